//! A whole log in one call or in pieces, with the GIL released.

use std::ops::Range;

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

use crate::block::ImuColumns;
use crate::config::{EngineConfig, StateInfo};
use crate::engine::{self, Engine, Linear, Log};
use crate::{convert, errors};

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
}

/// Snapshots of the covariance.
#[derive(Debug, Default)]
struct Snapshots {
    t_ns: Vec<i64>,
    matrix: Vec<f64>,
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

    /// Makes room for the rows that will come: no column is moved while it grows.
    fn reserve(&mut self, rows: usize, states: usize) {
        self.t_ns.reserve(rows);
        let blocks = states - gnssins::nav::NAV;
        for (column, width) in [
            (&mut self.lla, 3),
            (&mut self.v_n, 3),
            (&mut self.rpy, 3),
            (&mut self.q_nb, 4),
            (&mut self.sd, 9),
            (&mut self.x, blocks),
            (&mut self.x_sd, blocks),
        ] {
            column.reserve(rows * width);
        }
    }

    /// Hands the columns over to NumPy; `n` states.
    pub fn fill(self, out: &Bound<'_, PyDict>, n: usize) -> PyResult<()> {
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
        Ok(())
    }
}

/// Emits at the first row and then at the first row of each multiple of the interval, so that all outputs of a log, and
/// those of other logs on the same clock, share one grid.
pub struct Grid {
    interval_ns: i64,
    /// The cell of the last row.
    cell: Range<i64>,
}

impl Grid {
    pub fn new(interval_ns: i64) -> Self {
        Self { interval_ns: interval_ns.max(1), cell: 0..0 }
    }

    pub fn due(&mut self, t_ns: i64) -> bool {
        if self.cell.contains(&t_ns) {
            return false;
        }
        let start = t_ns.div_euclid(self.interval_ns).saturating_mul(self.interval_ns);
        self.cell = start..start.saturating_add(self.interval_ns);
        true
    }

    /// Rows that a stretch of a log with so many rows gives at most.
    pub fn rows(&self, rows: usize, (first_ns, last_ns): (i64, i64)) -> usize {
        let cells = last_ns.saturating_sub(first_ns) / self.interval_ns;
        rows.min(usize::try_from(cells).unwrap_or(0).saturating_add(2))
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
    let imu = ImuColumns::new(imu_t_ns, gyro, accel)?;
    refuse_bad_share(py, &imu, config.imu.max_bad_share)?;
    let aids = aids(gnss_t_ns, gnss_pos, gnss_vel, gnss_var, gnss_new, baro, heading)?;
    let mut job = Job::new(py, &config, aids)?;
    job.imu(py, &imu, progress.as_ref())?;
    job.finish(py)?;
    look(py, progress.as_ref(), 1.0)?;
    let out = job.take_columns(py)?;
    job.describe(&out)?;
    Ok(out)
}

/// A run whose IMU log comes in pieces, for logs that do not fit in memory. See the stub for shapes and units.
#[pyclass(module = "gnssins._core")]
pub struct Run(Job);

#[pymethods]
impl Run {
    #[new]
    #[pyo3(signature = (config_json, gnss_t_ns, gnss_pos, gnss_vel, gnss_var, *, gnss_new=None, baro=None, heading=None))]
    #[expect(clippy::too_many_arguments, reason = "columns of three tables")]
    fn new<'py>(
        py: Python<'py>,
        config_json: &str,
        gnss_t_ns: &Bound<'py, PyAny>,
        gnss_pos: &Bound<'py, PyAny>,
        gnss_vel: &Bound<'py, PyAny>,
        gnss_var: &Bound<'py, PyAny>,
        gnss_new: Option<&Bound<'py, PyAny>>,
        baro: Option<Scalar<'py>>,
        heading: Option<Scalar<'py>>,
    ) -> PyResult<Self> {
        let aids = aids(gnss_t_ns, gnss_pos, gnss_vel, gnss_var, gnss_new, baro, heading)?;
        Ok(Self(Job::new(py, &EngineConfig::parse(py, config_json)?, aids)?))
    }

