//! Covariance of the fifteen errors: attitude (navigation axes), gyro bias, gyro matrix.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::math;

/// Errors: three of attitude, three of bias, nine of the gyro matrix row by row.
pub const STATES: usize = 15;

/// First error of the bias, of the matrix.
const BIAS: usize = 3;
const MATRIX: usize = 6;

/// Sensor errors alone.
const PARAMS: usize = STATES - BIAS;

/// Numbers that [`Covariance::pack`] gives.
pub const PACKED: usize = STATES * (STATES + 1) / 2;

/// One value per error.
pub type Errors = SVector<f64, STATES>;

/// What a measurement may correct.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Corrects {
    /// Every error, by the optimal gain.
    All,
    /// All but the level, which is only taken into account (consider update, Schmidt 1966).
    NotLevel,
}

/// Covariance, symmetric to the bit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Covariance {
    p: SMatrix<f64, STATES, STATES>,
}

impl Covariance {
    /// Independent errors of the given standard deviations.
    pub fn diagonal(attitude_sd: &Vector3<f64>, bias_sd: f64, matrix_sd: f64) -> Self {
        let sd = Errors::from_fn(|i, _| match i {
            0..BIAS => attitude_sd[i],
            BIAS..MATRIX => bias_sd,
            _ => matrix_sd,
        });
        Self { p: SMatrix::from_diagonal(&sd.component_mul(&sd)) }
    }

    /// Standard deviation of an error.
    pub fn sd(&self, i: usize) -> f64 {
        math::sqrt(self.p[(i, i)])
    }

    /// Sum of the two variances of the level, rad².
    pub fn level(&self) -> f64 {
        self.p[(0, 0)] + self.p[(1, 1)]
    }

    /// Sum of the three variances of the bias.
    pub fn bias(&self) -> f64 {
        (BIAS..MATRIX).map(|i| self.p[(i, i)]).sum()
    }

    /// Variance of the attitude error along `h`.
    pub fn along(&self, h: &Vector3<f64>) -> f64 {
        h.dot(&(self.p.fixed_view::<3, 3>(0, 0) * h))
    }

    /// Adds to the variance of an error.
    pub fn add(&mut self, i: usize, var: f64) {
        self.p[(i, i)] += var;
    }

    /// Carries the errors over an interval in which the body turned by the mean matrix `c_nb` and the rate
    /// `rate` (bias removed) for `dt_s`: $\dot\rho=C(\delta S\,\omega-\delta b)$, sensor errors constant.
    pub fn predict(&mut self, c_nb: &Matrix3<f64>, rate: &Vector3<f64>, dt_s: f64) {
        let a = SMatrix::<f64, 3, PARAMS>::from_fn(|i, j| {
            let cell = j.wrapping_sub(3);
            dt_s * if j < 3 { -c_nb[(i, j)] } else { c_nb[(i, cell / 3)] * rate[cell % 3] }
        });
        let params = self.p.fixed_view::<PARAMS, PARAMS>(BIAS, BIAS).into_owned();
        let before = self.p.fixed_view::<3, PARAMS>(0, BIAS).into_owned();
        let cross = before + a * params;
        let turned = a * before.transpose();
        let attitude = self.p.fixed_view::<3, 3>(0, 0) + turned + cross * a.transpose();
        self.p.fixed_view_mut::<3, 3>(0, 0).copy_from(&attitude);
        self.p.fixed_view_mut::<3, PARAMS>(0, BIAS).copy_from(&cross);
        self.p.fixed_view_mut::<PARAMS, 3>(BIAS, 0).copy_from(&cross.transpose());
        self.mirror();
    }

    /// Scalar measurement `z = h x + v`, v of variance `r`: the correction of every error. The covariance
    /// follows in the form that holds for any gain, by two passes of rank one:
    /// $A=P-k(Ph)^T,\ P^+=A-(Ah)k^T+r\,kk^T$ (Joseph).
    ///
    /// Nothing is corrected by a measurement without a positive finite innovation variance.
    pub fn update(&mut self, h: &Errors, z: f64, r: f64, corrects: Corrects) -> Errors {
        let ph = self.p * h;
        let s = h.dot(&ph) + r;
        if !(s > 0.0 && s.is_finite() && z.is_finite()) {
            return Errors::zeros();
        }
        let mut k = ph / s;
        if corrects == Corrects::NotLevel {
            k[0] = 0.0;
            k[1] = 0.0;
        }
        let a = self.p - k * ph.transpose();
        let ah = a * h;
        self.p = a - ah * k.transpose() + (k * r) * k.transpose();
        self.mirror();
        k * z
    }

