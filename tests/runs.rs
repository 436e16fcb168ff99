//! Short simulated runs: planted errors are found, the two models agree, the pole is crossed.

mod common;

use common::{DT_NS, Leg, Rng, antenna, block, bytes, error, fix, fly, initial, markov, settings, solution};
use gnssins::attitude;
use gnssins::blocks::{Block, BlockKind, Process};
use gnssins::ekf::{Ekf, Initial, Settings};
use gnssins::imu::{Coning, ImuDelta};
use gnssins::inverse::FreeIns;
use gnssins::meas::Status;
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::Ned;
use gnssins::nav::{EarthModel, NavModel, Solution};
use gnssins::stream::{Navigator, StreamSettings};
use nalgebra::{UnitQuaternion, Vector3};

const PLACE: [f64; 3] = [47.0, 8.0, 500.0];

/// What is wrong with the sensors of a run.
#[derive(Clone, Copy, Default)]
struct Planted {
    lever_b: Vector3<f64>,
    position_n: Vector3<f64>,
    velocity_n: Vector3<f64>,
    gyro_bias: Vector3<f64>,
    accel_bias: Vector3<f64>,
}

/// Runs a filter through a flight with fixes every 0.2 s and their noise; returns it.
fn run<M: NavModel>(
    set: &Settings,
    blocks: &[Block],
    start: &Initial,
    legs: &[Leg],
    planted: &Planted,
    fix_sd: [f64; 2],
) -> Ekf<M, 32> {
    let mut rng = Rng(5);
    let mut ekf = Ekf::<M, 32>::new(set, blocks, start).unwrap();
    for (k, leg) in legs.iter().enumerate() {
        let dt = leg.delta.dt_s;
        let (dtheta, dvel) =
            (leg.delta.dtheta + planted.gyro_bias * dt, leg.delta.dvel + planted.accel_bias * dt);
        ekf.predict(leg.t_ns, &dtheta, &dvel).unwrap();
        if k % 20 == 19 {
            let (position, v) = antenna(&leg.truth, &planted.lever_b, &(leg.delta.dtheta / dt));
            let mut z = fix(leg.t_ns, &leg.truth, fix_sd[0], fix_sd[1]);
            let off = planted.position_n + rng.vector(fix_sd[0]);
            let mut p = position;
            p.lat_rad += off.x / 6.37e6;
            p.lon_rad += off.y / (6.39e6 * p.lat_rad.cos());
            p.height_m -= off.z;
            z.position = Some(p);
            let v = v + planted.velocity_n + rng.vector(fix_sd[1]);
            z.velocity_n = [0, 1, 2].map(|i| Some(v[i]));
            assert_eq!(ekf.update(k as u64, &z).unwrap().status, Status::Used);
        }
    }
    ekf
}

/// The three states of a block are known and within four sigma of what was planted.
fn assert_found<M: NavModel>(ekf: &Ekf<M, 32>, kind: BlockKind, truth: &Vector3<f64>, sd_below: f64) {
    let start = ekf.layout().find(kind).unwrap();
    for i in 0..3 {
        let (got, sd) = (ekf.params()[start + i], ekf.covariance().get(start + i, start + i).sqrt());
        assert!(sd < sd_below, "{kind:?} {i}: sd {sd}");
        assert!((got - truth[i]).abs() < 4.0 * sd, "{kind:?} {i}: {got}, planted {}, sd {sd}", truth[i]);
    }
}

fn known(start: Solution) -> Initial {
    Initial {
        sd_phi: Vector3::repeat(1e-3),
        sd_v: Vector3::repeat(1e-3),
        sd_p: Vector3::repeat(1e-3),
        ..initial(start)
    }
}

fn check_lever_arm<M: NavModel>() {
    let planted = Planted { lever_b: Vector3::new(1.2, -0.4, -1.5), ..Planted::default() };
    let list = [block(BlockKind::GnssLeverArm, Process::Constant, 2.0)];
    // at rest without turning the arm cannot be told from the position: a good start makes it known
    let (start, legs) = fly::<M>(common::resting, PLACE, 1000, DT_NS);
    let ekf = run::<M>(&settings(), &list, &known(start), &legs, &planted, [0.02, 0.02]);
    assert_found(&ekf, BlockKind::GnssLeverArm, &planted.lever_b, 0.03);
    // turning on the spot shows it whatever the start
    let (start, legs) = fly::<M>(common::turning, PLACE, 3000, DT_NS);
    let ekf = run::<M>(&settings(), &list, &initial(start), &legs, &planted, [0.02, 0.02]);
    assert_found(&ekf, BlockKind::GnssLeverArm, &planted.lever_b, 0.03);
    assert_eq!(ekf.lever_b_m(), Vector3::from_column_slice(&ekf.params()[9..12]));
}

