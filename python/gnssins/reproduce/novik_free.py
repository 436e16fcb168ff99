"""What Novik (2011) says about an INS without a filter: its equations, its budget, and separated operation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.analysis import compare, ned_difference, run_seed
from gnssins.reproduce.novik_runs import Plan
from gnssins.reproduce.novik_tables import AXES, ENU, Runs, growth
from gnssins.reproduce.report import Cell, Table
from gnssins.sim.analytic import evaluate
from gnssins.sim.frames import EARTH_RATE_RAD_S, c_en
from gnssins.units import ACCEL_BIAS, GYRO_BIAS, NS_PER_S

if TYPE_CHECKING:
    from gnssins.analysis.budget import Budget
    from gnssins.analysis.forms import FormTable
    from gnssins.analysis.schuler import SchulerCurves

__all__ = [
    "MODES", "Uncoupled", "budget", "budget_table", "closed_form_error", "earth_table", "feedback_bound_s",
    "form_table", "forms", "rates", "schuler_table", "separated_table", "uncoupled", "uncoupled_growth",
]  # fmt: skip

Array = NDArray[np.float64]

#: Modes of separated operation, and what they are. The height of an INS that every fix restarts needs no barometer.
MODES: Final = {
    "free": "free INS, height held by the barometer",
    "restart": "INS restarted from every fix",
    "slaved": "INS slaved to GNSS, 10 s",
    "restart-at-gap": "free INS, restarted from the last fix before the outage",
}

_UG, _DEG_H = ACCEL_BIAS["ug"], GYRO_BIAS["deg/h"]


@dataclass(frozen=True, eq=False)
class Uncoupled:
    """Errors of one mode in one run.

    Parameters
    ----------
    rms : ndarray, shape (6,)
        Over the settled closed loop: position N, E, D (m), velocity (m/s).
    growth : ndarray, shape (seconds, 3)
        Growth of the position error N, E, D since the last fix, m.
    """

    rms: Array
    growth: Array


def uncoupled(plan: Plan, seed: int, index: int) -> dict[str, Uncoupled]:
    """Fly run ``index`` in every mode of separated operation."""
    from gnssins.uncoupled import separated

    simulated = plan.simulator.run(run_seed(seed, index))
    gap = (plan.end_s + 0.5, plan.end_s + plan.outage_s + 0.5)
    out = {}
    for mode in MODES:
        vertical = "free" if mode == "restart" else "baro"
        result = separated(simulated, mode, outages=[gap], vertical=vertical, output_rate_hz=1.0)  # type: ignore[arg-type]
        found = compare(result, plan.simulator.truth)
        settled = (found.time_s > plan.settle_s) & (found.time_s < plan.end_s + 0.5)
        both = np.column_stack([found.position, found.velocity])[settled]
        first = int(np.searchsorted(found.time_s, plan.end_s - 0.01))
        grown = found.position[first:] - found.position[first]
        out[mode] = Uncoupled(np.sqrt(np.mean(both**2, axis=0)), grown)
    return out


def uncoupled_growth(flights: Sequence[Mapping[str, Uncoupled]], mode: str) -> Array:
    """Growth E, N, h (m) of all runs, shape (runs, seconds, 3)."""
    return np.array([each[mode].growth for each in flights])[:, :, ENU]


def separated_table(runs: Runs, flights: Sequence[Mapping[str, Uncoupled]]) -> Table:
    """Separated operation beside the complex: closed loop, and the end of the outage."""
    rows: list[list[Cell]] = []

    def add(label: str, loop: Array, grown: Array) -> None:
        last = np.sqrt(np.mean(grown[:, -1] ** 2, axis=0))
        rows.append([label, *map(float, loop[ENU]), *map(float, loop[3:][ENU]), *map(float, last)])

    every = runs.loop.over_window(0)[0]
    add("complex", np.concatenate([every[6:9], every[3:6]]), growth(runs))
    for mode, label in MODES.items():
        loop = np.sqrt(np.mean([each[mode].rms ** 2 for each in flights], axis=0))
        add(label, loop, uncoupled_growth(flights, mode))
    head = [f"{what} {axis}" for what in ("m", "m/s", "growth m") for axis in AXES]
    plan = runs.plan
    return Table(
        "separated",
        f"Separated operation beside the complex, rms of {plan.settle_s:.0f}-{plan.end_s:.0f} s, and growth of the "
        f"position error over the outage of {plan.outage_s:.0f} s",
        ["scheme", *head],
        rows,
        "No scheme can see the slow position error of the receiver, so positions hardly differ while GNSS is there. "
        "The height of a\nrestarted INS has the noise of every fix, that of a slaved one the bias of the barometer.",
    )


# ---- equations


def closed_form_error(plan: Plan, inner: int = 8) -> Array:
    """Distance of an error-free strapdown from the closed-form track, m, shape (samples + 1,).

    The increments owe nothing to the engine: angles are the rotation vectors between body axes in inertial space over
    ``inner`` steps per sample, velocities the quadrature of the closed-form specific force (Simpson).
    """
    scenario = plan.simulator.scenario
    if scenario.analytic is None or scenario.scenario.duration_s is None:
        raise TypeError(f"{scenario.name} has no analytic track")
    rate, start = scenario.scenario.rate_hz, scenario.start
    samples = round(scenario.scenario.duration_s * rate)
    t = np.arange(samples * inner + 1) / (rate * inner)
    place = np.array([np.radians(start.lat_deg), np.radians(start.lon_deg), start.height_m])
    track = evaluate(scenario.analytic, place, t)
    q_nb = _core.euler_to_quat(np.ascontiguousarray(track.rpy))
    c_nb = _core.quat_to_dcm(q_nb)
    c_ib = (
        c_en(np.column_stack([track.lla[:, 0], track.lla[:, 1] + EARTH_RATE_RAD_S * t, track.lla[:, 2]]))
        @ c_nb
    )
    turn = np.ascontiguousarray(np.swapaxes(c_ib[:-1], 1, 2) @ c_ib[1:])
    dtheta = _core.quat_to_rotvec(_core.dcm_to_quat(turn)).reshape(samples, inner, 3).sum(axis=1)
    weight = np.ones(inner + 1)
    weight[1:-1:2], weight[2:-1:2] = 4.0, 2.0
    rows = np.arange(samples)[:, None] * inner + np.arange(inner + 1)
    force = np.einsum("kij,ki->kj", c_nb, track.f_n)
    dvel = np.einsum("ksi,s->ki", force[rows], weight / (3.0 * rate * inner))
    t_ns, none = np.rint(t[::inner] * NS_PER_S).astype(np.int64), np.zeros((1, 3))
    truth = scenario.truth
    lla, _, _ = _core.strapdown(
        truth.model, truth.ellipsoid, truth.gravity, truth.coning, t_ns, np.vstack([none, dtheta]),
        np.vstack([none, dvel]), track.lla[0], track.v_n[0], q_nb[0],
    )  # fmt: skip
    return np.asarray(np.linalg.norm(ned_difference(lla, track.lla[::inner]), axis=1))


def forms(plan: Plan) -> FormTable:
    """Attitude forms on the error-free flight."""
    from gnssins.analysis import attitude_forms

    return attitude_forms(plan.simulator.trajectory)


def rates(plan: Plan) -> FormTable:
    """Three rates on the error-free flight."""
    from gnssins.analysis import three_rates

    return three_rates(plan.simulator.trajectory)


def form_table(found: FormTable, name: str, note: str = "") -> Table:
    """Forms side by side."""
    rows: list[list[Cell]] = [
        [f.name, f.position_m, f.largest_position_m, f.velocity_m_s, f.attitude_rad, f.time_ratio]
        for f in found.forms
    ]
    return Table(
        name,
        f"{found.title}, error-free flight of {found.duration_s:.0f} s at {found.rate_hz:.0f} Hz",
        ["form", "position m", "largest m", "velocity m/s", "attitude rad", "time"],
        rows,
        "Errors at the end; time over that of the first line, from one call each." + note,
    )


def earth_table() -> Table:
    """Radii and gravity in the publication's simplified forms."""
    from gnssins.analysis import earth_variants

    found = earth_variants()
    rows: list[list[Cell]] = [
        [e.quantity, e.form, e.shown, abs(e.lat_deg), e.height_m / 1e3, e.acts_as] for e in found.errors
    ]
    return Table(
        "earth",
        f"Simplified forms of radii and gravity: largest error, heights 0 to {found.top_m / 1e3:.0f} km",
        ["quantity", "form", "error", "at lat deg", "km", "acts as"],
        rows,
        "Against the closed forms of the engine, WGS-84.",
    )


