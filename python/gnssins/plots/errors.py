"""Errors over time with the band that the filter claims."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gnssins.analysis import text
from gnssins.analysis.errors import NavErrors
from gnssins.plots import style
from gnssins.plots.style import BAND, COLORS

__all__ = ["attitude_errors", "position_errors", "velocity_errors"]

Array = NDArray[np.float64]
Windows = NDArray[np.int64]

_NO_WINDOWS: Windows = np.empty((0, 2), dtype=np.int64)


def position_errors(errors: NavErrors, outages_ns: Windows = _NO_WINDOWS) -> Figure:
    """Draw position errors north, east, down (m) with their ±3 sd bands; time without GNSS is shaded."""
    names = ("North (m)", "East (m)", "Down (m)")
    return _figure("Position error", names, errors.time_s, errors.position, errors.sd[:, :3], outages_ns, "m")


def velocity_errors(errors: NavErrors, outages_ns: Windows = _NO_WINDOWS) -> Figure:
    """Draw velocity errors north, east, down (m/s) with their ±3 sd bands; time without GNSS is shaded."""
    names = ("North (m/s)", "East (m/s)", "Down (m/s)")
    return _figure(
        "Velocity error", names, errors.time_s, errors.velocity, errors.sd[:, 3:6], outages_ns, "m/s"
    )


def attitude_errors(errors: NavErrors, outages_ns: Windows = _NO_WINDOWS) -> Figure:
    """Draw roll, pitch and heading errors with their ±3 sd bands, in degrees, or in arc minutes if small."""
    values, sd = np.degrees(errors.euler), np.degrees(errors.sd[:, 6:9])
    unit = "deg"
    known = np.abs(values[np.isfinite(values)])
    if known.size and np.quantile(known, 0.99) < 0.1:
        values, sd, unit = 60.0 * values, 60.0 * sd, "arcmin"
    names = (f"Roll ({unit})", f"Pitch ({unit})", f"Heading ({unit})")
    return _figure("Attitude error", names, errors.time_s, values, sd, outages_ns, unit, ((0, 1), (2,)))


def _figure(
    title: str,
    names: tuple[str, str, str],
    time_s: Array,
    values: Array,
    sd: Array,
    outages_ns: Windows,
    unit: str,
    alike: Sequence[Sequence[int]] = ((0, 1, 2),),
) -> Figure:
    """Three axes over time; those in one group of ``alike`` get one scale."""
    figure, axes = style.grid(3, title=title)
    for i, ax in enumerate(axes[:, 0]):
        style.shade(ax, outages_ns)
        if np.isfinite(sd[:, i]).any():
            time, band = style.envelope(time_s, 3.0 * sd[:, i])
            ax.fill_between(time, -band, band, **BAND)
        ax.plot(*style.envelope(time_s, values[:, i]), color=COLORS["blue"], lw=0.9, label="error")
        ax.axhline(0.0, color=COLORS["black"], lw=0.6)
        style.label(ax, names[i])
        known = values[np.isfinite(values[:, i]), i]
        if known.size:
            rms = text.number(float(np.sqrt(np.mean(known**2))))
            style.note(ax, f"rms {rms} {unit}, largest {text.number(float(np.abs(known).max()))} {unit}")
    for together in alike:
        top = max(_top(values[:, i], 3.0 * sd[:, i]) for i in together)
        for i in together:
            axes[i, 0].set_ylim(*((-top, top) if top > 0.0 else (-1.0, 1.0)))
    style.legend(figure, axes[:, 0])
    return figure


def _top(values: Array, band: Array) -> float:
    """Largest value to show: all errors, and the band after the first twentieth unless it dwarfs the errors."""
    known = np.abs(values[np.isfinite(values)])
    top = float(known.max()) if known.size else 0.0
    settled = band[len(band) // 20 :]
    settled = settled[np.isfinite(settled)]
    return max(1.1 * top, min(1.05 * float(settled.max()), 20.0 * top)) if settled.size else 1.1 * top
