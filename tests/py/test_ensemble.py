"""Ensembles against hand-made numbers, a closed form, and the sums of the Monte Carlo."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from gnssins import monte_carlo, simulated_run
from gnssins.analysis import Ensemble, Parameters, ensemble, nees, nis, run_seed, sample_run
from gnssins.analysis.consistency import NisGroup
from gnssins.analysis.ensemble import ratio_verdict
from gnssins.analysis.sample import Sample
from gnssins.errors import InputError
from gnssins.result import AidRecords
from gnssins.tables import State
from short_flight import DURATION_S, config, result, simulated, simulator

STATES = (State("dp_n", "m", "position", "position"), State("gyro_bias_x", "rad/s", "gyro_bias", "gyro_bias"))


def sample(errors, sigmas=None, *, nis_mean=3.0, nis_count=10, time_s=(1.0, 2.0)) -> Sample:
    """One run by hand: errors (epochs, 2)."""
    errors = np.array(errors, dtype=float)
    sigmas = np.full_like(errors, 2.0) if sigmas is None else np.array(sigmas, dtype=float)
    return Sample(
        time_s=np.array(time_s),
        states=STATES,
        errors=errors,
        sigmas=sigmas,
        euler=np.zeros((2, 3)),
        euler_sigmas=np.ones((2, 3)),
        nees={"all": (errors**2 / sigmas**2).sum(axis=1)},
        dof={"all": 2},
        nis={"gnss, 3 components": NisGroup("gnss, 3 components", 3, nis_count, nis_mean)},
        windows=((0.0, 3.0),),
        window_rms=np.sqrt(np.mean(errors**2, axis=0))[None],
        window_max=np.abs(errors).max(axis=0)[None],
        window_sigma=np.sqrt(np.mean(sigmas**2, axis=0))[None],
        counts={"in": 10, "used": 9},
    )


def three() -> Ensemble:
    return Ensemble.of(
        [
            sample([[1.0, -3.0], [3.0, 1.0]], nis_mean=2.0, nis_count=10),
            sample([[-2.0, 0.0], [4.0, 1.0]], nis_mean=4.0, nis_count=30),
            sample([[2.0, 3.0], [0.0, 1.0]], nis_mean=3.0, nis_count=10),
        ],
        seed=5,
    )


def test_figures_over_the_runs_are_those_of_the_hand():
    found = three()
    assert found.errors.shape == (3, 2, 2)
    assert np.allclose(found.rms(), [[math.sqrt(9 / 3), math.sqrt(18 / 3)], [math.sqrt(25 / 3), 1.0]])
    assert np.allclose(found.median(), [[2.0, 3.0], [3.0, 1.0]])
    # three values sorted: 95 % lies nine tenths of the way from the second to the third
    assert np.allclose(found.p95(), [[2.0, 3.0], [3.9, 1.0]])
    assert np.allclose(found.sigma(), 2.0)
    assert np.allclose(found.ratio(), found.rms() / 2.0)
    assert np.allclose(found.growth(1.0, 2.0), [[2.0, 4.0], [6.0, 1.0], [-2.0, -2.0]])
    assert np.allclose(found.over_window()[0], np.sqrt([(9 + 25) / 6, (18 + 3) / 6]))
    assert found.counts == {"in": 30, "used": 27}


def test_nis_of_runs_is_weighted_by_the_number_of_measurements():
    group = three().nis["gnss, 3 components"]
    assert (group.count, group.mean) == (50, pytest.approx((20 + 120 + 30) / 50))
    assert group.bounds == pytest.approx(tuple(chi2.ppf([0.005, 0.995], 150) / 50))


def test_nees_is_the_mean_over_the_runs_with_bounds_for_their_number():
    group = three().nees()["all"]
    assert np.allclose(group.value, [(10 + 4 + 13) / 12, (10 + 17 + 1) / 12])
    assert group.runs == 3
    assert group.bounds == pytest.approx(tuple(chi2.ppf([0.005, 0.995], 6) / 3))
    assert group.verdict == "consistent"


def test_bounds_of_the_ratio_are_the_root_of_chi_square_over_the_runs():
    low, high = three().ratio_bounds
    assert low == pytest.approx(math.sqrt(chi2.ppf(0.005, 3) / 3))
    assert high == pytest.approx(math.sqrt(chi2.ppf(0.995, 3) / 3))
    assert ratio_verdict(1.0, 100) == "consistent"
    assert ratio_verdict(1.25, 100) == "over-confident, sd 1.25 times too small"
    assert ratio_verdict(0.8, 100) == "under-confident, sd 1.25 times too large"
    assert ratio_verdict(float("nan"), 100) == "unknown"


def test_drawn_errors_of_an_honest_filter_stay_inside_the_bounds():
    # GIVEN 400 runs drawn from what the filter claims, THEN of 2 x 2 ratios at most one falls out of 99 % bounds
    rng = np.random.default_rng(11)
    sigmas = np.array([[0.5, 1e-6], [2.0, 1e-7]])
    found = Ensemble.of([sample(sigmas * rng.standard_normal((2, 2)), sigmas) for _ in range(400)], 0)
    low, high = found.ratio_bounds
    assert ((found.ratio() < low) | (found.ratio() > high)).sum() <= 1
    # median and 95 % of |N(0, 1)|: 0.674 and 1.960 sigma; sd of a quantile of 400 draws about 5 %
    assert np.allclose(found.median() / sigmas, 0.6745, rtol=0.25)
    assert np.allclose(found.p95() / sigmas, 1.960, rtol=0.2)
    # BUT WHEN it claims half, THEN every verdict says so
    proud = Ensemble.of(
        [sample(s.errors, s.sigmas / 2) for s in [sample(e, sigmas) for e in found.errors]], 0
    )
    verdicts = {proud.verdict(r) for r in proud.ratio().ravel()}
    assert all(v.startswith("over-confident") for v in verdicts)
    assert proud.nees()["all"].verdict.startswith("over-confident")


def test_runs_that_do_not_belong_together_are_refused():
    with pytest.raises(InputError, match="at least one run"):
        Ensemble.of([], 0)
    other = sample([[0.0, 0.0], [0.0, 0.0]], time_s=(1.0, 3.0))
    with pytest.raises(InputError, match="run 1 has other states or epochs"):
        Ensemble.of([sample([[0.0, 0.0], [0.0, 0.0]]), other], 0)


def test_lookup_by_name_and_time():
    found = three()
    assert found.column("gyro_bias_x") == 1
    assert found.group("gyro_bias") == [1]
    assert found.at(2.0) == 1
    with pytest.raises(InputError, match=r"5 s is not one of the 2 epochs"):
        found.at(5.0)
    with pytest.raises(InputError, match=r'no state "dp_x"'):
        found.column("dp_x")


# ---- with the engine


def test_a_sample_has_the_errors_of_the_run_with_the_signs_of_estimate_minus_truth():
    r, flight = result(), simulated()
    one = sample_run(r, flight, at_s=[100.0, 299.0])
    truth, row = flight.dataset.truth, int(np.searchsorted(r.t_ns, 100_000_000_000))
    true = int(np.searchsorted(truth.t_ns, r.t_ns[row]))
    assert one.errors[0, 3:6] == pytest.approx(r.v_n[row] - truth.v_n[true], abs=1e-12)
    assert one.errors[0, 8] == pytest.approx(truth.lla[true, 2] - r.lla[row, 2], abs=1e-9)
    names = [state.name for state in r.block_states]
    drift = names.index("accel_drift_x")
    known = flight.truth_blocks["accel_drift"][true, 0]
    assert one.errors[0, 9 + drift] == pytest.approx(r.x[row, drift] - known, rel=1e-9)
    # the covariance counts blocks the other way round: NEES must not notice
    whole = nees(r, truth, Parameters.of(flight))["all"]
    at = int(np.searchsorted(whole.t_ns, 100_000_000_000))
    assert one.nees["all"][0] == pytest.approx(whole.value[at], rel=1e-12)
    assert one.sigmas[0, 3:9] == pytest.approx(r.sd[row, [3, 4, 5, 0, 1, 2]], rel=1e-9)
    assert one.euler_sigmas[0] == pytest.approx(r.sd[row, 6:9], rel=1e-12)


class Replayed:
    """The runs of a Monte Carlo, one after the other."""

    def __init__(self, seed: int) -> None:
        self.numbers = {run_seed(seed, index): index for index in range(3)}
        self.seed = seed

    def run(self, seed: int):
        return simulated_run(simulator(), self.seed, self.numbers[seed])


def test_an_ensemble_and_the_monte_carlo_agree_on_the_same_runs():
    settings = config(output_rate_hz=1.0)
    found = ensemble(
        Replayed(7), settings, 3, 7, at_s=[60.0, 290.0], windows=[(60.0, math.inf)], after_s=60.0, jobs=2
    )
    sums = monte_carlo(simulator(), settings, 3, seed=7, after_s=60.0)
    rms = found.over_window()[0]
    assert rms[:3] == pytest.approx(sums.phi, rel=1e-12)
    assert rms[3:6] == pytest.approx(sums.velocity, rel=1e-12)
    assert rms[6:9] == pytest.approx(sums.position, abs=2e-9)
    joint = found.nis["gnss, 6 components"]
    assert (joint.count, joint.mean) == (sums.nis.count, pytest.approx(sums.nis.mean, rel=1e-12))
    at = int(np.searchsorted(sums.nees["all"].t_ns, 290_000_000_000))
    assert found.nees()["all"].value[1] == pytest.approx(sums.nees["all"].value[at], rel=1e-6)
    assert {**sums.counts, "withheld": 0} == found.counts
    assert "dp_n" in found.table()
    assert found.to_dict()["states"][0] == {"name": "phi_n", "unit": "rad"}


def test_an_ensemble_does_not_depend_on_the_number_of_threads():
    shares: list[float] = []
    settings = config(output_rate_hz=1.0)
    one = ensemble(simulator(), settings, 3, 8, at_s=[100.0], jobs=1, progress=shares.append)
    two = ensemble(simulator(), settings, 3, 8, at_s=[100.0], jobs=3)
    assert np.array_equal(one.errors, two.errors)
    assert shares == pytest.approx([1 / 3, 2 / 3, 1.0])


def test_blocks_without_a_known_truth_are_unknown_and_not_zero():
    flight = simulated()
    blind = replace(flight, truth_blocks={})
    one = sample_run(result(), blind, at_s=[100.0])
    found = Ensemble.of([one, one], 0)
    assert np.isfinite(found.rms()[0, :9]).all()
    assert np.isnan(found.rms()[0, 9:]).all()
    assert "all" not in found.nees_values
    assert "unknown" in found.table()
    assert found.to_dict()["rms"][0][9] is None


def test_nis_of_an_aid_counts_used_and_rejected_rows_after_a_time():
    # rows: used, used, rejected, bad, late; NIS 9 of the first row lies before the time
    status = np.array([0, 0, 1, 3, 2], dtype=np.uint8)
    values = np.array([9.0, 0.5, 2.5, np.nan, 7.0])
    t_ns = np.arange(1, 6) * 1_000_000_000
    zero = np.zeros(5)
    aid = AidRecords(np.arange(5), t_ns, status, values, zero, zero, ("",) * 5)
    group = nis(replace(result(), aids={"baro": aid}), after_s=1.0)["baro"]
    assert (group.dof, group.count, group.mean) == (1, 2, 1.5)
    one = sample_run(replace(result(), aids={"baro": aid}), simulated(), at_s=[100.0])
    assert Ensemble.of([one, one], 0).nis["baro"].count == 6


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"at_s": [DURATION_S + 5.0]}, "1 of 1 epochs have no covariance snapshot, first 305 s"),
        ({"windows": [(400.0, 500.0)]}, r"no covariance snapshot in 400 s < t < 500 s"),
    ],
)
def test_epochs_outside_the_run_are_refused(keys, words):
    with pytest.raises(InputError, match=words):
        sample_run(result(), simulated(), **keys)
