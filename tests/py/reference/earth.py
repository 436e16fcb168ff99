"""Ellipsoid, radii of curvature, normal gravity and the rates of the local-level frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass(frozen=True)
class Ellipsoid:
    """Level ellipsoid.

    Attributes
    ----------
    a : float
        Semi-major axis (m).
    f : float
        Flattening.
    omega : float
        Earth rate (rad/s).
    gamma_e : float
        Normal gravity on the equator (m/s^2).
    gamma_p : float
        Normal gravity at the poles (m/s^2).
    m : float
        omega^2 a^2 b / GM.
    """

    a: float
    f: float
    omega: float
    gamma_e: float
    gamma_p: float
    m: float

    @property
    def e2(self) -> float:
        """First eccentricity squared."""
        return self.f * (2.0 - self.f)

    @property
    def k(self) -> float:
        """Somigliana constant b gamma_p / (a gamma_e) - 1."""
        return (1.0 - self.f) * self.gamma_p / self.gamma_e - 1.0


WGS84 = Ellipsoid(
    a=6378137.0,
    f=1.0 / 298.257223563,
    omega=7.292115e-5,
    gamma_e=9.7803253359,
    gamma_p=9.8321849379,
    m=0.00344978650684,
)
"""World Geodetic System 1984 (NGA.STND.0036, 2014; the polar value rounds 9.83218493786)."""


def radii(lat: Any, ell: Ellipsoid = WGS84) -> tuple[Any, Any]:
    """Meridian and prime-vertical radii of curvature (m) at a latitude (rad)."""
    d = 1.0 - ell.e2 * np.sin(lat) ** 2
    return ell.a * (1.0 - ell.e2) / d**1.5, ell.a / d**0.5


def radii_slopes(lat: Any, ell: Ellipsoid = WGS84) -> tuple[Any, Any]:
    """Derivatives of the two radii with latitude (m/rad)."""
    d = 1.0 - ell.e2 * np.sin(lat) ** 2
    rm, rn = radii(lat, ell)
    sc = ell.e2 * np.sin(lat) * np.cos(lat)
    return 3.0 * rm * sc / d, rn * sc / d


def _gamma_0(lat: Any, ell: Ellipsoid) -> tuple[Any, Any, Any]:
    """Somigliana gravity on the ellipsoid (m/s^2) and its first and second latitude derivative."""
    s2 = np.sin(lat) ** 2
    d = 1.0 - ell.e2 * s2
    value = ell.gamma_e * (1.0 + ell.k * s2) / np.sqrt(d)
    by_s2 = ell.gamma_e * (ell.k / d**0.5 + (1.0 + ell.k * s2) * ell.e2 / (2.0 * d**1.5))
    by_s2_s2 = ell.gamma_e * (ell.k * ell.e2 / d**1.5 + 0.75 * (1.0 + ell.k * s2) * ell.e2**2 / d**2.5)
    first = by_s2 * np.sin(2.0 * lat)
    return value, first, by_s2_s2 * np.sin(2.0 * lat) ** 2 + 2.0 * by_s2 * np.cos(2.0 * lat)


def _height_factor(lat: Any, ell: Ellipsoid) -> tuple[Any, Any, Any]:
    """Linear coefficient c of the height expansion (1/m) and its first and second latitude derivative."""
    c = 2.0 / ell.a * (1.0 + ell.f + ell.m - 2.0 * ell.f * np.sin(lat) ** 2)
    return c, -4.0 * ell.f / ell.a * np.sin(2.0 * lat), -8.0 * ell.f / ell.a * np.cos(2.0 * lat)


def gravity_n(lat: Any, h: Any, ell: Ellipsoid = WGS84, kind: str = "normal") -> Array:
    """Normal gravity in north-east-down axes (3,), m/s^2.

    Somigliana's value gamma with the height expansion to second order (TR8350.2, eq. 4-3),

        g_D = gamma (1 - c h + 3 h^2 / a^2),

    and, for ``normal``, the one north component that makes the field free of curl and vanishes on the
    ellipsoid, ``(R_M + h) g_N = -d/dL (integral of g_D from 0 to h)``. ``vertical`` leaves it out.
    """
    g0, _, _ = _gamma_0(lat, ell)
    c, _, _ = _height_factor(lat, ell)
    rm, _ = radii(lat, ell)
    north = -_work_slopes(lat, h, ell)[0] / (rm + h) if kind == "normal" else 0.0 * h
    return np.array([north, 0.0 * h, g0 * (1.0 - c * h + 3.0 * h**2 / ell.a**2)])


def _work_slopes(lat: Any, h: Any, ell: Ellipsoid) -> tuple[Any, Any]:
    """First and second latitude derivative of the integral of g_D from 0 to h."""
    g0, g1, g2 = _gamma_0(lat, ell)
    c0, c1, c2 = _height_factor(lat, ell)
    cube = h + h**3 / ell.a**2
    first = g1 * cube - (g1 * c0 + g0 * c1) * h**2 / 2.0
    return first, g2 * cube - (g2 * c0 + 2.0 * g1 * c1 + g0 * c2) * h**2 / 2.0


def gravity_slopes(lat: Any, h: Any, ell: Ellipsoid = WGS84, kind: str = "normal") -> tuple[Array, Array]:
    """Derivatives of `gravity_n` with latitude (3,), m/s^2/rad, and with height (3,), 1/s^2."""
    g0, g1, _ = _gamma_0(lat, ell)
    c0, c1, _ = _height_factor(lat, ell)
    square = 3.0 * h**2 / ell.a**2
    down_l = g1 * (1.0 - c0 * h + square) - g0 * c1 * h
    down_h = g0 * (-c0 + 6.0 * h / ell.a**2)
    zero = 0.0 * h
    north_l, north_h = zero, zero
    if kind == "normal":
        rm, _ = radii(lat, ell)
        rm_l, _ = radii_slopes(lat, ell)
        first, second = _work_slopes(lat, h, ell)
        m = rm + h
        north_l = -second / m + first * rm_l / m**2
        north_h = -down_l / m + first / m**2
    return np.array([north_l, zero, down_l]), np.array([north_h, zero, down_h])


def earth_rate_n(lat: Any, ell: Ellipsoid = WGS84) -> Array:
    """Earth rate in north-east-down axes (3,), rad/s."""
    return np.array([ell.omega * np.cos(lat), 0.0 * lat, -ell.omega * np.sin(lat)])


def transport_rate_n(lat: Any, h: Any, v_n: Array, ell: Ellipsoid = WGS84) -> Array:
    """Rate of n over the ellipsoid in north-east-down axes (3,), rad/s: Groves (2013), eq. 5.44."""
    rm, rn = radii(lat, ell)
    return np.array([v_n[1] / (rn + h), -v_n[0] / (rm + h), -v_n[1] * np.tan(lat) / (rn + h)])


def c_en(lat: Any, lon: Any) -> Array:
    """Rotation (3, 3) of north-east-down vectors to ECEF: Groves (2013), eq. 2.158."""
    sl, cl, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    return np.array([[-sl * co, -so, -cl * co], [-sl * so, co, -cl * so], [cl, 0.0 * lat, -sl]])


def lla_to_ecef(lat: Any, lon: Any, h: Any, ell: Ellipsoid = WGS84) -> Array:
    """ECEF position (3,), m, of geodetic coordinates (rad, rad, m)."""
    _, rn = radii(lat, ell)
    c = np.cos(lat)
    return np.array(
        [(rn + h) * c * np.cos(lon), (rn + h) * c * np.sin(lon), ((1.0 - ell.e2) * rn + h) * np.sin(lat)]
    )


def ecef_to_lla(r_e: Array, ell: Ellipsoid = WGS84) -> tuple[Any, Any, Any]:
    """Geodetic coordinates (rad, rad, m) by plain fixed-point iteration; not for the poles."""
    p = np.sqrt(r_e[0] ** 2 + r_e[1] ** 2)
    lat = np.arctan2(r_e[2], p * (1.0 - ell.e2))
    h = 0.0 * p
    for _ in range(30):
        _, rn = radii(lat, ell)
        h = p * np.cos(lat) + r_e[2] * np.sin(lat) - ell.a**2 / rn
        lat = np.arctan2(r_e[2] * (rn + h), p * (rn * (1.0 - ell.e2) + h))
    return lat, np.arctan2(r_e[1], r_e[0]), h


def wrap(angle: Any) -> Any:
    """Angle (rad) brought to [-pi, pi); one that is inside keeps its bits."""
    if np.all((angle >= -np.pi) & (angle < np.pi)):
        return angle
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
