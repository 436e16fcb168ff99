//! From rows in time order to a filter: merging, splitting of IMU intervals at fixes, gaps, bad rows, counts.

use nalgebra::Vector3;

use crate::bytes::{Reader, Writer};
use crate::discretise::ImuNoise;
use crate::ekf::Ekf;
use crate::error::Error;
use crate::imu::{Calibration, ImuInput, Rates};
use crate::meas::gnss::GnssFix;
use crate::meas::{BadReason, Measurement, Record, Status};
use crate::nav::NavModel;

/// Fixes that may wait for the next IMU sample, unless the type says otherwise.
pub const PENDING_MAX: usize = 32;

/// Change of the angular rate that a vehicle may make unseen in a gap, rad/s per s, and its largest rate, rad/s.
const GAP_GYRO_SLOPE: f64 = 0.1;
const GAP_GYRO_MOST: f64 = 0.5;
/// The same of the specific force, m/s² per s and m/s².
const GAP_ACCEL_SLOPE: f64 = 1.0;
const GAP_ACCEL_MOST: f64 = 5.0;

/// An interval longer than this many usual ones is a gap, for increments and mean rates: a row is missing.
const GAP_FACTOR_MEAN: f64 = 1.8;
/// The same for sampled rates, where a missing row only coarsens the trapezoid.
const GAP_FACTOR_RATES: f64 = 3.5;

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
    /// GNSS stamp minus time of validity, ns.
    pub latency_ns: i64,
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
            latency_ns: 0,
            reacquire_after: Some(10),
        }
    }
}

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
    /// A GNSS row was refused by the gate.
    GnssRejected,
    /// A GNSS row was valid before the filter's time.
    GnssLate,
    /// A GNSS row cannot be used.
    GnssBad,
    /// A GNSS row lies after the last IMU row.
    GnssAfterEnd,
    /// So many fixes in a row were refused that the covariance was raised to fit them.
    FilterReset,
}

impl EventKind {
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
            Self::GnssRejected => "gnss.rejected",
            Self::GnssLate => "gnss.late",
            Self::GnssBad => "gnss.bad",
            Self::GnssAfterEnd => "gnss.after_end",
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
            Self::GnssRejected => "GNSS row refused by the chi-square gate (NIS)",
            Self::GnssLate => "GNSS row valid before the filter's time (s)",
            Self::GnssBad => "GNSS row not usable",
            Self::GnssAfterEnd => "GNSS row after the last IMU row (s)",
            Self::FilterReset => "fixes refused too often: covariance raised by this factor, fix tried again",
        }
    }
}

/// Where events and records go. All methods may be left out; `()` drops everything.
pub trait Sink {
    /// Takes an event.
    fn event(&mut self, _event: &Event) {}
    /// Takes the record of a measurement, one per row fed.
    fn record(&mut self, _record: &Record) {}
}

impl Sink for () {}

#[derive(Debug, Clone, Copy)]
struct Last {
    t_ns: i64,
    raw: Rates,
    /// Rates at the stamp, or mean rates of the interval before it, calibrated.
    rates: Rates,
}

/// A filter fed by rows: the same object serves logs and live streams.
#[derive(Debug, Clone)]
pub struct Navigator<M, const CAP: usize, const PENDING: usize = PENDING_MAX> {
    ekf: Ekf<M, CAP>,
    settings: StreamSettings,
    last: Option<Last>,
    intervals: Intervals,
    saturated: bool,
    refused: Refused,
    pending: [Option<(u64, GnssFix)>; PENDING],
    /// Fixes that wait: the first so many places of `pending`.
    waiting: usize,
    imu: Counts,
    gnss: Counts,
}

/// Fixes refused in a row.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Refused {
    count: u32,
    /// Sum of NIS over degrees of freedom.
    ratio: f64,
}

/// Intervals that the usual one is taken from.
const INTERVALS: usize = 8;

