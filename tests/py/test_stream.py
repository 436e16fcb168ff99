"""One row as arrays, as six numbers or in blocks: the same bits, and errors that name the row."""

import threading

import numpy as np
import pytest

from gnssins import Navigator
from gnssins.errors import GapError, InputError, TimeOrderError
from short_flight import config, simulated

ROWS = 3000


def _navigator():
    return Navigator(config(), simulated().initial)


def _table(first=1, last=ROWS):
    imu = simulated().dataset.imu
    return imu.t_ns[first:last], imu.gyro[first:last], imu.accel[first:last]


def _fixes():
    gnss = simulated().dataset.gnss
    return [
        (int(t), lla, v, sd) for t, lla, v, sd in zip(gnss.t_ns, gnss.lla, gnss.v_n, gnss.sd, strict=True)
    ]


def _one_by_one(feed, fixes=True):
    """The state after rows fed one by one, fixes among them."""
    nav, waiting = _navigator(), _fixes() if fixes else []
    for t, w, f in zip(*_table(), strict=True):
        while waiting and waiting[0][0] <= t:
            stamp, lla, v_n, sd = waiting.pop(0)
            nav.gnss(stamp, lla=lla, v_n=v_n, sd=sd)
        feed(nav, t, w, f)
    return nav


def test_every_way_to_feed_a_row_gives_the_same_bits():
    ways = [
        lambda nav, t, w, f: nav.imu(int(t), w, f),
        lambda nav, t, w, f: nav.imu(t, w.tolist(), tuple(f)),
        lambda nav, t, w, f: nav.imu(t, np.tile(w, 2)[:3][::-1][::-1], np.repeat(f, 2)[::2]),
        lambda nav, t, w, f: nav.imu_xyz(int(t), *w, *f),
        lambda nav, t, w, f: nav.imu_xyz(t / 1e9, *w.tolist(), *f.tolist()),
        lambda nav, t, w, f: nav.imu_many([t], [w], [f]),
    ]
    assert len({_one_by_one(way).save() for way in ways}) == 1


@pytest.mark.parametrize("sizes", [[ROWS], [1, 2, 63, 64, 65, 500, ROWS]])
def test_blocks_give_the_bits_of_single_rows(sizes):
    single, blocks = _one_by_one(lambda nav, t, w, f: nav.imu(int(t), w, f)), _navigator()
    for stamp, lla, v_n, sd in _fixes():
        if stamp <= _table()[0][-1]:
            blocks.gnss(stamp, lla=lla, v_n=v_n, sd=sd)
    at = 0
    for size in sizes:
        t, w, f = (column[at : at + size] for column in _table())
        blocks.imu_many(t, w, f)
        at += size
    assert blocks.save() == single.save()
    assert [m.nis for m in blocks.take_measurements()] == [m.nis for m in single.take_measurements()]


def test_a_block_may_be_larger_than_what_is_copied_at_once():
    nav, other = _navigator(), _navigator()
    rows = 40_000
    t = np.arange(1, rows + 1) * 20_000_000
    w, f = np.full((rows, 3), 1e-6), np.tile([0.0, 0.0, -0.19], (rows, 1))
    nav.imu_many(t, w, f)
    for first in range(0, rows, 7000):
        other.imu_many(*(column[first : first + 7000] for column in (t, w, f)))
    assert nav.save() == other.save()


def test_times_of_a_block_may_be_seconds_and_its_arrays_of_any_layout():
    t, w, f = _table(1, 200)
    runs = []
    for block in (
        (t, w, f),
        (t / 1e9, np.asfortranarray(w), f.tolist()),
        (t.astype(np.int32), np.repeat(w, 2, axis=0)[::2], f) if t.max() < 2**31 else (list(t), w, f),
    ):
        nav = _navigator()
        nav.imu_many(*block)
        runs.append(nav.save())
    assert runs[0] == runs[1] == runs[2]


def test_estimates_come_at_the_spacing_asked_for():
    t, w, f = _table()
    nav, single = _navigator(), _navigator()
    every = nav.imu_many(t, w, f, interval_s=0.0)
    assert np.array_equal(every.t_ns, t)
    states = [(single.imu(int(a), b, c), single.state)[1] for a, b, c in zip(t, w, f, strict=True)]
    for name in ("lla", "v_n", "rpy", "q_nb", "sd", "x", "x_sd"):
        assert np.array_equal(getattr(every, name), np.array([getattr(s, name) for s in states])), name
    second = _navigator().imu_many(t, w, f, interval_s=1.0)
    assert np.array_equal(second.t_ns, [t[0], *range(10**9, int(t[-1]) + 1, 10**9)])
    assert np.array_equal(second.lla[1:], every.lla[np.isin(t, second.t_ns)][1:])
    assert len(_navigator().imu_many(t, w, f)) == 0


def test_an_error_in_a_block_names_its_row_and_keeps_the_rows_before():
    t, w, f = (np.array(column) for column in _table(1, 1000))
    t[700] -= 40_000_000
    nav, single = _navigator(), _navigator()
    with pytest.raises(TimeOrderError, match="row 700 of the block") as caught:
        nav.imu_many(t, w, f)
    assert caught.value.context["block_row"] == 700
    single.imu_many(t[:700], w[:700], f[:700])
    assert nav.save() == single.save()
    # the caller may go on behind it
    nav.imu_many(t[701:], w[701:], f[701:])
    t[300:] += 10_000_000_000
    with pytest.raises(GapError) as caught:
        _navigator().imu_many(t, w, f)
    assert caught.value.context["block_row"] == 300


@pytest.mark.parametrize(
    ("t", "w", "code"),
    [
        ([0.02, np.nan], np.zeros((2, 3)), "input.time"),
        ([0.02, 1e12], np.zeros((2, 3)), "input.time"),
        (["a", "b"], np.zeros((2, 3)), "input.time"),
        ([0.02, 0.04], np.zeros((2, 2)), "input.shape"),
        ([0.02, 0.04], np.zeros((3, 3)), "input.shape"),
        ([0.02, 0.04], np.zeros(6), "input.dtype"),
        ([0.02, 0.04], "abc", "input.dtype"),
    ],
)
def test_a_block_that_cannot_be_read_is_refused_as_a_whole(t, w, code):
    nav = _navigator()
    with pytest.raises(InputError) as caught:
        nav.imu_many(t, w, np.zeros((2, 3)))
    assert caught.value.code == code
    assert nav.counts["imu"]["in"] == 0


def test_six_numbers_must_be_numbers():
    nav = _navigator()
    with pytest.raises(TypeError):
        nav.imu_xyz(0.02, "a", 0.0, 0.0, 0.0, 0.0, -0.19)
    with pytest.raises(InputError):
        nav.imu_xyz(2**70, 0.0, 0.0, 0.0, 0.0, 0.0, -0.19)
    assert nav.counts["imu"]["in"] == 0


def test_a_long_block_lets_other_threads_run():
    rows = 60_000
    t, stop, turns = np.arange(1, rows + 1) * 20_000_000, threading.Event(), []

    def count():
        while not stop.is_set():
            turns.append(None)
            stop.wait(0.001)

    other = threading.Thread(target=count)
    other.start()
    before = len(turns)
    _navigator().imu_many(t, np.zeros((rows, 3)), np.tile([0.0, 0.0, -0.19], (rows, 1)))
    during = len(turns) - before
    stop.set()
    other.join()
    assert during > 5
