"""The packaged scenarios of the publications: their figures, and the runs that are made of them."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from gnssins import _core
from gnssins.config import Config, load_preset
from gnssins.io import read_dataset
from gnssins.sim import Simulator, Trajectory, load_scenario, scenario_from_dict
from gnssins.sim.waypoints import plan_route
from gnssins.simfiles import matching_filter, output_files, scenario_config, write_simulation
from gnssins.units import ACCEL_BIAS, GYRO_BIAS

Array = NDArray[np.float64]


def turns(name: str) -> list[tuple[float, float, float]]:
    """Start (s), end (s) and change (deg) of every turn of a route."""
    scenario = load_scenario(name)
    ramp_s = scenario.motion.turn_ramp_s
    return [
        (
            pulse.start_s,
            pulse.start_s + pulse.length_s + ramp_s,
            float(np.degrees(pulse.value * pulse.length_s)),
        )
        for pulse in plan_route(scenario).profile.turns
    ]


def speed(path: Trajectory) -> Array:
    return np.linalg.norm(path.v_n, axis=1)


def inside_4_sigma(found: Array, sd: float, count: int) -> None:
    """Check the variance of ``count`` independent draws."""
    low, high = chi2.ppf([3e-5, 1.0 - 3e-5], count) / count
    assert low < np.var(found) / sd**2 < high


# ---- city drive


@pytest.fixture(scope="module")
def drive() -> Simulator:
    return Simulator("al-bitar-gavrilov-2019", variant="gaps", truth_rate_hz=1.0)


def test_the_city_drive_has_the_stated_length_speed_and_stops(drive: Simulator) -> None:
    path, v = drive.trajectory, speed(drive.trajectory)
    assert (len(path), path.t_ns[-1]) == (180_001, 900_000_000_000)
    assert np.sum(v[1:] * path.dt_s) == pytest.approx(7900.0, abs=50.0)
    assert v.max() == pytest.approx(13.0, abs=0.05)
    standing = np.diff((v < 1e-3).astype(int), prepend=0)
    assert np.sum(standing == 1) >= 6
    lat, lon = np.degrees(path.lla[:, 0]), np.degrees(path.lla[:, 1])
    assert 45.04 < lat.min() < lat.max() < 45.06
    assert 7.64 < lon.min() < lon.max() < 7.68


def test_the_city_drive_turns_by_90_deg_every_60_to_70_s() -> None:
    made = turns("al-bitar-gavrilov-2019")
    assert len(made) == 13
    assert np.abs([change for _, _, change in made]) == pytest.approx(np.full(13, 90.0), abs=1e-6)
    assert all(60.0 <= after - before <= 70.0 for (before, _, _), (after, _, _) in pairwise(made))


def test_the_gaps_of_the_city_drive_are_the_stated_ones(drive: Simulator) -> None:
    assert drive.outages == tuple((s, s + 60.0) for s in (200.0, 295.0, 390.0, 485.0, 580.0, 675.0, 770.0))
    assert len(drive.run(1).dataset.gnss) == 4500 - 7 * 300


def test_the_sensors_of_the_city_drive_have_the_stated_figures(drive: Simulator) -> None:
    scenario = drive.scenario
    assert np.degrees(scenario.imu.gyro.density[0]) * 60.0 == pytest.approx(0.15)
    assert scenario.imu.accel.density[0] == pytest.approx(57e-6 * 9.80665)
    runs = [drive.run(seed).truth_blocks for seed in range(15)]
    assert list(runs[0]) == ["gyro_walk", "gyro_drift", "accel_walk", "accel_drift"]
    inside_4_sigma(np.array([run["gyro_walk"][0] for run in runs]), np.radians(0.02), 45)
    inside_4_sigma(np.array([run["accel_walk"][0] for run in runs]), 3.0 * ACCEL_BIAS["mg"], 45)
    # both walk over the whole drive: one increment of 900 s per axis and run
    walked = np.array([run["gyro_walk"][-1] - run["gyro_walk"][0] for run in runs])
    inside_4_sigma(walked, 5e-7 * 30.0, 45)
    inside_4_sigma(np.array([run["accel_walk"][-1] - run["accel_walk"][0] for run in runs]), 1e-5 * 30.0, 45)
    # drifts: four values 200 s or more apart per axis and run
    inside_4_sigma(np.array([run["gyro_drift"][::300] for run in runs]), 3.0 * GYRO_BIAS["deg/h"], 120)
    inside_4_sigma(np.array([run["accel_drift"][::300] for run in runs]), 20.0 * ACCEL_BIAS["ug"], 120)


def test_two_antennas_and_raw_sensors_are_variants_of_the_city_drive() -> None:
    two = Simulator("al-bitar-gavrilov-2019", variant="dual-antenna", truth_rate_hz=1.0).run(1)
    assert len(two.dataset.heading) == 4500
    raw = Simulator("al-bitar-gavrilov-2019", variant="raw", truth_rate_hz=1.0).run(1)
    assert raw.truth_blocks["gyro_scale"][5] == pytest.approx([8e-4, -5e-4, 1.2e-3])
    assert raw.truth_blocks["accel_misalignment"].shape[1] == 6
    assert np.array_equal(raw.truth_blocks["gyro_walk"], two.truth_blocks["gyro_walk"])


# ---- pole


@pytest.fixture(scope="module")
def walk() -> Simulator:
    return Simulator("vasilyuk-2019")


def test_the_walk_is_closed_at_walking_speed_after_a_rest(walk: Simulator) -> None:
    path, v = walk.trajectory, speed(walk.trajectory)
    assert walk.scenario.scenario.rate_hz == 100.0
    assert path.model == "ecef"
    assert not v[:1500].any()
    assert v.max() == pytest.approx(1.2)
    ends = _core.lla_to_ecef(path.lla[[0, -1]], path.ellipsoid)
    assert np.linalg.norm(ends[1] - ends[0]) < 1.0
    assert np.sum(v[1:] * path.dt_s) == pytest.approx(168.0, abs=2.0)


def test_the_walk_has_long_straights_and_a_place_for_the_outage(walk: Simulator) -> None:
    made = turns("vasilyuk-2019")
    assert [round(change) for _, _, change in made] == [90, 90, 90]
    assert all(end - start < 2.5 for start, end, _ in made)
    (first, last), *_ = Simulator("vasilyuk-2019", variant="outage").outages
    assert last - first == 20.0
    assert made[1][1] + 10.0 < first
    assert last < made[2][0]
    assert made[0][1] < 80.0 < made[1][0]  # point A


def test_the_pole_sways_and_turns_and_without_sway_stands_upright(walk: Simulator) -> None:
    rows = slice(10_000, 12_000)
    roll, pitch, heading = np.degrees(walk.trajectory.rpy[rows]).T
    assert (np.abs(roll).max(), np.abs(pitch).max()) == pytest.approx((2.0, 1.5), abs=0.01)
    assert 20.0 < np.ptp(np.unwrap(heading, period=360.0)) / 2.0 < 30.0
    assert not np.any(walk.trajectory.rpy[:1500, :2])
    still = Simulator("vasilyuk-2019", variant="no-sway").trajectory
    assert not np.any(still.rpy[:, :2])
    assert np.degrees(np.ptp(np.unwrap(still.rpy[rows, 2]))) < 1e-9
    assert np.array_equal(still.v_n, walk.trajectory.v_n)


def test_the_sensors_of_the_walk_have_the_stated_figures(walk: Simulator) -> None:
    imu, gnss = walk.scenario.imu, walk.scenario.gnss
    assert gnss is not None
    assert np.degrees(imu.gyro.density) == pytest.approx(np.full(3, 0.008))
    assert imu.accel.density == pytest.approx(np.full(3, 0.0034))
    assert imu.gyro.bandwidth_hz == imu.accel.bandwidth_hz == 40.0
    assert gnss.lever_ba_b_m == (0.03, 0.02, -0.10)  # z up and y left in the publication
    runs = [walk.run(seed) for seed in range(15)]
    blocks = [run.truth_blocks for run in runs]
    inside_4_sigma(np.array([run["gyro_bias"][0] for run in blocks]), np.radians(0.3), 45)
    inside_4_sigma(np.array([run["accel_bias"][0] for run in blocks]), 0.05, 45)
    inside_4_sigma(np.array([run["gyro_drift"][0] for run in blocks]), 4.848e-5, 45)
    inside_4_sigma(np.array([run["accel_drift"][0] for run in blocks]), 7.845e-4, 45)
    fixes = runs[0].dataset.gnss
    assert len(fixes) == 1600
    assert fixes.has_position.all()
    assert not fixes.has_velocity.any()
    assert fixes.sd[:, :3] == pytest.approx(np.full((1600, 3), 0.03))


# ---- airliner


@pytest.fixture(scope="module")
def flight() -> Simulator:
    return Simulator("novik-2011")


def test_the_flight_has_the_stated_aids(flight: Simulator) -> None:
    run = flight.run(1)
    gnss, baro = run.dataset.gnss, run.dataset.baro
    assert flight.trajectory.t_ns[-1] == 800_000_000_000
    assert (len(gnss), len(baro)) == (800, 800)
    assert gnss.new_constellation is not None
    assert gnss.t_ns[gnss.new_constellation].tolist() == [300_000_000_000, 600_000_000_000]
    plain = ~gnss.new_constellation
    assert gnss.sd[plain][0] == pytest.approx([2.0, 2.0, 2.5, 0.03, 0.03, 0.03])
    jumped = [np.hypot(2.0, 2.0), np.hypot(2.0, 2.0), np.hypot(2.5, 3.0), *[np.hypot(0.03, 0.05)] * 3]
    assert gnss.sd[~plain][0] == pytest.approx(jumped)
    gap = Simulator("novik-2011", variant="outage").run(1).dataset
    assert (len(gap.gnss), len(gap.baro)) == (700, 800)


def test_the_errors_of_the_flight_have_the_stated_figures(flight: Simulator) -> None:
    runs = [flight.run(seed) for seed in range(15)]
    blocks = [run.truth_blocks for run in runs]
    inside_4_sigma(np.array([run["gyro_bias"][0] for run in blocks]), 0.003 * GYRO_BIAS["deg/h"], 45)
    inside_4_sigma(np.array([run["accel_bias"][0] for run in blocks]), 25.0 * ACCEL_BIAS["ug"], 45)
    walked = np.array([run["accel_bias"][-1] - run["accel_bias"][0] for run in blocks])
    inside_4_sigma(walked, 5.0 * ACCEL_BIAS["ug"] * np.sqrt(800.0 / 3600.0), 45)
    position = np.array([run["gnss_position_error"][0] for run in blocks])
    inside_4_sigma(position / [6.0, 6.0, 8.5], 1.0, 45)
    inside_4_sigma(np.array([run["gnss_velocity_error"][0] for run in blocks]), 0.05, 45)
    bias = np.array([run["baro_bias"][:, 0] for run in blocks])
    inside_4_sigma(bias[:, 0], 4.0, 15)
    inside_4_sigma(bias[:, -1] - bias[:, 0], 0.035 * np.sqrt(800.0), 15)
    start = np.array([run.initial_error for run in runs])
    inside_4_sigma(start[:, :3], 1e-3, 45)
    inside_4_sigma(start[:, 3:6], 0.3, 45)
    inside_4_sigma(start[:, 6:], 10.0, 45)
    assert np.degrees(flight.scenario.imu.gyro.density[0]) * 60.0 == pytest.approx(0.002)
    assert flight.scenario.imu.accel.density[0] * 60.0 == pytest.approx(0.0059, abs=5e-5)


def test_scale_factors_and_coarse_sensors_are_variants_of_the_flight(flight: Simulator) -> None:
    plain = flight.run(3)
    scaled = Simulator("novik-2011", variant="scale-factors").run(3)
    assert np.array_equal(plain.truth_blocks["gyro_bias"], scaled.truth_blocks["gyro_bias"])
    assert np.abs(scaled.truth_blocks["accel_scale"]).max() < 4e-4
    assert np.array_equal(plain.dataset.gnss.lla, scaled.dataset.gnss.lla)
    coarse = Simulator("novik-2011", variant="coarse").run(3)
    ratio = coarse.truth_blocks["gyro_bias"][0] / plain.truth_blocks["gyro_bias"][0]
    assert ratio == pytest.approx(np.full(3, 1.0 / 0.003))


# ---- files


@pytest.mark.parametrize("name", ["al-bitar-gavrilov-2019", "novik-2011", "vasilyuk-2019"])
def test_the_filter_is_the_preset_of_the_publication(name: str) -> None:
    scenario = load_scenario(name)
    assert matching_filter(scenario)["preset"] == name
    for variant in set(scenario.variant) & {"outage", "gaps", "no-sway", "dual-antenna"}:
        assert matching_filter(scenario.with_variant(variant))["preset"] == name


@pytest.mark.parametrize("name", ["al-bitar-gavrilov-2019", "novik-2011"])
def test_the_errors_have_the_names_of_the_blocks_of_the_preset(name: str) -> None:
    preset = {block["name"] for block in load_preset(name)["blocks"]}
    assert set(Simulator(name, truth_rate_hz=1.0).run(1).truth_blocks) == preset


def test_the_figures_of_the_preset_are_those_of_the_scenario(flight: Simulator) -> None:
    # what the filter of an unnamed scenario with the same errors would have
    own = flight.scenario.model_copy(
        update={"scenario": flight.scenario.scenario.model_copy(update={"name": "my-flight"})}
    )
    tables = {"imu": {"gyro": {"arw_deg_sqrt_h": 1.0}, "accel": {"vrw_m_s_sqrt_h": 1.0}}}
    made = Config.from_dict(tables | {"filter": matching_filter(own)}).engine_config()["blocks"]
    packaged = Config.from_dict({"filter": matching_filter(flight.scenario)}).engine_config()["blocks"]
    for key in ("initial_sd", "psd", "sd", "tau_s", "distance_m", "jump_sd"):
        for mine, preset in zip(made, packaged, strict=True):
            if mine.get(key) is not None:
                assert mine[key] == pytest.approx(preset[key], rel=1e-6), (mine["name"], key)


def test_a_variant_with_other_errors_has_a_filter_with_a_block_for_each() -> None:
    run = Simulator("novik-2011", variant="scale-factors").run(1)
    section = matching_filter(run.scenario)
    blocks = {block["kind"]: block for block in section["block"]}
    assert "preset" not in section
    assert set(blocks) == set(run.truth_blocks)
    position = blocks["gnss_position_error"]
    assert position["distance_m"] == 250_000.0
    assert position["jump_sd"] == [3.0, 3.0, 5.0]
    assert "distance_m" not in blocks["gnss_velocity_error"]
    assert blocks["baro_bias"] == {
        "kind": "baro_bias",
        "process": "random_walk",
        "unit": "m",
        "initial_sd": 4.0,
        "walk": 0.035,
    }
    config = Config.from_dict(scenario_config(run))
    assert config.engine_config()["imu"]["accel_psd"][0] == pytest.approx((10e-6 * 9.80665) ** 2)


def test_a_run_with_aids_comes_back_from_its_files(tmp_path: Path) -> None:
    tables = load_scenario("novik-2011").model_dump(mode="json", exclude_none=True)
    tables["scenario"]["duration_s"] = 310.0
    tables["heading"] = {"rate_hz": 1.0, "heading_sd_deg": 0.2, "latency_ms": 30.0}
    tables["variant"] = {}
    scenario = scenario_from_dict(tables)
    run = Simulator(scenario, truth_rate_hz=1.0).run(2)
    files = write_simulation(run, tmp_path)
    assert sorted(files) == sorted(str(path) for path in output_files(scenario, tmp_path))
    back = read_dataset(Config.load(files[-1]))
    assert np.array_equal(back.baro.t_ns, run.dataset.baro.t_ns)
    assert back.baro.height_m == pytest.approx(run.dataset.baro.height_m, rel=1e-14)
    assert back.baro.var == pytest.approx(run.dataset.baro.var)
    assert back.heading.heading_rad == pytest.approx(run.dataset.heading.heading_rad, rel=1e-12)
    assert back.gnss.new_constellation is not None
    assert np.array_equal(back.gnss.new_constellation, run.dataset.gnss.new_constellation)
    config = Config.load(files[-1])
    assert config.heading.latency_ms == 30.0
