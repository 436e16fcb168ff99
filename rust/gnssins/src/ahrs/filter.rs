//! The attitude filter to use: sensor errors estimated in body axes, disturbed references weighed down.
//!
//! An error-state Kalman filter with fifteen errors: the attitude ρ (navigation axes,
//! $C_{true}=\mathrm{Exp}(\rho)\,C$), the gyro bias δb and the gyro matrix δS (scale factors and misalignments, nine
//! elements). With $\omega=(I+S)(\omega_m-b)$ the attitude is a product of exact rotations and
//! $$\dot\rho=C\,(\delta S\,(\omega_m-b)-\delta b)+w,\qquad
//!   w:\ \sigma_w^2=n^2+2\tau\,(\epsilon^2+\lambda^2|\omega|^2)\,|\omega|^2$$
//!
//! with the angle random walk n and what fast turning leaves in any strapdown: a share ε of the rate and axes that
//! are not sampled at one instant (lag λ).
//!
//! **Level.** The specific force is turned into navigation axes and smoothed there, so that neither turning of the
//! body nor a shaken hand enters. Its horizontal part over g is the tilt plus the body's own acceleration, whose
//! strength nobody knows beforehand. It is measured: the smoothed force less gravity, less what the filter's own
//! uncertainty of tilt explains, is the present acceleration a; its square, held for a moment, gives the noise
//! density $R=r^2+2\tau_a a^2$ of the measurement. So a body at rest is levelled within seconds, one that
//! accelerates keeps the gyro's level, and there is no threshold between the two.
//!
//! **Heading.** The same with the smoothed field against the field of the place (horizontal and vertical strength,
//! learnt, or new after it has stood for a time). The magnetometer corrects the heading and never the level: the
//! level enters its update as a considered error (Schmidt 1966), with the slope $\tan(dip)$ that makes a
//! tilt of one degree two degrees of heading in middle latitudes.
//!
//! **Rest.** A body that does not move shows the gyro bias directly, in all axes, whatever the field does.
//!
//! After a large error that looks like an acceleration (started in a manoeuvre, a wrong attitude given) the filter
//! would wait for ever, and blame the gyro meanwhile. The integral of the supposed acceleration is a change of
//! speed: when that becomes impossible, the filter starts again from the smoothed force, and counts it.
//!
//! Sources of the parts: error-state form Markley (2003), J. Guidance 26(2), p. 311; smoothing in navigation axes and
//! a heading correction apart from the level Laidig and Seel (2023), Information Fusion 91, p. 187 (VQF); noise from
//! the innovation Mehra (1972). Written out and combined here.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::ahrs::measured::{levelled, triad};
use crate::ahrs::{AhrsSample, AhrsStatus, AttitudeEstimator, check, initial};
use crate::attitude;
use crate::error::Error;
use crate::frames::wrap_pi;
use crate::math;

mod covariance;
mod references;
mod saved;
mod settings;

use covariance::{Corrects, Covariance, Errors};
use references::{Field, Meridian, REST_MEAN_S, Rest, Smoothed};

pub use saved::SAVED_LEN;
pub use settings::Settings;

/// Time over which the errors of fast turning keep their sign, s.
const TURNING_S: f64 = 1.0;

/// Part of a squared departure that the filter's own uncertainty of tilt (heading) explains, in variances: 1.5σ.
const EXPLAINED: f64 = 2.2;

/// Acceleration from which [`AhrsStatus::ACCEL_DISTURBED`] is set, m/s².
const ACCEL_FLAG: f64 = 0.5;

/// Disturbance of the field from which [`AhrsStatus::MAG_DISTURBED`] is set, share of its strength.
const MAG_FLAG: f64 = 0.1;

/// Readings beyond these are no readings: m/s², and any unit of field.
const ACCEL_RANGE: (f64, f64) = (1e-3, 1e5);
const MAG_RANGE: (f64, f64) = (1e-12, 1e12);

/// Horizontal share of the field below which there is no heading in it.
const HORIZONTAL_MIN: f64 = 1e-3;

/// Gyro matrix elements and bias are kept within these: ±, and rad/s.
const MATRIX_MAX: f64 = 0.2;
const BIAS_MAX: f64 = 1.0;

/// Largest standard deviation of an angle, rad: nothing is known.
const UNKNOWN: f64 = core::f64::consts::PI;

/// Attitude, gyro bias and gyro matrix from gyro, accelerometer and magnetometer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AttitudeFilter {
    settings: Settings,
    q_nb: UnitQuaternion<f64>,
    bias: Vector3<f64>,
    matrix: Matrix3<f64>,
    errors: Covariance,
    aligned: bool,
    force: Smoothed,
    /// Integral of the supposed acceleration, m/s.
    speed: Vector3<f64>,
    magnet: Smoothed,
    field: Field,
    rest: Rest,
    /// Samples refused for their gyro rate or interval, starts after the first.
    refused: u64,
    restarts: u64,
}

