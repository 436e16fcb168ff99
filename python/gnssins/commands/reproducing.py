"""``gnssins reproduce``: published experiments, repeated and held against their publication."""

from __future__ import annotations

import time
from pathlib import Path

from gnssins.analysis.text import table
from gnssins.reproduce import publication, publications
from gnssins.reproduce import reproduce as repeat
from gnssins.terminal import heading, progress, put, put_json

__all__ = ["list_publications", "reproduce"]


def list_publications(as_json: bool) -> None:
    """``gnssins reproduce --list``."""
    found = publications()
    if as_json:
        rows = [
            {"name": name, "available": False}
            if each is None
            else {
                "name": name,
                "available": True,
                "title": each.title,
                "summary": each.summary,
                "runs": each.runs,
                "seed": each.seed,
            }
            for name, each in found.items()
        ]
        put_json({"publications": rows})
        return
    cells = [
        [name, "-", "not in this version"] if each is None else [name, str(each.runs), each.summary]
        for name, each in found.items()
    ]
    put(table("", ["publication", "runs", "what is repeated"], cells, left=(0, 2)))


def reproduce(
    name: str, runs: int | None, seed: int | None, jobs: int | None, out: Path | None, as_json: bool
) -> None:
    """``gnssins reproduce``."""
    publication(name)  # an unknown name is told before the bar shows
    folder = out if out is not None else Path(f"{name}-reproduction")
    clock = time.perf_counter()
    with progress(name) as bar:
        report = repeat(name, runs, seed, jobs, folder, bar)
    files = [str(folder / file) for file in report.files]
    wall_s = time.perf_counter() - clock
    if as_json:
        put_json({**report.to_dict(), "out": str(folder), "files": files, "wall_s": wall_s})
        return
    put(report.text())
    heading("Written")
    put("\n".join(f"  {file}" for file in files))
    put(f"{wall_s:.0f} s")
