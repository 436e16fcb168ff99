"""Dense filter of the reference: Markov variance, series, noise, Joseph form, attitude reset."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from reference import attitude as att
from reference import errormodel, kalman

Array = NDArray[Any]
F_B = np.array([1.3, -2.1, -11.0])


def markov_chain(sd: float, tau: float, dt: float, steps: int) -> tuple[float, float]:
    """Variance of a Gauss-Markov state after many predictions, started right and started at zero."""
    d2 = np.exp(-2 * dt / tau)
    q = np.array([[2 * sd**2 * (1 - d2) / (1 + d2)]])
    phi = np.array([[np.sqrt(d2)]])
    a, b = np.array([[sd**2]]), np.array([[0.0]])
    for _ in range(steps):
        a, b = kalman.predict(a, phi, q), kalman.predict(b, phi, q)
    return a[0, 0], b[0, 0]


@pytest.mark.parametrize(("tau", "dt"), [(7200.0, 0.01), (1.0, 0.5), (0.1, 1.0)])
def test_stationary_variance_of_a_markov_state_is_exact(tau, dt):
    stay, grow = markov_chain(0.3, tau, dt, 2000)
    assert stay == pytest.approx(0.09, rel=1e-11)
    # the trapezoid form is not the exact transient, but its error is of second order in dt / tau
    exact = 0.09 * (1 - np.exp(-2 * dt * 2000 / tau))
    assert grow == pytest.approx(exact, rel=1e-9)


def typical_f() -> Array:
    c = att.quat_to_dcm(att.euler_to_quat(0.2, -0.1, 1.0))
    f = np.zeros((15, 15))
    f[:9, :9] = errormodel.ned_f(np.radians(48.0), 500.0, np.array([180.0, -200.0, 10.0]), c @ F_B)
    f[:9, 9:12], f[:9, 12:] = errormodel.couplings(c)
    f[9:, 9:] = -np.eye(6) / 50.0
    return f


@pytest.mark.parametrize("order", [1, 2, 3])
def test_transition_series_has_the_error_of_its_order(order):
    f = typical_f()
    errors = []
    for dt in (0.4, 0.2):
        exact, _ = kalman.van_loan(f, np.zeros_like(f), dt)
        errors.append(np.abs(kalman.transition(f, dt, order) - exact).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order + 1, abs=0.15)


def test_trapezoid_noise_has_a_relative_error_of_second_order_in_the_step():
    f = typical_f()
    qc = np.diag([1e-6] * 3 + [1e-4] * 3 + [0.0] * 3 + [1e-10] * 3 + [1e-6] * 3)
    sd = np.sqrt(np.diag(kalman.van_loan(f, qc, 1.0)[1]))
    errors = []
    for dt in (0.02, 0.01):
        steps = round(1.0 / dt)
        phi = kalman.transition(f, dt, 3)
        p = np.zeros((15, 15))
        for _ in range(steps):
            p = kalman.predict(p, phi, qc * dt)
        errors.append(np.abs((p - kalman.van_loan(f, qc, 1.0)[1]) / np.outer(sd, sd)).max())
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_two_pass_scalar_joseph_equals_the_full_joseph_form():
    rng = np.random.default_rng(4)
    for _ in range(50):
        n, k = 15, 6
        scale = 10.0 ** rng.uniform(-6, 2, n)
        root = rng.normal(size=(n, n)) * scale[:, None]
        p = root @ root.T
        r_root = rng.normal(size=(k, k))
        r = r_root @ r_root.T + np.eye(k)
        h, y = rng.normal(size=(k, n)) / scale, rng.normal(size=k)
        x, post, _, _ = kalman.update(p, y, h, r)
        x2, post2 = kalman.update_two_pass(p, y, h, r)
        sd = np.sqrt(np.diag(p))
        assert x2 / sd == pytest.approx(x / sd, abs=1e-10)
        assert post2 / np.outer(sd, sd) == pytest.approx(post / np.outer(sd, sd), abs=1e-10)


def test_attitude_reset_jacobian_has_the_plus_sign():
    # GIVEN C_true = Exp(phi) C_est  WHEN Exp(phi_hat) C_est is taken as the new estimate
    # THEN the error left is (I + [phi_hat x] / 2) times the error of phi_hat, to first order in phi_hat
    rng = np.random.default_rng(7)
    for size in (1e-2, 1e-3):
        hat = rng.normal(size=3)
        hat *= size / np.linalg.norm(hat)
        columns = []
        for i in range(3):
            d = np.zeros(3)
            d[i] = 1e-5
            left = [
                att.log_quat(att.quat_mul(att.exp_quat(hat + x), att.quat_inv(att.exp_quat(hat))))
                for x in (d, -d)
            ]
            columns.append((left[0] - left[1]) / 2e-5)
        numeric = np.column_stack(columns)
        assert np.abs(numeric - kalman.reset_jacobian(hat)).max() < size**2 / 4
        assert np.abs(numeric - kalman.reset_jacobian(-hat)).max() > size / 4


def test_attitude_reset_jacobian_turns_the_covariance_as_a_monte_carlo():
    rng = np.random.default_rng(8)
    hat = np.array([0.3, -0.2, 0.4])
    sd = np.array([1e-3, 4e-3, 2e-2])
    draws = hat + rng.normal(size=(40000, 3)) * sd
    back = att.quat_inv(att.exp_quat(hat))
    left = np.array([att.log_quat(att.quat_mul(att.exp_quat(d), back)) for d in draws])
    got = np.cov(left.T)
    misfit = []
    for sign in (1.0, 0.0, -1.0):
        g = kalman.reset_jacobian(sign * hat)
        misfit.append(np.linalg.norm(g @ np.diag(sd**2) @ g.T - got) / np.linalg.norm(got))
    assert misfit[0] < 0.05
    assert misfit[0] < misfit[1] / 3 < misfit[2] / 4
