"""Separated operation: what each mode does to a free INS, exact where sensors and fixes are."""

from dataclasses import replace

import numpy as np
import pytest

import gnssins
from gnssins import Result, plots
from gnssins.analysis import compare, outage_table
from gnssins.analysis.errors import ned_difference
from gnssins.dataset import Dataset, ImuTable
from gnssins.errors import ConfigError, InputError
from gnssins.sim import scenario_from_dict, simulate
from gnssins.uncoupled import MODES

G0 = 9.80665
OUTAGE = (200.0, 260.0)


def flight(
    seed=1, *, noise=1e-6, bias_ug=0.0, error=None, outages=(OUTAGE,), lever=(0.0, 0.0, 0.0), latency_ms=0.0
):
    """A weaving flight of 300 s with fixes at 1 Hz, all but exact if nothing else is asked."""
    tables = {
        "scenario": {"name": "weave", "duration_s": 300.0, "rate_hz": 50.0},
        "start": {
            "lat_deg": 50.0,
            "lon_deg": 179.99,
            "height_m": 500.0,
            "speed_m_s": 50.0,
            "heading_deg": 80.0,
        },
        "turn": [
            {"start_s": 20.0 + 60.0 * k, "length_s": 20.0, "rate_deg_s": 3.0 * (-1.0) ** k} for k in range(4)
        ],
        "slope": [{"from_s": 60.0, "to_s": 100.0, "angle_deg": 5.0}],
        "gnss": {
            "rate_hz": 1.0,
            "position_sd_m": noise,
            "velocity_sd_m_s": noise,
            "lever_ba_b_m": list(lever),
            "latency_ms": latency_ms,
            "outages": [list(w) for w in outages],
        },
        "initial_error": error or {"attitude_sd_deg": 0.0, "velocity_sd_m_s": 0.0, "position_sd_m": 0.0},
    }
    if bias_ug:
        tables["imu"] = {
            "error": [{"kind": "accel_bias", "process": "constant", "unit": "ug", "initial_sd": bias_ug}]
        }
    return simulate(scenario_from_dict(tables), seed)


def errors(result, simulated):
    return compare(result, simulated.dataset.truth)


def at(result, t_s):
    return int(np.flatnonzero(result.t_ns == round(t_s * 1e9))[0])


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("vertical", ["free", "gnss"])
def test_exact_sensors_and_fixes_stay_on_the_truth_in_every_mode(mode, vertical):
    simulated = flight()
    result = gnssins.separated(simulated, mode, vertical=vertical)
    found = errors(result, simulated)
    assert np.abs(found.position[:, :2]).max() < 2e-3
    # straight lines between the heights of two fixes cut the corners of a climb
    assert np.abs(found.position[:, 2]).max() < (2e-3 if vertical == "free" else 0.5)
    assert len(found) == 15000
    assert np.isnan(result.sd).all()


def test_free_ins_does_not_listen():
    simulated = flight(error={"attitude_sd_deg": 0.01, "velocity_sd_m_s": 0.1, "position_sd_m": 5.0})
    result = gnssins.separated(simulated, "free", vertical="free")
    assert result.counts["gnss"]["used"] == 0
    assert np.isnan(result.records.innovation).all()
    first = errors(result, simulated)
    np.testing.assert_allclose(first.position[0, :2], simulated.initial_error[6:8], atol=0.02)


def test_restart_sets_the_ins_to_every_fix_and_keeps_its_attitude():
    simulated = flight(
        noise=2.0, error={"attitude_sd_deg": 0.5, "velocity_sd_m_s": 1.0, "position_sd_m": 50.0}
    )
    result = gnssins.separated(simulated, "restart")
    free = gnssins.separated(simulated, "free", vertical="free")
    gnss = simulated.dataset.gnss
    rows = np.array([at(result, t / 1e9) for t in gnss.t_ns])
    assert np.abs(ned_difference(result.lla[rows], gnss.lla)).max() < 1e-6
    np.testing.assert_allclose(result.v_n[rows], gnss.v_n, atol=1e-9)
    assert np.abs(errors(result, simulated).phi).max() > 1e-3
    # its own attitude: that of the free INS but for the rates of the axes, which follow the velocity
    assert np.abs(compare(result, free).phi).max() < 1e-3
    assert result.counts["gnss"] == {
        "in": 240, "used": 240, "rejected": 0, "late": 0, "bad": 0, "withheld": 0,
    }  # fmt: skip
    # innovation: fix minus INS, at first the errors of the start
    np.testing.assert_allclose(result.records.innovation[0, :2], -simulated.initial_error[6:8], atol=6.0)


def test_restart_at_a_period_uses_every_tenth_fix():
    simulated = flight(noise=1.0, outages=())
    result = gnssins.separated(simulated, "restart", period_s=10.0)
    assert result.counts["gnss"]["used"] == 30
    used = result.records.t_ns[result.records.is_status("used")]
    assert set(np.diff(used)) == {10_000_000_000}
    rejected = result.records.is_status("rejected")
    assert rejected.sum() == 270
    assert "does not use" in result.records.reason[int(np.flatnonzero(rejected)[0])]


