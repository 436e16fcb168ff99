//! Transition matrix and process noise over one interval.

use nalgebra::{Matrix3, Vector3};

use crate::error::Error;
use crate::layout::{Act, Layout};
use crate::nav::{DV, Dynamics, LAST_FROM, NAV, PHI};
use crate::simd::{Aligned, Eight, LANES, Lanes, Plain, madd};

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

/// The upper nine rows of Phi (the rest is diagonal) and the process noise of one interval.
#[derive(Debug, Clone, Copy)]
pub struct Transition<const CAP: usize> {
    /// Rows 0 to 7 of Phi, state by state.
    pub(crate) columns: Aligned<[Lanes; CAP]>,
    /// Row 8 of Phi.
    pub(crate) last: Aligned<[f64; CAP]>,
    /// The rest of Phi, and the noise of the block states.
    pub blocks: BlockStep<CAP>,
    /// Noise of the attitude errors over the interval, rad².
    pub q_phi: Matrix3<f64>,
    /// Noise of the velocity errors over the interval, m²/s².
    pub q_dv: Matrix3<f64>,
}

/// Last of the nine rows.
pub(crate) const LAST: usize = NAV - 1;

/// Columns of the couplings: gyros, then accelerometers.
const COUPLINGS: usize = 6;

/// `a x + b F y`, column by column: rows 0 to 7 of each in `heads`, row 8 in `lasts`.
#[inline(always)]
fn horner<E: Eight>(
    f: &[E; NAV],
    (a, x, x_last): (f64, &[Lanes], &[f64]),
    (b, y, y_last): (f64, &[Lanes], &[f64]),
    heads: &mut [Lanes],
    lasts: &mut [f64],
) {
    let (a_8, b_8) = (E::splat(a), E::splat(b));
    let x = x.iter().zip(x_last);
    let y = y.iter().zip(y_last);
    for ((head, last), ((x, x_last), (y, y_last))) in heads.iter_mut().zip(lasts).zip(x.zip(y)) {
        // three short sums: one long one would wait for itself
        let mut sums =
            [E::splat(*y_last).times(f[LAST]), E::splat(y[0]).times(f[0]), E::splat(y[1]).times(f[1])];
        for k in [2, 5] {
            for (i, sum) in sums.iter_mut().enumerate() {
                *sum = sum.madd(E::splat(y[k + i]), f[k + i]);
            }
        }
        let [p, q, r] = sums;
        a_8.times(E::load(x)).madd(b_8, p.plus(q).plus(r)).store(head);
        *last = madd::<E>(b, y[LAST_FROM], a * x_last);
    }
}

