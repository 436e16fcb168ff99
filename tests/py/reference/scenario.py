"""Short hard flight for the golden runs: turns, climbs, rolls, shakes and speed changes in ten seconds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import attitude as att
from . import earth
from .strapdown import NavState, coning_sculling, step

Array = NDArray[Any]
DT_NS = 10_000_000
DT = 0.01
STEPS = 1000
GNSS_STEPS = range(50, STEPS + 1, 100)


@dataclass
class Truth:
    """True states at every IMU time and the true increments (1001, 3) that lead to them; row 0 is zero."""

    states: list[NavState]
    dtheta: Array
    dvel: Array


def motion(t: float) -> tuple[Array, Array]:
    """Attitude q_nb (4,) and velocity (3,) in NED, m/s."""
    speed = 30.0 + 3.0 * np.sin(0.5 * t)
    course = 0.8 + 0.12 * t + 0.35 * np.sin(0.6 * t)
    climb = 0.10 + 0.08 * np.sin(0.7 * t)
    shake = 2.0 * np.pi * 1.5 * t
    q = att.euler_to_quat(
        0.3 * np.sin(0.6 * t) + 0.05 * np.sin(shake), climb + 0.03 * np.cos(shake), course + 0.01 * np.sin(t)
    )
    v = speed * np.array([np.cos(climb) * np.cos(course), np.cos(climb) * np.sin(course), -np.sin(climb)])
    return q, v


def fly(lat: float, lon: float, h: float) -> Truth:
    """Truth: what the error-free step makes of increments that follow `motion`."""
    q, v = motion(0.0)
    states = [NavState(lat, lon, h, v, q)]
    dtheta, dvel = np.zeros((STEPS + 1, 3)), np.zeros((STEPS + 1, 3))
    before = None
    for k in range(STEPS):
        s = states[-1]
        (q0, v0), (q1, v1) = motion(k * DT), motion((k + 1) * DT)
        w_ie, w_en = earth.earth_rate_n(s.lat), earth.transport_rate_n(s.lat, s.h, v0)
        turn = att.quat_mul(att.exp_quat((w_ie + w_en) * DT), q1)
        dth = att.log_quat(att.quat_mul(att.quat_inv(q0), turn))
        dv_n = v1 - v0 - DT * (earth.gravity_n(s.lat, s.h) - np.cross(2.0 * w_ie + w_en, v0))
        dv = att.quat_to_dcm(q0).T @ dv_n - 0.5 * np.cross(dth, att.quat_to_dcm(q0).T @ dv_n)
        alpha, u = coning_sculling(dth, dv, DT, before)
        before = (dth, dv, DT)
        states.append(step(s, alpha, u, DT)[0])
        dtheta[k + 1], dvel[k + 1] = dth, dv
    return Truth(states, dtheta, dvel)


def perturbed(s: NavState, phi: Array, dv: Array, dp: Array) -> NavState:
    """Estimate that is off the true state by phi (rad), dv (m/s) and dp (m), each (3,)."""
    rm, rn = earth.radii(s.lat)
    return NavState(
        s.lat + dp[0] / (rm + s.h),
        earth.wrap(s.lon + dp[1] / ((rn + s.h) * np.cos(s.lat))),
        s.h - dp[2],
        s.v + dv,
        att.quat_mul(att.exp_quat(-phi), s.q),
    )


def antenna(truth: Truth, k: int, lever: Array) -> tuple[Array, Array]:
    """True antenna position (rad, rad, m) and velocity (3,) at step k."""
    s = truth.states[k]
    rm, rn = earth.radii(s.lat)
    c = att.quat_to_dcm(s.q)
    arm = c @ lever
    w = truth.dtheta[k] / DT
    pos = [s.lat + arm[0] / (rm + s.h), s.lon + arm[1] / ((rn + s.h) * np.cos(s.lat)), s.h - arm[2]]
    pos[1] = earth.wrap(pos[1])
    return np.array(pos), s.v + c @ np.cross(w, lever) - np.cross(earth.earth_rate_n(s.lat), arm)


def sensors(truth: Truth, rng: np.random.Generator, **errors: Any) -> tuple[Array, Array]:
    """Measured increments, (1001, 3) each: matrix, bias, noise, rounding to 1e-11 rad and 1e-9 m/s."""
    out = []
    for name, true, digits in (("gyro", truth.dtheta, 11), ("accel", truth.dvel, 9)):
        matrix = np.eye(3) + np.array(errors[f"{name}_matrix"])
        noise = np.sqrt(errors[f"{name}_psd"] * DT) * rng.standard_normal(true.shape)
        measured = true @ matrix.T + np.array(errors[f"{name}_bias"]) * DT + noise
        measured[0] = 0.0
        out.append(np.round(measured, digits))
    return out[0], out[1]


def fixes(
    truth: Truth, rng: np.random.Generator, lever: Array, var: Array, offset: Array
) -> tuple[Array, Array]:
    """GNSS position and velocity, (10, 3) each, with the covariance var (6, 6) and an offset (6,)."""
    pos, vel = [], []
    root = np.linalg.cholesky(var)
    for k in GNSS_STEPS:
        p, v = antenna(truth, k, lever)
        e = root @ rng.standard_normal(6) + offset
        rm, rn = earth.radii(p[0])
        pos.append(
            [
                p[0] + e[0] / (rm + p[2]),
                earth.wrap(p[1] + e[1] / ((rn + p[2]) * np.cos(p[0]))),
                p[2] - e[2],
            ]
        )
        vel.append(v + e[3:])
    return np.array(pos), np.array(vel)
