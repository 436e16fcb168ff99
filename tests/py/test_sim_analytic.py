"""Analytic track: worked figures of the publication, finite differences, limits, and the truth made of it."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gnssins import _core
from gnssins.errors import ConfigError
from gnssins.sim import Trajectory, build_trajectory, load_scenario, scenario_from_dict
from gnssins.sim.analytic import AnalyticMotion, evaluate
from gnssins.sim.frames import c_en
from gnssins.sim.motion_config import Analytic

Array = NDArray[np.float64]
START = (np.radians(55.0), np.radians(30.0), 5000.0)
#: Every term at work, none of them a special case.
RICH: dict[str, Any] = {
    "lat": {"rate_rad_s": 1e-5, "amplitude_rad": 0.004, "period_s": 600.0, "phase_rad": 0.3},
    "lon": {"rate_rad_s": 4e-5, "amplitude_rad": 0.002, "period_s": 450.0, "phase_rad": -1.0},
    "height": {"rate_m_s": 2.0, "amplitude_m": 3000.0, "period_s": 500.0, "phase_rad": 0.7},
    "bank_gain_rad_s2_m": 0.05,
}
BASE: dict[str, Any] = {
    "scenario": {"name": "test", "duration_s": 60.0, "rate_hz": 50.0},
    "start": {"lat_deg": 55.0, "lon_deg": 30.0, "height_m": 5000.0},
    "analytic": RICH,
    "initial_error": {"attitude_sd_deg": 1.0, "velocity_sd_m_s": 0.1, "position_sd_m": 1.0},
}


def published(t_s: Array) -> AnalyticMotion:
    terms = load_scenario("novik-2011").analytic
    assert terms is not None
    return evaluate(terms, START, t_s)


def rich(t_s: Array, **keys: str) -> AnalyticMotion:
    return evaluate(Analytic.model_validate(RICH), START, t_s, **keys)


def slope(values: Array, dt_s: float) -> Array:
    """Central difference of the middle of three rows."""
    return (values[2] - values[0]) / (2.0 * dt_s)


@pytest.fixture(scope="module")
def flight() -> Trajectory:
    tables = load_scenario("novik-2011").model_dump(mode="json", exclude_none=True)
    tables["scenario"]["duration_s"] = 900.0
    return build_trajectory(scenario_from_dict(tables))


def test_the_flight_has_the_published_figures() -> None:
    motion = published(np.arange(0.0, 600.0, 0.1))
    north, east, down = motion.v_n.T
    roll, pitch, heading = np.degrees(motion.rpy.T)
    assert (east.min(), east.max()) == pytest.approx((146.0, 148.0), abs=0.5)
    assert np.abs(north).max() == pytest.approx(267.0, abs=1.0)
    assert (motion.lla[:, 2].min(), motion.lla[:, 2].max()) == pytest.approx((0.0, 10_000.0), abs=0.1)
    assert np.abs(down).max() == pytest.approx(52.0, abs=0.5)
    assert (heading.min(), heading.max()) == pytest.approx((29.0, 151.0), abs=0.5)
    assert np.abs(pitch).max() == pytest.approx(19.7, abs=0.05)
    assert np.abs(roll).max() == pytest.approx(3.4, abs=0.05)
    assert np.hypot(*motion.v_dot_n[:, :2].T).max() == pytest.approx(2.8, abs=0.05)


def test_the_body_turns_as_fast_as_published(flight: Trajectory) -> None:
    rate = np.linalg.norm(flight.dtheta[1:], axis=1) * 50.0
    assert np.degrees(rate.max()) == pytest.approx(1.1, abs=0.05)


def test_a_term_in_degrees_would_not_fly() -> None:
    slow = Analytic.model_validate({"lon": {"rate_rad_s": np.radians(4e-5)}})
    assert evaluate(slow, START, [0.0]).v_n[0, 1] == pytest.approx(2.6, abs=0.05)


@pytest.mark.parametrize("t_s", [0.0, 37.0, 411.5])
def test_every_derivative_is_that_of_its_function(t_s: float) -> None:
    dt_s = 0.01
    motion = rich(np.array([t_s - dt_s, t_s, t_s + dt_s]))
    pairs = [
        (motion.lla, motion.lla_rate),
        (motion.lla_rate, motion.lla_accel),
        (motion.radii_m, motion.radii_rate_m_s),
        (motion.v_n, motion.v_dot_n),
    ]
    for function, derivative in pairs:
        scale = np.abs(derivative[1]).max()
        assert slope(function, dt_s) == pytest.approx(derivative[1], abs=2e-7 * max(scale, 1.0), rel=2e-7)
        assert scale > 0.0


@pytest.mark.parametrize("ellipsoid", ["wgs84", "krasovsky"])
@pytest.mark.parametrize("t_s", [0.0, 123.4, 555.0])
def test_velocity_and_specific_force_are_those_of_the_motion_in_space(t_s: float, ellipsoid: str) -> None:
    # independent of the geographic frame: r_e'' = f_e + g_e - 2 w x v_e, by differences of the ECEF position
    dt_s, w = 0.5, np.array([0.0, 0.0, 7.292115e-5])
    motion = rich(t_s + dt_s * np.arange(-2.0, 3.0), ellipsoid=ellipsoid)
    r = _core.lla_to_ecef(motion.lla, ellipsoid)
    v_e = (8.0 * (r[3] - r[1]) - (r[4] - r[0])) / (12.0 * dt_s)
    a_e = (16.0 * (r[3] + r[1]) - r[4] - r[0] - 30.0 * r[2]) / (12.0 * dt_s**2)
    to_n = c_en(motion.lla[2:3])[0].T
    g_n = _core.gravity_n(motion.lla[2:3, 0], motion.lla[2:3, 2], ellipsoid)[0]
    assert to_n @ v_e == pytest.approx(motion.v_n[2], abs=1e-7)
    assert to_n @ (a_e + 2.0 * np.cross(w, v_e)) - g_n == pytest.approx(motion.f_n[2], abs=2e-7)


def test_gravity_without_its_north_component_changes_the_force_to_the_north_alone() -> None:
    t_s = np.array([100.0])
    normal, vertical = rich(t_s), rich(t_s, gravity="vertical")
    assert vertical.f_n[0, 1:] == pytest.approx(normal.f_n[0, 1:], abs=1e-12)
    assert abs(vertical.f_n[0, 0] - normal.f_n[0, 0]) > 1e-6


def test_a_coordinated_gain_puts_the_force_into_the_plane_of_symmetry() -> None:
    # with K = 1/g in level flight the force across the body vanishes to first order in the roll
    terms = copy.deepcopy(RICH) | {"height": {}, "bank_gain_rad_s2_m": 1.0 / 9.8}
    motion = evaluate(Analytic.model_validate(terms), START, np.arange(0.0, 600.0, 10.0))
    c_nb = _core.quat_to_dcm(_core.euler_to_quat(motion.rpy))
    across = np.einsum("nij,ni->nj", c_nb, motion.f_n)[:, 1]
    level = np.abs(np.einsum("nij,ni->nj", c_nb, motion.v_dot_n)[:, 1]).max()
    assert level > 1.0
    assert np.abs(across).max() < 0.1  # what Coriolis and the third power of the roll leave


def test_north_and_south_are_mirror_images() -> None:
    south = Analytic.model_validate(
        RICH
        | {"lat": {key: -v if "rad" in key else v for key, v in RICH["lat"].items()} | {"phase_rad": 0.3}}
    )
    t_s = np.arange(0.0, 600.0, 50.0)
    here = rich(t_s)
    there = evaluate(south, (-START[0], START[1], START[2]), t_s)
    assert there.v_n == pytest.approx(here.v_n * [-1.0, 1.0, 1.0], abs=1e-9)
    assert there.f_n == pytest.approx(here.f_n * [-1.0, 1.0, 1.0], abs=1e-9)
    assert there.rpy[:, :2] == pytest.approx(here.rpy[:, :2] * [-1.0, 1.0], abs=1e-12)


def test_at_rest_there_is_no_velocity_and_only_gravity() -> None:
    motion = evaluate(Analytic(), START, [0.0, 10.0])
    g_n = _core.gravity_n(np.array([START[0]]), np.array([START[2]]), "wgs84")[0]
    assert not np.any(motion.v_n)
    assert motion.f_n[1] == pytest.approx(-g_n, abs=1e-15)
    assert not np.any(motion.rpy)


def test_the_truth_keeps_to_the_track_within_a_millimetre_over_900_s(flight: Trajectory) -> None:
    motion = published(flight.t_ns / 1e9)
    assert np.array_equal(flight.v_n, motion.v_n)
    off = _core.lla_to_ecef(flight.lla, "wgs84") - _core.lla_to_ecef(motion.lla, "wgs84")
    distance = np.linalg.norm(off, axis=1).max()
    # the trapezoidal rule: T^2/12 times the change of acceleration, 2 x 2.8 m/s^2
    assert distance == pytest.approx(0.02**2 / 12.0 * 2.8, rel=0.1)


def test_error_free_navigation_closes_on_the_truth_after_900_s(flight: Trajectory) -> None:
    lla, v_n, q_nb = _core.strapdown(
        flight.model, flight.ellipsoid, flight.gravity, flight.coning, flight.t_ns,
        flight.dtheta, flight.dvel, flight.lla[0], flight.v_n[0], flight.q_nb[0],
    )  # fmt: skip
    apart = _core.lla_to_ecef(lla, "wgs84") - _core.lla_to_ecef(flight.lla, "wgs84")
    assert np.linalg.norm(apart, axis=1).max() < 1e-4
    assert np.abs(v_n - flight.v_n).max() < 1e-9
    assert np.abs(q_nb - flight.q_nb).max() < 1e-11


def test_the_increments_feel_the_specific_force_of_the_closed_form(flight: Trajectory) -> None:
    motion = published(flight.t_ns / 1e9)
    felt = np.einsum("nij,nj->ni", _core.quat_to_dcm(flight.q_nb[1:]), flight.dvel[1:]) * 50.0
    middle = 0.5 * (motion.f_n[1:] + motion.f_n[:-1])
    assert felt == pytest.approx(middle, abs=3e-3)  # half a step of turning: 9.8 m/s^2 x 1.1 deg/s x 0.01 s


def test_a_sway_comes_on_top_of_the_attitude() -> None:
    sway = [{"axis": "roll", "amplitude_deg": 5.0, "period_s": 8.0, "ramp_s": 0.0}]
    plain = build_trajectory(scenario_from_dict(BASE))
    swaying = build_trajectory(scenario_from_dict(copy.deepcopy(BASE) | {"sway": sway}))
    t_s = plain.t_ns / 1e9
    expected = np.radians(5.0) * np.sin(2.0 * np.pi * t_s / 8.0)
    assert swaying.rpy[:, 0] - plain.rpy[:, 0] == pytest.approx(expected, abs=1e-12)
    assert np.array_equal(swaying.v_n, plain.v_n)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"waypoint": [{"north_m": 10.0, "east_m": 0.0}]}, "does not go with analytic"),
        ({"turn": [{"start_s": 1.0, "length_s": 1.0, "rate_deg_s": 1.0}]}, "does not go with analytic"),
        ({"start": BASE["start"] | {"heading_deg": 0.0}}, "does not go with analytic"),
        ({"start": BASE["start"] | {"speed_m_s": 5.0}}, "does not go with analytic"),
        ({"motion": {"heading_reference": "grid"}}, "does not go with analytic"),
        ({"scenario": {"name": "test"}}, "needs duration_s"),
        ({"analytic": {"lat": {"period_s": 0.0}}}, "period_s"),
        ({"analytic": {"lat": {"rate_deg_s": 1.0}}}, "rate_deg_s"),
    ],
)
def test_what_does_not_go_with_an_analytic_track_is_refused(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        scenario_from_dict(copy.deepcopy(BASE) | changes)


@pytest.mark.parametrize(
    ("terms", "text"),
    [
        ({"lat": {"amplitude_rad": 0.001}}, "ground speed falls"),
        ({"lon": {"rate_rad_s": 1e-6}, "height": {"amplitude_m": 5000.0, "period_s": 60.0}}, "steep"),
    ],
)
def test_tracks_that_cannot_be_flown_are_refused(terms: dict[str, Any], text: str) -> None:
    tables = copy.deepcopy(BASE) | {"analytic": terms}
    tables["scenario"]["duration_s"] = 400.0
    with pytest.raises(ConfigError, match=text) as caught:
        build_trajectory(scenario_from_dict(tables))
    assert caught.value.code == "config.motion"
