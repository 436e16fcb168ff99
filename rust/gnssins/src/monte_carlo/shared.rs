//! Runs with the covariance and the gains of the trajectory without errors.

use nalgebra::Vector3;

use super::plan::Plan;
use super::run::{Feeder, Row, draw, feed, filter};
use super::statistics::{Claim, Groups, Ledger, Sums};
use crate::blocks::{BLOCK_MAX, Block};
use crate::ekf::{Ekf, Gain, Integrity, SolutionSd};
use crate::error::Error;
use crate::imu::Calibration;
use crate::meas::{Measurement, Observation, SOURCES, Source};
use crate::nav::{NAV, NavModel};
use crate::stream::Counts;

/// Gains and claims along the trajectory without errors.
#[derive(Debug)]
pub(super) struct Nominal<const CAP: usize> {
    /// One per value fed, `None` for what cannot be used.
    gains: Vec<Option<Gain<CAP>>>,
    claims: Vec<Claim>,
    sds: Vec<SolutionSd>,
}

/// A filter that stops at the values of the aids within an IMU interval, as the navigator does.
trait Splitting {
    fn now_ns(&self) -> i64;
    fn predict(&mut self, t_ns: i64, dtheta: &Vector3<f64>, dvel: &Vector3<f64>) -> Result<(), Error>;
    fn update(&mut self, number: usize, aid: &Observation) -> Result<(), Error>;
}

/// Values that wait for an IMU row, and the row number of each.
#[derive(Debug, Default)]
struct Waiting {
    aids: Vec<Observation>,
    fed: usize,
    /// Calibrations of the IMU that are known beforehand; the nominal trajectory has no error to take off.
    gyro: Calibration,
    accel: Calibration,
}

impl Waiting {
    /// Takes a value; what is valid now or before goes on at once.
    fn aid(&mut self, plan: &Plan, aid: &Observation, to: &mut impl Splitting) -> Result<(), Error> {
        let latency = plan.filter.stream.latency_ns[aid.source().index()];
        let aid = aid.at(aid.t_ns().saturating_sub(latency));
        if aid.t_ns() <= to.now_ns() {
            self.fed += 1;
            return to.update(self.fed - 1, &aid);
        }
        self.aids.push(aid);
        Ok(())
    }

    fn imu(&mut self, t_ns: i64, row: &Row, to: &mut impl Splitting) -> Result<(), Error> {
        let dt_s = |to_ns: i64, from_ns: i64| (to_ns - from_ns) as f64 / 1e9;
        let whole_s = dt_s(t_ns, to.now_ns());
        let own = [self.gyro.increment(&row[0], whole_s), self.accel.increment(&row[1], whole_s)];
        let aids = core::mem::take(&mut self.aids);
        let begin = to.now_ns();
        for aid in aids {
            let part_s = dt_s(aid.t_ns(), to.now_ns());
            if part_s > 0.0 {
                let [dtheta, dvel] = if part_s == whole_s { own } else { own.map(|v| v / whole_s * part_s) };
                to.predict(aid.t_ns(), &dtheta, &dvel)?;
            }
            self.fed += 1;
            to.update(self.fed - 1, &aid)?;
        }
        if to.now_ns() == begin {
            return to.predict(t_ns, &own[0], &own[1]);
        }
        let rest_s = dt_s(t_ns, to.now_ns());
        if rest_s > 0.0 {
            let [dtheta, dvel] = own.map(|v| v / whole_s * rest_s);
            to.predict(t_ns, &dtheta, &dvel)?;
        }
        Ok(())
    }
}

/// The pass that makes the gains.
struct Making<M, const CAP: usize> {
    ekf: Ekf<M, CAP>,
    gains: Vec<Option<Gain<CAP>>>,
}

impl<M: NavModel, const CAP: usize> Splitting for Making<M, CAP> {
    fn now_ns(&self) -> i64 {
        self.ekf.t_ns()
    }

    fn predict(&mut self, t_ns: i64, dtheta: &Vector3<f64>, dvel: &Vector3<f64>) -> Result<(), Error> {
        self.ekf.predict(t_ns, dtheta, dvel)
    }

    fn update(&mut self, number: usize, aid: &Observation) -> Result<(), Error> {
        let gain = if aid.t_ns() == self.ekf.t_ns() { self.ekf.gain(aid) } else { None };
        self.gains.push(gain);
        self.ekf.update(number as u64, aid).map(|_| ())
    }
}

struct MakingFeeder<'p, M, const CAP: usize> {
    plan: &'p Plan,
    groups: &'p Groups,
    waiting: Waiting,
    making: Making<M, CAP>,
    claims: Vec<Claim>,
    sds: Vec<SolutionSd>,
}

impl<M: NavModel, const CAP: usize> Feeder for MakingFeeder<'_, M, CAP> {
    fn aid(&mut self, aid: &Observation) -> Result<(), Error> {
        self.waiting.aid(self.plan, aid, &mut self.making)
    }

    fn imu(&mut self, t_ns: i64, row: &Row) -> Result<(), Error> {
        self.waiting.imu(t_ns, row, &mut self.making)
    }

    fn compare(&mut self, k: usize, _true_errors: &[f64]) {
        let ekf = &self.making.ekf;
        let mut claim = Claim::default();
        if self.plan.epochs[k].nees {
            claim.set(self.groups, &ekf.ned_covariance(), ekf.layout().len());
        }
        self.claims.push(claim);
        self.sds.push(ekf.solution_sd());
    }
}

