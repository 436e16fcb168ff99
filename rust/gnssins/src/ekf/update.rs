//! What becomes of a measurement: its innovation covariance, the sequential update, the feedback.

use nalgebra::{Matrix3, Vector3};

use super::{Ekf, navigation};
use crate::attitude::skew;
use crate::cov::{Covariance, Sparse, lanes, lanes_mut};
use crate::error::Error;
use crate::meas::Rows;
use crate::nav::{DP, NAV, NavModel, PHI, from_ned_errors};
use crate::simd::{self, Aligned, Eight, Kernel};
use crate::small::{self, ROWS_MAX, Square};

impl<M: NavModel, const CAP: usize> Ekf<M, CAP> {
    /// H P H' + R of some rows.
    pub(super) fn innovation_covariance(&self, rows: &Rows<CAP>) -> Square {
        simd::run(self.isa, Prior { cov: &self.cov, rows })
    }

    pub(super) fn fuse(&mut self, rows: &Rows<CAP>) -> Result<(), Error> {
        let bad = |pivot| Error::Covariance { t_ns: self.t_ns, state: DP, pivot };
        let factor = small::Factor::of(&rows.r, rows.len).ok_or(bad(rows.r[0][0]))?;
        let kernel = Fuse { cov: &mut self.cov, rows, factor: &factor };
        let mut x = simd::run(self.isa, kernel).ok_or(bad(f64::NAN))?;
        if let Some(floor) = self.floor {
            match self.model.to_ned_errors().map(|t| from_ned_errors(&t)) {
                None => self.cov.raise_to(&floor),
                Some(inverse) => self.raise_ned(&floor, &inverse),
            }
        }
        if let Some(waiting) = self.waiting.take() {
            for (x, w) in x.iter_mut().zip(&waiting) {
                *x += w;
            }
        }
        if self.t_ns.saturating_sub(self.fed_back_ns) >= self.settings.feedback_ns {
            self.feed_back(&x)?;
            self.fed_back_ns = self.t_ns;
        } else {
            self.waiting = Some(x);
        }
        self.cov.check_variances(self.t_ns)?;
        self.check_position()
    }

    /// Moves the error estimate into the state. The attitude error is then measured from another estimate,
    /// Exp(-phi⁺) = Exp(phi_hat) Exp(-phi), so phi⁺ = (I + [phi_hat x]/2)(phi - phi_hat): P turns with it.
    fn feed_back(&mut self, x: &[f64; CAP]) -> Result<(), Error> {
        let nav = navigation(x);
        self.model.correct(&nav);
        let phi: Vector3<f64> = nav.fixed_rows::<3>(PHI).into();
        let g = Matrix3::identity() + 0.5 * skew(&phi);
        simd::run(self.isa, Turn { cov: &mut self.cov, g: &g });
        for (p, x) in self.params.iter_mut().zip(x).skip(NAV) {
            *p += x;
        }
        self.refresh_sensors()
    }
}

/// H P H' + R.
pub(super) struct Prior<'a, const CAP: usize> {
    pub(super) cov: &'a Covariance<CAP>,
    pub(super) rows: &'a Rows<CAP>,
}

impl<const CAP: usize> Kernel for Prior<'_, CAP> {
    type Output = Square;

    #[inline(always)]
    fn run<E: Eight>(self) -> Square {
        let Self { cov, rows } = self;
        let mut h = [Sparse::EMPTY; ROWS_MAX];
        let mut s = rows.r;
        for i in 0..rows.len.min(ROWS_MAX) {
            h[i].set::<E>(&rows.h[i]);
            let ph = cov.times_kernel::<E>(&h[i]);
            for j in 0..=i {
                let hph = h[j].dot::<E>(&ph.0);
                s[i][j] += hph;
                if j < i {
                    s[j][i] += hph;
                }
            }
        }
        s
    }
}

/// The rows, whitened, into the covariance, one after the other: the error estimate, or `None` when P is none any more.
struct Fuse<'a, const CAP: usize> {
    cov: &'a mut Covariance<CAP>,
    rows: &'a Rows<CAP>,
    factor: &'a small::Factor,
}

impl<const CAP: usize> Kernel for Fuse<'_, CAP> {
    type Output = Option<[f64; CAP]>;

    #[inline(always)]
    fn run<E: Eight>(self) -> Option<[f64; CAP]> {
        let Self { cov, rows, factor } = self;
        let y = factor.solve(&rows.y);
        let mut x = Aligned([0.0; CAP]);
        let mut white = Aligned([[0.0; CAP]; ROWS_MAX]);
        let mut h = Sparse::EMPTY;
        for i in 0..rows.len.min(ROWS_MAX) {
            if factor.diagonal {
                h.set::<E>(&rows.h[i]);
                h.scale(factor.per[i]);
            } else {
                let (done, rest) = white.0.split_at_mut(i);
                let row = &mut rest[0];
                *row = rows.h[i];
                for (done, l) in done.iter().zip(&factor.l[i]) {
                    let minus = E::splat(-l);
                    for (r, d) in lanes_mut(row).iter_mut().zip(lanes(done)) {
                        E::load(r).madd(minus, E::load(d)).store(r);
                    }
                }
                for r in lanes_mut(row) {
                    E::load(r).times(E::splat(factor.per[i])).store(r);
                }
                h.set::<E>(row);
            }
            let left = E::splat(y[i] - h.dot::<E>(&x.0));
            let gain = cov.update_kernel::<E>(&h)?;
            for (x, k) in lanes_mut(&mut x.0).iter_mut().zip(lanes(&gain.0)) {
                E::load(x).madd(E::load(k), left).store(x);
            }
        }
        cov.mirror::<E>();
        Some(x.0)
    }
}

/// The covariance of attitude errors that are measured from another estimate.
struct Turn<'a, const CAP: usize> {
    cov: &'a mut Covariance<CAP>,
    g: &'a Matrix3<f64>,
}

impl<const CAP: usize> Kernel for Turn<'_, CAP> {
    type Output = ();

    #[inline(always)]
    fn run<E: Eight>(self) {
        self.cov.transform3::<E, PHI>(self.g);
    }
}
