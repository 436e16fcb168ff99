"""Linear error models of the reference against central differences of the equations of motion."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from reference import attitude as att
from reference import earth, errormodel
from reference.differences import (
    EPS,
    LD,
    STEP,
    differences,
    ecef_error_rates,
    near,
    ned_error_rates,
    noise_of,
)
from reference.earth import WGS84

Array = NDArray[Any]

LATITUDES = [-80.0, -45.0, 0.0, 30.68, 60.0, 80.0]
VELOCITIES = [(0.0, 0.0, 0.0), (30.0, 0.0, 0.0), (-20.0, 21.0, 5.0), (180.0, -230.0, -70.0)]
ATTITUDES = [
    (0.0, 0.0, 0.0),
    (10.0, -5.0, 75.0),
    (-60.0, 40.0, 200.0),
    (170.0, 10.0, 300.0),
    (25.0, 90.0, 130.0),
    (-40.0, -90.0, 20.0),
]
W_IB_B = np.array([0.3, -0.2, 0.5])
F_B = np.array([1.3, -2.1, -11.0])


def grid() -> list[tuple[float, float, Array, Array]]:
    """Latitude (rad), height (m), velocity (3,), rotation (3, 3), all in extended precision."""
    points = []
    for i, lat in enumerate(LATITUDES):
        for j, v in enumerate(VELOCITIES):
            for e in ATTITUDES:
                c = att.quat_to_dcm(att.euler_to_quat(*np.radians(np.array(e, LD))))
                h = LD((0.0, 8000.0, 500.0)[(i + j) % 3])
                points.append((np.radians(LD(lat)), h, np.array(v, LD), c))
    return points


def test_ned_error_dynamics_are_the_differences_of_the_equations_of_motion():
    for lat, h, v, c in grid():
        numeric = differences(lambda e, p=(lat, h, v, c): ned_error_rates(e, *p, W_IB_B, F_B))
        gyro, accel = errormodel.couplings(c)
        f = np.hstack([errormodel.ned_f(lat, h, v, c @ F_B.astype(LD)), gyro, accel])
        near(numeric, f, noise_of([1.0, 50.0, 400.0]))


def test_ecef_error_dynamics_are_the_differences_of_the_equations_of_motion():
    for lat, h, v, c_nb in grid():
        lon = LD(1.8)
        c_en = earth.c_en(lat, lon)
        r, v_e, c = earth.lla_to_ecef(lat, lon, h), c_en @ v, c_en @ c_nb
        numeric = differences(lambda e, p=(r, v_e, c): ecef_error_rates(e, *p, W_IB_B, F_B))
        gyro, accel = errormodel.couplings(c)
        f = np.hstack([errormodel.ecef_f(lat, lon, h, c @ F_B.astype(LD)), gyro, accel])
        near(numeric, f, noise_of([1.0, 50.0, 400.0]))


def test_aiding_jacobians_are_the_differences_of_the_antenna_equations():
    lever = np.array([0.8, -0.3, -1.2], LD)
    for lat, h, v, c in grid():
        lon = LD(1.8)
        rm, rn = earth.radii(lat)
        c_en = earth.c_en(lat, lon)

        def antenna_ned(e, lat=lat, h=h, v=v, c=c, m=rm + h, n=rn + h):
            c_est, arm = att.exp_dcm(-e[:3]) @ c, lever - e[12:15]
            la, lo, he = lat + e[6] / m, e[7] / (n * np.cos(lat)), h - e[8]
            metres = np.array([(la - lat) * m, lo * n * np.cos(lat), -(he - h)])
            rate = c_est @ np.cross(W_IB_B + e[9:12], arm) - np.cross(earth.earth_rate_n(la), c_est @ arm)
            return np.concatenate([metres + c_est @ arm, v + e[3:6] + rate])

        def antenna_ecef(e, c=c, v=v, lat=lat, lon=lon, h=h, c_en=c_en):
            c_est, arm = att.exp_dcm(-e[:3]) @ c_en @ c, lever - e[12:15]
            w_ie = np.array([0.0, 0.0, WGS84.omega])
            rate = c_est @ np.cross(W_IB_B + e[9:12], arm) - np.cross(w_ie, c_est @ arm)
            return np.concatenate([c_en.T @ (e[6:9] + c_est @ arm), c_en.T @ (c_en @ v + e[3:6] + rate)])

        ned = errormodel.aiding_ned(lat, h, c, W_IB_B, lever)
        ecef = errormodel.aiding_ecef(lat, lon, c, W_IB_B, lever)
        for fun, jac in ((antenna_ned, ned), (antenna_ecef, ecef)):
            numeric = []
            for i, s in enumerate(STEP):
                e = np.zeros(15, LD)
                e[i] = s
                numeric.append((fun(e) - fun(-e)) / (2 * LD(s)))
            full = np.zeros((6, 15), LD)
            full[:3, :9], full[3:, :9] = jac["position"], jac["velocity"]
            full[3:, 9:12] = jac["velocity_gyro"]
            full[:3, 12:], full[3:, 12:] = jac["position_lever"], jac["velocity_lever"]
            noise = np.repeat([100.0, 400.0], 3)[:, None] * 10 * EPS / STEP[None, :]
            noise[:, :3] += 5.0 * STEP[0] ** 2
            near(np.column_stack(numeric), full, noise)


def test_ecef_velocity_row_turns_with_the_estimated_position():
    # GIVEN a NED velocity resolved at the estimate  THEN the residual moves by v x (turn of n)
    for lat, h, v, _ in grid():
        lon, s = LD(1.8), LD(10.0)
        c_en, r = earth.c_en(lat, lon), earth.lla_to_ecef(lat, lon, h)
        numeric = []
        for i in range(3):
            d = np.zeros(3, LD)
            d[i] = s
            up, down = (earth.ecef_to_lla(r + x) for x in (d, -d))
            numeric.append((earth.c_en(*up[:2]).T - earth.c_en(*down[:2]).T) @ c_en @ v / (2 * s))
        near(
            np.column_stack(numeric),
            errormodel.velocity_turn(lat, lon, h, v)[:, 6:],
            np.full((3, 3), 1e4 * EPS),
        )
