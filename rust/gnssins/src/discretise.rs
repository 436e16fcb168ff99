//! Transition matrix and process noise over one interval.

use nalgebra::{Matrix3, Vector3};

use crate::blocks::{Coupling, Input, Source};
use crate::error::Error;
use crate::layout::Layout;
use crate::nav::{DV, Dynamics, NAV, PHI};
use crate::simd::{Aligned, madd};

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

impl ImuNoise {
    /// No noise.
    pub const NONE: Self =
        Self { gyro_psd: Vector3::new(0.0, 0.0, 0.0), accel_psd: Vector3::new(0.0, 0.0, 0.0) };
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

/// Rows of a column of nine, padded to whole vectors.
pub(crate) const COLUMN: usize = 16;

/// One column of nine rows.
pub(crate) type Column = [f64; COLUMN];

/// The upper nine rows of Phi (the rest is diagonal) and the process noise of one interval.
#[derive(Debug, Clone, Copy)]
pub struct Transition<const CAP: usize> {
    /// Rows 0 to 8 of Phi, state by state.
    pub(crate) columns: Aligned<[Column; CAP]>,
    /// The rest of Phi, and the noise of the block states.
    pub blocks: BlockStep<CAP>,
    /// Noise of the attitude errors over the interval, rad².
    pub q_phi: Matrix3<f64>,
    /// Noise of the velocity errors over the interval, m²/s².
    pub q_dv: Matrix3<f64>,
}

/// Columns of [F | gyro coupling | accelerometer coupling].
const WIDTH: usize = NAV + 6;
/// First column of the gyro coupling.
const GYRO: usize = NAV;
/// First column of the accelerometer coupling.
const ACCEL: usize = NAV + 3;

/// [F | gyro coupling | accelerometer coupling] or its product with F, column by column.
type Wide = Aligned<[Column; WIDTH]>;

#[inline(always)]
fn widen(dynamics: &Dynamics) -> Wide {
    let mut wide = Aligned([[0.0; COLUMN]; WIDTH]);
    for (j, column) in wide.0.iter_mut().enumerate().take(NAV) {
        for i in 0..NAV {
            column[i] = dynamics.f[(i, j)];
        }
    }
    for j in 0..3 {
        for i in 0..3 {
            wide.0[GYRO + j][PHI + i] = -dynamics.c[(i, j)];
            wide.0[ACCEL + j][DV + i] = dynamics.c[(i, j)];
        }
    }
    wide
}

/// F times columns; about half of F is zero and most of the couplings are, which is skipped.
#[inline(always)]
fn times_f<const FMA: bool>(f: &Wide, x: &Wide) -> Wide {
    let mut out = Aligned([[0.0; COLUMN]; WIDTH]);
    for (o, x) in out.0.iter_mut().zip(&x.0) {
        let mut sum = [0.0; COLUMN];
        for (&a, f) in x.iter().zip(&f.0).take(NAV) {
            if a != 0.0 {
                for (s, f) in sum.iter_mut().zip(f) {
                    *s = madd::<FMA>(a, *f, *s);
                }
            }
        }
        *o = sum;
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
        Self::of::<false>(dynamics, layout, noise, w_b, f_b, blocks, order)
    }

    /// As [`Transition::new`], for a kernel.
    #[inline(always)]
    pub(crate) fn of<const FMA: bool>(
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
        let zero = Aligned([[0.0; COLUMN]; WIDTH]);
        let (x2, x3, h2, h3) = match order {
            Order::First => (zero, zero, 0.0, 0.0),
            Order::Second => (times_f::<FMA>(&x1, &x1), zero, h2, 0.0),
            Order::Third => {
                let x2 = times_f::<FMA>(&x1, &x1);
                (x2, times_f::<FMA>(&x1, &x2), h2, h3)
            }
        };
        let mut c1 = zero;
        for (c1, ((x1, x2), x3)) in c1.0.iter_mut().zip(x1.0.iter().zip(&x2.0).zip(&x3.0)) {
            for i in 0..COLUMN {
                c1[i] = madd::<FMA>(h3, x3[i], madd::<FMA>(h2, x2[i], dt * x1[i]));
            }
        }

        let mut columns = Aligned([[0.0; COLUMN]; CAP]);
        for (j, (column, c1)) in columns.0.iter_mut().zip(&c1.0).enumerate().take(NAV) {
            *column = *c1;
            column[j] += 1.0;
        }
        for (column, (_, state)) in columns.0.iter_mut().skip(NAV).zip(layout.states()) {
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
            let (x1, x2, c1) = (&x1.0[k], &x2.0[k], &c1.0[k]);
            if a == 0.0 {
                for i in 0..COLUMN {
                    column[i] = factor * c1[i];
                }
            } else {
                for i in 0..COLUMN {
                    let decaying = h2 * x1[i] + h3 * (x2[i] + a * x1[i]);
                    column[i] = factor * (c1[i] + a * decaying);
                }
            }
        }
        // the halves of a product and of its transpose: symmetric to the last bit
        let turned = |psd: &Vector3<f64>| {
            let q = c * Matrix3::from_diagonal(&(psd * dt)) * c.transpose();
            0.5 * (q + q.transpose())
        };
        Self { columns, blocks: *blocks, q_phi: turned(&noise.gyro_psd), q_dv: turned(&noise.accel_psd) }
    }

    /// A transition that changes nothing: Phi = I over the navigation errors, no noise of theirs.
    #[must_use]
    pub fn identity(blocks: &BlockStep<CAP>) -> Self {
        let mut columns = Aligned([[0.0; COLUMN]; CAP]);
        for (i, column) in columns.0.iter_mut().enumerate().take(NAV) {
            column[i] = 1.0;
        }
        Self { columns, blocks: *blocks, q_phi: Matrix3::zeros(), q_dv: Matrix3::zeros() }
    }

    /// Element (i, j) of the upper nine rows of Phi; 0 outside.
    #[must_use]
    pub fn top(&self, i: usize, j: usize) -> f64 {
        self.columns.0.get(j).filter(|_| i < NAV).map_or(0.0, |column| column[i])
    }

    /// Sets element (i, j) of the upper nine rows of Phi; nothing outside.
    pub fn set_top(&mut self, i: usize, j: usize, value: f64) {
        if let Some(column) = self.columns.0.get_mut(j).filter(|_| i < NAV) {
            column[i] = value;
        }
    }

    /// Carries an error estimate over the interval.
    pub(crate) fn carry(&self, x: &mut [f64; CAP]) {
        let mut top = [0.0; COLUMN];
        for (column, x) in self.columns.0.iter().zip(&*x) {
            for (t, c) in top.iter_mut().zip(column) {
                *t += c * x;
            }
        }
        for (x, d) in x.iter_mut().zip(&self.blocks.diagonal) {
            *x *= d;
        }
        x[..NAV].copy_from_slice(&top[..NAV]);
    }

    /// Adds half of the process noise to a covariance.
    #[inline(always)]
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
