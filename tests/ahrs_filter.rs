//! The attitude filter: convergence, bias and gyro matrix, disturbances, faults, saved states, worked numbers.

mod common;

use approx::assert_abs_diff_eq;
use common::Rng;
use gnssins::ahrs::filter::{AttitudeFilter, SAVED_LEN, Settings};
use gnssins::ahrs::{AhrsSample, AhrsStatus, AttitudeEstimator};
use gnssins::attitude::{exp, from_euler, to_euler};
use gnssins::bytes::{Reader, Writer};
use gnssins::error::Error;
use gnssins::frames::wrap_pi;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

const G: f64 = 9.806_65;
const DT: f64 = 0.01;

/// 50 µT, 65° down.
fn field() -> Vector3<f64> {
    let dip = 65f64.to_radians();
    Vector3::new(dip.cos(), 0.0, dip.sin()) * 50.0
}

/// A body that turns about all axes, up to 1 rad/s.
fn rate(t: f64) -> Vector3<f64> {
    Vector3::new(0.6 * (0.9 * t).sin(), 0.5 * (0.7 * t + 1.0).cos(), 0.4 * (0.4 * t).sin())
}

/// A body, its true attitude, and the sensors that it feeds a filter with.
struct Body {
    q_nb: UnitQuaternion<f64>,
    t: f64,
    bias: Vector3<f64>,
    matrix: Matrix3<f64>,
    rng: Option<Rng>,
}

impl Body {
    fn new(roll: f64, pitch: f64, heading: f64) -> Self {
        let q_nb = from_euler(roll, pitch, heading);
        Self { q_nb, t: 0.0, bias: Vector3::zeros(), matrix: Matrix3::zeros(), rng: None }
    }

    fn sample(&mut self, rate: Vector3<f64>, a_n: Vector3<f64>, m_n: Vector3<f64>, dt: f64) -> AhrsSample {
        self.t += dt;
        self.q_nb *= exp(&(rate * dt));
        let back = self.q_nb.inverse();
        let mut noise = |sd: f64| self.rng.as_mut().map_or(Vector3::zeros(), |r| r.vector(sd));
        AhrsSample {
            gyro: (Matrix3::identity() - self.matrix) * rate + self.bias + noise(1.7e-4 / dt.sqrt()),
            accel: back * (a_n - Vector3::new(0.0, 0.0, G)) + noise(0.02),
            mag: Some(back * m_n + noise(0.2)),
        }
    }

    /// Feeds `seconds` of undisturbed motion.
    fn turn(&mut self, filter: &mut AttitudeFilter, seconds: f64, dt: f64) {
        for _ in 0..(seconds / dt).round() as usize {
            let s = self.sample(rate(self.t), Vector3::zeros(), field(), dt);
            filter.step(dt, &s).unwrap();
        }
    }

    fn error_deg(&self, filter: &AttitudeFilter) -> f64 {
        self.q_nb.angle_to(&filter.q_nb()).to_degrees()
    }
}

fn filter() -> AttitudeFilter {
    AttitudeFilter::new(&Settings::default()).unwrap()
}

#[test]
fn the_first_sample_gives_the_attitude_of_the_vectors_with_declination() {
    let declination_rad = 0.2;
    let mut f = AttitudeFilter::new(&Settings { declination_rad, ..Settings::default() }).unwrap();
    let mut body = Body::new(0.4, -1.2, 2.5);
    let east = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), declination_rad) * field();
    let s = body.sample(Vector3::zeros(), Vector3::zeros(), east, DT);
    let status = f.step(0.0, &s).unwrap();
    assert!(status.has(AhrsStatus::ALIGNED) && status.has(AhrsStatus::MAG_USED));
    assert!(body.error_deg(&f) < 1e-6);
    let (roll, pitch, heading) = to_euler(&f.q_nb());
    assert_abs_diff_eq!(Vector3::new(roll, pitch, heading), Vector3::new(0.4, -1.2, 2.5), epsilon = 1e-12);
    // and holds it: declination enters the heading update with the same sign
    for _ in 0..2000 {
        let s = body.sample(Vector3::zeros(), Vector3::zeros(), east, DT);
        f.step(DT, &s).unwrap();
    }
    assert!(body.error_deg(&f) < 1e-6);
}

