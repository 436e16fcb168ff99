//! Barometer and heading: rows against central differences, streams with several sources, saved queues.

mod common;

use common::equations::{ATTITUDES, LATITUDES};
use common::{DEG, DT_NS, Log, block, diagonal, fix, initial, markov, settings, solution, walk};
use gnssins::blocks::{Block, BlockKind};
use gnssins::bytes::{Reader, Writer};
use gnssins::ekf::{Ekf, Settings};
use gnssins::layout::Layout;
use gnssins::meas::baro::BaroHeight;
use gnssins::meas::gnss::GnssFix;
use gnssins::meas::heading::Heading;
use gnssins::meas::{BadReason, Measurement, Observation, Source, Status, View};
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::Ned;
use gnssins::nav::{EarthModel, NavModel, Vector9};
use gnssins::stream::{EventKind, Navigator, StreamSettings};
use nalgebra::Vector3;

const CAP: usize = 32;
const PLACE: [f64; 3] = [50.0, 10.0, 400.0];

fn with_baro() -> Vec<Block> {
    let mut list = common::blocks(15);
    list.push(block(BlockKind::BaroBias, walk(1e-3), 4.0));
    list
}

/// A row of a measurement of one component: y and H.
fn row<M: NavModel>(
    model: &M,
    layout: &Layout<CAP>,
    params: &[f64; CAP],
    z: &impl Measurement,
) -> (f64, [f64; CAP]) {
    let view = View { model, layout, params, lever_b_m: Vector3::zeros(), w_ib_b: Vector3::zeros() };
    let rows = z.rows(&view).unwrap();
    assert_eq!((rows.len, rows.component[0]), (1, 0));
    (rows.y[0], rows.h[0])
}

fn check_rows<M: NavModel>(latitudes: &[f64], z: &impl Measurement, steep: f64) {
    let layout = Layout::<CAP>::new(&with_baro()).unwrap();
    let baro = layout.find(BlockKind::BaroBias).unwrap();
    let mut checked = 0;
    for &lat in latitudes {
        for &[r, p, h] in ATTITUDES.iter().filter(|a| a[1].abs() <= steep) {
            let start = solution([lat, 100.0, 3000.0], [120.0, -80.0, 5.0], [r, p, h]);
            let model = M::new(EarthModel::default(), &start).unwrap();
            let params = [0.0; CAP];
            let (_, got) = row(&model, &layout, &params, z);
            for (j, got) in got.iter().enumerate().take(layout.len()) {
                let step = [1e-5, 1.0, 50.0].get(j / 3).copied().unwrap_or(0.1);
                let y = |sign: f64| {
                    let (mut estimate, mut params) = (model.clone(), params);
                    if j < 9 {
                        // the estimate gets the error: the opposite of a correction
                        let mut x = Vector9::zeros();
                        x[j] = -sign * step;
                        estimate.correct(&x);
                    } else {
                        params[j] -= sign * step;
                    }
                    row(&estimate, &layout, &params, z).0
                };
                let want = (y(1.0) - y(-1.0)) / (2.0 * step);
                // heading wraps where the two lie on both sides of south
                let scale = if j < 3 { 1.0 + 1.0 / (p * DEG).cos().powi(3) } else { 1.0 };
                let near = (got - want).abs() < 2e-6 * scale;
                assert!(near, "{} lat {lat} attitude {r} {p} {h} state {j}: {got} {want}", M::NAME);
                checked += 1;
            }
            assert_eq!(got[baro] != 0.0, z.source() == Source::Baro);
        }
    }
    assert!(checked > 100);
}

#[test]
fn rows_of_height_and_heading_match_central_differences_at_all_attitudes() {
    let height = BaroHeight { t_ns: 0, height_m: 2990.0, variance: 0.5 };
    check_rows::<Ned>(&LATITUDES, &height, f64::INFINITY);
    check_rows::<Ecef>(&LATITUDES, &height, f64::INFINITY);
    let heading = Heading { t_ns: 0, heading_rad: 0.3, variance: 1e-6 };
    check_rows::<Ned>(&LATITUDES, &heading, 80.0);
    check_rows::<Ecef>(&LATITUDES, &heading, 80.0);
}

