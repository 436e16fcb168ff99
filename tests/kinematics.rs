//! Forms of the attitude equations, three rates, vertical channel: orders, worked numbers, limits.

mod common;

use common::{Rng, bytes, error, filter, fix, fly, restore, solution, turning, weaving};
use gnssins::attitude::{self, dcm, exp, from_dcm, from_euler, log, skew, to_euler};
use gnssins::ekf::Ekf;
use gnssins::error::Error;
use gnssins::imu::{Coning, ImuDelta};
use gnssins::inverse::FreeIns;
use gnssins::nav::ecef::Ecef;
use gnssins::nav::kinematics::{
    AttitudeForm, EULER_PITCH_LIMIT_RAD, TURN_LIMIT_RAD, euler_rates, orthogonalise, orthogonality_error,
    picard_step, poisson_step,
};
use gnssins::nav::ned::Ned;
use gnssins::nav::three_rate::{Divisors, Gather, ThreeRate};
use gnssins::nav::{EarthModel, NavModel, Solution};
use gnssins::vertical::{Vertical, VerticalLoop};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use proptest::prelude::*;

const PLACE: [f64; 3] = [55.0, 30.0, 3000.0];

/// Turn from the exact attitude to that of a form after one step, rad.
fn departure(
    form: AttitudeForm,
    q: &UnitQuaternion<f64>,
    alpha: &Vector3<f64>,
    zeta: &Vector3<f64>,
) -> Vector3<f64> {
    let exact = attitude::renormalise(&(exp(&-zeta) * q * exp(alpha)));
    log(&(exact.inverse() * form.advance(q, alpha, zeta).unwrap()))
}

#[test]
fn one_step_about_a_fixed_axis_misses_by_the_stated_power_of_the_angle() {
    let axis = Vector3::new(0.36, -0.48, 0.8);
    let q = from_euler(0.3, -0.2, 1.0);
    for (form, power, coefficient) in [
        (AttitudeForm::Dcm, 3, 1.0 / 6.0),
        (AttitudeForm::Picard, 3, 1.0 / 24.0),
        (AttitudeForm::TwoQuaternions, 3, 1.0 / 24.0),
        (AttitudeForm::Quaternion, 5, -1.0 / 1920.0),
    ] {
        for angle in [0.02f64, 0.05, 0.1] {
            let miss = departure(form, &q, &(axis * angle), &Vector3::zeros()).dot(&axis);
            let expected = coefficient * angle.powi(power);
            // rounding of a rotation vector, and the next term of the series
            let tolerance = 2e-15 + expected.abs() * angle * angle;
            assert!((miss - expected).abs() < tolerance, "{form:?} {angle}: {miss:e} {expected:e}");
        }
    }
}

#[test]
fn halving_the_step_shows_the_order_of_every_form() {
    // both rotations, no common axis: an interval in one step and in two
    let (alpha, zeta) = (Vector3::new(0.12, -0.2, 0.16), Vector3::new(-0.03, 0.02, 0.05));
    let q = from_euler(0.3, 0.7, -2.0);
    for (form, order) in [
        (AttitudeForm::Euler, 4),
        (AttitudeForm::Dcm, 2),
        (AttitudeForm::Quaternion, 4),
        (AttitudeForm::Picard, 2),
        (AttitudeForm::TwoQuaternions, 2),
    ] {
        let miss = |steps: u32| {
            let share = 1.0 / f64::from(steps);
            let end = (0..steps).fold(q, |q, _| form.advance(&q, &(share * alpha), &(share * zeta)).unwrap());
            let exact = exp(&-zeta) * q * exp(&alpha);
            log(&(exact.inverse() * end)).norm()
        };
        let ratio = miss(4) / miss(8);
        let expected = 2f64.powi(order);
        assert!((ratio / expected - 1.0).abs() < 0.2, "{form:?}: {ratio}");
    }
}

#[test]
fn default_form_is_the_exact_one_to_the_bit() {
    let mut rng = Rng(3);
    for _ in 0..200 {
        let q = exp(&rng.vector(1.5));
        let (alpha, w, dt) = (rng.vector(0.3), rng.vector(1e-4), 0.01);
        let written_out = attitude::renormalise(&(exp(&(-dt * w)) * q * exp(&alpha)));
        let form = AttitudeForm::default().advance(&q, &alpha, &(dt * w)).unwrap();
        assert_eq!(form.coords, written_out.coords);
    }
}

