//! Receiver, barometric altimeter and heading of two antennas of one run.
//!
//! The values of a run are made before its first step: they are few beside the IMU samples. Noise is drawn for the values
//! in outages too, so that runs with and without outages see the same values elsewhere.

use nalgebra::{Matrix3, Vector3};

use super::normal::{BLOCK, Deviates, stream};
use super::process::{COMPONENTS, Law, START, Series};
use crate::earth::Ellipsoid;
use crate::frames::{Ecef, Geodetic, Lla, ecef_to_lla};
use crate::math;

/// Where a time lies in the truth: interval and share of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Interval, from 0.
    pub interval: usize,
    /// From 0 to 1.
    pub share: f64,
}

/// True motion of the antenna at a fix, ECEF axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Antenna {
    /// Position, m.
    pub position: Vector3<f64>,
    /// Velocity, m/s.
    pub velocity: Vector3<f64>,
    /// What a metre of lever arm, body axes, adds to position and velocity.
    pub per_lever: Option<(Matrix3<f64>, Matrix3<f64>)>,
}

/// An error of the receiver that is correlated in time: a stationary part, and jumps that fade by the same rate.
#[derive(Debug, Clone, PartialEq)]
pub struct SlowError {
    /// Stream of the stationary part.
    pub stream: u32,
    /// Its law.
    pub law: Law,
    /// Stream of the jumps.
    pub jump_stream: u32,
    /// Standard deviation of a jump.
    pub jump_sd: [f64; 3],
    /// Integral of the rate from the start to each epoch of the truth.
    pub decay: Vec<f64>,
}

/// The receiver.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Gnss {
    /// Fixes, all of them, by time.
    pub place: Vec<Place>,
    /// True motion at them.
    pub antenna: Vec<Antenna>,
    /// Standard deviations of the white noise, position and velocity; NaN where the receiver gives none.
    pub sd: Vec<[f64; 6]>,
    /// Standard deviation of the lever arm about its nominal value, m.
    pub lever_sd: [f64; 3],
    /// Slow errors of position (m) and velocity (m/s) along north, east, down.
    pub slow: [Option<SlowError>; 2],
    /// Fixes with which the constellation changes.
    pub changes: Vec<usize>,
}

/// The altimeter.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Baro {
    /// Values, all of them, by time.
    pub place: Vec<Place>,
    /// True heights, m.
    pub height_m: Vec<f64>,
    /// White noise, m.
    pub sd_m: f64,
    /// Law of the bias, m.
    pub bias: Option<Law>,
}

/// Heading of two antennas.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Headings {
    /// True headings, rad.
    pub heading_rad: Vec<f64>,
    /// White noise, rad.
    pub sd_rad: f64,
}

/// All aids of a scenario.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Aids {
    /// Receiver.
    pub gnss: Gnss,
    /// Altimeter.
    pub baro: Baro,
    /// Headings.
    pub heading: Headings,
}

const LEVER: u32 = stream("gnss.lever_arm");
const WHITE: [u32; 2] = [stream("gnss.position"), stream("gnss.velocity")];
const BARO: u32 = stream("baro");
const BARO_BIAS: u32 = stream("baro.bias");
const HEADING: u32 = stream("heading");

/// What the aids of one run measure, and the true errors that a filter may estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct AidValues {
    /// Positions and velocities (m/s, along north, east, down) of all fixes.
    pub fixes: Vec<(Lla, Vector3<f64>)>,
    /// Heights, m.
    pub heights_m: Vec<f64>,
    /// Headings in [0, 2 pi), rad.
    pub headings_rad: Vec<f64>,
    /// Error of the lever arm, true minus nominal, body axes, m.
    pub lever_m: [f64; 3],
    /// At the wanted epochs: slow errors of position and velocity, bias of the altimeter.
    pub true_errors: Vec<[f64; 7]>,
}

