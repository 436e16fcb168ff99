//! A whole log in one call, with the GIL released.

use gnssins::error::Error;
use gnssins::meas::gnss::GnssFix;
use gnssins::meas::{Record, Status};
use gnssins::stream::{Counts, Event};
use nalgebra::Vector3;
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList};

use crate::config::{EngineConfig, StateInfo};
use crate::engine::{self, Engine, Log};
use crate::{convert, errors};

/// IMU rows between two looks at signals and the progress callback.
const ROWS_PER_LOOK: usize = 16_384;

/// Columns of the result.
#[derive(Debug, Default)]
pub struct Columns {
    t_ns: Vec<i64>,
    lla: Vec<f64>,
    v_n: Vec<f64>,
    rpy: Vec<f64>,
    q_nb: Vec<f64>,
    sd: Vec<f64>,
    x: Vec<f64>,
    x_sd: Vec<f64>,
    cov_t_ns: Vec<i64>,
    cov: Vec<f64>,
}

impl Columns {
    pub fn push(&mut self, engine: &dyn Engine) {
        let s = engine.solution();
        let (roll, pitch, heading) = gnssins::attitude::to_euler(&s.q_nb);
        let sd = engine.solution_sd();
        self.t_ns.push(engine.t_ns());
        self.lla.extend([s.position.lat_rad, s.position.lon_rad, s.position.height_m]);
        self.v_n.extend(s.v_n.iter());
        self.rpy.extend([roll, pitch, heading]);
        self.q_nb.extend([s.q_nb.w, s.q_nb.i, s.q_nb.j, s.q_nb.k]);
        for v in [&sd.position_m, &sd.velocity_m_s, &sd.euler_rad] {
            self.sd.extend(v.iter());
        }
        engine.blocks(&mut self.x, &mut self.x_sd);
    }

    fn push_covariance(&mut self, engine: &dyn Engine) {
        self.cov_t_ns.push(engine.t_ns());
        engine.covariance(&mut self.cov);
    }

    fn fill(self, out: &Bound<'_, PyDict>, n: usize) -> PyResult<()> {
        let py = out.py();
        let blocks = n - gnssins::nav::NAV;
        let rows = self.t_ns.len();
        out.set_item("t_ns", PyArray1::from_vec(py, self.t_ns))?;
        for (key, values, width) in [
            ("lla", self.lla, 3),
            ("v_n", self.v_n, 3),
            ("rpy", self.rpy, 3),
            ("q_nb", self.q_nb, 4),
            ("sd", self.sd, 9),
        ] {
            out.set_item(key, convert::array2(py, values, width)?)?;
        }
        for (key, values) in [("x", self.x), ("x_sd", self.x_sd)] {
            use numpy::PyArrayMethods;
            out.set_item(key, PyArray1::from_vec(py, values).reshape([rows, blocks])?)?;
        }
        out.set_item("cov_t_ns", PyArray1::from_vec(py, self.cov_t_ns))?;
        out.set_item("cov", convert::array3(py, self.cov, n, n)?)
    }
}

/// Emits at the first row and then at the first row of each multiple of the interval, so that all outputs of a log, and
/// those of other logs on the same clock, share one grid.
struct Grid {
    interval_ns: i64,
    cell: Option<i64>,
}

impl Grid {
    fn new(interval_ns: i64) -> Self {
        Self { interval_ns: interval_ns.max(1), cell: None }
    }

    fn due(&mut self, t_ns: i64) -> bool {
        self.cell.replace(t_ns.div_euclid(self.interval_ns)) != Some(t_ns.div_euclid(self.interval_ns))
    }
}

/// Runs a filter over a log. See the stub for shapes and units.
#[pyfunction]
#[pyo3(signature = (config_json, imu_t_ns, gyro, accel, gnss_t_ns, gnss_pos, gnss_vel, gnss_var, progress=None))]
#[expect(clippy::too_many_arguments, reason = "columns of two tables")]
pub fn run<'py>(
    py: Python<'py>,
    config_json: &str,
    imu_t_ns: &Bound<'py, PyAny>,
    gyro: &Bound<'py, PyAny>,
    accel: &Bound<'py, PyAny>,
    gnss_t_ns: &Bound<'py, PyAny>,
    gnss_pos: &Bound<'py, PyAny>,
    gnss_vel: &Bound<'py, PyAny>,
    gnss_var: &Bound<'py, PyAny>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let config = EngineConfig::parse(py, config_json)?;
    let mut engine = engine::build(py, &config)?;
    let imu = Imu {
        t_ns: convert::times(imu_t_ns, "imu_t_ns")?,
        gyro: convert::rows3(gyro, "gyro")?,
        accel: convert::rows3(accel, "accel")?,
    };
    convert::same_length(py, "IMU table", &[imu.t_ns.len(), imu.gyro.len(), imu.accel.len()])?;
    refuse_bad_share(py, &imu, config.imu.max_bad_share)?;
    let fixes = convert::fixes(gnss_t_ns, gnss_pos, gnss_vel, gnss_var)?;

    let mut job = Job::new(&config, engine.as_mut(), fixes);
    py.detach(|| job.run(&imu, progress.as_ref()))?;
    let Job { columns, log, order, .. } = job;

    let out = PyDict::new(py);
    let states = config.states(py)?;
    columns.fill(&out, states.len())?;
    out.set_item("states", state_list(py, &states)?)?;
    out.set_item("meas", records(py, &log.records, &order)?)?;
    out.set_item("events", event_list(py, &log.events, Some(&order))?)?;
    out.set_item("counts", count_dict(py, &engine.counts())?)?;
    let saved = engine.save().map_err(|e| errors::from_crate(py, &e))?;
    out.set_item("final_state", PyBytes::new(py, &saved))?;
    Ok(out)
}

