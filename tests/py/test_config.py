"""Configuration: what is accepted, what becomes of it in SI, and that the file survives a round trip."""

import contextlib
import json
import math
import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from gnssins import _core
from gnssins.config import Config, preset_names, render_reference
from gnssins.config.schema import table_of
from gnssins.errors import ConfigError, GnssinsError, InputError, MissingFileError

NOISE = {"imu": {"gyro": {"arw_deg_sqrt_h": 0.15}, "accel": {"vrw_m_s_sqrt_h": 0.06}}}
DEG = math.pi / 180.0
G = 9.80665


def with_noise(**sections):
    """Tables with both noises, and the given sections laid over them."""
    tables = json.loads(json.dumps(NOISE))
    for name, keys in sections.items():
        tables.setdefault(name, {}).update(keys)
    return tables


def test_noise_alone_makes_a_configuration_with_nine_states():
    engine = Config.from_dict(NOISE).engine_config()
    assert engine["blocks"] == []
    assert (engine["model"], engine["ellipsoid"], engine["gravity"]) == ("ned", "wgs84", "normal")
    assert (engine["coning"], engine["phi_order"], engine["imu"]["input"]) == ("two-sample", 3, "rates")


# ---- units: the numbers are worked by hand from the definitions


def test_noise_keys_give_densities_in_si():
    gyro = 0.15 * DEG / 60.0
    engine = Config.from_dict(NOISE).engine_config()["imu"]
    np.testing.assert_allclose(engine["gyro_psd"], [gyro**2] * 3, rtol=1e-15)
    np.testing.assert_allclose(engine["accel_psd"], [1e-6] * 3, rtol=1e-15)


def test_noise_density_equals_random_walk_in_other_units():
    other = {
        "imu": {
            "gyro": {"noise_density_deg_s_sqrt_hz": 0.0025},
            "accel": {"noise_density_ug_sqrt_hz": 1e6 * 1e-3 / G},
        }
    }
    a, b = Config.from_dict(NOISE).engine_config(), Config.from_dict(other).engine_config()
    np.testing.assert_allclose(a["imu"]["gyro_psd"], b["imu"]["gyro_psd"], rtol=1e-12)
    np.testing.assert_allclose(a["imu"]["accel_psd"], b["imu"]["accel_psd"], rtol=1e-12)


def test_noise_may_differ_between_axes():
    tables = with_noise(imu={"accel": {"noise_density_m_s2_sqrt_hz": [0.1, 0.2, 0.3]}})
    psd = Config.from_dict(tables).engine_config()["imu"]["accel_psd"]
    np.testing.assert_allclose(psd, [0.01, 0.04, 0.09], rtol=1e-15)


def test_ranges_calibration_latency_and_rates_become_si():
    matrix = [[0.001, 0, 0], [0, 0.002, 0], [0, 0, 0.003]]
    tables = with_noise(gnss={"latency_ms": -100, "lever_ba_b_m": [0.85, 0, -1.2], "gate_probability": "off"})
    tables["gnss"]["reacquire_after"] = "off"
    tables["imu"]["gyro"] |= {"range_deg_s": 2000, "bias_deg_h": [3600, 0, 0]}
    tables["imu"]["accel"] |= {"range_g": 16, "bias_mg": 1, "matrix": matrix}
    tables["imu"] |= {"max_gap_s": 0.25, "on_gap": "bridge"}
    tables["run"] = {"output_rate_hz": 10, "covariance_interval_s": 2.5}
    engine = Config.from_dict(tables).engine_config()
    assert engine["imu"]["gyro_range"] == pytest.approx(2000 * DEG)
    assert engine["imu"]["accel_range"] == pytest.approx(16 * G)
    assert engine["imu"]["gyro_bias"] == pytest.approx([DEG, 0, 0])
    assert engine["imu"]["accel_bias"] == pytest.approx([G * 1e-3] * 3)
    assert engine["imu"]["accel_matrix"] == matrix
    assert (engine["imu"]["max_gap_ns"], engine["imu"]["on_gap"]) == (250_000_000, "bridge")
    assert engine["gnss"] == {
        "lever_b_m": [0.85, 0, -1.2],
        "latency_ns": -100_000_000,
        "gate_probability": None,
        "reacquire_after": None,
        "gate": "joint",
        "trace_ratio_limit": None,
        "max_accel_m_s2": None,
    }
    assert engine["output"] == {
        "interval_ns": 100_000_000,
        "covariance_interval_ns": 2_500_000_000,
        "linearise": False,
    }


