"""Analysis of the attitude laws: against independent algebra, against figures of the publication, against the core."""

import json
import math

import numpy as np
import pytest
from scipy.linalg import expm

from gnssins import _core, ahrs, plots
from gnssins.ahrs import Cross, Integral, Positional, Quaternion, Sensors, tuning
from gnssins.analysis.ahrs import (
    ANGLES,
    characteristic_polynomial,
    effective_matrix,
    error_matrix,
    euler_rate_limit,
    level_sensors,
    noise_gain,
    printed_polynomial,
    rate_grid,
    response,
    routh,
    simulated_corner,
    simulated_noise,
    simulated_response,
    simulated_step,
    stability,
    step_response,
)
from gnssins.errors import ConfigError
from gnssins.plots import ahrs as figures

G = 9.80665
K, N = 42.8, 13.3
CROSS = Cross(K, N)
W0 = 2.0 * math.pi * 10.0
CHEBYSHEV = Integral(1.1 * W0, 1.1 * W0**2)
NORTH = np.array([1.0, 0.0, 1.0])
LAWS = [Positional(K), Positional((10.0, 20.0, 70.0)), CROSS, Cross(30.0, -20.0), CHEBYSHEV]


# ---------------------------------------------------------------------------- polynomials and stability


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_polynomial_is_that_of_the_matrix(law):
    rates = np.random.default_rng(1).uniform(-100.0, 100.0, (40, 3))
    found = characteristic_polynomial(law, rates)
    for rate, row in zip(rates, found, strict=True):
        np.testing.assert_allclose(row, np.poly(error_matrix(law, rate)), rtol=1e-9)


def test_printed_constant_term_is_another_one():
    rate = np.array([30.0, -50.0, 70.0])  # forward, right, down: w2 = -70, w3 = -50 in the publication's axes
    right, printed = characteristic_polynomial(CROSS, rate), printed_polynomial(CROSS, rate)
    np.testing.assert_array_equal(right[:3], printed[:3])
    assert printed[3] - right[3] == pytest.approx(4 * N**3 + 2 * N * (-70.0 + 50.0))
    # at rest the published factors (p + k - n)(p² + (2k + n)p + k² + kn + 2n²) have -2n³
    factors = np.polymul([1.0, K - N], [1.0, 2 * K + N, K**2 + K * N + 2 * N**2])
    np.testing.assert_allclose(characteristic_polynomial(CROSS), factors)
    np.testing.assert_allclose(factors, [1.0, 128.4, 5672.45, 81268.44], rtol=1e-5)
    np.testing.assert_allclose(np.sort_complex(np.roots(factors))[-1].real, -29.5)


def test_published_sensitivity_of_the_pair_at_rest():
    # p2,3 = -k - n/2 +- j n sqrt(7)/2
    poles = np.linalg.eigvals(error_matrix(CROSS))
    pair = poles[poles.imag > 1.0][0]
    assert pair == pytest.approx(complex(-K - N / 2, N * math.sqrt(7.0) / 2))


@pytest.mark.parametrize("law", [CROSS, Cross(30.0, -20.0), Positional((10.0, 20.0, 70.0))], ids=str)
def test_eigenvalues_keep_the_bound_on_the_whole_grid(law):
    found = stability(law, rate_grid(100.0, 41))
    bound = -(law.k - abs(law.n)) if isinstance(law, Cross) else -10.0
    assert found.bound == pytest.approx(bound)
    assert found.worst <= bound + 1e-9
    assert found.stable
    assert found.missed == 0
    assert "any body rate" in found.verdict


