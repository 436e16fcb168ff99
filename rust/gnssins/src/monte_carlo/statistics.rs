//! What a set of runs leaves behind: sums, taken on the way.

use nalgebra::Vector3;

use super::plan::{Epoch, Plan};
use crate::attitude;
use crate::ekf::SolutionSd;
use crate::frames::wrap_pi;
use crate::math;
use crate::meas::{Record, SOURCES, Status};
use crate::nav::{NAV, Solution};
use crate::small::ROWS_MAX;
use crate::stream::{Counts, Sink};

/// Position, velocity, attitude, three axes each.
pub type Nine = [f64; 9];

/// Sum and number of NIS values.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NisSum {
    /// Sum.
    pub sum: f64,
    /// Number.
    pub count: u64,
}

/// What the runs left at the end of one gap.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct GapSum {
    /// Runs with an epoch in the gap before the first fix after its start.
    pub runs: u64,
    /// Squares of the errors of position, velocity and roll, pitch, heading.
    pub squares: Nine,
    /// Variances that the filter claimed.
    pub variances: Nine,
    /// Squares of errors over sigmas.
    pub ratios: Nine,
}

/// Sums over some runs.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sums {
    /// Squares of position, velocity and phi over the counted epochs, of each run.
    pub runs: Vec<Nine>,
    /// Epochs behind them, over all runs.
    pub count: u64,
    /// At each epoch of the covariance: squares of position, velocity and phi.
    pub squares: Vec<Nine>,
    /// At each epoch of the covariance: variances that the filter claimed.
    pub variances: Vec<Nine>,
    /// NEES by epoch and group.
    pub nees: Vec<f64>,
    /// NIS by source and number of components.
    pub nis: [[NisSum; ROWS_MAX + 1]; SOURCES],
    /// Ends of the gaps.
    pub gaps: Vec<GapSum>,
    /// Rows of the IMU, then of the aids.
    pub counts: [Counts; SOURCES + 1],
}

impl Sums {
    /// Of no runs yet.
    #[must_use]
    pub fn new(plan: &Plan) -> Self {
        let epochs = plan.epochs.iter().filter(|e| e.nees).count();
        Self {
            squares: vec![[0.0; 9]; epochs],
            variances: vec![[0.0; 9]; epochs],
            nees: vec![0.0; epochs * plan.groups.len()],
            gaps: vec![GapSum::default(); plan.gaps.len()],
            ..Self::default()
        }
    }
}

/// Groups that share a factorisation: the states of a part are the first ones of its whole.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Groups {
    /// Whole of each group, by its place in `wholes`, and how many of its states belong to the group.
    of: Vec<(usize, usize)>,
    wholes: Vec<Vec<usize>>,
}

impl Groups {
    pub fn new(groups: &[Vec<usize>]) -> Self {
        let mut wholes: Vec<Vec<usize>> = vec![];
        for group in groups {
            if !groups.iter().any(|g| g.len() > group.len() && g.starts_with(group))
                && !wholes.contains(group)
            {
                wholes.push(group.clone());
            }
        }
        let whole = |g: &Vec<usize>| (wholes.iter().position(|w| w.starts_with(g)).unwrap_or(0), g.len());
        Self { of: groups.iter().map(whole).collect(), wholes }
    }
}

/// What a filter claims at an epoch, ready to be held against errors.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Claim {
    /// Standard deviations of phi, velocity, position and the blocks.
    sd: Vec<f64>,
    /// Cholesky factors of the correlation matrices of the wholes, row by row.
    factors: Vec<Vec<f64>>,
}

impl Claim {
    /// From a covariance along north, east, down.
    pub fn set<const CAP: usize>(&mut self, groups: &Groups, p: &[[f64; CAP]; CAP], n: usize) {
        self.sd.clear();
        self.sd.extend((0..n).map(|i| math::sqrt(p[i][i])));
        self.factors.resize(groups.wholes.len(), vec![]);
        for (l, states) in self.factors.iter_mut().zip(&groups.wholes) {
            factorise(p, &self.sd, states, l);
        }
    }

    /// Adds the NEES of an error vector, by group.
    pub fn add_nees(&self, groups: &Groups, x: &[f64], out: &mut [f64]) {
        for (whole, (l, states)) in self.factors.iter().zip(&groups.wholes).enumerate() {
            let (mut white, mut row, mut sum) = (vec![0.0; states.len()], 0, 0.0);
            let mut sums = Vec::with_capacity(states.len());
            for (i, &state) in states.iter().enumerate() {
                let done: f64 = l[row..row + i].iter().zip(&white).map(|(l, w)| l * w).sum();
                white[i] = (x[state] / self.sd[state] - done) / l[row + i];
                sum += white[i] * white[i];
                sums.push(sum);
                row += i + 1;
            }
            for (out, (_, len)) in out.iter_mut().zip(&groups.of).filter(|(_, of)| of.0 == whole) {
                *out += sums[len - 1];
            }
        }
    }

    fn variances(&self) -> Nine {
        // phi, velocity, position here; position, velocity, phi there
        core::array::from_fn(|i| {
            let sd = self.sd[3 * (2 - i / 3) + i % 3];
            sd * sd
        })
    }
}

/// Lower Cholesky factor of the correlation matrix of some states.
fn factorise<const CAP: usize>(p: &[[f64; CAP]; CAP], sd: &[f64], states: &[usize], l: &mut Vec<f64>) {
    l.clear();
    for (i, &a) in states.iter().enumerate() {
        let start = l.len();
        let mut column = 0;
        for (j, &b) in states.iter().enumerate().take(i + 1) {
            let done: f64 = l[start..].iter().zip(&l[column..column + j]).map(|(x, y)| x * y).sum();
            let rest = p[a][b] / (sd[a] * sd[b]) - done;
            let value = if i == j { math::sqrt(rest) } else { rest / l[column + j] };
            l.push(value);
            column += j + 1;
        }
    }
}

