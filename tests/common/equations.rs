//! The equations of motion once more, in the text-book form and not as the engine has them, and their differences.

use gnssins::attitude::{self, skew};
use gnssins::frames::{C_UN, Ecef as Point, c_ne, ecef_to_lla, lla_to_ecef};
use gnssins::nav::{EarthModel, Matrix9, Solution, Vector9};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Specific force (m/s²) and body rate (rad/s) of the comparisons.
pub const F_B: Vector3<f64> = Vector3::new(1.3, -2.1, -9.4);
pub const W_B: Vector3<f64> = Vector3::new(0.02, -0.03, 0.01);
/// Steps of the central differences: rad, m/s, m.
pub const STEP: [f64; 3] = [1e-4, 1.0, 100.0];

/// Latitudes (deg) and Euler angles (deg) of the grids, vertical attitudes included.
pub const LATITUDES: [f64; 7] = [-80.0, -45.0, -7.0, 0.0, 30.68, 60.0, 80.0];
pub const ATTITUDES: [[f64; 3]; 6] = [
    [0.0, 0.0, 0.0],
    [10.0, -5.0, 120.0],
    [-170.0, 40.0, -60.0],
    [30.0, 90.0, 45.0],
    [0.0, -90.0, 200.0],
    [90.0, 0.0, 10.0],
];

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Axes {
    Ned,
    Enu,
    Ecef,
}

/// Position (latitude, longitude, height; or ECEF), velocity and attitude matrix, or their rates.
#[derive(Clone, Copy, Debug)]
pub struct State {
    pub p: Vector3<f64>,
    pub v: Vector3<f64>,
    pub c: Matrix3<f64>,
}

/// Equations of motion in one set of axes.
#[derive(Clone, Copy)]
pub struct Equations {
    pub axes: Axes,
    pub earth: EarthModel,
}

impl Equations {
    /// Metres per radian of latitude and of longitude, and per metre of height, along the axes of dp.
    pub fn scale(&self, lat: f64, h: f64) -> (f64, f64) {
        let (ell, s) = (&self.earth.ellipsoid, lat.sin());
        let root = (1.0 - ell.e2 * s * s).sqrt();
        let meridian = ell.semi_major_m * (1.0 - ell.e2) / root.powi(3);
        (meridian + h, (ell.semi_major_m / root + h) * lat.cos())
    }

    fn gravity_n(&self, lat: f64, h: f64) -> Vector3<f64> {
        self.earth.ellipsoid.gravity_n(self.earth.gravity, lat.sin(), lat.cos(), h)
    }

    pub fn rate(&self, s: &State, w_b: &Vector3<f64>, f_b: &Vector3<f64>) -> State {
        let (w, x) = (self.earth.ellipsoid.omega_rad_s, s.p);
        let (w_ie, w_en, g, p) = match self.axes {
            Axes::Ned => {
                let (m, e) = self.scale(x.x, x.z);
                let n = e / x.x.cos();
                let w_ie = w * Vector3::new(x.x.cos(), 0.0, -x.x.sin());
                let w_en = Vector3::new(s.v.y / n, -s.v.x / m, -s.v.y * x.x.tan() / n);
                (w_ie, w_en, self.gravity_n(x.x, x.z), Vector3::new(s.v.x / m, s.v.y / e, -s.v.z))
            }
            Axes::Enu => {
                let (m, e) = self.scale(x.x, x.z);
                let n = e / x.x.cos();
                let w_ie = w * Vector3::new(0.0, x.x.cos(), x.x.sin());
                let w_en = Vector3::new(-s.v.y / m, s.v.x / n, s.v.x * x.x.tan() / n);
                let g = self.gravity_n(x.x, x.z);
                (w_ie, w_en, Vector3::new(0.0, g.x, -g.z), Vector3::new(s.v.y / m, s.v.x / e, s.v.z))
            }
            Axes::Ecef => {
                let lla = ecef_to_lla(&self.earth.ellipsoid, &Point(x));
                let g =
                    c_ne(lla.lat_rad, lla.lon_rad).transpose() * self.gravity_n(lla.lat_rad, lla.height_m);
                (Vector3::new(0.0, 0.0, w), Vector3::zeros(), g, s.v)
            }
        };
        State {
            p,
            v: s.c * f_b - (2.0 * w_ie + w_en).cross(&s.v) + g,
            c: s.c * skew(w_b) - skew(&(w_ie + w_en)) * s.c,
        }
    }

