"""True motion: the published flight, exact closure, manoeuvres, waypoints, poles."""

from __future__ import annotations

import copy
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gnssins import _core
from gnssins.errors import ConfigError, GnssinsError
from gnssins.sim import Trajectory, build_trajectory, load_scenario, relocate, scenario_from_dict
from gnssins.sim.conformal import geodetic_latitude, grid_convergence, isometric_latitude
from gnssins.sim.motion import Profile, Pulse, Step, evaluate
from gnssins.sim.waypoints import plan_route

Array = NDArray[np.float64]

BASE: dict[str, Any] = {
    "scenario": {"name": "test", "duration_s": 60.0, "rate_hz": 50.0},
    "start": {"lat_deg": 45.0, "lon_deg": 10.0, "height_m": 500.0, "heading_deg": 0.0, "speed_m_s": 40.0},
    "initial_error": {"attitude_sd_deg": 1.0, "velocity_sd_m_s": 0.1, "position_sd_m": 1.0},
}

# Check table of the published flight: t, latitude, longitude, height, heading, pitch, roll,
# v E N U.
PUBLISHED = [
    (0, 30.680000, 104.060000, 150.00, 45, 0, 0, 21.213, 21.213, 0.0),
    (500, 30.721379, 104.184505, 558.14, 15, 0, 0, 7.765, 28.978, 0.0),
    (1000, 30.735082, 104.264630, 662.60, 225, 0, 0, -21.213, -21.213, 0.0),
    (1500, 30.670630, 104.301442, 635.91, 45, -3, 0, 21.184, 21.184, -1.570),
    (1800, 30.658193, 104.369626, 631.20, 135, 0, 0, 21.213, -21.213, 0.0),
    (2100, 30.645360, 104.446690, 536.99, 115, 0, 0, 27.189, -12.679, 0.0),
    (2500, 30.637618, 104.545134, 479.41, 55, 0, 0, 24.575, 17.207, 0.0),
    (3000, 30.711051, 104.604065, 270.14, 85, 0, 0, 29.886, 2.615, 0.0),
]


def trajectory(**changes: Any) -> Trajectory:
    """Trajectory of the base scenario with changed tables; None removes a key."""
    tables = copy.deepcopy(BASE)
    for name, value in changes.items():
        if isinstance(value, dict) and name in tables:
            tables[name] = {k: v for k, v in (tables[name] | value).items() if v is not None}
        else:
            tables[name] = value
    return build_trajectory(scenario_from_dict(tables))


def free_solution(path: Trajectory) -> tuple[Array, Array, Array]:
    """Error-free navigation from the exact increments."""
    return _core.strapdown(
        path.model, path.ellipsoid, path.gravity, path.coning,
        path.t_ns, path.dtheta, path.dvel, path.lla[0], path.v_n[0], path.q_nb[0],
    )  # fmt: skip


def closure(path: Trajectory) -> tuple[float, float, float]:
    """Greatest distance (m), velocity (m/s) and attitude (rad) between free solution and truth."""
    lla, v_n, q_nb = free_solution(path)
    distance = _core.lla_to_ecef(lla, path.ellipsoid) - _core.lla_to_ecef(path.lla, path.ellipsoid)
    side = np.sign(np.sum(q_nb * path.q_nb, axis=1))[:, np.newaxis]
    turned = 2.0 * np.linalg.norm(q_nb * side - path.q_nb, axis=1)
    return (
        float(np.linalg.norm(distance, axis=1).max()),
        float(np.abs(v_n - path.v_n).max()),
        float(turned.max()),
    )


@pytest.fixture(scope="module")
def flight() -> Trajectory:
    return build_trajectory(load_scenario("fomichev-tan-2017"))


def test_published_flight_passes_the_check_table_to_the_printed_digits(flight: Trajectory) -> None:
    for t_s, lat, lon, height, heading, pitch, roll, v_east, v_north, v_up in PUBLISHED:
        row = 100 * t_s
        assert np.degrees(flight.lla[row, :2]) == pytest.approx([lat, lon], abs=5.5e-7)
        assert flight.lla[row, 2] == pytest.approx(height, abs=0.0055)
        angles = np.degrees(flight.rpy[row])
        assert angles[:2] == pytest.approx([roll, pitch], abs=1e-9)
        assert np.mod(angles[2] - heading + 180.0, 360.0) - 180.0 == pytest.approx(0.0, abs=1e-9)
        assert flight.v_n[row] == pytest.approx([v_north, v_east, -v_up], abs=5.5e-4)


