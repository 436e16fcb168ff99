"""One run: configuration and data in, one call into the compiled core, a :class:`~gnssins.result.Result` out."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.alignment import InitialState, initial_state
from gnssins.checks import Finding, check_dataset, raise_on_stop
from gnssins.collect import collect
from gnssins.config import Config
from gnssins.dataset import Dataset, Source
from gnssins.errors import GnssinsError, InputError
from gnssins.feed import Progress, call_core, cut_tables, refuse_outside
from gnssins.io import read_dataset
from gnssins.result import Result
from gnssins.units import NS_PER_S

if TYPE_CHECKING:
    from gnssins.sim import Simulated

__all__ = ["as_config", "as_initial", "run"]

if _core.is_debug_build():
    warnings.warn("gnssins runs on a debug build, 20 to 50 times slower", RuntimeWarning, stacklevel=2)


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
        engine = engine_of(config, start, dataset.imu.kind)
        cut = cut_tables(config, dataset, engine)
        refuse_outside(config, start.t_ns, int(cut.imu.t_ns[-1]))
        prepared = time.perf_counter()
        with ThreadPoolExecutor(max_workers=1) as beside:  # neither digests nor the core need the GIL
            inputs = beside.submit(_inputs, dataset)
            columns = call_core(engine, config, cut, progress)
    except GnssinsError as error:
        attach(error, findings, repeat=told is None)
        raise
    times = {"prepare_s": prepared - clock, "filter_s": time.perf_counter() - prepared}
    about = about_run(config_file, times)
    about |= {key: dataset.meta[key] for key in ("scenario", "variant", "seed") if key in dataset.meta}
    metadata = run_metadata(config, about, inputs.result(), engine, findings)
    return collect(columns, dataset, cut, metadata)


def attach(error: GnssinsError, findings: list[Finding], *, repeat: bool) -> None:
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


def engine_of(config: Config, start: InitialState, kind: str) -> dict[str, Any]:
    """Configuration of the engine for a start and IMU rows of a kind."""
    engine = config.engine_config(start.to_engine())
    engine["imu"]["input"] = kind
    return engine


def about_run(config_file: str | None, times: Mapping[str, float]) -> dict[str, Any]:
    """When, how long (s), and by which file a run was made."""
    about: dict[str, Any] = {"created": datetime.now(UTC).isoformat(timespec="seconds")}
    if config_file is not None:
        about["config_file"] = str(Path(config_file).resolve())
    return about | {key: round(value, 4) for key, value in times.items()}


def run_metadata(
    config: Config,
    about: Mapping[str, Any],
    inputs: list[dict[str, Any]],
    engine: dict[str, Any],
    findings: list[Finding],
) -> dict[str, Any]:
    """What ``run.toml`` keeps beside counts and states."""
    windows = [[round(t * NS_PER_S) for t in pair] for pair in config.run.outages]
    return {
        "run": dict(about),
        "versions": versions(),
        "ellipsoid": engine["ellipsoid"],
        "model": engine["model"],
        "lever_ba_b_m": engine["gnss"]["lever_b_m"],
        "outages_ns": windows,
        "input": inputs,
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
        return listed_files(dataset.sources.values())
    imu, gnss, baro, heading = dataset.imu, dataset.gnss, dataset.baro, dataset.heading
    tables = {"imu": (imu.t_ns, imu.gyro, imu.accel), "gnss": (gnss.t_ns, gnss.lla, gnss.v_n, gnss.var)}
    if len(baro):
        tables["baro"] = (baro.t_ns, baro.height_m, baro.var)
    if len(heading):
        tables["heading"] = (heading.t_ns, heading.heading_rad, heading.var)
    return [
        {"table": name, "sha256": _digest(arrays), "rows": len(arrays[0])} for name, arrays in tables.items()
    ]


def listed_files(sources: Iterable[Source]) -> list[dict[str, Any]]:
    """Files with their digests and rows."""
    return [
        {
            "file": str(Path(source.path)),
            "sha256": source.sha256,
            "rows": source.rows,
            "skipped": dict(source.skipped),
        }
        for source in sources
    ]


def _digest(arrays: tuple[NDArray[Any], ...]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
