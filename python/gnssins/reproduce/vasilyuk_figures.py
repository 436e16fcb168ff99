"""Figures of the reproduction of Vasilyuk (2019): route, settling, growth in the gap, observability."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gnssins import plots
from gnssins.analysis import Ensemble, Observability, ned_difference, observability, run_seed
from gnssins.plots import style
from gnssins.plots.style import BAND, COLORS
from gnssins.reproduce.vasilyuk_runs import Plan, Walk, growths
from gnssins.reproduce.vasilyuk_tables import DEG, PUBLISHED_GROWTH
from gnssins.runner import run
from gnssins.units import NS_PER_S

__all__ = ["draw"]

#: Walks drawn one by one.
_SHOWN: Final = 30


def draw(
    plan: Plan, walks: Sequence[Walk], raw: Sequence[Walk], whole: Ensemble, seed: int
) -> dict[str, Figure]:
    """Make all figures."""
    return {
        "route": _route(plan),
        "gyro_bias": _gyro_bias(plan, whole),
        "position_growth": _growth(walks, raw, "horizontal", "Horizontal (m)", 1.0),
        "attitude_growth": _attitude(walks, raw),
        "observability_sway": _observability(plan, "continuous", seed, "Observability, pole with sway"),
        "observability_no_sway": _observability(plan, "no-sway", seed, "Observability, pole without sway"),
    }


def _route(plan: Plan) -> Figure:
    truth = plan.simulator("continuous").truth
    place = ned_difference(truth.lla, np.broadcast_to(truth.lla[0], truth.lla.shape))
    figure = Figure(figsize=(5.6, 4.6), layout="constrained", facecolor="white")
    ax = figure.subplots()
    style.tidy(ax)
    ax.plot(place[:, 1], place[:, 0], color=COLORS["blue"], lw=1.4, label="route")
    t_s = truth.t_ns / NS_PER_S
    gap = (t_s >= plan.gap[0]) & (t_s <= plan.gap[1])
    ax.plot(place[gap, 1], place[gap, 0], color=COLORS["red"], lw=3.0, label="20 s without fixes")
    k = int(np.searchsorted(t_s, plan.settled_s))
    ax.plot(place[k, 1], place[k, 0], "s", color=COLORS["black"], ms=6, label="point A, 80 s")
    ax.plot(0.0, 0.0, "o", ms=6, mfc="white", mec=COLORS["black"], label="start")
    ax.set_aspect("equal")
    ax.set_xlabel("East (m)")
    style.label(ax, "North (m)")
    style.head(figure, "Walk with the pole")
    style.legend(figure, [ax])
    return figure


def _gyro_bias(plan: Plan, whole: Ensemble) -> Figure:
    """Errors of the gyro biases along the walk."""
    figure, axes = style.grid(3, title="Gyro biases: estimate minus truth")
    for row, name in enumerate(("gyro_bias_x", "gyro_bias_y", "gyro_bias_z")):
        ax, i = axes[row, 0], whole.column(name)
        sd = 3.0 * DEG * whole.sigma()[:, i]
        ax.fill_between(whole.time_s, -sd, sd, **BAND)
        for k in range(min(whole.runs, _SHOWN)):
            label = "one walk" if k == 0 else "_"
            ax.plot(whole.time_s, DEG * whole.errors[k, :, i], color=COLORS["grey"], lw=0.5, label=label)
        ax.plot(whole.time_s, DEG * whole.rms()[:, i], color=COLORS["blue"], lw=1.4, label="rms of the walks")
        for stretch in plan.stretches:
            if stretch.is_turn:
                ax.axvline(stretch.start_s, color=COLORS["orange"], lw=1.0, label="turn")
        style.label(ax, f"{name[-1]} (deg/s)")
        ax.set_ylim(-0.5, 0.5) if row == 2 else ax.set_ylim(-0.1, 0.1)
    style.legend(figure, axes[:, 0])
    return figure


def _growth(walks: Sequence[Walk], raw: Sequence[Walk], quantity: str, label: str, factor: float) -> Figure:
    figure, axes = style.grid(1, title="Growth without fixes", row_height=3.4)
    _lines(axes[0, 0], walks, raw, quantity, factor)
    style.label(axes[0, 0], label)
    axes[0, 0].set_xlabel("Time since the loss of fixes (s)", fontsize=10)
    style.legend(figure, axes[:, 0])
    return figure


def _attitude(walks: Sequence[Walk], raw: Sequence[Walk]) -> Figure:
    figure, axes = style.grid(3, title="Growth of the attitude errors without fixes")
    for ax, quantity in zip(axes[:, 0], ("roll", "pitch", "heading"), strict=True):
        _lines(ax, walks, raw, quantity, DEG)
        style.label(ax, f"{quantity.capitalize()} (deg)")
    axes[2, 0].set_xlabel("Time since the loss of fixes (s)", fontsize=10)
    style.legend(figure, axes[:, 0])
    return figure


def _lines(ax: Axes, walks: Sequence[Walk], raw: Sequence[Walk], quantity: str, factor: float) -> None:
    """Root mean squares of both sets against the corrected run, the sigma, and what was published."""
    corrected, truth = growths(walks)
    other, _ = growths(raw)
    at = corrected.at_s
    for growth, reading, colour, dashes, text in (
        (corrected, "rms", "black", "-", "growth"),
        (truth, "rms", "green", "-.", "error against the truth"),
        (truth, "sigma", "sky", "--", "filter's sigma"),
        (other, "rms", "orange", ":", "growth, uncalibrated"),
    ):
        values = [factor * growth.value(reading, quantity, float(t)) for t in at]
        ax.plot(at, values, dashes, color=COLORS[colour], lw=1.6, label=text)
    ax.plot(
        (10.0, 20.0), PUBLISHED_GROWTH[quantity], "D", color=COLORS["red"], ms=6, label="published growth"
    )
    ax.set_ylim(bottom=0.0)
    ax.set_xticks(np.arange(0.0, 20.5, 5.0))


def _observability(plan: Plan, variant: str, seed: int, title: str) -> Figure:
    """Rank and flags along the first walk."""
    simulated = plan.simulator(variant).run(run_seed(seed, 0))
    found: Observability = observability(run(plan.config(linearise=True), simulated))
    return plots.observability(found, title)
