//! Free inertial navigation in three rates, for a processor that cannot do everything at the rate of the sensors.
//!
//! * fast, every sample: attitude, with the rate of the navigation axes held;
//! * middle, every `velocity` samples: velocity, from the increments gathered since, as [`Gather`] says;
//! * slow, every `position` middle steps: position, radii, Earth rate, transport rate, gravity.
//!
//! The parts are those of the one-rate step of [`super::ned::Ned`]: coning and sculling of [`Strap`], Earth quantities at
//! the predicted middle of the slow interval, half of the frame's rotation on the velocity increment. What is held is
//! computed with the velocity that is expected there, from its change over the slow interval before.

use nalgebra::{Matrix3, Vector3};

use super::kinematics::AttitudeForm;
use super::ned::{Ned, Point};
use super::{EarthModel, NavModel, Solution, finite, half_turn};
use crate::attitude;
use crate::error::Error;
use crate::frames::{Lla, wrap_pi};
use crate::imu::{Coning, ImuDelta, Strap};

/// How much slower than the samples the other two loops run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Divisors {
    /// Samples per velocity step.
    pub velocity: u32,
    /// Velocity steps per position step.
    pub position: u32,
}

/// How the velocity increments of the samples come together until the velocity is stepped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Gather {
    /// Summed in body axes and turned once, with the attitude at the start and sculling over the whole velocity step. Cheap;
    /// what is lost is of third order in the turn within a velocity step.
    #[default]
    Body,
    /// Each turned by the attitude of its own sample: one matrix per sample more, nothing lost.
    Navigation,
}

impl Gather {
    /// The choice of a name, or `None`.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        match name {
            "body" => Some(Self::Body),
            "navigation" => Some(Self::Navigation),
            _ => None,
        }
    }
}

impl Divisors {
    /// Samples per position step.
    fn samples(self) -> f64 {
        f64::from(self.velocity) * f64::from(self.position)
    }
}

/// Quantities that the slow loop holds.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Held {
    point: Point,
    g_n: Vector3<f64>,
    w_en: Vector3<f64>,
    w_in: Vector3<f64>,
}

/// A free INS whose attitude, velocity and position are stepped at three rates.
#[derive(Debug, Clone)]
pub struct ThreeRate {
    earth: EarthModel,
    form: AttitudeForm,
    coning: Coning,
    divisors: Divisors,
    gather: Gather,
    solution: Solution,
    /// Attitude at the start of the velocity step, or of the sample.
    c_nb: Matrix3<f64>,
    /// Velocity increments gathered in navigation axes, m/s.
    force_n: Vector3<f64>,
    held: Option<Held>,
    samples: u32,
    steps: u32,
    sum: ImuDelta,
    previous: Option<ImuDelta>,
    previous_sum: Option<ImuDelta>,
    /// Integral of the velocity since the position was stepped, m.
    travelled: Vector3<f64>,
    v_before: Vector3<f64>,
}

const NOTHING: ImuDelta =
    ImuDelta { dt_s: 0.0, dtheta: Vector3::new(0.0, 0.0, 0.0), dvel: Vector3::new(0.0, 0.0, 0.0) };

impl ThreeRate {
    /// Starts at a solution.
    ///
    /// # Errors
    /// [`Error::Config`] for a divisor of 0, and what [`NavModel::new`] of the NED model refuses.
    pub fn new(
        earth: EarthModel,
        form: AttitudeForm,
        coning: Coning,
        divisors: Divisors,
        gather: Gather,
        start: &Solution,
    ) -> Result<Self, Error> {
        for (what, got) in [("velocity divisor", divisors.velocity), ("position divisor", divisors.position)]
        {
            if got == 0 {
                return Err(Error::Config { what, need: "must be at least 1", got: 0.0 });
            }
        }
        let solution = Ned::new(earth, start)?.solution();
        Ok(Self {
            earth,
            form,
            coning,
            divisors,
            gather,
            solution,
            c_nb: attitude::dcm(&solution.q_nb),
            force_n: Vector3::zeros(),
            held: None,
            samples: 0,
            steps: 0,
            sum: NOTHING,
            previous: None,
            previous_sum: None,
            travelled: Vector3::zeros(),
            v_before: solution.v_n,
        })
    }

    /// Attitude of the last sample, velocity of the last velocity step, position of the last position step.
    #[must_use]
    pub const fn solution(&self) -> Solution {
        self.solution
    }