def test_published_flight_has_the_stated_roll_rate_and_side_force(flight: Trajectory) -> None:
    assert np.degrees(np.abs(flight.rpy[:, 0]).max()) == pytest.approx(9.10, abs=0.005)
    assert np.degrees(np.abs(flight.dtheta).max()) * 100.0 == pytest.approx(3.42, abs=0.005)
    assert np.abs(flight.dvel[:, 1]).max() * 100.0 == pytest.approx(0.005, abs=5e-4)


def test_one_step_of_the_published_flight_has_the_stated_increments(flight: Trajectory) -> None:
    # Printed for axes right, forward, up; here forward, right, down. The printed velocity increment comes
    # from a step of lower order, without the turn of the frame under the increment (0.5 dt w_in dv = 5e-8
    # m/s).
    row = 91_501
    assert flight.t_ns[row] == 915_010_000_000
    assert flight.dtheta[row] == pytest.approx([-4.0278e-7, 3.649812e-5, 3.467564e-4], abs=6e-11)
    assert flight.dvel[row] == pytest.approx([-3.187e-8, -3.8856e-6, -9.8443851e-2], abs=7e-8)


def test_error_free_navigation_closes_after_3000_s(flight: Trajectory) -> None:
    distance, velocity, attitude = closure(flight)
    assert distance < 1e-3
    assert velocity < 1e-6
    assert attitude < 1e-9


def test_the_closure_test_sees_a_micro_g(flight: Trajectory) -> None:
    bias = 1e-5 * 0.01
    lla, _, _ = _core.strapdown(
        flight.model, flight.ellipsoid, flight.gravity, flight.coning, flight.t_ns,
        flight.dtheta, flight.dvel + bias, flight.lla[0], flight.v_n[0], flight.q_nb[0],
    )  # fmt: skip
    apart = _core.lla_to_ecef(lla[-1:], "wgs84") - _core.lla_to_ecef(flight.lla[-1:], "wgs84")
    assert np.linalg.norm(apart) > 10.0


@pytest.mark.parametrize("coning", ["two-sample", "one-sample"])
@pytest.mark.parametrize("model", ["ned", "ecef"])
def test_every_mechanisation_closes_on_its_own_truth(model: str, coning: str) -> None:
    path = trajectory(
        truth={"model": model, "coning": coning},
        turn=[{"start_s": 5.0, "length_s": 20.0, "rate_deg_s": 12.0}],
        slope=[{"from_s": 10.0, "to_s": 40.0, "angle_deg": 10.0}],
        sway=[{"axis": "roll", "amplitude_deg": 20.0, "period_s": 1.5}],
    )
    distance, velocity, attitude = closure(path)
    assert distance < 1e-6
    assert velocity < 1e-9
    assert attitude < 1e-11


def test_both_mechanisations_make_nearly_the_same_truth() -> None:
    turn = [{"start_s": 5.0, "length_s": 20.0, "rate_deg_s": 12.0}]
    ned = trajectory(turn=turn)
    ecef = trajectory(turn=turn, truth={"model": "ecef"})
    apart = _core.lla_to_ecef(ned.lla, "wgs84") - _core.lla_to_ecef(ecef.lla, "wgs84")
    assert np.linalg.norm(apart, axis=1).max() < 1e-3
    assert np.abs(ned.dtheta - ecef.dtheta).max() < 1e-9
    assert np.abs(ned.dvel - ecef.dvel).max() < 1e-6


def test_truth_is_read_only(flight: Trajectory) -> None:
    with pytest.raises(ValueError, match="read-only"):
        flight.lla[0, 0] = 0.0


def test_a_turn_changes_the_heading_by_rate_times_length_whatever_the_ramp() -> None:
    t_s = np.linspace(0.0, 60.0, 601)
    for ramp_s in (0.0, 2.0, 5.0, 25.0):
        profile = Profile(0.3, 20.0, turns=(Pulse(10.0, 15.0, ramp_s, 0.05),))
        assert evaluate(profile, t_s).heading_rad[-1] == pytest.approx(0.3 + 0.75, abs=1e-14)


