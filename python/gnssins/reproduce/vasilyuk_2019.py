"""Vasilyuk (2019): loose coupling in ECEF axes with a quaternion, 15 error states, on a surveying pole that is carried.

Walks of 160 s are repeated with drawn errors: with fixes throughout, with 20 s without fixes on a straight, with the
pole upright and without sway, and with sensors that nobody has calibrated. The growth in the gap is counted as
published (uncorrected minus corrected run of the same filter) and against the truth; observability is looked at in
windows of 31 fixes; the printed forms are judged by their covariances.
"""

from __future__ import annotations

from functools import partial
from typing import Final

from gnssins.analysis import run_seed
from gnssins.reproduce.report import Job, Publication, Reproduction
from gnssins.reproduce.vasilyuk_claims import claims
from gnssins.reproduce.vasilyuk_errata import noise_table, printed_forms, printed_table
from gnssins.reproduce.vasilyuk_runs import PUBLISHED, SCENARIO, Plan, together, walk
from gnssins.reproduce.vasilyuk_tables import (
    consistency_table,
    growth_table,
    observability_table,
    sensor_table,
    settling_table,
)

__all__ = ["PUBLICATION", "experiment"]

TITLE: Final = (
    "Vasilyuk (2019): INS/GNSS in ECEF axes with an attitude quaternion, on a pole carried by a walker"
)

#: Walks whose observability is looked at: the flags hardly differ from one to the next.
_WATCHED: Final = 28


def experiment(job: Job, plan: Plan = PUBLISHED) -> Reproduction:
    """Repeat the experiment.

    Parameters
    ----------
    job : Job
        Walks, seed, threads.
    plan : Plan
        The gap and point A.

    Returns
    -------
    Reproduction
    """
    from gnssins.reproduce import vasilyuk_figures as figures

    watched = min(job.runs, _WATCHED)
    job.expect(2 * job.runs + watched)
    simulators = {name: plan.simulator(name) for name in ("continuous", "no-sway", "uncalibrated")}
    for simulator in simulators.values():
        _ = simulator.truth  # made once, before the threads share it
    main = partial(walk, plan, simulators["continuous"], job.seed, watched=watched)
    walks = job.map(main, job.runs, "matched sensors")
    upright = partial(walk, plan, simulators["no-sway"], job.seed, watched=watched)
    still = job.map(upright, watched, "no sway")
    raw = job.map(partial(walk, plan, simulators["uncalibrated"], job.seed), job.runs, "uncalibrated sensors")
    whole = together(walks, job.seed)
    first = simulators["continuous"].run(run_seed(job.seed, 0))
    printed = printed_forms(plan, first)
    return Reproduction(
        name=SCENARIO,
        title=TITLE,
        runs=job.runs,
        seed=job.seed,
        claims=claims(plan, walks, still, whole, printed),
        tables=[
            growth_table(walks),
            sensor_table(plan, walks, raw),
            settling_table(plan, whole),
            consistency_table(plan, whole),
            observability_table(plan, walks, still),
            noise_table(plan, first, job.seed),
            printed_table(printed),
        ],
        figures=figures.draw(plan, walks, raw, whole, job.seed),
    )


PUBLICATION: Final = Publication(
    name=SCENARIO,
    title=TITLE,
    summary="walk with a pole: MEMS and centimetre fixes, 20 s without them, observability along the path",
    runs=112,
    seed=2019,
    run=experiment,
)