#[test]
fn lever_arm_block_finds_a_planted_arm() {
    check_lever_arm::<Ned>();
    check_lever_arm::<Ecef>();
}

#[test]
fn gnss_error_blocks_find_planted_errors() {
    let planted = Planted {
        position_n: Vector3::new(1.5, -2.0, 3.0),
        velocity_n: Vector3::new(0.3, -0.2, 0.15),
        ..Planted::default()
    };
    let list = [
        block(BlockKind::GnssPositionError, markov(3.0, 1000.0), 3.0),
        block(BlockKind::GnssVelocityError, markov(0.3, 1000.0), 0.3),
    ];
    for motion in [common::resting as common::Motion, common::turning, common::weaving] {
        let (start, legs) = fly::<Ned>(motion, PLACE, 1000, DT_NS);
        let ned = run::<Ned>(&settings(), &list, &known(start), &legs, &planted, [0.1, 0.05]);
        let ecef = run::<Ecef>(&settings(), &list, &known(start), &legs, &planted, [0.1, 0.05]);
        assert_found(&ned, BlockKind::GnssPositionError, &planted.position_n, 0.5);
        assert_found(&ned, BlockKind::GnssVelocityError, &planted.velocity_n, 0.05);
        assert_found(&ecef, BlockKind::GnssPositionError, &planted.position_n, 0.5);
        assert_found(&ecef, BlockKind::GnssVelocityError, &planted.velocity_n, 0.05);
    }
}

/// A start that is wrong by one sigma or so.
fn wrong(start: &Solution) -> Initial {
    let mut s = *start;
    s.position.lat_rad += 0.7 / 6.4e6;
    s.position.height_m -= 1.1;
    s.v_n += Vector3::new(0.05, -0.1, 0.08);
    s.q_nb = attitude::exp(&Vector3::new(0.004, -0.006, 0.01)) * s.q_nb;
    initial(s)
}

const BIASES: Planted = Planted {
    lever_b: Vector3::new(0.8, 0.2, -1.1),
    gyro_bias: Vector3::new(5e-5, -8e-5, 6e-5),
    accel_bias: Vector3::new(0.02, -0.01, 0.015),
    position_n: Vector3::new(0.0, 0.0, 0.0),
    velocity_n: Vector3::new(0.0, 0.0, 0.0),
};

#[test]
fn ned_and_ecef_agree_on_a_flight_and_both_find_the_truth() {
    let set = Settings { lever_b_m: BIASES.lever_b, ..settings() };
    let (start, legs) = fly::<Ned>(common::weaving, PLACE, 6000, DT_NS);
    let ned = run::<Ned>(&set, &common::blocks(15), &wrong(&start), &legs, &BIASES, [0.5, 0.05]);
    let ecef = run::<Ecef>(&set, &common::blocks(15), &wrong(&start), &legs, &BIASES, [0.5, 0.05]);
    let [phi, dv, dp] = error(&ned.solution(), &ecef.solution());
    assert!(dp.amax() < 1e-4 && dv.amax() < 1e-5 && phi.amax() < 1e-6, "{dp} {dv} {phi}");
    let (a, b) = (ned.ned_covariance(), ecef.ned_covariance());
    for i in 0..15 {
        for j in 0..15 {
            let scale = (a[i][i] * a[j][j]).sqrt();
            assert!((a[i][j] - b[i][j]).abs() < 1e-4 * scale, "({i}, {j}): {:e} {:e}", a[i][j], b[i][j]);
        }
    }
    let (s, truth) = (ned.solution_sd(), legs[legs.len() - 1].truth);
    let [phi, dv, dp] = error(&ned.solution(), &truth);
    for i in 0..3 {
        assert!(
            dp[i].abs() < 4.0 * s.position_m[i] && s.position_m[i] < 0.3,
            "position {i}: {} {}",
            dp[i],
            s.position_m[i]
        );
        assert!(dv[i].abs() < 4.0 * s.velocity_m_s[i] && s.velocity_m_s[i] < 0.05);
        assert!(phi[i].abs() < 4.0 * ned.covariance().get(i, i).sqrt());
        // sigmas of the solution are those of the covariance along north, east, down
        assert!((s.position_m[i] - a[6 + i][6 + i].sqrt()).abs() < 1e-12);
    }
    assert_found(&ned, BlockKind::GyroBias, &BIASES.gyro_bias, 1e-4);
    assert_found(&ecef, BlockKind::AccelBias, &BIASES.accel_bias, 0.02);
}

