//! Quaternion, rotation vector, matrix and Euler angles. Numbers: scipy.spatial.transform.Rotation.

use approx::assert_abs_diff_eq;
use gnssins::attitude::{
    MIN_COS_PITCH, dcm, euler_jacobian, exp, from_dcm, from_euler, log, renormalise, skew, to_euler,
};
use gnssins::frames::wrap_pi;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use proptest::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI};

#[test]
fn euler_angles_equal_the_worked_example() {
    let q = from_euler(20f64.to_radians(), (-35f64).to_radians(), 130f64.to_radians());
    let expected = [
        0.349_610_153_701_615_47,
        0.338_381_956_034_229_44,
        0.024_941_655_326_385_537,
        0.873_297_375_519_222_2,
    ];
    for (got, want) in [q.w, q.i, q.j, q.k].into_iter().zip(expected) {
        assert_abs_diff_eq!(got, want, epsilon = 1e-15);
    }
    assert_abs_diff_eq!(
        log(&q),
        Vector3::new(0.876_670_748_529_911_7, 0.064_618_160_793_259_38, 2.262_515_037_321_313_6),
        epsilon = 2e-15
    );
    let c_nb = Matrix3::new(
        -0.526_540_784_518_363_2,
        -0.593_747_647_132_837_6,
        0.608_455_860_159_967_4, //
        0.627_506_871_597_133,
        -0.754_301_308_516_625,
        -0.193_040_571_042_685_46, //
        0.573_576_436_351_046,
        0.280_166_499_593_235_53,
        0.769_751_131_320_057_1,
    );
    assert_abs_diff_eq!(dcm(&q), c_nb, epsilon = 1e-15);
    assert!(from_dcm(&c_nb).angle_to(&q) < 1e-7);
    assert_abs_diff_eq!(from_dcm(&c_nb).coords, q.coords, epsilon = 1e-15);
}

#[test]
fn exponential_equals_the_worked_example() {
    let q = exp(&Vector3::new(0.3, -0.2, 0.5));
    let expected = Quaternion::new(
        0.952_874_852_886_029_6,
        0.147_636_255_766_526_28,
        -0.098_424_170_511_017_53,
        0.246_060_426_277_543_8,
    );
    assert_abs_diff_eq!(q.coords, expected.coords, epsilon = 2e-16);
}

#[test]
fn exponential_has_no_step_where_the_series_ends() {
    let axis = Vector3::new(2.0, -1.0, 2.0) / 3.0;
    for angle in [0.2f64.next_down(), 0.2, 0.2f64.next_up(), 0.199, 0.201] {
        let q = exp(&(axis * angle));
        assert_abs_diff_eq!(q.w, (0.5 * angle).cos(), epsilon = 2e-16);
        assert_abs_diff_eq!(q.imag(), axis * (0.5 * angle).sin(), epsilon = 2e-16);
    }
}

#[test]
fn logarithm_undoes_exponential_from_1e_12_to_pi() {
    let axis = Vector3::new(0.48, -0.6, 0.64);
    for angle in
        [0.0, 1e-300, 1e-160, 1e-12, 1e-8, 1e-5, 3.9e-3, 4.1e-3, 0.1, 1.0, 2.0, 3.0, 3.1, PI - 1e-9, PI]
    {
        let rotvec = axis * angle;
        let q = exp(&rotvec);
        let back = log(&q);
        assert!(
            (back - rotvec).norm() <= 4e-16 * angle.max(1e-300) + if angle > 1.0 { 1e-15 } else { 0.0 },
            "{angle}"
        );
        let minus = UnitQuaternion::new_unchecked(-q.into_inner());
        if angle < PI {
            assert_eq!(log(&minus), back, "{angle}");
        }
    }
    // Past half a turn the shorter way round is returned.
    assert_abs_diff_eq!(log(&exp(&(axis * (PI + 0.1)))), -axis * (PI - 0.1), epsilon = 1e-14);
}

