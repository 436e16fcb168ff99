//! The published attitude laws: against their differential equations, on the whole circle, at high rates, under abuse.

use approx::assert_abs_diff_eq;
use gnssins::ahrs::dcm::{Dcm, Form, Law, nearest_rotation};
use gnssins::ahrs::measured::{References, angles, levelled, triad};
use gnssins::ahrs::{AhrsSample, AhrsStatus, AttitudeEstimator, axes, dcm, euler, quaternion};
use gnssins::attitude::{exp, from_dcm, from_euler, log, skew, to_euler};
use gnssins::error::Error;
use gnssins::frames::wrap_pi;
use nalgebra::{Matrix3, Matrix4, Quaternion, UnitQuaternion, Vector3, Vector4};
use proptest::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI};

const G: f64 = 9.806_65;
const K: f64 = 42.8;
const N: f64 = 13.3;
const CROSS: Law = Law::Cross { k: K, n: N };

/// Field of 50 µT, 65° down, and a declination.
fn field(declination: f64) -> Vector3<f64> {
    let (dip, f) = (65f64.to_radians(), 50.0);
    Vector3::new(dip.cos() * declination.cos(), dip.cos() * declination.sin(), dip.sin()) * f
}

/// What ideal sensors show at an attitude.
fn sample(q: &UnitQuaternion<f64>, gyro: Vector3<f64>, declination: f64) -> AhrsSample {
    let back = q.inverse();
    AhrsSample { gyro, accel: back * Vector3::new(0.0, 0.0, -G), mag: Some(back * field(declination)) }
}

fn estimator(law: Law, form: Form, start: &UnitQuaternion<f64>) -> Dcm {
    let initial_q_nb = Some([start.w, start.i, start.j, start.k]);
    Dcm::new(&dcm::Settings { law, form, initial_q_nb, ..Default::default() }).unwrap()
}

fn grid() -> impl Iterator<Item = Vector3<f64>> {
    let axis = [-100.0, -37.0, 0.0, 61.0, 100.0];
    axis.into_iter().flat_map(move |x| {
        axis.into_iter().flat_map(move |y| axis.into_iter().map(move |z| Vector3::new(x, y, z)))
    })
}

#[test]
fn publication_axes_give_the_matrix_printed_there() {
    // worked by hand from R2(psi) R3(theta) R1(gamma) with psi = -heading
    let (roll, pitch, heading) = (0.3_f64, -0.4_f64, 1.1_f64);
    let c = axes::dcm_to_publication(&gnssins::attitude::dcm(&from_euler(roll, pitch, heading)));
    let (psi, th, ga) = (-heading, pitch, roll);
    let want = Matrix3::new(
        psi.cos() * th.cos(),
        -ga.cos() * psi.cos() * th.sin() + ga.sin() * psi.sin(),
        ga.sin() * psi.cos() * th.sin() + ga.cos() * psi.sin(),
        th.sin(),
        ga.cos() * th.cos(),
        -th.cos() * ga.sin(),
        -th.cos() * psi.sin(),
        psi.sin() * th.sin() * ga.cos() + ga.sin() * psi.cos(),
        -ga.sin() * psi.sin() * th.sin() + ga.cos() * psi.cos(),
    );
    assert_abs_diff_eq!(c, want, epsilon = 1e-15);
    assert_abs_diff_eq!(c.determinant(), 1.0, epsilon = 1e-15);
    assert_abs_diff_eq!(
        axes::dcm_from_publication(&c),
        gnssins::attitude::dcm(&from_euler(roll, pitch, heading)),
        epsilon = 1e-15
    );
    // the quaternion turns with it: l0..l3 of section "initial quaternion", half angles
    let q = axes::quaternion_to_publication(&from_euler(roll, pitch, heading));
    let ((sp, cp), (st, ct), (sg, cg)) = ((psi / 2.0).sin_cos(), (th / 2.0).sin_cos(), (ga / 2.0).sin_cos());
    let l = [
        cp * ct * cg - sp * st * sg,
        cp * ct * sg + sp * st * cg,
        sp * ct * cg + cp * st * sg,
        cp * st * cg - sp * ct * sg,
    ];
    for (got, want) in [q.w, q.i, q.j, q.k].into_iter().zip(l) {
        assert_abs_diff_eq!(got, want, epsilon = 1e-15);
    }
}

