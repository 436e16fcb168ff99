"""What all runs of a Monte Carlo share, as the compiled core takes it: truth, sensors, filter, epochs of comparison."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.alignment import InitialState
from gnssins.config import Config
from gnssins.config.filter import BLOCK_SIZES
from gnssins.dataset import BaroTable, Dataset, GnssTable, HeadingTable, ImuTable
from gnssins.errors import ConfigError
from gnssins.feed import Cut, cut_tables, refuse_outside
from gnssins.sim import Scenario, Simulator, Trajectory, scenario_from_dict
from gnssins.sim.aiding import antenna_ecef, change_marks, fix_times, in_sight, white_sd
from gnssins.sim.receiver_errors import change_rows, fading
from gnssins.sim.sensor_config import AccelSensor, GyroSensor, ImuError
from gnssins.units import DEG_TO_RAD, NS_PER_S, STANDARD_GRAVITY_M_S2, ms_to_ns

__all__ = ["Group", "Job", "Prepared", "nominal_dataset", "nominal_start", "prepare", "truth_columns"]

Array = NDArray[np.float64]
Times = NDArray[np.int64]

#: Intervals between epochs of comparison and of the covariance if the configuration gives none, ns.
ERRORS_EVERY_NS: Final = NS_PER_S
NEES_EVERY_NS: Final = 10 * NS_PER_S

_NAVIGATION: Final = {
    "navigation": list(range(9)),
    "attitude": [0, 1, 2],
    "velocity": [3, 4, 5],
    "position": [6, 7, 8],
}
_SOURCES: Final = ("gnss", "baro", "heading")


@dataclass(frozen=True)
class Job:
    """A Monte Carlo as plain text and numbers: what a worker elsewhere needs, and a stored sweep must agree with."""

    scenario: str
    outages: tuple[tuple[float, float], ...]
    config: str
    seed: int
    covariance: Literal["full", "shared"]
    after_s: float

    @classmethod
    def of(
        cls,
        simulator: Simulator,
        config: Config,
        seed: int,
        covariance: Literal["full", "shared"],
        after_s: float,
    ) -> Job:
        """Write down a simulator and a configuration."""
        scenario = json.dumps(simulator.scenario.model_dump(mode="json", exclude_none=True))
        tables = config.to_dict()
        return cls(scenario, simulator.outages, json.dumps(tables), seed, covariance, after_s)

    def prepared(self) -> Prepared:
        """Prepare the core; kept for the next range of the same job."""
        return _prepared(self)


@dataclass(frozen=True)
class Group:
    """States whose NEES is taken together."""

    name: str
    index: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Prepared:
    """The core with all that runs share, and what its sums mean."""

    core: _core.MonteCarlo
    rows: int
    groups: tuple[Group, ...]
    nees_t_ns: Times
    gaps_s: tuple[tuple[float, float], ...]


@lru_cache(maxsize=2)
def _prepared(job: Job) -> Prepared:
    scenario = scenario_from_dict(json.loads(job.scenario))
    simulator = Simulator(scenario, outages=job.outages)
    return prepare(simulator, Config.from_dict(json.loads(job.config)), job)


def prepare(simulator: Simulator, config: Config, job: Job) -> Prepared:
    """Prepare the core for a simulator whose truth may be there already; arguments as written down in ``job``.

    Raises
    ------
    ConfigError
        ``config.monte_carlo_start``: the filter would start later than the simulation.
    """
    path, scenario = simulator.trajectory, simulator.scenario
    start = nominal_start(simulator)
    engine = config.engine_config(start.to_engine())
    engine["imu"]["input"] = "increments"
    data = nominal_dataset(simulator)
    cut = cut_tables(config, data, engine)
    if cut.imu_first > 0:
        raise ConfigError(
            "config.monte_carlo_start",
            f"[run] start_s = {config.run.start_s:g}: a Monte Carlo starts with the simulation, at 0 s",
            "leave start_s out, and give after_s to count errors after the start",
            {"start_s": config.run.start_s},
        )
    rows = len(cut.imu)
    refuse_outside(config, start.t_ns, int(path.t_ns[rows]))
    windows = config.run.outages or simulator.outages
    truths, groups = _states(scenario, engine["blocks"])
    epochs = _epochs(path, rows, engine["output"], config)
    spec = {
        "seed": job.seed,
        "shared": job.covariance == "shared",
        "ecef": path.model == "ecef",
        "ellipsoid": path.ellipsoid,
        "rows": rows,
        "after_ns": round(job.after_s * NS_PER_S),
        "gyro": _triad(scenario.imu.gyro),
        "accel": _triad(scenario.imu.accel),
        "errors": [_error(error) for error in scenario.imu.error],
        "gnss": _gnss_spec(path, scenario, config),
        "baro": _baro_spec(scenario),
        "heading_sd": scenario.heading.heading_sd_deg * DEG_TO_RAD if scenario.heading else 0.0,
        "truths": truths,
        "groups": [group.index for group in groups],
        "gaps_ns": [[round(t * NS_PER_S) for t in window] for window in windows],
    }
    columns = {
        "t_ns": path.t_ns,
        "dtheta": path.dtheta,
        "dvel": path.dvel,
        **epochs,
        **_feed(simulator, cut, engine),
        **_gnss_columns(path, scenario),
        **_scalar_columns(path, scenario),
    }
    core = _core.MonteCarlo(json.dumps(engine), json.dumps(spec), columns)
    nees_rows = epochs["epoch_row"][(epochs["epoch_kind"] & 2) != 0]
    return Prepared(core, rows, groups, path.t_ns[nees_rows], tuple(windows))


def nominal_start(simulator: Simulator) -> InitialState:
    """Give the true state at the start, as uncertain as the scenario says."""
    path, figures = simulator.trajectory, simulator.scenario.initial_error
    sds = [np.asarray(sd) for sd in (figures.attitude_sd_rad, figures.velocity_sd_m_s, figures.position_sd_m)]
    return InitialState(int(path.t_ns[0]), path.lla[0], path.v_n[0], path.q_nb[0], *sds)


def nominal_dataset(simulator: Simulator) -> Dataset:
    """Tables with the stamps, marks and variances of a run; fixes and headings without their values."""
    path, scenario = simulator.trajectory, simulator.scenario
    gnss, baro, heading = GnssTable.empty(), BaroTable.empty(), HeadingTable.empty()
    if scenario.gnss is not None:
        t_ns = fix_times(path, scenario.gnss)
        seen = in_sight(t_ns, simulator.outages)
        rows = np.zeros((int(seen.sum()), 3))
        gnss = GnssTable(
            (t_ns + ms_to_ns(scenario.gnss.latency_ms))[seen],
            rows,
            rows,
            np.square(white_sd(scenario.gnss, t_ns)[seen]),
            change_marks(scenario.gnss, t_ns[seen]),
        )
    if scenario.baro is not None:
        t_ns = fix_times(path, scenario.baro)
        stamps = t_ns + ms_to_ns(scenario.baro.latency_ms)
        baro = BaroTable(stamps, np.zeros(len(t_ns)), np.full(len(t_ns), scenario.baro.height_sd_m**2))
    if scenario.heading is not None:
        t_ns = fix_times(path, scenario.heading)
        seen = in_sight(t_ns, simulator.outages)
        stamps = (t_ns + ms_to_ns(scenario.heading.latency_ms))[seen]
        var = (scenario.heading.heading_sd_deg * DEG_TO_RAD) ** 2
        heading = HeadingTable(stamps, np.zeros(len(stamps)), np.full(len(stamps), var))
    imu = ImuTable(path.t_ns[1:], path.dtheta[1:], path.dvel[1:], "increments")
    return Dataset(imu, gnss, simulator.truth, meta={}, baro=baro, heading=heading)


def truth_columns(scenario: Scenario) -> dict[str, range]:
    """Columns of the true sensor errors in the core, by name of the filter block, in its order."""
    columns, at = {}, 0
    for error in scenario.imu.error:
        columns[error.block_name] = range(at, at + error.size)
        at += error.size
    gnss, baro = scenario.gnss, scenario.baro
    if gnss is not None and any(gnss.lever_error_sd_m):
        columns["gnss_lever_arm"] = range(at, at + 3)
    if gnss is not None and gnss.position_error is not None:
        columns["gnss_position_error"] = range(at + 3, at + 6)
    if gnss is not None and gnss.velocity_error is not None:
        columns["gnss_velocity_error"] = range(at + 6, at + 9)
    if baro is not None and (baro.bias_initial_sd_m > 0.0 or baro.bias_walk_m_sqrt_s > 0.0):
        columns["baro_bias"] = range(at + 9, at + 10)
    return columns


def _states(
    scenario: Scenario, blocks: list[Mapping[str, Any]]
) -> tuple[list[int | None], tuple[Group, ...]]:
    """Column of the true error of each block state, and the groups of states that are known."""
    known = truth_columns(scenario)
    truths: list[int | None] = []
    groups: dict[str, list[int]] = {}
    for block in blocks:
        size, columns = BLOCK_SIZES[block["kind"]], known.get(block["name"], range(0))
        first = 9 + len(truths)
        if len(columns) == size:
            groups[block["name"]] = list(range(first, first + size))
            truths += columns
        else:
            truths += [None] * size
    every = {} if None in truths or not truths else {"all": list(range(9 + len(truths)))}
    named = {**every, **_NAVIGATION, **groups}
    return truths, tuple(Group(name, tuple(index)) for name, index in named.items())


def _epochs(path: Trajectory, rows: int, output: Mapping[str, int], config: Config) -> dict[str, Any]:
    """Epochs of the truth at which errors (1) and covariance (2) are looked at."""
    t_ns = path.t_ns[1 : rows + 1]

    def due(interval_ns: int) -> NDArray[np.bool_]:
        # the first row, and then the first one of each multiple, as in the engine
        cell = t_ns // interval_ns
        return np.concatenate([[True], np.diff(cell) != 0])

    errors = due(ERRORS_EVERY_NS if config.run.output_rate_hz is None else max(output["interval_ns"], 1))
    nees = due(output["covariance_interval_ns"] or NEES_EVERY_NS)
    at = np.flatnonzero(errors | nees)
    row = at + 1
    return {
        "epoch_row": row.astype(np.int64),
        "epoch_kind": errors[at].astype(np.int64) + 2 * nees[at].astype(np.int64),
        "epoch_lla": path.lla[row],
        "epoch_v_n": path.v_n[row],
        "epoch_q_nb": path.q_nb[row],
    }


def _feed(simulator: Simulator, cut: Cut, engine: Mapping[str, Any]) -> dict[str, Times]:
    """What the filter gets of the aids, in the order of validity: GNSS first where times are equal."""
    path, scenario = simulator.trajectory, simulator.scenario
    parts = []
    for number, name in enumerate(_SOURCES):
        aid, table = getattr(scenario, name), getattr(cut, name)
        if aid is None:
            continue
        seen = in_sight(fix_times(path, aid), simulator.outages if name != "baro" else ())
        rows = cut.fed if name == "gnss" else cut.aid_rows[name]
        new = getattr(table, "new_constellation", None)
        new = np.zeros(len(rows), dtype=np.int64) if new is None else new.astype(np.int64)
        valid = table.t_ns - engine[name]["latency_ns"]
        source = np.full(len(rows), number, dtype=np.int64)
        parts.append(np.column_stack([valid, source, np.flatnonzero(seen)[rows], table.t_ns, new]))
    joined = np.concatenate([np.zeros((0, 5), dtype=np.int64), *parts])
    joined = joined[np.argsort(joined[:, 0], kind="stable")]
    names = ("feed_source", "feed_index", "feed_t_ns", "feed_new")
    return {name: np.ascontiguousarray(joined[:, i]) for i, name in enumerate(names, start=1)}


def _triad(sensor: GyroSensor | AccelSensor) -> dict[str, Any]:
    """Noise, range and resolution in SI."""
    if isinstance(sensor, GyroSensor):
        scale, lsb = (sensor.range_deg_s, DEG_TO_RAD), (sensor.increment_lsb_arcsec, DEG_TO_RAD / 3600.0)
    else:
        scale, lsb = (sensor.range_g, STANDARD_GRAVITY_M_S2), (sensor.increment_lsb_mm_s, 1e-3)
    full_scale, resolution = (None if v is None else v * unit for v, unit in (scale, lsb))
    return {
        "density": list(sensor.density),
        "bandwidth_hz": sensor.bandwidth_hz,
        "full_scale": full_scale,
        "lsb": resolution,
    }


def _error(error: ImuError) -> dict[str, Any]:
    """Law of one slowly varying error in SI."""
    figures = {key: error.si(key).tolist() for key in ("value", "initial_sd", "walk", "sd")}
    return {
        "kind": error.kind,
        "name": error.block_name,
        "process": error.process,
        "tau_s": error.tau_s,
        **figures,
    }


def _gnss_spec(path: Trajectory, scenario: Scenario, config: Config) -> dict[str, Any]:
    gnss, uses = scenario.gnss, [config.gnss.uses_position, config.gnss.uses_velocity]
    if gnss is None:
        return {"uses": uses, "lever_sd": [0.0, 0.0, 0.0], "slow": [None, None], "changes": []}
    position, velocity = gnss.position_error, gnss.velocity_error
    slow = [
        position and {"sd": position.sd_m, "jump_sd": position.jump_sd_m},
        velocity and {"sd": velocity.sd_m_s, "jump_sd": velocity.jump_sd_m_s},
    ]
    changes = change_rows(fix_times(path, gnss), gnss.constellation_changes).tolist()
    return {"uses": uses, "lever_sd": gnss.lever_error_sd_m, "slow": slow, "changes": changes}


def _gnss_columns(path: Trajectory, scenario: Scenario) -> dict[str, Any]:
    """True motion of the antenna at all fixes, with what a metre of lever arm adds, and their noise."""
    gnss = scenario.gnss
    if gnss is None:
        none = np.zeros((0, 3))
        keys = ("gnss_position", "gnss_velocity", "gnss_sd_position", "gnss_sd_velocity")
        return {"gnss_t_ns": np.zeros(0, dtype=np.int64), **dict.fromkeys(keys, none)}
    t_ns, lever = fix_times(path, gnss), np.asarray(gnss.lever_ba_b_m, dtype=np.float64)
    position, velocity = antenna_ecef(path, t_ns, lever)
    sd = white_sd(gnss, t_ns)
    columns = {
        "gnss_t_ns": t_ns,
        "gnss_position": position,
        "gnss_velocity": velocity,
        "gnss_sd_position": sd[:, :3].copy(),
        "gnss_sd_velocity": sd[:, 3:].copy(),
    }
    if any(gnss.lever_error_sd_m):
        # both are linear in the lever arm
        moved = [antenna_ecef(path, t_ns, lever + axis) for axis in np.eye(3)]
        columns["lever_position"] = np.stack([p - position for p, _ in moved], axis=2)
        columns["lever_velocity"] = np.stack([v - velocity for _, v in moved], axis=2)
    for name, slow in (("position", gnss.position_error), ("velocity", gnss.velocity_error)):
        if slow is not None:
            columns[f"growth_{name}"] = fading(path, slow)
    return columns


def _baro_spec(scenario: Scenario) -> dict[str, float]:
    baro = scenario.baro
    if baro is None:
        return {"sd": 0.0, "initial_sd": 0.0, "walk": 0.0}
    return {
        "sd": baro.height_sd_m,
        "initial_sd": baro.bias_initial_sd_m,
        "walk": baro.bias_walk_m_sqrt_s,
    }


def _scalar_columns(path: Trajectory, scenario: Scenario) -> dict[str, Any]:
    """True heights and headings at all values of their aids."""
    none = np.zeros(0, dtype=np.int64)
    baro_t_ns = fix_times(path, scenario.baro) if scenario.baro is not None else none
    heading_t_ns = fix_times(path, scenario.heading) if scenario.heading is not None else none
    return {
        "baro_t_ns": baro_t_ns,
        "baro_height": np.interp(baro_t_ns, path.t_ns, path.lla[:, 2]),
        "heading_rad": np.interp(heading_t_ns, path.t_ns, np.unwrap(path.rpy[:, 2])),
    }
