//! Navigation models: strapdown mechanisation, its error dynamics and the Jacobians that aids need.
//!
//! # Conventions, written once
//!
//! * Error state, in this order: `phi` (3, rad), `dv` (3, m/s), `dp` (3, m), then the blocks.
//! * Navigation errors are *estimate minus truth*. Attitude: `C_est = (I - [phi x]) C_true`, so that
//!   `C_true = Exp(phi) C_est`. The components are those of the model's own axes: NED for [`ned::Ned`],
//!   ECEF for [`ecef::Ecef`].
//! * Sensor errors (block states) are *what is left in the measurement*: true parameter minus estimated
//!   parameter. A gyro bias `b` is defined by `measured = true + b`.
//! * So a correction is subtracted from the navigation solution and added to the block parameters.
//! * A measurement gives `y = predicted - measured = H x - noise`, always along north, east, down.

pub mod ecef;
pub mod kinematics;
pub mod ned;
pub mod three_rate;

use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};

use crate::earth::{Ellipsoid, Gravity, WGS84};
use crate::error::Error;
use crate::frames::Lla;
use crate::imu::Strap;
use crate::nav::kinematics::AttitudeForm;
use crate::simd::{Aligned, Lanes};

/// First row of the attitude error `phi`.
pub const PHI: usize = 0;
/// First row of the velocity error `dv`.
pub const DV: usize = 3;
/// First row of the position error `dp`.
pub const DP: usize = 6;
/// Number of navigation error states.
pub const NAV: usize = 9;
/// Where the last row of the dynamics has its only number, which is 1.
pub(crate) const LAST_FROM: usize = DV + 2;

/// 9x9 matrix over the navigation errors.
pub type Matrix9 = SMatrix<f64, NAV, NAV>;
/// 9x3 matrix, a coupling of a body-axes sensor error into the navigation errors.
pub type Matrix9x3 = SMatrix<f64, NAV, 3>;
/// 3x9 matrix, rows of a measurement over the navigation errors.
pub type Matrix3x9 = SMatrix<f64, 3, NAV>;
/// Navigation error vector.
pub type Vector9 = SVector<f64, NAV>;

/// Ellipsoid and gravity formula that a model works with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EarthModel {
    /// Reference ellipsoid, with its rotation rate.
    pub ellipsoid: Ellipsoid,
    /// Gravity formula.
    pub gravity: Gravity,
}

impl Default for EarthModel {
    fn default() -> Self {
        Self { ellipsoid: WGS84, gravity: Gravity::Normal }
    }
}

/// Position, velocity and attitude as the user sees them, whatever the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solution {
    /// Geodetic position of the IMU.
    pub position: Lla,
    /// Velocity against the Earth along north, east, down, m/s.
    pub v_n: Vector3<f64>,
    /// Attitude: takes body vectors (forward, right, down) to NED.
    pub q_nb: UnitQuaternion<f64>,
}

/// Continuous error dynamics at one point: `x' = f x + coupling * sensor error`.
///
/// The last row is the same for every model: the last position error grows by the last velocity error and nothing else.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dynamics {
    /// Rows 0 to 7 of the system matrix, column by column.
    pub(crate) columns: Aligned<[Lanes; NAV]>,
    /// Body to model axes; the gyro error enters `phi` by `-c`, the accelerometer error `dv` by `+c`.
    pub c: Matrix3<f64>,
}

impl Dynamics {
    /// From the blocks of the rows `phi` and `dv`, and of `dp` over itself, whose last row is zero; `dp` over `dv` is the
    /// identity.
    #[inline(always)]
    pub(crate) fn of(
        phi: &[Matrix3<f64>; 3],
        dv: &[Matrix3<f64>; 3],
        dp: &Matrix3<f64>,
        c: Matrix3<f64>,
    ) -> Self {
        let column = |block: usize, j: usize| {
            let (a, b) = (&phi[block], &dv[block]);
            let [north, east] = match block {
                0 => [0.0, 0.0],
                1 => [if j == 0 { 1.0 } else { 0.0 }, if j == 1 { 1.0 } else { 0.0 }],
                _ => [dp[(0, j)], dp[(1, j)]],
            };
            [a[(0, j)], a[(1, j)], a[(2, j)], b[(0, j)], b[(1, j)], b[(2, j)], north, east]
        };
        let columns = [
            column(0, 0),
            column(0, 1),
            column(0, 2),
            column(1, 0),
            column(1, 1),
            column(1, 2),
            column(2, 0),
            column(2, 1),
            column(2, 2),
        ];
        Self { columns: Aligned(columns), c }
    }

