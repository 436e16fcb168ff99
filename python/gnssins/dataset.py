"""Typed tables of one recording: IMU, GNSS, other aids, truth; SI units, body axes forward-right-down, times in ns.

Arrays are copied on construction and read-only afterwards, so a table can be shared between runs and threads.
NaN stands for an absent value; what a row lacks is for the engine to judge and count.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray

from .errors import InputError
from .rows import Array, Rows, Timed, Times, floats, marks, store, times
from .units import seconds_to_ns

__all__ = [
    "Array",
    "BaroTable",
    "Dataset",
    "GnssTable",
    "HeadingTable",
    "ImuKind",
    "ImuPiece",
    "ImuTable",
    "Rows",
    "Source",
    "Times",
    "TruthTable",
]

ImuKind = Literal["rates", "mean-rates", "increments"]


@dataclass(frozen=True, eq=False, repr=False)
class ImuTable(Timed):
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
        t_ns = times(self.t_ns, "imu")
        store(self, t_ns=t_ns)
        store(self, gyro=floats(self.gyro, (t_ns.size, 3), "imu", "gyro"))
        store(self, accel=floats(self.accel, (t_ns.size, 3), "imu", "accel"))

    @classmethod
    def empty(cls, kind: ImuKind = "rates") -> ImuTable:
        """Return a table without rows."""
        return cls(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)), kind)

    @classmethod
    def of_own(cls, t_ns: Times, gyro: Array, accel: Array, kind: ImuKind) -> ImuTable:
        """Return a table of arrays that nobody else holds, of the right shapes and types: without a copy."""
        return cls.empty(kind)._with(t_ns=t_ns, gyro=gyro, accel=accel)

    @classmethod
    def joined(cls, one: ImuTable, other: ImuTable) -> ImuTable:
        """Return the rows of two tables of the same kind, one after the other."""
        return cls(
            np.concatenate([one.t_ns, other.t_ns]),
            np.concatenate([one.gyro, other.gyro]),
            np.concatenate([one.accel, other.accel]),
            one.kind,
        )

    def __repr__(self) -> str:
        return f"ImuTable({self.span()}, {self.kind})"

    def select(self, rows: Rows) -> Self:
        """Return the table of some rows, by mask, indices or slice."""
        return self._with(t_ns=self.t_ns[rows], gyro=self.gyro[rows], accel=self.accel[rows])


@dataclass(frozen=True, eq=False, repr=False)
class GnssTable(Timed):
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
    new_constellation : ndarray of bool, shape (m,), or None
        Rows at which the receiver changed the set of satellites that it uses, so that its correlated errors
        jumped; None if it does not tell.

    Raises
    ------
    InputError
        Wrong shape or dtype (``input.shape``, ``input.dtype``).
    """

    t_ns: Times
    lla: Array
    v_n: Array
    var: Array
    new_constellation: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        t_ns = times(self.t_ns, "gnss")
        count = t_ns.size
        store(self, t_ns=t_ns)
        store(self, lla=floats(self.lla, (count, 3), "gnss", "lla"))
        store(self, v_n=floats(self.v_n, (count, 3), "gnss", "v_n"))
        full = np.ndim(self.var) == 3
        store(self, var=floats(self.var, (count, 6, 6) if full else (count, 6), "gnss", "var"))
        if self.new_constellation is not None:
            store(
                self, new_constellation=marks(self.new_constellation, (count,), "gnss", "new_constellation")
            )

    @classmethod
    def empty(cls) -> GnssTable:
        """Return a table without rows, for pure inertial navigation."""
        return cls(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 6)))

    def __repr__(self) -> str:
        if not len(self):
            return "GnssTable(empty)"
        parts = [f"{np.mean(self.has_position):.0%} position", f"{np.mean(self.has_velocity):.0%} velocity"]
        return f"GnssTable({self.span()}, {', '.join(parts)})"

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
        changed = None if self.new_constellation is None else self.new_constellation[rows]
        return self._with(
            t_ns=self.t_ns[rows],
            lla=self.lla[rows],
            v_n=self.v_n[rows],
            var=self.var[rows],
            new_constellation=changed,
        )


@dataclass(frozen=True, eq=False, repr=False)
class BaroTable(Timed):
    """Heights of a barometric altimeter.

    Attributes
    ----------
    t_ns : ndarray of int64, shape (m,)
        Stamps, ns; the latency is not taken off.
    height_m : ndarray, shape (m,)
        Height above the ellipsoid, m, with the slowly varying error of the altimeter in it; NaN where missing.
    var : ndarray, shape (m,)
        Variance of the white noise, m^2.

    Raises
    ------
    InputError
        Wrong shape or dtype (``input.shape``, ``input.dtype``).
    """

    t_ns: Times
    height_m: Array
    var: Array

    def __post_init__(self) -> None:
        t_ns = times(self.t_ns, "baro")
        store(self, t_ns=t_ns)
        store(self, height_m=floats(self.height_m, (t_ns.size,), "baro", "height_m"))
        store(self, var=floats(self.var, (t_ns.size,), "baro", "var"))

    @classmethod
    def empty(cls) -> BaroTable:
        """Return a table without rows."""
        return cls(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))

    def __repr__(self) -> str:
        return f"BaroTable({self.span()})"

    def select(self, rows: Rows) -> Self:
        """Return the table of some rows, by mask, indices or slice."""
        return self._with(t_ns=self.t_ns[rows], height_m=self.height_m[rows], var=self.var[rows])


