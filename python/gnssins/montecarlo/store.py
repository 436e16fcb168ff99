"""A sweep on disk: the sums of its finished chunks, so that it goes on where it was left."""

from __future__ import annotations

import hashlib
import time
import zipfile
from pathlib import Path
from typing import Any, Final

import numpy as np

from gnssins import _core
from gnssins.errors import ConfigError, InputError
from gnssins.montecarlo.plan import Job
from gnssins.montecarlo.result import Sums
from gnssins.storage import write_atomic

__all__ = ["Store"]

#: Version of the file.
FORMAT: Final = 1
#: Shortest time between two writes, s.
PAUSE_S: Final = 2.0


class Store:
    """The file of one sweep. It holds whole chunks only, so that a longer sweep adds the same chunks to it.

    Parameters
    ----------
    path : Path
        The file; need not exist.
    job : Job
        What the sweep must be.
    """

    def __init__(self, path: Path, job: Job) -> None:
        self.path = path
        self.identity = {
            "format": str(FORMAT),
            "version of gnssins": _core.version(),
            "scenario": _digest(job.scenario + repr(job.outages)),
            "configuration": _digest(job.config),
            "seed": str(job.seed),
            "covariance": job.covariance,
            "after_s": repr(job.after_s),
        }
        self._written = time.monotonic()

    def load(self) -> Sums:
        """Read the finished chunks; none if there is no file.

        Raises
        ------
        ConfigError
            ``config.store``: the file belongs to another sweep.
        InputError
            ``input.store``: the file is not one of a sweep, or damaged.
        """
        if not self.path.exists():
            return Sums()
        try:
            with np.load(self.path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            found = dict(zip(arrays.pop("identity_keys"), arrays.pop("identity"), strict=True))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as failure:
            raise InputError(
                "input.store",
                f"{self.path} is not the store of a Monte Carlo, or damaged: {failure}",
                "name another file, or remove this one",
                {"file": str(self.path)},
            ) from None
        different = [key for key, value in self.identity.items() if found.get(key) != value]
        if different:
            raise ConfigError(
                "config.store",
                f"{self.path} holds a sweep with another {', '.join(different)}",
                "name another file, or remove this one to begin anew",
                {"file": str(self.path), "different": different},
            )
        return Sums.of_arrays(arrays)

    def save(self, sums: Sums, *, now: bool = False) -> None:
        """Write whole chunks, at most every two seconds unless ``now``."""
        if not sums.runs or (not now and time.monotonic() - self._written < PAUSE_S):
            return
        arrays: dict[str, Any] = sums.to_arrays()
        arrays["identity_keys"] = np.array(list(self.identity))
        arrays["identity"] = np.array(list(self.identity.values()))

        def write(path: Path) -> None:
            with path.open("wb") as file:
                np.savez(file, **arrays)

        write_atomic(self.path, write)
        self._written = time.monotonic()


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
