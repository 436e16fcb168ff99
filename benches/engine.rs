//! Speed of the engine's parts and of a whole step, each covariance step beside a dense nalgebra one.
//!
//! `cargo bench` runs everything in about half a minute; `cargo bench -- covariance` a part. Names end in the number of
//! states. `dense` is `Phi (P + Q/2) Phi' + Q/2` with `SMatrix` of exactly that size, and for updates the Joseph form of all
//! six rows at once, without the gate, the feedback and the check of P that the whole update has.

#[path = "../tests/common/mod.rs"]
mod common;

use std::hint::black_box;
use std::time::Duration;

use common::{DT_NS, blocks, fix, fly, initial, settings};
use criterion::Criterion;
use gnssins::discretise::{BlockStep, Transition};
use gnssins::ekf::Ekf;
use gnssins::imu::{ImuDelta, Strap};
use gnssins::layout::Layout;
use gnssins::meas::Status;
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::Ned;
use gnssins::nav::{NavModel, Solution};
use nalgebra::{SMatrix, Vector3};

const PLACE: [f64; 3] = [47.0, 8.0, 500.0];

/// A body at rest: its increments repeat for ever without the state running away.
fn at_rest<M: NavModel>() -> (Solution, ImuDelta) {
    let (start, legs) = fly::<M>(common::resting, PLACE, 2, DT_NS);
    (start, legs[1].delta)
}

fn filter<M: NavModel, const CAP: usize>(states: usize) -> (Ekf<M, CAP>, ImuDelta) {
    let (start, delta) = at_rest::<M>();
    (Ekf::new(&settings(), &blocks(states), &initial(start)).unwrap(), delta)
}

fn strapdown<M: NavModel>(c: &mut Criterion) {
    let (start, delta) = at_rest::<M>();
    let mut model = M::new(settings().earth, &start).unwrap();
    let strap = Strap::from_increments(&delta, Some(&delta));
    c.bench_function(&format!("strapdown/{}", M::NAME), |b| {
        b.iter(|| black_box(model.step(black_box(&strap)).unwrap()));
    });
}

/// Transition of one interval at the start of a filter.
fn one_transition<const CAP: usize>(states: usize) -> (Layout<CAP>, Transition<CAP>) {
    let (start, delta) = at_rest::<Ned>();
    let mut model = Ned::new(settings().earth, &start).unwrap();
    let dynamics = model.step(&Strap::from_increments(&delta, None)).unwrap();
    let layout = Layout::<CAP>::new(&blocks(states)).unwrap();
    let (w, f) = (delta.dtheta / delta.dt_s, delta.dvel / delta.dt_s);
    let noise = settings().noise;
    let t = common::transition(&dynamics, &layout, &noise, &w, &f, delta.dt_s, settings().order);
    (layout, t)
}

fn transition<const CAP: usize>(c: &mut Criterion, states: usize) {
    let (start, delta) = at_rest::<Ned>();
    let mut model = Ned::new(settings().earth, &start).unwrap();
    let dynamics = model.step(&Strap::from_increments(&delta, None)).unwrap();
    let layout = Layout::<CAP>::new(&blocks(states)).unwrap();
    let (w, f) = (delta.dtheta / delta.dt_s, delta.dvel / delta.dt_s);
    let (set, step) = (settings(), BlockStep::new(&layout, delta.dt_s, 0.0));
    c.bench_function(&format!("transition/{states}"), |b| {
        b.iter(|| {
            let d = black_box(&dynamics);
            black_box(Transition::new(d, &layout, &set.noise, &w, &f, &step, set.order))
        });
    });
}

/// Phi and Q as full matrices of the exact size.
fn dense<const CAP: usize, const N: usize>(t: &Transition<CAP>) -> (SMatrix<f64, N, N>, SMatrix<f64, N, N>) {
    let (phi, q) = common::dense_transition(t, N);
    (SMatrix::from_column_slice(phi.as_slice()), SMatrix::from_column_slice(q.as_slice()))
}

fn dense_step<const N: usize>(phi: &SMatrix<f64, N, N>, q: &SMatrix<f64, N, N>, p: &mut SMatrix<f64, N, N>) {
    *p += q * 0.5;
    *p = phi * *p * phi.transpose() + q * 0.5;
}

fn covariance<const CAP: usize, const N: usize>(c: &mut Criterion) {
    let (_, t) = one_transition::<CAP>(N);
    let (phi, q) = dense::<CAP, N>(&t);
    let mut cov = *filter::<Ned, CAP>(N).0.covariance();
    let mut p = SMatrix::<f64, N, N>::from_fn(|i, j| cov.get(i, j));
    c.bench_function(&format!("covariance/block/{N}"), |b| b.iter(|| cov.predict(black_box(&t))));
    c.bench_function(&format!("covariance/dense/{N}"), |b| {
        b.iter(|| dense_step(black_box(&phi), black_box(&q), &mut p));
    });
    black_box((cov, p));
}

