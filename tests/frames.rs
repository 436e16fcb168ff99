//! Conversions between geodetic, ECEF and local positions. Numbers: EPSG Guidance Note 7-2 and pymap3d 3.2.0.

use approx::assert_abs_diff_eq;
use gnssins::earth::Ellipsoid;
use gnssins::frames::{
    C_UN, Ecef, Enu, Geodetic, Lla, LlaDeg, Ned, c_ne, ecef_to_enu, ecef_to_lla, ecef_to_ned, enu_to_ecef,
    lla_to_ecef, ned_to_ecef, wrap_pi,
};
use nalgebra::{Matrix3, Vector3};
use proptest::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

const ALL: [Ellipsoid; 4] = [Ellipsoid::WGS84, Ellipsoid::GRS80, Ellipsoid::PZ90, Ellipsoid::KRASOVSKY];

fn latitudes() -> impl Iterator<Item = f64> {
    (-90..=90).step_by(5).map(|d| f64::from(d).to_radians())
}

/// Distance on the ground and in height (m) between two geodetic positions that are close together.
fn distance_m(a: &Lla, b: &Lla) -> f64 {
    let radius = 6.4e6 + a.height_m;
    let east = wrap_pi(a.lon_rad - b.lon_rad) * a.lat_rad.cos();
    (radius * (a.lat_rad - b.lat_rad)).hypot(radius * east).hypot(a.height_m - b.height_m)
}

#[test]
fn geodetic_to_ecef_equals_the_worked_examples() {
    let cases = [
        // EPSG Guidance Note 7-2, section on EPSG 9602 prints 3771793.968, 140253.342, 5124304.349.
        (
            "wgs84",
            LlaDeg::new(53.809_394_444_444_44, 2.129_55, 73.0),
            [3_771_793.967_641_78, 140_253.341_899_61, 5_124_304.349_350_54],
        ),
        (
            "wgs84",
            LlaDeg::new(-33.5, -179.999, 35_786e3),
            [-35_165_507.599_740_52, -613.753_890_823_395_4, -23_251_951.244_399_67],
        ),
        (
            "wgs84",
            LlaDeg::new(89.9999, 30.0, -5000.0),
            [9.665_424_877_88, 5.580_335_655_08, 6_351_752.314_235_44],
        ),
        (
            "krasovsky",
            LlaDeg::new(55.0, 37.0, 200.0),
            [2_928_412.041_737_43, 2_206_716.754_421_03, 5_201_638.766_330_3],
        ),
    ];
    for (name, lla, expected) in cases {
        let ell = Ellipsoid::by_name(name).unwrap();
        let ecef = lla_to_ecef(&ell, &lla.into());
        assert_abs_diff_eq!(ecef.0, Vector3::from(expected), epsilon = 2e-8);
        assert!(distance_m(&lla.into(), &ecef_to_lla(&ell, &Ecef(expected.into()))) < 2e-8);
    }
}

#[test]
fn geodetic_round_trip_is_1e_8_m_near_earth_and_1e_7_m_at_geo() {
    let (mut near, mut far) = (0.0f64, 0.0f64);
    for ell in ALL {
        for step in -360..=360 {
            let lat = f64::from(step) * PI / 720.0;
            for lon in [-PI, -3.1, -FRAC_PI_2, -0.3, 0.0, 1e-9, 1.0, PI - 6e-10] {
                for height in [-10_000.0, -100.0, 0.0, 500.0, 20_000.0, 1e6, 3.5786e7, 4.0e7] {
                    let lla = Lla::new(lat, lon, height);
                    let back = ecef_to_lla(&ell, &lla_to_ecef(&ell, &lla));
                    let error = distance_m(&lla, &back);
                    if height <= 20_000.0 { near = near.max(error) } else { far = far.max(error) }
                }
            }
        }
    }
    println!("round trip: {near:e} m near Earth, {far:e} m to GEO");
    assert!(near < 1e-8, "{near}");
    assert!(far < 1e-7, "{far}");
}

