"""Tables of the reproduction of Al Bitar and Gavrilov (2019), and the figures that its claims share with them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import Ensemble, Observability, OutageGrowth, chi_square_bounds
from gnssins.analysis.consistency import direction
from gnssins.reproduce import consistency
from gnssins.reproduce.al_bitar_published import LABELS, PUBLISHED_TABLE, REFERENCE_R1, REFERENCE_R2, TIMES_S
from gnssins.reproduce.al_bitar_runs import Drive, Plan
from gnssins.reproduce.consistency import chi_square_row, nees_over
from gnssins.reproduce.report import Cell, Table
from gnssins.tables import table_unit
from gnssins.units import ACCEL_BIAS, DEG_TO_RAD, GYRO_BIAS

__all__ = [
    "BINS",
    "FILTERS",
    "Manoeuvre",
    "bias_table",
    "consistency_table",
    "gap_end_table",
    "gap_nees",
    "gap_ratio",
    "manoeuvre_table",
    "manoeuvres",
    "mean_nees",
    "outage_rows",
    "variant_table",
]

Array = NDArray[np.float64]

#: Classes of the acceleration, m/s^2.
BINS: Final = ((0.0, 0.001), (0.001, 0.3), (0.3, 1.0), (1.0, math.inf))

#: Length of the windows over which the acceleration is averaged, s: 31 fixes.
WINDOW_S: Final = 6.0

#: Filters in the gaps, and what they are.
FILTERS: Final[Mapping[str, str]] = {
    "published": "as published, calibrated sensors",
    "heading": "with the heading of two antennas",
    "calibrated 1": "S of 1e-3, known and taken off",
    "uncalibrated 1": "S of 1e-3, left in",
    "states 1": "S of 1e-3, estimated (39 states)",
    "calibrated 10": "S of 1e-2, known and taken off",
    "uncalibrated 10": "S of 1e-2, left in",
    "states 10": "S of 1e-2, estimated (39 states)",
}


# ---- the table of the publication


def outage_rows(plan: Plan, growth: OutageGrowth) -> Table:
    """The whole table of the publication beside both of our readings, the filter's sigma and the reference program."""
    rows: list[list[Cell]] = []
    radius = _metres_per_rad(growth)
    for key, (label, unit, factor) in LABELS.items():
        for reading, values in _readings(key, radius).items():
            rows.append([label, unit, reading, *_at(plan, values)])
        for reading, name in (("so_far", "ours R1"), ("at_end", "ours R2"), ("sigma", "filter's sigma")):
            figures = [factor * growth.value(reading, key, t) for t in plan.at_s]
            rows.append([label, unit, name, *figures])
    return Table(
        "outages",
        f"Errors T seconds after the loss of GNSS, means of {growth.gaps} gaps",
        ["quantity", "unit", "", *(f"{t:g} s" for t in plan.at_s)],
        rows,
        "R1: root mean square over the gap so far; R2: magnitude at T; sigma: what the filter claims at T, rms. The "
        "published drive was recorded,\nours is simulated with sensor figures of the class of that unit: an order of "
        "magnitude, no race. Reference: an independent program on a\nsimilar drive.",
    )


def _readings(key: str, radius: Mapping[str, float]) -> dict[str, tuple[float, ...]]:
    """Rows that are not ours; metres from the published radians."""
    if key in radius:
        angle = {"north": "latitude", "east": "longitude"}[key]
        every = (PUBLISHED_TABLE, REFERENCE_R1, REFERENCE_R2)
        rows = [tuple(1e-7 * radius[key] * v for v in table[angle]) for table in every]
    else:
        rows = [PUBLISHED_TABLE[key], REFERENCE_R1[key], REFERENCE_R2[key]]
    return dict(zip(("published", "reference R1", "reference R2"), rows, strict=True))


