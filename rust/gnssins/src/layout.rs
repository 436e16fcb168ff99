//! From an ordered list of blocks to state indices: which state couples where, decays how, is driven by what.

use crate::blocks::{BLOCK_MAX, Block, BlockKind, Coupling, Input, Process, Source};
use crate::error::Error;
use crate::math;
use crate::nav::NAV;
use nalgebra::{Matrix3, Vector3};

/// Most blocks in one filter.
pub const BLOCKS_MAX: usize = 16;

/// Name, unit and scale of one error state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StateInfo {
    /// `phi`, `dv`, `dp`, or the kind of the block.
    pub quantity: &'static str,
    /// Axis or element: n, e, d; x, y, z; xy and so on.
    pub axis: &'static str,
    /// SI unit.
    pub unit: &'static str,
    /// Typical size in that unit: of a block state its initial sigma.
    pub scale: f64,
}

/// Quantity, unit and typical size of the navigation errors, three of each.
const NAV_STATES: [(&str, &str, f64); 3] = [("phi", "rad", 1e-3), ("dv", "m/s", 0.1), ("dp", "m", 1.0)];
const NED: [&str; 3] = ["n", "e", "d"];

/// How the error of an inertial sensor acts: places in tables, for the kernels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Act {
    /// Axis of the sensor that errs: gyros 0 to 2, accelerometers 3 to 5.
    pub column: u8,
    /// By what: component of the true rate 0 to 2, of the specific force 3 to 5, or 6 for 1.
    pub factor: u8,
}

impl Act {
    fn of(coupling: Coupling) -> Option<Self> {
        let (first, Input { axis, source }) = match coupling {
            Coupling::Gyro(input) => (0, input),
            Coupling::Accel(input) => (3, input),
            _ => return None,
        };
        let factor = match source {
            Source::Unit => 6,
            Source::Component(c) => first + c as u8,
        };
        Some(Self { column: first + axis as u8, factor })
    }

    /// Place of the parameter in [`Layout::sensor_errors`].
    fn place(self) -> u8 {
        let (sensor, axis) = (self.column / 3, self.column % 3);
        let column = if self.factor == 6 { 0 } else { 1 + self.factor % 3 };
        12 * sensor + 3 * column + axis
    }
}

/// One state behind the navigation errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BlockState {
    pub coupling: Coupling,
    /// Errors of inertial sensors only.
    pub act: Option<Act>,
    /// -1/tau, or 0: 1/s.
    pub decay: f64,
    /// -1/distance, or 0: 1/m.
    pub decay_per_m: f64,
    /// What drives it: stationary variance of a Gauss-Markov process (`decay` is not 0), unit², or density of a random
    /// walk, unit²/s, or 0.
    drive: f64,
    /// Variance that a change of constellation adds, unit².
    pub jump: f64,
    /// Standard deviation at the start, unit.
    initial_sd: f64,
}

/// A block in its place.
#[derive(Debug, Clone, Copy)]
struct Placed {
    kind: BlockKind,
    /// Class of the process, for fingerprints.
    process: u8,
    start: u8,
}

/// Where each block sits. States 0 to 8 are the navigation errors, blocks follow in the order given.
#[derive(Debug, Clone, Copy)]
pub struct Layout<const CAP: usize> {
    n: usize,
    blocks: [Option<Placed>; BLOCKS_MAX],
    states: [Option<BlockState>; CAP],
    /// Where the parameters add up in tables of sensor errors: bias and columns of the matrix of the gyros, then of the
    /// accelerometers; behind them what is none.
    places: [u8; CAP],
}

/// Place of what is no error of an inertial sensor.
const NOWHERE: u8 = 24;

