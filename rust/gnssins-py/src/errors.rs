//! From the crate's errors to the exception classes of `gnssins.errors`.

use gnssins::error::Error;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Raises the class that `gnssins.errors.from_core` picks for a code.
pub fn raise(py: Python<'_>, code: &str, message: &str, hint: &str, context: &Bound<'_, PyDict>) -> PyErr {
    let build = || -> PyResult<Bound<'_, PyAny>> {
        py.import("gnssins.errors")?.getattr("from_core")?.call1((code, message, hint, context))
    };
    match build() {
        Ok(exception) => PyErr::from_value(exception),
        Err(_) => PyRuntimeError::new_err(format!("[{code}] {message}; {hint}")),
    }
}

/// An error of the crate.
pub fn from_crate(py: Python<'_>, error: &Error) -> PyErr {
    raise(py, error.code(), &message(error), error.hint(), &context(py, error))
}

/// An error of the crate at a row of a block, counted from 0: what came before it was taken.
pub fn in_block(py: Python<'_>, error: &Error, row: usize) -> PyErr {
    let context = context(py, error);
    drop(context.set_item("block_row", row));
    let message = format!("{}; row {row} of the block", message(error));
    raise(py, error.code(), &message, error.hint(), &context)
}

fn context<'py>(py: Python<'py>, error: &Error) -> Bound<'py, PyDict> {
    let context = PyDict::new(py);
    // a dictionary cannot refuse a string key with a number: failures leave the context shorter
    let set = |key: &str, value: f64| drop(context.set_item(key, value));
    match *error {
        Error::TimeBackwards { row, t_ns, previous_ns } => {
            set("row", row as f64);
            drop(context.set_item("t_ns", t_ns));
            drop(context.set_item("previous_ns", previous_ns));
        }
        Error::Gap { row, from_ns, to_ns, limit_ns } => {
            set("row", row as f64);
            set("gap_s", (to_ns - from_ns) as f64 / 1e9);
            set("limit_s", limit_ns as f64 / 1e9);
            drop(context.set_item("from_ns", from_ns));
            drop(context.set_item("to_ns", to_ns));
        }
        Error::Covariance { t_ns, state, pivot } => {
            drop(context.set_item("t_ns", t_ns));
            set("state", state as f64);
            set("pivot", pivot);
        }
        Error::Config { what, got, .. } => {
            drop(context.set_item("key", what));
            set("got", got);
        }
        _ => {}
    }
    context
}

/// The message with times in seconds, as users read them.
fn message(error: &Error) -> String {
    let s = |ns: i64| ns as f64 / 1e9;
    match *error {
        Error::TimeBackwards { row, t_ns, previous_ns } => format!(
            "IMU row {row}: t = {:.6} s after {:.6} s ({:+.3} ms)",
            s(t_ns),
            s(previous_ns),
            s(t_ns - previous_ns) * 1e3
        ),
        Error::Gap { row, from_ns, to_ns, limit_ns } => format!(
            "IMU row {row}: no sample for {:.3} s from t = {:.3} s to {:.3} s, limit {:.3} s",
            s(to_ns - from_ns),
            s(from_ns),
            s(to_ns),
            s(limit_ns)
        ),
        Error::Covariance { t_ns, state, pivot } => format!(
            "covariance not positive definite at t = {:.3} s: state {state}, pivot {pivot:e}",
            s(t_ns)
        ),
        Error::NonFinite { what, t_ns } => {
            format!("{what} is not finite or beyond all bounds at t = {:.3} s", s(t_ns))
        }
        Error::LatitudeLimit { lat_rad, limit_rad } => format!(
            "latitude {:.6} deg is beyond the limit {:.1} deg of the NED model",
            lat_rad.to_degrees(),
            limit_rad.to_degrees()
        ),
        Error::AttitudeForm { what, got_rad, limit_rad } => format!(
            "{what} of {:.3} deg is beyond the limit {:.1} deg of the chosen attitude form",
            got_rad.to_degrees(),
            limit_rad.to_degrees()
        ),
        _ => error.to_string(),
    }
}

/// An input that has the wrong shape, type or value.
pub fn input(py: Python<'_>, code: &str, message: &str, hint: &str) -> PyErr {
    raise(py, code, message, hint, &PyDict::new(py))
}
