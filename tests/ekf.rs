//! The filter: fusion against dense algebra, gate, feedback, saving, refusals, both models side by side.

mod common;

use common::{DT_NS, Rng, block, bytes, dense, fix, initial, markov, restore, settings, solution};
use gnssins::attitude::{self, skew};
use gnssins::blocks::{Block, BlockKind, Process};
use gnssins::ekf::{Ekf, Initial, Settings};
use gnssins::error::Error;
use gnssins::frames::Lla;
use gnssins::imu::Rates;
use gnssins::meas::gnss::GnssFix;
use gnssins::meas::{Measurement, Record, Status, View};
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::Ned;
use gnssins::nav::{EarthModel, NavModel, Solution, Vector9};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

const W_B: Vector3<f64> = Vector3::new(0.1, -0.3, 0.2);
const F_B: Vector3<f64> = Vector3::new(1.0, -2.0, -9.5);

fn somewhere() -> Solution {
    solution([-40.0, 120.0, 2000.0], [-20.0, 15.0, 3.0], [25.0, -35.0, 160.0])
}

/// 15 states, lever arm and both GNSS errors: every kind of column that a fix can touch.
fn all_columns() -> Vec<Block> {
    let mut list = common::blocks(15);
    list.push(block(BlockKind::GyroScale, Process::Constant, 0.01));
    list.push(block(BlockKind::GnssLeverArm, Process::Constant, 0.3));
    list.push(block(BlockKind::GnssPositionError, markov(2.0, 30.0), 2.0));
    list.push(block(BlockKind::GnssVelocityError, markov(0.2, 10.0), 0.2));
    list
}

fn predicted<M: NavModel>(settings: &Settings, blocks: &[Block], start: &Initial, steps: i64) -> Ekf<M, 32> {
    let mut ekf = Ekf::new(settings, blocks, start).unwrap();
    for k in 1..=steps {
        ekf.predict(k * DT_NS, &(W_B * 0.01), &(F_B * 0.01)).unwrap();
    }
    ekf
}

/// A fix some sigma off, with every component correlated.
fn correlated_fix(t_ns: i64, near: &Solution, rng: &mut Rng) -> GnssFix {
    let mut z = fix(t_ns, near, 1.0, 1.0);
    z.position = Some(Lla {
        lat_rad: near.position.lat_rad + 3e-7 * rng.unit(),
        lon_rad: near.position.lon_rad + 3e-7 * rng.unit(),
        height_m: near.position.height_m + 2.0 * rng.unit(),
    });
    z.velocity_n = z.velocity_n.map(|v| v.map(|v| v + 0.2 * rng.unit()));
    let a = DMatrix::from_fn(6, 6, |i, _| [1.5, 1.0, 2.0, 0.1, 0.2, 0.15][i] * rng.unit());
    let r = &a * a.transpose() + DMatrix::from_diagonal_element(6, 6, 1e-3);
    z.covariance = std::array::from_fn(|i| std::array::from_fn(|j| r[(i.max(j), i.min(j))]));
    z
}

struct Dense {
    y: DVector<f64>,
    s: DMatrix<f64>,
    x: DVector<f64>,
    p: DMatrix<f64>,
}

/// The textbook update of all six rows at once, before feedback. Parameters must still be zero.
fn dense_update<M: NavModel>(ekf: &Ekf<M, 32>, z: &GnssFix) -> Dense {
    let n = ekf.layout().len();
    let params = ekf.params();
    let view = View {
        model: ekf.model(),
        layout: ekf.layout(),
        params: &params,
        lever_b_m: ekf.lever_b_m(),
        w_ib_b: W_B,
    };
    let rows = z.rows(&view).unwrap();
    let h = DMatrix::from_fn(rows.len, n, |i, j| rows.h[i][j]);
    let r = DMatrix::from_fn(rows.len, rows.len, |i, j| rows.r[i][j]);
    let y = DVector::from_column_slice(&rows.y[..rows.len]);
    let p = dense(ekf.covariance());
    let s = &h * &p * h.transpose() + &r;
    let k = &p * h.transpose() * s.clone().try_inverse().unwrap();
    let a = DMatrix::identity(n, n) - &k * &h;
    Dense { x: &k * &y, p: &a * &p * a.transpose() + &k * r * k.transpose(), y, s }
}

