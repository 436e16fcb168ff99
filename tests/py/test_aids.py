"""Barometer and heading from tables to result: records, counts, outages, streaming, saved results."""

from dataclasses import replace

import numpy as np
import pytest

import gnssins
from gnssins import Navigator, Result
from gnssins.dataset import BaroTable, Dataset, GnssTable, HeadingTable
from gnssins.errors import InputError
from gnssins.sim import load_scenario, scenario_from_dict, scenario_toml

DEG = np.pi / 180.0
CONFIG = {
    "imu": {"kind": "increments"},
    "filter": {
        "preset": "ned-15",
        "block": [
            {"kind": "baro_bias", "process": "random_walk", "unit": "m", "initial_sd": 5.0, "walk": 0.05}
        ],
    },
    "gnss": {"lever_ba_b_m": [0.4, 0.1, -1.2], "latency_ms": 80.0},
    "baro": {"latency_ms": 30.0, "height_sd_m": 0.5},
    "heading": {"heading_sd_deg": 0.3},
    "run": {"outages": [[60.0, 80.0]]},
}


@pytest.fixture(scope="module")
def drive():
    """A hundred seconds of the car with a barometer that reads 4 m too high and a heading every second."""
    import tomllib

    tables = tomllib.loads(scenario_toml(load_scenario("car-loop")))
    tables["scenario"]["duration_s"] = 100.0
    tables["gnss"]["outages"] = []
    simulated = gnssins.simulate(scenario_from_dict(tables), 5)
    truth, rng = simulated.dataset.truth, np.random.default_rng(1)
    rows = np.arange(50, len(truth), 50)
    height = truth.lla[rows, 2] + 4.0 + 0.5 * rng.standard_normal(rows.size)
    baro = BaroTable(truth.t_ns[rows] + 30_000_000, height, np.full(rows.size, 0.25))
    rows = np.arange(100, len(truth), 100)
    from gnssins import _core

    yaw = _core.quat_to_euler(truth.q_nb[rows])[:, 2] + 0.3 * DEG * rng.standard_normal(rows.size)
    heading = HeadingTable(truth.t_ns[rows], yaw, np.full(rows.size, (0.3 * DEG) ** 2))
    return replace(simulated, dataset=replace(simulated.dataset, baro=baro, heading=heading))


@pytest.fixture(scope="module")
def result(drive):
    return gnssins.run(CONFIG, drive)


def test_every_row_is_counted_and_recorded(drive, result):
    for name, table in (("baro", drive.dataset.baro), ("heading", drive.dataset.heading)):
        counts, records = result.counts[name], result.aids[name]
        fed = counts["in"]
        assert fed + counts.get("withheld", 0) == len(table)
        assert fed == counts["used"] + counts["rejected"] + counts["late"] + counts["bad"] == records.row.size
        np.testing.assert_array_equal(np.diff(records.t_ns) > 0, True)
        used = records.is_status("used")
        assert used.mean() > 0.97
        # the tuning of the preset is on the safe side for these sensors
        assert 0.4 < np.mean(records.nis[used]) < 1.3
    latency = drive.dataset.baro.t_ns[result.aids["baro"].row] - result.aids["baro"].t_ns
    assert set(latency) == {30_000_000}


def test_outages_take_headings_and_leave_the_barometer(result):
    assert result.counts["heading"]["withheld"] == 20
    held = (result.aids["heading"].t_ns >= 60e9) & (result.aids["heading"].t_ns < 80e9)
    assert not held.any()
    assert "withheld" not in result.counts["baro"]
    inside = (result.aids["baro"].t_ns >= 60e9) & (result.aids["baro"].t_ns < 80e9)
    assert inside.sum() == 40


def test_the_bias_is_found_and_the_height_held_through_the_outage(drive, result):
    without = gnssins.run(CONFIG, replace(drive, dataset=replace(drive.dataset, baro=BaroTable.empty())))
    at = np.searchsorted(result.t_ns, int(79.9e9))
    bias = [s.kind for s in result.block_states].index("baro_bias")
    assert result.x[at, bias] == pytest.approx(4.0, abs=4.0 * result.x_sd[at, bias])
    assert result.sd[at, 2] < 0.35 * without.sd[at, 2]
    assert "baro" not in without.counts
    assert "baro" not in without.aids


def test_headings_make_the_heading_known(drive, result):
    without = gnssins.run(
        CONFIG, replace(drive, dataset=replace(drive.dataset, heading=HeadingTable.empty()))
    )
    # the car rests for 20 s: nothing else tells the heading
    at = np.searchsorted(result.t_ns, int(15e9))
    assert np.degrees(result.sd[at, 8]) < 0.2
    assert np.degrees(without.sd[at, 8]) > 2.0


