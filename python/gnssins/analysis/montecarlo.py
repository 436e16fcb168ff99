"""Many runs of one scenario: how accurate the filter is, and whether it knows its own errors.

Only sums stay in memory. Run ``k`` depends on the seed and on ``k`` alone, and the sums are taken in the order of
``k``: the figures are the same for any number of jobs.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import text
from gnssins.analysis.consistency import Nees, NeesGroup, NisGroup, Parameters, nees, nis
from gnssins.analysis.errors import compare
from gnssins.analysis.outages import Outage, outage_table
from gnssins.config import Config
from gnssins.parallel import ordered, submitted
from gnssins.runner import as_config, run

if TYPE_CHECKING:
    from gnssins.sim import Simulated

__all__ = ["MonteCarlo", "monte_carlo", "run_seed"]

Array = NDArray[np.float64]

_AXES = ("north", "east", "down")


class Simulator(Protocol):
    """Makes run after run: :class:`gnssins.sim.Simulator`, or anything like it that threads may share."""

    def run(self, seed: int) -> Simulated:
        """Make the run of one seed."""


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """What a set of runs says together.

    Parameters
    ----------
    runs : int
        Number of runs.
    seed : int
        Seed of the set; run ``k`` used ``run_seed(seed, k)``.
    after_s : float
        Root mean squares and NIS count times after this one.
    position, velocity, phi : ndarray, shape (3,)
        Root mean square over runs and epochs along north, east, down: m, m/s, rad.
    run_position : ndarray, shape (runs, 3)
        The same of each run, for outliers.
    nees : Nees
        Mean over the runs at each epoch of the covariance; ``nees.after(after_s)`` for the steady state.
    nis : NisGroup
        Whole fixes of all runs.
    gap_ends : ndarray, shape (runs, gaps, 9)
        Errors at the ends of the gaps: position N, E, D (m), velocity N, E, D (m/s), roll, pitch, heading (rad).
    gap_sds : ndarray, shape (runs, gaps, 9)
        Standard deviations that the filter claimed there.
    counts : mapping
        Sums of the GNSS counts.
    """

    runs: int
    seed: int
    after_s: float
    position: Array
    velocity: Array
    phi: Array
    run_position: Array
    nees: Nees
    nis: NisGroup
    gap_ends: Array
    gap_sds: Array
    counts: Mapping[str, int]

    @property
    def gap_ratio(self) -> Array:
        """Root mean square over runs of error over sigma at the end of each gap, shape (gaps, 9); 1 is honest."""
        return np.asarray(np.sqrt(np.mean((self.gap_ends / self.gap_sds) ** 2, axis=0)))

    def table(self) -> str:
        """All figures as text."""
        rows = [
            ["position, m", *map(text.number, self.position)],
            ["velocity, m/s", *map(text.number, self.velocity)],
            ["attitude about the axis, arcmin", *(text.number(60.0 * v) for v in np.degrees(self.phi))],
        ]
        title = f"Root mean square of {self.runs} runs, t > {self.after_s:g} s (seed {self.seed})"
        parts = [text.table(title, ["", *_AXES], rows)]
        parts.append(self.nees.after(self.after_s).table())
        low, high = self.nis.bounds
        parts.append(
            f"NIS mean {self.nis.mean:.3f} of {self.nis.count} fixes with {self.nis.dof} components, "
            f"{100 * self.nis.probability:.0f} % bounds {low:.3f} .. {high:.3f}: {self.nis.verdict}"
        )
        if self.gap_ends.shape[1]:
            parts.append(self._gap_table())
        return "\n\n".join(parts)

    def _gap_table(self) -> str:
        rms = np.sqrt(np.mean(self.gap_ends**2, axis=0))
        head = ["end of gap", *(f"{a}, m" for a in _AXES), *(f"over sigma {a}" for a in _AXES)]
        rows = [
            [str(g + 1), *map(text.number, rms[g, :3]), *(f"{v:.2f}" for v in self.gap_ratio[g, :3])]
            for g in range(rms.shape[0])
        ]
        return text.table("Position error at the ends of the gaps, rms over the runs", head, rows)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, units in the names."""
        return {
            "runs": self.runs,
            "seed": self.seed,
            "after_s": self.after_s,
            "position_m": self.position.tolist(),
            "velocity_m_s": self.velocity.tolist(),
            "phi_arcmin": (60.0 * np.degrees(self.phi)).tolist(),
            "nees": self.nees.after(self.after_s).to_dict(),
            "nis": {"mean": self.nis.mean, "count": self.nis.count, "bounds": list(self.nis.bounds)},
            "gap_end_over_sigma": self.gap_ratio.tolist(),
            "counts": dict(self.counts),
        }


@dataclass(frozen=True, eq=False)
class _Summary:
    """What one run leaves behind."""

    count: int
    squares: Array
    nees: Nees
    nis_sum: float
    nis_count: int
    nis_dof: int
    gap_ends: Array
    gap_sds: Array
    counts: Mapping[str, int]


