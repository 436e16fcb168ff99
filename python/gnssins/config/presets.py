"""Published filters as the compiled core knows them; there is no second copy of their data in Python."""

from __future__ import annotations

import difflib
import json
from functools import cache
from typing import Any

from .. import _core
from .base import invalid


def preset_names() -> list[str]:
    """Names of all presets, in the order of the core."""
    return list(_core.preset_names())


@cache
def _preset_text(name: str) -> str:
    return _core.preset_json(name)


def load_preset(name: str | None) -> dict[str, Any]:
    """Engine configuration of a preset, SI units; empty for None.

    Parameters
    ----------
    name : str or None
        One of :func:`preset_names`.

    Returns
    -------
    dict
        A fresh copy that the caller may change.
    """
    if name is None:
        return {}
    preset: dict[str, Any] = json.loads(_preset_text(name))
    return preset


def check_preset(name: str) -> str:
    """Refuse an unknown preset with the nearest known name."""
    names = preset_names()
    if name not in names:
        near = difflib.get_close_matches(name, names, n=1, cutoff=0.4)
        raise invalid(
            "config.preset",
            f"is not a preset; known: {', '.join(names)}",
            f'nearest: "{near[0]}"' if near else "",
        )
    return name
