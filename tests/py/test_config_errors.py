"""Configuration errors: each names the key, the value, what is allowed and the remedy."""

import pytest

from gnssins.config import Config
from gnssins.errors import ConfigError

GYRO = {"arw_deg_sqrt_h": 0.15}
ACCEL = {"vrw_m_s_sqrt_h": 0.06}


def refuse(**sections):
    """Validate tables that are complete but for the given keys, and return the error."""
    tables = {"imu": {"gyro": dict(GYRO), "accel": dict(ACCEL)}}
    for name, keys in sections.items():
        if isinstance(keys, dict):
            tables.setdefault(name, {}).update(keys)
        else:
            tables[name] = keys
    with pytest.raises(ConfigError) as caught:
        Config.from_dict(tables, source="drive.toml")
    return caught.value


def test_misspelt_key_is_refused_with_path_value_and_nearest_key():
    error = refuse(gnss={"latncy_ms": 40})
    assert error.code == "config.unknown_key"
    assert "drive.toml: [gnss] latncy_ms = 40: unknown key" in error.message
    assert error.hint == "nearest: latency_ms"


def test_key_of_another_section_is_sent_there():
    error = refuse(imu={"latency_ms": 40})
    assert "it belongs to [gnss]" in error.hint


def test_unknown_section_is_refused_with_the_nearest():
    assert refuse(imo={"file": "a"}).hint == "nearest: imu"


def test_unknown_key_without_a_likeness_lists_the_known_ones():
    assert "start_s" in refuse(run={"zzz": 1}).hint


def test_key_in_a_block_is_named_with_the_number_of_the_block():
    block = {"kind": "gyro_bias", "unit": "deg/h", "initial_sd": 1, "tau": 5}
    error = refuse(filter={"block": [dict(block, tau_s=1.0), block]})
    assert "[[filter.block]] #2 tau = 5: unknown key" in str(error)


def test_all_problems_of_a_file_are_told_at_once():
    error = refuse(gnss={"latncy_ms": 40, "use": "pos"}, imu={"max_bad_share": 3}, run={"output_rate_hz": 0})
    paths = [problem["path"] for problem in error.context["problems"]]
    assert paths == ["[run] output_rate_hz", "[imu] max_bad_share", "[gnss] use", "[gnss] latncy_ms"]
    assert "drive.toml: 4 problems" in error.message
    assert all(path in error.message for path in paths)


def test_many_problems_are_listed_by_key_after_the_first():
    error = refuse(run={f"x{i}": 1 for i in range(12)})
    assert "12 problems" in error.message
    assert "and at [run] x8, [run] x9, [run] x10, [run] x11" in error.message


@pytest.mark.parametrize(
    ("key", "value", "nearest"),
    [("gyro_unit", "deg/sec", '"deg/s"'), ("accel_unit", "m/s2", '"m/s^2"'), ("time_unit", "sec", '"s"')],
)
def test_wrong_unit_is_refused_with_the_choices(key, value, nearest):
    error = refuse(imu={key: value})
    assert error.code == "config.unit"
    assert f'[imu] {key} = "{value}": must be one of' in error.message
    assert nearest in str(error)


@pytest.mark.parametrize(
    ("kind", "key", "unit"),
    [
        ("increments", "gyro_unit", "deg/s"),
        ("rates", "accel_unit", "m/s"),
        ("mean-rates", "gyro_unit", "rad"),
    ],
)
def test_unit_of_rates_does_not_go_with_increments(kind, key, unit):
    error = refuse(imu={"kind": kind, key: unit})
    assert error.code == "config.unit"
    assert f'[imu] {key} = "{unit}"' in error.message
    assert f'kind = "{kind}"' in error.message


@pytest.mark.parametrize(
    ("section", "key", "value", "allowed"),
    [
        ("imu", "max_bad_share", 1.5, ">= 0 and <= 1"),
        ("imu", "max_gap_s", 0, "> 0"),
        ("gnss", "sd_scale", -1, "> 0"),
        ("gnss", "latency_ms", 1e6, ">= -10000 and <= 10000"),
        ("filter", "phi_order", 4, ">= 1 and <= 3"),
        ("initial", "heading_deg", 400, ">= -180 and <= 360"),
    ],
)
def test_value_out_of_range_is_refused_with_the_range(section, key, value, allowed):
    error = refuse(**{section: {key: value}})
    assert error.code == "config.range"
    assert f"[{section}] {key} = " in error.message
    assert allowed in error.message


