"""Observability along a path: the rank over time, and which states are unobservable when."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from gnssins.errors import InputError
from gnssins.plots import style
from gnssins.plots.style import COLORS
from gnssins.tables import stretches

if TYPE_CHECKING:
    from gnssins.analysis.observable import Observability

__all__ = ["observability"]

_MAP = LinearSegmentedColormap.from_list("observable", ["#ffffff", COLORS["sky"], COLORS["blue"]])

#: Columns of the picture, at most.
_COLUMNS = 1500


def observability(found: Observability, title: str = "Observability along the path") -> Figure:
    """Draw the rank, and for every state the projection on the unobservable subspace; flagged stretches are framed red.

    Parameters
    ----------
    found : Observability
        At least one window.
    title : str
        Above the figure.

    Returns
    -------
    Figure
        Time is that of the last fix of each window.
    """
    if not len(found):
        raise InputError("input.no_overlap", "no window to draw", "take a longer stretch")
    figure, axes = style.grid(2, title=title, width=9.0, row_height=0.16 * len(found.states) + 1.2)
    rank, states = axes[:, 0]
    n = len(found.states)
    step = max(1, -(-len(found) // (2 * _COLUMNS)))
    rank.step(found.t_s[::step], found.rank[::step], where="post", color=COLORS["blue"], lw=1.1, label="rank")
    rank.axhline(n, color=COLORS["grey"], lw=0.8, ls="--", label=f"{n} states")
    style.label(rank, "Rank")
    rank.set_ylim(min(int(found.rank.min()), n - 1) - 0.8, n + 0.8)
    unit = "SI" if found.scaling == "si" else "sigma"
    style.note(rank, f"{int(found.fixes.max())} fixes per window, threshold {found.threshold:g} {unit}")
    edges = _edges(found.t_s[::step])
    image = states.pcolormesh(
        edges,
        np.arange(n + 1) - 0.5,
        found.projection[::step].T,
        cmap=_MAP,
        vmin=0.0,
        vmax=1.0,
        rasterized=True,
    )
    for row, flagged in enumerate(found.flags[::step].T):
        for begin, end in stretches(flagged):
            states.plot(
                [edges[begin], edges[end]], [row, row], color=COLORS["red"], lw=1.6, solid_capstyle="butt"
            )
    states.set_yticks(np.arange(n), found.names)
    states.set_ylim(n - 0.5, -0.5)
    states.grid(False)
    style.note(states, f"red: projection above {found.flag:g}, the state is unobservable")
    bar = figure.colorbar(image, ax=states, pad=0.01, fraction=0.04)
    bar.set_label("Projection on the\nunobservable subspace", fontsize=9)
    bar.ax.tick_params(labelsize=9)
    style.legend(figure, [rank])
    return figure


def _edges(t_s: np.ndarray) -> np.ndarray:
    """Borders between the columns, one more than there are times."""
    if t_s.size == 1:
        return np.array([t_s[0] - 0.5, t_s[0] + 0.5])
    middle = 0.5 * (t_s[1:] + t_s[:-1])
    return np.concatenate([[2 * t_s[0] - middle[0]], middle, [2 * t_s[-1] - middle[-1]]])
