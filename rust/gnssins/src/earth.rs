//! Ellipsoids of revolution: radii of curvature, normal gravity with height, Earth rate and transport rate.
//!
//! # Gravity model
//!
//! With $s=\sin\varphi$, $c=\cos\varphi$ and height $h$ above the ellipsoid the down component is
//! Somigliana's surface value with the second-order free-air series (Groves 2013, eq. 2.134 and 2.139;
//! Heiskanen & Moritz 1967, eq. 2-123):
//!
//! $$g_D=\gamma_0\,(1-Ah+Bh^2),\quad
//!   \gamma_0=\gamma_e\frac{1+k s^2}{\sqrt{1-e^2s^2}},\quad
//!   A=\tfrac{2}{a}(1+f+m-2fs^2),\quad B=\tfrac{3}{a^2},\quad m=\frac{\omega^2a^2b}{GM}$$
//!
//! The north component follows from it: gravity has a potential, and in the meridian plane a field without
//! curl obeys $\partial_h[(R_M+h)g_N]=-\partial_\varphi g_D$. Integrated from the ellipsoid, where $g_N=0$
//! because it is level,
//!
//! $$g_N=-\frac{s\,c\,h}{R_M+h}
//!   \Big[2\gamma_0'\big(1-\tfrac{Ah}{2}+\tfrac{Bh^2}{3}\big)+\frac{4f}{a}\gamma_0h\Big],
//!   \qquad \gamma_0'=\frac{d\gamma_0}{d(s^2)}$$
//!
//! For WGS-84 the leading term is the $-8.08\cdot10^{-9}\,h\sin2\varphi$ of Groves (2013, eq. 2.140) within
//! 1 %. With both components from one potential the gradient tensor is symmetric, and $g_N\tan\varphi$ is
//! finite at the poles.
//!
//! Largest error against the closed form of the level ellipsoid (NIMA TR8350.2, 3rd ed., chapter 4) at any
//! latitude:
//!
//! | height | 0 | 1 km | 5 km | 10 km | 20 km |
//! |---|---|---|---|---|---|
//! | down (m/s²) | 4e-11 | 1.0e-7 | 4.3e-7 | 7.0e-7 | 1.5e-6 |
//! | north (m/s²) | 0 | 9e-12 | 1.8e-10 | 5.6e-10 | 1.1e-9 |
//!
//! The series is meant for -10 km to 50 km (2e-5 m/s²) and means nothing at satellite heights.

use crate::frames::Geodetic;
use crate::math;
use nalgebra::{Matrix3, Vector3};

/// Rotation rate of the Earth used with every ellipsoid here (rad/s). NIMA TR8350.2, GRS-80 and PZ-90 agree
/// on it.
pub const EARTH_RATE_RAD_S: f64 = 7.292_115e-5;

/// An ellipsoid of revolution with its rotation and its normal gravity.
///
/// `e2`, `semi_minor_m`, `somigliana_k` and `gravity_ratio_m` follow from the others: build with
/// [`Ellipsoid::new`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipsoid {
    /// Semi-major axis a (m).
    pub semi_major_m: f64,
    /// Flattening f = (a - b) / a.
    pub flattening: f64,
    /// Rotation rate (rad/s).
    pub omega_rad_s: f64,
    /// Gravitational constant with the atmosphere, GM (m³/s²).
    pub gm_m3_s2: f64,
    /// Normal gravity on the ellipsoid at the equator (m/s²).
    pub gamma_equator_m_s2: f64,
    /// Normal gravity on the ellipsoid at the poles (m/s²).
    pub gamma_pole_m_s2: f64,
    /// First eccentricity squared, f (2 - f).
    pub e2: f64,
    /// Semi-minor axis b (m).
    pub semi_minor_m: f64,
    /// Somigliana's constant k = b γ_p / (a γ_e) - 1.
    pub somigliana_k: f64,
    /// Centrifugal over gravitational acceleration at the equator, m = ω² a² b / GM.
    pub gravity_ratio_m: f64,
}

/// Radii of curvature (m), or their derivatives with respect to latitude (m/rad).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Radii {
    /// Meridian (north-south) radius R_M.
    pub meridian_m: f64,
    /// Prime-vertical (east-west) radius R_N.
    pub prime_vertical_m: f64,
}

