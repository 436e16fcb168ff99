"""Sections ``[run]`` and ``[initial]``: which part of the log to process, and what is known at its start."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from .base import Positive, Problem, Sd3, Section, Vec3, invalid, is_number, refuse


def _windows(value: Any) -> Any:
    """Accept [[from, to], ...] in rising order."""
    if not isinstance(value, (list, tuple)):
        raise invalid("config.type", "must be a list of [from_s, to_s] pairs")
    last = float("-inf")
    for number, pair in enumerate(value, start=1):
        if not (isinstance(pair, (list, tuple)) and len(pair) == 2 and all(map(is_number, pair))):
            raise invalid("config.type", f"pair {number} must be [from_s, to_s]")
        if not last <= pair[0] < pair[1]:
            raise invalid(
                "config.range",
                f"pair {number} [{pair[0]:g}, {pair[1]:g}] must rise and start after the pair before it",
                "sort the windows by time and merge those that overlap",
            )
        last = pair[1]
    return tuple(tuple(pair) for pair in value)


def _velocity(value: Any) -> Any:
    """Accept the word gnss or a vector."""
    if value == "gnss":
        return value
    if isinstance(value, (list, tuple)) and len(value) == 3 and all(map(is_number, value)):
        return tuple(value)
    raise invalid("config.choice", 'must be "gnss", or three numbers: north, east, down in m/s')


def _position(value: Any) -> Any:
    """Accept the word gnss or a table with latitude, longitude and height."""
    if value == "gnss" or isinstance(value, (dict, GeoPoint)):
        return value
    raise invalid(
        "config.choice", 'must be "gnss", or a table { lat_deg = ..., lon_deg = ..., height_m = ... }'
    )


def _position_form(value: Any) -> str:
    """Name the form of a position, so that only the problems of that form are told."""
    return "gnss" if value == "gnss" else GeoPoint.__name__


class RunConfig(Section):
    """Which part of the log to process and what to write."""

    start_s: float | None = Field(
        default=None,
        description="Start of the filter, s on the clock of the IMU log; left out: the first moment with all "
        "data",
        examples=[38.0],
    )
    end_s: float | None = Field(
        default=None,
        description="End, s on the clock of the IMU log; left out: the end of the log",
        examples=[540.0],
    )
    output_rate_hz: Positive | None = Field(
        default=None, description="Rows of the result per second; left out: every IMU row", examples=[10.0]
    )
    covariance_interval_s: Positive | None = Field(
        default=None,
        description="Keep the full covariance matrix every so many seconds; left out: standard deviations "
        "only",
        examples=[1.0],
    )
    linearise: bool = Field(
        default=False,
        description="Keep the linearised system, transition and rows between measurements, for the analysis of "
        "observability; needs n x n numbers per measurement",
    )
    outages: Annotated[tuple[tuple[float, float], ...], BeforeValidator(_windows)] = Field(
        default=(),
        description="GNSS withheld, [[from_s, to_s], ...]; the withheld fixes become the truth of an outage "
        "test",
    )

    @model_validator(mode="after")
    def _rising(self) -> RunConfig:
        if self.start_s is not None and self.end_s is not None and self.end_s <= self.start_s:
            refuse([Problem("config.range", f"must be greater than start_s = {self.start_s:g}", "", "end_s")])
        return self


class GeoPoint(Section):
    """A position on or above the ellipsoid."""

    lat_deg: float = Field(
        ge=-90.0, le=90.0, description="Geodetic latitude, deg, north positive", examples=[48.78]
    )
    lon_deg: float = Field(ge=-180.0, le=360.0, description="Longitude, deg, east positive", examples=[9.17])
    height_m: float = Field(
        ge=-12_000.0, le=1e8, description="Height above the ellipsoid, m", examples=[320.0]
    )


class InitialConfig(Section):
    """What is known at the start. Left-out standard deviations of position and velocity come from the fix."""

    position: Annotated[
        Annotated[Literal["gnss"], Tag("gnss")] | Annotated[GeoPoint, Tag("GeoPoint")],
        Discriminator(_position_form),
        BeforeValidator(_position),
    ] = Field(
        default="gnss",
        description="gnss: from the fixes at the start; or { lat_deg = ..., lon_deg = ..., height_m = ... } "
        "of the IMU",
    )
    velocity: Annotated[Literal["gnss"] | Vec3, BeforeValidator(_velocity)] = Field(
        default="gnss", description="gnss: from the fixes at the start; or [north, east, down] in m/s"
    )
    leveling: Literal["accel"] | None = Field(
        default=None,
        description="accel: roll and pitch from the direction of gravity in the accelerometer, corrected for "
        "the "
        "GNSS acceleration; this is what happens if roll_deg and pitch_deg are left out",
        examples=["accel"],
    )
    roll_deg: float | None = Field(
        default=None, ge=-180.0, le=180.0, description="Roll, deg, right side down positive", examples=[0.0]
    )
    pitch_deg: float | None = Field(
        default=None, ge=-90.0, le=90.0, description="Pitch, deg, nose up positive", examples=[0.0]
    )
    heading: Literal["course"] | None = Field(
        default=None,
        description="course: heading from the direction of the GNSS velocity, for vehicles that move forward "
        "at the "
        "start; this is what happens if heading_deg is left out",
        examples=["course"],
    )
    heading_deg: float | None = Field(
        default=None,
        ge=-180.0,
        le=360.0,
        description="Heading of the forward axis, deg clockwise from true north",
        examples=[90.0],
    )
    course_min_speed_m_s: Positive = Field(
        default=1.0, description="Slowest horizontal speed at which the course is taken for the heading, m/s"
    )
    leveling_window_s: Positive = Field(
        default=1.0, description="Length of IMU data at the start that is averaged for leveling, s"
    )
    position_sd_m: Sd3 | None = Field(
        default=None, description="Position north, east, down, m, 1 sigma", examples=[[5.0, 5.0, 10.0]]
    )
    velocity_sd_m_s: Sd3 | None = Field(
        default=None, description="Velocity north, east, down, m/s, 1 sigma", examples=[[0.5, 0.5, 0.5]]
    )
    roll_sd_deg: float = Field(default=2.0, gt=0.0, le=180.0, description="Roll, deg, 1 sigma")
    pitch_sd_deg: float = Field(default=2.0, gt=0.0, le=90.0, description="Pitch, deg, 1 sigma")
    heading_sd_deg: float = Field(default=10.0, gt=0.0, le=180.0, description="Heading, deg, 1 sigma")

    @model_validator(mode="after")
    def _consistent(self) -> InitialConfig:
        problems = []
        if (self.roll_deg is None) != (self.pitch_deg is None):
            missing = "roll_deg" if self.roll_deg is None else "pitch_deg"
            problems.append(
                Problem(
                    "config.conflict", "roll_deg and pitch_deg belong together", f"add {missing}", missing
                )
            )
        if self.leveling is not None and self.roll_deg is not None:
            problems.append(
                Problem(
                    "config.conflict", "stands beside roll_deg and pitch_deg", "keep one way only", "leveling"
                )
            )
        if self.heading is not None and self.heading_deg is not None:
            problems.append(
                Problem("config.conflict", "stands beside heading_deg", "keep one way only", "heading")
            )
        refuse(problems)
        return self
