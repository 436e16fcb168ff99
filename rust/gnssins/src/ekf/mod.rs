//! Error-state Kalman filter over any navigation model and any list of blocks.

mod judge;
mod propagate;
mod save;
mod settings;
#[cfg(feature = "monte-carlo")]
mod shared;
mod update;

use settings::Kept;
pub use settings::{Floor, Gate, Initial, Integrity, Settings, SolutionSd};
#[cfg(feature = "monte-carlo")]
pub use shared::Gain;

use nalgebra::{Matrix3, Vector3};
use propagate::{Advance, Close, Open};

use crate::attitude;
use crate::blocks::Block;
use crate::cov::Covariance;
use crate::discretise::{BlockStep, ImuNoise, Transition};
use crate::error::Error;
use crate::imu::{Calibration, ImuDelta, Rates, Strap};
use crate::layout::Layout;
use crate::meas::{BadReason, Measurement, Record, Rows, SOURCES, Status, View};
use crate::nav::kinematics::AttitudeForm;
use crate::nav::{DP, DV, Dynamics, Matrix9, NAV, NavModel, PHI, Solution, Vector9, from_ned_errors};
use crate::simd::{self, Isa};
use crate::small::ROWS_MAX;

/// Nanoseconds per second.
const NS: f64 = 1e9;

/// Closed-loop error-state Kalman filter with up to `CAP` states (a multiple of 8).
///
/// The error estimate is fed back after every measurement, so between measurements it is zero and only the
/// covariance is carried; with [`Settings::feedback_ns`] it is carried beside the state until its time has come. No
/// heap, no panic.
#[derive(Debug, Clone)]
pub struct Ekf<M, const CAP: usize> {
    model: M,
    layout: Layout<CAP>,
    settings: Kept,
    gates: [[f64; ROWS_MAX + 1]; SOURCES],
    /// Lower bounds of the variances, where there are any.
    floor: Option<[f64; CAP]>,
    /// Whether a change of constellation adds to any variance.
    jumps: bool,
    spatial: bool,
    isa: Isa,
    t_ns: i64,
    params: [f64; CAP],
    /// Error estimate that is not yet fed back, and the time of the last feedback.
    waiting: Option<[f64; CAP]>,
    fed_back_ns: i64,
    /// The estimate after the last measurement of the receiver's position.
    accepted: Option<(i64, Solution)>,
    cov: Covariance<CAP>,
    sensors: [Calibration; 2],
    block_step: BlockStep<CAP>,
    /// Intervals that the covariance has not been through.
    open: Open,
    previous: Option<ImuDelta>,
    w_ib_b: Vector3<f64>,
}

impl<M: NavModel, const CAP: usize> Ekf<M, CAP> {
    /// A filter at its start.
    ///
    /// # Errors
    /// [`Error::Config`] or [`Error::Capacity`] for settings, blocks or initial sigmas that make no filter, and
    /// what [`NavModel::new`] refuses.
    pub fn new(settings: &Settings, blocks: &[Block], initial: &Initial) -> Result<Self, Error> {
        settings.check()?;
        let layout = Layout::new(blocks)?;
        let model = M::new(settings.earth, &initial.solution)?;
        let cov = initial_covariance(&layout, blocks, &model, initial)?;
        let mut params = [0.0; CAP];
        for (block, (kind, start)) in blocks.iter().zip(layout.blocks()) {
            for (p, v) in params.iter_mut().skip(start).zip(block.initial.iter().take(kind.len())) {
                *p = *v;
            }
        }
        let block_step = BlockStep::new(&layout, 0.0, 0.0);
        let mut ekf = Self {
            model,
            layout,
            settings: settings.into(),
            gates: settings.gates(),
            floor: floor(&layout, blocks, &settings.floor),
            jumps: layout.jumps(),
            spatial: layout.is_spatial(),
            isa: Isa::detect(),
            t_ns: initial.t_ns,
            params,
            waiting: None,
            fed_back_ns: initial.t_ns,
            accepted: None,
            cov,
            sensors: [Calibration::default(); 2],
            block_step,
            open: Open::NONE,
            previous: None,
            w_ib_b: Vector3::zeros(),
        };
        ekf.refresh_sensors()?;
        ekf.cov.check(ekf.t_ns)?;
        Ok(ekf)
    }

