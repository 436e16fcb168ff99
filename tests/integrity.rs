//! Tests of a fix, lower bounds, and feedback at intervals.

mod common;

use common::{DT_NS, Rng, bytes, dense, error, fix, fly, initial, restore, settings, solution, weaving};
use gnssins::ekf::{Ekf, Floor, Gate, Integrity, Settings};
use gnssins::meas::gnss::GnssFix;
use gnssins::meas::{Record, Status, Test};
use gnssins::nav::Solution;
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::Ned;
use nalgebra::{Matrix3, Vector3};

const PLACE: [f64; 3] = [50.0, 10.0, 400.0];

fn somewhere() -> Solution {
    solution(PLACE, [10.0, -20.0, 1.0], [5.0, -10.0, 80.0])
}

fn filter(integrity: Integrity) -> Ekf<Ned, 16> {
    let set = Settings { integrity, gate_probability: [Some(0.999); 3], ..settings() };
    Ekf::new(&set, &common::blocks(15), &initial(somewhere())).unwrap()
}

fn parts() -> Integrity {
    Integrity { gate: Gate::Parts, ..Integrity::default() }
}

/// A fix that is off by metres and metres per second.
fn off(t_ns: i64, truth: &Solution, dp: [f64; 3], dv: [f64; 3]) -> GnssFix {
    let mut z = fix(t_ns, truth, 1.0, 0.1);
    let (m, n) = (6_370_000.0, 6_390_000.0);
    if let Some(p) = &mut z.position {
        p.lat_rad += dp[0] / m;
        p.lon_rad += dp[1] / (n * p.lat_rad.cos());
        p.height_m -= dp[2];
    }
    for (v, d) in z.velocity_n.iter_mut().zip(dv) {
        *v = v.map(|v| v + d);
    }
    z
}

fn without(z: &GnssFix, position: bool) -> GnssFix {
    if position { GnssFix { position: None, ..*z } } else { GnssFix { velocity_n: [None; 3], ..*z } }
}

#[test]
fn the_part_that_fails_is_dropped_and_the_rest_is_fused_as_if_it_stood_alone() {
    for (dp, dv, refused) in [([0.0, 30.0, 0.0], [0.0; 3], 0b111), ([0.0; 3], [0.0, 0.0, 4.0], 0b111_000)] {
        let mut ekf = filter(parts());
        let mut alone = ekf.clone();
        let z = off(0, &somewhere(), dp, dv);
        let record = ekf.update(0, &z).unwrap();
        assert_eq!(
            (record.status, record.refused, record.test),
            (Status::Used, refused, Some(Test::ChiSquare))
        );
        assert_eq!((record.dof, record.present), (6, 0b111_111));
        let record = alone.update(0, &without(&z, refused == 0b111)).unwrap();
        assert_eq!((record.refused, record.dof), (0, 3));
        // the last accepted estimate apart, which knows positions only
        assert_eq!(ekf.solution(), alone.solution());
        assert_eq!(ekf.covariance(), alone.covariance());
    }
    // both fail, or the joint gate: nothing is fused
    for (integrity, dv) in [(parts(), 4.0), (Integrity::default(), 0.0)] {
        let mut ekf = filter(integrity);
        let before = bytes(&ekf);
        let record = ekf.update(0, &off(0, &somewhere(), [0.0, 30.0, 0.0], [dv, 0.0, 0.0])).unwrap();
        assert_eq!((record.status, record.refused), (Status::Rejected, 0b111_111));
        assert_eq!(bytes(&ekf), before);
    }
}

/// The tests of a part as they are written down: (y'S^-1 y, y'y / trace S).
fn by_hand(record: &Record, start: usize) -> (f64, f64) {
    let y = Vector3::from_fn(|i, _| record.innovation[start + i]);
    let s = Matrix3::from_fn(|i, j| record.innovation_cov[start + i][start + j]);
    (y.dot(&(s.try_inverse().unwrap() * y)), y.norm_squared() / s.trace())
}

