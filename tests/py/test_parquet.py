"""Parquet instead of text: the same tables, whole and in pieces."""

import numpy as np
import polars as pl
import pytest

import gnssins
from gnssins import read_dataset, run_pieces
from gnssins.errors import InputError, MissingFileError
from gnssins.simfiles import write_simulation
from short_flight import simulated


@pytest.fixture(scope="module")
def configs(tmp_path_factory):
    """The short flight as text and as Parquet, small row groups."""
    folder = tmp_path_factory.mktemp("flight")
    write_simulation(simulated(), folder)
    text = gnssins.Config.load(next(folder.glob("*.toml"))).replace(run={"output_rate_hz": 1.0})
    for name in ("imu", "gnss", "ref"):
        table = pl.read_csv(folder / f"{name}.csv.gz")
        table.write_parquet(folder / f"{name}.parquet", row_group_size=700)
    files = {"imu": "imu", "gnss": "gnss", "truth": "ref"}
    return text, text.replace(
        **{key: {"file": str(folder / f"{name}.parquet")} for key, name in files.items()}
    )


def test_parquet_gives_the_tables_of_the_text(configs):
    text, parquet = (read_dataset(config) for config in configs)
    for table, names in (
        ("imu", ("t_ns", "gyro", "accel")),
        ("gnss", ("t_ns", "lla", "v_n", "var")),
        ("truth", ("t_ns", "lla", "v_n")),
    ):
        for name in names:
            one, other = (getattr(getattr(data, table), name) for data in (text, parquet))
            assert np.array_equal(one, other, equal_nan=True), (table, name)
    assert [s.rows for s in text.sources.values()] == [s.rows for s in parquet.sources.values()]


def test_pieces_of_parquet_give_the_bits_of_the_whole_run(configs, tmp_path):
    whole, pieces = gnssins.run(configs[1]), run_pieces(configs[1], tmp_path / "result", rows=2345)
    assert pieces.final_state == whole.final_state
    assert pl.read_parquet(tmp_path / "result" / "navigation.parquet").equals(whole.navigation)


def test_missing_values_and_integer_stamps(configs, tmp_path):
    path = tmp_path / "imu.parquet"
    table = pl.read_parquet(configs[1].imu.file)
    first = table.columns[1]
    stamps = pl.Series("t", np.arange(1, table.height + 1) * 20_000_000)
    holed = table.with_columns(
        stamps, pl.when(pl.arange(0, pl.len()) == 7).then(None).otherwise(first).alias(first)
    )
    holed.write_parquet(path)
    config = configs[1].replace(imu={"file": str(path), "time_column": "t", "time_unit": "ns"})
    imu = read_dataset(config).imu
    assert np.array_equal(imu.t_ns, stamps.to_numpy())
    assert np.flatnonzero(np.isnan(imu.gyro).any(axis=1)).tolist() == [7]


def test_files_that_cannot_be_read_are_told(configs, tmp_path):
    with pytest.raises(MissingFileError):
        read_dataset(configs[1].replace(imu={"file": str(tmp_path / "none.parquet")}))
    (tmp_path / "bad.parquet").write_bytes(b"PAR1 not really")
    with pytest.raises(InputError, match="cannot be read as Parquet") as caught:
        read_dataset(configs[1].replace(imu={"file": str(tmp_path / "bad.parquet")}))
    assert caught.value.code == "input.corrupt"
    with pytest.raises(InputError, match="column missing: nothing") as caught:
        read_dataset(configs[1].replace(imu={"time_column": "nothing"}))
    assert caught.value.code == "input.column"
