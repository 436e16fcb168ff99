//! Error dynamics, couplings and aiding Jacobians against central differences of the non-linear equations.
//!
//! The equations of motion stand here once more, written from the text-book form and not from the engine. A state is
//! an estimate; removing an error x by its definition (page of `nav`) gives the truth; both move by the same
//! equations, and the rate at which they part is the column of F. Within a 3x3 block an element may be off by 1e-6 of
//! the largest one in its row of the block, plus 1e-8 of the largest in the block (rounding).

mod common;

use common::equations::{ATTITUDES, Axes, Equations, F_B, LATITUDES, STEP, State, ecef_state, ned_state};
use common::solution;
use gnssins::attitude;
use gnssins::discretise::Order;
use gnssins::earth::{Ellipsoid, Gravity};
use gnssins::ekf::{Ekf, Settings};
use gnssins::frames::C_UN;
use gnssins::imu::{ImuDelta, Strap};
use gnssins::layout::Layout;
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::Ned;
use gnssins::nav::{Dynamics, EarthModel, Matrix9, NavModel, Solution, Vector9};
use nalgebra::{Matrix3, SMatrix, Vector3};

const ELLIPSOIDS: [Ellipsoid; 4] =
    [Ellipsoid::WGS84, Ellipsoid::GRS80, Ellipsoid::PZ90, Ellipsoid::KRASOVSKY];
const GRAVITIES: [Gravity; 2] = [Gravity::Normal, Gravity::NormalVertical];

/// 1e-6 of the row within its block and 1e-8 of the block.
fn assert_blocks<const C: usize>(got: &SMatrix<f64, 9, C>, want: &SMatrix<f64, 9, C>, what: &str) {
    for (bi, bj) in (0..9).step_by(3).flat_map(|i| (0..C).step_by(3).map(move |j| (i, j))) {
        let block = want.fixed_view::<3, 3>(bi, bj).amax();
        for i in bi..bi + 3 {
            let row = want.fixed_view::<1, 3>(i, bj).amax();
            for j in bj..bj + 3 {
                let (g, w) = (got[(i, j)], want[(i, j)]);
                let limit = 1e-6 * row + 1e-8 * block;
                assert!((g - w).abs() <= limit, "({i}, {j}): {g:e}, differences {w:e}, {what}");
            }
        }
    }
}

const VELOCITIES: [[f64; 3]; 8] = [
    [0.0, 0.0, 0.0],
    [30.0, 0.0, 0.0],
    [0.0, -30.0, 0.0],
    [-10.0, 20.0, 20.0],
    [300.0, 0.0, 0.0],
    [0.0, 300.0, 0.0],
    [0.0, 0.0, -300.0],
    [-200.0, 210.0, 75.0],
];

/// Every combination of place, velocity, attitude, ellipsoid and gravity.
fn grid(latitudes: &[f64], check: impl Fn(EarthModel, &Solution, &str)) {
    for (ellipsoid, gravity) in ELLIPSOIDS.iter().flat_map(|e| GRAVITIES.map(|g| (*e, g))) {
        for (&lat, h) in latitudes.iter().flat_map(|l| [0.0, 10_000.0].map(|h| (l, h))) {
            for (v, a) in VELOCITIES.iter().flat_map(|v| ATTITUDES.iter().map(move |a| (v, a))) {
                let s = solution([lat, 33.0, h], *v, *a);
                check(
                    EarthModel { ellipsoid, gravity },
                    &s,
                    &format!("lat {lat} h {h} v {v:?} {a:?} {gravity:?}"),
                );
            }
        }
    }
}

fn couplings(d: &Dynamics) -> SMatrix<f64, 9, 6> {
    let mut out = SMatrix::<f64, 9, 6>::zeros();
    out.fixed_columns_mut::<3>(0).copy_from(&d.gyro_coupling());
    out.fixed_columns_mut::<3>(3).copy_from(&d.accel_coupling());
    out
}

#[test]
fn ned_dynamics_are_the_derivative_of_the_equations_of_motion() {
    grid(&LATITUDES, |earth, s, what| {
        let (f, b) = Equations { axes: Axes::Ned, earth }.jacobian(&ned_state(s));
        let d = Ned::new(earth, s).unwrap().dynamics(&F_B);
        assert_blocks(&d.f(), &f, what);
        assert_blocks(&couplings(&d), &b, what);
    });
}

#[test]
fn ecef_dynamics_are_the_derivative_of_the_equations_of_motion_poles_included() {
    let with_poles: Vec<f64> = LATITUDES.iter().copied().chain([-90.0, 90.0]).collect();
    grid(&with_poles, |earth, s, what| {
        let (f, b) = Equations { axes: Axes::Ecef, earth }.jacobian(&ecef_state(&earth, s));
        let d = Ecef::new(earth, s).unwrap().dynamics(&F_B);
        assert_blocks(&d.f(), &f, what);
        assert_blocks(&couplings(&d), &b, what);
    });
}

