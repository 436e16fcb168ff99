//! Bad rows: dropped, counted and told; nothing lost, nothing broken, whatever comes.

mod common;

use common::{DT_NS, Log, Rng, fix, fly, initial, settings, solution};
use gnssins::bytes::{Reader, Writer};
use gnssins::ekf::{Ekf, Settings};
use gnssins::error::Error;
use gnssins::imu::{Calibration, ImuInput};
use gnssins::meas::gnss::GnssFix;
use gnssins::meas::{BadReason, Source, Status};
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::Ned;
use gnssins::nav::{NavModel, Solution};
use gnssins::stream::{Counts, EventKind, Navigator, OnBackwards, OnGap, PENDING_MAX, StreamSettings};
use nalgebra::{Matrix3, Vector3};

const WEIGHT: Vector3<f64> = Vector3::new(0.0, 0.0, -9.8);
const STILL: Vector3<f64> = Vector3::new(0.0, 0.0, 0.0);

fn start() -> Solution {
    solution([47.0, 8.0, 500.0], [10.0, 0.0, 0.0], [0.0, 0.0, 0.0])
}

fn navigator<M: NavModel>(set: StreamSettings) -> Navigator<M, 16> {
    let gated = Settings { gate_probability: [Some(0.999); 3], ..settings() };
    Navigator::new(Ekf::new(&gated, &common::blocks(15), &initial(start())).unwrap(), set)
}

fn mean_rates() -> StreamSettings {
    StreamSettings { input: ImuInput::MeanRates, ..StreamSettings::default() }
}

fn assert_balanced(c: Counts, fed: u64, what: &str) {
    assert_eq!((c.total, c.used + c.rejected + c.late + c.bad), (fed, fed), "{what}: {c:?}");
}

fn saved<M: NavModel>(nav: &Navigator<M, 16>) -> Vec<u8> {
    let mut buffer = vec![0; nav.saved_len()];
    let mut out = Writer::new(&mut buffer);
    nav.save(&mut out).unwrap();
    let len = out.len();
    buffer.truncate(len);
    buffer
}

#[test]
fn bad_imu_rows_are_dropped_counted_and_told() {
    let mut nav = navigator::<Ned>(StreamSettings { on_backwards: OnBackwards::Drop, ..mean_rates() });
    let mut log = Log::default();
    let mut clean = navigator::<Ned>(mean_rates());
    for k in 1..=20 {
        let row = |nav: &mut Navigator<Ned, 16>, t: i64, g: Vector3<f64>, log: &mut Log| {
            nav.imu(t, &g, &WEIGHT, log).unwrap()
        };
        row(&mut nav, k * DT_NS, STILL, &mut log);
        row(&mut clean, k * DT_NS, STILL, &mut Log::default());
        match k {
            5 => row(&mut nav, 5 * DT_NS, STILL, &mut log),
            7 => row(&mut nav, 7 * DT_NS, Vector3::x(), &mut log),
            9 => row(&mut nav, 8 * DT_NS, STILL, &mut log),
            11 => row(&mut nav, 11 * DT_NS + 5_000_000, Vector3::repeat(f64::NAN), &mut log),
            13 => nav.imu(14 * DT_NS, &STILL, &Vector3::new(0.0, f64::INFINITY, 0.0), &mut log).unwrap(),
            _ => {}
        }
    }
    use EventKind::*;
    let kinds: Vec<_> = log.events.iter().map(|e| (e.kind, e.row)).collect();
    let want =
        [(ImuDuplicate, 5), (ImuConflict, 8), (ImuBackwards, 11), (ImuNotFinite, 14), (ImuNotFinite, 17)];
    assert_eq!(kinds, want);
    assert!((log.events[2].value + 0.01).abs() < 1e-12, "seconds back");
    assert_eq!(nav.imu_counts(), Counts { total: 25, used: 20, rejected: 0, late: 0, bad: 5 });
    assert_eq!(common::bytes(nav.ekf()), common::bytes(clean.ekf()), "dropped rows leave no trace");
}

