"""Result: its tables, its folder, its way back."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest
import tomlkit

import gnssins
from gnssins import Config, Result
from gnssins.errors import InputError, MissingFileError
from gnssins.result import Covariance, Event
from gnssins.simfiles import scenario_config
from gnssins.storage import write_atomic
from short_flight import config, result, simulated

HEAD = [
    "time_s", "lat_deg", "lon_deg", "height_m", "v_north_m_s", "v_east_m_s", "v_down_m_s",
    "roll_deg", "pitch_deg", "heading_deg",
    "sd_north_m", "sd_east_m", "sd_down_m", "sd_v_north_m_s", "sd_v_east_m_s", "sd_v_down_m_s",
    "sd_roll_deg", "sd_pitch_deg", "sd_heading_deg",
]  # fmt: skip


def test_navigation_has_the_promised_columns_in_their_order():
    table = result().navigation
    blocks = [("gyro_bias", "deg_h"), ("gyro_drift", "deg_h"), ("accel_drift", "mg")]
    states = [f"{block}_{axis}_{unit}" for block, unit in blocks for axis in "xyz"]
    assert table.columns == HEAD + [name for state in states for name in (state, f"sd_{state}")]
    assert table.height == len(result())
    assert set(table.dtypes) == {pl.Float64}


def test_navigation_is_the_arrays_in_other_units():
    r, table = result(), result().navigation
    assert np.array_equal(table["time_s"], r.t_ns / 1e9)
    assert np.allclose(np.radians(table["lat_deg"]), r.lla[:, 0], rtol=1e-15)
    assert np.array_equal(table["v_down_m_s"], r.v_n[:, 2])
    assert np.allclose(np.radians(table["sd_heading_deg"]), r.sd[:, 8], rtol=1e-14)
    assert np.allclose(table["gyro_drift_y_deg_h"] * np.pi / 180 / 3600, r.x[:, 4], rtol=1e-14)
    assert np.allclose(table["sd_accel_drift_z_mg"] * 9.80665e-3, r.x_sd[:, 8], rtol=1e-14)


def test_heading_is_in_0_to_360():
    rpy = np.zeros((4, 3))
    rpy[:, 2] = [-1e-20, -0.1, 0.0, 3.0]
    part = replace(result(), rpy=np.resize(rpy, result().rpy.shape))
    heading = part.navigation["heading_deg"].to_numpy()[:4]
    assert np.allclose(heading, [0.0, 360.0 - np.degrees(0.1), 0.0, np.degrees(3.0)])
    assert (heading < 360.0).all()


def test_measurements_tell_the_fix_its_fate_and_its_innovation():
    table = result().measurements
    assert table.height == len(simulated().dataset.gnss)
    assert set(table["status"]) <= {"used", "rejected", "withheld"}
    used = table.filter(pl.col("status") == "used")
    cov = used["innovation_cov"].to_numpy().reshape(-1, 6, 6)
    assert np.allclose(used["sd_innovation_v_east_m_s"] ** 2, cov[:, 4, 4])
    innovation = used.select(pl.selectors.starts_with("innovation_") - pl.selectors.by_name("innovation_cov"))
    y = innovation.to_numpy()
    assert np.allclose(np.einsum("ki,kij,kj->k", y, np.linalg.inv(cov), y), used["nis"], rtol=1e-9)
    held = table.filter(pl.col("status") == "withheld")
    assert held["nis"].is_nan().all()
    assert held["lat_deg"].is_finite().all()


def test_a_saved_result_comes_back(tmp_path):
    r = result()
    again = Result.open(r.save(tmp_path / "a" / "b"))
    assert np.array_equal(again.t_ns, r.t_ns)
    for name, tolerance in (("lla", 1e-15), ("v_n", 0.0), ("rpy", 1e-15), ("sd", 1e-15), ("x", 1e-15)):
        assert np.allclose(getattr(again, name), getattr(r, name), rtol=tolerance, atol=1e-18), name
    assert np.allclose(np.abs(np.sum(again.q_nb * r.q_nb, axis=1)), 1.0, atol=1e-15)
    assert np.array_equal(again.covariance.matrix, r.covariance.matrix)
    assert np.array_equal(again.covariance.t_ns, r.covariance.t_ns)
    assert again.states == r.states
    assert again.counts == r.counts
    assert again.log == r.log
    assert again.final_state == r.final_state
    assert again.metadata["config"] == tomlkit.parse(tomlkit.dumps(r.metadata["config"])).unwrap()
    assert np.array_equal(again.outages(), r.outages())
    for name in ("row", "t_ns", "status", "dof", "nis", "innovation", "innovation_cov", "v_n"):
        assert np.array_equal(getattr(again.records, name), getattr(r.records, name), equal_nan=True), name
    assert again.records.reason == r.records.reason
    assert repr(again) == repr(r)


def test_the_folder_holds_the_promised_files_and_nothing_else(tmp_path):
    result().save(tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {
        "navigation.parquet", "measurements.parquet", "aids.parquet", "covariance.parquet", "events.csv", "state.bin",
        "run.toml",
    }  # fmt: skip
    run = tomlkit.parse((tmp_path / "run.toml").read_text()).unwrap()
    assert run["run"]["seed"] == 1
    assert run["counts"]["gnss"]["withheld"] == 50
    assert run["versions"]["gnssins"] == gnssins.__version__
    assert {len(entry["sha256"]) for entry in run["input"]} == {64}
    # the whole configuration: what it says can be run again
    assert Config.from_dict(run["config"]) == config(outages=[[200.0, 250.0]])


def test_a_run_from_run_toml_gives_the_same_numbers(tmp_path):
    result().save(tmp_path)
    run = tomlkit.parse((tmp_path / "run.toml").read_text()).unwrap()
    again = gnssins.run(run["config"], simulated())
    assert np.array_equal(again.lla, result().lla)


def test_times_come_back_to_the_nanosecond(tmp_path):
    odd = replace(result(), t_ns=result().t_ns * 7 + 403_575_123_456_789)
    assert np.array_equal(Result.open(odd.save(tmp_path)).t_ns, odd.t_ns)


def test_a_folder_without_run_toml_is_not_a_result(tmp_path):
    result().save(tmp_path)
    (tmp_path / "run.toml").unlink()
    with pytest.raises(MissingFileError, match="no complete result"):
        Result.open(tmp_path)
    with pytest.raises(MissingFileError):
        Result.open(tmp_path / "nowhere")


def test_a_damaged_folder_is_refused(tmp_path):
    result().save(tmp_path)
    (tmp_path / "navigation.parquet").write_bytes(b"PAR1 cut")
    with pytest.raises(InputError, match=r"navigation\.parquet: cannot be read"):
        Result.open(tmp_path)
    pl.DataFrame({"time_s": [0.0]}).write_parquet(tmp_path / "navigation.parquet")
    with pytest.raises(InputError, match="lacks lat_deg"):
        Result.open(tmp_path)
    (tmp_path / "run.toml").write_text("format = 99\nstate = []\n")
    with pytest.raises(InputError, match="this version reads 1"):
        Result.open(tmp_path)


def test_a_failed_write_leaves_the_old_file_and_no_rest(tmp_path):
    path = tmp_path / "file.txt"
    path.write_text("old")

    def fail(temporary):
        temporary.write_text("half")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_atomic(path, fail)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["file.txt"]


def test_an_interrupted_save_is_not_taken_for_a_result(tmp_path):
    result().save(tmp_path)
    broken = replace(result(), covariance=Covariance(np.zeros(3, dtype=np.int64), np.zeros((2, 18, 18))))
    with pytest.raises(pl.exceptions.ShapeError):
        broken.save(tmp_path)
    with pytest.raises(MissingFileError):
        Result.open(tmp_path)


def test_a_filter_without_blocks_and_without_snapshots_survives_the_folder(tmp_path):
    tables = scenario_config(simulated())
    tables["filter"] = {}
    tables["imu"] |= {"gyro": {"arw_deg_sqrt_h": 0.001}, "accel": {"vrw_m_s_sqrt_h": 0.01}}
    r = gnssins.run({**tables, "run": {"end_s": 5.0}}, simulated())
    assert r.x.shape == (len(r), 0)
    assert r.navigation.columns == HEAD
    again = Result.open(r.save(tmp_path))
    assert again.x.shape == (len(r), 0)
    assert again.covariance.matrix.shape == (0, 9, 9)


def test_events_keep_commas_and_quotes(tmp_path):
    log = (Event(5, "imu.gap", 3, 'gap, "long"\nsecond line'), Event(7, "gnss.late", 4, ""))
    again = Result.open(replace(result(), log=log).save(tmp_path))
    assert again.log == log
    assert again.event_counts() == {"imu.gap": 1, "gnss.late": 1}
    assert replace(result(), log=()).events.height == 0


def test_events_keep_their_number(tmp_path):
    log = (Event(5, "gnss.rejected", 3, "refused", 41.5), Event(7, "gnss.bad", 4, "not usable"))
    made = replace(result(), log=log)
    assert made.events.columns == ["time_s", "code", "row", "value", "message"]
    assert made.events["value"].to_list() == [41.5, None]
    folder = made.save(tmp_path)
    assert (folder / "events.csv").read_text().splitlines()[1] == "5e-9,gnss.rejected,3,41.5,refused"
    assert Result.open(folder).log == log


def test_a_result_from_before_events_had_numbers_can_be_read(tmp_path):
    folder = replace(result(), log=(Event(5_000_000_000, "gnss.late", 3, "late", 1.0),)).save(tmp_path)
    (folder / "events.csv").write_text("time_s,code,row,message\n5.0,gnss.late,3,late\n")
    assert Result.open(folder).log == (Event(5_000_000_000, "gnss.late", 3, "late"),)


def test_to_pandas_gives_the_same_numbers():
    pandas = pytest.importorskip("pandas")
    frame = result().to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    assert list(frame.columns) == result().navigation.columns
    assert np.array_equal(frame["lat_deg"], result().navigation["lat_deg"])


def test_a_missing_pandas_is_answered_by_the_pip_line(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(ImportError, match=r'pip install "gnssins\[pandas\]"'):
        result().to_pandas()


def test_repr_is_one_line():
    assert repr(result()).startswith("Result(3001 epochs from 0.020 s to 300.000 s, 18 states, ")