/// Which normal gravity the navigation equations use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Gravity {
    /// Down and north components of one potential.
    #[default]
    #[cfg_attr(feature = "serde", serde(rename = "normal"))]
    Normal,
    /// The down component alone, as in publications that write [0, 0, g].
    #[cfg_attr(feature = "serde", serde(rename = "vertical"))]
    NormalVertical,
}

/// WGS-84, see [`Ellipsoid::WGS84`].
pub const WGS84: Ellipsoid = Ellipsoid::WGS84;
/// GRS-80, see [`Ellipsoid::GRS80`].
pub const GRS80: Ellipsoid = Ellipsoid::GRS80;
/// PZ-90, see [`Ellipsoid::PZ90`].
pub const PZ90: Ellipsoid = Ellipsoid::PZ90;
/// Krasovsky 1940, see [`Ellipsoid::KRASOVSKY`].
pub const KRASOVSKY: Ellipsoid = Ellipsoid::KRASOVSKY;

impl Ellipsoid {
    /// World Geodetic System 1984. Source: NIMA TR8350.2, 3rd ed. (2000), tables 3.1, 3.3 and 3.4.
    pub const WGS84: Self = Self::new(
        6_378_137.0,
        1.0 / 298.257_223_563,
        EARTH_RATE_RAD_S,
        3.986_004_418e14,
        9.780_325_335_9,
        9.832_184_937_9,
    );

    /// Geodetic Reference System 1980. Source: Moritz, "Geodetic Reference System 1980", Bulletin Géodésique
    /// 62 (1988).
    pub const GRS80: Self = Self::new(
        6_378_137.0,
        1.0 / 298.257_222_101,
        EARTH_RATE_RAD_S,
        3.986_005e14,
        9.780_326_771_5,
        9.832_186_368_5,
    );

    /// Parametry Zemli 1990, the frame of GLONASS. Source of the figure and of GM: EPSG ellipsoid 7054.
    ///
    /// The two gravity values are those of the level ellipsoid with these constants; the GLONASS interface
    /// document prints the equatorial one as 978 032.84 mGal.
    pub const PZ90: Self = Self::new(
        6_378_136.0,
        1.0 / 298.257_839_303,
        EARTH_RATE_RAD_S,
        3.986_004_418e14,
        9.780_328_358_5,
        9.832_188_005_0,
    );

    /// Krasovsky 1940, the figure of SK-42. Source of the figure: EPSG ellipsoid 7024. Gravity: Helmert
    /// 1901-1909, γ = 9.780 30 (1 + 0.005 302 sin²φ - 0.000 007 sin² 2φ) m/s², taken at the equator and at
    /// the poles.
    ///
    /// Krasovsky's ellipsoid is a figure fitted to the geoid of one country and not to the centre of the
    /// Earth; it has no normal field of its own, and surveys in SK-42 used Helmert's. Somigliana's curve
    /// through the two end values follows Helmert's series within 1.2 mGal and GRS-80 within 3.2 mGal. The
    /// alternative, a level ellipsoid with these axes, would be 34 mGal too low wherever the height is small,
    /// because its surface lies 108 m outside the mean Earth ellipsoid. The old Potsdam correction (-14 mGal)
    /// is left out: with it the formula misses GRS-80 by 17 mGal. GM is that of WGS-84 and enters the height
    /// term only.
    pub const KRASOVSKY: Self = Self::new(
        6_378_245.0,
        1.0 / 298.3,
        EARTH_RATE_RAD_S,
        3.986_004_418e14,
        9.780_30,
        9.780_30 * 1.005_302,
    );

