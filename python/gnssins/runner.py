"""One run: configuration and data in, one call into the compiled core, a :class:`~gnssins.result.Result` out."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.alignment import InitialState, initial_state
from gnssins.checks import Finding, check_dataset, raise_on_stop
from gnssins.config import Config
from gnssins.dataset import Dataset, GnssTable, ImuTable
from gnssins.errors import ConfigError, GnssinsError, InputError
from gnssins.io import read_dataset
from gnssins.result import WITHHELD, Covariance, Event, Records, Result, finite
from gnssins.tables import State
from gnssins.units import NS_PER_S

if TYPE_CHECKING:
    from gnssins.sim import Simulated

__all__ = ["as_config", "as_initial", "run"]

if _core.is_debug_build():
    warnings.warn("gnssins runs on a debug build, 20 to 50 times slower", RuntimeWarning, stacklevel=2)

Rows = NDArray[np.intp]
Progress = Callable[[float], None]


class _ToEngine(Protocol):
    def to_engine(self) -> Mapping[str, Any]: ...


#: An initial state: an object that gives the section ``initial`` of an engine configuration, or that section.
Start = _ToEngine | Mapping[str, Any]


def run(
    config: Config | Mapping[str, Any] | str | os.PathLike[str],
    dataset: Dataset | Simulated | None = None,
    *,
    progress: Progress | None = None,
    initial: Start | None = None,
    told: Callable[[list[Finding]], object] | None = None,
) -> Result:
    """Process one recording.

    Parameters
    ----------
    config : Config, mapping or path
        The configuration, its tables, or its TOML file.
    dataset : Dataset or Simulated, optional
        Data to process; left out: the files that the configuration names. A simulation brings its own initial
        state.
    progress : callable, optional
        Called now and then with the share that is done, 0 to 1.
    initial : InitialState, mapping or simulated initial state, optional
        State to start from, also in the form of the engine configuration; left out: found from the data as
        ``[initial]`` says (:mod:`gnssins.alignment`).
    told : callable, optional
        Called with the findings of the look at the data (:func:`gnssins.checks.check_dataset`) before the filter
        starts; without it, an error that follows repeats them in its hint. They are in the context of the error
        (``"findings"``) and in ``metadata["finding"]`` of the result in any case.

    Returns
    -------
    Result
        Estimates at every IMU row or at ``[run] output_rate_hz``, one record per GNSS row between start and end,
        events and counts. Rows of GNSS inside ``[run] outages`` appear with the status ``"withheld"``.

    Raises
    ------
    ConfigError, InputError, MissingFileError
        Configuration or files cannot be used.
    TimeOrderError, GapError, DataQualityError, CovarianceError, NavigationError
        What the engine refuses, with row and time.
    """
    clock = time.perf_counter()
    config_file = os.fspath(config) if isinstance(config, str | os.PathLike) else None
    config = as_config(config)
    findings: list[Finding] = []
    if dataset is not None and not isinstance(dataset, Dataset):
        initial = dataset.initial if initial is None else initial
        dataset = dataset.dataset
    else:
        dataset = read_dataset(config) if dataset is None else dataset
        findings = check_dataset(dataset, config)
        if told is not None:
            told(findings)
    try:
        raise_on_stop(findings)
        start = as_initial(initial) if initial is not None else initial_state(config, dataset)
        engine = config.engine_config(start.to_engine())
        engine["imu"]["input"] = dataset.imu.kind
        cut = _cut(config, dataset, engine["gnss"]["latency_ns"])
        _refuse_outside(config, start.t_ns, int(cut.imu.t_ns[-1]))
        prepared = time.perf_counter()
        columns = _call(engine, config, cut, progress)
    except GnssinsError as error:
        _attach(error, findings, repeat=told is None)
        raise
    times = {"prepare_s": prepared - clock, "filter_s": time.perf_counter() - prepared}
    metadata = _metadata(config, dataset, engine, findings, times)
    if config_file is not None:
        metadata["run"]["config_file"] = str(Path(config_file).resolve())
    return _result(columns, dataset, cut, metadata)


def _attach(error: GnssinsError, findings: list[Finding], *, repeat: bool) -> None:
    """Give an error what the look at the data had found before."""
    if not findings:
        return
    error.context["findings"] = _listed(findings)
    suspects = [f.message for f in findings if f.level != "info" and f.message not in error.message]
    if repeat and suspects:
        said = f"the look at the data before said: {'; '.join(suspects)}"
        error.hint = f"{error.hint}; {said}" if error.hint else said


def _listed(findings: list[Finding]) -> list[dict[str, str]]:
    """Findings as plain tables."""
    return [{"level": f.level, "code": f.code, "message": f.message, "hint": f.hint} for f in findings]


def as_config(config: Config | Mapping[str, Any] | str | os.PathLike[str]) -> Config:
    """Take a configuration as it is, from its tables, or from its TOML file."""
    if isinstance(config, Config):
        return config
    if isinstance(config, Mapping):
        return Config.from_dict(config)
    return Config.load(config)


def as_initial(initial: Start) -> InitialState:
    """Take an initial state as it is, or from the section ``initial`` of an engine configuration."""
    if isinstance(initial, InitialState):
        return initial
    section = initial if isinstance(initial, Mapping) else getattr(initial, "to_engine", dict)()
    try:
        return InitialState.from_engine(section)
    except (KeyError, TypeError, ValueError) as failure:
        what = f"lacks {failure}" if section and isinstance(failure, KeyError) else "is not one"
        raise InputError(
            "input.initial",
            f"the initial state {what}: got {type(initial).__name__}",
            "give gnssins.InitialState, gnssins.initial_state(config, dataset), Simulated.initial, or a mapping with "
            "t_ns, lat_rad, lon_rad, height_m, v_n, q_nb, sd_phi, sd_v, sd_p",
        ) from None


# ---- what goes in


@dataclass(frozen=True, eq=False)
class _Cut:
    """Rows of the tables that take part, and the times of validity of all GNSS rows."""

    imu: ImuTable
    gnss: GnssTable
    imu_first: int
    fed: Rows
    withheld: Rows
    valid_ns: NDArray[np.int64]


def _cut(config: Config, dataset: Dataset, latency_ns: int) -> _Cut:
    """Leave out what lies outside ``start_s`` .. ``end_s`` and hold back the fixes inside the outages.

    Rows between ``start_s`` and the initial state stay in: the engine counts them as late.
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
    valid = gnss.t_ns - latency_ns
    takes_part = (valid >= begin_ns) & (valid <= end_ns)
    held = np.zeros(len(gnss), dtype=np.bool_)
    for from_s, to_s in config.run.outages:
        held |= (valid >= round(from_s * NS_PER_S)) & (valid < round(to_s * NS_PER_S))
    fed = np.flatnonzero(takes_part & ~held)
    return _Cut(
        imu=imu.select(slice(first, last)),
        gnss=gnss.select(fed),
        imu_first=first,
        fed=fed,
        withheld=np.flatnonzero(takes_part & held),
        valid_ns=valid,
    )


