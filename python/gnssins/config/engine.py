"""From the user's configuration to the SI configuration of the engine."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from .. import units
from .base import Problem
from .filter import BLOCK_SIZES, BlockConfig
from .presets import load_preset

if TYPE_CHECKING:
    from .aids import BaroConfig, HeadingConfig
    from .root import Config

_DEFAULTS: Mapping[str, Any] = {
    "model": "ned",
    "ellipsoid": "wgs84",
    "gravity": "normal",
    "coning": "two-sample",
    "attitude_form": "rotation-vector",
    "phi_order": 3,
}
_IDENTITY_ERROR = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
_PROCESS_KEYS: Mapping[str, tuple[str, ...]] = {
    "constant": (),
    "random_walk": ("psd",),
    "gauss_markov": ("sd", "tau_s"),
}
_BOUNDS = ("jump_sd", "floor_sd")


def filter_settings(config: Config, preset: Mapping[str, Any]) -> dict[str, Any]:
    """Model, ellipsoid, gravity, coning and order: the user's, else the preset's, else the default."""
    settings = {}
    for key, default in _DEFAULTS.items():
        own = getattr(config.filter, key)
        settings[key] = own if own is not None else preset.get(key, default)
    return settings


def noise_psd(config: Config, preset: Mapping[str, Any]) -> tuple[list[float] | None, list[float] | None]:
    """Gyro (rad^2/s) and accelerometer (m^2/s^3) densities: the user's, else the preset's, else None."""
    imu = preset.get("imu") or {}
    gyro = config.imu.gyro.psd() or _listed(imu.get("gyro_psd"))
    accel = config.imu.accel.psd() or _listed(imu.get("accel_psd"))
    return gyro, accel


def _listed(psd: Iterable[float] | None) -> list[float] | None:
    """Take the noise of a preset as it is: zero if its publication has none, None if it leaves it open."""
    return None if psd is None else [float(value) for value in psd]


def merge_blocks(
    own: Iterable[BlockConfig], preset: Mapping[str, Any]
) -> tuple[list[dict[str, Any]], list[Problem]]:
    """Lay the user's blocks over those of the preset.

    A block whose name the preset knows changes only the keys that it gives; any other block is added at the
    end.

    Parameters
    ----------
    own : iterable of BlockConfig
        The user's blocks.
    preset : Mapping
        Engine configuration of the preset; may be empty.

    Returns
    -------
    blocks : list of dict
        Blocks in engine form, SI units.
    problems : list of Problem
        What keeps a block from being complete; ``key`` is ``"block.<index>.<key>"``.
    """
    blocks = {block["name"]: dict(block) for block in preset.get("blocks", ())}
    problems: list[Problem] = []
    seen: set[str] = set()
    for index, block in enumerate(own):
        where, name = f"block.{index}.", block.state_name
        if name in seen:
            text = f'two blocks are called "{name}"'
            problems.append(Problem("config.conflict", text, "give one of them another name", where + "name"))
            continue
        seen.add(name)
        base = blocks.get(name, {"kind": block.kind, "name": name, "process": "constant"})
        if base["kind"] != block.kind:
            text = f'the preset has a block "{name}" of kind "{base["kind"]}"'
            problems.append(Problem("config.conflict", text, "give this one another name", where + "name"))
            continue
        merged = _merge_block(base, block)
        problems += _incomplete(merged, where)
        blocks[name] = merged
    return list(blocks.values()), problems


def _merge_block(base: Mapping[str, Any], own: BlockConfig) -> dict[str, Any]:
    process = own.process or base["process"]
    size = BLOCK_SIZES[own.kind]
    walk = own.values("walk")
    given = {
        "initial": own.values("initial"),
        "initial_sd": own.values("initial_sd"),
        "psd": [value**2 for value in walk] if walk else None,
        "sd": own.values("sd"),
        "tau_s": [own.tau_s] * size if own.tau_s is not None else None,
    }
    inherited = base if process == base["process"] else {"initial_sd": base.get("initial_sd")}
    merged: dict[str, Any] = {"kind": own.kind, "name": base["name"], "process": process}
    for key in ("initial_sd", "initial", *_PROCESS_KEYS[process]):
        merged[key] = given[key] if given[key] is not None else inherited.get(key)
    if merged["initial_sd"] is None and process == "gauss_markov":
        merged["initial_sd"] = merged["sd"]
    if merged["initial"] is None:
        merged["initial"] = [0.0] * size
    optional = {
        "distance_m": own.distance_m if own.distance_m is not None else inherited.get("distance_m"),
        **{key: own.values(key) or base.get(key) for key in _BOUNDS},
    }
    return merged | {key: value for key, value in optional.items() if value}


def _incomplete(block: Mapping[str, Any], where: str) -> list[Problem]:
    words = {"initial_sd": "initial_sd", "psd": "walk", "sd": "sd", "tau_s": "tau_s"}
    needed = _PROCESS_KEYS[block["process"]]
    if block["process"] != "gauss_markov":  # there initial_sd follows from sd
        needed = ("initial_sd", *needed)
    return [
        Problem(
            "config.missing_key",
            f'missing for process = "{block["process"]}"',
            f"add {words[key]}" + ("" if key == "tau_s" else " and its unit"),
            where + words[key],
        )
        for key in needed
        if block[key] is None
    ]


def filter_problems(config: Config) -> list[Problem]:
    """Everything that the user's keys and the preset together leave open."""
    preset = load_preset(config.filter.preset)
    problems = []
    origin = f'nor by preset "{config.filter.preset}"' if config.filter.preset else "and there is no preset"
    gyro, accel = noise_psd(config, preset)
    if gyro is None:
        problems.append(
            Problem(
                "config.noise",
                f"gyro noise missing: not given here, {origin}",
                "add arw_deg_sqrt_h or noise_density_deg_s_sqrt_hz (data sheet) to [imu.gyro]",
                "imu.gyro",
            )
        )
    if accel is None:
        problems.append(
            Problem(
                "config.noise",
                f"accelerometer noise missing: not given here, {origin}",
                "add vrw_m_s_sqrt_h, noise_density_ug_sqrt_hz or noise_density_m_s2_sqrt_hz to [imu.accel]",
                "imu.accel",
            )
        )
    settings = filter_settings(config, preset)
    if settings["model"] == "ecef" and settings["attitude_form"] != "rotation-vector":
        text = 'the ECEF model has attitude_form = "rotation-vector" only'
        hint = 'set model = "ned", or leave attitude_form out'
        problems.append(Problem("config.conflict", text, hint, "filter.attitude_form"))
    _, incomplete = merge_blocks(config.filter.block, preset)
    return problems + [Problem(p.code, p.text, p.hint, f"filter.{p.key}") for p in incomplete]