def test_overlapping_manoeuvres_add_up() -> None:
    t_s = np.linspace(0.0, 60.0, 601)
    one = Profile(0.0, 20.0, turns=(Pulse(5.0, 20.0, 5.0, 0.02),), climbs=(Pulse(5.0, 20.0, 6.0, 0.05),))
    two = Profile(0.0, 20.0, turns=(Pulse(15.0, 20.0, 5.0, -0.03),), climbs=(Pulse(12.0, 9.0, 6.0, 0.04),))
    both = Profile(0.0, 20.0, turns=one.turns + two.turns, climbs=one.climbs + two.climbs)
    a, b, c = (evaluate(profile, t_s) for profile in (one, two, both))
    assert c.heading_rad == pytest.approx(a.heading_rad + b.heading_rad, abs=1e-15)
    assert c.path_angle_rad == pytest.approx(a.path_angle_rad + b.path_angle_rad, abs=1e-15)


def test_roll_follows_from_the_derivatives_of_heading_and_path_angle() -> None:
    t_s = np.arange(0.0, 60.0, 1e-3)
    profile = Profile(
        0.0,
        50.0,
        turns=(Pulse(10.0, 20.0, 5.0, 0.06),),
        climbs=(Pulse(14.0, 12.0, 6.0, 0.12),),
        speeds=(Step(20.0, 15.0, 30.0),),
    )
    motion = evaluate(profile, t_s)
    heading_rate, path_rate = np.gradient(motion.heading_rad, t_s), np.gradient(motion.path_angle_rad, t_s)
    level = np.cos(motion.path_angle_rad)
    roll = np.arctan2(motion.speed_m_s * level * heading_rate, 9.80665 * level + motion.speed_m_s * path_rate)
    assert motion.roll_rad == pytest.approx(roll, abs=2e-6)
    assert np.degrees(roll.max()) > 15.0


def test_a_coordinated_turn_has_no_side_force_and_a_flat_one_has_it_all() -> None:
    turn = [{"start_s": 10.0, "length_s": 30.0, "rate_deg_s": 6.0}]
    banked = trajectory(turn=turn)
    flat = trajectory(turn=turn, scenario={"vehicle": "car"})
    steady = slice(1000, 1900)
    assert np.abs(banked.dvel[steady, 1]).max() * 50.0 < 0.03
    centripetal = 40.0 * np.radians(6.0)
    assert flat.dvel[steady, 1].mean() * 50.0 == pytest.approx(centripetal, abs=0.02)
    assert np.abs(flat.rpy[:, 0]).max() < 1e-12


def test_speed_targets_and_changes_are_met() -> None:
    path = trajectory(
        speed=[
            {"from_s": 5.0, "to_s": 15.0, "target_m_s": 10.0},
            {"from_s": 20.0, "to_s": 30.0, "change_m_s": 5.0},
            {"from_s": 40.0, "to_s": 50.0, "target_m_s": 0.0},
        ]
    )
    speed = np.linalg.norm(path.v_n, axis=1)
    assert speed[[0, 18 * 50, 35 * 50, 55 * 50]] == pytest.approx([40.0, 10.0, 15.0, 0.0], abs=1e-12)


def test_impossible_motion_is_refused() -> None:
    with pytest.raises(ConfigError, match="speed falls to -10"):
        trajectory(speed=[{"from_s": 5.0, "to_s": 15.0, "change_m_s": -50.0}])
    steep = {"from_s": 5.0, "to_s": 15.0, "angle_deg": 45.0}
    with pytest.raises(ConfigError, match="steep"):
        trajectory(slope=[steep, steep])
    with pytest.raises(ConfigError, match="samples"):
        trajectory(scenario={"duration_s": 0.001})


def test_sway_turns_the_body_and_leaves_the_path_alone() -> None:
    sway = [
        {"axis": "roll", "amplitude_deg": 8.0, "period_s": 9.0, "ramp_s": 5.0},
        {"axis": "heading", "amplitude_deg": 3.0, "period_s": 20.0, "from_s": 10.0, "to_s": 40.0},
    ]
    calm = trajectory(scenario={"vehicle": "ship"})
    rough = trajectory(scenario={"vehicle": "ship"}, sway=sway)
    assert np.abs(rough.lla - calm.lla).max() < 1e-15
    assert np.array_equal(rough.v_n, calm.v_n)
    roll, pitch, heading = np.degrees(rough.rpy).T
    assert np.abs(roll).max() == pytest.approx(8.0, abs=0.01)
    assert np.abs(pitch).max() < 1e-9
    assert heading.max() == pytest.approx(3.0, abs=0.05)
    assert np.abs(heading[-1]) < 1e-9


