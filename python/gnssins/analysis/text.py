"""Plain-text tables, the same on a terminal, in a file and in a notebook."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Sequence

from rich import box
from rich.console import Console
from rich.table import Table

__all__ = ["number", "table"]


def table(
    title: str,
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    caption: str = "",
    left: Sequence[int] = (0,),
) -> str:
    """Lay out a table as text; numbers to the right.

    Parameters
    ----------
    title : str
        Line above the table; none when empty.
    header : sequence of str
        Column titles.
    rows : iterable of sequences of str
        Cells, as many per row as there are titles.
    caption : str
        Line below the table; none when empty.
    left : sequence of int
        Columns of words, set to the left.

    Returns
    -------
    str
        Lines without colour codes and without a line feed at the end.
    """
    grid = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for i, name in enumerate(header):
        grid.add_column(name, justify="left" if i in left else "right", no_wrap=True)
    for row in rows:
        grid.add_row(*row)
    stream = io.StringIO()
    Console(file=stream, width=200, color_system=None, markup=False, highlight=False).print(grid)
    lines = [line.rstrip() for line in stream.getvalue().splitlines()]
    return "\n".join([*([title] if title else []), *lines, *([caption] if caption else [])]).rstrip()


def number(value: float, figures: int = 3) -> str:
    """Format with so many significant figures and no exponent where that stays readable; ``-`` for NaN."""
    if not math.isfinite(value):
        return "-"
    if value == 0.0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if exponent < -5 or exponent > 6:
        return f"{value:.{figures - 1}e}"
    return f"{value:.{max(figures - 1 - exponent, 0)}f}"
