//! The state as bytes: [`Ekf::restore`] continues with the same bits.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::Ekf;
use super::propagate::Open;
use crate::bytes::{Reader, Writer};
use crate::error::Error;
use crate::frames::Lla;
use crate::imu::ImuDelta;
use crate::nav::{NAV, NavModel, Solution};

impl<M: NavModel, const CAP: usize> Ekf<M, CAP> {
    /// Bytes that [`Ekf::save`] writes.
    #[must_use]
    pub const fn saved_len(&self) -> usize {
        let n = self.layout.len();
        8 * (3 + 10 + (n - NAV) + n * (n + 1) / 2 + 1 + 7 + 3 + (2 + n) + (2 + 10) + Open::PACKED)
    }

    /// Writes the state; [`Ekf::restore`] continues from it with the same bits.
    ///
    /// # Errors
    /// [`Error::SavedState`] when the buffer is shorter than [`Ekf::saved_len`].
    pub fn save(&self, out: &mut Writer<'_>) -> Result<(), Error> {
        out.u64(self.layout.len() as u64)?;
        out.u64(self.layout.fingerprint(M::NAME))?;
        out.i64(self.t_ns)?;
        out.f64s(&self.model.pack())?;
        out.f64s(&self.params[NAV..self.layout.len()])?;
        for i in 0..self.layout.len() {
            out.f64s(&self.cov.rows()[i][..=i])?;
        }
        out.u64(u64::from(self.previous.is_some()))?;
        let previous =
            self.previous.unwrap_or(ImuDelta { dt_s: 0.0, dtheta: Vector3::zeros(), dvel: Vector3::zeros() });
        out.f64s(&[previous.dt_s])?;
        out.f64s(previous.dtheta.as_slice())?;
        out.f64s(previous.dvel.as_slice())?;
        out.f64s(self.w_ib_b.as_slice())?;
        out.i64(self.fed_back_ns)?;
        out.u64(u64::from(self.waiting.is_some()))?;
        out.f64s(&self.waiting.unwrap_or([0.0; CAP])[..self.layout.len()])?;
        out.u64(u64::from(self.accepted.is_some()))?;
        let (t_ns, s) = self.accepted.unwrap_or((0, self.model.solution()));
        out.i64(t_ns)?;
        out.f64s(&[s.position.lat_rad, s.position.lon_rad, s.position.height_m])?;
        out.f64s(s.v_n.as_slice())?;
        out.f64s(&[s.q_nb.w, s.q_nb.i, s.q_nb.j, s.q_nb.k])?;
        out.f64s(&self.open.pack())
    }

    /// Restores a state that a filter of the same model and blocks saved.
    ///
    /// # Errors
    /// [`Error::SavedState`] when the bytes belong to another model or layout or are cut short, and what
    /// [`NavModel::unpack`] refuses; the filter is then unchanged.
    pub fn restore(&mut self, saved: &mut Reader<'_>) -> Result<(), Error> {
        let mut next = self.clone();
        let n = self.layout.len();
        saved.expect("number of states", n as u64)?;
        saved.expect("model and block list", self.layout.fingerprint(M::NAME))?;
        next.t_ns = saved.i64()?;
        let mut packed = [0.0; 10];
        saved.f64s(&mut packed)?;
        next.model.unpack(&packed)?;
        saved.f64s(&mut next.params[NAV..n])?;
        for i in 0..n {
            for j in 0..=i {
                let value = saved.f64()?;
                next.cov.set(i, j, value);
            }
        }
        let some = saved.flag()?;
        let (mut dt, mut v) = ([0.0; 1], [[0.0; 3]; 3]);
        saved.f64s(&mut dt)?;
        for v in &mut v {
            saved.f64s(v)?;
        }
        let [dtheta, dvel, w] = v.map(Vector3::from);
        next.previous = some.then_some(ImuDelta { dt_s: dt[0], dtheta, dvel });
        next.w_ib_b = w;
        next.fed_back_ns = saved.i64()?;
        let waits = saved.flag()?;
        let mut x = [0.0; CAP];
        saved.f64s(&mut x[..n])?;
        next.waiting = waits.then_some(x);
        let accepted = saved.flag()?;
        let t_ns = saved.i64()?;
        let (mut a, mut q) = ([0.0; 6], [0.0; 4]);
        saved.f64s(&mut a)?;
        saved.f64s(&mut q)?;
        next.accepted = accepted.then_some((
            t_ns,
            Solution {
                position: Lla::new(a[0], a[1], a[2]),
                v_n: Vector3::new(a[3], a[4], a[5]),
                q_nb: UnitQuaternion::new_unchecked(Quaternion::new(q[0], q[1], q[2], q[3])),
            },
        ));
        let mut open = [0.0; Open::PACKED];
        saved.f64s(&mut open)?;
        next.open = Open::unpack(&open);
        let numbers = next.params.iter().chain(&dt).chain(v.iter().flatten()).chain(&x).chain(&a).chain(&q);
        let numbers = numbers.chain(&open);
        if !numbers.copied().all(f64::is_finite) {
            return Err(Error::NonFinite { what: "saved state", t_ns: next.t_ns });
        }
        next.refresh_sensors()?;
        next.cov.check(next.t_ns)?;
        *self = next;
        Ok(())
    }
}
