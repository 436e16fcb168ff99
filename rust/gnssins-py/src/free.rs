//! INS without a filter: fed in pieces, and in three rates.

use gnssins::error::Error;
use gnssins::imu::ImuDelta;
use gnssins::inverse::FreeIns as Ins;
use gnssins::nav::ecef::Ecef;
use gnssins::nav::ned::Ned;
use gnssins::nav::three_rate::{Divisors, Gather, ThreeRate};
use gnssins::nav::{NavModel, Solution};
use gnssins::vertical::{Vertical, VerticalLoop};
use nalgebra::Vector3;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::maths::{Triple, choice, coning_by_name, earth, form_by_name, is_ecef, point, solutions};
use crate::{convert, errors};

/// Increments of one piece of a log: lengths of the intervals, angles, velocities, outer heights.
struct Piece {
    dt_s: Vec<f64>,
    dtheta: Vec<Vector3<f64>>,
    dvel: Vec<Vector3<f64>>,
    height_m: Option<Vec<f64>>,
}

#[derive(Clone)]
enum Model {
    Ned(Ins<Ned>),
    Ecef(Ins<Ecef>),
}

/// A free INS that keeps its state between the pieces of a log.
#[pyclass(module = "gnssins._core")]
pub struct FreeIns {
    model: Model,
    vertical: VerticalLoop,
    t_ns: i64,
}

#[pymethods]
impl FreeIns {
    #[new]
    #[pyo3(signature = (model, ellipsoid, gravity, coning, t_ns, lla0, v0, q0, *, attitude_form="rotation-vector", vertical_tau_s=None))]
    #[expect(clippy::too_many_arguments, reason = "model and start")]
    fn new(
        py: Python<'_>,
        model: &str,
        ellipsoid: &str,
        gravity: &str,
        coning: &str,
        t_ns: i64,
        lla0: &Bound<'_, PyAny>,
        v0: &Bound<'_, PyAny>,
        q0: &Bound<'_, PyAny>,
        attitude_form: &str,
        vertical_tau_s: Option<f64>,
    ) -> PyResult<Self> {
        let own = |e: Error| errors::from_crate(py, &e);
        let start = Solution {
            position: point(&convert::vector3(lla0, "lla0")?),
            v_n: convert::vector3(v0, "v0")?,
            q_nb: convert::one_quaternion(q0, "q0")?,
        };
        let (earth, coning) = (earth(py, ellipsoid, gravity)?, coning_by_name(py, coning)?);
        let form = form_by_name(py, attitude_form)?;
        let model = if is_ecef(py, model)? {
            let mut m = Ecef::new(earth, &start).map_err(own)?;
            m.set_attitude_form(form).map_err(own)?;
            Model::Ecef(Ins::new(m, coning))
        } else {
            let mut m = Ned::new(earth, &start).map_err(own)?;
            m.set_attitude_form(form).map_err(own)?;
            Model::Ned(Ins::new(m, coning))
        };
        let kind = vertical_tau_s.map_or(Vertical::Held, |tau_s| Vertical::Damped { tau_s });
        Ok(Self { model, vertical: VerticalLoop::new(kind).map_err(own)?, t_ns })
    }

    #[getter]
    fn t_ns(&self) -> i64 {
        self.t_ns
    }

    /// Position, velocity, attitude.
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let s = self.solution();
        let (p, v, q) = (s.position, s.v_n, s.q_nb);
        let rows = [vec![p.lat_rad, p.lon_rad, p.height_m], vec![v.x, v.y, v.z], vec![q.w, q.i, q.j, q.k]];
        PyTuple::new(py, rows.map(|r| numpy::PyArray1::from_vec(py, r)))
    }

    #[pyo3(signature = (lla=None, v_n=None, q_nb=None))]
    fn restart(
        &mut self,
        py: Python<'_>,
        lla: Option<&Bound<'_, PyAny>>,
        v_n: Option<&Bound<'_, PyAny>>,
        q_nb: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let mut next = self.solution();
        if let Some(lla) = lla {
            next.position = point(&convert::vector3(lla, "lla")?);
        }
        if let Some(v_n) = v_n {
            next.v_n = convert::vector3(v_n, "v_n")?;
        }
        if let Some(q_nb) = q_nb {
            next.q_nb = convert::one_quaternion(q_nb, "q_nb")?;
        }
        let done = match &mut self.model {
            Model::Ned(ins) => ins.restart(&next),
            Model::Ecef(ins) => ins.restart(&next),
        };
        done.map_err(|e| errors::from_crate(py, &e))
    }

    #[pyo3(signature = (t_ns, dtheta, dvel, height=None))]
    fn run<'py>(
        &mut self,
        py: Python<'py>,
        t_ns: &Bound<'py, PyAny>,
        dtheta: &Bound<'py, PyAny>,
        dvel: &Bound<'py, PyAny>,
        height: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Triple<'py>> {
        let t = convert::times(t_ns, "t_ns")?;
        let height_m = height.map(|h| convert::column(h, "height")).transpose()?;
        let heights = height_m.as_ref().map_or(t.len(), Vec::len);
        let (dtheta, dvel) = (convert::rows3(dtheta, "dtheta")?, convert::rows3(dvel, "dvel")?);
        convert::same_length(py, "FreeIns.run", &[t.len(), dtheta.len(), dvel.len(), heights])?;
        let piece = Piece { dt_s: intervals(py, self.t_ns, &t)?, dtheta, dvel, height_m };
        let (mut model, mut vertical) = (self.model.clone(), self.vertical);
        let rows = py.detach(|| match &mut model {
            Model::Ned(ins) => follow(ins, &mut vertical, &piece),
            Model::Ecef(ins) => follow(ins, &mut vertical, &piece),
        });
        let rows = rows.map_err(|e| errors::from_crate(py, &e))?;
        (self.model, self.vertical) = (model, vertical);
        self.t_ns = t.last().copied().unwrap_or(self.t_ns);
        solutions(py, &rows)
    }
}

