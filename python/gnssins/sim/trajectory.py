"""Truth: from a scenario to positions, velocities, attitudes and the increments of an error-free IMU.

Velocity and attitude are prescribed in closed form (:mod:`gnssins.sim.motion`, :mod:`gnssins.sim.analytic`) at
the sampling times. The
compiled core then inverts its own strapdown step: it gives the increments that lead exactly from one sample
to the next, and the positions that the step makes of these velocities. So the truth obeys the equations of
the engine, and an error-free navigation solution closes on it to rounding, however long the run is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..errors import ConfigError
from ..units import DEG_TO_RAD, NS_PER_S
from . import analytic
from .conformal import grid_convergence
from .motion import Motion, Profile, Pulse, Step, Sway, add_sways, evaluate
from .motion_config import Analytic
from .scenario import Scenario
from .waypoints import plan_route

__all__ = ["Trajectory", "build_trajectory", "plan_motion"]

Array = NDArray[np.float64]
TimeArray = NDArray[np.int64]

#: Steepest path that the generator accepts.
_STEEPEST_RAD = 80.0 * DEG_TO_RAD
#: Steps of motion that a track must stay away from a pole: closer, north turns too far within one sample.
_STEPS_FROM_POLE = 25.0
#: Steps of acceleration that the ground speed of an analytic track must exceed: slower, its heading turns too far
#: within one sample.
_STEPS_FROM_REST = 25.0
_HINTS = {
    "duration": "change duration_s or rate_hz",
    "speed": "look at the sum of the speed changes",
    "slope": "look at the sum of the slopes that overlap",
    "heading": "add a linear term to a coordinate, so that it never stands still over the ground",
    "pole": "move the start or the heading, or raise rate_hz",
}
#: Most samples in one trajectory; they take 3 GB.
_MOST_SAMPLES = 20_000_000


@dataclass(frozen=True)
class Trajectory:
    """True motion of the IMU, sampled at the IMU epochs; all arrays are read-only.

    Attributes
    ----------
    t_ns : ndarray of int64, shape (n,)
        Epochs; the first is 0.
    lla : ndarray, shape (n, 3)
        Latitude and longitude (rad), height above the ellipsoid (m).
    v_n : ndarray, shape (n, 3)
        Velocity over the Earth along north, east, down (m/s).
    q_nb : ndarray, shape (n, 4)
        Attitude, body (forward, right, down) to north-east-down, scalar first.
    dtheta, dvel : ndarray, shape (n, 3)
        Exact increments of angle (rad) and velocity (m/s) in body axes over the interval that ends at the
        epoch; row 0 is zero.
    model, ellipsoid, gravity, coning : str
        The equations that hold exactly.
    """

    t_ns: TimeArray
    lla: Array
    v_n: Array
    q_nb: Array
    dtheta: Array
    dvel: Array
    model: Literal["ned", "ecef"]
    ellipsoid: str
    gravity: str
    coning: str

    def __post_init__(self) -> None:
        for array in (self.t_ns, self.lla, self.v_n, self.q_nb, self.dtheta, self.dvel):
            array.flags.writeable = False

    def __len__(self) -> int:
        """Return the number of epochs."""
        return len(self.t_ns)

    @property
    def dt_s(self) -> Array:
        """Lengths of the intervals (s), shape (n - 1,); interval k leads from epoch k to epoch k + 1."""
        return np.diff(self.t_ns) / NS_PER_S

    @property
    def rpy(self) -> Array:
        """Roll, pitch, heading (rad), shape (n, 3)."""
        return np.asarray(_core.quat_to_euler(self.q_nb))


def plan_motion(scenario: Scenario) -> tuple[Profile, float]:
    """Profile and length (s) of the motion that a scenario describes.

    Parameters
    ----------
    scenario : Scenario
        Manoeuvres or waypoints.

    Returns
    -------
    profile : Profile
        Steps and pulses in SI units.
    duration_s : float
        Length of the run; of a route without a given duration, the time at the last waypoint.

    Raises
    ------
    ConfigError
        The route cannot be flown.
    """
    sways = _sways(scenario)
    if scenario.waypoint:
        route = plan_route(scenario)
        duration = scenario.scenario.duration_s
        return replace(route.profile, sways=sways), duration if duration is not None else route.arrival_s
    assert scenario.scenario.duration_s is not None
    assert scenario.start.heading_deg is not None
    turn_ramp, slope_ramp = scenario.motion.turn_ramp_s, scenario.motion.slope_ramp_s
    profile = Profile(
        heading_rad=scenario.start.heading_deg * DEG_TO_RAD,
        speed_m_s=scenario.start.speed_m_s,
        turns=tuple(
            Pulse(item.start_s, item.length_s, _or(item.ramp_s, turn_ramp), item.rate_deg_s * DEG_TO_RAD)
            for item in scenario.turn
        ),
        speeds=_speed_steps(scenario),
        climbs=tuple(
            Pulse(
                item.from_s,
                item.to_s - item.from_s,
                _or(item.ramp_s, slope_ramp),
                item.angle_deg * DEG_TO_RAD,
            )
            for item in scenario.slope
        ),
        sways=sways,
        coordination=scenario.coordination,
    )
    return profile, scenario.scenario.duration_s


def _sways(scenario: Scenario) -> tuple[Sway, ...]:
    """Attitude oscillations of a scenario, SI."""
    return tuple(
        Sway(
            item.axis,
            item.amplitude_deg * DEG_TO_RAD,
            item.period_s,
            item.phase_deg * DEG_TO_RAD,
            Pulse(
                item.from_s,
                (item.to_s if item.to_s is not None else np.inf) - item.from_s,
                item.ramp_s if item.ramp_s is not None else item.period_s,
                1.0,
            ),
        )
        for item in scenario.sway
    )


def _or(own: float | None, common: float) -> float:
    return own if own is not None else common


def _speed_steps(scenario: Scenario) -> tuple[Step, ...]:
    """List the changes of speed; a target is met from the speed that all earlier changes give."""
    speed = scenario.start.speed_m_s
    steps = []
    for item in sorted(scenario.speed, key=lambda span: span.from_s):
        change = item.change_m_s if item.target_m_s is None else item.target_m_s - speed
        assert change is not None
        steps.append(Step(item.from_s, item.to_s - item.from_s, change))
        speed += change
    return tuple(steps)


def build_trajectory(scenario: Scenario) -> Trajectory:
    """Make the true motion of a scenario.

    Parameters
    ----------
    scenario : Scenario
        What moves, where and how fast it is sampled.

    Returns
    -------
    Trajectory

    Raises
    ------
    ConfigError
        The motion cannot be: a route with legs too short, a negative speed, a path steeper than 80 deg, a run
        of more than 20 million samples, a track within 25 sampling steps of a pole.
    NavigationError
        The NED equations do not hold there, next to a pole.
    """
    truth, analytic_terms = scenario.truth, scenario.analytic
    if analytic_terms is not None:
        assert scenario.scenario.duration_s is not None
        t_ns = _epochs(scenario, scenario.scenario.duration_s)
        lla_start, v_n, rpy = _analytic_motion(scenario, analytic_terms, t_ns)
    else:
        profile, duration_s = plan_motion(scenario)
        t_ns = _epochs(scenario, duration_s)
        lla_start, v_n, rpy = _planned_motion(scenario, profile, t_ns)
    q_nb = _core.euler_to_quat(rpy)
    lla, dtheta, dvel = _core.invert_strapdown(
        truth.model, truth.ellipsoid, truth.gravity, truth.coning, t_ns, lla_start, v_n, q_nb
    )
    _check_poles(scenario, lla, np.hypot(v_n[:, 0], v_n[:, 1]) / scenario.scenario.rate_hz)
    return Trajectory(
        t_ns, lla, v_n, q_nb, dtheta, dvel, truth.model, truth.ellipsoid, truth.gravity, truth.coning
    )


def _epochs(scenario: Scenario, duration_s: float) -> TimeArray:
    """Sampling times, ns."""
    rate_hz = scenario.scenario.rate_hz
    samples = int(np.floor(duration_s * rate_hz * (1.0 + 1e-12))) + 1
    if not 2 <= samples <= _MOST_SAMPLES:
        raise _motion_error(scenario, "duration", f"{samples} samples; allowed are 2 to {_MOST_SAMPLES}")
    return np.asarray(np.rint(np.arange(samples) * (NS_PER_S / rate_hz)), dtype=np.int64)


def _planned_motion(scenario: Scenario, profile: Profile, t_ns: TimeArray) -> tuple[Array, Array, Array]:
    """Start, velocities and attitudes (roll, pitch, heading) of manoeuvres or waypoints."""
    motion = evaluate(profile, t_ns / NS_PER_S)
    _check_motion(scenario, motion)
    start = scenario.start
    lat_rad = start.lat_deg * DEG_TO_RAD
    ground_speed = motion.speed_m_s * np.cos(motion.path_angle_rad)
    course, yaw = motion.heading_rad, motion.yaw_rad
    if scenario.motion.heading_reference == "grid":
        convergence = grid_convergence(
            lat_rad,
            start.height_m,
            course,
            ground_speed,
            1.0 / scenario.scenario.rate_hz,
            scenario.truth.ellipsoid,
        )
        course, yaw = course + convergence, yaw + convergence
    down = -motion.speed_m_s * np.sin(motion.path_angle_rad)
    v_n = np.column_stack([ground_speed * np.cos(course), ground_speed * np.sin(course), down])
    rpy = np.column_stack([motion.roll_rad, motion.pitch_rad, yaw])
    return np.array([lat_rad, start.lon_deg * DEG_TO_RAD, start.height_m]), v_n, rpy


def _analytic_motion(scenario: Scenario, terms: Analytic, t_ns: TimeArray) -> tuple[Array, Array, Array]:
    """Start, velocities and attitudes of an analytic track.

    The velocities at the epochs are those of the closed form. Positions are what the strapdown step makes of
    them, which is the trapezoidal rule: they leave the closed form by no more than ``T^2/12`` times the change
    of acceleration since the start, a tenth of a millimetre at 50 Hz.
    """
    start, truth = scenario.start, scenario.truth
    constants = (start.lat_deg * DEG_TO_RAD, start.lon_deg * DEG_TO_RAD, start.height_m)
    motion = analytic.evaluate(
        terms, constants, t_ns / NS_PER_S, ellipsoid=truth.ellipsoid, gravity=truth.gravity
    )
    ground = motion.ground_speed_m_s
    least = _STEPS_FROM_REST * np.hypot(*motion.v_dot_n[:, :2].T) / scenario.scenario.rate_hz
    if np.any(ground <= least):
        row = int(np.argmin(ground - least))
        text = f"the ground speed falls to {ground[row]:.2g} m/s, too low for a heading along the velocity"
        raise _motion_error(
            scenario, "heading", f"{text}; with this rate it must exceed {least[row]:.2g} m/s"
        )
    roll, pitch, heading = motion.rpy.T
    steepest = float(np.abs(pitch).max())
    if steepest > _STEEPEST_RAD:
        text = f"the path is as steep as {np.degrees(steepest):.1f} deg; allowed are 80 deg"
        raise _motion_error(scenario, "slope", text)
    angles = {"roll": roll.copy(), "pitch": pitch.copy(), "heading": np.unwrap(heading)}
    add_sways(angles, t_ns / NS_PER_S, _sways(scenario))
    return motion.lla[0], motion.v_n, np.column_stack([angles["roll"], angles["pitch"], angles["heading"]])


def _check_motion(scenario: Scenario, motion: Motion) -> None:
    slowest = float(motion.speed_m_s.min())
    if slowest < -1e-9:
        raise _motion_error(
            scenario, "speed", f"the speed falls to {slowest:.3f} m/s; it must not be negative"
        )
    steepest = float(np.abs(motion.path_angle_rad).max())
    if steepest > _STEEPEST_RAD:
        text = f"the path is as steep as {np.degrees(steepest):.1f} deg; allowed are 80 deg"
        raise _motion_error(scenario, "slope", text)


def _check_poles(scenario: Scenario, lla: Array, step_m: Array) -> None:
    """Refuse tracks so close to a pole that velocities along north and east no longer say where they go."""
    _, prime_vertical = _core.radii(lla[:1, 0], scenario.truth.ellipsoid)[0]
    distance_m = prime_vertical * np.cos(lla[:, 0])
    nearest = int(np.argmin(distance_m - _STEPS_FROM_POLE * step_m))
    if distance_m[nearest] < _STEPS_FROM_POLE * step_m[nearest]:
        text = f"the track comes within {distance_m[nearest]:.1f} m of a pole"
        raise _motion_error(
            scenario,
            "pole",
            f"{text}; with this speed and rate it must keep {_STEPS_FROM_POLE * step_m[nearest]:.1f} m away",
        )


def _motion_error(scenario: Scenario, key: str, text: str) -> ConfigError:
    hint = _HINTS[key]
    return ConfigError(
        "config.motion", f"{scenario.name}: {text}", hint, {"scenario": scenario.name, "key": key}
    )
