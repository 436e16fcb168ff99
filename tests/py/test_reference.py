"""Earth, attitude and strapdown of the reference against numbers from their sources."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from reference import attitude as att
from reference import earth, errormodel, strapdown, trajectory
from reference.differences import EPS, LD, near
from reference.earth import WGS84

Array = NDArray[Any]
LATITUDES = [-80.0, -45.0, 0.0, 30.68, 60.0, 80.0]


def test_gravity_matches_published_values():
    # equator, pole and Somigliana's constant of WGS 84 (TR8350.2, table 3.4); the pole is rounded
    assert earth.gravity_n(0.0, 0.0)[2] == pytest.approx(9.7803253359, rel=1e-15)
    assert earth.gravity_n(np.pi / 2, 0.0)[2] == pytest.approx(9.8321849378, abs=1.01e-10)
    assert WGS84.k == pytest.approx(0.00193185265241, abs=5e-12)
    assert earth.gravity_n(np.radians(30.68), 150.0)[2] == pytest.approx(9.79332, abs=6e-6)


def test_vertical_gradient_obeys_bruns():
    # On a level surface -dg/dh = g (1/R_M + 1/R_N) + 2 omega^2 (Heiskanen and Moritz 1967, eq. 2-79)
    for lat in np.radians(LATITUDES):
        rm, rn = earth.radii(lat)
        _, by_h = earth.gravity_slopes(lat, 0.0)
        bruns = earth.gravity_n(lat, 0.0)[2] * (1 / rm + 1 / rn) + 2 * WGS84.omega**2
        assert -by_h[2] == pytest.approx(bruns, rel=5e-5)


def test_north_gravity_makes_the_field_free_of_curl():
    # the gradient of a field without curl is symmetric; its trace is twice the square of the Earth rate
    for lat in np.radians(np.array(LATITUDES, LD)):
        for h in (LD(0.0), LD(2000.0), LD(20000.0)):
            g = errormodel.gravity_gradient_n(lat, h)
            assert np.abs(g - g.T).max() < 20.0 * EPS / 6e6 * 10.0
            assert float(np.trace(g)) == pytest.approx(2 * WGS84.omega**2, abs=1e-9)
    # Groves (2013), eq. 2.140: -8.08e-9 per metre times sin 2L
    groves = -8.08e-9 * 1000.0 * np.sin(np.radians(2 * 40.0))
    assert earth.gravity_n(np.radians(40.0), 1000.0)[0] == pytest.approx(groves, rel=0.01)


@pytest.mark.parametrize("kind", ["normal", "vertical"])
def test_slopes_of_radii_and_gravity_are_differences(kind):
    for lat in np.radians(np.array(LATITUDES, LD)):
        s, h = LD(1e-6), LD(4000.0)
        pair = [np.array(earth.radii(lat + x)) for x in (s, -s)]
        near(
            np.array(earth.radii_slopes(lat)),
            (pair[0] - pair[1]) / (2 * s),
            np.full(2, 1e6 * EPS / 1e-6 * 100),
        )
        by_lat, by_h = earth.gravity_slopes(lat, h, kind=kind)
        g = [earth.gravity_n(lat + x, h, kind=kind) for x in (s, -s)]
        near(by_lat, (g[0] - g[1]) / (2 * s), np.full(3, 10 * EPS / 1e-6 * 100))
        g = [earth.gravity_n(lat, h + x, kind=kind) for x in (LD(1.0), LD(-1.0))]
        near(by_h, (g[0] - g[1]) / 2, np.full(3, 10 * EPS * 100))


def test_exp_and_log_of_attitude_are_inverse():
    rng = np.random.default_rng(1)
    for size in (1e-12, 1e-6, 1e-3, 0.5, 3.1):
        v = rng.normal(size=3)
        v *= size / np.linalg.norm(v)
        assert att.log_quat(att.exp_quat(v)) == pytest.approx(v, rel=1e-14, abs=1e-15 * size)
        q = att.exp_quat(v)
        c = att.quat_to_dcm(q)
        assert att.quat_to_dcm(att.dcm_to_quat(c)) == pytest.approx(c, abs=1e-15)


def test_euler_angles_have_the_named_senses():
    # nose up lifts the forward axis, right wing down lowers the right axis, heading east turns north to east
    up = att.quat_to_dcm(att.euler_to_quat(0.0, 0.1, 0.0))
    assert up[2, 0] < 0.0
    right_down = att.quat_to_dcm(att.euler_to_quat(0.1, 0.0, 0.0))
    assert right_down[2, 1] > 0.0
    east = att.quat_to_dcm(att.euler_to_quat(0.0, 0.0, np.pi / 2))
    assert east @ [1, 0, 0] == pytest.approx([0, 1, 0], abs=1e-15)
    assert att.quat_to_euler(att.euler_to_quat(0.3, -0.4, 2.0)) == pytest.approx([0.3, -0.4, 2.0], abs=1e-15)


def test_geodetic_and_ecef_positions_are_inverse():
    for lat in LATITUDES:
        lla = np.radians(lat), 2.0, 4000.0
        assert earth.ecef_to_lla(earth.lla_to_ecef(*lla)) == pytest.approx(lla, rel=1e-12, abs=1e-15)


def linear_motion(t: float) -> tuple[Array, Array]:
    """Rate and specific force (3,) that are linear in time."""
    return np.array([0.5, -0.3, 0.8]) + np.array([3.0, 2.0, -4.0]) * t, np.array([2.0, 1.0, -9.8]) + np.array(
        [5.0, -20.0, 8.0]
    ) * t


def integrate(t0: float, t1: float, n: int = 4000) -> tuple[Array, Array]:
    """Rotation matrix (3, 3) and velocity (3,) in the axes at t0, by many small midpoint steps."""
    c, v = np.eye(3), np.zeros(3)
    dt = (t1 - t0) / n
    for i in range(n):
        w, f = linear_motion(t0 + (i + 0.5) * dt)
        half = att.exp_dcm(w * dt / 2)
        v = v + c @ half @ f * dt
        c = c @ half @ half
    return c, v


def increments(t0: float, t1: float) -> tuple[Array, Array]:
    w0, f0 = linear_motion(t0)
    w1, f1 = linear_motion(t1)
    return (w0 + w1) / 2 * (t1 - t0), (f0 + f1) / 2 * (t1 - t0)


@pytest.mark.parametrize("ratio", [1.0, 0.5, 2.0])
def test_two_sample_coning_and_sculling_are_exact_for_linear_motion(ratio):
    errors = []
    for dt in (0.02, 0.01):
        c, v = integrate(0.0, dt)
        before = (*increments(-ratio * dt, 0.0), ratio * dt)
        alpha, u = strapdown.coning_sculling(*increments(0.0, dt), dt, before)
        errors.append([np.linalg.norm(att.log_quat(att.dcm_to_quat(c)) - alpha), np.linalg.norm(v - u)])
    # the angle is left with fourth order in dt, the velocity with the cubic theta x (theta x dv) / 6
    assert errors[0][0] / errors[1][0] > 12.0
    assert errors[0][1] / errors[1][1] > 6.0
    assert errors[1][0] < 1e-9
    assert errors[1][1] < 2e-6


def test_rates_give_the_same_compensation_as_increments_of_linear_motion():
    dt = 0.01
    (w0, f0), (w1, f1) = linear_motion(0.0), linear_motion(dt)
    dtheta, dvel, alpha, u = strapdown.increments_of_rates(w0, w1, f0, f1, dt)
    before = (*increments(-dt, 0.0), dt)
    alpha2, u2 = strapdown.coning_sculling(dtheta, dvel, dt, before)
    assert alpha == pytest.approx(alpha2, abs=1e-16)
    assert u == pytest.approx(u2, abs=1e-15)


def test_step_is_of_second_order_against_the_continuous_equations():
    # GIVEN constant body rate and force  WHEN one interval is taken as 1, 2, 4 steps
    # THEN the end velocity and position approach the limit with the square of the step
    lat, h, v = np.radians(50.0), 3000.0, np.array([120.0, -160.0, 20.0])
    w, f = np.array([0.02, -0.01, 0.03]), np.array([1.0, 0.5, -9.9])

    def fly(n: int) -> Array:
        s, dt = strapdown.NavState(lat, 1.0, h, v, att.euler_to_quat(0.1, 0.2, 0.3)), 8.0 / n
        for _ in range(n):
            alpha, u = strapdown.coning_sculling(w * dt, f * dt, dt, None)
            s, _ = strapdown.step(s, alpha, u, dt)
        return np.array([*s.v, s.lat * 6.4e6, s.lon * 4e6, s.h, *(s.q * 1e3)])

    fine = fly(2048)
    coarse, half = np.abs(fly(16) - fine), np.abs(fly(32) - fine)
    assert np.all(coarse / half > 3.5)


def rk4_ned(s: strapdown.NavState, w: Array, f: Array, until: float, n: int) -> strapdown.NavState:
    """Continuous equations with constant body rate and force by Runge-Kutta 4."""
    y = np.concatenate([[s.lat, s.lon, s.h], s.v, att.quat_to_dcm(s.q).ravel()])
    dt = until / n

    def rate(y: Array) -> Array:
        a = strapdown.rates_ned(y[0], y[2], y[3:6], y[6:].reshape(3, 3), w, f)
        return np.concatenate([[a[0], a[1], a[2]], a[3], a[4].ravel()])

    for _ in range(n):
        k1 = rate(y)
        k2 = rate(y + dt / 2 * k1)
        k3 = rate(y + dt / 2 * k2)
        k4 = rate(y + dt * k3)
        y = y + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return strapdown.NavState(y[0], y[1], y[2], y[3:6], att.dcm_to_quat(y[6:].reshape(3, 3)))


def test_step_closes_on_the_continuous_equations():
    # GIVEN 300 m/s at 60 deg latitude and a turn  WHEN 60 s are flown at 100 Hz
    # THEN the steps agree with Runge-Kutta on the continuous equations
    start = strapdown.NavState(
        np.radians(60.0), 1.0, 9000.0, np.array([200.0, 220.0, -10.0]), att.euler_to_quat(0.1, 0.02, 0.8)
    )
    w, f, dt = np.array([1e-3, -2e-3, 3e-2]), np.array([0.2, 0.3, -9.81]), 0.01
    want = rk4_ned(start, w, f, 60.0, 600)
    s, before = start, None
    for _ in range(6000):
        alpha, u = strapdown.coning_sculling(w * dt, f * dt, dt, before)
        before = (w * dt, f * dt, dt)
        s, _ = strapdown.step(s, alpha, u, dt)
    assert (s.lat - want.lat) * 6.4e6 == pytest.approx(0.0, abs=2e-4)
    assert (s.lon - want.lon) * 3.2e6 == pytest.approx(0.0, abs=2e-4)
    assert s.h - want.h == pytest.approx(0.0, abs=2e-4)
    assert s.v == pytest.approx(want.v, abs=1e-5)
    turn = att.log_quat(att.quat_mul(s.q, att.quat_inv(want.q)))
    assert turn == pytest.approx(np.zeros(3), abs=1e-9)


TABLE = np.array(
    [  # t, lat, lon, h, heading, pitch, roll, vE, vN, vU
        [0, 30.680000, 104.060000, 150.00, 45, 0, 0, 21.213, 21.213, 0],
        [500, 30.721379, 104.184505, 558.14, 15, 0, 0, 7.765, 28.978, 0],
        [1000, 30.735082, 104.264630, 662.60, 225, 0, 0, -21.213, -21.213, 0],
        [1500, 30.670630, 104.301442, 635.91, 45, -3, 0, 21.184, 21.184, -1.570],
        [1800, 30.658193, 104.369626, 631.20, 135, 0, 0, 21.213, -21.213, 0],
        [2100, 30.645360, 104.446690, 536.99, 115, 0, 0, 27.189, -12.679, 0],
        [2500, 30.637618, 104.545134, 479.41, 55, 0, 0, 24.575, 17.207, 0],
        [3000, 30.711051, 104.604065, 270.14, 85, 0, 0, 29.886, 2.615, 0],
    ]
)
DT = 0.01


@pytest.fixture(scope="module")
def flight() -> Array:
    """Latitude, longitude, height (300001, 3) at 100 Hz."""
    return trajectory.positions(3000.0, DT)


def state_at(flight: Array, k: int) -> strapdown.NavState:
    t = np.float64(k * DT)
    return strapdown.NavState(
        *flight[k], trajectory.velocity_n(t), att.euler_to_quat(*trajectory.attitude_angles(t))
    )


def test_flight_passes_through_the_published_table(flight):
    for t, lat, lon, h, heading, pitch, roll, ve, vn, vu in TABLE:
        s = state_at(flight, round(t / DT))
        assert np.degrees([s.lat, s.lon]) == pytest.approx([lat, lon], abs=6e-7)
        assert s.h == pytest.approx(h, abs=6e-3)
        assert s.v == pytest.approx([vn, ve, -vu], abs=6e-4)
        angles = np.degrees(trajectory.attitude_angles(t))
        assert angles == pytest.approx([roll, pitch, heading], abs=1e-9)


def test_published_step_gives_the_check_value_at_915_s(flight):
    s0, s1 = state_at(flight, 91500), state_at(flight, 91501)
    dtheta, dvel = strapdown.invert_step_spec(s0, s1.v, s1.q, DT)
    frd_to_rfu = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    # half a unit of the last printed digit
    digit = np.array([5e-12, 5e-12, 5e-11])
    assert np.all(np.abs(frd_to_rfu @ dtheta - [3.649812e-5, -4.0278e-7, -3.467564e-4]) <= digit)
    digit = np.array([5e-11, 5e-12, 5e-10])
    assert np.all(np.abs(frd_to_rfu @ dvel - [-3.8856e-6, -3.187e-8, 9.8443851e-2]) <= digit)


def test_engine_step_differs_from_the_published_step_by_the_half_rotation_and_mid_coriolis(flight):
    s0, s1 = state_at(flight, 91500), state_at(flight, 91501)
    dtheta, dvel = strapdown.invert_step_spec(s0, s1.v, s1.q, DT)
    published = strapdown.step_spec(s0, dtheta, dvel, DT)
    alpha, u = strapdown.coning_sculling(dtheta, dvel, DT, None)
    ours, _ = strapdown.step(s0, alpha, u, DT, gravity="vertical")
    w_ie, w_en = earth.earth_rate_n(s0.lat), earth.transport_rate_n(s0.lat, s0.h, s0.v)
    half = -DT / 2 * np.cross(w_ie + w_en, att.quat_to_dcm(s0.q) @ u)
    v_mid = s0.v + (s1.v - s0.v) / 2
    middle = np.cross(2 * w_ie + w_en, s0.v) - np.cross(
        2 * w_ie + earth.transport_rate_n(s0.lat, s0.h, v_mid), v_mid
    )
    assert ours.v - published.v == pytest.approx(half + DT * middle, abs=2e-11)
    assert np.abs(half).max() == pytest.approx(3.4e-8, rel=0.02)
    # the north gravity that the publication leaves out is of the same size here
    full, _ = strapdown.step(s0, alpha, u, DT)
    assert full.v - ours.v == pytest.approx([-4.7e-8, 0.0, 0.0], abs=1e-9)
    assert (ours.lat - published.lat) * 6.4e6 == pytest.approx(0.0, abs=5e-9)
    turn = att.log_quat(att.quat_mul(ours.q, att.quat_inv(published.q)))
    assert turn == pytest.approx(np.zeros(3), abs=1e-13)
