//! Transition matrix and process noise against dense series, the matrix exponential and Van Loan's integral.

mod common;

use common::linearised::{CAP, F_B, ORDERS, W_B, dynamics, noise, real_transition};
use common::{block, blocks, dense, dense_transition, expm, markov, walk};
use gnssins::blocks::{Block, BlockKind, Process};
use gnssins::cov::Covariance;
use gnssins::discretise::Order;
use gnssins::layout::Layout;
use nalgebra::{DMatrix, Matrix3, Vector3};

/// The whole system matrix of nine errors and blocks, with the decays on its diagonal.
fn system_matrix(blocks: &[Block], states: usize) -> DMatrix<f64> {
    let d = dynamics();
    let mut f = DMatrix::zeros(states, states);
    f.view_mut((0, 0), (9, 9)).copy_from(&d.f());
    let (mut j, pairs) = (9, [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)]);
    for block in blocks {
        for i in 0..block.kind.len() {
            use BlockKind::*;
            let (gyro, axis, factor) = match block.kind {
                GyroBias => (true, i, 1.0),
                AccelBias => (false, i, 1.0),
                GyroScale => (true, i, W_B[i]),
                AccelScale => (false, i, F_B[i]),
                GyroMisalignment => (true, pairs[i].0, W_B[pairs[i].1]),
                AccelMisalignment => (false, pairs[i].0, F_B[pairs[i].1]),
                _ => (true, 0, 0.0),
            };
            let start = if gyro { 0 } else { 3 };
            let column = if gyro { -d.c.column(axis) } else { d.c.column(axis).into_owned() };
            f.view_mut((start, j), (3, 1)).copy_from(&(column * factor));
            if let Process::GaussMarkov { tau_s, .. } = block.process {
                f[(j, j)] = -1.0 / tau_s[i];
            }
            j += 1;
        }
    }
    f
}

/// Largest departure of the velocity rows of Phi from exp(F dt).
fn phi_error(blocks: &[Block], states: usize, dt: f64, order: Order) -> f64 {
    let layout = Layout::<CAP>::new(blocks).unwrap();
    let (phi, _) = dense_transition(&real_transition(&layout, dt, order), states);
    (phi - expm(&(system_matrix(blocks, states) * dt))).rows(3, 3).amax()
}

#[test]
fn phi_approaches_the_matrix_exponential_with_its_order() {
    // short correlation times, so that the decay takes part
    let blocks = [
        block(BlockKind::GyroBias, markov(1e-4, 0.7), 1e-4),
        block(BlockKind::AccelScale, markov(1e-3, 0.5), 1e-3),
        block(BlockKind::GyroMisalignment, walk(1e-10), 1e-3),
    ];
    for (k, order) in ORDERS.into_iter().enumerate() {
        let (coarse, fine) = (phi_error(&blocks, 21, 0.02, order), phi_error(&blocks, 21, 0.01, order));
        let ratio = 2f64.powi(k as i32 + 2);
        assert!((0.95 * ratio..1.05 * ratio).contains(&(coarse / fine)), "{order:?}: {coarse:e} {fine:e}");
        assert!(fine < [2e-3, 1e-5, 5e-8][k], "{order:?}: {fine:e}");
    }
}

#[test]
fn phi_is_the_series_of_the_whole_system_matrix_term_by_term() {
    for states in [15, 18, 21, 36] {
        let blocks = blocks(states);
        let layout = Layout::<CAP>::new(&blocks).unwrap();
        let dt = 0.02;
        let fd = system_matrix(&blocks, states) * dt;
        let (mut series, mut term) = (DMatrix::identity(states, states), DMatrix::identity(states, states));
        for (k, order) in ORDERS.into_iter().enumerate() {
            term = &term * &fd / (k + 1) as f64;
            series += &term;
            let (phi, _) = dense_transition(&real_transition(&layout, dt, order), states);
            for i in 0..9 {
                let row = series.row(i).amax();
                for j in 0..states {
                    let d = (phi[(i, j)] - series[(i, j)]).abs();
                    assert!(
                        d <= 1e-15 * row + 1e-13 * series[(i, j)].abs(),
                        "{states} {order:?} ({i}, {j}): {d:e}"
                    );
                }
            }
            // the blocks are exact at any order
            for j in 9..states {
                assert!((phi[(j, j)] - fd[(j, j)].exp()).abs() < 1e-15);
            }
        }
    }
}

