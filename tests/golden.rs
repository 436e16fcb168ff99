//! The engine against the numbers of an independent dense filter, without Python.
//!
//! `tests/golden/*.json` is written by the numpy reference under `tests/py/reference`, from the equations and not from
//! this crate. State and covariance must agree to 1e-9: of the magnitude of position, velocity and attitude, of the
//! standard deviation of a block state, and of sqrt(P_ii P_jj). What is left is the order of summation.

mod common;

use common::{Log, block};
use gnssins::blocks::{BLOCK_MAX, Block, BlockKind, Process};
use gnssins::cov::Covariance;
use gnssins::discretise::{ImuNoise, Order};
use gnssins::earth::{Ellipsoid, Gravity};
use gnssins::ekf::{Ekf, Initial, Settings};
use gnssins::frames::Lla;
use gnssins::imu::{Calibration, Coning, ImuInput};
use gnssins::layout::Layout;
use gnssins::meas::Status;
use gnssins::meas::gnss::GnssFix;
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::Ned;
use gnssins::nav::{EarthModel, NavModel, Solution};
use gnssins::stream::{Navigator, StreamSettings};
use nalgebra::{DMatrix, Matrix3, Vector3};
use serde_json::Value;

const CAP: usize = 40;

fn read(name: &str) -> Value {
    let path = format!("{}/tests/golden/{name}.json", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{path}: {e}"));
    serde_json::from_str(&text).unwrap()
}

/// A list of numbers; null is NaN.
fn list(v: &Value) -> Vec<f64> {
    v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap_or(f64::NAN)).collect()
}

fn three(v: &Value) -> Vector3<f64> {
    Vector3::from_column_slice(&list(v))
}

fn table(v: &Value) -> Vec<Vec<f64>> {
    v.as_array().unwrap().iter().map(list).collect()
}

fn matrix(v: &Value) -> DMatrix<f64> {
    let rows = table(v);
    DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
}

fn times(v: &Value) -> Vec<i64> {
    v.as_array().unwrap().iter().map(|t| t.as_i64().unwrap()).collect()
}

fn quaternion(v: &Value) -> nalgebra::UnitQuaternion<f64> {
    let q = list(v);
    common::quaternion(q[0], q[1], q[2], q[3])
}

fn place(v: &Value) -> Lla {
    let p = list(v);
    Lla::new(p[0], p[1], p[2])
}

fn kind(name: &str) -> BlockKind {
    use BlockKind::*;
    let all = [
        GyroBias,
        AccelBias,
        GyroScale,
        AccelScale,
        GyroMisalignment,
        AccelMisalignment,
        GnssLeverArm,
        BaroBias,
        GnssPositionError,
        GnssVelocityError,
    ];
    all.into_iter().find(|k| k.name() == name).unwrap()
}

fn blocks(v: &Value) -> Vec<Block> {
    let six = |v: &Value| {
        let mut out = [1.0; BLOCK_MAX];
        let values = list(v);
        out[..values.len()].copy_from_slice(&values);
        out
    };
    let one = |b: &Value| {
        let process = match b["process"].as_str().unwrap() {
            "constant" => Process::Constant,
            "random_walk" => Process::RandomWalk { psd: six(&b["psd"]) },
            _ => Process::GaussMarkov { sd: six(&b["sd"]), tau_s: six(&b["tau_s"]) },
        };
        let kind = kind(b["kind"].as_str().unwrap());
        Block { initial_sd: six(&b["initial_sd"]), initial: six(&b["initial"]), ..block(kind, process, 1.0) }
    };
    v.as_array().unwrap().iter().map(one).collect()
}

