//! Shared by the integration tests: seeded numbers, block lists, a short flight, dense algebra.
// Each test file is its own crate and uses its own part of this one.
#![allow(dead_code)]

pub mod equations;
pub mod linearised;

use gnssins::attitude;
use gnssins::blocks::{BLOCK_MAX, Block, BlockKind, Process};
use gnssins::bytes::{Reader, Writer};
use gnssins::cov::Covariance;
use gnssins::discretise::{BlockStep, ImuNoise, Order, Transition};
use gnssins::ekf::{Ekf, Initial, Settings};
use gnssins::error::Error;
use gnssins::frames::Lla;
use gnssins::imu::{Coning, ImuDelta};
use gnssins::inverse::FreeIns;
use gnssins::layout::Layout;
use gnssins::meas::Record;
use gnssins::meas::gnss::GnssFix;
use gnssins::nav::{Dynamics, EarthModel, NavModel, Solution};
use gnssins::small::Square;
use gnssins::stream::{Event, Sink};
use nalgebra::{DMatrix, DVector, Matrix3, UnitQuaternion, Vector3};

pub const DEG: f64 = std::f64::consts::PI / 180.0;
/// Interval of the flights, ns: 100 Hz.
pub const DT_NS: i64 = 10_000_000;

/// SplitMix64 (Steele, Lea and Flood 2014): the same numbers on every machine.
#[derive(Clone)]
pub struct Rng(pub u64);

impl Rng {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [-1, 1).
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n as u64) as usize
    }

    /// Normal by the sum of twelve uniforms: good to three sigma, which is all that is asked of it.
    pub fn normal(&mut self) -> f64 {
        0.5 * (0..12).map(|_| self.unit()).sum::<f64>()
    }

    pub fn vector(&mut self, sd: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| sd * self.normal())
    }
}

pub const fn block(kind: BlockKind, process: Process, sd: f64) -> Block {
    Block::isotropic(kind, process, sd)
}

pub const fn walk(psd: f64) -> Process {
    Process::RandomWalk { psd: [psd; BLOCK_MAX] }
}

pub const fn markov(sd: f64, tau_s: f64) -> Process {
    Process::GaussMarkov { sd: [sd; BLOCK_MAX], tau_s: [tau_s; BLOCK_MAX] }
}

/// Block lists of 15, 18, 21, 22 and 36 states; 36 has every inertial block and the lever arm.
pub fn blocks(states: usize) -> Vec<Block> {
    use BlockKind::*;
    let gyro = block(GyroBias, walk(1e-14), 1e-4);
    let accel = block(AccelBias, markov(0.02, 300.0), 0.02);
    let scale = [block(GyroScale, Process::Constant, 1e-3), block(AccelScale, markov(2e-3, 50.0), 2e-3)];
    let mut list = vec![gyro, accel];
    match states {
        15 => {}
        18 => list.insert(1, block(GyroBias, markov(2e-5, 100.0), 2e-5)),
        21 => list.extend(scale),
        22 => {
            list.extend([scale[0], block(GnssLeverArm, Process::Constant, 0.1)]);
            list.push(block(BaroBias, markov(3.0, 600.0), 3.0));
        }
        36 => {
            list.extend(scale);
            list.push(block(GyroMisalignment, Process::Constant, 1e-3));
            list.push(block(AccelMisalignment, walk(1e-10), 1e-3));
            list.push(block(GnssLeverArm, Process::Constant, 0.1));
        }
        _ => panic!("no list of {states} states"),
    }
    assert_eq!(9 + list.iter().map(|b| b.kind.len()).sum::<usize>(), states);
    list
}

pub fn settings() -> Settings {
    let noise = ImuNoise { gyro_psd: Vector3::repeat(1e-9), accel_psd: Vector3::repeat(1e-6) };
    Settings { gate_probability: [None; 3], ..Settings::new(noise) }
}

pub fn solution(lla: [f64; 3], v_n: [f64; 3], euler_deg: [f64; 3]) -> Solution {
    let [r, p, h] = euler_deg.map(f64::to_radians);
    Solution {
        position: Lla::new(lla[0].to_radians(), lla[1].to_radians(), lla[2]),
        v_n: v_n.into(),
        q_nb: attitude::from_euler(r, p, h),
    }
}

pub fn initial(solution: Solution) -> Initial {
    Initial {
        t_ns: 0,
        solution,
        sd_phi: Vector3::repeat(0.01),
        sd_v: Vector3::repeat(0.1),
        sd_p: Vector3::repeat(1.0),
    }
}