#[test]
fn enu_dynamics_are_the_ned_ones_under_one_rotation() {
    let mut t = Matrix9::zeros();
    for k in [0, 3, 6] {
        t.fixed_view_mut::<3, 3>(k, k).copy_from(&C_UN);
    }
    grid(&[-60.0, 30.68], |earth, s, what| {
        let ned = ned_state(s);
        let enu = State { p: ned.p, v: C_UN * ned.v, c: C_UN * ned.c };
        let (f, b) = Equations { axes: Axes::Enu, earth }.jacobian(&enu);
        let d = Ned::new(earth, s).unwrap().dynamics(&F_B);
        assert_blocks(&(t * d.f() * t.transpose()), &f, what);
        assert_blocks(&(t * couplings(&d)), &b, what);
    });
}

/// A strap over `dt` with constant rates, as the first one after a start.
fn strap(dt: f64, w_b: &Vector3<f64>, f_b: &Vector3<f64>) -> Strap {
    Strap::from_increments(&ImuDelta { dt_s: dt, dtheta: w_b * dt, dvel: f_b * dt }, None)
}

/// Integrates the equations of motion by Runge-Kutta of fourth order.
fn integrate(eq: &Equations, start: &State, dt: f64, w_b: &Vector3<f64>) -> State {
    let add = |s: &State, r: &State, h: f64| State { p: s.p + r.p * h, v: s.v + r.v * h, c: s.c + r.c * h };
    let h = dt / 20.0;
    (0..20).fold(*start, |s, _| {
        let k1 = eq.rate(&s, w_b, &F_B);
        let k2 = eq.rate(&add(&s, &k1, 0.5 * h), w_b, &F_B);
        let k3 = eq.rate(&add(&s, &k2, 0.5 * h), w_b, &F_B);
        let k4 = eq.rate(&add(&s, &k3, h), w_b, &F_B);
        let s = add(&add(&s, &k1, h / 6.0), &k2, h / 3.0);
        add(&add(&s, &k3, h / 3.0), &k4, h / 6.0)
    })
}

/// Body rate of the step test, rad/s: small, so that the terms of the Earth stand out.
const SLOW: Vector3<f64> = Vector3::new(0.001, -0.0015, 0.001);

/// Largest departure of one step from the integrated equations: rad, m/s, m.
fn step_error<M: NavModel>(
    eq: &Equations,
    s: &Solution,
    dt: f64,
    pack: fn(&EarthModel, &Solution) -> State,
) -> [f64; 3] {
    let mut model = M::new(eq.earth, s).unwrap();
    model.step(&strap(dt, &SLOW, &F_B)).unwrap();
    let (got, want) = (pack(&eq.earth, &model.solution()), integrate(eq, &pack(&eq.earth, s), dt, &SLOW));
    let d = if eq.axes == Axes::Ecef {
        got.p - want.p
    } else {
        let (m, e) = eq.scale(want.p.x, want.p.z);
        (got.p - want.p).component_mul(&Vector3::new(m, e, 1.0))
    };
    [(got.c - want.c).amax(), (got.v - want.v).amax(), d.amax()]
}

#[test]
fn a_strapdown_step_follows_the_equations_of_motion_to_third_order() {
    let earth = EarthModel::default();
    for lat in [-70.0, 0.0, 45.0, 80.0] {
        for v in VELOCITIES {
            let s = solution([lat, 33.0, 5000.0], v, [20.0, 10.0, 250.0]);
            let ned = Equations { axes: Axes::Ned, earth };
            let ecef = Equations { axes: Axes::Ecef, earth };
            let errors = |dt| {
                [
                    step_error::<Ned>(&ned, &s, dt, |_, s| ned_state(s)),
                    step_error::<Ecef>(&ecef, &s, dt, ecef_state),
                ]
            };
            // what is left: w² f dt³/6 of the rotation, and dt³/12 of the change of acceleration
            let limits = [2e-12, 1e-8, 2e-6];
            for (coarse, fine) in errors(0.2).iter().zip(&errors(0.1)) {
                for i in 0..3 {
                    let (c, f) = (coarse[i], fine[i]);
                    assert!(f <= limits[i], "lat {lat} v {v:?} [{i}]: {f:e}");
                    assert!(c >= 6.0 * f || f < 0.05 * limits[i], "lat {lat} v {v:?} [{i}]: {c:e}, {f:e}");
                }
            }
        }
    }
}

/// Error of one filter against another in the model's own axes, from the packed states.
fn model_error<M: NavModel>(estimate: &M, truth: &M) -> Vector9 {
    let (e, t) = (estimate.pack(), truth.pack());
    let q = |p: &[f64; 10]| common::quaternion(p[6], p[7], p[8], p[9]);
    let phi = attitude::log(&(q(&t) * q(&e).inverse()));
    let d: [f64; 6] = std::array::from_fn(|i| e[i] - t[i]);
    let dp = if M::NAME == "ned" {
        let eq = Equations { axes: Axes::Ned, earth: EarthModel::default() };
        let (m, east) = eq.scale(0.5 * (e[0] + t[0]), 0.5 * (e[2] + t[2]));
        [d[0] * m, d[1] * east, -d[2]]
    } else {
        [d[0], d[1], d[2]]
    };
    Vector9::from_column_slice(&[phi.x, phi.y, phi.z, d[3], d[4], d[5], dp[0], dp[1], dp[2]])
}

