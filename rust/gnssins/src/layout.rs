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

/// One state behind the navigation errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BlockState {
    pub coupling: Coupling,
    /// -1/tau, or 0: 1/s.
    pub decay: f64,
    /// -1/distance, or 0: 1/m.
    pub decay_per_m: f64,
    /// Density of a random walk, unit²/s, or 0.
    pub psd: f64,
    /// Stationary variance of a Gauss-Markov process, unit², or 0.
    pub variance: f64,
    /// Variance that a change of constellation adds, unit².
    pub jump: f64,
}

/// Where each block sits. States 0 to 8 are the navigation errors, blocks follow in the order given.
#[derive(Debug, Clone, Copy)]
pub struct Layout<const CAP: usize> {
    n: usize,
    blocks: [Option<(Block, usize)>; BLOCKS_MAX],
    states: [Option<BlockState>; CAP],
}

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
        let mut layout = Self { n, blocks: [None; BLOCKS_MAX], states: [None; CAP] };
        let mut start = NAV;
        for (slot, block) in layout.blocks.iter_mut().zip(blocks) {
            block.check()?;
            *slot = Some((*block, start));
            for (i, state) in layout.states.iter_mut().skip(start).take(block.kind.len()).enumerate() {
                *state = Some(BlockState::new(block, i));
            }
            start += block.kind.len();
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

    /// The blocks with the index of their first state.
    pub fn blocks(&self) -> impl Iterator<Item = (&Block, usize)> {
        self.blocks.iter().flatten().map(|(b, i)| (b, *i))
    }

    /// First state of the first block of a kind.
    #[must_use]
    pub fn find(&self, kind: BlockKind) -> Option<usize> {
        self.blocks().find(|(b, _)| b.kind == kind).map(|(_, i)| i)
    }

    /// What state `i` is: names, unit and scale for tables, plots and conditioning.
    #[must_use]
    pub fn state(&self, i: usize) -> Option<StateInfo> {
        if i < NAV {
            let (quantity, unit, scale) = NAV_STATES[i / 3];
            return Some(StateInfo { quantity, axis: NED[i % 3], unit, scale });
        }
        let (block, start) = self.blocks().find(|(b, start)| (*start..start + b.kind.len()).contains(&i))?;
        let k = i - start;
        Some(StateInfo {
            quantity: block.kind.name(),
            axis: block.kind.axes()[k],
            unit: block.kind.unit(),
            scale: block.initial_sd[k],
        })
    }

    /// Block states with their indices.
    pub(crate) fn states(&self) -> impl Iterator<Item = (usize, &BlockState)> {
        self.states.iter().enumerate().filter_map(|(i, s)| s.as_ref().map(|s| (i, s)))
    }

    /// Whether the correlation of any state depends on the ground speed.
    pub(crate) fn is_spatial(&self) -> bool {
        self.states().any(|(_, s)| s.decay_per_m != 0.0)
    }

    /// Variances that a change of constellation adds, or `None` when it adds nothing.
    pub(crate) fn jump(&self) -> Option<[f64; CAP]> {
        let mut jump = [0.0; CAP];
        for (i, s) in self.states() {
            jump[i] = s.jump;
        }
        jump.iter().any(|v| *v > 0.0).then_some(jump)
    }

    /// Sum of the parameters of all lever-arm blocks, m.
    pub(crate) fn lever_arm(&self, x: &[f64; CAP]) -> Vector3<f64> {
        let mut sum = Vector3::zeros();
        for (i, s) in self.states() {
            if let Coupling::LeverArm(axis) = s.coupling {
                sum[axis] += x[i];
            }
        }
        sum
    }

    /// Bias and error matrix of the gyros and of the accelerometers that the parameters `x` stand for.
    pub(crate) fn sensor_errors(&self, x: &[f64; CAP]) -> [SensorError; 2] {
        let mut errors = [SensorError::default(); 2];
        for (i, s) in self.states() {
            let (which, Input { axis, source }) = match s.coupling {
                Coupling::Gyro(input) => (0, input),
                Coupling::Accel(input) => (1, input),
                _ => continue,
            };
            match source {
                Source::Unit => errors[which].bias[axis] += x[i],
                Source::Component(c) => errors[which].matrix[(axis, c)] += x[i],
            }
        }
        errors
    }

    /// A number that differs between models and layouts, for saved states.
    #[must_use]
    pub fn fingerprint(&self, model: &str) -> u64 {
        // FNV-1a over the model's name, kinds and process classes
        const PRIME: u64 = 0x0000_0100_0000_01b3;
        let start =
            model.bytes().fold(0xcbf2_9ce4_8422_2325, |h: u64, v| (h ^ u64::from(v)).wrapping_mul(PRIME));
        self.blocks().fold(start, |hash, (b, i)| {
            let process = match b.process {
                Process::Constant => 0,
                Process::RandomWalk { .. } => 1,
                Process::GaussMarkov { .. } if b.distance_m.is_finite() => 3,
                Process::GaussMarkov { .. } => 2,
            };
            [b.kind as u64, process, i as u64].iter().fold(hash, |h, v| (h ^ v).wrapping_mul(PRIME))
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
        let (decay, psd, variance) = match &block.process {
            Process::Constant => (0.0, 0.0, 0.0),
            Process::RandomWalk { psd } => (0.0, at(psd), 0.0),
            Process::GaussMarkov { sd, tau_s } => (-1.0 / at(tau_s), 0.0, at(sd) * at(sd)),
        };
        let decay_per_m = if block.distance_m.is_finite() { -1.0 / block.distance_m } else { 0.0 };
        let jump = at(&block.jump_sd) * at(&block.jump_sd);
        Self { coupling: block.kind.coupling(i), decay, decay_per_m, psd, variance, jump }
    }

    /// Transition over `dt_s` at the ground speed `speed_m_s` and the noise variance Q that makes d²(P + Q/2) + Q/2 exact: for Gauss-Markov
    /// Q = 2 sd² (1 - d²)/(1 + d²), d = exp(-dt/tau), so that P = sd² stays.
    pub(crate) fn discrete(&self, dt_s: f64, speed_m_s: f64) -> (f64, f64) {
        if self.decay == 0.0 {
            return (1.0, self.psd * dt_s);
        }
        let d = math::exp((self.decay + self.decay_per_m * speed_m_s) * dt_s);
        (d, 2.0 * self.variance * (1.0 - d * d) / (1.0 + d * d))
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
