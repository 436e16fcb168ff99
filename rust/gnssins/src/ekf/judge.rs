//! Whether a measurement is to be believed: innovation, its covariance, and the tests on both.

use super::{Ekf, Gate};
use crate::error::Error;
use crate::math;
use crate::meas::{BadReason, PART, PARTS, Record, Rows, Source, Status, Test};
use crate::nav::NavModel;
use crate::small::{self, ROWS_MAX};

/// Largest ratio of prior variance over noise variance that a full covariance in double precision can take in.
const PRECISION: f64 = 1e15;

/// Sigmas of a fix that the tolerance test allows, on a difference of two.
const TOLERANCE_SIGMAS: f64 = 5.0 * core::f64::consts::SQRT_2;

impl<M: NavModel, const CAP: usize> Ekf<M, CAP> {
    /// Innovation, its covariance and NIS on the prior.
    pub(super) fn evaluate(
        &self,
        source: Source,
        row: u64,
        rows: &Rows<CAP>,
    ) -> Result<Result<Record, BadReason>, Error> {
        let mut record = Record::unevaluated(source, row, self.t_ns, Status::Used);
        record.dof = rows.len;
        let s = self.innovation_covariance(rows);
        let len = rows.len.min(ROWS_MAX);
        if (0..len).any(|i| s[i][i] > PRECISION * rows.r[i][i]) {
            return Ok(Err(BadReason::Covariance));
        }
        let Some(factor) = small::Factor::of(&s, rows.len) else {
            self.cov.check(self.t_ns)?;
            return Ok(Err(BadReason::Covariance));
        };
        record.nis = factor.norm_squared(&rows.y);
        let component = rows.component.map(|c| c.min(ROWS_MAX - 1));
        for (i, &c) in component.iter().enumerate().take(len) {
            record.present |= 1 << c;
            record.innovation[c] = -rows.y[i];
            for (j, &d) in component.iter().enumerate().take(len) {
                record.innovation_cov[c][d] = s[i][j];
            }
        }
        Ok(if record.nis.is_finite() { Ok(record) } else { Err(BadReason::Value) })
    }

    /// Puts the verdict of the tests into a record.
    pub(super) fn judge(&self, rows: &Rows<CAP>, record: &mut Record) {
        let gates = &self.gates[record.source.index()];
        let set = &self.settings.integrity;
        let whole = set.gate == Gate::Joint && record.nis > gates[rows.len.min(ROWS_MAX)];
        if whole {
            record.refuse(record.present, Test::ChiSquare);
        }
        for part in 0..PARTS {
            let bits = part_bits(part) & record.present;
            if bits == 0 {
                continue;
            }
            if set.gate == Gate::Parts {
                let (nis, dof) = part_nis(record, bits);
                if nis > gates[dof.min(ROWS_MAX)] {
                    record.refuse(bits, Test::ChiSquare);
                }
            }
            let fix = record.source == Source::Gnss;
            if fix && set.trace_ratio_limit.is_some_and(|limit| trace_ratio(record, bits) >= limit) {
                record.refuse(bits, Test::TraceRatio);
            }
            if fix && set.max_accel_m_s2.is_some_and(|a| self.beyond_tolerance(part, rows, a)) {
                record.refuse(bits, Test::Tolerance);
            }
            if record.refused & bits != 0 {
                let (nis, dof) = if whole { (record.nis, record.dof) } else { part_nis(record, bits) };
                record.part_ratio[part] = nis / dof as f64;
            }
        }
        if record.refused == record.present {
            record.status = Status::Rejected;
        }
    }

    /// Whether a part of a fix lies farther from the extrapolated last accepted estimate than the vehicle can have gone.
    fn beyond_tolerance(&self, part: usize, rows: &Rows<CAP>, accel: f64) -> bool {
        let Some((then_ns, then)) = &self.accepted else { return false };
        let now = self.solution();
        let dt = self.t_ns.saturating_sub(*then_ns) as f64 / super::NS;
        let (reach, moved) = if part == 0 {
            let radii = self.settings.earth.ellipsoid.radii(math::sin(then.position.lat_rad));
            let (m, n) =
                (radii.meridian_m + then.position.height_m, radii.prime_vertical_m + then.position.height_m);
            let east = crate::frames::wrap_pi(now.position.lon_rad - then.position.lon_rad);
            let gone = nalgebra::Vector3::new(
                (now.position.lat_rad - then.position.lat_rad) * m,
                east * n * math::cos(then.position.lat_rad),
                then.position.height_m - now.position.height_m,
            );
            (0.5 * accel * dt * dt, gone - then.v_n * dt)
        } else {
            (accel * dt, now.v_n - then.v_n)
        };
        // measured minus extrapolated = predicted minus extrapolated, less y = predicted minus measured
        (0..rows.len.min(ROWS_MAX)).filter(|i| rows.component[*i] / PART == part).any(|i| {
            let off = moved[rows.component[i] % PART] - rows.y[i];
            math::abs(off) > reach + TOLERANCE_SIGMAS * math::sqrt(rows.r[i][i])
        })
    }
}

/// Bits of the components of a part.
const fn part_bits(part: usize) -> u8 {
    0b111 << (part * PART)
}

/// Components among some bits.
fn components(bits: u8) -> impl Iterator<Item = usize> {
    (0..ROWS_MAX).filter(move |c| bits >> c & 1 == 1)
}

/// NIS of some components by themselves, and their number; infinite where their covariance is none.
fn part_nis(record: &Record, bits: u8) -> (f64, usize) {
    let len = components(bits).count();
    let (mut s, mut y) = ([[0.0; ROWS_MAX]; ROWS_MAX], [0.0; ROWS_MAX]);
    for ((row, y), i) in s.iter_mut().zip(&mut y).zip(components(bits)) {
        *y = record.innovation[i];
        for (s, j) in row.iter_mut().zip(components(bits)) {
            *s = record.innovation_cov[i][j];
        }
    }
    (small::Factor::of(&s, len).map_or(f64::INFINITY, |factor| factor.norm_squared(&y)), len)
}

/// Innovation squared over the trace of its covariance; Novik (2011), integrity test of a subvector.
fn trace_ratio(record: &Record, bits: u8) -> f64 {
    let squared: f64 = components(bits).map(|c| record.innovation[c] * record.innovation[c]).sum();
    squared / components(bits).map(|c| record.innovation_cov[c][c]).sum::<f64>()
}