#[test]
fn either_sign_of_the_quaternion_makes_the_same_filter() {
    fn check<M: NavModel>() {
        let (start, legs) = fly::<M>(common::weaving, PLACE, 300, DT_NS);
        let other = Solution { q_nb: UnitQuaternion::new_unchecked(-start.q_nb.into_inner()), ..start };
        let list = common::blocks(15);
        let a = run::<M>(&settings(), &list, &initial(start), &legs, &BIASES, [1.0, 0.1]);
        let b = run::<M>(&settings(), &list, &initial(other), &legs, &BIASES, [1.0, 0.1]);
        assert_eq!(a.covariance(), b.covariance());
        assert_eq!(a.params(), b.params());
        assert_eq!((a.solution().position, a.solution().v_n), (b.solution().position, b.solution().v_n));
        assert_eq!(attitude::dcm(&a.solution().q_nb), attitude::dcm(&b.solution().q_nb));
        let off = a.solution_sd().euler_rad - b.solution_sd().euler_rad;
        assert!(off.amax() < 1e-15, "{off}");
    }
    check::<Ned>();
    check::<Ecef>();
}

#[test]
fn two_sample_coning_is_used_until_increments_are_broken() {
    let start = solution(PLACE, [10.0, 0.0, 0.0], [5.0, 5.0, 30.0]);
    let twice = |coning, break_between: bool| {
        let mut ekf = Ekf::<Ned, 16>::new(&Settings { coning, ..settings() }, &[], &initial(start)).unwrap();
        ekf.predict(DT_NS, &Vector3::new(0.02, 0.0, 0.0), &Vector3::new(0.0, 0.0, -0.1)).unwrap();
        if break_between {
            ekf.break_increments();
        }
        ekf.predict(2 * DT_NS, &Vector3::new(0.0, 0.03, 0.0), &Vector3::new(0.05, 0.0, -0.1)).unwrap();
        ekf.solution()
    };
    let (two, one) = (twice(Coning::TwoSample, false), twice(Coning::OneSample, false));
    assert_eq!(twice(Coning::TwoSample, true), one);
    assert_eq!(twice(Coning::OneSample, true), one);
    // dtheta_prev x dtheta / 12 about the body's down axis
    let turn = attitude::log(&(one.q_nb.inverse() * two.q_nb));
    assert!((turn - Vector3::new(0.0, 0.0, 0.02 * 0.03 / 12.0)).amax() < 2e-6, "{turn}");
}

#[test]
fn ecef_crosses_the_pole_with_fixes() {
    // 600 m before the pole, straight over it at 100 m/s without turning against the Earth
    let lat = 90.0 - 600.0 / 111_694.0;
    let start = solution([lat, 25.0, 1000.0], [100.0, 0.0, 0.0], [0.0; 3]);
    let earth = EarthModel::default();
    let mut ins = FreeIns::new(Ecef::new(earth, &start).unwrap(), Coning::TwoSample);
    let mut ekf = Ekf::<Ecef, 16>::new(&settings(), &common::blocks(15), &wrong(&start)).unwrap();
    let mut rng = Rng(9);
    let mut nearest = f64::INFINITY;
    let w_b = Vector3::new(0.0, 0.0, -earth.ellipsoid.omega_rad_s);
    for k in 1..=1200i64 {
        let delta = ImuDelta { dt_s: 0.01, dtheta: w_b * 0.01, dvel: Vector3::new(0.0, 0.0, -0.0983) };
        ins.step(&delta).unwrap();
        let truth = ins.model().solution();
        nearest = nearest.min(90.0 - truth.position.lat_rad.to_degrees());
        ekf.predict(k * DT_NS, &delta.dtheta, &delta.dvel).unwrap();
        if k % 50 == 0 {
            let mut z = fix(k * DT_NS, &truth, 0.5, 0.05);
            z.velocity_n = z.velocity_n.map(|v| v.map(|v| v + 0.05 * rng.normal()));
            assert_eq!(ekf.update(0, &z).unwrap().status, Status::Used, "step {k}");
        }
        let sd = ekf.solution_sd();
        let all = [sd.position_m, sd.velocity_m_s, sd.euler_rad];
        assert!(all.iter().all(|v| v.iter().all(|x| x.is_finite())), "step {k}: {sd:?}");
    }
    let truth = ins.model().solution();
    assert!(nearest < 1e-4, "passed the pole at {nearest} deg");
    assert!((truth.position.lon_rad.to_degrees() - (25.0 - 180.0)).abs() < 0.5, "{:?}", truth.position);
    assert!((truth.v_n.x + 100.0).abs() < 0.1, "now flying south: {}", truth.v_n);
    let s = ekf.solution_sd();
    let [_, dv, dp] = error(&ekf.solution(), &truth);
    assert!(dp.amax() < 1.0 && dv.amax() < 0.1, "{dp} {dv} {s:?}");
    assert!(s.position_m.amax() < 0.5 && s.velocity_m_s.amax() < 0.1, "{s:?}");
    // the saved state of the far side restores
    let saved = bytes(&ekf);
    common::restore(&mut ekf, &saved).unwrap();
}

