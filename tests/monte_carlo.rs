//! Monte Carlo: the same bits for any number of threads, the laws of the sensors, sums against runs, shared gains.

mod common;

use std::ops::ControlFlow;

use common::DT_NS;
use gnssins::blocks::{Block, BlockKind, Process};
use gnssins::discretise::ImuNoise;
use gnssins::earth::WGS84;
use gnssins::ekf::{Ekf, Initial, Settings};
use gnssins::error::Error;
use gnssins::frames::{Lla, c_ne, lla_to_ecef};
use gnssins::imu::{Coning, ImuInput};
use gnssins::inverse::FreeIns;
use gnssins::meas::Source;
use gnssins::monte_carlo::aids::{Aids, Antenna, Gnss, Place, SlowError};
use gnssins::monte_carlo::imu::{ErrorKind, Imu, ImuRun, SensorError, Triad};
use gnssins::monte_carlo::normal::stream;
use gnssins::monte_carlo::process::{Components, Law, LowPass, Series};
use gnssins::monte_carlo::{BLOCK, CHUNK, Deviates, Epoch, Feed, Filter, Mode, MonteCarlo, Plan, Sums};
use gnssins::nav::kinematics::AttitudeForm;
use gnssins::nav::ned::Ned;
use gnssins::nav::{EarthModel, NavModel, Solution};
use gnssins::simd::Isa;
use gnssins::stream::StreamSettings;
use nalgebra::{UnitQuaternion, Vector3};

const DT_S: f64 = 0.01;
const SECONDS: usize = 12;
const BIAS_SD: f64 = 2e-4;
const MARKOV_SD: f64 = 5e-3;
const TAU_S: f64 = 100.0;

fn six(value: f64) -> Components {
    [value; 6]
}

/// Twelve seconds of a gentle turn with fixes at 2 Hz, one gap, a constant gyro bias and a drifting accelerometer.
fn plan() -> Plan {
    let n = 100 * SECONDS;
    let start = Solution {
        position: Lla::new(0.8, 0.2, 100.0),
        v_n: Vector3::new(20.0, 0.0, 0.0),
        q_nb: UnitQuaternion::identity(),
    };
    let mut ins = FreeIns::new(Ned::new(EarthModel::default(), &start).unwrap(), Coning::TwoSample);
    let mut exact = [vec![[[0.0; BLOCK]; 3]; n.div_ceil(BLOCK)], vec![[[0.0; BLOCK]; 3]; n.div_ceil(BLOCK)]];
    let mut dt_s = vec![[0.0; BLOCK]; n.div_ceil(BLOCK)];
    let mut truth = vec![start];
    for k in 0..n {
        let heading = 0.05 * (k + 1) as f64 * DT_S;
        let v_n = 20.0 * Vector3::new(heading.cos(), heading.sin(), 0.0);
        let q_nb = UnitQuaternion::from_euler_angles(0.02 * heading.sin(), 0.0, heading);
        let delta = ins.step_to(DT_S, &v_n, &q_nb).unwrap();
        dt_s[k / BLOCK][k % BLOCK] = DT_S;
        for axis in 0..3 {
            exact[0][k / BLOCK][axis][k % BLOCK] = delta.dtheta[axis];
            exact[1][k / BLOCK][axis][k % BLOCK] = delta.dvel[axis];
        }
        truth.push(ins.model().solution());
    }
    let t_ns: Vec<i64> = (0..=n as i64).map(|k| k * DT_NS).collect();
    let fixes: Vec<usize> = (1..=2 * SECONDS).map(|k| 50 * k).collect();
    let antenna = fixes.iter().map(|&k| Antenna {
        position: lla_to_ecef(&WGS84, &truth[k].position).0,
        velocity: c_ne(truth[k].position.lat_rad, truth[k].position.lon_rad).tr_mul(&truth[k].v_n),
        per_lever: None,
    });
    let gnss = Gnss {
        place: fixes.iter().map(|&k| Place { interval: k.min(n - 1), share: f64::from(k == n) }).collect(),
        antenna: antenna.collect(),
        sd: vec![[1.0, 1.0, 1.0, 0.05, 0.05, 0.05]; fixes.len()],
        ..Gnss::default()
    };
    let feed = fixes.iter().enumerate().filter(|(_, k)| !(600..800).contains(*k));
    let feed =
        feed.map(|(index, &k)| Feed { source: Source::Gnss, index, t_ns: t_ns[k], new_constellation: false });
    let triad = |density: f64| Triad { density: [density; 3], ..Triad::default() };
    let errors = vec![
        SensorError {
            kind: ErrorKind::GyroBias,
            stream: stream("gyro"),
            law: Law::Constant { value: six(0.0), sd: six(BIAS_SD) },
        },
        SensorError {
            kind: ErrorKind::AccelBias,
            stream: stream("accel"),
            law: Law::markov(six(MARKOV_SD), TAU_S, DT_S),
        },
    ];
    let noise = (1e-4_f64, 1e-3_f64);
    let block = |kind, process, sd: f64| Block {
        kind,
        process,
        initial_sd: six(sd),
        initial: six(0.0),
        distance_m: f64::INFINITY,
        jump_sd: six(0.0),
        floor_sd: six(0.0),
    };
    let settings = Settings::new(ImuNoise {
        gyro_psd: Vector3::repeat(noise.0 * noise.0),
        accel_psd: Vector3::repeat(noise.1 * noise.1),
    });
    let epochs = (1..=SECONDS).map(|s| 100 * s);
    Plan {
        seed: 7,
        rows: n,
        ellipsoid: WGS84,
        ecef: false,
        initial: Initial {
            t_ns: 0,
            solution: start,
            sd_phi: Vector3::repeat(2e-3),
            sd_v: Vector3::repeat(0.05),
            sd_p: Vector3::repeat(1.0),
        },
        imu: Imu { dt_s, exact, triads: [triad(noise.0), triad(noise.1)], errors },
        aids: Aids { gnss, ..Aids::default() },
        feed: feed.collect(),
        uses: [true, true],
        epochs: epochs.map(|row| Epoch { row, error: true, nees: true, truth: truth[row] }).collect(),
        after_ns: 0,
        truths: (0..6).map(Some).collect(),
        groups: vec![(0..15).collect(), (0..9).collect(), (9..12).collect()],
        gaps: vec![[6_000_000_000, 8_000_000_000]],
        filter: Filter {
            settings,
            blocks: vec![
                block(BlockKind::GyroBias, Process::Constant, BIAS_SD),
                block(
                    BlockKind::AccelBias,
                    Process::GaussMarkov { sd: six(MARKOV_SD), tau_s: six(TAU_S) },
                    MARKOV_SD,
                ),
            ],
            stream: StreamSettings { input: ImuInput::Increments, ..StreamSettings::default() },
            attitude_form: AttitudeForm::default(),
        },
        t_ns,
    }
}

