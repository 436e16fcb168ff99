"""Sensor accuracy budget of one horizontal INS channel, and how long feedback may wait.

The channel is a Schuler pendulum, ``dp'' + ws^2 dp = da`` with ``ws^2 = g/R``: period 84.4 min, no coupling to the
other one, Earth rate and ellipsoid left out. Constant sensor errors grow as

- accelerometer da: ``R (da/g) (1 - cos ws t)``, at most ``2 R da/g``; ``da t^2/2`` at first;
- gyro e: ``R e (t - sin(ws t)/ws)``; ``g e t^3/6`` at first;
- tilt al at the start: ``R al (1 - cos ws t)``;
- velocity dv at the start: ``(dv/ws) sin ws t``.

Titterton and Weston (2004), chapter 12; Groves (2013), section 5.7.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from gnssins import units
from gnssins.analysis import text
from gnssins.errors import ConfigError

__all__ = [
    "OUTAGES_S",
    "Budget",
    "BudgetRow",
    "allowed_accel",
    "allowed_gyro",
    "correction_period",
    "growth",
    "linearity_bound",
    "outage_of_accel",
    "outage_of_gyro",
    "sensor_budget",
]

Array = NDArray[np.float64]

#: Radius of the Earth (m) and gravity (m/s^2) of the channel.
RADIUS_M: Final = 6_371_000.0
GRAVITY_M_S2: Final = units.STANDARD_GRAVITY_M_S2

#: Schuler frequency, rad/s.
SCHULER_RAD_S: Final = math.sqrt(GRAVITY_M_S2 / RADIUS_M)

#: Outage lengths of the table, s.
OUTAGES_S: Final = (10.0, 30.0, 60.0, 100.0, 300.0, 600.0, 1800.0, 3600.0)

#: Half a Schuler period, s: from there on the error of an accelerometer grows no more.
HALF_PERIOD_S: Final = math.pi / SCHULER_RAD_S

_UG: Final = units.ACCEL_BIAS["ug"]
_DEG_H: Final = units.GYRO_BIAS["deg/h"]


def growth(
    time_s: ArrayLike,
    *,
    accel_m_s2: float = 0.0,
    gyro_rad_s: float = 0.0,
    tilt_rad: float = 0.0,
    velocity_m_s: float = 0.0,
) -> Array:
    """Position error of the channel (m), the sum over the given constant errors.

    Parameters
    ----------
    time_s : array_like, shape (k,)
        Time since the last correction.
    accel_m_s2, gyro_rad_s : float
        Constant sensor errors.
    tilt_rad, velocity_m_s : float
        Errors at the start.

    Returns
    -------
    ndarray, shape (k,)
    """
    t = np.asarray(time_s, dtype=np.float64)
    wt = SCHULER_RAD_S * t
    swing = 2.0 * np.sin(0.5 * wt) ** 2  # 1 - cos without loss of digits
    level = RADIUS_M * (accel_m_s2 / GRAVITY_M_S2 + tilt_rad) * swing
    return np.asarray(level + RADIUS_M * gyro_rad_s * _drift(t) + velocity_m_s / SCHULER_RAD_S * np.sin(wt))


def _drift(t: Array) -> Array:
    """t - sin(ws t)/ws, by its series where that would cancel."""
    wt = SCHULER_RAD_S * t
    series = t * wt**2 / 6.0 * (1.0 - wt**2 / 20.0 * (1.0 - wt**2 / 42.0))
    return np.asarray(np.where(wt < 0.1, series, t - np.sin(wt) / SCHULER_RAD_S))


def allowed_accel(position_m: float, outage_s: float, *, within: bool = False) -> float:
    """Constant accelerometer error (m/s^2) that makes a position error of ``position_m`` after an outage.

    Parameters
    ----------
    position_m, outage_s : float
        Requirement.
    within : bool
        Ask that the requirement holds all the time up to the end of the outage: beyond half a Schuler period
        (2532 s) the error returns, and at 84.4 min any error would be allowed at the end.
    """
    _require(position_m=position_m, outage_s=outage_s)
    t = min(outage_s, HALF_PERIOD_S) if within else outage_s
    swing = 2.0 * math.sin(0.5 * SCHULER_RAD_S * t) ** 2
    return math.inf if swing == 0.0 else GRAVITY_M_S2 * position_m / (RADIUS_M * swing)


def allowed_gyro(position_m: float, outage_s: float) -> float:
    """Constant drift (rad/s) of a horizontal gyro that makes a position error of ``position_m`` after an outage."""
    _require(position_m=position_m, outage_s=outage_s)
    return position_m / (RADIUS_M * float(_drift(np.asarray(outage_s))))


def outage_of_accel(position_m: float, accel_m_s2: float) -> float:
    """First time (s) at which a constant accelerometer error has grown to ``position_m``; infinite if it never does."""
    _require(position_m=position_m, accel_m_s2=accel_m_s2)
    share = position_m * GRAVITY_M_S2 / (RADIUS_M * accel_m_s2)
    return math.inf if share > 2.0 else 2.0 * math.asin(math.sqrt(0.5 * share)) / SCHULER_RAD_S


def outage_of_gyro(position_m: float, gyro_rad_s: float) -> float:
    """Time (s) at which the constant drift of a horizontal gyro has grown to ``position_m``."""
    _require(position_m=position_m, gyro_rad_s=gyro_rad_s)
    return _first_time(lambda t: float(growth(t, gyro_rad_s=gyro_rad_s)) - position_m)


def _both(position_m: float, accel_m_s2: float, gyro_rad_s: float) -> float:
    """First time at which the root sum of squares of both errors reaches ``position_m``."""

    def excess(t: float) -> float:
        accel = float(growth(min(t, HALF_PERIOD_S), accel_m_s2=accel_m_s2))
        return math.hypot(accel, float(growth(t, gyro_rad_s=gyro_rad_s))) - position_m

    return _first_time(excess)


def _first_time(excess: Any) -> float:
    """Root of a rising function of time that starts below zero."""
    top = 1.0
    while excess(top) < 0.0:
        top *= 2.0
        if top > 1e12:
            return math.inf
    return float(brentq(excess, 0.0, top, xtol=1e-9, rtol=1e-13))


@dataclass(frozen=True)
class BudgetRow:
    """Allowed constant errors for one outage: at its end, and of the accelerometer all the time up to it."""

    outage_s: float
    accel_m_s2: float
    accel_within_m_s2: float
    gyro_rad_s: float


@dataclass(frozen=True)
class Budget:
    """What a position requirement allows, and how long given sensors meet it.

    Parameters
    ----------
    position_m : float
        Requirement.
    rows : tuple of BudgetRow
        By length of the outage.
    accel_m_s2, gyro_rad_s : float or None
        Sensors asked about.
    accel_outage_s, gyro_outage_s, both_outage_s : float or None
        How long they meet the requirement, alone and together (root sum of squares).
    """

    position_m: float
    rows: tuple[BudgetRow, ...]
    accel_m_s2: float | None = None
    gyro_rad_s: float | None = None
    accel_outage_s: float | None = None
    gyro_outage_s: float | None = None
    both_outage_s: float | None = None

    def table(self) -> str:
        """The allowed errors, one line per outage, and the lengths for the given sensors."""
        rows = [
            [
                f"{r.outage_s:g}",
                text.number(r.accel_m_s2 / _UG),
                text.number(r.accel_within_m_s2 / _UG),
                text.number(r.gyro_rad_s / _DEG_H),
            ]
            for r in self.rows
        ]
        head = ["outage, s", "accelerometer at the end, ug", "at any time, ug", "gyro, deg/h"]
        title = f"Allowed constant errors for {self.position_m:g} m, each alone"
        return text.table(title, head, rows, "\n".join(self._reach()))

    def _reach(self) -> list[str]:
        lines = []
        if self.accel_m_s2 is not None and self.accel_outage_s is not None:
            lines.append(f"Accelerometer of {self.accel_m_s2 / _UG:g} ug: {_seconds(self.accel_outage_s)}")
        if self.gyro_rad_s is not None and self.gyro_outage_s is not None:
            lines.append(f"Gyro of {self.gyro_rad_s / _DEG_H:g} deg/h: {_seconds(self.gyro_outage_s)}")
        if self.both_outage_s is not None:
            lines.append(f"Both, root sum of squares: {_seconds(self.both_outage_s)}")
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, units in the names; None where not asked, an unbounded time as infinity."""
        return {
            "position_m": self.position_m,
            "allowed": [
                {
                    "outage_s": r.outage_s,
                    "accel_ug": r.accel_m_s2 / _UG,
                    "accel_within_ug": r.accel_within_m_s2 / _UG,
                    "gyro_deg_h": r.gyro_rad_s / _DEG_H,
                }
                for r in self.rows
            ],
            "accel_ug": None if self.accel_m_s2 is None else self.accel_m_s2 / _UG,
            "gyro_deg_h": None if self.gyro_rad_s is None else self.gyro_rad_s / _DEG_H,
            "accel_outage_s": self.accel_outage_s,
            "gyro_outage_s": self.gyro_outage_s,
            "both_outage_s": self.both_outage_s,
        }


