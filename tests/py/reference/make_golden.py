"""Write the golden numbers: ``python -m reference.make_golden`` in ``tests/py``.

Files in ``tests/golden`` (JSON; floats in the shortest form that reads back to the same bits; null = absent):

``ned18.json``, ``ned21.json``, ``ned40.json``
    One run each: ``config`` (engine configuration), ``imu`` (t_ns, gyro, accel: increments), ``gnss`` (t_ns,
    pos, vel, var), ``states`` (at ``t_ns``: lla, v_n, q_nb, block estimates x), ``sd`` (each second),
    ``cov`` (full, at three times) and ``meas`` (status, dof, nis, innovation, innovation_cov, row by row).
``jacobians.json``
    Twelve points with F, couplings and aiding Jacobians of the NED and the ECEF model.
``discretise.json``
    Phi and Qd by Van Loan, and by series and trapezoid, at points with their blocks.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import attitude as att
from . import earth, errormodel, kalman
from .blocks import blocks_of, sensor_jacobian
from .cases import ARCMIN, CASES, DEG_H, MILLI_G, block, config
from .filter import run
from .strapdown import NavState

Array = NDArray[Any]
GOLDEN = Path(__file__).resolve().parents[2] / "golden"
STATE_STEPS = range(0, 1001, 40)
SD_STEPS = range(0, 1001, 100)
COV_STEPS = (200, 600, 1000)


def plain(value: Any) -> Any:
    """Arrays as lists, NaN as null."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def dump(name: str, content: dict[str, Any]) -> None:
    """One top-level key per line, so that a change shows where it is."""
    rows = [f"{json.dumps(k)}: {json.dumps(plain(v), separators=(',', ':'))}" for k, v in content.items()]
    (GOLDEN / name).write_text("{\n" + ",\n".join(rows) + "\n}\n")


def golden_run(name: str) -> dict[str, Any]:
    """Inputs and outputs of one golden run."""
    cfg, imu, gnss = CASES[name]()
    out = run(cfg, imu, gnss)
    s, c = list(STATE_STEPS), list(COV_STEPS)
    return {
        "about": CASES[name].__doc__,
        "config": cfg,
        "imu": imu,
        "gnss": gnss,
        "states": {key: out[key][s] for key in ("t_ns", "lla", "v_n", "q_nb", "x")},
        "sd": {
            "t_ns": out["t_ns"][list(SD_STEPS)],
            "sd": np.sqrt(np.array([np.diag(out["cov"][k]) for k in SD_STEPS])),
        },
        "cov": {"t_ns": out["t_ns"][c], "cov": out["cov"][c]},
        "meas": {
            key: [m[key] for m in out["meas"]]
            for key in ("status", "dof", "nis", "innovation", "innovation_cov")
        },
    }


# latitude, longitude deg, height m, velocity NED, roll, pitch, heading deg, f_b, w_ib_b, lever
POINTS: list[tuple[Any, ...]] = [
    (30.68, 104.06, 150, (21.2, 21.2, 0), (0, 0, 45), (0, 0, -9.79), (0, 0, 0), (0, 0, 0)),
    (30.66, 104.37, 630, (-12.7, 27.2, -1.6), (6, 3, 115), (0.2, 0, -9.9), (0.01, 0.02, 0.04), (1, 0, -1)),
    (-35, -70, 2500, (-80, 60, 10), (-25, 12, 310), (1, 0.5, -11), (0.3, -0.2, 0.5), (2, -1, 0.5)),
    (5, 0, 9000, (150, -220, -30), (40, -20, 200), (-2, 3, -12), (-0.4, 0.1, 0.2), (-3, 0.4, 1.5)),
    (70, 179.99, 12000, (210, 190, 15), (170, 60, 20), (4, -3, 8), (1, -2, 3), (0.5, 0.5, 0.5)),
    (-79, -180, 20, (-3, -4, 0.5), (5, 89, 170), (9.7, 0.3, -0.2), (0.1, 0.2, -0.3), (1, 0, 0)),
    (80, 90, 0, (0, 300, 0), (0, 90, 0), (9.8, 0, 0), (0, 0.5, 0), (0, 2, 0)),
    (-80, -90, 500, (-200, 220, 40), (30, -90, 60), (-9.8, 1, 1), (2, 0, 0), (0, 0, 3)),
    (0, 45, -50, (0, 0, 0), (0, 0, 0), (0, 0, -9.78), (0, 0, 0), (1, 1, 1)),
    (45, -1, 18000, (-250, -150, 5), (-90, 0, 180), (1, 9.8, 0), (-0.5, 0.5, 1.5), (0.1, -0.2, 0.3)),
    (60, 25, 100, (10, -5, 1), (179, -45, 269), (-5, 2, 7), (3, 3, -3), (-1, -2, -3)),
    (-51.5, 12.3, 3333, (30, 0, -30), (-120, 33, -77), (0.7, -15, 22), (0.05, -1, 0.7), (5, 4, -3)),
]  # fmt: skip


