"""The demonstration: a published 3000 s UAV flight, simulated, filtered, and held against the publication's figures.

Fomichev and Tan (2017): 18 states, IMU at 100 Hz, GNSS at 1 Hz, once with GNSS throughout and once with three gaps.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from gnssins.analysis import (
    NavErrors,
    Nees,
    Nis,
    OutageTable,
    Parameters,
    compare,
    nees,
    nis,
    outage_table,
    text,
)
from gnssins.config import Config
from gnssins.runner import run
from gnssins.sim import Simulator
from gnssins.simfiles import scenario_config

if TYPE_CHECKING:
    from gnssins.result import Result
    from gnssins.sim import Simulated

__all__ = ["SCENARIO", "TARGETS", "DemoReport", "Flight", "fly", "run_demo"]

Array = NDArray[np.float64]

SCENARIO: Final = "fomichev-tan-2017"

#: Start of the steady state, s: the errors of the start and of the biases have settled.
AFTER_S: Final = 600.0

#: What 100 runs together must reach for t > 600 s, root mean square per axis.
TARGETS: Final = {
    "position, m": 0.205,
    "velocity, m/s": 0.0066,
    "level, arcmin": 0.042,
    "heading, arcmin": 0.37,
}

CLAIMS: Final = (
    "north about 5 m, east and down a little less",
    "north about 5 m, east and down a little less",
    "(no figure given)",
)

_AXES: Final = ("north", "east", "down")


@dataclass(frozen=True, eq=False)
class Flight:
    """One of the two runs and what the truth says about it."""

    result: Result
    errors: NavErrors
    nees: Nees
    nis: Nis


@dataclass(frozen=True, eq=False)
class DemoReport:
    """Everything that the demonstration shows.

    Parameters
    ----------
    seed : int
        Seed of the simulation.
    whole, gaps : Flight
        With GNSS throughout, and with the three gaps.
    outages : OutageTable
        Errors in the gaps against the truth.
    simulated_s, wall_s : float
        Time for the simulation and for everything.
    folder : Path
        Where results and pictures are.
    files : tuple of str
        Pictures.
    """

    seed: int
    whole: Flight
    gaps: Flight
    outages: OutageTable
    simulated_s: float
    wall_s: float
    folder: Path
    files: tuple[str, ...]

    def accuracy(self) -> list[tuple[str, str, float, float, float]]:
        """Rows of quantity, axis, error (rms), the filter's own sd (rms), target; run with GNSS throughout."""
        steady = self.whole.errors.between(AFTER_S)
        rmse, sd = steady.rmse(), np.sqrt(np.mean(steady.sd**2, axis=0))
        arcmin = 60.0 * np.degrees(1.0)
        units = list(TARGETS)
        rows = [(units[0], a, rmse.position[i], sd[i]) for i, a in enumerate(_AXES)]
        rows += [(units[1], a, rmse.velocity[i], sd[3 + i]) for i, a in enumerate(_AXES)]
        rows += [
            (units[2], a, arcmin * rmse.euler[i], arcmin * sd[6 + i]) for i, a in enumerate(("roll", "pitch"))
        ]
        rows.append((units[3], "", arcmin * rmse.euler[2], arcmin * sd[8]))
        return [(q, a, float(e), float(s), TARGETS[q]) for q, a, e, s in rows]

    def returns(self) -> list[tuple[Array, Array]]:
        """Correction by the first fix after each gap (m, N E D), and the rms error from 60 s to 100 s after it."""
        errors, out = self.gaps.errors, []
        for gap in self.outages.outages:
            before = np.searchsorted(errors.time_s, gap.end_s) - 1
            after = min(int(np.searchsorted(errors.time_s, gap.end_s + 0.5)), len(errors) - 1)
            jump = errors.position[after] - errors.position[before]
            calm = errors.between(gap.end_s + 60.0, gap.end_s + 100.0)
            out.append((jump, np.sqrt(np.mean(calm.position**2, axis=0))))
        return out

    def text(self) -> str:
        """Write the report for a terminal."""
        parts = [
            f"UAV flight of Fomichev and Tan (2017), simulated with seed {self.seed}: 3000 s at 30 m/s, IMU 100 Hz, "
            f"GNSS 1 Hz, filter with {len(self.whole.result.states)} states",
            self._accuracy_table(),
            self._gap_table(),
            self._consistency(),
            self._rows(),
            self._places(),
        ]
        return "\n\n".join(parts)

    def _accuracy_table(self) -> str:
        rows = [
            [f"{q.split(',')[0]} {a}".strip(), q.split(", ")[1], *map(text.number, (error, sd, target))]
            for q, a, error, sd, target in self.accuracy()
        ]
        return text.table(
            f"1. Accuracy with GNSS throughout: root mean square for t > {AFTER_S:.0f} s",
            ["", "unit", "error", "filter's own sd", "target of 100 runs"],
            rows,
            "One run scatters by some per cent: the slow sensor errors are drawn once.",
            left=(0, 1),
        )

    def _gap_table(self) -> str:
        rows = []
        for gap, (jump, calm), claim in zip(self.outages.outages, self.returns(), CLAIMS, strict=True):
            for i, axis in enumerate(_AXES):
                rows.append(
                    [
                        f"{gap.start_s:.0f} to {gap.end_s:.0f} s" if i == 0 else "",
                        axis,
                        f"{gap.end_position[i]:+.2f}",
                        f"{gap.end_sd[i]:.2f}",
                        f"{gap.end_sigmas[i]:+.2f}",
                        f"{jump[i]:+.2f}",
                        f"{calm[i]:.2f}",
                        claim if i == 0 else "",
                    ]
                )
        head = [
            "gap",
            "axis",
            "error m",
            "sigma m",
            "error/sigma",
            "step at return m",
            "a minute later m",
            "published",
        ]
        return text.table(
            "2. Position at the end of each gap, before the first fix",
            head,
            rows,
            "Published, from one run with errors of +1 sigma: north about +-5 m in the first two gaps, east and up a "
            "little smaller,\nno jumps, full accuracy when GNSS returns. Random errors scatter as sigma says.",
            left=(0, 1, 7),
        )

    def _consistency(self) -> str:
        lines = [
            "3. Does the filter know its own errors? One run each: only many runs can prove it (see gnssins montecarlo)"
        ]
        for name, flight in (("GNSS throughout", self.whole), ("three gaps", self.gaps)):
            steady = flight.nees.after(AFTER_S)
            nine, all_states = steady["navigation"], steady["all"]
            low, high = nine.bounds
            wide_low, wide_high = all_states.bounds
            joint = flight.nis["gnss, 6 components"]
            fix_low, fix_high = joint.bounds
            lines += [
                f"  {name}",
                f"    NEES  9 states  {nine.mean:6.2f}, expected  9, {100 * nine.share_inside:3.0f} % of epochs "
                f"inside {low:.2f} .. {high:.2f} (95 %)",
                f"    NEES {all_states.dof} states  {all_states.mean:6.2f}, expected {all_states.dof}, "
                f"{100 * all_states.share_inside:3.0f} % of epochs inside {wide_low:.2f} .. {wide_high:.2f} (95 %)",
                f"    NIS  6 per fix  {joint.mean:6.2f}, expected  6, {joint.count} fixes, "
                f"95 % bounds {fix_low:.2f} .. {fix_high:.2f}: {joint.verdict}",
            ]
        return "\n".join(lines)

    def _rows(self) -> str:
        lines = ["4. Every row accounted for"]
        for name, flight in (("GNSS throughout", self.whole), ("three gaps", self.gaps)):
            for table in ("imu", "gnss"):
                counts = dict(flight.result.counts[table])
                total, held = counts.pop("in"), counts.pop("withheld", 0)
                parts = " + ".join(f"{count} {what}" for what, count in counts.items())
                tail = f", {held} withheld" if held else ""
                lines.append(f"  {name:<16} {table.upper():<4} {total:>6} in = {parts}{tail}")
        return "\n".join(lines)

    def _places(self) -> str:
        filtered = [f.result.metadata["run"]["filter_s"] for f in (self.whole, self.gaps)]
        return (
            f"5. Time: {self.wall_s:.1f} s in all (simulation {self.simulated_s:.1f} s, "
            f"filter {filtered[0]:.2f} s and {filtered[1]:.2f} s for 300 000 IMU rows each, the rest is pictures)\n"
            f"   Pictures and results: {self.folder}/whole, {self.folder}/gaps "
            f"(look at {self.folder}/gaps/position_errors.png first)"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers, units in the names."""
        names = ("quantity", "axis", "rms", "sd", "target")
        return {
            "scenario": SCENARIO,
            "seed": self.seed,
            "accuracy": [dict(zip(names, row, strict=True)) for row in self.accuracy()],
            "outages": self.outages.to_dict(),
            "after_return": [{"step_m": j.tolist(), "rms_m": c.tolist()} for j, c in self.returns()],
            "nees": {
                n: f.nees.after(AFTER_S).to_dict() for n, f in (("whole", self.whole), ("gaps", self.gaps))
            },
            "nis": {n: f.nis.to_dict() for n, f in (("whole", self.whole), ("gaps", self.gaps))},
            "counts": {"whole": self.whole.result.counts, "gaps": self.gaps.result.counts},
            "wall_s": self.wall_s,
            "folder": str(self.folder),
            "files": list(self.files),
        }


def fly(simulated: Simulated, outages: tuple[tuple[float, float], ...] = ()) -> Flight:
    """Filter the simulated flight with some of its fixes withheld, and compare it with the truth."""
    config = Config.from_dict(scenario_config(simulated))
    config = config.replace(run={"output_rate_hz": 10.0, "covariance_interval_s": 1.0, "outages": outages})
    result, truth = run(config, simulated), simulated.dataset.truth
    if truth is None:
        raise TypeError("the simulated flight has no truth")
    found = nees(result, truth, Parameters.of(simulated), probability=0.95)
    return Flight(result, compare(result, truth), found, nis(result))


def run_demo(folder: Path, seed: int = 2017) -> DemoReport:
    """Simulate, filter twice, compare, draw.

    Parameters
    ----------
    folder : Path
        Gets the folders ``whole`` and ``gaps`` with results and pictures.
    seed : int
        Of the simulation.

    Returns
    -------
    DemoReport
    """
    clock = time.perf_counter()
    simulator = Simulator(SCENARIO)
    simulated = simulator.run(seed)
    simulated_s = time.perf_counter() - clock
    windows = Simulator(simulator.scenario, variant="gaps").outages
    whole, gaps = fly(simulated), fly(simulated, windows)
    if simulated.dataset.truth is None:
        raise TypeError("the simulated flight has no truth")
    outages = outage_table(gaps.result, simulated.dataset.truth)
    files: list[str] = []
    for name, flight in (("whole", whole), ("gaps", gaps)):
        flight.result.save(folder / name)
        files += _pictures(flight, simulated, folder / name, everything=name == "gaps")
    wall_s = time.perf_counter() - clock
    return DemoReport(seed, whole, gaps, outages, simulated_s, wall_s, folder, tuple(files))


def _pictures(flight: Flight, simulated: Simulated, folder: Path, *, everything: bool) -> list[str]:
    from gnssins import plots

    windows = flight.result.outages()
    made = {
        "position_errors": plots.position_errors(flight.errors, windows),
        "velocity_errors": plots.velocity_errors(flight.errors, windows),
        "attitude_errors": plots.attitude_errors(flight.errors, windows),
    }
    if everything:
        made["track"] = plots.track(flight.result, simulated.dataset.truth)
        made["biases"] = plots.biases(flight.result, Parameters.of(simulated))
        made["innovations"] = plots.innovations(flight.result)
        made["nis"] = plots.nis(flight.result)
    return [str(plots.save(figure, folder / f"{name}.png")) for name, figure in made.items()]
