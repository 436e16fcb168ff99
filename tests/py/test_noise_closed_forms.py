"""Band-limited noise: closed forms against quadrature and drawn noise, published numbers, printed errata."""

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.signal import lfilter

from gnssins import _core
from gnssins.analysis.noise import (
    ERRATA,
    BandLimited,
    gauss_markov_noise,
    process_noise,
    rotated_noise,
    skew,
    transition,
    worked_values,
)
from gnssins.errors import InputError

# the receiver of the publication: one-sided root densities sqrt(2) 0.008 deg/s/sqrt(Hz), sqrt(2) 0.0034 m/s^2/sqrt(Hz)
GYRO = BandLimited.of_one_sided(np.sqrt(2.0) * np.radians(0.008), 40.0)
ACCEL = BandLimited.of_one_sided(np.sqrt(2.0) * 0.0034, 40.0)
T_I, T_P, J = 0.01, 0.1, 10
W_IE = np.array([0.0, 0.0, 7.292115e-5])


def walk(seed=0) -> np.ndarray:
    """Attitudes of ten steps of a turn."""
    rng = np.random.default_rng(seed)
    return _core.quat_to_dcm(_core.rotvec_to_quat(np.cumsum(rng.normal(0.0, 0.2, (J, 3)), axis=0)))


def test_published_figures_of_the_sensors():
    # specification, section 3: ARW 0.008 deg/rts = 0.48 deg/rth, sample sigma 0.0897 deg/s; VRW 0.204 m/s/rth, 0.0381
    assert 60.0 * np.degrees(GYRO.walk) == pytest.approx(0.48)
    assert np.degrees(np.sqrt(GYRO.variance)) == pytest.approx(0.0897, abs=5e-5)
    assert 60.0 * ACCEL.walk == pytest.approx(0.204)
    assert np.sqrt(ACCEL.variance) == pytest.approx(0.0381, abs=5e-5)
    assert GYRO.walk**2 == pytest.approx(1.950e-8, rel=5e-4)
    assert ACCEL.tau_s == pytest.approx(3.979e-3, abs=1e-6)


def test_worked_values_per_tenth_of_a_second():
    # specification, section 6: alpha 1.950e-9 (closed 1.872e-9), v 1.156e-6 (closed 1.110e-6), 4 % short
    found = worked_values(GYRO, ACCEL)
    assert found["attitude_white_rad2"] == pytest.approx(1.950e-9, rel=3e-4)
    assert found["attitude_closed_rad2"] == pytest.approx(1.872e-9, rel=3e-4)
    assert found["velocity_white_m2_s2"] == pytest.approx(1.156e-6, rel=1e-12)
    assert found["velocity_closed_m2_s2"] == pytest.approx(1.110e-6, rel=1e-4)
    assert found["shortfall"] == pytest.approx(0.0398, abs=1e-4)
    assert gauss_markov_noise(np.radians(10.0 / 3600.0), 70.0, T_P) == pytest.approx(6.72e-12, rel=1e-3)
    assert gauss_markov_noise(7.845e-4, 70.0, T_P) == pytest.approx(1.76e-9, rel=2e-3)


def test_the_two_conventions_of_a_density_differ_by_two():
    one_sided, two_sided = BandLimited.of_one_sided(0.01, 40.0), BandLimited.of_random_walk(0.01, 40.0)
    assert two_sided.variance == pytest.approx(2.0 * one_sided.variance)
    assert two_sided.walk == pytest.approx(0.01)
    # sigma of white noise of 0.01 per rtHz through a first-order filter: 0.01 sqrt(1.57 f) one-sided
    assert np.sqrt(one_sided.variance) == pytest.approx(0.01 * np.sqrt(0.5 * np.pi * 40.0))


@pytest.mark.parametrize(("length", "corner"), [(0.01, 40.0), (0.1, 40.0), (0.05, 3.0), (0.2, 0.5)])
def test_closed_forms_are_the_double_integrals_of_the_autocovariance(length, corner):
    noise = BandLimited(2.0, corner)

    def double(apart: int) -> float:
        def r(s, t):
            return float(noise.autocovariance(s - t))

        if apart:  # smooth: the two intervals do not overlap
            return dblquad(r, 0.0, length, apart * length, (apart + 1) * length)[0]
        return 2.0 * dblquad(r, 0.0, length, 0.0, lambda t: t)[0]  # twice the triangle below the diagonal

    assert noise.same_interval(length) == pytest.approx(double(0), rel=1e-7)
    for apart in (1, 2, 3):
        assert noise.distinct_intervals(length, apart) == pytest.approx(double(apart), rel=1e-6)


