//! Covariance: block-structured prediction, scalar Joseph update, health.

use crate::discretise::{Column, Transition};
use crate::error::Error;
use crate::math;
use crate::nav::NAV;
use crate::simd::{self, Aligned, Isa, Kernel, madd};

/// Columns that the prediction kernel keeps in registers.
const LANES: usize = 8;

/// Symmetric covariance of up to `CAP` states; rows beyond the `n` in use are zero. `CAP` is a multiple of 8.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(64))]
pub struct Covariance<const CAP: usize> {
    p: [[f64; CAP]; CAP],
    n: usize,
}

impl<const CAP: usize> Covariance<CAP> {
    const CHECKED: () =
        assert!(CAP.is_multiple_of(LANES) && CAP > NAV, "CAP must be a multiple of 8, at least 16");

    /// Diagonal covariance from the variances of the first `n` states.
    #[must_use]
    pub fn from_variances(variances: &[f64; CAP], n: usize) -> Self {
        const { Self::CHECKED }
        let n = n.min(CAP);
        let mut p = [[0.0; CAP]; CAP];
        for i in 0..n {
            p[i][i] = variances[i];
        }
        Self { p, n }
    }

    /// Number of states in use.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.n
    }

    /// Never: a filter has states.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.n == 0
    }

    /// The padded rows.
    #[must_use]
    pub const fn rows(&self) -> &[[f64; CAP]; CAP] {
        &self.p
    }

    /// Element (i, j), 0 outside the matrix.
    #[must_use]
    pub fn get(&self, i: usize, j: usize) -> f64 {
        self.p.get(i).and_then(|row| row.get(j)).copied().unwrap_or(0.0)
    }

    /// Sets (i, j) and (j, i).
    pub(crate) fn set(&mut self, i: usize, j: usize, value: f64) {
        self.p[i][j] = value;
        self.p[j][i] = value;
    }

    /// `P <- Phi (P + Q/2) Phi' + Q/2` with Phi = [A B; 0 D], D diagonal: the product is never formed n x n. Runs on the
    /// widest instructions of the machine.
    pub fn predict(&mut self, t: &Transition<CAP>) {
        self.predict_on(Isa::detect(), t);
    }

    /// As [`Covariance::predict`], on a given set of instructions where the machine has it.
    pub fn predict_on(&mut self, isa: Isa, t: &Transition<CAP>) {
        simd::run(isa, Predict { cov: self, t });
    }

    #[inline(always)]
    pub(crate) fn predict_kernel<const FMA: bool, const TILE: usize>(&mut self, t: &Transition<CAP>) {
        let n = self.n;
        t.add_half_noise(&mut self.p);
        let columns = &t.columns;
        // W = [A B] P, nine rows
        let w = multiply_rows::<FMA, TILE, CAP>(columns, &self.p, n).0;
        // navigation block: W [A B]'
        let nav = times_transposed::<FMA, TILE, CAP>(&w, columns, n);
        let d = &t.blocks.diagonal;
        for i in 0..NAV {
            // cross block: W D
            for (p, (w, d)) in self.p[i].iter_mut().zip(w[i].iter().zip(d)) {
                *p = w * d;
            }
            for j in 0..=i.min(LANES - 1) {
                (self.p[i][j], self.p[j][i]) = (nav[i][j], nav[i][j]);
            }
        }
        self.p[NAV - 1][NAV - 1] =
            w[NAV - 1].iter().zip(&columns.0).fold(0.0, |sum, (w, c)| madd::<FMA>(*w, c[NAV - 1], sum));
        let (top, rest) = self.p.split_at_mut(NAV);
        // block by block: D P D
        if t.blocks.decays {
            for (row, di) in rest.iter_mut().zip(&d[NAV..]).take(n - NAV) {
                for (p, dj) in row.iter_mut().zip(d) {
                    *p *= di * dj;
                }
            }
        }
        // the mirror of the cross block
        for (j, row) in rest.iter_mut().enumerate().take(n - NAV) {
            for i in 0..NAV {
                row[i] = top[i][NAV + j];
            }
        }
        t.add_half_noise(&mut self.p);
    }

    /// Gain of a scalar measurement `y = h x - noise` with unit noise variance, and the covariance after it, by the
    /// Joseph form in two rank-one passes: A = P - k (hP); P⁺ = A - (A h') k' + k k', then mirrored.
    ///
    /// Returns the gain k = P h'/(h P h' + 1), or `None` (nothing changed) when h P h' + 1 is not positive.
    pub fn update(&mut self, h: &[f64; CAP]) -> Option<[f64; CAP]> {
        let gain = self.update_kernel::<false>(h)?;
        self.mirror();
        Some(gain)
    }

    /// As [`Covariance::update`], without the mirroring: what is left of asymmetry after some rows is rounding.
    #[inline(always)]
    pub(crate) fn update_kernel<const FMA: bool>(&mut self, h: &[f64; CAP]) -> Option<[f64; CAP]> {
        let n = self.n;
        let ph = self.times_kernel::<FMA>(h);
        let s = dot::<FMA, CAP>(h, &ph) + 1.0;
        if !(s.is_finite() && s > 0.0) {
            return None;
        }
        let inverse = 1.0 / s;
        let k = ph.map(|v| v * inverse);
        for (row, &ki) in self.p.iter_mut().zip(&k).take(n) {
            for (a, &hp) in row.iter_mut().zip(&ph) {
                *a = madd::<FMA>(-ki, hp, *a);
            }
        }
        let ah = self.times_kernel::<FMA>(h);
        for ((row, &ki), &ahi) in self.p.iter_mut().zip(&k).zip(&ah).take(n) {
            let c = ki - ahi;
            for (a, &kj) in row.iter_mut().zip(&k) {
                *a = madd::<FMA>(c, kj, *a);
            }
        }
        Some(k)
    }

    /// P h' for a row h.
    #[must_use]
    pub fn times(&self, h: &[f64; CAP]) -> [f64; CAP] {
        self.times_kernel::<false>(h)
    }

    /// Zeros of h are skipped: a row of an aid has a handful of others.
    #[inline(always)]
    pub(crate) fn times_kernel<const FMA: bool>(&self, h: &[f64; CAP]) -> [f64; CAP] {
        let mut out = [0.0; CAP];
        for (row, &hj) in self.p.iter().zip(h).take(self.n) {
            if hj != 0.0 {
                for (o, &a) in out.iter_mut().zip(row) {
                    *o = madd::<FMA>(hj, a, *o);
                }
            }
        }
        out
    }

    /// Adds variances to the diagonal.
    pub(crate) fn add_diagonal(&mut self, variances: &[f64; CAP]) {
        for (i, v) in variances.iter().enumerate().take(self.n) {
            self.p[i][i] += v;
        }
    }

    /// Raises variances below their lower bound to it: what is added to the diagonal keeps P positive definite.
    pub(crate) fn raise_to(&mut self, floor: &[f64; CAP]) {
        for (i, &v) in floor.iter().enumerate().take(self.n) {
            self.p[i][i] = self.p[i][i].max(v);
        }
    }

    /// Multiplies a state's sigma, its correlations unchanged.
    pub(crate) fn scale_state(&mut self, i: usize, factor: f64) {
        for j in 0..self.n {
            self.p[i][j] *= factor;
            self.p[j][i] *= factor;
        }
    }

    /// `P <- G P G'` where G differs from I only in the 3x3 block at `start`.
    pub(crate) fn transform3(&mut self, start: usize, g: &nalgebra::Matrix3<f64>) {
        for j in 0..self.n {
            let v = g * nalgebra::Vector3::new(self.p[start][j], self.p[start + 1][j], self.p[start + 2][j]);
            for i in 0..3 {
                self.p[start + i][j] = v[i];
            }
        }
        for row in self.p.iter_mut().take(self.n) {
            let v = g * nalgebra::Vector3::new(row[start], row[start + 1], row[start + 2]);
            row[start..start + 3].copy_from_slice(v.as_slice());
        }
        self.mirror();
    }

    /// Copies the lower triangle to the upper: symmetry is exact by construction.
    pub(crate) fn mirror(&mut self) {
        for i in 0..self.n {
            for j in 0..i {
                self.p[j][i] = self.p[i][j];
            }
        }
    }

    /// Verifies that all variances are finite and positive: what can be asked after every measurement.
    ///
    /// # Errors
    /// [`Error::Covariance`] with the first state that fails and its variance.
    pub(crate) fn check_variances(&self, t_ns: i64) -> Result<(), Error> {
        let bad = |v: f64| !(v.is_finite() && v > 0.0);
        match (0..self.n).find(|i| bad(self.p[*i][*i])) {
            Some(state) => Err(Error::Covariance { t_ns, state, pivot: self.p[state][state] }),
            None => Ok(()),
        }
    }

    /// Verifies that P is finite and positive definite, by a Cholesky factorisation of the correlation matrix.
    ///
    /// # Errors
    /// [`Error::Covariance`] with the first state that fails and its pivot (1 means uncorrelated).
    pub fn check(&self, t_ns: i64) -> Result<(), Error> {
        let mut l = [[0.0; CAP]; CAP];
        let mut scale = [0.0; CAP];
        for i in 0..self.n {
            let variance = self.p[i][i];
            if !(variance.is_finite() && variance > 0.0) {
                return Err(Error::Covariance { t_ns, state: i, pivot: variance });
            }
            scale[i] = 1.0 / math::sqrt(variance);
        }
        for i in 0..self.n {
            for j in 0..=i {
                let sum = self.p[i][j] * scale[i] * scale[j]
                    - l[i].iter().zip(&l[j]).take(j).map(|(a, b)| a * b).sum::<f64>();
                if i == j {
                    if !(sum.is_finite() && sum > 0.0) {
                        return Err(Error::Covariance { t_ns, state: i, pivot: sum });
                    }
                    l[i][i] = math::sqrt(sum);
                } else {
                    l[i][j] = sum / l[j][j];
                }
            }
        }
        Ok(())
    }
}

