"""What the reproduction of Aleshkin et al. (2021) runs: the compiled laws with the published gains."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.ahrs import Cross, Integral, Levelling, Positional, Quaternion, Sensors, run
from gnssins.ahrs.laws import Law, RowLaw
from gnssins.analysis import run_seed
from gnssins.analysis.ahrs import (
    Angle,
    Reading,
    StepResponse,
    simulated_corner,
    simulated_noise,
    simulated_response,
    simulated_step,
)
from gnssins.reproduce.job import Job
from gnssins.units import DEG_TO_RAD, NS_PER_S, STANDARD_GRAVITY_M_S2

__all__ = [
    "BODE_HZ",
    "CHEBYSHEV",
    "CROSS",
    "FAST_SETTLED_S",
    "FAST_START_DEG",
    "POSITIONAL",
    "SCHULER_RATE",
    "TUNINGS",
    "Experiment",
    "Noise",
    "Path",
    "experiment",
]

Array = NDArray[np.float64]

#: The publication's gains: "third-order Butterworth, 10 Hz"; the same without cross-coupling; "Chebyshev, 1 dB, 10 Hz".
CROSS: Final = Cross(42.8, 13.3)
POSITIONAL: Final = Positional(42.8)
CHEBYSHEV: Final = Integral(1.1 * 20.0 * math.pi, 1.1 * (20.0 * math.pi) ** 2)
TUNINGS: Final[Mapping[str, RowLaw]] = {"X": CROSS, "P": POSITIONAL, "PI": CHEBYSHEV}

#: Schuler frequency for g = 9.80665 m/s² and R = 6371 km, rad/s.
RADIUS_M: Final = 6.371e6
SCHULER_RATE: Final = math.sqrt(STANDARD_GRAVITY_M_S2 / RADIUS_M)

#: Interval at which corners and steps are taken from the running laws, s.
FINE_S: Final = 2e-4

#: Interval and noise of the published noise claim, s and deg/s; samples of one run.
NOISE_S: Final = 0.01
NOISE_DEG_S: Final = 0.1
NOISE_SAMPLES: Final = 100_000

#: Frequencies at which the Bode figure shows the running law, Hz.
BODE_HZ: Final = (0.5, 1.0, 2.0, 4.0, 7.0, 10.0, 15.0, 25.0, 40.0)


@dataclass(frozen=True)
class Path:
    """A path of the table of tunings: law by its letter, from a reading to an angle."""

    law: str
    angle: Angle
    reading: Reading

    @property
    def text(self) -> str:
        """In words."""
        if self.reading == "gyro":
            return f"{self.law}: gyro -> {self.angle}"
        return f"{self.law}: {'magnetometer' if self.angle == 'heading' else 'accelerometer'} -> {self.angle}"


PATHS: Final = (
    Path("X", "pitch", "measured"),
    Path("X", "heading", "measured"),
    Path("X", "roll", "measured"),
    Path("X", "pitch", "gyro"),
    Path("X", "roll", "gyro"),
    Path("P", "pitch", "measured"),
    Path("P", "pitch", "gyro"),
    Path("PI", "pitch", "measured"),
    Path("PI", "pitch", "gyro"),
)

#: Paths whose corner has a DC response to be measured from; drawn in the Bode figure with points.
LOW_PASS: Final = tuple(p for p in PATHS if not (p.law == "PI" and p.reading == "gyro"))

STEPS: Final[tuple[tuple[str, Angle], ...]] = (("P", "pitch"), ("X", "pitch"), ("X", "roll"), ("PI", "pitch"))

#: Acceleration of 2 m/s² for 10 s against laws placed at the Schuler frequency.
SCHULER: Final[Mapping[str, Levelling]] = {
    "k = 0, k_int = g/R": Levelling(0.0, SCHULER_RATE**2),
    "k = 0.05 w_s, k_int = g/R": Levelling(0.05 * SCHULER_RATE, SCHULER_RATE**2),
    "k = 1.1 w_s, k_int = 1.1 g/R": Levelling(1.1 * SCHULER_RATE, 1.1 * SCHULER_RATE**2),
    "positional, k = w_s": Levelling(SCHULER_RATE),
}

#: Body rate of the fast turn (rad/s): 100 rad/s about an oblique axis, and the laws that follow it.
FAST_RATE: Final = np.array([60.0, -56.0, 57.0])

#: Error of its start about another oblique axis (deg), and when it must be gone (s).
FAST_START_DEG: Final = 30.0
FAST_SETTLED_S: Final = 1.0
FAST: Final[Mapping[str, tuple[Law, str | None]]] = {
    "P": (POSITIONAL, None),
    "X": (CROSS, None),
    "X, elements": (CROSS, "elements"),
    "PI": (CHEBYSHEV, None),
    "quaternion": (Quaternion(42.8, 13.3), None),
    "Euler": (Levelling(42.8, k_heading=42.8), None),
}


@dataclass(frozen=True, eq=False)
class Noise:
    """Variances of the angles under gyro noise of 0.1 deg/s at 100 Hz, over all runs.

    Parameters
    ----------
    variance : mapping of str to ndarray, shape (runs, 3)
        Roll, pitch, heading (deg²) of every run, by law.
    stepped : ndarray, shape (runs, 3)
        The cross-coupled law stepped by explicit Euler, as a reader of the publication would.
    """

    variance: Mapping[str, Array]
    stepped: Array


@dataclass(frozen=True, eq=False)
class Experiment:
    """Everything that was run.

    Parameters
    ----------
    corners : mapping of Path to float
        -3 dB frequencies of the running laws, Hz.
    points : mapping of Path to ndarray of complex, shape (len(BODE_HZ),)
        Responses of the running laws.
    steps : mapping of (law, angle) to StepResponse
        Of the running laws.
    schuler : mapping of str to float
        Tilt (deg) after an acceleration of 2 m/s² for 10 s.
    drift_deg : float
        Tilt (deg) that 1 deg/h of gyro drift costs a positional law at the Schuler frequency.
    fast : mapping of str to float
        Largest attitude error (deg) at 100 rad/s and 100 Hz, after a wrong start.
    noise : Noise
    """

    corners: Mapping[Path, float]
    points: Mapping[Path, NDArray[np.complex128]]
    steps: Mapping[tuple[str, Angle], StepResponse]
    schuler: Mapping[str, float]
    drift_deg: float
    fast: Mapping[str, float]
    noise: Noise


def experiment(job: Job) -> Experiment:
    """Run everything on the job's threads."""
    corners = job.map(lambda i: _corner(LOW_PASS[i]), len(LOW_PASS), "corners")
    points = job.map(lambda i: _points(LOW_PASS[i]), len(LOW_PASS), "responses")
    steps = job.map(
        lambda i: simulated_step(TUNINGS[STEPS[i][0]], STEPS[i][1], FINE_S, 0.25), len(STEPS), "steps"
    )
    schuler = job.map(lambda i: accelerated(list(SCHULER.values())[i]), len(SCHULER), "Schuler")
    fast = job.map(lambda i: turned_fast(*list(FAST.values())[i]), len(FAST), "fast turn")
    names = list(TUNINGS)
    runs = job.map(lambda i: _noise(run_seed(job.seed, i)), job.runs, "noise", units=3 * job.runs)
    return Experiment(
        corners=dict(zip(LOW_PASS, corners, strict=True)),
        points=dict(zip(LOW_PASS, points, strict=True)),
        steps=dict(zip(STEPS, steps, strict=True)),
        schuler=dict(zip(SCHULER, schuler, strict=True)),
        drift_deg=drifted(),
        fast=dict(zip(FAST, fast, strict=True)),
        noise=Noise(
            {name: np.array([one[0][k] for one in runs]) for k, name in enumerate(names)},
            np.array([one[1] for one in runs]),
        ),
    )


