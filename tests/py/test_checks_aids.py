"""What the look at the data says about a barometer and about headings."""

from dataclasses import replace

import numpy as np
import pytest

import gnssins
from gnssins import _core
from gnssins.checks import check_dataset
from gnssins.config import Config
from gnssins.dataset import BaroTable, HeadingTable
from gnssins.errors import DataQualityError

DEG = np.pi / 180.0
CONFIG = {
    "filter": {
        "preset": "ned-15",
        "block": [
            {"kind": "baro_bias", "process": "random_walk", "unit": "m", "initial_sd": 5.0, "walk": 0.05}
        ],
    },
    "imu": {"kind": "increments"},
}


@pytest.fixture(scope="module")
def drive():
    simulated = gnssins.simulate("car-loop", 3)
    truth = simulated.dataset.truth
    rows = np.arange(100, len(truth), 100)
    rng = np.random.default_rng(5)
    yaw = _core.quat_to_euler(truth.q_nb[rows])[:, 2] + 0.3 * DEG * rng.standard_normal(rows.size)
    heading = HeadingTable(truth.t_ns[rows], yaw, np.full(rows.size, (0.3 * DEG) ** 2))
    height = truth.lla[rows, 2] + 2.0 + 0.5 * rng.standard_normal(rows.size)
    baro = BaroTable(truth.t_ns[rows], height, np.full(rows.size, 0.25))
    return replace(simulated.dataset, baro=baro, heading=heading)


def found(dataset, config=CONFIG):
    aids = ("baro", "heading", "time.no_overlap")
    return {
        f.code: f.level
        for f in check_dataset(dataset, Config.from_dict(config))
        if any(word in f.code for word in aids)
    }


def heading_of(drive, **changes):
    return replace(drive, heading=replace(drive.heading, **changes))


def baro_of(drive, **changes):
    return replace(drive, baro=replace(drive.baro, **changes))


def test_good_aids_give_no_finding(drive):
    assert found(drive) == {}


def test_a_bias_of_the_barometer_needs_its_block(drive):
    assert found(drive, {**CONFIG, "filter": {"preset": "ned-15"}}) == {"config.no_baro_bias": "warn"}


@pytest.mark.parametrize("shift_s", [10_000.0, -10_000.0])
def test_another_clock_stops(drive, shift_s):
    shift = int(shift_s * 1e9)
    assert found(baro_of(drive, t_ns=drive.baro.t_ns + shift))["time.no_overlap"] == "stop"
    assert found(heading_of(drive, t_ns=drive.heading.t_ns + shift))["time.no_overlap"] == "stop"


def test_an_accuracy_that_is_none_is_told_with_its_rows(drive):
    var = np.array(drive.baro.var)
    var[[3, 7]] = 0.0
    assert found(baro_of(drive, var=var)) == {"data.baro_sd": "warn"}
    finding = next(f for f in check_dataset(baro_of(drive, var=var)) if f.code == "data.baro_sd")
    assert finding.count == 2
    assert "first: row 3" in finding.message
    assert found(heading_of(drive, var=-drive.heading.var)) == {"data.heading_sd": "stop"}


def test_degrees_read_as_radians_stop(drive):
    turned = np.mod(drive.heading.heading_rad / DEG, 360.0)
    assert found(heading_of(drive, heading_rad=turned)) == {"data.heading_unit": "stop"}


@pytest.mark.parametrize("offset", [90.0, -90.0, 180.0])
def test_antennas_that_do_not_lie_along_are_told_with_their_angle(drive, offset):
    table = heading_of(drive, heading_rad=drive.heading.heading_rad + offset * DEG)
    assert found(table) == {"data.heading_offset": "warn"}
    finding = next(f for f in check_dataset(table) if f.code == "data.heading_offset")
    told = float(finding.hint.split("offset_deg = ")[1].split()[0])
    assert abs((told - offset + 180.0) % 360.0 - 180.0) < 3.0


def test_feet_stop_and_another_height_is_told(drive):
    feet = drive.baro.height_m / 0.3048
    assert found(baro_of(drive, height_m=feet)) == {"data.baro_unit": "stop"}
    assert found(baro_of(drive, height_m=drive.baro.height_m + 48.0)) == {"data.baro_offset": "warn"}


def test_a_run_refuses_what_stops(drive):
    table = heading_of(drive, heading_rad=np.mod(drive.heading.heading_rad / DEG, 360.0))
    with pytest.raises(DataQualityError, match="degrees read as radians") as caught:
        gnssins.run(CONFIG, table)
    assert caught.value.code == "data.heading_unit"
