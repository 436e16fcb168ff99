"""The filter of Novik (2011) in its own coordinates, 22 states, as derived and as printed.

States: dR_E, dR_N, dh (m, reduced: R0 times the errors of longitude and latitude, so dR_E is 1/cos(latitude) longer
than on the ground), dV_E, dV_N, dV_h (m/s), al_E, al_N, al_h (rad), gyro drifts (rad/s) and accelerometer errors
(m/s^2) of body axes forward, up, right, barometer (m), slow errors of the receiver's position (m) and velocity (m/s).
Errors are computed minus true. Written from the strapdown equations of the publication with its axes, and so a check
of the engine that owes nothing to it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.sim import Scenario
from gnssins.sim.analytic import evaluate
from gnssins.sim.frames import EARTH_RATE_RAD_S
from gnssins.units import ACCEL_BIAS, DEG_SQRT_H_TO_RAD_SQRT_S, GYRO_BIAS

__all__ = [
    "ERRATA", "R0_M", "STATES", "Motion", "initial_covariance", "jump_covariance", "observation", "system_matrix",
    "transition",
]  # fmt: skip

Array = NDArray[np.float64]
Entries = dict[tuple[int, int], Array]

#: Radius of the reduced coordinates, m; any constant.
R0_M: Final = 6_371_000.0

STATES: Final = 22

#: Gravity at the equator (m/s^2), first eccentricity squared, semi-major axis (m), of WGS-84.
_G_E, _E2, _A_M = 9.7803253359, 0.00669437999014, 6378137.0
_Q = EARTH_RATE_RAD_S**2 * _A_M / _G_E

_WALK: Final = {"gyro": 0.001 / 60.0 * GYRO_BIAS["deg/h"], "accel": 5.0 / 60.0 * ACCEL_BIAS["ug"]}
_WHITE: Final = {"gyro": 0.002 * DEG_SQRT_H_TO_RAD_SQRT_S, "accel": 10.0 * ACCEL_BIAS["ug"]}
_BIAS: Final = {"gyro": 0.003 * GYRO_BIAS["deg/h"], "accel": 25.0 * ACCEL_BIAS["ug"]}

#: "Mid" values of the receiver: slow errors and white noise of position E, N, h (m) and velocity (m/s), their jumps.
_SLOW: Final = np.array([6.0, 6.0, 8.5, 0.05, 0.05, 0.05])
_NOISE: Final = np.array([2.0, 2.0, 2.5, 0.03, 0.03, 0.03])
_SLOW_JUMP: Final = np.array([3.0, 3.0, 5.0, 0.015, 0.015, 0.015])
_NOISE_JUMP: Final = np.array([2.0, 2.0, 3.0, 0.05, 0.05, 0.05])
_RATE_M, _RATE_S, _RATE_V = 4e-6, 5e-4, 0.02
_BARO_NOISE_M, _BARO_WALK, _BARO_M = 0.75, 0.035, 4.0

#: Misprints that change the filter, by their number in the list of errata, and what is printed.
ERRATA: Final[Mapping[str, str]] = {
    "21": "f12 = lon' tan(lat)/R0",
    "22": "f23 with the other sign",
    "23": "f43 = (V_E/R)(...) for V_E/R^2",
    "24": "f52: V_E^2 tan^2/R for /(R R0)",
    "25": "f54, f64: 2u + lon' for 2(u + lon')",
    "26": "f62: other sign of the gravity term, R for R0",
    "27": "f63 = -g/a - ... for +2 g/a - ...",
    "28a": "row 9 without columns 4, 7, 8",
    "28b": "f92 = u cos + lon'/cos/R0, without the bracket",
}


@dataclass(frozen=True, eq=False)
class Motion:
    """The track at m times.

    Parameters
    ----------
    lat_rad, lat_rate, lon_rate : ndarray, shape (m,)
        Latitude, and the rates of latitude and longitude, rad/s.
    height_m : ndarray, shape (m,)
        Height.
    radii_m : ndarray, shape (m, 2)
        R_M + h and R_P + h.
    v : ndarray, shape (m, 3)
        Velocity E, N, h, m/s.
    a : ndarray, shape (m, 3)
        Specific force E, N, h, m/s^2.
    b : ndarray, shape (m, 3, 3)
        Body axes forward, up, right to E, N, h.
    """

    lat_rad: Array
    lat_rate: Array
    lon_rate: Array
    height_m: Array
    radii_m: Array
    v: Array
    a: Array
    b: Array

    @classmethod
    def of(cls, scenario: Scenario, times_s: Array) -> Motion:
        """Evaluate the analytic track of a scenario."""
        if scenario.analytic is None:
            raise TypeError(f"{scenario.name} has no analytic track")
        start = scenario.start
        place = np.array([np.radians(start.lat_deg), np.radians(start.lon_deg), start.height_m])
        found = evaluate(scenario.analytic, place, times_s)
        roll, pitch, heading = found.rpy.T
        sp, cp, st, ct, sg, cg = (f(x) for x in (heading, pitch, roll) for f in (np.sin, np.cos))
        b = np.array(
            [
                [sp * ct, cp * sg - sp * cg * st, cp * cg + sp * sg * st],
                [cp * ct, -sp * sg - cp * cg * st, -sp * cg + cp * sg * st],
                [st, cg * ct, -sg * ct],
            ]
        )
        enu = np.array([1, 0, 2]), np.array([1.0, 1.0, -1.0])
        return cls(
            lat_rad=found.lla[:, 0],
            lat_rate=found.lla_rate[:, 0],
            lon_rate=found.lla_rate[:, 1],
            height_m=found.lla[:, 2],
            radii_m=found.radii_m + found.lla[:, 2:3],
            v=found.v_n[:, enu[0]] * enu[1],
            a=found.f_n[:, enu[0]] * enu[1],
            b=np.moveaxis(b, 2, 0),
        )

    @property
    def ground(self) -> Array:
        """Factors from dR_E, dR_N, dh to metres on the ground, shape (m, 3)."""
        east = self.radii_m[:, 1] * np.cos(self.lat_rad) / R0_M
        return np.column_stack([east, self.radii_m[:, 0] / R0_M, np.ones_like(east)])


def _right(m: Motion) -> Entries:
    """Entries of the navigation part, rows and columns from 1."""
    (ve, vn, vh), (ae, an, ah) = m.v.T, m.a.T
    rn, re = m.radii_m.T
    s, c, t = np.sin(m.lat_rad), np.cos(m.lat_rad), np.tan(m.lat_rad)
    u, lon, lat = EARTH_RATE_RAD_S, m.lon_rate, m.lat_rate
    uq, g = 2.0 * u + lon, _gravity(m)
    we, wn, wh = -lat, (u + lon) * c, (u + lon) * s
    one = np.ones_like(s)
    return {
        (1, 2): lon * t,
        (1, 3): -lon * R0_M / re,
        (1, 4): R0_M / (re * c),
        (2, 3): -lat * R0_M / rn,
        (2, 5): R0_M / rn,
        (3, 6): one,
        (4, 2): (uq * (vn * c + vh * s) + lon * t * (vn * s - vh * c)) / R0_M,
        (4, 3): ve / re**2 * (vh - vn * t),
        (4, 4): (vn * s - vh * c) / (re * c),
        (4, 5): uq * s,
        (4, 6): -uq * c,
        (4, 8): -ah,
        (4, 9): an,
        (5, 2): -(uq * ve * c + ve**2 * t**2 / re) / R0_M,
        (5, 3): ve**2 * t / re**2 + vn * vh / rn**2,
        (5, 4): -2.0 * (u + lon) * s,
        (5, 5): -vh / rn,
        (5, 6): -lat,
        (5, 7): ah,
        (5, 9): -ae,
        (6, 2): -(2.0 * u * ve * s + _gravity_slope(m)) / R0_M,
        (6, 3): 2.0 * g / _A_M - (ve**2 / re**2 + vn**2 / rn**2),
        (6, 4): 2.0 * (u + lon) * c,
        (6, 5): 2.0 * lat,
        (6, 7): -an,
        (6, 8): ae,
        (7, 3): vn / rn**2,
        (7, 5): -1.0 / rn,
        (7, 8): wh,
        (7, 9): -wn,
        (8, 2): -u * s / R0_M,
        (8, 3): -ve / re**2,
        (8, 4): 1.0 / re,
        (8, 7): -wh,
        (8, 9): we,
        (9, 2): (u * c + lon / c) / R0_M,
        (9, 3): -ve * t / re**2,
        (9, 4): t / re,
        (9, 7): wn,
        (9, 8): -we,
    }


def _gravity(m: Motion) -> Array:
    return np.asarray(_core.gravity_n(np.ascontiguousarray(m.lat_rad), m.height_m.copy(), "wgs84")[:, 2])


def _gravity_slope(m: Motion) -> Array:
    """Change of gravity with latitude, m/s^2 per rad."""
    return _G_E * np.sin(2.0 * m.lat_rad) * (5.0 * _Q - _E2) / 2.0


def _printed(m: Motion) -> dict[str, Entries]:
    """Entries as they are printed, by the number of the erratum."""
    right, (ve, vn, _), (rn, re) = _right(m), m.v.T, m.radii_m.T
    s, c, t = np.sin(m.lat_rad), np.cos(m.lat_rad), np.tan(m.lat_rad)
    u, lon, zero = EARTH_RATE_RAD_S, m.lon_rate, np.zeros_like(s)
    uq = 2.0 * u + lon
    return {
        "21": {(1, 2): lon * t / R0_M},
        "22": {(2, 3): -right[2, 3]},
        "23": {(4, 3): right[4, 3] * re},
        "24": {(5, 2): -uq * ve * c / R0_M - ve**2 * t**2 / re},
        "25": {(5, 4): -uq * s, (6, 4): uq * c},
        "26": {(6, 2): -2.0 * u * ve * s / re + 1.5 * _gravity(m) * _E2 * s * c / R0_M},
        "27": {(6, 3): -_gravity(m) / _A_M - (ve**2 / re**2 + vn**2 / rn**2)},
        "28a": {(9, 4): zero, (9, 7): zero, (9, 8): zero},
        "28b": {(9, 2): u * c + lon / c / R0_M},
    }


def system_matrix(m: Motion, errata: Collection[str] = ()) -> Array:
    """System matrices (m, 22, 22), right or with some of the misprints of :data:`ERRATA`."""
    entries = _right(m)
    for name, wrong in _printed(m).items():
        if name in errata:
            entries |= wrong
    f = np.zeros((m.lat_rad.size, STATES, STATES))
    for (row, column), value in entries.items():
        f[:, row - 1, column - 1] = value
    f[:, 6:9, 9:12] = -m.b
    f[:, 3:6, 12:15] = m.b
    for i in range(6):
        f[:, 16 + i, 16 + i] = -_slow_rate(m)[:, i]
    return f


def _slow_rate(m: Motion) -> Array:
    """Rates of the slow errors of the receiver, 1/s, shape (m, 6)."""
    position = _RATE_M * np.hypot(m.v[:, 0], m.v[:, 1]) + _RATE_S
    return np.column_stack([position, position, position, *([np.full_like(position, _RATE_V)] * 3)])


def transition(m: Motion, dt_s: float, errata: Collection[str] = ()) -> tuple[Array, Array]:
    """Transition matrices and process noise (m, 22, 22) of steps around the times of the motion, to third order.

    The slow errors are stepped exactly: W = exp(-rate dt), q^2 = 1 - W^2. Noise enters with sqrt(dt).
    """
    f = system_matrix(m, errata)
    eye, square = np.eye(STATES), f @ f
    phi = eye + dt_s * f + dt_s**2 / 2.0 * square + dt_s**3 / 6.0 * (square @ f)
    g = np.zeros((m.lat_rad.size, STATES, 13))
    g[:, 6:9, 0:3] = -_WHITE["gyro"] * m.b
    g[:, 3:6, 3:6] = _WHITE["accel"] * m.b
    g[:, 9:12, 6:9] = _WALK["gyro"] * np.eye(3)
    g[:, 12:15, 9:12] = _WALK["accel"] * np.eye(3)
    g[:, 15, 12] = _BARO_WALK
    root = np.sqrt(dt_s) * (eye + dt_s / 2.0 * f + dt_s**2 / 6.0 * square) @ g
    q = root @ np.swapaxes(root, 1, 2)
    keep = np.exp(-_slow_rate(m) * dt_s)
    sd = _stretched(m, _SLOW)
    for i in range(6):
        phi[:, 16 + i, 16 + i] = keep[:, i]
        q[:, 16 + i, 16 + i] = (1.0 - keep[:, i] ** 2) * sd[:, i] ** 2
    return phi, q


def _stretched(m: Motion, sd: Array) -> Array:
    """Figures in metres on the ground as reduced ones, shape (m, 6)."""
    return np.column_stack([sd[:3] / m.ground, np.tile(sd[3:], (m.lat_rad.size, 1))])


def jump_covariance(m: Motion) -> Array:
    """What a change of the constellation adds to the covariance of the state, shape (m, 22, 22)."""
    q = np.zeros((m.lat_rad.size, STATES, STATES))
    at = np.arange(16, STATES)
    q[:, at, at] = _stretched(m, _SLOW_JUMP) ** 2
    return q


def observation(m: Motion, changed: NDArray[np.bool_]) -> tuple[Array, Array]:
    """All eight observations: H (8, 22) and the noise input Q (m, 8, 7), with R = Q Q'.

    Row 1 is the INS height less the barometer, rows 2 to 7 are INS less GNSS, row 8 is the barometer less the GNSS
    height; row 8 = row 4 - row 1 in both.

    Parameters
    ----------
    m : Motion
        At the epochs of the fixes.
    changed : ndarray of bool, shape (m,)
        Epochs with a new constellation.
    """
    h = np.zeros((8, STATES))
    h[0, [2, 15]] = 1.0, -1.0
    for i in range(6):
        h[1 + i, [i, 16 + i]] = 1.0, -1.0
    h[7] = h[3] - h[0]
    sd = np.hypot(_stretched(m, _NOISE), np.where(changed[:, None], _stretched(m, _NOISE_JUMP), 0.0))
    noise = np.zeros((m.lat_rad.size, 8, 7))
    noise[:, 0, 0] = -_BARO_NOISE_M
    for i in range(6):
        noise[:, 1 + i, 1 + i] = -sd[:, i]
    noise[:, 7] = noise[:, 3] - noise[:, 0]
    return h, noise


def initial_covariance(m: Motion) -> Array:
    """Covariance (22, 22) at the start: 10 m, 0.3 m/s, 1 mrad, and the figures of the sensors."""
    place = 10.0 / m.ground[0]
    slow = _stretched(m, _SLOW)[0]
    sd = [*place, *[0.3] * 3, *[1e-3] * 3, *[_BIAS["gyro"]] * 3, *[_BIAS["accel"]] * 3, _BARO_M, *slow]
    return np.diag(np.square(sd))
