"""pyins and VQF on data that ``runs.py`` wrote; prints times as JSON. Runs in an environment of its own."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from typing import Any

import numpy as np
import pandas as pd
from pyins import filters, inertial_sensor, measurements, strapdown
from scipy.spatial.transform import Rotation
from vqf import VQF

TIMES = 3


def seconds(work: Callable[[], object]) -> list[float]:
    found = []
    for _ in range(TIMES):
        clock = time.perf_counter()
        work()
        found.append(time.perf_counter() - clock)
    return found


def pyins(data: Any, rows: int) -> Callable[[], Any]:
    """Feedback filter with 15 states over the first rows."""
    place, v_n, q_nb = data["start"][:3], data["start"][3:6], data["start"][6:]
    degrees = np.degrees(place[:2])
    rph = Rotation.from_quat(np.roll(q_nb, -1)).as_euler("xyz", degrees=True)
    names = ["lat", "lon", "alt", "VN", "VE", "VD", "roll", "pitch", "heading"]
    pva = pd.Series([*degrees, place[2], *v_n, *rph], names, name=float(data["start_s"]))
    # its increments are one fewer than the rows: the row at the start is the first once more
    times = np.concatenate([[data["start_s"]], data["imu_s"][:rows]])
    values = np.hstack([data["gyro"][:rows], data["accel"][:rows]])
    columns = ["gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"]
    imu = pd.DataFrame(np.vstack([values[:1], values]), pd.Index(times), columns)
    increments = strapdown.compute_increments_from_imu(imu, "increment")
    lla = np.hstack([np.degrees(data["lla"][:, :2]), data["lla"][:, 2:]])
    used = data["fix_s"] <= times[-1]
    at = pd.Index(data["fix_s"][used])
    aids = [
        measurements.Position(pd.DataFrame(lla[used], at, names[:3]), 1.0),
        measurements.NedVelocity(pd.DataFrame(data["v_n"][used], at, names[3:6]), 0.05),
    ]
    gyro = inertial_sensor.EstimationModel(bias_sd=5e-8, noise=3e-7, bias_walk=1e-10)
    accel = inertial_sensor.EstimationModel(bias_sd=5e-4, noise=1e-4, bias_walk=1e-6)
    return lambda: filters.run_feedback_filter(pva, 1.0, 0.05, 1 / 60, 1 / 60, increments, gyro, accel, aids)


def main() -> None:
    data = np.load(sys.argv[1])
    pyins(data, 200)()  # numba compiles
    end = pyins(data, len(data["imu_s"]))().trajectory.iloc[-1]
    vqf_data = [np.ascontiguousarray(data[name]) for name in ("ahrs_gyro", "ahrs_accel", "ahrs_mag")]
    result = {
        "pyins": {
            "version": version("python-ins"),
            "numba": version("numba"),
            "states": 15,
            "end_lla": [*np.radians(end[["lat", "lon"]]), end["alt"]],
            "times_s": seconds(pyins(data, len(data["imu_s"]))),
        },
        "vqf": {
            "version": version("vqf"),
            "times_s": seconds(lambda: VQF(1.0 / float(data["ahrs_rate_hz"])).updateBatch(*vqf_data)),
        },
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