#[test]
fn time_that_goes_back_stops_by_default_and_names_the_row() {
    let mut nav = navigator::<Ned>(mean_rates());
    for k in 1..=3 {
        nav.imu(k * DT_NS, &STILL, &WEIGHT, &mut ()).unwrap();
    }
    let before = saved(&nav);
    let error = nav.imu(2 * DT_NS, &STILL, &WEIGHT, &mut ()).expect_err("stops");
    assert_eq!(error, Error::TimeBackwards { row: 3, t_ns: 2 * DT_NS, previous_ns: 3 * DT_NS });
    assert_eq!(saved(&nav), before);
}

#[test]
fn rows_before_the_start_are_late_and_the_row_at_the_start_is_the_first_sample() {
    let mut nav = navigator::<Ned>(StreamSettings::default());
    for k in -3..=3 {
        nav.imu(k * DT_NS, &Vector3::new(0.0, 0.0, 0.1 * k as f64), &WEIGHT, &mut ()).unwrap();
    }
    assert_eq!(nav.imu_counts(), Counts { total: 7, used: 4, rejected: 0, late: 3, bad: 0 });
    // trapezoid of 0, 0.1, 0.2, 0.3 rad/s: the sample at the start has a share
    let (_, _, heading) = gnssins::attitude::to_euler(&nav.ekf().solution().q_nb);
    assert!((heading - 0.0045).abs() < 2e-5, "{heading}");
    // a fix valid before the start is late, whatever else is wrong with it
    let mut log = Log::default();
    nav.gnss(&fix(-1, &start(), 1.0, 0.1), &mut log).unwrap();
    nav.gnss(&fix(DT_NS, &start(), 1.0, 0.1), &mut log).unwrap();
    assert_eq!((nav.gnss_counts().late, log.events.len()), (2, 2));
    assert!(log.events.iter().all(|e| e.kind == EventKind::AidLate(Source::Gnss) && e.value < 0.0));
    assert!(log.records.iter().all(|r| r.status == Status::Late));
}

#[test]
fn bad_fixes_are_counted_with_their_reason() {
    let mut nav = navigator::<Ned>(mean_rates());
    let good = fix(DT_NS / 2, &start(), 1.0, 0.1);
    let with = |change: &dyn Fn(&mut GnssFix)| {
        let mut z = good;
        change(&mut z);
        z
    };
    let cases = [
        (with(&|z| (z.position, z.velocity_n) = (None, [None; 3])), BadReason::Empty),
        (with(&|z| z.position.as_mut().unwrap().lat_rad = 1.7), BadReason::Value),
        (with(&|z| z.velocity_n[0] = Some(f64::INFINITY)), BadReason::Value),
        (with(&|z| z.position = Some(Default::default())), BadReason::NoFix),
        (with(&|z| z.covariance = [[0.0; 6]; 6]), BadReason::Covariance),
        (with(&|z| z.covariance[1][1] = -1.0), BadReason::Covariance),
        (with(&|z| z.covariance[2][0] = 0.5), BadReason::Covariance),
        (with(&|z| z.covariance[4][4] = f64::NAN), BadReason::Covariance),
    ];
    let mut log = Log::default();
    for (z, _) in &cases {
        nav.gnss(z, &mut log).unwrap();
    }
    nav.imu(DT_NS, &STILL, &WEIGHT, &mut log).unwrap();
    let reasons: Vec<_> = log.records.iter().map(|r| r.status).collect();
    assert_eq!(reasons, cases.map(|(_, reason)| Status::Bad(reason)));
    assert!(
        log.events.iter().all(|e| e.kind == EventKind::AidBad(Source::Gnss))
            && log.events.len() == cases.len()
    );
    assert_eq!(nav.gnss_counts(), Counts { total: 8, used: 0, rejected: 0, late: 0, bad: 8 });
}

#[test]
fn a_full_queue_is_an_error_and_loses_nothing() {
    let mut nav = navigator::<Ned>(mean_rates());
    let mut log = Log::default();
    let z = |k: usize| fix(1_000_000 + k as i64, &start(), 5.0, 1.0);
    for k in 0..PENDING_MAX {
        nav.gnss(&z(k), &mut log).unwrap();
    }
    let before = saved(&nav);
    let error = nav.gnss(&z(99), &mut log).expect_err("full");
    assert_eq!(
        (error, error.code()),
        (Error::QueueFull { pending: PENDING_MAX, t_ns: 0 }, "time.queue_full")
    );
    assert_eq!(saved(&nav), before);
    nav.imu(DT_NS, &STILL, &WEIGHT, &mut log).unwrap();
    nav.gnss(&z(99), &mut log).unwrap();
    assert_eq!(log.records.len(), PENDING_MAX + 1);
    assert_balanced(nav.gnss_counts(), PENDING_MAX as u64 + 1, "queue");
}

