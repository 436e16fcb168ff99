"""How single errors grow in a free INS at rest: the full mechanisation of the engine beside the Schuler pendulum."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from gnssins import _core, units
from gnssins.analysis import text
from gnssins.analysis.budget import growth
from gnssins.analysis.errors import ned_difference
from gnssins.errors import ConfigError
from gnssins.units import NS_PER_S

__all__ = ["CASES", "SchulerCase", "SchulerCurve", "SchulerCurves", "schuler_curves"]

Array = NDArray[np.float64]

#: Period of the pendulum, s: time of the curves if nothing else is asked.
PERIOD_S: Final = 5064.0

_DEG_H: Final = units.GYRO_BIAS["deg/h"]


@dataclass(frozen=True)
class SchulerCase:
    """One constant error of an INS at rest, body axes along north, east, down.

    Parameters
    ----------
    key, text : str
        Name, and what it is.
    tilt_rad, velocity_m_s : tuple of float
        Errors at the start, estimate minus truth, north, east, down: rotation vector phi (rad), velocity (m/s).
    gyro_rad_s, accel_m_s2 : tuple of float
        Constant sensor errors, body axes.
    axis : int
        Axis of the position error that the error drives: 0 north, 1 east.
    at_s : float or None
        Time of the figure in the table; None: the largest error up to the end.
    published_m : float or None
        What the publication states for this error.
    note : str
        What there is to say about that.
    """

    key: str
    text: str
    tilt_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    velocity_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gyro_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    accel_m_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: int = 0
    at_s: float | None = None
    published_m: float | None = None
    note: str = ""

    def closed_form(self, time_s: Array) -> Array:
        """Error of the single channel (m), shape of ``time_s``; zero for errors that do not enter it directly."""
        # a tilt about east drives north, one about north drives east with the other sign
        about, sign = (1, 1.0) if self.axis == 0 else (0, -1.0)
        return growth(
            time_s,
            accel_m_s2=self.accel_m_s2[self.axis],
            gyro_rad_s=-sign * self.gyro_rad_s[about],
            tilt_rad=sign * self.tilt_rad[about],
            velocity_m_s=self.velocity_m_s[self.axis],
        )


#: Errors of the publication, section "errors of a fixed INS".
CASES: Final = (
    SchulerCase(
        "tilt",
        "tilt of 1e-3 rad about east",
        tilt_rad=(0.0, 1e-3, 0.0),
        published_m=1300.0,
        note="1300 m belongs to 1e-4 rad",
    ),
    SchulerCase(
        "gyro-horizontal",
        "horizontal gyro 0.01 deg/h, after 1 h",
        gyro_rad_s=(0.0, 0.01 * _DEG_H, 0.0),
        at_s=3600.0,
        published_m=1300.0,
        note="published for the vertical gyro",
    ),
    SchulerCase(
        "gyro-vertical",
        "vertical gyro 0.01 deg/h, after 1 h",
        gyro_rad_s=(0.0, 0.0, 0.01 * _DEG_H),
        at_s=3600.0,
        published_m=1300.0,
        note="belongs to the horizontal gyro",
    ),
    SchulerCase("velocity", "velocity 1 m/s north", velocity_m_s=(1.0, 0.0, 0.0)),
    SchulerCase(
        "accelerometer",
        "accelerometer 1e-4 g",
        accel_m_s2=(1e-4 * units.STANDARD_GRAVITY_M_S2, 0.0, 0.0),
    ),
)


@dataclass(frozen=True, eq=False)
class SchulerCurve:
    """One case: position error north, east (m) of the full mechanisation (k, 2), and of the pendulum (k,)."""

    case: SchulerCase
    time_s: Array
    position_m: Array
    closed_m: Array

    @property
    def main_m(self) -> Array:
        """Error along the axis that the case drives, m."""
        return np.asarray(self.position_m[:, self.case.axis])

    def figure(self, values: Array) -> float:
        """The number of the table: the value at the time of the case, or the largest one."""
        if self.case.at_s is None:
            return float(np.abs(values).max())
        return float(np.abs(values[int(np.argmin(np.abs(self.time_s - self.case.at_s)))]))

    @property
    def full_m(self) -> float:
        """Horizontal error of the full mechanisation."""
        return self.figure(np.hypot(*self.position_m.T))

    @property
    def pendulum_m(self) -> float | None:
        """The same of the closed form; None where the error does not enter the channel."""
        return self.figure(self.closed_m) or None


@dataclass(frozen=True, eq=False)
class SchulerCurves:
    """All cases at one latitude."""

    lat_deg: float
    curves: Mapping[str, SchulerCurve]

    def __getitem__(self, key: str) -> SchulerCurve:
        return self.curves[key]

    def table(self) -> str:
        """One line per case."""
        rows = []
        for curve in self.curves.values():
            closed = curve.pendulum_m
            published = curve.case.published_m
            rows.append(
                [
                    curve.case.text,
                    text.number(curve.full_m, 4),
                    "-" if closed is None else text.number(closed, 4),
                    "-" if closed is None else f"{curve.full_m / closed:.3f}",
                    "-" if published is None else text.number(published, 4),
                    curve.case.note,
                ]
            )
        title = f"Horizontal error of a free INS at rest at {self.lat_deg:g} deg, height held"
        head = ["error", "full model, m", "pendulum, m", "ratio", "published, m", ""]
        caption = "Largest error within a period of 84.4 min, or at the time named."
        return text.table(title, head, rows, caption, left=(0, 5))

    def to_frame(self) -> pl.DataFrame:
        """All curves as one table: time, then north, east and pendulum (m) of every case."""
        columns: dict[str, Array] = {}
        for key, curve in self.curves.items():
            columns.setdefault("time_s", curve.time_s)
            name = key.replace("-", "_")
            columns[f"{name}_north_m"] = curve.position_m[:, 0]
            columns[f"{name}_east_m"] = curve.position_m[:, 1]
            columns[f"{name}_pendulum_m"] = curve.closed_m
        return pl.DataFrame(columns)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers per case."""
        return {
            "lat_deg": self.lat_deg,
            "cases": {
                key: {
                    "text": curve.case.text,
                    "full_m": curve.full_m,
                    "pendulum_m": curve.pendulum_m,
                    "published_m": curve.case.published_m,
                    "note": curve.case.note,
                }
                for key, curve in self.curves.items()
            },
        }


