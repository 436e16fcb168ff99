"""Published experiments, each repeated by one call and held against its publication.

>>> from gnssins.reproduce import reproduce
>>> report = reproduce("fomichev-tan-2017", runs=20, out="report")  # doctest: +SKIP
>>> print(report.text())  # doctest: +SKIP

The modules load on first use; ``PUBLICATIONS`` says where each one is.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Final

from gnssins.errors import ConfigError
from gnssins.reproduce.report import (
    Claim,
    Job,
    Publication,
    Reproduction,
    Table,
    refuse_foreign,
    refuse_others,
)

__all__ = [
    "PUBLICATIONS",
    "Claim",
    "Job",
    "Publication",
    "Reproduction",
    "Table",
    "publication",
    "publications",
    "reproduce",
]

#: Module of each publication, by its name on the command line.
PUBLICATIONS: Final = {
    "fomichev-tan-2017": "gnssins.reproduce.fomichev_tan_2017",
    "novik-2011": "gnssins.reproduce.novik_2011",
    "vasilyuk-2019": "gnssins.reproduce.vasilyuk_2019",
    "al-bitar-gavrilov-2019": "gnssins.reproduce.al_bitar_gavrilov_2019",
    "aleshkin-2021": "gnssins.reproduce.aleshkin_2021",
}


def publication(name: str) -> Publication:
    """Look up a publication.

    Raises
    ------
    ConfigError
        ``config.publication``: no such name, with the nearest one; or its module is not in this version.
    """
    if name not in PUBLICATIONS:
        near = difflib.get_close_matches(name, PUBLICATIONS, n=1, cutoff=0.3)
        raise ConfigError(
            "config.publication",
            f'no publication "{name}"; known: {", ".join(PUBLICATIONS)}',
            f'nearest: "{near[0]}"' if near else "gnssins reproduce --list tells what each one is",
            {"name": name, "known": list(PUBLICATIONS)},
        )
    found = _load(name)
    if found is None:
        raise ConfigError(
            "config.publication",
            f"{name} cannot be reproduced by this version",
            "gnssins reproduce --list shows what can",
            {"name": name, "known": list(PUBLICATIONS)},
        )
    return found


def publications() -> dict[str, Publication | None]:
    """Every publication by name; None for one whose module is not in this version."""
    return {name: _load(name) for name in PUBLICATIONS}


def _load(name: str) -> Publication | None:
    path = PUBLICATIONS[name]
    try:
        module = import_module(path)
    except ModuleNotFoundError as error:
        if error.name != path:
            raise
        return None
    found: Publication = module.PUBLICATION
    return found


def reproduce(
    name: str,
    runs: int | None = None,
    seed: int | None = None,
    jobs: int | None = None,
    out: str | os.PathLike[str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Reproduction:
    """Repeat a published experiment.

    Parameters
    ----------
    name : str
        One of :data:`PUBLICATIONS`.
    runs, seed : int, optional
        Monte Carlo runs and their seed; left out: those of the publication's module.
    jobs : int, optional
        Threads; left out: one per core. The figures do not depend on it.
    out : path, optional
        Folder for tables, figures and ``summary.json``; left out: nothing is written.
    progress : callable, optional
        Called with the share that is done, 0 to 1.

    Returns
    -------
    Reproduction

    Raises
    ------
    ConfigError
        Unknown name, a number out of range, or a folder that cannot be used (before anything is computed).
    """
    chosen = publication(name)
    for key, value, least in (("runs", runs, 1), ("seed", seed, 0), ("jobs", jobs, 1)):
        if value is not None and value < least:
            raise ConfigError(
                "config.range", f"{key} = {value} must be {least} or more", "", {"key": key, "value": value}
            )
    if out is not None:
        refuse_foreign(Path(out))
        refuse_others(Path(out))
    job = Job(
        runs=chosen.runs if runs is None else runs,
        seed=chosen.seed if seed is None else seed,
        jobs=jobs or os.cpu_count() or 1,
        progress=progress,
    )
    found = chosen.run(job)
    if out is not None:
        found.write(Path(out))
    return found
