//! Counter-based normal deviates: a value is a function of seed, run, stream, part and place, and of nothing else.
//!
//! The bits come from Philox4x32-10 (Salmon, Moraes, Dror, Shaw 2011, "Parallel random numbers: as easy as 1, 2, 3"): the
//! key is the seed, the counter is (place, part, stream, run). Two of its 32-bit words make two deviates by the form of
//! Box and Muller (1958); so the largest is 6.7, which one normal deviate in 4e10 exceeds. Logarithm, sine and cosine are
//! polynomials of plain products and sums, which are never fused: the same bits on every machine and for every set of
//! instructions.
//!
//! Measured on an EPYC core, least of twenty: 1.6 ns per deviate with AVX-512, 2.8 with AVX2, 5.3 portable. The words of
//! ChaCha8 alone (`rand_chacha` 0.10) take 1.3 ns each, without the random access to a run that the counter gives for
//! nothing, and no Philox crate is kept: so these forty lines are our own, held to the known answers of Random123.

use crate::simd::{self, Eight, Isa, Kernel};

/// Deviates that are made together.
pub const BLOCK: usize = 64;

/// Calls of the generator in a block: each gives four deviates.
const LANES: usize = BLOCK / 4;

const LOW: u64 = 0xffff_ffff;
const MULTIPLIERS: [u64; 2] = [0xD251_1F53, 0xCD9E_8D57];
const WEYL: [u32; 2] = [0x9E37_79B9, 0xBB67_AE85];

/// Number of a stream, from its name (FNV-1a): another source of errors leaves the numbers of all others as they are.
#[must_use]
pub const fn stream(name: &str) -> u32 {
    let (bytes, mut hash, mut i) = (name.as_bytes(), 0x811c_9dc5_u32, 0);
    while i < bytes.len() {
        hash = (hash ^ bytes[i] as u32).wrapping_mul(0x0100_0193);
        i += 1;
    }
    hash
}

/// The deviates of one run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Deviates {
    key: [u32; 2],
    run: u32,
    isa: Isa,
}

impl Deviates {
    /// Of run `run` of the set with this seed.
    #[must_use]
    pub fn new(seed: u64, run: u32) -> Self {
        Self { key: [seed as u32, (seed >> 32) as u32], run, isa: Isa::detect() }
    }

    /// The same on another set of instructions.
    #[must_use]
    pub fn on(self, isa: Isa) -> Self {
        Self { isa, ..self }
    }

    /// Block `block` (deviates `64 block` to `64 block + 63`) of consecutive parts of a stream, one part per element.
    pub fn fill(&self, stream: u32, first_part: u32, block: u32, out: &mut [[f64; BLOCK]]) {
        simd::run(self.isa, Fill { from: *self, stream, first_part, block, out });
    }

    /// The set of instructions in use.
    #[must_use]
    pub const fn isa(&self) -> Isa {
        self.isa
    }

    /// As [`Deviates::fill`], to be compiled into a kernel.
    #[inline(always)]
    pub(super) fn fill_here(&self, stream: u32, first_part: u32, block: u32, out: &mut [[f64; BLOCK]]) {
        for (part, out) in (first_part..).zip(out) {
            let counter = [block.wrapping_mul(LANES as u32), part, stream, self.run];
            normals(&words(self.key, counter), out);
        }
    }

    /// The first deviate of `N` consecutive parts of a stream: for values that are drawn once.
    #[must_use]
    pub fn first<const N: usize>(&self, stream: u32, first_part: u32) -> [f64; N] {
        let mut blocks = [[0.0; BLOCK]; N];
        self.fill(stream, first_part, 0, &mut blocks);
        blocks.map(|block| block[0])
    }
}

struct Fill<'a> {
    from: Deviates,
    stream: u32,
    first_part: u32,
    block: u32,
    out: &'a mut [[f64; BLOCK]],
}

impl Kernel for Fill<'_> {
    type Output = ();

    #[inline(always)]
    fn run<E: Eight>(self) {
        self.from.fill_here(self.stream, self.first_part, self.block, self.out);
    }
}

/// One word of each of [`LANES`] calls, in the lower halves.
type Words = [u64; LANES];

/// Philox4x32-10 of [`LANES`] counters that differ in their first word, which counts upwards.
#[inline(always)]
fn words(key: [u32; 2], counter: [u32; 4]) -> [Words; 4] {
    let mut x: [Words; 4] = counter.map(|c| [u64::from(c); LANES]);
    for (lane, word) in x[0].iter_mut().enumerate() {
        *word = (*word + lane as u64) & LOW;
    }
    let mut key = key;
    for _ in 0..10 {
        let [k0, k1] = key.map(u64::from);
        for lane in 0..LANES {
            let p0 = MULTIPLIERS[0] * (x[0][lane] & LOW);
            let p1 = MULTIPLIERS[1] * (x[2][lane] & LOW);
            (x[0][lane], x[1][lane], x[2][lane], x[3][lane]) =
                ((p1 >> 32) ^ x[1][lane] ^ k0, p1 & LOW, (p0 >> 32) ^ x[3][lane] ^ k1, p0 & LOW);
        }
        key = [key[0].wrapping_add(WEYL[0]), key[1].wrapping_add(WEYL[1])];
    }
    x
}

