//! Radii, gravity and rates of the ellipsoid against closed forms, worked numbers and finite differences.

use approx::assert_abs_diff_eq;
use gnssins::attitude::{from_dcm, log};
use gnssins::earth::{Ellipsoid, Gravity, transport_rate_n};
use gnssins::frames::{Geodetic, Lla, LlaDeg, c_ne, lla_to_ecef};
use nalgebra::Vector3;
use std::f64::consts::PI;

const ALL: [Ellipsoid; 4] = [Ellipsoid::WGS84, Ellipsoid::GRS80, Ellipsoid::PZ90, Ellipsoid::KRASOVSKY];
const WITH_OWN_FIELD: [Ellipsoid; 3] = [Ellipsoid::WGS84, Ellipsoid::GRS80, Ellipsoid::PZ90];

/// Exact normal gravity of the level ellipsoid: NIMA TR8350.2, 3rd ed., chapter 4 (Heiskanen & Moritz 1967,
/// sections 2-7 and 2-8).
struct LevelEllipsoid {
    ell: Ellipsoid,
    focal: f64,
    q0: f64,
}

impl LevelEllipsoid {
    fn new(ell: Ellipsoid) -> Self {
        let focal = (ell.semi_major_m.powi(2) - ell.semi_minor_m.powi(2)).sqrt();
        Self { ell, focal, q0: q(ell.semi_minor_m / focal) }
    }

    /// Equatorial and polar surface gravity, Heiskanen & Moritz 2-73 and 2-74.
    fn surface(&self) -> (f64, f64) {
        let (a, b, m) = (self.ell.semi_major_m, self.ell.semi_minor_m, self.ell.gravity_ratio_m);
        let term = m * self.focal / b * q_prime(b / self.focal) / self.q0;
        let gm = self.ell.gm_m3_s2;
        (gm / (a * b) * (1.0 - m - term / 6.0), gm / (a * a) * (1.0 + term / 3.0))
    }

    /// North and down gravity at a latitude and a height above the ellipsoid.
    fn gravity(&self, lat: f64, height: f64) -> (f64, f64) {
        let (s, c) = lat.sin_cos();
        let r = lla_to_ecef(&self.ell, &Lla::new(lat, 0.0, height)).0;
        let (p, z, focal2) = (r.x, r.z, self.focal.powi(2));
        let difference = p * p + z * z - focal2;
        let u2 = 0.5 * difference * (1.0 + (1.0 + 4.0 * focal2 * z * z / difference.powi(2)).sqrt());
        let (u, v) = (u2.sqrt(), (u2 + focal2).sqrt());
        let beta = (z * v).atan2(u * p);
        let (sb, cb) = beta.sin_cos();
        let w = ((u2 + focal2 * sb * sb) / (u2 + focal2)).sqrt();
        let spin = (self.ell.omega_rad_s * self.ell.semi_major_m).powi(2);
        let omega2 = self.ell.omega_rad_s.powi(2);
        let along_u = (-(self.ell.gm_m3_s2
            + spin * self.focal * q_prime(u / self.focal) / self.q0 * (0.5 * sb * sb - 1.0 / 6.0))
            / (v * v)
            + omega2 * u * cb * cb)
            / w;
        let along_beta = (spin / v * q(u / self.focal) / self.q0 - omega2 * v) * sb * cb / w;
        let outward = (u / v * cb * along_u - sb * along_beta) / w;
        let polar = (sb * along_u + u / v * cb * along_beta) / w;
        (c * polar - s * outward, -s * polar - c * outward)
    }
}

fn q(x: f64) -> f64 {
    0.5 * ((1.0 + 3.0 * x * x) * (1.0 / x).atan() - 3.0 * x)
}

fn q_prime(x: f64) -> f64 {
    3.0 * (1.0 + x * x) * (1.0 - x * (1.0 / x).atan()) - 1.0
}

fn latitudes() -> impl Iterator<Item = f64> {
    (-90..=90).step_by(5).map(|d| f64::from(d).to_radians())
}

