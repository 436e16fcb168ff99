//! Which instructions the kernels of the filter run on: chosen at run time, one algorithm for all.
//!
//! A [`Kernel`] is written once over [`Eight`], eight numbers that are computed together. [`run`] calls it inside a
//! function that is compiled for the widest vectors that the machine has: then eight numbers are one register of AVX-512,
//! two of AVX2 with fused multiply-add, or plain numbers. All `unsafe` of the crate is in this file.
//!
//! # Why it is sound
//!
//! * The types of AVX-512 and AVX2 are private to the module `x86` here, so no kernel can be instantiated with them but by
//!   its `run`, which does so inside a function with the features switched on, after [`Isa::available`] has found
//!   these features on this machine.
//! * Loads and stores go through references to eight numbers: always valid, aligned for `f64`, and the instructions used ask
//!   for no more.
//!
//! # What agrees bit by bit
//!
//! AVX-512 and AVX2 round in the same places and add in the same order: the same bits. The portable path rounds every product
//! before it is added; it differs from the others by rounding only. Without the feature `std`, or on other processors, only
//! the portable path exists.

/// A set of instructions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Isa {
    /// What every machine of the target has.
    #[default]
    Portable,
    /// 256-bit vectors with fused multiply-add (x86-64-v3).
    Avx2,
    /// 512-bit vectors (x86-64-v4).
    Avx512,
}

impl Isa {
    /// All sets, the narrowest first.
    pub const ALL: [Self; 3] = [Self::Portable, Self::Avx2, Self::Avx512];

    /// The widest that this machine has.
    #[must_use]
    pub fn detect() -> Self {
        #[cfg(all(feature = "std", target_arch = "x86_64"))]
        {
            if std::is_x86_feature_detected!("avx512f")
                && std::is_x86_feature_detected!("avx512dq")
                && std::is_x86_feature_detected!("avx512vl")
            {
                return Self::Avx512;
            }
            if std::is_x86_feature_detected!("avx2") && std::is_x86_feature_detected!("fma") {
                return Self::Avx2;
            }
        }
        Self::Portable
    }

    /// This set, or the widest that the machine has where that is narrower.
    #[must_use]
    pub fn available(self) -> Self {
        let widest = Self::detect();
        if self as u8 <= widest as u8 { self } else { widest }
    }
}

/// Something to compute, written once. Implementations and all that they call are `#[inline(always)]`, or they would be
/// compiled for the portable path only; closures that compute with [`Eight`] are not.
pub(crate) trait Kernel {
    /// What comes out.
    type Output;

    /// The computation.
    fn run<E: Eight>(self) -> Self::Output;
}

/// How many numbers are computed together.
pub(crate) const LANES: usize = 8;

/// Numbers side by side.
pub(crate) type Lanes = [f64; LANES];

/// Eight numbers that are computed together.
pub(crate) trait Eight: Copy {
    /// Whether a product is added before it is rounded.
    #[cfg_attr(not(feature = "std"), expect(dead_code, reason = "only plain numbers there"))]
    const FUSED: bool;
    /// Sums of eight that stay in registers beside each other.
    const SUMS: usize;

    /// The same number eight times.
    fn splat(x: f64) -> Self;
    /// From memory.
    fn load(x: &Lanes) -> Self;
    /// To memory.
    fn store(self, to: &mut Lanes);
    /// Sums.
    fn plus(self, other: Self) -> Self;
    /// Products.
    fn times(self, other: Self) -> Self;
    /// `self + a b`.
    fn madd(self, a: Self, b: Self) -> Self;
    /// The sum of all eight, by halves: 0 + 4, 1 + 5 and so on first.
    fn sum(self) -> f64;
    /// Eight rows to eight columns.
    fn transpose(rows: [Self; LANES]) -> [Self; LANES];
    /// Bit i is set where number i is not zero.
    fn nonzero(self) -> u8;
}

/// Stands in a loop over numbers that lie far apart: without it the compiler gathers and scatters them by vectors, which costs
/// more than it saves.
#[inline(always)]
pub(crate) fn one_by_one() {
    core::hint::black_box(());
}

