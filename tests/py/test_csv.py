"""The CSV reader: exact times, units and axes from the configuration, and no row lost in silence."""

import contextlib
import gzip
import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gnssins.config import Config
from gnssins.errors import ConfigError, GnssinsError, InputError, MissingFileError
from gnssins.io import format_of, read_dataset
from gnssins.io.cells import numbers
from gnssins.io.clean import read_clean
from gnssins.io.text import read_text

HEAD = "time_s,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z"
ROWS = ["0.00,1,2,3,4,5,6", "0.01,-1,-2,-3,-4,-5,-6", "0.02,0,0,0,0,0,-9.8"]
GNSS_HEAD = "time_s,lat_deg,lon_deg,height_m,vn,ve,vd,sd_n,sd_e,sd_d,sd_vn,sd_ve,sd_vd"
GNSS_ROW = "1.0,48.0,9.0,300.0,1.0,2.0,3.0,1.0,1.5,2.0,0.1,0.2,0.3"


def lines(*rows, end="\n"):
    return end.join(rows) + end


PLAIN = lines(HEAD, *ROWS)


@pytest.fixture
def read(tmp_path):
    """Read an IMU file (text or bytes), and perhaps a GNSS file, under extra keys."""

    def reader(imu=PLAIN, gnss=None, truth=None, name="imu.csv", imu_keys=None, gnss_keys=None):
        tables = {
            "imu": {
                "file": name,
                "gyro": {"arw_deg_sqrt_h": 1},
                "accel": {"vrw_m_s_sqrt_h": 1},
                **(imu_keys or {}),
            }
        }
        for key, file, content in (
            ("imu", name, imu),
            ("gnss", "gnss.csv", gnss),
            ("truth", "ref.csv", truth),
        ):
            if content is not None:
                data = content if isinstance(content, bytes) else content.encode()
                (tmp_path / file).write_bytes(data)
                tables.setdefault(key, {})["file"] = file
        tables.setdefault("gnss", {}).update(gnss_keys or {})
        return read_dataset(Config.from_dict(tables, base=tmp_path))

    return reader


def source_of(dataset, name):
    return next(s for path, s in dataset.sources.items() if path.endswith(name))


# ---- plain reading


def test_values_units_and_digest_are_those_of_the_file(read):
    text = lines(HEAD, *ROWS)
    dataset = read(text)
    np.testing.assert_array_equal(dataset.imu.t_ns, [0, 10_000_000, 20_000_000])
    np.testing.assert_array_equal(dataset.imu.gyro, [[1, 2, 3], [-1, -2, -3], [0, 0, 0]])
    np.testing.assert_array_equal(dataset.imu.accel[2], [0, 0, -9.8])
    source = source_of(dataset, "imu.csv")
    assert source.sha256 == hashlib.sha256(text.encode()).hexdigest()
    assert (source.rows, source.rows_skipped) == (3, 0)


def test_units_and_axes_come_from_the_configuration(read):
    keys = {"gyro_unit": "deg/s", "accel_unit": "g", "axes": "FLU"}
    dataset = read(lines(HEAD, "0,180,90,-90,0,0.5,1"), imu_keys=keys)
    np.testing.assert_allclose(dataset.imu.gyro[0], np.pi * np.array([1, -0.5, 0.5]), rtol=1e-15)
    np.testing.assert_allclose(dataset.imu.accel[0], 9.80665 * np.array([0, -0.5, -1]), rtol=1e-15)


def test_increments_keep_their_kind_and_unit(read):
    keys = {"kind": "increments", "gyro_unit": "deg", "accel_unit": "m/s"}
    dataset = read(lines(HEAD, "0,180,0,0,1,2,3"), imu_keys=keys)
    assert dataset.imu.kind == "increments"
    np.testing.assert_allclose(dataset.imu.gyro[0], [np.pi, 0, 0])
    np.testing.assert_array_equal(dataset.imu.accel[0], [1, 2, 3])


@pytest.mark.parametrize(
    ("axes", "frd"),
    [
        ("FRD", [1, 2, 3]),
        ("FLU", [1, -2, -3]),
        ("RFU", [2, 1, -3]),
        ("ENU", [2, 1, -3]),
        ("NED", [1, 2, 3]),
        ("BRU", [-1, 2, -3]),
        ("UFL", [2, -3, -1]),
        ([[0, 1, 0], [1, 0, 0], [0, 0, -1]], [2, 1, -3]),
    ],
)
def test_axes_letters_and_matrices_turn_vectors_to_forward_right_down(read, axes, frd):
    dataset = read(lines(HEAD, "0,1,2,3,1,2,3"), imu_keys={"axes": axes})
    np.testing.assert_array_equal(dataset.imu.gyro[0], frd)
    np.testing.assert_array_equal(dataset.imu.accel[0], frd)


