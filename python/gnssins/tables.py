"""Column names and units of the tables that gnssins writes; the only place that knows them.

Inside a :class:`~gnssins.result.Result` everything is SI and radians. Tables are for people and other programs, so
every column carries its unit in its name, angles are in degrees and sensor errors in the units of data sheets.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from gnssins.units import ACCEL_BIAS, GYRO_BIAS, NS_PER_S

__all__ = [
    "AID_SCHEMA",
    "AID_UNITS",
    "EVENT_SCHEMA",
    "INNOVATION_COLUMNS",
    "NAVIGATION_COLUMNS",
    "SD_COLUMNS",
    "State",
    "TableUnit",
    "column_of",
    "heading_deg",
    "seconds",
    "stretches",
    "table_unit",
    "wrap_pi",
]

Array = NDArray[np.float64]

#: Columns of the navigation table before the standard deviations.
NAVIGATION_COLUMNS: Final = (
    "time_s",
    "lat_deg",
    "lon_deg",
    "height_m",
    "v_north_m_s",
    "v_east_m_s",
    "v_down_m_s",
    "roll_deg",
    "pitch_deg",
    "heading_deg",
)

#: Standard deviations, in the order of ``Result.sd``.
SD_COLUMNS: Final = (
    "sd_north_m",
    "sd_east_m",
    "sd_down_m",
    "sd_v_north_m_s",
    "sd_v_east_m_s",
    "sd_v_down_m_s",
    "sd_roll_deg",
    "sd_pitch_deg",
    "sd_heading_deg",
)

#: Components of an innovation, in the order of ``Records.innovation``.
INNOVATION_COLUMNS: Final = (
    "innovation_north_m",
    "innovation_east_m",
    "innovation_down_m",
    "innovation_v_north_m_s",
    "innovation_v_east_m_s",
    "innovation_v_down_m_s",
)

#: Columns of the table of events and of ``events.csv``.
EVENT_SCHEMA: Final[dict[str, type[pl.DataType]]] = {
    "time_s": pl.Float64,
    "code": pl.String,
    "row": pl.Int64,
    "value": pl.Float64,
    "message": pl.String,
}


#: Columns of the table of aids beside GNSS.
AID_SCHEMA: Final[dict[str, type[pl.DataType]]] = {
    "source": pl.String,
    "row": pl.Int64,
    "time_s": pl.Float64,
    "status": pl.String,
    "reason": pl.String,
    "nis": pl.Float64,
    "innovation": pl.Float64,
    "sd_innovation": pl.Float64,
    "unit": pl.String,
}

#: Unit in which that table shows an innovation, with its factor from SI.
AID_UNITS: Final = {"baro": (1.0, "m"), "heading": (math.degrees(1.0), "deg")}


@dataclass(frozen=True)
class State:
    """One state of the filter.

    Parameters
    ----------
    name : str
        Such as ``"gyro_bias_x"``; unique in a filter.
    unit : str
        SI unit of the estimate and of its row of the covariance.
    block : str
        Name of the block that the state belongs to (``"attitude"``, ``"velocity"``, ``"position"`` for the first
        nine).
    kind : str
        Kind of the block, such as ``"gyro_bias"``.
    """

    name: str
    unit: str
    block: str
    kind: str


@dataclass(frozen=True)
class TableUnit:
    """Unit of a state in tables and figures: ``value_table = value_si * factor``."""

    suffix: str
    label: str
    factor: float


_TABLE_UNITS: Final = {
    "rad/s": TableUnit("deg_h", "deg/h", 1.0 / GYRO_BIAS["deg/h"]),
    "m/s^2": TableUnit("mg", "mg", 1.0 / ACCEL_BIAS["mg"]),
    "1": TableUnit("ppm", "ppm", 1e6),
    "rad": TableUnit("mrad", "mrad", 1e3),
    "m": TableUnit("m", "m", 1.0),
    "m/s": TableUnit("m_s", "m/s", 1.0),
}


def table_unit(unit: str) -> TableUnit:
    """Unit in which tables and figures show a block state of SI unit ``unit``."""
    known = _TABLE_UNITS.get(unit)
    return known or TableUnit(unit.replace("^", "").replace("/", "_"), unit, 1.0)


def column_of(state: State) -> str:
    """Column of a block state, such as ``"gyro_bias_x_deg_h"``."""
    return f"{state.name}_{table_unit(state.unit).suffix}"


def seconds(t_ns: NDArray[np.int64]) -> Array:
    """Seconds as floating point, shape as ``t_ns``; the nearest double, for tables and figures only."""
    return t_ns / np.float64(NS_PER_S)


def heading_deg(heading_rad: Array) -> Array:
    """Heading in degrees, in [0, 360)."""
    degrees = np.mod(np.degrees(heading_rad), 360.0)
    return np.where(degrees >= 360.0, 0.0, degrees)


def wrap_pi(angle_rad: Array) -> Array:
    """Angles brought to [-pi, pi)."""
    return np.mod(angle_rad + math.pi, 2.0 * math.pi) - math.pi


def stretches(mask: NDArray[np.bool_], least: int = 1) -> list[tuple[int, int]]:
    """First and past-the-last index of every stretch of True of at least so many samples."""
    change = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in change.reshape(-1, 2) if b - a >= least]
