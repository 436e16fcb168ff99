"""Typed errors: one base class, a stable code, a message that says what, where and how many, and the remedy.

Every error that a user can cause is a :class:`GnssinsError`. Its text is::

    TimeOrderError [time.backwards] imu.csv row 48213: t = 456312.480 s after 456312.485 s (-5 ms), 3 such
    rows
      hint: set [imu] on_backwards = "sort" or "drop", or check the logger's clock

Programs look at :attr:`GnssinsError.code` and :attr:`GnssinsError.context`, never at the text. The first word
of the code names the family and fixes the class; :func:`from_core` uses that to raise the errors of the
compiled core.
"""

from __future__ import annotations

import errno
from collections.abc import Mapping

__all__ = [
    "ConfigError",
    "CovarianceError",
    "DataQualityError",
    "GapError",
    "GnssinsError",
    "InputError",
    "MissingFileError",
    "NavigationError",
    "StateError",
    "TimeOrderError",
    "from_core",
]


class GnssinsError(Exception):
    """Base of every error that gnssins raises on purpose.

    Parameters
    ----------
    code : str
        Stable machine name such as ``"time.backwards"``.
    message : str
        What happened, where and how many times; one line, no full stop.
    hint : str, optional
        What the user can do about it.
    context : Mapping, optional
        The facts behind the message (file, row, column, value, ...), for programs.
    """

    def __init__(
        self, code: str, message: str, hint: str = "", context: Mapping[str, object] | None = None
    ) -> None:
        super().__init__(code, message)
        self.code = code
        self.message = message
        self.hint = hint
        self.context: dict[str, object] = dict(context or {})

    def __str__(self) -> str:
        text = f"{type(self).__name__} [{self.code}] {self.message}"
        return f"{text}\n  hint: {self.hint}" if self.hint else text

    def __reduce__(self) -> tuple[object, ...]:
        """Keep code, hint and context when the error crosses a process boundary."""
        return type(self), (self.code, self.message, self.hint, self.context)


class ConfigError(GnssinsError):
    """The configuration is wrong: unknown key, unit, range, or a combination that means nothing."""


class InputError(GnssinsError):
    """An input file cannot be read as configured: format, column, cell, unit."""


class MissingFileError(InputError, FileNotFoundError):
    """An input file does not exist; also a :class:`FileNotFoundError`."""

    def __init__(
        self, code: str, message: str, hint: str = "", context: Mapping[str, object] | None = None
    ) -> None:
        super().__init__(code, message, hint, context)
        self.errno = errno.ENOENT
        self.filename = self.context.get("file")


class TimeOrderError(GnssinsError):
    """Time stamps go backwards or repeat."""


class GapError(GnssinsError):
    """The IMU stream has a gap longer than the configured limit."""


class CovarianceError(GnssinsError):
    """A covariance is not positive definite or not finite."""


class DataQualityError(GnssinsError):
    """The data are readable but cannot be meant like that: units, axes, too many bad rows."""


class StateError(GnssinsError):
    """The filter state is unusable: wrong saved state, call before the initial state, non-finite state."""


class NavigationError(GnssinsError):
    """The navigation model does not hold here, such as NED mechanisation next to a pole."""


_FAMILIES: dict[str, type[GnssinsError]] = {
    "config": ConfigError,
    "input": InputError,
    "time": TimeOrderError,
    "gap": GapError,
    "cov": CovarianceError,
    "data": DataQualityError,
    "state": StateError,
    "nav": NavigationError,
}


def from_core(
    code: str, message: str, hint: str = "", context: Mapping[str, object] | None = None
) -> GnssinsError:
    """Build the error of the class that the first word of ``code`` names.

    Parameters
    ----------
    code : str
        ``"family.detail"``; an unknown family gives the base class, never a second failure.
    message, hint : str
        As in :class:`GnssinsError`.
    context : Mapping, optional
        As in :class:`GnssinsError`.

    Returns
    -------
    GnssinsError
        Ready to raise.
    """
    family = code.partition(".")[0]
    return _FAMILIES.get(family, GnssinsError)(code, message, hint, context)
