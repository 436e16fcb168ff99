"""Drives of the published car: with GNSS throughout, with seven gaps, with two antennas, before calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.analysis import (
    Ensemble,
    OutageGrowth,
    Parameters,
    Sample,
    outage_growth,
    run_seed,
    sample_run,
)
from gnssins.analysis.states import error_states
from gnssins.config import Config
from gnssins.dataset import TruthTable
from gnssins.result import Result
from gnssins.runner import run
from gnssins.sim import Simulated, Simulator, load_scenario, scenario_from_dict
from gnssins.units import MISALIGNMENT, NS_PER_S, SCALE

__all__ = [
    "PUBLISHED",
    "SCENARIO",
    "SIZES",
    "Coasted",
    "Drive",
    "Force",
    "Plan",
    "Simulators",
    "Sums",
    "coast",
    "drive",
    "growths",
    "sums_of",
    "together",
]

Array = NDArray[np.float64]

SCENARIO: Final = "al-bitar-gavrilov-2019"

#: Rate of the reference that the errors are counted against, Hz.
TRUTH_RATE_HZ: Final = 10.0

#: Components of a misalignment in the order of the scenario: output axis, input axis.
_TERMS: Final = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))

#: One bias per sensor, which is all that a window of some seconds could tell of walk and Markov error.
_ONE_BIAS: Final = (
    {"kind": "gyro_bias", "process": "random_walk", "unit": "deg/s", "initial_sd": 0.02, "walk": 8.3e-5},
    {"kind": "accel_bias", "process": "random_walk", "unit": "mg", "initial_sd": 3.0, "walk": 0.002},
)

#: How many times the made-up matrices of the scenario (per mille) are taken: as they are, and as of raw MEMS sensors.
SIZES: Final = (1.0, 10.0)


def _matrix_states(size: float) -> tuple[dict[str, Any], ...]:
    """Scale factors and cross couplings as states, as uncertain as the made-up ones are large."""
    return tuple(
        {"kind": f"{sensor}_{kind}", "process": "constant", "unit": unit, "initial_sd": size * sd}
        for sensor in ("gyro", "accel")
        for kind, unit, sd in (("scale", "ppm", 1000.0), ("misalignment", "mrad", 0.8))
    )


@dataclass(frozen=True)
class Plan:
    """The experiment.

    Parameters
    ----------
    gaps : sequence of (from, to)
        Times without fixes, s.
    at_s : sequence of float
        Times since the start of a gap that the table has, s.
    after_s : float
        From when on the filter counts as settled.
    changes : mapping
        Keys of ``[scenario]`` to change, such as a shorter ``duration_s``.
    """

    gaps: tuple[tuple[float, float], ...]
    at_s: tuple[float, ...] = (10.0, 20.0, 30.0, 40.0, 50.0, 60.0)
    after_s: float = 200.0
    changes: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def _tables(self) -> dict[str, Any]:
        tables = load_scenario(SCENARIO).model_dump(mode="json", exclude_none=True)
        tables["scenario"] |= self.changes
        return tables

    @property
    def end_s(self) -> float:
        """End of the drive."""
        return float(self._tables["scenario"]["duration_s"])

    @property
    def epochs(self) -> list[float]:
        """Epochs at which errors are kept: every second."""
        return [float(s) for s in range(1, round(self.end_s) + 1)]

    @property
    def gap_ends(self) -> list[float]:
        """Last second of each gap."""
        return [end for _, end in self.gaps]

    def simulator(self, variant: str | None = None) -> Simulator:
        """Drives with fixes throughout: the filter's configuration withholds them."""
        return Simulator(
            scenario_from_dict(self._tables), variant=variant, outages=(), truth_rate_hz=TRUTH_RATE_HZ
        )

    def config(
        self,
        gaps: bool,
        *,
        blocks: Sequence[Mapping[str, Any]] = (),
        imu: Mapping[str, Any] | None = None,
        linearise: bool = False,
    ) -> Config:
        """The published filter; a gap takes in the fix at its end, so that its last second is coasted too."""
        tables = {"preset": SCENARIO, "block": list(blocks)}
        return self._configured(tables, {"kind": "increments", **(imu or {})}, gaps, linearise)

    def one_bias(self, gaps: bool, *, linearise: bool = False) -> Config:
        """A filter with one bias per sensor, 15 states, and the white noise of the published one."""
        noise = {"gyro": {"arw_deg_sqrt_h": 0.15}, "accel": {"noise_density_ug_sqrt_hz": 57.0}}
        return self._configured({"block": list(_ONE_BIAS)}, {"kind": "increments", **noise}, gaps, linearise)

    def _configured(
        self, tables: Mapping[str, Any], imu: Mapping[str, Any], gaps: bool, linearise: bool
    ) -> Config:
        run = {
            "output_rate_hz": 10.0,
            "covariance_interval_s": 1.0,
            "outages": [[begin, end + 0.1] for begin, end in self.gaps] if gaps else [],
            "linearise": linearise,
        }
        return Config.from_dict({"filter": tables, "imu": imu, "run": run})

    def raw(self, size: float = 1.0) -> Simulator:
        """Drives before calibration; the matrices of the scenario taken ``size`` times."""
        tables = {**self._tables, "imu": self._raw_imu(size), "variant": {}}
        return Simulator(scenario_from_dict(tables), outages=(), truth_rate_hz=TRUTH_RATE_HZ)

    def faultless(self) -> Simulator:
        """The same drive without any error to speak of: a filter on it is linearised along the truth."""
        tables = {**self._tables, "imu": {}, "variant": {}}
        tables["gnss"] = {**tables["gnss"], "position_sd_m": 1e-4, "velocity_sd_m_s": 1e-6}
        tables["initial_error"] = {"attitude_sd_deg": 1e-6, "velocity_sd_m_s": 1e-6, "position_sd_m": 1e-4}
        return Simulator(scenario_from_dict(tables), outages=(), truth_rate_hz=TRUTH_RATE_HZ)

    def calibration(self, size: float = 1.0) -> dict[str, Any]:
        """``[imu.gyro]`` and ``[imu.accel]`` with the matrices S = K + G of these drives."""
        found = {}
        for sensor in ("gyro", "accel"):
            s = np.zeros((3, 3))
            for error in self._raw_imu(size)["error"]:
                if error["kind"] == f"{sensor}_scale":
                    s[range(3), range(3)] = np.array(error["value"]) * SCALE[error["unit"]]
                elif error["kind"] == f"{sensor}_misalignment":
                    s[tuple(zip(*_TERMS, strict=True))] = (
                        np.array(error["value"]) * MISALIGNMENT[error["unit"]]
                    )
            found[sensor] = {"matrix": s.tolist()}
        return found

    def _raw_imu(self, size: float) -> dict[str, Any]:
        imu: dict[str, Any] = self._tables["variant"]["raw"]["imu"]
        errors = [{**e, "value": [size * v for v in e["value"]]} if "value" in e else e for e in imu["error"]]
        return {**imu, "error": errors}

    @cached_property
    def force(self) -> Force:
        """Specific force along the drive."""
        return Force.of(self.simulator().truth)


