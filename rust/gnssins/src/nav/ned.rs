//! NED mechanisation: latitude, longitude, height, velocity and attitude against north, east, down.
//!
//! ENU is this model under one constant rotation: a proper rotation turns `phi`, `dv` and `dp` alike.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::{
    Aid, DP, DV, Dynamics, EarthModel, FARTHEST_M, FASTEST_M_S, Matrix3x9, Matrix9, Motion, NavModel, PHI,
    Solution, Vector9, check_start, finite, half_turn, lever_velocity, within,
};
use crate::attitude::{self, skew};
use crate::earth::Radii;
use crate::error::Error;
use crate::frames::{Lla, wrap_pi};
use crate::imu::Strap;
use crate::math;
use crate::nav::kinematics::AttitudeForm;

/// Largest latitude of the model, rad (89.9 degrees): beyond it tan(latitude) spoils the transport rate.
pub const LATITUDE_LIMIT_RAD: f64 = 1.569_051_3;

/// State of the NED mechanisation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ned {
    earth: EarthModel,
    form: AttitudeForm,
    position: Lla,
    v_n: Vector3<f64>,
    q_nb: UnitQuaternion<f64>,
    c_nb: Matrix3<f64>,
}

/// Earth quantities at one point, computed once per step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Point {
    pub(super) sin_lat: f64,
    pub(super) cos_lat: f64,
    tan_lat: f64,
    pub(super) height_m: f64,
    /// Radii of curvature, including the height, and what is one over them.
    radii: Radii,
    per_m: f64,
    per_n: f64,
    pub(super) w_ie_n: Vector3<f64>,
}

impl Point {
    pub(super) fn new(earth: &EarthModel, lat_rad: f64, height_m: f64) -> Self {
        let (sin_lat, cos_lat) = math::sin_cos(lat_rad);
        Self::of(earth, &Vector3::new(sin_lat, cos_lat, height_m))
    }

    /// From sine and cosine of the latitude and the height, m.
    #[inline(always)]
    fn of(earth: &EarthModel, place: &Vector3<f64>) -> Self {
        let (sin_lat, cos_lat, height_m) = (place.x, place.y, place.z);
        let mut radii = earth.ellipsoid.radii(sin_lat);
        radii.meridian_m += height_m;
        radii.prime_vertical_m += height_m;
        Self {
            sin_lat,
            cos_lat,
            tan_lat: sin_lat / cos_lat,
            height_m,
            radii,
            per_m: 1.0 / radii.meridian_m,
            per_n: 1.0 / radii.prime_vertical_m,
            w_ie_n: earth.ellipsoid.earth_rate_n(sin_lat, cos_lat),
        }
    }

    /// As [`crate::earth::transport_rate_n`].
    #[inline(always)]
    pub(super) fn transport_rate(&self, v_n: &Vector3<f64>) -> Vector3<f64> {
        let east = v_n.y * self.per_n;
        Vector3::new(east, -v_n.x * self.per_m, -east * self.tan_lat)
    }

    /// R_M + h and R_N + h, m.
    pub(super) fn scales(&self) -> (f64, f64) {
        (self.radii.meridian_m, self.radii.prime_vertical_m)
    }
}

impl Ned {
    /// Gravity (m/s²), and its changes with latitude and with height as the first columns of a matrix.
    #[inline(always)]
    fn gravity(&self, point: &Point) -> (Vector3<f64>, Matrix3<f64>) {
        let (g_n, by_lat, by_height) = self.earth.ellipsoid.gravity_and_rates_n(
            self.earth.gravity,
            point.sin_lat,
            point.cos_lat,
            point.height_m,
        );
        (g_n, Matrix3::from_columns(&[by_lat, by_height, Vector3::zeros()]))
    }

    #[inline(always)]
    pub(super) fn check(position: &Lla, v_n: &Vector3<f64>, q_nb: &UnitQuaternion<f64>) -> Result<(), Error> {
        finite("position", &[position.lat_rad, position.lon_rad])?;
        within("height", &[position.height_m], FARTHEST_M)?;
        within("velocity", v_n.as_slice(), FASTEST_M_S)?;
        finite("attitude", q_nb.coords.as_slice())?;
        if position.lat_rad.abs() > LATITUDE_LIMIT_RAD {
            return Err(Error::LatitudeLimit { lat_rad: position.lat_rad, limit_rad: LATITUDE_LIMIT_RAD });
        }
        Ok(())
    }
}

impl NavModel for Ned {
    const NAME: &'static str = "ned";

    fn new(earth: EarthModel, solution: &Solution) -> Result<Self, Error> {
        check_start(solution)?;
        let Solution { position, v_n, q_nb } = *solution;
        Self::check(&position, &v_n, &q_nb)?;
        let q_nb = attitude::renormalise(&q_nb);
        let form = AttitudeForm::default();
        Ok(Self { earth, form, position, v_n, q_nb, c_nb: attitude::dcm(&q_nb) })
    }

