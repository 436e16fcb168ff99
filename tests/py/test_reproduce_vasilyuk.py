"""Vasilyuk (2019): straights and turns, growth, a few walks against the claims, covariances of the printed forms."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gnssins.analysis import compare, outage_growth, run_seed
from gnssins.analysis.noise import BandLimited
from gnssins.reproduce import publication
from gnssins.reproduce.report import Job, Reproduction
from gnssins.reproduce.vasilyuk_2019 import PUBLICATION, experiment
from gnssins.reproduce.vasilyuk_errata import ACCEL, FIX_S, GYRO, engine_noise, printed_forms
from gnssins.reproduce.vasilyuk_runs import PUBLISHED, matched, walk
from gnssins.reproduce.vasilyuk_tables import FOUR, growth_table, seen
from gnssins.runner import run

RUNS = 5


@cache
def first():
    """The first walk of the default seed."""
    return PUBLISHED.simulator("continuous").run(run_seed(2019, 0))


@cache
def found() -> Reproduction:
    return experiment(Job(runs=RUNS, seed=2019, jobs=2))


def test_it_is_registered():
    assert publication("vasilyuk-2019") is PUBLICATION
    assert PUBLICATION.runs >= 28


def test_straights_and_turns_are_those_of_the_walk():
    straights = [s for s in PUBLISHED.stretches if not s.is_turn]
    turns = [s.start_s for s in PUBLISHED.stretches if s.is_turn]
    # legs of 48, 36, 48 and 36 m at 1.2 m/s, corners rounded with 1 m
    assert len(straights) == 4
    lengths = [s.end_s - s.start_s for s in straights]
    np.testing.assert_allclose(lengths, [38.0, 27.8, 37.8, 28.0], atol=0.3)
    np.testing.assert_allclose(np.diff(turns), [46.3 / 1.2 - 8.95, 39.6], atol=0.3)
    assert straights[2].start_s < PUBLISHED.gap[0] < PUBLISHED.gap[1] < straights[2].end_s
    np.testing.assert_allclose(PUBLISHED.lever, [0.03, 0.02, -0.10])


def test_growth_is_counted_to_the_last_second_of_the_gap_and_no_further():
    simulated = matched(first())
    coasted = run(PUBLISHED.config(gap=True), simulated)
    used = coasted.records.t_ns[coasted.records.is_status("used")] / 1e9
    assert used[used < 110.0].max() == pytest.approx(99.9)
    assert used[used > 110.0].min() == pytest.approx(120.1)
    one = walk(PUBLISHED, PUBLISHED.simulator("continuous"), 2019, 0)
    errors = compare(coasted, simulated.dataset.truth)
    row = int(np.searchsorted(errors.t_ns, 120_000_000_000))
    assert one.truth.values("horizontal", 20.0)[0] == pytest.approx(
        np.hypot(*errors.position[row, :2]), rel=1e-6
    )
    before = int(np.searchsorted(errors.t_ns, 99_900_000_000))
    moved = errors.position[row, :2] - errors.position[before, :2]
    assert one.change[-1, 0] == pytest.approx(np.hypot(*moved), rel=1e-6)
    assert one.windows == ()


def test_a_filter_with_one_bias_is_judged_by_the_sum_of_turn_on_bias_and_drift():
    both, apart = matched(first()).truth_blocks, first().truth_blocks
    np.testing.assert_array_equal(both["gyro_bias"], apart["gyro_bias"] + apart["gyro_drift"])
    assert set(both) == {"gyro_bias", "accel_bias"}


def test_straight_without_sway_has_rank_11_and_the_four_flags_of_the_publication():
    still = walk(PUBLISHED, PUBLISHED.simulator("no-sway"), 2019, 0, watched=1)
    for s in seen(PUBLISHED, [still]):
        if s.name.startswith("straight"):
            assert (s.lowest, s.highest) == (11, 11)
            assert s.four_only == 1.0
        else:
            assert s.lowest >= 14
    assert set(still.flagged) == FOUR


def test_every_turn_of_the_pole_clears_the_accelerometers_but_for_its_very_middle():
    swaying = walk(PUBLISHED, PUBLISHED.simulator("continuous"), 2019, 1, watched=2)
    turns = [s for s in seen(PUBLISHED, [swaying]) if s.name.startswith("turn")]
    assert len(turns) == 3
    assert all(s.lowest >= 14 for s in turns)
    assert all(max(s.flagged["accel_bias_x"], s.flagged["gyro_bias_z"]) == 0.0 for s in turns)
    # ten windows within 0.5 s of the middle; up to three at the middle flag the lateral accelerometer
    assert [s.clear for s in turns] == pytest.approx([0.9, 0.7, 0.8])
    assert [s.middle for s in turns] == [1.0, 0.0, 0.0]


def test_a_few_walks_meet_every_claim_within_their_scatter():
    report = found()
    assert report.runs == RUNS
    beyond = {"heading_truth_10", "heading_truth_20", "flags_turn", "flags_turn_share"}
    assert {c.key for c in report.missed} >= beyond
    assert all(report[key].note for key in beyond)
    for claim in report.claims:
        if claim.key in beyond:
            continue
        if claim.sense == "at most" and claim.judged:
            assert claim.ours <= 1.5 * claim.wanted, claim.line()  # 5 walks scatter by 32 %
        elif claim.judged:
            assert claim.met, claim.line()
    assert report["nees"].ours == pytest.approx(1.0, abs=0.2)
    assert len(report.figures) == 6
    assert {t.name for t in report.tables} >= {
        "growth",
        "settling",
        "consistency",
        "observability",
        "process_noise",
    }


def test_threads_do_not_change_the_figures():
    one, two = (experiment(Job(runs=2, seed=7, jobs=jobs)) for jobs in (1, 2))
    assert [c.ours for c in one.claims] == [c.ours for c in two.claims]


def test_printed_forms_have_their_expected_consistency():
    right, decaying, coupled, closed = printed_forms(PUBLISHED, first())
    assert right.nees == pytest.approx(1.0, abs=1e-6)  # truth and filter are one
    assert right.horizontal_m == pytest.approx(right.claimed_m, rel=1e-6)
    assert decaying.nees > 3.0
    assert decaying.heading > 2.0 * right.heading
    assert decaying.gyro_z > 3.0 * right.gyro_z
    assert coupled.nees > 100.0
    assert closed.nees == pytest.approx(1.0 + 0.5 * GYRO.shortfall(FIX_S), abs=0.02)


def test_expected_errors_of_the_right_form_are_the_sigmas_of_the_engine():
    right = printed_forms(PUBLISHED, first())[0]
    engine = run(PUBLISHED.config(gap=True), matched(first()))
    growth = outage_growth(engine, first().dataset.truth, at_s=[20.0])
    assert right.claimed_m == pytest.approx(growth.value("sigma", "horizontal", 20.0), rel=0.02)
    whole = run(PUBLISHED.config(), matched(first()))
    assert right.heading == pytest.approx(whole.sd[-1, 8], rel=0.02)
    assert right.gyro_z == pytest.approx(whole.x_sd[-1, 2], rel=0.02)


def test_noise_of_the_engine_is_the_white_equivalent():
    engine = engine_noise(PUBLISHED, first())
    assert engine["attitude"] == pytest.approx(GYRO.white_equivalent(FIX_S), rel=1e-3)
    assert engine["velocity"] == pytest.approx(ACCEL.white_equivalent(FIX_S), rel=1e-3)
    assert engine["gyro bias"] == pytest.approx(6.716e-12, rel=1e-3)
    assert engine["accelerometer bias"] == pytest.approx(1.7585e-9, rel=1e-3)
    assert BandLimited.of_random_walk(GYRO.walk, 40.0).density == pytest.approx(GYRO.density)


def test_the_table_has_the_published_figures_beside_ours():
    one = walk(PUBLISHED, PUBLISHED.simulator("continuous"), 2019, 0)
    table = growth_table([one, replace(one)])
    row = next(r for r in table.rows if r[0] == "horizontal" and r[2] == 20.0)
    assert row[3:5] == [8.0, 2.0]
    assert row[5] == pytest.approx(one.corrected.value("rms", "horizontal", 20.0))
