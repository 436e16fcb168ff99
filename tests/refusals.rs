//! What a filter refuses: settings, starts, input; by name, and with nothing changed.

mod common;

use common::{DT_NS, block, blocks, bytes, filter, fix, initial, markov, settings, solution, walk};
use gnssins::blocks::{Block, BlockKind, Process};
use gnssins::discretise::Order;
use gnssins::ekf::{Ekf, Initial, Settings};
use gnssins::error::Error;
use gnssins::frames::Lla;
use gnssins::meas::{BadReason, Status};
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::{LATITUDE_LIMIT_RAD, Ned};
use gnssins::nav::{NavModel, Solution};
use nalgebra::Vector3;

const STILL: Vector3<f64> = Vector3::new(0.0, 0.0, 0.0);
const WEIGHT: Vector3<f64> = Vector3::new(0.0, 0.0, -0.098);

fn somewhere() -> Solution {
    solution([45.0, 10.0, 300.0], [20.0, 5.0, -1.0], [1.0, 2.0, 30.0])
}

fn made<M: NavModel>(set: &Settings, blocks: &[Block], start: &Initial) -> Result<Ekf<M, 24>, Error> {
    Ekf::new(set, blocks, start)
}

/// The name in the error of a filter that cannot be made.
fn name_of(change: impl Fn(&mut Settings, &mut Vec<Block>, &mut Initial)) -> &'static str {
    let (mut set, mut list, mut start) = (settings(), blocks(15), initial(somewhere()));
    change(&mut set, &mut list, &mut start);
    let error = made::<Ned>(&set, &list, &start).expect_err("refused");
    assert!(made::<Ecef>(&set, &list, &start).is_err(), "{error}");
    assert_eq!(error.code(), "config.range");
    assert!(!error.hint().is_empty());
    match error {
        Error::Config { what, .. } => what,
        other => panic!("{other}"),
    }
}

#[test]
fn bad_settings_are_refused_by_name() {
    for bad in [-1e-9, f64::NAN, f64::INFINITY] {
        assert_eq!(name_of(|s, _, _| s.noise.gyro_psd.y = bad), "imu.gyro noise density");
        assert_eq!(name_of(|s, _, _| s.noise.accel_psd.z = bad), "imu.accel noise density");
    }
    for bad in [0.0, 1.0, -0.5, 1.5, f64::NAN] {
        assert_eq!(name_of(|s, _, _| s.gate_probability[0] = Some(bad)), "gnss.gate_probability");
    }
    assert_eq!(name_of(|s, _, _| s.lever_b_m.x = f64::NAN), "gnss.lever_ba_b_m");
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(name_of(|_, _, i| i.sd_phi.x = bad), "initial attitude sigma");
        assert_eq!(name_of(|_, _, i| i.sd_v.y = bad), "initial velocity sigma");
        assert_eq!(name_of(|_, _, i| i.sd_p.z = bad), "initial position sigma");
        assert_eq!(name_of(|_, b, _| b[0].initial_sd[2] = bad), "block.initial_sd");
        assert_eq!(name_of(|_, b, _| b[0].process = walk(bad)), "block.psd");
        assert_eq!(name_of(|_, b, _| b[1].process = markov(bad, 10.0)), "block.sd");
        assert_eq!(name_of(|_, b, _| b[1].process = markov(1.0, bad)), "block.tau_s");
    }
    assert_eq!(name_of(|_, b, _| b[1].initial[0] = f64::NAN), "block.initial");
    assert!(matches!(Order::from_number(4), Err(Error::Config { what: "filter.phi_order", .. })));
    assert_eq!(Order::from_number(2), Ok(Order::Second));
}

#[test]
fn too_many_states_or_blocks_are_refused_with_need_and_capacity() {
    let error = made::<Ned>(&settings(), &blocks(36), &initial(somewhere())).expect_err("refused");
    assert_eq!(error, Error::Capacity { need: 36, capacity: 24 });
    let many = [block(BlockKind::BaroBias, Process::Constant, 1.0); 17];
    let error = Ekf::<Ned, 40>::new(&settings(), &many, &initial(somewhere())).expect_err("refused");
    assert!(matches!(error, Error::Config { what: "filter.block (count)", got: 17.0, .. }), "{error}");
}

#[test]
fn scale_factors_that_cannot_be_inverted_are_refused() {
    let mut list = vec![block(BlockKind::GyroScale, Process::Constant, 0.1)];
    list[0].initial[1] = -1.0;
    assert!(matches!(made::<Ned>(&settings(), &list, &initial(somewhere())), Err(Error::Config { .. })));
}

