"""A look at the data before a run: units, axes, clocks, places. Finds what would make a run worthless.

:func:`check_dataset` returns findings; :func:`raise_on_stop` turns those of level ``stop`` into an error.
"""

from __future__ import annotations

import numpy as np

from ..config import Config
from ..dataset import Dataset
from ..units import ms_to_ns
from .aids import check_aids
from .findings import LEVELS, Finding, Level, raise_on_stop
from .gnss import check_gnss
from .imu import check_imu
from .timing import check_overlap, check_times

__all__ = ["LEVELS", "Finding", "Level", "check_dataset", "raise_on_stop"]


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
    latency_ns = 0 if config is None else ms_to_ns(config.gnss.latency_ms)
    start_s = None if config is None else config.run.start_s
    max_gap_s = 1.0 if config is None else config.imu.max_gap_s
    with np.errstate(all="ignore"):  # values that overflow are what the checks are for
        findings = [
            *_skipped(dataset),
            *check_times(dataset.imu.t_ns, "imu", max_gap_s),
            *check_times(dataset.gnss.t_ns, "gnss"),
            *check_overlap(dataset, start_s),
            *check_imu(dataset, config, latency_ns),
            *check_gnss(dataset.gnss),
            *check_aids(dataset, config),
        ]
    if not len(dataset.imu):
        findings.append(Finding("stop", "data.imu_empty", "imu: no rows", "check [imu] file"))
    return sorted(findings, key=lambda finding: LEVELS.index(finding.level))


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