def test_columns_are_found_by_name_in_any_order_among_others(read):
    keys = {"time_column": "t", "gyro_columns": ["p", "q", "r"], "accel_columns": ["ax", "ay", "az"]}
    dataset = read(lines("az,temp,ay,ax,r,q,p,t", "6,20.5,5,4,3,2,1,7"), imu_keys=keys)
    np.testing.assert_array_equal(dataset.imu.gyro[0], [1, 2, 3])
    np.testing.assert_array_equal(dataset.imu.accel[0], [4, 5, 6])
    assert dataset.imu.t_ns[0] == 7_000_000_000


@pytest.mark.parametrize(
    ("text", "unit", "ns"),
    [
        ("1234567890.123456789", "s", 1234567890123456789),
        ("-0.098", "s", -98_000_000),
        ("0.1", "s", 100_000_000),
        ("1e3", "s", 1_000_000_000_000),
        ("5", "s", 5_000_000_000),
        (".5", "s", 500_000_000),
        ("1234567890123.456789", "ms", 1234567890123456789),
        ("1234567890123456.789", "us", 1234567890123456789),
        ("1234567890123456789", "ns", 1234567890123456789),
        ("1.0000000014", "s", 1_000_000_001),
        ("1.0000000016", "s", 1_000_000_002),
    ],
)
def test_time_is_exact_to_the_nanosecond(read, text, unit, ns):
    dataset = read(lines(HEAD, f"{text},0,0,0,0,0,0"), imu_keys={"time_unit": unit})
    assert dataset.imu.t_ns[0] == ns


@given(st.integers(-(2**62), 2**62), st.sampled_from([("s", 9), ("ms", 6), ("us", 3), ("ns", 0)]))
def test_any_time_written_in_full_comes_back(tmp_path_factory, ns, unit):
    folder = tmp_path_factory.getbasetemp()
    name, digits = unit
    whole, rest = divmod(abs(ns), 10**digits)
    text = f"{'-' if ns < 0 else ''}{whole}" + (f".{rest:0{digits}d}" if digits else "")
    (folder / "t.csv").write_text(lines(HEAD, f"{text},0,0,0,0,0,0"))
    imu = {"file": "t.csv", "time_unit": name, "gyro": {"arw_deg_sqrt_h": 1}, "accel": {"vrw_m_s_sqrt_h": 1}}
    assert read_dataset(Config.from_dict({"imu": imu}, base=folder)).imu.t_ns[0] == ns


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
@pytest.mark.parametrize("packed", [False, True])
def test_line_ends_byte_order_mark_and_gzip_make_no_difference(read, end, mark, packed):
    data = (mark + lines(HEAD, *ROWS, end=end)).encode()
    data, name = (gzip.compress(data), "imu.csv.gz") if packed else (data, "imu.csv")
    dataset = read(data, name=name)
    np.testing.assert_array_equal(dataset.imu.gyro, read().imu.gyro)
    np.testing.assert_array_equal(dataset.imu.t_ns, read().imu.t_ns)


def test_gzip_of_several_members_is_read_to_the_end(read):
    data = gzip.compress(lines(HEAD, ROWS[0]).encode()) + gzip.compress(lines(*ROWS[1:]).encode())
    assert len(read(data, name="imu.csv.gz").imu) == 3


@pytest.mark.parametrize("text", [lines(HEAD, *ROWS)[:-1], "\n\n" + lines(HEAD, "", *ROWS, "", "  ")])
def test_blank_lines_and_a_missing_last_line_end_are_no_rows(read, text):
    dataset = read(text)
    assert (len(dataset.imu), source_of(dataset, "imu.csv").rows) == (3, 3)


@pytest.mark.parametrize(("separator", "mark"), [(";", ";"), ("\t", "\t"), ("|", "|")])
def test_other_separators_are_read_when_told(read, separator, mark):
    text = lines(HEAD, *ROWS).replace(",", mark)
    assert len(read(text, imu_keys={"separator": separator}).imu) == 3


def test_quoted_cells_are_read(read):
    text = lines(HEAD.replace("time_s", '"time_s"') + ",note", *(f'{row},"a, b"' for row in ROWS))
    np.testing.assert_array_equal(read(text).imu.gyro, read().imu.gyro)