    fn set_attitude_form(&mut self, form: AttitudeForm) -> Result<(), Error> {
        self.form = form;
        Ok(())
    }

    fn restart(&mut self, solution: &Solution) -> Result<(), Error> {
        *self = Self { form: self.form, ..Self::new(self.earth, solution)? };
        Ok(())
    }

    fn solution(&self) -> Solution {
        Solution { position: self.position, v_n: self.v_n, q_nb: self.q_nb }
    }

    #[inline(always)]
    fn advance(&mut self, strap: &Strap) -> Result<Motion, Error> {
        let dt = strap.dt_s;
        let Lla { lat_rad, lon_rad, height_m } = self.position;
        let v = self.v_n;
        let ellipsoid = &self.earth.ellipsoid;
        // Earth at the middle of the interval, predicted with the velocity of its start
        let (sin_start, cos_start) = math::sin_cos(lat_rad);
        let half_north = 0.5 * dt * v.x / (ellipsoid.meridian_nearly(sin_start) + height_m);
        let (sin_lat, cos_lat) = math::sin_cos_near(sin_start, cos_start, lat_rad, half_north);
        let place = Vector3::new(sin_lat, cos_lat, height_m - 0.5 * dt * v.z);
        let point = Point::of(&self.earth, &place);
        let (g_n, gravity) = self.gravity(&point);
        let acceleration = |v: &Vector3<f64>, w_en: &Vector3<f64>| g_n - (2.0 * point.w_ie_n + w_en).cross(v);

        let cu = self.c_nb * strap.u;
        let v_half = v + 0.5 * (cu + dt * acceleration(&v, &point.transport_rate(&v)));
        let w_en = point.transport_rate(&v_half);
        let dv_f = half_turn(&(point.w_ie_n + w_en), dt, &cu);
        let v_new = v + dv_f + dt * acceleration(&v_half, &w_en);
        let v_mean = 0.5 * (v + v_new);

        let position = Lla {
            lat_rad: lat_rad + dt * v_mean.x * point.per_m,
            lon_rad: wrap_pi(lon_rad + dt * v_mean.y * point.per_n / point.cos_lat),
            height_m: height_m - dt * v_mean.z,
        };
        let w_in = point.w_ie_n + point.transport_rate(&v_mean);
        let q_nb = self.form.advance(&self.q_nb, &strap.alpha, &(dt * w_in))?;
        Self::check(&position, &v_new, &q_nb)?;
        let c_new = attitude::dcm(&q_nb);
        let (f, c) = (dv_f / dt, 0.5 * (self.c_nb + c_new));
        (self.position, self.v_n, self.q_nb, self.c_nb) = (position, v_new, q_nb, c_new);
        Ok(Motion { place, v: v_mean, f, c, gravity })
    }

    fn motion(&self, f_b: &Vector3<f64>) -> Motion {
        let point = Point::new(&self.earth, self.position.lat_rad, self.position.height_m);
        let place = Vector3::new(point.sin_lat, point.cos_lat, point.height_m);
        let (_, gravity) = self.gravity(&point);
        Motion { place, v: self.v_n, f: self.c_nb * f_b, c: self.c_nb, gravity }
    }

    /// Error dynamics with every term of the coordinate equations: transport rate and its change with
    /// velocity, latitude (radii included) and height, Coriolis, gravity gradient. Derived in the metre form
    /// dp = [(R_M+h) dL, (R_N+h) cosL dlon, -dh]; compare Groves (2013), eq. 14.63-14.71, in radians.
    #[inline(always)]
    fn linearise(&self, motion: &Motion) -> Dynamics {
        let ellipsoid = &self.earth.ellipsoid;
        let point = Point::of(&self.earth, &motion.place);
        let (s, c, t) = (point.sin_lat, point.cos_lat, point.tan_lat);
        let (m, n) = (point.per_m, point.per_n);
        let rate = ellipsoid.radii_rate(s, c);
        let w = ellipsoid.omega_rad_s;
        let v = &motion.v;
        let (north, east, down) = (v.x * m, v.y * n, v.z);

        // d(w_ie)/d(dp): only latitude, dL = dp_N / M
        let dw_ie = Vector3::new(-w * s * m, 0.0, -w * c * m);
        // d(w_en)/d(dv): north and east
        let by_vn = Vector3::new(0.0, -m, 0.0);
        let by_ve = Vector3::new(n, 0.0, -t * n);
        // d(w_en)/d(dp): latitude with the change of the radii, height with dh = -dp_D
        let shrink = east * rate.prime_vertical_m * n;
        let by_north =
            m * Vector3::new(-shrink, north * rate.meridian_m * m, t * shrink - east * (1.0 + t * t));
        let by_down = Vector3::new(east * n, -north * m, -east * t * n);
        let w_in = point.w_ie_n + point.transport_rate(v);
        let zero = Vector3::zeros();

        let phi = [
            -skew(&w_in),
            Matrix3::from_columns(&[by_vn, by_ve, zero]),
            Matrix3::from_columns(&[dw_ie + by_north, zero, by_down]),
        ];
        let gravity = [motion.gravity.column(0) * m, -motion.gravity.column(1).into_owned()];
        let dv = [
            skew(&motion.f),
            Matrix3::from_columns(&[v.cross(&by_vn), v.cross(&by_ve), zero]) - skew(&(w_in + point.w_ie_n)),
            Matrix3::from_columns(&[
                v.cross(&(2.0 * dw_ie + by_north)) + gravity[0],
                zero,
                v.cross(&by_down) + gravity[1],
            ]),
        ];
        let dp = Matrix3::new(-down * m, 0.0, north, east * t, -(v.x * t + down) * n, east, 0.0, 0.0, 0.0);
        Dynamics::of(&phi, &dv, &dp, motion.c)
    }

