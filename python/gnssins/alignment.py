"""The state to start from: position and velocity from fixes, level from the accelerometer, heading from the course.

One fix starts the filter: the first one that has what the configuration asks for. The state is then carried to the
first IMU stamp after it, so that the same fix is not also used as a measurement. Leveling looks *forward* from
there, which a recording allows; a program that runs live collects its window first and passes the result on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.errors import InputError
from gnssins.leveling import (
    calibration,
    corrected,
    earth_rate_n,
    level,
    leveling_sd,
    mean_specific_force,
    phi_sd,
    refuse_no_gravity,
)
from gnssins.units import NS_PER_S

if TYPE_CHECKING:
    from gnssins.config import Config
    from gnssins.dataset import Dataset, GnssTable, ImuTable

__all__ = ["InitialState", "initial_state", "last_row_needed_ns"]

Array = NDArray[np.float64]

#: Uncertainty of the mean acceleration of a vehicle that the fixes see at rest, m/s^2 (1 sigma).
REST_ACCELERATION_SD_M_S2: Final = 0.05

#: The same of a vehicle that moves as the configuration says, no fix being looked at, m/s^2 (1 sigma).
UNKNOWN_ACCELERATION_SD_M_S2: Final = 0.5

#: Longest time between fixes over which their change of velocity is called an acceleration, s.
LONGEST_BASE_S: Final = 5.0

#: Uncertainty of the angle between the forward axis and the course (side slip, wind, mounting), deg (1 sigma).
CRAB_SD_DEG: Final = 3.0

#: Speed over its own uncertainty from which on it shows a course: receivers at rest report 1 m/s now and then.
COURSE_SIGMAS: Final = 5.0


#: Rows at the start of a log whose median interval is called usual.
USUAL_ROWS: Final = 1000


@dataclass(frozen=True, eq=False)
class InitialState:
    """Where a filter starts, and how well that is known; SI units and radians.

    Parameters
    ----------
    t_ns : int
        Time of the state.
    lla : ndarray, shape (3,)
        Latitude, longitude (rad), ellipsoidal height (m) of the IMU.
    v_n : ndarray, shape (3,)
        Velocity north, east, down (m/s).
    q_nb : ndarray, shape (4,)
        Attitude, body to NED, scalar first.
    sd_phi, sd_v, sd_p : ndarray, shape (3,)
        Standard deviations along north, east, down: attitude (rad), velocity (m/s), position (m).
    """

    t_ns: int
    lla: Array
    v_n: Array
    q_nb: Array
    sd_phi: Array
    sd_v: Array
    sd_p: Array

    def to_engine(self) -> dict[str, Any]:
        """Section ``initial`` of the engine configuration."""
        return {
            "t_ns": int(self.t_ns),
            "lat_rad": float(self.lla[0]),
            "lon_rad": float(self.lla[1]),
            "height_m": float(self.lla[2]),
            "v_n": [float(v) for v in self.v_n],
            "q_nb": [float(v) for v in self.q_nb],
            "sd_phi": [float(v) for v in self.sd_phi],
            "sd_v": [float(v) for v in self.sd_v],
            "sd_p": [float(v) for v in self.sd_p],
        }

    @classmethod
    def from_engine(cls, section: Mapping[str, Any]) -> InitialState:
        """Take over a section ``initial`` of an engine configuration."""
        return cls(
            int(section["t_ns"]),
            np.array([section["lat_rad"], section["lon_rad"], section["height_m"]], dtype=np.float64),
            *(np.array(section[key], dtype=np.float64) for key in ("v_n", "q_nb", "sd_phi", "sd_v", "sd_p")),
        )


@dataclass(frozen=True, eq=False)
class _Motion:
    """What the fixes say about one epoch: antenna position, velocity, mean acceleration after it, their sd."""

    valid_ns: int
    end_ns: int
    lla: Array
    sd_p: Array
    v_n: Array
    sd_v: Array
    acceleration: Array
    acceleration_sd: float


def initial_state(config: Config, dataset: Dataset) -> InitialState:
    """Find the state to start from as ``[initial]`` asks for.

    Parameters
    ----------
    config : Config
        Sections ``run``, ``initial``, ``gnss``, ``imu`` and ``filter`` are used.
    dataset : Dataset
        IMU and, if anything is to come from GNSS, fixes.

    Returns
    -------
    InitialState
        At the first IMU stamp after the fix that gave it; at ``start_s`` or the start of the IMU data
        if the configuration gives position and velocity.

    Raises
    ------
    InputError
        Empty IMU data, no fix with what is asked for, no fix with a speed that shows a course.
    DataQualityError
        The accelerometer does not show gravity in the window: wrong units or free fall.
    """
    imu = dataset.imu
    if len(imu) < 2:
        raise InputError(
            "input.empty",
            f"the IMU data have {len(imu)} rows, needs at least 2",
            "check [imu] file, start_s and end_s",
        )
    engine = config.engine_config()
    motion = _motion(config, dataset, _start_ns(config, imu), engine["gnss"]["latency_ns"])
    q_nb, sd_phi = _attitude(config, imu, engine, motion)
    return _at_imu_stamp(config, imu, engine, motion, q_nb, sd_phi)


def last_row_needed_ns(config: Config, start: InitialState) -> int:
    """Time from which on IMU rows have no influence on an initial state."""
    return start.t_ns + round((config.initial.leveling_window_s + 2.0 * LONGEST_BASE_S) * NS_PER_S)


def _start_ns(config: Config, imu: ImuTable) -> int:
    """Earliest time of the state: ``start_s``, or the start of the IMU data.

    The first row of increments or mean rates covers the usual interval before its stamp: the data start there. Usual is
    that of the first rows, which a log in pieces has as well.
    """
    if config.run.start_s is not None:
        return max(round(config.run.start_s * NS_PER_S), int(imu.t_ns[0]))
    return int(imu.t_ns[0]) - (0 if imu.kind == "rates" else int(np.median(np.diff(imu.t_ns[:USUAL_ROWS]))))


# ---- position, velocity, acceleration


def _motion(config: Config, dataset: Dataset, start_ns: int, latency_ns: int) -> _Motion:
    """Position and velocity at the start, from the configuration or from the first fix that has them."""
    initial = config.initial
    wanted = [
        name
        for name, value in (("position", initial.position), ("velocity", initial.velocity))
        if value == "gnss"
    ]
    if wanted:
        found = _from_fixes(config, dataset, start_ns, latency_ns, "position" in wanted)
    else:
        end_ns = start_ns + round(initial.leveling_window_s * NS_PER_S)
        at_rest = float(np.linalg.norm(np.asarray(initial.velocity, dtype=np.float64))) < 0.1
        sd = REST_ACCELERATION_SD_M_S2 if at_rest else UNKNOWN_ACCELERATION_SD_M_S2
        unknown = np.full(3, np.nan)
        found = _Motion(start_ns, end_ns, unknown, unknown, unknown, unknown, np.zeros(3), sd)
    if initial.position != "gnss":
        point = initial.position
        lla = np.array([np.radians(point.lat_deg), np.radians(point.lon_deg), point.height_m])
        found = replace(found, lla=lla)
    if initial.velocity != "gnss":
        found = replace(found, v_n=np.array(initial.velocity))
    if initial.position_sd_m is not None:
        found = replace(found, sd_p=np.array(initial.position_sd_m))
    if initial.velocity_sd_m_s is not None:
        found = replace(found, sd_v=np.array(initial.velocity_sd_m_s))
    for name, values in (("position_sd_m", found.sd_p), ("velocity_sd_m_s", found.sd_v)):
        if not np.isfinite(values).all():
            raise InputError(
                "input.no_sd",
                f"no accuracy is known for the initial {name.split('_')[0]}",
                f"give [initial] {name} = [north, east, down], or [gnss] {name}",
            )
    return found


def _from_fixes(config: Config, dataset: Dataset, start_ns: int, latency_ns: int, position: bool) -> _Motion:
    """The first fix from ``start_ns`` on that can start the filter."""
    gnss, imu = _sound(dataset.gnss), dataset.imu
    valid = gnss.t_ns - latency_ns
    end_ns = int(imu.t_ns[-1])
    if config.run.end_s is not None:
        end_ns = min(end_ns, round(config.run.end_s * NS_PER_S))
    last = end_ns - round(config.initial.leveling_window_s * NS_PER_S)
    usable = (valid >= start_ns) & (valid >= imu.t_ns[0]) & (valid <= last)
    for from_s, to_s in config.run.outages:
        usable &= (valid < round(from_s * NS_PER_S)) | (valid >= round(to_s * NS_PER_S))
    if position or not gnss.has_velocity.any():
        usable &= gnss.has_position
    if gnss.has_velocity.any() and config.gnss.uses_velocity:
        usable &= gnss.has_velocity
    usable = _with_accuracy(config, gnss, usable)
    needs_course = config.initial.heading_deg is None and config.initial.velocity == "gnss"
    limit, candidates, fastest = config.initial.course_min_speed_m_s, usable, 0.0
    if needs_course and config.gnss.uses_velocity and gnss.has_velocity.any():
        speed = np.nan_to_num(np.hypot(gnss.v_n[:, 0], gnss.v_n[:, 1]))
        candidates, fastest = usable & (speed >= limit), float(speed[usable].max(initial=0.0))
    for row in np.flatnonzero(candidates):
        motion = _at_fix(config, gnss, valid, int(row))
        ground = float(np.hypot(motion.v_n[0], motion.v_n[1]))
        if np.isfinite(motion.v_n).all():
            if not needs_course or ground >= max(limit, COURSE_SIGMAS * float(motion.sd_v[:2].max())):
                return motion
            fastest = max(fastest, ground)
    if not usable.any():
        what = "position" if position else "velocity"
        unsound = int((dataset.gnss.has_position & ~gnss.has_position).sum())
        more = f", {unsound} of them at 0, 0 or with an accuracy that is not positive" if unsound else ""
        raise InputError(
            "input.no_start_fix",
            f"no fix with a {what} from {start_ns / NS_PER_S:.3f} s on that the IMU data cover "
            f"({imu.t_ns[0] / NS_PER_S:.3f} s to {end_ns / NS_PER_S:.3f} s; {len(gnss)} fixes in all{more})",
            "check that both files count time on one clock, or give [initial] position and velocity",
            {"fixes": len(gnss), "start_s": start_ns / NS_PER_S, "end_s": end_ns / NS_PER_S},
        )
    if config.run.end_s is not None:
        raise InputError(
            "input.no_start_fix",
            f"no fix faster than course_min_speed_m_s = {limit:g} and {COURSE_SIGMAS:g} of its sigmas "
            f"between {start_ns / NS_PER_S:g} and {end_ns / NS_PER_S:g} s; "
            f"fastest {fastest:.2f} m/s of {int(usable.sum())} fixes",
            "give [initial] heading_deg, or raise [run] end_s",
            {"fastest_m_s": fastest, "needs_m_s": limit, "end_s": end_ns / NS_PER_S},
        )
    raise InputError(
        "input.no_course",
        f"no fix from {start_ns / NS_PER_S:.3f} s on shows a course: fastest {fastest:.2f} m/s, "
        f"needs {limit:g} m/s and {COURSE_SIGMAS:g} times its sigma",
        "give [initial] heading_deg, or lower course_min_speed_m_s if the vehicle really moves that slowly",
        {"fastest_m_s": fastest, "needs_m_s": limit},
    )


def _sound(gnss: GnssTable) -> GnssTable:
    """Fixes without what receivers write when they have none: 0, 0, infinities, variances that are not positive."""
    var = gnss.var if gnss.var.ndim == 2 else np.diagonal(gnss.var, axis1=1, axis2=2)
    null = (gnss.lla[:, 0] == 0.0) & (gnss.lla[:, 1] == 0.0)
    bad = null | ~np.isfinite(gnss.lla).all(axis=1) | (var[:, :3] <= 0.0).any(axis=1)
    wrong = ~np.isfinite(gnss.v_n) | (var[:, 3:] <= 0.0)
    return replace(gnss, lla=np.where(bad[:, None], np.nan, gnss.lla), v_n=np.where(wrong, np.nan, gnss.v_n))


def _with_accuracy(config: Config, gnss: GnssTable, usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Of the usable fixes those whose accuracy is known, where it is needed and known for any."""
    sd, initial = gnss.sd, config.initial
    needed = [(sd[:, :3], initial.position == "gnss" and initial.position_sd_m is None)]
    if config.gnss.uses_velocity and gnss.has_velocity.any():
        needed.append((sd[:, 3:5], initial.velocity == "gnss" and initial.velocity_sd_m_s is None))
    for values, wanted in needed:
        known = usable & np.isfinite(values).all(axis=1)
        if wanted and known.any():
            usable = known
    return usable


