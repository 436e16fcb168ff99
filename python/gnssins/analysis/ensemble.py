"""Errors of every state over many seeded runs, at chosen epochs and over chosen spans, beside what the filter claimed.

:func:`gnssins.monte_carlo` adds up as it goes and keeps sums only; an ensemble keeps the errors themselves, so
that medians, quantiles and growth over a gap can be told of any state. Navigation errors are estimate minus truth along
north, east, down; block errors are estimate minus truth too (the covariance counts them the other way round).
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import text
from gnssins.analysis.consistency import Nees, NeesGroup, Nis, NisGroup, chi_square_bounds, direction
from gnssins.analysis.sample import NEAR_S, Sample, rms_of, sample_run
from gnssins.config import Config
from gnssins.errors import InputError
from gnssins.parallel import ordered
from gnssins.runner import as_config, run
from gnssins.sim.streams import run_seed
from gnssins.tables import State, table_unit
from gnssins.units import NS_PER_S

if TYPE_CHECKING:
    from gnssins.sim import Simulated

__all__ = ["Ensemble", "Sample", "ensemble", "sample_run"]

Array = NDArray[np.float64]
Windows = Sequence[tuple[float, float]]


class Simulator(Protocol):
    """Makes run after run: :class:`gnssins.sim.Simulator`, or anything like it that threads may share."""

    def run(self, seed: int) -> Simulated:
        """Make the run of one seed."""


@dataclass(frozen=True, eq=False)
class Ensemble:
    """A set of runs: every error of every state at some epochs.

    Parameters
    ----------
    runs, seed : int
        Number of runs and seed of the set; run ``k`` used ``run_seed(seed, k)``.
    time_s : ndarray, shape (epochs,)
        Epochs, s.
    states : tuple of State
        All n states in the order of the covariance.
    errors, sigmas : ndarray, shape (runs, epochs, n)
        Estimate minus truth, and the filter's own standard deviation; SI, attitude as rotation about north, east,
        down (rad). Errors of a block whose truth is not known are NaN.
    euler, euler_sigmas : ndarray, shape (runs, epochs, 3)
        The same of roll, pitch, heading (rad).
    nees_values : mapping of str to ndarray, shape (runs, epochs)
        NEES by group of states, as in :func:`gnssins.analysis.nees`.
    dof : mapping of str to int
        Number of states of each group.
    nis : Nis
        Mean over all measurements of all runs, by kind of measurement.
    windows : tuple of (from, to)
        Spans, s: ``from < t < to``.
    window_rms, window_max, window_sigma : ndarray, shape (runs, windows, n)
        Root mean square error, largest absolute error and root mean square of the filter's own sigma over the
        snapshots of a span.
    counts : mapping of str to int
        Sums of the GNSS counts.
    probability : float
        Of the two-sided chi-square bounds.
    """

    runs: int
    seed: int
    time_s: Array
    states: tuple[State, ...]
    errors: Array
    sigmas: Array
    euler: Array
    euler_sigmas: Array
    nees_values: Mapping[str, Array]
    dof: Mapping[str, int]
    nis: Nis
    windows: tuple[tuple[float, float], ...]
    window_rms: Array
    window_max: Array
    window_sigma: Array
    counts: Mapping[str, int]
    probability: float = 0.99

    @classmethod
    def of(cls, samples: Iterable[Sample], seed: int, probability: float = 0.99) -> Ensemble:
        """Put samples of :func:`sample_run` together, in their order.

        Raises
        ------
        InputError
            ``input.ensemble``: no sample, or samples with different epochs or states.
        """
        every = list(samples)
        if not every:
            raise InputError("input.ensemble", "an ensemble needs at least one run")
        first = every[0]
        for k, sample in enumerate(every):
            if sample.states != first.states or not np.array_equal(sample.time_s, first.time_s):
                raise InputError(
                    "input.ensemble",
                    f"run {k} has other states or epochs than run 0: {len(sample.states)} and {len(first.states)} "
                    f"states, {sample.time_s.size} and {first.time_s.size} epochs",
                    "give at_s, and one configuration to all runs",
                )
        stacked = {
            name: np.array([getattr(sample, name) for sample in every])
            for name in (
                "errors",
                "sigmas",
                "euler",
                "euler_sigmas",
                "window_rms",
                "window_max",
                "window_sigma",
            )
        }
        return cls(
            runs=len(every),
            seed=seed,
            time_s=first.time_s,
            states=first.states,
            nees_values={name: np.array([s.nees[name] for s in every]) for name in first.nees},
            dof=first.dof,
            nis=_pooled([sample.nis for sample in every], probability),
            windows=first.windows,
            counts={name: sum(s.counts.get(name, 0) for s in every) for name in first.counts},
            probability=probability,
            **stacked,
        )

    def at(self, time_s: float) -> int:
        """Index of an epoch.

        Raises
        ------
        InputError
            It is not among them.
        """
        found = np.flatnonzero(np.abs(self.time_s - time_s) <= NEAR_S)
        if not found.size:
            raise InputError("input.epoch", f"{time_s:g} s is not one of the {self.time_s.size} epochs")
        return int(found[0])

    def column(self, name: str) -> int:
        """Index of a state by its name, such as ``"dp_n"`` or ``"gyro_bias_x"``."""
        names = [state.name for state in self.states]
        if name not in names:
            raise InputError("input.state", f'no state "{name}"; there are {", ".join(names)}')
        return names.index(name)

    def group(self, *blocks: str) -> list[int]:
        """Indices of the states of blocks, such as ``"position"`` or ``"accel_bias"``."""
        return [i for i, state in enumerate(self.states) if state.block in blocks]

    # ---- over the runs, shapes (epochs, n)

    def rms(self) -> Array:
        """Root mean square error over the runs, shape (epochs, n)."""
        return rms_of(self.errors)

    def sigma(self) -> Array:
        """Root mean square over the runs of what the filter claims, shape (epochs, n)."""
        return rms_of(self.sigmas)

    def median(self) -> Array:
        """Median of the absolute error over the runs, shape (epochs, n)."""
        return np.asarray(np.median(np.abs(self.errors), axis=0))

    def p95(self) -> Array:
        """Absolute error that 95 % of the runs stay below, shape (epochs, n); linear between the runs."""
        return np.asarray(np.quantile(np.abs(self.errors), 0.95, axis=0))

    def ratio(self) -> Array:
        """Root mean square over the runs of error over sigma, shape (epochs, n); 1 is honest."""
        return rms_of(self.errors / self.sigmas)

    @property
    def ratio_bounds(self) -> tuple[float, float]:
        """Two-sided bounds of :meth:`ratio` for an honest filter: its square is chi-square of N runs over N."""
        low, high = chi_square_bounds(1, self.runs, self.probability)
        return math.sqrt(low), math.sqrt(high)

    def verdict(self, ratio: float) -> str:
        """Put a ratio into words: consistent, or over- or under-confident and by how much."""
        return ratio_verdict(ratio, self.runs, self.probability)

    def growth(self, from_s: float, to_s: float) -> Array:
        """Error at one epoch minus error at another one, shape (runs, n)."""
        return np.asarray(self.errors[:, self.at(to_s)] - self.errors[:, self.at(from_s)])

    def over_window(self, index: int = 0) -> tuple[Array, Array]:
        """Root mean square over runs and time of the error and of the sigma in one span, each of shape (n,)."""
        return rms_of(self.window_rms[:, index]), rms_of(self.window_sigma[:, index])

    # ---- consistency

    def nees(self) -> Nees:
        """Mean over the runs at each epoch, by group; bounds for that number of runs."""
        t_ns = np.rint(self.time_s * NS_PER_S).astype(np.int64)
        return Nees(
            {
                name: NeesGroup(name, self.dof[name], t_ns, values.mean(axis=0), self.runs, self.probability)
                for name, values in self.nees_values.items()
            }
        )

    # ---- text

    def table(self, time_s: float | None = None) -> str:
        """Errors of every state at one epoch (left out: the last), then NEES and NIS with their verdicts."""
        k = self.time_s.size - 1 if time_s is None else self.at(time_s)
        every = self.rms()[k], self.median()[k], self.p95()[k], self.sigma()[k], self.ratio()[k]
        rows = []
        for i, state in enumerate(self.states):
            unit = table_unit(state.unit)
            values = [text.number(values[i] * unit.factor) for values in every[:4]]
            ratio = float(every[4][i])
            rows.append([state.name, unit.label, *values, text.number(ratio), self.verdict(ratio)])
        low, high = self.ratio_bounds
        title = f"Errors of {self.runs} runs at {self.time_s[k]:g} s (seed {self.seed})"
        caption = f"{100 * self.probability:.0f} % bounds of error/sigma for {self.runs} runs: {low:.2f} .. {high:.2f}"
        head = ["state", "unit", "rms", "median", "95 %", "filter's sigma", "error/sigma", "the filter is"]
        parts = [text.table(title, head, rows, caption, left=(0, 1, 7)), self.nees().table()]
        if self.nis.groups:
            parts.append(self.nis.table("NIS of all runs, before the gate"))
        return "\n\n".join(parts)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, SI; None where unknown."""
        return {
            "runs": self.runs,
            "seed": self.seed,
            "time_s": self.time_s.tolist(),
            "states": [{"name": state.name, "unit": state.unit} for state in self.states],
            "rms": _listed(self.rms()),
            "median": _listed(self.median()),
            "p95": _listed(self.p95()),
            "sigma": _listed(self.sigma()),
            "ratio": _listed(self.ratio()),
            "ratio_bounds": list(self.ratio_bounds),
            "nees": {
                name: {**figures, "verdict": self.nees()[name].verdict}
                for name, figures in self.nees().to_dict().items()
            },
            "nis": self.nis.to_dict(),
            "windows": [list(window) for window in self.windows],
            "window_rms": _listed(rms_of(self.window_rms)),
            "window_sigma": _listed(rms_of(self.window_sigma)),
            "counts": dict(self.counts),
        }


