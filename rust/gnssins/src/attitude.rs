//! Attitude: unit quaternion, rotation vector, direction-cosine matrix and Euler angles.
//!
//! `q_nb` and `c_nb` take b-vectors (forward-right-down) to n (north-east-down). Euler angles are roll, pitch
//! and heading of the Z-Y-X sequence: $C_{nb}=R_z(\psi)R_y(\theta)R_x(\phi)$, heading clockwise from north. q
//! and -q are one attitude; no function here depends on the sign. Quaternion to and from Euler angles goes
//! through half sums of the angles and stays accurate up to ±90° of pitch.

use crate::frames::wrap_pi;
use crate::math;
use core::f64::consts::FRAC_PI_2;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// Squared rotation angle (rad²) up to which [`exp`] uses its series: 0.2 rad. The first omitted term is
/// below 3e-17.
const SERIES_ANGLE2: f64 = 0.04;

/// Half-angle ratio below which [`log`] uses its series. The first omitted term is below 2e-17.
const SERIES_RATIO: f64 = 2.0e-3;

/// Amplitude below which [`to_euler`] no longer separates roll from heading: pitch within 1.4e-12 rad of
/// ±90°.
const GIMBAL: f64 = 1.0e-12;

/// Departure of the squared length from one up to which a Newton step is exact to rounding (error 3/8 of its
/// square).
const NEWTON_RANGE: f64 = 1.0e-8;

/// Least |cos(pitch)| in [`euler_jacobian`]: pitch is treated as no nearer to ±90° than this (0.057°).
pub const MIN_COS_PITCH: f64 = 1.0e-3;

/// Quaternion of a rotation vector (rad): $[\cos\frac{\theta}{2},\
/// \frac{\sin(\theta/2)}{\theta}\,\boldsymbol\theta]$.
///
/// Power series below 0.2 rad; there both forms agree to rounding, so there is no step.
#[inline]
#[must_use]
pub fn exp(rotvec: &Vector3<f64>) -> UnitQuaternion<f64> {
    let angle2 = rotvec.norm_squared();
    let (w, scale) = if angle2 < SERIES_ANGLE2 {
        let x = 0.25 * angle2;
        (
            1.0 + x * (-1.0 / 2.0 + x * (1.0 / 24.0 + x * (-1.0 / 720.0 + x * (1.0 / 40_320.0)))),
            0.5 + x * (-1.0 / 12.0 + x * (1.0 / 240.0 + x * (-1.0 / 10_080.0 + x * (1.0 / 725_760.0)))),
        )
    } else {
        let angle = math::sqrt(angle2);
        let (sin_half, cos_half) = math::sin_cos(0.5 * angle);
        (cos_half, sin_half / angle)
    };
    UnitQuaternion::new_unchecked(Quaternion::new(w, scale * rotvec.x, scale * rotvec.y, scale * rotvec.z))
}

/// Rotation vector (rad) of a quaternion, length in [0, π]; q and -q give the same one.
///
/// At exactly π both directions of the axis are the same rotation and the one stored in the quaternion is
/// returned.
#[must_use]
pub fn log(q: &UnitQuaternion<f64>) -> Vector3<f64> {
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    let w = sign * q.w;
    let v = sign * q.imag();
    let n = v.norm();
    let ratio = n / w;
    let scale = if ratio < SERIES_RATIO {
        let x = ratio * ratio;
        2.0 / w * (1.0 - x * (1.0 / 3.0 - x * (1.0 / 5.0)))
    } else {
        2.0 * math::atan2(n, w) / n
    };
    scale * v
}

/// Direction-cosine matrix of a quaternion. Groves (2013), eq. 2.34.
#[inline]
#[must_use]
pub fn dcm(q: &UnitQuaternion<f64>) -> Matrix3<f64> {
    let (w, x, y, z) = (q.w, q.i, q.j, q.k);
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (xy, xz, yz) = (x * y, x * z, y * z);
    let (wx, wy, wz) = (w * x, w * y, w * z);
    Matrix3::new(
        1.0 - 2.0 * (yy + zz),
        2.0 * (xy - wz),
        2.0 * (xz + wy),
        2.0 * (xy + wz),
        1.0 - 2.0 * (xx + zz),
        2.0 * (yz - wx),
        2.0 * (xz - wy),
        2.0 * (yz + wx),
        1.0 - 2.0 * (xx + yy),
    )
}

/// Quaternion of a direction-cosine matrix, scalar part never negative.
///
/// Divides by the largest of the four components (Shepperd 1978, J. Guidance and Control 1, p. 223). The
/// caller answers for the matrix being orthonormal with determinant +1; small departures are averaged and the
/// result is normalised.
#[must_use]
pub fn from_dcm(c: &Matrix3<f64>) -> UnitQuaternion<f64> {
    let (xx, yy, zz) = (c[(0, 0)], c[(1, 1)], c[(2, 2)]);
    let trace = xx + yy + zz;
    let (dx, dy, dz) = (c[(2, 1)] - c[(1, 2)], c[(0, 2)] - c[(2, 0)], c[(1, 0)] - c[(0, 1)]);
    let (sxy, sxz, syz) = (c[(0, 1)] + c[(1, 0)], c[(0, 2)] + c[(2, 0)], c[(1, 2)] + c[(2, 1)]);
    // Each row is q times four of its own components; take the one with the largest diagonal term.
    let q = if trace >= xx && trace >= yy && trace >= zz {
        Quaternion::new(1.0 + trace, dx, dy, dz)
    } else if xx >= yy && xx >= zz {
        Quaternion::new(dx, 1.0 + 2.0 * xx - trace, sxy, sxz)
    } else if yy >= zz {
        Quaternion::new(dy, sxy, 1.0 + 2.0 * yy - trace, syz)
    } else {
        Quaternion::new(dz, sxz, syz, 1.0 + 2.0 * zz - trace)
    };
    UnitQuaternion::new_normalize(if q.w < 0.0 { -q } else { q })
}

