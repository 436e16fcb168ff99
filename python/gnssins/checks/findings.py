"""What a check says, and how a stop becomes an error."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from ..errors import DataQualityError

Level = Literal["info", "warn", "stop"]
LEVELS: tuple[Level, ...] = ("stop", "warn", "info")
"""Levels, gravest first."""


@dataclass(frozen=True)
class Finding:
    """One thing that a look at the data has found.

    Attributes
    ----------
    level : {"info", "warn", "stop"}
        info: worth knowing; warn: probably not meant; stop: a run would be worthless.
    code : str
        Stable name such as ``"data.accel_unit"``.
    message : str
        What, where and how many.
    hint : str
        What to do about it.
    count : int
        Number of rows, windows or pairs behind the finding.
    """

    level: Level
    code: str
    message: str
    hint: str = ""
    count: int = 0

    def __str__(self) -> str:
        text = f"{self.level} [{self.code}] {self.message}"
        return f"{text}\n  hint: {self.hint}" if self.hint else text


def raise_on_stop(findings: Iterable[Finding]) -> None:
    """Raise the stops among the findings as one error; do nothing if there are none.

    Parameters
    ----------
    findings : iterable of Finding
        As :func:`gnssins.checks.check_dataset` returns them.

    Raises
    ------
    DataQualityError
        With the code and hint of the first stop, and all of them in the message.
    """
    stops = [finding for finding in findings if finding.level == "stop"]
    if stops:
        message = "; ".join(stop.message for stop in stops)
        codes = [stop.code for stop in stops]
        raise DataQualityError(stops[0].code, message, stops[0].hint, {"codes": codes})
