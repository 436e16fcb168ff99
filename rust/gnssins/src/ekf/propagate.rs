//! One interval: strapdown, transition and covariance in one kernel.

use nalgebra::Vector3;

use super::Ekf;
use crate::discretise::{ImuNoise, Transition};
use crate::error::Error;
use crate::imu::{ImuDelta, Strap};
use crate::math;
use crate::nav::{Motion, NavModel};
use crate::simd::{Eight, Kernel};

/// What the covariance has yet to go through: sums over intervals, of everything times their length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Open {
    pub(super) steps: u32,
    dt_s: f64,
    motion: Motion,
    dtheta: Vector3<f64>,
    dvel: Vector3<f64>,
    /// Variances that were added to those of the sensors, rad² and m²/s².
    extra: ImuNoise,
    /// Way over ground, m.
    way_m: f64,
}

impl Open {
    pub(super) const NONE: Self = Self {
        steps: 0,
        dt_s: 0.0,
        motion: Motion::ZERO,
        dtheta: Vector3::new(0.0, 0.0, 0.0),
        dvel: Vector3::new(0.0, 0.0, 0.0),
        extra: ImuNoise::NONE,
        way_m: 0.0,
    };

    /// Numbers that [`Open::pack`] gives.
    pub(super) const PACKED: usize = 42;

    /// The numbers that make it up, for saving bit by bit.
    pub(super) fn pack(&self) -> [f64; Self::PACKED] {
        let Motion { place, v, f, c, gravity } = &self.motion;
        let ImuNoise { gyro_psd, accel_psd } = &self.extra;
        let scalars = [f64::from(self.steps), self.dt_s, self.way_m];
        let vectors = [place, v, f, &self.dtheta, &self.dvel, gyro_psd, accel_psd];
        let mut packed = [0.0; Self::PACKED];
        let numbers = scalars
            .iter()
            .chain(vectors.into_iter().flat_map(|v| v.iter()))
            .chain(c.iter())
            .chain(gravity.iter());
        for (p, x) in packed.iter_mut().zip(numbers) {
            *p = *x;
        }
        packed
    }

    /// What [`Open::pack`] gave.
    pub(super) fn unpack(packed: &[f64; Self::PACKED]) -> Self {
        let mut open = Self::NONE;
        open.steps = packed[0] as u32;
        (open.dt_s, open.way_m) = (packed[1], packed[2]);
        let Motion { place, v, f, c, gravity } = &mut open.motion;
        let ImuNoise { gyro_psd, accel_psd } = &mut open.extra;
        let vectors = [place, v, f, &mut open.dtheta, &mut open.dvel, gyro_psd, accel_psd];
        let numbers =
            vectors.into_iter().flat_map(|v| v.iter_mut()).chain(c.iter_mut()).chain(gravity.iter_mut());
        for (x, p) in numbers.zip(&packed[3..]) {
            *x = *p;
        }
        open
    }

    /// One more interval.
    fn add(&mut self, motion: &Motion, delta: &ImuDelta, extra: &ImuNoise, speed_m_s: f64) {
        let dt_s = delta.dt_s;
        self.steps += 1;
        self.dt_s += dt_s;
        self.motion = self.motion.plus(motion, dt_s);
        self.dtheta += delta.dtheta;
        self.dvel += delta.dvel;
        self.extra.gyro_psd += dt_s * extra.gyro_psd;
        self.extra.accel_psd += dt_s * extra.accel_psd;
        self.way_m += speed_m_s * dt_s;
    }
}

impl<M: NavModel, const CAP: usize> Ekf<M, CAP> {
    /// The strapdown step of an interval, which then waits for the covariance.
    pub(super) fn gather(&mut self, strap: &Strap, delta: &ImuDelta, extra: &ImuNoise) -> Result<(), Error> {
        let motion = self.model.advance(strap)?;
        let speed_m_s = self.speed_m_s();
        self.open.add(&motion, delta, extra, speed_m_s);
        Ok(())
    }

