//! What a stream tells beside the solution: events, records, counts.

use crate::discretise::Transition;
use crate::meas::{Record, Rows, Source};
use crate::nav::NavModel;

/// Rows by what became of them: total = used + rejected + late + bad + those that still wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Rows fed.
    pub total: u64,
    /// Rows used.
    pub used: u64,
    /// Rows refused by a gate.
    pub rejected: u64,
    /// Rows before the filter's time.
    pub late: u64,
    /// Rows that cannot be used.
    pub bad: u64,
}

/// Something worth telling the user.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Event {
    /// Time, ns.
    pub t_ns: i64,
    /// Row of its table, from 0.
    pub row: u64,
    /// What happened.
    pub kind: EventKind,
    /// A number that belongs to it: seconds of a gap, a rate.
    pub value: f64,
}

/// Kinds of [`Event`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum EventKind {
    /// An IMU row holds a NaN or infinity; dropped.
    ImuNotFinite,
    /// An IMU row repeats the one before; dropped.
    ImuDuplicate,
    /// An IMU row has the time of the one before but other values; dropped.
    ImuConflict,
    /// An IMU row lies before the one before; dropped.
    ImuBackwards,
    /// Rows are missing within the allowed gap; bridged with raised noise.
    ImuGap,
    /// A gap beyond the limit; bridged with raised noise as configured.
    ImuGapLong,
    /// A sensor reached its range.
    ImuSaturated,
    /// A row of an aid was refused by its tests.
    AidRejected(Source),
    /// A part of a GNSS row was refused by its tests, the rest used.
    AidPartRejected(Source),
    /// A row of an aid was valid before the filter's time.
    AidLate(Source),
    /// A row of an aid cannot be used.
    AidBad(Source),
    /// A row of an aid lies after the last IMU row.
    AidAfterEnd(Source),
    /// So many fixes in a row were refused that the covariance was raised to fit them.
    FilterReset,
}

impl EventKind {
    /// The aid that it is about.
    #[must_use]
    pub const fn source(self) -> Option<Source> {
        match self {
            Self::AidRejected(source)
            | Self::AidPartRejected(source)
            | Self::AidLate(source)
            | Self::AidBad(source)
            | Self::AidAfterEnd(source) => Some(source),
            _ => None,
        }
    }

    /// Stable code.
    #[must_use]
    pub const fn code(self) -> &'static str {
        match self {
            Self::ImuNotFinite => "imu.not_finite",
            Self::ImuDuplicate => "imu.duplicate",
            Self::ImuConflict => "imu.conflict",
            Self::ImuBackwards => "imu.backwards",
            Self::ImuGap => "imu.gap",
            Self::ImuGapLong => "imu.gap_long",
            Self::ImuSaturated => "imu.saturated",
            Self::AidRejected(source) => match source {
                Source::Gnss => "gnss.rejected",
                Source::Baro => "baro.rejected",
                Source::Heading => "heading.rejected",
            },
            Self::AidPartRejected(source) => match source {
                Source::Gnss => "gnss.part_rejected",
                Source::Baro => "baro.part_rejected",
                Source::Heading => "heading.part_rejected",
            },
            Self::AidLate(source) => match source {
                Source::Gnss => "gnss.late",
                Source::Baro => "baro.late",
                Source::Heading => "heading.late",
            },
            Self::AidBad(source) => match source {
                Source::Gnss => "gnss.bad",
                Source::Baro => "baro.bad",
                Source::Heading => "heading.bad",
            },
            Self::AidAfterEnd(source) => match source {
                Source::Gnss => "gnss.after_end",
                Source::Baro => "baro.after_end",
                Source::Heading => "heading.after_end",
            },
            Self::FilterReset => "filter.reset",
        }
    }

    /// What happened, in words; `value` has the unit named here.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::ImuNotFinite => "IMU row with NaN or infinity dropped",
            Self::ImuDuplicate => "IMU row repeats the one before: dropped",
            Self::ImuConflict => "IMU row with the time of the one before and other values: dropped",
            Self::ImuBackwards => "IMU row earlier than the one before (s): dropped",
            Self::ImuGap => "IMU gap (s) bridged with raised noise",
            Self::ImuGapLong => "IMU gap (s) beyond the limit bridged with raised noise",
            Self::ImuSaturated => "IMU value at its range (rad/s or m/s^2)",
            Self::AidRejected(source) => match source {
                Source::Gnss => "GNSS row refused by its tests (NIS)",
                Source::Baro => "barometer row refused by its tests (NIS)",
                Source::Heading => "heading row refused by its tests (NIS)",
            },
            Self::AidPartRejected(source) => match source {
                Source::Gnss => "GNSS row refused in part (NIS): position or velocity dropped",
                Source::Baro => "barometer row refused in part (NIS): position or velocity dropped",
                Source::Heading => "heading row refused in part (NIS): position or velocity dropped",
            },
            Self::AidLate(source) => match source {
                Source::Gnss => "GNSS row valid before the filter's time (s)",
                Source::Baro => "barometer row valid before the filter's time (s)",
                Source::Heading => "heading row valid before the filter's time (s)",
            },
            Self::AidBad(source) => match source {
                Source::Gnss => "GNSS row not usable",
                Source::Baro => "barometer row not usable",
                Source::Heading => "heading row not usable",
            },
            Self::AidAfterEnd(source) => match source {
                Source::Gnss => "GNSS row after the last IMU row (s)",
                Source::Baro => "barometer row after the last IMU row (s)",
                Source::Heading => "heading row after the last IMU row (s)",
            },
            Self::FilterReset => "fixes refused too often: covariance raised by this factor, fix tried again",
        }
    }
}

/// Where events and records go. All methods may be left out; `()` drops everything.
pub trait Sink {
    /// Takes the transition over one interval, as the covariance went through it.
    fn transition<const CAP: usize>(&mut self, _transition: &Transition<CAP>) {}
    /// Takes the linearised rows of a measurement, before its tests, and the model at which they hold.
    fn linearised<M: NavModel, const CAP: usize>(&mut self, _t_ns: i64, _model: &M, _rows: &Rows<CAP>) {}
    /// Takes an event.
    fn event(&mut self, _event: &Event) {}
    /// Takes the record of a measurement, one per row fed.
    fn record(&mut self, _record: &Record) {}
}

impl Sink for () {}
