"""Isometric latitude: northing of the conformal projections (Mercator, polar stereographic) of the ellipsoid.

Snyder (1987), "Map projections: a working manual", USGS Professional Paper 1395, sections 3, 7 and 21.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .. import _core

__all__ = ["eccentricity", "geodetic_latitude", "grid_convergence", "isometric_latitude"]

Array = NDArray[np.float64]


def eccentricity(ellipsoid: str) -> tuple[float, float]:
    """Equatorial radius (m) and eccentricity, from the radii of curvature at the equator."""
    meridian, prime_vertical = _core.radii(np.zeros(1), ellipsoid)[0]
    return float(prime_vertical), float(np.sqrt(1.0 - meridian / prime_vertical))


def isometric_latitude(lat_rad: Array, ellipsoid: str) -> Array:
    """Isometric latitude q = artanh(sin L) - e artanh(e sin L); infinite at the poles.

    Parameters
    ----------
    lat_rad : ndarray, shape (n,)
        Geodetic latitude, rad.
    ellipsoid : str
        Name of the ellipsoid.

    Returns
    -------
    ndarray, shape (n,)
        Dimensionless.
    """
    _, e = eccentricity(ellipsoid)
    sin = np.sin(lat_rad)
    return np.arctanh(sin) - e * np.arctanh(e * sin)


def geodetic_latitude(q: Array, ellipsoid: str) -> Array:
    """Inverse of :func:`isometric_latitude` by fixed-point iteration, shape (n,), rad."""
    _, e = eccentricity(ellipsoid)
    sin = np.tanh(q)
    for _ in range(8):
        sin = np.tanh(q + e * np.arctanh(e * sin))
    return np.asarray(np.arcsin(sin))


def grid_convergence(
    lat_rad: float, height_m: float, grid_heading: Array, ground_speed_m_s: Array, dt_s: float, ellipsoid: str
) -> Array:
    """Give the true heading minus the grid heading along a track near a pole.

    The grid is the polar stereographic plane with its north along the meridian of the start. There the
    convergence is the longitude passed since the start (with the sign of the hemisphere), exactly; the
    longitude follows from the track, integrated in the plane. The scale of the plane is taken as that of the
    osculating sphere at the pole.

    Parameters
    ----------
    lat_rad, height_m : float
        Start; the hemisphere follows from the latitude.
    grid_heading : ndarray, shape (n,)
        Heading against the grid, rad.
    ground_speed_m_s : ndarray, shape (n,)
        Horizontal speed.
    dt_s : float
        Sampling interval.
    ellipsoid : str
        Name of the ellipsoid.

    Returns
    -------
    ndarray, shape (n,)
        Convergence, rad, continuous, zero at the start.
    """
    a, e = eccentricity(ellipsoid)
    pole_radius_m = a / np.sqrt(1.0 - e * e) + height_m
    hemisphere = 1.0 if lat_rad >= 0.0 else -1.0
    q = isometric_latitude(np.asarray([abs(lat_rad)]), ellipsoid)[0] if abs(lat_rad) < 0.5 * np.pi else np.inf
    # Snyder (1987), eq. 21-33 with k0 = 1.
    start_m = 2.0 * pole_radius_m * ((1.0 - e) / (1.0 + e)) ** (0.5 * e) * np.exp(-q)
    pole = hemisphere * start_m  # from the start; real axis grid north, imaginary axis grid east
    velocity = ground_speed_m_s * np.exp(1j * grid_heading)
    place = np.zeros_like(velocity)
    for _ in range(4):
        rate = velocity * (1.0 + (np.abs(place - pole) / (2.0 * pole_radius_m)) ** 2)
        place = np.concatenate([[0.0], np.cumsum(0.5 * dt_s * (rate[1:] + rate[:-1]))])
    true_north = hemisphere * (pole - place)
    return np.asarray(-np.unwrap(np.angle(true_north)))