def _seconds(value: float) -> str:
    return f"{value:.1f} s" if math.isfinite(value) else "for ever: it never grows so far"


def sensor_budget(
    position_m: float,
    outages_s: Sequence[float] = OUTAGES_S,
    *,
    accel_m_s2: float | None = None,
    gyro_rad_s: float | None = None,
) -> Budget:
    """Accelerometer and gyro errors that a position requirement allows, and its inverse.

    Parameters
    ----------
    position_m : float
        Largest position error of one horizontal channel, m.
    outages_s : sequence of float
        Lengths of time without GNSS.
    accel_m_s2, gyro_rad_s : float, optional
        Constant errors of given sensors: how long do they meet the requirement?

    Returns
    -------
    Budget

    Raises
    ------
    ConfigError
        A figure that is not finite and positive.
    """
    _require(position_m=position_m)
    rows = tuple(
        BudgetRow(
            outage_s,
            allowed_accel(position_m, outage_s),
            allowed_accel(position_m, outage_s, within=True),
            allowed_gyro(position_m, outage_s),
        )
        for outage_s in outages_s
    )
    accel = None if accel_m_s2 is None else outage_of_accel(position_m, accel_m_s2)
    gyro = None if gyro_rad_s is None else outage_of_gyro(position_m, gyro_rad_s)
    both = None
    if accel_m_s2 is not None and gyro_rad_s is not None:
        both = _both(position_m, accel_m_s2, gyro_rad_s)
    return Budget(position_m, rows, accel_m_s2, gyro_rad_s, accel, gyro, both)


