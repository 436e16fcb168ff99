"""Integrity tests of the fixes in the reproduction of Novik (2011): false alarms, steps, ramps, a step let through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import Integrity, Share
from gnssins.analysis.gates import Part, chi_square_limit, tolerance
from gnssins.reproduce.novik_runs import ACCEL_M_S2, AFTER_S, FALSE_ALARM, Fault, Plan
from gnssins.reproduce.novik_tables import AXES, ENU, Runs
from gnssins.reproduce.report import Cell, Table
from gnssins.units import NS_PER_S

__all__ = [
    "UNSETTLED_S",
    "absorbed_table",
    "alarm_table",
    "ramp_table",
    "settled",
    "step_table",
    "tolerance_share",
]

_PARTS: Final[tuple[Part, Part]] = ("position", "velocity")

#: Seconds after a change of the constellation during which the filter rightly expects steps.
UNSETTLED_S: Final = 10.0


def settled(tests: Integrity, plan: Plan) -> Integrity:
    """Fixes after the filter has settled, those of 10 s after a change of the constellation left out."""
    gnss = plan.simulator.scenario.gnss
    t = tests.t_ns / NS_PER_S
    keep = t > plan.settle_s
    for change in gnss.constellation_changes if gnss is not None else ():
        keep &= (t < change) | (t >= change + UNSETTLED_S)
    return _subset(tests, keep)


def _subset(tests: Integrity, keep: NDArray[np.bool_]) -> Integrity:
    parts = {
        name: getattr(tests, name)[keep] for name in ("t_ns", "run", "innovation", "covariance", "stretch")
    }
    return replace(tests, **parts)


def alarm_table(runs: Runs) -> Table:
    """False alarms of every test, per fix."""
    rows: list[list[Cell]] = []

    def add(part: Part, test: str, limit: float, share: Share) -> None:
        rows.append([part, test, limit, share.hits, share.trials, share.value, *share.bounds])

    for part in _PARTS:
        ground, reduced = runs.tests.alarms(part), runs.reduced.alarms(part)
        add(part, "trace ratio, reduced (published)", runs.reduced.delta, reduced["trace ratio"])
        add(part, "trace ratio, on the ground", runs.tests.delta, ground["trace ratio"])
        add(part, "chi-square", runs.tests.limit, ground["chi-square"])
        for window_s in runs.tests.windows_s:
            share = runs.tests.window_alarms(part, window_s)
            add(part, f"chi-square of the sum over {window_s:.0f} s", runs.tests.limit, share)
        add(part, "tolerance", 1.0, tolerance_share(runs, part, 0.0, 0))
    return Table(
        "false_alarms",
        f"False alarms per fix, all {runs.tests.t_ns.size} fixes of {runs.loop.runs} runs",
        ["part", "test", "limit", "alarms", "of", "rate", "95 % from", "to"],
        rows,
        f"Chi-square: limit for {FALSE_ALARM:g}. Tolerance: {ACCEL_M_S2:g} m/s^2, 5 sqrt(2) sigma.",
    )


def tolerance_share(runs: Runs, part: Part, step: float, axis: int) -> Share:
    """Share of fixes at which the tolerance test sees a step along an axis (0 north, 1 east, 2 down)."""
    at = slice(0, 3) if part == "position" else slice(3, 6)
    gnss = runs.plan.simulator.scenario.gnss
    if gnss is None or gnss.position_sd_m is None or gnss.velocity_sd_m_s is None:
        raise TypeError("the scenario has no fixes")
    sd = np.asarray(gnss.position_sd_m if part == "position" else gnss.velocity_sd_m_s, dtype=np.float64)
    jump = np.concatenate([flight.jumps[:, at] for flight in runs.flights])
    shift = step * np.eye(3)[axis]
    both = np.concatenate([jump + shift, jump - shift]) if step else jump
    value = tolerance(both, np.ones(len(both)), sd, ACCEL_M_S2, part).max(axis=1)
    return Share(int((value > 1.0).sum()), int(value.size))


def step_table(runs: Runs) -> Table:
    """Steps caught at the first fix, by test."""
    quiet = settled(runs.tests, runs.plan), settled(runs.reduced, runs.plan)
    rows: list[list[Cell]] = []
    sizes: dict[Part, tuple[float, ...]] = {
        "position": (10.0, 15.0, 20.0, 30.0),
        "velocity": (0.2, 0.3, 0.5, 1.0),
    }
    for part, step in ((part, step) for part, steps in sizes.items() for step in steps):
        unit = "m" if part == "position" else "m/s"
        label = f"{step:g} {unit}"

        def caught(tests: Integrity, test: str, part: Part = part, step: float = step) -> list[float]:
            return [tests.detection(part, step, axis)[test].value for axis in ENU]

        rows.append([part, label, "trace ratio, reduced (published)", *caught(quiet[1], "trace ratio")])
        rows.append([part, label, "trace ratio, on the ground", *caught(quiet[0], "trace ratio")])
        rows.append([part, label, "chi-square", *caught(quiet[0], "chi-square")])
        rows.append([part, label, "chi-square, all fixes", *caught(runs.tests, "chi-square")])
        rows.append(
            [part, label, "tolerance", *(tolerance_share(runs, part, step, axis).value for axis in ENU)]
        )
    return Table(
        "steps",
        "Share of steps caught at the first fix",
        ["part", "step", "test", *AXES],
        rows,
        f"Fixes after {runs.plan.settle_s:.0f} s, those of {UNSETTLED_S:.0f} s after a change of the constellation "
        f"left out; there the filter rightly\nexpects a step. Limits: ratio {runs.tests.delta:g}, chi-square "
        f"{chi_square_limit(FALSE_ALARM):.1f}.",
    )


def ramp_table(runs: Runs) -> Table:
    """Ramps of the position seen at the end of a window."""
    quiet = settled(runs.tests, runs.plan)
    rows: list[list[Cell]] = []
    for window_s in runs.tests.windows_s:
        for rate in (0.2, 0.5, 1.0, 2.0):
            shares = [quiet.ramp_detection("position", rate, axis, window_s).value for axis in ENU]
            rows.append([f"{window_s:.0f} s", rate, *shares])
    return Table(
        "ramps",
        "Share of ramps of the position seen by the chi-square test of the sum of innovations",
        ["window", "m/s", *AXES],
        rows,
        "The ramp begins with the window, and the filter is taken not to follow it: an upper bound for the longer one.",
    )


def absorbed_table(faults: Sequence[Fault]) -> Table:
    """A step of 15 m north: tests at the first fixes, and what it does to the position."""
    ratio = np.array([f.ratio for f in faults])
    chi = np.array([f.chi_square for f in faults])
    shift, guarded = np.array([f.shift for f in faults]), np.array([f.guarded for f in faults])
    limit = chi_square_limit(FALSE_ALARM)
    rows: list[list[Cell]] = []
    for i, second in enumerate(AFTER_S):
        refused = float(np.mean([f.refused[second] for f in faults]))
        rows.append(
            [
                second,
                float(shift[:, second].mean()),
                float(np.mean(ratio[:, i] >= 10.0)),
                float(np.mean(chi[:, i] >= limit)),
                refused,
                float(guarded[:, second].mean()),
            ]
        )
    longest = max(int(f.refused.sum()) for f in faults)
    return Table(
        "absorbed",
        f"A lasting step of 15 m north that is let through, {len(faults)} runs",
        [
            "after s", "shift of the position m", "alarms: trace ratio", "chi-square", "gate on: refused",
            "shift with the gate m",
        ],
        rows,
        f"Gate on: the position is refused until the filter's doubt about the slow error has grown, {longest} s at "
        "most; then the step\nis taken in all the same. A test by itself delays a lasting step, it does not remove it.",
    )  # fmt: skip
