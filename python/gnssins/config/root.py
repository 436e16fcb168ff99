"""The whole configuration: one TOML file to one immutable object, and back."""

from __future__ import annotations

import copy
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import tomlkit
from pydantic import Field, ValidationError, model_validator

from ..errors import ConfigError, InputError, MissingFileError
from .aids import BaroConfig, HeadingConfig
from .base import Section, refuse
from .engine import engine_config, filter_problems
from .filter import FilterConfig
from .gnss import GnssConfig, TruthConfig
from .imu import ImuConfig
from .problems import config_error
from .start import InitialConfig, RunConfig

_FILE_SECTIONS = ("imu", "gnss", "baro", "heading", "truth")


class Config(Section):
    """Everything that one run needs, in the units of data sheets; :meth:`engine_config` gives it in SI.

    Built by :meth:`load` from a TOML file or by :meth:`from_dict`; both refuse unknown keys, wrong units and
    values out of range with a :class:`gnssins.errors.ConfigError` that lists every problem at once. Equal
    files give equal objects. Paths are absolute.
    """

    version: Literal[1] = Field(default=1, description="Version of this file format")
    run: RunConfig = Field(default=RunConfig(), description="Which part of the log to process, what to write")
    imu: ImuConfig = Field(default=ImuConfig(), description="The IMU log and its sensors")
    gnss: GnssConfig = Field(default=GnssConfig(), description="The GNSS log, its accuracy and its antenna")
    baro: BaroConfig = Field(default=BaroConfig(), description="Barometric altimeter")
    heading: HeadingConfig = Field(default=HeadingConfig(), description="Headings from two antennas")
    filter: FilterConfig = Field(default=FilterConfig(), description="Navigation model and error states")
    initial: InitialConfig = Field(default=InitialConfig(), description="What is known at the start")
    truth: TruthConfig = Field(default=TruthConfig(), description="Reference to compare the result with")

    @model_validator(mode="after")
    def _complete(self) -> Config:
        refuse(filter_problems(self))
        return self

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Config:
        """Read a TOML file.

        Parameters
        ----------
        path : str or path
            The file. Relative file names in it count from its folder.

        Returns
        -------
        Config

        Raises
        ------
        MissingFileError
            No such file (``input.not_found``).
        ConfigError
            No TOML (``config.syntax``), or any wrong key, value or combination.
        """
        file = Path(path)
        data = parse_toml(file)
        return cls.from_dict(data, base=file.resolve().parent, source=str(path))

    @classmethod
    def from_dict(
        cls,
        data: Mapping[str, Any],
        *,
        base: str | os.PathLike[str] | None = None,
        source: str = "configuration",
    ) -> Config:
        """Validate tables and keys as they stand in a TOML file.

        Parameters
        ----------
        data : Mapping
            Nested tables.
        base : path, optional
            Folder from which relative file names count; left out: the working folder.
        source : str, optional
            Name for messages.

        Returns
        -------
        Config

        Raises
        ------
        ConfigError
            As :meth:`load`.
        """
        tables = copy.deepcopy(dict(data))
        if base is not None:
            for name in _FILE_SECTIONS:
                section = tables.get(name)
                if isinstance(section, dict) and isinstance(section.get("file"), str):
                    section["file"] = str(Path(base) / Path(section["file"]).expanduser())
        try:
            return cls.model_validate(tables)
        except ValidationError as failure:
            raise config_error(failure, cls, source) from None

    def to_dict(self) -> dict[str, Any]:
        """Give all keys with their values, defaults included, absent ones left out, for TOML or JSON."""
        return self.model_dump(mode="json", exclude_none=True)

    def to_toml(self, path: str | os.PathLike[str]) -> None:
        """Write a TOML file that :meth:`load` reads back to an equal configuration.

        Parameters
        ----------
        path : str or path
            The file; replaced if it exists. File names are written as absolute paths.
        """
        Path(path).write_text(self.to_toml_text(), encoding="utf-8")

    def to_toml_text(self) -> str:
        """Return the text that :meth:`to_toml` writes."""
        return tomlkit.dumps(self.to_dict())

    def engine_config(self, initial: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Give the configuration of the compiled engine: SI units, radians, integer nanoseconds.

        Parameters
        ----------
        initial : Mapping, optional
            Initial state in engine form (``t_ns, lat_rad, lon_rad, height_m, v_n, q_nb, sd_phi, sd_v,
            sd_p``); stored as it is.

        Returns
        -------
        dict
            Ready for ``json.dumps``; without ``initial`` if none was given.
        """
        return engine_config(self, initial)

    def replace(self, **changes: Mapping[str, Any]) -> Config:
        """Return a copy with some keys changed, validated as a whole.

        Parameters
        ----------
        **changes : Mapping
            Keys to set per section, such as ``run={"outages": [[60.0, 90.0]]}``; None removes a key.

        Returns
        -------
        Config

        Raises
        ------
        ConfigError
            As :meth:`load`.
        """
        tables = self.to_dict()
        for name, keys in changes.items():
            section = tables.setdefault(name, {})
            section.update(keys)
            for key in [key for key, value in keys.items() if value is None]:
                section.pop(key)
        return self.from_dict(tables)


def parse_toml(file: Path) -> dict[str, Any]:
    """Read a TOML file into plain tables.

    Parameters
    ----------
    file : Path
        The file.

    Returns
    -------
    dict

    Raises
    ------
    MissingFileError
        ``input.not_found``.
    InputError
        ``input.unreadable``: a folder, or no permission.
    ConfigError
        ``config.syntax``: no UTF-8 text or no TOML; the message names the line.
    """
    try:
        text = file.read_bytes().decode("utf-8-sig")
        return tomllib.loads(text.replace("\r\n", "\n"))
    except FileNotFoundError:
        raise MissingFileError(
            "input.not_found",
            f"{file}: no such file",
            f"looked from {Path.cwd()}",
            {"file": str(file)},
        ) from None
    except OSError as failure:
        raise InputError(
            "input.unreadable",
            f"{file}: {failure.strerror}",
            "give the name of a TOML file",
            {"file": str(file)},
        ) from None
    except UnicodeDecodeError as failure:
        raise ConfigError(
            "config.syntax",
            f"{file}: not UTF-8 text (byte {failure.start})",
            "save the file as UTF-8",
            {"file": str(file)},
        ) from None
    except tomllib.TOMLDecodeError as failure:
        raise ConfigError(
            "config.syntax", f"{file}: not valid TOML: {failure}", "text needs quotes", {"file": str(file)}
        ) from None