def schuler_curves(
    lat_deg: float = 55.0,
    cases: Sequence[SchulerCase] = CASES,
    *,
    duration_s: float = PERIOD_S,
    step_s: float = 2.0,
    ellipsoid: str = "wgs84",
) -> SchulerCurves:
    """Let single errors grow in a free INS at rest, its height held.

    The sensors give the increments of rest exactly, plus the error of the case; the NED mechanisation of the engine
    integrates them. Body axes lie along north, east, down.

    Parameters
    ----------
    lat_deg : float
        Latitude.
    cases : sequence of SchulerCase
        Errors; by default those of the publication.
    duration_s, step_s : float
        Length and step of the curves, s.
    ellipsoid : str
        Ellipsoid of the INS.

    Returns
    -------
    SchulerCurves

    Raises
    ------
    ConfigError
        A length or step that gives fewer than two epochs.
    """
    epochs = int(duration_s / step_s * (1.0 + 1e-12)) + 1 if duration_s > 0.0 and step_s > 0.0 else 0
    if epochs < 2:
        text_ = f"duration_s = {duration_s}, step_s = {step_s}: no curve"
        raise ConfigError("config.range", text_, "both must be positive, the step the shorter")
    t_ns = np.rint(np.arange(epochs) * (step_s * NS_PER_S)).astype(np.int64)
    start = np.array([math.radians(lat_deg), 0.0, 0.0]), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    setup = ("ned", ellipsoid, "normal", "one-sample")
    rest_v, rest_q = np.zeros((epochs, 3)), np.tile(start[2], (epochs, 1))
    _, dtheta, dvel = _core.invert_strapdown(*setup, t_ns, start[0], rest_v, rest_q)
    dt = np.diff(t_ns)[:, None] / NS_PER_S
    curves = {}
    for case in cases:
        phi = np.array([case.tilt_rad])
        q0 = _core.quat_mul(_core.rotvec_to_quat(-phi), start[2][None])[0]
        ins = _core.FreeIns(*setup, 0, start[0], np.asarray(case.velocity_m_s), q0)
        lla, _, _ = ins.run(
            t_ns[1:],
            dtheta[1:] + np.asarray(case.gyro_rad_s) * dt,
            dvel[1:] + np.asarray(case.accel_m_s2) * dt,
            np.zeros(epochs - 1),
        )
        truth = np.tile(start[0], (epochs - 1, 1))
        error = np.vstack([np.zeros((1, 2)), ned_difference(lla, truth, ellipsoid)[:, :2]])
        time_s = t_ns / NS_PER_S
        curves[case.key] = SchulerCurve(case, time_s, error, case.closed_form(time_s))
    return SchulerCurves(lat_deg, curves)
