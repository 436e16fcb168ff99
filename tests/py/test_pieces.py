"""A run in pieces gives what the whole run gives, to the bit, and says what it cannot do."""

import gzip

import numpy as np
import polars as pl
import pytest

import gnssins
from gnssins import Result, run_pieces
from gnssins.errors import ConfigError, DataQualityError, InputError
from gnssins.simfiles import write_simulation
from short_flight import simulated

TABLES = ("navigation", "measurements", "aids", "covariance")


@pytest.fixture(scope="session")
def flight(tmp_path_factory):
    """The short flight as files: 15 000 IMU rows."""
    folder = tmp_path_factory.mktemp("flight")
    write_simulation(simulated(), folder)
    return folder


def _config(folder, **run):
    toml = next(folder.glob("*.toml"))
    return gnssins.Config.load(toml).replace(
        run={"output_rate_hz": 10.0, "covariance_interval_s": 5.0, "outages": [[100.0, 130.0]], **run}
    )


def _same(config, tmp_path, rows):
    """Both runs on disk; the result of the one in pieces."""
    whole, pieces = tmp_path / "whole", tmp_path / "pieces"
    gnssins.run(config).save(whole)
    given = run_pieces(config, pieces, rows=rows)
    for name in TABLES:
        one, other = (pl.read_parquet(folder / f"{name}.parquet") for folder in (whole, pieces))
        assert one.equals(other, null_equal=True), name
        assert one.schema == other.schema
    one, other = Result.open(whole), Result.open(pieces)
    assert one.final_state == other.final_state
    assert one.counts == other.counts
    assert one.log == other.log
    for key in ("finding", "config", "engine", "outages_ns"):
        assert one.metadata[key] == other.metadata[key], key
    files = {entry["file"]: entry for entry in one.metadata["input"]}
    imu, *aids = other.metadata["input"]
    assert all(files[entry["file"]] == entry for entry in aids)
    if config.run.end_s is None:
        assert files[imu["file"]] == imu
    else:  # what lies a piece after the end is not read
        assert files[imu["file"]]["sha256"] == imu["sha256"]
        assert imu["rows"] <= (config.run.end_s + 40.0) * 50.0
    return given


@pytest.mark.parametrize("rows", [1000, 4321, 1_000_000])
def test_pieces_of_any_size_give_the_bits_of_the_whole_run(flight, tmp_path, rows):
    given = _same(_config(flight), tmp_path, rows)
    assert len(given) == 0
    assert given.counts["gnss"]["withheld"] == 30
    assert given.records.row.size == given.counts["gnss"]["in"] + 30
    assert not list((tmp_path / "pieces").glob(".parts-*"))


@pytest.mark.parametrize("span", [(30.0, 250.0), (45.123, 60.0)])
def test_the_start_may_be_found_and_the_end_may_lie_in_any_piece(flight, tmp_path, span):
    tables = _config(flight).to_dict()
    tables["run"] |= {"start_s": span[0], "end_s": span[1], "outages": []}
    tables["initial"] = {"heading": "course", "leveling": "accel"}
    tables["gnss"] |= {"position_sd_m": 1.0, "velocity_sd_m_s": 0.05}
    _same(gnssins.Config.from_dict(tables), tmp_path, 1000)


def test_a_start_between_two_imu_rows_of_two_pieces_keeps_the_row_before(flight, tmp_path):
    config = _config(flight, start_s=20.01, end_s=60.0, outages=[])
    _same(config, tmp_path, 1000)


def test_rows_that_are_skipped_or_bad_are_counted_as_in_the_whole_run(flight, tmp_path):
    text = gzip.decompress((flight / "imu.csv.gz").read_bytes()).decode().splitlines()
    text[1500] = text[1500].replace(",", ";", 1)
    cells = text[7000].split(",")
    text[7000] = ",".join([cells[0], "nan", *cells[2:]])
    text.insert(9000, "")
    (tmp_path / "imu.csv").write_text("\n".join(text) + "\n")
    config = _config(flight).replace(imu={"file": str(tmp_path / "imu.csv"), "on_bad_row": "skip"})
    given = _same(config, tmp_path, 1000)
    assert given.counts["imu"]["bad"] == 1
    assert given.metadata["input"][0]["skipped"] == {"wrong number of cells": 1}
    assert [event.row for event in given.log if event.code == "imu.not_finite"] == [6998]


def test_errors_name_the_row_of_the_file(flight, tmp_path):
    text = gzip.decompress((flight / "imu.csv.gz").read_bytes()).decode().splitlines()
    text[7000] = text[7000].replace(",", ",x", 1)
    (tmp_path / "imu.csv").write_text("\n".join(text) + "\n")
    config = _config(flight).replace(imu={"file": str(tmp_path / "imu.csv")})
    with pytest.raises(InputError) as whole:
        gnssins.run(config)
    with pytest.raises(InputError) as pieces:
        run_pieces(config, tmp_path / "result", rows=1000)
    assert str(whole.value) == str(pieces.value)
    assert pieces.value.context["line"] == 7001


def test_a_log_that_goes_bad_late_leaves_no_result(flight, tmp_path):
    text = gzip.decompress((flight / "imu.csv.gz").read_bytes()).decode().splitlines()
    for row in range(12_000, 13_000):
        text[row] = ",".join([text[row].split(",")[0], *["nan"] * 6])
    (tmp_path / "imu.csv").write_text("\n".join(text) + "\n")
    config = _config(flight).replace(imu={"file": str(tmp_path / "imu.csv"), "max_gap_s": 60.0})
    with pytest.raises(DataQualityError) as caught:
        run_pieces(config, tmp_path / "result", rows=1000)
    assert caught.value.code == "data.imu_bad"
    assert not list((tmp_path / "result").iterdir())


def test_units_are_refused_before_the_filter_starts(flight, tmp_path):
    config = _config(flight).replace(imu={"kind": "rates", "accel_unit": "m/s^2", "gyro_unit": "rad/s"})
    heard = []
    with pytest.raises(DataQualityError, match="specific force"):
        run_pieces(config, tmp_path / "result", rows=2000, told=heard.append)
    assert heard
    assert not (tmp_path / "result").exists()


@pytest.mark.parametrize(
    ("keys", "rows", "what"),
    [
        ({"imu": {"on_backwards": "sort"}}, 1000, "on_backwards"),
        ({"run": {"linearise": True}}, 1000, "linearise"),
        ({}, 999, "at least 1000"),
    ],
)
def test_what_needs_the_whole_log_is_refused(flight, tmp_path, keys, rows, what):
    with pytest.raises(ConfigError, match=what):
        run_pieces(_config(flight).replace(**keys), tmp_path / "result", rows=rows)


def test_progress_rises_to_one(flight, tmp_path):
    shares = []
    run_pieces(_config(flight), tmp_path / "result", rows=1000, progress=shares.append)
    assert shares == sorted(shares)
    assert len(shares) > 10
    assert shares[-1] == 1.0
    assert np.all(np.array(shares[:-1]) < 1.0)
