//! NumPy arrays in and out. Input is copied: nothing borrowed is held while the GIL is released.

use gnssins::frames::Lla;
use gnssins::meas::gnss::GnssFix;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use numpy::{
    Element, PyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyFloat, PyInt};

use crate::errors;

fn shape_error(py: Python<'_>, name: &str, need: &str, got: &[usize]) -> PyErr {
    errors::input(
        py,
        "input.shape",
        &format!("{name}: need an array of shape {need}, got {got:?}"),
        "pass one row per sample",
    )
}

fn floats(array: &Bound<'_, PyAny>, name: &str) -> PyResult<(Vec<usize>, Vec<f64>)> {
    let py = array.py();
    let array: PyReadonlyArrayDyn<'_, f64> = array.extract().map_err(|_| {
        let got = array.get_type().name().map_or_else(|_| "?".into(), |n| n.to_string());
        errors::input(
            py,
            "input.dtype",
            &format!("{name}: need a float64 array, got {got}"),
            "convert with numpy.asarray(x, dtype=float)",
        )
    })?;
    Ok((array.shape().to_vec(), array.as_array().iter().copied().collect()))
}

/// Rows of three.
pub fn rows3(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<Vector3<f64>>> {
    let (shape, values) = floats(array, name)?;
    match shape[..] {
        [_, 3] => Ok(values.chunks_exact(3).map(|c| Vector3::new(c[0], c[1], c[2])).collect()),
        _ => Err(shape_error(array.py(), name, "(n, 3)", &shape)),
    }
}

/// One vector of three. A float64 array is read in place, without the registry of borrows, which costs more than the
/// reading; anything else that holds numbers goes the long way.
pub fn vector3(values: &Bound<'_, PyAny>, name: &str) -> PyResult<Vector3<f64>> {
    if let Ok(array) = values.cast::<PyArray1<f64>>()
        && array.is_aligned()
        && array.len() == 3
        && let (Some(x), Some(y), Some(z)) =
            (array.get_owned([0]), array.get_owned([1]), array.get_owned([2]))
    {
        return Ok(Vector3::new(x, y, z));
    }
    any_vector3(values, name)
}

#[cold]
fn any_vector3(values: &Bound<'_, PyAny>, name: &str) -> PyResult<Vector3<f64>> {
    if let Ok([x, y, z]) = values.extract::<[f64; 3]>() {
        return Ok(Vector3::new(x, y, z));
    }
    let py = values.py();
    let array = py.import("numpy")?.call_method1("array", (values, "float64")).map_err(|e| {
        let message = format!("{name} is not numeric: {}", e.value(py));
        errors::input(py, "input.dtype", &message, "give three numbers, NaN where one is absent")
    })?;
    let (shape, v) = floats(&array, name)?;
    match shape[..] {
        [3] => Ok(Vector3::new(v[0], v[1], v[2])),
        _ => Err(shape_error(py, name, "(3,)", &shape)),
    }
}

/// Nanoseconds of a time: whole numbers are nanoseconds already, floating point is seconds.
pub fn nanoseconds(t: &Bound<'_, PyAny>) -> PyResult<i64> {
    if let Ok(seconds) = t.cast::<PyFloat>() {
        return from_seconds(seconds.value()).ok_or_else(|| no_time(t));
    }
    if t.is_instance_of::<PyBool>() {
        return Err(no_time(t));
    }
    match t.extract::<i64>() {
        Ok(t_ns) => Ok(t_ns),
        // beyond 64 bits
        Err(_) if t.is_instance_of::<PyInt>() => Err(no_time(t)),
        Err(_) => t.extract().ok().and_then(from_seconds).ok_or_else(|| no_time(t)),
    }
}

/// Whole seconds and fraction apart, to keep all digits; half to even.
fn from_seconds(seconds: f64) -> Option<i64> {
    let whole = seconds.floor();
    let fraction_ns = ((seconds - whole) * 1e9).round_ties_even();
    // 2^63 ns are 9.2e9 s
    (whole.abs() < 9.2e9).then(|| whole as i64 * 1_000_000_000 + fraction_ns as i64)
}

#[cold]
fn no_time(t: &Bound<'_, PyAny>) -> PyErr {
    let shown = t.repr().map_or_else(|_| "?".into(), |r| r.to_string());
    errors::input(
        t.py(),
        "input.time",
        &format!("a row with the time {shown}, needs a finite number"),
        "give seconds as float or nanoseconds as int; leave out rows without a time",
    )
}

/// Rows of four as unit quaternions, scalar first.
pub fn quaternions(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<UnitQuaternion<f64>>> {
    let (shape, values) = floats(array, name)?;
    match shape[..] {
        [_, 4] => Ok(values.chunks_exact(4).map(quaternion).collect()),
        _ => Err(shape_error(array.py(), name, "(n, 4)", &shape)),
    }
}

/// One unit quaternion, scalar first.
pub fn one_quaternion(array: &Bound<'_, PyAny>, name: &str) -> PyResult<UnitQuaternion<f64>> {
    if let Ok(q) = array.extract::<[f64; 4]>() {
        return Ok(quaternion(&q));
    }
    let (shape, q) = floats(array, name)?;
    match shape[..] {
        [4] => Ok(quaternion(&q)),
        _ => Err(shape_error(array.py(), name, "(4,)", &shape)),
    }
}

/// A unit quaternion from scalar-first numbers.
pub fn quaternion(c: &[f64]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_quaternion(Quaternion::new(c[0], c[1], c[2], c[3]))
}

/// One column.
pub fn column(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<f64>> {
    let (shape, values) = floats(array, name)?;
    match shape[..] {
        [_] => Ok(values),
        _ => Err(shape_error(array.py(), name, "(n,)", &shape)),
    }
}

/// Time stamps, ns.
pub fn times(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<i64>> {
    let array = time_column(array, name)?;
    Ok(array.try_readonly()?.as_array().iter().copied().collect())
}

/// Time stamps, ns, as they lie in the array.
pub fn time_column<'py>(array: &Bound<'py, PyAny>, name: &str) -> PyResult<Bound<'py, PyArray1<i64>>> {
    typed(
        array,
        name,
        "an int64 array of nanoseconds, shape (n,)",
        "convert with numpy.rint(seconds * 1e9).astype(numpy.int64), or read decimal text exactly",
    )
}

/// Rows of three as they lie in the array.
pub fn table3<'py>(array: &Bound<'py, PyAny>, name: &str) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let table: Bound<'_, PyArray2<f64>> =
        typed(array, name, "a float64 array of shape (n, 3)", "convert with numpy.asarray(x, dtype=float)")?;
    match table.shape() {
        [_, 3] => Ok(table),
        shape => Err(shape_error(array.py(), name, "(n, 3)", shape)),
    }
}

