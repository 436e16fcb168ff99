"""Closed-loop INS/GNSS filter in NED on whole records: the engine's run, dense and slow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from . import attitude as att
from . import earth, errormodel, kalman
from .blocks import Block, blocks_of, sensor_jacobian, sensor_model, total
from .strapdown import Midpoint, NavState, coning_sculling, increments_of_rates, step

Array = NDArray[Any]
USED, REJECTED = 0, 1


@dataclass
class Interval:
    """Corrected sensor data of one IMU interval; w_ib_b (3,) is the rate for the lever arm at its end."""

    dt: float
    dtheta: Array
    dvel: Array
    w_ib_b: Array


class ReferenceFilter:
    """Dense filter driven by an engine configuration (NED model, constant ellipsoid WGS-84)."""

    def __init__(self, config: dict[str, Any]) -> None:
        self.cfg = config
        self.gravity: str = config["gravity"]
        i = config["initial"]
        self.nav = NavState(
            i["lat_rad"], i["lon_rad"], i["height_m"], np.array(i["v_n"], float), np.array(i["q_nb"], float)
        )
        self.blocks: list[Block] = blocks_of(config)
        self.n = 9 + sum(len(b.initial) for b in self.blocks)
        self.x = np.zeros(self.n)
        sd = np.zeros(self.n)
        sd[:9] = [*i["sd_phi"], *i["sd_v"], *i["sd_p"]]
        for b in self.blocks:
            self.x[b.at], sd[b.at] = b.initial, b.initial_sd
        self.p: Array = np.diag(sd**2)
        self.lever = np.array(config["gnss"]["lever_b_m"], float)
        self.last: Interval | None = None
        self.last_raw: tuple[Array, Array] | None = None

    # ---- prediction -------------------------------------------------------------------------------------

    def calibrate(self, value: Array, sensor: str) -> Array:
        """Rate or specific force (3,) after the fixed calibration: (I + M)^-1 (measured - bias)."""
        imu = self.cfg["imu"]
        matrix = np.eye(3) + np.array(imu[f"{sensor}_matrix"], float)
        return np.linalg.solve(matrix, value - np.array(imu[f"{sensor}_bias"], float))

    def correct(self, value: Array, sensor: str) -> Array:
        """Calibrated rate or specific force (3,) less the estimated blocks."""
        bias, matrix = sensor_model(self.blocks, self.x, sensor)
        return np.linalg.solve(np.eye(3) + matrix, self.calibrate(value, sensor) - bias)

    def imu(self, dt: float, gyro: Array, accel: Array) -> None:
        """One IMU row: the columns as configured by ``imu.input``, dt (s) since the row before."""
        kind = self.cfg["imu"]["input"]
        if kind == "rates":
            assert self.last_raw is not None
            w0, w1 = (self.correct(w, "gyro") for w in (self.last_raw[0], gyro))
            f0, f1 = (self.correct(f, "accel") for f in (self.last_raw[1], accel))
            dtheta, dvel, alpha, u = increments_of_rates(w0, w1, f0, f1, dt)
            w_end = w1
        else:
            scale = dt if kind == "increments" else 1.0
            dtheta = self.correct(gyro / scale, "gyro") * dt
            dvel = self.correct(accel / scale, "accel") * dt
            w_end = dtheta / dt
            before = None if self.last is None or self.cfg["coning"] == "one-sample" else self.last
            alpha, u = coning_sculling(
                dtheta, dvel, dt, None if before is None else (before.dtheta, before.dvel, before.dt)
            )
        self.last_raw = (gyro, accel)
        self.last = Interval(dt, dtheta, dvel, w_end)
        self.nav, mid = step(self.nav, alpha, u, dt, gravity=self.gravity)
        phi, q = self.discretise(mid, dt)
        self.p = kalman.predict(self.p, phi, q)
        for b in self.blocks:
            self.x[b.at] *= b.decay(dt, self.ground_speed())

    def ground_speed(self) -> float:
        """Horizontal speed (m/s) at the end of the interval."""
        return float(np.hypot(self.nav.v[0], self.nav.v[1]))

    def dense_f(self, mid: Midpoint) -> Array:
        """Continuous F (n, n) of navigation errors and blocks at the middle of the last interval."""
        assert self.last is not None
        f = np.zeros((self.n, self.n))
        f[:9, :9] = errormodel.ned_f(mid.lat, mid.h, mid.v, mid.f_n, gravity=self.gravity)
        gyro, accel = errormodel.couplings(mid.c)
        for b in self.blocks:
            if b.kind.startswith("gyro_"):
                f[:9, b.at] = gyro @ sensor_jacobian(b.kind, self.last.dtheta / self.last.dt)
            elif b.kind.startswith("accel_"):
                f[:9, b.at] = accel @ sensor_jacobian(b.kind, self.last.dvel / self.last.dt)
            if b.process == "gauss_markov":
                f[b.at, b.at] = np.diag(-1.0 / b.tau)
        return f

    def discretise(self, mid: Midpoint, dt: float) -> tuple[Array, Array]:
        """Phi (n, n), exact on the diagonal of the blocks, and Q (n, n) for the trapezoid form."""
        phi = kalman.transition(self.dense_f(mid), dt, self.cfg["phi_order"])
        q = np.zeros((self.n, self.n))
        imu = self.cfg["imu"]
        q[:3, :3] = mid.c @ np.diag(imu["gyro_psd"]) @ mid.c.T * dt
        q[3:6, 3:6] = mid.c @ np.diag(imu["accel_psd"]) @ mid.c.T * dt
        for b in self.blocks:
            phi[b.at, b.at] = np.diag(b.decay(dt, self.ground_speed()))
            q[b.at, b.at] = np.diag(b.variance_step(dt, self.ground_speed()))
        return phi, q

    # ---- update -----------------------------------------------------------------------------------------

    def residual(self, pos: Array, vel: Array) -> tuple[Array, Array]:
        """Predicted minus measured (6,) in NED, m and m/s, and its Jacobian (6, n)."""
        s, c = self.nav, att.quat_to_dcm(self.nav.q)
        lever = self.lever + total(self.blocks, self.x, "gnss_lever_arm")
        w_ib_b = np.zeros(3) if self.last is None else self.last.w_ib_b
        rm, rn = earth.radii(s.lat)
        arm = c @ lever
        y_p = np.array(
            [
                (s.lat - pos[0]) * (rm + s.h),
                earth.wrap(s.lon - pos[1]) * (rn + s.h) * np.cos(s.lat),
                -(s.h - pos[2]),
            ]
        )
        y_p = y_p + arm + total(self.blocks, self.x, "gnss_position_error")
        y_v = s.v + c @ np.cross(w_ib_b, lever) - np.cross(earth.earth_rate_n(s.lat), arm) - vel
        y_v = y_v + total(self.blocks, self.x, "gnss_velocity_error")
        jac = errormodel.aiding_ned(s.lat, s.h, c, w_ib_b, lever)
        h = np.zeros((6, self.n))
        h[:3, :9], h[3:, :9] = jac["position"], jac["velocity"]
        for b in self.blocks:
            if b.kind.startswith("gyro_"):
                h[3:, b.at] = jac["velocity_gyro"] @ sensor_jacobian(b.kind, w_ib_b)
            elif b.kind == "gnss_lever_arm":
                h[:3, b.at], h[3:, b.at] = jac["position_lever"], jac["velocity_lever"]
            elif b.kind == "gnss_position_error":
                h[:3, b.at] = -np.eye(3)
            elif b.kind == "gnss_velocity_error":
                h[3:, b.at] = -np.eye(3)
        return np.concatenate([y_p, y_v]), h

    def gnss(self, pos: Array, vel: Array, r: Array) -> dict[str, Any]:
        """One GNSS row (NaN = absent), R (6, 6): joint gate, update, injection, reset; returns the record."""
        y, h = self.residual(pos, vel)
        rows = np.flatnonzero(np.isfinite(np.concatenate([pos, vel])))
        x, p, s, nis = kalman.update(self.p, y[rows], h[rows], r[np.ix_(rows, rows)])
        record = {"status": USED, "dof": len(rows), "nis": nis, "innovation": np.full(6, np.nan)}
        record["innovation"][rows] = -y[rows]
        record["innovation_cov"] = np.full((6, 6), np.nan)
        record["innovation_cov"][np.ix_(rows, rows)] = s
        gate = self.cfg["gnss"]["gate_probability"]
        if gate is not None and self.cfg["gnss"].get("gate") == "parts":
            rows = self.passing_parts(record, rows, gate)
            if not len(rows):
                record["status"] = REJECTED
                return record
            x, p, _, _ = kalman.update(self.p, y[rows], h[rows], r[np.ix_(rows, rows)])
        elif gate is not None and nis > scipy.stats.chi2.ppf(gate, len(rows)):
            record["status"] = REJECTED
            return record
        self.take(x, p)
        return record

    def passing_parts(self, record: dict[str, Any], rows: Array, gate: float) -> Array:
        """Rows of position and of velocity, each kept if its own innovation passes."""
        kept = []
        for part in (rows[rows < 3], rows[rows >= 3]):
            y, s = record["innovation"][part], record["innovation_cov"][np.ix_(part, part)]
            if len(part) and y @ np.linalg.solve(s, y) <= scipy.stats.chi2.ppf(gate, len(part)):
                kept += list(part)
        return np.array(kept, dtype=int)

    def jump(self) -> None:
        """Another constellation: the correlated errors jump."""
        for b in self.blocks:
            self.p[b.at, b.at] += np.diag(b.jump_sd**2)

    def scalar(self, kind: str, value: float, var: float) -> dict[str, Any]:
        """One height (m) or heading (rad) of variance var: gate, update, injection; returns the record."""
        h = np.zeros((1, self.n))
        if kind == "baro":
            h[0, 8] = -1.0  # height is minus down
            y = self.nav.h - value
            for b in self.blocks:
                if b.kind == "baro_bias":
                    h[0, b.at] = -1.0
                    y += float(self.x[b.at][0])
        else:
            _, pitch, yaw = att.quat_to_euler(self.nav.q)
            # the estimate is turned by -phi, of which its heading takes the part about down and the tilt's share
            h[0, :3] = [-np.tan(pitch) * np.cos(yaw), -np.tan(pitch) * np.sin(yaw), -1.0]
            y = earth.wrap(yaw - value)
        x, p, s, nis = kalman.update(self.p, np.array([y]), h, np.array([[var]]))
        record = {"status": USED, "nis": nis, "innovation": -y, "variance": s[0, 0]}
        gate = self.cfg[kind]["gate_probability"]
        if gate is not None and nis > scipy.stats.chi2.ppf(gate, 1):
            record["status"] = REJECTED
            return record
        self.take(x, p)
        return record

    def take(self, x: Array, p: Array) -> None:
        """Posterior with its lower bounds, then injection."""
        self.p = p
        floor = self.cfg.get("floor", {"phi": [0.0] * 3, "v": [0.0] * 3, "p": [0.0] * 3})
        sd = np.concatenate([floor["phi"], floor["v"], floor["p"], *(b.floor_sd for b in self.blocks)])
        np.fill_diagonal(self.p, np.maximum(np.diag(self.p), sd**2))
        self.inject(x)

    def inject(self, x: Array) -> None:
        """Subtract the navigation errors, add the block states (n,), turn the attitude covariance."""
        s = self.nav
        rm, rn = earth.radii(s.lat)
        q = att.quat_mul(att.exp_quat(x[:3]), s.q)
        self.nav = NavState(
            s.lat - x[6] / (rm + s.h),
            earth.wrap(s.lon - x[7] / ((rn + s.h) * np.cos(s.lat))),
            s.h + x[8],
            s.v - x[3:6],
            q / np.sqrt(q @ q),
        )
        self.x[9:] += x[9:]
        g = np.eye(self.n)
        g[:3, :3] = kalman.reset_jacobian(x[:3])
        self.p = g @ self.p @ g.T


def run(
    config: dict[str, Any],
    imu: dict[str, Array],
    gnss: dict[str, Array],
    aids: dict[str, dict[str, Array]] | None = None,
) -> dict[str, Any]:
    """Whole record through the reference filter.

    Parameters
    ----------
    config : dict
        Engine configuration.
    imu : dict
        ``t_ns`` (n,), ``gyro`` (n, 3), ``accel`` (n, 3); row 0 at the initial time is the start.
    gnss : dict
        ``t_ns`` (m,), each equal to an IMU time, ``pos`` (m, 3), ``vel`` (m, 3), ``var`` (m, 6) or (m, 6, 6), and
        perhaps ``new`` (m,), rows with another constellation.
    aids : dict, optional
        ``baro`` and ``heading`` with ``t_ns``, ``value``, ``var``, shapes (k,), at IMU times; fused after GNSS.

    Returns
    -------
    dict
        ``t_ns``, ``lla``, ``v_n``, ``q_nb``, ``x``, ``cov`` after each IMU row and its update; records as lists:
        ``meas`` and one per aid.
    """
    filt = ReferenceFilter(config)
    filt.last_raw = (imu["gyro"][0], imu["accel"][0])
    out: dict[str, list[Any]] = {
        k: [] for k in ("t_ns", "lla", "v_n", "q_nb", "x", "cov", "meas", *(aids or {}))
    }
    row = 0
    for k in range(len(imu["t_ns"])):
        if k > 0:
            dt = int(imu["t_ns"][k] - imu["t_ns"][k - 1]) * 1e-9
            filt.imu(dt, imu["gyro"][k], imu["accel"][k])
        while row < len(gnss["t_ns"]) and gnss["t_ns"][row] == imu["t_ns"][k]:
            var = gnss["var"][row]
            if "new" in gnss and gnss["new"][row]:
                filt.jump()
            r = np.diag(var) if var.ndim == 1 else var
            out["meas"].append(filt.gnss(gnss["pos"][row], gnss["vel"][row], r))
            row += 1
        for kind, table in (aids or {}).items():
            for j in np.flatnonzero(table["t_ns"] == imu["t_ns"][k]):
                out[kind].append(filt.scalar(kind, table["value"][j], table["var"][j]))
        s = filt.nav
        out["t_ns"].append(int(imu["t_ns"][k]))
        out["lla"].append([s.lat, s.lon, s.h])
        out["v_n"].append(s.v.copy())
        out["q_nb"].append(s.q.copy())
        out["x"].append(filt.x[9:].copy())
        out["cov"].append(filt.p.copy())
    if row != len(gnss["t_ns"]):
        raise ValueError(f"GNSS row {row} is not at an IMU time")
    records = ("meas", *(aids or {}))
    return {k: v if k in records else np.array(v) for k, v in out.items()}
