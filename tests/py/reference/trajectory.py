"""Flight of the published 18-state filter in closed form: heading, pitch, roll and velocity."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import earth

Array = NDArray[np.float64]

SPEED = 30.0
START = (np.radians(30.68), np.radians(104.06), 150.0)
G0 = 9.80665
TURN_RAMP_S, SLOPE_RAMP_S = 5.0, 6.0
# start s, length s, rate deg/s
TURNS = [
    (200, 30, 2.0), (420, 45, -2.0), (650, 60, 1.5), (900, 60, 2.0), (1150, 45, -2.0),
    (1380, 60, -1.5), (1600, 30, 3.0), (1900, 40, -2.0), (2020, 30, 2.0), (2140, 30, -2.0),
    (2290, 45, 2.0), (2440, 30, -3.0), (2590, 60, -1.5), (2780, 60, 2.0),
]  # fmt: skip
# from s, to s, path angle deg
SLOPES = [
    (60, 180, 4.0), (300, 400, 3.0), (520, 620, -3.0), (760, 860, 5.0), (1000, 1100, -4.0),
    (1250, 1350, 4.0), (1480, 1580, -3.0), (1700, 1780, 3.0), (1950, 2010, -3.0), (2150, 2190, -2.0),
    (2230, 2280, -3.0), (2350, 2390, 3.0), (2540, 2580, 3.0), (2650, 2690, -3.0), (2850, 2950, -4.0),
]  # fmt: skip


def quintic(u: Any) -> Any:
    """Smooth step 10 u^3 - 15 u^4 + 6 u^5 held at 0 and 1 outside [0, 1]."""
    u = np.clip(u, 0.0, 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2)


def quintic_slope(u: Any) -> Any:
    """Derivative of `quintic`."""
    u = np.clip(u, 0.0, 1.0)
    return 30.0 * u**2 * (1.0 - u) ** 2


def quintic_integral(t: Any, ramp: float) -> Any:
    """Integral of quintic(t / ramp) from 0 to t (s)."""
    u = np.clip(t / ramp, 0.0, 1.0)
    inside = ramp * u**4 * (2.5 - 3.0 * u + u**2)
    return np.where(t > ramp, ramp / 2.0 + (t - ramp), inside)


def attitude_angles(t: Any) -> tuple[Any, Any, Any]:
    """Roll, pitch and heading (rad) at the times t (s); coordinated turns."""
    heading, heading_rate = np.radians(45.0) + 0.0 * t, 0.0 * t
    for start, length, rate in TURNS:
        r = np.radians(rate)
        for sign, t0 in ((1.0, start), (-1.0, start + length)):
            heading = heading + sign * r * quintic_integral(t - t0, TURN_RAMP_S)
            heading_rate = heading_rate + sign * r * quintic((t - t0) / TURN_RAMP_S)
    pitch, pitch_rate = 0.0 * t, 0.0 * t
    for begin, end, angle in SLOPES:
        a = np.radians(angle)
        for sign, t0 in ((1.0, begin), (-1.0, end)):
            pitch = pitch + sign * a * quintic((t - t0) / SLOPE_RAMP_S)
            pitch_rate = pitch_rate + sign * a * quintic_slope((t - t0) / SLOPE_RAMP_S) / SLOPE_RAMP_S
    roll = np.arctan2(SPEED * np.cos(pitch) * heading_rate, G0 * np.cos(pitch) + SPEED * pitch_rate)
    return roll, pitch, heading


def velocity_n(t: Any) -> Array:
    """Velocity (..., 3) in north-east-down, m/s."""
    _, pitch, heading = attitude_angles(t)
    return SPEED * np.stack(
        [np.cos(pitch) * np.cos(heading), np.cos(pitch) * np.sin(heading), -np.sin(pitch)], axis=-1
    )


def positions(until: float, dt: float) -> Array:
    """Latitude, longitude (rad) and height (m) at 0, dt, ... until: (k, 3), by the mean of two velocities."""
    t = np.arange(round(until / dt) + 1) * dt
    v = velocity_n(t)
    mean = (v[1:] + v[:-1]) / 2.0
    lat, lon, h = START
    out = [[lat, lon, h]]
    for vn, ve, vd in mean:
        rm, rn = earth.radii(lat)
        lat, lon, h = (
            lat + dt * vn / (rm + h),
            lon + dt * ve / ((rn + h) * np.cos(lat)),
            h - dt * vd,
        )
        out.append([lat, lon, h])
    return np.array(out)
