"""The command line: what it prints where, what it writes, and with which code it leaves."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import gnssins
from gnssins import Result, cli
from gnssins.commands import filtering
from gnssins.errors import ConfigError
from gnssins.simfiles import write_simulation
from short_flight import config, simulated

COMMANDS = ("demo", "simulate", "run", "compare", "outages")


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    """Files of the short flight; the last one is the configuration."""
    return Path(write_simulation(simulated(), tmp_path_factory.mktemp("log"))[-1])


@pytest.fixture
def gnssins_command(capsys, monkeypatch):
    """Run the command in this process; gives exit code, stdout, stderr."""

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["gnssins", *map(str, arguments)])
        code = cli._guarded()
        out, err = capsys.readouterr()
        return code, out, err

    return call


def test_version_is_that_of_the_package():
    done = subprocess.run(
        [sys.executable, "-m", "gnssins", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout == f"gnssins {gnssins.__version__}\n"
    assert done.stderr == ""


def test_help_shows_every_command_with_an_example(gnssins_command):
    code, out, _ = gnssins_command("--help")
    assert code == 0
    assert all(name in out for name in COMMANDS)
    assert "Start with: gnssins demo" in out
    for name in COMMANDS:
        code, out, _ = gnssins_command(name, "--help")
        assert code == 0
        assert f"Example: gnssins {name}" in out
        assert "--json" in out


def test_help_loads_nothing_heavy():
    code = (
        "import sys; sys.argv = ['gnssins', 'run', '--help']\n"
        "from gnssins import cli; cli._guarded()\n"
        "heavy = {'numpy', 'polars', 'scipy', 'matplotlib', 'gnssins.config'} & set(sys.modules)\n"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_run_writes_the_result_and_tells_what_it_did(gnssins_command, log, tmp_path):
    code, out, err = gnssins_command("run", log, "--out", tmp_path / "result", "--csv", "--kml", "--figures")
    assert code == 0, err
    assert err == ""
    names = {path.name for path in (tmp_path / "result").iterdir()}
    assert names >= {
        "navigation.parquet", "measurements.parquet", "run.toml", "navigation.csv", "measurements.csv",
        "track.kml", "track.png", "position_errors.png", "biases.png", "innovations.png", "nis.png",
    }  # fmt: skip
    assert "IMU rows: 15000 in = 15000 used + 0 rejected + 0 late + 0 bad" in out
    assert "position, m" in out
    assert "consistent" in out
    assert str(tmp_path / "result" / "track.kml") in out


def test_run_prints_json_and_nothing_else(gnssins_command, log, tmp_path):
    code, out, err = gnssins_command("run", log, "--out", tmp_path / "result", "--json")
    report = json.loads(out)
    assert (code, err) == (0, "")
    assert report["counts"]["gnss"]["in"] == 300
    assert report["rmse"]["position_m"]["north"] < 1.0
    assert report["outages"] is None
    assert report["findings"] == []
    assert all(Path(file).is_file() for file in report["files"])
    assert len(Result.open(report["out"])) == report["epochs"]


def test_run_with_outages_prints_how_far_the_solution_drifts(gnssins_command, log, tmp_path):
    text = log.read_text()
    gaps = log.with_name("gaps.toml")
    gaps.write_text(text + "\n[run]\noutages = [[200.0, 250.0]]\noutput_rate_hz = 10.0\n")
    code, out, _ = gnssins_command("run", gaps, "--out", tmp_path / "result")
    assert code == 0
    assert "50 withheld" in out
    assert "Without GNSS, against the withheld fixes" in out
    code, out, _ = gnssins_command("compare", tmp_path / "result", log.with_name("ref.csv.gz"), "--json")
    report = json.loads(out)
    assert code == 0
    assert len(report["outages"]["outages"]) == 1


def test_compare_takes_a_file_or_another_result(gnssins_command, log, tmp_path):
    result = gnssins.run(config(), simulated())
    result.save(tmp_path / "result")
    code, out, _ = gnssins_command(
        "compare", tmp_path / "result", log.with_name("ref.csv.gz"), "--after", 100
    )
    assert code == 0
    assert "100.1 s to 300.0 s" in out
    code, out, _ = gnssins_command("compare", tmp_path / "result", tmp_path / "result", "--json")
    assert code == 0
    assert set(json.loads(out)["rmse"]["position_m"].values()) == {0.0}


def test_simulate_writes_a_log_that_runs(gnssins_command, tmp_path):
    code, out, _ = gnssins_command("simulate", "static", "--seed", 4, "--out", tmp_path / "a")
    assert code == 0
    names = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert names == ["gnss.csv.gz", "imu.csv.gz", "ref.csv.gz", "static.toml"]
    assert f"Next: gnssins run {tmp_path / 'a' / 'static.toml'}" in out
    code, out, _ = gnssins_command("run", tmp_path / "a" / "static.toml", "--out", tmp_path / "r", "--json")
    assert code == 0
    assert json.loads(out)["rmse"]["position_m"]["north"] < 3.0


def test_the_same_seed_simulates_the_same_files(gnssins_command, tmp_path):
    for folder, seed in (("a", 4), ("b", 4), ("c", 5)):
        gnssins_command("simulate", "static", "--seed", seed, "--out", tmp_path / folder, "--json")
    a, b, c = ((tmp_path / folder / "imu.csv.gz").read_bytes() for folder in "abc")
    assert a == b
    assert a != c


def test_simulate_lists_its_scenarios(gnssins_command):
    code, out, _ = gnssins_command("simulate", "--list")
    assert code == 0
    assert "fomichev-tan-2017" in out
    code, out, _ = gnssins_command("simulate", "--list", "--json")
    assert {"name", "description", "variants"} == set(json.loads(out)["scenarios"][0])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "nowhere.toml"), r"input\.not_found.*nowhere\.toml"),
        (("run",), "Missing argument"),
        (("rnu",), "No such command"),
        (("run", "x.toml", "--figure"), "No such option"),
        (("simulate",), "gnssins simulate --list"),
        (("simulate", "fomichev"), r"config\.scenario"),
        (("simulate", "static", "--seed", "-1"), "seed"),
        (("compare", "nowhere", "ref.csv"), r"input\.no_result"),
    ],
)
def test_what_the_user_can_change_leaves_with_1_and_no_trace(gnssins_command, arguments, words):
    code, out, err = gnssins_command(*arguments)
    assert code == 1
    assert re.search(words, err, re.DOTALL)
    assert "Traceback" not in err
    assert out == ""


def test_a_user_error_is_one_line_and_its_hint(gnssins_command, tmp_path):
    bad = tmp_path / "bad.toml"
    bad.write_text('[filter]\npreset = "ned-15"\nmodle = "ned"\n')
    code, _, err = gnssins_command("run", bad)
    assert code == 1
    assert "modle" in err
    assert "model" in err


def test_errors_are_json_on_request(gnssins_command):
    code, out, err = gnssins_command("run", "nowhere.toml", "--json")
    assert code == 1
    assert json.loads(out)["error"]["code"] == "input.not_found"
    assert "nowhere.toml" in err


def test_a_full_disk_is_not_a_bug(gnssins_command, log, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device", str(tmp_path / "navigation.parquet"))

    monkeypatch.setattr("gnssins.storage.save", full)
    code, _, err = gnssins_command("run", log, "--out", tmp_path / "result")
    assert code == 1
    assert "No space left on device" in err
    assert "Traceback" not in err


def test_a_bug_leaves_with_2_and_its_trace(gnssins_command, monkeypatch):
    monkeypatch.setattr(filtering, "compare", lambda *_: 1 // 0)
    code, _, err = gnssins_command("compare", "a", "b")
    assert code == 2
    assert "ZeroDivisionError" in err
    assert "This is a bug" in err


def test_ctrl_c_leaves_quietly(gnssins_command, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(filtering, "compare", interrupted)
    code, _, err = gnssins_command("compare", "a", "b")
    assert code == 130
    assert "Traceback" not in err


def test_findings_about_the_data_go_to_stderr(gnssins_command, log, tmp_path):
    late = log.with_name("late.toml")
    late.write_text(log.read_text().replace('kind = "increments"', 'kind = "rates"'))
    code, out, err = gnssins_command("run", late, "--out", tmp_path / "result")
    assert code == 1
    assert "hint:" in err
    assert out == ""


def test_no_color_and_pipes_get_plain_text(log, tmp_path):
    command = [sys.executable, "-m", "gnssins", "run", str(log), "--out", str(tmp_path / "result")]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, env={"NO_COLOR": "1", "PATH": ""}
    )
    assert "\x1b" not in done.stdout + done.stderr
    assert done.stderr == ""


def test_the_demonstration_reports_what_it_promises(gnssins_command, tmp_path):
    code, out, _ = gnssins_command("demo", "--out", tmp_path / "demo", "--json")
    report = json.loads(out)
    assert code == 0
    assert len(report["accuracy"]) == 9
    assert all(row["rms"] < 2.0 * row["target"] for row in report["accuracy"])
    assert len(report["outages"]["outages"]) == 3
    assert report["counts"]["gaps"]["gnss"]["withheld"] == 700
    assert all(Path(file).is_file() for file in report["files"])
    assert report["nis"]["whole"]["gnss, 6 components"]["count"] == 3000


def test_a_wrong_key_is_a_config_error():
    with pytest.raises(ConfigError):
        gnssins.run({"filtre": {}})
