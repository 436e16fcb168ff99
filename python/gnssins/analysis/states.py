"""The true errors of a filter's states, with the signs of its covariance: what NEES and ensembles are made of."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis.errors import NavErrors, Trajectory, compare
from gnssins.errors import InputError
from gnssins.tables import State

if TYPE_CHECKING:
    from gnssins.result import Result
    from gnssins.sim import Simulated

__all__ = ["ErrorStates", "Parameters", "error_states", "quadratic"]

Array = NDArray[np.float64]
Times = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Parameters:
    """True block states over time.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (k,)
        Epochs.
    blocks : mapping of str to ndarray, shape (k, p)
        True values by the name of the block, SI, columns in the order of its states.
    """

    t_ns: Times
    blocks: Mapping[str, Array]

    @classmethod
    def of(cls, simulated: Simulated) -> Parameters:
        """Take the true sensor errors of a simulated run."""
        return cls(simulated.truth.t_ns, simulated.truth_blocks)

    def by_state(self, states: Sequence[State]) -> dict[str, Array]:
        """True values (k,) by name of the state, for the states whose block is known."""
        found: dict[str, Array] = {}
        seen: Counter[str] = Counter()
        for state in states:
            values = self.blocks.get(state.block)
            if values is not None:
                found[state.name] = values[:, seen[state.block]]
                seen[state.block] += 1
        return found


@dataclass(frozen=True, eq=False)
class ErrorStates:
    """True errors of all states of a filter at the epochs of its covariance snapshots.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (c,)
        Epochs.
    x : ndarray, shape (c, n)
        Errors with the signs of the covariance: navigation estimate minus truth, blocks truth minus estimate, SI; NaN
        where the truth of a block is not known.
    matrix : ndarray, shape (c, n, n)
        Covariance that the filter claims.
    groups : mapping of str to list of int
        Indices of the states by group, as in :class:`Nees`.
    navigation : NavErrors
        Errors of the navigation states at these epochs, with Euler angles.
    """

    t_ns: Times
    x: Array
    matrix: Array
    groups: Mapping[str, list[int]]
    navigation: NavErrors

    @property
    def sd(self) -> Array:
        """Standard deviations that the filter claims, shape (c, n)."""
        return np.asarray(np.sqrt(np.einsum("kii->ki", self.matrix)))

    def nees(self, index: Sequence[int]) -> Array:
        """NEES of some of the states, shape (c,)."""
        return quadratic(self.x[:, index], self.matrix[:, index][:, :, index])


def error_states(
    result: Result,
    truth: Trajectory,
    parameters: Parameters | None = None,
    *,
    ellipsoid: str | None = None,
) -> ErrorStates:
    """Find the true errors behind the covariance snapshots of a run; parameters and errors as in :func:`nees`."""
    if not result.covariance.t_ns.size:
        raise InputError(
            "input.no_covariance",
            "the run kept no covariance matrices",
            "set [run] covariance_interval_s",
        )
    found = compare(result, truth, ellipsoid=ellipsoid or str(result.metadata.get("ellipsoid", "wgs84")))
    epochs, at_found, at_cov = np.intersect1d(
        found.t_ns, result.covariance.t_ns, assume_unique=True, return_indices=True
    )
    epochs, at_result, again = np.intersect1d(result.t_ns, epochs, assume_unique=True, return_indices=True)
    if not epochs.size:
        raise InputError(
            "input.no_overlap",
            "no covariance snapshot at an epoch of both the result and the truth",
            "make covariance_interval_s a multiple of the output interval, and the truth cover the run",
        )
    rows = at_found[again]
    known = parameters.by_state(result.block_states) if parameters is not None else {}
    have = parameters.t_ns if parameters is not None else result.t_ns
    return ErrorStates(
        t_ns=epochs,
        x=_error_vector(result, found, rows, at_result, have, known),
        matrix=result.covariance.matrix[at_cov[again]],
        groups=_groups(result, known),
        navigation=found.rows(rows),
    )


def _error_vector(
    result: Result,
    found: NavErrors,
    at_found: NDArray[np.intp],
    at_result: NDArray[np.intp],
    have: Times,
    known: Mapping[str, Array],
) -> Array:
    """True error state (c, n) with the signs of the covariance; NaN where a parameter is unknown."""
    t_ns = result.t_ns[at_result]
    blocks = np.full((t_ns.size, len(result.block_states)), np.nan)
    for i, state in enumerate(result.block_states):
        if state.name in known:
            true = np.interp(t_ns - have[0], have - have[0], known[state.name])
            blocks[:, i] = true - result.x[at_result, i]
    return np.column_stack([found.phi[at_found], found.velocity[at_found], found.position[at_found], blocks])


def _groups(result: Result, known: Mapping[str, Array]) -> dict[str, list[int]]:
    """Indices of the states by group, unknown ones left out."""
    groups: dict[str, list[int]] = {}
    if result.block_states and all(s.name in known for s in result.block_states):
        groups["all"] = list(range(len(result.states)))
    groups["navigation"] = list(range(9))
    groups["attitude"], groups["velocity"], groups["position"] = [0, 1, 2], [3, 4, 5], [6, 7, 8]
    for i, state in enumerate(result.block_states, start=9):
        if state.name in known:
            groups.setdefault(state.block, []).append(i)
    return groups


def quadratic(x: Array, matrix: Array) -> Array:
    """x' P^-1 x of every row, P scaled to a correlation matrix first."""
    sd = np.sqrt(np.einsum("kii->ki", matrix))
    scaled = x / sd
    correlation = matrix / (sd[:, :, None] * sd[:, None, :])
    solved = np.linalg.solve(correlation, scaled[:, :, None])[:, :, 0]
    return np.asarray(np.einsum("ki,ki->k", scaled, solved))
