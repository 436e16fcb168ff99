"""Errors of a trajectory against a reference: common epochs, errors in metres and radians, RMSE tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.analysis import text
from gnssins.errors import InputError
from gnssins.tables import seconds, wrap_pi
from gnssins.units import NS_PER_S

__all__ = ["NavErrors", "Rmse", "Track", "Trajectory", "compare", "interpolate", "ned_difference"]

Array = NDArray[np.float64]
Times = NDArray[np.int64]


class Trajectory(Protocol):
    """What can be compared: a :class:`gnssins.Result`, a truth table, a simulated truth, a :class:`Track`.

    NaN stands for an unknown velocity or attitude, None for no attitude at all.
    """

    @property
    def t_ns(self) -> Times:
        """Strictly ascending times (k,), nanoseconds."""

    @property
    def lla(self) -> Array:
        """Latitude, longitude (rad), ellipsoidal height (m), shape (k, 3)."""

    @property
    def v_n(self) -> Array:
        """Velocity north, east, down (m/s), shape (k, 3)."""

    @property
    def q_nb(self) -> Array | None:
        """Attitude, body to NED, scalar first, shape (k, 4)."""


@dataclass(frozen=True, eq=False)
class Track:
    """Plain arrays that make a :class:`Trajectory`."""

    t_ns: Times
    lla: Array
    v_n: Array
    q_nb: Array

    @classmethod
    def of(cls, source: Trajectory) -> Track:
        """Take the arrays of any trajectory, an attitude that is not there as NaN."""
        q_nb = source.q_nb if source.q_nb is not None else np.full((source.t_ns.size, 4), np.nan)
        return cls(source.t_ns, source.lla, source.v_n, q_nb)


@dataclass(frozen=True, eq=False)
class NavErrors:
    """Estimate minus truth at common epochs.

    Parameters
    ----------
    t_ns : ndarray of int64, shape (k,)
        Epochs.
    position : ndarray, shape (k, 3)
        North, east, down (m): (R_M+h) dL, (R_N+h) cos L dlon, -dh.
    velocity : ndarray, shape (k, 3)
        North, east, down (m/s).
    phi : ndarray, shape (k, 3)
        Rotation vector of the attitude error along north, east, down (rad): C_true = Exp(phi) C_est.
    euler : ndarray, shape (k, 3)
        Roll, pitch, heading (rad), wrapped to [-pi, pi).
    sd : ndarray, shape (k, 9)
        Standard deviations that the estimate claims, as ``Result.sd``; NaN if it claims none.
    """

    t_ns: Times
    position: Array
    velocity: Array
    phi: Array
    euler: Array
    sd: Array

    def __len__(self) -> int:
        return int(self.t_ns.size)

    @property
    def time_s(self) -> Array:
        """Epochs in seconds, shape (k,)."""
        return seconds(self.t_ns)

    def between(self, start_s: float | None = None, end_s: float | None = None) -> NavErrors:
        """Only the epochs with ``start_s < t <= end_s``; None leaves a side open."""
        keep = np.ones(len(self), dtype=np.bool_)
        if start_s is not None:
            keep &= self.t_ns > round(start_s * NS_PER_S)
        if end_s is not None:
            keep &= self.t_ns <= round(end_s * NS_PER_S)
        return self.rows(keep)

    def rows(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> NavErrors:
        """Only some of the epochs, by mask or by index."""
        return NavErrors(
            self.t_ns[keep],
            self.position[keep],
            self.velocity[keep],
            self.phi[keep],
            self.euler[keep],
            self.sd[keep],
        )

    def rmse(self, after_s: float | None = None) -> Rmse:
        """Root mean square per axis over the epochs after ``after_s``, NaN rows apart."""
        part = self.between(after_s) if after_s is not None else self
        if not len(part):
            raise InputError(
                "input.no_overlap",
                f"no epoch in common after {after_s} s" if after_s is not None else "no epoch in common",
                "the two trajectories must overlap in time and count it on the same clock",
            )
        return Rmse(
            epochs=len(part),
            start_s=float(part.time_s[0]),
            end_s=float(part.time_s[-1]),
            position=_rms(part.position),
            velocity=_rms(part.velocity),
            phi=_rms(part.phi),
            euler=_rms(part.euler),
        )


@dataclass(frozen=True, eq=False)
class Rmse:
    """Root mean square errors; each vector (3,), NaN where the truth says nothing.

    ``position`` (m) and ``velocity`` (m/s) along north, east, down; ``phi`` (rad) about north, east, down; ``euler``
    (rad) roll, pitch, heading.
    """

    epochs: int
    start_s: float
    end_s: float
    position: Array
    velocity: Array
    phi: Array
    euler: Array

    @property
    def horizontal_m(self) -> float:
        """Horizontal position, m."""
        return float(np.hypot(self.position[0], self.position[1]))

    @property
    def horizontal_m_s(self) -> float:
        """Horizontal velocity, m/s."""
        return float(np.hypot(self.velocity[0], self.velocity[1]))

    def table(self, title: str = "Root mean square error") -> str:
        """The figures as text, angles in degrees."""
        rows = [
            ["position, m", *map(text.number, self.position), text.number(self.horizontal_m)],
            ["velocity, m/s", *map(text.number, self.velocity), text.number(self.horizontal_m_s)],
            ["attitude about the axis, deg", *map(text.number, np.degrees(self.phi)), ""],
        ]
        angles = zip(("roll", "pitch", "heading"), np.degrees(self.euler), strict=True)
        caption = "  ".join(f"{name} {text.number(value)} deg" for name, value in angles)
        span = f"{self.epochs} epochs, {self.start_s:.1f} s to {self.end_s:.1f} s"
        return text.table(f"{title} ({span})", ["", "north", "east", "down", "horizontal"], rows, caption)

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain numbers with units in the names; None where unknown."""
        return {
            "epochs": self.epochs,
            "start_s": self.start_s,
            "end_s": self.end_s,
            "position_m": _named(("north", "east", "down"), self.position),
            "velocity_m_s": _named(("north", "east", "down"), self.velocity),
            "phi_deg": _named(("north", "east", "down"), np.degrees(self.phi)),
            "euler_deg": _named(("roll", "pitch", "heading"), np.degrees(self.euler)),
        }


