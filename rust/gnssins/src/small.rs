//! Dense helpers for measurements of at most six rows.

use crate::math;

/// Most rows of one measurement.
pub const ROWS_MAX: usize = 6;

/// Square matrix of a measurement, the first rows and columns in use.
pub type Square = [[f64; ROWS_MAX]; ROWS_MAX];

/// Lower Cholesky factor of the leading part of a matrix.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Factor {
    /// What stands below the diagonal.
    pub(crate) l: Square,
    /// One over the diagonal.
    pub(crate) per: [f64; ROWS_MAX],
    /// Whether nothing stands below the diagonal.
    pub(crate) diagonal: bool,
    n: usize,
}

impl Factor {
    /// Of the leading `n` x `n` part, or `None` when it is not positive definite.
    #[inline]
    pub(crate) fn of(a: &Square, n: usize) -> Option<Self> {
        let n = n.min(ROWS_MAX);
        let mut factor = Self { l: [[0.0; ROWS_MAX]; ROWS_MAX], per: [0.0; ROWS_MAX], diagonal: true, n };
        for i in 0..n {
            for j in 0..i {
                factor.diagonal &= a[i][j] == 0.0;
            }
        }
        let l = &mut factor.l;
        for i in 0..n {
            let mut pivot = a[i][i];
            if !factor.diagonal {
                for j in 0..i {
                    let mut sum = a[i][j];
                    for k in 0..j {
                        sum -= l[i][k] * l[j][k];
                    }
                    sum *= factor.per[j];
                    l[i][j] = sum;
                    pivot -= sum * sum;
                }
            }
            if !(pivot.is_finite() && pivot > 0.0) {
                return None;
            }
            factor.per[i] = 1.0 / math::sqrt(pivot);
        }
        Some(factor)
    }

    /// x of `l x = b`; 0 behind the leading part.
    #[inline]
    pub(crate) fn solve(&self, b: &[f64; ROWS_MAX]) -> [f64; ROWS_MAX] {
        let mut x = [0.0; ROWS_MAX];
        for i in 0..self.n.min(ROWS_MAX) {
            let mut sum = b[i];
            for j in 0..i {
                sum -= self.l[i][j] * x[j];
            }
            x[i] = sum * self.per[i];
        }
        x
    }

    /// b' A⁻¹ b.
    #[inline]
    pub(crate) fn norm_squared(&self, b: &[f64; ROWS_MAX]) -> f64 {
        self.solve(b).iter().map(|x| x * x).sum()
    }
}

/// Upper tail probability of the chi-square distribution with `dof` degrees of freedom.
/// Recurrence over the degrees from 1 (erfc) or 2 (exp); Abramowitz and Stegun 26.4.4-26.4.5.
#[must_use]
pub fn chi_square_tail(dof: usize, x: f64) -> f64 {
    if x <= 0.0 {
        return 1.0;
    }
    let half = 0.5 * x;
    let (mut k, mut tail, mut term) = if dof % 2 == 1 {
        // the next term is half^(1/2) e^-half / Gamma(3/2)
        (
            1,
            libm::erfc(math::sqrt(half)),
            math::sqrt(half) * math::exp(-half) * core::f64::consts::FRAC_2_SQRT_PI,
        )
    } else {
        (2, math::exp(-half), half * math::exp(-half))
    };
    while k < dof {
        tail += term;
        k += 2;
        term *= half / (0.5 * k as f64);
    }
    tail
}

/// Chi-square value that a variable with `dof` degrees of freedom exceeds with probability `1 - probability`.
#[must_use]
pub fn chi_square_quantile(dof: usize, probability: f64) -> f64 {
    let tail = (1.0 - probability).clamp(1e-15, 1.0);
    let (mut low, mut high) = (0.0, 200.0);
    for _ in 0..100 {
        let mid = 0.5 * (low + high);
        if chi_square_tail(dof, mid) > tail { low = mid } else { high = mid }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chi_square_quantiles_match_tables() {
        // scipy.stats.chi2.ppf
        for (dof, p, want) in [
            (1, 0.95, 3.841_458_820_694_124),
            (2, 0.99, 9.210_340_371_976_18),
            (3, 0.999, 16.266_236_196_238_13),
            (4, 0.5, 3.356_693_980_033_321),
            (5, 0.999, 20.515_005_652_432_873),
            (6, 0.999, 22.457_744_484_825_323),
        ] {
            assert!((chi_square_quantile(dof, p) / want - 1.0).abs() < 1e-12, "{dof} {p}");
        }
    }

    #[test]
    fn whitening_turns_the_covariance_into_the_identity() {
        let a: Square = core::array::from_fn(|i| {
            core::array::from_fn(|j| if i == j { 2.0 + i as f64 } else { 0.3 / (1.0 + (i + j) as f64) })
        });
        for n in 1..=6 {
            let factor = Factor::of(&a, n).unwrap();
            assert_eq!(factor.diagonal, n == 1);
            // L^-1 A = L', column by column; what stands behind the leading part does not count
            for j in 0..n {
                let column: [f64; 6] = core::array::from_fn(|i| if i < n { a[i][j] } else { f64::NAN });
                let x = factor.solve(&column);
                for i in 0..6 {
                    let below = if i == j && i < n { 1.0 / factor.per[i] } else { factor.l[j][i] };
                    assert!((x[i] - if i < n { below } else { 0.0 }).abs() < 1e-14, "{n} {i} {j}");
                }
            }
        }
        let alone = Factor::of(
            &core::array::from_fn(|i| core::array::from_fn(|j| if i == j { 4.0 } else { 0.0 })),
            6,
        );
        assert!(alone.is_some_and(|f| f.diagonal && f.norm_squared(&[2.0; 6]) == 6.0));
        assert!(Factor::of(&[[1.0; 6]; 6], 6).is_none());
    }
}
