//! Inertial input: calibration, increments, coning and sculling.

use nalgebra::{Matrix3, Vector3};

use crate::attitude::skew;
use crate::error::Error;

/// What an IMU row holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum ImuInput {
    /// Angle (rad) and velocity (m/s) increments over the interval that ends at the stamp.
    Increments,
    /// Mean rates (rad/s, m/s²) over the interval that ends at the stamp.
    MeanRates,
    /// Rates (rad/s, m/s²) sampled at the stamp; integrated by the trapezoid rule.
    #[default]
    Rates,
}

/// Order of the coning and sculling compensation of increments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Coning {
    /// Rotation during the interval only.
    OneSample,
    /// Also the change of rate since the previous interval (Savage 2000, sect. 7.1-7.2).
    #[default]
    TwoSample,
    /// As [`Coning::TwoSample`], and the velocity increment to third order in the turn: adds
    /// $\tfrac16\Delta\theta\times(\Delta\theta\times\Delta v)$. Without it a body that turns at w loses the share
    /// (w dt)²/6 of the specific force across its axis: 17 ppm at 1 rad/s and 100 Hz.
    ThirdOrder,
}

/// Deterministic sensor calibration: `measured = (I + matrix) true + bias`, per sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    bias: Vector3<f64>,
    inverse: Matrix3<f64>,
    identity: bool,
}

impl Default for Calibration {
    fn default() -> Self {
        Self { bias: Vector3::zeros(), inverse: Matrix3::identity(), identity: true }
    }
}

impl Calibration {
    /// From a bias (rad/s or m/s²) and a matrix of scale factors and misalignments (dimensionless).
    ///
    /// # Errors
    /// [`Error::Config`] when `I + matrix` cannot be inverted or a value is not finite.
    pub fn new(bias: Vector3<f64>, matrix: Matrix3<f64>) -> Result<Self, Error> {
        let mut calibration = Self::default();
        calibration.set(bias, matrix)?;
        Ok(calibration)
    }

    /// As [`Calibration::new`], in place; on an error unchanged.
    #[inline(always)]
    pub(crate) fn set(&mut self, bias: Vector3<f64>, matrix: Matrix3<f64>) -> Result<(), Error> {
        let refuse = |got| {
            Err(Error::Config {
                what: "imu.calibration",
                need: "I + matrix must be invertible and finite",
                got,
            })
        };
        if !(bias.x.is_finite() && bias.y.is_finite() && bias.z.is_finite()) {
            return refuse(bias.sum());
        }
        if matrix == Matrix3::zeros() {
            *self = Self { bias, ..Self::default() };
            return Ok(());
        }
        // the adjugate: its rows are cross products of the columns
        let full = Matrix3::identity() + matrix;
        let [x, y, z] = [0, 1, 2].map(|j| full.column(j).into_owned());
        let (yz, zx, xy) = (y.cross(&z), z.cross(&x), x.cross(&y));
        let det = x.dot(&yz);
        if !(det.is_finite() && det.abs() > 1e-6) {
            return refuse(det);
        }
        let inverse = Matrix3::from_columns(&[yz, zx, xy]).transpose() * (1.0 / det);
        *self = Self { bias, inverse, identity: false };
        Ok(())
    }

    /// True rate from a measured one.
    #[must_use]
    pub fn rate(&self, measured: &Vector3<f64>) -> Vector3<f64> {
        self.increment(measured, 1.0)
    }

    /// True increment over `dt_s` from a measured one.
    #[inline]
    #[must_use]
    pub fn increment(&self, measured: &Vector3<f64>, dt_s: f64) -> Vector3<f64> {
        let centred = measured - self.bias * dt_s;
        if self.identity { centred } else { self.inverse * centred }
    }
}

/// Increments over one interval, in body axes, not yet compensated for rotation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuDelta {
    /// Length of the interval, s.
    pub dt_s: f64,
    /// Integral of the angular rate, rad.
    pub dtheta: Vector3<f64>,
    /// Integral of the specific force, m/s.
    pub dvel: Vector3<f64>,
}

/// What the strapdown step takes: the interval's rotation vector and its velocity increment resolved in
/// the body axes of the interval's start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Strap {
    /// Length of the interval, s.
    pub dt_s: f64,
    /// Rotation vector of the body over the interval, rad.
    pub alpha: Vector3<f64>,
    /// Specific-force increment in the body axes at the start, m/s.
    pub u: Vector3<f64>,
}