#: The published number and length of gaps; when they begin is not printed.
PUBLISHED: Final = Plan(gaps=tuple((200.0 + 95.0 * i, 260.0 + 95.0 * i) for i in range(7)))


@dataclass(frozen=True, eq=False)
class Force:
    """Specific force and acceleration along a motion, without sensor errors; k epochs.

    Parameters
    ----------
    time_s : ndarray, shape (k,)
        Epochs, s.
    size : ndarray, shape (k,)
        Magnitude |f|, m/s^2.
    accel : ndarray, shape (k,)
        Of the acceleration over the ground, m/s^2: what |f| has beside gravity. A heading error shows in the velocity
        only if there is any.
    """

    time_s: Array
    size: Array
    accel: Array

    @classmethod
    def of(cls, truth: TruthTable) -> Force:
        """From the change of velocity; Coriolis terms, 2e-3 m/s^2 here, left out."""
        t_s = truth.t_ns / NS_PER_S
        lat, height = (np.ascontiguousarray(truth.lla[:, i]) for i in (0, 2))
        accel = np.gradient(truth.v_n, t_s, axis=0)
        f_n = accel - _core.gravity_n(lat, height, "wgs84")
        return cls(t_s, np.linalg.norm(f_n, axis=1), np.linalg.norm(accel, axis=1))

    def first_straight(self) -> tuple[float, float]:
        """Times (s) between the end of the first acceleration and the begin of the next one, a second off both."""
        moving = int(np.argmax(self.accel > 0.5))
        even = self.accel < 1e-3
        begin = moving + int(np.argmax(even[moving:]))
        end = begin + int(np.argmax(~even[begin:]))
        return float(np.ceil(self.time_s[begin])) + 1.0, float(np.floor(self.time_s[end])) - 1.0

    def rms(self, from_s: Array, to_s: Array) -> Array:
        """Root mean square of the acceleration over spans, shape (m,)."""
        sums = np.concatenate([[0.0], np.cumsum(self.accel**2)])
        low, high = np.searchsorted(self.time_s, from_s), np.searchsorted(self.time_s, to_s, side="right")
        return np.asarray(np.sqrt((sums[high] - sums[low]) / np.maximum(high - low, 1)))


@dataclass(frozen=True, eq=False)
class Sums:
    """Errors of walk + Markov error, which alone act on the navigation errors: gyro x, y, z, accelerometer x, y, z.

    Parameters
    ----------
    error, sigma : ndarray, shape (epochs, 6)
        Estimate minus truth, and what the filter claims; rad/s, m/s^2.
    """

    error: Array
    sigma: Array