#[test]
fn a_longer_queue_holds_more_and_gives_the_same_filter() {
    let make = || Ekf::<Ned, 16>::new(&settings(), &common::blocks(15), &initial(start())).unwrap();
    let mut long = Navigator::<Ned, 16, 100>::with_queue(make(), mean_rates());
    let mut short = Navigator::<Ned, 16>::new(make(), mean_rates());
    let z = |k: i64| fix((k + 1) * DT_NS, &start(), 5.0, 1.0);
    for k in (0..100).rev() {
        long.gnss(&z(k), &mut ()).unwrap();
    }
    assert!(matches!(long.gnss(&z(1), &mut ()), Err(Error::QueueFull { pending: 100, .. })));
    for k in 0..100 {
        long.imu((k + 1) * DT_NS, &STILL, &WEIGHT, &mut ()).unwrap();
        short.imu((k + 1) * DT_NS, &STILL, &WEIGHT, &mut ()).unwrap();
        short.gnss(&z(k), &mut ()).unwrap();
    }
    assert_eq!(common::bytes(long.ekf()), common::bytes(short.ekf()));
    assert_eq!((long.gnss_counts(), long.gnss_counts().used), (short.gnss_counts(), 100));
}

#[test]
fn fixes_after_the_last_row_are_late_at_the_end() {
    let mut nav = navigator::<Ned>(mean_rates());
    let mut log = Log::default();
    nav.imu(DT_NS, &STILL, &WEIGHT, &mut log).unwrap();
    for ms in [30, 20] {
        nav.gnss(&fix(ms * 1_000_000, &start(), 1.0, 0.1), &mut log).unwrap();
    }
    assert_eq!(nav.gnss_counts(), Counts { total: 2, ..Counts::default() });
    nav.finish(&mut log);
    assert_eq!(nav.gnss_counts(), Counts { total: 2, late: 2, ..Counts::default() });
    let events: Vec<_> = log.events.iter().map(|e| (e.kind, e.row, (e.value * 1e3).round())).collect();
    assert_eq!(
        events,
        [(EventKind::AidAfterEnd(Source::Gnss), 1, 10.0), (EventKind::AidAfterEnd(Source::Gnss), 0, 20.0)]
    );
}

#[test]
fn saturation_is_told_once_per_stay_and_of_the_raw_value() {
    // the calibration takes 2 % off: a value clipped at the range must be seen all the same
    let gyro = Calibration::new(Vector3::zeros(), Matrix3::identity() * 0.02).unwrap();
    for (input, dt) in [(ImuInput::MeanRates, 1.0), (ImuInput::Rates, 1.0), (ImuInput::Increments, 0.01)] {
        let set = StreamSettings {
            input,
            gyro,
            gyro_range: Some(5.0),
            accel_range: Some(40.0),
            ..StreamSettings::default()
        };
        let mut nav = navigator::<Ned>(set);
        let mut log = Log::default();
        for k in 1..=20 {
            let rate = if (5..8).contains(&k) || k == 12 { -5.0 } else { 0.1 };
            let force = if k == 16 { 40.0 } else { 0.0 };
            let (g, a) = (Vector3::new(rate, 0.0, 0.0) * dt, Vector3::new(force, 0.0, -9.8) * dt);
            nav.imu(k * DT_NS, &g, &a, &mut log).unwrap();
        }
        let events: Vec<_> = log.events.iter().map(|e| (e.kind, e.row)).collect();
        let s = EventKind::ImuSaturated;
        assert_eq!(events, [(s, 4), (s, 11), (s, 15)], "{input:?}");
    }
}

