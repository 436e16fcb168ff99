"""The GNSS receiver: fixes of the antenna with noise, latency and outages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..dataset import GnssTable
from ..units import NS_PER_S, ms_to_ns, seconds_to_ns
from .frames import EARTH_RATE_RAD_S, c_en, displaced
from .processes import constant, gauss_markov
from .sensor_config import Gnss
from .streams import Streams
from .trajectory import Trajectory

__all__ = ["antenna_motion", "fix_times", "simulate_gnss"]

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
    same fixes elsewhere. Variances are those of the white noise, without the correlated errors.

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
    blocks = _error_histories(trajectory, gnss, streams)
    lever = np.asarray(gnss.lever_ba_b_m, dtype=np.float64)
    if "gnss_lever_arm" in blocks:
        lever = lever + blocks["gnss_lever_arm"][0]
    lla, v_n = antenna_motion(trajectory, t_ns, lever)
    count = len(t_ns)
    var = np.full((count, 6), np.nan)
    if gnss.position_sd_m is None:
        lla = np.full((count, 3), np.nan)
    else:
        var[:, :3] = np.square(gnss.position_sd_m)
        noise = streams("gnss.position").standard_normal((count, 3)) * np.asarray(gnss.position_sd_m)
        lla = displaced(
            lla, noise + _at(trajectory, blocks.get("gnss_position_error"), t_ns), trajectory.ellipsoid
        )
    if gnss.velocity_sd_m_s is None:
        v_n = np.full((count, 3), np.nan)
    else:
        var[:, 3:] = np.square(gnss.velocity_sd_m_s)
        noise = streams("gnss.velocity").standard_normal((count, 3)) * np.asarray(gnss.velocity_sd_m_s)
        v_n = v_n + noise + _at(trajectory, blocks.get("gnss_velocity_error"), t_ns)
    seen = np.ones(count, dtype=np.bool_)
    for from_s, to_s in gnss.outages if outages is None else outages:
        seen &= (t_ns < seconds_to_ns(from_s)) | (t_ns >= seconds_to_ns(to_s))
    stamps = t_ns + ms_to_ns(gnss.latency_ms)
    return GnssTable(stamps[seen], lla[seen], v_n[seen], var[seen]), blocks


def fix_times(trajectory: Trajectory, gnss: Gnss) -> TimeArray:
    """Give the times of validity of all fixes within the truth, int64 ns."""
    first_ns = seconds_to_ns(gnss.first_s if gnss.first_s is not None else 1.0 / gnss.rate_hz)
    period_ns = NS_PER_S / gnss.rate_hz
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
    before = np.clip(np.searchsorted(trajectory.t_ns, t_ns, side="right") - 1, 0, len(trajectory) - 2)
    position, velocity = _antenna_at_epochs(trajectory, before, lever_ba_b_m)
    next_position, next_velocity = _antenna_at_epochs(trajectory, before + 1, lever_ba_b_m)
    step_ns = trajectory.t_ns[before + 1] - trajectory.t_ns[before]
    share = ((t_ns - trajectory.t_ns[before]) / step_ns)[:, np.newaxis]
    step_s = (step_ns / NS_PER_S)[:, np.newaxis]
    bulge = 0.5 * step_s * share * (1.0 - share) * (next_velocity - velocity)
    position = position + share * (next_position - position) - bulge
    velocity = velocity + share * (next_velocity - velocity)
    lla = np.asarray(_core.ecef_to_lla(position, trajectory.ellipsoid))
    return lla, np.einsum("mji,mj->mi", c_en(lla), velocity)


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


def _error_histories(trajectory: Trajectory, gnss: Gnss, streams: Streams) -> dict[str, Array]:
    """Lever-arm and correlated errors at the epochs of the truth."""
    samples, dt_s = len(trajectory), float(np.mean(trajectory.dt_s))
    blocks: dict[str, Array] = {}
    if any(gnss.lever_error_sd_m):
        sd = np.asarray(gnss.lever_error_sd_m)
        blocks["gnss_lever_arm"] = constant(streams("gnss.lever_arm"), samples, sd)
    if gnss.position_error is not None:
        sd, tau_s = np.asarray(gnss.position_error.sd_m), gnss.position_error.tau_s
        rng = streams("gnss.position_error")
        blocks["gnss_position_error"] = gauss_markov(rng, samples, dt_s, sd, tau_s)
    if gnss.velocity_error is not None:
        sd, tau_s = np.asarray(gnss.velocity_error.sd_m_s), gnss.velocity_error.tau_s
        rng = streams("gnss.velocity_error")
        blocks["gnss_velocity_error"] = gauss_markov(rng, samples, dt_s, sd, tau_s)
    return blocks


def _at(trajectory: Trajectory, history: Array | None, t_ns: TimeArray) -> Array:
    """Interpolate a history, linear between the epochs, shape (m, 3); zero if there is none."""
    if history is None:
        return np.zeros((len(t_ns), 3))
    return np.column_stack([np.interp(t_ns, trajectory.t_ns, axis) for axis in history.T])