/// Columns of Phi for sensor states against filters that believe in parameters a little too large and too small.
fn check_sensor_columns<M: NavModel>(states: usize) {
    let (dt, w, f) = (0.02, Vector3::new(0.2, -0.4, 0.3), Vector3::new(2.0, -5.0, -11.0));
    let settings: Settings = common::settings();
    let s = solution([-40.0, 120.0, 2000.0], [-120.0, 150.0, 30.0], [25.0, -35.0, 160.0]);
    let blocks = common::blocks(states);
    let layout = Layout::<40>::new(&blocks).unwrap();
    let predicted = |state: usize, value: f64| {
        let mut shifted = blocks.clone();
        for (block, (_, start)) in shifted.iter_mut().zip(layout.blocks()) {
            if (start..start + block.kind.len()).contains(&state) {
                block.initial[state - start] = value;
            }
        }
        let mut ekf = Ekf::<M, 40>::new(&settings, &shifted, &common::initial(s)).unwrap();
        ekf.predict(20_000_000, &(w * dt), &(f * dt)).unwrap();
        ekf.model().clone()
    };
    let mut model = M::new(settings.earth, &s).unwrap();
    let dynamics = model.step(&strap(dt, &w, &f)).unwrap();
    let t = common::transition(&dynamics, &layout, &settings.noise, &w, &f, dt, Order::Third);
    for j in 9..layout.len() {
        let x = 0.02;
        // an estimated parameter too small leaves a positive error in the sensor
        let d = model_error(&predicted(j, -x), &predicted(j, x)) / (2.0 * x);
        // Phi is the exact series, the step a trapezoid: its position feels a gyro error by dt³/4, not dt³/6
        let gyro = d.fixed_rows::<3>(0).amax() > 1e-6;
        let limits = [1e-3, 1e-2, if gyro { 0.4 } else { 1e-2 }];
        for (i, want) in d.iter().enumerate() {
            let row = d.fixed_rows::<3>(i / 3 * 3).amax();
            let (got, limit) = (t.top(i, j), limits[i / 3] * row + 1e-9);
            assert!((got - want).abs() <= limit, "{} ({i}, {j}): {got:e}, {want:e}", M::NAME);
        }
    }
}

#[test]
fn sensor_columns_of_phi_are_the_derivative_of_a_predicted_filter() {
    check_sensor_columns::<Ned>(36);
    check_sensor_columns::<Ecef>(36);
    check_sensor_columns::<Ned>(18);
}

/// Navigation columns of Phi against steps from states that differ by one error.
fn check_navigation_columns<M: NavModel>() {
    let (dt, w) = (0.05, Vector3::new(0.1, -0.2, 0.15));
    let earth = EarthModel::default();
    let s = solution([62.0, -20.0, 9000.0], [210.0, -150.0, 40.0], [25.0, -35.0, 160.0]);
    let stepped = |x: &Vector9| {
        let mut model = M::new(earth, &s).unwrap();
        model.correct(x);
        let dynamics = model.step(&strap(dt, &w, &F_B)).unwrap();
        (model, dynamics)
    };
    let dynamics = stepped(&Vector9::zeros()).1;
    let layout = Layout::<16>::new(&[]).unwrap();
    let noise = common::settings().noise;
    let t = common::transition(&dynamics, &layout, &noise, &w, &F_B, dt, Order::Third);
    let mut phi = Matrix9::zeros();
    for j in 0..9 {
        let mut x = Vector9::zeros();
        x[j] = STEP[j / 3];
        let d = model_error(&stepped(&-x).0, &stepped(&x).0) / (2.0 * STEP[j / 3]);
        phi.set_column(j, &d);
    }
    // without the identity, so that small terms show
    for (bi, bj) in (0..9).step_by(3).flat_map(|i| (0..9).step_by(3).map(move |j| (i, j))) {
        let block = |i: usize, j: usize| if i / 3 == j / 3 { Matrix3::identity() } else { Matrix3::zeros() };
        let got = Matrix3::from_fn(|i, j| t.top(bi + i, bj + j)) - block(bi, bj);
        let want = phi.fixed_view::<3, 3>(bi, bj) - block(bi, bj);
        // position feels an attitude error by dt³/4 of the trapezoid instead of dt³/6
        let limit = if (bi, bj) == (6, 0) { 3e-4 } else { 3e-6 };
        let rounding = if bi == 6 { 1e-11 } else { 0.0 };
        assert!(
            (got - want).amax() <= limit * want.amax() + rounding,
            "{} block ({bi}, {bj}): {got:e} {want:e}",
            M::NAME
        );
    }
}

#[test]
fn navigation_columns_of_phi_are_the_derivative_of_the_step() {
    check_navigation_columns::<Ned>();
    check_navigation_columns::<Ecef>();
}