#[test]
fn both_tests_of_a_part_cut_at_their_limit() {
    // chi-square, 3 degrees of freedom, 0.999: 16.266 (Abramowitz and Stegun, table 26.8)
    let mut rng = Rng(11);
    let (mut chi, mut ratio) = ([0; 2], [0; 2]);
    for _ in 0..400 {
        let d = [0, 1, 2].map(|_| 6.0 * rng.normal());
        let z = off(0, &somewhere(), d, [0.0; 3]);
        let record = filter(parts()).update(0, &z).unwrap();
        let (nis, trace) = by_hand(&record, 0);
        assert_eq!(record.refused & 0b111 != 0, nis > 16.266, "{nis}");
        chi[usize::from(record.refused != 0)] += 1;
        let only = Integrity { trace_ratio_limit: Some(10.0), ..parts() };
        let mut set = Settings { integrity: only, ..settings() };
        set.gate_probability = [None; 3];
        let mut ekf = Ekf::<Ned, 16>::new(&set, &common::blocks(15), &initial(somewhere())).unwrap();
        let record = ekf.update(0, &z).unwrap();
        assert_eq!(record.refused == 0b111, trace >= 10.0, "{trace}");
        assert_eq!(record.test, (trace >= 10.0).then_some(Test::TraceRatio));
        ratio[usize::from(record.refused != 0)] += 1;
    }
    assert!(chi.iter().chain(&ratio).all(|n| *n > 10), "{chi:?} {ratio:?}");
}

#[test]
fn the_trace_ratio_is_blind_along_a_short_axis_and_the_chi_square_test_is_not() {
    // vertical sigma 20 m, horizontal 1 m: 15 m to the north is fifteen sigma and still below ten traces
    let mut z = off(0, &somewhere(), [15.0, 0.0, 0.0], [0.0; 3]);
    z.covariance[2][2] = 400.0;
    let only = Integrity { trace_ratio_limit: Some(10.0), ..Integrity::default() };
    let set = Settings { integrity: only, ..settings() };
    let mut ekf = Ekf::<Ned, 16>::new(&set, &common::blocks(15), &initial(somewhere())).unwrap();
    assert_eq!(ekf.update(0, &z).unwrap().refused, 0);
    assert_eq!(filter(parts()).update(0, &z).unwrap().refused, 0b111);
}

#[test]
fn the_tolerance_test_knows_how_far_the_vehicle_can_have_gone() {
    let accel = 5.0;
    let set = Settings {
        integrity: Integrity { max_accel_m_s2: Some(accel), ..Integrity::default() },
        ..settings()
    };
    // a loose filter, so that only this test refuses
    let mut start = initial(somewhere());
    start.sd_p *= 1e3;
    for dt_s in [1, 4] {
        let mut ekf = Ekf::<Ned, 16>::new(&set, &common::blocks(15), &start).unwrap();
        // nothing accepted yet: nothing to compare with
        assert_eq!(ekf.update(0, &fix(0, &somewhere(), 1.0, 0.1)).unwrap().refused, 0);
        let then = ekf.solution();
        for k in 1..=100 * dt_s {
            // free of forces but gravity, so it moves on unaccelerated for this test's purpose
            ekf.predict(k * DT_NS, &Vector3::zeros(), &Vector3::new(0.0, 0.0, -9.8)).unwrap();
        }
        let t = dt_s as f64;
        // where the last accepted estimate would be now, seen from the present estimate
        let now = ekf.solution();
        let [_, dv, dp] = error(&now, &then);
        let gone = dp - then.v_n * t;
        let limit_p = 0.5 * accel * t * t + 5.0 * std::f64::consts::SQRT_2;
        let limit_v = accel * t + 0.5 * std::f64::consts::SQRT_2;
        for (share, refused) in [(0.98, 0), (1.02, 0b111)] {
            let mut d = [0.0; 3].map(|v: f64| v);
            for (i, d) in d.iter_mut().enumerate() {
                *d = -gone[i];
            }
            d[0] += share * limit_p;
            let mut vel = [-dv[0], -dv[1], -dv[2]];
            vel[1] += 0.5 * limit_v;
            let z = off(100 * dt_s * DT_NS, &now, d, vel);
            let record = ekf.clone().update(0, &z).unwrap();
            assert_eq!(record.refused, refused, "{share} after {t} s");
        }
        for (share, refused) in [(0.98, 0), (1.02, 0b111_000)] {
            let d = [-gone[0], -gone[1], -gone[2]];
            let z = off(100 * dt_s * DT_NS, &now, d, [-dv[0], -dv[1], -dv[2] - share * limit_v]);
            assert_eq!(ekf.clone().update(0, &z).unwrap().refused, refused, "velocity {share} after {t} s");
        }
    }
}

