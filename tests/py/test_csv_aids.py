"""Files of a barometer and of headings, the mark of a changed constellation; and the writers of the same layout."""

import numpy as np
import pytest

from gnssins.config import Config
from gnssins.dataset import BaroTable, Dataset, GnssTable, HeadingTable, ImuTable
from gnssins.errors import ConfigError, InputError
from gnssins.io import read_dataset, write_baro, write_gnss, write_heading

IMU = "time_s,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z\n0,0,0,0,0,0,-9.8\n"
NOISE = {"gyro": {"arw_deg_sqrt_h": 1}, "accel": {"vrw_m_s_sqrt_h": 1}}
T = np.arange(1, 4, dtype=np.int64) * 100_000_000


@pytest.fixture
def read(tmp_path):
    def reader(section, text, **keys):
        (tmp_path / "imu.csv").write_text(IMU)
        (tmp_path / "aid.csv").write_text(text)
        tables = {"imu": {"file": "imu.csv", **NOISE}, section: {"file": "aid.csv", **keys}}
        return read_dataset(Config.from_dict(tables, base=tmp_path))

    return reader


def test_heights_become_metres_above_the_ellipsoid(read):
    data = read("baro", "time_s,height_m,sd\n1.5,100.0,0.5\n2.5,nan,0.5\n", geoid_height_m=47.0)
    assert data.baro.t_ns.tolist() == [1_500_000_000, 2_500_000_000]
    np.testing.assert_array_equal(data.baro.height_m, [147.0, np.nan])
    np.testing.assert_allclose(data.baro.var, 0.25)
    assert len(data.sources) == 2


def test_feet_turn_value_and_accuracy(read):
    keys = {"height_unit": "ft", "height_column": "alt", "sd_column": "err", "time_unit": "ms"}
    baro = read("baro", "time_s,alt,err\n1500,1000,10\n", **keys).baro
    assert (baro.height_m[0], baro.var[0]) == pytest.approx((304.8, 3.048**2))


def test_headings_become_radians_without_the_direction_of_the_antennas(read):
    table = read("heading", "time_s,heading,sd\n1,350.0,0.2\n", offset_deg=90.0).heading
    assert (table.heading_rad[0], table.var[0]) == pytest.approx((np.radians(260.0), np.radians(0.2) ** 2))
    assert read("heading", "time_s,heading,sd\n1,3.0,0.1\n", angle_unit="rad").heading.heading_rad[0] == 3.0


@pytest.mark.parametrize(
    ("section", "head", "key", "value", "si"),
    [
        ("baro", "time_s,height_m", "height_sd_m", 0.75, 0.75),
        ("heading", "time_s,heading", "heading_sd_deg", 0.2, np.radians(0.2)),
    ],
)
def test_the_configuration_gives_the_accuracy_that_the_file_lacks(read, section, head, key, value, si):
    assert getattr(read(section, f"{head}\n1,2.0\n", **{key: value}), section).var[0] == pytest.approx(si**2)
    text = f"{head},sd\n1,2.0,0.1\n2,2.0,\n"
    mixed = getattr(read(section, text, **{key: value}), section)
    assert mixed.var[1] == pytest.approx(si**2)
    assert mixed.var[0] != pytest.approx(si**2)
    own = getattr(read(section, text, sd="config", **{key: value}), section)
    np.testing.assert_allclose(own.var, si**2)
    with pytest.raises(ConfigError, match=r"1 of 2 .* have no accuracy, first at aid.csv row 2") as caught:
        read(section, text)
    assert caught.value.code == "config.no_accuracy"
    assert key in caught.value.hint
    with pytest.raises(ConfigError, match=key):
        read(section, text, sd="config")


def test_a_negative_accuracy_stays_negative_for_the_engine_to_judge(read):
    assert read("baro", "time_s,height_m,sd\n1,2,-0.5\n").baro.var[0] == -0.25


def test_bad_rows_stop_or_are_counted(read):
    text = "time_s,height_m,sd\n1,2,0.5\n2,low,0.5\n"
    with pytest.raises(InputError, match=r'row 2 .*column height_m: "low" is no number'):
        read("baro", text)
    data = read("baro", text, on_bad_row="skip")
    assert len(data.baro) == 1
    assert sum(source.rows_skipped for source in data.sources.values()) == 1


def test_a_missing_column_and_a_column_named_twice_are_refused(read):
    with pytest.raises(InputError, match="height_m"):
        read("baro", "time_s,h\n1,2\n", height_sd_m=1.0)
    with pytest.raises(ConfigError, match="used twice: time_s"):
        read("baro", "time_s,h\n1,2\n", height_column="time_s")


