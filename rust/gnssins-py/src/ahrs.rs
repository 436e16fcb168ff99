//! Attitude estimators over a log, with the GIL released.

use gnssins::ahrs::{AhrsSample, AhrsStatus, AttitudeEstimator, dcm, euler, filter, quaternion};
use gnssins::error::Error;
use gnssins::imu::{ImuInput, Rates, Strap};
use nalgebra::Vector3;
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::{convert, errors};

/// Flag of a row whose gyro rate is not finite: the interval is left to the next row.
const GYRO_BAD: u16 = 1 << 11;

/// What to run; the settings are those of the method.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    method: String,
    #[serde(default)]
    settings: serde_json::Map<String, serde_json::Value>,
    #[serde(default)]
    input: ImuInput,
    /// Longest interval without a usable row, ns.
    max_gap_ns: i64,
}

/// An estimator by the name of its method.
enum Estimator {
    Dcm(dcm::Dcm),
    Quaternion(quaternion::Corrected),
    Euler(euler::Euler),
    Filter(Box<filter::AttitudeFilter>),
}

impl Estimator {
    fn new(py: Python<'_>, config: Config) -> PyResult<Self> {
        let own = |e: Error| errors::from_crate(py, &e);
        match config.method.as_str() {
            "dcm" => dcm::Dcm::new(&settings(py, config.settings)?).map(Self::Dcm).map_err(own),
            "quaternion" => {
                quaternion::Corrected::new(&settings(py, config.settings)?).map(Self::Quaternion).map_err(own)
            }
            "euler" => euler::Euler::new(&settings(py, config.settings)?).map(Self::Euler).map_err(own),
            "filter" => filter::AttitudeFilter::new(&settings(py, config.settings)?)
                .map(|f| Self::Filter(Box::new(f)))
                .map_err(own),
            other => Err(errors::input(
                py,
                "config.choice",
                &format!("method \"{other}\" is not known"),
                "use one of filter, dcm, quaternion, euler",
            )),
        }
    }

    fn core(&mut self) -> &mut dyn AttitudeEstimator {
        match self {
            Self::Dcm(e) => e,
            Self::Quaternion(e) => e,
            Self::Euler(e) => e,
            Self::Filter(e) => e.as_mut(),
        }
    }

    /// Angles read from single elements, for laws that have elements.
    fn element_angles(&self) -> Option<Vector3<f64>> {
        match self {
            Self::Dcm(e) => Some(e.element_angles()),
            _ => None,
        }
    }

    /// Standard deviations of attitude (north, east, down) and bias, for estimators that have them.
    fn sd(&self) -> Option<[Vector3<f64>; 2]> {
        match self {
            Self::Filter(e) => Some([e.attitude_sd_rad(), e.gyro_bias_sd_rad_s()]),
            _ => None,
        }
    }
}

fn settings<T: DeserializeOwned>(
    py: Python<'_>,
    map: serde_json::Map<String, serde_json::Value>,
) -> PyResult<T> {
    serde_json::from_value(serde_json::Value::Object(map)).map_err(|e| {
        errors::input(
            py,
            "config.json",
            &format!("attitude estimator: {e}"),
            "see gnssins.ahrs.run for the settings",
        )
    })
}

/// Rows of the log.
struct Log {
    t_ns: Vec<i64>,
    gyro: Vec<Vector3<f64>>,
    accel: Vec<Vector3<f64>>,
    mag: Option<Vec<Vector3<f64>>>,
}

#[derive(Default)]
struct Columns {
    q_nb: Vec<f64>,
    bias: Vec<f64>,
    elements: Vec<f64>,
    sd: Vec<f64>,
    flags: Vec<u16>,
}

impl Log {
    /// Mean rates over the interval that ends at a row; `last` is the row that ended the one before.
    fn sample(&self, input: ImuInput, row: usize, last: usize, dt_s: f64) -> AhrsSample {
        let (gyro, accel) = (self.gyro[row], self.accel[row]);
        let mag = self.mag.as_ref().map(|m| m[row]);
        let (gyro, accel) = match input {
            ImuInput::MeanRates => (gyro, accel),
            _ if dt_s <= 0.0 => (if input == ImuInput::Rates { gyro } else { Vector3::zeros() }, accel),
            ImuInput::Increments => (gyro / dt_s, accel / dt_s),
            ImuInput::Rates => {
                let rates = |gyro| Rates { gyro, accel: Vector3::zeros() };
                (Strap::from_rates(&rates(self.gyro[last]), &rates(gyro), dt_s).alpha / dt_s, accel)
            }
        };
        AhrsSample { gyro, accel, mag }
    }