fn predict<M: NavModel, const CAP: usize, const N: usize>(c: &mut Criterion) {
    let (mut ekf, delta) = filter::<M, CAP>(N);
    let fresh = ekf.clone();
    c.bench_function(&format!("predict/{}/{N}", M::NAME), |b| {
        b.iter(|| {
            // coasting has a limit: from time to time back to the start
            if ekf.t_ns() > 100_000 * DT_NS {
                ekf.clone_from(&fresh);
            }
            ekf.predict(ekf.t_ns() + DT_NS, black_box(&delta.dtheta), black_box(&delta.dvel)).unwrap();
        });
    });
    // the same strapdown and transition, with the product of full matrices
    let (start, delta) = at_rest::<M>();
    let mut model = M::new(settings().earth, &start).unwrap();
    let layout = Layout::<CAP>::new(&blocks(N)).unwrap();
    let (set, step) = (settings(), BlockStep::new(&layout, delta.dt_s, 0.0));
    let (w, f) = (delta.dtheta / delta.dt_s, delta.dvel / delta.dt_s);
    let mut p = SMatrix::<f64, N, N>::identity();
    c.bench_function(&format!("predict/{}-dense/{N}", M::NAME), |b| {
        b.iter(|| {
            let strap = Strap::from_increments(black_box(&delta), Some(&delta));
            let dynamics = model.step(&strap).unwrap();
            let t = Transition::new(&dynamics, &layout, &set.noise, &w, &f, &step, set.order);
            let mut phi = SMatrix::<f64, N, N>::zeros();
            let mut q = SMatrix::<f64, N, N>::zeros();
            for i in 0..N {
                (phi[(i, i)], q[(i, i)]) = (t.blocks.diagonal[i], t.blocks.q[i]);
            }
            for (i, j) in (0..9).flat_map(|i| (0..N).map(move |j| (i, j))) {
                phi[(i, j)] = t.top(i, j);
            }
            q.fixed_view_mut::<3, 3>(0, 0).copy_from(&t.q_phi);
            q.fixed_view_mut::<3, 3>(3, 3).copy_from(&t.q_dv);
            dense_step(&phi, &q, &mut p);
        });
    });
}

fn update<const CAP: usize, const N: usize>(c: &mut Criterion) {
    let (mut ekf, delta) = filter::<Ned, CAP>(N);
    for k in 1..=100 {
        ekf.predict(k * DT_NS, &delta.dtheta, &delta.dvel).unwrap();
    }
    let mut z = fix(ekf.t_ns(), &ekf.solution(), 1.0, 0.1);
    (z.covariance[0][1], z.covariance[1][0]) = (0.3, 0.3);
    let p0 = SMatrix::<f64, N, N>::from_fn(|i, j| ekf.covariance().get(i, j));
    c.bench_function(&format!("update/sequential/{N}"), |b| {
        b.iter(|| assert_eq!(ekf.update(0, black_box(&z)).unwrap().status, Status::Used));
    });
    let mut h = SMatrix::<f64, 6, N>::zeros();
    let aid = ekf.model().position_aid(&Vector3::zeros(), &ekf.solution().position);
    h.fixed_view_mut::<3, 9>(0, 0).copy_from(&aid.h);
    h.fixed_view_mut::<3, 3>(3, 3).fill_with_identity();
    let r = SMatrix::<f64, 6, 6>::from_fn(|i, j| z.covariance[i][j]);
    c.bench_function(&format!("update/dense/{N}"), |b| {
        b.iter(|| {
            let (p, h) = (black_box(&p0), black_box(&h));
            let ph = p * h.transpose();
            let k = ph * (h * ph + r).try_inverse().unwrap();
            let a = SMatrix::<f64, N, N>::identity() - k * h;
            black_box(a * p * a.transpose() + k * r * k.transpose())
        });
    });
}

fn main() {
    let mut c = Criterion::default()
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(600))
        .sample_size(30)
        .configure_from_args();
    strapdown::<Ned>(&mut c);
    strapdown::<Ecef>(&mut c);
    transition::<16>(&mut c, 15);
    transition::<24>(&mut c, 18);
    transition::<24>(&mut c, 21);
    transition::<40>(&mut c, 36);
    covariance::<16, 15>(&mut c);
    covariance::<24, 18>(&mut c);
    covariance::<24, 21>(&mut c);
    covariance::<40, 36>(&mut c);
    predict::<Ned, 16, 15>(&mut c);
    predict::<Ned, 24, 18>(&mut c);
    predict::<Ned, 24, 21>(&mut c);
    predict::<Ned, 40, 36>(&mut c);
    predict::<Ecef, 24, 18>(&mut c);
    update::<24, 18>(&mut c);
    update::<24, 21>(&mut c);
    c.final_summary();
}