#[test]
fn one_level_update_is_the_scalar_kalman_update_worked_by_hand() {
    // given level and north, a specific force tilted by 0.01 rad in pitch; everything else off or tiny
    let settings = Settings {
        initial_q_nb: Some([1.0, 0.0, 0.0, 0.0]),
        rest_detection: false,
        gyro_matrix_sd: 0.0,
        bias_sd_rad_s: 1e-12,
        bias_walk_rad_s_sqrt_s: 0.0,
        gyro_arw_rad_sqrt_s: 1e-12,
        ..Settings::default()
    };
    let mut f = AttitudeFilter::new(&settings).unwrap();
    let tilt = 0.01f64;
    let accel = Vector3::new(G * tilt.sin(), 0.0, -G * tilt.cos());
    f.step(DT, &AhrsSample { gyro: Vector3::zeros(), accel, mag: None }).unwrap();
    // the tilt is explained by the initial 0.2 rad: r = density^2 / (g^2 dt), k = p / (p + r)
    let (p, r) = (0.2f64 * 0.2, 0.022f64.powi(2) / (G * G * DT));
    let (_, pitch, _) = to_euler(&f.q_nb());
    assert_abs_diff_eq!(pitch, p / (p + r) * tilt.sin(), epsilon = 1e-9);
    assert_abs_diff_eq!(f.attitude_sd_rad().y, (p * r / (p + r)).sqrt(), epsilon = 1e-9);
    assert_eq!(f.acceleration_m_s2(), 0.0);
}

#[test]
fn a_turning_body_shows_bias_and_gyro_matrix() {
    let bias = Vector3::new(0.008, -0.005, 0.006);
    let matrix = Matrix3::new(0.002, 0.001, -0.002, 0.0, -0.0015, 0.001, 0.001, -0.001, 0.0012);
    for dt in [0.001, 0.004, DT, 0.02] {
        let mut body = Body { bias, matrix, ..Body::new(0.1, 0.2, -2.0) };
        let mut f = filter();
        body.turn(&mut f, 240.0, dt);
        assert!((f.gyro_bias_b() - bias).amax() < 3e-4, "{dt}: {}", f.gyro_bias_b());
        assert!(f.gyro_bias_sd_rad_s().amax() < 2e-3);
        assert!((f.gyro_matrix() - matrix).amax() < 1.2e-3, "{dt}: {}", f.gyro_matrix());
        assert!(body.error_deg(&f) < 0.05, "{dt}: {}", body.error_deg(&f));
    }
}

#[test]
fn at_rest_the_bias_comes_from_the_gyro_whatever_the_field_does() {
    let bias = Vector3::new(0.004, -0.003, 0.005);
    let mut body = Body { bias, rng: Some(Rng(3)), ..Body::new(0.0, 0.0, 1.0) };
    let mut f = filter();
    let mut rest = 0;
    for k in 0..2000 {
        // a magnet passes by
        let m_n = field() + Vector3::new(0.0, 20.0 * (0.01 * k as f64).sin(), 0.0);
        let s = body.sample(Vector3::zeros(), Vector3::zeros(), m_n, DT);
        rest += usize::from(f.step(DT, &s).unwrap().has(AhrsStatus::REST));
    }
    assert!(rest > 1700, "{rest}");
    assert!((f.gyro_bias_b() - bias).amax() < 2e-4, "{}", f.gyro_bias_b());
    // a slow turn is as still as rest, but its rate cannot be the bias that is known by now
    let before = f.gyro_bias_b();
    for _ in 0..1500 {
        let s = body.sample(Vector3::new(0.0, 0.0, 0.035), Vector3::zeros(), field(), DT);
        f.step(DT, &s).unwrap();
    }
    assert!((f.gyro_bias_b() - before).amax() < 4e-4, "{}", f.gyro_bias_b());
}

