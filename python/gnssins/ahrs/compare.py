"""The attitude filter beside the published laws and beside other people's filters, in one scenario.

All gains are fixed: the published ones, and those that each package ships. The filter's own defaults were chosen on
recordings and on a forerunner of :mod:`gnssins.ahrs.disturbed` with another generator of random numbers, so no run
here was seen before. VQF (package ``vqf``; Laidig and Seel 2023, Information Fusion 91, p. 187), Mahony et al. (2008)
and Madgwick (2010; package ``ahrs``) take part where they are installed; the last two are interpreted sample by
sample and are therefore run on the first ``slow_runs`` runs only. They and the published laws get the true attitude
or the first reading to start from; nothing of the first minute is scored.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gnssins import _core
from gnssins.ahrs.disturbed import PHASES, Disturbed, Recording
from gnssins.ahrs.estimate import Sensors, run
from gnssins.ahrs.laws import Cross, Law, Positional
from gnssins.analysis import text
from gnssins.errors import ConfigError
from gnssins.parallel import ordered

__all__ = ["METHODS", "TARGETS_DEG", "Comparison", "Row", "comparison", "installed"]

Array = NDArray[np.float64]

#: Quaternion that takes east-north-up to north-east-down.
_NED_OF_ENU: Final = np.array([0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0])

#: Largest RMS of the total attitude error (deg) that the filter is held to, by phase and length of manoeuvre (s).
TARGETS_DEG: Final[Mapping[tuple[str, float], float]] = MappingProxyType(
    {
        ("clean", 3.0): 0.2,
        ("clean", 8.0): 0.2,
        ("magnetic", 3.0): 1.1,
        ("magnetic", 8.0): 2.8,
        ("acceleration", 3.0): 4.2,
        ("acceleration", 8.0): 5.0,
        ("both", 3.0): 3.2,
        ("both", 8.0): 5.5,
        ("all", 3.0): 3.2,
        ("all", 8.0): 5.5,
    }
)


def _filter(recording: Recording) -> Array:
    return run(_sensors(recording)).q_nb


def _law(law: Law) -> Callable[[Recording], Array]:
    return lambda recording: run(_sensors(recording), law).q_nb


def _sensors(recording: Recording) -> Sensors:
    return Sensors(recording.t_ns, recording.gyro, recording.accel, recording.mag, "mean-rates")


def _from_enu(q: Array) -> Array:
    return _core.quat_mul(np.broadcast_to(_NED_OF_ENU, q.shape).copy(), np.ascontiguousarray(q))


def _vqf(recording: Recording) -> Array:
    vqf = importlib.import_module("vqf").VQF(1.0 / recording.scenario.rate_hz)
    sensors = (np.ascontiguousarray(a) for a in (recording.gyro, recording.accel, recording.mag))
    return _from_enu(vqf.updateBatch(*sensors)["quat9D"])


def _mahony(recording: Recording) -> Array:
    # the package corrects towards east-north-up, with the axes of the body as they are
    start = _core.quat_mul(_NED_OF_ENU[np.newaxis] * [1.0, -1.0, -1.0, -1.0], recording.q_nb[:1])[0]
    sensors = (recording.gyro, recording.accel, recording.mag)
    filters = importlib.import_module("ahrs.filters")
    return _from_enu(filters.Mahony(*sensors, frequency=recording.scenario.rate_hz, q0=start).Q)


def _madgwick(recording: Recording) -> Array:
    # the package levels on z up: forward-left-up and north-west-up, a half turn about the first axis from ours
    up = np.array([1.0, -1.0, -1.0])
    half_turn = np.array([1.0, 1.0, -1.0, -1.0])
    sensors = (recording.gyro * up, recording.accel * up, recording.mag * up)
    filters = importlib.import_module("ahrs.filters")
    estimate = filters.Madgwick(
        *sensors, frequency=recording.scenario.rate_hz, q0=recording.q_nb[0] * half_turn
    )
    return np.asarray(estimate.Q * half_turn)


@dataclass(frozen=True)
class _Method:
    estimate: Callable[[Recording], Array]
    package: str | None = None
    slow: bool = False


#: Everything that can be compared: a name, how it estimates, what it needs.
METHODS: Final[Mapping[str, _Method]] = MappingProxyType(
    {
        "filter": _Method(_filter),
        "VQF": _Method(_vqf, "vqf"),
        "Madgwick": _Method(_madgwick, "ahrs", slow=True),
        "Mahony": _Method(_mahony, "ahrs", slow=True),
        "positional 10 Hz": _Method(_law(Positional(k=20.0 * math.pi))),
        "cross 42.8 / 13.3": _Method(_law(Cross(k=42.8, n=13.3))),
    }
)


def installed(method: str) -> bool:
    """Whether the package that a method needs is there."""
    package = METHODS[method].package
    return package is None or importlib.util.find_spec(package) is not None


@dataclass(frozen=True)
class Row:
    """One method at one length of manoeuvre.

    Parameters
    ----------
    method : str
        Name in :data:`METHODS`.
    manoeuvre_s : float
        Length of a manoeuvre.
    runs : int
        Runs behind the figures.
    rms_deg : mapping of str to float
        RMS of the total attitude error over the runs, by phase and over ``all``.
    worst_deg : mapping of str to float
        The largest RMS of a single run.
    """

    method: str
    manoeuvre_s: float
    runs: int
    rms_deg: Mapping[str, float]
    worst_deg: Mapping[str, float]

    def reaches(self, phase: str) -> bool | None:
        """Whether the target of a phase is met; ``None`` where there is none."""
        target = TARGETS_DEG.get((phase, self.manoeuvre_s))
        return None if target is None else self.rms_deg[phase] <= target


@dataclass(frozen=True)
class Comparison:
    """Outcome of :func:`comparison`.

    Parameters
    ----------
    seed : int
        Seed of the runs.
    rows : tuple of Row
        By length of manoeuvre, then by method.
    absent : tuple of str
        Methods left out because their package is not installed.
    """

    seed: int
    rows: tuple[Row, ...]
    absent: tuple[str, ...]

    def row(self, method: str, manoeuvre_s: float) -> Row:
        """Figures of a method at a length of manoeuvre."""
        for row in self.rows:
            if (row.method, row.manoeuvre_s) == (method, manoeuvre_s):
                return row
        raise ConfigError(
            "config.choice",
            f"no row of {method} at manoeuvres of {manoeuvre_s} s",
            f"there are: {', '.join(f'{r.method} at {r.manoeuvre_s:g} s' for r in self.rows)}",
        )

    def columns(self) -> list[str]:
        """Titles of :meth:`cells`."""
        return ["method", "manoeuvre s", "runs", *PHASES, "all"]

    def cells(self) -> list[list[str]]:
        """Rows of the table as text, the targets after the methods of each length; errors in degrees."""
        found: list[list[str]] = []
        for length in dict.fromkeys(row.manoeuvre_s for row in self.rows):
            for row in self.rows:
                if row.manoeuvre_s == length:
                    errors = [text.number(row.rms_deg[p], 3) for p in (*PHASES, "all")]
                    found.append([row.method, f"{length:g}", str(row.runs), *errors])
            targets = [TARGETS_DEG.get((p, length), math.nan) for p in (*PHASES, "all")]
            if not all(map(math.isnan, targets)):
                found.append(
                    ["target of the filter", f"{length:g}", "", *(text.number(x, 2) for x in targets)]
                )
        return found

    def table(self) -> str:
        """RMS of the total attitude error (deg) of every method in every phase."""
        note = f"not installed: {', '.join(self.absent)}" if self.absent else ""
        return text.table(
            f"Total attitude error, deg RMS, seed {self.seed}", self.columns(), self.cells(), note
        )

    def to_dict(self) -> dict[str, Any]:
        """All figures."""
        return {
            "seed": self.seed,
            "absent": list(self.absent),
            "targets_deg": [
                {"phase": phase, "manoeuvre_s": length, "target": value}
                for (phase, length), value in TARGETS_DEG.items()
            ],
            "rows": [
                {
                    "method": row.method,
                    "manoeuvre_s": row.manoeuvre_s,
                    "runs": row.runs,
                    "rms_deg": dict(row.rms_deg),
                    "worst_deg": dict(row.worst_deg),
                }
                for row in self.rows
            ],
        }


def comparison(
    runs: int = 10,
    seed: int = 1,
    jobs: int = 1,
    *,
    methods: Sequence[str] | None = None,
    manoeuvres_s: Sequence[float] = (3.0, 8.0),
    slow_runs: int = 1,
    progress: Callable[[float], None] | None = None,
) -> Comparison:
    """Run the methods over the scenario of :mod:`gnssins.ahrs.disturbed`.

    Parameters
    ----------
    runs : int
        Runs of each length of manoeuvre.
    seed : int
        Seed; the same gives the same figures whatever ``jobs`` is.
    jobs : int
        Threads.
    methods : sequence of str, optional
        Names in :data:`METHODS`; left out: all that are installed.
    manoeuvres_s : sequence of float
        Lengths of manoeuvres.
    slow_runs : int
        Runs of the methods that are interpreted sample by sample, about 3 s each.
    progress : callable, optional
        Called with the share done, from 0 to 1.

    Returns
    -------
    Comparison

    Raises
    ------
    ConfigError
        An unknown method, or one whose package is not installed; fewer than one run or thread.
    """
    if min(runs, jobs, slow_runs) < 1:
        raise ConfigError(
            "config.range", f"runs, jobs, slow_runs = {runs}, {jobs}, {slow_runs}", "give at least 1 of each"
        )
    names = tuple(methods) if methods is not None else tuple(filter(installed, METHODS))
    for name in names:
        if name not in METHODS:
            raise ConfigError(
                "config.choice", f'method "{name}" is not known', f"one of: {', '.join(METHODS)}"
            )
        if not installed(name):
            package = METHODS[name].package
            raise ConfigError(
                "config.choice", f"{name} needs the package {package}", f"pip install {package}"
            )
    work = [(length, number) for length in manoeuvres_s for number in range(runs)]

    def one(index: int) -> dict[str, dict[str, float]]:
        length, number = work[index]
        recording = Disturbed(manoeuvre_s=length).simulate(seed, number)
        return {
            name: _squares(recording, METHODS[name].estimate(recording))
            for name in names
            if number < slow_runs or not METHODS[name].slow
        }

    squares: dict[tuple[str, float], list[dict[str, float]]] = {}
    for (length, _), found in zip(work, ordered(one, len(work), jobs, progress), strict=True):
        for name, values in found.items():
            squares.setdefault((name, length), []).append(values)
    rows = [
        _row(name, length, squares[name, length])
        for length in manoeuvres_s
        for name in names
        if (name, length) in squares
    ]
    absent = tuple(name for name in METHODS if methods is None and not installed(name))
    return Comparison(seed, tuple(rows), absent)


def _squares(recording: Recording, q_nb: Array) -> dict[str, float]:
    """Mean squared error by phase, deg²."""
    error = np.degrees(recording.error_rad(q_nb))
    return {phase: float(np.mean(error[recording.rows(phase)] ** 2)) for phase in (*PHASES, "all")}


def _row(method: str, manoeuvre_s: float, squares: list[dict[str, float]]) -> Row:
    phases = (*PHASES, "all")
    rms = {p: math.sqrt(sum(s[p] for s in squares) / len(squares)) for p in phases}
    worst = {p: math.sqrt(max(s[p] for s in squares)) for p in phases}
    return Row(method, manoeuvre_s, len(squares), rms, worst)
