"""A simulated run as files: the log, the truth, and a configuration that filters it as it was made."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import tomlkit
from numpy.typing import NDArray

from gnssins import _core, units
from gnssins.config import Config, preset_names
from gnssins.io import write_baro, write_gnss, write_heading, write_imu, write_truth
from gnssins.outputs import make_folder
from gnssins.sim import Scenario, Simulated, load_scenario, scenario_names
from gnssins.sim.aid_config import CorrelatedPosition, CorrelatedVelocity
from gnssins.sim.sensor_config import ImuError
from gnssins.storage import write_atomic

__all__ = ["matching_filter", "output_files", "scenario_config", "write_simulation"]

Array = NDArray[np.float64]

#: Noise that the filter assumes where the scenario has none: a filter must not believe in a perfect sensor.
LEAST_ARW_DEG_SQRT_H: Final = 1e-4
LEAST_VRW_M_S_SQRT_H: Final = 1e-4

_HEAD: Final = """\
# Filter configuration for a simulated log: {name}, seed {seed}.
# Sensor errors, noise and the accuracy of the start are those of the simulation.
# Run it with: gnssins run {file}

"""


def write_simulation(simulated: Simulated, folder: str | Path) -> list[str]:
    """Write ``imu.csv.gz``, ``ref.csv.gz``, one file per aid and ``NAME.toml``, which names them.

    Parameters
    ----------
    simulated : Simulated
        What to write.
    folder : str or Path
        Made if absent.

    Returns
    -------
    list of str
        The files, the configuration last.
    """
    target = make_folder(Path(folder))
    data, files = simulated.dataset, {"imu": "imu.csv.gz"}
    write_imu(target / files["imu"], data.imu)
    if len(data.gnss):
        files["gnss"] = "gnss.csv.gz"
        write_gnss(target / files["gnss"], data.gnss)
    if len(data.baro):
        files["baro"] = "baro.csv.gz"
        write_baro(target / files["baro"], data.baro)
    if len(data.heading):
        files["heading"] = "heading.csv.gz"
        write_heading(target / files["heading"], data.heading)
    if data.truth is not None:
        files["truth"] = "ref.csv.gz"
        write_truth(target / files["truth"], data.truth)
    tables = scenario_config(simulated)
    for section, name in files.items():
        tables.setdefault(section, {})["file"] = name
    # refuses what the reader would refuse
    Config.from_dict(tables, base=target)
    name = f"{simulated.scenario.name}.toml"
    head = _HEAD.format(name=simulated.scenario.name, seed=simulated.seed, file=name)
    text = head + tomlkit.dumps(tables)
    write_atomic(target / name, lambda path: path.write_text(text, encoding="utf-8"))
    return [str(target / file) for file in (*files.values(), name)]


def output_files(scenario: Scenario, folder: Path) -> list[Path]:
    """Every file that :func:`write_simulation` may write for a scenario."""
    names = [
        "imu.csv.gz",
        "gnss.csv.gz",
        "baro.csv.gz",
        "heading.csv.gz",
        "ref.csv.gz",
        f"{scenario.name}.toml",
    ]
    return [folder / name for name in names]


def scenario_config(simulated: Simulated) -> dict[str, Any]:
    """Tables of a configuration for a simulated run, without file names.

    The filter is the preset of the name of the scenario if there is one and the sensors are those that it is for, else
    one block per simulated error.

    Parameters
    ----------
    simulated : Simulated
        What is to be filtered.

    Returns
    -------
    dict
        For :meth:`gnssins.Config.from_dict`.
    """
    scenario = simulated.scenario
    tables: dict[str, Any] = {
        "version": 1,
        "imu": {"kind": simulated.dataset.imu.kind, **_imu_noise(scenario)},
        "filter": matching_filter(scenario),
        "initial": _initial(simulated),
    }
    if "preset" in tables["filter"]:
        tables["imu"] = {"kind": simulated.dataset.imu.kind}
    if scenario.gnss is not None:
        gnss = scenario.gnss
        use = "both" if gnss.position_sd_m and gnss.velocity_sd_m_s else "position"
        use = use if gnss.position_sd_m else "velocity"
        tables["gnss"] = {"use": use, "lever_ba_b_m": list(gnss.lever_ba_b_m), "latency_ms": gnss.latency_ms}
    if scenario.baro is not None:
        tables["baro"] = {"latency_ms": scenario.baro.latency_ms}
    if scenario.heading is not None:
        tables["heading"] = {"latency_ms": scenario.heading.latency_ms}
    return tables


def matching_filter(scenario: Scenario) -> dict[str, Any]:
    """Section ``filter`` that models the errors of a scenario."""
    truth = scenario.truth
    equations = {
        "model": truth.model,
        "ellipsoid": truth.ellipsoid,
        "gravity": truth.gravity,
        "coning": truth.coning,
    }
    if scenario.name in preset_names() and _has_packaged_sensors(scenario):
        return {"preset": scenario.name, **equations}
    aids = _baro_blocks(scenario) + _gnss_blocks(scenario)
    return {**equations, "block": [_block(error) for error in scenario.imu.error] + aids}


def _has_packaged_sensors(scenario: Scenario) -> bool:
    """Tell whether IMU, receiver and altimeter are those of the packaged scenario of this name, outages aside."""
    if scenario.name not in scenario_names():
        return True
    packaged = load_scenario(scenario.name)
    receivers = [
        None if gnss is None else gnss.model_copy(update={"outages": ()})
        for gnss in (scenario.gnss, packaged.gnss)
    ]
    return scenario.imu == packaged.imu and receivers[0] == receivers[1] and scenario.baro == packaged.baro


def _block(error: ImuError) -> dict[str, Any]:
    """One filter block of one simulated error."""
    block: dict[str, Any] = {
        "kind": error.kind,
        "name": error.block_name,
        "process": error.process,
        "unit": error.unit,
    }
    if error.process == "gauss_markov":
        return {**block, "sd": _plain(error.sd), "tau_s": error.tau_s}
    if error.process == "random_walk":
        start = error.initial_sd if error.initial_sd is not None else error.walk
        return {**block, "initial_sd": _plain(start), "walk": _plain(error.walk)}
    if error.initial_sd is not None:
        return {**block, "initial_sd": _plain(error.initial_sd)}
    # a fixed error: as uncertain as it is large
    values = np.abs(np.broadcast_to(np.asarray(error.value, dtype=np.float64), (error.size,)))
    return {**block, "initial_sd": np.maximum(values, 0.1 * max(values.max(), 1e-3)).tolist()}


def _baro_blocks(scenario: Scenario) -> list[dict[str, Any]]:
    """Block of the bias of the altimeter."""
    baro = scenario.baro
    if baro is None or not (baro.bias_initial_sd_m or baro.bias_walk_m_sqrt_s):
        return []
    start = max(baro.bias_initial_sd_m, 1e-3)
    if not baro.bias_walk_m_sqrt_s:
        return [{"kind": "baro_bias", "process": "constant", "unit": "m", "initial_sd": start}]
    walk = {"initial_sd": start, "walk": baro.bias_walk_m_sqrt_s}
    return [{"kind": "baro_bias", "process": "random_walk", "unit": "m", **walk}]


def _gnss_blocks(scenario: Scenario) -> list[dict[str, Any]]:
    """Blocks of the lever arm and of the correlated errors of the receiver."""
    gnss = scenario.gnss
    blocks: list[dict[str, Any]] = []
    if gnss is None:
        return []
    if any(gnss.lever_error_sd_m):
        sd = [max(v, 1e-4) for v in gnss.lever_error_sd_m]
        blocks.append({"kind": "gnss_lever_arm", "process": "constant", "unit": "m", "initial_sd": sd})
    if gnss.position_error is not None:
        slow = gnss.position_error
        blocks.append(_markov("gnss_position_error", "m", slow, slow.sd_m, slow.jump_sd_m))
    if gnss.velocity_error is not None:
        fast = gnss.velocity_error
        blocks.append(_markov("gnss_velocity_error", "m/s", fast, fast.sd_m_s, fast.jump_sd_m_s))
    return blocks


def _markov(
    kind: str,
    unit: str,
    error: CorrelatedPosition | CorrelatedVelocity,
    sd: Sequence[float],
    jump_sd: Sequence[float],
) -> dict[str, Any]:
    """One block of a correlated error of the receiver."""
    block: dict[str, Any] = {"kind": kind, "process": "gauss_markov", "unit": unit, "sd": list(sd)}
    block["tau_s"] = error.tau_s
    if error.distance_m is not None:
        block["distance_m"] = error.distance_m
    if any(jump_sd):
        block["jump_sd"] = list(jump_sd)
    return block


def _imu_noise(scenario: Scenario) -> dict[str, Any]:
    gyro = scenario.imu.gyro.density / units.DEG_SQRT_H_TO_RAD_SQRT_S
    accel = scenario.imu.accel.density / units.M_S_SQRT_H_TO_M_S_SQRT_S
    arw = np.maximum(gyro, LEAST_ARW_DEG_SQRT_H).tolist()
    vrw = np.maximum(accel, LEAST_VRW_M_S_SQRT_H).tolist()
    return {"gyro": {"arw_deg_sqrt_h": arw}, "accel": {"vrw_m_s_sqrt_h": vrw}}


def _initial(simulated: Simulated) -> dict[str, Any]:
    """Section ``initial``: the drawn start of the simulation and its standard deviations."""
    start = simulated.initial
    roll, pitch, heading = np.degrees(_core.quat_to_euler(start.q_nb[None])[0])
    north, east, down = np.maximum(np.degrees(start.sd_phi), 1e-6)
    level = float(max(north, east))
    return {
        "position": {
            "lat_deg": float(np.degrees(start.lla[0])),
            "lon_deg": float(np.degrees(start.lla[1])),
            "height_m": float(start.lla[2]),
        },
        "velocity": start.v_n.tolist(),
        "roll_deg": float(roll),
        "pitch_deg": float(pitch),
        "heading_deg": float(heading),
        "position_sd_m": np.maximum(start.sd_p, 1e-3).tolist(),
        "velocity_sd_m_s": np.maximum(start.sd_v, 1e-4).tolist(),
        "roll_sd_deg": level,
        "pitch_sd_deg": level,
        "heading_sd_deg": float(down),
    }


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
