"""The folder of a saved result, and how it is written and read.

=======================  ======================================================================================
``navigation.parquet``   one row per epoch; columns of :attr:`gnssins.Result.navigation`
``measurements.parquet`` one row per GNSS row; columns of :attr:`gnssins.Result.measurements`
``aids.parquet``         one row per row of the other aids; columns of :attr:`gnssins.Result.aid_measurements`
``covariance.parquet``   ``t_ns`` and ``covariance`` (n*n numbers row by row, SI, order of the states)
``events.csv``           ``time_s, code, row, value, message``
``state.bin``            state of the engine at the end, for :meth:`gnssins.Navigator.restore`
``run.toml``             versions, input hashes, counts, seed, the whole configuration, the list of states
=======================  ======================================================================================

Times come back from the ``time_s`` column: to the nanosecond on clocks below 4e6 s, to 0.25 microseconds when the
seconds count from the start of GPS time.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np
import polars as pl
import tomlkit
from numpy.typing import NDArray

from gnssins import tables
from gnssins.errors import InputError, MissingFileError
from gnssins.outputs import RESULT_FILES, make_folder, refuse_inputs
from gnssins.tables import State
from gnssins.units import times_to_ns

if TYPE_CHECKING:
    from gnssins.result import AidRecords, Event, Records, Result

__all__ = ["FORMAT", "covariance_table", "load", "save", "save_with", "write_atomic"]

#: Version of the layout of the folder.
FORMAT: Final = 1

RUN_FILE: Final = "run.toml"

T = TypeVar("T")


def write_atomic(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a temporary file in the same folder, then rename it to ``path``.

    A reader sees the old file or the new one, never a part; on any failure the temporary file goes away.
    """
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        temporary.chmod(0o644)
        temporary.replace(path)
    except BaseException:
        with suppress(FileNotFoundError):
            temporary.unlink()
        raise


def save(result: Result, folder: str | Path) -> Path:
    """Write ``result`` into ``folder``; ``run.toml`` goes first when it is there and comes last when all is written."""
    return save_with(
        result,
        folder,
        lambda path: result.navigation.write_parquet(path),
        lambda path: covariance_table(result).write_parquet(path),
    )


def save_with(
    result: Result,
    folder: str | Path,
    navigation: Callable[[Path], object],
    covariance: Callable[[Path], object],
) -> Path:
    """Write ``result`` as :func:`save` does, the two tables over time by functions that fill a file."""
    target = Path(folder)
    inputs = [entry.get("file") for entry in result.metadata.get("input", [])]
    inputs.append(result.metadata.get("run", {}).get("config_file"))
    refuse_inputs([target / name for name in RESULT_FILES], inputs)
    make_folder(target)
    (target / RUN_FILE).unlink(missing_ok=True)
    write_atomic(target / "navigation.parquet", navigation)
    write_atomic(target / "measurements.parquet", result.measurements.write_parquet)
    write_atomic(target / "aids.parquet", result.aid_measurements.write_parquet)
    write_atomic(target / "events.csv", result.events.write_csv)
    write_atomic(target / "covariance.parquet", covariance)
    write_atomic(target / "state.bin", lambda path: path.write_bytes(result.final_state))
    text = tomlkit.dumps(_run_document(result))
    write_atomic(target / RUN_FILE, lambda path: path.write_text(text, encoding="utf-8"))
    return target


def covariance_table(result: Result) -> pl.DataFrame:
    """Snapshots of the covariance as a table."""
    n = len(result.states)
    flat = np.ascontiguousarray(result.covariance.matrix.reshape(-1, n * n))
    column = pl.Series(flat, dtype=pl.Array(pl.Float64, n * n))
    return pl.DataFrame({"t_ns": result.covariance.t_ns, "covariance": column})


def _run_document(result: Result) -> dict[str, Any]:
    return {
        "format": FORMAT,
        **_plain(result.metadata),
        "counts": _plain(result.counts),
        "events": result.event_counts(),
        "state": [{"name": s.name, "unit": s.unit, "block": s.block, "kind": s.kind} for s in result.states],
    }


