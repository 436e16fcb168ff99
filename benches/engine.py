"""The parts of the engine: what Criterion measured, and instructions counted under callgrind."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from report import ABSENT, Measured, Report

SETS = ("portable", "avx2", "avx512")
PARTS = {
    "transition": "Transition, third order",
    "covariance": "Covariance through one interval",
    "step": "Whole step: strapdown, transition, covariance; NED",
    "step-ecef": "Whole step; ECEF",
    "update-6": "Update, position and velocity",
    "update-3": "Update, position",
}

#: A case: part, variant, number of states.
Case = tuple[str, str, int]


def criterion(folder: Path) -> dict[Case, Measured]:
    """Medians that ``cargo bench`` left behind, s."""
    found = {}
    for about in folder.glob("**/new/benchmark.json"):
        case = _case(json.loads(about.read_text())["full_id"])
        if case:
            estimates = json.loads(about.with_name("estimates.json").read_text())
            median, spread = (estimates[key]["point_estimate"] for key in ("median", "median_abs_dev"))
            found[case] = Measured(1e-9 * median, 1e-9 * spread)
    return found


def _case(name: str) -> Case | None:
    match = re.fullmatch(r"([a-z0-9-]+)/([a-z0-9]+)/(\d+)", name)
    return (match[1], match[2], int(match[3])) if match else None


def count(program: Path) -> dict[Case, float] | None:
    """Instructions per call of every case of ``benches/counts.rs``; None without valgrind."""
    valgrind = shutil.which("valgrind")
    if valgrind is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        options = ["--tool=callgrind", f"--callgrind-out-file={out}"]
        options += ["--zero-before=counted", "--dump-after=counted"]
        done = subprocess.run([valgrind, *options, str(program)], capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"valgrind failed:\n{done.stderr}")
        found = {}
        for place, line in enumerate(done.stdout.splitlines(), start=1):
            name, calls = line.split()
            total = re.search(r"^totals: (\d+)$", Path(f"{out}.{place}").read_text(), flags=re.MULTILINE)
            case = _case(name)
            if total is None or case is None:
                sys.exit(f"callgrind wrote no total for {name}")
            found[case] = int(total[1]) / int(calls)
        return found


def show(report: Report, times: Mapping[Case, Measured], counts: Mapping[Case, float] | None) -> None:
    """Parts by number of states, each beside dense nalgebra."""
    report.section(
        "Parts of the engine",
        "Nanoseconds of one core, median ± median deviation, each beside the same work with whole matrices of nalgebra "
        "(`SMatrix` of exactly the size). The last column is how many times faster the widest set of instructions is. "
        "Dense updates have no gate, no feedback and no check of P, which ours have. The transition runs on portable "
        "instructions here; within a step it runs on those of the step.",
    )
    rows = [
        [f"Strapdown, {name.upper()}", ABSENT if m is None else m.ns()]
        for name in ("ned", "ecef")
        for m in [times.get(("strapdown", name, 9))]
    ]
    report.table(["", "ns"], rows)
    for part, title in PARTS.items():
        report.lines += [f"{title}:", ""]
        rows = [_row(report, part, states, times) for states in _sizes(part, times)]
        report.table(["states", *SETS, "dense nalgebra", "times faster"], rows)
    _show_counts(report, counts)


def _sizes(part: str, cases: Mapping[Case, object]) -> list[int]:
    return sorted({states for name, _, states in cases if name == part})


def _row(report: Report, part: str, states: int, times: Mapping[Case, Measured]) -> list[str]:
    ours = [times.get((part, name, states)) for name in SETS]
    dense = times.get((part, "dense", states))
    ratio = ABSENT
    for name, m in zip(SETS, ours, strict=True):
        if m is not None and dense is not None:
            ratio = report.against(f"{part}, {states} states, {name}", m, "dense nalgebra", dense)
    return [str(states), *(ABSENT if m is None else m.ns() for m in [*ours, dense]), ratio]


def _show_counts(report: Report, counts: Mapping[Case, float] | None) -> None:
    report.section(
        "Instructions",
        "Instructions of one step or update, counted under callgrind: the same on every run of one build. Valgrind "
        "knows no AVX-512.",
    )
    if counts is None:
        report.lines += ["Not counted: valgrind is not installed.", ""]
        return
    names = ["portable", "avx2", "dense"]
    rows = [
        [part, str(states), *(_number(counts.get((part, name, states))) for name in names)]
        for part in PARTS
        for states in _sizes(part, counts)
    ]
    report.table(["part", "states", *names], rows)


def _number(value: float | None) -> str:
    return ABSENT if value is None else f"{value:.0f}"
