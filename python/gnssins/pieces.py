"""A run whose IMU log does not fit in memory: read, filtered and written in pieces, to the same bits."""

from __future__ import annotations

import os
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import polars as pl

from gnssins import storage
from gnssins.alignment import USUAL_ROWS, InitialState, initial_state, last_row_needed_ns
from gnssins.checks import Finding, ImuLook, judge, raise_on_stop
from gnssins.collect import collect, collect_epochs, no_epochs
from gnssins.config import Config
from gnssins.dataset import Dataset, ImuPiece, ImuTable, Source
from gnssins.errors import ConfigError, GnssinsError, InputError
from gnssins.feed import ImuTrim, Progress, cut_aids, limits_ns, refuse_outside, start_core
from gnssins.io import format_of, imu_file, read_aids
from gnssins.io.raw import file_digest
from gnssins.outputs import make_folder
from gnssins.result import Result
from gnssins.runner import (
    Start,
    about_run,
    as_config,
    as_initial,
    attach,
    engine_of,
    listed_files,
    run_metadata,
)
from gnssins.storage import covariance_table

__all__ = ["run_pieces"]

#: Errors of the search for a start that more of the log may mend.
_MORE_MAY_HELP: Final = (
    "input.empty",
    "input.no_start_fix",
    "input.no_course",
    "input.no_imu",
    "input.no_sd",
)


def run_pieces(
    config: Config | Mapping[str, Any] | str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    rows: int = 1_000_000,
    progress: Progress | None = None,
    initial: Start | None = None,
    told: Callable[[list[Finding]], object] | None = None,
) -> Result:
    """Process a recording that is larger than memory.

    The IMU log is read in pieces, each is filtered and its epochs are written before the next is read. The files of
    the aids are read whole. The numbers are those of :func:`gnssins.run`, to the bit.

    Parameters
    ----------
    config : Config, mapping or path
        As for :func:`gnssins.run`; it names the files.
    folder : path
        Where the result goes; read it with :meth:`gnssins.Result.open`, or piece by piece with polars.
    rows : int, optional
        IMU rows of a piece, at least 1000: some 0.5 kB of memory for each while text is read, and 0.4 kB for each
        epoch of the output.
    progress, initial, told
        As for :func:`gnssins.run`. ``told`` gets the findings of the first piece.

    Returns
    -------
    Result
        Without its epochs and covariances, which are in the folder alone; records, events, counts and metadata are
        there.

    Raises
    ------
    ConfigError
        Also for ``[imu] on_backwards = "sort"`` and ``[run] linearise``, which need the log as a whole
        (``config.pieces``).
    InputError, DataQualityError, TimeOrderError, GapError, CovarianceError, NavigationError
        As :func:`gnssins.run`. What only the whole log can tell (share of bad rows, no common time with the fixes, a
        unit that shows only later) is raised at its end; nothing is written then.

    Notes
    -----
    The look at the data takes the first piece before the filter starts, and all rows by its end: the findings in
    ``metadata["finding"]`` are those of the whole log, except that the usual step and the unevenness of the stamps are
    those of its start. The reference of ``[truth]`` is not read. Rows after ``[run] end_s`` are not read on once
    a whole piece lies there.
    """
    clock = time.perf_counter()
    config_file = os.fspath(config) if isinstance(config, str | os.PathLike) else None
    config = as_config(config)
    _refuse_whole(config, rows)
    file, aids = imu_file(config), read_aids(config)
    look, trim = ImuLook(aids.imu.kind, aids.gnss, config), ImuTrim(config)
    findings: list[Finding] = []
    try:
        findings = _first_look(config, aids, rows)
        if told is not None:
            told(findings)
        raise_on_stop(findings)
        start = as_initial(initial) if initial is not None else _initial_state(config, aids, rows)
        engine = engine_of(config, start, aids.imu.kind)
        cut = cut_aids(config, aids, engine)
        core = start_core(engine, config, cut)
        prepared = time.perf_counter()
        with _parts(Path(folder), core.states()) as parts:
            counted, last_ns = _Count(), start.t_ns
            for piece in _pieces(config, rows):
                look.add(piece.table)
                counted.add(piece.source)
                imu = trim.take(piece.table)
                if len(imu):
                    last_ns = int(imu.t_ns[-1])
                    parts.add(core.imu(imu.t_ns, imu.gyro, imu.accel))
                if trim.ended:
                    break
                if progress is not None:
                    progress(min(piece.share, 0.999))
            trim.refuse_nothing()
            refuse_outside(config, start.t_ns, last_ns)
            about = core.finish()
            aids = replace(aids, sources={str(file): counted.source(file), **aids.sources})
            findings = judge(look, aids, config)
            raise_on_stop(findings)
            times = {"prepare_s": prepared - clock, "filter_s": time.perf_counter() - prepared}
            inputs = listed_files(aids.sources.values())
            metadata = run_metadata(config, about_run(config_file, times), inputs, engine, findings)
            cut = replace(cut, imu_first=trim.first or 0)
            result = collect({**no_epochs(len(about["states"])), **about}, aids, cut, metadata)
            storage.save_with(result, Path(folder), parts.write_navigation, parts.write_covariance)
    except GnssinsError as error:
        attach(error, findings, repeat=told is None)
        raise
    if progress is not None:
        progress(1.0)
    return result


