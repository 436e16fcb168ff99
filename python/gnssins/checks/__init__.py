"""A look at the data before a run: units, axes, clocks, places. Finds what would make a run worthless.

:func:`check_dataset` returns findings; :func:`raise_on_stop` turns those of level ``stop`` into an error.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from ..config import Config
from ..dataset import Dataset
from .aids import check_aids
from .findings import LEVELS, Finding, Level, raise_on_stop
from .gnss import check_gnss
from .imu import check_imu
from .look import ImuLook
from .timing import check_overlap, check_times

__all__ = ["LEVELS", "WHOLE", "Finding", "ImuLook", "Level", "check_dataset", "judge", "raise_on_stop"]


def check_dataset(dataset: Dataset, config: Config | None = None) -> list[Finding]:
    """Look at a data set as a whole.

    Parameters
    ----------
    dataset : Dataset
        The data, uncut.
    config : Config, optional
        Adds what only the configuration knows: start, limits, ranges, axes, latency.

    Returns
    -------
    list of Finding
        Gravest first; empty if there is nothing to say.
    """
    look = ImuLook(dataset.imu.kind, dataset.gnss, config)
    with np.errstate(all="ignore"):  # values that overflow are what the checks are for
        look.add(dataset.imu)
    return judge(look, dataset, config)


#: Findings that need the whole IMU log.
WHOLE: Final = ("time.no_overlap", "time.start_outside", "data.imu_bad")


def judge(
    look: ImuLook, dataset: Dataset, config: Config | None = None, *, whole: bool = True
) -> list[Finding]:
    """Findings about a data set whose IMU log a look has taken, whole or in part.

    Parameters
    ----------
    look : ImuLook
        What was seen of the IMU log.
    dataset : Dataset
        Everything else; its IMU table is not looked at.
    config : Config, optional
        As for :func:`check_dataset`.
    whole : bool, optional
        Whether the look has taken the whole log; of a part, :data:`WHOLE` is not told.

    Returns
    -------
    list of Finding
        Gravest first.
    """
    start_s = None if config is None else config.run.start_s
    span_ns = look.stamps.span_ns
    with np.errstate(all="ignore"):
        findings = [
            *_skipped(dataset),
            *look.stamps.findings(),
            *check_times(dataset.gnss.t_ns, "gnss"),
            *check_overlap(span_ns, dataset.gnss, start_s),
            *check_imu(look, config),
            *check_gnss(dataset.gnss),
            *check_aids(dataset, config, span_ns),
        ]
    if span_ns is None:
        findings.append(Finding("stop", "data.imu_empty", "imu: no rows", "check [imu] file"))
    told = [finding for finding in findings if whole or finding.code not in WHOLE]
    return sorted(told, key=lambda finding: LEVELS.index(finding.level))


def _skipped(dataset: Dataset) -> list[Finding]:
    """Tell the rows that the readers have left out."""
    return [
        Finding(
            "warn",
            "input.skipped",
            f"{source.path}: {source.rows_skipped} of {source.rows} rows skipped: "
            + ", ".join(f"{count} {reason}" for reason, count in source.skipped.items()),
            "see the rows in the file",
            source.rows_skipped,
        )
        for source in dataset.sources.values()
        if source.rows_skipped
    ]