@pytest.mark.parametrize("value", [0, -0.1, [0.1, 0.0, 0.1]])
@pytest.mark.parametrize(
    ("sensor", "key"),
    [
        ("gyro", "arw_deg_sqrt_h"),
        ("gyro", "noise_density_deg_s_sqrt_hz"),
        ("accel", "vrw_m_s_sqrt_h"),
        ("accel", "noise_density_ug_sqrt_hz"),
        ("accel", "noise_density_m_s2_sqrt_hz"),
    ],
)
def test_zero_or_negative_noise_is_refused_with_the_reason(sensor, key, value):
    error = refuse(imu={sensor: {key: value}})
    assert error.code == "config.noise"
    assert f"[imu.{sensor}] {key}" in error.message
    assert "perfect" in error.message


@pytest.mark.parametrize("key", ["position_sd_m", "velocity_sd_m_s"])
def test_zero_accuracy_of_fixes_is_refused(key):
    assert refuse(gnss={key: [1.0, 1.0, 0.0]}).code == "config.noise"


def test_zero_initial_uncertainty_of_a_state_is_refused():
    block = {"kind": "gyro_bias", "unit": "deg/h", "initial_sd": 0}
    error = refuse(filter={"block": [block]})
    assert error.code == "config.noise"
    assert "singular" in error.message


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_values_that_are_not_finite_are_refused(value):
    assert "[gnss] latency_ms" in refuse(gnss={"latency_ms": value}).message


@pytest.mark.parametrize(
    ("section", "key", "value", "says"),
    [
        ("gnss", "latency_ms", "40", "must be a number"),
        ("gnss", "latency_ms", True, "must be a number"),
        ("gnss", "file", 5, "file name in quotes"),
        ("gnss", "lever_ba_b_m", 1.0, "list of three numbers"),
        ("imu", "time_column", 1, "text in quotes"),
        ("imu", "gyro_columns", ["a", "b"], "three column names"),
        ("imu", "gyro_columns", ["a", "b", "a"], "names a column twice"),
        ("filter", "phi_order", 2.5, "whole number"),
        ("run", "outages", [[1.0]], "[from_s, to_s]"),
        ("initial", "velocity", 3.0, "three numbers"),
        ("initial", "position", "home", "lat_deg"),
    ],
)
def test_wrong_type_is_never_converted_in_silence(section, key, value, says):
    error = refuse(**{section: {key: value}})
    assert f"[{section}] {key}" in error.message
    assert says in error.message


def test_column_names_under_the_sensor_are_sent_to_their_key():
    error = refuse(imu={"gyro": ["wx", "wy", "wz"]})
    assert "gyro_columns" in error.hint


def test_column_used_twice_is_refused():
    assert "gyro_x" in refuse(imu={"accel_columns": ["gyro_x", "b", "c"]}).message


def test_noise_left_out_everywhere_is_an_error_that_names_the_keys():
    with pytest.raises(ConfigError) as caught:
        Config.from_dict({})
    text = str(caught.value)
    assert "[imu.gyro]: gyro noise missing" in text
    assert "arw_deg_sqrt_h or noise_density_deg_s_sqrt_hz" in text
    assert "vrw_m_s_sqrt_h" in text


def test_same_noise_given_twice_is_refused():
    error = refuse(imu={"gyro": {**GYRO, "noise_density_deg_s_sqrt_hz": 0.1}})
    assert error.code == "config.conflict"
    assert "arw_deg_sqrt_h, noise_density_deg_s_sqrt_hz" in error.message


def test_unknown_preset_is_refused_with_the_nearest():
    error = refuse(filter={"preset": "ned15"})
    assert error.code == "config.preset"
    assert error.hint == 'nearest: "ned-15"'