def imu_settings(config: Config, preset: Mapping[str, Any]) -> dict[str, Any]:
    """Section ``imu`` of the engine configuration: input kind, noise, limits, calibration."""
    imu = config.imu
    gyro, accel = noise_psd(config, preset)
    range_rad_s = imu.gyro.range_deg_s
    range_g = imu.accel.range_g
    return {
        "input": imu.kind,
        "gyro_psd": gyro,
        "accel_psd": accel,
        "gyro_range": None if range_rad_s is None else range_rad_s * units.DEG_TO_RAD,
        "accel_range": None if range_g is None else range_g * units.STANDARD_GRAVITY_M_S2,
        "max_gap_ns": units.seconds_to_ns(imu.max_gap_s),
        "on_gap": imu.on_gap,
        "on_backwards": "drop" if imu.on_backwards == "drop" else "stop",
        "max_bad_share": imu.max_bad_share,
        "gyro_bias": [v * units.GYRO_BIAS["deg/h"] for v in imu.gyro.bias_deg_h],
        "accel_bias": [v * units.ACCEL_BIAS["mg"] for v in imu.accel.bias_mg],
        "gyro_matrix": _matrix(imu.gyro.matrix),
        "accel_matrix": _matrix(imu.accel.matrix),
    }


def _matrix(rows: tuple[tuple[float, float, float], ...] | None) -> list[list[float]]:
    return [list(row) for row in rows] if rows is not None else [list(row) for row in _IDENTITY_ERROR]


def gnss_settings(config: Config) -> dict[str, Any]:
    """Section ``gnss`` of the engine configuration: lever arm, latency, gate."""
    gnss = config.gnss
    return {
        "lever_b_m": list(gnss.lever_ba_b_m),
        "latency_ns": units.ms_to_ns(gnss.latency_ms),
        "gate_probability": None if gnss.gate_probability == "off" else gnss.gate_probability,
        "reacquire_after": None if gnss.reacquire_after == "off" else gnss.reacquire_after,
        "gate": gnss.gate,
        "trace_ratio_limit": gnss.trace_ratio_limit,
        "max_accel_m_s2": gnss.max_accel_m_s2,
    }


def aid_settings(aid: BaroConfig | HeadingConfig) -> dict[str, Any]:
    """Section of an aid beside GNSS in the engine configuration: latency and gate."""
    return {
        "latency_ns": units.ms_to_ns(aid.latency_ms),
        "gate_probability": None if aid.gate_probability == "off" else aid.gate_probability,
    }


def floor_settings(config: Config) -> dict[str, list[float]]:
    """Section ``floor`` of the engine configuration: lower bounds of the navigation sigmas, rad, m/s, m."""
    own = config.filter
    return {
        "phi": [v * units.DEG_TO_RAD for v in own.floor_attitude_deg],
        "v": list(own.floor_velocity_m_s),
        "p": list(own.floor_position_m),
    }


def output_settings(config: Config) -> dict[str, Any]:
    """Section ``output`` of the engine configuration: intervals in ns, 0 = every row or none."""
    rate, covariance = config.run.output_rate_hz, config.run.covariance_interval_s
    return {
        "interval_ns": 0 if rate is None else units.seconds_to_ns(1.0 / rate),
        "covariance_interval_ns": 0 if covariance is None else units.seconds_to_ns(covariance),
        "linearise": config.run.linearise,
    }


def engine_config(config: Config, initial: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Assemble the engine configuration; see :meth:`gnssins.config.Config.engine_config`."""
    preset = load_preset(config.filter.preset)
    blocks, _ = merge_blocks(config.filter.block, preset)
    engine: dict[str, Any] = {
        **filter_settings(config, preset),
        "floor": floor_settings(config),
        "covariance_every": config.filter.covariance_every,
        "feedback_ns": units.seconds_to_ns(config.filter.feedback_interval_s),
        "imu": imu_settings(config, preset),
        "blocks": blocks,
        "gnss": gnss_settings(config),
        "baro": aid_settings(config.baro),
        "heading": aid_settings(config.heading),
        "output": output_settings(config),
    }
    if initial is not None:
        engine["initial"] = dict(initial)
    return engine