/// a b + c, as [`Eight::madd`] has it.
#[inline(always)]
pub(crate) fn madd<E: Eight>(a: f64, b: f64, c: f64) -> f64 {
    #[cfg(feature = "std")]
    if E::FUSED {
        return a.mul_add(b, c);
    }
    a * b + c
}

/// Numbers on a cache line of their own: a vector that lies across two costs twice.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(64))]
pub(crate) struct Aligned<T>(pub T);

/// Eight plain numbers.
#[derive(Clone, Copy)]
pub(crate) struct Plain(Lanes);

impl Eight for Plain {
    const FUSED: bool = false;
    const SUMS: usize = 2;

    #[inline(always)]
    fn splat(x: f64) -> Self {
        Self([x; LANES])
    }

    #[inline(always)]
    fn load(x: &Lanes) -> Self {
        Self(*x)
    }

    #[inline(always)]
    fn store(self, to: &mut Lanes) {
        *to = self.0;
    }

    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        let mut out = self.0;
        for i in 0..LANES {
            out[i] += other.0[i];
        }
        Self(out)
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        let mut out = self.0;
        for i in 0..LANES {
            out[i] *= other.0[i];
        }
        Self(out)
    }

    #[inline(always)]
    fn madd(self, a: Self, b: Self) -> Self {
        let mut out = self.0;
        for i in 0..LANES {
            out[i] += a.0[i] * b.0[i];
        }
        Self(out)
    }

    #[inline(always)]
    fn sum(self) -> f64 {
        let [a, b, c, d, e, f, g, h] = self.0;
        ((a + e) + (c + g)) + ((b + f) + (d + h))
    }

    #[inline(always)]
    fn transpose(rows: [Self; LANES]) -> [Self; LANES] {
        let mut out = rows;
        for i in 0..LANES {
            for j in 0..LANES {
                out[i].0[j] = rows[j].0[i];
            }
        }
        out
    }

    #[inline(always)]
    fn nonzero(self) -> u8 {
        let mut bits = 0;
        for i in 0..LANES {
            bits |= u8::from(self.0[i] != 0.0) << i;
        }
        bits
    }
}

/// Runs a kernel on a set of instructions; one that the machine lacks falls back.
#[inline]
pub(crate) fn run<K: Kernel>(isa: Isa, kernel: K) -> K::Output {
    #[cfg(all(feature = "std", target_arch = "x86_64"))]
    return x86::run(isa, kernel);
    #[cfg(not(all(feature = "std", target_arch = "x86_64")))]
    {
        let _ = isa;
        kernel.run::<Plain>()
    }
}

#[cfg(all(feature = "std", target_arch = "x86_64"))]
#[expect(unsafe_code, reason = "vector instructions, used after asking for them")]
mod x86 {
    use core::arch::x86_64::*;

    use super::{Eight, Isa, Kernel, LANES, Lanes, Plain};

    #[inline]
    pub(super) fn run<K: Kernel>(isa: Isa, kernel: K) -> K::Output {
        // SAFETY: the functions need the features that `Isa::available` has just found on this machine, and nothing else.
        // The look-up is an atomic load.
        match isa.available() {
            Isa::Portable => kernel.run::<Quad>(),
            Isa::Avx2 => unsafe { avx2(kernel) },
            Isa::Avx512 => unsafe { avx512(kernel) },
        }
    }

    /// Four registers of SSE2, which every x86-64 has.
    #[derive(Clone, Copy)]
    pub(super) struct Quad([__m128d; 4]);

    // SAFETY: `load` and `store` touch the eight numbers that they borrow; the rest is safe.
    impl Eight for Quad {
        const FUSED: bool = false;
        const SUMS: usize = 2;

        #[inline(always)]
        fn splat(x: f64) -> Self {
            unsafe { Self([_mm_set1_pd(x); 4]) }
        }

        #[inline(always)]
        fn load(x: &Lanes) -> Self {
            let x = x.as_ptr();
            unsafe {
                Self([
                    _mm_loadu_pd(x),
                    _mm_loadu_pd(x.add(2)),
                    _mm_loadu_pd(x.add(4)),
                    _mm_loadu_pd(x.add(6)),
                ])
            }
        }

