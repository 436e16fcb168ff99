"""Delimited text to columns of cells, exactly: every row of the file is in the table or counted as skipped.

Nothing is converted here; :mod:`gnssins.io.cells` makes numbers and times of the cells.
"""

from __future__ import annotations

import csv
import difflib
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from ..errors import InputError
from .raw import read_pieces, read_raw

_SEPARATORS = {",": "comma", ";": "semicolon", "\t": "tab", "|": "bar", " ": "space"}
Integers = NDArray[np.int64]


@dataclass
class TextTable:
    """Wanted columns of a delimited text file.

    Attributes
    ----------
    path : Path
        The file.
    sha256 : str
        Digest of the file as it lies on disk.
    section : str
        Section of the configuration that speaks about the file, for hints.
    skip_bad : bool
        Rows that cannot be read are counted, not an error.
    rows : int
        Data rows in the file, blank lines not counted.
    columns : dict of str to polars.Series
        Cells as text without blanks around them, or as numbers; null for an empty cell.
    row, line : ndarray of int64
        Number of each table row among the data rows (first = 1), and its line in the file (header = 1; None for files
        without lines).
    skipped : dict of str to int
        Rows left out so far, by reason.
    piece : bool
        The table is a piece of a file: other pieces have rows too.
    share : float
        Share of the file that is read.
    """

    path: Path
    sha256: str
    section: str
    skip_bad: bool
    rows: int
    columns: dict[str, pl.Series]
    row: Integers
    line: Integers | None
    skipped: dict[str, int] = field(default_factory=dict)
    piece: bool = False
    share: float = 1.0

    def where(self, index: int) -> str:
        """Name a table row the way a user finds it: file, row, line."""
        line = "" if self.line is None else f" (line {self.line[index]})"
        return f"{self.path.name} row {self.row[index]}{line}"

    def count(self, reason: str, rows: int) -> None:
        """Add to the skipped rows of a reason."""
        if rows:
            self.skipped[reason] = self.skipped.get(reason, 0) + rows


@dataclass
class _Lines:
    """Lines of the body that are not blank."""

    number: Integers
    cells: Integers
    complete: bool


def read_text(
    path: Path,
    *,
    section: str,
    required: Sequence[str],
    optional: Sequence[str] = (),
    separator: str = ",",
    skip_bad: bool = False,
) -> TextTable:
    """Read columns of a delimited text file with one header line.

    Parameters
    ----------
    path : Path
        The file, plain or gzip.
    section : str
        Section of the configuration that speaks about the file, such as ``"imu"``.
    required, optional : sequence of str
        Columns that must, or may, be there; others are not looked at.
    separator : str
        Character between cells.
    skip_bad : bool
        Leave rows with a wrong number of cells out and count them, instead of stopping.

    Returns
    -------
    TextTable

    Raises
    ------
    MissingFileError
        ``input.not_found``.
    InputError
        Those of :func:`gnssins.io.raw.read_raw`, and ``input.header``, ``input.separator``, ``input.column``,
        ``input.no_rows``, ``input.ragged``.
    """
    raw = read_raw(path, section=section, accept_cut=skip_bad)
    head, body, lead = _take_header(raw.data)
    layout = _layout(path, head, section, required, optional, separator, skip_bad)
    table = layout.table(body, line=lead, cut=raw.cut)
    if not table.rows:
        raise no_rows(path)
    table.sha256 = raw.sha256
    return table


def text_pieces(
    path: Path,
    rows: int,
    *,
    section: str,
    required: Sequence[str],
    separator: str = ",",
    skip_bad: bool = False,
) -> Iterator[TextTable]:
    """Read a delimited text file in pieces of so many rows; as :func:`read_text`, without the digest.

    Yields
    ------
    TextTable
        The next rows, numbered as in the file.
    """
    layout, seen, line = None, 0, 0
    for data, cut, share in read_pieces(path, section=section, lines=rows, accept_cut=skip_bad):
        body, lines = data, data.count(b"\n")
        if layout is None:
            head, body, lead = _take_header(data)
            if not head.strip():
                line += lines
                continue
            layout = _layout(path, head, section, required, (), separator, skip_bad)
            table = layout.table(body, line=line + lead, cut=cut)
        else:
            table = layout.table(body, seen, line, cut=cut)
        line, seen = line + lines, seen + table.rows
        table.piece, table.share = True, share
        if table.rows:
            yield table
    if not seen:
        raise no_rows(path)


