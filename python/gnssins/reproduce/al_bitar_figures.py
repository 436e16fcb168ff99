"""The figures of Al Bitar and Gavrilov (2019), 4 to 8, growth of the errors, and observability along the drive."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from numpy.typing import NDArray

from gnssins.analysis import (
    Ensemble,
    NavErrors,
    Observability,
    OutageGrowth,
    compare,
    observability,
    run_seed,
)
from gnssins.plots import observability as observability_figure
from gnssins.plots import style
from gnssins.plots.style import BAND, COLORS
from gnssins.reproduce.al_bitar_published import PUBLISHED_TABLE, TIMES_S
from gnssins.reproduce.al_bitar_runs import Drive, Plan
from gnssins.reproduce.al_bitar_tables import WINDOW_S, Manoeuvre
from gnssins.result import Result
from gnssins.runner import run
from gnssins.sim import Simulated, Simulator
from gnssins.units import ACCEL_BIAS, DEG_TO_RAD, GYRO_BIAS, NS_PER_S

__all__ = ["Shown", "draw", "show"]

Array = NDArray[np.float64]
Windows = NDArray[np.int64]

_NONE: Windows = np.empty((0, 2), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Shown:
    """One drive in detail, for the figures.

    Parameters
    ----------
    simulated : Simulated
        The drive.
    whole, gaps : Result
        Filtered with GNSS throughout and with the gaps.
    errors : NavErrors
        Errors with the gaps.
    observability : Observability
        Of a filter with one bias per sensor along the true motion, windows of 31 fixes.
    """

    simulated: Simulated
    whole: Result
    gaps: Result
    errors: NavErrors
    observability: Observability


def show(plan: Plan, simulator: Simulator, seed: int) -> Shown:
    """Simulate the first drive of a set again and keep everything."""
    simulated = simulator.run(run_seed(seed, 0))
    gaps = run(plan.config(True), simulated)
    return Shown(
        simulated=simulated,
        whole=run(plan.config(False), simulated),
        gaps=gaps,
        errors=compare(gaps, simulated.truth),
        observability=observability(
            run(plan.one_bias(False, linearise=True), plan.faultless().run(run_seed(seed, 0)))
        ),
    )


def draw(
    plan: Plan,
    whole: Ensemble,
    gaps: Ensemble,
    found: Mapping[str, OutageGrowth],
    drives: Sequence[Drive],
    shown: Shown,
    classes: Sequence[Manoeuvre],
) -> dict[str, Figure]:
    """Make all figures; the key of each says which one of the publication it corresponds to."""
    windows = np.rint(np.array(plan.gaps) * NS_PER_S).astype(np.int64)
    seen = observability_figure(shown.observability, "Observability, one bias per sensor")
    return {
        "figure_4_biases": _biases(plan, drives[0], shown),
        "figure_5_heading_force": _heading(plan, whole),
        "figure_5_change": _change(plan, whole, classes),
        "figure_6_distance": _distance(plan, whole, _NONE, "Figure 6: E_xyz, GNSS throughout"),
        "figure_7_route": _route(plan, shown),
        "figure_8_distance_gaps": _distance(plan, gaps, windows, "Figure 8: E_xyz with the gaps", log=True),
        "growth": _growth(found),
        "observability": seen,
    }


def _biases(plan: Plan, drive: Drive, shown: Shown) -> Figure:
    """Estimated biases of one drive, walk + Markov error, with the truth and the filter's band."""
    figure, axes = style.grid(
        3, 2, title="Figure 4: bias estimates, GNSS throughout", width=10.0, row_height=1.7
    )
    blocks, result = shown.simulated.truth_blocks, shown.whole
    t_s = np.array(plan.epochs)
    t_true = shown.simulated.truth.t_ns / NS_PER_S
    names = [state.name for state in result.block_states]
    for column, (sensor, unit, factor) in enumerate(
        (("gyro", "deg/h", GYRO_BIAS["deg/h"]), ("accel", "mg", ACCEL_BIAS["mg"]))
    ):
        true = (blocks[f"{sensor}_walk"] + blocks[f"{sensor}_drift"]) / factor
        for row, axis in enumerate("xyz"):
            ax = axes[row, column]
            at = [names.index(f"{sensor}_{part}_{axis}") for part in ("walk", "drift")]
            estimate = result.x[:, at].sum(axis=1) / factor
            band = 3.0 * drive.sums.sigma[:, 3 * column + row] / factor
            middle = np.interp(t_s, result.time_s, estimate)
            ax.fill_between(t_s, middle - band, middle + band, **BAND)
            ax.plot(*style.thin(t_true, true[:, row]), color=COLORS["black"], lw=1.0, label="truth")
            ax.plot(*style.envelope(result.time_s, estimate), color=COLORS["blue"], lw=1.0, label="estimate")
            settled = t_s > 100.0
            low, high = (middle - band)[settled].min(), (middle + band)[settled].max()
            room = 1.5 * max(high - low, 1e-9)
            ax.set_ylim(0.5 * (low + high) - room, 0.5 * (low + high) + room)
            style.label(ax, f"{sensor} {axis} ({unit})")
    style.legend(figure, axes.ravel().tolist())
    return figure


