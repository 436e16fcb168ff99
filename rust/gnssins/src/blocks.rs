//! Error-state blocks as data: what a filter estimates beside position, velocity and attitude.

use nalgebra::Vector3;

use crate::error::Error;

/// Most states that one block has (a full misalignment matrix).
pub const BLOCK_MAX: usize = 6;

/// What a block describes. All are errors of a measurement: see [`crate::nav`] for the sign.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum BlockKind {
    /// Gyro bias, rad/s, body axes.
    GyroBias,
    /// Accelerometer bias, m/s², body axes.
    AccelBias,
    /// Gyro scale factor error, dimensionless, per axis.
    GyroScale,
    /// Accelerometer scale factor error, dimensionless, per axis.
    AccelScale,
    /// Gyro misalignment, rad: elements xy, xz, yx, yz, zx, zy of the error matrix.
    GyroMisalignment,
    /// Accelerometer misalignment, rad: elements xy, xz, yx, yz, zx, zy of the error matrix.
    AccelMisalignment,
    /// IMU to GNSS antenna, m, body axes.
    GnssLeverArm,
    /// Barometric height error, m.
    BaroBias,
    /// Time-correlated GNSS position error along north, east, down, m.
    GnssPositionError,
    /// Time-correlated GNSS velocity error along north, east, down, m/s.
    GnssVelocityError,
}

const XYZ: &[&str] = &["x", "y", "z"];
const NED: &[&str] = &["n", "e", "d"];
const OFF_DIAGONAL: &[&str] = &["xy", "xz", "yx", "yz", "zx", "zy"];
/// Row and column of the off-diagonal elements in the order of the misalignment states.
const OFF_DIAGONAL_INDEX: [(Axis, Axis); 6] = [
    (Axis::X, Axis::Y),
    (Axis::X, Axis::Z),
    (Axis::Y, Axis::X),
    (Axis::Y, Axis::Z),
    (Axis::Z, Axis::X),
    (Axis::Z, Axis::Y),
];

/// One of three axes: an index that is never out of range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Axis {
    X,
    Y,
    Z,
}

impl Axis {
    /// Component along it.
    pub(crate) const fn of(self, v: &Vector3<f64>) -> f64 {
        let [x, y, z] = v.data.0[0];
        match self {
            Self::X => x,
            Self::Y => y,
            Self::Z => z,
        }
    }
}

/// The axis of state `i` of a block of three.
const fn axis(i: usize) -> Axis {
    match i {
        0 => Axis::X,
        1 => Axis::Y,
        _ => Axis::Z,
    }
}

impl BlockKind {
    /// Number of states.
    #[must_use]
    pub const fn len(self) -> usize {
        self.axes().len()
    }

    /// Never: every block has states.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        false
    }

    /// Suffixes of the state names.
    #[must_use]
    pub const fn axes(self) -> &'static [&'static str] {
        match self {
            Self::GyroMisalignment | Self::AccelMisalignment => OFF_DIAGONAL,
            Self::GnssPositionError | Self::GnssVelocityError => NED,
            Self::BaroBias => &["up"],
            _ => XYZ,
        }
    }

    /// SI unit of the states.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::GyroBias => "rad/s",
            Self::AccelBias => "m/s^2",
            Self::GyroScale | Self::AccelScale => "1",
            Self::GyroMisalignment | Self::AccelMisalignment => "rad",
            Self::GnssLeverArm | Self::BaroBias | Self::GnssPositionError => "m",
            Self::GnssVelocityError => "m/s",
        }
    }

    /// Name in configurations.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::GyroBias => "gyro_bias",
            Self::AccelBias => "accel_bias",
            Self::GyroScale => "gyro_scale",
            Self::AccelScale => "accel_scale",
            Self::GyroMisalignment => "gyro_misalignment",
            Self::AccelMisalignment => "accel_misalignment",
            Self::GnssLeverArm => "gnss_lever_arm",
            Self::BaroBias => "baro_bias",
            Self::GnssPositionError => "gnss_position_error",
            Self::GnssVelocityError => "gnss_velocity_error",
        }
    }

    /// Where state `i` of the block acts.
    #[must_use]
    pub(crate) const fn coupling(self, i: usize) -> Coupling {
        match self {
            Self::GyroBias => Coupling::Gyro(Input { axis: axis(i), source: Source::Unit }),
            Self::AccelBias => Coupling::Accel(Input { axis: axis(i), source: Source::Unit }),
            Self::GyroScale => Coupling::Gyro(Input { axis: axis(i), source: Source::Component(axis(i)) }),
            Self::AccelScale => Coupling::Accel(Input { axis: axis(i), source: Source::Component(axis(i)) }),
            Self::GyroMisalignment => Coupling::Gyro(off_diagonal(i)),
            Self::AccelMisalignment => Coupling::Accel(off_diagonal(i)),
            Self::GnssLeverArm => Coupling::LeverArm(axis(i)),
            Self::BaroBias => Coupling::Baro,
            Self::GnssPositionError => Coupling::GnssPosition(axis(i)),
            Self::GnssVelocityError => Coupling::GnssVelocity(axis(i)),
        }
    }
}

