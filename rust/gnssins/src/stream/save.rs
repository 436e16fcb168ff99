//! The state with everything that waits as bytes.

use nalgebra::Vector3;

use super::intervals::INTERVALS;
use super::{Last, Navigator, Observation, Refused};
use crate::bytes::{Reader, Writer};
use crate::error::Error;
use crate::frames::Lla;
use crate::imu::Rates;
use crate::meas::baro::BaroHeight;
use crate::meas::gnss::GnssFix;
use crate::meas::heading::Heading;
use crate::meas::{Measurement, PARTS, SOURCES, Source};
use crate::nav::NavModel;

impl<M: NavModel, const CAP: usize, const PENDING: usize> Navigator<M, CAP, PENDING> {
    /// Bytes that [`Navigator::save`] writes at most.
    #[must_use]
    pub const fn saved_len(&self) -> usize {
        self.ekf.saved_len()
            + 8 * (1 + 1 + 12 + INTERVALS + 2 + 1 + 2 * PARTS + 5 * (1 + SOURCES) + 1 + PENDING * WORDS)
    }

    /// Writes the state with everything that waits; [`Navigator::restore`] continues with the same bits.
    ///
    /// # Errors
    /// [`Error::SavedState`] when the buffer is too short.
    pub fn save(&self, out: &mut Writer<'_>) -> Result<(), Error> {
        self.ekf.save(out)?;
        out.u64(u64::from(self.last.is_some()))?;
        let last = self.last.unwrap_or(Last { t_ns: 0, raw: Rates::default(), rates: Rates::default() });
        out.i64(last.t_ns)?;
        for v in [&last.raw.gyro, &last.raw.accel, &last.rates.gyro, &last.rates.accel] {
            out.f64s(v.as_slice())?;
        }
        self.intervals.recent.iter().try_for_each(|dt| out.i64(*dt))?;
        out.u64(self.intervals.next as u64)?;
        out.i64(self.intervals.owed_ns)?;
        out.u64(u64::from(self.saturated))?;
        for refused in &self.refused {
            out.u64(u64::from(refused.count))?;
            out.f64s(&[refused.ratio])?;
        }
        for c in core::iter::once(&self.imu).chain(&self.aids) {
            for v in [c.total, c.used, c.rejected, c.late, c.bad] {
                out.u64(v)?;
            }
        }
        out.u64(self.pending.iter().flatten().count() as u64)?;
        self.pending.iter().flatten().try_for_each(|(row, aid)| save_aid(out, *row, aid))
    }

    /// Restores what a navigator with the same configuration saved.
    ///
    /// # Errors
    /// [`Error::SavedState`] when the bytes do not fit; the navigator is then unchanged.
    pub fn restore(&mut self, saved: &mut Reader<'_>) -> Result<(), Error> {
        let mut next = self.clone();
        next.ekf.restore(saved)?;
        let some = saved.flag()?;
        let t_ns = saved.i64()?;
        let mut v = [[0.0; 3]; 4];
        for v in &mut v {
            saved.f64s(v)?;
        }
        let [gyro, accel, gyro2, accel2] = v.map(Vector3::from);
        let rates = Rates { gyro: gyro2, accel: accel2 };
        next.last = some.then_some(Last { t_ns, raw: Rates { gyro, accel }, rates });
        for dt in &mut next.intervals.recent {
            *dt = saved.i64()?;
        }
        next.intervals.next = (saved.u64()? % INTERVALS as u64) as usize;
        next.intervals.owed_ns = saved.i64()?;
        next.saturated = saved.flag()?;
        for refused in &mut next.refused {
            let count = saved.u64()?.min(u64::from(u32::MAX)) as u32;
            *refused = Refused { count, ratio: saved.f64()? };
        }
        for c in core::iter::once(&mut next.imu).chain(&mut next.aids) {
            for v in [&mut c.total, &mut c.used, &mut c.rejected, &mut c.late, &mut c.bad] {
                *v = saved.u64()?;
            }
        }
        let waiting = saved.u64()?;
        if waiting > PENDING as u64 {
            return Err(Error::SavedState {
                what: "waiting measurements",
                need: PENDING as u64,
                got: waiting,
            });
        }
        next.pending = [None; PENDING];
        next.waiting = waiting as usize;
        for slot in next.pending.iter_mut().take(waiting as usize) {
            *slot = Some(restore_aid(saved)?);
        }
        *self = next;
        Ok(())
    }
}

/// Words of one saved measurement: row, source, time, flags, three of position, three of velocity, 36 of covariance.
const WORDS: usize = 4 + 6 + 36;

fn save_aid(out: &mut Writer<'_>, row: u64, aid: &Observation) -> Result<(), Error> {
    out.u64(row)?;
    out.u64(aid.source().index() as u64)?;
    out.i64(aid.t_ns())?;
    match aid {
        Observation::Gnss(fix) => {
            let mut flags = u64::from(fix.position.is_some());
            for (i, v) in fix.velocity_n.iter().enumerate() {
                flags |= u64::from(v.is_some()) << (i + 1);
            }
            out.u64(flags | u64::from(fix.new_constellation) << 4)?;
            let p = fix.position.unwrap_or(Lla::new(0.0, 0.0, 0.0));
            out.f64s(&[p.lat_rad, p.lon_rad, p.height_m])?;
            out.f64s(&fix.velocity_n.map(|v| v.unwrap_or(0.0)))?;
            fix.covariance.iter().try_for_each(|r| out.f64s(r))
        }
        Observation::Baro(b) => out.f64s(&[b.height_m, b.variance]),
        Observation::Heading(h) => out.f64s(&[h.heading_rad, h.variance]),
    }
}

fn restore_aid(saved: &mut Reader<'_>) -> Result<(u64, Observation), Error> {
    let row = saved.u64()?;
    let source = saved.u64()?;
    let t_ns = saved.i64()?;
    let aid = match usize::try_from(source).ok().and_then(|i| Source::ALL.get(i)) {
        Some(Source::Gnss) => Observation::Gnss(restore_fix(saved, t_ns)?),
        Some(Source::Baro) => {
            let mut v = [0.0; 2];
            saved.f64s(&mut v)?;
            Observation::Baro(BaroHeight { t_ns, height_m: v[0], variance: v[1] })
        }
        Some(Source::Heading) => {
            let mut v = [0.0; 2];
            saved.f64s(&mut v)?;
            Observation::Heading(Heading { t_ns, heading_rad: v[0], variance: v[1] })
        }
        None => {
            return Err(Error::SavedState { what: "source of a measurement", need: 0, got: source });
        }
    };
    Ok((row, aid))
}

fn restore_fix(saved: &mut Reader<'_>, t_ns: i64) -> Result<GnssFix, Error> {
    let flags = saved.u64()?;
    let (mut p, mut v, mut covariance) = ([0.0; 3], [0.0; 3], [[0.0; 6]; 6]);
    saved.f64s(&mut p)?;
    saved.f64s(&mut v)?;
    for r in &mut covariance {
        saved.f64s(r)?;
    }
    let position = (flags & 1 == 1).then(|| Lla::new(p[0], p[1], p[2]));
    let velocity_n = core::array::from_fn(|i| (flags >> (i + 1) & 1 == 1).then_some(v[i]));
    Ok(GnssFix { t_ns, position, velocity_n, covariance, new_constellation: flags >> 4 & 1 == 1 })
}
