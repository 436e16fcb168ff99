//! Euler angles from body rates, levelled by the accelerometer: the older law that the publication starts from.
//!
//! In the axes of the publication (ψ about up, counter-clockwise; θ nose up; γ right side down):
//! $$\dot\psi=\frac{\omega_2\cos\gamma-\omega_3\sin\gamma}{\cos\theta},\quad
//!   \dot\theta=\omega_2\sin\gamma+\omega_3\cos\gamma,\quad
//!   \dot\gamma=\omega_1-\tan\theta(\omega_2\cos\gamma-\omega_3\sin\gamma)$$
//! The unknown rate of the navigation axes is replaced by one from the specific force W in those axes:
//! $$\omega^k_1=-\frac{k}{g}W_3-\frac{k^I}{g}\int W_3+\omega^k_1(t_0),\quad
//!   \omega^k_3=\frac{k}{g}W_1+\frac{k^I}{g}\int W_1+\omega^k_3(t_0),\quad
//!   \omega^k_2=\omega^k_1\tan\varphi$$
//! Roll and pitch are asymptotically stable, heading is neutral: a gyro heading unless a gain for the magnetometer is
//! given. $k=0,\ k^I=g/R$ is the one tuning that does not feel acceleration (Schuler): the integral becomes V/R.
//!
//! Angles are integrated by Runge-Kutta steps of at most [`STEP_RAD`]; the levelling by its closed solution, so that
//! it is stable at any interval. Next to ±90° of pitch, where the angles have no rate, a rotation bridges and
//! [`AhrsStatus::GIMBAL`] says so. The publication's two gains for roll and pitch are one here: they belong to the
//! north and east axes, which are roll and pitch only when the heading is north.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::ahrs::axes::{
    dcm_from_publication, quaternion_from_publication, quaternion_to_publication, to_publication,
};
use crate::ahrs::measured::{References, gain};
use crate::ahrs::{AhrsSample, AhrsStatus, AttitudeEstimator, axes_rate, check, initial};
use crate::attitude::{dcm, exp, from_dcm};
use crate::error::Error;
use crate::frames::wrap_pi;
use crate::math;

/// Longest turn of one Runge-Kutta step, rad; its error is below 1e-9 rad there, 5° away from the vertical.
pub const STEP_RAD: f64 = 0.02;

/// Least |cos θ| at which Euler rates are integrated: 85° of pitch.
const COS_MIN: f64 = 0.087;

/// Longest turn of an interval that is integrated in angles, rad.
const TURN_MAX: f64 = 4.0;

/// Specific force at which a reading is cut before it levels, m/s².
const ACCEL_MAX: f64 = 1.0e4;

/// Settings of [`Euler`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(default, deny_unknown_fields))]
pub struct Settings {
    /// Levelling gain, 1/s.
    pub k: f64,
    /// Gain of the levelling integral, 1/s².
    pub k_int: f64,
    /// Gain of the magnetic heading, 1/s; zero as published.
    pub k_heading: f64,
    /// Latitude for $\omega^k_2$, rad; without it the levelling leaves the heading alone.
    pub latitude_rad: Option<f64>,
    /// Declination, gravity, tolerances.
    pub references: References,
    /// Rate of the navigation axes against inertial space along north, east, down, rad/s: the negative
    /// $\omega^k(t_0)$.
    pub rate_n: [f64; 3],
    /// Initial attitude, scalar first; from the first usable sample where absent.
    pub initial_q_nb: Option<[f64; 4]>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            k: 1.0,
            k_int: 0.0,
            k_heading: 0.0,
            latitude_rad: None,
            references: References::default(),
            rate_n: [0.0; 3],
            initial_q_nb: None,
        }
    }
}

/// Euler angles with levelling.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Euler {
    k: f64,
    k_int: f64,
    k_heading: f64,
    tan_latitude: f64,
    references: References,
    rate: Vector3<f64>,
    angles: Angles,
    /// Integral parts about north and east, rad/s.
    x: [f64; 2],
    aligned: bool,
}