#[test]
fn sigmas_do_not_fall_below_their_floor_and_p_stays_positive() {
    let floor =
        Floor { phi: Vector3::repeat(1e-3), v: Vector3::repeat(0.02), p: Vector3::new(0.3, 0.2, 0.1) };
    let mut list = common::blocks(15);
    list[0].floor_sd = [8e-5; 6];
    let with = Settings { floor, ..settings() };
    let (start, legs) = fly::<Ned>(weaving, PLACE, 3000, DT_NS);
    let mut bounded = Ekf::<Ned, 16>::new(&with, &list, &initial(start)).unwrap();
    let mut free = Ekf::<Ned, 16>::new(&settings(), &common::blocks(15), &initial(start)).unwrap();
    for (k, leg) in legs.iter().enumerate() {
        for ekf in [&mut bounded, &mut free] {
            ekf.predict(leg.t_ns, &leg.delta.dtheta, &leg.delta.dvel).unwrap();
            if k % 10 == 9 {
                ekf.update(0, &fix(leg.t_ns, &leg.truth, 0.1, 0.01)).unwrap();
            }
        }
    }
    let least = [1e-3, 1e-3, 1e-3, 0.02, 0.02, 0.02, 0.3, 0.2, 0.1, 8e-5, 8e-5, 8e-5];
    for (i, least) in least.into_iter().enumerate() {
        let (a, b) = (bounded.covariance().get(i, i).sqrt(), free.covariance().get(i, i).sqrt());
        assert!(a >= least * (1.0 - 1e-12), "{i}: {a} {least}");
        assert!(b < least, "{i}: the test asks for something only if {b} < {least}");
    }
    assert!(dense(bounded.covariance()).cholesky().is_some());
}

fn fed_back_at_intervals<M: gnssins::nav::NavModel>(seconds: f64) -> (f64, f64) {
    let (start, legs) = fly::<M>(weaving, PLACE, 4000, DT_NS);
    let at = |feedback_ns| Settings { feedback_ns, ..settings() };
    let wrong = {
        let mut s = start;
        s.v_n += Vector3::new(0.1, -0.05, 0.1);
        s.position.height_m += 1.0;
        s.q_nb = gnssins::attitude::exp(&Vector3::new(2e-3, -3e-3, 4e-3)) * s.q_nb;
        s
    };
    let make = |set: &Settings| Ekf::<M, 32>::new(set, &common::blocks(22), &initial(wrong)).unwrap();
    let (mut every, mut seldom) = (make(&at(0)), make(&at((seconds * 1e9) as i64)));
    let mut resumed = seldom.clone();
    let mut rng = Rng(3);
    let (mut apart, mut waited) = (0.0f64, 0.0f64);
    for (k, leg) in legs.iter().enumerate() {
        let mut z = fix(leg.t_ns, &leg.truth, 1.0, 0.1);
        z.velocity_n = z.velocity_n.map(|v| v.map(|v| v + 0.1 * rng.normal()));
        for ekf in [&mut every, &mut seldom, &mut resumed] {
            ekf.predict(leg.t_ns, &leg.delta.dtheta, &leg.delta.dvel).unwrap();
            if k % 50 == 49 {
                ekf.update(0, &z).unwrap();
            }
        }
        if k == 1777 {
            // saved between two feedbacks, restored elsewhere: the same bits follow
            let saved = bytes(&seldom);
            resumed = make(&at((seconds * 1e9) as i64));
            restore(&mut resumed, &saved).unwrap();
        }
        let [phi, dv, dp] = error(&seldom.solution(), &every.solution());
        apart = apart.max(phi.norm() / 1e-3).max(dv.norm() / 0.1).max(dp.norm());
        let [phi, ..] = error(&seldom.solution(), &seldom.model().solution());
        waited = waited.max(phi.norm());
    }
    assert_eq!(bytes(&resumed), bytes(&seldom));
    let sd = |e: &Ekf<M, 32>| e.solution_sd().position_m.norm();
    assert!((sd(&every) / sd(&seldom) - 1.0).abs() < 0.01);
    (apart, waited)
}

