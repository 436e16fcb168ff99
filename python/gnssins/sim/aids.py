"""Barometric altimeter and heading of two antennas: measured values from the truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..dataset import BaroTable, HeadingTable
from ..units import DEG_TO_RAD, ms_to_ns
from .aid_config import Baro, Heading
from .aiding import fix_times, in_sight
from .processes import random_walk
from .streams import Streams
from .trajectory import Trajectory

__all__ = ["simulate_baro", "simulate_heading"]

Array = NDArray[np.float64]


def simulate_baro(trajectory: Trajectory, baro: Baro, streams: Streams) -> tuple[BaroTable, dict[str, Array]]:
    """Heights of one run, ``h + bias + noise``, and the true bias.

    The bias starts from ``bias_initial_sd_m`` and walks on at the epochs of the truth, so that its law does not
    depend on the rate of the altimeter; outages of the receiver do not touch it.

    Parameters
    ----------
    trajectory : Trajectory
        Truth with n epochs.
    baro : Baro
        Figures of the altimeter.
    streams : Streams
        Random numbers of the run.

    Returns
    -------
    table : BaroTable
        Stamps are times of validity plus latency; heights are those of the IMU.
    blocks : dict of str to ndarray, shape (n, 1)
        ``baro_bias``, measured minus true, m; absent if the altimeter has no bias.
    """
    t_ns = fix_times(trajectory, baro)
    height = np.interp(t_ns, trajectory.t_ns, trajectory.lla[:, 2])
    height += streams("baro").standard_normal(len(t_ns)) * baro.height_sd_m
    blocks: dict[str, Array] = {}
    if baro.bias_initial_sd_m > 0.0 or baro.bias_walk_m_sqrt_s > 0.0:
        bias = random_walk(
            streams("baro.bias"),
            len(trajectory),
            float(np.mean(trajectory.dt_s)),
            np.array([baro.bias_walk_m_sqrt_s]),
            np.array([baro.bias_initial_sd_m]),
        )
        height += np.interp(t_ns, trajectory.t_ns, bias[:, 0])
        blocks["baro_bias"] = bias
    var = np.full(len(t_ns), baro.height_sd_m**2)
    return BaroTable(t_ns + ms_to_ns(baro.latency_ms), height, var), blocks


def simulate_heading(
    trajectory: Trajectory, heading: Heading, streams: Streams, outages: Sequence[tuple[float, float]]
) -> HeadingTable:
    """Headings of one run: that of the forward axis plus white noise.

    Noise is drawn for the values in outages too and thrown away, as with the fixes.

    Parameters
    ----------
    trajectory : Trajectory
        Truth.
    heading : Heading
        Figures of the antennas.
    streams : Streams
        Random numbers of the run.
    outages : sequence of (from, to)
        Times of validity [from, to) without fixes, s; the headings need the same satellites.

    Returns
    -------
    HeadingTable
        Stamps are times of validity plus latency; headings in [0, 2 pi).
    """
    t_ns = fix_times(trajectory, heading)
    true = np.interp(t_ns, trajectory.t_ns, np.unwrap(trajectory.rpy[:, 2]))
    sd = heading.heading_sd_deg * DEG_TO_RAD
    measured = np.mod(true + streams("heading").standard_normal(len(t_ns)) * sd, 2.0 * np.pi)
    seen = in_sight(t_ns, outages)
    stamps = t_ns + ms_to_ns(heading.latency_ms)
    return HeadingTable(stamps[seen], measured[seen], np.full(int(seen.sum()), sd**2))
