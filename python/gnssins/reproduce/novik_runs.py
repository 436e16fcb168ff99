"""Runs of the published airliner flight: closed loop, outage, faults, scale factors, a coarse unit, feedback."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import (
    Integrity,
    NavErrors,
    Sample,
    compare,
    integrity,
    ned_difference,
    run_seed,
    sample_run,
)
from gnssins.config import Config
from gnssins.dataset import GnssTable
from gnssins.result import Result
from gnssins.runner import run
from gnssins.sim import Simulated, Simulator, load_scenario, scenario_from_dict
from gnssins.sim.frames import displaced
from gnssins.simfiles import matching_filter
from gnssins.units import ACCEL_BIAS, GYRO_BIAS, NS_PER_S

__all__ = [
    "ACCEL_M_S2", "AFTER_S", "EXAMPLE", "EXAMPLE_PERIOD_S", "FALSE_ALARM", "PUBLISHED", "STEP_M", "VARIATIONS", "Fault",
    "Feedback", "Flight", "Plan", "Realisation", "delay", "example_errors", "fault", "fly", "jumps", "realise", "vary",
]  # fmt: skip

Array = NDArray[np.float64]

SCENARIO: Final = "novik-2011"

#: Rate of false alarms that the chi-square gate is set for, per part of a fix.
FALSE_ALARM: Final = 1e-5

#: What an airliner can do, m/s^2: limit of the tolerance test.
ACCEL_M_S2: Final = 5.0

#: Step of the position north that is let through, m, and when it comes, s.
STEP_M, STEP_AT_S = 15.0, 400.0

#: Epochs after the step at which the tests are looked at; 0 is the first fix with the step.
AFTER_S: Final = (0, 1, 2, 5, 10, 20, 80)

#: Sensors of the publication's example for the period of feedback, and the period that it has from them, s.
EXAMPLE: Final = {"gyro_deg_h": 10.0, "accel_ug": 3000.0, "tilt_rad": 5e-3, "tilt_max_rad": 10e-3}
EXAMPLE_PERIOD_S: Final = 100.0


@dataclass(frozen=True)
class Plan:
    """The experiment.

    Parameters
    ----------
    end_s : float
        Length of the closed loop, s.
    outage_s : float
        Time without GNSS after it, s; the aircraft flies on along its track.
    settle_s : float
        From then on steps of the fixes count.
    """

    end_s: float = 800.0
    outage_s: float = 100.0
    settle_s: float = 100.0
    changes: Mapping[str, Any] = field(default_factory=dict)

    def tables(self, variant: str | None = None) -> dict[str, Any]:
        """Tables of the scenario with a variant, long enough for the outage."""
        scenario = load_scenario(SCENARIO)
        chosen = scenario if variant is None else scenario.with_variant(variant)
        tables: dict[str, Any] = chosen.model_dump(mode="json", exclude_none=True)
        tables["variant"] = {}
        tables["scenario"] |= {"duration_s": self.end_s + self.outage_s}
        return tables | dict(self.changes)

    @cached_property
    def simulator(self) -> Simulator:
        """The flight with ring laser gyros and the "mid" receiver."""
        return Simulator(scenario_from_dict(self.tables()))

    @cached_property
    def scaled(self) -> Simulator:
        """Scale-factor errors of 5 ppm and 100 ppm are left in; the flight ends with the closed loop."""
        return self._short(self.tables("scale-factors"))

    @cached_property
    def coarse(self) -> Simulator:
        """A unit and a receiver that come near the printed table."""
        return self._short(self.tables("coarse"))

    @cached_property
    def example(self) -> Simulator:
        """The unit of the publication's example for the period of feedback."""
        tables = self.tables()
        for error in tables["imu"]["error"]:
            error["initial_sd"] = EXAMPLE["gyro_deg_h" if error["kind"] == "gyro_bias" else "accel_ug"]
        tables["initial_error"]["attitude_sd_deg"] = [math.degrees(EXAMPLE["tilt_rad"])] * 3
        return self._short(tables)

    def _short(self, tables: dict[str, Any]) -> Simulator:
        tables["scenario"]["duration_s"] = self.end_s
        return Simulator(scenario_from_dict(tables))

    def config(
        self,
        simulator: Simulator,
        *,
        outage: bool = False,
        feedback_s: float = 0.0,
        gates: bool = True,
    ) -> Config:
        """The published filter, told the figures of the scenario.

        Parameters
        ----------
        simulator : Simulator
            Whose sensors and errors the filter knows.
        outage : bool
            Without GNSS after the end of the closed loop.
        feedback_s : float
            Least time between two feedbacks.
        gates : bool
            With the chi-square test of each part of a fix.
        """
        imu = simulator.scenario.imu
        white = (
            {"arw_deg_sqrt_h": imu.gyro.arw_deg_sqrt_h},
            {"noise_density_ug_sqrt_hz": imu.accel.noise_density_ug_sqrt_hz},
        )
        probability = 1.0 - FALSE_ALARM if gates else "off"
        return Config.from_dict(
            {
                "filter": {**matching_filter(simulator.scenario), "feedback_interval_s": feedback_s},
                "imu": {"kind": "increments", "gyro": white[0], "accel": white[1]},
                "gnss": {"gate": "parts", "gate_probability": probability, "reacquire_after": "off"},
                "baro": {"gate_probability": probability},
                "run": {
                    "output_rate_hz": 1.0,
                    "covariance_interval_s": 1.0,
                    # the fix at the end of the closed loop is the last one
                    "outages": [[self.end_s + 0.5, self.end_s + self.outage_s + 0.5]] if outage else [],
                },
            }
        )

    def grid(self) -> list[float]:
        """Epochs of the closed loop: every ten seconds."""
        return [*np.arange(10.0, self.end_s + 0.5, 10.0).tolist()]

    def gap(self) -> list[float]:
        """Every second of the outage, the last fix first."""
        return [*np.arange(self.end_s, self.end_s + self.outage_s + 0.5).tolist()]


