"""Where to withhold GNSS: windows spread over the part of a recording that the filter can use."""

from __future__ import annotations

import math

from gnssins.errors import ConfigError

__all__ = ["place_windows"]

#: Shortest time with GNSS between two windows, s.
LEAST_BETWEEN_S = 1.0


def place_windows(
    start_s: float,
    end_s: float,
    *,
    length_s: float,
    count: int,
    settle_s: float = 60.0,
    first_s: float | None = None,
    period_s: float | None = None,
) -> tuple[tuple[float, float], ...]:
    """Place ``count`` windows of ``length_s``, evenly, between ``start_s + settle_s`` and ``end_s``.

    Parameters
    ----------
    start_s, end_s : float
        Start of the filter and end of the data, s.
    length_s : float
        Length of a window, s.
    count : int
        Number of windows.
    settle_s : float
        Time that the filter has before the first window, s.
    first_s : float, optional
        Start of the first window instead, s; it may come before the settle time is over.
    period_s : float, optional
        From start to start, s; left out: as long as possible, so that the last window ends with the data.

    Returns
    -------
    tuple of (from, to)
        Ascending; at least 1 s with GNSS in between.

    Raises
    ------
    ConfigError
        ``config.windows``: no such windows. ``config.windows_fit``: they do not fit; the context says how many would.
    """
    numbers = [start_s, end_s, length_s, settle_s, first_s or 0.0, period_s or 1.0]
    if not (all(map(math.isfinite, numbers)) and length_s > 0.0 and count >= 1 and settle_s >= 0.0):
        raise ConfigError(
            "config.windows",
            f"{count} windows of {length_s:g} s after {settle_s:g} s",
            "length and count are positive, the settle time is not negative",
        )
    begin = start_s + settle_s if first_s is None else first_s
    least = length_s + LEAST_BETWEEN_S
    if first_s is not None and first_s < start_s:
        raise ConfigError(
            "config.windows_fit",
            f"the first window starts at {first_s:g} s, before the filter, which starts at {start_s:.1f} s",
            "windows count in s on the clock of the IMU log",
            {"start_s": start_s, "end_s": end_s},
        )
    if period_s is not None and period_s < least:
        raise ConfigError(
            "config.windows_fit",
            f"windows of {length_s:g} s every {period_s:g} s leave less than {LEAST_BETWEEN_S:g} s in between",
            f"a period of at least {least:g} s",
        )
    room = end_s - begin - length_s
    step = period_s if period_s is not None else (room / (count - 1) if count > 1 else least)
    if room < 0.0 or (count > 1 and (step < least or (count - 1) * step > room + 1e-9)):
        fit = 0 if room < 0.0 else 1 + int(room / (period_s or least) + 1e-9)
        before = f"{settle_s:g} s to settle" if first_s is None else f"a start at {first_s:g} s"
        raise ConfigError(
            "config.windows_fit",
            f"{count} windows of {length_s:g} s do not fit between {start_s:.1f} and {end_s:.1f} s with {before}: "
            f"room for {fit}",
            "fewer or shorter windows, a shorter settle time (or a given first window), a shorter period",
            {"start_s": start_s, "end_s": end_s, "fit": fit},
        )
    return tuple((begin + i * step, begin + i * step + length_s) for i in range(count))