#[test]
fn bad_starts_are_refused_by_both_models() {
    let refused = |change: &dyn Fn(&mut Solution)| {
        let mut s = somewhere();
        change(&mut s);
        let start = initial(s);
        let ned = made::<Ned>(&settings(), &[], &start).map(|e| e.solution());
        let ecef = made::<Ecef>(&settings(), &[], &start).map(|e| e.solution());
        assert!(ned.is_err(), "NED took {s:?} as {ned:?}");
        assert!(ecef.is_err(), "ECEF took {s:?} as {ecef:?}");
    };
    for bad in [f64::NAN, f64::INFINITY] {
        refused(&|s| s.position.lat_rad = bad);
        refused(&|s| s.position.lon_rad = bad);
        refused(&|s| s.position.height_m = bad);
        refused(&|s| s.v_n.x = bad);
        refused(&|s| s.q_nb = common::quaternion(bad, 0.0, 0.0, 0.0));
    }
    // degrees where radians belong
    refused(&|s| s.position.lat_rad = 45.0);
    // no attitude at all
    refused(&|s| s.q_nb = common::quaternion(0.0, 0.0, 0.0, 0.0));
}

/// Both models, every bad input: an error, and not one bit changed.
fn check_input<M: NavModel>() {
    let mut ekf = filter::<M, 24>(15, somewhere());
    ekf.predict(DT_NS, &STILL, &WEIGHT).unwrap();
    let before = bytes(&ekf);
    for i in 0..3 {
        for bad in [f64::NAN, f64::INFINITY, -f64::INFINITY] {
            let mut v = WEIGHT;
            v[i] = bad;
            for result in [ekf.predict(2 * DT_NS, &v, &WEIGHT), ekf.predict(2 * DT_NS, &STILL, &v)] {
                assert!(
                    matches!(result, Err(Error::NonFinite { t_ns, .. }) if t_ns == 2 * DT_NS),
                    "{result:?}"
                );
                assert_eq!(result.unwrap_err().code(), "state.non_finite");
            }
            assert_eq!(bytes(&ekf), before);
        }
    }
    for t_ns in [DT_NS, 0, i64::MIN] {
        let result = ekf.predict(t_ns, &STILL, &WEIGHT);
        assert!(matches!(result, Err(Error::TimeBackwards { previous_ns: DT_NS, .. })), "{result:?}");
    }
    assert_eq!(bytes(&ekf), before);
    ekf.predict(2 * DT_NS, &STILL, &WEIGHT).unwrap();
}

#[test]
fn input_that_is_not_finite_or_not_later_is_an_error_and_leaves_the_state() {
    check_input::<Ned>();
    check_input::<Ecef>();
}

fn check_huge<M: NavModel>() {
    for power in (3..300).step_by(3) {
        let big = 10f64.powi(power);
        let mut ekf = filter::<M, 24>(15, somewhere());
        for k in 1..4 {
            let _ = ekf.predict(k * DT_NS, &Vector3::repeat(big), &Vector3::repeat(-big));
            if ekf.update(0, &fix(ekf.t_ns(), &somewhere(), 1.0, 0.1)).is_err() {
                break; // a covariance that has overflowed: the filter is over, and says so
            }
            let s = ekf.solution();
            assert!(s.position.is_valid() && s.v_n.iter().all(|v| v.is_finite()), "{big:e}: {s:?}");
            assert!(s.q_nb.coords.iter().all(|v| v.is_finite()), "{big:e}: {s:?}");
        }
    }
}

#[test]
fn huge_input_never_leaves_a_state_that_is_not_finite() {
    check_huge::<Ned>();
    check_huge::<Ecef>();
}

#[test]
fn ned_refuses_the_last_tenth_of_a_degree_where_ecef_goes_on() {
    for lat in [89.91, -89.95, 90.0] {
        let start = initial(solution([lat, 0.0, 0.0], [0.0; 3], [0.0; 3]));
        let error = made::<Ned>(&settings(), &[], &start).expect_err("refused");
        assert_eq!(error.code(), "state.latitude");
        assert!(error.hint().contains("ecef"));
        made::<Ecef>(&settings(), &[], &start).unwrap();
    }
    // 30 m before the limit, northwards at 100 m/s
    let lat = LATITUDE_LIMIT_RAD.to_degrees() - 30.0 / 111_000.0;
    let s = solution([lat, 0.0, 0.0], [100.0, 0.0, 0.0], [0.0; 3]);
    let (mut ned, mut ecef) = (filter::<Ned, 24>(15, s), filter::<Ecef, 24>(15, s));
    let mut refused_at = 0;
    for k in 1..=100 {
        let before = bytes(&ned);
        ecef.predict(k * DT_NS, &STILL, &WEIGHT).unwrap();
        if let Err(error) = ned.predict(k * DT_NS, &STILL, &WEIGHT) {
            assert_eq!(error.code(), "state.latitude");
            assert_eq!(bytes(&ned), before);
            refused_at = k;
            break;
        }
    }
    assert!((25..40).contains(&refused_at), "{refused_at}");
}

