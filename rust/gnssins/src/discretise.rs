//! Transition matrix and process noise over one interval.

use nalgebra::{Matrix3, Vector3};

use crate::blocks::{Coupling, Input, Source};
use crate::error::Error;
use crate::layout::Layout;
use crate::nav::{DV, Dynamics, Matrix9, Matrix9x3, NAV, PHI};

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

/// The upper nine rows of Phi (the rest is diagonal) and the process noise of one interval.
#[derive(Debug, Clone, Copy)]
pub struct Transition<const CAP: usize> {
    /// Rows 0 to 8 of Phi over all states.
    pub top: [[f64; CAP]; NAV],
    /// Diagonal of Phi over the block states; 1 before them.
    pub diagonal: [f64; CAP],
    /// Noise of the attitude errors over the interval, rad².
    pub q_phi: Matrix3<f64>,
    /// Noise of the velocity errors over the interval, m²/s².
    pub q_dv: Matrix3<f64>,
    /// Noise of the block states over the interval, unit².
    pub q_blocks: [f64; CAP],
}

/// Series coefficients of a coupling column: Phi_nb = c1 + a c2 + a² c3 with the decay rate a.
struct Column {
    c1: Matrix9x3,
    c2: Matrix9x3,
    c3: Matrix9x3,
}

impl Column {
    fn new(f: &Matrix9, g: &Matrix9x3, dt: f64, order: Order) -> Self {
        let (h2, h3) = (dt * dt / 2.0, dt * dt * dt / 6.0);
        let mut column = Self { c1: g * dt, c2: Matrix9x3::zeros(), c3: Matrix9x3::zeros() };
        if order != Order::First {
            let fg = f * g;
            column.c1 += fg * h2;
            column.c2 += g * h2;
            if order == Order::Third {
                column.c1 += f * fg * h3;
                column.c2 += fg * h3;
                column.c3 += g * h3;
            }
        }
        column
    }
}

impl<const CAP: usize> Transition<CAP> {
    /// Discretises the dynamics of mid-interval over `dt_s`. `w_b` and `f_b` are the true mean rate (rad/s) and
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
        dt_s: f64,
        order: Order,
    ) -> Self {
        let Dynamics { f, c } = dynamics;
        let mut nn = f * dt_s;
        if order != Order::First {
            let ff = f * f;
            nn += ff * (dt_s * dt_s / 2.0);
            if order == Order::Third {
                nn += f * ff * (dt_s * dt_s * dt_s / 6.0);
            }
        }
        nn += Matrix9::identity();

        let mut top = [[0.0; CAP]; NAV];
        for (i, row) in top.iter_mut().enumerate() {
            for (j, value) in row.iter_mut().take(NAV).enumerate() {
                *value = nn[(i, j)];
            }
        }
        let gyro = Column::new(f, &dynamics.gyro_coupling(), dt_s, order);
        let accel = Column::new(f, &dynamics.accel_coupling(), dt_s, order);
        let mut diagonal = [1.0; CAP];
        let mut q_blocks = [0.0; CAP];
        for (j, state) in layout.states() {
            (diagonal[j], q_blocks[j]) = state.discrete(dt_s);
            let (column, Input { axis, source }, true_value) = match state.coupling {
                Coupling::Gyro(input) => (&gyro, input, w_b),
                Coupling::Accel(input) => (&accel, input, f_b),
                _ => continue,
            };
            let factor = match source {
                Source::Unit => 1.0,
                Source::Component(k) => true_value[k],
            };
            let a = state.decay;
            for (i, row) in top.iter_mut().enumerate() {
                row[j] =
                    factor * (column.c1[(i, axis)] + a * (column.c2[(i, axis)] + a * column.c3[(i, axis)]));
            }
        }
        let turned = |psd: &Vector3<f64>| c * Matrix3::from_diagonal(&(psd * dt_s)) * c.transpose();
        Self { top, diagonal, q_phi: turned(&noise.gyro_psd), q_dv: turned(&noise.accel_psd), q_blocks }
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
        for (i, q) in self.q_blocks.iter().enumerate() {
            p[i][i] += 0.5 * q;
        }
    }
}