fn typed<'py, T: Element, D: numpy::ndarray::Dimension>(
    array: &Bound<'py, PyAny>,
    name: &str,
    need: &str,
    hint: &str,
) -> PyResult<Bound<'py, PyArray<T, D>>> {
    match array.cast::<PyArray<T, D>>() {
        Ok(array) if array.is_aligned() => Ok(array.clone()),
        _ => Err(errors::input(array.py(), "input.dtype", &format!("{name}: need {need}"), hint)),
    }
}

/// Refuses columns of unequal length.
pub fn same_length(py: Python<'_>, what: &str, lengths: &[usize]) -> PyResult<()> {
    if lengths.windows(2).all(|w| w[0] == w[1]) {
        return Ok(());
    }
    Err(errors::input(
        py,
        "input.shape",
        &format!("{what}: columns have {lengths:?} rows"),
        "all columns of a table need the same number of rows",
    ))
}

/// A covariance of six components from variances (6) or a full matrix (36).
pub fn covariance(c: &[f64]) -> [[f64; 6]; 6] {
    core::array::from_fn(|i| {
        core::array::from_fn(|j| match c.len() {
            36 => c[6 * i + j],
            _ if i == j => c[i],
            _ => 0.0,
        })
    })
}

/// A fix from columns in which NaN means absent.
pub fn fix(t_ns: i64, p: &Vector3<f64>, v: &Vector3<f64>, cov: [[f64; 6]; 6]) -> GnssFix {
    let position = p.iter().any(|x| !x.is_nan()).then(|| Lla::new(p.x, p.y, p.z));
    let velocity_n = core::array::from_fn(|i| (!v[i].is_nan()).then_some(v[i]));
    GnssFix { t_ns, position, velocity_n, covariance: cov, new_constellation: false }
}

/// Fixes from the columns of a table; variances are (m, 6) or (m, 6, 6).
pub fn fixes(
    t_ns: &Bound<'_, PyAny>,
    pos: &Bound<'_, PyAny>,
    vel: &Bound<'_, PyAny>,
    var: &Bound<'_, PyAny>,
) -> PyResult<Vec<GnssFix>> {
    let t = times(t_ns, "gnss_t_ns")?;
    let (p, v) = (rows3(pos, "gnss_pos")?, rows3(vel, "gnss_vel")?);
    let (shape, values) = floats(var, "gnss_var")?;
    let width = match shape[..] {
        [_, 6] => 6,
        [_, 6, 6] => 36,
        _ => return Err(shape_error(var.py(), "gnss_var", "(m, 6) or (m, 6, 6)", &shape)),
    };
    same_length(t_ns.py(), "GNSS table", &[t.len(), p.len(), v.len(), shape[0]])?;
    Ok(t.iter()
        .zip(p.iter().zip(&v))
        .zip(values.chunks_exact(width))
        .map(|((t, (p, v)), c)| fix(*t, p, v, covariance(c)))
        .collect())
}