#[test]
fn measured_attitude_covers_the_full_circle_with_declination() {
    let declination = 0.21;
    for roll in [-3.0, -1.2, 0.0, 0.7, 2.9] {
        for pitch in [-1.5, -0.6, 0.0, 1.1] {
            for heading in [-3.1, -1.9, -0.4, 0.0, 1.5, 1.7, 3.0] {
                let q = from_euler(roll, pitch, heading);
                let s = sample(&q, Vector3::zeros(), declination);
                let c = triad(&s.accel, &s.mag.unwrap(), declination).unwrap();
                assert!(from_dcm(&c).angle_to(&q) < 3e-8, "{roll} {pitch} {heading}");
                let (r, p, h) = angles(&s.accel, &s.mag.unwrap(), declination);
                assert_abs_diff_eq!(r, roll, epsilon = 1e-12);
                assert_abs_diff_eq!(p, pitch, epsilon = 1e-12);
                assert_abs_diff_eq!(wrap_pi(h - heading), 0.0, epsilon = 1e-12);
            }
        }
    }
}

#[test]
fn measured_attitude_needs_no_angles_when_the_nose_points_up_or_down() {
    for pitch in [FRAC_PI_2, -FRAC_PI_2, FRAC_PI_2 - 1e-9] {
        for heading in [-2.0, 0.0, 0.5, 3.0] {
            let q = from_euler(0.0, pitch, heading);
            let s = sample(&q, Vector3::zeros(), 0.0);
            let c = triad(&s.accel, &s.mag.unwrap(), 0.0).unwrap();
            assert!(from_dcm(&c).angle_to(&q) < 3e-8, "{pitch} {heading}");
        }
    }
    // a vertical field has no north; zero and infinite vectors have no direction
    let (up, down) = (Vector3::new(0.0, 0.0, -G), Vector3::new(0.0, 0.0, 50.0));
    assert!(triad(&up, &down, 0.0).is_none());
    assert!(triad(&Vector3::zeros(), &Vector3::x(), 0.0).is_none());
    assert!(triad(&up, &Vector3::new(f64::INFINITY, 0.0, 0.0), 0.0).is_none());
    // magnitudes at the ends of the range still have one
    assert!(triad(&(up * 1e300), &Vector3::new(1e-300, 0.0, 1e-300), 0.0).is_some());
}

#[test]
fn levelling_keeps_the_predicted_heading() {
    for (pitch, heading) in [(0.2, 1.0), (-1.3, -2.5), (1.5, 0.3)] {
        let predicted = from_euler(0.4, pitch, heading);
        let true_q = from_euler(0.38, pitch + 0.01, heading);
        let down = true_q.inverse() * Vector3::z();
        let c = levelled(&down, &gnssins::attitude::dcm(&predicted));
        assert_abs_diff_eq!(c.transpose() * Vector3::z(), down, epsilon = 1e-14);
        assert_abs_diff_eq!(c * c.transpose(), Matrix3::identity(), epsilon = 1e-14);
        // the correction is a tilt: it has nothing about the vertical, to first order
        let turn = log(&(from_dcm(&c) * predicted.inverse()));
        assert!(turn.z.abs() < 4e-4 * (1.0 + pitch.tan().abs()), "{turn}");
    }
    // upside down and at right angles to the prediction there is still a level attitude
    for down in [Vector3::x(), -Vector3::x(), -Vector3::z(), Vector3::y()] {
        let c = levelled(&down, &Matrix3::identity());
        assert_abs_diff_eq!(c.determinant(), 1.0, epsilon = 1e-14);
    }
}

