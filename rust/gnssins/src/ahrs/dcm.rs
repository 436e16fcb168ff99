//! Direction cosines corrected element by element: positional, integral-positional and cross-coupled.
//!
//! In the axes of the publication (see [`crate::ahrs::axes`]) let c be one row of C as a column, $c_k$ the same row
//! of the measured attitude, $e=c-c_k$ and $W=-[\omega\times]$. The laws are
//!
//! | law | equation of a row | error |
//! |---|---|---|
//! | positional | $\dot c=Wc-Ke,\ K=\mathrm{diag}(k_1,k_2,k_3)$ | $\dot e=(W-K)e$ |
//! | integral | $\dot c=Wc-ke-x,\ \dot x=k^n e$ | $V=\lvert e\rvert^2+\lvert x\rvert^2/k^n$ has $\dot V=-2k\lvert e\rvert^2$ |
//! | cross-coupled | $\dot c=Wc-Ke$, K of [`Law::matrix`] | $\lvert e\rvert'\le-(k-\lvert n\rvert)\lvert e\rvert$ for any ω(t) |
//!
//! Over one interval ω is constant, $c_k$ turns with the body and arrives at what the sensors show at its end.
//! That equation has a closed solution, which is what is computed here:
//! $$e^+=e^{(W-K)T}\left(c^--e^{-WT}c_k^+\right),\qquad c^+=c_k^++e^+$$
//! so that the sampled law has exactly the eigenvalues of the continuous one at every rate and interval. An
//! explicit Euler step of the same law is unstable at rates above $\sqrt{1-(1-kT)^2}/T$: 82 rad/s at 100 Hz with
//! k = 42.8 1/s.
//!
//! A gyro bias acts as a turn at the start of each interval. What it leaves at the samples, $bTe^{-kT}/(1-e^{-kT})$ for
//! the positional law, is below the b/k of continuous time; the integral law, which leaves nothing there, leaves half an
//! interval of drift: the error swings about zero within the interval.
//!
//! Corrected element by element, C leaves the rotations. [`Form`] says what is done about it.

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3};

use crate::ahrs::axes::{dcm_from_publication, dcm_to_publication, to_publication};
use crate::ahrs::expm::expm;
use crate::ahrs::measured::{References, gain};
use crate::ahrs::{AhrsSample, AhrsStatus, AttitudeEstimator, axes_rate, check, initial};
use crate::attitude::{dcm, exp, from_dcm, skew};
use crate::error::Error;
use crate::math;

/// Correction law with its gains, axes of the publication.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case", deny_unknown_fields))]
pub enum Law {
    /// Gains on the elements along body forward, up, right, 1/s.
    Positional {
        /// One gain per column of C, 1/s.
        k: [f64; 3],
    },
    /// With one integrator per element.
    Integral {
        /// Gain, 1/s.
        k: f64,
        /// Gain of the integrator, 1/s².
        k_int: f64,
    },
    /// Every element corrected by the errors of its whole row.
    Cross {
        /// Own gain, 1/s.
        k: f64,
        /// Gain of the neighbours, 1/s.
        n: f64,
    },
}

impl Law {
    /// K of the row equation; for [`Law::Integral`] its positional part.
    /// Cross-coupled: `[k n n; -n k n; -n n k]`, Aleshkin et al. (2021), eq. 20.
    #[must_use]
    pub fn matrix(&self) -> Matrix3<f64> {
        match *self {
            Law::Positional { k } => Matrix3::from_diagonal(&Vector3::from(k)),
            Law::Integral { k, .. } => Matrix3::from_diagonal_element(k),
            Law::Cross { k, n } => Matrix3::new(k, n, n, -n, k, n, -n, n, k),
        }
    }

    /// Refuses gains without meaning and, unless allowed, laws that some body rate makes unstable.
    fn check(&self, allow_unstable: bool) -> Result<(), Error> {
        match *self {
            Law::Positional { k } => k.iter().try_for_each(|k| gain("law.k", *k)),
            Law::Integral { k, k_int } => gain("law.k", k).and_then(|()| gain("law.k_int", k_int)),
            Law::Cross { k, n } => {
                gain("law.k", k)?;
                gain("law.n", math::abs(n))?;
                if math::abs(n) > k && !allow_unstable {
                    let need = "at most k in magnitude: beyond that some body rate makes the law unstable";
                    return Err(Error::Config { what: "law.n", need, got: n });
                }
                Ok(())
            }
        }
    }
}

