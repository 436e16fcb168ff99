"""Writers of the CSV layout that the reader takes without any column key."""

from __future__ import annotations

import gzip
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from .. import _core
from ..dataset import BaroTable, GnssTable, HeadingTable, ImuTable, TruthTable
from ..errors import InputError
from ..units import DEG_TO_RAD, NS_PER_S

Array = NDArray[np.float64]
_COMPRESSION = 6


def write_imu(path: str | os.PathLike[str], table: ImuTable) -> None:
    """Write ``time_s, gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z`` in SI units, forward-right-down.

    Parameters
    ----------
    path : path
        ``.csv``, or ``.csv.gz`` to compress.
    table : ImuTable
        Rates, or increments (rad, m/s): the reader has to be told by ``[imu] kind``.

    Raises
    ------
    InputError
        ``input.write``: the file cannot be written.
    """
    columns = {f"gyro_{axis}": table.gyro[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"accel_{axis}": table.accel[:, i] for i, axis in enumerate("xyz")}
    _write(Path(path), table.t_ns, columns)


def write_gnss(path: str | os.PathLike[str], table: GnssTable) -> None:
    """Write ``time_s, lat_deg, lon_deg, height_m, vn, ve, vd, sd_n, sd_e, sd_d, sd_vn, sd_ve, sd_vd``.

    A table that knows of changes of the constellation has a column ``new_constellation`` of 0 and 1 too.

    Parameters
    ----------
    path : path
        ``.csv``, or ``.csv.gz`` to compress.
    table : GnssTable
        Fixes with variances.

    Raises
    ------
    InputError
        ``input.shape``: full covariances do not fit into the columns; ``input.write``: the file cannot be
        written.
    """
    if table.var.ndim == 3 and any(np.any(np.triu(block, 1)) for block in table.var):
        raise InputError(
            "input.shape",
            f"{path}: the CSV layout holds standard deviations, not full 6x6 covariances",
            "write the diagonal: GnssTable(t_ns, lla, v_n, var=...) with shape (m, 6)",
            {"file": str(path)},
        )
    names = ("sd_n", "sd_e", "sd_d", "sd_vn", "sd_ve", "sd_vd")
    columns: dict[str, NDArray[Any]] = {**_position(table.lla), **_velocity(table.v_n)}
    columns |= {name: table.sd[:, i] for i, name in enumerate(names)}
    if table.new_constellation is not None:
        columns["new_constellation"] = table.new_constellation.astype(np.uint8)
    _write(Path(path), table.t_ns, columns)


def write_baro(path: str | os.PathLike[str], table: BaroTable) -> None:
    """Write ``time_s, height_m, sd`` in metres.

    Parameters
    ----------
    path : path
        ``.csv``, or ``.csv.gz`` to compress.
    table : BaroTable
        Heights with variances.

    Raises
    ------
    InputError
        ``input.write``: the file cannot be written.
    """
    _write(Path(path), table.t_ns, {"height_m": table.height_m, "sd": _deviation(table.var)})


def write_heading(path: str | os.PathLike[str], table: HeadingTable) -> None:
    """Write ``time_s, heading, sd`` in degrees.

    Parameters
    ----------
    path : path
        ``.csv``, or ``.csv.gz`` to compress.
    table : HeadingTable
        Headings with variances; written in [0, 360) deg.

    Raises
    ------
    InputError
        ``input.write``: the file cannot be written.
    """
    heading = table.heading_rad / DEG_TO_RAD % 360.0
    _write(Path(path), table.t_ns, {"heading": heading, "sd": _deviation(table.var) / DEG_TO_RAD})


def write_truth(path: str | os.PathLike[str], table: TruthTable) -> None:
    """Write ``time_s, lat_deg, lon_deg, height_m, vn, ve, vd`` and, if known, Euler angles and quaternion.

    Parameters
    ----------
    path : path
        ``.csv``, or ``.csv.gz`` to compress.
    table : TruthTable
        Reference trajectory; heading is written in [0, 360) deg.

    Raises
    ------
    InputError
        ``input.write``: the file cannot be written.
    """
    columns = {**_position(table.lla), **_velocity(table.v_n)}
    if table.q_nb is not None:
        euler = np.full((len(table), 3), np.nan)
        known = np.isfinite(table.q_nb).all(axis=1)
        euler[known] = _core.quat_to_euler(np.ascontiguousarray(table.q_nb[known])) / DEG_TO_RAD
        columns |= {"roll_deg": euler[:, 0], "pitch_deg": euler[:, 1], "heading_deg": euler[:, 2] % 360.0}
        columns |= {name: table.q_nb[:, i] for i, name in enumerate(("qw", "qx", "qy", "qz"))}
    _write(Path(path), table.t_ns, columns)


def _deviation(var: Array) -> Array:
    """Root of a variance; NaN where it is missing or negative."""
    return np.sqrt(np.where(var >= 0.0, var, np.nan))


def _position(lla: Array) -> dict[str, Array]:
    return {"lat_deg": lla[:, 0] / DEG_TO_RAD, "lon_deg": lla[:, 1] / DEG_TO_RAD, "height_m": lla[:, 2]}


def _velocity(v_n: Array) -> dict[str, Array]:
    return {"vn": v_n[:, 0], "ve": v_n[:, 1], "vd": v_n[:, 2]}


def _seconds(t_ns: NDArray[np.int64]) -> pl.Series:
    """Write whole nanoseconds as seconds with nine decimals, digit by digit."""
    size = np.abs(t_ns)
    frame = pl.DataFrame({"minus": t_ns < 0, "whole": size // NS_PER_S, "rest": size % NS_PER_S})
    sign = pl.when(pl.col("minus")).then(pl.lit("-")).otherwise(pl.lit(""))
    rest = pl.col("rest").cast(pl.String).str.zfill(9)
    return frame.select(time_s=pl.concat_str([sign, pl.col("whole"), pl.lit("."), rest]))["time_s"]


def _write(path: Path, t_ns: NDArray[np.int64], columns: Mapping[str, NDArray[Any]]) -> None:
    """Write through a temporary file: a cut never looks like a result; equal tables give equal bytes."""
    frame = pl.DataFrame([_seconds(t_ns), *(pl.Series(name, values) for name, values in columns.items())])
    text = frame.write_csv().replace("NaN", "nan").encode()
    data = gzip.compress(text, _COMPRESSION, mtime=0) if path.suffix == ".gz" else text
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(data)
        part.replace(path)
    except OSError as failure:
        raise InputError(
            "input.write", f"{path}: {failure.strerror}", "check the folder and the disk", {"file": str(path)}
        ) from None