    /// Keeps the variance of an error at `most` or below, correlations unchanged.
    pub fn limit(&mut self, i: usize, most: f64) {
        if self.p[(i, i)] > most {
            let share = math::sqrt(most / self.p[(i, i)]);
            for j in 0..STATES {
                self.p[(i, j)] *= share;
                self.p[(j, i)] *= share;
            }
        }
    }

    /// Lower triangle, row by row.
    pub fn pack(&self, out: &mut [f64; PACKED]) {
        let cells = (0..STATES).flat_map(|i| (0..=i).map(move |j| (i, j)));
        out.iter_mut().zip(cells).for_each(|(x, cell)| *x = self.p[cell]);
    }

    /// What [`Covariance::pack`] gave.
    pub fn unpack(packed: &[f64; PACKED]) -> Self {
        let mut p = SMatrix::zeros();
        let cells = (0..STATES).flat_map(|i| (0..=i).map(move |j| (i, j)));
        packed.iter().zip(cells).for_each(|(x, (i, j))| {
            p[(i, j)] = *x;
            p[(j, i)] = *x;
        });
        Self { p }
    }

    fn mirror(&mut self) {
        for i in 0..STATES {
            for j in 0..i {
                let mean = 0.5 * (self.p[(i, j)] + self.p[(j, i)]);
                self.p[(i, j)] = mean;
                self.p[(j, i)] = mean;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attitude;

    fn mixed() -> Covariance {
        let mut p = Covariance::diagonal(&Vector3::new(0.1, 0.2, 0.3), 0.01, 0.02);
        let c = attitude::dcm(&attitude::from_euler(0.3, -0.5, 2.0));
        p.predict(&c, &Vector3::new(1.0, -2.0, 0.5), 0.7);
        p
    }

    #[test]
    fn prediction_is_the_dense_product() {
        let (c, w, dt) =
            (attitude::dcm(&attitude::from_euler(-1.0, 0.4, 0.1)), Vector3::new(0.2, 3.0, -1.0), 0.3);
        let mut p = mixed();
        let mut phi = SMatrix::<f64, STATES, STATES>::identity();
        for i in 0..3 {
            for j in 0..3 {
                phi[(i, 3 + j)] = -c[(i, j)] * dt;
                for k in 0..3 {
                    phi[(i, 6 + 3 * j + k)] = c[(i, j)] * w[k] * dt;
                }
            }
        }
        let dense = phi * p.p * phi.transpose();
        p.predict(&c, &w, dt);
        assert!((p.p - dense).amax() < 1e-15);
    }

    #[test]
    fn update_is_the_textbook_one_and_a_considered_level_stays() {
        let mut h = Errors::zeros();
        (h[0], h[1], h[2]) = (-2.0, 0.3, 1.0);
        let (mut p, before) = (mixed(), mixed());
        let x = p.update(&h, 0.05, 0.01, Corrects::All);
        let s = (h.transpose() * before.p * h)[0] + 0.01;
        let k = before.p * h / s;
        assert!((x - k * 0.05).amax() < 1e-16);
        assert!((p.p - (before.p - k * s * k.transpose())).amax() < 1e-15);

        let mut considered = mixed();
        let x = considered.update(&h, 0.05, 0.01, Corrects::NotLevel);
        assert_eq!((x[0], x[1]), (0.0, 0.0));
        assert_eq!(considered.level(), before.level());
        // the gain of each error is its own optimum: the heading gains as much as by the full update
        assert!(considered.sd(2) < before.sd(2) && (considered.sd(2) - p.sd(2)).abs() < 1e-15);
    }

    #[test]
    fn a_limited_variance_keeps_its_correlations() {
        let (mut p, before) = (mixed(), mixed());
        p.limit(2, 1e-4);
        let rho = |m: &Covariance, i, j| m.p[(i, j)] / (m.sd(i) * m.sd(j));
        assert!((p.sd(2) - 1e-2).abs() < 1e-15);
        assert!((rho(&p, 2, 5) - rho(&before, 2, 5)).abs() < 1e-14);
    }
}
