//! Measurements: each gives predicted minus measured, its Jacobian rows and its covariance; one file per aid.

pub mod gnss;

use nalgebra::Vector3;

use crate::layout::Layout;
use crate::nav::NavModel;
use crate::small::{ROWS_MAX, Square};

/// What a measurement sees of the filter.
#[derive(Debug, Clone, Copy)]
pub struct View<'a, M, const CAP: usize> {
    /// Navigation state.
    pub model: &'a M,
    /// Where the blocks are.
    pub layout: &'a Layout<CAP>,
    /// Block parameters by state index.
    pub params: &'a [f64; CAP],
    /// IMU to antenna with the estimated correction, m, body axes.
    pub lever_b_m: Vector3<f64>,
    /// Latest body rate, corrected, rad/s.
    pub w_ib_b: Vector3<f64>,
}

/// A linearised measurement `y = predicted - measured = H x - noise` of at most six rows.
#[derive(Debug, Clone, Copy)]
pub struct Rows<const CAP: usize> {
    /// Rows in use.
    pub len: usize,
    /// Predicted minus measured.
    pub y: [f64; ROWS_MAX],
    /// Jacobian rows over all states.
    pub h: [[f64; CAP]; ROWS_MAX],
    /// Noise covariance.
    pub r: Square,
    /// Which component of the measurement a row is: its place in records.
    pub component: [usize; ROWS_MAX],
}

/// An aid: anything that can be linearised at the present state.
pub trait Measurement {
    /// Time of validity, ns.
    fn t_ns(&self) -> i64;

    /// The rows at the present state.
    ///
    /// # Errors
    /// The reason why the measurement cannot be used whatever the state; it is then counted as bad.
    fn rows<M: NavModel, const CAP: usize>(&self, view: &View<M, CAP>) -> Result<Rows<CAP>, BadReason>;
}

/// Why a measurement is bad.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum BadReason {
    /// No component is given.
    Empty,
    /// A value is NaN, infinite or out of its range.
    Value,
    /// Latitude and longitude are exactly zero: a receiver without a fix.
    NoFix,
    /// Fusing it ended the run with an error.
    Fatal,
    /// The covariance has a NaN, a variance that is not positive, or is asymmetric or not positive definite.
    Covariance,
}

impl BadReason {
    /// What is wrong, in words.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Empty => "no component given",
            Self::Value => "value not finite or out of range",
            Self::NoFix => "latitude and longitude exactly 0: receiver without a fix",
            Self::Fatal => "fusing it ended the run with an error",
            Self::Covariance => {
                "covariance not positive definite (zero, negative, asymmetric, not finite) or beyond all precision"
            }
        }
    }
}

/// What became of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// Fused.
    Used,
    /// Refused by the chi-square gate.
    Rejected,
    /// Valid before the filter's time.
    Late,
    /// Not usable at all.
    Bad(BadReason),
}

/// One record per measurement in: what the filter thought of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Record {
    /// Row of the measurement's table, from 0, in the order fed.
    pub row: u64,
    /// Time of validity, ns.
    pub t_ns: i64,
    /// What became of it.
    pub status: Status,
    /// Number of rows, 0 when it was not evaluated.
    pub dof: usize,
    /// Normalised innovation squared on the prior.
    pub nis: f64,
    /// Components present, as bits.
    pub present: u8,
    /// Innovation, measured minus predicted, by component.
    pub innovation: [f64; ROWS_MAX],
    /// Innovation covariance H P H' + R, by component.
    pub innovation_cov: Square,
}

impl Record {
    /// A record of a measurement that was not evaluated.
    #[must_use]
    pub const fn unevaluated(row: u64, t_ns: i64, status: Status) -> Self {
        Self {
            row,
            t_ns,
            status,
            dof: 0,
            nis: 0.0,
            present: 0,
            innovation: [0.0; ROWS_MAX],
            innovation_cov: [[0.0; ROWS_MAX]; ROWS_MAX],
        }
    }
}