@dataclass(frozen=True, eq=False, repr=False)
class HeadingTable(Timed):
    """Headings of a receiver with two antennas.

    Attributes
    ----------
    t_ns : ndarray of int64, shape (m,)
        Stamps, ns; the latency is not taken off.
    heading_rad : ndarray, shape (m,)
        Heading of the forward axis of the body, rad, clockwise from true north, any turn; NaN where missing.
    var : ndarray, shape (m,)
        Variance, rad^2.

    Raises
    ------
    InputError
        Wrong shape or dtype (``input.shape``, ``input.dtype``).
    """

    t_ns: Times
    heading_rad: Array
    var: Array

    def __post_init__(self) -> None:
        t_ns = times(self.t_ns, "heading")
        store(self, t_ns=t_ns)
        store(self, heading_rad=floats(self.heading_rad, (t_ns.size,), "heading", "heading_rad"))
        store(self, var=floats(self.var, (t_ns.size,), "heading", "var"))

    @classmethod
    def empty(cls) -> HeadingTable:
        """Return a table without rows."""
        return cls(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))

    def __repr__(self) -> str:
        return f"HeadingTable({self.span()})"

    def select(self, rows: Rows) -> Self:
        """Return the table of some rows, by mask, indices or slice."""
        return self._with(t_ns=self.t_ns[rows], heading_rad=self.heading_rad[rows], var=self.var[rows])


@dataclass(frozen=True, eq=False, repr=False)
class TruthTable(Timed):
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
        t_ns = times(self.t_ns, "truth")
        store(self, t_ns=t_ns)
        store(self, lla=floats(self.lla, (t_ns.size, 3), "truth", "lla"))
        store(self, v_n=floats(self.v_n, (t_ns.size, 3), "truth", "v_n"))
        if self.q_nb is not None:
            store(self, q_nb=floats(self.q_nb, (t_ns.size, 4), "truth", "q_nb"))

    def __repr__(self) -> str:
        attitude = "no attitude" if self.q_nb is None else "with attitude"
        return f"TruthTable({self.span()}, {attitude})"

    def select(self, rows: Rows) -> Self:
        """Return the table of some rows, by mask, indices or slice."""
        q_nb = None if self.q_nb is None else self.q_nb[rows]
        return self._with(t_ns=self.t_ns[rows], lla=self.lla[rows], v_n=self.v_n[rows], q_nb=q_nb)


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


@dataclass(frozen=True)
class ImuPiece:
    """Some rows of an IMU log.

    Attributes
    ----------
    table : ImuTable
        The rows.
    source : Source
        Counts of these rows, without the digest of the file.
    share : float
        Share of the file that is read, 0 to 1.
    """

    table: ImuTable
    source: Source
    share: float


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
    baro : BaroTable
        Heights of a barometric altimeter; may be empty.
    heading : HeadingTable
        Headings of a receiver with two antennas; may be empty.
    """

    imu: ImuTable
    gnss: GnssTable = field(default_factory=GnssTable.empty)
    truth: TruthTable | None = None
    sources: Mapping[str, Source] = field(default_factory=dict)
    meta: Mapping[str, Any] = field(default_factory=dict)
    baro: BaroTable = field(default_factory=BaroTable.empty)
    heading: HeadingTable = field(default_factory=HeadingTable.empty)

    def withhold(
        self, windows_s: Sequence[tuple[float, float]], latency_ns: int = 0
    ) -> tuple[Dataset, GnssTable]:
        """Take GNSS rows out of the data, for an outage test.

        Headings come from the same satellites, so those in the windows are taken out too, by their stamps.

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
        out = _inside(self.gnss.t_ns - latency_ns, windows_s)
        lost = _inside(self.heading.t_ns, windows_s)
        data = replace(self, gnss=self.gnss.select(~out), heading=self.heading.select(~lost))
        return data, self.gnss.select(out)


def _inside(t_ns: Times, windows_s: Sequence[tuple[float, float]]) -> NDArray[np.bool_]:
    """Stamps inside any of the half-open windows."""
    inside = np.zeros(t_ns.size, dtype=np.bool_)
    for start_s, end_s in windows_s:
        inside |= (t_ns >= seconds_to_ns(start_s)) & (t_ns < seconds_to_ns(end_s))
    return inside
