//! Sets of simulated runs, with the GIL released.

use std::ops::ControlFlow;

use gnssins::earth::Ellipsoid;
use gnssins::ekf::Initial;
use gnssins::meas::Source;
use gnssins::monte_carlo::aids::{Aids, Antenna, Baro, Gnss, Headings, Place, SlowError};
use gnssins::monte_carlo::imu::{Axes, ErrorKind, Imu, SensorError, Triad};
use gnssins::monte_carlo::normal::stream;
use gnssins::monte_carlo::process::{COMPONENTS, Components, Law, LowPass};
use gnssins::monte_carlo::{
    BLOCK, CHUNK, Deviates, Epoch, Failure, Feed, Filter, Mode, MonteCarlo, Plan, Sums,
};
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::Ned;
use gnssins::nav::{NavModel, Solution};
use gnssins::presets::Model;
use nalgebra::Vector3;
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde::Deserialize;

use crate::config::{self, CAPACITY, EngineConfig};
use crate::{convert, errors};

/// Figures of a set in SI; arrays come beside it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Spec {
    seed: u64,
    shared: bool,
    ecef: bool,
    ellipsoid: String,
    rows: usize,
    after_ns: i64,
    gyro: TriadSpec,
    accel: TriadSpec,
    errors: Vec<ErrorSpec>,
    gnss: GnssSpec,
    baro: BaroSpec,
    heading_sd: f64,
    truths: Vec<Option<usize>>,
    groups: Vec<Vec<usize>>,
    gaps_ns: Vec<[i64; 2]>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct TriadSpec {
    density: [f64; 3],
    bandwidth_hz: Option<f64>,
    full_scale: Option<f64>,
    lsb: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ErrorSpec {
    kind: ErrorKind,
    name: String,
    process: Process,
    value: Vec<f64>,
    initial_sd: Vec<f64>,
    walk: Vec<f64>,
    sd: Vec<f64>,
    tau_s: Option<f64>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Process {
    Constant,
    RandomWalk,
    GaussMarkov,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct GnssSpec {
    uses: [bool; 2],
    lever_sd: [f64; 3],
    slow: [Option<SlowSpec>; 2],
    changes: Vec<usize>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SlowSpec {
    sd: [f64; 3],
    jump_sd: [f64; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct BaroSpec {
    sd: f64,
    initial_sd: f64,
    walk: f64,
}

/// Numbers of a process, the rest zero.
fn components(values: &[f64]) -> Components {
    let mut out = [0.0; COMPONENTS];
    out.iter_mut().zip(values).for_each(|(o, v)| *o = *v);
    out
}

impl TriadSpec {
    fn triad(&self, dt_s: f64) -> Triad {
        Triad {
            density: self.density,
            low_pass: self.bandwidth_hz.map(|corner| LowPass::new(corner, dt_s)),
            full_scale: self.full_scale,
            lsb: self.lsb,
        }
    }
}

impl ErrorSpec {
    fn error(&self, dt_s: f64) -> SensorError {
        let law = match self.process {
            Process::Constant => {
                Law::Constant { value: components(&self.value), sd: components(&self.initial_sd) }
            }
            Process::RandomWalk => Law::walk(components(&self.initial_sd), &components(&self.walk), dt_s),
            Process::GaussMarkov => {
                Law::markov(components(&self.sd), self.tau_s.unwrap_or(f64::INFINITY), dt_s)
            }
        };
        SensorError { kind: self.kind, stream: stream(&format!("imu.error.{}", self.name)), law }
    }
}

/// Columns of a set by name.
struct Columns<'py>(&'py Bound<'py, PyDict>);

impl Columns<'_> {
    fn get(&self, name: &str) -> PyResult<Bound<'_, PyAny>> {
        self.0.get_item(name)?.ok_or_else(|| {
            errors::input(self.0.py(), "input.missing", &format!("no column {name}"), "report this as a bug")
        })
    }

    fn times(&self, name: &str) -> PyResult<Vec<i64>> {
        convert::times(&self.get(name)?, name)
    }

    fn column(&self, name: &str) -> PyResult<Vec<f64>> {
        convert::column(&self.get(name)?, name)
    }

    fn rows3(&self, name: &str) -> PyResult<Vec<Vector3<f64>>> {
        convert::rows3(&self.get(name)?, name)
    }

    fn same(&self, what: &str, lengths: &[usize]) -> PyResult<()> {
        convert::same_length(self.0.py(), what, lengths)
    }

    /// Increments by blocks, without the row of the first epoch.
    fn blocks(&self, name: &str) -> PyResult<Vec<Axes>> {
        let rows = self.rows3(name)?;
        let mut out = vec![[[0.0; BLOCK]; 3]; rows.len().saturating_sub(1).div_ceil(BLOCK)];
        for (k, row) in rows.iter().skip(1).enumerate() {
            for axis in 0..3 {
                out[k / BLOCK][axis][k % BLOCK] = row[axis];
            }
        }
        Ok(out)
    }

    fn epochs(&self) -> PyResult<Vec<Epoch>> {
        let (rows, kinds) = (self.times("epoch_row")?, self.times("epoch_kind")?);
        let (lla, v_n) = (self.rows3("epoch_lla")?, self.rows3("epoch_v_n")?);
        let q_nb = convert::quaternions(&self.get("epoch_q_nb")?, "epoch_q_nb")?;
        self.same("epochs", &[rows.len(), kinds.len(), lla.len(), v_n.len(), q_nb.len()])?;
        let epoch = |k: usize| Epoch {
            row: rows[k] as usize,
            error: kinds[k] & 1 != 0,
            nees: kinds[k] & 2 != 0,
            truth: Solution {
                position: gnssins::frames::Lla::new(lla[k].x, lla[k].y, lla[k].z),
                v_n: v_n[k],
                q_nb: q_nb[k],
            },
        };
        Ok((0..rows.len()).map(epoch).collect())
    }

    fn feed(&self) -> PyResult<Vec<Feed>> {
        let (source, index) = (self.times("feed_source")?, self.times("feed_index")?);
        let (t_ns, new) = (self.times("feed_t_ns")?, self.times("feed_new")?);
        self.same("values of the aids", &[source.len(), index.len(), t_ns.len(), new.len()])?;
        let feed = |k: usize| Feed {
            source: Source::ALL[(source[k] as usize).min(Source::ALL.len() - 1)],
            index: index[k] as usize,
            t_ns: t_ns[k],
            new_constellation: new[k] != 0,
        };
        Ok((0..source.len()).map(feed).collect())
    }

    fn gnss(&self, spec: &GnssSpec, t_ns: &[i64]) -> PyResult<Gnss> {
        let (position, velocity) = (self.rows3("gnss_position")?, self.rows3("gnss_velocity")?);
        let (sd_p, sd_v) = (self.rows3("gnss_sd_position")?, self.rows3("gnss_sd_velocity")?);
        let place = places(t_ns, &self.times("gnss_t_ns")?);
        self.same("fixes", &[place.len(), position.len(), velocity.len(), sd_p.len(), sd_v.len()])?;
        let lever = if spec.lever_sd == [0.0; 3] {
            None
        } else {
            let matrices = |name: &str| convert::matrices3(&self.get(name)?, name);
            let both = (matrices("lever_position")?, matrices("lever_velocity")?);
            self.same("lever arm", &[place.len(), both.0.len(), both.1.len()])?;
            Some(both)
        };
        let antenna = (0..place.len()).map(|k| Antenna {
            position: position[k],
            velocity: velocity[k],
            per_lever: lever.as_ref().map(|(p, v)| (p[k], v[k])),
        });
        let slow = |part: usize, name: &str| -> PyResult<Option<SlowError>> {
            let Some(slow) = &spec.slow[part] else { return Ok(None) };
            let growth = self.column(&format!("growth_{name}"))?;
            let mut decay = vec![0.0; growth.len() + 1];
            for (k, g) in growth.iter().enumerate() {
                decay[k + 1] = decay[k] + g;
            }
            Ok(Some(SlowError {
                stream: stream(&format!("gnss.{name}_error")),
                law: Law::varying(components(&slow.sd), &growth),
                jump_stream: stream(&format!("gnss.{name}_error.jump")),
                jump_sd: slow.jump_sd,
                decay,
            }))
        };
        Ok(Gnss {
            antenna: antenna.collect(),
            sd: sd_p.iter().zip(&sd_v).map(|(p, v)| [p.x, p.y, p.z, v.x, v.y, v.z]).collect(),
            lever_sd: spec.lever_sd,
            slow: [slow(0, "position")?, slow(1, "velocity")?],
            changes: spec.changes.clone(),
            place,
        })
    }

    fn aids(&self, spec: &Spec, t_ns: &[i64], dt_s: f64) -> PyResult<Aids> {
        let (initial, walk) = (components(&[spec.baro.initial_sd]), components(&[spec.baro.walk]));
        let biased = spec.baro.initial_sd > 0.0 || spec.baro.walk > 0.0;
        Ok(Aids {
            gnss: self.gnss(&spec.gnss, t_ns)?,
            baro: Baro {
                place: places(t_ns, &self.times("baro_t_ns")?),
                height_m: self.column("baro_height")?,
                sd_m: spec.baro.sd,
                bias: biased.then(|| Law::walk(initial, &walk, dt_s)),
            },
            heading: Headings { heading_rad: self.column("heading_rad")?, sd_rad: spec.heading_sd },
        })
    }
}

/// Where times lie between epochs.
fn places(epochs: &[i64], t_ns: &[i64]) -> Vec<Place> {
    let place = |t: &i64| {
        let interval =
            epochs.partition_point(|e| e <= t).saturating_sub(1).min(epochs.len().saturating_sub(2));
        let (from, to) = (epochs[interval], epochs[interval + 1]);
        Place { interval, share: (t - from) as f64 / (to - from) as f64 }
    };
    t_ns.iter().map(place).collect()
}

fn plan(py: Python<'_>, engine: &EngineConfig, spec: &Spec, columns: &Columns<'_>) -> PyResult<Plan> {
    let t_ns = columns.times("t_ns")?;
    let exact = [columns.blocks("dtheta")?, columns.blocks("dvel")?];
    if t_ns.len() < 2 || !t_ns.windows(2).all(|pair| pair[0] < pair[1]) {
        return Err(errors::input(
            py,
            "input.empty",
            "a truth needs two epochs that ascend",
            "report this as a bug",
        ));
    }
    let intervals = t_ns.len() - 1;
    let mut dt_s = vec![[0.0; BLOCK]; intervals.div_ceil(BLOCK)];
    for (k, pair) in t_ns.windows(2).enumerate() {
        dt_s[k / BLOCK][k % BLOCK] = (pair[1] - pair[0]) as f64 / 1e9;
    }
    let mean_s = (t_ns[intervals] - t_ns[0]) as f64 / 1e9 / intervals as f64;
    let ellipsoid: Ellipsoid = config::ellipsoid(py, &spec.ellipsoid)?;
    let initial: Initial = engine.initial(py)?;
    Ok(Plan {
        seed: spec.seed,
        rows: spec.rows,
        ellipsoid,
        ecef: spec.ecef,
        initial,
        imu: Imu {
            dt_s,
            exact,
            triads: [spec.gyro.triad(mean_s), spec.accel.triad(mean_s)],
            errors: spec.errors.iter().map(|e| e.error(mean_s)).collect(),
        },
        aids: columns.aids(spec, &t_ns, mean_s)?,
        feed: columns.feed()?,
        uses: spec.gnss.uses,
        epochs: columns.epochs()?,
        after_ns: spec.after_ns,
        truths: spec.truths.clone(),
        groups: spec.groups.clone(),
        gaps: spec.gaps_ns.clone(),
        filter: Filter {
            settings: engine.settings(py)?,
            blocks: engine.blocks(py)?,
            stream: engine.stream(py)?,
            attitude_form: engine.attitude_form,
        },
        t_ns,
    })
}

/// What the binding asks of a set.
trait Set: Send + Sync {
    fn plan(&self) -> &Plan;
    fn run(
        &self,
        first: u32,
        last: u32,
        jobs: usize,
        take: &mut dyn FnMut(u32, Sums) -> ControlFlow<()>,
        go_on: &mut dyn FnMut() -> bool,
    ) -> Result<(), Failure>;
}

impl<M: NavModel + Send + Sync, const CAP: usize> Set for MonteCarlo<M, CAP> {
    fn plan(&self) -> &Plan {
        self.plan()
    }

    fn run(
        &self,
        first: u32,
        last: u32,
        jobs: usize,
        take: &mut dyn FnMut(u32, Sums) -> ControlFlow<()>,
        go_on: &mut dyn FnMut() -> bool,
    ) -> Result<(), Failure> {
        self.run(first..last, jobs, take, go_on)
    }
}

/// The smallest set that holds the configured states.
fn build(py: Python<'_>, model: Model, n: usize, plan: Plan, mode: Mode) -> PyResult<Box<dyn Set>> {
    match model {
        Model::Ned => sized::<Ned>(py, n, plan, mode),
        Model::Ecef => sized::<Ecef>(py, n, plan, mode),
    }
}

fn sized<M: NavModel + Send + Sync + 'static>(
    py: Python<'_>,
    n: usize,
    plan: Plan,
    mode: Mode,
) -> PyResult<Box<dyn Set>> {
    match n {
        0..=16 => boxed::<M, 16>(py, plan, mode),
        17..=24 => boxed::<M, 24>(py, plan, mode),
        25..=40 => boxed::<M, 40>(py, plan, mode),
        _ => boxed::<M, CAPACITY>(py, plan, mode),
    }
}

fn boxed<M: NavModel + Send + Sync + 'static, const CAP: usize>(
    py: Python<'_>,
    plan: Plan,
    mode: Mode,
) -> PyResult<Box<dyn Set>> {
    match py.detach(|| MonteCarlo::<M, CAP>::new(plan, mode)) {
        Ok(set) => Ok(Box::new(set)),
        Err(e) => Err(errors::from_crate(py, &e)),
    }
}

/// A set of runs. See the stub.
#[pyclass(name = "MonteCarlo", module = "gnssins._core", frozen)]
pub struct PyMonteCarlo {
    set: Box<dyn Set>,
}

#[pymethods]
impl PyMonteCarlo {
    #[new]
    fn new(
        py: Python<'_>,
        engine_json: &str,
        spec_json: &str,
        columns: &Bound<'_, PyDict>,
    ) -> PyResult<Self> {
        let engine = EngineConfig::parse(py, engine_json)?;
        let spec: Spec = serde_json::from_str(spec_json).map_err(|e| {
            errors::input(py, "config.json", &format!("Monte Carlo: {e}"), "use gnssins.monte_carlo")
        })?;
        let mode = if spec.shared { Mode::Shared } else { Mode::Full };
        let plan = plan(py, &engine, &spec, &Columns(columns))?;
        Ok(Self { set: build(py, engine.model, engine.state_count(), plan, mode)? })
    }

    /// Runs whose sums come together.
    #[classattr]
    const CHUNK: u32 = CHUNK;

    /// Goes through runs `first` .. `last - 1`.
    fn run(&self, py: Python<'_>, first: u32, last: u32, jobs: usize, take: Py<PyAny>) -> PyResult<()> {
        let (done, raised) = py.detach(|| {
            let raised = std::cell::RefCell::new(None);
            let keep = |result: PyResult<()>| match result {
                Ok(()) => true,
                Err(error) => {
                    raised.replace(Some(error));
                    false
                }
            };
            let mut give = |run: u32, sums: Sums| {
                let given = Python::attach(|py| take.call1(py, (run, sums_dict(py, &sums)?)).map(drop));
                if keep(given) { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
            };
            let mut go_on = || keep(Python::attach(|py| py.check_signals()));
            let done = self.set.run(first, last, jobs, &mut give, &mut go_on);
            (done, raised.into_inner())
        });
        match raised {
            Some(error) => Err(error),
            None => done.map_err(|failure| failed(py, &failure)),
        }
    }

    /// Sensors, aids and start of one run.
    fn simulated<'py>(&self, py: Python<'py>, run: u32) -> PyResult<Bound<'py, PyDict>> {
        let plan = self.set.plan();
        let made = py.detach(|| plan.simulated(run));
        let flat = |rows: &[[f64; 3]]| rows.iter().flatten().copied().collect::<Vec<_>>();
        let out = PyDict::new(py);
        out.set_item("gyro", convert::array2(py, flat(&made.increments[0]), 3)?)?;
        out.set_item("accel", convert::array2(py, flat(&made.increments[1]), 3)?)?;
        let positions = made.aids.fixes.iter().flat_map(|(p, _)| [p.lat_rad, p.lon_rad, p.height_m]);
        out.set_item("gnss_lla", convert::array2(py, positions.collect(), 3)?)?;
        let velocities: Vec<_> = made.aids.fixes.iter().map(|(_, v)| *v).collect();
        out.set_item("gnss_v_n", convert::from_rows3(py, &velocities)?)?;
        out.set_item("baro_height", PyArray1::from_vec(py, made.aids.heights_m))?;
        out.set_item("heading_rad", PyArray1::from_vec(py, made.aids.headings_rad))?;
        out.set_item("true_errors", convert::array2(py, made.true_errors, plan.columns())?)?;
        let Solution { position: p, v_n, q_nb: q } = made.initial.solution;
        out.set_item("lla", [p.lat_rad, p.lon_rad, p.height_m])?;
        out.set_item("v_n", config::list(&v_n))?;
        out.set_item("q_nb", [q.w, q.i, q.j, q.k])?;
        let error: Vec<f64> = made.initial_error.iter().flat_map(|v| v.iter().copied()).collect();
        out.set_item("initial_error", error)?;
        Ok(out)
    }
}

/// Normal deviates of a part of a stream of a run, from the first on.
#[pyfunction]
pub fn monte_carlo_deviates<'py>(
    py: Python<'py>,
    seed: u64,
    run: u32,
    name: &str,
    part: u32,
    count: usize,
) -> Bound<'py, PyArray1<f64>> {
    let deviates = Deviates::new(seed, run);
    let mut out = vec![[0.0; BLOCK]; count.div_ceil(BLOCK)];
    for (block, values) in out.chunks_mut(1).enumerate() {
        deviates.fill(stream(name), part, block as u32, values);
    }
    PyArray1::from_slice(py, &out.as_flattened()[..count])
}

