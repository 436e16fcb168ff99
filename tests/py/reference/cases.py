"""The golden runs: configuration, sensor data and fixes of each."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import scenario
from .attitude import quat_to_euler
from .strapdown import NavState

Array = NDArray[Any]
DEG_H = np.pi / 180.0 / 3600.0
MILLI_G = 9.80665e-3
ARCMIN = np.pi / 180.0 / 60.0


def block(
    kind: str, process: str, initial_sd: float, size: int = 3, name: str = "", **extra: float
) -> dict[str, Any]:
    """One block of the engine configuration; psd, sd and tau_s are the same for all its states."""
    out: dict[str, Any] = {"kind": kind, "name": name or kind, "process": process}
    out |= {"initial_sd": [initial_sd] * size, "initial": [0.0] * size}
    return out | {key: [value] * size for key, value in extra.items()}


def config(start: NavState, blocks: list[dict[str, Any]], **change: Any) -> dict[str, Any]:
    """Engine configuration with the start at an estimate; `change` replaces keys of its tables."""
    out: dict[str, Any] = {
        "model": "ned",
        "ellipsoid": "wgs84",
        "gravity": "normal",
        "coning": "two-sample",
        "phi_order": 3,
        "imu": {
            "input": "increments",
            "gyro_psd": [0.0] * 3,
            "accel_psd": [0.0] * 3,
            "gyro_range": None,
            "accel_range": None,
            "max_gap_ns": 50_000_000,
            "on_gap": "stop",
            "on_backwards": "stop",
            "max_bad_share": 0.01,
            "gyro_bias": [0.0] * 3,
            "accel_bias": [0.0] * 3,
            "gyro_matrix": [[0.0] * 3] * 3,
            "accel_matrix": [[0.0] * 3] * 3,
        },
        "blocks": blocks,
        "gnss": {"lever_b_m": [0.0] * 3, "latency_ns": 0, "gate_probability": None},
        "output": {"interval_ns": 0, "covariance_interval_ns": 1_000_000_000},
        "initial": {
            "t_ns": 0,
            "lat_rad": start.lat,
            "lon_rad": start.lon,
            "height_m": start.h,
            "v_n": start.v.tolist(),
            "q_nb": start.q.tolist(),
        },
    }
    for table, values in change.items():
        out[table] |= values
    return out


def _record(
    truth: scenario.Truth, gyro: Array, accel: Array, pos: Array, vel: Array, var: Array
) -> tuple[Any, Any]:
    imu = {"t_ns": np.arange(scenario.STEPS + 1) * scenario.DT_NS, "gyro": gyro, "accel": accel}
    times = np.array(scenario.GNSS_STEPS) * scenario.DT_NS
    return imu, {"t_ns": times, "pos": pos, "vel": vel, "var": var}


def ned18() -> tuple[dict[str, Any], dict[str, Array], dict[str, Array]]:
    """The published 18 states, no lever arm, no gate; one fix without velocity and one without position."""
    rng = np.random.default_rng(18)
    truth = scenario.fly(np.radians(30.68), np.radians(104.06), 150.0)
    sd = {"sd_phi": [ARCMIN] * 3, "sd_v": [0.05] * 3, "sd_p": [1.0] * 3}
    s = scenario.perturbed(
        truth.states[0],
        rng.standard_normal(3) * ARCMIN,
        rng.standard_normal(3) * 0.05,
        rng.standard_normal(3),
    )
    gyro_psd = (0.001 * np.pi / 180.0 / 60.0) ** 2
    gyro, accel = scenario.sensors(
        truth,
        rng,
        gyro_matrix=np.zeros((3, 3)),
        accel_matrix=np.zeros((3, 3)),
        gyro_bias=rng.standard_normal(3) * 0.01 * DEG_H,
        accel_bias=rng.standard_normal(3) * 0.05 * MILLI_G,
        gyro_psd=gyro_psd,
        accel_psd=0.0,
    )
    var = np.diag([1.0, 1.2, 2.0, 0.05**2, 0.05**2, 0.08**2])
    pos, vel = scenario.fixes(truth, rng, np.zeros(3), var, np.zeros(6))
    vel[3], pos[7] = np.nan, np.nan
    blocks = [
        block("gyro_bias", "constant", 0.01 * DEG_H),
        block("gyro_bias", "gauss_markov", 0.001 * DEG_H, name="gyro_drift", sd=0.001 * DEG_H, tau_s=7200.0),
        block("accel_bias", "gauss_markov", 0.05 * MILLI_G, sd=0.05 * MILLI_G, tau_s=1800.0),
    ]
    cfg = config(s, blocks, imu={"gyro_psd": [gyro_psd] * 3}, initial=sd)
    return cfg, *_record(truth, gyro, accel, pos, vel, np.tile(np.diag(var), (10, 1)))


def _low_cost(
    seed: int, lon_deg: float
) -> tuple[scenario.Truth, NavState, dict[str, Any], Array, Array, Array, Any]:
    """Low-cost sensor: truth, start, noise tables, increments, R, generator."""
    rng = np.random.default_rng(seed)
    truth = scenario.fly(np.radians(52.1), np.radians(lon_deg), 420.0)
    sd_phi = np.radians([0.5, 0.5, 2.0])
    start = scenario.perturbed(
        truth.states[0],
        rng.standard_normal(3) * sd_phi,
        rng.standard_normal(3) * 0.1,
        rng.standard_normal(3),
    )
    gyro_psd, accel_psd = np.radians(0.15 / 60.0) ** 2, (0.05 / 60.0) ** 2
    gyro, accel = scenario.sensors(
        truth,
        rng,
        gyro_matrix=np.diag([8e-4, -5e-4, 1e-3]) + 3e-4 * (np.ones((3, 3)) - np.eye(3)),
        accel_matrix=np.diag([-6e-4, 9e-4, 5e-4]) - 2e-4 * (np.ones((3, 3)) - np.eye(3)),
        gyro_bias=[30 * DEG_H, -20 * DEG_H, 25 * DEG_H],
        accel_bias=[3 * MILLI_G, -2 * MILLI_G, 2.5 * MILLI_G],
        gyro_psd=gyro_psd,
        accel_psd=accel_psd,
    )
    root = np.diag([0.5, 0.5, 0.9, 0.04, 0.04, 0.07])
    corr = np.eye(6)
    for i, j, rho in ((0, 1, 0.3), (0, 2, -0.2), (1, 2, 0.4), (0, 3, 0.25), (2, 5, 0.35), (3, 4, -0.3)):
        corr[i, j] = corr[j, i] = rho
    change = {
        "imu": {"gyro_psd": [gyro_psd] * 3, "accel_psd": [accel_psd] * 3},
        "initial": {"sd_phi": sd_phi.tolist(), "sd_v": [0.1] * 3, "sd_p": [1.0] * 3},
    }
    return truth, start, change, gyro, accel, root @ corr @ root, rng


def ned21() -> tuple[dict[str, Any], dict[str, Array], dict[str, Array]]:
    """21 states, lever arm, full R, gate at 0.999 with one fix 60 m off, over Greenwich."""
    truth, start, change, gyro, accel, var, rng = _low_cost(21, -0.0015)
    lever = np.array([0.85, 0.1, -1.2])
    pos, vel = scenario.fixes(truth, rng, lever, var, np.zeros(6))
    pos[6, 0] += 60.0 / 6.38e6
    blocks = [
        block("gyro_bias", "random_walk", 40 * DEG_H, psd=(3 * DEG_H) ** 2 / 100.0),
        block("accel_bias", "gauss_markov", 4 * MILLI_G, sd=4 * MILLI_G, tau_s=300.0),
        block("gyro_scale", "constant", 1e-3),
        block("accel_scale", "constant", 1e-3),
    ]
    gnss = {"lever_b_m": lever.tolist(), "gate_probability": 0.999}
    cfg = config(start, blocks, gnss=gnss, **change)
    cfg["gravity"] = "vertical"
    return cfg, *_record(truth, gyro, accel, pos, vel, np.tile(var, (10, 1, 1)))


def ned40() -> tuple[dict[str, Any], dict[str, Array], dict[str, Array]]:
    """Every kind of block, wrong lever arm, time-correlated GNSS, fixed calibration, over the dateline."""
    truth, start, change, gyro, accel, var, rng = _low_cost(40, 179.9985)
    lever = np.array([0.85, 0.1, -1.2])
    offset = np.array([0.5, -0.3, 0.8, 0.02, 0.03, -0.02])
    pos, vel = scenario.fixes(truth, rng, lever + np.array([0.12, -0.08, 0.1]), var, offset)
    blocks = [
        block("gyro_bias", "random_walk", 40 * DEG_H, psd=(3 * DEG_H) ** 2 / 100.0),
        block("accel_bias", "gauss_markov", 4 * MILLI_G, sd=4 * MILLI_G, tau_s=300.0),
        block("gyro_scale", "gauss_markov", 1e-3, sd=1e-3, tau_s=500.0),
        block("gyro_misalignment", "constant", 5e-4, size=6),
        block("accel_misalignment", "random_walk", 5e-4, size=6, psd=1e-10),
        block("gnss_lever_arm", "constant", 0.1),
        block("baro_bias", "gauss_markov", 3.0, size=1, sd=5.0, tau_s=60.0),
        block("gnss_position_error", "gauss_markov", 0.8, sd=0.8, tau_s=40.0),
        block("gnss_velocity_error", "gauss_markov", 0.04, sd=0.04, tau_s=20.0),
    ]
    # the axes of a block need not be alike
    blocks[1] |= {"tau_s": [300.0, 200.0, 400.0], "initial": [0.02, -0.01, 0.005]}
    blocks[8] |= {"sd": [0.04, 0.05, 0.06]}
    change["imu"] |= {
        "gyro_bias": [1e-5, -2e-5, 3e-5],
        "accel_bias": [2e-3, 1e-3, -3e-3],
        "gyro_matrix": [[1e-4, 2e-5, 0.0], [0.0, -1e-4, 3e-5], [1e-5, 0.0, 2e-4]],
        "accel_matrix": [[-1e-4, 0.0, 1e-5], [2e-5, 1e-4, 0.0], [0.0, -3e-5, 1e-4]],
    }
    gnss = {"lever_b_m": lever.tolist(), "gate_probability": 0.999}
    cfg = config(start, blocks, gnss=gnss, **change)
    cfg |= {"phi_order": 2, "gravity": "vertical"}
    return cfg, *_record(truth, gyro, accel, pos, vel, np.tile(var, (10, 1, 1)))


def ned22() -> tuple[dict[str, Any], dict[str, Array], dict[str, Array], dict[str, dict[str, Array]]]:
    """22 states with barometer, headings, errors correlated over the way, jumps, floors and a gate by parts."""
    truth, start, change, gyro, accel, var, rng = _low_cost(22, 30.0)
    lever = np.array([0.85, 0.1, -1.2])
    pos, vel = scenario.fixes(truth, rng, lever, var, np.array([2.0, -1.0, 3.0, 0.02, 0.0, -0.01]))
    pos[3, 0] += 80.0 / 6.38e6  # position refused, velocity kept
    vel[6, 1] += 3.0  # and the other way round
    blocks = [
        block("gyro_bias", "random_walk", 40 * DEG_H, psd=(3 * DEG_H) ** 2 / 100.0, floor_sd=35 * DEG_H),
        block("accel_bias", "gauss_markov", 4 * MILLI_G, sd=4 * MILLI_G, tau_s=300.0),
        block("baro_bias", "random_walk", 4.0, size=1, psd=0.035**2, floor_sd=0.5),
        block("gnss_position_error", "gauss_markov", 3.0, sd=3.0, tau_s=20.0, jump_sd=2.0),
        block("gnss_velocity_error", "gauss_markov", 0.05, sd=0.05, tau_s=5.0, jump_sd=0.02),
    ]
    blocks[3] |= {"distance_m": 500.0, "sd": [3.0, 3.0, 4.0], "initial_sd": [3.0, 3.0, 4.0]}
    gnss = {"lever_b_m": lever.tolist(), "gate_probability": 0.9999, "gate": "parts"}
    cfg = config(start, blocks, gnss=gnss, **change)
    cfg["baro"] = {"latency_ns": 0, "gate_probability": 0.9999}
    cfg["heading"] = {"latency_ns": 0, "gate_probability": None}
    cfg["floor"] = {"phi": [1e-3, 1e-3, 3e-3], "v": [0.02, 0.02, 0.01], "p": [0.0, 0.0, 0.4]}
    imu, table = _record(truth, gyro, accel, pos, vel, np.tile(var, (10, 1, 1)))
    table["new"] = np.arange(10) % 4 == 2
    steps = np.arange(20, scenario.STEPS + 1, 30)
    height = np.array([truth.states[k].h for k in steps]) + 5.0 + 0.4 * rng.standard_normal(steps.size)
    height[11] += 40.0  # refused
    baro = {"t_ns": steps * scenario.DT_NS, "value": height, "var": np.full(steps.size, 0.16)}
    steps = np.arange(50, scenario.STEPS + 1, 50)  # every other one together with a fix
    yaw = np.array([quat_to_euler(truth.states[k].q)[2] for k in steps])
    yaw = yaw + np.radians(0.3) * rng.standard_normal(steps.size)
    heading = {"t_ns": steps * scenario.DT_NS, "value": yaw, "var": np.full(steps.size, np.radians(0.3) ** 2)}
    return cfg, imu, table, {"baro": baro, "heading": heading}


CASES = {"ned18": ned18, "ned21": ned21, "ned40": ned40}