#[test]
fn an_acceleration_is_seen_allowed_for_and_forgotten() {
    let mut body = Body { rng: Some(Rng(5)), ..Body::new(0.1, 0.0, 0.5) };
    let mut f = filter();
    body.turn(&mut f, 60.0, DT);
    let (mut worst, mut flagged) = (0.0f64, 0);
    for _ in 0..1000 {
        let s = body.sample(rate(body.t), Vector3::new(3.0, 2.0, 0.0), field(), DT);
        flagged += usize::from(f.step(DT, &s).unwrap().has(AhrsStatus::ACCEL_DISTURBED));
        worst = worst.max(body.error_deg(&f));
    }
    // followed, the tilt would be atan(3.6 / 9.8) = 20 degrees
    assert!(worst < 1.0, "{worst}");
    assert!(flagged > 950, "{flagged}");
    assert_abs_diff_eq!(f.acceleration_m_s2(), 13f64.sqrt(), epsilon = 0.3);
    body.turn(&mut f, 10.0, DT);
    assert!(f.acceleration_m_s2() < 0.3);
    assert!(body.error_deg(&f) < 0.3);
}

#[test]
fn a_disturbed_field_moves_neither_level_nor_heading() {
    let mut body = Body { rng: Some(Rng(6)), ..Body::new(0.1, 0.0, 0.5) };
    let mut f = filter();
    body.turn(&mut f, 60.0, DT);
    let mut flagged = 0;
    let (mut level, mut total) = (0.0f64, 0.0f64);
    for _ in 0..800 {
        let s = body.sample(rate(body.t), Vector3::zeros(), field() + Vector3::new(5.0, 18.0, -6.0), DT);
        flagged += usize::from(f.step(DT, &s).unwrap().has(AhrsStatus::MAG_DISTURBED));
        let down = (f.q_nb() * body.q_nb.inverse()) * Vector3::z();
        level = level.max(down.angle(&Vector3::z()).to_degrees());
        total = total.max(body.error_deg(&f));
    }
    assert!(flagged > 780, "{flagged}");
    assert!(level < 0.15 && total < 1.0, "{level} {total}");
    body.turn(&mut f, 10.0, DT);
    assert!(body.error_deg(&f) < 0.3);
}

#[test]
fn a_field_that_has_changed_for_good_becomes_the_reference() {
    let mut body = Body { rng: Some(Rng(7)), ..Body::new(0.0, 0.1, -0.5) };
    let settings = Settings { mag_new_s: 10.0, ..Settings::default() };
    let mut f = AttitudeFilter::new(&settings).unwrap();
    let run = |f: &mut AttitudeFilter, body: &mut Body, m_n: Vector3<f64>, seconds: usize| {
        for _ in 0..100 * seconds {
            let s = body.sample(rate(body.t), Vector3::zeros(), m_n, DT);
            f.step(DT, &s).unwrap();
        }
    };
    // started beside a steel frame that turns the field by 40 degrees, then carried away from it
    let bent = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.7) * field() * 1.3;
    run(&mut f, &mut body, bent, 30);
    assert!(body.error_deg(&f) > 35.0);
    run(&mut f, &mut body, field(), 5);
    assert!(body.error_deg(&f) > 30.0 && f.field_disturbance() > 0.3);
    run(&mut f, &mut body, field(), 55);
    assert!(body.error_deg(&f) < 2.0, "{}", body.error_deg(&f));
    assert!(f.field_disturbance() < 0.1);
}

