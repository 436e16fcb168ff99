"""Error equations of the laws: matrices, characteristic polynomials, linear models of one angle.

Aleshkin et al. (2021) write body 1 forward, 2 up, 3 right and navigation 1 north, 2 up, 3 east. Rates given to these
functions are forward, right, down; :func:`published` turns them and is the only function that does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from gnssins.ahrs.laws import Cross, Form, Integral, Positional, Quaternion, RowLaw

__all__ = [
    "ANGLES",
    "Angle",
    "Model",
    "Reading",
    "characteristic_polynomial",
    "effective_matrix",
    "error_matrix",
    "model",
    "printed_polynomial",
    "published",
]

Array = NDArray[np.float64]

Angle = Literal["roll", "pitch", "heading"]
#: ``"measured"``: the angle that accelerometer or magnetometer show; ``"gyro"``: the rate of that angle.
Reading = Literal["measured", "gyro"]

ANGLES: Final[tuple[Angle, ...]] = ("roll", "pitch", "heading")

#: Rows up and east of C near level attitude and north heading, as the angles move them: columns roll, pitch,
#: heading. c21 = pitch, c23 = -roll; c31 = heading, c32 = roll.
_UP: Final = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
_EAST: Final = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])

#: The row and the element from which the publication reads each angle, with its sign.
_ELEMENT: Final = {"roll": (_UP, 2, -1.0), "pitch": (_UP, 0, 1.0), "heading": (_EAST, 0, 1.0)}

#: Place of each angle in a rotation vector along forward, up, right, with its sign.
_AXIS: Final = {"roll": (0, 1.0), "pitch": (2, 1.0), "heading": (1, -1.0)}


def published(vector: ArrayLike) -> Array:
    """Turn forward, right, down into forward, up, right; shape (..., 3)."""
    v = np.asarray(vector, dtype=np.float64)
    return np.stack([v[..., 0], -v[..., 2], v[..., 1]], axis=-1)


def _cross_matrix(w: Array) -> Array:
    """Matrix of the cross product with w (..., 3), shape (..., 3, 3)."""
    zero = np.zeros_like(w[..., 0])
    x, y, z = w[..., 0], w[..., 1], w[..., 2]
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def error_matrix(law: RowLaw | Quaternion, rate_b: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """Matrix A of the error equation e' = A e at constant body rates.

    Positional and cross-coupled: A = W - K of one row of C, W = -[w x]; integral: [[0, k_int I], [-I, W - k I]] over
    integrators and errors; quaternion: right product with w/2, less K4.

    Parameters
    ----------
    law : RowLaw or Quaternion
        Law and gains.
    rate_b : array_like, shape (..., 3)
        Body rates forward, right, down, rad/s.

    Returns
    -------
    ndarray, shape (..., n, n)
        n = 3, 6 or 4, in the axes of the publication.
    """
    w = published(rate_b)
    if isinstance(law, Quaternion):
        return _half_product(w) - law.matrix()
    own = -_cross_matrix(w) - law.matrix()
    if not isinstance(law, Integral):
        return own
    a = np.zeros((*w.shape[:-1], 6, 6))
    a[..., :3, 3:] = law.k_int * np.eye(3)
    a[..., 3:, :3] = -np.eye(3)
    a[..., 3:, 3:] = own
    return a


def _half_product(w: Array) -> Array:
    """Matrix of L o w / 2 for w (..., 3), shape (..., 4, 4)."""
    a = np.zeros((*w.shape[:-1], 4, 4))
    a[..., 0, 1:] = -w
    a[..., 1:, 0] = w
    a[..., 1:, 1:] = -_cross_matrix(w)
    return 0.5 * a


def characteristic_polynomial(law: RowLaw, rate_b: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """Characteristic polynomial of a row's error equation, written out.

    ::

        Positional:  p³ + Σk p² + (k1k2 + k1k3 + k2k3 + w²) p + k1k2k3 + k1w1² + k2w2² + k3w3².
        Integral:    q³ + p² w² q with q = p² + k p + k_int.
        Cross:       p³ + 3k p² + [3k² + n² + w² + 2n(w2 - w3)] p
                     + k³ + kn² - 2n³ + kw² + 2nk(w2 - w3) + 2n²(w3 - w2) + 2n w2w3.

    Aleshkin et al. (2021), eq. 18 to 23; the constant term of the cross-coupled law is the determinant of K - W and
    differs from the printed one (:func:`printed_polynomial`).

    Parameters
    ----------
    law : RowLaw
        Law and gains.
    rate_b : array_like, shape (..., 3)
        Body rates forward, right, down, rad/s.

    Returns
    -------
    ndarray, shape (..., n + 1)
        Coefficients from the highest power down; n = 3, integral 6.
    """
    w = published(rate_b)
    w1, w2, w3 = w[..., 0], w[..., 1], w[..., 2]
    square = w1**2 + w2**2 + w3**2
    if isinstance(law, Positional):
        k1, k2, k3 = law.gains
        b = k1 * k2 + k1 * k3 + k2 * k3 + square
        return _stack(k1 + k2 + k3, b, k1 * k2 * k3 + k1 * w1**2 + k2 * w2**2 + k3 * w3**2)
    if isinstance(law, Cross):
        k, n = law.k, law.n
        b = 3 * k**2 + n**2 + square + 2 * n * (w2 - w3)
        c = k**3 + k * n**2 - 2 * n**3 + k * square
        c = c + 2 * n * k * (w2 - w3) + 2 * n**2 * (w3 - w2) + 2 * n * w2 * w3
        return _stack(3 * k, b, c)
    quadratic = np.array([1.0, law.k, law.k_int])
    cube = np.polymul(np.polymul(quadratic, quadratic), quadratic)
    return np.asarray(cube + square[..., None] * np.array([0.0, 0.0, *quadratic, 0.0, 0.0]))


def printed_polynomial(law: Cross, rate_b: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """Characteristic polynomial of the cross-coupled law as printed: +2n³ and 2n(w2 - w3 + w2w3) in the constant term.

    Not homogeneous in 1/s, and against the publication's own polynomial at rest. For comparison only.
    """
    found = characteristic_polynomial(law, rate_b)
    w = published(rate_b)
    found[..., 3] += 4.0 * law.n**3 + 2.0 * law.n * (w[..., 1] - w[..., 2])
    return np.asarray(found)


def _stack(a: float, b: Array, c: Array) -> Array:
    return np.stack([np.ones_like(b), np.full_like(b, a), b, c], axis=-1)


def effective_matrix(law: RowLaw) -> Array:
    """Matrix K' of d' = -K' d for a small rotation d when C is kept a rotation: (tr K I - K^T) / 2.

    The symmetric part of the error matrix, which the nearest rotation drops, takes half of every cross gain with it.
    Follows from [d x] M + M^T [d x] = [((tr M) I - M) d x].
    """
    k = law.matrix()
    return np.asarray(0.5 * (np.trace(k) * np.eye(3) - k.T))


@dataclass(frozen=True, eq=False)
class Model:
    """Linear model of one angle: z' = a z + b u, angle = out z.

    Parameters
    ----------
    a : ndarray, shape (n, n)
        Dynamics, 1/s.
    moved : ndarray, shape (n, 3)
        How roll, pitch and heading enter the state: the columns of a gyro input; -a times them, those of readings.
    out : ndarray, shape (n,)
        The angle from the state.
    own : int
        Column of the angle itself in ``moved``.
    law : RowLaw
        Law and gains.
    form : {"elements", "rotation"}
        As in :func:`model`.
    """

    a: Array
    moved: Array
    out: Array
    own: int
    law: RowLaw
    form: Form

    def transition(self, dt_s: float) -> Array:
        """Transition over a sampling interval as the compiled law takes it, shape (n, n).

        exp(a T); where C is kept a rotation, (tr F I - F^T) / 2 of F = exp(-K T), the nearest rotation being taken
        once per sample: a little more cross-coupling is left than the continuous form has.
        """
        if self.form == "rotation" and not isinstance(self.law, Integral):
            f = expm(-self.law.matrix() * dt_s)
            return np.asarray(0.5 * (np.trace(f) * np.eye(3) - f.T))
        return np.asarray(expm(self.a * dt_s))

    def inputs(self, reading: Reading) -> Array:
        """Input matrix b, shape (n, 3)."""
        return self.moved if reading == "gyro" else -self.a @ self.moved


def model(law: RowLaw, angle: Angle, form: Form = "elements") -> Model:
    """Linear model of an angle near level attitude and north heading, at rest.

    Parameters
    ----------
    law : RowLaw
        Law and gains.
    angle : {"roll", "pitch", "heading"}
        Angle given out.
    form : {"elements", "rotation"}
        Angle read from a single element, as published, or from the matrix kept a rotation.
    """
    own = ANGLES.index(angle)
    if form == "elements":
        moved, element, sign = _ELEMENT[angle]
        a, out = -law.matrix(), sign * np.eye(3)[element]
    else:
        moved = np.zeros((3, 3))
        for i, name in enumerate(ANGLES):
            axis, sign = _AXIS[name]
            moved[axis, i] = sign
        axis, sign = _AXIS[angle]
        a, out = -effective_matrix(law), sign * np.eye(3)[axis]
    if isinstance(law, Integral):
        wide = np.zeros((6, 6))
        wide[:3, 3:], wide[3:, :3], wide[3:, 3:] = law.k_int * np.eye(3), -np.eye(3), a
        return Model(wide, np.vstack([np.zeros((3, 3)), moved]), np.append(np.zeros(3), out), own, law, form)
    return Model(a, moved, out, own, law, form)
