"""The track on the ground and the height over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gnssins.analysis.errors import Trajectory, ned_difference
from gnssins.plots import style
from gnssins.plots.style import COLORS
from gnssins.tables import seconds

if TYPE_CHECKING:
    from gnssins.result import Result

__all__ = ["track"]

Array = NDArray[np.float64]

#: Distance of start and end on the page, points, below which they share one label.
_LABEL_PT: Final = 45.0


def track(result: Result, truth: Trajectory | None = None) -> Figure:
    """Draw the track seen from above, with fixes and gaps, and the height below it.

    Parameters
    ----------
    result : Result
        At least one epoch.
    truth : Trajectory, optional
        Drawn as a thin dashed line.

    Returns
    -------
    Figure
    """
    origin = result.lla[:1]
    plane = _plane(result.lla, origin)
    width, height = np.maximum(np.ptp(plane, axis=0), 1e-9)
    tall = float(np.clip(7.2 * height / width, 2.6, 7.5))
    figure = Figure(figsize=(8.0, tall + 3.0), layout="constrained", facecolor="white")
    above, below = figure.subplots(2, 1, gridspec_kw={"height_ratios": [tall, 1.6]})
    for ax in (above, below):
        style.tidy(ax)
    scale, unit = _scale(plane)
    fixes = np.isfinite(result.records.lla).all(axis=1)
    held = fixes & result.records.is_status("withheld")
    shown = fixes & ~held
    at = _plane(result.records.lla, origin) / scale
    above.plot(*_thinned(at[shown]), ".", ms=2.5, color=COLORS["orange"], label="fixes", zorder=1)
    if held.any():
        dots: dict[str, Any] = {"ms": 2.0, "color": COLORS["purple"], "label": "withheld fixes", "zorder": 1}
        above.plot(*_thinned(at[held]), ".", **dots)
    above.plot(*_thinned(plane / scale), color=COLORS["blue"], lw=1.4, label="solution", zorder=3)
    for i, (start, end) in enumerate(result.outages()):
        inside = (result.t_ns >= start) & (result.t_ns <= end)
        above.plot(
            *_thinned(plane[inside] / scale),
            color=COLORS["red"],
            lw=2.4,
            label="solution without GNSS" if i == 0 else "_",
            zorder=4,
        )
    if truth is not None:
        above.plot(
            *_thinned(_plane(truth.lla, origin) / scale),
            "--",
            color=COLORS["black"],
            lw=0.9,
            label="reference",
            zorder=5,
        )
    # points of the page per metre; the two labels point away from each other, but not where they would meet
    page = 72.0 * min(7.2 / width, tall / height)
    marks = [(plane[0], "start", 1), (plane[-1], "end", -1)]
    if float(np.linalg.norm(plane[-1] - plane[0])) * page < _LABEL_PT:
        marks = [(plane[0], "start, end", 1), (plane[-1], "", -1)]
    for point, text, side in marks:
        above.plot(*(point / scale), "o", ms=6, mfc="white", mec=COLORS["black"], zorder=6)
        if not text:
            continue
        above.annotate(
            text,
            point / scale,
            xytext=(7 * side, 7 * side),
            textcoords="offset points",
            ha="left" if side > 0 else "right",
            va="bottom" if side > 0 else "top",
            fontsize=9,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 1.0},
            zorder=5,
        )
    above.set_aspect("equal", adjustable="datalim")
    above.set_xlabel(f"East of the start ({unit})")
    style.label(above, f"North of the start ({unit})")
    times, heights = style.envelope(result.time_s, result.lla[:, 2])
    fix_track = style.thin(seconds(result.records.t_ns[shown]), result.records.lla[shown, 2], points=20_000)
    below.plot(*fix_track, ".", ms=2, color=COLORS["orange"])
    below.plot(times, heights, color=COLORS["blue"], lw=1.4)
    if truth is not None:
        below.plot(*style.envelope(seconds(truth.t_ns), truth.lla[:, 2]), "--", color=COLORS["black"], lw=0.9)
    style.shade(below, result.outages(), "_")
    below.set_xlabel("Time (s)")
    style.label(below, "Height (m)")
    style.head(figure, "Track")
    style.legend(figure, [above])
    return figure


def _plane(lla: Array, origin: Array) -> Array:
    """East and north of the origin (m), shape (k, 2): differences of angle times the radii at the origin."""
    return ned_difference(lla, np.repeat(origin, len(lla), axis=0))[:, [1, 0]]


def _scale(plane: Array) -> tuple[float, str]:
    extent = float(np.ptp(plane, axis=0).max()) if len(plane) else 0.0
    return (1000.0, "km") if extent > 5000.0 else (1.0, "m")


def _thinned(plane: Array) -> tuple[Array, Array]:
    x, y = style.thin(plane[:, 0], plane[:, 1], points=20_000)
    return x, y
