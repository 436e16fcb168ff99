//! The crate in a program of yours: the filter alone, then the stream around it. `cargo run --example embedded`.

use gnssins::attitude;
use gnssins::ekf::{Ekf, Initial, Settings};
use gnssins::error::Error;
use gnssins::frames::Lla;
use gnssins::imu::{Coning, ImuDelta, ImuInput};
use gnssins::inverse::FreeIns;
use gnssins::meas::gnss::GnssFix;
use gnssins::meas::{Record, Status};
use gnssins::nav::{EarthModel, NavModel, Solution, ned::Ned};
use gnssins::presets;
use gnssins::stream::{Event, Navigator, Sink, StreamSettings};
use nalgebra::Vector3;

/// States of the filter, 9 + 3 + 3, rounded up to a multiple of 8.
const CAP: usize = 16;
type Filter = Ekf<Ned, CAP>;

const STEP_NS: i64 = 10_000_000; // IMU at 100 Hz
const STEPS_PER_FIX: u64 = 20; // GNSS at 5 Hz
const STEPS: u64 = 12_000; // two minutes

fn main() -> Result<(), Error> {
    filter_alone()?;
    with_the_stream()
}

// ---- 1. the filter alone: predict to the time of a fix, then update

fn filter_alone() -> Result<(), Error> {
    let mut car = Car::new()?;
    let mut filter = make_filter(&car)?;
    let (mut used, mut rejected) = (0, 0);
    for step in 1..=STEPS {
        let imu = car.drive()?;
        filter.predict(car.t_ns, &imu.dtheta, &imu.dvel)?; // rad, m/s since the last time
        if step % STEPS_PER_FIX == 0 {
            match filter.update(step / STEPS_PER_FIX - 1, &car.fix())?.status {
                Status::Used => used += 1,
                _ => rejected += 1,
            }
        }
    }
    println!("filter alone: {used} fixes used, {rejected} not");
    print_result(&filter, &car);
    Ok(())
}

// ---- 2. the stream: rows as they come, gaps, late fixes, counts, events

/// Takes what the navigator has to tell. On a microcontroller: a counter, a flag, a line on a serial port.
#[derive(Default)]
struct Log {
    nis_sum: f64,
    fixes: u32,
}

impl Sink for Log {
    fn event(&mut self, event: &Event) {
        let t_s = event.t_ns as f64 / 1e9;
        println!("  {t_s:.2} s, row {}: {} {:.2}", event.row, event.kind.code(), event.value);
    }

    fn record(&mut self, record: &Record) {
        if record.status == Status::Used {
            self.nis_sum += record.nis;
            self.fixes += 1;
        }
    }
}

fn with_the_stream() -> Result<(), Error> {
    let mut car = Car::new()?;
    let settings = StreamSettings { input: ImuInput::Increments, ..StreamSettings::default() };
    let mut navigator: Navigator<Ned, CAP> = Navigator::new(make_filter(&car)?, settings);
    let mut log = Log::default();
    println!("stream:");
    for step in 1..=STEPS {
        let imu = car.drive()?;
        if step % STEPS_PER_FIX == 0 {
            navigator.gnss(&car.fix(), &mut log)?; // before the IMU row that reaches its time
        }
        if !(6_000..6_005).contains(&step) {
            navigator.imu(car.t_ns, &imu.dtheta, &imu.dvel, &mut log)?; // five rows are lost at 60 s
        }
    }
    navigator.finish(&mut log);
    let (imu, gnss) = (navigator.imu_counts(), navigator.gnss_counts());
    println!("  IMU rows {} = {} used + {} bad", imu.total, imu.used, imu.bad);
    println!("  fixes {} = {} used + {} rejected", gnss.total, gnss.used, gnss.rejected);
    println!("  mean NIS of fixes with six components: {:.2}", log.nis_sum / f64::from(log.fixes));
    print_result(navigator.ekf(), &car);
    Ok(())
}

// ---- common to both

fn make_filter(car: &Car) -> Result<Filter, Error> {
    let preset = presets::find("ned-15").expect("the preset is part of the crate");
    let blocks = [preset.blocks[0].1, preset.blocks[1].1]; // gyro bias, accelerometer bias
    let settings = Settings::new(preset.noise);
    // the filter starts a little wrong, and knows about how much
    let mut solution = car.truth.model().solution();
    solution.position.height_m += 2.0;
    solution.q_nb = attitude::exp(&Vector3::new(0.01, -0.01, 0.05)) * solution.q_nb;
    let initial = Initial {
        t_ns: 0,
        solution,
        sd_phi: Vector3::new(0.01, 0.01, 0.05),
        sd_v: Vector3::repeat(0.1),
        sd_p: Vector3::repeat(2.0),
    };
    Filter::new(&settings, &blocks, &initial)
}

