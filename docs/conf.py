"""Sphinx configuration: MyST pages, numpydoc API reference. Generated parts of pages: docs/generate.py."""

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
exclude_patterns = ["_build", "publications/*-filter.md"]  # a part of another page
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