#[test]
fn an_error_in_the_middle_keeps_the_counts_and_the_waiting_fixes() {
    // northwards over the limit of the NED model
    let lat = gnssins::nav::ned::LATITUDE_LIMIT_RAD.to_degrees() - 20.0 / 111_000.0;
    let s = solution([lat, 0.0, 0.0], [100.0, 0.0, 0.0], [0.0; 3]);
    let ekf = Ekf::<Ned, 16>::new(&settings(), &common::blocks(15), &initial(s)).unwrap();
    let mut nav = Navigator::new(ekf, mean_rates());
    let mut log = Log::default();
    nav.gnss(&fix(95 * DT_NS + 1, &s, 1.0, 0.1), &mut log).unwrap();
    let mut errors = 0;
    for k in 1..=100 {
        errors += u64::from(nav.imu(k * DT_NS, &STILL, &WEIGHT, &mut log).is_err());
    }
    assert!(errors > 0);
    assert_balanced(nav.imu_counts(), 100, "imu");
    nav.finish(&mut log);
    assert_balanced(nav.gnss_counts(), 1, "gnss");
}

#[test]
fn extreme_stamps_never_panic() {
    let stamps = [i64::MIN, i64::MIN + 1, -1, 0, 1, DT_NS, i64::MAX - 1, i64::MAX];
    for first in stamps {
        for second in stamps {
            for (on_gap, input) in [
                (OnGap::Stop, ImuInput::Rates),
                (OnGap::Bridge, ImuInput::Rates),
                (OnGap::Bridge, ImuInput::Increments),
            ] {
                let set = StreamSettings {
                    on_gap,
                    input,
                    on_backwards: OnBackwards::Drop,
                    latency_ns: [7; 3],
                    ..StreamSettings::default()
                };
                let mut nav = navigator::<Ecef>(set);
                for t in [first, second, DT_NS] {
                    let _ = nav.gnss(&fix(t, &start(), 1.0, 0.1), &mut ());
                    let _ = nav.imu(t, &STILL, &WEIGHT, &mut ());
                }
                nav.finish(&mut ());
                assert_balanced(nav.gnss_counts(), 3, &format!("{first} {second}"));
                assert_balanced(nav.imu_counts(), 3, &format!("{first} {second}"));
            }
        }
    }
}

/// One log with rows dropped, doubled, swapped, spoilt and late; a filter must survive it with its books in order.
fn fuzz<M: NavModel>(seed: u64) -> Counts {
    let mut rng = Rng(seed);
    let inputs = [ImuInput::Rates, ImuInput::MeanRates, ImuInput::Increments];
    let input = inputs[rng.below(3)];
    let set = StreamSettings {
        input,
        on_gap: OnGap::Bridge,
        on_backwards: OnBackwards::Drop,
        max_gap_ns: 200_000_000,
        latency_ns: [20_000_000 * rng.below(3) as i64; 3],
        gyro_range: Some(1.0),
        ..StreamSettings::default()
    };
    let (s, legs) = fly::<M>(common::weaving, [47.0, 179.999, 500.0], 600, DT_NS);
    let ekf = Ekf::<M, 16>::new(
        &Settings { gate_probability: [Some(0.99); 3], ..settings() },
        &common::blocks(15),
        &initial(s),
    )
    .unwrap();
    let (mut nav, mut log, mut fixes) = (Navigator::new(ekf, set), Log::default(), 0);
    let (mut k, mut rows, mut errors) = (0usize, 0, Vec::new());
    while k < legs.len() {
        let l = &legs[k];
        let scale = if input == ImuInput::Increments { 1.0 } else { 100.0 };
        let (mut t, mut g, a) = (l.t_ns, l.delta.dtheta * scale, l.delta.dvel * scale);
        match rng.below(40) {
            0 => k += rng.below(30),
            1 => k = k.saturating_sub(rng.below(3)),
            2 => g[rng.below(3)] = [f64::NAN, f64::INFINITY, 2.0 * scale / 100.0][rng.below(3)],
            3 => t += (4e6 * rng.unit()) as i64,
            _ => k += 1,
        }
        rows += 1;
        errors.extend(nav.imu(t, &g, &a, &mut log).err().map(|e| e.code()));
        if rng.below(8) == 0 {
            let mut z = fix(l.t_ns + (8e7 * rng.unit()) as i64, &l.truth, 1.0, 0.1);
            match rng.below(10) {
                0 => z.position = None,
                1 => z.velocity_n[rng.below(3)] = None,
                2 => z.velocity_n[1] = Some(f64::NAN),
                3 => z.position.as_mut().unwrap().height_m += 1000.0 * rng.unit(),
                4 => z.covariance[rng.below(6)][rng.below(6)] = rng.unit(),
                _ => {}
            }
            fixes += u64::from(nav.gnss(&z, &mut log).is_ok());
        }
        let s = nav.ekf().solution();
        assert!(
            s.position.is_valid() && s.v_n.iter().chain(s.q_nb.coords.iter()).all(|v| v.is_finite()),
            "seed {seed}"
        );
    }
    nav.finish(&mut log);
    let what = format!("seed {seed} {input:?}");
    assert_balanced(nav.imu_counts(), rows, &what);
    assert_balanced(nav.gnss_counts(), fixes, &what);
    assert_eq!(log.records.len() as u64, fixes, "{what}: one record per fix");
    nav.ekf().covariance().check(0).unwrap();
    // a hole among the first increments cannot be told from what they cover: that stops
    let stopped = errors.iter().all(|code| *code == "gap.imu") && input == ImuInput::Increments;
    assert!(errors.is_empty() || stopped, "{what}: {errors:?}");
    nav.gnss_counts()
}

