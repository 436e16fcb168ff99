"""Dense Kalman filter: series transition, trapezoid noise, full-matrix gain and Joseph form."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Array = NDArray[Any]


def transition(f: Array, dt: float, order: int) -> Array:
    """I + F dt + ... to the order 1, 2 or 3."""
    phi, term = np.eye(len(f)), np.eye(len(f))
    for i in range(1, order + 1):
        term = term @ f * dt / i
        phi = phi + term
    return phi


def predict(p: Array, phi: Array, q: Array) -> Array:
    """Phi (P + Q/2) Phi' + Q/2: Groves (2013), eq. 3.46."""
    p = phi @ (p + q / 2.0) @ phi.T + q / 2.0
    return (p + p.T) / 2.0


def update(p: Array, y: Array, h: Array, r: Array) -> tuple[Array, Array, Array, float]:
    """Joint update by the full matrices.

    Parameters
    ----------
    p : (n, n) array
        Prior covariance.
    y : (k,) array
        Residual y = H x + noise.
    h, r : (k, n) and (k, k) arrays
        Jacobian and noise covariance.

    Returns
    -------
    x, p, s, nis
        Estimate (n,), posterior (n, n) by (I - KH) P (I - KH)' + K R K', residual covariance (k, k),
        y' S^-1 y.
    """
    s = h @ p @ h.T + r
    k = np.linalg.solve(s, h @ p).T
    a = np.eye(len(p)) - k @ h
    post = a @ p @ a.T + k @ r @ k.T
    return k @ y, (post + post.T) / 2.0, s, float(y @ np.linalg.solve(s, y))


def update_two_pass(p: Array, y: Array, h: Array, r: Array) -> tuple[Array, Array]:
    """The same update row by row: R whitened by its Cholesky factor, each row in two rank-one passes."""
    root = np.linalg.cholesky(r)
    y, h = np.linalg.solve(root, y), np.linalg.solve(root, h)
    x = np.zeros(len(p))
    for yi, hi in zip(y, h, strict=True):
        k = p @ hi / (hi @ p @ hi + 1.0)
        x = x + k * (yi - hi @ x)
        a = p - np.outer(k, hi @ p)
        p = a - np.outer(a @ hi, k) + np.outer(k, k)
    return x, p


def reset_jacobian(phi: Array) -> Array:
    """d(phi after injection) / d(phi before), (3, 3), to first order in the injected rotation phi (3,).

    C_true = Exp(phi_hat + d) C_est and C_new = Exp(phi_hat) C_est leave phi_new = J_l(phi_hat) d with the
    left Jacobian J_l = I + [phi_hat x] / 2 + ...
    """
    z = 0.0
    return np.eye(3) + 0.5 * np.array([[z, -phi[2], phi[1]], [phi[2], z, -phi[0]], [-phi[1], phi[0], z]])


def van_loan(f: Array, qc: Array, dt: float) -> tuple[Array, Array]:
    """Exact Phi and Qd of x' = F x + w with density Qc: Van Loan (1978)."""
    n = len(f)
    block = np.block([[-f, qc], [np.zeros((n, n)), f.T]]) * dt
    e = scipy.linalg.expm(block)
    phi = e[n:, n:].T
    qd = phi @ e[:n, n:]
    return phi, (qd + qd.T) / 2.0