def _plain(value: Any) -> Any:
    """Mappings, sequences and NumPy scalars as plain Python; entries that are None disappear (TOML has no null)."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items() if v is not None}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        return value.item()
    return str(value) if isinstance(value, Path) else value


def load(folder: str | Path) -> Result:
    """Read the folder that :func:`save` wrote; see :meth:`gnssins.Result.open` for the errors."""
    from gnssins.result import Covariance, Result

    source = Path(folder)
    document = _read_run(source)
    states = tuple(State(s["name"], s["unit"], s["block"], s["kind"]) for s in document.pop("state"))
    counts, n = document.pop("counts"), len(states)
    for key in ("format", "events"):
        document.pop(key)
    navigation = _read(source / "navigation.parquet", pl.read_parquet)
    columns = [*tables.NAVIGATION_COLUMNS, *tables.SD_COLUMNS]
    names = [tables.column_of(s) for s in states[9:]]
    table = _columns(source, navigation, columns + names + [f"sd_{name}" for name in names])
    factors = np.array([tables.table_unit(s.unit).factor for s in states[9:]])
    rpy = np.radians(table[:, 7:10])
    rpy[:, 2] = tables.wrap_pi(rpy[:, 2])
    covariance = _read(source / "covariance.parquet", pl.read_parquet)
    return Result(
        t_ns=times_to_ns(table[:, 0]),
        lla=np.column_stack([np.radians(table[:, 1:3]), table[:, 3]]),
        v_n=table[:, 4:7].copy(),
        rpy=rpy,
        q_nb=_quaternions(rpy),
        sd=np.column_stack([table[:, 10:16], np.radians(table[:, 16:19])]),
        x=table[:, 19 : 19 + len(names)] / factors,
        x_sd=table[:, 19 + len(names) :] / factors,
        states=states,
        covariance=Covariance(
            covariance["t_ns"].to_numpy(), covariance["covariance"].to_numpy().reshape(-1, n, n).copy()
        ),
        records=_load_records(source),
        log=_load_events(source),
        counts=counts,
        metadata=document,
        final_state=_read(source / "state.bin", Path.read_bytes),
        aids=_load_aids(source),
    )


def _read_run(source: Path) -> dict[str, Any]:
    path = source / RUN_FILE
    if not path.is_file():
        raise MissingFileError(
            "input.no_result",
            f"{source} holds no complete result: {RUN_FILE} is missing",
            "name a folder that `gnssins run --out` or Result.save() wrote; run again if it was interrupted",
            {"file": str(path)},
        )
    document = tomlkit.parse(path.read_text(encoding="utf-8")).unwrap()
    if document.get("format") != FORMAT:
        raise InputError(
            "input.result_format",
            f"{path}: format = {document.get('format')}, this version reads {FORMAT}",
            "run again with this version",
            {"file": str(path)},
        )
    return dict(document)


def _read(path: Path, reader: Callable[[Path], T]) -> T:
    try:
        return reader(path)
    except (OSError, pl.exceptions.PolarsError) as error:
        raise InputError(
            "input.result_file",
            f"{path}: cannot be read ({error})",
            "the folder is damaged: run again",
            {"file": str(path)},
        ) from error


def _columns(source: Path, table: pl.DataFrame, names: list[str]) -> NDArray[np.float64]:
    missing = [name for name in names if name not in table.columns]
    if missing:
        raise InputError(
            "input.result_file",
            f"{source}: navigation.parquet lacks {', '.join(missing)}",
            "the folder mixes two runs: run again into a new one",
            {"file": str(source), "columns": missing},
        )
    return np.ascontiguousarray(table.select(names).to_numpy())


def _quaternions(rpy: NDArray[np.float64]) -> NDArray[np.float64]:
    from gnssins import _core

    return _core.euler_to_quat(rpy)


def _load_records(source: Path) -> Records:
    from gnssins.result import STATUS, Records

    table = _read(source / "measurements.parquet", pl.read_parquet)
    fix = table.select(tables.NAVIGATION_COLUMNS[1:7]).to_numpy()
    return Records(
        row=table["row"].to_numpy(),
        t_ns=times_to_ns(table["time_s"].to_numpy()),
        status=np.array([STATUS.index(name) for name in table["status"]], dtype=np.uint8),
        dof=table["dof"].to_numpy(),
        nis=table["nis"].to_numpy(),
        innovation=np.ascontiguousarray(table.select(tables.INNOVATION_COLUMNS).to_numpy()),
        innovation_cov=table["innovation_cov"].to_numpy().reshape(-1, 6, 6).copy(),
        reason=tuple(table["reason"]),
        lla=np.column_stack([np.radians(fix[:, :2]), fix[:, 2]]),
        v_n=fix[:, 3:].copy(),
        refused=_refused(table),
    )


def _refused(table: pl.DataFrame) -> NDArray[np.uint8]:
    """Dropped components; none in results that were written before there were any."""
    if "refused" in table.columns:
        return table["refused"].to_numpy()
    return np.zeros(table.height, dtype=np.uint8)


def _load_aids(source: Path) -> dict[str, AidRecords]:
    from gnssins.result import STATUS, AidRecords

    if not (source / "aids.parquet").is_file():  # written before there were other aids
        return {}
    aids = {}
    whole = _read(source / "aids.parquet", pl.read_parquet)
    for (name,), table in whole.group_by("source", maintain_order=True):
        factor, _ = tables.AID_UNITS[str(name)]
        aids[str(name)] = AidRecords(
            row=table["row"].to_numpy(),
            t_ns=times_to_ns(table["time_s"].to_numpy()),
            status=np.array([STATUS.index(status) for status in table["status"]], dtype=np.uint8),
            nis=table["nis"].to_numpy(),
            innovation=table["innovation"].to_numpy() / factor,
            variance=(table["sd_innovation"].to_numpy() / factor) ** 2,
            reason=tuple(table["reason"]),
        )
    return aids


def _load_events(source: Path) -> tuple[Event, ...]:
    from gnssins.result import Event

    table = _read(source / "events.csv", lambda path: pl.read_csv(path, schema_overrides=tables.EVENT_SCHEMA))
    if "value" not in table.columns:  # written before events had numbers
        table = table.with_columns(value=pl.lit(None, pl.Float64))
    times = times_to_ns(table["time_s"].to_numpy())
    rows = zip(times, *(table[name] for name in ("code", "row", "message", "value")), strict=True)
    return tuple(Event(int(t), code, row, message, value) for t, code, row, message, value in rows)