def jacobians() -> dict[str, Any]:
    """F, couplings and H of both models at all points; F is (9, 9) in the axes of the model."""
    out = []
    for lat, lon, h, v, angles, f_b, w_ib_b, lever in POINTS:
        lat, lon, h = np.radians(lat), np.radians(lon), float(h)
        v, f_b, w_ib_b, lever = (np.array(a, float) for a in (v, f_b, w_ib_b, lever))
        q = att.euler_to_quat(*np.radians(angles))
        c_nb, c_en = att.quat_to_dcm(q), earth.c_en(lat, lon)
        gyro, accel = errormodel.couplings(c_nb)
        gyro_e, accel_e = errormodel.couplings(c_en @ c_nb)
        ecef_h = errormodel.aiding_ecef(lat, lon, c_nb, w_ib_b, lever)
        ecef_h["velocity_turn"] = errormodel.velocity_turn(lat, lon, h, v)
        out.append(
            {
                "lla": [lat, lon, h],
                "v_n": v,
                "q_nb": q,
                "f_b": f_b,
                "w_ib_b": w_ib_b,
                "lever_b": lever,
                "ned": {"f": errormodel.ned_f(lat, h, v, c_nb @ f_b), "gyro": gyro, "accel": accel}
                | errormodel.aiding_ned(lat, h, c_nb, w_ib_b, lever),
                "ecef": {
                    "f": errormodel.ecef_f(lat, lon, h, c_en @ c_nb @ f_b),
                    "gyro": gyro_e,
                    "accel": accel_e,
                }
                | ecef_h,
            }
        )
    return {"points": out}


def discretisation(point: int, dt: float, cfg: dict[str, Any]) -> dict[str, Any]:
    """Phi and Qd of the NED model with the blocks of a configuration at one of the points."""
    lat, _, h, v, angles, f_b, w_ib_b, _ = POINTS[point]
    lat, h, v, f_b, w_ib_b = np.radians(lat), float(h), np.array(v, float), np.array(f_b), np.array(w_ib_b)
    q = att.euler_to_quat(*np.radians(angles))
    c = att.quat_to_dcm(q)
    blocks = blocks_of(cfg)
    n = 9 + sum(len(b.initial) for b in blocks)
    f, qc, qd = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    f[:9, :9] = errormodel.ned_f(lat, h, v, c @ f_b)
    gyro, accel = errormodel.couplings(c)
    imu = cfg["imu"]
    qc[:3, :3], qc[3:6, 3:6] = c @ np.diag(imu["gyro_psd"]) @ c.T, c @ np.diag(imu["accel_psd"]) @ c.T
    qd[:9, :9] = qc[:9, :9] * dt
    phi = np.eye(n)
    for b in blocks:
        coupling, value = (gyro, w_ib_b) if b.kind.startswith("gyro_") else (accel, f_b)
        f[:9, b.at] = coupling @ sensor_jacobian(b.kind, value)
        f[b.at, b.at] = np.diag(-1.0 / b.tau)
        density = 2.0 * b.sd**2 / b.tau if b.process == "gauss_markov" else b.psd
        qc[b.at, b.at], qd[b.at, b.at] = np.diag(density), np.diag(b.variance_step(dt))
    out: dict[str, Any] = {
        "dt_s": dt,
        "lla": [lat, 0.0, h],
        "v_n": v,
        "q_nb": q,
        "f_b": f_b,
        "w_ib_b": w_ib_b,
    }
    out |= {"gyro_psd": imu["gyro_psd"], "accel_psd": imu["accel_psd"], "blocks": cfg["blocks"], "f": f}
    for order in (1, 2, 3):
        phi = kalman.transition(f, dt, order)
        for b in blocks:
            phi[b.at, b.at] = np.diag(b.decay(dt))
        out[f"phi_{order}"] = phi
    out["qd_trapezoid"] = kalman.predict(np.zeros((n, n)), phi, qd)
    out["phi_van_loan"], out["qd_van_loan"] = kalman.van_loan(f, qc, dt)
    return out


def discretise() -> dict[str, Any]:
    """A navigation-grade 18-state and a low-cost 15-state case."""
    start = NavState(0.0, 0.0, 0.0, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    drift = block(
        "gyro_bias", "gauss_markov", 0.001 * DEG_H, name="gyro_drift", sd=0.001 * DEG_H, tau_s=7200.0
    )
    fine = config(
        start,
        [
            block("gyro_bias", "constant", 0.01 * DEG_H),
            drift,
            block("accel_bias", "gauss_markov", 0.05 * MILLI_G, sd=0.05 * MILLI_G, tau_s=1800.0),
        ],
        imu={"gyro_psd": [(ARCMIN * 0.001) ** 2] * 3, "accel_psd": [1e-10, 2e-10, 3e-10]},
    )
    coarse = config(
        start,
        [
            block("gyro_bias", "random_walk", 40 * DEG_H, psd=(3 * DEG_H) ** 2 / 100.0),
            block("accel_scale", "gauss_markov", 1e-3, sd=1e-3, tau_s=20.0),
        ],
        imu={"gyro_psd": [2e-9, 3e-9, 4e-9], "accel_psd": [1e-6, 2e-6, 3e-6]},
    )
    return {"cases": [discretisation(1, 0.01, fine), discretisation(4, 0.02, coarse)]}


def main() -> None:
    """Write all files."""
    GOLDEN.mkdir(exist_ok=True)
    for name in CASES:
        dump(f"{name}.json", golden_run(name))
    dump("jacobians.json", jacobians())
    dump("discretise.json", discretise())
    for path in sorted(GOLDEN.glob("*.json")):
        print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