def _refuse_outside(config: Config, start_ns: int, end_ns: int) -> None:
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


def _call(engine: dict[str, Any], config: Config, cut: _Cut, progress: Progress | None) -> dict[str, Any]:
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
    )
    return cast("dict[str, Any]", columns)


# ---- what comes out


def _result(columns: dict[str, Any], dataset: Dataset, cut: _Cut, metadata: dict[str, Any]) -> Result:
    counts = {table: dict(values) for table, values in columns["counts"].items()}
    counts["gnss"]["withheld"] = int(cut.withheld.size)
    return Result(
        t_ns=columns["t_ns"],
        lla=columns["lla"],
        v_n=columns["v_n"],
        rpy=columns["rpy"],
        q_nb=columns["q_nb"],
        sd=columns["sd"],
        x=columns["x"],
        x_sd=columns["x_sd"],
        states=tuple(State(s["name"], s["unit"], s["block"], s["kind"]) for s in columns["states"]),
        covariance=Covariance(columns["cov_t_ns"], columns["cov"]),
        records=_records(columns["meas"], dataset.gnss, cut),
        log=_events(columns["events"], columns["meas"], cut),
        counts=counts,
        metadata=metadata,
        final_state=columns["final_state"],
    )


def _records(meas: Mapping[str, Any], gnss: GnssTable, cut: _Cut) -> Records:
    """Records of the engine and of the withheld rows together, in the order of the GNSS table."""
    fed = cut.fed[meas["row"]]
    row = np.concatenate([fed, cut.withheld])
    order = np.argsort(row, kind="stable")
    held = cut.withheld.size

    def joined(values: NDArray[Any], filler: float) -> NDArray[Any]:
        tail = np.full((held, *values.shape[1:]), filler, dtype=values.dtype)
        return np.concatenate([values, tail])[order]

    reason = [*meas["reason"], *["withheld by [run] outages"] * held]
    row = row[order]
    return Records(
        row=row.astype(np.int64),
        t_ns=cut.valid_ns[row],
        status=joined(meas["status"], WITHHELD),
        dof=joined(meas["dof"], 0),
        nis=joined(meas["nis"], np.nan),
        innovation=joined(meas["innovation"], np.nan),
        innovation_cov=joined(meas["innovation_cov"], np.nan),
        reason=tuple(reason[i] for i in order),
        lla=gnss.lla[row],
        v_n=gnss.v_n[row],
    )


