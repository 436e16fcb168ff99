"""Sections ``[baro]`` and ``[heading]``: a barometric altimeter, and a receiver with two antennas."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from .. import units
from .base import InputPath, Positive, Problem, Section, Separator, refuse
from .gnss import accept_gate


class _AidConfig(Section):
    """What the sections of all aids with one value per row have in common."""

    separator: Separator = Field(default=",", description="Character between the cells of a line")
    time_column: str = Field(
        default="time_s", description="Column of the time stamps, on the clock of the IMU log"
    )
    time_unit: Literal["s", "ms", "us", "ns"] = Field(default="s", description="Unit of the time stamps")
    latency_ms: float = Field(
        default=0.0,
        description="Stamp minus time of validity, ms: positive if the stamps come late, negative if they "
        "are early",
        ge=-10_000.0,
        le=10_000.0,
    )
    gate_probability: Annotated[float | Literal["off"], BeforeValidator(accept_gate)] = Field(
        default=0.999,
        description="Chi-square gate: a value that a right filter would see less often than 1 - p is rejected; "
        'or "off"',
    )
    missing: str = Field(
        default="nan", description="Text that stands for a missing value, beside an empty cell"
    )
    on_bad_row: Literal["stop", "skip"] = Field(
        default="stop",
        description="Rows that cannot be read: stop with the row and column, or skip and count them",
    )


def _one_column_each(*names: str) -> list[Problem]:
    """Refuse a column that is named twice."""
    twice = sorted({name for name in names if names.count(name) > 1})
    return [Problem("config.columns", f"column used twice: {', '.join(twice)}")] if twice else []


def _accuracy_given(sd: str, key: str, value: float | None) -> list[Problem]:
    """Refuse ``sd = "config"`` without the figure that it speaks of."""
    if sd != "config" or value is not None:
        return []
    return [Problem("config.missing_key", 'missing, although sd = "config"', f"add {key}", key)]


class BaroConfig(_AidConfig):
    """The log of a barometric altimeter: where it is, what its columns mean, how far it can be trusted."""

    file: InputPath | None = Field(
        default=None,
        description="Log of heights, .csv or .csv.gz, with one header line; left out: no barometer",
        examples=["baro.csv.gz"],
    )
    height_column: str = Field(default="height_m", description="Column of the heights")
    height_unit: Literal["m", "ft"] = Field(default="m", description="Unit of heights and their accuracy")
    geoid_height_m: float = Field(
        default=0.0,
        ge=-200.0,
        le=200.0,
        description="Height of the geoid above the ellipsoid, m: added to heights that count from mean sea "
        "level",
    )
    sd: Literal["file", "config"] = Field(
        default="file",
        description="1-sigma white noise of the heights. file: from sd_column, and from height_sd_m where the "
        "file has none or nan; config: from height_sd_m only",
    )
    sd_column: str = Field(default="sd", description="Column of the accuracy, in height_unit, 1 sigma")
    height_sd_m: Positive | None = Field(
        default=None,
        description="White noise of the heights, m, 1 sigma; the slow error is a block of kind baro_bias",
        examples=[0.75],
    )

    @property
    def height_factor(self) -> float:
        """Factor from the columns to m."""
        return units.HEIGHT[self.height_unit]

    @model_validator(mode="after")
    def _consistent(self) -> BaroConfig:
        refuse(
            _one_column_each(self.time_column, self.height_column, self.sd_column)
            + _accuracy_given(self.sd, "height_sd_m", self.height_sd_m)
        )
        return self


class HeadingConfig(_AidConfig):
    """The log of headings from two antennas: where it is, what its columns mean, how far it can be trusted."""

    file: InputPath | None = Field(
        default=None,
        description="Log of headings, .csv or .csv.gz, with one header line; left out: no headings",
        examples=["heading.csv.gz"],
    )
    heading_column: str = Field(
        default="heading", description="Column of the headings, clockwise from true north"
    )
    angle_unit: Literal["deg", "rad"] = Field(
        default="deg", description="Unit of headings and their accuracy"
    )
    offset_deg: float = Field(
        default=0.0,
        ge=-360.0,
        le=360.0,
        description="Direction from the first antenna to the second one against the forward axis, deg, to the "
        "right positive: taken off the headings",
    )
    sd: Literal["file", "config"] = Field(
        default="file",
        description="1-sigma accuracy of the headings. file: from sd_column, and from heading_sd_deg where the "
        "file has none or nan; config: from heading_sd_deg only",
    )
    sd_column: str = Field(default="sd", description="Column of the accuracy, in angle_unit, 1 sigma")
    heading_sd_deg: Positive | None = Field(
        default=None, description="Accuracy of the headings, deg, 1 sigma", examples=[0.2]
    )

    @property
    def angle_factor(self) -> float:
        """Factor from the columns to rad."""
        return units.ANGLE[self.angle_unit]

    @model_validator(mode="after")
    def _consistent(self) -> HeadingConfig:
        refuse(
            _one_column_each(self.time_column, self.heading_column, self.sd_column)
            + _accuracy_given(self.sd, "heading_sd_deg", self.heading_sd_deg)
        )
        return self
