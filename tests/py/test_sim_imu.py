"""Simulated inertial sensors: every error against its closed form, every random number from one seed."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gnssins.sim import Simulated, Simulator, scenario_from_dict
from gnssins.sim.processes import constant, gauss_markov, random_walk
from gnssins.sim.streams import Streams
from gnssins.units import ACCEL_BIAS, GYRO_BIAS

Array = NDArray[np.float64]

BASE: dict[str, Any] = {
    "scenario": {"name": "test", "duration_s": 100.0, "rate_hz": 100.0},
    "start": {"lat_deg": 45.0, "lon_deg": 10.0, "height_m": 500.0, "heading_deg": 30.0, "speed_m_s": 40.0},
    "turn": [{"start_s": 10.0, "length_s": 30.0, "rate_deg_s": 10.0}],
    "slope": [{"from_s": 20.0, "to_s": 60.0, "angle_deg": 8.0}],
    "initial_error": {"attitude_sd_deg": 1.0, "velocity_sd_m_s": 0.1, "position_sd_m": 1.0},
}


def simulator(imu: dict[str, Any] | None = None, **changes: Any) -> Simulator:
    tables = copy.deepcopy(BASE) | changes
    if imu is not None:
        tables["imu"] = imu
    return Simulator(scenario_from_dict(tables))


def errors_of(source: Simulator, run: Simulated) -> tuple[Array, Array]:
    """Measured minus true increments of gyros and accelerometers."""
    path = source.trajectory
    return run.dataset.imu.gyro - path.dtheta[1:], run.dataset.imu.accel - path.dvel[1:]


def pooled(process: Any, runs: int) -> Array:
    """Histories of many seeds side by side, shape (samples, components of all runs)."""
    return np.concatenate([process(np.random.default_rng([7, seed])) for seed in range(runs)], axis=1)


def test_a_perfect_imu_puts_out_the_truth() -> None:
    source = simulator()
    run = source.run(1)
    imu = run.dataset.imu
    assert imu.kind == "increments"
    assert np.array_equal(imu.t_ns, source.trajectory.t_ns[1:])
    assert all(not np.any(error) for error in errors_of(source, run))
    assert run.truth_blocks == {}


def test_fixed_biases_scale_factors_and_misalignments_act_as_the_filter_models_them() -> None:
    cross = [1.0, -2.0, 3.0, 0.5, -1.5, 2.5]
    errors = [
        {"kind": "gyro_bias", "unit": "deg/h", "value": [10.0, -20.0, 30.0]},
        {"kind": "accel_bias", "unit": "mg", "value": [1.0, 2.0, -3.0]},
        {"kind": "gyro_scale", "unit": "ppm", "value": [100.0, 200.0, -300.0]},
        {"kind": "accel_scale", "unit": "ppm", "value": 500.0},
        {"kind": "gyro_misalignment", "unit": "mrad", "value": cross},
        {"kind": "accel_misalignment", "unit": "mrad", "value": cross},
    ]
    source = simulator({"error": errors})
    run, path = source.run(1), source.trajectory
    m = np.array([[0.0, 1.0, -2.0], [3.0, 0.0, 0.5], [-1.5, 2.5, 0.0]]) * 1e-3
    s_gyro, s_accel = np.diag([1e-4, 2e-4, -3e-4]), np.diag([5e-4] * 3)
    b_gyro = np.array([10.0, -20.0, 30.0]) * GYRO_BIAS["deg/h"]
    b_accel = np.array([1.0, 2.0, -3.0]) * ACCEL_BIAS["mg"]
    gyro = path.dtheta[1:] @ (np.eye(3) + s_gyro + m).T + b_gyro * 0.01
    accel = path.dvel[1:] @ (np.eye(3) + s_accel + m).T + b_accel * 0.01
    assert run.dataset.imu.gyro == pytest.approx(gyro, rel=1e-12, abs=1e-16)
    assert run.dataset.imu.accel == pytest.approx(accel, rel=1e-12, abs=1e-16)
    assert list(run.truth_blocks) == [error["kind"] for error in errors]
    assert run.truth_blocks["accel_misalignment"].shape == (len(path), 6)
    assert np.array_equal(run.truth_blocks["gyro_bias"][4321], b_gyro)


def test_a_drifting_bias_enters_with_its_mean_over_the_interval() -> None:
    drift = {"kind": "gyro_bias", "process": "random_walk", "unit": "deg/h", "walk": 5.0, "initial_sd": 2.0}
    source = simulator({"error": [drift]})
    run = source.run(3)
    history = run.truth_blocks["gyro_bias"]
    gyro, accel = errors_of(source, run)
    assert gyro == pytest.approx(0.005 * (history[1:] + history[:-1]), abs=1e-17)
    assert not np.any(accel)


def test_several_errors_of_one_kind_add_up() -> None:
    errors = [
        {"kind": "accel_bias", "name": "turn_on", "unit": "mg", "value": 3.0},
        {"kind": "accel_bias", "name": "thermal", "unit": "ug", "value": 50.0},
    ]
    source = simulator({"error": errors})
    _, accel = errors_of(source, source.run(1))
    assert accel == pytest.approx(np.full_like(accel, 3.05e-3 * 9.80665 * 0.01), rel=1e-9)


def test_white_noise_has_the_allan_deviation_of_its_random_walk() -> None:
    # sigma(tau) = N / sqrt(tau), IEEE Std 952. K clusters that do not overlap: relative sd about 1/sqrt(K).
    source = simulator(
        {"gyro": {"arw_deg_sqrt_h": [0.1, 0.2, 0.4]}, "accel": {"vrw_m_s_sqrt_h": 0.05}}, turn=[], slope=[]
    )
    densities = (np.radians([0.1, 0.2, 0.4]) / 60.0, np.full(3, 0.05) / 60.0)
    runs = [errors_of(source, source.run(seed)) for seed in range(10)]
    for triad, density in enumerate(densities):
        for cluster in (1, 10, 100):
            tau_s = 0.01 * cluster
            variances = []
            for run in runs:
                means = run[triad].reshape(-1, cluster, 3).sum(axis=1) / tau_s
                variances.append(0.5 * np.mean(np.diff(means, axis=0) ** 2, axis=0))
            clusters = 10 * (10_000 // cluster)
            allan = np.sqrt(np.mean(variances, axis=0))
            assert allan == pytest.approx(density / np.sqrt(tau_s), rel=4.0 / np.sqrt(clusters))


def test_gauss_markov_is_stationary_from_the_first_sample_on() -> None:
    # 1200 components; relative sd of a variance 1/sqrt(600) = 4 %, bound 4 sigma.
    sd, tau_s = np.array([2.0, 0.5, 1.0]), 20.0
    x = pooled(lambda rng: gauss_markov(rng, 400, 0.5, sd, tau_s), 400) / np.tile(sd, 400)
    assert np.var(x[[0, 1, 40, 399]], axis=1) == pytest.approx(np.ones(4), abs=0.17)
    assert np.mean(x[[0, 40, 399]], axis=1) == pytest.approx(np.zeros(3), abs=4.0 / np.sqrt(1200))


@pytest.mark.parametrize("lag_in_tau", [0.5, 1.0, 2.0])
def test_gauss_markov_has_the_correlation_of_its_time_constant(lag_in_tau: float) -> None:
    # 50 correlation times in each of 300 components: sd of the estimate below 1.1 %, bound 4 sigma.
    tau_s, dt_s = 10.0, 0.5
    x = pooled(lambda rng: gauss_markov(rng, 1000, dt_s, np.ones(3), tau_s), 100)
    lag = round(lag_in_tau * tau_s / dt_s)
    assert np.mean(x[lag:] * x[:-lag]) == pytest.approx(np.exp(-lag_in_tau), abs=0.045)


def test_gauss_markov_does_not_depend_on_how_finely_it_is_sampled() -> None:
    fine = pooled(lambda rng: gauss_markov(rng, 401, 0.05, np.ones(3), 5.0), 300)
    coarse = pooled(lambda rng: gauss_markov(rng, 3, 10.0, np.ones(3), 5.0), 300)
    expected = np.exp(-2.0)
    assert np.mean(fine[0] * fine[200]) == pytest.approx(expected, abs=4.0 / np.sqrt(900))
    assert np.mean(coarse[0] * coarse[1]) == pytest.approx(expected, abs=4.0 / np.sqrt(900))
    assert np.var(coarse[2]) == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / 900))


def test_random_walk_grows_as_it_should() -> None:
    walk, start = np.array([0.3, 0.6, 1.2]), np.array([1.0, 2.0, 0.0])
    x = pooled(lambda rng: random_walk(rng, 101, 0.25, walk, start), 500)
    for row, t_s in ((0, 0.0), (40, 10.0), (100, 25.0)):
        expected = start**2 + walk**2 * t_s
        found = x[row].reshape(500, 3).var(axis=0)
        assert found == pytest.approx(expected, rel=4.0 * np.sqrt(2.0 / 500), abs=1e-15)


def test_a_constant_is_drawn_once_per_run() -> None:
    x = pooled(lambda rng: constant(rng, 5, np.array([1.0, 10.0, 0.0])), 500)
    assert np.ptp(x, axis=0) == pytest.approx(0.0, abs=0.0)
    found = x[0].reshape(500, 3).std(axis=0)
    assert found == pytest.approx([1.0, 10.0, 0.0], rel=4.0 / np.sqrt(1000))


def test_histories_of_a_run_have_the_stated_deviation_and_correlation() -> None:
    error = {"kind": "accel_bias", "process": "gauss_markov", "unit": "ug", "sd": 50.0, "tau_s": 2.0}
    source = simulator({"error": [error]})
    x = np.concatenate([source.run(seed).truth_blocks["accel_bias"] for seed in range(20)], axis=1)
    x = x / (50.0 * ACCEL_BIAS["ug"])
    assert np.var(x) == pytest.approx(1.0, abs=0.12)  # 60 components of 50 tau: sd 2.6 %
    assert np.mean(x[200:] * x[:-200]) == pytest.approx(np.exp(-1.0), abs=0.1)


def test_quantisation_never_builds_up() -> None:
    lsb_rad, lsb_m_s = np.radians(2.0 / 3600.0), 5e-3
    source = simulator({"gyro": {"increment_lsb_arcsec": 2.0}, "accel": {"increment_lsb_mm_s": 5.0}})
    run = source.run(1)
    for error, lsb, measured in zip(
        errors_of(source, run), (lsb_rad, lsb_m_s), (run.dataset.imu.gyro, run.dataset.imu.accel), strict=True
    ):
        assert np.abs(np.cumsum(error, axis=0)).max() <= 0.5 * lsb * (1.0 + 1e-6)
        counts = measured / lsb
        assert counts == pytest.approx(np.rint(counts), abs=1e-4)
        assert np.abs(error).max() > 0.4 * lsb


def test_a_range_clips_the_rate_and_nothing_below_it() -> None:
    source = simulator({"gyro": {"range_deg_s": 5.0}, "accel": {"range_g": 1.1}})
    run = source.run(1)
    true, measured = (
        np.degrees(source.trajectory.dtheta[1:]) * 100.0,
        np.degrees(run.dataset.imu.gyro) * 100.0,
    )
    assert np.abs(true).max() > 5.5
    assert np.abs(measured).max() == pytest.approx(5.0, rel=1e-12)
    inside = np.abs(true) < 5.0
    assert np.array_equal(measured[inside], true[inside])
    assert np.abs(run.dataset.imu.accel).max() * 100.0 == pytest.approx(1.1 * 9.80665, rel=1e-12)


NOISY: dict[str, Any] = {
    "gyro": {"arw_deg_sqrt_h": 0.1},
    "accel": {"vrw_m_s_sqrt_h": 0.05},
    "error": [
        {"kind": "gyro_bias", "unit": "deg/h", "initial_sd": 10.0},
        {"kind": "accel_bias", "process": "gauss_markov", "unit": "mg", "sd": 1.0, "tau_s": 100.0},
    ],
}
GNSS = {"rate_hz": 1.0, "position_sd_m": 1.0, "velocity_sd_m_s": 0.1}


def everything(run: Simulated) -> list[bytes]:
    """All arrays of a run as bytes."""
    data, start = run.dataset, run.initial
    arrays = [data.imu.gyro, data.imu.accel, data.gnss.lla, data.gnss.v_n, start.lla, start.v_n, start.q_nb]
    return [array.tobytes() for array in (*arrays, *run.truth_blocks.values())]


def test_the_same_seed_gives_the_same_bytes() -> None:
    again = simulator(NOISY, gnss=GNSS)
    source = simulator(NOISY, gnss=GNSS)
    source.run(5)
    assert everything(source.run(4)) == everything(again.run(4))


def test_another_seed_changes_every_random_quantity() -> None:
    source = simulator(NOISY, gnss=GNSS)
    assert all(
        one != two for one, two in zip(everything(source.run(4)), everything(source.run(5)), strict=True)
    )


def test_another_source_of_error_leaves_all_others_as_they_are() -> None:
    scale = {"kind": "gyro_scale", "unit": "ppm", "initial_sd": 100.0}
    more = NOISY | {"error": [scale, *NOISY["error"]]}
    few, many = simulator(NOISY, gnss=GNSS).run(9), simulator(more, gnss=GNSS).run(9)
    for name in ("gyro_bias", "accel_bias"):
        assert np.array_equal(few.truth_blocks[name], many.truth_blocks[name])
    assert np.array_equal(few.dataset.imu.accel, many.dataset.imu.accel)
    assert np.array_equal(few.dataset.gnss.lla, many.dataset.gnss.lla)
    assert np.array_equal(few.initial_error, many.initial_error)
    assert not np.array_equal(few.dataset.imu.gyro, many.dataset.imu.gyro)


def test_streams_of_different_names_and_seeds_are_uncorrelated() -> None:
    draws = [
        Streams(seed)(name).standard_normal(10_000)
        for seed in (0, 1, 2)
        for name in ("imu.gyro", "imu.accel", "gnss.position")
    ]
    correlation = np.corrcoef(draws) - np.eye(len(draws))
    assert np.abs(correlation).max() < 4.5 / np.sqrt(10_000)


def test_a_slower_truth_table_has_the_same_rows() -> None:
    scenario = scenario_from_dict(copy.deepcopy(BASE) | {"imu": NOISY})
    full, thin = Simulator(scenario).run(2), Simulator(scenario, truth_rate_hz=1.0).run(2)
    assert thin.dataset.truth is not None
    assert full.dataset.truth is not None
    assert len(thin.dataset.truth) == 101
    assert np.array_equal(thin.dataset.truth.lla, full.dataset.truth.lla[::100])
    assert np.array_equal(thin.truth_blocks["accel_bias"], full.truth_blocks["accel_bias"][::100])
