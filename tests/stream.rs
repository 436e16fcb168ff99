//! Rows in time order to a filter: merging, splitting at fixes, latency, gaps, re-acquisition.

mod common;

use common::{DT_NS, Leg, Log, dense, error, fix, fly, initial, settings};
use gnssins::ekf::{Ekf, Settings};
use gnssins::error::Error;
use gnssins::imu::{Calibration, ImuInput, Rates};
use gnssins::meas::gnss::GnssFix;
use gnssins::meas::{Source, Status};
use gnssins::nav::Solution;
use gnssins::nav::ned::Ned;
use gnssins::stream::{Event, EventKind, Navigator, OnGap, StreamSettings};
use nalgebra::{Matrix3, Vector3};

type Nav = Navigator<Ned, 16>;
type Row = (i64, Vector3<f64>, Vector3<f64>);

const PLACE: [f64; 3] = [47.0, 8.0, 500.0];

fn with_input(input: ImuInput) -> StreamSettings {
    StreamSettings { input, ..StreamSettings::default() }
}

fn filter(start: &Solution) -> Ekf<Ned, 16> {
    Ekf::new(&settings(), &common::blocks(15), &initial(*start)).unwrap()
}

fn flight(legs: usize) -> (Solution, Vec<Leg>) {
    fly::<Ned>(common::weaving, PLACE, legs, DT_NS)
}

fn increments(legs: &[Leg]) -> Vec<Row> {
    legs.iter().map(|l| (l.t_ns, l.delta.dtheta, l.delta.dvel)).collect()
}

fn mean_rates(legs: &[Leg]) -> Vec<Row> {
    legs.iter().map(|l| (l.t_ns, l.delta.dtheta / l.delta.dt_s, l.delta.dvel / l.delta.dt_s)).collect()
}

/// Feeds the fixes first, then the rows.
fn feed(nav: &mut Nav, rows: &[Row], fixes: &[GnssFix]) -> (Log, Result<(), Error>) {
    let mut log = Log::default();
    for z in fixes {
        nav.gnss(z, &mut log).unwrap();
    }
    let result = rows.iter().try_for_each(|(t, g, a)| nav.imu(*t, g, a, &mut log));
    (log, result)
}

fn fed(set: StreamSettings, start: &Solution, rows: &[Row], fixes: &[GnssFix]) -> (Nav, Log) {
    let mut nav = Nav::new(filter(start), set);
    let (log, result) = feed(&mut nav, rows, fixes);
    result.unwrap();
    (nav, log)
}

fn kinds(events: &[Event]) -> Vec<EventKind> {
    events.iter().map(|e| e.kind).collect()
}

fn assert_same(a: &Ekf<Ned, 16>, b: &Ekf<Ned, 16>, tolerance: f64) {
    let [phi, dv, dp] = error(&a.solution(), &b.solution());
    let off = phi.amax().max(dv.amax() / 30.0).max(dp.amax() / 1e4);
    assert!(off <= tolerance, "{phi} {dv} {dp}");
    let (p, q) = (dense(a.covariance()), dense(b.covariance()));
    let off = common::distance(&p, &q, &p.diagonal());
    assert!(off <= 100.0 * tolerance, "covariance off by {off:e}");
}

#[test]
fn a_fix_between_samples_splits_the_interval_there() {
    let (start, legs) = flight(5);
    let t_fix = 2 * DT_NS + DT_NS / 4;
    let z = fix(t_fix, &legs[1].truth, 0.5, 0.05);

    // increments are shared out evenly in time
    let (nav, log) = fed(with_input(ImuInput::Increments), &start, &increments(&legs), &[z]);
    let mut by_hand = filter(&start);
    for leg in &legs {
        let d = &leg.delta;
        if leg.t_ns == 3 * DT_NS {
            by_hand.predict(t_fix, &(d.dtheta * 0.25), &(d.dvel * 0.25)).unwrap();
            assert_eq!(by_hand.update(0, &z).unwrap().status, Status::Used);
            by_hand.predict(leg.t_ns, &(d.dtheta * 0.75), &(d.dvel * 0.75)).unwrap();
        } else {
            by_hand.predict(leg.t_ns, &d.dtheta, &d.dvel).unwrap();
        }
    }
    assert_same(nav.ekf(), &by_hand, 1e-13);
    assert_eq!((log.events.len(), log.records.len()), (0, 1));
    assert_eq!((log.records[0].t_ns, log.records[0].status), (t_fix, Status::Used));

    // sampled rates are interpolated linearly
    let rows = mean_rates(&legs);
    let (nav, _) = fed(with_input(ImuInput::Rates), &start, &rows, &[z]);
    let rates = |k: usize| Rates { gyro: rows[k].1, accel: rows[k].2 };
    let mut by_hand = filter(&start);
    by_hand.predict_rates(DT_NS, &rates(0), &rates(0)).unwrap();
    by_hand.predict_rates(2 * DT_NS, &rates(0), &rates(1)).unwrap();
    let middle = rates(1).towards(&rates(2), 0.25);
    by_hand.predict_rates(t_fix, &rates(1), &middle).unwrap();
    by_hand.update(0, &z).unwrap();
    by_hand.predict_rates(3 * DT_NS, &middle, &rates(2)).unwrap();
    by_hand.predict_rates(4 * DT_NS, &rates(2), &rates(3)).unwrap();
    by_hand.predict_rates(5 * DT_NS, &rates(3), &rates(4)).unwrap();
    assert_same(nav.ekf(), &by_hand, 1e-13);
}

