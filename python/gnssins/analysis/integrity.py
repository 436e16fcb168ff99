"""Integrity tests of the fixes, judged after the run: how often they cry wolf, and how soon they see a step or a ramp.

Every test looks at the innovation v of one part of a fix (position or velocity) and its covariance S; a part counts
where all of its three components were measured:

* **trace ratio**: v'v / trace(S), alarm above ``delta`` = 10. Novik (2011). It takes no account of the shape of S.
* **chi-square**: v' S^-1 v, alarm above the quantile of three degrees of freedom for a chosen rate of false alarms.
* **tolerance** (:func:`gnssins.analysis.gates.tolerance`): the jump of a fix against the extrapolated last estimate,
  beyond what the vehicle can do. Novik (2011).
* **window**: the chi-square test of the sum of the innovations of 10 to 60 s, for slow ramps: with white innovations
  the covariance of the sum is the sum of the covariances.

Detection is judged after the fact: a step e at an epoch adds e to the innovation of that epoch, whatever the run, so
every epoch of every run is one trial of "caught at the first epoch".
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import text
from gnssins.analysis.gates import Part, Share, chi_square, chi_square_limit, trace_ratio, windowed
from gnssins.errors import InputError
from gnssins.result import Records, Result
from gnssins.units import NS_PER_S

__all__ = ["PUBLISHED_RATIO", "Integrity", "integrity"]

Array = NDArray[np.float64]
Times = NDArray[np.int64]

#: Limit of the trace ratio: Novik (2011), "at least 10".
PUBLISHED_RATIO: Final = 10.0

_PARTS: Final[dict[Part, slice]] = {"position": slice(0, 3), "velocity": slice(3, 6)}
_AXES: Final = ("north", "east", "down")


@dataclass(frozen=True, eq=False)
class Integrity:
    """Innovations of one run or many, and what the tests make of them; j fixes.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (j,)
        Times of validity, ascending within a run.
    run : ndarray of int, shape (j,)
        Number of the run.
    innovation : ndarray, shape (j, 6)
        Measured minus predicted, as :class:`gnssins.result.Records`, east stretched if ``reduced``.
    covariance : ndarray, shape (j, 6, 6)
        Its covariance.
    stretch : ndarray, shape (j,)
        Factor on the east components: 1, or 1 / cos(latitude) if ``reduced``.
    delta : float
        Limit of the trace ratio.
    false_alarm : float
        Rate that the limit of the chi-square test is for.
    windows_s : tuple of float
        Lengths of the windowed test, s.
    """

    t_ns: Times
    run: NDArray[np.intp]
    innovation: Array
    covariance: Array
    stretch: Array
    delta: float
    false_alarm: float
    windows_s: tuple[float, ...]

    @property
    def limit(self) -> float:
        """Limit of the chi-square test of three components."""
        return chi_square_limit(self.false_alarm)

    @classmethod
    def combine(cls, items: Iterable[Integrity]) -> Integrity:
        """Put the fixes of several runs together; their settings must agree."""
        found = list(items)
        if not found:
            raise InputError("input.empty", "nothing to combine")
        first = found[0]
        settings = [(i.delta, i.false_alarm, i.windows_s) for i in found]
        if any(s != settings[0] for s in settings):
            raise InputError("input.settings", "runs judged with different limits", "use the same for all")
        starts = np.cumsum([0, *(int(i.run.max(initial=-1)) + 1 for i in found)])
        return cls(
            t_ns=np.concatenate([i.t_ns for i in found]),
            run=np.concatenate([i.run + start for i, start in zip(found, starts, strict=False)]),
            innovation=np.concatenate([i.innovation for i in found]),
            covariance=np.concatenate([i.covariance for i in found]),
            stretch=np.concatenate([i.stretch for i in found]),
            delta=first.delta,
            false_alarm=first.false_alarm,
            windows_s=first.windows_s,
        )

    def has(self, part: Part) -> bool:
        """Tell whether any fix has all three components of this part."""
        return bool(np.isfinite(self.innovation[:, _PARTS[part]]).all(axis=1).any())

    def part(self, part: Part) -> tuple[Array, Array]:
        """Innovations (j, 3) and covariances (j, 3, 3) of one part."""
        at = _PARTS[part]
        return self.innovation[:, at], self.covariance[:, at, at]

    def ratio(self, part: Part) -> Array:
        """Trace ratio of every fix, shape (j,)."""
        return trace_ratio(*self.part(part))

    def chi_square(self, part: Part) -> Array:
        """Chi-square value of every fix, shape (j,)."""
        return chi_square(*self.part(part))

    def alarms(self, part: Part) -> dict[str, Share]:
        """Alarms per fix of both tests as the run stands: false ones if nothing was wrong with the fixes."""
        return {
            "trace ratio": _share(self.ratio(part), self.delta),
            "chi-square": _share(self.chi_square(part), self.limit),
        }

    def window_alarms(self, part: Part, window_s: float) -> Share:
        """Alarms of the windowed test per window; windows overlap, so the bounds are too narrow."""
        return _share(self._windowed(part, window_s, np.zeros(3)), self.limit)

    def detection(self, part: Part, step: float, axis: int | Sequence[float]) -> dict[str, Share]:
        """Share of epochs at which a step is caught at once, over both signs of the step.

        Parameters
        ----------
        part : {"position", "velocity"}
            What jumps.
        step : float
            Size, m or m/s on the ground.
        axis : int or sequence of float
            0 north, 1 east, 2 down, or a direction (its length counts).
        """
        direction = np.eye(3)[axis] if isinstance(axis, int) else np.asarray(axis, dtype=np.float64)
        v, s = self.part(part)
        shift = step * direction * self._stretched()
        both = (v + shift, v - shift)
        return {
            "trace ratio": _share(np.concatenate([trace_ratio(w, s) for w in both]), self.delta),
            "chi-square": _share(np.concatenate([chi_square(w, s) for w in both]), self.limit),
        }

    def ramp_detection(self, part: Part, rate: float, axis: int, window_s: float) -> Share:
        """Share of windows at whose end a ramp of ``rate`` per s that began with the window is seen.

        The filter is taken not to follow the ramp, which holds for a window short against its memory.
        """
        return _share(self._windowed(part, window_s, rate * np.eye(3)[axis]), self.limit)

    def _stretched(self) -> Array:
        """Factors on north, east, down, shape (j, 3)."""
        ones = np.ones_like(self.stretch)
        return np.column_stack([ones, self.stretch, ones])

    def _windowed(self, part: Part, window_s: float, rate: Array) -> Array:
        v, s = self.part(part)
        pieces = []
        for number in np.unique(self.run):
            rows = self.run == number
            ramp = rate * self._stretched()[rows]
            pieces.append(windowed(self.t_ns[rows], v[rows], s[rows], window_s, ramp=ramp))
        return np.concatenate(pieces) if pieces else np.zeros(0)

    def table(
        self,
        position_steps: Sequence[float] = (10.0, 15.0, 20.0, 30.0),
        velocity_steps: Sequence[float] = (0.5, 1.0, 2.0),
        title: str = "",
    ) -> str:
        """False alarms, then the share of steps caught at the first epoch by size and axis."""
        runs = int(np.unique(self.run).size)
        title = (
            title
            or f"Integrity tests of {self.t_ns.size} fixes of {'one run' if runs == 1 else f'{runs} runs'}"
        )
        parts: list[Part] = [name for name in _PARTS if self.has(name)]
        rows = []
        for name in parts:
            for test, share in self.alarms(name).items():
                limit = self.delta if test == "trace ratio" else self.limit
                low, high = share.bounds
                rows.append(
                    [
                        name,
                        test,
                        text.number(limit),
                        str(share.hits),
                        str(share.trials),
                        f"{low:.1e} .. {high:.1e}",
                    ]
                )
            for window_s in self.windows_s:
                share = self.window_alarms(name, window_s)
                rows.append(
                    [
                        name,
                        f"window {window_s:g} s",
                        text.number(self.limit),
                        str(share.hits),
                        str(share.trials),
                        "",
                    ]
                )
        head = ["part", "test", "limit", "alarms", "of", "rate, 95 % bounds"]
        blocks = [text.table(title, head, rows, left=(0, 1))]
        caught = []
        for name in parts:
            unit = "m" if name == "position" else "m/s"
            for step in position_steps if name == "position" else velocity_steps:
                found = [self.detection(name, step, axis) for axis in range(3)]
                for test in ("trace ratio", "chi-square"):
                    caught.append(
                        [name, f"{step:g} {unit}", test, *(f"{100 * f[test].value:.2f} %" for f in found)]
                    )
        blocks.append(
            text.table(
                "Steps caught at the first epoch", ["part", "step", "test", *_AXES], caught, left=(0, 2)
            )
        )
        return "\n\n".join(blocks)

    def to_dict(
        self,
        position_steps: Sequence[float] = (10.0, 15.0, 20.0, 30.0),
        velocity_steps: Sequence[float] = (0.5, 1.0, 2.0),
    ) -> dict[str, Any]:
        """Plain numbers per part: alarms, windows, steps."""
        out: dict[str, Any] = {
            "fixes": int(self.t_ns.size),
            "runs": int(np.unique(self.run).size),
            "ratio_limit": self.delta,
            "chi_square_limit": self.limit,
        }
        for name in _PARTS:
            if not self.has(name):
                continue
            steps = position_steps if name == "position" else velocity_steps
            out[name] = {
                "alarms": {test: share.to_dict() for test, share in self.alarms(name).items()},
                "windows": {
                    f"{window_s:g}": {"hits": share.hits, "trials": share.trials}
                    for window_s in self.windows_s
                    for share in [self.window_alarms(name, window_s)]
                },
                "caught": {
                    f"{step:g}": {
                        axis: {test: share.value for test, share in self.detection(name, step, i).items()}
                        for i, axis in enumerate(_AXES)
                    }
                    for step in steps
                },
            }
        return out


def _share(values: Array, limit: float) -> Share:
    known = values[np.isfinite(values)]
    return Share(int((known >= limit).sum()), int(known.size))


def integrity(
    results: Result | Records | Iterable[Result | Records],
    *,
    delta: float = PUBLISHED_RATIO,
    false_alarm: float = 1e-5,
    windows_s: Sequence[float] = (10.0, 60.0),
    after_s: float | None = None,
    reduced: bool = False,
) -> Integrity:
    """Judge the fixes of one run, or of many together.

    Parameters
    ----------
    results : Result or Records, or several
        Fixes that were compared with the prediction, used or rejected.
    delta : float
        Limit of the trace ratio.
    false_alarm : float
        Per epoch, for the limit of the chi-square test.
    windows_s : sequence of float
        Lengths of the windowed test, s.
    after_s : float, optional
        Only fixes valid after this time.
    reduced : bool
        East components in the publication's reduced coordinates, 1 / cos(latitude) longer than on the ground. It
        changes the trace ratio, which depends on the coordinates, and not the chi-square test.

    Returns
    -------
    Integrity

    Raises
    ------
    InputError
        ``input.no_innovations``: no fix was compared with a prediction.
    """
    chi_square_limit(false_alarm)
    many = [results] if isinstance(results, Result | Records) else list(results)
    records = [r.records if isinstance(r, Result) else r for r in many]
    items = [_one(r, delta, false_alarm, tuple(windows_s), after_s, reduced) for r in records]
    found = Integrity.combine(items)
    if not found.t_ns.size:
        raise InputError(
            "input.no_innovations",
            "no fix was compared with a prediction",
            "the run needs fixes that are used or rejected" + (f" after {after_s:g} s" if after_s else ""),
        )
    return found


def _one(
    records: Records,
    delta: float,
    false_alarm: float,
    windows_s: tuple[float, ...],
    after_s: float | None,
    reduced: bool,
) -> Integrity:
    keep = records.is_status("used", "rejected") & np.isfinite(records.innovation).any(axis=1)
    if after_s is not None:
        keep &= records.t_ns > round(after_s * NS_PER_S)
    order = np.flatnonzero(keep)[np.argsort(records.t_ns[keep], kind="stable")]
    v, s = records.innovation[order].copy(), records.innovation_cov[order].copy()
    stretch = np.ones(order.size)
    if reduced:
        latitude = records.lla[order, 0]
        known = latitude[np.isfinite(latitude)]
        stretch = 1.0 / np.cos(np.where(np.isfinite(latitude), latitude, known.mean() if known.size else 0.0))
        for east in (1, 4):
            v[:, east] *= stretch
            s[:, east, :] *= stretch[:, None]
            s[:, :, east] *= stretch[:, None]
    return Integrity(
        records.t_ns[order],
        np.zeros(order.size, dtype=np.intp),
        v,
        s,
        stretch,
        delta,
        false_alarm,
        windows_s,
    )
