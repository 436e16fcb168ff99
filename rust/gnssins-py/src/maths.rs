//! Vectorised functions of the crate over NumPy arrays.

use gnssins::earth::{Ellipsoid, Gravity};
use gnssins::frames::{self, Ecef as EcefPoint, Lla};
use gnssins::imu::{Coning, ImuDelta};
use gnssins::inverse::FreeIns;
use gnssins::nav::ecef::Ecef;
use gnssins::nav::kinematics::AttitudeForm;
use gnssins::nav::ned::Ned;
use gnssins::nav::{EarthModel, NavModel, Solution};
use gnssins::{attitude, error::Error};
use nalgebra::{SMatrix, UnitQuaternion, Vector3};
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::config::ellipsoid as ellipsoid_by_name;
use crate::{convert, errors};

type Rows<'py> = PyResult<Bound<'py, PyArray2<f64>>>;

/// Position, velocity and attitude columns, or position and increments.
pub type Triple<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

/// Adds the functions to the module.
pub fn register(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(radii, m)?)?;
    m.add_function(wrap_pyfunction!(gravity_n, m)?)?;
    m.add_function(wrap_pyfunction!(lla_to_ecef, m)?)?;
    m.add_function(wrap_pyfunction!(ecef_to_lla, m)?)?;
    m.add_function(wrap_pyfunction!(euler_to_quat, m)?)?;
    m.add_function(wrap_pyfunction!(quat_to_euler, m)?)?;
    m.add_function(wrap_pyfunction!(quat_to_dcm, m)?)?;
    m.add_function(wrap_pyfunction!(dcm_to_quat, m)?)?;
    m.add_function(wrap_pyfunction!(rotvec_to_quat, m)?)?;
    m.add_function(wrap_pyfunction!(quat_to_rotvec, m)?)?;
    m.add_function(wrap_pyfunction!(quat_mul, m)?)?;
    m.add_function(wrap_pyfunction!(strapdown, m)?)?;
    m.add_function(wrap_pyfunction!(invert_strapdown, m)?)?;
    m.add_function(wrap_pyfunction!(error_dynamics, m)?)?;
    m.add_function(wrap_pyfunction!(aiding_jacobians, m)?)
}

#[pyfunction]
fn radii<'py>(lat: &Bound<'py, PyAny>, ellipsoid: &str) -> Rows<'py> {
    let py = lat.py();
    let e = ellipsoid_by_name(py, ellipsoid)?;
    let rows = convert::column(lat, "lat")?.into_iter().flat_map(|lat| {
        let r = e.radii(lat.sin());
        [r.meridian_m, r.prime_vertical_m]
    });
    convert::array2(py, rows.collect(), 2)
}

#[pyfunction]
#[pyo3(signature = (lat, height, ellipsoid, gravity="normal"))]
fn gravity_n<'py>(
    lat: &Bound<'py, PyAny>,
    height: &Bound<'py, PyAny>,
    ellipsoid: &str,
    gravity: &str,
) -> Rows<'py> {
    let py = lat.py();
    let earth = earth(py, ellipsoid, gravity)?;
    let (lat, height) = (convert::column(lat, "lat")?, convert::column(height, "height")?);
    convert::same_length(py, "gravity_n", &[lat.len(), height.len()])?;
    let rows: Vec<_> = lat
        .iter()
        .zip(&height)
        .map(|(l, h)| earth.ellipsoid.gravity_n(earth.gravity, l.sin(), l.cos(), *h))
        .collect();
    convert::from_rows3(py, &rows)
}

#[pyfunction]
fn lla_to_ecef<'py>(lla: &Bound<'py, PyAny>, ellipsoid: &str) -> Rows<'py> {
    let e = ellipsoid_by_name(lla.py(), ellipsoid)?;
    map3(lla, "lla", |v| frames::lla_to_ecef(&e, &point(v)).0)
}

#[pyfunction]
fn ecef_to_lla<'py>(ecef: &Bound<'py, PyAny>, ellipsoid: &str) -> Rows<'py> {
    let e = ellipsoid_by_name(ecef.py(), ellipsoid)?;
    map3(ecef, "ecef", |v| from_point(&frames::ecef_to_lla(&e, &EcefPoint(*v))))
}

#[pyfunction]
fn euler_to_quat<'py>(rpy: &Bound<'py, PyAny>) -> Rows<'py> {
    let q: Vec<_> = convert::rows3(rpy, "rpy")?.iter().map(|v| attitude::from_euler(v.x, v.y, v.z)).collect();
    convert::from_quaternions(rpy.py(), &q)
}

