//! Random processes of sensor errors, exact at the epochs of the truth however long the step is.

use super::normal::{BLOCK, Deviates};
use crate::math;
use crate::simd::{self, Eight, Kernel};

/// Most components of a process: the terms of a misalignment.
pub const COMPONENTS: usize = 6;

/// Part of a stream from which values at the start are drawn; the parts from 0 drive the intervals.
pub(super) const START: u32 = 64;

/// One number per component.
pub type Components = [f64; COMPONENTS];

/// Law of a process.
#[derive(Debug, Clone, PartialEq)]
pub enum Law {
    /// Drawn once about a value.
    Constant {
        /// Mean.
        value: Components,
        /// Standard deviation.
        sd: Components,
    },
    /// Variance `initial_sd² + walk² t`.
    Walk {
        /// Standard deviation at the start.
        initial_sd: Components,
        /// Standard deviation of one step.
        step_sd: Components,
    },
    /// First-order Gauss-Markov, stationary from the first epoch on: `x⁺ = keep x + drive n`.
    Markov {
        /// Standard deviation.
        sd: Components,
        /// Share that is left after an interval.
        keep: f64,
        /// Standard deviation of what an interval adds.
        drive_sd: Components,
    },
    /// The same with a rate that changes: `x⁺ = W x + sd sqrt(1 - W²) n`, W of each interval.
    Varying {
        /// Standard deviation.
        sd: Components,
        /// W by blocks of intervals, 1 after the last.
        keep: Vec<[f64; BLOCK]>,
        /// sqrt(1 - W²), 0 after the last.
        drive: Vec<[f64; BLOCK]>,
    },
}

impl Law {
    /// Random walk of `walk` per root second over intervals of `dt_s`.
    #[must_use]
    pub fn walk(initial_sd: Components, walk: &Components, dt_s: f64) -> Self {
        Self::Walk { initial_sd, step_sd: walk.map(|w| w * math::sqrt(dt_s)) }
    }

    /// Gauss-Markov process of correlation time `tau_s` over intervals of `dt_s`.
    #[must_use]
    pub fn markov(sd: Components, tau_s: f64, dt_s: f64) -> Self {
        let drive = math::sqrt(-math::exp_m1(-2.0 * dt_s / tau_s));
        Self::Markov { sd, keep: math::exp(-dt_s / tau_s), drive_sd: sd.map(|s| s * drive) }
    }

    /// Gauss-Markov process that fades by `exp(-growth)` over each interval.
    #[must_use]
    pub fn varying(sd: Components, growth: &[f64]) -> Self {
        let drive = |g: &f64| math::sqrt(-math::exp_m1(-2.0 * g));
        Self::Varying {
            sd,
            keep: blocks(growth.iter().map(|g| math::exp(-g)), 1.0),
            drive: blocks(growth.iter().map(drive), 0.0),
        }
    }

    /// Whether it never changes.
    #[must_use]
    pub const fn is_constant(&self) -> bool {
        matches!(self, Self::Constant { .. })
    }
}

/// Numbers by blocks, the last one filled up.
pub(super) fn blocks(values: impl ExactSizeIterator<Item = f64>, filler: f64) -> Vec<[f64; BLOCK]> {
    let mut out = vec![[filler; BLOCK]; values.len().div_ceil(BLOCK)];
    for (to, from) in out.as_flattened_mut().iter_mut().zip(values) {
        *to = from;
    }
    out
}

/// A process of one run on its way through the epochs.
#[derive(Debug, Clone)]
pub struct Series<'p> {
    law: &'p Law,
    stream: u32,
    len: usize,
    /// Values at the epochs that bound the intervals of the present block.
    history: [[f64; BLOCK + 1]; COMPONENTS],
    deviates: [[f64; BLOCK]; COMPONENTS],
}

impl<'p> Series<'p> {
    /// At the first epoch.
    #[must_use]
    pub fn new(law: &'p Law, stream: u32, len: usize, deviates: &Deviates) -> Self {
        let (mean, sd) = match law {
            Law::Constant { value, sd } => (value, sd),
            Law::Walk { initial_sd: sd, .. } | Law::Markov { sd, .. } | Law::Varying { sd, .. } => {
                (&[0.0; COMPONENTS], sd)
            }
        };
        let drawn = deviates.first::<COMPONENTS>(stream, START);
        let history = core::array::from_fn(|c| [mean[c] + sd[c] * drawn[c]; BLOCK + 1]);
        Self { law, stream, len, history, deviates: [[0.0; BLOCK]; COMPONENTS] }
    }