def test_the_stream_gives_the_bits_of_the_run(drive, result):
    data, _ = drive.dataset.withhold([(60.0, 80.0)], 80_000_000)
    nav = Navigator(CONFIG, drive.initial)
    rows = [(t - 80_000_000, 0, "gnss", i) for i, t in enumerate(data.gnss.t_ns)]
    rows += [(t - 30_000_000, 1, "baro", i) for i, t in enumerate(data.baro.t_ns)]
    rows += [(t, 2, "heading", i) for i, t in enumerate(data.heading.t_ns)]
    rows += [(t, 3, "imu", i) for i, t in enumerate(data.imu.t_ns)]
    for _, _, kind, i in sorted(rows):
        if kind == "imu":
            nav.imu(int(data.imu.t_ns[i]), data.imu.gyro[i], data.imu.accel[i])
        elif kind == "gnss":
            nav.gnss(
                int(data.gnss.t_ns[i]),
                lla=data.gnss.lla[i],
                v_n=data.gnss.v_n[i],
                cov=np.diag(data.gnss.var[i]),
            )
        elif kind == "baro":
            nav.baro(int(data.baro.t_ns[i]), data.baro.height_m[i])
        else:
            nav.heading(int(data.heading.t_ns[i]), data.heading.heading_rad[i])
    nav.finish()
    assert nav.state.lla.tobytes() == result.lla[-1].tobytes()
    assert nav.counts["baro"] == result.counts["baro"]
    taken = nav.take_measurements()
    innovations = [m.innovation[0] for m in taken if m.source == "heading"]
    np.testing.assert_array_equal(innovations, result.aids["heading"].innovation)
    assert all(m.innovation_cov.shape == (1, 1) for m in taken if m.source == "baro")


def test_a_row_without_accuracy_is_refused(drive):
    nav = Navigator({**CONFIG, "baro": {}, "heading": {}}, drive.initial)
    with pytest.raises(InputError, match="height_sd_m"):
        nav.baro(1.0, 100.0)
    with pytest.raises(InputError, match="heading_sd_deg"):
        nav.heading(1.0, 1.0)
    nav.baro(1.0, 100.0, 0.5)
    nav.heading(1.0, 1.0, 0.01)
    assert nav.counts["baro"]["in"] == nav.counts["heading"]["in"] == 1


def test_records_survive_the_folder(result, tmp_path):
    result.save(tmp_path)
    again = Result.open(tmp_path)
    for name, records in result.aids.items():
        other = again.aids[name]
        np.testing.assert_array_equal(records.row, other.row)
        np.testing.assert_array_equal(records.status, other.status)
        np.testing.assert_allclose(records.innovation, other.innovation, rtol=1e-14)
        np.testing.assert_allclose(records.variance, other.variance, rtol=1e-14)
        assert tuple(records.reason) == tuple(other.reason)
    np.testing.assert_array_equal(again.records.refused, result.records.refused)
    (tmp_path / "aids.parquet").unlink()
    assert Result.open(tmp_path).aids == {}


def test_a_bad_row_is_an_event_with_its_row(drive):
    height = np.array(drive.dataset.baro.height_m)
    height[7] = np.nan
    baro = BaroTable(drive.dataset.baro.t_ns, height, drive.dataset.baro.var)
    result = gnssins.run(CONFIG, replace(drive, dataset=replace(drive.dataset, baro=baro)))
    assert [e.row for e in result.log if e.code == "baro.bad"] == [7]
    assert result.counts["baro"]["bad"] == 1
    assert np.isnan(result.aids["baro"].innovation[7])


def with_fault(drive, offset_m, from_s):
    """The drive with fixes that jump to the north from a time on; the velocities stay right."""
    gnss = drive.dataset.gnss
    lla = np.array(gnss.lla)
    lla[gnss.t_ns > from_s * 1e9, 0] += offset_m / 6.37e6
    table = GnssTable(gnss.t_ns, lla, gnss.v_n, gnss.var)
    return replace(drive, dataset=replace(drive.dataset, gnss=table))


