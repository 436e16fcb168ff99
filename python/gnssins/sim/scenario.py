"""The scenario of a simulated run: a strict model of a TOML file.

A scenario says how the vehicle moves, what its sensors are like and how well the start is known. The motion
is a list of manoeuvres (``[[turn]]``, ``[[slope]]``, ``[[speed]]``, in any order, overlapping at will), a list
of ``[[waypoint]]``, or an ``[analytic]`` track; ``[[sway]]`` adds attitude oscillations to all of them. Figures
keep the units of data sheets here; the modules that use them convert. Sensor axes are forward, right, down; a
single number stands for three equal axes.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from .. import units
from ..config.base import Floor3, Positive, Problem, Section, refuse
from .aid_config import Baro, Gnss, Heading, Outages, outage_problems
from .motion_config import Analytic, MotionSettings, Slope, Speed, Sway, Turn, Waypoint
from .sensor_config import Imu

__all__ = ["About", "InitialError", "Scenario", "Start", "TruthModel", "Variant"]

_LAX = Field(strict=False)


class About(Section):
    """``[scenario]``: name, length and rate."""

    name: str = Field(description="Name of the scenario")
    description: str = Field(default="", description="What it shows")
    duration_s: Positive | None = Field(
        default=None, description="Length, s; waypoints may leave it out: until the last one is reached"
    )
    rate_hz: float = Field(default=100.0, gt=0.0, le=10_000.0, description="IMU samples per second")
    vehicle: Literal["aircraft", "car", "ship"] = Field(default="aircraft", description="Sets how it banks")


class TruthModel(Section):
    """``[truth]``: the navigation equations that the true motion obeys to the last digit."""

    model: Literal["ned", "ecef"] = Field(default="ned", description="Mechanisation of the engine")
    ellipsoid: Literal["wgs84", "grs80", "pz90", "krasovsky"] = Field(
        default="wgs84", description="Ellipsoid"
    )
    gravity: Literal["normal", "vertical"] = Field(
        default="normal", description="Normal gravity with its north component, or along the vertical only"
    )
    coning: Literal["two-sample", "one-sample", "third-order"] = Field(
        default="two-sample", description="Coning and sculling algorithm that the increments suit exactly"
    )


class Start(Section):
    """``[start]``: where and how the motion begins; roll and pitch follow from the motion."""

    lat_deg: float = Field(ge=-90.0, le=90.0, description="Latitude, deg; of [analytic] its constant term")
    lon_deg: float = Field(ge=-180.0, le=360.0, description="Longitude, deg; the same")
    height_m: float = Field(default=0.0, description="Height above the ellipsoid, m; the same")
    speed_m_s: float = Field(default=0.0, ge=0.0, description="Speed, m/s")
    rest_s: float = Field(
        default=0.0, ge=0.0, description="Time at rest before the first waypoint is made for, s"
    )
    heading_deg: float | None = Field(
        default=None, ge=-360.0, le=360.0, description="Heading, deg; waypoints give it themselves"
    )


class InitialError(Section):
    """``[initial_error]``: how well the start is known; drawn per run, axes north, east, down."""

    attitude_sd_deg: Floor3 | None = Field(
        default=None, description="Standard deviation of the attitude, deg"
    )
    attitude_sd_arcmin: Floor3 | None = Field(default=None, description="The same in arcmin")
    velocity_sd_m_s: Floor3 = Field(description="Standard deviation of the velocity, m/s")
    position_sd_m: Floor3 = Field(description="Standard deviation of the position, m")

    @model_validator(mode="after")
    def _one_unit(self) -> InitialError:
        if (self.attitude_sd_deg is None) == (self.attitude_sd_arcmin is None):
            refuse([Problem("config.conflict", "needs exactly one of attitude_sd_deg, attitude_sd_arcmin")])
        return self

    @property
    def attitude_sd_rad(self) -> tuple[float, float, float]:
        """Standard deviations of the attitude error along north, east, down, rad."""
        factor = units.DEG_TO_RAD if self.attitude_sd_deg is not None else units.DEG_TO_RAD / 60.0
        north, east, down = self.attitude_sd_deg or self.attitude_sd_arcmin or (0.0, 0.0, 0.0)
        return (north * factor, east * factor, down * factor)


class Variant(Section):
    """``[variant.NAME]``: what a named variant changes. Each table that it gives replaces that of the scenario."""

    outages: Outages | None = Field(
        default=None, description="Times [from, to) without fixes, s; left out: those of the scenario"
    )
    sway: Annotated[tuple[Sway, ...], _LAX] | None = Field(default=None, description="Attitude oscillations")
    imu: Imu | None = Field(default=None, description="Inertial sensors")
    gnss: Gnss | None = Field(default=None, description="Receiver")
    baro: Baro | None = Field(default=None, description="Barometric altimeter")
    heading: Heading | None = Field(default=None, description="Heading of two antennas")
    initial_error: InitialError | None = Field(default=None, description="How well the start is known")

    @model_validator(mode="after")
    def _consistent(self) -> Variant:
        refuse(outage_problems(self.outages or ()))
        return self


class Scenario(Section):
    """A whole scenario; attributes are named like the tables of the TOML file."""

    version: Literal[1] = Field(default=1, description="Version of the file format")
    scenario: About = Field(description="Name, length, rate")
    truth: TruthModel = Field(default=TruthModel(), description="Equations of the true motion")
    start: Start = Field(description="Where and how the motion begins")
    motion: MotionSettings = Field(default=MotionSettings(), description="Ramps and attitude")
    turn: Annotated[tuple[Turn, ...], _LAX] = Field(default=(), description="Turns")
    slope: Annotated[tuple[Slope, ...], _LAX] = Field(default=(), description="Climbs and descents")
    speed: Annotated[tuple[Speed, ...], _LAX] = Field(default=(), description="Changes of speed")
    sway: Annotated[tuple[Sway, ...], _LAX] = Field(default=(), description="Attitude oscillations")
    waypoint: Annotated[tuple[Waypoint, ...], _LAX] = Field(default=(), description="Route by waypoints")
    analytic: Analytic | None = Field(default=None, description="Coordinates as functions of time")
    imu: Imu = Field(default=Imu(), description="Inertial sensors; left out: perfect ones")
    gnss: Gnss | None = Field(default=None, description="Receiver; left out: no fixes")
    baro: Baro | None = Field(default=None, description="Barometric altimeter; left out: none")
    heading: Heading | None = Field(default=None, description="Heading of two antennas; left out: none")
    initial_error: InitialError = Field(description="How well the start is known")
    variant: dict[str, Variant] = Field(default_factory=dict, description="Named variants")

    @property
    def name(self) -> str:
        """Name of the scenario."""
        return self.scenario.name

    def with_variant(self, name: str) -> Scenario:
        """Return the scenario with the tables of one of its variants; outages stay where they are.

        Parameters
        ----------
        name : str
            One of ``variant``.

        Returns
        -------
        Scenario
            The same object if the variant changes no table.
        """
        given = self.variant[name]
        tables = {
            key: getattr(given, key)
            for key in type(given).model_fields
            if key != "outages" and getattr(given, key) is not None
        }
        return self.model_copy(update=tables) if tables else self

    @property
    def coordination(self) -> float:
        """Share of the coordinated bank in turns."""
        if self.motion.coordination is not None:
            return self.motion.coordination
        return 1.0 if self.scenario.vehicle == "aircraft" else 0.0

    @model_validator(mode="after")
    def _one_kind_of_motion(self) -> Scenario:
        problems = []
        if self.analytic is not None:
            problems = self._analytic_problems()
        elif self.waypoint:
            if self.turn or self.slope or self.speed:
                text = "does not go with turn, slope and speed"
                problems.append(Problem("config.conflict", text, "use one kind of motion", "waypoint"))
            if self.start.heading_deg is not None:
                text = "heading_deg is set by the first waypoint"
                problems.append(Problem("config.conflict", text, "leave heading_deg out", "start"))
            if self.start.rest_s > 0.0 and self.start.speed_m_s > 0.0:
                problems.append(Problem("config.conflict", "rest_s needs speed_m_s = 0", key="start"))
        else:
            if self.start.rest_s > 0.0:
                text = "rest_s goes with waypoints only"
                problems.append(Problem("config.conflict", text, "let the manoeuvres begin later", "start"))
            if self.start.heading_deg is None:
                problems.append(Problem("config.missing_key", "needs heading_deg", key="start"))
            if self.scenario.duration_s is None:
                problems.append(Problem("config.missing_key", "needs duration_s", key="scenario"))
        refuse(problems)
        return self

    def _analytic_problems(self) -> list[Problem]:
        """What does not go with an analytic track, which gives speed and heading itself."""
        given = {
            "waypoint": self.waypoint,
            "turn": self.turn,
            "slope": self.slope,
            "speed": self.speed,
            "start.speed_m_s": self.start.speed_m_s,
            "start.rest_s": self.start.rest_s,
            "start.heading_deg": self.start.heading_deg is not None,
            "motion.heading_reference": self.motion.heading_reference != "north",
        }
        problems = [
            Problem("config.conflict", "does not go with analytic", "leave it out", key)
            for key, value in given.items()
            if value
        ]
        if self.scenario.duration_s is None:
            problems.append(Problem("config.missing_key", "needs duration_s", key="scenario"))
        return problems

    @model_validator(mode="after")
    def _targets_are_clear(self) -> Scenario:
        spans = sorted(self.speed, key=lambda span: span.from_s)
        for before, after in pairwise(spans):
            if after.from_s < before.to_s and (before.target_m_s, after.target_m_s) != (None, None):
                where = f"the changes from {before.from_s:g} s and from {after.from_s:g} s overlap"
                text = f"{where}, and one has target_m_s"
                refuse([Problem("config.conflict", text, "use change_m_s where changes overlap", "speed")])
        return self