/// `q_nb` of roll, pitch and heading (rad).
#[must_use]
pub fn from_euler(roll_rad: f64, pitch_rad: f64, heading_rad: f64) -> UnitQuaternion<f64> {
    let (sr, cr) = math::sin_cos(0.5 * roll_rad);
    let (sp, cp) = math::sin_cos(0.5 * pitch_rad);
    let (sh, ch) = math::sin_cos(0.5 * heading_rad);
    UnitQuaternion::new_unchecked(Quaternion::new(
        cr * cp * ch + sr * sp * sh,
        sr * cp * ch - cr * sp * sh,
        cr * sp * ch + sr * cp * sh,
        cr * cp * sh - sr * sp * ch,
    ))
}

/// Roll, pitch and heading (rad) of `q_nb`; roll and heading in [-π, π), pitch in [-π/2, π/2].
///
/// The half-angle products of [`from_euler`] give $w\pm y$ and $x\mp z$ as amplitudes times cosine and sine
/// of $(\phi\mp\psi)/2$; the ratio of the two amplitudes is the pitch. At ±90° one amplitude vanishes and
/// roll and heading act about one axis: then roll is 0 and the heading carries the turn.
#[must_use]
pub fn to_euler(q_nb: &UnitQuaternion<f64>) -> (f64, f64, f64) {
    let (diff_cos, diff_sin) = (q_nb.w + q_nb.j, q_nb.i - q_nb.k);
    let (sum_cos, sum_sin) = (q_nb.w - q_nb.j, q_nb.i + q_nb.k);
    let up = math::hypot(diff_cos, diff_sin);
    let down = math::hypot(sum_cos, sum_sin);
    let pitch = 2.0 * math::atan2(up, down) - FRAC_PI_2;
    let half_diff = math::atan2(diff_sin, diff_cos);
    let half_sum = math::atan2(sum_sin, sum_cos);
    if down < GIMBAL {
        (0.0, pitch, wrap_pi(-2.0 * half_diff))
    } else if up < GIMBAL {
        (0.0, pitch, wrap_pi(2.0 * half_sum))
    } else {
        (wrap_pi(half_sum + half_diff), pitch, wrap_pi(half_sum - half_diff))
    }
}

/// Cross-product matrix: `skew(a) * b` is `a x b`.
#[inline]
#[must_use]
pub fn skew(a: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -a.z, a.y, a.z, 0.0, -a.x, -a.y, a.x, 0.0)
}

/// The quaternion with its length brought back to one.
///
/// Within 1e-8 of unit squared length one Newton step of the inverse square root, exact to rounding; farther
/// away the root itself. A zero quaternion gives the identity, a NaN stays NaN.
#[inline]
#[must_use]
pub fn renormalise(q: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let n2 = q.as_ref().norm_squared();
    if n2 == 0.0 {
        return UnitQuaternion::identity();
    }
    let scale = if math::abs(n2 - 1.0) < NEWTON_RANGE { 1.5 - 0.5 * n2 } else { 1.0 / math::sqrt(n2) };
    UnitQuaternion::new_unchecked(q.into_inner() * scale)
}

/// Jacobian of (roll, pitch, heading) with respect to a small rotation ρ of the body resolved in n,
/// $C_{new}=\mathrm{Exp}(\rho)\,C$:
///
/// $$\dot\phi=\frac{\cos\psi\,\rho_N+\sin\psi\,\rho_E}{\cos\theta},\quad
///   \dot\theta=-\sin\psi\,\rho_N+\cos\psi\,\rho_E,\quad
///   \dot\psi=\rho_D+\tan\theta(\cos\psi\,\rho_N+\sin\psi\,\rho_E)$$
///
/// Roll and heading have no derivative at ±90° of pitch; cos θ is kept at least [`MIN_COS_PITCH`] so that the
/// matrix stays bounded by a thousand, and what it returns nearer than that is a lower bound of the
/// sensitivity.
#[must_use]
pub fn euler_jacobian(pitch_rad: f64, heading_rad: f64) -> Matrix3<f64> {
    let (sin_p, cos_p) = math::sin_cos(pitch_rad);
    let (sin_h, cos_h) = math::sin_cos(heading_rad);
    let cos_p = math::copysign(math::abs(cos_p).max(MIN_COS_PITCH), cos_p);
    let tan_p = sin_p / cos_p;
    Matrix3::new(cos_h / cos_p, sin_h / cos_p, 0.0, -sin_h, cos_h, 0.0, tan_p * cos_h, tan_p * sin_h, 1.0)
}