    /// Name, unit, block and kind of every error state.
    fn states<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        state_list(py, &self.0.states)
    }

    /// Takes the next rows of the IMU log; the columns of the result that they give.
    fn imu<'py>(
        &mut self,
        t_ns: &Bound<'py, PyAny>,
        gyro: &Bound<'py, PyAny>,
        accel: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let py = t_ns.py();
        self.0.imu(py, &ImuColumns::new(t_ns, gyro, accel)?, None)?;
        self.0.take_columns(py)
    }

    /// Ends the log: what a run knows beside its columns.
    fn finish<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.0.finish(py)?;
        let out = PyDict::new(py);
        self.0.describe(&out)?;
        Ok(out)
    }
}

fn refuse_bad_share(py: Python<'_>, imu: &ImuColumns<'_>, limit: f64) -> PyResult<()> {
    let rows = imu.len();
    if rows == 0 {
        return Err(errors::input(py, "input.empty", "IMU table: 0 rows", "check the file and the time cut"));
    }
    let (mut count, mut first) = (0, None);
    imu.in_blocks(
        |_| Ok(()),
        |start, block| {
            for row in block.bad_rows() {
                count += 1;
                first.get_or_insert(start + row);
            }
            Ok(())
        },
    )?;
    match first {
        Some(first) if count as f64 > limit * rows as f64 => Err(errors::input(
            py,
            "data.bad_share",
            &format!(
                "IMU table: {count} of {rows} rows hold NaN or infinity (first: row {first}), limit {:.1} %",
                100.0 * limit
            ),
            "clean the log, or raise [imu] max_bad_share",
        )),
        _ => Ok(()),
    }
}

/// Columns of an aid with one value: stamps, values, variances.
type Scalar<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>);

/// Rows of the aids, by source.
type Aids = [Vec<Observation>; SOURCES];

/// Rows of the tables in the order in which they were fed, by source.
type Order = [Vec<usize>; SOURCES];

fn aids<'py>(
    gnss_t_ns: &Bound<'py, PyAny>,
    gnss_pos: &Bound<'py, PyAny>,
    gnss_vel: &Bound<'py, PyAny>,
    gnss_var: &Bound<'py, PyAny>,
    gnss_new: Option<&Bound<'py, PyAny>>,
    baro: Option<Scalar<'py>>,
    heading: Option<Scalar<'py>>,
) -> PyResult<Aids> {
    let mut fixes = convert::fixes(gnss_t_ns, gnss_pos, gnss_vel, gnss_var)?;
    for (fix, new) in fixes.iter_mut().zip(convert::marks(gnss_new, "gnss_new", gnss_t_ns.len()?)?) {
        fix.new_constellation = new;
    }
    let heights = convert::scalar_rows(baro, "baro")?.into_iter();
    let headings = convert::scalar_rows(heading, "heading")?.into_iter();
    Ok([
        fixes.into_iter().map(Observation::Gnss).collect(),
        heights
            .map(|(t_ns, height_m, variance)| Observation::Baro(BaroHeight { t_ns, height_m, variance }))
            .collect(),
        headings
            .map(|(t_ns, heading_rad, variance)| {
                Observation::Heading(Heading { t_ns, heading_rad, variance })
            })
            .collect(),
    ])
}

/// A run on its way.
struct Job {
    engine: Box<dyn Engine>,
    states: Vec<StateInfo>,
    /// Times of validity and rows of all aids, by that time.
    aids: Vec<(i64, Observation)>,
    /// The first of them that the engine does not have yet.
    next: usize,
    order: Order,
    columns: Columns,
    snapshots: Snapshots,
    log: Log,
    output: Grid,
    covariance: Option<Grid>,
}

impl Job {
    fn new(py: Python<'_>, config: &EngineConfig, tables: Aids) -> PyResult<Self> {
        let engine = engine::build(py, config)?;
        let states = config.states(py)?;
        let mut aids: Vec<(usize, i64, Observation)> = vec![];
        for (row, aid) in tables.into_iter().flat_map(|table| table.into_iter().enumerate()) {
            aids.push((row, engine.valid_ns(aid.source(), aid.t_ns()), aid));
        }
        // stable: where times are equal GNSS comes first, and rows keep their order
        aids.sort_by_key(|(_, valid_ns, _)| *valid_ns);
        let mut order = Order::default();
        for (row, _, aid) in &aids {
            order[aid.source().index()].push(*row);
        }
        let every = config.output.covariance_interval_ns;
        let linear = config.output.linearise.then(|| Linear::new(states.len()));
        Ok(Self {
            engine,
            states,
            aids: aids.into_iter().map(|(_, valid_ns, aid)| (valid_ns, aid)).collect(),
            next: 0,
            order,
            columns: Columns::default(),
            snapshots: Snapshots::default(),
            log: Log { linear, ..Log::default() },
            output: Grid::new(config.output.interval_ns),
            covariance: (every > 0).then(|| Grid::new(every)),
        })
    }

