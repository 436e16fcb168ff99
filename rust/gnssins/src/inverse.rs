//! From a motion to the increments of an ideal IMU: the exact inverse of a model's strapdown step.

use nalgebra::{UnitQuaternion, Vector3};

use crate::attitude;
use crate::error::Error;
use crate::imu::{Coning, ImuDelta, Strap};
use crate::nav::{NavModel, Solution};

/// Most corrections of one step; four reach rounding at any realistic motion.
const ITERATIONS: usize = 8;
/// Correction (rad, m/s) at which rounding is reached.
const DONE: f64 = 1e-15;

/// A model with the memory that two-sample coning needs: an INS without aids, forward or inverted.
#[derive(Debug, Clone)]
pub struct FreeIns<M> {
    model: M,
    coning: Coning,
    previous: Option<ImuDelta>,
}

impl<M: NavModel> FreeIns<M> {
    /// Starts at the state of a model.
    #[must_use]
    pub const fn new(model: M, coning: Coning) -> Self {
        Self { model, coning, previous: None }
    }

    /// The model at the present time.
    #[must_use]
    pub const fn model(&self) -> &M {
        &self.model
    }

    /// Goes to another solution; the memory of the increments stays.
    ///
    /// # Errors
    /// What [`NavModel::restart`] refuses.
    pub fn restart(&mut self, solution: &Solution) -> Result<(), Error> {
        self.model.restart(solution)
    }

    /// Propagates with true increments.
    ///
    /// # Errors
    /// What [`NavModel::step`] refuses.
    pub fn step(&mut self, delta: &ImuDelta) -> Result<(), Error> {
        self.model.step(&Strap::compensated(delta, self.previous.as_ref(), self.coning))?;
        self.previous = Some(*delta);
        Ok(())
    }

    /// Finds the increments that take the model to a velocity (m/s, NED) and attitude after `dt_s`, and goes there. The
    /// position that results belongs to the motion: it is the integral of the velocity as the step forms it.
    ///
    /// # Errors
    /// What [`NavModel::step`] refuses.
    pub fn step_to(
        &mut self,
        dt_s: f64,
        v_n: &Vector3<f64>,
        q_nb: &UnitQuaternion<f64>,
    ) -> Result<ImuDelta, Error> {
        let start = self.model.solution();
        let back = attitude::dcm(&start.q_nb).transpose();
        let mut strap =
            Strap { dt_s, alpha: attitude::log(&(start.q_nb.inverse() * q_nb)), u: back * (v_n - start.v_n) };
        for _ in 0..ITERATIONS {
            let mut trial = self.model.clone();
            trial.step(&strap)?;
            let reached = trial.solution();
            let turn = attitude::log(&(reached.q_nb.inverse() * q_nb));
            let push = back * (v_n - reached.v_n);
            strap.alpha = attitude::log(&(attitude::exp(&strap.alpha) * attitude::exp(&turn)));
            strap.u += push;
            if turn.norm() < DONE && push.norm() < DONE {
                break;
            }
        }
        let delta = strap.to_increments(self.previous.as_ref(), self.coning);
        self.step(&delta)?;
        Ok(delta)
    }
}
