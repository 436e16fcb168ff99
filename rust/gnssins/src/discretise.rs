//! Transition matrix and process noise over one interval.

use nalgebra::{Matrix3, Vector3};

use crate::blocks::{Coupling, Input, Source};
use crate::error::Error;
use crate::layout::Layout;
use crate::nav::{DV, Dynamics, NAV, PHI};

/// Highest power of F dt in the series of the transition matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Order {
    /// I + F dt.
    First,
    /// + (F dt)²/2.
    Second,
    /// + (F dt)³/6.
    #[default]
    Third,
}

impl Order {
    /// From the number 1, 2 or 3.
    ///
    /// # Errors
    /// [`Error::Config`] for another number.
    pub fn from_number(n: u8) -> Result<Self, Error> {
        match n {
            1 => Ok(Self::First),
            2 => Ok(Self::Second),
            3 => Ok(Self::Third),
            _ => {
                Err(Error::Config { what: "filter.phi_order", need: "must be 1, 2 or 3", got: f64::from(n) })
            }
        }
    }
}

/// White noise of the inertial sensors, spectral densities per body axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuNoise {
    /// Gyro, rad²/s (the square of the angle random walk).
    pub gyro_psd: Vector3<f64>,
    /// Accelerometer, m²/s³ (the square of the velocity random walk).
    pub accel_psd: Vector3<f64>,
}

/// Transition and noise of the block states over one interval length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BlockStep<const CAP: usize> {
    dt_s: f64,
    speed_m_s: f64,
    /// Whether any state decays.
    pub(crate) decays: bool,
    /// Diagonal of Phi over the block states; 1 before them.
    pub diagonal: [f64; CAP],
    /// Noise variances over the interval, unit².
    pub q: [f64; CAP],
}

impl<const CAP: usize> BlockStep<CAP> {
    /// For intervals of `dt_s` at the ground speed `speed_m_s`, which counts for errors that are correlated over
    /// distance only.
    #[must_use]
    pub fn new(layout: &Layout<CAP>, dt_s: f64, speed_m_s: f64) -> Self {
        let (mut diagonal, mut q) = ([1.0; CAP], [0.0; CAP]);
        for (j, state) in layout.states() {
            (diagonal[j], q[j]) = state.discrete(dt_s, speed_m_s);
        }
        Self { dt_s, speed_m_s, decays: diagonal.iter().any(|d| *d < 1.0), diagonal, q }
    }

    /// Makes it fit another interval length or speed; nothing is computed while both stay.
    pub(crate) fn fit(&mut self, layout: &Layout<CAP>, dt_s: f64, speed_m_s: f64) {
        if self.dt_s != dt_s || self.speed_m_s != speed_m_s {
            *self = Self::new(layout, dt_s, speed_m_s);
        }
    }
}

/// The upper nine rows of Phi (the rest is diagonal) and the process noise of one interval.
#[derive(Debug, Clone, Copy)]
pub struct Transition<const CAP: usize> {
    /// Rows 0 to 8 of Phi over all states.
    pub top: [[f64; CAP]; NAV],
    /// The rest of Phi, and the noise of the block states.
    pub blocks: BlockStep<CAP>,
    /// Noise of the attitude errors over the interval, rad².
    pub q_phi: Matrix3<f64>,
    /// Noise of the velocity errors over the interval, m²/s².
    pub q_dv: Matrix3<f64>,
}

/// Width of a row of [F | gyro coupling | accelerometer coupling], padded to whole vector registers.
const WIDTH: usize = 16;
/// First column of the gyro coupling in such a row.
const GYRO: usize = NAV;
/// First column of the accelerometer coupling.
const ACCEL: usize = NAV + 3;

/// Nine rows of [F | gyro coupling | accelerometer coupling] or of their products with F.
type Wide = [[f64; WIDTH]; NAV];

fn widen(dynamics: &Dynamics) -> Wide {
    let mut wide = [[0.0; WIDTH]; NAV];
    for j in 0..NAV {
        for i in 0..NAV {
            wide[i][j] = dynamics.f[(i, j)];
        }
    }
    for j in 0..3 {
        for i in 0..3 {
            wide[PHI + i][GYRO + j] = -dynamics.c[(i, j)];
            wide[DV + i][ACCEL + j] = dynamics.c[(i, j)];
        }
    }
    wide
}