impl Strap {
    /// From two successive increments; without `previous` (start, after a gap, or [`Coning::OneSample`]) the
    /// rates count as constant within the interval.
    ///
    /// With rates that vary linearly over both intervals, and k = dt²/(6 dt₁ (dt₁ + dt)) (1/12 for equal ones):
    /// $$\alpha=\Delta\theta+k\,\Delta\theta_1\times\Delta\theta,\quad
    ///   u=\Delta v+\tfrac12\Delta\theta\times\Delta v+k(\Delta\theta_1\times\Delta v+\Delta v_1\times\Delta\theta)$$
    /// Savage (2000), sections 7.1.1.1 and 7.2.2.2, for equal intervals.
    #[must_use]
    pub fn from_increments(now: &ImuDelta, previous: Option<&ImuDelta>) -> Self {
        let mut alpha = now.dtheta;
        let mut u = now.dvel + 0.5 * now.dtheta.cross(&now.dvel);
        if let Some(p) = previous.filter(|p| p.dt_s > 0.0) {
            let k = now.dt_s * now.dt_s / (6.0 * p.dt_s * (p.dt_s + now.dt_s));
            alpha += k * p.dtheta.cross(&now.dtheta);
            u += k * (p.dtheta.cross(&now.dvel) + p.dvel.cross(&now.dtheta));
        }
        Self { dt_s: now.dt_s, alpha, u }
    }

    /// As [`Strap::from_increments`], with what `coning` uses of it.
    #[inline]
    #[must_use]
    pub fn compensated(now: &ImuDelta, previous: Option<&ImuDelta>, coning: Coning) -> Self {
        let mut strap = Self::from_increments(now, previous.filter(|_| coning != Coning::OneSample));
        if coning == Coning::ThirdOrder {
            strap.u += now.dtheta.cross(&now.dtheta.cross(&now.dvel)) / 6.0;
        }
        strap
    }

    /// The increments whose [`Strap::compensated`] is this one: the exact inverse, for simulation.
    #[must_use]
    pub fn to_increments(&self, previous: Option<&ImuDelta>, coning: Coning) -> ImuDelta {
        let previous = previous.filter(|_| coning != Coning::OneSample);
        let (mut turn, mut carry, mut k) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
        if let Some(p) = previous.filter(|p| p.dt_s > 0.0) {
            k = self.dt_s * self.dt_s / (6.0 * p.dt_s * (p.dt_s + self.dt_s));
            turn = k * skew(&p.dtheta);
            carry = p.dvel;
        }
        // I plus a skew-symmetric matrix is never singular, nor is it with the third order of a realistic turn
        let solve = |m: Matrix3<f64>, v: Vector3<f64>| m.try_inverse().map_or(v, |i| i * v);
        let dtheta = solve(Matrix3::identity() + turn, self.alpha);
        let mut carried = Matrix3::identity() + 0.5 * skew(&dtheta) + turn;
        if coning == Coning::ThirdOrder {
            carried += skew(&dtheta) * skew(&dtheta) / 6.0;
        }
        let dvel = solve(carried, self.u - k * carry.cross(&dtheta));
        ImuDelta { dt_s: self.dt_s, dtheta, dvel }
    }

    /// From rates at both ends of the interval, taken as linear in between.
    #[must_use]
    pub fn from_rates(start: &Rates, end: &Rates, dt_s: f64) -> Self {
        let dtheta = 0.5 * dt_s * (start.gyro + end.gyro);
        let dvel = 0.5 * dt_s * (start.accel + end.accel);
        let k = dt_s * dt_s / 12.0;
        Self {
            dt_s,
            alpha: dtheta + k * start.gyro.cross(&end.gyro),
            u: dvel
                + 0.5 * dtheta.cross(&dvel)
                + k * (start.gyro.cross(&end.accel) + start.accel.cross(&end.gyro)),
        }
    }
}

/// Angular rate and specific force at one instant, body axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rates {
    /// Angular rate of the body against inertial space, rad/s.
    pub gyro: Vector3<f64>,
    /// Specific force, m/s².
    pub accel: Vector3<f64>,
}

impl Rates {
    /// Linear interpolation, `s` from 0 (self) to 1 (`end`).
    #[must_use]
    pub fn towards(&self, end: &Rates, s: f64) -> Rates {
        Rates { gyro: self.gyro.lerp(&end.gyro, s), accel: self.accel.lerp(&end.accel, s) }
    }

    /// True when all six numbers are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.gyro.iter().chain(self.accel.iter()).all(|v| v.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attitude;
    use crate::math;

    /// Integrates dC/dt = C [w x] and dv/dt = C f finely as the reference.
    fn reference(
        w: impl Fn(f64) -> Vector3<f64>,
        f: impl Fn(f64) -> Vector3<f64>,
        t0: f64,
        t1: f64,
    ) -> Strap {
        let n = 2000;
        let dt = (t1 - t0) / f64::from(n);
        let (mut q, mut u) = (nalgebra::UnitQuaternion::identity(), Vector3::zeros());
        for i in 0..n {
            let t = t0 + (f64::from(i) + 0.5) * dt;
            let half = q * attitude::exp(&(w(t) * dt * 0.5));
            u += half * f(t) * dt;
            q *= attitude::exp(&(w(t) * dt));
        }
        Strap { dt_s: t1 - t0, alpha: attitude::log(&q), u }
    }