#[test]
fn disturbed_and_missing_references_are_flagged_and_the_gyro_goes_alone() {
    let references = References {
        accel_tolerance: Some(0.05),
        field: 50.0,
        field_tolerance: Some(0.1),
        dip_rad: 65f64.to_radians(),
        dip_tolerance_rad: Some(0.1),
        ..Default::default()
    };
    let settings = dcm::Settings { references, law: CROSS, ..Default::default() };
    let q = from_euler(0.1, 0.2, 0.3);
    let start = {
        let mut e = Dcm::new(&settings).unwrap();
        assert_eq!(e.step(0.0, &sample(&q, Vector3::zeros(), 0.0)).unwrap(), {
            AhrsStatus::ACCEL_USED.with(AhrsStatus::MAG_USED).with(AhrsStatus::ALIGNED)
        });
        e
    };
    let rate = Vector3::new(0.5, -1.0, 2.0);
    let good = sample(&(q * exp(&(rate * 0.01))), rate, 0.0);
    let alone = q * exp(&(rate * 0.01));
    let cases = [
        (AhrsSample { accel: good.accel * 1.2, ..good }, AhrsStatus::ACCEL_DISTURBED),
        (AhrsSample { accel: Vector3::repeat(f64::NAN), ..good }, AhrsStatus::ACCEL_BAD),
        (AhrsSample { accel: Vector3::zeros(), mag: None, ..good }, {
            AhrsStatus::ACCEL_BAD.with(AhrsStatus::MAG_BAD)
        }),
    ];
    for (s, want) in cases {
        let mut e = start;
        assert_eq!(e.step(0.01, &s).unwrap(), want);
        assert!(e.q_nb().angle_to(&alone) < 3e-8);
    }
    for (mag, want) in [
        (good.mag.map(|m| m * 1.2), AhrsStatus::MAG_DISTURBED),
        (Some(good.accel * -5.1), AhrsStatus::MAG_DISTURBED), // vertical: the dip is wrong
        (Some(Vector3::new(f64::NAN, 0.0, 0.0)), AhrsStatus::MAG_BAD),
        (None, AhrsStatus::MAG_BAD),
    ] {
        // GIVEN a heading error WHEN only the field fails THEN the tilt is corrected and the heading is the gyro's
        let mut e = start;
        let turned = from_euler(0.0, 0.0, 0.2);
        let s = AhrsSample { mag, ..sample(&(turned * alone), rate, 0.0) };
        assert_eq!(e.step(0.01, &s).unwrap(), AhrsStatus::ACCEL_USED.with(want));
        assert!(e.q_nb().angle_to(&alone) < 3e-8);
    }
}

#[test]
fn bad_intervals_and_rates_are_refused_and_leave_the_state() {
    let q = from_euler(0.1, 0.2, 0.3);
    let good = sample(&q, Vector3::new(0.1, 0.0, 0.0), 0.0);
    let all: [&mut dyn AttitudeEstimator; 3] = [
        &mut Dcm::new(&dcm::Settings::default()).unwrap(),
        &mut quaternion::Corrected::new(&quaternion::Settings::default()).unwrap(),
        &mut euler::Euler::new(&euler::Settings::default()).unwrap(),
    ];
    for e in all {
        let nothing = AhrsSample { accel: Vector3::zeros(), ..good };
        assert!(e.step(0.01, &nothing).unwrap().has(AhrsStatus::UNALIGNED));
        assert_eq!(e.q_nb(), UnitQuaternion::identity());
        e.step(0.0, &good).unwrap();
        let before = e.q_nb();
        assert_eq!(e.step(0.0, &good).unwrap(), AhrsStatus::SKIPPED);
        for dt in [-0.01, f64::NAN, f64::INFINITY] {
            assert!(matches!(e.step(dt, &good), Err(Error::Config { what: "dt_s", .. })));
        }
        for x in [f64::NAN, f64::NEG_INFINITY, 1e7] {
            let bad = AhrsSample { gyro: Vector3::new(0.0, x, 0.0), ..good };
            assert!(matches!(e.step(0.01, &bad), Err(Error::NonFinite { .. })));
        }
        assert_eq!(e.q_nb(), before);
    }
}

