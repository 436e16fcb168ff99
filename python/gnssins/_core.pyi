"""Compiled core: SI units, radians, int64 nanoseconds; body axes forward-right-down, navigation axes NED.

Arrays are copied in, the IMU log block by block. Quaternions are scalar first and take body vectors to NED. Every
function raises the classes of :mod:`gnssins.errors`: ``InputError`` for shapes and types, ``ConfigError`` for values.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NotRequired, Self, TypedDict, final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import disjoint_base

__all__ = [
    "FreeIns",
    "MonteCarlo",
    "Navigator",
    "Run",
    "ahrs_flags",
    "ahrs_run",
    "aiding_jacobians",
    "dcm_to_quat",
    "ecef_to_lla",
    "error_dynamics",
    "euler_to_quat",
    "gravity_n",
    "invert_strapdown",
    "is_debug_build",
    "lla_to_ecef",
    "monte_carlo_deviates",
    "preset_json",
    "preset_names",
    "preset_summary",
    "quat_mul",
    "quat_to_dcm",
    "quat_to_euler",
    "quat_to_rotvec",
    "radii",
    "rotvec_to_quat",
    "run",
    "strapdown",
    "strapdown_three_rate",
    "version",
]

_F = NDArray[np.float64]
_I = NDArray[np.int64]
_Vector = _F | Sequence[float]

class _State(TypedDict):
    name: str
    unit: str
    scale: float
    block: str
    kind: str

class _Event(TypedDict):
    t_ns: int
    code: str
    row: int
    value: float
    message: str

class _Measurements(TypedDict):
    row: _I
    t_ns: _I
    status: NDArray[np.uint8]
    dof: NDArray[np.uint8]
    nis: _F
    innovation: _F
    innovation_cov: _F
    reason: list[str]
    refused: NDArray[np.uint8]

class _AidMeasurements(TypedDict):
    row: _I
    t_ns: _I
    status: NDArray[np.uint8]
    dof: NDArray[np.uint8]
    nis: _F
    innovation: _F
    variance: _F
    reason: list[str]
    refused: NDArray[np.uint8]

class _Taken(TypedDict):
    gnss: _Measurements
    baro: _AidMeasurements
    heading: _AidMeasurements

class _Linearised(TypedDict):
    t_ns: _I
    phi: _F
    h: _F
    r: _F
    lla: _F
    q_nb: _F

class _Track(TypedDict):
    t_ns: _I
    lla: _F
    v_n: _F
    rpy: _F
    q_nb: _F
    sd: _F
    x: _F
    x_sd: _F

class _Columns(_Track):
    cov_t_ns: _I
    cov: _F

class _About(TypedDict):
    states: list[_State]
    meas: _Measurements
    baro: _AidMeasurements
    heading: _AidMeasurements
    lin: NotRequired[_Linearised]
    events: list[_Event]
    counts: dict[str, dict[str, int]]
    final_state: bytes

class _Run(_Columns, _About): ...

class _NavigatorState(TypedDict):
    t_ns: int
    lla: _F
    v_n: _F
    rpy: _F
    q_nb: _F
    sd: _F
    x: _F
    x_sd: _F

class _Ahrs(TypedDict):
    q_nb: _F
    bias: _F
    elements: _F
    sd: _F
    flags: NDArray[np.uint16]

def version() -> str:
    """Version of the compiled core."""

def is_debug_build() -> bool:
    """Tell whether the core was built without optimisation."""

def preset_names() -> list[str]:
    """Names of the presets."""

def preset_json(name: str) -> str:
    """Return a preset as engine configuration (JSON, SI units)."""

def preset_summary(name: str) -> str:
    """One line about a preset."""

def run(
    config_json: str,
    imu_t_ns: _I,
    gyro: _F,
    accel: _F,
    gnss_t_ns: _I,
    gnss_pos: _F,
    gnss_vel: _F,
    gnss_var: _F,
    progress: Callable[[float], object] | None = None,
    *,
    gnss_new: NDArray[np.bool_] | None = None,
    baro: tuple[_I, _F, _F] | None = None,
    heading: tuple[_I, _F, _F] | None = None,
) -> _Run:
    """Run a filter over a log, with the GIL released.

    Parameters
    ----------
    config_json
        Engine configuration; built by :meth:`gnssins.Config.engine_config`.
    imu_t_ns, gyro, accel
        IMU rows, shapes (n,), (n, 3), (n, 3): rates (rad/s, m/s²) or increments (rad, m/s) as configured.
    gnss_t_ns, gnss_pos, gnss_vel, gnss_var
        GNSS rows, shapes (m,), (m, 3), (m, 3), (m, 6) or (m, 6, 6): latitude, longitude (rad), height (m);
        velocity NED (m/s); variances (m², m²/s²). NaN marks an absent component.
    progress
        Called now and then with the share done, 0 to 1.
    gnss_new
        Rows at which the constellation changed, shape (m,).
    baro, heading
        Stamps, heights (m) or headings (rad), and variances (m² or rad²), shapes (k,).

    Returns
    -------
    dict
        ``t_ns`` (k,), ``lla`` (k, 3), ``v_n`` (k, 3), ``rpy`` (k, 3), ``q_nb`` (k, 4); ``sd`` (k, 9): N, E, D (m),
        vN, vE, vD (m/s), roll, pitch, heading (rad); ``x``, ``x_sd`` (k, blocks); ``states``; ``cov_t_ns`` (c,),
        ``cov`` (c, n, n) of the error states along NED; ``meas``, one entry per GNSS row, status 0 used, 1 rejected,
        2 late, 3 bad; ``baro`` and ``heading`` likewise; ``events``; ``counts``; ``final_state``; ``lin`` as
        :class:`gnssins.result.Linearisation` where ``output.linearise`` asks for it.

    Raises
    ------
    gnssins.errors.GnssinsError
        Its class and ``code`` say what: time order, gap, covariance, data quality, configuration.
    """

def ahrs_run(config_json: str, t_ns: _I, gyro: _F, accel: _F, mag: _F | None = None) -> _Ahrs:
    """Run an attitude estimator over a log, with the GIL released.

    Parameters
    ----------
    config_json
        ``{"method", "settings", "input", "max_gap_ns"}``; built by :func:`gnssins.ahrs.run`.
    t_ns, gyro, accel
        Rows, shapes (n,), (n, 3), (n, 3): rates (rad/s, m/s²) or increments (rad, m/s) as ``input`` says. A row of
        ``gyro`` that is not finite leaves its interval to the next one.
    mag
        Magnetic field, shape (n, 3), any unit; NaN where there is none.

    Returns
    -------
    dict
        ``q_nb`` (n, 4), ``bias`` (n, 3) in rad/s, ``elements`` (n, 3): roll, pitch, heading (rad) read from single
        direction cosines, (0, 3) for estimators without them; ``sd`` (n, 6): 1σ of the attitude error about north,
        east, down (rad) and of the bias (rad/s), (0, 6) for estimators without them; ``flags`` (n,), bits as in
        :func:`ahrs_flags`.

    Raises
    ------
    gnssins.errors.GnssinsError
        Configuration, time order, gap.
    """

def ahrs_flags() -> list[tuple[str, int]]:
    """Names of the flags of :func:`ahrs_run` and their bits."""

@final
class Run:
    """A run whose IMU log comes in pieces: the pieces of :func:`run` with the same bits, whatever their lengths.

    Arguments and dictionaries as for :func:`run`. The share of bad rows is not looked at.
    """

    def __new__(
        cls,
        config_json: str,
        gnss_t_ns: _I,
        gnss_pos: _F,
        gnss_vel: _F,
        gnss_var: _F,
        *,
        gnss_new: NDArray[np.bool_] | None = None,
        baro: tuple[_I, _F, _F] | None = None,
        heading: tuple[_I, _F, _F] | None = None,
    ) -> Run: ...
    def states(self) -> list[_State]:
        """Name, unit, block and kind of every error state."""

    def imu(self, t_ns: _I, gyro: _F, accel: _F) -> _Columns:
        """Take the next rows of the IMU log; return the epochs and covariances that they give."""

    def finish(self) -> _About:
        """End the log; return everything that is not a column over time."""

@disjoint_base
class Navigator:
    """A filter fed row by row; gives the same bits as :func:`run` on the same rows in time order.

    Times are seconds as float, nanoseconds as int. The public class :class:`gnssins.Navigator` is made of this one.
    """

    def __new__(cls, config_json: str) -> Self: ...
    def imu(self, t: float | int, gyro: ArrayLike, accel: ArrayLike) -> None:
        """Take one IMU row: stamp, three rates or increments, three specific forces or increments."""

    def imu_xyz(
        self, t: float | int, wx: float, wy: float, wz: float, fx: float, fy: float, fz: float
    ) -> None:
        """Take one IMU row as six numbers."""

    def _imu_many(self, t_ns: _I, gyro: _F, accel: _F, interval_ns: int | None = None) -> _Track:
        """Take rows (n,), (n, 3), (n, 3); return the estimates at the spacing, all for 0, none for None."""

    def _gnss(
        self,
        t: float | int,
        pos: ArrayLike | None,
        vel: ArrayLike | None,
        var: ArrayLike,
        new_constellation: bool = False,
    ) -> None:
        """Take a fix: stamp, latitude, longitude (rad), height (m), velocity NED (m/s), variances (6,) or (6, 6)."""

    def _baro(self, t: float | int, height_m: float, variance: float) -> None:
        """Take a barometric height: stamp, height (m), variance of its white noise (m²)."""

    def _heading(self, t: float | int, heading_rad: float, variance: float) -> None:
        """Take a heading of the forward axis: stamp, heading (rad), variance (rad²)."""

    def finish(self) -> None:
        """End a log: fixes that still wait for an IMU row are counted as late."""

    def _state(self) -> _NavigatorState:
        """Return the present solution, its standard deviations and the block states."""

    def _states(self) -> list[_State]:
        """Name, unit, block and kind of every error state."""

    def _cov(self) -> _F:
        """Covariance of the error states along NED, shape (n, n)."""

    def save(self) -> bytes:
        """Return the whole state; :meth:`restore` continues from it with the same bits."""

    def restore(self, saved: bytes) -> None:
        """Restore what a navigator of the same configuration saved."""

    def _take_measurements(self) -> _Taken:
        """Return the records since the last call, by source."""

    def _take_events(self) -> list[_Event]:
        """Return the events since the last call."""

    def _counts(self) -> dict[str, dict[str, int]]:
        """Rows by source: in, used, rejected, late, bad."""

@final
class MonteCarlo:
    """Many simulated runs of one scenario: what they share is prepared once.

    ``engine_json`` is the configuration of the filter with the true state at the start and its standard deviations;
    ``spec_json`` the figures of the sensors and what is asked, ``columns`` truth, aids and epochs of comparison, as
    :mod:`gnssins.montecarlo.plan` makes them.
    """

    #: Runs whose sums come together.
    CHUNK: ClassVar[int]

    def __new__(cls, engine_json: str, spec_json: str, columns: Mapping[str, Any]) -> MonteCarlo: ...
    def run(self, first: int, last: int, jobs: int, take: Callable[[int, dict[str, Any]], object]) -> None:
        """Go through runs ``first`` .. ``last - 1`` on threads, the GIL released.

        ``take`` gets the first run and the sums of every chunk, in order and in the calling thread; it may raise.
        Ctrl-C raises within a tenth of a second after the chunks under way.
        """

    def simulated(self, run: int) -> dict[str, Any]:
        """Give increments, values of the aids, true errors and initial state of one run."""

@final
class FreeIns:
    """A free INS that is fed in pieces: state and memory of the increments stay between them.

    With an outer height the vertical channel is held to it, or damped by a third-order loop with the time constant
    ``vertical_tau_s``.
    """

    def __new__(
        cls,
        model: str,
        ellipsoid: str,
        gravity: str,
        coning: str,
        t_ns: int,
        lla0: _Vector,
        v0: _Vector,
        q0: _Vector,
        *,
        attitude_form: str = "rotation-vector",
        vertical_tau_s: float | None = None,
    ) -> FreeIns: ...
    @property
    def t_ns(self) -> int:
        """Time of the state, ns."""

    def state(self) -> tuple[_F, _F, _F]:
        """Return position (3,), velocity NED (3,) and attitude (4,)."""

    def restart(
        self, lla: _Vector | None = None, v_n: _Vector | None = None, q_nb: _Vector | None = None
    ) -> None:
        """Replace position (rad, rad, m), velocity (m/s) or attitude; what is left out stays."""

    def run(self, t_ns: _I, dtheta: _F, dvel: _F, height: _F | None = None) -> tuple[_F, _F, _F]:
        """Integrate increments up to the stamps (n,); one row of position, velocity, attitude per stamp.

        ``height`` (n,) is the outer height at the stamps, m; NaN where there is none.
        """

def radii(lat: _F, ellipsoid: str) -> _F:
    """Radii of curvature R_M, R_N (m), shape (k, 2), at latitudes (rad) (k,). Groves (2013), eq. 2.105-2.106."""

def gravity_n(lat: _F, height: _F, ellipsoid: str, gravity: str = "normal") -> _F:
    """Gravity along NED (m/s²), shape (k, 3); ``gravity`` is "normal" or "vertical" (no north component)."""

def lla_to_ecef(lla: _F, ellipsoid: str) -> _F:
    """Latitude, longitude (rad), height (m), shape (k, 3), to ECEF (m)."""

def monte_carlo_deviates(seed: int, run: int, name: str, part: int, count: int) -> _F:
    """Normal deviates of a part of a stream, by its name, of one run: shape (count,), from the first on.

    Parts from 0 drive the intervals or values one after the other, one part per component; those from 64 hold, first of
    each, what is drawn at the start.
    """

def ecef_to_lla(ecef: _F, ellipsoid: str) -> _F:
    """ECEF (m), shape (k, 3), to latitude, longitude (rad), height (m)."""

def euler_to_quat(rpy: _F) -> _F:
    """Roll, pitch, heading (rad), shape (k, 3), to quaternions (k, 4)."""

def quat_to_euler(q: _F) -> _F:
    """Quaternions (k, 4) to roll, pitch, heading (rad)."""

def quat_to_dcm(q: _F) -> _F:
    """Quaternions (k, 4) to rotation matrices (k, 3, 3)."""

def dcm_to_quat(c: _F) -> _F:
    """Rotation matrices (k, 3, 3) to quaternions (k, 4)."""

def rotvec_to_quat(rotvec: _F) -> _F:
    """Rotation vectors (rad), shape (k, 3), to quaternions (k, 4)."""

def quat_to_rotvec(q: _F) -> _F:
    """Quaternions (k, 4) to rotation vectors (rad), angle at most pi."""

def quat_mul(a: _F, b: _F) -> _F:
    """Row-wise product of quaternions (k, 4): the rotation b, then a."""

def strapdown(
    model: str,
    ellipsoid: str,
    gravity: str,
    coning: str,
    t_ns: _I,
    dtheta: _F,
    dvel: _F,
    lla0: _Vector,
    v0: _Vector,
    q0: _Vector,
    *,
    attitude_form: str = "rotation-vector",
) -> tuple[_F, _F, _F]:
    """Integrate increments without aids; row 0 is the start, row k leads there from row k-1.

    ``attitude_form`` is "rotation-vector" (exact), "euler", "dcm", "quaternion", "picard" or "two-quaternions"; all but
    the first need the model "ned". Returns position (n, 3), velocity NED (n, 3) and attitude (n, 4).
    """

def strapdown_three_rate(
    ellipsoid: str,
    gravity: str,
    coning: str,
    attitude_form: str,
    divisors: tuple[int, int],
    gather: str,
    t_ns: _I,
    dtheta: _F,
    dvel: _F,
    lla0: _Vector,
    v0: _Vector,
    q0: _Vector,
) -> tuple[_F, _F, _F]:
    """Integrate increments in the NED model in three rates; rows as in :func:`strapdown`.

    Attitude is stepped at every sample, velocity at every ``divisors[0]``-th, position, gravity and the rates of the
    navigation axes at every ``divisors[1]``-th velocity step; in between the rows repeat the last value. ``gather``:
    "body" sums the velocity increments in body axes and turns them once, "navigation" turns each by itself.
    """

def invert_strapdown(
    model: str, ellipsoid: str, gravity: str, coning: str, t_ns: _I, lla0: _Vector, v_n: _F, q_nb: _F
) -> tuple[_F, _F, _F]:
    """Find the increments with which :func:`strapdown` follows given velocities (n, 3) and attitudes (n, 4).

    Returns position (n, 3), which is the step's own integral of the velocity, ``dtheta`` (n, 3) in rad and ``dvel``
    (n, 3) in m/s; row 0 of the increments is zero.
    """

def error_dynamics(
    model: str,
    ellipsoid: str,
    gravity: str,
    lla: _Vector,
    v_n: _Vector,
    q_nb: _Vector,
    f_b: _Vector,
) -> dict[str, Any]:
    """System matrix ``f`` (9, 9) and couplings ``gyro``, ``accel`` (9, 3) at one point, in the model's axes."""

def aiding_jacobians(
    model: str,
    ellipsoid: str,
    lla: _Vector,
    v_n: _Vector,
    q_nb: _Vector,
    w_ib_b: _Vector,
    lever_b: _Vector,
) -> dict[str, Any]:
    """Jacobians of predicted minus measured at one point, rows north, east, down.

    ``position``, ``velocity`` (3, 9) over phi, dv, dp; ``position_lever``, ``velocity_lever``, ``velocity_gyro``
    (3, 3) over the remaining lever-arm (m) and gyro (rad/s) errors.
    """
