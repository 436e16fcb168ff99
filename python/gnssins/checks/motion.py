"""Window statistics of the inertial samples, and their comparison with the motion that GNSS shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..dataset import Array, GnssTable, ImuTable
from ..units import NS_PER_S

_WINDOW_S = 1.0
_STEADY = 0.02
"""Spread of the specific force in a window, relative to its size, below which the window is steady."""

_MIN_SPEED_M_S = 3.0
_MAX_STEP_S = 3.0


@dataclass(frozen=True)
class Rates:
    """Finite samples as rates.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
        Time since the first sample, s.
    gyro : ndarray, shape (n, 3)
        Angular rate, rad/s.
    accel : ndarray, shape (n, 3)
        Specific force, m/s^2.
    step_s : float
        Median step, s.
    """

    t_s: Array
    gyro: Array
    accel: Array
    step_s: float


@dataclass(frozen=True)
class Windows:
    """Statistics of windows of one second: centre times (s), mean rate and force, steady or not."""

    t_s: Array
    gyro: Array
    accel: Array
    steady: NDArray[np.bool_]


@dataclass(frozen=True)
class Fit:
    """Straight line through the origin, y = slope x: slope, correlation, pairs."""

    slope: float
    correlation: float
    pairs: int


def rising(t_s: Array) -> NDArray[np.bool_]:
    """Rows (n,) that are later than every row before them."""
    later = np.ones(t_s.size, dtype=np.bool_)
    later[1:] = t_s[1:] > np.maximum.accumulate(t_s)[:-1]
    return later


def as_rates(imu: ImuTable) -> Rates | None:
    """Bring finite samples with rising stamps to rates; None if there are too few to say anything."""
    t_s = (imu.t_ns - imu.t_ns[0]) / NS_PER_S if len(imu) else np.zeros(0)
    finite = np.isfinite(imu.gyro).all(axis=1) & np.isfinite(imu.accel).all(axis=1)
    use = rising(t_s) & finite
    if use.sum() < 10:
        return None
    t_s, gyro, accel = t_s[use], imu.gyro[use], imu.accel[use]
    steps = np.diff(t_s)
    step = float(np.median(steps))
    if imu.kind == "increments":
        every = np.concatenate(([step], np.minimum(steps, 3.0 * step)))[:, None]
        gyro, accel = gyro / every, accel / every
    return Rates(t_s, gyro, accel, step)


def windows(rates: Rates) -> Windows:
    """Cut the samples into windows of one second with at least five samples each."""
    index = np.floor(rates.t_s / _WINDOW_S).astype(np.int64)
    starts = np.flatnonzero(np.diff(index, prepend=index[0] - 1))
    counts = np.diff(np.append(starts, index.size))

    def mean(values: Array) -> Array:
        return np.add.reduceat(values, starts, axis=0) / counts.reshape((-1,) + (1,) * (values.ndim - 1))

    force = mean(rates.accel)
    spread = np.sqrt(np.maximum(mean((rates.accel**2).sum(axis=1)) - (force**2).sum(axis=1), 0.0))
    size = np.linalg.norm(force, axis=1)
    full = counts >= 5
    steady = (spread < _STEADY * size)[full]
    return Windows(mean(rates.t_s)[full], mean(rates.gyro)[full], force[full], steady)


def fit(x: Array, y: Array) -> Fit:
    """Fit y = slope x by least squares; correlation about zero."""
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    if xx <= 0.0 or yy <= 0.0:
        return Fit(0.0, 0.0, x.size)
    return Fit(xy / xx, xy / float(np.sqrt(xx * yy)), x.size)


@dataclass(frozen=True)
class Steps:
    """Motion between fixes that move: gyro turn (rad), GNSS turn (rad), mean force and GNSS acceleration."""

    gyro_turn: Array
    course_turn: Array
    force: Array
    speed_gain: Array


def steps_between_fixes(rates: Rates, imu: ImuTable, gnss: GnssTable, up_b: Array, latency_ns: int) -> Steps:
    """Compare gyro and accelerometer with the course and speed of consecutive fixes.

    Parameters
    ----------
    rates : Rates
        The samples.
    imu : ImuTable
        The table behind them, for its first stamp.
    gnss : GnssTable
        The fixes; only those with horizontal velocity count.
    up_b : ndarray, shape (3,)
        Unit vector up in body axes: the mean direction of the specific force.
    latency_ns : int
        Taken off the stamps of the fixes.

    Returns
    -------
    Steps
        One row per pair of fixes at least one second apart, both faster than 3 m/s: turn about down by gyro
        and by GNSS, mean specific force (m/s^2), gain of horizontal speed per second (m/s^2).
    """
    t_s = (gnss.t_ns - latency_ns - imu.t_ns[0]) / NS_PER_S
    speed = np.hypot(gnss.v_n[:, 0], gnss.v_n[:, 1])
    use = (
        rising(t_s)
        & gnss.has_velocity
        & (speed > _MIN_SPEED_M_S)
        & (t_s > rates.t_s[0])
        & (t_s < rates.t_s[-1])
    )
    t_s, v_n, speed = t_s[use], gnss.v_n[use], speed[use]
    first, last = spans(t_s, _WINDOW_S, _MAX_STEP_S)
    dt = t_s[last] - t_s[first]
    course = np.arctan2(v_n[:, 1], v_n[:, 0])
    turn = course[last] - course[first]
    turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
    down_rate = -(rates.gyro @ up_b)
    angle = integral(rates.t_s, down_rate[:, None])[:, 0]
    gyro_turn = np.interp(t_s[last], rates.t_s, angle) - np.interp(t_s[first], rates.t_s, angle)
    velocity = integral(rates.t_s, rates.accel)
    gain = np.column_stack([np.interp(t_s, rates.t_s, velocity[:, axis]) for axis in range(3)])
    force = (gain[last] - gain[first]) / dt[:, None]
    return Steps(gyro_turn, turn, force, (speed[last] - speed[first]) / dt)


def spans(t_s: Array, shortest: float, longest: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs of rows between ``shortest`` and ``longest`` seconds apart, end to end, without overlap."""
    first, last = [], []
    start = 0
    while start < t_s.size:
        end = int(np.searchsorted(t_s, t_s[start] + 0.999 * shortest))
        if end >= t_s.size:
            break
        if t_s[end] - t_s[start] <= longest:
            first.append(start)
            last.append(end)
        start = end
    return np.array(first, dtype=np.intp), np.array(last, dtype=np.intp)


def integral(t_s: Array, values: Array) -> Array:
    """Cumulative trapezoid."""
    mean = 0.5 * (values[1:] + values[:-1]) * np.diff(t_s)[:, None]
    return np.vstack([np.zeros((1, values.shape[1])), np.cumsum(mean, axis=0)])