def _heading(plan: Plan, whole: Ensemble) -> Figure:
    """Specific force, heading error and z gyro bias over time."""
    figure, axes = style.grid(3, title="Figure 5: heading error and specific force", row_height=1.7)
    force, t_s = plan.force, np.array(plan.epochs)
    axes[0, 0].plot(*style.envelope(force.time_s, force.size), color=COLORS["black"], lw=0.8)
    style.label(axes[0, 0], "|f| (m/s²)")
    phi, walk, markov = (whole.column(name) for name in ("phi_d", "gyro_walk_z", "gyro_drift_z"))
    bias = whole.errors[:, :, walk] + whole.errors[:, :, markov]
    rms = np.sqrt(np.mean(bias**2, axis=0)) / GYRO_BIAS["deg/h"]
    for ax, values, sigma, name in (
        (
            axes[1, 0],
            whole.rms()[:, phi] / DEG_TO_RAD,
            whole.sigma()[:, phi] / DEG_TO_RAD,
            "Heading (deg)",
        ),
        (axes[2, 0], rms, None, "Gyro bias z (deg/h)"),
    ):
        ax.plot(t_s, values, color=COLORS["blue"], lw=1.1, label=f"rms of {whole.runs} runs")
        if sigma is not None:
            ax.plot(t_s, sigma, "--", color=COLORS["red"], lw=1.0, label="the filter's own sigma")
        ax.set_yscale("log")
        ax.yaxis.set_minor_formatter(NullFormatter())
        style.label(ax, name)
    style.legend(figure, axes[:, 0])
    return figure


def _change(plan: Plan, whole: Ensemble, classes: Sequence[Manoeuvre]) -> Figure:
    """Change of the heading error against the acceleration of the same seconds."""
    epochs, step = np.array(plan.epochs), round(WINDOW_S)
    begin, end = epochs[:-step], epochs[step:]
    sigma = np.log(whole.sigma()[:, whole.column("phi_d")])
    settled = begin >= plan.after_s
    least = 3e-4
    force = np.maximum(plan.force.rms(begin, end)[settled], least)
    percent = 100.0 * np.expm1(10.0 / WINDOW_S * (sigma[step:] - sigma[:-step])[settled])
    figure = Figure(figsize=(8.0, 3.6), layout="constrained", facecolor="white")
    ax = figure.subplots()
    style.tidy(ax)
    ax.plot(force, percent, ".", ms=4, color=COLORS["sky"], label="the filter's own sigma, each second")
    for i, m in enumerate(classes):
        span = [max(m.low, 0.8 * least), min(m.high, 1.1 * float(force.max()))]
        for value, color, name in (
            (m.sigma_change, "blue", "its mean by class"),
            (m.error_change, "red", f"rms error of {whole.runs} runs, mean by class"),
        ):
            label = name if i == 0 else "_"
            ax.plot(span, [100.0 * math.expm1(value)] * 2, color=COLORS[color], lw=2.0, label=label)
    ax.axhline(0.0, color=COLORS["grey"], lw=0.8)
    ax.set_xscale("log")
    ax.set_xlabel("Acceleration, rms of 6 s (m/s²), all below 0.0003 at the left edge")
    style.label(ax, "Change of the heading error\nper 10 s (%)")
    figure.suptitle(
        "Figure 5: heading error against acceleration", x=0.01, ha="left", fontsize=12, fontweight="bold"
    )
    style.legend(figure, [ax])
    return figure


