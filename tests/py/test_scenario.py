"""Scenarios: what is accepted, what is refused and how, packaged ones, moving and writing them."""

from __future__ import annotations

import copy
import tomllib
from pathlib import Path
from typing import Any

import pytest

from gnssins.errors import ConfigError, MissingFileError
from gnssins.sim import Simulator, load_scenario, relocate, scenario_from_dict, scenario_names, scenario_toml

MINIMAL: dict[str, Any] = {
    "scenario": {"name": "minimal", "duration_s": 10.0},
    "start": {"lat_deg": 45.0, "lon_deg": 10.0, "heading_deg": 0.0, "speed_m_s": 20.0},
    "initial_error": {"attitude_sd_deg": 1.0, "velocity_sd_m_s": 0.1, "position_sd_m": 1.0},
}
POINT = {"north_m": 10.0, "east_m": 0.0}
TURN = {"start_s": 1.0, "length_s": 1.0, "rate_deg_s": 1.0}
TO_3_M_S = {"from_s": 1.0, "to_s": 5.0, "target_m_s": 3.0}
BIAS = {"kind": "gyro_bias", "unit": "deg/h", "initial_sd": 1.0}


def with_changes(**changes: Any) -> dict[str, Any]:
    return copy.deepcopy(MINIMAL) | changes


def refused(tables: dict[str, Any]) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        scenario_from_dict(tables)
    return caught.value


@pytest.mark.parametrize("name", scenario_names())
def test_packaged_scenarios_load_and_survive_a_round_trip(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    assert scenario_from_dict(tomllib.loads(scenario_toml(scenario))) == scenario


def test_the_packaged_scenarios_are_found_by_name() -> None:
    assert scenario_names() == [
        "al-bitar-gavrilov-2019",
        "car-loop",
        "fomichev-tan-2017",
        "novik-2011",
        "static",
        "vasilyuk-2019",
    ]


def test_a_scenario_is_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(scenario_toml(scenario_from_dict(MINIMAL)), encoding="utf-8")
    assert load_scenario(path) == load_scenario(str(path)) == scenario_from_dict(MINIMAL)


def test_a_missing_file_and_an_unknown_name_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError):
        load_scenario(tmp_path / "none.toml")
    with pytest.raises(ConfigError, match="known: al-bitar-gavrilov-2019, car-loop, fomichev") as caught:
        load_scenario("car-lop")
    assert 'nearest: "car-loop"' in caught.value.hint


def test_an_unknown_key_is_refused_with_the_nearest_one() -> None:
    tables = with_changes()
    tables["start"]["hight_m"] = 100.0
    error = refused(tables)
    assert error.code == "config.unknown_key"
    assert "hight_m" in error.message
    assert "height_m" in error.hint


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        ("start", "lat_deg", 91.0),
        ("start", "speed_m_s", -1.0),
        ("start", "lat_deg", float("nan")),
        ("scenario", "rate_hz", 0.0),
        ("scenario", "duration_s", -5.0),
        ("scenario", "vehicle", "submarine"),
        ("initial_error", "position_sd_m", -1.0),
        ("initial_error", "position_sd_m", [1.0, 2.0]),
        ("start", "heading_deg", "north"),
    ],
)
def test_values_out_of_range_or_of_the_wrong_type_are_refused(table: str, key: str, value: object) -> None:
    tables = with_changes()
    tables[table][key] = value
    assert key in refused(tables).message


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"unit": "mg"}, "not a unit"),
        ({"initial_sd": [1.0, 2.0]}, "one number or 3"),
        ({"initial_sd": -1.0}, "must not be negative"),
        ({"value": 1.0}, "got initial_sd, value"),
        ({"process": "random_walk"}, "takes walk"),
        ({"process": "gauss_markov", "initial_sd": None, "sd": 1.0}, "takes sd and tau_s"),
        ({"kind": "gyro_misalignment", "unit": "mrad", "initial_sd": [1.0, 2.0, 3.0]}, "6 numbers"),
    ],
)
def test_inconsistent_sensor_errors_are_refused(change: dict[str, Any], text: str) -> None:
    error_table = {key: value for key, value in (BIAS | change).items() if value is not None}
    with pytest.raises(ConfigError, match=text):
        scenario_from_dict(with_changes(imu={"error": [error_table]}))


def test_two_sensor_errors_need_two_names() -> None:
    error = refused(with_changes(imu={"error": [BIAS, BIAS | {"process": "constant"}]}))
    assert "gyro_bias" in error.message
    names = [{**BIAS, "name": "turn_on"}, {**BIAS, "name": "drift"}]
    scenario = scenario_from_dict(with_changes(imu={"error": names}))
    assert [item.block_name for item in scenario.imu.error] == ["turn_on", "drift"]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"waypoint": [POINT]}, "set by the first waypoint"),
        ({"waypoint": [POINT], "turn": [TURN]}, "does not go with turn"),
        ({"waypoint": [{"north_m": 10.0, "lon_deg": 0.0}]}, "lat_deg and lon_deg, or north_m and east_m"),
        ({"slope": [{"from_s": 5.0, "to_s": 4.0, "angle_deg": 1.0}]}, "must be after from_s"),
        ({"speed": [{"from_s": 1.0, "to_s": 2.0}]}, "exactly one of"),
        ({"speed": [TO_3_M_S, {"from_s": 4.0, "to_s": 6.0, "change_m_s": 1.0}]}, "overlap"),
        ({"sway": [{"axis": "yaw", "amplitude_deg": 1.0, "period_s": 1.0}]}, "axis"),
        ({"gnss": {"rate_hz": 1.0}}, "position_sd_m, velocity_sd_m_s or both"),
        ({"gnss": {"rate_hz": 1.0, "position_sd_m": 1.0, "outages": [[5.0, 3.0]]}}, "from < to"),
        ({"variant": {"a": {"outages": [[-1.0, 3.0]]}}}, "from < to"),
        ({"version": 2}, "version"),
    ],
)
def test_combinations_that_mean_nothing_are_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        scenario_from_dict(with_changes(**changes))


