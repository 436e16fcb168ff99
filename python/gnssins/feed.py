"""What goes into a run: the rows of the tables that take part, handed to the compiled core."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.config import Config
from gnssins.dataset import BaroTable, Dataset, GnssTable, HeadingTable, ImuTable
from gnssins.errors import ConfigError, InputError
from gnssins.units import NS_PER_S

__all__ = ["Cut", "Progress", "call_core", "cut_tables", "refuse_outside"]

Rows = NDArray[np.intp]
Progress = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class Cut:
    """Rows of the tables that take part, and the times of validity of all GNSS rows.

    ``fed`` and ``withheld`` are rows of the GNSS table; ``aid_rows`` the rows fed of the other aids, ``aid_withheld``
    the number of their rows that the outages held back.
    """

    imu: ImuTable
    gnss: GnssTable
    baro: BaroTable
    heading: HeadingTable
    imu_first: int
    fed: Rows
    withheld: Rows
    valid_ns: NDArray[np.int64]
    aid_rows: Mapping[str, Rows]
    aid_withheld: Mapping[str, int]


def cut_tables(config: Config, dataset: Dataset, engine: Mapping[str, Any]) -> Cut:
    """Leave out what lies outside ``start_s`` .. ``end_s`` and hold back what the outages take away.

    Outages take fixes and the headings of two antennas, not the barometer. Rows between ``start_s`` and the initial
    state stay in: the engine counts them as late.
    """
    imu, gnss = dataset.imu, dataset.gnss
    begin_ns, end_ns = np.iinfo(np.int64).min, np.iinfo(np.int64).max
    if config.run.start_s is not None:
        begin_ns = round(config.run.start_s * NS_PER_S)
    if config.run.end_s is not None:
        end_ns = round(config.run.end_s * NS_PER_S)
    inside = (imu.t_ns >= begin_ns) & (imu.t_ns <= end_ns)
    if not inside.any():
        raise InputError(
            "input.empty",
            f"no IMU row between start_s and end_s; the {len(imu)} rows of the log are outside",
            "check [run] start_s and end_s against the clock of the IMU log",
        )
    # rows keep their order, so that time going backwards is seen and not cut away
    first = int(np.argmax(inside))
    last = imu.t_ns.size - int(np.argmax(inside[::-1]))
    if config.initial.position != "gnss" and first > 0 and imu.t_ns[first] > begin_ns:
        first -= 1  # the start lies within an interval: the row before tells where that began

    def shared(
        name: str, t_ns: NDArray[np.int64], outages: Sequence[tuple[float, float]]
    ) -> tuple[Rows, Rows]:
        """Rows of an aid that are fed, and those that are withheld."""
        valid = t_ns - engine[name]["latency_ns"]
        takes_part = (valid >= begin_ns) & (valid <= end_ns)
        held = np.zeros(len(valid), dtype=np.bool_)
        for from_s, to_s in outages:
            held |= (valid >= round(from_s * NS_PER_S)) & (valid < round(to_s * NS_PER_S))
        return np.flatnonzero(takes_part & ~held), np.flatnonzero(takes_part & held)

    fed, withheld = shared("gnss", gnss.t_ns, config.run.outages)
    baro, _ = shared("baro", dataset.baro.t_ns, ())
    heading, no_heading = shared("heading", dataset.heading.t_ns, config.run.outages)
    return Cut(
        imu=imu.select(slice(first, last)),
        gnss=_with_changes(gnss, fed, withheld),
        baro=dataset.baro.select(baro),
        heading=dataset.heading.select(heading),
        imu_first=first,
        fed=fed,
        withheld=withheld,
        valid_ns=gnss.t_ns - engine["gnss"]["latency_ns"],
        aid_rows={"baro": baro, "heading": heading},
        aid_withheld={"heading": int(no_heading.size)},
    )


def _with_changes(gnss: GnssTable, fed: Rows, withheld: Rows) -> GnssTable:
    """The rows that are fed; a change of constellation in a withheld row shows in the next one that is fed."""
    table = gnss.select(fed)
    if gnss.new_constellation is None or not fed.size:
        return table
    changed = np.array(table.new_constellation)
    missed = withheld[gnss.new_constellation[withheld]]
    after = np.searchsorted(fed, missed)
    changed[after[after < fed.size]] = True
    return GnssTable(table.t_ns, table.lla, table.v_n, table.var, changed)


def refuse_outside(config: Config, start_ns: int, end_ns: int) -> None:
    """Raise for a window of ``[run] outages`` of which nothing lies within the filtered span."""
    start_s, end_s = start_ns / NS_PER_S, end_ns / NS_PER_S
    outside = [w for w in config.run.outages if w[1] <= start_s or w[0] >= end_s]
    if outside:
        windows = ", ".join(f"[{from_s:g}, {to_s:g}]" for from_s, to_s in outside)
        raise ConfigError(
            "config.outage_outside",
            f"[run] outages: {len(outside)} of {len(config.run.outages)} windows outside of the filtered span "
            f"{start_s:.3f} to {end_s:.3f} s: {windows}",
            "windows count in s on the clock of the IMU log; the filter starts at the first fix that [initial] can use",
            {"windows_s": [list(w) for w in outside], "start_s": start_s, "end_s": end_s},
        )


def call_core(engine: dict[str, Any], config: Config, cut: Cut, progress: Progress | None) -> dict[str, Any]:
    """Hand the columns to the core, what ``[gnss] use`` leaves out replaced by NaN."""
    gnss = cut.gnss
    position = gnss.lla if config.gnss.uses_position else np.full_like(gnss.lla, np.nan)
    velocity = gnss.v_n if config.gnss.uses_velocity else np.full_like(gnss.v_n, np.nan)
    columns = _core.run(
        json.dumps(engine),
        cut.imu.t_ns,
        cut.imu.gyro,
        cut.imu.accel,
        gnss.t_ns,
        position,
        velocity,
        gnss.var,
        progress,
        gnss_new=gnss.new_constellation,
        baro=(cut.baro.t_ns, cut.baro.height_m, cut.baro.var),
        heading=(cut.heading.t_ns, cut.heading.heading_rad, cut.heading.var),
    )
    return cast("dict[str, Any]", columns)