    /// Names that [`Ellipsoid::by_name`] knows.
    pub const NAMES: [&'static str; 4] = ["wgs84", "grs80", "pz90", "krasovsky"];

    /// Ellipsoid from its defining constants: axis (m), flattening, rotation (rad/s), GM (m³/s²) and normal
    /// gravity at the equator and at the poles (m/s²).
    #[must_use]
    pub const fn new(
        semi_major_m: f64,
        flattening: f64,
        omega_rad_s: f64,
        gm_m3_s2: f64,
        gamma_equator_m_s2: f64,
        gamma_pole_m_s2: f64,
    ) -> Self {
        let semi_minor_m = semi_major_m * (1.0 - flattening);
        Self {
            semi_major_m,
            flattening,
            omega_rad_s,
            gm_m3_s2,
            gamma_equator_m_s2,
            gamma_pole_m_s2,
            e2: flattening * (2.0 - flattening),
            semi_minor_m,
            somigliana_k: semi_minor_m * gamma_pole_m_s2 / (semi_major_m * gamma_equator_m_s2) - 1.0,
            gravity_ratio_m: omega_rad_s * omega_rad_s * semi_major_m * semi_major_m * semi_minor_m
                / gm_m3_s2,
        }
    }

    /// One of [`Ellipsoid::NAMES`], or `None`.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        match name {
            "wgs84" => Some(Self::WGS84),
            "grs80" => Some(Self::GRS80),
            "pz90" => Some(Self::PZ90),
            "krasovsky" => Some(Self::KRASOVSKY),
            _ => None,
        }
    }

    /// Radii of curvature at a latitude (m): $R_N=a/\sqrt{1-e^2s^2}$, $R_M=a(1-e^2)/(1-e^2s^2)^{3/2}$.
    ///
    /// Groves (2013), eq. 2.105 and 2.106.
    #[inline]
    #[must_use]
    pub fn radii(&self, sin_lat: f64) -> Radii {
        let per_w = 1.0 / math::sqrt(1.0 - self.e2 * (sin_lat * sin_lat));
        let prime_vertical_m = self.semi_major_m * per_w;
        Radii { meridian_m: prime_vertical_m * (1.0 - self.e2) * (per_w * per_w), prime_vertical_m }
    }

    /// The meridian radius within a millionth, without a root: enough to say where the middle of an interval is.
    #[inline(always)]
    pub(crate) fn meridian_nearly(&self, sin_lat: f64) -> f64 {
        let x = self.e2 * (sin_lat * sin_lat);
        self.semi_major_m * (1.0 - self.e2) * (1.0 + x * (1.5 + 1.875 * x))
    }

    /// Derivatives of the radii with respect to latitude (m/rad):
    /// $R_M'=3e^2sc\,R_M/(1-e^2s^2)$, $R_N'=e^2sc\,R_N/(1-e^2s^2)$.
    #[inline]
    #[must_use]
    pub fn radii_rate(&self, sin_lat: f64, cos_lat: f64) -> Radii {
        let radii = self.radii(sin_lat);
        let share = self.e2 * sin_lat * cos_lat / (1.0 - self.e2 * (sin_lat * sin_lat));
        Radii { meridian_m: 3.0 * share * radii.meridian_m, prime_vertical_m: share * radii.prime_vertical_m }
    }

    /// Earth rate resolved in north-east-down (rad/s): $\omega\,[c,\ 0,\ -s]$. Groves (2013), eq. 2.123.
    #[inline]
    #[must_use]
    pub fn earth_rate_n(&self, sin_lat: f64, cos_lat: f64) -> Vector3<f64> {
        Vector3::new(self.omega_rad_s * cos_lat, 0.0, -self.omega_rad_s * sin_lat)
    }

    /// Gravity (attraction and centrifugal) resolved in north-east-down (m/s²); formula in the page of this
    /// module.
    #[inline]
    #[must_use]
    pub fn gravity_n(&self, model: Gravity, sin_lat: f64, cos_lat: f64, height_m: f64) -> Vector3<f64> {
        let t = Terms::at(self, sin_lat, height_m);
        let north = match model {
            Gravity::Normal => sin_lat * cos_lat * t.north_over_sc,
            Gravity::NormalVertical => 0.0,
        };
        Vector3::new(north, 0.0, t.down)
    }

    /// Derivatives of [`Ellipsoid::gravity_n`]'s components with respect to latitude (m/s² per rad) and to
    /// height (m/s² per m), exact for the implemented formula. The axes turn with the point: only components
    /// are differentiated.
    #[must_use]
    pub fn gravity_rates_n(
        &self,
        model: Gravity,
        sin_lat: f64,
        cos_lat: f64,
        height_m: f64,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let (_, by_lat, by_height) = self.gravity_and_rates_n(model, sin_lat, cos_lat, height_m);
        (by_lat, by_height)
    }

    /// [`Ellipsoid::gravity_n`] and [`Ellipsoid::gravity_rates_n`] together.
    #[inline(always)]
    pub(crate) fn gravity_and_rates_n(
        &self,
        model: Gravity,
        sin_lat: f64,
        cos_lat: f64,
        height_m: f64,
    ) -> (Vector3<f64>, Vector3<f64>, Vector3<f64>) {
        let rates = Rates::at(self, model, sin_lat, cos_lat, height_m);
        (rates.gravity(), rates.by_lat, rates.by_height)
    }

    /// Gravity resolved in ECEF axes at an ECEF point (m/s²): `c_en * gravity_n` at the geodetic point.
    #[must_use]
    pub fn gravity_e(&self, model: Gravity, r_e: &Vector3<f64>) -> Vector3<f64> {
        let point = Geodetic::of(self, r_e);
        let g_n = self.gravity_n(model, point.sin_lat, point.cos_lat, point.height_m);
        point.turn_to_e(&g_n)
    }

    /// Gravity (m/s²) and its Jacobian with respect to the position (1/s²), both in ECEF axes, for one
    /// conversion of the point. See [`Ellipsoid::gravity_gradient_e`].
    #[must_use]
    pub fn gravity_and_gradient_e(&self, model: Gravity, r_e: &Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        let point = Geodetic::of(self, r_e);
        let rates = Rates::at(self, model, point.sin_lat, point.cos_lat, point.height_m);
        let c_en = point.c_en();
        (point.turn_to_e(&rates.gravity()), c_en * rates.gradient() * c_en.transpose())
    }

    /// Jacobian of [`Ellipsoid::gravity_e`] with respect to `r_e` (1/s²), analytic.
    ///
    /// In local axes a displacement (N, E, D) changes latitude by $dN/(R_M+h)$ and height by $-dD$, and turns
    /// the axes by $d\theta=[dE/(R_N+h),\ -dN/(R_M+h),\ -\tan\varphi\,dE/(R_N+h)]$, so
    /// $dg=\gamma_\varphi d\varphi+\gamma_h dh+d\theta\times\gamma$. The product $\tan\varphi\,g_N$ is formed
    /// as $s^2\,(g_N/sc)$: nothing grows at the poles. Symmetric for [`Gravity::Normal`], which has a potential;
    /// its trace is 2ω² (Laplace with the centrifugal part) to the accuracy of the height series.
    #[must_use]
    pub fn gravity_gradient_e(&self, model: Gravity, r_e: &Vector3<f64>) -> Matrix3<f64> {
        self.gravity_and_gradient_e(model, r_e).1
    }

    /// The same Jacobian in north-east-down axes: change of the gravity vector for a displacement, with the
    /// axes of the undisplaced point kept (1/s²).
    #[must_use]
    pub fn gravity_gradient_n(
        &self,
        model: Gravity,
        sin_lat: f64,
        cos_lat: f64,
        height_m: f64,
    ) -> Matrix3<f64> {
        Rates::at(self, model, sin_lat, cos_lat, height_m).gradient()
    }
}