#[test]
fn late_and_bad_fixes_are_recorded_with_their_reason_and_change_nothing() {
    let mut ekf = filter::<Ned, 24>(15, somewhere());
    ekf.predict(DT_NS, &STILL, &WEIGHT).unwrap();
    let before = bytes(&ekf);
    let good = fix(DT_NS, &somewhere(), 1.0, 0.1);
    let mut status = |change: &dyn Fn(&mut gnssins::meas::gnss::GnssFix)| {
        let mut z = good;
        change(&mut z);
        let record = ekf.update(9, &z).unwrap();
        assert_eq!((record.row, record.t_ns, record.dof), (9, z.t_ns, 0));
        assert_eq!(bytes(&ekf), before);
        record.status
    };
    assert_eq!(status(&|z| z.t_ns -= 1), Status::Late);
    let bad = |reason| Status::Bad(reason);
    assert_eq!(status(&|z| (z.position, z.velocity_n) = (None, [None; 3])), bad(BadReason::Empty));
    assert_eq!(status(&|z| z.position = Some(Lla::new(0.0, 0.0, 10.0))), bad(BadReason::NoFix));
    for p in [
        Lla::new(1.6, 0.0, 0.0),
        Lla::new(f64::NAN, 0.0, 0.0),
        Lla::new(0.5, f64::INFINITY, 0.0),
        Lla::new(0.5, 0.1, f64::NAN),
    ] {
        assert_eq!(status(&|z| z.position = Some(p)), bad(BadReason::Value));
    }
    for v in [f64::NAN, 1e7] {
        assert_eq!(status(&|z| z.velocity_n[2] = Some(v)), bad(BadReason::Value));
    }
    for (i, j, value) in [
        (0, 0, 0.0),
        (3, 3, -0.01),
        (5, 5, f64::NAN),
        (2, 2, f64::INFINITY),
        (0, 1, 0.2), // asymmetric: its mirror stays 0
        (4, 1, f64::NAN),
        (2, 2, 1e-18), // a nanometre: beyond the digits of a prior of a metre
    ] {
        assert_eq!(status(&|z| z.covariance[i][j] = value), bad(BadReason::Covariance), "({i}, {j}) {value}");
    }
    // symmetric, but correlated beyond one
    let beyond = |z: &mut gnssins::meas::gnss::GnssFix| (z.covariance[0][1], z.covariance[1][0]) = (1.1, 1.1);
    assert_eq!(status(&beyond), bad(BadReason::Covariance));
}

#[test]
fn a_fix_from_the_future_is_not_used() {
    let mut ekf = filter::<Ned, 24>(15, somewhere());
    ekf.predict(DT_NS, &STILL, &WEIGHT).unwrap();
    let before = bytes(&ekf);
    let result = ekf.update(0, &fix(DT_NS + 1_000_000_000, &somewhere(), 1.0, 0.1));
    assert!(!matches!(result, Ok(record) if record.status == Status::Used), "{result:?}");
    assert_eq!(bytes(&ekf), before);
}

#[test]
fn a_position_that_is_known_to_a_thousand_kilometres_ends_the_run() {
    fn check<M: NavModel>() {
        let mut start = initial(somewhere());
        start.sd_v = Vector3::repeat(20_000.0);
        let mut ekf = Ekf::<M, 16>::new(&settings(), &[], &start).unwrap();
        let ended = (1..=10_000).find_map(|k| ekf.predict(k * DT_NS, &STILL, &WEIGHT).err().map(|e| (k, e)));
        // 20 km/s make a thousand kilometres in 50 s
        let (k, error) = ended.unwrap();
        assert!(matches!(error, Error::Unbounded { sd_m, .. } if sd_m > 1e6), "{error}");
        assert!((4900..5300).contains(&k), "{k}");
    }
    check::<Ned>();
    check::<Ecef>();
}
