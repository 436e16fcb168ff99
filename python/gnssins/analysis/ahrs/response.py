"""Frequency and step response of a law, continuous and as sampled."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm
from scipy.optimize import brentq, minimize_scalar

from gnssins.ahrs.laws import Form, RowLaw
from gnssins.analysis import text
from gnssins.analysis.ahrs.dynamics import ANGLES, Angle, Model, Reading, model
from gnssins.errors import ConfigError

__all__ = ["Response", "StepResponse", "response", "step_response"]

Array = NDArray[np.float64]

#: Grid on which peaks and corners are bracketed, points per decade.
_PER_DECADE = 200

#: DC response below which there is none.
_NO_DC = 1e-12


@dataclass(frozen=True, eq=False)
class Response:
    """Frequency response from a reading to an angle.

    Parameters
    ----------
    law : RowLaw
        Law and gains.
    angle : {"roll", "pitch", "heading"}
        Output.
    reading : {"measured", "gyro"}
        Input: the angle that accelerometer or magnetometer show (dimensionless response), or its rate (s).
    form : {"elements", "rotation"}
        As in :func:`~gnssins.analysis.ahrs.model`.
    dt_s : float, optional
        Sampling interval; left out: continuous time.
    """

    law: RowLaw
    angle: Angle
    reading: Reading
    form: Form = "elements"
    dt_s: float | None = None

    @cached_property
    def _system(self) -> tuple[Model, Array | None]:
        found = model(self.law, self.angle, self.form)
        return found, None if self.dt_s is None else found.transition(self.dt_s)

    def at(self, frequency_hz: ArrayLike, source: Angle | None = None) -> NDArray[np.complex128]:
        """Complex response at frequencies, from the angle's own reading or from that of another (``source``)."""
        linear, phi = self._system
        column = linear.own if source is None else ANGLES.index(source)
        omega = 2.0 * math.pi * np.atleast_1d(np.asarray(frequency_hz, dtype=np.float64))
        identity = np.eye(len(linear.a))
        b = self._input(column)
        if phi is None or self.dt_s is None:
            poles = 1j * omega[:, None, None] * identity - linear.a
        else:
            poles = identity - phi * np.exp(-1j * omega * self.dt_s)[:, None, None]
        states = np.linalg.solve(poles, np.broadcast_to(b[:, None], (len(omega), len(b), 1)).astype(complex))
        return np.asarray(states[..., 0] @ linear.out)

    @property
    def dc(self) -> float:
        """Response to a constant."""
        linear, phi = self._system
        a, b = -linear.a, self._input(linear.own)
        return float(linear.out @ np.linalg.solve(a if phi is None else np.eye(len(a)) - phi, b))

    def _input(self, column: int) -> Array:
        """Input column of an angle: continuous, or over a sampling interval at whose end the reading acts."""
        linear, phi = self._system
        if phi is None or self.dt_s is None:
            return np.asarray(linear.inputs(self.reading)[:, column])
        moved = linear.moved[:, column]
        return np.asarray(phi @ moved * self.dt_s if self.reading == "gyro" else moved - phi @ moved)

    @cached_property
    def _resonance_hz(self) -> float | None:
        """Frequency of undamped poles, at which the response has no bound; None without any."""
        poles = np.linalg.eigvals(self._system[0].a)
        free = poles[(np.abs(poles.real) <= 1e-9 * np.abs(poles)) & (poles.imag > 0.0)]
        return float(free[0].imag) / (2.0 * math.pi) if free.size else None

    @cached_property
    def _scan(self) -> tuple[Array, Array]:
        """Frequencies (Hz) around the poles and magnitudes there."""
        poles = np.abs(np.linalg.eigvals(self._system[0].a)) / (2.0 * math.pi)
        low, high = max(poles.min(), 1e-9) / 1e3, max(poles.max(), 1e-9) * 1e3
        if self.dt_s is not None:
            high = min(high, 0.5 / self.dt_s)
        grid = np.geomspace(low, high, round(_PER_DECADE * math.log10(high / low)))
        return grid, np.abs(self.at(grid))

    @property
    def peak(self) -> tuple[float, float]:
        """Largest magnitude over its reference, dB, and its frequency, Hz (0: at DC).

        The reference is the DC response, or the peak itself where that is zero (band-pass). Without damping the
        peak is infinite.
        """
        if self._resonance_hz is not None:
            return math.inf, self._resonance_hz
        top, at = self._top
        if self.band_pass:
            return 0.0, at
        if top <= abs(self.dc) * (1.0 + 1e-6):
            return 0.0, 0.0
        return 20.0 * math.log10(top / abs(self.dc)), at

    @cached_property
    def _top(self) -> tuple[float, float]:
        """Largest magnitude, and its frequency, Hz."""
        grid, size = self._scan
        i = int(size.argmax())
        around = (math.log(grid[max(i - 1, 0)]), math.log(grid[min(i + 1, grid.size - 1)]))
        found = minimize_scalar(
            lambda x: -abs(self.at(math.exp(x))[0]), bounds=around, method="bounded", options={"xatol": 1e-10}
        )
        return -float(found.fun), math.exp(float(found.x))

    @cached_property
    def band_pass(self) -> bool:
        """Whether a constant input leaves nothing, as a gyro bias under the integral law in continuous time.

        Sampled it leaves half an interval of drift: the error swings about zero within the interval.
        """
        linear, _ = self._system
        b = linear.inputs(self.reading)[:, linear.own]
        return bool(abs(linear.out @ np.linalg.solve(-linear.a, b)) <= _NO_DC)

    @property
    def _reference(self) -> float:
        return self._top[0] if self.band_pass else abs(self.dc)

    @property
    def corner_hz(self) -> float:
        """Upper frequency (Hz) at which it has fallen by sqrt(2) from DC, a band-pass from its peak; NaN: none."""
        if self._resonance_hz is not None and self.band_pass:
            return math.nan
        grid, size = self._scan
        level = self._reference / math.sqrt(2.0)
        above = np.flatnonzero(size >= level)
        if not above.size or above[-1] + 1 >= grid.size:
            return math.nan
        low, high = grid[above[-1]], grid[above[-1] + 1]
        return float(brentq(lambda f: abs(self.at(f)[0]) - level, low, high, xtol=1e-12, rtol=1e-12))

    @property
    def slope_db_decade(self) -> float:
        """Final slope of a continuous law, dB per decade."""
        grid, _ = self._scan
        ends = np.abs(self.at([grid[-1], 10.0 * grid[-1]]))
        return 20.0 * math.log10(ends[1] / ends[0])

    def table(self) -> str:
        """DC, corner, peak, slope."""
        peak, at = self.peak
        rows = [
            ["DC" + (" (s)" if self.reading == "gyro" else ""), text.number(self.dc, 3)],
            ["-3 dB, Hz", text.number(self.corner_hz)],
            ["peak, dB", f"{peak:+.2f}" + (f" at {text.number(at)} Hz" if at else "")],
            ["slope, dB/decade", f"{self.slope_db_decade:.0f}" if self.dt_s is None else "-"],
        ]
        return text.table(f"{self.reading} -> {self.angle}, {self.law}", ["", ""], rows)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        peak, at = self.peak
        corner = self.corner_hz
        return {
            "angle": self.angle,
            "reading": self.reading,
            "form": self.form,
            "dc": self.dc,
            "corner_hz": corner if math.isfinite(corner) else None,
            "peak_db": peak if math.isfinite(peak) else None,
            "peak_hz": at,
            "slope_db_decade": self.slope_db_decade if self.dt_s is None else None,
        }


