//! Streaming: the same engine, row by row.

use gnssins::error::Error;
use gnssins::meas::Observation;
use gnssins::meas::baro::BaroHeight;
use gnssins::meas::heading::Heading;
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList};

use crate::config::{EngineConfig, StateInfo, list};
use crate::engine::{self, Engine, Log};
use crate::{convert, errors, run};

/// A filter fed sample by sample.
#[pyclass(module = "gnssins._core")]
pub struct Navigator {
    engine: Box<dyn Engine>,
    states: Vec<StateInfo>,
    log: Log,
}

impl Navigator {
    fn done(py: Python<'_>, result: Result<(), Error>) -> PyResult<()> {
        result.map_err(|e| errors::from_crate(py, &e))
    }
}

#[pymethods]
impl Navigator {
    #[new]
    fn new(py: Python<'_>, config_json: &str) -> PyResult<Self> {
        let config = EngineConfig::parse(py, config_json)?;
        Ok(Self { engine: engine::build(py, &config)?, states: config.states(py)?, log: Log::default() })
    }

    fn imu(&mut self, t_ns: i64, gyro: &Bound<'_, PyAny>, accel: &Bound<'_, PyAny>) -> PyResult<()> {
        let (w, f) = (convert::vector3(gyro, "gyro")?, convert::vector3(accel, "accel")?);
        Self::done(gyro.py(), self.engine.imu(t_ns, &w, &f, &mut self.log))
    }

    #[pyo3(signature = (t_ns, pos, vel, var, new_constellation=false))]
    fn gnss(
        &mut self,
        t_ns: i64,
        pos: Option<&Bound<'_, PyAny>>,
        vel: Option<&Bound<'_, PyAny>>,
        var: &Bound<'_, PyAny>,
        new_constellation: bool,
    ) -> PyResult<()> {
        let or_absent = |v: Option<&Bound<'_, PyAny>>, name| {
            v.map_or(Ok(nalgebra::Vector3::repeat(f64::NAN)), |v| convert::vector3(v, name))
        };
        let mut fix = convert::fix(
            t_ns,
            &or_absent(pos, "pos")?,
            &or_absent(vel, "vel")?,
            convert::one_covariance(var)?,
        );
        fix.new_constellation = new_constellation;
        Self::done(var.py(), self.engine.aid(&Observation::Gnss(fix), &mut self.log))
    }

    fn baro(&mut self, py: Python<'_>, t_ns: i64, height_m: f64, variance: f64) -> PyResult<()> {
        let row = Observation::Baro(BaroHeight { t_ns, height_m, variance });
        Self::done(py, self.engine.aid(&row, &mut self.log))
    }

    fn heading(&mut self, py: Python<'_>, t_ns: i64, heading_rad: f64, variance: f64) -> PyResult<()> {
        let row = Observation::Heading(Heading { t_ns, heading_rad, variance });
        Self::done(py, self.engine.aid(&row, &mut self.log))
    }

    fn finish(&mut self) {
        self.engine.finish(&mut self.log);
    }

    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (s, sd) = (self.engine.solution(), self.engine.solution_sd());
        let (roll, pitch, heading) = gnssins::attitude::to_euler(&s.q_nb);
        let (mut x, mut x_sd) = (vec![], vec![]);
        self.engine.blocks(&mut x, &mut x_sd);
        let sds = [&sd.position_m, &sd.velocity_m_s, &sd.euler_rad];
        let sds: Vec<f64> = sds.iter().flat_map(|v| list(v)).collect();
        let out = PyDict::new(py);
        out.set_item("t_ns", self.engine.t_ns())?;
        let p = s.position;
        for (key, values) in [
            ("lla", vec![p.lat_rad, p.lon_rad, p.height_m]),
            ("v_n", list(&s.v_n).to_vec()),
            ("rpy", vec![roll, pitch, heading]),
            ("q_nb", vec![s.q_nb.w, s.q_nb.i, s.q_nb.j, s.q_nb.k]),
            ("sd", sds),
            ("x", x),
            ("x_sd", x_sd),
        ] {
            out.set_item(key, PyArray1::from_vec(py, values))?;
        }
        Ok(out)
    }

    fn cov<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, numpy::PyArray2<f64>>> {
        let mut values = vec![];
        self.engine.covariance(&mut values);
        convert::array2(py, values, self.states.len())
    }

    fn states<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        run::state_list(py, &self.states)
    }

    fn save<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let saved = self.engine.save().map_err(|e| errors::from_crate(py, &e))?;
        Ok(PyBytes::new(py, &saved))
    }

    fn restore(&mut self, py: Python<'_>, saved: &[u8]) -> PyResult<()> {
        Self::done(py, self.engine.restore(saved))
    }

    fn take_measurements<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        run::all_records(py, &std::mem::take(&mut self.log.records))
    }

    fn take_events<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        run::event_list(py, &std::mem::take(&mut self.log.events), None)
    }

    fn counts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        run::count_dict(py, self.engine.as_ref())
    }
}