#[test]
fn settings_without_meaning_are_refused() {
    let with = |law| Dcm::new(&dcm::Settings { law, ..Default::default() }).map(|_| ());
    assert!(with(Law::Cross { k: 42.8, n: -42.8 }).is_ok());
    for law in [
        Law::Cross { k: 41.89, n: 51.3 },
        Law::Cross { k: 10.0, n: -10.1 },
        Law::Positional { k: [1.0, -1.0, 1.0] },
        Law::Integral { k: f64::NAN, k_int: 1.0 },
        Law::Integral { k: 1.0, k_int: f64::INFINITY },
    ] {
        let error = with(law).unwrap_err();
        assert!(matches!(error, Error::Config { .. }), "{law:?}");
    }
    let quaternion = |k, n| quaternion::Corrected::new(&quaternion::Settings { k, n, ..Default::default() });
    assert!(quaternion(10.0, 9.0).is_ok() && quaternion(10.0, -4.9).is_ok());
    assert!(quaternion(10.0, 10.1).is_err() && quaternion(10.0, -5.1).is_err());
    let euler = |latitude_rad| euler::Euler::new(&euler::Settings { latitude_rad, ..Default::default() });
    assert!(euler(Some(1.0)).is_ok() && euler(Some(1.571)).is_err() && euler(Some(f64::NAN)).is_err());
    let start = |q| Dcm::new(&dcm::Settings { initial_q_nb: Some(q), ..Default::default() });
    assert!(start([1.0, 0.0, 0.0, 0.0]).is_ok() && start([0.0; 4]).is_err() && start([f64::NAN; 4]).is_err());
    for rate_n in [[f64::NAN, 0.0, 0.0], [0.0, 1e7, 0.0]] {
        assert!(Dcm::new(&dcm::Settings { rate_n, ..Default::default() }).is_err());
    }
    let bad = References { gravity_m_s2: 0.0, ..Default::default() };
    assert!(Dcm::new(&dcm::Settings { references: bad, ..Default::default() }).is_err());
}

/// Runge-Kutta of a differential equation in matrices of any kind.
fn integrate<T>(mut y: T, dt: f64, steps: u32, f: impl Fn(f64, &T) -> T) -> T
where
    T: Clone + std::ops::Add<T, Output = T> + std::ops::Mul<f64, Output = T>,
{
    let h = dt / f64::from(steps);
    for i in 0..steps {
        let t = f64::from(i) * h;
        let k1 = f(t, &y);
        let k2 = f(t + 0.5 * h, &(y.clone() + k1.clone() * (0.5 * h)));
        let k3 = f(t + 0.5 * h, &(y.clone() + k2.clone() * (0.5 * h)));
        let k4 = f(t + h, &(y.clone() + k3.clone() * h));
        y = y + (k1 + (k2 + k3) * 2.0 + k4) * (h / 6.0);
    }
    y
}

#[test]
fn step_solves_the_published_equation_of_every_law() {
    // C' = C [w x] - (C - C_k) K^T - X, X' = k_n (C - C_k), with C_k turning with the body, all in their axes
    let rate = Vector3::new(35.0, -60.0, 80.0);
    let (q0, dt) = (from_euler(0.2, -0.3, 2.0), 0.01);
    let wrong = from_euler(-0.1, 0.25, 2.4);
    let w = axes::to_publication(&rate);
    let measured = |t: f64| axes::dcm_to_publication(&gnssins::attitude::dcm(&(q0 * exp(&(rate * t)))));
    for law in [
        Law::Positional { k: [K; 3] },
        Law::Positional { k: [10.0, 40.0, 90.0] },
        Law::Integral { k: 69.0, k_int: 4342.0 },
        CROSS,
        Law::Cross { k: 30.0, n: -29.0 },
    ] {
        let mut e = estimator(law, Form::Elements, &wrong);
        let k_int = if let Law::Integral { k_int, .. } = law { k_int } else { 0.0 };
        let (mut c, mut x) = (e.elements(), Matrix3::zeros());
        for step in 0..3 {
            let t0 = f64::from(step) * dt;
            let y = integrate(nalgebra::Matrix6x3::zeros() + stack(&c, &x), dt, 400, |t, y| {
                let (c, x) = unstack(y);
                let error = c - measured(t0 + t);
                stack(&(c * skew(&w) - error * law.matrix().transpose() - x), &(error * k_int))
            });
            (c, x) = unstack(&y);
            e.step(dt, &sample(&(q0 * exp(&(rate * (t0 + dt)))), rate, 0.0)).unwrap();
            assert_abs_diff_eq!(e.elements(), c, epsilon = 2e-11);
        }
    }
}

fn stack(c: &Matrix3<f64>, x: &Matrix3<f64>) -> nalgebra::Matrix6x3<f64> {
    let mut y = nalgebra::Matrix6x3::zeros();
    y.fixed_view_mut::<3, 3>(0, 0).copy_from(c);
    y.fixed_view_mut::<3, 3>(3, 0).copy_from(x);
    y
}

fn unstack(y: &nalgebra::Matrix6x3<f64>) -> (Matrix3<f64>, Matrix3<f64>) {
    (y.fixed_view::<3, 3>(0, 0).into_owned(), y.fixed_view::<3, 3>(3, 0).into_owned())
}

