//! Positions on and near the ellipsoid: geodetic, Earth-centred (ECEF) and local tangent plane.
//!
//! Axes: e is Earth-centred Earth-fixed (x to the Greenwich meridian, z to the north pole), n is
//! north-east-down at a point, u is east-north-up at the same point. `c_ne` takes e-vectors to n;
//! neighbouring letters cancel.
//!
//! # Geodetic position from ECEF
//!
//! Bowring's iteration on the reduced latitude β, $\tan\beta=(1-f)\tan\varphi$ (Bowring 1976, "Transformation
//! from spatial to geographical coordinates", Survey Review 23, with the starting value of his 1985 paper in
//! Survey Review 28), done on the pair (sin β, cos β), so it needs square roots only and has no special case
//! at the poles or the equator. Two steps reach rounding from [`DEEP_RADIUS_M`] to beyond geostationary orbit.
//! Nearer to the centre, where the iteration may fail, bisection finds the nearest point of the ellipsoid.
//! Height is taken along the normal,
//! $h=(p-a\cos\beta)\cos\varphi+(z-b\sin\beta)\sin\varphi$, which loses nothing at any latitude.
//!
//! The centre itself is as far from every longitude; the answer is the nearest surface point, the north pole,
//! at longitude zero and height -b.

use crate::earth::Ellipsoid;
use crate::math;
use core::f64::consts::{PI, TAU};
use nalgebra::{Matrix3, Vector3};

/// Distance from the centre (m) below which [`Geodetic::of`] searches by bisection.
pub const DEEP_RADIUS_M: f64 = 1.0e6;

/// Geodetic position in radians and metres.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Lla {
    /// Geodetic latitude (rad), north positive, within ±π/2.
    pub lat_rad: f64,
    /// Longitude (rad), east positive, in [-π, π).
    pub lon_rad: f64,
    /// Height above the ellipsoid (m), up positive.
    pub height_m: f64,
}

/// Geodetic position in degrees and metres, for input and output.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LlaDeg {
    /// Geodetic latitude (deg), north positive.
    pub lat_deg: f64,
    /// Longitude (deg), east positive.
    pub lon_deg: f64,
    /// Height above the ellipsoid (m), up positive.
    pub height_m: f64,
}

/// Position in Earth-centred Earth-fixed axes (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ecef(pub Vector3<f64>);

/// Displacement from an origin in north-east-down axes of the origin (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ned(pub Vector3<f64>);

/// Displacement from an origin in east-north-up axes of the origin (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Enu(pub Vector3<f64>);

/// Constant rotation from north-east-down (n) to east-north-up (u). It is its own inverse.
pub const C_UN: Matrix3<f64> = Matrix3::new(
    0.0, 1.0, 0.0, //
    1.0, 0.0, 0.0, //
    0.0, 0.0, -1.0,
);

impl Lla {
    /// Position from latitude and longitude (rad) and height (m).
    #[must_use]
    pub const fn new(lat_rad: f64, lon_rad: f64, height_m: f64) -> Self {
        Self { lat_rad, lon_rad, height_m }
    }

    /// True when every field is finite and the latitude is within ±π/2.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        math::abs(self.lat_rad) <= 0.5 * PI && self.lon_rad.is_finite() && self.height_m.is_finite()
    }
}

impl LlaDeg {
    /// Position from latitude and longitude (deg) and height (m).
    #[must_use]
    pub const fn new(lat_deg: f64, lon_deg: f64, height_m: f64) -> Self {
        Self { lat_deg, lon_deg, height_m }
    }
}

impl From<LlaDeg> for Lla {
    fn from(p: LlaDeg) -> Self {
        Self::new(p.lat_deg.to_radians(), p.lon_deg.to_radians(), p.height_m)
    }
}

impl From<Lla> for LlaDeg {
    fn from(p: Lla) -> Self {
        Self::new(p.lat_rad.to_degrees(), p.lon_rad.to_degrees(), p.height_m)
    }
}

impl From<Ned> for Enu {
    fn from(p: Ned) -> Self {
        Self(C_UN * p.0)
    }
}

impl From<Enu> for Ned {
    fn from(p: Enu) -> Self {
        Self(C_UN * p.0)
    }
}

impl From<Vector3<f64>> for Ecef {
    fn from(r_e: Vector3<f64>) -> Self {
        Self(r_e)
    }
}

