//! Python binding of the `gnssins` crate: conversion of arguments and results, no mathematics.

mod ahrs;
mod block;
mod config;
mod convert;
mod engine;
mod errors;
mod free;
mod maths;
mod monte_carlo;
mod navigator;
mod run;

use pyo3::prelude::*;

/// Version of the compiled core.
#[pyfunction]
fn version() -> &'static str {
    env!("CARGO_PKG_VERSION")
}

/// True when the core was built without optimisation.
#[pyfunction]
fn is_debug_build() -> bool {
    cfg!(debug_assertions)
}

#[pymodule]
fn _core(m: &Bound<'_, PyModule>) -> PyResult<()> {
    m.add_function(wrap_pyfunction!(version, m)?)?;
    m.add_function(wrap_pyfunction!(is_debug_build, m)?)?;
    m.add_function(wrap_pyfunction!(config::preset_names, m)?)?;
    m.add_function(wrap_pyfunction!(config::preset_json, m)?)?;
    m.add_function(wrap_pyfunction!(config::preset_summary, m)?)?;
    m.add_function(wrap_pyfunction!(run::run, m)?)?;
    m.add_function(wrap_pyfunction!(ahrs::ahrs_run, m)?)?;
    m.add_function(wrap_pyfunction!(ahrs::ahrs_flags, m)?)?;
    m.add_class::<run::Run>()?;
    m.add_class::<navigator::Navigator>()?;
    m.add_class::<monte_carlo::PyMonteCarlo>()?;
    m.add_function(wrap_pyfunction!(monte_carlo::monte_carlo_deviates, m)?)?;
    m.add_class::<free::FreeIns>()?;
    m.add_function(wrap_pyfunction!(free::strapdown_three_rate, m)?)?;
    maths::register(m)
}
