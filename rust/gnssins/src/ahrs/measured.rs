//! Attitude from one accelerometer and one magnetometer reading, over the full circle and at ±90° of pitch.

use nalgebra::{Matrix3, Vector3};

use crate::ahrs::{AhrsSample, AhrsStatus};
use crate::error::Error;
use crate::frames::wrap_pi;
use crate::math;

/// Specific force below which there is no direction in it, m/s².
const ACCEL_MIN: f64 = 1.0e-3;

/// Horizontal share of the field below which there is no heading in it.
const HORIZONTAL_MIN: f64 = 1.0e-4;

/// What the readings are compared with. The tolerances are off unless given: the published laws have none.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(default, deny_unknown_fields))]
pub struct References {
    /// Magnetic declination, east positive, rad.
    pub declination_rad: f64,
    /// Gravity, m/s².
    pub gravity_m_s2: f64,
    /// Largest departure of the specific force from gravity, relative; beyond it the gyro goes alone.
    pub accel_tolerance: Option<f64>,
    /// Strength of the field, in the unit of the magnetometer.
    pub field: f64,
    /// Largest departure of the strength, relative; beyond it the heading is the gyro's.
    pub field_tolerance: Option<f64>,
    /// Dip of the field, down positive, rad.
    pub dip_rad: f64,
    /// Largest departure of the dip, rad; beyond it the heading is the gyro's.
    pub dip_tolerance_rad: Option<f64>,
}

impl Default for References {
    fn default() -> Self {
        Self {
            declination_rad: 0.0,
            gravity_m_s2: 9.806_65,
            accel_tolerance: None,
            field: 1.0,
            field_tolerance: None,
            dip_rad: 0.0,
            dip_tolerance_rad: None,
        }
    }
}

/// Level and direction that a sample shows, and what was wrong with it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// Measured $C_{nb}$, heading from the field or, without it, from the prediction; `None` without level.
    pub c_nb: Option<Matrix3<f64>>,
    /// Which readings were used, absent or refused.
    pub status: AhrsStatus,
}

impl References {
    /// Refuses values without meaning.
    ///
    /// # Errors
    /// [`Error::Config`] naming the value.
    pub fn check(&self) -> Result<(), Error> {
        finite("references.declination_rad", self.declination_rad)?;
        finite("references.dip_rad", self.dip_rad)?;
        positive("references.gravity_m_s2", self.gravity_m_s2)?;
        positive("references.field", self.field)?;
        for (what, value) in [
            ("references.accel_tolerance", self.accel_tolerance),
            ("references.field_tolerance", self.field_tolerance),
            ("references.dip_tolerance_rad", self.dip_tolerance_rad),
        ] {
            positive(what, value.unwrap_or(1.0))?;
        }
        Ok(())
    }

    /// Attitude that a sample shows; `predicted` $C_{nb}$ gives the heading where the field does not.
    #[must_use]
    pub fn measure(&self, sample: &AhrsSample, predicted: &Matrix3<f64>) -> Measured {
        let Some((down, force)) = direction(&-sample.accel, ACCEL_MIN) else {
            let status = AhrsStatus::ACCEL_BAD.with_if(sample.mag.is_none(), AhrsStatus::MAG_BAD);
            return Measured { c_nb: None, status };
        };
        let off = |t: f64| math::abs(force / self.gravity_m_s2 - 1.0) > t;
        if self.accel_tolerance.is_some_and(off) {
            return Measured { c_nb: None, status: AhrsStatus::ACCEL_DISTURBED };
        }
        let status = AhrsStatus::ACCEL_USED;
        match self.north(&down, sample) {
            Ok(north) => {
                Measured { c_nb: Some(rows(&north, &down)), status: status.with(AhrsStatus::MAG_USED) }
            }
            Err(fault) => Measured { c_nb: Some(levelled(&down, predicted)), status: status.with(fault) },
        }
    }

    /// True north in body axes, or the flag that says why there is none.
    fn north(&self, down: &Vector3<f64>, sample: &AhrsSample) -> Result<Vector3<f64>, AhrsStatus> {
        let (field, strength) =
            sample.mag.and_then(|m| direction(&m, f64::MIN_POSITIVE)).ok_or(AhrsStatus::MAG_BAD)?;
        let off = |t: f64| math::abs(strength / self.field - 1.0) > t;
        let dip = math::atan2(field.dot(down), down.cross(&field).norm());
        if self.field_tolerance.is_some_and(off)
            || self.dip_tolerance_rad.is_some_and(|t| math::abs(dip - self.dip_rad) > t)
        {
            return Err(AhrsStatus::MAG_DISTURBED);
        }
        north(down, &field, self.declination_rad).ok_or(AhrsStatus::MAG_BAD)
    }
}

