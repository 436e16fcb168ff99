"""GNSS and reference files: accuracy rules, axes, absent values; and the writers of the same layout."""

import gzip

import numpy as np
import pytest

from gnssins import _core
from gnssins.config import Config
from gnssins.dataset import GnssTable, ImuTable, TruthTable
from gnssins.errors import ConfigError, InputError
from gnssins.io import read_dataset, write_gnss, write_imu, write_truth

IMU = "time_s,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z\n0,0,0,0,0,0,-9.8\n"
HEAD = "time_s,lat_deg,lon_deg,height_m,vn,ve,vd,sd_n,sd_e,sd_d,sd_vn,sd_ve,sd_vd"
FULL = "1.0,48.0,9.0,300.0,1.0,2.0,3.0,1.0,1.5,2.0,0.1,0.2,0.3"
NO_SD = "1.0,48.0,9.0,300.0,1.0,2.0,3.0,nan,nan,nan,nan,nan,nan"


@pytest.fixture
def read(tmp_path):
    def reader(*rows, head=HEAD, truth=None, **keys):
        (tmp_path / "imu.csv").write_text(IMU)
        (tmp_path / "gnss.csv").write_text("\n".join([head, *rows]) + "\n")
        imu = {"file": "imu.csv", "gyro": {"arw_deg_sqrt_h": 1}, "accel": {"vrw_m_s_sqrt_h": 1}}
        tables = {"imu": imu, "gnss": {"file": "gnss.csv", **keys}}
        if truth is not None:
            (tmp_path / "ref.csv").write_text(truth)
            tables["truth"] = {"file": "ref.csv"}
        return read_dataset(Config.from_dict(tables, base=tmp_path))

    return reader


def test_fix_becomes_radians_metres_and_variances(read):
    gnss = read(FULL).gnss
    np.testing.assert_allclose(gnss.lla[0], [np.radians(48), np.radians(9), 300], rtol=1e-15)
    np.testing.assert_array_equal(gnss.v_n[0], [1, 2, 3])
    np.testing.assert_allclose(gnss.var[0], [1, 2.25, 4, 0.01, 0.04, 0.09], rtol=1e-15)


def test_radians_geoid_and_east_north_up_are_converted(read):
    gnss = read(
        "1,0.5,0.1,300,1,2,3,1,1,1,1,1,1", angle_unit="rad", geoid_height_m=47.5, velocity_axes="ENU"
    ).gnss
    np.testing.assert_array_equal(gnss.lla[0], [0.5, 0.1, 347.5])
    np.testing.assert_array_equal(gnss.v_n[0], [2, 1, -3])


def test_accuracy_of_the_file_is_scaled_then_floored(read):
    gnss = read(FULL, sd_scale=2.0, position_sd_floor_m=[0, 3.5, 0], velocity_sd_floor_m_s=0.5).gnss
    np.testing.assert_allclose(gnss.sd[0], [2, 3.5, 4, 0.5, 0.5, 0.6])


def test_accuracy_of_the_configuration_fills_what_the_file_lacks(read):
    gnss = read(NO_SD, FULL, position_sd_m=[2, 3, 4], velocity_sd_m_s=0.5).gnss
    np.testing.assert_allclose(gnss.sd, [[2, 3, 4, 0.5, 0.5, 0.5], [1, 1.5, 2, 0.1, 0.2, 0.3]])


def test_accuracy_columns_may_be_absent_altogether(read):
    gnss = read("1,48,9,300,1,2,3", head=HEAD.split(",sd_n")[0], position_sd_m=2, velocity_sd_m_s=0.5).gnss
    np.testing.assert_allclose(gnss.sd[0], [2, 2, 2, 0.5, 0.5, 0.5])


def test_accuracy_from_the_configuration_ignores_the_file(read):
    gnss = read(FULL, sd="config", position_sd_m=5, velocity_sd_m_s=0.5).gnss
    np.testing.assert_allclose(gnss.sd[0], [5, 5, 5, 0.5, 0.5, 0.5])