def response(
    law: RowLaw,
    angle: Angle = "pitch",
    reading: Reading = "measured",
    *,
    form: Form = "elements",
    dt_s: float | None = None,
) -> Response:
    """Frequency response of a law; see :class:`Response`.

    Raises
    ------
    ConfigError
        An angle or reading that does not exist, or an interval that is not positive.
    """
    if angle not in ANGLES or reading not in ("measured", "gyro"):
        raise ConfigError("config.choice", f'no response from "{reading}" to "{angle}"')
    if dt_s is not None and not (math.isfinite(dt_s) and dt_s > 0.0):
        raise ConfigError("config.range", f"dt_s = {dt_s} must be positive")
    return Response(law, angle, reading, form, dt_s)


@dataclass(frozen=True, eq=False)
class StepResponse:
    """How an initial error of one angle goes away, the body at rest.

    Parameters
    ----------
    angle : {"roll", "pitch", "heading"}
        Angle that starts off by one.
    time_s : ndarray, shape (m,)
        Time.
    errors : ndarray, shape (m, 3)
        Errors of roll, pitch, heading over the initial error.
    """

    angle: Angle
    time_s: Array
    errors: Array

    @property
    def own(self) -> Array:
        """Error of the angle itself, shape (m,)."""
        return self.errors[:, ANGLES.index(self.angle)]

    def settled_s(self, share: float = 0.05) -> float:
        """First time from which the angle stays within a share of its initial error; NaN: never."""
        outside = np.flatnonzero(np.abs(self.own) > share)
        if not outside.size:
            return float(self.time_s[0])
        i = int(outside[-1])
        if i + 1 >= self.time_s.size:
            return math.nan
        a, b = abs(self.own[i]), abs(self.own[i + 1])
        return float(self.time_s[i] + (self.time_s[i + 1] - self.time_s[i]) * (a - share) / (a - b))

    @property
    def undershoot(self) -> float:
        """Largest excursion beyond zero, over the initial error."""
        return max(0.0, -float(self.own.min()))

    def leak(self, angle: Angle) -> float:
        """Largest error thrown into another angle, over the initial error."""
        return float(np.abs(self.errors[:, ANGLES.index(angle)]).max())

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        settled = self.settled_s()
        return {
            "angle": self.angle,
            "settled_5_percent_s": settled if math.isfinite(settled) else None,
            "undershoot": self.undershoot,
            "leak": {a: self.leak(a) for a in ANGLES if a != self.angle},
        }


