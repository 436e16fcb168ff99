"""What the commands show: text or JSON on stdout, progress and messages on stderr."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

__all__ = ["heading", "message", "plain", "progress", "put", "put_json"]


def put(text: str = "") -> None:
    """Write a line to stdout."""
    sys.stdout.write(f"{text}\n")


def heading(text: str) -> None:
    """Write a title to stdout, bold where colours are wanted (terminal, NO_COLOR not set)."""
    from rich.console import Console
    from rich.text import Text

    Console(soft_wrap=True, highlight=False).print(Text(f"\n{text}", style="bold"))


def put_json(value: Mapping[str, Any]) -> None:
    """Write one JSON document to stdout; a number that is not finite becomes null."""
    put(json.dumps(plain(value), indent=2, ensure_ascii=False))


def message(text: str, style: str = "") -> None:
    """Write a line to stderr."""
    from rich.console import Console
    from rich.text import Text

    Console(stderr=True, soft_wrap=True, highlight=False).print(Text(text, style=style))


@contextmanager
def progress(text: str) -> Iterator[Callable[[float], None] | None]:
    """Show a bar on stderr while the block runs; nothing at all when stderr is no terminal.

    Yields
    ------
    callable or None
        To be called with the share that is done.
    """
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task(text, total=1.0)
        yield lambda share: bars.update(task, completed=share)


def plain(value: Any) -> Any:
    """Take a value apart into what JSON knows; a number that is not finite becomes None."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, str | int | float | bool | None) else str(value)
