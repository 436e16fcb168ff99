"""Slow errors of the receiver: correlated over time and distance, with jumps when the satellites change.

Each error is the sum of two parts. One is a stationary first-order Gauss-Markov process of rate
``1/tau + V_ground/distance``: from one epoch to the next it keeps the share ``exp(-(dt/tau + ds/distance))``.
The other holds the jumps: each is drawn when the satellites change, enters with the first fix from then on,
and fades by the same rate. The sum obeys the recursion of the error model from fix to fix exactly, however the
two sampling rates go together; without jumps it is the stationary process alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..units import seconds_to_ns
from .aid_config import CorrelatedPosition, CorrelatedVelocity, Gnss
from .processes import gauss_markov, gauss_markov_varying
from .streams import Streams
from .trajectory import Trajectory

__all__ = ["SlowError", "change_rows", "fading", "slow_errors"]

Array = NDArray[np.float64]
Times = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SlowError:
    """One slow error of a run.

    Attributes
    ----------
    t_ns : ndarray of int64, shape (n,)
        Epochs of the truth.
    stationary : ndarray, shape (n, 3)
        Gauss-Markov part at the epochs.
    decay : ndarray, shape (n,)
        Integral of the rate from the start to the epochs; a value fades by the exponential of its growth.
    jump_ns : ndarray of int64, shape (j,)
        Times of validity of the fixes with which the jumps enter.
    jumps : ndarray, shape (j, 3)
        The jumps.
    """

    t_ns: Times
    stationary: Array
    decay: Array
    jump_ns: Times
    jumps: Array

    def at(self, t_ns: Times) -> Array:
        """Error at any times inside the truth, shape (m, 3).

        The stationary part is linear between epochs; a jump counts from its own time on.
        """
        value = np.column_stack([np.interp(t_ns, self.t_ns, axis) for axis in self.stationary.T])
        return value + self._jumped(t_ns)

    def history(self) -> Array:
        """Error at the epochs of the truth, shape (n, 3)."""
        return self.stationary + self._jumped(self.t_ns) if len(self.jump_ns) else self.stationary

    def _jumped(self, t_ns: Times) -> Array:
        total = np.zeros((len(t_ns), 3))
        decay = np.interp(t_ns, self.t_ns, self.decay)
        for jump_ns, jump in zip(self.jump_ns, self.jumps, strict=True):
            after = t_ns >= jump_ns
            faded = np.exp(np.interp(jump_ns, self.t_ns, self.decay) - decay[after])
            total[after] += faded[:, np.newaxis] * jump
        return total


def change_rows(t_ns: Times, changes_s: Sequence[float]) -> NDArray[np.intp]:
    """Row of the first fix at or after each change of the satellites, without those after the last fix.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (m,)
        Times of validity, ascending.
    changes_s : sequence of float
        Times of the changes, s.

    Returns
    -------
    ndarray of int, shape (j,)
        Ascending, each row once: two changes between two fixes are one.
    """
    changes_ns = np.array([seconds_to_ns(change) for change in changes_s], dtype=np.int64)
    rows = np.unique(np.searchsorted(t_ns, changes_ns))
    return rows[rows < len(t_ns)]


def slow_errors(trajectory: Trajectory, gnss: Gnss, t_ns: Times, streams: Streams) -> dict[str, SlowError]:
    """Draw the slow errors of position and velocity of one run.

    Parameters
    ----------
    trajectory : Trajectory
        Truth.
    gnss : Gnss
        Receiver figures.
    t_ns : ndarray of int64, shape (m,)
        Times of validity of all fixes, those in outages included.
    streams : Streams
        Random numbers of the run.

    Returns
    -------
    dict of str to SlowError
        ``gnss_position_error`` (m) and ``gnss_velocity_error`` (m/s), measured minus true along north, east,
        down; only those that the scenario has.
    """
    jump_ns = t_ns[change_rows(t_ns, gnss.constellation_changes)]
    errors: dict[str, SlowError] = {}
    if gnss.position_error is not None:
        own = gnss.position_error
        sds = np.asarray(own.sd_m), np.asarray(own.jump_sd_m)
        errors["gnss_position_error"] = _draw("gnss.position_error", trajectory, own, *sds, jump_ns, streams)
    if gnss.velocity_error is not None:
        other = gnss.velocity_error
        sds = np.asarray(other.sd_m_s), np.asarray(other.jump_sd_m_s)
        errors["gnss_velocity_error"] = _draw(
            "gnss.velocity_error", trajectory, other, *sds, jump_ns, streams
        )
    return errors


def fading(trajectory: Trajectory, figures: CorrelatedPosition | CorrelatedVelocity) -> Array:
    """Integral of the rate of an error over each interval of the truth, shape (n - 1,)."""
    growth = trajectory.dt_s / figures.tau_s
    if figures.distance_m is None:
        return growth
    ground = np.hypot(trajectory.v_n[:, 0], trajectory.v_n[:, 1])
    return np.asarray(growth + 0.5 * (ground[1:] + ground[:-1]) * trajectory.dt_s / figures.distance_m)


def _draw(
    name: str,
    trajectory: Trajectory,
    figures: CorrelatedPosition | CorrelatedVelocity,
    sd: Array,
    jump_sd: Array,
    jump_ns: Times,
    streams: Streams,
) -> SlowError:
    growth = fading(trajectory, figures)
    if figures.distance_m is None:
        dt_s = float(np.mean(trajectory.dt_s))
        stationary = gauss_markov(streams(name), len(trajectory), dt_s, sd, figures.tau_s)
    else:
        stationary = gauss_markov_varying(streams(name), growth, sd)
    decay = np.concatenate([[0.0], np.cumsum(growth)])
    if not np.any(jump_sd):
        jump_ns = jump_ns[:0]
    jumps = streams(f"{name}.jump").standard_normal((len(jump_ns), 3)) * jump_sd
    return SlowError(trajectory.t_ns, stationary, decay, jump_ns, jumps)
