//! Dense helpers for measurements of at most six rows.

use crate::math;

/// Most rows of one measurement.
pub const ROWS_MAX: usize = 6;

/// Square matrix of a measurement, the first rows and columns in use.
pub type Square = [[f64; ROWS_MAX]; ROWS_MAX];

/// Lower Cholesky factor of the leading `n` x `n` part, or `None` when it is not positive definite.
pub(crate) fn cholesky(a: &Square, n: usize) -> Option<Square> {
    let mut l = [[0.0; ROWS_MAX]; ROWS_MAX];
    for i in 0..n.min(ROWS_MAX) {
        for j in 0..=i {
            let sum = a[i][j] - l[i].iter().zip(&l[j]).take(j).map(|(x, y)| x * y).sum::<f64>();
            if i == j {
                if !(sum.is_finite() && sum > 0.0) {
                    return None;
                }
                l[i][i] = math::sqrt(sum);
            } else {
                l[i][j] = sum / l[j][j];
            }
        }
    }
    Some(l)
}

/// Solves `l x = b` in place for each of the `n` rows of `b`, the rows being vectors of any width.
pub(crate) fn forward<const W: usize>(l: &Square, b: &mut [[f64; W]; ROWS_MAX], n: usize) {
    for i in 0..n.min(ROWS_MAX) {
        let (done, rest) = b.split_at_mut(i);
        let row = &mut rest[0];
        for (lij, d) in l[i].iter().zip(done.iter()) {
            for (x, y) in row.iter_mut().zip(d) {
                *x -= lij * y;
            }
        }
        for x in row.iter_mut() {
            *x /= l[i][i];
        }
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
        let l = cholesky(&a, 6).unwrap();
        let mut x = a;
        forward(&l, &mut x, 6); // L^-1 A = L'
        for i in 0..6 {
            for j in 0..6 {
                assert!((x[i][j] - l[j][i]).abs() < 1e-14);
            }
        }
        assert!(cholesky(&[[1.0; 6]; 6], 6).is_none());
    }
}