def test_bound_is_that_of_the_running_law():
    # the slowest rate of the grid, WHEN the core runs it, THEN the error falls exactly as its eigenvalue says
    found = stability(CROSS, rate_grid(100.0, 5))
    dt_s, count = 0.01, 40
    for rate in (found.worst_rate, np.array([100.0, -100.0, 50.0])):
        q = np.empty((count, 4))
        q[0] = [1.0, 0.0, 0.0, 0.0]
        for k in range(1, count):
            q[k] = _core.quat_mul(q[k - 1 : k], _core.rotvec_to_quat(rate[None] * dt_s))[0]
        c = _core.quat_to_dcm(q)
        t_ns = np.rint(np.arange(count) * dt_s * 1e9).astype(np.int64)
        accel = np.einsum("kji,j->ki", c, np.array([0.0, 0.0, -G]))
        mag = np.einsum("kji,j->ki", c, NORTH)
        sensors = Sensors(t_ns, np.tile(rate, (count, 1)), accel, mag, "mean-rates")
        start = _core.euler_to_quat(np.array([[0.003, -0.002, 0.004]]))[0]
        result = ahrs.run(sensors, CROSS, form="elements", initial_q_nb=start)
        # the error matrix of the up row, from the elements c21 = sin(pitch) and the roll: independent prediction
        turn = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
        c0 = turn @ _core.quat_to_dcm(start[None])[0] @ turn.T
        for k in (1, 5, 20):
            truth = turn @ c[k] @ turn.T
            error = expm(error_matrix(CROSS, rate) * k * dt_s) @ (c0 - np.eye(3))[1]
            element = truth[1, 0] + error[0]
            assert math.sin(result.element_angles[k, 1]) == pytest.approx(element, abs=1e-12)


def test_whole_routh_condition_finds_what_the_published_one_passes():
    # n = 1.05 k: every unstable point of the grid passes ab > c
    found = stability(Cross(K, 1.05 * K))
    assert int((~found.routh).sum()) == found.missed == 3185
    np.testing.assert_array_equal(found.routh, found.abscissa < 0.0)
    assert "unstable" in found.verdict
    assert not np.any((found.abscissa >= 0.0) & found.routh)
    json.dumps(found.to_dict())
    assert "3185" in found.table()


def test_routh_tells_stable_polynomials():
    rng = np.random.default_rng(7)
    for degree in (2, 3, 4, 6):
        for _ in range(200):
            p = np.poly(rng.normal(-0.3, 1.0, degree))
            assert routh(p) == (np.roots(p).real.max() < 0.0)
    assert routh([[1.0, 2.0, 3.0, 4.0], [1.0, 2.0, 3.0, -4.0]]).tolist() == [True, False]
    assert not routh([1.0, 0.0, 1.0])


def test_integral_law_slows_down_with_the_rate():
    law = Integral(1.1 * 2.0 * math.pi, 1.1 * (2.0 * math.pi) ** 2)
    at_rest, fast = stability(law, [[0.0, 0.0, 0.0]]), stability(law, [[100.0, 100.0, -100.0]])
    assert at_rest.worst == pytest.approx(-3.456, abs=1e-3)
    assert fast.worst == pytest.approx(-0.0099, abs=1e-4)
    assert fast.worst == pytest.approx(-law.k * law.k_int / (law.k**2 + 3e4), rel=0.01)


def test_quaternion_law_is_stable_within_its_range():
    for n in (-0.49, 0.0, 0.3, 0.99):
        found = stability(Quaternion(K, n * K), rate_grid(100.0, 9))
        assert found.stable
        assert found.worst <= found.bound + 1e-9 < 0.0
    for n in (-0.51, 1.01):  # beyond it nothing is promised
        assert stability(Quaternion(K, n * K), [[0.0, 0.0, 0.0]]).bound > 0.0


def test_explicit_euler_has_the_limit_that_the_core_has_not():
    for dt_s, limit in ((0.01, 82.0), (0.005, 124.0), (0.001, 289.0)):
        assert euler_rate_limit(K, dt_s) == pytest.approx(limit, abs=0.5)
        for factor, grows in ((0.99, False), (1.01, True)):
            rate = [0.0, 0.0, factor * euler_rate_limit(K, dt_s)]
            step = np.eye(3) + error_matrix(Positional(K), rate) * dt_s
            assert (np.abs(np.linalg.eigvals(step)).max() > 1.0) == grows
    assert euler_rate_limit(300.0, 0.01) == 0.0


# ---------------------------------------------------------------------------- frequency response