/// The latest IMU intervals. Their median is the usual one: a single gap or jittered stamp does not move it, a lasting
/// change of rate does after a few rows. Stamps that come early and late in turn are told from missing rows by what the
/// early ones owe.
#[derive(Debug, Clone, Copy)]
struct Intervals {
    recent: [i64; INTERVALS],
    next: usize,
    /// Time by which stamps came early and which a long interval may make up for, ns.
    owed_ns: i64,
}

impl Intervals {
    fn push(&mut self, dt_ns: i64) {
        if let Some(usual) = self.usual_ns() {
            self.owed_ns = self.owed_ns.saturating_add(usual.saturating_sub(dt_ns)).clamp(0, usual);
        }
        self.recent[self.next % INTERVALS] = dt_ns;
        self.next = (self.next + 1) % INTERVALS;
    }

    /// Median, ns, or `None` until the window is full.
    fn usual_ns(&self) -> Option<i64> {
        let mut sorted = self.recent;
        sorted.sort_unstable();
        (sorted[0] > 0).then(|| sorted[INTERVALS / 2 - 1] / 2 + sorted[INTERVALS / 2] / 2)
    }
}

/// One IMU interval on its way to the filter.
struct Interval {
    from_ns: i64,
    to_ns: i64,
    start: Rates,
    end: Rates,
    /// Whole increments where the rows hold them.
    increments: Option<(Vector3<f64>, Vector3<f64>)>,
    extra: ImuNoise,
    /// Longest step, ns: a bridged gap is crossed in steps of the usual length.
    step_ns: i64,
}

impl<M: NavModel, const CAP: usize> Navigator<M, CAP> {
    /// Around a filter at its start, with room for [`PENDING_MAX`] fixes that wait.
    #[must_use]
    pub const fn new(ekf: Ekf<M, CAP>, settings: StreamSettings) -> Self {
        Self::with_queue(ekf, settings)
    }
}

impl<M: NavModel, const CAP: usize, const PENDING: usize> Navigator<M, CAP, PENDING> {
    /// Around a filter at its start, with room for `PENDING` fixes that wait for the next IMU row.
    #[must_use]
    pub const fn with_queue(ekf: Ekf<M, CAP>, settings: StreamSettings) -> Self {
        const NONE: Counts = Counts { total: 0, used: 0, rejected: 0, late: 0, bad: 0 };
        Self {
            ekf,
            settings,
            last: None,
            intervals: Intervals { recent: [0; INTERVALS], next: 0, owed_ns: 0 },
            saturated: false,
            refused: Refused { count: 0, ratio: 0.0 },
            pending: [None; PENDING],
            waiting: 0,
            imu: NONE,
            gnss: NONE,
        }
    }

    /// The filter.
    #[must_use]
    pub const fn ekf(&self) -> &Ekf<M, CAP> {
        &self.ekf
    }

    /// IMU rows by what became of them.
    #[must_use]
    pub const fn imu_counts(&self) -> Counts {
        self.imu
    }

    /// GNSS rows by what became of them; those that wait for the next IMU row are only in the total.
    #[must_use]
    pub const fn gnss_counts(&self) -> Counts {
        self.gnss
    }

    /// Time of validity of a GNSS row stamped `t_ns`.
    #[must_use]
    pub const fn valid_ns(&self, t_ns: i64) -> i64 {
        t_ns.saturating_sub(self.settings.latency_ns)
    }

    /// Takes an IMU row: rates (rad/s, m/s²) or increments (rad, m/s), body axes. Fixes that wait for a time up to this
    /// row are fused at their own epoch.
    ///
    /// # Errors
    /// [`Error::TimeBackwards`] and [`Error::Gap`] as configured, and what the filter refuses.
    pub fn imu(
        &mut self,
        t_ns: i64,
        gyro: &Vector3<f64>,
        accel: &Vector3<f64>,
        sink: &mut impl Sink,
    ) -> Result<(), Error> {
        let row = self.imu.total;
        let raw = Rates { gyro: *gyro, accel: *accel };
        if let Some(kind) = self.refuse(row, t_ns, &raw)? {
            self.imu.total += 1;
            self.imu.bad += 1;
            let value = self.last.map_or(0.0, |l| seconds(t_ns, l.t_ns));
            sink.event(&Event { t_ns, row, kind, value });
            return Ok(());
        }
        self.imu.total += 1;
        let done = self.accept(row, t_ns, raw, sink);
        match done {
            Ok(true) => self.imu.used += 1,
            Ok(false) => self.imu.late += 1,
            Err(_) => self.imu.bad += 1,
        }
        done.map(|_| ())
    }

