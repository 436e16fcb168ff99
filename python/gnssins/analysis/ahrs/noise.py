"""Noise of the angles from white noise of the sensors, by the Lyapunov equation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

from gnssins.ahrs.laws import Form, RowLaw
from gnssins.analysis import text
from gnssins.analysis.ahrs.dynamics import ANGLES, Angle, Model, model
from gnssins.errors import ConfigError

__all__ = ["NoiseGain", "noise_gain"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class NoiseGain:
    """Variance of every angle over the variance of the sensor and its sampling interval.

    Parameters
    ----------
    gyro : ndarray, shape (3,)
        Roll, pitch, heading: variance = ``gyro`` x gyro variance x interval; s.
    measured : ndarray, shape (3,)
        The same for white noise of the measured angles; 1/s.
    dt_s : float or None
        Interval of the sampled law; None: continuous time.
    """

    gyro: Array
    measured: Array
    dt_s: float | None = None

    def variance(self, angle: Angle, gyro_var: float, dt_s: float | None = None) -> float:
        """Variance of an angle (rad²) for a gyro variance ((rad/s)²) at an interval; any other unit likewise."""
        interval = self.dt_s if dt_s is None else dt_s
        if interval is None:
            raise ConfigError("config.range", "a continuous noise gain needs the sampling interval dt_s")
        return float(self.gyro[ANGLES.index(angle)]) * gyro_var * interval

    def table(self) -> str:
        """One line per angle."""
        rows = [
            [name, text.number(float(g), 4), text.number(float(m), 4)]
            for name, g, m in zip(ANGLES, self.gyro, self.measured, strict=True)
        ]
        return text.table("Noise gain", ["angle", "gyro, s", "measured angle, 1/s"], rows)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        names = [(name, i) for i, name in enumerate(ANGLES)]
        return {
            "gyro_s": {name: float(self.gyro[i]) for name, i in names},
            "measured_1_s": {name: float(self.measured[i]) for name, i in names},
            "dt_s": self.dt_s,
        }


def noise_gain(law: RowLaw, *, form: Form = "elements", dt_s: float | None = None) -> NoiseGain:
    """Noise gain of a law for white noise, equal and independent on the three axes, at rest and level.

    Continuous: A P + P A' + B B' = 0. Sampled, as the compiled law runs: P = F P F' + G G', F = exp(A T), and
    G = F M T for the gyro, (I - F) M for measured angles, M the columns by which the angles enter.

    Parameters
    ----------
    law : RowLaw
        Law and gains.
    form : {"elements", "rotation"}
        As in :func:`~gnssins.analysis.ahrs.model`.
    dt_s : float, optional
        Sampling interval; left out: continuous time.

    Raises
    ------
    ConfigError
        The law is not stable at rest, or the interval not positive.
    """
    if dt_s is not None and not (math.isfinite(dt_s) and dt_s > 0.0):
        raise ConfigError("config.range", f"dt_s = {dt_s} must be positive")
    gains = np.array([_gains(model(law, angle, form), dt_s) for angle in ANGLES])
    return NoiseGain(gains[:, 0], gains[:, 1], dt_s)


def _gains(linear: Model, dt_s: float | None) -> tuple[float, float]:
    a = linear.a
    if np.linalg.eigvals(a).real.max() >= 0.0:
        raise ConfigError("config.range", "the law is not stable at rest: its noise grows without bound")
    if dt_s is None:
        inputs = (linear.inputs("gyro"), linear.inputs("measured"))
        found = [solve_continuous_lyapunov(a, -b @ b.T) for b in inputs]
    else:
        phi = linear.transition(dt_s)
        inputs = (phi @ linear.moved * dt_s, linear.moved - phi @ linear.moved)
        found = [solve_discrete_lyapunov(phi, b @ b.T) / dt_s for b in inputs]
    gyro, measured = (float(linear.out @ p @ linear.out) for p in found)
    return gyro, measured
