"""Noise of band-limited sensors over one interval between fixes, in closed form, beside the white equivalent.

A sensor whose white noise passes a first-order low-pass filter with the corner frequency f gives increments that are
correlated from one interval to the next. With the one-sided density N, k = 2 pi f and tau = 1/k,

    R(s) = (N k / 4) exp(-k |s|)

and the integrals over intervals of length T are

    the same interval:           Q1(T)    = (N/2) [T + tau (exp(-k T) - 1)]
    two of them, d intervals apart: Q2(T, d) = (N/4) tau exp(-k (d-1) T) (1 - exp(-k T))^2

Vasilyuk (2019), with the printed forms put right (:data:`ERRATA`). The engine takes the white equivalent N T / 2, as
every recursion must that adds one covariance per interval: the closed form leaves out what neighbouring intervals
have in common, and falls short in the long run by (tau/T)(1 - exp(-k T)), 4 % for 40 Hz and 0.1 s.

One-sided and two-sided densities differ by a factor of two, their roots by the square root of two. A random walk
(``arw``, ``vrw``) is the root of the two-sided one: (N/2) T is its variance after the time T.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gnssins.errors import InputError

__all__ = [
    "ERRATA",
    "BandLimited",
    "Erratum",
    "gauss_markov_noise",
    "process_noise",
    "rotated_noise",
    "transition",
    "worked_values",
]

Array = NDArray[np.float64]
Form = Literal["right", "printed"]


@dataclass(frozen=True)
class BandLimited:
    """White noise behind a first-order low-pass filter.

    Parameters
    ----------
    density : float
        One-sided power spectral density N of the white noise: (rad/s)^2/Hz or (m/s^2)^2/Hz.
    corner_hz : float
        Corner frequency of the filter, Hz.
    """

    density: float
    corner_hz: float

    def __post_init__(self) -> None:
        if not (
            self.density >= 0.0 and self.corner_hz > 0.0 and math.isfinite(self.density * self.corner_hz)
        ):
            raise InputError(
                "input.noise",
                f"a density of {self.density:g} behind a corner of {self.corner_hz:g} Hz",
                "the density must not be negative, the corner frequency must be positive",
            )

    @classmethod
    def of_one_sided(cls, root_density: float, corner_hz: float) -> BandLimited:
        """From the root of a one-sided density, per root of Hz: the rms of B Hz is ``root_density`` sqrt(B)."""
        return cls(root_density**2, corner_hz)

    @classmethod
    def of_random_walk(cls, walk: float, corner_hz: float) -> BandLimited:
        """From a random walk, per root of s (IEEE angle or velocity random walk): the root of the two-sided density."""
        return cls(2.0 * walk**2, corner_hz)

    @property
    def walk(self) -> float:
        """Random walk, sqrt(N/2): the standard deviation of the integral after 1 s of white noise."""
        return math.sqrt(0.5 * self.density)

    @property
    def rate(self) -> float:
        """k = 2 pi f, 1/s."""
        return 2.0 * math.pi * self.corner_hz

    @property
    def tau_s(self) -> float:
        """Correlation time 1/k, s."""
        return 1.0 / self.rate

    @property
    def variance(self) -> float:
        """Variance of a sample, N k / 4 = (pi/2) N f."""
        return 0.25 * self.density * self.rate

    def autocovariance(self, lag_s: ArrayLike) -> Array:
        """R(s) at lags of any sign."""
        return np.asarray(self.variance * np.exp(-self.rate * np.abs(np.asarray(lag_s, dtype=np.float64))))

    def same_interval(self, length_s: float) -> float:
        """Q1: variance of the integral over one interval."""
        return 0.5 * self.density * (length_s + self.tau_s * math.expm1(-self.rate * length_s))

    def distinct_intervals(self, length_s: float, apart: ArrayLike) -> Array:
        """Q2: covariance of the integrals over two intervals whose numbers differ by ``apart``, either sign."""
        d = np.abs(np.asarray(apart, dtype=np.float64))
        if (d < 1.0).any():
            raise InputError(
                "input.noise", "two distinct intervals are at least one apart", "the same one has Q1"
            )
        edge = math.expm1(-self.rate * length_s) ** 2
        return np.asarray(0.25 * self.density * self.tau_s * np.exp(-self.rate * (d - 1.0) * length_s) * edge)

    def white_equivalent(self, length_s: float) -> float:
        """N T / 2: what a recursion has to add per interval to be right in the long run."""
        return 0.5 * self.density * length_s

    def shortfall(self, length_s: float) -> float:
        """Share by which Q1 lies below the white equivalent: (tau/T)(1 - exp(-k T))."""
        return -self.tau_s / length_s * math.expm1(-self.rate * length_s)

    def growth(self, length_s: float, intervals: int) -> float:
        """Variance of the integral over so many intervals, per interval: from Q1(T) for one towards N T / 2."""
        return self.same_interval(intervals * length_s) / intervals


@dataclass(frozen=True)
class Erratum:
    """A printed form, the right one, and what the printed one does."""

    place: str
    printed: str
    right: str
    effect: str


#: Errata of Vasilyuk (2019), section on the discrete noise and the transition; J inertial steps per fix.
ERRATA: Final = (
    Erratum("F6", "-T_P sum S_j", "-T_I sum S_j", "J times too large: each integral lasts one inertial step"),
    Erratum(
        "Q3, first form",
        "both inner integrals over [t_k-1, t_k]",
        "over the inertial intervals j and i",
        "J^2 times too large for a constant attitude",
    ),
    Erratum(
        "Q3, term i = j",
        "S_j Q1(T_P) S_i'",
        "S_j Q1(T_I) S_j'",
        "15 times too large for 40 Hz, T_I = 0.01 s, J = 10",
    ),
    Erratum(
        "Q2(i, j)",
        "exp(-k (i-j-1) T_P) (exp(-k T_P) - 1)^2",
        "|i - j| and T_I",
        "grows without bound for i < j: a factor of 1e22 to 1e109 for 40 Hz, T_P = 0.1 s, J = 10",
    ),
    Erratum("Q1", "diag(N_Gz, N_Gy, N_Gz)", "N_Gx first", "wrong for unequal axes"),
    Erratum(
        "F3, F7",
        "-T_P/tau with the biases held constant between fixes",
        "no decay for a random walk, or decay of the estimate too",
        "a constant bias keeps its size while its variance decays: over-confident by 3.5 to 4.4 in NEES",
    ),
)


def rotated_noise(c: Array, noise: tuple[BandLimited, ...], step_s: float, form: Form = "right") -> Array:
    """Covariance of the sum of rotated increments over J inertial steps: sum over j and i of C_j Q(|i-j|) C_i'.

    Parameters
    ----------
    c : ndarray, shape (J, 3, 3)
        Body to navigation axes in each step.
    noise : tuple of BandLimited
        Of the three axes.
    step_s : float
        Inertial step T_I, s.
    form : {"right", "printed"}
        ``"printed"``: the first form of Q3 as it stands, with both integrals over the whole interval.

    Returns
    -------
    ndarray, shape (3, 3)
    """
    steps = c.shape[0]
    if form == "printed":
        total = c.sum(axis=0)
        return np.asarray(total @ np.diag([n.same_interval(steps * step_s) for n in noise]) @ total.T)
    apart = np.abs(np.subtract.outer(np.arange(steps), np.arange(steps)))
    covariance = np.empty((steps, steps, 3))
    for axis, n in enumerate(noise):
        covariance[:, :, axis] = np.where(
            apart == 0, n.same_interval(step_s), n.distinct_intervals(step_s, np.maximum(apart, 1))
        )
    return np.asarray(np.einsum("jab,jib,icb->ac", c, covariance, c))


def gauss_markov_noise(sd: float, tau_s: float, length_s: float) -> float:
    """T k^2 with k = sqrt(2/tau) sd: what a first-order Gauss-Markov bias gains over an interval short against tau."""
    return 2.0 * sd**2 / tau_s * length_s


def transition(
    c: Array,
    theta: Array,
    nu: Array,
    step_s: float,
    tau_s: tuple[float, float],
    w_ie: Array,
    f6: Form = "right",
) -> Array:
    """First-order transition F_k over one interval between fixes, F1 to F8 of the publication.

    State: attitude alpha in body axes, gyro bias, velocity, accelerometer bias, position; errors truth minus estimate.

    Parameters
    ----------
    c : ndarray, shape (J, 3, 3)
        Body to ECEF axes at the end of each inertial step.
    theta, nu : ndarray, shape (J, 3)
        Bias-free increments of angle (rad) and velocity (m/s).
    step_s : float
        Inertial step T_I, s.
    tau_s : tuple of float
        Correlation times of the gyro and accelerometer biases, s; infinity drops F3 and F7.
    w_ie : ndarray, shape (3,)
        Earth rate in ECEF axes, rad/s.
    f6 : {"right", "printed"}
        The printed F6 is J times too large.

    Returns
    -------
    ndarray, shape (15, 15)
    """
    fix_s = c.shape[0] * step_s
    f = np.eye(15)
    f[0:3, 0:3] -= skew(theta.sum(axis=0))
    f[0:3, 3:6] = -fix_s * np.eye(3)
    f[3:6, 3:6] -= fix_s / tau_s[0] * np.eye(3)
    f[6:9, 0:3] = -np.einsum("jab,jbc->ac", c, np.array([skew(v) for v in nu]))
    f[6:9, 6:9] -= 2.0 * fix_s * skew(w_ie)
    f[6:9, 9:12] = -(fix_s if f6 == "printed" else step_s) * c.sum(axis=0)
    f[9:12, 9:12] -= fix_s / tau_s[1] * np.eye(3)
    f[12:15, 6:9] = fix_s * np.eye(3)
    return f


def process_noise(
    c: Array,
    gyro: tuple[BandLimited, ...],
    accel: tuple[BandLimited, ...],
    bias: tuple[float, float],
    step_s: float,
    f: Array | None = None,
    form: Literal["published", "closed", "white"] = "published",
) -> Array:
    """Q_k of the publication over one interval between fixes; state as in :func:`transition`.

    Parameters
    ----------
    c : ndarray, shape (J, 3, 3)
        Body to ECEF axes in each inertial step.
    gyro, accel : tuple of BandLimited
        Three axes each.
    bias : tuple of float
        k^2 of the gyro and accelerometer biases: (rad/s)^2/s and (m/s^2)^2/s.
    step_s : float
        Inertial step T_I, s.
    f : ndarray, shape (15, 15), optional
        Transition; with it Q_k = (F Q F' + Q)/2 has the cross terms, else it is block diagonal as published.
    form : {"published", "closed", "white"}
        ``"published"``: N T / 2 for the gyros, :func:`rotated_noise` for the accelerometers; ``"closed"``: Q1 for the
        gyros too; ``"white"``: N T / 2 for both.

    Returns
    -------
    ndarray, shape (15, 15)
    """
    fix_s = c.shape[0] * step_s
    q = np.zeros((15, 15))
    about = [n.same_interval(fix_s) if form == "closed" else n.white_equivalent(fix_s) for n in gyro]
    q[0:3, 0:3] = np.diag(about)
    if form != "white":
        q[6:9, 6:9] = rotated_noise(c, accel, step_s)
    else:
        white = np.diag([n.white_equivalent(step_s) for n in accel])
        q[6:9, 6:9] = np.einsum("jab,bc,jdc->ad", c, white, c)
    q[3:6, 3:6], q[9:12, 9:12] = fix_s * bias[0] * np.eye(3), fix_s * bias[1] * np.eye(3)
    return q if f is None else np.asarray(0.5 * (f @ q @ f.T + q))


def skew(v: Array) -> Array:
    """[v x], shape (3, 3)."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def worked_values(gyro: BandLimited, accel: BandLimited, fix_s: float = 0.1) -> dict[str, Any]:
    """Per interval between fixes: white equivalent and closed form of both sensors, and the share that is missing."""
    return {
        "fix_s": fix_s,
        "attitude_white_rad2": gyro.white_equivalent(fix_s),
        "attitude_closed_rad2": gyro.same_interval(fix_s),
        "velocity_white_m2_s2": accel.white_equivalent(fix_s),
        "velocity_closed_m2_s2": accel.same_interval(fix_s),
        "shortfall": accel.shortfall(fix_s),
    }
