"""Tables of the reproduction of Novik (2011), in its axes: east, north, up; body forward, up, right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import Ensemble, Integrity, chi_square_bounds
from gnssins.analysis.consistency import direction
from gnssins.reproduce.novik_linear import Honest
from gnssins.reproduce.novik_runs import Flight, Plan
from gnssins.reproduce.report import Cell, Table
from gnssins.units import ACCEL_BIAS, GYRO_BIAS

__all__ = [
    "AXES", "ENU", "PUBLISHED", "STATES", "Named", "Runs", "choice_table", "coarse_table", "consistency_table",
    "growth", "growth_start_table", "growth_table", "mean_nees", "scale_table", "state_table",
]  # fmt: skip

Array = NDArray[np.float64]

_URAD, _DEG_H, _UG = 1e6, 1.0 / GYRO_BIAS["deg/h"], 1.0 / ACCEL_BIAS["ug"]


@dataclass(frozen=True)
class Named:
    """A state of the publication: key and name, unit and factor for people, and its column in the engine."""

    key: str
    name: str
    unit: str
    factor: float
    column: int


#: All 22 states in the order of the publication.
STATES: Final = (
    Named("east", "position east", "m", 1.0, 7),
    Named("north", "position north", "m", 1.0, 6),
    Named("up", "height", "m", 1.0, 8),
    Named("v_east", "velocity east", "m/s", 1.0, 4),
    Named("v_north", "velocity north", "m/s", 1.0, 3),
    Named("v_up", "velocity up", "m/s", 1.0, 5),
    Named("tilt_east", "tilt about east", "urad", _URAD, 1),
    Named("tilt_north", "tilt about north", "urad", _URAD, 0),
    Named("heading", "heading", "urad", _URAD, 2),
    Named("gyro_x", "gyro x, forward", "deg/h", _DEG_H, 9),
    Named("gyro_y", "gyro y, up", "deg/h", _DEG_H, 11),
    Named("gyro_z", "gyro z, right", "deg/h", _DEG_H, 10),
    Named("accel_x", "accelerometer x, forward", "ug", _UG, 12),
    Named("accel_y", "accelerometer y, up", "ug", _UG, 14),
    Named("accel_z", "accelerometer z, right", "ug", _UG, 13),
    Named("baro", "barometer", "m", 1.0, 15),
    Named("slow_east", "GNSS slow error east", "m", 1.0, 17),
    Named("slow_north", "GNSS slow error north", "m", 1.0, 16),
    Named("slow_up", "GNSS slow error up", "m", 1.0, 18),
    Named("slow_v_east", "GNSS slow velocity error east", "m/s", 1.0, 20),
    Named("slow_v_north", "GNSS slow velocity error north", "m/s", 1.0, 19),
    Named("slow_v_up", "GNSS slow velocity error up", "m/s", 1.0, 21),
)

#: Table 4.3.1, SI times the factors above; sensor errors are labelled E, N, h in print but belong to the body axes.
PUBLISHED: Final = dict(
    zip(
        (state.key for state in STATES[:15]),
        (
            5.879, 4.648, 4.868, 0.0236, 0.0235, 0.0232, 84.2, 134.0, 474.0,
            2.5e-7 * _DEG_H, 1.28e-6 * _DEG_H, 3.8e-7 * _DEG_H, 50.0, 34.0, 47.0,
        ),
        strict=True,
    )
)  # fmt: skip

#: East, north, up from north, east, down; signs do not matter for magnitudes.
ENU: Final = [1, 0, 2]
AXES: Final = ("east", "north", "up")


@dataclass(frozen=True, eq=False)
class Runs:
    """All flights, put together."""

    plan: Plan
    flights: Sequence[Flight]
    loop: Ensemble
    gap: Ensemble
    scaled: Ensemble
    unscaled: Ensemble
    coarse: Ensemble
    tests: Integrity
    reduced: Integrity

    @classmethod
    def of(cls, plan: Plan, flights: Sequence[Flight], seed: int) -> Runs:
        """Put them together, in their order."""
        parts = {
            name: Ensemble.of([getattr(flight, name) for flight in flights], seed)
            for name in ("loop", "gap", "scaled", "unscaled", "coarse")
        }
        tests, reduced = (
            Integrity.combine([getattr(flight, name) for flight in flights]) for name in ("tests", "reduced")
        )
        return cls(plan, flights, tests=tests, reduced=reduced, **parts)


def mean_nees(found: Ensemble, group: str) -> tuple[Array, int, tuple[float, float]]:
    """Mean over the runs at each epoch, degrees of freedom, 99 % bounds of one epoch."""
    dof = found.dof[group]
    return (
        found.nees_values[group].mean(axis=0),
        dof,
        chi_square_bounds(dof, found.runs, found.probability),
    )


def state_table(runs: Runs, honest: Honest) -> Table:
    """Every state at the end of the closed loop, beside the filter's sigma and that of the publication's matrices."""
    found, k = runs.loop, runs.loop.at(runs.plan.end_s)
    figures = found.rms()[k], found.median()[k], found.p95()[k], found.sigma()[k]
    ratio, own = found.ratio()[k], honest.sd(round(runs.plan.end_s))
    rows: list[list[Cell]] = []
    for i, state in enumerate(STATES):
        values = [float(v[state.column] * state.factor) for v in figures]
        r = float(ratio[state.column])
        rows.append([state.name, state.unit, *values, r, found.verdict(r), float(own[i] * state.factor)])
    low, high = found.ratio_bounds
    return Table(
        "states",
        f"Every state at {runs.plan.end_s:.0f} s, ring laser gyros, mid receiver",
        [
            "state", "unit", "rms", "median", "95 %", "filter's sigma", "error/sigma", "the filter is",
            "sigma of the publication's matrices",
        ],
        rows,
        f"99 % bounds of error/sigma for {found.runs} runs: {low:.2f} .. {high:.2f}. Last column: covariance of the 22 "
        "states in the\npublication's coordinates, its matrices with the errata put right, no part of the engine.",
    )  # fmt: skip


def coarse_table(runs: Runs) -> Table:
    """Table 4.3.1 beside ours: the unit of the data sheet, and a coarse one."""
    k = runs.loop.at(runs.plan.end_s)
    over = runs.loop.over_window(0)[0], runs.coarse.over_window(0)[0]
    rows: list[list[Cell]] = []
    for state in STATES[:15]:
        column = state.column
        fine, coarse = runs.loop.rms()[k, column], runs.coarse.rms()[k, column]
        values = (fine, over[0][column], coarse, over[1][column])
        scaled = [float(v * state.factor) for v in values]
        rows.append([state.name, state.unit, PUBLISHED[state.key], *scaled, PUBLISHED[state.key] / scaled[2]])
    end, settle = runs.plan.end_s, runs.plan.settle_s
    return Table(
        "table_4_3_1",
        "The publication's table 4.3.1, one run, beside ours, rms of all runs",
        [
            "state", "unit", "published", f"data sheet, {end:.0f} s", f"data sheet, {settle:.0f}-{end:.0f} s",
            f"coarse, {end:.0f} s", f"coarse, {settle:.0f}-{end:.0f} s", "published/coarse",
        ],
        rows,
        "Data sheet: 0.003 deg/h and 25 ug, mid receiver. Coarse: 1 deg/h, 1 mg, receiver at the low end of its "
        "ranges. Position on the\nground; if the published east is the reduced dR_E, it is 3.37 m on the ground.",
    )  # fmt: skip


def consistency_table(runs: Runs) -> Table:
    """NEES by group and NIS of the closed loop with the published unit."""
    rows: list[list[Cell]] = []
    for group in runs.loop.nees_values:
        mean, dof, bounds = mean_nees(runs.loop, group)
        inside = float(np.mean((mean >= bounds[0]) & (mean <= bounds[1])))
        verdict = direction(float(mean.mean()), dof, bounds)
        rows.append([f"NEES {group}", dof, float(mean.mean()), *bounds, f"{100 * inside:.0f} %", verdict])
    for name, part in runs.loop.nis.groups.items():
        rows.append([f"NIS {name}", part.dof, part.mean, *part.bounds, "", part.verdict])
    return Table(
        "consistency",
        f"NEES and NIS of the closed loop, {runs.loop.runs} runs, {len(runs.plan.grid())} epochs",
        ["what", "expected", "mean", "99 % from", "to", "epochs inside", "the filter is"],
        rows,
        "NEES: bounds of one epoch; NIS: bounds of the mean of all measurements.",
    )


# ---- outage


def growth(runs: Runs) -> Array:
    """Growth of the position error E, N, h (m) since the last fix, shape (runs, seconds, 3)."""
    errors = runs.gap.errors[:, :, 6:9] - runs.gap.errors[:, :1, 6:9]
    return np.asarray(errors[:, :, ENU])


def growth_table(runs: Runs, honest: Honest) -> Table:
    """Growth of the position error at some seconds of the outage."""
    grown = growth(runs)
    end = round(runs.plan.end_s)
    rows: list[list[Cell]] = []
    for second in (10, 30, 60, round(runs.plan.outage_s)):
        expected = honest.growth(end, second)
        for axis, name in enumerate(AXES):
            values = grown[:, second, axis]
            rms, median = float(np.sqrt(np.mean(values**2))), float(np.median(np.abs(values)))
            p95, worst = float(np.quantile(np.abs(values), 0.95)), float(np.abs(values).max())
            rows.append([second, name, rms, median, p95, worst, float(expected[axis])])
    return Table(
        "outage",
        f"GNSS off from {end} s on, barometer on: growth of the position error since the last fix, m",
        ["after s", "axis", "rms", "median", "95 %", "largest", "expected sigma"],
        rows,
        "Published: inside +-10 m for 100 s. The position itself keeps the slow error of the receiver, 5.7 m, "
        "whatever the INS does.",
    )


def growth_start_table(runs: Runs, honest: Honest) -> Table:
    """Expected growth over 100 s against the start of the outage."""
    changes = runs.plan.simulator.scenario.gnss
    rows: list[list[Cell]] = [
        [start, *map(float, honest.growth(start, round(runs.plan.outage_s)))]
        for start in range(200, round(runs.plan.end_s) + 1, 50)
    ]
    times = ", ".join(f"{t:.0f}" for t in (changes.constellation_changes if changes is not None else ()))
    return Table(
        "outage_start",
        f"Growth of the position error over {runs.plan.outage_s:.0f} s against the start of the outage: expected "
        "sigma, m",
        ["start s", *AXES],
        rows,
        f"The publication does not say when. Changes of the constellation at {times} s spoil the velocity for a while.",
    )


# ---- scale factors, choices


def scale_table(runs: Runs) -> Table:
    """NEES of nine states with scale-factor errors left in."""
    rows: list[list[Cell]] = []
    for label, found in (("off", runs.unscaled), ("on", runs.scaled)):
        mean, dof, bounds = mean_nees(found, "navigation")
        inside = float(np.mean((mean >= bounds[0]) & (mean <= bounds[1])))
        verdict = direction(float(mean.mean()), dof, bounds)
        figures = float(mean.mean()), float(mean.max()), *bounds
        rows.append([label, len(found.states), *figures, f"{100 * inside:.0f} %", verdict])
    return Table(
        "scale_factors",
        "Scale-factor errors of 5 ppm (gyros) and 100 ppm (accelerometers) left in: NEES of nine states",
        ["scale states", "states", "mean", "largest", "99 % from", "to", "epochs inside", "the filter is"],
        rows,
    )


def choice_table(choices: Mapping[str, str]) -> Table:
    """What the publication leaves open, and what was taken."""
    return Table(
        "choices",
        "What the publication leaves open, and what was taken here",
        ["what", "taken"],
        [[what, taken] for what, taken in choices.items()],
    )