#[test]
fn step_solves_the_quaternion_equation() {
    let rate = Vector3::new(35.0, -60.0, 80.0);
    let (q0, wrong, dt) = (from_euler(0.2, -0.3, 2.0), from_euler(0.1, -0.2, 2.1), 0.01);
    let four = |q: &UnitQuaternion<f64>| {
        let p = axes::quaternion_to_publication(q);
        Vector4::new(p.w, p.i, p.j, p.k)
    };
    let (k, n) = (40.0, -15.0);
    let k4 = Matrix4::new(k, n, n, n, -n, k, n, n, -n, n, k, n, -n, n, n, k);
    let w = axes::to_publication(&rate);
    let end = integrate(four(&wrong), dt, 400, |t, l| {
        let product = Quaternion::new(l[0], l[1], l[2], l[3]) * Quaternion::from_imag(w) * 0.5;
        let error = l - four(&(q0 * exp(&(rate * t))));
        Vector4::new(product.w, product.i, product.j, product.k) - k4 * error
    });
    let initial_q_nb = Some([wrong.w, wrong.i, wrong.j, wrong.k]);
    let settings = quaternion::Settings { k, n, initial_q_nb, ..Default::default() };
    let mut e = quaternion::Corrected::new(&settings).unwrap();
    e.step(dt, &sample(&(q0 * exp(&(rate * dt))), rate, 0.0)).unwrap();
    assert_abs_diff_eq!(four(&e.q_nb()), end / end.norm(), epsilon = 1e-11);
}

#[test]
fn cross_law_decays_at_least_at_k_minus_n_on_the_grid_of_body_rates() {
    // |e| of every row, sampled at 100 Hz with body rates up to 100 rad/s per axis: exp(-(k-|n|)T) bounds every step
    let (dt, bound) = (0.01, K - N);
    let mut slowest: f64 = 0.0;
    for rate in grid() {
        let q0 = from_euler(0.3, 0.2, -1.0);
        let mut e = estimator(CROSS, Form::Elements, &from_euler(0.35, 0.1, -1.2));
        let mut before = deviation(&e, &q0);
        for step in 1..=20 {
            let q = q0 * exp(&(rate * (f64::from(step) * dt)));
            e.step(dt, &sample(&q, rate, 0.0)).unwrap();
            let now = deviation(&e, &q);
            for row in 0..3 {
                let ratio = now.row(row).norm() / before.row(row).norm();
                assert!(ratio <= (-bound * dt).exp() * (1.0 + 1e-9), "{rate} {step} {ratio}");
                slowest = slowest.max(ratio);
            }
            before = now;
        }
    }
    // and the bound is met: at rest the eigenvalue is n - k itself
    assert!(slowest > 0.999 * (-bound * dt).exp(), "{slowest}");
}

/// Elements less the true ones, their axes.
fn deviation(e: &Dcm, truth: &UnitQuaternion<f64>) -> Matrix3<f64> {
    e.elements() - axes::dcm_to_publication(&gnssins::attitude::dcm(truth))
}

#[test]
fn integral_law_never_gains_energy_at_any_rate() {
    // V = |e|² + |x|²/k_n never grows; x(0) = 0, so that |e|² <= V(0) = |e(0)|² throughout, and e goes to zero
    let (k, k_int) = (20.0, 300.0);
    for rate in grid() {
        let q0 = from_euler(0.3, 0.2, -1.0);
        let mut e = estimator(Law::Integral { k, k_int }, Form::Elements, &from_euler(0.35, 0.1, -1.2));
        let start = deviation(&e, &q0).norm();
        for step in 1..=3000 {
            let q = q0 * exp(&(rate * (f64::from(step) * 0.01)));
            e.step(0.01, &sample(&q, rate, 0.0)).unwrap();
            assert!(deviation(&e, &q).norm() <= start * (1.0 + 1e-9), "{rate} {step}");
        }
        let left = deviation(&e, &(q0 * exp(&(rate * 30.0)))).norm();
        assert!(left < 0.02 * start, "{rate} {left}");
    }
}