/// Course about up (rad), pitch, roll: their ψ, θ, γ.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Angles {
    psi: f64,
    theta: f64,
    gamma: f64,
}

impl Angles {
    fn of(q: &UnitQuaternion<f64>) -> Self {
        let (roll, pitch, heading) = crate::attitude::to_euler(&quaternion_from_publication(q));
        Self { psi: -heading, theta: pitch, gamma: roll }
    }

    fn quaternion(&self) -> UnitQuaternion<f64> {
        quaternion_to_publication(&crate::attitude::from_euler(self.gamma, self.theta, -self.psi))
    }

    fn moved(&self, rate: &Vector3<f64>, dt_s: f64) -> Self {
        Self {
            psi: self.psi + rate.x * dt_s,
            theta: self.theta + rate.y * dt_s,
            gamma: self.gamma + rate.z * dt_s,
        }
    }

    /// Rates of ψ, θ, γ under a body rate and a rate `nav` of the body against the navigation axes, along them.
    fn rates(&self, body: &Vector3<f64>, nav: &Vector3<f64>) -> Vector3<f64> {
        let (sin_t, cos_t) = math::sin_cos(self.theta);
        let (sin_g, cos_g) = math::sin_cos(self.gamma);
        let (sin_p, cos_p) = math::sin_cos(self.psi);
        let level = body.y * cos_g - body.z * sin_g;
        let ahead = nav.x * cos_p - nav.z * sin_p;
        Vector3::new(
            level / cos_t + nav.y - sin_t / cos_t * ahead,
            body.y * sin_g + body.z * cos_g + nav.x * sin_p + nav.z * cos_p,
            body.x - sin_t / cos_t * level + ahead / cos_t,
        )
    }

    /// Runge-Kutta over an interval with constant rates; `None` where it comes next to ±90° of pitch or turns so
    /// far that the interval itself means nothing.
    fn integrated(mut self, body: &Vector3<f64>, nav: &Vector3<f64>, dt_s: f64) -> Option<Self> {
        let turn = (body.norm() + nav.norm()) * dt_s;
        if turn.is_nan() || turn >= TURN_MAX {
            return None;
        }
        let steps = 1 + (turn / STEP_RAD) as u32;
        let h = dt_s / f64::from(steps);
        for _ in 0..steps {
            if math::abs(math::cos(self.theta)) < COS_MIN {
                return None;
            }
            let k1 = self.rates(body, nav);
            let k2 = self.moved(&k1, 0.5 * h).rates(body, nav);
            let k3 = self.moved(&k2, 0.5 * h).rates(body, nav);
            let k4 = self.moved(&k3, h).rates(body, nav);
            self = self.moved(&(k1 + 2.0 * (k2 + k3) + k4), h / 6.0);
        }
        (math::abs(math::cos(self.theta)) >= COS_MIN).then(|| self.wrapped())
    }

    fn wrapped(&self) -> Self {
        Self { psi: wrap_pi(self.psi), theta: self.theta, gamma: wrap_pi(self.gamma) }
    }
}

impl Euler {
    /// An estimator before its first sample.
    ///
    /// # Errors
    /// [`Error::Config`] for a gain, latitude or reference out of range.
    pub fn new(settings: &Settings) -> Result<Self, Error> {
        gain("k", settings.k)?;
        gain("k_int", settings.k_int)?;
        gain("k_heading", settings.k_heading)?;
        let latitude = settings.latitude_rad.unwrap_or(0.0);
        if latitude.is_nan() || math::abs(latitude) >= 1.57 {
            return Err(Error::Config { what: "latitude_rad", need: "within ±1.57 rad", got: latitude });
        }
        settings.references.check()?;
        let start = initial(settings.initial_q_nb)?;
        Ok(Self {
            k: settings.k,
            k_int: settings.k_int,
            k_heading: settings.k_heading,
            tan_latitude: math::tan(latitude),
            references: settings.references,
            rate: to_publication(&axes_rate(&settings.rate_n)?),
            angles: Angles::of(&quaternion_to_publication(&start.unwrap_or_default())),
            x: [0.0; 2],
            aligned: start.is_some(),
        })
    }

