//! Rows of the aids, and the errors along NED of the ECEF model, against central differences of what they predict.

mod common;

use common::equations::{ATTITUDES, Axes, Equations, LATITUDES, STEP};
use common::{DEG, block, markov, solution};
use gnssins::attitude;
use gnssins::blocks::BlockKind;
use gnssins::imu::Calibration;
use gnssins::layout::Layout;
use gnssins::meas::{Measurement, View};
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::Ned;
use gnssins::nav::{Aid, EarthModel, NavModel, Vector9};
use nalgebra::{Matrix3, SMatrix, Vector3};

const LEVER: Vector3<f64> = Vector3::new(1.5, -0.8, -2.0);
const TURN: Vector3<f64> = Vector3::new(0.3, -0.5, 0.8);

/// Rows of an aid over phi, dv, dp, the gyro and the lever by central differences.
fn aid_rows<M: NavModel>(
    model: &M,
    aid: impl Fn(&M, &Vector3<f64>, &Vector3<f64>) -> Vector3<f64>,
) -> SMatrix<f64, 3, 15> {
    let mut h = SMatrix::<f64, 3, 15>::zeros();
    for j in 0..15 {
        let step = [1e-4, 1.0, 100.0, 1e-3, 1e-2][j / 3];
        let y = |sign: f64| {
            let (mut estimate, mut lever, mut w) = (model.clone(), LEVER, TURN);
            match j {
                // the estimate gets the error: the opposite of a correction
                0..9 => {
                    let mut x = Vector9::zeros();
                    x[j] = -sign * step;
                    estimate.correct(&x);
                }
                // an error left in the gyro makes the rate too large, one left in the lever leaves it too short
                9..12 => w[j - 9] += sign * step,
                _ => lever[j - 12] -= sign * step,
            }
            aid(&estimate, &lever, &w)
        };
        h.set_column(j, &((y(1.0) - y(-1.0)) / (2.0 * step)));
    }
    h
}

/// 1e-5 of the block's largest element: y is exact to the radii's change over the lever arm.
fn assert_aid(aid: &Aid, want: &SMatrix<f64, 3, 15>, skip_dp: bool, what: &str) {
    let mut got = SMatrix::<f64, 3, 15>::zeros();
    got.fixed_columns_mut::<9>(0).copy_from(&aid.h);
    got.fixed_columns_mut::<3>(9).copy_from(&aid.h_gyro);
    got.fixed_columns_mut::<3>(12).copy_from(&aid.h_lever);
    for start in (0..15).step_by(3).filter(|s| !(skip_dp && *s == 6)) {
        let (g, w) = (got.fixed_columns::<3>(start), want.fixed_columns::<3>(start));
        assert!((g - w).amax() <= 1e-5 * w.amax() + 1e-12, "columns from {start}, {what}: {g} {w}");
    }
}

fn check_aids<M: NavModel>(latitudes: &[f64]) {
    let earth = EarthModel::default();
    for (&lat, euler) in latitudes.iter().flat_map(|l| ATTITUDES.map(|a| (l, a))) {
        let s = solution([lat, -179.999_99, 700.0], [40.0, -120.0, 15.0], euler);
        let what = format!("{} lat {lat} {euler:?}", M::NAME);
        let model = M::new(earth, &s).unwrap();
        let (at, v) = common::antenna(&s, &LEVER, &TURN);

        let position = model.position_aid(&LEVER, &at);
        // the curvature of the Earth over the lever arm: l² tan(L) / R
        assert!(position.y.amax() < 2e-5, "position {what}: {}", position.y);
        assert_aid(&position, &aid_rows(&model, |m, l, _| m.position_aid(l, &at).y), false, &what);

        let velocity = model.velocity_aid(&LEVER, &TURN, &v, Some(&s.position));
        assert!(velocity.y.amax() < 1e-9, "velocity {what}: {}", velocity.y);
        let rows = aid_rows(&model, |m, l, w| m.velocity_aid(l, w, &v, Some(&s.position)).y);
        assert_aid(&velocity, &rows, false, &what);

        // without the receiver's position the turn of the axes with dp, v/R per metre, is left out
        let alone = model.velocity_aid(&LEVER, &TURN, &v, None);
        let rows = aid_rows(&model, |m, l, w| m.velocity_aid(l, w, &v, None).y);
        assert_aid(&alone, &rows, true, &what);
        let left_out = (rows.fixed_columns::<3>(6) - alone.h.fixed_columns::<3>(6)).amax();
        assert!(left_out <= 130.0 * (1.0 + (lat * DEG).tan().abs()) / 6.3e6, "{what}: {left_out:e}");
    }
}