def test_restart_at_gap_uses_the_last_fix_before_each_gap_and_no_other():
    windows = [(100.0, 130.0), (200.0, 260.0)]
    simulated = flight(
        noise=0.3,
        outages=windows,
        error={"attitude_sd_deg": 0.02, "velocity_sd_m_s": 0.5, "position_sd_m": 20.0},
    )
    result = gnssins.separated(simulated, "restart-at-gap")
    used = result.records.t_ns[result.records.is_status("used")]
    np.testing.assert_array_equal(used, [99_000_000_000, 199_000_000_000])
    found = errors(result, simulated)
    horizontal = np.hypot(*found.position[:, :2].T)
    before, after = at(result, 98.98), at(result, 99.0)
    assert horizontal[before] > 20.0 > 5.0 > horizontal[after]
    table = outage_table(result, simulated.dataset.truth)
    assert [o.start_s for o in table.outages] == [100.0, 200.0]
    # in the gap the INS runs on from that fix: no other one is used, and none was withheld from the data by hand
    assert table.outages[1].max_horizontal_m < 60.0
    assert table.outages[1].epochs == 3001


def test_accelerometer_bias_shows_in_the_gap_as_half_bt2():
    simulated = flight(bias_ug=500.0)
    result = gnssins.separated(simulated, "restart-at-gap", vertical="free")
    bias_b = simulated.truth_blocks["accel_bias"][0]
    start, end = at(result, 199.0), at(result, 260.0)
    c_nb = np.array(gnssins._core.quat_to_dcm(simulated.dataset.truth.q_nb))
    dt = 0.02
    velocity = np.cumsum(c_nb[start:end] @ bias_b, axis=0) * dt
    expected = velocity.sum(axis=0) * dt
    found = errors(result, simulated).position[end - 1]
    # gravity and the rates of the axes feed the error back: a percent in a minute
    np.testing.assert_allclose(found, expected, atol=0.04 * np.linalg.norm(expected))


def test_slaving_takes_an_error_out_with_the_stated_time_constant():
    error = {"attitude_sd_deg": 0.0, "velocity_sd_m_s": 0.0, "position_sd_m": 30.0}
    simulated = flight(error=error, outages=())
    result = gnssins.separated(simulated, "slaved", position_time_s=20.0, velocity_time_s=20.0)
    found = errors(result, simulated)
    start = np.hypot(*simulated.initial_error[6:8])
    for t in (20.0, 60.0):
        left = np.hypot(*found.position[at(result, t), :2])
        assert left == pytest.approx(start * np.exp(-t / 20.0), rel=0.03), t
    whole = gnssins.separated(simulated, "slaved", position_time_s=0.0, velocity_time_s=0.0, vertical="free")
    again = gnssins.separated(simulated, "restart", vertical="free")
    np.testing.assert_allclose(whole.lla, again.lla, atol=1e-12)


def test_lever_arm_latency_and_times_between_samples_are_taken_into_account():
    simulated = flight(lever=(2.0, -1.0, -1.5), latency_ms=127.0)
    late = replace(
        simulated.dataset,
        imu=ImuTable(
            simulated.dataset.imu.t_ns + 7_000_000,
            simulated.dataset.imu.gyro,
            simulated.dataset.imu.accel,
            "increments",
        ),
    )
    result = gnssins.separated(simulated, "restart", vertical="free")
    assert np.abs(errors(result, simulated).position).max() < 0.03
    # stamps of the fixes now lie between the samples: both clocks differ by 7 ms, 0.35 m of way along the track
    start = simulated.initial.to_engine() | {"t_ns": 7_000_000}
    shifted = gnssins.separated(
        late, "restart", initial=start, vertical="free", lever_ba_b_m=(2.0, -1.0, -1.5), latency_ms=120.0
    )
    truth = simulated.dataset.truth
    same = compare(shifted, replace(truth, t_ns=truth.t_ns + 7_000_000))
    assert np.abs(same.position[2000:]).max() < 0.03
    wrong = gnssins.separated(
        late, "restart", initial=start, vertical="free", lever_ba_b_m=(2.0, -1.0, -1.5), latency_ms=127.0
    )
    off = compare(wrong, replace(truth, t_ns=truth.t_ns + 7_000_000))
    along = np.linalg.norm(off.position[2000:9000:50], axis=1)
    assert np.median(along) == pytest.approx(0.35, abs=0.05)


def test_vertical_channel_is_tamed_by_gnss_and_in_the_gap_by_a_barometer():
    simulated = flight(bias_ug=3000.0, seed=4)
    truth = simulated.dataset.truth
    height = truth.t_ns[::5], truth.lla[::5, 2] + 1.0
    down = {}
    for name, more in {
        "free": {"vertical": "free"},
        "gnss": {"vertical": "gnss"},
        "baro": {"vertical": "baro", "height": height},
        "held": {"vertical": "baro", "height": height, "vertical_tau_s": None},
    }.items():
        result = gnssins.separated(simulated, "free", **more)
        down[name] = errors(result, simulated).position[:, 2]
    assert np.abs(down["free"]).max() > 100.0
    assert np.abs(down["gnss"][5000:10000]).max() < 3.0
    # found before the gap, the accelerometer error is taken off in it
    gap = slice(at_time(200.0), at_time(260.0))
    assert np.abs(down["gnss"][gap]).max() < 0.1 * 0.5 * 3000e-6 * G0 * 60.0**2
    assert np.abs(down["baro"][gap] + 1.0).max() < 1.0
    assert np.abs(down["held"][gap] + 1.0).max() < 1e-6