#: The experiment as published.
PUBLISHED: Final = Plan()


@dataclass(frozen=True, eq=False)
class Flight:
    """What one simulated flight leaves behind; second 0 of the gap is the last fix.

    Parameters
    ----------
    loop : Sample
        The closed loop at the epochs of the grid.
    gap : Sample
        Every second of the outage.
    tests, reduced : Integrity
        Innovations of all fixes, on the ground and in the publication's reduced coordinates.
    jumps : ndarray, shape (j, 6)
        Fix less the extrapolated estimate of one second before: N, E, D (m), velocity (m/s).
    scaled, unscaled : Sample
        Scale-factor errors left in: filter with and without states for them.
    coarse : Sample
        Coarse unit and receiver.
    """

    loop: Sample
    gap: Sample
    tests: Integrity
    reduced: Integrity
    jumps: Array
    scaled: Sample
    unscaled: Sample
    coarse: Sample


def fly(plan: Plan, seed: int, index: int) -> Flight:
    """Simulate run ``index`` in all variants and filter it."""
    simulated = plan.simulator.run(run_seed(seed, index))
    result = run(plan.config(plan.simulator, outage=True), simulated)
    windows = [(plan.settle_s, plan.end_s + 0.5)]
    scaled = plan.scaled.run(run_seed(seed, index))
    coarse = plan.coarse.run(run_seed(seed, index))

    def sampled(config: Config, data: Simulated) -> Sample:
        return sample_run(run(config, data), data, at_s=plan.grid(), windows=windows, after_s=0.0)

    return Flight(
        loop=sample_run(result, simulated, at_s=plan.grid(), windows=windows, after_s=0.0),
        gap=sample_run(result, simulated, at_s=plan.gap()),
        tests=integrity(result, false_alarm=FALSE_ALARM),
        reduced=integrity(result, false_alarm=FALSE_ALARM, reduced=True),
        jumps=jumps(result, simulated.dataset.gnss),
        scaled=sampled(plan.config(plan.scaled), scaled),
        unscaled=sampled(plan.config(plan.simulator), scaled),
        coarse=sampled(plan.config(plan.coarse), coarse),
    )


def jumps(result: Result, gnss: GnssTable) -> Array:
    """Fixes less what the estimate of one second before, extrapolated with its velocity, lets expect, shape (j, 6).

    Position N, E, D (m) and velocity (m/s); the estimates of the receiver's slow errors count to the expectation.
    """
    seen = result.records.row[result.records.is_status("used", "rejected")]
    before_ns = gnss.t_ns[seen] - NS_PER_S
    rows = np.minimum(np.searchsorted(result.t_ns, before_ns), len(result) - 1)
    known = result.t_ns[rows] == before_ns
    rows, seen = rows[known], seen[known]
    ahead = displaced(result.lla[rows], result.v_n[rows], str(result.metadata["ellipsoid"]))
    off = np.column_stack([ned_difference(gnss.lla[seen], ahead), gnss.v_n[seen] - result.v_n[rows]])
    blocks = [state.block for state in result.block_states]
    for first, block in ((0, "gnss_position_error"), (3, "gnss_velocity_error")):
        at = blocks.index(block)
        off[:, first : first + 3] -= result.x[rows, at : at + 3]
    return off


# ---- a step that is let through


@dataclass(frozen=True, eq=False)
class Fault:
    """A step of the fixes: what it does where nothing stops it, and where the chi-square test does.

    Parameters
    ----------
    shift : ndarray, shape (s,)
        North position with the step less that without it, every second from the first fix with the step on, m.
    ratio, chi_square : ndarray, shape (len(AFTER_S),)
        Test values of the position at the epochs of :data:`AFTER_S`.
    refused : ndarray of bool, shape (s,)
        Epochs at which the filter with the chi-square test drops the position.
    guarded : ndarray, shape (s,)
        The shift there.
    """

    shift: Array
    ratio: Array
    chi_square: Array
    refused: NDArray[np.bool_]
    guarded: Array