#[test]
fn two_short_transitions_make_one_long_one_for_constant_dynamics() {
    let blocks = blocks(21);
    let layout = Layout::<CAP>::new(&blocks).unwrap();
    let phi = |dt| dense_transition(&real_transition(&layout, dt, Order::Third), 21).0;
    let off = |s: f64| {
        let (a, b) = (0.02 * s, 0.03 * s);
        (phi(a + b) - phi(b) * phi(a)).rows(3, 3).amax()
    };
    // the series ends at dt³: what is left falls with dt⁴
    assert!(off(1.0) < 1e-5, "{:e}", off(1.0));
    assert!((off(1.0) / off(0.5) / 16.0 - 1.0).abs() < 0.05, "{}", off(1.0) / off(0.5));
}

#[test]
fn stationary_variance_of_gauss_markov_states_stays_at_any_interval() {
    let blocks = [block(BlockKind::AccelBias, markov(0.02, 30.0), 0.02)];
    let layout = Layout::<CAP>::new(&blocks).unwrap();
    for dt in [1e-4, 0.01, 1.0, 45.0, 900.0] {
        let mut cov = Covariance::<CAP>::from_variances(&[4e-4; CAP], 12);
        let t = real_transition(&layout, dt, Order::Third);
        for _ in 0..1000 {
            cov.predict(&t);
        }
        for j in 9..12 {
            assert!((cov.get(j, j) / 4e-4 - 1.0).abs() < 1e-12, "dt {dt}: {:e}", cov.get(j, j));
        }
        // from elsewhere it goes there with exp(-2 dt/tau)
        let mut cov = Covariance::<CAP>::from_variances(&[1e-4; CAP], 12);
        cov.predict(&t);
        let want = 4e-4 - 3e-4 * (-2.0 * dt / 30.0).exp();
        assert!((cov.get(9, 9) / want - 1.0).abs() < 1e-12, "dt {dt}");
    }
}

/// Noise of one interval: prediction of a zero covariance, and the exact integral by Van Loan (1978).
fn noise_of(dt: f64) -> (DMatrix<f64>, DMatrix<f64>) {
    let blocks = blocks(18);
    let layout = Layout::<CAP>::new(&blocks).unwrap();
    let mut cov = Covariance::<CAP>::from_variances(&[0.0; CAP], 18);
    cov.predict(&real_transition(&layout, dt, Order::Third));

    let (f, c) = (system_matrix(&blocks, 18), dynamics().c);
    let mut q = DMatrix::zeros(18, 18);
    let turned = |psd: &Vector3<f64>| c * Matrix3::from_diagonal(psd) * c.transpose();
    q.view_mut((0, 0), (3, 3)).copy_from(&turned(&noise().gyro_psd));
    q.view_mut((3, 3), (3, 3)).copy_from(&turned(&noise().accel_psd));
    let densities = [1e-14, 2.0 * 2e-5f64.powi(2) / 100.0, 2.0 * 0.02f64.powi(2) / 300.0];
    for j in 9..18 {
        q[(j, j)] = densities[(j - 9) / 3];
    }
    let mut m = DMatrix::zeros(36, 36);
    m.view_mut((0, 0), (18, 18)).copy_from(&(-&f * dt));
    m.view_mut((0, 18), (18, 18)).copy_from(&(q * dt));
    m.view_mut((18, 18), (18, 18)).copy_from(&(f.transpose() * dt));
    let e = expm(&m);
    let phi = e.view((18, 18), (18, 18)).transpose();
    (dense(&cov), phi * e.view((0, 18), (18, 18)))
}

#[test]
fn process_noise_is_the_exact_integral_up_to_the_second_power_of_the_interval() {
    let off = |dt: f64, i: usize, j: usize| {
        let (got, want) = noise_of(dt);
        ((got - &want).view((i, j), (3, 3)).amax(), want.view((i, j), (3, 3)).amax())
    };
    for (i, j) in [(0, 0), (3, 3), (3, 0), (6, 3), (0, 9), (0, 12), (3, 15), (9, 9), (12, 12), (15, 15)] {
        let ((coarse, _), (fine, size)) = (off(0.02, i, j), off(0.01, i, j));
        assert!(fine < 1e-3 * size, "({i}, {j}): {fine:e} of {size:e}");
        assert!(coarse > 7.0 * fine || fine < 1e-10 * size, "({i}, {j}): {coarse:e} {fine:e}");
    }
    // position from accelerometer noise begins with dt³, where the trapezoid has 1/2 for 1/3
    let (fine, size) = off(0.01, 6, 6);
    assert!((fine / size - 0.5).abs() < 0.01, "{fine:e} of {size:e}");
}
