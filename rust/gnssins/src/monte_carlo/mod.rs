//! Monte Carlo: the sensors of a simulated motion, the filter behind them, and sums over many runs.
//!
//! The truth is made once and shared. Every run draws its sensor errors from counters ([`normal`]), so that run k is the
//! same on any number of threads and in any order; it feeds the streaming [`crate::stream::Navigator`],
//! and only sums stay ([`Sums`]). Sums are taken over chunks of [`CHUNK`] runs in the order of the runs, and the chunks
//! are handed out in their order: whoever adds them up gets the same bits for any number of threads.
//!
//! With [`Mode::Shared`] the covariance and the gains are those of the trajectory without errors, made once: a run is
//! then strapdown, innovations and feedback. That holds where errors are small against what bends the equations. Gates
//! are off, for nothing is tested; the feedback follows every measurement.

pub mod aids;
pub mod imu;
pub mod normal;
pub mod plan;
pub mod process;
mod run;
mod shared;
mod statistics;

use core::ops::{ControlFlow, Range};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

pub use normal::{BLOCK, Deviates};
pub use plan::{Epoch, Feed, Filter, Plan};
pub use statistics::{GapSum, Nine, NisSum, Sums};

use crate::ekf::Initial;
use crate::error::Error;
use crate::imu::ImuInput;
use crate::nav::NavModel;
use aids::AidValues;
use nalgebra::Vector3;
use shared::Nominal;
use statistics::Groups;

/// Runs whose sums are taken together.
pub const CHUNK: u32 = 4;

/// Longest time between two looks at whether to go on.
const LOOK: Duration = Duration::from_millis(100);

/// Where the covariance comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Mode {
    /// Every run has its own.
    #[default]
    Full,
    /// All runs have that of the trajectory without errors.
    Shared,
}

/// A run that ended with an error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Failure {
    /// Number of the run.
    pub run: u32,
    /// Its error.
    pub error: Error,
}

/// A set of runs of one plan.
#[derive(Debug)]
pub struct MonteCarlo<M, const CAP: usize> {
    plan: Plan,
    groups: Groups,
    nominal: Option<Nominal<CAP>>,
    model: core::marker::PhantomData<fn() -> M>,
}

/// One run as its filter would have seen it.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedRun {
    /// Measured increments of angle (rad) and velocity (m/s), one row per interval of the truth.
    pub increments: [Vec<[f64; 3]>; 2],
    /// Values of all aids.
    pub aids: AidValues,
    /// True sensor errors at every epoch of the truth, by [`Plan::columns`].
    pub true_errors: Vec<f64>,
    /// What the filter is told at the start.
    pub initial: Initial,
    /// Its errors: phi, velocity, position.
    pub initial_error: [Vector3<f64>; 3],
}

impl Plan {
    /// Sensors, aids and start of a run.
    #[must_use]
    pub fn simulated(&self, run: u32) -> SimulatedRun {
        let (deviates, n) = (self.deviates(run), self.t_ns.len());
        let every: Vec<usize> = (0..n).collect();
        let aids = AidValues::new(&self.aids, &self.ellipsoid, &deviates, &every);
        let mut imu = imu::ImuRun::new(&self.imu, deviates);
        let (mut increments, mut true_errors) = ([vec![], vec![]], Vec::with_capacity(n * self.columns()));
        for block in 0..self.imu.dt_s.len() {
            imu.block(block);
            let intervals = BLOCK.min(n - 1 - block * BLOCK);
            for i in 0..=intervals {
                // the end of a block is the beginning of the next one
                if i < intervals || block * BLOCK + i == n - 1 {
                    for series in imu.errors() {
                        true_errors.extend((0..series.len()).map(|c| series.at(c, i)));
                    }
                    true_errors.extend(aids.lever_m);
                    true_errors.extend(aids.true_errors[block * BLOCK + i]);
                }
                if i < intervals {
                    for (rows, axes) in increments.iter_mut().zip(imu.measured()) {
                        rows.push([axes[0][i], axes[1][i], axes[2][i]]);
                    }
                }
            }
        }
        let (initial, initial_error) = self.start(&deviates);
        SimulatedRun { increments, aids, true_errors, initial, initial_error }
    }
}

