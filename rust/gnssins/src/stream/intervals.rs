//! The usual interval between IMU rows.

/// Intervals that the usual one is taken from.
pub(super) const INTERVALS: usize = 8;

/// The latest IMU intervals. Their median is the usual one: a single gap or jittered stamp does not move it, a lasting
/// change of rate does after a few rows. Stamps that come early and late in turn are told from missing rows by what the
/// early ones owe.
#[derive(Debug, Clone, Copy)]
pub(super) struct Intervals {
    pub recent: [i64; INTERVALS],
    pub next: usize,
    /// Time by which stamps came early and which a long interval may make up for, ns.
    pub owed_ns: i64,
}

impl Intervals {
    /// Nothing seen yet.
    pub const NONE: Self = Self { recent: [0; INTERVALS], next: 0, owed_ns: 0 };

    pub fn push(&mut self, dt_ns: i64) {
        if let Some(usual) = self.usual_ns() {
            self.owed_ns = self.owed_ns.saturating_add(usual.saturating_sub(dt_ns)).max(0).min(usual);
        }
        self.recent[self.next % INTERVALS] = dt_ns;
        self.next = (self.next + 1) % INTERVALS;
    }

    /// Median, ns, or `None` until the window is full.
    pub fn usual_ns(&self) -> Option<i64> {
        let mut sorted = self.recent;
        sorted.sort_unstable();
        (sorted[0] > 0).then(|| sorted[INTERVALS / 2 - 1] / 2 + sorted[INTERVALS / 2] / 2)
    }
}
