"""Inertial navigation in north-east-down: the discrete step, its inputs, and the continuous equations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import attitude as att
from . import earth
from .earth import WGS84, Ellipsoid

Array = NDArray[Any]


@dataclass
class NavState:
    """Geodetic position (rad, rad, m), velocity in n (3,), m/s, attitude q_nb (4,)."""

    lat: Any
    lon: Any
    h: Any
    v: Array
    q: Array


@dataclass
class Midpoint:
    """What the error model needs of one step: middle of the interval."""

    lat: Any
    h: Any
    v: Array
    c: Array
    f_n: Array


def coning_sculling(
    dtheta: Array, dvel: Array, dt: Any, previous: tuple[Array, Array, Any] | None
) -> tuple[Array, Array]:
    """Rotation vector (3,) and velocity increment (3,) at the start attitude, two-sample form.

    Parameters
    ----------
    dtheta, dvel : (3,) arrays
        Increments of the interval (rad, m/s).
    dt : float
        Length of the interval (s).
    previous : tuple or None
        dtheta, dvel and dt of the interval before; None gives the one-sample form.

    Notes
    -----
    Exact for an angular rate and a specific force that are linear in time over both intervals, to the second
    order of small quantities; equal intervals give the factor 1/12 (Savage 1998, parts 1 and 2).
    """
    alpha, u = dtheta, dvel + 0.5 * np.cross(dtheta, dvel)
    if previous is not None:
        dth0, dv0, dt0 = previous
        k = dt**2 / (6.0 * dt0 * (dt0 + dt))
        alpha = alpha + k * np.cross(dth0, dtheta)
        u = u + k * (np.cross(dth0, dvel) + np.cross(dv0, dtheta))
    return alpha, u


def increments_of_rates(
    w0: Array, w1: Array, f0: Array, f1: Array, dt: Any
) -> tuple[Array, Array, Array, Array]:
    """Increments dtheta, dvel and compensated alpha, u (all (3,)) of point samples at the two ends."""
    dtheta, dvel = (w0 + w1) / 2.0 * dt, (f0 + f1) / 2.0 * dt
    alpha = dtheta + dt**2 / 12.0 * np.cross(w0, w1)
    u = dvel + 0.5 * np.cross(dtheta, dvel) + dt**2 / 12.0 * (np.cross(w0, f1) + np.cross(f0, w1))
    return dtheta, dvel, alpha, u


def step(
    s: NavState, alpha: Array, u: Array, dt: Any, ell: Ellipsoid = WGS84, gravity: str = "normal"
) -> tuple[NavState, Midpoint]:
    """One step: earth and gravity at the predicted middle, Coriolis at a predicted mid velocity."""
    c = att.quat_to_dcm(s.q)
    rm, _ = earth.radii(s.lat, ell)
    lat_m = s.lat + dt / 2.0 * s.v[0] / (rm + s.h)
    h_m = s.h - dt / 2.0 * s.v[2]
    rm_m, rn_m = earth.radii(lat_m, ell)
    w_ie = earth.earth_rate_n(lat_m, ell)
    g = earth.gravity_n(lat_m, h_m, ell, gravity)

    def drift(v: Array) -> Array:
        w_en = earth.transport_rate_n(lat_m, h_m, v, ell)
        return g - np.cross(2.0 * w_ie + w_en, v)

    v_pred = s.v + 0.5 * (c @ u + dt * drift(s.v))
    w_in = w_ie + earth.transport_rate_n(lat_m, h_m, v_pred, ell)
    turn = np.eye(3) - dt / 2.0 * att.skew(w_in)
    v1 = s.v + turn @ c @ u + dt * drift(v_pred)
    v_mean = (s.v + v1) / 2.0
    w_in2 = w_ie + earth.transport_rate_n(lat_m, h_m, v_mean, ell)
    q1 = att.quat_mul(att.exp_quat(-w_in2 * dt), att.quat_mul(s.q, att.exp_quat(alpha)))
    q1 = q1 / np.sqrt(q1 @ q1)
    after = NavState(
        s.lat + dt * v_mean[0] / (rm_m + h_m),
        earth.wrap(s.lon + dt * v_mean[1] / ((rn_m + h_m) * np.cos(lat_m))),
        s.h - dt * v_mean[2],
        v1,
        q1,
    )
    c_mid = (c + att.quat_to_dcm(q1)) / 2.0
    return after, Midpoint(lat_m, h_m, v_mean, c_mid, turn @ c @ u / dt)


def rates_ned(
    lat: Any,
    h: Any,
    v: Array,
    c: Array,
    w_ib_b: Array,
    f_b: Array,
    ell: Ellipsoid = WGS84,
    gravity: str = "normal",
) -> tuple[Any, Any, Any, Array, Array]:
    """Continuous equations: rates of latitude, longitude, height, v_n (3,) and C_nb (3, 3).

    Groves (2013), eqs. 5.39, 5.53 and 5.56.
    """
    rm, rn = earth.radii(lat, ell)
    w_ie = earth.earth_rate_n(lat, ell)
    w_en = earth.transport_rate_n(lat, h, v, ell)
    v_dot = c @ f_b + earth.gravity_n(lat, h, ell, gravity) - np.cross(2.0 * w_ie + w_en, v)
    c_dot = c @ att.skew(w_ib_b) - att.skew(w_ie + w_en) @ c
    return v[0] / (rm + h), v[1] / ((rn + h) * np.cos(lat)), -v[2], v_dot, c_dot


def rates_ecef(
    r_e: Array,
    v_e: Array,
    c_eb: Array,
    w_ib_b: Array,
    f_b: Array,
    ell: Ellipsoid = WGS84,
    gravity: str = "normal",
) -> tuple[Array, Array, Array]:
    """Continuous equations in ECEF: rates of r_e (3,), v_eb_e (3,), C_eb (3, 3).

    Groves (2013), section 5.3.
    """
    lat, lon, h = earth.ecef_to_lla(r_e, ell)
    w_ie = np.array([0.0, 0.0, ell.omega])
    g_e = earth.c_en(lat, lon) @ earth.gravity_n(lat, h, ell, gravity)
    v_dot = c_eb @ f_b + g_e - 2.0 * np.cross(w_ie, v_e)
    return v_e, v_dot, c_eb @ att.skew(w_ib_b) - att.skew(w_ie) @ c_eb


def step_spec(s: NavState, dtheta: Array, dvel: Array, dt: Any, ell: Ellipsoid = WGS84) -> NavState:
    """The plain step of the published filter: Coriolis and gravity at the start, no half rotation of n."""
    c = att.quat_to_dcm(s.q)
    v1 = s.v + c @ (dvel + 0.5 * np.cross(dtheta, dvel)) + dt * _drift_start(s, ell)
    v_mean = (s.v + v1) / 2.0
    rm, rn = earth.radii(s.lat, ell)
    w_in = earth.earth_rate_n(s.lat, ell) + earth.transport_rate_n(s.lat, s.h, v_mean, ell)
    q1 = att.quat_mul(att.exp_quat(-w_in * dt), att.quat_mul(s.q, att.exp_quat(dtheta)))
    return NavState(
        s.lat + dt * v_mean[0] / (rm + s.h),
        s.lon + dt * v_mean[1] / ((rn + s.h) * np.cos(s.lat)),
        s.h - dt * v_mean[2],
        v1,
        q1 / np.sqrt(q1 @ q1),
    )


def invert_step_spec(
    s: NavState, v1: Array, q1: Array, dt: Any, ell: Ellipsoid = WGS84
) -> tuple[Array, Array]:
    """Increments dtheta (3,), dvel (3,) that make `step_spec` lead from a state to v1 (3,) and q1 (4,)."""
    v_mean = (s.v + v1) / 2.0
    w_in = earth.earth_rate_n(s.lat, ell) + earth.transport_rate_n(s.lat, s.h, v_mean, ell)
    turn = att.quat_mul(att.quat_inv(s.q), att.quat_mul(att.exp_quat(w_in * dt), q1))
    dtheta = att.log_quat(turn)
    c = att.quat_to_dcm(s.q)
    dv_n = v1 - s.v - dt * _drift_start(s, ell)
    return dtheta, np.linalg.solve(np.eye(3) + 0.5 * att.skew(dtheta), c.T @ dv_n)


def _drift_start(s: NavState, ell: Ellipsoid) -> Array:
    w = 2.0 * earth.earth_rate_n(s.lat, ell) + earth.transport_rate_n(s.lat, s.h, s.v, ell)
    return earth.gravity_n(s.lat, s.h, ell, "vertical") - np.cross(w, s.v)