#[test]
fn worked_numbers_of_height_and_heading() {
    let layout = Layout::<CAP>::new(&with_baro()).unwrap();
    let start = solution([10.0, 20.0, 1000.0], [0.0; 3], [0.0, 0.0, 175.0]);
    let model = Ned::new(EarthModel::default(), &start).unwrap();
    let mut params = [0.0; CAP];
    let baro = layout.find(BlockKind::BaroBias).unwrap();
    params[baro] = 3.0;
    // the altimeter is believed to read 3 m too high: 1000 + 3 - 1005
    let (y, h) = row(&model, &layout, &params, &BaroHeight { t_ns: 0, height_m: 1005.0, variance: 1.0 });
    assert!((y + 2.0).abs() < 1e-9);
    assert_eq!((h[8], h[baro], h[6]), (-1.0, -1.0, 0.0));
    // 175 deg against -175 deg: 10 deg short, the short way round; level, an error about down turns the heading by -1
    let (y, h) =
        row(&model, &layout, &params, &Heading { t_ns: 0, heading_rad: -175.0 * DEG, variance: 1.0 });
    assert!((y + 10.0 * DEG).abs() < 1e-12, "{}", y / DEG);
    assert!((h[2] + 1.0).abs() < 1e-12 && h[0].abs() < 1e-12 && h[1].abs() < 1e-12);
}

#[test]
fn values_that_are_none_are_bad_and_change_nothing() {
    let upright = solution(PLACE, [0.0; 3], [0.0, 88.0, 0.0]);
    let mut ekf = Ekf::<Ned, 24>::new(&settings(), &with_baro(), &initial(upright)).unwrap();
    let before = common::bytes(&ekf);
    let height = |height_m, variance| Observation::Baro(BaroHeight { t_ns: 0, height_m, variance });
    let heading = |heading_rad, variance| Observation::Heading(Heading { t_ns: 0, heading_rad, variance });
    for (z, reason) in [
        (height(f64::NAN, 1.0), BadReason::Value),
        (height(f64::INFINITY, 1.0), BadReason::Value),
        (height(2e6, 1.0), BadReason::Value),
        (height(1.0, 0.0), BadReason::Covariance),
        (height(1.0, -1.0), BadReason::Covariance),
        (height(1.0, f64::NAN), BadReason::Covariance),
        (heading(f64::NAN, 1.0), BadReason::Value),
        (heading(100.0, 1.0), BadReason::Value),
        (heading(1.0, 0.0), BadReason::Covariance),
        // the nose points at the zenith: there is no heading
        (heading(1.0, 1.0), BadReason::Vertical),
    ] {
        let record = ekf.update(0, &z).unwrap();
        assert_eq!(record.status, Status::Bad(reason), "{z:?}");
        assert_eq!(record.source, z.source());
        assert_eq!(common::bytes(&ekf), before);
    }
}

#[test]
fn a_bias_of_the_altimeter_is_found_with_fixes_and_carries_the_height_without() {
    let place = solution(PLACE, [0.0; 3], [0.0; 3]);
    let mut ekf = Ekf::<Ned, 24>::new(&settings(), &with_baro(), &initial(place)).unwrap();
    let baro = ekf.layout().find(BlockKind::BaroBias).unwrap();
    let weight = EarthModel::default().ellipsoid.gravity_n(
        EarthModel::default().gravity,
        place.position.lat_rad.sin(),
        place.position.lat_rad.cos(),
        place.position.height_m,
    );
    let w_ie = EarthModel::default()
        .ellipsoid
        .earth_rate_n(place.position.lat_rad.sin(), place.position.lat_rad.cos());
    let mut sd_with = 0.0;
    for k in 1..=12_000 {
        ekf.predict(k * DT_NS, &(w_ie * 0.01), &(-weight * 0.01)).unwrap();
        if k % 100 == 0 {
            let height_m = place.position.height_m + 7.0;
            ekf.update(0, &BaroHeight { t_ns: k * DT_NS, height_m, variance: 0.25 }).unwrap();
            if k <= 6000 {
                ekf.update(0, &fix(k * DT_NS, &place, 2.0, 0.1)).unwrap();
                sd_with = ekf.solution_sd().position_m.z;
            }
        }
    }
    assert!((ekf.params()[baro] - 7.0).abs() < 0.05, "{}", ekf.params()[baro]);
    assert!((ekf.solution().position.height_m - place.position.height_m).abs() < 0.05);
    // a minute without fixes: the height stays known, the position does not
    let sd = ekf.solution_sd().position_m;
    assert!(sd.z < 1.5 * sd_with && sd.x > 3.0 * sd_with, "{sd} {sd_with}");
}

fn navigator(latency_ns: [i64; 3], gates: [Option<f64>; 3]) -> Navigator<Ned, 24> {
    let start = solution(PLACE, [0.0; 3], [0.0, 0.0, 40.0]);
    let set = Settings { gate_probability: gates, ..settings() };
    let ekf = Ekf::new(&set, &with_baro(), &initial(start)).unwrap();
    let input = gnssins::imu::ImuInput::MeanRates;
    Navigator::new(ekf, StreamSettings { input, latency_ns, ..StreamSettings::default() })
}

