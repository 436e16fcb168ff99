"""The whole chain on the published flight: accuracy, honesty, agreement of the models.

Bounds of 50 runs: a mean of n squared normals per run lies within +-4 standard deviations of the mean of that
many; slow errors (heading, accelerometers) give one independent value per run.
"""

from functools import cache

import numpy as np
import pytest

from gnssins import Config, MonteCarlo, Simulator, _core, monte_carlo, run
from gnssins.analysis.consistency import chi_square_bounds
from gnssins.errors import StateError
from gnssins.sim import load_scenario, relocate

RUNS = 50
ARCMIN = np.radians(1.0 / 60.0)


def config(model: str = "ned", **sections: object) -> Config:
    return Config.from_dict(
        {
            "filter": {"preset": "fomichev-tan-2017", "model": model},
            "imu": {"kind": "increments"},
            "gnss": {"gate_probability": "off"},
            "run": {"output_rate_hz": 1.0, "covariance_interval_s": 10.0},
            **sections,
        }
    )


@cache
def flights(variant: str) -> MonteCarlo:
    simulator = Simulator("fomichev-tan-2017", variant=variant)
    return monte_carlo(simulator, config(), RUNS, seed=2017, after_s=600.0)


def test_accuracy_with_gnss_is_that_of_the_specification():
    found = flights("continuous")
    assert (found.position < 0.205).all()
    assert (found.velocity < 0.0066).all()
    assert (found.phi[:2] < 0.042 * ARCMIN).all()
    # one independent heading error per run: 10 % scatter of its root mean square, expected 0.31
    assert found.phi[2] < 0.41 * ARCMIN


@pytest.mark.parametrize("variant", ["continuous", "gaps"])
def test_nees_and_nis_say_that_the_filter_knows_its_errors(variant):
    found = flights(variant)
    nees = found.nees.after(600.0)
    assert 8.3 < nees["navigation"].mean < 9.7
    low, high = chi_square_bounds(18, RUNS, 0.99)
    assert low < nees["all"].mean < high
    assert 5.9 < found.nis.mean < 6.1


@pytest.mark.parametrize("variant", ["continuous", "gaps"])
def test_nees_of_every_block_is_inside_its_band_at_twenty_epochs(variant):
    nees = flights(variant).nees.after(600.0)
    for name, group in nees.groups.items():
        epochs = np.linspace(0, len(group.value) - 1, 20).round().astype(int)
        low, high = chi_square_bounds(group.dof, RUNS, 0.95)
        values = group.value[epochs]
        outside = int(((values < low) | (values > high)).sum())
        assert outside <= 5, (name, outside)


def test_errors_at_the_ends_of_the_gaps_are_as_large_as_the_filter_says():
    ratio = flights("gaps").gap_ratio
    assert ratio.shape == (3, 9)
    # 99.9 % of chi with 50 degrees of freedom over its root mean square
    assert (ratio > 0.69).all()
    assert (ratio < 1.32).all()


def test_a_filter_that_claims_half_the_accelerometer_drift_is_found_out():
    drift = {"kind": "accel_bias", "name": "accel_drift", "process": "gauss_markov", "unit": "ug"}
    wrong = {"initial_sd": 25.0, "sd": 25.0, "tau_s": 1800.0}
    tables = config().to_dict()
    tables["filter"] = {"preset": "fomichev-tan-2017", "block": [drift | wrong]}
    found = monte_carlo(Simulator("fomichev-tan-2017", variant="gaps"), tables, 8, seed=1, after_s=600.0)
    _, high = chi_square_bounds(18, 8, 0.999)
    assert found.nees.after(600.0)["all"].mean > high


def test_ned_and_ecef_give_the_same_flight():
    flight = Simulator("fomichev-tan-2017", variant="continuous").run(5)
    ned, ecef = (run(config(model), flight) for model in ("ned", "ecef"))
    metres = (ned.lla - ecef.lla) * [6.4e6, 6.4e6, 1.0]
    turn = _core.quat_mul(ned.q_nb, ecef.q_nb * np.array([1.0, -1.0, -1.0, -1.0]))
    assert np.abs(metres).max() < 1e-3
    assert np.abs(ned.v_n - ecef.v_n).max() < 1e-5
    assert np.abs(_core.quat_to_rotvec(turn)).max() < 1e-7
    assert np.abs(ned.sd / ecef.sd - 1.0).max() < 1e-4


def test_the_flight_runs_within_a_kilometre_of_the_pole_in_ecef_and_is_refused_in_ned():
    # the start lies 0.009 degrees, one kilometre, from the pole
    scenario = relocate(load_scenario("fomichev-tan-2017"), lat_deg=89.991, lon_deg=0.0, model="ecef")
    simulator = Simulator(scenario, variant="continuous")
    found = monte_carlo(simulator, config("ecef"), 6, seed=3, after_s=600.0)
    assert (found.position < 0.25).all()
    assert (found.velocity < 0.008).all()
    low, high = chi_square_bounds(18, 6, 0.999)
    assert low < found.nees.after(600.0)["all"].mean < high
    with pytest.raises(StateError, match=r"latitude .* beyond the limit .* NED(.|\n)*ecef"):
        run(config("ned"), simulator.run(1))