    /// Number of components.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.len
    }

    /// Never: a process has components.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Component `c` at the beginning of interval `i` of the present block, or, with the number of the last one plus
    /// one, at its end.
    #[must_use]
    pub fn at(&self, c: usize, i: usize) -> f64 {
        self.history[c][i]
    }

    /// Component `c` at a share of the way through interval `i`.
    #[must_use]
    pub fn between(&self, c: usize, i: usize, share: f64) -> f64 {
        self.history[c][i] + share * (self.history[c][i + 1] - self.history[c][i])
    }

    /// Means of a component over the intervals of the block.
    #[inline(always)]
    pub(super) fn means(&self, c: usize) -> [f64; BLOCK] {
        let h = &self.history[c];
        core::array::from_fn(|i| 0.5 * (h[i] + h[i + 1]))
    }

    /// Goes through block `block` of the intervals.
    pub fn advance(&mut self, deviates: &Deviates, block: u32) {
        simd::run(deviates.isa(), Advance { series: self, deviates, block });
    }

    /// As [`Series::advance`], to be compiled into a kernel.
    #[inline(always)]
    pub(super) fn advance_here(&mut self, deviates: &Deviates, block: u32) {
        if self.law.is_constant() {
            return;
        }
        deviates.fill_here(self.stream, 0, block, &mut self.deviates[..self.len]);
        for c in 0..self.len {
            let (h, n) = (&mut self.history[c], &self.deviates[c]);
            let mut x = if block == 0 { h[0] } else { h[BLOCK] };
            h[0] = x;
            match self.law {
                Law::Constant { .. } => {}
                Law::Walk { step_sd, .. } => {
                    for i in 0..BLOCK {
                        x += step_sd[c] * n[i];
                        h[i + 1] = x;
                    }
                }
                Law::Markov { keep, drive_sd, .. } => {
                    for i in 0..BLOCK {
                        x = keep * x + drive_sd[c] * n[i];
                        h[i + 1] = x;
                    }
                }
                Law::Varying { sd, keep, drive } => {
                    let (keep, drive) = (&keep[block as usize], &drive[block as usize]);
                    for i in 0..BLOCK {
                        x = keep[i] * x + sd[c] * drive[i] * n[i];
                        h[i + 1] = x;
                    }
                }
            }
        }
    }
}

struct Advance<'a, 'p> {
    series: &'a mut Series<'p>,
    deviates: &'a Deviates,
    block: u32,
}

impl Kernel for Advance<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<E: Eight>(self) {
        self.series.advance_here(self.deviates, self.block);
    }
}

/// White noise behind a first-order low-pass, from the exact joint law of its value w and of its integral over an
/// interval T. With k = 2 pi corner and a = exp(-k T): `w⁺ = a w + u`, `integral = w (1 - a)/k + v`, for a density of one
///
/// * `var u = k (1 - a²)/2`, `cov(u, v) = (1 - a)²/2`,
/// * `var v = T - 2 (1 - a)/k + (1 - a²)/(2 k)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LowPass {
    start_sd: f64,
    keep: f64,
    sd_u: f64,
    share: f64,
    mixed: f64,
    rest: f64,
}

impl LowPass {
    /// For intervals of `dt_s`.
    #[must_use]
    pub fn new(corner_hz: f64, dt_s: f64) -> Self {
        let k = core::f64::consts::TAU * corner_hz;
        let (fade, fade_twice) = (-math::exp_m1(-k * dt_s), -math::exp_m1(-2.0 * k * dt_s));
        let sd_u = math::sqrt(0.5 * k * fade_twice);
        let mixed = 0.5 * fade * fade / sd_u;
        let rest = dt_s - 2.0 * fade / k + 0.5 * fade_twice / k - mixed * mixed;
        Self {
            start_sd: math::sqrt(0.5 * k),
            keep: math::exp(-k * dt_s),
            sd_u,
            share: fade / k,
            mixed,
            rest: math::sqrt(rest.max(0.0)),
        }
    }

    /// Values at the start, of density one.
    #[must_use]
    pub fn start(&self, stream: u32, deviates: &Deviates) -> [f64; 3] {
        deviates.first(stream, START).map(|n: f64| self.start_sd * n)
    }

    /// Integral over the next interval from two deviates; the value moves on.
    #[inline(always)]
    pub(super) fn integral(&self, w: &mut f64, first: f64, second: f64) -> f64 {
        let integral = *w * self.share + self.mixed * first + self.rest * second;
        *w = self.keep * *w + self.sd_u * first;
        integral
    }
}