    /// System matrix of the nine navigation errors, 1/s and mixed units.
    #[must_use]
    pub fn f(&self) -> Matrix9 {
        let last = |j| if j == LAST_FROM { 1.0 } else { 0.0 };
        Matrix9::from_fn(|i, j| self.columns.0[j].get(i).copied().unwrap_or(last(j)))
    }

    /// Coupling of a gyro error (rad/s, body axes).
    #[must_use]
    pub fn gyro_coupling(&self) -> Matrix9x3 {
        let mut g = Matrix9x3::zeros();
        g.fixed_rows_mut::<3>(PHI).copy_from(&-self.c);
        g
    }

    /// Coupling of an accelerometer error (m/s², body axes).
    #[must_use]
    pub fn accel_coupling(&self) -> Matrix9x3 {
        let mut g = Matrix9x3::zeros();
        g.fixed_rows_mut::<3>(DV).copy_from(&self.c);
        g
    }
}

/// What the error dynamics depend on, in the middle of an interval. The mean of several intervals is a motion too.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Where: sine and cosine of the latitude and height (m) in NED, position (m) in ECEF.
    pub place: Vector3<f64>,
    /// Velocity against the Earth, model axes, m/s.
    pub v: Vector3<f64>,
    /// Specific force, model axes, m/s².
    pub f: Vector3<f64>,
    /// Body to model axes.
    pub c: Matrix3<f64>,
    /// How gravity changes: per rad of latitude and per m of height in the first two columns in NED, per m of position in
    /// ECEF.
    pub gravity: Matrix3<f64>,
}

impl Motion {
    /// Nothing, as the start of a sum.
    pub(crate) const ZERO: Self = Self {
        place: Vector3::new(0.0, 0.0, 0.0),
        v: Vector3::new(0.0, 0.0, 0.0),
        f: Vector3::new(0.0, 0.0, 0.0),
        c: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        gravity: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    };

    /// The sum with another one by a weight.
    pub(crate) fn plus(&self, other: &Self, weight: f64) -> Self {
        Self {
            place: self.place + weight * other.place,
            v: self.v + weight * other.v,
            f: self.f + weight * other.f,
            c: self.c + weight * other.c,
            gravity: self.gravity + weight * other.gravity,
        }
    }
}

/// A position or velocity aid, linearised: `y = predicted - measured = H x - noise`, rows north, east, down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aid {
    /// Predicted minus measured.
    pub y: Vector3<f64>,
    /// Rows over the navigation errors.
    pub h: Matrix3x9,
    /// Rows over the remaining gyro error (rad/s, body axes).
    pub h_gyro: Matrix3<f64>,
    /// Rows over the remaining lever-arm error (m, body axes).
    pub h_lever: Matrix3<f64>,
}

/// One mechanisation with its error model. Everything above (blocks, covariance, aids) is written once against
/// this trait.
pub trait NavModel: Clone {
    /// Name in configurations.
    const NAME: &'static str;

    /// Starts the model at a solution.
    ///
    /// # Errors
    /// [`Error::NonFinite`] for a NaN or infinity, [`Error::LatitudeLimit`] where the model does not work.
    fn new(earth: EarthModel, solution: &Solution) -> Result<Self, Error>;

    /// Chooses how the attitude is integrated; a model that has the exact form only refuses any other.
    ///
    /// # Errors
    /// [`Error::Config`].
    fn set_attitude_form(&mut self, form: AttitudeForm) -> Result<(), Error> {
        match form {
            AttitudeForm::RotationVector => Ok(()),
            _ => Err(Error::Config {
                what: "filter.attitude_form (number of the form)",
                need: "must be 0, rotation-vector: the ECEF model has no other",
                got: f64::from(form as u8),
            }),
        }
    }

    /// Goes to another solution; ellipsoid, gravity and attitude form stay.
    ///
    /// # Errors
    /// As [`NavModel::new`]; the state is then unchanged.
    fn restart(&mut self, solution: &Solution) -> Result<(), Error>;

    /// The present solution.
    fn solution(&self) -> Solution;

    /// One strapdown step; returns the motion at mid-interval.
    ///
    /// # Errors
    /// As [`NavModel::new`]; the state is then unchanged.
    fn advance(&mut self, strap: &Strap) -> Result<Motion, Error>;

    /// The motion at the present state under the specific force `f_b` (m/s², body axes).
    fn motion(&self, f_b: &Vector3<f64>) -> Motion;

    /// Error dynamics of a motion.
    fn linearise(&self, motion: &Motion) -> Dynamics;

