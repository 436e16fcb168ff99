"""Section ``[imu]``: the IMU file, what its columns mean, and how good the sensors are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from .. import units
from .axes import axes_matrix
from .base import (
    Axes3,
    InputPath,
    Matrix3,
    Names3,
    Noise3,
    Positive,
    Problem,
    Section,
    Separator,
    choices,
    refuse,
    three_by_three,
)

ImuKind = Literal["rates", "mean-rates", "increments"]

Convention = Literal["one-sided", "two-sided"]
"""What the square of a noise density stands for; see :data:`DENSITY_SIDES`."""

DENSITY_SIDES: Mapping[str, float] = {"two-sided": 1.0, "one-sided": math.sqrt(2.0)}
"""Root of a density of each convention over the root of the two-sided one.

Two-sided (IEEE Std 952, angle and velocity random walk): the integral of the noise over a time T has the variance
``density^2 T``. One-sided: the noise in a bandwidth B has the variance ``density^2 B``, so the density over positive
frequencies alone holds what the two-sided one spreads over both signs, twice as much.
"""


def _axes(value: Any) -> Any:
    """Accept axis letters or a matrix, and prove that either is a proper rotation."""
    if not isinstance(value, str):
        value = three_by_three(value)
    axes_matrix(value)
    return value


def _one_noise_only(given: list[str]) -> list[Problem]:
    """Refuse the same noise given twice."""
    if len(given) < 2:
        return []
    return [Problem("config.conflict", f"the same noise given twice: {', '.join(given)}", "keep one of them")]


def _no_density(convention: str, density: object) -> list[Problem]:
    """Refuse a convention without the density that it speaks about."""
    if density is not None or convention == "two-sided":
        return []
    text = "speaks about a noise density, but there is none: a random walk has no sides"
    return [Problem("config.conflict", text, "drop it", "noise_density_convention")]


def _squares(density: tuple[float, ...], factor: float, convention: str = "two-sided") -> list[float]:
    """Two-sided spectral densities from root densities, their unit factor and what they mean."""
    return [(value * factor / DENSITY_SIDES[convention]) ** 2 for value in density]


_CONVENTION = (
    "What noise_density means. two-sided: its square times the time is the variance of the integral (ARW, VRW; IEEE "
    "Std 952); one-sided: its square times the bandwidth is the variance of the reading, which makes it sqrt(2) "
    "times as large"
)


class GyroConfig(Section):
    """Gyro: noise, range, known errors. Give one noise key, or take the noise of the preset."""

    arw_deg_sqrt_h: Noise3 | None = Field(
        default=None,
        description="Angle random walk, deg/sqrt(h), one number or x, y, z",
        examples=[0.15],
    )
    noise_density_deg_s_sqrt_hz: Noise3 | None = Field(
        default=None,
        description="The same as a rate noise density, deg/s/sqrt(Hz); 60 times smaller in number",
        examples=[0.0025],
    )
    noise_density_convention: Convention = Field(default="two-sided", description=_CONVENTION)
    range_deg_s: Positive | None = Field(
        default=None,
        description="Full scale, deg/s; samples at or beyond it are flagged as saturated",
        examples=[2000.0],
    )
    bias_deg_h: Axes3 = Field(
        default=(0.0, 0.0, 0.0), description="Known bias, deg/h in FRD axes, taken off first"
    )
    matrix: Matrix3 | None = Field(
        default=None,
        description="Known scale and misalignment M, dimensionless: measured = (I + M) true + bias",
        examples=[[[0.001, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]],
    )

    @model_validator(mode="after")
    def _one_noise(self) -> GyroConfig:
        given = [k for k in ("arw_deg_sqrt_h", "noise_density_deg_s_sqrt_hz") if getattr(self, k) is not None]
        convention, density = self.noise_density_convention, self.noise_density_deg_s_sqrt_hz
        refuse(_one_noise_only(given) + _no_density(convention, density))
        return self

    def psd(self) -> list[float] | None:
        """Two-sided power spectral density per axis, rad^2/s; None if the configuration gives no noise."""
        if self.arw_deg_sqrt_h is not None:
            return _squares(self.arw_deg_sqrt_h, units.DEG_SQRT_H_TO_RAD_SQRT_S)
        if self.noise_density_deg_s_sqrt_hz is not None:
            return _squares(self.noise_density_deg_s_sqrt_hz, units.DEG_TO_RAD, self.noise_density_convention)
        return None


class AccelConfig(Section):
    """Accelerometer: noise, range, known errors. Give one noise key, or take the noise of the preset."""

    vrw_m_s_sqrt_h: Noise3 | None = Field(
        default=None,
        description="Velocity random walk, m/s/sqrt(h), one number or x, y, z",
        examples=[0.08],
    )
    noise_density_ug_sqrt_hz: Noise3 | None = Field(
        default=None, description="The same as a noise density, ug/sqrt(Hz)", examples=[140.0]
    )
    noise_density_m_s2_sqrt_hz: Noise3 | None = Field(
        default=None, description="The same as a noise density, m/s^2/sqrt(Hz)", examples=[0.0014]
    )
    noise_density_convention: Convention = Field(default="two-sided", description=_CONVENTION)
    range_g: Positive | None = Field(
        default=None,
        description="Full scale, g; samples at or beyond it are flagged as saturated",
        examples=[16.0],
    )
    bias_mg: Axes3 = Field(default=(0.0, 0.0, 0.0), description="Known bias, mg in FRD axes, taken off first")
    matrix: Matrix3 | None = Field(
        default=None,
        description="Known scale and misalignment M, dimensionless: measured = (I + M) true + bias",
        examples=[[[0.001, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]],
    )

    @model_validator(mode="after")
    def _one_noise(self) -> AccelConfig:
        keys = ("vrw_m_s_sqrt_h", "noise_density_ug_sqrt_hz", "noise_density_m_s2_sqrt_hz")
        given = [k for k in keys if getattr(self, k) is not None]
        density = next((k for k in given if k != "vrw_m_s_sqrt_h"), None)
        refuse(_one_noise_only(given) + _no_density(self.noise_density_convention, density))
        return self

    def psd(self) -> list[float] | None:
        """Two-sided power spectral density per axis, m^2/s^3; None if the configuration gives no noise."""
        if self.vrw_m_s_sqrt_h is not None:
            return _squares(self.vrw_m_s_sqrt_h, units.M_S_SQRT_H_TO_M_S_SQRT_S)
        if self.noise_density_ug_sqrt_hz is not None:
            return _squares(self.noise_density_ug_sqrt_hz, units.UG_TO_M_S2, self.noise_density_convention)
        if self.noise_density_m_s2_sqrt_hz is not None:
            return _squares(self.noise_density_m_s2_sqrt_hz, 1.0, self.noise_density_convention)
        return None


class ImuConfig(Section):
    """The IMU log: where it is, what its columns mean, what to do with faults in it."""

    file: InputPath | None = Field(
        default=None, description="IMU log, .csv or .csv.gz, with one header line", examples=["imu.csv.gz"]
    )
    separator: Separator = Field(default=",", description="Character between the cells of a line")
    time_column: str = Field(default="time_s", description="Column of the time stamps")
    time_unit: Literal["s", "ms", "us", "ns"] = Field(default="s", description="Unit of the time stamps")
    kind: ImuKind = Field(
        default="rates",
        description=(
            "What a row holds. rates: values at the instant of the stamp; mean-rates: means over the "
            "interval "
            "that ends at the stamp; increments: angle and velocity increments over that interval"
        ),
    )
    gyro_columns: Names3 = Field(
        default=("gyro_x", "gyro_y", "gyro_z"), description="Gyro columns: sensor x, y, z"
    )
    gyro_unit: Literal["rad/s", "deg/s", "rad", "deg"] | None = Field(
        default=None,
        description="Unit of the gyro columns: rad/s or deg/s for rates, rad or deg for increments; "
        "left out: rad/s, or rad for increments",
        examples=["rad/s"],
    )
    accel_columns: Names3 = Field(
        default=("accel_x", "accel_y", "accel_z"),
        description="Accelerometer columns: sensor x, y, z; specific force (at rest, the axis that points up "
        "reads +9.8 m/s^2)",
    )
    accel_unit: Literal["m/s^2", "g", "m/s"] | None = Field(
        default=None,
        description="Unit of the accelerometer columns: m/s^2 or g for rates, m/s for increments; "
        "left out: m/s^2, or m/s for increments",
        examples=["m/s^2"],
    )
    axes: Annotated[str | Matrix3, BeforeValidator(_axes)] = Field(
        default="FRD",
        description="Where sensor x, y, z point: letters of F/B (forward, back), R/L (right, left), U/D (up, "
        'down) such as "FRD", "FLU", "RFU" (also written "ENU"); or a 3x3 matrix that takes sensor axes to '
        "forward-right-down",
    )
    missing: str = Field(
        default="nan", description="Text that stands for a missing value, beside an empty cell"
    )
    on_bad_row: Literal["stop", "skip"] = Field(
        default="stop",
        description="Rows that cannot be read (a cell is no number, too few or too many cells, a cut file): "
        "stop with the row and column, or skip and count them",
    )
    on_backwards: Literal["stop", "drop", "sort"] = Field(
        default="stop",
        description="Rows whose time goes back: stop, drop and count them, or sort the file by time",
    )
    max_gap_s: Positive = Field(default=1.0, description="Longest step between two rows that is no gap, s")
    on_gap: Literal["stop", "bridge"] = Field(
        default="stop", description="Longer gaps: stop, or bridge with an event in the result"
    )
    max_bad_share: float = Field(
        default=0.01,
        ge=0.0,
        le=1.0,
        description="Share of missing or non-finite rows above which a run stops",
    )
    gyro: GyroConfig = Field(default=GyroConfig(), description="Quality of the gyros")
    accel: AccelConfig = Field(default=AccelConfig(), description="Quality of the accelerometers")

    @model_validator(mode="after")
    def _consistent(self) -> ImuConfig:
        problems = []
        for key, rates, steps in (
            ("gyro_unit", units.RATE, units.ANGLE),
            ("accel_unit", units.FORCE, units.VELOCITY),
        ):
            unit = getattr(self, key)
            allowed = steps if self.kind == "increments" else rates
            if unit is not None and unit not in allowed:
                problems.append(
                    Problem(
                        "config.unit",
                        f'"{unit}" does not go with kind = "{self.kind}", which takes {choices(allowed)}',
                        f'set {key}, or kind = "{"rates" if unit in rates else "increments"}"',
                        key,
                    )
                )
        names = (self.time_column, *self.gyro_columns, *self.accel_columns)
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            problems.append(Problem("config.columns", f"column used twice: {', '.join(twice)}"))
        refuse(problems)
        return self

    def gyro_factor(self) -> float:
        """Factor from the gyro columns to rad/s, or to rad for increments."""
        table = units.ANGLE if self.kind == "increments" else units.RATE
        return table[self.gyro_unit] if self.gyro_unit else 1.0

    def accel_factor(self) -> float:
        """Factor from the accelerometer columns to m/s^2, or to m/s for increments."""
        table = units.VELOCITY if self.kind == "increments" else units.FORCE
        return table[self.accel_unit] if self.accel_unit else 1.0
