//! One object over all models and capacities, chosen from the configuration at run time.

use gnssins::bytes::{Reader, Writer};
use gnssins::discretise::Transition;
use gnssins::ekf::{Ekf, SolutionSd};
use gnssins::error::Error;
use gnssins::meas::{Observation, Record, Rows, SOURCES, Source};
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::Ned;
use gnssins::nav::{NAV, NavModel, Solution};
use gnssins::presets::Model;
use gnssins::small::ROWS_MAX;
use gnssins::stream::{Counts, Event, Navigator, Sink};
use nalgebra::Vector3;
use pyo3::prelude::*;

use crate::config::{CAPACITY, EngineConfig};
use crate::errors;

/// Events and records in the order in which they came, and the linearised system where it is asked for.
#[derive(Debug, Default)]
pub struct Log {
    pub events: Vec<Event>,
    pub records: Vec<Record>,
    pub linear: Option<Linear>,
}

/// The linearised system, one entry per measurement: transition since the one before, rows and their covariance.
#[derive(Debug)]
pub struct Linear {
    n: usize,
    /// Transition since the last measurement, n x n.
    since: Vec<f64>,
    pub t_ns: Vec<i64>,
    pub phi: Vec<f64>,
    pub h: Vec<f64>,
    pub r: Vec<f64>,
    pub lla: Vec<f64>,
    pub q_nb: Vec<f64>,
}

impl Linear {
    pub fn new(n: usize) -> Self {
        let (t_ns, phi, h, r, lla, q_nb) = (vec![], vec![], vec![], vec![], vec![], vec![]);
        Self { n, since: identity(n), t_ns, phi, h, r, lla, q_nb }
    }

    /// Multiplies by [A B; 0 D] from the left.
    fn carry<const CAP: usize>(&mut self, t: &Transition<CAP>) {
        let n = self.n;
        let mut top = vec![0.0; NAV * n];
        for (i, out) in top.chunks_exact_mut(n).enumerate() {
            for (j, since) in self.since.chunks_exact(n).enumerate().filter(|(j, _)| t.top(i, *j) != 0.0) {
                let a = t.top(i, j);
                out.iter_mut().zip(since).for_each(|(o, s)| *o += a * s);
            }
        }
        for (row, d) in self.since.chunks_exact_mut(n).zip(&t.blocks.diagonal) {
            row.iter_mut().for_each(|v| *v *= d);
        }
        self.since[..NAV * n].copy_from_slice(&top);
    }

    fn push<const CAP: usize>(&mut self, t_ns: i64, at: &Solution, rows: &Rows<CAP>) {
        self.t_ns.push(t_ns);
        self.lla.extend([at.position.lat_rad, at.position.lon_rad, at.position.height_m]);
        self.q_nb.extend([at.q_nb.w, at.q_nb.i, at.q_nb.j, at.q_nb.k]);
        self.phi.append(&mut self.since);
        self.since = identity(self.n);
        let (mut h, mut r) = (vec![f64::NAN; ROWS_MAX * self.n], [[f64::NAN; ROWS_MAX]; ROWS_MAX]);
        for i in 0..rows.len {
            let c = rows.component[i];
            h[c * self.n..(c + 1) * self.n].copy_from_slice(&rows.h[i][..self.n]);
            for j in 0..rows.len {
                r[c][rows.component[j]] = rows.r[i][j];
            }
        }
        self.h.append(&mut h);
        self.r.extend(r.iter().flatten());
    }
}

fn identity(n: usize) -> Vec<f64> {
    (0..n * n).map(|k| if k % (n + 1) == 0 { 1.0 } else { 0.0 }).collect()
}

impl Sink for Log {
    fn transition<const CAP: usize>(&mut self, transition: &Transition<CAP>) {
        if let Some(linear) = &mut self.linear {
            linear.carry(transition);
        }
    }

    fn linearised<M: NavModel, const CAP: usize>(&mut self, t_ns: i64, model: &M, rows: &Rows<CAP>) {
        if let Some(linear) = &mut self.linear {
            linear.push(t_ns, &model.solution(), rows);
        }
    }

    fn event(&mut self, event: &Event) {
        self.events.push(*event);
    }

    fn record(&mut self, record: &Record) {
        self.records.push(*record);
    }
}