#[test]
fn turns_about_body_axes_have_the_aircraft_signs() {
    let (roll, pitch, heading) = (Vector3::x(), Vector3::y(), Vector3::z());
    assert_abs_diff_eq!(from_euler(0.3, 0.0, 0.0).coords, exp(&(roll * 0.3)).coords, epsilon = 1e-16);
    assert_abs_diff_eq!(from_euler(0.0, 0.3, 0.0).coords, exp(&(pitch * 0.3)).coords, epsilon = 1e-16);
    assert_abs_diff_eq!(from_euler(0.0, 0.0, 0.3).coords, exp(&(heading * 0.3)).coords, epsilon = 1e-16);
    // Heading east points the nose east, pitch up points it up, right bank lowers the right wing.
    assert_abs_diff_eq!(dcm(&from_euler(0.0, 0.0, FRAC_PI_2)) * roll, Vector3::y(), epsilon = 1e-15);
    assert_abs_diff_eq!(dcm(&from_euler(0.0, FRAC_PI_2, 0.0)) * roll, -Vector3::z(), epsilon = 1e-15);
    assert_abs_diff_eq!(dcm(&from_euler(FRAC_PI_2, 0.0, 0.0)) * pitch, Vector3::z(), epsilon = 1e-15);
}

#[test]
fn straight_up_and_down_give_roll_zero_and_the_whole_turn_as_heading() {
    for sign in [1.0, -1.0] {
        let q = from_euler(0.4, sign * FRAC_PI_2, 1.1);
        let (roll, pitch, heading) = to_euler(&q);
        assert_eq!(roll, 0.0);
        assert_abs_diff_eq!(pitch, sign * FRAC_PI_2, epsilon = 1e-12);
        assert_abs_diff_eq!(heading, 1.1 - sign * 0.4, epsilon = 1e-12);
        assert_abs_diff_eq!(dcm(&from_euler(roll, pitch, heading)), dcm(&q), epsilon = 3e-12);
    }
}

#[test]
fn euler_round_trip_keeps_the_attitude_near_the_vertical() {
    for offset in [1e-1, 1e-3, 1e-6, 1e-9, 1e-11, 1e-12, 1e-14] {
        for sign in [1.0, -1.0] {
            let q = from_euler(-2.0, sign * (FRAC_PI_2 - offset), 2.9);
            let (roll, pitch, heading) = to_euler(&q);
            let back = from_euler(roll, pitch, heading);
            assert!(log(&(q.inverse() * back)).norm() < 4e-12, "{offset} {sign}");
        }
    }
}

#[test]
fn euler_jacobian_is_the_derivative_of_the_angles() {
    let step = 1e-6;
    for pitch in [-1.5, -0.7, 0.0, 0.4, 1.2] {
        for (roll, heading) in [(0.0, 0.0), (0.8, -2.0), (-2.5, 1.3)] {
            let q = from_euler(roll, pitch, heading);
            let jacobian = euler_jacobian(pitch, heading);
            for axis in 0..3 {
                let mut rho = Vector3::zeros();
                rho[axis] = step;
                let (ahead, behind) = (to_euler(&(exp(&rho) * q)), to_euler(&(exp(&-rho) * q)));
                let slope = Vector3::new(
                    wrap_pi(ahead.0 - behind.0),
                    wrap_pi(ahead.1 - behind.1),
                    wrap_pi(ahead.2 - behind.2),
                ) / (2.0 * step);
                assert_abs_diff_eq!(jacobian.column(axis).into_owned(), slope, epsilon = 1e-6);
            }
        }
    }
}

#[test]
fn euler_jacobian_stays_bounded_at_the_vertical() {
    for pitch in [FRAC_PI_2, -FRAC_PI_2, FRAC_PI_2 - 1e-9, 1e-9 - FRAC_PI_2] {
        let jacobian = euler_jacobian(pitch, 0.7);
        assert!(jacobian.iter().all(|x| x.abs() <= 1.0 / MIN_COS_PITCH + 1e-9));
    }
}

#[test]
fn skew_multiplies_like_the_cross_product() {
    let (a, b) = (Vector3::new(1.0, -2.0, 3.0), Vector3::new(0.5, 4.0, -1.0));
    assert_eq!(skew(&a) * b, a.cross(&b));
    assert_eq!(skew(&a).transpose(), -skew(&a));
}

