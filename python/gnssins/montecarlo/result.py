"""What a Monte Carlo says: sums of its chunks, and the figures made of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import text
from gnssins.analysis.consistency import Nees, NeesGroup, Nis, NisGroup
from gnssins.errors import InputError
from gnssins.montecarlo.plan import Job, Prepared
from gnssins.tables import seconds

__all__ = ["MonteCarlo", "Sums"]

Array = NDArray[np.float64]

_AXES: Final = ("north", "east", "down")
_SOURCES: Final = ("gnss", "baro", "heading")
_COUNTS: Final = ("in", "used", "rejected", "late", "bad")
#: NIS by source and number of components 0 .. 6.
_NIS_SHAPE: Final = (3, 7)


@dataclass(frozen=True, eq=False)
class MonteCarlo:
    """What a set of runs says together.

    Parameters
    ----------
    runs : int
        Number of runs that are counted: the first so many of those asked for.
    asked : int
        Number of runs asked for.
    seed : int
        Seed of the set.
    covariance : {"full", "shared"}
        Whether every run had its own covariance.
    after_s : float
        Root mean squares and NIS count times after this one.
    position, velocity, phi : ndarray, shape (3,)
        Root mean square over runs and epochs along north, east, down: m, m/s, rad.
    run_rms : ndarray, shape (runs, 9)
        The same of each run, in this order, for outliers.
    time_s : ndarray, shape (c,)
        Epochs of the covariance, s.
    error_rms, sigma_rms : ndarray, shape (c, 9)
        Root mean square over the runs of the errors of position, velocity and phi at these epochs, and of the sigmas
        that the filter claimed.
    nees : Nees
        Mean over the runs at these epochs; ``nees.after(after_s)`` for the steady state.
    nis : NisGroup
        The kind of measurement with most values, fixes first.
    nis_by_source : Nis
        All kinds of measurement: ``"gnss, n components"``, ``"baro"``, ``"heading"``.
    gaps_s : tuple of (from, to)
        Gaps whose ends were looked at, s.
    gap_rms, gap_sigma, gap_ratio : ndarray, shape (gaps, 9)
        Root mean square over the runs at the ends of the gaps, before the first fix: errors, sigmas that the filter
        claimed, errors over sigmas (1 is honest). Position N, E, D (m), velocity N, E, D (m/s), roll, pitch, heading
        (rad); NaN where no run has an epoch.
    counts : mapping
        Sums of the GNSS counts.
    aid_counts : mapping
        Those of the other aids, by source.
    imu_rows : int
        IMU rows of one run.
    wall_s : float
        Time that the runs took, that of runs taken over from a store not counted.
    computed : int
        Runs computed in that time.
    """

    runs: int
    asked: int
    seed: int
    covariance: str
    after_s: float
    position: Array
    velocity: Array
    phi: Array
    run_rms: Array
    time_s: Array
    error_rms: Array
    sigma_rms: Array
    nees: Nees
    nis: NisGroup
    nis_by_source: Nis
    gaps_s: tuple[tuple[float, float], ...]
    gap_rms: Array
    gap_sigma: Array
    gap_ratio: Array
    counts: Mapping[str, int]
    aid_counts: Mapping[str, Mapping[str, int]]
    imu_rows: int
    wall_s: float
    computed: int

    @property
    def complete(self) -> bool:
        """Whether all runs are counted; an interrupt leaves the first of them."""
        return self.runs == self.asked

    @property
    def rms(self) -> Array:
        """``position``, ``velocity`` and ``phi`` as rows, shape (3, 3)."""
        return np.stack([self.position, self.velocity, self.phi])

    @property
    def run_position(self) -> Array:
        """Root mean square position error of each run, m, shape (runs, 3)."""
        return self.run_rms[:, :3]

    @property
    def run_steps(self) -> int:
        """IMU rows of all runs that were computed."""
        return self.computed * self.imu_rows

    @property
    def steps_per_s(self) -> float:
        """Run-steps per second of wall time; NaN if nothing was computed."""
        return self.run_steps / self.wall_s if self.computed else float("nan")

    def table(self) -> str:
        """All figures as text."""
        rows = [
            ["position, m", *map(text.number, self.position)],
            ["velocity, m/s", *map(text.number, self.velocity)],
            ["attitude about the axis, arcmin", *(text.number(60.0 * v) for v in np.degrees(self.phi))],
        ]
        share = "" if self.complete else f" of {self.asked}, interrupted"
        common = ", one covariance for all" if self.covariance == "shared" else ""
        title = (
            f"Root mean square of {self.runs} runs{share}, t > {self.after_s:g} s (seed {self.seed}{common})"
        )
        parts = [text.table(title, ["", *_AXES], rows)]
        parts.append(self.nees.after(self.after_s).table())
        if self.nis_by_source.groups:
            parts.append(self.nis_by_source.table("NIS of all runs, before the gate"))
        if self.gaps_s:
            parts.append(self._gap_table())
        return "\n\n".join(parts)

    def _gap_table(self) -> str:
        head = ["end of gap, s", *(f"{a}, m" for a in _AXES), *(f"over sigma {a}" for a in _AXES)]
        rows = [
            [f"{gap[1]:g}", *map(text.number, rms[:3]), *(f"{v:.2f}" for v in ratio[:3])]
            for gap, rms, ratio in zip(self.gaps_s, self.gap_rms, self.gap_ratio, strict=True)
        ]
        return text.table("Position error at the ends of the gaps, rms over the runs", head, rows)

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, units in the names; the same for any number of jobs."""
        return {
            "runs": self.runs,
            "complete": self.complete,
            "seed": self.seed,
            "covariance": self.covariance,
            "after_s": self.after_s,
            "position_m": self.position.tolist(),
            "velocity_m_s": self.velocity.tolist(),
            "phi_arcmin": (60.0 * np.degrees(self.phi)).tolist(),
            "nees": self.nees.after(self.after_s).to_dict(),
            "nis": self.nis_by_source.to_dict(),
            "gaps_s": [list(gap) for gap in self.gaps_s],
            "gap_end_rms": self.gap_rms.tolist(),
            "gap_end_over_sigma": self.gap_ratio.tolist(),
            "counts": dict(self.counts),
            "aid_counts": {name: dict(counts) for name, counts in self.aid_counts.items()},
        }