#[test]
fn every_law_holds_100_rad_s_at_100_hz_where_explicit_euler_fails() {
    let dt = 0.01;
    let rate = Vector3::new(60.0, -56.0, 57.0); // 100 rad/s
    let q0 = from_euler(0.1, -0.2, 0.3);
    let start = from_euler(0.4, 0.1, 0.0);
    let initial_q_nb = Some([start.w, start.i, start.j, start.k]);
    let quaternion = quaternion::Settings { k: K, n: N, initial_q_nb, ..Default::default() };
    let euler = euler::Settings { k: K, k_heading: K, initial_q_nb, ..Default::default() };
    let all: [&mut dyn AttitudeEstimator; 7] = [
        &mut estimator(Law::Positional { k: [K; 3] }, Form::Rotation, &start),
        &mut estimator(Law::Integral { k: K, k_int: 100.0 }, Form::Rotation, &start),
        &mut estimator(CROSS, Form::Rotation, &start),
        &mut estimator(Law::Positional { k: [K; 3] }, Form::Elements, &start),
        &mut estimator(CROSS, Form::Elements, &start),
        &mut quaternion::Corrected::new(&quaternion).unwrap(),
        &mut euler::Euler::new(&euler).unwrap(),
    ];
    for (i, e) in all.into_iter().enumerate() {
        for step in 1..=500 {
            let q = q0 * exp(&(rate * (f64::from(step) * dt)));
            e.step(dt, &sample(&q, rate, 0.0)).unwrap();
            let found = e.q_nb();
            assert!((found.as_ref().norm() - 1.0).abs() < 1e-14);
            if step > 400 {
                let limit = if i == 1 { 3e-3 } else { 1e-6 }; // the integral law is slow at rate
                assert!(found.angle_to(&q) < limit, "estimator {i}, step {step}: {}", found.angle_to(&q));
            }
        }
    }
    // explicit Euler of the same law: |1 - kT + j w T| passes one at 82 rad/s
    let limit = (1.0 - (1.0 - K * dt).powi(2)).sqrt() / dt;
    assert!((limit - 82.0).abs() < 0.1);
    for (w, grows) in [(0.98 * limit, false), (1.02 * limit, true)] {
        let mut e = Vector3::new(1.0, 0.5, 0.2);
        for _ in 0..2000 {
            e += (-skew(&Vector3::new(0.0, 0.0, w)) * e - e * K) * dt;
        }
        assert_eq!(e.norm() > 1.0, grows, "{w} {}", e.norm());
    }
}

#[test]
fn rotation_form_halves_the_cross_coupling_and_changes_nothing_for_equal_gains() {
    // small rotation error δ in their body axes: δ' = -(tr K I - K') δ / 2
    for law in [CROSS, Law::Positional { k: [K; 3] }, Law::Positional { k: [10.0, 40.0, 90.0] }] {
        let k = law.matrix();
        let effective = 0.5 * (Matrix3::identity() * k.trace() - k.transpose());
        let q = from_euler(0.4, -0.2, 1.0);
        let small = Vector3::new(1e-5, -2e-5, 3e-5);
        let mut e = estimator(law, Form::Rotation, &(q * exp(&axes::from_publication(&small))));
        for _ in 0..50 {
            e.step(2e-4, &sample(&q, Vector3::zeros(), 0.0)).unwrap();
        }
        let left = axes::to_publication(&log(&(q.inverse() * e.q_nb())));
        let want = gnssins::ahrs::expm::expm(&(-effective * 0.01)) * small;
        assert!((left - want).norm() < 2e-3 * small.norm(), "{law:?} {left} {want}");
    }
}

#[test]
fn a_law_beyond_its_bound_is_destabilised_by_some_rate() {
    // n = 1.05 k: c = k³ + k n² - 2 n³ + ... < 0 at rest already
    let law = Law::Cross { k: 10.0, n: 10.5 };
    let settings = dcm::Settings { law, form: Form::Elements, allow_unstable: true, ..Default::default() };
    let q = from_euler(0.0, 0.0, 0.0);
    let mut e = Dcm::new(&settings).unwrap();
    e.step(0.0, &sample(&from_euler(0.01, 0.02, 0.03), Vector3::zeros(), 0.0)).unwrap();
    let mut largest: f64 = 0.0;
    for _ in 0..200_000 {
        e.step(0.01, &sample(&q, Vector3::zeros(), 0.0)).unwrap();
        largest = largest.max((e.elements() - Matrix3::identity()).norm());
        assert!(e.q_nb().as_ref().norm() - 1.0 < 1e-9); // a rotation even so
    }
    assert!(largest > 1.0, "{largest}");
}