@pytest.mark.parametrize("count", [2, 5, 10])
def test_parts_of_an_interval_add_up_to_the_whole(count):
    # Q1(n T) is the sum over all pairs of the n parts
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    parts = np.where(
        apart == 0, ACCEL.same_interval(T_I), ACCEL.distinct_intervals(T_I, np.maximum(apart, 1))
    )
    assert parts.sum() == pytest.approx(ACCEL.same_interval(count * T_I), rel=1e-12)


def test_limits_of_the_closed_form():
    wide = BandLimited(2.0, 1e6)  # far above 1/T: white noise
    assert wide.same_interval(0.1) == pytest.approx(wide.white_equivalent(0.1), rel=1e-5)
    narrow = BandLimited(2.0, 1e-3)  # far below: a constant, R(0) T^2
    assert narrow.same_interval(0.1) == pytest.approx(narrow.variance * 0.1**2, rel=1e-3)
    assert ACCEL.distinct_intervals(T_I, -3) == ACCEL.distinct_intervals(T_I, 3)


def test_the_closed_form_falls_short_by_4_percent_in_the_long_run():
    # GIVEN one interval THEN its variance is Q1; over 10 s the growth per interval is that of white noise
    assert ACCEL.growth(T_P, 1) == ACCEL.same_interval(T_P)
    assert ACCEL.growth(T_P, 100) == pytest.approx(ACCEL.white_equivalent(T_P), rel=5e-4)
    assert 1.0 - ACCEL.same_interval(T_P) / ACCEL.white_equivalent(T_P) == pytest.approx(ACCEL.shortfall(T_P))
    # drawn noise, 400 runs of 10 s at 4 kHz: exact first-order recursion, trapezoidal integral
    rng, dt, runs = np.random.default_rng(1), 2.5e-4, 400
    keep = np.exp(-ACCEL.rate * dt)
    drive = np.sqrt(ACCEL.variance * (1.0 - keep**2)) * rng.normal(size=(runs, 40_001))
    drive[:, 0] *= 1.0 / np.sqrt(1.0 - keep**2)
    w = lfilter([1.0], [1.0, -keep], drive, axis=1)
    v = np.concatenate([np.zeros((runs, 1)), np.cumsum(0.5 * dt * (w[:, 1:] + w[:, :-1]), axis=1)], axis=1)
    intervals = np.diff(v[:, ::400], axis=1)
    one, long_run = intervals.var(), (v[:, -1] ** 2).mean() / 100
    assert one == pytest.approx(ACCEL.same_interval(T_P), rel=0.03)  # 40 000 intervals: 3 sd are 2.1 %
    assert long_run == pytest.approx(ACCEL.white_equivalent(T_P), rel=0.22)  # 400 runs: 3 sd are 21 %
    neighbours = (intervals[:, 1:] * intervals[:, :-1]).mean()
    assert neighbours == pytest.approx(float(ACCEL.distinct_intervals(T_P, 1)), rel=0.3)  # 3 sd are 25 %


def test_a_constant_attitude_drops_out_of_the_rotated_sum():
    c = np.repeat(walk()[:1], J, axis=0)
    found = rotated_noise(c, (ACCEL,) * 3, T_I)
    np.testing.assert_allclose(found, ACCEL.same_interval(T_P) * np.eye(3), rtol=1e-12, atol=1e-20)
    assert found[0, 0] == pytest.approx(1.11000e-6, rel=1e-5)  # specification: 1.11000e-6 both ways


def test_the_rotated_sum_is_that_of_all_pairs():
    c, noise = walk(3), (ACCEL, BandLimited(1e-4, 10.0), GYRO)
    total = np.zeros((3, 3))
    for j in range(J):
        for i in range(J):
            q = [n.same_interval(T_I) if i == j else float(n.distinct_intervals(T_I, i - j)) for n in noise]
            total += c[j] @ np.diag(q) @ c[i].T
    found = rotated_noise(c, noise, T_I)
    np.testing.assert_allclose(found, total, rtol=1e-12)
    assert np.linalg.eigvalsh(found).min() > 0.0


# ---- errata


def test_printed_f6_is_j_times_too_large():
    c, theta, nu = walk(), np.full((J, 3), 1e-3), np.tile([0.0, 0.0, 0.098], (J, 1))
    right = transition(c, theta, nu, T_I, (70.0, 70.0), W_IE)
    printed = transition(c, theta, nu, T_I, (70.0, 70.0), W_IE, "printed")
    np.testing.assert_allclose(printed[6:9, 9:12], J * right[6:9, 9:12])
    # right: an accelerometer bias b moves the velocity by -S b T_P over the interval
    still = np.repeat(np.eye(3)[None], J, axis=0)
    f = transition(still, 0 * theta, 0 * nu, T_I, (70.0, 70.0), W_IE)
    np.testing.assert_allclose(f[6:9, 9:12], -T_P * np.eye(3))


