//! Height of a barometric altimeter, with the error of its block.

use super::{BadReason, Measurement, Rows, Source, View, check_variance};
use crate::blocks::Coupling;
use crate::nav::{DP, NavModel, Vector9};

/// A height. The altimeter's slow error (weather, static pressure) is the block `baro_bias`; without one the height
/// counts as free of bias.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BaroHeight {
    /// Time of validity, ns.
    pub t_ns: i64,
    /// Height above the ellipsoid, up to the altimeter's own error, m.
    pub height_m: f64,
    /// Variance of its white noise, m².
    pub variance: f64,
}

/// Height beyond which nothing measures pressure, m.
const HIGHEST_M: f64 = 1e6;

impl Measurement for BaroHeight {
    fn t_ns(&self) -> i64 {
        self.t_ns
    }

    fn source(&self) -> Source {
        Source::Baro
    }

    /// `y = h + b - h_B`: down is minus up, and the bias left in the measurement is subtracted.
    fn rows<M: NavModel, const CAP: usize>(&self, view: &View<M, CAP>) -> Result<Rows<CAP>, BadReason> {
        if !self.height_m.is_finite() || self.height_m.abs() > HIGHEST_M {
            return Err(BadReason::Value);
        }
        check_variance(self.variance)?;
        let mut h_ned = Vector9::zeros();
        h_ned[DP + 2] = -1.0;
        let y = view.model.solution().position.height_m - self.height_m;
        let mut rows = Rows::single(view.model, y, &h_ned, self.variance);
        for (j, _) in view.layout.couplings().filter(|(_, c)| *c == Coupling::Baro) {
            rows.h[0][j] = -1.0;
            rows.y[0] += view.params[j];
        }
        Ok(rows)
    }
}
