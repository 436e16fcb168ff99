"""Whether the filter knows how wrong it is: NEES and NIS with chi-square bounds, and the direction of the deviation.

NEES is x' P^-1 x of the true error x, NIS is y' S^-1 y of the innovation y. With n components both have the mean n
if the covariance is right. A larger mean says over-confident (the errors exceed what the filter claims), a smaller
one under-confident. Bar-Shalom, Li, Kirubarajan (2001), section 5.4.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from gnssins.analysis import text
from gnssins.analysis.errors import Trajectory
from gnssins.analysis.states import Parameters, error_states, quadratic
from gnssins.units import NS_PER_S

if TYPE_CHECKING:
    from gnssins.result import Result

__all__ = [
    "Nees",
    "NeesGroup",
    "Nis",
    "NisGroup",
    "Parameters",
    "chi_square_bounds",
    "direction",
    "nees",
    "nis",
]

Array = NDArray[np.float64]
Times = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class NeesGroup:
    """NEES of one group of states at the epochs of the covariance snapshots: ``value`` (c,), mean of ``runs`` runs."""

    name: str
    dof: int
    t_ns: Times
    value: Array
    runs: int = 1
    probability: float = 0.95

    @property
    def bounds(self) -> tuple[float, float]:
        """Two-sided bounds of the value at one epoch: chi-square with runs x dof degrees of freedom over runs."""
        return chi_square_bounds(self.dof, self.runs, self.probability)

    @property
    def mean(self) -> float:
        """Mean over time."""
        return float(np.mean(self.value))

    @property
    def factor(self) -> float:
        """Mean over its expectation: above 1 over-confident, below 1 under-confident."""
        return self.mean / self.dof

    @property
    def share_inside(self) -> float:
        """Share of epochs inside the bounds; neighbouring epochs are correlated."""
        low, high = self.bounds
        return float(np.mean((self.value >= low) & (self.value <= high)))

    @property
    def verdict(self) -> str:
        """Judge the mean over time by the bounds of one epoch.

        Epochs are correlated to an unknown degree, and a mean of them never scatters more than one of them: an honest
        filter passes at least as often as the probability of the bounds says.
        """
        return direction(self.mean, self.dof, self.bounds)


@dataclass(frozen=True, eq=False)
class Nees:
    """NEES by group: ``"all"`` states, ``"navigation"`` (the first nine), and every block by itself."""

    groups: Mapping[str, NeesGroup]

    def __getitem__(self, name: str) -> NeesGroup:
        return self.groups[name]

    def after(self, start_s: float) -> Nees:
        """Only the epochs with t > ``start_s``."""
        cut = {}
        for name, g in self.groups.items():
            keep = g.t_ns > round(start_s * NS_PER_S)
            cut[name] = NeesGroup(name, g.dof, g.t_ns[keep], g.value[keep], g.runs, g.probability)
        return Nees(cut)

    def table(self, title: str = "") -> str:
        """One line per group. A verdict over time is left to the reader: NEES is correlated in time."""
        first = next(iter(self.groups.values()))
        rows = [
            [
                g.name,
                str(g.dof),
                text.number(g.mean),
                "{:.2f} .. {:.2f}".format(*g.bounds),
                f"{100 * g.share_inside:.0f} %",
                f"{g.factor:.2f}",
            ]
            for g in self.groups.values()
        ]
        runs = "one run" if first.runs == 1 else f"{first.runs} runs"
        title = title or f"NEES, {runs}, {first.value.size} epochs"
        share = f"{100 * first.probability:.0f} % bounds of an epoch"
        return text.table(title, ["states", "dof", "mean", share, "epochs inside", "mean/dof"], rows)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers per group."""
        return {
            name: {
                "dof": g.dof,
                "runs": g.runs,
                "epochs": int(g.value.size),
                "mean": g.mean,
                "epoch_bounds": list(g.bounds),
                "share_inside": g.share_inside,
                "factor": g.factor,
            }
            for name, g in self.groups.items()
        }


@dataclass(frozen=True)
class NisGroup:
    """NIS of one kind of measurement: ``mean`` of ``count`` values of ``dof`` components."""

    name: str
    dof: int
    count: int
    mean: float
    probability: float = 0.95

    @property
    def bounds(self) -> tuple[float, float]:
        """Two-sided bounds of the mean, innovations being independent."""
        return chi_square_bounds(self.dof, self.count, self.probability)

    @property
    def factor(self) -> float:
        """Mean over its expectation."""
        return self.mean / self.dof

    @property
    def verdict(self) -> str:
        """Consistent, over-confident or under-confident, and by how much."""
        return direction(self.mean, self.dof, self.bounds)


