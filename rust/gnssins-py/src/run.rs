//! A whole log in one call, with the GIL released.

use gnssins::error::Error;
use gnssins::meas::baro::BaroHeight;
use gnssins::meas::heading::Heading;
use gnssins::meas::{Measurement, Observation, Record, SOURCES, Source, Status, Test};
use gnssins::small::ROWS_MAX;
use gnssins::stream::Event;
use nalgebra::Vector3;
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList};

use crate::config::{EngineConfig, StateInfo};
use crate::engine::{self, Engine, Linear, Log};
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
#[pyo3(signature = (config_json, imu_t_ns, gyro, accel, gnss_t_ns, gnss_pos, gnss_vel, gnss_var, progress=None,
    *, gnss_new=None, baro=None, heading=None))]
#[expect(clippy::too_many_arguments, reason = "columns of four tables")]
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
    gnss_new: Option<&Bound<'py, PyAny>>,
    baro: Option<Scalar<'py>>,
    heading: Option<Scalar<'py>>,
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
    let mut fixes = convert::fixes(gnss_t_ns, gnss_pos, gnss_vel, gnss_var)?;
    for (fix, new) in fixes.iter_mut().zip(convert::marks(gnss_new, "gnss_new", gnss_t_ns.len()?)?) {
        fix.new_constellation = new;
    }
    let heights = convert::scalar_rows(baro, "baro")?.into_iter();
    let headings = convert::scalar_rows(heading, "heading")?.into_iter();
    let aids = [
        fixes.into_iter().map(Observation::Gnss).collect(),
        heights
            .map(|(t_ns, height_m, variance)| Observation::Baro(BaroHeight { t_ns, height_m, variance }))
            .collect(),
        headings
            .map(|(t_ns, heading_rad, variance)| {
                Observation::Heading(Heading { t_ns, heading_rad, variance })
            })
            .collect(),
    ];

    let states = config.states(py)?;
    let mut job = Job::new(&config, engine.as_mut(), aids);
    job.log.linear = config.output.linearise.then(|| Linear::new(states.len()));
    py.detach(|| job.run(&imu, progress.as_ref()))?;
    let Job { columns, log, order, .. } = job;

    let out = PyDict::new(py);
    columns.fill(&out, states.len())?;
    out.set_item("states", state_list(py, &states)?)?;
    out.set_item("meas", records(py, &log.records, &order[Source::Gnss.index()])?)?;
    for source in [Source::Baro, Source::Heading] {
        out.set_item(source.name(), scalar_records(py, &log.records, source, &order[source.index()])?)?;
    }
    out.set_item("events", event_list(py, &log.events, Some(&order))?)?;
    out.set_item("counts", count_dict(py, engine.as_ref())?)?;
    if let Some(linear) = log.linear {
        out.set_item("lin", linear_dict(py, linear, states.len())?)?;
    }
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

/// Columns of an aid with one value: stamps, values, variances.
type Scalar<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>);

/// Rows of the tables in the order in which they were fed, by source.
type Order = [Vec<usize>; SOURCES];

/// A run on its way.
struct Job<'a> {
    engine: &'a mut dyn Engine,
    /// Rows of all aids by time of validity.
    aids: Vec<Observation>,
    order: Order,
    columns: Columns,
    log: Log,
    output: Grid,
    covariance: Option<Grid>,
}

impl<'a> Job<'a> {
    fn new(config: &EngineConfig, engine: &'a mut dyn Engine, tables: [Vec<Observation>; SOURCES]) -> Self {
        let mut aids: Vec<(usize, Observation)> =
            tables.into_iter().flat_map(|table| table.into_iter().enumerate()).collect();
        // stable: where times are equal GNSS comes first, and rows keep their order
        aids.sort_by_key(|(_, aid)| engine.valid_ns(aid.source(), aid.t_ns()));
        let mut order = Order::default();
        for (row, aid) in &aids {
            order[aid.source().index()].push(*row);
        }
        let aids = aids.into_iter().map(|(_, aid)| aid).collect();
        let every = config.output.covariance_interval_ns;
        Self {
            engine,
            aids,
            order,
            columns: Columns::default(),
            log: Log::default(),
            output: Grid::new(config.output.interval_ns),
            covariance: (every > 0).then(|| Grid::new(every)),
        }
    }

    fn run(&mut self, imu: &Imu, progress: Option<&Py<PyAny>>) -> PyResult<()> {
        let mut next = 0;
        let rows = imu.t_ns.len();
        for k in 0..rows {
            if k % ROWS_PER_LOOK == 0 {
                look(progress, k as f64 / rows as f64)?;
            }
            self.row(imu, k, &mut next).map_err(|e| Python::attach(|py| errors::from_crate(py, &e)))?;
        }
        for aid in &self.aids[next..] {
            match self.engine.aid(aid, &mut self.log) {
                // more rows after the end of the IMU log than the queue holds: flush and go on
                Err(Error::QueueFull { .. }) => {
                    self.engine.finish(&mut self.log);
                    self.engine
                        .aid(aid, &mut self.log)
                        .map_err(|e| Python::attach(|py| errors::from_crate(py, &e)))?;
                }
                other => other.map_err(|e| Python::attach(|py| errors::from_crate(py, &e)))?,
            }
        }
        self.engine.finish(&mut self.log);
        look(progress, 1.0)
    }