#[pyfunction]
fn quat_to_euler<'py>(q: &Bound<'py, PyAny>) -> Rows<'py> {
    let rows: Vec<_> = convert::quaternions(q, "q")?
        .iter()
        .map(|q| {
            let (roll, pitch, heading) = attitude::to_euler(q);
            Vector3::new(roll, pitch, heading)
        })
        .collect();
    convert::from_rows3(q.py(), &rows)
}

#[pyfunction]
fn quat_to_dcm<'py>(q: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let values = convert::quaternions(q, "q")?;
    let values = values.iter().flat_map(|q| convert::row_major(attitude::dcm(q))).collect();
    convert::array3(q.py(), values, 3, 3)
}

#[pyfunction]
fn dcm_to_quat<'py>(c: &Bound<'py, PyAny>) -> Rows<'py> {
    let matrices = convert::matrices3(c, "c")?;
    let q: Vec<_> = matrices.iter().map(attitude::from_dcm).collect();
    convert::from_quaternions(c.py(), &q)
}

#[pyfunction]
fn rotvec_to_quat<'py>(rotvec: &Bound<'py, PyAny>) -> Rows<'py> {
    let q: Vec<_> = convert::rows3(rotvec, "rotvec")?.iter().map(attitude::exp).collect();
    convert::from_quaternions(rotvec.py(), &q)
}

#[pyfunction]
fn quat_to_rotvec<'py>(q: &Bound<'py, PyAny>) -> Rows<'py> {
    let rows: Vec<_> = convert::quaternions(q, "q")?.iter().map(attitude::log).collect();
    convert::from_rows3(q.py(), &rows)
}

#[pyfunction]
fn quat_mul<'py>(a: &Bound<'py, PyAny>, b: &Bound<'py, PyAny>) -> Rows<'py> {
    let (p, q) = (convert::quaternions(a, "a")?, convert::quaternions(b, "b")?);
    convert::same_length(a.py(), "quat_mul", &[p.len(), q.len()])?;
    let rows: Vec<_> = p.iter().zip(&q).map(|(p, q)| attitude::renormalise(&(p * q))).collect();
    convert::from_quaternions(a.py(), &rows)
}

/// Error-free INS over given increments; row 0 is the start.
#[pyfunction]
#[pyo3(signature = (model, ellipsoid, gravity, coning, t_ns, dtheta, dvel, lla0, v0, q0, *, attitude_form="rotation-vector"))]
#[expect(clippy::too_many_arguments, reason = "model, start and columns")]
fn strapdown<'py>(
    py: Python<'py>,
    model: &str,
    ellipsoid: &str,
    gravity: &str,
    coning: &str,
    t_ns: &Bound<'py, PyAny>,
    dtheta: &Bound<'py, PyAny>,
    dvel: &Bound<'py, PyAny>,
    lla0: &Bound<'py, PyAny>,
    v0: &Bound<'py, PyAny>,
    q0: &Bound<'py, PyAny>,
    attitude_form: &str,
) -> PyResult<Triple<'py>> {
    let start = Solution {
        position: point(&convert::vector3(lla0, "lla0")?),
        v_n: convert::vector3(v0, "v0")?,
        q_nb: convert::one_quaternion(q0, "q0")?,
    };
    let setup = Setup {
        earth: earth(py, ellipsoid, gravity)?,
        coning: coning_by_name(py, coning)?,
        form: form_by_name(py, attitude_form)?,
        start,
    };
    let t = convert::times(t_ns, "t_ns")?;
    let (dtheta, dvel) = (convert::rows3(dtheta, "dtheta")?, convert::rows3(dvel, "dvel")?);
    convert::same_length(py, "strapdown", &[t.len(), dtheta.len(), dvel.len()])?;
    let ecef = is_ecef(py, model)?;
    let rows = py.detach(|| match ecef {
        true => forward::<Ecef>(&setup, &t, &dtheta, &dvel),
        false => forward::<Ned>(&setup, &t, &dtheta, &dvel),
    });
    let rows = rows.map_err(|e| errors::from_crate(py, &e))?;
    solutions(py, &rows)
}

/// Solutions as columns: position, velocity, attitude.
pub fn solutions<'py>(py: Python<'py>, rows: &[Solution]) -> PyResult<Triple<'py>> {
    let lla: Vec<_> = rows.iter().map(|s| from_point(&s.position)).collect();
    let v: Vec<_> = rows.iter().map(|s| s.v_n).collect();
    let q: Vec<_> = rows.iter().map(|s| s.q_nb).collect();
    Ok((convert::from_rows3(py, &lla)?, convert::from_rows3(py, &v)?, convert::from_quaternions(py, &q)?))
}

