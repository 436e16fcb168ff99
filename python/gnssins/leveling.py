"""Roll and pitch from the accelerometer: small vectorised steps that :mod:`gnssins.alignment` puts together."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.errors import DataQualityError, InputError
from gnssins.units import NS_PER_S

if TYPE_CHECKING:
    from gnssins.dataset import ImuTable

__all__ = [
    "calibration",
    "corrected",
    "earth_rate_n",
    "level",
    "leveling_sd",
    "mean_specific_force",
    "phi_sd",
    "refuse_no_gravity",
]

Array = NDArray[np.float64]

#: Earth rotation rate, rad/s (WGS-84); here only for the Coriolis share of the specific force.
EARTH_RATE_RAD_S: Final = 7.292115e-5


def level(f_b: Array, f_n: Array, heading_rad: float) -> tuple[float, float]:
    """Roll and pitch that turn a specific force in body axes into the one expected in NED, the heading being known.

    With h the level frame turned by the heading, C = R_y(pitch) R_x(roll): the y row gives
    ``f_y cos(roll) - f_z sin(roll) = h_y``, then x and z give the pitch. At rest, f_n = (0, 0, -g), this is the usual
    ``roll = atan2(-f_y, -f_z)``, ``pitch = atan2(f_x, sqrt(f_y^2 + f_z^2))``.

    Parameters
    ----------
    f_b : ndarray, shape (3,)
        Measured specific force, forward, right, down (m/s^2).
    f_n : ndarray, shape (3,)
        Expected one: acceleration minus gravity, north, east, down (m/s^2).
    heading_rad : float
        Heading of the forward axis.

    Returns
    -------
    roll, pitch : float
        Radians.
    """
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    h = np.array([c * f_n[0] + s * f_n[1], c * f_n[1] - s * f_n[0], f_n[2]])
    side = np.hypot(f_b[1], f_b[2])
    roll = np.arcsin(np.clip(h[1] / side, -1.0, 1.0)) - np.arctan2(f_b[1], -f_b[2])
    down = f_b[1] * np.sin(roll) + f_b[2] * np.cos(roll)
    pitch = np.arctan2(down * h[0] - f_b[0] * h[2], f_b[0] * h[0] + down * h[2])
    return float(roll), float(pitch)


def mean_specific_force(
    imu: ImuTable,
    start_ns: int,
    end_ns: int,
    gyro_error: tuple[Array, Array] | None = None,
    accel_error: tuple[Array, Array] | None = None,
) -> tuple[Array, float]:
    """Mean specific force over a window in the body axes at its start.

    The gyro carries the axes: the rotation since the start is Exp of the summed angles, which is exact about a fixed
    axis and good to half the product of the angles otherwise.

    Parameters
    ----------
    imu : ImuTable
        Rates, mean rates or increments.
    start_ns, end_ns : int
        Window; rows in (start, end] count.
    gyro_error, accel_error : (bias, matrix), optional
        Known errors, shapes (3,) and (3, 3): measured = (I + matrix) true + bias.

    Returns
    -------
    f_b : ndarray, shape (3,)
        m/s^2.
    span_s : float
        Time covered.

    Raises
    ------
    InputError
        No finite rows in the window.
    """
    rows = np.flatnonzero((imu.t_ns > start_ns) & (imu.t_ns <= end_ns))
    finite = np.isfinite(imu.gyro[rows]).all(axis=1) & np.isfinite(imu.accel[rows]).all(axis=1)
    rows = rows[finite & (rows > 0)]
    if not rows.size:
        raise InputError(
            "input.no_imu",
            f"no usable IMU row from {start_ns / NS_PER_S:.3f} s to {end_ns / NS_PER_S:.3f} s for leveling",
            "give [initial] roll_deg and pitch_deg, or start elsewhere (start_s)",
        )
    dt = (imu.t_ns[rows] - imu.t_ns[rows - 1]) / NS_PER_S
    scale = 1.0 / dt if imu.kind == "increments" else np.ones_like(dt)
    rate = corrected(imu.gyro[rows] * scale[:, None], gyro_error)
    force = corrected(imu.accel[rows] * scale[:, None], accel_error)
    turn = rate * dt[:, None]
    angle = np.cumsum(turn, axis=0) - 0.5 * turn
    c_start_b = _core.quat_to_dcm(_core.rotvec_to_quat(angle))
    carried = np.einsum("kij,kj->ki", c_start_b, force)
    return np.asarray(np.average(carried, axis=0, weights=dt)), float(dt.sum())


def corrected(values: Array, error: tuple[Array, Array] | None) -> Array:
    """Take known errors off sensor values (k, 3): (I + matrix)^-1 (measured - bias)."""
    if error is None:
        return values
    bias, matrix = error
    return np.asarray(np.linalg.solve(np.eye(3) + matrix, (values - bias).T).T, dtype=np.float64)


def calibration(engine: dict[str, Any]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Known gyro and accelerometer errors: the calibration plus the initial values of bias blocks."""
    out = []
    for sensor in ("gyro", "accel"):
        bias = np.array(engine["imu"][f"{sensor}_bias"], dtype=np.float64)
        for block in engine["blocks"]:
            if block["kind"] == f"{sensor}_bias":
                bias = bias + np.array(block["initial"])
        out.append((bias, np.array(engine["imu"][f"{sensor}_matrix"], dtype=np.float64)))
    return out[0], out[1]


def refuse_no_gravity(f_b: Array, gravity: float) -> None:
    """Raise a :class:`DataQualityError` for a mean specific force that is nowhere near gravity (m/s^2)."""
    norm = float(np.linalg.norm(f_b))
    if not 0.3 * gravity < norm < 3.0 * gravity:
        raise DataQualityError(
            "data.no_gravity",
            f"the mean specific force at the start is {norm:.3g} m/s^2, gravity is {gravity:.3f} m/s^2",
            'check [imu] accel_unit ("g" or "m/s^2") and kind ("rates" or "increments")',
            {"norm_m_s2": norm},
        )


def leveling_sd(engine: dict[str, Any], acceleration_sd: float, span_s: float, gravity: float) -> float:
    """Sd of roll and pitch (rad): acceleration, accelerometer bias and noise over gravity; gyro bias over the span."""
    variance = acceleration_sd**2 + max(engine["imu"]["accel_psd"]) / span_s
    turn = 0.0
    for block in engine["blocks"]:
        if block["kind"] == "accel_bias":
            variance += max(block["initial_sd"]) ** 2
        elif block["kind"] == "gyro_bias":
            turn += (0.5 * span_s * max(block["initial_sd"])) ** 2
    return float(np.sqrt(variance / gravity**2 + turn))


def phi_sd(roll_sd: float, pitch_sd: float, heading_sd: float, pitch: float, heading: float) -> Array:
    """Sd of phi along north, east, down from those of roll, pitch, heading (correlations dropped)."""
    along = roll_sd * np.cos(pitch)
    north = np.hypot(along * np.cos(heading), pitch_sd * np.sin(heading))
    east = np.hypot(along * np.sin(heading), pitch_sd * np.cos(heading))
    return np.array([north, east, np.hypot(heading_sd, roll_sd * np.sin(pitch))])


def earth_rate_n(lat_rad: float) -> Array:
    """Rotation of the Earth in NED, shape (3,), rad/s."""
    return EARTH_RATE_RAD_S * np.array([np.cos(lat_rad), 0.0, -np.sin(lat_rad)])
