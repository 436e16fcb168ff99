"""The inertial sensors: from the exact increments of the truth to what an imperfect IMU would put out.

``measured = (I + S + M) true + b dt + noise``, with scale factors S, misalignments M, biases b, and noise that
is white (``n sqrt(dt) w`` with a root density n) or white behind a first-order low-pass; then the range limits
the mean rate of each sample, and the resolution rounds the accumulated angle or velocity, so that no rounding
error ever builds up. Errors that vary enter with their mean over the interval.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..dataset import ImuTable
from ..units import DEG_TO_RAD, STANDARD_GRAVITY_M_S2
from .processes import constant, gauss_markov, low_pass, random_walk
from .sensor_config import AccelSensor, GyroSensor, Imu, ImuError
from .streams import Streams
from .trajectory import Trajectory

__all__ = ["error_history", "simulate_imu"]

Array = NDArray[np.float64]

#: Input and output axis of the terms of a misalignment, in the order of the filter block.
_MISALIGNMENT_TERMS = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
_ARCSEC_TO_RAD = DEG_TO_RAD / 3600.0


def simulate_imu(trajectory: Trajectory, imu: Imu, streams: Streams) -> tuple[ImuTable, dict[str, Array]]:
    """Measured increments of one run, and the true errors behind them.

    Parameters
    ----------
    trajectory : Trajectory
        Truth with n epochs.
    imu : Imu
        Sensor figures.
    streams : Streams
        Random numbers of the run.

    Returns
    -------
    table : ImuTable
        n - 1 increments, the first one stamped at the second epoch.
    blocks : dict of str to ndarray, shape (n, 3) or (n, 6)
        True history of each ``[[imu.error]]`` at the epochs, SI, measured minus true, in the order of the
        scenario.
    """
    blocks = {error.block_name: error_history(error, trajectory, streams) for error in imu.error}
    dt = trajectory.dt_s[:, np.newaxis]
    gyro = _with_errors("gyro", trajectory.dtheta[1:], dt, imu.error, blocks)
    accel = _with_errors("accel", trajectory.dvel[1:], dt, imu.error, blocks)
    _add_noise(gyro, dt, imu.gyro, streams("imu.gyro"))
    _add_noise(accel, dt, imu.accel, streams("imu.accel"))
    gyro = _limit(gyro, dt, imu.gyro.range_deg_s, DEG_TO_RAD)
    accel = _limit(accel, dt, imu.accel.range_g, STANDARD_GRAVITY_M_S2)
    gyro = _quantise(gyro, imu.gyro.increment_lsb_arcsec, _ARCSEC_TO_RAD)
    accel = _quantise(accel, imu.accel.increment_lsb_mm_s, 1e-3)
    return ImuTable(trajectory.t_ns[1:], gyro, accel, "increments"), blocks


def error_history(error: ImuError, trajectory: Trajectory, streams: Streams) -> Array:
    """One error at all epochs of the truth.

    Parameters
    ----------
    error : ImuError
        Kind, process and figures.
    trajectory : Trajectory
        Gives the n epochs; they are taken as evenly spaced.
    streams : Streams
        Random numbers; the stream is that of the block's name.

    Returns
    -------
    ndarray, shape (n, 3) or (n, 6)
        SI; may be a read-only view that repeats one row.
    """
    samples, dt_s = len(trajectory), float(np.mean(trajectory.dt_s))
    rng = streams(f"imu.error.{error.block_name}")
    if error.process == "gauss_markov":
        assert error.tau_s is not None
        return gauss_markov(rng, samples, dt_s, error.si("sd"), error.tau_s)
    if error.process == "random_walk":
        return random_walk(rng, samples, dt_s, error.si("walk"), error.si("initial_sd"))
    if error.value is not None:
        return np.broadcast_to(error.si("value"), (samples, error.size))
    return constant(rng, samples, error.si("initial_sd"))


def _with_errors(
    triad: str, true: Array, dt: Array, errors: tuple[ImuError, ...], blocks: dict[str, Array]
) -> Array:
    """``(I + S + M) true + b dt`` for one triad, shape (n - 1, 3)."""
    measured = true.copy()
    for error in errors:
        if not error.kind.startswith(triad):
            continue
        history = blocks[error.block_name]
        mean = history[:1] if history.strides[0] == 0 else 0.5 * (history[1:] + history[:-1])
        if error.kind.endswith("bias"):
            measured += mean * dt
        elif error.kind.endswith("scale"):
            measured += mean * true
        else:
            for term, (output, source) in enumerate(_MISALIGNMENT_TERMS):
                measured[:, output] += mean[:, term] * true[:, source]
    return measured


def _add_noise(
    measured: Array, dt: Array, sensor: GyroSensor | AccelSensor, rng: np.random.Generator
) -> None:
    """Add the noise of a triad to its increments, in place."""
    density = sensor.density
    if not np.any(density > 0.0):
        return
    if sensor.bandwidth_hz is None:
        measured += rng.standard_normal(measured.shape) * (density * np.sqrt(dt))
        return
    _, integrals = low_pass(rng, len(measured), float(np.mean(dt)), density, sensor.bandwidth_hz)
    measured += integrals


def _limit(measured: Array, dt: Array, full_scale: float | None, factor: float) -> Array:
    """Clip the mean rate of each sample to the range."""
    if full_scale is None:
        return measured
    return np.clip(measured, -full_scale * factor * dt, full_scale * factor * dt)


def _quantise(measured: Array, lsb: float | None, factor: float) -> Array:
    """Round the accumulated increments to whole counts and give their differences."""
    if lsb is None:
        return measured
    counts = np.rint(np.cumsum(measured, axis=0) / (lsb * factor))
    return np.asarray(np.diff(counts, axis=0, prepend=0.0) * (lsb * factor))
