//! What all runs of a set share.

use nalgebra::{UnitQuaternion, Vector3};

use super::aids::{AidValues, Aids};
use super::imu::Imu;
use super::normal::{Deviates, stream};
use crate::attitude;
use crate::blocks::Block;
use crate::earth::Ellipsoid;
use crate::ekf::{Initial, Settings};
use crate::error::Error;
use crate::frames::{Ecef, c_ne, ecef_to_lla, lla_to_ecef, wrap_pi};
use crate::math;
use crate::meas::baro::BaroHeight;
use crate::meas::gnss::GnssFix;
use crate::meas::heading::Heading;
use crate::meas::{Observation, Source};
use crate::nav::kinematics::AttitudeForm;
use crate::nav::{NAV, Solution};
use crate::stream::StreamSettings;

/// A value of an aid on its way to the filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feed {
    /// Aid.
    pub source: Source,
    /// Value among all of the aid.
    pub index: usize,
    /// Stamp, ns.
    pub t_ns: i64,
    /// Whether the constellation has changed since the fix before.
    pub new_constellation: bool,
}

/// An epoch at which estimate and truth are compared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Epoch {
    /// Epoch of the truth, from 1.
    pub row: usize,
    /// Whether its errors count for the root mean squares and the ends of gaps.
    pub error: bool,
    /// Whether the covariance is judged.
    pub nees: bool,
    /// True state.
    pub truth: Solution,
}

/// The configured filter.
#[derive(Debug, Clone, PartialEq)]
pub struct Filter {
    /// Settings.
    pub settings: Settings,
    /// Blocks.
    pub blocks: Vec<Block>,
    /// How rows are read; rows are increments.
    pub stream: StreamSettings,
    /// Form of the attitude equations.
    pub attitude_form: AttitudeForm,
}

/// What all runs share: the truth, the sensors, the filter, and what is asked.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Seed of the set.
    pub seed: u64,
    /// Epochs of the truth, ns; the first is that of the initial state.
    pub t_ns: Vec<i64>,
    /// Number of IMU rows that the filter gets.
    pub rows: usize,
    /// Ellipsoid of the truth.
    pub ellipsoid: Ellipsoid,
    /// Whether the equations of the truth are those of the ECEF model: attitude errors are then those against e.
    pub ecef: bool,
    /// True state at the start, and how well it is known.
    pub initial: Initial,
    /// Inertial sensors.
    pub imu: Imu,
    /// Aids.
    pub aids: Aids,
    /// Which of their values the filter gets, in the order of validity.
    pub feed: Vec<Feed>,
    /// Whether fixes give the filter their positions and their velocities.
    pub uses: [bool; 2],
    /// Epochs of comparison.
    pub epochs: Vec<Epoch>,
    /// Root mean squares and NIS count after this time, ns.
    pub after_ns: i64,
    /// True error behind each block state: its column, see [`Plan::columns`].
    pub truths: Vec<Option<usize>>,
    /// States of each group whose NEES is wanted.
    pub groups: Vec<Vec<usize>>,
    /// Gaps [from, to] whose ends are looked at, ns.
    pub gaps: Vec<[i64; 2]>,
    /// The filter.
    pub filter: Filter,
}

/// Columns of the aids after those of the IMU errors: lever arm (3), errors of position and velocity (6), bias of the
/// altimeter.
pub(super) const AID_COLUMNS: usize = 10;

const INITIAL: [u32; 3] =
    [stream("initial.attitude"), stream("initial.velocity"), stream("initial.position")];

impl Plan {
    /// Verifies what indices point to.
    ///
    /// # Errors
    /// [`Error::Config`] with what does not fit.
    pub fn check(&self) -> Result<(), Error> {
        let need = "must point into the truth, the states or the values of the aid";
        let point = |what, got: usize, ok: bool| {
            if ok { Ok(()) } else { Err(Error::Config { what, need, got: got as f64 }) }
        };
        let intervals = self.t_ns.len().saturating_sub(1);
        let blocks = self.imu.dt_s.len();
        point("plan: blocks of intervals", blocks, blocks == intervals.div_ceil(super::BLOCK))?;
        for exact in &self.imu.exact {
            point("plan: blocks of increments", exact.len(), exact.len() == blocks)?;
        }
        point("plan: IMU rows", self.rows, self.rows <= intervals)?;
        let ascend = self.epochs.windows(2).all(|pair| pair[0].row < pair[1].row);
        point("plan: epochs", self.epochs.len(), ascend)?;
        for epoch in &self.epochs {
            point("plan: epoch", epoch.row, (1..=self.rows).contains(&epoch.row))?;
        }
        let aids = &self.aids;
        for place in aids.gnss.place.iter().chain(&aids.baro.place) {
            point("plan: place of an aid", place.interval, place.interval < intervals)?;
        }
        let fixes = aids.gnss.place.len();
        let alike = aids.gnss.antenna.len() == fixes && aids.gnss.sd.len() == fixes;
        point("plan: fixes", fixes, alike && aids.gnss.changes.iter().all(|row| *row < fixes))?;
        for slow in aids.gnss.slow.iter().flatten() {
            point("plan: decay", slow.decay.len(), slow.decay.len() == self.t_ns.len())?;
        }
        let bias = aids.baro.bias.is_none() || aids.baro.place.len() == aids.baro.height_m.len();
        point("plan: heights", aids.baro.place.len(), bias)?;
        for feed in &self.feed {
            let len = match feed.source {
                Source::Gnss => fixes,
                Source::Baro => aids.baro.height_m.len(),
                Source::Heading => aids.heading.heading_rad.len(),
            };
            point("plan: value of an aid", feed.index, feed.index < len)?;
        }
        for column in self.truths.iter().flatten() {
            point("plan: true error", *column, *column < self.columns())?;
        }
        let states = NAV + self.filter.blocks.iter().map(|b| b.kind.len()).sum::<usize>();
        point("plan: block states", self.truths.len(), self.truths.len() + NAV == states)?;
        for state in self.groups.iter().flatten() {
            point("plan: state of a group", *state, *state < states)?;
        }
        Ok(())
    }

