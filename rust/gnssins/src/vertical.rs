//! The vertical channel of a free INS under an outer height (barometer, GNSS): alone it diverges as exp(t / 570 s).

use crate::error::Error;
use crate::nav::Solution;

/// 2 g / R, 1/s²: how fast an error of height accelerates itself.
const RUNAWAY_PER_S2: f64 = 2.0 * 9.81 / 6.371e6;

/// Fewest sampling intervals in the time constant of a loop that is stepped by Euler's rule.
const SAMPLES_PER_TAU: f64 = 5.0;

/// What an outer height does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Vertical {
    /// It replaces the height; the vertical velocity is its change, from the second height on.
    Held,
    /// It damps the channel: a loop of third order with its three poles at -1/tau.
    ///
    /// $$\dot e=v-\tfrac3\tau e,\quad \dot v=a-\big(\tfrac3{\tau^2}+\tfrac{2g}R\big)e-b,\quad \dot b=\tfrac1{\tau^3}e$$
    /// with e the INS height above the outer one and v upward; b takes over a constant accelerometer error, so that
    /// none is left in the height. The characteristic polynomial is (s + 1/tau)³.
    Damped {
        /// Time constant, s.
        tau_s: f64,
    },
}

/// A vertical channel at work.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VerticalLoop {
    kind: Vertical,
    accel_m_s2: f64,
    height_before_m: Option<f64>,
}

impl VerticalLoop {
    /// Starts with no accelerometer error known.
    ///
    /// # Errors
    /// [`Error::Config`] for a time constant that is not finite and positive.
    pub fn new(kind: Vertical) -> Result<Self, Error> {
        match kind {
            Vertical::Damped { tau_s } if !(tau_s.is_finite() && tau_s > 0.0) => {
                let need = "must be finite and greater than 0";
                return Err(Error::Config { what: "vertical.tau_s", need, got: tau_s });
            }
            _ => {}
        }
        Ok(Self { kind, accel_m_s2: 0.0, height_before_m: None })
    }

    /// The solution at the end of an interval of `dt_s` with the outer height of that instant (m). While there is none
    /// (not finite) the channel runs on with the accelerometer error found before.
    ///
    /// # Errors
    /// [`Error::Config`] for an interval that is too long for the time constant.
    pub fn correct(&mut self, solution: &Solution, height_m: f64, dt_s: f64) -> Result<Solution, Error> {
        let mut out = *solution;
        if !height_m.is_finite() {
            self.height_before_m = None;
            out.v_n.z += self.accel_m_s2 * dt_s;
            return Ok(out);
        }
        match self.kind {
            Vertical::Held => {
                out.position.height_m = height_m;
                if let Some(before) = self.height_before_m {
                    out.v_n.z = (before - height_m) / dt_s;
                }
            }
            Vertical::Damped { tau_s } => {
                if dt_s * SAMPLES_PER_TAU > tau_s {
                    let need = "must be at least 5 sampling intervals";
                    return Err(Error::Config { what: "vertical.tau_s", need, got: tau_s });
                }
                let error = solution.position.height_m - height_m;
                let rate = 1.0 / tau_s;
                out.position.height_m -= 3.0 * rate * error * dt_s;
                // down is positive in v_n
                out.v_n.z += ((3.0 * rate * rate + RUNAWAY_PER_S2) * error + self.accel_m_s2) * dt_s;
                self.accel_m_s2 += rate * rate * rate * error * dt_s;
            }
        }
        self.height_before_m = Some(height_m);
        Ok(out)
    }
}