#[test]
fn radii_equal_the_worked_numbers_of_wgs84() {
    let at = |deg: f64| Ellipsoid::WGS84.radii(deg.to_radians().sin());
    assert_abs_diff_eq!(at(45.0).prime_vertical_m, 6_388_838.290_121_148, epsilon = 1e-8);
    assert_abs_diff_eq!(at(45.0).meridian_m, 6_367_381.815_619_549, epsilon = 1e-8);
    assert_abs_diff_eq!(at(-60.0).prime_vertical_m, 6_394_209.173_847_894, epsilon = 1e-8);
    assert_abs_diff_eq!(at(-60.0).meridian_m, 6_383_453.857_229_078, epsilon = 1e-8);
    // At the poles both equal a²/b.
    let polar = Ellipsoid::WGS84.semi_major_m.powi(2) / Ellipsoid::WGS84.semi_minor_m;
    assert_abs_diff_eq!(at(90.0).prime_vertical_m, polar, epsilon = 1e-8);
    assert_abs_diff_eq!(at(90.0).meridian_m, polar, epsilon = 1e-8);
}

#[test]
fn eccentricities_equal_the_published_ones() {
    assert_abs_diff_eq!(Ellipsoid::WGS84.e2, 6.694_379_990_14e-3, epsilon = 1e-14);
    assert_abs_diff_eq!(Ellipsoid::GRS80.e2, 6.694_380_022_90e-3, epsilon = 1e-14);
    assert_abs_diff_eq!(Ellipsoid::PZ90.e2, 6.694_366_19e-3, epsilon = 1e-11);
    assert_abs_diff_eq!(Ellipsoid::KRASOVSKY.e2, 6.693_421_62e-3, epsilon = 1e-11);
}

#[test]
fn radii_rate_is_the_derivative_of_radii() {
    let step = 1e-4;
    for ell in ALL {
        for lat in latitudes() {
            let rate = ell.radii_rate(lat.sin(), lat.cos());
            let (above, below) = (ell.radii((lat + step).sin()), ell.radii((lat - step).sin()));
            let slope = |hi: f64, lo: f64| (hi - lo) / (2.0 * step);
            assert_abs_diff_eq!(rate.meridian_m, slope(above.meridian_m, below.meridian_m), epsilon = 2e-3);
            assert_abs_diff_eq!(
                rate.prime_vertical_m,
                slope(above.prime_vertical_m, below.prime_vertical_m),
                epsilon = 2e-3
            );
        }
    }
}

#[test]
fn gravity_constants_are_those_of_a_level_ellipsoid() {
    for ell in WITH_OWN_FIELD {
        let (equator, pole) = LevelEllipsoid::new(ell).surface();
        assert_abs_diff_eq!(ell.gamma_equator_m_s2, equator, epsilon = 1e-10);
        assert_abs_diff_eq!(ell.gamma_pole_m_s2, pole, epsilon = 1e-10);
    }
}

#[test]
fn krasovsky_gravity_follows_helmert_and_grs80() {
    let level = LevelEllipsoid::new(Ellipsoid::KRASOVSKY);
    for lat in latitudes() {
        let (s, c) = lat.sin_cos();
        let down = Ellipsoid::KRASOVSKY.gravity_n(Gravity::Normal, s, c, 0.0).z;
        let helmert = 9.780_30 * (1.0 + 0.005_302 * s * s - 0.000_007 * (2.0 * s * c).powi(2));
        let grs80 = Ellipsoid::GRS80.gravity_n(Gravity::Normal, s, c, 0.0).z;
        assert!((down - helmert).abs() < 1.2e-5, "{lat}: {}", down - helmert);
        assert!((down - grs80).abs() < 3.2e-5, "{lat}: {}", down - grs80);
        // The level ellipsoid of the same axes is the worse choice that the documentation speaks of.
        assert_abs_diff_eq!(grs80 - level.gravity(lat, 0.0).1, 34e-5, epsilon = 1e-5);
    }
}

#[test]
fn surface_gravity_is_the_closed_form_within_1e_9() {
    assert_abs_diff_eq!(
        Ellipsoid::WGS84.gravity_n(Gravity::Normal, 0.5f64.sqrt(), 0.5f64.sqrt(), 0.0).z,
        9.806_197_769_377_376,
        epsilon = 1e-10
    );
    for ell in WITH_OWN_FIELD {
        let level = LevelEllipsoid::new(ell);
        for lat in latitudes() {
            let g_n = ell.gravity_n(Gravity::Normal, lat.sin(), lat.cos(), 0.0);
            let (north, down) = level.gravity(lat, 0.0);
            assert_abs_diff_eq!(g_n.z, down, epsilon = 1e-9);
            assert_abs_diff_eq!(g_n.x, north, epsilon = 1e-9);
        }
    }
}

