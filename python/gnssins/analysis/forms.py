"""What the forms of the strapdown equations cost: attitude forms, and the split into three rates.

Both comparisons fly the error-free increments of a :class:`gnssins.sim.Trajectory`. These lead the one-rate step with
the exact rotation back to the truth within rounding, so whatever is left belongs to the form. Times are those of the
calls within one process and are given as ratios.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.analysis import text
from gnssins.analysis.errors import Track, compare
from gnssins.errors import ConfigError
from gnssins.units import NS_PER_S

if TYPE_CHECKING:
    from gnssins.sim import Trajectory

__all__ = [
    "ATTITUDE_FORMS",
    "AttitudeForm",
    "FormError",
    "FormTable",
    "agile_flight",
    "attitude_forms",
    "three_rates",
]

Array = NDArray[np.float64]

AttitudeForm = Literal["rotation-vector", "euler", "dcm", "quaternion", "picard", "two-quaternions"]

#: All forms, the exact one first.
ATTITUDE_FORMS: Final[tuple[AttitudeForm, ...]] = get_args(AttitudeForm)

#: Divisors of the three-rate split that :func:`three_rates` tries: samples per velocity step, velocity steps per
#: position step.
DIVISORS: Final = ((1, 1), (1, 10), (1, 50), (2, 10), (5, 10), (10, 10))


def agile_flight(duration_s: float = 900.0, rate_hz: float = 100.0) -> Trajectory:
    """Make a flight that tells the forms apart: banks to 77 deg, pitch to 28 deg, body rates to 2.6 rad/s.

    An aircraft of 60 m/s from 55 deg north; turns of 12 deg/s alternate with climbs and descents, and the attitude
    sways about all three axes throughout, so that small rotations about different axes follow each other.
    """
    from gnssins.sim import build_trajectory, scenario_from_dict

    starts = np.arange(10.0, max(duration_s - 30.0, 11.0), 30.0)
    signs = np.where(np.arange(starts.size) % 3 == 1, -1.0, 1.0)
    climbs = np.where(np.arange(starts.size) % 2 == 0, 20.0, -20.0)
    tables = {
        "scenario": {"name": "agile-flight", "duration_s": duration_s, "rate_hz": rate_hz},
        "start": {
            "lat_deg": 55.0,
            "lon_deg": 30.0,
            "height_m": 2000.0,
            "speed_m_s": 60.0,
            "heading_deg": 40.0,
        },
        "motion": {"turn_ramp_s": 2.0, "slope_ramp_s": 8.0},
        "turn": [
            {"start_s": float(s), "length_s": 10.0, "rate_deg_s": float(12.0 * sign)}
            for s, sign in zip(starts, signs, strict=True)
        ],
        "slope": [
            {"from_s": float(s + 14.0), "to_s": float(s + 22.0), "angle_deg": float(angle)}
            for s, angle in zip(starts, climbs, strict=True)
        ],
        "sway": [
            {"axis": "roll", "amplitude_deg": 25.0, "period_s": 1.7},
            {"axis": "pitch", "amplitude_deg": 8.0, "period_s": 2.3},
            {"axis": "heading", "amplitude_deg": 5.0, "period_s": 3.1},
        ],
        "initial_error": {"attitude_sd_deg": 0.0, "velocity_sd_m_s": 0.0, "position_sd_m": 0.0},
    }
    return build_trajectory(scenario_from_dict(tables, source="agile flight"))


@dataclass(frozen=True)
class FormError:
    """Errors of one form at the end of the flight, and its time.

    Parameters
    ----------
    name : str
        Name of the form, or its rates.
    position_m, velocity_m_s, attitude_rad : float
        Length of the error at the last epoch.
    largest_position_m : float
        Largest length of the position error at any compared epoch.
    time_ratio : float
        Time of the call over that of the first form of the table.
    """

    name: str
    position_m: float
    velocity_m_s: float
    attitude_rad: float
    largest_position_m: float
    time_ratio: float


@dataclass(frozen=True)
class FormTable:
    """Forms side by side over one flight of ``duration_s`` at ``rate_hz``."""

    title: str
    duration_s: float
    rate_hz: float
    forms: tuple[FormError, ...]

    def __getitem__(self, name: str) -> FormError:
        return next(form for form in self.forms if form.name == name)

    def table(self) -> str:
        """One line per form."""
        rows = [
            [
                f.name,
                text.number(f.position_m),
                text.number(f.largest_position_m),
                text.number(f.velocity_m_s),
                text.number(f.attitude_rad),
                f"{f.time_ratio:.2f}",
            ]
            for f in self.forms
        ]
        head = ["form", "position m", "largest m", "velocity m/s", "attitude rad", "time"]
        title = f"{self.title}, {self.duration_s:.0f} s at {self.rate_hz:.0f} Hz"
        return text.table(title, head, rows, "Errors at the end; time over that of the first line.")

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers by form."""
        return {
            "title": self.title,
            "duration_s": self.duration_s,
            "rate_hz": self.rate_hz,
            "forms": {
                f.name: {
                    "position_m": f.position_m,
                    "largest_position_m": f.largest_position_m,
                    "velocity_m_s": f.velocity_m_s,
                    "attitude_rad": f.attitude_rad,
                    "time_ratio": f.time_ratio,
                }
                for f in self.forms
            },
        }