    /// Turns by constant rates, in angles where they have rates; true when a rotation had to bridge.
    fn turn(&mut self, body: &Vector3<f64>, nav: &Vector3<f64>, dt_s: f64) -> bool {
        if let Some(angles) = self.angles.integrated(body, nav, dt_s) {
            self.angles = angles;
            return false;
        }
        let q = exp(&(nav * dt_s)) * self.angles.quaternion() * exp(&(body * dt_s));
        self.angles = Angles::of(&crate::attitude::renormalise(&q));
        true
    }

    /// Rotation (navigation axes, rad) by which a reading levels and, if asked for, turns the attitude.
    fn correction(&mut self, sample: &AhrsSample, measured: &Matrix3<f64>, dt_s: f64) -> Vector3<f64> {
        let c = dcm(&self.angles.quaternion());
        let force = c * to_publication(&sample.accel.map(|a| a.clamp(-ACCEL_MAX, ACCEL_MAX)));
        let force = force / self.references.gravity_m_s2;
        // tilt errors about north and east: W3/g and -W1/g
        let [north, east] = [(0, force.z), (1, -force.x)].map(|(i, e)| {
            let (x, e_new) = levelling(self.k, self.k_int, self.x[i], e, dt_s);
            self.x[i] = x;
            e_new - e
        });
        let mut up = north * self.tan_latitude;
        if self.k_heading > 0.0 {
            let measured = math::atan2(measured[(1, 0)], measured[(0, 0)]);
            up -= wrap_pi(measured + self.angles.psi) * (1.0 - math::exp(-self.k_heading * dt_s));
        }
        Vector3::new(north, up, east)
    }
}

/// Solution of $\dot e=-ke-x,\ \dot x=k^Ie$ over an interval: x and e at its end.
fn levelling(k: f64, k_int: f64, x: f64, e: f64, dt_s: f64) -> (f64, f64) {
    let phi = crate::ahrs::expm::expm(&(nalgebra::Matrix2::new(0.0, k_int, -1.0, -k) * dt_s));
    (phi[(0, 0)] * x + phi[(0, 1)] * e, phi[(1, 0)] * x + phi[(1, 1)] * e)
}

impl AttitudeEstimator for Euler {
    fn step(&mut self, dt_s: f64, sample: &AhrsSample) -> Result<AhrsStatus, Error> {
        let moving = check(dt_s, &sample.gyro)?;
        if !self.aligned {
            let measured = self.references.measure(sample, &Matrix3::identity());
            let Some(c_nb) = measured.c_nb else {
                return Ok(measured.status.with(AhrsStatus::UNALIGNED));
            };
            self.angles = Angles::of(&quaternion_to_publication(&from_dcm(&c_nb)));
            self.aligned = true;
            return Ok(measured.status.with(AhrsStatus::ALIGNED));
        }
        if !moving {
            return Ok(AhrsStatus::SKIPPED);
        }
        let bridged = self.turn(&to_publication(&sample.gyro), &(-self.rate), dt_s);
        let c_nb = dcm_from_publication(&dcm(&self.angles.quaternion()));
        let measured = self.references.measure(sample, &c_nb);
        let rotation = match &measured.c_nb {
            Some(c_k) => self.correction(sample, c_k, dt_s),
            // the integral stands for the rate of the navigation axes and goes on without readings
            None => Vector3::new(-self.x[0], -self.x[0] * self.tan_latitude, -self.x[1]) * dt_s,
        };
        let again = self.turn(&Vector3::zeros(), &(rotation / dt_s), dt_s);
        Ok(measured.status.with_if(bridged || again, AhrsStatus::GIMBAL))
    }

    fn q_nb(&self) -> UnitQuaternion<f64> {
        quaternion_from_publication(&self.angles.quaternion())
    }
}
