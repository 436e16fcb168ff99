"""What the misprints of Al Bitar and Gavrilov (2019) would do.

Gravity that is wrong by dg (E1, E3) is the same as a specific force that is wrong by C' dg: these drives go through
the engine, and so do the two readings of the random components (E7). The wrong frame of the attitude error (E2) is a
matter of the feedback: a covariance analysis with the published 21 states tells what it does,

    P- = Phi P Phi' + Q,   K = P- H' (H P- H' + R)^-1,   S = (I - T K H) S- (I - T K H)' + T K R K' T'

where P is what the filter claims, S the covariance of its errors, and T = I but for the attitude, which is corrected
by C_b^n times what was meant.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.analysis import OutageGrowth, Trajectory, run_seed
from gnssins.reproduce.al_bitar_runs import Coasted, Plan, coast
from gnssins.reproduce.covariances import corrected, gain, third_order, transposed
from gnssins.reproduce.report import Cell, Job, Table
from gnssins.runner import run
from gnssins.sim import Simulated, Simulator
from gnssins.sim.frames import EARTH_RATE_RAD_S
from gnssins.units import ACCEL_BIAS, DEG_SQRT_H_TO_RAD_SQRT_S, DEG_TO_RAD, GYRO_BIAS, NS_PER_S, UG_TO_M_S2

__all__ = [
    "ERRATA",
    "Conditions",
    "Outcome",
    "centrifugal_n",
    "coast_errata",
    "covariance_outcomes",
    "errata_table",
    "polynomial_gravity",
    "system_matrix",
    "with_gravity_error",
]

Array = NDArray[np.float64]

#: Runs that the misprints get, at most.
RUNS: Final = 20

#: Filters that go through the engine, and what is wrong with them.
ERRATA: Final[Mapping[str, str]] = {
    "": "all right",
    "E1": "centrifugal acceleration taken off the polynomial, which has it already",
    "E3": "sin L in the place of sin^2 L and sin^4 L in gravity",
    "E7 start": "random components start at their own spread, constants not in P",
    "E7 one": "one random walk per sensor, 15 states",
}

#: Those of the covariance analysis.
ANALYSED: Final[Mapping[str, str]] = {
    "analysis": "all right, by covariance analysis",
    "E2": "attitude error of the NED axes fed back as one of the body axes",
}

T_GD: Final = 200.0
T_AD: Final = 200.0

#: Normal gravity as a polynomial (m/s^2; 1/m): g0 (1 + a1 sin^2 + a2 sin^4) + h (a3 + a4 sin^2) + a5 h^2.
_G0: Final = 9.7803267715
_A: Final = (0.0052790414, 0.0000232718, -3.0876910891e-6, 4.3977311e-9, 7.211e-13)

#: Standard deviations of fixes, m and m/s.
_FIX_SD: Final = (0.5, 0.5, 0.5, 0.1, 0.1, 0.1)


# ---- gravity


def polynomial_gravity(lat_rad: float, height_m: float, *, printed: bool = False) -> float:
    """Normal gravity, down (m/s^2), section 2 of the specification; ``printed``: with the exponents lost (E3)."""
    s = math.sin(lat_rad)
    square, fourth = (s, s) if printed else (s**2, s**4)
    a1, a2, a3, a4, a5 = _A
    return _G0 * (1.0 + a1 * square + a2 * fourth) + height_m * (a3 + a4 * square) + a5 * height_m**2


def centrifugal_n(lat_rad: float, height_m: float) -> Array:
    """Centrifugal acceleration, away from the axis of the Earth, north, east, down (m/s^2): -w x (w x r)."""
    normal = float(_core.radii(np.array([lat_rad]), "wgs84")[0, 1]) + height_m
    s, c = math.sin(lat_rad), math.cos(lat_rad)
    return EARTH_RATE_RAD_S**2 * normal * c * np.array([-s, 0.0, -c])


# ---- through the engine


def with_gravity_error(simulated: Simulated, path_q_nb: Array, dg_n: Array) -> Simulated:
    """Make a drive what it is to an INS whose gravity is wrong by dg: C f + g + dg = C (f + C' dg) + g.

    Parameters
    ----------
    simulated : Simulated
        The drive.
    path_q_nb : ndarray, shape (n, 4)
        True attitude at the start and at every sample of the IMU.
    dg_n : ndarray, shape (3,)
        Error of gravity, north, east, down (m/s^2).
    """
    imu = simulated.dataset.imu
    c_nb = _core.quat_to_dcm(np.ascontiguousarray(path_q_nb))
    step_s = np.diff(np.concatenate([[simulated.initial.t_ns], imu.t_ns])) / NS_PER_S
    felt = np.einsum("kji,j->ki", c_nb, dg_n)
    accel = imu.accel + 0.5 * (felt[1:] + felt[:-1]) * step_s[:, None]
    return replace(simulated, dataset=replace(simulated.dataset, imu=replace(imu, accel=accel)))


def coast_errata(plan: Plan, simulator: Simulator, seed: int, index: int) -> dict[str, Coasted]:
    """Filter drive ``index`` with every misprint; keys as in :data:`ERRATA`."""
    simulated = simulator.run(run_seed(seed, index))
    path = simulator.trajectory
    lat, height = float(path.lla[0, 0]), float(path.lla[0, 2])
    wrong = polynomial_gravity(lat, height, printed=True) - polynomial_gravity(lat, height)
    start = [
        {"kind": "gyro_bias", "name": "gyro_walk", "unit": "deg/h", "initial_sd": 1e-3},
        {"kind": "accel_bias", "name": "accel_walk", "unit": "ug", "initial_sd": 1e-1},
    ]
    right = plan.config(True)
    found = {"": coast(plan, run(right, simulated), simulated)}
    for name, dg in (("E1", centrifugal_n(lat, height)), ("E3", np.array([0.0, 0.0, wrong]))):
        misled = with_gravity_error(simulated, path.q_nb, dg)
        found[name] = coast(plan, run(right, misled), misled)
    found["E7 start"] = coast(plan, run(plan.config(True, blocks=start), simulated), simulated)
    found["E7 one"] = coast(plan, run(plan.one_bias(True), simulated), simulated)
    return found


# ---- covariance analysis


@dataclass(frozen=True, eq=False)
class Conditions:
    """The motion at m times: everything that the system matrix depends on.

    Parameters
    ----------
    lat_rad, height_m : ndarray, shape (m,)
        Place.
    v_n, f_n : ndarray, shape (m, 3)
        Velocity (m/s) and specific force (m/s^2) along north, east, down.
    c_nb : ndarray, shape (m, 3, 3)
        Body to north, east, down.
    """

    lat_rad: Array
    height_m: Array
    v_n: Array
    f_n: Array
    c_nb: Array

    @classmethod
    def of(cls, truth: Trajectory, times_s: Array) -> Conditions:
        """Take them from a motion at the nearest of its epochs; the specific force from the change of velocity."""
        if truth.q_nb is None:
            raise TypeError("the motion has no attitude")
        t_s = truth.t_ns / NS_PER_S
        row = np.clip(np.searchsorted(t_s, times_s - 1e-6), 0, t_s.size - 1)
        lat, height = (np.ascontiguousarray(truth.lla[:, i]) for i in (0, 2))
        v = truth.v_n
        m, n = (_core.radii(lat, "wgs84") + height[:, None]).T
        rate = np.column_stack([np.cos(lat), np.zeros_like(lat), -np.sin(lat)]) * EARTH_RATE_RAD_S
        transport = np.column_stack([v[:, 1] / n, -v[:, 0] / m, -v[:, 1] * np.tan(lat) / n])
        slope = np.gradient(v, t_s, axis=0)
        f_n = slope + np.cross(2.0 * rate + transport, v) - _core.gravity_n(lat, height, "wgs84")
        c_nb = _core.quat_to_dcm(np.ascontiguousarray(truth.q_nb[row]))
        return cls(lat[row], height[row], v[row], f_n[row], c_nb)

    @property
    def radii(self) -> tuple[Array, Array]:
        """Radii of curvature with the height, M + h and N + h, shapes (m,)."""
        found = _core.radii(np.ascontiguousarray(self.lat_rad), "wgs84") + self.height_m[:, None]
        return found[:, 0], found[:, 1]


def system_matrix(c: Conditions) -> Array:
    """F of the publication, (m, 21, 21): dq, latitude, longitude (rad), height, velocity, then the four biases."""
    lat, (vn, ve, vd), (fn, fe, fd) = c.lat_rad, c.v_n.T, c.f_n.T
    (m, n), w = c.radii, EARTH_RATE_RAD_S
    s, co, tan = np.sin(lat), np.cos(lat), np.tan(lat)
    g = _core.gravity_n(np.ascontiguousarray(lat), np.ascontiguousarray(c.height_m), "wgs84")[:, 2]
    north, east, down = w * co + ve / n, -vn / m, -w * s - ve * tan / n
    entries = {
        (1, 2): down, (1, 3): -east, (2, 1): -down, (2, 3): north, (3, 1): east, (3, 2): -north,
        (1, 4): -w * s / 2, (1, 6): -ve / (2 * n**2), (1, 8): 1 / (2 * n),
        (2, 6): vn / (2 * m**2), (2, 7): -1 / (2 * m),
        (3, 4): -(w * co + ve / (n * co**2)) / 2, (3, 6): ve * tan / (2 * n**2), (3, 8): -tan / (2 * n),
        (4, 6): -vn / m**2, (4, 7): 1 / m,
        (5, 4): ve * tan / (n * co), (5, 6): -ve / (n**2 * co), (5, 8): 1 / (n * co), (6, 9): -np.ones_like(lat),
        (7, 2): -2 * fd, (7, 3): 2 * fe, (8, 1): 2 * fd, (8, 3): -2 * fn, (9, 1): -2 * fe, (9, 2): 2 * fn,
        (7, 4): -(2 * w * co * ve + ve**2 / (n * co**2)), (7, 6): ve**2 * tan / n**2 - vn * vd / m**2,
        (8, 4): 2 * w * (co * vn - s * vd) + vn * ve / (n * co**2), (8, 6): -ve * (vn * tan + vd) / n**2,
        (9, 4): 2 * w * s * ve, (9, 6): ve**2 / n**2 + vn**2 / m**2 - 2 * g / np.sqrt(m * n),
        (7, 7): vd / m, (7, 8): -2 * (w * s + ve * tan / n), (7, 9): vn / m,
        (8, 7): 2 * w * s + ve * tan / n, (8, 8): (vd + vn * tan) / n, (8, 9): 2 * w * co + ve / n,
        (9, 7): -2 * vn / m, (9, 8): -2 * (w * co + ve / n),
    }  # fmt: skip
    f = np.zeros((lat.size, 21, 21))
    for (row, column), value in entries.items():
        f[:, row - 1, column - 1] = value
    for first in (9, 12):
        f[:, 0:3, first : first + 3] = -c.c_nb / 2.0
    for first in (15, 18):
        f[:, 6:9, first : first + 3] = c.c_nb
    for i in range(3):
        f[:, 12 + i, 12 + i] = -1.0 / T_GD
        f[:, 18 + i, 18 + i] = -1.0 / T_AD
    return f


@dataclass(frozen=True)
class Outcome:
    """Standard deviations in the last second of the gaps, root mean square of them: actual, and as claimed.

    Position in m, angles in rad; of the filters that go through the engine root mean square errors of all runs.
    """

    distance: tuple[float, float]
    tilt: tuple[float, float]
    heading: tuple[float, float]
    nees: float

    @classmethod
    def of(cls, growth: OutageGrowth, nees: float) -> Outcome:
        """Take it from the growth of errors in gaps."""
        last = float(growth.at_s[-1])

        def pair(name: str) -> tuple[float, float]:
            return growth.value("rms", name, last), growth.value("sigma", name, last)

        roll, pitch = pair("roll"), pair("pitch")
        tilt = tuple(math.hypot(a, b) / math.sqrt(2.0) for a, b in zip(roll, pitch, strict=True))
        return cls(pair("distance"), (tilt[0], tilt[1]), pair("heading"), nees)


def covariance_outcomes(plan: Plan, truth: Trajectory, fix_s: float = 0.2) -> dict[str, Outcome]:
    """Run the published filter's covariance through the gaps, right and with E2; keys as in :data:`ANALYSED`."""
    last = max(plan.gap_ends)
    count = round(last / fix_s)
    middle = Conditions.of(truth, (np.arange(2 * count, dtype=np.float64) + 0.5) * fix_s / 2.0)
    at = Conditions.of(truth, np.arange(1, count + 1, dtype=np.float64) * fix_s)
    phi, q = _transition(middle, fix_s / 2.0)
    m, n = at.radii
    scale = np.column_stack([m, n * np.cos(at.lat_rad), np.ones_like(m)])
    r = np.diag(np.square(_FIX_SD))
    claimed = _initial(scale[0])
    actual = np.stack([claimed, claimed])
    ends = {round(end / fix_s) for end in plan.gap_ends}
    variances = []
    for k in range(count):
        claimed = phi[k] @ claimed @ phi[k].T + q[k]
        actual = phi[k] @ actual @ phi[k].T + q[k]
        t = (k + 1) * fix_s
        if not any(begin - 1e-6 <= t <= end + 1e-6 for begin, end in plan.gaps):
            h = np.zeros((6, 21))
            h[0:3, 3:6], h[3:6, 6:9] = np.diag(scale[k]), np.eye(3)
            right = gain(claimed, h, r)
            turned = np.eye(21)
            turned[0:3, 0:3] = at.c_nb[k]
            actual = corrected(actual, np.stack([right, turned @ right]), h, r)
            claimed = corrected(claimed, right, h, r)
        if k + 1 in ends:
            variances.append([_figures(p, scale[k]) for p in (claimed, *actual)])
    claims, *found = np.sqrt(np.mean(variances, axis=0))

    def outcome(figures: Array) -> Outcome:
        pairs = [(float(a), float(b)) for a, b in zip(figures, claims, strict=True)]
        return Outcome(pairs[0], pairs[1], pairs[2], math.nan)

    return {name: outcome(figures) for name, figures in zip(ANALYSED, found, strict=True)}


def _transition(c: Conditions, dt: float) -> tuple[Array, Array]:
    """Transition and process noise from fix to fix, two steps each, terms to third order, shape (fixes, 21, 21)."""
    f = system_matrix(c)
    g = np.zeros((f.shape[0], 21, 18))
    g[:, 0:3, 0:3], g[:, 6:9, 3:6] = -c.c_nb / 2.0, c.c_nb
    g[:, 9:21, 6:18] = np.eye(12)
    gyro, accel = 3.0 * GYRO_BIAS["deg/h"], 20.0 * ACCEL_BIAS["ug"]
    white = [(0.15 * DEG_SQRT_H_TO_RAD_SQRT_S) ** 2, (57.0 * UG_TO_M_S2) ** 2]
    drives = [5e-7**2, 2.0 * gyro**2 / T_GD, 1e-5**2, 2.0 * accel**2 / T_AD]
    phi, q = third_order(f, g, np.diag(np.repeat([*white, *drives], 3)), dt)
    return phi[1::2] @ phi[::2], phi[1::2] @ q[::2] @ transposed(phi[1::2]) + q[1::2]


def _initial(scale: Array) -> Array:
    """Initial covariance (21, 21) of the specification."""
    attitude = np.array([0.2, 0.2, 1.0]) * DEG_TO_RAD / 2.0
    blocks = (0.02 * DEG_TO_RAD, 3.0 * GYRO_BIAS["deg/h"], 3.0 * ACCEL_BIAS["mg"], 20.0 * ACCEL_BIAS["ug"])
    return np.diag(np.square(np.concatenate([attitude, 0.5 / scale, [0.1] * 3, np.repeat(blocks, 3)])))


def _figures(p: Array, scale: Array) -> list[float]:
    """Variances of the distance (m^2), of a tilt and of the heading (rad^2): twice dq."""
    d = np.diag(p)
    return [float(d[3:6] @ scale**2), float(2.0 * (d[0] + d[1])), float(4.0 * d[2])]


# ---- table


def errata_table(plan: Plan, job: Job, simulator: Simulator, units: int) -> Table:
    """What each misprint does at the ends of the gaps: actual errors, and those that the filter claims."""
    runs = min(job.runs, RUNS)
    work = partial(coast_errata, plan, simulator, job.seed)
    drives = job.map(work, runs, "misprints", units=units)
    every = {name: _engine_outcome([found[name] for found in drives]) for name in ERRATA}
    every |= covariance_outcomes(plan, simulator.truth)
    rows: list[list[Cell]] = []
    for name, each in every.items():
        number, text = name or "-", {**ERRATA, **ANALYSED}[name]
        angles = [value / DEG_TO_RAD for pair in (each.tilt, each.heading) for value in pair]
        rows.append([number, text, *each.distance, *angles, None if math.isnan(each.nees) else each.nees])
    return Table(
        "errata",
        f"What the misprints would do: errors in the last second of the gaps, {runs} runs",
        [
            "no", "filter", "E_xyz m", "claimed", "roll, pitch deg", "claimed", "heading deg", "claimed",
            "NEES of 9 states",
        ],
        rows,
        "Root mean square over runs and gaps, beside what the filter claims. E2 diverges: figures of a linear "
        "analysis, which say no more than that.",
    )  # fmt: skip


def _engine_outcome(found: Sequence[Coasted]) -> Outcome:
    growth = OutageGrowth.combine([each.growth for each in found])
    return Outcome.of(growth, float(np.mean([each.nees for each in found])))