def run_seed(seed: int, index: int) -> int:
    """Seed of run ``index`` of a set: hashed, so that neighbouring sets and runs share nothing."""
    return int(np.random.SeedSequence(seed, spawn_key=(index,)).generate_state(1, np.uint64)[0] >> 1)


def monte_carlo(
    simulator: Simulator,
    config: Config | Mapping[str, Any] | str | os.PathLike[str],
    runs: int = 100,
    seed: int = 0,
    *,
    after_s: float = 0.0,
    jobs: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[float], None] | None = None,
) -> MonteCarlo:
    """Simulate, filter and compare ``runs`` times.

    Parameters
    ----------
    simulator : Simulator
        Such as ``gnssins.Simulator("fomichev-tan-2017")``, its truth at the rate of the IMU: a sparse truth would
        have to be interpolated, which costs more accuracy in turns than the filter has to show.
    config : Config, mapping or path
        With ``covariance_interval_s``; an ``output_rate_hz`` of 1 saves most of the time and memory. Gaps come
        from ``[run] outages`` or from the simulator.
    runs, seed : int
        Number of runs and seed of the set.
    after_s : float
        Start of the steady state for root mean squares and NIS.
    jobs : int, optional
        Threads; left out: one per core. The engine releases the GIL.
    executor : concurrent.futures.Executor, optional
        Runs the jobs instead, on processes or machines.
    progress : callable, optional
        Called after each run with the share that is done.

    Returns
    -------
    MonteCarlo

    Raises
    ------
    GnssinsError
        The error of the first run that fails.
    """
    config = as_config(config)
    work = partial(_one_run, simulator, config, seed, after_s)
    if executor is not None:
        return _reduce(submitted(executor, work, runs, 4 * (os.cpu_count() or 1), progress), seed, after_s)
    return _reduce(ordered(work, runs, jobs or os.cpu_count() or 1, progress), seed, after_s)


def _one_run(simulator: Simulator, config: Config, seed: int, after_s: float, index: int) -> _Summary:
    simulated = simulator.run(run_seed(seed, index))
    truth, result = simulated.truth, run(config, simulated)
    ellipsoid = str(result.metadata["ellipsoid"])
    found = compare(result, truth, ellipsoid=ellipsoid).between(after_s)
    joint = nis(result, after_s=after_s)
    whole = max(joint.groups.values(), key=lambda g: (g.name.startswith("gnss"), g.count))
    windows = config.run.outages or simulated.outages
    gaps: tuple[Outage, ...] = outage_table(result, truth, windows).outages if windows else ()
    ends = [np.concatenate([g.end_position, g.end_velocity, g.end_euler]) for g in gaps]
    return _Summary(
        count=len(found),
        squares=np.array([(e**2).sum(axis=0) for e in (found.position, found.velocity, found.phi)]),
        nees=nees(result, truth, Parameters.of(simulated)),
        nis_sum=whole.mean * whole.count,
        nis_count=whole.count,
        nis_dof=whole.dof,
        gap_ends=np.array(ends).reshape(-1, 9),
        gap_sds=np.array([g.end_sd for g in gaps]).reshape(-1, 9),
        counts=result.counts["gnss"],
    )


def _reduce(summaries: Iterator[_Summary], seed: int, after_s: float) -> MonteCarlo:
    """Add up in the order of the runs."""
    first = next(summaries)
    squares, count, nis_sum, nis_count = np.zeros((3, 3)), 0, 0.0, 0
    sums = {name: np.zeros_like(g.value) for name, g in first.nees.groups.items()}
    counts = dict.fromkeys(first.counts, 0)
    per_run, ends, sds = [], [], []
    for summary in _chain(first, summaries):
        squares += summary.squares
        count += summary.count
        nis_sum += summary.nis_sum
        nis_count += summary.nis_count
        for name, total in sums.items():
            total += summary.nees[name].value
        for name in counts:
            counts[name] += summary.counts[name]
        per_run.append(np.sqrt(summary.squares[0] / summary.count))
        ends.append(summary.gap_ends)
        sds.append(summary.gap_sds)
    runs, rms = len(per_run), np.sqrt(squares / count)
    groups = {
        name: NeesGroup(name, g.dof, g.t_ns, sums[name] / runs, runs, g.probability)
        for name, g in first.nees.groups.items()
    }
    return MonteCarlo(
        runs=runs,
        seed=seed,
        after_s=after_s,
        position=rms[0],
        velocity=rms[1],
        phi=rms[2],
        run_position=np.array(per_run),
        nees=Nees(groups),
        nis=NisGroup("gnss", first.nis_dof, nis_count, nis_sum / nis_count),
        gap_ends=np.array(ends),
        gap_sds=np.array(sds),
        counts=counts,
    )


def _chain(first: _Summary, rest: Iterator[_Summary]) -> Iterator[_Summary]:
    yield first
    yield from rest
