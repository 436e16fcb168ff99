"""Attitude from recorded sensors: arrays in, one call into the compiled core, :class:`Attitude` out."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gnssins import _core
from gnssins.ahrs.laws import Form, Law
from gnssins.analysis import text
from gnssins.dataset import Dataset, ImuKind, ImuTable
from gnssins.errors import ConfigError, InputError
from gnssins.units import NS_PER_S, STANDARD_GRAVITY_M_S2

__all__ = ["FLAGS", "Attitude", "References", "Sensors", "run"]

Array = NDArray[np.float64]

#: Bit of every flag in :attr:`Attitude.flags`, by name.
FLAGS: Final[Mapping[str, int]] = MappingProxyType(dict(_core.ahrs_flags()))


@dataclass(frozen=True)
class References:
    """What the published laws compare the readings with. Tolerances are off unless given, as published.

    Parameters
    ----------
    declination_rad : float
        Magnetic declination, east positive.
    gravity_m_s2 : float
        Gravity.
    accel_tolerance : float, optional
        Largest relative departure of the specific force from gravity; beyond it the gyro goes alone.
    field : float
        Strength of the magnetic field, in the unit of the magnetometer.
    field_tolerance : float, optional
        Largest relative departure of that strength; beyond it the heading is the gyro's.
    dip_rad : float
        Dip of the field, down positive.
    dip_tolerance_rad : float, optional
        Largest departure of the dip; beyond it the heading is the gyro's.
    """

    declination_rad: float = 0.0
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2
    accel_tolerance: float | None = None
    field: float = 1.0
    field_tolerance: float | None = None
    dip_rad: float = 0.0
    dip_tolerance_rad: float | None = None


class Sensors:
    """Gyro, accelerometer and magnetometer of one recording, body axes forward-right-down.

    Parameters
    ----------
    t_ns : array_like of int, shape (n,)
        Stamps, ns, ascending.
    gyro : array_like, shape (n, 3)
        Angular rate, rad/s (increments: rad). A row that is not finite leaves its interval to the next one.
    accel : array_like, shape (n, 3)
        Specific force, m/s² (increments: m/s). A row that is not finite or zero leaves the gyro alone.
    mag : array_like, shape (n, 3), optional
        Magnetic field, any unit. A row that is not finite or zero leaves the heading to the gyro.
    kind : {"rates", "mean-rates", "increments"}
        Values at the stamp, means over the interval that ends there, or increments over it.

    Raises
    ------
    InputError
        Wrong shape or dtype.
    """

    def __init__(
        self,
        t_ns: ArrayLike,
        gyro: ArrayLike,
        accel: ArrayLike,
        mag: ArrayLike | None = None,
        kind: ImuKind = "rates",
    ) -> None:
        self.imu = ImuTable(np.asarray(t_ns), np.asarray(gyro), np.asarray(accel), kind)
        self.mag = None if mag is None else _rows(mag, len(self.imu))

    @classmethod
    def of(cls, data: Sensors | Dataset | ImuTable, mag: ArrayLike | None = None) -> Sensors:
        """Take a data set or an IMU table with a magnetometer beside it, row for row."""
        if isinstance(data, Sensors):
            return data if mag is None else cls.of(data.imu, mag)
        imu = data.imu if isinstance(data, Dataset) else data
        return cls(imu.t_ns, imu.gyro, imu.accel, mag, imu.kind)

    def __len__(self) -> int:
        return len(self.imu)


def _rows(mag: ArrayLike, count: int) -> Array:
    values = np.array(mag, dtype=np.float64)
    if values.shape != (count, 3):
        raise InputError(
            "input.shape",
            f"mag: need an array of shape ({count}, 3), got {values.shape}",
            "one row per IMU row, NaN where the magnetometer has no sample",
        )
    values.flags.writeable = False
    return values


@dataclass(frozen=True, eq=False)
class Attitude:
    """Attitude over time.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (n,)
        Stamps of the sensors, ns.
    q_nb : ndarray, shape (n, 4)
        Unit quaternions [w, x, y, z], body to north-east-down; the identity until the first usable reading.
    bias : ndarray, shape (n, 3)
        Estimated gyro bias (rad/s), zero for the published laws.
    flags : ndarray of uint16, shape (n,)
        What every row did; bits in :data:`FLAGS`.
    element_angles : ndarray, shape (n, 3), or None
        Roll, pitch, heading (rad) read from single direction cosines, as published; only laws that have them.
    method : str
        Estimator.
    settings : mapping
        Its settings.
    attitude_sd, bias_sd : ndarray, shape (n, 3), or None
        1σ of the attitude error about north, east, down (rad) and of the gyro bias (rad/s); only the filter has them.
    """

    t_ns: NDArray[np.int64]
    q_nb: Array
    bias: Array
    flags: NDArray[np.uint16]
    element_angles: Array | None
    method: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    attitude_sd: Array | None = None
    bias_sd: Array | None = None

    def __len__(self) -> int:
        return int(self.t_ns.size)

    @property
    def time_s(self) -> Array:
        """Stamps, s, shape (n,)."""
        return self.t_ns / NS_PER_S

    @cached_property
    def euler(self) -> Array:
        """Roll, pitch, heading (rad), shape (n, 3)."""
        return _core.quat_to_euler(self.q_nb)

    def has(self, flag: str) -> NDArray[np.bool_]:
        """Rows with a flag, shape (n,)."""
        if flag not in FLAGS:
            raise ConfigError("config.choice", f'flag "{flag}" is not known', f"one of: {', '.join(FLAGS)}")
        return np.asarray(self.flags & FLAGS[flag] != 0)

    @property
    def counts(self) -> dict[str, int]:
        """Rows, and rows with each flag."""
        return {"rows": len(self)} | {name: int(self.has(name).sum()) for name in FLAGS}

    def table(self) -> str:
        """How many rows did what."""
        rows = [[name.replace("_", " "), str(n)] for name, n in self.counts.items() if n]
        return text.table(f"Attitude by {self.method}", ["", "rows"], rows)

    def to_dict(self) -> dict[str, Any]:
        """Method, settings, counts, last attitude and bias."""
        last = {"q_nb": self.q_nb[-1].tolist(), "bias_rad_s": self.bias[-1].tolist()} if len(self) else {}
        return {"method": self.method, "settings": dict(self.settings), "counts": self.counts, "last": last}


def run(
    data: Sensors | Dataset | ImuTable,
    method: Law | str = "filter",
    *,
    mag: ArrayLike | None = None,
    references: References | None = None,
    form: Form | None = None,
    initial_q_nb: Sequence[float] | None = None,
    rate_n: Sequence[float] | None = None,
    settings: Mapping[str, Any] | None = None,
    max_gap_s: float = 1.0,
) -> Attitude:
    """Estimate the attitude over a recording.

    >>> from gnssins import ahrs
    >>> result = ahrs.run(sensors, ahrs.Cross(k=42.8, n=13.3))  # doctest: +SKIP
    >>> result = ahrs.run(dataset, mag=field, settings={"declination_rad": 0.1})  # doctest: +SKIP

    Parameters
    ----------
    data : Sensors, Dataset or ImuTable
        Readings.
    method : Law or str
        A published law with its gains (:class:`Positional`, :class:`Integral`, :class:`Cross`,
        :class:`Quaternion`, :class:`Levelling`), or ``"filter"``: gyro bias in body axes, disturbed references
        rejected.
    mag : array_like, shape (n, 3), optional
        Magnetometer beside the rows of ``data``.
    references : References, optional
        Declination, gravity, tolerances of a published law.
    form : {"rotation", "elements"}, optional
        For direction cosines: what keeps them a rotation.
    initial_q_nb : sequence of four floats, optional
        Attitude at the first row; left out: from the first usable readings.
    rate_n : sequence of three floats, optional
        Rate of the navigation axes against inertial space along north, east, down (rad/s): the Earth's, and the
        vehicle's over it. Left out: zero, which costs a tilt of that rate over k. Published laws only.
    settings : mapping, optional
        Further settings by the names of the core; where both name one, these count.
    max_gap_s : float
        Longest interval between usable rows.

    Returns
    -------
    Attitude

    Raises
    ------
    InputError
        Shapes; unknown or ill-typed settings (``config.json`` raises a :class:`ConfigError`).
    ConfigError
        A gain or setting out of range, such as a cross gain beyond its bound.
    TimeOrderError, GapError
        A stamp before its predecessor, an interval longer than ``max_gap_s``; with the row.
    """
    sensors = Sensors.of(data, mag)
    found = {} if isinstance(method, str) else method.settings()
    for key, value in (("form", form), ("initial_q_nb", initial_q_nb), ("rate_n", rate_n)):
        if value is not None:
            found[key] = value if isinstance(value, str) else [float(x) for x in value]
    if references is not None:
        found["references"] = asdict(references)
    found |= settings or {}
    name = method if isinstance(method, str) else method.method
    config = {
        "method": name,
        "settings": found,
        "input": sensors.imu.kind,
        "max_gap_ns": round(max_gap_s * NS_PER_S),
    }
    imu = sensors.imu
    columns = _core.ahrs_run(json.dumps(config), imu.t_ns, imu.gyro, imu.accel, sensors.mag)
    elements = columns["elements"] if len(columns["elements"]) == len(imu) else None
    sd = columns["sd"] if len(columns["sd"]) == len(imu) else None
    attitude_sd, bias_sd = (None, None) if sd is None else (sd[:, :3], sd[:, 3:])
    return Attitude(
        imu.t_ns,
        columns["q_nb"],
        columns["bias"],
        columns["flags"],
        elements,
        name,
        found,
        attitude_sd,
        bias_sd,
    )