def _refuse_whole(config: Config, rows: int) -> None:
    """Raise for what needs the IMU log as a whole."""
    keys = [('[imu] on_backwards = "sort"', config.imu.on_backwards == "sort")]
    keys += [("[run] linearise", config.run.linearise)]
    asked = [key for key, given in keys if given]
    if asked:
        raise ConfigError(
            "config.pieces",
            f"{' and '.join(asked)}: not possible in pieces, needs the whole IMU log in memory",
            'sort the file first, or set on_backwards = "drop"; leave linearise out',
            {"keys": asked},
        )
    if rows < USUAL_ROWS:
        raise ConfigError(
            "config.pieces",
            f"pieces of {rows} IMU rows, needs at least {USUAL_ROWS}",
            "a million is a good size",
            {"rows": rows},
        )


def _pieces(config: Config, rows: int) -> Iterator[ImuPiece]:
    file = imu_file(config)
    return format_of(file).imu_pieces(file, config.imu, rows)


def _first_look(config: Config, aids: Dataset, rows: int) -> list[Finding]:
    """What the first piece shows of the whole log."""
    look = ImuLook(aids.imu.kind, aids.gnss, config)
    first = next(_pieces(config, rows), None)
    if first is not None:
        look.add(first.table)
    return judge(look, aids, config, whole=first is None)


def _initial_state(config: Config, aids: Dataset, rows: int) -> InitialState:
    """The state that the whole log would give, from as many pieces as it takes."""
    begin_ns, _ = limits_ns(config)
    head, failure = aids.imu, None
    for piece in _pieces(config, rows):
        if piece.table.t_ns.size and int(piece.table.t_ns.max()) < begin_ns:
            head = piece.table  # what lies before the start is not needed, only the row next to it
            continue
        head = ImuTable.joined(head, piece.table)
        try:
            start = initial_state(config, replace(aids, imu=head))
        except InputError as error:
            if error.code not in _MORE_MAY_HELP:
                raise
            failure = error
            continue
        failure = None
        if int(head.t_ns[-1]) >= last_row_needed_ns(config, start):
            return start
    if failure is not None:
        raise failure
    return initial_state(config, replace(aids, imu=head))


@dataclass
class _Count:
    """Rows of the file, summed over its pieces."""

    rows: int = 0
    skipped: Counter[str] = field(default_factory=Counter)

    def add(self, source: Source) -> None:
        self.rows += source.rows
        self.skipped.update(source.skipped)

    def source(self, file: Path) -> Source:
        return Source(str(file), file_digest(file), self.rows, dict(self.skipped))


@dataclass
class _Parts:
    """Tables over time on their way to the folder: a file for every piece, joined at the end."""

    folder: Path
    states: Sequence[Mapping[str, Any]]
    count: int = 0

    def add(self, columns: Mapping[str, Any]) -> None:
        """Write what a piece has given."""
        epochs = collect_epochs(columns, self.states)
        epochs.navigation.write_parquet(self.folder / f"navigation-{self.count:06d}.parquet")
        covariance_table(epochs).write_parquet(self.folder / f"covariance-{self.count:06d}.parquet")
        self.count += 1

    def write_navigation(self, path: Path) -> None:
        """Join the trajectories."""
        pl.scan_parquet(self.folder / "navigation-*.parquet").sink_parquet(path)

    def write_covariance(self, path: Path) -> None:
        """Join the snapshots of the covariance."""
        pl.scan_parquet(self.folder / "covariance-*.parquet").sink_parquet(path)


@contextmanager
def _parts(folder: Path, states: Sequence[Mapping[str, Any]]) -> Iterator[_Parts]:
    """A place for the parts beside the result, gone at the end whatever happens."""
    with tempfile.TemporaryDirectory(prefix=".parts-", dir=make_folder(folder)) as name:
        yield _Parts(Path(name), states)
