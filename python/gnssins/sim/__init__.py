"""Simulation: scenarios, true motion, sensors and receivers, all random numbers from one seed.

>>> from gnssins import simulate
>>> simulated = simulate("static", seed=1)
>>> simulated.dataset.imu.kind
'increments'
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..alignment import InitialState
from ..dataset import BaroTable, Dataset, GnssTable, HeadingTable, TruthTable
from ..errors import ConfigError, InputError
from .aiding import simulate_gnss
from .aids import simulate_baro, simulate_heading
from .imu import simulate_imu
from .initial import draw_initial_state
from .library import (
    load_scenario,
    relocate,
    scenario_from_dict,
    scenario_names,
    scenario_toml,
    variant_from_dict,
)
from .scenario import Scenario
from .streams import Streams
from .trajectory import Trajectory, build_trajectory

__all__ = [
    "Scenario",
    "Simulated",
    "Simulator",
    "Trajectory",
    "build_trajectory",
    "load_scenario",
    "relocate",
    "scenario_from_dict",
    "scenario_names",
    "scenario_toml",
    "simulate",
]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Simulated:
    """One simulated run.

    Attributes
    ----------
    dataset : Dataset
        IMU increments, fixes, heights of a barometer, headings and the truth, as far as the scenario has them.
    initial : InitialState
        State at the start, with drawn errors, and its standard deviations.
    initial_error : ndarray, shape (9,)
        Those errors, estimate minus truth, along north, east, down: phi (rad), velocity (m/s), position (m).
    truth_blocks : Mapping of str to ndarray, shape (k, states of the block)
        True sensor errors at the stamps of ``dataset.truth``, SI, by the name of their filter block and in
        the order of the scenario.
    scenario : Scenario
        Where it comes from.
    seed : int
        Seed of all random numbers.
    outages : tuple of (from, to)
        Times of validity [from, to) without fixes, s.
    """

    dataset: Dataset
    initial: InitialState
    initial_error: Array
    truth_blocks: Mapping[str, Array]
    scenario: Scenario
    seed: int
    outages: tuple[tuple[float, float], ...]

    @property
    def truth(self) -> TruthTable:
        """True motion of the dataset, which a simulated run always has.

        Raises
        ------
        InputError
            ``input.no_truth``: it was taken away.
        """
        if self.dataset.truth is None:
            raise InputError("input.no_truth", "the simulated run has no truth")
        return self.dataset.truth


class Simulator:
    """Runs of one scenario; the true motion is made once and shared by all of them.

    Parameters
    ----------
    scenario : str, path or Scenario
        Packaged name, TOML file or model.
    variant : str, optional
        Named variant of the scenario.
    outages : sequence of (from, to), optional
        Times of validity [from, to) without fixes, s, instead of those of the scenario or variant.
    truth_rate_hz : float, optional
        Rate of the truth table and of the true sensor errors; left out: every IMU sample. The nearest whole
        fraction of the IMU rate is taken.

    Raises
    ------
    ConfigError
        Unknown scenario or variant, or a wrong scenario.
    MissingFileError
        No such file.

    Attributes
    ----------
    scenario : Scenario
        With the tables of the variant.
    outages : tuple of (from, to)
        Times without fixes, s.
    truth_step : int
        IMU samples from one row of the truth table to the next.
    """

    def __init__(
        self,
        scenario: str | os.PathLike[str] | Scenario,
        *,
        variant: str | None = None,
        outages: Sequence[tuple[float, float]] | None = None,
        truth_rate_hz: float | None = None,
    ) -> None:
        source = load_scenario(scenario)
        self.variant = variant
        self.outages = _outages(source, variant, outages)
        self.scenario = source if variant is None else source.with_variant(variant)
        self.truth_step = 1
        if truth_rate_hz is not None:
            self.truth_step = max(1, round(self.scenario.scenario.rate_hz / truth_rate_hz))

    @cached_property
    def trajectory(self) -> Trajectory:
        """True motion at the IMU rate."""
        return build_trajectory(self.scenario)

    @cached_property
    def truth(self) -> TruthTable:
        """True motion at the rate of the truth table."""
        rows, path = slice(None, None, self.truth_step), self.trajectory
        return TruthTable(path.t_ns[rows], path.lla[rows], path.v_n[rows], path.q_nb[rows])

    def run(self, seed: int) -> Simulated:
        """Sensors, fixes and initial errors of one run.

        Parameters
        ----------
        seed : int
            Not negative. The same seed gives the same bytes.

        Returns
        -------
        Simulated

        Raises
        ------
        ConfigError
            ``config.seed``: a negative seed.
        """
        if seed < 0:
            raise ConfigError("config.seed", f"seed = {seed} is negative", "use 0 or more", {"seed": seed})
        streams, path = Streams(seed), self.trajectory
        imu, blocks = simulate_imu(path, self.scenario.imu, streams)
        gnss = GnssTable.empty()
        if self.scenario.gnss is not None:
            gnss, gnss_blocks = simulate_gnss(path, self.scenario.gnss, streams, self.outages)
            blocks |= gnss_blocks
        baro, heading = BaroTable.empty(), HeadingTable.empty()
        if self.scenario.baro is not None:
            baro, baro_blocks = simulate_baro(path, self.scenario.baro, streams)
            blocks |= baro_blocks
        if self.scenario.heading is not None:
            heading = simulate_heading(path, self.scenario.heading, streams, self.outages)
        initial, initial_error = draw_initial_state(path, self.scenario.initial_error, streams)
        meta = {"scenario": self.scenario.name, "variant": self.variant, "seed": seed}
        return Simulated(
            dataset=Dataset(imu, gnss, self.truth, meta=meta, baro=baro, heading=heading),
            initial=initial,
            initial_error=initial_error,
            truth_blocks={name: history[:: self.truth_step] for name, history in blocks.items()},
            scenario=self.scenario,
            seed=seed,
            outages=self.outages,
        )


def simulate(
    scenario: str | os.PathLike[str] | Scenario,
    seed: int = 0,
    *,
    variant: str | None = None,
    outages: Sequence[tuple[float, float]] | None = None,
) -> Simulated:
    """One simulated run; for many runs of a scenario keep a :class:`Simulator`.

    Parameters
    ----------
    scenario : str, path or Scenario
        Packaged name (see :func:`scenario_names`), TOML file or model.
    seed : int, optional
        Seed of all random numbers.
    variant : str, optional
        Named variant of the scenario.
    outages : sequence of (from, to), optional
        Times without fixes, s, instead of those of the scenario or variant.

    Returns
    -------
    Simulated

    Raises
    ------
    ConfigError
        Unknown scenario or variant, or a wrong scenario.
    MissingFileError
        No such file.
    """
    return Simulator(scenario, variant=variant, outages=outages).run(seed)


def _outages(
    scenario: Scenario, variant: str | None, outages: Sequence[tuple[float, float]] | None
) -> tuple[tuple[float, float], ...]:
    if variant is not None and variant not in scenario.variant:
        known = ", ".join(scenario.variant) or "none"
        raise ConfigError(
            "config.variant",
            f'{scenario.name} has no variant "{variant}"; known: {known}',
            "leave it out for the scenario as it stands",
            {"variant": variant, "known": list(scenario.variant)},
        )
    if outages is not None:
        windows = [[float(first), float(last)] for first, last in outages]
        return variant_from_dict({"outages": windows}).outages or ()
    if variant is not None:
        own = scenario.variant[variant].outages
        if own is not None:
            return own
        scenario = scenario.with_variant(variant)
    return scenario.gnss.outages if scenario.gnss is not None else ()
