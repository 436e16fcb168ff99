"""Tables of the reproduction of Vasilyuk (2019): growth in the gap, settling, consistency, observability."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import Ensemble
from gnssins.reproduce.report import Cell, Table
from gnssins.reproduce.vasilyuk_runs import Plan, Walk, growths
from gnssins.tables import table_unit

__all__ = [
    "DEG",
    "FOUR",
    "PUBLISHED_GROWTH",
    "TARGETS",
    "Seen",
    "consistency_table",
    "growth_table",
    "mean_nees",
    "observability_table",
    "seen",
    "sensor_table",
    "settling_table",
]

Array = NDArray[np.float64]

#: Degrees per radian.
DEG: Final = 180.0 / math.pi

#: Components that the publication ever found unobservable.
FOUR: Final = frozenset({"phi_z", "gyro_bias_z", "accel_bias_x", "accel_bias_y"})

#: Published growth, root mean square over 14 walks, and the figures wanted: at 10 s and 20 s; m, deg.
PUBLISHED_GROWTH: Final = {
    "horizontal": (1.6, 8.0),
    "roll": (0.07, 0.2),
    "pitch": (0.07, 0.2),
    "heading": (0.35, 0.5),
}
TARGETS: Final = {
    "horizontal": (0.50, 2.0),
    "roll": (0.045, 0.075),
    "pitch": (0.045, 0.075),
    "heading": (0.31, 0.36),
}

_UNITS: Final = {
    "horizontal": ("m", 1.0),
    "roll": ("deg", DEG),
    "pitch": ("deg", DEG),
    "heading": ("deg", DEG),
}

_TIMES: Final = (5.0, 10.0, 15.0, 20.0)


def changed(walks: Sequence[Walk], quantity: str, at_s: float) -> float:
    """Root mean square change of the error since the start of the gap, SI."""
    column = list(_UNITS).index(quantity)
    row = round(at_s) - 1
    return float(np.sqrt(np.mean([w.change[row, column] ** 2 for w in walks])))


def growth_table(walks: Sequence[Walk]) -> Table:
    """Growth of the errors in 20 s without fixes, by three references."""
    corrected, truth = growths(walks)
    rows: list[list[Cell]] = []
    for quantity, (unit, factor) in _UNITS.items():
        for i, time in enumerate(_TIMES):
            published, target = (
                (PUBLISHED_GROWTH[quantity][i // 2], TARGETS[quantity][i // 2]) if i % 2 else (None, None)
            )
            rows.append(
                [
                    quantity,
                    unit,
                    time,
                    published,
                    target,
                    factor * corrected.value("rms", quantity, time),
                    factor * changed(walks, quantity, time),
                    factor * truth.value("rms", quantity, time),
                    factor * truth.value("sigma", quantity, time),
                ]
            )
    return Table(
        "growth",
        f"Root mean square over {len(walks)} gaps of 20 s on a straight, matched sensors",
        [
            "quantity",
            "unit",
            "s",
            "published",
            "wanted",
            "against corrected run",
            "change of error",
            "error",
            "filter's sigma",
        ],
        rows,
        "Published: uncorrected minus corrected run of the same filter. It hides what both share: the error of the "
        "heading itself is several times its growth. Both are judged.",
    )


def sensor_table(plan: Plan, walks: Sequence[Walk], raw: Sequence[Walk]) -> Table:
    """Matched sensors beside uncalibrated ones, whose scale and cross-axis errors the filter does not know."""
    rows: list[list[Cell]] = []
    sets = [(growths(w), w) for w in (walks, raw)]
    for quantity, (unit, factor) in _UNITS.items():
        for i, time in enumerate((10.0, 20.0)):
            row: list[Cell] = [quantity, unit, time, PUBLISHED_GROWTH[quantity][i]]
            for (corrected, truth), _ in sets:
                row += [
                    factor * corrected.value("rms", quantity, time),
                    factor * truth.value("rms", quantity, time),
                ]
            rows.append(row)
    return Table(
        "sensors",
        f"Matched sensors ({len(walks)} walks) and uncalibrated ones ({len(raw)} walks)",
        [
            "quantity",
            "unit",
            "s",
            "published",
            "matched: growth",
            "matched: error",
            "uncalibrated: growth",
            "uncalibrated: error",
        ],
        rows,
        "The publication had no calibration. Growth is against the corrected run, error against the truth.",
    )


def settling_table(plan: Plan, whole: Ensemble) -> Table:
    """Biases and heading along the walk."""
    times = (20.0, 40.0, 54.0, 58.0, 70.0, 80.0, 99.0, 150.0)
    rms, sigma, ratio = whole.rms(), whole.sigma(), whole.ratio()
    rows: list[list[Cell]] = []
    for time in times:
        k = whole.at(time)
        row: list[Cell] = [time]
        for name, factor in (
            ("phi_d", DEG),
            ("gyro_bias_z", DEG),
            ("gyro_bias_x", DEG),
            ("accel_bias_x", table_unit("m/s^2").factor),
            ("accel_bias_z", table_unit("m/s^2").factor),
        ):
            i = whole.column(name)
            row += [factor * float(rms[k, i]), factor * float(sigma[k, i])]
        heading, bias = whole.column("phi_d"), whole.column("gyro_bias_z")
        row.append(f"{ratio[k, heading]:.2f}, {ratio[k, bias]:.2f}")
        rows.append(row)
    names = ("heading deg", "z-gyro deg/s", "x-gyro deg/s", "x-accel mg", "z-accel mg")
    columns = ["s", *(column for name in names for column in (name, "sigma")), "error/sigma heading, z-gyro"]
    low, high = whole.ratio_bounds
    return Table(
        "settling",
        f"Errors along the walk with GNSS throughout, root mean square of {whole.runs} walks",
        columns,
        rows,
        f"Corners at 55.8, 85.4 and 125.0 s. 99 % bounds of error/sigma: {low:.2f} .. {high:.2f}.",
    )


def mean_nees(plan: Plan, whole: Ensemble, group: str = "all") -> float:
    """Mean NEES over walks and seconds from point A on, over its number of states."""
    settled = whole.time_s > plan.settled_s
    return float(whole.nees_values[group][:, settled].mean()) / whole.dof[group]


def consistency_table(plan: Plan, whole: Ensemble) -> Table:
    """NEES by group from point A on, NIS of the fixes."""
    nees, t_s = whole.nees(), plan.settled_s
    rows: list[list[Cell]] = []
    for name, group in nees.groups.items():
        settled = group.t_ns > round(t_s * 1e9)
        inside = (group.value[settled] >= group.bounds[0]) & (group.value[settled] <= group.bounds[1])
        rows.append(
            [
                f"NEES {name}",
                group.dof,
                mean_nees(plan, whole, name),
                f"{group.bounds[0] / group.dof:.2f} .. {group.bounds[1] / group.dof:.2f}",
                f"{100 * float(inside.mean()):.0f} %",
            ]
        )
    for name, kind in whole.nis.groups.items():
        low, high = kind.bounds
        rows.append(
            [
                f"NIS {name}",
                kind.dof,
                kind.factor,
                f"{low / kind.dof:.3f} .. {high / kind.dof:.3f}",
                kind.verdict,
            ]
        )
    return Table(
        "consistency",
        f"Consistency for t > {t_s:.0f} s, {whole.runs} walks, GNSS throughout",
        ["what", "dof", "mean/dof", "99 % bounds", "epochs inside, or verdict"],
        rows,
        "Bounds of NEES are those of one epoch over the walks.",
    )


# ---- observability


@dataclass(frozen=True)
class Seen:
    """What the windows of one stretch say, over all walks.

    Parameters
    ----------
    name : str
        Stretch.
    windows : int
        Number of windows of all walks.
    lowest, highest : int
        Rank.
    flagged : mapping of str to float
        Share of windows in which a state is flagged.
    four_only : float
        Share of windows that flag exactly the published four.
    clear : float
        Share of windows of rank 14 at least in which no accelerometer is flagged.
    middle : float
        Share of walks whose window at the middle of the stretch is such a one.
    """

    name: str
    windows: int
    lowest: int
    highest: int
    flagged: dict[str, float]
    four_only: float
    clear: float
    middle: float


def seen(plan: Plan, walks: Sequence[Walk], *, sigma: bool = False) -> list[Seen]:
    """Sum up the windows of every stretch."""
    found = []
    for i, stretch in enumerate(plan.stretches):
        parts = [w.windows[i + len(plan.stretches) * sigma] for w in walks]
        names = parts[0].names
        flags, rank = np.concatenate([p.flags for p in parts]), np.concatenate([p.rank for p in parts])
        exact = (flags == np.array([n in FOUR for n in names])).all(axis=1)
        accel = [k for k, n in enumerate(names) if n.startswith("accel_bias")]
        clear = [(p.rank >= 14) & ~p.flags[:, accel].any(axis=1) for p in parts]
        at_s = 0.5 * (stretch.start_s + stretch.end_s)
        middle = [np.abs(0.5 * (p.first_s + p.t_s) - at_s).argmin() for p in parts]
        found.append(
            Seen(
                stretch.name,
                rank.size,
                int(rank.min()),
                int(rank.max()),
                dict(zip(names, flags.mean(axis=0).tolist(), strict=True)),
                float(exact.mean()),
                float(np.concatenate(clear).mean()),
                float(np.mean([c[k] for c, k in zip(clear, middle, strict=True)])),
            )
        )
    return found


def observability_table(plan: Plan, sway: Sequence[Walk], still: Sequence[Walk]) -> Table:
    """Rank and flags by stretch: pole with sway and without, in SI and in sigma."""
    watched = [w for w in sway if w.windows]
    rows: list[list[Cell]] = []
    for label, walks, sigma in (
        ("no sway, SI", still, False),
        ("sway, SI", watched, False),
        ("sway, sigma", watched, True),
    ):
        for s in seen(plan, walks, sigma=sigma):
            often = sorted(s.flagged.items(), key=lambda item: -item[1])
            flags = ", ".join(f"{name} {100 * share:.0f}" for name, share in often if share >= 0.005)
            ranks = str(s.lowest) if s.lowest == s.highest else f"{s.lowest} .. {s.highest}"
            rows.append([label, s.name, s.windows, ranks, flags or "none"])
    return Table(
        "observability",
        "Rank and unobservable states in windows of 31 fixes",
        ["pole, form", "stretch", "windows", "rank of 15", "flagged, % of windows"],
        rows,
        "Straights: windows wholly on them. Turns: windows centred within 0.5 s of their middle. SI: threshold 0.025. "
        "Sigma: prior of the start of the walk, 3 cm, threshold 1.",
    )