impl AidValues {
    /// Of one run; true errors at these epochs of the truth, which ascend.
    #[must_use]
    pub fn new(aids: &Aids, ellipsoid: &Ellipsoid, deviates: &Deviates, epochs: &[usize]) -> Self {
        let gnss = &aids.gnss;
        let drawn = deviates.first::<3>(LEVER, START);
        let lever_m = core::array::from_fn(|i| gnss.lever_sd[i] * drawn[i]);
        let mut true_errors = vec![[0.0; 7]; epochs.len()];
        let mut errors = vec![[0.0; 6]; gnss.place.len()];
        for (part, slow) in gnss.slow.iter().enumerate() {
            let Some(slow) = slow else { continue };
            let at_fixes =
                |fix: usize, v: [f64; COMPONENTS]| errors[fix][3 * part..][..3].copy_from_slice(&v[..3]);
            let at_epochs =
                |k: usize, v: [f64; COMPONENTS]| true_errors[k][3 * part..][..3].copy_from_slice(&v[..3]);
            sample(&slow.law, slow.stream, 3, deviates, &gnss.place, epochs, at_fixes, at_epochs);
            add_jumps(slow, gnss, deviates, epochs, part, &mut errors, &mut true_errors);
        }
        add_white(&WHITE, gnss, deviates, &mut errors);
        let lever = Vector3::from(lever_m);
        let fixes =
            gnss.antenna.iter().zip(&errors).map(|(a, e)| measured(a, &lever, e, ellipsoid)).collect();
        Self {
            fixes,
            heights_m: heights(&aids.baro, deviates, epochs, &mut true_errors),
            headings_rad: headings(&aids.heading, deviates),
            lever_m,
            true_errors,
        }
    }
}

impl Aids {
    /// What aids without errors measure.
    #[must_use]
    pub fn exact_values(&self, ellipsoid: &Ellipsoid, epochs: usize) -> AidValues {
        let none = Vector3::zeros();
        // what the receiver does not give stays NaN
        let fixes = self.gnss.antenna.iter().zip(&self.gnss.sd);
        let fixes = fixes.map(|(a, sd)| measured(a, &none, &sd.map(|s| 0.0 * s), ellipsoid)).collect();
        AidValues {
            fixes,
            heights_m: self.baro.height_m.clone(),
            headings_rad: self.heading.heading_rad.clone(),
            lever_m: [0.0; 3],
            true_errors: vec![[0.0; 7]; epochs],
        }
    }
}

/// A fix: noise is laid off in ECEF axes along the north, east, down of the true antenna.
fn measured(
    antenna: &Antenna,
    lever: &Vector3<f64>,
    error: &[f64; 6],
    ellipsoid: &Ellipsoid,
) -> (Lla, Vector3<f64>) {
    let (mut position, mut velocity) = (antenna.position, antenna.velocity);
    if let Some((p, v)) = &antenna.per_lever {
        position += p * lever;
        velocity += v * lever;
    }
    let c_ne = Geodetic::of(ellipsoid, &position).c_ne();
    let [n, e, d, vn, ve, vd] = *error;
    let position = position + c_ne.tr_mul(&Vector3::new(n, e, d));
    (ecef_to_lla(ellipsoid, &Ecef(position)), c_ne * velocity + Vector3::new(vn, ve, vd))
}

/// Gives a process at the places of an aid, linear between the epochs of the truth, and at some epochs.
#[expect(clippy::too_many_arguments, reason = "a process, where it is wanted, and where it goes")]
fn sample(
    law: &Law,
    stream: u32,
    len: usize,
    deviates: &Deviates,
    places: &[Place],
    epochs: &[usize],
    mut at_place: impl FnMut(usize, [f64; COMPONENTS]),
    mut at_epoch: impl FnMut(usize, [f64; COMPONENTS]),
) {
    let mut series = Series::new(law, stream, len, deviates);
    let (mut p, mut e, mut block) = (0, 0, 0);
    while p < places.len() || e < epochs.len() {
        series.advance(deviates, block as u32);
        let (first, end) = (block * BLOCK, (block + 1) * BLOCK);
        while let Some(place) = places.get(p).filter(|place| place.interval < end) {
            at_place(p, core::array::from_fn(|c| series.between(c, place.interval - first, place.share)));
            p += 1;
        }
        while let Some(epoch) = epochs.get(e).filter(|epoch| **epoch <= end) {
            at_epoch(e, core::array::from_fn(|c| series.at(c, epoch - first)));
            e += 1;
        }
        block += 1;
    }
}