def ensemble(
    simulator: Simulator,
    config: Config | Mapping[str, Any] | str | os.PathLike[str],
    runs: int = 100,
    seed: int = 0,
    *,
    at_s: Sequence[float] | None = None,
    windows: Windows = (),
    after_s: float | None = None,
    probability: float = 0.99,
    jobs: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Ensemble:
    """Simulate and filter ``runs`` times and keep the errors of every state.

    Parameters
    ----------
    simulator : Simulator
        Such as ``gnssins.Simulator("fomichev-tan-2017")``, its truth at the rate of the IMU.
    config : Config, mapping or path
        With ``covariance_interval_s``: epochs are those of the covariance snapshots, which must fall on output epochs.
    runs, seed : int
        Number of runs and seed of the set.
    at_s : sequence of float, optional
        Epochs, s; left out: every snapshot.
    windows : sequence of (from, to), optional
        Spans ``from < t < to`` (s) for errors over time; ``math.inf`` leaves the end open.
    after_s : float, optional
        NIS counts measurements after this time.
    probability : float
        Of all two-sided bounds.
    jobs : int, optional
        Threads; left out: one per core. The figures do not depend on it.
    progress : callable, optional
        Called after each run with the share that is done.

    Returns
    -------
    Ensemble

    Raises
    ------
    GnssinsError
        The error of the first run that fails.
    """
    work = partial(_one_run, simulator, as_config(config), seed, at_s, windows, after_s)
    return Ensemble.of(ordered(work, runs, jobs or os.cpu_count() or 1, progress), seed, probability)


def _one_run(
    simulator: Simulator,
    config: Config,
    seed: int,
    at_s: Sequence[float] | None,
    windows: Windows,
    after_s: float | None,
    index: int,
) -> Sample:
    simulated = simulator.run(run_seed(seed, index))
    return sample_run(run(config, simulated), simulated, at_s=at_s, windows=windows, after_s=after_s)


def ratio_verdict(ratio: float, runs: int, probability: float = 0.99) -> str:
    """Put the root mean square of error over sigma of so many runs into words."""
    return direction(ratio * ratio, 1, chi_square_bounds(1, runs, probability))


def _pooled(every: Sequence[Mapping[str, NisGroup]], probability: float) -> Nis:
    """Means over all measurements of all runs; a kind that only some runs have counts where it is."""
    groups = {}
    for name in dict.fromkeys(name for groups in every for name in groups):
        parts = [found[name] for found in every if name in found]
        count = sum(part.count for part in parts)
        mean = sum(part.mean * part.count for part in parts) / count
        groups[name] = NisGroup(name, parts[0].dof, count, mean, probability)
    return Nis(groups)


def _listed(values: Array) -> list[Any]:
    """Nested lists with None for NaN."""

    def plain(item: Any) -> Any:
        if isinstance(item, list):
            return [plain(part) for part in item]
        return item if math.isfinite(item) else None

    return [plain(row) for row in values.tolist()]
