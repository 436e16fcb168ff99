"""Covariance analysis of the filter of Novik (2011): what its misprints do, and how an outage grows.

Two covariances run side by side: the one that a filter with a misprint claims, and the one that its errors have. In a
closed loop every estimate is fed back at once, so the errors move as the INS does whatever the filter believes:

    P- = Phi_f P Phi_f' + Q_f        M- = Phi M Phi' + Q
    K  = P- H' (H P- H' + R)^-1      M  = (I - K H) M- (I - K H)' + K R K'

Gelb (ed., 1974), section 7.2. This is why a closed loop hides wrong elements of F: they only spoil the gain.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gnssins.reproduce.covariances import corrected, gain
from gnssins.reproduce.novik_matrices import (
    ERRATA,
    Motion,
    initial_covariance,
    jump_covariance,
    observation,
    transition,
)
from gnssins.sim import Scenario

__all__ = ["FILTERS", "Honest", "Outcome", "honest", "outcomes"]

Array = NDArray[np.float64]

#: Filters that differ in something else than one element of F.
_OTHERS: Final = {
    "22*": "f23 = +lat R0/R: the angle for its rate",
    "32": "G dt for G sqrt(dt) of the INS, filter at 10 Hz",
    "33": "row 8 kept, with a diagonal R",
    "white": "no misprint: slow GNSS errors taken for white noise",
}

#: All filters that are analysed, right one first.
FILTERS: Final[Mapping[str, str]] = {"": "all right", **ERRATA, **_OTHERS}


@dataclass(frozen=True, eq=False)
class Honest:
    """The right filter, second by second; s seconds.

    Parameters
    ----------
    covariance : ndarray, shape (s + 1, 22, 22)
        After the update at each second, the start first; reduced coordinates.
    ground : ndarray, shape (s + 1, 3)
        Factors from reduced coordinates to metres on the ground.
    """

    scenario: Scenario
    covariance: Array
    ground: Array

    def sd(self, time_s: int) -> Array:
        """Standard deviations (22,) at a second, positions on the ground."""
        sd = np.sqrt(np.diag(self.covariance[time_s]))
        sd[:3] *= self.ground[time_s]
        sd[16:19] *= self.ground[time_s]
        return np.asarray(sd)

    def growth(self, start_s: int, length_s: int) -> Array:
        """Standard deviation of the growth of the position error E, N, h (m) without GNSS, barometer on.

        Growth is the error at ``start_s + length_s`` less that at ``start_s``, the epoch of the last fix.
        """
        first = self.covariance[start_s]
        p, cross = first.copy(), first.copy()
        steps = np.arange(start_s, start_s + length_s, dtype=np.float64)
        phi, q = transition(Motion.of(self.scenario, steps + 0.5), 1.0)
        motion = Motion.of(self.scenario, steps + 1.0)
        h, noise = observation(motion, np.zeros(length_s, dtype=np.bool_))
        for k in range(length_s):
            p, cross = phi[k] @ p @ phi[k].T + q[k], phi[k] @ cross
            r = noise[k, :1] @ noise[k, :1].T
            taken = gain(p, h[:1], r)
            p = corrected(p, taken, h[:1], r)
            cross = cross - taken @ h[:1] @ cross
        # on the ground at the end: the factors differ by 1e-5 of an error of some metres
        grown = (p + first - cross - cross.T)[:3, :3]
        return np.asarray(np.sqrt(np.diag(grown)) * motion.ground[-1])


def _epochs(scenario: Scenario, seconds: int) -> tuple[Motion, Motion, NDArray[np.bool_]]:
    """Middles of the seconds, their ends, and which of these have a new constellation."""
    steps = np.arange(seconds, dtype=np.float64)
    changes = scenario.gnss.constellation_changes if scenario.gnss is not None else ()
    changed = np.isin(np.arange(1, seconds + 1), np.ceil(changes))
    return Motion.of(scenario, steps + 0.5), Motion.of(scenario, steps + 1.0), changed


def honest(scenario: Scenario, seconds: int) -> Honest:
    """Run the right filter with its seven observations."""
    middle, ends, changed = _epochs(scenario, seconds)
    phi, q = transition(middle, 1.0)
    q += np.where(changed[:, None, None], jump_covariance(ends), 0.0)
    h, noise = observation(ends, changed)
    h, r = h[:7], noise[:, :7] @ np.swapaxes(noise[:, :7], 1, 2)
    start = Motion.of(scenario, np.zeros(1))
    p = initial_covariance(start)
    every = [p]
    for k in range(seconds):
        p = phi[k] @ p @ phi[k].T + q[k]
        p = corrected(p, gain(p, h, r[k]), h, r[k])
        every.append(p)
    return Honest(scenario, np.array(every), np.vstack([start.ground, ends.ground]))


@dataclass(frozen=True)
class Outcome:
    """Standard deviations at the end: actual and claimed by the filter.

    Positions E, N, h on the ground (m), tilt (rad, the greater), heading (rad); the largest actual position error on
    any axis after 100 s; the expected NEES of the nine navigation errors, 9 for an honest filter.
    """

    position: tuple[Array, Array]
    tilt: tuple[float, float]
    heading: tuple[float, float]
    worst_position_m: float
    nees: float


def outcomes(scenario: Scenario, seconds: int, names: Sequence[str] = tuple(FILTERS)) -> dict[str, Outcome]:
    """Run filters with misprints through the flight.

    Parameters
    ----------
    scenario : Scenario
        Of the publication.
    seconds : int
        Length.
    names : sequence of str
        Of :data:`FILTERS`.

    Returns
    -------
    dict of str to Outcome
        A filter whose covariance breaks down has infinite figures.
    """
    middle, ends, changed = _epochs(scenario, seconds)
    phi, q = transition(middle, 1.0)
    jump = np.where(changed[:, None, None], jump_covariance(ends), 0.0)
    h, noise = observation(ends, changed)
    start = Motion.of(scenario, np.zeros(1))
    first = initial_covariance(start)
    truth = (phi, q + jump)
    out = {}
    for name in names:
        model = transition(middle, 1.0, (name,)) if name in ERRATA else (phi, q)
        out[name] = _fly(_Filter.of(name, model, jump, h, noise, first), truth, h, noise, first, ends)
    return out


@dataclass(frozen=True, eq=False)
class _Filter:
    """What one filter believes: transition, process noise, rows that it uses, their noise, start."""

    phi: Array
    q: Array
    rows: int
    r: Array
    start: Array

    @classmethod
    def of(
        cls, name: str, model: tuple[Array, Array], jump: Array, h: Array, noise: Array, first: Array
    ) -> _Filter:
        phi, q = model[0], model[1] + jump
        rows = 8 if name == "33" else 7
        r = noise[:, :rows] @ np.swapaxes(noise[:, :rows], 1, 2)
        start = first.copy()
        if name == "22*":
            phi = phi.copy()
            phi[:, 1, 2] = 0.96  # the latitude, rad, times R0/R and one second
        if name == "32":
            # printed for the noise of the INS; that of barometer and receiver has its own, right form
            q = q.copy()
            q[:, :15, :15] *= 0.1
        if name == "33":
            r = r * np.eye(8)
        if name == "white":
            q, r = q.copy(), r.copy()
            slow = np.diag(first)[16:]
            q[:, 16:, 16:] = start[16:, 16:] = 0.0
            r[:, range(1, 7), range(1, 7)] += slow
        return cls(phi, q, rows, r, start)


def _fly(
    own: _Filter, truth: tuple[Array, Array], h: Array, noise: Array, first: Array, ends: Motion
) -> Outcome:
    phi, q = truth
    rows = own.rows
    real = noise[:, :rows] @ np.swapaxes(noise[:, :rows], 1, 2)
    p, m = own.start.copy(), first.copy()
    ground, worst = ends.ground, 0.0
    with np.errstate(all="ignore"):
        for k in range(len(phi)):
            p = own.phi[k] @ p @ own.phi[k].T + own.q[k]
            m = phi[k] @ m @ phi[k].T + q[k]
            taken = gain(p, h[:rows], own.r[k])
            p = corrected(p, taken, h[:rows], own.r[k])
            m = corrected(m, taken, h[:rows], real[k])
            if k >= 100:
                worst = max(worst, float((np.sqrt(np.abs(np.diag(m)[:3])) * ground[k]).max()))
        nav = slice(0, 9)
        nees = float(np.trace(np.linalg.solve(p[nav, nav], m[nav, nav])))
        actual, claimed = (np.sqrt(np.abs(np.diag(x)[:9])) for x in (m, p))
    return Outcome(
        position=(actual[:3] * ground[-1], claimed[:3] * ground[-1]),
        tilt=(float(actual[6:8].max()), float(claimed[6:8].max())),
        heading=(float(actual[8]), float(claimed[8])),
        worst_position_m=worst,
        nees=nees,
    )