    /// Takes one sample.
    ///
    /// # Errors
    /// As [`NavModel::step`] of the NED model; nothing has changed then.
    pub fn step(&mut self, delta: &ImuDelta) -> Result<(), Error> {
        let held = match self.held {
            Some(held) => held,
            None => self.hold(&self.solution, delta.dt_s * self.divisors.samples()),
        };
        let mut next = self.solution;
        let strap = self.strap(delta, self.previous.as_ref());
        next.q_nb = self.form.advance(&next.q_nb, &strap.alpha, &(delta.dt_s * held.w_in))?;
        let sum = ImuDelta {
            dt_s: self.sum.dt_s + delta.dt_s,
            dtheta: self.sum.dtheta + delta.dtheta,
            dvel: self.sum.dvel + delta.dvel,
        };
        let force_n = match self.gather {
            Gather::Body => Vector3::zeros(),
            Gather::Navigation => self.force_n + half_turn(&held.w_in, delta.dt_s, &(self.c_nb * strap.u)),
        };
        if self.samples + 1 < self.divisors.velocity {
            finite("attitude", next.q_nb.coords.as_slice())?;
            (self.samples, self.sum, self.force_n) = (self.samples + 1, sum, force_n);
            if self.gather == Gather::Navigation {
                self.c_nb = attitude::dcm(&next.q_nb);
            }
        } else {
            let force_n = match self.gather {
                Gather::Body => {
                    let u = self.strap(&sum, self.previous_sum.as_ref()).u;
                    half_turn(&held.w_in, sum.dt_s, &(self.c_nb * u))
                }
                Gather::Navigation => force_n,
            };
            self.velocity_step(&mut next, &sum, &force_n, &held)?;
        }
        self.solution = next;
        self.held.get_or_insert(held);
        self.previous = Some(*delta);
        Ok(())
    }

    fn strap(&self, delta: &ImuDelta, previous: Option<&ImuDelta>) -> Strap {
        Strap::compensated(delta, previous, self.coning)
    }

    /// Earth quantities for the slow interval of `slow_s` that begins at a solution.
    fn hold(&self, at: &Solution, slow_s: f64) -> Held {
        let Solution { position, v_n, .. } = *at;
        let start = Point::new(&self.earth, position.lat_rad, position.height_m);
        let v = v_n + 0.5 * (v_n - self.v_before);
        let point = Point::new(
            &self.earth,
            position.lat_rad + 0.5 * slow_s * v.x / start.scales().0,
            position.height_m - 0.5 * slow_s * v.z,
        );
        let gravity = self.earth.gravity;
        let g_n = self.earth.ellipsoid.gravity_n(gravity, point.sin_lat, point.cos_lat, point.height_m);
        let w_en = point.transport_rate(&v);
        Held { point, g_n, w_en, w_in: point.w_ie_n + w_en }
    }

    /// Velocity over the gathered increments, and the position when it is due.
    fn velocity_step(
        &mut self,
        next: &mut Solution,
        sum: &ImuDelta,
        force_n: &Vector3<f64>,
        held: &Held,
    ) -> Result<(), Error> {
        let (dt, v) = (sum.dt_s, next.v_n);
        let acceleration = |v: &Vector3<f64>| held.g_n - (2.0 * held.point.w_ie_n + held.w_en).cross(v);
        let v_half = v + 0.5 * (force_n + dt * acceleration(&v));
        next.v_n = v + force_n + dt * acceleration(&v_half);
        let travelled = self.travelled + 0.5 * dt * (v + next.v_n);
        let due = self.steps + 1 >= self.divisors.position;
        if due {
            let (m, n) = held.point.scales();
            let Lla { lat_rad, lon_rad, height_m } = next.position;
            next.position = Lla {
                lat_rad: lat_rad + travelled.x / m,
                lon_rad: wrap_pi(lon_rad + travelled.y / (n * held.point.cos_lat)),
                height_m: height_m - travelled.z,
            };
        }
        Ned::check(&next.position, &next.v_n, &next.q_nb)?;
        if due {
            self.held = Some(self.hold(next, dt * f64::from(self.divisors.position)));
            self.v_before = next.v_n;
        }
        self.travelled = if due { Vector3::zeros() } else { travelled };
        self.steps = if due { 0 } else { self.steps + 1 };
        self.c_nb = attitude::dcm(&next.q_nb);
        (self.samples, self.sum, self.previous_sum) = (0, NOTHING, Some(*sum));
        self.force_n = Vector3::zeros();
        Ok(())
    }
}
