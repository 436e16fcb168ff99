"""Aleshkin et al. (2021): corrected kinematic equations of a strapdown attitude reference.

The published gains are given to the running laws: corners, step responses, stability over body rates, noise, Schuler
tuning. What the publication says of them is held against what they do. Last, the attitude filter for use beside VQF,
Mahony, Madgwick and the published laws, on a scenario with disturbed references.
"""

from __future__ import annotations

from typing import Final

from gnssins.ahrs.compare import comparison
from gnssins.analysis.ahrs import rate_grid, stability
from gnssins.reproduce.aleshkin_claims import claims
from gnssins.reproduce.aleshkin_runs import CROSS, UNITS, experiment
from gnssins.reproduce.aleshkin_tables import tables
from gnssins.reproduce.report import Job, Publication, Reproduction

__all__ = ["PUBLICATION", "reproduction"]

NAME: Final = "aleshkin-2021"
TITLE: Final = "Aleshkin et al. (2021): corrected kinematic equations of a strapdown attitude reference"

#: Work units of one run of the comparison.
_COMPARED: Final = 12


def reproduction(job: Job) -> Reproduction:
    """Repeat the experiment."""
    from gnssins.reproduce.aleshkin_figures import draw

    job.expect(UNITS + 3 * job.runs + _COMPARED * job.runs)
    found = experiment(job)
    grid = stability(CROSS, rate_grid(100.0, 41))
    compared = comparison(job.runs, job.seed, job.jobs, progress=job.part(_COMPARED * job.runs, "comparison"))
    return Reproduction(
        name=NAME,
        title=TITLE,
        runs=job.runs,
        seed=job.seed,
        claims=claims(found, grid, compared),
        tables=tables(found, compared),
        figures=draw(found, compared),
    )


PUBLICATION: Final = Publication(
    name=NAME,
    title=TITLE,
    summary="attitude laws with their published gains: corners, stability, noise, Schuler; a filter beside VQF",
    runs=20,
    seed=2021,
    run=reproduction,
)
