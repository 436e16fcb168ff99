"""``gnssins outages``: how fast the errors of a configured filter grow when GNSS is lost, on any recording."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from gnssins.alignment import initial_state
from gnssins.analysis import OutageGrowth, outage_growth, place_windows
from gnssins.checks import check_dataset, raise_on_stop
from gnssins.commands.filtering import start_line
from gnssins.config import Config
from gnssins.dataset import Dataset
from gnssins.errors import ConfigError, InputError
from gnssins.io import read_dataset
from gnssins.result import Result
from gnssins.runner import Start
from gnssins.runner import run as run_filter
from gnssins.terminal import heading, message, progress, put, put_json
from gnssins.units import NS_PER_S, ms_to_ns

__all__ = ["REFERENCES", "growth_of", "outages"]

#: What the errors may be counted against.
REFERENCES: Final = ("auto", "truth", "fixes", "run")

_NAMES: Final = {
    "truth": "the truth",
    "fixes": "the withheld fixes",
    "run": "the same filter with all fixes",
}

#: Most columns of the table if ``--at`` does not say.
_COLUMNS: Final = 6


@dataclass(frozen=True)
class Windows:
    """Which windows are asked for; s."""

    length_s: float
    count: int
    first_s: float | None = None
    period_s: float | None = None
    settle_s: float = 60.0


@dataclass(frozen=True, eq=False)
class _Job:
    """A recording with what the filter starts from."""

    config: Config
    data: Dataset
    start: Start
    start_s: float
    end_s: float
    interval_s: float


def outages(source: str, windows: Windows, at: str | None, reference: str, seed: int, as_json: bool) -> None:
    """``gnssins outages``."""
    if reference not in REFERENCES:
        raise ConfigError(
            "config.choice", f'--reference "{reference}" is unknown', f"one of: {', '.join(REFERENCES)}"
        )
    times = _times(at, windows.length_s)
    job = _prepare(source, seed, quiet=as_json)
    kind = _kind(reference, job.data)
    placed = _place(job, windows)
    growth, result = growth_of(job.config, job.data, placed, times, kind, job.start)
    if as_json:
        put_json(
            {
                "config": source,
                "windows_s": [list(w) for w in placed],
                "filter_start_s": job.start_s,
                "data_end_s": job.end_s,
                "counts": result.counts,
                **growth.to_dict(),
            }
        )
        return
    put(start_line(result, job.config))
    if job.config.run.outages:
        put(f"the {len(job.config.run.outages)} windows of [run] outages are not withheld here")
    after = placed[0][0] - job.start_s
    every = f", then every {placed[1][0] - placed[0][0]:.1f} s" if len(placed) > 1 else ""
    put(f"{len(placed)} windows of {windows.length_s:g} s, the first {after:.1f} s after the start{every}:")
    put("  " + ", ".join(f"{start:.1f} to {end:.1f}" for start, end in placed))
    heading(f"Growth of the errors, mean of {growth.gaps} gaps, against {growth.reference}")
    put(growth.table(" ").lstrip())
    if kind == "fixes":
        put("\nThe noise of the fixes counts as error; fixes tell no attitude (--reference run does).")
    elif kind == "run":
        put("\nWhat the two runs have in common, such as an error of the heading, does not show.")


def growth_of(
    config: Config,
    data: Dataset,
    windows: Sequence[tuple[float, float]],
    at_s: Sequence[float],
    reference: str,
    start: Start | None = None,
) -> tuple[OutageGrowth, Result]:
    """Run a filter with the fixes of some windows withheld, and count how its errors grow.

    Parameters
    ----------
    config : Config
        Its own ``[run] outages`` are replaced.
    data : Dataset
        What to process.
    windows : sequence of (from, to)
        Seconds; the fix at the end of a window is withheld too.
    at_s : sequence of float
        Times since the start of a window, s.
    reference : {"truth", "fixes", "run"}
        What the errors are counted against.
    start : InitialState or the like, optional
        Left out: found as ``[initial]`` says.

    Returns
    -------
    OutageGrowth
    Result
        The run with the gaps.
    """
    edge = 0.5 * data.gnss.interval_s if len(data.gnss) > 1 else 0.0
    withheld = [[first, last + edge] for first, last in windows]
    with progress("filter") as bar:
        result = run_filter(config.replace(run={"outages": withheld}), data, initial=start, progress=bar)
    truth: Any = None
    if reference == "truth":
        truth = data.truth
    elif reference == "run":
        with progress("filter with all fixes") as bar:
            truth = run_filter(config.replace(run={"outages": []}), data, initial=start, progress=bar)
    growth = outage_growth(result, truth, at_s=at_s, reference=_NAMES[reference])
    return growth, result


def _prepare(source: str, seed: int, *, quiet: bool) -> _Job:
    """Read what is to be filtered: the log of a configuration, or a packaged scenario."""
    from gnssins.sim import scenario_names, simulate
    from gnssins.simfiles import scenario_config

    if not Path(source).exists() and source in scenario_names():
        simulated = simulate(source, seed, outages=())
        config = Config.from_dict(scenario_config(simulated))
        data, start = simulated.dataset, simulated.initial
    else:
        config = Config.load(Path(source))
        data = read_dataset(config)
        findings = check_dataset(data, config)
        for finding in [] if quiet else findings:
            text = f"{finding.level}: {finding.message}"
            message(f"{text}\n  hint: {finding.hint}" if finding.hint else text, "yellow")
        raise_on_stop(findings)
        _refuse_no_gnss(data)
        start = initial_state(config, data)
    _refuse_no_gnss(data)
    valid = data.gnss.t_ns - ms_to_ns(config.gnss.latency_ms)
    end_ns = min(int(data.imu.t_ns[-1]), int(valid.max()))
    if config.run.end_s is not None:
        end_ns = min(end_ns, round(config.run.end_s * NS_PER_S))
    interval = float(np.median(np.diff(np.sort(valid)))) / NS_PER_S if valid.size > 1 else 0.0
    return _Job(config, data, start, start.t_ns / NS_PER_S, end_ns / NS_PER_S, interval)


def _refuse_no_gnss(data: Dataset) -> None:
    if not len(data.gnss):
        raise InputError(
            "input.no_gnss",
            "the recording has no fixes: there is nothing to withhold",
            "name the GNSS log in [gnss] file",
        )


def _place(job: _Job, windows: Windows) -> tuple[tuple[float, float], ...]:
    return place_windows(
        job.start_s,
        job.end_s,
        length_s=windows.length_s,
        count=windows.count,
        settle_s=windows.settle_s,
        first_s=windows.first_s,
        period_s=windows.period_s,
    )


def _kind(reference: str, data: Dataset) -> str:
    """What to compare with: the truth if there is one, else the withheld fixes."""
    has_truth = data.truth is not None and len(data.truth) > 0
    if reference == "truth" and not has_truth:
        raise InputError(
            "input.no_reference",
            "the configuration names no reference",
            "add [truth] file, or --reference fixes",
        )
    if reference == "auto":
        return "truth" if has_truth else "fixes"
    return reference


def _times(at: str | None, length_s: float) -> list[float]:
    """Times of the table, s."""
    if at is None:
        return _even(length_s)
    try:
        times = [float(word) for word in at.replace(" ", "").split(",") if word]
    except ValueError:
        times = []
    rising = all(a < b for a, b in pairwise(times))
    if not times or not rising or times[0] <= 0.0 or times[-1] > length_s * (1.0 + 1e-9):
        raise ConfigError(
            "config.times",
            f'--at "{at}": needs rising times in s, above 0 and not beyond the length of {length_s:g} s',
            "such as --at 10,20,30",
        )
    return times


def _even(length_s: float) -> list[float]:
    """Multiples of a round number of seconds, and the length itself."""
    if not length_s > 0.0:
        return []  # refused when the windows are placed
    scale = 10.0 ** math.floor(math.log10(length_s / _COLUMNS))
    step = next(scale * n for n in (1.0, 2.0, 5.0, 10.0) if scale * n * _COLUMNS >= length_s * (1.0 - 1e-9))
    times = [step * (i + 1) for i in range(_COLUMNS) if step * (i + 1) < length_s * (1.0 - 1e-9)]
    return [*times, length_s]