@dataclass(frozen=True, eq=False)
class Drive:
    """What one simulated drive leaves behind.

    Parameters
    ----------
    whole, gaps : Sample
        Filter with GNSS throughout and with the gaps, every second.
    sums : Sums
        Biases of the filter with GNSS throughout, every second.
    distance : ndarray, shape (2, epochs)
        E_xyz (m) of both, every second.
    coasted : mapping of str to Coasted
        What each filter made of the gaps: ``"published"``; ``"heading"`` of two antennas taken too; ``"calibrated 1"``,
        ``"uncalibrated 1"``, ``"states 1"``: sensors before calibration, their matrices taken off, left out or
        estimated; the same with 10.
    first_nis : ndarray, shape (gaps,)
        NIS of the first fix after each gap.
    """

    whole: Sample
    gaps: Sample
    sums: Sums
    coasted: Mapping[str, Coasted]
    first_nis: Array


@dataclass(frozen=True, eq=False)
class Coasted:
    """One filter in the gaps of one drive.

    Parameters
    ----------
    growth : OutageGrowth
        Growth of its errors.
    nees : ndarray, shape (gaps,)
        NEES of the nine navigation states in the last second of each gap.
    """

    growth: OutageGrowth
    nees: Array


@dataclass(frozen=True, eq=False)
class Simulators:
    """The kinds of drives; their random numbers are the same."""

    plain: Simulator
    dual: Simulator
    raw: Mapping[float, Simulator]

    @classmethod
    def of(cls, plan: Plan) -> Simulators:
        """Make them."""
        raw = {size: plan.raw(size) for size in SIZES}
        return cls(plan.simulator(), plan.simulator("dual-antenna"), raw)


def drive(plan: Plan, simulators: Simulators, seed: int, index: int) -> Drive:
    """Simulate drive ``index`` and filter it in every way."""
    number = run_seed(seed, index)
    simulated = simulators.plain.run(number)
    whole = run(plan.config(False), simulated)
    gaps = run(plan.config(True), simulated)
    samples = [
        sample_run(
            result,
            simulated,
            at_s=plan.epochs,
            windows=[(plan.after_s, np.inf)],
            after_s=plan.after_s,
        )
        for result in (whole, gaps)
    ]
    sums = sums_of(whole, simulated, plan.epochs)
    coasted = {"published": coast(plan, gaps, simulated)}
    simulated = simulators.dual.run(number)
    coasted["heading"] = coast(plan, run(plan.config(True), simulated), simulated)
    for size, simulator in simulators.raw.items():
        simulated = simulator.run(number)
        for name, config in (
            ("calibrated", plan.config(True, imu=plan.calibration(size))),
            ("uncalibrated", plan.config(True)),
            ("states", plan.config(True, blocks=_matrix_states(size))),
        ):
            coasted[f"{name} {size:g}"] = coast(plan, run(config, simulated), simulated)
    return Drive(samples[0], samples[1], sums, coasted, _first_nis(gaps, plan))


def coast(plan: Plan, result: Result, simulated: Simulated) -> Coasted:
    """Growth of the errors in the gaps, and NEES where they end."""
    truth = simulated.truth
    growth = outage_growth(result, truth, plan.gaps, at_s=plan.at_s, reference="the truth")
    found = error_states(result, truth, Parameters.of(simulated))
    rows = np.searchsorted(found.t_ns, np.rint(np.array(plan.gap_ends) * NS_PER_S).astype(np.int64))
    return Coasted(growth, found.nees(found.groups["navigation"])[rows])


def sums_of(result: Result, simulated: Simulated, epochs: Sequence[float]) -> Sums:
    """Errors of the sums of walk and Markov error at covariance snapshots."""
    found = error_states(result, simulated.truth, Parameters.of(simulated))
    rows = np.searchsorted(found.t_ns, np.rint(np.asarray(epochs) * NS_PER_S).astype(np.int64))
    x, p = -found.x[rows], found.matrix[rows]
    error, variance = [], []
    for sensor in ("gyro", "accel"):
        walk, markov = found.groups[f"{sensor}_walk"], found.groups[f"{sensor}_drift"]
        error.append(x[:, walk] + x[:, markov])
        variance.append(p[:, walk, walk] + p[:, markov, markov] + 2.0 * p[:, walk, markov])
    return Sums(np.concatenate(error, axis=1), np.sqrt(np.concatenate(variance, axis=1)))


def _first_nis(result: Result, plan: Plan) -> Array:
    """NIS of the first fix that was compared after each gap, shape (gaps,)."""
    records = result.records
    seen = records.is_status("used", "rejected")
    first = [np.flatnonzero(seen & (records.t_ns > round(end * NS_PER_S)))[0] for end in plan.gap_ends]
    return np.asarray(records.nis[np.asarray(first)])


def growths(drives: Sequence[Drive]) -> dict[str, OutageGrowth]:
    """Growth in the gaps of all drives, by filter."""
    return {
        name: OutageGrowth.combine([d.coasted[name].growth for d in drives]) for name in drives[0].coasted
    }


def together(drives: Sequence[Drive], seed: int) -> tuple[Ensemble, Ensemble]:
    """Ensembles of the drives with GNSS throughout and with the gaps."""
    return Ensemble.of([d.whole for d in drives], seed), Ensemble.of([d.gaps for d in drives], seed)