impl AttitudeFilter {
    /// A filter that takes its attitude from the first usable sample, or the given one.
    ///
    /// # Errors
    /// [`Error::Config`] for a setting out of its range.
    pub fn new(settings: &Settings) -> Result<Self, Error> {
        settings.check()?;
        let given = initial(settings.initial_q_nb)?;
        let mut filter = Self {
            settings: *settings,
            q_nb: given.unwrap_or_default(),
            bias: Vector3::zeros(),
            matrix: Matrix3::zeros(),
            errors: Covariance::diagonal(&Vector3::zeros(), 0.0, 0.0),
            aligned: given.is_some(),
            force: Smoothed::default(),
            speed: Vector3::zeros(),
            magnet: Smoothed::default(),
            field: Field::default(),
            rest: Rest::default(),
            refused: 0,
            restarts: 0,
        };
        filter.open(settings.initial_heading_sd_rad);
        Ok(filter)
    }

    /// 1σ of the attitude error about north, east, down, rad; π where nothing is known.
    #[must_use]
    pub fn attitude_sd_rad(&self) -> Vector3<f64> {
        match self.aligned {
            true => Vector3::from_fn(|i, _| self.errors.sd(i)),
            false => Vector3::repeat(UNKNOWN),
        }
    }

    /// 1σ of the gyro bias, rad/s.
    #[must_use]
    pub fn gyro_bias_sd_rad_s(&self) -> Vector3<f64> {
        Vector3::from_fn(|i, _| self.errors.sd(3 + i))
    }

    /// Gyro matrix S: the true rate is $(I+S)(\omega_m-b)$.
    #[must_use]
    pub fn gyro_matrix(&self) -> Matrix3<f64> {
        self.matrix
    }

    /// Acceleration of the body that the filter presently allows for, m/s².
    #[must_use]
    pub fn acceleration_m_s2(&self) -> f64 {
        math::sqrt(self.force.held)
    }

    /// Disturbance of the field that the filter presently allows for, share of its strength.
    #[must_use]
    pub fn field_disturbance(&self) -> f64 {
        math::sqrt(self.magnet.held)
    }

    /// Samples refused because of their gyro rate or their interval.
    #[must_use]
    pub const fn refused(&self) -> u64 {
        self.refused
    }

    /// How often the filter started again because the speed that it supposed had become impossible.
    #[must_use]
    pub const fn restarts(&self) -> u64 {
        self.restarts
    }

    /// Covariance of the start.
    fn open(&mut self, heading_sd: f64) {
        let tilt = self.settings.initial_tilt_sd_rad;
        let sd = Vector3::new(tilt, tilt, heading_sd);
        self.errors = Covariance::diagonal(&sd, self.settings.bias_sd_rad_s, self.settings.gyro_matrix_sd);
    }

    /// Attitude of one reading; without a field the heading is zero and unknown.
    fn align(&mut self, accel: &Vector3<f64>, mag: Option<&Vector3<f64>>) -> AhrsStatus {
        let found = mag.and_then(|m| triad(accel, m, self.settings.declination_rad));
        let known = found.is_some();
        let c_nb = found.unwrap_or_else(|| levelled(&(-accel / accel.norm()), &Matrix3::identity()));
        self.q_nb = attitude::from_dcm(&c_nb);
        self.open(if known { self.settings.initial_heading_sd_rad } else { UNKNOWN });
        self.aligned = true;
        AhrsStatus::ALIGNED.with(AhrsStatus::ACCEL_USED).with_if(known, AhrsStatus::MAG_USED)
    }

    /// Starts again, level by a force in navigation axes, heading and field to be found.
    fn restart(&mut self, f: &Vector3<f64>) {
        let horizontal = math::hypot(f.x, f.y);
        let angle = math::atan2(horizontal, -f.z);
        let axis = match horizontal > f64::MIN_POSITIVE {
            true => Vector3::new(-f.y, f.x, 0.0) / horizontal,
            false => Vector3::x(),
        };
        self.q_nb = attitude::renormalise(&(attitude::exp(&(axis * angle)) * self.q_nb));
        self.bias = Vector3::zeros();
        self.matrix = Matrix3::zeros();
        self.force = Smoothed::default();
        self.magnet = Smoothed::default();
        self.field = Field::default();
        self.speed = Vector3::zeros();
        self.open(UNKNOWN);
        self.restarts += 1;
    }

