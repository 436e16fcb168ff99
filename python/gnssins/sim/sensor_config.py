"""Scenario tables of the sensors: what the simulated IMU and the simulated receiver do to the truth.

Keys and units are those of the run configuration wherever both mean the same thing, so that blocks can be
copied from a scenario into a filter.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from ..config.base import Floor3, Positive, Problem, Sd3, Section, Vec3, choices, refuse
from ..config.filter import BLOCK_SIZES, BLOCK_UNITS, Numbers

__all__ = ["AccelSensor", "CorrelatedPosition", "CorrelatedVelocity", "Gnss", "GyroSensor", "Imu", "ImuError"]

ErrorKind = Literal[
    "gyro_bias", "accel_bias", "gyro_scale", "accel_scale", "gyro_misalignment", "accel_misalignment"
]

_ZERO = (0.0, 0.0, 0.0)

Outages = Annotated[tuple[Annotated[tuple[float, float], Field(strict=False)], ...], Field(strict=False)]
"""Times [from, to) without fixes, seconds."""


def outage_problems(outages: tuple[tuple[float, float], ...]) -> list[Problem]:
    """Refuse outages that do not run forward."""
    return [
        Problem("config.range", f"must satisfy 0 <= from < to, got [{first:g}, {last:g}]", key="outages")
        for first, last in outages
        if not 0.0 <= first < last
    ]


class GyroSensor(Section):
    """``[imu.gyro]``: white noise, range and resolution of the gyros."""

    arw_deg_sqrt_h: Floor3 = Field(default=_ZERO, description="Angle random walk, deg/sqrt(h)")
    range_deg_s: Positive | None = Field(
        default=None, description="Full scale, deg/s; beyond it the output clips"
    )
    increment_lsb_arcsec: Positive | None = Field(
        default=None,
        description="Resolution of an angle increment, arcsec; the rounding error is carried over",
    )


class AccelSensor(Section):
    """``[imu.accel]``: white noise, range and resolution of the accelerometers."""

    vrw_m_s_sqrt_h: Floor3 = Field(default=_ZERO, description="Velocity random walk, m/s/sqrt(h)")
    range_g: Positive | None = Field(default=None, description="Full scale, g; beyond it the output clips")
    increment_lsb_mm_s: Positive | None = Field(
        default=None,
        description="Resolution of a velocity increment, mm/s; the rounding error is carried over",
    )


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

    def si(self, key: Literal["initial_sd", "value", "walk", "sd"]) -> NDArray[np.float64]:
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


class CorrelatedPosition(Section):
    """``[gnss.position_error]``: first-order Gauss-Markov error of the fixes along north, east, down."""

    sd_m: Floor3 = Field(description="Stationary standard deviation, m")
    tau_s: Positive = Field(description="Correlation time, s")


class CorrelatedVelocity(Section):
    """``[gnss.velocity_error]``: the same for the velocity of the fixes."""

    sd_m_s: Floor3 = Field(description="Stationary standard deviation, m/s")
    tau_s: Positive = Field(description="Correlation time, s")


class Gnss(Section):
    """``[gnss]``: the receiver. Fixes are valid at ``first_s + k / rate_hz``."""

    rate_hz: Positive = Field(description="Fixes per second")
    first_s: float | None = Field(
        default=None, ge=0.0, description="Validity of the first fix, s; left out: one period after the start"
    )
    latency_ms: float = Field(default=0.0, ge=0.0, description="Stamp minus validity, ms")
    position_sd_m: Sd3 | None = Field(default=None, description="White position noise N, E, D, m")
    velocity_sd_m_s: Sd3 | None = Field(default=None, description="White velocity noise N, E, D, m/s")
    position_error: CorrelatedPosition | None = Field(default=None, description="Correlated position error")
    velocity_error: CorrelatedVelocity | None = Field(default=None, description="Correlated velocity error")
    lever_ba_b_m: Vec3 = Field(default=_ZERO, description="Antenna from the IMU, forward, right, down, m")
    lever_error_sd_m: Floor3 = Field(default=_ZERO, description="Doubt about the lever arm, drawn per run, m")
    outages: Outages = Field(default=(), description="Times [from, to) without fixes, s")

    @model_validator(mode="after")
    def _consistent(self) -> Gnss:
        problems = outage_problems(self.outages)
        if self.position_sd_m is None and self.velocity_sd_m_s is None:
            problems.append(Problem("config.missing_key", "needs position_sd_m, velocity_sd_m_s or both"))
        refuse(problems)
        return self