def test_without_files_the_tables_are_empty(read):
    data = read("baro", "time_s,height_m,sd\n1,2,3\n")
    assert (len(data.heading), len(data.gnss)) == (0, 0)
    assert repr(data.heading) == "HeadingTable(empty)"
    assert repr(data.baro) == "BaroTable(1 rows, 1.000 to 1.000 s, nan Hz)"


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz"])
def test_written_tables_come_back(tmp_path, suffix):
    baro = BaroTable(T, np.array([1.25, -3.5, np.nan]), np.array([0.25, 1.0, 4.0]))
    heading = HeadingTable(T, np.array([0.1, -0.1, 7.0]), np.full(3, 1e-4))
    rng = np.random.default_rng(1)
    marks = np.array([False, True, False])
    fixes = GnssTable(T, rng.normal(size=(3, 3)), rng.normal(size=(3, 3)), np.ones((3, 6)), marks)
    write_baro(tmp_path / f"baro{suffix}", baro)
    write_heading(tmp_path / f"heading{suffix}", heading)
    write_gnss(tmp_path / f"gnss{suffix}", fixes)
    (tmp_path / "imu.csv").write_text(IMU)
    files = {name: {"file": f"{name}{suffix}"} for name in ("baro", "heading", "gnss")}
    back = read_dataset(Config.from_dict({"imu": {"file": "imu.csv", **NOISE}, **files}, base=tmp_path))
    for table, written in ((back.baro, baro), (back.heading, heading)):
        np.testing.assert_array_equal(table.t_ns, T)
        np.testing.assert_allclose(table.var, written.var, rtol=1e-12)
    np.testing.assert_array_equal(back.baro.height_m, baro.height_m)
    np.testing.assert_allclose(back.heading.heading_rad, np.mod(heading.heading_rad, 2 * np.pi), rtol=1e-12)
    np.testing.assert_array_equal(back.gnss.new_constellation, marks)


def test_the_mark_is_any_number_but_nought_and_need_not_be_there(tmp_path):
    (tmp_path / "imu.csv").write_text(IMU)
    tables = {"imu": {"file": "imu.csv", **NOISE}, "gnss": {"file": "g.csv", "use": "velocity"}}
    head, row = "time_s,vn,ve,vd,sd_vn,sd_ve,sd_vd", "1,2,3,.1,.1,.1"
    (tmp_path / "g.csv").write_text(f"{head},new_constellation\n1,{row},1\n2,{row},0\n3,{row},\n4,{row},2\n")
    gnss = read_dataset(Config.from_dict(tables, base=tmp_path)).gnss
    assert gnss.new_constellation.tolist() == [True, False, False, True]
    (tmp_path / "g.csv").write_text(f"{head}\n1,{row}\n")
    assert read_dataset(Config.from_dict(tables, base=tmp_path)).gnss.new_constellation is None


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (
            lambda: BaroTable(T, np.zeros((3, 1)), np.ones(3)),
            r"baro height_m has shape \(3, 1\), needs \(3,\)",
        ),
        (lambda: BaroTable(T, np.zeros(3), np.ones(2)), "baro var has shape"),
        (lambda: HeadingTable(T, np.zeros(2), np.ones(3)), "heading heading_rad has shape"),
        (lambda: HeadingTable(T / 1e9, np.zeros(3), np.ones(3)), "whole nanoseconds"),
        (
            lambda: GnssTable(
                T, np.zeros((3, 3)), np.zeros((3, 3)), np.ones((3, 6)), np.zeros(2, dtype=bool)
            ),
            "gnss new_constellation has shape",
        ),
        (
            lambda: GnssTable(T, np.zeros((3, 3)), np.zeros((3, 3)), np.ones((3, 6)), np.zeros(3)),
            "needs bool",
        ),
    ],
)
def test_wrong_tables_are_refused_by_name(build, says):
    with pytest.raises(InputError, match=says):
        build()


def test_tables_are_read_only_and_select_takes_rows_of_every_column():
    baro = BaroTable(T, np.arange(3.0), np.ones(3))
    with pytest.raises(ValueError, match="read-only"):
        baro.height_m[0] = 5.0
    assert baro.select(slice(1, 3)).height_m.tolist() == [1.0, 2.0]
    heading = HeadingTable(T, np.arange(3.0), np.ones(3))
    assert heading.select(np.array([True, False, True])).heading_rad.tolist() == [0.0, 2.0]
    fixes = GnssTable(T, np.zeros((3, 3)), np.zeros((3, 3)), np.ones((3, 6)), np.array([True, False, True]))
    assert fixes.select(slice(0, 2)).new_constellation.tolist() == [True, False]


def test_headings_are_withheld_with_the_fixes_and_heights_are_not():
    imu = ImuTable(T, np.zeros((3, 3)), np.zeros((3, 3)))
    fixes = GnssTable(T, np.zeros((3, 3)), np.zeros((3, 3)), np.ones((3, 6)))
    one = np.zeros(3), np.ones(3)
    data, withheld = Dataset(imu, fixes, baro=BaroTable(T, *one), heading=HeadingTable(T, *one)).withhold(
        [(0.15, 0.25)]
    )
    assert (len(withheld), len(data.gnss), len(data.heading), len(data.baro)) == (1, 2, 2, 3)