def _distance(plan: Plan, found: Ensemble, windows: Windows, title: str, *, log: bool = False) -> Figure:
    """Distance from the truth over time: one drive, rms of all, and what the filter claims."""
    figure, axes = style.grid(1, title=title, row_height=3.0)
    ax, t_s = axes[0, 0], np.array(plan.epochs)
    style.shade(ax, windows)
    each = np.linalg.norm(found.errors[:, :, 6:9], axis=2)
    sigma = np.sqrt(np.mean(np.sum(found.sigmas[:, :, 6:9] ** 2, axis=2), axis=0))
    ax.plot(t_s, each[0], color=COLORS["sky"], lw=0.9, label="one drive")
    ax.plot(
        t_s,
        np.sqrt(np.mean(each**2, axis=0)),
        color=COLORS["blue"],
        lw=1.2,
        label=f"rms of {found.runs} drives",
    )
    ax.plot(t_s, sigma, "--", color=COLORS["black"], lw=1.0, label="the filter's own sigma")
    if log:
        ax.set_yscale("log")
        ax.set_ylim(0.03, 2.0 * float(each[0].max()))
    else:
        ax.set_ylim(0.0, 1.1 * float(each[0].max()))
    style.label(ax, "E_xyz (m)")
    style.legend(figure, [ax])
    return figure


def _route(plan: Plan, shown: Shown) -> Figure:
    """Route seen from above, and what the filter makes of the gaps."""
    truth, result = shown.simulated.truth, shown.gaps
    figure = Figure(figsize=(8.0, 6.0), layout="constrained", facecolor="white")
    ax = figure.subplots()
    style.tidy(ax)
    lat0, lon0 = truth.lla[0, :2]
    north, east = 6.37e6, 6.39e6 * math.cos(lat0)

    def plane(lla: Array) -> tuple[Array, Array]:
        return (lla[:, 1] - lon0) * east, (lla[:, 0] - lat0) * north

    ax.plot(*style.thin(*plane(truth.lla)), color=COLORS["black"], lw=1.0, label="truth")
    for i, (begin, end) in enumerate(plan.gaps):
        inside = (result.time_s >= begin) & (result.time_s <= end)
        x, y = plane(result.lla[inside])
        ax.plot(x, y, color=COLORS["red"], lw=1.8, label="filter without GNSS" if i == 0 else "_")
        ax.annotate(f"{i + 1}", (x[-1], y[-1]), xytext=(5, 5), textcoords="offset points", fontsize=9)
    ax.plot(0.0, 0.0, "o", ms=6, mfc="white", mec=COLORS["black"], label="start")
    ax.set_aspect("equal")
    ax.set_xlabel("East (m)")
    style.label(ax, "North (m)")
    figure.suptitle("Figure 7: route with gaps", x=0.01, ha="left", fontsize=12, fontweight="bold")
    style.legend(figure, [ax])
    return figure


def _growth(found: Mapping[str, OutageGrowth]) -> Figure:
    """Growth of E_xyz and of the heading error: both readings, the filter's sigma, two antennas, published."""
    ours, dual = found["published"], found["heading"]
    figure, axes = style.grid(
        1, 2, title=f"Errors after the loss of GNSS, means of {ours.gaps} gaps", width=10.0, row_height=3.0
    )
    for ax, key, factor, name in (
        (axes[0, 0], "distance", 1.0, "E_xyz (m)"),
        (axes[0, 1], "heading", 1.0 / DEG_TO_RAD, "Heading (deg)"),
    ):
        for growth, reading, label, color, line in (
            (ours, "so_far", "R1", "sky", "o-"),
            (ours, "at_end", "R2", "blue", "o-"),
            (ours, "sigma", "the filter's own sigma", "black", "--"),
            (dual, "at_end", "R2, two antennas", "green", "o-"),
        ):
            values = [factor * growth.value(reading, key, t) for t in growth.at_s]
            ax.plot(growth.at_s, values, line, ms=3, lw=1.2, color=COLORS[color], label=label)
        label = "published, a recorded drive"
        ax.plot(TIMES_S, PUBLISHED_TABLE[key], "s-", ms=4, lw=1.2, color=COLORS["red"], label=label)
        ax.set_yscale("log")
        ax.set_xlabel("Time since the loss of GNSS (s)")
        style.label(ax, name)
    style.legend(figure, axes.ravel().tolist())
    return figure
