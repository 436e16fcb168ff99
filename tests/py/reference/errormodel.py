"""Linear error dynamics and aiding Jacobians, dense, element by element from the equations of motion.

Order of the navigation errors: phi (rad), dv (m/s), dp (m), all estimate minus truth, in n (NED model) or e
(ECEF model) axes. With ``C_est = (I - [phi x]) C`` the equations of motion give

    phi' = -w_in x phi + dw_in - C dw_ib,      dv' = f x phi + C df + d(gravity + Coriolis),

where dw_ib and df are the errors of the corrected gyro and accelerometer (estimate minus truth).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import attitude as att
from . import earth
from .earth import WGS84, Ellipsoid

Array = NDArray[Any]

PHI, DV, DP = slice(0, 3), slice(3, 6), slice(6, 9)


def ned_f(lat: Any, h: Any, v: Array, f_n: Array, ell: Ellipsoid = WGS84, gravity: str = "normal") -> Array:
    """F (9, 9) of the NED model.

    Parameters
    ----------
    lat, h : float
        Latitude (rad) and ellipsoidal height (m).
    v, f_n : (3,) arrays
        Velocity (m/s) and specific force (m/s^2) in n.

    Notes
    -----
    dp = [M dL, N cosL dlon, -dh] with M = R_M + h and N = R_N + h. In dp' the slopes of the radii cancel
    by dR_N/dL = (R_N - R_M) tanL; they stay in the attitude and velocity rows.
    """
    rm, rn = earth.radii(lat, ell)
    rm_l, rn_l = earth.radii_slopes(lat, ell)
    m, n = rm + h, rn + h
    tan, sec2 = np.tan(lat), 1.0 / np.cos(lat) ** 2
    vn, ve, vd = v
    w_ie = earth.earth_rate_n(lat, ell)
    w_en = earth.transport_rate_n(lat, h, v, ell)
    z = lat * 0.0

    # d(w_en) by velocity, by latitude and by height
    w_en_v = np.array([[z, 1.0 / n, z], [-1.0 / m, z, z], [z, -tan / n, z]])
    w_en_l = np.array([-ve * rn_l / n**2, vn * rm_l / m**2, -ve * (sec2 / n - tan * rn_l / n**2)])
    w_en_h = np.array([-ve / n**2, vn / m**2, ve * tan / n**2])
    w_ie_l = ell.omega * np.array([-np.sin(lat), z, -np.cos(lat)])
    g_l, g_h = earth.gravity_slopes(lat, h, ell, gravity)

    # columns of latitude and height become columns of dp: dL = dp_N / M, dh = -dp_D
    def by_position(by_lat: Array, by_h: Array) -> Array:
        return np.column_stack([by_lat / m, by_lat * 0.0, -by_h])

    v_x = att.skew(v)
    f = np.zeros((9, 9), dtype=np.result_type(lat, v, f_n))
    f[PHI, PHI] = -att.skew(w_ie + w_en)
    f[PHI, DV] = w_en_v
    f[PHI, DP] = by_position(w_ie_l + w_en_l, w_en_h)
    f[DV, PHI] = att.skew(f_n)
    f[DV, DV] = -att.skew(2.0 * w_ie + w_en) + v_x @ w_en_v
    f[DV, DP] = by_position(v_x @ (2.0 * w_ie_l + w_en_l) + g_l, v_x @ w_en_h + g_h)
    f[DP, DV] = np.eye(3)
    f[DP, DP] = np.array([[-vd / m, z, vn / m], [ve * tan / n, -(vn * tan + vd) / n, ve / n], [z, z, z]])
    return f


def gravity_gradient_n(lat: Any, h: Any, ell: Ellipsoid = WGS84, gravity: str = "normal") -> Array:
    """Gradient (3, 3), 1/s^2, of the normal gravity vector by a displacement, both in n axes.

    The vector turns with n: a displacement turns n by [dp_E, -dp_N (N/M), -dp_E tanL] / N, to which
    the slopes of the components are added.
    """
    rm, rn = earth.radii(lat, ell)
    m, n = rm + h, rn + h
    g = earth.gravity_n(lat, h, ell, gravity)
    g_l, g_h = earth.gravity_slopes(lat, h, ell, gravity)
    z = lat * 0.0
    turn = np.array([[z, 1.0 / n, z], [-1.0 / m, z, z], [z, -np.tan(lat) / n, z]])
    return -att.skew(g) @ turn + np.column_stack([g_l / m, g_l * 0.0, -g_h])


def ecef_f(lat: Any, lon: Any, h: Any, f_e: Array, ell: Ellipsoid = WGS84, gravity: str = "normal") -> Array:
    """F (9, 9) of the ECEF model with specific force f_e (3,), m/s^2: Groves (2013), eq. 14.49."""
    c = earth.c_en(lat, lon)
    w_x = att.skew(np.array([lat * 0.0, lat * 0.0, lat * 0.0 + ell.omega]))
    f = np.zeros((9, 9), dtype=np.result_type(lat, f_e))
    f[PHI, PHI] = -w_x
    f[DV, PHI] = att.skew(f_e)
    f[DV, DV] = -2.0 * w_x
    f[DV, DP] = c @ gravity_gradient_n(lat, h, ell, gravity) @ c.T
    f[DP, DV] = np.eye(3)
    return f


def couplings(c: Array) -> tuple[Array, Array]:
    """Gyro and accelerometer couplings, both (9, 3), of the rotation c (3, 3) from b to the model's axes."""
    gyro, accel = np.zeros((9, 3), dtype=c.dtype), np.zeros((9, 3), dtype=c.dtype)
    gyro[PHI] = -c
    accel[DV] = c
    return gyro, accel