/// What the binding asks of a navigator.
pub trait Engine: Send + Sync {
    fn imu(
        &mut self,
        t_ns: i64,
        gyro: &Vector3<f64>,
        accel: &Vector3<f64>,
        log: &mut Log,
    ) -> Result<(), Error>;
    fn aid(&mut self, aid: &Observation, log: &mut Log) -> Result<(), Error>;
    fn finish(&mut self, log: &mut Log);
    fn valid_ns(&self, source: Source, t_ns: i64) -> i64;
    fn t_ns(&self) -> i64;
    fn solution(&self) -> Solution;
    fn solution_sd(&self) -> SolutionSd;
    /// Estimates and standard deviations of the block states.
    fn blocks(&self, x: &mut Vec<f64>, sd: &mut Vec<f64>);
    /// Covariance along north, east, down, row by row.
    fn covariance(&self, out: &mut Vec<f64>);
    /// Rows of the IMU.
    fn imu_counts(&self) -> Counts;
    /// Rows of the aids.
    fn counts(&self) -> [Counts; SOURCES];
    fn save(&self) -> Result<Vec<u8>, Error>;
    fn restore(&mut self, saved: &[u8]) -> Result<(), Error>;
}

/// Fixes that may wait for an IMU row: logs with long gaps are read too.
const PENDING: usize = 1024;

impl<M: NavModel + Send + Sync, const CAP: usize> Engine for Navigator<M, CAP, PENDING> {
    fn imu(
        &mut self,
        t_ns: i64,
        gyro: &Vector3<f64>,
        accel: &Vector3<f64>,
        log: &mut Log,
    ) -> Result<(), Error> {
        Navigator::imu(self, t_ns, gyro, accel, log)
    }

    fn aid(&mut self, aid: &Observation, log: &mut Log) -> Result<(), Error> {
        Navigator::aid(self, aid, log)
    }

    fn finish(&mut self, log: &mut Log) {
        Navigator::finish(self, log);
    }

    fn valid_ns(&self, source: Source, t_ns: i64) -> i64 {
        Navigator::valid_ns(self, source, t_ns)
    }

    fn t_ns(&self) -> i64 {
        self.ekf().t_ns()
    }

    fn solution(&self) -> Solution {
        self.ekf().solution()
    }

    fn solution_sd(&self) -> SolutionSd {
        self.ekf().solution_sd()
    }

    fn blocks(&self, x: &mut Vec<f64>, sd: &mut Vec<f64>) {
        let ekf = self.ekf();
        let params = ekf.params();
        for (i, param) in params.iter().enumerate().take(ekf.layout().len()).skip(NAV) {
            x.push(*param);
            sd.push(ekf.covariance().get(i, i).sqrt());
        }
    }

    fn covariance(&self, out: &mut Vec<f64>) {
        let n = self.ekf().layout().len();
        for row in self.ekf().ned_covariance().iter().take(n) {
            out.extend_from_slice(&row[..n]);
        }
    }

    fn imu_counts(&self) -> Counts {
        Navigator::imu_counts(self)
    }

    fn counts(&self) -> [Counts; SOURCES] {
        Source::ALL.map(|source| Navigator::counts(self, source))
    }

    fn save(&self) -> Result<Vec<u8>, Error> {
        let mut bytes = vec![0; self.saved_len()];
        let mut writer = Writer::new(&mut bytes);
        Navigator::save(self, &mut writer)?;
        let len = writer.len();
        bytes.truncate(len);
        Ok(bytes)
    }

    fn restore(&mut self, saved: &[u8]) -> Result<(), Error> {
        Navigator::restore(self, &mut Reader::new(saved))
    }
}

/// Builds the smallest engine that holds the configured states.
pub fn build(py: Python<'_>, config: &EngineConfig) -> PyResult<Box<dyn Engine>> {
    let n = config.state_count();
    match config.model {
        Model::Ned => sized::<Ned>(py, config, n),
        Model::Ecef => sized::<Ecef>(py, config, n),
    }
}

fn sized<M: NavModel + Send + Sync + 'static>(
    py: Python<'_>,
    config: &EngineConfig,
    n: usize,
) -> PyResult<Box<dyn Engine>> {
    match n {
        0..=16 => boxed::<M, 16>(py, config),
        17..=24 => boxed::<M, 24>(py, config),
        25..=40 => boxed::<M, 40>(py, config),
        _ => boxed::<M, CAPACITY>(py, config),
    }
}

fn boxed<M: NavModel + Send + Sync + 'static, const CAP: usize>(
    py: Python<'_>,
    config: &EngineConfig,
) -> PyResult<Box<dyn Engine>> {
    let mut ekf = Ekf::<M, CAP>::new(&config.settings(py)?, &config.blocks(py)?, &config.initial(py)?)
        .map_err(|e| errors::from_crate(py, &e))?;
    ekf.set_attitude_form(config.attitude_form).map_err(|e| errors::from_crate(py, &e))?;
    Ok(Box::new(Navigator::<M, CAP, PENDING>::with_queue(ekf, config.stream(py)?)))
}
