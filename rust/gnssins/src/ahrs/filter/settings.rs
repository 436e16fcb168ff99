//! Settings of the filter: meaning, unit, default.

use crate::ahrs::measured::{finite, positive};
use crate::error::Error;

/// Settings of [`super::AttitudeFilter`]. The defaults suit consumer and industrial MEMS at 50 to 1000 Hz.
///
/// Noise, correlation times and initial deviations scale the covariance together: all densities times c, both
/// correlation times times c², leaves every gain as it is. The defaults are set so that the standard deviations given
/// out are somewhat larger than the errors found.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(default, deny_unknown_fields))]
pub struct Settings {
    /// Angle random walk of the gyro, rad/√s. Default 1.7e-4 (0.6 deg/√h).
    pub gyro_arw_rad_sqrt_s: f64,
    /// Rate error in proportion to the rate that the gyro matrix does not hold, share. Default 3e-4.
    pub gyro_rate_share: f64,
    /// Instant at which one axis is sampled against another, s: an error that grows with the square of the rate.
    /// Default 1.5e-4.
    pub gyro_lag_s: f64,
    /// Initial gyro bias, 1σ, rad/s. Default 0.0087 (0.5 deg/s).
    pub bias_sd_rad_s: f64,
    /// Random walk of the gyro bias, rad/s/√s. Default 6e-5.
    pub bias_walk_rad_s_sqrt_s: f64,
    /// Gyro scale factors and misalignments, 1σ; zero estimates none. Default 0.0015.
    pub gyro_matrix_sd: f64,
    /// Gravity, m/s². Default 9.80665.
    pub gravity_m_s2: f64,
    /// Noise density of the specific force with the body's usual small motion, m/s²/√Hz. Default 0.022.
    pub accel_noise_m_s2_sqrt_hz: f64,
    /// Time constant of the two low passes of the specific force, s. Default 0.45.
    pub accel_smooth_s: f64,
    /// Time that one value of an acceleration counts for, s: short against a manoeuvre, because the held value is
    /// the largest and because what speeds up also brakes. Default 0.11.
    pub accel_correlation_s: f64,
    /// Time constant in which an acceleration is forgotten, s. Default 0.5.
    pub accel_hold_s: f64,
    /// Largest change of speed that the body can make in one manoeuvre, m/s: when a supposed acceleration adds up
    /// to more, the filter starts again. Default 100.
    pub speed_change_m_s: f64,
    /// Declination, east positive, rad. Default 0.
    pub declination_rad: f64,
    /// Noise density of the field, share of its strength, 1/√Hz. Default 0.0012.
    pub mag_noise_sqrt_hz: f64,
    /// Time constant of the two low passes of the field, s. Default 0.05.
    pub mag_smooth_s: f64,
    /// Time that one value of a disturbance of the field counts for, s. Default 0.45.
    pub mag_correlation_s: f64,
    /// Time constant in which a disturbance is forgotten, s. Default 0.2.
    pub mag_hold_s: f64,
    /// Weight of a departure in strength or dip against one in heading. Default 2.
    pub mag_departure_weight: f64,
    /// Time constant of learning the field of the place, s. Default 40.
    pub mag_learn_s: f64,
    /// Time that another field must stand, while the body turns, to become the reference, s. Default 30.
    pub mag_new_s: f64,
    /// Whether a body at rest is used to find the gyro bias. Default true.
    pub rest_detection: bool,
    /// Largest departure of the rate from its mean at rest, rad/s. Default 0.0087 (0.5 deg/s).
    pub rest_gyro_rad_s: f64,
    /// Largest departure of the specific force from its mean at rest, m/s². Default 0.25.
    pub rest_accel_m_s2: f64,
    /// Time without movement that makes rest, s. Default 1.5.
    pub rest_time_s: f64,
    /// Rotation left in a body found at rest, as a density, rad/√s. Default 1.5e-5.
    pub rest_noise_rad_sqrt_s: f64,
    /// Initial tilt, 1σ, rad. Default 0.2.
    pub initial_tilt_sd_rad: f64,
    /// Initial heading where a magnetometer gave it, 1σ, rad. Default 0.35.
    pub initial_heading_sd_rad: f64,
    /// Initial attitude, scalar first; from the first usable sample where absent.
    pub initial_q_nb: Option<[f64; 4]>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            gyro_arw_rad_sqrt_s: 1.7e-4,
            gyro_rate_share: 3e-4,
            gyro_lag_s: 1.5e-4,
            bias_sd_rad_s: 0.0087,
            bias_walk_rad_s_sqrt_s: 6e-5,
            gyro_matrix_sd: 0.0015,
            gravity_m_s2: 9.806_65,
            accel_noise_m_s2_sqrt_hz: 0.022,
            accel_smooth_s: 0.45,
            accel_correlation_s: 0.11,
            accel_hold_s: 0.5,
            speed_change_m_s: 100.0,
            declination_rad: 0.0,
            mag_noise_sqrt_hz: 0.0012,
            mag_smooth_s: 0.05,
            mag_correlation_s: 0.45,
            mag_hold_s: 0.2,
            mag_departure_weight: 2.0,
            mag_learn_s: 40.0,
            mag_new_s: 30.0,
            rest_detection: true,
            rest_gyro_rad_s: 0.0087,
            rest_accel_m_s2: 0.25,
            rest_time_s: 1.5,
            rest_noise_rad_sqrt_s: 1.5e-5,
            initial_tilt_sd_rad: 0.2,
            initial_heading_sd_rad: 0.35,
            initial_q_nb: None,
        }
    }
}

