"""Finding, reading, writing and moving scenarios."""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import tomlkit
from pydantic import ValidationError

from ..config.problems import config_error
from ..config.root import parse_toml
from ..errors import ConfigError
from .scenario import Scenario, Variant

__all__ = [
    "load_scenario",
    "relocate",
    "scenario_from_dict",
    "scenario_names",
    "scenario_toml",
    "variant_from_dict",
]

_SUFFIX = ".toml"
#: Beyond this latitude a heading that counts from true north no longer makes the same track.
_GRID_LATITUDE_DEG = 80.0


def _folder() -> Traversable:
    return resources.files("gnssins") / "scenarios"


def scenario_names() -> list[str]:
    """Names of the packaged scenarios, sorted."""
    folder = _folder()
    return sorted(item.name[: -len(_SUFFIX)] for item in folder.iterdir() if item.name.endswith(_SUFFIX))


def load_scenario(source: str | os.PathLike[str] | Scenario) -> Scenario:
    """Read a scenario.

    Parameters
    ----------
    source : str, path or Scenario
        Name of a packaged scenario (see :func:`scenario_names`), TOML file, or a scenario, which is returned
        as it is. A text that ends in ``.toml`` or has a folder in it is a file.

    Returns
    -------
    Scenario

    Raises
    ------
    ConfigError
        Unknown name, no TOML, or any wrong key, value or combination; lists every problem.
    MissingFileError
        No such file.
    """
    if isinstance(source, Scenario):
        return source
    text = os.fspath(source)
    if isinstance(source, str) and not text.endswith(_SUFFIX) and Path(text).name == text:
        return _packaged(text)
    return scenario_from_dict(parse_toml(Path(text)), source=text)


def _packaged(name: str) -> Scenario:
    known = scenario_names()
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
        raise ConfigError(
            "config.scenario",
            f'no packaged scenario "{name}"; known: {", ".join(known)}',
            f'nearest: "{near[0]}"' if near else "a file name ends in .toml",
            {"name": name, "known": known},
        )
    with resources.as_file(_folder() / f"{name}{_SUFFIX}") as path:
        return scenario_from_dict(parse_toml(path), source=f"scenario {name}")


def scenario_from_dict(data: Mapping[str, Any], *, source: str = "scenario") -> Scenario:
    """Validate tables and keys as they stand in a TOML file.

    Parameters
    ----------
    data : Mapping
        Nested tables.
    source : str, optional
        Name for messages.

    Returns
    -------
    Scenario

    Raises
    ------
    ConfigError
        Any wrong key, value or combination; lists every problem.
    """
    try:
        return Scenario.model_validate(dict(data))
    except ValidationError as failure:
        raise config_error(failure, Scenario, source) from None


def variant_from_dict(data: Mapping[str, Any]) -> Variant:
    """Validate the table of a variant; errors as in :func:`scenario_from_dict`."""
    try:
        return Variant.model_validate(dict(data))
    except ValidationError as failure:
        raise config_error(failure, Variant, "variant") from None


def scenario_toml(scenario: Scenario) -> str:
    """Text of a TOML file that :func:`load_scenario` reads back to an equal scenario."""
    return tomlkit.dumps(scenario.model_dump(mode="json", exclude_none=True))


def relocate(
    scenario: Scenario,
    lat_deg: float,
    lon_deg: float,
    height_m: float | None = None,
    *,
    model: str | None = None,
) -> Scenario:
    """Move a scenario: the same motion from another start point.

    Beyond 80 deg of latitude headings are taken from the grid, so that the track keeps its shape next to a
    pole.

    Parameters
    ----------
    scenario : Scenario
        What to move. Waypoints in degrees cannot be moved.
    lat_deg, lon_deg : float
        New start, degrees.
    height_m : float, optional
        New height above the ellipsoid, m; left out: as before.
    model : {"ned", "ecef"}, optional
        Mechanisation of the truth; left out: as before. Near a pole only ``"ecef"`` holds.

    Returns
    -------
    Scenario

    Raises
    ------
    ConfigError
        ``config.waypoint``: the route is given in degrees; or a value out of range.
    """
    if any(point.lat_deg is not None for point in scenario.waypoint):
        raise ConfigError(
            "config.waypoint",
            f"{scenario.name}: waypoints in degrees cannot be moved",
            "give them as north_m and east_m",
            {"scenario": scenario.name},
        )
    tables = scenario.model_dump(mode="json", exclude_none=True)
    tables["start"] |= {"lat_deg": float(lat_deg), "lon_deg": float(lon_deg)}
    if height_m is not None:
        tables["start"]["height_m"] = float(height_m)
    if model is not None:
        tables["truth"]["model"] = model
    if abs(lat_deg) > _GRID_LATITUDE_DEG:
        tables["motion"]["heading_reference"] = "grid"
    return scenario_from_dict(tables, source=f"{scenario.name}, moved")