const fn off_diagonal(i: usize) -> Input {
    let (axis, column) = OFF_DIAGONAL_INDEX[i % 6];
    Input { axis, source: Source::Component(column) }
}

/// How one inertial error state acts: on sensor `axis`, by the factor `source`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Input {
    pub axis: Axis,
    pub source: Source,
}

/// Factor of an inertial error state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Source {
    /// A bias: the state itself.
    Unit,
    /// A matrix element: the state times this component of the true rate or specific force.
    Component(Axis),
}

/// Where a block state enters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Coupling {
    Gyro(Input),
    Accel(Input),
    LeverArm(Axis),
    Baro,
    GnssPosition(Axis),
    GnssVelocity(Axis),
}

/// Couplings of one inertial sensor: the bias and three columns of the error matrix, three axes each.
const INPUTS: usize = 12;
/// Couplings of both, the gyros first.
pub(crate) const INERTIAL: usize = 2 * INPUTS;
const LEVER_ARM: usize = INERTIAL;
const BARO: usize = LEVER_ARM + 3;
const GNSS_POSITION: usize = BARO + 1;
const GNSS_VELOCITY: usize = GNSS_POSITION + 3;

/// All couplings: a layout keeps the place of each in one byte.
pub(crate) const COUPLINGS: [Coupling; GNSS_VELOCITY + 3] = {
    let mut all = [Coupling::Baro; GNSS_VELOCITY + 3];
    let mut i = 0;
    while i < INPUTS {
        let source = if i < 3 { Source::Unit } else { Source::Component(axis(i / 3 - 1)) };
        let input = Input { axis: axis(i % 3), source };
        all[i] = Coupling::Gyro(input);
        all[INPUTS + i] = Coupling::Accel(input);
        i += 1;
    }
    let mut i = 0;
    while i < 3 {
        all[LEVER_ARM + i] = Coupling::LeverArm(axis(i));
        all[GNSS_POSITION + i] = Coupling::GnssPosition(axis(i));
        all[GNSS_VELOCITY + i] = Coupling::GnssVelocity(axis(i));
        i += 1;
    }
    all
};

impl Coupling {
    /// Place in [`COUPLINGS`].
    pub(crate) const fn place(self) -> u8 {
        let (first, i) = match self {
            Self::Gyro(input) => (0, input.place()),
            Self::Accel(input) => (INPUTS, input.place()),
            Self::LeverArm(axis) => (LEVER_ARM, axis as usize),
            Self::Baro => (BARO, 0),
            Self::GnssPosition(axis) => (GNSS_POSITION, axis as usize),
            Self::GnssVelocity(axis) => (GNSS_VELOCITY, axis as usize),
        };
        (first + i) as u8
    }
}

impl Input {
    const fn place(self) -> usize {
        let column = match self.source {
            Source::Unit => 0,
            Source::Component(axis) => 1 + axis as usize,
        };
        3 * column + self.axis as usize
    }
}

/// How the states of a block move by themselves. Arrays hold one value per state; the rest is ignored.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Process {
    /// Does not change.
    Constant,
    /// Random walk with these densities, unit²/s.
    RandomWalk {
        /// Spectral density of the driving white noise, unit²/s.
        psd: [f64; BLOCK_MAX],
    },
    /// First-order Gauss-Markov, x' = -x/tau + w, stationary standard deviation `sd`.
    GaussMarkov {
        /// Stationary standard deviation, unit.
        sd: [f64; BLOCK_MAX],
        /// Correlation time, s.
        tau_s: [f64; BLOCK_MAX],
    },
}

