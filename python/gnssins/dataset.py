"""Typed tables of one recording: IMU, GNSS, truth; SI units, body axes forward-right-down, times in whole ns.

Arrays are copied on construction and read-only afterwards, so a table can be shared between runs and threads.
NaN stands for an absent value; what a row lacks is for the engine to judge and count.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError
from .units import NS_PER_S, seconds_to_ns

Array = NDArray[np.float64]
Times = NDArray[np.int64]
Rows = NDArray[np.bool_] | NDArray[np.intp] | slice
ImuKind = Literal["rates", "mean-rates", "increments"]
_Scalar = TypeVar("_Scalar", bound=np.generic)


class _Timed:
    """What all tables with a time column can tell."""

    t_ns: Times

    def __len__(self) -> int:
        return int(self.t_ns.size)

    @property
    def duration_s(self) -> float:
        """Last stamp minus first stamp, s; 0 for less than two rows."""
        return float(self.t_ns[-1] - self.t_ns[0]) / NS_PER_S if len(self) > 1 else 0.0

    @property
    def interval_s(self) -> float:
        """Median step between stamps, s; NaN for less than two rows."""
        return float(np.median(np.diff(self.t_ns))) / NS_PER_S if len(self) > 1 else float("nan")

    @property
    def rate_hz(self) -> float:
        """Rows per second, from the median step; NaN for less than two rows or a zero step."""
        step = self.interval_s
        return 1.0 / step if step > 0.0 else float("nan")

    def _span(self) -> str:
        if not len(self):
            return "empty"
        start, end = self.t_ns[0] / NS_PER_S, self.t_ns[-1] / NS_PER_S
        return f"{len(self)} rows, {start:.3f} to {end:.3f} s, {self.rate_hz:.4g} Hz"


@dataclass(frozen=True, eq=False, repr=False)
class ImuTable(_Timed):
    """Inertial samples in body axes forward-right-down.

    Attributes
    ----------
    t_ns : ndarray of int64, shape (n,)
        Stamps, ns.
    gyro : ndarray, shape (n, 3)
        Angular rate, rad/s; for ``kind="increments"`` angle increments over the interval that ends at the
        stamp, rad.
    accel : ndarray, shape (n, 3)
        Specific force, m/s^2; for increments velocity increments, m/s.
    kind : {"rates", "mean-rates", "increments"}
        Values at the stamp, means over the interval that ends there, or increments over it.

    Raises
    ------
    InputError
        Wrong shape, dtype or kind (``input.shape``, ``input.dtype``, ``input.kind``).
    """

    t_ns: Times
    gyro: Array
    accel: Array
    kind: ImuKind = "rates"

    def __post_init__(self) -> None:
        if self.kind not in get_args(ImuKind):
            known = ", ".join(get_args(ImuKind))
            raise InputError("input.kind", f'imu kind "{self.kind}" is unknown', f"one of: {known}")
        t_ns = _times(self.t_ns, "imu")
        _set(self, t_ns=t_ns)
        _set(self, gyro=_floats(self.gyro, (t_ns.size, 3), "imu", "gyro"))
        _set(self, accel=_floats(self.accel, (t_ns.size, 3), "imu", "accel"))

    def __repr__(self) -> str:
        return f"ImuTable({self._span()}, {self.kind})"

    def select(self, rows: Rows) -> Self:
        """Return the table of some rows, by mask, indices or slice."""
        return replace(self, t_ns=self.t_ns[rows], gyro=self.gyro[rows], accel=self.accel[rows])


@dataclass(frozen=True, eq=False, repr=False)
class GnssTable(_Timed):
    """Fixes of the antenna; NaN where a row lacks a value.

    Attributes
    ----------
    t_ns : ndarray of int64, shape (m,)
        Stamps, ns; the latency is not taken off.
    lla : ndarray, shape (m, 3)
        Latitude (rad), longitude (rad), height above the ellipsoid (m).
    v_n : ndarray, shape (m, 3)
        Velocity north, east, down, m/s.
    var : ndarray, shape (m, 6) or (m, 6, 6)
        Variances, or full covariance, of position north, east, down (m^2) and velocity north, east, down
        (m^2/s^2).

    Raises
    ------
    InputError
        Wrong shape or dtype (``input.shape``, ``input.dtype``).
    """

    t_ns: Times
    lla: Array
    v_n: Array
    var: Array

    def __post_init__(self) -> None:
        t_ns = _times(self.t_ns, "gnss")
        count = t_ns.size
        _set(self, t_ns=t_ns)
        _set(self, lla=_floats(self.lla, (count, 3), "gnss", "lla"))
        _set(self, v_n=_floats(self.v_n, (count, 3), "gnss", "v_n"))
        full = np.ndim(self.var) == 3
        _set(self, var=_floats(self.var, (count, 6, 6) if full else (count, 6), "gnss", "var"))

    @classmethod
    def empty(cls) -> GnssTable:
        """Return a table without rows, for pure inertial navigation."""
        return cls(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 6)))

    def __repr__(self) -> str:
        if not len(self):
            return "GnssTable(empty)"
        parts = [f"{np.mean(self.has_position):.0%} position", f"{np.mean(self.has_velocity):.0%} velocity"]
        return f"GnssTable({self._span()}, {', '.join(parts)})"

    @property
    def has_position(self) -> NDArray[np.bool_]:
        """Rows with latitude, longitude and height, shape (m,)."""
        return np.asarray(np.isfinite(self.lla).all(axis=1))

    @property
    def has_velocity(self) -> NDArray[np.bool_]:
        """Rows with at least the horizontal velocity, shape (m,)."""
        return np.asarray(np.isfinite(self.v_n[:, :2]).all(axis=1))

    @property
    def sd(self) -> Array:
        """Standard deviations (m, 6): m and m/s; NaN where the variance is missing or negative."""
        var = self.var if self.var.ndim == 2 else np.diagonal(self.var, axis1=1, axis2=2)
        return np.sqrt(np.where(var >= 0.0, var, np.nan))

    def select(self, rows: Rows) -> Self:
        """Return the table of some rows, by mask, indices or slice."""
        return replace(self, t_ns=self.t_ns[rows], lla=self.lla[rows], v_n=self.v_n[rows], var=self.var[rows])


@dataclass(frozen=True, eq=False, repr=False)
class TruthTable(_Timed):
    """Reference trajectory of the IMU; NaN where a row lacks a value.

    Attributes
    ----------
    t_ns : ndarray of int64, shape (k,)
        Stamps, ns.
    lla : ndarray, shape (k, 3)
        Latitude (rad), longitude (rad), height above the ellipsoid (m).
    v_n : ndarray, shape (k, 3)
        Velocity north, east, down, m/s.
    q_nb : ndarray, shape (k, 4), or None
        Unit quaternions [w, x, y, z] from body to north-east-down; None if the reference has no attitude at
        all.

    Raises
    ------
    InputError
        Wrong shape or dtype (``input.shape``, ``input.dtype``).
    """

    t_ns: Times
    lla: Array
    v_n: Array
    q_nb: Array | None = None

    def __post_init__(self) -> None:
        t_ns = _times(self.t_ns, "truth")
        _set(self, t_ns=t_ns)
        _set(self, lla=_floats(self.lla, (t_ns.size, 3), "truth", "lla"))
        _set(self, v_n=_floats(self.v_n, (t_ns.size, 3), "truth", "v_n"))
        if self.q_nb is not None:
            _set(self, q_nb=_floats(self.q_nb, (t_ns.size, 4), "truth", "q_nb"))

    def __repr__(self) -> str:
        attitude = "no attitude" if self.q_nb is None else "with attitude"
        return f"TruthTable({self._span()}, {attitude})"

    def select(self, rows: Rows) -> Self:
        """Return the table of some rows, by mask, indices or slice."""
        q_nb = None if self.q_nb is None else self.q_nb[rows]
        return replace(self, t_ns=self.t_ns[rows], lla=self.lla[rows], v_n=self.v_n[rows], q_nb=q_nb)


@dataclass(frozen=True)
class Source:
    """Where a table came from: rows in the file = rows in the table + rows skipped.

    Attributes
    ----------
    path : str
        The file.
    sha256 : str
        Digest of the file as it lies on disk.
    rows : int
        Data rows in the file.
    skipped : Mapping of str to int
        Rows that are not in the table, counted by reason.
    sorted_rows : int
        Rows that were moved because the file was sorted by time.
    """

    path: str
    sha256: str
    rows: int
    skipped: Mapping[str, int] = field(default_factory=dict)
    sorted_rows: int = 0

    @property
    def rows_skipped(self) -> int:
        """All skipped rows."""
        return sum(self.skipped.values())


@dataclass(frozen=True, eq=False)
class Dataset:
    """One recording.

    Attributes
    ----------
    imu : ImuTable
        Inertial samples.
    gnss : GnssTable
        Fixes; may be empty.
    truth : TruthTable or None
        Reference, only to compare with.
    sources : Mapping of str to Source
        File behind each table, by path; empty for simulated data.
    meta : Mapping
        Anything else worth keeping, such as the scenario and seed of a simulation.
    """

    imu: ImuTable
    gnss: GnssTable = field(default_factory=GnssTable.empty)
    truth: TruthTable | None = None
    sources: Mapping[str, Source] = field(default_factory=dict)
    meta: Mapping[str, Any] = field(default_factory=dict)

    def withhold(
        self, windows_s: Sequence[tuple[float, float]], latency_ns: int = 0
    ) -> tuple[Dataset, GnssTable]:
        """Take GNSS rows out of the data, for an outage test.

        Parameters
        ----------
        windows_s : sequence of (from, to)
            Half-open windows [from, to), s on the clock of the IMU.
        latency_ns : int, optional
            Taken off the stamps first: the windows count at the time of validity.

        Returns
        -------
        dataset : Dataset
            Without the rows in the windows.
        withheld : GnssTable
            Those rows.
        """
        valid_ns = self.gnss.t_ns - latency_ns
        out = np.zeros(len(self.gnss), dtype=np.bool_)
        for start_s, end_s in windows_s:
            out |= (valid_ns >= seconds_to_ns(start_s)) & (valid_ns < seconds_to_ns(end_s))
        return replace(self, gnss=self.gnss.select(~out)), self.gnss.select(out)


def _set(table: object, **values: object) -> None:
    """Store a checked array in a frozen dataclass."""
    for name, value in values.items():
        object.__setattr__(table, name, value)


def _times(values: ArrayLike, table: str) -> Times:
    array = np.array(values)
    if array.size and array.dtype.kind not in "iu":
        raise InputError(
            "input.dtype",
            f"{table} t_ns has dtype {array.dtype}, needs whole nanoseconds (int64)",
            "convert without a float in between: at 1e9 s a float64 resolves only 0.1 us",
        )
    return _frozen(array.astype(np.int64), (array.size,), table, "t_ns")


def _floats(values: ArrayLike, shape: tuple[int, ...], table: str, name: str) -> Array:
    try:
        array = np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError) as failure:
        raise InputError(
            "input.dtype", f"{table} {name} is not numeric: {failure}", "give an array of floats"
        ) from None
    return _frozen(array, shape, table, name)


def _frozen(array: NDArray[_Scalar], shape: tuple[int, ...], table: str, name: str) -> NDArray[_Scalar]:
    if array.shape != shape:
        raise InputError(
            "input.shape",
            f"{table} {name} has shape {array.shape}, needs {shape}",
            "one row per epoch, one column per component",
            {"table": table, "name": name, "shape": array.shape},
        )
    array.setflags(write=False)
    return array