def at_time(t_s):
    return round(t_s * 50.0) - 1


@pytest.mark.parametrize("kind", ["mean-rates", "rates"])
def test_rates_are_integrated_as_well(kind):
    simulated = flight()
    imu = simulated.dataset.imu
    step = np.diff(imu.t_ns, prepend=imu.t_ns[0] - 20_000_000)[:, None] / 1e9
    gyro, accel = imu.gyro / step, imu.accel / step
    if kind == "rates":
        # means of neighbours: the trapezoid of these is close to the increments
        gyro, accel = (np.vstack([0.5 * (v[:-1] + v[1:]), v[-1:]]) for v in (gyro, accel))
    data = replace(simulated.dataset, imu=ImuTable(imu.t_ns, gyro, accel, kind))
    result = gnssins.separated(data, "slaved", initial=simulated.initial, outages=[OUTAGE])
    worst = np.abs(errors(result, simulated).position[:, :2]).max()
    assert worst < (5e-3 if kind == "mean-rates" else 5.0)


def test_withheld_fixes_serve_as_the_reference_of_the_gap():
    simulated = flight(noise=0.5, bias_ug=300.0, outages=())
    result = gnssins.separated(simulated, "restart", outages=[OUTAGE], output_rate_hz=1.0)
    assert len(result) == 300
    assert result.counts["gnss"]["withheld"] == 60
    table = outage_table(result)
    against_truth = outage_table(result, simulated.dataset.truth)
    assert table.outages[0].epochs == 60
    assert table.outages[0].max_horizontal_m == pytest.approx(
        against_truth.outages[0].max_horizontal_m, rel=0.2
    )
    assert result.metadata["separated"]["mode"] == "restart"


def test_result_is_saved_opened_and_drawn(tmp_path):
    simulated = flight(noise=1.0)
    result = gnssins.separated(simulated, output_rate_hz=2.0)
    again = Result.open(result.save(tmp_path / "separated"))
    np.testing.assert_allclose(again.lla, result.lla, atol=1e-12)
    assert again.metadata["separated"]["position_time_s"] == 10.0
    assert plots.track(result, simulated.dataset.truth).axes
    assert plots.position_errors(errors(result, simulated), result.outages()).axes
    assert repr(result).startswith("Result(600 epochs")


def test_fixes_that_cannot_be_used_are_told():
    simulated = flight(outages=())
    gnss = simulated.dataset.gnss
    lla, t_ns = gnss.lla.copy(), gnss.t_ns.copy()
    lla[10] = np.nan
    t_ns[20] = t_ns[21] - 1_000_000  # two within one IMU interval
    t_ns[-1] += 10_000_000_000
    data = replace(simulated.dataset, gnss=replace(gnss, lla=lla, t_ns=t_ns))
    result = gnssins.separated(data, "restart", initial=simulated.initial)
    r = result.records
    assert r.reason[10] == "no position"
    assert r.reason[20] == "another fix follows within the IMU interval"
    assert r.reason[-1] == "valid outside the time span of the INS"
    assert [r.status[i] for i in (9, 10, 20, 21, len(gnss) - 1)] == [0, 3, 1, 0, 2]
    counts = result.counts["gnss"]
    assert counts["in"] == sum(v for k, v in counts.items() if k != "in")
    nothing = Dataset(simulated.dataset.imu)
    assert gnssins.separated(nothing, "slaved", initial=simulated.initial).counts["gnss"]["in"] == 0


def test_what_cannot_be_is_refused():
    simulated = flight(outages=())
    bad = [
        ({"mode": "tied"}, "not known"),
        ({"vertical": "radar"}, "not known"),
        ({"mode": "restart-at-gap"}, "without outages"),
        ({"position_time_s": -1.0}, "at least 0"),
        ({"period_s": -1.0}, "at least 0"),
        ({"vertical_tau_s": 0.0}, "greater than 0"),
        ({"vertical_tau_s": 0.05}, "5 sampling intervals"),
        ({"equations": {"attitude_form": "matrix"}}, "not known"),
    ]
    for more, text in bad:
        with pytest.raises(ConfigError, match=text):
            gnssins.separated(simulated, **more)
    with pytest.raises(InputError, match="initial state"):
        gnssins.separated(simulated.dataset)
    with pytest.raises(InputError, match="no height readings"):
        gnssins.separated(simulated, vertical="baro")
    late = simulated.initial.to_engine() | {"t_ns": 400_000_000_000}
    with pytest.raises(InputError, match="no IMU row after"):
        gnssins.separated(simulated, initial=late)