/// I + [phi x]/2 on the attitude rows: the reset of the attitude error.
fn reset(phi: &Vector3<f64>, n: usize) -> DMatrix<f64> {
    let mut g = DMatrix::identity(n, n);
    g.view_mut((0, 0), (3, 3)).copy_from(&(Matrix3::identity() + 0.5 * skew(phi)));
    g
}

fn check_update<M: NavModel>() {
    let mut rng = Rng(11);
    let mut set = settings();
    set.lever_b_m = Vector3::new(1.0, -0.5, -2.0);
    for _ in 0..20 {
        let mut ekf = predicted::<M>(&set, &all_columns(), &initial(somewhere()), 100);
        let n = ekf.layout().len();
        let z = correlated_fix(100 * DT_NS, &ekf.solution(), &mut rng);
        let want = dense_update(&ekf, &z);
        let mut model = ekf.model().clone();
        let record = ekf.update(0, &z).unwrap();

        assert_eq!((record.status, record.dof, record.present), (Status::Used, 6, 0b11_1111));
        let nis = want.y.dot(&(want.s.clone().try_inverse().unwrap() * &want.y));
        assert!((record.nis / nis - 1.0).abs() < 1e-9, "{} {nis}", record.nis);
        for i in 0..6 {
            assert_eq!(record.innovation[i], -want.y[i]);
            for j in 0..6 {
                let limit = 1e-12 * (want.s[(i, i)] * want.s[(j, j)]).sqrt();
                assert!((record.innovation_cov[i][j] - want.s[(i, j)]).abs() < limit);
            }
        }
        model.correct(&Vector9::from_column_slice(&want.x.as_slice()[..9]));
        for (got, want) in ekf.model().pack().iter().zip(model.pack()) {
            assert!((got - want).abs() < 1e-11 * (1.0 + want.abs()), "{got} {want}");
        }
        for j in 9..n {
            assert!((ekf.params()[j] - want.x[j]).abs() < 1e-9 * want.x.rows(9, n - 9).amax(), "{j}");
        }
        let g = reset(&Vector3::new(want.x[0], want.x[1], want.x[2]), n);
        let p = &g * &want.p * g.transpose();
        assert!(common::distance(&dense(ekf.covariance()), &p, &p.diagonal()) < 1e-9);
    }
}

#[test]
fn sequential_update_of_whitened_rows_equals_the_dense_one() {
    check_update::<Ned>();
    check_update::<Ecef>();
}

/// A filter with a gate, and what it makes of a fix `scale` times as far off as it will take.
fn gated(present: [bool; 2], quantile: f64, scale: f64) -> (Record, bool) {
    let make = |gate: Option<f64>| {
        predicted::<Ned>(
            &Settings { gate_probability: [gate; 3], ..settings() },
            &common::blocks(15),
            &initial(somewhere()),
            10,
        )
    };
    let mut ekf = make(Some(0.999));
    let s = ekf.solution();
    let z = |off: f64| {
        let mut z = fix(10 * DT_NS, &s, 2.0, 0.2);
        z.position = present[0].then(|| {
            Lla::new(s.position.lat_rad + off * 1e-7, s.position.lon_rad, s.position.height_m - off)
        });
        z.velocity_n = if present[1] { [0, 1, 2].map(|i| Some(s.v_n[i] + 0.1 * off)) } else { [None; 3] };
        z
    };
    let nis = make(None).update(0, &z(1.0)).unwrap().nis;
    let before = bytes(&ekf);
    let record = ekf.update(0, &z(scale * (quantile / nis).sqrt())).unwrap();
    (record, before == bytes(&ekf))
}

#[test]
fn gate_takes_up_to_the_chi_square_quantile_and_a_rejection_changes_no_bit() {
    // scipy.stats.chi2.ppf(0.999, dof)
    for (present, dof, quantile) in
        [([true, false], 3, 16.266_236_196_238_13), ([true, true], 6, 22.457_744_484_825_323)]
    {
        let (inside, same) = gated(present, quantile, 1.0 - 1e-7);
        assert_eq!((inside.status, inside.dof), (Status::Used, dof));
        assert!(!same);
        let (outside, same) = gated(present, quantile, 1.0 + 1e-7);
        assert_eq!((outside.status, outside.dof), (Status::Rejected, dof));
        assert!((outside.nis / quantile - 1.0).abs() < 1e-6);
        assert!(same, "a rejected fix moved the filter");
    }
}

