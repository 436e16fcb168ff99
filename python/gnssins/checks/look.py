"""One pass over the inertial samples: counters and sums that the checks judge. Takes a log whole or in pieces."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..config import Config
from ..dataset import Array, GnssTable, ImuTable, Times
from ..units import DEG_TO_RAD, NS_PER_S, STANDARD_GRAVITY_M_S2, ms_to_ns
from .motion import Steps, Windows, moving_fixes, spans
from .timing import BLOCK_ROWS, StampLook

__all__ = ["FASTEST_RAD_S", "ImuLook"]

FASTEST_RAD_S: Final = 70.0
"""No gyro on the market reads so much (4000 deg/s)."""

_LEAST_ROWS = 10
"""Usable rows below which nothing is said about units and axes."""

_LEAST_IN_WINDOW = 5

_LONGEST_STEP_S = 3.0
"""Fixes further apart are not compared with what the IMU did in between."""


class ImuLook:
    """What the checks need to know of an IMU log; :meth:`add` takes it whole or in pieces.

    Only the usual step between rows is that of the start of the log; all else is of all rows so far.

    Attributes
    ----------
    stamps : StampLook
        Order, gaps and span of the stamps.
    rows, bad, first_bad : int
        Rows; those with a missing or infinite value, and the first of them, from 0.
    saturated : dict of str to int
        Rows at or beyond the range of ``"gyro"`` and ``"accel"``, where the configuration knows it.
    repeated : int
        Rows that repeat all six values of the row before.
    used : int
        Finite rows with rising stamps: those that the sums are of.
    too_fast, fastest_rad_s
        Angular rates beyond :data:`FASTEST_RAD_S`, and the largest.
    """

    def __init__(self, kind: str, gnss: GnssTable, config: Config | None) -> None:
        self.kind = kind
        self.stamps = StampLook("imu", 1.0 if config is None else config.imu.max_gap_s)
        self.rows = self.bad = self.first_bad = self.repeated = self.used = self.too_fast = 0
        self.fastest_rad_s = 0.0
        self.limits: dict[str, float] = {}
        if config is not None and kind != "increments":
            ranges = {
                "gyro": (config.imu.gyro.range_deg_s, DEG_TO_RAD),
                "accel": (config.imu.accel.range_g, STANDARD_GRAVITY_M_S2),
            }
            self.limits = {
                name: 0.999 * limit * factor for name, (limit, factor) in ranges.items() if limit is not None
            }
        self.saturated = dict.fromkeys(self.limits, 0)
        latency_ns = 0 if config is None else ms_to_ns(config.gnss.latency_ms)
        self._fixes = moving_fixes(gnss, latency_ns)
        self._integrals = np.full((self._fixes.t_ns.size, 6), np.nan)
        self._integral = np.zeros(6)
        self._last: Array | None = None
        self._last_used: tuple[int, Array] | None = None
        self._sums: list[tuple[NDArray[np.int64], Array]] = []

    @property
    def step_s(self) -> float:
        """Usual step between rows, s."""
        return self.stamps.step_s

    def add(self, imu: ImuTable) -> None:
        """Take the next rows of the log."""
        self.stamps.add(imu.t_ns)
        for first in range(0, len(imu), BLOCK_ROWS):
            rows = slice(first, first + BLOCK_ROWS)
            values = np.hstack([imu.gyro[rows], imu.accel[rows]])
            self._count(values, imu.t_ns[rows])
            self.rows += len(values)

    def _count(self, values: Array, t_ns: Times) -> None:
        """Count bad, saturated and repeated rows; pass the usable ones on."""
        for name, part in (("gyro", values[:, :3]), ("accel", values[:, 3:])):
            limit = self.limits.get(name)
            if limit is not None and not (part.max() < limit and part.min() > -limit):
                self.saturated[name] += int((np.abs(part) >= limit).any(axis=1).sum())
        before = values if self._last is None else np.vstack([self._last, values])
        same = np.flatnonzero(before[1:, 0] == before[:-1, 0])
        self.repeated += int((before[same] == before[same + 1]).all(axis=1).sum())
        self._last = values[-1:]
        latest = np.iinfo(np.int64).min if self._last_used is None else self._last_used[0]
        use = np.ones(len(values), dtype=np.bool_)
        if not np.isfinite(values.sum()):  # a sum that overflows only costs the closer look
            use[:] = np.isfinite(values).all(axis=1)
            if not use.all() and not self.bad:
                self.first_bad = self.rows + int(np.argmin(use))
            self.bad += int((~use).sum())
        if t_ns[0] <= latest or (np.diff(t_ns) <= 0).any():
            high = np.maximum(np.maximum.accumulate(t_ns), latest)
            use &= t_ns > np.concatenate([[latest], high[:-1]])
        if use.all():
            self._sum(values, t_ns)
        elif use.any():
            self._sum(values[use], t_ns[use])

    def _sum(self, values: Array, t_ns: Times) -> None:
        """Add usable rows to the windows of one second and to the integrals up to the fixes."""
        self.used += len(values)
        usual_s = self.step_s if self.step_s > 0.0 else 1.0
        if self._last_used is None:
            self.first_used_ns = int(t_ns[0])
        before_ns = (
            int(t_ns[0]) - round(usual_s * NS_PER_S) if self._last_used is None else self._last_used[0]
        )
        steps_s = np.diff(t_ns, prepend=before_ns) / NS_PER_S
        if self.kind == "increments":
            values = values / np.minimum(steps_s, 3.0 * usual_s)[:, None]
        gyro = values[:, :3]
        high, low = float(gyro.max()), float(gyro.min())
        self.fastest_rad_s = max(self.fastest_rad_s, high, -low)
        if max(high, -low) > FASTEST_RAD_S:
            self.too_fast += int((np.abs(gyro) > FASTEST_RAD_S).sum())
        self._add_windows(values, t_ns)
        if self._last_used is None:
            self._integrate(values, t_ns, steps_s[1:])
        else:
            before_ns, before = self._last_used
            joined = np.concatenate([before, values]), np.concatenate([[before_ns], t_ns])
            self._integrate(*joined, steps_s)
        self._last_used = int(t_ns[-1]), values[-1:]

    def _add_windows(self, values: Array, t_ns: Times) -> None:
        """Sums per second since the first usable row: rows, time, six values, square of the specific force."""
        since = t_ns - self.first_used_ns
        seconds = np.arange(since[0] // NS_PER_S, since[-1] // NS_PER_S + 1)
        starts = np.searchsorted(since, seconds * NS_PER_S)
        full = np.diff(starts, append=t_ns.size) > 0
        seconds, starts = seconds[full], starts[full]
        force = values[:, 3:]
        square = np.einsum("ki,ki->k", force, force)
        columns = (
            np.diff(starts, append=t_ns.size),
            np.add.reduceat(since / NS_PER_S, starts),
            *np.add.reduceat(values, starts, axis=0).T,
            np.add.reduceat(square, starts),
        )
        self._sums.append((seconds, np.column_stack(columns)))

    def _integrate(self, values: Array, t_ns: Times, steps_s: Array) -> None:
        """Trapezoids from the first usable row on, read off at the fixes that lie in these rows."""
        if t_ns.size < 2:
            return
        pieces = (values[1:] + values[:-1]) * (0.5 * steps_s)[:, None]
        fix_ns = self._fixes.t_ns
        fixes = slice(*np.searchsorted(fix_ns, [t_ns[0], t_ns[-1]]))
        at = np.searchsorted(t_ns, fix_ns[fixes], side="right") - 1
        starts = np.unique(np.concatenate([[0], at]))
        sums = np.cumsum(np.add.reduceat(pieces, starts, axis=0), axis=0)
        up_to = self._integral + np.vstack([np.zeros(6), sums[:-1]])
        share = (fix_ns[fixes] - t_ns[at]) / (t_ns[at + 1] - t_ns[at])
        self._integrals[fixes] = up_to[np.searchsorted(starts, at)] + pieces[at] * share[:, None]
        self._integral = self._integral + sums[-1]

    def windows(self) -> Windows | None:
        """Statistics of the seconds with at least five samples; None if there are too few samples to say anything."""
        if self.used < _LEAST_ROWS:
            return None
        seconds = np.concatenate([second for second, _ in self._sums])
        sums = np.concatenate([part for _, part in self._sums])
        starts = np.flatnonzero(np.diff(seconds, prepend=seconds[0] - 1))
        sums = np.add.reduceat(sums, starts, axis=0)  # seconds that two blocks share
        sums = sums[sums[:, 0] >= _LEAST_IN_WINDOW]
        mean = sums[:, 1:] / sums[:, :1]
        return Windows(mean[:, 0], mean[:, 1:4], mean[:, 4:7], mean[:, 7])

    def steps(self, up_b: Array) -> Steps:
        """Motion between consecutive fixes by IMU and by GNSS.

        Parameters
        ----------
        up_b : ndarray, shape (3,)
            Unit vector up in body axes: the mean direction of the specific force.

        Returns
        -------
        Steps
            One row per pair of moving fixes at least one second apart: turn about down by gyro and by GNSS, mean
            specific force (m/s^2), gain of horizontal speed per second (m/s^2).
        """
        inside = np.isfinite(self._integrals).all(axis=1) & (self._fixes.t_ns > self.first_used_ns)
        t_s, v_n = (self._fixes.t_ns[inside] - self.first_used_ns) / NS_PER_S, self._fixes.v_n[inside]
        integral, speed = self._integrals[inside], np.hypot(v_n[:, 0], v_n[:, 1])
        first, last = spans(t_s, 1.0, _LONGEST_STEP_S)
        dt = t_s[last] - t_s[first]
        course = np.arctan2(v_n[:, 1], v_n[:, 0])
        turn = (course[last] - course[first] + np.pi) % (2.0 * np.pi) - np.pi
        moved = integral[last] - integral[first]
        return Steps(
            -(moved[:, :3] @ up_b), turn, moved[:, 3:] / dt[:, None], (speed[last] - speed[first]) / dt
        )