#[test]
fn nearest_rotation_is_the_polar_factor() {
    let c = gnssins::attitude::dcm(&from_euler(1.0, -0.5, 2.0));
    for noise in [0.0, 1e-6, 0.1, 0.6] {
        let m = c + Matrix3::new(0.3, -0.8, 0.2, 0.5, 0.1, -0.9, 0.4, 0.6, -0.7) * noise;
        let svd = m.svd(true, true);
        let want = svd.u.unwrap() * svd.v_t.unwrap();
        let got = nearest_rotation(&m).unwrap();
        assert_abs_diff_eq!(got, want, epsilon = 1e-12);
        assert_abs_diff_eq!(got * got.transpose(), Matrix3::identity(), epsilon = 1e-14);
    }
    assert!(nearest_rotation(&Matrix3::zeros()).is_none());
    assert!(nearest_rotation(&-Matrix3::identity()).is_none());
    assert!(nearest_rotation(&Matrix3::from_element(f64::NAN)).is_none());
}

#[test]
fn laws_come_back_from_any_attitude() {
    let q = from_euler(0.2, 0.3, -2.0);
    for axis in [Vector3::x(), Vector3::new(0.6, 0.0, 0.8), Vector3::new(-0.48, 0.6, 0.64)] {
        for angle in [0.5, 2.0, 3.1, PI] {
            let start = q * exp(&(axis * angle));
            for form in [Form::Rotation, Form::Elements] {
                for law in [CROSS, Law::Positional { k: [K; 3] }, Law::Integral { k: 20.0, k_int: 100.0 }] {
                    let mut e = estimator(law, form, &start);
                    for _ in 0..600 {
                        e.step(0.01, &sample(&q, Vector3::zeros(), 0.0)).unwrap();
                    }
                    assert!(e.q_nb().angle_to(&q) < 1e-4, "{law:?} {form:?} {angle} {axis}");
                }
            }
        }
    }
}

#[test]
fn rate_of_the_navigation_axes_is_taken_off() {
    // a body at rest on the turning Earth, exaggerated: the gyro shows the Earth's turn and nothing moves
    let rate_n = [0.02, 0.0, -0.03];
    let q = from_euler(0.3, -0.4, 1.0);
    let gyro = q.inverse() * Vector3::from(rate_n);
    let initial_q_nb = Some([q.w, q.i, q.j, q.k]);
    let silent = AhrsSample { gyro, accel: Vector3::zeros(), mag: None };
    let all: [&mut dyn AttitudeEstimator; 3] = [
        &mut Dcm::new(&dcm::Settings { rate_n, initial_q_nb, ..Default::default() }).unwrap(),
        &mut quaternion::Corrected::new(&quaternion::Settings { rate_n, initial_q_nb, ..Default::default() })
            .unwrap(),
        &mut euler::Euler::new(&euler::Settings { rate_n, initial_q_nb, ..Default::default() }).unwrap(),
    ];
    for e in all {
        for _ in 0..1000 {
            e.step(0.1, &silent).unwrap();
        }
        assert!(e.q_nb().angle_to(&q) < 2e-7, "{}", e.q_nb().angle_to(&q));
    }
}

#[test]
fn euler_kinematics_equal_the_rotation_and_bridge_the_vertical() {
    let settings = |q: &UnitQuaternion<f64>| euler::Settings {
        k: 0.0,
        initial_q_nb: Some([q.w, q.i, q.j, q.k]),
        ..Default::default()
    };
    // a body that spins about its long axis at 100 rad/s while it swings
    let mut q = from_euler(0.0, 0.3, 0.5);
    let mut e = euler::Euler::new(&settings(&q)).unwrap();
    for step in 0..200 {
        let rate = Vector3::new(100.0, 2.0 * (f64::from(step) * 0.05).cos(), 1.0);
        q *= exp(&(rate * 0.01));
        let s = AhrsSample { gyro: rate, accel: Vector3::zeros(), mag: None };
        let status = e.step(0.01, &s).unwrap();
        assert!(!status.has(AhrsStatus::GIMBAL));
        assert!(e.q_nb().angle_to(&q) < 1e-6, "{step} {}", e.q_nb().angle_to(&q));
    }
    // a loop through both verticals
    let mut q = from_euler(0.0, 0.0, 0.4);
    let mut e = euler::Euler::new(&settings(&q)).unwrap();
    let mut bridged = 0;
    for _ in 0..700 {
        let rate = Vector3::new(0.0, 1.0, 0.0);
        q *= exp(&(rate * 0.01));
        let s = AhrsSample { gyro: rate, accel: Vector3::zeros(), mag: None };
        bridged += u32::from(e.step(0.01, &s).unwrap().has(AhrsStatus::GIMBAL));
        assert!(e.q_nb().angle_to(&q) < 1e-6);
    }
    assert!(bridged > 20 && bridged < 70, "{bridged}");
}