def _metres_per_rad(growth: OutageGrowth) -> dict[str, float]:
    """Metres per rad of latitude and longitude where the gaps are."""
    pairs = (("north", "latitude"), ("east", "longitude"))
    last = float(growth.at_s[-1])
    return {m: growth.value("rms", m, last) / growth.value("rms", a, last) for m, a in pairs}


def _at(plan: Plan, values: Sequence[float]) -> list[float | None]:
    """Published values at the times of the plan, None where it has other ones."""
    known = dict(zip(TIMES_S, values, strict=True))
    return [known.get(t) for t in plan.at_s]


# ---- ends of the gaps


def _gap_rows(plan: Plan, gaps: Ensemble) -> list[int]:
    return [gaps.at(t) for t in plan.gap_ends]


def gap_ratio(plan: Plan, gaps: Ensemble) -> Array:
    """Error over sigma in the last second of the gaps, rms over runs and gaps, shape (states,)."""
    rows = _gap_rows(plan, gaps)
    return np.asarray(np.sqrt(np.mean((gaps.errors[:, rows] / gaps.sigmas[:, rows]) ** 2, axis=(0, 1))))


def gap_nees(drives: Sequence[Drive], name: str) -> float:
    """NEES of the nine navigation states in the last second of the gaps, mean of runs and gaps."""
    return float(np.mean([d.coasted[name].nees for d in drives]))


def gap_end_table(plan: Plan, gaps: Ensemble) -> Table:
    """Every state in the last second of the gaps."""
    rows_at = _gap_rows(plan, gaps)
    errors = np.abs(gaps.errors[:, rows_at]).reshape(-1, len(gaps.states))
    sigma = np.sqrt(np.mean(gaps.sigmas[:, rows_at] ** 2, axis=(0, 1)))
    ratio = gap_ratio(plan, gaps)
    count = errors.shape[0]
    bounds = chi_square_bounds(1, count, gaps.probability)
    rows: list[list[Cell]] = []
    for i, state in enumerate(gaps.states):
        unit = table_unit(state.unit)
        rms = float(np.sqrt(np.mean(errors[:, i] ** 2)))
        figures = (rms, *np.quantile(errors[:, i], [0.5, 0.95]), sigma[i])
        verdict = direction(float(ratio[i] ** 2), 1, bounds)
        rows.append(
            [state.name, unit.label, *(float(v) * unit.factor for v in figures), float(ratio[i]), verdict]
        )
    low, high = (math.sqrt(v) for v in bounds)
    return Table(
        "gap_ends",
        f"Every state in the last second of the gaps, {count} gaps",
        ["state", "unit", "rms", "median", "95 %", "filter's sigma", "error/sigma", "the filter is"],
        rows,
        f"99 % bounds of error/sigma for {count} independent gaps: {low:.2f} .. {high:.2f}. Gaps of one run share "
        "their biases, so those states scatter more.",
    )


def variant_table(
    plan: Plan, found: Mapping[str, OutageGrowth], drives: Sequence[Drive], gaps: Ensemble
) -> Table:
    """What two antennas and the calibration matrices do to the figures of the gaps."""
    last = plan.at_s[-1]
    rows: list[list[Cell]] = []
    for name, growth in found.items():
        pairs = {
            reading: [growth.value(reading, q, last) / DEG_TO_RAD for q in ("roll", "pitch", "heading")]
            for reading in ("at_end", "sigma")
        }
        angles = [
            value
            for roll, pitch, heading in pairs.values()
            for value in (math.hypot(roll, pitch) / math.sqrt(2.0), heading)
        ]
        distance = [growth.value("at_end", "distance", t) for t in _some(plan)]
        sigma = growth.value("sigma", "distance", last)
        mean = gap_nees(drives, name)
        verdict = direction(mean, 9, chi_square_bounds(9, growth.gaps, gaps.probability))
        tilt, heading, tilt_sigma, heading_sigma = angles
        rows.append(
            [FILTERS[name], *distance, sigma, tilt, tilt_sigma, heading, heading_sigma, mean, verdict]
        )
    return Table(
        "variants",
        f"R2 of other filters in the same {next(iter(found.values())).gaps} gaps",
        [
            "filter", *(f"{t:g} s" for t in _some(plan)), "sigma", "tilt", "sigma", "heading", "sigma", "NEES/9",
            "the filter is",
        ],
        rows,
        f"E_xyz in m at three times, its sigma at the last; tilt (roll and pitch) and heading in deg at {last:g} s; "
        "NEES of the nine navigation states\nthere. S = K + G, scale factors and cross couplings of gyros and "
        "accelerometers; the same seeds in all rows.",
    )  # fmt: skip