#[test]
fn poles_equator_dateline_and_centre_have_defined_answers() {
    let ell = Ellipsoid::WGS84;
    let at = |x: f64, y: f64, z: f64| ecef_to_lla(&ell, &Ecef(Vector3::new(x, y, z)));
    let north = at(0.0, 0.0, ell.semi_minor_m + 100.0);
    assert_eq!((north.lat_rad, north.lon_rad), (FRAC_PI_2, 0.0));
    assert_abs_diff_eq!(north.height_m, 100.0, epsilon = 1e-8);
    assert_eq!(at(0.0, 0.0, -7e6).lat_rad, -FRAC_PI_2);
    let equator = at(0.0, -ell.semi_major_m, 0.0);
    assert_eq!((equator.lat_rad, equator.lon_rad, equator.height_m), (0.0, -FRAC_PI_2, 0.0));
    assert_eq!(at(-7e6, 0.0, 0.0).lon_rad, -PI);
    assert_eq!(at(-7e6, -0.0, 0.0).lon_rad, -PI);
    let centre = at(0.0, 0.0, 0.0);
    assert_abs_diff_eq!(centre.lat_rad, FRAC_PI_2, epsilon = 1e-15);
    assert_eq!(centre.lon_rad, 0.0);
    assert_abs_diff_eq!(centre.height_m, -ell.semi_minor_m, epsilon = 1e-8);
    assert!(at(f64::NAN, 0.0, 0.0).height_m.is_nan());
}

#[test]
fn every_point_inside_the_earth_is_on_the_normal_of_its_answer() {
    let ell = Ellipsoid::WGS84;
    for radius in [1.0, 1e3, 4e4, 5e4, 3e5, 9.99e5, 1.001e6, 2e6, 5e6] {
        for step in -18..=18 {
            let angle = f64::from(step) * PI / 36.0;
            let r_e = Vector3::new(radius * angle.cos(), 0.0, radius * angle.sin());
            let point = Geodetic::of(&ell, &r_e);
            let r_n = ell.radii(point.sin_lat).prime_vertical_m;
            let back = Vector3::new(
                (r_n + point.height_m) * point.cos_lat,
                0.0,
                ((1.0 - ell.e2) * r_n + point.height_m) * point.sin_lat,
            );
            assert!((back - r_e).norm() < 1e-8, "{radius} {angle}: {}", (back - r_e).norm());
            assert!(point.height_m <= radius - ell.semi_minor_m + 1e-6);
        }
    }
}

#[test]
fn geodetic_sines_equal_those_of_the_angles() {
    for lat in latitudes() {
        let lla = Lla::new(lat, 2.5, 7000.0);
        let point = Geodetic::of(&Ellipsoid::WGS84, &lla_to_ecef(&Ellipsoid::WGS84, &lla).0);
        assert_abs_diff_eq!(point.sin_lat, lat.sin(), epsilon = 1e-15);
        assert_abs_diff_eq!(point.cos_lat, lat.cos(), epsilon = 1e-15);
        assert_abs_diff_eq!(
            point.c_ne(),
            c_ne(lat, if point.sin_lon == 0.0 { 0.0 } else { 2.5 }),
            epsilon = 1e-14
        );
    }
}

#[test]
fn local_axes_point_north_east_and_down() {
    let at_gulf = c_ne(0.0, 0.0);
    assert_eq!(at_gulf * Vector3::z(), Vector3::x());
    assert_eq!(at_gulf * Vector3::y(), Vector3::y());
    assert_eq!(at_gulf * Vector3::x(), -Vector3::z());
    for lat in latitudes() {
        let c = c_ne(lat, 1.9);
        assert_abs_diff_eq!(c * c.transpose(), Matrix3::identity(), epsilon = 1e-15);
        assert_abs_diff_eq!(c.determinant(), 1.0, epsilon = 1e-15);
    }
}

