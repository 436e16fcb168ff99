"""Tables of a recording: shapes, types, immutability, and what they tell about themselves."""

import numpy as np
import pytest

from gnssins.dataset import Dataset, GnssTable, ImuTable, Source, TruthTable
from gnssins.errors import InputError

T = np.arange(5, dtype=np.int64) * 10_000_000


def imu(n=5, **changes):
    parts = {"t_ns": T[:n], "gyro": np.zeros((n, 3)), "accel": np.ones((n, 3))} | changes
    return ImuTable(**parts)


def gnss(n=5, **changes):
    parts = {"t_ns": T[:n] * 100, "lla": np.zeros((n, 3)), "v_n": np.zeros((n, 3)), "var": np.ones((n, 6))}
    return GnssTable(**(parts | changes))


def truth(n=5, **changes):
    return TruthTable(**({"t_ns": T[:n], "lla": np.zeros((n, 3)), "v_n": np.zeros((n, 3))} | changes))


def test_tables_copy_their_arrays_and_keep_them_read_only():
    gyro = np.zeros((5, 3))
    table = imu(gyro=gyro)
    gyro[0, 0] = 1.0
    assert table.gyro[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        table.gyro[0, 0] = 1.0


@pytest.mark.parametrize(
    "layout", [np.asfortranarray, lambda a: a[::-1], lambda a: a.astype(np.float32), list]
)
def test_tables_take_any_layout_and_hold_contiguous_float64(layout):
    table = imu(gyro=layout(np.arange(15.0).reshape(5, 3)))
    assert table.gyro.dtype == np.float64
    assert table.gyro.flags.c_contiguous


@pytest.mark.parametrize(
    ("build", "changes", "says"),
    [
        (imu, {"gyro": np.zeros((5, 2))}, r"imu gyro has shape \(5, 2\), needs \(5, 3\)"),
        (imu, {"accel": np.zeros((4, 3))}, r"imu accel has shape \(4, 3\), needs \(5, 3\)"),
        (imu, {"gyro": np.zeros(15)}, "imu gyro has shape"),
        (imu, {"t_ns": np.zeros((5, 1), dtype=np.int64)}, "imu t_ns has shape"),
        (gnss, {"lla": np.zeros((5, 2))}, "gnss lla has shape"),
        (gnss, {"var": np.zeros((5, 3))}, "gnss var has shape"),
        (gnss, {"var": np.zeros((5, 3, 3))}, r"needs \(5, 6, 6\)"),
        (truth, {"q_nb": np.zeros((5, 3))}, "truth q_nb has shape"),
    ],
)
def test_wrong_shape_is_refused_by_name(build, changes, says):
    with pytest.raises(InputError, match=says) as caught:
        build(**changes)
    assert caught.value.code == "input.shape"


def test_times_as_floats_are_refused():
    with pytest.raises(InputError, match="whole nanoseconds") as caught:
        imu(t_ns=T / 1e9)
    assert caught.value.code == "input.dtype"


def test_text_is_refused_as_values():
    with pytest.raises(InputError, match="gyro is not numeric"):
        imu(gyro=[["a", "b", "c"]] * 5)


def test_unknown_kind_lists_the_known_ones():
    with pytest.raises(InputError, match="kind") as caught:
        imu(kind="deltas")
    assert "increments" in caught.value.hint


def test_rate_and_duration_come_from_the_stamps():
    assert (imu().rate_hz, imu().duration_s) == pytest.approx((100.0, 0.04))
    assert (len(imu(1)), imu(1).duration_s) == (1, 0.0)
    assert np.isnan(imu(1).rate_hz)
    assert np.isnan(imu(t_ns=np.zeros(5, dtype=np.int64)).rate_hz)


def test_tables_describe_themselves_in_one_line():
    assert repr(imu()) == "ImuTable(5 rows, 0.000 to 0.040 s, 100 Hz, rates)"
    half = gnss(v_n=np.where(np.arange(5)[:, None] < 2, 0.0, np.nan) * np.ones(3))
    assert repr(half) == "GnssTable(5 rows, 0.000 to 4.000 s, 1 Hz, 100% position, 40% velocity)"
    assert repr(GnssTable.empty()) == "GnssTable(empty)"
    assert repr(truth()) == "TruthTable(5 rows, 0.000 to 0.040 s, 100 Hz, no attitude)"


def test_velocity_without_its_vertical_part_still_counts():
    v_n = np.array([[1.0, 2.0, np.nan]] * 5)
    assert gnss(v_n=v_n).has_velocity.all()


def test_standard_deviations_come_from_variances_and_covariances():
    full = np.tile(np.diag([1.0, 4, 9, 16, 25, 36]), (5, 1, 1))
    np.testing.assert_array_equal(gnss(var=full).sd[0], [1, 2, 3, 4, 5, 6])
    assert np.isnan(gnss(var=-np.ones((5, 6))).sd).all()


def test_select_takes_rows_of_every_column():
    part = truth(q_nb=np.tile([1.0, 0, 0, 0], (5, 1))).select(slice(1, 3))
    assert (len(part), part.lla.shape, part.q_nb.shape) == (2, (2, 3), (2, 4))
    assert len(imu().select(np.array([True, False, True, False, False]))) == 2


def test_withheld_fixes_leave_the_data_and_none_is_lost():
    data, withheld = Dataset(imu(), gnss()).withhold([(1.0, 3.0)])
    np.testing.assert_array_equal(data.gnss.t_ns, T[[0, 3, 4]] * 100)
    np.testing.assert_array_equal(withheld.t_ns, T[[1, 2]] * 100)


def test_outage_windows_count_at_the_time_of_validity():
    _, withheld = Dataset(imu(), gnss()).withhold([(1.0, 3.0)], latency_ns=500_000_000)
    np.testing.assert_array_equal(withheld.t_ns, T[[2, 3]] * 100)


def test_rows_of_a_source_add_up():
    source = Source("a.csv", "00", 10, {"no time stamp": 2, "wrong number of cells": 1})
    assert source.rows_skipped == 3