/// Four deviates of each lane: those of the first two words, then those of the last two.
#[inline(always)]
fn normals(words: &[Words; 4], out: &mut [f64; BLOCK]) {
    for lane in 0..LANES {
        let [a, b] = pair(words[0][lane], words[1][lane]);
        let [c, d] = pair(words[2][lane], words[3][lane]);
        out[lane] = a;
        out[LANES + lane] = b;
        out[2 * LANES + lane] = c;
        out[3 * LANES + lane] = d;
    }
}

/// Box and Muller (1958): radius sqrt(-2 ln u) with u = (w + 1/2)/2^32, angle from the other word.
#[inline(always)]
fn pair(radius: u64, angle: u64) -> [f64; 2] {
    let r = (-2.0 * ln(small_integer(radius) + 0.5)).sqrt();
    // two bits choose the quadrant, thirty the angle within it, from -pi/4 to pi/4
    let t = (small_integer(angle & 0x3fff_ffff) + (0.5 - 536_870_912.0))
        * (core::f64::consts::FRAC_PI_2 / 1_073_741_824.0);
    let (s, c) = sin_cos(t);
    let (s, c) = ((r * s).to_bits(), (r * c).to_bits());
    let odd = 0_u64.wrapping_sub(angle >> 30 & 1);
    let sign = (angle >> 31) << 63;
    let (x, y) = ((s & odd) | (c & !odd), (c & odd) | (s & !odd));
    // a quarter turn takes (c, s) to (-s, c)
    [f64::from_bits(x ^ sign ^ (odd & 1 << 63)), f64::from_bits(y ^ sign)]
}

/// An integer below 2^52 as a number, without an instruction that not every machine has for vectors.
#[inline(always)]
fn small_integer(x: u64) -> f64 {
    f64::from_bits(x | 0x4330_0000_0000_0000) - 4_503_599_627_370_496.0
}

/// Natural logarithm of `x / 2^32` for 1/2 <= x < 2^32: x = 2^k m with sqrt(1/2) <= m < sqrt(2), and
/// ln m = 2 artanh s, s = (m - 1)/(m + 1), |s| < 0.172.
#[inline(always)]
fn ln(x: f64) -> f64 {
    const ONE: u64 = 0x3ff0_0000_0000_0000;
    const ROOT_HALF: u64 = 0x3fe6_a09e_667f_3bcd;
    let shifted = x.to_bits() + (ONE - ROOT_HALF);
    // the exponent of x / sqrt(1/2) with its bias of 1023
    let k = small_integer(shifted >> 52) - (1023.0 + 32.0);
    let m = f64::from_bits((shifted & 0x000f_ffff_ffff_ffff) + ROOT_HALF);
    let s = (m - 1.0) / (m + 1.0);
    let z = s * s;
    let p = 1.0 / 19.0;
    let p = p * z + 1.0 / 17.0;
    let p = p * z + 1.0 / 15.0;
    let p = p * z + 1.0 / 13.0;
    let p = p * z + 1.0 / 11.0;
    let p = p * z + 1.0 / 9.0;
    let p = p * z + 1.0 / 7.0;
    let p = p * z + 1.0 / 5.0;
    let p = p * z + 1.0 / 3.0;
    k * core::f64::consts::LN_2 + 2.0 * (s + s * (z * p))
}