#[test]
fn picard_step_has_the_mixed_signs_of_the_matrix_form_and_grows_by_e2_over_64() {
    let l = Quaternion::new(0.4, -0.6, 0.2, 0.663_324_958_071_08);
    let d = Vector3::new(0.03, -0.05, 0.02);
    let e = d.norm_squared();
    let (l0, l1, l2, l3) = (l.w, l.i, l.j, l.k);
    let by_components = Quaternion::new(
        l0 - l0 * e / 8.0 - 0.5 * (l1 * d.x + l2 * d.y + l3 * d.z),
        l1 - l1 * e / 8.0 + 0.5 * (l0 * d.x - l3 * d.y + l2 * d.z),
        l2 - l2 * e / 8.0 + 0.5 * (l3 * d.x + l0 * d.y - l1 * d.z),
        l3 - l3 * e / 8.0 + 0.5 * (-l2 * d.x + l1 * d.y + l0 * d.z),
    );
    let step = picard_step(&l, &d);
    assert!((step - by_components).norm() < 1e-16);
    let growth = step.norm_squared() / l.norm_squared() - 1.0;
    assert!((growth / (e * e / 64.0) - 1.0).abs() < 1e-6, "{growth:e}");
    // printed with a minus everywhere it is no rotation of the kind: the length shrinks at first order
    let printed = Quaternion::new(
        l0 - l0 * e / 8.0 - 0.5 * (l1 * d.x + l2 * d.y + l3 * d.z),
        l1 - l1 * e / 8.0 - 0.5 * (l0 * d.x + l3 * d.y + l2 * d.z),
        l2 - l2 * e / 8.0 - 0.5 * (l3 * d.x + l0 * d.y + l1 * d.z),
        l3 - l3 * e / 8.0 - 0.5 * (l2 * d.x + l1 * d.y + l0 * d.z),
    );
    assert!((printed.norm_squared() - 1.0).abs() > 1e-3);
}

#[test]
fn euler_rates_are_the_derivatives_of_the_angles() {
    let h = 1e-5;
    for [r, p, y] in [[0.0, 0.0, 0.0], [0.4, -0.9, 2.0], [-2.5, 1.2, -0.7]] {
        let q = from_euler(r, p, y);
        for w in [Vector3::x(), Vector3::y(), Vector3::z()] {
            let at = |t: f64| {
                let (r, p, y) = to_euler(&(q * exp(&(t * w))));
                Vector3::new(r, p, y)
            };
            let difference = (at(h) - at(-h)) / (2.0 * h);
            let rates = euler_rates(r, p, &w).unwrap();
            assert!((difference - rates).norm() < 2e-8, "{w:?}: {difference:?} {rates:?}");
        }
    }
}

#[test]
fn euler_form_refuses_the_vertical_and_no_form_gives_nan() {
    let w = Vector3::new(0.0, 0.02, 0.0);
    let refused = |q: &UnitQuaternion<f64>| {
        let error = AttitudeForm::Euler.advance(q, &w, &Vector3::zeros()).unwrap_err();
        assert_eq!(error.code(), "nav.attitude_form");
        assert!(matches!(error, Error::AttitudeForm { what: "pitch", .. }), "{error:?}");
    };
    for pitch in [EULER_PITCH_LIMIT_RAD - 0.01, 1.5, std::f64::consts::FRAC_PI_2, -1.52] {
        refused(&from_euler(0.1, pitch, 0.3));
    }
    let near = from_euler(0.1, EULER_PITCH_LIMIT_RAD - 0.021, 0.3);
    assert!(departure(AttitudeForm::Euler, &near, &w, &Vector3::zeros()).norm() < 1e-6);
    // a step over the top from far below is refused too: no stage may lie beyond the limit
    let steep = from_euler(0.0, 1.3, 0.0);
    let over = AttitudeForm::Euler.advance(&steep, &Vector3::new(0.0, 0.45, 0.0), &Vector3::zeros());
    assert!(over.is_err());
    for form in AttitudeForm::ALL {
        assert_eq!(AttitudeForm::by_name(form.name()), Some(form));
        let bad = form.advance(&near, &Vector3::new(f64::NAN, 0.0, 0.0), &Vector3::zeros());
        if form == AttitudeForm::RotationVector {
            continue; // the model checks its result
        }
        assert!(matches!(bad, Err(Error::NonFinite { .. })), "{form:?}");
        let fast = form.advance(&near, &Vector3::new(0.0, 0.0, TURN_LIMIT_RAD + 1e-9), &Vector3::zeros());
        assert!(matches!(fast, Err(Error::AttitudeForm { what: "turn within one step", .. })), "{form:?}");
    }
    assert_eq!(AttitudeForm::by_name("poisson"), None);
}

