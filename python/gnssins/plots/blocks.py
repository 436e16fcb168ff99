"""Estimated sensor errors and other block states over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from gnssins.errors import InputError
from gnssins.plots import style
from gnssins.plots.style import BAND, COLORS
from gnssins.tables import seconds, table_unit

if TYPE_CHECKING:
    from gnssins.analysis.consistency import Parameters
    from gnssins.result import Result

__all__ = ["biases"]

_COLUMNS = 3


def biases(result: Result, truth: Parameters | None = None) -> Figure:
    """Draw the block states with their ±3 sd bands, one row per block of three, in data-sheet units.

    Parameters
    ----------
    result : Result
        Of a filter with blocks.
    truth : Parameters, optional
        True values by state name, drawn dashed.

    Returns
    -------
    Figure

    Raises
    ------
    InputError
        The filter has no block states.
    """
    states = result.block_states
    if not states:
        raise InputError(
            "input.no_blocks", "the filter estimates no sensor errors", "add [[filter.block]] tables"
        )
    blocks = list(dict.fromkeys(s.block for s in states))
    places: list[list[int]] = []
    for block in blocks:
        members = [i for i, s in enumerate(states) if s.block == block]
        places += [members[k : k + _COLUMNS] for k in range(0, len(members), _COLUMNS)]
    figure, axes = style.grid(len(places), _COLUMNS, title="Estimated errors", width=10.0, row_height=1.9)
    known = truth.by_state(states) if truth is not None else {}
    for row, members in enumerate(places):
        top = 0.0
        for column, i in enumerate(members):
            ax, state, unit = axes[row, column], states[i], table_unit(states[i].unit)
            style.shade(ax, result.outages())
            series = (result.time_s, result.x[:, i] * unit.factor, result.x_sd[:, i] * unit.factor)
            time, value, sd = style.thin(*series)
            ax.fill_between(time, value - 3.0 * sd, value + 3.0 * sd, **BAND)
            ax.plot(time, value, color=COLORS["blue"], lw=1.1, label="estimate")
            if truth is not None and state.name in known:
                true = style.thin(seconds(truth.t_ns), known[state.name] * unit.factor, points=400)
                ax.plot(*true, "--", color=COLORS["black"], lw=1.0, label="truth")
            axis = state.name.removeprefix(f"{state.block}_")
            style.note(ax, f"{state.block.replace('_', ' ')} {axis}")
            if column == 0:
                style.label(ax, unit.label)
            settled = slice(len(time) // 10, None)
            # a short burst of the band, as after filter.reset, may leave the axes: it would flatten the rest
            top = max(
                top,
                float(np.quantile((np.abs(value) + 3.0 * sd)[settled], 0.95)),
                float(np.quantile(np.abs(value), 0.97)),
            )
        for column in range(_COLUMNS):
            axes[row, column].set_visible(column < len(members))
            if top > 0.0:
                axes[row, column].set_ylim(-1.1 * top, 1.1 * top)
    style.legend(figure, axes.ravel().tolist())
    return figure
