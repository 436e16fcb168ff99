"""Statistics of integrity tests, on plain arrays: trace ratio, chi-square, tolerance, window; rates with bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import betaincinv, gammainccinv

from gnssins.errors import InputError
from gnssins.units import NS_PER_S

__all__ = ["Part", "Share", "chi_square", "chi_square_limit", "tolerance", "trace_ratio", "windowed"]

Array = NDArray[np.float64]
Times = NDArray[np.int64]

#: Part of a fix.
Part = Literal["position", "velocity"]


def trace_ratio(innovation: Array, covariance: Array) -> Array:
    """v'v / trace(S) of rows (k, c) with covariances (k, c, c); NaN where a component is absent."""
    return np.asarray(np.einsum("ki,ki->k", innovation, innovation) / np.trace(covariance, axis1=1, axis2=2))


def chi_square(innovation: Array, covariance: Array) -> Array:
    """v' S^-1 v of rows (k, c) with covariances (k, c, c); NaN where a component is absent."""
    out = np.full(innovation.shape[0], np.nan)
    known = np.isfinite(innovation).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2))
    v = innovation[known]
    out[known] = np.einsum("ki,ki->k", v, np.linalg.solve(covariance[known], v[:, :, None])[:, :, 0])
    return out


def chi_square_limit(false_alarm: float, dof: int = 3) -> float:
    """Limit that a chi-square value exceeds with probability ``false_alarm``: 25.9 for 1e-5 and three components."""
    if not 0.0 < false_alarm < 1.0:
        raise InputError("input.probability", f"a false-alarm rate of {false_alarm:g}", "between 0 and 1")
    return 2.0 * float(gammainccinv(0.5 * dof, false_alarm))


@dataclass(frozen=True)
class Share:
    """So many hits of so many trials, with the two-sided bounds of Clopper and Pearson (1934)."""

    hits: int
    trials: int
    probability: float = 0.95

    @property
    def value(self) -> float:
        """Hits over trials; NaN without trials."""
        return self.hits / self.trials if self.trials else math.nan

    @property
    def bounds(self) -> tuple[float, float]:
        """Between these the true rate lies with ``probability``, trials being independent."""
        tail, k, n = 0.5 * (1.0 - self.probability), self.hits, self.trials
        low = float(betaincinv(k, n - k + 1, tail)) if k else 0.0
        high = float(betaincinv(k + 1, n - k, 1.0 - tail)) if k < n else 1.0
        return low, high

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        return {"hits": self.hits, "trials": self.trials, "rate": self.value, "bounds": list(self.bounds)}


def windowed(
    t_ns: Times, innovation: Array, covariance: Array, window_s: float, *, ramp: Array | None = None
) -> Array:
    """Chi-square value of the sum of the innovations over the ``window_s`` up to each fix.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (k,)
        Ascending.
    innovation : ndarray, shape (k, c)
        Rows with an absent component do not count.
    covariance : ndarray, shape (k, c, c)
        Of the innovations.
    window_s : float
        Length, s.
    ramp : ndarray, shape (k, c), optional
        Added to the innovations, per s since the start of the window.

    Returns
    -------
    ndarray, shape (k,)
        NaN before the first full window, and where fewer than two fixes lie in it. With white innovations chi-square of
        c degrees of freedom.
    """
    known = np.isfinite(innovation).all(axis=1)
    out = np.full(t_ns.size, np.nan)
    if known.sum() < 2:
        return out
    t, v, s = (t_ns[known] - t_ns[0]) / NS_PER_S, innovation[known], covariance[known]
    length = window_s + 1e-6
    first = np.searchsorted(t, t - length)
    at = np.arange(t.size)
    full = (t - t[0] >= window_s - 1e-6) & (at - first >= 1)
    sums = np.concatenate([np.zeros((1, v.shape[1])), np.cumsum(v, axis=0)])
    spreads = np.concatenate([np.zeros((1, *s.shape[1:])), np.cumsum(s, axis=0)])
    total = sums[at + 1] - sums[first]
    if ramp is not None:
        slope = ramp[known]
        moment = np.concatenate([np.zeros((1, v.shape[1])), np.cumsum(slope * t[:, None], axis=0)])
        count = np.concatenate([np.zeros((1, v.shape[1])), np.cumsum(slope, axis=0)])
        total = total + (moment[at + 1] - moment[first]) - t[first][:, None] * (count[at + 1] - count[first])
    value = np.full(t.size, np.nan)
    value[full] = chi_square(total[full], (spreads[at + 1] - spreads[first])[full])
    out[known] = value
    return out


def tolerance(
    jump: ArrayLike, dt_s: ArrayLike, sd: ArrayLike, max_accel_m_s2: float, part: Part = "position"
) -> Array:
    """Jump of a fix over what the vehicle and the noise allow; above 1 is an alarm.

    The last accepted estimate, extrapolated over ``dt_s`` with its velocity, against the fix: the position may differ
    by a dt^2 / 2 + 5 sqrt(2) s, the velocity by a dt + 5 sqrt(2) s.

    Parameters
    ----------
    jump : array_like, shape (k, 3)
        Fix minus extrapolated estimate along each axis, m or m/s.
    dt_s : array_like, shape (k,)
        Time since the last accepted fix, s.
    sd : array_like, shape (k, 3) or (3,)
        Standard deviations of the fix.
    max_accel_m_s2 : float
        What the vehicle can do; 5 for an airliner.
    part : {"position", "velocity"}
        What jumps.

    Returns
    -------
    ndarray, shape (k, 3)
    """
    dt = np.asarray(dt_s, dtype=np.float64)[..., None]
    reach = 0.5 * max_accel_m_s2 * dt**2 if part == "position" else max_accel_m_s2 * dt
    return np.asarray(np.abs(jump) / (reach + 5.0 * math.sqrt(2.0) * np.asarray(sd, dtype=np.float64)))
