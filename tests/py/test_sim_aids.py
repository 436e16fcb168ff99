"""Simulated barometer, heading and slow receiver errors: laws in time and space, jumps, outages, truth."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gnssins.errors import ConfigError
from gnssins.sim import Simulator, scenario_from_dict
from gnssins.sim.processes import gauss_markov_varying
from gnssins.sim.receiver_errors import change_rows

Array = NDArray[np.float64]
S = 1_000_000_000

BASE: dict[str, Any] = {
    "scenario": {"name": "test", "duration_s": 60.0, "rate_hz": 50.0, "vehicle": "car"},
    "start": {"lat_deg": 45.0, "lon_deg": 10.0, "height_m": 500.0, "heading_deg": 350.0, "speed_m_s": 20.0},
    "turn": [{"start_s": 10.0, "length_s": 30.0, "rate_deg_s": 1.0}],
    "slope": [{"from_s": 10.0, "to_s": 40.0, "angle_deg": 5.0}],
    "initial_error": {"attitude_sd_deg": 1.0, "velocity_sd_m_s": 0.1, "position_sd_m": 1.0},
}
SILENT = {"rate_hz": 1.0, "position_sd_m": 1e-6, "velocity_sd_m_s": 1e-8}


def simulator(**changes: Any) -> Simulator:
    return Simulator(scenario_from_dict(copy.deepcopy(BASE) | changes))


# ---- barometer


def test_the_barometer_reads_height_plus_bias_plus_noise() -> None:
    source = simulator(
        baro={
            "rate_hz": 10.0,
            "height_sd_m": 1e-9,
            "bias_initial_sd_m": 4.0,
            "bias_walk_m_sqrt_s": 0.035,
            "latency_ms": 40.0,
        }
    )
    run = source.run(1)
    baro, bias = run.dataset.baro, run.truth_blocks["baro_bias"]
    assert bias.shape == (len(source.trajectory), 1)
    valid = baro.t_ns - 40_000_000
    assert valid[0] == 100_000_000
    assert len(baro) == 600
    rows = valid // 20_000_000
    assert baro.height_m == pytest.approx(source.trajectory.lla[rows, 2] + bias[rows, 0], abs=1e-6)
    assert np.ptp(source.trajectory.lla[:, 2]) > 40.0


def test_the_bias_of_the_barometer_is_a_random_walk_whatever_the_rate() -> None:
    # 400 runs: relative sd of a variance 7 %, bound 4 sigma
    source = simulator(
        baro={"rate_hz": 0.5, "height_sd_m": 0.75, "bias_initial_sd_m": 4.0, "bias_walk_m_sqrt_s": 0.5}
    )
    bias = np.array([source.run(seed).truth_blocks["baro_bias"][:, 0] for seed in range(400)])
    for row, t_s in ((0, 0.0), (1500, 30.0), (3000, 60.0)):
        assert np.var(bias[:, row]) == pytest.approx(16.0 + 0.25 * t_s, rel=0.28)
    assert np.var(bias[:, 3000] - bias[:, 1500]) == pytest.approx(0.25 * 30.0, rel=0.28)


def test_the_white_noise_of_the_barometer_is_the_stated_one() -> None:
    # 6000 heights: relative sd of a variance 1.8 %, of a correlation 1.3 %; bounds 4 sigma
    source = simulator(baro={"rate_hz": 50.0, "height_sd_m": 0.75})
    errors = []
    for seed in range(2):
        run = source.run(seed)
        assert run.truth_blocks == {}
        assert run.dataset.baro.var == pytest.approx(np.full(3000, 0.5625))
        errors.append(run.dataset.baro.height_m - source.trajectory.lla[1:, 2])
    noise = np.array(errors) / 0.75
    assert np.var(noise) == pytest.approx(1.0, abs=0.073)
    assert np.mean(noise[:, 1:] * noise[:, :-1]) == pytest.approx(0.0, abs=0.052)


# ---- heading


def test_headings_are_those_of_the_body_and_are_lost_with_the_fixes() -> None:
    gnss = SILENT | {"outages": [[40.0, 50.0]]}
    source = simulator(gnss=gnss, heading={"rate_hz": 5.0, "heading_sd_deg": 1e-7, "latency_ms": 10.0})
    table = source.run(3).dataset.heading
    valid = table.t_ns - 10_000_000
    assert len(table) == 300 - 50
    assert not np.any((valid >= 40 * S) & (valid < 50 * S))
    true = source.trajectory.rpy[valid // 20_000_000, 2]
    assert np.angle(np.exp(1j * (table.heading_rad - true))) == pytest.approx(np.zeros(len(table)), abs=1e-8)
    assert np.all((table.heading_rad >= 0.0) & (table.heading_rad < 2.0 * np.pi))
    assert np.degrees(table.heading_rad.min()) < 5.0  # it passes north, and stays a heading
    assert np.degrees(table.heading_rad.max()) > 355.0


def test_the_noise_of_headings_is_the_stated_one_and_outages_leave_the_rest_alone() -> None:
    # 6000 headings: relative sd of a variance 1.8 %, bound 4 sigma
    figures = {"rate_hz": 10.0, "heading_sd_deg": 0.2}
    source = simulator(gnss=SILENT, heading=figures)
    rows = source.run(0).dataset.heading.t_ns // 20_000_000
    true = source.trajectory.rpy[rows, 2]
    tables = [source.run(seed).dataset.heading for seed in range(10)]
    noise = np.array([np.angle(np.exp(1j * (table.heading_rad - true))) for table in tables])
    assert np.degrees(noise.std()) == pytest.approx(0.2, rel=0.037)
    assert tables[0].var == pytest.approx(np.full(600, np.radians(0.2) ** 2))
    town = simulator(gnss=SILENT | {"outages": [[5.0, 50.0]]}, heading=figures).run(0).dataset.heading
    kept = np.isin(tables[0].t_ns, town.t_ns)
    assert np.array_equal(tables[0].heading_rad[kept], town.heading_rad)


# ---- slow errors of the receiver


def test_a_varying_rate_keeps_the_variance_and_correlates_by_its_integral() -> None:
    # 1500 components; relative sd of a variance 3.7 %, of a correlation at most 2.6 %; bounds 4 sigma
    growth = np.linspace(0.0, 0.05, 200)
    growth[100] = 40.0  # a step that forgets everything must not overflow
    sd = np.array([2.0, 0.5, 1.0])
    runs = [gauss_markov_varying(np.random.default_rng([3, seed]), growth, sd) / sd for seed in range(500)]
    x = np.concatenate(runs, axis=1)
    assert np.var(x[[0, 50, 100, 101, 200]], axis=1) == pytest.approx(np.ones(5), abs=0.15)
    for first, last in ((0, 100), (40, 60), (101, 120), (90, 110)):
        expected = np.exp(-growth[first:last].sum())
        assert np.mean(x[first] * x[last]) == pytest.approx(expected, abs=0.105)


def test_slow_errors_fade_over_the_distance_travelled() -> None:
    # At 20 m/s and 400 m they fade as if tau were 20 s; at rest they stay. 450 components, bounds 4 sigma.
    figures = {"position_error": {"sd_m": 3.0, "tau_s": 1e6, "distance_m": 400.0}}
    for speed, kept in ((20.0, np.exp(-1.0)), (0.0, 1.0)):
        start = BASE["start"] | {"speed_m_s": speed}
        source = simulator(gnss=SILENT | figures, start=start, turn=[], slope=[])
        x = [source.run(seed).truth_blocks["gnss_position_error"] for seed in range(150)]
        pairs = np.array([(run[500] * run[1500]).mean() for run in x]) / 9.0
        assert pairs.mean() == pytest.approx(kept, abs=0.27)
        assert np.var(x) == pytest.approx(9.0, rel=0.35)
    # and exactly: at rest nothing but the noise of an unending tau moves them
    moved = simulator(gnss=SILENT | figures, start=BASE["start"] | {"speed_m_s": 0.0}, turn=[], slope=[])
    history = moved.run(1).truth_blocks["gnss_position_error"]
    assert np.abs(history - history[0]).max() < 0.2


JUMPING: dict[str, Any] = SILENT | {
    "rate_hz": 2.0,
    "constellation_changes": [20.3, 40.0],
    "position_error": {"sd_m": 1.0, "tau_s": 50.0, "distance_m": 2000.0, "jump_sd_m": [3.0, 4.0, 5.0]},
    "velocity_error": {"sd_m_s": 0.01, "tau_s": 20.0, "jump_sd_m_s": 0.05},
    "position_jump_sd_m": [20.0, 30.0, 40.0],
    "velocity_jump_sd_m_s": 0.5,
}


def test_the_first_fix_after_a_change_is_marked_and_tells_its_noise() -> None:
    gnss = simulator(gnss=JUMPING).run(1).dataset.gnss
    assert gnss.new_constellation is not None
    assert (gnss.t_ns[gnss.new_constellation] / S).tolist() == [20.5, 40.0]
    rows = np.flatnonzero(gnss.new_constellation)
    assert gnss.sd[rows[0]] == pytest.approx([20.0, 30.0, 40.0, 0.5, 0.5, 0.5])
    assert gnss.sd[rows[0] + 1] == pytest.approx([1e-6] * 3 + [1e-8] * 3)


def test_a_change_inside_an_outage_is_told_by_the_first_fix_after_it() -> None:
    gnss = simulator(gnss=JUMPING | {"outages": [[15.0, 25.0]]}).run(1).dataset.gnss
    assert gnss.new_constellation is not None
    assert (gnss.t_ns[gnss.new_constellation] / S).tolist() == [25.0, 40.0]
    assert gnss.sd[np.flatnonzero(gnss.new_constellation)[0], 0] == pytest.approx(1e-6)


def test_changes_after_the_last_fix_are_none_and_two_between_fixes_are_one() -> None:
    t_ns = np.arange(1, 11, dtype=np.int64) * S
    assert change_rows(t_ns, [2.0, 2.1, 2.9, 10.1]).tolist() == [1, 2]
    assert change_rows(t_ns, []).size == 0
    assert simulator(gnss=SILENT).run(1).dataset.gnss.new_constellation is None


def test_jumps_have_their_deviation_and_fade_with_the_error() -> None:
    # 300 runs: relative sd of a variance 8 %, bounds 4 sigma
    source = simulator(gnss=JUMPING)
    runs = [source.run(seed).truth_blocks for seed in range(300)]
    position = np.array([run["gnss_position_error"] for run in runs])
    velocity = np.array([run["gnss_velocity_error"] for run in runs])
    jump = position[:, 1025] - position[:, 1024]  # 20.50 s against 20.48 s
    assert np.var(jump, axis=0) == pytest.approx([9.0, 16.0, 25.0], rel=0.33)
    assert np.var(velocity[:, 1025] - velocity[:, 1024], axis=0) == pytest.approx([0.0025] * 3, rel=0.33)
    assert np.abs(position[:, 1024] - position[:, 1023]).max() < 0.3
    fade = np.exp(-2.0 * 19.0 * (1.0 / 50.0 + 20.0 / 2000.0))  # at 39.5 s
    expected = 1.0 + np.array([9.0, 16.0, 25.0]) * fade
    assert np.var(position[:, 1975], axis=0) == pytest.approx(expected, rel=0.33)
    assert np.var(position[:, 100], axis=0) == pytest.approx([1.0] * 3, rel=0.33)
    assert np.corrcoef(jump.T)[np.triu_indices(3, 1)] == pytest.approx(np.zeros(3), abs=4.5 / np.sqrt(300))


def test_the_error_obeys_the_published_recursion_from_fix_to_fix() -> None:
    # dR+ = W dR + q s n + mu s_d n, W = exp(-(1/tau + V/d) dt): 17700 draws, relative sd of a variance 1 %
    gnss = {key: value for key, value in JUMPING.items() if "_jump_" not in key} | {"rate_hz": 1.0}
    source = simulator(gnss=gnss | {"constellation_changes": [20.0]})
    w = np.exp(-(1.0 / 50.0 + 20.0 / 2000.0))
    innovations = []
    for seed in range(100):
        x = source.run(seed).truth_blocks["gnss_position_error"][::50]
        innovations.append(x[1:] - w * x[:-1])
    drive = np.array(innovations) / np.sqrt(1.0 - w * w)
    rest = np.delete(drive, 19, axis=1)
    # the track climbs for part of the time, so the ground speed is up to 0.4 % below 20 m/s
    assert np.var(rest) == pytest.approx(1.0, abs=0.045)
    assert np.mean(rest[:, 1:] * rest[:, :-1]) == pytest.approx(0.0, abs=0.031)
    jump = np.var(drive[:, 19], axis=0) * (1.0 - w * w)
    assert jump == pytest.approx(np.array([9.0, 16.0, 25.0]) + (1.0 - w * w), rel=4.0 * np.sqrt(2.0 / 100))


def test_fixes_carry_the_slow_errors_of_the_truth() -> None:
    quiet = {key: value for key, value in JUMPING.items() if "_jump_" not in key}
    source = simulator(gnss=quiet)
    run, plain = source.run(2), simulator(gnss=SILENT | {"rate_hz": 2.0}).run(2)
    rows = run.dataset.gnss.t_ns // 20_000_000
    error = run.dataset.gnss.v_n - plain.dataset.gnss.v_n
    assert error == pytest.approx(run.truth_blocks["gnss_velocity_error"][rows], abs=1e-9)
    up = run.dataset.gnss.lla[:, 2] - plain.dataset.gnss.lla[:, 2]
    assert -up == pytest.approx(run.truth_blocks["gnss_position_error"][rows, 2], abs=1e-4)


def test_jumps_leave_all_other_random_numbers_as_they_are() -> None:
    calm = {
        key: value for key, value in JUMPING.items() if "jump" not in key and key != "constellation_changes"
    }
    calm["position_error"] = {k: v for k, v in JUMPING["position_error"].items() if "jump" not in k}
    calm["velocity_error"] = {k: v for k, v in JUMPING["velocity_error"].items() if "jump" not in k}
    still, jumping = simulator(gnss=calm).run(4), simulator(gnss=JUMPING).run(4)
    for name in ("gnss_position_error", "gnss_velocity_error"):
        assert np.array_equal(still.truth_blocks[name][:1025], jumping.truth_blocks[name][:1025])
    assert np.array_equal(still.dataset.gnss.lla[:40], jumping.dataset.gnss.lla[:40])
    assert not np.array_equal(still.dataset.gnss.lla[40], jumping.dataset.gnss.lla[40])


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"gnss": SILENT | {"position_jump_sd_m": 1.0}}, "without constellation_changes"),
        (
            {"gnss": SILENT | {"position_error": {"sd_m": 1.0, "tau_s": 1.0, "jump_sd_m": 1.0}}},
            "without constellation_changes",
        ),
        ({"gnss": SILENT | {"constellation_changes": [-1.0]}}, "constellation_changes"),
        ({"baro": {"rate_hz": 1.0, "height_sd_m": 0.0}}, "height_sd_m"),
        ({"baro": {"rate_hz": 1.0, "height_sd_m": 1.0, "bias_walk_m_sqrt_s": -1.0}}, "bias_walk_m_sqrt_s"),
        ({"heading": {"rate_hz": 1.0}}, "heading_sd_deg"),
    ],
)
def test_aids_that_mean_nothing_are_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        scenario_from_dict(copy.deepcopy(BASE) | changes)
