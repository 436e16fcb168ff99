"""Bytes of a text file as they should be: unpacked, without byte order mark, lines ended by a line feed."""

from __future__ import annotations

import difflib
import hashlib
import zlib
from dataclasses import dataclass
from pathlib import Path

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
    context = {"file": str(path)}
    if data.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\x00" in data[:4096]:
        raise InputError(
            "input.encoding", f"{path}: UTF-16 or binary data, not delimited text", "export as UTF-8", context
        )
    data = data.removeprefix(b"\xef\xbb\xbf")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if not data.strip():
        raise InputError("input.empty", f"{path}: the file is empty", f"check [{section}] file", context)
    return RawText(data, hashlib.sha256(raw).hexdigest(), cut)


def _read_bytes(path: Path, section: str) -> bytes:
    try:
        return path.read_bytes()
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
        raise InputError(
            "input.corrupt",
            f"{path}: the compressed data are damaged ({failure})",
            "copy the file again",
            {"file": str(path)},
        ) from None
    data = b"".join(parts)
    if not accept_cut:
        lines = data.count(b"\n")
        raise InputError(
            "input.truncated",
            f"{path}: the compressed data end early, after {lines} complete lines",
            f'copy the file again, or set [{section}] on_bad_row = "skip" to use what is there',
            {"file": str(path), "lines": lines},
        )
    return data, True