#[test]
fn feedback_at_intervals_gives_the_same_estimate_while_the_errors_are_small() {
    for (apart, waited) in [fed_back_at_intervals::<Ned>(10.0), fed_back_at_intervals::<Ecef>(10.0)] {
        // the estimate waits beside the state, several milliradian of it, and agrees to second order
        assert!(waited > 2e-3, "{waited}");
        assert!(apart < 0.1, "{apart}");
    }
}

/// A stationary navigator 300 m off that believes itself good to metres, with good fixes every second.
fn lost(gate: Gate, limit: Option<u32>) -> (common::Log, f64, f64, Vec<f64>) {
    use gnssins::blocks::{Block, BlockKind};
    use gnssins::imu::ImuInput;
    use gnssins::stream::{Navigator, StreamSettings};
    let place = solution(PLACE, [0.0; 3], [0.0; 3]);
    let mut wrong = place;
    wrong.position.lat_rad += 300.0 / 6.37e6;
    let mut list = common::blocks(15);
    list.push(Block {
        jump_sd: [3.0; 6],
        ..common::block(BlockKind::GnssPositionError, common::markov(6.0, 2000.0), 6.0)
    });
    let set = Settings {
        integrity: Integrity { gate, ..Integrity::default() },
        gate_probability: [Some(0.999); 3],
        ..settings()
    };
    let ekf = Ekf::<Ned, 24>::new(&set, &list, &initial(wrong)).unwrap();
    let stream =
        StreamSettings { input: ImuInput::MeanRates, reacquire_after: limit, ..StreamSettings::default() };
    let mut nav = Navigator::<Ned, 24>::new(ekf, stream);
    let mut log = common::Log::default();
    let earth = gnssins::nav::EarthModel::default();
    let (s, c) = place.position.lat_rad.sin_cos();
    let force = -earth.ellipsoid.gravity_n(earth.gravity, s, c, place.position.height_m);
    let rate = earth.ellipsoid.earth_rate_n(s, c);
    for k in 1..=6000 {
        if k % 100 == 0 {
            nav.gnss(&fix(k * DT_NS, &place, 2.0, 0.1), &mut log).unwrap();
        }
        nav.imu(k * DT_NS, &rate, &force, &mut log).unwrap();
    }
    let [.., dp] = error(&nav.ekf().solution(), &place);
    let sds = (9..nav.ekf().layout().len()).map(|i| nav.ekf().covariance().get(i, i).sqrt()).collect();
    (log, dp.norm(), nav.ekf().solution_sd().position_m.norm(), sds)
}

#[test]
fn a_lost_filter_finds_back_whatever_is_judged_together() {
    for gate in [Gate::Joint, Gate::Parts] {
        let (log, off, sd, sds) = lost(gate, Some(10));
        let resets = log.events.iter().filter(|e| e.kind == gnssins::stream::EventKind::FilterReset);
        let resets = resets.count();
        assert!((1..=2).contains(&resets), "{gate:?}: {resets}");
        assert!(off < 3.5 * sd && off < 60.0, "{gate:?}: {off} m, claimed {sd} m");
        // sensor errors are not believed larger than they can be
        for (sd, most) in sds.iter().zip([1e-4; 3].iter().chain(&[0.02; 3]).chain(&[6.0; 3])) {
            assert!(*sd <= most * 1.2, "{gate:?}: {sds:?}");
        }
        let used = log.records.iter().rev().take(20).filter(|r| r.refused == 0).count();
        assert_eq!(used, 20, "{gate:?}: the last fixes are fused whole");
    }
    let (log, off, ..) = lost(Gate::Parts, None);
    assert!(off > 250.0 && log.records.iter().all(|r| r.refused & 0b111 != 0), "{off}");
}

