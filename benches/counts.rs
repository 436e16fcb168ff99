//! Instructions per step or update, counted by callgrind: `make bench-counts`.
//!
//! By itself this program measures nothing. Under `valgrind --tool=callgrind --zero-before=counted --dump-after=counted`
//! the dumps hold one case each, in the order of the lines printed.

mod parts;

use parts::Visitor;

/// Calls of a case that are counted together: enough that what happens once per second is in it.
const CALLS: u32 = 100;

/// The calls that are counted; callgrind is told its name.
#[expect(unsafe_code, reason = "a name that no compiler changes; the program has no other of it")]
#[unsafe(no_mangle)]
#[inline(never)]
fn counted(work: &mut dyn FnMut()) {
    for _ in 0..CALLS {
        work();
    }
}

struct Counter;

impl Visitor for Counter {
    fn case(&mut self, part: &str, variant: &str, states: usize, work: &mut dyn FnMut()) {
        // what is set up at the first call
        work();
        counted(work);
        println!("{part}/{variant}/{states} {CALLS}");
    }
}

fn main() {
    parts::visit(&mut Counter);
}
