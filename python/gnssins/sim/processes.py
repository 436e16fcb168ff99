"""Random processes of sensor errors, exact at the samples however long the step is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded
from scipy.signal import lfilter

__all__ = ["constant", "gauss_markov", "gauss_markov_varying", "low_pass", "random_walk"]

Array = NDArray[np.float64]


def constant(rng: np.random.Generator, samples: int, sd: Array) -> Array:
    """Draw a value once from N(0, sd^2).

    Parameters
    ----------
    rng : Generator
        Source of the draw.
    samples : int
        Length n of the history.
    sd : ndarray, shape (k,)
        Standard deviation of each component.

    Returns
    -------
    ndarray, shape (n, k)
        Read-only view that repeats one row.
    """
    return np.broadcast_to(sd * rng.standard_normal(sd.size), (samples, sd.size))


def random_walk(rng: np.random.Generator, samples: int, dt_s: float, walk: Array, initial_sd: Array) -> Array:
    """Random walk: variance ``initial_sd^2 + walk^2 t``.

    Parameters
    ----------
    rng : Generator
        Source of the draws.
    samples : int
        Length n of the history.
    dt_s : float
        Sampling interval.
    walk : ndarray, shape (k,)
        Growth, unit per root second.
    initial_sd : ndarray, shape (k,)
        Standard deviation of the first sample.

    Returns
    -------
    ndarray, shape (n, k)
    """
    drive = rng.standard_normal((walk.size, samples))
    drive[:, 0] *= initial_sd
    drive[:, 1:] *= walk[:, np.newaxis] * np.sqrt(dt_s)
    return np.asarray(np.cumsum(drive, axis=1).T)


def gauss_markov(rng: np.random.Generator, samples: int, dt_s: float, sd: Array, tau_s: float) -> Array:
    """First-order Gauss-Markov process in its stationary state.

    ``x[k+1] = exp(-dt/tau) x[k] + sd sqrt(1 - exp(-2 dt/tau)) n[k]``, with x[0] from N(0, sd^2): the
    autocovariance is ``sd^2 exp(-|t|/tau)`` from the first sample on.

    Parameters
    ----------
    rng : Generator
        Source of the draws.
    samples : int
        Length n of the history.
    dt_s : float
        Sampling interval.
    sd : ndarray, shape (k,)
        Stationary standard deviation.
    tau_s : float
        Correlation time.

    Returns
    -------
    ndarray, shape (n, k)
    """
    drive = rng.standard_normal((sd.size, samples))
    drive[:, 0] *= sd
    drive[:, 1:] *= (sd * np.sqrt(-np.expm1(-2.0 * dt_s / tau_s)))[:, np.newaxis]
    return np.asarray(lfilter([1.0], [1.0, -np.exp(-dt_s / tau_s)], drive, axis=1).T)


def gauss_markov_varying(rng: np.random.Generator, growth: Array, sd: Array) -> Array:
    """First-order Gauss-Markov process of constant variance whose rate changes with time.

    ``x[k+1] = W x[k] + sd sqrt(1 - W^2) n[k]`` with ``W = exp(-growth[k])``, the integral of the rate over the
    interval: the variance is ``sd^2`` at every sample, and two samples correlate by the exponential of minus the
    growth between them.

    Parameters
    ----------
    rng : Generator
        Source of the draws.
    growth : ndarray, shape (n - 1,)
        Integral of the rate over each interval, not negative.
    sd : ndarray, shape (k,)
        Standard deviation.

    Returns
    -------
    ndarray, shape (n, k)
    """
    drive = rng.standard_normal((sd.size, growth.size + 1)).T * sd
    drive[1:] *= np.sqrt(-np.expm1(-2.0 * growth))[:, np.newaxis]
    bands = np.ones((2, growth.size + 1))
    bands[1, :-1] = -np.exp(-growth)
    return np.asarray(solve_banded((1, 0), bands, drive, overwrite_b=True, check_finite=False))


def low_pass(
    rng: np.random.Generator, samples: int, dt_s: float, density: Array, corner_hz: float
) -> tuple[Array, Array]:
    """White noise behind a first-order low-pass: its values, and its integrals over the intervals between them.

    ``w' = k (e - w)`` with ``k = 2 pi corner_hz`` and white noise e of root density ``density``. Value and
    integral are drawn together from their exact joint law over one interval T, with ``a = exp(-k T)`` and
    densities ``q = density^2``: ``w+ = a w + u``, ``integral = w (1 - a)/k + v``,

    * ``var u = q k (1 - a^2)/2``, ``cov(u, v) = q (1 - a)^2/2``,
    * ``var v = q (T - 2 (1 - a)/k + (1 - a^2)/(2 k))``.

    So the values have the variance ``q k/2`` and the integrals ``q (T - (1 - a)/k)``: Vasilyuk (2019), section on
    the noise, with q for half the one-sided density N.

    Parameters
    ----------
    rng : Generator
        Source of the draws.
    samples : int
        Number n of intervals.
    dt_s : float
        Length T of an interval.
    density : ndarray, shape (k,)
        Root of the two-sided density of the noise at low frequency, unit times root second.
    corner_hz : float
        Corner frequency.

    Returns
    -------
    values : ndarray, shape (n + 1, k)
        At the ends of the intervals, stationary from the first on.
    integrals : ndarray, shape (n, k)
        Over the intervals.
    """
    k = 2.0 * np.pi * corner_hz
    fade = float(-np.expm1(-k * dt_s))  # 1 - a
    fade_twice = float(-np.expm1(-2.0 * k * dt_s))  # 1 - a^2
    sd_u = np.sqrt(0.5 * k * fade_twice)
    mixed = 0.5 * fade**2 / sd_u
    rest = dt_s - 2.0 * fade / k + 0.5 * fade_twice / k - mixed**2
    first, second = rng.standard_normal((2, samples, density.size))
    drive = np.concatenate([np.sqrt(0.5 * k) * rng.standard_normal((1, density.size)), sd_u * first])
    values = np.asarray(lfilter([1.0], [1.0, -np.exp(-k * dt_s)], drive, axis=0))
    integrals = values[:-1] * (fade / k) + mixed * first + np.sqrt(max(rest, 0.0)) * second
    return values * density, integrals * density
