//! Saved states of the filter: every number bit by bit, so that a restored filter goes on as if never stopped.

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

use super::AttitudeFilter;
use super::covariance::{Covariance, PACKED};
use super::references::{Field, Rest, Smoothed};
use crate::bytes::{Reader, Writer};
use crate::error::Error;

/// Kind and version of the layout.
const KIND: u64 = 0x4148_5253_0001;

/// Numbers of a saved state after the kind, the two counts and the alignment.
const NUMBERS: usize = 4 + 3 + 9 + PACKED + 8 + 3 + 8 + 6 + 7;

/// Bytes of a saved state.
pub const SAVED_LEN: usize = 8 * (4 + NUMBERS);

impl AttitudeFilter {
    /// Writes the state; [`AttitudeFilter::restore`] continues from it with the same bits. Settings are not saved.
    ///
    /// # Errors
    /// [`Error::SavedState`] when the buffer is shorter than [`SAVED_LEN`].
    pub fn save(&self, out: &mut Writer<'_>) -> Result<(), Error> {
        out.u64(KIND)?;
        out.u64(self.refused)?;
        out.u64(self.restarts)?;
        out.u64(u64::from(self.aligned))?;
        let q = &self.q_nb;
        out.f64s(&[q.w, q.i, q.j, q.k])?;
        out.f64s(self.bias.as_slice())?;
        out.f64s(self.matrix.as_slice())?;
        let mut packed = [0.0; PACKED];
        self.errors.pack(&mut packed);
        out.f64s(&packed)?;
        out.f64s(&self.force.pack())?;
        out.f64s(self.speed.as_slice())?;
        out.f64s(&self.magnet.pack())?;
        out.f64s(&self.field.pack())?;
        out.f64s(&self.rest.pack())
    }

    /// Restores a state that a filter of the same settings saved.
    ///
    /// # Errors
    /// [`Error::SavedState`] when the bytes are of another kind or cut short, [`Error::NonFinite`] for a number
    /// that is not finite; the filter is then unchanged.
    pub fn restore(&mut self, saved: &mut Reader<'_>) -> Result<(), Error> {
        let mut next = *self;
        saved.expect("kind", KIND)?;
        next.refused = saved.u64()?;
        next.restarts = saved.u64()?;
        next.aligned = saved.u64()? != 0;
        let mut q = [0.0; 4];
        numbers(saved, &mut q)?;
        next.q_nb = UnitQuaternion::new_unchecked(Quaternion::new(q[0], q[1], q[2], q[3]));
        let mut three = [0.0; 3];
        numbers(saved, &mut three)?;
        next.bias = Vector3::from(three);
        let mut matrix = [0.0; 9];
        numbers(saved, &mut matrix)?;
        next.matrix = Matrix3::from_column_slice(&matrix);
        let mut packed = [0.0; PACKED];
        numbers(saved, &mut packed)?;
        next.errors = Covariance::unpack(&packed);
        let mut eight = [0.0; 8];
        numbers(saved, &mut eight)?;
        next.force = Smoothed::unpack(&eight);
        numbers(saved, &mut three)?;
        next.speed = Vector3::from(three);
        numbers(saved, &mut eight)?;
        next.magnet = Smoothed::unpack(&eight);
        let mut six = [0.0; 6];
        numbers(saved, &mut six)?;
        next.field = Field::unpack(&six);
        let mut seven = [0.0; 7];
        numbers(saved, &mut seven)?;
        next.rest = Rest::unpack(&seven);
        *self = next;
        Ok(())
    }
}

/// Reads numbers and refuses what is not finite.
fn numbers(saved: &mut Reader<'_>, out: &mut [f64]) -> Result<(), Error> {
    saved.f64s(out)?;
    match out.iter().all(|x| x.is_finite()) {
        true => Ok(()),
        false => Err(Error::NonFinite { what: "saved number", t_ns: 0 }),
    }
}
