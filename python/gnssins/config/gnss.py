"""Sections ``[gnss]`` and ``[truth]``: fixes, accuracy and antenna; the reference to compare with."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from .base import (
    Floor3,
    InputPath,
    Names3,
    Positive,
    Problem,
    Sd3,
    Section,
    Separator,
    Vec3,
    invalid,
    is_number,
    refuse,
)


def _reacquire(value: Any) -> Any:
    """Accept a number of fixes, or the word off."""
    if value == "off" or (isinstance(value, int) and not isinstance(value, bool) and 2 <= value <= 1_000_000):
        return value
    raise invalid(
        "config.range",
        'must be a whole number of fixes from 2 to 1000000, or "off"',
        "10 rejected fixes in a row are no accident",
    )


def accept_gate(value: Any) -> Any:
    """Accept a probability below 1, or the word off."""
    if value == "off" or (is_number(value) and 0.0 < value < 1.0):
        return value
    raise invalid(
        "config.range",
        'must be a probability between 0 and 1 (both excluded), or "off"',
        "0.999 turns away one good fix in a thousand",
    )


class GnssConfig(Section):
    """The GNSS log: where it is, what its columns mean, how far it can be trusted, where the antenna sits."""

    file: InputPath | None = Field(
        default=None,
        description="GNSS log, .csv or .csv.gz, with one header line; left out: no GNSS",
        examples=["gnss.csv.gz"],
    )
    separator: Separator = Field(default=",", description="Character between the cells of a line")
    time_column: str = Field(
        default="time_s", description="Column of the time stamps, on the clock of the IMU log"
    )
    time_unit: Literal["s", "ms", "us", "ns"] = Field(default="s", description="Unit of the time stamps")
    use: Literal["both", "position", "velocity"] = Field(
        default="both",
        description="What to use; a row that lacks one of the two is used for the other",
    )
    position_columns: Names3 = Field(
        default=("lat_deg", "lon_deg", "height_m"),
        description="Latitude, longitude, height above the ellipsoid in m",
    )
    angle_unit: Literal["deg", "rad"] = Field(default="deg", description="Unit of latitude and longitude")
    geoid_height_m: float = Field(
        default=0.0,
        ge=-200.0,
        le=200.0,
        description="Height of the geoid above the ellipsoid, m: added to heights that count from mean sea "
        "level",
    )
    velocity_columns: Names3 = Field(
        default=("vn", "ve", "vd"), description="Velocity columns in the order of velocity_axes, m/s"
    )
    velocity_axes: Literal["NED", "ENU"] = Field(
        default="NED", description="Axes of the velocity columns: north-east-down or east-north-up"
    )
    sd: Literal["file", "config"] = Field(
        default="file",
        description="1-sigma accuracy of the fixes. file: from the columns below, and from position_sd_m and "
        "velocity_sd_m_s where the file has none or nan; config: from those two keys only",
    )
    position_sd_columns: Names3 = Field(
        default=("sd_n", "sd_e", "sd_d"), description="Position accuracy north, east, down, m, 1 sigma"
    )
    velocity_sd_columns: Names3 = Field(
        default=("sd_vn", "sd_ve", "sd_vd"), description="Velocity accuracy north, east, down, m/s, 1 sigma"
    )
    position_sd_m: Sd3 | None = Field(
        default=None,
        description="Position accuracy north, east, down, m, 1 sigma",
        examples=[[2.0, 2.0, 4.0]],
    )
    velocity_sd_m_s: Sd3 | None = Field(
        default=None,
        description="Velocity accuracy north, east, down, m/s, 1 sigma",
        examples=[[0.2, 0.2, 0.4]],
    )
    sd_scale: Positive = Field(
        default=1.0, description="Factor on the accuracy columns of the file; receivers tend to be optimistic"
    )
    position_sd_floor_m: Floor3 = Field(
        default=(0.0, 0.0, 0.0),
        description="Smallest position accuracy taken from the file, m, after sd_scale",
    )
    velocity_sd_floor_m_s: Floor3 = Field(
        default=(0.0, 0.0, 0.0),
        description="Smallest velocity accuracy taken from the file, m/s, after sd_scale",
    )
    new_constellation_column: str = Field(
        default="new_constellation",
        description="Column that is not 0 where the receiver changed its set of satellites, so that its slow errors "
        "jumped; need not be there",
    )
    lever_ba_b_m: Vec3 = Field(
        default=(0.0, 0.0, 0.0),
        description="Lever arm from the IMU to the antenna, forward, right, down, m (antenna on the roof: "
        "last < 0)",
    )
    latency_ms: float = Field(
        default=0.0,
        description="Stamp minus time of validity, ms: positive if the stamps come late, negative if they "
        "are early",
        ge=-10_000.0,
        le=10_000.0,
    )
    gate_probability: Annotated[float | Literal["off"], BeforeValidator(accept_gate)] = Field(
        default=0.999,
        description="Chi-square gate: a fix that a right filter would see less often than 1 - p is rejected; "
        'or "off"',
    )
    reacquire_after: Annotated[int | Literal["off"], BeforeValidator(_reacquire)] = Field(
        default=10,
        description="Fixes rejected in a row after which the filter declares its own covariance too small, raises "
        'it as a counted event (filter.reset) and tries again; "off" never follows them',
    )
    gate: Literal["joint", "parts"] = Field(
        default="joint",
        description="joint: the whole fix passes the chi-square gate or none of it; parts: position and velocity are "
        "judged apart, and only what fails is dropped",
    )
    trace_ratio_limit: Positive | None = Field(
        default=None,
        description="Also drop position or velocity where innovation squared over the trace of its covariance reaches "
        "this (Novik 2011: at least 10); left out: no such test",
        examples=[10.0],
    )
    max_accel_m_s2: Positive | None = Field(
        default=None,
        description="Also drop position or velocity that the vehicle cannot have reached since the last accepted fix "
        "with this acceleration, m/s^2 (plus 7 sigma of the fix); left out: no such test",
        examples=[5.0],
    )
    missing: str = Field(
        default="nan", description="Text that stands for a missing value, beside an empty cell"
    )
    on_bad_row: Literal["stop", "skip"] = Field(
        default="stop",
        description="Rows that cannot be read: stop with the row and column, or skip and count them",
    )

    @property
    def uses_position(self) -> bool:
        """True if positions are used."""
        return self.use != "velocity"

    @property
    def uses_velocity(self) -> bool:
        """True if velocities are used."""
        return self.use != "position"

    @model_validator(mode="after")
    def _consistent(self) -> GnssConfig:
        problems = []
        if self.sd == "config":
            for used, key in (
                (self.uses_position, "position_sd_m"),
                (self.uses_velocity, "velocity_sd_m_s"),
            ):
                if used and getattr(self, key) is None:
                    problems.append(
                        Problem(
                            "config.missing_key",
                            f'missing, although sd = "config" and use = "{self.use}"',
                            f"add {key} = [north, east, down]",
                            key,
                        )
                    )
        names = [self.time_column]
        if self.uses_position:
            names += self.position_columns
        if self.uses_velocity:
            names += self.velocity_columns
        names.append(self.new_constellation_column)
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            problems.append(Problem("config.columns", f"column used twice: {', '.join(twice)}"))
        refuse(problems)
        return self


class TruthConfig(Section):
    """Reference trajectory, only to compare the result with; never seen by the filter."""

    file: InputPath | None = Field(
        default=None,
        description="Reference log, .csv or .csv.gz: time_s, lat_deg, lon_deg, height_m and, if known, vn, "
        "ve, vd "
        "(m/s) and roll_deg, pitch_deg, heading_deg or qw, qx, qy, qz (body to north-east-down); nan where "
        "unknown",
        examples=["ref.csv.gz"],
    )