@pytest.mark.parametrize(
    ("law", "angle", "reading", "corner"),
    [
        (CROSS, "pitch", "measured", 7.91),
        (CROSS, "heading", "measured", 7.91),
        (CROSS, "roll", "measured", 6.59),
        (CROSS, "pitch", "gyro", 8.79),
        (CROSS, "roll", "gyro", 5.87),
        (Positional(K), "pitch", "measured", 6.82),
        (Positional(K), "roll", "gyro", 6.82),
        (Positional(W0), "roll", "measured", 10.0),
        (CHEBYSHEV, "pitch", "measured", 19.3),
        (CHEBYSHEV, "pitch", "gyro", 17.35),
    ],
)
def test_corners_of_the_published_tunings(law, angle, reading, corner):
    found = response(law, angle, reading)
    assert found.corner_hz == pytest.approx(corner, rel=0.005)
    assert found.slope_db_decade == pytest.approx(-20.0, abs=0.01)


def test_gains_and_peaks_of_the_published_tunings():
    assert response(CROSS, "pitch", "gyro").dc == pytest.approx(0.0204, abs=5e-5)
    assert response(CROSS, "roll", "gyro").dc == pytest.approx(0.0247, abs=5e-5)
    assert response(CROSS, "pitch").peak == (0.0, 0.0)
    peak, at = response(CHEBYSHEV, "pitch").peak
    assert peak == pytest.approx(3.14, abs=0.01)
    assert at == pytest.approx(8.88, abs=0.01)
    assert response(CHEBYSHEV, "pitch", "gyro").dc == pytest.approx(0.0, abs=1e-12)
    assert response(CHEBYSHEV, "pitch", "gyro").peak[1] == pytest.approx(10.0 * math.sqrt(1.1), rel=1e-6)
    # static leakage of a gyro bias into the other tilt axis
    leak = abs(response(CROSS, "roll", "gyro").at(0.0, "pitch")[0]) / response(CROSS, "pitch", "gyro").dc
    assert leak == pytest.approx(0.24, abs=0.005)


@pytest.mark.parametrize("form", ["elements", "rotation"])
@pytest.mark.parametrize("law", [CROSS, Positional((30.0, 40.0, 50.0)), CHEBYSHEV], ids=str)
def test_frequency_response_is_that_of_the_running_law(law, form):
    for angle in ANGLES:
        for reading in ("measured", "gyro"):
            for f in (2.0, 10.0, 25.0):
                want = response(law, angle, reading, form=form, dt_s=0.01).at(f)[0]
                assert simulated_response(law, angle, reading, f, 0.01, form) == pytest.approx(want, rel=2e-4)


@pytest.mark.parametrize(
    ("law", "angle", "corner"),
    [(CROSS, "pitch", 7.91), (CROSS, "roll", 6.59), (Positional(K), "heading", 6.82)],
)
def test_corner_of_the_running_law_is_the_published_one(law, angle, corner):
    # at 5 kHz, where sampling moves it by less than a thousandth
    assert simulated_corner(law, angle) == pytest.approx(corner, rel=0.005)
    assert simulated_corner(law, angle) == pytest.approx(response(law, angle).corner_hz, rel=1e-3)


def test_constant_gyro_error_leaves_its_sampled_dc_response():
    for law in (CROSS, Positional(K), CHEBYSHEV):
        want = response(law, "roll", "gyro", dt_s=0.01)
        rates = np.tile([1e-5, 0.0, 0.0], (400, 1))
        run = ahrs.run(level_sensors(400, 0.01, gyro=rates), law, form="elements")
        assert run.element_angles[-1, 0] / 1e-5 == pytest.approx(want.dc, rel=1e-6)
    # the integral law leaves nothing in continuous time, half an interval of drift at the samples
    sampled = response(CHEBYSHEV, "roll", "gyro", dt_s=0.001)
    assert sampled.band_pass
    assert sampled.dc == pytest.approx(-0.0005, rel=0.03)
    assert sampled.corner_hz == pytest.approx(17.3, rel=0.01)
    assert response(Positional(K), "roll", "gyro", dt_s=0.01).dc == pytest.approx(0.01 / math.expm1(K * 0.01))


def test_rotation_form_halves_the_cross_coupling():
    np.testing.assert_allclose(
        effective_matrix(CROSS) - K * np.eye(3), 0.5 * (K * np.eye(3) - CROSS.matrix().T), atol=1e-12
    )
    np.testing.assert_allclose(effective_matrix(Positional(K)), K * np.eye(3))
    assert response(CROSS, "roll", form="rotation").corner_hz == pytest.approx(7.16, abs=0.005)
    assert response(CROSS, "pitch", form="rotation").corner_hz == pytest.approx(6.84, abs=0.005)