@pytest.mark.parametrize("value", [0, 1, -3, 2.5, True, "never"])
def test_reacquisition_takes_a_number_of_fixes_or_off(value):
    with pytest.raises(ConfigError, match=r"\[gnss\] reacquire_after"):
        Config.from_dict(with_noise(gnss={"reacquire_after": value}))


def test_sorting_is_done_by_the_reader_so_the_engine_is_told_to_stop():
    for choice, told in (("stop", "stop"), ("drop", "drop"), ("sort", "stop")):
        config = Config.from_dict(with_noise(imu={"on_backwards": choice}))
        assert config.engine_config()["imu"]["on_backwards"] == told


# ---- presets and blocks


@pytest.mark.parametrize("name", preset_names())
def test_preset_alone_gives_exactly_the_engine_configuration_of_the_core(name):
    engine = Config.from_dict({"filter": {"preset": name}}).engine_config()
    assert engine == json.loads(_core.preset_json(name))


def test_initial_state_is_passed_on_as_it_is():
    initial = {"t_ns": 1, "lat_rad": 0.5}
    assert Config.from_dict(NOISE).engine_config(initial)["initial"] == initial
    assert "initial" not in Config.from_dict(NOISE).engine_config()


def test_explicit_keys_go_before_the_preset():
    tables = with_noise(filter={"preset": "ned-15", "model": "ecef", "phi_order": 1, "gravity": "vertical"})
    engine = Config.from_dict(tables).engine_config()
    assert (engine["model"], engine["phi_order"], engine["gravity"]) == ("ecef", 1, "vertical")
    assert engine["imu"]["gyro_psd"] == pytest.approx([(0.15 * DEG / 60) ** 2] * 3)
    assert len(engine["blocks"]) == 2


def blocks_of(*blocks, preset="ned-15"):
    tables = with_noise(filter={"block": list(blocks)} | ({"preset": preset} if preset else {}))
    return Config.from_dict(tables).engine_config()["blocks"]


def test_block_of_the_preset_changes_only_the_keys_it_gives():
    before = {b["name"]: b for b in json.loads(_core.preset_json("ned-15"))["blocks"]}
    after = {b["name"]: b for b in blocks_of({"kind": "gyro_bias", "unit": "deg/h", "initial_sd": 36})}
    assert after["accel_bias"] == before["accel_bias"]
    assert after["gyro_bias"]["psd"] == before["gyro_bias"]["psd"]
    assert after["gyro_bias"]["initial_sd"] == pytest.approx([0.01 * DEG] * 3)


def test_new_block_is_added_after_those_of_the_preset():
    lever = {"kind": "gnss_lever_arm", "unit": "m", "initial_sd": 0.1, "initial": [1.0, 0.0, -0.5]}
    blocks = blocks_of(lever)
    assert [b["name"] for b in blocks] == ["gyro_bias", "accel_bias", "gnss_lever_arm"]
    assert blocks[2] == {
        "kind": "gnss_lever_arm",
        "name": "gnss_lever_arm",
        "process": "constant",
        "initial_sd": [0.1] * 3,
        "initial": [1.0, 0.0, -0.5],
    }


def test_sum_of_two_processes_is_two_named_blocks():
    drift = {"kind": "accel_bias", "process": "gauss_markov", "unit": "mg", "sd": 0.05, "tau_s": 1800}
    constant = {"kind": "accel_bias", "name": "turn_on", "unit": "ug", "initial_sd": 500}
    blocks = blocks_of(drift, constant, preset=None)
    assert [b["name"] for b in blocks] == ["accel_bias", "turn_on"]
    assert blocks[0]["sd"] == pytest.approx([5e-5 * G] * 3)
    assert blocks[0]["initial_sd"] == blocks[0]["sd"]
    assert blocks[0]["tau_s"] == [1800.0] * 3


def test_change_of_process_drops_the_figures_of_the_old_one():
    gyro = {"kind": "gyro_bias", "process": "gauss_markov", "unit": "deg/h", "sd": 10, "tau_s": 300}
    block = blocks_of(gyro)[0]
    assert set(block) == {"kind", "name", "process", "initial_sd", "initial", "sd", "tau_s"}


def test_random_walk_is_given_per_square_root_of_time():
    walk = {"kind": "gyro_bias", "process": "random_walk", "unit": "deg/s", "initial_sd": 1, "walk": 0.002}
    np.testing.assert_allclose(blocks_of(walk, preset=None)[0]["psd"], [(0.002 * DEG) ** 2] * 3)


def test_misalignment_has_six_states():
    block = {"kind": "accel_misalignment", "unit": "mrad", "initial_sd": 2}
    assert blocks_of(block, preset=None)[0]["initial_sd"] == pytest.approx([0.002] * 6)