    /// Turns the attitude on and its errors with it; gives the rate.
    fn turn_on(&mut self, gyro: &Vector3<f64>, dt_s: f64) -> Vector3<f64> {
        let s = &self.settings;
        let raw = gyro - self.bias;
        let rate = raw + self.matrix * raw;
        let before = attitude::dcm(&self.q_nb);
        self.q_nb = attitude::renormalise(&(self.q_nb * attitude::exp(&(rate * dt_s))));
        let mean = 0.5 * (before + attitude::dcm(&self.q_nb));
        self.errors.predict(&mean, &raw, dt_s);
        let (share, lag, square) = (s.gyro_rate_share, s.gyro_lag_s, rate.norm_squared());
        let density = s.gyro_arw_rad_sqrt_s * s.gyro_arw_rad_sqrt_s
            + 2.0 * TURNING_S * (share * share + lag * lag * square) * square;
        let walk = s.bias_walk_rad_s_sqrt_s * s.bias_walk_rad_s_sqrt_s;
        for i in 0..3 {
            self.errors.add(i, density * dt_s);
            self.errors.add(3 + i, walk * dt_s);
            self.errors.limit(i, UNKNOWN * UNKNOWN);
            self.errors.limit(3 + i, BIAS_MAX * BIAS_MAX);
        }
        rate
    }

    /// Takes the errors out that measurements have shown.
    fn correct(&mut self, x: &Errors) {
        let dq = attitude::exp(&Vector3::new(x[0], x[1], x[2]));
        self.q_nb = attitude::renormalise(&(dq * self.q_nb));
        self.force.turn(&dq);
        self.magnet.turn(&dq);
        self.speed = dq * self.speed;
        for i in 0..3 {
            self.bias[i] = (self.bias[i] + x[3 + i]).clamp(-BIAS_MAX, BIAS_MAX);
            for j in 0..3 {
                self.matrix[(i, j)] = (self.matrix[(i, j)] + x[6 + 3 * i + j]).clamp(-MATRIX_MAX, MATRIX_MAX);
            }
        }
    }

    /// The gyro of a body at rest shows its bias; a rate that the bias cannot be is a slow turn instead.
    fn at_rest(&mut self, gyro: &Vector3<f64>, dt_s: f64) -> bool {
        let s = &self.settings;
        let density =
            s.gyro_arw_rad_sqrt_s * s.gyro_arw_rad_sqrt_s + s.rest_noise_rad_sqrt_s * s.rest_noise_rad_sqrt_s;
        // four sigma of the mean rate less the estimate: of the bias, and of the noise in an exponential mean
        let limit = 16.0 * (self.errors.bias() + 3.0 * density / (2.0 * REST_MEAN_S));
        if (self.rest.rate() - self.bias).norm_squared() > limit {
            return false;
        }
        for i in 0..3 {
            let mut h = Errors::zeros();
            h[3 + i] = 1.0;
            let x = self.errors.update(&h, gyro[i] - self.bias[i], density / dt_s, Corrects::All);
            self.correct(&x);
        }
        true
    }

    /// Level from the specific force; true when the body accelerates.
    ///
    /// $C f=a-g\,e_z-\rho\times(-g\,e_z)$, so that $\rho_E=(Cf)_N/g$ and $\rho_N=-(Cf)_E/g$ but for a.
    fn level(&mut self, accel: &Vector3<f64>, dt_s: f64) -> bool {
        let s = self.settings;
        let g = s.gravity_m_s2;
        let f = self.force.take(&(self.q_nb * accel), dt_s, s.accel_smooth_s);
        let a = Vector3::new(f.x, f.y, f.z + g);
        let unexplained = (a.norm_squared() - EXPLAINED * g * g * self.errors.level()).max(0.0);
        let held = self.force.hold(unexplained, dt_s, s.accel_hold_s);
        let accelerates = held > ACCEL_FLAG * ACCEL_FLAG;
        self.speed = if accelerates { self.speed + a * dt_s } else { Vector3::zeros() };
        if self.speed.norm() > s.speed_change_m_s {
            self.restart(&f);
            return true;
        }
        let noise = s.accel_noise_m_s2_sqrt_hz * s.accel_noise_m_s2_sqrt_hz;
        let r = (noise + 2.0 * s.accel_correlation_s * self.force.held) / (g * g * dt_s);
        let mut h = Errors::zeros();
        h[0] = 1.0;
        let first = self.errors.update(&h, -f.y / g, r, Corrects::All);
        h[0] = 0.0;
        h[1] = 1.0;
        let second = self.errors.update(&h, f.x / g - first[1], r, Corrects::All);
        self.correct(&(first + second));
        accelerates
    }

