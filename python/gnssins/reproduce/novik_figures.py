"""The figures of Novik (2011) in its axes, and two that it does not show: the outage and the integrity tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gnssins import _core
from gnssins.plots import style
from gnssins.plots.style import BAND, COLORS
from gnssins.reproduce.novik_free import Uncoupled, uncoupled_growth
from gnssins.reproduce.novik_integrity import settled
from gnssins.reproduce.novik_linear import Honest
from gnssins.reproduce.novik_runs import Realisation
from gnssins.reproduce.novik_tables import AXES, ENU, STATES, Named, Runs, growth
from gnssins.tables import seconds
from gnssins.units import NS_PER_S

if TYPE_CHECKING:
    from gnssins.analysis.schuler import SchulerCurves

__all__ = ["draw"]

Array = NDArray[np.float64]

#: East, north, up from north, east, down: signs.
_SIGN = np.array([1.0, 1.0, -1.0])


def draw(
    runs: Runs,
    one: Realisation,
    honest: Honest,
    apart: Sequence[Mapping[str, Uncoupled]],
    curves: SchulerCurves,
) -> dict[str, Figure]:
    """Make all figures."""
    from gnssins.plots import schuler

    end = runs.plan.end_s
    errors = one.errors
    gap = np.rint(np.array([[end, end + runs.plan.outage_s]]) * NS_PER_S).astype(np.int64)
    tilt = np.column_stack([errors.phi[:, 1], errors.phi[:, 0], -errors.phi[:, 2]])
    sd = one.result.sd[np.searchsorted(one.result.t_ns, errors.t_ns)]
    tilt_sd = np.sqrt(np.array([np.diag(m)[:3] for m in one.result.covariance.matrix]))[:, ENU]
    at = seconds(one.result.covariance.t_ns)
    return {
        "trajectory": _trajectory(one),
        "coordinates": _errors(
            "Errors of the coordinates", "m", errors.time_s, errors.position[:, ENU] * _SIGN, errors.time_s,
            sd[:, :3][:, ENU], gap,
        ),
        "velocity": _errors(
            "Errors of the velocity", "m/s", errors.time_s, errors.velocity[:, ENU] * _SIGN, errors.time_s,
            sd[:, 3:6][:, ENU], gap,
        ),
        "tilt": _errors(
            "Errors of the attitude about east, north, up", "mrad", errors.time_s, 1e3 * tilt, at, 1e3 * tilt_sd, gap
        ),
        "gyros": _sensors(one, "Gyro drifts: estimate and truth", STATES[9:12], gap),
        "accelerometers": _sensors(one, "Accelerometer errors: estimate and truth", STATES[12:15], gap),
        "attitude": _attitude(one),
        "schuler": schuler(curves),
        "outage": _outage(runs, honest, apart),
        "integrity": _integrity(runs),
    }  # fmt: skip


def _trajectory(one: Realisation) -> Figure:
    """Track in space, its shadow on the ground."""
    truth = one.simulated.dataset.truth
    if truth is None:
        raise TypeError("the simulated flight has no truth")
    east = np.radians(55.0)
    x = (truth.lla[:, 1] - truth.lla[0, 1]) * 6.371e3 * np.cos(east)
    y = (truth.lla[:, 0] - truth.lla[0, 0]) * 6.371e3
    x, y, z = style.thin(x, y, truth.lla[:, 2] / 1e3)
    figure = Figure(figsize=(7.0, 4.6), layout="constrained", facecolor="white")
    ax = figure.add_subplot(projection="3d")
    ax.plot(x, y, z, color=COLORS["blue"], lw=1.6)
    ax.plot(x, y, np.zeros_like(z), color=COLORS["grey"], lw=0.9)
    ax.set_xlabel("East (km)", labelpad=12)
    ax.set_ylabel("North (km)", labelpad=8)
    ax.set_zlabel("Height (km)")
    ax.set_box_aspect((2.2, 1.2, 0.8))
    figure.suptitle("Trajectory", x=0.01, ha="left", fontsize=12, fontweight="bold")
    return figure


def _errors(
    title: str, unit: str, time_s: Array, values: Array, sd_time_s: Array, sd: Array, gap: NDArray[np.int64]
) -> Figure:
    """Three errors with their 3-sigma bands."""
    figure, axes = style.grid(3, title=title, row_height=1.7)
    calm = time_s > 100.0
    for i, (ax, name) in enumerate(zip(axes[:, 0], ("East", "North", "Up"), strict=True)):
        style.shade(ax, gap)
        ax.fill_between(sd_time_s, -3.0 * sd[:, i], 3.0 * sd[:, i], **BAND)
        ax.plot(*style.envelope(time_s, values[:, i]), color=COLORS["blue"], lw=0.9, label="error")
        top = 1.15 * max(3.0 * sd[sd_time_s > 100.0, i].max(), np.abs(values[calm, i]).max())
        ax.set_ylim(-top, top)
        style.label(ax, f"{name} ({unit})")
    style.legend(figure, axes[:, 0])
    return figure


def _sensors(one: Realisation, title: str, states: Sequence[Named], gap: NDArray[np.int64]) -> Figure:
    """Estimates of three sensors beside the truth."""
    figure, axes = style.grid(3, title=title, row_height=1.7)
    result, truth = one.result, one.simulated.dataset.truth
    time_s = seconds(result.t_ns)
    for ax, state in zip(axes[:, 0], states, strict=True):
        column = state.column - 9
        block = one.simulated.truth_blocks["gyro_bias" if column < 3 else "accel_bias"]
        style.shade(ax, gap)
        value, sd = state.factor * result.x[:, column], 3.0 * state.factor * result.x_sd[:, column]
        ax.fill_between(time_s, value - sd, value + sd, **BAND)
        ax.plot(time_s, value, color=COLORS["blue"], lw=1.0, label="estimate")
        if truth is not None:
            line = style.thin(seconds(truth.t_ns), state.factor * block[:, column % 3])
            ax.plot(*line, color=COLORS["red"], lw=1.0, label="truth")
        unit = "deg/h" if column < 3 else "µg"
        style.label(ax, f"{state.key.split('_')[1]} ({unit})")
        style.note(ax, state.name.split(", ")[1])
    style.legend(figure, axes[:, 0])
    return figure


def _attitude(one: Realisation) -> Figure:
    """Heading, pitch, roll of the flight."""
    truth = one.simulated.dataset.truth
    if truth is None or truth.q_nb is None:
        raise TypeError("the simulated flight has no attitude")
    euler = np.degrees(_core.quat_to_euler(np.ascontiguousarray(truth.q_nb)))
    figure, axes = style.grid(3, title="Attitude", row_height=1.5)
    for ax, name, column in zip(axes[:, 0], ("Heading", "Pitch", "Roll"), (2, 1, 0), strict=True):
        ax.plot(*style.thin(seconds(truth.t_ns), euler[:, column]), color=COLORS["blue"], lw=1.2)
        style.label(ax, f"{name} (deg)")
    return figure


def _outage(runs: Runs, honest: Honest, apart: Sequence[Mapping[str, Uncoupled]]) -> Figure:
    """Growth in the outage: all runs, their rms, what is expected, and an INS slaved until then."""
    grown, end = growth(runs), round(runs.plan.end_s)
    after = np.arange(grown.shape[1], dtype=np.float64)
    marks = np.arange(10, round(runs.plan.outage_s) + 1, 10)
    expected = np.array([honest.growth(end, int(m)) for m in marks])
    slaved = np.sqrt(np.mean(uncoupled_growth(apart, "slaved") ** 2, axis=0)) if apart else None
    figure, axes = style.grid(1, 3, width=10.0, row_height=3.0)
    figure.suptitle(
        f"Growth of the position error without GNSS, barometer on, {runs.loop.runs} runs",
        x=0.01,
        ha="left",
        fontsize=12,
        fontweight="bold",
    )
    for i, name in enumerate(AXES):
        ax = axes[0, i]
        for k, line in enumerate(grown[:, :, i]):
            label = "runs" if k == 0 else "_"
            ax.plot(after, line * _SIGN[i], color=COLORS["grey"], lw=0.4, alpha=0.6, label=label)
        rms = np.sqrt(np.mean(grown[:, :, i] ** 2, axis=0))
        ax.plot(after, rms, color=COLORS["blue"], lw=1.6, label="rms")
        ax.plot(marks, expected[:, i], "--", color=COLORS["black"], lw=1.0, label="expected sigma")
        if slaved is not None:
            ax.plot(after, slaved[:, i], color=COLORS["red"], lw=1.2, label="INS slaved until then, rms")
        ax.set_ylim(-12.0, 12.0)
        for bound in (-10.0, 10.0):
            ax.axhline(bound, color=COLORS["black"], lw=0.8, ls=":", label="published" if bound > 0 else "_")
        style.label(ax, f"{name.capitalize()} (m)")
        ax.set_xlabel("Time since the last fix (s)")
    style.legend(figure, axes.ravel().tolist())
    return figure


def _integrity(runs: Runs) -> Figure:
    """Share of steps of the position caught at the first fix, against their size."""
    ground, reduced = settled(runs.tests, runs.plan), settled(runs.reduced, runs.plan)
    sizes = np.arange(4.0, 26.5, 1.0)
    figure, axes = style.grid(1, 3, width=10.0, row_height=3.0)
    figure.suptitle(
        "Steps of the position caught at the first fix", x=0.01, ha="left", fontsize=12, fontweight="bold"
    )
    curves = (
        ("chi-square, 1e-5", ground, "chi-square", COLORS["blue"]),
        ("trace ratio, 10, reduced (published)", reduced, "trace ratio", COLORS["red"]),
        ("trace ratio, 10, on the ground", ground, "trace ratio", COLORS["orange"]),
    )
    for i, (axis, name) in enumerate(zip(ENU, AXES, strict=True)):
        ax = axes[0, i]
        for label, tests, test, color in curves:
            share = [tests.detection("position", float(size), axis)[test].value for size in sizes]
            ax.plot(sizes, share, color=color, lw=1.4, label=label)
        style.label(ax, f"Share, {name}")
        ax.set_xlabel("Step (m)")
    style.legend(figure, axes.ravel().tolist())
    return figure