/// What keeps the attitude a rotation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Form {
    /// C is brought to the nearest rotation after every sample and goes on from there. A small rotation error δ
    /// (body axes) then obeys $\dot\delta=-\tfrac12(\mathrm{tr}K\,I-K^T)\,\delta$: nothing changes for equal gains,
    /// and the cross-coupling acts with half its gain.
    #[default]
    Rotation,
    /// The nine elements go on as the law leaves them, as published; the attitude given out is the nearest
    /// rotation. The published frequency responses are those of single elements in this form.
    Elements,
}

/// Settings of [`Dcm`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(default, deny_unknown_fields))]
pub struct Settings {
    /// Law and gains.
    pub law: Law,
    /// What keeps the attitude a rotation.
    pub form: Form,
    /// Declination, gravity, tolerances.
    pub references: References,
    /// Rate of the navigation axes against inertial space along north, east, down, rad/s; zero leaves it out.
    pub rate_n: [f64; 3],
    /// Initial attitude, scalar first; from the first usable sample where absent.
    pub initial_q_nb: Option<[f64; 4]>,
    /// Takes a law that is not stable at every body rate.
    pub allow_unstable: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            law: Law::Positional { k: [1.0; 3] },
            form: Form::default(),
            references: References::default(),
            rate_n: [0.0; 3],
            initial_q_nb: None,
            allow_unstable: false,
        }
    }
}

/// Direction cosines corrected by measured ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dcm {
    law: Law,
    form: Form,
    references: References,
    /// Rate of the navigation axes, their axes.
    rate: Vector3<f64>,
    /// Elements as the law has them, their axes.
    c: Matrix3<f64>,
    /// Integrators, one per element.
    x: Matrix3<f64>,
    /// The nearest rotation, their axes.
    nearest: Matrix3<f64>,
    aligned: bool,
}

impl Dcm {
    /// An estimator before its first sample.
    ///
    /// # Errors
    /// [`Error::Config`] for a gain or reference out of range.
    pub fn new(settings: &Settings) -> Result<Self, Error> {
        settings.law.check(settings.allow_unstable)?;
        settings.references.check()?;
        let start = initial(settings.initial_q_nb)?;
        let c = dcm_to_publication(&dcm(&start.unwrap_or_default()));
        Ok(Self {
            law: settings.law,
            form: settings.form,
            references: settings.references,
            rate: to_publication(&axes_rate(&settings.rate_n)?),
            c,
            x: Matrix3::zeros(),
            nearest: c,
            aligned: start.is_some(),
        })
    }

    /// The nine elements as the law has them, axes of the publication; a rotation in [`Form::Rotation`].
    #[must_use]
    pub fn elements(&self) -> Matrix3<f64> {
        self.c
    }

    /// Roll, pitch and heading (rad) read from single elements, as the publication reads them:
    /// $\psi=\mathrm{atan2}(-c_{31},c_{11}),\ \theta=\arcsin c_{21},\ \gamma=\mathrm{atan2}(-c_{23},c_{22})$,
    /// heading = -ψ. Equal to those of [`AttitudeEstimator::q_nb`] where the elements are a rotation.
    #[must_use]
    pub fn element_angles(&self) -> Vector3<f64> {
        element_angles(&self.c)
    }

    /// Solution of the error equation over an interval: `e` at its start, body rate `w`.
    fn correct(&mut self, e: Matrix3<f64>, w: &Vector3<f64>, r: &Matrix3<f64>, dt_s: f64) -> Matrix3<f64> {
        match self.law {
            Law::Positional { k: [k1, k2, k3] } if k1 == k2 && k2 == k3 => e * r * math::exp(-k1 * dt_s),
            Law::Positional { .. } | Law::Cross { .. } => {
                // rows on the left: the transposed matrix on the right
                e * expm(&((skew(w) - self.law.matrix().transpose()) * dt_s))
            }
            Law::Integral { k, k_int } => {
                let mut a = Matrix6::zeros();
                a.fixed_view_mut::<3, 3>(3, 0).copy_from(&Matrix3::from_diagonal_element(k_int));
                a.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::from_diagonal_element(-1.0));
                a.fixed_view_mut::<3, 3>(3, 3).copy_from(&(skew(w) - Matrix3::from_diagonal_element(k)));
                let phi = expm(&(a * dt_s));
                let part = |i: usize, j: usize| phi.fixed_view::<3, 3>(i, j).into_owned();
                let x = self.x;
                self.x = x * part(0, 0) + e * part(3, 0);
                x * part(0, 3) + e * part(3, 3)
            }
        }
    }

    /// Takes over the elements `c`; where they are no longer near any rotation, those of `instead`.
    fn settle(&mut self, c: Matrix3<f64>, instead: &Matrix3<f64>) {
        match nearest_rotation(&c).filter(|_| self.x.iter().all(|x| x.is_finite())) {
            Some(nearest) => {
                self.nearest = nearest;
                self.c = if self.form == Form::Rotation { nearest } else { c };
            }
            None => {
                (self.c, self.nearest) = (*instead, *instead);
                self.x = Matrix3::zeros();
            }
        }
    }
}

