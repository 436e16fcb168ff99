"""How errors grow after GNSS is lost: at so many seconds into the gap, averaged over gaps and over runs.

"The root mean square error at t = T" of one gap can be read in two ways, and both are given:

* R1, **so far**: root mean square over the gap from its start to T;
* R2, **at T**: magnitude of the error at T.

Both are averaged over the gaps. Al Bitar and Gavrilov (2019), whose table prints one figure without saying which.
The root mean square over the gaps of the error at T stands beside them: it compares with the filter's own sigma.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.analysis import text
from gnssins.analysis.errors import NavErrors, Trajectory, compare, interpolate
from gnssins.analysis.outages import antenna_track, gap_windows, withheld_track
from gnssins.errors import InputError
from gnssins.units import NS_PER_S

if TYPE_CHECKING:
    from gnssins.result import Result

__all__ = ["QUANTITIES", "OutageGrowth", "Quantity", "outage_growth"]

Array = NDArray[np.float64]
Times = NDArray[np.int64]


@dataclass(frozen=True)
class Quantity:
    """One line of the table: key, unit of the arrays (SI), and unit and factor for people."""

    key: str
    unit: str
    label: str
    factor: float


_DEG: Final = 180.0 / np.pi

#: What is counted, in the order of the last axis of the arrays.
QUANTITIES: Final = (
    Quantity("latitude", "rad", "latitude, 1e-7 rad", 1e7),
    Quantity("longitude", "rad", "longitude, 1e-7 rad", 1e7),
    Quantity("north", "m", "north, m", 1.0),
    Quantity("east", "m", "east, m", 1.0),
    Quantity("height", "m", "height, m", 1.0),
    Quantity("horizontal", "m", "horizontal, m", 1.0),
    Quantity("distance", "m", "E_xyz (3-D), m", 1.0),
    Quantity("v_north", "m/s", "v north, m/s", 1.0),
    Quantity("v_east", "m/s", "v east, m/s", 1.0),
    Quantity("v_down", "m/s", "v down, m/s", 1.0),
    Quantity("roll", "rad", "roll, deg", _DEG),
    Quantity("pitch", "rad", "pitch, deg", _DEG),
    Quantity("heading", "rad", "heading, deg", _DEG),
)

_READINGS: Final = (
    ("so_far", "R1: root mean square over the gap so far, mean of the gaps"),
    ("at_end", "R2: magnitude of the error at the time, mean of the gaps"),
    ("rms", "Root mean square over the gaps of the error at the time"),
    ("sigma", "The filter's own sigma at the time, root mean square of the gaps"),
)


@dataclass(frozen=True, eq=False)
class OutageGrowth:
    """Growth of the errors in g gaps at e times; q quantities in the order of :data:`QUANTITIES`.

    Parameters
    ----------
    at_s : ndarray, shape (e,)
        Seconds since the start of the gap.
    start_s : ndarray, shape (g,)
        Starts of the gaps, s on the clock of their run.
    error : ndarray, shape (g, e, q)
        Errors at these times, estimate minus reference, SI; distances not negative. NaN where the reference says
        nothing.
    rms_so_far : ndarray, shape (g, e, q)
        Root mean square from the start of the gap.
    sd : ndarray, shape (g, e, q)
        What the filter claims; of distances the root of the sum of variances.
    reference : str
        What the errors are counted against.
    """

    at_s: Array
    start_s: Array
    error: Array
    rms_so_far: Array
    sd: Array
    reference: str = ""

    @property
    def gaps(self) -> int:
        """Number of gaps."""
        return int(self.start_s.size)

    @property
    def so_far(self) -> Array:
        """R1: mean over the gaps of the root mean square so far, shape (e, q)."""
        return _mean(self.rms_so_far)

    @property
    def at_end(self) -> Array:
        """R2: mean over the gaps of the magnitude at the time, shape (e, q)."""
        return _mean(np.abs(self.error))

    @property
    def rms(self) -> Array:
        """Root mean square over the gaps of the error at the time, shape (e, q)."""
        return np.asarray(np.sqrt(_mean(self.error**2)))

    @property
    def sigma(self) -> Array:
        """Root mean square over the gaps of what the filter claims, shape (e, q)."""
        return np.asarray(np.sqrt(_mean(self.sd**2)))

    def value(self, reading: str, quantity: str, at_s: float) -> float:
        """One figure: ``"so_far"``, ``"at_end"``, ``"rms"`` or ``"sigma"`` of a quantity (by key) at a time, SI."""
        row, column = self._cell(quantity, at_s)
        known = [name for name, _ in _READINGS]
        if reading not in known:
            raise InputError("input.quantity", f'no reading "{reading}"', f"one of: {', '.join(known)}")
        return float(getattr(self, reading)[row, column])

    def values(self, quantity: str, at_s: float) -> Array:
        """Errors of a quantity (by key) at a time in all gaps, shape (g,), SI."""
        row, column = self._cell(quantity, at_s)
        return np.asarray(self.error[:, row, column])

    def _cell(self, quantity: str, at_s: float) -> tuple[int, int]:
        keys = [q.key for q in QUANTITIES]
        row = np.flatnonzero(np.isclose(self.at_s, at_s))
        if quantity not in keys or not row.size:
            raise InputError(
                "input.quantity",
                f'nothing about "{quantity}" at {at_s:g} s',
                f"quantities: {', '.join(keys)}; times: {', '.join(f'{t:g}' for t in self.at_s)} s",
            )
        return int(row[0]), keys.index(quantity)

    @classmethod
    def combine(cls, items: Iterable[OutageGrowth]) -> OutageGrowth:
        """Put the gaps of several runs together; the times must agree."""
        found = list(items)
        if not found:
            raise InputError("input.empty", "nothing to combine")
        if any(not np.array_equal(f.at_s, found[0].at_s) for f in found):
            raise InputError(
                "input.times", "gaps counted at different times", "use the same at_s for all runs"
            )
        return cls(
            at_s=found[0].at_s,
            start_s=np.concatenate([f.start_s for f in found]),
            error=np.concatenate([f.error for f in found]),
            rms_so_far=np.concatenate([f.rms_so_far for f in found]),
            sd=np.concatenate([f.sd for f in found]),
            reference=found[0].reference,
        )

    def table(self, title: str = "", readings: Sequence[str] = ("so_far", "at_end", "sigma")) -> str:
        """One block per reading, one line per quantity that has a reference, one column per time."""
        head = ["", *(f"{t:.4g} s" for t in self.at_s)]
        against = f", against {self.reference}" if self.reference else ""
        blocks = [title or f"Growth of the errors without GNSS, {self.gaps} gaps{against}"]
        seen = np.atleast_1d(np.isfinite(self.error).any(axis=(0, 1)))
        for name, heading in _READINGS:
            if name not in readings:
                continue
            values = getattr(self, name)
            rows = [
                [q.label, *(text.number(v * q.factor) for v in values[:, i])]
                for i, q in enumerate(QUANTITIES)
                if seen[i]
            ]
            blocks.append(text.table(heading, head, rows))
        return "\n\n".join(blocks)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers in SI by reading and quantity; None where unknown."""
        return {
            "gaps": self.gaps,
            "reference": self.reference,
            "at_s": self.at_s.tolist(),
            "start_s": self.start_s.tolist(),
            **{
                name: {
                    f"{q.key}_{q.unit.replace('/', '_')}": [
                        float(v) if np.isfinite(v) else None for v in getattr(self, name)[:, i]
                    ]
                    for i, q in enumerate(QUANTITIES)
                }
                for name, _ in _READINGS
            },
        }