def fault(plan: Plan, seed: int, index: int) -> Fault:
    """Fly run ``index`` with and without a step of 15 m north from 400 s on."""
    simulated = plan.simulator.run(run_seed(seed, index))
    gnss = simulated.dataset.gnss
    late = gnss.t_ns >= round(STEP_AT_S * NS_PER_S)
    lla = gnss.lla.copy()
    lla[late] = displaced(lla[late], np.tile([STEP_M, 0.0, 0.0], (int(late.sum()), 1)), "wgs84")
    stepped = replace(simulated, dataset=replace(simulated.dataset, gnss=replace(gnss, lla=lla)))
    free, guarded = (plan.config(plan.simulator, outage=True, gates=gates) for gates in (False, True))
    clean, passed = run(free, simulated), run(free, stepped)
    kept = run(guarded, stepped)
    seen = integrity(passed, false_alarm=FALSE_ALARM, reduced=True)
    first = int(np.searchsorted(seen.t_ns, round(STEP_AT_S * NS_PER_S)))
    rows = first + np.array(AFTER_S)
    during = (clean.t_ns >= seen.t_ns[first]) & (clean.t_ns <= seen.t_ns[-1])
    records = kept.records
    refused = records.refused[late & (records.t_ns <= seen.t_ns[-1])] & 0b111 > 0
    return Fault(
        shift=ned_difference(passed.lla[during], clean.lla[during])[:, 0],
        ratio=seen.ratio("position")[rows],
        chi_square=seen.chi_square("position")[rows],
        refused=refused,
        guarded=ned_difference(kept.lla[during], clean.lla[during])[:, 0],
    )


# ---- feedback that waits


@dataclass(frozen=True, eq=False)
class Feedback:
    """One run with feedback at every fix and with rarer ones: samples at the end, by the least time between two, s."""

    unit: Mapping[float, Sample]
    example: Mapping[float, Sample]


def delay(plan: Plan, periods_s: Sequence[float], seed: int, index: int) -> Feedback:
    """Fly run ``index`` with several periods of feedback, with the published unit and that of the example."""

    def flown(simulator: Simulator, periods: Sequence[float]) -> dict[float, Sample]:
        data = simulator.run(run_seed(seed, index))
        out = {}
        for period in periods:
            config = plan.config(simulator, outage=simulator is plan.simulator, feedback_s=period)
            out[period] = sample_run(run(config, data), data, at_s=plan.grid())
        return out

    return Feedback(
        unit=flown(plan.simulator, (0.0, *periods_s)),
        example=flown(plan.example, (0.0, 10.0, EXAMPLE_PERIOD_S, plan.end_s)),
    )


# ---- variations of the closed loop

#: Closed loops that differ in one thing from the usual one.
VARIATIONS: Final = {
    "usual": "usual",
    "bounds": "lower bounds of diag P",
    "dcm": "attitude as DCM, corrected to first order, orthogonalised",
    "picard": "attitude by Picard increments",
    "two-quaternions": "attitude by two quaternions",
}

#: Lower bounds of the publication's kind, as proposed for flight: tilt 2 urad, heading 10 urad, a tenth of the biases.
_BOUNDS: Final[dict[str, Any]] = {
    "floor_attitude_deg": [math.degrees(2e-6), math.degrees(2e-6), math.degrees(1e-5)],
    "floor_velocity_m_s": 2e-3,
    "floor_position_m": 0.3,
    "block": [
        {"kind": "gyro_bias", "unit": "deg/h", "floor_sd": 3e-4},
        {"kind": "accel_bias", "unit": "ug", "floor_sd": 2.5},
        {"kind": "baro_bias", "unit": "m", "floor_sd": 0.1},
        {"kind": "gnss_position_error", "unit": "m", "floor_sd": 0.3},
        {"kind": "gnss_velocity_error", "unit": "m/s", "floor_sd": 2e-3},
    ],
}


def vary(plan: Plan, seed: int, index: int) -> dict[str, Sample]:
    """Fly run ``index`` with every variation of the closed loop."""
    simulated = plan.simulator.run(run_seed(seed, index))
    tables = plan.config(plan.simulator, outage=True).to_dict()
    out = {}
    for name in VARIATIONS:
        change: dict[str, Any] = {}
        if name == "bounds":
            change = _BOUNDS
        elif name != "usual":
            change = {"attitude_form": name}
        config = Config.from_dict({**tables, "filter": {**tables["filter"], **change}})
        out[name] = sample_run(run(config, simulated), simulated, at_s=plan.grid())
    return out


# ---- one flight for the figures


@dataclass(frozen=True, eq=False)
class Realisation:
    """One drawn flight: errors of the filter every second, and its result beside the true sensor errors."""

    simulated: Simulated
    result: Result
    errors: NavErrors


def realise(plan: Plan, seed: int) -> Realisation:
    """Fly run 0 of the set for the figures."""
    simulated = plan.simulator.run(run_seed(seed, 0))
    result = run(plan.config(plan.simulator, outage=True), simulated)
    return Realisation(simulated, result, compare(result, plan.simulator.truth))


def example_errors() -> tuple[float, float]:
    """Gyro drift (rad/s) and accelerometer error (m/s^2) of the example."""
    return EXAMPLE["gyro_deg_h"] * GYRO_BIAS["deg/h"], EXAMPLE["accel_ug"] * ACCEL_BIAS["ug"]
