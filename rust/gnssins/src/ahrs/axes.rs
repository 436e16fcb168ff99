//! Axes of Aleshkin et al. (2021) to ours and back; nothing else in the crate knows theirs.
//!
//! Body: theirs forward, up, right; ours forward, right, down. Navigation: theirs north, up, east; ours north,
//! east, down. Both are the one quarter turn P about the first axis, so that with
//! $x'=Px$ and $C'=PCP^T$ every equation of the publication holds as printed there.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// Our vector in their axes: $(x,\ -z,\ y)$.
#[inline]
#[must_use]
pub fn to_publication(v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(v.x, -v.z, v.y)
}

/// Their vector in our axes: $(x,\ z,\ -y)$.
#[inline]
#[must_use]
pub fn from_publication(v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(v.x, v.z, -v.y)
}

/// Our `q_nb` as their quaternion: the vector part turns as a vector.
#[inline]
#[must_use]
pub fn quaternion_to_publication(q: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(Quaternion::from_parts(q.w, to_publication(&q.imag())))
}

/// Their quaternion as our `q_nb`.
#[inline]
#[must_use]
pub fn quaternion_from_publication(q: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::new_unchecked(Quaternion::from_parts(q.w, from_publication(&q.imag())))
}

/// Their direction-cosine matrix of our attitude: $C'=PC_{nb}P^T$.
#[must_use]
pub fn dcm_to_publication(c_nb: &Matrix3<f64>) -> Matrix3<f64> {
    P * c_nb * P.transpose()
}

/// Our $C_{nb}$ of their direction-cosine matrix.
#[must_use]
pub fn dcm_from_publication(c: &Matrix3<f64>) -> Matrix3<f64> {
    P.transpose() * c * P
}

/// P: ours to theirs.
const P: Matrix3<f64> = Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0);