/// F times nine rows; about half of F is zero and is skipped.
fn times_f(f: &Wide, x: &Wide) -> Wide {
    let mut out = [[0.0; WIDTH]; NAV];
    for (row, factors) in out.iter_mut().zip(f) {
        let mut sum = [0.0; WIDTH];
        for (&a, x) in factors.iter().zip(x) {
            if a != 0.0 {
                for (s, x) in sum.iter_mut().zip(x) {
                    *s += a * x;
                }
            }
        }
        *row = sum;
    }
    out
}

impl<const CAP: usize> Transition<CAP> {
    /// Discretises the dynamics of mid-interval over the interval of `blocks`. `w_b` and `f_b` are the true mean rate (rad/s) and
    /// specific force (m/s²), with which scale factor and misalignment states act.
    ///
    /// Phi by series of F dt; block states exactly, d = exp(-dt/tau). Q is the density times the interval; the
    /// trapezoid P⁻ = Phi (P + Q/2) Phi' + Q/2 (Groves 2013, eq. 3.46) spreads it over the interval.
    #[must_use]
    pub fn new(
        dynamics: &Dynamics,
        layout: &Layout<CAP>,
        noise: &ImuNoise,
        w_b: &Vector3<f64>,
        f_b: &Vector3<f64>,
        blocks: &BlockStep<CAP>,
        order: Order,
    ) -> Self {
        let c = &dynamics.c;
        let dt = blocks.dt_s;
        // F^k [F | g]: the series of Phi_nn, and of a coupling column with decay rate a,
        // Phi_nb = c1 + a c2 + a² c3, c1 = g dt + F g dt²/2 + F² g dt³/6, c2 = g dt²/2 + F g dt³/6, c3 = g dt³/6
        let (h2, h3) = (dt * dt / 2.0, dt * dt * dt / 6.0);
        let x1 = widen(dynamics);
        let zero = [[0.0; WIDTH]; NAV];
        let (x2, x3, h2, h3) = match order {
            Order::First => (zero, zero, 0.0, 0.0),
            Order::Second => (times_f(&x1, &x1), zero, h2, 0.0),
            Order::Third => {
                let x2 = times_f(&x1, &x1);
                (x2, times_f(&x1, &x2), h2, h3)
            }
        };
        let mut c1 = zero;
        for i in 0..NAV {
            for j in 0..WIDTH {
                c1[i][j] = dt * x1[i][j] + h2 * x2[i][j] + h3 * x3[i][j];
            }
        }

        let mut top = [[0.0; CAP]; NAV];
        for (i, (row, c1)) in top.iter_mut().zip(&c1).enumerate() {
            row[..NAV].copy_from_slice(&c1[..NAV]);
            row[i] += 1.0;
        }
        for (j, state) in layout.states() {
            let (start, Input { axis, source }, true_value) = match state.coupling {
                Coupling::Gyro(input) => (GYRO, input, w_b),
                Coupling::Accel(input) => (ACCEL, input, f_b),
                _ => continue,
            };
            let factor = match source {
                Source::Unit => 1.0,
                Source::Component(k) => true_value[k],
            };
            let (k, a) = (start + axis, state.decay);
            for i in 0..NAV {
                let decaying = if a == 0.0 { 0.0 } else { h2 * x1[i][k] + h3 * (x2[i][k] + a * x1[i][k]) };
                top[i][j] = factor * (c1[i][k] + a * decaying);
            }
        }
        // the halves of a product and of its transpose: symmetric to the last bit
        let turned = |psd: &Vector3<f64>| {
            let q = c * Matrix3::from_diagonal(&(psd * dt)) * c.transpose();
            0.5 * (q + q.transpose())
        };
        Self { top, blocks: *blocks, q_phi: turned(&noise.gyro_psd), q_dv: turned(&noise.accel_psd) }
    }

    /// Carries an error estimate over the interval.
    pub(crate) fn carry(&self, x: &mut [f64; CAP]) {
        let top = self.top.map(|row| row.iter().zip(&*x).map(|(a, x)| a * x).sum::<f64>());
        for (x, d) in x.iter_mut().zip(&self.blocks.diagonal) {
            *x *= d;
        }
        x[..NAV].copy_from_slice(&top);
    }

    /// Adds half of the process noise to a covariance.
    pub(crate) fn add_half_noise(&self, p: &mut [[f64; CAP]; CAP]) {
        for (start, q) in [(PHI, &self.q_phi), (DV, &self.q_dv)] {
            for i in 0..3 {
                for j in 0..3 {
                    p[start + i][start + j] += 0.5 * q[(i, j)];
                }
            }
        }
        for (i, q) in self.blocks.q.iter().enumerate() {
            p[i][i] += 0.5 * q;
        }
    }
}