def test_printed_q3_is_j_squared_times_too_large_at_a_constant_attitude():
    c = np.repeat(walk()[:1], J, axis=0)
    ratio = rotated_noise(c, (ACCEL,) * 3, T_I, "printed") @ np.linalg.inv(
        rotated_noise(c, (ACCEL,) * 3, T_I)
    )
    np.testing.assert_allclose(ratio, J**2 * np.eye(3), atol=1e-9)


def test_other_printed_forms_have_the_size_that_the_errata_tell():
    told = {e.place: e.effect for e in ERRATA}
    same = ACCEL.same_interval(T_P) / ACCEL.same_interval(T_I)
    assert same == pytest.approx(15.1, abs=0.1)
    assert "15 times" in told["Q3, term i = j"]
    powers = [
        ACCEL.rate * (d + 1) * T_P / np.log(10.0) for d in (1, 9)
    ]  # exp(-k (i-j-1) T_P) at i - j = -1, -9
    assert [round(p) for p in powers] == [22, 109]
    assert "1e22 to 1e109" in told["Q2(i, j)"]


# ---- the whole matrices


def test_transition_is_the_linearised_motion_of_the_errors():
    # a rigid turn by theta each step: the product of the exact steps, to first order in the increments
    rng = np.random.default_rng(5)
    theta, nu = rng.normal(0.0, 1e-4, (J, 3)), rng.normal(0.0, 1e-4, (J, 3)) + [0.0, 0.0, -0.098]
    c = _core.quat_to_dcm(_core.rotvec_to_quat(np.cumsum(theta, axis=0)))
    f = transition(c, theta, nu, T_I, (70.0, 50.0), W_IE)
    exact = np.eye(15)
    for j in range(J):
        a = np.zeros((15, 15))
        a[0:3, 0:3], a[0:3, 3:6], a[3:6, 3:6] = -skew(theta[j]), -T_I * np.eye(3), -T_I / 70.0 * np.eye(3)
        a[6:9, 0:3], a[6:9, 6:9], a[6:9, 9:12] = -c[j] @ skew(nu[j]), -2.0 * T_I * skew(W_IE), -T_I * c[j]
        a[9:12, 9:12], a[12:15, 6:9] = -T_I / 50.0 * np.eye(3), T_I * np.eye(3)
        exact = (np.eye(15) + a) @ exact
    linear = np.abs(f - exact)
    assert (
        linear[np.ix_(range(12), range(12))].max() < 0.06
    )  # second order: velocity from gyro bias, g T^2 / 2
    blocks = [(0, 0), (0, 3), (3, 3), (6, 0), (6, 6), (6, 9), (9, 9), (12, 6)]
    for i, j in blocks:
        np.testing.assert_allclose(f[i : i + 3, j : j + 3], exact[i : i + 3, j : j + 3], atol=3e-4)


def test_process_noise_has_the_published_blocks_and_cross_terms():
    c = walk()
    bias = (6.716e-11, 1.758e-8)
    q = process_noise(c, (GYRO,) * 3, (ACCEL,) * 3, bias, T_I)
    np.testing.assert_allclose(np.diag(q)[[0, 3, 9]], [1.9496e-9, 6.716e-12, 1.758e-9], rtol=1e-3)
    np.testing.assert_allclose(q[6:9, 6:9], rotated_noise(c, (ACCEL,) * 3, T_I))
    assert not q[12:].any()
    closed = process_noise(c, (GYRO,) * 3, (ACCEL,) * 3, bias, T_I, form="closed")
    assert closed[0, 0] / q[0, 0] == pytest.approx(1.0 - GYRO.shortfall(T_P))
    white = process_noise(c, (GYRO,) * 3, (ACCEL,) * 3, bias, T_I, form="white")
    np.testing.assert_allclose(white[6:9, 6:9], ACCEL.white_equivalent(T_P) * np.eye(3), atol=1e-20)
    f = transition(c, np.zeros((J, 3)), np.tile([0, 0, -0.098], (J, 1)), T_I, (np.inf, np.inf), W_IE)
    whole = process_noise(c, (GYRO,) * 3, (ACCEL,) * 3, bias, T_I, f)
    np.testing.assert_allclose(whole, whole.T, atol=1e-18)
    assert np.linalg.eigvalsh(whole).min() > -1e-20
    # half of F Q F': the velocity comes into the position with T_P / 2
    np.testing.assert_allclose(whole[12:, 6:9], 0.5 * T_P * (f @ q @ f.T)[6:9, 6:9], rtol=0.05, atol=1e-10)


@pytest.mark.parametrize("values", [(-1.0, 40.0), (1.0, 0.0), (np.nan, 40.0), (1.0, np.inf)])
def test_noise_that_is_none_is_refused(values):
    with pytest.raises(InputError, match="density"):
        BandLimited(*values)
    with pytest.raises(InputError, match="at least one apart"):
        ACCEL.distinct_intervals(T_I, 0)
