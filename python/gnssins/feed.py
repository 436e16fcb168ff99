"""What goes into a run: the rows of the tables that take part, handed to the compiled core."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.config import Config
from gnssins.dataset import BaroTable, Dataset, GnssTable, HeadingTable, ImuTable
from gnssins.errors import ConfigError, InputError
from gnssins.units import NS_PER_S

__all__ = [
    "Cut",
    "ImuTrim",
    "Progress",
    "call_core",
    "cut_aids",
    "cut_tables",
    "limits_ns",
    "refuse_outside",
    "start_core",
]

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
    trim = ImuTrim(config)
    imu = trim.take(dataset.imu)
    trim.refuse_nothing()
    return replace(cut_aids(config, dataset, engine), imu=imu, imu_first=trim.first or 0)


class ImuTrim:
    """Leaves out the rows of an IMU log before ``start_s`` and after ``end_s``; takes it whole or in pieces.

    Rows keep their order, so that time going backwards is seen and not cut away.

    Attributes
    ----------
    seen : int
        Rows of the log so far.
    first : int or None
        The first row that takes part.
    ended : bool
        The last piece lay after ``end_s`` as a whole.
    """

    def __init__(self, config: Config) -> None:
        self._begin_ns, self._end_ns = limits_ns(config)
        self._unlimited = config.run.start_s is None and config.run.end_s is None
        # the start lies within an interval: the row before tells where that began
        self._with_row_before = config.initial.position != "gnss"
        self._before: ImuTable | None = None
        self._tail: ImuTable | None = None
        self.seen = 0
        self.first: int | None = None
        self.ended = False

    def take(self, imu: ImuTable) -> ImuTable:
        """Rows of the next piece that take part; rows after ``end_s`` do if one inside comes after them."""
        if self._unlimited and len(imu):
            self.first, self.seen = self.first or 0, self.seen + len(imu)
            return imu
        inside = (imu.t_ns >= self._begin_ns) & (imu.t_ns <= self._end_ns)
        seen, self.seen = self.seen, self.seen + len(imu)
        if not inside.any():
            self.ended = self.first is not None
            if self.first is None and len(imu):
                self._before = imu.select(slice(-1, None))
            elif self._tail is not None:
                self._tail = ImuTable.joined(self._tail, imu)
            return imu.select(slice(0, 0))
        last = imu.t_ns.size - int(np.argmax(inside[::-1]))
        kept = imu.select(slice(0, last))
        if self.first is None:
            row = int(np.argmax(inside))
            between = self._with_row_before and imu.t_ns[row] > self._begin_ns
            if between and row == 0 and self._before is not None:
                kept, self.first = ImuTable.joined(self._before, kept), seen - 1
            else:
                row -= int(between and row > 0)
                kept, self.first = imu.select(slice(row, last)), seen + row
        elif self._tail is not None and len(self._tail):
            kept = ImuTable.joined(self._tail, kept)
        self._tail, self.ended = imu.select(slice(last, None)), False
        return kept

    def refuse_nothing(self) -> None:
        """Raise if no row took part."""
        if self.first is None:
            raise InputError(
                "input.empty",
                f"no IMU row between start_s and end_s; the {self.seen} rows of the log are outside",
                "check [run] start_s and end_s against the clock of the IMU log",
            )


def limits_ns(config: Config) -> tuple[int, int]:
    """First and last time that ``[run]`` lets in."""
    start_s, end_s = config.run.start_s, config.run.end_s
    span = np.iinfo(np.int64)
    return (
        int(span.min) if start_s is None else round(start_s * NS_PER_S),
        int(span.max) if end_s is None else round(end_s * NS_PER_S),
    )


def cut_aids(config: Config, dataset: Dataset, engine: Mapping[str, Any]) -> Cut:
    """Cut the tables of the aids; the IMU table is that of the data set."""
    gnss = dataset.gnss
    begin_ns, end_ns = limits_ns(config)

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
        imu=dataset.imu,
        gnss=_with_changes(gnss, fed, withheld),
        baro=dataset.baro.select(baro),
        heading=dataset.heading.select(heading),
        imu_first=0,
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
    """Hand the columns to the core."""
    imu, (fixes, others) = cut.imu, _aid_columns(config, cut)
    columns = _core.run(json.dumps(engine), imu.t_ns, imu.gyro, imu.accel, *fixes, progress, **others)
    return cast("dict[str, Any]", columns)


def start_core(engine: dict[str, Any], config: Config, cut: Cut) -> _core.Run:
    """Hand the aids to the core; the IMU log comes later, in pieces."""
    fixes, others = _aid_columns(config, cut)
    return _core.Run(json.dumps(engine), *fixes, **others)


def _aid_columns(config: Config, cut: Cut) -> tuple[tuple[Any, Any, Any, Any], dict[str, Any]]:
    """Columns of the aids as the core takes them, what ``[gnss] use`` leaves out replaced by NaN."""
    gnss, baro, heading = cut.gnss, cut.baro, cut.heading
    position = gnss.lla if config.gnss.uses_position else np.full_like(gnss.lla, np.nan)
    velocity = gnss.v_n if config.gnss.uses_velocity else np.full_like(gnss.v_n, np.nan)
    others = {
        "gnss_new": gnss.new_constellation,
        "baro": (baro.t_ns, baro.height_m, baro.var),
        "heading": (heading.t_ns, heading.heading_rad, heading.var),
    }
    return (gnss.t_ns, position, velocity, gnss.var), others
