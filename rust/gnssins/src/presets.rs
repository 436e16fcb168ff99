//! Named filters: each a model, a block list and a tuning, nothing else.

use nalgebra::Vector3;

use crate::blocks::{BLOCK_MAX, Block, BlockKind, Process};
use crate::discretise::ImuNoise;
use crate::earth::Gravity;

/// Mechanisation that a preset runs on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum Model {
    /// [`crate::nav::ned::Ned`].
    #[default]
    Ned,
    /// [`crate::nav::ecef::Ecef`].
    Ecef,
}

/// A filter as data.
#[derive(Debug, Clone, Copy)]
pub struct Preset {
    /// Name in configurations.
    pub name: &'static str,
    /// One line for lists.
    pub summary: &'static str,
    /// Mechanisation.
    pub model: Model,
    /// Gravity formula.
    pub gravity: Gravity,
    /// White noise of the sensors.
    pub noise: ImuNoise,
    /// Blocks with the names that their states carry.
    pub blocks: &'static [(&'static str, Block)],
}

const DEG: f64 = core::f64::consts::PI / 180.0;
const DEG_PER_H: f64 = DEG / 3600.0;
/// 1 deg/sqrt(h) in rad/sqrt(s).
const DEG_PER_SQRT_H: f64 = DEG / 60.0;
/// Standard gravity, m/s²: the unit g of sensor data sheets.
const G0: f64 = 9.806_65;
const MG: f64 = 1e-3 * G0;

const fn all(v: f64) -> [f64; BLOCK_MAX] {
    [v; BLOCK_MAX]
}

const fn isotropic(gyro: f64, accel: f64) -> ImuNoise {
    ImuNoise { gyro_psd: Vector3::new(gyro, gyro, gyro), accel_psd: Vector3::new(accel, accel, accel) }
}

/// Fomichev and Tan (2017): 18 states, constant and Gauss-Markov gyro drift, Gauss-Markov accelerometer error, no
/// accelerometer white noise. The gyro white noise is read as an angle random walk of 0.001 deg/sqrt(h).
const FOMICHEV_TAN_2017: Preset = Preset {
    name: "fomichev-tan-2017",
    summary: "18 states: gyro bias and drift, accelerometer drift; navigation-grade UAV of Fomichev and Tan (2017)",
    model: Model::Ned,
    gravity: Gravity::NormalVertical,
    noise: isotropic(0.001 * DEG_PER_SQRT_H * 0.001 * DEG_PER_SQRT_H, 0.0),
    blocks: &[
        ("gyro_bias", Block::isotropic(BlockKind::GyroBias, Process::Constant, 0.01 * DEG_PER_H)),
        (
            "gyro_drift",
            Block::isotropic(
                BlockKind::GyroBias,
                Process::GaussMarkov { sd: all(0.001 * DEG_PER_H), tau_s: all(7200.0) },
                0.001 * DEG_PER_H,
            ),
        ),
        (
            "accel_drift",
            Block::isotropic(
                BlockKind::AccelBias,
                Process::GaussMarkov { sd: all(5e-5 * G0), tau_s: all(1800.0) },
                5e-5 * G0,
            ),
        ),
    ],
};

/// Biases of a low-cost MEMS unit in a vehicle: random walks, with noise raised for vibration.
const MEMS_BIASES: [(&str, Block); 2] = [
    (
        "gyro_bias",
        Block::isotropic(
            BlockKind::GyroBias,
            Process::RandomWalk { psd: all(2e-3 * DEG * 2e-3 * DEG) },
            0.5 * DEG,
        ),
    ),
    (
        "accel_bias",
        Block::isotropic(BlockKind::AccelBias, Process::RandomWalk { psd: all(2e-3 * 2e-3) }, 20.0 * MG),
    ),
];
const MEMS_NOISE: ImuNoise = isotropic(0.05 * DEG * 0.05 * DEG, 0.03 * 0.03);

const NED_15: Preset = Preset {
    name: "ned-15",
    summary: "15 states, NED: gyro and accelerometer bias random walks; MEMS unit on a car or drone",
    model: Model::Ned,
    gravity: Gravity::Normal,
    noise: MEMS_NOISE,
    blocks: &MEMS_BIASES,
};

const ECEF_15: Preset = Preset {
    name: "ecef-15",
    summary: "15 states, ECEF: as ned-15, works at every latitude",
    model: Model::Ecef,
    ..NED_15
};

const NED_21: Preset = Preset {
    name: "ned-21",
    summary: "21 states, NED: ned-15 with gyro and accelerometer scale factors",
    blocks: &[
        MEMS_BIASES[0],
        MEMS_BIASES[1],
        ("gyro_scale", Block::isotropic(BlockKind::GyroScale, Process::Constant, 0.01)),
        ("accel_scale", Block::isotropic(BlockKind::AccelScale, Process::Constant, 0.01)),
    ],
    ..NED_15
};

/// All presets.
pub const PRESETS: &[Preset] = &[NED_15, ECEF_15, NED_21, FOMICHEV_TAN_2017];

/// Finds a preset by name.
#[must_use]
pub fn find(name: &str) -> Option<&'static Preset> {
    PRESETS.iter().find(|p| p.name == name)
}