    /// Chooses how the attitude is integrated and corrected; the exact form is the default.
    ///
    /// # Errors
    /// What [`NavModel::set_attitude_form`] refuses.
    pub fn set_attitude_form(&mut self, form: AttitudeForm) -> Result<(), Error> {
        self.model.set_attitude_form(form)
    }

    /// Runs the kernels of this filter on a given set of instructions; the widest of the machine is the default, and what it
    /// lacks falls back.
    pub fn set_isa(&mut self, isa: Isa) {
        self.isa = isa.available();
    }

    /// Time of the state, ns.
    #[must_use]
    pub const fn t_ns(&self) -> i64 {
        self.t_ns
    }

    /// Position, velocity and attitude.
    #[must_use]
    pub fn solution(&self) -> Solution {
        match &self.waiting {
            None => self.model.solution(),
            Some(x) => {
                let mut model = self.model.clone();
                model.correct(&navigation(x));
                model.solution()
            }
        }
    }

    /// Block parameters by state index; the first nine are zero.
    #[must_use]
    pub fn params(&self) -> [f64; CAP] {
        let mut params = self.params;
        if let Some(x) = &self.waiting {
            for (p, x) in params.iter_mut().zip(x).skip(NAV) {
                *p += x;
            }
        }
        params
    }

    /// Where the blocks are.
    #[must_use]
    pub const fn layout(&self) -> &Layout<CAP> {
        &self.layout
    }

    /// Navigation state, without an error estimate that is not yet fed back.
    #[must_use]
    pub const fn model(&self) -> &M {
        &self.model
    }

    /// Covariance of the error states in the model's own axes.
    #[must_use]
    pub const fn covariance(&self) -> &Covariance<CAP> {
        &self.cov
    }

    /// IMU to antenna with the estimated correction, m, body axes.
    #[must_use]
    pub fn lever_b_m(&self) -> Vector3<f64> {
        self.settings.lever_b_m + self.layout.lever_arm(&self.params())
    }

    /// Propagates to `t_ns` with measured increments (rad, m/s) over the whole interval since the last time.
    ///
    /// # Errors
    /// [`Error::TimeBackwards`] unless `t_ns` lies after the filter's time; what [`NavModel::step`] refuses.
    pub fn predict(&mut self, t_ns: i64, dtheta: &Vector3<f64>, dvel: &Vector3<f64>) -> Result<(), Error> {
        self.predict_with(t_ns, dtheta, dvel, &ImuNoise::NONE, &mut |_| {})
    }

    /// As [`Ekf::predict`], with noise densities added for this interval; shows its transition to `seen`.
    pub(crate) fn predict_with(
        &mut self,
        t_ns: i64,
        dtheta: &Vector3<f64>,
        dvel: &Vector3<f64>,
        extra: &ImuNoise,
        seen: &mut impl FnMut(&Transition<CAP>),
    ) -> Result<(), Error> {
        let dt_s = self.interval_s(t_ns)?;
        let delta = ImuDelta {
            dt_s,
            dtheta: self.sensors[0].increment(dtheta, dt_s),
            dvel: self.sensors[1].increment(dvel, dt_s),
        };
        let strap = Strap::compensated(&delta, self.previous.as_ref(), self.settings.coning);
        self.advance(t_ns, &strap, &delta, extra, seen)?;
        self.previous = Some(delta);
        self.w_ib_b = delta.dtheta / dt_s;
        Ok(())
    }

    /// Propagates to `t_ns` with measured rates (rad/s, m/s²) at both ends of the interval, linear in between.
    ///
    /// # Errors
    /// As [`Ekf::predict`].
    pub fn predict_rates(&mut self, t_ns: i64, start: &Rates, end: &Rates) -> Result<(), Error> {
        self.predict_rates_with(t_ns, start, end, &ImuNoise::NONE, &mut |_| {})
    }

    /// As [`Ekf::predict_rates`], with noise densities added for this interval; shows its transition to `seen`.
    pub(crate) fn predict_rates_with(
        &mut self,
        t_ns: i64,
        start: &Rates,
        end: &Rates,
        extra: &ImuNoise,
        seen: &mut impl FnMut(&Transition<CAP>),
    ) -> Result<(), Error> {
        let dt_s = self.interval_s(t_ns)?;
        let correct =
            |r: &Rates| Rates { gyro: self.sensors[0].rate(&r.gyro), accel: self.sensors[1].rate(&r.accel) };
        let (start, end) = (correct(start), correct(end));
        let mean = start.towards(&end, 0.5);
        let delta = ImuDelta { dt_s, dtheta: mean.gyro * dt_s, dvel: mean.accel * dt_s };
        self.advance(t_ns, &Strap::from_rates(&start, &end, dt_s), &delta, extra, seen)?;
        self.w_ib_b = end.gyro;
        Ok(())
    }