    /// Heading from the field. `None` where the field has none, else whether it is disturbed.
    ///
    /// The angle of the smoothed field from magnetic north is $\rho_D-\tan(dip)\,\rho_{N'}$, N' magnetic north.
    fn head(&mut self, mag: &Vector3<f64>, rate: f64, dt_s: f64) -> Option<bool> {
        let s = self.settings;
        let m = self.magnet.take(&(self.q_nb * mag), dt_s, s.mag_smooth_s);
        let seen: Meridian = [math::hypot(m.x, m.y), m.z];
        let [horizontal, down] = self.field.compare(&seen);
        let share = self.field.reference[0] / self.field.strength();
        if !(share > HORIZONTAL_MIN && seen[0] > 0.0) {
            return None;
        }
        let z = wrap_pi(s.declination_rad - math::atan2(m.y, m.x));
        let slope = self.field.reference[1] / self.field.reference[0];
        let (sin_d, cos_d) = math::sin_cos(s.declination_rad);
        let along = Vector3::new(-slope * cos_d, -slope * sin_d, 1.0);
        let across = share * 2.0 * math::sin(0.5 * z);
        let explained = EXPLAINED * share * share * self.errors.along(&along);
        let weight = s.mag_departure_weight * s.mag_departure_weight;
        let departure = horizontal * horizontal + down * down;
        let turned = (across * across - explained).max(0.0);
        let held = self.magnet.hold(weight * departure + turned, dt_s, s.mag_hold_s);
        let other = departure + turned > MAG_FLAG * MAG_FLAG;
        if self.field.renew(&seen, other, rate, dt_s, s.mag_new_s) {
            self.errors.add(2, z * z);
            self.magnet.held = 0.0;
        }
        let noise = s.mag_noise_sqrt_hz * s.mag_noise_sqrt_hz;
        let r = (noise + 2.0 * s.mag_correlation_s * self.magnet.held) / (share * share * dt_s);
        let mut h = Errors::zeros();
        h.fixed_rows_mut::<3>(0).copy_from(&along);
        let x = self.errors.update(&h, z, r, Corrects::NotLevel);
        self.correct(&x);
        self.field.learn(&seen, dt_s, s.mag_learn_s);
        Some(held > MAG_FLAG * MAG_FLAG)
    }
}

/// The reading, if it is finite and in range.
fn usable(v: &Vector3<f64>, range: (f64, f64)) -> bool {
    let top = v.iter().fold(0.0, |a: f64, x| a.max(math::abs(*x)));
    v.iter().all(|x| x.is_finite()) && (range.0..range.1).contains(&top)
}

impl AttitudeEstimator for AttitudeFilter {
    fn step(&mut self, dt_s: f64, sample: &AhrsSample) -> Result<AhrsStatus, Error> {
        let moves = check(dt_s, &sample.gyro).inspect_err(|_| self.refused += 1)?;
        let accel = Some(sample.accel).filter(|a| usable(a, ACCEL_RANGE));
        let mag = sample.mag.filter(|m| usable(m, MAG_RANGE));
        let status = AhrsStatus::default()
            .with_if(accel.is_none(), AhrsStatus::ACCEL_BAD)
            .with_if(mag.is_none(), AhrsStatus::MAG_BAD);
        if !self.aligned {
            return Ok(match accel {
                Some(a) => status.with(self.align(&a, mag.as_ref())),
                None => status.with(AhrsStatus::UNALIGNED),
            });
        }
        if !moves {
            return Ok(status.with(AhrsStatus::SKIPPED));
        }
        let mut status = status;
        let rate = self.turn_on(&sample.gyro, dt_s).norm();
        let s = &self.settings;
        let limits = (s.rest_gyro_rad_s, s.rest_accel_m_s2);
        let still = self.rest.take(&sample.gyro, accel.as_ref(), dt_s, limits, s.rest_time_s);
        if still && s.rest_detection {
            status = status.with_if(self.at_rest(&sample.gyro, dt_s), AhrsStatus::REST);
        }
        if let Some(a) = accel {
            let starts = self.restarts;
            let accelerates = self.level(&a, dt_s);
            status = status
                .with(AhrsStatus::ACCEL_USED)
                .with_if(accelerates, AhrsStatus::ACCEL_DISTURBED)
                .with_if(self.restarts > starts, AhrsStatus::ALIGNED);
        }
        if let Some(m) = mag {
            status = match self.head(&m, rate, dt_s) {
                Some(disturbed) => {
                    status.with(AhrsStatus::MAG_USED).with_if(disturbed, AhrsStatus::MAG_DISTURBED)
                }
                None => status.with(AhrsStatus::MAG_BAD),
            };
        }
        Ok(status)
    }

    fn q_nb(&self) -> UnitQuaternion<f64> {
        self.q_nb
    }

    fn gyro_bias_b(&self) -> Vector3<f64> {
        self.bias
    }
}
