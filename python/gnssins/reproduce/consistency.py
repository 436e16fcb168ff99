"""NEES and NIS of a flight with GNSS throughout and with gaps, as reproductions print them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import Ensemble, chi_square_bounds
from gnssins.analysis.consistency import direction
from gnssins.reproduce.report import Cell, Table

__all__ = ["chi_square_row", "consistency_table", "nees_over"]

Array = NDArray[np.float64]


def nees_over(found: Ensemble, group: str, rows: Sequence[int]) -> tuple[float, int, tuple[float, float]]:
    """Mean over the runs and some epochs, degrees of freedom, 99 % bounds of one epoch."""
    dof = found.dof[group]
    values = found.nees_values[group][:, rows]
    return float(values.mean()), dof, chi_square_bounds(dof, found.runs, found.probability)


def chi_square_row(what: str, dof: int, mean: float, count: int) -> list[Cell]:
    """One line of the table, for a mean of ``count`` independent values in or after the gaps; 99 % bounds."""
    bounds = chi_square_bounds(dof, count, 0.99)
    return ["gaps", what, dof, mean, *bounds, direction(mean, dof, bounds)]


def consistency_table(
    whole: Ensemble,
    gaps: Ensemble,
    after_s: float,
    epochs: Callable[[Ensemble], Sequence[int]],
    more: Sequence[list[Cell]],
) -> Table:
    """NEES by group and NIS of both variants, with chi-square bounds and verdicts.

    Parameters
    ----------
    whole, gaps : Ensemble
        Flights with GNSS throughout, and with gaps.
    after_s : float
        Start of the steady state.
    epochs : callable
        Indices of the epochs that count, of an ensemble.
    more : sequence of list
        Further lines; see :func:`chi_square_row`.

    Returns
    -------
    Table
    """
    rows: list[list[Cell]] = []
    for variant, found in (("throughout", whole), ("gaps", gaps)):
        for group in found.nees_values:
            mean, dof, bounds = nees_over(found, group, epochs(found))
            rows.append([variant, f"NEES {group}", dof, mean, *bounds, direction(mean, dof, bounds)])
        for name in ("gnss, 6 components", "position", "velocity"):
            part = found.nis[name]
            rows.append([variant, f"NIS {name}", part.dof, part.mean, *part.bounds, part.verdict])
    return Table(
        "consistency",
        f"NEES and NIS for t > {after_s:g} s, means of {whole.runs} runs",
        ["GNSS", "what", "expected", "mean", "99 % from", "to", "the filter is"],
        [*rows, *more],
        "NEES: bounds of one epoch, which the mean over correlated epochs keeps all the more; NIS: bounds of the mean "
        "of all fixes.",
    )
