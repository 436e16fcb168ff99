"""A simulated run as files: the log, the truth, and a configuration that filters it as it was made."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
import tomlkit
from numpy.typing import NDArray

from gnssins import _core
from gnssins.config import Config, preset_names
from gnssins.io import write_gnss, write_imu, write_truth
from gnssins.outputs import make_folder
from gnssins.sim import Scenario, Simulated
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
    """Write ``imu.csv.gz``, ``gnss.csv.gz``, ``ref.csv.gz`` and ``NAME.toml``, which names them.

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
    names = ("imu.csv.gz", "gnss.csv.gz", "ref.csv.gz", f"{scenario.name}.toml")
    return [folder / name for name in names]


def scenario_config(simulated: Simulated) -> dict[str, Any]:
    """Tables of a configuration for a simulated run, without file names.

    The filter is the preset of the name of the scenario if there is one, else one block per simulated error.

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
    if scenario.name in preset_names():
        return {"preset": scenario.name, **equations}
    return {**equations, "block": [_block(error) for error in scenario.imu.error] + _gnss_blocks(scenario)}


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
        sd, tau_s = list(gnss.position_error.sd_m), gnss.position_error.tau_s
        blocks.append(_markov("gnss_position_error", "m", sd, tau_s))
    if gnss.velocity_error is not None:
        sd, tau_s = list(gnss.velocity_error.sd_m_s), gnss.velocity_error.tau_s
        blocks.append(_markov("gnss_velocity_error", "m/s", sd, tau_s))
    return blocks


def _markov(kind: str, unit: str, sd: list[float], tau_s: float) -> dict[str, Any]:
    return {"kind": kind, "process": "gauss_markov", "unit": unit, "sd": sd, "tau_s": tau_s}


def _imu_noise(scenario: Scenario) -> dict[str, Any]:
    arw = [max(v, LEAST_ARW_DEG_SQRT_H) for v in scenario.imu.gyro.arw_deg_sqrt_h]
    vrw = [max(v, LEAST_VRW_M_S_SQRT_H) for v in scenario.imu.accel.vrw_m_s_sqrt_h]
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