    /// Takes a row in order; `false` when it lies before the start.
    fn accept(&mut self, row: u64, t_ns: i64, raw: Rates, sink: &mut impl Sink) -> Result<bool, Error> {
        let previous = self.last;
        let now = self.ekf.t_ns();
        let dt_ns = t_ns.saturating_sub(previous.map_or(now, |l| l.t_ns));
        let gap = self.classify_gap(row, t_ns, dt_ns)?;
        // a row after a hole holds only its own interval
        let row_dt_ns = self.intervals.usual_ns().filter(|_| gap.is_some()).unwrap_or(dt_ns);
        let row_dt_s = row_dt_ns as f64 / 1e9;
        self.watch_range(row, t_ns, &self.measured_rates(&raw, row_dt_s), sink);
        let rates = self.calibrated(&raw, row_dt_s);
        self.last = Some(Last { t_ns, raw, rates });
        if previous.is_some() {
            self.intervals.push(dt_ns);
        }
        if t_ns <= now {
            // the row at the start is its first sample; earlier ones only tell the rate of the row after them
            self.ekf.set_body_rate(&rates.gyro);
            return Ok(t_ns == now);
        }
        let from_ns = previous.map_or(now, |l| l.t_ns);
        let sampled = self.settings.input == ImuInput::Rates;
        let start = previous.map_or(rates, |l| l.rates);
        match gap {
            None => {
                let increments = (self.settings.input == ImuInput::Increments)
                    .then(|| self.calibrated_increments(&raw, row_dt_s));
                let start = if sampled { start } else { rates };
                let interval = Interval {
                    from_ns,
                    to_ns: t_ns,
                    start,
                    end: rates,
                    increments,
                    extra: NO_NOISE,
                    step_ns: i64::MAX,
                };
                self.run(&interval, sink)?;
            }
            Some(kind) => {
                sink.event(&Event { t_ns, row, kind, value: dt_ns as f64 / 1e9 });
                self.bridge(from_ns, t_ns, row_dt_ns, &start, &rates, sink)?;
            }
        }
        Ok(true)
    }

    /// Takes a GNSS row; `fix.t_ns` is its stamp, the configured latency is taken off here.
    ///
    /// # Errors
    /// [`Error::QueueFull`] when too many fixes wait for an IMU row (this one is then neither taken nor counted),
    /// and what the filter refuses.
    pub fn gnss(&mut self, fix: &GnssFix, sink: &mut impl Sink) -> Result<(), Error> {
        let row = self.gnss.total;
        let fix = GnssFix { t_ns: self.valid_ns(fix.t_ns), ..*fix };
        if fix.t_ns <= self.ekf.t_ns() {
            self.gnss.total += 1;
            return self.fuse(row, &fix, sink);
        }
        let slot = self
            .pending
            .get_mut(self.waiting)
            .ok_or(Error::QueueFull { pending: PENDING, t_ns: self.ekf.t_ns() })?;
        *slot = Some((row, fix));
        self.waiting += 1;
        self.gnss.total += 1;
        Ok(())
    }

    /// Ends a log: fixes that wait for an IMU row that will not come are counted as late.
    pub fn finish(&mut self, sink: &mut impl Sink) {
        while let Some((row, fix)) = self.take_pending(i64::MAX) {
            self.gnss.late += 1;
            let value = seconds(fix.t_ns, self.ekf.t_ns());
            sink.event(&Event { t_ns: fix.t_ns, row, kind: EventKind::GnssAfterEnd, value });
            sink.record(&Record::unevaluated(row, fix.t_ns, Status::Late));
        }
    }