    fn correct(&mut self, x: &Vector9) {
        let point = Point::new(&self.earth, self.position.lat_rad, self.position.height_m);
        let (m, n) = point.scales();
        self.position.lat_rad -= x[DP] / m;
        self.position.lon_rad = wrap_pi(self.position.lon_rad - x[DP + 1] / (n * point.cos_lat));
        self.position.height_m += x[DP + 2];
        self.v_n -= x.fixed_rows::<3>(DV);
        let phi: Vector3<f64> = x.fixed_rows::<3>(PHI).into();
        self.q_nb = self.form.correct(&self.q_nb, &phi);
        self.c_nb = attitude::dcm(&self.q_nb);
    }

    fn position_aid(&self, lever_b: &Vector3<f64>, measured: &Lla) -> Aid {
        let point = Point::new(&self.earth, self.position.lat_rad, self.position.height_m);
        let (m, n) = point.scales();
        let arm = self.c_nb * lever_b;
        let y = arm
            + Vector3::new(
                (self.position.lat_rad - measured.lat_rad) * m,
                wrap_pi(self.position.lon_rad - measured.lon_rad) * n * point.cos_lat,
                measured.height_m - self.position.height_m,
            );
        let mut h = Matrix3x9::zeros();
        h.fixed_columns_mut::<3>(PHI).copy_from(&skew(&arm));
        h.fixed_columns_mut::<3>(DP).copy_from(&Matrix3::identity());
        Aid { y, h, h_gyro: Matrix3::zeros(), h_lever: -self.c_nb }
    }

    fn velocity_aid(
        &self,
        lever_b: &Vector3<f64>,
        w_ib_b: &Vector3<f64>,
        measured: &Vector3<f64>,
        _at: Option<&Lla>,
    ) -> Aid {
        let point = Point::new(&self.earth, self.position.lat_rad, self.position.height_m);
        let (m, _) = point.scales();
        let lever = lever_velocity(&self.c_nb, lever_b, w_ib_b, &point.w_ie_n);
        let w = self.earth.ellipsoid.omega_rad_s;
        // the Earth rate turns with latitude, dL = dp_N / (R_M + h)
        let dw_ie = Vector3::new(-w * point.sin_lat / m, 0.0, -w * point.cos_lat / m);
        let mut h = Matrix3x9::zeros();
        h.fixed_columns_mut::<3>(PHI).copy_from(&lever.h_phi);
        h.fixed_columns_mut::<3>(DV).copy_from(&Matrix3::identity());
        h.set_column(DP, &-dw_ie.cross(&(self.c_nb * lever_b)));
        Aid { y: self.v_n + lever.velocity - measured, h, h_gyro: lever.h_gyro, h_lever: lever.h_lever }
    }

    fn to_ned_errors(&self) -> Option<Matrix9> {
        None
    }

    fn pack(&self) -> [f64; 10] {
        let (p, v, q) = (&self.position, &self.v_n, &self.q_nb);
        [p.lat_rad, p.lon_rad, p.height_m, v.x, v.y, v.z, q.w, q.i, q.j, q.k]
    }

    fn unpack(&mut self, p: &[f64; 10]) -> Result<(), Error> {
        let position = Lla { lat_rad: p[0], lon_rad: p[1], height_m: p[2] };
        let v_n = Vector3::new(p[3], p[4], p[5]);
        let q_nb = UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(p[6], p[7], p[8], p[9]));
        check_start(&Solution { position, v_n, q_nb })?;
        Self::check(&position, &v_n, &q_nb)?;
        *self = Self { position, v_n, q_nb, c_nb: attitude::dcm(&q_nb), ..*self };
        Ok(())
    }
}