def test_blanks_around_cells_and_names_do_not_matter(read):
    text = lines(HEAD.replace(",", " , "), *(row.replace(",", " , ") for row in ROWS))
    np.testing.assert_array_equal(read(text).imu.accel, read().imu.accel)


# ---- missing values and rows that cannot be used


@pytest.mark.parametrize("cell", ["nan", "NaN", "", " "])
def test_missing_imu_values_are_passed_on_for_the_engine_to_count(read, cell):
    dataset = read(lines(HEAD, *ROWS, f"0.03,{cell},0,0,0,0,0"))
    assert len(dataset.imu) == 4
    assert np.isnan(dataset.imu.gyro[3]).all() or np.isnan(dataset.imu.gyro[3, 0])


@pytest.mark.parametrize(("token", "cell"), [("-9999", "-9999.0"), ("null", "NULL"), ("-", "-")])
def test_own_token_for_missing_values_is_understood(read, token, cell):
    dataset = read(lines(HEAD, f"0,{cell},2,3,4,5,6"), imu_keys={"missing": token})
    assert np.isnan(dataset.imu.gyro[0, 0])
    assert dataset.imu.accel[0, 2] == 6


def test_infinite_values_are_passed_on_without_a_warning(read):
    dataset = read(lines(HEAD, "0,inf,0,0,0,0,-9.8"), imu_keys={"axes": "FLU"})
    assert not np.isfinite(dataset.imu.gyro[0]).all()


def test_rows_without_a_time_are_counted(read):
    dataset = read(lines(HEAD, *ROWS, "nan,0,0,0,0,0,0", ",0,0,0,0,0,0"))
    source = source_of(dataset, "imu.csv")
    assert (len(dataset.imu), source.rows) == (3, 5)
    assert source.skipped == {"no time stamp": 2}


BAD_ROWS = ["0.03,abc,0,0,0,0,0", "0.04,0,0,0,0,0", "0.05,0,0,0,0,0,0,0", "x,0,0,0,0,0,0"]


@pytest.mark.parametrize(
    ("row", "code", "says"),
    [
        (BAD_ROWS[0], "input.cell", 'row 4 (line 5), column gyro_x: "abc" is no number'),
        (BAD_ROWS[1], "input.ragged", "row 4 (line 5): too few cells: 6 instead of 7"),
        (BAD_ROWS[2], "input.ragged", "row 4 (line 5): too many cells: 8 instead of 7"),
        (BAD_ROWS[3], "input.cell", 'row 4 (line 5), column time_s: "x" is no time stamp'),
    ],
)
def test_row_that_cannot_be_read_stops_with_its_place(read, row, code, says):
    with pytest.raises(InputError) as caught:
        read(lines(HEAD, *ROWS, row))
    assert caught.value.code == code
    assert says in caught.value.message
    assert "on_bad_row" in caught.value.hint
    assert caught.value.context["row"] == 4


def test_rows_that_cannot_be_read_are_counted_by_reason_when_asked(read):
    dataset = read(lines(HEAD, *ROWS, *BAD_ROWS, "nan,0,0,0,0,0,0"), imu_keys={"on_bad_row": "skip"})
    source = source_of(dataset, "imu.csv")
    assert (len(dataset.imu), source.rows, source.rows_skipped) == (3, 8, 5)
    assert source.skipped == {
        "wrong number of cells": 2,
        "no time stamp in time_s": 1,
        "no number in gyro_x": 1,
        "no time stamp": 1,
    }


def test_number_of_bad_rows_is_told(read):
    with pytest.raises(InputError, match="2 such rows"):
        read(lines(HEAD, "a,0,0,0,0,0,0", *ROWS, "b,0,0,0,0,0,0"))


def test_file_with_bad_rows_only_is_refused_even_when_skipping(read):
    with pytest.raises(InputError, match="none of the 1 rows can be used"):
        read(lines(HEAD, "a,0,0,0,0,0,0"), imu_keys={"on_bad_row": "skip"})


def test_ragged_rows_in_a_quoted_file_are_found_too(read):
    with pytest.raises(InputError, match=r"row 2 \(line 3\): too few cells"):
        read(lines(HEAD, '"0",1,2,3,4,5,6', '"1",1,2'))


def test_decimal_commas_are_recognised(read):
    text = lines(HEAD.replace(",", ";"), "0,01;1;2;3;4;5;6")
    with pytest.raises(InputError, match="decimal points"):
        read(text, imu_keys={"separator": ";"})


