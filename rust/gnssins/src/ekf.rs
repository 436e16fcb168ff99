//! Error-state Kalman filter over any navigation model and any list of blocks.

use nalgebra::{Matrix3, Vector3};

use crate::attitude::{self, skew};
use crate::blocks::Block;
use crate::bytes::{Reader, Writer};
use crate::cov::Covariance;
use crate::discretise::{BlockStep, ImuNoise, Order, Transition};
use crate::error::Error;
use crate::imu::{Calibration, Coning, ImuDelta, Rates, Strap};
use crate::layout::Layout;
use crate::meas::{BadReason, Measurement, Record, Rows, Status, View};
use crate::nav::kinematics::AttitudeForm;
use crate::nav::{DP, DV, Dynamics, EarthModel, Matrix9, NAV, NavModel, PHI, Solution, Vector9};
use crate::small::{self, ROWS_MAX};

/// Nanoseconds per second.
const NS: f64 = 1e9;

/// What a filter is tuned with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Ellipsoid and gravity.
    pub earth: EarthModel,
    /// White noise of the inertial sensors.
    pub noise: ImuNoise,
    /// Order of the transition matrix.
    pub order: Order,
    /// Coning and sculling compensation of increments.
    pub coning: Coning,
    /// IMU to GNSS antenna, m, body axes.
    pub lever_b_m: Vector3<f64>,
    /// Probability with which a good measurement passes the joint gate, or no gate.
    pub gate_probability: Option<f64>,
}

