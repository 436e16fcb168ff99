//! No step, update or row asks for memory: every allocation of the thread is counted.

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use common::{DT_NS, Leg, fix, fly, initial, settings, weaving};
use gnssins::attitude;
use gnssins::blocks::Block;
use gnssins::bytes::{Reader, Writer};
use gnssins::ekf::{Ekf, Gate, Integrity, Settings};
use gnssins::error::Error;
use gnssins::imu::{ImuInput, Rates};
use gnssins::meas::baro::BaroHeight;
use gnssins::meas::gnss::GnssFix;
use gnssins::meas::heading::Heading;
use gnssins::meas::{Measurement, Record, Source, Status};
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::Ned;
use gnssins::nav::{NavModel, Solution};
use gnssins::presets::{Model, PRESETS, Preset};
use gnssins::simd::Isa;
use gnssins::stream::{Event, EventKind, Navigator, OnBackwards, OnGap, Sink, StreamSettings};

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

struct Counting;

#[expect(unsafe_code, reason = "an allocator is unsafe by its nature; this one only counts and passes on")]
// SAFETY: every call goes to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        unsafe { System.dealloc(memory, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

/// Allocations of this thread during some work.
fn allocations(work: impl FnOnce()) -> u64 {
    let before = ALLOCATIONS.get();
    work();
    ALLOCATIONS.get() - before
}

/// Counts what it is told, by kind of event, and keeps nothing else.
#[derive(Default)]
struct Tally {
    records: u32,
    gaps: u32,
    long_gaps: u32,
    dropped: u32,
    saturated: u32,
    refused: u32,
    late: u32,
    bad: u32,
    resets: u32,
}

impl Sink for Tally {
    fn event(&mut self, event: &Event) {
        use EventKind::*;
        let place = match event.kind {
            ImuGap => &mut self.gaps,
            ImuGapLong => &mut self.long_gaps,
            ImuNotFinite | ImuDuplicate | ImuConflict | ImuBackwards => &mut self.dropped,
            ImuSaturated => &mut self.saturated,
            AidRejected(_) | AidPartRejected(_) => &mut self.refused,
            AidLate(_) | AidAfterEnd(_) => &mut self.late,
            AidBad(_) => &mut self.bad,
            FilterReset => &mut self.resets,
            _ => return,
        };
        *place += 1;
    }

    fn record(&mut self, _record: &Record) {
        self.records += 1;
    }
}

const PLACE: [f64; 3] = [47.0, 8.0, 500.0];
const CAP: usize = 24;
const GNSS_LATENCY_NS: i64 = 8_000_000;
const HEADING_LATENCY_NS: i64 = 15_000_000;

fn filter<M: NavModel>(preset: &Preset, isa: Isa, start: Solution, set: Settings) -> Ekf<M, CAP> {
    let blocks: Vec<Block> = preset.blocks.iter().map(|(_, b)| *b).collect();
    let mut ekf = Ekf::new(&Settings { noise: preset.noise, ..set }, &blocks, &initial(start)).unwrap();
    ekf.set_isa(isa);
    ekf
}

/// A fix that no gate lets pass: 5 km too far east.
fn astray(fix: &GnssFix) -> GnssFix {
    let position = fix.position.map(|p| gnssins::frames::Lla { lon_rad: p.lon_rad + 1e-3, ..p });
    GnssFix { position, ..*fix }
}

fn height(t_ns: i64, truth: &Solution) -> BaroHeight {
    BaroHeight { t_ns, height_m: truth.position.height_m, variance: 25.0 }
}

fn heading(t_ns: i64, truth: &Solution) -> Heading {
    Heading { t_ns, heading_rad: attitude::to_euler(&truth.q_nb).2, variance: 1e-4 }
}

fn verdict<M: NavModel>(ekf: &mut Ekf<M, CAP>, row: u64, z: &impl Measurement) -> Status {
    ekf.update(row, z).unwrap().status
}

