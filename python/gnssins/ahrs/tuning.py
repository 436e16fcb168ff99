"""Gains of the published laws from a wanted bandwidth, and what these gains really give.

A prototype such as Butterworth or Chebyshev describes a transfer function without zeros. The paths of these laws have
zeros, and a relative degree of one: gains that place the poles of a prototype do not give its response. Every function
here returns a :class:`Tuning`, which carries both, the poles that were asked for and the corners that come out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from gnssins.ahrs.laws import Cross, Integral, Positional, RowLaw
from gnssins.analysis import text
from gnssins.errors import ConfigError
from gnssins.units import STANDARD_GRAVITY_M_S2

if TYPE_CHECKING:
    from gnssins.analysis.ahrs import Angle, Response, Stability

__all__ = [
    "EARTH_RADIUS_M",
    "Tuning",
    "butterworth_cross",
    "butterworth_integral",
    "chebyshev_integral",
    "cross",
    "positional",
    "schuler",
]

Poles = NDArray[np.complex128]

#: Mean radius of the Earth for the Schuler frequency.
EARTH_RADIUS_M: Final = 6.371e6


@dataclass(frozen=True, eq=False)
class Tuning:
    """Gains, what they were made for, and what they give.

    Parameters
    ----------
    law : RowLaw
        Law with its gains.
    wanted : str
        What was asked for.
    wanted_poles : sequence of complex
        Poles of the prototype, 1/s; empty where none was named.
    note : str
        What has to be known about it.
    """

    law: RowLaw
    wanted: str
    wanted_poles: Sequence[complex] = ()
    note: str = ""

    @cached_property
    def poles(self) -> Poles:
        """Poles of one row at rest, 1/s, slowest first; each stands as often as it occurs."""
        from gnssins.analysis.ahrs import error_matrix

        found = np.linalg.eigvals(error_matrix(self.law))
        return np.asarray(found[np.argsort(-found.real)], dtype=np.complex128)

    @cached_property
    def stability(self) -> Stability:
        """Stability over body rates up to 100 rad/s per axis."""
        from gnssins.analysis.ahrs import rate_grid, stability

        return stability(self.law, rate_grid(100.0, 21))

    @property
    def reached(self) -> bool:
        """Whether the poles at rest are those of the prototype, within 1 %, and none of them grows."""
        # rounding of an undamped pair on the axis (Schuler) does not count
        if self.poles.real.max() > 1e-9 * float(np.abs(self.poles).max()):
            return False
        return all(np.abs(self.poles - p).min() <= 0.01 * abs(p) for p in self.wanted_poles)

    @cached_property
    def responses(self) -> tuple[Response, ...]:
        """Responses of roll, pitch and heading to their own measured angle and rate, continuous, as published."""
        from gnssins.analysis.ahrs import ANGLES, response

        return tuple(response(self.law, angle, way) for way in ("measured", "gyro") for angle in ANGLES)

    def table(self) -> str:
        """What every path gives."""
        rows = []
        for r in self.responses:
            peak, at = r.peak
            rows.append(
                [
                    f"{r.reading} -> {r.angle}",
                    text.number(r.dc),
                    text.number(r.corner_hz),
                    f"{peak:+.2f}" + (f" at {text.number(at)} Hz" if at else ""),
                    f"{r.slope_db_decade:.0f}",
                ]
            )
        lines = [
            f"poles at rest {_poles(self.poles)} 1/s",
            self.stability.verdict,
            *([self.note] if self.note else []),
        ]
        if self.wanted_poles:
            lines.insert(0, f"wanted {_poles(np.asarray(self.wanted_poles))} 1/s")
        head = ["path", "DC", "-3 dB, Hz", "peak, dB", "dB/decade"]
        return text.table(f"{self.wanted}: {self.law}", head, rows, "\n".join(lines))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        return {
            "wanted": self.wanted,
            "law": str(self.law),
            "wanted_poles": [[p.real, p.imag] for p in self.wanted_poles],
            "poles": [[p.real, p.imag] for p in self.poles],
            "stable": self.stability.stable,
            "reached": self.reached,
            "responses": [r.to_dict() for r in self.responses],
            "note": self.note,
        }


def _poles(poles: Poles) -> str:
    """Poles in words, conjugate pairs and repetitions together."""
    upper = poles[poles.imag >= -1e-6 * np.abs(poles)]
    seen: dict[str, int] = {}
    for p in upper:
        name = _pole(complex(p))
        seen[name] = seen.get(name, 0) + 1
    return ", ".join(f"{name} ({n} times)" if n > 1 else name for name, n in seen.items())


def _pole(p: complex) -> str:
    real = text.number(p.real)
    if abs(p.imag) <= 1e-6 * abs(p):
        return real
    return f"{real} ± j{text.number(abs(p.imag))}"


def _positive(name: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise ConfigError("config.range", f"{name} = {value} must be positive", "", {"key": name})
    return float(value)


def positional(corner_hz: float) -> Tuning:
    """Positional law with a corner; the one prototype that its law really gives: first order, k = 2 pi f."""
    k = 2.0 * math.pi * _positive("corner_hz", corner_hz)
    return Tuning(Positional(k), f"first order, {corner_hz:g} Hz", (complex(-k),))


def chebyshev_integral(edge_hz: float, ripple_db: float = 1.0) -> Tuning:
    """Integral law with the poles of a second-order Chebyshev low-pass.

    With a = asinh(1/sqrt(10^(r/10) - 1)) / 2: k = sqrt2 sinh(a) w0, k_int = cosh(2a) w0² / 2, w0 the edge of the ripple
    band; 1.0977 w0 and 1.1025 w0² for 1 dB. Aleshkin et al. (2021) print 1.1 for both.

    The zero of the path from the measured angle makes it another filter: +3.1 dB at 0.89 of the edge, -3 dB at 1.93
    times the edge, -20 dB per decade.
    """
    w0 = 2.0 * math.pi * _positive("edge_hz", edge_hz)
    a = 0.5 * math.asinh(1.0 / math.sqrt(10.0 ** (_positive("ripple_db", ripple_db) / 10.0) - 1.0))
    law = Integral(math.sqrt(2.0) * math.sinh(a) * w0, 0.5 * math.cosh(2.0 * a) * w0**2)
    pole = w0 * complex(-math.sinh(a), math.cosh(a)) / math.sqrt(2.0)
    note = "the zero at -k_int/k makes the path from the measured angle another filter than the prototype"
    wanted = f"Chebyshev, second order, {ripple_db:g} dB, edge {edge_hz:g} Hz"
    return Tuning(law, wanted, (pole, pole.conjugate()), note)


def butterworth_integral(corner_hz: float) -> Tuning:
    """Integral law with the poles of a second-order Butterworth low-pass: k = sqrt2 w0, k_int = w0²."""
    w0 = 2.0 * math.pi * _positive("corner_hz", corner_hz)
    pole = w0 * complex(-1.0, 1.0) / math.sqrt(2.0)
    note = "the zero at -k_int/k makes the path from the measured angle another filter than the prototype"
    wanted = f"Butterworth, second order, {corner_hz:g} Hz"
    return Tuning(Integral(math.sqrt(2.0) * w0, w0**2), wanted, (pole, pole.conjugate()), note)


def butterworth_cross(corner_hz: float) -> Tuning:
    """Cross-coupled law that matches as much of a third-order Butterworth polynomial as it can: not all, and unstable.

    p³ + 2w0 p² + 2w0² p + w0³ against 3k, 3k² + n², k³ + kn² - 2n³ at rest: the first two give k = 2w0/3 and
    n = w0 sqrt(2/3), which is beyond k. The pattern is out of reach of this law, and its paths fall with 20 dB per
    decade whatever the poles. Aleshkin et al. (2021) give k = 42.8, n = 13.3 for 10 Hz: poles -29.5 and -49.5 +- j17.6
    where -62.8 and -31.4 +- j54.4 were meant.
    """
    w0 = 2.0 * math.pi * _positive("corner_hz", corner_hz)
    pole = w0 * complex(-0.5, 0.5 * math.sqrt(3.0))
    note = "out of reach: matching the first two coefficients needs n beyond k, where the law is unstable"
    return Tuning(
        Cross(2.0 * w0 / 3.0, w0 * math.sqrt(2.0 / 3.0)),
        f"Butterworth, third order, {corner_hz:g} Hz",
        (complex(-w0), pole, pole.conjugate()),
        note,
    )


def cross(corner_hz: float, angle: Angle = "pitch", ratio: float = 13.3 / 42.8) -> Tuning:
    """Cross-coupled law with a corner of one angle at a ratio n/k, below 1 in magnitude; the published one if left out.

    Everything scales with k: the corner of k = 1 is found once.
    """
    from gnssins.analysis.ahrs import response

    if not abs(ratio) < 1.0:
        raise ConfigError(
            "config.range", f"ratio = {ratio} must be below 1: beyond that some body rate destabilises"
        )
    k = _positive("corner_hz", corner_hz) / response(Cross(1.0, ratio), angle).corner_hz
    return Tuning(
        Cross(k, ratio * k), f"corner {corner_hz:g} Hz from the measured {angle}, n/k = {ratio:.3g}"
    )


def schuler(
    damping: float = 0.0, gravity_m_s2: float = STANDARD_GRAVITY_M_S2, radius_m: float = EARTH_RADIUS_M
) -> Tuning:
    """Integral law with the Schuler frequency: k_int = g/R, k = 2 damping sqrt(g/R); period 84.4 min.

    Only ``damping = 0`` leaves acceleration without effect: the integral then becomes V/R, the rate at which the
    vertical turns under the vehicle. It needs gyros of navigation grade: 1 deg/h of drift costs 0.22 deg.
    """
    w_s = math.sqrt(_positive("gravity_m_s2", gravity_m_s2) / _positive("radius_m", radius_m))
    if not (math.isfinite(damping) and damping >= 0.0):
        raise ConfigError("config.range", f"damping = {damping} must be zero or positive")
    pole = w_s * (-damping + np.emath.sqrt(damping**2 - 1.0))
    note = "" if damping == 0.0 else "acceleration has an effect: only k = 0 leaves it without"
    wanted = f"Schuler, {2.0 * math.pi / w_s / 60.0:.1f} min, damping {damping:g}"
    return Tuning(
        Integral(2.0 * damping * w_s, w_s**2), wanted, (complex(pole), complex(pole).conjugate()), note
    )