#[test]
fn a_reset_leaves_the_tolerance_test_without_its_reference() {
    use gnssins::imu::ImuInput;
    use gnssins::stream::{Navigator, StreamSettings};
    // the fixes move by 500 m: no vehicle does; the chi-square gate is off
    let place = solution(PLACE, [0.0; 3], [0.0; 3]);
    let mut moved = place;
    moved.position.lon_rad += 500.0 / 4.1e6;
    let set =
        Settings { integrity: Integrity { max_accel_m_s2: Some(5.0), ..Integrity::default() }, ..settings() };
    let ekf = Ekf::<Ned, 16>::new(&set, &common::blocks(15), &initial(place)).unwrap();
    let stream = StreamSettings { input: ImuInput::MeanRates, ..StreamSettings::default() };
    let mut nav = Navigator::<Ned, 16>::new(ekf, stream);
    let mut log = common::Log::default();
    for k in 1..=400 {
        if k % 20 == 0 {
            let at = if k <= 100 { &place } else { &moved };
            nav.gnss(&fix(k * DT_NS, at, 1.0, 0.1), &mut log).unwrap();
        }
        nav.imu(k * DT_NS, &Vector3::zeros(), &Vector3::new(0.0, 0.0, -9.81), &mut log).unwrap();
    }
    let refused: Vec<bool> = log.records.iter().map(|r| r.refused & 0b111 != 0).collect();
    // five good, nine refused, the tenth taken up by the declared reset, the rest as well
    let want: Vec<bool> = (0..20).map(|k| (5..14).contains(&k)).collect();
    assert_eq!(refused, want);
}

#[test]
fn floors_lie_along_north_east_down_in_every_model() {
    fn sds<M: gnssins::nav::NavModel>() -> [f64; 6] {
        let floor =
            Floor { phi: Vector3::new(0.0, 0.0, 0.03), p: Vector3::new(0.0, 0.0, 5.0), ..Floor::NONE };
        let set = Settings { floor, ..settings() };
        let place = solution([50.0, 40.0, 100.0], [0.0; 3], [0.0; 3]);
        let mut ekf = Ekf::<M, 16>::new(&set, &common::blocks(15), &initial(place)).unwrap();
        for k in 1..=500 {
            ekf.predict(k * DT_NS, &Vector3::zeros(), &Vector3::new(0.0, 0.0, -0.0981)).unwrap();
            if k % 20 == 0 {
                let z = fix(k * DT_NS, &ekf.solution(), 0.3, 0.02);
                ekf.update(0, &z).unwrap();
            }
        }
        let sd = ekf.solution_sd();
        assert!(dense(ekf.covariance()).cholesky().is_some());
        std::array::from_fn(|i| if i < 3 { sd.position_m[i] } else { sd.euler_rad[i - 3] })
    }
    let (ned, ecef) = (sds::<Ned>(), sds::<Ecef>());
    for (a, b) in ned.iter().zip(&ecef) {
        assert!((a / b - 1.0).abs() < 0.01, "{ned:?} {ecef:?}");
    }
    assert!((ned[2] - 5.0).abs() < 1e-6 && ned[0] < 0.3 && ned[5] >= 0.03 && ned[3] < 0.012, "{ned:?}");
}

#[test]
fn the_jump_of_a_constellation_is_added_once_even_by_the_fix_that_resets() {
    use gnssins::blocks::{Block, BlockKind};
    let slow = Block {
        jump_sd: [50.0; 6],
        ..common::block(BlockKind::GnssPositionError, common::markov(6.0, 1e6), 6.0)
    };
    let place = solution(PLACE, [0.0; 3], [0.0; 3]);
    let set = Settings { gate_probability: [Some(0.999); 3], ..settings() };
    let run = |marked: bool| {
        let ekf = Ekf::<Ned, 16>::new(&set, &[slow], &initial(place)).unwrap();
        let stream = gnssins::stream::StreamSettings { reacquire_after: Some(2), ..Default::default() };
        let mut nav = gnssins::stream::Navigator::<Ned, 16>::new(ekf, stream);
        let mut log = common::Log::default();
        for k in 0..2 {
            // velocities that cannot be, so that the whole fix is refused; useless positions
            let mut z = off(0, &place, [0.0; 3], [30.0, 0.0, 0.0]);
            z.covariance[0][0] = 1e12;
            z.covariance[1][1] = 1e12;
            z.covariance[2][2] = 1e12;
            z.new_constellation = marked && k == 1;
            nav.gnss(&z, &mut log).unwrap();
        }
        assert_eq!(log.events.iter().filter(|e| e.kind.code() == "filter.reset").count(), 1);
        nav.ekf().covariance().get(9, 9)
    };
    let (plain, marked) = (run(false), run(true));
    // added before the reset scales: once is 2500, and the bound of the block is the larger of its own and the jump
    assert!(plain < 50.0 * 50.0 + 1.0 && marked < 2.0 * 2500.0 + 40.0, "{plain} {marked}");
}