def _at_fix(config: Config, gnss: GnssTable, valid: NDArray[np.int64], row: int) -> _Motion:
    """Position, velocity and acceleration at one fix and over the leveling window after it."""
    end_ns = int(valid[row]) + round(config.initial.leveling_window_s * NS_PER_S)
    sd = gnss.sd[row]
    unknown = np.full(3, np.nan)
    base = _Motion(
        int(valid[row]),
        end_ns,
        gnss.lla[row],
        sd[:3],
        unknown,
        unknown,
        np.zeros(3),
        REST_ACCELERATION_SD_M_S2,
    )
    if gnss.has_velocity[row] and config.gnss.uses_velocity:
        v_n, sd_v = gnss.v_n[row].copy(), sd[3:].copy()
        # a receiver without vertical velocity: take zero, as uncertain as the horizontal speed allows
        v_n[2], sd_v[2] = (
            (v_n[2], sd_v[2]) if np.isfinite(v_n[2]) else (0.0, max(1.0, 0.1 * float(np.hypot(*v_n[:2]))))
        )
        return _with_acceleration(replace(base, v_n=v_n, sd_v=sd_v), gnss, valid, config)
    return _from_positions(base, gnss, valid, row)


def _with_acceleration(motion: _Motion, gnss: GnssTable, valid: NDArray[np.int64], config: Config) -> _Motion:
    """Mean acceleration over the window from the velocities at its ends; zero for a vehicle at rest.

    The window is moved to end at a fix, so that the mean specific force and the change of velocity belong to the same
    span of time.
    """
    use = (
        gnss.has_velocity
        & (valid >= motion.valid_ns)
        & (valid <= motion.valid_ns + LONGEST_BASE_S * NS_PER_S)
    )
    rows = np.flatnonzero(use)
    if rows.size < 2:
        return motion
    # the fix nearest to the end of the window, or the next one
    last = rows[1:][np.argmin(np.abs(valid[rows[1:]] - motion.end_ns))]
    inside = rows[(valid[rows] <= valid[last])]
    v_n, sd = np.nan_to_num(gnss.v_n), np.nan_to_num(gnss.sd[:, 3:], nan=0.5)
    speed = np.hypot(v_n[inside, 0], v_n[inside, 1])
    at_rest = speed.max() < max(config.initial.course_min_speed_m_s, 3.0 * float(sd[inside, :2].max()))
    if at_rest:
        return motion
    span_s = float(valid[last] - valid[rows[0]]) / NS_PER_S
    acceleration = (v_n[last] - v_n[rows[0]]) / span_s
    acceleration_sd = float(np.hypot(sd[last, :2].max(), sd[rows[0], :2].max())) / span_s
    return replace(
        motion,
        valid_ns=int(valid[rows[0]]),
        end_ns=int(valid[last]),
        acceleration=acceleration,
        acceleration_sd=float(np.hypot(acceleration_sd, REST_ACCELERATION_SD_M_S2)),
    )