#[test]
fn aiding_rows_are_the_derivative_of_predicted_minus_measured() {
    check_aids::<Ned>(&LATITUDES);
    check_aids::<Ecef>(&LATITUDES);
}

#[test]
fn gnss_rows_of_sensor_and_error_states_are_the_derivative_of_y() {
    let blocks = [
        common::blocks(36),
        vec![block(BlockKind::GnssPositionError, markov(1.0, 30.0), 1.0)],
        vec![block(BlockKind::GnssVelocityError, markov(0.1, 30.0), 0.1)],
    ]
    .concat();
    let layout = Layout::<48>::new(&blocks).unwrap();
    let s = solution([40.0, 7.0, 300.0], [20.0, -30.0, 4.0], [30.0, -20.0, 70.0]);
    let model = Ned::new(EarthModel::default(), &s).unwrap();
    let fix = common::fix(0, &s, 1.0, 0.1);
    let y = |params: &[f64; 48]| {
        let start = |kind| layout.find(kind).unwrap();
        let (b, k) = (start(BlockKind::GyroBias), start(BlockKind::GyroScale));
        let (m, l) = (start(BlockKind::GyroMisalignment), start(BlockKind::GnssLeverArm));
        let p = |i: usize| params[i];
        let matrix =
            Matrix3::new(p(k), p(m), p(m + 1), p(m + 2), p(k + 1), p(m + 3), p(m + 4), p(m + 5), p(k + 2));
        let gyro = Calibration::new(Vector3::new(p(b), p(b + 1), p(b + 2)), matrix).unwrap();
        let view = View {
            model: &model,
            layout: &layout,
            params,
            lever_b_m: LEVER + Vector3::new(p(l), p(l + 1), p(l + 2)),
            w_ib_b: gyro.rate(&TURN),
        };
        fix.rows(&view).unwrap()
    };
    let rows = y(&[0.0; 48]);
    for j in 9..layout.len() {
        let shifted = |sign: f64| {
            let mut params = [0.0; 48];
            params[j] = sign * 1e-4;
            y(&params).y
        };
        // the state is true minus estimated parameter: y falls where the estimate grows
        let (above, below) = (shifted(1.0), shifted(-1.0));
        for i in 0..6 {
            let want = -(above[i] - below[i]) / 2e-4;
            assert!((rows.h[i][j] - want).abs() <= 1e-6, "({i}, {j}): {}, {want}", rows.h[i][j]);
        }
    }
}

#[test]
fn ned_errors_of_the_ecef_model_are_the_derivative_of_its_solution() {
    let earth = EarthModel::default();
    for lat in LATITUDES.iter().copied().chain([-89.9, 89.9]) {
        for euler in ATTITUDES {
            let s = solution([lat, 100.0, 3000.0], [150.0, -200.0, 30.0], euler);
            let model = Ecef::new(earth, &s).unwrap();
            let t = model.to_ned_errors().unwrap();
            for j in 0..9 {
                let step = STEP[j / 3] * if lat.abs() > 89.0 { 0.1 } else { 1.0 };
                let shifted = |sign: f64| {
                    let mut m = model;
                    let mut x = Vector9::zeros();
                    x[j] = -sign * step;
                    m.correct(&x);
                    m.solution()
                };
                let (up, down) = (shifted(1.0), shifted(-1.0));
                let eq = Equations { axes: Axes::Ned, earth };
                let (m, east) = eq.scale(s.position.lat_rad, s.position.height_m);
                let (a, b) = (&up.position, &down.position);
                let dp = Vector3::new(
                    (a.lat_rad - b.lat_rad) * m,
                    (a.lon_rad - b.lon_rad) * east,
                    b.height_m - a.height_m,
                );
                let phi = attitude::log(&(down.q_nb * up.q_nb.inverse()));
                for (k, want) in [phi, up.v_n - down.v_n, dp].iter().enumerate() {
                    let want = want / (2.0 * step);
                    let got = t.fixed_view::<3, 1>(3 * k, j).into_owned();
                    let scale = t.fixed_view::<3, 3>(3 * k, j / 3 * 3).amax();
                    assert!(
                        (got - want).amax() <= 1e-5 * scale + 1e-12,
                        "lat {lat} rows {k} column {j}: {got:e} {want:e}"
                    );
                }
            }
        }
    }
}