fn navigator<M: NavModel>(config: &Value) -> Navigator<M, CAP> {
    let (imu, gnss, start) = (&config["imu"], &config["gnss"], &config["initial"]);
    let gravity = match config["gravity"].as_str().unwrap() {
        "vertical" => Gravity::NormalVertical,
        _ => Gravity::Normal,
    };
    let coning = if config["coning"] == "one-sample" { Coning::OneSample } else { Coning::TwoSample };
    let ellipsoid = Ellipsoid::by_name(config["ellipsoid"].as_str().unwrap()).unwrap();
    let noise = ImuNoise { gyro_psd: three(&imu["gyro_psd"]), accel_psd: three(&imu["accel_psd"]) };
    let settings = Settings {
        earth: EarthModel { ellipsoid, gravity },
        order: Order::from_number(config["phi_order"].as_u64().unwrap() as u8).unwrap(),
        coning,
        lever_b_m: three(&gnss["lever_b_m"]),
        gate_probability: [gnss["gate_probability"].as_f64(); 3],
        ..Settings::new(noise)
    };
    let number = |key: &str| start[key].as_f64().unwrap();
    let initial = Initial {
        t_ns: start["t_ns"].as_i64().unwrap(),
        solution: Solution {
            position: Lla::new(number("lat_rad"), number("lon_rad"), number("height_m")),
            v_n: three(&start["v_n"]),
            q_nb: quaternion(&start["q_nb"]),
        },
        sd_phi: three(&start["sd_phi"]),
        sd_v: three(&start["sd_v"]),
        sd_p: three(&start["sd_p"]),
    };
    let calibration = |bias: &str, m: &str| {
        let m = matrix(&imu[m]);
        Calibration::new(three(&imu[bias]), Matrix3::from_fn(|i, j| m[(i, j)])).unwrap()
    };
    assert_eq!((imu["input"].as_str(), config["model"].as_str()), (Some("increments"), Some(M::NAME)));
    let stream = StreamSettings {
        input: ImuInput::Increments,
        gyro: calibration("gyro_bias", "gyro_matrix"),
        accel: calibration("accel_bias", "accel_matrix"),
        max_gap_ns: imu["max_gap_ns"].as_i64().unwrap(),
        latency_ns: [gnss["latency_ns"].as_i64().unwrap(), 0, 0],
        ..StreamSettings::default()
    };
    Navigator::new(Ekf::new(&settings, &blocks(&config["blocks"]), &initial).unwrap(), stream)
}

fn fixes(gnss: &Value) -> Vec<GnssFix> {
    let (pos, vel) = (table(&gnss["pos"]), table(&gnss["vel"]));
    let var = |v: &Value| -> gnssins::small::Square {
        if v[0].is_array() {
            let m = matrix(v);
            return std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]));
        }
        let d = list(v);
        std::array::from_fn(|i| std::array::from_fn(|j| if i == j { d[i] } else { 0.0 }))
    };
    let one = |(k, t_ns): (usize, i64)| GnssFix {
        t_ns,
        position: pos[k][0].is_finite().then(|| Lla::new(pos[k][0], pos[k][1], pos[k][2])),
        velocity_n: [0, 1, 2].map(|i| Some(vel[k][i]).filter(|v| v.is_finite())),
        covariance: var(&gnss["var"][k]),
        new_constellation: false,
    };
    times(&gnss["t_ns"]).into_iter().enumerate().map(one).collect()
}

/// Largest departures of a run, in units of what 1e-9 is measured against.
#[derive(Default, Debug)]
struct Worst {
    position_m: f64,
    velocity: f64,
    attitude: f64,
    blocks: f64,
    sd: f64,
    covariance: f64,
    innovation: f64,
}

fn check_state(nav: &Navigator<Ned, CAP>, golden: &Value, k: usize, worst: &mut Worst) {
    let (ekf, s) = (nav.ekf(), nav.ekf().solution());
    let want = Solution {
        position: place(&golden["lla"][k]),
        v_n: three(&golden["v_n"][k]),
        q_nb: quaternion(&golden["q_nb"][k]),
    };
    let [phi, dv, dp] = common::error(&s, &want);
    worst.attitude = worst.attitude.max(phi.norm());
    worst.velocity = worst.velocity.max(dv.norm() / want.v_n.norm());
    worst.position_m = worst.position_m.max(dp.norm());
    for (j, want) in list(&golden["x"][k]).iter().enumerate() {
        let sd = ekf.covariance().get(9 + j, 9 + j).sqrt();
        worst.blocks = worst.blocks.max((ekf.params()[9 + j] - want).abs() / sd);
    }
}