/// Every call of the filter that a run makes, with every verdict on a measurement.
fn filter_calls<M: NavModel>(ekf: &mut Ekf<M, CAP>, legs: &[Leg], buffer: &mut [u8]) {
    for (k, leg) in legs.iter().enumerate() {
        if k % 2 == 0 {
            ekf.predict(leg.t_ns, &leg.delta.dtheta, &leg.delta.dvel).unwrap();
        } else {
            let mean =
                Rates { gyro: leg.delta.dtheta / leg.delta.dt_s, accel: leg.delta.dvel / leg.delta.dt_s };
            ekf.predict_rates(leg.t_ns, &mean, &mean).unwrap();
        }
        if k % 50 != 49 {
            continue;
        }
        let (t_ns, truth) = (leg.t_ns, &leg.truth);
        let good = fix(t_ns, truth, 1.0, 0.1);
        let mut bad = good;
        bad.covariance[0][0] = f64::NAN;
        let mut full = good;
        (full.covariance[0][1], full.covariance[1][0]) = (0.3, 0.3);
        let changed = GnssFix { new_constellation: true, ..good };
        assert_eq!(verdict(ekf, 0, &good), Status::Used);
        assert_eq!(verdict(ekf, 1, &full), Status::Used);
        assert_eq!(verdict(ekf, 2, &changed), Status::Used);
        assert_eq!(verdict(ekf, 3, &height(t_ns, truth)), Status::Used);
        assert_eq!(verdict(ekf, 4, &heading(t_ns, truth)), Status::Used);
        assert_eq!(verdict(ekf, 6, &GnssFix { t_ns: t_ns - 1, ..good }), Status::Late);
        assert!(matches!(verdict(ekf, 7, &bad), Status::Bad(_)));
        let refused = ekf.update(5, &astray(&good)).unwrap();
        assert!(refused.refused & 0b111 == 0b111, "{refused:?}");
        assert!(matches!(ekf.update(8, &GnssFix { t_ns: t_ns + 1, ..good }), Err(Error::Future { .. })));
        assert!(ekf.predict(t_ns, &leg.delta.dtheta, &leg.delta.dvel).is_err());
        let seen = (ekf.solution(), ekf.solution_sd(), ekf.params(), ekf.ned_covariance(), ekf.lever_b_m());
        assert!(seen.1.position_m.x > 0.0);
        ekf.save(&mut Writer::new(buffer)).unwrap();
        ekf.restore(&mut Reader::new(buffer)).unwrap();
    }
    ekf.raise_covariance(2.0);
}

/// A stream with everything that can be wrong with one; returns what was told.
fn stream_calls<M: NavModel>(nav: &mut Navigator<M, CAP>, input: ImuInput, legs: &[Leg]) -> Tally {
    let mut told = Tally::default();
    for (k, leg) in legs.iter().enumerate() {
        let (t_ns, truth) = (leg.t_ns, &leg.truth);
        let scale = if input == ImuInput::Increments { 1.0 } else { 1.0 / leg.delta.dt_s };
        let (w, f) = (leg.delta.dtheta * scale, leg.delta.dvel * scale);
        // five rows are missing, then seventy
        if !(300..305).contains(&k) && !(400..470).contains(&k) {
            nav.imu(t_ns, &w, &f, &mut told).unwrap();
        }
        match k {
            100 => nav.imu(t_ns, &w, &f, &mut told).unwrap(),
            110 => nav.imu(t_ns + 1, &(w * f64::NAN), &f, &mut told).unwrap(),
            120 => nav.imu(t_ns - 1, &w, &f, &mut told).unwrap(),
            _ => {}
        }
        // valid between this row and the next, or at this one
        if k % 20 == 19 {
            let good = fix(t_ns + 3_000_000 + GNSS_LATENCY_NS, truth, 1.0, 0.1);
            let z = if (500..760).contains(&k) { astray(&good) } else { good };
            nav.gnss(&z, &mut told).unwrap();
            nav.baro(&height(t_ns, truth), &mut told).unwrap();
            nav.heading(&heading(t_ns + HEADING_LATENCY_NS, truth), &mut told).unwrap();
        }
        if k == 200 {
            nav.gnss(&fix(t_ns - 1_000_000_000, truth, 1.0, 0.1), &mut told).unwrap();
            let mut bad = fix(t_ns + GNSS_LATENCY_NS, truth, 1.0, 0.1);
            bad.covariance[2][2] = -1.0;
            nav.gnss(&bad, &mut told).unwrap();
        }
        if k % 100 == 0 {
            assert!(nav.ekf().solution_sd().position_m.x > 0.0);
        }
    }
    nav.finish(&mut told);
    told
}

