"""Scenario tables that say how the vehicle moves: manoeuvres in time, or waypoints in space."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..config.base import Positive, Problem, Section, refuse

__all__ = [
    "Analytic",
    "AngleTerms",
    "HeightTerms",
    "MotionSettings",
    "Slope",
    "Speed",
    "Sway",
    "Turn",
    "Waypoint",
]

NotNegative = Annotated[float, Field(ge=0.0)]
"""A number of 0 or greater."""


class MotionSettings(Section):
    """``[motion]``: ramps of the manoeuvres, and how the attitude follows the path."""

    turn_ramp_s: NotNegative = Field(default=5.0, description="Time in which a turn rate builds up, s")
    slope_ramp_s: NotNegative = Field(default=6.0, description="Time in which a path angle builds up, s")
    coordination: float | None = Field(
        default=None,
        ge=-1.0,
        le=1.0,
        description="Share of the coordinated bank in turns; left out: 1 for an aircraft, 0 for a car or a "
        "ship",
    )
    heading_reference: Literal["north", "grid"] = Field(
        default="north",
        description="What headings count from: true north, or the meridian of the start carried along in the "
        "polar stereographic plane, so that a straight track stays straight next to a pole",
    )
    turn_radius_m: Positive = Field(default=200.0, description="Radius of the turns at waypoints, m")
    accel_m_s2: Positive = Field(
        default=1.0, description="Greatest acceleration of speed changes between waypoints, m/s^2"
    )


class Turn(Section):
    """``[[turn]]``: a heading rate held for a time; the heading changes by their product."""

    start_s: NotNegative = Field(description="When the rate starts to build up, s")
    length_s: Positive = Field(description="Time from the start to the start of the roll-out, s")
    rate_deg_s: float = Field(description="Heading rate, deg/s, right turns positive")
    ramp_s: NotNegative | None = Field(default=None, description="Ramp of this turn, s")


class _Span(Section):
    from_s: NotNegative = Field(description="When the ramp in starts, s")
    to_s: NotNegative = Field(
        description="When the ramp out starts, s (of a speed change: when it is complete)"
    )

    @model_validator(mode="after")
    def _forward(self) -> _Span:
        if self.to_s <= self.from_s:
            text = f"must be after from_s = {self.from_s:g}, is {self.to_s:g}"
            refuse([Problem("config.range", text, key="to_s")])
        return self


class Slope(_Span):
    """``[[slope]]``: a path angle, kept from one time to another."""

    angle_deg: float = Field(ge=-60.0, le=60.0, description="Path angle, deg, up positive")
    ramp_s: NotNegative | None = Field(default=None, description="Ramp of this slope, s")


class Speed(_Span):
    """``[[speed]]``: a smooth change of speed, by a difference or to a target."""

    change_m_s: float | None = Field(default=None, description="Change of speed, m/s")
    target_m_s: NotNegative | None = Field(default=None, description="Speed after the change, m/s")

    @model_validator(mode="after")
    def _one(self) -> Speed:
        if (self.change_m_s is None) == (self.target_m_s is None):
            refuse([Problem("config.conflict", "needs exactly one of change_m_s, target_m_s")])
        return self


class Sway(Section):
    """``[[sway]]``: oscillation of one attitude angle; the path is not touched."""

    axis: Literal["roll", "pitch", "heading"] = Field(description="Angle that oscillates")
    amplitude_deg: float = Field(description="Amplitude, deg")
    period_s: Positive = Field(description="Period, s")
    phase_deg: float = Field(default=0.0, description="Phase at from_s, deg")
    from_s: NotNegative = Field(default=0.0, description="When the oscillation starts to grow, s")
    to_s: Positive | None = Field(default=None, description="When it starts to fade, s; left out: never")
    ramp_s: NotNegative | None = Field(
        default=None, description="Time to grow or fade, s; left out: one period"
    )

    @model_validator(mode="after")
    def _forward(self) -> Sway:
        if self.to_s is not None and self.to_s <= self.from_s:
            text = f"must be after from_s = {self.from_s:g}, is {self.to_s:g}"
            refuse([Problem("config.range", text, key="to_s")])
        return self


class Waypoint(Section):
    """``[[waypoint]]``: a corner of the route, given in degrees or in metres north and east of the start."""

    lat_deg: float | None = Field(default=None, gt=-89.0, lt=89.0, description="Latitude, deg")
    lon_deg: float | None = Field(default=None, ge=-180.0, le=360.0, description="Longitude, deg")
    north_m: float | None = Field(default=None, description="Distance north of the start, m")
    east_m: float | None = Field(default=None, description="Distance east of the start, m")
    height_m: float | None = Field(default=None, description="Height to reach here, m; left out: as before")
    speed_m_s: Positive | None = Field(
        default=None, description="Ground speed on the leg that ends here, m/s; left out: as before"
    )
    turn_radius_m: Positive | None = Field(default=None, description="Radius of the turn at this point, m")
    turn_speed_m_s: Positive | None = Field(
        default=None, description="Ground speed in the turn at this point, m/s; left out: that of the leg"
    )
    stop_s: NotNegative | None = Field(
        default=None,
        description="Time at rest before the turn at this point, s; at the last point: arrive at rest",
    )

    @model_validator(mode="after")
    def _one_kind(self) -> Waypoint:
        given = {key for key in ("lat_deg", "lon_deg", "north_m", "east_m") if getattr(self, key) is not None}
        if given not in ({"lat_deg", "lon_deg"}, {"north_m", "east_m"}):
            refuse([Problem("config.conflict", "needs lat_deg and lon_deg, or north_m and east_m")])
        return self


class AngleTerms(Section):
    """``[analytic.lat]``, ``[analytic.lon]``: ``angle0 + K t + D sin(2 pi t / T + d)``; angle0 is in ``[start]``."""

    rate_rad_s: float = Field(default=0.0, description="Linear term K, rad/s")
    amplitude_rad: float = Field(default=0.0, ge=-1.0, le=1.0, description="Amplitude D, rad")
    period_s: Positive = Field(default=600.0, description="Period T, s")
    phase_rad: float = Field(default=0.0, description="Phase d, rad")


class HeightTerms(Section):
    """``[analytic.height]``: ``h0 + K t - D cos(2 pi t / T + d)``; h0 is ``height_m`` in ``[start]``."""

    rate_m_s: float = Field(default=0.0, description="Linear term K, m/s")
    amplitude_m: float = Field(default=0.0, description="Amplitude D, m")
    period_s: Positive = Field(default=600.0, description="Period T, s")
    phase_rad: float = Field(default=0.0, description="Phase d, rad")


class Analytic(Section):
    """``[analytic]``: latitude, longitude and height as functions of time, and what the attitude makes of them."""

    lat: AngleTerms = Field(default=AngleTerms(), description="Latitude")
    lon: AngleTerms = Field(default=AngleTerms(), description="Longitude")
    height: HeightTerms = Field(default=HeightTerms(), description="Height above the ellipsoid")
    bank_gain_rad_s2_m: float = Field(
        default=0.02,
        description="Roll per acceleration across the track, rad/(m/s^2), the factor 1/cos(pitch) aside; a "
        "coordinated turn has 0.10",
    )
