"""What a run leaves behind: estimates, their standard deviations, one record per measurement, events and counts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import polars as pl
from numpy.typing import NDArray

from gnssins import tables
from gnssins.tables import State

if TYPE_CHECKING:
    import pandas

__all__ = ["STATUS", "WITHHELD", "AidRecords", "Covariance", "Event", "Linearisation", "Records", "Result"]

Array = NDArray[np.float64]
Times = NDArray[np.int64]

#: Meaning of ``Records.status``.
STATUS: Final = ("used", "rejected", "late", "bad", "withheld")

#: Status of a fix that the configuration kept away from the filter.
WITHHELD: Final = STATUS.index("withheld")


class Covariance(NamedTuple):
    """Snapshots of the error-state covariance, NED axes, order of ``Result.states``, SI units."""

    t_ns: Times
    matrix: Array


@dataclass(frozen=True)
class Event:
    """Something worth knowing that happened during a run.

    Attributes
    ----------
    t_ns : int
        Time.
    code : str
        Stable name such as ``"imu.gap"``.
    row : int
        Row of the IMU or GNSS table, from 0.
    message : str
        What happened, with the unit of ``value``.
    value : float or None
        The number that belongs to it: NIS, seconds, factor.
    """

    t_ns: int
    code: str
    row: int
    message: str
    value: float | None = None


def finite(value: float) -> float | None:
    """Return a number, or None for one that is not finite."""
    return float(value) if np.isfinite(value) else None


@dataclass(frozen=True, eq=False)
class Records:
    """One entry per GNSS row that the run saw, in the order of the input; all arrays have j rows.

    Parameters
    ----------
    row : ndarray of int, shape (j,)
        Row of the GNSS table.
    t_ns : ndarray of int, shape (j,)
        Time of validity.
    status : ndarray of uint8, shape (j,)
        Index into :data:`STATUS`.
    dof : ndarray of uint8, shape (j,)
        Number of components compared with the prediction.
    nis : ndarray, shape (j,)
        Normalised innovation squared on the prior; NaN when none was computed.
    innovation : ndarray, shape (j, 6)
        Measured minus predicted: position N, E, D (m), velocity N, E, D (m/s); NaN where absent.
    innovation_cov : ndarray, shape (j, 6, 6)
        Its covariance; NaN where absent.
    reason : sequence of str
        Why a row, or a part of it, was not used; empty when all was.
    lla : ndarray, shape (j, 3)
        The fix itself, at the antenna: latitude, longitude (rad), height (m); NaN where absent.
    v_n : ndarray, shape (j, 3)
        Its velocity (m/s, NED); NaN where absent.
    refused : ndarray of uint8, shape (j,)
        Components that were dropped, as bits: 1, 2, 4 position, 8, 16, 32 velocity.
    """

    row: Times
    t_ns: Times
    status: NDArray[np.uint8]
    dof: NDArray[np.uint8]
    nis: Array
    innovation: Array
    innovation_cov: Array
    reason: Sequence[str]
    lla: Array
    v_n: Array
    refused: NDArray[np.uint8]

    def is_status(self, *names: str) -> NDArray[np.bool_]:
        """Mask (j,) of the rows with one of these statuses (see :data:`STATUS`)."""
        return np.isin(self.status, [STATUS.index(name) for name in names])


@dataclass(frozen=True, eq=False)
class AidRecords:
    """One entry per row of an aid with one value, in the order of the input; all arrays have shape (j,).

    Parameters
    ----------
    row : ndarray of int
        Row of the table of the aid.
    t_ns : ndarray of int
        Time of validity.
    status : ndarray of uint8
        Index into :data:`STATUS`.
    nis : ndarray
        Normalised innovation squared on the prior; NaN when none was computed.
    innovation : ndarray
        Measured minus predicted: m for heights, rad for headings; NaN when not computed.
    variance : ndarray
        Its variance.
    reason : sequence of str
        Why a row was not used; empty when it was.
    """

    row: Times
    t_ns: Times
    status: NDArray[np.uint8]
    nis: Array
    innovation: Array
    variance: Array
    reason: Sequence[str]

    def is_status(self, *names: str) -> NDArray[np.bool_]:
        """Mask (j,) of the rows with one of these statuses (see :data:`STATUS`)."""
        return np.isin(self.status, [STATUS.index(name) for name in names])


@dataclass(frozen=True, eq=False)
class Linearisation:
    """The linearised system along a run, one entry per measurement of any source (``[run] linearise``).

    With x the error states, ``x[k] = phi[k] x[k-1]`` up to noise and ``predicted - measured = h[k] x[k] - noise``. The
    feedback of estimates into the navigation state turns the attitude errors by terms of second order, which are left
    out.

    Parameters
    ----------
    t_ns : ndarray of int, shape (m,)
        Times of validity.
    phi : ndarray, shape (m, n, n)
        Transition from the measurement before, at first from the start.
    h : ndarray, shape (m, 6, n)
        Rows of the measurement; NaN where a component is absent.
    r : ndarray, shape (m, 6, 6)
        Noise covariance; NaN where absent.
    lla, q_nb : ndarray, shapes (m, 3) and (m, 4)
        Position (rad, rad, m) and attitude (body to NED) at which the rows hold.
    axes : {"ned", "ecef"}
        Axes of the nine navigation errors.
    states : tuple of State
        Names and units, SI.
    """

    t_ns: Times
    phi: Array
    h: Array
    r: Array
    lla: Array
    q_nb: Array
    axes: str
    states: tuple[State, ...]

    def __len__(self) -> int:
        return int(self.t_ns.size)


@dataclass(frozen=True, eq=False)
class Result:
    """Trajectory and everything around it; all arrays SI and radians, one row per output epoch.

    Made by :func:`gnssins.run` or :meth:`Result.open`.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (k,)
        Time, nanoseconds of the time scale of the IMU file.
    lla : ndarray, shape (k, 3)
        Latitude, longitude (rad), ellipsoidal height (m) of the IMU.
    v_n : ndarray, shape (k, 3)
        Velocity over ground, NED (m/s).
    rpy : ndarray, shape (k, 3)
        Roll, pitch, heading (rad), heading in [-pi, pi).
    q_nb : ndarray, shape (k, 4)
        Attitude, body (FRD) to NED, scalar first.
    sd : ndarray, shape (k, 9)
        Standard deviations: position N, E, D (m), velocity N, E, D (m/s), roll, pitch, heading (rad).
    x, x_sd : ndarray, shape (k, m)
        Block states and their standard deviations, SI.
    states : tuple of State
        All 9 + m states in the order of the covariance.
    covariance : Covariance
        Snapshots, shapes (c,) and (c, n, n); empty when the configuration asks for none.
    records : Records
        One entry per GNSS row.
    log : tuple of Event
        Events in order of time.
    counts : mapping
        ``counts["imu"]``, ``counts["gnss"]`` and, where they were fed, ``counts["baro"]`` and ``counts["heading"]``:
        in, used, rejected, late, bad; for GNSS and headings also withheld.
    metadata : mapping
        Versions, configuration, input hashes, seed, wall time: what ``run.toml`` holds.
    final_state : bytes
        State of the engine at the end, for :meth:`gnssins.Navigator.restore`.
    aids : mapping of str to AidRecords
        Records of ``"baro"`` and ``"heading"``, where they were fed.
    linearisation : Linearisation or None
        The linearised system, where ``[run] linearise`` asks for it; not saved.
    """

    t_ns: Times
    lla: Array
    v_n: Array
    rpy: Array
    q_nb: Array
    sd: Array
    x: Array
    x_sd: Array
    states: tuple[State, ...]
    covariance: Covariance
    records: Records
    log: tuple[Event, ...]
    counts: Mapping[str, Mapping[str, int]]
    metadata: Mapping[str, Any] = field(default_factory=dict)
    final_state: bytes = b""
    aids: Mapping[str, AidRecords] = field(default_factory=dict)
    linearisation: Linearisation | None = None

    def __len__(self) -> int:
        return int(self.t_ns.size)

    def __repr__(self) -> str:
        if not len(self):
            return "Result(empty)"
        used, seen = self.counts["gnss"]["used"], self.counts["gnss"]["in"]
        first, last = tables.seconds(self.t_ns[[0, -1]])
        found = len(self.metadata.get("finding", ()))
        said = f", {found} finding{'s' if found > 1 else ''}" if found else ""
        return (
            f"Result({len(self)} epochs from {first:.3f} s to {last:.3f} s, {len(self.states)} states, "
            f"{used} of {seen} fixes used, {len(self.log)} events{said})"
        )

    @property
    def block_states(self) -> tuple[State, ...]:
        """States behind the nine navigation errors, in the order of the columns of ``x``."""
        return self.states[9:]

    @property
    def time_s(self) -> Array:
        """Time in seconds, shape (k,)."""
        return tables.seconds(self.t_ns)

    @cached_property
    def navigation(self) -> pl.DataFrame:
        """The trajectory as a table: one row per epoch, degrees and data-sheet units (see :mod:`gnssins.tables`)."""
        columns: dict[str, Array] = {"time_s": self.time_s}
        values = np.column_stack(
            [
                np.degrees(self.lla[:, :2]),
                self.lla[:, 2],
                self.v_n,
                np.degrees(self.rpy[:, :2]),
                tables.heading_deg(self.rpy[:, 2]),
            ]
        )
        columns.update(zip(tables.NAVIGATION_COLUMNS[1:], values.T, strict=True))
        sd = np.column_stack([self.sd[:, :6], np.degrees(self.sd[:, 6:])])
        columns.update(zip(tables.SD_COLUMNS, sd.T, strict=True))
        for i, state in enumerate(self.block_states):
            name, factor = tables.column_of(state), tables.table_unit(state.unit).factor
            columns[name] = self.x[:, i] * factor
            columns[f"sd_{name}"] = self.x_sd[:, i] * factor
        return pl.DataFrame(columns)

    @cached_property
    def measurements(self) -> pl.DataFrame:
        """One row per GNSS row of the input: the fix, what became of it, its innovation and the innovation's sd.

        ``innovation_cov`` is the covariance of the innovation, 36 numbers row by row.
        """
        r = self.records
        columns: dict[str, Any] = {
            "row": r.row,
            "time_s": tables.seconds(r.t_ns),
            "source": pl.Series(["gnss"] * r.row.size, dtype=pl.String),
            "status": pl.Series([STATUS[s] for s in r.status], dtype=pl.String),
            "reason": pl.Series(list(r.reason), dtype=pl.String),
            "dof": r.dof,
            "nis": r.nis,
            "refused": r.refused,
        }
        fix = np.column_stack([np.degrees(r.lla[:, :2]), r.lla[:, 2], r.v_n])
        columns.update(zip(tables.NAVIGATION_COLUMNS[1:7], fix.T, strict=True))
        columns.update(zip(tables.INNOVATION_COLUMNS, r.innovation.T, strict=True))
        sd = np.sqrt(np.einsum("kii->ki", r.innovation_cov))
        columns.update((f"sd_{n}", s) for n, s in zip(tables.INNOVATION_COLUMNS, sd.T, strict=True))
        flat = np.ascontiguousarray(r.innovation_cov.reshape(-1, 36))
        columns["innovation_cov"] = pl.Series(flat, dtype=pl.Array(pl.Float64, 36))
        return pl.DataFrame(columns)

    @cached_property
    def aid_measurements(self) -> pl.DataFrame:
        """One row per row of the aids beside GNSS: heights in m, headings in deg."""
        frames = []
        for source, r in self.aids.items():
            factor, unit = tables.AID_UNITS[source]
            columns = {
                "source": pl.Series([source] * r.row.size, dtype=pl.String),
                "row": r.row,
                "time_s": tables.seconds(r.t_ns),
                "status": pl.Series([STATUS[s] for s in r.status], dtype=pl.String),
                "reason": pl.Series(list(r.reason), dtype=pl.String),
                "nis": r.nis,
                "innovation": r.innovation * factor,
                "sd_innovation": np.sqrt(r.variance) * factor,
                "unit": pl.Series([unit] * r.row.size, dtype=pl.String),
            }
            frames.append(pl.DataFrame(columns, schema=tables.AID_SCHEMA))
        return pl.concat(frames) if frames else pl.DataFrame(schema=tables.AID_SCHEMA)

    @cached_property
    def events(self) -> pl.DataFrame:
        """Events as a table: ``time_s``, ``code``, ``row``, ``value`` (unit in the message), ``message``."""
        times = np.array([e.t_ns for e in self.log], dtype=np.int64)
        return pl.DataFrame(
            {
                "time_s": tables.seconds(times),
                "code": [e.code for e in self.log],
                "row": [e.row for e in self.log],
                "value": [e.value for e in self.log],
                "message": [e.message for e in self.log],
            },
            schema=tables.EVENT_SCHEMA,
        )

    def event_counts(self) -> dict[str, int]:
        """How often each event code occurred, most frequent first."""
        return dict(Counter(event.code for event in self.log).most_common())

    def outages(self) -> NDArray[np.int64]:
        """The withheld stretches that the configuration asked for, shape (o, 2): start and end, nanoseconds."""
        windows = self.metadata.get("outages_ns", [])
        return np.asarray(windows, dtype=np.int64).reshape(-1, 2)

    def save(self, folder: str | Path) -> Path:
        """Write the result to a folder (made if absent); see :mod:`gnssins.storage` for the files.

        Every file is written beside its final name and renamed, ``run.toml`` last: a folder without it is not a
        complete result.
        """
        from gnssins import storage

        return storage.save(self, folder)

    @classmethod
    def open(cls, folder: str | Path) -> Result:
        """Read a result that :meth:`save` wrote.

        Raises
        ------
        MissingFileError
            The folder holds no complete result.
        InputError
            A file of the folder does not fit the others.
        """
        from gnssins import storage

        return storage.load(folder)

    def to_pandas(self) -> pandas.DataFrame:
        """The navigation table as a pandas frame; needs pandas."""
        try:
            import pandas
        except ImportError as error:
            message = 'to_pandas() needs pandas; add it with: pip install "gnssins[pandas]"'
            raise ImportError(message) from error
        return pandas.DataFrame({c.name: c.to_numpy() for c in self.navigation})

    def to_csv(self, path: str | Path) -> Path:
        """Write the navigation table as CSV (gzip when the name ends in ``.gz``)."""
        from gnssins import export

        return export.write_csv(self.navigation, path)

    def to_kml(self, path: str | Path, *, name: str = "") -> Path:
        """Write the track for Google Earth and other viewers of KML."""
        from gnssins import export

        return export.write_kml(self, path, name=name)
