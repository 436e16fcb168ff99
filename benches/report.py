"""Numbers with their spread, comparisons, and Markdown."""

from __future__ import annotations

import statistics
import textwrap
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

#: In the place of a number that was not measured.
ABSENT = "–"


@dataclass(frozen=True)
class Measured:
    """Median of several runs and the median distance from it, s."""

    median: float
    spread: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Measured:
        median = statistics.median(values)
        return cls(median, statistics.median(abs(v - median) for v in values))

    def __mul__(self, factor: float) -> Measured:
        return Measured(self.median * factor, self.spread * factor)

    def __truediv__(self, by: float) -> Measured:
        return self * (1.0 / by)

    def __sub__(self, other: Measured) -> Measured:
        return Measured(self.median - other.median, self.spread + other.spread)

    def ns(self) -> str:
        return f"{1e9 * self.median:.0f} ± {1e9 * self.spread:.0f}"

    def s(self) -> str:
        return f"{self.median:.3f} ± {self.spread:.3f}"


def timed(work: Callable[[], object], times: int) -> Measured:
    """Wall time of some work, after one run that does not count."""
    work()
    return Measured.of([_once(work) for _ in range(times)])


def _once(work: Callable[[], object]) -> float:
    clock = time.perf_counter()
    work()
    return time.perf_counter() - clock


@dataclass
class Report:
    """The page as it grows, and who was faster where."""

    lines: list[str] = field(default_factory=list)
    losses: list[str] = field(default_factory=list)

    def section(self, title: str, *text: str) -> None:
        """Heading and paragraphs, wrapped."""
        self.lines += [f"## {title}", "", *(line for t in text for line in (*textwrap.wrap(t, 130), ""))]

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        self.lines += [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
        self.lines += [f"| {' | '.join(row)} |" for row in rows] + [""]

    def against(self, what: str, ours: Measured, other: str, theirs: Measured) -> str:
        """How many times faster ours is; below 1 it is listed among the losses."""
        ratio = theirs.median / ours.median
        if ratio < 1.0:
            self.losses.append(f"{what}: {other} is {1.0 / ratio:.2f} times faster")
        return f"{ratio:.3g}"