def test_parts_keep_the_velocity_of_a_fix_with_a_wrong_position(drive):
    faulty = with_fault(drive, 60.0, 85.0)
    config = {**CONFIG, "run": {}, "gnss": {**CONFIG["gnss"], "gate": "parts", "reacquire_after": "off"}}
    result = gnssins.run(config, faulty)
    late = result.records.t_ns > 86e9
    assert (result.records.refused[late] == 0b111).all()
    assert set(np.array(result.records.reason)[late]) == {"chi-square gate"}
    assert result.records.is_status("used")[late].all()
    assert (
        result.event_counts()["gnss.part_rejected"]
        == late.sum() + ((result.records.t_ns >= 85e9) & ~late).sum()
    )
    joint = gnssins.run({**config, "gnss": {**config["gnss"], "gate": "joint"}}, faulty)
    assert joint.records.is_status("rejected")[late].all()
    # the velocities go on: the solution without them is looser
    assert result.sd[-1, 3] < 0.9 * joint.sd[-1, 3]


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [("trace_ratio_limit", 10.0, "trace ratio"), ("max_accel_m_s2", 5.0, "beyond what the vehicle can do")],
)
def test_the_other_tests_of_a_fix_name_themselves(drive, key, value, reason):
    gnss = {**CONFIG["gnss"], "gate_probability": "off", key: value}
    result = gnssins.run({**CONFIG, "run": {}, "gnss": gnss}, with_fault(drive, 300.0, 85.0))
    first = int(np.argmax(result.records.t_ns >= 85e9))
    assert result.records.refused[first] == 0b111
    assert result.records.reason[first] == reason
    assert (result.records.refused[:first] == 0).all()


def test_a_change_of_constellation_in_an_outage_shows_in_the_next_fix(drive):
    gnss = drive.dataset.gnss
    changed = np.zeros(len(gnss), dtype=bool)
    changed[np.searchsorted(gnss.t_ns, int(70e9))] = True
    marked = replace(gnss, new_constellation=changed)
    block = {
        "kind": "gnss_position_error",
        "process": "gauss_markov",
        "unit": "m",
        "sd": 1.0,
        "tau_s": 100.0,
        "jump_sd": 20.0,
    }
    config = {
        **CONFIG,
        "filter": {"preset": "ned-15", "block": [block]},
        "gnss": {**CONFIG["gnss"], "gate_probability": "off"},
    }

    def sd_after(table):
        result = gnssins.run(config, replace(drive, dataset=replace(drive.dataset, gnss=table)))
        state = [s.block for s in result.states].index("gnss_position_error") - 9
        return result.x_sd[np.searchsorted(result.t_ns, int(80.5e9)), state]

    assert sd_after(marked) > 2.0 * sd_after(gnss)


def test_the_linearised_system_carries_the_covariance(drive):
    """With Phi, H and R of the records alone the covariance at the end comes out, but for the process noise."""
    data = replace(drive.dataset, gnss=drive.dataset.gnss.select(slice(0, 3)))
    data = Dataset(data.imu.select(slice(0, 100)), data.gnss, data.truth, baro=data.baro.select(slice(0, 1)))
    config = {**CONFIG, "run": {"linearise": True, "covariance_interval_s": 0.01}}
    result = gnssins.run(config, replace(drive, dataset=data))
    lin = result.linearisation
    assert lin is not None
    assert lin.axes == "ned"
    assert lin.phi.shape == (len(lin), 16, 16)
    assert [int(np.isfinite(h[:, 0]).sum()) for h in lin.h] == [6, 6, 1, 6]
    baro = np.flatnonzero(np.isfinite(lin.h[:, :, 0]).sum(axis=1) == 1)[0]
    row = lin.h[baro, 0]
    assert (row[8], row[15]) == (-1.0, -1.0)
    # position follows velocity over the time since the row before
    dt = np.diff(lin.t_ns) / 1e9
    np.testing.assert_allclose(lin.phi[1:, 6, 3], dt, rtol=1e-6)
    np.testing.assert_allclose(lin.phi[1:, 0, 9], -dt * np.cos(0.0), rtol=0.9)
    np.testing.assert_allclose(np.linalg.det(lin.phi), 1.0, atol=1e-4)
    assert gnssins.run(CONFIG | {"run": {}}, replace(drive, dataset=data)).linearisation is None


def test_components_refused_by_parts_are_drawn_as_refused(drive):
    from matplotlib import pyplot as plt

    from gnssins import plots

    config = {**CONFIG, "run": {}, "gnss": {**CONFIG["gnss"], "gate": "parts", "reacquire_after": "off"}}
    result = gnssins.run(config, with_fault(drive, 60.0, 85.0))
    figure = plots.innovations(result)
    crosses = {
        ax.get_ylabel() + str(ax.get_subplotspec().colspan.start): sum(
            len(line.get_xdata()) for line in ax.lines if line.get_marker() in ("x", "^", "v")
        )
        for ax in figure.axes
    }
    position = [n for name, n in crosses.items() if name.endswith("0")]
    assert max(position) >= (result.records.refused == 0b111).sum() - 1
    plt.close(figure)