#[test]
fn matrix_to_quaternion_holds_at_every_branch() {
    let half_turns = [Vector3::x() * PI, Vector3::y() * PI, Vector3::z() * PI];
    let near = [
        Vector3::new(3.0, 0.3, 0.2),
        Vector3::new(0.1, 3.0, 0.5),
        Vector3::new(-0.4, 0.2, 3.1),
        Vector3::zeros(),
    ];
    for rotvec in half_turns.into_iter().chain(near) {
        let q = exp(&rotvec);
        let back = from_dcm(&dcm(&q));
        assert!(back.w >= 0.0);
        assert_abs_diff_eq!(dcm(&back), dcm(&q), epsilon = 1e-15);
    }
}

#[test]
fn renormalisation_restores_unit_length_and_keeps_nan() {
    let q = from_euler(0.1, 0.2, 0.3).into_inner();
    for scale in [1.0 + 1e-15, 1.0 - 1e-10, 1.0 + 4e-9, 1.1, 1e-3, 1e150] {
        let unit = renormalise(&UnitQuaternion::new_unchecked(q * scale));
        assert_abs_diff_eq!(unit.as_ref().norm(), 1.0, epsilon = 3e-16);
        assert_abs_diff_eq!(unit.coords, q.coords, epsilon = 1e-15);
    }
    assert_eq!(renormalise(&UnitQuaternion::new_unchecked(q * 0.0)), UnitQuaternion::identity());
    assert!(renormalise(&UnitQuaternion::new_unchecked(q * f64::NAN)).w.is_nan());
}

#[test]
fn a_million_steps_keep_the_matrix_orthonormal() {
    let step = exp(&Vector3::new(1e-3, -2e-3, 5e-4));
    let mut q = from_euler(0.5, 1.0, -2.0);
    for _ in 0..1_000_000 {
        q = renormalise(&(q * step));
    }
    let c = dcm(&q);
    assert_abs_diff_eq!(c * c.transpose(), Matrix3::identity(), epsilon = 1e-15);
    // The same turn in one step: 1e6 roundings of 1e-16 in random directions.
    let whole = from_euler(0.5, 1.0, -2.0) * exp(&Vector3::new(1e3, -2e3, 5e2));
    assert!(log(&(q.inverse() * whole)).norm() < 1e-10);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..Default::default() })]

    #[test]
    fn log_undoes_exp(x in -1.8f64..1.8, y in -1.8f64..1.8, z in -1.8f64..1.8, power in -12i32..1) {
        let rotvec = Vector3::new(x, y, z) * 10f64.powi(power);
        prop_assert!((log(&exp(&rotvec)) - rotvec).norm() <= 2e-15 * rotvec.norm());
    }

    #[test]
    fn exp_undoes_log(w in -1.0f64..1.0, x in -1.0f64..1.0, y in -1.0f64..1.0, z in -1.0f64..1.0) {
        let q = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z + 2.0));
        let rotvec = log(&q);
        prop_assert!(rotvec.norm() <= PI + 1e-15);
        let back = exp(&rotvec);
        prop_assert!((back.coords - q.coords * q.w.signum()).amax() < 1e-15);
    }

    #[test]
    fn matrix_and_quaternion_agree(x in -3.0f64..3.0, y in -3.0f64..3.0, z in -3.0f64..3.0) {
        let q = exp(&Vector3::new(x, y, z));
        let c = dcm(&q);
        prop_assert!((c * c.transpose() - Matrix3::identity()).amax() < 4e-15);
        prop_assert!((c.determinant() - 1.0).abs() < 4e-15);
        prop_assert!((c - q.to_rotation_matrix().into_inner()).amax() < 1e-15);
        prop_assert!((from_dcm(&c).coords - q.coords * q.w.signum()).amax() < 2e-15);
    }

    #[test]
    fn euler_angles_survive_the_quaternion(roll in -PI..PI, pitch in -1.57f64..1.57, heading in -PI..PI) {
        let (r, p, h) = to_euler(&from_euler(roll, pitch, heading));
        let slack = 2e-15 / pitch.cos();
        prop_assert!(wrap_pi(r - roll).abs() < slack && wrap_pi(h - heading).abs() < slack);
        prop_assert!((p - pitch).abs() < 2e-15);
        prop_assert!((-PI..PI).contains(&r) && (-PI..PI).contains(&h));
    }
}
