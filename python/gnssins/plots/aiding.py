"""What the fixes say about the filter: innovations with their bands, NIS with its bounds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gnssins.analysis.consistency import chi_square_bounds
from gnssins.plots import style
from gnssins.plots.style import BAND, COLORS
from gnssins.tables import seconds

if TYPE_CHECKING:
    from gnssins.result import Result

__all__ = ["innovations", "nis"]

Array = NDArray[np.float64]

_NAMES = ("North", "East", "Down")

#: Most fixes drawn as dots.
_DOTS = 20_000


def innovations(result: Result) -> Figure:
    """Draw measured minus predicted, position left and velocity right, with ±3 sd; rejected fixes stand out.

    Parameters
    ----------
    result : Result
        Any; parts that were never measured are left out.

    Returns
    -------
    Figure
    """
    r = result.records
    time = seconds(r.t_ns)
    parts = [
        (name, unit, columns)
        for name, unit, columns in (("position", "m", (0, 1, 2)), ("velocity", "m/s", (3, 4, 5)))
        if np.isfinite(r.innovation[:, columns]).any()
    ] or [("position", "m", (0, 1, 2))]
    figure, axes = style.grid(3, len(parts), title="Innovations: measured minus predicted", width=10.0)
    rejected = r.is_status("rejected")
    for column, (name, unit, components) in enumerate(parts):
        for row, i in enumerate(components):
            ax = axes[row, column]
            style.shade(ax, result.outages())
            seen = np.isfinite(r.innovation[:, i])
            good, out = seen & ~rejected, seen & rejected
            sd = np.sqrt(r.innovation_cov[:, i, i])
            _bands(ax, time[seen], sd[seen])
            x, y = style.thin(time[good], r.innovation[good, i], points=_DOTS)
            ax.plot(x, y, ".", ms=2.5, color=COLORS["blue"], label="used")
            if out.any():
                ax.plot(
                    time[out], r.innovation[out, i], "x", ms=5, mew=1.2, color=COLORS["red"], label="rejected"
                )
            ax.axhline(0.0, color=COLORS["black"], lw=0.6)
            style.label(ax, f"{_NAMES[row]} ({unit})")
            if row == 0:
                style.note(ax, name)
            _limit(ax, r.innovation[good, i], sd[good])
    style.legend(figure, axes.ravel().tolist())
    return figure


def nis(result: Result, probability: float = 0.95, window: int = 50) -> Figure:
    """Draw the NIS of every fix over its expectation, its running mean and the bounds of that mean.

    Parameters
    ----------
    result : Result
        Any.
    probability : float
        Of the two-sided bounds of the running mean.
    window : int
        Fixes in the running mean.

    Returns
    -------
    Figure
    """
    r = result.records
    figure, axes = style.grid(1, title="NIS per component", row_height=3.6)
    ax = axes[0, 0]
    style.shade(ax, result.outages())
    seen = np.isfinite(r.nis) & (r.dof > 0) & r.is_status("used", "rejected")
    rejected = r.is_status("rejected")
    time, ratio = seconds(r.t_ns), r.nis / np.maximum(r.dof, 1)
    good, out = seen & ~rejected, seen & rejected
    top = max(3.0, min(1.1 * float(ratio[seen].max(initial=0.0)), 12.0))
    x, y = style.thin(time[good], ratio[good], points=_DOTS)
    ax.plot(x, y, ".", ms=2.5, color=COLORS["sky"], label="fix")
    near, far = out & (ratio <= top), seen & (ratio > top)
    mark: dict[str, Any] = {"color": COLORS["red"], "zorder": 4, "mew": 1.2}
    if near.any():
        ax.plot(time[near], ratio[near], "x", ms=5, label="rejected", **mark)
    if far.any():
        ax.plot(time[far], np.full(int(far.sum()), 0.985 * top), "^", ms=4, label="beyond the axis", **mark)
    n = min(window, int(seen.sum()))
    if n > 1:
        mean = np.convolve(r.nis[seen], np.ones(n), "valid") / np.convolve(r.dof[seen], np.ones(n), "valid")
        dof = round(float(np.median(r.dof[seen])))
        low, high = (bound / dof for bound in chi_square_bounds(dof, n, probability))
        share = f"{100 * probability:.0f} % bounds of that mean"
        ax.axhspan(low, high, color=COLORS["green"], alpha=0.20, lw=0, label=share, zorder=0)
        x, y = style.broken(*style.envelope(time[seen][n - 1 :], mean))
        ax.plot(x, y, color=COLORS["blue"], lw=1.4, label=f"mean of {n} fixes")
    ax.axhline(1.0, color=COLORS["black"], lw=0.8)
    style.label(ax, "NIS / components (expected 1)")
    if seen.any():
        total = float(r.nis[seen].sum() / r.dof[seen].sum())
        style.note(ax, f"mean {total:.3f} over {int(seen.sum())} fixes, {int(out.sum())} rejected")
    ax.set_ylim(0.0, top)
    style.legend(figure, [ax])
    return figure


def _bands(ax: Axes, time: Array, sd: Array) -> None:
    x, y = style.broken(*style.thin(time, 3.0 * sd))
    ax.fill_between(x, -y, y, **BAND)


def _limit(ax: Axes, values: Array, sd: Array) -> None:
    """Limits from the fixes that were used, so that one wild fix does not flatten the rest."""
    if values.size:
        top = max(float(np.abs(values).max()), 3.5 * float(np.median(sd)))
        ax.set_ylim(-1.1 * top, 1.1 * top)