    /// Forgets the previous increment: the next interval gets no coning term from across a gap.
    pub fn break_increments(&mut self) {
        self.previous = None;
    }

    fn interval_s(&self, t_ns: i64) -> Result<f64, Error> {
        match t_ns.checked_sub(self.t_ns) {
            Some(dt) if dt > 0 => Ok(dt as f64 / NS),
            _ => Err(Error::TimeBackwards { row: 0, t_ns, previous_ns: self.t_ns }),
        }
    }

    fn advance(
        &mut self,
        t_ns: i64,
        strap: &Strap,
        delta: &ImuDelta,
        extra: &ImuNoise,
        seen: &mut impl FnMut(&Transition<CAP>),
    ) -> Result<(), Error> {
        if self.settings.covariance_every == 1 {
            simd::run(self.isa, Advance { ekf: self, strap, delta, extra, seen })
        } else {
            self.gather(strap, delta, extra)
        }
        .map_err(|e| at_time(e, t_ns))?;
        // an estimate that waits must be carried to the time of the state that it belongs to
        if self.open.steps >= self.settings.covariance_every || self.waiting.is_some() {
            self.close(seen)?;
        }
        let second = |t: i64| t.div_euclid(1_000_000_000);
        let new_second = second(t_ns) != second(self.t_ns);
        self.t_ns = t_ns;
        if new_second { self.check() } else { Ok(()) }
    }

    /// Brings the covariance to the filter's time where [`Settings::covariance_every`] has left it behind; shows the
    /// transition to `seen`.
    pub(crate) fn close(&mut self, seen: &mut impl FnMut(&Transition<CAP>)) -> Result<(), Error> {
        if self.open.steps == 0 {
            return Ok(());
        }
        simd::run(self.isa, Close { ekf: self, seen })
    }

    /// Health of the covariance, looked at once per second; after a measurement only its diagonal is.
    fn check(&self) -> Result<(), Error> {
        self.cov.check_on(self.isa, self.t_ns)?;
        self.check_position()
    }

    /// Whether the position is still one.
    fn check_position(&self) -> Result<(), Error> {
        let sd_m = (DP..DP + 3).map(|i| crate::math::sqrt(self.cov.get(i, i))).fold(0.0, f64::max);
        if sd_m > UNKNOWN_M { Err(Error::Unbounded { t_ns: self.t_ns, sd_m }) } else { Ok(()) }
    }

    /// The calibration that the block parameters stand for.
    #[inline(always)]
    fn refresh_sensors(&mut self) -> Result<(), Error> {
        let [gyro, accel] = self.layout.sensor_errors(&self.params);
        self.sensors[0].set(gyro.bias, gyro.matrix)?;
        self.sensors[1].set(accel.bias, accel.matrix)
    }

    /// Fuses a measurement that is valid at the filter's time: tests on the prior, then scalar updates of the
    /// whitened rows, then feedback. The record tells what became of it.
    ///
    /// # Errors
    /// [`Error::Covariance`] when the covariance is no longer positive definite: the filter must not be used on.
    /// [`Error::Future`] for a measurement that is valid after the filter's time.
    pub fn update(&mut self, row: u64, measurement: &impl Measurement) -> Result<Record, Error> {
        self.update_with(row, measurement, measurement.new_constellation(), &mut |_, _| {})
    }