/// C diag(variance) C', symmetric to the last bit.
#[inline(always)]
fn turned(c: &Matrix3<f64>, variance: &Vector3<f64>) -> Matrix3<f64> {
    let [x, y, z] = [0, 1, 2].map(|i| c.row(i).transpose());
    let [vx, vy, vz] = [x, y, z].map(|row| row.component_mul(variance));
    let (xy, xz, yz) = (vx.dot(&y), vx.dot(&z), vy.dot(&z));
    Matrix3::new(vx.dot(&x), xy, xz, xy, vy.dot(&y), yz, xz, yz, vz.dot(&z))
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
        Self::of::<Plain>(dynamics, layout, noise, w_b, f_b, blocks, order)
    }

    /// As [`Transition::new`], for a kernel.
    #[inline(always)]
    pub(crate) fn of<E: Eight>(
        dynamics: &Dynamics,
        layout: &Layout<CAP>,
        noise: &ImuNoise,
        w_b: &Vector3<f64>,
        f_b: &Vector3<f64>,
        blocks: &BlockStep<CAP>,
        order: Order,
    ) -> Self {
        let dt = blocks.dt_s;
        // By Horner's rule over x = [F | g]: y = x dt²/2 + F x dt³/6 and c = x dt + F y, which gives Phi_nn = I + c, and of a
        // coupling column with decay rate a Phi_nb = c + a y + a² g dt³/6
        let (h2, h3) = match order {
            Order::First => (0.0, 0.0),
            Order::Second => (dt * dt / 2.0, 0.0),
            Order::Third => (dt * dt / 2.0, dt * dt * dt / 6.0),
        };
        let mut t = Self {
            columns: Aligned([[0.0; LANES]; CAP]),
            last: Aligned([0.0; CAP]),
            blocks: *blocks,
            q_phi: turned(&dynamics.c, &(noise.gyro_psd * dt)),
            q_dv: turned(&dynamics.c, &(noise.accel_psd * dt)),
        };
        let mut f = [E::splat(0.0); NAV];
        for (f, column) in f.iter_mut().zip(&dynamics.columns.0) {
            *f = E::load(column);
        }
        let x = &dynamics.columns.0;
        let mut x_last = [0.0; NAV];
        x_last[LAST_FROM] = 1.0;
        let (mut y, mut y_last) = (Aligned([[0.0; LANES]; NAV]), [0.0; NAV]);
        horner::<E>(&f, (h2, x, &x_last), (h3, x, &x_last), &mut y.0, &mut y_last);
        let (columns, last) = (&mut t.columns.0, &mut t.last.0);
        horner::<E>(&f, (dt, x, &x_last), (1.0, &y.0, &y_last), &mut columns[..NAV], &mut last[..NAV]);
        for (i, column) in columns.iter_mut().take(LANES).enumerate() {
            column[i] += 1.0;
        }
        last[LAST] += 1.0;

        let (mut x, x_last) = (Aligned([[0.0; LANES]; COUPLINGS]), [0.0; COUPLINGS]);
        for j in 0..3 {
            let g = [dynamics.c[(0, j)], dynamics.c[(1, j)], dynamics.c[(2, j)]];
            x.0[j] = [-g[0], -g[1], -g[2], 0.0, 0.0, 0.0, 0.0, 0.0];
            x.0[3 + j] = [0.0, 0.0, 0.0, g[0], g[1], g[2], 0.0, 0.0];
        }
        let (mut c, mut c_last) = (Aligned([[0.0; LANES]; COUPLINGS]), [0.0; COUPLINGS]);
        let (y, y_last) = (&mut y.0[..COUPLINGS], &mut y_last[..COUPLINGS]);
        horner::<E>(&f, (h2, &x.0, &x_last), (h3, &x.0, &x_last), y, y_last);
        horner::<E>(&f, (dt, &x.0, &x_last), (1.0, y, y_last), &mut c.0, &mut c_last);
        let factors = [w_b.x, w_b.y, w_b.z, f_b.x, f_b.y, f_b.z, 1.0, 0.0];
        for (j, state) in layout.states() {
            let Some(Act { column, factor }) = state.act else { continue };
            let k = usize::from(column).min(COUPLINGS - 1);
            let (factor, a) = (factors[usize::from(factor & 7)], state.decay);
            let (mut head, mut tail) = (E::load(&c.0[k]), c_last[k]);
            if a != 0.0 {
                head = head.madd(E::splat(a), E::load(&y[k]));
                head = head.madd(E::splat(a * a * h3), E::load(&x.0[k]));
                tail = madd::<E>(a, y_last[k], tail);
            }
            head.times(E::splat(factor)).store(&mut columns[j]);
            last[j] = factor * tail;
        }
        t
    }

    /// A transition that changes nothing: Phi = I over the navigation errors, no noise of theirs.
    #[must_use]
    pub fn identity(blocks: &BlockStep<CAP>) -> Self {
        let (columns, last) = (Aligned([[0.0; LANES]; CAP]), Aligned([0.0; CAP]));
        let mut t = Self { columns, last, blocks: *blocks, q_phi: Matrix3::zeros(), q_dv: Matrix3::zeros() };
        (0..NAV).for_each(|i| t.set_top(i, i, 1.0));
        t
    }

    /// Element (i, j) of the upper nine rows of Phi; 0 outside.
    #[must_use]
    pub fn top(&self, i: usize, j: usize) -> f64 {
        let row = if i == LAST { self.last.0.get(j) } else { self.columns.0.get(j).and_then(|c| c.get(i)) };
        row.copied().unwrap_or(0.0)
    }

    /// Sets element (i, j) of the upper nine rows of Phi; nothing outside.
    pub fn set_top(&mut self, i: usize, j: usize, value: f64) {
        let (columns, last) = (&mut self.columns.0, &mut self.last.0);
        let element = if i == LAST { last.get_mut(j) } else { columns.get_mut(j).and_then(|c| c.get_mut(i)) };
        if let Some(element) = element {
            *element = value;
        }
    }

    /// Carries an error estimate over the interval.
    pub(crate) fn carry(&self, x: &mut [f64; CAP]) {
        let (mut top, mut last) = ([0.0; LANES], 0.0);
        for ((column, l), x) in self.columns.0.iter().zip(&self.last.0).zip(&*x) {
            for (t, c) in top.iter_mut().zip(column) {
                *t += c * x;
            }
            last += l * x;
        }
        for (x, d) in x.iter_mut().zip(&self.blocks.diagonal) {
            *x *= d;
        }
        x[..LANES].copy_from_slice(&top);
        x[LAST] = last;
    }

    /// Half of the process noise of the navigation errors, row by row; the last column has none.
    #[inline(always)]
    pub(crate) fn half_noise(&self) -> Aligned<[Lanes; NAV]> {
        let mut half = Aligned([[0.0; LANES]; NAV]);
        for (start, q) in [(PHI, &self.q_phi), (DV, &self.q_dv)] {
            for i in 0..3 {
                for j in 0..3 {
                    half.0[start + i][start + j] = 0.5 * q[(i, j)];
                }
            }
        }
        half
    }
}
