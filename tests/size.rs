//! What a filter and a stream take of a small machine's memory.

use gnssins::ekf::Ekf;
use gnssins::nav::{ecef::Ecef, ned::Ned};
use gnssins::stream::Navigator;

/// Most bytes of a filter with 22 states: 4608 of them are its covariance.
const FILTER: usize = 8192;
/// Most bytes that a stream adds without a queue, and per measurement that may wait.
const STREAM: usize = 768;
const WAITING: usize = 392;

#[test]
fn a_filter_of_22_states_takes_at_most_8_kb() {
    for (model, size) in [("NED", size_of::<Ekf<Ned, 24>>()), ("ECEF", size_of::<Ekf<Ecef, 24>>())] {
        assert!(size <= FILTER, "{model}: {size} bytes, at most {FILTER}");
    }
}

#[test]
fn a_stream_adds_its_queue_and_little_else() {
    let filter = size_of::<Ekf<Ned, 24>>();
    let added = |stream: usize| stream - filter;
    assert!(added(size_of::<Navigator<Ned, 24, 0>>()) <= STREAM);
    assert!(added(size_of::<Navigator<Ned, 24>>()) <= STREAM + 32 * WAITING);
    assert!(added(size_of::<Navigator<Ned, 24, 4>>()) <= STREAM + 4 * WAITING);
}
