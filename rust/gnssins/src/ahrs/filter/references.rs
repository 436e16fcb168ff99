//! What the filter holds the accelerometer and the magnetometer against: smoothed vectors, the field of the place,
//! a body at rest.

use nalgebra::{UnitQuaternion, Vector3};

use crate::math;

/// Share of the way that a first-order low pass goes in an interval.
pub fn share(dt_s: f64, tau_s: f64) -> f64 {
    -math::exp_m1(-dt_s / tau_s)
}

/// A vector in navigation axes behind two equal low passes, with the disturbance seen in it.
///
/// Smoothed where the true vector stands still, so that turning the body smears nothing; whenever the attitude
/// is corrected, what has been smoothed turns with it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Smoothed {
    /// Output of the first and of the second low pass; `None` before the first reading.
    passes: Option<[Vector3<f64>; 2]>,
    /// Held square of the disturbance.
    pub held: f64,
}

impl Smoothed {
    /// Takes a reading, returns the smoothed vector.
    pub fn take(&mut self, v_n: &Vector3<f64>, dt_s: f64, tau_s: f64) -> Vector3<f64> {
        let k = share(dt_s, tau_s);
        let passes = self.passes.get_or_insert([*v_n; 2]);
        passes[0] += k * (v_n - passes[0]);
        passes[1] += k * (passes[0] - passes[1]);
        passes[1]
    }

    /// Turns with a correction of the attitude.
    pub fn turn(&mut self, dq: &UnitQuaternion<f64>) {
        if let Some(passes) = self.passes.as_mut() {
            passes.iter_mut().for_each(|v| *v = dq * *v);
        }
    }

    /// Raises the held disturbance to the present one, or lets it fade with the time constant `hold_s`.
    pub fn hold(&mut self, square: f64, dt_s: f64, hold_s: f64) -> f64 {
        self.held = square.max(self.held * math::exp(-dt_s / hold_s));
        self.held
    }

    /// Eight numbers; the first tells whether there was a reading.
    pub fn pack(&self) -> [f64; 8] {
        let [a, b] = self.passes.unwrap_or_default();
        [f64::from(u8::from(self.passes.is_some())), a.x, a.y, a.z, b.x, b.y, b.z, self.held]
    }

    /// What [`Smoothed::pack`] gave.
    pub fn unpack(v: &[f64; 8]) -> Self {
        let passes = [Vector3::new(v[1], v[2], v[3]), Vector3::new(v[4], v[5], v[6])];
        Self { passes: (v[0] != 0.0).then_some(passes), held: v[7] }
    }
}

/// Horizontal and downward component of a field, which no heading changes.
pub type Meridian = [f64; 2];

/// Departure up to which a field is the same as another, share of its strength.
const SAME_FIELD: f64 = 0.1;

/// Departure at which a reading counts half in the reference field, share of its strength.
const LEARN_SCALE: f64 = 0.05;

/// Time constant of the candidate for a new reference, s.
const CANDIDATE_S: f64 = 5.0;

/// Rate from which the body turns enough to tell a field of the place from a magnet on the body, rad/s.
const TURNING: f64 = 0.35;

/// Time in which the first reference is a plain mean, s.
const FIRST_S: f64 = 2.0;

/// The undisturbed field of the place, learnt from the readings.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Field {
    /// Reference: horizontal and down, unit of the magnetometer.
    pub reference: Meridian,
    candidate: Meridian,
    /// Time of learning, and time that the candidate has stood against the reference, s.
    learnt_s: f64,
    stood_s: f64,
}

impl Field {
    /// Strength of the reference; zero before the first reading.
    pub fn strength(&self) -> f64 {
        math::hypot(self.reference[0], self.reference[1])
    }

    /// Departure of a field from another, both components, share of the strength of the reference.
    fn departure(&self, from: &Meridian, seen: &Meridian) -> [f64; 2] {
        let strength = self.strength();
        [(seen[0] - from[0]) / strength, (seen[1] - from[1]) / strength]
    }

    /// Sets the reference at the first reading; gives the departure of a reading from it.
    pub fn compare(&mut self, seen: &Meridian) -> [f64; 2] {
        if self.learnt_s == 0.0 {
            self.reference = *seen;
            self.candidate = *seen;
        }
        self.departure(&self.reference, seen)
    }