    /// Why an IMU row cannot be used, or an error where time going back stops the run.
    fn refuse(&self, row: u64, t_ns: i64, raw: &Rates) -> Result<Option<EventKind>, Error> {
        if !raw.is_finite() {
            return Ok(Some(EventKind::ImuNotFinite));
        }
        let Some(last) = self.last else { return Ok(None) };
        if t_ns == last.t_ns {
            let same = *raw == last.raw;
            return Ok(Some(if same { EventKind::ImuDuplicate } else { EventKind::ImuConflict }));
        }
        if t_ns > last.t_ns {
            return Ok(None);
        }
        match self.settings.on_backwards {
            OnBackwards::Stop => Err(Error::TimeBackwards { row, t_ns, previous_ns: last.t_ns }),
            OnBackwards::Drop => Ok(Some(EventKind::ImuBackwards)),
        }
    }

    fn classify_gap(&self, row: u64, t_ns: i64, dt_ns: i64) -> Result<Option<EventKind>, Error> {
        if t_ns <= self.ekf.t_ns() {
            return Ok(None);
        }
        let usual = self.intervals.usual_ns();
        if dt_ns > self.settings.max_gap_ns {
            // increments cannot be told from rates over a hole while the usual interval is not known
            let blind = usual.is_none() && self.settings.input == ImuInput::Increments;
            return match self.settings.on_gap {
                OnGap::Bridge if !blind => Ok(Some(EventKind::ImuGapLong)),
                _ => Err(Error::Gap {
                    row,
                    from_ns: t_ns.saturating_sub(dt_ns),
                    to_ns: t_ns,
                    limit_ns: self.settings.max_gap_ns,
                }),
            };
        }
        let factor = if self.settings.input == ImuInput::Rates { GAP_FACTOR_RATES } else { GAP_FACTOR_MEAN };
        let due_ns = dt_ns.saturating_sub(self.intervals.owed_ns);
        let gap = usual.is_some_and(|usual| due_ns as f64 > factor * usual as f64);
        Ok(gap.then_some(EventKind::ImuGap))
    }

    /// Rates as the sensor gave them.
    fn measured_rates(&self, raw: &Rates, dt_s: f64) -> Rates {
        let scale = match self.settings.input {
            ImuInput::Increments if dt_s > 0.0 => 1.0 / dt_s,
            _ => 1.0,
        };
        Rates { gyro: raw.gyro * scale, accel: raw.accel * scale }
    }

    fn calibrated(&self, raw: &Rates, dt_s: f64) -> Rates {
        let measured = self.measured_rates(raw, dt_s);
        Rates {
            gyro: self.settings.gyro.rate(&measured.gyro),
            accel: self.settings.accel.rate(&measured.accel),
        }
    }

    fn calibrated_increments(&self, raw: &Rates, dt_s: f64) -> (Vector3<f64>, Vector3<f64>) {
        (self.settings.gyro.increment(&raw.gyro, dt_s), self.settings.accel.increment(&raw.accel, dt_s))
    }

    fn watch_range(&mut self, row: u64, t_ns: i64, rates: &Rates, sink: &mut impl Sink) {
        let reaches = |range: Option<f64>, v: &Vector3<f64>| range.is_some_and(|r| v.amax() >= r);
        let gyro = reaches(self.settings.gyro_range, &rates.gyro);
        let now = gyro || reaches(self.settings.accel_range, &rates.accel);
        if now && !self.saturated {
            let value = if gyro { rates.gyro.amax() } else { rates.accel.amax() };
            sink.event(&Event { t_ns, row, kind: EventKind::ImuSaturated, value });
        }
        self.saturated = now;
    }