def _mean(values: Array) -> Array:
    """Mean over the first axis of what is known, NaN where nothing is."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0.0).sum(axis=0)
    return np.asarray(np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0))


def outage_growth(
    result: Result,
    truth: Trajectory | None = None,
    windows_s: Sequence[tuple[float, float]] | None = None,
    *,
    at_s: Sequence[float] = (10.0, 20.0, 30.0, 40.0, 50.0, 60.0),
    ellipsoid: str | None = None,
    reference: str = "",
) -> OutageGrowth:
    """Growth of the errors inside the gaps of a run.

    The error "at T" is that of the reference epoch next to T seconds after the start of the window; it must lie in
    the gap, before the first fix that the filter used again, and no farther from T than one interval of the reference.

    Parameters
    ----------
    result : Result
        Of a run with gaps.
    truth : Trajectory, optional
        Reference at the IMU: a truth, or the result of the same run with all fixes (which hides what both have in
        common). Left out: the withheld fixes, compared at the antenna (lever arm of the run); their noise counts as
        error, and attitude stays unknown.
    windows_s : sequence of (float, float), optional
        Gaps, s; left out: those of the configuration (``[run] outages``).
    at_s : sequence of float
        Times since the start of the gap, s, rising.
    ellipsoid : str, optional
        Left out: that of the run.
    reference : str
        Name of the reference for the table; left out: "the reference", or "the withheld fixes".

    Returns
    -------
    OutageGrowth
        Gaps shorter than a time have NaN there.

    Raises
    ------
    InputError
        ``input.no_outages``: no gaps. ``input.times``: times that do not rise. ``input.no_overlap``: no gap has a
        reference epoch at any of the times. ``input.no_reference``: neither truth nor withheld fixes.
    """
    at = np.asarray(at_s, dtype=np.float64)
    if not (at.ndim == 1 and at.size and (at > 0.0).all() and (np.diff(at) > 0.0).all()):
        raise InputError(
            "input.times", f"times since the start of the gap: {list(at_s)}", "positive and rising, s"
        )
    windows = gap_windows(result, windows_s)
    ellipsoid = ellipsoid or str(result.metadata.get("ellipsoid", "wgs84"))
    other = truth if truth is not None else withheld_track(result)
    own = result if truth is not None else antenna_track(result, ellipsoid)
    used = result.records.t_ns[result.records.is_status("used")]
    parts = []
    for start, end in windows:
        back = used[used > start].min(initial=np.iinfo(np.int64).max)
        parts.append(_gap(own, other, result, (int(start), int(end), int(back)), at, ellipsoid))
    error, so_far, sd = (np.array(list(p)) for p in zip(*parts, strict=True))
    if not np.isfinite(error).any():
        raise InputError(
            "input.no_overlap",
            f"no reference epoch at any of the times in any of the {len(windows)} gaps",
            "the gaps must lie inside the run and last as long as the first time, and the reference must cover them",
        )
    named = reference or ("the withheld fixes" if truth is None else "the reference")
    return OutageGrowth(at, windows[:, 0] / NS_PER_S, error, so_far, sd, named)


def _gap(
    own: Trajectory,
    other: Trajectory,
    result: Result,
    gap: tuple[int, int, int],
    at: Array,
    ellipsoid: str,
) -> tuple[Array, Array, Array]:
    """Errors, root mean squares so far and sigmas of one gap, shapes (e, q)."""
    start, end, back = gap
    shape = (at.size, len(QUANTITIES))
    error, so_far, sd = (np.full(shape, np.nan) for _ in range(3))
    inside = _cut(other, start, end, back)
    near = _cut(own, start, end, back, margin=1)
    if not (inside.t_ns.size and near.t_ns.size):
        return error, so_far, sd
    found = compare(near, inside, ellipsoid=ellipsoid)
    keep = (found.t_ns >= start) & (found.t_ns <= end) & (found.t_ns < back)
    if not keep.any():
        return error, so_far, sd
    t_s = (found.t_ns[keep] - start) / NS_PER_S
    lla = interpolate(inside, found.t_ns[keep]).lla
    values = _quantities(found, keep, lla, ellipsoid)
    claims = _claims(result, found.t_ns[keep], lla, ellipsoid)
    step = float(np.median(np.diff(t_s))) if t_s.size > 1 else 0.0
    squares = np.cumsum(values**2, axis=0) / np.arange(1, t_s.size + 1)[:, None]
    for i, time in enumerate(at):
        row = int(np.abs(t_s - time).argmin())
        if abs(t_s[row] - time) <= 1.001 * step + 1e-6:
            error[i], sd[i], so_far[i] = values[row], claims[row], np.sqrt(squares[row])
    return error, so_far, sd


@dataclass(frozen=True, eq=False)
class _Piece:
    """Part of a trajectory."""

    t_ns: Times
    lla: Array
    v_n: Array
    q_nb: Array | None


def _cut(source: Trajectory, start: int, end: int, back: int, margin: int = 0) -> _Piece:
    """Epochs of a gap, with so many more on either side, but none after GNSS is back."""
    low = max(int(np.searchsorted(source.t_ns, start)) - margin, 0)
    high = int(np.searchsorted(source.t_ns, min(end, back - 1), side="right")) + margin
    if margin:
        high = min(high, int(np.searchsorted(source.t_ns, back)))
    rows = slice(low, high)
    q_nb = None if source.q_nb is None else source.q_nb[rows]
    return _Piece(source.t_ns[rows], source.lla[rows], source.v_n[rows], q_nb)


def _quantities(found: NavErrors, keep: NDArray[np.bool_], lla: Array, ellipsoid: str) -> Array:
    north, east, down = found.position[keep].T
    per_lat, per_lon = _metres(lla, ellipsoid)
    return np.column_stack(
        [
            north / per_lat,
            east / per_lon,
            north,
            east,
            -down,
            np.hypot(north, east),
            np.sqrt(north**2 + east**2 + down**2),
            found.velocity[keep],
            found.euler[keep],
        ]
    )


def _claims(result: Result, t_ns: Times, lla: Array, ellipsoid: str) -> Array:
    """Standard deviations of the quantities, of the last output at or before each epoch."""
    row = np.clip(np.searchsorted(result.t_ns, t_ns, side="right") - 1, 0, len(result) - 1)
    sd = result.sd[row]
    north, east, down = sd[:, :3].T
    per_lat, per_lon = _metres(lla, ellipsoid)
    return np.column_stack(
        [
            north / per_lat,
            east / per_lon,
            north,
            east,
            down,
            np.hypot(north, east),
            np.sqrt(north**2 + east**2 + down**2),
            sd[:, 3:9],
        ]
    )


def _metres(lla: Array, ellipsoid: str) -> tuple[Array, Array]:
    """Metres per rad of latitude and of longitude, shapes (k,)."""
    lat = np.ascontiguousarray(lla[:, 0])
    radii = _core.radii(lat, ellipsoid) + lla[:, 2:3]
    return radii[:, 0], radii[:, 1] * np.cos(lat)