#: Work units of :func:`experiment` besides three per run.
UNITS: Final = 2 * len(LOW_PASS) + len(STEPS) + len(SCHULER) + len(FAST)


def _corner(path: Path) -> float:
    return simulated_corner(TUNINGS[path.law], path.angle, path.reading, FINE_S)


def _points(path: Path) -> NDArray[np.complex128]:
    law = TUNINGS[path.law]
    return np.array([simulated_response(law, path.angle, path.reading, f, 1e-3) for f in BODE_HZ])


def _noise(seed: int) -> tuple[list[Array], Array]:
    """Variances (deg²) of one run: every law, then the stepped one."""
    sd = NOISE_DEG_S * DEG_TO_RAD
    laws = [
        simulated_noise(law, sd, "gyro", NOISE_S, NOISE_SAMPLES, seed) / DEG_TO_RAD**2
        for law in TUNINGS.values()
    ]
    return laws, stepped_noise(seed)


def stepped_noise(seed: int) -> Array:
    """Variances (deg²) of roll, pitch, heading of the cross-coupled law stepped by explicit Euler, small angles.

    e+ = (I - K T) e + T dW c on the rows up and east of C; not how the compiled law runs.
    """
    rng = np.random.default_rng(seed)
    rates = rng.normal(0.0, NOISE_DEG_S, (NOISE_SAMPLES, 3)) * NOISE_S
    step = np.eye(3) - CROSS.matrix() * NOISE_S
    values, vectors = np.linalg.eig(step)
    modal = np.linalg.inv(vectors)
    # roll (1), pitch (3) and course (2) move c21 = pitch and c23 = -roll; c31 = heading and c32 = roll
    up = np.column_stack([rates[:, 1], np.zeros(len(rates)), -rates[:, 0]])
    east = np.column_stack([rates[:, 2], rates[:, 0], np.zeros(len(rates))])
    out = []
    for drive, element in ((up, 2), (up, 0), (east, 0)):
        state = np.zeros(len(drive), dtype=complex)
        for k in range(3):
            state += vectors[element, k] * _first_order(values[k], drive @ modal[k])
        out.append(state.real[1000:].var())
    return np.array(out)


