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
            refused = rejected | ((r.refused >> i) & 1 == 1)
            good, out = seen & ~refused, seen & refused
            sd = np.sqrt(r.innovation_cov[:, i, i])
            _bands(ax, time[seen], sd[seen])
            top = _top(r.innovation[good, i], sd[good])
            _dots(ax, time[good], r.innovation[good, i], top)
            if out.any():
                inside = out & (np.abs(r.innovation[:, i]) <= top)
                mark: dict[str, Any] = {"color": COLORS["red"], "mew": 1.2, "label": "rejected"}
                ax.plot(time[inside], r.innovation[inside, i], "x", ms=5, **mark)
                _beyond(ax, time[out], r.innovation[out, i], top)
            ax.axhline(0.0, color=COLORS["black"], lw=0.6)
            style.label(ax, f"{_NAMES[row]} ({unit})")
            if row == 0:
                style.note(ax, name)
            ax.set_ylim(-top, top)
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


def _top(values: Array, sd: Array) -> float:
    """Half height of the axes: what nearly all fixes that were used need, so that a few do not flatten the rest."""
    if not values.size:
        return 1.0
    return max(1.3 * float(np.quantile(np.abs(values), 0.99)), 4.0 * float(np.median(sd)), 1e-9)


def _dots(ax: Axes, time: Array, values: Array, top: float) -> None:
    inside = np.abs(values) <= top
    x, y = style.thin(time[inside], values[inside], points=_DOTS)
    ax.plot(x, y, ".", ms=2.5, color=COLORS["blue"], label="used")
    _beyond(ax, time, values, top, COLORS["blue"])


def _beyond(ax: Axes, time: Array, values: Array, top: float, color: str = COLORS["red"]) -> None:
    """Mark values outside the axes at their edge."""
    for outside, marker, edge in ((values > top, "^", 0.97 * top), (values < -top, "v", -0.97 * top)):
        if outside.any():
            at = np.full(int(outside.sum()), edge)
            ax.plot(time[outside], at, marker, ms=4, color=color, ls="", label="beyond the axis", zorder=4)
