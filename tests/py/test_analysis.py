"""Errors, RMSE and gaps: known displacements are found again, with the promised signs."""

from dataclasses import replace

import numpy as np
import pytest

import gnssins
from gnssins import TruthTable, _core, analysis
from gnssins.analysis import Track, compare, interpolate, ned_difference, outage_table
from gnssins.analysis.text import number
from gnssins.errors import InputError
from gnssins.tables import seconds
from short_flight import GAP_S, config, result, simulated

S = 1_000_000_000
DP, DV, PHI = np.array([1.5, -2.0, 0.7]), np.array([0.1, 0.2, -0.3]), np.array([1e-3, -2e-3, 5e-3])


def truth() -> TruthTable:
    return simulated().dataset.truth


def displaced(track, dp=DP, dv=DV, phi=PHI) -> Track:
    """A track with known errors: estimate = truth + dp, + dv, C_est = Exp(-phi) C_true."""
    radii = _core.radii(track.lla[:, 0].copy(), "wgs84") + track.lla[:, 2:]
    scale = np.column_stack(
        [1 / radii[:, 0], 1 / (radii[:, 1] * np.cos(track.lla[:, 0])), -np.ones(len(radii))]
    )
    turn = np.repeat(_core.rotvec_to_quat(-phi[None]), len(radii), axis=0)
    return Track(track.t_ns, track.lla + dp * scale, track.v_n + dv, _core.quat_mul(turn, track.q_nb))


def line(t_s, lat=0.8, lon=0.2, heading=0.0) -> Track:
    """North at 10 m/s, turning with 0.1 rad/s."""
    t = np.asarray(t_s, dtype=np.float64)
    radius = _core.radii(np.array([lat]), "wgs84")[0, 0]
    lla = np.column_stack([lat + 10.0 * t / radius, np.full_like(t, lon), np.full_like(t, 100.0)])
    rpy = np.column_stack([0 * t, 0 * t, heading + 0.1 * t])
    v_n = np.tile([10.0, 0.0, 0.0], (t.size, 1))
    return Track(np.rint(t * S).astype(np.int64), lla, v_n, _core.euler_to_quat(rpy))


# ---- errors


def test_known_errors_are_found_with_their_signs():
    found = compare(displaced(truth()), truth())
    assert len(found) == len(truth())
    assert np.allclose(found.position, DP, atol=2e-6)
    assert np.allclose(found.velocity, DV, atol=1e-12)
    assert np.allclose(found.phi, PHI, atol=1e-12)
    assert np.isnan(found.sd).all()


def test_euler_errors_are_estimate_minus_truth_and_wrapped():
    a, b = line([0.0, 1.0], heading=np.pi - 0.01), line([0.0, 1.0], heading=-np.pi + 0.01)
    assert np.allclose(compare(a, b).euler, [0.0, 0.0, -0.02], atol=1e-12)
    assert np.allclose(compare(a, b).phi, [0.0, 0.0, 0.02], atol=1e-12)


def test_a_difference_across_the_date_line_is_short():
    a, b = np.array([[0.0, np.pi - 1e-7, 0.0]]), np.array([[0.0, -np.pi + 1e-7, 0.0]])
    assert np.allclose(ned_difference(a, b), [[0.0, -2e-7 * 6378137.0, 0.0]], atol=1e-6)


def test_the_sd_of_a_result_comes_along():
    found = compare(result(), truth())
    assert np.array_equal(found.sd, result().sd)
    assert np.array_equal(found.t_ns, result().t_ns)


def test_the_sparser_track_gives_the_epochs():
    dense, sparse = line(np.arange(0, 10.05, 0.1)), line(np.arange(0.55, 12.0, 0.5))
    for found in (compare(dense, sparse), compare(sparse, dense)):
        assert np.allclose(seconds(found.t_ns), np.arange(0.55, 10.0, 0.5))
        assert np.abs(found.position).max() < 1e-5
        assert np.abs(found.phi).max() < 1e-9


def test_tracks_that_do_not_overlap_say_so():
    found = compare(line([0.0, 1.0]), line([5.0, 6.0]))
    assert len(found) == 0
    with pytest.raises(InputError, match="no epoch in common"):
        found.rmse()
    with pytest.raises(InputError, match="without epochs"):
        compare(line([]), line([0.0]))


def test_unknown_velocity_and_attitude_stay_unknown():
    only_position = TruthTable(truth().t_ns, truth().lla, np.full_like(truth().v_n, np.nan))
    rmse = compare(displaced(truth()), only_position).rmse()
    assert np.allclose(rmse.position, np.abs(DP), atol=1e-5)
    assert np.isnan(rmse.velocity).all()
    assert np.isnan(rmse.phi).all()
    assert rmse.to_dict()["velocity_m_s"] == {"north": None, "east": None, "down": None}
    assert "-" in rmse.table()


def test_attitude_is_interpolated_along_the_rotation_whatever_the_sign_of_the_quaternion():
    track = line([0.0, 2.0])
    flipped = replace(track, q_nb=track.q_nb * [[1.0], [-1.0]])
    for t in (0.0, 0.5, 1.9, 2.0):
        q = interpolate(flipped, np.array([round(t * S)]), max_gap_s=5.0).q_nb
        heading = _core.quat_to_euler(q)[0, 2]
        assert heading == pytest.approx(0.1 * t, abs=1e-12)


