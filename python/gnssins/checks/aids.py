"""Checks of the barometer and of headings: clock, accuracy, unit, and what GNSS says about the same quantity."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..config import Config
from ..dataset import BaroTable, Dataset, GnssTable, HeadingTable
from ..units import HEIGHT, NS_PER_S, ms_to_ns
from .findings import Finding

__all__ = ["check_aids"]

Array = NDArray[np.float64]

_MOVING_M_S = 3.0
"""Speed from which the course of the fixes is worth a comparison."""
_LEAST_PAIRS = 20
"""Pairs of an aid and a fix below which nothing is said."""
_FOOT_M = HEIGHT["ft"]
_HIGH_M = 30.0
"""Height above the ellipsoid from which the ratio of two heights tells their units."""


def check_aids(dataset: Dataset, config: Config | None, span_ns: tuple[int, int] | None) -> Iterator[Finding]:
    """Look at the aids beside GNSS.

    Parameters
    ----------
    dataset : Dataset
        The aids, uncut.
    span_ns : tuple of int, or None
        First and last time of the IMU log.
    config : Config, optional
        Adds latencies and the blocks of the filter.

    Yields
    ------
    Finding
        ``time.no_overlap``, ``data.baro_sd``, ``data.heading_sd``, ``data.heading_unit``, ``data.heading_offset``,
        ``data.baro_unit``, ``data.baro_offset``, ``config.no_baro_bias``.
    """
    tables: tuple[tuple[str, BaroTable | HeadingTable], ...] = (
        ("baro", dataset.baro),
        ("heading", dataset.heading),
    )
    for name, table in tables:
        if len(table):
            latency_ms = 0.0 if config is None else getattr(config, name).latency_ms
            yield from _overlap(span_ns, table, name, ms_to_ns(latency_ms))
            yield from _accuracy(table, name)
    if len(dataset.heading):
        yield from _heading(dataset.heading, dataset.gnss)
    if len(dataset.baro):
        yield from _height(dataset.baro, dataset.gnss)
        yield from _no_bias(config)


def _overlap(
    span_ns: tuple[int, int] | None, table: BaroTable | HeadingTable, name: str, latency_ns: int
) -> Iterator[Finding]:
    if span_ns is None:
        return
    first, last = span_ns
    valid = table.t_ns - latency_ns
    if ((valid >= first) & (valid <= last)).any():
        return
    yield Finding(
        "stop",
        "time.no_overlap",
        f"{name}: {valid.min() / NS_PER_S:.3f} to {valid.max() / NS_PER_S:.3f} s, IMU: {first / NS_PER_S:.3f} to "
        f"{last / NS_PER_S:.3f} s: none of {len(table)} rows lies within the IMU log",
        f"check [{name}] time_column and time_unit: both logs must count on one clock",
        len(table),
    )


def _accuracy(table: BaroTable | HeadingTable, name: str) -> Iterator[Finding]:
    bad = ~(table.var > 0.0)
    if not bad.any():
        return
    first = int(np.argmax(bad))
    yield Finding(
        "stop" if bad.all() else "warn",
        f"data.{name}_sd",
        f"{name}: sd is missing, zero or negative in {int(bad.sum())} of {len(table)} rows (first: row {first})",
        f"check [{name}] sd_column, or set {'height_sd_m' if name == 'baro' else 'heading_sd_deg'}; such rows are not "
        "used",
        int(bad.sum()),
    )


def _heading(table: HeadingTable, gnss: GnssTable) -> Iterator[Finding]:
    known = np.isfinite(table.heading_rad)
    far = known & (np.abs(table.heading_rad) > 4.0 * np.pi)
    if far.sum() > 0.5 * known.sum():
        yield Finding(
            "stop",
            "data.heading_unit",
            f"heading: {int(far.sum())} of {len(table)} values beyond two turns: degrees read as radians?",
            'set [heading] angle_unit = "deg"',
            int(far.sum()),
        )
        return
    speed = np.hypot(gnss.v_n[:, 0], gnss.v_n[:, 1])
    moving = np.flatnonzero(np.isfinite(speed) & (speed > _MOVING_M_S))
    rows = _nearest(table.t_ns, gnss.t_ns[moving])
    course = np.arctan2(gnss.v_n[moving, 1], gnss.v_n[moving, 0])
    off = (table.heading_rad[rows] - course)[np.isfinite(table.heading_rad[rows])]
    if off.size < _LEAST_PAIRS:
        return
    mean = np.angle(np.mean(np.exp(1j * off)))
    spread = float(np.degrees(np.median(np.abs(np.angle(np.exp(1j * (off - mean)))))))
    offset = float(np.degrees(mean))
    if abs(offset) > 30.0 and spread < 15.0:
        yield Finding(
            "warn",
            "data.heading_offset",
            f"heading: {offset:+.0f} deg from the course of {off.size} moving fixes, steady within {spread:.0f} deg",
            f"set [heading] offset_deg = {offset:.0f} if the antennas lie across; the vehicle may also drive "
            "backwards or drift",
            int(off.size),
        )


def _height(table: BaroTable, gnss: GnssTable) -> Iterator[Finding]:
    fixes = np.flatnonzero(np.isfinite(gnss.lla[:, 2]))
    rows = _nearest(table.t_ns, gnss.t_ns[fixes])
    baro, height = table.height_m[rows], gnss.lla[fixes, 2]
    both = np.isfinite(baro)
    baro, height = baro[both], height[both]
    if baro.size < _LEAST_PAIRS:
        return
    scale = float(np.median(baro) / np.median(height)) if abs(np.median(height)) > _HIGH_M else 1.0
    if abs(scale * _FOOT_M - 1.0) < 0.1 or abs(scale / _FOOT_M - 1.0) < 0.1:
        unit = "ft" if scale > 1.0 else "m"
        yield Finding(
            "stop",
            "data.baro_unit",
            f"baro: heights are {scale:.2f} times those of {baro.size} fixes",
            f'set [baro] height_unit = "{unit}"',
            int(baro.size),
        )
        return
    offset = float(np.median(baro - height))
    if abs(offset) > 20.0:
        yield Finding(
            "warn",
            "data.baro_offset",
            f"baro: {offset:+.0f} m from the height of {baro.size} fixes",
            "heights count above the ellipsoid: set [baro] geoid_height_m, or give the block baro_bias an initial_sd "
            "that covers this",
            int(baro.size),
        )


def _no_bias(config: Config | None) -> Iterator[Finding]:
    if config is None:
        return
    if not any(block["kind"] == "baro_bias" for block in config.engine_config()["blocks"]):
        yield Finding(
            "warn",
            "config.no_baro_bias",
            "baro: the filter has no block of kind baro_bias: the altimeter counts as free of bias",
            'add [[filter.block]] kind = "baro_bias", process = "random_walk" with initial_sd and walk',
        )


def _nearest(t_ns: NDArray[np.int64], at_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Rows of sorted-enough stamps that lie next after the given times."""
    order = np.argsort(t_ns, kind="stable")
    return np.asarray(order[np.clip(np.searchsorted(t_ns[order], at_ns), 0, t_ns.size - 1)])