#[test]
fn one_velocity_component_alone_has_one_degree_of_freedom() {
    let mut ekf = predicted::<Ned>(&settings(), &common::blocks(15), &initial(somewhere()), 10);
    let mut z = fix(10 * DT_NS, &ekf.solution(), 1.0, 0.2);
    z.position = None;
    z.velocity_n = [None, Some(ekf.solution().v_n.y + 0.5), None];
    // what is absent may hold anything
    z.covariance[0][0] = f64::NAN;
    let s = ekf.covariance().get(4, 4) + 0.04;
    let record = ekf.update(3, &z).unwrap();
    assert_eq!((record.row, record.dof, record.present, record.status), (3, 1, 0b1_0000, Status::Used));
    assert!((record.innovation[4] - 0.5).abs() < 1e-12 && (record.nis - 0.25 / s).abs() < 1e-12);
}

#[test]
fn the_lever_arm_turns_with_the_corrected_rate_of_the_interval_or_of_the_stamp() {
    let lever_b_m = Vector3::new(3.0, -2.0, 4.0);
    let bias = Vector3::new(0.02, -0.01, 0.03);
    let mut blocks = common::blocks(15);
    blocks[0].initial[..3].copy_from_slice(bias.as_slice());
    let innovation = |rates: Option<[Vector3<f64>; 2]>, w: &Vector3<f64>| {
        let set = Settings { lever_b_m, ..settings() };
        let mut ekf = Ekf::<Ned, 16>::new(&set, &blocks, &initial(somewhere())).unwrap();
        match rates {
            None => ekf.predict(DT_NS, &((W_B + bias) * 0.01), &(F_B * 0.01)).unwrap(),
            Some(ends) => {
                let [a, b] = ends.map(|gyro| Rates { gyro: gyro + bias, accel: F_B });
                ekf.predict_rates(DT_NS, &a, &b).unwrap();
            }
        }
        let (_, v) = common::antenna(&ekf.solution(), &lever_b_m, w);
        let mut z = fix(DT_NS, &ekf.solution(), 1.0, 0.1);
        (z.position, z.velocity_n) = (None, [0, 1, 2].map(|i| Some(v[i])));
        Vector3::from_column_slice(&ekf.update(0, &z).unwrap().innovation[3..])
    };
    assert!(innovation(None, &W_B).amax() < 1e-9);
    let other = Vector3::new(-0.4, 0.2, 0.7);
    assert!(innovation(Some([W_B, other]), &other).amax() < 1e-9, "a sample at the stamp is the rate there");
    assert!(innovation(Some([W_B, other]), &W_B).amax() > 1.0);
}

#[test]
fn attitude_reset_is_the_derivative_of_the_error_after_feedback() {
    let phi_hat = Vector3::new(0.2, -0.3, 0.25);
    let model = Ned::new(EarthModel::default(), &somewhere()).unwrap();
    let mut corrected = model;
    let mut x = Vector9::zeros();
    x.fixed_rows_mut::<3>(0).copy_from(&phi_hat);
    corrected.correct(&x);
    let left = |phi: Vector3<f64>| {
        let truth = attitude::exp(&phi) * model.solution().q_nb;
        attitude::log(&(truth * corrected.solution().q_nb.inverse()))
    };
    let j = Matrix3::from_columns(&[0, 1, 2].map(|i| {
        let step = Vector3::ith(i, 1e-5);
        (left(phi_hat + step) - left(phi_hat - step)) / 2e-5
    }));
    // the left Jacobian of SO(3) is I + [phi x]/2 + [phi x]²/6 + ...
    let g = Matrix3::identity() + 0.5 * skew(&phi_hat);
    assert!((j - g).amax() < phi_hat.norm_squared() / 6.0, "{j} {g}");
    assert!((j - g.transpose()).amax() > 0.2, "the other sign would be far off");

    // and the filter turns its covariance that way: fixes tell of a large attitude error
    let mut start = initial(somewhere());
    start.sd_phi = Vector3::repeat(0.5);
    start.sd_v = Vector3::repeat(1e-3);
    let mut ekf = predicted::<Ned>(&settings(), &common::blocks(15), &start, 300);
    let mut z = fix(300 * DT_NS, &ekf.solution(), 1.0, 0.01);
    z.velocity_n = [0, 1, 2].map(|i| Some(ekf.solution().v_n[i] + [4.0, -5.0, 1.0][i]));
    let want = dense_update(&ekf, &z);
    let phi = Vector3::new(want.x[0], want.x[1], want.x[2]);
    assert!(phi.norm() > 0.1, "{phi}");
    ekf.update(0, &z).unwrap();
    let p = |g: &DMatrix<f64>| {
        let p = g * &want.p * g.transpose();
        common::distance(&dense(ekf.covariance()), &p, &p.diagonal())
    };
    assert!(p(&reset(&phi, 15)) < 1e-6, "{:e}", p(&reset(&phi, 15)));
    assert!(p(&reset(&-phi, 15)) > 1e-2 && p(&DMatrix::identity(15, 15)) > 1e-2);
}

