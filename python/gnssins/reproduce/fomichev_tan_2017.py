"""Fomichev and Tan (2017): loosely coupled INS/GNSS of a small UAV with three gaps of GNSS, 18 states.

The flight of 3000 s is repeated with drawn errors, with GNSS throughout (variant 1) and with the gaps (variant 2), in
three readings of the gyro noise, and beside an INS that is only restarted at each gap. The figures show one flight with
errors of +1 sigma, as the publication does; the claims are those of all runs.
"""

from __future__ import annotations

from functools import partial
from typing import Final

from gnssins.analysis import Ensemble
from gnssins.reproduce.fomichev_tan_claims import claims
from gnssins.reproduce.fomichev_tan_runs import (
    PUBLISHED,
    READINGS,
    Plan,
    fly,
    fly_reading,
    realise,
    together,
)
from gnssins.reproduce.fomichev_tan_tables import (
    accuracy_table,
    consistency_table,
    gap_table,
    reading_table,
    restarted_table,
    state_table,
)
from gnssins.reproduce.report import Job, Publication, Reproduction

__all__ = ["PUBLICATION", "experiment"]

NAME: Final = "fomichev-tan-2017"
TITLE: Final = "Fomichev and Tan (2017): loosely coupled INS/GNSS of a small UAV with gaps of GNSS"


def experiment(job: Job, plan: Plan = PUBLISHED) -> Reproduction:
    """Repeat the experiment.

    Parameters
    ----------
    job : Job
        Runs, seed, threads.
    plan : Plan
        Gaps and length of the flight; the published ones unless a shorter flight is wanted.

    Returns
    -------
    Reproduction
    """
    from gnssins.reproduce import fomichev_tan_figures as figures
    from gnssins.reproduce.fomichev_tan_errata import errata_table

    job.expect(5 * job.runs)
    simulators = {name: plan.simulator(name) for name in READINGS}
    main = partial(fly, plan, simulators["B"], job.seed)
    flights = job.map(main, job.runs, "GNSS throughout, gaps, restarted INS", units=3 * job.runs)
    whole, gaps = together(plan, flights, job.seed)
    readings = {"B": gaps}
    for name in ("A", "C"):
        other = partial(fly_reading, plan, name, simulators[name], job.seed)
        readings[name] = Ensemble.of(job.map(other, job.runs, f"reading {name}"), job.seed)
    one = realise(plan, job.seed)
    tables = [
        accuracy_table(plan, whole),
        state_table(plan, gaps),
        gap_table(plan, gaps, one),
        restarted_table(plan, gaps, flights),
        reading_table(plan, readings),
        consistency_table(plan, whole, gaps, flights),
        errata_table(simulators["B"].truth, plan.gaps[0]),
    ]
    return Reproduction(
        name=NAME,
        title=TITLE,
        runs=job.runs,
        seed=job.seed,
        claims=claims(plan, whole, gaps, readings, flights, one),
        tables=tables,
        figures=figures.draw(plan, one, gaps, flights),
    )


PUBLICATION: Final = Publication(
    name=NAME,
    title=TITLE,
    summary="UAV flight with three gaps of GNSS, 18 states, three readings of the gyro noise, beside a restarted INS",
    runs=100,
    seed=2017,
    run=experiment,
)