    fn row(&mut self, imu: &Imu, k: usize, next: &mut usize) -> Result<(), Error> {
        let t_ns = imu.t_ns[k];
        let due = |aid: &&Observation| self.engine.valid_ns(aid.source(), aid.t_ns()) <= t_ns;
        let ready = self.aids[*next..].iter().take_while(due).count();
        for aid in &self.aids[*next..*next + ready] {
            self.engine.aid(aid, &mut self.log)?;
        }
        *next += ready;
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

/// Row of the table that a record belongs to; `order` maps the order fed to rows.
fn row_of(record: &Record, order: &[usize]) -> i64 {
    order.get(record.row as usize).map_or(record.row as i64, |&i| i as i64)
}

/// What became of a measurement, and why, in words.
fn status(r: &Record) -> (u8, &'static str) {
    let test = r.test.map_or("", Test::text);
    match r.status {
        Status::Used => (0, test),
        Status::Rejected => (1, test),
        Status::Late => (2, "valid outside the time span of the filter"),
        Status::Bad(reason) => (3, reason.text()),
    }
}

/// Records of a source by row of its table.
fn sorted<'r>(records: &'r [Record], source: Source, order: &[usize]) -> Vec<&'r Record> {
    let mut of_source: Vec<&Record> = records.iter().filter(|r| r.source == source).collect();
    of_source.sort_by_key(|r| row_of(r, order));
    of_source
}

/// Columns that the records of all sources have.
fn common<'py>(py: Python<'py>, sorted: &[&Record], order: &[usize]) -> PyResult<Bound<'py, PyDict>> {
    let nis = |r: &&Record| if r.dof == 0 { f64::NAN } else { r.nis };
    let out = PyDict::new(py);
    out.set_item("row", PyArray1::from_iter(py, sorted.iter().map(|r| row_of(r, order))))?;
    out.set_item("t_ns", PyArray1::from_iter(py, sorted.iter().map(|r| r.t_ns)))?;
    out.set_item("status", PyArray1::from_iter(py, sorted.iter().map(|r| status(r).0)))?;
    out.set_item("dof", PyArray1::from_iter(py, sorted.iter().map(|r| r.dof as u8)))?;
    out.set_item("nis", PyArray1::from_iter(py, sorted.iter().map(nis)))?;
    out.set_item("refused", PyArray1::from_iter(py, sorted.iter().map(|r| r.refused)))?;
    out.set_item("reason", PyList::new(py, sorted.iter().map(|r| status(r).1))?)?;
    Ok(out)
}

/// Records of an aid with one value as columns, by row of its table.
fn scalar_records<'py>(
    py: Python<'py>,
    records: &[Record],
    source: Source,
    order: &[usize],
) -> PyResult<Bound<'py, PyDict>> {
    let sorted = sorted(records, source, order);
    let out = common(py, &sorted, order)?;
    let known = |r: &&Record, v: f64| if r.dof == 0 { f64::NAN } else { v };
    let innovation = sorted.iter().map(|r| known(r, r.innovation[0]));
    out.set_item("innovation", PyArray1::from_iter(py, innovation))?;
    let variance = sorted.iter().map(|r| known(r, r.innovation_cov[0][0]));
    out.set_item("variance", PyArray1::from_iter(py, variance))?;
    Ok(out)
}

/// Measurement records of the receiver as columns, by row of the table; `order` maps the order fed to rows.
pub fn records<'py>(py: Python<'py>, records: &[Record], order: &[usize]) -> PyResult<Bound<'py, PyDict>> {
    let sorted = sorted(records, Source::Gnss, order);
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
    let out = common(py, &sorted, order)?;
    out.set_item("innovation", convert::array2(py, innovation, 6)?)?;
    out.set_item("innovation_cov", convert::array3(py, cov, 6, 6)?)?;
    Ok(out)
}

/// Records of all sources, in the order fed.
pub fn all_records<'py>(py: Python<'py>, of: &[Record]) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    out.set_item(Source::Gnss.name(), records(py, of, &[])?)?;
    for source in [Source::Baro, Source::Heading] {
        out.set_item(source.name(), scalar_records(py, of, source, &[])?)?;
    }
    Ok(out)
}

/// The linearised system as columns.
fn linear_dict<'py>(py: Python<'py>, linear: Linear, n: usize) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("t_ns", PyArray1::from_vec(py, linear.t_ns))?;
    out.set_item("phi", convert::array3(py, linear.phi, n, n)?)?;
    out.set_item("h", convert::array3(py, linear.h, ROWS_MAX, n)?)?;
    out.set_item("r", convert::array3(py, linear.r, ROWS_MAX, ROWS_MAX)?)?;
    out.set_item("lla", convert::array2(py, linear.lla, 3)?)?;
    out.set_item("q_nb", convert::array2(py, linear.q_nb, 4)?)?;
    Ok(out)
}

/// Events as a list of dictionaries; `order` maps rows fed to rows of the tables.
pub fn event_list<'py>(
    py: Python<'py>,
    events: &[Event],
    order: Option<&Order>,
) -> PyResult<Bound<'py, PyList>> {
    let list = PyList::empty(py);
    for e in events {
        let code = e.kind.code();
        let source = match e.kind.source() {
            Some(source) => Some(source),
            None if code.starts_with("imu.") => None,
            None => Some(Source::Gnss),
        };
        let mapped = order.zip(source).and_then(|(o, s)| o[s.index()].get(e.row as usize));
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

/// Row counts by source; of the aids beside GNSS only those that were fed.
pub fn count_dict<'py>(py: Python<'py>, engine: &dyn Engine) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let aids = Source::ALL.iter().zip(engine.counts()).map(|(s, c)| (s.name(), c));
    let always = ["imu", Source::Gnss.name()];
    for (name, c) in std::iter::once(("imu", engine.imu_counts())).chain(aids) {
        if c.total == 0 && !always.contains(&name) {
            continue;
        }
        let d = PyDict::new(py);
        for (key, v) in
            [("in", c.total), ("used", c.used), ("rejected", c.rejected), ("late", c.late), ("bad", c.bad)]
        {
            d.set_item(key, v)?;
        }
        out.set_item(name, d)?;
    }
    Ok(out)
}
