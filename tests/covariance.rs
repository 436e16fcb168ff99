//! Covariance prediction and update, transition and process noise, against dense references.

mod common;

use common::linearised::{CAP, ORDERS, real_transition, somewhere};
use common::{Rng, blocks, dense, dense_transition, distance, fix, settings};
use gnssins::cov::Covariance;
use gnssins::discretise::{BlockStep, Order, Transition};
use gnssins::ekf::Ekf;
use gnssins::error::Error;
use gnssins::layout::Layout;
use gnssins::nav::ned::Ned;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// A transition of random numbers with a random noise.
fn random_transition(layout: &Layout<CAP>, rng: &mut Rng) -> Transition<CAP> {
    let n = layout.len();
    let mut t = real_transition(layout, 0.01, Order::Third);
    for (i, j) in (0..9).flat_map(|i| (0..n).map(move |j| (i, j))) {
        t.set_top(i, j, rng.unit());
    }
    for j in 9..n {
        (t.blocks.diagonal[j], t.blocks.q[j]) = (0.5 + 0.5 * rng.unit(), 0.1 * (1.0 + rng.unit()));
    }
    for q in [&mut t.q_phi, &mut t.q_dv] {
        let a = Matrix3::from_fn(|_, _| rng.unit());
        let aa = a * a.transpose();
        *q = Matrix3::from_fn(|i, j| aa[(i.max(j), i.min(j))]);
    }
    t
}

/// A full covariance with correlations: random transitions and updates from a diagonal.
fn random_covariance(layout: &Layout<CAP>, rng: &mut Rng) -> Covariance<CAP> {
    let variances = std::array::from_fn(|_| 0.5 + 0.4 * rng.unit());
    let mut cov = Covariance::from_variances(&variances, layout.len());
    for _ in 0..3 {
        cov.predict(&random_transition(layout, rng));
        for _ in 0..4 {
            cov.update(&random_row(layout.len(), rng)).unwrap();
        }
    }
    cov.check(0).unwrap();
    cov
}

fn random_row(n: usize, rng: &mut Rng) -> [f64; CAP] {
    let mut h = [0.0; CAP];
    h[..n].fill_with(|| rng.unit());
    h
}

#[test]
fn block_prediction_equals_the_dense_trapezoid() {
    let mut rng = Rng(1);
    for states in [15, 18, 21, 22, 36] {
        let layout = Layout::<CAP>::new(&blocks(states)).unwrap();
        for k in 0..20 {
            let t = match k {
                0..3 => real_transition(&layout, 0.01, ORDERS[k]),
                _ => random_transition(&layout, &mut rng),
            };
            let mut cov = random_covariance(&layout, &mut rng);
            let (phi, q) = dense_transition(&t, states);
            let want = &phi * (dense(&cov) + &q * 0.5) * phi.transpose() + &q * 0.5;
            cov.predict(&t);
            assert!(distance(&dense(&cov), &want, &want.diagonal()) < 1e-14 * states as f64, "{states} {k}");
        }
    }
}

#[test]
fn two_pass_update_equals_the_dense_joseph_form() {
    let mut rng = Rng(2);
    for states in [15, 18, 21, 22, 36] {
        let layout = Layout::<CAP>::new(&blocks(states)).unwrap();
        for _ in 0..20 {
            let mut cov = random_covariance(&layout, &mut rng);
            let p = dense(&cov);
            let row = random_row(states, &mut rng);
            let h = DMatrix::from_row_slice(1, states, &row[..states]);
            let s = (&h * &p * h.transpose())[0] + 1.0;
            let k = &p * h.transpose() / s;
            let a = DMatrix::identity(states, states) - &k * &h;
            let want = &a * &p * a.transpose() + &k * k.transpose();
            let gain = cov.update(&row).unwrap();
            assert!(distance(&dense(&cov), &want, &p.diagonal()) < 1e-14 * states as f64, "{states}");
            assert!(
                (DVector::from_column_slice(&gain[..states]) - k.column(0)).amax()
                    < 1e-14 * k.amax() * states as f64
            );
        }
    }
}

