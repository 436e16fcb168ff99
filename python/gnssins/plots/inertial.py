"""Curves of single errors in a free INS."""

from __future__ import annotations

from matplotlib.figure import Figure

from gnssins.analysis.schuler import SchulerCurves
from gnssins.plots import style
from gnssins.plots.style import COLORS

__all__ = ["schuler"]


def schuler(curves: SchulerCurves) -> Figure:
    """Draw position errors north and east (m) of every case over time, with the pendulum's dashed."""
    names = list(curves.curves)
    figure, axes = style.grid(
        len(names),
        title=f"Single errors of a free INS at rest at {curves.lat_deg:g}°, height held",
        row_height=1.7,
    )
    for ax, name in zip(axes[:, 0], names, strict=True):
        curve = curves[name]
        for i, (axis, color) in enumerate((("north", COLORS["blue"]), ("east", COLORS["orange"]))):
            ax.plot(curve.time_s, curve.position_m[:, i], color=color, lw=1.3, label=axis)
        if curve.pendulum_m is not None:
            ax.plot(curve.time_s, curve.closed_m, "--", color=COLORS["black"], lw=0.9, label="pendulum")
        style.label(ax, "Error (m)")
        style.note(ax, curve.case.text)
    style.legend(figure, axes[:, 0])
    return figure