/// The covariance prediction as a kernel.
struct Predict<'a, const CAP: usize> {
    cov: &'a mut Covariance<CAP>,
    t: &'a Transition<CAP>,
}

impl<const CAP: usize> Kernel for Predict<'_, CAP> {
    type Output = ();

    #[inline(always)]
    fn run<const FMA: bool, const TILE: usize>(self) {
        self.cov.predict_kernel::<FMA, TILE>(self.t);
    }
}

/// Scalar product, summed in [`LANES`] strands.
#[inline(always)]
pub(crate) fn dot<const FMA: bool, const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    let mut sum = [0.0; LANES];
    for (x, y) in a.as_chunks::<LANES>().0.iter().zip(b.as_chunks::<LANES>().0) {
        for ((s, x), y) in sum.iter_mut().zip(x).zip(y) {
            *s = madd::<FMA>(*x, *y, *s);
        }
    }
    sum.iter().sum()
}

/// Nine rows, column by column.
type Columns<const CAP: usize> = Aligned<[Column; CAP]>;

/// Nine rows, given by columns, times a matrix with `n` rows in use. `TILE` columns of all nine rows are summed at a
/// time, so that each element of `b` is read once.
#[inline(always)]
fn multiply_rows<const FMA: bool, const TILE: usize, const CAP: usize>(
    a: &Columns<CAP>,
    b: &[[f64; CAP]; CAP],
    n: usize,
) -> Aligned<[[f64; CAP]; NAV]> {
    let mut out = Aligned([[0.0; CAP]; NAV]);
    for tile in 0..n.div_ceil(TILE) {
        let mut sum = [[0.0; TILE]; NAV];
        for (a, row) in a.0.iter().zip(b).take(n) {
            let x = &row.as_chunks::<TILE>().0[tile];
            for (s, f) in sum.iter_mut().zip(a) {
                for j in 0..TILE {
                    s[j] = madd::<FMA>(*f, x[j], s[j]);
                }
            }
        }
        for (o, s) in out.0.iter_mut().zip(sum) {
            o.as_chunks_mut::<TILE>().0[tile] = s;
        }
    }
    out
}

/// The first eight columns of nine rows times the transpose of nine others, given by columns.
#[inline(always)]
fn times_transposed<const FMA: bool, const TILE: usize, const CAP: usize>(
    w: &[[f64; CAP]; NAV],
    columns: &Columns<CAP>,
    n: usize,
) -> [[f64; LANES]; NAV] {
    let mut out = [[0.0; LANES]; NAV];
    for tile in 0..LANES / TILE {
        let mut sum = [[0.0; TILE]; NAV];
        for (k, column) in columns.0.iter().enumerate().take(n) {
            let x = &column.as_chunks::<TILE>().0[tile];
            for (s, w) in sum.iter_mut().zip(w) {
                for j in 0..TILE {
                    s[j] = madd::<FMA>(w[k], x[j], s[j]);
                }
            }
        }
        for (o, s) in out.iter_mut().zip(sum) {
            o.as_chunks_mut::<TILE>().0[tile] = s;
        }
    }
    out
}