@pytest.mark.parametrize(
    ("keys", "key"),
    [({"velocity_sd_m_s": 1}, "position_sd_m"), ({"position_sd_m": 1}, "velocity_sd_m_s")],
)
def test_accuracy_known_to_nobody_is_an_error_that_names_the_key(read, keys, key):
    with pytest.raises(ConfigError) as caught:
        read(FULL, NO_SD, **keys)
    assert caught.value.code == "config.no_accuracy"
    assert "1 of 2 fixes" in caught.value.message
    assert "row 2 (line 3)" in caught.value.message
    assert f"add [gnss] {key}" in caught.value.hint


def test_accuracy_is_not_asked_for_where_there_is_no_value(read):
    gnss = read("1,48,9,300,1,2,nan,1,1,1,0.1,0.1,nan", "2,nan,nan,nan,1,2,3,nan,nan,nan,1,1,1").gnss
    assert np.isnan(gnss.var[0, 5])
    np.testing.assert_array_equal(gnss.has_position, [True, False])
    np.testing.assert_array_equal(gnss.has_velocity, [True, True])


@pytest.mark.parametrize("sd", ["0", "-2"])
def test_zero_or_negative_accuracy_stays_visible_for_the_engine(read, sd):
    gnss = read(FULL.replace(",1.0,1.5,", f",{sd},1.5,")).gnss
    assert gnss.var[0, 0] == -(float(sd) ** 2)
    assert np.isnan(gnss.sd[0, 0]) == (sd == "-2")


def test_positions_only_need_no_velocity_columns(read):
    gnss = read("1,48,9,300", head="time_s,lat_deg,lon_deg,height_m", use="position", position_sd_m=1).gnss
    assert np.isnan(gnss.v_n).all()


def test_missing_velocity_columns_hint_at_the_key_that_does_without(read):
    with pytest.raises(InputError) as caught:
        read("1,48,9,300", head="time_s,lat_deg,lon_deg,height_m", position_sd_m=1)
    assert caught.value.hint.endswith('or set [gnss] use = "position"')


def test_unused_columns_are_not_read(read):
    gnss = read("1,48,9,300,a,b,c,1,1,1,0,0,0", use="position").gnss
    assert np.isnan(gnss.v_n).all()


# ---- reference


def test_reference_attitude_comes_from_roll_pitch_heading(read):
    head = "time_s,lat_deg,lon_deg,height_m,vn,ve,vd,roll_deg,pitch_deg,heading_deg"
    truth = f"{head}\n0,48,9,300,1,2,3,10,-5,350\n"
    table = read(FULL, truth=truth).truth
    euler = np.degrees(_core.quat_to_euler(np.array(table.q_nb)))
    np.testing.assert_allclose(euler, [[10, -5, -10]], atol=1e-12)
    np.testing.assert_array_equal(table.v_n, [[1, 2, 3]])


def test_quaternion_columns_go_before_the_angles_and_are_normalised(read):
    truth = "time_s,roll_deg,pitch_deg,heading_deg,qw,qx,qy,qz\n0,10,0,0,0,0,0,-2\n1,0,0,90,nan,nan,nan,nan\n"
    table = read(FULL, truth=truth).truth
    np.testing.assert_allclose(table.q_nb, [[0, 0, 0, -1], [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]], atol=1e-15)
    assert np.isnan(table.lla).all()


def test_reference_without_attitude_says_so(read):
    table = read(FULL, truth="time_s,lat_deg,lon_deg,height_m,roll_deg\n0,48,9,300,nan\n").truth
    assert table.q_nb is None


def test_reference_without_any_known_column_is_refused(read):
    with pytest.raises(InputError, match="no position, velocity or attitude"):
        read(FULL, truth="time_s,x,y\n0,1,2\n")


# ---- recorded data


