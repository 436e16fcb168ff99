//! The engine as a static library for a machine without an operating system.
//!
//! The crate has its own panic handler and no allocator, so it links only if nothing below it brings in `std` or asks
//! for a heap. `main.c` calls it and checks the answers.
#![no_std]

use core::panic::PanicInfo;

use gnssins::attitude;
use gnssins::blocks::{Block, BlockKind, Process};
use gnssins::discretise::ImuNoise;
use gnssins::ekf::{Ekf, Initial, Settings};
use gnssins::error::Error;
use gnssins::frames::Lla;
use gnssins::meas::gnss::GnssFix;
use gnssins::nav::{EarthModel, NavModel, Solution, ecef::Ecef, ned::Ned};
use nalgebra::{UnitQuaternion, Vector3};

/// States of the filter (9 + 3 + 3), rounded up to a multiple of 8.
const CAP: usize = 16;
const STEP_NS: i64 = 10_000_000;
const STEPS_PER_FIX: u32 = 100;

#[panic_handler]
fn on_panic(_: &PanicInfo<'_>) -> ! {
    loop {
        core::hint::spin_loop();
    }
}

/// Position error (m) after `seconds` at rest with 100 Hz increments and 1 Hz fixes, from a start that is 5 m off;
/// -1 when the engine returns an error.
#[unsafe(no_mangle)]
pub extern "C" fn gnssins_parked_ned(seconds: u32) -> f64 {
    parked::<Ned>(seconds).unwrap_or(-1.0)
}

/// As [`gnssins_parked_ned`] with the ECEF model.
#[unsafe(no_mangle)]
pub extern "C" fn gnssins_parked_ecef(seconds: u32) -> f64 {
    parked::<Ecef>(seconds).unwrap_or(-1.0)
}

fn parked<M: NavModel>(seconds: u32) -> Result<f64, Error> {
    let earth = EarthModel::default();
    let truth = Lla { lat_rad: 0.85, lon_rad: 0.16, height_m: 320.0 };
    let (sin_lat, cos_lat) = gnssins::math::sin_cos(truth.lat_rad);
    let radii = earth.ellipsoid.radii(sin_lat);
    let (per_north, per_east) = (
        1.0 / (radii.meridian_m + truth.height_m),
        1.0 / ((radii.prime_vertical_m + truth.height_m) * cos_lat),
    );

    let start = Lla {
        lat_rad: truth.lat_rad + 3.0 * per_north,
        lon_rad: truth.lon_rad - 4.0 * per_east,
        height_m: truth.height_m,
    };
    let solution = Solution { position: start, v_n: Vector3::zeros(), q_nb: UnitQuaternion::identity() };
    let noise = ImuNoise { gyro_psd: Vector3::repeat(1e-10), accel_psd: Vector3::repeat(1e-7) };
    let settings = Settings { earth, ..Settings::new(noise) };
    let blocks = [
        Block::isotropic(BlockKind::GyroBias, Process::RandomWalk { psd: [1e-14; 6] }, 1e-5),
        Block::isotropic(
            BlockKind::AccelBias,
            Process::GaussMarkov { sd: [1e-3; 6], tau_s: [600.0; 6] },
            1e-3,
        ),
    ];
    let initial = Initial {
        t_ns: 0,
        solution,
        sd_phi: Vector3::repeat(1e-3),
        sd_v: Vector3::repeat(0.1),
        sd_p: Vector3::repeat(5.0),
    };
    let mut ekf = Ekf::<M, CAP>::new(&settings, &blocks, &initial)?;

    let dt_s = STEP_NS as f64 / 1e9;
    let q_bn = attitude::exp(&Vector3::zeros());
    let dtheta = q_bn * earth.ellipsoid.earth_rate_n(sin_lat, cos_lat) * dt_s;
    let dvel = q_bn * earth.ellipsoid.gravity_n(earth.gravity, sin_lat, cos_lat, truth.height_m) * -dt_s;
    let mut covariance = [[0.0; 6]; 6];
    for (i, row) in covariance.iter_mut().enumerate() {
        row[i] = if i < 3 { 0.25 } else { 0.0025 };
    }
    let mut t_ns = 0;
    for second in 0..seconds {
        for _ in 0..STEPS_PER_FIX {
            t_ns += STEP_NS;
            ekf.predict(t_ns, &dtheta, &dvel)?;
        }
        let fix = GnssFix {
            t_ns,
            position: Some(truth),
            velocity_n: [Some(0.0); 3],
            covariance,
            new_constellation: false,
        };
        ekf.update(u64::from(second), &fix)?;
    }
    let p = ekf.solution().position;
    let error = Vector3::new(
        (p.lat_rad - truth.lat_rad) / per_north,
        (p.lon_rad - truth.lon_rad) / per_east,
        p.height_m - truth.height_m,
    );
    Ok(error.norm())
}
