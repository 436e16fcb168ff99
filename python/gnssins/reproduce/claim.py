"""One figure beside what was wanted of it and what was published, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, TypedDict, get_args

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import text

__all__ = ["Claim", "Sense", "Spread", "plain", "rms", "spread", "with_scatter"]

#: Runs from which on the scatter of a root mean square (10 %) no longer decides about a claim.
ENOUGH: Final = 50

#: Smallest factor that is called better and not just reached: what one decimal shows as 1.1.
_BETTER: Final = 1.05

Sense = Literal["at most", "at least", "within", "equal", "beside"]


@dataclass(frozen=True)
class Claim:
    """One figure of ours beside what was wanted and what was published.

    Parameters
    ----------
    key : str
        Stable short name such as ``"position_north"``; unique in a reproduction.
    text : str
        What is claimed, for a reader, without the numbers.
    unit : str
        Unit of every number here; empty for a pure number.
    ours : float
        Measured. NaN: it could not be measured, which counts as missed.
    target : float, optional
        What was wanted. Left out: the published figure takes its place; without that either, nothing is judged.
    sense : {"at most", "at least", "within", "equal", "beside"}
        How ``ours`` has to stand to the target; ``"within"`` takes ``low`` and ``high`` instead of a target, and
        ``"beside"`` judges nothing: the published figure belongs to other conditions.
    low, high : float, optional
        Bounds of ``"within"``, both included; one of them may be left open.
    published : float, optional
        Figure of the publication.
    sigma : float, optional
        What the filter itself claimed, one standard deviation (root mean square over the runs).
    median, p95 : float, optional
        Of the absolute value over the runs, beside a root mean square in ``ours``.
    chi_square : str
        Verdict of a chi-square test that belongs to the figure, such as ``"consistent"``.
    note : str
        Why it was missed, or what else has to be known; one line.
    tolerance : float
        Largest deviation from the target that still counts as ``"equal"``.
    """

    key: str
    text: str
    unit: str
    ours: float
    target: float | None = None
    sense: Sense = "at most"
    low: float | None = None
    high: float | None = None
    published: float | None = None
    sigma: float | None = None
    median: float | None = None
    p95: float | None = None
    chi_square: str = ""
    note: str = ""
    tolerance: float = 0.0

    def __post_init__(self) -> None:
        if self.sense == "within" and self.low is None and self.high is None:
            raise ValueError(f'claim {self.key}: "within" needs low or high')
        if self.sense not in get_args(Sense):
            raise ValueError(f'claim {self.key}: sense "{self.sense}"')

    @property
    def wanted(self) -> float | None:
        """The target, or the published figure in its place; None where nothing is judged, and for ``"within"``."""
        if self.sense in ("within", "beside"):
            return None
        return self.target if self.target is not None else self.published

    @property
    def judged(self) -> bool:
        """Tell whether there is anything to hold the figure against."""
        return self.sense == "within" or self.wanted is not None

    @property
    def met(self) -> bool:
        """Tell whether the figure is as wanted; a bound itself counts as reached, NaN never does."""
        ours, wanted = self.ours, self.wanted
        if self.sense == "within":
            low = -math.inf if self.low is None else self.low
            high = math.inf if self.high is None else self.high
            return bool(low <= ours <= high)
        if wanted is None:
            return False
        if self.sense == "equal":
            return bool(abs(ours - wanted) <= self.tolerance)
        return bool(ours <= wanted if self.sense == "at most" else ours >= wanted)

    @property
    def factor(self) -> float:
        """How many times better than wanted, for positive figures with one bound; 1 where that means nothing."""
        wanted = self.wanted
        if wanted is None or self.sense == "equal" or not (self.ours > 0.0 and wanted > 0.0):
            return 1.0
        return wanted / self.ours if self.sense == "at most" else self.ours / wanted

    @property
    def verdict(self) -> str:
        """``"reached"``, ``"better by 2.1x"``, ``"missed"``, or ``"measured"`` where nothing is judged."""
        if not self.judged:
            return "measured"
        if not self.met:
            return "missed"
        better = _BETTER <= self.factor < math.inf
        return f"better by {_factor(self.factor)}x" if better else "reached"

    @property
    def requirement(self) -> str:
        """What was wanted, in words."""
        if self.sense == "within":
            if self.low is None or self.high is None:
                return f"at most {_given(self.high)}" if self.low is None else f"at least {_given(self.low)}"
            return f"within {_given(self.low)} .. {_given(self.high)}"
        if self.wanted is None:
            return ""
        if self.sense == "equal":
            return _given(self.wanted) + (f" +- {_given(self.tolerance)}" if self.tolerance else "")
        return f"{self.sense} {_given(self.wanted)}"

    def line(self) -> str:
        """The claim in one line: verdict, what, ours, wanted, published, filter's sigma, why."""
        unit = f" {self.unit}" if self.unit else ""
        parts = [f"{_number(self.ours)}{unit}"]
        if self.requirement:
            parts.append(f"wanted {self.requirement}")
        if self.published is not None:
            parts.append(f"published {_given(self.published)}")
        if self.sigma is not None:
            parts.append(f"filter's sigma {_number(self.sigma)}")
        if self.chi_square:
            parts.append(self.chi_square)
        why = f" ({self.note})" if self.note else ""
        return f"{self.verdict:<15} {self.text}: {', '.join(parts)}{why}"

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers; None where unknown or not finite."""
        return {
            "key": self.key,
            "text": self.text,
            "unit": self.unit,
            "ours": plain(self.ours),
            "target": plain(self.target),
            "sense": self.sense,
            "low": plain(self.low),
            "high": plain(self.high),
            "tolerance": self.tolerance,
            "published": plain(self.published),
            "sigma": plain(self.sigma),
            "median": plain(self.median),
            "p95": plain(self.p95),
            "chi_square": self.chi_square,
            "verdict": self.verdict,
            "met": self.met if self.judged else None,
            "note": self.note,
        }


class Spread(TypedDict):
    """Median and 95 % of a set of absolute values, as keywords of a :class:`Claim`."""

    median: float
    p95: float


def spread(values: Sequence[float] | NDArray[np.float64]) -> Spread:
    """Median and 95 % of absolute values, in the unit of the claim."""
    return {"median": float(np.median(values)), "p95": float(np.quantile(values, 0.95))}


def rms(values: Sequence[float] | NDArray[np.float64]) -> float:
    """Root mean square of all values."""
    return float(np.sqrt(np.mean(np.square(values))))


def with_scatter(claims: Iterable[Claim], runs: int) -> list[Claim]:
    """Let every claim that few runs have missed say so, unless it has a note of its own."""
    note = f"{runs} run{'s' if runs != 1 else ''}: scatter of {100 / math.sqrt(2 * runs):.0f} %; repeat with {ENOUGH}"
    return [
        replace(claim, note=note)
        if claim.judged and not claim.met and not claim.note and runs < ENOUGH
        else claim
        for claim in claims
    ]


def plain(value: object) -> Any:
    """A cell or number for JSON: NumPy scalars as Python's, None for one that is not finite."""
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _number(value: float | None) -> str:
    """Three significant figures; whole numbers as such."""
    if value is None:
        return "-"
    if isinstance(value, int) or (math.isfinite(value) and value == round(value) and abs(value) < 1e6):
        return str(round(value))
    return text.number(value)


def _given(value: float | None) -> str:
    """A figure that somebody has set: three significant figures at most, no zeros that nobody has measured."""
    return "-" if value is None else f"{value:.3g}" if abs(value) < 999.5 else _number(value)


def _factor(value: float) -> str:
    """A factor with one decimal below ten."""
    return f"{value:.1f}" if value < 9.95 else f"{value:.0f}"