        #[inline(always)]
        fn store(self, to: &mut Lanes) {
            let to = to.as_mut_ptr();
            unsafe {
                _mm_storeu_pd(to, self.0[0]);
                _mm_storeu_pd(to.add(2), self.0[1]);
                _mm_storeu_pd(to.add(4), self.0[2]);
                _mm_storeu_pd(to.add(6), self.0[3]);
            }
        }

        #[inline(always)]
        fn plus(self, other: Self) -> Self {
            let mut out = self;
            for (o, x) in out.0.iter_mut().zip(other.0) {
                *o = unsafe { _mm_add_pd(*o, x) };
            }
            out
        }

        #[inline(always)]
        fn times(self, other: Self) -> Self {
            let mut out = self;
            for (o, x) in out.0.iter_mut().zip(other.0) {
                *o = unsafe { _mm_mul_pd(*o, x) };
            }
            out
        }

        #[inline(always)]
        fn madd(self, a: Self, b: Self) -> Self {
            self.plus(a.times(b))
        }

        #[inline(always)]
        fn sum(self) -> f64 {
            let mut lanes = [0.0; LANES];
            self.store(&mut lanes);
            Plain(lanes).sum()
        }

        #[inline(always)]
        fn transpose(rows: [Self; LANES]) -> [Self; LANES] {
            let mut out = rows;
            for i in 0..LANES / 2 {
                for j in 0..LANES / 2 {
                    let (a, b) = (rows[2 * j].0[i], rows[2 * j + 1].0[i]);
                    unsafe {
                        out[2 * i].0[j] = _mm_unpacklo_pd(a, b);
                        out[2 * i + 1].0[j] = _mm_unpackhi_pd(a, b);
                    }
                }
            }
            out
        }

        #[inline(always)]
        fn nonzero(self) -> u8 {
            let mut bits = 0;
            for (i, x) in self.0.iter().enumerate() {
                bits |= unsafe { _mm_movemask_pd(_mm_cmpneq_pd(*x, _mm_setzero_pd())) } << (2 * i);
            }
            bits as u8
        }
    }

    #[target_feature(enable = "avx2,fma")]
    fn avx2<K: Kernel>(kernel: K) -> K::Output {
        kernel.run::<Double>()
    }

    #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx2,fma")]
    fn avx512<K: Kernel>(kernel: K) -> K::Output {
        kernel.run::<Single>()
    }

    /// One register of AVX-512.
    #[derive(Clone, Copy)]
    struct Single(__m512d);

    // SAFETY of all that follows: only `avx512` above makes values of this type, so the features are there; `load` and
    // `store` touch the eight numbers that they borrow.
    impl Eight for Single {
        const FUSED: bool = true;
        const SUMS: usize = 18;

        #[inline(always)]
        fn splat(x: f64) -> Self {
            unsafe { Self(_mm512_set1_pd(x)) }
        }

        #[inline(always)]
        fn load(x: &Lanes) -> Self {
            unsafe { Self(_mm512_loadu_pd(x.as_ptr())) }
        }

        #[inline(always)]
        fn store(self, to: &mut Lanes) {
            unsafe { _mm512_storeu_pd(to.as_mut_ptr(), self.0) }
        }

        #[inline(always)]
        fn plus(self, other: Self) -> Self {
            unsafe { Self(_mm512_add_pd(self.0, other.0)) }
        }

        #[inline(always)]
        fn times(self, other: Self) -> Self {
            unsafe { Self(_mm512_mul_pd(self.0, other.0)) }
        }

        #[inline(always)]
        fn madd(self, a: Self, b: Self) -> Self {
            unsafe { Self(_mm512_fmadd_pd(a.0, b.0, self.0)) }
        }

        #[inline(always)]
        fn sum(self) -> f64 {
            unsafe {
                let (low, high) = (_mm512_castpd512_pd256(self.0), _mm512_extractf64x4_pd::<1>(self.0));
                sum_of_four(_mm256_add_pd(low, high))
            }
        }

