//! One agile state whose linearisation the tests of transition and covariance share.

use gnssins::discretise::{ImuNoise, Order, Transition};
use gnssins::layout::Layout;
use gnssins::nav::ned::Ned;
use gnssins::nav::{Dynamics, NavModel, Solution};
use nalgebra::Vector3;

use super::{settings, solution};

pub const CAP: usize = 40;
pub const W_B: Vector3<f64> = Vector3::new(0.3, -0.2, 0.5);
pub const F_B: Vector3<f64> = Vector3::new(1.0, -3.0, -10.0);
pub const ORDERS: [Order; 3] = [Order::First, Order::Second, Order::Third];

pub fn somewhere() -> Solution {
    solution([-40.0, 120.0, 2000.0], [-120.0, 150.0, 30.0], [25.0, -35.0, 160.0])
}

pub fn dynamics() -> Dynamics {
    Ned::new(settings().earth, &somewhere()).unwrap().dynamics(&F_B)
}

pub fn noise() -> ImuNoise {
    ImuNoise { gyro_psd: Vector3::new(1e-9, 2e-9, 3e-9), accel_psd: Vector3::new(1e-6, 2e-6, 4e-6) }
}

pub fn real_transition(layout: &Layout<CAP>, dt_s: f64, order: Order) -> Transition<CAP> {
    super::transition(&dynamics(), layout, &noise(), &W_B, &F_B, dt_s, order)
}
