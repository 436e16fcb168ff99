"""Columns for an INS without a filter: increments from any kind of IMU rows, outer heights at their stamps."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from gnssins.dataset import ImuTable
from gnssins.errors import InputError
from gnssins.units import NS_PER_S

__all__ = ["increments_after", "joined", "output_rows"]

Array = NDArray[np.float64]
Times = NDArray[np.int64]

#: Readings of an outer height further apart than so many usual intervals are not joined.
LONGEST_STEP: Final = 2.5


def increments_after(imu: ImuTable, start_ns: int) -> tuple[Times, Array, Array]:
    """Increments after the start: stamps (n,), angles (n, 3), velocities (n, 3); a cut interval gives its share."""
    first = int(np.searchsorted(imu.t_ns, start_ns, side="right"))
    if first >= len(imu):
        raise InputError(
            "input.empty",
            f"no IMU row after the initial state at {start_ns / NS_PER_S:.3f} s",
            "the initial state must lie within the IMU log",
        )
    t_ns = imu.t_ns[first:]
    before_ns = np.concatenate([[imu.t_ns[first - 1] if first else start_ns], t_ns[:-1]])
    whole_s = ((t_ns - before_ns) / NS_PER_S)[:, None]
    columns = []
    for values in (imu.gyro, imu.accel):
        part = values[first:]
        if imu.kind == "rates":
            part = 0.5 * (part + np.vstack([values[max(first - 1, 0)], part[:-1]]))
        columns.append(part if imu.kind == "increments" else part * whole_s)
    if first and before_ns[0] < start_ns:
        share = (t_ns[0] - start_ns) / (t_ns[0] - before_ns[0])
        columns = [np.vstack([share * column[:1], column[1:]]) for column in columns]
    return t_ns, np.ascontiguousarray(columns[0]), np.ascontiguousarray(columns[1])


def joined(t_ns: Times, have_ns: Times, values: Array) -> Array:
    """Readings joined by straight lines, NaN outside of them and across their gaps."""
    if have_ns.size < 2:
        return np.full(t_ns.size, np.nan)
    out = np.interp(t_ns - have_ns[0], have_ns - have_ns[0], values, left=np.nan, right=np.nan)
    step = np.diff(have_ns)
    after = np.clip(np.searchsorted(have_ns, t_ns), 1, have_ns.size - 1)
    if not np.isfinite(values).all():
        return joined(t_ns, have_ns[np.isfinite(values)], values[np.isfinite(values)])
    apart = step[after - 1] > LONGEST_STEP * np.median(step)
    return np.asarray(np.where(apart & (t_ns != have_ns[after]), np.nan, out))


def output_rows(t_ns: Times, interval_ns: int) -> NDArray[np.intp] | slice:
    """Last row at or before every multiple of the interval; all rows for 0."""
    if interval_ns <= 0:
        return slice(None)
    multiple = -(-t_ns // interval_ns)
    step = np.flatnonzero(np.diff(multiple) > 0)
    return np.asarray(np.append(step, t_ns.size - 1) if t_ns[-1] % interval_ns == 0 else step)
