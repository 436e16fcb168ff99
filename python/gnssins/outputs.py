"""Where output goes: never over an input, never into something that is no folder."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

from gnssins.errors import ConfigError

__all__ = [
    "FIGURE_FILES",
    "RESULT_FILES",
    "make_folder",
    "refuse_inputs",
    "refuse_no_file",
    "refuse_no_folder",
]

#: Files of a saved result, in the order of their use.
RESULT_FILES: Final = (
    "navigation.parquet",
    "measurements.parquet",
    "aids.parquet",
    "covariance.parquet",
    "events.csv",
    "state.bin",
    "run.toml",
)

#: Pictures that ``gnssins run --figures`` may write.
FIGURE_FILES: Final = (
    "track.png",
    "innovations.png",
    "nis.png",
    "biases.png",
    "position_errors.png",
    "velocity_errors.png",
    "attitude_errors.png",
)


def refuse_inputs(outputs: Iterable[Path], inputs: Iterable[str | Path | None]) -> None:
    """Raise if one of the files to be written is one of the files that were read, links followed.

    Parameters
    ----------
    outputs : iterable of Path
        What would be written.
    inputs : iterable of str, Path or None
        Input files, configuration, scenario; None is skipped.

    Raises
    ------
    ConfigError
        ``config.output_is_input``, with every such file.
    """
    read = [Path(file) for file in inputs if file is not None]
    both = [file for file in outputs if any(_same(file, other) for other in read)]
    if both:
        names = ", ".join(map(str, both))
        raise ConfigError(
            "config.output_is_input",
            f"{names}: the output would overwrite {len(both)} of the input files",
            "name another folder with --out, or in Result.save()",
            {"files": [str(file) for file in both]},
        )


def _same(one: Path, other: Path) -> bool:
    """Tell whether two names lead to one file."""
    if one.resolve() == other.resolve():
        return True
    return one.exists() and other.exists() and one.samefile(other)


def refuse_no_folder(folder: Path) -> None:
    """Raise a :class:`ConfigError` if ``folder`` cannot be one: it, or a part of its path, is a file."""
    for part in (folder, *folder.parents):
        if part.exists():
            if not part.is_dir():
                raise ConfigError(
                    "config.output_not_folder",
                    f"{part}: the output needs a folder, this is a file",
                    "name a folder with --out; it is made if absent",
                    {"file": str(part)},
                )
            return


def make_folder(folder: Path) -> Path:
    """Make the folder for output if it is absent."""
    refuse_no_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def refuse_no_file(file: Path) -> None:
    """Raise if a file could not be written: before hours of work, not after.

    Parameters
    ----------
    file : Path
        File to be written or replaced.

    Raises
    ------
    ConfigError
        ``config.output_file``: it is a folder, or its folder does not exist.
    """
    if file.is_dir():
        what = "is a folder"
    elif not file.absolute().parent.is_dir():
        what = f"its folder {file.parent} does not exist"
    else:
        return
    raise ConfigError(
        "config.output_file", f"{file}: {what}", "name a file in a folder that exists", {"file": str(file)}
    )
