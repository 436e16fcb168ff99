"""Novik (2011): airliner with ring laser gyros, GPS/GLONASS receiver and barometer, 22 states, closed loop.

The flight of 800 s is repeated with drawn errors and goes on for 100 s without GNSS; the same flights with scale-factor
errors, with a coarse unit, with a step of the fixes that is let through, with feedback that waits, and beside an INS
and a receiver that work apart. Axes of the output are those of the publication.
"""

from __future__ import annotations

from functools import partial
from typing import Final

from gnssins.reproduce.novik_claims import Measured, claims
from gnssins.reproduce.novik_filter import (
    Observations,
    errata_table,
    feedback_table,
    observation_table,
    variation_table,
)
from gnssins.reproduce.novik_integrity import absorbed_table, alarm_table, ramp_table, step_table
from gnssins.reproduce.novik_linear import honest, outcomes
from gnssins.reproduce.novik_runs import PUBLISHED, Plan, delay, fault, fly, realise, vary
from gnssins.reproduce.novik_tables import (
    Runs,
    choice_table,
    coarse_table,
    consistency_table,
    growth_start_table,
    growth_table,
    scale_table,
    state_table,
)
from gnssins.reproduce.report import Job, Publication, Reproduction

__all__ = ["CHOICES", "PUBLICATION", "experiment"]

NAME: Final = "novik-2011"
TITLE: Final = "Novik (2011): INS/GNSS/barometer complex of an airliner, ring laser gyros, closed loop"

#: Runs with a step that is let through, and with feedback that waits: comparisons in pairs need no more.
PAIRED: Final = 20

#: What the publication leaves open.
CHOICES: Final = {
    "sensors of the runs": "data sheet of the HG9900: 0.003 deg/h, 0.002 deg/sqrt(h), 25 ug; 10 ug/sqrt(Hz) for a "
    "misprinted figure",
    "walks of the biases": "0.001 deg/h/sqrt(h), 5 ug/sqrt(h)",
    "receiver": "mid values; white jump of the height 3 m; changes of the constellation at 300 s and 600 s",
    "initial errors and P0": "10 m, 0.3 m/s, 1 mrad, drawn; P0 is their law and that of the sensors",
    "barometer": "walk per step read as per second: 0.035 m/sqrt(s)",
    "lower bound of diag P": "none here: it would hide an inconsistency; for flight see the page of the publication",
    "steps": "IMU 50 Hz, fixes and barometer 1 Hz, feedback at every fix",
    "begin of the outage": "800 s, the end of the closed loop; the aircraft flies on along its track",
    "Earth and gravity": "WGS-84, normal gravity with free air of second order",
    "tolerance test": "5 m/s^2, 5 sqrt(2) sigma of the fix",
    "number of runs": "100",
}


def experiment(job: Job, plan: Plan = PUBLISHED) -> Reproduction:
    """Repeat the experiment.

    Parameters
    ----------
    job : Job
        Runs, seed, threads.
    plan : Plan
        Lengths of the flight; the published ones unless others are wanted.

    Returns
    -------
    Reproduction
    """
    from gnssins.analysis import schuler_curves
    from gnssins.reproduce import novik_figures as figures
    from gnssins.reproduce import novik_free as free

    paired = min(job.runs, PAIRED)
    job.expect(6 * job.runs + 14 * paired)
    for simulator in (plan.simulator, plan.scaled, plan.coarse, plan.example):
        _ = simulator.truth  # before the threads ask for it
    bound_s = free.feedback_bound_s()
    flights = job.map(
        partial(fly, plan, job.seed), job.runs, "closed loop, outage, variants", units=4 * job.runs
    )
    apart = job.map(
        partial(free.uncoupled, plan, job.seed), job.runs, "separated operation", units=2 * job.runs
    )
    faults = job.map(partial(fault, plan, job.seed), paired, "step let through", units=3 * paired)
    periods = (10.0, 100.0, bound_s)
    waits = job.map(partial(delay, plan, periods, job.seed), paired, "feedback that waits", units=6 * paired)
    varied = job.map(partial(vary, plan, job.seed), paired, "variations", units=5 * paired)
    runs = Runs.of(plan, flights, job.seed)
    end = round(plan.end_s)
    scenario = plan.simulator.scenario
    right = honest(scenario, end)
    misprints = outcomes(scenario, end)
    seen = Observations(right, end)
    closed = float(free.closed_form_error(plan).max())
    forms, rates, curves = free.forms(plan), free.rates(plan), schuler_curves()
    found = Measured(
        runs, right, faults, waits, bound_s, apart, seen, closed, free.budget(), curves, job.seed
    )
    tables = [
        state_table(runs, right),
        coarse_table(runs),
        consistency_table(runs),
        growth_table(runs, right),
        growth_start_table(runs, right),
        free.separated_table(runs, apart),
        alarm_table(runs),
        step_table(runs),
        ramp_table(runs),
        absorbed_table(faults),
        scale_table(runs),
        feedback_table(waits, bound_s, job.seed),
        variation_table(varied, job.seed),
        observation_table(seen, misprints),
        errata_table(misprints),
        free.form_table(forms, "attitude_forms"),
        free.form_table(rates, "three_rates"),
        free.earth_table(),
        free.budget_table(found.budget),
        free.schuler_table(curves),
        choice_table(CHOICES),
    ]
    return Reproduction(
        name=NAME,
        title=TITLE,
        runs=job.runs,
        seed=job.seed,
        claims=claims(found),
        tables=tables,
        figures=figures.draw(runs, realise(plan, job.seed), right, apart, curves),
    )


PUBLICATION: Final = Publication(
    name=NAME,
    title=TITLE,
    summary="airliner with ring laser gyros, GNSS and barometer, 22 states: closed loop, outage, integrity, "
    "separated operation",
    runs=100,
    seed=1,
    run=experiment,
)
