"""Tables as CSV and tracks as KML."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import TYPE_CHECKING, Final
from xml.sax.saxutils import escape

import numpy as np
import polars as pl
from numpy.typing import NDArray

from gnssins.errors import InputError
from gnssins.storage import write_atomic

if TYPE_CHECKING:
    from gnssins.result import Result

__all__ = ["write_csv", "write_kml"]

#: Decimals of the columns of a CSV file; the others get :data:`SIGNIFICANT` figures. 1e-10 deg is 11 micrometres.
DECIMALS: Final = {"time_s": 9, "lat_deg": 10, "lon_deg": 10, "height_m": 5}

#: Significant figures of all other columns.
SIGNIFICANT: Final = 9

#: Most points of a KML track; viewers slow down beyond it.
KML_POINTS: Final = 20_000


def write_csv(table: pl.DataFrame, path: str | Path) -> Path:
    """Write a table as CSV, one header line, comma, ``nan`` for a missing number.

    Columns that hold a matrix per row are left out. Numbers are rounded well below any accuracy: see
    :data:`DECIMALS` and :data:`SIGNIFICANT`.

    Parameters
    ----------
    table : polars.DataFrame
        Such as :attr:`gnssins.Result.navigation` or :attr:`gnssins.Result.measurements`.
    path : str or Path
        File to write; compressed when the name ends in ``.gz``.

    Returns
    -------
    Path
        The file.
    """
    plain = [c.name for c in table if not isinstance(c.dtype, pl.Array)]
    rounded = table.select(
        pl.col(name).round(DECIMALS[name])
        if name in DECIMALS
        else pl.col(name).round_sig_figs(SIGNIFICANT)
        if table.schema[name] == pl.Float64
        else pl.col(name)
        for name in plain
    )

    def write(temporary: Path) -> None:
        if str(path).endswith(".gz"):
            temporary.write_bytes(gzip.compress(rounded.write_csv().encode(), compresslevel=6, mtime=0))
        else:
            rounded.write_csv(temporary)

    target = Path(path)
    write_atomic(target, write)
    return target


def write_kml(result: Result, path: str | Path, *, name: str = "") -> Path:
    """Write the track as KML 2.2: the whole line, the parts without GNSS on top in another colour, start and end.

    Heights are above the ellipsoid, while KML means mean sea level; a viewer therefore shows the line off by the
    height of the geoid (up to 100 m).

    Parameters
    ----------
    result : Result
        With at least one epoch.
    path : str or Path
        File to write.
    name : str
        Title in the viewer; the name of the file when empty.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        The result is empty.
    """
    if not len(result):
        raise InputError("input.empty", "a result without epochs has no track to write")
    target = Path(path)
    lla = np.column_stack([np.degrees(result.lla[:, :2]), result.lla[:, 2]])
    parts = [_line("Track", "track", _thinned(lla))]
    for number, (start, end) in enumerate(result.outages(), start=1):
        inside = lla[(result.t_ns >= start) & (result.t_ns <= end)]
        if len(inside) > 1:
            parts.append(_line(f"Without GNSS {number}", "outage", _thinned(inside)))
    parts += [_point("Start", lla[0]), _point("End", lla[-1])]
    text = _DOCUMENT.format(name=escape(name or target.stem), parts="\n".join(parts))
    write_atomic(target, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return target


def _thinned(lla: NDArray[np.float64]) -> NDArray[np.float64]:
    """At most :data:`KML_POINTS` points, evenly spaced in time, first and last included."""
    if len(lla) <= KML_POINTS:
        return lla
    return lla[np.linspace(0, len(lla) - 1, KML_POINTS).round().astype(np.int64)]


def _coordinates(lla: NDArray[np.float64]) -> str:
    return "\n".join(f"{lon:.9f},{lat:.9f},{height:.3f}" for lat, lon, height in lla)


def _line(name: str, style: str, lla: NDArray[np.float64]) -> str:
    return (
        f"<Placemark><name>{escape(name)}</name><styleUrl>#{style}</styleUrl><LineString>"
        f"<altitudeMode>absolute</altitudeMode><coordinates>\n{_coordinates(lla)}\n</coordinates>"
        f"</LineString></Placemark>"
    )


def _point(name: str, lla: NDArray[np.float64]) -> str:
    return (
        f"<Placemark><name>{escape(name)}</name><Point><altitudeMode>absolute</altitudeMode>"
        f"<coordinates>{_coordinates(lla[None])}</coordinates></Point></Placemark>"
    )


# KML colours are aabbggrr
_DOCUMENT: Final = """<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2"><Document><name>{name}</name>
<Style id="track"><LineStyle><color>ffb27200</color><width>3</width></LineStyle></Style>
<Style id="outage"><LineStyle><color>ff005ed5</color><width>5</width></LineStyle></Style>
{parts}
</Document></kml>
"""