def test_a_body_at_rest_feels_gravity_and_the_turning_earth() -> None:
    path = build_trajectory(load_scenario("static"))
    assert np.ptp(path.lla, axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=1e-15)
    lat = path.lla[0, 0]
    w_ie_n = 7.292115e-5 * np.array([np.cos(lat), 0.0, -np.sin(lat)])
    c_nb = _core.quat_to_dcm(path.q_nb[:1])[0]
    gravity = _core.gravity_n(path.lla[:1, 0], path.lla[:1, 2], "wgs84", "normal")[0]
    assert path.dtheta[50] * 100.0 == pytest.approx(c_nb.T @ w_ie_n, abs=1e-12)
    assert path.dvel[50] * 100.0 == pytest.approx(-c_nb.T @ gravity, abs=1e-5)


def test_a_rate_that_is_no_whole_number_of_ns_keeps_its_stamps() -> None:
    path = trajectory(scenario={"rate_hz": 104.0})
    assert len(path) == 6241
    assert path.t_ns[-1] == 60_000_000_000
    assert np.ptp(np.diff(path.t_ns)) == 1
    assert closure(path)[0] < 1e-6


def local_metres(path: Trajectory) -> Array:
    """North, east of the start (m), for routes of a few kilometres."""
    radii = _core.radii(path.lla[:1, 0], path.ellipsoid)[0] + path.lla[0, 2]
    north = (path.lla[:, 0] - path.lla[0, 0]) * radii[0]
    east = (path.lla[:, 1] - path.lla[0, 1]) * radii[1] * np.cos(path.lla[0, 0])
    return np.column_stack([north, east])


def test_the_car_comes_back_to_where_it_started() -> None:
    scenario = load_scenario("car-loop")
    path = build_trajectory(scenario)
    assert local_metres(path)[-1] == pytest.approx([0.0, 0.0], abs=1e-3)
    assert path.lla[-1, 2] == pytest.approx(300.0, abs=1e-6)
    assert np.abs(path.v_n[-1]).max() < 1e-12
    assert plan_route(scenario).arrival_s < 600.0
    speed = np.linalg.norm(path.v_n, axis=1)
    assert np.count_nonzero(speed < 1e-9) / 100.0 >= 20.0 + 12.0 + 20.0 + 15.0 + 10.0 + 5.0


def test_a_route_keeps_to_its_legs_and_cuts_only_the_corners() -> None:
    scenario = load_scenario("car-loop")
    place = local_metres(build_trajectory(scenario))[::20]
    corners = np.array([(0.0, 0.0), *((point.north_m, point.east_m) for point in scenario.waypoint)])
    off = np.full(len(place), np.inf)
    for start, end in pairwise(corners):
        leg = end - start
        share = np.clip((place - start) @ leg / (leg @ leg), 0.0, 1.0)
        off = np.minimum(off, np.linalg.norm(place - start - share[:, np.newaxis] * leg, axis=1))
    assert off.max() < 5.0
    assert np.median(off) < 0.02  # of which the constant radii here take the most


def test_a_route_in_degrees_crosses_the_date_line_and_meets_heights_and_speeds() -> None:
    points = [
        {"lat_deg": 48.3, "lon_deg": -179.7, "height_m": 2500.0, "speed_m_s": 80.0},
        {"lat_deg": 48.6, "lon_deg": -179.8},
        {"lat_deg": 48.5, "lon_deg": 179.5, "height_m": 500.0, "speed_m_s": 50.0},
    ]
    start = {"lat_deg": 48.0, "lon_deg": 179.8, "height_m": 1000.0, "speed_m_s": 60.0, "heading_deg": None}
    path = trajectory(
        start=start,
        scenario={"duration_s": None, "rate_hz": 10.0},
        motion={"turn_radius_m": 800.0},
        waypoint=points,
    )
    ends = np.array([[np.radians(48.5), np.radians(179.5), 500.0]])
    miss = _core.lla_to_ecef(path.lla[-1:], "wgs84") - _core.lla_to_ecef(ends, "wgs84")
    assert np.linalg.norm(miss) < 10.0  # of 120 km; up to one sample of 5 m from the end
    assert path.lla[-1, 2] == pytest.approx(500.0, abs=1e-3)
    assert path.lla[:, 2].max() == pytest.approx(2500.0, abs=1e-3)
    assert np.linalg.norm(path.v_n[-1]) == pytest.approx(50.0, abs=1e-9)