class Sums:
    """Sums over the chunks so far, added in their order: those of ``runs`` runs."""

    def __init__(self) -> None:
        self.values: dict[str, NDArray[Any]] = {}
        self.runs = 0
        self._rows: list[Array] = []

    def add(self, chunk: Mapping[str, Any]) -> None:
        """Add the sums of a chunk, as the core gives them."""
        rows = np.asarray(chunk["runs"])
        self._rows.append(rows)
        self.runs += len(rows)
        for name, value in chunk.items():
            if name != "runs":
                self.values[name] = self.values[name] + value if name in self.values else np.array(value)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Give everything as arrays by name."""
        return {**self.values, "runs": np.concatenate([np.zeros((0, 9)), *self._rows])}

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Sums:
        """Take back what :meth:`to_arrays` gave."""
        sums = cls()
        sums.values = {name: value for name, value in arrays.items() if name != "runs"}
        sums._rows = [arrays["runs"]]
        sums.runs = len(arrays["runs"])
        return sums

    def result(self, job: Job, prepared: Prepared, asked: int, wall_s: float, computed: int) -> MonteCarlo:
        """Make the figures."""
        values, runs = self.to_arrays(), self.runs
        squares, count = values["runs"], int(values["count"])
        if not count:
            raise InputError(
                "input.no_epoch",
                f"no epoch of comparison after after_s = {job.after_s:g} s",
                "lower after_s, or raise [run] output_rate_hz",
            )
        with np.errstate(invalid="ignore", divide="ignore"):
            rms = np.sqrt(squares.sum(axis=0) / count)
            gaps = [np.sqrt(values[f"gap_{key}"] / values["gap_runs"][:, None]) for key in _GAP_KEYS]
        by_source = _nis(values)
        counts = values["counts"].reshape(4, 5)
        named = [dict(zip(_COUNTS, map(int, row), strict=True)) for row in counts]
        return MonteCarlo(
            runs=runs,
            asked=asked,
            seed=job.seed,
            covariance=job.covariance,
            after_s=job.after_s,
            position=rms[:3],
            velocity=rms[3:6],
            phi=rms[6:],
            run_rms=np.sqrt(squares / (count / runs)),
            time_s=seconds(prepared.nees_t_ns),
            error_rms=np.sqrt(values["squares"] / runs),
            sigma_rms=np.sqrt(values["variances"] / runs),
            nees=_nees(values, prepared, runs),
            nis=_main(by_source),
            nis_by_source=by_source,
            gaps_s=prepared.gaps_s,
            gap_rms=gaps[0],
            gap_sigma=gaps[1],
            gap_ratio=gaps[2],
            counts=named[1],
            aid_counts={
                name: own for name, own in zip(_SOURCES[1:], named[2:], strict=True) if own["in"] > 0
            },
            imu_rows=prepared.rows,
            wall_s=wall_s,
            computed=computed,
        )


_GAP_KEYS: Final = ("squares", "variances", "ratios")


def _nees(values: Mapping[str, NDArray[Any]], prepared: Prepared, runs: int) -> Nees:
    means = values["nees"].reshape(-1, len(prepared.groups)) / runs
    return Nees(
        {
            group.name: NeesGroup(
                group.name, len(group.index), prepared.nees_t_ns, np.ascontiguousarray(means[:, k]), runs
            )
            for k, group in enumerate(prepared.groups)
        }
    )


def _nis(values: Mapping[str, NDArray[Any]]) -> Nis:
    sums, counts = values["nis_sum"].reshape(_NIS_SHAPE), values["nis_count"].reshape(_NIS_SHAPE)
    groups = {}
    for source, dof in zip(*np.nonzero(counts), strict=True):
        name = _SOURCES[source] if source else f"gnss, {dof} components"
        count = int(counts[source, dof])
        groups[name] = NisGroup(name, int(dof), count, float(sums[source, dof] / count))
    return Nis(groups)


def _main(every: Nis) -> NisGroup:
    """Pick the kind of measurement that tells most: fixes before the other aids, then the one with most values."""
    none = NisGroup("none", 1, 0, float("nan"))
    return max(every.groups.values(), key=lambda g: (g.name.startswith("gnss"), g.count), default=none)