    #[test]
    fn linear_rates_give_exact_coning_and_sculling_to_third_order() {
        let w = |t: f64| Vector3::new(0.8 + 9.0 * t, -0.5 + 4.0 * t, 0.3 - 7.0 * t);
        let f = |t: f64| Vector3::new(3.0 - 40.0 * t, 2.0 + 30.0 * t, -9.0 + 50.0 * t);
        let delta = |a: f64, b: f64| ImuDelta {
            dt_s: b - a,
            dtheta: w(0.5 * (a + b)) * (b - a),
            dvel: f(0.5 * (a + b)) * (b - a),
        };
        let (t0, t1, t2) = (-0.006, 0.0, 0.01);
        let truth = reference(w, f, t1, t2);
        let two = Strap::from_increments(&delta(t1, t2), Some(&delta(t0, t1)));
        let one = Strap::from_increments(&delta(t1, t2), None);
        let rates = |t| Rates { gyro: w(t), accel: f(t) };
        let trapezoid = Strap::from_rates(&rates(t1), &rates(t2), t2 - t1);
        for s in [&two, &trapezoid] {
            assert!((s.alpha - truth.alpha).norm() < 2e-9, "{}", (s.alpha - truth.alpha).norm());
            // what is left of u is the second-order rotation w x (w x f) dt³/6
            assert!((s.u - truth.u).norm() < 5e-6, "{}", (s.u - truth.u).norm());
        }
        assert!((two.alpha - trapezoid.alpha).norm() < 1e-15);
        assert!((two.u - trapezoid.u).norm() < 1e-15);
        assert!((one.alpha - truth.alpha).norm() > 100.0 * (two.alpha - truth.alpha).norm());
    }

    #[test]
    fn third_order_keeps_the_force_of_a_steady_turn() {
        // w along z, f along x, both constant: u = f [sin a / w, (1 - cos a) / w], a = w dt
        let (w, f, dt) = (1.0, 9.8, 0.05);
        let delta = ImuDelta { dt_s: dt, dtheta: Vector3::z() * (w * dt), dvel: Vector3::x() * (f * dt) };
        let exact = f / w * Vector3::new(math::sin(w * dt), 1.0 - math::cos(w * dt), 0.0);
        let miss = |coning| (Strap::compensated(&delta, Some(&delta), coning).u - exact).norm();
        let third = f * dt * (w * dt) * (w * dt) / 6.0;
        assert!((miss(Coning::TwoSample) / third - 1.0).abs() < 2e-2);
        assert!((miss(Coning::ThirdOrder) / (third * 0.25 * w * dt) - 1.0).abs() < 1e-2);
        for coning in [Coning::OneSample, Coning::TwoSample, Coning::ThirdOrder] {
            let before = ImuDelta { dt_s: 0.03, dtheta: Vector3::new(0.01, -0.02, 0.04), dvel: delta.dvel };
            let back = Strap::compensated(&delta, Some(&before), coning).to_increments(Some(&before), coning);
            assert!((back.dtheta - delta.dtheta).norm() < 1e-16 && (back.dvel - delta.dvel).norm() < 1e-15);
        }
    }

    #[test]
    fn classical_coning_drift_is_removed() {
        // w = a W (cos Wt, sin Wt, 0): the mean drift about z is a² W (1 - sin(W dt)/(W dt)) / 2 if uncompensated
        let (a, big_w, dt) = (1e-3, 2.0 * core::f64::consts::PI * 10.0, 0.01);
        let delta = |k: i32| {
            let (t0, t1) = (f64::from(k) * dt, f64::from(k + 1) * dt);
            let dtheta = Vector3::new(
                a * (math::sin(big_w * t1) - math::sin(big_w * t0)),
                -a * (math::cos(big_w * t1) - math::cos(big_w * t0)),
                0.0,
            );
            ImuDelta { dt_s: dt, dtheta, dvel: Vector3::zeros() }
        };
        let drift = |two: bool| {
            let total: Vector3<f64> = (0..10)
                .map(|k| {
                    Strap::from_increments(&delta(k), two.then(|| delta(k - 1)).as_ref()).alpha
                        - delta(k).dtheta
                })
                .sum();
            total.z / (10.0 * dt)
        };
        let needed = 0.5 * a * a * big_w * (1.0 - math::sin(big_w * dt) / (big_w * dt));
        assert_eq!(drift(false), 0.0);
        // the two-sample form leaves a part of the order (W dt)² of the coning rate
        assert!((drift(true) / needed - 1.0).abs() < 0.12, "{}", drift(true) / needed);
    }

    #[test]
    fn calibration_inverts_its_own_model() {
        let m = Matrix3::new(0.01, 0.002, -0.003, 0.001, -0.02, 0.004, 0.0, 0.005, 0.03);
        let b = Vector3::new(0.1, -0.2, 0.3);
        let c = Calibration::new(b, m).unwrap();
        let truth = Vector3::new(1.0, -2.0, 9.8);
        let measured = (Matrix3::identity() + m) * truth + b;
        assert!((c.rate(&measured) - truth).norm() < 1e-14);
        assert!((c.increment(&(measured * 0.01), 0.01) - truth * 0.01).norm() < 1e-16);
        assert!(Calibration::new(b, -Matrix3::identity()).is_err());
    }
}