@pytest.mark.parametrize("name", ["car-comma-hwy", "uav-qdr-h09", "static-vn310"])
def test_recorded_sets_are_read_without_a_key_but_their_file(shared_data, name):
    folder = shared_data / name
    tables = {"filter": {"preset": "ned-15"}, "gnss": {"position_sd_m": 2, "velocity_sd_m_s": 0.1}}
    for key, file in (("imu", "imu"), ("gnss", "gnss"), ("truth", "ref")):
        tables.setdefault(key, {})["file"] = str(folder / f"{file}.csv.gz")
    dataset = read_dataset(Config.from_dict(tables))
    with gzip.open(folder / "imu.csv.gz", "rt") as file:
        assert len(dataset.imu) == sum(1 for _ in file) - 1
    assert all(source.rows_skipped == 0 for source in dataset.sources.values())


# ---- writers


@pytest.fixture
def tables():
    rng = np.random.default_rng(1)
    t_ns = 1_234_567_890_123_456_789 + np.arange(50, dtype=np.int64) * 10_000_001
    t_ns[0] = -1
    q_nb = rng.normal(size=(50, 4))
    q_nb /= np.linalg.norm(q_nb, axis=1, keepdims=True)
    v_n = rng.normal(size=(50, 3))
    v_n[3] = np.nan
    lla = np.column_stack([rng.uniform(-1.5, 1.5, 50), rng.uniform(-3, 3, 50), rng.uniform(-100, 9000, 50)])
    imu = ImuTable(t_ns, rng.normal(size=(50, 3)) * 1e-7, rng.normal(size=(50, 3)), "increments")
    return imu, GnssTable(t_ns, lla, v_n, rng.uniform(1e-4, 4, (50, 6))), TruthTable(t_ns, lla, v_n, q_nb)


def read_back(folder, suffix):
    files = {key: {"file": f"{key}{suffix}"} for key in ("imu", "gnss", "truth")}
    files["imu"] |= {"kind": "increments", "gyro": {"arw_deg_sqrt_h": 1}, "accel": {"vrw_m_s_sqrt_h": 1}}
    return read_dataset(Config.from_dict(files, base=folder))


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz"])
def test_written_tables_come_back(tmp_path, tables, suffix):
    imu, gnss, truth = tables
    write_imu(tmp_path / f"imu{suffix}", imu)
    write_gnss(tmp_path / f"gnss{suffix}", gnss)
    write_truth(tmp_path / f"truth{suffix}", truth)
    back = read_back(tmp_path, suffix)
    np.testing.assert_array_equal(back.imu.t_ns, imu.t_ns)
    np.testing.assert_array_equal(back.imu.gyro, imu.gyro)
    np.testing.assert_array_equal(back.imu.accel, imu.accel)
    np.testing.assert_allclose(back.gnss.lla, gnss.lla, rtol=1e-15, atol=0)
    np.testing.assert_array_equal(back.gnss.v_n, gnss.v_n)
    np.testing.assert_allclose(back.gnss.var, gnss.var, rtol=1e-15)
    np.testing.assert_allclose(back.truth.q_nb, truth.q_nb, atol=1e-15)


def test_written_files_have_the_layout_and_nine_decimals(tmp_path, tables):
    write_gnss(tmp_path / "g.csv", tables[1])
    head, first, second, *_ = (tmp_path / "g.csv").read_text().splitlines()
    assert head == HEAD
    assert first.startswith("-0.000000001,")
    assert second.startswith("1234567890.133456790,")


def test_equal_tables_give_equal_bytes(tmp_path, tables):
    for name in ("a.csv.gz", "b.csv.gz"):
        write_imu(tmp_path / name, tables[0])
    assert (tmp_path / "a.csv.gz").read_bytes() == (tmp_path / "b.csv.gz").read_bytes()
    assert not list(tmp_path.glob("*.part"))


def test_full_covariances_are_refused_by_the_csv_layout(tmp_path, tables):
    gnss = tables[1]
    full = np.tile(np.eye(6) + 0.1, (len(gnss), 1, 1))
    with pytest.raises(InputError, match="6x6"):
        write_gnss(tmp_path / "g.csv", GnssTable(gnss.t_ns, gnss.lla, gnss.v_n, full))


def test_folder_that_is_not_there_is_named(tmp_path, tables):
    with pytest.raises(InputError, match="No such file"):
        write_imu(tmp_path / "no" / "imu.csv", tables[0])