impl<M: NavModel + Send + Sync, const CAP: usize> MonteCarlo<M, CAP> {
    /// Prepares a set; with [`Mode::Shared`] the trajectory without errors is filtered here.
    ///
    /// # Errors
    /// [`Error::Config`] for a plan that does not fit together, and what the filter refuses.
    pub fn new(plan: Plan, mode: Mode) -> Result<Self, Error> {
        plan.check()?;
        if plan.filter.stream.input != ImuInput::Increments {
            let (what, need) =
                ("imu.input (number of the kind)", "must be increments: the simulated IMU puts out those");
            return Err(Error::Config { what, need, got: plan.filter.stream.input as u8 as f64 });
        }
        if mode == Mode::Shared && plan.filter.settings.feedback_ns > 0 {
            return Err(Error::Config {
                what: "filter.feedback_interval (ns)",
                need: "must be 0 with shared covariance: its gains feed back after every measurement",
                got: plan.filter.settings.feedback_ns as f64,
            });
        }
        let groups = Groups::new(&plan.groups);
        let nominal = match mode {
            Mode::Full => None,
            Mode::Shared => Some(Nominal::new::<M>(&plan, &groups)?),
        };
        Ok(Self { plan, groups, nominal, model: core::marker::PhantomData })
    }

    /// What the runs share.
    #[must_use]
    pub const fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Sums over some runs.
    ///
    /// # Errors
    /// The error of the first run that fails.
    pub fn sums(&self, runs: Range<u32>) -> Result<Sums, Failure> {
        let mut sums = Sums::new(&self.plan);
        for run in runs {
            let done = match &self.nominal {
                None => run::full::<M, CAP>(&self.plan, &self.groups, run, &mut sums),
                Some(nominal) => shared::shared::<M, CAP>(&self.plan, &self.groups, nominal, run, &mut sums),
            };
            done.map_err(|error| Failure { run, error })?;
        }
        Ok(sums)
    }

    /// Goes through the runs on `jobs` threads and hands the sums of every [`CHUNK`] runs to `take`, in their order and
    /// on the calling thread. `go_on` is asked several times a second. After a break of either, or an error, chunks that
    /// are under way are finished and dropped.
    ///
    /// # Errors
    /// The error of the first run that fails, after the sums of all chunks before it.
    ///
    /// # Panics
    /// When the system gives no threads.
    pub fn run(
        &self,
        runs: Range<u32>,
        jobs: usize,
        mut take: impl FnMut(u32, Sums) -> ControlFlow<()>,
        mut go_on: impl FnMut() -> bool,
    ) -> Result<(), Failure> {
        let chunks = runs.len().div_ceil(CHUNK as usize) as u32;
        let (next, stop) = (AtomicU32::new(0), AtomicBool::new(false));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs.max(1)).build().expect("threads");
        pool.in_place_scope(|scope| {
            let (sender, receiver) = channel();
            for _ in 0..jobs.max(1) {
                let (sender, next, stop, runs) = (sender.clone(), &next, &stop, runs.clone());
                scope.spawn(move |_| {
                    while !stop.load(Ordering::Relaxed) {
                        let chunk = next.fetch_add(1, Ordering::Relaxed);
                        if chunk >= chunks {
                            break;
                        }
                        let first = runs.start + chunk * CHUNK;
                        let sums = self.sums(first..runs.end.min(first + CHUNK));
                        if sender.send((chunk, sums)).is_err() {
                            break;
                        }
                    }
                });
            }
            drop(sender);
            let mut early = std::collections::BTreeMap::new();
            let mut due = 0;
            let done = loop {
                match early.remove(&due) {
                    Some(Ok(sums)) => {
                        if take(runs.start + due * CHUNK, sums).is_break() {
                            break Ok(());
                        }
                        due += 1;
                    }
                    Some(Err(failure)) => break Err(failure),
                    None if due == chunks => break Ok(()),
                    None => match receiver.recv_timeout(LOOK) {
                        Ok((chunk, sums)) => drop(early.insert(chunk, sums)),
                        Err(RecvTimeoutError::Timeout) => {}
                        Err(RecvTimeoutError::Disconnected) => break Ok(()),
                    },
                }
                if !go_on() {
                    break Ok(());
                }
            };
            stop.store(true, Ordering::Relaxed);
            done
        })
    }
}