def _from_positions(motion: _Motion, gnss: GnssTable, valid: NDArray[np.int64], row: int) -> _Motion:
    """Velocity and acceleration of a parabola through the positions of the window (at least four of them)."""
    rows = np.flatnonzero(gnss.has_position & (valid >= valid[row]))
    inside = rows[valid[rows] <= motion.end_ns]
    rows = inside if inside.size >= 4 else rows[:4]
    if rows.size < 4 or valid[rows[-1]] - valid[row] > 2.0 * LONGEST_BASE_S * NS_PER_S:
        return motion
    t = (valid[rows] - valid[row]) / NS_PER_S
    radii = _core.radii(gnss.lla[row : row + 1, 0].copy(), "wgs84")[0] + gnss.lla[row, 2]
    step = gnss.lla[rows] - gnss.lla[row]
    ned = np.column_stack(
        [step[:, 0] * radii[0], step[:, 1] * radii[1] * np.cos(gnss.lla[row, 0]), -step[:, 2]]
    )
    design = np.column_stack([np.ones_like(t), t, 0.5 * t * t])
    solution, *_ = np.linalg.lstsq(design, ned, rcond=None)
    spread = np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    sd = np.nan_to_num(gnss.sd[row, :3], nan=1.0)
    return replace(
        motion,
        v_n=solution[1],
        sd_v=spread[1] * sd,
        acceleration=solution[2],
        acceleration_sd=float(np.hypot(spread[2] * sd[:2].max(), REST_ACCELERATION_SD_M_S2)),
        end_ns=int(valid[rows[-1]]),
    )


