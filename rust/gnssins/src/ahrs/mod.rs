//! Attitude from gyro, accelerometer and magnetometer, without position or velocity.
//!
//! | module | what |
//! |---|---|
//! | [`filter`] | the estimator to use: gyro bias in body axes, disturbed references rejected |
//! | [`dcm`] | direction cosines corrected: positional, integral-positional, cross-coupled |
//! | [`quaternion`] | the same correction of the quaternion |
//! | [`euler`] | Euler angles levelled by the accelerometer |
//! | [`measured`] | attitude from one accelerometer and one magnetometer reading |
//!
//! All estimators implement [`AttitudeEstimator`]. Body axes are forward-right-down, navigation axes
//! north-east-down, as everywhere in this crate. The laws of Aleshkin et al. (2021) are written there in body
//! forward-up-right and navigation north-up-east; [`axes`] turns one into the other and is the only place that
//! does.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::error::Error;

pub mod axes;
pub mod dcm;
pub mod euler;
pub mod expm;
pub mod filter;
pub mod measured;
pub mod quaternion;

/// One reading of the sensors, body axes forward-right-down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AhrsSample {
    /// Mean angular rate over the interval that ends at the stamp, rad/s.
    pub gyro: Vector3<f64>,
    /// Specific force at the stamp, m/s²; a component NaN where there is none.
    pub accel: Vector3<f64>,
    /// Magnetic field at the stamp, any unit; `None` where there is none.
    pub mag: Option<Vector3<f64>>,
}

/// What an estimator did with a sample: a set of the flags below.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct AhrsStatus(u16);

impl AhrsStatus {
    /// The accelerometer corrected the attitude.
    pub const ACCEL_USED: Self = Self(1);
    /// The magnetometer corrected the attitude.
    pub const MAG_USED: Self = Self(1 << 1);
    /// The accelerometer reading was absent, not finite or zero.
    pub const ACCEL_BAD: Self = Self(1 << 2);
    /// The magnetometer reading was absent, not finite, zero, or parallel to the vertical.
    pub const MAG_BAD: Self = Self(1 << 3);
    /// The accelerometer reading was refused or weakened: the body accelerates.
    pub const ACCEL_DISTURBED: Self = Self(1 << 4);
    /// The magnetometer reading was refused or weakened: the field is not the reference field.
    pub const MAG_DISTURBED: Self = Self(1 << 5);
    /// The body was found at rest.
    pub const REST: Self = Self(1 << 6);
    /// The sample set the initial attitude.
    pub const ALIGNED: Self = Self(1 << 7);
    /// The interval was zero: nothing was done.
    pub const SKIPPED: Self = Self(1 << 8);
    /// There is no attitude yet: no usable accelerometer reading has come.
    pub const UNALIGNED: Self = Self(1 << 9);
    /// Euler kinematics were bridged by a rotation because the pitch was next to ±90°.
    pub const GIMBAL: Self = Self(1 << 10);

    /// The flags as a number.
    #[must_use]
    pub const fn bits(self) -> u16 {
        self.0
    }

    /// True when all flags of `other` are set.
    #[must_use]
    pub const fn has(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// The flags of both.
    #[must_use]
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// The flags, and those of `other` if the condition holds.
    #[must_use]
    pub const fn with_if(self, condition: bool, other: Self) -> Self {
        if condition { self.with(other) } else { self }
    }
}

/// An attitude estimator: one sample in, one attitude out.
pub trait AttitudeEstimator {
    /// Takes the sample at the end of an interval of `dt_s` seconds.
    ///
    /// Over an interval of zero nothing is done but to align an estimator that has no attitude yet. A missing or unusable accelerometer or magnetometer
    /// reading is flagged and the gyro carries the attitude meanwhile.
    ///
    /// # Errors
    /// [`Error::NonFinite`] for a gyro rate that is not finite, [`Error::Config`] for a negative or non-finite
    /// interval; the estimator keeps its state.
    fn step(&mut self, dt_s: f64, sample: &AhrsSample) -> Result<AhrsStatus, Error>;

    /// Attitude: body to north-east-down. The identity before the first usable sample.
    fn q_nb(&self) -> UnitQuaternion<f64>;

    /// Estimated gyro bias, body axes, rad/s: to be subtracted from the rate. Zero where none is estimated.
    fn gyro_bias_b(&self) -> Vector3<f64> {
        Vector3::zeros()
    }
}

/// Refuses an interval or a rate that cannot be used; true when there is something to do.
pub(crate) fn check(dt_s: f64, gyro: &Vector3<f64>) -> Result<bool, Error> {
    if !(0.0..=INTERVAL_MAX).contains(&dt_s) {
        return Err(Error::Config { what: "dt_s", need: "from 0 to 1e6 s", got: dt_s });
    }
    if !gyro.iter().all(|x| x.abs() < RATE_MAX) {
        return Err(Error::NonFinite { what: "gyro rate", t_ns: 0 });
    }
    Ok(dt_s > 0.0)
}

/// The rate of the navigation axes from settings.
pub(crate) fn axes_rate(rate_n: &[f64; 3]) -> Result<Vector3<f64>, Error> {
    for got in *rate_n {
        if got.is_nan() || got.abs() >= RATE_MAX {
            return Err(Error::Config { what: "rate_n", need: "below 1e6 rad/s", got });
        }
    }
    Ok(Vector3::from(*rate_n))
}

/// An initial attitude from four numbers, scalar first.
pub(crate) fn initial(q: Option<[f64; 4]>) -> Result<Option<UnitQuaternion<f64>>, Error> {
    let Some([w, x, y, z]) = q else {
        return Ok(None);
    };
    let norm = Quaternion::new(w, x, y, z).norm();
    if !(norm > 0.5 && norm < 2.0) {
        return Err(Error::Config { what: "initial_q_nb", need: "a unit quaternion", got: norm });
    }
    Ok(Some(UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z))))
}

/// Interval beyond which no clock is right, s.
const INTERVAL_MAX: f64 = 1.0e6;

/// Rate beyond which no body turns and no unit is right, rad/s.
const RATE_MAX: f64 = 1.0e6;