impl FreeIns {
    fn solution(&self) -> Solution {
        match &self.model {
            Model::Ned(ins) => ins.model().solution(),
            Model::Ecef(ins) => ins.model().solution(),
        }
    }
}

/// Lengths of the intervals that end at the stamps, s.
fn intervals(py: Python<'_>, start_ns: i64, t_ns: &[i64]) -> PyResult<Vec<f64>> {
    let mut before = start_ns;
    let mut out = Vec::with_capacity(t_ns.len());
    for (row, &t) in t_ns.iter().enumerate() {
        if t <= before {
            let error = Error::TimeBackwards { row: row as u64, t_ns: t, previous_ns: before };
            return Err(errors::from_crate(py, &error));
        }
        out.push((t - before) as f64 / 1e9);
        before = t;
    }
    Ok(out)
}

fn follow<M: NavModel>(
    ins: &mut Ins<M>,
    vertical: &mut VerticalLoop,
    piece: &Piece,
) -> Result<Vec<Solution>, Error> {
    let mut rows = Vec::with_capacity(piece.dt_s.len());
    for (k, &dt_s) in piece.dt_s.iter().enumerate() {
        ins.step(&ImuDelta { dt_s, dtheta: piece.dtheta[k], dvel: piece.dvel[k] })?;
        if let Some(height) = &piece.height_m {
            let corrected = vertical.correct(&ins.model().solution(), height[k], dt_s)?;
            ins.restart(&corrected)?;
        }
        rows.push(ins.model().solution());
    }
    Ok(rows)
}

/// Free INS in three rates; row 0 is the start.
#[pyfunction]
#[pyo3(signature = (ellipsoid, gravity, coning, attitude_form, divisors, gather, t_ns, dtheta, dvel, lla0, v0, q0))]
#[expect(clippy::too_many_arguments, reason = "model, start and columns")]
pub fn strapdown_three_rate<'py>(
    py: Python<'py>,
    ellipsoid: &str,
    gravity: &str,
    coning: &str,
    attitude_form: &str,
    divisors: (u32, u32),
    gather: &str,
    t_ns: &Bound<'py, PyAny>,
    dtheta: &Bound<'py, PyAny>,
    dvel: &Bound<'py, PyAny>,
    lla0: &Bound<'py, PyAny>,
    v0: &Bound<'py, PyAny>,
    q0: &Bound<'py, PyAny>,
) -> PyResult<Triple<'py>> {
    let start = Solution {
        position: point(&convert::vector3(lla0, "lla0")?),
        v_n: convert::vector3(v0, "v0")?,
        q_nb: convert::one_quaternion(q0, "q0")?,
    };
    let (earth, coning) = (earth(py, ellipsoid, gravity)?, coning_by_name(py, coning)?);
    let form = form_by_name(py, attitude_form)?;
    let gather = Gather::by_name(gather).ok_or_else(|| choice(py, "gather", gather, "body, navigation"))?;
    let t = convert::times(t_ns, "t_ns")?;
    let (dtheta, dvel) = (convert::rows3(dtheta, "dtheta")?, convert::rows3(dvel, "dvel")?);
    convert::same_length(py, "strapdown_three_rate", &[t.len(), dtheta.len(), dvel.len()])?;
    let Some((&first, rest)) = t.split_first() else {
        return Err(errors::input(
            py,
            "input.empty",
            "strapdown_three_rate: 0 rows",
            "give at least the start",
        ));
    };
    let dt_s = intervals(py, first, rest)?;
    let divisors = Divisors { velocity: divisors.0, position: divisors.1 };
    let rows = py.detach(|| {
        let mut ins = ThreeRate::new(earth, form, coning, divisors, gather, &start)?;
        let mut rows = vec![ins.solution()];
        for (k, &dt_s) in dt_s.iter().enumerate() {
            ins.step(&ImuDelta { dt_s, dtheta: dtheta[k + 1], dvel: dvel[k + 1] })?;
            rows.push(ins.solution());
        }
        Ok(rows)
    });
    solutions(py, &rows.map_err(|e: Error| errors::from_crate(py, &e))?)
}