/// How far a split without a fused fix moves the solution.
fn split_error(input: ImuInput, dt_ns: i64) -> f64 {
    let (start, legs) = fly::<Ned>(common::weaving, PLACE, 5, dt_ns);
    let rows = if input == ImuInput::Increments { increments(&legs) } else { mean_rates(&legs) };
    let empty =
        GnssFix { position: None, velocity_n: [None; 3], ..fix(2 * dt_ns + dt_ns / 3, &start, 1.0, 1.0) };
    let (whole, _) = fed(with_input(input), &start, &rows, &[]);
    let (split, log) = fed(with_input(input), &start, &rows, &[empty]);
    assert_eq!(kinds(&log.events), [EventKind::AidBad(Source::Gnss)]);
    let [phi, dv, dp] = error(&split.ekf().solution(), &whole.ekf().solution());
    phi.norm() + dv.norm() + dp.norm()
}

#[test]
fn a_split_without_a_fix_changes_nothing_beyond_third_order() {
    for input in [ImuInput::Increments, ImuInput::MeanRates, ImuInput::Rates] {
        let (coarse, fine) = (split_error(input, 80_000_000), split_error(input, 40_000_000));
        assert!(fine < 3e-5, "{input:?}: {fine:e}");
        assert!(coarse > 7.0 * fine, "{input:?}: {coarse:e} {fine:e}");
    }
}

#[test]
fn increments_and_mean_rates_of_the_same_motion_give_the_same_result() {
    let (start, legs) = flight(300);
    let fixes = [1.0, 1.5, 2.004]
        .map(|t: f64| fix((t * 1e9) as i64, &legs[(t * 100.0) as usize - 1].truth, 1.0, 0.1));
    let (a, _) = fed(with_input(ImuInput::Increments), &start, &increments(&legs), &fixes);
    let (b, _) = fed(with_input(ImuInput::MeanRates), &start, &mean_rates(&legs), &fixes);
    assert_same(a.ekf(), b.ekf(), 1e-12);
    let [phi, dv, dp] = error(&a.ekf().solution(), &legs[299].truth);
    assert!(dp.amax() < 1.0 && dv.amax() < 0.1 && phi.amax() < 0.01, "{phi} {dv} {dp}");
}

#[test]
fn a_fix_at_the_time_of_a_sample_may_come_before_or_after_it() {
    let (start, legs) = flight(40);
    let rows = increments(&legs);
    let z: Vec<GnssFix> = [9, 19, 29].map(|k: usize| fix(legs[k].t_ns, &legs[k].truth, 1.0, 0.1)).into();
    let (before, log) = fed(with_input(ImuInput::Increments), &start, &rows, &z);
    let mut after = Nav::new(filter(&start), with_input(ImuInput::Increments));
    let mut later = Log::default();
    for (k, (t, g, a)) in rows.iter().enumerate() {
        after.imu(*t, g, a, &mut later).unwrap();
        if k % 10 == 9 && k < 30 {
            after.gnss(&z[k / 10], &mut later).unwrap();
        }
    }
    assert_eq!(common::bytes(before.ekf()), common::bytes(after.ekf()));
    assert_eq!(log.records, later.records);
    assert_eq!((before.gnss_counts().used, after.gnss_counts().used), (3, 3));
}