/// Sums on their way through a run.
pub(super) struct Ledger<'p> {
    plan: &'p Plan,
    groups: &'p Groups,
    pub sums: &'p mut Sums,
    run: Nine,
    /// Epochs of the covariance seen.
    nees_epoch: usize,
    /// Last epoch in each gap before a fix ended it: errors and sigmas.
    ends: Vec<Option<(Nine, Nine)>>,
    open: Vec<bool>,
}

impl<'p> Ledger<'p> {
    pub fn new(plan: &'p Plan, groups: &'p Groups, sums: &'p mut Sums) -> Self {
        let gaps = plan.gaps.len();
        let (ends, open) = (vec![None; gaps], vec![true; gaps]);
        Self { plan, groups, sums, run: [0.0; 9], nees_epoch: 0, ends, open }
    }

    /// Whether standard deviations are wanted at a time, ns.
    pub fn wants_sd(&self, t_ns: i64) -> bool {
        let inside = |gap: &[i64; 2]| (gap[0]..=gap[1]).contains(&t_ns);
        self.plan.gaps.iter().zip(&self.open).any(|(gap, open)| *open && inside(gap))
    }

    /// Takes an epoch of comparison; `true_errors` are the columns of [`Plan::columns`].
    pub fn epoch(
        &mut self,
        epoch: &Epoch,
        estimate: &Solution,
        params: &[f64],
        true_errors: &[f64],
        claim: Option<&Claim>,
        sd: Option<&SolutionSd>,
    ) {
        let t_ns = self.plan.t_ns[epoch.row];
        let [position, velocity, phi] = self.plan.errors(estimate, &epoch.truth);
        let nine = joined(&position, &velocity, &phi);
        if epoch.error && t_ns > self.plan.after_ns {
            add_squares(&mut self.run, &nine);
            self.sums.count += 1;
        }
        if let Some(sd) = sd.filter(|_| epoch.error) {
            let euler = |s: &Solution| Vector3::from(<[f64; 3]>::from(attitude::to_euler(&s.q_nb)));
            let turn = (euler(estimate) - euler(&epoch.truth)).map(wrap_pi);
            let errors = joined(&position, &velocity, &turn);
            let sds = joined(&sd.position_m, &sd.velocity_m_s, &sd.euler_rad);
            for ((gap, open), end) in self.plan.gaps.iter().zip(&self.open).zip(&mut self.ends) {
                if *open && (gap[0]..=gap[1]).contains(&t_ns) {
                    *end = Some((errors, sds));
                }
            }
        }
        if let Some(claim) = claim.filter(|_| epoch.nees) {
            let k = self.nees_epoch;
            self.nees_epoch += 1;
            add_squares(&mut self.sums.squares[k], &nine);
            add(&mut self.sums.variances[k], &claim.variances());
            let mut x = Vec::with_capacity(NAV + params.len());
            x.extend(phi.iter().chain(&velocity).chain(&position));
            let known = self.plan.truths.iter().zip(params);
            x.extend(known.map(|(column, p)| column.map_or(f64::NAN, |c| true_errors[c] - p)));
            let width = self.plan.groups.len();
            claim.add_nees(self.groups, &x, &mut self.sums.nees[k * width..(k + 1) * width]);
        }
    }

    /// Takes what a filter thought of a measurement.
    pub fn nis(&mut self, source: usize, t_ns: i64, dof: usize, nis: f64) {
        if t_ns > self.plan.after_ns && nis.is_finite() && dof > 0 {
            let own = &mut self.sums.nis[source][dof];
            own.sum += nis;
            own.count += 1;
        }
    }

    /// Takes the time of a fix that was used.
    pub fn used(&mut self, t_ns: i64) {
        for (gap, open) in self.plan.gaps.iter().zip(&mut self.open) {
            *open &= t_ns < gap[0];
        }
    }

    /// Ends the run.
    pub fn finish(self, counts: &[Counts; SOURCES + 1]) {
        self.sums.runs.push(self.run);
        for (sum, end) in self.sums.gaps.iter_mut().zip(&self.ends) {
            let Some((errors, sds)) = end else { continue };
            sum.runs += 1;
            add_squares(&mut sum.squares, errors);
            add_squares(&mut sum.variances, sds);
            add_squares(&mut sum.ratios, &core::array::from_fn(|i| errors[i] / sds[i]));
        }
        for (sum, own) in self.sums.counts.iter_mut().zip(counts) {
            sum.total += own.total;
            sum.used += own.used;
            sum.rejected += own.rejected;
            sum.late += own.late;
            sum.bad += own.bad;
        }
    }
}

impl Sink for Ledger<'_> {
    fn record(&mut self, record: &Record) {
        if matches!(record.status, Status::Used | Status::Rejected) {
            self.nis(record.source.index(), record.t_ns, record.dof, record.nis);
        }
        if record.status == Status::Used && record.source.index() == 0 {
            self.used(record.t_ns);
        }
    }
}

fn joined(a: &Vector3<f64>, b: &Vector3<f64>, c: &Vector3<f64>) -> Nine {
    [a.x, a.y, a.z, b.x, b.y, b.z, c.x, c.y, c.z]
}

fn add(to: &mut Nine, from: &Nine) {
    to.iter_mut().zip(from).for_each(|(t, f)| *t += f);
}

fn add_squares(to: &mut Nine, from: &Nine) {
    to.iter_mut().zip(from).for_each(|(t, f)| *t += f * f);
}