#[test]
fn correction_of_the_dcm_form_is_first_order_and_orthogonal() {
    let q = from_euler(0.2, 0.4, -1.0);
    let axis = Vector3::new(0.6, 0.0, -0.8);
    for angle in [1e-4, 0.01, 0.3, 2.0] {
        let phi = angle * axis;
        let turn = |form: AttitudeForm| log(&(form.correct(&q, &phi) * q.inverse()));
        assert!((turn(AttitudeForm::Dcm) - f64::atan(angle) * axis).norm() < 1e-14, "{angle}");
        for form in [AttitudeForm::RotationVector, AttitudeForm::Euler, AttitudeForm::Picard] {
            assert!((turn(form) - phi).norm() < 1e-14, "{form:?} {angle}");
        }
    }
}

#[test]
fn orthogonalise_finds_the_polar_factor() {
    let mut rng = Rng(11);
    for size in [1e-9, 1e-4, 0.1, 0.5] {
        let c = dcm(&exp(&rng.vector(1.0)));
        let noise = Matrix3::from_fn(|_, _| size * rng.normal());
        // C (I + S) with S symmetric has the polar factor C
        let stretched = c * (Matrix3::identity() + 0.25 * (noise + noise.transpose()));
        let found = orthogonalise(&stretched);
        assert!(orthogonality_error(&found) < 1e-14, "{size}");
        assert!((found - c).amax() < 1e-13, "{size}: {:e}", (found - c).amax());
    }
    assert!((orthogonalise(&(7.0 * Matrix3::identity())) - Matrix3::identity()).amax() < 1e-15);
    // Poisson's step without it: the departure grows by a^4/4 per step
    let a = Vector3::new(0.0, 0.0, 0.1);
    let (w, one) = (skew(&a), Matrix3::identity());
    let bare = one + w + 0.5 * w * w;
    assert!((orthogonality_error(&bare) / 0.25e-4 - 1.0).abs() < 1e-9);
    assert!(orthogonality_error(&poisson_step(&one, &a, &Vector3::zeros())) < 1e-15);
}

proptest! {
    #[test]
    fn all_forms_agree_with_the_exact_one_within_their_error(
        a in prop::array::uniform3(-0.04f64..0.04),
        z in prop::array::uniform3(-0.01f64..0.01),
        angles in (-3.1f64..3.1, -1.35f64..1.35, -3.1f64..3.1),
    ) {
        let (alpha, zeta) = (Vector3::from(a), Vector3::from(z));
        let q = from_euler(angles.0, angles.1, angles.2);
        let turn = alpha.norm() + zeta.norm();
        for form in AttitudeForm::ALL {
            let (order, factor) = match form {
                AttitudeForm::RotationVector => (3, 1e-12),
                AttitudeForm::Euler => (5, 2.0 / angles.1.cos().powi(5)),
                AttitudeForm::Quaternion => (5, 0.01),
                AttitudeForm::Dcm | AttitudeForm::Picard | AttitudeForm::TwoQuaternions => (3, 0.5),
            };
            let miss = departure(form, &q, &alpha, &zeta).norm();
            prop_assert!(miss <= factor * turn.powi(order) + 1e-15, "{:?} {:e}", form, miss);
            let next = form.advance(&q, &alpha, &zeta).unwrap();
            prop_assert!((next.norm() - 1.0).abs() < 1e-15);
        }
    }
}

/// Position and attitude error after a flight in one form, m and rad.
fn flown(form: AttitudeForm, dt_ns: i64) -> [f64; 2] {
    let (start, legs) = fly::<Ned>(weaving, PLACE, (60_000_000_000 / dt_ns) as usize, dt_ns);
    let mut model = Ned::new(EarthModel::default(), &start).unwrap();
    model.set_attitude_form(form).unwrap();
    let mut ins = FreeIns::new(model, Coning::TwoSample);
    for leg in &legs {
        ins.step(&leg.delta).unwrap();
    }
    let [phi, _, dp] = error(&ins.model().solution(), &legs.last().unwrap().truth);
    [dp.norm(), phi.norm()]
}