#[test]
fn fixes_of_one_interval_are_taken_in_the_order_of_their_times() {
    let (start, legs) = flight(3);
    let z = [7, 3, 5, 5].map(|ms: i64| fix(DT_NS + ms * 1_000_000, &legs[0].truth, 1.0, 0.1));
    let (_, log) = fed(with_input(ImuInput::MeanRates), &start, &mean_rates(&legs), &z);
    let order: Vec<(u64, i64)> = log.records.iter().map(|r| (r.row, r.t_ns / 1_000_000)).collect();
    assert_eq!(order, [(1, 13), (2, 15), (3, 15), (0, 17)]);
}

#[test]
fn latency_is_taken_off_the_stamp() {
    let (start, legs) = flight(30);
    let z = fix(legs[9].t_ns, &legs[9].truth, 1.0, 0.1);
    let delayed = GnssFix { t_ns: z.t_ns + 43_000_000, ..z };
    let set = StreamSettings { latency_ns: [43_000_000; 3], ..with_input(ImuInput::Increments) };
    let (a, log_a) = fed(with_input(ImuInput::Increments), &start, &increments(&legs), &[z]);
    let (b, log_b) = fed(set, &start, &increments(&legs), &[delayed]);
    assert_eq!(common::bytes(a.ekf()), common::bytes(b.ekf()));
    assert_eq!(log_a.records, log_b.records);
    assert_eq!(b.valid_ns(Source::Gnss, delayed.t_ns), z.t_ns);
}

#[test]
fn a_gap_is_bridged_with_an_event_and_raised_noise() {
    let (start, legs) = flight(100);
    for (input, rows) in [
        (ImuInput::Increments, increments(&legs)),
        (ImuInput::MeanRates, mean_rates(&legs)),
        (ImuInput::Rates, mean_rates(&legs)),
    ] {
        let missing: Vec<Row> =
            rows.iter().enumerate().filter(|(k, _)| !(50..60).contains(k)).map(|(_, r)| *r).collect();
        let (whole, log) = fed(with_input(input), &start, &rows, &[]);
        assert_eq!(log.events, []);
        let (bridged, log) = fed(with_input(input), &start, &missing, &[]);
        assert_eq!(kinds(&log.events), [EventKind::ImuGap], "{input:?}");
        assert!((log.events[0].value - 0.11).abs() < 1e-12 && log.events[0].row == 50);
        let [phi, dv, dp] = error(&bridged.ekf().solution(), &whole.ekf().solution());
        // the rates at both ends tell what was in between to second order: 0.1 s at jerks of 1 m/s³
        assert!(phi.amax() < 1e-3 && dv.amax() < 0.02 && dp.amax() < 0.02, "{input:?}: {phi} {dv} {dp}");
        for i in 0..9 {
            let sd = |n: &Nav| n.ekf().covariance().get(i, i).sqrt();
            assert!(sd(&bridged) > sd(&whole), "{input:?} state {i}");
        }
        // and the error is within the sigma that the gap adds
        for i in 0..3 {
            let added =
                |j: usize| (bridged.ekf().covariance().get(j, j) - whole.ekf().covariance().get(j, j)).sqrt();
            assert!(phi[i].abs() < 4.0 * added(i) + 1e-5, "{input:?} phi {i}: {} {}", phi[i], added(i));
            assert!(dv[i].abs() < 4.0 * added(3 + i) + 1e-3, "{input:?} dv {i}: {} {}", dv[i], added(3 + i));
        }
        assert_eq!(bridged.imu_counts().used, 90);
    }
}

#[test]
fn a_hole_is_crossed_with_the_mean_of_its_neighbours_in_usual_steps_and_no_coning_over_its_ends() {
    let (start, legs) = flight(30);
    let rows: Vec<Row> = mean_rates(&legs)
        .into_iter()
        .enumerate()
        .filter(|(k, _)| !(15..19).contains(k))
        .map(|(_, r)| (r.0, r.1 + Vector3::new(0.2, -0.1, 0.3) * (r.0 / DT_NS % 7) as f64, r.2))
        .collect();
    let (nav, _) = fed(with_input(ImuInput::MeanRates), &start, &rows, &[]);
    let mut by_hand = filter(&start);
    let mut last = (0, Vector3::zeros(), Vector3::zeros());
    for (t, g, a) in rows {
        if t - last.0 > DT_NS {
            let (g, a) = ((g + last.1) * 0.5, (a + last.2) * 0.5);
            by_hand.break_increments();
            for t in (last.0 + DT_NS..t).step_by(DT_NS as usize) {
                by_hand.predict(t, &(g * 0.01), &(a * 0.01)).unwrap();
            }
            by_hand.break_increments();
        }
        by_hand.predict(t, &(g * 0.01), &(a * 0.01)).unwrap();
        last = (t, g, a);
    }
    let [phi, dv, dp] = error(&nav.ekf().solution(), &by_hand.solution());
    assert!(phi.amax() < 1e-13 && dv.amax() < 1e-12 && dp.amax() < 1e-8, "{phi} {dv} {dp}");
}

