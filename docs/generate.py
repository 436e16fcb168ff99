"""Renew the parts of the reference pages that the code itself tells: run ``.venv/bin/python docs/generate.py``.

Such a part stands between two comment lines in its page and is committed with it, so that a clone reads without a
build; ``tests/py/test_docs.py`` fails when it is stale.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from gnssins import _core, units
from gnssins.config import render_reference

REFERENCE = Path(__file__).resolve().parent / "reference"
BEGIN = "<!-- made by docs/generate.py: do not edit -->\n"
END = "<!-- end -->\n"


def configuration() -> str:
    """All keys with their defaults."""
    return f"```toml\n{render_reference().strip()}\n```\n"


def command_line() -> str:
    """The help texts."""
    parts = []
    environment = os.environ | {
        "NO_COLOR": "1",
        "TERM": "dumb",
        "COLUMNS": "100",
        "PYTHONIOENCODING": "utf-8",
    }
    for command in (
        "",
        "demo",
        "simulate",
        "run",
        "compare",
        "outages",
        "montecarlo",
        "reproduce",
        "budget",
        "schuler",
    ):
        words = [sys.executable, "-m", "gnssins", *command.split(), "--help"]
        done = subprocess.run(words, check=True, capture_output=True, encoding="utf-8", env=environment)
        text = done.stdout.replace("python -m gnssins", "gnssins").strip("\n")
        lines = "\n".join(line.rstrip() for line in text.splitlines())
        parts.append(f"## gnssins {command}".rstrip() + f"\n\n```text\n{lines}\n```\n")
    return "\n".join(parts)


def presets() -> str:
    """Two tables: what each preset is, and its blocks."""
    filters = ["| preset | what, and for whom | gyro noise | accelerometer noise |", "|---|---|---|---|"]
    blocks = [
        "| preset | block | process | at the start, 1 sigma | walk, or steady sd |",
        "|---|---|---|---|---|",
    ]
    for name in _core.preset_names():
        preset = json.loads(_core.preset_json(name))
        gyro = math.sqrt(preset["imu"]["gyro_psd"][0]) / units.DEG_TO_RAD
        accel = math.sqrt(preset["imu"]["accel_psd"][0])
        gyro_text = f"{60 * gyro:.3g} °/√h = {gyro:.3g} °/s/√Hz" if gyro else "none"
        accel_text = f"{60 * accel:.3g} m/s/√h = {accel / units.UG_TO_M_S2:.0f} µg/√Hz" if accel else "none"
        filters.append(f"| `{name}` | {_core.preset_summary(name)} | {gyro_text} | {accel_text} |")
        for block in preset["blocks"]:
            cells = (name, block["name"], block["process"])
            start = _values(block["kind"], block["initial_sd"])
            blocks.append(f"| {' | '.join(f'`{c}`' for c in cells)} | {start} | {_motion(block)} |")
    return "\n".join([*filters, "", *blocks, ""])


def _motion(block: dict) -> str:
    if block["process"] == "random_walk":
        return _value(block["kind"], math.sqrt(block["psd"][0])) + " per √s"
    if block["process"] == "gauss_markov":
        text = f"{_values(block['kind'], block['sd'])}, tau {block['tau_s'][0]:.0f} s"
        if block.get("distance_m"):
            text += f" and {block['distance_m'] / 1000.0:.0f} km"
        if any(block.get("jump_sd") or ()):
            text += f", jumps of {_values(block['kind'], block['jump_sd'])}"
        return text
    return "none"


def _values(kind: str, values: list[float]) -> str:
    """Numbers of a block, once if they are equal on all axes."""
    texts = [_value(kind, value) for value in values]
    return texts[0] if len(set(texts)) == 1 else ", ".join(texts)


def _value(kind: str, value: float) -> str:
    """A number of a block in the unit of data sheets."""
    if kind == "gyro_bias":
        per_hour = value / units.GYRO_BIAS["deg/h"]
        return f"{per_hour:.3g} °/h" if per_hour < 5.0 else f"{per_hour / 3600.0:.3g} °/s"
    if kind == "accel_bias":
        in_mg = value / units.ACCEL_BIAS["mg"]
        return f"{in_mg:.2g} mg" if in_mg > 0.05 else f"{1000.0 * in_mg:.2g} µg"
    if kind in ("baro_bias", "gnss_lever_arm", "gnss_position_error"):
        return f"{value:.3g} m"
    if kind == "gnss_velocity_error":
        return f"{value:.3g} m/s"
    return f"{value / units.SCALE['ppm']:.0f} ppm"


PAGES: dict[str, Callable[[], str]] = {
    "configuration.md": configuration,
    "command-line.md": command_line,
    "presets.md": presets,
}


def renewed(page: str) -> str:
    """Text of a page with its made part as the code has it now."""
    head, rest = (REFERENCE / page).read_text(encoding="utf-8").split(BEGIN)
    tail = rest.split(END)[1]
    return f"{head}{BEGIN}\n{PAGES[page]()}\n{END}{tail}"


if __name__ == "__main__":
    for name in PAGES:
        (REFERENCE / name).write_text(renewed(name), encoding="utf-8", newline="\n")