    /// As [`Ekf::update`], with the jump of a new constellation or without; shows the model and the linearised rows to
    /// `seen`.
    pub(crate) fn update_with(
        &mut self,
        row: u64,
        measurement: &impl Measurement,
        jumps: bool,
        seen: &mut impl FnMut(&M, &Rows<CAP>),
    ) -> Result<Record, Error> {
        let (t_ns, source) = (measurement.t_ns(), measurement.source());
        if t_ns < self.t_ns {
            return Ok(Record::unevaluated(source, row, t_ns, Status::Late));
        }
        if t_ns > self.t_ns {
            return Err(Error::Future { t_ns, filter_ns: self.t_ns });
        }
        self.close(&mut |_| {})?;
        if self.jumps && jumps {
            for (i, state) in self.layout.states() {
                self.cov.add_variance(i, state.jump);
            }
        }
        let bad = |reason| Ok(Record::unevaluated(source, row, t_ns, Status::Bad(reason)));
        let view = View {
            model: &self.model,
            layout: &self.layout,
            params: &self.params,
            lever_b_m: self.settings.lever_b_m + self.layout.lever_arm(&self.params),
            w_ib_b: self.w_ib_b,
        };
        let mut rows = match measurement.rows(&view) {
            Ok(rows) => rows,
            Err(reason) => return bad(reason),
        };
        if rows.len > ROWS_MAX || rows.component.iter().any(|c| *c >= ROWS_MAX) {
            return bad(BadReason::Value);
        }
        seen(&self.model, &rows);
        if let Some(x) = &self.waiting {
            for (y, h) in rows.y.iter_mut().zip(&rows.h).take(rows.len) {
                *y -= h.iter().zip(x).map(|(h, x)| h * x).sum::<f64>();
            }
        }
        let mut record = match self.evaluate(source, row, &rows)? {
            Ok(record) => record,
            Err(reason) => return bad(reason),
        };
        self.judge(&rows, &mut record);
        if record.status == Status::Rejected {
            return Ok(record);
        }
        if record.refused != 0 {
            rows = rows.without(record.refused);
        }
        self.fuse(&rows)?;
        if record.position_used() {
            self.accepted = Some((self.t_ns, self.solution()));
        }
        Ok(record)
    }

    /// Multiplies the covariance: the declared remedy where the filter was found overconfident by this factor (of
    /// variance). Attitude sigmas grow to 1 rad at most, those of block states to what they were at the start or, of
    /// Gauss-Markov processes, are in the long run. Factors below 1 and non-finite ones do nothing.
    pub fn raise_covariance(&mut self, factor: f64) {
        if !factor.is_finite() || factor <= 1.0 {
            return;
        }
        let root = crate::math::sqrt(factor);
        for i in 0..NAV {
            let sd = crate::math::sqrt(self.cov.get(i, i));
            let limit = if i < DV { (1.0 / sd).max(1.0) } else { f64::INFINITY };
            self.cov.scale_state(i, root.min(limit));
        }
        for (i, state) in self.layout.states() {
            let sd = crate::math::sqrt(self.cov.get(i, i));
            self.cov.scale_state(i, root.min((state.most_sd() / sd).max(1.0)));
        }
    }

    /// Takes up the fixes that were refused too often: raises the covariance and forgets the accepted estimate that the
    /// tolerance test starts from.
    pub(crate) fn reacquire(&mut self, factor: f64) {
        self.raise_covariance(factor);
        self.accepted = None;
    }

    /// Body rate (rad/s) as measured at the present time, before the first interval: velocity aids with a lever arm
    /// need it.
    pub(crate) fn set_body_rate(&mut self, gyro: &Vector3<f64>) {
        self.w_ib_b = self.sensors[0].rate(gyro);
    }

    /// Lower bounds along north, east, down where the model has other axes: what is missing there is added, turned by
    /// `inverse` into the model's axes.
    fn raise_ned(&mut self, floor: &[f64; CAP], inverse: &Matrix9) {
        let ned = self.ned_navigation_covariance();
        let missing = Vector9::from_fn(|i, _| (floor[i] - ned[(i, i)]).max(0.0));
        if missing.iter().any(|v| *v > 0.0) {
            let added = inverse * Matrix9::from_diagonal(&missing) * inverse.transpose();
            for i in 0..NAV {
                for j in 0..=i {
                    self.cov.set(i, j, self.cov.get(i, j) + added[(i, j)]);
                }
            }
        }
        let mut blocks = *floor;
        blocks[..NAV].fill(0.0);
        self.cov.raise_to(&blocks);
    }

    /// Covariance of the navigation errors along north, east, down.
    #[must_use]
    pub fn ned_navigation_covariance(&self) -> Matrix9 {
        let p = Matrix9::from_fn(|i, j| self.cov.get(i, j));
        match self.model.to_ned_errors() {
            Some(t) => t * p * t.transpose(),
            None => p,
        }
    }