#[test]
fn a_minute_of_flight_at_20_hz_tells_the_forms_apart() {
    let miss = |form| flown(form, 50_000_000);
    let [exact, _] = miss(AttitudeForm::RotationVector);
    let [fourth, _] = miss(AttitudeForm::Quaternion);
    let [euler, _] = miss(AttitudeForm::Euler);
    let [picard, picard_rad] = miss(AttitudeForm::Picard);
    let [_, two_rad] = miss(AttitudeForm::TwoQuaternions);
    let [poisson, poisson_rad] = miss(AttitudeForm::Dcm);
    assert!(exact < 1e-6 && fourth < 1e-4 && euler < 1e-4);
    assert!(exact < fourth && fourth < picard && picard < poisson);
    // four times the error of the angle, so four times that of everything that follows from it
    assert!((poisson_rad / picard_rad - 4.0).abs() < 0.2, "{}", poisson_rad / picard_rad);
    assert!((two_rad / picard_rad - 1.0).abs() < 0.05, "{}", two_rad / picard_rad);
    assert!((picard_rad / flown(AttitudeForm::Picard, 25_000_000)[1] - 4.0).abs() < 0.5);
}

#[test]
fn ecef_refuses_every_form_but_the_exact_one() {
    let start = solution([55.0, 30.0, 0.0], [10.0, 0.0, 0.0], [0.0, 0.0, 30.0]);
    let mut model = Ecef::new(EarthModel::default(), &start).unwrap();
    for form in AttitudeForm::ALL {
        let code = model.set_attitude_form(form).map_err(|e| e.code());
        assert_eq!(code, if form == AttitudeForm::RotationVector { Ok(()) } else { Err("config.range") });
    }
    assert!(filter::<Ecef, 16>(15, start).set_attitude_form(AttitudeForm::Dcm).is_err());
}

#[test]
fn a_filter_in_the_dcm_form_restores_to_the_same_bits() {
    let (start, legs) = fly::<Ned>(weaving, PLACE, 300, 10_000_000);
    let dcm_filter = || {
        let mut ekf: Ekf<Ned, 16> = filter(15, start);
        ekf.set_attitude_form(AttitudeForm::Dcm).unwrap();
        ekf
    };
    let mut through = dcm_filter();
    let mut resumed = dcm_filter();
    for (k, leg) in legs.iter().enumerate() {
        if k == 150 {
            restore(&mut resumed, &bytes(&through)).unwrap();
        }
        for ekf in [Some(&mut through), (k >= 150).then_some(&mut resumed)].into_iter().flatten() {
            ekf.predict(leg.t_ns, &leg.delta.dtheta, &leg.delta.dvel).unwrap();
            if k % 50 == 49 {
                ekf.update(k as u64, &fix(leg.t_ns, &leg.truth, 1.0, 0.1)).unwrap();
            }
        }
    }
    assert_eq!(bytes(&through), bytes(&resumed));
    let mut exact: Ekf<Ned, 16> = filter(15, start);
    for leg in &legs {
        exact.predict(leg.t_ns, &leg.delta.dtheta, &leg.delta.dvel).unwrap();
    }
    assert_ne!(bytes(&through), bytes(&exact));
}

/// Error of three rates after a flight: position (m) at the last position step.
fn in_three_rates(motion: common::Motion, divisors: (u32, u32), gather: Gather, legs: usize) -> f64 {
    let (start, legs) = fly::<Ned>(motion, PLACE, legs, 10_000_000);
    let divisors = Divisors { velocity: divisors.0, position: divisors.1 };
    let mut ins = ThreeRate::new(
        EarthModel::default(),
        AttitudeForm::default(),
        Coning::TwoSample,
        divisors,
        gather,
        &start,
    )
    .unwrap();
    for leg in &legs {
        ins.step(&leg.delta).unwrap();
    }
    error(&ins.solution(), &legs.last().unwrap().truth)[2].norm()
}

#[test]
fn three_rates_cost_accuracy_in_proportion() {
    let flown = |velocity, position, gather| in_three_rates(weaving, (velocity, position), gather, 6000);
    let one = flown(1, 1, Gather::Body);
    let split = flown(5, 4, Gather::Body);
    let coarse = flown(20, 5, Gather::Body);
    let turned = flown(20, 5, Gather::Navigation);
    assert!(one < 1e-5, "{one}");
    assert!(split < 0.3 && split > 3.0 * one, "{split} {one}");
    assert!(coarse > 3.0 * split, "{coarse} {split}");
    // at rest on a turntable only the sculling of the velocity step is left
    assert!(in_three_rates(turning, (1, 10), Gather::Body, 1000) < 1e-4);
    // turned one by one only the slow position is left, and at the rate of the samples both ways are one
    assert!(turned < 0.05 * coarse && turned > 1e-3, "{turned}");
    assert!((flown(1, 1, Gather::Navigation) - one).abs() < 1e-9);
    assert_eq!(Gather::by_name("navigation"), Some(Gather::Navigation));
    assert_eq!(Gather::by_name("earth"), None);
}

