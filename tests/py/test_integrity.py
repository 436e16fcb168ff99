"""Integrity tests of the fixes: drawn innovations, detection in closed form, ramps, agreement with the records."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import beta, chi2, ncx2, norm

from gnssins import run
from gnssins.analysis import Integrity, Share, integrity, ned_difference
from gnssins.analysis.gates import chi_square, chi_square_limit, tolerance, trace_ratio, windowed
from gnssins.errors import InputError
from gnssins.result import STATUS, Records
from short_flight import config, result, simulated

S = 1_000_000_000
USED = STATUS.index("used")


def drawn(count=20_000, seed=1, sd=(5.0, 5.0, 8.0, 0.1, 0.1, 0.2), lat=0.96) -> Records:
    """Records whose innovations are drawn from their covariance, one per second."""
    rng = np.random.default_rng(seed)
    root = np.diag(sd) @ (np.eye(6) + 0.2 * rng.normal(size=(6, 6)))
    cov = np.tile(root @ root.T, (count, 1, 1))
    v = rng.normal(size=(count, 6)) @ root.T
    return Records(
        row=np.arange(count),
        t_ns=np.arange(count) * S,
        status=np.full(count, USED, dtype=np.uint8),
        dof=np.full(count, 6, dtype=np.uint8),
        nis=chi_square(v, cov),
        innovation=v,
        innovation_cov=cov,
        reason=[""] * count,
        lla=np.tile([lat, 0.5, 100.0], (count, 1)),
        v_n=np.zeros((count, 3)),
        refused=np.zeros(count, dtype=np.uint8),
    )


# ---- statistics


def test_the_limit_is_the_quantile_of_chi_square():
    assert chi_square_limit(1e-5) == pytest.approx(25.9, abs=0.01)  # Novik (2011): 25.9 for 1e-5
    for probability, dof in ((1e-3, 3), (1e-6, 2), (0.05, 6)):
        assert chi_square_limit(probability, dof) == pytest.approx(chi2.isf(probability, dof), rel=1e-12)
    for wrong in (0.0, 1.0, float("nan")):
        with pytest.raises(InputError, match="false-alarm rate"):
            chi_square_limit(wrong)


def test_both_statistics_in_numbers():
    v, s = np.array([[3.0, 4.0, 0.0]]), np.diag([9.0, 16.0, 25.0])[None]
    assert trace_ratio(v, s) == pytest.approx(0.5)
    assert chi_square(v, s) == pytest.approx(2.0)
    absent = np.array([[3.0, np.nan, 0.0]])
    assert np.isnan(trace_ratio(absent, s)).all()
    assert np.isnan(chi_square(absent, s)).all()


def test_the_sum_of_the_records_is_the_nis_that_the_engine_computed():
    r = result().records
    seen = r.is_status("used", "rejected")
    np.testing.assert_allclose(chi_square(r.innovation[seen], r.innovation_cov[seen]), r.nis[seen], rtol=1e-9)


@pytest.mark.parametrize(("hits", "trials"), [(0, 100), (3, 100), (100, 100), (17, 1_000_000)])
def test_bounds_of_a_share_are_those_of_clopper_and_pearson(hits, trials):
    share = Share(hits, trials)
    low = beta.ppf(0.025, hits, trials - hits + 1) if hits else 0.0
    high = beta.ppf(0.975, hits + 1, trials - hits) if hits < trials else 1.0
    assert share.bounds == pytest.approx((low, high), rel=1e-9)
    assert share.value == hits / trials


# ---- false alarms and detection


def test_false_alarms_come_as_often_as_asked():
    found = integrity(drawn(), false_alarm=0.01)
    for part in ("position", "velocity"):
        share = found.alarms(part)["chi-square"]
        assert share.trials == 20_000
        assert share.hits == pytest.approx(200, abs=4 * np.sqrt(200))


def test_a_step_is_caught_as_often_as_the_noncentral_chi_square_says():
    r = drawn()
    found = integrity(r)
    cov = r.innovation_cov[0, :3, :3]
    for axis, step in ((0, 20.0), (1, 30.0), (2, 40.0)):
        e = step * np.eye(3)[axis]
        expected = ncx2.sf(found.limit, 3, e @ np.linalg.solve(cov, e))
        share = found.detection("position", step, axis)["chi-square"]
        assert share.trials == 40_000
        assert share.value == pytest.approx(
            expected, abs=0.012
        )  # 4 sd of 40 000 halves that share their noise


def test_a_step_in_the_trace_ratio_where_only_one_axis_has_noise():
    r = drawn(sd=(5.0, 5.0, 5.0, 0.1, 0.1, 0.1))
    cov = np.zeros((6, 6))
    cov[0, 0] = cov[3, 3] = 1.0
    v = np.zeros_like(r.innovation)
    v[:, 0] = np.random.default_rng(2).normal(size=v.shape[0])
    flat = replace(r, innovation=v, innovation_cov=np.tile(cov + 1e-12 * np.eye(6), (v.shape[0], 1, 1)))
    found = integrity(flat)
    # |v| > sqrt(10) for a sigma of 1, and for a step of 4
    assert found.alarms("position")["trace ratio"].value == pytest.approx(
        2 * norm.sf(np.sqrt(10.0)), abs=1.2e-3
    )
    expected = norm.sf(np.sqrt(10.0) - 4.0) + norm.cdf(-np.sqrt(10.0) - 4.0)
    assert found.detection("position", 4.0, 0)["trace ratio"].value == pytest.approx(expected, abs=0.012)
    # a step along the axis without noise: seen by chi-square at once, by the trace ratio as any other
    across = found.detection("position", 0.1, 2)
    assert across["chi-square"].value == 1.0
    assert across["trace ratio"].value < 0.01


def test_a_direction_may_be_given():
    found = integrity(drawn(2000))
    assert found.detection("position", 30.0, [0.6, 0.8, 0.0]) == found.detection(
        "position", 6.0, [3.0, 4.0, 0.0]
    )
    assert found.detection("velocity", 1.0, 2) == found.detection("velocity", 1.0, [0.0, 0.0, 1.0])


def test_reduced_coordinates_change_the_ratio_and_not_chi_square():
    # Novik (2011): at 55 deg, threshold sqrt(10 tr S) is 9.4 m east but 16.3 m north on the ground for the same tr S
    r = drawn(2000, lat=np.radians(55.0))
    ground, reduced = integrity(r), integrity(r, reduced=True)
    np.testing.assert_allclose(reduced.chi_square("position"), ground.chi_square("position"), rtol=1e-9)
    stretch = 1.0 / np.cos(np.radians(55.0))
    v, s = (
        r.innovation[0, :3] * [1, stretch, 1],
        r.innovation_cov[0, :3, :3] * np.outer([1, stretch, 1], [1, stretch, 1]),
    )
    assert reduced.ratio("position")[0] == pytest.approx(v @ v / np.trace(s))
    east = [i.detection("position", 15.0, 1)["trace ratio"].value for i in (ground, reduced)]
    north = [i.detection("position", 15.0, 0)["trace ratio"].value for i in (ground, reduced)]
    assert (
        reduced.detection("position", 15.0, 1)["chi-square"]
        == ground.detection("position", 15.0, 1)["chi-square"]
    )
    assert east[1] > east[0]
    assert north[1] < north[0]


# ---- ramps


def test_the_windowed_test_is_chi_square_of_white_innovations():
    found = integrity(drawn(), false_alarm=0.01)
    for window_s, spread in ((10.0, 3.0), (60.0, 7.5)):  # neighbouring windows share most of their fixes
        share = found.window_alarms("position", window_s)
        assert share.trials == 20_000 - window_s
        assert share.hits == pytest.approx(200, abs=4 * spread * np.sqrt(200))


def test_a_slow_ramp_is_seen_by_the_long_window_and_not_by_the_single_fix():
    found = integrity(drawn(4000))
    rate = 0.25  # m/s: 15 m after 60 s
    assert found.detection("position", rate, 0)["chi-square"].value < 1e-3
    short, long = (found.ramp_detection("position", rate, 0, w).value for w in (10.0, 60.0))
    assert short < 0.01
    assert long > 0.99


def test_the_window_by_hand_with_gaps_and_absent_components():
    rng = np.random.default_rng(7)
    t = np.cumsum(rng.integers(200, 900, 60)) * 1_000_000
    v, root = rng.normal(size=(60, 3)), rng.normal(size=(60, 3, 3)) + 3 * np.eye(3)
    s = root @ root.transpose(0, 2, 1)
    v[10] = np.nan
    ramp = np.tile([0.3, 0.0, -0.1], (60, 1))
    found = windowed(t, v, s, 4.0, ramp=ramp)
    assert np.isnan(found[10])
    for k in (30, 59):
        rows = [i for i in range(60) if i != 10 and 0 <= t[k] - t[i] <= 4.0 * S]
        total = sum(v[i] + ramp[i] * (t[i] - t[rows[0]]) / S for i in rows)
        assert found[k] == pytest.approx(total @ np.linalg.solve(sum(s[i] for i in rows), total), rel=1e-9)
    assert np.isnan(found[(t - t[0]) < 4.0 * S]).all()
    assert np.isnan(windowed(t[:1], v[:1], s[:1], 1.0)).all()


def test_tolerance_in_numbers():
    # 1 s, 5 m/s^2, 2 m: 2.5 + 5 sqrt(2) 2 = 16.64 m; velocity, 0.1 m/s: 5 + 0.71
    jump = np.array([[16.7, -16.7, 16.6]])
    assert (tolerance(jump, [1.0], [2.0, 2.0, 2.0], 5.0) > 1.0).tolist() == [[True, True, False]]
    limit = 5.0 + 0.5 * np.sqrt(2.0)
    found = tolerance([[limit, 0.0, 2 * limit]], [1.0], [0.1, 0.1, 0.1], 5.0, "velocity")
    np.testing.assert_allclose(found, [[1.0, 0.0, 2.0]])


# ---- agreement with the tests that the engine applies


def faulty(**gnss: object):
    """The flight with steps of the fixes: 30 m east at 100 s, 3 m/s down at 150 s, 5 m north at 200 s."""
    data = simulated().dataset
    lla, v_n = data.gnss.lla.copy(), data.gnss.v_n.copy()
    at = {t: int(np.searchsorted(data.gnss.t_ns, t * S)) for t in (100, 150, 200)}
    lla[at[100], 1] += 30.0 / (6.378e6 * np.cos(lla[0, 0]))
    v_n[at[150], 2] += 3.0
    lla[at[200], 0] += 5.0 / 6.36e6
    settings = config(output_rate_hz=None).replace(gnss={"gate_probability": "off", **gnss})
    changed = replace(data, gnss=replace(data.gnss, lla=lla, v_n=v_n))
    return run(settings, replace(simulated(), dataset=changed)), at


def test_the_trace_ratio_is_that_of_the_engine():
    r, at = faulty(trace_ratio_limit=10.0)
    for part, bits, columns in (("position", 7, slice(0, 3)), ("velocity", 56, slice(3, 6))):
        ratio = trace_ratio(r.records.innovation[:, columns], r.records.innovation_cov[:, columns, columns])
        np.testing.assert_array_equal(r.records.refused & bits == bits, ratio >= 10.0)
        assert integrity(r).alarms(part)["trace ratio"].hits == (ratio >= 10.0).sum()
    assert r.records.refused[at[100]] == 7
    assert r.records.refused[at[150]] == 56


def test_the_gate_by_parts_is_the_chi_square_test():
    r, at = faulty(gate="parts", gate_probability=0.999)
    limit = chi_square_limit(1e-3)
    for bits, columns in ((7, slice(0, 3)), (56, slice(3, 6))):
        value = chi_square(r.records.innovation[:, columns], r.records.innovation_cov[:, columns, columns])
        np.testing.assert_array_equal(r.records.refused & bits == bits, value > limit)
    assert r.records.refused[[at[100], at[150], at[200]]].tolist() == [7, 56, 7]


def test_the_tolerance_is_that_of_the_engine():
    # a fix that is refused leaves the solution as it was predicted: what the engine compared can be made again
    r, at = faulty(max_accel_m_s2=5.0)
    assert r.records.refused[[at[100], at[150], at[200]]].tolist() == [7, 0, 0]
    now, then = (int(np.searchsorted(r.t_ns, t * S)) for t in (100, 99))
    moved = ned_difference(r.lla[now : now + 1], r.lla[then : then + 1])[0] - r.v_n[then]
    jump = moved + r.records.innovation[at[100], :3]
    found = tolerance([jump], [1.0], [1.0, 1.0, 1.0], 5.0)[0]
    assert found[1] == pytest.approx(30.0 / (2.5 + 5.0 * np.sqrt(2.0)), rel=0.1)
    assert (found > 1.0).tolist() == [False, True, False]


# ---- what comes out


def test_runs_are_put_together_and_windows_stay_within_a_run():
    a, b = drawn(3000, 1), drawn(3000, 2)
    both = integrity([a, b], false_alarm=0.01)
    parts = [integrity(x, false_alarm=0.01) for x in (a, b)]
    assert np.unique(both.run).tolist() == [0, 1]
    for test in ("trace ratio", "chi-square"):
        assert both.alarms("position")[test].hits == sum(p.alarms("position")[test].hits for p in parts)
    assert both.window_alarms("position", 60.0).trials == 2 * (3000 - 60)
    again = Integrity.combine([both, parts[0]])
    assert np.unique(again.run).tolist() == [0, 1, 2]
    with pytest.raises(InputError, match="different limits"):
        Integrity.combine([both, integrity(a, false_alarm=0.02)])


def test_a_run_of_the_engine_is_clean_and_its_tables_are_complete():
    found = integrity(result(), after_s=60.0)
    assert found.alarms("position")["chi-square"].hits == 0
    text = found.table()
    assert "Steps caught at the first epoch" in text
    assert "window 60 s" in text
    plain = found.to_dict()
    assert set(plain) >= {"position", "velocity", "ratio_limit", "chi_square_limit"}
    assert plain["position"]["caught"]["30"]["north"]["chi-square"] == 1.0
    assert (found.t_ns > 60 * S).all()


def test_parts_that_were_never_measured_are_left_out():
    r = drawn(100)
    only = replace(r, innovation=np.where(np.arange(6) < 3, r.innovation, np.nan))
    found = integrity(only)
    assert not found.has("velocity")
    assert "velocity" not in found.to_dict()
    assert "velocity" not in found.table()


def test_a_run_without_compared_fixes_is_refused():
    r = drawn(10)
    with pytest.raises(InputError, match="no fix was compared"):
        integrity(replace(r, status=np.full(10, STATUS.index("late"), dtype=np.uint8)))
    with pytest.raises(InputError, match="nothing to combine"):
        integrity([])