def linearity_bound(accel_m_s2: float) -> float:
    """Tilt (rad) up to which the linear error model is good.

    There its second-order term ``0.5 g al^2`` equals the error of the accelerometer: ``sqrt(2 da/g)``.
    """
    _require(accel_m_s2=accel_m_s2)
    return math.sqrt(2.0 * accel_m_s2 / GRAVITY_M_S2)


def correction_period(tilt_max_rad: float, *, tilt_rad: float, gyro_rad_s: float, accel_m_s2: float) -> float:
    """Longest time (s) between two feedback corrections for which the tilt stays below a bound.

    Solves ``al_max = al_0 + e T + [(al_0 g + da) T^2/2 + g e T^3/6]/R``. The publication leaves out the
    ``al_0`` in front, the tilt at T = 0; without it the period comes out too long.

    Parameters
    ----------
    tilt_max_rad : float
        Bound, such as :func:`linearity_bound`.
    tilt_rad : float
        Tilt left after a correction.
    gyro_rad_s, accel_m_s2 : float
        Constant errors left after a correction.

    Returns
    -------
    float
        0 if the tilt is there already.
    """
    _require(tilt_max_rad=tilt_max_rad)
    for name, value in {"tilt_rad": tilt_rad, "gyro_rad_s": gyro_rad_s, "accel_m_s2": accel_m_s2}.items():
        if not (math.isfinite(value) and value >= 0.0):
            raise ConfigError("config.range", f"{name} = {value}: must be finite and at least 0")
    if tilt_rad >= tilt_max_rad:
        return 0.0
    g = GRAVITY_M_S2

    def excess(t: float) -> float:
        carried = ((tilt_rad * g + accel_m_s2) * t**2 / 2.0 + g * gyro_rad_s * t**3 / 6.0) / RADIUS_M
        return tilt_rad + gyro_rad_s * t + carried - tilt_max_rad

    return _first_time(excess)


def _require(**values: float) -> None:
    for name, value in values.items():
        if not (math.isfinite(value) and value > 0.0):
            raise ConfigError(
                "config.range",
                f"{name} = {value}: must be finite and greater than 0",
                "give the 1-sigma figure",
            )