@pytest.mark.parametrize(
    ("block", "says"),
    [
        ({"kind": "gyro_bais"}, 'nearest: "gyro_bias"'),
        ({"kind": "gyro_bias", "initial_sd": 1}, "in which unit is initial_sd?"),
        ({"kind": "gyro_bias", "unit": "mg", "initial_sd": 1}, '"deg/h", "deg/s", "rad/s"'),
        ({"kind": "gyro_bias", "unit": "deg/h", "initial_sd": [1, 2]}, "3 numbers"),
        ({"kind": "gyro_bias", "unit": "deg/h"}, "initial_sd: missing"),
        ({"kind": "gyro_bias", "process": "random_walk", "unit": "deg/h", "initial_sd": 1}, "walk: missing"),
        ({"kind": "gyro_bias", "process": "gauss_markov", "unit": "deg/h", "sd": 1}, "tau_s: missing"),
        ({"kind": "baro_bias", "unit": "m", "initial_sd": 1, "tau_s": -5}, "must be > 0"),
        (
            {"kind": "gyro_bias", "process": "constant", "unit": "deg/h", "initial_sd": 1, "walk": 1},
            'belongs to process = "random_walk"',
        ),
        ({"kind": "gyro_bias", "name": "Gyro Bias"}, "pattern"),
    ],
)
def test_incomplete_or_inconsistent_block_is_refused(block, says):
    assert says in str(refuse(filter={"block": [block]}))


def test_two_blocks_of_one_name_are_refused():
    block = {"kind": "gyro_bias", "unit": "deg/h", "initial_sd": 1}
    assert 'two blocks are called "gyro_bias"' in str(refuse(filter={"block": [block, block]}))


def test_block_with_the_name_of_another_kind_is_refused():
    block = {"kind": "accel_bias", "name": "gyro_bias", "unit": "mg", "initial_sd": 1}
    assert "of kind" in str(refuse(filter={"preset": "ned-15", "block": [block]}))


def test_mirrored_axes_are_refused_as_left_handed():
    for axes in ("FRU", [[1, 0, 0], [0, 1, 0], [0, 0, -1]]):
        error = refuse(imu={"axes": axes})
        assert error.code == "config.axes"
        assert "left-handed" in error.message


def test_skewed_axes_are_refused_as_not_orthonormal():
    error = refuse(imu={"axes": [[1, 0.001, 0], [0, 1, 0], [0, 0, 1]]})
    assert "not orthonormal" in error.message
    assert "0.001" in error.message


@pytest.mark.parametrize("axes", ["FFD", "FBU", "XYZ", "FR", "", 3, [[1, 0], [0, 1]]])
def test_axes_that_are_no_frame_are_refused(axes):
    error = refuse(imu={"axes": axes})
    assert "[imu] axes" in error.message


def test_accuracy_from_the_configuration_needs_its_keys():
    error = refuse(gnss={"sd": "config", "use": "position"})
    assert "[gnss] position_sd_m: missing" in error.message
    assert "velocity" not in error.message


@pytest.mark.parametrize("outages", [[[5, 3]], [[3, 3]], [[1, 4], [3, 6]], [[5, 6], [1, 2]]])
def test_outages_must_rise_and_not_overlap(outages):
    assert "[run] outages" in refuse(run={"outages": outages}).message


def test_end_must_come_after_start():
    assert "[run] end_s = 5" in refuse(run={"start_s": 10.0, "end_s": 5.0}).message


@pytest.mark.parametrize(
    ("initial", "says"),
    [
        ({"roll_deg": 1.0}, "add pitch_deg"),
        ({"leveling": "accel", "roll_deg": 1.0, "pitch_deg": 0.0}, "keep one way"),
        ({"heading": "course", "heading_deg": 10.0}, "keep one way"),
        ({"position": {"lat_deg": 95.0, "lon_deg": 0.0, "height_m": 0.0}}, ">= -90 and <= 90"),
        ({"position": {"lat_deg": 45.0, "lon_deg": 0.0}}, "height_m: missing"),
    ],
)
def test_contradictory_or_incomplete_start_is_refused(initial, says):
    assert says in str(refuse(initial=initial))


def test_other_version_of_the_format_is_refused():
    error = refuse(version=2)
    assert error.code == "config.version"
    assert "version 1" in error.message
