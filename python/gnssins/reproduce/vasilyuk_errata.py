"""What the printed forms of Vasilyuk (2019) do, told by two covariances: the filter's own, and that of its true error.

The system along one walk is linear once it is known where the walk leads (``Result.linearisation``). A filter with a
wrong transition in place of Phi, or a wrong Q, computes a wrong P and a wrong gain; the covariance Pi of its true error
takes that gain through the right system (:mod:`gnssins.reproduce.covariances`). The expected NEES is the trace of
P^-1 Pi. Nothing is drawn.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gnssins.alignment import InitialState
from gnssins.analysis.noise import BandLimited, gauss_markov_noise
from gnssins.analysis.stacking import c_en
from gnssins.reproduce.covariances import corrected, gain
from gnssins.reproduce.report import Cell, Table
from gnssins.reproduce.vasilyuk_runs import Plan, matched
from gnssins.result import Linearisation, Result
from gnssins.runner import run
from gnssins.sim import Simulated
from gnssins.sim.processes import low_pass
from gnssins.units import ACCEL_BIAS, DEG_TO_RAD, GYRO_BIAS, NS_PER_S

__all__ = ["ACCEL", "GYRO", "Printed", "noise_table", "printed_forms", "printed_table"]

Array = NDArray[np.float64]

#: The sensors of the publication: one-sided densities behind 40 Hz.
GYRO: Final = BandLimited.of_one_sided(math.sqrt(2.0) * 0.008 * DEG_TO_RAD, 40.0)
ACCEL: Final = BandLimited.of_one_sided(math.sqrt(2.0) * 0.0034, 40.0)

#: Biases: steady standard deviation and correlation time.
GYRO_BIAS_SD: Final = 10.0 * GYRO_BIAS["deg/h"]
ACCEL_BIAS_SD: Final = 80.0 * ACCEL_BIAS["ug"]
TAU_S: Final = 70.0

#: Fix interval and inertial step of the publication, s.
FIX_S: Final = 0.1
STEP_S: Final = 0.01

#: Turn-on biases, which the publication does not give; those of the scenario.
GYRO_START: Final = 0.3 * DEG_TO_RAD
ACCEL_START: Final = 0.05

Change = Callable[[Array, Array], tuple[Array, Array]]


@dataclass(frozen=True)
class Printed:
    """What becomes of a filter with one printed form.

    Parameters
    ----------
    name : str
        Which form.
    nees : float
        Expected NEES over 15, mean from point A on.
    gyro_z : float
        True root mean square error of the z-gyro bias at the end, rad/s.
    heading : float
        The same of the heading, rad.
    horizontal_m : float
        True horizontal root mean square error after 20 s without fixes.
    claimed_m : float
        What the filter claims there.
    """

    name: str
    nees: float
    gyro_z: float
    heading: float
    horizontal_m: float
    claimed_m: float


def printed_forms(plan: Plan, simulated: Simulated) -> list[Printed]:
    """Right form and printed ones on one walk."""
    result = run(plan.config(linearise=True), matched(simulated))
    linear = result.linearisation
    if linear is None:
        raise TypeError("the run kept no linearised model")
    forms: dict[str, Change] = {
        "right: biases as random walks": lambda phi, q: (phi, q),
        "F3, F7 = -1/tau, biases held": _decaying,
        "F6 with T_P in place of T_I": _coupled,
        "closed-form Q of one interval": lambda phi, q: (phi, _closed(q)),
    }
    start = simulated.initial
    return [_judge(name, change, plan, linear, start) for name, change in forms.items()]


def _decaying(phi: Array, q: Array) -> tuple[Array, Array]:
    """The variance of a bias decays with tau while its estimate does not."""
    wrong = phi.copy()
    i = np.arange(9, 15)
    wrong[i, i] -= FIX_S / TAU_S
    return wrong, q


def _coupled(phi: Array, q: Array) -> tuple[Array, Array]:
    """Accelerometer biases enter the velocity J times too strongly."""
    wrong = phi.copy()
    wrong[3:6, 12:15] *= FIX_S / STEP_S
    return wrong, q


def _closed(q: Array) -> Array:
    """The noise of one interval by itself, without what it has in common with its neighbours."""
    scale = np.ones(q.shape[0])
    scale[:3], scale[3:6] = GYRO.shortfall(FIX_S), ACCEL.shortfall(FIX_S)
    root = np.sqrt(1.0 - np.where(scale == 1.0, 0.0, scale))
    return np.asarray(q * root[:, None] * root[None, :])


def _white(phi: Array, dt_s: float) -> Array:
    """Process noise of one interval, axes of the model: white equivalents, cross terms as (Phi Q Phi' + Q)/2."""
    per_axis = [
        GYRO.white_equivalent(dt_s),
        ACCEL.white_equivalent(dt_s),
        0.0,
        gauss_markov_noise(GYRO_BIAS_SD, TAU_S, dt_s),
        gauss_markov_noise(ACCEL_BIAS_SD, TAU_S, dt_s),
    ]
    q = np.diag(np.repeat(per_axis, 3))
    return np.asarray(0.5 * (phi @ q @ phi.T + q))


def _judge(name: str, change: Change, plan: Plan, linear: Linearisation, start: InitialState) -> Printed:
    """Run both covariances along the walk; coast from the start of the gap on a branch of its own."""
    t_s = linear.t_ns / NS_PER_S
    dt = np.diff(t_s, prepend=start.t_ns / NS_PER_S)
    turn = c_en(linear.lla)
    p = _prior(start, turn[0])
    pi, factor = p.copy(), np.zeros(t_s.size)
    branch: tuple[Array, Array] | None = None
    coasted = (math.nan, math.nan)
    for k in range(t_s.size):
        phi, q = linear.phi[k], _white(linear.phi[k], float(dt[k]))
        wrong, wrong_q = change(phi, q)
        pi, p = phi @ pi @ phi.T + q, wrong @ p @ wrong.T + wrong_q
        if branch is not None:
            branch = phi @ branch[0] @ phi.T + q, wrong @ branch[1] @ wrong.T + wrong_q
            if t_s[k] >= plan.gap[1] - 1e-6:
                coasted = (_horizontal(branch[0], turn[k]), _horizontal(branch[1], turn[k]))
                branch = None
        elif t_s[k] >= plan.gap[0] - 1e-6 and math.isnan(coasted[0]):
            branch = pi, p  # the fix at the start of the gap is the first one withheld
        pi, p = _correct(pi, p, linear.h[k, :3], linear.r[k, :3, :3])
        factor[k] = np.trace(np.linalg.solve(p, pi)) / p.shape[0]
    down = turn[-1][:, 2]
    return Printed(
        name=name,
        nees=float(factor[t_s > plan.settled_s].mean()),
        gyro_z=math.sqrt(pi[11, 11]),
        heading=math.sqrt(down @ pi[:3, :3] @ down),
        horizontal_m=coasted[0],
        claimed_m=coasted[1],
    )


def _prior(start: InitialState, turn: Array) -> Array:
    """Covariance at the start, axes of the model."""
    p = np.zeros((15, 15))
    for at, sd in ((0, start.sd_phi), (3, start.sd_v), (6, start.sd_p)):
        p[at : at + 3, at : at + 3] = turn @ np.diag(np.asarray(sd) ** 2) @ turn.T
    p[9:12, 9:12], p[12:, 12:] = GYRO_START**2 * np.eye(3), ACCEL_START**2 * np.eye(3)
    return p


def _correct(pi: Array, p: Array, h: Array, r: Array) -> tuple[Array, Array]:
    """One fix with the filter's own gain, on the true covariance and on its own (Joseph form)."""
    own = gain(p, h, r)
    return corrected(pi, own, h, r), corrected(p, own, h, r)


def _horizontal(p: Array, turn: Array) -> float:
    level = turn[:, :2]
    return float(math.sqrt(np.trace(level.T @ p[6:9, 6:9] @ level)))


def printed_table(found: list[Printed]) -> Table:
    """What the printed forms do."""
    published = ["0.94", "3.5 .. 4.4", "-", "-"]
    rows: list[list[Cell]] = [
        [
            f.name,
            f.nees,
            reference,
            f.gyro_z / GYRO_BIAS["deg/h"],
            f.heading / DEG_TO_RAD,
            f.horizontal_m,
            f.claimed_m,
        ]
        for f, reference in zip(found, published, strict=True)
    ]
    return Table(
        "printed_forms",
        "Right and printed forms on one walk: expected values, nothing drawn",
        [
            "form",
            "NEES/15",
            "independent program",
            "z-gyro bias deg/h",
            "heading deg",
            "horizontal m, 20 s",
            "claimed m",
        ],
        rows,
        "True errors of a filter that believes the form; biases and heading at the end of the walk. Independent "
        "program: one seed on another path.",
    )


# ---- noise of one interval


def noise_table(plan: Plan, simulated: Simulated, seed: int) -> Table:
    """Noise per interval between fixes: closed form, white equivalent, the engine's, and drawn noise."""
    engine = engine_noise(plan, simulated)
    rows: list[list[Cell]] = []
    for name, unit, noise, own in (
        ("attitude", "rad^2", GYRO, engine["attitude"]),
        ("velocity", "m^2/s^2", ACCEL, engine["velocity"]),
    ):
        one, long_run = _drawn(noise, seed)
        rows.append(
            [name, unit, noise.same_interval(FIX_S), noise.white_equivalent(FIX_S), own, one, long_run]
        )
    for name, unit, sd in (
        ("gyro bias", "rad^2/s^2", GYRO_BIAS_SD),
        ("accelerometer bias", "m^2/s^4", ACCEL_BIAS_SD),
    ):
        value = gauss_markov_noise(sd, TAU_S, FIX_S)
        rows.append([name, unit, value, value, engine[name], None, None])
    return Table(
        "process_noise",
        "Variance that one interval of 0.1 s adds, per axis",
        [
            "state",
            "unit",
            "closed form",
            "white N T/2",
            "engine",
            "drawn, one interval",
            "drawn, growth over 10 s",
        ],
        rows,
        f"The closed form is right for one interval and {100 * ACCEL.shortfall(FIX_S):.1f} % short in the long run: "
        "neighbouring intervals are correlated.",
    )


def engine_noise(plan: Plan, simulated: Simulated) -> dict[str, float]:
    """Q of the engine per fix interval, from P[k] - Phi P[k-1] Phi' of a run without knowledge and without fixes.

    The start is exact and the fixes are worth nothing, so that P is made of noise alone; over some seconds only, while
    the turn of the local axes with the position error is nothing either.
    """
    data, start = simulated.dataset, simulated.initial
    fixes = replace(data.gnss, var=data.gnss.var * 1e16)
    nothing = np.full(3, 1e-12)
    exact = replace(start, sd_phi=nothing, sd_v=nothing, sd_p=nothing)
    config = plan.config(linearise=True).replace(
        run={"covariance_interval_s": FIX_S, "end_s": 4.0},
        filter={
            "block": [
                {"kind": "gyro_bias", "unit": "rad/s", "initial_sd": 1e-15},
                {"kind": "accel_bias", "unit": "m/s^2", "initial_sd": 1e-15},
            ]
        },
    )
    result: Result = run(config, replace(data, gnss=fixes), initial=exact)
    linear = result.linearisation
    if linear is None:
        raise TypeError("the run kept no linearised model")
    _, at, rows = np.intersect1d(linear.t_ns, result.covariance.t_ns, return_indices=True)
    turn = np.zeros((at.size, 15, 15))
    turn[:, range(9, 15), range(9, 15)] = 1.0
    for k in (0, 3, 6):
        turn[:, k : k + 3, k : k + 3] = c_en(linear.lla[at])
    p = turn @ result.covariance.matrix[rows] @ turn.transpose(0, 2, 1)
    phi = linear.phi[at]
    q = (p[1:] - phi[1:] @ p[:-1] @ phi[1:].transpose(0, 2, 1))[np.diff(at) == 1]
    mean = np.einsum("kii->ki", q).mean(axis=0).reshape(5, 3).mean(axis=1)
    names = ("attitude", "velocity", "position", "gyro bias", "accelerometer bias")
    return dict(zip(names, mean.tolist(), strict=True))


def _drawn(noise: BandLimited, seed: int) -> tuple[float, float]:
    """Variance of one interval and growth per interval over 10 s, of drawn noise as simulated."""
    runs, steps = 400, round(10.0 / STEP_S)
    rng = np.random.default_rng(seed)
    _, parts = low_pass(rng, steps, STEP_S, np.full(runs, noise.walk), noise.corner_hz)
    intervals = parts.reshape(-1, round(FIX_S / STEP_S), runs).sum(axis=1)
    return float(np.mean(intervals**2)), float(np.mean(parts.sum(axis=0) ** 2)) / intervals.shape[0]
