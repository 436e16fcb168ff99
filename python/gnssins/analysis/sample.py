"""What one filtered run tells an ensemble: errors and sigmas at some epochs, over some spans, NEES and NIS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis.consistency import NisGroup, nis
from gnssins.analysis.states import ErrorStates, Parameters, error_states
from gnssins.errors import InputError
from gnssins.tables import State, seconds

if TYPE_CHECKING:
    from gnssins.result import Result
    from gnssins.sim import Simulated

__all__ = ["NEAR_S", "Sample", "sample_run"]

Array = NDArray[np.float64]
Windows = Sequence[tuple[float, float]]

#: A snapshot of the covariance stands for an epoch that was asked for if it is no further away than this, s.
NEAR_S: Final = 0.05


@dataclass(frozen=True, eq=False)
class Sample:
    """What one run leaves to an :class:`gnssins.analysis.Ensemble`; shapes without their axis of runs, see there."""

    time_s: Array
    states: tuple[State, ...]
    errors: Array
    sigmas: Array
    euler: Array
    euler_sigmas: Array
    nees: Mapping[str, Array]
    dof: Mapping[str, int]
    nis: Mapping[str, NisGroup]
    windows: tuple[tuple[float, float], ...]
    window_rms: Array
    window_max: Array
    window_sigma: Array
    counts: Mapping[str, int]


def sample_run(
    result: Result,
    simulated: Simulated,
    *,
    at_s: Sequence[float] | None = None,
    windows: Windows = (),
    after_s: float | None = None,
) -> Sample:
    """Take from one filtered run what an ensemble needs; arguments as in :func:`gnssins.analysis.ensemble`.

    Raises
    ------
    InputError
        ``input.no_truth``, ``input.no_covariance``; ``input.epoch``: an epoch or a span without a snapshot.
    """
    found = error_states(result, simulated.truth, Parameters.of(simulated))
    time_s = seconds(found.t_ns)
    rows = _rows(time_s, at_s)
    x, sd = found.x.copy(), found.sd
    x[:, 9:] *= -1.0
    spans = [_span(x, sd, time_s, window) for window in windows]
    shape = (len(spans), x.shape[1])
    return Sample(
        time_s=time_s[rows] if at_s is None else np.asarray(at_s, dtype=np.float64),
        states=result.states,
        errors=x[rows],
        sigmas=sd[rows],
        euler=found.navigation.euler[rows],
        euler_sigmas=found.navigation.sd[rows, 6:9],
        nees=_nees(found, rows),
        dof={name: len(index) for name, index in found.groups.items()},
        nis=nis(result, after_s=after_s).groups,
        windows=tuple((float(first), float(last)) for first, last in windows),
        window_rms=np.array([span[0] for span in spans]).reshape(shape),
        window_max=np.array([span[1] for span in spans]).reshape(shape),
        window_sigma=np.array([span[2] for span in spans]).reshape(shape),
        counts=result.counts["gnss"],
    )


def _nees(found: ErrorStates, rows: NDArray[np.intp]) -> dict[str, Array]:
    part = ErrorStates(
        found.t_ns[rows], found.x[rows], found.matrix[rows], found.groups, found.navigation.rows(rows)
    )
    return {name: part.nees(index) for name, index in part.groups.items()}


def _rows(time_s: Array, at_s: Sequence[float] | None) -> NDArray[np.intp]:
    """Snapshot of each epoch: the nearest one, which must be near."""
    if at_s is None:
        return np.arange(time_s.size)
    wanted = np.asarray(at_s, dtype=np.float64)
    after = np.clip(np.searchsorted(time_s, wanted), 1, max(time_s.size - 1, 1))
    after = np.minimum(after, time_s.size - 1)
    before = np.maximum(after - 1, 0)
    near = np.where(np.abs(time_s[before] - wanted) <= np.abs(time_s[after] - wanted), before, after)
    far = np.abs(time_s[near] - wanted) > NEAR_S
    if far.any():
        raise InputError(
            "input.epoch",
            f"{int(far.sum())} of {wanted.size} epochs have no covariance snapshot, first {wanted[far][0]:g} s; there "
            f"are {time_s.size} from {time_s[0]:g} s to {time_s[-1]:g} s",
            "choose multiples of [run] covariance_interval_s inside the run",
            {"at_s": wanted[far].tolist()},
        )
    return np.asarray(near, dtype=np.intp)


def _span(x: Array, sd: Array, time_s: Array, window: tuple[float, float]) -> tuple[Array, Array, Array]:
    """Root mean square and largest error, root mean square sigma over one span."""
    inside = (time_s > window[0]) & (time_s < window[1])
    if not inside.any():
        raise InputError(
            "input.epoch",
            f"no covariance snapshot in {window[0]:g} s < t < {window[1]:g} s",
            "choose a span inside the run, longer than [run] covariance_interval_s",
        )
    part = x[inside]
    return rms_of(part), np.abs(part).max(axis=0), rms_of(sd[inside])


def rms_of(values: Array) -> Array:
    """Root mean square over the first axis, NaN where one is."""
    return np.asarray(np.sqrt(np.mean(values * values, axis=0)))