/// Increments of an ideal IMU on a motion given by velocity and attitude; row 0 is the start.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "model, start and columns")]
fn invert_strapdown<'py>(
    py: Python<'py>,
    model: &str,
    ellipsoid: &str,
    gravity: &str,
    coning: &str,
    t_ns: &Bound<'py, PyAny>,
    lla0: &Bound<'py, PyAny>,
    v_n: &Bound<'py, PyAny>,
    q_nb: &Bound<'py, PyAny>,
) -> PyResult<Triple<'py>> {
    let t = convert::times(t_ns, "t_ns")?;
    let (v, q) = (convert::rows3(v_n, "v_n")?, convert::quaternions(q_nb, "q_nb")?);
    convert::same_length(py, "invert_strapdown", &[t.len(), v.len(), q.len()])?;
    let (Some(v0), Some(q0)) = (v.first(), q.first()) else {
        return Err(errors::input(py, "input.empty", "invert_strapdown: 0 rows", "give at least the start"));
    };
    let start = Solution { position: point(&convert::vector3(lla0, "lla0")?), v_n: *v0, q_nb: *q0 };
    let setup = Setup {
        earth: earth(py, ellipsoid, gravity)?,
        coning: coning_by_name(py, coning)?,
        form: AttitudeForm::default(),
        start,
    };
    let ecef = is_ecef(py, model)?;
    let rows = py.detach(|| match ecef {
        true => backward::<Ecef>(&setup, &t, &v, &q),
        false => backward::<Ned>(&setup, &t, &v, &q),
    });
    let rows = rows.map_err(|e| errors::from_crate(py, &e))?;
    let lla: Vec<_> = rows.iter().map(|(p, _)| from_point(p)).collect();
    let dtheta: Vec<_> = rows.iter().map(|(_, d)| d.dtheta).collect();
    let dvel: Vec<_> = rows.iter().map(|(_, d)| d.dvel).collect();
    Ok((convert::from_rows3(py, &lla)?, convert::from_rows3(py, &dtheta)?, convert::from_rows3(py, &dvel)?))
}

struct Setup {
    earth: EarthModel,
    coning: Coning,
    form: AttitudeForm,
    start: Solution,
}

fn interval_s(t: &[i64]) -> f64 {
    (t[1] - t[0]) as f64 / 1e9
}

fn forward<M: NavModel>(
    setup: &Setup,
    t: &[i64],
    dtheta: &[Vector3<f64>],
    dvel: &[Vector3<f64>],
) -> Result<Vec<Solution>, Error> {
    let mut model = M::new(setup.earth, &setup.start)?;
    model.set_attitude_form(setup.form)?;
    let mut ins = FreeIns::new(model, setup.coning);
    let mut rows = vec![setup.start];
    for (k, pair) in t.windows(2).enumerate() {
        ins.step(&ImuDelta { dt_s: interval_s(pair), dtheta: dtheta[k + 1], dvel: dvel[k + 1] })?;
        rows.push(ins.model().solution());
    }
    Ok(rows)
}

fn backward<M: NavModel>(
    setup: &Setup,
    t: &[i64],
    v: &[Vector3<f64>],
    q: &[UnitQuaternion<f64>],
) -> Result<Vec<(Lla, ImuDelta)>, Error> {
    let mut ins = FreeIns::new(M::new(setup.earth, &setup.start)?, setup.coning);
    let none = ImuDelta { dt_s: 0.0, dtheta: Vector3::zeros(), dvel: Vector3::zeros() };
    let mut rows = vec![(setup.start.position, none)];
    for (k, pair) in t.windows(2).enumerate() {
        let delta = ins.step_to(interval_s(pair), &v[k + 1], &q[k + 1])?;
        rows.push((ins.model().solution().position, delta));
    }
    Ok(rows)
}

/// Error dynamics of a model at one point, for tests and analysis.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one point in full")]
fn error_dynamics<'py>(
    py: Python<'py>,
    model: &str,
    ellipsoid: &str,
    gravity: &str,
    lla: &Bound<'py, PyAny>,
    v_n: &Bound<'py, PyAny>,
    q_nb: &Bound<'py, PyAny>,
    f_b: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyDict>> {
    let start = Solution {
        position: point(&convert::vector3(lla, "lla")?),
        v_n: convert::vector3(v_n, "v_n")?,
        q_nb: convert::one_quaternion(q_nb, "q_nb")?,
    };
    let earth = earth(py, ellipsoid, gravity)?;
    let f_b = convert::vector3(f_b, "f_b")?;
    let own = |e: Error| errors::from_crate(py, &e);
    let d = match is_ecef(py, model)? {
        true => Ecef::new(earth, &start).map_err(own)?.dynamics(&f_b),
        false => Ned::new(earth, &start).map_err(own)?.dynamics(&f_b),
    };
    let out = PyDict::new(py);
    out.set_item("f", dense(py, &d.f())?)?;
    out.set_item("gyro", dense(py, &d.gyro_coupling())?)?;
    out.set_item("accel", dense(py, &d.accel_coupling())?)?;
    Ok(out)
}