def test_step_responses_of_the_published_tunings():
    for law, angle, settled, undershoot in (
        (Positional(K), "pitch", 0.070, 0.0),
        (CROSS, "pitch", 0.057, 0.001),
        (CROSS, "roll", 0.077, 0.0),
        (CHEBYSHEV, "pitch", 0.066, 0.285),
    ):
        run = simulated_step(law, angle)
        want = step_response(law, angle, time_s=run.time_s)
        np.testing.assert_allclose(run.errors, want.errors, atol=2e-3)
        assert run.settled_s() == pytest.approx(settled, abs=1e-3)
        assert want.settled_s() == pytest.approx(settled, abs=6e-4)
        assert want.undershoot == pytest.approx(undershoot, abs=6e-4)
    assert step_response(CROSS, "pitch").leak("roll") == pytest.approx(0.097, abs=5e-4)
    assert step_response(CROSS, "pitch", form="rotation").leak("roll") < 0.07


# ---------------------------------------------------------------------------- noise


def test_noise_gains_of_the_published_tuning():
    found = noise_gain(CROSS)
    np.testing.assert_allclose(found.gyro, [0.01219, 0.01116, 0.01116], atol=5e-6)
    np.testing.assert_allclose(noise_gain(Positional(K)).gyro, 1.0 / (2.0 * K))
    np.testing.assert_allclose(noise_gain(Positional(K)).measured, K / 2.0)
    # the printed 1.548e-6 from 0.1: at 1.39 ms; from (0.1 deg/s)² at 100 Hz: 1.12e-6 continuous
    assert found.variance("heading", 0.1, 1.387e-3) == pytest.approx(1.548e-6, rel=2e-3)


@pytest.mark.parametrize("form", ["elements", "rotation"])
@pytest.mark.parametrize("law", [CROSS, Positional(K), CHEBYSHEV], ids=str)
def test_noise_of_the_running_law_is_the_lyapunov_solution(law, form):
    # 300 000 samples: 3 sigma of a sampled variance is below 1.6 % at a correlation time of 2.3 samples
    dt_s, count = 0.01, 300_000
    gyro_sd, angle_sd = math.radians(0.1), math.radians(0.05)
    want = noise_gain(law, form=form, dt_s=dt_s)
    found = simulated_noise(law, gyro_sd, "gyro", dt_s, count, 2021, form)
    np.testing.assert_allclose(found, want.gyro * gyro_sd**2 * dt_s, rtol=0.02)
    found = simulated_noise(law, angle_sd, "measured", dt_s, count, 2022, form)
    np.testing.assert_allclose(found, want.measured * angle_sd**2 * dt_s, rtol=0.02)


def test_sampled_noise_gain_tends_to_the_continuous_one():
    for law in (CROSS, CHEBYSHEV, Positional((10.0, 20.0, 70.0))):
        np.testing.assert_allclose(noise_gain(law, dt_s=1e-5).gyro, noise_gain(law).gyro, rtol=3e-3)
        np.testing.assert_allclose(noise_gain(law, dt_s=1e-5).measured, noise_gain(law).measured, rtol=3e-3)
    # at 100 Hz sampling takes a third off for the published gains
    assert noise_gain(Positional(K), dt_s=0.01).gyro[0] == pytest.approx(0.00739, abs=1e-5)


# ---------------------------------------------------------------------------- tuning


def test_prototypes_and_what_they_give():
    chebyshev = tuning.chebyshev_integral(10.0)
    assert chebyshev.law.k / W0 == pytest.approx(1.0977, abs=5e-5)
    assert chebyshev.law.k_int / W0**2 == pytest.approx(1.1025, abs=5e-5)
    assert chebyshev.reached  # the poles are right, the response is not
    ripple = 20 * math.log10(abs(1.1025 / complex(0.1025, 1.0977)))  # all-pole prototype at its edge: -1 dB
    assert ripple == pytest.approx(0.0, abs=0.01)
    assert chebyshev.responses[0].corner_hz == pytest.approx(19.3, abs=0.1)
    butterworth = tuning.butterworth_integral(10.0)
    np.testing.assert_allclose(np.abs(butterworth.poles), W0)
    cubic = tuning.butterworth_cross(10.0)
    assert cubic.law.k == pytest.approx(41.89, abs=0.005)
    assert cubic.law.n == pytest.approx(51.3, abs=0.005)
    assert not cubic.reached
    assert not cubic.stability.stable
    wanted = np.poly(cubic.wanted_poles).real
    np.testing.assert_allclose(wanted, [1.0, 125.66, 7895.7, 248050.0], rtol=1e-4)
    np.testing.assert_allclose(characteristic_polynomial(cubic.law)[:3], wanted[:3])
    first = tuning.positional(10.0)
    assert first.reached
    assert all(r.corner_hz == pytest.approx(10.0) for r in first.responses)


