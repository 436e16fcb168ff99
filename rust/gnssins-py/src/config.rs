//! The engine configuration as JSON: SI units, unknown fields refused.

use gnssins::blocks::{BLOCK_MAX, Block, BlockKind, Process};
use gnssins::discretise::{ImuNoise, Order};
use gnssins::earth::{Ellipsoid, Gravity};
use gnssins::ekf::{Floor, Gate, Initial, Integrity, Settings};
use gnssins::error::Error;
use gnssins::frames::Lla;
use gnssins::imu::{Calibration, Coning, ImuInput};
use gnssins::layout::Layout;
use gnssins::nav::kinematics::AttitudeForm;
use gnssins::nav::{EarthModel, NAV, Solution};
use gnssins::presets::{self, Model, Preset};
use gnssins::stream::{OnBackwards, OnGap, StreamSettings};
use nalgebra::{Matrix3, Vector3};
use pyo3::prelude::*;
use serde::{Deserialize, Serialize};

use crate::{convert, errors};

/// What `covariance_every` is where it is left out.
const fn one() -> u32 {
    1
}

/// Everything that the engine needs besides the rows.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EngineConfig {
    pub model: Model,
    pub ellipsoid: String,
    pub gravity: Gravity,
    pub coning: Coning,
    #[serde(default)]
    pub attitude_form: AttitudeForm,
    pub phi_order: u8,
    #[serde(default = "one")]
    pub covariance_every: u32,
    #[serde(default)]
    pub floor: FloorConfig,
    #[serde(default)]
    pub feedback_ns: i64,
    pub imu: ImuConfig,
    pub blocks: Vec<BlockConfig>,
    pub gnss: GnssConfig,
    #[serde(default)]
    pub baro: AidConfig,
    #[serde(default)]
    pub heading: AidConfig,
    pub output: OutputConfig,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub initial: Option<InitialConfig>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuConfig {
    pub input: ImuInput,
    pub gyro_psd: [f64; 3],
    pub accel_psd: [f64; 3],
    pub gyro_range: Option<f64>,
    pub accel_range: Option<f64>,
    pub max_gap_ns: i64,
    pub on_gap: OnGap,
    pub on_backwards: OnBackwards,
    pub max_bad_share: f64,
    pub gyro_bias: [f64; 3],
    pub accel_bias: [f64; 3],
    pub gyro_matrix: [[f64; 3]; 3],
    pub accel_matrix: [[f64; 3]; 3],
}

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlockConfig {
    pub kind: BlockKind,
    pub name: String,
    pub process: String,
    pub initial_sd: Vec<f64>,
    #[serde(default)]
    pub initial: Vec<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub psd: Vec<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sd: Vec<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub tau_s: Vec<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distance_m: Option<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub jump_sd: Vec<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub floor_sd: Vec<f64>,
}

/// Lower bounds of the navigation sigmas: rad, m/s, m; north, east, down.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FloorConfig {
    pub phi: [f64; 3],
    pub v: [f64; 3],
    pub p: [f64; 3],
}

/// An aid beside GNSS.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AidConfig {
    pub latency_ns: i64,
    pub gate_probability: Option<f64>,
}