# ---- attitude


def _attitude(config: Config, imu: ImuTable, engine: dict[str, Any], motion: _Motion) -> tuple[Array, Array]:
    """Attitude (4,) at ``motion.valid_ns`` and the sd of phi (3,)."""
    initial, given = config.initial, config.initial.model_fields_set
    speed = float(np.hypot(motion.v_n[0], motion.v_n[1]))
    heading_sd = np.radians(initial.heading_sd_deg)
    if initial.heading_deg is not None:
        heading = float(np.radians(initial.heading_deg))
    else:
        if speed < initial.course_min_speed_m_s:
            raise InputError(
                "input.no_course",
                f"the initial velocity of {speed:.2f} m/s shows no course, needs {initial.course_min_speed_m_s:g} m/s",
                "give [initial] heading_deg",
            )
        heading = float(np.arctan2(motion.v_n[1], motion.v_n[0]))
        course_sd = np.hypot(float(motion.sd_v[:2].max()) / speed, np.radians(CRAB_SD_DEG))
        heading_sd = heading_sd if "heading_sd_deg" in given else max(heading_sd, course_sd)
    sd = np.radians([initial.roll_sd_deg, initial.pitch_sd_deg])
    if initial.roll_deg is not None and initial.pitch_deg is not None:
        roll, pitch = np.radians([initial.roll_deg, initial.pitch_deg])
    else:
        f_b, span_s = mean_specific_force(imu, motion.valid_ns, motion.end_ns, *calibration(engine))
        gravity = _core.gravity_n(
            motion.lla[:1].copy(), motion.lla[2:].copy(), engine["ellipsoid"], engine["gravity"]
        )[0]
        refuse_no_gravity(f_b, float(gravity[2]))
        coriolis = np.cross(2.0 * earth_rate_n(motion.lla[0]), motion.v_n)
        roll, pitch = level(f_b, motion.acceleration - gravity + coriolis, heading)
        computed = leveling_sd(engine, motion.acceleration_sd, span_s, float(gravity[2]))
        for i, key in enumerate(("roll_sd_deg", "pitch_sd_deg")):
            sd[i] = sd[i] if key in given else max(sd[i], computed)
    q_nb = _core.euler_to_quat(np.array([[roll, pitch, heading]]))[0]
    return q_nb, phi_sd(float(sd[0]), float(sd[1]), float(heading_sd), float(pitch), heading)