fn print_result(filter: &Filter, car: &Car) {
    let (solution, sd, truth) = (filter.solution(), filter.solution_sd(), car.truth.model().solution());
    let earth = EarthModel::default().ellipsoid;
    let radii = earth.radii(truth.position.lat_rad.sin());
    let height = truth.position.height_m;
    let north = (solution.position.lat_rad - truth.position.lat_rad) * (radii.meridian_m + height);
    let up = solution.position.height_m - height;
    let (_, _, heading) = attitude::to_euler(&solution.q_nb);
    let (_, _, true_heading) = attitude::to_euler(&truth.q_nb);
    let gyro_z = filter.params()[11].to_degrees();
    println!(
        "  north error {north:+.3} m (sd {:.3}), up {up:+.3} m (sd {:.3})",
        sd.position_m.x, sd.position_m.z
    );
    println!(
        "  heading error {:+.3} deg (sd {:.3})",
        (heading - true_heading).to_degrees(),
        sd.euler_rad.z.to_degrees()
    );
    println!("  gyro z bias {gyro_z:.4} deg/s, true {:.4}", car.gyro_bias.z.to_degrees());
}

// ---- a stand-in for your sensors: a car on a winding road, a gyro with a bias, a receiver with noise

struct Car {
    t_ns: i64,
    truth: FreeIns<Ned>,
    gyro_bias: Vector3<f64>,
    random: u64,
}

impl Car {
    fn new() -> Result<Self, Error> {
        let position = Lla::new(48.78_f64.to_radians(), 9.18_f64.to_radians(), 320.0);
        let (v_n, q_nb) = motion(0);
        let model = Ned::new(EarthModel::default(), &Solution { position, v_n, q_nb })?;
        let gyro_bias = Vector3::new(0.0, 0.0, 0.1_f64.to_radians());
        Ok(Self { t_ns: 0, truth: FreeIns::new(model, Coning::TwoSample), gyro_bias, random: 1 })
    }

    fn drive(&mut self) -> Result<ImuDelta, Error> {
        self.t_ns += STEP_NS;
        let dt_s = STEP_NS as f64 / 1e9;
        let (v_n, q_nb) = motion(self.t_ns);
        let mut imu = self.truth.step_to(dt_s, &v_n, &q_nb)?;
        imu.dtheta += self.gyro_bias * dt_s;
        Ok(imu)
    }

    fn fix(&mut self) -> GnssFix {
        let truth = self.truth.model().solution();
        let radii = EarthModel::default().ellipsoid.radii(truth.position.lat_rad.sin());
        let mut position = truth.position;
        position.lat_rad += 0.5 * self.noise() / radii.meridian_m;
        position.lon_rad += 0.5 * self.noise() / (radii.prime_vertical_m * position.lat_rad.cos());
        position.height_m += 0.5 * self.noise();
        let velocity_n = [truth.v_n.x, truth.v_n.y, truth.v_n.z].map(|v| Some(v + 0.1 * self.noise()));
        let mut covariance = [[0.0; 6]; 6];
        for (i, row) in covariance.iter_mut().enumerate() {
            row[i] = if i < 3 { 0.5 * 0.5 } else { 0.1 * 0.1 }; // m², m²/s²
        }
        GnssFix {
            t_ns: self.t_ns,
            position: Some(position),
            velocity_n,
            covariance,
            new_constellation: false,
        }
    }

    /// About normal, mean 0 and variance 1: the sum of twelve uniform numbers (Knuth's 64-bit generator).
    fn noise(&mut self) -> f64 {
        let mut uniform = || {
            self.random =
                self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.random >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..12).map(|_| uniform()).sum::<f64>() - 6.0
    }
}

/// Velocity and attitude: curves to both sides, faster and slower.
fn motion(t_ns: i64) -> (Vector3<f64>, nalgebra::UnitQuaternion<f64>) {
    let t_s = t_ns as f64 / 1e9;
    let (heading, speed) = ((0.15 * t_s).sin(), 10.0 + 3.0 * (0.4 * t_s).sin());
    let v_n = speed * Vector3::new(heading.cos(), heading.sin(), 0.0);
    (v_n, attitude::exp(&Vector3::new(0.0, 0.0, heading)))
}
