//! The inertial sensors: from the increments of the truth to what an imperfect IMU puts out, block by block.
//!
//! `measured = (I + S + M) true + b dt + noise`; then the range clips the mean rate of each sample, and the resolution
//! rounds the accumulated angle or velocity, so that no rounding error builds up. Errors that vary enter with their mean
//! over the interval. Everything is plain products and sums: the same bits for every set of instructions.

use super::normal::{BLOCK, Deviates, stream};
use super::process::{Law, LowPass, Series};
use crate::simd::{self, Eight, Kernel};

/// What an error acts on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum ErrorKind {
    /// Added to the rate.
    GyroBias,
    /// Added to the specific force.
    AccelBias,
    /// Times the same axis of the turn.
    GyroScale,
    /// The same of the velocity increment.
    AccelScale,
    /// Times the other axes of the turn: xy, xz, yx, yz, zx, zy.
    GyroMisalignment,
    /// The same of the velocity increment.
    AccelMisalignment,
}

impl ErrorKind {
    /// 0: gyros, 1: accelerometers.
    const fn triad(self) -> usize {
        matches!(self, Self::AccelBias | Self::AccelScale | Self::AccelMisalignment) as usize
    }

    /// Number of components.
    #[must_use]
    pub const fn len(self) -> usize {
        if matches!(self, Self::GyroMisalignment | Self::AccelMisalignment) { 6 } else { 3 }
    }

    /// Never.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        false
    }
}

/// Output and input axis of the terms of a misalignment.
const MISALIGNMENT: [(usize, usize); 6] = [(0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1)];

/// A slowly varying error.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorError {
    /// What it acts on.
    pub kind: ErrorKind,
    /// Its stream, [`stream`] of its name.
    pub stream: u32,
    /// Its law.
    pub law: Law,
}

/// Noise, range and resolution of a triad.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Triad {
    /// Root of the two-sided noise density, rad/sqrt(s) or m/s/sqrt(s).
    pub density: [f64; 3],
    /// Low-pass of the noise.
    pub low_pass: Option<LowPass>,
    /// Largest mean rate, rad/s or m/s².
    pub full_scale: Option<f64>,
    /// Resolution of an increment, rad or m/s.
    pub lsb: Option<f64>,
}

/// Streams of the noise of gyros and accelerometers.
const NOISE: [u32; 2] = [stream("imu.gyro"), stream("imu.accel")];

/// Three axes of a block of intervals.
pub type Axes = [[f64; BLOCK]; 3];

/// The inertial sensors and what they would measure without errors.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Imu {
    /// Lengths of the intervals, s, by blocks; 0 after the last.
    pub dt_s: Vec<[f64; BLOCK]>,
    /// Exact increments of angle (rad) and velocity (m/s) by blocks.
    pub exact: [Vec<Axes>; 2],
    /// Gyros and accelerometers.
    pub triads: [Triad; 2],
    /// Slowly varying errors, in the order of the scenario.
    pub errors: Vec<SensorError>,
}

impl Imu {
    /// The same without errors, noise and limits.
    #[must_use]
    pub fn without_errors(&self) -> Self {
        Self { dt_s: self.dt_s.clone(), exact: self.exact.clone(), ..Self::default() }
    }
}

/// The sensors of one run on their way.
pub struct ImuRun<'p> {
    imu: &'p Imu,
    deviates: Deviates,
    errors: Vec<Series<'p>>,
    low_passed: [[f64; 3]; 2],
    /// Increments summed up for the resolution, and whole counts put out so far.
    summed: [[f64; 3]; 2],
    counts: [[f64; 3]; 2],
    noise: [[f64; BLOCK]; 6],
    measured: [Axes; 2],
}

impl<'p> ImuRun<'p> {
    /// Before the first interval.
    #[must_use]
    pub fn new(imu: &'p Imu, deviates: Deviates) -> Self {
        let series = |e: &'p SensorError| Series::new(&e.law, e.stream, e.kind.len(), &deviates);
        let start = |triad: usize| {
            imu.triads[triad].low_pass.map_or([0.0; 3], |filter| filter.start(NOISE[triad], &deviates))
        };
        Self {
            imu,
            deviates,
            errors: imu.errors.iter().map(series).collect(),
            low_passed: [start(0), start(1)],
            summed: [[0.0; 3]; 2],
            counts: [[0.0; 3]; 2],
            noise: [[0.0; BLOCK]; 6],
            measured: [[[0.0; BLOCK]; 3]; 2],
        }
    }

