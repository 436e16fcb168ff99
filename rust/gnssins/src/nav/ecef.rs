//! ECEF mechanisation: Cartesian position, velocity and attitude against the rotating Earth frame.
//!
//! No singular latitude: this is the model for the poles, and for anything that crosses the date line often.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::{
    Aid, DP, DV, Dynamics, EarthModel, FARTHEST_M, FASTEST_M_S, Matrix3x9, Matrix9, Motion, NavModel, PHI,
    Solution, Vector9, check_start, finite, half_turn, lever_velocity, within,
};
use crate::attitude::{self, skew};
use crate::error::Error;
use crate::frames::{self, Ecef as Point, Lla};
use crate::imu::Strap;
use crate::math;

/// Smallest cos(latitude) that the conversion of uncertainties to NED works with: within 6 m of a pole,
/// heading has no meaning and its sigma stays finite only by this bound.
const COS_LAT_FLOOR: f64 = 1e-6;

/// State of the ECEF mechanisation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ecef {
    earth: EarthModel,
    r_e: Vector3<f64>,
    v_e: Vector3<f64>,
    q_eb: UnitQuaternion<f64>,
    c_eb: Matrix3<f64>,
}

impl Ecef {
    fn w_ie(&self) -> Vector3<f64> {
        Vector3::new(0.0, 0.0, self.earth.ellipsoid.omega_rad_s)
    }

    fn check(r: &Vector3<f64>, v: &Vector3<f64>, q: &UnitQuaternion<f64>) -> Result<(), Error> {
        within("position", r.as_slice(), FARTHEST_M)?;
        within("velocity", v.as_slice(), FASTEST_M_S)?;
        finite("attitude", q.coords.as_slice())
    }

    fn lla(&self) -> Lla {
        frames::ecef_to_lla(&self.earth.ellipsoid, &Point(self.r_e))
    }
}

impl NavModel for Ecef {
    const NAME: &'static str = "ecef";

    fn new(earth: EarthModel, solution: &Solution) -> Result<Self, Error> {
        check_start(solution)?;
        let Solution { position, v_n, q_nb } = *solution;
        let c_en = frames::c_ne(position.lat_rad, position.lon_rad).transpose();
        let r_e = frames::lla_to_ecef(&earth.ellipsoid, &position).0;
        let v_e = c_en * v_n;
        let q_eb = attitude::renormalise(&(attitude::from_dcm(&c_en) * q_nb));
        Self::check(&r_e, &v_e, &q_eb)?;
        Ok(Self { earth, r_e, v_e, q_eb, c_eb: attitude::dcm(&q_eb) })
    }

    fn restart(&mut self, solution: &Solution) -> Result<(), Error> {
        *self = Self::new(self.earth, solution)?;
        Ok(())
    }

    fn solution(&self) -> Solution {
        let position = self.lla();
        let c_ne = frames::c_ne(position.lat_rad, position.lon_rad);
        Solution {
            position,
            v_n: c_ne * self.v_e,
            q_nb: attitude::renormalise(&(attitude::from_dcm(&c_ne) * self.q_eb)),
        }
    }

    #[inline(always)]
    fn advance(&mut self, strap: &Strap) -> Result<Motion, Error> {
        let dt = strap.dt_s;
        let w_ie = self.w_ie();
        let (r, v) = (self.r_e, self.v_e);
        let r_mid = r + 0.5 * dt * v;
        let (g, gradient) = self.earth.ellipsoid.gravity_and_gradient_e(self.earth.gravity, &r_mid);
        let acceleration = |v: &Vector3<f64>| g - 2.0 * w_ie.cross(v);

        let cu = self.c_eb * strap.u;
        let v_half = v + 0.5 * (cu + dt * acceleration(&v));
        let dv_f = half_turn(&w_ie, dt, &cu);
        let v_new = v + dv_f + dt * acceleration(&v_half);
        let v_mean = 0.5 * (v + v_new);
        let r_new = r + dt * v_mean;
        let q_eb =
            attitude::renormalise(&(attitude::exp(&(-dt * w_ie)) * self.q_eb * attitude::exp(&strap.alpha)));
        Self::check(&r_new, &v_new, &q_eb)?;
        let c_new = attitude::dcm(&q_eb);
        let (f, c) = (dv_f / dt, 0.5 * (self.c_eb + c_new));
        (self.r_e, self.v_e, self.q_eb, self.c_eb) = (r_new, v_new, q_eb, c_new);
        Ok(Motion { place: r_mid, v: v_mean, f, c, gravity: gradient })
    }

    fn motion(&self, f_b: &Vector3<f64>) -> Motion {
        let gravity = self.earth.ellipsoid.gravity_gradient_e(self.earth.gravity, &self.r_e);
        Motion { place: self.r_e, v: self.v_e, f: self.c_eb * f_b, c: self.c_eb, gravity }
    }

