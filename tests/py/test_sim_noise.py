"""Band-limited noise against its closed forms, and densities told apart by their convention."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gnssins.config import Config
from gnssins.errors import ConfigError
from gnssins.sim import Simulator, scenario_from_dict
from gnssins.sim.processes import low_pass
from gnssins.simfiles import scenario_config

Array = NDArray[np.float64]

#: One-sided density (rad/s)^2/Hz, corner and interval of the published gyro: sqrt(N) = sqrt(2) 0.008 deg/s/sqrt(Hz).
N = 2.0 * np.radians(0.008) ** 2
CORNER_HZ, T_S = 40.0, 0.01
K = 2.0 * np.pi * CORNER_HZ
SD = np.sqrt(N / 2.0)

BASE: dict[str, Any] = {
    "scenario": {"name": "test", "duration_s": 100.0, "rate_hz": 100.0},
    "start": {"lat_deg": 45.0, "lon_deg": 10.0, "heading_deg": 30.0},
    "initial_error": {"attitude_sd_deg": 1.0, "velocity_sd_m_s": 0.1, "position_sd_m": 1.0},
}


def q1(t_s: float) -> float:
    """Variance of the integral over one interval: Vasilyuk (2019), Q1."""
    return 0.5 * N * (t_s + (np.exp(-K * t_s) - 1.0) / K)


def q2(lag: int, t_s: float = T_S) -> float:
    """Covariance of the integrals over two intervals ``lag`` apart: Vasilyuk (2019), Q2, with the right indices."""
    return 0.25 * N / K * np.exp(-K * (lag - 1) * t_s) * (1.0 - np.exp(-K * t_s)) ** 2


@pytest.fixture(scope="module")
def drawn() -> tuple[Array, Array]:
    """A thousand seconds on 12 axes: (100001, 12) values and (100000, 12) integrals."""
    return low_pass(np.random.default_rng(11), 100_000, T_S, np.full(12, SD), CORNER_HZ)


def test_the_closed_forms_have_the_published_numbers() -> None:
    two_sided = N / 2.0
    assert two_sided == pytest.approx(1.950e-8, rel=5e-4)
    assert q1(0.1) == pytest.approx(1.872e-9, rel=5e-4)
    assert np.degrees(np.sqrt(N * K / 4.0)) == pytest.approx(0.0897, abs=5e-5)


def test_values_have_the_variance_of_density_times_corner(drawn: tuple[Array, Array]) -> None:
    # 1.2e6 values, correlated over 0.4 of an interval: relative sd 0.14 %, bound 5 sigma
    assert np.var(drawn[0]) == pytest.approx(N * K / 4.0, rel=0.007)
    assert np.mean(drawn[0][1:] * drawn[0][:-1]) == pytest.approx(N * K / 4.0 * np.exp(-K * T_S), rel=0.09)


def test_integrals_over_one_interval_have_q1(drawn: tuple[Array, Array]) -> None:
    assert np.var(drawn[1]) == pytest.approx(q1(T_S), rel=0.007)


@pytest.mark.parametrize("lag", [1, 2, 3])
def test_integrals_over_two_intervals_have_q2(drawn: tuple[Array, Array], lag: int) -> None:
    # the sd of a covariance of 1.2e6 pairs is Q1/sqrt(1.2e6) = 0.0009 Q1, bound 5 sigma
    found = np.mean(drawn[1][lag:] * drawn[1][:-lag])
    assert found == pytest.approx(q2(lag), abs=0.0046 * q1(T_S))
    if lag == 1:
        assert q2(1) > 20.0 * 0.0046 * q1(T_S)


@pytest.mark.parametrize("intervals", [10, 1000])
def test_growth_over_many_intervals_is_q1_of_their_sum(drawn: tuple[Array, Array], intervals: int) -> None:
    # 0.1 s: 4 % short of white noise; 10 s: as good as white. 1.2e6/intervals sums, bound 4 sigma
    sums = drawn[1].reshape(-1, intervals, 12).sum(axis=1)
    bound = 4.0 * np.sqrt(2.0 / sums.size)
    assert np.var(sums) == pytest.approx(q1(intervals * T_S), rel=bound)
    assert q1(0.1) / (0.5 * N * 0.1) == pytest.approx(0.960, abs=0.001)
    assert q1(10.0) / (0.5 * N * 10.0) == pytest.approx(1.0, abs=5e-4)


def test_the_growth_in_ten_seconds_per_fix_interval_is_that_of_white_noise(
    drawn: tuple[Array, Array],
) -> None:
    # the published accelerometer: 1.117e-6 in one interval of 0.1 s, 1.161e-6 per interval over 10 s
    scale = 1.156e-5 / (N / 2.0)
    sums = drawn[1].reshape(-1, 1000, 12).sum(axis=1)
    assert np.var(sums) * scale / 100.0 == pytest.approx(1.156e-6, rel=4.0 * np.sqrt(2.0 / sums.size))
    tenths = drawn[1].reshape(-1, 10, 12).sum(axis=1)
    assert np.var(tenths) * scale == pytest.approx(1.110e-6, rel=4.0 * np.sqrt(2.0 / tenths.size))


def test_value_and_integral_belong_together(drawn: tuple[Array, Array]) -> None:
    # cov(w at the end, integral) = N/4 (1 - a), the same for w at the start: 1.2e6 pairs, bound 5 sigma
    expected = 0.25 * N * (1.0 - np.exp(-K * T_S))
    bound = 5.0 * np.sqrt(q1(T_S) * N * K / 4.0 / 1.2e6)
    assert np.mean(drawn[0][1:] * drawn[1]) == pytest.approx(expected, abs=bound)
    assert np.mean(drawn[0][:-1] * drawn[1]) == pytest.approx(expected, abs=bound)
    assert expected > 50.0 * bound


def test_noise_starts_in_its_stationary_state() -> None:
    # 3000 components: relative sd of a variance 2.6 %, bound 4 sigma
    first, integral = low_pass(np.random.default_rng(5), 1, T_S, np.full(3000, SD), CORNER_HZ)
    assert np.var(first[0]) == pytest.approx(N * K / 4.0, rel=0.105)
    assert np.var(integral[0]) == pytest.approx(q1(T_S), rel=0.105)


def test_a_very_high_corner_leaves_white_noise() -> None:
    # 40000 integrals: relative sd of a variance 0.7 %, bound 4 sigma
    _, integrals = low_pass(np.random.default_rng(6), 2000, T_S, np.full(20, SD), 1e5)
    assert np.var(integrals) == pytest.approx(0.5 * N * T_S, rel=0.028)


def test_a_very_low_corner_leaves_a_random_walk_and_its_integral() -> None:
    # between two values the integral leaves their mean by the bridge of a walk: 1/sqrt(12) of a step times T
    values, integrals = low_pass(np.random.default_rng(6), 2000, T_S, np.full(20, SD), 1e-3)
    step = values[1:] - values[:-1]
    bridge = integrals - 0.5 * (values[1:] + values[:-1]) * T_S
    assert bridge.std() / (step.std() * T_S) == pytest.approx(1.0 / np.sqrt(12.0), rel=0.03)
    lower = low_pass(np.random.default_rng(6), 100, T_S, np.full(3, SD), 1e-7)
    assert all(np.isfinite(part).all() for part in lower)


# ---- the scenario


def noise_of(imu: dict[str, Any], seed: int = 1) -> tuple[Array, Array]:
    """Measured minus true increments of gyros and accelerometers."""
    source = Simulator(scenario_from_dict(copy.deepcopy(BASE) | {"imu": imu}))
    run, path = source.run(seed), source.trajectory
    return run.dataset.imu.gyro - path.dtheta[1:], run.dataset.imu.accel - path.dvel[1:]


def test_a_scenario_has_the_noise_of_its_density_and_bandwidth() -> None:
    # 30000 increments per triad: relative sd 0.8 %, bound 5 sigma
    root_n = float(np.degrees(np.sqrt(N)))
    gyro, accel = noise_of(
        {
            "gyro": {
                "noise_density_deg_s_sqrt_hz": root_n,
                "noise_density_convention": "one-sided",
                "bandwidth_hz": CORNER_HZ,
            },
            "accel": {
                "noise_density_m_s2_sqrt_hz": 0.0034 * np.sqrt(2.0),
                "noise_density_convention": "one-sided",
                "bandwidth_hz": CORNER_HZ,
            },
        }
    )
    assert np.var(gyro) == pytest.approx(q1(T_S), rel=0.041)
    assert np.var(accel) == pytest.approx(q1(T_S) * 1.156e-5 / (N / 2.0), rel=0.041)
    assert np.mean(gyro[1:] * gyro[:-1]) == pytest.approx(q2(1), abs=5.0 * q1(T_S) / np.sqrt(3e4))


def test_the_same_noise_by_every_name_gives_the_same_bytes() -> None:
    walk = noise_of({"gyro": {"arw_deg_sqrt_h": 0.48}, "accel": {"vrw_m_s_sqrt_h": 0.204}})
    two = {"noise_density_deg_s_sqrt_hz": 0.008}, {"noise_density_m_s2_sqrt_hz": 0.0034}
    one = (
        {
            "noise_density_deg_s_sqrt_hz": 0.008 * np.sqrt(2.0),
            "noise_density_convention": "one-sided",
        },
        {
            "noise_density_ug_sqrt_hz": 0.0034 / 9.80665e-6 * np.sqrt(2.0),
            "noise_density_convention": "one-sided",
        },
    )
    for gyro, accel in (two, one):
        found = noise_of({"gyro": gyro, "accel": accel})
        for noise, reference in zip(found, walk, strict=True):
            assert noise == pytest.approx(reference, rel=1e-6, abs=1e-16)


@pytest.mark.parametrize(
    ("gyro", "text"),
    [
        ({"arw_deg_sqrt_h": 0.1, "noise_density_deg_s_sqrt_hz": 0.01}, "same noise given twice"),
        ({"arw_deg_sqrt_h": 0.1, "noise_density_convention": "one-sided"}, "a random walk has no sides"),
        (
            {"noise_density_deg_s_sqrt_hz": 0.1, "noise_density_convention": "both"},
            "noise_density_convention",
        ),
        ({"arw_deg_sqrt_h": 0.1, "bandwidth_hz": 0.0}, "bandwidth_hz"),
    ],
)
def test_noise_that_means_nothing_is_refused(gyro: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        scenario_from_dict(copy.deepcopy(BASE) | {"imu": {"gyro": gyro}})
    if "bandwidth_hz" not in gyro:
        tables = {"imu": {"gyro": gyro, "accel": {"vrw_m_s_sqrt_h": 0.1}}}
        with pytest.raises(ConfigError, match=text):
            Config.from_dict(tables)


# ---- the run configuration


def psd(gyro: dict[str, Any], accel: dict[str, Any]) -> tuple[float, float]:
    engine = Config.from_dict({"imu": {"gyro": gyro, "accel": accel}}).engine_config()
    return engine["imu"]["gyro_psd"][0], engine["imu"]["accel_psd"][0]


def test_a_one_sided_density_is_half_as_much_power() -> None:
    root = np.sqrt(2.0)
    one = {"noise_density_convention": "one-sided"}
    expected = (np.radians(0.008) ** 2, 0.0034**2)
    assert psd(
        {"noise_density_deg_s_sqrt_hz": 0.008}, {"noise_density_m_s2_sqrt_hz": 0.0034}
    ) == pytest.approx(expected)
    assert psd(
        {"noise_density_deg_s_sqrt_hz": 0.008 * root} | one,
        {"noise_density_m_s2_sqrt_hz": 0.0034 * root} | one,
    ) == pytest.approx(expected)
    assert psd(
        {"arw_deg_sqrt_h": 0.48}, {"noise_density_ug_sqrt_hz": 0.0034 / 9.80665e-6 * root} | one
    ) == pytest.approx(expected)


def test_the_filter_of_a_scenario_takes_the_white_equivalent() -> None:
    imu = {
        "gyro": {
            "noise_density_deg_s_sqrt_hz": 0.008 * np.sqrt(2.0),
            "noise_density_convention": "one-sided",
            "bandwidth_hz": 40.0,
        },
        "accel": {"noise_density_m_s2_sqrt_hz": 0.0034},
    }
    simulated = Simulator(scenario_from_dict(copy.deepcopy(BASE) | {"imu": imu})).run(1)
    tables = scenario_config(simulated)
    assert tables["imu"]["gyro"]["arw_deg_sqrt_h"] == pytest.approx([0.48] * 3)
    assert tables["imu"]["accel"]["vrw_m_s_sqrt_h"] == pytest.approx([0.204] * 3)