#[test]
fn a_wrong_level_is_found_out_when_the_speed_becomes_impossible() {
    for wrong in [0.6, 3.0] {
        let given = from_euler(wrong, 0.0, 0.0);
        let settings = Settings {
            initial_q_nb: Some([given.w, given.i, given.j, given.k]),
            initial_tilt_sd_rad: 0.01,
            speed_change_m_s: 50.0,
            ..Settings::default()
        };
        let mut f = AttitudeFilter::new(&settings).unwrap();
        let mut body = Body { rng: Some(Rng(8)), ..Body::new(0.0, 0.0, 0.0) };
        body.turn(&mut f, 2.0, DT);
        assert!(body.error_deg(&f) > 15.0, "{wrong}: {}", body.error_deg(&f));
        body.turn(&mut f, 40.0, DT);
        assert_eq!(f.restarts(), 1);
        assert!(body.error_deg(&f) < 1.0, "{wrong}: {}", body.error_deg(&f));
    }
}

#[test]
fn without_a_magnetometer_the_level_holds_and_the_heading_says_how_little_it_knows() {
    let mut body = Body { rng: Some(Rng(9)), ..Body::new(0.3, -0.2, 1.0) };
    let mut f = filter();
    for _ in 0..6000 {
        let s = body.sample(rate(body.t), Vector3::zeros(), field(), DT);
        assert!(f.step(DT, &AhrsSample { mag: None, ..s }).unwrap().has(AhrsStatus::MAG_BAD));
    }
    let down = (f.q_nb() * body.q_nb.inverse()) * Vector3::z();
    assert!(down.angle(&Vector3::z()).to_degrees() < 0.3);
    assert!(f.attitude_sd_rad().z > 2.5);
    // the first field sets the heading at once
    body.turn(&mut f, 1.0, DT);
    assert!(body.error_deg(&f) < 1.0, "{}", body.error_deg(&f));
}

#[test]
fn turning_everything_about_the_vertical_changes_nothing_else() {
    let run = |turned: f64| {
        let about = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turned);
        let mut body = Body { bias: Vector3::new(0.01, 0.0, -0.01), ..Body::new(0.2, 0.3, turned) };
        let mut f =
            AttitudeFilter::new(&Settings { declination_rad: turned, ..Settings::default() }).unwrap();
        for k in 0..2000 {
            let a_n = if k % 700 > 500 { about * Vector3::new(2.0, 1.0, 0.0) } else { Vector3::zeros() };
            let s = body.sample(rate(body.t), a_n, about * field(), DT);
            f.step(DT, &s).unwrap();
        }
        let (roll, pitch, course) = to_euler(&f.q_nb());
        (Vector3::new(roll, pitch, wrap_pi(course - turned)), f.gyro_bias_b())
    };
    let (euler, bias) = run(0.0);
    for turned in [1.0, -2.5, 3.1] {
        let (e, b) = run(turned);
        assert_abs_diff_eq!(e, euler, epsilon = 1e-9);
        assert_abs_diff_eq!(b, bias, epsilon = 1e-9);
    }
}

#[test]
fn standard_deviations_cover_the_errors() {
    let (mut inside, mut count) = (0, 0);
    for seed in 0..6 {
        let mut rng = Rng(100 + seed);
        let mut body = Body { bias: rng.vector(0.005), rng: Some(rng), ..Body::new(0.1, 0.1, 0.1) };
        let mut f = filter();
        for _ in 0..20 {
            body.turn(&mut f, 5.0, DT);
            let error = gnssins::attitude::log(&(body.q_nb * f.q_nb().inverse()));
            let sd = f.attitude_sd_rad();
            for i in 0..3 {
                inside += usize::from(error[i].abs() < 3.0 * sd[i]);
                count += 1;
            }
            // not so large either that they would say nothing
            assert!(sd.amax() < 0.02, "{sd}");
        }
    }
    assert!(inside >= count - 2, "{inside} of {count}");
}