    /// Learns from a reading: the mean at first, then with the time constant `learn_s`, a departed reading less
    /// by $1/(1+e^2/e_0^2)$.
    pub fn learn(&mut self, seen: &Meridian, dt_s: f64, learn_s: f64) {
        let [a, b] = self.departure(&self.reference, seen);
        self.learnt_s += dt_s;
        let weight = match self.learnt_s > FIRST_S {
            true => 1.0 / (1.0 + (a * a + b * b) / (LEARN_SCALE * LEARN_SCALE)),
            false => 1.0,
        };
        let k = weight * (dt_s / self.learnt_s.min(learn_s)).min(1.0);
        for (r, s) in self.reference.iter_mut().zip(seen) {
            *r += k * (s - *r);
        }
    }

    /// Follows the candidate; true when it has stood for `new_s` of turning and is now the reference.
    pub fn renew(&mut self, seen: &Meridian, other: bool, rate: f64, dt_s: f64, new_s: f64) -> bool {
        let [a, b] = self.departure(&self.candidate, seen);
        let k = share(dt_s, CANDIDATE_S);
        for (c, s) in self.candidate.iter_mut().zip(seen) {
            *c += k * (s - *c);
        }
        if !other || a * a + b * b > SAME_FIELD * SAME_FIELD {
            self.stood_s = 0.0;
        } else if rate > TURNING {
            self.stood_s += dt_s;
        }
        let new = self.stood_s > new_s;
        if new {
            self.reference = self.candidate;
            self.stood_s = 0.0;
        }
        new
    }

    /// Six numbers.
    pub fn pack(&self) -> [f64; 6] {
        let (r, c) = (self.reference, self.candidate);
        [r[0], r[1], c[0], c[1], self.learnt_s, self.stood_s]
    }

    /// What [`Field::pack`] gave.
    pub fn unpack(v: &[f64; 6]) -> Self {
        Self { reference: [v[0], v[1]], candidate: [v[2], v[3]], learnt_s: v[4], stood_s: v[5] }
    }
}

/// Time constant of the means that tell rest, s.
pub(super) const REST_MEAN_S: f64 = 0.5;

/// Detection of a body that does not move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rest {
    gyro: Vector3<f64>,
    accel: Vector3<f64>,
    /// Time without movement, s; negative before the first sample.
    still_s: f64,
}

impl Default for Rest {
    fn default() -> Self {
        Self { gyro: Vector3::zeros(), accel: Vector3::zeros(), still_s: -1.0 }
    }
}

impl Rest {
    /// Takes a sample; true when neither sensor left its mean by more than its limit for `time_s`.
    pub fn take(
        &mut self,
        gyro: &Vector3<f64>,
        accel: Option<&Vector3<f64>>,
        dt_s: f64,
        limits: (f64, f64),
        time_s: f64,
    ) -> bool {
        if self.still_s < 0.0 {
            *self = Self { gyro: *gyro, accel: accel.copied().unwrap_or_default(), still_s: 0.0 };
        }
        let k = share(dt_s, REST_MEAN_S);
        self.gyro += k * (gyro - self.gyro);
        let mut still = (gyro - self.gyro).norm() <= limits.0;
        if let Some(accel) = accel {
            self.accel += k * (accel - self.accel);
            still &= (accel - self.accel).norm() <= limits.1;
        }
        self.still_s = if still { self.still_s + dt_s } else { 0.0 };
        self.still_s > time_s
    }

    /// Mean rate, rad/s.
    pub fn rate(&self) -> Vector3<f64> {
        self.gyro
    }

    /// Seven numbers.
    pub fn pack(&self) -> [f64; 7] {
        let (g, a) = (self.gyro, self.accel);
        [g.x, g.y, g.z, a.x, a.y, a.z, self.still_s]
    }

    /// What [`Rest::pack`] gave.
    pub fn unpack(v: &[f64; 7]) -> Self {
        Self { gyro: Vector3::new(v[0], v[1], v[2]), accel: Vector3::new(v[3], v[4], v[5]), still_s: v[6] }
    }
}