@given(
    st.lists(st.sampled_from([*ROWS, *BAD_ROWS, "", "nan,1,2,3,4,5,6", "1,nan,,3,4,5,6"]), max_size=30),
    st.booleans(),
)
def test_rows_of_the_file_are_rows_of_the_table_plus_rows_skipped(tmp_path_factory, rows, end):
    folder = tmp_path_factory.getbasetemp()
    (folder / "r.csv").write_text(lines(HEAD, *ROWS, *rows) + ("" if end else "7,1"))
    imu = {
        "file": "r.csv",
        "on_bad_row": "skip",
        "gyro": {"arw_deg_sqrt_h": 1},
        "accel": {"vrw_m_s_sqrt_h": 1},
    }
    dataset = read_dataset(Config.from_dict({"imu": imu}, base=folder))
    source = source_of(dataset, "r.csv")
    assert source.rows == 3 + sum(bool(row) for row in rows) + (not end)
    assert source.rows == len(dataset.imu) + source.rows_skipped


# ---- files that are broken as a whole


def test_missing_file_names_its_likeness(read, tmp_path):
    (tmp_path / "imu_log.csv").write_text("x")
    with pytest.raises(MissingFileError) as caught:
        read(None, imu_keys={"file": "imu_lg.csv"})
    assert 'nearest in that folder: "imu_log.csv"' in caught.value.hint


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (b"", "input.empty"),
        (b"\n \n", "input.empty"),
        (b"\xef\xbb\xbf", "input.empty"),
        (HEAD.encode(), "input.no_rows"),
        (lines(HEAD, "").encode(), "input.no_rows"),
        (lines(HEAD, *ROWS).encode("utf-16"), "input.encoding"),
        (lines(*ROWS).encode(), "input.header"),
        (lines(HEAD + ",gyro_x", *(f"{row},0" for row in ROWS)).encode(), "input.header"),
        (lines(HEAD, *ROWS).replace(",", ";").encode(), "input.separator"),
    ],
)
def test_file_that_holds_no_table_is_refused_by_name(read, content, code):
    with pytest.raises(InputError, match=r"imu\.csv") as caught:
        read(content)
    assert caught.value.code == code
    assert caught.value.hint


def test_missing_column_names_those_that_the_file_has_and_the_nearest(read):
    with pytest.raises(InputError) as caught:
        read(lines(HEAD.replace("gyro_x", "gyr_x"), *ROWS))
    assert caught.value.code == "input.column"
    assert "column missing: gyro_x; the file has: time_s, gyr_x, gyro_y" in caught.value.message
    assert '"gyr_x" for "gyro_x"' in caught.value.hint


