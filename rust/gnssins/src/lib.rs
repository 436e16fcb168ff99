//! INS/GNSS integration: strapdown navigation corrected by an error-state Kalman filter.
//!
//! | module | what |
//! |---|---|
//! | [`earth`], [`frames`], [`attitude`], [`time`] | ellipsoids and gravity, coordinates, rotations, GPS time |
//! | [`imu`] | calibration, increments, coning and sculling |
//! | [`nav`] | mechanisations [`nav::ned::Ned`] and [`nav::ecef::Ecef`], error dynamics; sign conventions |
//! | [`blocks`], [`layout`], [`presets`] | error states as data |
//! | [`discretise`], [`cov`], [`ekf`] | transition and noise, covariance, the filter |
//! | [`meas`] | measurements |
//! | [`inverse`], [`vertical`] | exact increments for a given motion, INS without aids, its vertical channel |
//! | `monte_carlo` | many simulated runs and their sums (feature `monte-carlo`) |
//! | [`ahrs`] | attitude from gyro, accelerometer, magnetometer alone |
//! | [`stream`] | rows in time order to a filter: gaps, fixes between samples, counts |
//!
//! Units are SI and radians; body axes are forward, right, down; time is integer nanoseconds. The crate needs neither
//! `std` nor a heap (`default-features = false`).
//!
//! ```
//! use gnssins::{ekf::{Ekf, Initial, Settings}, nav, presets};
//! use nalgebra::{UnitQuaternion, Vector3};
//!
//! let preset = presets::find("ned-15").unwrap();
//! let blocks: Vec<_> = preset.blocks.iter().map(|(_, b)| *b).collect();
//! let settings = Settings::new(preset.noise);
//! let start = Initial {
//!     t_ns: 0,
//!     solution: nav::Solution {
//!         position: gnssins::frames::Lla::new(0.8, 0.1, 300.0),
//!         v_n: Vector3::zeros(), q_nb: UnitQuaternion::identity(),
//!     },
//!     sd_phi: Vector3::repeat(0.01), sd_v: Vector3::repeat(0.1), sd_p: Vector3::repeat(1.0),
//! };
//! let mut filter = Ekf::<nav::ned::Ned, 16>::new(&settings, &blocks, &start)?;
//! filter.predict(10_000_000, &Vector3::zeros(), &Vector3::new(0.0, 0.0, -0.0981))?;
//! assert!(filter.solution_sd().position_m.x > 1.0);
//! # Ok::<(), gnssins::error::Error>(())
//! ```
#![cfg_attr(not(feature = "std"), no_std)]
#![deny(missing_docs)]

pub mod ahrs;
pub mod attitude;
pub mod blocks;
pub mod bytes;
pub mod cov;
pub mod discretise;
pub mod earth;
pub mod ekf;
pub mod error;
pub mod frames;
pub mod imu;
pub mod inverse;
pub mod layout;
pub mod math;
pub mod meas;
#[cfg(feature = "monte-carlo")]
pub mod monte_carlo;
pub mod nav;
pub mod presets;
pub mod simd;
pub mod small;
pub mod stream;
pub mod time;
pub mod vertical;