    fn imu(&mut self, py: Python<'_>, imu: &ImuColumns<'_>, progress: Option<&Py<PyAny>>) -> PyResult<()> {
        if let Some(span_ns) = imu.span_ns() {
            self.columns.reserve(self.output.rows(imu.len(), span_ns), self.states.len());
        }
        imu.in_blocks(
            |share| look(py, progress, share),
            |_, block| {
                for (t_ns, gyro, accel) in block.rows() {
                    self.row(t_ns, &gyro, &accel)
                        .map_err(|e| Python::attach(|py| errors::from_crate(py, &e)))?;
                }
                Ok(())
            },
        )
    }

    fn row(&mut self, t_ns: i64, gyro: &Vector3<f64>, accel: &Vector3<f64>) -> Result<(), Error> {
        while let Some((_, aid)) = self.aids.get(self.next).filter(|(valid_ns, _)| *valid_ns <= t_ns) {
            self.engine.aid(aid, &mut self.log)?;
            self.next += 1;
        }
        self.engine.imu(t_ns, gyro, accel, &mut self.log)?;
        if self.engine.t_ns() == t_ns {
            if self.output.due(t_ns) {
                self.columns.push(self.engine.as_ref());
            }
            if self.covariance.as_mut().is_some_and(|g| g.due(t_ns)) {
                self.snapshots.t_ns.push(t_ns);
                self.engine.covariance(&mut self.snapshots.matrix);
            }
        }
        Ok(())
    }

    /// Hands over the aids that come after the last IMU row and ends the log.
    fn finish(&mut self, py: Python<'_>) -> PyResult<()> {
        for (_, aid) in &self.aids[self.next..] {
            let mut taken = self.engine.aid(aid, &mut self.log);
            if let Err(Error::QueueFull { .. }) = taken {
                // more rows after the end of the IMU log than the queue holds: flush and go on
                self.engine.finish(&mut self.log);
                taken = self.engine.aid(aid, &mut self.log);
            }
            taken.map_err(|e| errors::from_crate(py, &e))?;
        }
        self.next = self.aids.len();
        self.engine.finish(&mut self.log);
        Ok(())
    }

    /// The columns since the last call.
    fn take_columns<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (out, n) = (PyDict::new(py), self.states.len());
        std::mem::take(&mut self.columns).fill(&out, n)?;
        let Snapshots { t_ns, matrix } = std::mem::take(&mut self.snapshots);
        out.set_item("cov_t_ns", PyArray1::from_vec(py, t_ns))?;
        out.set_item("cov", convert::array3(py, matrix, n, n)?)?;
        Ok(out)
    }

    /// States, records, events, counts and the saved engine.
    fn describe(&mut self, out: &Bound<'_, PyDict>) -> PyResult<()> {
        let (py, order) = (out.py(), &self.order);
        let log = std::mem::take(&mut self.log);
        out.set_item("states", state_list(py, &self.states)?)?;
        out.set_item("meas", records(py, &log.records, &order[Source::Gnss.index()])?)?;
        for source in [Source::Baro, Source::Heading] {
            let rows = scalar_records(py, &log.records, source, &order[source.index()])?;
            out.set_item(source.name(), rows)?;
        }
        out.set_item("events", event_list(py, &log.events, Some(order))?)?;
        out.set_item("counts", count_dict(py, self.engine.as_ref())?)?;
        if let Some(linear) = log.linear {
            out.set_item("lin", linear_dict(py, linear, self.states.len())?)?;
        }
        let saved = self.engine.save().map_err(|e| errors::from_crate(py, &e))?;
        out.set_item("final_state", PyBytes::new(py, &saved))
    }
}

/// Lets Ctrl-C through and reports progress.
fn look(py: Python<'_>, progress: Option<&Py<PyAny>>, share: f64) -> PyResult<()> {
    py.check_signals()?;
    if let Some(f) = progress {
        f.call1(py, (share,))?;
    }
    Ok(())
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
