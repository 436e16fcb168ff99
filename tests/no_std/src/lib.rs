//! The engine as a static library for a machine without an operating system.
//!
//! The crate has no allocator, so it links only if nothing below it brings in `std` or asks for a heap. Its panic
//! handler calls a function that does not exist, so it links only if no call in it can panic: neither the filter nor the
//! stream, whatever they are fed. `main.c` calls it and checks the answers.
#![no_std]

use core::hint::black_box;
use core::panic::PanicInfo;

use gnssins::attitude;
use gnssins::blocks::{Block, BlockKind, Process};
use gnssins::bytes::{Reader, Writer};
use gnssins::discretise::ImuNoise;
use gnssins::ekf::{Ekf, Initial, Settings};
use gnssins::error::Error;
use gnssins::frames::Lla;
use gnssins::imu::Rates;
use gnssins::meas::baro::BaroHeight;
use gnssins::meas::gnss::GnssFix;
use gnssins::meas::heading::Heading;
use gnssins::meas::{Record, Status};
use gnssins::nav::{EarthModel, NavModel, Solution, ecef::Ecef, ned::Ned};
use gnssins::stream::{Event, Navigator, Sink, StreamSettings};
use nalgebra::{UnitQuaternion, Vector3};

/// States of the filter (9 + 3 + 3 + 1), a multiple of 8.
const CAP: usize = 16;
const STEP_NS: i64 = 10_000_000;
const STEPS_PER_FIX: u32 = 100;

unsafe extern "C" {
    /// Nowhere defined: a linker that asks for it has found a path to a panic.
    safe fn gnssins_can_panic() -> !;
}

#[panic_handler]
fn on_panic(_: &PanicInfo<'_>) -> ! {
    gnssins_can_panic()
}

/// Position error (m) after `seconds` at rest with 100 Hz increments and 1 Hz fixes, from a start that is 5 m off;
/// -1 when the engine returns an error.
#[unsafe(no_mangle)]
pub extern "C" fn gnssins_parked_ned(seconds: u32) -> f64 {
    filtered::<Ned>(seconds).unwrap_or(-1.0)
}

/// As [`gnssins_parked_ned`] with the ECEF model.
#[unsafe(no_mangle)]
pub extern "C" fn gnssins_parked_ecef(seconds: u32) -> f64 {
    filtered::<Ecef>(seconds).unwrap_or(-1.0)
}

/// As [`gnssins_parked_ned`], through the stream, with a barometer and headings.
#[unsafe(no_mangle)]
pub extern "C" fn gnssins_streamed_ned(seconds: u32) -> f64 {
    streamed::<Ned>(seconds).unwrap_or(-1.0)
}

/// As [`gnssins_streamed_ned`] with the ECEF model.
#[unsafe(no_mangle)]
pub extern "C" fn gnssins_streamed_ecef(seconds: u32) -> f64 {
    streamed::<Ecef>(seconds).unwrap_or(-1.0)
}

/// Where the vehicle stands, and what its sensors say there.
struct Parked {
    truth: Lla,
    /// Angle per metre north and east.
    per_m: [f64; 2],
    rates: Rates,
    fix: GnssFix,
}

impl Parked {
    fn new(earth: &EarthModel) -> Self {
        let truth = Lla { lat_rad: 0.85, lon_rad: 0.16, height_m: 320.0 };
        let (sin_lat, cos_lat) = gnssins::math::sin_cos(truth.lat_rad);
        let radii = earth.ellipsoid.radii(sin_lat);
        let (m, n) = (radii.meridian_m + truth.height_m, radii.prime_vertical_m + truth.height_m);
        let q_bn = attitude::exp(&Vector3::zeros());
        let gravity = earth.ellipsoid.gravity_n(earth.gravity, sin_lat, cos_lat, truth.height_m);
        let mut covariance = [[0.0; 6]; 6];
        for (i, row) in covariance.iter_mut().enumerate() {
            row[i] = if i < 3 { 0.25 } else { 0.0025 };
        }
        Self {
            truth,
            per_m: [1.0 / m, 1.0 / (n * cos_lat)],
            rates: Rates {
                gyro: q_bn * earth.ellipsoid.earth_rate_n(sin_lat, cos_lat),
                accel: q_bn * -gravity,
            },
            fix: GnssFix {
                t_ns: 0,
                position: Some(truth),
                velocity_n: [Some(0.0); 3],
                covariance,
                new_constellation: false,
            },
        }
    }

    fn error_m(&self, p: &Lla) -> f64 {
        let (north, east) = (p.lat_rad - self.truth.lat_rad, p.lon_rad - self.truth.lon_rad);
        Vector3::new(north / self.per_m[0], east / self.per_m[1], p.height_m - self.truth.height_m).norm()
    }

