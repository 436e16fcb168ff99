"""Renew figures and tables of the pages of the publications from reproductions.

For each publication::

    gnssins reproduce NAME --out build/NAME
    .venv/bin/python docs/renew_publications.py build/NAME

A page has its text by hand. The claims stand between ``<!-- claims -->`` and ``<!-- end -->``, table X of the
reproduction between ``<!-- table X -->`` and ``<!-- end -->``; in the index the published figures beside ours between
``<!-- NAME -->`` and ``<!-- end -->``. Figures that a page shows (``figures/NAME-KEY.png``) are made small here. All
of it is committed: the runs take minutes, and a clone reads without a build.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

from PIL import Image

from gnssins.analysis.text import number

PAGES = Path(__file__).resolve().parent / "publications"
FIGURES = PAGES / "figures"
END = "<!-- end -->"

#: Largest file of a figure, bytes.
LIMIT = 100_000


def claims(summary: dict[str, Any]) -> str:
    """All claims of a publication, one row each."""
    head = ["claim", "published", "wanted", "ours", "median", "95 %", "filter's σ", "verdict"]
    rows = []
    for claim in summary["claims"]:
        unit = f" {claim['unit']}" if claim["unit"] else ""
        verdict = claim["verdict"] + (f"; {claim['chi_square']}" if claim["chi_square"] else "")
        figures = (claim[key] for key in ("median", "p95", "sigma"))
        rows.append(
            [
                claim["text"],
                _given(claim["published"], unit),
                _wanted(claim),
                _with(claim["ours"], unit),
                *(_number(value) for value in figures),
                f"**{verdict}**" if claim["met"] is False else verdict,
            ]
        )
    notes = "".join(f"* {c['text']}: {c['note']}\n" for c in summary["claims"] if c["note"])
    return f"{_origin(summary)} {summary['outcome']['text']}.\n\n{markdown(head, rows)}\n{notes}"


def published(summary: dict[str, Any]) -> str:
    """Rows of the index: the claims for which the publication gives a figure."""
    rows = [
        [
            claim["text"],
            _given(claim["published"], f" {claim['unit']}" if claim["unit"] else ""),
            _with(claim["ours"], f" {claim['unit']}" if claim["unit"] else ""),
            _wanted(claim),
            claim["verdict"],
        ]
        for claim in summary["claims"]
        if claim["published"] is not None
    ]
    text = f"{_origin(summary)} {summary['outcome']['text']}.\n"
    return text + (
        "\n" + markdown(["claim", "publication", "ours", "wanted", "verdict"], rows) if rows else ""
    )


def table(summary: dict[str, Any], name: str) -> str:
    """One table of the reproduction."""
    found = next(t for t in summary["tables"] if t["name"] == name)
    rows = [[_number(cell) if not isinstance(cell, str) else cell for cell in row] for row in found["rows"]]
    note = f"\n{' '.join(found['note'].split())}\n" if found["note"] else ""
    return f"{found['title']}\n\n{markdown(found['columns'], rows)}{note}"


def markdown(head: list[str], rows: list[list[str]]) -> str:
    """Lay out a table of Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(cell.replace('|', '/') for cell in line)} |\n" for line in lines)


def _origin(summary: dict[str, Any]) -> str:
    return f"`gnssins reproduce {summary['name']}`, {summary['runs']} runs, seed {summary['seed']}:"


def _wanted(claim: dict[str, Any]) -> str:
    if claim["met"] is None:
        return "–"
    if claim["sense"] == "within":
        low, high = claim["low"], claim["high"]
        if low is None or high is None:
            return f"≤ {_given(high)}" if low is None else f"≥ {_given(low)}"
        return f"{_given(low)} .. {_given(high)}"
    if claim["sense"] == "beside":
        return "–"
    wanted = claim["target"] if claim["target"] is not None else claim["published"]
    sign = {"at most": "≤ ", "at least": "≥ ", "equal": ""}[claim["sense"]]
    return "–" if wanted is None else f"{sign}{_given(wanted)}" + _tolerance(claim)


def _tolerance(claim: dict[str, Any]) -> str:
    """Largest deviation that still counts as equal, where a reader of three digits would see it."""
    allowed, wanted = claim["tolerance"], claim["target"] or claim["published"] or 0.0
    shown = f"{allowed:.1g}" if allowed < 10.0 else f"{allowed:.0f}"
    return f" ± {shown}" if claim["sense"] == "equal" and allowed > 1e-3 * abs(wanted) else ""


def _given(value: float | None, unit: str = "") -> str:
    """A figure that somebody has set: as it was given, without digits that nobody has measured."""
    return "–" if value is None else f"{value:.3g}{unit}" if abs(value) < 999.5 else f"{number(value)}{unit}"


def _with(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{_number(value)}{unit}"


def _number(value: float | int | None) -> str:
    if value is None:
        return "–"
    return str(value) if isinstance(value, int) else number(value)


def replaced(text: str, mark: str, content: str) -> str:
    """Put ``content`` between a mark and the next end."""
    head, rest = text.split(f"<!-- {mark} -->", 1)
    return f"{head}<!-- {mark} -->\n\n{content}\n{END}{rest.split(END, 1)[1]}"


def renew(folder: Path) -> None:
    """Renew page, figures and index from one folder of ``gnssins reproduce``."""
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    name = summary["name"]
    page = PAGES / f"{name}.md"
    text = page.read_text(encoding="utf-8")
    for mark in re.findall(r"<!-- (claims|table [a-z0-9_]+) -->", text):
        made = claims(summary) if mark == "claims" else table(summary, mark.split()[1])
        text = replaced(text, mark, made)
    page.write_text(text, encoding="utf-8", newline="\n")
    for key in re.findall(rf"\(figures/{name}-([a-z0-9_.-]+)\.png\)", text):
        shrink(folder / f"{key}.png", FIGURES / f"{name}-{key}.png")
    index = PAGES / "index.md"
    text = index.read_text(encoding="utf-8")
    index.write_text(replaced(text, name, published(summary)), encoding="utf-8", newline="\n")


def shrink(source: Path, target: Path) -> None:
    """Write a picture with a palette, at most 900 pixels wide, and so few colours that it is small."""
    with Image.open(source) as picture:
        flat = picture.convert("RGB")
    width = min(900, flat.width)
    flat = flat.resize((width, round(flat.height * width / flat.width)), Image.Resampling.LANCZOS)
    for colours in (256, 128, 64):
        flat.quantize(colours, Image.Quantize.MAXCOVERAGE).save(target, optimize=True)
        if target.stat().st_size < LIMIT:
            return
    raise SystemExit(f"{target}: {target.stat().st_size} bytes, more than {LIMIT}")


if __name__ == "__main__":
    FIGURES.mkdir(exist_ok=True)
    for argument in sys.argv[1:]:
        renew(Path(argument))