def _events(events: list[dict[str, Any]], meas: Mapping[str, Any], cut: _Cut) -> tuple[Event, ...]:
    """Events with the rows of the tables as they were handed in, bad fixes with the reason of their record."""
    reasons = {int(row): reason for row, reason in zip(meas["row"], meas["reason"], strict=True)}
    out = []
    for event in events:
        row, message = int(event["row"]), event["message"]
        if event["code"] == "gnss.bad" and reasons.get(row):
            message = f"{message}: {reasons[row]}"
        if event["code"].startswith("imu."):
            row += cut.imu_first
        elif event["code"].startswith(("gnss.", "filter.")):
            row = int(cut.fed[row])
        out.append(Event(int(event["t_ns"]), event["code"], row, message, finite(event["value"])))
    return tuple(out)


def _metadata(
    config: Config,
    dataset: Dataset,
    engine: dict[str, Any],
    findings: list[Finding],
    times: dict[str, float],
) -> dict[str, Any]:
    """What ``run.toml`` keeps beside counts and states."""
    windows = [[round(t * NS_PER_S) for t in pair] for pair in config.run.outages]
    about: dict[str, Any] = {"created": datetime.now(UTC).isoformat(timespec="seconds")}
    about |= {key: dataset.meta[key] for key in ("scenario", "variant", "seed") if key in dataset.meta}
    about |= {key: round(value, 4) for key, value in times.items()}
    return {
        "run": about,
        "versions": versions(),
        "ellipsoid": engine["ellipsoid"],
        "lever_ba_b_m": engine["gnss"]["lever_b_m"],
        "outages_ns": windows,
        "input": _inputs(dataset),
        "finding": _listed(findings),
        "config": config.to_dict(),
        "engine": {"json": json.dumps(engine)},
    }


def versions() -> dict[str, str]:
    """Versions of gnssins and of what it computes with."""
    import polars

    return {
        "gnssins": _core.version(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "polars": polars.__version__,
        "platform": platform.platform(),
    }


def _inputs(dataset: Dataset) -> list[dict[str, Any]]:
    """Files with their digests and rows; digests of the arrays for data that came from no file."""
    if dataset.sources:
        return [
            {
                "file": str(Path(source.path)),
                "sha256": source.sha256,
                "rows": source.rows,
                "skipped": dict(source.skipped),
            }
            for source in dataset.sources.values()
        ]
    imu, gnss = dataset.imu, dataset.gnss
    tables = {"imu": (imu.t_ns, imu.gyro, imu.accel), "gnss": (gnss.t_ns, gnss.lla, gnss.v_n, gnss.var)}
    return [
        {"table": name, "sha256": _digest(arrays), "rows": len(arrays[0])} for name, arrays in tables.items()
    ]


def _digest(arrays: tuple[NDArray[Any], ...]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