def _named(names: tuple[str, ...], values: Array) -> dict[str, float | None]:
    return {n: float(v) if np.isfinite(v) else None for n, v in zip(names, values, strict=True)}


def _rms(values: Array) -> Array:
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values * values, 0.0).sum(axis=0)
    mean = np.divide(total, count, out=np.full(values.shape[1], np.nan), where=count > 0)
    return np.asarray(np.sqrt(mean), dtype=np.float64)


def compare(
    estimate: Trajectory, truth: Trajectory, *, ellipsoid: str = "wgs84", max_gap_s: float = 2.0
) -> NavErrors:
    """Errors of ``estimate`` against ``truth`` where both exist.

    The epochs are those of the one with fewer of them in the common span; the other is interpolated to them
    (:func:`interpolate`), or taken as it is where the stamps agree.

    Parameters
    ----------
    estimate, truth : Trajectory
        On one clock. The sd of ``estimate`` comes along if it has the attribute ``sd`` (k, 9).
    ellipsoid : str
        For the radii of curvature: ``"wgs84"``, ``"grs80"``, ``"pz90"``, ``"krasovsky"``.
    max_gap_s : float
        Epochs inside a longer gap of the interpolated one are left out.

    Returns
    -------
    NavErrors
        Empty if the two do not overlap.

    Raises
    ------
    InputError
        One of them has no epochs.
    """
    if not (estimate.t_ns.size and truth.t_ns.size):
        raise InputError("input.empty", "a trajectory without epochs cannot be compared")
    span = max(estimate.t_ns[0], truth.t_ns[0]), min(estimate.t_ns[-1], truth.t_ns[-1])
    est_in, truth_in = (_inside(t.t_ns, span) for t in (estimate, truth))
    epochs = estimate.t_ns[est_in] if est_in.sum() <= truth_in.sum() else truth.t_ns[truth_in]
    est, ref = interpolate(estimate, epochs, max_gap_s), interpolate(truth, epochs, max_gap_s)
    sd = getattr(estimate, "sd", None)
    sd_at = np.full((epochs.size, 9), np.nan) if sd is None else _linear(estimate.t_ns, sd, epochs)
    keep = np.isfinite(est.lla).all(axis=1) & np.isfinite(ref.lla).all(axis=1)
    est, ref = (Track(epochs[keep], t.lla[keep], t.v_n[keep], t.q_nb[keep]) for t in (est, ref))
    return NavErrors(
        t_ns=epochs[keep],
        position=ned_difference(est.lla, ref.lla, ellipsoid),
        velocity=est.v_n - ref.v_n,
        phi=phi_between(est.q_nb, ref.q_nb),
        euler=wrap_pi(_known(_core.quat_to_euler, est.q_nb, 3) - _known(_core.quat_to_euler, ref.q_nb, 3)),
        sd=sd_at[keep],
    )


