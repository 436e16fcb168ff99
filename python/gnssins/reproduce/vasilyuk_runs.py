"""Walks of the published pole: matched sensors, uncalibrated ones, and a pole that does not sway."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.analysis import (
    Ensemble,
    NavErrors,
    Observability,
    OutageGrowth,
    Sample,
    compare,
    observability,
    outage_growth,
    run_seed,
    sample_run,
)
from gnssins.config import Config
from gnssins.result import Result
from gnssins.runner import run
from gnssins.sim import Simulated, Simulator, Trajectory
from gnssins.tables import stretches, wrap_pi
from gnssins.units import NS_PER_S

__all__ = ["PUBLISHED", "SCENARIO", "Plan", "Stretch", "Walk", "growths", "matched", "together", "walk"]

Array = NDArray[np.float64]

SCENARIO: Final = "vasilyuk-2019"

#: Yaw rate (rad/s) and acceleration (m/s^2) below which the path counts as straight and even.
_STRAIGHT_RATE: Final = 1e-3
_STRAIGHT_ACCEL: Final = 1e-2

#: A window is one of a turn if its middle is no farther than this from the middle of the turn, s.
_IN_TURN_S: Final = 0.5


@dataclass(frozen=True)
class Stretch:
    """Part of the path: a straight from ``start_s`` to ``end_s``, or the middle of a turn (both times equal)."""

    name: str
    start_s: float
    end_s: float

    @property
    def is_turn(self) -> bool:
        """Tell a turn from a straight."""
        return self.start_s == self.end_s

    def of(self, found: Observability) -> Observability:
        """Windows wholly on the straight, or centred on the turn."""
        if not self.is_turn:
            return found.between(self.start_s, self.end_s)
        middle = 0.5 * (found.first_s + found.t_s)
        return found.select(np.abs(middle - self.start_s) <= _IN_TURN_S)


@dataclass(frozen=True)
class Plan:
    """The experiment.

    Parameters
    ----------
    gap : (from, to)
        Time without fixes, s: the published 20 s from a point B on a straight.
    settled_s : float
        Point A, from which on the filter counts as settled.
    """

    gap: tuple[float, float] = (100.0, 120.0)
    settled_s: float = 80.0

    @property
    def at_s(self) -> list[float]:
        """Whole seconds since the start of the gap."""
        return [float(s) for s in range(1, round(self.gap[1] - self.gap[0]) + 1)]

    def config(self, *, gap: bool = False, linearise: bool = False) -> Config:
        """The published filter; the gap takes in the fix at its end, so that the last second is coasted too."""
        outages = [[self.gap[0], self.gap[1] + 0.05]] if gap else []
        return Config.from_dict(
            {
                "filter": {"preset": SCENARIO},
                "imu": {"kind": "increments"},
                "gnss": {"use": "position", "lever_ba_b_m": list(self.lever)},
                "run": {
                    "output_rate_hz": 10.0,
                    "covariance_interval_s": 1.0,
                    "outages": outages,
                    "linearise": linearise,
                },
            }
        )

    @cached_property
    def lever(self) -> tuple[float, float, float]:
        """Lever arm of the scenario, m."""
        gnss = self.simulator("continuous").scenario.gnss
        if gnss is None:
            raise TypeError("the walk has no fixes")
        return gnss.lever_ba_b_m

    def simulator(self, variant: str) -> Simulator:
        """Walks of one variant of the scenario."""
        return Simulator(SCENARIO, variant=variant)

    @cached_property
    def stretches(self) -> tuple[Stretch, ...]:
        """Straights and turns of the path, told from the pole that does not sway."""
        return _stretches(self.simulator("no-sway").trajectory)


#: The experiment as published, as far as it tells.
PUBLISHED: Final = Plan()


def _stretches(path: Trajectory) -> tuple[Stretch, ...]:
    t_s = path.t_ns / NS_PER_S
    heading = np.unwrap(_core.quat_to_euler(np.ascontiguousarray(path.q_nb))[:, 2])
    rate = np.gradient(heading, t_s)
    accel = np.linalg.norm(np.gradient(path.v_n, t_s, axis=0), axis=1)
    moving = np.hypot(path.v_n[:, 0], path.v_n[:, 1]) > 0.5
    even = (np.abs(rate) < _STRAIGHT_RATE) & (accel < _STRAIGHT_ACCEL) & moving
    turning = (np.abs(rate) > 0.5 * np.abs(rate).max()) & moving
    straights = [
        Stretch(f"straight {i + 1}", float(t_s[a]), float(t_s[b - 1]))
        for i, (a, b) in enumerate(stretches(even, 500))
    ]
    middles = [0.5 * float(t_s[a] + t_s[b - 1]) for a, b in stretches(turning, 20)]
    turns = [Stretch(f"turn {i + 1}", middle, middle) for i, middle in enumerate(middles)]
    return tuple(sorted([*straights, *turns], key=lambda s: s.start_s))


@dataclass(frozen=True, eq=False)
class Walk:
    """What one walk leaves behind.

    Parameters
    ----------
    corrected, truth : OutageGrowth
        Errors in the gap against the same filter with all fixes (as published), and against the truth.
    change : ndarray, shape (e, 4)
        Change of the error since the start of the gap: horizontal (m), roll, pitch, heading (rad).
    sample : Sample
        Errors of all states with GNSS throughout, every second.
    windows : tuple of Observability
        Windows of every stretch of the plan, in SI and in sigma: twice as many as there are stretches. Empty where
        nobody looked.
    flagged : tuple of str
        States that are flagged (SI) in any window of the walk.
    """

    corrected: OutageGrowth
    truth: OutageGrowth
    change: Array
    sample: Sample
    windows: tuple[Observability, ...]
    flagged: tuple[str, ...]


def matched(simulated: Simulated) -> Simulated:
    """The filter has one bias per sensor: its truth is the sum of turn-on bias and drift."""
    found = simulated.truth_blocks
    blocks = {f"{s}_bias": found[f"{s}_bias"] + found[f"{s}_drift"] for s in ("gyro", "accel")}
    return replace(simulated, truth_blocks=blocks)


def walk(plan: Plan, simulator: Simulator, seed: int, index: int, *, watched: int = 0) -> Walk:
    """Simulate walk ``index``, filter it with and without the gap; see what was observable in the first ``watched``."""
    observed = index < watched
    simulated = matched(simulator.run(run_seed(seed, index)))
    truth = simulated.truth
    whole = run(plan.config(linearise=observed), simulated)
    coasted = run(plan.config(gap=True), simulated)
    windows: tuple[Observability, ...] = ()
    flagged: tuple[str, ...] = ()
    if observed:
        both = observability(whole), observability(whole, scaling="sigma")
        windows = tuple(stretch.of(found) for found in both for stretch in plan.stretches)
        flagged = both[0].ever_flagged
    return Walk(
        corrected=outage_growth(coasted, whole, [plan.gap], at_s=plan.at_s),
        truth=outage_growth(coasted, truth, [plan.gap], at_s=plan.at_s),
        change=_change(plan, coasted, compare(coasted, truth)),
        sample=sample_run(whole, simulated, after_s=plan.settled_s),
        windows=windows,
        flagged=flagged,
    )


def _change(plan: Plan, coasted: Result, errors: NavErrors) -> Array:
    """Change of the error since the last epoch before the gap, shape (e, 4)."""
    times = np.array([0.0, *plan.at_s]) + plan.gap[0]
    rows = np.searchsorted(errors.t_ns, np.rint((times + 1e-6) * NS_PER_S).astype(np.int64), side="right") - 1
    rows[0] -= 1  # before the first withheld fix
    position = errors.position[rows] - errors.position[rows[0]]
    angles = wrap_pi(errors.euler[rows] - errors.euler[rows[0]])
    return np.column_stack([np.hypot(position[:, 0], position[:, 1]), angles])[1:]


def growths(walks: Sequence[Walk]) -> tuple[OutageGrowth, OutageGrowth]:
    """Growth in all gaps, against the corrected runs and against the truth."""
    return OutageGrowth.combine([w.corrected for w in walks]), OutageGrowth.combine([w.truth for w in walks])


def together(walks: Sequence[Walk], seed: int) -> Ensemble:
    """Errors of all walks with GNSS throughout."""
    return Ensemble.of([w.sample for w in walks], seed)