fn failed(py: Python<'_>, failure: &Failure) -> PyErr {
    let error = errors::from_crate(py, &failure.error);
    // an error without a context stays as it is
    drop(error.value(py).getattr("context").and_then(|context| context.set_item("run", failure.run)));
    error
}

fn sums_dict<'py>(py: Python<'py>, sums: &Sums) -> PyResult<Bound<'py, PyDict>> {
    let nine = |rows: &[[f64; 9]]| convert::array2(py, rows.as_flattened().to_vec(), 9);
    let out = PyDict::new(py);
    out.set_item("runs", nine(&sums.runs)?)?;
    out.set_item("count", sums.count)?;
    out.set_item("squares", nine(&sums.squares)?)?;
    out.set_item("variances", nine(&sums.variances)?)?;
    out.set_item("nees", PyArray1::from_slice(py, &sums.nees))?;
    let nis = sums.nis.as_flattened();
    out.set_item("nis_sum", PyArray1::from_iter(py, nis.iter().map(|n| n.sum)))?;
    out.set_item("nis_count", PyArray1::from_iter(py, nis.iter().map(|n| n.count as i64)))?;
    out.set_item("gap_runs", PyArray1::from_iter(py, sums.gaps.iter().map(|g| g.runs as i64)))?;
    out.set_item("gap_squares", nine(&sums.gaps.iter().map(|g| g.squares).collect::<Vec<_>>())?)?;
    out.set_item("gap_variances", nine(&sums.gaps.iter().map(|g| g.variances).collect::<Vec<_>>())?)?;
    out.set_item("gap_ratios", nine(&sums.gaps.iter().map(|g| g.ratios).collect::<Vec<_>>())?)?;
    let counts = sums.counts.iter().flat_map(|c| [c.total, c.used, c.rejected, c.late, c.bad]);
    out.set_item("counts", PyArray1::from_iter(py, counts.map(|c| c as i64)))?;
    Ok(out)
}
