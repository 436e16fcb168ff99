"""From waypoints to a motion profile: straight legs joined by arcs with smooth ends.

The route lies in a conformal plane that is true to scale at the start: Mercator, or polar stereographic if
headings count from the grid. In the Mercator plane a straight leg is a rhumb line, so the heading is constant
on a leg and true north needs no correction; lengths are brought back to the ellipsoid at the height of the
leg.

A leg is driven like this: from the speed of the last corner to the speed of the leg, on at that speed while
the height changes, then to the speed of the next corner, by way of a stop if one is asked for. The turn
follows at constant speed, its rate v/radius being reached over the turn ramp; as it cuts the corner, it
begins its tangent length before the waypoint. Speeds are ground speeds and change at most at the acceleration
of the scenario. Time follows from lengths and speeds. Position comes from the strapdown step and not from the
plane: it keeps to the route within a few metres over a hundred kilometres.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..errors import ConfigError
from .conformal import geodetic_latitude, isometric_latitude
from .motion import Profile, Pulse, Step, add_step_integral
from .scenario import Scenario

__all__ = ["Route", "plan_route"]

Array = NDArray[np.float64]

#: Peak slope of the quintic step of unit height and length.
_PEAK_SLOPE = 1.875
#: Sharpest corner that a turn can cut.
_GREATEST_TURN_RAD = np.radians(150.0)


@dataclass(frozen=True)
class Route:
    """A planned route: the profile, and when it reaches the last waypoint."""

    profile: Profile
    arrival_s: float


@dataclass(frozen=True)
class _Turn:
    """Turn at a waypoint: heading change, length of the pulse, and how far before the corner it begins."""

    change_rad: float
    length_s: float
    tangent_m: float


@dataclass(frozen=True)
class _Leg:
    """A leg: its length, the speeds of its three parts, and what it does besides."""

    length_m: float
    speed_before_m_s: float
    speed_m_s: float
    speed_after_m_s: float
    rise_m: float
    stop_s: float | None
    turn: _Turn


class _Driver:
    """Lays the legs one after the other on the time axis."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.time_s = scenario.start.rest_s
        self.behind_m = 0.0
        self.turns: list[Pulse] = []
        self.speeds: list[Step] = []
        self.climbs: list[Pulse] = []

    def change_speed(self, before: float, after: float) -> None:
        """Change the speed from now on; zero change takes no time."""
        ramp_s = self._ramp_s(before, after)
        if ramp_s > 0.0:
            self.speeds.append(Step(self.time_s, ramp_s, after - before))
            self.time_s += ramp_s

    def drive(self, index: int, leg: _Leg) -> None:
        """Add one leg and the turn at its end."""
        ahead = [leg.speed_m_s, leg.speed_after_m_s]
        if leg.stop_s is not None:
            ahead.insert(1, 0.0)
        speeds = [leg.speed_before_m_s, *ahead]
        pairs = list(pairwise(speeds))
        needed_m = sum(0.5 * (v0 + v1) * self._ramp_s(v0, v1) for v0, v1 in pairs)
        cruise_m = leg.length_m - self.behind_m - leg.turn.tangent_m - needed_m
        if cruise_m < 0.0 or (leg.rise_m != 0.0 and cruise_m == 0.0):
            raise _leg_error(self.scenario, index, leg.length_m, leg.length_m - cruise_m)
        self.change_speed(*pairs[0])
        self._cruise(cruise_m / leg.speed_m_s, leg.rise_m)
        for v0, v1 in pairs[1:]:
            self.change_speed(v0, v1)
            if v1 == 0.0:
                self.time_s += leg.stop_s or 0.0
        if leg.turn.length_s > 0.0:
            ramp_s = self.scenario.motion.turn_ramp_s
            self.turns.append(
                Pulse(self.time_s, leg.turn.length_s, ramp_s, leg.turn.change_rad / leg.turn.length_s)
            )
            self.time_s += leg.turn.length_s + ramp_s
        self.behind_m = leg.turn.tangent_m

    def _cruise(self, cruise_s: float, rise_m: float) -> None:
        if rise_m != 0.0:
            ramp_s = min(self.scenario.motion.slope_ramp_s, 0.5 * cruise_s)
            climb_s = cruise_s - ramp_s
            self.climbs.append(Pulse(self.time_s, climb_s, ramp_s, rise_m / climb_s))
        self.time_s += cruise_s

    def _ramp_s(self, before: float, after: float) -> float:
        return _PEAK_SLOPE * abs(after - before) / self.scenario.motion.accel_m_s2