def step_response(
    law: RowLaw, angle: Angle = "pitch", *, form: Form = "elements", time_s: ArrayLike | None = None
) -> StepResponse:
    """Response of a law to an initial error of one angle.

    Parameters
    ----------
    law : RowLaw
        Law and gains.
    angle : {"roll", "pitch", "heading"}
        Angle that starts off.
    form : {"elements", "rotation"}
        As in :func:`~gnssins.analysis.ahrs.model`.
    time_s : array_like, shape (m,), optional
        Equally spaced times from 0; left out: 4000 up to ten times the slowest time constant.
    """
    if time_s is None:
        slowest = -float(np.linalg.eigvals(model(law, angle, form).a).real.max())
        time_s = np.linspace(0.0, 10.0 / slowest if slowest > 0.0 else 1.0, 4001)
    t = np.asarray(time_s, dtype=np.float64)
    if t.ndim != 1 or t.size < 2 or not np.allclose(np.diff(t), t[1] - t[0], rtol=1e-6, atol=0.0):
        raise ConfigError("config.range", "time_s: need two or more equally spaced times")
    start = ANGLES.index(angle)
    errors = np.empty((t.size, 3))
    for i, name in enumerate(ANGLES):
        linear = model(law, name, form)
        phi = expm(linear.a * (t[1] - t[0]))
        z = linear.moved[:, start]
        for k in range(t.size):
            errors[k, i] = linear.out @ z
            z = phi @ z
    return StepResponse(angle, t - t[0], errors)