def ned_difference(estimate: Array, truth: Array, ellipsoid: str = "wgs84") -> Array:
    """Displacement from ``truth`` to ``estimate`` along north, east, down (m), shape (k, 3).

    ``[(R_M+h) dL, (R_N+h) cos L dlon, -dh]`` with radii and latitude of the truth; the difference of longitude is
    wrapped. Good for differences small against the Earth; not for places within metres of a pole.
    """
    lat, height = np.ascontiguousarray(truth[:, 0]), truth[:, 2]
    radii = _core.radii(lat, ellipsoid)
    return np.column_stack(
        [
            (estimate[:, 0] - lat) * (radii[:, 0] + height),
            wrap_pi(estimate[:, 1] - truth[:, 1]) * (radii[:, 1] + height) * np.cos(lat),
            height - estimate[:, 2],
        ]
    )


def phi_between(estimate: Array, truth: Array) -> Array:
    """Attitude error phi (k, 3) in n axes (rad) of quaternions (k, 4): Exp(phi) = C_true C_est'; NaN rows stay."""
    known = np.isfinite(estimate).all(axis=1) & np.isfinite(truth).all(axis=1)
    phi = np.full((estimate.shape[0], 3), np.nan)
    turn = _core.quat_mul(np.ascontiguousarray(truth[known]), _conjugate(estimate[known]))
    phi[known] = _core.quat_to_rotvec(turn)
    return phi


def interpolate(source: Trajectory, t_ns: Times, max_gap_s: float = 2.0) -> Track:
    """Bring a trajectory to other epochs: position and velocity linearly, attitude along the shortest rotation.

    Parameters
    ----------
    source : Trajectory
        At least one epoch.
    t_ns : ndarray of int64, shape (k,)
        Epochs wanted.
    max_gap_s : float
        Longest step of ``source`` to interpolate across.

    Returns
    -------
    Track
        NaN outside the span of ``source`` and inside longer gaps. Epochs of ``source`` come back unchanged.
    """
    track = Track.of(source)
    have = track.t_ns
    if have.size == t_ns.size and np.array_equal(have, t_ns):
        return track
    after = np.clip(np.searchsorted(have, t_ns), 1, max(have.size - 1, 1))
    after = np.minimum(after, have.size - 1)
    before = np.maximum(after - 1, 0)
    step = np.maximum(have[after] - have[before], 1)
    share = (t_ns - have[before]) / step
    exact = (share == 0.0) | (share == 1.0)
    bad = (share < 0.0) | (share > 1.0) | ((step > max_gap_s * NS_PER_S) & ~exact)
    lla = np.column_stack([track.lla[:, 0], np.unwrap(track.lla[:, 1]), track.lla[:, 2]])
    lla = _blend(lla, before, after, share)
    lla[:, 1] = wrap_pi(lla[:, 1])
    v_n = _blend(track.v_n, before, after, share)
    q_nb = _slerp(track.q_nb[before], track.q_nb[after], share)
    for values in (lla, v_n, q_nb):
        values[bad] = np.nan
    return Track(t_ns, lla, v_n, q_nb)


def _inside(t_ns: Times, span: tuple[int, int]) -> NDArray[np.bool_]:
    return (t_ns >= span[0]) & (t_ns <= span[1])


def _blend(values: Array, before: NDArray[np.intp], after: NDArray[np.intp], share: Array) -> Array:
    """Linear in between, and exactly the sample at both ends (also when the other one is NaN)."""
    first, last, s = values[before], values[after], share[:, None]
    return np.where(s == 0.0, first, np.where(s == 1.0, last, first + s * (last - first)))


def _linear(have: Times, values: Array, t_ns: Times) -> Array:
    if have.size == t_ns.size and np.array_equal(have, t_ns):
        return values
    return np.column_stack([np.interp(t_ns - have[0], have - have[0], column) for column in values.T])


def _slerp(q0: Array, q1: Array, share: Array) -> Array:
    """Quaternions at ``share`` of the way from ``q0`` to ``q1``, shape (k, 4); NaN where one of them is."""
    known = np.isfinite(q0).all(axis=1) & np.isfinite(q1).all(axis=1)
    out = np.full(q0.shape, np.nan)
    first = np.ascontiguousarray(q0[known])
    turn = _core.quat_to_rotvec(_core.quat_mul(_conjugate(first), np.ascontiguousarray(q1[known])))
    out[known] = _core.quat_mul(first, _core.rotvec_to_quat(share[known, None] * turn))
    return out


def _conjugate(q: Array) -> Array:
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]), dtype=np.float64)


def _known(function: Any, values: Array, width: int) -> Array:
    """Apply a row-wise function of the core to the rows without NaN."""
    rows = np.isfinite(values).all(axis=1)
    out = np.full((values.shape[0], width), np.nan)
    out[rows] = function(np.ascontiguousarray(values[rows]))
    return out