def aiding_ned(
    lat: Any, h: Any, c: Array, w_ib_b: Array, lever_b: Array, ell: Ellipsoid = WGS84
) -> dict[str, Array]:
    """Jacobians of predicted minus measured antenna position and velocity, NED rows and NED errors.

    Antenna: p + C l and v + C (w_ib x l) - w_ie x (C l).

    Returns
    -------
    dict
        ``position`` and ``velocity`` (3, 9); ``velocity_gyro`` (3, 3) by the gyro error;
        ``position_lever`` and ``velocity_lever`` (3, 3) by true minus estimated lever arm.
    """
    rm, _ = earth.radii(lat, ell)
    w_ie = earth.earth_rate_n(lat, ell)
    arm = c @ lever_b
    position, velocity = np.zeros((3, 9), dtype=c.dtype), np.zeros((3, 9), dtype=c.dtype)
    position[:, PHI] = att.skew(arm)
    position[:, DP] = np.eye(3)
    velocity[:, PHI] = att.skew(c @ np.cross(w_ib_b, lever_b)) - att.skew(w_ie) @ att.skew(arm)
    velocity[:, DV] = np.eye(3)
    # the Earth rate in n turns with latitude: 1e-11 per metre, kept for completeness
    w_ie_l = ell.omega * np.array([-np.sin(lat), 0.0, -np.cos(lat)])
    velocity[:, 6] = -np.cross(w_ie_l, arm) / (rm + h)
    return {
        "position": position,
        "velocity": velocity,
        "velocity_gyro": -c @ att.skew(lever_b),
        "position_lever": -c,
        "velocity_lever": -(c @ att.skew(w_ib_b) - att.skew(w_ie) @ c),
    }


def aiding_ecef(
    lat: Any, lon: Any, c_nb: Array, w_ib_b: Array, lever_b: Array, ell: Ellipsoid = WGS84
) -> dict[str, Array]:
    """Jacobians as `aiding_ned`: NED rows, errors of the ECEF model in ECEF axes.

    The rows are resolved in the axes n of the estimate, which are held fixed: their turn multiplies the
    residual and is of second order.
    """
    c_ne = earth.c_en(lat, lon).T
    arm = c_nb @ lever_b
    w_ie = earth.earth_rate_n(lat, ell)
    position, velocity = np.zeros((3, 9), dtype=c_nb.dtype), np.zeros((3, 9), dtype=c_nb.dtype)
    position[:, PHI] = att.skew(arm) @ c_ne
    position[:, DP] = c_ne
    turned = att.skew(c_nb @ np.cross(w_ib_b, lever_b)) - att.skew(w_ie) @ att.skew(arm)
    velocity[:, PHI] = turned @ c_ne
    velocity[:, DV] = c_ne
    return {
        "position": position,
        "velocity": velocity,
        "velocity_gyro": -c_nb @ att.skew(lever_b),
        "position_lever": -c_nb,
        "velocity_lever": -(c_nb @ att.skew(w_ib_b) - att.skew(w_ie) @ c_nb),
    }


def velocity_turn(lat: Any, lon: Any, h: Any, v: Array, ell: Ellipsoid = WGS84) -> Array:
    """Addition (3, 9) to the ECEF velocity row when n, in which the fix is given, is that of the estimate.

    A position error turns n by [dp_E/N, -dp_N/M, -dp_E tanL/N], which moves C_ne v_e by v_n x turn.
    """
    rm, rn = earth.radii(lat, ell)
    m, n = rm + h, rn + h
    z = lat * 0.0
    turn = np.array([[z, 1.0 / n, z], [-1.0 / m, z, z], [z, -np.tan(lat) / n, z]])
    out = np.zeros((3, 9), dtype=v.dtype)
    out[:, DP] = att.skew(v) @ turn @ earth.c_en(lat, lon).T
    return out