    /// Position change that a displacement in metres means at a state.
    fn displacement(&self, at: &State, d: Vector3<f64>) -> Vector3<f64> {
        let (m, e) = self.scale(at.p.x, at.p.z);
        match self.axes {
            Axes::Ned => Vector3::new(d.x / m, d.y / e, -d.z),
            Axes::Enu => Vector3::new(d.y / m, d.x / e, d.z),
            Axes::Ecef => d,
        }
    }

    /// Truth behind an estimate with error x.
    fn truth(&self, estimate: &State, x: &Vector9) -> State {
        let part = |k: usize| Vector3::new(x[k], x[k + 1], x[k + 2]);
        State {
            p: estimate.p - self.displacement(estimate, part(6)),
            v: estimate.v - part(3),
            c: attitude::dcm(&attitude::exp(&part(0))) * estimate.c,
        }
    }

    /// Rate of the error between an estimate and a truth that move.
    fn error_rate(&self, estimate: &State, e: &State, truth: &State, t: &State) -> Vector9 {
        // Exp(phi) = C_true C_est'; the skew part of its rate is phi' but for phi² phi'/6
        let turn = t.c * estimate.c.transpose() + truth.c * e.c.transpose();
        let phi = 0.5
            * Vector3::new(
                turn[(2, 1)] - turn[(1, 2)],
                turn[(0, 2)] - turn[(2, 0)],
                turn[(1, 0)] - turn[(0, 1)],
            );
        let (d, rate) = (estimate.p - truth.p, e.p - t.p);
        let dp = if self.axes == Axes::Ecef {
            rate
        } else {
            let (m, east) = self.scale(estimate.p.x, estimate.p.z);
            let ahead = self.scale(estimate.p.x + e.p.x, estimate.p.z + e.p.z);
            let behind = self.scale(estimate.p.x - e.p.x, estimate.p.z - e.p.z);
            let north = m * rate.x + 0.5 * (ahead.0 - behind.0) * d.x;
            let east = east * rate.y + 0.5 * (ahead.1 - behind.1) * d.y;
            let ned = Vector3::new(north, east, -rate.z);
            if self.axes == Axes::Ned { ned } else { C_UN * ned }
        };
        let dv = e.v - t.v;
        Vector9::from_column_slice(&[phi.x, phi.y, phi.z, dv.x, dv.y, dv.z, dp.x, dp.y, dp.z])
    }

    /// F and the columns of gyro and accelerometer errors.
    pub fn jacobian(&self, estimate: &State) -> (Matrix9, SMatrix<f64, 9, 6>) {
        let mut f = Matrix9::zeros();
        let rate = self.rate(estimate, &W_B, &F_B);
        for j in 0..9 {
            let step = STEP[j / 3];
            let parting = |sign: f64| {
                let mut x = Vector9::zeros();
                x[j] = sign * step;
                let truth = self.truth(estimate, &x);
                self.error_rate(estimate, &rate, &truth, &self.rate(&truth, &W_B, &F_B))
            };
            f.set_column(j, &((parting(1.0) - parting(-1.0)) / (2.0 * step)));
        }
        let mut couplings = SMatrix::<f64, 9, 6>::zeros();
        for j in 0..6 {
            // what is left in the sensor makes the estimate's input too large
            let parting = |sign: f64| {
                let mut input = [W_B, F_B];
                input[j / 3][j % 3] += sign * 1e-3;
                self.error_rate(estimate, &self.rate(estimate, &input[0], &input[1]), estimate, &rate)
            };
            couplings.set_column(j, &((parting(1.0) - parting(-1.0)) / 2e-3));
        }
        (f, couplings)
    }
}

/// A solution in the coordinates of the NED equations.
pub fn ned_state(s: &Solution) -> State {
    let p = &s.position;
    State { p: Vector3::new(p.lat_rad, p.lon_rad, p.height_m), v: s.v_n, c: attitude::dcm(&s.q_nb) }
}

/// A solution in the coordinates of the ECEF equations.
pub fn ecef_state(earth: &EarthModel, s: &Solution) -> State {
    let c_en = c_ne(s.position.lat_rad, s.position.lon_rad).transpose();
    let p = lla_to_ecef(&earth.ellipsoid, &s.position).0;
    State { p, v: c_en * s.v_n, c: c_en * attitude::dcm(&s.q_nb) }
}