@dataclass(frozen=True)
class _Layout:
    """What the header and the configuration say about every row of a file."""

    path: Path
    section: str
    names: list[str]
    wanted: set[str]
    separator: str
    skip_bad: bool

    def table(self, body: bytes, seen: int = 0, line: int = 0, *, cut: bool) -> TextTable:
        """Split text into cells; ``seen`` rows and ``line`` lines of the file come before it."""
        split = _split_quoted if b'"' in body else _split_plain
        lines, columns = split(body, self.names, self.wanted, self.separator)
        good = lines.cells == len(self.names)
        row = np.arange(seen + 1, seen + good.size + 1, dtype=np.int64)
        at = lines.number + line
        table = TextTable(self.path, "", self.section, self.skip_bad, good.size, columns, row[good], at[good])
        if not good.all():
            _tell_ragged(table, self.names, lines, row, at, cut=cut or not lines.complete)
        return table


def _layout(
    path: Path,
    head: bytes,
    section: str,
    required: Sequence[str],
    optional: Sequence[str],
    separator: str,
    skip_bad: bool,
) -> _Layout:
    names = _header(head, separator, path, section)
    require_columns(required, names, path, section)
    wanted = {name for name in names if name in required or name in optional}
    return _Layout(path, section, names, wanted, separator, skip_bad)


def no_rows(path: Path) -> InputError:
    """Error of a file without rows."""
    return InputError(
        "input.no_rows",
        f"{path}: a header line but no data rows",
        "the logger wrote nothing, or the export was cut",
        {"file": str(path)},
    )


def _take_header(data: bytes) -> tuple[bytes, bytes, int]:
    """First line that is not blank, what follows it, and the number of lines up to there."""
    lead = 0
    head, body = b"", data
    while not head.strip() and body:
        head, _, body = body.partition(b"\n")
        lead += 1
    return head, body, lead


def _header(head: bytes, separator: str, path: Path, section: str) -> list[str]:
    text = head.decode("utf-8", errors="replace")
    names = [name.strip() for name in next(csv.reader([text], delimiter=separator))]
    context = {"file": str(path), "columns": names}
    if all(_looks_numeric(name) for name in names):
        raise InputError(
            "input.header",
            f"{path}: the first line holds numbers, not column names: {text[:60]}",
            "put one line with the column names on top",
            context,
        )
    twice = sorted({name for name in names if name and names.count(name) > 1})
    if twice:
        raise InputError(
            "input.header", f"{path}: column name used twice: {', '.join(twice)}", "rename one", context
        )
    other = next((s for s in _SEPARATORS if s != separator and s in text.strip()), None)
    if len(names) == 1 and other is not None:
        shown = "\\t" if other == "\t" else other
        raise InputError(
            "input.separator",
            f"{path}: only one column: {text[:60]}",
            f'separated by {_SEPARATORS[other]}? then set [{section}] separator = "{shown}"',
            context,
        )
    return names


