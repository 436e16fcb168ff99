"""Output never overwrites an input and never goes where no folder can be."""

import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gnssins
from gnssins import Result, cli
from gnssins.errors import ConfigError, GapError
from gnssins.outputs import FIGURE_FILES
from gnssins.sim import load_scenario, scenario_toml
from gnssins.simfiles import write_simulation
from short_flight import config, result, simulated


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    return Path(write_simulation(simulated(), tmp_path_factory.mktemp("outputs"))[-1])


@pytest.fixture
def command(capsys, monkeypatch):
    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["gnssins", *map(str, arguments)])
        code = cli._guarded()
        out, err = capsys.readouterr()
        return code, out, err

    return call


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_simulate_does_not_overwrite_its_scenario(command, tmp_path):
    scenario = tmp_path / "static.toml"
    scenario.write_text(scenario_toml(load_scenario("static")))
    before = files(tmp_path)
    code, _, err = command("simulate", scenario, "--out", tmp_path)
    assert code == 1
    assert "config.output_is_input" in err
    assert str(scenario) in err
    assert files(tmp_path) == before


@pytest.mark.parametrize("name", ["run.toml", "RUN2.toml"])
def test_run_does_not_overwrite_its_configuration(command, log, tmp_path, name):
    folder = tmp_path / "project"
    shutil.copytree(log.parent, folder)
    settings = folder / name
    (folder / log.name).rename(settings)
    if name != "run.toml":
        (folder / "run.toml").symlink_to(settings)
    before = files(folder)
    code, _, err = command("run", settings, "--out", folder)
    assert code == 1
    assert "config.output_is_input" in err
    assert "another folder" in err
    assert files(folder) == before


def test_run_does_not_overwrite_a_log(command, log, tmp_path):
    folder = tmp_path / "project"
    shutil.copytree(log.parent, folder)
    (folder / "ref.csv.gz").rename(folder / "navigation.csv.gz")
    shutil.copy(folder / "navigation.csv.gz", folder / "navigation.csv")
    settings = folder / log.name
    settings.write_text(log.read_text().replace("ref.csv.gz", "navigation.csv"))
    before = files(folder)
    code, _, err = command("run", settings, "--out", folder, "--csv")
    assert code == 1
    assert "navigation.csv: the output would overwrite 1 of the input files" in err
    assert files(folder) == before


def test_a_result_from_python_does_not_overwrite_its_configuration(tmp_path):
    path = tmp_path / "run.toml"
    config(end_s=2.0).to_toml(path)
    made = gnssins.run(path, simulated())
    text = path.read_text()
    with pytest.raises(ConfigError) as caught:
        made.save(tmp_path)
    assert caught.value.code == "config.output_is_input"
    assert path.read_text() == text
    assert len(Result.open(made.save(tmp_path / "result"))) == len(made)


# ---- findings


def suspicious():
    """The flight, with two stamps repeated in the fixes (a warning) and a hole that stops the engine."""
    data = simulated().dataset
    t_ns = data.gnss.t_ns.copy()
    t_ns[10] = t_ns[9]
    keep = (data.imu.t_ns < 30 * 10**9) | (data.imu.t_ns > 35 * 10**9)
    return replace(data, imu=data.imu.select(keep), gnss=replace(data.gnss, t_ns=t_ns))


def test_an_error_of_the_engine_carries_the_findings():
    with pytest.raises(GapError) as caught:
        gnssins.run(config(), suspicious(), initial=simulated().initial)
    assert "the look at the data before said:" in caught.value.hint
    assert "gnss: 1 rows repeat the stamp" in caught.value.hint
    assert {"time.duplicate", "gap.long"} <= {f["code"] for f in caught.value.context["findings"]}


def test_findings_are_told_before_the_filter_runs_and_not_twice():
    seen = []
    with pytest.raises(GapError) as caught:
        gnssins.run(config(), suspicious(), initial=simulated().initial, told=seen.extend)
    assert "time.duplicate" in {f.code for f in seen}
    assert "look at the data" not in caught.value.hint


def test_the_command_prints_findings_although_the_engine_fails(command, log, tmp_path):
    data = suspicious()
    files = write_simulation(replace(simulated(), dataset=data), tmp_path / "log")
    code, _, err = command("run", files[-1], "--out", tmp_path / "result")
    assert code == 1
    assert err.index("warn: gnss: 1 rows repeat") < err.index("GapError")
    code, out, err = command("run", files[-1], "--out", tmp_path / "result", "--json")
    assert code == 1
    assert "the look at the data before said:" in out
    assert '"findings"' in out


def test_the_result_says_how_many_findings_there_are():
    made = replace(result(), metadata={**result().metadata, "finding": [{}, {}]})
    assert str(made).endswith(" events, 2 findings)")
    assert "finding" not in str(result())
    assert np.all(made.t_ns == result().t_ns)


# ---- folder


def test_a_file_in_place_of_the_folder_is_refused_before_the_work(command, log, tmp_path):
    taken = tmp_path / "taken"
    taken.write_text("mine")
    for arguments in (("run", log), ("simulate", "static")):
        for place in (taken, taken / "below"):
            code, _, err = command(*arguments, "--out", place)
            assert code == 1
            assert "config.output_not_folder" in err
            assert "hint:" in err
    with pytest.raises(ConfigError):
        result().save(taken)
    assert taken.read_text() == "mine"


def test_pictures_of_an_earlier_run_go_and_others_stay(command, log, tmp_path):
    folder = tmp_path / "result"
    folder.mkdir()
    (folder / "nis.png").write_text("not from a run")
    settings = log.with_name("short.toml")
    settings.write_text(log.read_text() + "\n[run]\nend_s = 20.0\n")
    assert command("run", settings, "--out", folder)[0] == 0
    assert (folder / "nis.png").read_text() == "not from a run"
    assert command("run", settings, "--out", folder, "--figures")[0] == 0
    (folder / "photo.png").write_text("mine")
    assert {path.name for path in folder.glob("*.png")} == {*FIGURE_FILES, "photo.png"}
    assert command("run", settings, "--out", folder)[0] == 0
    assert [path.name for path in folder.glob("*.png")] == ["photo.png"]


# ---- start


def test_the_run_tells_when_it_started_and_where_the_attitude_comes_from(command, log, tmp_path):
    out = command("run", log, "--out", tmp_path / "a")[1]
    line = next(text for text in out.splitlines() if text.startswith("Started at"))
    assert line.startswith("Started at 0.000 s: heading ")
    assert line.count("given") == 2
    tables = config().replace(run={"start_s": 45.0, "end_s": 60.0})
    tables = tables.replace(initial=dict.fromkeys(tables.to_dict()["initial"]))
    files = {name: {"file": str(log.with_name(f"{name}.csv.gz"))} for name in ("imu", "gnss")}
    tables.replace(**files).to_toml(tmp_path / "auto.toml")
    code, out, err = command("run", tmp_path / "auto.toml", "--out", tmp_path / "b")
    assert code == 0, err
    line = next(text for text in out.splitlines() if text.startswith("Started at"))
    assert re.match(
        r"Started at 45\.0\d\d s \(asked 45\.0 s\): heading [\d.]+ deg, sd [\d.]+ deg, from the", line
    )
    assert line.endswith("from the accelerometer")