    fn run(&self, estimator: &mut Estimator, input: ImuInput, max_gap_ns: i64) -> Result<Columns, Error> {
        let rows = self.t_ns.len();
        let mut out = Columns::default();
        out.q_nb.reserve(4 * rows);
        out.flags.reserve(rows);
        let mut last: Option<usize> = None;
        for row in 0..rows {
            let t_ns = self.t_ns[row];
            if let Some(before) = row.checked_sub(1).map(|r| self.t_ns[r])
                && t_ns < before
            {
                return Err(Error::TimeBackwards { row: row as u64, t_ns, previous_ns: before });
            }
            out.flags.push(match self.gyro[row].iter().all(|x| x.is_finite()) {
                true => {
                    let from = last.unwrap_or(row);
                    let from_ns = self.t_ns[from];
                    let gap_ns = t_ns.saturating_sub(from_ns);
                    if gap_ns > max_gap_ns {
                        let limit_ns = max_gap_ns;
                        return Err(Error::Gap { row: row as u64, from_ns, to_ns: t_ns, limit_ns });
                    }
                    let dt_s = gap_ns as f64 / 1e9;
                    let status = estimator.core().step(dt_s, &self.sample(input, row, from, dt_s))?;
                    last = Some(row);
                    status.bits()
                }
                false => GYRO_BAD,
            });
            let (q, bias) = (estimator.core().q_nb(), estimator.core().gyro_bias_b());
            out.q_nb.extend([q.w, q.i, q.j, q.k]);
            out.bias.extend(bias.iter());
            out.elements.extend(estimator.element_angles().iter().flat_map(|v| v.iter().copied()));
            out.sd.extend(estimator.sd().iter().flatten().flat_map(|v| v.iter().copied()));
        }
        Ok(out)
    }
}

/// Runs an attitude estimator over a log. See the stub for shapes and units.
#[pyfunction]
#[pyo3(signature = (config_json, t_ns, gyro, accel, mag=None))]
pub fn ahrs_run<'py>(
    py: Python<'py>,
    config_json: &str,
    t_ns: &Bound<'py, PyAny>,
    gyro: &Bound<'py, PyAny>,
    accel: &Bound<'py, PyAny>,
    mag: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let config: Config = serde_json::from_str(config_json).map_err(|e| {
        errors::input(
            py,
            "config.json",
            &format!("attitude estimator: {e}"),
            "build it with gnssins.ahrs.run",
        )
    })?;
    let (input, max_gap_ns) = (config.input, config.max_gap_ns);
    let log = Log {
        t_ns: convert::times(t_ns, "t_ns")?,
        gyro: convert::rows3(gyro, "gyro")?,
        accel: convert::rows3(accel, "accel")?,
        mag: mag.map(|m| convert::rows3(m, "mag")).transpose()?,
    };
    let rows = log.t_ns.len();
    let mags = log.mag.as_ref().map_or(rows, Vec::len);
    convert::same_length(py, "attitude sensors", &[rows, log.gyro.len(), log.accel.len(), mags])?;
    let mut estimator = Estimator::new(py, config)?;
    let columns =
        py.detach(|| log.run(&mut estimator, input, max_gap_ns)).map_err(|e| errors::from_crate(py, &e))?;
    let out = PyDict::new(py);
    out.set_item("q_nb", convert::array2(py, columns.q_nb, 4)?)?;
    out.set_item("bias", convert::array2(py, columns.bias, 3)?)?;
    out.set_item("elements", convert::array2(py, columns.elements, 3)?)?;
    out.set_item("sd", convert::array2(py, columns.sd, 6)?)?;
    out.set_item("flags", PyArray1::from_vec(py, columns.flags))?;
    Ok(out)
}

/// Bits of the flags by name.
#[pyfunction]
pub fn ahrs_flags() -> Vec<(&'static str, u16)> {
    vec![
        ("accel_used", AhrsStatus::ACCEL_USED.bits()),
        ("mag_used", AhrsStatus::MAG_USED.bits()),
        ("accel_bad", AhrsStatus::ACCEL_BAD.bits()),
        ("mag_bad", AhrsStatus::MAG_BAD.bits()),
        ("accel_disturbed", AhrsStatus::ACCEL_DISTURBED.bits()),
        ("mag_disturbed", AhrsStatus::MAG_DISTURBED.bits()),
        ("rest", AhrsStatus::REST.bits()),
        ("aligned", AhrsStatus::ALIGNED.bits()),
        ("skipped", AhrsStatus::SKIPPED.bits()),
        ("unaligned", AhrsStatus::UNALIGNED.bits()),
        ("gimbal", AhrsStatus::GIMBAL.bits()),
        ("gyro_bad", GYRO_BAD),
    ]
}