def _first_order(pole: complex, drive: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """x[k] = pole x[k-1] + drive[k]."""
    from scipy.signal import lfilter

    return np.asarray(lfilter([1.0], [1.0, -pole], drive))


def accelerated(law: Levelling) -> float:
    """Tilt (deg) that a level vehicle shows after 2 m/s² to the north for 10 s, the vertical turning with V/R."""
    dt_s = 0.01
    t = np.arange(1001) * dt_s
    rate = -2.0 * np.maximum(t - 0.5 * dt_s, 0.0) / RADIUS_M  # about east, mean of every interval
    gyro = np.column_stack([np.zeros_like(t), rate, np.zeros_like(t)])
    accel = np.tile([2.0, 0.0, -STANDARD_GRAVITY_M_S2], (t.size, 1))
    sensors = Sensors(np.rint(t * NS_PER_S).astype(np.int64), gyro, accel, kind="mean-rates")
    result = run(sensors, law, initial_q_nb=(1.0, 0.0, 0.0, 0.0))
    return _tilt_deg(result.q_nb[-1:])


def drifted() -> float:
    """Tilt (deg) that 1 deg/h of drift costs a positional law at the Schuler frequency, after five hours."""
    t_ns = np.arange(18_001, dtype=np.int64) * NS_PER_S
    gyro = np.tile([0.0, DEG_TO_RAD / 3600.0, 0.0], (t_ns.size, 1))
    accel = np.tile([0.0, 0.0, -STANDARD_GRAVITY_M_S2], (t_ns.size, 1))
    sensors = Sensors(t_ns, gyro, accel, kind="mean-rates")
    return _tilt_deg(run(sensors, Levelling(SCHULER_RATE), initial_q_nb=(1.0, 0.0, 0.0, 0.0)).q_nb[-1:])


def _tilt_deg(q_nb: Array) -> float:
    return float(np.degrees(np.linalg.norm(_core.quat_to_rotvec(q_nb)[0, :2])))


def turned_fast(law: Law, form: str | None) -> float:
    """Largest attitude error (deg) in 1 s to 5 s of 100 rad/s at 100 Hz, ideal sensors, started 30 deg off."""
    count, dt_s = 501, 0.01
    t = np.arange(count) * dt_s
    q_nb = _core.rotvec_to_quat(FAST_RATE * t[:, None])
    c_nb = _core.quat_to_dcm(q_nb)
    accel, mag = -STANDARD_GRAVITY_M_S2 * c_nb[:, 2], c_nb[:, 0] + c_nb[:, 2]
    t_ns = np.rint(t * NS_PER_S).astype(np.int64)
    sensors = Sensors(t_ns, np.tile(FAST_RATE, (count, 1)), accel, mag, "mean-rates")
    start = _core.rotvec_to_quat(np.full((1, 3), FAST_START_DEG * DEG_TO_RAD / math.sqrt(3.0)))[0]
    result = run(sensors, law, form="elements" if form == "elements" else None, initial_q_nb=start)
    error = _core.quat_to_rotvec(_core.quat_mul(result.q_nb * [1.0, -1.0, -1.0, -1.0], q_nb))
    return float(np.degrees(np.linalg.norm(error[t >= FAST_SETTLED_S], axis=1).max()))
