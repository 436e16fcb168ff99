//! Streaming: the same engine, row by row.

use gnssins::error::Error;
use gnssins::meas::Observation;
use gnssins::meas::baro::BaroHeight;
use gnssins::meas::heading::Heading;
use nalgebra::Vector3;
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList};

use crate::block::ImuColumns;
use crate::config::{EngineConfig, StateInfo, list};
use crate::engine::{self, Engine, Log};
use crate::run::{Columns, Grid};
use crate::{convert, errors, run};

/// A filter fed sample by sample: what the public class of the same name is made of.
#[pyclass(module = "gnssins._core", subclass)]
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

    /// Take one IMU row and move the state to its time.
    ///
    /// Parameters
    /// ----------
    /// t : float or int
    ///     Stamp: seconds as float, nanoseconds as int.
    /// gyro, accel : array_like, shape (3,)
    ///     Body axes, rad/s and m/s^2, or rad and m/s for increments (``[imu] kind``).
    ///
    /// Raises
    /// ------
    /// TimeOrderError, GapError
    ///     As configured; the row is then not taken.
    /// InputError
    ///     The time is no finite number, or the values are no numbers.
    fn imu(
        &mut self,
        t: &Bound<'_, PyAny>,
        gyro: &Bound<'_, PyAny>,
        accel: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let t_ns = convert::nanoseconds(t)?;
        let (w, f) = (convert::vector3(gyro, "gyro")?, convert::vector3(accel, "accel")?);
        Self::done(t.py(), self.engine.imu(t_ns, &w, &f, &mut self.log))
    }

    /// Take one IMU row as six numbers: :meth:`imu` without arrays, for the shortest call.
    ///
    /// Parameters
    /// ----------
    /// t : float or int
    ///     Stamp as in :meth:`imu`.
    /// wx, wy, wz, fx, fy, fz : float
    ///     Gyro and accelerometer along forward, right, down; units of :meth:`imu`.
    ///
    /// Raises
    /// ------
    /// TimeOrderError, GapError, InputError
    ///     As :meth:`imu`.
    /// TypeError
    ///     A value is no number.
    #[expect(clippy::too_many_arguments, reason = "six numbers are the point")]
    fn imu_xyz(
        &mut self,
        t: &Bound<'_, PyAny>,
        wx: f64,
        wy: f64,
        wz: f64,
        fx: f64,
        fy: f64,
        fz: f64,
    ) -> PyResult<()> {
        let (w, f) = (Vector3::new(wx, wy, wz), Vector3::new(fx, fy, fz));
        Self::done(t.py(), self.engine.imu(convert::nanoseconds(t)?, &w, &f, &mut self.log))
    }

    /// Takes rows, one after the other; the columns at the first row of every interval, all rows for 0, none for None.
    #[pyo3(name = "_imu_many", signature = (t_ns, gyro, accel, interval_ns=None))]
    fn imu_many<'py>(
        &mut self,
        t_ns: &Bound<'py, PyAny>,
        gyro: &Bound<'py, PyAny>,
        accel: &Bound<'py, PyAny>,
        interval_ns: Option<i64>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let py = t_ns.py();
        let (mut output, mut columns) = (interval_ns.map(Grid::new), Columns::default());
        ImuColumns::new(t_ns, gyro, accel)?.in_blocks(
            |_| py.check_signals(),
            |first, block| {
                for (row, (t_ns, gyro, accel)) in block.rows().enumerate() {
                    self.engine
                        .imu(t_ns, &gyro, &accel, &mut self.log)
                        .map_err(|e| Python::attach(|py| errors::in_block(py, &e, first + row)))?;
                    if output.as_mut().is_some_and(|grid| self.engine.t_ns() == t_ns && grid.due(t_ns)) {
                        columns.push(self.engine.as_ref());
                    }
                }
                Ok(())
            },
        )?;
        let out = PyDict::new(py);
        columns.fill(&out, self.states.len())?;
        Ok(out)
    }

    #[pyo3(name = "_gnss", signature = (t, pos, vel, var, new_constellation=false))]
    fn gnss(
        &mut self,
        t: &Bound<'_, PyAny>,
        pos: Option<&Bound<'_, PyAny>>,
        vel: Option<&Bound<'_, PyAny>>,
        var: &Bound<'_, PyAny>,
        new_constellation: bool,
    ) -> PyResult<()> {
        let or_absent = |v: Option<&Bound<'_, PyAny>>, name| {
            v.map_or(Ok(Vector3::repeat(f64::NAN)), |v| convert::vector3(v, name))
        };
        let mut fix = convert::fix(
            convert::nanoseconds(t)?,
            &or_absent(pos, "pos")?,
            &or_absent(vel, "vel")?,
            convert::one_covariance(var)?,
        );
        fix.new_constellation = new_constellation;
        Self::done(t.py(), self.engine.aid(&Observation::Gnss(fix), &mut self.log))
    }

    #[pyo3(name = "_baro")]
    fn baro(&mut self, t: &Bound<'_, PyAny>, height_m: f64, variance: f64) -> PyResult<()> {
        let row = Observation::Baro(BaroHeight { t_ns: convert::nanoseconds(t)?, height_m, variance });
        Self::done(t.py(), self.engine.aid(&row, &mut self.log))
    }

    #[pyo3(name = "_heading")]
    fn heading(&mut self, t: &Bound<'_, PyAny>, heading_rad: f64, variance: f64) -> PyResult<()> {
        let row = Observation::Heading(Heading { t_ns: convert::nanoseconds(t)?, heading_rad, variance });
        Self::done(t.py(), self.engine.aid(&row, &mut self.log))
    }

    /// End the stream: fixes that wait for an IMU row that will not come are counted as late.
    fn finish(&mut self) {
        self.engine.finish(&mut self.log);
    }

    #[pyo3(name = "_state")]
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

    #[pyo3(name = "_cov")]
    fn cov<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, numpy::PyArray2<f64>>> {
        let mut values = vec![];
        self.engine.covariance(&mut values);
        convert::array2(py, values, self.states.len())
    }

    #[pyo3(name = "_states")]
    fn states<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        run::state_list(py, &self.states)
    }

    /// Freeze the whole state, waiting fixes included, in bytes.
    fn save<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        let saved = self.engine.save().map_err(|e| errors::from_crate(py, &e))?;
        Ok(PyBytes::new(py, &saved))
    }

    /// Go on from what :meth:`save` gave, or from :attr:`gnssins.Result.final_state`: the same bits follow.
    ///
    /// Raises
    /// ------
    /// StateError
    ///     The bytes belong to another configuration; the navigator is then unchanged.
    fn restore(&mut self, py: Python<'_>, saved: &[u8]) -> PyResult<()> {
        Self::done(py, self.engine.restore(saved))
    }

    #[pyo3(name = "_take_measurements")]
    fn take_measurements<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        run::all_records(py, &std::mem::take(&mut self.log.records))
    }

    #[pyo3(name = "_take_events")]
    fn take_events<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        run::event_list(py, &std::mem::take(&mut self.log.events), None)
    }

    #[pyo3(name = "_counts")]
    fn counts<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        run::count_dict(py, self.engine.as_ref())
    }
}