impl Settings {
    fn check(&self) -> Result<(), Error> {
        let psd = [
            ("imu.gyro noise density", &self.noise.gyro_psd),
            ("imu.accel noise density", &self.noise.accel_psd),
        ];
        for (what, values) in psd {
            if let Some(&got) = values.iter().find(|v| !(v.is_finite() && **v >= 0.0)) {
                return Err(Error::Config { what, need: "must be finite and at least 0", got });
            }
        }
        if let Some(&got) = self.lever_b_m.iter().find(|v| !v.is_finite()) {
            return Err(Error::Config { what: "gnss.lever_ba_b_m", need: "must be finite", got });
        }
        match self.gate_probability {
            Some(p) if !(p > 0.0 && p < 1.0) => Err(Error::Config {
                what: "gnss.gate_probability",
                need: "must lie between 0 and 1, ends excluded",
                got: p,
            }),
            _ => Ok(()),
        }
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

/// Closed-loop error-state Kalman filter with up to `CAP` states (a multiple of 8).
///
/// The error estimate is fed back after every measurement, so between measurements it is zero and only the
/// covariance is carried. No heap, no panic.
#[derive(Debug, Clone)]
pub struct Ekf<M, const CAP: usize> {
    model: M,
    layout: Layout<CAP>,
    settings: Settings,
    gates: [f64; ROWS_MAX + 1],
    t_ns: i64,
    params: [f64; CAP],
    cov: Covariance<CAP>,
    sensors: [Calibration; 2],
    block_step: BlockStep<CAP>,
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
        let cov = initial_covariance(&layout, &model, initial)?;
        let mut params = [0.0; CAP];
        for (block, start) in layout.blocks() {
            let len = block.kind.len();
            params[start..start + len].copy_from_slice(&block.initial[..len]);
        }
        let gates = core::array::from_fn(|dof| match settings.gate_probability {
            Some(p) if dof > 0 => small::chi_square_quantile(dof, p),
            _ => f64::INFINITY,
        });
        let block_step = BlockStep::new(&layout, 0.0);
        let mut ekf = Self {
            model,
            layout,
            settings: *settings,
            gates,
            t_ns: initial.t_ns,
            params,
            cov,
            sensors: [Calibration::default(); 2],
            block_step,
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

    /// Time of the state, ns.
    #[must_use]
    pub const fn t_ns(&self) -> i64 {
        self.t_ns
    }

    /// Position, velocity and attitude.
    #[must_use]
    pub fn solution(&self) -> Solution {
        self.model.solution()
    }

    /// Block parameters by state index; the first nine are zero.
    #[must_use]
    pub const fn params(&self) -> &[f64; CAP] {
        &self.params
    }

    /// Where the blocks are.
    #[must_use]
    pub const fn layout(&self) -> &Layout<CAP> {
        &self.layout
    }

    /// Navigation state.
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
        self.settings.lever_b_m + self.layout.lever_arm(&self.params)
    }

    /// Propagates to `t_ns` with measured increments (rad, m/s) over the whole interval since the last time.
    ///
    /// # Errors
    /// [`Error::TimeBackwards`] unless `t_ns` lies after the filter's time; what [`NavModel::step`] refuses.
    pub fn predict(&mut self, t_ns: i64, dtheta: &Vector3<f64>, dvel: &Vector3<f64>) -> Result<(), Error> {
        self.predict_with(t_ns, dtheta, dvel, &NO_NOISE)
    }

    /// As [`Ekf::predict`], with noise densities added for this interval.
    pub(crate) fn predict_with(
        &mut self,
        t_ns: i64,
        dtheta: &Vector3<f64>,
        dvel: &Vector3<f64>,
        extra: &ImuNoise,
    ) -> Result<(), Error> {
        let dt_s = self.interval_s(t_ns)?;
        let delta = ImuDelta {
            dt_s,
            dtheta: self.sensors[0].increment(dtheta, dt_s),
            dvel: self.sensors[1].increment(dvel, dt_s),
        };
        let strap = Strap::compensated(&delta, self.previous.as_ref(), self.settings.coning);
        self.advance(t_ns, &strap, &delta, extra)?;
        self.previous = Some(delta);
        self.w_ib_b = delta.dtheta / dt_s;
        Ok(())
    }

    /// Propagates to `t_ns` with measured rates (rad/s, m/s²) at both ends of the interval, linear in between.
    ///
    /// # Errors
    /// As [`Ekf::predict`].
    pub fn predict_rates(&mut self, t_ns: i64, start: &Rates, end: &Rates) -> Result<(), Error> {
        self.predict_rates_with(t_ns, start, end, &NO_NOISE)
    }

    /// As [`Ekf::predict_rates`], with noise densities added for this interval.
    pub(crate) fn predict_rates_with(
        &mut self,
        t_ns: i64,
        start: &Rates,
        end: &Rates,
        extra: &ImuNoise,
    ) -> Result<(), Error> {
        let dt_s = self.interval_s(t_ns)?;
        let correct =
            |r: &Rates| Rates { gyro: self.sensors[0].rate(&r.gyro), accel: self.sensors[1].rate(&r.accel) };
        let (start, end) = (correct(start), correct(end));
        let mean = start.towards(&end, 0.5);
        let delta = ImuDelta { dt_s, dtheta: mean.gyro * dt_s, dvel: mean.accel * dt_s };
        self.advance(t_ns, &Strap::from_rates(&start, &end, dt_s), &delta, extra)?;
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

    fn advance(&mut self, t_ns: i64, strap: &Strap, delta: &ImuDelta, extra: &ImuNoise) -> Result<(), Error> {
        let dt_s = delta.dt_s;
        let dynamics = self.model.step(strap).map_err(|e| at_time(e, t_ns))?;
        let noise = ImuNoise {
            gyro_psd: self.settings.noise.gyro_psd + extra.gyro_psd,
            accel_psd: self.settings.noise.accel_psd + extra.accel_psd,
        };
        let (w_b, f_b) = (delta.dtheta / dt_s, delta.dvel / dt_s);
        self.block_step.fit(&self.layout, dt_s);
        let transition = Transition::new(
            &dynamics,
            &self.layout,
            &noise,
            &w_b,
            &f_b,
            &self.block_step,
            self.settings.order,
        );
        self.cov.predict(&transition);
        if self.block_step.decays {
            for (p, d) in self.params.iter_mut().zip(&self.block_step.diagonal) {
                *p *= d;
            }
            self.refresh_sensors()?;
        }
        let second = |t: i64| t.div_euclid(1_000_000_000);
        let new_second = second(t_ns) != second(self.t_ns);
        self.t_ns = t_ns;
        if new_second { self.check() } else { Ok(()) }
    }

    /// Health of the covariance, looked at once per second and after every measurement.
    fn check(&self) -> Result<(), Error> {
        self.cov.check(self.t_ns)?;
        let sd_m = (DP..DP + 3).map(|i| crate::math::sqrt(self.cov.get(i, i))).fold(0.0, f64::max);
        if sd_m > UNKNOWN_M { Err(Error::Unbounded { t_ns: self.t_ns, sd_m }) } else { Ok(()) }
    }

    fn refresh_sensors(&mut self) -> Result<(), Error> {
        let [gyro, accel] = self.layout.sensor_errors(&self.params);
        self.sensors =
            [Calibration::new(gyro.bias, gyro.matrix)?, Calibration::new(accel.bias, accel.matrix)?];
        Ok(())
    }

    /// Fuses a measurement that is valid at the filter's time: joint gate on the prior, then scalar updates of
    /// the whitened rows, then feedback. The record tells what became of it.
    ///
    /// # Errors
    /// [`Error::Covariance`] when the covariance is no longer positive definite: the filter must not be used on.
    /// [`Error::Future`] for a measurement that is valid after the filter's time.
    pub fn update(&mut self, row: u64, measurement: &impl Measurement) -> Result<Record, Error> {
        let t_ns = measurement.t_ns();
        if t_ns < self.t_ns {
            return Ok(Record::unevaluated(row, t_ns, Status::Late));
        }
        if t_ns > self.t_ns {
            return Err(Error::Future { t_ns, filter_ns: self.t_ns });
        }
        let view = View {
            model: &self.model,
            layout: &self.layout,
            params: &self.params,
            lever_b_m: self.lever_b_m(),
            w_ib_b: self.w_ib_b,
        };
        let rows = match measurement.rows(&view) {
            Ok(rows) => rows,
            Err(reason) => return Ok(Record::unevaluated(row, t_ns, Status::Bad(reason))),
        };
        let bad = |reason| Ok(Record::unevaluated(row, t_ns, Status::Bad(reason)));
        if rows.len > ROWS_MAX || rows.component.iter().any(|c| *c >= ROWS_MAX) {
            return bad(BadReason::Value);
        }
        let mut record = match self.evaluate(row, t_ns, &rows)? {
            Ok(record) => record,
            Err(reason) => return bad(reason),
        };
        if record.nis > self.gates[rows.len] {
            record.status = Status::Rejected;
            return Ok(record);
        }
        self.fuse(rows)?;
        Ok(record)
    }

    /// Multiplies the covariance: the declared remedy where the filter was found overconfident by this factor (of
    /// variance). Attitude sigmas grow to 1 rad at most. Factors below 1 and non-finite ones do nothing.
    pub fn raise_covariance(&mut self, factor: f64) {
        if !factor.is_finite() || factor <= 1.0 {
            return;
        }
        let root = crate::math::sqrt(factor);
        for i in 0..self.layout.len() {
            let sd = crate::math::sqrt(self.cov.get(i, i));
            let limit = if i < DV { (1.0 / sd).max(1.0) } else { f64::INFINITY };
            self.cov.scale_state(i, root.min(limit));
        }
    }

    /// Body rate (rad/s) as measured at the present time, before the first interval: velocity aids with a lever arm
    /// need it.
    pub(crate) fn set_body_rate(&mut self, gyro: &Vector3<f64>) {
        self.w_ib_b = self.sensors[0].rate(gyro);
    }

    /// Innovation, its covariance and NIS on the prior.
    fn evaluate(&self, row: u64, t_ns: i64, rows: &Rows<CAP>) -> Result<Result<Record, BadReason>, Error> {
        let mut record = Record::unevaluated(row, t_ns, Status::Used);
        record.dof = rows.len;
        let mut s = rows.r;
        for i in 0..rows.len {
            let ph = self.cov.times(&rows.h[i]);
            for j in 0..rows.len {
                s[i][j] += rows.h[j].iter().zip(&ph).map(|(h, p)| h * p).sum::<f64>();
            }
            if s[i][i] > PRECISION * rows.r[i][i] {
                return Ok(Err(BadReason::Covariance));
            }
        }
        let Some(l) = small::cholesky(&s, rows.len) else {
            self.cov.check(self.t_ns)?;
            return Ok(Err(BadReason::Covariance));
        };
        let mut white = rows.y.map(|y| [y]);
        small::forward(&l, &mut white, rows.len);
        record.nis = white.iter().take(rows.len).map(|w| w[0] * w[0]).sum();
        for i in 0..rows.len {
            let c = rows.component[i];
            record.present |= 1 << c;
            record.innovation[c] = -rows.y[i];
            for j in 0..rows.len {
                record.innovation_cov[c][rows.component[j]] = s[i][j];
            }
        }
        Ok(if record.nis.is_finite() { Ok(record) } else { Err(BadReason::Value) })
    }

    fn fuse(&mut self, mut rows: Rows<CAP>) -> Result<(), Error> {
        let bad = |pivot| Error::Covariance { t_ns: self.t_ns, state: DP, pivot };
        let l = small::cholesky(&rows.r, rows.len).ok_or(bad(rows.r[0][0]))?;
        let mut y = rows.y.map(|y| [y]);
        small::forward(&l, &mut y, rows.len);
        small::forward(&l, &mut rows.h, rows.len);
        let mut x = [0.0; CAP];
        for (h, y) in rows.h.iter().zip(&y).take(rows.len) {
            let left = y[0] - h.iter().zip(&x).map(|(h, x)| h * x).sum::<f64>();
            let gain = self.cov.update(h).ok_or(bad(f64::NAN))?;
            for (x, k) in x.iter_mut().zip(&gain) {
                *x += k * left;
            }
        }
        self.feed_back(&x)?;
        self.check()
    }

    /// Moves the error estimate into the state. The attitude error is then measured from another estimate,
    /// Exp(-phi⁺) = Exp(phi_hat) Exp(-phi), so phi⁺ = (I + [phi_hat x]/2)(phi - phi_hat): P turns with it.
    fn feed_back(&mut self, x: &[f64; CAP]) -> Result<(), Error> {
        let nav = Vector9::from_iterator(x.iter().take(NAV).copied());
        self.model.correct(&nav);
        let phi: Vector3<f64> = nav.fixed_rows::<3>(PHI).into();
        self.cov.transform3(PHI, &(Matrix3::identity() + 0.5 * skew(&phi)));
        for (p, x) in self.params.iter_mut().zip(x).skip(NAV) {
            *p += x;
        }
        self.refresh_sensors()
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
        let (_, pitch, heading) = attitude::to_euler(&self.model.solution().q_nb);
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

    /// Bytes that [`Ekf::save`] writes.
    #[must_use]
    pub const fn saved_len(&self) -> usize {
        let n = self.layout.len();
        8 * (3 + 10 + (n - NAV) + n * (n + 1) / 2 + 1 + 7 + 3)
    }

    /// Writes the state; [`Ekf::restore`] continues from it with the same bits.
    ///
    /// # Errors
    /// [`Error::SavedState`] when the buffer is shorter than [`Ekf::saved_len`].
    pub fn save(&self, out: &mut Writer<'_>) -> Result<(), Error> {
        out.u64(self.layout.len() as u64)?;
        out.u64(self.layout.fingerprint(M::NAME))?;
        out.i64(self.t_ns)?;
        out.f64s(&self.model.pack())?;
        out.f64s(&self.params[NAV..self.layout.len()])?;
        for i in 0..self.layout.len() {
            out.f64s(&self.cov.rows()[i][..=i])?;
        }
        out.u64(u64::from(self.previous.is_some()))?;
        let previous =
            self.previous.unwrap_or(ImuDelta { dt_s: 0.0, dtheta: Vector3::zeros(), dvel: Vector3::zeros() });
        out.f64s(&[previous.dt_s])?;
        out.f64s(previous.dtheta.as_slice())?;
        out.f64s(previous.dvel.as_slice())?;
        out.f64s(self.w_ib_b.as_slice())
    }

    /// Restores a state that a filter of the same model and blocks saved.
    ///
    /// # Errors
    /// [`Error::SavedState`] when the bytes belong to another model or layout or are cut short, and what
    /// [`NavModel::unpack`] refuses; the filter is then unchanged.
    pub fn restore(&mut self, saved: &mut Reader<'_>) -> Result<(), Error> {
        let mut next = self.clone();
        let n = self.layout.len();
        saved.expect("number of states", n as u64)?;
        saved.expect("model and block list", self.layout.fingerprint(M::NAME))?;
        next.t_ns = saved.i64()?;
        let mut packed = [0.0; 10];
        saved.f64s(&mut packed)?;
        next.model.unpack(&packed)?;
        saved.f64s(&mut next.params[NAV..n])?;
        for i in 0..n {
            for j in 0..=i {
                let value = saved.f64()?;
                next.cov.set(i, j, value);
            }
        }
        let some = saved.u64()? == 1;
        let (mut dt, mut v) = ([0.0; 1], [[0.0; 3]; 3]);
        saved.f64s(&mut dt)?;
        for v in &mut v {
            saved.f64s(v)?;
        }
        let [dtheta, dvel, w] = v.map(Vector3::from);
        next.previous = some.then_some(ImuDelta { dt_s: dt[0], dtheta, dvel });
        next.w_ib_b = w;
        let numbers = next.params.iter().chain(&dt).chain(v.iter().flatten());
        if !numbers.copied().all(f64::is_finite) {
            return Err(Error::NonFinite { what: "saved state", t_ns: next.t_ns });
        }
        next.refresh_sensors()?;
        next.cov.check(next.t_ns)?;
        *self = next;
        Ok(())
    }
}

/// Position sigma at which a solution is none, m: far below where the covariance loses its digits.
const UNKNOWN_M: f64 = 1e6;

/// Largest ratio of prior variance over noise variance that a full covariance in double precision can take in.
const PRECISION: f64 = 1e15;

const NO_NOISE: ImuNoise =
    ImuNoise { gyro_psd: Vector3::new(0.0, 0.0, 0.0), accel_psd: Vector3::new(0.0, 0.0, 0.0) };

fn at_time(error: Error, t_ns: i64) -> Error {
    match error {
        Error::NonFinite { what, .. } => Error::NonFinite { what, t_ns },
        other => other,
    }
}

/// P0: diagonal along north, east, down and in the blocks, turned into the model's axes.
fn initial_covariance<M: NavModel, const CAP: usize>(
    layout: &Layout<CAP>,
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
    for (block, start) in layout.blocks() {
        for (v, sd) in variances[start..].iter_mut().zip(&block.initial_sd[..block.kind.len()]) {
            *v = sd * sd;
        }
    }
    let mut cov = Covariance::from_variances(&variances, layout.len());
    if let Some(inverse) = model.to_ned_errors().and_then(|t| t.try_inverse()) {
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