# ---- budget, Schuler curves


def budget() -> Budget:
    """Sensor budget for 5 m, and how long the published sensors meet it."""
    from gnssins.analysis import sensor_budget

    return sensor_budget(5.0, accel_m_s2=25.0 * _UG, gyro_rad_s=0.003 * _DEG_H)


def budget_table(found: Budget) -> Table:
    """Allowed sensor errors by length of the outage."""
    rows: list[list[Cell]] = [
        [r.outage_s, r.accel_m_s2 / _UG, r.accel_within_m_s2 / _UG, r.gyro_rad_s / _DEG_H] for r in found.rows
    ]
    return Table(
        "budget",
        "Constant sensor errors allowed for 5 m after an outage, each alone",
        ["outage s", "accelerometer at the end ug", "at any time ug", "gyro deg/h"],
        rows,
        f"25 ug reach 5 m after {found.accel_outage_s:.0f} s, 0.003 deg/h after {found.gyro_outage_s:.0f} s.",
    )


def schuler_table(curves: SchulerCurves) -> Table:
    """Single errors of a free INS beside the pendulum and the print."""
    rows: list[list[Cell]] = [
        [c.case.text, c.full_m, c.pendulum_m, c.case.published_m, c.case.note] for c in curves.curves.values()
    ]
    return Table(
        "schuler",
        f"Horizontal error of a free INS at rest at {curves.lat_deg:.0f} deg, height held",
        ["error", "full model m", "pendulum m", "published m", "note"],
        rows,
        "Largest error within a period of 84.4 min, or at the time named.",
    )


def feedback_bound_s() -> float:
    """Longest time between two feedbacks from the linearity bound: data sheet, 1 mrad at the start."""
    from gnssins.analysis import correction_period, linearity_bound

    accel, gyro = 25.0 * _UG, 0.003 * _DEG_H
    return correction_period(linearity_bound(accel), tilt_rad=1e-3, gyro_rad_s=gyro, accel_m_s2=accel)
