"""Which states the measurements of a stretch of path determine, and which they leave open: observability along a path.

Over a sliding window of fixes the rows of all measurements are referred to the first epoch of the window,

    O = [ H_1 ; H_2 Phi_2 ; H_3 Phi_3 Phi_2 ; ... ; H_p Phi_p ... Phi_2 ]

and decomposed, O = U L V'. Singular values below a threshold count as zero; their columns of V span the
unobservable subspace. A state is flagged if the projection of its unit vector on that subspace is longer than
``flag``. Vasilyuk (2019), with its equation (12) in the corrected form: the window begins at H_1, and no transition
leads out of it.

The threshold of the publication, 0.025, is tied to SI units (rad, rad/s, m, m/s, m/s^2) and to 31 fixes: it is an rms
displacement of the antenna of 0.025 / sqrt(31) = 4.5 mm per unit of state. The second form, ``scaling="sigma"``, has no
units: columns times the prior standard deviation, rows over the standard deviation of the measurement, threshold 1.
A direction then counts as observable if the window tells more about it than was known at the start.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import text
from gnssins.analysis.stacking import TOLERANCE_NS, AttitudeAxes, Linear, basis_of, rows_of, stack, windows
from gnssins.errors import InputError
from gnssins.result import Result
from gnssins.runner import as_config, run
from gnssins.tables import State, seconds
from gnssins.units import NS_PER_S

if TYPE_CHECKING:
    from gnssins.config import Config
    from gnssins.dataset import Dataset
    from gnssins.sim import Simulated

__all__ = [
    "PUBLISHED_FIXES",
    "PUBLISHED_FLAG",
    "PUBLISHED_THRESHOLD",
    "Linear",
    "Observability",
    "observability",
]

Array = NDArray[np.float64]
Scaling = Literal["si", "sigma"]

#: Smallest singular value that counts, SI units, and the number of fixes that it belongs to: Vasilyuk (2019).
PUBLISHED_THRESHOLD: Final = 0.025
PUBLISHED_FIXES: Final = 31

#: Length of the projection on the unobservable subspace from which on a state is flagged: Vasilyuk (2019).
PUBLISHED_FLAG: Final = 0.5

#: Windows that are decomposed at once: bounds the memory.
_CHUNK: Final = 256

_NAMES: Final[dict[str, tuple[str, str, str]]] = {
    "body": ("x", "y", "z"),
    "ned": ("n", "e", "d"),
    "ecef": ("ecef_x", "ecef_y", "ecef_z"),
}


@dataclass(frozen=True, eq=False)
class Observability:
    """Rank and unobservable states over time; k windows, n states.

    Parameters
    ----------
    t_s : ndarray, shape (k,)
        Last fix of each window, s.
    first_s : ndarray, shape (k,)
        First fix of each window, s: the errors are those of this epoch.
    fixes : ndarray of int, shape (k,)
        Measurement epochs in each window.
    rank : ndarray of int, shape (k,)
        Singular values of at least ``threshold``.
    singular_values : ndarray, shape (k, n)
        Descending; zeros where a window has fewer rows than there are states.
    projection : ndarray, shape (k, n)
        Length of the projection of each unit vector on the unobservable subspace, 0 to 1.
    flags : ndarray of bool, shape (k, n)
        Projection longer than ``flag``: the state is unobservable over that window.
    states : tuple of State
        The n states; attitude named by the axes it is given in, such as ``"phi_z"`` for body axes.
    threshold, flag : float
        As used.
    scaling : {"si", "sigma"}
        Whether the threshold is in SI units or in standard deviations.
    attitude_axes : {"body", "ned", "model"}
        Axes of the attitude error.
    """

    t_s: Array
    first_s: Array
    fixes: NDArray[np.intp]
    rank: NDArray[np.intp]
    singular_values: Array
    projection: Array
    flags: NDArray[np.bool_]
    states: tuple[State, ...]
    threshold: float
    flag: float
    scaling: Scaling
    attitude_axes: AttitudeAxes

    def __len__(self) -> int:
        return int(self.t_s.size)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the states, in the order of the columns."""
        return tuple(state.name for state in self.states)

    @property
    def share_flagged(self) -> dict[str, float]:
        """Share of the windows in which each state is flagged."""
        return dict(zip(self.names, self.flags.mean(axis=0).tolist(), strict=True))

    @property
    def ever_flagged(self) -> tuple[str, ...]:
        """States that are flagged in at least one window."""
        return tuple(
            name for name, hit in zip(self.names, self.flags.any(axis=0).tolist(), strict=True) if hit
        )

    def ranks(self) -> dict[int, float]:
        """Share of the windows by rank, ascending."""
        values, counts = np.unique(self.rank, return_counts=True)
        return {int(v): float(c) / len(self) for v, c in zip(values, counts, strict=True)}

    def flag_sets(self) -> dict[tuple[str, ...], float]:
        """Share of the windows by the set of flagged states, most frequent first."""
        sets = Counter(tuple(n for n, hit in zip(self.names, row, strict=True) if hit) for row in self.flags)
        return {names: count / len(self) for names, count in sets.most_common()}

    def between(self, start_s: float, end_s: float) -> Observability:
        """Only the windows that lie wholly within ``start_s`` and ``end_s``."""
        slack = TOLERANCE_NS / NS_PER_S
        return self.select((self.first_s >= start_s - slack) & (self.t_s <= end_s + slack))

    def select(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> Observability:
        """Only some windows, by mask or indices."""
        names = ("t_s", "first_s", "fixes", "rank", "singular_values", "projection", "flags")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    def table(self, title: str = "") -> str:
        """One line per state; the ranks below."""
        _refuse_empty(len(self))
        low, high = self.projection.min(axis=0), self.projection.max(axis=0)
        middle = np.median(self.projection, axis=0)
        rows = [
            [s.name, s.unit, f"{100 * share:.0f} %", f"{a:.2f}", f"{b:.2f}", f"{c:.2f}"]
            for s, share, a, b, c in zip(self.states, self.flags.mean(axis=0), low, middle, high, strict=True)
        ]
        ranks = ", ".join(f"{rank}: {100 * share:.0f} %" for rank, share in self.ranks().items())
        unit = "SI" if self.scaling == "si" else "sigma"
        span = f"{len(self)} windows, {self.first_s[0]:.1f} to {self.t_s[-1]:.1f} s"
        title = title or f"Observability ({span}, threshold {self.threshold:g} {unit})"
        head = ["state", "unit", "flagged", "projection min", "median", "max"]
        return text.table(title, head, rows, f"rank of {len(self.states)}: {ranks}", left=(0, 1))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers: settings, ranks, flags by state."""
        _refuse_empty(len(self))
        return {
            "windows": len(self),
            "start_s": float(self.first_s[0]),
            "end_s": float(self.t_s[-1]),
            "fixes_per_window": [int(self.fixes.min()), int(self.fixes.max())],
            "threshold": self.threshold,
            "flag": self.flag,
            "scaling": self.scaling,
            "attitude_axes": self.attitude_axes,
            "states": list(self.names),
            "rank_share": {str(rank): share for rank, share in self.ranks().items()},
            "flagged_share": self.share_flagged,
            "projection_median": dict(
                zip(self.names, np.median(self.projection, axis=0).tolist(), strict=True)
            ),
        }


def observability(
    source: Result | Linear | Config | Mapping[str, Any] | str | os.PathLike[str],
    data: Dataset | Simulated | None = None,
    *,
    window: int = PUBLISHED_FIXES,
    window_s: float | None = None,
    threshold: float | None = None,
    flag: float = PUBLISHED_FLAG,
    attitude_axes: AttitudeAxes = "body",
    scaling: Scaling = "si",
    prior_sd: Array | None = None,
) -> Observability:
    """Observability of every state over a sliding window, for any configuration.

    Parameters
    ----------
    source : Result, linearisation, Config, mapping or path
        A result with ``linearisation``, the linearisation itself, or a configuration, which is run with
        ``[run] linearise = true``.
    data : Dataset or Simulated, optional
        For a configuration: what to process; left out: the files that it names.
    window : int
        Measurements per window; one of each source where there is more than GNSS.
    window_s : float, optional
        Length of the window in seconds instead; the window then has as many fixes as fall into it.
    threshold : float, optional
        Smallest singular value that counts; left out: 0.025 for ``"si"`` (published, for 31 fixes), 1 for ``"sigma"``.
    flag : float
        Projection from which on a state is flagged.
    attitude_axes : {"body", "ned", "model"}
        Axes of the attitude error at the first epoch of the window. ``"body"``, as published: C_true = C_est
        Exp(alpha), so alpha = C_est' phi. ``"ned"``: phi along north, east, down. Velocity and position are along
        north, east, down in both. ``"model"``: all nine as the model has them. Signs do not matter to rank, projection
        and flags.
    scaling : {"si", "sigma"}
        SI units, or columns times prior standard deviation and rows over that of the measurement.
    prior_sd : ndarray, shape (n,), optional
        For ``"sigma"``: standard deviations of attitude (about), velocity and position (along north, east, down), then
        of the blocks; left out: those of the start of the run.

    Returns
    -------
    Observability

    Raises
    ------
    InputError
        ``input.no_linearisation``: the result has none. ``input.window``: a window that no stretch of the run fills.
        ``input.no_prior``: a linearisation alone does not tell the prior. ``input.axes``, ``input.scaling``,
        ``input.threshold``: no such choice.
    """
    _refuse_choices(attitude_axes, scaling, window, window_s, threshold, flag)
    linear, start = _linear(source, data)
    limit = threshold if threshold is not None else (PUBLISHED_THRESHOLD if scaling == "si" else 1.0)
    if linear.axes not in ("ned", "ecef"):
        raise InputError("input.axes", f'a linearisation with axes "{linear.axes}"', 'one of: "ned", "ecef"')
    n = len(linear.states)
    sd = None
    if scaling == "sigma":
        sd = _prior(start if prior_sd is None else prior_sd, n)
    first, last = windows(linear.t_ns, window, window_s)
    rows = rows_of(linear, whiten=scaling == "sigma")
    count = first.size
    values, projection = np.zeros((count, n)), np.empty((count, n))
    rank = np.empty(count, dtype=np.intp)
    for begin in range(0, count, _CHUNK):
        part = slice(begin, begin + _CHUNK)
        basis = basis_of(linear, first[part], attitude_axes, sd)
        stacked = stack(linear, rows, first[part], last[part], basis)
        # O = Q R with orthonormal Q: R has the same singular values and the same V
        _, s, vt = np.linalg.svd(np.linalg.qr(stacked, mode="r"))
        values[part] = s
        rank[part] = (s >= limit).sum(axis=1)
        open_ = np.arange(n) >= rank[part, None]
        projection[part] = np.sqrt(np.einsum("kj,kjs->ks", open_.astype(np.float64), vt * vt))
    projection = np.minimum(projection, 1.0)
    return Observability(
        t_s=seconds(linear.t_ns[last]),
        first_s=seconds(linear.t_ns[first]),
        fixes=last - first + 1,
        rank=rank,
        singular_values=values,
        projection=projection,
        flags=projection > flag,
        states=_named(linear, attitude_axes),
        threshold=limit,
        flag=flag,
        scaling=scaling,
        attitude_axes=attitude_axes,
    )


def _refuse_empty(count: int) -> None:
    if not count:
        raise InputError("input.no_overlap", "no window in this stretch", "take a longer one")


def _refuse_choices(
    axes: str, scaling: str, window: int, window_s: float | None, threshold: float | None, flag: float
) -> None:
    for name, value, known in (
        ("attitude_axes", axes, get_args(AttitudeAxes)),
        ("scaling", scaling, get_args(Scaling)),
    ):
        if value not in known:
            code = "input.axes" if name == "attitude_axes" else "input.scaling"
            raise InputError(code, f'{name} = "{value}" is unknown', f"one of: {', '.join(known)}")
    length, unit = (window, "fixes") if window_s is None else (window_s, "s")
    if not length > 0 or (window_s is not None and not np.isfinite(window_s)):
        raise InputError("input.window", f"a window of {length:g} {unit}", "give a positive length")
    if (threshold is not None and not threshold > 0.0) or not 0.0 < flag < 1.0:
        raise InputError(
            "input.threshold",
            f"threshold = {threshold}, flag = {flag:g}",
            "the threshold is positive, the flag lies between 0 and 1",
        )


def _linear(source: Any, data: Dataset | Simulated | None) -> tuple[Linear, Array | None]:
    """The linearisation, and the standard deviations of the start (n,) if they are known."""
    if not isinstance(source, Result):
        if all(hasattr(source, name) for name in ("phi", "h", "q_nb")):
            return source, None
        config = as_config(source).replace(run={"linearise": True})
        source = run(config, data)
    linear = getattr(source, "linearisation", None)
    if linear is None:
        raise InputError(
            "input.no_linearisation",
            "the run kept no linearised model",
            "set [run] linearise = true, or hand over the configuration and the data",
        )
    engine = json.loads(source.metadata["engine"]["json"])
    start = [engine["initial"][key] for key in ("sd_phi", "sd_v", "sd_p")]
    blocks = [block["initial_sd"] for block in engine["blocks"]]
    return linear, np.concatenate([np.ravel(part) for part in (*start, *blocks)]).astype(np.float64)


def _prior(sd: Array | None, n: int) -> Array:
    if sd is None:
        raise InputError(
            "input.no_prior",
            "a linearisation alone does not tell the prior",
            "give prior_sd, or the whole result",
        )
    sd = np.asarray(sd, dtype=np.float64)
    if sd.shape != (n,) or not (np.isfinite(sd) & (sd >= 0.0)).all():
        raise InputError(
            "input.no_prior",
            f"prior_sd of shape {sd.shape}, needs {n} standard deviations",
            "attitude, velocity, position, north, east, down, then the blocks; not negative",
        )
    return sd


def _named(linear: Linear, axes: AttitudeAxes) -> tuple[State, ...]:
    """The states, the first nine with the names of their axes."""
    own = linear.axes if axes == "model" else "ned"
    attitude = _NAMES["body" if axes == "body" else own]
    names = [f"phi_{a}" for a in attitude] + [f"{q}_{a}" for q in ("dv", "dp") for a in _NAMES[own]]
    return tuple(
        replace(state, name=name) for name, state in zip(names, linear.states, strict=False)
    ) + tuple(linear.states[9:])