/// $C_{nb}$ of specific force and field (body axes, any length) by vectors:
/// $\hat d=-f/|f|,\ \hat e_m=\hat d\times m/|\hat d\times m|,\ \hat n_m=\hat e_m\times\hat d$, then the declination
/// about $\hat d$. TRIAD (Black 1964) with the level exact. No angle enters, so that nothing happens at ±90° of
/// pitch. `None` where a vector is zero, not finite, or the field vertical.
#[must_use]
pub fn triad(accel: &Vector3<f64>, mag: &Vector3<f64>, declination_rad: f64) -> Option<Matrix3<f64>> {
    let (down, _) = direction(&-accel, ACCEL_MIN)?;
    let (field, _) = direction(mag, f64::MIN_POSITIVE)?;
    Some(rows(&north(&down, &field, declination_rad)?, &down))
}

/// Roll, pitch and heading (rad) of specific force and field, by angles:
/// $\theta=\mathrm{atan2}(f_x,\hypot(f_y,f_z)),\ \phi=\mathrm{atan2}(-f_y,-f_z)$, and the heading from the field
/// turned level, over the full circle. Aleshkin et al. (2021), eq. 15 and 16 with the signs of their own matrix.
///
/// The printed form, an arcsine of the east component over the horizontal field, reaches ±90° of heading only,
/// and its roll has the sign of the opposite convention. Equal to [`triad`] except at ±90° of pitch.
#[must_use]
pub fn angles(accel: &Vector3<f64>, mag: &Vector3<f64>, declination_rad: f64) -> (f64, f64, f64) {
    let pitch = math::atan2(accel.x, math::hypot(accel.y, accel.z));
    let roll = math::atan2(-accel.y, -accel.z);
    let ((sin_r, cos_r), (sin_p, cos_p)) = (math::sin_cos(roll), math::sin_cos(pitch));
    let h_n = cos_p * mag.x + sin_p * (sin_r * mag.y + cos_r * mag.z);
    let h_e = cos_r * mag.y - sin_r * mag.z;
    (roll, pitch, wrap_pi(math::atan2(-h_e, h_n) + declination_rad))
}

/// $C_{nb}$ with the vertical `down` (body axes, unit) and the heading of a prediction.
#[must_use]
pub fn levelled(down: &Vector3<f64>, predicted: &Matrix3<f64>) -> Matrix3<f64> {
    let row = |i: usize| Vector3::new(predicted[(i, 0)], predicted[(i, 1)], predicted[(i, 2)]);
    let level = |v: &Vector3<f64>| v - down * v.dot(down);
    // north laid level; where it stands upright in the measured frame, east does not
    let north = level(&row(0));
    let north = match north.norm() > 0.5 {
        true => north,
        false => level(&row(1)).cross(down),
    };
    let length = north.norm();
    if length > f64::EPSILON { rows(&(north / length), down) } else { rows(&any_level(down), down) }
}

/// Some unit vector at right angles to a unit vector.
fn any_level(down: &Vector3<f64>) -> Vector3<f64> {
    let axis = if math::abs(down.x) < 0.8 { Vector3::x() } else { Vector3::y() };
    let level = axis - down * axis.dot(down);
    level / level.norm()
}

/// Unit vector and length of a finite vector of at least `least`.
fn direction(v: &Vector3<f64>, least: f64) -> Option<(Vector3<f64>, f64)> {
    let top = v.iter().fold(0.0, |a: f64, x| a.max(math::abs(*x)));
    if !(v.iter().all(|x| x.is_finite()) && top >= least) {
        return None;
    }
    // scaled, so that no square overflows or vanishes
    let scaled = v / top;
    let length = scaled.norm();
    Some((scaled / length, length * top))
}

/// True north in body axes from unit vectors down and field.
fn north(down: &Vector3<f64>, field: &Vector3<f64>, declination_rad: f64) -> Option<Vector3<f64>> {
    let east = down.cross(field);
    let horizontal = east.norm();
    if horizontal < HORIZONTAL_MIN {
        return None;
    }
    let east = east / horizontal;
    let (sin_d, cos_d) = math::sin_cos(declination_rad);
    Some(east.cross(down) * cos_d - east * sin_d)
}

/// $C_{nb}$ from north and down in body axes.
fn rows(north: &Vector3<f64>, down: &Vector3<f64>) -> Matrix3<f64> {
    let east = down.cross(north);
    Matrix3::new(north.x, north.y, north.z, east.x, east.y, east.z, down.x, down.y, down.z)
}

pub(crate) fn finite(what: &'static str, got: f64) -> Result<(), Error> {
    if got.is_finite() { Ok(()) } else { Err(Error::Config { what, need: "a finite number", got }) }
}

pub(crate) fn positive(what: &'static str, got: f64) -> Result<(), Error> {
    if got.is_finite() && got > 0.0 {
        Ok(())
    } else {
        Err(Error::Config { what, need: "a positive finite number", got })
    }
}

/// A gain, 1/s or 1/s²: finite, not negative, below anything that a sampled law could follow.
pub(crate) fn gain(what: &'static str, got: f64) -> Result<(), Error> {
    if (0.0..=GAIN_MAX).contains(&got) {
        Ok(())
    } else {
        Err(Error::Config { what, need: "a number from 0 to 1e12", got })
    }
}

const GAIN_MAX: f64 = 1.0e12;
