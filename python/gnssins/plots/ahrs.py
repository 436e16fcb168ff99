"""Figures of attitude laws: Bode diagram, stability over body rates, step responses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from numpy.typing import ArrayLike, NDArray

from gnssins.ahrs.laws import RowLaw
from gnssins.analysis import text
from gnssins.analysis.ahrs import Response, StepResponse, stability
from gnssins.plots import style
from gnssins.plots.style import COLORS

__all__ = ["bode", "stability_map", "steps"]

Array = NDArray[np.float64]

#: Dashes in turn, so that a curve under another one is seen.
_LINES: Final = ("-", "--", "-.", ":")


def bode(
    responses: Mapping[str, Response],
    frequency_hz: ArrayLike | None = None,
    *,
    title: str = "Frequency response",
    points: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
) -> Figure:
    """Draw magnitude and phase of responses; a dot marks the corner of each.

    Parameters
    ----------
    responses : mapping of str to Response
        By the name in the legend. A gyro path is drawn over its DC response, a band-pass over its peak.
    frequency_hz : array_like, optional
        Left out: 0.1 to 100 Hz.
    title : str
        Above the figure.
    points : mapping of str to (frequencies, complex responses), optional
        Measured points by the name of the response that they belong to.
    """
    f = np.geomspace(0.1, 100.0, 600) if frequency_hz is None else np.asarray(frequency_hz, dtype=np.float64)
    figure, axes = style.grid(2, title=title, row_height=2.7)
    colors = [c for name, c in COLORS.items() if name not in ("black", "grey")]
    for i, (name, one) in enumerate(responses.items()):
        value = one.at(f)
        top = float(np.abs(value).max()) if one.band_pass else abs(one.dc)
        color, line = colors[i % len(colors)], _LINES[i % len(_LINES)]
        axes[0, 0].plot(f, _db(value / top), line, color=color, lw=1.4, label=name)
        axes[1, 0].plot(f, np.degrees(np.unwrap(np.angle(value))), line, color=color, lw=1.4)
        corner = one.corner_hz
        if f[0] <= corner <= f[-1]:
            axes[0, 0].plot([corner], _db(one.at(corner) / top), "o", ms=4.5, color=color)
        if points is not None and name in points:
            at, measured = (np.asarray(x) for x in points[name])
            axes[0, 0].plot(at, _db(measured / top), "x", ms=5, color=color)
            axes[1, 0].plot(at, np.degrees(np.unwrap(np.angle(measured))), "x", ms=5, color=color)
    axes[0, 0].axhline(-10.0 * np.log10(2.0), color=COLORS["grey"], lw=0.8, ls=":")
    axes[0, 0].set_ylim(-32.0, 6.0)
    style.label(axes[0, 0], "Magnitude (dB)")
    style.label(axes[1, 0], "Phase (deg)")
    for ax in axes[:, 0]:
        ax.set_xscale("log")
        ax.set_xlim(f[0], f[-1])
        ax.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes[1, 0].set_xlabel("Frequency (Hz)")
    style.legend(figure, [axes[0, 0]])
    return figure


def stability_map(laws: Mapping[str, RowLaw], limit_rad_s: float = 100.0, points: int = 81) -> Figure:
    """Draw the largest real part of the eigenvalues over rates about right and down, no roll rate.

    Parameters
    ----------
    laws : mapping of str to RowLaw
        One panel each, by its title.
    limit_rad_s : float
        Largest rate.
    points : int
        Grid points per axis.
    """
    axis = np.linspace(-limit_rad_s, limit_rad_s, points)
    right, down = np.meshgrid(axis, axis, indexing="ij")
    grid = np.stack([np.zeros_like(right), right, down], axis=-1).reshape(-1, 3)
    figure = Figure(figsize=(3.0 * len(laws) + 0.6, 4.5), layout="constrained", facecolor="white")
    style.head(figure, "Largest real part of the poles, no roll rate (red: zero)")
    panels = np.atleast_1d(np.asarray(figure.subplots(1, len(laws), sharey=True), dtype=np.object_))
    for ax, (name, law) in zip(panels, laws.items(), strict=True):
        found = stability(law, grid)
        value = found.abscissa.reshape(points, points)
        mesh = ax.pcolormesh(axis, axis, value.T, cmap="viridis", shading="nearest", rasterized=True)
        if (value < 0.0).any() and (value > 0.0).any():
            ax.contour(axis, axis, value.T, levels=[0.0], colors=[COLORS["red"]], linewidths=1.6)
        ax.set_title(f"{name}\nworst {text.number(found.worst)} 1/s", fontsize=10)
        ax.set_xlabel("Rate about right (rad/s)")
        ax.set_aspect("equal")
        bar = figure.colorbar(mesh, ax=ax, orientation="horizontal", pad=0.03)
        bar.set_label("Largest real part (1/s)", fontsize=10)
    style.label(panels[0], "Rate about down (rad/s)")
    return figure


def steps(responses: Mapping[str, StepResponse], title: str = "Initial error of one angle") -> Figure:
    """Draw how an initial error goes away, and below it what is thrown into the other angles.

    Parameters
    ----------
    responses : mapping of str to StepResponse
        By the name in the legend.
    title : str
        Above the figure.
    """
    figure, axes = style.grid(2, title=title, row_height=2.4)
    colors = [c for name, c in COLORS.items() if name not in ("black", "grey")]
    for i, (name, one) in enumerate(responses.items()):
        color, line = colors[i % len(colors)], _LINES[i % len(_LINES)]
        axes[0, 0].plot(one.time_s, 100.0 * one.own, line, color=color, lw=1.4, label=name)
        other = np.delete(one.errors, _own(one), axis=1)
        worst = int(np.abs(other).max(axis=0).argmax())
        axes[1, 0].plot(one.time_s, 100.0 * other[:, worst], line, color=color, lw=1.4)
    for level in (-5.0, 5.0):
        axes[0, 0].axhline(level, color=COLORS["grey"], lw=0.8, ls=":")
    style.label(axes[0, 0], "Angle (%)")
    style.label(axes[1, 0], "Largest other angle (%)")
    style.legend(figure, [axes[0, 0]])
    return figure


def _own(one: StepResponse) -> int:
    return ("roll", "pitch", "heading").index(one.angle)


def _db(value: Array | NDArray[np.complex128]) -> Array:
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(value), 1e-12)))