#[test]
fn three_rates_refuse_what_is_no_rate_and_no_number() {
    let start = solution([55.0, 30.0, 0.0], [10.0, 0.0, 0.0], [0.0, 0.0, 30.0]);
    let new = |velocity, position| {
        let divisors = Divisors { velocity, position };
        ThreeRate::new(
            EarthModel::default(),
            AttitudeForm::Euler,
            Coning::OneSample,
            divisors,
            Gather::Body,
            &start,
        )
    };
    assert_eq!(new(0, 1).unwrap_err().code(), "config.range");
    assert_eq!(new(1, 0).unwrap_err().code(), "config.range");
    let mut ins = new(2, 2).unwrap();
    let before = ins.solution();
    let nan = ImuDelta { dt_s: 0.01, dtheta: Vector3::repeat(f64::NAN), dvel: Vector3::zeros() };
    assert_eq!(ins.step(&nan).unwrap_err().code(), "state.non_finite");
    assert_eq!(ins.solution(), before);
}

/// Free INS at rest with an error of height, damped or not; height error (m) after a time.
fn height_after(seconds: usize, error_m: f64, accel_m_s2: f64, vertical: Option<Vertical>) -> f64 {
    let start = Solution {
        position: gnssins::frames::Lla::new(55f64.to_radians(), 0.5, 0.0),
        v_n: Vector3::zeros(),
        q_nb: UnitQuaternion::identity(),
    };
    let (dt_s, down) = (0.1, Vector3::new(0.0, 0.0, accel_m_s2));
    let mut ideal = FreeIns::new(Ned::new(EarthModel::default(), &start).unwrap(), Coning::OneSample);
    let mut off = start;
    off.position.height_m += error_m;
    let mut ins = FreeIns::new(Ned::new(EarthModel::default(), &off).unwrap(), Coning::OneSample);
    let mut channel = vertical.map(|kind| VerticalLoop::new(kind).unwrap());
    for _ in 0..seconds * 10 {
        let mut delta = ideal.step_to(dt_s, &start.v_n, &start.q_nb).unwrap();
        delta.dvel += dt_s * down;
        ins.step(&delta).unwrap();
        if let Some(channel) = &mut channel {
            let held = channel.correct(&ins.model().solution(), 0.0, dt_s).unwrap();
            ins.restart(&held).unwrap();
        }
    }
    ins.model().solution().position.height_m
}

#[test]
fn vertical_channel_diverges_alone_and_is_tamed_by_an_outer_height() {
    // 10 m become 10 cosh(800 s / 570 s) = 21.6 m
    let alone = height_after(800, 10.0, 0.0, None);
    assert!((alone - 21.6).abs() < 0.15, "{alone}");
    let tau = Vertical::Damped { tau_s: 20.0 };
    let damped = height_after(400, 10.0, 0.0, Some(tau));
    assert!(damped.abs() < 1e-4, "{damped}");
    // after 2 tau, e(t) of a triple pole: e0 (1 - t/tau + t²/(2 tau²)... ) leaves an overshoot, not the start
    assert!(height_after(40, 10.0, 0.0, Some(tau)).abs() < 4.0);
    // 1 mg of accelerometer error: taken over by the third state, nothing is left
    let biased = height_after(600, 0.0, -9.8e-3, Some(tau));
    assert!(biased.abs() < 1e-3, "{biased}");
    assert_eq!(height_after(10, 10.0, -9.8e-3, Some(Vertical::Held)), 0.0);
    for tau_s in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(VerticalLoop::new(Vertical::Damped { tau_s }).is_err());
    }
    let mut fast = VerticalLoop::new(Vertical::Damped { tau_s: 1.0 }).unwrap();
    let any = solution([55.0, 30.0, 0.0], [10.0, 0.0, 0.0], [0.0, 0.0, 30.0]);
    assert!(fast.correct(&any, 0.0, 0.25).is_err());
    assert_eq!(fast.correct(&any, f64::NAN, 0.1).unwrap(), any);
}

#[test]
fn from_dcm_of_a_poisson_step_is_the_form() {
    let (q, a) = (from_euler(0.1, 0.2, 0.3), Vector3::new(0.01, 0.02, -0.03));
    let z = Vector3::new(1e-5, -2e-5, 3e-5);
    let by_hand = from_dcm(&poisson_step(&dcm(&q), &a, &z));
    assert_eq!(AttitudeForm::Dcm.advance(&q, &a, &z).unwrap(), by_hand);
}
