//! What is measured, for the clock (`engine.rs`) and for the counter of instructions (`counts.rs`).

#[path = "../../tests/common/mod.rs"]
pub mod common;
mod dense;

use std::hint::black_box;

use common::{DT_NS, blocks, fix, fly, initial, settings};
use gnssins::discretise::{BlockStep, Transition};
use gnssins::ekf::Ekf;
use gnssins::imu::{ImuDelta, Strap};
use gnssins::layout::Layout;
use gnssins::meas::Status;
use gnssins::meas::gnss::GnssFix;
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::Ned;
use gnssins::nav::{Dynamics, NavModel, Solution};
use gnssins::simd::Isa;
use gnssins::stream::{Navigator, StreamSettings};

/// The variant that nalgebra computes with whole matrices.
const DENSE: &str = "dense";
/// The variant of what has one only.
const ONLY: &str = "engine";

/// Takes the cases one by one: part, variant, number of states, and the work of one step or update.
pub trait Visitor {
    /// Measures one case.
    fn case(&mut self, part: &str, variant: &str, states: usize, work: &mut dyn FnMut());
}

/// Shows all cases.
pub fn visit(v: &mut impl Visitor) {
    strapdown::<Ned>(v);
    strapdown::<Ecef>(v);
    sized::<16, 15>(v);
    sized::<24, 18>(v);
    sized::<24, 21>(v);
    sized::<24, 22>(v);
    sized::<40, 36>(v);
    step::<Ecef, 24, 21>(v, "step-ecef");
    row::<24, 18>(v);
}

fn sized<const CAP: usize, const N: usize>(v: &mut impl Visitor) {
    transition::<CAP, N>(v);
    covariance::<CAP, N>(v);
    step::<Ned, CAP, N>(v, "step");
    update::<CAP, N>(v, "update-6", 6);
    update::<CAP, N>(v, "update-3", 3);
}

/// The sets of instructions of this machine, with their names.
fn isas() -> impl Iterator<Item = (Isa, &'static str)> {
    [(Isa::Portable, "portable"), (Isa::Avx2, "avx2"), (Isa::Avx512, "avx512")]
        .into_iter()
        .filter(|(isa, _)| isa.available() == *isa)
}

/// A body at rest: its increments repeat for ever without the state running away.
fn at_rest<M: NavModel>() -> (Solution, ImuDelta) {
    let (start, legs) = fly::<M>(common::resting, [47.0, 8.0, 500.0], 2, DT_NS);
    (start, legs[1].delta)
}

fn filter<M: NavModel, const CAP: usize>(states: usize, isa: Isa) -> (Ekf<M, CAP>, ImuDelta) {
    let (start, delta) = at_rest::<M>();
    let mut ekf = Ekf::new(&settings(), &blocks(states), &initial(start)).unwrap();
    ekf.set_isa(isa);
    (ekf, delta)
}

/// A model and what its transitions need.
struct Discretiser<M, const CAP: usize> {
    model: M,
    delta: ImuDelta,
    layout: Layout<CAP>,
    step: BlockStep<CAP>,
}

impl<M: NavModel, const CAP: usize> Discretiser<M, CAP> {
    fn new(states: usize) -> Self {
        let (start, delta) = at_rest::<M>();
        let layout = Layout::new(&blocks(states)).unwrap();
        let step = BlockStep::new(&layout, delta.dt_s, 0.0);
        Self { model: M::new(settings().earth, &start).unwrap(), delta, layout, step }
    }

    fn dynamics(&mut self) -> Dynamics {
        let strap = Strap::from_increments(black_box(&self.delta), Some(&self.delta));
        self.model.step(&strap).unwrap()
    }

    fn transition(&self, dynamics: &Dynamics) -> Transition<CAP> {
        let (w, f) = (self.delta.dtheta / self.delta.dt_s, self.delta.dvel / self.delta.dt_s);
        let set = settings();
        Transition::new(dynamics, &self.layout, &set.noise, &w, &f, &self.step, set.order)
    }
}

fn strapdown<M: NavModel>(v: &mut impl Visitor) {
    let mut parts = Discretiser::<M, 16>::new(15);
    v.case("strapdown", M::NAME, 9, &mut || {
        black_box(parts.dynamics());
    });
}

fn transition<const CAP: usize, const N: usize>(v: &mut impl Visitor) {
    let mut parts = Discretiser::<Ned, CAP>::new(N);
    let dynamics = parts.dynamics();
    v.case("transition", "portable", N, &mut || {
        black_box(parts.transition(black_box(&dynamics)));
    });
    let f = dense::system::<CAP, N>(&parts.transition(&dynamics), parts.delta.dt_s);
    v.case("transition", DENSE, N, &mut || {
        black_box(dense::series(black_box(&f), parts.delta.dt_s));
    });
}