#[test]
fn enu_is_ned_under_one_constant_rotation() {
    assert_eq!(C_UN * C_UN, Matrix3::identity());
    assert_eq!(C_UN.determinant(), 1.0);
    assert_eq!(Enu::from(Ned(Vector3::new(1.0, 2.0, 3.0))), Enu(Vector3::new(2.0, 1.0, -3.0)));
    assert_eq!(Ned::from(Enu(Vector3::new(2.0, 1.0, -3.0))), Ned(Vector3::new(1.0, 2.0, 3.0)));
}

#[test]
fn tangent_plane_displacement_equals_the_worked_example_and_returns() {
    let ell = Ellipsoid::WGS84;
    let origin: Lla = LlaDeg::new(46.0, 7.0, 1500.0).into();
    let point = lla_to_ecef(&ell, &LlaDeg::new(46.02, 7.03, 2500.0).into());
    let ned = ecef_to_ned(&ell, &origin, &point);
    assert_abs_diff_eq!(
        ned.0,
        Vector3::new(2_224.340_553_163, 2_323.970_408_493, -999.189_215_583),
        epsilon = 5e-9
    );
    let enu = ecef_to_enu(&ell, &origin, &point);
    assert_eq!(enu, Enu::from(ned));
    assert_abs_diff_eq!(ned_to_ecef(&ell, &origin, &ned).0, point.0, epsilon = 3e-9);
    assert_abs_diff_eq!(enu_to_ecef(&ell, &origin, &enu).0, point.0, epsilon = 3e-9);
}

#[test]
fn wrapped_angles_lie_in_minus_pi_to_pi() {
    assert_eq!(wrap_pi(PI), -PI);
    assert_eq!(wrap_pi(-PI), -PI);
    assert_abs_diff_eq!(wrap_pi(3.0 * PI + 0.25), -PI + 0.25, epsilon = 1e-14);
    assert_abs_diff_eq!(wrap_pi(-0.25 - 4.0 * PI), -0.25, epsilon = 1e-14);
    assert!(wrap_pi(f64::NAN).is_nan() && wrap_pi(f64::INFINITY).is_nan());
    for near in [PI, -PI, 3.0 * PI, -3.0 * PI, 101.0 * PI, -101.0 * PI] {
        for angle in [near.next_down(), near, near.next_up()] {
            assert!((-PI..PI).contains(&wrap_pi(angle)), "{angle}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..Default::default() })]

    #[test]
    fn any_position_survives_ecef(
        lat in -FRAC_PI_2..=FRAC_PI_2,
        lon in -PI..PI,
        height in -1e4f64..5e4,
        body in 0usize..4,
    ) {
        let lla = Lla::new(lat, lon, height);
        prop_assert!(distance_m(&lla, &ecef_to_lla(&ALL[body], &lla_to_ecef(&ALL[body], &lla))) < 1e-8);
    }

    #[test]
    fn any_finite_point_gives_a_finite_position(
        x in -1e9f64..1e9,
        y in -1e9f64..1e9,
        z in -1e9f64..1e9,
        scale in -12i32..1,
    ) {
        let r_e = Vector3::new(x, y, z) * 10f64.powi(scale);
        let lla = ecef_to_lla(&Ellipsoid::WGS84, &Ecef(r_e));
        prop_assert!(lla.is_valid());
        prop_assert!((lla_to_ecef(&Ellipsoid::WGS84, &lla).0 - r_e).norm() < 1e-8 + 1e-15 * r_e.norm());
    }

    #[test]
    fn degrees_survive_radians(lat in -90.0f64..90.0, lon in -180.0f64..180.0, height in -1e4f64..1e7) {
        let deg = LlaDeg::new(lat, lon, height);
        let back = LlaDeg::from(Lla::from(deg));
        prop_assert!((back.lat_deg - lat).abs() < 3e-14 && (back.lon_deg - lon).abs() < 6e-14);
    }

    #[test]
    fn wrapping_keeps_the_angle(turns in -1000i32..1000, angle in -PI..PI) {
        let wrapped = wrap_pi(angle + f64::from(turns) * TAU);
        prop_assert!((-PI..PI).contains(&wrapped));
        prop_assert!((wrapped - angle).abs() < 1e-11 || (wrapped - angle).abs() > TAU - 1e-11);
    }
}