#[test]
fn gravity_at_height_is_the_closed_form_within_the_stated_bounds() {
    for ell in WITH_OWN_FIELD {
        let level = LevelEllipsoid::new(ell);
        // height, bound of the down component, bound of the north component
        for (height, down_bound, north_bound) in [
            (-1000.0, 1.2e-7, 1.0e-10),
            (1000.0, 1.1e-7, 1.0e-10),
            (5000.0, 4.5e-7, 3.0e-10),
            (10_000.0, 7.2e-7, 7.0e-10),
            (20_000.0, 1.5e-6, 1.2e-9),
        ] {
            for lat in latitudes() {
                let g_n = ell.gravity_n(Gravity::Normal, lat.sin(), lat.cos(), height);
                let (north, down) = level.gravity(lat, height);
                assert!((g_n.z - down).abs() < down_bound, "{height} {lat} {}", g_n.z - down);
                assert!((g_n.x - north).abs() < north_bound, "{height} {lat} {}", g_n.x - north);
            }
        }
    }
}

#[test]
fn north_gravity_is_the_published_coefficient_within_one_per_cent() {
    // Groves (2013), eq. 2.140: -8.08e-9 h sin 2φ.
    for height in [100.0, 1000.0, 9000.0] {
        let lat: f64 = 0.7;
        let north = Ellipsoid::WGS84.gravity_n(Gravity::Normal, lat.sin(), lat.cos(), height).x;
        assert!((north / (-8.08e-9 * height * (2.0 * lat).sin()) - 1.0).abs() < 0.01);
    }
}

#[test]
fn vertical_gravity_keeps_down_and_drops_north() {
    let normal = Ellipsoid::WGS84.gravity_n(Gravity::Normal, 0.6, 0.8, 5000.0);
    let vertical = Ellipsoid::WGS84.gravity_n(Gravity::NormalVertical, 0.6, 0.8, 5000.0);
    assert_eq!(vertical, Vector3::new(0.0, 0.0, normal.z));
    assert!(normal.x < -1e-5);
}

#[test]
fn gravity_rates_are_the_derivatives_of_gravity() {
    for ell in ALL {
        for model in [Gravity::Normal, Gravity::NormalVertical] {
            for (lat, height) in [-85.0, -40.0, 0.0, 20.0, 45.0, 70.0, 90.0]
                .into_iter()
                .flat_map(|d: f64| [-500.0, 0.0, 3000.0, 20_000.0].map(|h| (d.to_radians(), h)))
            {
                let at = |lat: f64, h: f64| ell.gravity_n(model, lat.sin(), lat.cos(), h);
                let (by_lat, by_height) = ell.gravity_rates_n(model, lat.sin(), lat.cos(), height);
                let lat_slope = (at(lat + 1e-4, height) - at(lat - 1e-4, height)) / 2e-4;
                let height_slope = (at(lat, height + 100.0) - at(lat, height - 100.0)) / 200.0;
                assert_abs_diff_eq!(by_lat, lat_slope, epsilon = 1e-9);
                assert_abs_diff_eq!(by_height, height_slope, epsilon = 1e-15);
            }
        }
    }
}

#[test]
fn ecef_gravity_is_ned_gravity_turned_within_1e_13() {
    for ell in ALL {
        for lat in latitudes() {
            for (lon, height) in [(0.0, 0.0), (2.0, 12_000.0), (-PI, 20_000.0), (-1.3, -400.0)] {
                let r_e = lla_to_ecef(&ell, &Lla::new(lat, lon, height)).0;
                for model in [Gravity::Normal, Gravity::NormalVertical] {
                    let g_n = ell.gravity_n(model, lat.sin(), lat.cos(), height);
                    let expected = c_ne(lat, lon).transpose() * g_n;
                    let g_e = ell.gravity_e(model, &r_e);
                    assert_abs_diff_eq!(g_e, expected, epsilon = 1e-13);
                    let (again, gradient) = ell.gravity_and_gradient_e(model, &r_e);
                    assert_abs_diff_eq!(g_e, again, epsilon = 1e-14);
                    assert_eq!(gradient, ell.gravity_gradient_e(model, &r_e));
                }
            }
        }
    }
}

