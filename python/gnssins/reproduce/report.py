"""What a reproduction says: claims with their verdicts, tables, figures, and the folder that holds them.

A claim sets a figure of ours against the one that was wanted and the one that was published. A claim that is missed is
a result like any other: it is told, with the reason, and nothing fails.
"""

from __future__ import annotations

import csv
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from gnssins.analysis import text
from gnssins.errors import ConfigError
from gnssins.outputs import make_folder, refuse_inputs, refuse_no_folder
from gnssins.reproduce.claim import Claim, Sense, plain
from gnssins.reproduce.job import Job, Publication
from gnssins.runner import versions
from gnssins.storage import write_atomic

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Cell", "Claim", "Job", "Publication", "Reproduction", "Sense", "Table"]

#: Version of the layout of ``summary.json``.
FORMAT: Final = 1

SUMMARY_FILE: Final = "summary.json"
REPORT_FILE: Final = "report.txt"

_NAME = re.compile(r"[a-z0-9][a-z0-9_.-]*")

#: Content of a table: numbers keep all digits in the CSV file; None is unknown.
Cell = str | float | int | None


def _unique(columns: Sequence[str]) -> list[str]:
    """Names that a reader of tables can tell apart: an empty one gets its number, a repeated one a counter."""
    seen: Counter[str] = Counter()
    names = []
    for number, column in enumerate(columns, start=1):
        name = column or f"column_{number}"
        seen[name] += 1
        names.append(name if seen[name] == 1 else f"{name} ({seen[name]})")
    return names


@dataclass(frozen=True)
class Table:
    """A table of a reproduction: text for the reader, CSV with all digits.

    Parameters
    ----------
    name : str
        Name of the file without its suffix; lower case, unique in a reproduction.
    title : str
        Line above it.
    columns : sequence of str
        Titles, with units.
    rows : sequence of sequences
        As many cells per row as there are columns.
    note : str
        Line below it.
    """

    name: str
    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    note: str = ""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.name}: {len(row)} cells for {len(self.columns)} columns")

    def text(self) -> str:
        """Lay it out for a terminal; columns of words to the left."""
        words = [i for i in range(len(self.columns)) if any(isinstance(row[i], str) for row in self.rows)]
        return text.table(
            self.title,
            list(self.columns),
            [[_shown(cell) for cell in row] for row in self.rows],
            self.note,
            left=words,
        )

    def write_csv(self, path: Path) -> None:
        """Write it with all digits, unknown cells empty."""
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(_unique(self.columns))
            for row in self.rows:
                writer.writerow(["" if plain(cell) is None else cell for cell in row])

    def to_dict(self) -> dict[str, Any]:
        """Name, title, columns, rows, note."""
        return {
            "name": self.name,
            "title": self.title,
            "columns": list(self.columns),
            "rows": [[plain(cell) for cell in row] for row in self.rows],
            "note": self.note,
        }