impl Default for AidConfig {
    fn default() -> Self {
        Self { latency_ns: 0, gate_probability: Some(0.999) }
    }
}

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GnssConfig {
    pub lever_b_m: [f64; 3],
    pub latency_ns: i64,
    pub gate_probability: Option<f64>,
    #[serde(default)]
    pub reacquire_after: Option<u32>,
    #[serde(default)]
    pub gate: Gate,
    #[serde(default)]
    pub trace_ratio_limit: Option<f64>,
    #[serde(default)]
    pub max_accel_m_s2: Option<f64>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OutputConfig {
    pub interval_ns: i64,
    pub covariance_interval_ns: i64,
    #[serde(default)]
    pub linearise: bool,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InitialConfig {
    pub t_ns: i64,
    pub lat_rad: f64,
    pub lon_rad: f64,
    pub height_m: f64,
    pub v_n: [f64; 3],
    pub q_nb: [f64; 4],
    pub sd_phi: [f64; 3],
    pub sd_v: [f64; 3],
    pub sd_p: [f64; 3],
}

impl EngineConfig {
    pub fn parse(py: Python<'_>, json: &str) -> PyResult<Self> {
        serde_json::from_str(json).map_err(|e| {
            errors::input(
                py,
                "config.json",
                &format!("engine configuration: {e}"),
                "build it with gnssins.Config",
            )
        })
    }

    pub fn settings(&self, py: Python<'_>) -> PyResult<Settings> {
        let own = |e: &Error| errors::from_crate(py, e);
        Ok(Settings {
            earth: EarthModel { ellipsoid: ellipsoid(py, &self.ellipsoid)?, gravity: self.gravity },
            noise: ImuNoise { gyro_psd: self.imu.gyro_psd.into(), accel_psd: self.imu.accel_psd.into() },
            order: Order::from_number(self.phi_order).map_err(|e| own(&e))?,
            covariance_every: self.covariance_every,
            coning: self.coning,
            lever_b_m: self.gnss.lever_b_m.into(),
            gate_probability: [
                self.gnss.gate_probability,
                self.baro.gate_probability,
                self.heading.gate_probability,
            ],
            integrity: Integrity {
                gate: self.gnss.gate,
                trace_ratio_limit: self.gnss.trace_ratio_limit,
                max_accel_m_s2: self.gnss.max_accel_m_s2,
            },
            floor: Floor { phi: self.floor.phi.into(), v: self.floor.v.into(), p: self.floor.p.into() },
            feedback_ns: self.feedback_ns,
        })
    }

    pub fn stream(&self, py: Python<'_>) -> PyResult<StreamSettings> {
        let calibration = |bias: [f64; 3], matrix: [[f64; 3]; 3]| {
            Calibration::new(bias.into(), Matrix3::from_fn(|i, j| matrix[i][j]))
                .map_err(|e| errors::from_crate(py, &e))
        };
        Ok(StreamSettings {
            input: self.imu.input,
            gyro: calibration(self.imu.gyro_bias, self.imu.gyro_matrix)?,
            accel: calibration(self.imu.accel_bias, self.imu.accel_matrix)?,
            gyro_range: self.imu.gyro_range,
            accel_range: self.imu.accel_range,
            max_gap_ns: self.imu.max_gap_ns,
            on_gap: self.imu.on_gap,
            on_backwards: self.imu.on_backwards,
            latency_ns: [self.gnss.latency_ns, self.baro.latency_ns, self.heading.latency_ns],
            reacquire_after: self.gnss.reacquire_after,
        })
    }

    pub fn initial(&self, py: Python<'_>) -> PyResult<Initial> {
        let i = self.initial.as_ref().ok_or_else(|| {
            errors::input(
                py,
                "config.initial",
                "no initial state",
                "give position, velocity, attitude and their sd",
            )
        })?;
        Ok(Initial {
            t_ns: i.t_ns,
            solution: Solution {
                position: Lla::new(i.lat_rad, i.lon_rad, i.height_m),
                v_n: i.v_n.into(),
                q_nb: convert::quaternion(&i.q_nb),
            },
            sd_phi: i.sd_phi.into(),
            sd_v: i.sd_v.into(),
            sd_p: i.sd_p.into(),
        })
    }

    pub fn blocks(&self, py: Python<'_>) -> PyResult<Vec<Block>> {
        self.blocks.iter().map(|b| b.block(py)).collect()
    }

    /// Number of error states.
    pub fn state_count(&self) -> usize {
        NAV + self.blocks.iter().map(|b| b.kind.len()).sum::<usize>()
    }

    /// Name, unit and scale of every state: those of the layout, with the names of the configured blocks.
    pub fn states(&self, py: Python<'_>) -> PyResult<Vec<StateInfo>> {
        let layout = Layout::<CAPACITY>::new(&self.blocks(py)?).map_err(|e| errors::from_crate(py, &e))?;
        let nav = (0..NAV).map(|_| "navigation");
        let blocks = self.blocks.iter().flat_map(|b| b.kind.axes().iter().map(|_| b.name.as_str()));
        let named = |(i, block): (usize, &str)| {
            let s = layout.state(i)?;
            let (prefix, kind) = if i < NAV { (s.quantity, "navigation") } else { (block, s.quantity) };
            let name = match s.quantity {
                "baro_bias" => prefix.to_string(),
                _ => format!("{prefix}_{}", s.axis),
            };
            Some(StateInfo { name, unit: s.unit, scale: s.scale, block: block.to_string(), kind })
        };
        Ok(nav.chain(blocks).enumerate().filter_map(named).collect())
    }
}

/// Most states that the binding is compiled for.
pub const CAPACITY: usize = 64;

/// What a state is, for tables and plots.
#[derive(Debug, Clone, PartialEq)]
pub struct StateInfo {
    pub name: String,
    pub unit: &'static str,
    pub scale: f64,
    pub block: String,
    pub kind: &'static str,
}

impl BlockConfig {
    fn block(&self, py: Python<'_>) -> PyResult<Block> {
        let len = self.kind.len();
        let fill = |key: &str, values: &[f64], missing: Option<f64>| {
            let mut out = [0.0; BLOCK_MAX];
            match (values.len(), missing) {
                (n, _) if n == len => out[..len].copy_from_slice(values),
                (0, Some(default)) => out = [default; BLOCK_MAX],
                (n, _) => {
                    return Err(errors::input(
                        py,
                        "config.block",
                        &format!("block {}: {key} has {n} values, needs {len}", self.name),
                        "one value per state of the block",
                    ));
                }
            }
            Ok(out)
        };
        let process = match self.process.as_str() {
            "constant" => Process::Constant,
            "random_walk" => Process::RandomWalk { psd: fill("psd", &self.psd, None)? },
            "gauss_markov" => Process::GaussMarkov {
                sd: fill("sd", &self.sd, None)?,
                tau_s: fill("tau_s", &self.tau_s, None)?,
            },
            other => {
                return Err(errors::input(
                    py,
                    "config.block",
                    &format!("block {}: process \"{other}\"", self.name),
                    "use constant, random_walk or gauss_markov",
                ));
            }
        };
        Ok(Block {
            kind: self.kind,
            process,
            initial_sd: fill("initial_sd", &self.initial_sd, None)?,
            initial: fill("initial", &self.initial, Some(0.0))?,
            distance_m: self.distance_m.unwrap_or(f64::INFINITY),
            jump_sd: fill("jump_sd", &self.jump_sd, Some(0.0))?,
            floor_sd: fill("floor_sd", &self.floor_sd, Some(0.0))?,
        })
    }

    fn of(name: &str, block: &Block) -> Self {
        let len = block.kind.len();
        let cut = |v: &[f64; BLOCK_MAX]| v[..len].to_vec();
        let some = |v: &[f64; BLOCK_MAX]| if v.iter().any(|x| *x > 0.0) { cut(v) } else { vec![] };
        let (process, psd, sd, tau_s) = match &block.process {
            Process::Constant => ("constant", vec![], vec![], vec![]),
            Process::RandomWalk { psd } => ("random_walk", cut(psd), vec![], vec![]),
            Process::GaussMarkov { sd, tau_s } => ("gauss_markov", vec![], cut(sd), cut(tau_s)),
        };
        Self {
            kind: block.kind,
            name: name.to_string(),
            process: process.to_string(),
            initial_sd: cut(&block.initial_sd),
            initial: cut(&block.initial),
            psd,
            sd,
            tau_s,
            distance_m: Some(block.distance_m).filter(|d| d.is_finite()),
            jump_sd: some(&block.jump_sd),
            floor_sd: some(&block.floor_sd),
        }
    }
}

impl From<&Preset> for EngineConfig {
    fn from(p: &Preset) -> Self {
        let stream = StreamSettings::default();
        let zero = [[0.0; 3]; 3];
        Self {
            model: p.model,
            ellipsoid: "wgs84".into(),
            gravity: p.gravity,
            coning: Coning::default(),
            attitude_form: AttitudeForm::default(),
            phi_order: 3,
            covariance_every: 1,
            floor: FloorConfig::default(),
            feedback_ns: 0,
            imu: ImuConfig {
                input: stream.input,
                gyro_psd: p.noise.gyro_psd.into(),
                accel_psd: p.noise.accel_psd.into(),
                gyro_range: None,
                accel_range: None,
                max_gap_ns: stream.max_gap_ns,
                on_gap: stream.on_gap,
                on_backwards: stream.on_backwards,
                max_bad_share: 0.01,
                gyro_bias: [0.0; 3],
                accel_bias: [0.0; 3],
                gyro_matrix: zero,
                accel_matrix: zero,
            },
            blocks: p.blocks.iter().map(|(name, b)| BlockConfig::of(name, b)).collect(),
            gnss: GnssConfig {
                lever_b_m: [0.0; 3],
                latency_ns: 0,
                gate_probability: Some(0.999),
                reacquire_after: stream.reacquire_after,
                gate: Gate::default(),
                trace_ratio_limit: None,
                max_accel_m_s2: None,
            },
            baro: AidConfig::default(),
            heading: AidConfig::default(),
            output: OutputConfig { interval_ns: 0, covariance_interval_ns: 0, linearise: false },
            initial: None,
        }
    }
}

/// An ellipsoid by name.
pub fn ellipsoid(py: Python<'_>, name: &str) -> PyResult<Ellipsoid> {
    Ellipsoid::by_name(name).ok_or_else(|| {
        let known = Ellipsoid::NAMES.join(", ");
        errors::input(
            py,
            "config.ellipsoid",
            &format!("ellipsoid \"{name}\" is not known"),
            &format!("use one of {known}"),
        )
    })
}

fn preset(py: Python<'_>, name: &str) -> PyResult<&'static Preset> {
    presets::find(name).ok_or_else(|| {
        let known = preset_names().join(", ");
        errors::input(
            py,
            "config.preset",
            &format!("preset \"{name}\" is not known"),
            &format!("use one of {known}"),
        )
    })
}

/// Names of the presets.
#[pyfunction]
pub fn preset_names() -> Vec<&'static str> {
    presets::PRESETS.iter().map(|p| p.name).collect()
}

/// A preset as engine configuration.
#[pyfunction]
pub fn preset_json(py: Python<'_>, name: &str) -> PyResult<String> {
    serde_json::to_string(&EngineConfig::from(preset(py, name)?))
        .map_err(|e| errors::input(py, "config.json", &e.to_string(), "report this as a bug"))
}

/// One line about a preset.
#[pyfunction]
pub fn preset_summary(py: Python<'_>, name: &str) -> PyResult<&'static str> {
    Ok(preset(py, name)?.summary)
}

/// Rotation-safe vector for Python: three numbers.
pub fn list(v: &Vector3<f64>) -> [f64; 3] {
    [v.x, v.y, v.z]
}