#[test]
fn bad_readings_are_flagged_and_bridged_bad_rates_refused_and_counted() {
    let mut body = Body { rng: Some(Rng(11)), ..Body::new(0.1, 0.0, 0.5) };
    let mut f = filter();
    body.turn(&mut f, 30.0, DT);
    let nan = Vector3::repeat(f64::NAN);
    let (mut bad, mut refused) = (0, 0);
    let mut waiting = 0.0;
    for k in 0..3000 {
        let mut s = body.sample(rate(body.t), Vector3::zeros(), field(), DT);
        waiting += DT;
        match k % 10 {
            1 => s.accel = nan,
            2 => s.mag = Some(nan),
            3 => s.accel = Vector3::new(f64::INFINITY, 0.0, 0.0),
            4 => s.mag = Some(Vector3::zeros()),
            5 => s.accel = Vector3::zeros(),
            6 => s.accel = Vector3::repeat(1e300),
            7 => s.mag = Some(Vector3::repeat(f64::MAX)),
            8 => s.gyro = nan,
            _ => {}
        }
        let before = f;
        match f.step(waiting, &s) {
            Ok(status) => {
                waiting = 0.0;
                bad += usize::from(status.has(AhrsStatus::ACCEL_BAD) || status.has(AhrsStatus::MAG_BAD));
            }
            Err(e) => {
                assert_eq!(e, Error::NonFinite { what: "gyro rate", t_ns: 0 });
                assert_eq!(f.q_nb(), before.q_nb());
                refused += 1;
            }
        }
        assert!(f.q_nb().coords.iter().all(|x| x.is_finite()));
        assert!(f.attitude_sd_rad().iter().chain(f.gyro_bias_b().iter()).all(|x| x.is_finite()));
    }
    assert_eq!((bad, refused, f.refused()), (2100, 300, 300));
    assert!(body.error_deg(&f) < 0.3, "{}", body.error_deg(&f));
    // intervals: none, backwards, not a number
    let s = body.sample(Vector3::zeros(), Vector3::zeros(), field(), DT);
    let before = f;
    assert!(f.step(0.0, &s).unwrap().has(AhrsStatus::SKIPPED));
    assert_eq!(f, before);
    for dt in [-0.01, f64::NAN, f64::INFINITY] {
        assert!(matches!(f.step(dt, &s), Err(Error::Config { what: "dt_s", .. })));
    }
    assert_eq!(f.refused(), 303);
}

#[test]
fn nothing_that_is_fed_in_makes_the_filter_lose_its_numbers() {
    let mut rng = Rng(12);
    for _ in 0..40 {
        let mut f = filter();
        for _ in 0..400 {
            let scale = 10f64.powi(rng.below(13) as i32 - 6);
            let mag = (rng.below(3) > 0).then(|| rng.vector(50.0 * scale));
            let s = AhrsSample { gyro: rng.vector(scale), accel: rng.vector(9.8 * scale), mag };
            let dt = 10f64.powi(rng.below(8) as i32 - 4);
            let _ = f.step(dt, &s);
            let sd = f.attitude_sd_rad();
            assert!(sd.iter().all(|x| x.is_finite() && *x >= 0.0 && *x <= 3.2), "{sd}");
            assert!((f.q_nb().norm() - 1.0).abs() < 1e-9);
            assert!(f.gyro_bias_b().amax() <= 1.0 && f.gyro_matrix().amax() <= 0.2);
        }
    }
}

#[test]
fn free_fall_and_a_vertical_field_leave_the_gyro_alone() {
    let mut body = Body::new(0.1, 0.2, 0.3);
    let mut f = filter();
    body.turn(&mut f, 30.0, DT);
    for _ in 0..300 {
        let s = body.sample(rate(body.t), Vector3::new(0.0, 0.0, 0.95 * G), Vector3::new(0.0, 0.0, 50.0), DT);
        f.step(DT, &s).unwrap();
    }
    assert!(body.error_deg(&f) < 0.2, "{}", body.error_deg(&f));
    assert_abs_diff_eq!(f.acceleration_m_s2(), 0.95 * G, epsilon = 0.1);
}