    /// Crosses a gap of length T in steps of the usual length. In between the rates may have been anywhere between those
    /// of its ends, or have changed and come back: constant over the gap with the variance Δ²/12 + (s T/2)², a density
    /// of T times that, where s is what a vehicle may change its rates by in a second.
    fn bridge(
        &mut self,
        from_ns: i64,
        to_ns: i64,
        row_dt_ns: i64,
        start: &Rates,
        end: &Rates,
        sink: &mut impl Sink,
    ) -> Result<(), Error> {
        self.ekf.break_increments();
        let length_s = seconds(to_ns, from_ns);
        let density = |a: &Vector3<f64>, b: &Vector3<f64>, slope: f64, most: f64| {
            let unseen = (0.5 * slope * length_s).min(most);
            (b - a).map(|d| (d * d / 12.0 + unseen * unseen) * length_s)
        };
        let extra = ImuNoise {
            gyro_psd: density(&start.gyro, &end.gyro, GAP_GYRO_SLOPE, GAP_GYRO_MOST),
            accel_psd: density(&start.accel, &end.accel, GAP_ACCEL_SLOPE, GAP_ACCEL_MOST),
        };
        let step_ns = self.intervals.usual_ns().unwrap_or(row_dt_ns).max(1_000_000);
        if self.settings.input == ImuInput::Rates {
            let whole =
                Interval { from_ns, to_ns, start: *start, end: *end, increments: None, extra, step_ns };
            return self.run(&whole, sink);
        }
        // the row itself covers only its own interval, where that is known; the hole before it gets the mean of both
        // neighbours
        let known_ns = self.intervals.usual_ns().map_or(0, |_| row_dt_ns);
        let middle_ns = to_ns.saturating_sub(known_ns).max(from_ns);
        let mean = start.towards(end, 0.5);
        let hole =
            Interval { from_ns, to_ns: middle_ns, start: mean, end: mean, increments: None, extra, step_ns };
        self.run(&hole, sink)?;
        self.ekf.break_increments();
        let own = Interval {
            from_ns: middle_ns,
            to_ns,
            start: *end,
            end: *end,
            increments: None,
            extra: NO_NOISE,
            step_ns: i64::MAX,
        };
        self.run(&own, sink)
    }

    /// Propagates through an interval, stopping at every fix that is valid in it.
    fn run(&mut self, interval: &Interval, sink: &mut impl Sink) -> Result<(), Error> {
        while let Some(fix_ns) = self.next_pending_ns().filter(|t| *t <= interval.to_ns) {
            self.propagate(interval, fix_ns)?;
            if let Some((row, fix)) = self.take_pending(fix_ns) {
                self.fuse(row, &fix, sink)?;
            }
        }
        self.propagate(interval, interval.to_ns)
    }

    fn propagate(&mut self, interval: &Interval, target_ns: i64) -> Result<(), Error> {
        while self.ekf.t_ns() < target_ns {
            let next_ns = self.ekf.t_ns().saturating_add(interval.step_ns).min(target_ns);
            self.step(interval, next_ns)?;
        }
        Ok(())
    }

    fn step(&mut self, interval: &Interval, target_ns: i64) -> Result<(), Error> {
        let now = self.ekf.t_ns();
        let length = seconds(interval.to_ns, interval.from_ns);
        let at = |t_ns: i64| interval.start.towards(&interval.end, seconds(t_ns, interval.from_ns) / length);
        let whole = now == interval.from_ns && target_ns == interval.to_ns;
        if self.settings.input == ImuInput::Rates {
            let (a, b) = if whole { (interval.start, interval.end) } else { (at(now), at(target_ns)) };
            return self.ekf.predict_rates_with(target_ns, &a, &b, &interval.extra);
        }
        let (dtheta, dvel) = match interval.increments.filter(|_| whole) {
            Some(increments) => increments,
            None => {
                let dt_s = seconds(target_ns, now);
                (interval.end.gyro * dt_s, interval.end.accel * dt_s)
            }
        };
        self.ekf.predict_with(target_ns, &dtheta, &dvel, &interval.extra)
    }

    fn fuse(&mut self, row: u64, fix: &GnssFix, sink: &mut impl Sink) -> Result<(), Error> {
        let record = match self.update(row, fix, sink) {
            Ok(record) => record,
            Err(error) => {
                self.gnss.bad += 1;
                sink.record(&Record::unevaluated(row, fix.t_ns, Status::Bad(BadReason::Fatal)));
                return Err(error);
            }
        };
        let (counter, event) = match record.status {
            Status::Used => (&mut self.gnss.used, None),
            Status::Rejected => (&mut self.gnss.rejected, Some((EventKind::GnssRejected, record.nis))),
            Status::Late => {
                (&mut self.gnss.late, Some((EventKind::GnssLate, seconds(fix.t_ns(), self.ekf.t_ns()))))
            }
            Status::Bad(_) => (&mut self.gnss.bad, Some((EventKind::GnssBad, 0.0))),
        };
        *counter += 1;
        if let Some((kind, value)) = event {
            sink.event(&Event { t_ns: fix.t_ns, row, kind, value });
        }
        sink.record(&record);
        Ok(())
    }

