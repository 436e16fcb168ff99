"""Analytic track: latitude, longitude and height in closed form, and all that follows from them.

Novik (2011), trajectory generator: each coordinate is a constant, a linear and a harmonic term. Velocity, its
derivative, the specific force and the attitude follow without numerical differentiation, so the functions here
are also a standard to test mechanisations against.

The publication has the axes east, north, up; here they are north, east, down. It takes gravity as
``(mu/a^2)(1 - 2 h/a + 0.75 e^2 sin^2 lat)``, which leaves out the centrifugal and the flattening terms and is
1.8 mg off; here gravity is that of the engine. Its units of the angular terms are not printed: they are rad and
rad/s (in degrees the aircraft would fly at 2.6 m/s).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from .conformal import eccentricity
from .frames import EARTH_RATE_RAD_S
from .motion_config import Analytic, AngleTerms, HeightTerms

__all__ = ["AnalyticMotion", "evaluate"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AnalyticMotion:
    """The track and its derived quantities at n times.

    Attributes
    ----------
    t_s : ndarray, shape (n,)
        Times since the start, s.
    lla, lla_rate, lla_accel : ndarray, shape (n, 3)
        Latitude, longitude (rad), height above the ellipsoid (m), and their first and second derivatives.
    radii_m, radii_rate_m_s : ndarray, shape (n, 2)
        Radii of curvature of meridian and prime vertical (m), without the height, and their derivatives (m/s).
    v_n, v_dot_n : ndarray, shape (n, 3)
        Velocity along north, east, down (m/s), and the derivatives of its components (m/s^2).
    f_n : ndarray, shape (n, 3)
        Specific force along north, east, down (m/s^2): what error-free accelerometers feel.
    rpy : ndarray, shape (n, 3)
        Roll, pitch, heading (rad): heading and pitch along the velocity, roll by the bank gain.
    """

    t_s: Array
    lla: Array
    lla_rate: Array
    lla_accel: Array
    radii_m: Array
    radii_rate_m_s: Array
    v_n: Array
    v_dot_n: Array
    f_n: Array
    rpy: Array

    @property
    def ground_speed_m_s(self) -> Array:
        """Horizontal speed, m/s, shape (n,)."""
        return np.hypot(self.v_n[:, 0], self.v_n[:, 1])


def evaluate(
    analytic: Analytic,
    lla0: ArrayLike,
    t_s: ArrayLike,
    *,
    ellipsoid: str = "wgs84",
    gravity: str = "normal",
) -> AnalyticMotion:
    """Evaluate an analytic track in closed form.

    With s, c the sine and cosine of the latitude, R_M and R_P the radii of curvature and u the rate of the Earth:

    * ``V_N = lat' (R_M + h)``, ``V_E = lon' (R_P + h) c``, ``V_h = h'``;
    * ``R_P' = a e^2 s c lat' / (1 - e^2 s^2)^1.5``,
      ``R_M' = R_P' (1 - e^2)/(1 - e^2 s^2) + 2 R_P (1 - e^2) e^2 s c lat' / (1 - e^2 s^2)^2``;
    * ``V_N' = lat'' (R_M + h) + lat' (R_M' + V_h)``,
      ``V_E' = lon'' (R_P + h) c + lon' (R_P' + V_h) c - lon' (R_P + h) s lat'``, ``V_h' = h''``;
    * ``a_N = V_N' + q s V_E + lat' V_h - g_N``, ``a_E = V_E' - q s V_N + q c V_h``,
      ``a_h = V_h' - q c V_E - lat' V_N + g`` with ``q = lon' + 2 u``;
    * pitch ``atan2(V_h, V_r)``, heading ``atan2(V_E, V_N)``,
      roll ``K (V_N V_E' - V_E V_N') / (V_r cos pitch)`` with ``V_r = hypot(V_N, V_E)``.

    Novik (2011), trajectory section; the derivative of R_M is checked against finite differences.

    Parameters
    ----------
    analytic : Analytic
        Linear and harmonic terms, and the bank gain K.
    lla0 : array_like, shape (3,)
        Constant terms: latitude, longitude (rad), height (m).
    t_s : array_like, shape (n,)
        Times since the start, s.
    ellipsoid : str, optional
        Name of the ellipsoid.
    gravity : {"normal", "vertical"}, optional
        With or without the north component of gravity.

    Returns
    -------
    AnalyticMotion
        Heading and roll mean nothing where the ground speed is zero.
    """
    t = np.atleast_1d(np.asarray(t_s, dtype=np.float64))
    lat0, lon0, height0 = np.asarray(lla0, dtype=np.float64)
    lat, lon = _angle(analytic.lat, lat0, t), _angle(analytic.lon, lon0, t)
    height = _height(analytic.height, height0, t)
    lla, rate, accel = (np.column_stack(parts) for parts in zip(lat, lon, height, strict=True))
    a, e = eccentricity(ellipsoid)
    e2, s, c = e * e, np.sin(lla[:, 0]), np.cos(lla[:, 0])
    root = 1.0 - e2 * s * s
    r_m, r_p = _core.radii(np.ascontiguousarray(lla[:, 0]), ellipsoid).T
    r_p_rate = a * e2 * s * c * rate[:, 0] / root**1.5
    r_m_rate = r_p_rate * (1.0 - e2) / root + 2.0 * r_p * (1.0 - e2) * e2 * s * c * rate[:, 0] / root**2
    h, climb = lla[:, 2], rate[:, 2]
    v_n = rate[:, 0] * (r_m + h)
    v_e = rate[:, 1] * (r_p + h) * c
    v_n_dot = accel[:, 0] * (r_m + h) + rate[:, 0] * (r_m_rate + climb)
    v_e_dot = (
        accel[:, 1] * (r_p + h) * c
        + rate[:, 1] * (r_p_rate + climb) * c
        - rate[:, 1] * (r_p + h) * s * rate[:, 0]
    )
    q = rate[:, 1] + 2.0 * EARTH_RATE_RAD_S
    g_n = _core.gravity_n(np.ascontiguousarray(lla[:, 0]), np.ascontiguousarray(h), ellipsoid, gravity)
    f_north = v_n_dot + q * s * v_e + rate[:, 0] * climb - g_n[:, 0]
    f_east = v_e_dot - q * s * v_n + q * c * climb
    f_up = accel[:, 2] - q * c * v_e - rate[:, 0] * v_n + g_n[:, 2]
    return AnalyticMotion(
        t_s=t,
        lla=lla,
        lla_rate=rate,
        lla_accel=accel,
        radii_m=np.column_stack([r_m, r_p]),
        radii_rate_m_s=np.column_stack([r_m_rate, r_p_rate]),
        v_n=np.column_stack([v_n, v_e, -climb]),
        v_dot_n=np.column_stack([v_n_dot, v_e_dot, -accel[:, 2]]),
        f_n=np.column_stack([f_north, f_east, -f_up]),
        rpy=_attitude(v_n, v_e, climb, v_n_dot, v_e_dot, analytic.bank_gain_rad_s2_m),
    )


def _attitude(v_n: Array, v_e: Array, climb: Array, v_n_dot: Array, v_e_dot: Array, gain: float) -> Array:
    """Roll, pitch and heading along the velocity; no roll where there is no ground speed."""
    ground = np.hypot(v_n, v_e)
    pitch = np.arctan2(climb, ground)
    along = ground * np.cos(pitch)
    across = v_n * v_e_dot - v_e * v_n_dot
    roll = gain * np.divide(across, along, out=np.zeros_like(along), where=along > 0.0)
    return np.column_stack([roll, pitch, np.arctan2(v_e, v_n)])


def _angle(terms: AngleTerms, angle0: float, t: Array) -> tuple[Array, Array, Array]:
    """Latitude or longitude with its first and second derivative."""
    w = 2.0 * np.pi / terms.period_s
    x, d = w * t + terms.phase_rad, terms.amplitude_rad
    return (
        angle0 + terms.rate_rad_s * t + d * np.sin(x),
        terms.rate_rad_s + d * w * np.cos(x),
        -d * w * w * np.sin(x),
    )


def _height(terms: HeightTerms, height0: float, t: Array) -> tuple[Array, Array, Array]:
    """Height with its first and second derivative."""
    w = 2.0 * np.pi / terms.period_s
    x, d = w * t + terms.phase_rad, terms.amplitude_m
    return (
        height0 + terms.rate_m_s * t - d * np.cos(x),
        terms.rate_m_s + d * w * np.sin(x),
        d * w * w * np.cos(x),
    )
