//! How rows are read.

use crate::imu::{Calibration, ImuInput};
use crate::meas::SOURCES;

/// What to do at an IMU gap longer than the limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum OnGap {
    /// Return [`Error::Gap`].
    #[default]
    Stop,
    /// Go on with the mean rate of both ends and noise raised by their difference.
    Bridge,
}

/// What to do with an IMU row that lies before its predecessor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum OnBackwards {
    /// Return [`Error::TimeBackwards`].
    #[default]
    Stop,
    /// Count the row as bad and go on.
    Drop,
}

/// How rows are read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StreamSettings {
    /// What IMU rows hold.
    pub input: ImuInput,
    /// Gyro calibration, applied first.
    pub gyro: Calibration,
    /// Accelerometer calibration, applied first.
    pub accel: Calibration,
    /// Range of the gyros, rad/s: an event where a rate reaches it.
    pub gyro_range: Option<f64>,
    /// Range of the accelerometers, m/s².
    pub accel_range: Option<f64>,
    /// Longest interval between IMU rows that is bridged without asking, ns.
    pub max_gap_ns: i64,
    /// What to do beyond it.
    pub on_gap: OnGap,
    /// What to do with time that goes back.
    pub on_backwards: OnBackwards,
    /// Stamp minus time of validity of the aids, by [`crate::meas::Source::index`], ns.
    pub latency_ns: [i64; SOURCES],
    /// Rejected fixes in a row after which the filter declares its covariance wrong and re-acquires; `None`: never.
    pub reacquire_after: Option<u32>,
}

impl Default for StreamSettings {
    fn default() -> Self {
        Self {
            input: ImuInput::default(),
            gyro: Calibration::default(),
            accel: Calibration::default(),
            gyro_range: None,
            accel_range: None,
            max_gap_ns: 1_000_000_000,
            on_gap: OnGap::default(),
            on_backwards: OnBackwards::default(),
            latency_ns: [0; SOURCES],
            reacquire_after: Some(10),
        }
    }
}