impl<const CAP: usize> Layout<CAP> {
    /// Lays out a block list.
    ///
    /// # Errors
    /// [`Error::Capacity`] when the states or blocks do not fit, [`Error::Config`] for a bad value in a block.
    pub fn new(blocks: &[Block]) -> Result<Self, Error> {
        let n = NAV + blocks.iter().map(|b| b.kind.len()).sum::<usize>();
        if n > CAP {
            return Err(Error::Capacity { need: n, capacity: CAP });
        }
        if blocks.len() > BLOCKS_MAX {
            return Err(Error::Config {
                what: "filter.block (count)",
                need: "at most 16 blocks",
                got: blocks.len() as f64,
            });
        }
        let mut layout = Self { n, blocks: [None; BLOCKS_MAX], states: [None; CAP], places: [NOWHERE; CAP] };
        let mut start = NAV;
        for (slot, block) in layout.blocks.iter_mut().zip(blocks) {
            block.check()?;
            let process = match block.process {
                Process::Constant => 0,
                Process::RandomWalk { .. } => 1,
                Process::GaussMarkov { .. } if block.distance_m.is_finite() => 3,
                Process::GaussMarkov { .. } => 2,
            };
            // at most 9 states and 16 blocks of 6
            *slot = Some(Placed { kind: block.kind, process, start: start as u8 });
            for (i, state) in layout.states.iter_mut().skip(start).take(block.kind.len()).enumerate() {
                *state = Some(BlockState::new(block, i));
            }
            start += block.kind.len();
        }
        for (place, state) in layout.places.iter_mut().zip(&layout.states) {
            *place = state.as_ref().and_then(|s| s.act).map_or(NOWHERE, Act::place);
        }
        Ok(layout)
    }

    /// Number of states, the nine navigation errors included.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.n
    }

    /// Never: the navigation errors are always there.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        false
    }

    /// Kinds of the blocks with the index of their first state.
    pub fn blocks(&self) -> impl Iterator<Item = (BlockKind, usize)> {
        self.blocks.iter().flatten().map(|b| (b.kind, usize::from(b.start)))
    }

    /// First state of the first block of a kind.
    #[must_use]
    pub fn find(&self, kind: BlockKind) -> Option<usize> {
        self.blocks().find(|(k, _)| *k == kind).map(|(_, i)| i)
    }

    /// What state `i` is: names, unit and scale for tables, plots and conditioning.
    #[must_use]
    pub fn state(&self, i: usize) -> Option<StateInfo> {
        if i < NAV {
            let (quantity, unit, scale) = NAV_STATES[i / 3];
            return Some(StateInfo { quantity, axis: NED[i % 3], unit, scale });
        }
        let (kind, start) = self.blocks().find(|(k, start)| (*start..start + k.len()).contains(&i))?;
        let (axis, state) = (kind.axes().get(i - start)?, self.states.get(i)?.as_ref()?);
        Some(StateInfo { quantity: kind.name(), axis, unit: kind.unit(), scale: state.initial_sd })
    }

    /// Block states with their indices.
    pub(crate) fn states(&self) -> impl Iterator<Item = (usize, &BlockState)> {
        self.states.iter().enumerate().filter_map(|(i, s)| s.as_ref().map(|s| (i, s)))
    }

    /// Whether the correlation of any state depends on the ground speed.
    pub(crate) fn is_spatial(&self) -> bool {
        self.states().any(|(_, s)| s.decay_per_m != 0.0)
    }

    /// Whether a change of constellation adds to the variance of any state.
    pub(crate) fn jumps(&self) -> bool {
        self.states().any(|(_, s)| s.jump > 0.0)
    }

    /// Sum of the parameters of all lever-arm blocks, m.
    pub(crate) fn lever_arm(&self, x: &[f64; CAP]) -> Vector3<f64> {
        let mut sum = Vector3::zeros();
        for (i, s) in self.states() {
            if let Coupling::LeverArm(axis) = s.coupling {
                sum[axis as usize] += x[i];
            }
        }
        sum
    }

    /// Bias and error matrix of the gyros and of the accelerometers that the parameters `x` stand for.
    #[inline(always)]
    pub(crate) fn sensor_errors(&self, x: &[f64; CAP]) -> [SensorError; 2] {
        let mut sums = [0.0; 32];
        for (place, x) in self.places.iter().zip(x).take(self.n).skip(NAV) {
            sums[usize::from(place & 31)] += x;
        }
        [0, 12].map(|first| SensorError {
            bias: Vector3::from_fn(|i, _| sums[first + i]),
            matrix: Matrix3::from_fn(|i, j| sums[first + 3 + 3 * j + i]),
        })
    }

    /// A number that differs between models and layouts, for saved states.
    #[must_use]
    pub fn fingerprint(&self, model: &str) -> u64 {
        // FNV-1a over the model's name, kinds and process classes
        const PRIME: u64 = 0x0000_0100_0000_01b3;
        let start =
            model.bytes().fold(0xcbf2_9ce4_8422_2325, |h: u64, v| (h ^ u64::from(v)).wrapping_mul(PRIME));
        self.blocks.iter().flatten().fold(start, |hash, b| {
            let numbers = [b.kind as u64, u64::from(b.process), u64::from(b.start)];
            numbers.iter().fold(hash, |h, v| (h ^ v).wrapping_mul(PRIME))
        })
    }
}

