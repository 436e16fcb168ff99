"""The short way for text tables without a flaw: the parser makes numbers at once, and a second look confirms it.

A file that is odd in any way (quotes, blank lines, a cell that is no number, rows of unequal length) is left to
:mod:`gnssins.io.text` and :mod:`gnssins.io.cells`, which name the place or count the row.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..units import TIME_DIGITS
from .cells import PRECISION, as_missing

_BLOCK = 1 << 20


@dataclass(frozen=True)
class Clean:
    """Stamps (n,), ns, the columns asked for, and the digest of the file."""

    t_ns: NDArray[np.int64]
    columns: dict[str, NDArray[np.float64]]
    sha256: str


@dataclass(frozen=True)
class _Scan:
    sha256: str
    separators: int
    plain: bool


def read_clean(
    path: Path, time_column: str, time_unit: str, values: Sequence[str], missing: str, separator: str
) -> Clean | None:
    """Read columns of numbers from a text file that has one header line and nothing to complain about.

    Parameters
    ----------
    path : Path
        The file.
    time_column, time_unit, values, missing
        As for :func:`gnssins.io.cells.numbers`.
    separator : str
        Character between cells.

    Returns
    -------
    Clean or None
        None if the file is not clean, whatever the reason.
    """
    names = _names(path, separator)
    wanted = [time_column, *values]
    if not all(name in names for name in wanted):
        return None
    types: dict[str, pl.DataType] = dict.fromkeys(names, pl.String())
    types |= dict.fromkeys(values, pl.Float64())
    types[time_column] = pl.Decimal(PRECISION, TIME_DIGITS[time_unit])
    # the last column tells whether a row is complete
    used = sorted({names.index(name) for name in (*wanted, names[-1])})
    with ThreadPoolExecutor(max_workers=1) as beside:
        scan = beside.submit(_scan, path, separator)
        try:
            frame = pl.read_csv(
                path, schema=types, columns=used, separator=separator, quote_char=None, glob=False
            )
        except pl.exceptions.PolarsError:
            return None
    seen = scan.result()
    rows = frame.height
    t_ns = frame[time_column].to_physical().cast(pl.Int64, strict=False)
    incomplete = any(column.null_count() for column in frame) or t_ns.null_count() > 0
    if not rows or not seen.plain or incomplete or seen.separators != (rows + 1) * (len(names) - 1):
        return None
    columns = {name: as_missing(frame[name].to_numpy(), missing) for name in values}
    return Clean(t_ns.to_numpy(), columns, seen.sha256)


def _names(path: Path, separator: str) -> list[str]:
    """Names of the columns; none where the first line is not plainly a header."""
    try:
        with path.open("rb") as file:
            head = file.readline(1 << 16)
    except OSError:
        return []
    names = [name.strip() for name in head.decode("utf-8", errors="replace").split(separator)]
    return names if len(names) > 1 and len(set(names)) == len(names) else []


def _scan(path: Path, separator: str) -> _Scan:
    """Digest of a file, its separators, and whether no byte needs a closer look; mostly without the GIL."""
    digest, separators, plain = hashlib.sha256(), 0, True
    buffer = bytearray(_BLOCK)
    values = np.frombuffer(buffer, dtype=np.uint8)
    with path.open("rb", buffering=0) as file:
        while count := file.readinto(buffer):
            digest.update(memoryview(buffer)[:count])
            separators += int(np.count_nonzero(values[:count] == ord(separator)))
            plain = plain and all(buffer.find(odd, 0, count) < 0 for odd in (b'"', b"\r", b"\x00"))
    return _Scan(digest.hexdigest(), separators, plain)