fn set(mode: Mode) -> MonteCarlo<Ned, 16> {
    MonteCarlo::new(plan(), mode).unwrap()
}

fn chunks(set: &MonteCarlo<Ned, 16>, runs: std::ops::Range<u32>, jobs: usize) -> Vec<(u32, Sums)> {
    let mut out = vec![];
    let take = |first, sums| {
        out.push((first, sums));
        ControlFlow::Continue(())
    };
    set.run(runs, jobs, take, || true).unwrap();
    out
}

// ---- order

#[test]
fn sums_are_the_same_bits_for_any_number_of_threads_and_any_split() {
    for mode in [Mode::Full, Mode::Shared] {
        let set = set(mode);
        let one = chunks(&set, 0..10, 1);
        assert_eq!(one.iter().map(|(first, _)| *first).collect::<Vec<_>>(), [0, CHUNK, 2 * CHUNK]);
        assert_eq!(one[2].1.runs.len(), 2);
        assert_eq!(one, chunks(&set, 0..10, 3));
        let mut split = chunks(&set, 0..CHUNK, 2);
        split.extend(chunks(&set, CHUNK..10, 1));
        assert_eq!(one, split);
    }
}

#[test]
fn a_break_keeps_the_chunks_before_it_and_starts_no_more() {
    let set = set(Mode::Shared);
    let (mut taken, mut asked) = (vec![], 0);
    let take = |first, _| {
        taken.push(first);
        if first == CHUNK { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    set.run(0..4000, 2, take, || true).unwrap();
    assert_eq!(taken, [0, CHUNK]);
    let go_on = || {
        asked += 1;
        asked < 3
    };
    let mut count = 0;
    let take = |_, _| {
        count += 1;
        ControlFlow::Continue(())
    };
    set.run(0..4000, 2, take, go_on).unwrap();
    assert!(count <= 3, "{count}");
}

#[test]
fn a_run_that_fails_is_named_after_the_chunks_before_it() {
    // GIVEN a gap of the IMU that the settings refuse, THEN the first run says so
    let mut broken = plan();
    let gap = 500;
    for t in &mut broken.t_ns[gap..] {
        *t += 5_000_000_000;
    }
    broken.feed.clear();
    let set = MonteCarlo::<Ned, 16>::new(broken, Mode::Full).unwrap();
    let failure = set.run(2..9, 2, |_, _| ControlFlow::Continue(()), || true).unwrap_err();
    assert_eq!(failure.run, 2);
    assert!(matches!(failure.error, Error::Gap { .. }), "{:?}", failure.error);
}

#[test]
fn what_does_not_fit_is_refused() {
    let refused = |change: &dyn Fn(&mut Plan), mode| {
        let mut plan = plan();
        change(&mut plan);
        match MonteCarlo::<Ned, 16>::new(plan, mode) {
            Err(Error::Config { what, .. }) => what,
            other => panic!("{:?}", other.map(drop)),
        }
    };
    let full = Mode::Full;
    assert_eq!(refused(&|p| p.rows = 10_000, full), "plan: IMU rows");
    assert_eq!(refused(&|p| p.epochs[3].row = 0, full), "plan: epochs");
    assert_eq!(refused(&|p| p.feed[0].index = 99, full), "plan: value of an aid");
    assert_eq!(refused(&|p| p.truths[0] = Some(99), full), "plan: true error");
    assert_eq!(refused(&|p| p.groups[0][0] = 15, full), "plan: state of a group");
    assert_eq!(refused(&|p| p.truths.truncate(2), full), "plan: block states");
    assert_eq!(refused(&|p| p.filter.stream.input = ImuInput::Rates, full), "imu.input (number of the kind)");
    let slow = |p: &mut Plan| p.filter.settings.feedback_ns = 1;
    assert_eq!(refused(&slow, Mode::Shared), "filter.feedback_interval (ns)");
}

// ---- sensors

#[test]
fn sensors_measure_the_same_bits_on_all_instructions() {
    let mut imu = plan().imu;
    imu.triads[0].low_pass = Some(LowPass::new(30.0, DT_S));
    imu.triads[1].full_scale = Some(9.8);
    imu.triads[1].lsb = Some(1e-4);
    imu.errors[1].kind = ErrorKind::AccelMisalignment;
    let all = |isa| {
        let mut run = ImuRun::new(&imu, Deviates::new(3, 4).on(isa));
        let blocks = (0..imu.dt_s.len()).map(|block| {
            run.block(block);
            *run.measured()
        });
        blocks.collect::<Vec<_>>()
    };
    let portable = all(Isa::Portable);
    assert_eq!(portable, all(Isa::Avx2));
    assert_eq!(portable, all(Isa::Avx512));
    // clipped at the range before the rounding, to whole counts after it
    let down = portable.iter().flat_map(|block| block[1][2]).take(100 * SECONDS);
    for value in down {
        assert!(value.abs() <= 9.8 * DT_S + 0.5e-4 && ((value / 1e-4).round() - value / 1e-4).abs() < 1e-9);
    }
}

/// Mean products of a process with itself `lag` intervals later, over runs.
fn covariance(law: &Law, at: usize, lag: usize, runs: u32) -> f64 {
    let mut sum = 0.0;
    for run in 0..runs {
        let deviates = Deviates::new(11, run);
        let mut series = Series::new(law, 5, 3, &deviates);
        let mut values = vec![[0.0; 3]; at + lag + 1];
        for block in 0..=(at + lag) / BLOCK {
            series.advance(&deviates, block as u32);
            for i in 0..=BLOCK {
                if let Some(value) = values.get_mut(block * BLOCK + i) {
                    *value = [0, 1, 2].map(|c| series.at(c, i));
                }
            }
        }
        sum += values[at].iter().zip(&values[at + lag]).map(|(a, b)| a * b).sum::<f64>();
    }
    sum / f64::from(3 * runs)
}

#[test]
fn processes_have_the_covariances_of_their_laws() {
    // 6000 products: their mean scatters by 1.8 % to 2.6 % of the product of the sigmas
    let runs = 2000;
    let (sd, tau, dt) = (2.0, 0.5, DT_S);
    let markov = Law::markov(six(sd), tau, dt);
    let varying = Law::varying(six(sd), &[0.02; 200]);
    let walk = Law::walk(six(1.0), &six(3.0), dt);
    let constant = Law::Constant { value: six(0.0), sd: six(sd) };
    for (at, lag) in [(0, 0), (0, 40), (70, 0), (70, 50), (63, 1), (64, 64)] {
        let fade = sd * sd * (-(lag as f64) * dt / tau).exp();
        for law in [&markov, &varying] {
            let got = covariance(law, at, lag, runs);
            assert!((got - fade).abs() < 0.1 * sd * sd, "{at} {lag}: {got} {fade}");
        }
        let grown = 1.0 + 9.0 * at as f64 * dt;
        let got = covariance(&walk, at, lag, runs);
        assert!(
            (got - grown).abs() < 0.12 * (grown * (grown + 9.0 * lag as f64 * dt)).sqrt(),
            "{got} {grown}"
        );
        assert!((covariance(&constant, at, lag, runs) - sd * sd).abs() < 0.1 * sd * sd);
    }
}

#[test]
fn noise_behind_a_low_pass_has_the_variances_of_its_closed_form() {
    // GIVEN a corner of 10 Hz at 100 Hz, THEN sums of m samples have q (mT - (1 - a^m)/k), a = exp(-kT)
    let corner_hz = 10.0;
    let n = 4096;
    let density = 0.3;
    let triad =
        Triad { density: [density; 3], low_pass: Some(LowPass::new(corner_hz, DT_S)), ..Triad::default() };
    let imu = Imu {
        dt_s: vec![[DT_S; BLOCK]; n / BLOCK],
        exact: [vec![[[0.0; BLOCK]; 3]; n / BLOCK], vec![[[0.0; BLOCK]; 3]; n / BLOCK]],
        triads: [triad, Triad::default()],
        errors: vec![],
    };
    let k = std::f64::consts::TAU * corner_hz;
    for m in [1, 4, 32] {
        let (mut squares, mut count) = (0.0, 0.0);
        for run in 0..60 {
            let mut sensors = ImuRun::new(&imu, Deviates::new(1, run));
            let mut values = vec![];
            for block in 0..n / BLOCK {
                sensors.block(block);
                values.extend_from_slice(&sensors.measured()[0][0]);
            }
            for part in values.chunks_exact(m) {
                squares += part.iter().sum::<f64>().powi(2);
                count += 1.0;
            }
        }
        let t = m as f64 * DT_S;
        let wanted = density * density * (t - (1.0 - (-k * t).exp()) / k);
        assert!((squares / count / wanted - 1.0).abs() < 0.06, "{m}: {} {wanted}", squares / count);
    }
}

#[test]
fn jumps_enter_with_their_fix_and_fade() {
    let mut plan = plan();
    let growth = vec![DT_S / 4.0; 100 * SECONDS];
    let decay: Vec<f64> = (0..=growth.len()).map(|k| k as f64 * DT_S / 4.0).collect();
    plan.aids.gnss.slow[0] = Some(SlowError {
        stream: stream("slow"),
        law: Law::varying(six(0.0), &growth),
        jump_stream: stream("jump"),
        jump_sd: [3.0; 3],
        decay,
    });
    plan.aids.gnss.changes = vec![9];
    let made = plan.simulated(5);
    let columns = plan.columns();
    let error = |row: usize| made.true_errors[row * columns + 6 + 3];
    assert_eq!(error(499), 0.0);
    assert!(error(500).abs() > 1e-3);
    assert!((error(900) / error(500) - (-1.0_f64).exp()).abs() < 1e-9);
}

// ---- sums

#[test]
fn nees_and_nis_are_those_of_a_filter_that_knows_its_errors() {
    // 200 runs: NEES of 15 states over 200 runs scatters by 0.39, its mean over epochs by less
    let runs = 200;
    for mode in [Mode::Full, Mode::Shared] {
        let set = set(mode);
        let (mut nees, mut nis, mut ratio, mut at) = ([0.0; 3], (0.0, 0), 0.0, 0);
        for (_, sums) in chunks(&set, 0..runs, 2) {
            for (k, value) in sums.nees.iter().enumerate() {
                nees[k % 3] += value / (f64::from(runs) * SECONDS as f64);
            }
            nis = (nis.0 + sums.nis[0][6].sum, nis.1 + sums.nis[0][6].count);
            ratio += sums.gaps[0].ratios.iter().sum::<f64>();
            at += sums.gaps[0].runs;
        }
        let [all, navigation, gyro] = nees;
        assert!(
            (all - 15.0).abs() < 1.2 && (navigation - 9.0).abs() < 0.9 && (gyro - 3.0).abs() < 0.6,
            "{nees:?}"
        );
        assert!((nis.0 / nis.1 as f64 - 6.0).abs() < 0.25, "{nis:?}");
        assert_eq!(at, u64::from(runs));
        assert!((ratio / (9.0 * at as f64) - 1.0).abs() < 0.25, "{ratio}");
    }
}

#[test]
fn a_run_by_itself_is_the_run_of_the_set() {
    let plan = plan();
    let run = 3;
    let made = plan.simulated(run);
    let mut ekf = Ekf::<Ned, 16>::new(&plan.filter.settings, &plan.filter.blocks, &made.initial).unwrap();
    let mut squares = [0.0; 9];
    for k in 0..plan.rows {
        let row = |triad: usize| Vector3::from(made.increments[triad][k]);
        ekf.predict(plan.t_ns[k + 1], &row(0), &row(1)).unwrap();
        if let Some(feed) = plan.feed.iter().find(|f| f.t_ns == plan.t_ns[k + 1]) {
            ekf.update(0, &plan.observation(feed, &made.aids)).unwrap();
        }
        if let Some(epoch) = plan.epochs.iter().find(|e| e.row == k + 1) {
            let errors = plan.errors(&ekf.solution(), &epoch.truth);
            for (sum, e) in squares.iter_mut().zip(errors.iter().flat_map(|v| v.iter())) {
                *sum += e * e;
            }
        }
    }
    let sums = set(Mode::Full).sums(run..run + 1).unwrap();
    assert_eq!(sums.runs, [squares]);
    assert_eq!(sums.count, SECONDS as u64);
    assert_eq!(sums.counts[1].total, plan.feed.len() as u64);
}

#[test]
fn without_errors_shared_and_full_runs_are_one() {
    // GIVEN perfect sensors and no errors at the start, THEN both modes stay on the truth and claim the same
    let mut exact = plan();
    exact.imu = exact.imu.without_errors();
    exact.truths = vec![None; 6];
    exact.groups = vec![(0..9).collect()];
    exact.aids.gnss.sd.iter_mut().for_each(|sd| *sd = sd.map(|s| 1e-6 * s));
    let [sd_phi, sd_v, sd_p] = [1e-9, 1e-7, 1e-6].map(Vector3::repeat);
    exact.initial = Initial { sd_phi, sd_v, sd_p, ..exact.initial };
    let sums = |mode| MonteCarlo::<Ned, 16>::new(exact.clone(), mode).unwrap().sums(0..1).unwrap();
    let (full, shared) = (sums(Mode::Full), sums(Mode::Shared));
    for (a, b) in full.variances.as_flattened().iter().zip(shared.variances.as_flattened()) {
        assert!((a / b - 1.0).abs() < 1e-6, "{a} {b}");
    }
    assert_eq!(full.counts, shared.counts);
    for (a, b) in full.runs[0].iter().zip(&shared.runs[0]) {
        assert!((a.sqrt() - b.sqrt()).abs() < 1e-3 * a.sqrt() + 1e-8, "{a} {b}");
    }
}

#[test]
fn shared_runs_follow_full_runs_while_errors_are_small_and_leave_them_when_they_are_not() {
    let distance = |heading_sd: f64| {
        let mut plan = plan();
        plan.initial.sd_phi = Vector3::new(2e-3, 2e-3, heading_sd);
        let sums = |mode| MonteCarlo::<Ned, 16>::new(plan.clone(), mode).unwrap().sums(0..40).unwrap();
        let (full, shared) = (sums(Mode::Full), sums(Mode::Shared));
        let total = |sums: &Sums| sums.runs.iter().map(|r| r[3] + r[4]).sum::<f64>().sqrt();
        total(&shared) / total(&full) - 1.0
    };
    // one per cent in velocity while a heading error of 0.1 deg stays second order; more when it is a radian
    assert!(distance(2e-3).abs() < 0.01, "{}", distance(2e-3));
    assert!(distance(1.0).abs() > 0.1, "{}", distance(1.0));
}