#[test]
fn a_restored_filter_goes_on_with_the_same_bits() {
    let mut body = Body { rng: Some(Rng(13)), ..Body::new(0.1, 0.0, 0.5) };
    let mut f = filter();
    body.turn(&mut f, 20.0, DT);
    let mut buffer = [0u8; SAVED_LEN];
    let mut writer = Writer::new(&mut buffer);
    f.save(&mut writer).unwrap();
    assert_eq!(writer.len(), SAVED_LEN);
    let mut resumed = filter();
    resumed.restore(&mut Reader::new(&buffer)).unwrap();
    assert_eq!(resumed, f);
    for _ in 0..500 {
        let s = body.sample(rate(body.t), Vector3::new(2.0, 0.0, 0.0), field() * 1.2, DT);
        assert_eq!(f.step(DT, &s), resumed.step(DT, &s));
        assert_eq!(f, resumed);
    }
    // cut short, or of another kind: refused, unchanged
    let before = resumed;
    assert!(matches!(resumed.restore(&mut Reader::new(&buffer[..400])), Err(Error::SavedState { .. })));
    buffer[0] ^= 1;
    assert!(matches!(
        resumed.restore(&mut Reader::new(&buffer)),
        Err(Error::SavedState { what: "kind", .. })
    ));
    buffer[0] ^= 1;
    buffer[32..40].copy_from_slice(&f64::NAN.to_le_bytes());
    assert!(matches!(resumed.restore(&mut Reader::new(&buffer)), Err(Error::NonFinite { .. })));
    assert_eq!(resumed, before);
    assert!(f.save(&mut Writer::new(&mut [0u8; 64])).is_err());
}

#[test]
fn settings_without_meaning_are_refused_by_name() {
    type Edit = fn(&mut Settings);
    let edits: [(&str, Edit); 6] = [
        ("gravity_m_s2", |s| s.gravity_m_s2 = 0.0),
        ("accel_smooth_s", |s| s.accel_smooth_s = -1.0),
        ("gyro_arw_rad_sqrt_s", |s| s.gyro_arw_rad_sqrt_s = f64::NAN),
        ("gyro_matrix_sd", |s| s.gyro_matrix_sd = -1e-3),
        ("declination_rad", |s| s.declination_rad = f64::INFINITY),
        ("initial_q_nb", |s| s.initial_q_nb = Some([0.0; 4])),
    ];
    for (name, edit) in edits {
        let mut settings = Settings::default();
        edit(&mut settings);
        match AttitudeFilter::new(&settings) {
            Err(Error::Config { what, .. }) => assert_eq!(what, name),
            other => panic!("{name}: {other:?}"),
        }
    }
}

#[test]
fn the_bias_at_rest_is_known_as_well_as_it_says_whatever_walk_it_is_given() {
    for walk in [6e-5, 1e-5, 1e-6] {
        let (mut ratio, mut rest) = (0.0f64, 0);
        for seed in 0..12 {
            let settings = Settings { bias_walk_rad_s_sqrt_s: walk, ..Settings::default() };
            let mut f = AttitudeFilter::new(&settings).unwrap();
            let mut body = Body::new(0.1, -0.2, 0.5);
            body.rng = Some(Rng(9000 + seed));
            body.bias = Vector3::new(1e-3, -2e-3, 3e-3);
            for _ in 0..12_000 {
                let still = body.sample(Vector3::zeros(), Vector3::zeros(), field(), DT);
                let status = f.step(DT, &AhrsSample { mag: None, ..still }).unwrap();
                rest += usize::from(status.has(AhrsStatus::REST));
            }
            ratio += ((f.gyro_bias_b().z - 3e-3) / f.gyro_bias_sd_rad_s().z).powi(2) / 12.0;
        }
        // chi-square of 12: below 26.2 with probability 0.99; before, samples near the estimate were taken only
        assert!(ratio < 26.2 / 12.0, "walk {walk}: rms over sigma {}", ratio.sqrt());
        assert!(rest > 12 * 11_000, "walk {walk}: {rest} samples at rest");
    }
}
