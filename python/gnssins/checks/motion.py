"""Motion as windows of inertial samples and as steps between GNSS fixes show it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..dataset import Array, GnssTable, Times

_STEADY = 0.02
"""Spread of the specific force in a window, relative to its size, below which the window is steady."""

_MIN_SPEED_M_S = 3.0


@dataclass(frozen=True)
class Windows:
    """Statistics of windows of one second: mean times (s), rates, forces, and square of the force."""

    t_s: Array
    gyro: Array
    accel: Array
    accel_square: Array

    @property
    def steady(self) -> NDArray[np.bool_]:
        """Windows in which the specific force hardly changes."""
        size = np.linalg.norm(self.accel, axis=1)
        spread = np.sqrt(np.maximum(self.accel_square - (self.accel**2).sum(axis=1), 0.0))
        return np.asarray(spread < _STEADY * size)


@dataclass(frozen=True)
class Fit:
    """Straight line through the origin, y = slope x: slope, correlation, pairs."""

    slope: float
    correlation: float
    pairs: int


@dataclass(frozen=True)
class Steps:
    """Motion between fixes that move: gyro turn (rad), GNSS turn (rad), mean force and GNSS acceleration."""

    gyro_turn: Array
    course_turn: Array
    force: Array
    speed_gain: Array


@dataclass(frozen=True)
class Fixes:
    """Times of validity and velocities of fixes."""

    t_ns: Times
    v_n: Array


def fit(x: Array, y: Array) -> Fit:
    """Fit y = slope x by least squares; correlation about zero."""
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    if xx <= 0.0 or yy <= 0.0:
        return Fit(0.0, 0.0, x.size)
    return Fit(xy / xx, xy / float(np.sqrt(xx * yy)), x.size)


def rising(t_ns: Times) -> NDArray[np.bool_]:
    """Rows (n,) that are later than every row before them."""
    later = np.ones(t_ns.size, dtype=np.bool_)
    later[1:] = t_ns[1:] > np.maximum.accumulate(t_ns)[:-1]
    return later


def moving_fixes(gnss: GnssTable, latency_ns: int) -> Fixes:
    """Fixes with rising stamps and a horizontal speed that shows a course."""
    speed = np.hypot(gnss.v_n[:, 0], gnss.v_n[:, 1])
    use = rising(gnss.t_ns) & gnss.has_velocity & (speed > _MIN_SPEED_M_S)
    return Fixes(gnss.t_ns[use] - latency_ns, gnss.v_n[use])


def spans(t_s: Array, shortest: float, longest: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs of rows between ``shortest`` and ``longest`` seconds apart, end to end, without overlap."""
    ends = np.searchsorted(t_s, t_s + 0.999 * shortest).tolist()
    chain = [0] if ends else []
    while chain and ends[chain[-1]] < len(ends):
        chain.append(ends[chain[-1]])
    first, last = np.array(chain[:-1], dtype=np.intp), np.array(chain[1:], dtype=np.intp)
    near = t_s[last] - t_s[first] <= longest
    return first[near], last[near]
