"""Checks of time stamps: order, repeats, gaps, jitter, and whether the tables overlap."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..dataset import GnssTable, Times
from ..units import NS_PER_S
from .findings import Finding

_GAP_STEPS = 3.0
"""A step longer than so many median steps is told as a short gap."""

BLOCK_ROWS: Final = 8192
"""Rows looked at in one go: their temporary arrays stay in the cache."""

_JUDGED_ROWS = 100_000

_JITTER_SHARE = 0.2
"""Spread of the steps, as a share of the median step, above which the stamps are called uneven."""


class StampLook:
    """A look at the stamps of one table, whole or in pieces.

    The usual step and the unevenness are those of the first hundred thousand rows (of the first piece, if that is
    shorter); order and gaps are of all stamps so far.

    Parameters
    ----------
    name : str
        Name of the table in messages, also its section of the configuration.
    max_gap_s : float, optional
        Configured limit of a gap, s; None for tables that may have gaps.

    Attributes
    ----------
    step_s : float
        Median step forward, s; NaN if there is none.
    span_ns : tuple of int, or None
        Earliest and latest stamp; None without any.
    """

    def __init__(self, name: str, max_gap_s: float | None = None) -> None:
        self.name = name
        self.max_gap_s = max_gap_s
        self.step_s = self._spread = float("nan")
        self.span_ns: tuple[int, int] | None = None
        self._rows = self._judged = 0
        self._last: Times = np.zeros(0, dtype=np.int64)
        self._back, self._same, self._long, self._short = _Tally(), _Tally(), _Tally(), _Tally()

    def add(self, t_ns: Times) -> None:
        """Take the next stamps."""
        if np.isnan(self.step_s):
            self._judge_steps(np.diff(t_ns[:_JUDGED_ROWS]))
        for first in range(0, t_ns.size, BLOCK_ROWS):
            self._add(t_ns[first : first + BLOCK_ROWS])

    def _add(self, t_ns: Times) -> None:
        low, high = int(t_ns.min()), int(t_ns.max())
        span = (low, high) if self.span_ns is None else self.span_ns
        self.span_ns = (min(low, span[0]), max(high, span[1]))
        joined = np.concatenate([self._last, t_ns])
        steps = np.diff(joined)
        first = self._rows - self._last.size
        self._rows, self._last = self._rows + t_ns.size, t_ns[-1:]
        if not steps.size:
            return
        if steps.min() <= 0:
            self._back.add(steps < 0, joined, steps, first)
            self._same.add(steps == 0, joined, steps, first)
        if self.max_gap_s is None or np.isnan(self.step_s):
            return
        short = min(_GAP_STEPS * self.step_s, self.max_gap_s)
        if steps.max() > short * NS_PER_S:
            seconds = steps / NS_PER_S
            long = seconds > self.max_gap_s
            self._long.add(long, joined, steps, first)
            self._short.add((seconds > _GAP_STEPS * self.step_s) & ~long, joined, steps, first)

    def _judge_steps(self, steps: Times) -> None:
        forward = steps[steps > 0]
        if forward.size:
            median = np.median(forward)
            self.step_s = float(median) / NS_PER_S
            self._spread = 1.4826 * float(np.median(np.abs(forward - median))) / float(median)
            self._judged = forward.size

    def findings(self) -> Iterator[Finding]:
        """Tell what was seen.

        Yields
        ------
        Finding
            ``time.backwards``, ``time.duplicate``, ``gap.long``, ``gap.short``, ``time.jitter``.
        """
        yield from self._order()
        if self.max_gap_s is None:
            return
        yield from self._gaps(self.max_gap_s)
        if self._spread > _JITTER_SHARE:
            yield Finding(
                "info",
                "time.jitter",
                f"{self.name}: steps between rows spread by {self._spread:.0%} of their median "
                f"{1e3 * self.step_s:.2f} ms",
                "the stamps are used as they are; check that the logger stamps the sample, not its arrival",
                self._judged,
            )

    def _order(self) -> Iterator[Finding]:
        name, back, same = self.name, self._back, self._same
        if back.count:
            now, before = back.after_ns / NS_PER_S, back.before_ns / NS_PER_S
            many = f", {back.count} such rows" if back.count > 1 else ""
            hint = 'set [imu] on_backwards = "sort" or "drop", or check the logger\'s clock'
            yield Finding(
                "warn",
                "time.backwards",
                f"{name} row {back.row + 1}: t = {now:.3f} s after {before:.3f} s ({1e3 * (now - before):.3g} "
                f"ms){many}",
                hint if name == "imu" else "check the logger's clock",
                back.count,
            )
        if same.count:
            yield Finding(
                "warn",
                "time.duplicate",
                f"{name}: {same.count} rows repeat the stamp of the row before, first row {same.row + 1} at "
                f"t = {same.after_ns / NS_PER_S:.3f} s",
                "stamps of too few digits, or a logger that writes a sample twice",
                same.count,
            )

    def _gaps(self, max_gap_s: float) -> Iterator[Finding]:
        name, long, short = self.name, self._long, self._short
        if long.count:
            yield Finding(
                "warn",
                "gap.long",
                f"{name}: {long.count} gaps longer than max_gap_s = {max_gap_s:g} s, first at "
                f"t = {long.before_ns / NS_PER_S:.3f} s, longest {long.longest_ns / NS_PER_S:.3f} s",
                f'run the part between gaps (start_s, end_s), or set [{name}] on_gap = "bridge" or max_gap_s',
                long.count,
            )
        if short.count:
            yield Finding(
                "info",
                "gap.short",
                f"{name}: {short.count} steps longer than {_GAP_STEPS:g} times the median step "
                f"{1e3 * self.step_s:.2f} ms, longest {short.longest_ns / NS_PER_S:.3f} s at "
                f"t = {short.longest_at_ns / NS_PER_S:.3f} s",
                "short gaps are bridged",
                short.count,
            )


@dataclass
class _Tally:
    """Steps of one sort: how many, the row after the first and the stamps around it, the longest and its start."""

    count: int = 0
    row: int = 0
    before_ns: int = 0
    after_ns: int = 0
    longest_ns: int = 0
    longest_at_ns: int = 0

    def add(self, which: NDArray[np.bool_], t_ns: Times, steps: Times, first: int) -> None:
        """Count the steps ``which`` between the stamps ``t_ns``, the first of which is row ``first``."""
        at = np.flatnonzero(which)
        if not at.size:
            return
        if not self.count:
            self.row = first + int(at[0]) + 1
            self.before_ns, self.after_ns = int(t_ns[at[0]]), int(t_ns[at[0] + 1])
        worst = int(at[np.argmax(steps[at])])
        if int(steps[worst]) > self.longest_ns:
            self.longest_ns, self.longest_at_ns = int(steps[worst]), int(t_ns[worst])
        self.count += at.size


def check_times(t_ns: Times, name: str, max_gap_s: float | None = None) -> Iterator[Finding]:
    """Look at all stamps of one table at once; see :class:`StampLook`."""
    look = StampLook(name, max_gap_s)
    look.add(t_ns)
    yield from look.findings()


def check_overlap(
    span_ns: tuple[int, int] | None, gnss: GnssTable, start_s: float | None
) -> Iterator[Finding]:
    """Look whether IMU and GNSS, and the start of the run, lie on one stretch of time.

    Yields
    ------
    Finding
        ``time.no_overlap``, ``time.start_outside``.
    """
    if span_ns is None:
        return
    first, last = span_ns[0] / NS_PER_S, span_ns[1] / NS_PER_S
    span = f"imu {first:.3f} to {last:.3f} s"
    if start_s is not None and not first <= start_s < last:
        yield Finding(
            "stop",
            "time.start_outside",
            f"[run] start_s = {start_s:g} s is outside of the data: {span}",
            "start_s counts on the clock of the IMU log",
        )
    if len(gnss) and (gnss.t_ns.max() < span_ns[0] or gnss.t_ns.min() > span_ns[1]):
        fixes = f"gnss {gnss.t_ns.min() / NS_PER_S:.3f} to {gnss.t_ns.max() / NS_PER_S:.3f} s"
        yield Finding(
            "stop",
            "time.no_overlap",
            f"no fix lies within the IMU data: {span}, {fixes}",
            "both logs must use one clock and the right time_unit",
            len(gnss),
        )