def attitude_forms(
    trajectory: Trajectory, forms: Sequence[AttitudeForm] = ATTITUDE_FORMS, *, repeats: int = 1
) -> FormTable:
    """Fly a motion with every form of the attitude equations.

    Parameters
    ----------
    trajectory : Trajectory
        True motion of the NED model with its exact increments: ``gnssins.sim.build_trajectory(scenario)``.
    forms : sequence of str
        Forms to fly; the first one is the measure of time.
    repeats : int
        Calls per form; the fastest counts.

    Returns
    -------
    FormTable

    Raises
    ------
    ConfigError
        A motion of the ECEF model, or an unknown form.
    NavigationError
        A form does not hold on this motion: the Euler form beyond 85 deg of pitch.
    """
    _ned_only(trajectory)
    model = ("ned", trajectory.ellipsoid, trajectory.gravity, trajectory.coning)
    columns, start = _columns(trajectory)

    def flight(form: AttitudeForm) -> Callable[[], tuple[Array, Array, Array]]:
        return lambda: _core.strapdown(*model, *columns, *start, attitude_form=form)

    return _table("Attitude forms", trajectory, {form: flight(form) for form in forms}, 1, repeats)


def three_rates(
    trajectory: Trajectory,
    divisors: Sequence[tuple[int, int]] = DIVISORS,
    *,
    gather: Literal["body", "navigation"] = "body",
    attitude_form: AttitudeForm = "rotation-vector",
    repeats: int = 1,
) -> FormTable:
    """Fly a motion with attitude, velocity and position at three rates.

    The attitude is stepped at every sample; the velocity at every ``divisors[0]``-th, from the sum of the increments in
    between; position, gravity, radii and the rates of the navigation axes at every ``divisors[1]``-th velocity step.
    Errors count at the epochs at which all three are new.

    Parameters
    ----------
    trajectory : Trajectory
        As for :func:`attitude_forms`.
    divisors : sequence of (int, int)
        Splits to try; the first one is the measure of time.
    gather : {"body", "navigation"}
        Velocity increments are summed in body axes and turned once per velocity step, as publications have it, or each
        is turned with the attitude of its own sample.
    attitude_form : str
        Form of the attitude equations.
    repeats : int
        Calls per split; the fastest counts.

    Returns
    -------
    FormTable
        Named by the three rates in Hz, such as ``"100/50/5"``.

    Raises
    ------
    ConfigError
        A motion of the ECEF model, a divisor of 0.
    """
    _ned_only(trajectory)
    columns, start = _columns(trajectory)
    rate = _rate_hz(trajectory)
    model = (trajectory.ellipsoid, trajectory.gravity, trajectory.coning, attitude_form)

    def flight(split: tuple[int, int]) -> Callable[[], tuple[Array, Array, Array]]:
        return lambda: _core.strapdown_three_rate(*model, split, gather, *columns, *start)

    flights = {f"{rate:g}/{rate / max(v, 1):g}/{rate / max(v * p, 1):g}": flight((v, p)) for v, p in divisors}
    title = f"Three rates (attitude/velocity/position, Hz), increments gathered in {gather} axes"
    step = int(np.lcm.reduce([v * p for v, p in divisors]))
    return _table(title, trajectory, flights, step, repeats)


def _ned_only(trajectory: Trajectory) -> None:
    if trajectory.model != "ned":
        raise ConfigError(
            "config.conflict",
            f'the forms belong to the NED model, the motion was made with model = "{trajectory.model}"',
            'set [truth] model = "ned" in the scenario',
        )


def _rate_hz(trajectory: Trajectory) -> float:
    return float(1.0 / np.median(trajectory.dt_s))


def _columns(
    trajectory: Trajectory,
) -> tuple[tuple[NDArray[np.int64], Array, Array], tuple[Array, Array, Array]]:
    columns = (trajectory.t_ns, trajectory.dtheta, trajectory.dvel)
    return columns, (trajectory.lla[0], trajectory.v_n[0], trajectory.q_nb[0])


def _table(
    title: str,
    trajectory: Trajectory,
    flights: dict[str, Callable[[], tuple[Array, Array, Array]]],
    step: int,
    repeats: int,
) -> FormTable:
    rows: list[FormError] = []
    epochs = slice(0, None, max(step, 1))
    truth = Track(
        trajectory.t_ns[epochs], trajectory.lla[epochs], trajectory.v_n[epochs], trajectory.q_nb[epochs]
    )
    reference = 0.0
    for name, flight in flights.items():
        spent = np.inf
        for _ in range(max(repeats, 1)):
            clock = time.perf_counter()
            flown = flight()
            spent = min(spent, time.perf_counter() - clock)
        reference = reference or spent
        track = Track(truth.t_ns, *(column[epochs] for column in flown))
        found = compare(track, truth, ellipsoid=trajectory.ellipsoid)
        distance = np.linalg.norm(found.position, axis=1)
        rows.append(
            FormError(
                name=name,
                position_m=float(distance[-1]),
                velocity_m_s=float(np.linalg.norm(found.velocity[-1])),
                attitude_rad=float(np.linalg.norm(found.phi[-1])),
                largest_position_m=float(distance.max()),
                time_ratio=spent / reference,
            )
        )
    duration = float(truth.t_ns[-1] - truth.t_ns[0]) / NS_PER_S
    return FormTable(title, duration, _rate_hz(trajectory), tuple(rows))
