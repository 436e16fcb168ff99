"""Scenario by which attitude estimators are compared: clean, magnetic disturbance, acceleration, both at once.

A body (a hand, a vehicle) turns about all axes and is shaken a little the whole time. It is still for the first ten
seconds; the first minute is not scored. Then four phases of equal length follow:

=============  =====================================================================================
clean          turning and shaking only
magnetic       manoeuvres with another field added, half of them fixed to the place, half to the body
acceleration   manoeuvres with several m/s² held, every second one brakes what the one before gained
both           both kinds, each in its own rhythm
=============  =====================================================================================

A manoeuvre lasts ``manoeuvre_s`` (ramps of 0.3 s included); the pauses between are one to two times as long. Half of
the accelerations turn with up to 0.3 rad/s, all have a vertical part of up to 30 %, so that some leave the length of
the specific force as it is; the directions of the added field are even over the sphere, so that some leave
strength and dip as they are. Sensor errors are those of a calibrated consumer MEMS at 100 Hz.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.errors import ConfigError
from gnssins.sim.streams import Streams
from gnssins.units import NS_PER_S, STANDARD_GRAVITY_M_S2

__all__ = ["PHASES", "Disturbed", "Recording"]

Array = NDArray[np.float64]

#: Names of the phases in their order.
PHASES: Final = ("clean", "magnetic", "acceleration", "both")

_STILL_S: Final = 10.0
_RAMP_S: Final = 0.3


@dataclass(frozen=True)
class Disturbed:
    """The scenario as data. Standard deviations are of values drawn once per run, uniform ranges per manoeuvre.

    Parameters
    ----------
    manoeuvre_s : float
        Length of a manoeuvre, above 1 s.
    rate_hz : float
        Sampling rate.
    settle_s, phase_s : float
        Time before the first phase, of which 10 s at rest, and length of each phase.
    attitude_deg : tuple of three floats
        RMS of roll, pitch, heading; four sines each between 0.05 and 0.4 Hz (heading 0.02 and 0.3 Hz).
    shake_m_s2 : float
        RMS of the small acceleration per axis, 0.5 to 3 Hz.
    accel_m_s2, field_ut : tuple of two floats
        Least and greatest acceleration and added field of a manoeuvre.
    earth_field_ut, dip_deg : float
        Field of the place; its horizontal part points north.
    gyro_noise_deg_s_sqrt_hz, gyro_bias_deg_s, gyro_walk_deg_s_sqrt_s : float
        Noise density, bias, random walk of the bias.
    gyro_scale, gyro_misalignment_rad : float
        Scale factor, and rotation of the gyro axes.
    accel_noise_ug_sqrt_hz, accel_bias_mg, accel_scale : float
        Noise density, bias, scale factor.
    mag_noise_ut, mag_bias_ut, mag_scale : float
        Noise of a sample, remaining hard iron, scale factor.
    """

    manoeuvre_s: float = 3.0
    rate_hz: float = 100.0
    settle_s: float = 60.0
    phase_s: float = 90.0
    attitude_deg: tuple[float, float, float] = (30.0, 20.0, 60.0)
    shake_m_s2: float = 0.15
    accel_m_s2: tuple[float, float] = (1.5, 4.0)
    field_ut: tuple[float, float] = (8.0, 30.0)
    earth_field_ut: float = 50.0
    dip_deg: float = 66.0
    gyro_noise_deg_s_sqrt_hz: float = 0.01
    gyro_bias_deg_s: float = 0.3
    gyro_walk_deg_s_sqrt_s: float = 0.001
    gyro_scale: float = 0.002
    gyro_misalignment_rad: float = 0.001
    accel_noise_ug_sqrt_hz: float = 200.0
    accel_bias_mg: float = 1.0
    accel_scale: float = 0.001
    mag_noise_ut: float = 0.2
    mag_bias_ut: float = 0.03
    mag_scale: float = 0.001

    def __post_init__(self) -> None:
        if not (1.0 < self.manoeuvre_s < 0.5 * self.phase_s):
            raise ConfigError(
                "config.range",
                f"manoeuvre_s = {self.manoeuvre_s}: above 1 s and below half a phase ({self.phase_s} s)",
                "a phase has to hold a manoeuvre and its pause",
            )

    @property
    def duration_s(self) -> float:
        """Length of a run."""
        return self.settle_s + len(PHASES) * self.phase_s

    def window(self, phase: str) -> tuple[float, float]:
        """Begin and end of a phase (s)."""
        start = self.settle_s + PHASES.index(phase) * self.phase_s
        return start, start + self.phase_s

    def simulate(self, seed: int, run: int = 0) -> Recording:
        """One run: the same numbers for the same seed and run.

        Parameters
        ----------
        seed : int
            Not negative.
        run : int
            Number of the run.

        Returns
        -------
        Recording
        """
        streams = Streams(seed)
        dt = 1.0 / self.rate_hz
        t: Array = dt * np.arange(round(self.duration_s * self.rate_hz) + 1, dtype=np.float64)
        q_nb, rate = self._attitude(streams(f"{run}.attitude"), t)
        accel = self._acceleration(streams(f"{run}.acceleration"), t[1:])
        field_n, field_b = self._field(streams(f"{run}.field"), t[1:])
        c_nb = _core.quat_to_dcm(q_nb)
        force = _to_body(c_nb, accel - [0.0, 0.0, STANDARD_GRAVITY_M_S2])
        field = _to_body(c_nb, field_n) + field_b
        gyro, bias = self._gyro(streams(f"{run}.gyro"), rate, dt)
        return Recording(
            self,
            np.round(t[1:] * NS_PER_S).astype(np.int64),
            gyro,
            self._accelerometer(streams(f"{run}.accelerometer"), force),
            self._magnetometer(streams(f"{run}.magnetometer"), field),
            q_nb,
            bias,
        )

    def _attitude(self, rng: np.random.Generator, t: Array) -> tuple[Array, Array]:
        """Attitude at the samples after the first, and mean rate over the interval before each."""
        begin = _step((t - _STILL_S) / 5.0)
        bands = ((0.05, 0.4), (0.05, 0.4), (0.02, 0.3))
        angles = [
            np.radians(rms) * _sines(rng, t, band, 4)
            for rms, band in zip(self.attitude_deg, bands, strict=True)
        ]
        start = [0.0, 0.0, rng.uniform(-np.pi, np.pi)]
        euler = np.stack([s + begin * a for s, a in zip(start, angles, strict=True)], axis=1)
        q = _core.euler_to_quat(euler)
        back = q[:-1] * [1.0, -1.0, -1.0, -1.0]
        turn = _core.quat_to_rotvec(_core.quat_mul(back, q[1:]))
        return q[1:], turn * self.rate_hz

    def _acceleration(self, rng: np.random.Generator, t: Array) -> Array:
        shake = np.stack([_sines(rng, t, (0.5, 3.0), 6) for _ in range(3)], axis=1)
        accel = self.shake_m_s2 * _step((t - _STILL_S) / 5.0)[:, np.newaxis] * shake
        for phase in ("acceleration", "both"):
            size, azimuth = 0.0, 0.0
            for number, start in enumerate(self._starts(rng, phase)):
                if number % 2 == 0:
                    size, azimuth = rng.uniform(*self.accel_m_s2), rng.uniform(-np.pi, np.pi)
                else:
                    azimuth += np.pi
                turn = rng.uniform(-0.3, 0.3) * (rng.random() < 0.5)
                angle = azimuth + turn * (t - start)
                direction = np.stack(
                    [np.cos(angle), np.sin(angle), np.full(t.size, rng.uniform(-0.3, 0.3))], axis=1
                )
                accel += size * self._pulse(t, start)[:, np.newaxis] * direction
        return accel

    def _field(self, rng: np.random.Generator, t: Array) -> tuple[Array, Array]:
        """Field in navigation axes, and the part that turns with the body."""
        dip = np.radians(self.dip_deg)
        place = np.tile(self.earth_field_ut * np.array([np.cos(dip), 0.0, np.sin(dip)]), (t.size, 1))
        body = np.zeros((t.size, 3))
        for phase in ("magnetic", "both"):
            for start in self._starts(rng, phase):
                added = rng.standard_normal(3)
                added *= rng.uniform(*self.field_ut) / np.linalg.norm(added)
                where = place if rng.random() < 0.5 else body
                where += self._pulse(t, start)[:, np.newaxis] * added
        return place, body

    def _starts(self, rng: np.random.Generator, phase: str) -> list[float]:
        begin, end = self.window(phase)
        found = []
        t = begin + rng.uniform(1.0, 3.0)
        while t + self.manoeuvre_s < end - 1.0:
            found.append(t)
            t += self.manoeuvre_s * (1.0 + rng.uniform(1.0, 2.0))
        return found

    def _pulse(self, t: Array, start: float) -> Array:
        return _step((t - start) / _RAMP_S) - _step((t - start - self.manoeuvre_s + _RAMP_S) / _RAMP_S)

    def _gyro(self, rng: np.random.Generator, rate: Array, dt: float) -> tuple[Array, Array]:
        n = rng.standard_normal
        walk = np.radians(self.gyro_walk_deg_s_sqrt_s) * np.sqrt(dt)
        bias = np.radians(self.gyro_bias_deg_s) * n(3) + np.cumsum(walk * n(rate.shape), axis=0)
        noise = np.radians(self.gyro_noise_deg_s_sqrt_hz) / np.sqrt(dt) * n(rate.shape)
        scaled = rate * (1.0 + self.gyro_scale * n(3)) + np.cross(rate, self.gyro_misalignment_rad * n(3))
        return scaled + bias + noise, bias

    def _accelerometer(self, rng: np.random.Generator, force: Array) -> Array:
        n = rng.standard_normal
        g = STANDARD_GRAVITY_M_S2
        noise = 1e-6 * g * self.accel_noise_ug_sqrt_hz * np.sqrt(self.rate_hz) * n(force.shape)
        return np.asarray(
            force * (1.0 + self.accel_scale * n(3)) + 1e-3 * g * self.accel_bias_mg * n(3) + noise
        )

    def _magnetometer(self, rng: np.random.Generator, field: Array) -> Array:
        n = rng.standard_normal
        noise = self.mag_noise_ut * n(field.shape)
        return np.asarray(field * (1.0 + self.mag_scale * n(3)) + self.mag_bias_ut * n(3) + noise)


@dataclass(frozen=True, eq=False)
class Recording:
    """One run: sensors, body forward-right-down, and the truth.

    Parameters
    ----------
    scenario : Disturbed
        Where it comes from.
    t_ns : ndarray of int64, shape (n,)
        Stamps, ns.
    gyro, accel, mag : ndarray, shape (n, 3)
        Mean rate over the interval that ends at the stamp (rad/s); specific force (m/s²) and field (µT) at it.
    q_nb : ndarray, shape (n, 4)
        True attitude, body to north-east-down.
    bias : ndarray, shape (n, 3)
        True gyro bias, rad/s.
    """

    scenario: Disturbed
    t_ns: NDArray[np.int64]
    gyro: Array
    accel: Array
    mag: Array
    q_nb: Array
    bias: Array

    def error_rad(self, q_nb: Array) -> Array:
        """Angle of the rotation between an estimate (shape (n, 4)) and the truth, shape (n,)."""
        # of the smaller part of the quaternion: an arccosine of the larger one ends at 1e-8
        difference = _core.quat_mul(self.q_nb * [1.0, -1.0, -1.0, -1.0], q_nb)
        vector = np.linalg.norm(difference[:, 1:], axis=1)
        return np.asarray(2.0 * np.arctan2(vector, np.abs(difference[:, 0])))

    def rows(self, phase: str) -> NDArray[np.bool_]:
        """Rows of a phase, or of all four for ``"all"``, shape (n,)."""
        t = self.t_ns / NS_PER_S
        start, end = self.scenario.window(phase) if phase != "all" else (self.scenario.settle_s, np.inf)
        return np.asarray((t > start) & (t <= end))


def _to_body(c_nb: Array, v_n: Array) -> Array:
    return np.asarray(np.einsum("nij,ni->nj", c_nb, v_n))


def _step(x: Array) -> Array:
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**3 * (10.0 - 15.0 * x + 6.0 * x * x))


def _sines(rng: np.random.Generator, t: Array, band_hz: tuple[float, float], count: int) -> Array:
    """Sum of sines with RMS one, frequencies even over the logarithm of the band."""
    low, high = band_hz
    frequency = low * (high / low) ** rng.random(count)
    phase, weight = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(0.5, 1.0, count)
    waves = np.sin(2.0 * np.pi * np.outer(frequency, t) + phase[:, np.newaxis])
    return np.asarray(weight @ waves / np.sqrt(np.sum(weight**2) / 2.0))