/// Jumps enter with the fix that they were drawn for, and fade.
fn add_jumps(
    slow: &SlowError,
    gnss: &Gnss,
    deviates: &Deviates,
    epochs: &[usize],
    part: usize,
    errors: &mut [[f64; 6]],
    true_errors: &mut [[f64; 7]],
) {
    if slow.jump_sd == [0.0; 3] {
        return;
    }
    let decay = |place: &Place| {
        let d = &slow.decay[place.interval..];
        d[0] + place.share * (d[1] - d[0])
    };
    let mut drawn = [[0.0; BLOCK]; 3];
    for (number, &fix) in gnss.changes.iter().enumerate() {
        if number % BLOCK == 0 {
            deviates.fill(slow.jump_stream, 0, (number / BLOCK) as u32, &mut drawn);
        }
        let entry = &gnss.place[fix];
        let entered = decay(entry);
        let jump: [f64; 3] = core::array::from_fn(|i| slow.jump_sd[i] * drawn[i][number % BLOCK]);
        for (error, place) in errors.iter_mut().zip(&gnss.place).skip(fix) {
            let left = math::exp(entered - decay(place));
            (0..3).for_each(|i| error[3 * part + i] += left * jump[i]);
        }
        let since = epochs.partition_point(|e| (*e as f64) < entry.interval as f64 + entry.share);
        for (error, epoch) in true_errors.iter_mut().zip(epochs).skip(since) {
            let left = math::exp(entered - slow.decay[*epoch]);
            (0..3).for_each(|i| error[3 * part + i] += left * jump[i]);
        }
    }
}

fn add_white(streams: &[u32; 2], gnss: &Gnss, deviates: &Deviates, errors: &mut [[f64; 6]]) {
    let mut drawn = [[0.0; BLOCK]; 6];
    for (block, (errors, sds)) in errors.chunks_mut(BLOCK).zip(gnss.sd.chunks(BLOCK)).enumerate() {
        let (position, velocity) = drawn.split_at_mut(3);
        deviates.fill(streams[0], 0, block as u32, position);
        deviates.fill(streams[1], 0, block as u32, velocity);
        for (i, (error, sd)) in errors.iter_mut().zip(sds).enumerate() {
            (0..6).for_each(|c| error[c] += drawn[c][i] * sd[c]);
        }
    }
}

fn heights(baro: &Baro, deviates: &Deviates, epochs: &[usize], true_errors: &mut [[f64; 7]]) -> Vec<f64> {
    let mut out = baro.height_m.clone();
    white(BARO, baro.sd_m, deviates, &mut out);
    if let Some(law) = &baro.bias {
        let at_values = |k: usize, v: [f64; COMPONENTS]| out[k] += v[0];
        let at_epochs = |k: usize, v: [f64; COMPONENTS]| true_errors[k][6] = v[0];
        sample(law, BARO_BIAS, 1, deviates, &baro.place, epochs, at_values, at_epochs);
    }
    out
}

fn headings(heading: &Headings, deviates: &Deviates) -> Vec<f64> {
    let mut out = heading.heading_rad.clone();
    white(HEADING, heading.sd_rad, deviates, &mut out);
    for value in &mut out {
        *value = value.rem_euclid(core::f64::consts::TAU);
    }
    out
}

/// Adds white noise to a column.
fn white(stream: u32, sd: f64, deviates: &Deviates, out: &mut [f64]) {
    let mut drawn = [[0.0; BLOCK]; 1];
    for (block, values) in out.chunks_mut(BLOCK).enumerate() {
        deviates.fill(stream, 0, block as u32, &mut drawn);
        for (value, n) in values.iter_mut().zip(&drawn[0]) {
            *value += n * sd;
        }
    }
}
