"""A five-minute piece of the UAV flight, simulated once for all tests that need a run."""

from dataclasses import replace
from functools import cache

import numpy as np

from gnssins import Config, InitialState, Result, Simulated, Simulator, run
from gnssins.sim import load_scenario, scenario_from_dict
from gnssins.simfiles import scenario_config

GAP_S = (200.0, 250.0)
DURATION_S = 300.0


@cache
def simulator() -> Simulator:
    tables = load_scenario("fomichev-tan-2017").model_dump(mode="json", exclude_none=True)
    tables["scenario"] |= {"duration_s": DURATION_S, "rate_hz": 50.0}
    tables["variant"] = {}
    return Simulator(scenario_from_dict(tables))


@cache
def simulated(seed: int = 1) -> Simulated:
    return simulator().run(seed)


def config(**run_keys: object) -> Config:
    keys = {"output_rate_hz": 10.0, "covariance_interval_s": 1.0, **run_keys}
    return Config.from_dict(scenario_config(simulated())).replace(run=keys)


def start_at(time_s: float) -> InitialState:
    """The truth at a time, as uncertain as the simulated start."""
    truth = simulated().dataset.truth
    row = int(np.searchsorted(truth.t_ns, round(time_s * 1e9)))
    return replace(
        simulated().initial,
        t_ns=int(truth.t_ns[row]),
        lla=truth.lla[row],
        v_n=truth.v_n[row],
        q_nb=truth.q_nb[row],
    )


@cache
def result() -> Result:
    """The flight with one gap."""
    return run(config(outages=[GAP_S]), simulated())