fn covariance<const CAP: usize, const N: usize>(v: &mut impl Visitor) {
    let mut parts = Discretiser::<Ned, CAP>::new(N);
    let dynamics = parts.dynamics();
    let t = parts.transition(&dynamics);
    let start = *filter::<Ned, CAP>(N, Isa::Portable).0.covariance();
    for (isa, name) in isas() {
        let mut cov = start;
        v.case("covariance", name, N, &mut || cov.predict_on(isa, black_box(&t)));
    }
    let (phi, q) = dense::matrices::<CAP, N>(&t);
    let mut p = dense::covariance(&start);
    v.case("covariance", DENSE, N, &mut || dense::predict(black_box(&phi), black_box(&q), &mut p));
}

fn step<M: NavModel, const CAP: usize, const N: usize>(v: &mut impl Visitor, part: &str) {
    for (isa, name) in isas() {
        let (mut ekf, delta) = filter::<M, CAP>(N, isa);
        let fresh = ekf.clone();
        v.case(part, name, N, &mut || {
            // coasting has a limit: from time to time back to the start
            if ekf.t_ns() > 100_000 * DT_NS {
                ekf.clone_from(&fresh);
            }
            ekf.predict(ekf.t_ns() + DT_NS, black_box(&delta.dtheta), black_box(&delta.dvel)).unwrap();
        });
    }
    // the same strapdown and transition, with the product of full matrices
    let mut parts = Discretiser::<M, CAP>::new(N);
    let mut p = dense::covariance::<CAP, N>(filter::<M, CAP>(N, Isa::Portable).0.covariance());
    v.case(part, DENSE, N, &mut || {
        let dynamics = parts.dynamics();
        let (phi, q) = dense::matrices(&parts.transition(&dynamics));
        dense::predict(&phi, &q, &mut p);
    });
}

/// A filter after a second, and a fix there whose components north and east are correlated.
fn before_update<const CAP: usize>(states: usize, isa: Isa, rows: usize) -> (Ekf<Ned, CAP>, GnssFix) {
    let (mut ekf, delta) = filter::<Ned, CAP>(states, isa);
    for k in 1..=100 {
        ekf.predict(k * DT_NS, &delta.dtheta, &delta.dvel).unwrap();
    }
    let mut z = fix(ekf.t_ns(), &ekf.solution(), 1.0, 0.1);
    (z.covariance[0][1], z.covariance[1][0]) = (0.3, 0.3);
    if rows == 3 {
        z.velocity_n = [None; 3];
    }
    (ekf, z)
}

fn update<const CAP: usize, const N: usize>(v: &mut impl Visitor, part: &str, rows: usize) {
    for (isa, name) in isas() {
        let (mut ekf, z) = before_update::<CAP>(N, isa, rows);
        let (fresh, mut left) = (ekf.clone(), 0);
        v.case(part, name, N, &mut || {
            // the covariance shrinks with every update: from time to time back to the start
            if left == 0 {
                ekf.clone_from(&fresh);
                left = 1000;
            }
            left -= 1;
            assert_eq!(ekf.update(0, black_box(&z)).unwrap().status, Status::Used);
        });
    }
    let (ekf, z) = before_update::<CAP>(N, Isa::Portable, rows);
    if rows == 3 {
        dense_update::<CAP, N, 3>(v, part, &ekf, &z);
    } else {
        dense_update::<CAP, N, 6>(v, part, &ekf, &z);
    }
}

fn dense_update<const CAP: usize, const N: usize, const R: usize>(
    v: &mut impl Visitor,
    part: &str,
    ekf: &Ekf<Ned, CAP>,
    z: &GnssFix,
) {
    let p = dense::covariance::<CAP, N>(ekf.covariance());
    let (h, r) = dense::measurement::<CAP, N, R>(ekf, z);
    v.case(part, DENSE, N, &mut || {
        black_box(dense::update(black_box(&p), black_box(&h), &r));
    });
}

/// One row of the IMU through the stream, a fix with every hundredth: what a run costs per row when Rust feeds it.
fn row<const CAP: usize, const N: usize>(v: &mut impl Visitor) {
    let (ekf, delta) = filter::<Ned, CAP>(N, Isa::detect());
    let truth = ekf.solution();
    let (gyro, accel) = (delta.dtheta / delta.dt_s, delta.dvel / delta.dt_s);
    let mut stream = Navigator::new(ekf, StreamSettings::default());
    let mut k = 0;
    v.case("row", ONLY, N, &mut || {
        k += 1;
        stream.imu(k * DT_NS, black_box(&gyro), black_box(&accel), &mut ()).unwrap();
        if k % 100 == 0 {
            stream.gnss(&fix(k * DT_NS, &truth, 1.0, 0.1), &mut ()).unwrap();
        }
    });
}