#[test]
fn spoilt_logs_never_break_the_filter_or_its_books() {
    let mut sum = Counts::default();
    for seed in 0..150 {
        for c in [fuzz::<Ned>(seed), fuzz::<Ecef>(1000 + seed)] {
            sum.used += c.used;
            sum.rejected += c.rejected;
            sum.late += c.late;
            sum.bad += c.bad;
        }
    }
    // the logs hold something of everything
    assert!([sum.used, sum.rejected, sum.late, sum.bad].iter().all(|n| *n > 300), "{sum:?}");
}

#[test]
fn a_navigator_saved_with_waiting_fixes_goes_on_with_the_same_bits() {
    let (s, legs) = fly::<Ned>(common::weaving, [47.0, 8.0, 500.0], 200, DT_NS);
    for input in [ImuInput::Rates, ImuInput::MeanRates, ImuInput::Increments] {
        let set = StreamSettings { input, gyro_range: Some(0.2), ..StreamSettings::default() };
        let make = || {
            Navigator::new(Ekf::<Ned, 16>::new(&settings(), &common::blocks(15), &initial(s)).unwrap(), set)
        };
        let scale = if input == ImuInput::Increments { 1.0 } else { 100.0 };
        let go_on = |nav: &mut Navigator<Ned, 16>, from: usize, to: usize| {
            let mut log = Log::default();
            for l in legs[from..to].iter().filter(|l| l.t_ns != 90 * DT_NS) {
                if l.t_ns % (20 * DT_NS) == 0 {
                    // two fixes that wait for later rows, the second without a height velocity
                    let mut z = fix(l.t_ns + 25_000_000, &l.truth, 1.0, 0.1);
                    nav.gnss(&z, &mut log).unwrap();
                    (z.t_ns, z.velocity_n[2]) = (l.t_ns + 15_000_000, None);
                    nav.gnss(&z, &mut log).unwrap();
                }
                nav.imu(l.t_ns, &(l.delta.dtheta * scale), &(l.delta.dvel * scale), &mut log).unwrap();
            }
            log
        };
        let mut straight = make();
        go_on(&mut straight, 0, 100);
        let bytes = saved(&straight);
        let mut resumed = make();
        resumed.restore(&mut Reader::new(&bytes)).unwrap();
        assert_eq!(saved(&resumed), bytes);
        let (a, b) = (go_on(&mut straight, 100, 200), go_on(&mut resumed, 100, 200));
        assert_eq!((&a.events, &a.records), (&b.events, &b.records));
        assert!(a.records.len() >= 10 && a.records.iter().any(|r| r.dof == 5));
        assert_eq!(saved(&straight), saved(&resumed));
        // cut short: refused, and nothing changed
        let mut other = make();
        let before = saved(&other);
        for len in (0..bytes.len()).step_by(8) {
            assert!(other.restore(&mut Reader::new(&bytes[..len])).is_err());
        }
        assert_eq!(saved(&other), before);
    }
}