@pytest.mark.parametrize(("table", "key"), [("start", "heading_deg"), ("scenario", "duration_s")])
def test_manoeuvres_need_a_heading_and_a_duration(table: str, key: str) -> None:
    tables = with_changes()
    del tables[table][key]
    error = refused(tables)
    assert error.code == "config.missing_key"
    assert key in error.message


def test_all_problems_are_told_at_once() -> None:
    tables = with_changes()
    tables["start"]["lat_deg"] = 100.0
    tables["scenario"]["rate_hz"] = -1.0
    assert len(refused(tables).context["problems"]) == 2  # type: ignore[arg-type]


def test_one_number_stands_for_three_axes() -> None:
    scenario = scenario_from_dict(with_changes(gnss={"rate_hz": 1, "position_sd_m": 2, "outages": []}))
    assert scenario.gnss is not None
    assert scenario.gnss.position_sd_m == (2, 2, 2)


def test_vehicles_bank_by_default_as_they_should() -> None:
    share = {}
    for vehicle in ("aircraft", "car", "ship"):
        tables = with_changes()
        tables["scenario"]["vehicle"] = vehicle
        share[vehicle] = scenario_from_dict(tables).coordination
    assert share == {"aircraft": 1.0, "car": 0.0, "ship": 0.0}
    assert scenario_from_dict(with_changes(motion={"coordination": 0.2})).coordination == 0.2


def test_relocation_moves_the_start_and_nothing_else() -> None:
    scenario = load_scenario("fomichev-tan-2017")
    moved = relocate(scenario, -33.0, 151.0, 20.0)
    assert (moved.start.lat_deg, moved.start.lon_deg, moved.start.height_m) == (-33.0, 151.0, 20.0)
    assert moved.turn == scenario.turn
    assert moved.motion == scenario.motion
    assert moved.truth.model == "ned"


def test_relocation_to_a_pole_takes_headings_from_the_grid() -> None:
    moved = relocate(load_scenario("fomichev-tan-2017"), 89.99, 0.0, model="ecef")
    assert moved.motion.heading_reference == "grid"
    assert moved.truth.model == "ecef"


def test_a_route_in_degrees_cannot_be_relocated() -> None:
    tables = with_changes(waypoint=[{"lat_deg": 45.1, "lon_deg": 10.1}])
    del tables["start"]["heading_deg"]
    with pytest.raises(ConfigError, match="cannot be moved"):
        relocate(scenario_from_dict(tables), 50.0, 10.0)


def test_a_variant_changes_the_outages_and_an_unknown_one_is_refused() -> None:
    scenario = load_scenario("fomichev-tan-2017")
    gaps = ((1800.0, 2100.0), (2200.0, 2400.0), (2500.0, 2700.0))
    assert Simulator(scenario).outages == Simulator(scenario, variant="continuous").outages == ()
    assert Simulator(scenario, variant="gaps").outages == gaps
    assert Simulator(scenario, variant="gaps", outages=[(1, 2)]).outages == ((1.0, 2.0),)
    with pytest.raises(ConfigError, match="from < to"):
        Simulator(scenario, outages=[(5.0, 3.0)])
    with pytest.raises(ConfigError, match="known: continuous, gaps"):
        Simulator(scenario, variant="gap")


def test_a_variant_replaces_whole_tables_and_keeps_the_outages_unless_it_has_its_own() -> None:
    tables = with_changes(
        gnss={"rate_hz": 1.0, "position_sd_m": 1.0, "outages": [[1.0, 2.0]]},
        imu={"error": [BIAS]},
        sway=[{"axis": "roll", "amplitude_deg": 1.0, "period_s": 1.0}],
        variant={
            "calm": {"sway": []},
            "open": {"outages": []},
            "other": {"gnss": {"rate_hz": 2.0, "position_sd_m": 5.0, "outages": [[3.0, 4.0]]}},
            "perfect": {"imu": {}},
            "level": {"initial_error": MINIMAL["initial_error"] | {"attitude_sd_deg": 0.0}},
            "high": {"baro": {"rate_hz": 1.0, "height_sd_m": 1.0}},
        },
    )
    scenario = scenario_from_dict(tables)
    assert Simulator(scenario, variant="calm").scenario.sway == ()
    assert Simulator(scenario, variant="calm").outages == ((1.0, 2.0),)
    assert Simulator(scenario, variant="open").outages == ()
    assert Simulator(scenario, variant="open").scenario is scenario
    assert Simulator(scenario, variant="other").outages == ((3.0, 4.0),)
    assert len(Simulator(scenario, variant="other").run(1).dataset.gnss) == 18
    assert Simulator(scenario, variant="perfect").run(1).truth_blocks == {}
    assert not Simulator(scenario, variant="level").run(1).initial_error[:3].any()
    assert len(Simulator(scenario, variant="high").run(1).dataset.baro) == 10
    assert scenario.sway
    assert scenario.baro is None


def test_a_variant_is_checked_like_the_scenario() -> None:
    error = refused(with_changes(variant={"a": {"imu": {"error": [BIAS | {"unit": "mg"}]}}}))
    assert "not a unit" in error.message
    assert "unknown key" in refused(with_changes(variant={"a": {"waypoint": []}})).message


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(ConfigError, match="seed"):
        Simulator(scenario_from_dict(MINIMAL)).run(-1)
