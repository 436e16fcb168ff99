"""Figures of the reproduction of Aleshkin et al. (2021): Bode, step responses, stability, comparison."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from gnssins.ahrs import Cross
from gnssins.ahrs.compare import Comparison
from gnssins.ahrs.disturbed import PHASES
from gnssins.analysis.ahrs import response
from gnssins.plots import style
from gnssins.plots.ahrs import bode, stability_map, steps
from gnssins.plots.style import COLORS
from gnssins.reproduce.aleshkin_runs import BODE_HZ, CHEBYSHEV, CROSS, POSITIONAL, TUNINGS, Experiment, Path

__all__ = ["draw"]


def draw(found: Experiment, compared: Comparison) -> dict[str, Figure]:
    """Make all figures."""
    return {
        "bode_measured": _bode(found, [p for p in found.points if p.reading == "measured"], "Measured angle"),
        "bode_gyro": _bode(found, [p for p in found.points if p.reading == "gyro"], "Rate"),
        "steps": steps({f"{law}: {angle}": one for (law, angle), one in found.steps.items()}),
        "stability": stability_map(
            {
                "X, published gains": CROSS,
                "X, n = 1.05 k": Cross(CROSS.k, 1.05 * CROSS.k),
                "PI, published gains": CHEBYSHEV,
            }
        ),
        "comparison": _comparison(compared),
    }


def _bode(found: Experiment, paths: list[Path], what: str) -> Figure:
    """Equations as lines, running law as crosses; sampling at 1 kHz."""
    lines = {p.text: response(TUNINGS[p.law], p.angle, p.reading) for p in paths}
    points = {p.text: (BODE_HZ, found.points[p]) for p in paths}
    if what == "Rate":
        lines["PI: gyro -> pitch"] = response(CHEBYSHEV, "pitch", "gyro")
    else:
        lines["P, 10 Hz"] = response(type(POSITIONAL)(20.0 * np.pi), "pitch")
    title = f"{what} to angle: equations, and the running law at 1 kHz (crosses)"
    return bode(lines, np.geomspace(0.3, 60.0, 500), title=title, points=points)


def _comparison(compared: Comparison) -> Figure:
    """Errors by phase, one panel per length of manoeuvre."""
    lengths = list(dict.fromkeys(r.manoeuvre_s for r in compared.rows))
    figure = Figure(figsize=(9.0, 2.9 * len(lengths) + 0.6), layout="constrained", facecolor="white")
    panels = np.atleast_1d(np.asarray(figure.subplots(len(lengths), 1, sharex=True), dtype=np.object_))
    colors = [COLORS[c] for c in ("blue", "orange", "green", "purple", "sky", "grey")]
    names = list(dict.fromkeys(r.method for r in compared.rows))
    width = 0.8 / len(names)
    phases = (*PHASES, "all")
    for ax, length in zip(panels, lengths, strict=True):
        style.tidy(ax)
        for i, name in enumerate(names):
            rows = [r for r in compared.rows if r.method == name and r.manoeuvre_s == length]
            if rows:
                x = np.arange(len(phases)) + (i - 0.5 * (len(names) - 1)) * width
                heights = [rows[0].rms_deg[p] for p in phases]
                runs = f"{rows[0].runs} run{'s' if rows[0].runs > 1 else ''}"
                ax.bar(x, heights, width, color=colors[i % len(colors)], label=f"{name}, {runs}")
        ax.set_yscale("log")
        ax.set_ylim(0.05, None)
        ax.set_xticks(range(len(phases)), phases)
        style.note(ax, f"manoeuvres of {length:g} s")
        style.label(ax, "Attitude error, rms (deg)")
    style.head(figure, "Total attitude error on the comparison scenario")
    style.legend(figure, panels[:1])
    return figure