fn imu(nav: &mut Navigator<Ned, 24>, k: i64, log: &mut Log) {
    nav.imu(k * DT_NS, &Vector3::zeros(), &Vector3::new(0.0, 0.0, -9.81), log).unwrap();
}

fn height(t_ns: i64, height_m: f64) -> Observation {
    Observation::Baro(BaroHeight { t_ns, height_m, variance: 0.25 })
}

fn heading(t_ns: i64, deg: f64) -> Observation {
    Observation::Heading(Heading { t_ns, heading_rad: deg * DEG, variance: 1e-4 })
}

fn position(t_ns: i64) -> Observation {
    Observation::Gnss(fix(t_ns, &solution(PLACE, [0.0; 3], [0.0; 3]), 1.0, 0.1))
}

#[test]
fn every_source_has_its_own_rows_gate_latency_and_counts() {
    let mut nav = navigator([10_000_000, 20_000_000, 0], [Some(0.999), Some(0.999), None]);
    let mut log = Log::default();
    imu(&mut nav, 0, &mut log);
    imu(&mut nav, 1, &mut log);
    // stamps of one epoch come out in the order of the sources, each less its latency
    for z in
        [heading(5 * DT_NS, 40.0), height(7 * DT_NS, 400.0), position(6 * DT_NS), height(8 * DT_NS, 900.0)]
    {
        nav.aid(&z, &mut log).unwrap();
    }
    assert!(log.records.is_empty());
    (2..8).for_each(|k| imu(&mut nav, k, &mut log));
    nav.aid(&height(5 * DT_NS, 400.0), &mut log).unwrap();
    // far off, but headings have no gate here
    nav.aid(&heading(7 * DT_NS, 140.0), &mut log).unwrap();
    nav.aid(&heading(99 * DT_NS, 40.0), &mut log).unwrap();
    nav.finish(&mut log);

    let seen: Vec<_> = log.records.iter().map(|r| (r.source, r.row, r.t_ns / DT_NS, r.status)).collect();
    use Source::{Baro, Gnss};
    assert_eq!(
        seen,
        [
            (Gnss, 0, 5, Status::Used),
            (Baro, 0, 5, Status::Used),
            (Source::Heading, 0, 5, Status::Used),
            (Baro, 1, 6, Status::Rejected),
            (Baro, 2, 3, Status::Late),
            (Source::Heading, 1, 7, Status::Used),
            (Source::Heading, 2, 99, Status::Late),
        ]
    );
    let events: Vec<_> = log.events.iter().map(|e| (e.kind, e.row, e.kind.code())).collect();
    assert_eq!(
        events,
        [
            (EventKind::AidRejected(Baro), 1, "baro.rejected"),
            (EventKind::AidLate(Baro), 2, "baro.late"),
            (EventKind::AidAfterEnd(Source::Heading), 2, "heading.after_end"),
        ]
    );
    for (source, want) in
        [(Gnss, [1, 1, 0, 0, 0]), (Baro, [3, 1, 1, 1, 0]), (Source::Heading, [3, 2, 0, 1, 0])]
    {
        let c = nav.counts(source);
        assert_eq!([c.total, c.used, c.rejected, c.late, c.bad], want, "{source:?}");
    }
}

#[test]
fn an_aid_is_fused_at_its_own_epoch_inside_an_interval() {
    let mut nav = navigator([0; 3], [None; 3]);
    let mut by_hand = nav.clone();
    imu(&mut nav, 0, &mut Log::default());
    imu(&mut nav, 1, &mut Log::default());
    nav.aid(&height(DT_NS + DT_NS / 4, 395.0), &mut ()).unwrap();
    imu(&mut nav, 2, &mut Log::default());
    imu(&mut by_hand, 0, &mut Log::default());
    imu(&mut by_hand, 1, &mut Log::default());
    let mut ekf = by_hand.ekf().clone();
    let f = Vector3::new(0.0, 0.0, -9.81);
    let quarter = DT_NS / 4;
    ekf.predict(DT_NS + quarter, &Vector3::zeros(), &(f * 0.0025)).unwrap();
    ekf.update(0, &height(DT_NS + quarter, 395.0)).unwrap();
    ekf.predict(2 * DT_NS, &Vector3::zeros(), &(f * 0.0075)).unwrap();
    let (a, b) = (nav.ekf().solution(), ekf.solution());
    assert!((a.position.height_m - b.position.height_m).abs() < 1e-9);
    assert!((nav.ekf().covariance().get(8, 8) - ekf.covariance().get(8, 8)).abs() < 1e-12);
}

