"""Tables of the reproduction of Fomichev and Tan (2017), and the figures that its claims share with them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import Ensemble
from gnssins.reproduce import consistency
from gnssins.reproduce.consistency import chi_square_row, nees_over
from gnssins.reproduce.fomichev_tan_runs import READINGS, Flight, Plan, Realisation
from gnssins.reproduce.report import Cell, Table
from gnssins.tables import table_unit

__all__ = [
    "ARCMIN",
    "AXES",
    "accuracy_table",
    "consistency_table",
    "gap_end",
    "gap_table",
    "mean_nees",
    "pooled",
    "reading_table",
    "restarted_gain",
    "restarted_table",
    "state_table",
]

Array = NDArray[np.float64]

AXES: Final = ("north", "east", "down")
ARCMIN: Final = 60.0 * 180.0 / math.pi


def pooled(values: Array) -> Array:
    """Runs and epochs together."""
    return values.reshape(-1, values.shape[-1])


def _grid_rows(plan: Plan, found: Ensemble) -> list[int]:
    return [found.at(time_s) for time_s in plan.grid()]


def mean_nees(plan: Plan, found: Ensemble, group: str) -> tuple[float, int, tuple[float, float]]:
    """Mean over the runs and the grid, degrees of freedom, 99 % bounds of one epoch."""
    return nees_over(found, group, _grid_rows(plan, found))


def gap_end(plan: Plan, found: Ensemble, gap: int) -> int:
    """Index of the last second of a gap."""
    return found.at(plan.gaps[gap][1] - 1.0)


def restarted_gain(gaps: Ensemble, flights: Sequence[Flight], gap: int) -> tuple[Array, Array]:
    """Root mean square position errors N, E, D (m) over a gap: coasting filter, restarted INS."""
    ours = np.sqrt(np.mean(gaps.window_rms[:, gap, 6:9] ** 2, axis=0))
    theirs = np.sqrt(np.mean(np.array([f.restarted_rms[gap] for f in flights]) ** 2, axis=0))
    return ours, theirs


def accuracy_table(plan: Plan, whole: Ensemble) -> Table:
    """Errors with GNSS throughout, in the steady state."""
    rms, sigma = whole.over_window(0)
    errors = np.abs(pooled(whole.errors))
    rows: list[list[Cell]] = []
    for i, state in enumerate(whole.states):
        unit, factor = ("arcmin", ARCMIN) if i < 3 else _unit(state.unit)
        median, p95 = np.quantile(errors[:, i], [0.5, 0.95])
        values = (rms[i], median, p95, sigma[i])
        rows.append([state.name, unit, *(float(v * factor) for v in values), float(rms[i] / sigma[i])])
    return Table(
        "accuracy",
        f"Variant 1, GNSS throughout: errors for t > {plan.after_s:.0f} s",
        ["state", "unit", "rms", "median", "95 %", "filter's sigma", "rms/sigma"],
        rows,
        "Attitude is the rotation about north, east, down: about down is the heading.",
    )


def _unit(si: str) -> tuple[str, float]:
    unit = table_unit(si)
    return unit.label, unit.factor


def state_table(plan: Plan, gaps: Ensemble) -> Table:
    """Every state in the last second before the first gap, over the runs, with the chi-square verdict."""
    begin = plan.gaps[0][0]
    k = gaps.at(begin - 1.0)
    every = gaps.rms()[k], gaps.median()[k], gaps.p95()[k], gaps.sigma()[k]
    ratio = gaps.ratio()[k]
    rows: list[list[Cell]] = []
    for i, state in enumerate(gaps.states):
        unit, factor = ("arcmin", ARCMIN) if i < 3 else _unit(state.unit)
        figures = [float(values[i] * factor) for values in every]
        rows.append([state.name, unit, *figures, float(ratio[i]), gaps.verdict(float(ratio[i]))])
    low, high = gaps.ratio_bounds
    return Table(
        "states",
        f"Every state at {begin - 1.0:.0f} s, the last second before the first gap",
        ["state", "unit", "rms", "median", "95 %", "filter's sigma", "error/sigma", "the filter is"],
        rows,
        f"99 % bounds of error/sigma for {gaps.runs} runs: {low:.2f} .. {high:.2f}; of {len(rows)} states one in "
        "five sets falls outside by chance.",
    )


def gap_table(plan: Plan, gaps: Ensemble, one: Realisation) -> Table:
    """Position and velocity at the end of each gap."""
    ratio, rms, sigma, median, p95 = gaps.ratio(), gaps.rms(), gaps.sigma(), gaps.median(), gaps.p95()
    rows: list[list[Cell]] = []
    for g, (begin, end) in enumerate(plan.gaps):
        k = gap_end(plan, gaps, g)
        row = int(np.searchsorted(one.gaps.time_s, end - 1.0))
        for quantity, unit, first, shown in (
            ("position", "m", 6, one.gaps.position),
            ("velocity", "m/s", 3, one.gaps.velocity),
        ):
            for axis, name in enumerate(AXES):
                i = first + axis
                figures = [float(values[k, i]) for values in (rms, median, p95, sigma, ratio)]
                verdict = gaps.verdict(figures[-1])
                label = f"{begin:.0f}-{end:.0f} s"
                rows.append([label, f"{quantity} {name}", unit, *figures, verdict, float(shown[row, axis])])
    low, high = gaps.ratio_bounds
    return Table(
        "gaps",
        "Variant 2: errors in the last second of each gap",
        [
            "gap", "error", "unit", "rms", "median", "95 %", "filter's sigma", "error/sigma", "the filter is",
            "one run, +1 sigma",
        ],
        rows,
        f"99 % bounds of error/sigma for {gaps.runs} runs: {low:.2f} .. {high:.2f}. Published, one run: north position "
        "about +-5 m in the first two gaps, east and up a little smaller.",
    )  # fmt: skip


def restarted_table(plan: Plan, gaps: Ensemble, flights: Sequence[Flight]) -> Table:
    """The coasting filter beside an INS that is only restarted at the gap."""
    rows: list[list[Cell]] = []
    for g, (begin, end) in enumerate(plan.gaps):
        ours, theirs = restarted_gain(gaps, flights, g)
        label = f"{begin:.0f}-{end:.0f} s"
        for axis, name in enumerate(AXES):
            rows.append(
                [label, name, float(ours[axis]), float(theirs[axis]), float(theirs[axis] / ours[axis])]
            )
        a, b = float(np.linalg.norm(ours)), float(np.linalg.norm(theirs))
        rows.append([label, "all three", a, b, b / a])
    return Table(
        "restarted",
        "Position error over each gap, root mean square over runs and seconds",
        ["gap", "axis", "coasting filter m", "restarted INS m", "gain"],
        rows,
        "The restarted INS runs freely from the start, with the drawn initial errors and raw sensors; at the gap its "
        "position and\nvelocity are set from the last fix.",
    )


def reading_table(plan: Plan, readings: Mapping[str, Ensemble]) -> Table:
    """Errors at the ends of the gaps in the three readings of the gyro noise."""
    rows: list[list[Cell]] = []
    for name in sorted(readings):
        found, reading = readings[name], READINGS[name]
        mean, _, _ = mean_nees(plan, found, "navigation")
        for g, (begin, end) in enumerate(plan.gaps):
            k = gap_end(plan, found, g)
            position, sigma = found.rms()[k, 6:9], found.sigma()[k, 6:9]
            rows.append(
                [
                    name,
                    reading.text,
                    reading.arw_deg_sqrt_h,
                    f"{begin:.0f}-{end:.0f} s",
                    *map(float, position),
                    *map(float, sigma),
                    float(ARCMIN * found.rms()[k, 2]),
                    mean,
                ]
            )
    return Table(
        "readings",
        "Position error in the last second of each gap in the three readings of the white gyro noise (rms of the runs)",
        [
            "reading", "0.001 deg/h means", "deg/sqrt(h)", "gap", "north m", "east m", "down m", "sigma N m",
            "sigma E m", "sigma D m", "heading arcmin", "NEES/9 states",
        ],
        rows,
        "The same seeds in all three; the filter knows the noise that was simulated.",
    )  # fmt: skip


def consistency_table(plan: Plan, whole: Ensemble, gaps: Ensemble, flights: Sequence[Flight]) -> Table:
    """NEES by group and NIS, both variants, with chi-square bounds and verdicts."""
    first = np.array([flight.first_nis for flight in flights])
    more = [chi_square_row("NIS first fix after a gap", 6, float(first.mean()), first.size)]
    return consistency.consistency_table(whole, gaps, plan.after_s, partial(_grid_rows, plan), more)