def _looks_numeric(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def require_columns(required: Sequence[str], names: list[str], path: Path, section: str) -> None:
    """Raise for columns that the file does not have."""
    missing = [name for name in required if name not in names]
    if not missing:
        return
    near = {name: difflib.get_close_matches(name, names, n=1, cutoff=0.5) for name in missing}
    guesses = [f'"{match[0]}" for "{name}"' for name, match in near.items() if match]
    hint = f"name the columns of the file in [{section}]"
    raise InputError(
        "input.column",
        f"{path}: column missing: {', '.join(missing)}; the file has: {', '.join(names)}",
        f"{hint}; nearest: {', '.join(guesses)}" if guesses else hint,
        {"file": str(path), "missing": missing, "columns": names},
    )


def _split_plain(
    body: bytes, names: list[str], wanted: set[str], separator: str
) -> tuple[_Lines, dict[str, pl.Series]]:
    """Split text without quotes: line ends and separators are counted, then one pass of the parser."""
    text = np.frombuffer(body, dtype=np.uint8)
    ends = np.flatnonzero(text == ord("\n"))
    complete = not body or body.endswith(b"\n")
    if not complete:
        ends = np.append(ends, text.size)
    starts = np.concatenate(([0], ends[:-1] + 1))[: ends.size]
    marks = np.flatnonzero(text == ord(separator))
    cells = np.searchsorted(marks, ends) - np.searchsorted(marks, starts) + 1
    blank = ends == starts
    for index in np.flatnonzero(~blank & (cells != len(names))):
        blank[index] = not body[starts[index] : ends[index]].strip()
    lines = _Lines(np.flatnonzero(~blank).astype(np.int64) + 1, cells[~blank].astype(np.int64), complete)
    keep = ~blank & (cells == len(names))
    if not keep.all():
        inside = np.ones(text.size, dtype=np.bool_)
        for index in np.flatnonzero(~keep):
            inside[starts[index] : ends[index] + 1] = False
        body = text[inside].tobytes()
    if not keep.any():
        return lines, {name: pl.Series(name, [], dtype=pl.String) for name in wanted}
    frame = pl.read_csv(
        io.BytesIO(body),
        has_header=False,
        new_columns=names,
        columns=[index for index, name in enumerate(names) if name in wanted],
        separator=separator,
        quote_char=None,
        infer_schema=False,
        encoding="utf8-lossy",
    )
    blanks = b" " in body or b"\t" in body
    return lines, {name: _tidy(frame[name]) if blanks else frame[name] for name in frame.columns}


def _split_quoted(
    body: bytes, names: list[str], wanted: set[str], separator: str
) -> tuple[_Lines, dict[str, pl.Series]]:
    """Split text with quoted cells row by row: slow, but right about separators and line ends in quotes."""
    reader = csv.reader(io.StringIO(body.decode("utf-8", errors="replace"), newline=""), delimiter=separator)
    rows, numbers, before = [], [], 0
    for cells in reader:
        if any(cell.strip() for cell in cells) or len(cells) > 1:
            rows.append(cells)
            numbers.append(before + 1)
        before = reader.line_num
    lengths = np.array([len(cells) for cells in rows], dtype=np.int64)
    good = [cells for cells in rows if len(cells) == len(names)]
    columns = {
        name: _tidy(pl.Series(name, [cells[index] for cells in good], dtype=pl.String))
        for index, name in enumerate(names)
        if name in wanted
    }
    return _Lines(np.array(numbers, dtype=np.int64), lengths, body.endswith(b"\n")), columns


def _tidy(cells: pl.Series) -> pl.Series:
    """Take blanks off; an empty cell becomes null."""
    cells = cells.str.strip_chars()
    return cells.set(cells == "", None)


def _tell_ragged(
    table: TextTable, names: list[str], lines: _Lines, row: Integers, line: Integers, cut: bool
) -> None:
    """Stop at, or count, the rows that have too few or too many cells."""
    bad = lines.cells != len(names)
    first = int(np.flatnonzero(bad)[0])
    last_is_cut = cut and bool(bad[-1])
    if table.skip_bad:
        table.count("cut in the middle of the row", int(last_is_cut))
        table.count("wrong number of cells", int(bad.sum()) - int(last_is_cut))
        return
    cells, count = int(lines.cells[first]), int(bad.sum())
    many = f", {count} such rows" if count > 1 else ""
    if last_is_cut and count == 1:
        what, hint = "the file ends in the middle of the row", "the file was cut: copy it again"
    elif cells > len(names):
        what, hint = "too many cells", "a comma as decimal sign, or a wrong separator"
    else:
        what, hint = "too few cells", "the row is incomplete"
    raise InputError(
        "input.ragged",
        f"{table.path}: row {row[first]} (line {line[first]}): {what}: {cells} instead of {len(names)}{many}",
        f'{hint}; or set [{table.section}] on_bad_row = "skip"',
        {"file": str(table.path), "row": int(row[first]), "line": int(line[first]), "count": count},
    )