    /// Number of true sensor errors: components of the IMU errors in their order, then those of the aids.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.imu.errors.iter().map(|e| e.kind.len()).sum::<usize>() + AID_COLUMNS
    }

    /// Deviates of a run.
    #[must_use]
    pub fn deviates(&self, run: u32) -> Deviates {
        Deviates::new(self.seed, run)
    }

    /// State that the filter of a run is told at the start, and its errors: phi (rad), velocity (m/s), position (m) along
    /// north, east, down.
    #[must_use]
    pub fn start(&self, deviates: &Deviates) -> (Initial, [Vector3<f64>; 3]) {
        let truth = &self.initial.solution;
        let sds = [&self.initial.sd_phi, &self.initial.sd_v, &self.initial.sd_p];
        let [phi, dv, dp] = core::array::from_fn(|i| {
            sds[i].component_mul(&Vector3::from(deviates.first::<3>(INITIAL[i], super::process::START)))
        });
        let true_axes = c_ne(truth.position.lat_rad, truth.position.lon_rad);
        let r_e = lla_to_ecef(&self.ellipsoid, &truth.position).0 + true_axes.tr_mul(&dp);
        let position = ecef_to_lla(&self.ellipsoid, &Ecef(r_e));
        let mut q_nb = attitude::exp(&-phi) * truth.q_nb;
        if self.ecef {
            let turn = c_ne(position.lat_rad, position.lon_rad) * true_axes.transpose();
            q_nb = attitude::from_dcm(&turn) * q_nb;
        }
        // of unit length to the last digit: whoever is handed the state normalises it to the same numbers
        let q_nb = UnitQuaternion::new_normalize(q_nb.into_inner());
        let solution = Solution { position, v_n: truth.v_n + dv, q_nb };
        (Initial { solution, ..self.initial }, [phi, dv, dp])
    }

    /// A value of an aid as the filter gets it.
    #[must_use]
    pub fn observation(&self, feed: &Feed, values: &AidValues) -> Observation {
        let t_ns = feed.t_ns;
        match feed.source {
            Source::Gnss => {
                let (position, v_n) = values.fixes[feed.index];
                let sd = &self.aids.gnss.sd[feed.index];
                let mut covariance = [[0.0; 6]; 6];
                (0..6).for_each(|i| covariance[i][i] = sd[i] * sd[i]);
                let [p, v] = self.uses;
                Observation::Gnss(GnssFix {
                    t_ns,
                    position: Some(position).filter(|at| p && !at.height_m.is_nan()),
                    velocity_n: core::array::from_fn(|i| Some(v_n[i]).filter(|x| v && !x.is_nan())),
                    covariance,
                    new_constellation: feed.new_constellation,
                })
            }
            Source::Baro => {
                let sd = self.aids.baro.sd_m;
                let height_m = values.heights_m[feed.index];
                Observation::Baro(BaroHeight { t_ns, height_m, variance: sd * sd })
            }
            Source::Heading => {
                let sd = self.aids.heading.sd_rad;
                let heading_rad = values.headings_rad[feed.index];
                Observation::Heading(Heading { t_ns, heading_rad, variance: sd * sd })
            }
        }
    }

    /// Time at which the filter takes a value for valid, ns.
    #[must_use]
    pub fn valid_ns(&self, feed: &Feed) -> i64 {
        feed.t_ns.saturating_sub(self.filter.stream.latency_ns[feed.source.index()])
    }

    /// Errors of an estimate: position (m), velocity (m/s), phi (rad), along north, east, down.
    #[must_use]
    pub fn errors(&self, estimate: &Solution, truth: &Solution) -> [Vector3<f64>; 3] {
        let earth = &self.filter.settings.earth.ellipsoid;
        let (at, of) = (&truth.position, &estimate.position);
        let (sin_lat, cos_lat) = math::sin_cos(at.lat_rad);
        let radii = earth.radii(sin_lat);
        let position = Vector3::new(
            (of.lat_rad - at.lat_rad) * (radii.meridian_m + at.height_m),
            wrap_pi(of.lon_rad - at.lon_rad) * (radii.prime_vertical_m + at.height_m) * cos_lat,
            at.height_m - of.height_m,
        );
        let turn: UnitQuaternion<f64> = truth.q_nb * estimate.q_nb.inverse();
        [position, estimate.v_n - truth.v_n, attitude::log(&turn)]
    }
}
