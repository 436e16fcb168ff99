"""What the figures share: colours, size, axes, shading of gaps, thinning of long series. No pyplot, no global state."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gnssins.storage import write_atomic
from gnssins.units import NS_PER_S

__all__ = [
    "BAND",
    "COLORS",
    "GAP",
    "broken",
    "envelope",
    "grid",
    "head",
    "label",
    "legend",
    "note",
    "save",
    "shade",
    "thin",
    "tidy",
]

Array = NDArray[np.float64]

#: Okabe and Ito (2008): told apart with every common kind of colour blindness.
COLORS: Final = {
    "blue": "#0072b2",
    "orange": "#e69f00",
    "red": "#d55e00",
    "green": "#009e73",
    "sky": "#56b4e9",
    "purple": "#cc79a7",
    "black": "#222222",
    "grey": "#8c8c8c",
}

#: Fill of a sigma band.
BAND: Final[dict[str, Any]] = {"color": COLORS["sky"], "alpha": 0.35, "linewidth": 0.0, "label": "±3 sd"}

#: Fill of the time without GNSS.
GAP: Final[dict[str, Any]] = {"color": "#bbbbbb", "alpha": 0.30, "linewidth": 0.0}

#: Buckets along the time axis; two points each, finer than the pixels of a page.
BUCKETS: Final = 1500

_RC: Final = {"title": 12, "label": 10, "tick": 9}


def grid(
    rows: int, columns: int = 1, *, title: str = "", width: float = 8.0, row_height: float = 2.0
) -> tuple[Figure, NDArray[np.object_]]:
    """Make a figure of ``rows`` x ``columns`` axes over a common time axis.

    Returns
    -------
    figure : Figure
        Belongs to nobody else: show it with a notebook, or :func:`save` it.
    axes : ndarray of Axes, shape (rows, columns)
        Time label only below.
    """
    figure = Figure(figsize=(width, row_height * rows + 0.9), layout="constrained", facecolor="white")
    axes = np.asarray(figure.subplots(rows, columns, sharex=True, squeeze=False), dtype=np.object_)
    for ax in axes.ravel().tolist():
        tidy(ax)
    for ax in axes[-1]:
        ax.set_xlabel("Time (s)", fontsize=_RC["label"])
    if title:
        head(figure, title)
    return figure, axes


def head(figure: Figure, text: str) -> None:
    """Put the title of a figure at its upper left."""
    figure.suptitle(text, fontsize=_RC["title"], x=0.01, ha="left", fontweight="bold")


def tidy(ax: Axes) -> None:
    """Light grid behind the data, no box, small ticks."""
    ax.grid(True, color="#d9d9d9", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(labelsize=_RC["tick"], length=3)
    ax.margins(x=0.01)


def label(ax: Axes, text: str) -> None:
    """Label the vertical axis."""
    ax.set_ylabel(text, fontsize=_RC["label"])


def note(ax: Axes, text: str) -> None:
    """Small print above the right end of an axis, where no data are."""
    ax.set_title(text, fontsize=_RC["tick"], loc="right", pad=3, color="#444444")


def legend(figure: Figure, axes: Iterable[Axes]) -> None:
    """Put one legend of all labels below the axes, where no data are, in as many lines as it takes."""
    entries: dict[str, Artist] = {}
    for ax in axes:
        for handle, name in zip(*ax.get_legend_handles_labels(), strict=True):
            entries.setdefault(name, handle)
    if entries:
        figure.legend(
            list(entries.values()),
            list(entries),
            loc="outside lower center",
            ncols=_columns([len(name) for name in entries], figure.get_figwidth()),
            fontsize=_RC["tick"],
            frameon=False,
        )


def _columns(letters: list[int], width_in: float) -> int:
    """Most columns of a legend that fit the width: 0.068 in a letter, 0.6 in for a line with its space."""
    for columns in range(len(letters), 1, -1):
        rows = -(-len(letters) // columns)
        parts = [letters[i : i + rows] for i in range(0, len(letters), rows)]
        if sum(0.6 + 0.068 * max(part) for part in parts) < width_in:
            return -(-len(letters) // rows)  # lines of like length
    return 1


def shade(ax: Axes, windows_ns: NDArray[np.int64], text: str = "no GNSS") -> None:
    """Shade the time without GNSS, windows (o, 2) in nanoseconds."""
    for i, (start, end) in enumerate(windows_ns / NS_PER_S):
        ax.axvspan(start, end, zorder=0, label=text if i == 0 else "_", **GAP)


def thin(*series: Array, points: int = 2 * BUCKETS) -> tuple[Array, ...]:
    """Every k-th row of smooth series of equal length, at most ``points`` and the last one."""
    step = max(1, -(-len(series[0]) // points))
    if step == 1:
        return series
    index = np.unique(np.append(np.arange(0, len(series[0]), step), len(series[0]) - 1))
    return tuple(values[index] for values in series)


def broken(x: Array, *series: Array, factor: float = 5.0) -> tuple[Array, ...]:
    """Part lines where the abscissa jumps: a NaN goes in wherever a step exceeds ``factor`` usual ones.

    Parameters
    ----------
    x : ndarray, shape (k,)
        Abscissa ascending.
    *series : ndarray, shape (k,)
        Values.
    factor : float
        Longest step over the median step.

    Returns
    -------
    tuple of ndarray
        ``x`` and the series, longer by one per jump.
    """
    if len(x) < 3:
        return (x, *series)
    step = np.diff(x)
    at = np.flatnonzero(step > factor * np.median(step)) + 1
    return (np.insert(x, at, x[at]), *(np.insert(values, at, np.nan) for values in series))


def envelope(x: Array, y: Array, buckets: int = BUCKETS) -> tuple[Array, Array]:
    """Thin a rough series and keep its extremes: smallest and largest value of each bucket, in order of time.

    Parameters
    ----------
    x, y : ndarray, shape (k,)
        Abscissa ascending; NaN in ``y`` is skipped.
    buckets : int
        Series of up to two points per bucket come back as they are.

    Returns
    -------
    x, y : ndarray
        At most two points per bucket.
    """
    if len(x) <= 2 * buckets:
        return x, y
    edges = np.linspace(0, len(x), buckets + 1).astype(np.int64)[:-1]
    index = np.arange(len(x))
    low, high = (
        np.minimum.reduceat(np.where(np.isnan(y), np.inf, y), edges),
        np.maximum.reduceat(np.where(np.isnan(y), -np.inf, y), edges),
    )
    bucket = np.searchsorted(edges, index, side="right") - 1
    first_low = _first(y == low[bucket], bucket, len(edges))
    first_high = _first(y == high[bucket], bucket, len(edges))
    keep = np.unique(np.concatenate([[0, len(x) - 1], first_low, first_high]))
    return x[keep], y[keep]


def _first(hit: NDArray[np.bool_], bucket: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Index of the first hit of every bucket that has one."""
    where = np.flatnonzero(hit)
    _, first = np.unique(bucket[where], return_index=True)
    return where[first]


def save(figure: Figure, path: str | Path, dpi: int = 150) -> Path:
    """Write a figure; the suffix of the name says which format (.png, .pdf, .svg)."""
    target = Path(path)
    kind = target.suffix.lstrip(".") or "png"
    write_atomic(target, lambda temporary: figure.savefig(temporary, format=kind, dpi=dpi))
    return target
