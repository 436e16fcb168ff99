//! The correction of [`crate::ahrs::dcm`] applied to the quaternion.
//!
//! In the axes of the publication, with L the attitude, $L_k$ the measured one and $s=\mathrm{sign}(L\cdot L_k)$:
//! $$\dot L=\tfrac12 L\circ\omega-K_4(L-sL_k),\qquad K_4=kI+nJ,\qquad
//!   J=\begin{bmatrix}0&1&1&1\\-1&0&1&1\\-1&1&0&1\\-1&1&1&0\end{bmatrix}$$
//! Aleshkin et al. (2021) state that such a law gives results similar to those of the direction cosines and print no
//! equations; this one does for small errors at level attitude. $-k/2<n<k$ suffices for stability at every rate.
//! Sampled by the closed solution, as the direction cosines are, and brought to unit length after every sample.

use nalgebra::{Matrix4, Quaternion, UnitQuaternion, Vector3, Vector4};

use crate::ahrs::axes::{
    dcm_from_publication, quaternion_from_publication, quaternion_to_publication, to_publication,
};
use crate::ahrs::expm::expm;
use crate::ahrs::measured::{References, gain};
use crate::ahrs::{AhrsSample, AhrsStatus, AttitudeEstimator, axes_rate, check, initial};
use crate::attitude::{dcm, exp, from_dcm};
use crate::error::Error;
use crate::math;

/// Settings of [`Corrected`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(default, deny_unknown_fields))]
pub struct Settings {
    /// Gain k, 1/s.
    pub k: f64,
    /// Cross gain n, 1/s.
    pub n: f64,
    /// Declination, gravity, tolerances.
    pub references: References,
    /// Rate of the navigation axes against inertial space along north, east, down, rad/s; zero leaves it out.
    pub rate_n: [f64; 3],
    /// Initial attitude, scalar first; from the first usable sample where absent.
    pub initial_q_nb: Option<[f64; 4]>,
    /// Takes gains outside the sufficient range for stability.
    pub allow_unstable: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            k: 1.0,
            n: 0.0,
            references: References::default(),
            rate_n: [0.0; 3],
            initial_q_nb: None,
            allow_unstable: false,
        }
    }
}

/// Quaternion corrected by a measured one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corrected {
    k4: Matrix4<f64>,
    references: References,
    rate: Vector3<f64>,
    /// Attitude, their axes.
    q: UnitQuaternion<f64>,
    aligned: bool,
}

/// Squared length below which a corrected quaternion has lost its direction.
const LENGTH2_MIN: f64 = 1.0e-4;

impl Corrected {
    /// An estimator before its first sample.
    ///
    /// # Errors
    /// [`Error::Config`] for a gain or reference out of range.
    pub fn new(settings: &Settings) -> Result<Self, Error> {
        let Settings { k, n, .. } = *settings;
        gain("k", k)?;
        gain("n", math::abs(n))?;
        if !(n <= k && -0.5 * k <= n || settings.allow_unstable) {
            return Err(Error::Config { what: "n", need: "from -k/2 to k", got: n });
        }
        settings.references.check()?;
        let start = initial(settings.initial_q_nb)?;
        Ok(Self {
            k4: Matrix4::new(k, n, n, n, -n, k, n, n, -n, n, k, n, -n, n, n, k),
            references: settings.references,
            rate: to_publication(&axes_rate(&settings.rate_n)?),
            q: quaternion_to_publication(&start.unwrap_or_default()),
            aligned: start.is_some(),
        })
    }

    /// Solution of the error equation over an interval, rate constant, the measured attitude turning with the body.
    fn correct(
        &self,
        start: &UnitQuaternion<f64>,
        end: &Quaternion<f64>,
        w: &Vector3<f64>,
        dt_s: f64,
    ) -> Vector4<f64> {
        let h = w * 0.5;
        let half = Matrix4::new(
            0.0, -h.x, -h.y, -h.z, //
            h.x, 0.0, h.z, -h.y, //
            h.y, -h.z, 0.0, h.x, //
            h.z, h.y, -h.x, 0.0,
        );
        let back = end * exp(&(-w * dt_s)).into_inner();
        expm(&((half - self.k4) * dt_s)) * (numbers(start) - numbers(&back))
    }
}

impl AttitudeEstimator for Corrected {
    fn step(&mut self, dt_s: f64, sample: &AhrsSample) -> Result<AhrsStatus, Error> {
        let moving = check(dt_s, &sample.gyro)?;
        if !self.aligned {
            let measured = self.references.measure(sample, &nalgebra::Matrix3::identity());
            let Some(c_nb) = measured.c_nb else {
                return Ok(measured.status.with(AhrsStatus::UNALIGNED));
            };
            self.q = quaternion_to_publication(&from_dcm(&c_nb));
            self.aligned = true;
            return Ok(measured.status.with(AhrsStatus::ALIGNED));
        }
        if !moving {
            return Ok(AhrsStatus::SKIPPED);
        }
        let w = to_publication(&sample.gyro);
        let start = exp(&(-self.rate * dt_s)) * self.q;
        let predicted = crate::attitude::renormalise(&(start * exp(&(w * dt_s))));
        let c_nb = dcm_from_publication(&dcm(&predicted));
        let measured = self.references.measure(sample, &c_nb);
        let Some(c_k) = measured.c_nb else {
            self.q = predicted;
            return Ok(measured.status);
        };
        let q_k = quaternion_to_publication(&from_dcm(&c_k));
        let sign = if q_k.coords.dot(&predicted.coords) < 0.0 { -1.0 } else { 1.0 };
        let end = q_k.into_inner() * sign;
        let sum = numbers(&end) + self.correct(&start, &end, &w, dt_s);
        let found = Quaternion::new(sum[0], sum[1], sum[2], sum[3]);
        let length2 = found.norm_squared();
        // a sum that vanished or overflowed has no direction: the measured attitude has
        self.q = match length2.is_finite() && length2 > LENGTH2_MIN {
            true => UnitQuaternion::new_unchecked(found * (1.0 / math::sqrt(length2))),
            false => q_k,
        };
        Ok(measured.status)
    }

    fn q_nb(&self) -> UnitQuaternion<f64> {
        quaternion_from_publication(&self.q)
    }
}

/// Scalar first.
fn numbers(q: &Quaternion<f64>) -> Vector4<f64> {
    Vector4::new(q.w, q.i, q.j, q.k)
}
