//! What a filter is tuned with, where it starts, and how accurate it says it is.

use nalgebra::Vector3;

use crate::discretise::{ImuNoise, Order};
use crate::error::Error;
use crate::imu::Coning;
use crate::meas::{SOURCES, Source};
use crate::nav::{EarthModel, Solution};
use crate::small::{self, ROWS_MAX};

/// What a filter is tuned with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Ellipsoid and gravity.
    pub earth: EarthModel,
    /// White noise of the inertial sensors.
    pub noise: ImuNoise,
    /// Order of the transition matrix.
    pub order: Order,
    /// Intervals that the covariance goes through at once, with the mean of their dynamics; always up to date where a
    /// measurement is fused. 1: at every sample.
    pub covariance_every: u32,
    /// Coning and sculling compensation of increments.
    pub coning: Coning,
    /// IMU to GNSS antenna, m, body axes.
    pub lever_b_m: Vector3<f64>,
    /// Probability with which a good measurement passes its chi-square gate, or no gate; by [`Source::index`].
    pub gate_probability: [Option<f64>; SOURCES],
    /// How the fixes of the receiver are judged.
    pub integrity: Integrity,
    /// Lower bounds of the navigation sigmas; those of blocks stand in the blocks.
    pub floor: Floor,
    /// Least time between two feedbacks of the error estimate into the state, ns; 0: after every measurement.
    pub feedback_ns: i64,
}

/// What a running filter keeps of its settings: gates and bounds stand in tables of their own.
#[derive(Debug, Clone, Copy)]
pub(super) struct Kept {
    pub(super) earth: EarthModel,
    pub(super) noise: ImuNoise,
    pub(super) lever_b_m: Vector3<f64>,
    pub(super) integrity: Integrity,
    pub(super) feedback_ns: i64,
    pub(super) covariance_every: u32,
    pub(super) order: Order,
    pub(super) coning: Coning,
}

impl From<&Settings> for Kept {
    fn from(s: &Settings) -> Self {
        let Settings {
            earth, noise, lever_b_m, integrity, feedback_ns, covariance_every, order, coning, ..
        } = *s;
        Self { earth, noise, lever_b_m, integrity, feedback_ns, covariance_every, order, coning }
    }
}

/// What is dropped when a test fails.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Gate {
    /// All components are judged together, the whole fix is dropped.
    #[default]
    Joint,
    /// Position and velocity are judged apart, only what fails is dropped.
    Parts,
}

/// Tests of a fix. The chi-square gate takes what [`Integrity::gate`] says together; the other two always judge position
/// and velocity apart.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Integrity {
    /// What the chi-square gate judges together.
    pub gate: Gate,
    /// Largest y'y / trace(H P H' + R) of position and of velocity, or no such test. Novik (2011): at least 10. The test
    /// is blind in the directions of small sigma; the chi-square gate is not.
    pub trace_ratio_limit: Option<f64>,
    /// Largest acceleration of the vehicle, m/s², for the tolerance test, or no such test: a fix must lie within
    /// a dt²/2 + 5 sqrt(2) sigma of the last accepted estimate extrapolated by its velocity, and its velocity within
    /// a dt + 5 sqrt(2) sigma of the one then.
    pub max_accel_m_s2: Option<f64>,
}

/// Lower bounds of standard deviations, north, east, down; zero for none. They keep the gain of a filter open whose
/// model is better than its vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Floor {
    /// Of `phi`, rad.
    pub phi: Vector3<f64>,
    /// Of the velocity, m/s.
    pub v: Vector3<f64>,
    /// Of the position, m.
    pub p: Vector3<f64>,
}

impl Floor {
    /// No bounds.
    pub const NONE: Self = Self {
        phi: Vector3::new(0.0, 0.0, 0.0),
        v: Vector3::new(0.0, 0.0, 0.0),
        p: Vector3::new(0.0, 0.0, 0.0),
    };
}

impl Settings {
    /// The usual settings with this sensor noise: WGS-84, third order, two-sample coning, no lever arm, joint gates
    /// at 0.999, feedback after every measurement.
    #[must_use]
    pub fn new(noise: ImuNoise) -> Self {
        Self {
            earth: EarthModel::default(),
            noise,
            order: Order::default(),
            covariance_every: 1,
            coning: Coning::default(),
            lever_b_m: Vector3::zeros(),
            gate_probability: [Some(0.999); SOURCES],
            integrity: Integrity::default(),
            floor: Floor::NONE,
            feedback_ns: 0,
        }
    }

    pub(super) fn check(&self) -> Result<(), Error> {
        let psd = [
            ("imu.gyro noise density", &self.noise.gyro_psd),
            ("imu.accel noise density", &self.noise.accel_psd),
            ("filter.floor_attitude", &self.floor.phi),
            ("filter.floor_velocity", &self.floor.v),
            ("filter.floor_position", &self.floor.p),
        ];
        for (what, values) in psd {
            if let Some(&got) = values.iter().find(|v| !(v.is_finite() && **v >= 0.0)) {
                return Err(Error::Config { what, need: "must be finite and at least 0", got });
            }
        }
        if let Some(&got) = self.lever_b_m.iter().find(|v| !v.is_finite()) {
            return Err(Error::Config { what: "gnss.lever_ba_b_m", need: "must be finite", got });
        }
        if self.covariance_every == 0 {
            return Err(Error::Config {
                what: "filter.covariance_every",
                need: "must be at least 1",
                got: 0.0,
            });
        }
        if self.feedback_ns < 0 {
            let got = self.feedback_ns as f64;
            return Err(Error::Config {
                what: "filter.feedback_interval (ns)",
                need: "must be at least 0",
                got,
            });
        }
        for (what, limit) in [
            ("gnss.trace_ratio_limit", self.integrity.trace_ratio_limit),
            ("gnss.max_accel_m_s2", self.integrity.max_accel_m_s2),
        ] {
            if let Some(got) = limit.filter(|v| !(v.is_finite() && *v > 0.0)) {
                return Err(Error::Config { what, need: "must be finite and greater than 0", got });
            }
        }
        let names = ["gnss.gate_probability", "baro.gate_probability", "heading.gate_probability"];
        for (what, p) in names.into_iter().zip(self.gate_probability) {
            if let Some(got) = p.filter(|p| !(*p > 0.0 && *p < 1.0)) {
                return Err(Error::Config { what, need: "must lie between 0 and 1, ends excluded", got });
            }
        }
        Ok(())
    }

    /// Chi-square quantiles by source and degrees of freedom.
    pub(super) fn gates(&self) -> [[f64; ROWS_MAX + 1]; SOURCES] {
        Source::ALL.map(|source| {
            core::array::from_fn(|dof| match self.gate_probability[source.index()] {
                Some(p) if dof > 0 => small::chi_square_quantile(dof, p),
                _ => f64::INFINITY,
            })
        })
    }
}

/// Where a filter starts, and how well that is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Initial {
    /// Time, ns.
    pub t_ns: i64,
    /// Solution at that time.
    pub solution: Solution,
    /// Standard deviation of `phi` along north, east, down, rad.
    pub sd_phi: Vector3<f64>,
    /// Standard deviation of the velocity along north, east, down, m/s.
    pub sd_v: Vector3<f64>,
    /// Standard deviation of the position along north, east, down, m.
    pub sd_p: Vector3<f64>,
}

/// Standard deviations of the solution as the user reads it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolutionSd {
    /// Position north, east, down, m.
    pub position_m: Vector3<f64>,
    /// Velocity north, east, down, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Roll, pitch, heading, rad.
    pub euler_rad: Vector3<f64>,
}
