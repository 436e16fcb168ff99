"""The examples of the documentation do what they say: TOML validates, Python runs."""

import re
from pathlib import Path

import pytest

from gnssins.config import Config
from gnssins.config.root import parse_toml
from gnssins.sim import scenario_from_dict

DOCS = Path(__file__).resolve().parents[2] / "docs"


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
    (text,) = blocks("howto/simulate.md", "toml")
    assert scenario_from_dict(tables(text, tmp_path)).name == "loop"


@pytest.mark.parametrize("page", ["howto/simulate.md", "howto/stream.md"])
def test_python_of_the_how_to_runs(page, capsys):
    for text in blocks(page, "python"):
        exec(compile(text, page, "exec"), {})
    assert capsys.readouterr().out