@dataclass(frozen=True, eq=False)
class Nis:
    """NIS by kind of measurement and number of components, then of its parts and axes."""

    groups: Mapping[str, NisGroup]

    def __getitem__(self, name: str) -> NisGroup:
        return self.groups[name]

    def table(self, title: str = "NIS of the fixes, before the gate") -> str:
        """One line per group with its verdict."""
        rows = [
            [
                g.name,
                str(g.dof),
                str(g.count),
                text.number(g.mean),
                "{:.2f} .. {:.2f}".format(*g.bounds),
                g.verdict,
            ]
            for g in self.groups.values()
        ]
        first = next(iter(self.groups.values()), None)
        share = f"{100 * first.probability:.0f} % bounds" if first else "bounds"
        head = ["measurement", "dof", "count", "mean", share, "the filter is"]
        return text.table(title, head, rows, left=(0, 5))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers per group."""
        return {
            name: {
                "dof": g.dof,
                "count": g.count,
                "mean": g.mean,
                "bounds": list(g.bounds),
                "factor": g.factor,
                "verdict": g.verdict,
            }
            for name, g in self.groups.items()
        }


def chi_square_bounds(dof: int, count: int = 1, probability: float = 0.95) -> tuple[float, float]:
    """Two-sided bounds of the mean of ``count`` independent chi-square values of ``dof`` degrees of freedom."""
    tail = 0.5 * (1.0 - probability)
    # quantile of chi-square with k degrees of freedom: twice the inverse of the regularised gamma function of k/2
    low, high = 2.0 * gammaincinv(0.5 * count * dof, [tail, 1.0 - tail]) / count
    return float(low), float(high)


def direction(mean: float, dof: int, bounds: tuple[float, float]) -> str:
    """Put a mean into words: inside the bounds, or over- or under-confident and by which factor in sd."""
    if not math.isfinite(mean):
        return "unknown"
    low, high = bounds
    factor = math.sqrt(mean / dof)
    if mean > high:
        return f"over-confident, sd {factor:.2f} times too small"
    if mean < low:
        return (
            f"under-confident, sd {1.0 / factor:.2f} times too large" if factor > 0.0 else "under-confident"
        )
    return "consistent"


def nees(
    result: Result,
    truth: Trajectory,
    parameters: Parameters | None = None,
    *,
    probability: float = 0.95,
    ellipsoid: str | None = None,
) -> Nees:
    """NEES of the covariance snapshots of a run.

    Navigation errors count as estimate minus truth, block states as truth minus estimate, as in the covariance.

    Parameters
    ----------
    result : Result
        With covariance snapshots (``[run] covariance_interval_s``) at output epochs.
    truth : Trajectory
        True motion; every snapshot that it covers is used.
    parameters : Parameters, optional
        True block states by name, for the groups of the blocks. Group ``"all"`` needs every one of them.
    probability : float
        Of the two-sided bounds.
    ellipsoid : str, optional
        Left out: that of the run.

    Returns
    -------
    Nees

    Raises
    ------
    InputError
        No snapshots, or none at an epoch that result and truth share.
    """
    found = error_states(result, truth, parameters, ellipsoid=ellipsoid)
    groups = {
        name: NeesGroup(name, len(index), found.t_ns, found.nees(index), 1, probability)
        for name, index in found.groups.items()
    }
    return Nees(groups)


def nis(result: Result, *, after_s: float | None = None, probability: float = 0.95) -> Nis:
    """NIS of the fixes that were compared with the prediction, used or rejected: the gate must not flatter.

    Parameters
    ----------
    result : Result
        Any.
    after_s : float, optional
        Only fixes valid after this time.
    probability : float
        Of the two-sided bounds.

    Returns
    -------
    Nis
        Groups ``"gnss, n components"`` of whole fixes, then ``"position"``, ``"velocity"`` and the six axes, then the
        aids beside GNSS by their source (``"baro"``, ``"heading"``).
    """
    r = result.records
    begin_ns = round(after_s * NS_PER_S) if after_s is not None else np.iinfo(np.int64).min
    keep = r.is_status("used", "rejected") & np.isfinite(r.nis) & (r.t_ns > begin_ns)
    groups = {}
    for dof in np.unique(r.dof[keep]):
        values = r.nis[keep & (r.dof == dof)]
        name = f"gnss, {dof} components"
        groups[name] = NisGroup(name, int(dof), values.size, float(values.mean()), probability)
    y, s = r.innovation[keep], r.innovation_cov[keep]
    parts = {"position": [0, 1, 2], "velocity": [3, 4, 5]}
    axes = (
        "position north",
        "position east",
        "position down",
        "velocity north",
        "velocity east",
        "velocity down",
    )
    parts |= {name: [i] for i, name in enumerate(axes)}
    for name, index in parts.items():
        rows = np.isfinite(y[:, index]).all(axis=1)
        if rows.any():
            values = quadratic(y[rows][:, index], s[rows][:, index][:, :, index])
            groups[name] = NisGroup(name, len(index), values.size, float(values.mean()), probability)
    for source, aid in result.aids.items():
        values = aid.nis[aid.is_status("used", "rejected") & np.isfinite(aid.nis) & (aid.t_ns > begin_ns)]
        if values.size:
            groups[source] = NisGroup(source, 1, values.size, float(values.mean()), probability)
    return Nis(groups)
