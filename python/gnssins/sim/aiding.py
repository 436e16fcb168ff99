"""The GNSS receiver: fixes of the antenna with noise, slow errors, latency and outages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..dataset import GnssTable
from ..units import NS_PER_S, ms_to_ns, seconds_to_ns
from .aid_config import Gnss, Sampled
from .frames import EARTH_RATE_RAD_S, c_en, displaced
from .processes import constant
from .receiver_errors import change_rows, slow_errors
from .streams import Streams
from .trajectory import Trajectory

__all__ = [
    "antenna_ecef",
    "antenna_motion",
    "change_marks",
    "fix_times",
    "in_sight",
    "simulate_gnss",
    "white_sd",
]

Array = NDArray[np.float64]
TimeArray = NDArray[np.int64]


def simulate_gnss(
    trajectory: Trajectory,
    gnss: Gnss,
    streams: Streams,
    outages: Sequence[tuple[float, float]] | None = None,
) -> tuple[GnssTable, dict[str, Array]]:
    """Make the fixes of one run, and the true errors that a filter may estimate.

    Noise is drawn for the fixes in outages too and thrown away, so that runs with and without outages see the
    same fixes elsewhere. Variances are those of the white noise, without the correlated errors; the first fix
    after a change of the satellites has its further white noise in them. If that fix falls into an outage, the
    first one after the outage is marked in its place.

    Parameters
    ----------
    trajectory : Trajectory
        Truth with n epochs.
    gnss : Gnss
        Receiver figures.
    streams : Streams
        Random numbers of the run.
    outages : sequence of (from, to), optional
        Times of validity [from, to) without fixes (s); left out: those of the scenario.

    Returns
    -------
    table : GnssTable
        Stamps are times of validity plus latency.
    blocks : dict of str to ndarray, shape (n, 3)
        Of what the scenario has of them: ``gnss_lever_arm`` (true minus nominal, body axes, m),
        ``gnss_position_error`` (m) and ``gnss_velocity_error`` (m/s), measured minus true along north, east,
        down.
    """
    t_ns = fix_times(trajectory, gnss)
    slow = slow_errors(trajectory, gnss, t_ns, streams)
    blocks = _lever_error(trajectory, gnss, streams)
    lever = np.asarray(gnss.lever_ba_b_m, dtype=np.float64)
    if "gnss_lever_arm" in blocks:
        lever = lever + blocks["gnss_lever_arm"][0]
    lla, v_n = antenna_motion(trajectory, t_ns, lever)
    count, sd = len(t_ns), white_sd(gnss, t_ns)
    if gnss.position_sd_m is None:
        lla = np.full((count, 3), np.nan)
    else:
        error = streams("gnss.position").standard_normal((count, 3)) * sd[:, :3]
        if "gnss_position_error" in slow:
            error += slow["gnss_position_error"].at(t_ns)
        lla = displaced(lla, error, trajectory.ellipsoid)
    if gnss.velocity_sd_m_s is None:
        v_n = np.full((count, 3), np.nan)
    else:
        v_n = v_n + streams("gnss.velocity").standard_normal((count, 3)) * sd[:, 3:]
        if "gnss_velocity_error" in slow:
            v_n = v_n + slow["gnss_velocity_error"].at(t_ns)
    blocks |= {name: error.history() for name, error in slow.items()}
    seen = in_sight(t_ns, gnss.outages if outages is None else outages)
    table = GnssTable(
        (t_ns + ms_to_ns(gnss.latency_ms))[seen],
        lla[seen],
        v_n[seen],
        np.square(sd[seen]),
        change_marks(gnss, t_ns[seen]),
    )
    return table, blocks


def in_sight(t_ns: TimeArray, outages: Sequence[tuple[float, float]]) -> NDArray[np.bool_]:
    """Tell the times of validity that lie outside all outages [from, to), s; shape (m,)."""
    seen = np.ones(len(t_ns), dtype=np.bool_)
    for from_s, to_s in outages:
        seen &= (t_ns < seconds_to_ns(from_s)) | (t_ns >= seconds_to_ns(to_s))
    return seen


def change_marks(gnss: Gnss, t_ns: TimeArray) -> NDArray[np.bool_] | None:
    """Tell the first of these fixes at or after each change of the satellites; None if they never change."""
    if not gnss.constellation_changes:
        return None
    marks = np.zeros(len(t_ns), dtype=np.bool_)
    marks[change_rows(t_ns, gnss.constellation_changes)] = True
    return marks


def white_sd(gnss: Gnss, t_ns: TimeArray) -> Array:
    """Standard deviations of the white noise of fixes, shape (m, 6); NaN for what the receiver does not give."""
    out = np.full((len(t_ns), 6), np.nan)
    changed = change_rows(t_ns, gnss.constellation_changes)
    parts = (
        (gnss.position_sd_m, gnss.position_jump_sd_m),
        (gnss.velocity_sd_m_s, gnss.velocity_jump_sd_m_s),
    )
    for part, (sd, jump_sd) in enumerate(parts):
        if sd is not None:
            columns = out[:, 3 * part : 3 * part + 3]
            columns[:] = sd
            columns[changed] = np.hypot(columns[changed], jump_sd)
    return out


def fix_times(trajectory: Trajectory, aid: Sampled) -> TimeArray:
    """Give the times of validity of all values of an aid within the truth, int64 ns."""
    first_ns = seconds_to_ns(aid.first_s if aid.first_s is not None else 1.0 / aid.rate_hz)
    period_ns = NS_PER_S / aid.rate_hz
    count = int((trajectory.t_ns[-1] - first_ns) / period_ns * (1.0 + 1e-12)) + 1
    t_ns = first_ns + np.rint(np.arange(max(count, 0)) * period_ns).astype(np.int64)
    return np.asarray(t_ns[t_ns <= trajectory.t_ns[-1]])


def antenna_motion(trajectory: Trajectory, t_ns: TimeArray, lever_ba_b_m: Array) -> tuple[Array, Array]:
    """Give the true position and velocity of the antenna.

    In ECEF axes ``r_a = r + C l`` and ``v_a = v + C (w_eb x l)``; Groves (2013), section 2.5.5. Between two
    epochs the velocity is taken as linear and the position as its integral, which is what a strapdown step
    makes of a split interval.

    Parameters
    ----------
    trajectory : Trajectory
        Truth.
    t_ns : ndarray of int64, shape (m,)
        Times inside the truth.
    lever_ba_b_m : ndarray, shape (3,)
        Antenna from the IMU, body axes (m).

    Returns
    -------
    lla : ndarray, shape (m, 3)
        Latitude, longitude (rad), height (m).
    v_n : ndarray, shape (m, 3)
        Velocity in the north-east-down axes of the antenna (m/s).
    """
    position, velocity = antenna_ecef(trajectory, t_ns, lever_ba_b_m)
    lla = np.asarray(_core.ecef_to_lla(position, trajectory.ellipsoid))
    return lla, np.einsum("mji,mj->mi", c_en(lla), velocity)


def antenna_ecef(trajectory: Trajectory, t_ns: TimeArray, lever_ba_b_m: Array) -> tuple[Array, Array]:
    """Position (m) and velocity (m/s) as of :func:`antenna_motion`, ECEF axes, shapes (m, 3)."""
    before = np.clip(np.searchsorted(trajectory.t_ns, t_ns, side="right") - 1, 0, len(trajectory) - 2)
    position, velocity = _antenna_at_epochs(trajectory, before, lever_ba_b_m)
    next_position, next_velocity = _antenna_at_epochs(trajectory, before + 1, lever_ba_b_m)
    step_ns = trajectory.t_ns[before + 1] - trajectory.t_ns[before]
    share = ((t_ns - trajectory.t_ns[before]) / step_ns)[:, np.newaxis]
    step_s = (step_ns / NS_PER_S)[:, np.newaxis]
    bulge = 0.5 * step_s * share * (1.0 - share) * (next_velocity - velocity)
    position = position + share * (next_position - position) - bulge
    return position, velocity + share * (next_velocity - velocity)


def _antenna_at_epochs(trajectory: Trajectory, rows: NDArray[np.intp], lever: Array) -> tuple[Array, Array]:
    """Position (m) and velocity (m/s) of the antenna at epochs of the truth, ECEF axes, shapes (m, 3)."""
    lla = trajectory.lla[rows]
    to_ecef = c_en(lla)
    position = np.asarray(_core.lla_to_ecef(lla, trajectory.ellipsoid))
    velocity = np.einsum("mij,mj->mi", to_ecef, trajectory.v_n[rows])
    if not np.any(lever):
        return position, velocity
    first, last = np.maximum(rows - 1, 0), np.minimum(rows + 1, len(trajectory) - 1)
    turned = trajectory.dtheta[rows] + np.where((rows < last)[:, np.newaxis], trajectory.dtheta[last], 0.0)
    w_ib_b = turned / ((trajectory.t_ns[last] - trajectory.t_ns[first]) / NS_PER_S)[:, np.newaxis]
    c_eb = to_ecef @ _core.quat_to_dcm(trajectory.q_nb[rows])
    arm = c_eb @ lever
    w_ie = np.array([0.0, 0.0, EARTH_RATE_RAD_S])
    swing = np.einsum("mij,mj->mi", c_eb, np.cross(w_ib_b, lever)) - np.cross(w_ie, arm)
    return position + arm, velocity + swing


def _lever_error(trajectory: Trajectory, gnss: Gnss, streams: Streams) -> dict[str, Array]:
    """Error of the lever arm at the epochs of the truth, if the scenario has one."""
    if not any(gnss.lever_error_sd_m):
        return {}
    sd = np.asarray(gnss.lever_error_sd_m)
    return {"gnss_lever_arm": constant(streams("gnss.lever_arm"), len(trajectory), sd)}
