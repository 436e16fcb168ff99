//! Sets of simulated runs, with the GIL released.

mod plan;

use std::ops::ControlFlow;

use gnssins::monte_carlo::normal::stream;
use gnssins::monte_carlo::{BLOCK, CHUNK, Deviates, Failure, Mode, MonteCarlo, Plan, Sums};
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::Ned;
use gnssins::nav::{NavModel, Solution};
use gnssins::presets::Model;
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::config::{self, CAPACITY, EngineConfig};
use crate::{convert, errors};
use plan::{Columns, Spec};

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
        let plan = plan::plan(py, &engine, &spec, &Columns(columns))?;
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
