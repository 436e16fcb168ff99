"""Sensor axes by letters or by matrix, as the rotation that takes sensor axes to forward-right-down."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .base import invalid

#: Unit vectors in forward-right-down axes; compass letters are the vehicle that looks north.
_LETTERS: dict[str, tuple[float, float, float]] = {
    "F": (1.0, 0.0, 0.0),
    "B": (-1.0, 0.0, 0.0),
    "R": (0.0, 1.0, 0.0),
    "L": (0.0, -1.0, 0.0),
    "D": (0.0, 0.0, 1.0),
    "U": (0.0, 0.0, -1.0),
}
_COMPASS = str.maketrans("NSEW", "FBRL")
_HINT = 'letters such as "FRD", "FLU", "RFU" (sensor x, y, z in this order), or a 3x3 rotation matrix'
TOLERANCE = 1e-6
"""Largest deviation of C C' from the identity that still counts as rounding."""


def axes_matrix(axes: str | Sequence[Sequence[float]]) -> NDArray[np.float64]:
    """Rotation from sensor axes to body axes forward-right-down.

    Parameters
    ----------
    axes : str or 3x3 sequence
        Letters of the directions in which sensor x, y, z point, or the matrix itself (v_frd = C v_sensor).
        ``"ENU"``, ``"NED"``, ``"NWU"`` and the like are read for a vehicle that looks north: ``"ENU"`` =
        ``"RFU"``.

    Returns
    -------
    ndarray, shape (3, 3)
        Proper rotation, columns = sensor axes in FRD.

    Raises
    ------
    pydantic_core.PydanticCustomError
        Not three different axes, left-handed (determinant -1) or not orthonormal to 1e-6.
        Inside the configuration this becomes a :class:`gnssins.errors.ConfigError`.
    """
    if isinstance(axes, str):
        return _from_letters(axes)
    try:
        matrix = np.array(axes, dtype=np.float64)
    except (TypeError, ValueError):
        raise invalid("config.axes", "is not a 3x3 matrix", _HINT) from None
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise invalid("config.axes", "is not a finite 3x3 matrix", _HINT)
    deviation = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if deviation > TOLERANCE:
        raise invalid(
            "config.axes",
            f"is not orthonormal: C C' differs from the identity by {deviation:.3g}, allowed {TOLERANCE:g}",
            "rows must be unit vectors at right angles; scale and misalignment belong to [imu.gyro] matrix "
            "and "
            "[imu.accel] matrix",
        )
    _refuse_left_handed(matrix)
    return matrix


def _from_letters(axes: str) -> NDArray[np.float64]:
    letters = axes.upper().translate(_COMPASS)
    if len(letters) != 3 or any(letter not in _LETTERS for letter in letters):
        raise invalid("config.axes", f'"{axes}" does not name three axes', _HINT)
    matrix = np.array([_LETTERS[letter] for letter in letters], dtype=np.float64).T
    if abs(abs(np.linalg.det(matrix)) - 1.0) > TOLERANCE:
        raise invalid("config.axes", f'"{axes}" names one direction twice', _HINT)
    _refuse_left_handed(matrix)
    return matrix


def _refuse_left_handed(matrix: NDArray[np.float64]) -> None:
    if np.linalg.det(matrix) < 0.0:
        raise invalid(
            "config.axes",
            "is left-handed (determinant -1): a mirror, not a rotation",
            "one axis has the wrong sign, or two are swapped; x cross y must give z",
        )


def proper_letters() -> list[str]:
    """All 24 right-handed letter triples, ``"FRD"`` first."""
    found = []
    for x in "FBRLUD":
        for y in "FBRLUD":
            for z in "FBRLUD":
                matrix = np.array([_LETTERS[k] for k in (x, y, z)])
                if np.linalg.det(matrix) > 0.5:
                    found.append(x + y + z)
    found.sort(key=lambda name: name != "FRD")
    return found
