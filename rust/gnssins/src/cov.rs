//! Covariance: block-structured prediction, scalar Joseph update, health.

use crate::discretise::Transition;
use crate::error::Error;
use crate::math;
use crate::nav::NAV;

/// Columns that the prediction kernel keeps in registers.
const LANES: usize = 8;

/// Symmetric covariance of up to `CAP` states; rows beyond the `n` in use are zero. `CAP` is a multiple of 8.
#[derive(Debug, Clone, Copy, PartialEq)]
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

    /// `P <- Phi (P + Q/2) Phi' + Q/2` with Phi = [A B; 0 D], D diagonal: the product is never formed n x n.
    pub fn predict(&mut self, t: &Transition<CAP>) {
        let n = self.n;
        t.add_half_noise(&mut self.p);
        // W = [A B] P, nine rows
        let w = multiply_rows(&t.top, &self.p, n);
        // navigation block: W [A B]', lower triangle mirrored
        for i in 0..NAV {
            for j in 0..=i {
                let dot = dot(&w[i], &t.top[j]);
                self.set(i, j, dot);
            }
        }
        // cross block: W D, and its mirror
        let d = &t.blocks.diagonal;
        for i in 0..NAV {
            for j in NAV..n {
                let value = w[i][j] * d[j];
                self.set(i, j, value);
            }
        }
        // block by block: D P D
        if t.blocks.decays {
            for i in NAV..n {
                for j in NAV..n {
                    self.p[i][j] *= d[i] * d[j];
                }
            }
        }
        t.add_half_noise(&mut self.p);
    }

    /// Gain of a scalar measurement `y = h x - noise` with unit noise variance, and the covariance after it, by the
    /// Joseph form in two rank-one passes: A = P - k (hP); P⁺ = A - (A h') k' + k k', then mirrored.
    ///
    /// Returns the gain k = P h'/(h P h' + 1), or `None` (nothing changed) when h P h' + 1 is not positive.
    pub fn update(&mut self, h: &[f64; CAP]) -> Option<[f64; CAP]> {
        let n = self.n;
        let ph = self.times(h);
        let s = dot(h, &ph) + 1.0;
        if !(s.is_finite() && s > 0.0) {
            return None;
        }
        let k = ph.map(|v| v / s);
        let mut ah = [0.0; CAP];
        for ((row, &ki), ahi) in self.p.iter_mut().zip(&k).zip(&mut ah).take(n) {
            for (a, &hp) in row.iter_mut().zip(&ph) {
                *a -= ki * hp;
            }
            *ahi = dot(row, h);
        }
        for ((row, &ki), &ahi) in self.p.iter_mut().zip(&k).zip(&ah).take(n) {
            let c = ki - ahi;
            for (a, &kj) in row.iter_mut().zip(&k) {
                *a += c * kj;
            }
        }
        self.mirror();
        Some(k)
    }

    /// P h' for a row h.
    #[must_use]
    pub fn times(&self, h: &[f64; CAP]) -> [f64; CAP] {
        let mut out = [0.0; CAP];
        for (row, &hj) in self.p.iter().zip(h).take(self.n) {
            if hj != 0.0 {
                for (o, &a) in out.iter_mut().zip(row) {
                    *o += hj * a;
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
    fn mirror(&mut self) {
        for i in 0..self.n {
            for j in 0..i {
                self.p[j][i] = self.p[i][j];
            }
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

fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    let mut sum = [0.0; LANES];
    for (x, y) in a.as_chunks::<LANES>().0.iter().zip(b.as_chunks::<LANES>().0) {
        for ((s, x), y) in sum.iter_mut().zip(x).zip(y) {
            *s += x * y;
        }
    }
    sum.iter().sum()
}

/// Columns that the product keeps in registers beside three rows of factors.
const TILE: usize = 4;

/// Nine rows times a matrix with `n` rows in use. Three rows at a time share each load of `b`.
fn multiply_rows<const CAP: usize>(
    a: &[[f64; CAP]; NAV],
    b: &[[f64; CAP]; CAP],
    n: usize,
) -> [[f64; CAP]; NAV] {
    let mut out = [[0.0; CAP]; NAV];
    for (a3, out3) in a.as_chunks::<3>().0.iter().zip(out.as_chunks_mut::<3>().0) {
        let [a0, a1, a2] = a3;
        for tile in 0..n.div_ceil(TILE) {
            let [mut c0, mut c1, mut c2] = [[0.0; TILE]; 3];
            for (((row, f0), f1), f2) in b.iter().zip(a0).zip(a1).zip(a2).take(n) {
                let x = &row.as_chunks::<TILE>().0[tile];
                for j in 0..TILE {
                    c0[j] += f0 * x[j];
                    c1[j] += f1 * x[j];
                    c2[j] += f2 * x[j];
                }
            }
            for (o, c) in out3.iter_mut().zip([c0, c1, c2]) {
                o.as_chunks_mut::<TILE>().0[tile] = c;
            }
        }
    }
    out
}