    /// Element (i, j) of the covariance with the navigation errors along north, east, down, for all states.
    #[must_use]
    pub fn ned_covariance(&self) -> [[f64; CAP]; CAP] {
        let mut p = *self.cov.rows();
        if let Some(t) = self.model.to_ned_errors() {
            let nav = self.ned_navigation_covariance();
            for j in NAV..self.layout.len() {
                let column = t * Vector9::from_fn(|i, _| self.cov.get(i, j));
                for i in 0..NAV {
                    p[i][j] = column[i];
                    p[j][i] = column[i];
                }
            }
            for i in 0..NAV {
                for j in 0..NAV {
                    p[i][j] = nav[(i, j)];
                }
            }
        }
        p
    }

    /// Standard deviations of position, velocity and Euler angles.
    #[must_use]
    pub fn solution_sd(&self) -> SolutionSd {
        let p = self.ned_navigation_covariance();
        let (_, pitch, heading) = attitude::to_euler(&self.solution().q_nb);
        // an attitude error phi turns the estimate by the rotation vector -phi
        let j = attitude::euler_jacobian(pitch, heading);
        let euler = j * p.fixed_view::<3, 3>(PHI, PHI) * j.transpose();
        let sd = |m: &Matrix3<f64>| m.diagonal().map(|v| crate::math::sqrt(v.max(0.0)));
        SolutionSd {
            position_m: sd(&p.fixed_view::<3, 3>(DP, DP).into()),
            velocity_m_s: sd(&p.fixed_view::<3, 3>(DV, DV).into()),
            euler_rad: sd(&euler),
        }
    }

    /// Error dynamics at the present state under the specific force `f_b` (m/s²).
    #[must_use]
    pub fn dynamics(&self, f_b: &Vector3<f64>) -> Dynamics {
        self.model.dynamics(f_b)
    }
}

/// Position sigma at which a solution is none, m: far below where the covariance loses its digits.
const UNKNOWN_M: f64 = 1e6;

/// The navigation errors of an error vector.
fn navigation<const CAP: usize>(x: &[f64; CAP]) -> Vector9 {
    Vector9::from_iterator(x.iter().take(NAV).copied())
}

/// Lower bounds of all variances, or `None` when there are none.
fn floor<const CAP: usize>(layout: &Layout<CAP>, blocks: &[Block], nav: &Floor) -> Option<[f64; CAP]> {
    let mut floor = [0.0; CAP];
    for (start, sd) in [(PHI, &nav.phi), (DV, &nav.v), (DP, &nav.p)] {
        for i in 0..3 {
            floor[start + i] = sd[i] * sd[i];
        }
    }
    for (block, (kind, start)) in blocks.iter().zip(layout.blocks()) {
        for (f, sd) in floor.iter_mut().skip(start).zip(block.floor_sd.iter().take(kind.len())) {
            *f = sd * sd;
        }
    }
    floor.iter().any(|v| *v > 0.0).then_some(floor)
}

fn at_time(error: Error, t_ns: i64) -> Error {
    match error {
        Error::NonFinite { what, .. } => Error::NonFinite { what, t_ns },
        other => other,
    }
}

/// P0: diagonal along north, east, down and in the blocks, turned into the model's axes.
fn initial_covariance<M: NavModel, const CAP: usize>(
    layout: &Layout<CAP>,
    blocks: &[Block],
    model: &M,
    initial: &Initial,
) -> Result<Covariance<CAP>, Error> {
    let mut variances = [0.0; CAP];
    let parts = [
        ("initial attitude sigma", PHI, &initial.sd_phi),
        ("initial velocity sigma", DV, &initial.sd_v),
        ("initial position sigma", DP, &initial.sd_p),
    ];
    for (what, start, sd) in parts {
        for (i, &got) in sd.iter().enumerate() {
            if !(got.is_finite() && got > 0.0) {
                return Err(Error::Config { what, need: "must be finite and greater than 0", got });
            }
            variances[start + i] = got * got;
        }
    }
    for (block, (kind, start)) in blocks.iter().zip(layout.blocks()) {
        for (v, sd) in variances.iter_mut().skip(start).zip(block.initial_sd.iter().take(kind.len())) {
            *v = sd * sd;
        }
    }
    let mut cov = Covariance::from_variances(&variances, layout.len());
    if let Some(inverse) = model.to_ned_errors().map(|t| from_ned_errors(&t)) {
        let p = inverse
            * Matrix9::from_diagonal(&Vector9::from_iterator(variances.iter().take(NAV).copied()))
            * inverse.transpose();
        for i in 0..NAV {
            for j in 0..=i {
                cov.set(i, j, p[(i, j)]);
            }
        }
    }
    Ok(cov)
}