    fn filter<M: NavModel>(&self, earth: EarthModel) -> Result<Ekf<M, CAP>, Error> {
        let start = Lla {
            lat_rad: self.truth.lat_rad + 3.0 * self.per_m[0],
            lon_rad: self.truth.lon_rad - 4.0 * self.per_m[1],
            height_m: self.truth.height_m,
        };
        let solution = Solution { position: start, v_n: Vector3::zeros(), q_nb: UnitQuaternion::identity() };
        let noise = ImuNoise { gyro_psd: Vector3::repeat(1e-10), accel_psd: Vector3::repeat(1e-7) };
        let settings = Settings { earth, ..Settings::new(noise) };
        let walk = |psd| Process::RandomWalk { psd: [psd; 6] };
        let drift = Process::GaussMarkov { sd: [1e-3; 6], tau_s: [600.0; 6] };
        let blocks = [
            Block::isotropic(BlockKind::GyroBias, walk(1e-14), 1e-5),
            Block::isotropic(BlockKind::AccelBias, drift, 1e-3),
            Block::isotropic(BlockKind::BaroBias, walk(1e-6), 1.0),
        ];
        let initial = Initial {
            t_ns: 0,
            solution,
            sd_phi: Vector3::repeat(1e-3),
            sd_v: Vector3::repeat(0.1),
            sd_p: Vector3::repeat(5.0),
        };
        // after a black box the compiler knows nothing of a value: what is proved holds for all
        Ekf::new(black_box(&settings), black_box(&blocks), black_box(&initial))
    }
}

/// Every call of the filter.
fn filtered<M: NavModel>(seconds: u32) -> Result<f64, Error> {
    let earth = black_box(EarthModel::default());
    let parked = Parked::new(&earth);
    let mut filter = parked.filter::<M>(earth)?;
    let ekf = black_box(&mut filter);
    let dt_s = STEP_NS as f64 / 1e9;
    let (dtheta, dvel) = (parked.rates.gyro * dt_s, parked.rates.accel * dt_s);
    let mut saved = [0; 4096];
    let mut t_ns = 0;
    for second in 0..seconds {
        for _ in 1..STEPS_PER_FIX {
            t_ns += STEP_NS;
            ekf.predict(t_ns, black_box(&dtheta), black_box(&dvel))?;
        }
        t_ns += STEP_NS;
        ekf.predict_rates(t_ns, black_box(&parked.rates), black_box(&parked.rates))?;
        ekf.update(u64::from(second), black_box(&GnssFix { t_ns, ..parked.fix }))?;
        ekf.save(&mut Writer::new(black_box(&mut saved)))?;
        ekf.restore(&mut Reader::new(black_box(&saved)))?;
        black_box((ekf.params(), ekf.ned_covariance(), ekf.lever_b_m(), ekf.solution_sd()));
        black_box(&mut *ekf);
    }
    ekf.raise_covariance(black_box(1.0));
    ekf.break_increments();
    Ok(parked.error_m(&ekf.solution().position))
}

/// Counts what it is told.
#[derive(Default)]
struct Told {
    used: u32,
    events: u32,
}

impl Sink for Told {
    fn event(&mut self, event: &Event) {
        self.events += u32::from(!event.kind.text().is_empty() && !event.kind.code().is_empty());
    }

    fn record(&mut self, record: &Record) {
        self.used += u32::from(record.status == Status::Used);
    }
}

/// Every call of the stream; an error of 1 km when it did not use what it should have.
fn streamed<M: NavModel>(seconds: u32) -> Result<f64, Error> {
    let earth = black_box(EarthModel::default());
    let parked = Parked::new(&earth);
    let mut navigator =
        Navigator::<M, CAP>::new(parked.filter::<M>(earth)?, black_box(StreamSettings::default()));
    let nav = black_box(&mut navigator);
    let mut told = Told::default();
    let Rates { gyro, accel } = parked.rates;
    let mut t_ns = 0;
    for _ in 0..seconds {
        for _ in 0..STEPS_PER_FIX {
            t_ns += STEP_NS;
            nav.imu(t_ns, black_box(&gyro), black_box(&accel), &mut told)?;
            black_box(&mut *nav);
        }
        let height = BaroHeight { t_ns, height_m: parked.truth.height_m, variance: 1.0 };
        nav.gnss(black_box(&GnssFix { t_ns, ..parked.fix }), &mut told)?;
        nav.baro(black_box(&height), &mut told)?;
        nav.heading(black_box(&Heading { t_ns, heading_rad: 0.0, variance: 1e-4 }), &mut told)?;
    }
    let mut saved = [0; 4096];
    nav.save(&mut Writer::new(black_box(&mut saved)))?;
    nav.restore(&mut Reader::new(black_box(&saved)))?;
    nav.finish(&mut told);
    let whole = told.used == 3 * seconds && told.events == 0;
    Ok(if whole { parked.error_m(&nav.ekf().solution().position) } else { 1000.0 })
}