#[test]
fn padded_capacity_gives_the_same_bits() {
    let leg =
        |t: i64| (Vector3::new(1e-3, -2e-3, 3e-3) * (1.0 + t as f64), Vector3::new(0.01, 0.02, -0.0981));
    let mut small = common::filter::<Ned, 24>(21, somewhere());
    let mut large = common::filter::<Ned, 40>(21, somewhere());
    for k in 1..=50 {
        let (dtheta, dvel) = leg(k);
        small.predict(k * common::DT_NS, &dtheta, &dvel).unwrap();
        large.predict(k * common::DT_NS, &dtheta, &dvel).unwrap();
        if k % 10 == 0 {
            let z = fix(k * common::DT_NS, &somewhere(), 5.0, 0.5);
            assert_eq!(small.update(0, &z).unwrap(), large.update(0, &z).unwrap());
        }
        assert_eq!(common::bytes(&small), common::bytes(&large), "step {k}");
    }
}

/// Three whitened position rows, twice, on a prior of `ratio` noises that a prediction has correlated with the
/// velocities: the covariance by two passes, and by P - k h P.
fn fused(rows: [[f64; 3]; 3], ratio: f64) -> (Option<Covariance<CAP>>, DMatrix<f64>) {
    let layout = Layout::<CAP>::new(&[]).unwrap();
    let variances = std::array::from_fn(|i| [1e-4, 1.0, ratio * ratio][i.min(8) / 3]);
    let mut cov = Covariance::<CAP>::from_variances(&variances, layout.len());
    cov.predict(&real_transition(&layout, 0.1, Order::Third));
    let mut short = dense(&cov);
    for r in rows.iter().chain(&rows) {
        let mut h = [0.0; CAP];
        h[6..9].copy_from_slice(r);
        if cov.update(&h).is_none() {
            return (None, short);
        }
        let h = DMatrix::from_row_slice(1, 9, &h[..9]);
        let ph = &short * h.transpose();
        let s = (&h * &ph)[0] + 1.0;
        short -= &ph * ph.transpose() / s;
    }
    (Some(cov), short)
}

#[test]
fn two_pass_update_stays_positive_definite_where_the_short_form_breaks() {
    let aligned = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mut short_broke_at = f64::INFINITY;
    for ratio in (0..=10).map(|k| 10f64.powi(k)) {
        let (cov, short) = fused(aligned, ratio);
        let cov = cov.unwrap();
        cov.check(0).unwrap_or_else(|e| panic!("sd ratio {ratio:e}: {e}"));
        // two fixes of unit noise, and what the prior adds to them
        let want = 1.0 / (2.0 + ratio.powi(-2));
        for i in 6..9 {
            assert!((cov.get(i, i) / want - 1.0).abs() < 0.01, "{ratio:e} {i}: {}", cov.get(i, i));
        }
        if short.cholesky().is_none() {
            short_broke_at = short_broke_at.min(ratio);
        }
    }
    assert!(short_broke_at <= 1e8, "the short form held until {short_broke_at:e}");
}

#[test]
fn two_pass_update_of_oblique_rows_holds_as_far_as_the_numbers_can() {
    // beyond 1e7 the smallest eigenvalue of P lies below the rounding of its largest: no form of P can hold it
    let oblique = [[0.8, 0.6, 0.0], [-0.6, 0.8, 0.1], [0.1, 0.2, 0.97]];
    let h = Matrix3::from_fn(|i, j| oblique[i][j]);
    for ratio in (0..=7).map(|k| 10f64.powi(k)) {
        let cov = fused(oblique, ratio).0.unwrap();
        cov.check(0).unwrap_or_else(|e| panic!("sd ratio {ratio:e}: {e}"));
        let want = (2.0 * h.transpose() * h + Matrix3::identity() / ratio.powi(2)).try_inverse().unwrap();
        for i in 0..3 {
            let off = cov.get(6 + i, 6 + i) / want[(i, i)] - 1.0;
            assert!(off.abs() < 0.01, "{ratio:e} {i}: {off:e}");
        }
    }
}