# ---- from the antenna at the fix to the IMU at its stamp


def _at_imu_stamp(
    config: Config, imu: ImuTable, engine: dict[str, Any], motion: _Motion, q_nb: Array, sd_phi: Array
) -> InitialState:
    """Take off the lever arm and carry the state to the first IMU stamp after the fix, if a fix gave it."""
    if config.initial.position != "gnss" and config.initial.velocity != "gnss":
        return InitialState(motion.valid_ns, motion.lla, motion.v_n, q_nb, sd_phi, motion.sd_v, motion.sd_p)
    after = int(np.searchsorted(imu.t_ns, motion.valid_ns, side="right"))
    after = min(max(after, 1), len(imu) - 1)
    dt = (int(imu.t_ns[after]) - motion.valid_ns) / NS_PER_S
    step = (imu.t_ns[after] - imu.t_ns[after - 1]) / NS_PER_S
    rate = corrected(
        imu.gyro[after : after + 1] / (step if imu.kind == "increments" else 1.0), calibration(engine)[0]
    )
    rate = np.nan_to_num(rate)
    c_nb = _core.quat_to_dcm(q_nb[None])[0]
    lla, v_n = motion.lla.copy(), motion.v_n.copy()
    radii = _core.radii(lla[:1].copy(), engine["ellipsoid"])[0] + lla[2]
    lever = np.array(engine["gnss"]["lever_b_m"])
    if config.initial.velocity == "gnss":
        v_n -= c_nb @ np.cross(rate[0], lever)
    offset = (c_nb @ lever if config.initial.position == "gnss" else np.zeros(3)) - v_n * dt
    lla[0] -= offset[0] / radii[0]
    lla[1] -= offset[1] / (radii[1] * np.cos(lla[0]))
    lla[2] += offset[2]
    turned = _core.quat_mul(q_nb[None], _core.rotvec_to_quat(rate * dt))[0]
    v_n += motion.acceleration * dt
    return InitialState(int(imu.t_ns[after]), lla, v_n, turned, sd_phi, motion.sd_v, motion.sd_p)
