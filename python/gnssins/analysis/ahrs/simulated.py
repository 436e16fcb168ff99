"""The figures of a law taken from the running estimator: what the equations say is measured here.

A level body at rest, north ahead, is given to the compiled law: sines and noise come in through the gyro or through the
angles that accelerometer and magnetometer show.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from gnssins import _core
from gnssins.ahrs.estimate import Attitude, Sensors, run
from gnssins.ahrs.laws import Form, RowLaw
from gnssins.analysis.ahrs.dynamics import ANGLES, Angle, Reading, model
from gnssins.analysis.ahrs.response import Response, StepResponse, response
from gnssins.units import NS_PER_S, STANDARD_GRAVITY_M_S2

__all__ = ["level_sensors", "simulated_corner", "simulated_noise", "simulated_response", "simulated_step"]

Array = NDArray[np.float64]

#: Angle of the sines, rad: the sine of it is the angle to 2e-9.
_AMPLITUDE = 1e-4

#: Initial error of a step, rad.
_STEP = 1e-3


def level_sensors(
    count: int, dt_s: float, *, gyro: ArrayLike | None = None, euler: ArrayLike | None = None
) -> Sensors:
    """Sensors of a level body at rest, north ahead, in a field 45 deg down.

    Parameters
    ----------
    count : int
        Rows.
    dt_s : float
        Interval, s.
    gyro : array_like, shape (count, 3), optional
        What the gyro shows, mean rates, rad/s; left out: nothing.
    euler : array_like, shape (count, 3), optional
        Roll, pitch, heading (rad) that accelerometer and magnetometer show; left out: zero.
    """
    t_ns = np.rint(np.arange(count) * dt_s * NS_PER_S).astype(np.int64)
    shown = np.zeros((count, 3)) if euler is None else np.asarray(euler, dtype=np.float64)
    c_nb = _core.quat_to_dcm(_core.euler_to_quat(shown))
    accel, mag = -STANDARD_GRAVITY_M_S2 * c_nb[:, 2], c_nb[:, 0] + c_nb[:, 2]
    return Sensors(t_ns, np.zeros((count, 3)) if gyro is None else gyro, accel, mag, "mean-rates")


def _angles(result: Attitude, form: Form) -> Array:
    if form == "elements" and result.element_angles is not None:
        return result.element_angles
    return result.euler


def simulated_response(
    law: RowLaw,
    angle: Angle,
    reading: Reading,
    frequency_hz: float,
    dt_s: float,
    form: Form = "elements",
) -> complex:
    """Complex response of the running law to a sine, by least squares over whole periods after the transient."""
    slowest = -float(np.linalg.eigvals(model(law, angle, form).a).real.max())
    periods = max(2, math.ceil(0.4 * frequency_hz))
    last = round(periods / frequency_hz / dt_s)
    count = last + math.ceil(25.0 / slowest / dt_s)
    phase = 2.0 * math.pi * frequency_hz * dt_s * np.arange(count)
    column = ANGLES.index(angle)
    sine = np.zeros((count, 3))
    sine[:, column] = _AMPLITUDE * np.sin(phase)
    gyro, euler = (sine, None) if reading == "gyro" else (None, sine)
    sensors = level_sensors(count, dt_s, gyro=gyro, euler=euler)
    out = _angles(run(sensors, law, form=form, initial_q_nb=(1.0, 0.0, 0.0, 0.0)), form)[-last:, column]
    basis = np.column_stack([np.sin(phase[-last:]), np.cos(phase[-last:])])
    a, b = np.linalg.lstsq(basis, out, rcond=None)[0] / _AMPLITUDE
    return complex(a, b)


def simulated_corner(
    law: RowLaw, angle: Angle, reading: Reading = "measured", dt_s: float = 2e-4, form: Form = "elements"
) -> float:
    """Frequency (Hz) at which the running law has fallen by sqrt(2) from its DC response."""
    want: Response = response(law, angle, reading, form=form, dt_s=dt_s)
    level, guess = abs(want.dc) / math.sqrt(2.0), want.corner_hz

    def above(f: float) -> float:
        return abs(simulated_response(law, angle, reading, f, dt_s, form)) - level

    return float(brentq(above, 0.7 * guess, 1.4 * guess, xtol=1e-4 * guess))


def simulated_step(
    law: RowLaw, angle: Angle, dt_s: float = 1e-3, duration_s: float = 0.6, form: Form = "elements"
) -> StepResponse:
    """Response of the running law to an initial error of one angle."""
    count = round(duration_s / dt_s) + 1
    start = np.zeros((1, 3))
    start[0, ANGLES.index(angle)] = _STEP
    q_nb = [float(x) for x in _core.euler_to_quat(start)[0]]
    result = run(level_sensors(count, dt_s), law, form=form, initial_q_nb=q_nb)
    return StepResponse(angle, np.arange(count, dtype=np.float64) * dt_s, _angles(result, form) / _STEP)


def simulated_noise(
    law: RowLaw,
    sd: float,
    reading: Reading,
    dt_s: float,
    count: int,
    seed: int | np.random.SeedSequence,
    form: Form = "elements",
) -> Array:
    """Variance (rad²) of roll, pitch, heading of the running law under white noise on all three axes, shape (3,).

    Parameters
    ----------
    law : RowLaw
        Law and gains.
    sd : float
        Standard deviation of the rates (rad/s) or of the measured angles (rad).
    reading : {"measured", "gyro"}
        Where the noise comes in.
    dt_s : float
        Interval, s.
    count : int
        Rows after the transient of 20 times the slowest time constant.
    seed : int or SeedSequence
        Of the noise.
    form : {"elements", "rotation"}
        As in :func:`~gnssins.analysis.ahrs.model`.
    """
    slowest = -float(np.linalg.eigvals(model(law, "pitch", form).a).real.max())
    settle = math.ceil(20.0 / slowest / dt_s)
    noise = np.random.default_rng(seed).normal(0.0, sd, (count + settle, 3))
    gyro, euler = (noise, None) if reading == "gyro" else (None, noise)
    sensors = level_sensors(len(noise), dt_s, gyro=gyro, euler=euler)
    result = run(sensors, law, form=form, initial_q_nb=(1.0, 0.0, 0.0, 0.0))
    return np.asarray(_angles(result, form)[settle:].var(axis=0))
