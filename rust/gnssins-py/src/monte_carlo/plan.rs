//! What all runs share, from figures in JSON and columns from Python.

use gnssins::earth::Ellipsoid;
use gnssins::ekf::Initial;
use gnssins::meas::Source;
use gnssins::monte_carlo::aids::{Aids, Antenna, Baro, Gnss, Headings, Place, SlowError};
use gnssins::monte_carlo::imu::{Axes, ErrorKind, Imu, SensorError, Triad};
use gnssins::monte_carlo::normal::stream;
use gnssins::monte_carlo::process::{COMPONENTS, Components, Law, LowPass};
use gnssins::monte_carlo::{BLOCK, Epoch, Feed, Filter, Plan};
use gnssins::nav::Solution;
use nalgebra::Vector3;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde::Deserialize;

use crate::config::{self, EngineConfig};
use crate::{convert, errors};

/// Figures of a set in SI; arrays come beside it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spec {
    seed: u64,
    pub shared: bool,
    ecef: bool,
    ellipsoid: String,
    rows: usize,
    after_ns: i64,
    gyro: TriadSpec,
    accel: TriadSpec,
    errors: Vec<ErrorSpec>,
    gnss: GnssSpec,
    baro: BaroSpec,
    heading_sd: f64,
    truths: Vec<Option<usize>>,
    groups: Vec<Vec<usize>>,
    gaps_ns: Vec<[i64; 2]>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct TriadSpec {
    density: [f64; 3],
    bandwidth_hz: Option<f64>,
    full_scale: Option<f64>,
    lsb: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ErrorSpec {
    kind: ErrorKind,
    name: String,
    process: Process,
    value: Vec<f64>,
    initial_sd: Vec<f64>,
    walk: Vec<f64>,
    sd: Vec<f64>,
    tau_s: Option<f64>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Process {
    Constant,
    RandomWalk,
    GaussMarkov,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct GnssSpec {
    uses: [bool; 2],
    lever_sd: [f64; 3],
    slow: [Option<SlowSpec>; 2],
    changes: Vec<usize>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SlowSpec {
    sd: [f64; 3],
    jump_sd: [f64; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct BaroSpec {
    sd: f64,
    initial_sd: f64,
    walk: f64,
}

/// Numbers of a process, the rest zero.
fn components(values: &[f64]) -> Components {
    let mut out = [0.0; COMPONENTS];
    out.iter_mut().zip(values).for_each(|(o, v)| *o = *v);
    out
}

impl TriadSpec {
    fn triad(&self, dt_s: f64) -> Triad {
        Triad {
            density: self.density,
            low_pass: self.bandwidth_hz.map(|corner| LowPass::new(corner, dt_s)),
            full_scale: self.full_scale,
            lsb: self.lsb,
        }
    }
}

impl ErrorSpec {
    fn error(&self, dt_s: f64) -> SensorError {
        let law = match self.process {
            Process::Constant => {
                Law::Constant { value: components(&self.value), sd: components(&self.initial_sd) }
            }
            Process::RandomWalk => Law::walk(components(&self.initial_sd), &components(&self.walk), dt_s),
            Process::GaussMarkov => {
                Law::markov(components(&self.sd), self.tau_s.unwrap_or(f64::INFINITY), dt_s)
            }
        };
        SensorError { kind: self.kind, stream: stream(&format!("imu.error.{}", self.name)), law }
    }
}

/// Columns of a set by name.
pub struct Columns<'py>(pub &'py Bound<'py, PyDict>);

impl Columns<'_> {
    fn get(&self, name: &str) -> PyResult<Bound<'_, PyAny>> {
        self.0.get_item(name)?.ok_or_else(|| {
            errors::input(self.0.py(), "input.missing", &format!("no column {name}"), "report this as a bug")
        })
    }

    fn times(&self, name: &str) -> PyResult<Vec<i64>> {
        convert::times(&self.get(name)?, name)
    }

    fn column(&self, name: &str) -> PyResult<Vec<f64>> {
        convert::column(&self.get(name)?, name)
    }

    fn rows3(&self, name: &str) -> PyResult<Vec<Vector3<f64>>> {
        convert::rows3(&self.get(name)?, name)
    }

    fn same(&self, what: &str, lengths: &[usize]) -> PyResult<()> {
        convert::same_length(self.0.py(), what, lengths)
    }

    /// Increments by blocks, without the row of the first epoch.
    fn blocks(&self, name: &str) -> PyResult<Vec<Axes>> {
        let rows = self.rows3(name)?;
        let mut out = vec![[[0.0; BLOCK]; 3]; rows.len().saturating_sub(1).div_ceil(BLOCK)];
        for (k, row) in rows.iter().skip(1).enumerate() {
            for axis in 0..3 {
                out[k / BLOCK][axis][k % BLOCK] = row[axis];
            }
        }
        Ok(out)
    }

    fn epochs(&self) -> PyResult<Vec<Epoch>> {
        let (rows, kinds) = (self.times("epoch_row")?, self.times("epoch_kind")?);
        let (lla, v_n) = (self.rows3("epoch_lla")?, self.rows3("epoch_v_n")?);
        let q_nb = convert::quaternions(&self.get("epoch_q_nb")?, "epoch_q_nb")?;
        self.same("epochs", &[rows.len(), kinds.len(), lla.len(), v_n.len(), q_nb.len()])?;
        let epoch = |k: usize| Epoch {
            row: rows[k] as usize,
            error: kinds[k] & 1 != 0,
            nees: kinds[k] & 2 != 0,
            truth: Solution {
                position: gnssins::frames::Lla::new(lla[k].x, lla[k].y, lla[k].z),
                v_n: v_n[k],
                q_nb: q_nb[k],
            },
        };
        Ok((0..rows.len()).map(epoch).collect())
    }

    fn feed(&self) -> PyResult<Vec<Feed>> {
        let (source, index) = (self.times("feed_source")?, self.times("feed_index")?);
        let (t_ns, new) = (self.times("feed_t_ns")?, self.times("feed_new")?);
        self.same("values of the aids", &[source.len(), index.len(), t_ns.len(), new.len()])?;
        let feed = |k: usize| Feed {
            source: Source::ALL[(source[k] as usize).min(Source::ALL.len() - 1)],
            index: index[k] as usize,
            t_ns: t_ns[k],
            new_constellation: new[k] != 0,
        };
        Ok((0..source.len()).map(feed).collect())
    }

    fn gnss(&self, spec: &GnssSpec, t_ns: &[i64]) -> PyResult<Gnss> {
        let (position, velocity) = (self.rows3("gnss_position")?, self.rows3("gnss_velocity")?);
        let (sd_p, sd_v) = (self.rows3("gnss_sd_position")?, self.rows3("gnss_sd_velocity")?);
        let place = places(t_ns, &self.times("gnss_t_ns")?);
        self.same("fixes", &[place.len(), position.len(), velocity.len(), sd_p.len(), sd_v.len()])?;
        let lever = if spec.lever_sd == [0.0; 3] {
            None
        } else {
            let matrices = |name: &str| convert::matrices3(&self.get(name)?, name);
            let both = (matrices("lever_position")?, matrices("lever_velocity")?);
            self.same("lever arm", &[place.len(), both.0.len(), both.1.len()])?;
            Some(both)
        };
        let antenna = (0..place.len()).map(|k| Antenna {
            position: position[k],
            velocity: velocity[k],
            per_lever: lever.as_ref().map(|(p, v)| (p[k], v[k])),
        });
        let slow = |part: usize, name: &str| -> PyResult<Option<SlowError>> {
            let Some(slow) = &spec.slow[part] else { return Ok(None) };
            let growth = self.column(&format!("growth_{name}"))?;
            let mut decay = vec![0.0; growth.len() + 1];
            for (k, g) in growth.iter().enumerate() {
                decay[k + 1] = decay[k] + g;
            }
            Ok(Some(SlowError {
                stream: stream(&format!("gnss.{name}_error")),
                law: Law::varying(components(&slow.sd), &growth),
                jump_stream: stream(&format!("gnss.{name}_error.jump")),
                jump_sd: slow.jump_sd,
                decay,
            }))
        };
        Ok(Gnss {
            antenna: antenna.collect(),
            sd: sd_p.iter().zip(&sd_v).map(|(p, v)| [p.x, p.y, p.z, v.x, v.y, v.z]).collect(),
            lever_sd: spec.lever_sd,
            slow: [slow(0, "position")?, slow(1, "velocity")?],
            changes: spec.changes.clone(),
            place,
        })
    }

    fn aids(&self, spec: &Spec, t_ns: &[i64], dt_s: f64) -> PyResult<Aids> {
        let (initial, walk) = (components(&[spec.baro.initial_sd]), components(&[spec.baro.walk]));
        let biased = spec.baro.initial_sd > 0.0 || spec.baro.walk > 0.0;
        Ok(Aids {
            gnss: self.gnss(&spec.gnss, t_ns)?,
            baro: Baro {
                place: places(t_ns, &self.times("baro_t_ns")?),
                height_m: self.column("baro_height")?,
                sd_m: spec.baro.sd,
                bias: biased.then(|| Law::walk(initial, &walk, dt_s)),
            },
            heading: Headings { heading_rad: self.column("heading_rad")?, sd_rad: spec.heading_sd },
        })
    }
}

/// Where times lie between epochs.
fn places(epochs: &[i64], t_ns: &[i64]) -> Vec<Place> {
    let place = |t: &i64| {
        let interval =
            epochs.partition_point(|e| e <= t).saturating_sub(1).min(epochs.len().saturating_sub(2));
        let (from, to) = (epochs[interval], epochs[interval + 1]);
        Place { interval, share: (t - from) as f64 / (to - from) as f64 }
    };
    t_ns.iter().map(place).collect()
}

/// Puts the plan together.
pub fn plan(py: Python<'_>, engine: &EngineConfig, spec: &Spec, columns: &Columns<'_>) -> PyResult<Plan> {
    let t_ns = columns.times("t_ns")?;
    let exact = [columns.blocks("dtheta")?, columns.blocks("dvel")?];
    if t_ns.len() < 2 || !t_ns.windows(2).all(|pair| pair[0] < pair[1]) {
        return Err(errors::input(
            py,
            "input.empty",
            "a truth needs two epochs that ascend",
            "report this as a bug",
        ));
    }
    let intervals = t_ns.len() - 1;
    let mut dt_s = vec![[0.0; BLOCK]; intervals.div_ceil(BLOCK)];
    for (k, pair) in t_ns.windows(2).enumerate() {
        dt_s[k / BLOCK][k % BLOCK] = (pair[1] - pair[0]) as f64 / 1e9;
    }
    let mean_s = (t_ns[intervals] - t_ns[0]) as f64 / 1e9 / intervals as f64;
    let ellipsoid: Ellipsoid = config::ellipsoid(py, &spec.ellipsoid)?;
    let initial: Initial = engine.initial(py)?;
    Ok(Plan {
        seed: spec.seed,
        rows: spec.rows,
        ellipsoid,
        ecef: spec.ecef,
        initial,
        imu: Imu {
            dt_s,
            exact,
            triads: [spec.gyro.triad(mean_s), spec.accel.triad(mean_s)],
            errors: spec.errors.iter().map(|e| e.error(mean_s)).collect(),
        },
        aids: columns.aids(spec, &t_ns, mean_s)?,
        feed: columns.feed()?,
        uses: spec.gnss.uses,
        epochs: columns.epochs()?,
        after_ns: spec.after_ns,
        truths: spec.truths.clone(),
        groups: spec.groups.clone(),
        gaps: spec.gaps_ns.clone(),
        filter: Filter {
            settings: engine.settings(py)?,
            blocks: engine.blocks(py)?,
            stream: engine.stream(py)?,
            attitude_form: engine.attitude_form,
        },
        t_ns,
    })
}
