"""The documentation tells the truth: TOML validates, Python and Rust run, reference pages are those of the code."""

import importlib.util
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import gnssins
from gnssins.config import Config
from gnssins.config.root import parse_toml
from gnssins.sim import scenario_from_dict

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"


def blocks(page: str, language: str) -> list[str]:
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)


def tables(text: str, folder: Path) -> dict:
    file = folder / "example.toml"
    file.write_text(text, encoding="utf-8")
    return parse_toml(file)


def test_configuration_of_the_tutorial_is_valid(tmp_path):
    (text,) = blocks("tutorial.md", "toml")
    config = Config.from_dict(tables(text, tmp_path), base=tmp_path)
    assert config.filter.preset == "ned-15"


def test_scenario_of_the_how_to_is_valid(tmp_path):
    whole, aids = (tables(text, tmp_path) for text in blocks("howto/simulate.md", "toml"))
    assert scenario_from_dict(whole).name == "loop"
    assert scenario_from_dict(whole | aids).baro is not None


def test_python_of_the_simulation_how_to_runs(capsys):
    for text in blocks("howto/simulate.md", "python"):
        exec(compile(text, "howto/simulate.md", "exec"), {})
    assert capsys.readouterr().out


def test_stream_of_the_how_to_gives_the_bits_of_a_batch_run():
    rows, block = blocks("howto/stream.md", "python")
    names = {}
    exec(compile(rows, "howto/stream.md", "exec"), names)
    streamed = names["navigator"]
    result = gnssins.run(names["config"] | {"run": {"end_s": 20.0}}, names["simulated"])
    assert streamed.counts["imu"]["used"] == result.counts["imu"]["used"] == 2000
    assert streamed.counts["gnss"]["used"] == result.counts["gnss"]["used"] > 0
    assert streamed.state.t_ns == result.t_ns[-1]
    for name in ("lla", "v_n", "rpy", "q_nb", "sd", "x", "x_sd"):
        np.testing.assert_array_equal(getattr(streamed.state, name), getattr(result, name)[-1], err_msg=name)
    assert streamed.save() == result.final_state
    exec(compile(block, "howto/stream.md", "exec"), names)
    assert len(names["states"]) == 11


@pytest.fixture(scope="module")
def generate():
    spec = importlib.util.spec_from_file_location("generate", DOCS / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("page", ["configuration.md", "command-line.md", "presets.md"])
def test_made_pages_are_those_of_the_code(generate, page):
    assert page in generate.PAGES
    text = (DOCS / "reference" / page).read_text(encoding="utf-8")
    if text != generate.renewed(page):
        pytest.fail(
            f"docs/reference/{page} is stale; renew it: .venv/bin/python docs/generate.py", pytrace=False
        )


@pytest.mark.skipif(shutil.which("cargo") is None, reason="cargo is not installed")
def test_rust_example_runs_and_finds_its_way():
    # the profile of `cargo test`, so that nothing is built twice
    words = ["cargo", "run", "--quiet", "--profile", "test", "--example", "embedded"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, encoding="utf-8", check=False)
    assert done.returncode == 0, done.stderr
    errors = re.findall(r"north error (\S+) m \(sd (\S+)\), up (\S+) m \(sd (\S+)\)", done.stdout)
    assert len(errors) == 2
    for north, north_sd, up, up_sd in (map(float, values) for values in errors):
        assert abs(north) < 4 * north_sd < 1.0
        assert abs(up) < 4 * up_sd < 1.0
    (nis,) = re.findall(r"mean NIS .*: (\S+)", done.stdout)
    assert 5.0 < float(nis) < 7.0
    assert re.findall(r"imu\.gap", done.stdout) == ["imu.gap"]


def test_python_of_the_monte_carlo_how_to_runs(capsys):
    names: dict[str, object] = {"__name__": "page"}
    for text in blocks("howto/monte-carlo.md", "python"):
        exec(compile(text, "howto/monte-carlo.md", "exec"), names)
    assert names["result"].counts["gnss"]["used"] > 100
    assert "Root mean square of 40 runs" in capsys.readouterr().out
