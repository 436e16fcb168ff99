"""Around the filter of Novik (2011): its observations, feedback that waits, and what its misprints do."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import Ensemble, Sample
from gnssins.reproduce.novik_linear import FILTERS, Honest, Outcome
from gnssins.reproduce.novik_matrices import Motion, observation, transition
from gnssins.reproduce.novik_runs import EXAMPLE, EXAMPLE_PERIOD_S, VARIATIONS, Feedback, example_errors
from gnssins.reproduce.novik_tables import STATES, mean_nees
from gnssins.reproduce.report import Cell, Table

__all__ = [
    "Observations",
    "errata_table",
    "feedback_table",
    "observation_table",
    "variation_table",
    "waiting",
]

Array = NDArray[np.float64]


class Observations:
    """Seven against eight observations at the end of the closed loop.

    Attributes
    ----------
    rank : int
        Rank of S of all eight, scaled to a correlation matrix.
    smallest, second : float
        Its two smallest singular values.
    same : float
        Largest difference of the gain by the pseudo-inverse of all eight from that of the first seven, relative to the
        largest element of its column.
    rows : float
        Largest element of row 8 - (row 4 - row 1) in H and in the noise input.
    """

    def __init__(self, honest: Honest, time_s: int) -> None:
        scenario = honest.scenario
        step, end = (Motion.of(scenario, np.array([t])) for t in (time_s - 0.5, float(time_s)))
        phi, q = transition(step, 1.0)
        h, noise = observation(end, np.zeros(1, dtype=np.bool_))
        p = phi[0] @ honest.covariance[time_s - 1] @ phi[0].T + q[0]
        s = h @ p @ h.T + noise[0] @ noise[0].T
        sd = np.sqrt(np.diag(s))
        scaled = s / np.outer(sd, sd)
        values = np.linalg.svd(scaled, compute_uv=False)
        self.rank = int(np.linalg.matrix_rank(scaled, tol=1e-9))
        self.smallest, self.second = float(values[-1]), float(values[-2])
        self.rows = float(
            max(np.abs(h[7] - (h[3] - h[0])).max(), np.abs(noise[0, 7] - (noise[0, 3] - noise[0, 0])).max())
        )
        # z8 = T z7: the gain of all eight acts on seven numbers as K8 T
        both = np.vstack([np.eye(7), np.eye(7)[3] - np.eye(7)[0]])
        eight = (p @ h.T / sd) @ np.linalg.pinv(scaled, rcond=1e-9) / sd @ both
        seven = np.linalg.solve(s[:7, :7], h[:7] @ p).T
        self.same = float((np.abs(eight - seven) / np.abs(seven).max(axis=0)).max())


def observation_table(found: Observations, errata: dict[str, Outcome]) -> Table:
    """Rank of S, and what row 8 does."""
    right, twice = errata[""], errata["33"]
    rows: list[list[Cell]] = [
        ["observations", "8"],
        ["largest element of row 8 - (row 4 - row 1), H and noise", f"{found.rows:.0e}"],
        ["rank of S = H P H' + R of all eight", str(found.rank)],
        ["smallest singular values of S (scaled)", f"{found.second:.2g}, {found.smallest:.0e}"],
        ["gain by the pseudo-inverse of all eight less that of the first seven", f"{found.same:.0e}"],
        ["diagonal R with row 8: height actual / claimed, m", _pair(twice.position, 2)],
        ["first seven: height actual / claimed, m", _pair(right.position, 2)],
    ]
    return Table(
        "observations",
        "Seven observations against the printed eight",
        ["what", "value"],
        rows,
        "The printed gain needs the inverse of a matrix of rank 7. With a diagonal R it exists and counts barometer "
        "and GNSS height twice;\nthat does little here, because both carry slow errors that are states of their own.",
    )


def _pair(values: tuple[Array, Array], axis: int) -> str:
    return f"{values[0][axis]:.3f} / {values[1][axis]:.3f}"


def errata_table(found: dict[str, Outcome]) -> Table:
    """What the misprints of the filter do, by covariance analysis."""
    rows: list[list[Cell]] = []
    for name, each in found.items():
        cells: list[Cell] = [name or "-", FILTERS[name]]
        for axis in (1, 2):
            cells += [float(each.position[0][axis]), float(each.position[1][axis])]
        cells += [1e6 * each.heading[0], 1e6 * each.heading[1]]
        rows.append([*cells, each.worst_position_m, each.nees])
    return Table(
        "errata",
        "What each misprint of the filter would do: covariance analysis of the closed loop, one standard deviation at "
        "800 s",
        [
            "no",
            "printed",
            "N m",
            "claimed",
            "h m",
            "claimed",
            "heading urad",
            "claimed",
            "largest m",
            "NEES of 9",
        ],
        rows,
        "Numbers as in the list of errata; 22* is read as it is printed. Actual errors of a closed loop whose filter "
        "has the misprint,\nbeside what that filter claims, the largest position error on any axis after 100 s; an "
        "honest filter has NEES 9.",
    )


# ---- feedback


def waiting(found: Sequence[Feedback], unit: str, period_s: float, seed: int) -> tuple[Ensemble, Ensemble]:
    """Ensembles with feedback at every fix and after a period; ``unit``: "unit" or "example"."""
    every = [getattr(each, unit) for each in found]
    return tuple(Ensemble.of([e[p] for e in every], seed) for p in (0.0, period_s))  # type: ignore[return-value]


def feedback_table(found: Sequence[Feedback], bound_s: float, seed: int) -> Table:
    """Feedback that waits, beside feedback at every fix."""
    rows: list[list[Cell]] = []
    labels = {"unit": "data sheet", "example": "10 deg/h, 3 mg, 5 mrad"}
    for unit, label in labels.items():
        for period in getattr(found[0], unit):
            always, rare = waiting(found, unit, period, seed)
            mean, _, bounds = mean_nees(rare, "all")
            last = (
                np.sqrt(np.mean((rare.errors[:, -1] - always.errors[:, -1]) ** 2, axis=0))
                / always.sigma()[-1]
            )
            ratio = rare.rms()[-1] / always.rms()[-1]
            most = int(np.argmax(last))
            name = next(s.name for s in STATES if s.column == most) if period else ""
            rows.append(
                [label, period, float(last.max()), name, float(ratio.min()), float(ratio.max()), float(mean.mean()),
                 *bounds]
            )  # fmt: skip
    _, accel = example_errors()
    tilt = math.sqrt(2.0 * accel / 9.80665)
    return Table(
        "feedback",
        f"Feedback of the estimates that waits, {len(found)} runs: last epoch beside feedback at every fix",
        [
            "unit", "least time s", "largest difference, sigma", "of", "rms ratio from", "to", "NEES of 22",
            "99 % from", "to",
        ],
        rows,
        f"Bound of the data sheet: {bound_s:.0f} s from 1 mrad to sqrt(2 da/g) = 7 mrad, longer than the flight, which "
        f"then has no feedback at\nall. The example takes {1e3 * EXAMPLE['tilt_max_rad']:.0f} mrad and so "
        f"{EXAMPLE_PERIOD_S:.0f} s, and is no longer honest: the bound (here even "
        f"{1e3 * tilt:.0f} mrad) keeps the\nterms of second order below the error that the accelerometer had at the "
        "start, not below what the filter leaves of it.",
    )  # fmt: skip


# ---- variations


def variation_table(found: Sequence[Mapping[str, Sample]], seed: int) -> Table:
    """The closed loop with lower bounds of diag P and with other forms of the attitude, beside the usual one."""
    every = {name: Ensemble.of([each[name] for each in found], seed) for name in VARIATIONS}
    usual = next(iter(every.values()))
    rows: list[list[Cell]] = []
    for name, each in every.items():
        mean, _, bounds = mean_nees(each, "all")
        ratio, sigma = each.rms()[-1] / usual.rms()[-1], each.sigma()[-1] / usual.sigma()[-1]
        apart = np.sqrt(np.mean((each.errors[:, -1] - usual.errors[:, -1]) ** 2, axis=0)) / usual.sigma()[-1]
        figures = (
            float(apart.max()),
            float(ratio.min()),
            float(ratio.max()),
            float(sigma.max()),
            float(mean.mean()),
        )
        rows.append([VARIATIONS[name], *figures, *bounds])
    return Table(
        "variations",
        f"Variations of the closed loop, {len(found)} runs: last epoch beside the usual one",
        [
            "closed loop", "largest difference, sigma", "rms ratio from", "to", "largest sigma ratio", "NEES of 22",
            "99 % from", "to",
        ],
        rows,
        "Lower bounds keep the filter awake in flight, where its model is never quite right; with a right model they "
        "only make it\ndoubt the sensors that it knows best.",
    )  # fmt: skip
