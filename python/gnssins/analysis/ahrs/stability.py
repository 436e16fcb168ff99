"""Stability of a law at every body rate: eigenvalues over a grid, the whole Routh condition, and a bound."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gnssins.ahrs.laws import Cross, Integral, Positional, Quaternion, RowLaw
from gnssins.analysis import text
from gnssins.analysis.ahrs.dynamics import characteristic_polynomial, error_matrix
from gnssins.errors import ConfigError

__all__ = ["Stability", "euler_rate_limit", "rate_grid", "routh", "stability"]

Array = NDArray[np.float64]


def rate_grid(limit_rad_s: float = 100.0, points: int = 41) -> Array:
    """Body rates of a cube, shape (points³, 3), rad/s: each axis from -limit to +limit."""
    axis = np.linspace(-limit_rad_s, limit_rad_s, points)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def routh(polynomial: ArrayLike) -> NDArray[np.bool_]:
    """Tell whether all roots lie in the open left half plane, by the Routh table.

    For p³ + a p² + b p + c these are a > 0, ab > c **and c > 0**; the publication tests ab > c alone.

    Parameters
    ----------
    polynomial : array_like, shape (..., n + 1)
        Coefficients from the highest power down, the first one positive.

    Returns
    -------
    ndarray of bool, shape (...)
    """
    p = np.asarray(polynomial, dtype=np.float64)
    width = (p.shape[-1] + 1) // 2
    above = p[..., 0::2]
    below = np.zeros_like(above)
    below[..., : p[..., 1::2].shape[-1]] = p[..., 1::2]
    good = above[..., 0] > 0.0
    for _ in range(p.shape[-1] - 1):
        first = below[..., :1]
        good = good & (first[..., 0] > 0.0)
        ratio = above[..., :1] / np.where(first > 0.0, first, 1.0)
        rest = np.zeros_like(above)
        rest[..., : width - 1] = above[..., 1:] - ratio * below[..., 1:]
        above, below = below, rest
    return np.asarray(good)


@dataclass(frozen=True, eq=False)
class Stability:
    """Stability over body rates.

    Parameters
    ----------
    law : RowLaw or Quaternion
        Law and gains.
    rates : ndarray, shape (m, 3)
        Body rates forward, right, down, rad/s.
    abscissa : ndarray, shape (m,)
        Largest real part of the eigenvalues at each, 1/s.
    routh : ndarray of bool, shape (m,)
        Whole Routh condition; for a quaternion the sign of the abscissa.
    published : ndarray of bool, shape (m,), or None
        The one condition that the publication tests, ab > c; cubic polynomials only.
    bound : float
        Bound of the abscissa for any rate, constant or not, 1/s; from the symmetric part of the gains.
    """

    law: RowLaw | Quaternion
    rates: Array
    abscissa: Array
    routh: NDArray[np.bool_]
    published: NDArray[np.bool_] | None
    bound: float

    @property
    def stable(self) -> bool:
        """Whether the law is stable at every rate of the grid."""
        return bool(self.routh.all())

    @property
    def worst(self) -> float:
        """Largest real part on the grid, 1/s."""
        return float(self.abscissa.max())

    @property
    def worst_rate(self) -> Array:
        """Body rate where it occurs, shape (3,), rad/s."""
        return np.asarray(self.rates[int(self.abscissa.argmax())])

    @property
    def missed(self) -> int:
        """Unstable points of the grid that the publication's condition passes."""
        return 0 if self.published is None else int((self.published & ~self.routh).sum())

    @property
    def verdict(self) -> str:
        """In words."""
        scale = float(np.abs(self.law.matrix()).max()) or float(np.abs(error_matrix(self.law)).max())
        if not self.stable and self.worst <= 1e-9 * scale:
            return f"not damped at {int((~self.routh).sum())} of {self.routh.size} body rates"
        if not self.stable:
            return f"unstable at {int((~self.routh).sum())} of {self.routh.size} body rates"
        if self.bound < 0.0:
            return f"stable at any body rate: errors fall at least as exp({text.number(self.bound)} t)"
        return "stable at every rate of the grid"

    def table(self) -> str:
        """The figures and the verdict."""
        rows = [
            ["largest real part, 1/s", text.number(self.worst, 4)],
            ["at forward, right, down, rad/s", ", ".join(f"{v:g}" for v in self.worst_rate)],
            ["bound for any rate, 1/s", text.number(self.bound, 4)],
            ["points", str(self.routh.size)],
            ["unstable", str(int((~self.routh).sum()))],
            ["unstable but passed by ab > c", "-" if self.published is None else str(self.missed)],
        ]
        return text.table(f"Stability of {self.law}", ["", ""], rows, self.verdict)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        return {
            "worst_1_s": self.worst,
            "worst_rate_rad_s": self.worst_rate.tolist(),
            "bound_1_s": self.bound,
            "points": int(self.routh.size),
            "unstable": int((~self.routh).sum()),
            "passed_by_ab_above_c": None if self.published is None else self.missed,
            "verdict": self.verdict,
        }


def stability(law: RowLaw | Quaternion, rates: ArrayLike | None = None) -> Stability:
    """Examine a law over body rates.

    The error of a positional or cross-coupled law falls at least as exp(-s t), s the least eigenvalue of the symmetric
    part of K, at any rate, constant or not: k less the magnitude of n for the cross-coupled one. For the integral law
    ``V = |e|² + |x|² / k_int`` only falls, but one pair of poles slows down with the rate, so that its bound is 0.

    Parameters
    ----------
    law : RowLaw or Quaternion
        Law and gains.
    rates : array_like, shape (m, 3), optional
        Body rates forward, right, down, rad/s; left out: :func:`rate_grid`.
    """
    grid = rate_grid() if rates is None else np.atleast_2d(np.asarray(rates, dtype=np.float64))
    if grid.ndim != 2 or grid.shape[1] != 3 or not np.isfinite(grid).all():
        raise ConfigError("config.range", f"rates: need finite rates of shape (m, 3), got {grid.shape}")
    parts = [grid[i : i + 20_000] for i in range(0, len(grid), 20_000)]
    abscissa = np.concatenate([np.linalg.eigvals(error_matrix(law, p)).real.max(axis=1) for p in parts])
    if isinstance(law, Quaternion):
        return Stability(law, grid, abscissa, abscissa < 0.0, None, _bound(law))
    polynomial = characteristic_polynomial(law, grid)
    published = None
    if isinstance(law, Positional | Cross):
        published = polynomial[:, 1] * polynomial[:, 2] > polynomial[:, 3]
    return Stability(law, grid, abscissa, routh(polynomial), published, _bound(law))


def _bound(law: RowLaw | Quaternion) -> float:
    if isinstance(law, Integral):
        return 0.0
    matrix = law.matrix()
    return -float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T)).min())


def euler_rate_limit(k: float, dt_s: float) -> float:
    """Body rate (rad/s) at which the positional law, stepped by explicit Euler, becomes unstable.

    ``|1 - kT + j w T| = 1``, hence w = sqrt(1 - (1 - kT)²) / T; 0 for kT beyond 2. The compiled law has no such limit.
    """
    inside = 1.0 - (1.0 - k * dt_s) ** 2
    return math.sqrt(inside) / dt_s if inside > 0.0 else 0.0
