"""From pydantic's findings to one :class:`ConfigError` that names every key, value and remedy."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ValidationError

from ..errors import ConfigError
from .base import PROBLEMS, Problem
from .schema import Loc, Model, place, table_at, tables

_DETAILED = 8
"""Number of problems that are told with their hint; the rest is listed by key."""

_LIMITS = {
    "greater_than": ("gt", ">"),
    "greater_than_equal": ("ge", ">="),
    "less_than": ("lt", "<"),
    "less_than_equal": ("le", "<="),
}
_TYPES = {
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "string_type": "must be a text in quotes",
    "path_type": "must be a file name in quotes",
    "finite_number": "must be a finite number",
    "tuple_type": "must be a list",
}


@dataclass(frozen=True)
class _Told:
    """A problem with its place and value, ready to print."""

    path: str
    problem: Problem
    value: str

    def line(self) -> str:
        shown = f"{self.path} = {self.value}" if self.value else self.path
        return f"{shown}: {self.problem.text}" if shown else self.problem.text

    def facts(self) -> dict[str, str]:
        problem = self.problem
        return {
            "path": self.path,
            "value": self.value,
            "code": problem.code,
            "text": problem.text,
            "hint": problem.hint,
        }


def config_error(failure: ValidationError, root: Model, source: str) -> ConfigError:
    """Translate all findings of one validation.

    Parameters
    ----------
    failure : pydantic.ValidationError
        The findings.
    root : type
        Model class of the whole configuration, to find the known keys of each table.
    source : str
        Name of the file, or what stands for it in the message.

    Returns
    -------
    ConfigError
        Its code is that of the first problem; ``context["problems"]`` holds all of them.
    """
    told = [one for error in failure.errors(include_url=False) for one in _tell(dict(error), root)]
    context: dict[str, object] = {"file": source, "problems": [one.facts() for one in told]}
    first = told[0].problem
    if len(told) == 1:
        return ConfigError(first.code, f"{source}: {told[0].line()}", first.hint, context)
    lines = [f"{source}: {len(told)} problems"]
    for one in told[:_DETAILED]:
        lines.append(f"  - {one.line()}" + (f" ({one.problem.hint})" if one.problem.hint else ""))
    if len(told) > _DETAILED:
        lines.append(f"  - and at {', '.join(one.path for one in told[_DETAILED:])}")
    return ConfigError(first.code, "\n".join(lines), "correct the keys above", context)


def _tell(error: Mapping[str, Any], root: Model) -> Iterator[_Told]:
    loc, kind, value = _keys_only(error["loc"], root), error["type"], error["input"]
    if kind == PROBLEMS:
        for problem in error["ctx"][PROBLEMS]:
            inner = [int(part) if part.isdigit() else part for part in problem.key.split(".") if part]
            yield _Told(place([*loc, *inner], root), problem, _shown(_lookup(value, inner)))
        return
    shown = "" if kind == "missing" else _shown(value)
    yield _Told(place(loc, root), _plain(kind, error, loc, root), shown)


def _plain(kind: str, error: Mapping[str, Any], loc: Loc, root: Model) -> Problem:
    context = error.get("ctx", {})
    if kind == "extra_forbidden":
        return _unknown_key(loc, root)
    if kind == "missing":
        return Problem("config.missing_key", "missing", f"add {loc[-1]}")
    if kind == "literal_error":
        return _wrong_choice(context["expected"], error["input"], loc)
    if kind in _LIMITS:
        return Problem("config.range", f"must be {_allowed_range(loc, root, kind, context)}")
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        columns = tuple(loc) in {("imu", "gyro"), ("imu", "accel")}
        hint = f"column names belong to [imu] {loc[-1]}_columns" if columns else ""
        return Problem("config.type", "must be a table of keys, not a single value", hint)
    if kind == "string_pattern_mismatch":
        return Problem("config.type", f"must match the pattern {context['pattern']}")
    return Problem("config.type", _TYPES.get(kind, str(error["msg"]).lower()))


def _allowed_range(loc: Loc, root: Model, kind: str, context: Mapping[str, Any]) -> str:
    """Both ends of the allowed range, from the metadata of the field."""
    attribute, sign = _LIMITS[kind]
    parts = {sign: context[attribute]}
    table = table_at(loc[:-1], root)
    field = table.model_fields.get(str(loc[-1])) if table is not None else None
    for constraint in field.metadata if field is not None else ():
        for name, mark in _LIMITS.values():
            if getattr(constraint, name, None) is not None:
                parts[mark] = getattr(constraint, name)
    return " and ".join(f"{mark} {parts[mark]:g}" for mark in (">", ">=", "<", "<=") if mark in parts)


def _unknown_key(loc: Loc, root: Model) -> Problem:
    key = str(loc[-1])
    table = table_at(loc[:-1], root)
    known = list(table.model_fields) if table is not None else []
    near = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
    elsewhere = [path for path, names in tables(root) if key in names]
    if elsewhere and not near:
        return Problem("config.unknown_key", "unknown key here", f"it belongs to {' or '.join(elsewhere)}")
    hint = f"nearest: {near[0]}" if near else f"known keys here: {', '.join(known)}"
    return Problem("config.unknown_key", "unknown key", hint)


def _wrong_choice(expected: str, value: object, loc: Loc) -> Problem:
    if tuple(loc) == ("version",):
        text = f"this program reads version {expected}"
        return Problem("config.version", text, "see the change log for keys that were renamed")
    names = re.findall(r"'([^']*)'", expected)
    near = difflib.get_close_matches(str(value), names, n=1, cutoff=0.5)
    code = "config.unit" if str(loc[-1]).endswith("unit") else "config.choice"
    allowed = ", ".join(f'"{name}"' for name in names) or expected
    return Problem(code, f"must be one of {allowed}", f'nearest: "{near[0]}"' if near else "")


def _keys_only(loc: Loc, root: Model) -> list[int | str]:
    """Drop the names of union branches and validators that pydantic puts between the keys."""
    keys: list[int | str] = []
    for part in loc:
        table = table_at(keys, root)
        if isinstance(part, int) or not keys or (table is not None and table.__name__ != part):
            keys.append(part)
    return keys


def _lookup(value: Any, keys: Loc) -> Any:
    """Follow keys into nested tables as the user wrote them; None where they end."""
    for key in keys:
        try:
            value = value[key]
        except (KeyError, IndexError, TypeError):
            return None
    return value


def _shown(value: object) -> str:
    """Write a value as TOML would; nothing for tables and absent values."""
    if value is None or isinstance(value, (Mapping, BaseModel)):
        return ""
    text = json.dumps(value, default=str)
    return text if len(text) <= 80 else text[:77] + "..."
