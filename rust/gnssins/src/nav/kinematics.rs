//! Attitude kinematics in its classical forms: one step of `q_nb` by the body's rotation and that of the axes.
//!
//! Every form solves the same equation over one interval, $\dot C=C[\omega_{ib}^b\times]-[\omega_{in}^n\times]C$, with
//! rates that are constant in it: $\alpha$ is the rotation vector of the body (coning taken out before), $\zeta=\omega_{in}^n\,dt$
//! that of the axes. What differs is what is integrated and to which order. The exact solution is
//! $q^+=\mathrm{Exp}(-\zeta)\,q\,\mathrm{Exp}(\alpha)$.
//!
//! | form | what is stepped | error of one step about a fixed axis, angle a |
//! |---|---|---|
//! | rotation vector | closed form | none |
//! | Euler | roll, pitch, heading, Runge-Kutta of fourth order | a⁵, grows with 1/cos⁵(pitch) |
//! | DCM | Poisson's equation to second order, then orthogonalised | a³/6 |
//! | quaternion | Rodrigues-Hamilton, Runge-Kutta of fourth order | -a⁵/1920 |
//! | Picard | quaternion of the relative increments to second order | a³/24 |
//! | two quaternions | body and axes against an inertial frame, each to second order | a³/24 |
//!
//! About a fixed axis an error of a³ acts as a scale factor of the gyro: a²/6 is 17 ppm at a = 0.01 rad, a²/24 is 4 ppm.
//!
//! The state between steps is always the quaternion, so a form has no memory of its own. For two quaternions nothing is
//! lost by that: the step is $p_\zeta^*\,(m^*l)\,p_\alpha$ whatever the inertial frame, so it may be laid into the
//! geographic frame anew at each start. Each form is brought back to a rotation at each step: the second-order forms do not stay one by
//! themselves, the squared length of a Picard quaternion grows by e²/64 per step (e the squared increment).

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

use crate::attitude::{self, skew};
use crate::error::Error;
use crate::math;

/// Largest pitch of the Euler form, rad (85 degrees): roll and heading turn at most 11.5 times as fast as the body.
pub const EULER_PITCH_LIMIT_RAD: f64 = 1.483_529_864_195_180_2;

/// Largest turn of body and axes within one step, rad, that the forms with a series take.
pub const TURN_LIMIT_RAD: f64 = 0.5;

/// Departure of C'C from the identity from which one more Newton step reaches rounding.
const LAST_STEP: f64 = 1e-8;

/// Most Newton steps of [`orthogonalise`]; six reach rounding from any departure below 1.
const ITERATIONS: usize = 24;

/// How the attitude is integrated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum AttitudeForm {
    /// Exact: quaternions of both rotation vectors.
    #[default]
    RotationVector,
    /// Euler kinematics, singular at ±90 degrees of pitch; refuses beyond [`EULER_PITCH_LIMIT_RAD`].
    Euler,
    /// Poisson's equation of the direction cosines with orthogonalisation.
    Dcm,
    /// Rodrigues-Hamilton equation, Runge-Kutta of fourth order.
    Quaternion,
    /// Rodrigues-Hamilton equation of the relative rate, second-order Picard increments.
    Picard,
    /// Product of the quaternions of body and geographic frame against an inertial one, each by Picard increments.
    TwoQuaternions,
}

impl AttitudeForm {
    /// All forms, the exact one first.
    pub const ALL: [Self; 6] =
        [Self::RotationVector, Self::Euler, Self::Dcm, Self::Quaternion, Self::Picard, Self::TwoQuaternions];