def plan_route(scenario: Scenario) -> Route:
    """Headings, speeds and climbs that follow the waypoints of a scenario.

    Parameters
    ----------
    scenario : Scenario
        With at least one waypoint.

    Returns
    -------
    Route
        Profile with ground speeds, and the time of arrival at the last waypoint (s).

    Raises
    ------
    ConfigError
        ``config.waypoint``: a leg is too short for its turns and changes of speed or has no speed, a corner
        is sharper than 150 deg, or degrees are used with grid headings.
    """
    start, points = scenario.start, scenario.waypoint
    corners = _corners(scenario)
    directions = np.diff(corners, axis=0)
    headings = np.unwrap(np.arctan2(directions[:, 0], directions[:, 1]))
    heights, speeds = [start.height_m], [start.speed_m_s]
    for point in points:
        heights.append(point.height_m if point.height_m is not None else heights[-1])
        speeds.append(point.speed_m_s if point.speed_m_s is not None else speeds[-1])
    lengths = _true_lengths(scenario, corners, np.asarray(heights))
    driver = _Driver(scenario)
    before = start.speed_m_s
    for index, point in enumerate(points):
        last = index + 1 == len(points)
        cruise = speeds[index + 1]
        if cruise <= 0.0:
            raise _speed_error(scenario, index)
        after = cruise if point.turn_speed_m_s is None else point.turn_speed_m_s
        if last and point.stop_s is not None:
            after = 0.0
        change = 0.0 if last else float(headings[index + 1] - headings[index])
        turn = _turn(scenario, index, change, after)
        rise = heights[index + 1] - heights[index]
        stop_s = None if after == 0.0 else point.stop_s
        driver.drive(index, _Leg(float(lengths[index]), before, cruise, after, rise, stop_s, turn))
        before = after
    if before == 0.0:
        driver.time_s += points[-1].stop_s or 0.0
    profile = Profile(
        heading_rad=float(headings[0]),
        speed_m_s=start.speed_m_s,
        turns=tuple(driver.turns),
        speeds=tuple(driver.speeds),
        climbs=tuple(driver.climbs),
        speed_of="ground",
        coordination=scenario.coordination,
    )
    return Route(profile, driver.time_s)


def _turn(scenario: Scenario, index: int, change_rad: float, speed_m_s: float) -> _Turn:
    """Turn at a waypoint, with the tangent length from the true shape of its ramps."""
    if abs(change_rad) < 1e-9:
        return _Turn(0.0, 0.0, 0.0)
    if abs(change_rad) > _GREATEST_TURN_RAD:
        text = f"the corner of {abs(np.degrees(change_rad)):.1f} deg is sharper than 150 deg"
        raise _waypoint_error(scenario, index, text, "put another waypoint beside it")
    own = scenario.waypoint[index].turn_radius_m
    radius_m = own if own is not None else scenario.motion.turn_radius_m
    length_s = abs(change_rad) * radius_m / speed_m_s
    ramp_s = scenario.motion.turn_ramp_s
    t_s = np.linspace(0.0, length_s + ramp_s, 2001)
    heading = np.zeros_like(t_s)
    for step in Pulse(0.0, length_s, ramp_s, change_rad / length_s).steps():
        add_step_integral(heading, t_s, step)
    chord_m = speed_m_s * abs(np.trapezoid(np.exp(1j * heading), t_s))
    return _Turn(change_rad, length_s, float(chord_m / (2.0 * np.cos(0.5 * change_rad))))