/// A block: kind, process, start. A sum of processes (a constant bias and a Gauss-Markov drift) is two blocks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Block {
    /// What it describes.
    pub kind: BlockKind,
    /// How it moves.
    pub process: Process,
    /// Standard deviation at the start, unit.
    pub initial_sd: [f64; BLOCK_MAX],
    /// Parameter value at the start, unit.
    pub initial: [f64; BLOCK_MAX],
    /// Gauss-Markov errors of the receiver and the barometer only: correlation over the distance travelled too, so
    /// that the rate is 1/tau + ground speed/distance; infinite for none, m.
    pub distance_m: f64,
    /// Standard deviation that a change of the satellite constellation adds, unit; 0 for none.
    pub jump_sd: [f64; BLOCK_MAX],
    /// Lower bound of the standard deviation, held after every measurement, unit; 0 for none.
    pub floor_sd: [f64; BLOCK_MAX],
}

impl Block {
    /// A block with the same numbers on every axis that starts at zero.
    #[must_use]
    pub const fn isotropic(kind: BlockKind, process: Process, initial_sd: f64) -> Self {
        Self {
            kind,
            process,
            initial_sd: [initial_sd; BLOCK_MAX],
            initial: [0.0; BLOCK_MAX],
            distance_m: f64::INFINITY,
            jump_sd: [0.0; BLOCK_MAX],
            floor_sd: [0.0; BLOCK_MAX],
        }
    }

    /// Refuses numbers that make no filter.
    ///
    /// # Errors
    /// [`Error::Config`] naming the value.
    pub fn check(&self) -> Result<(), Error> {
        let all = |what, values: &[f64; BLOCK_MAX], ok: fn(f64) -> bool, need| {
            values[..self.kind.len()]
                .iter()
                .find(|v| !ok(**v))
                .map_or(Ok(()), |&got| Err(Error::Config { what, need, got }))
        };
        const POSITIVE: &str = "must be finite and greater than 0 (leave the block out to keep it fixed)";
        let positive: fn(f64) -> bool = |v| v.is_finite() && v > 0.0;
        all("block.initial_sd", &self.initial_sd, positive, POSITIVE)?;
        all("block.initial", &self.initial, f64::is_finite, "must be finite")?;
        const NOT_NEGATIVE: &str = "must be finite and at least 0";
        let not_negative: fn(f64) -> bool = |v| v.is_finite() && v >= 0.0;
        all("block.jump_sd", &self.jump_sd, not_negative, NOT_NEGATIVE)?;
        all("block.floor_sd", &self.floor_sd, not_negative, NOT_NEGATIVE)?;
        self.check_distance()?;
        match &self.process {
            Process::Constant => Ok(()),
            Process::RandomWalk { psd } => {
                all("block.psd", psd, positive, "must be finite and greater than 0")
            }
            Process::GaussMarkov { sd, tau_s } => {
                all("block.sd", sd, positive, "must be finite and greater than 0")?;
                all("block.tau_s", tau_s, positive, "must be finite and greater than 0")
            }
        }
    }

    /// Correlation over distance is a matter of what the receiver and the barometer see on their way.
    fn check_distance(&self) -> Result<(), Error> {
        let what = "block.distance_m";
        let got = self.distance_m;
        if got == f64::INFINITY {
            return Ok(());
        }
        if !(got.is_finite() && got > 0.0) {
            return Err(Error::Config { what, need: "must be greater than 0", got });
        }
        let outside = matches!(
            self.kind,
            BlockKind::GnssPositionError | BlockKind::GnssVelocityError | BlockKind::BaroBias
        );
        if !outside || !matches!(self.process, Process::GaussMarkov { .. }) {
            let need = "goes with process = \"gauss_markov\" of receiver and barometer errors only";
            return Err(Error::Config { what, need, got });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_coupling_has_the_place_where_it_stands() {
        for (place, coupling) in COUPLINGS.iter().enumerate() {
            assert_eq!(usize::from(coupling.place()), place, "{coupling:?}");
        }
    }
}
