"""Measurements of a stretch of path referred to its first epoch: the matrices behind the analysis of observability."""

from __future__ import annotations

from typing import Final, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.errors import InputError
from gnssins.tables import State
from gnssins.units import NS_PER_S

__all__ = ["TOLERANCE_NS", "AttitudeAxes", "Linear", "basis_of", "c_en", "rows_of", "stack", "windows"]

Array = NDArray[np.float64]
Times = NDArray[np.int64]

#: Axes of the attitude error.
AttitudeAxes = Literal["body", "ned", "model"]

#: Stamps that differ by less are one epoch, ns.
TOLERANCE_NS: Final = 1000


class Linear(Protocol):
    """A linearised run: what ``[run] linearise = true`` leaves in ``Result.linearisation``.

    m measurement epochs, n states, of which the first nine are attitude, velocity and position.
    """

    @property
    def t_ns(self) -> Times:
        """Measurement epochs (m,), ascending, ns."""

    @property
    def phi(self) -> Array:
        """Transition from the previous measurement epoch to this one, shape (m, n, n); the first is not used."""

    @property
    def h(self) -> Array:
        """Rows of the measurement, shape (m, q, n); NaN where a row is absent."""

    @property
    def r(self) -> Array:
        """Covariance of the measurement, shape (m, q, q); NaN where a row is absent."""

    @property
    def q_nb(self) -> Array:
        """Attitude, body to NED, scalar first, shape (m, 4)."""

    @property
    def lla(self) -> Array:
        """Latitude, longitude (rad), height (m), shape (m, 3)."""

    @property
    def axes(self) -> str:
        """Axes of the first nine states: ``"ned"`` or ``"ecef"``."""

    @property
    def states(self) -> tuple[State, ...]:
        """The n states."""


def windows(t_ns: Times, window: int, window_s: float | None) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First and last epoch of every window, shapes (k,)."""
    if window_s is None:
        last = np.arange(window - 1, t_ns.size)
        first = last - (window - 1)
    else:
        back = t_ns - round(window_s * NS_PER_S) - TOLERANCE_NS
        last = np.flatnonzero(back >= t_ns[0] - 2 * TOLERANCE_NS) if t_ns.size else np.zeros(0, dtype=np.intp)
        first = np.searchsorted(t_ns, back[last])
    if not last.size:
        length = f"{window} fixes" if window_s is None else f"{window_s:g} s"
        have = f"{t_ns.size} measurement epochs"
        span = f" over {(t_ns[-1] - t_ns[0]) / NS_PER_S:.1f} s" if t_ns.size else ""
        raise InputError(
            "input.window", f"a window of {length}, the run has {have}{span}", "take a shorter window"
        )
    return np.asarray(first, dtype=np.intp), np.asarray(last, dtype=np.intp)


def rows_of(linear: Linear, *, whiten: bool) -> Array:
    """Rows of all epochs, shape (m, q', n): absent ones zero, columns of rows that no epoch has left out."""
    present = np.atleast_2d(np.isfinite(linear.h).all(axis=2))
    if not present.any():
        raise InputError("input.window", "no epoch has a measurement", "let the filter use some fixes")
    some = np.flatnonzero(present.any(axis=0))
    h = np.where(present[:, :, None], linear.h, 0.0)[:, some]
    if not whiten:
        return np.ascontiguousarray(h)
    here = present[:, some]
    # an absent row stands for an independent one with unit noise, and is zero
    both = here[:, :, None] & here[:, None, :]
    r = np.where(both, linear.r[:, some][:, :, some], np.eye(some.size))
    return np.asarray(np.linalg.solve(np.linalg.cholesky(r), h))


def _turns(linear: Linear, first: NDArray[np.intp], axes: AttitudeAxes) -> tuple[Array, Array]:
    """Turns from the axes wanted to those of the model, shapes (k, 3, 3): of attitude, of velocity and position."""
    eye = np.broadcast_to(np.eye(3), (first.size, 3, 3))
    to_model = c_en(linear.lla[first]) if linear.axes == "ecef" else eye
    if axes == "model":
        return eye, eye
    if axes == "ned":
        return to_model, to_model
    c_nb = _core.quat_to_dcm(np.ascontiguousarray(linear.q_nb[first]))
    return to_model @ c_nb, to_model


def basis_of(linear: Linear, first: NDArray[np.intp], axes: AttitudeAxes, sd: Array | None) -> Array:
    """States of the model at the first epoch for unit (or one-sigma) errors in the axes wanted, shape (k, n, n)."""
    n = len(linear.states)
    attitude, rest = _turns(linear, first, axes)
    basis = np.zeros((first.size, n, n))
    basis[:, np.arange(n), np.arange(n)] = 1.0
    basis[:, 0:3, 0:3], basis[:, 3:6, 3:6], basis[:, 6:9, 6:9] = attitude, rest, rest
    if sd is None:
        return basis
    # the prior is diagonal along north, east, down: its variances along the axes wanted
    to_ned = c_en(linear.lla[first]).transpose(0, 2, 1) if linear.axes == "ecef" else np.eye(3)
    scale = np.broadcast_to(sd, (first.size, n)).copy()
    for at, turn in ((0, attitude), (3, rest), (6, rest)):
        scale[:, at : at + 3] = np.sqrt(np.einsum("kij,i->kj", (to_ned @ turn) ** 2, sd[at : at + 3] ** 2))
    return basis * scale[:, None, :]


def stack(
    linear: Linear, rows: Array, first: NDArray[np.intp], last: NDArray[np.intp], basis: Array
) -> Array:
    """The matrices O of some windows, shape (k, p q', n); windows with fewer epochs end in zeros."""
    longest, q, n = int((last - first).max()) + 1, rows.shape[1], rows.shape[2]
    stacked = np.zeros((first.size, max(longest * q, n), n))
    carried = basis
    for j in range(longest):
        at = np.minimum(first + j, last)
        if j:
            carried = linear.phi[at] @ carried
        stacked[:, j * q : (j + 1) * q] = rows[at] @ carried
        stacked[first + j > last, j * q : (j + 1) * q] = 0.0
    return stacked


def c_en(lla: Array) -> Array:
    """Turns from NED to ECEF axes, shape (k, 3, 3). Groves (2013), eq. 2.150."""
    sin_lat, cos_lat = np.sin(lla[:, 0]), np.cos(lla[:, 0])
    sin_lon, cos_lon = np.sin(lla[:, 1]), np.cos(lla[:, 1])
    zero = np.zeros_like(sin_lat)
    columns = [
        [-sin_lat * cos_lon, -sin_lon, -cos_lat * cos_lon],
        [-sin_lat * sin_lon, cos_lon, -cos_lat * sin_lon],
        [cos_lat, zero, -sin_lat],
    ]
    return np.moveaxis(np.array(columns), 2, 0)