impl From<Ecef> for Vector3<f64> {
    fn from(p: Ecef) -> Self {
        p.0
    }
}

/// A geodetic point as the sines and cosines of its angles: what gravity and the axes need, without
/// trigonometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geodetic {
    /// Sine of the geodetic latitude.
    pub sin_lat: f64,
    /// Cosine of the geodetic latitude, never negative.
    pub cos_lat: f64,
    /// Sine of the longitude; 0 on the polar axis.
    pub sin_lon: f64,
    /// Cosine of the longitude; 1 on the polar axis.
    pub cos_lon: f64,
    /// Height above the ellipsoid (m), up positive.
    pub height_m: f64,
}

impl Geodetic {
    /// Geodetic point of an ECEF position (m). Any finite input gives a finite answer; NaN gives NaN.
    #[must_use]
    pub fn of(ell: &Ellipsoid, r_e: &Vector3<f64>) -> Self {
        let (x, y, z) = (r_e.x, r_e.y, r_e.z);
        let p = math::sqrt(x * x + y * y);
        let (sin_lon, cos_lon) = if p == 0.0 { (0.0, 1.0) } else { (y / p, x / p) };
        let (a, b) = (ell.semi_major_m, ell.semi_minor_m);
        let radius = math::sqrt(p * p + z * z);
        let (sin_b, cos_b) = if radius < DEEP_RADIUS_M {
            nearest_by_bisection(ell, p, z)
        } else {
            // e'^2 b = (a² - b²) / b and e² a = (a² - b²) / a of the ellipsoid.
            let (second, first) = (ell.e2 * a * a / b, ell.e2 * a);
            let start = unit(b * z * (1.0 + second / radius), a * p);
            let step = |(s, c): (f64, f64)| unit(b * (z + second * s * s * s), a * (p - first * c * c * c));
            step(step(start))
        };
        // tan φ = tan β / (1 - f)
        let (sin_lat, cos_lat) = unit(a * sin_b, b * cos_b);
        let height_m = (p - a * cos_b) * cos_lat + (z - b * sin_b) * sin_lat;
        Self { sin_lat, cos_lat, sin_lon, cos_lon, height_m }
    }

    /// Rotation from e to north-east-down at this point.
    #[must_use]
    pub fn c_ne(&self) -> Matrix3<f64> {
        c_ne_from_sin_cos(self.sin_lat, self.cos_lat, self.sin_lon, self.cos_lon)
    }

    /// Rotation from north-east-down at this point to e.
    #[must_use]
    pub fn c_en(&self) -> Matrix3<f64> {
        self.c_ne().transpose()
    }

    /// A vector without east component, such as gravity, taken from north-east-down to e.
    #[must_use]
    pub(crate) fn turn_to_e(&self, v_n: &Vector3<f64>) -> Vector3<f64> {
        let radial = -self.sin_lat * v_n.x - self.cos_lat * v_n.z;
        Vector3::new(
            radial * self.cos_lon,
            radial * self.sin_lon,
            self.cos_lat * v_n.x - self.sin_lat * v_n.z,
        )
    }

    /// The angles themselves.
    #[must_use]
    pub fn to_lla(&self) -> Lla {
        Lla::new(
            math::atan2(self.sin_lat, self.cos_lat),
            wrap_pi(math::atan2(self.sin_lon, self.cos_lon)),
            self.height_m,
        )
    }
}

/// (s, c) scaled to unit length; (0, 0) becomes (0, 1).
#[inline]
fn unit(s: f64, c: f64) -> (f64, f64) {
    let n = math::sqrt(s * s + c * c);
    if n == 0.0 { (0.0, 1.0) } else { (s / n, c / n) }
}

/// Reduced latitude (sine, cosine) of the ellipsoid's point nearest to (p, z), for any p >= 0 and z.
///
/// In the quadrant of (p, |z|) the derivative of the squared distance,
/// $(a^2-b^2)\sin\beta\cos\beta-ap\sin\beta+bz\cos\beta$, falls from positive to negative exactly once; 60
/// halvings of the quadrant resolve it to rounding.
fn nearest_by_bisection(ell: &Ellipsoid, p: f64, z: f64) -> (f64, f64) {
    let (a, b) = (ell.semi_major_m, ell.semi_minor_m);
    let (focal, ap, bz) = (ell.e2 * a * a, a * p, b * math::abs(z));
    let (mut low, mut high) = ((0.0, 1.0), (1.0, 0.0));
    let mut middle = unit(1.0, 1.0);
    for _ in 0..60 {
        let (s, c) = middle;
        if (focal * c - ap) * s + bz * c > 0.0 {
            low = middle;
        } else {
            high = middle;
        }
        middle = unit(low.0 + high.0, low.1 + high.1);
    }
    (math::copysign(middle.0, z), middle.1)
}

