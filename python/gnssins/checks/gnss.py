"""Checks of the fixes: plausible places, consistent velocity, usable accuracy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..dataset import Array, GnssTable
from ..units import DEG_TO_RAD, NS_PER_S
from .findings import Finding
from .motion import Fit, fit, rising, spans

_EARTH_M = 6.371e6
_SPAN_S = 4.0
"""Length of track that is compared with the velocity: long enough for the noise of the fixes not to matter."""

_TRACK_TEXT = "gnss: the track does not follow the velocity ({pairs} pairs of fixes)"

_FAR_M = 12.0
_GOOD = 0.3
"""Relative difference of track and velocity that is called consistent."""

_EXACT = 0.03
"""Relative distance of track over velocity to a factor between units that still counts as that factor."""

_SPEED_UNITS = (
    (1.0 / 3.6, "km/h: divide the velocity columns by 3.6"),
    (0.01, "cm/s: divide the velocity columns by 100"),
    (0.001, "mm/s: divide the velocity columns by 1000"),
    (1000.0, "km/s: multiply the velocity columns by 1000"),
)


def check_gnss(gnss: GnssTable) -> Iterator[Finding]:
    """Look at the fixes.

    Parameters
    ----------
    gnss : GnssTable
        The fixes.

    Yields
    ------
    Finding
        ``data.gnss_range``, ``data.gnss_null``, ``data.gnss_swapped``, ``data.gnss_unit``,
        ``data.gnss_velocity``, ``data.gnss_vertical``, ``data.gnss_sigma``, ``data.gnss_empty``.
    """
    if not len(gnss):
        return
    fixes = gnss.has_position
    speeds = gnss.has_velocity
    neither = ~fixes & ~speeds
    if neither.any():
        count = int(neither.sum())
        yield Finding(
            "stop" if neither.all() else "info",
            "data.gnss_empty",
            f"gnss: {count} of {len(gnss)} rows have neither position nor velocity",
            "check the columns in [gnss]" if neither.all() else "these rows are counted as bad",
            count,
        )
    yield from _sigma(gnss)
    places = list(_places(gnss.lla[fixes]))
    yield from places
    if not any(finding.level == "stop" for finding in places):
        yield from _track(gnss)


def _sigma(gnss: GnssTable) -> Iterator[Finding]:
    var = gnss.var if gnss.var.ndim == 2 else np.diagonal(gnss.var, axis1=1, axis2=2)
    present = np.isfinite(np.hstack([gnss.lla, gnss.v_n]))
    bad = (present & ~(var > 0.0)).any(axis=1)
    count = int(bad.sum())
    if count:
        yield Finding(
            "stop" if count == len(gnss) else "warn",
            "data.gnss_sigma",
            f"gnss: {count} of {len(gnss)} rows have a zero, negative or missing accuracy, first row "
            f"{int(np.flatnonzero(bad)[0]) + 1}",
            'such rows are not used; set [gnss] position_sd_floor_m, velocity_sd_floor_m_s, or sd = "config"',
            count,
        )


def _places(lla: Array) -> Iterator[Finding]:
    if not lla.shape[0]:
        return
    lat, lon, height = lla.T
    null = (lat == 0.0) & (lon == 0.0)
    if null.any():
        yield Finding(
            "stop" if null.all() else "warn",
            "data.gnss_null",
            f"gnss: {int(null.sum())} fixes at latitude 0, longitude 0",
            "rows without a fix; the receiver should write nan",
            int(null.sum()),
        )
    outside = (np.abs(lat) > np.pi / 2) | (np.abs(lon) > 2.0 * np.pi)
    if outside.any():
        count = int(outside.sum())
        swapped = bool((np.abs(lat) <= 2.0 * np.pi).all() and (np.abs(lon) <= np.pi / 2).all())
        degrees = bool((np.abs(lat) <= 90.0).all() and (np.abs(lon) <= 360.0).all()) and not swapped
        hint = "latitude and longitude swapped? check position_columns" if swapped else "check angle_unit"
        if degrees:
            hint = 'likely: [gnss] angle_unit = "deg" (now read as rad)'
        yield Finding(
            "stop" if count > 0.5 * lat.size else "warn",
            "data.gnss_range",
            f"gnss: {count} of {lat.size} fixes with latitude beyond 90 deg or longitude beyond 360 deg",
            hint,
            count,
        )
    low = (height < -1000.0) | (height > 1e6)
    if low.any():
        text = f"gnss: {int(low.sum())} fixes below -1 km or above 1000 km height"
        yield Finding("warn", "data.gnss_range", text, "height in mm or of wrong sign?", int(low.sum()))


def _track(gnss: GnssTable) -> Iterator[Finding]:
    """Displacement over a few seconds against the velocity: finds swapped axes, wrong signs and wrong units."""
    use = gnss.has_position & gnss.has_velocity & rising(gnss.t_ns)
    t_s, lla, v_n = gnss.t_ns[use] / NS_PER_S, gnss.lla[use], gnss.v_n[use]
    first, last = spans(t_s, _SPAN_S, 2.0 * _SPAN_S)
    v_n = np.nan_to_num(v_n)
    path = np.zeros_like(v_n)  # trapezoids
    np.cumsum(0.5 * (v_n[1:] + v_n[:-1]) * np.diff(t_s)[:, None], axis=0, out=path[1:])
    way, change = path[last] - path[first], lla[last] - lla[first]
    too_small = list(_too_small(way, change, lla[first, 0]))
    if too_small:
        yield from too_small
        return
    far = np.linalg.norm(way[:, :2], axis=1) > _FAR_M
    if far.sum() < 10:
        return
    way, change, lat, lon = way[far], change[far], lla[first, 0][far], lla[first, 1][far]
    pairs = int(far.sum())
    shift = _EARTH_M * np.column_stack([change[:, 0], change[:, 1] * np.cos(lat)])
    if _mismatch(shift, way[:, :2]) > _GOOD:
        crossed = _EARTH_M * np.column_stack([change[:, 1], change[:, 0] * np.cos(lon)])
        yield from _explain(shift, crossed, way[:, :2], pairs)
    vertical = fit(-way[:, 2], change[:, 2])
    if vertical.correlation < -0.7:
        yield Finding(
            "warn",
            "data.gnss_vertical",
            f"gnss: height falls while the velocity says up ({pairs} pairs of fixes)",
            'down must be positive in vd; for up-positive columns set [gnss] velocity_axes = "ENU"',
            pairs,
        )


def _too_small(way: Array, change: Array, lat: Array) -> Iterator[Finding]:
    """Find velocities so small that by them the vehicle hardly moves, while the track is a multiple of them."""
    shift = _EARTH_M * np.column_stack([change[:, 0], change[:, 1] * np.cos(lat)])
    far = np.linalg.norm(shift, axis=1) > _FAR_M
    if far.sum() >= 10:
        scale = fit(way[far, :2].ravel(), shift[far].ravel())
        if scale.slope > 100.0:
            yield from _speed_unit(scale, _TRACK_TEXT.format(pairs=int(far.sum())), int(far.sum()))


def _speed_unit(scale: Fit, text: str, pairs: int) -> Iterator[Finding]:
    """Name the unit of the velocity if the track over it is a factor between units."""
    for factor, unit in _SPEED_UNITS:
        if scale.correlation > 0.95 and abs(scale.slope / factor - 1.0) < _EXACT:
            found = f"{text}; the track is {scale.slope:.3g} times the velocity"
            yield Finding("stop", "data.gnss_velocity", found, f"likely the velocity is in {unit}", pairs)


def _explain(shift: Array, crossed: Array, way: Array, pairs: int) -> Iterator[Finding]:
    """Say why the track (m, as it is and with latitude and longitude exchanged) leaves the velocity."""
    scale = fit(way.ravel(), shift.ravel())
    text = _TRACK_TEXT.format(pairs=pairs)
    unit = list(_speed_unit(scale, text, pairs))
    turned, exchanged = _mismatch(shift, way[:, ::-1]), _mismatch(crossed, way)
    if turned < min(_GOOD, exchanged):
        hint = 'velocity columns in the order east, north: swap them, or set [gnss] velocity_axes = "ENU"'
        yield Finding("stop", "data.gnss_velocity", text, hint, pairs)
    elif unit:
        yield from unit
    elif exchanged < _GOOD:
        hint = "latitude and longitude swapped: exchange the first two of [gnss] position_columns"
        yield Finding("stop", "data.gnss_swapped", text, hint, pairs)
    elif scale.correlation > 0.9 and abs(scale.slope * DEG_TO_RAD - 1.0) < _GOOD:
        yield Finding(
            "stop", "data.gnss_unit", text, 'likely: [gnss] angle_unit = "deg" (now read as rad)', pairs
        )
    elif scale.correlation > 0.9 and abs(scale.slope / DEG_TO_RAD - 1.0) < _GOOD:
        yield Finding(
            "stop", "data.gnss_unit", text, 'likely: [gnss] angle_unit = "rad" (now read as deg)', pairs
        )
    else:
        factor = f"; the track is {scale.slope:.3g} times the velocity" if scale.correlation > 0.9 else ""
        hint = "check the units and the order of the velocity columns, and the clock"
        yield Finding("warn", "data.gnss_velocity", text + factor, hint, pairs)


def _mismatch(shift: Array, way: Array) -> float:
    """Median difference of two displacements, relative to the second."""
    length = np.linalg.norm(way, axis=1)
    return float(np.median(np.linalg.norm(shift - way, axis=1) / np.maximum(length, 1e-6)))
