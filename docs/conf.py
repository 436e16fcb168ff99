"""Sphinx configuration: MyST pages, numpydoc API reference, pages made from the code they describe."""

import os
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import version as installed_version

project = "gnssins"
author = "The gnssins authors"
copyright = "2026, The gnssins authors"
release = installed_version("gnssins")
version = release

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx-mathjax-offline",
    "numpydoc",
]
exclude_patterns = ["_build"]
templates_path: list[str] = []
nitpicky = False
root_doc = "index"

myst_enable_extensions = ["amsmath", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "none"
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

html_theme = "furo"
html_title = f"gnssins {release}"
html_show_sphinx = False


def _configuration() -> str:
    from gnssins.config import render_reference

    return render_reference()


def _command_line() -> str:
    parts = []
    for command in ("", "demo", "simulate", "run", "compare"):
        words = [sys.executable, "-m", "gnssins", *command.split(), "--help"]
        environment = os.environ | {"NO_COLOR": "1", "TERM": "dumb", "COLUMNS": "100"}
        text = subprocess.run(words, check=True, capture_output=True, text=True, env=environment).stdout
        text = text.replace("python -m gnssins", "gnssins").strip("\n")
        lines = "\n".join(line.rstrip() for line in text.splitlines())
        parts.append(f"## gnssins {command}".rstrip() + f"\n\n```text\n{lines}\n```")
    return "\n\n".join(parts)


#: Markers in pages, and the functions that make what stands there.
_GENERATED: dict[str, tuple[str, Callable[[], str]]] = {
    "reference/configuration": ("@configuration@", _configuration),
    "reference/command-line": ("@command-line@", _command_line),
}


def _fill_in(_app: object, page: str, source: list[str]) -> None:
    if page in _GENERATED:
        marker, make = _GENERATED[page]
        source[0] = source[0].replace(marker, make())


def setup(app):
    """Fill in the generated parts as pages are read."""
    app.connect("source-read", _fill_in)
