"""Runs from Python: a log in one call, rows one by one, Monte Carlo, attitude alone."""

from __future__ import annotations

import json
import subprocess
import tempfile
import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

import gnssins
from engine import Case
from gnssins.ahrs.disturbed import Disturbed
from gnssins.ahrs.estimate import Sensors
from gnssins.sim import scenario_from_dict
from gnssins.simfiles import scenario_config
from report import ABSENT, Measured, Report, timed

#: The flight that is timed: 18 states, 100 Hz, fixes of position and velocity at 1 Hz.
FLIGHT = "fomichev-tan-2017"
HOUR_S = 3600.0
RATE_HZ = 100.0
TIMES = 5
#: Rows of the streaming measurements.
ROWS = 100_000
#: Runs of a Monte Carlo set, per thread: whole chunks, which the threads share out.
SET = {"full": 4, "shared": 12}
#: Length of what pyins gets: it is interpreted, and its time grows with the length.
OTHERS_S = 20


def flight(duration_s: float) -> gnssins.Simulated:
    """Simulate the flight with another length."""
    file = resources.files("gnssins") / "scenarios" / f"{FLIGHT}.toml"
    tables = tomllib.loads(file.read_text(encoding="utf-8"))
    tables["scenario"] |= {"duration_s": duration_s, "rate_hz": RATE_HZ}
    return gnssins.Simulator(scenario_from_dict(tables)).run(seed=1)


def show_runs(report: Report, hour: gnssins.Simulated, times: Mapping[Case, Measured]) -> Measured:
    """One hour from arrays; return its time."""
    report.section(
        "One hour of data from Python",
        f"`gnssins.run` over {len(hour.dataset.imu)} rows from NumPy arrays, 18 states, covariance at every row, "
        f"{len(hour.dataset.gnss)} fixes of position and velocity, estimates handed out at 1 Hz. The filter alone is "
        "the compiled stream fed from Rust, measured by Criterion per row.",
    )
    config = scenario_config(hour) | {"run": {"output_rate_hz": 1.0}}
    whole = timed(lambda: gnssins.run(config, hour), TIMES)
    rows = [["`gnssins.run`", whole.s()]]
    row = times.get(("row", "engine", 18))
    if row is not None:
        filter_s = row * (HOUR_S * RATE_HZ)
        ratio = f"{whole.median / filter_s.median:.2f}"
        rows += [["the filter alone", filter_s.s()], ["`gnssins.run` over the filter alone", ratio]]
    report.table(["", "s"], rows)
    return whole


def show_streaming(report: Report, hour: gnssins.Simulated) -> None:
    """Calls of the navigator, without fixes."""
    report.section(
        "Row by row from Python",
        f"Nanoseconds per row over {ROWS} rows, 18 states. The step itself is the same rows in one call of `imu_many`.",
    )
    imu = hour.dataset.imu
    times, gyro, accel = (np.ascontiguousarray(a[:ROWS]) for a in (imu.t_ns, imu.gyro, imu.accel))
    arrays = list(zip(times.tolist(), gyro, accel, strict=True))
    floats = [(t, *w, *f) for t, w, f in zip(times.tolist(), gyro.tolist(), accel.tolist(), strict=True)]
    config = scenario_config(hour)

    def per_row(name: str, feed: Any) -> Measured | None:
        if not hasattr(gnssins.Navigator, name):
            return None

        def work() -> None:
            feed(getattr(gnssins.Navigator(config, hour.initial), name))

        return timed(work, TIMES) / ROWS

    def one_by_one(rows: list[Any]) -> Any:
        def feed(call: Any) -> None:
            for row in rows:
                call(*row)

        return feed

    many = per_row("imu_many", lambda call: call(times, gyro, accel))
    rows = [["`imu_many(t, gyro, accel)`", _ns(many), ""]]
    for text, name, data in (
        ("`imu(t, gyro, accel)`, arrays", "imu", arrays),
        ("`imu_xyz(t, wx, wy, wz, fx, fy, fz)`, floats", "imu_xyz", floats),
    ):
        each = per_row(name, one_by_one(data))
        over = ABSENT if many is None or each is None else (each - many).ns()
        rows.append([text, _ns(each), over])
    report.table(["call", "ns per row", "over the step itself"], rows)


def _ns(value: Measured | None) -> str:
    return ABSENT if value is None else value.ns()


