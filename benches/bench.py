"""Writes ``benches/RESULTS.md``: what ``cargo bench`` measured, and whole runs from Python beside other packages.

``make bench`` runs it with everything it needs; ``make bench-counts`` only counts instructions.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
from pathlib import Path

from engine import count, criterion, show
from report import ABSENT, Report

HEAD = """\
# Measured speed

Written by `make bench` in one run on the machine below; nothing here is edited by hand. Times are medians, spreads are
median deviations. What is measured, and how to read it: [docs/reference/speed.md](../docs/reference/speed.md).
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--criterion", type=Path, help="folder in which Criterion keeps its estimates")
    parser.add_argument("--counts", type=Path, required=True, help="program of benches/counts.rs")
    parser.add_argument("--others", type=Path, help="Python with the packages to compare with")
    parser.add_argument("--out", type=Path, help="page to write")
    given = parser.parse_args()
    report = Report()
    counts = count(given.counts)
    if given.out is None:
        _print_counts(counts)
        return
    times = criterion(given.criterion)
    if not times:
        parser.error(f"{given.criterion} holds no estimates: run cargo bench first")
    show(report, times, counts)

    import runs

    hour = runs.flight(runs.HOUR_S)
    whole = runs.show_runs(report, hour, times)
    runs.show_streaming(report, hour)
    runs.show_monte_carlo(report)
    runs.show_others(report, given.others, hour, whole)
    report.section("Where others are faster")
    report.lines += [f"- {loss}" for loss in report.losses] or ["Nowhere in this run."]
    text = "\n".join([HEAD, *_machine(given.others), *report.lines]).rstrip() + "\n"
    given.out.write_text(text, encoding="utf-8")
    print(text)


def _print_counts(counts: dict[tuple[str, str, int], float] | None) -> None:
    if counts is None:
        print("instructions are not counted: valgrind is not installed (Linux: apt install valgrind)")
        return
    for (part, variant, states), value in counts.items():
        print(f"{f'{part}/{variant}/{states}':24} {value:10.0f} instructions")


def _machine(others: Path) -> list[str]:
    """What it was measured on, and with which versions."""
    import numpy as np

    import gnssins

    rows = [
        ["processor", _processor()],
        ["cores", str(os.cpu_count())],
        ["system", f"{platform.system()} {platform.machine()}"],
        ["rustc", _line("rustc", "--version").removeprefix("rustc ")],
        ["Python", platform.python_version()],
        ["gnssins, numpy", f"{gnssins.__version__}, {np.__version__}"],
        ["Python of the others", _line(str(others), "--version").removeprefix("Python ")],
    ]
    page = Report()
    page.section("Machine")
    page.table(["", ""], rows)
    return page.lines


def _processor() -> str:
    file = Path("/proc/cpuinfo")
    if file.exists():
        lines = file.read_text(encoding="utf-8").splitlines()
        fields = dict(line.split("\t: ", 1) for line in lines if "\t: " in line)
        if "model name" in fields:
            return fields["model name"]
    return platform.processor() or platform.machine()


def _line(*command: str) -> str:
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ABSENT


if __name__ == "__main__":
    main()
