"""Factors from the units of sensor data sheets and log files to SI.

``value_si = value * FACTOR["unit"]``. The tables are the whole list of accepted unit names; the configuration
models take their choices from here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

STANDARD_GRAVITY_M_S2: Final = 9.80665
"""Standard acceleration of gravity (exact): 3rd CGPM (1901), declaration on the unit of mass."""

NS_PER_S: Final = 1_000_000_000
"""Nanoseconds in a second."""

_DEG = math.pi / 180.0
_G = STANDARD_GRAVITY_M_S2

#: Angular rates, to rad/s.
RATE: Final[Mapping[str, float]] = MappingProxyType({"rad/s": 1.0, "deg/s": _DEG})

#: Angle increments over one sample, to rad.
ANGLE: Final[Mapping[str, float]] = MappingProxyType({"rad": 1.0, "deg": _DEG})

#: Specific force, to m/s^2.
FORCE: Final[Mapping[str, float]] = MappingProxyType({"m/s^2": 1.0, "g": _G})

#: Velocity increments over one sample, to m/s.
VELOCITY: Final[Mapping[str, float]] = MappingProxyType({"m/s": 1.0})

#: Decimal digits between one unit of the time column and one nanosecond.
TIME_DIGITS: Final[Mapping[str, int]] = MappingProxyType({"s": 9, "ms": 6, "us": 3, "ns": 0})

#: Units of a gyro bias, to rad/s.
GYRO_BIAS: Final[Mapping[str, float]] = MappingProxyType(
    {"deg/h": _DEG / 3600.0, "deg/s": _DEG, "rad/s": 1.0}
)

#: Units of an accelerometer bias, to m/s^2.
ACCEL_BIAS: Final[Mapping[str, float]] = MappingProxyType({"mg": 1e-3 * _G, "ug": 1e-6 * _G, "m/s^2": 1.0})

#: Units of a scale-factor error, to 1.
SCALE: Final[Mapping[str, float]] = MappingProxyType({"ppm": 1e-6})

#: Units of a misalignment, to rad.
MISALIGNMENT: Final[Mapping[str, float]] = MappingProxyType({"mrad": 1e-3})

#: Lengths, to m.
LENGTH: Final[Mapping[str, float]] = MappingProxyType({"m": 1.0})

#: Heights of an altimeter, to m.
HEIGHT: Final[Mapping[str, float]] = MappingProxyType({"m": 1.0, "ft": 0.3048})

DEG_SQRT_H_TO_RAD_SQRT_S: Final = _DEG / 60.0
"""Angle random walk: deg/sqrt(h) to rad/sqrt(s)."""

M_S_SQRT_H_TO_M_S_SQRT_S: Final = 1.0 / 60.0
"""Velocity random walk: m/s/sqrt(h) to m/s/sqrt(s)."""

DEG_TO_RAD: Final = _DEG
"""Degrees to radians."""

UG_TO_M_S2: Final = 1e-6 * _G
"""Micro-g to m/s^2 (noise density: ug/sqrt(Hz) to m/s^2/sqrt(Hz))."""


def seconds_to_ns(seconds: float) -> int:
    """Round seconds to whole nanoseconds.

    For settings such as a start time or a latency. Time stamps of samples do not pass through here: the
    readers take them from text without a float in between.
    """
    return round(seconds * NS_PER_S)


def times_to_ns(time_s: NDArray[np.float64]) -> NDArray[np.int64]:
    """Nanoseconds of finite times in seconds, whole seconds and fraction apart to keep all digits."""
    whole = np.floor(time_s)
    return whole.astype(np.int64) * NS_PER_S + np.rint((time_s - whole) * NS_PER_S).astype(np.int64)


def ms_to_ns(milliseconds: float) -> int:
    """Round milliseconds to whole nanoseconds."""
    return round(milliseconds * 1_000_000)