def _waypoint_error(scenario: Scenario, index: int, text: str, hint: str) -> ConfigError:
    message = f"{scenario.name}: [[waypoint]] #{index + 1}: {text}"
    return ConfigError("config.waypoint", message, hint, {"scenario": scenario.name, "waypoint": index})


def _speed_error(scenario: Scenario, index: int) -> ConfigError:
    return _waypoint_error(scenario, index, "the leg has no speed", "give speed_m_s, here or in [start]")


def _leg_error(scenario: Scenario, index: int, length_m: float, needed_m: float) -> ConfigError:
    text = f"the leg of {length_m:.1f} m is too short: turns and changes of speed need {needed_m:.1f} m"
    hint = "move the waypoint, use smaller turn_radius_m or turn_ramp_s, or a greater accel_m_s2"
    return _waypoint_error(scenario, index, text, hint)


def _corners(scenario: Scenario) -> Array:
    """Start and waypoints in the plane, shape (n + 1, 2): east, north of the start (m)."""
    rows = [(0.0, 0.0)]
    start = scenario.start
    for index, point in enumerate(scenario.waypoint):
        if point.north_m is not None and point.east_m is not None:
            rows.append((point.east_m, point.north_m))
            continue
        if scenario.motion.heading_reference == "grid":
            text = "degrees do not go with grid headings"
            raise _waypoint_error(scenario, index, text, "give north_m and east_m")
        assert point.lat_deg is not None
        assert point.lon_deg is not None
        lon_rad = np.radians(point.lon_deg - start.lon_deg)
        lon_rad -= 2.0 * np.pi * np.round(lon_rad / (2.0 * np.pi))
        q, q_start = isometric_latitude(np.radians([point.lat_deg, start.lat_deg]), scenario.truth.ellipsoid)
        unit_m = _parallel_radius(scenario, np.radians([start.lat_deg]), np.asarray([start.height_m]))[0]
        rows.append((float(unit_m * lon_rad), float(unit_m * (q - q_start))))
    corners = np.asarray(rows)
    for index, leg in enumerate(np.diff(corners, axis=0)):
        if not np.any(leg):
            raise _waypoint_error(scenario, index, "is where the leg begins", "leave it out")
    return corners


def _true_lengths(scenario: Scenario, corners: Array, heights: Array) -> Array:
    """Lengths of the legs at their mean height, shape (n,), by Simpson's rule over the scale of the plane."""
    east, north = np.diff(corners, axis=0).T
    plane = np.asarray(np.hypot(east, north))
    if scenario.motion.heading_reference == "grid":
        return plane
    start_lat = np.radians([scenario.start.lat_deg])
    unit_m = _parallel_radius(scenario, start_lat, np.asarray([scenario.start.height_m]))[0]
    q_start = isometric_latitude(start_lat, scenario.truth.ellipsoid)[0]
    height = 0.5 * (heights[1:] + heights[:-1])

    def metres(share: float) -> Array:
        north = corners[:-1, 1] + share * (corners[1:, 1] - corners[:-1, 1])
        lat = geodetic_latitude(q_start + north / unit_m, scenario.truth.ellipsoid)
        return np.asarray(_parallel_radius(scenario, lat, height) / unit_m)

    return np.asarray(plane * (metres(0.0) + 4.0 * metres(0.5) + metres(1.0)) / 6.0)


def _parallel_radius(scenario: Scenario, lat_rad: Array, height_m: Array) -> Array:
    """Radius of the parallel at a height (m)."""
    prime_vertical = _core.radii(lat_rad, scenario.truth.ellipsoid)[:, 1]
    return np.asarray((prime_vertical + height_m) * np.cos(lat_rad))
