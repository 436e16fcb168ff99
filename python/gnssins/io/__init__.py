"""Readers and writers of log files. One format is one file; the registry finds it by the suffix of the name.

:func:`read_dataset` reads everything that a configuration names. A new format is an object with the
attributes of :class:`Format`, handed to :func:`register`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from ..config import BaroConfig, Config, GnssConfig, HeadingConfig, ImuConfig, TruthConfig
from ..dataset import BaroTable, Dataset, GnssTable, HeadingTable, ImuPiece, ImuTable, Source, TruthTable
from ..errors import ConfigError, InputError
from .csv import CsvFormat
from .csv_writer import write_baro, write_gnss, write_heading, write_imu, write_truth
from .parquet import ParquetFormat

__all__ = [
    "Format",
    "format_of",
    "imu_file",
    "read_aids",
    "read_dataset",
    "register",
    "write_baro",
    "write_gnss",
    "write_heading",
    "write_imu",
    "write_truth",
]


class Format(Protocol):
    """What a file format provides."""

    @property
    def name(self) -> str:
        """Short name for messages."""

    @property
    def suffixes(self) -> tuple[str, ...]:
        """Endings of file names, lower case, with the leading dot."""

    def read_imu(self, path: Path, config: ImuConfig) -> tuple[ImuTable, Source]:
        """Read inertial samples."""

    def imu_pieces(self, path: Path, config: ImuConfig, rows: int) -> Iterator[ImuPiece]:
        """Read inertial samples in pieces of so many rows."""

    def read_gnss(self, path: Path, config: GnssConfig) -> tuple[GnssTable, Source]:
        """Read fixes."""

    def read_baro(self, path: Path, config: BaroConfig) -> tuple[BaroTable, Source]:
        """Read heights of a barometric altimeter."""

    def read_heading(self, path: Path, config: HeadingConfig) -> tuple[HeadingTable, Source]:
        """Read headings of a receiver with two antennas."""

    def read_truth(self, path: Path, config: TruthConfig) -> tuple[TruthTable, Source]:
        """Read a reference trajectory."""


_FORMATS: list[Format] = []


def register(file_format: Format) -> None:
    """Add a format; of two formats with one suffix the later one wins."""
    _FORMATS.insert(0, file_format)


def format_of(path: Path) -> Format:
    """Find the format of a file by its name.

    Parameters
    ----------
    path : Path
        The file; need not exist.

    Returns
    -------
    Format

    Raises
    ------
    InputError
        ``input.format``: no format knows the suffix.
    """
    name = path.name.lower()
    for file_format in _FORMATS:
        if name.endswith(file_format.suffixes):
            return file_format
    known = ", ".join(suffix for file_format in _FORMATS for suffix in file_format.suffixes)
    raise InputError(
        "input.format",
        f"{path}: unknown file format",
        f"rename the file or convert it; known endings: {known}",
        {"file": str(path)},
    )


def read_dataset(config: Config) -> Dataset:
    """Read the files that a configuration names.

    Parameters
    ----------
    config : Config
        Names the files and says what is in them. Nothing is cut: start, end and outages are for the run.

    Returns
    -------
    Dataset
        Tables and, in ``sources``, the digest and row counts of each file.

    Raises
    ------
    ConfigError
        ``config.no_file``: no IMU file named; ``config.no_accuracy``: fixes, heights or headings without
        accuracy.
    InputError
        Anything that cannot be read.
    """
    file = imu_file(config)
    imu, source = format_of(file).read_imu(file, config.imu)
    others = read_aids(config)
    truth, sources = None, {source.path: source, **others.sources}
    if config.truth.file is not None:
        truth, source = format_of(config.truth.file).read_truth(config.truth.file, config.truth)
        sources[source.path] = source
    return replace(others, imu=imu, truth=truth, sources=sources)


def imu_file(config: Config) -> Path:
    """Name of the IMU log.

    Raises
    ------
    ConfigError
        ``config.no_file``.
    """
    if config.imu.file is None:
        raise ConfigError(
            "config.no_file",
            "[imu] file: missing, there is nothing to read",
            'add file = "imu.csv" to [imu], or hand over a data set',
        )
    return config.imu.file


def read_aids(config: Config) -> Dataset:
    """Read the files of the aids alone; the IMU table is empty. Errors as :func:`read_dataset`."""
    sources: dict[str, Source] = {}
    gnss, baro, heading = GnssTable.empty(), BaroTable.empty(), HeadingTable.empty()
    if config.gnss.file is not None:
        gnss, source = format_of(config.gnss.file).read_gnss(config.gnss.file, config.gnss)
        sources[source.path] = source
    if config.baro.file is not None:
        baro, source = format_of(config.baro.file).read_baro(config.baro.file, config.baro)
        sources[source.path] = source
    if config.heading.file is not None:
        heading, source = format_of(config.heading.file).read_heading(config.heading.file, config.heading)
        sources[source.path] = source
    return Dataset(ImuTable.empty(config.imu.kind), gnss, sources=sources, baro=baro, heading=heading)


register(CsvFormat())
register(ParquetFormat())