    /// Name in configurations.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::RotationVector => "rotation-vector",
            Self::Euler => "euler",
            Self::Dcm => "dcm",
            Self::Quaternion => "quaternion",
            Self::Picard => "picard",
            Self::TwoQuaternions => "two-quaternions",
        }
    }

    /// The form of a name, or `None`.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|f| f.name() == name)
    }

    /// Attitude after an interval in which the body turned by `alpha` (rad, body axes, against inertial space) and
    /// the navigation axes by `zeta` (rad, their own axes).
    ///
    /// # Errors
    /// [`Error::AttitudeForm`] where a form does not hold: pitch beyond [`EULER_PITCH_LIMIT_RAD`] in the Euler form,
    /// a turn beyond [`TURN_LIMIT_RAD`] in any but the exact one. [`Error::NonFinite`] for input that is not finite.
    #[inline(always)]
    pub fn advance(
        self,
        q_nb: &UnitQuaternion<f64>,
        alpha: &Vector3<f64>,
        zeta: &Vector3<f64>,
    ) -> Result<UnitQuaternion<f64>, Error> {
        if self == Self::RotationVector {
            return Ok(attitude::renormalise(&(attitude::exp(&-zeta) * q_nb * attitude::exp(alpha))));
        }
        self.advance_by_series(q_nb, alpha, zeta)
    }

    #[cold]
    #[inline(never)]
    fn advance_by_series(
        self,
        q_nb: &UnitQuaternion<f64>,
        alpha: &Vector3<f64>,
        zeta: &Vector3<f64>,
    ) -> Result<UnitQuaternion<f64>, Error> {
        let turn = alpha.norm() + zeta.norm();
        if !(turn.is_finite() && q_nb.coords.iter().all(|c| c.is_finite())) {
            return Err(Error::NonFinite { what: "attitude", t_ns: 0 });
        }
        if turn > TURN_LIMIT_RAD {
            let what = "turn within one step";
            return Err(Error::AttitudeForm { what, got_rad: turn, limit_rad: TURN_LIMIT_RAD });
        }
        let q = q_nb.as_ref();
        Ok(match self {
            Self::RotationVector => return self.advance(q_nb, alpha, zeta),
            Self::Euler => euler_step(q_nb, alpha, zeta)?,
            Self::Dcm => attitude::from_dcm(&poisson_step(&attitude::dcm(q_nb), alpha, zeta)),
            Self::Quaternion => unit(&runge_kutta(q, alpha, zeta)),
            Self::Picard => unit(&picard_step(q, &relative_increment(q_nb, alpha, zeta))),
            Self::TwoQuaternions => {
                let l = unit(&picard_step(q, alpha));
                let m = unit(&picard_step(&Quaternion::identity(), zeta));
                attitude::renormalise(&(m.inverse() * l))
            }
        })
    }

    /// Attitude after an estimated error `phi` (rad, navigation axes) is taken out: `C_true = Exp(phi) C`. The DCM form
    /// does it as publications write it, `C := (I + [phi x]) C` and orthogonalisation; its angle is atan|phi|.
    #[must_use]
    pub fn correct(self, q_nb: &UnitQuaternion<f64>, phi: &Vector3<f64>) -> UnitQuaternion<f64> {
        match self {
            Self::Dcm => {
                attitude::from_dcm(&orthogonalise(&((Matrix3::identity() + skew(phi)) * attitude::dcm(q_nb))))
            }
            _ => attitude::renormalise(&(attitude::exp(phi) * q_nb)),
        }
    }
}

fn unit(q: &Quaternion<f64>) -> UnitQuaternion<f64> {
    attitude::renormalise(&UnitQuaternion::new_unchecked(*q))
}

/// Rates of roll, pitch and heading under a rate `w` of the body against the navigation axes, in body axes (forward,
/// right, down): the kinematics that [`AttitudeForm::Euler`] integrates.
///
/// $$\dot\phi=w_x+\tan\theta\,(w_y\sin\phi+w_z\cos\phi),\quad \dot\theta=w_y\cos\phi-w_z\sin\phi,\quad
///   \dot\psi=(w_y\sin\phi+w_z\cos\phi)/\cos\theta$$
///
/// `None` where pitch is beyond [`EULER_PITCH_LIMIT_RAD`].
#[must_use]
pub fn euler_rates(roll_rad: f64, pitch_rad: f64, w: &Vector3<f64>) -> Option<Vector3<f64>> {
    let (sin_r, cos_r) = math::sin_cos(roll_rad);
    let (sin_p, cos_p) = math::sin_cos(pitch_rad);
    let turning = w.y * sin_r + w.z * cos_r;
    let holds = math::abs(pitch_rad) <= EULER_PITCH_LIMIT_RAD;
    holds.then(|| Vector3::new(w.x + sin_p / cos_p * turning, w.y * cos_r - w.z * sin_r, turning / cos_p))
}

