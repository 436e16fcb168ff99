//! GNSS position and velocity, together or alone, with lever arm and full covariance.

use nalgebra::Vector3;

use super::{BadReason, Measurement, Rows, View};
use crate::blocks::{Axis, Coupling, Source};
use crate::frames::Lla;
use crate::nav::{Aid, NAV, NavModel};
use crate::small::{self, ROWS_MAX, Square};

/// A fix of the antenna. Components: position north, east, down (m), velocity north, east, down (m/s).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GnssFix {
    /// Time of validity, ns.
    pub t_ns: i64,
    /// Geodetic position of the antenna.
    pub position: Option<Lla>,
    /// Velocity of the antenna against the Earth along north, east, down, m/s; a receiver may lack some.
    pub velocity_n: [Option<f64>; 3],
    /// Covariance of the six components, m², m²/s and m²/s²; rows of absent components are ignored.
    pub covariance: Square,
    /// Whether the receiver works with other satellites than in the row before.
    pub new_constellation: bool,
}

impl GnssFix {
    /// The same with only some of its components, given as bits.
    pub(crate) fn only(&self, bits: u8) -> Self {
        let velocity_n = core::array::from_fn(|i| self.velocity_n[i].filter(|_| bits >> (i + 3) & 1 == 1));
        Self { position: self.position.filter(|_| bits & 0b111 != 0), velocity_n, ..*self }
    }

    /// Components present.
    fn present(&self) -> [bool; ROWS_MAX] {
        let p = self.position.is_some();
        let [vn, ve, vd] = self.velocity_n.map(|v| v.is_some());
        [p, p, p, vn, ve, vd]
    }

    fn check_values(&self) -> Result<(), BadReason> {
        if let Some(p) = self.position {
            if !p.is_valid() || p.lon_rad.abs() > core::f64::consts::TAU || p.height_m.abs() > FARTHEST_M {
                return Err(BadReason::Value);
            }
            if p.lat_rad == 0.0 && p.lon_rad == 0.0 {
                return Err(BadReason::NoFix);
            }
        }
        // NaN fails the comparison too
        if !self.velocity_n.iter().flatten().all(|v| v.abs() <= FASTEST_M_S) {
            return Err(BadReason::Value);
        }
        Ok(())
    }
}

/// Height beyond which a position is no measurement, m.
const FARTHEST_M: f64 = 1e9;
/// Speed beyond which a velocity is no measurement, m/s.
const FASTEST_M_S: f64 = 1e6;

/// Largest asymmetry of a covariance, relative to its diagonal, that counts as rounding.
const ASYMMETRY: f64 = 1e-6;

/// Checks the sub-matrix of the present components and returns it.
fn check_covariance(full: &Square, component: &[usize; ROWS_MAX], len: usize) -> Result<Square, BadReason> {
    let at = |i: usize, j: usize| full[component[i] % ROWS_MAX][component[j] % ROWS_MAX];
    let mut r = [[0.0; ROWS_MAX]; ROWS_MAX];
    for i in 0..len.min(ROWS_MAX) {
        for j in 0..=i {
            let (a, b) = (at(i, j), at(j, i));
            let scale = at(i, i).abs().max(at(j, j).abs());
            // NaN fails the comparison too
            if !(scale < f64::INFINITY && (a - b).abs() <= ASYMMETRY * scale) {
                return Err(BadReason::Covariance);
            }
            r[i][j] = 0.5 * (a + b);
            r[j][i] = r[i][j];
        }
    }
    small::Factor::of(&r, len).ok_or(BadReason::Covariance).map(|_| r)
}

impl Measurement for GnssFix {
    fn t_ns(&self) -> i64 {
        self.t_ns
    }

    fn new_constellation(&self) -> bool {
        self.new_constellation
    }

    #[inline(always)]
    fn rows<M: NavModel, const CAP: usize>(&self, view: &View<M, CAP>) -> Result<Rows<CAP>, BadReason> {
        self.check_values()?;
        let present = self.present();
        let mut component = [0; ROWS_MAX];
        let mut len = 0;
        for (c, _) in present.iter().enumerate().filter(|(_, p)| **p) {
            component[len] = c;
            len += 1;
        }
        if len == 0 {
            return Err(BadReason::Empty);
        }
        let r = check_covariance(&self.covariance, &component, len)?;

        let position = self.position.map(|p| view.model.position_aid(&view.lever_b_m, &p));
        let measured_v = Vector3::from(self.velocity_n.map(|v| v.unwrap_or(0.0)));
        let velocity = present[3..].iter().any(|p| *p).then(|| {
            view.model.velocity_aid(&view.lever_b_m, &view.w_ib_b, &measured_v, self.position.as_ref())
        });
        let mut rows = Rows { len, y: [0.0; ROWS_MAX], h: [[0.0; CAP]; ROWS_MAX], r, component };
        if let Some(aid) = &position {
            fill(&mut rows, aid, 0, view);
        }
        if let Some(aid) = &velocity {
            fill(&mut rows, aid, 3, view);
        }
        Ok(rows)
    }
}

/// The rows of the components from `first` on: the navigation part from the aid, the block parts from the layout.
#[inline(always)]
fn fill<M, const CAP: usize>(rows: &mut Rows<CAP>, aid: &Aid, first: usize, view: &View<M, CAP>) {
    let Rows { len, y, h, component, .. } = rows;
    // where a row has the component of an axis
    let mut row_of = [None; 3];
    for (row, c) in component.iter().enumerate().take(*len) {
        if let Some(place) = c.checked_sub(first).and_then(|axis| row_of.get_mut(axis)) {
            *place = Some(row);
        }
    }
    for (axis, row) in row_of.iter().enumerate() {
        if let Some((y, h)) = row.and_then(|row| y.get_mut(row).zip(h.get_mut(row))) {
            *y = aid.y[axis];
            for (j, value) in h.iter_mut().take(NAV).enumerate() {
                *value = aid.h[(axis, j)];
            }
        }
    }
    for (j, coupling) in view.layout.couplings() {
        let column: Vector3<f64> = match coupling {
            // a position does not feel a rate
            Coupling::Gyro(input) if first > 0 => {
                let factor = match input.source {
                    Source::Unit => 1.0,
                    Source::Component(k) => k.of(&view.w_ib_b),
                };
                aid.h_gyro.column(input.axis as usize) * factor
            }
            Coupling::LeverArm(k) => aid.h_lever.column(k as usize).into(),
            Coupling::GnssPosition(k) if first == 0 => error_of(k),
            Coupling::GnssVelocity(k) if first > 0 => error_of(k),
            _ => continue,
        };
        let parameter = if matches!(coupling, Coupling::GnssPosition(_) | Coupling::GnssVelocity(_)) {
            view.params[j]
        } else {
            0.0
        };
        for (value, row) in column.iter().zip(row_of) {
            if let Some((y, h)) = row.and_then(|row| y.get_mut(row).zip(h.get_mut(row))) {
                *y -= value * parameter;
                h[j] = *value;
            }
        }
    }
}

/// measured = true + error + noise, predicted = model + estimated error: the error that is left enters with minus one.
fn error_of(axis: Axis) -> Vector3<f64> {
    let mut column = Vector3::zeros();
    column[axis as usize] = -1.0;
    column
}