/// Sine and cosine for |t| <= pi/4 by their series, to the last digit but one.
#[inline(always)]
fn sin_cos(t: f64) -> (f64, f64) {
    let z = t * t;
    let s = -1.0 / 1_307_674_368_000.0;
    let s = s * z + 1.0 / 6_227_020_800.0;
    let s = s * z - 1.0 / 39_916_800.0;
    let s = s * z + 1.0 / 362_880.0;
    let s = s * z - 1.0 / 5_040.0;
    let s = s * z + 1.0 / 120.0;
    let s = s * z - 1.0 / 6.0;
    let c = 1.0 / 20_922_789_888_000.0;
    let c = c * z - 1.0 / 87_178_291_200.0;
    let c = c * z + 1.0 / 479_001_600.0;
    let c = c * z - 1.0 / 3_628_800.0;
    let c = c * z + 1.0 / 40_320.0;
    let c = c * z - 1.0 / 720.0;
    let c = c * z + 1.0 / 24.0;
    let c = c * z - 0.5;
    (t + t * (z * s), 1.0 + z * c)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known answers of Random123 1.14, kat_vectors, philox4x32 with 10 rounds.
    #[test]
    fn words_are_those_of_the_published_vectors() {
        let first = |counter, key| words(key, counter).map(|w| w[0] as u32);
        assert_eq!(first([0; 4], [0; 2]), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(
            first([0xffff_ffff; 4], [0xffff_ffff; 2]),
            [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]
        );
        assert_eq!(
            first([0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344], [0xa409_3822, 0x299f_31d0]),
            [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1]
        );
    }

    #[test]
    fn lanes_are_consecutive_counters() {
        let all = words([7, 8], [32, 1, 2, 3]);
        for lane in 0..LANES {
            let own = words([7, 8], [32 + lane as u32, 1, 2, 3]);
            assert_eq!(all.map(|w| w[lane]), own.map(|w| w[0]));
        }
    }

    #[test]
    fn elementary_functions_are_those_of_the_library() {
        for i in 0..200_000_u64 {
            let w = i * 21_474 + i % 7;
            let x = small_integer(w) + 0.5;
            let exact = (x / 4_294_967_296.0).ln();
            assert!((ln(x) - exact).abs() <= 4e-15 * exact.abs().max(1e-3), "{x}: {} {exact}", ln(x));
            let t = (i as f64 / 1e5 - 1.0) * core::f64::consts::FRAC_PI_4;
            let (s, c) = sin_cos(t);
            assert!((s - t.sin()).abs() < 3e-16 && (c - t.cos()).abs() < 3e-16, "{t}");
        }
        assert!((ln(0.5) - (0.5_f64 / 4_294_967_296.0).ln()).abs() < 1e-14);
    }

    #[test]
    fn a_pair_is_a_radius_and_an_angle() {
        for i in 0..64_u64 {
            let (radius, angle) = (i * 67_000_000 + 5, i * 66_999_999 + 17);
            let [x, y] = pair(radius, angle);
            let u = (radius as f64 + 0.5) / 4_294_967_296.0;
            assert!((x.hypot(y) - (-2.0 * u.ln()).sqrt()).abs() < 1e-14);
            // the quadrants lie about the axes: 0 stands for -pi/4
            let turned = y.atan2(x) + core::f64::consts::FRAC_PI_4;
            let wanted = (angle as f64 + 0.5) / 4_294_967_296.0 * core::f64::consts::TAU;
            let off = (turned - wanted).rem_euclid(core::f64::consts::TAU);
            assert!(off.min(core::f64::consts::TAU - off) < 1e-9, "{angle}");
        }
    }

    #[test]
    fn moments_and_tails_are_normal() {
        // GIVEN a million deviates, THEN their moments lie within five standard deviations of the expected
        let n = 1_000_000.0;
        let mut sums = [0.0; 4];
        let mut beyond_three = 0;
        let mut block = [[0.0; BLOCK]; 1];
        for b in 0..15_625 {
            Deviates::new(42, 1).fill(9, 0, b, &mut block);
            for x in block[0] {
                for (power, sum) in sums.iter_mut().enumerate() {
                    *sum += x.powi(power as i32 + 1);
                }
                beyond_three += usize::from(x.abs() > 3.0);
            }
        }
        let [mean, square, cube, fourth] = sums.map(|s| s / n);
        assert!(mean.abs() < 5e-3 && (square - 1.0).abs() < 5.0 * 1.42e-3, "{mean} {square}");
        assert!(cube.abs() < 5.0 * 3.9e-3 && (fourth - 3.0).abs() < 5.0 * 9.8e-3, "{cube} {fourth}");
        // 2.6998e-3 of a normal variable lies beyond three sigma
        assert!((beyond_three as f64 - 2699.8).abs() < 5.0 * 52.0, "{beyond_three}");
    }

    #[test]
    fn runs_streams_parts_and_blocks_share_nothing_and_all_instructions_agree() {
        let block = |seed, run, stream, part, number, isa| {
            let mut out = [[0.0; BLOCK]; 1];
            Deviates::new(seed, run).on(isa).fill(stream, part, number, &mut out);
            out[0]
        };
        let base = block(1, 2, 3, 4, 5, Isa::Portable);
        for isa in [Isa::Portable, Isa::Avx2, Isa::Avx512] {
            assert_eq!(base, block(1, 2, 3, 4, 5, isa));
        }
        let isa = Isa::detect();
        let others = [
            block(2, 2, 3, 4, 5, isa),
            block(1 << 40, 2, 3, 4, 5, isa),
            block(1, 3, 3, 4, 5, isa),
            block(1, 2, 4, 4, 5, isa),
            block(1, 2, 3, 5, 5, isa),
            block(1, 2, 3, 4, 6, isa),
        ];
        for other in others {
            assert!(base.iter().all(|x| !other.contains(x)));
        }
        let mut parts = [[0.0; BLOCK]; 2];
        Deviates::new(1, 2).fill(3, 4, 5, &mut parts);
        assert_eq!(parts, [base, others[4]]);
    }
}
