"""gnssins.run and gnssins.Navigator: what goes in is accounted for, and both give the same bits."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import gnssins
from gnssins import Dataset, GnssTable, ImuTable, Navigator, _core
from gnssins.errors import ConfigError, GapError, InputError, StateError, TimeOrderError
from short_flight import GAP_S, config, result, simulated, start_at

S = 1_000_000_000


def test_rows_in_are_used_rejected_late_or_bad_and_the_rest_is_withheld():
    r = result()
    for counts in r.counts.values():
        assert counts["in"] == sum(counts[k] for k in ("used", "rejected", "late", "bad"))
    assert r.counts["imu"]["in"] == len(simulated().dataset.imu)
    assert r.counts["gnss"]["in"] + r.counts["gnss"]["withheld"] == len(simulated().dataset.gnss)
    assert r.counts["gnss"]["withheld"] == 50


def test_every_fix_has_one_record_in_the_order_of_the_table():
    r, gnss = result().records, simulated().dataset.gnss
    assert np.array_equal(r.row, np.arange(len(gnss)))
    assert np.array_equal(r.lla, gnss.lla)
    held = r.is_status("withheld")
    assert np.array_equal(held, (r.t_ns >= GAP_S[0] * S) & (r.t_ns < GAP_S[1] * S))
    assert np.isnan(r.nis[held]).all()
    assert np.isnan(r.innovation[held]).all()
    assert (r.dof[held] == 0).all()
    assert set(np.array(r.reason)[held]) == {"withheld by [run] outages"}
    assert set(np.array(r.reason)[r.is_status("used")]) == {""}


def test_the_same_input_gives_the_same_bytes():
    again = gnssins.run(config(outages=[GAP_S]), simulated())
    for name in ("t_ns", "lla", "v_n", "q_nb", "sd", "x", "x_sd"):
        assert np.array_equal(getattr(again, name), getattr(result(), name)), name
    assert again.final_state == result().final_state


def test_config_may_be_an_object_its_tables_or_a_file(tmp_path):
    whole = config(end_s=20.0)
    path = tmp_path / "run.toml"
    whole.to_toml(path)
    runs = [gnssins.run(c, simulated()) for c in (whole, whole.to_dict(), path, str(path))]
    assert len({r.final_state for r in runs}) == 1
    assert runs[0].t_ns[-1] <= 20 * S


def test_progress_rises_to_one():
    shares = []
    gnssins.run(config(), simulated(), progress=shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_only_positions_are_used_if_so_configured():
    r = gnssins.run(config().replace(gnss={"use": "position"}), simulated())
    assert set(r.records.dof) == {3}
    assert np.isnan(r.records.innovation[:, 3:]).all()
    assert np.isfinite(r.records.innovation[:, :3]).all()


def test_records_carry_the_time_of_validity():
    data = simulated().dataset
    late = replace(data.gnss, t_ns=data.gnss.t_ns + 120_000_000)
    r = gnssins.run(
        config().replace(gnss={"latency_ms": 120.0}), replace(data, gnss=late), initial=simulated().initial
    )
    assert np.array_equal(r.records.t_ns, data.gnss.t_ns)
    assert r.counts["gnss"]["used"] > 295


def test_rows_outside_start_and_end_take_no_part():
    data = simulated().dataset
    r = gnssins.run(config(start_s=10.0, end_s=60.0), data, initial=start_at(10.0))
    assert r.counts["imu"]["in"] == 50 * 50 + 1
    assert r.counts["gnss"]["in"] == 51
    assert r.records.row[0] == 9


def test_event_rows_are_rows_of_the_tables_as_handed_in():
    data = simulated().dataset
    gyro = np.array(data.imu.gyro)
    gyro[1234, 1] = np.nan
    lla = np.array(data.gnss.lla)
    lla[30] = [np.nan, 0.1, 0.1]
    broken = replace(data, imu=replace(data.imu, gyro=gyro), gnss=replace(data.gnss, lla=lla))
    r = gnssins.run(config(start_s=10.0, end_s=60.0), broken, initial=start_at(10.0))
    rows = {event.code: event.row for event in r.log}
    assert rows["imu.not_finite"] == 1234
    assert rows["gnss.bad"] == 30
    bad = next(event for event in r.log if event.code == "gnss.bad")
    reason = r.records.reason[list(r.records.row).index(30)]
    assert reason
    assert bad.message == f"GNSS row not usable: {reason}"
    assert r.counts["imu"]["bad"] == 1
    assert r.counts["gnss"]["bad"] == 1


def test_no_imu_row_between_start_and_end_is_an_error():
    with pytest.raises(InputError, match="no IMU row between start_s and end_s"):
        gnssins.run(config(start_s=400.0), simulated())


@pytest.mark.parametrize("window", [[400.0, 450.0], [300.0, 310.0], [2.0, 10.0]])
def test_an_outage_window_outside_of_the_filtered_span_is_an_error(window):
    whole = config(start_s=10.0, outages=sorted([window, [100.0, 120.0]]))
    with pytest.raises(ConfigError, match=r"1 of 2 windows outside .* 10\.000 to 300\.000 s") as caught:
        gnssins.run(whole, simulated(), initial=start_at(10.0))
    assert caught.value.code == "config.outage_outside"
    assert f"[{window[0]:g}, {window[1]:g}]" in caught.value.message


def test_a_gap_beyond_the_limit_stops_the_run():
    data = simulated().dataset
    keep = (data.imu.t_ns < 30 * S) | (data.imu.t_ns > 35 * S)
    with pytest.raises(GapError):
        gnssins.run(config(), replace(data, imu=data.imu.select(keep)), initial=simulated().initial)


def test_metadata_says_where_the_result_comes_from():
    meta = result().metadata
    assert meta["run"]["seed"] == 1
    assert meta["run"]["scenario"] == "fomichev-tan-2017"
    assert meta["versions"]["gnssins"] == gnssins.__version__
    assert [entry["table"] for entry in meta["input"]] == ["imu", "gnss"]
    assert all(len(entry["sha256"]) == 64 for entry in meta["input"])
    assert meta["config"]["filter"]["preset"] == "fomichev-tan-2017"


def test_modules_are_attributes_of_the_package_and_load_late():
    code = (
        "import sys, gnssins\n"
        "assert 'gnssins.checks' not in sys.modules\n"
        "for name in ('checks', 'errors', 'result', 'config', 'sim'):\n"
        "    assert getattr(gnssins, name).__name__ == f'gnssins.{name}', name\n"
        "assert gnssins.errors.InputError.__name__ == 'InputError'"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# ---- sample by sample


def _streamed(until: int, nav: Navigator, first: int = 0) -> Navigator:
    data = simulated().dataset
    imu, gnss = data.imu, data.gnss
    fix = int(np.searchsorted(gnss.t_ns, imu.t_ns[first - 1] if first else 0, side="right"))
    for k in range(first, until):
        while fix < len(gnss) and gnss.t_ns[fix] <= imu.t_ns[k]:
            nav.gnss(int(gnss.t_ns[fix]), lla=gnss.lla[fix], v_n=gnss.v_n[fix], sd=gnss.sd[fix])
            fix += 1
        nav.imu(int(imu.t_ns[k]), imu.gyro[k], imu.accel[k])
    return nav


def test_streaming_gives_the_bits_of_the_batch():
    batch = gnssins.run(config(end_s=30.0, output_rate_hz=50.0), simulated())
    # the sd of a fix is squared back to a variance: give the variance itself
    nav = _streamed(batch.counts["imu"]["in"], Navigator(config(), simulated().initial))
    state = nav.state
    assert state.t_ns == batch.t_ns[-1]
    for name in ("lla", "v_n", "q_nb", "rpy", "sd", "x", "x_sd"):
        assert np.array_equal(getattr(state, name), getattr(batch, name)[-1]), name
    assert nav.save() == batch.final_state
    assert nav.counts["imu"] == batch.counts["imu"]
    assert nav.states == batch.states
    assert np.array_equal(np.sqrt(np.diag(nav.covariance))[9:], state.x_sd)


def test_a_restored_navigator_goes_on_with_the_same_bits():
    whole = _streamed(900, Navigator(config(), simulated().initial))
    half = _streamed(450, Navigator(config(), simulated().initial))
    other = Navigator(config(), simulated().initial)
    other.restore(half.save())
    assert _streamed(900, other, first=450).save() == whole.save()


def test_a_navigator_goes_on_from_the_end_of_a_run():
    batch = gnssins.run(config(end_s=10.0), simulated())
    nav = Navigator(config(), simulated().initial)
    nav.restore(batch.final_state)
    assert nav.state.t_ns == batch.t_ns[-1] or nav.state.t_ns == 10 * S


def test_a_saved_state_of_another_filter_is_refused():
    nav = Navigator(config(), simulated().initial)
    other = Navigator({"filter": {"preset": "ned-15"}}, simulated().initial)
    with pytest.raises(StateError):
        other.restore(nav.save())


def test_times_are_seconds_as_float_and_nanoseconds_as_int():
    runs = []
    for t in ((0.02, 0.04), (20_000_000, 40_000_000), (np.float64(0.02), np.int64(40_000_000))):
        nav = Navigator(config(), simulated().initial)
        for stamp in t:
            nav.imu(stamp, [0.0, 0.0, 1e-5], [0.0, 0.0, -0.19])
        runs.append(nav.save())
    assert runs[0] == runs[1] == runs[2]
    assert nav.state.time_s == 0.04


def test_time_going_backwards_is_refused_and_the_row_not_taken():
    nav = Navigator(config(), simulated().initial)
    nav.imu(0.02, [0.0, 0.0, 0.0], [0.0, 0.0, -0.19])
    with pytest.raises(TimeOrderError):
        nav.imu(0.01, [0.0, 0.0, 0.0], [0.0, 0.0, -0.19])
    assert nav.counts["imu"]["in"] == 1


def test_a_fix_without_accuracy_is_refused():
    nav = Navigator(config(), simulated().initial)
    with pytest.raises(InputError, match="accuracy of a fix"):
        nav.gnss(1.0, lla=[0.5, 1.8, 150.0])
    with pytest.raises(InputError, match="both sd and cov"):
        nav.gnss(1.0, lla=[0.5, 1.8, 150.0], sd=np.ones(6), cov=np.eye(6))


@pytest.mark.parametrize("wrong", [-1.0, 0.0, np.nan])
def test_an_sd_that_is_not_positive_is_refused(wrong):
    nav = Navigator(config(), simulated().initial)
    lla, v_n = simulated().initial.lla, simulated().initial.v_n
    with pytest.raises(InputError, match="position down, 1 such") as caught:
        nav.gnss(0.02, lla=lla, v_n=v_n, sd=[1.0, 1.0, wrong, 0.1, 0.1, 0.1])
    assert caught.value.code == "input.sd"
    # a component that is absent needs none
    nav.gnss(0.02, lla=lla, v_n=[*v_n[:2], np.nan], sd=[1.0, 1.0, 1.0, 0.1, 0.1, wrong])
    nav.gnss(0.04, lla=lla, sd=[1.0, 1.0, 1.0, wrong, wrong, wrong])
    assert nav.counts["gnss"]["in"] == 2


@pytest.mark.parametrize("time", [np.nan, np.inf, "31", None, True])
def test_a_time_that_is_no_number_is_refused(time):
    nav = Navigator(config(), simulated().initial)
    with pytest.raises(InputError, match="needs a finite number") as caught:
        nav.imu(time, [0.0, 0.0, 0.0], [0.0, 0.0, -0.19])
    assert caught.value.hint
    with pytest.raises(InputError, match="needs a finite number"):
        nav.gnss(time, lla=simulated().initial.lla, sd=np.ones(6))
    assert nav.counts["imu"]["in"] == 0


def test_values_that_are_no_numbers_are_refused():
    nav = Navigator(config(), simulated().initial)
    with pytest.raises(InputError, match="gyro is not numeric"):
        nav.imu(0.02, "abc", [0.0, 0.0, -0.19])
    with pytest.raises(InputError, match="needs"):
        nav.gnss(0.02, lla=[0.5, 1.8], sd=np.ones(6))
    assert nav.counts["gnss"]["in"] == 0


@pytest.mark.parametrize("nothing", [None, {}, 3.0, {"t_ns": 0}])
def test_a_navigator_without_an_initial_state_says_what_it_needs(nothing):
    with pytest.raises(InputError, match="the initial state") as caught:
        Navigator(config(), nothing)
    assert caught.value.code == "input.initial"
    assert "initial_state(config, dataset)" in caught.value.hint


def test_measurements_and_events_are_handed_out_once():
    nav = _streamed(100, Navigator(config(), simulated().initial))
    records = nav.take_measurements()
    assert [m.status for m in records] == ["used", "used"]
    assert records[0].dof == 6
    assert records[0].innovation.shape == (6,)
    assert nav.take_measurements() == []
    assert nav.take_events() == []


def test_the_accuracy_of_the_configuration_stands_in_for_a_missing_one():
    with_sd = config().replace(gnss={"position_sd_m": 1.0, "velocity_sd_m_s": 0.05})
    runs = []
    for keys in ({}, {"sd": [1.0, 1.0, 1.0, 0.05, 0.05, 0.05]}, {"cov": np.diag([1.0] * 3 + [0.05**2] * 3)}):
        nav = Navigator(with_sd, simulated().initial)
        nav.gnss(0.02, lla=simulated().initial.lla, v_n=simulated().initial.v_n, **keys)
        nav.imu(0.02, [0.0, 0.0, 0.0], [0.0, 0.0, -0.19])
        runs.append(nav.save())
    assert runs[0] == runs[1] == runs[2]


def test_a_pure_inertial_run_needs_no_fixes():
    data = simulated().dataset
    r = gnssins.run(config(), Dataset(data.imu, GnssTable.empty()), initial=simulated().initial)
    assert r.counts["gnss"]["in"] == 0
    assert len(r.records.row) == 0
    assert r.measurements.height == 0
    assert np.all(np.diff(r.sd[:, 0]) > -1e-9)


def test_one_imu_row_is_enough_for_a_result():
    data = Dataset(ImuTable(np.array([20_000_000]), [[0.0, 0.0, 0.0]], [[0.0, 0.0, -0.19]], "increments"))
    r = gnssins.run(config(), replace(simulated(), dataset=data))
    assert len(r) == 1


@pytest.mark.parametrize("kind", ["rates", "mean-rates"])
def test_a_gap_of_the_imu_takes_in_all_fixes_that_came_meanwhile(kind):
    engine = json.loads(_core.preset_json("ned-15"))
    engine["imu"] |= {"input": kind, "max_gap_ns": 10_000_000_000}
    still = {
        "lat_rad": 0.5,
        "lon_rad": 1.0,
        "height_m": 100.0,
        "v_n": [0.0] * 3,
        "q_nb": [1.0, 0.0, 0.0, 0.0],
    }
    engine["initial"] = {"t_ns": 0, **still, "sd_phi": [0.01] * 3, "sd_v": [0.1] * 3, "sd_p": [1.0] * 3}
    # 4 s without IMU rows, 40 fixes in them
    t_ns = np.delete(np.arange(2000, dtype=np.int64) * 10_000_000, slice(1000, 1400))
    rows = len(t_ns)
    found = _core.run(
        json.dumps(engine),
        t_ns,
        np.zeros((rows, 3)),
        np.tile([0.0, 0.0, -9.79], (rows, 1)),
        np.arange(1, 199, dtype=np.int64) * 100_000_000,
        np.tile([0.5, 1.0, 100.0], (198, 1)),
        np.zeros((198, 3)),
        np.ones((198, 6)),
    )
    assert found["counts"]["gnss"]["used"] == 198
    assert [event["code"] for event in found["events"]] == ["imu.gap"]
    assert np.abs(found["v_n"][-1]).max() < 0.01
