"""Scenario tables of the inertial sensors: what the simulated IMU does to the truth.

Keys and units are those of the run configuration wherever both mean the same thing, so that blocks can be
copied from a scenario into a filter.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from .. import units
from ..config.base import Floor3, Positive, Problem, Section, choices, refuse
from ..config.filter import BLOCK_SIZES, BLOCK_UNITS, Numbers
from ..config.imu import DENSITY_SIDES, Convention

__all__ = ["AccelSensor", "GyroSensor", "Imu", "ImuError"]

ErrorKind = Literal[
    "gyro_bias", "accel_bias", "gyro_scale", "accel_scale", "gyro_misalignment", "accel_misalignment"
]

Array = NDArray[np.float64]

_ZERO = (0.0, 0.0, 0.0)


class _Noise(Section):
    """What gyros and accelerometers have in common: what a density means, and how far the noise reaches."""

    noise_density_convention: Convention = Field(
        default="two-sided",
        description="What noise_density means. two-sided: the root of the density whose square times the time is "
        "the variance of the integral (ARW, VRW; IEEE Std 952); one-sided: the square times the bandwidth is the "
        "variance of the reading, which makes the root sqrt(2) times as large",
    )
    bandwidth_hz: Positive | None = Field(
        default=None,
        description="Corner of the first-order low-pass that the noise has passed, Hz; left out: white noise",
    )

    def _one_noise(self, walk: tuple[float, ...], densities: dict[str, Floor3 | None]) -> None:
        """Refuse the same noise given twice, and a convention that nothing goes with."""
        given = [key for key, value in densities.items() if value is not None]
        problems = []
        if len(given) + any(walk) > 1:
            text = f"the same noise given twice: {', '.join(given)}" + (
                " and a random walk" if any(walk) else ""
            )
            problems.append(Problem("config.conflict", text, "keep one of them"))
        if not given and self.noise_density_convention != "two-sided":
            text = "speaks about a noise density, but there is none: a random walk has no sides"
            problems.append(Problem("config.conflict", text, "drop it", "noise_density_convention"))
        refuse(problems)

    def _density(self, values: Floor3, factor: float) -> Array:
        """Root of the two-sided density in SI, shape (3,)."""
        return np.asarray(values) * factor / DENSITY_SIDES[self.noise_density_convention]


class GyroSensor(_Noise):
    """``[imu.gyro]``: noise, range and resolution of the gyros."""

    arw_deg_sqrt_h: Floor3 = Field(default=_ZERO, description="Angle random walk, deg/sqrt(h)")
    noise_density_deg_s_sqrt_hz: Floor3 | None = Field(
        default=None, description="The same as a rate noise density, deg/s/sqrt(Hz)"
    )
    range_deg_s: Positive | None = Field(
        default=None, description="Full scale, deg/s; beyond it the output clips"
    )
    increment_lsb_arcsec: Positive | None = Field(
        default=None,
        description="Resolution of an angle increment, arcsec; the rounding error is carried over",
    )

    @property
    def density(self) -> Array:
        """Root of the two-sided noise density, rad/sqrt(s), shape (3,)."""
        if self.noise_density_deg_s_sqrt_hz is not None:
            return self._density(self.noise_density_deg_s_sqrt_hz, units.DEG_TO_RAD)
        return np.asarray(self.arw_deg_sqrt_h) * units.DEG_SQRT_H_TO_RAD_SQRT_S

    @model_validator(mode="after")
    def _consistent(self) -> GyroSensor:
        given = {"noise_density_deg_s_sqrt_hz": self.noise_density_deg_s_sqrt_hz}
        self._one_noise(self.arw_deg_sqrt_h, given)
        return self


class AccelSensor(_Noise):
    """``[imu.accel]``: noise, range and resolution of the accelerometers."""

    vrw_m_s_sqrt_h: Floor3 = Field(default=_ZERO, description="Velocity random walk, m/s/sqrt(h)")
    noise_density_ug_sqrt_hz: Floor3 | None = Field(
        default=None, description="The same as a noise density, ug/sqrt(Hz)"
    )
    noise_density_m_s2_sqrt_hz: Floor3 | None = Field(
        default=None, description="The same as a noise density, m/s^2/sqrt(Hz)"
    )
    range_g: Positive | None = Field(default=None, description="Full scale, g; beyond it the output clips")
    increment_lsb_mm_s: Positive | None = Field(
        default=None,
        description="Resolution of a velocity increment, mm/s; the rounding error is carried over",
    )

    @property
    def density(self) -> Array:
        """Root of the two-sided noise density, m/s/sqrt(s), shape (3,)."""
        if self.noise_density_ug_sqrt_hz is not None:
            return self._density(self.noise_density_ug_sqrt_hz, units.UG_TO_M_S2)
        if self.noise_density_m_s2_sqrt_hz is not None:
            return self._density(self.noise_density_m_s2_sqrt_hz, 1.0)
        return np.asarray(self.vrw_m_s_sqrt_h) * units.M_S_SQRT_H_TO_M_S_SQRT_S

    @model_validator(mode="after")
    def _consistent(self) -> AccelSensor:
        keys = ("noise_density_ug_sqrt_hz", "noise_density_m_s2_sqrt_hz")
        self._one_noise(self.vrw_m_s_sqrt_h, {key: getattr(self, key) for key in keys})
        return self


class ImuError(Section):
    """``[[imu.error]]``: one slowly varying error of a triad, measured minus true.

    Scale factors and misalignments multiply the true input. A misalignment has six terms, in the order xy,
    xz, yx, yz, zx, zy: xy is the share of the y input in the x output.
    """

    kind: ErrorKind = Field(description="What the error acts on")
    name: str | None = Field(default=None, description="Name of the block; left out: the kind")
    process: Literal["constant", "random_walk", "gauss_markov"] = Field(
        default="constant",
        description="constant: initial_sd (drawn once) or value (fixed); random_walk: walk and perhaps "
        "initial_sd; gauss_markov: sd (stationary from the first sample on) and tau_s",
    )
    unit: str = Field(description="Unit of the figures below; of walk times sqrt(s)")
    initial_sd: Numbers | None = Field(
        default=None, description="Standard deviation at the start, drawn per run"
    )
    value: Numbers | None = Field(
        default=None, description="Fixed value of a constant, instead of a drawn one"
    )
    walk: Numbers | None = Field(default=None, description="random_walk: drift in the unit per sqrt(s)")
    sd: Numbers | None = Field(default=None, description="gauss_markov: steady standard deviation")
    tau_s: Positive | None = Field(default=None, description="gauss_markov: correlation time, s")

    @property
    def size(self) -> int:
        """Number of components: 3, or 6 for a misalignment."""
        return BLOCK_SIZES[self.kind]

    @property
    def block_name(self) -> str:
        """Name of the filter block that estimates this error."""
        return self.name or self.kind

    def si(self, key: Literal["initial_sd", "value", "walk", "sd"]) -> Array:
        """One of the figures in SI, shape (size,); zero if it is not given."""
        value = getattr(self, key)
        numbers = np.asarray(0.0 if value is None else value, dtype=np.float64)
        return np.broadcast_to(numbers * BLOCK_UNITS[self.kind][self.unit], (self.size,))

    @model_validator(mode="after")
    def _consistent(self) -> ImuError:
        table = BLOCK_UNITS[self.kind]
        problems = []
        if self.unit not in table:
            text = f'not a unit of kind = "{self.kind}", which takes {choices(table)}'
            problems.append(Problem("config.unit", text, key="unit"))
        given = {
            key for key in ("initial_sd", "value", "walk", "sd", "tau_s") if getattr(self, key) is not None
        }
        accepted: dict[str, tuple[set[str], ...]] = {
            "constant": ({"initial_sd"}, {"value"}),
            "random_walk": ({"walk"}, {"initial_sd", "walk"}),
            "gauss_markov": ({"sd", "tau_s"},),
        }
        if given not in accepted[self.process]:
            takes = ", or ".join(" and ".join(sorted(keys)) for keys in accepted[self.process])
            got = ", ".join(sorted(given)) or "none of them"
            problems.append(
                Problem("config.conflict", f'process = "{self.process}" takes {takes}; got {got}')
            )
        problems += [problem for key in sorted(given - {"tau_s"}) for problem in self._figure_problems(key)]
        refuse(problems)
        return self

    def _figure_problems(self, key: str) -> list[Problem]:
        value = getattr(self, key)
        values = value if isinstance(value, tuple) else (value,)
        if isinstance(value, tuple) and len(value) != self.size:
            text = f'must be one number or {self.size} numbers for kind = "{self.kind}", not {len(value)}'
            return [Problem("config.type", text, key=key)]
        if key != "value" and min(values) < 0.0:
            return [Problem("config.range", "must not be negative", key=key)]
        return []


class Imu(Section):
    """``[imu]``: the inertial sensors."""

    gyro: GyroSensor = Field(default=GyroSensor(), description="White noise, range, resolution of the gyros")
    accel: AccelSensor = Field(default=AccelSensor(), description="The same of the accelerometers")
    error: Annotated[tuple[ImuError, ...], Field(strict=False)] = Field(
        default=(), description="Slowly varying errors, in the order of the filter blocks"
    )

    @model_validator(mode="after")
    def _names_differ(self) -> Imu:
        names = [error.block_name for error in self.error]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            text = f"errors with the same name: {', '.join(twice)}"
            refuse([Problem("config.conflict", text, "give each [[imu.error]] its own name", "error")])
        return self