#[test]
fn a_gap_beyond_the_limit_stops_or_is_bridged_as_configured() {
    let (start, legs) = flight(100);
    let rows: Vec<Row> = mean_rates(&legs)
        .into_iter()
        .enumerate()
        .filter(|(k, _)| !(50..60).contains(k))
        .map(|(_, r)| r)
        .collect();
    let set = |on_gap| StreamSettings { on_gap, max_gap_ns: 100_000_000, ..with_input(ImuInput::MeanRates) };
    let mut nav = Nav::new(filter(&start), set(OnGap::Stop));
    let (_, result) = feed(&mut nav, &rows, &[]);
    let want = Error::Gap { row: 50, from_ns: 500_000_000, to_ns: 610_000_000, limit_ns: 100_000_000 };
    assert_eq!(result, Err(want));
    assert_eq!((want.code(), nav.ekf().t_ns()), ("gap.imu", 500_000_000));

    let (nav, log) = fed(set(OnGap::Bridge), &start, &rows, &[]);
    assert_eq!(kinds(&log.events), [EventKind::ImuGapLong]);
    assert_eq!(nav.ekf().t_ns(), 1_000_000_000);
}

/// No events, and at the end within the error of the missing first instants of the truth.
fn assert_undisturbed(input: ImuInput, start: &Solution, rows: &[Row], truth: &Solution, what: &str) {
    let (nav, log) = fed(with_input(input), start, rows, &[]);
    assert_eq!(log.events, [], "{what} {input:?}");
    let [phi, dv, dp] = error(&nav.ekf().solution(), truth);
    assert!(phi.amax() < 1e-3 && dv.amax() < 0.06 && dp.amax() < 0.3, "{what} {input:?}: {phi} {dv} {dp}");
}

#[test]
fn a_start_between_rows_is_not_a_gap_for_ever() {
    // rows begin 4 ms after the filter, and come every 10 ms
    let (start, legs) = fly::<Ned>(common::weaving, PLACE, 1000, 2_000_000);
    let rows: Vec<Row> = (0..199)
        .map(|k| {
            let own = &legs[(5 * k + 2usize).saturating_sub(5)..5 * k + 2];
            let dt = own.len() as f64 * 0.002;
            let sum = |f: fn(&Leg) -> Vector3<f64>| own.iter().map(f).sum::<Vector3<f64>>() / dt;
            (legs[5 * k + 1].t_ns, sum(|l| l.delta.dtheta), sum(|l| l.delta.dvel))
        })
        .collect();
    let truth = legs[5 * 198 + 1].truth;
    assert_undisturbed(ImuInput::MeanRates, &start, &rows, &truth, "late first row");
    assert_undisturbed(ImuInput::Rates, &start, &rows, &truth, "late first row");
    let mut whole = rows.clone();
    for (k, r) in whole.iter_mut().enumerate() {
        let dt = if k == 0 { 0.004 } else { 0.01 };
        (r.1, r.2) = (r.1 * dt, r.2 * dt);
    }
    assert_undisturbed(ImuInput::Increments, &start, &whole, &truth, "late first row");
}

#[test]
fn one_short_interval_does_not_make_gaps_of_all_others() {
    let (start, legs) = flight(400);
    // the stamp of one row comes 8 ms early, its successor makes up for it
    let mut rows = mean_rates(&legs);
    rows[100].0 -= 8_000_000;
    let (nav, log) = fed(with_input(ImuInput::Rates), &start, &rows, &[]);
    assert!(log.events.len() <= 1, "{:?}", log.events);
    let [phi, dv, dp] = error(&nav.ekf().solution(), &legs[399].truth);
    assert!(phi.amax() < 2e-3 && dv.amax() < 0.1 && dp.amax() < 0.5, "{phi} {dv} {dp}");
    // a true change of rate is learned
    let (start, slow) = fly::<Ned>(common::weaving, PLACE, 200, 3 * DT_NS);
    let fast = fly::<Ned>(common::weaving, PLACE, 100, DT_NS).1;
    let mut rows = mean_rates(&fast);
    rows.extend(mean_rates(&slow).into_iter().skip(34));
    let (_, log) = fed(with_input(ImuInput::MeanRates), &start, &rows, &[]);
    assert!(log.events.len() <= 9, "{} events", log.events.len());
}