    /// One strapdown step; returns the error dynamics at mid-interval.
    ///
    /// # Errors
    /// As [`NavModel::advance`].
    #[inline(always)]
    fn step(&mut self, strap: &Strap) -> Result<Dynamics, Error> {
        self.advance(strap).map(|motion| self.linearise(&motion))
    }

    /// Error dynamics at the present state under the specific force `f_b` (m/s², body axes).
    fn dynamics(&self, f_b: &Vector3<f64>) -> Dynamics {
        self.linearise(&self.motion(f_b))
    }

    /// Removes an estimated error (estimate minus truth) from the state.
    fn correct(&mut self, x: &Vector9);

    /// Position of a point at `lever_b` (m, body axes) against a measured one.
    fn position_aid(&self, lever_b: &Vector3<f64>, measured: &Lla) -> Aid;

    /// Velocity of a point at `lever_b` against a measured one (m/s, NED), with the body rate `w_ib_b` (rad/s).
    /// `at` is the receiver's own position where known: its NED axes are those of the measured velocity.
    fn velocity_aid(
        &self,
        lever_b: &Vector3<f64>,
        w_ib_b: &Vector3<f64>,
        measured: &Vector3<f64>,
        at: Option<&Lla>,
    ) -> Aid;

    /// Takes the model's error vector to the errors along NED at the present point; `None` when they are the same.
    fn to_ned_errors(&self) -> Option<Matrix9>;

    /// The numbers that make up the state, for saving bit by bit.
    fn pack(&self) -> [f64; 10];

    /// Restores what [`NavModel::pack`] gave.
    ///
    /// # Errors
    /// As [`NavModel::new`]; the state is then unchanged.
    fn unpack(&mut self, packed: &[f64; 10]) -> Result<(), Error>;
}

/// Rows of a velocity aid that both models share: velocity of the lever arm's end against the Earth, and its
/// Jacobians, in the axes of `c`.
struct LeverVelocity {
    velocity: Vector3<f64>,
    h_phi: Matrix3<f64>,
    h_gyro: Matrix3<f64>,
    h_lever: Matrix3<f64>,
}

fn lever_velocity(
    c: &Matrix3<f64>,
    lever_b: &Vector3<f64>,
    w_ib_b: &Vector3<f64>,
    w_ie: &Vector3<f64>,
) -> LeverVelocity {
    use crate::attitude::skew;
    let arm = c * lever_b;
    let spin = c * w_ib_b.cross(lever_b);
    let w_ie_x = skew(w_ie);
    LeverVelocity {
        velocity: spin - w_ie.cross(&arm),
        h_phi: skew(&spin) - w_ie_x * skew(&arm),
        h_gyro: -c * skew(lever_b),
        h_lever: w_ie_x * c - c * skew(w_ib_b),
    }
}

/// `(I - dt/2 [w x]) v`: a vector turned by half of the frame's rotation over the interval, to first order.
fn half_turn(w: &Vector3<f64>, dt_s: f64, v: &Vector3<f64>) -> Vector3<f64> {
    v - 0.5 * dt_s * w.cross(v)
}

/// Refuses a start that is no state: angles out of range (degrees given as radians) or no rotation.
fn check_start(solution: &Solution) -> Result<(), Error> {
    let Lla { lat_rad, lon_rad, height_m } = solution.position;
    finite("position", &[lat_rad, lon_rad, height_m])?;
    let bound = |what, got: f64, limit: f64, need| {
        if got.abs() <= limit { Ok(()) } else { Err(Error::Config { what, need, got }) }
    };
    bound(
        "latitude (rad)",
        lat_rad,
        core::f64::consts::FRAC_PI_2,
        "must lie in -pi/2..pi/2: are these degrees?",
    )?;
    bound(
        "longitude (rad)",
        lon_rad,
        2.0 * core::f64::consts::PI,
        "must lie in -2pi..2pi: are these degrees?",
    )?;
    let norm = solution.q_nb.coords.norm();
    finite("attitude", &[norm])?;
    if (norm - 1.0).abs() > 1e-3 {
        return Err(Error::Config { what: "attitude quaternion (length)", need: "must be 1", got: norm });
    }
    Ok(())
}

/// Largest distance (m) and speed (m/s) that count as numbers of a navigation state: beyond them conversions overflow.
const FARTHEST_M: f64 = 1e9;
const FASTEST_M_S: f64 = 1e6;

fn finite(what: &'static str, values: &[f64]) -> Result<(), Error> {
    within(what, values, f64::MAX)
}

fn within(what: &'static str, values: &[f64], limit: f64) -> Result<(), Error> {
    // NaN fails the comparison too
    if values.iter().all(|v| v.abs() <= limit) { Ok(()) } else { Err(Error::NonFinite { what, t_ns: 0 }) }
}
