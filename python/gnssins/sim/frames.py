"""Axes and Earth rate that the simulation of aids needs beside the vectorised functions of the core."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .. import _core

__all__ = ["EARTH_RATE_RAD_S", "c_en", "displaced"]

Array = NDArray[np.float64]

#: Angular velocity of the Earth (rad/s): NIMA TR8350.2 (2000), table 3.1.
EARTH_RATE_RAD_S = 7.292115e-5


def c_en(lla: Array) -> Array:
    """Rotation matrices from north-east-down to ECEF axes.

    Groves (2013), eq. 2.150, transposed.

    Parameters
    ----------
    lla : ndarray, shape (n, 3)
        Latitude, longitude (rad); the height plays no part.

    Returns
    -------
    ndarray, shape (n, 3, 3)
    """
    sin_lat, cos_lat = np.sin(lla[:, 0]), np.cos(lla[:, 0])
    sin_lon, cos_lon = np.sin(lla[:, 1]), np.cos(lla[:, 1])
    zero = np.zeros_like(sin_lat)
    north = np.stack([-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat], axis=-1)
    east = np.stack([-sin_lon, cos_lon, zero], axis=-1)
    down = np.stack([-cos_lat * cos_lon, -cos_lat * sin_lon, -sin_lat], axis=-1)
    return np.stack([north, east, down], axis=-1)


def displaced(lla: Array, ned_m: Array, ellipsoid: str) -> Array:
    """Move positions by small distances along north, east and down.

    The distances are laid off in ECEF axes, so that this holds at the poles too.

    Parameters
    ----------
    lla : ndarray, shape (n, 3)
        Latitude, longitude (rad), height (m).
    ned_m : ndarray, shape (n, 3)
        Displacements (m).
    ellipsoid : str
        Name of the ellipsoid.

    Returns
    -------
    ndarray, shape (n, 3)
        Latitude, longitude (rad), height (m).
    """
    step = np.einsum("nij,nj->ni", c_en(lla), ned_m)
    return np.asarray(_core.ecef_to_lla(_core.lla_to_ecef(lla, ellipsoid) + step, ellipsoid))
