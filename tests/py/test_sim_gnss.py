"""Simulated receiver and initial state: geometry of the antenna, times, noise, correlated errors, outages."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from gnssins import _core
from gnssins.sim import Simulated, Simulator, Trajectory, build_trajectory, relocate, scenario_from_dict
from gnssins.sim.aiding import antenna_motion
from gnssins.sim.frames import c_en

Array = NDArray[np.float64]

BASE: dict[str, Any] = {
    "scenario": {"name": "test", "duration_s": 60.0, "rate_hz": 100.0, "vehicle": "car"},
    "start": {"lat_deg": 45.0, "lon_deg": 10.0, "height_m": 500.0, "heading_deg": 30.0, "speed_m_s": 20.0},
    "turn": [{"start_s": 10.0, "length_s": 30.0, "rate_deg_s": 20.0}],
    "sway": [{"axis": "pitch", "amplitude_deg": 5.0, "period_s": 3.0}],
    "gnss": {"rate_hz": 1.0, "position_sd_m": [1.0, 2.0, 4.0], "velocity_sd_m_s": [0.05, 0.1, 0.2]},
    "initial_error": {
        "attitude_sd_arcmin": [1.0, 2.0, 30.0],
        "velocity_sd_m_s": [0.1, 0.2, 0.3],
        "position_sd_m": [1.0, 2.0, 3.0],
    },
}
LEVER = np.array([1.0, -0.5, -2.0])


def simulator(gnss: dict[str, Any] | None = None, **changes: Any) -> Simulator:
    tables = copy.deepcopy(BASE) | changes
    tables["gnss"] = tables["gnss"] | (gnss or {})
    return Simulator(scenario_from_dict({key: value for key, value in tables.items() if value is not None}))


@pytest.fixture(scope="module")
def path() -> Trajectory:
    return simulator().trajectory


def ecef(path: Trajectory, lla: Array) -> Array:
    return _core.lla_to_ecef(lla, path.ellipsoid)


def fix_errors(source: Simulator, run: Simulated) -> Array:
    """Fix minus true motion of the nominal antenna, north, east, down, (m, 6)."""
    gnss, scenario = run.dataset.gnss, source.scenario.gnss
    assert scenario is not None
    latency_ns = round(scenario.latency_ms * 1e6)
    lla, v_n = antenna_motion(source.trajectory, gnss.t_ns - latency_ns, np.asarray(scenario.lever_ba_b_m))
    radii = _core.radii(lla[:, 0], source.trajectory.ellipsoid) + lla[:, 2:]
    step = gnss.lla - lla
    position = [step[:, 0] * radii[:, 0], step[:, 1] * radii[:, 1] * np.cos(lla[:, 0]), -step[:, 2]]
    return np.column_stack([*position, gnss.v_n - v_n])


def test_without_lever_arm_the_antenna_is_the_imu(path: Trajectory) -> None:
    rows = np.arange(0, len(path), 100)
    lla, v_n = antenna_motion(path, path.t_ns[rows], np.zeros(3))
    assert ecef(path, lla) == pytest.approx(ecef(path, path.lla[rows]), abs=1e-8)
    assert v_n == pytest.approx(path.v_n[rows], abs=1e-11)


def test_the_lever_arm_turns_with_the_body(path: Trajectory) -> None:
    rows = np.arange(0, len(path), 50)
    lla, _ = antenna_motion(path, path.t_ns[rows], LEVER)
    arm_n = _core.quat_to_dcm(path.q_nb[rows]) @ LEVER
    arm_e = np.einsum("mij,mj->mi", c_en(path.lla[rows]), arm_n)
    assert ecef(path, lla) - ecef(path, path.lla[rows]) == pytest.approx(arm_e, abs=1e-8)


def test_the_velocity_of_the_antenna_is_the_derivative_of_its_position(path: Trajectory) -> None:
    lla, v_n = antenna_motion(path, path.t_ns, LEVER)
    velocity = np.gradient(ecef(path, lla), 0.01, axis=0)[1:-1]
    assert np.einsum("mij,mj->mi", c_en(lla[1:-1]), v_n[1:-1]) == pytest.approx(velocity, abs=2e-4)
    assert np.abs(v_n - path.v_n).max() > 0.2  # the term that this is about


def test_between_samples_the_truth_is_interpolated() -> None:
    tables = copy.deepcopy(BASE)
    tables["scenario"]["rate_hz"] = 1000.0
    fine = build_trajectory(scenario_from_dict(tables))
    coarse = simulator().trajectory
    t_ns = np.arange(5_000_000, 60_000_000_000, 137_000_000, dtype=np.int64)
    place, velocity = antenna_motion(coarse, t_ns, LEVER)
    fine_place, fine_velocity = antenna_motion(fine, t_ns, LEVER)
    assert ecef(coarse, place) == pytest.approx(ecef(fine, fine_place), abs=5e-4)
    assert velocity == pytest.approx(fine_velocity, abs=1e-3)
    linear = coarse.lla[:-1] + 0.5 * np.diff(coarse.lla, axis=0)
    middle, _ = antenna_motion(coarse, coarse.t_ns[:-1] + 5_000_000, np.zeros(3))
    sag = np.linalg.norm(ecef(coarse, middle) - ecef(coarse, linear), axis=1)
    assert sag.max() == pytest.approx(20.0 * np.radians(20.0) * 0.01**2 / 8.0, rel=0.02)


def test_stamps_are_validity_plus_latency() -> None:
    source = simulator({"rate_hz": 5.0, "latency_ms": 80.0})
    run = source.run(1)
    assert run.dataset.gnss.t_ns[0] == 280_000_000
    assert np.all(np.diff(run.dataset.gnss.t_ns) == 200_000_000)
    assert len(run.dataset.gnss) == 300
    assert np.abs(fix_errors(source, run)[:, :2]).max() < 10.0  # at 20 m/s a wrong epoch shows in the turn


def test_fixes_may_lie_between_imu_samples() -> None:
    source = simulator({"rate_hz": 3.0, "first_s": 0.005, "position_sd_m": 1e-6, "velocity_sd_m_s": 1e-6})
    run = source.run(1)
    assert run.dataset.gnss.t_ns[:3].tolist() == [5_000_000, 338_333_333, 671_666_667]
    assert np.abs(fix_errors(source, run)).max() < 1e-5


def test_outages_are_half_open_and_leave_the_other_fixes_alone() -> None:
    open_sky = simulator().run(3).dataset.gnss
    town = simulator({"outages": [[10.0, 20.0], [30.0, 31.0]]}).run(3).dataset.gnss
    seen = town.t_ns // 1_000_000_000
    assert seen.tolist() == [*range(1, 10), *range(20, 30), *range(31, 61)]
    kept = np.isin(open_sky.t_ns, town.t_ns)
    assert np.array_equal(open_sky.lla[kept], town.lla)
    assert np.array_equal(open_sky.v_n[kept], town.v_n)


def test_outages_count_at_the_time_of_validity() -> None:
    source = simulator({"latency_ms": 500.0, "outages": [[10.0, 20.0]]})
    run = source.run(3)
    at = run.dataset.gnss.t_ns
    assert 9_500_000_000 in at
    assert 10_500_000_000 not in at
    assert 20_500_000_000 in at


def test_white_noise_and_variances_are_those_of_the_scenario() -> None:
    # 3600 fixes: relative sd of a variance 2.4 %, of a correlation 1.7 %; bounds 4 sigma.
    source = simulator()
    runs = [source.run(seed) for seed in range(60)]
    sd = np.array([1.0, 2.0, 4.0, 0.05, 0.1, 0.2])
    assert runs[0].dataset.gnss.var == pytest.approx(np.tile(sd**2, (60, 1)))
    noise = np.stack([fix_errors(source, run) for run in runs]) / sd
    assert np.var(noise, axis=(0, 1)) == pytest.approx(np.ones(6), abs=0.1)
    assert np.mean(noise, axis=(0, 1)) == pytest.approx(np.zeros(6), abs=0.07)
    assert np.mean(noise[:, 1:] * noise[:, :-1], axis=(0, 1)) == pytest.approx(np.zeros(6), abs=0.07)
    correlation = np.corrcoef(noise.reshape(-1, 6).T) - np.eye(6)
    assert np.abs(correlation).max() < 0.07


def test_correlated_errors_are_in_the_fixes_and_in_the_truth() -> None:
    small = {"position_sd_m": 1e-4, "velocity_sd_m_s": 1e-6}
    source = simulator(
        small
        | {
            "position_error": {"sd_m": [3.0, 3.0, 5.0], "tau_s": 20.0},
            "velocity_error": {"sd_m_s": [0.1, 0.1, 0.2], "tau_s": 5.0},
        }
    )
    run = source.run(2)
    found = fix_errors(source, run)
    assert found[:, :3] == pytest.approx(run.truth_blocks["gnss_position_error"][100::100], abs=2e-3)
    assert found[:, 3:] == pytest.approx(run.truth_blocks["gnss_velocity_error"][100::100], abs=1e-5)
    assert run.dataset.gnss.var[0, 0] == pytest.approx(1e-8)
    x = np.concatenate(
        [source.run(seed).truth_blocks["gnss_position_error"][::100, :2] for seed in range(150)], axis=1
    )
    assert np.var(x) == pytest.approx(9.0, rel=0.25)  # 300 components of 3 tau
    assert np.mean(x[20:] * x[:-20]) / np.var(x) == pytest.approx(np.exp(-1.0), abs=0.13)


def test_the_true_lever_arm_differs_by_what_the_truth_says() -> None:
    source = simulator(
        {
            "position_sd_m": 1e-6,
            "velocity_sd_m_s": 1e-6,
            "lever_ba_b_m": [1.0, 0.0, -1.0],
            "lever_error_sd_m": [0.1, 0.2, 0.3],
        }
    )
    run = source.run(5)
    error = run.truth_blocks["gnss_lever_arm"][0]
    assert np.all(error != 0.0)
    rows = np.arange(100, 6001, 100)
    arm = _core.quat_to_dcm(source.trajectory.q_nb[rows]) @ error
    assert fix_errors(source, run)[:, :3] == pytest.approx(arm, abs=1e-5)
    drawn = np.array([source.run(seed).truth_blocks["gnss_lever_arm"][0] for seed in range(200)])
    assert drawn.std(axis=0) == pytest.approx([0.1, 0.2, 0.3], rel=0.2)


def test_a_receiver_may_give_position_or_velocity_alone() -> None:
    tables = copy.deepcopy(BASE)
    del tables["gnss"]["velocity_sd_m_s"]
    fixes = Simulator(scenario_from_dict(tables)).run(1).dataset.gnss
    assert np.isfinite(fixes.lla).all()
    assert np.isnan(fixes.v_n).all()
    tables["gnss"] = {"rate_hz": 1.0, "velocity_sd_m_s": 0.1}
    fixes = Simulator(scenario_from_dict(tables)).run(1).dataset.gnss
    assert np.isnan(fixes.lla).all()
    assert np.isfinite(fixes.v_n).all()


def test_without_a_receiver_there_are_no_fixes() -> None:
    tables = copy.deepcopy(BASE)
    del tables["gnss"]
    run = Simulator(scenario_from_dict(tables)).run(1)
    assert len(run.dataset.gnss) == 0
    assert run.truth_blocks == {}


def test_initial_errors_have_the_stated_deviations() -> None:
    # Sum of 9 squared normals in 400 runs: chi-square with 3600 degrees of freedom, two-sided 0.1 %.
    source = simulator()
    runs = [source.run(seed) for seed in range(400)]
    start = runs[0].initial
    sd = np.concatenate([start.sd_phi, start.sd_v, start.sd_p])
    arcmin = np.pi / 10_800.0
    assert sd == pytest.approx([arcmin, 2 * arcmin, 30 * arcmin, 0.1, 0.2, 0.3, 1.0, 2.0, 3.0])
    scaled = np.array([run.initial_error for run in runs]) / sd
    assert chi2.ppf(0.0005, 3600) < np.sum(scaled**2) < chi2.ppf(0.9995, 3600)
    assert np.var(scaled, axis=0) == pytest.approx(np.ones(9), abs=4.0 * np.sqrt(2.0 / 400))
    assert np.abs(np.corrcoef(scaled.T) - np.eye(9)).max() < 4.5 / np.sqrt(400)


def test_the_initial_state_is_truth_plus_error_in_the_conventions_of_the_filter() -> None:
    source = simulator()
    path = source.trajectory
    for seed in range(20):
        run = source.run(seed)
        start, (phi, dv, dp) = run.initial, np.split(run.initial_error, 3)
        c_true, c_est = _core.quat_to_dcm(np.array([path.q_nb[0], start.q_nb]))
        turn = _core.quat_to_dcm(_core.rotvec_to_quat(phi[np.newaxis]))[0]
        assert turn @ c_est == pytest.approx(c_true, abs=1e-14)
        assert start.v_n - path.v_n[0] == pytest.approx(dv, abs=1e-14)
        moved = ecef(path, start.lla[np.newaxis]) - ecef(path, path.lla[:1])
        assert c_en(path.lla[:1])[0].T @ moved[0] == pytest.approx(dp, abs=1e-5)
        assert start.t_ns == 0
        assert start.to_engine()["lat_rad"] == start.lla[0]


def test_next_to_the_pole_the_attitude_error_counts_against_the_earth() -> None:
    tables = copy.deepcopy(BASE)
    tables["start"]["speed_m_s"] = 0.0
    del tables["turn"]
    polar = relocate(scenario_from_dict(tables), 89.999, 10.0, model="ecef")
    run = Simulator(polar).run(4)
    assert run.dataset.truth is not None
    assert run.dataset.truth.q_nb is not None
    true, start = run.dataset.truth, run.initial
    c_eb_true = c_en(true.lla[:1])[0] @ _core.quat_to_dcm(true.q_nb[:1])[0]
    c_eb_est = c_en(start.lla[np.newaxis])[0] @ _core.quat_to_dcm(start.q_nb[np.newaxis])[0]
    turn = _core.quat_to_dcm(_core.rotvec_to_quat(run.initial_error[np.newaxis, :3]))[0]
    axes = c_en(true.lla[:1])[0]
    assert axes @ turn @ axes.T @ c_eb_est == pytest.approx(c_eb_true, abs=1e-12)