def test_nothing_is_interpolated_across_a_gap_or_beyond_the_ends():
    track = line([0.0, 1.0, 5.0, 6.0])
    at = interpolate(track, np.array([-S, 0, S // 2, S, 3 * S, 5 * S, 7 * S]), max_gap_s=2.0)
    known = np.isfinite(at.lla).all(axis=1)
    assert known.tolist() == [False, True, True, True, False, True, False]
    assert np.array_equal(np.isfinite(at.q_nb).all(axis=1), known)


def test_rmse_counts_from_a_time_on():
    errors = compare(displaced(truth()), truth())
    steep = replace(errors, position=errors.position * (errors.time_s > 100.0)[:, None])
    assert np.allclose(steep.rmse(100.0).position, np.abs(DP), atol=1e-5)
    assert steep.rmse().position[0] < 1.3
    assert steep.rmse(100.0).start_s == pytest.approx(100.02)
    assert steep.rmse().horizontal_m == pytest.approx(np.hypot(*steep.rmse().position[:2]))
    assert "position, m" in steep.rmse().table("Title")
    assert steep.between(10.0, 20.0).time_s[[0, -1]].tolist() == [10.02, 20.0]


# ---- gaps


def test_a_gap_against_truth_ends_before_the_first_fix():
    table = outage_table(result(), truth())
    (gap,) = table.outages
    assert (gap.start_s, gap.end_s) == GAP_S
    errors = compare(result(), truth())
    inside = (errors.time_s >= GAP_S[0]) & (errors.time_s < GAP_S[1])
    assert gap.epochs == inside.sum()
    horizontal = np.hypot(*errors.position[inside, :2].T)
    assert gap.max_horizontal_m == horizontal.max()
    assert gap.rms_horizontal_m == pytest.approx(np.sqrt(np.mean(horizontal**2)))
    assert np.array_equal(gap.end_position, errors.position[inside][-1])
    assert np.array_equal(gap.end_sd, errors.sd[inside][-1])
    assert np.allclose(
        gap.end_sigmas, np.concatenate([gap.end_position, gap.end_velocity, gap.end_euler]) / gap.end_sd
    )
    assert table.horizontal_m == pytest.approx(gap.rms_horizontal_m)


def test_withheld_fixes_agree_with_the_truth_within_their_noise():
    a, b = outage_table(result(), truth()), outage_table(result())
    assert b.outages[0].epochs == 50
    assert b.horizontal_m == pytest.approx(np.hypot(a.horizontal_m, np.sqrt(2.0)), rel=0.25)
    assert "200.0 to 250.0" in b.table()
    assert b.to_dict()["outages"][0]["end_position_sd_m"][0] > 0.0


def test_withheld_fixes_are_compared_at_the_antenna():
    # GIVEN a perfect solution and fixes at an antenna 3 m above and 2 m ahead of it
    r, lever = result(), np.array([2.0, 0.0, -3.0])
    at_fix = interpolate(truth(), r.records.t_ns)
    offset = np.einsum("kij,kj->ki", _core.quat_to_dcm(at_fix.q_nb), np.tile(lever, (len(at_fix.t_ns), 1)))
    rate = np.zeros_like(offset)
    fixes = displaced(at_fix, offset, rate, np.zeros(3))
    on_truth = interpolate(truth(), r.t_ns)
    perfect = replace(
        r,
        lla=on_truth.lla,
        v_n=on_truth.v_n,
        q_nb=on_truth.q_nb,
        records=replace(r.records, lla=fixes.lla),
        metadata={**r.metadata, "lever_ba_b_m": lever.tolist()},
    )
    # THEN the lever arm of the run brings both together, and without it the offset shows
    assert outage_table(perfect).horizontal_m < 2e-3
    assert outage_table(perfect).vertical_m < 2e-3
    bare = replace(perfect, metadata={**r.metadata, "lever_ba_b_m": [0.0, 0.0, 0.0]})
    assert outage_table(bare).vertical_m == pytest.approx(3.0, rel=0.05)


def test_a_run_without_gaps_says_what_to_do():
    whole = gnssins.run(config(end_s=30.0), simulated())
    with pytest.raises(InputError, match="no gaps") as caught:
        outage_table(whole)
    assert "[run] outages" in caught.value.hint
    with pytest.raises(InputError, match="no fix was withheld"):
        outage_table(whole, windows_s=[(5.0, 10.0)])
    with pytest.raises(InputError, match="no reference epoch inside any of the 1 gaps"):
        outage_table(whole, truth(), windows_s=[(100.0, 110.0)])


def test_a_gap_without_reference_stays_in_the_table():
    table = outage_table(result(), truth(), windows_s=[GAP_S, (400.0, 410.0)])
    assert [gap.epochs for gap in table.outages] == [500, 0]
    assert np.isfinite(table.max_horizontal_m)
    assert table.to_dict()["outages"][1]["max_horizontal_m"] is None


def test_every_result_prints_and_converts():
    for thing in (
        compare(result(), truth()).rmse(),
        outage_table(result()),
        analysis.nees(result(), truth()),
        analysis.nis(result()),
    ):
        assert len(thing.table().splitlines()) >= 4
        assert thing.to_dict()


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.0, "0"), (0.2046, "0.205"), (12.345, "12.3"), (123456.0, "123456"), (-0.00661, "-0.00661"),
        (1e-9, "1.00e-09"), (3.2e7, "3.20e+07"), (float("nan"), "-"),
    ],
)  # fmt: skip
def test_numbers_keep_three_figures(value, shown):
    assert number(value) == shown
