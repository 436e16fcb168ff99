"""Section ``[filter]``: navigation model, error-state blocks, and the preset that both start from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from .. import units
from .base import Floor3, Positive, Problem, Section, choices, invalid, is_number, refuse
from .presets import check_preset

BlockKind = Literal[
    "gyro_bias",
    "accel_bias",
    "gyro_scale",
    "accel_scale",
    "gyro_misalignment",
    "accel_misalignment",
    "gnss_lever_arm",
    "baro_bias",
    "gnss_position_error",
    "gnss_velocity_error",
]
Process = Literal["constant", "random_walk", "gauss_markov"]

BLOCK_UNITS: Mapping[str, Mapping[str, float]] = {
    "gyro_bias": units.GYRO_BIAS,
    "accel_bias": units.ACCEL_BIAS,
    "gyro_scale": units.SCALE,
    "accel_scale": units.SCALE,
    "gyro_misalignment": units.MISALIGNMENT,
    "accel_misalignment": units.MISALIGNMENT,
    "gnss_lever_arm": units.LENGTH,
    "baro_bias": units.LENGTH,
    "gnss_position_error": units.LENGTH,
    "gnss_velocity_error": units.VELOCITY,
}
"""Units that each kind of block takes, with the factor to SI."""

BLOCK_SIZES: Mapping[str, int] = {
    kind: {"gyro_misalignment": 6, "accel_misalignment": 6, "baro_bias": 1}.get(kind, 3)
    for kind in BLOCK_UNITS
}
"""Number of states of each kind of block."""

_OUTSIDE = ("gnss_position_error", "gnss_velocity_error", "baro_bias")
"""Kinds whose errors depend on where the vehicle is."""


def _numbers(value: Any) -> Any:
    """Accept a number or a list of numbers."""
    if is_number(value):
        return float(value)
    if isinstance(value, (list, tuple)) and value and all(map(is_number, value)):
        return tuple(float(v) for v in value)
    raise invalid("config.type", "must be a number, or a list with one number per axis")


def _positive(value: float | tuple[float, ...]) -> float | tuple[float, ...]:
    if min(value if isinstance(value, tuple) else (value,)) <= 0.0:
        raise invalid(
            "config.noise",
            "must be greater than 0: a state without uncertainty cannot be estimated and makes the "
            "covariance "
            "singular",
            "leave the block out if the error does not exist; a value that never changes is process = "
            '"constant"',
        )
    return value


_Numbers = float | tuple[float, ...]


def _not_negative(value: float | tuple[float, ...]) -> float | tuple[float, ...]:
    if min(value if isinstance(value, tuple) else (value,)) < 0.0:
        raise invalid("config.range", "must not be negative")
    return value


Numbers = Annotated[_Numbers, BeforeValidator(_numbers)]
FloorNumbers = Annotated[_Numbers, BeforeValidator(_numbers), AfterValidator(_not_negative)]
PositiveNumbers = Annotated[_Numbers, BeforeValidator(_numbers), AfterValidator(_positive)]


class BlockConfig(Section):
    """One block of error states; named as a block of the preset, it changes only the keys that it gives."""

    kind: BlockKind = Field(description="What the block stands for", examples=["gyro_bias"])
    name: str | None = Field(
        default=None,
        pattern=r"^[a-z][a-z0-9_]*$",
        description="Name of the states; left out: the kind. Two blocks of one kind need two names",
        examples=["gyro_bias"],
    )
    process: Process | None = Field(
        default=None,
        description="constant: does not change; random_walk: drifts by walk; gauss_markov: stays around zero "
        "with sd, "
        "correlated over tau_s. Left out: as in the preset, else constant",
        examples=["random_walk"],
    )
    unit: str | None = Field(
        default=None,
        description="Unit of initial, initial_sd, walk and sd: gyro_bias deg/h, deg/s, rad/s; accel_bias mg, "
        "ug, "
        "m/s^2; scale ppm; misalignment mrad; lever arm, position error and baro m; velocity error m/s",
        examples=["deg/h"],
    )
    initial: Numbers | None = Field(
        default=None,
        description="Value at the start, one number or one per axis; left out: 0",
        examples=[0.0],
    )
    initial_sd: PositiveNumbers | None = Field(
        default=None,
        description="Uncertainty at the start, 1 sigma, one number or one per axis; gauss_markov: left out = "
        "sd",
        examples=[100.0],
    )
    walk: PositiveNumbers | None = Field(
        default=None, description="random_walk: drift in the unit per sqrt(s)", examples=[0.2]
    )
    sd: PositiveNumbers | None = Field(
        default=None, description="gauss_markov: steady standard deviation", examples=[10.0]
    )
    tau_s: Positive | None = Field(
        default=None, description="gauss_markov: correlation time, s", examples=[3600.0]
    )
    distance_m: Positive | None = Field(
        default=None,
        description="gauss_markov errors of receiver and barometer: correlation over the way too, m; the rate is "
        "1/tau_s + ground speed/distance_m",
        examples=[250_000.0],
    )
    jump_sd: FloorNumbers | None = Field(
        default=None,
        description="What a change of the satellite constellation adds to the uncertainty, 1 sigma",
        examples=[3.0],
    )
    floor_sd: FloorNumbers | None = Field(
        default=None,
        description="Lower bound of the uncertainty, held after every measurement, 1 sigma; left out: none",
        examples=[0.1],
    )

    @property
    def state_name(self) -> str:
        """Name of the block: given, or its kind."""
        return self.name or self.kind

    def values(self, key: str) -> list[float] | None:
        """Return one of the value keys in SI, one number per state; None if not given."""
        value = getattr(self, key)
        if value is None:
            return None
        factor = BLOCK_UNITS[self.kind][self.unit] if self.unit else 1.0
        numbers = value if isinstance(value, tuple) else (value,) * BLOCK_SIZES[self.kind]
        return [number * factor for number in numbers]

    @model_validator(mode="after")
    def _consistent(self) -> BlockConfig:
        problems = []
        table = BLOCK_UNITS[self.kind]
        keys = ("initial", "initial_sd", "walk", "sd", "jump_sd", "floor_sd")
        given = [key for key in keys if getattr(self, key) is not None]
        if self.unit is None and given:
            problems.append(
                Problem(
                    "config.missing_key",
                    f"missing: in which unit is {', '.join(given)}?",
                    f"add unit, one of {choices(table)}",
                    "unit",
                )
            )
        if self.unit is not None and self.unit not in table:
            text = f'not a unit of kind = "{self.kind}", which takes {choices(table)}'
            problems.append(Problem("config.unit", text, "", "unit"))
        size = BLOCK_SIZES[self.kind]
        for key in given:
            value = getattr(self, key)
            if isinstance(value, tuple) and len(value) != size:
                text = f'must be one number or {size} numbers for kind = "{self.kind}", not {len(value)}'
                problems.append(Problem("config.type", text, "", key))
        foreign = {
            "walk": "random_walk",
            "sd": "gauss_markov",
            "tau_s": "gauss_markov",
            "distance_m": "gauss_markov",
        }
        if self.distance_m is not None and self.kind not in _OUTSIDE:
            names = ", ".join(_OUTSIDE)
            text = f"correlation over the way is for {names}"
            problems.append(Problem("config.conflict", text, "", "distance_m"))
        for key, process in foreign.items():
            if getattr(self, key) is not None and self.process is not None and self.process != process:
                text = f'belongs to process = "{process}", but process = "{self.process}"'
                problems.append(
                    Problem("config.conflict", text, f'drop it, or set process = "{process}"', key)
                )
        refuse(problems)
        return self


class FilterConfig(Section):
    """Navigation model and error states. Without preset and blocks: the nine navigation errors only."""

    preset: Annotated[str, AfterValidator(check_preset)] | None = Field(
        default=None,
        description="Published filter to start from: its model, blocks and sensor noise; every key that is "
        "given "
        "elsewhere in the file goes before it",
        examples=["ned-15"],
    )
    model: Literal["ned", "ecef"] | None = Field(
        default=None,
        description="Navigation equations: north-east-down, or Earth-centred (works at the poles too); "
        "left out: as in the preset, else ned",
        examples=["ned"],
    )
    ellipsoid: Literal["wgs84", "grs80", "pz90", "krasovsky"] | None = Field(
        default=None,
        description="Reference ellipsoid of positions and gravity; left out: as in the preset, else wgs84",
        examples=["wgs84"],
    )
    gravity: Literal["normal", "vertical"] | None = Field(
        default=None,
        description="normal: normal gravity with its small north component at height; vertical: without it; "
        "left out: as in the preset, else normal",
        examples=["normal"],
    )
    phi_order: int | None = Field(
        default=None,
        ge=1,
        le=3,
        description="Terms of the transition matrix series, 1 to 3; left out: as in the preset, else 3",
        examples=[3],
    )
    covariance_every: int = Field(
        default=1,
        ge=1,
        le=100,
        description="IMU intervals that the covariance goes through at once, with the mean of their dynamics; it is "
        "always brought up to date where a measurement is fused; sigmas of outputs in between are so many samples old "
        "at most. 1: at every sample; at most 100",
    )
    coning: Literal["two-sample", "one-sample", "third-order"] | None = Field(
        default=None,
        description="Coning and sculling compensation of increments; third-order: two-sample with one more term of the "
        'turn within an interval, for fast turns. No effect on [imu] kind = "rates", which has its own terms; left '
        "out: as in the preset, else two-sample",
        examples=["two-sample"],
    )
    attitude_form: (
        Literal["rotation-vector", "euler", "dcm", "quaternion", "picard", "two-quaternions"] | None
    ) = Field(
        default=None,
        description="Attitude equations of the NED model; rotation-vector is exact, the others are classical forms "
        "to compare with (docs, theory of strapdown forms); left out: as in the preset, else rotation-vector",
        examples=["rotation-vector"],
    )
    feedback_interval_s: float = Field(
        default=0.0,
        ge=0.0,
        description="Shortest time between two corrections of the navigation solution by the estimated errors, s; 0: "
        "after every measurement. Must stay well inside the range in which the error equations are linear",
    )
    floor_attitude_deg: Floor3 = Field(
        default=(0.0, 0.0, 0.0),
        description="Lower bound of the attitude uncertainty about north, east, down, deg, 1 sigma",
    )
    floor_velocity_m_s: Floor3 = Field(
        default=(0.0, 0.0, 0.0),
        description="Lower bound of the velocity uncertainty north, east, down, m/s, 1 sigma",
    )
    floor_position_m: Floor3 = Field(
        default=(0.0, 0.0, 0.0),
        description="Lower bound of the position uncertainty north, east, down, m, 1 sigma",
    )
    block: Annotated[tuple[BlockConfig, ...], Field(strict=False)] = Field(
        default=(), description="Blocks of error states, one [[filter.block]] each, in the order of the state"
    )