/// Transport rate of n over the ellipsoid, resolved in n (rad/s).
/// $$\omega_{en}^n=[\,v_E/(R_N+h),\ -v_N/(R_M+h),\ -v_E\tan\varphi/(R_N+h)\,]$$
/// Groves (2013), eq. 5.44. Grows without bound at the poles: the ECEF model has no such term.
#[inline]
#[must_use]
pub fn transport_rate_n(radii: &Radii, tan_lat: f64, height_m: f64, v_n: &Vector3<f64>) -> Vector3<f64> {
    let east = v_n.y / (radii.prime_vertical_m + height_m);
    Vector3::new(east, -v_n.x / (radii.meridian_m + height_m), -east * tan_lat)
}

/// Parts of the gravity formula at one point, u = sin²φ.
struct Terms {
    /// Surface gravity γ0 and its first two derivatives with respect to u (m/s²).
    gamma: [f64; 3],
    /// dA/du of the height series (1/m).
    slope_by_u: f64,
    /// 1 - Ah/2 + Bh²/3, the mean of the height series.
    mean: f64,
    meridian_plus_h: f64,
    /// Down component, and its derivatives with respect to u and to height.
    down: f64,
    down_by_u: f64,
    down_by_height: f64,
    /// North component divided by sinφ cosφ.
    north_over_sc: f64,
}