/// ECEF position of a geodetic one: $[(R_N+h)c\cos\lambda,\ (R_N+h)c\sin\lambda,\ ((1-e^2)R_N+h)s]$. Groves
/// (2013), eq. 2.112.
#[must_use]
pub fn lla_to_ecef(ell: &Ellipsoid, p: &Lla) -> Ecef {
    let (sin_lat, cos_lat) = math::sin_cos(p.lat_rad);
    let (sin_lon, cos_lon) = math::sin_cos(p.lon_rad);
    let r_n = ell.radii(sin_lat).prime_vertical_m;
    let across = (r_n + p.height_m) * cos_lat;
    Ecef(Vector3::new(across * cos_lon, across * sin_lon, ((1.0 - ell.e2) * r_n + p.height_m) * sin_lat))
}

/// Geodetic position of an ECEF one; longitude in [-π, π), zero on the polar axis. See the page of this
/// module.
#[must_use]
pub fn ecef_to_lla(ell: &Ellipsoid, p: &Ecef) -> Lla {
    Geodetic::of(ell, &p.0).to_lla()
}

/// Rotation from e to north-east-down at a latitude and longitude (rad). Groves (2013), eq. 2.150.
#[must_use]
pub fn c_ne(lat_rad: f64, lon_rad: f64) -> Matrix3<f64> {
    let (sin_lat, cos_lat) = math::sin_cos(lat_rad);
    let (sin_lon, cos_lon) = math::sin_cos(lon_rad);
    c_ne_from_sin_cos(sin_lat, cos_lat, sin_lon, cos_lon)
}

/// [`c_ne`] from the sines and cosines of latitude and longitude.
#[inline]
#[must_use]
pub fn c_ne_from_sin_cos(sin_lat: f64, cos_lat: f64, sin_lon: f64, cos_lon: f64) -> Matrix3<f64> {
    Matrix3::new(
        -sin_lat * cos_lon,
        -sin_lat * sin_lon,
        cos_lat,
        -sin_lon,
        cos_lon,
        0.0,
        -cos_lat * cos_lon,
        -cos_lat * sin_lon,
        -sin_lat,
    )
}

/// Displacement of a point from an origin in the origin's north-east-down axes.
#[must_use]
pub fn ecef_to_ned(ell: &Ellipsoid, origin: &Lla, point: &Ecef) -> Ned {
    Ned(c_ne(origin.lat_rad, origin.lon_rad) * (point.0 - lla_to_ecef(ell, origin).0))
}

/// Point that lies a north-east-down displacement from an origin.
#[must_use]
pub fn ned_to_ecef(ell: &Ellipsoid, origin: &Lla, displacement: &Ned) -> Ecef {
    Ecef(lla_to_ecef(ell, origin).0 + c_ne(origin.lat_rad, origin.lon_rad).tr_mul(&displacement.0))
}

/// Displacement of a point from an origin in the origin's east-north-up axes.
#[must_use]
pub fn ecef_to_enu(ell: &Ellipsoid, origin: &Lla, point: &Ecef) -> Enu {
    ecef_to_ned(ell, origin, point).into()
}

/// Point that lies an east-north-up displacement from an origin.
#[must_use]
pub fn enu_to_ecef(ell: &Ellipsoid, origin: &Lla, displacement: &Enu) -> Ecef {
    ned_to_ecef(ell, origin, &(*displacement).into())
}

/// The same angle in [-π, π) (rad). NaN and infinities give NaN.
#[inline]
#[must_use]
pub fn wrap_pi(angle_rad: f64) -> f64 {
    if (-PI..PI).contains(&angle_rad) {
        return angle_rad;
    }
    let wrapped = angle_rad - TAU * math::floor((angle_rad + PI) / TAU);
    // Rounding may leave the result a unit in the last place outside.
    if wrapped >= PI {
        -PI
    } else if wrapped < -PI {
        wrapped + TAU
    } else {
        wrapped
    }
}
