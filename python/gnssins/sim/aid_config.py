"""Scenario tables of the aids: receiver, barometric altimeter, heading of two antennas.

Keys and units are those of the run configuration wherever both mean the same thing.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from ..config.base import Floor3, Positive, Problem, Sd3, Section, Vec3, refuse

__all__ = [
    "Baro",
    "CorrelatedPosition",
    "CorrelatedVelocity",
    "Gnss",
    "Heading",
    "Outages",
    "Sampled",
    "outage_problems",
]

_ZERO = (0.0, 0.0, 0.0)

Outages = Annotated[tuple[Annotated[tuple[float, float], Field(strict=False)], ...], Field(strict=False)]
"""Times [from, to) without fixes, seconds."""

Times = Annotated[tuple[Annotated[float, Field(ge=0.0)], ...], Field(strict=False)]
"""Times, seconds."""


def outage_problems(outages: tuple[tuple[float, float], ...]) -> list[Problem]:
    """Refuse outages that do not run forward."""
    return [
        Problem("config.range", f"must satisfy 0 <= from < to, got [{first:g}, {last:g}]", key="outages")
        for first, last in outages
        if not 0.0 <= first < last
    ]


class Sampled(Section):
    """An aid with a rate of its own; values are valid at ``first_s + k / rate_hz``."""

    rate_hz: Positive = Field(description="Values per second")
    first_s: float | None = Field(
        default=None,
        ge=0.0,
        description="Validity of the first value, s; left out: one period after the start",
    )
    latency_ms: float = Field(default=0.0, ge=0.0, description="Stamp minus validity, ms")


class CorrelatedPosition(Section):
    """``[gnss.position_error]``: first-order Gauss-Markov error of the fixes along north, east, down.

    Its correlation fades with time and with the distance travelled over the ground: the rate is
    ``1/tau_s + V_ground/distance_m``.
    """

    sd_m: Floor3 = Field(description="Stationary standard deviation, m")
    tau_s: Positive = Field(description="Correlation time, s")
    distance_m: Positive | None = Field(
        default=None, description="Correlation length over the ground, m; left out: without end"
    )
    jump_sd_m: Floor3 = Field(default=_ZERO, description="Jump of the error at each constellation change, m")


class CorrelatedVelocity(Section):
    """``[gnss.velocity_error]``: the same for the velocity of the fixes."""

    sd_m_s: Floor3 = Field(description="Stationary standard deviation, m/s")
    tau_s: Positive = Field(description="Correlation time, s")
    distance_m: Positive | None = Field(
        default=None, description="Correlation length over the ground, m; left out: without end"
    )
    jump_sd_m_s: Floor3 = Field(
        default=_ZERO, description="Jump of the error at each constellation change, m/s"
    )


class Gnss(Sampled):
    """``[gnss]``: the receiver. Fixes are valid at ``first_s + k / rate_hz``."""

    position_sd_m: Sd3 | None = Field(default=None, description="White position noise N, E, D, m")
    velocity_sd_m_s: Sd3 | None = Field(default=None, description="White velocity noise N, E, D, m/s")
    position_error: CorrelatedPosition | None = Field(default=None, description="Correlated position error")
    velocity_error: CorrelatedVelocity | None = Field(default=None, description="Correlated velocity error")
    constellation_changes: Times = Field(
        default=(), description="Times at which the receiver changes its set of satellites, s"
    )
    position_jump_sd_m: Floor3 = Field(
        default=_ZERO, description="Further white noise of the first fix after a change, m"
    )
    velocity_jump_sd_m_s: Floor3 = Field(default=_ZERO, description="The same of its velocity, m/s")
    lever_ba_b_m: Vec3 = Field(default=_ZERO, description="Antenna from the IMU, forward, right, down, m")
    lever_error_sd_m: Floor3 = Field(default=_ZERO, description="Doubt about the lever arm, drawn per run, m")
    outages: Outages = Field(default=(), description="Times [from, to) without fixes, s")

    @model_validator(mode="after")
    def _consistent(self) -> Gnss:
        problems = outage_problems(self.outages)
        if self.position_sd_m is None and self.velocity_sd_m_s is None:
            problems.append(Problem("config.missing_key", "needs position_sd_m, velocity_sd_m_s or both"))
        jumps = [] if self.constellation_changes else self._jumps()
        problems += [
            Problem(
                "config.conflict", "jumps without constellation_changes", "add the times of the changes", key
            )
            for key in jumps
        ]
        refuse(problems)
        return self

    def _jumps(self) -> list[str]:
        """Keys of the jumps that are not zero."""
        position, velocity = self.position_error, self.velocity_error
        jumps = {
            "position_jump_sd_m": self.position_jump_sd_m,
            "velocity_jump_sd_m_s": self.velocity_jump_sd_m_s,
            "position_error.jump_sd_m": position.jump_sd_m if position is not None else _ZERO,
            "velocity_error.jump_sd_m_s": velocity.jump_sd_m_s if velocity is not None else _ZERO,
        }
        return [key for key, sd in jumps.items() if any(sd)]


class Baro(Sampled):
    """``[baro]``: a barometric altimeter, ``measured = height + bias + noise``; the bias is a random walk."""

    height_sd_m: Positive = Field(description="White noise of the heights, m")
    bias_initial_sd_m: float = Field(
        default=0.0, ge=0.0, description="Standard deviation of the bias at the start, drawn per run, m"
    )
    bias_walk_m_sqrt_s: float = Field(default=0.0, ge=0.0, description="Drift of the bias, m per sqrt(s)")


class Heading(Sampled):
    """``[heading]``: heading from two antennas, seen when the fixes are seen."""

    heading_sd_deg: Positive = Field(description="White noise of the headings, deg")