struct Imu {
    t_ns: Vec<i64>,
    gyro: Vec<Vector3<f64>>,
    accel: Vec<Vector3<f64>>,
}

fn refuse_bad_share(py: Python<'_>, imu: &Imu, limit: f64) -> PyResult<()> {
    let bad = |v: &Vector3<f64>| v.iter().any(|x| !x.is_finite());
    let rows = imu.t_ns.len();
    let count = imu.gyro.iter().zip(&imu.accel).filter(|(g, a)| bad(g) || bad(a)).count();
    if rows == 0 {
        return Err(errors::input(py, "input.empty", "IMU table: 0 rows", "check the file and the time cut"));
    }
    if count as f64 <= limit * rows as f64 {
        return Ok(());
    }
    let first = imu.gyro.iter().zip(&imu.accel).position(|(g, a)| bad(g) || bad(a)).unwrap_or(0);
    Err(errors::input(
        py,
        "data.bad_share",
        &format!(
            "IMU table: {count} of {rows} rows hold NaN or infinity (first: row {first}), limit {:.1} %",
            100.0 * limit
        ),
        "clean the log, or raise [imu] max_bad_share",
    ))
}

/// A run on its way.
struct Job<'a> {
    engine: &'a mut dyn Engine,
    /// Fixes by time of validity, and their rows in the table.
    fixes: Vec<GnssFix>,
    order: Vec<usize>,
    columns: Columns,
    log: Log,
    output: Grid,
    covariance: Option<Grid>,
}

impl<'a> Job<'a> {
    fn new(config: &EngineConfig, engine: &'a mut dyn Engine, fixes: Vec<GnssFix>) -> Self {
        let mut order: Vec<usize> = (0..fixes.len()).collect();
        order.sort_by_key(|&i| fixes[i].t_ns);
        let fixes = order.iter().map(|&i| fixes[i]).collect();
        let every = config.output.covariance_interval_ns;
        Self {
            engine,
            fixes,
            order,
            columns: Columns::default(),
            log: Log::default(),
            output: Grid::new(config.output.interval_ns),
            covariance: (every > 0).then(|| Grid::new(every)),
        }
    }

    fn run(&mut self, imu: &Imu, progress: Option<&Py<PyAny>>) -> PyResult<()> {
        let mut next_fix = 0;
        let rows = imu.t_ns.len();
        for k in 0..rows {
            if k % ROWS_PER_LOOK == 0 {
                look(progress, k as f64 / rows as f64)?;
            }
            self.row(imu, k, &mut next_fix).map_err(|e| Python::attach(|py| errors::from_crate(py, &e)))?;
        }
        for fix in &self.fixes[next_fix..] {
            match self.engine.gnss(fix, &mut self.log) {
                // more fixes after the end of the IMU log than the queue holds: flush and go on
                Err(Error::QueueFull { .. }) => {
                    self.engine.finish(&mut self.log);
                    self.engine
                        .gnss(fix, &mut self.log)
                        .map_err(|e| Python::attach(|py| errors::from_crate(py, &e)))?;
                }
                other => other.map_err(|e| Python::attach(|py| errors::from_crate(py, &e)))?,
            }
        }
        self.engine.finish(&mut self.log);
        look(progress, 1.0)
    }

    fn row(&mut self, imu: &Imu, k: usize, next_fix: &mut usize) -> Result<(), Error> {
        let t_ns = imu.t_ns[k];
        while let Some(fix) = self.fixes.get(*next_fix).filter(|f| self.engine.valid_ns(f.t_ns) <= t_ns) {
            self.engine.gnss(fix, &mut self.log)?;
            *next_fix += 1;
        }
        self.engine.imu(t_ns, &imu.gyro[k], &imu.accel[k], &mut self.log)?;
        if self.engine.t_ns() == t_ns {
            if self.output.due(t_ns) {
                self.columns.push(self.engine);
            }
            if self.covariance.as_mut().is_some_and(|g| g.due(t_ns)) {
                self.columns.push_covariance(self.engine);
            }
        }
        Ok(())
    }
}