pub fn filter<M: NavModel, const CAP: usize>(states: usize, start: Solution) -> Ekf<M, CAP> {
    Ekf::new(&settings(), &blocks(states), &initial(start)).unwrap()
}

pub fn transition<const CAP: usize>(
    dynamics: &Dynamics,
    layout: &Layout<CAP>,
    noise: &ImuNoise,
    w_b: &Vector3<f64>,
    f_b: &Vector3<f64>,
    dt_s: f64,
    order: Order,
) -> Transition<CAP> {
    Transition::new(dynamics, layout, noise, w_b, f_b, &BlockStep::new(layout, dt_s, 0.0), order)
}

/// One interval of a flight: its end, its true increments and the truth there.
#[derive(Clone, Copy)]
pub struct Leg {
    pub t_ns: i64,
    pub delta: ImuDelta,
    pub truth: Solution,
}

/// How the body moves: velocity (m/s, NED) and Euler angles (rad) as functions of time (s).
pub type Motion = fn(f64) -> (Vector3<f64>, [f64; 3]);

/// Turns, climbs and speed changes between 20 and 40 m/s, banked.
pub fn weaving(t: f64) -> (Vector3<f64>, [f64; 3]) {
    let heading = 0.7 + 0.9 * (0.25 * t).sin();
    let pitch = 0.1 * (0.4 * t).sin();
    let speed = 30.0 + 10.0 * (0.2 * t).sin();
    let (s, c) = heading.sin_cos();
    let v = speed * Vector3::new(pitch.cos() * c, pitch.cos() * s, -pitch.sin());
    (v, [0.6 * (0.25 * t).cos(), pitch, heading])
}

/// At rest, nose 30 degrees east of north, slightly tilted.
pub fn resting(_t: f64) -> (Vector3<f64>, [f64; 3]) {
    (Vector3::zeros(), [0.02, -0.03, 0.5])
}

/// At rest but turning about the vertical at 0.5 rad/s, rocking in roll and pitch.
pub fn turning(t: f64) -> (Vector3<f64>, [f64; 3]) {
    (Vector3::zeros(), [0.4 * (0.7 * t).sin(), 0.3 * (0.9 * t).cos(), 0.5 * t])
}

/// Exact increments of a motion from a place (deg, deg, m); the truth is what the step makes of them.
pub fn fly<M: NavModel>(motion: Motion, place: [f64; 3], legs: usize, dt_ns: i64) -> (Solution, Vec<Leg>) {
    let at = |t: f64| {
        let (v, [r, p, h]) = motion(t);
        (v, attitude::from_euler(r, p, h))
    };
    let (v_n, q_nb) = at(0.0);
    let position = Lla::new(place[0].to_radians(), place[1].to_radians(), place[2]);
    let start = Solution { position, v_n, q_nb };
    let mut ins = FreeIns::new(M::new(EarthModel::default(), &start).unwrap(), Coning::TwoSample);
    let dt_s = dt_ns as f64 / 1e9;
    let legs = (1..=legs as i64)
        .map(|k| {
            let (v, q) = at(k as f64 * dt_s);
            let delta = ins.step_to(dt_s, &v, &q).unwrap();
            Leg { t_ns: k * dt_ns, delta, truth: ins.model().solution() }
        })
        .collect();
    (start, legs)
}

/// A fix with position and velocity and independent noise.
pub fn fix(t_ns: i64, truth: &Solution, sd_p: f64, sd_v: f64) -> GnssFix {
    let covariance = diagonal([sd_p, sd_p, sd_p, sd_v, sd_v, sd_v]);
    GnssFix {
        t_ns,
        position: Some(truth.position),
        velocity_n: [0, 1, 2].map(|i| Some(truth.v_n[i])),
        covariance,
        new_constellation: false,
    }
}

pub fn diagonal(sd: [f64; 6]) -> Square {
    std::array::from_fn(|i| std::array::from_fn(|j| if i == j { sd[i] * sd[i] } else { 0.0 }))
}

/// Position and velocity of a point at `lever_b`, by way of ECEF.
pub fn antenna(truth: &Solution, lever_b: &Vector3<f64>, w_ib_b: &Vector3<f64>) -> (Lla, Vector3<f64>) {
    use gnssins::frames::{Ecef, c_ne, ecef_to_lla, lla_to_ecef};
    let ell = EarthModel::default().ellipsoid;
    let c_ne = c_ne(truth.position.lat_rad, truth.position.lon_rad);
    let c_eb = c_ne.transpose() * attitude::dcm(&truth.q_nb);
    let w_ie = Vector3::new(0.0, 0.0, ell.omega_rad_s);
    let arm = c_eb * lever_b;
    let r = lla_to_ecef(&ell, &truth.position).0 + arm;
    let v = c_ne.transpose() * truth.v_n + c_eb * w_ib_b.cross(lever_b) - w_ie.cross(&arm);
    (ecef_to_lla(&ell, &Ecef(r)), c_ne * v)
}

