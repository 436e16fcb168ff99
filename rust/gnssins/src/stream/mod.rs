//! From rows in time order to a filter: merging, splitting of IMU intervals at fixes, gaps, bad rows, counts.

mod events;
mod intervals;
mod save;
mod settings;

pub use events::{Counts, Event, EventKind, Sink};
pub use settings::{OnBackwards, OnGap, StreamSettings};

use nalgebra::Vector3;

use crate::discretise::ImuNoise;
use crate::ekf::Ekf;
use crate::error::Error;
use crate::imu::{ImuInput, Rates};
use crate::meas::baro::BaroHeight;
use crate::meas::gnss::GnssFix;
use crate::meas::heading::Heading;
use crate::meas::{BadReason, Measurement, Observation, PARTS, Record, SOURCES, Source, Status};
use crate::nav::NavModel;
use intervals::Intervals;

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
    refused: [Refused; PARTS],
    pending: [Option<(u64, Observation)>; PENDING],
    /// Measurements that wait: the first so many places of `pending`.
    waiting: usize,
    imu: Counts,
    aids: [Counts; SOURCES],
}

/// Fixes refused in a row.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Refused {
    count: u32,
    /// Sum of NIS over degrees of freedom.
    ratio: f64,
}

impl Refused {
    /// None so far.
    const NONE: Self = Self { count: 0, ratio: 0.0 };
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
            intervals: Intervals::NONE,
            saturated: false,
            refused: [Refused::NONE; PARTS],
            pending: [None; PENDING],
            waiting: 0,
            imu: NONE,
            aids: [NONE; SOURCES],
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
        self.counts(Source::Gnss)
    }

    /// Rows of a source by what became of them; those that wait for the next IMU row are only in the total.
    #[must_use]
    pub const fn counts(&self, source: Source) -> Counts {
        self.aids[source.index()]
    }

    /// Time of validity of a row of a source stamped `t_ns`.
    #[must_use]
    pub const fn valid_ns(&self, source: Source, t_ns: i64) -> i64 {
        t_ns.saturating_sub(self.settings.latency_ns[source.index()])
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
                    extra: ImuNoise::NONE,
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
    /// As [`Navigator::aid`].
    pub fn gnss(&mut self, fix: &GnssFix, sink: &mut impl Sink) -> Result<(), Error> {
        self.aid(&Observation::Gnss(*fix), sink)
    }

    /// Takes a row of the barometer; as [`Navigator::aid`].
    ///
    /// # Errors
    /// As [`Navigator::aid`].
    pub fn baro(&mut self, height: &BaroHeight, sink: &mut impl Sink) -> Result<(), Error> {
        self.aid(&Observation::Baro(*height), sink)
    }

    /// Takes a heading; as [`Navigator::aid`].
    ///
    /// # Errors
    /// As [`Navigator::aid`].
    pub fn heading(&mut self, heading: &Heading, sink: &mut impl Sink) -> Result<(), Error> {
        self.aid(&Observation::Heading(*heading), sink)
    }

    /// Takes a row of any aid; its time is its stamp, the configured latency of its source is taken off here.
    ///
    /// # Errors
    /// [`Error::QueueFull`] when too many rows wait for an IMU row (this one is then neither taken nor counted),
    /// and what the filter refuses.
    pub fn aid(&mut self, aid: &Observation, sink: &mut impl Sink) -> Result<(), Error> {
        let source = aid.source();
        let row = self.aids[source.index()].total;
        let aid = aid.at(self.valid_ns(source, aid.t_ns()));
        if aid.t_ns() <= self.ekf.t_ns() {
            self.aids[source.index()].total += 1;
            return self.fuse(row, &aid, sink);
        }
        let slot = self
            .pending
            .get_mut(self.waiting)
            .ok_or(Error::QueueFull { pending: PENDING, t_ns: self.ekf.t_ns() })?;
        *slot = Some((row, aid));
        self.waiting += 1;
        self.aids[source.index()].total += 1;
        Ok(())
    }

    /// Ends a log: rows that wait for an IMU row that will not come are counted as late.
    pub fn finish(&mut self, sink: &mut impl Sink) {
        while let Some((row, aid)) = self.take_pending(i64::MAX) {
            let (source, t_ns) = (aid.source(), aid.t_ns());
            self.aids[source.index()].late += 1;
            let value = seconds(t_ns, self.ekf.t_ns());
            sink.event(&Event { t_ns, row, kind: EventKind::AidAfterEnd(source), value });
            sink.record(&Record::unevaluated(source, row, t_ns, Status::Late));
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
            extra: ImuNoise::NONE,
            step_ns: i64::MAX,
        };
        self.run(&own, sink)
    }

    /// Propagates through an interval, stopping at every fix that is valid in it.
    fn run(&mut self, interval: &Interval, sink: &mut impl Sink) -> Result<(), Error> {
        while let Some(fix_ns) = self.next_pending_ns().filter(|t| *t <= interval.to_ns) {
            self.propagate(interval, fix_ns, sink)?;
            if let Some((row, aid)) = self.take_pending(fix_ns) {
                self.fuse(row, &aid, sink)?;
            }
        }
        self.propagate(interval, interval.to_ns, sink)
    }

    fn propagate(&mut self, interval: &Interval, target_ns: i64, sink: &mut impl Sink) -> Result<(), Error> {
        while self.ekf.t_ns() < target_ns {
            let next_ns = self.ekf.t_ns().saturating_add(interval.step_ns).min(target_ns);
            self.step(interval, next_ns, sink)?;
        }
        Ok(())
    }

    fn step(&mut self, interval: &Interval, target_ns: i64, sink: &mut impl Sink) -> Result<(), Error> {
        let seen = &mut |transition: &_| sink.transition(transition);
        let now = self.ekf.t_ns();
        let length = seconds(interval.to_ns, interval.from_ns);
        let at = |t_ns: i64| interval.start.towards(&interval.end, seconds(t_ns, interval.from_ns) / length);
        let whole = now == interval.from_ns && target_ns == interval.to_ns;
        if self.settings.input == ImuInput::Rates {
            let (a, b) = if whole { (interval.start, interval.end) } else { (at(now), at(target_ns)) };
            return self.ekf.predict_rates_with(target_ns, &a, &b, &interval.extra, seen);
        }
        let (dtheta, dvel) = match interval.increments.filter(|_| whole) {
            Some(increments) => increments,
            None => {
                let dt_s = seconds(target_ns, now);
                (interval.end.gyro * dt_s, interval.end.accel * dt_s)
            }
        };
        self.ekf.predict_with(target_ns, &dtheta, &dvel, &interval.extra, seen)
    }

    fn fuse(&mut self, row: u64, aid: &Observation, sink: &mut impl Sink) -> Result<(), Error> {
        let (source, t_ns) = (aid.source(), aid.t_ns());
        let counts = source.index();
        let record = match self.update(row, aid, sink) {
            Ok(record) => record,
            Err(error) => {
                self.aids[counts].bad += 1;
                sink.record(&Record::unevaluated(source, row, t_ns, Status::Bad(BadReason::Fatal)));
                return Err(error);
            }
        };
        let counts = &mut self.aids[counts];
        let (counter, event) = match record.status {
            Status::Used if record.refused != 0 => {
                (&mut counts.used, Some((EventKind::AidPartRejected(source), record.nis)))
            }
            Status::Used => (&mut counts.used, None),
            Status::Rejected => (&mut counts.rejected, Some((EventKind::AidRejected(source), record.nis))),
            Status::Late => {
                let late_s = seconds(t_ns, self.ekf.t_ns());
                (&mut counts.late, Some((EventKind::AidLate(source), late_s)))
            }
            Status::Bad(_) => (&mut counts.bad, Some((EventKind::AidBad(source), 0.0))),
        };
        *counter += 1;
        if let Some((kind, value)) = event {
            sink.event(&Event { t_ns, row, kind, value });
        }
        sink.record(&record);
        Ok(())
    }

    /// Fuses a measurement; a fix after a declared reset where too many were refused.
    fn update(&mut self, row: u64, aid: &Observation, sink: &mut impl Sink) -> Result<Record, Error> {
        let t_ns = aid.t_ns();
        let jumps = aid.new_constellation();
        // a late row changes nothing
        if t_ns >= self.ekf.t_ns() {
            self.ekf.close(&mut |transition| sink.transition(transition))?;
        }
        let record =
            self.ekf.update_with(row, aid, jumps, &mut |model, rows| sink.linearised(t_ns, model, rows))?;
        let Some(factor) = self.reset_factor(&record) else { return Ok(record) };
        self.ekf.reacquire(factor);
        sink.event(&Event { t_ns, row, kind: EventKind::FilterReset, value: factor });
        // what is rejected has changed nothing; of a fix that was used in part only the rest is tried again
        let again = match aid {
            Observation::Gnss(fix) if record.status == Status::Used => {
                Observation::Gnss(fix.only(record.refused))
            }
            other => *other,
        };
        let second = self.ekf.update_with(row, &again, false, &mut |_, _| {})?;
        let merged = record.status == Status::Used;
        Ok(if merged { Record { refused: second.refused, test: second.test, ..record } } else { second })
    }

    /// Follows the fixes refused in a row, position and velocity apart; when there are too many of either, the mean of
    /// their NIS per degree of freedom is the factor by which the covariance was too small.
    fn reset_factor(&mut self, record: &Record) -> Option<f64> {
        let judged = matches!(record.status, Status::Used | Status::Rejected);
        if record.source != Source::Gnss || !judged {
            return None;
        }
        let limit = self.settings.reacquire_after.unwrap_or(u32::MAX).max(1);
        let mut factor = None;
        for (part, (refused, ratio)) in self.refused.iter_mut().zip(&record.part_ratio).enumerate() {
            let bits = 0b111 << (3 * part) & record.present;
            if bits == 0 {
                continue;
            }
            if record.refused & bits == 0 {
                *refused = Refused::NONE;
                continue;
            }
            refused.count = refused.count.saturating_add(1);
            refused.ratio += ratio;
            if refused.count >= limit {
                factor = Some((refused.ratio / f64::from(refused.count)).max(factor.unwrap_or(1.0)));
            }
        }
        if factor.is_some() {
            self.refused = [Refused::NONE; PARTS];
        }
        factor
    }

    fn next_pending_ns(&self) -> Option<i64> {
        self.pending.iter().take(self.waiting).flatten().map(|(_, aid)| aid.t_ns()).min()
    }

    /// The earliest waiting measurement valid up to a time; where times are equal GNSS comes first, then rows fed earlier.
    fn take_pending(&mut self, until_ns: i64) -> Option<(u64, Observation)> {
        let places = self.pending.iter().take(self.waiting).enumerate();
        let (.., place) = places
            .filter_map(|(place, s)| s.map(|(row, a)| (a.t_ns(), a.source().index(), row, place)))
            .filter(|(t_ns, ..)| *t_ns <= until_ns)
            .min()?;
        // the last one takes its place
        self.waiting = self.waiting.saturating_sub(1);
        let last = self.pending.get_mut(self.waiting)?.take();
        match self.pending.get_mut(place) {
            Some(slot) if place != self.waiting => core::mem::replace(slot, last),
            _ => last,
        }
    }
}

fn seconds(later_ns: i64, earlier_ns: i64) -> f64 {
    later_ns.saturating_sub(earlier_ns) as f64 / 1e9
}