@pytest.mark.parametrize(
    ("corners", "text"),
    [
        ([(100.0, 0.0), (100.0, 500.0)], "#1: the leg of 100.0 m is too short"),
        ([(5000.0, 0.0), (0.0, 10.0)], "#1: the corner of 179.9 deg is sharper"),
        ([(0.0, 0.0)], "#1: is where the leg begins"),
    ],
)
def test_routes_that_cannot_be_followed_are_refused(corners: list[tuple[float, float]], text: str) -> None:
    points = [{"north_m": north, "east_m": east} for north, east in corners]
    with pytest.raises(ConfigError, match=text):
        trajectory(start={"heading_deg": None}, scenario={"duration_s": None}, waypoint=points)


def test_a_route_from_rest_needs_a_speed() -> None:
    with pytest.raises(ConfigError, match="no speed"):
        trajectory(
            start={"heading_deg": None, "speed_m_s": 0.0}, waypoint=[{"north_m": 100.0, "east_m": 0.0}]
        )


def test_isometric_latitude_inverts() -> None:
    lat = np.radians(np.array([-85.0, -30.0, 0.0, 1e-6, 45.0, 89.0]))
    assert geodetic_latitude(isometric_latitude(lat, "wgs84"), "wgs84") == pytest.approx(lat, abs=1e-14)


@pytest.mark.parametrize("hemisphere", [1.0, -1.0])
def test_grid_convergence_is_the_longitude_passed(hemisphere: float) -> None:
    scenario = relocate(load_scenario("fomichev-tan-2017"), hemisphere * 84.0, 104.06)
    path = build_trajectory(scenario)
    course = np.unwrap(np.arctan2(path.v_n[:, 1], path.v_n[:, 0]))
    grid = np.unwrap(course - hemisphere * (path.lla[:, 1] - path.lla[0, 1]))
    printed = [45.0, 15.0, 225.0, 85.0]
    assert np.mod(np.degrees(grid[[0, 50_000, 100_000, 300_000]]), 360.0) == pytest.approx(printed, abs=1e-3)


def test_grid_convergence_next_to_the_pole_is_plane_geometry() -> None:
    steps, dt_s = 2001, 0.05
    track = 30.0 * dt_s * np.arange(steps) * np.exp(0.25j * np.pi)
    heading, speed = np.full(steps, 0.25 * np.pi), np.full(steps, 30.0)
    found = grid_convergence(np.radians(89.99), 0.0, heading, speed, dt_s, "wgs84")
    distance = 6399593.6 * np.radians(0.01)
    assert found == pytest.approx(-np.unwrap(np.angle(distance - track)), abs=1e-6)


def test_the_flight_keeps_its_shape_next_to_the_pole(flight: Trajectory) -> None:
    scenario = relocate(load_scenario("fomichev-tan-2017"), 89.995, 104.06, model="ecef")
    polar = build_trajectory(scenario)
    distance, velocity, attitude = closure(polar)
    assert distance < 1e-3
    assert velocity < 1e-6
    assert attitude < 1e-9
    here, there = (_core.lla_to_ecef(path.lla[::10_000], "wgs84") for path in (flight, polar))
    span_here, span_there = (np.linalg.norm(ecef - ecef[0], axis=1) for ecef in (here, there))
    assert span_there == pytest.approx(span_here, rel=5e-3, abs=1.0)
    assert np.linalg.norm(polar.v_n, axis=1) == pytest.approx(np.linalg.norm(flight.v_n, axis=1), abs=1e-9)


def test_a_track_over_the_pole_itself_is_refused() -> None:
    scenario = relocate(load_scenario("fomichev-tan-2017"), 89.9999, 104.06, model="ecef")
    tables = scenario.model_dump(mode="json", exclude_none=True)
    tables["scenario"]["duration_s"] = 60.0
    tables["start"]["heading_deg"] = 0.0
    with pytest.raises(ConfigError, match="of a pole"):
        build_trajectory(scenario_from_dict(tables))


def test_the_ned_equations_refuse_the_pole() -> None:
    scenario = relocate(load_scenario("fomichev-tan-2017"), 89.9999, 104.06, model="ned")
    with pytest.raises(GnssinsError):
        build_trajectory(scenario)