def _some(plan: Plan) -> tuple[float, ...]:
    """Three times of the table: the first, one in the middle, the last."""
    return (plan.at_s[0], plan.at_s[(len(plan.at_s) - 1) // 2], plan.at_s[-1])


# ---- consistency


def mean_nees(plan: Plan, found: Ensemble, group: str) -> tuple[float, int, tuple[float, float]]:
    """Mean over runs and the steady state, every ten seconds; degrees of freedom; 99 % bounds of one epoch."""
    return nees_over(found, group, _steady_rows(plan, found))


def _steady_rows(plan: Plan, found: Ensemble) -> list[int]:
    return [found.at(t) for t in plan.epochs if t >= plan.after_s and t % 10.0 == 0.0]


def consistency_table(plan: Plan, whole: Ensemble, gaps: Ensemble, drives: Sequence[Drive]) -> Table:
    """NEES by group and NIS, with GNSS throughout and with gaps."""
    ends = gap_nees(drives, "published")
    first = np.array([d.first_nis for d in drives])
    more = [
        chi_square_row("NEES navigation, ends of the gaps", 9, ends, len(drives) * len(plan.gaps)),
        chi_square_row("NIS first fix after a gap", 6, float(first.mean()), first.size),
    ]
    return consistency.consistency_table(whole, gaps, plan.after_s, partial(_steady_rows, plan), more)


# ---- biases


def bias_table(plan: Plan, whole: Ensemble, drives: Sequence[Drive]) -> Table:
    """Sums of walk and Markov error over time, and how little the parts are told apart."""
    error = np.array([d.sums.error for d in drives])
    sigma = np.sqrt(np.mean(np.array([d.sums.sigma for d in drives]) ** 2, axis=0))
    ratio = np.sqrt(np.mean((error / np.array([d.sums.sigma for d in drives])) ** 2, axis=0))
    times = [t for t in (20.0, 60.0, 100.0, 200.0, 400.0, plan.end_s) if t <= plan.end_s]
    last = whole.at(plan.end_s)
    rows: list[list[Cell]] = []
    for i in range(6):
        sensor, axis = ("gyro", "accel")[i // 3], "xyz"[i % 3]
        unit, factor = ("deg/h", GYRO_BIAS["deg/h"]) if i < 3 else ("mg", ACCEL_BIAS["mg"])
        walk, markov = (whole.column(f"{sensor}_{part}_{axis}") for part in ("walk", "drift"))
        at = [float(sigma[whole.at(t), i] / factor) for t in times]
        parts = [float(whole.sigma()[last, k] / factor) for k in (walk, markov)]
        rms = float(np.sqrt(np.mean(error[:, last, i] ** 2)) / factor)
        settled = [whole.at(t) for t in plan.epochs if t >= plan.after_s and t % 50.0 == 0.0]
        over = float(np.sqrt(np.mean(ratio[settled, i] ** 2)))
        rows.append([f"{sensor} {axis}", unit, *at, rms, over, *parts])
    return Table(
        "biases",
        "Bias of each sensor, walk + Markov error: the filter's sigma over time, GNSS throughout",
        [
            "sensor", "unit", *(f"{t:g} s" for t in times), f"rms {plan.end_s:g} s", "error/sigma",
            "sigma of the walk", "of the Markov error",
        ],
        rows,
        f"error/sigma: rms over the runs and every 50 s from {plan.after_s:g} s. The last two columns are the parts at "
        f"{plan.end_s:g} s: only their sum acts on the navigation errors.",
    )  # fmt: skip


# ---- heading against the specific force


@dataclass(frozen=True)
class Manoeuvre:
    """Windows of one class of acceleration.

    Parameters
    ----------
    low, high : float
        Bounds of the class, m/s^2.
    share : float
        Of the time.
    excess : float
        Median of |f| minus that at rest, m/s^2.
    error_change, sigma_change : float
        Change of the rms heading error of the runs, and of the filter's sigma, per 10 s, mean of the logarithms.
    flagged : tuple of float
        Share of the windows in which heading, z gyro bias, x and y accelerometer bias are unobservable; their rank.
    """

    low: float
    high: float
    share: float
    excess: float
    error_change: float
    sigma_change: float
    flagged: tuple[float, float, float, float]
    rank: float


def manoeuvres(plan: Plan, whole: Ensemble, seen: Observability) -> list[Manoeuvre]:
    """Sort the settled drive with GNSS throughout by the acceleration."""
    epochs = np.array(plan.epochs)
    step = round(WINDOW_S)
    begin, end = epochs[:-step], epochs[step:]
    column = whole.column("phi_d")
    error, sigma = np.log(whole.rms()[:, column]), np.log(whole.sigma()[:, column])
    force = plan.force.rms(begin, end)
    settled = begin >= plan.after_s
    in_window = plan.force.rms(seen.first_s, seen.t_s)
    at_rest = float(np.median(plan.force.size[plan.force.accel < 1e-3]))
    size = np.interp(0.5 * (begin + end), plan.force.time_s, plan.force.size) - at_rest
    names = ("phi_z", "gyro_bias_z", "accel_bias_x", "accel_bias_y")
    columns = [seen.names.index(name) for name in names]
    found = []
    for low, high in BINS:
        rows = settled & (force >= low) & (force < high)
        windows = (in_window >= low) & (in_window < high)
        flags = seen.flags[windows][:, columns].mean(axis=0) if windows.any() else np.full(4, np.nan)
        change = [
            float(10.0 / WINDOW_S * np.mean(values[step:][rows] - values[:-step][rows]))
            if rows.any()
            else math.nan
            for values in (error, sigma)
        ]
        found.append(
            Manoeuvre(
                low,
                high,
                float(rows.sum() / settled.sum()),
                float(np.median(size[rows])) if rows.any() else math.nan,
                change[0],
                change[1],
                (float(flags[0]), float(flags[1]), float(flags[2]), float(flags[3])),
                float(np.median(seen.rank[windows])) if windows.any() else math.nan,
            )
        )
    return found


def manoeuvre_table(plan: Plan, found: Sequence[Manoeuvre]) -> Table:
    """Heading error against the specific force, and which states windows of 31 fixes leave open."""
    rows: list[list[Cell]] = []
    for m in found:
        label = f"{m.low:g} .. {m.high:g}" if math.isfinite(m.high) else f"above {m.low:g}"
        rows.append(
            [
                label,
                100.0 * m.share,
                m.excess,
                100.0 * math.expm1(m.error_change),
                100.0 * math.expm1(m.sigma_change),
                *(100.0 * flag for flag in m.flagged),
                m.rank,
            ]
        )
    return Table(
        "manoeuvres",
        "Heading, specific force and acceleration, GNSS throughout",
        [
            "accel m/s^2", "share %", "size of f - g", "error/10 s %", "sigma/10 s %", "heading open", "gyro z open",
            "accel x open", "accel y open", "rank of 15",
        ],
        rows,
        f"Windows of {WINDOW_S:g} s from {plan.after_s:g} s by the rms of the acceleration; change of the "
        "heading error (rms of the runs) and of its\nsigma; share (%) of the windows whose fixes alone leave a state "
        "open, one bias per sensor, threshold of 0.025 in SI units.",
    )  # fmt: skip
