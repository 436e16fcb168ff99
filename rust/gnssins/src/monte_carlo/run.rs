//! One run through the streaming navigator, with its own covariance.

use nalgebra::Vector3;

use super::BLOCK;
use super::aids::AidValues;
use super::imu::{Imu, ImuRun};
use super::normal::Deviates;
use super::plan::{AID_COLUMNS, Plan};
use super::statistics::{Claim, Groups, Ledger, Sums};
use crate::ekf::{Ekf, Initial};
use crate::error::Error;
use crate::meas::{Observation, Source};
use crate::nav::{NAV, NavModel};
use crate::stream::Navigator;

/// Increments of one IMU row.
pub(super) type Row = [Vector3<f64>; 2];

/// A filter that is fed one row after the other.
pub(super) trait Feeder {
    /// Takes a value of an aid that is valid up to the next row.
    fn aid(&mut self, aid: &Observation) -> Result<(), Error>;
    /// Takes an IMU row.
    fn imu(&mut self, t_ns: i64, row: &Row) -> Result<(), Error>;
    /// Compares at epoch `k` of the plan.
    fn compare(&mut self, k: usize, true_errors: &[f64]);
}

/// Feeds the rows of a run, whose sensors are those of the plan or others.
pub(super) fn feed(
    plan: &Plan,
    sensors: &Imu,
    deviates: Deviates,
    values: &AidValues,
    to: &mut impl Feeder,
) -> Result<(), Error> {
    let mut imu = ImuRun::new(sensors, deviates);
    let mut true_errors = vec![0.0; plan.columns()];
    let (mut next, mut epoch) = (0, 0);
    for block in 0..plan.rows.div_ceil(BLOCK) {
        imu.block(block);
        let first = block * BLOCK;
        for i in 0..BLOCK.min(plan.rows - first) {
            let t_ns = plan.t_ns[first + i + 1];
            while let Some(feed) = plan.feed.get(next).filter(|feed| plan.valid_ns(feed) <= t_ns) {
                to.aid(&plan.observation(feed, values))?;
                next += 1;
            }
            let row = imu.measured().each_ref().map(|m| Vector3::new(m[0][i], m[1][i], m[2][i]));
            to.imu(t_ns, &row)?;
            if plan.epochs.get(epoch).is_some_and(|e| e.row == first + i + 1) {
                columns(&imu, i + 1, values, epoch, &mut true_errors);
                to.compare(epoch, &true_errors);
                epoch += 1;
            }
        }
    }
    for feed in &plan.feed[next..] {
        to.aid(&plan.observation(feed, values))?;
    }
    Ok(())
}

/// True sensor errors at the end of interval `i - 1` of the present block, in the order of [`Plan::columns`].
fn columns(imu: &ImuRun<'_>, i: usize, values: &AidValues, epoch: usize, out: &mut [f64]) {
    let mut at = 0;
    for series in imu.errors() {
        for c in 0..series.len() {
            out[at] = series.at(c, i);
            at += 1;
        }
    }
    out[at..at + 3].copy_from_slice(&values.lever_m);
    out[at + 3..at + AID_COLUMNS].copy_from_slice(&values.true_errors[epoch]);
}

pub(super) fn filter<M: NavModel, const CAP: usize>(
    plan: &Plan,
    initial: &Initial,
) -> Result<Ekf<M, CAP>, Error> {
    let mut ekf = Ekf::new(&plan.filter.settings, &plan.filter.blocks, initial)?;
    ekf.set_attitude_form(plan.filter.attitude_form)?;
    Ok(ekf)
}

/// A run with the streaming navigator as it is.
struct Full<'p, M, const CAP: usize> {
    plan: &'p Plan,
    groups: &'p Groups,
    navigator: Navigator<M, CAP>,
    ledger: Ledger<'p>,
    claim: Claim,
}

impl<M: NavModel, const CAP: usize> Feeder for Full<'_, M, CAP> {
    fn aid(&mut self, aid: &Observation) -> Result<(), Error> {
        match self.navigator.aid(aid, &mut self.ledger) {
            // more values after the end of the IMU rows than the queue holds
            Err(Error::QueueFull { t_ns, .. }) if Some(t_ns) >= self.plan.t_ns.last().copied() => {
                self.navigator.finish(&mut self.ledger);
                self.navigator.aid(aid, &mut self.ledger)
            }
            other => other,
        }
    }

    fn imu(&mut self, t_ns: i64, [dtheta, dvel]: &Row) -> Result<(), Error> {
        self.navigator.imu(t_ns, dtheta, dvel, &mut self.ledger)
    }

    fn compare(&mut self, k: usize, true_errors: &[f64]) {
        let (ekf, epoch) = (self.navigator.ekf(), &self.plan.epochs[k]);
        let n = ekf.layout().len();
        if epoch.nees {
            self.claim.set(self.groups, &ekf.ned_covariance(), n);
        }
        let sd = self.ledger.wants_sd(self.plan.t_ns[epoch.row]).then(|| ekf.solution_sd());
        let params = &ekf.params()[NAV..n];
        self.ledger.epoch(epoch, &ekf.solution(), params, true_errors, Some(&self.claim), sd.as_ref());
    }
}

/// Adds a run with its own covariance.
pub(super) fn full<M: NavModel, const CAP: usize>(
    plan: &Plan,
    groups: &Groups,
    run: u32,
    sums: &mut Sums,
) -> Result<(), Error> {
    let (deviates, values) = draw(plan, run);
    let (initial, _) = plan.start(&deviates);
    let navigator = Navigator::new(filter::<M, CAP>(plan, &initial)?, plan.filter.stream);
    let mut to =
        Full { plan, groups, navigator, ledger: Ledger::new(plan, groups, sums), claim: Claim::default() };
    feed(plan, &plan.imu, deviates, &values, &mut to)?;
    let Full { mut navigator, mut ledger, .. } = to;
    navigator.finish(&mut ledger);
    let [a, b, c] = Source::ALL.map(|source| navigator.counts(source));
    ledger.finish(&[navigator.imu_counts(), a, b, c]);
    Ok(())
}

/// Deviates and values of the aids of a run.
pub(super) fn draw(plan: &Plan, run: u32) -> (Deviates, AidValues) {
    let deviates = plan.deviates(run);
    let epochs: Vec<usize> = plan.epochs.iter().map(|e| e.row).collect();
    (deviates, AidValues::new(&plan.aids, &plan.ellipsoid, &deviates, &epochs))
}