fn go_on<M: NavModel>(ekf: &mut Ekf<M, 32>, from: i64, to: i64) {
    let mut rng = Rng(from as u64);
    for k in from..to {
        ekf.predict((k + 1) * DT_NS, &(W_B * 0.01 + rng.vector(1e-4)), &(F_B * 0.01 + rng.vector(1e-3)))
            .unwrap();
        if k % 25 == 0 {
            let z = correlated_fix((k + 1) * DT_NS, &ekf.solution(), &mut rng);
            assert_eq!(ekf.update(0, &z).unwrap().status, Status::Used);
        }
    }
}

#[test]
fn a_restored_filter_goes_on_with_the_same_bits() {
    fn check<M: NavModel>() {
        let mut ekf = predicted::<M>(&settings(), &all_columns(), &initial(somewhere()), 0);
        go_on(&mut ekf, 0, 60);
        let saved = bytes(&ekf);
        // a filter that has been elsewhere
        let mut other =
            predicted::<M>(&settings(), &all_columns(), &initial(solution([1.0; 3], [0.0; 3], [0.0; 3])), 30);
        restore(&mut other, &saved).unwrap();
        assert_eq!(bytes(&other), saved);
        go_on(&mut ekf, 60, 200);
        go_on(&mut other, 60, 200);
        assert_eq!(bytes(&ekf), bytes(&other));
        assert_eq!(ekf.solution(), other.solution());
    }
    check::<Ned>();
    check::<Ecef>();
}

#[test]
fn bytes_that_are_cut_or_of_other_blocks_are_refused_and_change_nothing() {
    let ekf = predicted::<Ned>(&settings(), &all_columns(), &initial(somewhere()), 30);
    let saved = bytes(&ekf);
    let refused = |blocks: &[Block], bytes_in: &[u8]| {
        let mut other = predicted::<Ned>(&settings(), blocks, &initial(somewhere()), 3);
        let before = bytes(&other);
        let result = restore(&mut other, bytes_in);
        assert!(matches!(result, Err(Error::SavedState { .. })), "{result:?}");
        assert_eq!(bytes(&other), before);
    };
    for len in (0..saved.len()).step_by(8) {
        refused(&all_columns(), &saved[..len]);
    }
    let mut swapped = all_columns();
    swapped.swap(4, 5);
    refused(&swapped, &saved);
    refused(&common::blocks(15), &saved);
    let mut process = all_columns();
    process[0].process = Process::Constant;
    refused(&process, &saved);
}

#[test]
fn bytes_of_the_other_model_are_refused() {
    let ekf = predicted::<Ecef>(&settings(), &all_columns(), &initial(somewhere()), 3);
    let mut other = predicted::<Ned>(&settings(), &all_columns(), &initial(somewhere()), 3);
    let result = restore(&mut other, &bytes(&ekf));
    assert!(matches!(result, Err(Error::SavedState { .. })), "{result:?}");
}

#[test]
fn saved_numbers_that_are_not_finite_or_indefinite_are_refused() {
    fn check<M: NavModel>() {
        let ekf = predicted::<M>(&settings(), &all_columns(), &initial(somewhere()), 30);
        let (saved, n) = (bytes(&ekf), ekf.layout().len());
        let mut other = predicted::<M>(&settings(), &all_columns(), &initial(somewhere()), 3);
        let before = bytes(&other);
        // after count, fingerprint and time all words but the times of the last feedback and of the last accepted fix; at the
        // end stand the sums of intervals that the covariance has not been through
        let words = saved.len() / 8;
        let open = 42;
        let times = [words - open - 11 - 1 - n - 2, words - open - 11];
        for word in (3..words).filter(|w| !times.contains(w)) {
            let mut spoilt = saved.clone();
            spoilt[8 * word..8 * word + 8].copy_from_slice(&f64::NAN.to_bits().to_le_bytes());
            let result = restore(&mut other, &spoilt);
            assert!(result.is_err(), "{} word {word} of {words}, {n} states", M::NAME);
            assert_eq!(bytes(&other), before);
        }
    }
    check::<Ned>();
    check::<Ecef>();
}
