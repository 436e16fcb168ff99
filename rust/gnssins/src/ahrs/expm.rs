//! Exponential of a small matrix, without a heap and without a division.

use nalgebra::SMatrix;

/// Norm up to which the series is summed as it stands.
const SERIES_NORM: f64 = 0.5;

/// Terms of the series: the first one left out is below 1e-17 at [`SERIES_NORM`].
const TERMS: u32 = 13;

/// Most doublings; a norm beyond 2^62 gives no meaning to an exponential.
const DOUBLINGS_MAX: i32 = 62;

/// $e^{A}$ by scaling, Taylor series and squaring (Moler and Van Loan 2003, method 3).
///
/// A matrix that is not finite gives one that is not finite; growth beyond the range of `f64` does too.
#[must_use]
pub fn expm<const N: usize>(a: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    let norm = a.row_iter().map(|r| r.iter().map(|x| x.abs()).sum::<f64>()).fold(0.0, f64::max);
    let mut scale = 1.0;
    let mut doublings = 0;
    while norm * scale > SERIES_NORM && doublings < DOUBLINGS_MAX {
        scale *= 0.5;
        doublings += 1;
    }
    let a = a * scale;
    let identity = SMatrix::<f64, N, N>::identity();
    let mut sum = identity;
    for term in (1..=TERMS).rev() {
        sum = identity + a * sum * (1.0 / f64::from(term));
    }
    for _ in 0..doublings {
        sum *= sum;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attitude::{dcm, exp, skew};
    use nalgebra::{Matrix2, Matrix3, Vector3};

    #[test]
    fn exponential_of_a_skew_matrix_is_the_rotation() {
        for w in [Vector3::new(0.3, -0.2, 0.5), Vector3::new(30.0, 4.0, -21.0), Vector3::new(1e-9, 0.0, 0.0)]
        {
            assert!((expm(&skew(&w)) - dcm(&exp(&w))).norm() < 1e-13 * (1.0 + w.norm()), "{w}");
        }
    }

    #[test]
    fn exponential_equals_closed_forms() {
        // a Jordan block, a decay, a damped oscillation
        let jordan = expm(&Matrix2::new(-2.0, 1.0, 0.0, -2.0));
        assert!((jordan - Matrix2::new(1.0, 1.0, 0.0, 1.0) * (-2f64).exp()).norm() < 1e-15);
        let decay = expm(&Matrix3::from_diagonal(&Vector3::new(-40.0, -1.0, 3.0)));
        let want = Matrix3::from_diagonal(&Vector3::new((-40f64).exp(), (-1f64).exp(), 3f64.exp()));
        assert!((decay - want).norm() < 1e-13);
        let spin = expm(&Matrix2::new(-1.0, -5.0, 5.0, -1.0));
        let want = Matrix2::new(5f64.cos(), -5f64.sin(), 5f64.sin(), 5f64.cos()) * (-1f64).exp();
        assert!((spin - want).norm() < 1e-14);
    }
}