/// Jacobians of antenna position and velocity at one point, for tests and analysis.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "one point in full")]
fn aiding_jacobians<'py>(
    py: Python<'py>,
    model: &str,
    ellipsoid: &str,
    lla: &Bound<'py, PyAny>,
    v_n: &Bound<'py, PyAny>,
    q_nb: &Bound<'py, PyAny>,
    w_ib_b: &Bound<'py, PyAny>,
    lever_b: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyDict>> {
    let start = Solution {
        position: point(&convert::vector3(lla, "lla")?),
        v_n: convert::vector3(v_n, "v_n")?,
        q_nb: convert::one_quaternion(q_nb, "q_nb")?,
    };
    let earth = EarthModel { ellipsoid: ellipsoid_by_name(py, ellipsoid)?, gravity: Gravity::Normal };
    let (w, lever) = (convert::vector3(w_ib_b, "w_ib_b")?, convert::vector3(lever_b, "lever_b")?);
    let own = |e: Error| errors::from_crate(py, &e);
    let at = Some(&start.position);
    let (p, v) = match is_ecef(py, model)? {
        true => {
            let m = Ecef::new(earth, &start).map_err(own)?;
            (m.position_aid(&lever, &start.position), m.velocity_aid(&lever, &w, &start.v_n, at))
        }
        false => {
            let m = Ned::new(earth, &start).map_err(own)?;
            (m.position_aid(&lever, &start.position), m.velocity_aid(&lever, &w, &start.v_n, at))
        }
    };
    let out = PyDict::new(py);
    out.set_item("position", dense(py, &p.h)?)?;
    out.set_item("position_lever", dense(py, &p.h_lever)?)?;
    out.set_item("velocity", dense(py, &v.h)?)?;
    out.set_item("velocity_gyro", dense(py, &v.h_gyro)?)?;
    out.set_item("velocity_lever", dense(py, &v.h_lever)?)?;
    Ok(out)
}

fn dense<'py, const R: usize, const C: usize>(py: Python<'py>, m: &SMatrix<f64, R, C>) -> Rows<'py> {
    convert::array2(py, m.transpose().iter().copied().collect(), C)
}

fn map3<'py>(rows: &Bound<'py, PyAny>, name: &str, f: impl Fn(&Vector3<f64>) -> Vector3<f64>) -> Rows<'py> {
    let out: Vec<_> = convert::rows3(rows, name)?.iter().map(f).collect();
    convert::from_rows3(rows.py(), &out)
}

pub fn point(v: &Vector3<f64>) -> Lla {
    Lla::new(v.x, v.y, v.z)
}

fn from_point(p: &Lla) -> Vector3<f64> {
    Vector3::new(p.lat_rad, p.lon_rad, p.height_m)
}

pub fn choice(py: Python<'_>, what: &str, got: &str, known: &str) -> PyErr {
    errors::input(
        py,
        "config.choice",
        &format!("{what} \"{got}\" is not known"),
        &format!("use one of {known}"),
    )
}

pub fn earth(py: Python<'_>, ellipsoid: &str, gravity: &str) -> PyResult<EarthModel> {
    let ellipsoid: Ellipsoid = ellipsoid_by_name(py, ellipsoid)?;
    let gravity = match gravity {
        "normal" => Gravity::Normal,
        "vertical" => Gravity::NormalVertical,
        other => return Err(choice(py, "gravity", other, "normal, vertical")),
    };
    Ok(EarthModel { ellipsoid, gravity })
}

pub fn coning_by_name(py: Python<'_>, name: &str) -> PyResult<Coning> {
    match name {
        "one-sample" => Ok(Coning::OneSample),
        "two-sample" => Ok(Coning::TwoSample),
        "third-order" => Ok(Coning::ThirdOrder),
        other => Err(choice(py, "coning", other, "one-sample, two-sample, third-order")),
    }
}

pub fn form_by_name(py: Python<'_>, name: &str) -> PyResult<AttitudeForm> {
    AttitudeForm::by_name(name).ok_or_else(|| {
        let known = AttitudeForm::ALL.map(AttitudeForm::name).join(", ");
        choice(py, "attitude_form", name, &known)
    })
}

pub fn is_ecef(py: Python<'_>, name: &str) -> PyResult<bool> {
    match name {
        n if n == Ned::NAME => Ok(false),
        n if n == Ecef::NAME => Ok(true),
        other => Err(choice(py, "model", other, "ned, ecef")),
    }
}
