"""Parquet: the columns of the CSV reader, with numbers instead of text, and row groups read one after the other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import polars as pl

from ..errors import InputError
from .csv import CsvFormat
from .raw import file_digest, require_file
from .text import TextTable, no_rows, require_columns


def read_parquet(
    path: Path,
    *,
    section: str,
    required: Sequence[str],
    optional: Sequence[str] = (),
    separator: str = ",",
    skip_bad: bool = False,
) -> TextTable:
    """Read columns of a Parquet file as :func:`gnssins.io.text.read_text` reads those of a text file.

    Columns may hold numbers or text. Stamps are integers in the unit of the configuration, decimals, text, or floats,
    which from 4e6 s on no longer resolve a nanosecond. ``separator`` means nothing here.

    Raises
    ------
    MissingFileError
        ``input.not_found``.
    InputError
        ``input.corrupt``, ``input.column``, ``input.no_rows``.
    """
    (table,) = _tables(path, None, section, required, optional, skip_bad)
    table.sha256, table.piece = file_digest(path), False
    return table


def parquet_pieces(
    path: Path,
    rows: int,
    *,
    section: str,
    required: Sequence[str],
    separator: str = ",",
    skip_bad: bool = False,
) -> Iterator[TextTable]:
    """Read a Parquet file in pieces of so many rows, as :func:`gnssins.io.text.text_pieces` a text file."""
    yield from _tables(path, rows, section, required, (), skip_bad)


def _tables(
    path: Path,
    rows: int | None,
    section: str,
    required: Sequence[str],
    optional: Sequence[str],
    skip_bad: bool,
) -> Iterator[TextTable]:
    require_file(path, section)
    try:
        file = pl.scan_parquet(path, glob=False)
        names = file.collect_schema().names()
        total = int(file.select(pl.len()).collect().item())
    except (OSError, pl.exceptions.PolarsError) as failure:
        raise InputError(
            "input.corrupt",
            f"{path}: cannot be read as Parquet ({str(failure).splitlines()[0]})",
            f"check [{section}] file; was it written to its end?",
            {"file": str(path)},
        ) from None
    require_columns(required, names, path, section)
    if not total:
        raise no_rows(path)
    wanted = [name for name in names if name in required or name in optional]
    size = rows or total
    for first in range(0, total, size):
        frame = file.select(wanted).slice(first, size).collect()
        numbers = np.arange(first + 1, first + frame.height + 1, dtype=np.int64)
        columns = {name: frame[name] for name in wanted}
        share = (first + frame.height) / total
        yield TextTable(
            path, "", section, skip_bad, frame.height, columns, numbers, None, piece=True, share=share
        )


class ParquetFormat(CsvFormat):
    """Parquet files with the columns that the configuration names."""

    name = "parquet"
    suffixes = (".parquet",)
    clean = False
    table = staticmethod(read_parquet)
    pieces = staticmethod(parquet_pieces)
