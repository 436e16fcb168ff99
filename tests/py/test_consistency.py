"""NEES and NIS: right numbers for drawn errors, right signs, right words."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from gnssins import _core
from gnssins.analysis import Parameters, Track, chi_square_bounds, nees, nis, run_seed
from gnssins.analysis.consistency import direction
from gnssins.errors import InputError
from gnssins.result import Covariance
from short_flight import result, simulated

S = 1_000_000_000


def drawn(seed: int, epochs: int = 400):
    """A result whose errors against its truth are drawn from its covariance, with every sign of the convention."""
    rng = np.random.default_rng(seed)
    r = result()
    rows = np.arange(epochs)
    root = rng.normal(size=(18, 18)) / 18 + np.eye(18)
    scale = np.repeat([1e-3, 0.1, 2.0, 1e-6, 1e-7, 1e-4], 3)
    root = scale[:, None] * root
    x = rng.normal(size=(epochs, 18)) @ root.T
    lla, v_n, q_nb = r.lla[rows], r.v_n[rows], r.q_nb[rows]
    radii = _core.radii(lla[:, 0].copy(), "wgs84") + lla[:, 2:]
    # truth = estimate - error for navigation, C_true = Exp(phi) C_est, true parameter = estimate + error
    dp = x[:, 6:9]
    true_lla = lla - np.column_stack(
        [dp[:, 0] / radii[:, 0], dp[:, 1] / (radii[:, 1] * np.cos(lla[:, 0])), -dp[:, 2]]
    )
    turn = _core.quat_mul(_core.rotvec_to_quat(np.ascontiguousarray(x[:, :3])), q_nb)
    truth = Track(r.t_ns[rows], true_lla, v_n - x[:, 3:6], turn)
    values = r.x[rows] + x[:, 9:]
    blocks = {"gyro_bias": values[:, :3], "gyro_drift": values[:, 3:6], "accel_drift": values[:, 6:]}
    covariance = Covariance(r.t_ns[rows], np.tile(root @ root.T, (epochs, 1, 1)))
    exact = np.einsum("ki,ij,kj->k", x, np.linalg.inv(root @ root.T), x)
    return replace(r, covariance=covariance), truth, Parameters(truth.t_ns, blocks), exact


def test_nees_takes_every_sign_as_the_covariance_does():
    r, truth, parameters, exact = drawn(1)
    found = nees(r, truth, parameters)
    assert np.allclose(found["all"].value, exact, rtol=2e-3)
    assert [g.dof for g in found.groups.values()] == [18, 9, 3, 3, 3, 3, 3, 3]
    for group in found.groups.values():
        low, high = chi_square_bounds(group.dof, 400, 0.999)
        assert low < group.mean < high, group.name
        assert group.share_inside == pytest.approx(0.95, abs=0.05)


def test_nees_of_a_covariance_too_small_by_4_says_over_confident_by_2():
    r, truth, parameters, exact = drawn(2)
    proud = replace(r, covariance=Covariance(r.covariance.t_ns, r.covariance.matrix / 4.0))
    group = nees(proud, truth, parameters)["all"]
    assert np.allclose(group.value, 4.0 * exact, rtol=2e-3)
    assert group.factor == pytest.approx(4.0, rel=0.1)
    assert direction(group.mean, 18, chi_square_bounds(18, 400)).startswith("over-confident, sd ")


def test_nees_without_true_parameters_looks_at_navigation_alone():
    r, truth, _, _ = drawn(3)
    assert list(nees(r, truth).groups) == ["navigation", "attitude", "velocity", "position"]
    some = Parameters(truth.t_ns, {"gyro_bias": np.zeros((400, 3))})
    assert "all" not in nees(r, truth, some).groups
    assert "gyro_bias" in nees(r, truth, some).groups


def test_nees_needs_snapshots_at_common_epochs():
    r, truth, _, _ = drawn(4)
    with pytest.raises(InputError, match="kept no covariance"):
        nees(replace(r, covariance=Covariance(np.zeros(0, np.int64), np.zeros((0, 18, 18)))), truth)
    odd = Covariance(r.covariance.t_ns + 1, r.covariance.matrix)
    with pytest.raises(InputError, match="no covariance snapshot"):
        nees(replace(r, covariance=odd), truth)


def test_nees_of_the_flight_is_that_of_a_consistent_filter():
    found = nees(result(), simulated().dataset.truth, Parameters.of(simulated()))
    assert found["all"].value.size == 301
    assert 0.5 < found["all"].factor < 1.6
    late = found.after(100.0)
    assert late["all"].t_ns[0] > 100 * S
    assert late["all"].value.size < 300


@pytest.mark.parametrize(("dof", "low", "high"), [(9, 8.19, 9.85), (15, 13.95, 16.09), (21, 19.75, 22.29)])
def test_bounds_of_100_runs(dof, low, high):
    assert chi_square_bounds(dof, 100) == (pytest.approx(low, abs=0.005), pytest.approx(high, abs=0.005))


def test_bounds_are_the_quantiles_of_chi_square():
    for dof, count, p in ((1, 1, 0.95), (6, 3000, 0.99), (18, 1, 0.5)):
        exact = chi2.ppf([(1 - p) / 2, (1 + p) / 2], dof * count) / count
        assert np.allclose(chi_square_bounds(dof, count, p), exact, rtol=1e-9)


def test_directions_in_words():
    bounds = chi_square_bounds(6, 100)
    assert direction(6.0, 6, bounds) == "consistent"
    assert direction(24.0, 6, bounds) == "over-confident, sd 2.00 times too small"
    assert direction(1.5, 6, bounds) == "under-confident, sd 2.00 times too large"
    assert direction(float("nan"), 6, bounds) == "unknown"


def test_nis_counts_rejected_fixes_and_splits_into_parts():
    r = result()
    found = nis(r)
    joint = found["gnss, 6 components"]
    seen = r.records.is_status("used", "rejected")
    assert joint.count == seen.sum()
    assert joint.mean == pytest.approx(np.mean(r.records.nis[seen]))
    assert joint.verdict == "consistent"
    assert found["position"].dof == 3
    assert found["velocity east"].count == joint.count
    assert nis(r, after_s=100.0)["position"].count < joint.count
    wild = replace(r, records=replace(r.records, innovation=3.0 * r.records.innovation))
    assert nis(wild)["position"].verdict.startswith("over-confident, sd 3.")


def test_nis_of_no_fixes_is_empty():
    assert nis(result(), after_s=1e6).groups == {}
    assert nis(result(), after_s=1e6).table()


# ---- many runs


def test_seeds_of_runs_and_sets_differ():
    seeds = {run_seed(seed, index) for seed in range(20) for index in range(50)}
    assert len(seeds) == 1000
    assert min(seeds) >= 0
    assert run_seed(0, 0) == run_seed(0, 0)