    /// Makes the next block; blocks come in order.
    pub fn block(&mut self, block: usize) {
        simd::run(self.deviates.isa(), Make { run: self, block });
    }

    /// Increments of gyros and accelerometers in the present block.
    #[must_use]
    pub const fn measured(&self) -> &[Axes; 2] {
        &self.measured
    }

    /// Slowly varying errors in the present block.
    #[must_use]
    pub fn errors(&self) -> &[Series<'p>] {
        &self.errors
    }

    #[inline(always)]
    fn make(&mut self, block: usize) {
        let dt = &self.imu.dt_s[block];
        for triad in 0..2 {
            self.measured[triad] = self.imu.exact[triad][block];
        }
        for (series, error) in self.errors.iter_mut().zip(&self.imu.errors) {
            series.advance_here(&self.deviates, block as u32);
            let triad = error.kind.triad();
            add_error(error.kind, series, &self.imu.exact[triad][block], dt, &mut self.measured[triad]);
        }
        for triad in 0..2 {
            self.add_noise(triad, block);
            self.limit(triad, dt);
        }
    }

    #[inline(always)]
    fn add_noise(&mut self, triad: usize, block: usize) {
        let figures = &self.imu.triads[triad];
        if figures.density == [0.0; 3] {
            return;
        }
        let (dt, out) = (&self.imu.dt_s[block], &mut self.measured[triad]);
        let Some(low_pass) = &figures.low_pass else {
            let noise = &mut self.noise[..3];
            self.deviates.fill_here(NOISE[triad], 0, block as u32, noise);
            for axis in 0..3 {
                for i in 0..BLOCK {
                    out[axis][i] += noise[axis][i] * (figures.density[axis] * dt[i].sqrt());
                }
            }
            return;
        };
        self.deviates.fill_here(NOISE[triad], 0, block as u32, &mut self.noise);
        for axis in 0..3 {
            let w = &mut self.low_passed[triad][axis];
            for i in 0..BLOCK {
                let integral = low_pass.integral(w, self.noise[axis][i], self.noise[3 + axis][i]);
                out[axis][i] += integral * figures.density[axis];
            }
        }
    }

    /// Range and resolution.
    #[inline(always)]
    fn limit(&mut self, triad: usize, dt: &[f64; BLOCK]) {
        let figures = &self.imu.triads[triad];
        let out = &mut self.measured[triad];
        if let Some(full_scale) = figures.full_scale {
            for i in 0..BLOCK {
                let most = full_scale * dt[i];
                for axis in out.iter_mut() {
                    axis[i] = axis[i].clamp(-most, most);
                }
            }
        }
        let Some(lsb) = figures.lsb else { return };
        for axis in 0..3 {
            for value in &mut out[axis] {
                self.summed[triad][axis] += *value;
                let counts = (self.summed[triad][axis] / lsb).round_ties_even();
                *value = (counts - self.counts[triad][axis]) * lsb;
                self.counts[triad][axis] = counts;
            }
        }
    }
}

#[inline(always)]
fn add_error(kind: ErrorKind, series: &Series<'_>, exact: &Axes, dt: &[f64; BLOCK], out: &mut Axes) {
    for c in 0..kind.len() {
        let mean = series.means(c);
        let (to, from) = match kind {
            ErrorKind::GyroBias | ErrorKind::AccelBias => (c, dt),
            ErrorKind::GyroScale | ErrorKind::AccelScale => (c, &exact[c]),
            _ => (MISALIGNMENT[c].0, &exact[MISALIGNMENT[c].1]),
        };
        for i in 0..BLOCK {
            out[to][i] += mean[i] * from[i];
        }
    }
}

struct Make<'a, 'p> {
    run: &'a mut ImuRun<'p>,
    block: usize,
}

impl Kernel for Make<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<E: Eight>(self) {
        self.run.make(self.block);
    }
}
