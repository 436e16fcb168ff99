"""The initial state of a run: the truth at the start with errors drawn from their standard deviations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..alignment import InitialState
from .frames import c_en, displaced
from .scenario import InitialError
from .streams import Streams
from .trajectory import Trajectory

__all__ = ["draw_initial_state"]

Array = NDArray[np.float64]


def draw_initial_state(
    trajectory: Trajectory, figures: InitialError, streams: Streams
) -> tuple[InitialState, Array]:
    """Draw the initial errors of one run.

    The attitude error is that of the estimated rotation: ``C_est = Exp(-phi) C_true``, to north-east-down
    axes in the NED model, to ECEF axes (with phi resolved along the true north, east, down) in the ECEF
    model. The two differ by the turn of the local axes over the position error, which counts next to a pole.

    Parameters
    ----------
    trajectory : Trajectory
        Truth; the state is that of its first epoch.
    figures : InitialError
        Standard deviations.
    streams : Streams
        Random numbers of the run.

    Returns
    -------
    state : InitialState
        What the filter is told at the start.
    error : ndarray, shape (9,)
        The errors in it, estimate minus truth, along north, east, down: phi (rad), velocity (m/s), position
        (m).
    """
    sds = [np.asarray(sd) for sd in (figures.attitude_sd_rad, figures.velocity_sd_m_s, figures.position_sd_m)]
    names = ("initial.attitude", "initial.velocity", "initial.position")
    phi, dv, dp = (sd * streams(name).standard_normal(3) for sd, name in zip(sds, names, strict=True))
    true = trajectory.lla[:1]
    estimate = displaced(true, dp[np.newaxis], trajectory.ellipsoid)
    q_nb = _core.quat_mul(_core.rotvec_to_quat(-phi[np.newaxis]), trajectory.q_nb[:1])
    if trajectory.model == "ecef":
        turn = np.swapaxes(c_en(estimate), 1, 2) @ c_en(true)
        q_nb = _core.quat_mul(_core.dcm_to_quat(turn), q_nb)
    v_n = trajectory.v_n[0] + dv
    state = InitialState(int(trajectory.t_ns[0]), estimate[0], v_n, np.asarray(q_nb[0]), *sds)
    return state, np.concatenate([phi, dv, dp])