#[test]
fn a_fix_at_the_start_knows_the_rate_of_the_row_there() {
    let lever_b_m = Vector3::new(3.0, -2.0, 4.0);
    let begin = solution(PLACE, [10.0, 0.0, 0.0], [0.0; 3]);
    let w = Vector3::new(0.3, -0.2, 0.5);
    let set = Settings { lever_b_m, ..settings() };
    let ekf = Ekf::<Ned, 16>::new(&set, &common::blocks(15), &initial(begin)).unwrap();
    let mut nav = Navigator::<Ned, 16>::new(ekf, StreamSettings::default());
    let mut log = common::Log::default();
    nav.imu(0, &w, &Vector3::new(0.0, 0.0, -9.8), &mut log).unwrap();
    let (position, v) = common::antenna(&begin, &lever_b_m, &w);
    let mut z = fix(0, &begin, 1.0, 0.1);
    (z.position, z.velocity_n) = (Some(position), [0, 1, 2].map(|i| Some(v[i])));
    nav.gnss(&z, &mut log).unwrap();
    assert!(log.records[0].innovation[3..].iter().all(|y| y.abs() < 1e-9), "{:?}", log.records[0].innovation);
}

#[test]
fn a_gap_adds_the_noise_of_what_the_rates_may_have_done_in_it() {
    let begin = solution(PLACE, [0.0; 3], [0.0; 3]);
    let make = || Ekf::<Ned, 16>::new(&settings(), &[], &initial(begin)).unwrap();
    let weight = Vector3::new(0.0, 0.0, -9.8);
    for (dg, da) in [(0.0, 0.0), (0.3, 0.0), (0.0, 4.0)] {
        // rows to 0.2 s, nothing up to 0.41 s, where the rates have become others
        let (w, f) = (Vector3::repeat(dg), weight + Vector3::repeat(da));
        let set = StreamSettings { input: gnssins::imu::ImuInput::MeanRates, ..StreamSettings::default() };
        let (mut nav, mut by_hand) = (Navigator::<Ned, 16>::new(make(), set), make());
        for k in 1..=20 {
            nav.imu(k * DT_NS, &Vector3::zeros(), &weight, &mut ()).unwrap();
        }
        nav.imu(41 * DT_NS, &w, &f, &mut ()).unwrap();
        for k in 1..=41 {
            let share = [0.0, 0.5, 1.0][usize::from(k > 20) + usize::from(k > 40)];
            by_hand
                .predict(k * DT_NS, &(w * share * 0.01), &((weight + (f - weight) * share) * 0.01))
                .unwrap();
        }
        // over a gap of 0.21 s a rate may change by 0.1 rad/s and 1 m/s² per second and come back
        let (length, hole) = (0.21f64, 0.2);
        for (start, change, slope) in [(0, dg, 0.1), (3, da, 1.0)] {
            let want = (change * change / 12.0 + (0.5f64 * slope * length).powi(2)) * length * hole;
            for i in start..start + 3 {
                let added = nav.ekf().covariance().get(i, i) - by_hand.covariance().get(i, i);
                // attitude noise of the gap turns gravity into velocity noise too
                let turned = if start == 3 {
                    (dg * dg / 12.0 + 1.1e-4) * length * length.powi(2) * hole * 36.0
                } else {
                    0.0
                };
                assert!(
                    added > 0.95 * want && added < 1.05 * (want + turned),
                    "{dg} {da} state {i}: {added:e} {want:e}"
                );
            }
        }
    }
}
