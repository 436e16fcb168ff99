"""The generic CSV reader: column names, units and axes come from the configuration.

Every row of a file is in the table or counted in :attr:`gnssins.dataset.Source.skipped` with a reason. Values
that are missing or not finite are passed on as they are: the engine judges them and counts the row as bad.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..config import BaroConfig, GnssConfig, HeadingConfig, ImuConfig, TruthConfig, axes_matrix
from ..dataset import BaroTable, GnssTable, HeadingTable, ImuPiece, ImuTable, Source, TruthTable
from ..errors import ConfigError, InputError
from ..units import DEG_TO_RAD
from .cells import numbers
from .clean import read_clean
from .text import TextTable, read_text, text_pieces

Array = NDArray[np.float64]

_TRUTH_POSITION = ("lat_deg", "lon_deg", "height_m")
_TRUTH_VELOCITY = ("vn", "ve", "vd")
_TRUTH_EULER = ("roll_deg", "pitch_deg", "heading_deg")
_TRUTH_QUATERNION = ("qw", "qx", "qy", "qz")


class CsvFormat:
    """Delimited text with one header line, plain or gzip."""

    name = "csv"
    suffixes: tuple[str, ...] = (".csv", ".csv.gz", ".txt", ".txt.gz", ".tsv", ".tsv.gz")
    clean = True
    """Whether to try the short way of :mod:`gnssins.io.clean`."""
    table = staticmethod(read_text)
    pieces = staticmethod(text_pieces)

    def read_imu(self, path: Path, config: ImuConfig) -> tuple[ImuTable, Source]:
        """Read an IMU log into SI units and forward-right-down axes.

        Parameters
        ----------
        path : Path
            The file.
        config : ImuConfig
            Its columns, units and axes, and what to do with bad rows.

        Returns
        -------
        table : ImuTable
            Rows in the order of the file, or sorted by time with ``on_backwards = "sort"``.
        source : Source
            Digest and row counts.

        Raises
        ------
        InputError
            File, column, row or cell that cannot be read; see :mod:`gnssins.io.text` and
            :mod:`gnssins.io.cells`.
        """
        table, source = (self.clean and _clean_imu(path, config)) or self._any_imu(path, config)
        late = int((table.t_ns < np.maximum.accumulate(table.t_ns)).sum())
        if config.on_backwards != "sort" or not late:
            return table, source
        order = np.argsort(table.t_ns, kind="stable")
        return table.select(order), replace(source, sorted_rows=late)

    def _any_imu(self, path: Path, config: ImuConfig) -> tuple[ImuTable, Source]:
        """The long way: every flaw is named or counted."""
        text = self.table(
            path,
            section="imu",
            required=_imu_columns(config),
            separator=config.separator,
            skip_bad=config.on_bad_row == "skip",
        )
        return _imu_of_text(text, config), _source(text)

    def imu_pieces(self, path: Path, config: ImuConfig, rows: int) -> Iterator[ImuPiece]:
        """Read an IMU log in pieces of so many rows, in the order of the file.

        Parameters
        ----------
        path, config
            As for :meth:`read_imu`; nothing is sorted here.
        rows : int
            Rows of a piece.

        Yields
        ------
        ImuPiece
            The next rows; none where all were skipped.
        """
        pieces = self.pieces(
            path,
            rows,
            section="imu",
            required=_imu_columns(config),
            separator=config.separator,
            skip_bad=config.on_bad_row == "skip",
        )
        for text in pieces:
            table = _imu_of_text(text, config)
            yield ImuPiece(table, _source(text), text.share)

    def read_gnss(self, path: Path, config: GnssConfig) -> tuple[GnssTable, Source]:
        """Read a GNSS log into radians, metres and north-east-down.

        Parameters
        ----------
        path : Path
            The file.
        config : GnssConfig
            Its columns, units and axes, and where the accuracy comes from.

        Returns
        -------
        table : GnssTable
            Rows in the order of the file.
        source : Source
            Digest and row counts.

        Raises
        ------
        InputError
            As :meth:`read_imu`.
        ConfigError
            ``config.no_accuracy``: neither the file nor the configuration tells the accuracy of some fixes.
        """
        position = config.position_columns if config.uses_position else ()
        velocity = config.velocity_columns if config.uses_velocity else ()
        accuracy = (*config.position_sd_columns, *config.velocity_sd_columns)
        changed = config.new_constellation_column
        try:
            text = self.table(
                path,
                section="gnss",
                required=(config.time_column, *position, *velocity),
                optional=(*accuracy, changed) if config.sd == "file" else (changed,),
                separator=config.separator,
                skip_bad=config.on_bad_row == "skip",
            )
        except InputError as error:
            raise _hint_use(error, config) from None
        values = dict.fromkeys((*position, *velocity, *accuracy, changed))
        t_ns, columns = numbers(text, config.time_column, config.time_unit, tuple(values), config.missing)
        absent = np.full((t_ns.size, 3), np.nan)
        lla = _stack(columns, position) if position else absent
        v_n = _stack(columns, velocity) if velocity else absent
        if config.angle_unit == "deg":
            lla = lla * [DEG_TO_RAD, DEG_TO_RAD, 1.0]
        if config.velocity_axes == "ENU":
            v_n = v_n[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
        lla = lla + np.array([0.0, 0.0, config.geoid_height_m])
        sd = np.hstack(
            [
                _accuracy(text, columns, config, "position", np.isfinite(lla)),
                _accuracy(text, columns, config, "velocity", np.isfinite(v_n)),
            ]
        )
        marks = np.nan_to_num(columns[changed]) != 0.0 if changed in columns else None
        return GnssTable(t_ns, lla, v_n, sd * np.abs(sd), marks), _source(text)

    def read_baro(self, path: Path, config: BaroConfig) -> tuple[BaroTable, Source]:
        """Read the heights of a barometric altimeter into metres above the ellipsoid.

        Parameters
        ----------
        path : Path
            The file.
        config : BaroConfig
            Its columns and units, and where the accuracy comes from.

        Returns
        -------
        table : BaroTable
            Rows in the order of the file.
        source : Source
            Digest and row counts.

        Raises
        ------
        InputError
            As :meth:`read_imu`.
        ConfigError
            ``config.no_accuracy``: neither the file nor the configuration tells the accuracy of some heights.
        """
        text, t_ns, height, sd = _one_value(
            self.table, path, "baro", config, config.height_column, config.height_factor, config.height_sd_m
        )
        return BaroTable(t_ns, height + config.geoid_height_m, sd * np.abs(sd)), _source(text)

    def read_heading(self, path: Path, config: HeadingConfig) -> tuple[HeadingTable, Source]:
        """Read the headings of a receiver with two antennas into radians.

        Parameters
        ----------
        path : Path
            The file.
        config : HeadingConfig
            Its columns and units, and where the accuracy comes from.

        Returns
        -------
        table : HeadingTable
            Rows in the order of the file.
        source : Source
            Digest and row counts.

        Raises
        ------
        InputError
            As :meth:`read_imu`.
        ConfigError
            ``config.no_accuracy``: neither the file nor the configuration tells the accuracy of some headings.
        """
        given = config.heading_sd_deg
        text, t_ns, heading, sd = _one_value(
            self.table,
            path,
            "heading",
            config,
            config.heading_column,
            config.angle_factor,
            None if given is None else given * DEG_TO_RAD,
        )
        return HeadingTable(t_ns, heading - config.offset_deg * DEG_TO_RAD, sd * np.abs(sd)), _source(text)

    def read_truth(self, path: Path, config: TruthConfig) -> tuple[TruthTable, Source]:
        """Read a reference trajectory in the fixed layout of :class:`gnssins.config.TruthConfig`.

        Parameters
        ----------
        path : Path
            The file.
        config : TruthConfig
            Its section of the configuration.

        Returns
        -------
        table : TruthTable
            NaN where a row or the whole file lacks a value.
        source : Source
            Digest and row counts.

        Raises
        ------
        InputError
            As :meth:`read_imu`.
        """
        groups = (_TRUTH_POSITION, _TRUTH_VELOCITY, _TRUTH_EULER, _TRUTH_QUATERNION)
        values = tuple(name for group in groups for name in group)
        text = self.table(path, section="truth", required=("time_s",), optional=values)
        if not any(all(name in text.columns for name in group) for group in groups):
            raise InputError(
                "input.column",
                f"{path}: no position, velocity or attitude columns; the file has: {', '.join(text.columns)}",
                "name the columns " + ", ".join(values[:9]),
                {"file": str(path)},
            )
        t_ns, columns = numbers(text, "time_s", "s", values, "nan")
        lla = _stack(columns, _TRUTH_POSITION, t_ns.size) * [DEG_TO_RAD, DEG_TO_RAD, 1.0]
        v_n = _stack(columns, _TRUTH_VELOCITY, t_ns.size)
        return TruthTable(t_ns, lla, v_n, _attitude(columns, t_ns.size)), _source(text)


def _imu_columns(config: ImuConfig) -> tuple[str, ...]:
    return (config.time_column, *config.gyro_columns, *config.accel_columns)


def _clean_imu(path: Path, config: ImuConfig) -> tuple[ImuTable, Source] | None:
    """The short way; None for a file that is not clean."""
    time, *values = _imu_columns(config)
    clean = read_clean(path, time, config.time_unit, values, config.missing, config.separator)
    if clean is None:
        return None
    return _imu_table(clean.t_ns, clean.columns, config), Source(str(path), clean.sha256, clean.t_ns.size)


def _imu_of_text(text: TextTable, config: ImuConfig) -> ImuTable:
    """Cells to a table; what is skipped is counted in ``text``."""
    time, *values = _imu_columns(config)
    return _imu_table(*numbers(text, time, config.time_unit, values, config.missing), config)


def _imu_table(t_ns: NDArray[np.int64], columns: dict[str, Array], config: ImuConfig) -> ImuTable:
    """Columns to SI units and forward-right-down axes."""
    to_frd = axes_matrix(config.axes)
    gyro = _turned([columns[name] * config.gyro_factor() for name in config.gyro_columns], to_frd)
    accel = _turned([columns[name] * config.accel_factor() for name in config.accel_columns], to_frd)
    return ImuTable.of_own(t_ns, gyro, accel, config.kind)


def _one_value(
    read: Callable[..., TextTable],
    path: Path,
    section: str,
    config: BaroConfig | HeadingConfig,
    column: str,
    factor: float,
    given_sd: float | None,
) -> tuple[TextTable, NDArray[np.int64], Array, Array]:
    """Read an aid with one value per row: its stamps, values and standard deviations in SI, shapes (m,)."""
    text = read(
        path,
        section=section,
        required=(config.time_column, column),
        optional=(config.sd_column,) if config.sd == "file" else (),
        separator=config.separator,
        skip_bad=config.on_bad_row == "skip",
    )
    names = (column, config.sd_column)
    t_ns, columns = numbers(text, config.time_column, config.time_unit, names, config.missing)
    value = columns[column] * factor
    sd = columns.get(config.sd_column, np.full(t_ns.size, np.nan)) * factor
    sd = np.where(np.isnan(sd), np.nan if given_sd is None else given_sd, sd)
    unknown = np.isnan(sd) & np.isfinite(value)
    if unknown.any():
        key = "height_sd_m" if section == "baro" else "heading_sd_deg"
        what = "heights" if section == "baro" else "headings"
        raise ConfigError(
            "config.no_accuracy",
            f"{path}: {int(unknown.sum())} of {unknown.size} {what} have no accuracy, first at "
            f"{text.where(int(np.flatnonzero(unknown)[0]))}: column {config.sd_column} absent or nan",
            f"add [{section}] {key}",
            {"file": str(path), "key": f"{section}.{key}", "count": int(unknown.sum())},
        )
    return text, t_ns, value, sd


def _stack(columns: dict[str, Array], names: tuple[str, ...], rows: int = 0) -> Array:
    """Put columns side by side; NaN for those that the file does not have."""
    absent = np.full(rows, np.nan)
    return np.column_stack([columns.get(name, absent) for name in names])


def _turned(axes: list[Array], c: Array) -> Array:
    """Columns along three axes turned by a rotation, side by side; a value that is not finite stays in its row."""
    swap = np.abs(c).argmax(axis=1)
    sign = c[np.arange(3), swap]
    if np.array_equal(np.abs(sign), np.ones(3)):  # axes by letters: exact, and axis by axis
        out = np.empty((axes[0].size, 3))
        for i in range(3):
            np.multiply(axes[swap[i]], sign[i], out=out[:, i])
        return out
    with np.errstate(invalid="ignore"):
        return np.asarray(np.column_stack(axes) @ c.T)


def _source(text: TextTable) -> Source:
    return Source(str(text.path), text.sha256, text.rows, dict(text.skipped))


def _hint_use(error: InputError, config: GnssConfig) -> InputError:
    """Say that positions or velocities can be left out, if the missing columns are just those."""
    missing = error.context.get("missing")
    if config.use != "both" or not isinstance(missing, list):
        return error
    for columns, rest in ((config.velocity_columns, "position"), (config.position_columns, "velocity")):
        if set(missing) == set(columns):
            error.hint += f'; or set [gnss] use = "{rest}"'
    return error


def _accuracy(
    text: TextTable, columns: dict[str, Array], config: GnssConfig, what: str, present: NDArray[np.bool_]
) -> Array:
    """Find the standard deviations (m, 3) of positions or velocities; negative ones stay negative."""
    key = "position_sd_m" if what == "position" else "velocity_sd_m_s"
    given = getattr(config, key)
    fallback = np.full(3, np.nan) if given is None else np.asarray(given, dtype=np.float64)
    sd = np.full(present.shape, np.nan)
    if config.sd == "file":
        sd = _stack(columns, getattr(config, f"{what}_sd_columns"), present.shape[0]) * config.sd_scale
        floor = np.asarray(getattr(config, f"{key.replace('_sd', '_sd_floor')}"))
        sd = np.where(sd >= 0.0, np.maximum(sd, floor), sd)
    sd = np.where(np.isnan(sd), fallback, sd)
    unknown = (np.isnan(sd) & present).any(axis=1)
    if unknown.any():
        names = ", ".join(getattr(config, f"{what}_sd_columns"))
        raise ConfigError(
            "config.no_accuracy",
            f"{text.path}: {int(unknown.sum())} of {unknown.size} fixes have no {what} accuracy, first at "
            f"{text.where(int(np.flatnonzero(unknown)[0]))}: columns {names} absent or nan",
            f"add [gnss] {key} = [north, east, down]",
            {"file": str(text.path), "key": f"gnss.{key}", "count": int(unknown.sum())},
        )
    return sd


def _attitude(columns: dict[str, Array], rows: int) -> Array | None:
    """Quaternions from the quaternion columns, else from roll, pitch, heading; None without any."""
    q_nb = _stack(columns, _TRUTH_QUATERNION, rows)
    euler = _stack(columns, _TRUTH_EULER, rows) * DEG_TO_RAD
    known = np.isfinite(euler).all(axis=1) & ~np.isfinite(q_nb).all(axis=1)
    if known.any():
        q_nb[known] = _core.euler_to_quat(np.ascontiguousarray(euler[known]))
    finite = np.isfinite(q_nb).all(axis=1)
    if not finite.any():
        return None
    q_nb[~finite] = np.nan
    q_nb[finite] /= np.linalg.norm(q_nb[finite], axis=1, keepdims=True)
    return q_nb