def test_corner_of_the_cross_law_at_the_published_ratio():
    pitch, roll = tuning.cross(10.0), tuning.cross(10.0, "roll")
    assert (pitch.law.k, pitch.law.n) == (pytest.approx(54.1, abs=0.05), pytest.approx(16.8, abs=0.05))
    assert (roll.law.k, roll.law.n) == (pytest.approx(64.9, abs=0.05), pytest.approx(20.2, abs=0.05))
    assert response(roll.law, "roll").corner_hz == pytest.approx(10.0)


def test_schuler_tuning_has_its_period():
    undamped = tuning.schuler()
    assert undamped.law.k == 0.0
    assert 2.0 * math.pi / math.sqrt(undamped.law.k_int) / 60.0 == pytest.approx(84.4, abs=0.05)
    assert undamped.reached
    assert "not damped" in undamped.stability.verdict
    assert undamped.responses[0].peak[0] == math.inf
    damped = tuning.schuler(0.7)
    assert damped.reached
    assert damped.stability.stable


def test_tunings_tell_what_they_are():
    for one in (
        tuning.positional(5.0),
        tuning.chebyshev_integral(10.0),
        tuning.butterworth_cross(10.0),
        tuning.schuler(),
    ):
        assert "-3 dB" in one.table()
        json.dumps(one.to_dict(), allow_nan=False)
    for bad in (0.0, -1.0, float("nan"), float("inf")):
        for make in (tuning.positional, tuning.chebyshev_integral, tuning.butterworth_cross, tuning.cross):
            with pytest.raises(ConfigError):
                make(bad)
    with pytest.raises(ConfigError):
        tuning.cross(10.0, ratio=1.0)
    with pytest.raises(ConfigError):
        tuning.schuler(-0.1)


def test_what_cannot_be_analysed_is_refused():
    with pytest.raises(ConfigError):
        response(CROSS, "yaw")
    with pytest.raises(ConfigError):
        response(CROSS, dt_s=0.0)
    with pytest.raises(ConfigError):
        noise_gain(Cross(1.0, 2.0))
    with pytest.raises(ConfigError):
        stability(CROSS, [[np.nan, 0.0, 0.0]])
    with pytest.raises(ConfigError):
        step_response(CROSS, time_s=[0.0, 1.0, 3.0])
    with pytest.raises(ConfigError):
        noise_gain(CROSS).variance("roll", 1.0)


# ---------------------------------------------------------------------------- figures


def test_figures_show_what_they_are_given(tmp_path):
    named = {
        "X pitch": response(CROSS),
        "P": response(Positional(K)),
        "PI gyro": response(CHEBYSHEV, reading="gyro"),
    }
    points = {"P": ([5.0, 10.0], response(Positional(K)).at([5.0, 10.0]))}
    bode = figures.bode(named, points=points)
    labels = bode.axes[0].get_legend_handles_labels()[1]
    assert labels == list(named)
    corner = [line for line in bode.axes[0].lines if line.get_marker() == "o"]
    assert corner[0].get_xdata()[0] == pytest.approx(7.906, abs=1e-3)
    assert float(corner[0].get_ydata()[0]) == pytest.approx(-3.01, abs=0.01)
    surface = figures.stability_map({"n below k": CROSS, "n above k": Cross(K, 1.05 * K)}, points=21)
    assert "worst -29.5" in surface.axes[0].get_title()
    step = figures.steps({"X": step_response(CROSS), "P": step_response(Positional(K))})
    for name, figure in (("bode", bode), ("map", surface), ("steps", step)):
        assert plots.save(figure, tmp_path / f"{name}.png").stat().st_size > 10_000
