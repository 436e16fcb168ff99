"""What all tables with a time column share: stamps, rates, and the check of each array on the way in."""

from __future__ import annotations

from copy import copy
from typing import Any, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError
from .units import NS_PER_S

Array = NDArray[np.float64]
Times = NDArray[np.int64]
Rows = NDArray[np.bool_] | NDArray[np.intp] | slice
_Scalar = TypeVar("_Scalar", bound=np.generic)


class Timed:
    """What all tables with a time column can tell."""

    t_ns: Times

    def __len__(self) -> int:
        """Return the number of rows."""
        return int(self.t_ns.size)

    @property
    def duration_s(self) -> float:
        """Last stamp minus first stamp, s; 0 for less than two rows."""
        return float(self.t_ns[-1] - self.t_ns[0]) / NS_PER_S if len(self) > 1 else 0.0

    @property
    def interval_s(self) -> float:
        """Median step between stamps, s; NaN for less than two rows."""
        return float(np.median(np.diff(self.t_ns))) / NS_PER_S if len(self) > 1 else float("nan")

    @property
    def rate_hz(self) -> float:
        """Rows per second, from the median step; NaN for less than two rows or a zero step."""
        step = self.interval_s
        return 1.0 / step if step > 0.0 else float("nan")

    def span(self) -> str:
        """Rows, first and last stamp and rate, in words."""
        if not len(self):
            return "empty"
        start, end = self.t_ns[0] / NS_PER_S, self.t_ns[-1] / NS_PER_S
        return f"{len(self)} rows, {start:.3f} to {end:.3f} s, {self.rate_hz:.4g} Hz"

    def _with(self, **columns: NDArray[Any] | None) -> Self:
        """Copy of the table with other columns, made of its own: they need no check and are not copied again."""
        table = copy(self)
        for column in columns.values():
            if column is not None:
                column.setflags(write=False)
        store(table, **columns)
        return table


def store(table: object, **values: object) -> None:
    """Store a checked array in a frozen dataclass."""
    for name, value in values.items():
        object.__setattr__(table, name, value)


def times(values: ArrayLike, table: str) -> Times:
    """Copy a column of stamps; whole numbers only."""
    array = np.array(values)
    if array.size and array.dtype.kind not in "iu":
        raise InputError(
            "input.dtype",
            f"{table} t_ns has dtype {array.dtype}, needs whole nanoseconds (int64)",
            "convert without a float in between: at 1e9 s a float64 resolves only 0.1 us",
        )
    return frozen(array.astype(np.int64), (array.size,), table, "t_ns")


def floats(values: ArrayLike, shape: tuple[int, ...], table: str, name: str) -> Array:
    """Copy an array of numbers to contiguous float64 of a given shape."""
    try:
        array = np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError) as failure:
        raise InputError(
            "input.dtype", f"{table} {name} is not numeric: {failure}", "give an array of floats"
        ) from None
    return frozen(array, shape, table, name)


def marks(values: ArrayLike, shape: tuple[int, ...], table: str, name: str) -> NDArray[np.bool_]:
    """Copy a column of marks; numbers are not taken for marks."""
    array = np.array(values)
    if array.size and array.dtype.kind != "b":
        raise InputError(
            "input.dtype",
            f"{table} {name} has dtype {array.dtype}, needs bool",
            f"compare with a number first, such as {name} != 0",
        )
    return frozen(array.astype(np.bool_), shape, table, name)


def frozen(array: NDArray[_Scalar], shape: tuple[int, ...], table: str, name: str) -> NDArray[_Scalar]:
    """Refuse a wrong shape, and make the array read-only."""
    if array.shape != shape:
        raise InputError(
            "input.shape",
            f"{table} {name} has shape {array.shape}, needs {shape}",
            "one row per epoch, one column per component",
            {"table": table, "name": name, "shape": array.shape},
        )
    array.setflags(write=False)
    return array