def show_monte_carlo(report: Report) -> None:
    """Run-steps per second of both modes on one and two threads."""
    report.section(
        "Monte Carlo",
        f"`gnssins.monte_carlo` over `{FLIGHT}`: sensors simulated, filtered and compared, 18 states, 300 000 steps "
        "per run. Millions of run-steps per second.",
    )
    if not hasattr(gnssins, "monte_carlo"):
        report.lines += ["This version has none.", ""]
        return
    simulator = gnssins.Simulator(FLIGHT)
    rows = []
    for covariance, runs in SET.items():
        speeds = []
        for jobs in (1, 2):
            found = [
                gnssins.monte_carlo(simulator, runs=jobs * runs, jobs=jobs, covariance=covariance)
                for _ in range(3)
            ]
            speeds.append(Measured.of([m.run_steps / m.wall_s for m in found]))
        one, two = speeds
        cells = [f"{1e-6 * m.median:.2f} ± {1e-6 * m.spread:.2f}" for m in speeds]
        rows.append([covariance, *cells, f"{two.median / one.median:.2f}"])
    report.table(["covariance", "one thread", "two threads", "ratio"], rows)


def show_others(report: Report, python: Path, hour: gnssins.Simulated, whole: Measured) -> None:
    """Beside pyins and VQF, which run in an environment of their own on the same data."""
    recording = Disturbed().simulate(seed=1)
    data = hour.dataset
    rows, fixes = round(OTHERS_S * RATE_HZ), OTHERS_S
    start = hour.initial
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "data.npz"
        np.savez(
            file,
            imu_s=1e-9 * data.imu.t_ns[:rows],
            gyro=data.imu.gyro[:rows],
            accel=data.imu.accel[:rows],
            fix_s=1e-9 * data.gnss.t_ns[:fixes],
            lla=data.gnss.lla[:fixes],
            v_n=data.gnss.v_n[:fixes],
            start=np.concatenate([np.asarray(start.lla), np.asarray(start.v_n), np.asarray(start.q_nb)]),
            start_s=1e-9 * start.t_ns,
            ahrs_rate_hz=recording.scenario.rate_hz,
            ahrs_gyro=recording.gyro,
            ahrs_accel=recording.accel,
            ahrs_mag=recording.mag,
        )
        script = Path(__file__).with_name("others.py")
        done = subprocess.run([str(python), str(script), str(file)], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{script} failed:\n{done.stderr}")
    found = json.loads(done.stdout)
    _check_end(found["pyins"], data.truth, rows)
    _show_pyins(report, found["pyins"], whole / (HOUR_S * RATE_HZ))
    _show_vqf(report, found["vqf"], recording)


def _check_end(found: Mapping[str, Any], truth: Any, rows: int) -> None:
    """What is timed must navigate: within 10 m in height and 1e-6 rad of the truth at its end."""
    at = np.searchsorted(truth.t_ns, round(rows / RATE_HZ * 1e9))
    off = np.abs(np.asarray(found["end_lla"]) - truth.lla[at])
    if not np.all(off < [2e-6, 2e-6, 10.0]):
        raise SystemExit(f"pyins ended {off} (rad, rad, m) away from the truth: the comparison is void")


def _show_pyins(report: Report, found: Mapping[str, Any], ours: Measured) -> None:
    theirs = Measured.of(found["times_s"]) / (OTHERS_S * RATE_HZ)
    report.section(
        "Beside pyins",
        f"`run_feedback_filter` of pyins (`python-ins` {found['version']}, numba {found['numba']}) over the first "
        f"{OTHERS_S} s of the same data with its default `time_step` of 0.1 s, so that its covariance goes at a tenth "
        f"of the rate of ours; {found['states']} states against our 18. Ours is the whole call of `gnssins.run` above.",
    )
    ratio = report.against("run from Python, per row", ours, "pyins", theirs)
    report.table(
        ["", "ns per row"], [["gnssins", ours.ns()], ["pyins", theirs.ns()], ["times faster", ratio]]
    )


def _show_vqf(report: Report, found: Mapping[str, Any], recording: Any) -> None:
    sensors = Sensors(recording.t_ns, recording.gyro, recording.accel, recording.mag, "mean-rates")
    count = len(recording.t_ns)
    ours = timed(lambda: gnssins.ahrs.run(sensors), TIMES) / count
    theirs = Measured.of(found["times_s"]) / count
    report.section(
        "Attitude beside VQF",
        f"`gnssins.ahrs.run` and `VQF.updateBatch` (VQF {found['version']}, C++) over {count} rows of gyro, "
        "accelerometer and magnetometer. They do different work for it: VQF carries no covariance.",
    )
    ratio = report.against("attitude from recorded sensors, per row", ours, "VQF", theirs)
    report.table(["", "ns per row"], [["gnssins", ours.ns()], ["VQF", theirs.ns()], ["times faster", ratio]])
