"""The look at the data: wrong units, axes, clocks and places are found; right data are never stopped."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gnssins.checks import check_dataset, raise_on_stop
from gnssins.config import Config, axes_matrix
from gnssins.dataset import Dataset, GnssTable, ImuTable
from gnssins.errors import DataQualityError
from gnssins.io import read_dataset

G = 9.80665
DEG = np.pi / 180.0
LAT, LON, EARTH_M = 48.0 * DEG, 9.0 * DEG, 6.371e6


def drive():
    """A level car on a winding road for 200 s: 50 Hz and 2 Hz, with noise."""
    rng = np.random.default_rng(3)
    t = np.arange(0, 200, 0.02)
    yaw_rate = 0.15 * np.sin(2 * np.pi * t / 23.0)
    heading = np.cumsum(yaw_rate) * 0.02
    speed = 12.0 + 5.0 * np.sin(2 * np.pi * t / 31.0)
    gain = np.gradient(speed, t)
    gyro = np.column_stack([0 * t, 0 * t, yaw_rate]) + rng.normal(0, 0.002, (t.size, 3))
    accel = np.column_stack([gain, speed * yaw_rate, -G + 0 * t]) + rng.normal(0, 0.05, (t.size, 3))
    v_n = np.column_stack([speed * np.cos(heading), speed * np.sin(heading), 0.5 * np.sin(t / 9)])
    p_n = np.cumsum(v_n, axis=0) * 0.02
    lla = np.column_stack(
        [LAT + p_n[:, 0] / EARTH_M, LON + p_n[:, 1] / EARTH_M / np.cos(LAT), 300.0 - p_n[:, 2]]
    )
    t_ns = (t * 1e9).astype(np.int64)
    fix = slice(0, None, 25)
    gnss = GnssTable(t_ns[fix], lla[fix], v_n[fix], np.ones((t_ns[fix].size, 6)))
    return Dataset(ImuTable(t_ns, gyro, accel), gnss)


DRIVE = drive()


def imu(gyro=1.0, accel=1.0, turn=None, gyro_turn=None, **changes):
    """Return the drive with other inertial samples: scaled, or turned into other axes."""
    table = DRIVE.imu
    c = np.eye(3) if turn is None else turn
    g = c if gyro_turn is None else gyro_turn
    parts = {"gyro": table.gyro @ g.T * gyro, "accel": table.accel @ c.T * accel} | changes
    return replace(DRIVE, imu=replace(table, **parts))


def gnss(**changes):
    """Return the drive with other fixes."""
    return replace(DRIVE, gnss=replace(DRIVE.gnss, **changes))


def found(dataset, code, config=None):
    """Return the only finding of a code."""
    hits = [finding for finding in check_dataset(dataset, config) if finding.code == code]
    assert len(hits) == 1, [str(finding) for finding in check_dataset(dataset, config)]
    return hits[0]


def config(**sections):
    imu_keys = {"gyro": {"arw_deg_sqrt_h": 1}, "accel": {"vrw_m_s_sqrt_h": 1}}
    imu_keys |= sections.pop("imu", {})
    return Config.from_dict({"imu": imu_keys, **sections})


def test_a_good_drive_gives_no_finding():
    assert check_dataset(DRIVE, config()) == []


def test_findings_read_as_level_code_text_and_hint():
    text = str(found(imu(accel=1 / G), "data.accel_unit"))
    assert text.startswith("stop [data.accel_unit] imu: median specific force 1")
    assert '\n  hint: likely: [imu] accel_unit = "g"' in text


def test_gravest_findings_come_first():
    levels = [finding.level for finding in check_dataset(replace(imu(accel=1 / G), gnss=gnss().gnss))]
    assert levels == sorted(levels, key=["stop", "warn", "info"].index)


def test_a_stop_is_raised_as_one_error_with_its_code():
    with pytest.raises(DataQualityError, match="specific force") as caught:
        raise_on_stop(check_dataset(imu(accel=1 / G)))
    assert caught.value.code == "data.accel_unit"
    raise_on_stop(check_dataset(DRIVE))


# ---- units


@pytest.mark.parametrize(
    ("factor", "likely"),
    [
        (1 / G, 'accel_unit = "g"'),
        (1e3 / G, "milli-g"),
        (100.0, "cm/s^2"),
        (1 / 0.3048, "ft/s^2"),
        (G, 'accel_unit = "m/s^2"'),
        (0.02, 'kind = "increments"'),
    ],
)
def test_wrong_accelerometer_unit_stops_with_the_likely_one(factor, likely):
    finding = found(imu(accel=factor), "data.accel_unit")
    assert finding.level == "stop"
    assert likely in finding.hint


def test_rates_read_as_increments_stop():
    assert 'kind = "rates"' in found(imu(kind="increments"), "data.accel_unit").hint


def test_right_increments_give_no_finding():
    assert check_dataset(imu(gyro=0.02, accel=0.02, kind="increments")) == []


@pytest.mark.parametrize(
    ("factor", "likely"),
    [
        (1 / DEG, 'gyro_unit = "deg/s"'),
        (DEG, 'gyro_unit = "rad/s"'),
        (0.02, 'kind = "increments" (angle increments)'),
    ],
)
def test_wrong_gyro_unit_is_found_by_the_turns_of_the_track(factor, likely):
    finding = found(imu(gyro=factor), "data.gyro_unit")
    assert finding.level == "stop"
    assert likely in finding.hint


def test_rates_beyond_any_gyro_stop_even_without_gnss():
    dataset = replace(imu(gyro=10 / DEG), gnss=GnssTable.empty())
    assert 'gyro_unit = "deg/s"' in found(dataset, "data.gyro_unit").hint


def test_turning_gyro_at_rest_is_told():
    rng = np.random.default_rng(1)
    still = rng.normal((0, 0, -G), 0.01, (3000, 3))
    gyro = rng.normal((0.1, 0.05, 0), 0.01, (3000, 3))
    table = ImuTable(np.arange(3000, dtype=np.int64) * 10_000_000, gyro, still)
    finding = found(Dataset(table), "data.gyro_bias")
    assert finding.level == "warn"
    assert 'gyro_unit = "deg/s"' in finding.hint


def test_scale_error_of_the_accelerometer_is_told_not_stopped():
    rng = np.random.default_rng(1)
    still = (rng.normal((0, 0, -G), 0.01, (3000, 3))) * 1.05
    table = ImuTable(np.arange(3000, dtype=np.int64) * 10_000_000, np.zeros((3000, 3)) + 1e-4, still)
    assert found(Dataset(table), "data.accel_scale").level == "warn"


def test_dead_accelerometer_stops():
    assert found(imu(accel=0.0), "data.accel_unit").level == "stop"


# ---- axes


@pytest.mark.parametrize("axes", ["FLU", "RFU", "BLD", "RBD", "DRB", "UFL"])
def test_wrong_axes_are_named_from_gravity_and_from_the_gain_of_speed(axes):
    finding = found(imu(turn=axes_matrix(axes).T), "data.axes")
    assert finding.level == ("stop" if axes in ("FLU", "RFU") else "warn")
    assert finding.hint.partition(";")[0] == f'likely [imu] axes: "{axes}"'


def test_a_body_that_lies_on_its_back_by_configuration_is_not_stopped():
    turned = imu(turn=axes_matrix("FLU").T)
    assert found(turned, "data.axes", config()).level == "stop"
    told = config(initial={"roll_deg": 180.0, "pitch_deg": 0.0})
    assert found(turned, "data.axes", told).level == "warn"


def test_right_axes_key_silences_the_finding():
    turned = axes_matrix("RFU").T
    corrected = imu(turn=axes_matrix("RFU") @ turned)
    assert check_dataset(corrected, config(imu={"axes": "RFU"})) == []


def test_gyro_in_other_axes_than_the_accelerometer_is_told():
    assert found(imu(turn=np.eye(3), gyro_turn=np.diag([1.0, -1.0, -1.0])), "data.gyro_sign").level == "warn"


# ---- rows


def test_missing_values_are_counted_and_stop_above_the_share():
    gyro = DRIVE.imu.gyro.copy()
    gyro[:20, 0] = np.nan
    few = found(replace(DRIVE, imu=replace(DRIVE.imu, gyro=gyro)), "data.imu_bad")
    assert (few.level, few.count) == ("warn", 20)
    gyro[:500, 1] = np.inf
    many = found(replace(DRIVE, imu=replace(DRIVE.imu, gyro=gyro)), "data.imu_bad", config())
    assert many.level == "stop"


def test_saturated_rows_are_counted():
    sections = {"imu": {"gyro": {"arw_deg_sqrt_h": 1, "range_deg_s": 8.5}}}
    finding = found(DRIVE, "data.imu_saturated", config(**sections))
    assert finding.count > 100
    assert "8.5 deg/s" in finding.message


def test_repeated_rows_are_told():
    rows = np.arange(len(DRIVE.imu)) // 3 * 3
    part = DRIVE.imu.select(rows)
    finding = found(replace(DRIVE, imu=replace(part, t_ns=DRIVE.imu.t_ns)), "data.imu_repeated")
    assert finding.level == "warn"


def test_empty_imu_table_stops():
    empty = ImuTable(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)))
    assert found(Dataset(empty), "data.imu_empty").level == "stop"


@pytest.mark.parametrize("rows", [1, 2, 9, 40])
def test_very_short_data_are_looked_at_without_failing(rows):
    short = Dataset(DRIVE.imu.select(slice(rows)), DRIVE.gnss.select(slice(rows)))
    assert all(finding.level != "stop" for finding in check_dataset(short))


# ---- time


def test_backwards_time_names_row_and_amount():
    t_ns = DRIVE.imu.t_ns.copy()
    t_ns[100] -= 25_000_000
    finding = found(imu(t_ns=t_ns), "time.backwards")
    assert "imu row 101: t = 1.975 s after 1.980 s (-5 ms)" in finding.message
    assert "on_backwards" in finding.hint


def test_repeated_stamps_are_counted():
    t_ns = DRIVE.imu.t_ns.copy()
    t_ns[[50, 80]] = t_ns[[49, 79]]
    assert found(imu(t_ns=t_ns), "time.duplicate").count == 2


def test_gaps_are_told_with_their_place_and_length():
    t_ns = DRIVE.imu.t_ns.copy()
    t_ns[5000:] += 3_000_000_000
    finding = found(imu(t_ns=t_ns), "gap.long", config())
    assert "longest 3.020 s" in finding.message
    assert "first at t = 99.980 s" in finding.message
    t_ns = DRIVE.imu.t_ns.copy()
    t_ns[5000:] += 200_000_000
    assert found(imu(t_ns=t_ns), "gap.short", config()).level == "info"


def test_uneven_stamps_are_told():
    jitter = np.random.default_rng(1).integers(-9_000_000, 9_000_000, len(DRIVE.imu))
    assert found(imu(t_ns=DRIVE.imu.t_ns + jitter), "time.jitter").level == "info"


def test_clocks_without_a_common_stretch_stop():
    assert found(gnss(t_ns=DRIVE.gnss.t_ns + 10**15), "time.no_overlap").level == "stop"


def test_start_outside_of_the_data_stops():
    assert found(DRIVE, "time.start_outside", config(run={"start_s": 1e6})).level == "stop"


# ---- GNSS


@pytest.mark.parametrize(
    ("changes", "code", "says"),
    [
        ({"lla": DRIVE.gnss.lla[:, [1, 0, 2]]}, "data.gnss_swapped", "position_columns"),
        ({"lla": DRIVE.gnss.lla * [1 / DEG, 1 / DEG, 1]}, "data.gnss_range", 'angle_unit = "deg"'),
        ({"lla": DRIVE.gnss.lla * [DEG, DEG, 1]}, "data.gnss_unit", 'angle_unit = "rad"'),
        ({"v_n": DRIVE.gnss.v_n[:, [1, 0, 2]]}, "data.gnss_velocity", 'velocity_axes = "ENU"'),
        ({"lla": DRIVE.gnss.lla * 0}, "data.gnss_null", "nan"),
        ({"var": DRIVE.gnss.var * 0}, "data.gnss_sigma", "floor"),
        ({"lla": DRIVE.gnss.lla * np.nan, "v_n": DRIVE.gnss.v_n * np.nan}, "data.gnss_empty", "columns"),
    ],
)
def test_impossible_fixes_stop_with_the_remedy(changes, code, says):
    finding = found(gnss(**changes), code)
    assert finding.level == "stop"
    assert says in finding.hint


@pytest.mark.parametrize(
    ("factor", "unit"), [(3.6, "km/h"), (100.0, "cm/s"), (1000.0, "mm/s"), (1e-3, "km/s")]
)
def test_velocity_in_another_unit_stops_and_names_it(factor, unit):
    finding = found(gnss(v_n=DRIVE.gnss.v_n * factor), "data.gnss_velocity")
    assert finding.level == "stop"
    assert f"likely the velocity is in {unit}" in finding.hint


@pytest.mark.parametrize("factor", [1.9438, 2.2369, 3.3, 4.0, 0.5])
def test_velocity_that_is_off_by_any_other_factor_is_told(factor):
    finding = found(gnss(v_n=DRIVE.gnss.v_n * factor), "data.gnss_velocity")
    assert finding.level == "warn"
    assert "times the velocity" in finding.message


def test_vertical_velocity_of_the_wrong_sign_is_told():
    finding = found(gnss(v_n=DRIVE.gnss.v_n * [1, 1, -1]), "data.gnss_vertical")
    assert finding.level == "warn"


def test_single_rows_without_a_fix_do_not_stop():
    lla, var = DRIVE.gnss.lla.copy(), DRIVE.gnss.var.copy()
    lla[5, :2] = 0.0
    var[7, 0] = 0.0
    findings = {f.code: f for f in check_dataset(gnss(lla=lla, var=var))}
    assert (findings["data.gnss_null"].level, findings["data.gnss_null"].count) == ("warn", 1)
    assert (findings["data.gnss_sigma"].level, findings["data.gnss_sigma"].count) == ("warn", 1)


@given(st.data())
def test_garbage_gives_findings_not_failures(data):
    values = st.sampled_from([0.0, 1.0, -9.8, 1e300, -1e-300, np.nan, np.inf, -np.inf])
    stamps = st.integers(-(10**12), 10**12)

    def table(columns):
        rows = data.draw(st.lists(st.tuples(stamps, *[values] * columns), max_size=40))
        array = np.array([row[1:] for row in rows]).reshape(-1, columns)
        return np.array([row[0] for row in rows], dtype=np.int64), array

    t_ns, a = table(6)
    g_ns, b = table(12)
    kind = data.draw(st.sampled_from(["rates", "increments"]))
    fixes = GnssTable(g_ns, b[:, :3], b[:, 3:6], b[:, 6:])
    check_dataset(Dataset(ImuTable(t_ns, a[:, :3], a[:, 3:], kind), fixes), config())


# ---- recorded data


def test_no_recorded_set_is_stopped_or_suspected(shared_data):
    folders = [folder for folder in sorted(shared_data.iterdir()) if (folder / "imu.csv.gz").exists()]
    assert len(folders) >= 12
    for folder in folders:
        tables = {"filter": {"preset": "ned-15"}, "imu": {"file": str(folder / "imu.csv.gz")}}
        if (folder / "gnss.csv.gz").exists():
            file = str(folder / "gnss.csv.gz")
            tables["gnss"] = {"file": file, "position_sd_m": 2.0, "velocity_sd_m_s": 0.3}
        settings = Config.from_dict(tables)
        findings = check_dataset(read_dataset(settings), settings)
        assert [str(f) for f in findings if f.level != "info"] == [], folder.name


def test_every_example_passes_the_checks(repository, shared_data):
    for example in sorted((repository / "examples").glob("*.toml")):
        settings = Config.load(example)
        raise_on_stop(check_dataset(read_dataset(settings), settings))
