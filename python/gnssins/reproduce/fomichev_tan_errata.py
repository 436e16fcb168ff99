"""What the misprints of Fomichev and Tan (2017) would do, by a covariance analysis of the 18-state filter.

Two covariances run side by side (:mod:`gnssins.reproduce.covariances`): the one that a filter with a misprint claims,
and the one that its errors really have, for a loop that feeds every estimate back at once. Axes east, north, up and
right, forward, up, as published; states phi (rad), dv (m/s), dL, dlon (rad), dh (m), constant gyro drift, Markov gyro
drift (rad/s), Markov accelerometer error (m/s^2), drifts measured minus true.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.analysis import Trajectory
from gnssins.reproduce.covariances import corrected, gain, third_order, transposed
from gnssins.reproduce.report import Cell, Table
from gnssins.sim.frames import EARTH_RATE_RAD_S
from gnssins.units import ACCEL_BIAS, DEG_SQRT_H_TO_RAD_SQRT_S, DEG_TO_RAD, GYRO_BIAS, NS_PER_S

__all__ = ["ERRATA", "Conditions", "Outcome", "errata_table", "outcomes", "system_matrix"]

Array = NDArray[np.float64]
Entries = dict[tuple[int, int], Array]

TAU_R_S: Final = 7200.0
TAU_A_S: Final = 1800.0

#: East-north-up from north-east-down, and right-forward-up from forward-right-down: one rotation, its own inverse.
_TURN: Final = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True, eq=False)
class Conditions:
    """The motion at m times: everything that the system matrix depends on.

    Parameters
    ----------
    lat_rad, height_m : ndarray, shape (m,)
        Place.
    v_u, f_u : ndarray, shape (m, 3)
        Velocity (m/s) and specific force (m/s^2) along east, north, up.
    c_ub : ndarray, shape (m, 3, 3)
        Right, forward, up to east, north, up.
    """

    lat_rad: Array
    height_m: Array
    v_u: Array
    f_u: Array
    c_ub: Array

    @classmethod
    def of(cls, truth: Trajectory, times_s: Array, ellipsoid: str = "wgs84") -> Conditions:
        """Take them from a motion at times inside it; the specific force from the change of velocity over 0.2 s."""
        t_ns = np.rint(times_s * NS_PER_S).astype(np.int64)
        row = np.clip(np.searchsorted(truth.t_ns, t_ns), 0, truth.t_ns.size - 1)
        near = max(1, round(0.1 / ((truth.t_ns[-1] - truth.t_ns[0]) / NS_PER_S) * (truth.t_ns.size - 1)))
        low, high = np.maximum(row - near, 0), np.minimum(row + near, truth.t_ns.size - 1)
        lat, height, v = np.ascontiguousarray(truth.lla[row, 0]), truth.lla[row, 2], truth.v_n[row]
        if truth.q_nb is None:
            raise TypeError("the motion has no attitude")
        slope = (truth.v_n[high] - truth.v_n[low]) / ((truth.t_ns[high] - truth.t_ns[low]) / NS_PER_S)[
            :, None
        ]
        radii = _core.radii(lat, ellipsoid) + height[:, None]
        rate = np.column_stack([np.cos(lat), np.zeros_like(lat), -np.sin(lat)]) * EARTH_RATE_RAD_S
        transport = np.column_stack(
            [v[:, 1] / radii[:, 1], -v[:, 0] / radii[:, 0], -v[:, 1] * np.tan(lat) / radii[:, 1]]
        )
        gravity = _core.gravity_n(lat, np.ascontiguousarray(height), ellipsoid)
        f_n = slope + np.cross(2.0 * rate + transport, v) - gravity
        c_nb = _core.quat_to_dcm(np.ascontiguousarray(truth.q_nb[row]))
        return cls(lat, height, v @ _TURN, f_n @ _TURN, _TURN @ c_nb @ _TURN)


def _right(c: Conditions) -> Entries:
    """Entries of the navigation part, rows and columns from 1, as derived."""
    lat, (ve, vn, vu), (fe, fn, fu) = c.lat_rad, c.v_u.T, c.f_u.T
    m, n, w = *_radii(c), EARTH_RATE_RAD_S
    g = _core.gravity_n(np.ascontiguousarray(lat), np.ascontiguousarray(c.height_m), "wgs84")[:, 2]
    s, co, tan = np.sin(lat), np.cos(lat), np.tan(lat)
    sec, one = 1.0 / co, np.ones_like(lat)
    return {
        (1, 2): w * s + ve * tan / n,
        (1, 3): -(w * co + ve / n),
        (1, 5): -1.0 / m,
        (1, 9): vn / m**2,
        (2, 1): -(w * s + ve * tan / n),
        (2, 3): -vn / m,
        (2, 4): 1.0 / n,
        (2, 7): -w * s,
        (2, 9): -ve / n**2,
        (3, 1): w * co + ve / n,
        (3, 2): vn / m,
        (3, 4): tan / n,
        (3, 7): w * co + ve * sec**2 / n,
        (3, 9): -ve * tan / n**2,
        (4, 2): -fu,
        (4, 3): fn,
        (4, 4): (vn * tan - vu) / n,
        (4, 5): 2.0 * w * s + ve * tan / n,
        (4, 6): -(2.0 * w * co + ve / n),
        (4, 7): 2.0 * w * co * vn + ve * vn * sec**2 / n + 2.0 * w * s * vu,
        (4, 9): ve * (vu - vn * tan) / n**2,
        (5, 1): fu,
        (5, 3): -fe,
        (5, 4): -2.0 * (w * s + ve * tan / n),
        (5, 5): -vu / m,
        (5, 6): -vn / m,
        (5, 7): -(2.0 * w * co * ve + ve**2 * sec**2 / n),
        (5, 9): ve**2 * tan / n**2 + vn * vu / m**2,
        (6, 1): -fn,
        (6, 2): fe,
        (6, 4): 2.0 * (w * co + ve / n),
        (6, 5): 2.0 * vn / m,
        (6, 7): -2.0 * w * s * ve,
        (6, 9): 2.0 * g / np.sqrt(m * n) - ve**2 / n**2 - vn**2 / m**2,
        (7, 5): 1.0 / m,
        (7, 9): -vn / m**2,
        (8, 4): sec / n,
        (8, 7): ve * sec * tan / n,
        (8, 9): -ve * sec / n**2,
        (9, 6): one,
    }


def _radii(c: Conditions) -> tuple[Array, Array]:
    """Radii of curvature with the height, R_M + h and R_N + h."""
    radii = _core.radii(np.ascontiguousarray(c.lat_rad), "wgs84") + c.height_m[:, None]
    return radii[:, 0], radii[:, 1]


def _printed(c: Conditions) -> dict[str, Entries]:
    """Entries as they are printed, by the number of the erratum."""
    lat, (ve, vn, vu), (m, n) = c.lat_rad, c.v_u.T, _radii(c)
    w, s, co, tan, sec = EARTH_RATE_RAD_S, np.sin(lat), np.cos(lat), np.tan(lat), 1.0 / np.cos(lat)
    right = _right(c)
    return {
        "E2": {(1, 2): w * s + ve * tan / (n - c.height_m)},
        "E3": {(4, 4): (vn * tan - vu) / m},
        "E4": {(5, 4): -(2.0 * w * s + ve / n)},
        "E5": {(5, 7): -2.0 * (w * co + ve * sec**2 / n) * ve},
        "E6": {(6, 4): -(2.0 * w * co + ve / n)},
        "E7": {(8, 7): ve * sec * tan / m},
        "E9": {at: np.zeros_like(lat) for at in right if at[1] == 9},
    }


def system_matrix(c: Conditions, errata: frozenset[str] = frozenset()) -> Array:
    """System matrices (m, 18, 18), right or with some of the misprints."""
    f = np.zeros((c.lat_rad.size, 18, 18))
    entries = _right(c)
    for name, wrong in _printed(c).items():
        if name in errata:
            entries |= wrong
    for (row, column), value in entries.items():
        f[:, row - 1, column - 1] = value
    gyro = c.c_ub if "E8" in errata else -c.c_ub
    f[:, 0:3, 9:12] = f[:, 0:3, 12:15] = gyro
    f[:, 3:6, 15:18] = c.c_ub
    for i in range(3):
        f[:, 12 + i, 12 + i] = -1.0 / TAU_R_S
        f[:, 15 + i, 15 + i] = -1.0 / TAU_A_S
    return f


#: Misprints of the specification that change the filter, and what is wrong.
ERRATA: Final[Mapping[str, str]] = {
    "E2": "F(1,2): height missing under v_E tan L",
    "E3": "F(4,4): R_M + h under transport rates of v_E",
    "E4": "F(5,4): factor 2 and tan L missing",
    "E5": "F(5,7): factor 2 on the transport part too",
    "E6": "F(6,4): sign, and factor 2 of v_E",
    "E7": "F(8,7): R_M + h under the longitude",
    "E8": "gyro blocks of F with +C, drift subtracted",
    "E9": "column of the height error empty",
    "E10": "Gamma Q Gamma' with Q = Qc: noise 100 times too small",
    "E15": "initial position error of 1 rad, not 1 m",
    "E16": "P kept as it is while GNSS is absent",
}


@dataclass(frozen=True)
class Outcome:
    """Standard deviations of one filter: what it claims, and what its errors have.

    Each tuple is (actual, claimed); position in m, heading in arcmin. ``steady`` is the last second before the gap,
    ``end`` the last one in it, ``after`` one minute after the return of GNSS.
    """

    steady_north: tuple[float, float]
    steady_heading: tuple[float, float]
    end_north: tuple[float, float]
    end_up: tuple[float, float]
    after_north: tuple[float, float]


def outcomes(truth: Trajectory, gap: tuple[float, float], steps_per_s: int = 4) -> dict[str, Outcome]:
    """Run all filters from the start through one gap; key ``""`` is the right one.

    Parameters
    ----------
    truth : Trajectory
        True motion from 0 s to a minute after the gap.
    gap : (from, to)
        Time without fixes, s.
    steps_per_s : int
        Steps of the transition matrix per second.

    Returns
    -------
    dict of str to Outcome
    """
    begin, end = round(gap[0]), round(gap[1])
    seconds = end + 60
    step = 1.0 / steps_per_s
    middle = Conditions.of(truth, (np.arange(seconds * steps_per_s, dtype=np.float64) + 0.5) * step)
    whole = Conditions.of(truth, np.arange(1, seconds + 1, dtype=np.float64))
    names = ["", *ERRATA]
    phi_q = {name: _transition(middle, name, step, steps_per_s) for name in names if name in _OWN_MATRIX}
    phi, q = (np.stack([phi_q.get(name, phi_q[""])[i] for name in names]) for i in (0, 1))
    q[names.index("E10")] /= 100.0
    claimed, actual = (np.stack([_initial(whole)] * len(names)) for _ in range(2))
    claimed[names.index("E15"), 6, 6] = claimed[names.index("E15"), 7, 7] = 1.0
    frozen = names.index("E16")
    marks: dict[int, tuple[Array, Array]] = {}
    r = np.diag([1.0, 1.0, 1.0, 0.05**2, 0.05**2, 0.05**2])
    m, n = _radii(whole)
    scale = np.column_stack([n * np.cos(whole.lat_rad), m])
    for k in range(seconds):
        t = k + 1
        before = claimed[frozen].copy()
        claimed = phi[:, k] @ claimed @ transposed(phi[:, k]) + q[:, k]
        actual = phi[0, k] @ actual @ phi[0, k].T + q[0, k]
        if begin <= t < end:
            claimed[frozen] = before
        else:
            h = np.zeros((6, 18))
            h[0, 6], h[1, 7], h[2, 8] = scale[k, 1], scale[k, 0], 1.0
            h[3:, 3:6] = np.eye(3)
            k_own = gain(claimed, h, r)
            claimed, actual = corrected(claimed, k_own, h, r), corrected(actual, k_own, h, r)
        if t in (begin - 1, end - 1, end + 60):
            marks[t] = (_standard(actual, scale[k]), _standard(claimed, scale[k]))
    steady, last, after = (marks[t] for t in (begin - 1, end - 1, end + 60))

    def pair(found: tuple[Array, Array], name: str, column: int) -> tuple[float, float]:
        i = names.index(name)
        return float(found[0][i, column]), float(found[1][i, column])

    return {
        name: Outcome(
            pair(steady, name, 1),
            pair(steady, name, 3),
            pair(last, name, 1),
            pair(last, name, 2),
            pair(after, name, 1),
        )
        for name in names
    }


#: Filters whose system matrix differs from the others'.
_OWN_MATRIX: Final = frozenset({"", "E2", "E3", "E4", "E5", "E6", "E7", "E8", "E9"})


def _transition(c: Conditions, erratum: str, dt: float, steps: int) -> tuple[Array, Array]:
    """Transition matrices and process noise over whole seconds, shape (seconds, 18, 18), terms to third order."""
    f = system_matrix(c, frozenset({erratum}))
    phi, q = third_order(f, _noise_input(c), _density(), dt)
    phi, q = phi.reshape(-1, steps, 18, 18), q.reshape(-1, steps, 18, 18)
    over, noise = phi[:, 0], q[:, 0]
    for i in range(1, steps):
        noise = phi[:, i] @ noise @ transposed(phi[:, i]) + q[:, i]
        over = phi[:, i] @ over
    return over, noise


def _noise_input(c: Conditions) -> Array:
    """G (m, 18, 9): white gyro noise, drives of the Markov gyro drift and of the accelerometer error."""
    g = np.zeros((c.lat_rad.size, 18, 9))
    g[:, 0:3, 0:3] = -c.c_ub
    g[:, 12:15, 3:6] = g[:, 15:18, 6:9] = np.eye(3)
    return g


def _density() -> Array:
    """Spectral densities of the nine noises, (9, 9): reading B of the gyro noise."""
    white = (0.001 * DEG_SQRT_H_TO_RAD_SQRT_S) ** 2
    gyro = 2.0 * (0.001 * GYRO_BIAS["deg/h"]) ** 2 / TAU_R_S
    accel = 2.0 * (50.0 * ACCEL_BIAS["ug"]) ** 2 / TAU_A_S
    return np.diag(np.repeat([white, gyro, accel], 3))


def _initial(c: Conditions) -> Array:
    """Initial covariance (18, 18): squares of the published initial errors and drifts."""
    m, n = (float(values[0]) for values in _radii(c))
    attitude = DEG_TO_RAD / 60.0
    drift = GYRO_BIAS["deg/h"]
    place = [1.0 / m, 1.0 / (n * math.cos(float(c.lat_rad[0]))), 1.0]
    blocks = np.repeat([0.01 * drift, 0.001 * drift, 50.0 * ACCEL_BIAS["ug"]], 3)
    sd = np.concatenate([[attitude] * 3, [0.05] * 3, place, blocks])
    return np.diag(sd**2)


def _standard(p: Array, scale: Array) -> Array:
    """Standard deviations east, north, up (m) and of the heading (arcmin), shape (filters, 4)."""
    sd = np.sqrt(np.einsum("kii->ki", p))
    heading = sd[:, 2] / DEG_TO_RAD * 60.0
    return np.column_stack([sd[:, 7] * scale[0], sd[:, 6] * scale[1], sd[:, 8], heading])


def errata_table(truth: Trajectory, gap: tuple[float, float]) -> Table:
    """What each misprint does to accuracy and honesty: actual standard deviation, and the one that is claimed."""
    rows: list[list[Cell]] = []
    for name, each in outcomes(truth, gap).items():
        pairs = (each.steady_north, each.steady_heading, each.end_north, each.end_up, each.after_north)
        rows.append(
            [name or "-", ERRATA.get(name, "all right"), *(value for pair in pairs for value in pair)]
        )
    columns = ["no", "printed"]
    begin, end = gap
    for what in (
        f"north {begin - 1:.0f} s",
        f"heading {begin - 1:.0f} s",
        f"north {end - 1:.0f} s",
        f"up {end - 1:.0f} s",
        f"north {end + 60:.0f} s",
    ):
        columns += [what, "claimed"]
    return Table(
        "errata",
        f"What each misprint would do: covariance analysis through the gap of {begin:.0f} s to {end:.0f} s",
        columns,
        rows,
        "One standard deviation, m and arcmin: actual errors of a closed loop with the misprint in its filter, beside "
        "what that filter claims.",
    )