@pytest.fixture
def cut_gzip():
    rows = [f"{k * 0.01:.2f},{k % 7},2,3,4,5,{-k % 11}" for k in range(5000)]
    data = gzip.compress(lines(HEAD, *rows).encode())
    return data[: len(data) * 2 // 3]


def test_cut_gzip_stops_by_default(read, cut_gzip):
    with pytest.raises(InputError, match=r"end early, after [1-9][0-9]* complete lines") as caught:
        read(cut_gzip, name="imu.csv.gz")
    assert caught.value.code == "input.truncated"


def test_cut_gzip_is_read_up_to_the_cut_when_asked(read, cut_gzip):
    dataset = read(cut_gzip, name="imu.csv.gz", imu_keys={"on_bad_row": "skip"})
    source = source_of(dataset, "imu.csv.gz")
    assert 1000 < len(dataset.imu) < 5000
    assert source.rows == len(dataset.imu) + source.rows_skipped
    assert source.rows_skipped <= 1


def test_damaged_gzip_is_refused(read):
    data = bytearray(gzip.compress(lines(HEAD, *ROWS).encode()))
    data[20] ^= 0xFF
    with pytest.raises(InputError) as caught:
        read(bytes(data), name="imu.csv.gz")
    assert caught.value.code in {"input.corrupt", "input.truncated"}


def test_unknown_suffix_lists_the_known_ones(read):
    with pytest.raises(InputError, match="unknown file format") as caught:
        read(name="imu.xlsx")
    assert ".csv.gz" in caught.value.hint


def test_format_is_found_by_suffix_in_any_case(tmp_path):
    assert format_of(tmp_path / "A.CSV.GZ").name == "csv"


def test_data_set_without_an_imu_file_is_a_configuration_error():
    with pytest.raises(ConfigError, match=r"\[imu\] file"):
        read_dataset(Config.from_dict({"filter": {"preset": "ned-15"}}))


@given(st.binary(max_size=300), st.booleans())
def test_any_bytes_give_a_table_or_a_typed_error(tmp_path_factory, data, skip):
    folder = tmp_path_factory.getbasetemp()
    (folder / "fuzz.csv").write_bytes(data if skip else HEAD.encode() + b"\n" + data)
    imu = {"file": "fuzz.csv", "on_bad_row": "skip" if skip else "stop"}
    imu |= {"gyro": {"arw_deg_sqrt_h": 1}, "accel": {"vrw_m_s_sqrt_h": 1}}
    with contextlib.suppress(GnssinsError):
        read_dataset(Config.from_dict({"imu": imu}, base=folder))


# ---- order of time


def test_rows_stay_in_file_order_unless_sorting_is_asked_for(read):
    text = lines(HEAD, ROWS[1], ROWS[0], ROWS[2])
    np.testing.assert_array_equal(read(text).imu.t_ns, [10_000_000, 0, 20_000_000])
    dataset = read(text, imu_keys={"on_backwards": "sort"})
    np.testing.assert_array_equal(dataset.imu.t_ns, [0, 10_000_000, 20_000_000])
    np.testing.assert_array_equal(dataset.imu.gyro[0], [1, 2, 3])
    assert source_of(dataset, "imu.csv").sorted_rows == 1


CELL = st.sampled_from(
    [
        "0",
        "1.5",
        "-2",
        "+3",
        "1e-3",
        ".5",
        "7.",
        "1e400",
        "nan",
        "NaN",
        "inf",
        "-Infinity",
        "",
        " 4",
        "x",
        "-999",
    ]
    + ['"5"', "1,2", "1;2", "0x1", "1_0", "true", "\r", "5\r"]
)
TIME = st.sampled_from(
    ["0", "0.01", "1.0000000005", "1.0000000015", "1e1", "-3", " 2", "2 ", "", "nan", "t", "1e30", "+4", "7."]
)
TABLE = st.lists(st.tuples(TIME, st.lists(CELL, min_size=2, max_size=4)), min_size=1, max_size=4)


@given(TABLE, st.sampled_from(["nan", "-999", "x"]), st.sampled_from(["w", "f", "t"]), st.booleans())
def test_the_short_way_reads_what_the_long_way_reads_or_nothing(tmp_path_factory, rows, missing, last, wide):
    # GIVEN small tables with all kinds of cells and rows of unequal length, the last column wanted or not
    order = [name for name in "wft" if name != last] + [last]
    cells = [dict(zip("wft", (*values[:2], t), strict=True)) for t, values in rows]
    text = ",".join([*order, *(["z"] if wide else [])]) + "\n"
    for (_, values), named in zip(rows, cells, strict=True):
        text += ",".join([*(named[name] for name in order), *values[2:]]) + "\n"
    path = tmp_path_factory.mktemp("cells") / "a.csv"
    path.write_text(text)
    # WHEN both read them THEN the short way gives the same bits, or leaves the table to the long way
    short = read_clean(path, "t", "s", ["w", "f"], missing, ",")
    if short is None:
        return
    table = read_text(path, section="imu", required=("t", "w", "f"))
    t_ns, columns = numbers(table, "t", "s", ("w", "f"), missing)
    assert np.array_equal(short.t_ns, t_ns)
    for name in ("w", "f"):
        assert np.array_equal(short.columns[name], columns[name], equal_nan=True)
    assert short.sha256 == table.sha256
    assert table.rows == t_ns.size == short.t_ns.size


def test_a_plain_log_takes_the_short_way(tmp_path):
    path = tmp_path / "imu.csv"
    path.write_text(PLAIN)
    assert read_clean(path, "time_s", "s", HEAD.split(",")[1:], "nan", ",") is not None


@pytest.mark.parametrize(
    "odd",
    ['0.03,1,2,3,4,5,"6"', "", "0.03,1,2,3,4,5", "0.03,1,2,3,4,5,6,7", "0.03,1,2,3,4,5,6\r"],
    ids=["quotes", "blank line", "too few cells", "too many cells", "carriage return"],
)
def test_an_odd_log_takes_the_long_way(tmp_path, odd):
    path = tmp_path / "imu.csv"
    path.write_bytes(lines(HEAD, *ROWS[:2], odd, ROWS[2]).encode())
    assert read_clean(path, "time_s", "s", HEAD.split(",")[1:], "nan", ",") is None