#[test]
fn euler_levelling_is_stable_in_tilt_and_neutral_in_heading() {
    let k = 0.5;
    let truth = from_euler(0.02, -0.03, 2.0);
    let start = from_euler(0.07, 0.01, 2.0);
    let settings =
        euler::Settings { k, initial_q_nb: Some([start.w, start.i, start.j, start.k]), ..Default::default() };
    let mut e = euler::Euler::new(&settings).unwrap();
    for _ in 0..200 {
        e.step(0.01, &sample(&truth, Vector3::zeros(), 0.0)).unwrap();
    }
    let (roll, pitch, heading) = to_euler(&e.q_nb());
    let left = (-k * 2.0f64).exp();
    assert!(((roll - 0.02) / 0.05 - left).abs() < 0.01 && ((pitch + 0.03) / 0.04 - left).abs() < 0.01);
    assert!((heading - 2.0).abs() < 2e-3, "{heading}");
    // with a gain for it the heading follows the field over the shorter way
    let mut e = euler::Euler::new(&euler::Settings { k_heading: 1.0, ..settings }).unwrap();
    let far = from_euler(0.02, -0.03, -1.5);
    for _ in 0..2000 {
        e.step(0.01, &sample(&far, Vector3::zeros(), 0.0)).unwrap();
    }
    assert!(e.q_nb().angle_to(&far) < 1e-3);
}

fn hostile() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -200.0..200.0f64,
        1 => prop::sample::select(vec![
            0.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300, 1e-300, f64::MAX, f64::MIN_POSITIVE, 1e5,
        ]),
    ]
}

fn hostile_sample() -> impl Strategy<Value = AhrsSample> {
    let three = || [hostile(), hostile(), hostile()].prop_map(Vector3::from);
    (three(), three(), prop::option::of(three())).prop_map(|(gyro, accel, mag)| AhrsSample {
        gyro,
        accel,
        mag,
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn no_input_gives_anything_but_a_unit_quaternion(
        rows in prop::collection::vec(
            (prop::sample::select(vec![0.0, 1e-300, 1e-9, 0.001, 0.01, 0.3, 100.0, 1e6]), hostile_sample()), 1..40),
        k in prop::sample::select(vec![0.0, 1e-3, 42.8, 1e4, 1e12]),
        n in -1.0..1.0f64,
    ) {
        let law = Law::Cross { k, n: n * k };
        let integral = Law::Integral { k, k_int: n.abs() * k };
        let over = dcm::Settings { law: Law::Cross { k, n: 3.0 * n * k.min(1e3) }, allow_unstable: true, form: Form::Elements, ..Default::default() };
        let all: [&mut dyn AttitudeEstimator; 7] = [
            &mut Dcm::new(&dcm::Settings { law, ..Default::default() }).unwrap(),
            &mut Dcm::new(&dcm::Settings { law, form: Form::Elements, ..Default::default() }).unwrap(),
            &mut Dcm::new(&dcm::Settings { law: integral, ..Default::default() }).unwrap(),
            &mut Dcm::new(&dcm::Settings { law: integral, form: Form::Elements, ..Default::default() }).unwrap(),
            &mut Dcm::new(&over).unwrap(),
            &mut quaternion::Corrected::new(&quaternion::Settings { k, n: 0.5 * n * k, ..Default::default() }).unwrap(),
            &mut euler::Euler::new(&euler::Settings { k, k_int: k * 0.5, k_heading: k, latitude_rad: Some(1.2), ..Default::default() }).unwrap(),
        ];
        for e in all {
            for (dt, s) in &rows {
                let _ = e.step(*dt, s);
                let q = e.q_nb();
                prop_assert!((q.as_ref().norm() - 1.0).abs() < 1e-9, "{q} after {s:?}");
            }
        }
    }
}
