"""Central differences of the equations of motion in extended precision."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import attitude as att
from . import earth, strapdown

Array = NDArray[Any]
LD = np.longdouble
EPS = float(np.finfo(LD).eps)
STEP = np.array([1e-6] * 3 + [1e-3] * 3 + [10.0] * 3 + [1e-6] * 3 + [1e-3] * 3)


def near(got: Array, want: Array, noise: Array, rel: float = 1e-8) -> None:
    """Every element within rel of itself, or below the rounding and truncation noise of the differences."""
    bad = np.abs(got - want) > rel * np.abs(want) + noise
    assert not bad.any(), f"{np.argwhere(bad)[:5]}: {got[bad][:5]} against {want[bad][:5]}"


def noise_of(row_scale: list[float]) -> Array:
    """Rounding and truncation noise (9, 15) of the differences, for rows phi', dv', dp' of a given size."""
    noise = 100.0 * EPS * np.repeat(row_scale, 3)[:, None] / STEP[None, :]
    noise[:, :3] += 20.0 * STEP[0] ** 2
    return noise


def vee_skew(d: Array) -> Array:
    """Vector (3,) of the skew part of a matrix."""
    return np.array([d[2, 1] - d[1, 2], d[0, 2] - d[2, 0], d[1, 0] - d[0, 1]]) / 2.0


def ned_error_rates(e: Array, lat: Any, h: Any, v: Array, c: Array, w_ib_b: Array, f_b: Array) -> Array:
    """Rate (9,) of [phi, dv, dp] for an estimate off by e (15,): navigation, gyro, accelerometer."""
    rm, rn = earth.radii(lat)
    m, n = rm + h, rn + h
    c_est = att.exp_dcm(-e[:3]) @ c
    d_lat, d_lon, d_h = e[6] / m, e[7] / (n * np.cos(lat)), -e[8]
    true = strapdown.rates_ned(lat, h, v, c, w_ib_b.astype(LD), f_b.astype(LD))
    est = strapdown.rates_ned(lat + d_lat, h + d_h, v + e[3:6], c_est, w_ib_b + e[9:12], f_b + e[12:15])
    phi_dot = -vee_skew(est[4] @ c.T + c_est @ true[4].T)
    # dp = [M dL, N cosL dlon, -dh]: M and N cosL move with the vehicle
    s = LD(1e-6)
    (rm_a, rn_a), (rm_b, rn_b) = earth.radii(lat - s), earth.radii(lat + s)
    m_dot = (rm_b - rm_a) / (2 * s) * true[0] + true[2]
    n_dot = (rn_b - rn_a) / (2 * s) * true[0] + true[2]
    ncos_dot = n_dot * np.cos(lat) - n * np.sin(lat) * true[0]
    dp_dot = np.array(
        [
            m_dot * d_lat + m * (est[0] - true[0]),
            ncos_dot * d_lon + n * np.cos(lat) * (est[1] - true[1]),
            -(est[2] - true[2]),
        ]
    )
    return np.concatenate([phi_dot, est[3] - true[3], dp_dot])


def ecef_error_rates(e: Array, r: Array, v: Array, c: Array, w_ib_b: Array, f_b: Array) -> Array:
    """The same (9,) in ECEF axes."""
    c_est = att.exp_dcm(-e[:3]) @ c
    true = strapdown.rates_ecef(r, v, c, w_ib_b.astype(LD), f_b.astype(LD))
    est = strapdown.rates_ecef(r + e[6:9], v + e[3:6], c_est, w_ib_b + e[9:12], f_b + e[12:15])
    phi_dot = -vee_skew(est[2] @ c.T + c_est @ true[2].T)
    return np.concatenate([phi_dot, est[1] - true[1], est[0] - true[0]])


def differences(fun: Any) -> Array:
    """Central differences (9, 15)."""
    columns = []
    for i, s in enumerate(STEP):
        e = np.zeros(15, LD)
        e[i] = s
        columns.append((fun(e) - fun(-e)) / (2 * LD(s)))
    return np.column_stack(columns)