#[test]
fn gravity_gradient_is_the_jacobian_of_ecef_gravity_poles_included() {
    let step = 100.0;
    for ell in ALL {
        for model in [Gravity::Normal, Gravity::NormalVertical] {
            for lat_deg in [-90.0, -89.9999, -60.0, 0.0, 30.0, 45.0, 89.0, 90.0] {
                for height in [0.0, 15_000.0] {
                    let r_e = lla_to_ecef(&ell, &LlaDeg::new(lat_deg, 50.0, height).into()).0;
                    let gradient = ell.gravity_gradient_e(model, &r_e);
                    for axis in 0..3 {
                        let mut shift = Vector3::zeros();
                        shift[axis] = step;
                        let slope = (ell.gravity_e(model, &(r_e + shift))
                            - ell.gravity_e(model, &(r_e - shift)))
                            / (2.0 * step);
                        assert_abs_diff_eq!(gradient.column(axis).into_owned(), slope, epsilon = 2e-15);
                    }
                }
            }
        }
    }
}

#[test]
fn normal_gravity_has_a_potential_and_obeys_laplace() {
    for ell in WITH_OWN_FIELD {
        for lat in latitudes() {
            for height in [0.0, 5000.0, 20_000.0] {
                let r_e = lla_to_ecef(&ell, &Lla::new(lat, -2.2, height)).0;
                let gradient = ell.gravity_gradient_e(Gravity::Normal, &r_e);
                assert!((gradient - gradient.transpose()).amax() < 1e-20);
                let excess = gradient.trace() - 2.0 * ell.omega_rad_s.powi(2);
                assert!(excess.abs() < 5e-10, "{lat} {height} {excess}");
            }
        }
    }
}

#[test]
fn earth_rate_and_transport_rate_equal_the_worked_numbers() {
    let rate = Ellipsoid::WGS84.earth_rate_n(0.6, 0.8);
    assert_abs_diff_eq!(rate, Vector3::new(5.833_692e-5, 0.0, -4.375_269e-5), epsilon = 1e-18);
    let radii = Ellipsoid::WGS84.radii(0.5f64.sqrt());
    let turn = transport_rate_n(&radii, 1.0, 1000.0, &Vector3::new(200.0, -100.0, 5.0));
    let expected = Vector3::new(
        -100.0 / 6_389_838.290_121_148,
        -200.0 / 6_368_381.815_619_549,
        100.0 / 6_389_838.290_121_148,
    );
    assert_abs_diff_eq!(turn, expected, epsilon = 1e-18);
}

#[test]
fn transport_rate_is_the_turn_of_the_local_axes_along_the_path() {
    let (ell, start) = (Ellipsoid::WGS84, Lla::new(0.9, -1.1, 4000.0));
    let v_n = Vector3::new(120.0, 250.0, -3.0);
    let dt = 0.05;
    let r_e = lla_to_ecef(&ell, &start).0;
    let axes = |t: f64| Geodetic::of(&ell, &(r_e + c_ne(0.9, -1.1).transpose() * v_n * t)).c_ne();
    // C_ne(t) = Exp(-w_en t) C_ne(0) to first order.
    let turned = log(&from_dcm(&(axes(dt) * axes(-dt).transpose()))) / (2.0 * dt);
    let rate = transport_rate_n(&ell.radii(0.9f64.sin()), 0.9f64.tan(), 4000.0, &v_n);
    assert_abs_diff_eq!(turned, -rate, epsilon = 5e-15);
}

#[test]
fn ellipsoid_names_resolve_and_unknown_ones_do_not() {
    for (name, ell) in Ellipsoid::NAMES.into_iter().zip(ALL) {
        assert_eq!(Ellipsoid::by_name(name), Some(ell));
    }
    assert_eq!(Ellipsoid::by_name("wgs-84"), None);
}
