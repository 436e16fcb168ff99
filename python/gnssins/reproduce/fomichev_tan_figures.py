"""The figures of Fomichev and Tan (2017), 1 to 8, and the comparison with the restarted INS, which it does not show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gnssins import _core
from gnssins.analysis import Ensemble, NavErrors
from gnssins.plots import style
from gnssins.plots.style import BAND, COLORS
from gnssins.reproduce.fomichev_tan_runs import Flight, Plan, Realisation
from gnssins.tables import seconds
from gnssins.units import NS_PER_S

__all__ = ["draw"]

Array = NDArray[np.float64]
Windows = NDArray[np.int64]

_NONE: Windows = np.empty((0, 2), dtype=np.int64)

#: East, north, up from north, east, down: index and sign.
_ENU = ((1, 1.0), (0, 1.0), (2, -1.0))
_NAMES = ("East", "North", "Up")


def draw(plan: Plan, one: Realisation, gaps: Ensemble, flights: Sequence[Flight]) -> dict[str, Figure]:
    """Make all figures; the key of each says which one of the publication it corresponds to."""
    windows = np.rint(np.array(plan.gaps) * NS_PER_S).astype(np.int64)
    held = np.any([(one.fix_time_s >= a) & (one.fix_time_s < b) for a, b in plan.gaps], axis=0)
    return {
        "figure_1_route": _route(one, windows),
        "figure_2_attitude": _attitude(one, windows),
        "figure_3_velocity": _velocity(one, windows),
        "figure_4_coordinates": _coordinates(one, windows),
        "figure_5_gnss_errors": _fixes(one, ~np.zeros_like(held), _NONE, "Figure 5: errors of the fixes"),
        "figure_6_errors": _errors(one.whole, _NONE, "Figure 6: errors of the filter, GNSS throughout"),
        "figure_7_gnss_errors_gaps": _fixes(one, ~held, windows, "Figure 7: errors of the fixes, three gaps"),
        "figure_8_errors_gaps": _errors(one.gaps, windows, "Figure 8: errors of the filter, three gaps"),
        "gap_1_restarted": _restarted(plan, gaps, flights),
    }


def _route(one: Realisation, windows: Windows) -> Figure:
    """Route seen from above; the stretches without GNSS stand out."""
    truth = one.truth
    lat, lon = np.degrees(truth.lla[:, 0]), np.degrees(truth.lla[:, 1])
    figure = Figure(figsize=(8.0, 3.3), layout="constrained", facecolor="white")
    ax = figure.subplots()
    style.tidy(ax)
    ax.plot(*style.thin(lon, lat), color=COLORS["blue"], lw=1.4, label="route")
    for i, (start, end) in enumerate(windows):
        inside = (truth.t_ns >= start) & (truth.t_ns <= end)
        line = style.thin(lon[inside], lat[inside])
        ax.plot(*line, color=COLORS["red"], lw=2.4, label="no GNSS in variant 2" if i == 0 else "_")
    ax.plot(lon[0], lat[0], "o", ms=6, mfc="white", mec=COLORS["black"], label="start")
    ax.set_aspect(1.0 / np.cos(truth.lla[0, 0]))
    ax.set_xlabel("Longitude (deg)")
    style.label(ax, "Latitude (deg)")
    style.head(figure, "Figure 1: route")
    style.legend(figure, [ax])
    return figure


def _series(title: str, time_s: Array, rows: Sequence[tuple[str, Array]], windows: Windows) -> Figure:
    """Curves one above the other over time."""
    figure, axes = style.grid(len(rows), title=title, row_height=1.7)
    for ax, (name, values) in zip(axes[:, 0], rows, strict=True):
        style.shade(ax, windows, "no GNSS in variant 2")
        ax.plot(*style.envelope(time_s, values), color=COLORS["blue"], lw=1.1)
        style.label(ax, name)
    style.legend(figure, axes[:, 0])
    return figure


def _attitude(one: Realisation, windows: Windows) -> Figure:
    euler = np.degrees(np.unwrap(_core.quat_to_euler(np.ascontiguousarray(one.truth.q_nb)), axis=0))
    names = ("Roll (deg)", "Pitch (deg)", "Heading,\nnot wrapped (deg)")
    rows = [(names[i], euler[:, i]) for i in (2, 1, 0)]
    return _series("Figure 2: attitude", seconds(one.truth.t_ns), rows, windows)


def _velocity(one: Realisation, windows: Windows) -> Figure:
    rows = [(f"{n} (m/s)", s * one.truth.v_n[:, i]) for n, (i, s) in zip(_NAMES, _ENU, strict=True)]
    return _series("Figure 3: velocity", seconds(one.truth.t_ns), rows, windows)


def _coordinates(one: Realisation, windows: Windows) -> Figure:
    lla = one.truth.lla
    rows = [
        ("Latitude (deg)", np.degrees(lla[:, 0])),
        ("Longitude (deg)", np.degrees(lla[:, 1])),
        ("Height (m)", lla[:, 2]),
    ]
    return _series("Figure 4: coordinates", seconds(one.truth.t_ns), rows, windows)


def _fixes(one: Realisation, shown: NDArray[np.bool_], windows: Windows, title: str) -> Figure:
    """Errors of the fixes, position left and velocity right."""
    figure, axes = style.grid(3, 2, title=title, width=10.0, row_height=1.7)
    for column, (first, unit) in enumerate(((0, "m"), (3, "m/s"))):
        for row, (name, (i, sign)) in enumerate(zip(_NAMES, _ENU, strict=True)):
            ax = axes[row, column]
            style.shade(ax, windows)
            values = sign * one.fix_errors[shown, first + i]
            ax.plot(one.fix_time_s[shown], values, ".", ms=2, color=COLORS["orange"], label="fix minus truth")
            style.label(ax, f"{name} ({unit})")
            style.note(ax, f"rms {np.sqrt(np.mean(values**2)):.3f} {unit}")
    style.legend(figure, axes.ravel().tolist())
    return figure


def _errors(errors: NavErrors, windows: Windows, title: str) -> Figure:
    """Errors of the filter with its 3-sigma bands, position left and velocity right."""
    figure, axes = style.grid(3, 2, title=title, width=10.0, row_height=1.7)
    sides = ((errors.position, errors.sd[:, :3], "m"), (errors.velocity, errors.sd[:, 3:6], "m/s"))
    settled = errors.time_s > 60.0
    for column, (every, sds, unit) in enumerate(sides):
        top = 1.1 * float(max(3.0 * sds[settled].max(), np.abs(every[settled]).max()))
        for row, (name, (i, sign)) in enumerate(zip(_NAMES, _ENU, strict=True)):
            ax = axes[row, column]
            style.shade(ax, windows)
            band = style.envelope(errors.time_s, 3.0 * sds[:, i])
            ax.fill_between(band[0], -band[1], band[1], **BAND)
            values = sign * every[:, i]
            ax.plot(*style.envelope(errors.time_s, values), color=COLORS["blue"], lw=0.8, label="error")
            style.label(ax, f"{name} ({unit})")
            style.note(ax, f"largest after 60 s {np.abs(values[settled]).max():.3f} {unit}")
            ax.set_ylim(-top, top)
    style.legend(figure, axes.ravel().tolist())
    return figure


def _restarted(plan: Plan, gaps: Ensemble, flights: Sequence[Flight]) -> Figure:
    """Growth of the position error in the first gap: filter, its own sigma, restarted INS; rms of the runs."""
    epochs = np.array(plan.gap_epochs(0))
    rows = [gaps.at(t) for t in epochs]
    ours, sigma = gaps.rms()[rows, 6:9], gaps.sigma()[rows, 6:9]
    theirs = np.sqrt(np.mean(np.array([flight.restarted[0] for flight in flights]) ** 2, axis=0))
    title = f"Position error in the first gap, rms of {gaps.runs} runs"
    figure, axes = style.grid(1, 3, title=title, width=10.0, row_height=2.8)
    for column, (name, (i, _)) in enumerate(zip(_NAMES, _ENU, strict=True)):
        ax = axes[0, column]
        ax.plot(epochs, theirs[:, i], color=COLORS["red"], lw=1.4, label="INS restarted at the gap")
        ax.plot(epochs, ours[:, i], color=COLORS["blue"], lw=1.4, label="coasting filter")
        ax.plot(epochs, sigma[:, i], "--", color=COLORS["black"], lw=1.0, label="the filter's own sigma")
        ax.set_yscale("log")
        style.label(ax, f"{name} (m)")
    style.legend(figure, axes.ravel().tolist())
    return figure
