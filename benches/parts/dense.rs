//! The same work with whole matrices of nalgebra.

use gnssins::cov::Covariance;
use gnssins::discretise::Transition;
use gnssins::ekf::Ekf;
use gnssins::meas::gnss::GnssFix;
use gnssins::nav::{NAV, NavModel, ned::Ned};
use nalgebra::{SMatrix, Vector3};

/// The states in use.
pub fn covariance<const CAP: usize, const N: usize>(cov: &Covariance<CAP>) -> SMatrix<f64, N, N> {
    SMatrix::from_fn(|i, j| cov.get(i, j))
}

/// Phi and Q of a transition.
pub fn matrices<const CAP: usize, const N: usize>(
    t: &Transition<CAP>,
) -> (SMatrix<f64, N, N>, SMatrix<f64, N, N>) {
    let mut phi = SMatrix::<f64, N, N>::zeros();
    let mut q = SMatrix::<f64, N, N>::zeros();
    for i in 0..N {
        (phi[(i, i)], q[(i, i)]) = (t.blocks.diagonal[i], t.blocks.q[i]);
    }
    for (i, j) in (0..NAV).flat_map(|i| (0..N).map(move |j| (i, j))) {
        phi[(i, j)] = t.top(i, j);
    }
    q.fixed_view_mut::<3, 3>(0, 0).copy_from(&t.q_phi);
    q.fixed_view_mut::<3, 3>(3, 3).copy_from(&t.q_dv);
    (phi, q)
}

/// The system matrix that a transition over a short interval stands for, to first order.
pub fn system<const CAP: usize, const N: usize>(t: &Transition<CAP>, dt_s: f64) -> SMatrix<f64, N, N> {
    (matrices(t).0 - SMatrix::identity()) / dt_s
}

/// exp(F dt) to third order.
pub fn series<const N: usize>(f: &SMatrix<f64, N, N>, dt_s: f64) -> SMatrix<f64, N, N> {
    let one = SMatrix::<f64, N, N>::identity();
    let a = f * dt_s;
    one + a * (one + a * (one + a / 3.0) / 2.0)
}

/// Phi (P + Q/2) Phi' + Q/2.
pub fn predict<const N: usize>(phi: &SMatrix<f64, N, N>, q: &SMatrix<f64, N, N>, p: &mut SMatrix<f64, N, N>) {
    *p += q * 0.5;
    *p = phi * *p * phi.transpose() + q * 0.5;
}

/// H and R of the first `R` rows of a fix: position, then velocity.
pub fn measurement<const CAP: usize, const N: usize, const R: usize>(
    ekf: &Ekf<Ned, CAP>,
    fix: &GnssFix,
) -> (SMatrix<f64, R, N>, SMatrix<f64, R, R>) {
    let mut h = SMatrix::<f64, R, N>::zeros();
    let aid = ekf.model().position_aid(&Vector3::zeros(), &ekf.solution().position);
    h.view_mut((0, 0), (3, NAV)).copy_from(&aid.h);
    for i in 3..R {
        h[(i, i)] = 1.0;
    }
    (h, SMatrix::from_fn(|i, j| fix.covariance[i][j]))
}

/// Covariance after all rows at once, Joseph form.
pub fn update<const N: usize, const R: usize>(
    p: &SMatrix<f64, N, N>,
    h: &SMatrix<f64, R, N>,
    r: &SMatrix<f64, R, R>,
) -> SMatrix<f64, N, N> {
    let ph = p * h.transpose();
    let k = ph * (h * ph + r).try_inverse().unwrap();
    let a = SMatrix::<f64, N, N>::identity() - k * h;
    a * p * a.transpose() + k * r * k.transpose()
}
