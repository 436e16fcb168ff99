"""Monte Carlo: many runs of one scenario, simulated, filtered and compared inside the compiled core.

>>> import gnssins
>>> found = gnssins.monte_carlo("static", runs=8, seed=1)
>>> found.complete
True

The truth is made once and shared. Every run draws its sensor errors from counters, so that run k is the same on any
number of threads and in any order; what stays are sums, taken in the order of the runs.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from functools import partial
from numbers import Integral
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from gnssins import _core
from gnssins.alignment import InitialState
from gnssins.config import Config
from gnssins.dataset import BaroTable, Dataset, GnssTable, HeadingTable, ImuTable
from gnssins.errors import ConfigError
from gnssins.montecarlo.plan import Job, Prepared, nominal_dataset, nominal_start, prepare, truth_columns
from gnssins.montecarlo.result import MonteCarlo, Sums
from gnssins.montecarlo.store import Store
from gnssins.outputs import refuse_no_file
from gnssins.parallel import submitted
from gnssins.runner import as_config
from gnssins.sim import Scenario, Simulated, Simulator
from gnssins.sim.aiding import fix_times, in_sight
from gnssins.simfiles import scenario_config

__all__ = ["MonteCarlo", "monte_carlo", "simulated_run"]

#: Ranges of runs handed to an executor and not yet taken back.
AHEAD: Final = 256
#: Most runs of a set: the counters of the deviates have so many.
MOST_RUNS: Final = 2**32 - 1

Source = str | os.PathLike[str] | Scenario | Simulator


def monte_carlo(
    scenario: Source,
    config: Config | Mapping[str, Any] | str | os.PathLike[str] | None = None,
    runs: int = 100,
    *,
    seed: int = 0,
    jobs: int | None = None,
    executor: Executor | None = None,
    covariance: Literal["full", "shared"] = "full",
    after_s: float = 0.0,
    progress: Callable[[float], None] | None = None,
    store: str | os.PathLike[str] | None = None,
) -> MonteCarlo:
    """Simulate, filter and compare ``runs`` times.

    Parameters
    ----------
    scenario : str, path, Scenario or Simulator
        Packaged name, TOML file, model, or a simulator, such as ``gnssins.Simulator("car-loop", variant="open-sky")``.
    config : Config, mapping or path, optional
        The filter; left out: the one that models the errors of the scenario. What it says of files, of the kind of IMU
        rows and of the initial state has no meaning here: these come from the scenario. Errors are compared
        ``[run] output_rate_hz`` times per second (left out: once), the covariance every
        ``[run] covariance_interval_s`` (left out: 10 s). Gaps come from ``[run] outages`` or from the scenario.
    runs : int
        Number of runs.
    seed : int
        Seed of the set; :func:`simulated_run` gives a run by itself.
    jobs : int, optional
        Threads; left out: one per core.
    executor : concurrent.futures.Executor, optional
        Runs ranges of the runs instead, on processes or machines: one of the standard library, that of a dask client,
        an MPI pool.
    covariance : {"full", "shared"}
        ``"shared"``: covariance and gains are made once along the trajectory without errors, and all runs use them.
        Gates are off, and it holds only where the errors stay small: see the how-to.
    after_s : float
        Start of the steady state for root mean squares and NIS.
    progress : callable, optional
        Called with the share that is done.
    store : path, optional
        File that keeps the finished runs: a sweep that was broken off, or a longer one, goes on from there.

    Returns
    -------
    MonteCarlo
        The same bits for any number of jobs. Ctrl-C gives what is finished, with ``complete`` false.

    Raises
    ------
    ConfigError
        A scenario or configuration that cannot be used; ``config.range``: a figure out of its range;
        ``config.store``: the store belongs to another sweep.
    GnssinsError
        The error of the first run that fails, with ``context["run"]``.
    """
    _refuse(runs=runs, seed=seed, jobs=jobs, covariance=covariance)
    simulator = scenario if isinstance(scenario, Simulator) else Simulator(scenario)
    config = _matching(simulator) if config is None else as_config(config)
    job = Job.of(simulator, config, seed, covariance, after_s)
    if store is not None:
        refuse_no_file(Path(store))
    keep = Store(Path(store), job) if store is not None else None
    sums = keep.load() if keep is not None else Sums()
    prepared = prepare(simulator, config, job)
    before, clock = sums.runs, time.perf_counter()
    if before > runs:
        raise ConfigError(
            "config.store",
            f"{store} holds {before} runs, more than the {runs} asked for",
            "ask for at least as many, or name another file",
        )

    def take(_first: int, chunk: Mapping[str, Any]) -> None:
        whole = len(chunk["runs"]) == _core.MonteCarlo.CHUNK
        if keep is not None and not whole:
            keep.save(sums, now=True)
        sums.add(chunk)
        if keep is not None and whole:
            keep.save(sums, now=sums.runs == runs)
        if progress is not None:
            progress(sums.runs / runs)

    try:
        _run(job, prepared, sums.runs, runs, jobs, executor, take)
    except KeyboardInterrupt:
        if not sums.runs:
            raise
    finally:
        if keep is not None and sums.runs % _core.MonteCarlo.CHUNK == 0:
            keep.save(sums, now=True)
    return sums.result(job, prepared, runs, time.perf_counter() - clock, sums.runs - before)


def simulated_run(scenario: Source, seed: int = 0, run: int = 0) -> Simulated:
    """One run of a set as :func:`gnssins.simulate` gives it: the very numbers that :func:`monte_carlo` filters.

    Parameters
    ----------
    scenario : str, path, Scenario or Simulator
        As in :func:`monte_carlo`.
    seed : int
        Seed of the set.
    run : int
        Number of the run, from 0.

    Returns
    -------
    Simulated
        ``gnssins.run(config, simulated)`` gives the errors that the set counts for this run.
    """
    _refuse(runs=1, seed=seed)
    if not 0 <= run < MOST_RUNS:
        text = f"run = {run}: must lie between 0 and {MOST_RUNS - 1}"
        raise ConfigError("config.range", text, "runs count from 0", {"run": run})
    simulator = scenario if isinstance(scenario, Simulator) else Simulator(scenario)
    path, source = simulator.trajectory, simulator.scenario
    config = _matching(simulator)
    made = prepare(simulator, config, Job.of(simulator, config, seed, "full", 0.0)).core.simulated(run)
    stamps = nominal_dataset(simulator)
    gnss, baro, heading = GnssTable.empty(), BaroTable.empty(), HeadingTable.empty()
    if source.gnss is not None:
        seen, table = in_sight(fix_times(path, source.gnss), simulator.outages), stamps.gnss
        values = made["gnss_lla"][seen], made["gnss_v_n"][seen]
        gnss = GnssTable(table.t_ns, *values, table.var, table.new_constellation)
    if source.baro is not None:
        baro = BaroTable(stamps.baro.t_ns, made["baro_height"], stamps.baro.var)
    if source.heading is not None:
        seen = in_sight(fix_times(path, source.heading), simulator.outages)
        heading = HeadingTable(stamps.heading.t_ns, made["heading_rad"][seen], stamps.heading.var)
    imu = ImuTable(path.t_ns[1:], made["gyro"], made["accel"], "increments")
    meta = {"scenario": source.name, "variant": simulator.variant, "seed": seed, "run": run}
    start = nominal_start(simulator)
    lla, v_n, q_nb = (np.array(made[key]) for key in ("lla", "v_n", "q_nb"))
    histories = made["true_errors"][:: simulator.truth_step]
    return Simulated(
        dataset=Dataset(imu, gnss, simulator.truth, meta=meta, baro=baro, heading=heading),
        initial=InitialState(start.t_ns, lla, v_n, q_nb, start.sd_phi, start.sd_v, start.sd_p),
        initial_error=np.array(made["initial_error"]),
        truth_blocks={name: histories[:, list(at)] for name, at in truth_columns(source).items()},
        scenario=source,
        seed=seed,
        outages=simulator.outages,
    )


def _matching(simulator: Simulator) -> Config:
    """Configuration of the filter that models the errors of a scenario."""
    nominal = Simulated(
        dataset=nominal_dataset(simulator),
        initial=nominal_start(simulator),
        initial_error=np.zeros(9),
        truth_blocks={},
        scenario=simulator.scenario,
        seed=0,
        outages=simulator.outages,
    )
    return Config.from_dict(scenario_config(nominal))


def _run(
    job: Job,
    prepared: Prepared,
    first: int,
    runs: int,
    jobs: int | None,
    executor: Executor | None,
    take: Callable[[int, Mapping[str, Any]], None],
) -> None:
    """Hand the sums of all chunks to ``take`` in the order of the runs."""
    if executor is None:
        prepared.core.run(first, runs, jobs or os.cpu_count() or 1, take)
        return
    count = -(-(runs - first) // _core.MonteCarlo.CHUNK)
    for number, chunk in submitted(executor, partial(_chunk, job, first, runs), count, AHEAD):
        take(number, chunk)


def _chunk(job: Job, first: int, runs: int, index: int) -> tuple[int, dict[str, Any]]:
    """One chunk on a worker, which keeps what it has prepared."""
    begin = first + index * _core.MonteCarlo.CHUNK
    out: list[tuple[int, dict[str, Any]]] = []
    last = min(runs, begin + _core.MonteCarlo.CHUNK)
    job.prepared().core.run(begin, last, 1, lambda number, chunk: out.append((number, chunk)))
    return out[0]


def _refuse(*, runs: int, seed: int, jobs: int | None = None, covariance: str = "full") -> None:
    """Refuse figures out of their range."""
    limits = {"runs": (runs, 1, MOST_RUNS), "seed": (seed, 0, 2**64 - 1), "jobs": (jobs, 1, 4096)}
    for key, (value, least, most) in limits.items():
        if value is not None and not (isinstance(value, Integral) and least <= value <= most):
            text = f"{key} = {value}: must lie between {least} and {most}"
            raise ConfigError("config.range", text, "give a whole number in this range", {key: value})
    if covariance not in ("full", "shared"):
        text = f'covariance = "{covariance}" is unknown'
        raise ConfigError("config.choice", text, 'use "full" or "shared"', {"covariance": covariance})