    /// Fuses a fix, after a declared reset where too many were refused.
    fn update(&mut self, row: u64, fix: &GnssFix, sink: &mut impl Sink) -> Result<Record, Error> {
        let record = self.ekf.update(row, fix)?;
        let Some(factor) = self.reset_factor(&record) else { return Ok(record) };
        self.ekf.raise_covariance(factor);
        sink.event(&Event { t_ns: fix.t_ns, row, kind: EventKind::FilterReset, value: factor });
        self.ekf.update(row, fix)
    }

    /// Follows the fixes refused in a row; when there are too many, the mean of their NIS per degree of freedom is the
    /// factor by which the covariance was too small.
    fn reset_factor(&mut self, record: &Record) -> Option<f64> {
        match record.status {
            Status::Used => self.refused = Refused { count: 0, ratio: 0.0 },
            Status::Rejected => {
                self.refused.count += 1;
                self.refused.ratio += record.nis / record.dof as f64;
            }
            Status::Late | Status::Bad(_) => {}
        }
        let Refused { count, ratio } = self.refused;
        let limit = self.settings.reacquire_after?;
        (count >= limit.max(1)).then(|| {
            self.refused = Refused { count: 0, ratio: 0.0 };
            (ratio / f64::from(count)).max(1.0)
        })
    }

    fn next_pending_ns(&self) -> Option<i64> {
        self.pending.iter().take(self.waiting).flatten().map(|(_, fix)| fix.t_ns).min()
    }

    /// The earliest waiting fix valid up to a time; rows fed earlier come first where times are equal.
    fn take_pending(&mut self, until_ns: i64) -> Option<(u64, GnssFix)> {
        let places = self.pending.iter().take(self.waiting).enumerate();
        let (_, _, place) = places
            .filter_map(|(place, s)| s.map(|(row, f)| (f.t_ns, row, place)))
            .filter(|(t_ns, ..)| *t_ns <= until_ns)
            .min()?;
        self.waiting -= 1;
        self.pending.swap(place, self.waiting);
        self.pending[self.waiting].take()
    }

    /// Bytes that [`Navigator::save`] writes at most.
    #[must_use]
    pub const fn saved_len(&self) -> usize {
        self.ekf.saved_len() + 8 * (1 + 1 + 12 + INTERVALS + 2 + 1 + 2 + 10 + 1 + PENDING * FIX_WORDS)
    }

    /// Writes the state with everything that waits; [`Navigator::restore`] continues with the same bits.
    ///
    /// # Errors
    /// [`Error::SavedState`] when the buffer is too short.
    pub fn save(&self, out: &mut Writer<'_>) -> Result<(), Error> {
        self.ekf.save(out)?;
        out.u64(u64::from(self.last.is_some()))?;
        let last = self.last.unwrap_or(Last { t_ns: 0, raw: Rates::default(), rates: Rates::default() });
        out.i64(last.t_ns)?;
        for v in [&last.raw.gyro, &last.raw.accel, &last.rates.gyro, &last.rates.accel] {
            out.f64s(v.as_slice())?;
        }
        self.intervals.recent.iter().try_for_each(|dt| out.i64(*dt))?;
        out.u64(self.intervals.next as u64)?;
        out.i64(self.intervals.owed_ns)?;
        out.u64(u64::from(self.saturated))?;
        out.u64(u64::from(self.refused.count))?;
        out.f64s(&[self.refused.ratio])?;
        for c in [&self.imu, &self.gnss] {
            for v in [c.total, c.used, c.rejected, c.late, c.bad] {
                out.u64(v)?;
            }
        }
        out.u64(self.pending.iter().flatten().count() as u64)?;
        self.pending.iter().flatten().try_for_each(|(row, fix)| save_fix(out, *row, fix))
    }