fn every_filter<M: NavModel>(preset: &Preset, isa: Isa) {
    let (start, legs) = fly::<M>(weaving, PLACE, 300, DT_NS);
    let gated = Settings { gate_probability: [Some(0.999); 3], ..settings() };
    let judged = Integrity { gate: Gate::Parts, trace_ratio_limit: Some(10.0), max_accel_m_s2: Some(30.0) };
    let floor = gnssins::ekf::Floor { v: nalgebra::Vector3::repeat(1e-3), ..settings().floor };
    for set in [
        gated,
        Settings { integrity: judged, floor, ..gated },
        Settings { feedback_ns: 700_000_000, ..gated },
    ] {
        let mut ekf = filter::<M>(preset, isa, start, set);
        let mut buffer = vec![0; ekf.saved_len()];
        let count = allocations(|| filter_calls(&mut ekf, &legs, &mut buffer));
        assert_eq!(count, 0, "filter {} on {isa:?}", preset.name);
    }
}

fn every_stream<M: NavModel>(preset: &Preset, isa: Isa) {
    let (start, legs) = fly::<M>(weaving, PLACE, 900, DT_NS);
    let gated = Settings { gate_probability: [Some(0.999); 3], ..settings() };
    for input in [ImuInput::Rates, ImuInput::MeanRates, ImuInput::Increments] {
        let set = StreamSettings {
            input,
            gyro_range: Some(0.05),
            max_gap_ns: 500_000_000,
            on_gap: OnGap::Bridge,
            on_backwards: OnBackwards::Drop,
            latency_ns: [GNSS_LATENCY_NS, 0, HEADING_LATENCY_NS],
            ..StreamSettings::default()
        };
        let mut nav = Navigator::new(filter::<M>(preset, isa, start, gated), set);
        let mut told = Tally::default();
        let count = allocations(|| told = stream_calls(&mut nav, input, &legs));
        let what = format!("stream {} on {isa:?}, {input:?}", preset.name);
        assert_eq!(count, 0, "{what}");
        let Tally { records, gaps, long_gaps, dropped, saturated, refused, late, bad, resets } = told;
        let all = [gaps, long_gaps, saturated, refused, late, bad, resets];
        assert!(all.iter().all(|n| *n > 0), "{what}: nothing is proved of what did not happen: {all:?}");
        assert_eq!((dropped, records), (3, 137), "{what}");
        assert!(nav.counts(Source::Gnss).used > 20, "{what}");
    }
}

fn everywhere(run: impl Fn(&Preset, Isa)) {
    for preset in PRESETS {
        for isa in [Isa::Portable, Isa::Avx2, Isa::Avx512].into_iter().filter(|i| i.available() == *i) {
            run(preset, isa);
        }
    }
}

#[test]
fn the_counter_counts() {
    assert_eq!(allocations(|| drop(vec![1_u8])), 1);
    let mut list = Vec::with_capacity(1);
    assert!(allocations(|| (0..100).for_each(|k| list.push(k))) > 0, "growth counts too");
}

#[test]
fn no_call_of_the_filter_allocates_whatever_becomes_of_a_measurement() {
    everywhere(|preset, isa| match preset.model {
        Model::Ned => every_filter::<Ned>(preset, isa),
        Model::Ecef => every_filter::<Ecef>(preset, isa),
    });
}

#[test]
fn no_row_of_a_stream_allocates_whatever_is_wrong_with_it() {
    everywhere(|preset, isa| match preset.model {
        Model::Ned => every_stream::<Ned>(preset, isa),
        Model::Ecef => every_stream::<Ecef>(preset, isa),
    });
}
