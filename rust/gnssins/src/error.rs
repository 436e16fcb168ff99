//! The one error type of the crate: every variant says what, need and got; [`Error::code`] is stable.

use thiserror::Error as ThisError;

/// Why an operation was refused. Row counts still balance after an error; the filter keeps the last state that it
/// reached, and after [`Error::Covariance`] must not be used on.
#[derive(Debug, Clone, Copy, PartialEq, ThisError)]
#[non_exhaustive]
pub enum Error {
    /// A configuration value is out of its range.
    #[error("{what} = {got}: {need}")]
    Config {
        /// The value's name as in the configuration.
        what: &'static str,
        /// The allowed range, in words.
        need: &'static str,
        /// The value given.
        got: f64,
    },
    /// The block list needs more states than the filter was compiled for.
    #[error("the block list needs {need} states, the filter holds {capacity}")]
    Capacity {
        /// States asked for, the nine of the navigation solution included.
        need: usize,
        /// States that the type can hold (`CAP`).
        capacity: usize,
    },
    /// A number is NaN, infinite, or beyond anything that navigates (1e9 m, 1e6 m/s).
    #[error("{what} is not finite or beyond all bounds at t = {t_ns} ns")]
    NonFinite {
        /// What is not finite.
        what: &'static str,
        /// Time of the filter, ns.
        t_ns: i64,
    },
    /// The NED model was asked to work where its transport rate grows without bound.
    #[error("latitude {lat_rad} rad is beyond the limit {limit_rad} rad of the NED model")]
    LatitudeLimit {
        /// Latitude, rad.
        lat_rad: f64,
        /// Limit of the model, rad.
        limit_rad: f64,
    },
    /// The chosen form of the attitude equations does not hold here.
    #[error("{what} of {got_rad} rad is beyond the limit {limit_rad} rad of the chosen attitude form")]
    AttitudeForm {
        /// Which angle.
        what: &'static str,
        /// Its value, rad.
        got_rad: f64,
        /// Limit of the form, rad.
        limit_rad: f64,
    },
    /// An IMU stamp lies before its predecessor.
    #[error("IMU row {row}: t = {t_ns} ns after {previous_ns} ns")]
    TimeBackwards {
        /// Row of the IMU table, from 0.
        row: u64,
        /// Its stamp, ns.
        t_ns: i64,
        /// The stamp before it, ns.
        previous_ns: i64,
    },
    /// A measurement is valid after the filter's time: propagate first.
    #[error("measurement valid at {t_ns} ns, the filter stands at {filter_ns} ns")]
    Future {
        /// Time of validity, ns.
        t_ns: i64,
        /// Time of the filter, ns.
        filter_ns: i64,
    },
    /// The IMU was silent for longer than the configuration allows.
    #[error("IMU row {row}: no sample from {from_ns} ns to {to_ns} ns, limit {limit_ns} ns")]
    Gap {
        /// Row after the gap, from 0.
        row: u64,
        /// Last stamp before the gap, ns.
        from_ns: i64,
        /// First stamp after it, ns.
        to_ns: i64,
        /// Longest allowed interval, ns.
        limit_ns: i64,
    },
    /// The covariance is no longer positive definite: the filter's numbers cannot be trusted from here on.
    #[error("covariance not positive definite at t = {t_ns} ns: state {state}, pivot {pivot}")]
    Covariance {
        /// Time of the filter, ns.
        t_ns: i64,
        /// Index of the state where the factorisation failed.
        state: usize,
        /// The offending pivot of the scaled matrix.
        pivot: f64,
    },
    /// Without aids the position has become unknown: the numbers mean nothing any more.
    #[error("position sigma {sd_m} m at t = {t_ns} ns")]
    Unbounded {
        /// Time of the filter, ns.
        t_ns: i64,
        /// Largest position sigma, m.
        sd_m: f64,
    },
    /// More measurements wait for the next IMU sample than the queue holds; the new one was not taken.
    #[error("{pending} measurements wait for an IMU sample later than {t_ns} ns, capacity {pending}")]
    QueueFull {
        /// Measurements that wait.
        pending: usize,
        /// Time of the last IMU sample, ns.
        t_ns: i64,
    },
    /// A saved state does not fit this filter.
    #[error("saved state: {what}, need {need}, got {got}")]
    SavedState {
        /// What does not fit.
        what: &'static str,
        /// Value that this filter needs.
        need: u64,
        /// Value found.
        got: u64,
    },
}

impl Error {
    /// Stable machine-readable code, `group.detail`.
    #[must_use]
    pub fn code(&self) -> &'static str {
        match self {
            Error::Config { .. } => "config.range",
            Error::Capacity { .. } => "config.capacity",
            Error::NonFinite { .. } => "state.non_finite",
            Error::LatitudeLimit { .. } => "state.latitude",
            Error::AttitudeForm { .. } => "nav.attitude_form",
            Error::TimeBackwards { .. } => "time.backwards",
            Error::Future { .. } => "time.future",
            Error::Gap { .. } => "gap.imu",
            Error::Covariance { .. } => "cov.not_positive_definite",
            Error::Unbounded { .. } => "state.unbounded",
            Error::QueueFull { .. } => "time.queue_full",
            Error::SavedState { .. } => "state.saved",
        }
    }

    /// What the user can do about it.
    #[must_use]
    pub fn hint(&self) -> &'static str {
        match self {
            Error::Config { .. } => "give a value in the stated range",
            Error::Capacity { .. } => "drop blocks, or build the filter with a larger CAP",
            Error::NonFinite { .. } => "check units and axes of the input and the initial state",
            Error::LatitudeLimit { .. } => {
                "use the ECEF model (filter.model = \"ecef\"): it works at the poles"
            }
            Error::AttitudeForm { .. } => {
                "use attitude_form = \"rotation-vector\": it holds at every attitude and for every turn"
            }
            Error::TimeBackwards { .. } => {
                "set [imu] on_backwards = \"sort\" or \"drop\", or check the logger's clock"
            }
            Error::Gap { .. } => "raise [imu] max_gap_s, set on_gap = \"bridge\", or cut the run at the gap",
            Error::Future { .. } => "feed IMU data up to the measurement first, or use stream::Navigator",
            Error::Covariance { .. } => {
                "check initial sigmas and noise densities for extreme ratios, and the measurement covariance"
            }
            Error::Unbounded { .. } => "end the run at the last fix, or start a new one where fixes return",
            Error::QueueFull { .. } => "feed IMU samples before later measurements",
            Error::SavedState { .. } => "restore with the configuration that saved it",
        }
    }
}