@dataclass(frozen=True, eq=False)
class Reproduction:
    """A published experiment, repeated.

    Parameters
    ----------
    name : str
        Of the publication, as in :data:`gnssins.reproduce.PUBLICATIONS`.
    title : str
        Of the experiment.
    runs, seed : int
        Number of Monte Carlo runs and their seed.
    claims : sequence of Claim
        One per published or wanted figure.
    tables : sequence of Table
        Each becomes ``<name>.csv``.
    figures : mapping of str to matplotlib Figure
        Each becomes ``<key>.png``.
    inputs : sequence of Path
        Files that were read; none of them is ever written over.
    """

    name: str
    title: str
    runs: int
    seed: int
    claims: Sequence[Claim]
    tables: Sequence[Table] = ()
    figures: Mapping[str, Figure] = field(default_factory=dict)
    inputs: Sequence[Path] = ()

    def __post_init__(self) -> None:
        keys = [claim.key for claim in self.claims]
        files = [table.name for table in self.tables]
        for names in (keys, files):
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise ValueError(f"{self.name}: more than one {', '.join(twice)}")
        for name in (*files, *self.figures):
            if not _NAME.fullmatch(name):
                raise ValueError(f'{self.name}: "{name}" cannot be the name of a file')

    def __getitem__(self, key: str) -> Claim:
        """The claim of a key."""
        return next(claim for claim in self.claims if claim.key == key)

    @property
    def missed(self) -> tuple[Claim, ...]:
        """Claims that were judged and not met."""
        return tuple(claim for claim in self.claims if claim.judged and not claim.met)

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the files that :meth:`write` makes, the summary last."""
        tables = [f"{table.name}.csv" for table in self.tables]
        return (*tables, *(f"{key}.png" for key in self.figures), REPORT_FILE, SUMMARY_FILE)

    def outcome(self) -> str:
        """How many claims are met, in one sentence that hides nothing."""
        judged = [claim for claim in self.claims if claim.judged]
        better = sum(claim.verdict.startswith("better") for claim in judged)
        missed = len(self.missed)
        met = f"{len(judged) - missed} of {len(judged)} claims reached"
        if better:
            met += f", {better} of them better than wanted"
        if not missed:
            return met
        names = ", ".join(claim.key for claim in self.missed)
        return f"{met}; {missed} MISSED: {names}"

    def text(self) -> str:
        """Everything as text: the tables, the figures of the claims, one line per claim, the outcome."""
        head = f"{self.title}\n{self.name}: {self.runs} run{'s' if self.runs != 1 else ''}, seed {self.seed}"
        parts = [head, *(table.text() for table in self.tables)]
        figures = self._figures()
        if figures is not None:
            parts.append(figures.text())
        lines = [claim.line() for claim in self.claims]
        parts.append("\n".join(["Claims", *(f"  {line}" for line in lines), "", self.outcome()]))
        return "\n\n".join(parts)

    def _figures(self) -> Table | None:
        """Median, 95 % and the filter's own sigma of the claims that have any of them."""
        rows = [
            [c.text, c.unit, c.published, c.ours, c.median, c.p95, c.sigma, c.chi_square]
            for c in self.claims
            if any(value is not None for value in (c.sigma, c.median, c.p95)) or c.chi_square
        ]
        columns = ["", "unit", "published", "ours", "median", "95 %", "filter's sigma", "chi-square"]
        return Table("claims", "The figures behind the claims", columns, rows) if rows else None

    def to_dict(self) -> dict[str, Any]:
        """What ``summary.json`` holds; the same runs and seed give the same on one machine."""
        return {
            "format": FORMAT,
            "name": self.name,
            "title": self.title,
            "runs": self.runs,
            "seed": self.seed,
            "versions": versions(),
            "outcome": {
                "judged": sum(claim.judged for claim in self.claims),
                "missed": [claim.key for claim in self.missed],
                "text": self.outcome(),
            },
            "claims": [claim.to_dict() for claim in self.claims],
            "tables": [table.to_dict() for table in self.tables],
            "files": list(self.files),
        }

    def write(self, out: str | Path) -> list[str]:
        """Write tables, figures, ``report.txt`` and ``summary.json`` (last) into a folder, made if absent.

        Figures and tables that an earlier reproduction left there go first.

        Returns
        -------
        list of str
            The files.

        Raises
        ------
        ConfigError
            The folder is a file, a file to be written was an input, or ``summary.json`` there is somebody else's.
        """
        from gnssins.plots.style import save

        folder = Path(out)
        refuse_foreign(folder)
        refuse_inputs([folder / name for name in self.files], self.inputs)
        make_folder(folder)
        _clear(folder, self.inputs)
        for table in self.tables:
            write_atomic(folder / f"{table.name}.csv", table.write_csv)
        for key, figure in self.figures.items():
            save(figure, folder / f"{key}.png", dpi=110)
        report = f"{self.text()}\n"
        write_atomic(folder / REPORT_FILE, lambda path: path.write_text(report, encoding="utf-8"))
        summary = json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
        write_atomic(folder / SUMMARY_FILE, lambda path: path.write_text(summary, encoding="utf-8"))
        return [str(folder / name) for name in self.files]


def refuse_foreign(folder: Path) -> None:
    """Raise a :class:`ConfigError` if ``folder`` is a file or has a ``summary.json`` that is not of a reproduction."""
    refuse_no_folder(folder)
    path = folder / SUMMARY_FILE
    if path.exists() and _summary(path) is None:
        raise ConfigError(
            "config.output_foreign",
            f"{path}: was not written by gnssins reproduce and would be lost",
            "name another folder with --out",
            {"file": str(path)},
        )


def refuse_others(folder: Path) -> None:
    """Raise a :class:`ConfigError` if ``folder`` has tables or figures, and no reproduction that could be theirs.

    Names of tables and figures are known only when everything is computed; one of somebody else's could be among them.
    """
    if not folder.is_dir() or (folder / SUMMARY_FILE).exists():
        return
    others = sorted(path.name for path in folder.iterdir() if path.name.endswith((".csv", ".png", ".txt")))
    if others:
        raise ConfigError(
            "config.output_foreign",
            f"{folder}: has {len(others)} tables, figures or texts that are of no reproduction (such as {others[0]}) "
            "and could be written over",
            "name a new folder with --out",
            {"files": others},
        )


def _summary(path: Path) -> dict[str, Any] | None:
    """A summary that a reproduction wrote, or None."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    keys = {"format", "name", "claims", "files"}
    return found if isinstance(found, dict) and keys <= set(found) else None


def _clear(folder: Path, inputs: Sequence[Path]) -> None:
    """Remove the files that the summary in ``folder`` lists, the summary first."""
    path = folder / SUMMARY_FILE
    found = _summary(path) if path.is_file() else None
    if found is None:
        return
    names = [name for name in found["files"] if isinstance(name, str)]
    old = [
        folder / name for name in names if _NAME.fullmatch(name) and name.endswith((".csv", ".png", ".txt"))
    ]
    refuse_inputs(old, inputs)
    path.unlink()
    for file in old:
        file.unlink(missing_ok=True)


def _shown(cell: Cell) -> str:
    if cell is None:
        return "-"
    if isinstance(cell, str):
        return cell
    return str(cell) if isinstance(cell, int) else text.number(float(cell))