    /// Restores what a navigator with the same configuration saved.
    ///
    /// # Errors
    /// [`Error::SavedState`] when the bytes do not fit; the navigator is then unchanged.
    pub fn restore(&mut self, saved: &mut Reader<'_>) -> Result<(), Error> {
        let mut next = self.clone();
        next.ekf.restore(saved)?;
        let some = saved.u64()? == 1;
        let t_ns = saved.i64()?;
        let mut v = [[0.0; 3]; 4];
        for v in &mut v {
            saved.f64s(v)?;
        }
        let [gyro, accel, gyro2, accel2] = v.map(Vector3::from);
        let rates = Rates { gyro: gyro2, accel: accel2 };
        next.last = some.then_some(Last { t_ns, raw: Rates { gyro, accel }, rates });
        for dt in &mut next.intervals.recent {
            *dt = saved.i64()?;
        }
        next.intervals.next = (saved.u64()? % INTERVALS as u64) as usize;
        next.intervals.owed_ns = saved.i64()?;
        next.saturated = saved.u64()? == 1;
        let count = saved.u64()?.min(u64::from(u32::MAX)) as u32;
        next.refused = Refused { count, ratio: saved.f64()? };
        for c in [&mut next.imu, &mut next.gnss] {
            for v in [&mut c.total, &mut c.used, &mut c.rejected, &mut c.late, &mut c.bad] {
                *v = saved.u64()?;
            }
        }
        let waiting = saved.u64()?;
        if waiting > PENDING as u64 {
            return Err(Error::SavedState { what: "waiting fixes", need: PENDING as u64, got: waiting });
        }
        next.pending = [None; PENDING];
        next.waiting = waiting as usize;
        for slot in next.pending.iter_mut().take(waiting as usize) {
            *slot = Some(restore_fix(saved)?);
        }
        *self = next;
        Ok(())
    }
}

const NO_NOISE: ImuNoise =
    ImuNoise { gyro_psd: Vector3::new(0.0, 0.0, 0.0), accel_psd: Vector3::new(0.0, 0.0, 0.0) };

/// Words of one saved fix: row, time, presence, three of position, three of velocity, 36 of covariance.
const FIX_WORDS: usize = 3 + 6 + 36;

fn save_fix(out: &mut Writer<'_>, row: u64, fix: &GnssFix) -> Result<(), Error> {
    let mut present = u64::from(fix.position.is_some());
    for (i, v) in fix.velocity_n.iter().enumerate() {
        present |= u64::from(v.is_some()) << (i + 1);
    }
    out.u64(row)?;
    out.i64(fix.t_ns)?;
    out.u64(present)?;
    let p = fix.position.unwrap_or(crate::frames::Lla::new(0.0, 0.0, 0.0));
    out.f64s(&[p.lat_rad, p.lon_rad, p.height_m])?;
    out.f64s(&fix.velocity_n.map(|v| v.unwrap_or(0.0)))?;
    fix.covariance.iter().try_for_each(|r| out.f64s(r))
}

fn restore_fix(saved: &mut Reader<'_>) -> Result<(u64, GnssFix), Error> {
    let row = saved.u64()?;
    let t_ns = saved.i64()?;
    let present = saved.u64()?;
    let (mut p, mut v, mut covariance) = ([0.0; 3], [0.0; 3], [[0.0; 6]; 6]);
    saved.f64s(&mut p)?;
    saved.f64s(&mut v)?;
    for r in &mut covariance {
        saved.f64s(r)?;
    }
    let position = (present & 1 == 1).then(|| crate::frames::Lla::new(p[0], p[1], p[2]));
    let velocity_n = core::array::from_fn(|i| (present >> (i + 1) & 1 == 1).then_some(v[i]));
    Ok((row, GnssFix { t_ns, position, velocity_n, covariance }))
}

fn seconds(later_ns: i64, earlier_ns: i64) -> f64 {
    later_ns.saturating_sub(earlier_ns) as f64 / 1e9
}