fn check_covariance(cov: &Covariance<CAP>, want: &DMatrix<f64>) -> f64 {
    common::distance(&common::dense(cov), want, &want.diagonal())
}

fn check_records(log: &Log, meas: &Value) -> f64 {
    let mut worst = 0.0f64;
    for (k, r) in log.records.iter().enumerate() {
        let status = match meas["status"][k].as_u64() {
            Some(0) => Status::Used,
            _ => Status::Rejected,
        };
        assert_eq!((r.row, r.status, r.dof as u64), (k as u64, status, meas["dof"][k].as_u64().unwrap()));
        worst = worst.max((r.nis / meas["nis"][k].as_f64().unwrap() - 1.0).abs());
        let (y, s) = (list(&meas["innovation"][k]), table(&meas["innovation_cov"][k]));
        for i in 0..6 {
            let present = r.present >> i & 1 == 1;
            assert_eq!(present, y[i].is_finite());
            if present {
                worst = worst.max((r.innovation[i] - y[i]).abs() / s[i][i].sqrt());
                for j in (0..6).filter(|j| r.present >> j & 1 == 1) {
                    worst = worst.max((r.innovation_cov[i][j] - s[i][j]).abs() / (s[i][i] * s[j][j]).sqrt());
                }
            }
        }
    }
    worst
}

fn check_run(name: &str) {
    let golden = read(name);
    let mut nav = navigator::<Ned>(&golden["config"]);
    let (mut log, mut worst) = (Log::default(), Worst::default());
    for z in fixes(&golden["gnss"]) {
        nav.gnss(&z, &mut log).unwrap();
    }
    let (states, sds, covs) =
        (times(&golden["states"]["t_ns"]), times(&golden["sd"]["t_ns"]), times(&golden["cov"]["t_ns"]));
    let (gyro, accel) = (table(&golden["imu"]["gyro"]), table(&golden["imu"]["accel"]));
    let mut compared = [0; 3];
    for (k, t) in times(&golden["imu"]["t_ns"]).into_iter().enumerate() {
        let v = |x: &[f64]| Vector3::from_column_slice(x);
        nav.imu(t, &v(&gyro[k]), &v(&accel[k]), &mut log).unwrap();
        if let Ok(i) = states.binary_search(&t) {
            check_state(&nav, &golden["states"], i, &mut worst);
            compared[0] += 1;
        }
        if let Ok(i) = sds.binary_search(&t) {
            for (j, sd) in list(&golden["sd"]["sd"][i]).iter().enumerate() {
                worst.sd = worst.sd.max((nav.ekf().covariance().get(j, j).sqrt() / sd - 1.0).abs());
            }
            compared[1] += 1;
        }
        if let Ok(i) = covs.binary_search(&t) {
            let want = matrix(&golden["cov"]["cov"][i]);
            worst.covariance = worst.covariance.max(check_covariance(nav.ekf().covariance(), &want));
            compared[2] += 1;
        }
    }
    assert_eq!(compared, [states.len(), sds.len(), covs.len()]);
    assert_eq!(log.records.len(), golden["meas"]["status"].as_array().unwrap().len());
    worst.innovation = check_records(&log, &golden["meas"]);
    // 1e-9 of the Earth's radius would be 6 mm: positions are held to 1e-7 m
    assert!(worst.position_m < 1e-7, "{name}: {worst:?}");
    for value in [worst.velocity, worst.attitude, worst.blocks, worst.sd, worst.covariance] {
        assert!(value < 1e-9, "{name}: {worst:?}");
    }
    // the last bit of a longitude is 3e-9 m, and innovations are differences of positions against some 0.5 m
    assert!(worst.innovation < 2e-8, "{name}: {worst:?}");
}

#[test]
fn ned_18_states_agree_with_the_reference_over_1000_steps() {
    check_run("ned18");
}

#[test]
fn ned_21_states_with_lever_arm_full_noise_and_gate_agree_with_the_reference() {
    check_run("ned21");
}

#[test]
fn every_kind_of_block_agrees_with_the_reference() {
    check_run("ned40");
}

