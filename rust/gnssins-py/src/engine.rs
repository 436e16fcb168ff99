//! One object over all models and capacities, chosen from the configuration at run time.

use gnssins::bytes::{Reader, Writer};
use gnssins::ekf::{Ekf, SolutionSd};
use gnssins::error::Error;
use gnssins::meas::Record;
use gnssins::meas::gnss::GnssFix;
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::Ned;
use gnssins::nav::{NAV, NavModel, Solution};
use gnssins::presets::Model;
use gnssins::stream::{Counts, Event, Navigator, Sink};
use nalgebra::Vector3;
use pyo3::prelude::*;

use crate::config::{CAPACITY, EngineConfig};
use crate::errors;

/// Events and records in the order in which they came.
#[derive(Debug, Default)]
pub struct Log {
    pub events: Vec<Event>,
    pub records: Vec<Record>,
}

impl Sink for Log {
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
    fn gnss(&mut self, fix: &GnssFix, log: &mut Log) -> Result<(), Error>;
    fn finish(&mut self, log: &mut Log);
    fn valid_ns(&self, t_ns: i64) -> i64;
    fn t_ns(&self) -> i64;
    fn solution(&self) -> Solution;
    fn solution_sd(&self) -> SolutionSd;
    /// Estimates and standard deviations of the block states.
    fn blocks(&self, x: &mut Vec<f64>, sd: &mut Vec<f64>);
    /// Covariance along north, east, down, row by row.
    fn covariance(&self, out: &mut Vec<f64>);
    fn counts(&self) -> [Counts; 2];
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

    fn gnss(&mut self, fix: &GnssFix, log: &mut Log) -> Result<(), Error> {
        Navigator::gnss(self, fix, log)
    }

    fn finish(&mut self, log: &mut Log) {
        Navigator::finish(self, log);
    }

    fn valid_ns(&self, t_ns: i64) -> i64 {
        Navigator::valid_ns(self, t_ns)
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
        for i in NAV..ekf.layout().len() {
            x.push(ekf.params()[i]);
            sd.push(ekf.covariance().get(i, i).sqrt());
        }
    }

    fn covariance(&self, out: &mut Vec<f64>) {
        let n = self.ekf().layout().len();
        for row in self.ekf().ned_covariance().iter().take(n) {
            out.extend_from_slice(&row[..n]);
        }
    }

    fn counts(&self) -> [Counts; 2] {
        [self.imu_counts(), self.gnss_counts()]
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
