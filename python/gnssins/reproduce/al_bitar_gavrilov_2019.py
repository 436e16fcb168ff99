"""Al Bitar and Gavrilov (2019): loosely coupled MEMS INS/GNSS of a car with seven outages of 60 s, 21 states.

The publication's drive was recorded; this one is simulated, with sensors of the class of the unit that it used. Every
drive is filtered with GNSS throughout and with the seven gaps; with the heading of two antennas, which that receiver
had and the published filter did not take; and before calibration, with scale factors and cross couplings taken off,
left in, or estimated.
"""

from __future__ import annotations

from functools import partial
from typing import Final

from gnssins.reproduce.al_bitar_claims import claims
from gnssins.reproduce.al_bitar_runs import PUBLISHED, Plan, Simulators, drive, growths, together
from gnssins.reproduce.al_bitar_tables import (
    bias_table,
    consistency_table,
    gap_end_table,
    manoeuvre_table,
    manoeuvres,
    outage_rows,
    variant_table,
)
from gnssins.reproduce.report import Job, Publication, Reproduction

__all__ = ["PUBLICATION", "experiment"]

NAME: Final = "al-bitar-gavrilov-2019"
TITLE: Final = "Al Bitar and Gavrilov (2019): MEMS INS/GNSS of a car, outages of 60 s"


def experiment(job: Job, plan: Plan = PUBLISHED) -> Reproduction:
    """Repeat the experiment.

    Parameters
    ----------
    job : Job
        Runs, seed, threads.
    plan : Plan
        Gaps and length of the drive; the published ones unless a shorter drive is wanted.

    Returns
    -------
    Reproduction
    """
    from gnssins.reproduce import al_bitar_figures as figures
    from gnssins.reproduce.al_bitar_errata import RUNS, errata_table

    misprints = 5 * min(job.runs, RUNS)
    job.expect(10 * job.runs + misprints)
    simulators = Simulators.of(plan)
    work = partial(drive, plan, simulators, job.seed)
    drives = job.map(work, job.runs, "drives", units=10 * job.runs)
    whole, gaps = together(drives, job.seed)
    found = growths(drives)
    shown = figures.show(plan, simulators.plain, job.seed)
    classes = manoeuvres(plan, whole, shown.observability)
    tables = [
        outage_rows(plan, found["published"]),
        gap_end_table(plan, gaps),
        variant_table(plan, found, drives, gaps),
        bias_table(plan, whole, drives),
        manoeuvre_table(plan, classes),
        consistency_table(plan, whole, gaps, drives),
        errata_table(plan, job, simulators.plain, misprints),
    ]
    return Reproduction(
        name=NAME,
        title=TITLE,
        runs=job.runs,
        seed=job.seed,
        claims=claims(plan, whole, gaps, found, drives, classes),
        tables=tables,
        figures=figures.draw(plan, whole, gaps, found, drives, shown, classes),
    )


PUBLICATION: Final = Publication(
    name=NAME,
    title=TITLE,
    summary="car in a city with MEMS sensors, outages of 60 s in both readings, 21 states, two antennas, calibration",
    runs=50,
    seed=2019,
    run=experiment,
)
