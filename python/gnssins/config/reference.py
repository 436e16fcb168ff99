"""The commented list of all configuration keys, made from the models themselves."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

import tomlkit
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from .root import Config
from .schema import find_model, has_plain_form, is_list

_WIDTH = 88
_HEAD = """\
# gnssins configuration: all keys. A key that stands here with a value has that default;
# a key behind '#' has no default, and its value is an example.
"""


def render_reference() -> str:
    """Write a TOML text with every key: its meaning, unit, choices, default or example.

    Returns
    -------
    str
        Valid TOML; keys without a default are commented out.
    """
    return "\n".join([_HEAD.rstrip(), *_table(Config, ())]) + "\n"


def _table(model: type[BaseModel], path: tuple[str, ...]) -> Iterator[str]:
    tables = []
    for key, field in model.model_fields.items():
        inner = find_model(field.annotation)
        if inner is not None and not has_plain_form(model, key):
            tables.append((key, inner, is_list(model, key)))
            continue
        yield ""
        yield from _key(key, field)
    for key, inner, many in tables:
        name = ".".join((*path, key))
        yield ""
        yield from _comment(_summary(inner))
        yield f"# [[{name}]]" if many else f"[{name}]"
        lines = _table(inner, (*path, key))
        yield from (_commented(line) for line in lines) if many else lines


def _key(key: str, field: FieldInfo) -> Iterator[str]:
    allowed = _choices(field.annotation)
    text = field.description or ""
    yield from _comment(f"{text}. One of: {', '.join(allowed)}" if len(allowed) > 1 else text)
    if field.default is None or field.is_required():
        example = field.examples[0] if field.examples else (allowed or ["..."])[0].strip('"')
        yield f"# {key} = {_toml(example)}"
    else:
        yield f"{key} = {_toml(field.default)}"


def _summary(model: type[BaseModel]) -> str:
    return " ".join((model.__doc__ or "").split())


def _comment(text: str) -> list[str]:
    return textwrap.wrap(text, _WIDTH, initial_indent="# ", subsequent_indent="#   ", break_on_hyphens=False)


def _commented(line: str) -> str:
    return line if not line or line.startswith("#") else f"# {line}"


def _choices(annotation: object) -> list[str]:
    if get_origin(annotation) is Literal:
        return [_toml(value) for value in get_args(annotation)]
    return [name for inner in get_args(annotation) for name in _choices(inner)]


def _toml(value: Any) -> str:
    if isinstance(value, tuple):
        value = [list(row) if isinstance(row, tuple) else row for row in value]
    return str(tomlkit.item(value).as_string())