#[test]
fn a_long_gap_before_the_first_increment_is_not_free_fall() {
    let (start, legs) = fly::<Ned>(common::resting, PLACE, 600, DT_NS);
    for (input, rows) in [(ImuInput::Increments, increments(&legs)), (ImuInput::MeanRates, mean_rates(&legs))]
    {
        let set = StreamSettings { on_gap: OnGap::Bridge, ..with_input(input) };
        let mut nav = Nav::new(filter(&start), set);
        let (_, result) = feed(&mut nav, &rows[300..], &[]);
        if let Err(error) = result {
            assert_eq!(error.code(), "gap.imu");
            continue;
        }
        let fallen = nav.ekf().solution().v_n.z;
        assert!(fallen.abs() < 0.1, "{input:?}: {fallen} m/s down");
    }
}

#[test]
fn calibration_is_applied_before_everything() {
    let (start, legs) = flight(100);
    let m = Matrix3::new(0.01, 0.002, -0.003, 0.001, -0.02, 0.004, 0.0, 0.005, 0.03);
    let (gyro_bias, accel_bias) = (Vector3::new(0.01, -0.02, 0.03), Vector3::new(0.3, 0.2, -0.1));
    let wrong = |v: &Vector3<f64>, b: &Vector3<f64>, dt: f64| (Matrix3::identity() + m) * v + b * dt;
    for (input, rows, dt) in [
        (ImuInput::Increments, increments(&legs), 0.01),
        (ImuInput::MeanRates, mean_rates(&legs), 1.0),
        (ImuInput::Rates, mean_rates(&legs), 1.0),
    ] {
        let measured: Vec<Row> =
            rows.iter().map(|(t, g, a)| (*t, wrong(g, &gyro_bias, dt), wrong(a, &accel_bias, dt))).collect();
        let set = StreamSettings {
            gyro: Calibration::new(gyro_bias, m).unwrap(),
            accel: Calibration::new(accel_bias, m).unwrap(),
            ..with_input(input)
        };
        let (clean, _) = fed(with_input(input), &start, &rows, &[]);
        let (calibrated, _) = fed(set, &start, &measured, &[]);
        assert_same(clean.ekf(), calibrated.ekf(), 1e-12);
    }
}

#[test]
fn too_many_refused_fixes_raise_the_covariance_once_and_the_filter_finds_back() {
    let (start, legs) = flight(3000);
    let mut off = start;
    off.position.lat_rad += 300.0 / 6.4e6;
    let gated = Settings { gate_probability: [Some(0.999); 3], ..settings() };
    let run = |reacquire_after| {
        let ekf = Ekf::new(&gated, &common::blocks(15), &initial(off)).unwrap();
        let mut nav = Nav::new(ekf, StreamSettings { reacquire_after, ..with_input(ImuInput::Increments) });
        let mut log = Log::default();
        for (k, (t, g, a)) in increments(&legs).iter().enumerate() {
            nav.imu(*t, g, a, &mut log).unwrap();
            if k % 100 == 99 {
                nav.gnss(&fix(*t, &legs[k].truth, 1.0, 0.1), &mut log).unwrap();
            }
        }
        let resets = log.events.iter().filter(|e| e.kind == EventKind::FilterReset).count();
        (error(&nav.ekf().solution(), &legs[2999].truth)[2].x, nav.gnss_counts(), resets)
    };
    let (dp, counts, resets) = run(Some(5));
    assert!(dp.abs() < 2.0, "{dp}");
    assert_eq!((counts.rejected, counts.used, resets), (4, 26, 1), "the fifth refused fix is tried again");
    let (dp, counts, resets) = run(None);
    assert!(dp > 200.0 && counts.used == 0 && resets == 0, "{dp} {counts:?}");
}

#[test]
fn increments_with_stamps_that_come_early_and_late_in_turn_are_not_holes() {
    let (start, legs) = fly::<Ned>(common::resting, PLACE, 600, DT_NS);
    for early_ns in [1_000_000, 5_000_000, 8_000_000, 9_000_000] {
        let mut rows = increments(&legs);
        rows.iter_mut().skip(1).step_by(2).for_each(|row| row.0 -= early_ns);
        let mut nav = Nav::new(filter(&start), with_input(ImuInput::Increments));
        let (_, result) = feed(&mut nav, &rows, &[]);
        assert_eq!(result, Ok(()));
        let v = nav.ekf().solution().v_n;
        // one row's worth of gravity may be out of step at the end, no more
        assert!(v.norm() < 0.11, "{early_ns} ns early: {v}");
    }
}
