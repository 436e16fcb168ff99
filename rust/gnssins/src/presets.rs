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

const fn squared(v: f64) -> f64 {
    v * v
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

/// 1 deg/h per square root of an hour in rad/s per sqrt(s).
const DEG_PER_H_SQRT_H: f64 = DEG_PER_H / 60.0;
/// 1 micro-g per square root of an hour in m/s² per sqrt(s).
const UG_SQRT_H: f64 = 1e-6 * G0 / 60.0;

/// Novik (2011): 22 states on an airliner with ring laser gyros (HG9900), GNSS errors correlated in time and over the
/// way with jumps at changes of the constellation, barometer bias. The middle set of the publication's parameters;
/// bias walks, which it leaves open, are those of the sensor class.
const NOVIK_2011: Preset = Preset {
    name: "novik-2011",
    summary: "22 states: sensor, barometer and correlated GNSS errors; airliner complex of Novik (2011)",
    model: Model::Ned,
    gravity: Gravity::Normal,
    noise: isotropic(squared(0.002 * DEG_PER_SQRT_H), squared(1e-5 * G0)),
    blocks: &[
        (
            "gyro_bias",
            Block::isotropic(
                BlockKind::GyroBias,
                Process::RandomWalk { psd: all(squared(0.001 * DEG_PER_H_SQRT_H)) },
                0.003 * DEG_PER_H,
            ),
        ),
        (
            "accel_bias",
            Block::isotropic(
                BlockKind::AccelBias,
                Process::RandomWalk { psd: all(squared(5.0 * UG_SQRT_H)) },
                25e-6 * G0,
            ),
        ),
        (
            "baro_bias",
            Block::isotropic(BlockKind::BaroBias, Process::RandomWalk { psd: all(squared(0.035)) }, 4.0),
        ),
        (
            "gnss_position_error",
            Block {
                initial_sd: NOVIK_POSITION_SD,
                distance_m: 250_000.0,
                jump_sd: [3.0, 3.0, 5.0, 0.0, 0.0, 0.0],
                ..Block::isotropic(
                    BlockKind::GnssPositionError,
                    Process::GaussMarkov { sd: NOVIK_POSITION_SD, tau_s: all(2000.0) },
                    6.0,
                )
            },
        ),
        (
            "gnss_velocity_error",
            Block {
                jump_sd: [0.015, 0.015, 0.015, 0.0, 0.0, 0.0],
                ..Block::isotropic(
                    BlockKind::GnssVelocityError,
                    Process::GaussMarkov { sd: all(0.05), tau_s: all(50.0) },
                    0.05,
                )
            },
        ),
    ],
};
/// Correlated position error north, east, down, m.
const NOVIK_POSITION_SD: [f64; BLOCK_MAX] = [6.0, 6.0, 8.5, 8.5, 8.5, 8.5];

/// Vasilyuk (2019): 15 states in ECEF, MEMS unit on a pedestrian's pole with centimetre fixes. The biases are random
/// walks with the driving noise of the publication's Gauss-Markov processes: with their decay in the covariance and none
/// in the estimate, as printed, the filter believes a turn-on bias away.
const VASILYUK_2019: Preset = Preset {
    name: "vasilyuk-2019",
    summary: "15 states, ECEF: MEMS unit with centimetre fixes; pedestrian pole of Vasilyuk (2019)",
    model: Model::Ecef,
    gravity: Gravity::Normal,
    noise: isotropic(squared(0.008 * DEG), squared(0.0034)),
    blocks: &[
        (
            "gyro_bias",
            Block::isotropic(
                BlockKind::GyroBias,
                // 2 sd²/tau of 10 deg/h and 70 s
                Process::RandomWalk { psd: all(squared(10.0 * DEG_PER_H) / 35.0) },
                0.3 * DEG,
            ),
        ),
        (
            "accel_bias",
            Block::isotropic(
                BlockKind::AccelBias,
                // 2 sd²/tau of 80 micro-g and 70 s
                Process::RandomWalk { psd: all(squared(80e-6 * G0) / 35.0) },
                0.05,
            ),
        ),
    ],
};

/// Al Bitar and Gavrilov (2019): 21 states, two random components per sensor. The walks carry the constant biases from
/// the start. The publication prints no sensor figures; these are of the class of its unit.
const AL_BITAR_GAVRILOV_2019: Preset = Preset {
    name: "al-bitar-gavrilov-2019",
    summary: "21 states, NED: bias walk and drift of every sensor; car of Al Bitar and Gavrilov (2019)",
    model: Model::Ned,
    gravity: Gravity::Normal,
    noise: isotropic(squared(0.15 * DEG_PER_SQRT_H), squared(57e-6 * G0)),
    blocks: &[
        (
            "gyro_walk",
            Block::isotropic(
                BlockKind::GyroBias,
                Process::RandomWalk { psd: all(squared(5e-7)) },
                0.02 * DEG,
            ),
        ),
        (
            "gyro_drift",
            Block::isotropic(
                BlockKind::GyroBias,
                Process::GaussMarkov { sd: all(3.0 * DEG_PER_H), tau_s: all(200.0) },
                3.0 * DEG_PER_H,
            ),
        ),
        (
            "accel_walk",
            Block::isotropic(BlockKind::AccelBias, Process::RandomWalk { psd: all(squared(1e-5)) }, 3.0 * MG),
        ),
        (
            "accel_drift",
            Block::isotropic(
                BlockKind::AccelBias,
                Process::GaussMarkov { sd: all(20e-6 * G0), tau_s: all(200.0) },
                20e-6 * G0,
            ),
        ),
    ],
};

/// All presets.
pub const PRESETS: &[Preset] =
    &[NED_15, ECEF_15, NED_21, FOMICHEV_TAN_2017, NOVIK_2011, VASILYUK_2019, AL_BITAR_GAVRILOV_2019];

/// Finds a preset by name.
#[must_use]
pub fn find(name: &str) -> Option<&'static Preset> {
    PRESETS.iter().find(|p| p.name == name)
}