/// Lets Ctrl-C through and reports progress.
fn look(progress: Option<&Py<PyAny>>, share: f64) -> PyResult<()> {
    Python::attach(|py| {
        py.check_signals()?;
        if let Some(f) = progress {
            f.call1(py, (share,))?;
        }
        Ok(())
    })
}

/// States as a list of dictionaries.
pub fn state_list<'py>(py: Python<'py>, states: &[StateInfo]) -> PyResult<Bound<'py, PyList>> {
    let list = PyList::empty(py);
    for s in states {
        let d = PyDict::new(py);
        d.set_item("name", &s.name)?;
        d.set_item("unit", s.unit)?;
        d.set_item("scale", s.scale)?;
        d.set_item("block", &s.block)?;
        d.set_item("kind", s.kind)?;
        list.append(d)?;
    }
    Ok(list)
}

/// Measurement records as columns, by row of the table; `order` maps the order fed to rows.
pub fn records<'py>(py: Python<'py>, records: &[Record], order: &[usize]) -> PyResult<Bound<'py, PyDict>> {
    let row_of = |r: &Record| order.get(r.row as usize).map_or(r.row as i64, |&i| i as i64);
    let mut sorted: Vec<&Record> = records.iter().collect();
    sorted.sort_by_key(|r| row_of(r));
    let status = |r: &Record| match r.status {
        Status::Used => (0_u8, ""),
        Status::Rejected => (1, "chi-square gate"),
        Status::Late => (2, "valid outside the time span of the filter"),
        Status::Bad(reason) => (3, reason.text()),
    };
    let absent = |r: &Record, c: usize| r.present >> c & 1 == 0;
    let nan_or = |missing: bool, v: f64| if missing { f64::NAN } else { v };
    let mut innovation = Vec::with_capacity(6 * sorted.len());
    let mut cov = Vec::with_capacity(36 * sorted.len());
    for r in &sorted {
        for i in 0..6 {
            innovation.push(nan_or(absent(r, i), r.innovation[i]));
            for j in 0..6 {
                cov.push(nan_or(absent(r, i) || absent(r, j), r.innovation_cov[i][j]));
            }
        }
    }
    let out = PyDict::new(py);
    out.set_item("row", PyArray1::from_iter(py, sorted.iter().map(|r| row_of(r))))?;
    out.set_item("t_ns", PyArray1::from_iter(py, sorted.iter().map(|r| r.t_ns)))?;
    out.set_item("status", PyArray1::from_iter(py, sorted.iter().map(|r| status(r).0)))?;
    out.set_item("dof", PyArray1::from_iter(py, sorted.iter().map(|r| r.dof as u8)))?;
    out.set_item("nis", PyArray1::from_iter(py, sorted.iter().map(|r| nan_or(r.dof == 0, r.nis))))?;
    out.set_item("innovation", convert::array2(py, innovation, 6)?)?;
    out.set_item("innovation_cov", convert::array3(py, cov, 6, 6)?)?;
    out.set_item("reason", PyList::new(py, sorted.iter().map(|r| status(r).1))?)?;
    Ok(out)
}

/// Events as a list of dictionaries; `order` maps GNSS rows fed to rows of the table.
pub fn event_list<'py>(
    py: Python<'py>,
    events: &[Event],
    order: Option<&[usize]>,
) -> PyResult<Bound<'py, PyList>> {
    let list = PyList::empty(py);
    for e in events {
        let code = e.kind.code();
        let mapped = order.filter(|_| !code.starts_with("imu.")).and_then(|o| o.get(e.row as usize));
        let row = mapped.map_or(e.row, |&r| r as u64);
        let d = PyDict::new(py);
        d.set_item("t_ns", e.t_ns)?;
        d.set_item("code", code)?;
        d.set_item("row", row)?;
        d.set_item("value", e.value)?;
        d.set_item("message", e.kind.text())?;
        list.append(d)?;
    }
    Ok(list)
}

/// Row counts by source.
pub fn count_dict<'py>(py: Python<'py>, counts: &[Counts; 2]) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    for (source, c) in ["imu", "gnss"].iter().zip(counts) {
        let d = PyDict::new(py);
        for (key, v) in
            [("in", c.total), ("used", c.used), ("rejected", c.rejected), ("late", c.late), ("bad", c.bad)]
        {
            d.set_item(key, v)?;
        }
        out.set_item(source, d)?;
    }
    Ok(out)
}