impl<const CAP: usize> Nominal<CAP> {
    /// Runs the filter along the truth, without sensor errors and without noise.
    pub fn new<M: NavModel>(plan: &Plan, groups: &Groups) -> Result<Self, Error> {
        let exact = plan.imu.without_errors();
        let (deviates, values) =
            (plan.deviates(0), plan.aids.exact_values(&plan.ellipsoid, plan.epochs.len()));
        let mut settings = plan.filter.settings;
        settings.gate_probability = [None; SOURCES];
        settings.integrity = Integrity::default();
        // what the filter knows of errors beforehand is none of the exact sensors
        let blocks: Vec<Block> =
            plan.filter.blocks.iter().map(|b| Block { initial: [0.0; BLOCK_MAX], ..*b }).collect();
        let mut ekf = Ekf::<M, CAP>::new(&settings, &blocks, &plan.initial)?;
        ekf.set_attitude_form(plan.filter.attitude_form)?;
        let mut to = MakingFeeder {
            plan,
            groups,
            waiting: Waiting::default(),
            making: Making { ekf, gains: vec![] },
            claims: vec![],
            sds: vec![],
        };
        feed(plan, &exact, deviates, &values, &mut to)?;
        Ok(Self { gains: to.making.gains, claims: to.claims, sds: to.sds })
    }
}

/// A run with the gains of the nominal trajectory.
struct Shared<'p, M, const CAP: usize> {
    nominal: &'p Nominal<CAP>,
    ekf: Ekf<M, CAP>,
    ledger: Ledger<'p>,
    counts: [Counts; SOURCES + 1],
}

impl<M: NavModel, const CAP: usize> Splitting for Shared<'_, M, CAP> {
    fn now_ns(&self) -> i64 {
        self.ekf.t_ns()
    }

    fn predict(&mut self, t_ns: i64, dtheta: &Vector3<f64>, dvel: &Vector3<f64>) -> Result<(), Error> {
        self.ekf.predict_state(t_ns, dtheta, dvel)
    }

    fn update(&mut self, number: usize, aid: &Observation) -> Result<(), Error> {
        let (source, t_ns) = (aid.source(), aid.t_ns());
        let counts = &mut self.counts[1 + source.index()];
        if t_ns < self.ekf.t_ns() {
            counts.late += 1;
            return Ok(());
        }
        let gain = self.nominal.gains.get(number).and_then(Option::as_ref);
        let nis = match gain {
            Some(gain) => self.ekf.update_state(aid, gain)?.map(|nis| (nis, gain.len())),
            None => None,
        };
        let Some((nis, dof)) = nis else {
            counts.bad += 1;
            return Ok(());
        };
        counts.used += 1;
        self.ledger.nis(source.index(), t_ns, dof, nis);
        if source == Source::Gnss {
            self.ledger.used(t_ns);
        }
        Ok(())
    }
}

struct SharedFeeder<'p, M, const CAP: usize> {
    plan: &'p Plan,
    waiting: Waiting,
    shared: Shared<'p, M, CAP>,
}

impl<M: NavModel, const CAP: usize> Feeder for SharedFeeder<'_, M, CAP> {
    fn aid(&mut self, aid: &Observation) -> Result<(), Error> {
        self.shared.counts[1 + aid.source().index()].total += 1;
        self.waiting.aid(self.plan, aid, &mut self.shared)
    }

    fn imu(&mut self, t_ns: i64, row: &Row) -> Result<(), Error> {
        self.shared.counts[0].total += 1;
        self.shared.counts[0].used += 1;
        self.waiting.imu(t_ns, row, &mut self.shared)
    }

    fn compare(&mut self, k: usize, true_errors: &[f64]) {
        let Shared { nominal, ekf, ledger, .. } = &mut self.shared;
        let epoch = &self.plan.epochs[k];
        let sd = ledger.wants_sd(self.plan.t_ns[epoch.row]).then_some(&nominal.sds[k]);
        let params = &ekf.params()[NAV..ekf.layout().len()];
        let claim = Some(&nominal.claims[k]);
        ledger.epoch(epoch, &ekf.solution(), params, true_errors, claim, sd);
    }
}

/// Adds a run with the covariance of the nominal trajectory.
pub(super) fn shared<M: NavModel, const CAP: usize>(
    plan: &Plan,
    groups: &Groups,
    nominal: &Nominal<CAP>,
    run: u32,
    sums: &mut Sums,
) -> Result<(), Error> {
    let (deviates, values) = draw(plan, run);
    let (initial, _) = plan.start(&deviates);
    let ekf = filter::<M, CAP>(plan, &initial)?;
    let shared = Shared { nominal, ekf, ledger: Ledger::new(plan, groups, sums), counts: Default::default() };
    let stream = &plan.filter.stream;
    let waiting = Waiting { gyro: stream.gyro, accel: stream.accel, ..Waiting::default() };
    let mut to = SharedFeeder { plan, waiting, shared };
    feed(plan, &plan.imu, deviates, &values, &mut to)?;
    let Shared { ledger, mut counts, .. } = to.shared;
    for aid in &to.waiting.aids {
        counts[1 + aid.source().index()].late += 1;
    }
    ledger.finish(&counts);
    Ok(())
}
