//! Measurements: each gives predicted minus measured, its Jacobian rows and its covariance; one file per aid.

pub mod baro;
pub mod gnss;
pub mod heading;

use nalgebra::Vector3;

use crate::layout::Layout;
use crate::nav::{NAV, NavModel, Vector9};
use crate::small::{ROWS_MAX, Square};

/// Where a measurement comes from: each source has its own gate, latency, rows and counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// Position and velocity of a satellite receiver.
    Gnss,
    /// Height of a barometric altimeter.
    Baro,
    /// Heading of two antennas or another compass without errors of its own.
    Heading,
}

impl Source {
    /// All of them, in the order of [`Source::index`].
    pub const ALL: [Self; SOURCES] = [Self::Gnss, Self::Baro, Self::Heading];

    /// Place in tables by source.
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Name in configurations and codes.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Gnss => "gnss",
            Self::Baro => "baro",
            Self::Heading => "heading",
        }
    }
}

/// Number of sources.
pub const SOURCES: usize = 3;

/// Components that are judged together: position 0 to 2, velocity 3 to 5.
pub(crate) const PART: usize = 3;
/// Position and velocity.
pub const PARTS: usize = ROWS_MAX / PART;

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

impl<const CAP: usize> Rows<CAP> {
    /// A single row over the navigation errors along north, east, down, turned into the model's own axes.
    pub(crate) fn single<M: NavModel>(model: &M, y: f64, h_ned: &Vector9, variance: f64) -> Self {
        let mut rows = Self {
            len: 1,
            y: [0.0; ROWS_MAX],
            h: [[0.0; CAP]; ROWS_MAX],
            r: [[0.0; ROWS_MAX]; ROWS_MAX],
            component: [0; ROWS_MAX],
        };
        rows.y[0] = y;
        rows.r[0][0] = variance;
        let h = model.to_ned_errors().map_or(*h_ned, |t| t.tr_mul(h_ned));
        rows.h[0][..NAV].copy_from_slice(h.as_slice());
        rows
    }

    /// Only the rows whose components are not among the bits `refused`.
    pub(crate) fn without(&self, refused: u8) -> Self {
        let stays = |i: &usize| refused >> (self.component[*i] & 7) & 1 == 0;
        let from = || (0..self.len.min(ROWS_MAX)).filter(stays);
        let mut kept = Self { len: from().count(), ..*self };
        for (i, a) in (0..ROWS_MAX).zip(from()) {
            kept.y[i] = self.y[a];
            kept.h[i] = self.h[a];
            kept.component[i] = self.component[a];
            for (r, b) in kept.r[i].iter_mut().zip(from()) {
                *r = self.r[a][b];
            }
        }
        kept
    }
}

/// Refuses a variance that is none.
pub(crate) fn check_variance(variance: f64) -> Result<(), BadReason> {
    if variance.is_finite() && variance > 0.0 { Ok(()) } else { Err(BadReason::Covariance) }
}

/// An aid: anything that can be linearised at the present state.
pub trait Measurement {
    /// Time of validity, ns.
    fn t_ns(&self) -> i64;

    /// Where it comes from.
    fn source(&self) -> Source {
        Source::Gnss
    }

    /// Whether the constellation of satellites has changed since the measurement before: the errors that are
    /// correlated in time jump then (`jump_sd` of their blocks).
    fn new_constellation(&self) -> bool {
        false
    }

    /// The rows at the present state.
    ///
    /// # Errors
    /// The reason why the measurement cannot be used whatever the state; it is then counted as bad.
    fn rows<M: NavModel, const CAP: usize>(&self, view: &View<M, CAP>) -> Result<Rows<CAP>, BadReason>;
}

/// A row of any aid.
#[derive(Debug, Clone, Copy, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "without a heap nothing can be boxed")]
pub enum Observation {
    /// Position and velocity.
    Gnss(gnss::GnssFix),
    /// Barometric height.
    Baro(baro::BaroHeight),
    /// Heading.
    Heading(heading::Heading),
}

impl Observation {
    /// The same with another time.
    pub(crate) fn at(self, t_ns: i64) -> Self {
        match self {
            Self::Gnss(fix) => Self::Gnss(gnss::GnssFix { t_ns, ..fix }),
            Self::Baro(height) => Self::Baro(baro::BaroHeight { t_ns, ..height }),
            Self::Heading(heading) => Self::Heading(heading::Heading { t_ns, ..heading }),
        }
    }
}

/// Passes a call on to the measurement within.
macro_rules! inner {
    ($self:ident, $m:ident => $call:expr) => {
        match $self {
            Observation::Gnss($m) => $call,
            Observation::Baro($m) => $call,
            Observation::Heading($m) => $call,
        }
    };
}

impl Measurement for Observation {
    fn t_ns(&self) -> i64 {
        inner!(self, m => m.t_ns())
    }

    fn source(&self) -> Source {
        inner!(self, m => m.source())
    }

    fn new_constellation(&self) -> bool {
        inner!(self, m => m.new_constellation())
    }

    #[inline(always)]
    fn rows<M: NavModel, const CAP: usize>(&self, view: &View<M, CAP>) -> Result<Rows<CAP>, BadReason> {
        inner!(self, m => m.rows(view))
    }
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
    /// A heading while the body's forward axis is within five degrees of the vertical.
    Vertical,
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
            Self::Vertical => "no heading within 5 deg of the vertical",
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

/// Which test a measurement failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Test {
    /// Innovation against its covariance: chi-square.
    ChiSquare,
    /// Innovation squared over the trace of its covariance (Novik 2011).
    TraceRatio,
    /// Change since the last accepted measurement against what the vehicle can do.
    Tolerance,
}

impl Test {
    /// The test, in words.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::ChiSquare => "chi-square gate",
            Self::TraceRatio => "trace ratio",
            Self::Tolerance => "beyond what the vehicle can do",
        }
    }
}

/// One record per measurement in: what the filter thought of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Record {
    /// Where it comes from.
    pub source: Source,
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
    /// Components that were dropped, as bits; all of those present when the measurement was rejected.
    pub refused: u8,
    /// The test that dropped them.
    pub test: Option<Test>,
    /// NIS over degrees of freedom of what was dropped of position and of velocity, 0 where nothing was: the whole
    /// measurement's where it was judged as a whole.
    pub part_ratio: [f64; PARTS],
    /// Innovation, measured minus predicted, by component.
    pub innovation: [f64; ROWS_MAX],
    /// Innovation covariance H P H' + R, by component.
    pub innovation_cov: Square,
}

impl Record {
    /// Drops components; the first test that does so is named.
    pub(crate) fn refuse(&mut self, bits: u8, test: Test) {
        self.refused |= bits;
        self.test = self.test.or(Some(test));
    }

    /// Whether a position of the receiver was fused.
    pub(crate) fn position_used(&self) -> bool {
        self.source == Source::Gnss
            && self.status == Status::Used
            && self.present & !self.refused & 0b111 != 0
    }

    /// A record of a measurement that was not evaluated.
    #[must_use]
    pub const fn unevaluated(source: Source, row: u64, t_ns: i64, status: Status) -> Self {
        Self {
            source,
            row,
            t_ns,
            status,
            dof: 0,
            nis: 0.0,
            present: 0,
            refused: 0,
            test: None,
            part_ratio: [0.0; PARTS],
            innovation: [0.0; ROWS_MAX],
            innovation_cov: [[0.0; ROWS_MAX]; ROWS_MAX],
        }
    }
}
