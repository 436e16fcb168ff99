//! Gains computed once, used by many: the state without its covariance.
//!
//! Along a nominal trajectory the covariance and the gains hardly depend on the sensor errors of a run. [`Ekf::gain`]
//! gives the gain of a measurement at the present covariance, [`Ekf::predict_state`] and [`Ekf::update_state`] move
//! another filter with it: strapdown, innovation and feedback, no covariance, no gates.

use nalgebra::Vector3;

use super::update::Prior;
use super::{Ekf, navigation};
use crate::error::Error;
use crate::imu::{ImuDelta, Strap};
use crate::meas::{Measurement, Rows, View};
use crate::nav::{NAV, NavModel};
use crate::simd::{self, Eight, Kernel};
use crate::small::{Factor, ROWS_MAX};

/// Gain of one measurement of at most six rows.
#[derive(Debug, Clone)]
pub struct Gain<const CAP: usize> {
    len: usize,
    /// Columns of K = P H' S^-1.
    columns: [[f64; CAP]; ROWS_MAX],
    /// Cholesky factor of S = H P H' + R.
    factor: Factor,
}

impl<const CAP: usize> Gain<CAP> {
    /// Number of rows.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.len
    }

    /// Never.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }
}

impl<M: NavModel, const CAP: usize> Ekf<M, CAP> {
    /// Gain that a measurement would have now; the covariance is brought to the filter's time, nothing else changes.
    /// `None` where the measurement cannot be used.
    #[must_use]
    pub fn gain(&mut self, measurement: &impl Measurement) -> Option<Gain<CAP>> {
        self.close(&mut |_| {}).ok()?;
        let rows = self.rows(measurement)?;
        let mut cov = self.cov;
        if self.jumps && measurement.new_constellation() {
            for (i, state) in self.layout.states() {
                cov.add_variance(i, state.jump);
            }
        }
        let factor = Factor::of(&simd::run(self.isa, Prior { cov: &cov, rows: &rows }), rows.len)?;
        // K' = S^-1 (P H')': forward and back substitution
        let mut columns = rows.h.map(|h| cov.times(&h));
        for i in 0..rows.len {
            let (done, rest) = columns.split_at_mut(i);
            for (done, l) in done.iter().zip(&factor.l[i]) {
                rest[0].iter_mut().zip(done).for_each(|(x, y)| *x -= l * y);
            }
            rest[0].iter_mut().for_each(|x| *x *= factor.per[i]);
        }
        for i in (0..rows.len).rev() {
            let (rest, done) = columns.split_at_mut(i + 1);
            for (done, l) in done.iter().zip(&factor.l[i + 1..rows.len]) {
                rest[i].iter_mut().zip(done).for_each(|(x, y)| *x -= l[i] * y);
            }
            rest[i].iter_mut().for_each(|x| *x *= factor.per[i]);
        }
        Some(Gain { len: rows.len, columns, factor })
    }

    /// As [`Ekf::predict`], without the covariance.
    ///
    /// # Errors
    /// As [`Ekf::predict`].
    pub fn predict_state(
        &mut self,
        t_ns: i64,
        dtheta: &Vector3<f64>,
        dvel: &Vector3<f64>,
    ) -> Result<(), Error> {
        let dt_s = self.interval_s(t_ns)?;
        simd::run(self.isa, Coast { ekf: self, dt_s, dtheta, dvel }).map_err(|e| super::at_time(e, t_ns))?;
        self.t_ns = t_ns;
        Ok(())
    }

    /// Corrects the state by a given gain, without tests and without the covariance; gives the NIS by the covariance that
    /// the gain was made with, or `None` where the measurement has other rows or cannot be used.
    ///
    /// # Errors
    /// What the correction of the sensors refuses.
    pub fn update_state(
        &mut self,
        measurement: &impl Measurement,
        gain: &Gain<CAP>,
    ) -> Result<Option<f64>, Error> {
        let Some(rows) = self.rows(measurement).filter(|rows| rows.len == gain.len) else { return Ok(None) };
        let mut x = [0.0; CAP];
        for (k, y) in gain.columns.iter().zip(&rows.y).take(rows.len) {
            x.iter_mut().zip(k).for_each(|(x, k)| *x += k * y);
        }
        self.model.correct(&navigation(&x));
        for (p, x) in self.params.iter_mut().zip(&x).skip(NAV) {
            *p += x;
        }
        self.refresh_sensors()?;
        Ok(Some(gain.factor.norm_squared(&rows.y)))
    }

    fn rows(&self, measurement: &impl Measurement) -> Option<Rows<CAP>> {
        let view = View {
            model: &self.model,
            layout: &self.layout,
            params: &self.params,
            lever_b_m: self.settings.lever_b_m + self.layout.lever_arm(&self.params),
            w_ib_b: self.w_ib_b,
        };
        measurement.rows(&view).ok().filter(|rows| rows.len <= ROWS_MAX)
    }
}

/// The strapdown step of an interval by itself.
struct Coast<'a, M, const CAP: usize> {
    ekf: &'a mut Ekf<M, CAP>,
    dt_s: f64,
    dtheta: &'a Vector3<f64>,
    dvel: &'a Vector3<f64>,
}

impl<M: NavModel, const CAP: usize> Kernel for Coast<'_, M, CAP> {
    type Output = Result<(), Error>;

    #[inline(always)]
    fn run<E: Eight>(self) -> Result<(), Error> {
        let Self { ekf, dt_s, dtheta, dvel } = self;
        let [gyro, accel] = &ekf.sensors;
        let delta =
            ImuDelta { dt_s, dtheta: gyro.increment(dtheta, dt_s), dvel: accel.increment(dvel, dt_s) };
        let strap = Strap::compensated(&delta, ekf.previous.as_ref(), ekf.settings.coning);
        ekf.model.advance(&strap)?;
        let speed_m_s = ekf.speed_m_s();
        ekf.block_step.fit(&ekf.layout, dt_s, speed_m_s);
        ekf.decay()?;
        ekf.previous = Some(delta);
        ekf.w_ib_b = delta.dtheta / dt_s;
        Ok(())
    }
}
