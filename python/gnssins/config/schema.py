"""Questions about the configuration models: their tables, the keys of each, how a place is written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import get_args, get_origin

from pydantic import BaseModel

Loc = Sequence[int | str]
"""A place in nested tables: keys, and indices of list items."""

Model = type[BaseModel]


def table_of(model: Model | None, key: int | str) -> Model | None:
    """Model class of the table under a key; None if the key holds a value or is unknown."""
    if model is None or isinstance(key, int) or key not in model.model_fields:
        return None
    return find_model(model.model_fields[key].annotation)


def find_model(annotation: object) -> Model | None:
    """First model class inside a type annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for inner in get_args(annotation) if (found := find_model(inner))), None)


def is_list(model: Model | None, key: int | str) -> bool:
    """Tell whether the key holds a list of tables or values."""
    if model is None or isinstance(key, int) or key not in model.model_fields:
        return False
    return get_origin(model.model_fields[key].annotation) is tuple


def has_plain_form(model: Model | None, key: int | str) -> bool:
    """Tell a key whose table is only one of its forms, such as a position."""
    if model is None or isinstance(key, int) or key not in model.model_fields:
        return False
    return isinstance(model.model_fields[key].default, str)


def table_at(loc: Loc, root: Model) -> Model | None:
    """Model class of the table at a place; None if the place is no table."""
    table: Model | None = root
    for part in loc:
        if isinstance(part, str):
            table = table_of(table, part)
    return table


def tables(root: Model, prefix: str = "") -> Iterator[tuple[str, list[str]]]:
    """All tables with their keys, outermost first, each written as in the file: ``[imu.gyro]``."""
    for name in root.model_fields:
        model = table_of(root, name)
        if model is not None:
            path = f"{prefix}{name}"
            yield f"[[{path}]]" if is_list(root, name) else f"[{path}]", list(model.model_fields)
            yield from tables(model, f"{path}.")


def place(loc: Loc, root: Model) -> str:
    """Write a place the way it stands in the file.

    Parameters
    ----------
    loc : sequence of str or int
        Keys from the outermost table inwards, with indices of list items.
    root : type
        Model class of the whole configuration.

    Returns
    -------
    str
        Such as ``[imu.gyro] range_deg_s``, ``[[filter.block]] #2 unit`` or ``[gnss] lever_ba_b_m[0]``.
    """
    names: list[str] = []
    rest = list(loc)
    table: Model | None = root
    many = False
    while rest and isinstance(rest[0], str) and table_of(table, rest[0]) is not None and not many:
        if len(rest) == 1 and has_plain_form(table, rest[0]):
            break
        name = rest.pop(0)
        many = is_list(table, name)
        table = table_of(table, name)
        names.append(str(name))
    text = ""
    if names:
        path = ".".join(names)
        text = f"[[{path}]]" if many else f"[{path}]"
    if many and rest and isinstance(rest[0], int):
        text += f" #{int(rest.pop(0)) + 1}"
    for index, part in enumerate(rest):
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += f" {part}" if index == 0 else f".{part}"
    return text.strip()