def test_engine_takes_every_kind_of_block():
    units = {"gyro_scale": "ppm", "accel_scale": "ppm", "baro_bias": "m", "gnss_lever_arm": "m"}
    units |= {"gyro_misalignment": "mrad", "accel_misalignment": "mrad"}
    units |= {"gnss_position_error": "m", "gnss_velocity_error": "m/s"}
    gauss = {"process": "gauss_markov", "sd": 1.0, "tau_s": 60.0}
    for kind, unit in units.items():
        tables = with_noise(filter={"preset": "ned-15", "block": [{"kind": kind, "unit": unit, **gauss}]})
        initial = {"t_ns": 0, "lat_rad": 0.5, "lon_rad": 0.1, "height_m": 0.0, "v_n": [0.0] * 3}
        initial |= {"q_nb": [1.0, 0, 0, 0], "sd_phi": [0.1] * 3, "sd_v": [0.1] * 3, "sd_p": [1.0] * 3}
        navigator = _core.Navigator(json.dumps(Config.from_dict(tables).engine_config(initial)))
        assert len(navigator._state()["x"]) > 6


# ---- files


def test_every_example_loads_and_survives_a_round_trip(repository, tmp_path):
    examples = sorted((repository / "examples").glob("*.toml"))
    assert len(examples) >= 9
    for example in examples:
        config = Config.load(example)
        config.to_toml(tmp_path / "copy.toml")
        assert Config.load(tmp_path / "copy.toml") == config, example.name


def test_relative_files_count_from_the_folder_of_the_toml(tmp_path):
    (tmp_path / "runs").mkdir()
    file = tmp_path / "runs" / "a.toml"
    file.write_text(
        Config.from_dict(NOISE).to_toml_text().replace("[imu]", '[imu]\nfile = "../log/i.csv"', 1)
    )
    assert Config.load(file).imu.file == tmp_path.resolve() / "log" / "i.csv"


def test_relative_files_without_a_toml_count_from_the_working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = Config.from_dict(with_noise(gnss={"file": "g.csv"}))
    assert config.gnss.file == tmp_path.resolve() / "g.csv"


def test_windows_line_ends_and_byte_order_mark_are_read(tmp_path):
    text = 'version = 1\r\n[filter]\r\npreset = "ned-15"\r\n'
    (tmp_path / "a.toml").write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert Config.load(tmp_path / "a.toml").filter.preset == "ned-15"


def test_missing_file_says_where_it_was_looked_for(tmp_path):
    with pytest.raises(MissingFileError, match="no such file") as caught:
        Config.load(tmp_path / "nowhere.toml")
    assert caught.value.code == "input.not_found"


def test_folder_instead_of_a_file_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="directory"):
        Config.load(tmp_path)


@pytest.mark.parametrize("text", ["[imu\n", "a = [1,\n", "a = 1\na = 2\n", "unit = deg/s\n"])
def test_broken_toml_names_file_and_line(tmp_path, text):
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(ConfigError, match=r"a\.toml.*(line \d|end of document)") as caught:
        Config.load(tmp_path / "a.toml")
    assert caught.value.code == "config.syntax"


def test_text_that_is_not_utf8_is_a_syntax_error(tmp_path):
    (tmp_path / "a.toml").write_bytes(b'a = "\xe9"')
    with pytest.raises(ConfigError, match="UTF-8"):
        Config.load(tmp_path / "a.toml")


def test_configuration_is_immutable():
    config = Config.from_dict(NOISE)
    with pytest.raises(ValidationError):
        config.gnss.latency_ms = 3.0


def test_replace_changes_and_removes_keys_and_checks_the_whole():
    config = Config.from_dict(with_noise(run={"start_s": 10.0}))
    changed = config.replace(run={"start_s": None, "outages": [[60.0, 90.0]]})
    assert (changed.run.start_s, changed.run.outages) == (None, ((60.0, 90.0),))
    with pytest.raises(ConfigError, match=r"\[run\] outages"):
        config.replace(run={"outages": [[90.0, 60.0]]})


