"""Random processes of sensor errors, exact at the samples however long the step is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

__all__ = ["constant", "gauss_markov", "random_walk"]

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