        #[inline(always)]
        fn transpose(rows: [Self; LANES]) -> [Self; LANES] {
            unsafe {
                // no closures: they would not be compiled for these instructions
                let [a, b, c, d, e, f, g, h] = rows;
                // columns 0, 2, 4, 6 of two rows each, and columns 1, 3, 5, 7
                let (ab0, ab1) = (_mm512_unpacklo_pd(a.0, b.0), _mm512_unpackhi_pd(a.0, b.0));
                let (cd0, cd1) = (_mm512_unpacklo_pd(c.0, d.0), _mm512_unpackhi_pd(c.0, d.0));
                let (ef0, ef1) = (_mm512_unpacklo_pd(e.0, f.0), _mm512_unpackhi_pd(e.0, f.0));
                let (gh0, gh1) = (_mm512_unpacklo_pd(g.0, h.0), _mm512_unpackhi_pd(g.0, h.0));
                // of four rows each: columns 0 and 4, 2 and 6, 1 and 5, 3 and 7
                let (ad04, ad26) = (even(ab0, cd0), odd(ab0, cd0));
                let (ad15, ad37) = (even(ab1, cd1), odd(ab1, cd1));
                let (eh04, eh26) = (even(ef0, gh0), odd(ef0, gh0));
                let (eh15, eh37) = (even(ef1, gh1), odd(ef1, gh1));
                [
                    Self(even(ad04, eh04)),
                    Self(even(ad15, eh15)),
                    Self(even(ad26, eh26)),
                    Self(even(ad37, eh37)),
                    Self(odd(ad04, eh04)),
                    Self(odd(ad15, eh15)),
                    Self(odd(ad26, eh26)),
                    Self(odd(ad37, eh37)),
                ]
            }
        }

        #[inline(always)]
        fn nonzero(self) -> u8 {
            unsafe { _mm512_cmp_pd_mask::<_CMP_NEQ_UQ>(self.0, _mm512_setzero_pd()) }
        }
    }