    /// Groves (2013), eq. 14.48-14.49, with the gradient of the normal gravity that the step uses.
    #[inline(always)]
    fn linearise(&self, motion: &Motion) -> Dynamics {
        let (w_x, zero) = (skew(&self.w_ie()), Matrix3::zeros());
        let dv = [skew(&motion.f), -2.0 * w_x, motion.gravity];
        Dynamics::of(&[-w_x, zero, zero], &dv, &zero, motion.c)
    }

    fn correct(&mut self, x: &Vector9) {
        self.r_e -= x.fixed_rows::<3>(DP);
        self.v_e -= x.fixed_rows::<3>(DV);
        let phi: Vector3<f64> = x.fixed_rows::<3>(PHI).into();
        self.q_eb = attitude::renormalise(&(attitude::exp(&phi) * self.q_eb));
        self.c_eb = attitude::dcm(&self.q_eb);
    }

    fn position_aid(&self, lever_b: &Vector3<f64>, measured: &Lla) -> Aid {
        let arm = self.c_eb * lever_b;
        let z = frames::lla_to_ecef(&self.earth.ellipsoid, measured).0;
        // the residual is laid along the axes of the measured point: they do not depend on the state
        let c_ne = frames::c_ne(measured.lat_rad, measured.lon_rad);
        let mut h = Matrix3x9::zeros();
        h.fixed_columns_mut::<3>(PHI).copy_from(&(c_ne * skew(&arm)));
        h.fixed_columns_mut::<3>(DP).copy_from(&c_ne);
        Aid { y: c_ne * (self.r_e + arm - z), h, h_gyro: Matrix3::zeros(), h_lever: -c_ne * self.c_eb }
    }

    fn velocity_aid(
        &self,
        lever_b: &Vector3<f64>,
        w_ib_b: &Vector3<f64>,
        measured: &Vector3<f64>,
        at: Option<&Lla>,
    ) -> Aid {
        let lever = lever_velocity(&self.c_eb, lever_b, w_ib_b, &self.w_ie());
        let at = at.copied().unwrap_or_else(|| self.lla());
        let c_ne = frames::c_ne(at.lat_rad, at.lon_rad);
        let mut h = Matrix3x9::zeros();
        h.fixed_columns_mut::<3>(PHI).copy_from(&(c_ne * lever.h_phi));
        h.fixed_columns_mut::<3>(DV).copy_from(&c_ne);
        Aid {
            y: c_ne * (self.v_e + lever.velocity) - measured,
            h,
            h_gyro: c_ne * lever.h_gyro,
            h_lever: c_ne * lever.h_lever,
        }
    }

    /// phi_n = C phi_e + theta, dv_n = C dv_e + v x theta, dp_n = C dp_e, where theta is the turn of the NED
    /// axes from the true to the estimated point: [dE/(R_N+h), -dN/(R_M+h), -tanL dE/(R_N+h)].
    fn to_ned_errors(&self) -> Option<Matrix9> {
        let Lla { lat_rad, lon_rad, height_m } = self.lla();
        let (s, c) = math::sin_cos(lat_rad);
        let radii = self.earth.ellipsoid.radii(s);
        let (m, n) = (radii.meridian_m + height_m, radii.prime_vertical_m + height_m);
        let c_ne = frames::c_ne(lat_rad, lon_rad);
        let turn =
            Matrix3::new(0.0, 1.0 / n, 0.0, -1.0 / m, 0.0, 0.0, 0.0, -s / (c.max(COS_LAT_FLOOR) * n), 0.0)
                * c_ne;
        let mut t = Matrix9::zeros();
        for k in [PHI, DV, DP] {
            t.fixed_view_mut::<3, 3>(k, k).copy_from(&c_ne);
        }
        t.fixed_view_mut::<3, 3>(PHI, DP).copy_from(&turn);
        t.fixed_view_mut::<3, 3>(DV, DP).copy_from(&(skew(&(c_ne * self.v_e)) * turn));
        Some(t)
    }

    fn pack(&self) -> [f64; 10] {
        let (r, v, q) = (&self.r_e, &self.v_e, &self.q_eb);
        [r.x, r.y, r.z, v.x, v.y, v.z, q.w, q.i, q.j, q.k]
    }

    fn unpack(&mut self, p: &[f64; 10]) -> Result<(), Error> {
        let r_e = Vector3::new(p[0], p[1], p[2]);
        let v_e = Vector3::new(p[3], p[4], p[5]);
        let q_eb = UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(p[6], p[7], p[8], p[9]));
        Self::check(&r_e, &v_e, &q_eb)?;
        *self = Self { earth: self.earth, r_e, v_e, q_eb, c_eb: attitude::dcm(&q_eb) };
        Ok(())
    }
}
