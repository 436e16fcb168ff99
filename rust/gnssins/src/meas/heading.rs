//! Heading of the body's forward axis, as two antennas along it give it.

use super::{BadReason, Measurement, Rows, Source, View, check_variance};
use crate::attitude;
use crate::frames::wrap_pi;
use crate::math;
use crate::nav::{NavModel, PHI, Vector9};

/// A heading clockwise from true north.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Heading {
    /// Time of validity, ns.
    pub t_ns: i64,
    /// Heading, rad.
    pub heading_rad: f64,
    /// Variance of its white noise, rad².
    pub variance: f64,
}

/// Cosine of the pitch below which a heading says nothing: five degrees from the vertical.
const LEAST_COS_PITCH: f64 = 0.087;

impl Measurement for Heading {
    fn t_ns(&self) -> i64 {
        self.t_ns
    }

    fn source(&self) -> Source {
        Source::Heading
    }

    /// An attitude error phi turns the estimate by -phi, the heading by the last row of
    /// [`attitude::euler_jacobian`] times that.
    fn rows<M: NavModel, const CAP: usize>(&self, view: &View<M, CAP>) -> Result<Rows<CAP>, BadReason> {
        if !self.heading_rad.is_finite() || self.heading_rad.abs() > 2.0 * core::f64::consts::TAU {
            return Err(BadReason::Value);
        }
        check_variance(self.variance)?;
        let (_, pitch, heading) = attitude::to_euler(&view.model.solution().q_nb);
        if math::abs(math::cos(pitch)) < LEAST_COS_PITCH {
            return Err(BadReason::Vertical);
        }
        let mut h_ned = Vector9::zeros();
        let row = attitude::euler_jacobian(pitch, heading).row(2).transpose();
        h_ned.fixed_rows_mut::<3>(PHI).copy_from(&-row);
        Ok(Rows::single(view.model, wrap_pi(heading - self.heading_rad), &h_ned, self.variance))
    }
}