impl Terms {
    #[inline(always)]
    fn at(ell: &Ellipsoid, sin_lat: f64, height_m: f64) -> Self {
        let (a, e2, k, h) = (ell.semi_major_m, ell.e2, ell.somigliana_k, height_m);
        let u = sin_lat * sin_lat;
        let w2 = 1.0 - e2 * u;
        let per_w = 1.0 / math::sqrt(w2);
        let per_w2 = per_w * per_w;
        let numerator = 1.0 + k * u;
        let gamma0 = ell.gamma_equator_m_s2 * numerator * per_w;
        let gamma1 = ell.gamma_equator_m_s2 * per_w * (k + 0.5 * e2 * numerator * per_w2);
        let gamma2 = ell.gamma_equator_m_s2 * per_w * per_w2 * e2 * (k + 0.75 * e2 * numerator * per_w2);
        let slope = 2.0 / a * (1.0 + ell.flattening + ell.gravity_ratio_m - 2.0 * ell.flattening * u);
        let slope_by_u = -4.0 * ell.flattening / a;
        let curve = 3.0 / (a * a);
        let series = 1.0 - slope * h + curve * h * h;
        let mean = 1.0 - 0.5 * slope * h + curve * h * h / 3.0;
        let meridian_plus_h = a * (1.0 - e2) * per_w * per_w2 + h;
        Self {
            gamma: [gamma0, gamma1, gamma2],
            slope_by_u,
            mean,
            meridian_plus_h,
            down: gamma0 * series,
            down_by_u: gamma1 * series - gamma0 * slope_by_u * h,
            down_by_height: gamma0 * (2.0 * curve * h - slope),
            north_over_sc: -h * (2.0 * gamma1 * mean - gamma0 * slope_by_u * h) / meridian_plus_h,
        }
    }

    /// Derivative of `north_over_sc` with respect to u.
    fn north_over_sc_by_u(&self, ell: &Ellipsoid, sin_lat: f64, height_m: f64) -> f64 {
        let [_, gamma1, gamma2] = self.gamma;
        let meridian = self.meridian_plus_h - height_m;
        let meridian_by_u = 1.5 * ell.e2 * meridian / (1.0 - ell.e2 * sin_lat * sin_lat);
        let bracket_by_u = 2.0 * gamma2 * self.mean - 2.0 * gamma1 * self.slope_by_u * height_m;
        (-height_m * bracket_by_u - self.north_over_sc * meridian_by_u) / self.meridian_plus_h
    }
}

/// Gravity with its derivatives at one point.
struct Rates {
    north: f64,
    down: f64,
    /// North component times tan φ, finite at the poles.
    tan_times_north: f64,
    by_lat: Vector3<f64>,
    by_height: Vector3<f64>,
    meridian_plus_h: f64,
    prime_vertical_plus_h: f64,
}

impl Rates {
    #[inline(always)]
    fn at(ell: &Ellipsoid, model: Gravity, sin_lat: f64, cos_lat: f64, height_m: f64) -> Self {
        let t = Terms::at(ell, sin_lat, height_m);
        let (s2, sc) = (sin_lat * sin_lat, sin_lat * cos_lat);
        let down_by_lat = 2.0 * sc * t.down_by_u;
        let (over_sc, north_by_lat, north_by_height) = match model {
            Gravity::NormalVertical => (0.0, 0.0, 0.0),
            Gravity::Normal => (
                t.north_over_sc,
                (cos_lat * cos_lat - s2) * t.north_over_sc
                    + 2.0 * sc * sc * t.north_over_sc_by_u(ell, sin_lat, height_m),
                // The condition of no curl, see the page of this module.
                -(sc * t.north_over_sc + down_by_lat) / t.meridian_plus_h,
            ),
        };
        let meridian = t.meridian_plus_h - height_m;
        Self {
            north: sc * over_sc,
            down: t.down,
            tan_times_north: s2 * over_sc,
            by_lat: Vector3::new(north_by_lat, 0.0, down_by_lat),
            by_height: Vector3::new(north_by_height, 0.0, t.down_by_height),
            meridian_plus_h: t.meridian_plus_h,
            prime_vertical_plus_h: meridian * (1.0 - ell.e2 * s2) / (1.0 - ell.e2) + height_m,
        }
    }

    fn gravity(&self) -> Vector3<f64> {
        Vector3::new(self.north, 0.0, self.down)
    }

    fn gradient(&self) -> Matrix3<f64> {
        let per_n = 1.0 / self.meridian_plus_h;
        Matrix3::new(
            (self.by_lat.x - self.down) * per_n,
            0.0,
            -self.by_height.x,
            0.0,
            -(self.down + self.tan_times_north) / self.prime_vertical_plus_h,
            0.0,
            (self.by_lat.z + self.north) * per_n,
            0.0,
            -self.by_height.z,
        )
    }
}