@given(
    st.fixed_dictionaries(
        {},
        optional={
            "start_s": st.floats(-1e9, 1e9),
            "output_rate_hz": st.floats(1e-3, 1e3),
            "outages": st.just([[1.0, 2.0], [2.0, 3.5]]),
        },
    ),
    st.fixed_dictionaries(
        {},
        optional={
            "latency_ms": st.floats(-1e3, 1e3),
            "position_sd_m": st.floats(1e-3, 1e3),
            "gate_probability": st.one_of(st.just("off"), st.floats(0.5, 0.9999)),
            "lever_ba_b_m": st.lists(st.floats(-10, 10), min_size=3, max_size=3),
        },
    ),
)
def test_any_valid_configuration_survives_toml_and_json(run, gnss):
    config = Config.from_dict(with_noise(run=run, gnss=gnss))
    assert Config.from_dict(tomllib.loads(config.to_toml_text())) == config
    assert Config.from_dict(json.loads(json.dumps(config.to_dict()))) == config


@given(st.binary(max_size=200))
def test_any_bytes_as_toml_give_a_configuration_or_a_typed_error(tmp_path_factory, data):
    file = tmp_path_factory.getbasetemp() / "fuzz.toml"
    file.write_bytes(data)
    with contextlib.suppress(GnssinsError):
        Config.load(file)


# ---- the reference of all keys


def test_reference_is_toml_that_holds_the_defaults():
    tables = tomllib.loads(render_reference())
    for section in ("gyro", "accel"):
        tables["imu"][section].update(NOISE["imu"][section])
    assert Config.from_dict(tables) == Config.from_dict(NOISE)


def every_field(model):
    for key, field in model.model_fields.items():
        yield model.__name__, key, field
        if (inner := table_of(model, key)) is not None:
            yield from every_field(inner)


def test_every_key_is_described_and_stands_in_the_reference():
    text = render_reference()
    for owner, key, field in every_field(Config):
        assert field.description, f"{owner}.{key}"
        if table_of(Config, key) is None and owner != "GeoPoint":
            assert f"{key} = " in text or f"{key}]" in text, f"{owner}.{key}"


def test_lines_of_the_reference_fit_the_screen():
    assert max(map(len, render_reference().splitlines())) <= 110


def test_bounds_jumps_and_feedback_reach_the_engine():
    tables = {"gnss": {}}
    tables["filter"] = {
        "preset": "novik-2011",
        "feedback_interval_s": 100.0,
        "floor_attitude_deg": [0.1, 0.1, 0.5],
        "floor_velocity_m_s": 0.002,
        "block": [
            {"kind": "baro_bias", "unit": "m", "floor_sd": 0.1},
            {"kind": "gnss_position_error", "unit": "m", "jump_sd": [1.0, 2.0, 3.0], "distance_m": 1e5},
        ],
    }
    tables["gnss"] |= {"gate": "parts", "trace_ratio_limit": 10, "max_accel_m_s2": 5}
    tables["baro"] = {"latency_ms": 20, "gate_probability": "off"}
    engine = Config.from_dict(tables).engine_config()
    assert engine["feedback_ns"] == 100_000_000_000
    assert engine["floor"] == {
        "phi": pytest.approx([0.1 * DEG, 0.1 * DEG, 0.5 * DEG]),
        "v": [0.002] * 3,
        "p": [0.0] * 3,
    }
    blocks = {block["name"]: block for block in engine["blocks"]}
    assert blocks["baro_bias"]["floor_sd"] == [0.1]
    assert blocks["baro_bias"]["initial_sd"] == [4.0]  # the preset's
    error = blocks["gnss_position_error"]
    assert (error["jump_sd"], error["distance_m"], error["sd"]) == ([1.0, 2.0, 3.0], 1e5, [6.0, 6.0, 8.5])
    assert blocks["gnss_velocity_error"]["jump_sd"] == [0.015] * 3
    assert "distance_m" not in blocks["gnss_velocity_error"]
    gnss = engine["gnss"]
    assert (gnss["gate"], gnss["trace_ratio_limit"], gnss["max_accel_m_s2"]) == ("parts", 10, 5)
    assert engine["baro"] == {"latency_ns": 20_000_000, "gate_probability": None}
    assert engine["heading"] == {"latency_ns": 0, "gate_probability": 0.999}


@pytest.mark.parametrize(
    ("block", "text"),
    [
        ({"kind": "gyro_bias", "unit": "deg/h", "distance_m": 100.0}, "for gnss_position_error"),
        ({"kind": "baro_bias", "unit": "m", "process": "random_walk", "distance_m": 9.0}, "gauss_markov"),
        ({"kind": "baro_bias", "unit": "m", "floor_sd": -1.0}, "negative"),
        ({"kind": "baro_bias", "floor_sd": 1.0}, "in which unit"),
    ],
)
def test_bounds_that_make_no_sense_are_refused(block, text):
    tables = {"gnss": {}}
    tables["filter"] = {"preset": "novik-2011", "block": [block]}
    with pytest.raises(ConfigError, match=text):
        Config.from_dict(tables)
