//! Speed of the engine's parts and of a whole step, on every set of instructions that the machine has, each beside dense
//! nalgebra in the same run.
//!
//! `cargo bench` runs everything in a minute and a half; `cargo bench -- covariance/` a part. Names are
//! part/variant/states. The variant `dense` does the same work on `SMatrix` of exactly the size: the transition by Horner
//! on the whole matrix, `Phi (P + Q/2) Phi' + Q/2`, and for updates the Joseph form of all rows at once, without the gate,
//! the feedback and the checks that the whole update has.

mod parts;

use std::time::Duration;

use criterion::{BenchmarkId, Criterion};
use parts::Visitor;

struct Clock(Criterion);

impl Visitor for Clock {
    fn case(&mut self, part: &str, variant: &str, states: usize, work: &mut dyn FnMut()) {
        self.0
            .benchmark_group(part)
            .bench_function(BenchmarkId::new(variant, states), |b| b.iter(&mut *work));
    }
}

fn main() {
    let mut clock = Clock(
        Criterion::default()
            .warm_up_time(Duration::from_millis(150))
            .measurement_time(Duration::from_millis(450))
            .sample_size(30)
            .nresamples(2000)
            .configure_from_args(),
    );
    parts::visit(&mut clock);
    clock.0.final_summary();
}
