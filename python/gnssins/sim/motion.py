"""Prescribed motion in closed form: heading, path angle and speed against time.

Every manoeuvre is built from the quintic step S(x) = 10 x^3 - 15 x^4 + 6 x^5 (0 before, 1 after), which has
continuous first and second derivatives. A *pulse* is a step up followed by the same step down ``length_s``
later; its integral is exact, so a turn of rate r and length n changes the heading by r n to the last digit,
however long the ramp is. Manoeuvres add up, so they may overlap in time.

Angles are in radians, headings clockwise from north, path angles positive upward.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gnssins.units import STANDARD_GRAVITY_M_S2

__all__ = ["Motion", "Profile", "Pulse", "Step", "Sway", "add_step_integral", "add_sways", "evaluate"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Step:
    """A change of ``change`` that starts at ``start_s`` and takes ``ramp_s`` (zero: at once)."""

    start_s: float
    ramp_s: float
    change: float


@dataclass(frozen=True)
class Pulse:
    """A value that ramps up from ``start_s`` on and ramps down from ``start_s + length_s`` on."""

    start_s: float
    length_s: float
    ramp_s: float
    value: float

    def steps(self) -> tuple[Step, Step]:
        """Give the step up and the step down that make the pulse."""
        return (
            Step(self.start_s, self.ramp_s, self.value),
            Step(self.start_s + self.length_s, self.ramp_s, -self.value),
        )


@dataclass(frozen=True)
class Sway:
    """Oscillation of one attitude angle under a smooth envelope (a ship at sea, a hand, a gust)."""

    axis: Literal["roll", "pitch", "heading"]
    amplitude_rad: float
    period_s: float
    phase_rad: float
    envelope: Pulse


@dataclass(frozen=True)
class Profile:
    """Motion as sums of steps and pulses.

    Parameters
    ----------
    heading_rad, speed_m_s : float
        Values at time zero.
    turns : tuple of Pulse
        Rate of the heading (rad/s).
    speeds : tuple of Step
        Changes of speed (m/s).
    climbs : tuple of Pulse
        Path angle (rad) if ``speed_of`` is ``"path"``, vertical speed (m/s, up) if it is ``"ground"``.
    sways : tuple of Sway
        Attitude oscillations about the attitude that the path gives.
    speed_of : {"path", "ground"}
        Whether the speed is measured along the path or over the ground.
    coordination : float
        Share of the coordinated bank: 1 for an aircraft, 0 for a vehicle that stays level in turns.
    """

    heading_rad: float
    speed_m_s: float
    turns: tuple[Pulse, ...] = ()
    speeds: tuple[Step, ...] = ()
    climbs: tuple[Pulse, ...] = ()
    sways: tuple[Sway, ...] = ()
    speed_of: Literal["path", "ground"] = "path"
    coordination: float = 1.0


@dataclass(frozen=True)
class Motion:
    """A profile evaluated at given times; all arrays (n,).

    ``heading_rad`` is the course and is continuous (not wrapped). ``roll_rad``, ``pitch_rad`` and ``yaw_rad``
    are the attitude, equal to bank, path angle and course when nothing sways.
    """

    heading_rad: Array
    path_angle_rad: Array
    speed_m_s: Array
    roll_rad: Array
    pitch_rad: Array
    yaw_rad: Array


def add_step(out: Array, t_s: Array, step: Step) -> None:
    """Add ``change * S((t - start)/ramp)`` in place; ``t_s`` ascends."""
    first, last = np.searchsorted(t_s, (step.start_s, step.start_s + step.ramp_s), side="left")
    x = (t_s[first:last] - step.start_s) / step.ramp_s if step.ramp_s > 0.0 else t_s[first:last]
    out[first:last] += step.change * (x * x * x * (10.0 + x * (6.0 * x - 15.0)))
    out[last:] += step.change


def add_step_rate(out: Array, t_s: Array, step: Step) -> None:
    """Add the time derivative of the step in place; a step without ramp has none to add."""
    if step.ramp_s <= 0.0:
        return
    first, last = np.searchsorted(t_s, (step.start_s, step.start_s + step.ramp_s), side="left")
    x = (t_s[first:last] - step.start_s) / step.ramp_s
    out[first:last] += (step.change / step.ramp_s) * (30.0 * x * x * (1.0 - x) ** 2)


def add_step_integral(out: Array, t_s: Array, step: Step) -> None:
    """Add ``change * J(t - start)`` in place, J being the integral of S from the start of the step on."""
    first, last = np.searchsorted(t_s, (step.start_s, step.start_s + step.ramp_s), side="left")
    if step.ramp_s > 0.0:
        x = (t_s[first:last] - step.start_s) / step.ramp_s
        out[first:last] += step.change * step.ramp_s * (x**4 * (2.5 + x * (x - 3.0)))
    out[last:] += step.change * (t_s[last:] - step.start_s - 0.5 * step.ramp_s)


def _sum_of_pulses(t_s: Array, pulses: tuple[Pulse, ...]) -> tuple[Array, Array]:
    """Sum of pulses and its time derivative."""
    value, rate = np.zeros_like(t_s), np.zeros_like(t_s)
    for pulse in pulses:
        for step in pulse.steps():
            add_step(value, t_s, step)
            add_step_rate(rate, t_s, step)
    return value, rate


def evaluate(profile: Profile, t_s: Array) -> Motion:
    """Heading, path angle, speed and attitude of a profile.

    The bank of a coordinated turn is ``atan2(V cos(theta) psi', g0 cos(theta) + V theta')``: the specific
    force then lies in the plane of symmetry. ``coordination`` scales it. Pitch follows the path angle.

    Parameters
    ----------
    profile : Profile
        What moves when.
    t_s : ndarray, shape (n,)
        Times since the start, seconds, ascending.

    Returns
    -------
    Motion
        Arrays of shape (n,).
    """
    heading = np.full_like(t_s, profile.heading_rad)
    turn_rate = np.zeros_like(t_s)
    for pulse in profile.turns:
        for step in pulse.steps():
            add_step_integral(heading, t_s, step)
            add_step(turn_rate, t_s, step)
    speed = np.full_like(t_s, profile.speed_m_s)
    speed_rate = np.zeros_like(t_s)
    for step in profile.speeds:
        add_step(speed, t_s, step)
        add_step_rate(speed_rate, t_s, step)
    climb, climb_rate = _sum_of_pulses(t_s, profile.climbs)
    if profile.speed_of == "ground":
        path_angle, path_rate, speed = _path_of_ground_motion(speed, speed_rate, climb, climb_rate)
    else:
        path_angle, path_rate = climb, climb_rate
    cos_path = np.cos(path_angle)
    roll = np.arctan2(speed * cos_path * turn_rate, STANDARD_GRAVITY_M_S2 * cos_path + speed * path_rate)
    angles = {"roll": profile.coordination * roll, "pitch": path_angle.copy(), "heading": heading.copy()}
    add_sways(angles, t_s, profile.sways)
    return Motion(heading, path_angle, speed, angles["roll"], angles["pitch"], angles["heading"])


def add_sways(angles: Mapping[str, Array], t_s: Array, sways: tuple[Sway, ...]) -> None:
    """Add oscillations to the roll, pitch and heading (rad), in place."""
    for sway in sways:
        envelope, _ = _sum_of_pulses(t_s, (sway.envelope,))
        phase = (2.0 * np.pi / sway.period_s) * (t_s - sway.envelope.start_s) + sway.phase_rad
        angles[sway.axis] += sway.amplitude_rad * envelope * np.sin(phase)


def _path_of_ground_motion(
    ground: Array, ground_rate: Array, climb: Array, climb_rate: Array
) -> tuple[Array, Array, Array]:
    """Path angle, its rate and the path speed from ground speed and vertical speed."""
    square = ground * ground + climb * climb
    moving = square > 0.0
    rate = np.divide(
        climb_rate * ground - climb * ground_rate, square, out=np.zeros_like(square), where=moving
    )
    return np.arctan2(climb, ground), rate, np.sqrt(square)
