"""Checks of time stamps: order, repeats, gaps, jitter, and whether the tables overlap."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..dataset import Dataset, Times
from ..units import NS_PER_S
from .findings import Finding

_GAP_STEPS = 3.0
"""A step longer than so many median steps is told as a short gap."""

_JITTER_SHARE = 0.2
"""Spread of the steps, as a share of the median step, above which the stamps are called uneven."""


def check_times(t_ns: Times, name: str, max_gap_s: float | None = None) -> Iterator[Finding]:
    """Look at the stamps of one table.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (n,)
        Stamps, ns.
    name : str
        Name of the table in messages, also its section of the configuration.
    max_gap_s : float, optional
        Configured limit of a gap, s; None for tables that may have gaps.

    Yields
    ------
    Finding
        ``time.backwards``, ``time.duplicate``, ``gap.long``, ``gap.short``, ``time.jitter``.
    """
    if t_ns.size < 2:
        return
    steps = np.diff(t_ns)
    yield from _order(t_ns, steps, name)
    forward = steps[steps > 0]
    if not forward.size:
        return
    median = float(np.median(forward)) / NS_PER_S
    if max_gap_s is not None:
        yield from _gaps(t_ns, steps, median, max_gap_s, name)
        spread = 1.4826 * float(np.median(np.abs(forward / NS_PER_S - median))) / median
        if spread > _JITTER_SHARE:
            yield Finding(
                "info",
                "time.jitter",
                f"{name}: steps between rows spread by {spread:.0%} of their median {1e3 * median:.2f} ms",
                "the stamps are used as they are; check that the logger stamps the sample, not its arrival",
                int(forward.size),
            )


def _order(t_ns: Times, steps: Times, name: str) -> Iterator[Finding]:
    back, same = np.flatnonzero(steps < 0), np.flatnonzero(steps == 0)
    if back.size:
        row = int(back[0]) + 1
        now, before = t_ns[row] / NS_PER_S, t_ns[row - 1] / NS_PER_S
        many = f", {back.size} such rows" if back.size > 1 else ""
        hint = 'set [imu] on_backwards = "sort" or "drop", or check the logger\'s clock'
        yield Finding(
            "warn",
            "time.backwards",
            f"{name} row {row + 1}: t = {now:.3f} s after {before:.3f} s ({1e3 * (now - before):.3g} "
            f"ms){many}",
            hint if name == "imu" else "check the logger's clock",
            int(back.size),
        )
    if same.size:
        row = int(same[0]) + 1
        yield Finding(
            "warn",
            "time.duplicate",
            f"{name}: {same.size} rows repeat the stamp of the row before, first row {row + 1} at "
            f"t = {t_ns[row] / NS_PER_S:.3f} s",
            "stamps of too few digits, or a logger that writes a sample twice",
            int(same.size),
        )


def _gaps(t_ns: Times, steps: Times, median: float, max_gap_s: float, name: str) -> Iterator[Finding]:
    seconds = steps / NS_PER_S
    long = np.flatnonzero(seconds > max_gap_s)
    short = np.flatnonzero((seconds > _GAP_STEPS * median) & (seconds <= max_gap_s))
    if long.size:
        first = int(long[0])
        yield Finding(
            "warn",
            "gap.long",
            f"{name}: {long.size} gaps longer than max_gap_s = {max_gap_s:g} s, first at "
            f"t = {t_ns[first] / NS_PER_S:.3f} s, longest {seconds.max():.3f} s",
            f'run the part between gaps (start_s, end_s), or set [{name}] on_gap = "bridge" or max_gap_s',
            int(long.size),
        )
    if short.size:
        worst = int(short[np.argmax(seconds[short])])
        yield Finding(
            "info",
            "gap.short",
            f"{name}: {short.size} steps longer than {_GAP_STEPS:g} times the median step {1e3 * median:.2f} "
            "ms, "
            f"longest {seconds[worst]:.3f} s at t = {t_ns[worst] / NS_PER_S:.3f} s",
            "short gaps are bridged",
            int(short.size),
        )


def check_overlap(dataset: Dataset, start_s: float | None) -> Iterator[Finding]:
    """Look whether IMU and GNSS, and the start of the run, lie on one stretch of time.

    Yields
    ------
    Finding
        ``time.no_overlap``, ``time.start_outside``.
    """
    imu, gnss = dataset.imu.t_ns, dataset.gnss.t_ns
    if not imu.size:
        return
    first, last = imu.min() / NS_PER_S, imu.max() / NS_PER_S
    span = f"imu {first:.3f} to {last:.3f} s"
    if start_s is not None and not first <= start_s < last:
        yield Finding(
            "stop",
            "time.start_outside",
            f"[run] start_s = {start_s:g} s is outside of the data: {span}",
            "start_s counts on the clock of the IMU log",
        )
    if gnss.size and (gnss.max() < imu.min() or gnss.min() > imu.max()):
        fixes = f"gnss {gnss.min() / NS_PER_S:.3f} to {gnss.max() / NS_PER_S:.3f} s"
        yield Finding(
            "stop",
            "time.no_overlap",
            f"no fix lies within the IMU data: {span}, {fixes}",
            "both logs must use one clock and the right time_unit",
            int(gnss.size),
        )