    /// Ground speed where errors are correlated over the way, 0 elsewhere.
    #[inline(always)]
    pub(super) fn speed_m_s(&self) -> f64 {
        if !self.spatial {
            return 0.0;
        }
        let v_n = self.model.solution().v_n;
        math::hypot(v_n.x, v_n.y)
    }

    /// Block parameters through the interval of the block step.
    #[inline(always)]
    pub(super) fn decay(&mut self) -> Result<(), Error> {
        if !self.block_step.decays {
            return Ok(());
        }
        for (p, d) in self.params.iter_mut().zip(&self.block_step.diagonal) {
            *p *= d;
        }
        self.refresh_sensors()
    }
}

/// The strapdown step of an interval and the covariance through it.
pub(super) struct Advance<'a, M, const CAP: usize, S> {
    pub(super) ekf: &'a mut Ekf<M, CAP>,
    pub(super) strap: &'a Strap,
    pub(super) delta: &'a ImuDelta,
    pub(super) extra: &'a ImuNoise,
    pub(super) seen: &'a mut S,
}

impl<M: NavModel, const CAP: usize, S: FnMut(&Transition<CAP>)> Kernel for Advance<'_, M, CAP, S> {
    type Output = Result<(), Error>;

    #[inline(always)]
    fn run<E: Eight>(self) -> Result<(), Error> {
        let Self { ekf, strap, delta, extra, seen } = self;
        let motion = ekf.model.advance(strap)?;
        let speed_m_s = ekf.speed_m_s();
        let per_s = 1.0 / delta.dt_s;
        let (w_b, f_b) = (delta.dtheta * per_s, delta.dvel * per_s);
        through::<E, M, CAP>(ekf, &motion, &w_b, &f_b, extra, delta.dt_s, speed_m_s, seen)
    }
}

/// One transition through all intervals that are open, with the means over them.
pub(super) struct Close<'a, M, const CAP: usize, S> {
    pub(super) ekf: &'a mut Ekf<M, CAP>,
    pub(super) seen: &'a mut S,
}

impl<M: NavModel, const CAP: usize, S: FnMut(&Transition<CAP>)> Kernel for Close<'_, M, CAP, S> {
    type Output = Result<(), Error>;

    #[inline(always)]
    fn run<E: Eight>(self) -> Result<(), Error> {
        let Self { ekf, seen } = self;
        let open = core::mem::replace(&mut ekf.open, Open::NONE);
        let per_s = 1.0 / open.dt_s;
        let motion = Motion::ZERO.plus(&open.motion, per_s);
        let (w_b, f_b) = (open.dtheta * per_s, open.dvel * per_s);
        let extra =
            ImuNoise { gyro_psd: per_s * open.extra.gyro_psd, accel_psd: per_s * open.extra.accel_psd };
        through::<E, M, CAP>(ekf, &motion, &w_b, &f_b, &extra, open.dt_s, open.way_m * per_s, seen)
    }
}

/// Covariance, waiting estimate and block parameters through an interval.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "the means of one interval")]
fn through<E: Eight, M: NavModel, const CAP: usize>(
    ekf: &mut Ekf<M, CAP>,
    motion: &Motion,
    w_b: &Vector3<f64>,
    f_b: &Vector3<f64>,
    extra: &ImuNoise,
    dt_s: f64,
    speed_m_s: f64,
    seen: &mut impl FnMut(&Transition<CAP>),
) -> Result<(), Error> {
    ekf.block_step.fit(&ekf.layout, dt_s, speed_m_s);
    ekf.cov.add_half_noise(&ekf.block_step);
    let noise = ImuNoise {
        gyro_psd: ekf.settings.noise.gyro_psd + extra.gyro_psd,
        accel_psd: ekf.settings.noise.accel_psd + extra.accel_psd,
    };
    let dynamics = ekf.model.linearise(motion);
    let transition =
        Transition::of::<E>(&dynamics, &ekf.layout, &noise, w_b, f_b, &ekf.block_step, ekf.settings.order);
    ekf.cov.predict_kernel::<E>(&transition);
    if let Some(x) = &mut ekf.waiting {
        transition.carry(x);
    }
    seen(&transition);
    ekf.decay()
}
