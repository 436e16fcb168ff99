"""Cells of a text table to numbers and times: each bad cell is named, or its row counted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..errors import InputError
from ..units import TIME_DIGITS
from .text import TextTable

Mask = NDArray[np.bool_]
PRECISION = 38
"""Digits of the decimal type that times pass through: enough for int64 nanoseconds in any unit."""


def numbers(
    table: TextTable, time_column: str, time_unit: str, values: Sequence[str], missing: str
) -> tuple[NDArray[np.int64], dict[str, NDArray[np.float64]]]:
    """Convert the time column and the value columns; drop and count the rows that have no usable cell text.

    Parameters
    ----------
    table : TextTable
        The cells; its skipped rows are counted on.
    time_column : str
        Column of the stamps.
    time_unit : {"s", "ms", "us", "ns"}
        Unit of the stamps.
    values : sequence of str
        Columns of numbers; those that the table does not have are left out of the result.
    missing : str
        Text that stands for a missing value; an empty cell and ``nan`` do too.

    Returns
    -------
    t_ns : ndarray of int64, shape (n,)
        Stamps, ns, exact to the last digit; more digits are rounded half to even.
    columns : dict of str to ndarray, shape (n,)
        Values, NaN where missing.

    Raises
    ------
    InputError
        ``input.cell``: a cell is no number (unless bad rows are skipped); ``input.no_rows``: no row has a
        time.
    """
    t_ns, no_time, bad_time = _times(table.columns[time_column], time_unit, missing)
    out = no_time | bad_time
    _judge(table, time_column, bad_time, "time stamp")
    columns = {}
    for name in values:
        if name in table.columns:
            columns[name], bad = _floats(table.columns[name], missing)
            _judge(table, name, bad & ~out, "number")
            out |= bad
    table.count("no time stamp", int(no_time.sum()))
    if out.all() and not table.piece:
        raise InputError(
            "input.no_rows",
            f"{table.path}: none of the {table.rows} rows can be used ({_reasons(table)})",
            f"check [{table.section}] time_column and the file",
            {"file": str(table.path), "rows": table.rows, "skipped": dict(table.skipped)},
        )
    if out.any():
        keep = ~out
        table.row, t_ns = table.row[keep], t_ns[keep]
        table.line = None if table.line is None else table.line[keep]
        columns = {name: cells[keep] for name, cells in columns.items()}
    return t_ns, columns


def _reasons(table: TextTable) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in table.skipped.items())


def _floats(cells: pl.Series, missing: str) -> tuple[NDArray[np.float64], Mask]:
    """Values with NaN where missing, and the rows whose cell is no number."""
    parsed = cells.cast(pl.Float64, strict=False)
    return as_missing(parsed.to_numpy(), missing), _unread(cells, parsed, missing)


def as_missing(values: NDArray[np.float64], missing: str) -> NDArray[np.float64]:
    """NaN for a number that stands for a missing value."""
    if not _looks_numeric(missing):
        return values
    sentinel = values == float(missing)
    return np.where(sentinel, np.nan, values) if sentinel.any() else values


def _times(cells: pl.Series, unit: str, missing: str) -> tuple[NDArray[np.int64], Mask, Mask]:
    """Stamps in ns, the rows without a stamp, and the rows whose stamp is no number."""
    decimal = cells.cast(pl.Decimal(PRECISION, TIME_DIGITS[unit]), strict=False)
    parsed = decimal.to_physical().cast(pl.Int64, strict=False)
    bad = _unread(cells, parsed, missing)
    absent = parsed.is_null().to_numpy() & ~bad
    return parsed.fill_null(0).to_numpy(), absent, bad


def _unread(cells: pl.Series, parsed: pl.Series, missing: str) -> Mask:
    """Rows whose cell holds text that is neither a number nor a missing value."""
    if not parsed.null_count() or cells.dtype != pl.String:
        return np.zeros(len(cells), dtype=np.bool_)
    tokens = list({missing.strip().lower(), "nan"})
    known = cells.str.to_lowercase().is_in(tokens).fill_null(value=True)
    return (parsed.is_null() & ~known).to_numpy()


def _looks_numeric(text: str) -> bool:
    try:
        return not np.isnan(float(text))
    except ValueError:
        return False


def _judge(table: TextTable, name: str, bad: Mask, what: str) -> None:
    """Count the rows with a bad cell, or stop at the first."""
    count = int(bad.sum())
    if not count:
        return
    if table.skip_bad:
        table.count(f"no {what} in {name}", count)
        return
    index = int(np.flatnonzero(bad)[0])
    text = str(table.columns[name][index])
    many = f", {count} such rows" if count > 1 else ""
    decimal_comma = text.replace(",", ".", 1) != text and _looks_numeric(text.replace(",", ".", 1))
    hint = (
        "write decimal points, not commas"
        if decimal_comma
        else f'"{text}" may be a missing value: set missing'
    )
    raise InputError(
        "input.cell",
        f'{table.where(index)}, column {name}: "{text[:40]}" is no {what}{many}',
        f'{hint}; or set [{table.section}] on_bad_row = "skip"',
        {
            "file": str(table.path),
            "row": int(table.row[index]),
            "line": None if table.line is None else int(table.line[index]),
            "column": name,
            "count": count,
        },
    )