#[test]
fn a_saved_queue_with_all_sources_goes_on_with_the_same_bits() {
    let mut nav = navigator([0; 3], [Some(0.999); 3]);
    let mut log = Log::default();
    (0..12).for_each(|k| imu(&mut nav, k, &mut log));
    let mut z = GnssFix {
        new_constellation: true,
        ..fix(13 * DT_NS, &solution(PLACE, [0.0; 3], [0.0; 3]), 1.0, 0.1)
    };
    z.velocity_n[1] = None;
    for z in [height(14 * DT_NS, 401.0), heading(13 * DT_NS, 41.0), Observation::Gnss(z)] {
        nav.aid(&z, &mut log).unwrap();
    }
    let mut saved = vec![0; nav.saved_len()];
    let mut writer = Writer::new(&mut saved);
    nav.save(&mut writer).unwrap();
    let len = writer.len();
    let mut other = navigator([0; 3], [Some(0.999); 3]);
    other.restore(&mut Reader::new(&saved[..len])).unwrap();
    let run = |mut nav: Navigator<Ned, 24>| {
        let mut log = Log::default();
        (12..20).for_each(|k| imu(&mut nav, k, &mut log));
        (common::bytes(nav.ekf()), log.records, nav.counts(Source::Heading))
    };
    let (a, b) = (run(nav), run(other));
    assert_eq!(a, b);
    assert_eq!(a.1.len(), 3);
    // a source that does not exist: the second word of the first row that waits, a height
    let first = len / 8 - 2 * (3 + 2) - (4 + 6 + 36);
    let mut spoilt = saved.clone();
    spoilt[8 * (first + 1)..8 * (first + 2)].copy_from_slice(&9u64.to_le_bytes());
    let mut fresh = navigator([0; 3], [Some(0.999); 3]);
    assert!(fresh.restore(&mut Reader::new(&spoilt[..len])).is_err());
}

#[test]
fn errors_of_the_receiver_are_correlated_over_the_way_at_the_ground_speed() {
    let slow = Block {
        distance_m: 250_000.0,
        jump_sd: [3.0, 3.0, 5.0, 0.0, 0.0, 0.0],
        ..block(BlockKind::GnssPositionError, markov(6.0, 2000.0), 6.0)
    };
    for v_e in [0.0, 250.0] {
        // level flight: the vertical speed is not part of the way
        let start = solution(PLACE, [0.0, v_e, -30.0], [0.0; 3]);
        let mut ekf = Ekf::<Ned, 16>::new(&settings(), &[slow], &initial(start)).unwrap();
        // make the state known, so that its variance has somewhere to go back to
        for _ in 0..400 {
            let mut z = fix(0, &start, 0.01, 0.01);
            z.covariance = diagonal([0.01, 0.01, 0.01, 1.0, 1.0, 1.0]);
            ekf.update(0, &z).unwrap();
        }
        // after so many fixes position and error share what is left of their variances
        let before = ekf.covariance().get(9, 9);
        for k in 1..=100 {
            ekf.predict(k * DT_NS, &Vector3::zeros(), &Vector3::zeros()).unwrap();
        }
        let speed = ekf.solution().v_n.xy().norm();
        let rate = 1.0 / 2000.0 + 0.5 * (v_e + speed) / 250_000.0;
        let want = 36.0 - (36.0 - before) * (-2.0 * rate).exp();
        let got = ekf.covariance().get(9, 9);
        assert!((got - want).abs() < 1e-6 * want, "{v_e}: {got} {want}");
        assert!(got - before > 1e-3);

        // a change of the constellation adds its variance once, and only where it is told
        let mut z = fix(100 * DT_NS, &start, 1e4, 1e4);
        let p = |ekf: &Ekf<Ned, 16>| [9, 10, 11].map(|i| ekf.covariance().get(i, i));
        let plain = p(&ekf);
        ekf.update(0, &z).unwrap();
        assert!(p(&ekf).iter().zip(plain).all(|(a, b)| (a - b).abs() < 1e-4 * b));
        z.new_constellation = true;
        ekf.update(0, &z).unwrap();
        for ((a, b), jump) in p(&ekf).iter().zip(plain).zip([9.0, 9.0, 25.0]) {
            assert!((a - b - jump).abs() < 1e-3, "{a} {b} {jump}");
        }
    }
}