#[test]
fn symmetry_is_exact_over_many_predictions_and_updates() {
    let mut ekf = common::filter::<Ned, 24>(18, somewhere());
    let mut rng = Rng(3);
    for k in 1..=200_000i64 {
        let (dtheta, dvel) = (rng.vector(1e-3), Vector3::new(0.0, 0.0, -0.098) + rng.vector(1e-2));
        ekf.predict(k * common::DT_NS, &dtheta, &dvel).unwrap();
        if k % 10 == 0 {
            let mut z = fix(k * common::DT_NS, &ekf.solution(), 1.0, 0.1);
            z.covariance[0][1] = 0.3;
            z.covariance[1][0] = 0.3;
            ekf.update(0, &z).unwrap();
        }
        let p = ekf.covariance().rows();
        for i in 0..18 {
            for j in 0..i {
                assert_eq!(
                    p[i][j].to_bits(),
                    p[j][i].to_bits(),
                    "step {k} ({i}, {j}): {} {}",
                    p[i][j],
                    p[j][i]
                );
            }
        }
    }
    ekf.covariance().check(0).unwrap();
}

#[test]
fn check_names_the_state_that_is_not_positive_definite() {
    let layout = Layout::<CAP>::new(&blocks(21)).unwrap();
    let broken = |change: &dyn Fn(&mut Transition<CAP>)| {
        let mut t = Transition::identity(&BlockStep::new(&layout, 0.0, 0.0));
        change(&mut t);
        let mut cov = Covariance::<CAP>::from_variances(&[1.0; CAP], 21);
        cov.predict(&t);
        match cov.check(77) {
            Err(Error::Covariance { t_ns: 77, state, pivot }) => Some((state, pivot)),
            Err(other) => panic!("{other}"),
            Ok(()) => None,
        }
    };
    assert_eq!(broken(&|_| {}), None);
    assert_eq!(broken(&|t| t.blocks.q[13] = -3.0), Some((13, -2.0)));
    assert_eq!(broken(&|t| t.blocks.q[20] = -1.0), Some((20, 0.0)));
    // correlated beyond one: the second of the pair fails
    let both = broken(&|t| {
        t.q_dv[(1, 2)] = 1.5;
        t.q_dv[(2, 1)] = 1.5;
    });
    assert_eq!(both, Some((5, 1.0 - 2.25)));
    let mut variances = [1.0; CAP];
    variances[17] = f64::NAN;
    match Covariance::<CAP>::from_variances(&variances, 21).check(5) {
        Err(Error::Covariance { t_ns: 5, state: 17, pivot }) => assert!(pivot.is_nan()),
        other => panic!("{other:?}"),
    }
    variances[17] = f64::INFINITY;
    assert!(Covariance::<CAP>::from_variances(&variances, 21).check(5).is_err());
    // a NaN that has spread through a prediction is found at the first state that it reached
    assert!(broken(&|t| t.blocks.q[17] = f64::NAN).is_some_and(|(_, pivot)| pivot.is_nan()));
}

#[test]
fn a_filter_that_starts_indefinite_is_refused() {
    let mut start = common::initial(somewhere());
    start.sd_v.y = 1e-200;
    let made = Ekf::<Ned, 16>::new(&settings(), &[], &start);
    assert!(matches!(made, Err(Error::Covariance { state: 4, .. })), "{made:?}");
}

#[test]
fn every_set_of_instructions_gives_the_same_covariance() {
    use gnssins::simd::Isa;
    let mut rng = Rng(77);
    for states in [15, 18, 21, 22] {
        let layout = Layout::<CAP>::new(&blocks(states)).unwrap();
        let t = random_transition(&layout, &mut rng);
        let a = DMatrix::from_fn(states, states, |_, _| rng.unit());
        let start = &a * a.transpose();
        let on = |isa: Isa| {
            let mut cov = Covariance::<CAP>::from_variances(&[1.0; CAP], states);
            // a full matrix by fusing rows: the public way to one
            for i in 0..states {
                let mut h = [0.0; CAP];
                h[..states].copy_from_slice(&start.column(i).as_slice()[..states]);
                cov.update(&h).unwrap();
            }
            cov.predict_on(isa, &t);
            cov
        };
        let portable = on(Isa::Portable);
        for isa in [Isa::Avx2, Isa::Avx512] {
            assert!(isa.available() as u8 <= isa as u8);
            let wide = on(isa);
            let p = common::dense(&portable);
            // fused products round once where the portable path rounds twice
            assert!(common::distance(&common::dense(&wide), &p, &p.diagonal()) < 1e-13, "{isa:?} {states}");
        }
        // the widths of the vectors change no order of summation
        assert_eq!(on(Isa::Avx2), on(Isa::Avx512));
    }
}