impl AttitudeEstimator for Dcm {
    fn step(&mut self, dt_s: f64, sample: &AhrsSample) -> Result<AhrsStatus, Error> {
        let moving = check(dt_s, &sample.gyro)?;
        if !self.aligned {
            let measured = self.references.measure(sample, &Matrix3::identity());
            let Some(c_nb) = measured.c_nb else {
                return Ok(measured.status.with(AhrsStatus::UNALIGNED));
            };
            let c = dcm_to_publication(&c_nb);
            self.settle(c, &c);
            self.aligned = true;
            return Ok(measured.status.with(AhrsStatus::ALIGNED));
        }
        if !moving {
            return Ok(AhrsStatus::SKIPPED);
        }
        let w = to_publication(&sample.gyro);
        let r = dcm(&exp(&(w * dt_s)));
        let l = dcm(&exp(&(-self.rate * dt_s)));
        let predicted = l * self.nearest * r;
        let measured = self.references.measure(sample, &dcm_from_publication(&predicted));
        let start = l * self.c;
        match measured.c_nb {
            Some(c_nb) => {
                let c_k = dcm_to_publication(&c_nb);
                self.x = l * self.x;
                let e = self.correct(start - c_k * r.transpose(), &w, &r, dt_s);
                self.settle(c_k + e, &c_k);
            }
            None => self.settle(start * r, &predicted),
        }
        Ok(measured.status)
    }

    fn q_nb(&self) -> UnitQuaternion<f64> {
        from_dcm(&dcm_from_publication(&self.nearest))
    }
}

/// Roll, pitch, heading from single elements of a matrix in their axes.
fn element_angles(c: &Matrix3<f64>) -> Vector3<f64> {
    let pitch = math::asin(c[(1, 0)].clamp(-1.0, 1.0));
    let roll = math::atan2(-c[(1, 2)], c[(1, 1)]);
    Vector3::new(roll, pitch, math::atan2(c[(2, 0)], c[(0, 0)]))
}

/// Least determinant from which the nearest rotation is sought: far beyond, a turn by 180° between two attitudes.
const DETERMINANT_MIN: f64 = 1.0e-9;

/// Most Newton steps: enough for [`DETERMINANT_MIN`] with elements up to 1e3.
const STEPS_MAX: usize = 64;

/// Largest element of a matrix that still stands for an attitude.
const ELEMENT_MAX: f64 = 1.0e3;

/// The rotation nearest to a matrix (its orthogonal polar factor), by Newton's iteration
/// $X\leftarrow\tfrac12(X+X^{-T})$, Higham (1986). It converges from every matrix with a positive determinant, two
/// or three steps from a rotation nearly so. `None` without a positive determinant.
#[must_use]
pub fn nearest_rotation(c: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    if !c.iter().all(|x| x.is_finite() && x.abs() < ELEMENT_MAX) {
        return None;
    }
    let mut x = *c;
    for _ in 0..STEPS_MAX {
        let rows = [x.row(0).transpose(), x.row(1).transpose(), x.row(2).transpose()];
        let cofactors = [rows[1].cross(&rows[2]), rows[2].cross(&rows[0]), rows[0].cross(&rows[1])];
        let det = rows[0].dot(&cofactors[0]);
        if det.is_nan() || det <= DETERMINANT_MIN {
            return None;
        }
        let inverse_transposed = Matrix3::from_fn(|i, j| cofactors[i][j] / det);
        let next = 0.5 * (x + inverse_transposed);
        let change = (next - x).norm();
        x = next;
        if change < 1.0e-8 {
            return Some(x); // the error is the square of the change
        }
    }
    None
}