    /// Quarters 0 and 2 of both.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn even(x: __m512d, y: __m512d) -> __m512d {
        _mm512_shuffle_f64x2::<0b10_00_10_00>(x, y)
    }

    /// Quarters 1 and 3 of both.
    #[inline]
    #[target_feature(enable = "avx512f")]
    fn odd(x: __m512d, y: __m512d) -> __m512d {
        _mm512_shuffle_f64x2::<0b11_01_11_01>(x, y)
    }

    /// Four rows to four columns.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn four(a: __m256d, b: __m256d, c: __m256d, d: __m256d) -> [__m256d; 4] {
        let (ab0, ab1) = (_mm256_unpacklo_pd(a, b), _mm256_unpackhi_pd(a, b));
        let (cd0, cd1) = (_mm256_unpacklo_pd(c, d), _mm256_unpackhi_pd(c, d));
        [
            _mm256_permute2f128_pd::<0x20>(ab0, cd0),
            _mm256_permute2f128_pd::<0x20>(ab1, cd1),
            _mm256_permute2f128_pd::<0x31>(ab0, cd0),
            _mm256_permute2f128_pd::<0x31>(ab1, cd1),
        ]
    }

    /// Two registers of AVX2.
    #[derive(Clone, Copy)]
    struct Double(__m256d, __m256d);

    // SAFETY of all that follows: only `avx2` above makes values of this type, so the features are there; `load` and
    // `store` touch the eight numbers that they borrow.
    impl Eight for Double {
        const FUSED: bool = true;
        const SUMS: usize = 5;

        #[inline(always)]
        fn splat(x: f64) -> Self {
            unsafe { Self(_mm256_set1_pd(x), _mm256_set1_pd(x)) }
        }

        #[inline(always)]
        fn load(x: &Lanes) -> Self {
            unsafe { Self(_mm256_loadu_pd(x.as_ptr()), _mm256_loadu_pd(x.as_ptr().add(4))) }
        }

        #[inline(always)]
        fn store(self, to: &mut Lanes) {
            unsafe {
                _mm256_storeu_pd(to.as_mut_ptr(), self.0);
                _mm256_storeu_pd(to.as_mut_ptr().add(4), self.1);
            }
        }

        #[inline(always)]
        fn plus(self, other: Self) -> Self {
            unsafe { Self(_mm256_add_pd(self.0, other.0), _mm256_add_pd(self.1, other.1)) }
        }

        #[inline(always)]
        fn times(self, other: Self) -> Self {
            unsafe { Self(_mm256_mul_pd(self.0, other.0), _mm256_mul_pd(self.1, other.1)) }
        }

        #[inline(always)]
        fn madd(self, a: Self, b: Self) -> Self {
            unsafe { Self(_mm256_fmadd_pd(a.0, b.0, self.0), _mm256_fmadd_pd(a.1, b.1, self.1)) }
        }

        #[inline(always)]
        fn sum(self) -> f64 {
            unsafe { sum_of_four(_mm256_add_pd(self.0, self.1)) }
        }

        #[inline(always)]
        fn transpose(rows: [Self; LANES]) -> [Self; LANES] {
            unsafe {
                let [a, b, c, d, e, f, g, h] = rows;
                let [a0, a1, a2, a3] = four(a.0, b.0, c.0, d.0);
                let [b0, b1, b2, b3] = four(e.0, f.0, g.0, h.0);
                let [a4, a5, a6, a7] = four(a.1, b.1, c.1, d.1);
                let [b4, b5, b6, b7] = four(e.1, f.1, g.1, h.1);
                [
                    Self(a0, b0),
                    Self(a1, b1),
                    Self(a2, b2),
                    Self(a3, b3),
                    Self(a4, b4),
                    Self(a5, b5),
                    Self(a6, b6),
                    Self(a7, b7),
                ]
            }
        }

        #[inline(always)]
        fn nonzero(self) -> u8 {
            unsafe {
                let zero = _mm256_setzero_pd();
                let low = _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_NEQ_UQ>(self.0, zero));
                let high = _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_NEQ_UQ>(self.1, zero));
                (low | high << 4) as u8
            }
        }
    }

    /// 0 + 2 and 1 + 3 first.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn sum_of_four(x: __m256d) -> f64 {
        let pair = _mm_add_pd(_mm256_castpd256_pd128(x), _mm256_extractf128_pd::<1>(x));
        _mm_cvtsd_f64(_mm_add_sd(pair, _mm_unpackhi_pd(pair, pair)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every operation, on numbers that leave nothing to chance.
    struct All;

    impl Kernel for All {
        type Output = Vec<f64>;

        #[inline(always)]
        fn run<E: Eight>(self) -> Vec<f64> {
            let rows: [Lanes; LANES] = core::array::from_fn(|i| {
                core::array::from_fn(|j| 1.0 / (1.3 + i as f64 * 8.0 + j as f64) - 0.1)
            });
            let rows = rows.map(|r| E::load(&r));
            let (a, b) = (rows[0], rows[1]);
            let mut out = vec![];
            let mut push = |x: E| {
                let mut lanes = [0.0; LANES];
                x.store(&mut lanes);
                out.extend(lanes);
            };
            push(a.plus(b));
            push(a.times(b));
            push(E::splat(0.7));
            for row in E::transpose(rows) {
                push(row);
            }
            // a product that is exact: fused or not, the sum is the same
            push(E::splat(1.5).madd(E::splat(0.25), b));
            out.push(a.sum());
            let mut holes = [0.0; LANES];
            (holes[1], holes[2], holes[6], holes[7]) = (-0.0, 1e-300, f64::NAN, -3.0);
            out.push(f64::from(E::load(&holes).nonzero()));
            out.push(madd::<E>(0.5, 3.0, 0.1));
            out
        }
    }

    #[test]
    fn every_instruction_set_does_what_plain_numbers_do() {
        let plain = All.run::<Plain>();
        let [column, row] = [2, 5].map(|i| 24 + 8 * i);
        assert_eq!(plain[column + 5], 1.0 / (1.3 + 42.0) - 0.1);
        assert_eq!(plain[row + 2], 1.0 / (1.3 + 21.0) - 0.1);
        assert_eq!(plain[plain.len() - 2], f64::from(0b1100_0100_u8));
        for isa in Isa::ALL {
            assert_eq!(run(isa, All), plain, "{isa:?}");
        }
    }
}
