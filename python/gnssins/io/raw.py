"""Bytes of a text file as they should be: unpacked, without byte order mark, lines ended by a line feed."""

from __future__ import annotations

import difflib
import gzip
import hashlib
import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import BinaryIO

from ..errors import InputError, MissingFileError

_GZIP = b"\x1f\x8b"


@dataclass(frozen=True)
class RawText:
    """Content of a text file.

    Attributes
    ----------
    data : bytes
        UTF-8 text with line feeds.
    sha256 : str
        Digest of the file as it lies on disk.
    cut : bool
        The compressed data ended early and the rest was accepted as lost.
    """

    data: bytes
    sha256: str
    cut: bool


def read_raw(path: Path, *, section: str, accept_cut: bool = False) -> RawText:
    """Read a text file; gzip is recognised by its content, not by its name.

    Parameters
    ----------
    path : Path
        The file.
    section : str
        Section of the configuration that names the file, for hints.
    accept_cut : bool
        Take what is there of a gzip file that ends early.

    Returns
    -------
    RawText

    Raises
    ------
    MissingFileError
        ``input.not_found``.
    InputError
        ``input.unreadable``, ``input.truncated``, ``input.corrupt``, ``input.encoding``, ``input.empty``.
    """
    raw = _read_bytes(path, section)
    data, cut = _gunzip(raw, path, section, accept_cut) if raw.startswith(_GZIP) else (raw, False)
    data = _as_lines(_as_text(data, path))
    if not data.strip():
        raise _empty(path, section)
    return RawText(data, hashlib.sha256(raw).hexdigest(), cut)


def read_pieces(
    path: Path, *, section: str, lines: int, accept_cut: bool = False
) -> Iterator[tuple[bytes, bool, float]]:
    """Read a text file, plain or gzip, in pieces of so many lines: the memory needed is that of a piece.

    Parameters
    ----------
    path, section, accept_cut
        As for :func:`read_raw`.
    lines : int
        Lines of a piece.

    Yields
    ------
    data : bytes
        UTF-8 text with line feeds.
    cut : bool
        The compressed data ended early here and the rest was accepted as lost.
    share : float
        Share of the file that is read, 0 to 1.

    Raises
    ------
    MissingFileError, InputError
        As :func:`read_raw`.
    """
    total, empty = 0, True
    with _open(path, section) as file:
        packed = file.read(2) == _GZIP
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        source = gzip.GzipFile(fileobj=file) if packed else file
        while True:
            piece: list[bytes] = []
            cut = False
            try:
                piece.extend(islice(source, lines))
            except EOFError:
                cut = True
                if not accept_cut:
                    raise _truncated(path, section, total + len(piece)) from None
            except (gzip.BadGzipFile, zlib.error) as failure:
                raise _corrupt(path, failure) from None
            data = b"".join(piece)
            if total == 0:
                data = _as_text(data, path)
            empty = empty and not data.strip()
            total += len(piece)
            if data:
                yield _as_lines(data), cut, file.tell() / size
            if cut or len(piece) < lines:
                break
    if empty:
        raise _empty(path, section)


def require_file(path: Path, section: str) -> None:
    """Raise as :func:`read_raw` does for a file that is not there or cannot be opened."""
    _open(path, section).close()


def file_digest(path: Path) -> str:
    """SHA-256 of a file as it lies on disk."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _as_text(data: bytes, path: Path) -> bytes:
    """Take off a byte order mark; raise for what is no UTF-8 text."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\x00" in data[:4096]:
        raise InputError(
            "input.encoding",
            f"{path}: UTF-16 or binary data, not delimited text",
            "export as UTF-8",
            {"file": str(path)},
        )
    return data.removeprefix(b"\xef\xbb\xbf")


def _as_lines(data: bytes) -> bytes:
    """Let every line end with a line feed alone."""
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


def _empty(path: Path, section: str) -> InputError:
    return InputError(
        "input.empty", f"{path}: the file is empty", f"check [{section}] file", {"file": str(path)}
    )


def _truncated(path: Path, section: str, lines: int) -> InputError:
    return InputError(
        "input.truncated",
        f"{path}: the compressed data end early, after {lines} complete lines",
        f'copy the file again, or set [{section}] on_bad_row = "skip" to use what is there',
        {"file": str(path), "lines": lines},
    )


def _corrupt(path: Path, failure: Exception) -> InputError:
    return InputError(
        "input.corrupt",
        f"{path}: the compressed data are damaged ({failure})",
        "copy the file again",
        {"file": str(path)},
    )


def _read_bytes(path: Path, section: str) -> bytes:
    with _open(path, section) as file:
        return file.read()


def _open(path: Path, section: str) -> BinaryIO:
    try:
        return path.open("rb")
    except FileNotFoundError:
        folder = path.parent
        names = [entry.name for entry in folder.iterdir()] if folder.is_dir() else []
        near = difflib.get_close_matches(path.name, names, n=1, cutoff=0.6)
        hint = f'nearest in that folder: "{near[0]}"' if near else f"check [{section}] file"
        raise MissingFileError(
            "input.not_found", f"{path}: no such file", hint, {"file": str(path)}
        ) from None
    except OSError as failure:
        raise InputError(
            "input.unreadable",
            f"{path}: {failure.strerror}",
            f"[{section}] file must name a file that can be read",
            {"file": str(path)},
        ) from None


def _gunzip(raw: bytes, path: Path, section: str, accept_cut: bool) -> tuple[bytes, bool]:
    """Unpack all members of a gzip file; tell whether it ends early."""
    parts: list[bytes] = []
    rest = raw
    try:
        while rest.startswith(_GZIP):
            member = zlib.decompressobj(wbits=31)
            parts.append(member.decompress(rest))
            if not member.eof:
                break
            rest = member.unused_data
        else:
            return b"".join(parts), False
    except zlib.error as failure:
        raise _corrupt(path, failure) from None
    data = b"".join(parts)
    if not accept_cut:
        raise _truncated(path, section, data.count(b"\n"))
    return data, True