impl Settings {
    pub(super) fn check(&self) -> Result<(), Error> {
        finite("declination_rad", self.declination_rad)?;
        for (what, value) in [
            ("gyro_arw_rad_sqrt_s", self.gyro_arw_rad_sqrt_s),
            ("bias_sd_rad_s", self.bias_sd_rad_s),
            ("gravity_m_s2", self.gravity_m_s2),
            ("accel_noise_m_s2_sqrt_hz", self.accel_noise_m_s2_sqrt_hz),
            ("accel_smooth_s", self.accel_smooth_s),
            ("accel_correlation_s", self.accel_correlation_s),
            ("accel_hold_s", self.accel_hold_s),
            ("speed_change_m_s", self.speed_change_m_s),
            ("mag_noise_sqrt_hz", self.mag_noise_sqrt_hz),
            ("mag_smooth_s", self.mag_smooth_s),
            ("mag_correlation_s", self.mag_correlation_s),
            ("mag_hold_s", self.mag_hold_s),
            ("mag_departure_weight", self.mag_departure_weight),
            ("mag_learn_s", self.mag_learn_s),
            ("mag_new_s", self.mag_new_s),
            ("rest_gyro_rad_s", self.rest_gyro_rad_s),
            ("rest_accel_m_s2", self.rest_accel_m_s2),
            ("rest_time_s", self.rest_time_s),
            ("rest_noise_rad_sqrt_s", self.rest_noise_rad_sqrt_s),
            ("initial_tilt_sd_rad", self.initial_tilt_sd_rad),
            ("initial_heading_sd_rad", self.initial_heading_sd_rad),
        ] {
            positive(what, value)?;
        }
        for (what, got) in [
            ("gyro_rate_share", self.gyro_rate_share),
            ("gyro_lag_s", self.gyro_lag_s),
            ("bias_walk_rad_s_sqrt_s", self.bias_walk_rad_s_sqrt_s),
            ("gyro_matrix_sd", self.gyro_matrix_sd),
        ] {
            if !(got.is_finite() && got >= 0.0) {
                return Err(Error::Config { what, need: "zero or positive", got });
            }
        }
        Ok(())
    }
}