/// Runge-Kutta of fourth order on the three angles, rates relative to the navigation axes.
fn euler_step(
    q_nb: &UnitQuaternion<f64>,
    alpha: &Vector3<f64>,
    zeta: &Vector3<f64>,
) -> Result<UnitQuaternion<f64>, Error> {
    let rates = |a: &Vector3<f64>| {
        let c_nb = attitude::dcm(&attitude::from_euler(a.x, a.y, a.z));
        euler_rates(a.x, a.y, &(alpha - c_nb.tr_mul(zeta))).ok_or(Error::AttitudeForm {
            what: "pitch",
            got_rad: a.y,
            limit_rad: EULER_PITCH_LIMIT_RAD,
        })
    };
    let (roll, pitch, heading) = attitude::to_euler(q_nb);
    let a = Vector3::new(roll, pitch, heading);
    let k1 = rates(&a)?;
    let k2 = rates(&(a + 0.5 * k1))?;
    let k3 = rates(&(a + 0.5 * k2))?;
    let k4 = rates(&(a + k3))?;
    let end = a + (k1 + 2.0 * (k2 + k3) + k4) / 6.0;
    rates(&end)?;
    Ok(attitude::from_euler(end.x, end.y, end.z))
}

/// Poisson's equation over one interval to second order in both rotations, then orthogonalised.
#[must_use]
pub fn poisson_step(c_nb: &Matrix3<f64>, alpha: &Vector3<f64>, zeta: &Vector3<f64>) -> Matrix3<f64> {
    let (a, z) = (skew(alpha), skew(zeta));
    let one = Matrix3::identity();
    orthogonalise(&((one - z + 0.5 * z * z) * c_nb * (one + a + 0.5 * a * a)))
}

/// The rotation nearest to a matrix, by `C := C (3I - C'C)/2` until it no longer changes (Björck and Bowie 1971).
///
/// The matrix is scaled first, so that the iteration converges for every one that is not singular. A singular one, which no
/// step makes, comes back as far as the iteration brings it.
#[must_use]
pub fn orthogonalise(c: &Matrix3<f64>) -> Matrix3<f64> {
    let mut c = *c;
    for k in 0..ITERATIONS {
        let departure = c.tr_mul(&c) - Matrix3::identity();
        let size = departure.amax();
        if k == 0 && size > 0.5 {
            // singular values then lie below sqrt(3), where the iteration turns back
            c *= math::sqrt(3.0) / c.norm();
            continue;
        }
        c -= 0.5 * c * departure;
        if size < LAST_STEP {
            break;
        }
    }
    c
}

/// Departure of a matrix from a rotation: largest element of |C'C - I|.
#[must_use]
pub fn orthogonality_error(c: &Matrix3<f64>) -> f64 {
    (c.tr_mul(c) - Matrix3::identity()).amax()
}

/// Fourth-order Runge-Kutta step of $\dot q=\tfrac12 q\circ\omega_{ib}^b-\tfrac12\omega_{in}^n\circ q$, not normalised.
fn runge_kutta(q: &Quaternion<f64>, alpha: &Vector3<f64>, zeta: &Vector3<f64>) -> Quaternion<f64> {
    let (body, axes) = (Quaternion::from_imag(0.5 * alpha), Quaternion::from_imag(0.5 * zeta));
    let rate = |q: &Quaternion<f64>| q * body - axes * q;
    let k1 = rate(q);
    let k2 = rate(&(q + 0.5 * k1));
    let k3 = rate(&(q + 0.5 * k2));
    let k4 = rate(&(q + k3));
    q + (k1 + 2.0 * (k2 + k3) + k4) / 6.0
}

/// Second-order Picard step of $\dot l=\tfrac12 l\circ\omega$ over an increment d: $l\circ(1-e/8,\ d/2)$ with
/// $e=|d|^2$, not normalised. The squared length grows by the factor $1+e^2/64$.
#[must_use]
pub fn picard_step(l: &Quaternion<f64>, d: &Vector3<f64>) -> Quaternion<f64> {
    l * Quaternion::from_parts(1.0 - d.norm_squared() / 8.0, 0.5 * d)
}

/// Increment of the body against the navigation axes, in body axes, with the attitude at mid-interval to first order:
/// $\alpha-C^T\zeta+\tfrac12\alpha\times C^T\zeta$.
fn relative_increment(q_nb: &UnitQuaternion<f64>, alpha: &Vector3<f64>, zeta: &Vector3<f64>) -> Vector3<f64> {
    let axes = attitude::dcm(q_nb).tr_mul(zeta);
    alpha - axes + 0.5 * alpha.cross(&axes)
}