/// Element by element, relative to the largest of its 3x3 block.
fn assert_blocks(got: &DMatrix<f64>, want: &DMatrix<f64>, tolerance: f64, what: &str) {
    assert_eq!(got.shape(), want.shape(), "{what}");
    for i in 0..got.nrows() {
        for j in 0..got.ncols() {
            let scale = want.view((i / 3 * 3, j / 3 * 3), (3, 3)).amax();
            let off = (got[(i, j)] - want[(i, j)]).abs();
            assert!(off <= tolerance * scale + 1e-25, "{what} ({i}, {j}): {} {}", got[(i, j)], want[(i, j)]);
        }
    }
}

fn dynamic<const R: usize, const C: usize>(m: &nalgebra::SMatrix<f64, R, C>) -> DMatrix<f64> {
    DMatrix::from_column_slice(R, C, m.as_slice())
}

fn check_point<M: NavModel>(p: &Value, what: &str) {
    let position = place(&p["lla"]);
    let s = Solution { position, v_n: three(&p["v_n"]), q_nb: quaternion(&p["q_nb"]) };
    let model = M::new(EarthModel::default(), &s).unwrap();
    let golden = &p[M::NAME];
    let near = |got: &DMatrix<f64>, key: &str| {
        assert_blocks(got, &matrix(&golden[key]), 1e-9, &format!("{what} {key}"))
    };
    let d = model.dynamics(&three(&p["f_b"]));
    near(&dynamic(&d.f()), "f");
    near(&dynamic(&d.gyro_coupling()), "gyro");
    near(&dynamic(&d.accel_coupling()), "accel");
    let (lever, w) = (three(&p["lever_b"]), three(&p["w_ib_b"]));
    let aid = model.position_aid(&lever, &position);
    near(&dynamic(&aid.h), "position");
    near(&dynamic(&aid.h_lever), "position_lever");
    let aid = model.velocity_aid(&lever, &w, &s.v_n, Some(&position));
    near(&dynamic(&aid.h), "velocity");
    near(&dynamic(&aid.h_gyro), "velocity_gyro");
    near(&dynamic(&aid.h_lever), "velocity_lever");
}

#[test]
fn jacobians_agree_with_the_reference_element_by_element() {
    for (k, p) in read("jacobians")["points"].as_array().unwrap().iter().enumerate() {
        check_point::<Ned>(p, &format!("NED point {k}"));
        check_point::<Ecef>(p, &format!("ECEF point {k}"));
    }
}

#[test]
fn transition_and_noise_agree_with_the_reference() {
    for (k, c) in read("discretise")["cases"].as_array().unwrap().iter().enumerate() {
        let s = Solution { position: place(&c["lla"]), v_n: three(&c["v_n"]), q_nb: quaternion(&c["q_nb"]) };
        let dynamics = Ned::new(EarthModel::default(), &s).unwrap().dynamics(&three(&c["f_b"]));
        let layout = Layout::<CAP>::new(&blocks(&c["blocks"])).unwrap();
        let (n, dt) = (layout.len(), c["dt_s"].as_f64().unwrap());
        let noise = ImuNoise { gyro_psd: three(&c["gyro_psd"]), accel_psd: three(&c["accel_psd"]) };
        let (w, f) = (three(&c["w_ib_b"]), three(&c["f_b"]));
        for order in 1..=3u8 {
            let t = common::transition(
                &dynamics,
                &layout,
                &noise,
                &w,
                &f,
                dt,
                Order::from_number(order).unwrap(),
            );
            let (phi, _) = common::dense_transition(&t, n);
            assert_blocks(
                &phi,
                &matrix(&c[format!("phi_{order}")]),
                1e-9,
                &format!("case {k} order {order}"),
            );
            if order == 3 {
                let mut cov = Covariance::<CAP>::from_variances(&[0.0; CAP], n);
                cov.predict(&t);
                assert_blocks(
                    &common::dense(&cov),
                    &matrix(&c["qd_trapezoid"]),
                    1e-9,
                    &format!("case {k} noise"),
                );
            }
        }
    }
}
