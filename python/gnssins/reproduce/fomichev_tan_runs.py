"""Runs of the published UAV flight: with GNSS throughout, with gaps, with an INS that is only restarted at each gap."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import Ensemble, NavErrors, Sample, compare, ned_difference, run_seed, sample_run
from gnssins.config import Config
from gnssins.dataset import TruthTable
from gnssins.result import Result
from gnssins.runner import run
from gnssins.sim import Simulated, Simulator, load_scenario, scenario_from_dict
from gnssins.sim.initial import draw_initial_state
from gnssins.uncoupled import separated
from gnssins.units import NS_PER_S

__all__ = [
    "PUBLISHED",
    "READINGS",
    "Flight",
    "Plan",
    "Reading",
    "Realisation",
    "fly",
    "fly_reading",
    "realise",
]

Array = NDArray[np.float64]

SCENARIO: Final = "fomichev-tan-2017"

#: Time between the epochs at which errors are kept, s.
STEP_S: Final = 10.0


@dataclass(frozen=True)
class Reading:
    """One reading of the white gyro noise, printed as 0.001 deg/h without saying per what."""

    name: str
    text: str
    arw_deg_sqrt_h: float


READINGS: Final = {
    "A": Reading("A", "0.001 deg/h in each sample at 100 Hz", 0.001 * math.sqrt(0.01 / 3600.0)),
    "B": Reading("B", "0.001 deg/sqrt(h)", 0.001),
    "C": Reading("C", "0.001 deg/h/sqrt(Hz)", 0.001 / 60.0),
}


@dataclass(frozen=True)
class Plan:
    """The experiment: which gaps, from when on the filter counts as settled.

    Parameters
    ----------
    gaps : sequence of (from, to)
        Times without fixes, s.
    after_s : float
        Start of the steady state.
    changes : mapping
        Keys of ``[scenario]`` to change, such as a shorter ``duration_s``.
    """

    gaps: tuple[tuple[float, float], ...]
    after_s: float
    changes: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def _tables(self) -> dict[str, Any]:
        tables = load_scenario(SCENARIO).model_dump(mode="json", exclude_none=True)
        tables["scenario"] |= self.changes
        tables["variant"] = {}
        return tables

    @property
    def end_s(self) -> float:
        """End of the flight."""
        return float(self._tables["scenario"]["duration_s"])

    def simulator(self, reading: str = "B", *, one_sigma: bool = False) -> Simulator:
        """Flight with one reading of the gyro noise; ``one_sigma``: the constant gyro drift is +1 sigma, not drawn."""
        tables = {**self._tables, "imu": dict(self._tables["imu"])}
        tables["imu"]["gyro"] = {"arw_deg_sqrt_h": READINGS[reading].arw_deg_sqrt_h}
        if one_sigma:
            tables["imu"]["error"] = [_fixed(error) for error in tables["imu"]["error"]]
        return Simulator(scenario_from_dict(tables))

    def config(self, gaps: bool, reading: str = "B") -> Config:
        """The published filter, with the gate at 0.999."""
        return Config.from_dict(
            {
                "filter": {"preset": SCENARIO},
                "imu": {
                    "kind": "increments",
                    "gyro": {"arw_deg_sqrt_h": READINGS[reading].arw_deg_sqrt_h},
                },
                "run": {
                    "output_rate_hz": 1.0,
                    "covariance_interval_s": 1.0,
                    "outages": self.gaps if gaps else (),
                },
            }
        )

    def grid(self) -> list[float]:
        """Epochs of the steady state, every ten seconds."""
        return [*np.arange(self.after_s + STEP_S, self.end_s + 0.5, STEP_S).tolist()]

    def gap_epochs(self, index: int) -> list[float]:
        """Epochs inside a gap: every ten seconds, and the last second before GNSS is back."""
        begin, end = self.gaps[index]
        return [*np.arange(begin + STEP_S, end - 1.5, STEP_S).tolist(), end - 1.0]

    def epochs(self) -> list[float]:
        """Epochs that are kept of a flight with gaps: the grid, the gaps, and the seconds around their ends."""
        every = set(self.grid())
        for index, (begin, end) in enumerate(self.gaps):
            every |= {begin - 2.0, begin - 1.0, begin, end, *self.gap_epochs(index)}
        return sorted(every)

    def windows(self) -> list[tuple[float, float]]:
        """Spans that are summed up: the gaps, then from 60 s to 100 s after each of them."""
        return [*self.gaps, *((end + 59.5, end + 100.5) for _, end in self.gaps)]


#: The experiment as published.
PUBLISHED: Final = Plan(gaps=((1800.0, 2100.0), (2200.0, 2400.0), (2500.0, 2700.0)), after_s=600.0)


def _fixed(error: dict[str, Any]) -> dict[str, Any]:
    """A drawn constant becomes its standard deviation."""
    if error["process"] != "constant":
        return error
    return {**{k: v for k, v in error.items() if k != "initial_sd"}, "value": error["initial_sd"]}


@dataclass(frozen=True, eq=False)
class Flight:
    """What one simulated flight leaves behind.

    Parameters
    ----------
    whole, gaps : Sample
        Filter with GNSS throughout (epochs of the grid) and with the gaps (:meth:`Plan.epochs`).
    restarted : tuple of ndarray, shape (epochs, 3)
        Per gap: position errors N, E, D (m) of the INS that is only restarted, at :meth:`Plan.gap_epochs`.
    restarted_rms : ndarray, shape (gaps, 3)
        The same over the gap, root mean square of all seconds.
    first_nis : ndarray, shape (gaps,)
        NIS of the first fix after each gap.
    """

    whole: Sample
    gaps: Sample
    restarted: tuple[Array, ...]
    restarted_rms: Array
    first_nis: Array


def fly(plan: Plan, simulator: Simulator, seed: int, index: int) -> Flight:
    """Simulate run ``index`` once; filter it twice; let an INS coast beside it."""
    simulated = simulator.run(run_seed(seed, index))
    whole = sample_run(
        run(plan.config(gaps=False), simulated),
        simulated,
        at_s=plan.grid(),
        windows=[(plan.after_s, math.inf)],
        after_s=plan.after_s,
    )
    result = run(plan.config(gaps=True), simulated)
    gaps = sample_run(result, simulated, at_s=plan.epochs(), windows=plan.windows(), after_s=plan.after_s)
    every = restarted_errors(simulated, plan.gaps)
    at = [np.searchsorted(np.arange(b + 1.0, e), plan.gap_epochs(g)) for g, (b, e) in enumerate(plan.gaps)]
    return Flight(
        whole=whole,
        gaps=gaps,
        restarted=tuple(errors[rows] for errors, rows in zip(every, at, strict=True)),
        restarted_rms=np.array([np.sqrt(np.mean(errors**2, axis=0)) for errors in every]),
        first_nis=_first_nis(result, plan.gaps),
    )


def fly_reading(plan: Plan, reading: str, simulator: Simulator, seed: int, index: int) -> Sample:
    """Simulate and filter run ``index`` with the gaps under another reading of the gyro noise."""
    simulated = simulator.run(run_seed(seed, index))
    result = run(plan.config(True, reading), simulated)
    return sample_run(result, simulated, at_s=plan.epochs(), windows=plan.windows(), after_s=plan.after_s)


def restarted_errors(simulated: Simulated, gaps: Sequence[tuple[float, float]]) -> list[Array]:
    """Position errors of a free INS that is set to the last fix before each gap, :func:`gnssins.separated`.

    It starts with the drawn initial errors; its attitude and its sensors are never corrected.

    Returns
    -------
    list of ndarray, shape (seconds, 3)
        Per gap ``begin + 1, ..., end - 1`` s: north, east, down (m).
    """
    free = separated(simulated, "restart-at-gap", outages=gaps, vertical="free", output_rate_hz=1.0)
    errors = compare(free, simulated.truth)
    return [errors.between(begin, end - 0.5).position for begin, end in gaps]


def _first_nis(result: Result, gaps: Sequence[tuple[float, float]]) -> Array:
    """NIS of the first fix that was compared after each gap, shape (gaps,)."""
    records = result.records
    seen = records.is_status("used", "rejected")
    first = [np.flatnonzero(seen & (records.t_ns >= round(end * NS_PER_S)))[0] for _, end in gaps]
    return np.asarray(records.nis[np.asarray(first)])


# ---- the one realisation that the publication shows


class _OneSigma:
    """In the place of a random generator: every number drawn is +1."""

    def standard_normal(self, size: int) -> Array:
        return np.ones(size)


class _OneSigmaStreams:
    def __call__(self, name: str) -> _OneSigma:
        return _OneSigma()


@dataclass(frozen=True, eq=False)
class Realisation:
    """One flight with initial errors and constant drifts of +1 sigma each, as the publication shows it.

    Parameters
    ----------
    simulated : Simulated
        The flight; Markov drifts, white noise and fixes are drawn.
    whole, gaps : NavErrors
        Errors of the filter with GNSS throughout and with the gaps, every second.
    fix_errors : ndarray, shape (m, 6)
        Fix minus truth at each fix: position N, E, D (m), velocity N, E, D (m/s).
    fix_time_s : ndarray, shape (m,)
        Their times.
    """

    simulated: Simulated
    whole: NavErrors
    gaps: NavErrors
    fix_errors: Array
    fix_time_s: Array

    @property
    def truth(self) -> TruthTable:
        """True motion."""
        return self.simulated.truth


def realise(plan: Plan, seed: int) -> Realisation:
    """Fly the realisation with errors of +1 sigma."""
    simulator = plan.simulator(one_sigma=True)
    drawn = simulator.run(seed)
    figures, streams = simulator.scenario.initial_error, _OneSigmaStreams()
    initial, error = draw_initial_state(simulator.trajectory, figures, streams)  # type: ignore[arg-type]
    simulated = replace(drawn, initial=initial, initial_error=error)
    truth, gnss = simulator.truth, simulated.dataset.gnss
    whole, gaps = (compare(run(plan.config(gaps=gap), simulated), truth) for gap in (False, True))
    rows = np.searchsorted(truth.t_ns, gnss.t_ns)
    position = ned_difference(gnss.lla, truth.lla[rows])
    fix_errors = np.column_stack([position, gnss.v_n - truth.v_n[rows]])
    return Realisation(simulated, whole, gaps, fix_errors, gnss.t_ns / NS_PER_S)


def together(plan: Plan, flights: Sequence[Flight], seed: int) -> tuple[Ensemble, Ensemble]:
    """Ensembles of the flights with GNSS throughout and with the gaps."""
    return Ensemble.of([f.whole for f in flights], seed), Ensemble.of([f.gaps for f in flights], seed)