/// Error of one sensor triad: measured = (I + matrix) true + bias.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct SensorError {
    pub bias: Vector3<f64>,
    pub matrix: Matrix3<f64>,
}

impl BlockState {
    fn new(block: &Block, i: usize) -> Self {
        let at = |values: &[f64; BLOCK_MAX]| values[i.min(BLOCK_MAX - 1)];
        let (decay, drive) = match &block.process {
            Process::Constant => (0.0, 0.0),
            Process::RandomWalk { psd } => (0.0, at(psd)),
            Process::GaussMarkov { sd, tau_s } => (-1.0 / at(tau_s), at(sd) * at(sd)),
        };
        let decay_per_m = if block.distance_m.is_finite() { -1.0 / block.distance_m } else { 0.0 };
        let jump = at(&block.jump_sd) * at(&block.jump_sd);
        let (initial_sd, coupling) = (at(&block.initial_sd), block.kind.coupling(i));
        Self { coupling, act: Act::of(coupling), decay, decay_per_m, drive, jump, initial_sd }
    }

    /// Largest standard deviation that the state has by itself: that of the start or of the stationary process, a jump
    /// included.
    pub(crate) fn most_sd(&self) -> f64 {
        let stationary = if self.decay == 0.0 { 0.0 } else { self.drive };
        self.initial_sd.max(math::sqrt(stationary.max(self.jump)))
    }

    /// Transition over `dt_s` at the ground speed `speed_m_s` and the noise variance Q that makes d²(P + Q/2) + Q/2 exact: for Gauss-Markov
    /// Q = 2 sd² (1 - d²)/(1 + d²), d = exp(-dt/tau), so that P = sd² stays.
    pub(crate) fn discrete(&self, dt_s: f64, speed_m_s: f64) -> (f64, f64) {
        if self.decay == 0.0 {
            return (1.0, self.drive * dt_s);
        }
        let d = math::exp((self.decay + self.decay_per_m * speed_m_s) * dt_s);
        (d, 2.0 * self.drive * (1.0 - d * d) / (1.0 + d * d))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::presets;

    #[test]
    fn every_state_of_every_preset_has_a_name_of_its_own_a_unit_and_a_scale() {
        for preset in presets::PRESETS {
            let blocks: Vec<Block> = preset.blocks.iter().map(|(_, b)| *b).collect();
            let layout = Layout::<40>::new(&blocks).unwrap();
            for i in 0..layout.len() {
                let state = layout.state(i).unwrap();
                assert!(!state.unit.is_empty() && state.scale > 0.0 && state.scale.is_finite());
            }
            assert_eq!(layout.state(layout.len()), None);
            let first = layout.state(NAV).unwrap();
            assert_eq!((first.quantity, first.axis, first.unit), ("gyro_bias", "x", "rad/s"));
            assert_eq!(
                layout.state(8).unwrap(),
                StateInfo { quantity: "dp", axis: "d", unit: "m", scale: 1.0 }
            );
        }
    }
}
