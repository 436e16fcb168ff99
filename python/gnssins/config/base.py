"""What every section of the configuration is made of: the strict base model and the shared value types."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

PROBLEMS = "problems"
"""Type of the pydantic error that carries :class:`Problem` rows of a cross-key rule."""


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with a configuration.

    Attributes
    ----------
    code : str
        Stable name such as ``"config.unit"``.
    text : str
        What is wrong and what is allowed.
    hint : str
        What to write instead.
    key : str
        Key inside the section that found it; empty for the section as a whole.
    """

    code: str
    text: str
    hint: str = ""
    key: str = ""


class Section(BaseModel):
    """One table of the configuration: unknown keys refused, no silent conversion of types, immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def refuse(problems: Sequence[Problem]) -> None:
    """Raise all problems of a cross-key rule at once; do nothing if there are none."""
    if problems:
        raise PydanticCustomError(PROBLEMS, "inconsistent keys", {PROBLEMS: list(problems)})


def invalid(code: str, text: str, hint: str = "") -> PydanticCustomError:
    """Build the error with which a field validator refuses a value."""
    return PydanticCustomError(PROBLEMS, "invalid value", {PROBLEMS: [Problem(code, text, hint)]})


def is_number(value: object) -> bool:
    """Tell an int or a float from anything else, a bool included."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _three(value: Any) -> Any:
    """Accept one number for all axes, or three."""
    if is_number(value):
        return (value, value, value)
    if isinstance(value, (list, tuple)) and len(value) == 3 and all(map(is_number, value)):
        return tuple(value)
    raise invalid("config.type", "must be one number for all three axes, or a list of three numbers")


def _exactly_three(value: Any) -> Any:
    """Accept a vector: three numbers, no short form."""
    if isinstance(value, (list, tuple)) and len(value) == 3 and all(map(is_number, value)):
        return tuple(value)
    raise invalid("config.type", "must be a list of three numbers")


def _three_names(value: Any) -> Any:
    """Accept three different column names."""
    if isinstance(value, (list, tuple)) and len(value) == 3 and all(isinstance(v, str) for v in value):
        if len(set(value)) == 3:
            return tuple(value)
        raise invalid("config.columns", "names a column twice")
    raise invalid("config.type", "must be a list of three column names")


def three_by_three(value: Any) -> Any:
    """Accept a 3x3 matrix as a list of three rows."""
    if isinstance(value, (list, tuple)) and len(value) == 3:
        return tuple(_exactly_three(row) for row in value)
    raise invalid("config.type", "must be a 3x3 matrix: a list of three rows of three numbers")


def _positive_noise(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if min(value) <= 0.0:
        raise invalid(
            "config.noise",
            "must be greater than 0 on every axis: with a zero noise the filter believes the sensor to be "
            "perfect, its standard deviations shrink to nothing and it stops listening to GNSS",
            "use the figure of the data sheet; on a vibrating vehicle three to ten times as much",
        )
    return value


def _positive_sd(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if min(value) <= 0.0:
        raise invalid(
            "config.noise",
            "must be greater than 0 on every axis: a zero standard deviation makes the covariance singular",
            "give the 1-sigma accuracy that you would bet on",
        )
    return value


def _not_negative(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if min(value) < 0.0:
        raise invalid("config.range", "must not be negative")
    return value


def _absolute(path: Path) -> Path:
    """Make a path absolute, from the working folder if nothing better is known, without ``..`` parts."""
    return path.expanduser().resolve()


_Three = tuple[float, float, float]

Vec3 = Annotated[_Three, BeforeValidator(_exactly_three)]
"""A vector of three numbers."""

Axes3 = Annotated[_Three, BeforeValidator(_three)]
"""One number for all axes, or three numbers; any sign."""

Noise3 = Annotated[_Three, BeforeValidator(_three), AfterValidator(_positive_noise)]
"""A noise density per axis, greater than 0."""

Sd3 = Annotated[_Three, BeforeValidator(_three), AfterValidator(_positive_sd)]
"""A standard deviation per axis, greater than 0."""

Floor3 = Annotated[_Three, BeforeValidator(_three), AfterValidator(_not_negative)]
"""A lower bound per axis, 0 or greater."""

Names3 = Annotated[tuple[str, str, str], BeforeValidator(_three_names)]
"""Three different column names."""

Matrix3 = Annotated[tuple[_Three, _Three, _Three], BeforeValidator(three_by_three)]
"""A 3x3 matrix, row by row."""

InputPath = Annotated[Path, Field(strict=False), AfterValidator(_absolute)]
"""A file; relative paths count from the folder of the TOML file."""

Positive = Annotated[float, Field(gt=0.0)]
"""A number greater than 0."""

Separator = Literal[",", ";", "\t", "|", " "]
"""One character between the cells of a line."""


def choices(table: Mapping[str, object]) -> str:
    """List the keys of a unit table the way messages quote them."""
    return ", ".join(f'"{name}"' for name in table)