/// Estimate minus truth: rotation vector, velocity and metres along north, east, down.
pub fn error(estimate: &Solution, truth: &Solution) -> [Vector3<f64>; 3] {
    let ell = EarthModel::default().ellipsoid;
    let (p, z) = (&estimate.position, &truth.position);
    let radii = ell.radii(z.lat_rad.sin());
    let phi = attitude::log(&(truth.q_nb * estimate.q_nb.inverse()));
    let dp = Vector3::new(
        (p.lat_rad - z.lat_rad) * (radii.meridian_m + z.height_m),
        gnssins::frames::wrap_pi(p.lon_rad - z.lon_rad)
            * (radii.prime_vertical_m + z.height_m)
            * z.lat_rad.cos(),
        z.height_m - p.height_m,
    );
    [phi, estimate.v_n - truth.v_n, dp]
}

/// Everything that a stream reported.
#[derive(Default, Clone)]
pub struct Log {
    pub events: Vec<Event>,
    pub records: Vec<Record>,
}

impl Sink for Log {
    fn event(&mut self, event: &Event) {
        self.events.push(*event);
    }
    fn record(&mut self, record: &Record) {
        self.records.push(*record);
    }
}

/// Saved state of a filter.
pub fn bytes<M: NavModel, const CAP: usize>(ekf: &Ekf<M, CAP>) -> Vec<u8> {
    let mut buffer = vec![0; ekf.saved_len()];
    ekf.save(&mut Writer::new(&mut buffer)).unwrap();
    buffer
}

pub fn restore<M: NavModel, const CAP: usize>(ekf: &mut Ekf<M, CAP>, bytes: &[u8]) -> Result<(), Error> {
    ekf.restore(&mut Reader::new(bytes))
}

/// The states in use of a covariance, dense.
pub fn dense<const CAP: usize>(cov: &Covariance<CAP>) -> DMatrix<f64> {
    DMatrix::from_fn(cov.len(), cov.len(), |i, j| cov.get(i, j))
}

/// Phi and Q of a transition, dense.
pub fn dense_transition<const CAP: usize>(t: &Transition<CAP>, n: usize) -> (DMatrix<f64>, DMatrix<f64>) {
    let phi = DMatrix::from_fn(n, n, |i, j| match (i, j) {
        (i, j) if i < 9 => t.top(i, j),
        (i, j) if i == j => t.blocks.diagonal[i],
        _ => 0.0,
    });
    let mut q = DMatrix::from_fn(n, n, |i, j| if i == j { t.blocks.q[i] } else { 0.0 });
    let (q_phi, q_dv): (&Matrix3<f64>, &Matrix3<f64>) = (&t.q_phi, &t.q_dv);
    q.view_mut((0, 0), (3, 3)).copy_from(q_phi);
    q.view_mut((3, 3), (3, 3)).copy_from(q_dv);
    (phi, q)
}

/// exp(A) by scaling and squaring of the Taylor series (18 terms at norm below 1/2: rounding).
pub fn expm(a: &DMatrix<f64>) -> DMatrix<f64> {
    let norm = a.abs().row_sum().max() * a.nrows() as f64;
    let halvings = (norm.log2().ceil() as i32 + 1).max(0);
    let small = a / 2f64.powi(halvings);
    let mut term = DMatrix::identity(a.nrows(), a.nrows());
    let mut sum = term.clone();
    for k in 1..=18 {
        term = &term * &small / f64::from(k);
        sum += &term;
    }
    (0..halvings).fold(sum, |e, _| &e * &e)
}

/// Largest |a - b| of matrices, each element against sqrt(scale_ii scale_jj).
pub fn distance(a: &DMatrix<f64>, b: &DMatrix<f64>, scale: &DVector<f64>) -> f64 {
    let mut worst = 0.0f64;
    for i in 0..a.nrows() {
        for j in 0..a.ncols() {
            let d = (a[(i, j)] - b[(i, j)]).abs() / (scale[i] * scale[j]).sqrt();
            worst = worst.max(if d.is_nan() { f64::INFINITY } else { d });
        }
    }
    worst
}

pub fn quaternion(w: f64, x: f64, y: f64, z: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(w, x, y, z))
}
