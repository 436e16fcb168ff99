"""Published correction laws as objects: their gains, and the settings by which the compiled core runs them.

Gains act in the axes of Aleshkin et al. (2021), body forward, up, right; everything else in this package is body
forward, right, down and north, east, down. The core changes axes at one place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["Cross", "Form", "Integral", "Law", "Levelling", "Positional", "Quaternion", "RowLaw"]

Array = NDArray[np.float64]

#: What keeps direction cosines a rotation: ``"rotation"`` brings the matrix back after every sample, ``"elements"``
#: lets the nine elements go as published and gives out the nearest rotation.
Form = Literal["rotation", "elements"]

#: Signs of the cross gains of the quaternion law.
QUATERNION_CROSS: Final = np.array(
    [[0.0, 1.0, 1.0, 1.0], [-1.0, 0.0, 1.0, 1.0], [-1.0, 1.0, 0.0, 1.0], [-1.0, 1.0, 1.0, 0.0]]
)


class Law(Protocol):
    """A correction law that the compiled core can run."""

    @property
    def method(self) -> str:
        """Name of the estimator in the core."""

    def settings(self) -> dict[str, Any]:
        """Settings of that estimator."""


class _OfDirectionCosines:
    """Runs as direction cosines."""

    @property
    def method(self) -> str:
        """Name of the estimator in the core."""
        return "dcm"


@dataclass(frozen=True)
class Positional(_OfDirectionCosines):
    """Positional correction: c' = W c - K e with K diagonal, e = c - c_k, for every row c of C.

    Parameters
    ----------
    k : float or tuple of three floats
        Gain, 1/s; three gains belong to body forward, up, right.
    """

    k: float | tuple[float, float, float]

    @property
    def gains(self) -> tuple[float, float, float]:
        """The three gains, 1/s."""
        return self.k if isinstance(self.k, tuple) else (self.k, self.k, self.k)

    def matrix(self) -> Array:
        """K of the row equation, shape (3, 3), 1/s."""
        return np.diag(np.asarray(self.gains, dtype=float))

    def settings(self) -> dict[str, Any]:
        """Settings of the core."""
        return {"law": {"positional": {"k": list(self.gains)}}}


@dataclass(frozen=True)
class Integral(_OfDirectionCosines):
    """Integral-positional correction: c' = W c - k e - x, x' = k_int e, one integrator per element.

    The integrators stand for a rate in the axes of the elements; they take away a gyro bias only while the body does
    not turn.

    Parameters
    ----------
    k : float
        Gain, 1/s.
    k_int : float
        Gain of the integrators, 1/s².
    """

    k: float
    k_int: float

    def matrix(self) -> Array:
        """Positional part, shape (3, 3), 1/s."""
        return self.k * np.eye(3)

    def settings(self) -> dict[str, Any]:
        """Settings of the core."""
        return {"law": {"integral": {"k": self.k, "k_int": self.k_int}}}


@dataclass(frozen=True)
class Cross(_OfDirectionCosines):
    """Cross-coupled positional correction: c' = W c - K e with K = [k n n; -n k n; -n n k].

    Parameters
    ----------
    k : float
        Own gain, 1/s.
    n : float
        Gain of the neighbours in the row, 1/s; below k in magnitude, or some body rate makes the law unstable.
    """

    k: float
    n: float

    def matrix(self) -> Array:
        """K of the row equation, shape (3, 3), 1/s."""
        k, n = self.k, self.n
        return np.array([[k, n, n], [-n, k, n], [-n, n, k]])

    def settings(self) -> dict[str, Any]:
        """Settings of the core."""
        return {"law": {"cross": {"k": self.k, "n": self.n}}}


@dataclass(frozen=True)
class Quaternion:
    """Correction of the quaternion: L' = L o w / 2 - (k I + n J)(L - s L_k), s = sign(L . L_k).

    Parameters
    ----------
    k : float
        Own gain, 1/s.
    n : float
        Cross gain, 1/s, from -k/2 to k.
    """

    k: float
    n: float = 0.0

    @property
    def method(self) -> str:
        """Name of the estimator in the core."""
        return "quaternion"

    def matrix(self) -> Array:
        """K4, shape (4, 4), 1/s, scalar part first."""
        return self.k * np.eye(4) + self.n * QUATERNION_CROSS

    def settings(self) -> dict[str, Any]:
        """Settings of the core."""
        return {"k": self.k, "n": self.n}


@dataclass(frozen=True)
class Levelling:
    """Euler kinematics levelled by the specific force resolved in navigation axes; a gyro heading unless asked for.

    Parameters
    ----------
    k : float
        Levelling gain, 1/s.
    k_int : float
        Gain of its integral, 1/s². With ``k=0`` and ``k_int=g/R`` acceleration has no effect (Schuler).
    k_heading : float
        Gain of the magnetic heading, 1/s.
    latitude_rad : float, optional
        Lets the levelling turn the heading with the Earth; left out: it does not touch the heading.
    """

    k: float
    k_int: float = 0.0
    k_heading: float = 0.0
    latitude_rad: float | None = None

    @property
    def method(self) -> str:
        """Name of the estimator in the core."""
        return "euler"

    def settings(self) -> dict[str, Any]:
        """Settings of the core."""
        return {
            "k": self.k,
            "k_int": self.k_int,
            "k_heading": self.k_heading,
            "latitude_rad": self.latitude_rad,
        }


#: Laws whose rows of C obey one linear equation.
RowLaw = Positional | Integral | Cross
