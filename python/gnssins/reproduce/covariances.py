"""Two covariances side by side: the one that a filter claims, and the one that its errors really have.

A filter with a misprint computes a wrong P and with it a wrong gain K; the covariance S of its true errors takes the
same gain through the right system:

    S- = Phi S Phi' + Q,    S = (I - K H) S- (I - K H)' + K R K'

Gelb (ed., 1974), section 7.2. All functions take stacks of matrices, shape (..., n, n), as well as single ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["corrected", "gain", "third_order", "transposed"]

Array = NDArray[np.float64]


def transposed(a: Array) -> Array:
    """Matrices of a stack transposed."""
    return np.swapaxes(a, -1, -2)


def gain(p: Array, h: Array, r: Array) -> Array:
    """Gain of a filter that believes ``p``: K = P H' (H P H' + R)^-1, shape (..., n, m)."""
    k_transposed: Array = np.asarray(np.linalg.solve(h @ p @ transposed(h) + r, h @ p), dtype=np.float64)
    return transposed(k_transposed)


def corrected(p: Array, k: Array, h: Array, r: Array) -> Array:
    """Covariance after a measurement taken with any gain ``k``, its own or another filter's (Joseph form)."""
    keep = np.eye(h.shape[-1]) - k @ h
    return np.asarray(keep @ p @ transposed(keep) + k @ r @ transposed(k))


def third_order(f: Array, g: Array, density: Array, dt_s: float) -> tuple[Array, Array]:
    """Transition and process noise over one step, terms to third order.

    Parameters
    ----------
    f : ndarray, shape (..., n, n)
        System matrices.
    g : ndarray, shape (..., n, w)
        Noise inputs.
    density : ndarray, shape (w, w)
        Spectral densities.
    dt_s : float
        Step, s.

    Returns
    -------
    phi, q : ndarray, shape (..., n, n)
        Phi = I + F dt + (F dt)^2/2 + (F dt)^3/6; Q = Gamma (Qc/dt) Gamma', Gamma = (I + F dt/2 + (F dt)^2/6) G dt.
    """
    square, eye = f @ f, np.eye(f.shape[-1])
    phi = eye + dt_s * f + dt_s**2 / 2.0 * square + dt_s**3 / 6.0 * (square @ f)
    root = dt_s * (eye + dt_s / 2.0 * f + dt_s**2 / 6.0 * square) @ g
    return phi, np.asarray(root @ (density / dt_s) @ transposed(root))