/// Marks of the rows at which the constellation changed; none given: nowhere.
pub fn marks(array: Option<&Bound<'_, PyAny>>, name: &str, len: usize) -> PyResult<Vec<bool>> {
    let Some(array) = array else { return Ok(vec![false; len]) };
    let read: PyReadonlyArrayDyn<'_, bool> = array.extract().map_err(|_| {
        errors::input(
            array.py(),
            "input.dtype",
            &format!("{name}: need an array of bool"),
            "convert with numpy.asarray(x, dtype=bool)",
        )
    })?;
    match read.shape() {
        [n] if *n == len => Ok(read.as_array().iter().copied().collect()),
        shape => Err(shape_error(array.py(), name, &format!("({len},)"), shape)),
    }
}

/// Rows of an aid with one value: stamps, values, variances.
pub fn scalar_rows(
    rows: Option<(Bound<'_, PyAny>, Bound<'_, PyAny>, Bound<'_, PyAny>)>,
    name: &str,
) -> PyResult<Vec<(i64, f64, f64)>> {
    let Some((t_ns, value, var)) = rows else { return Ok(vec![]) };
    let t = times(&t_ns, &format!("{name} t_ns"))?;
    let column = |array: &Bound<'_, PyAny>, what: &str| {
        let (shape, values) = floats(array, &format!("{name} {what}"))?;
        match shape[..] {
            [_] => Ok(values),
            _ => Err(shape_error(array.py(), &format!("{name} {what}"), "(m,)", &shape)),
        }
    };
    let (v, s) = (column(&value, "value")?, column(&var, "var")?);
    same_length(t_ns.py(), &format!("{name} table"), &[t.len(), v.len(), s.len()])?;
    Ok(t.into_iter().zip(v).zip(s).map(|((t, v), s)| (t, v, s)).collect())
}

/// One covariance: 6 variances or a 6x6 matrix.
pub fn one_covariance(var: &Bound<'_, PyAny>) -> PyResult<[[f64; 6]; 6]> {
    if let Ok(v) = var.extract::<[f64; 6]>() {
        return Ok(covariance(&v));
    }
    let (shape, values) = floats(var, "var")?;
    match shape[..] {
        [6] | [6, 6] => Ok(covariance(&values)),
        _ => Err(shape_error(var.py(), "var", "(6,) or (6, 6)", &shape)),
    }
}

/// A flat vector as an array of rows.
pub fn array2<'py>(py: Python<'py>, values: Vec<f64>, width: usize) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let rows = values.len().checked_div(width).unwrap_or(0);
    PyArray1::from_vec(py, values).reshape([rows, width])
}

/// A flat vector as an array of matrices.
pub fn array3<'py>(
    py: Python<'py>,
    values: Vec<f64>,
    rows: usize,
    columns: usize,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let count = values.len().checked_div(rows * columns).unwrap_or(0);
    PyArray1::from_vec(py, values).reshape([count, rows, columns])
}

/// Vectors as rows.
pub fn from_rows3<'py>(py: Python<'py>, rows: &[Vector3<f64>]) -> PyResult<Bound<'py, PyArray2<f64>>> {
    array2(py, rows.iter().flat_map(|v| [v.x, v.y, v.z]).collect(), 3)
}

/// Quaternions as rows, scalar first.
pub fn from_quaternions<'py>(
    py: Python<'py>,
    rows: &[UnitQuaternion<f64>],
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    array2(py, rows.iter().flat_map(|q| [q.w, q.i, q.j, q.k]).collect(), 4)
}

/// Row-major numbers of a 3x3 matrix.
pub fn row_major(m: Matrix3<f64>) -> impl Iterator<Item = f64> {
    (0..3).flat_map(move |i| (0..3).map(move |j| m[(i, j)]))
}

/// Matrices of 3x3.
pub fn matrices3(array: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<Matrix3<f64>>> {
    let (shape, values) = floats(array, name)?;
    match shape[..] {
        [_, 3, 3] => Ok(values.chunks_exact(9).map(Matrix3::from_row_slice).collect()),
        _ => Err(shape_error(array.py(), name, "(n, 3, 3)", &shape)),
    }
}
