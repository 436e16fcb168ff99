//! Which instructions the covariance kernels run on: chosen at run time, one algorithm for all.
//!
//! A [`Kernel`] is written once over arrays. [`run`] calls it inside a function that is compiled for the widest vectors
//! that the machine has, so that the same source becomes AVX-512, AVX2 with fused multiply-add, or portable code. The
//! only `unsafe` of the crate is the call of such a function.
//!
//! The portable path rounds after every product; the other two fuse product and sum and agree with each other bit by bit
//! where the order of the sums is the same, which is so for all kernels here. Without the feature `std`, or on other
//! processors, only the portable path exists.

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
/// compiled for the portable path only.
pub(crate) trait Kernel {
    /// What comes out.
    type Output;

    /// The computation; `FMA` says whether product and sum are fused, `TILE` how many numbers go into one register, or
    /// into two where registers are short.
    fn run<const FMA: bool, const TILE: usize>(self) -> Self::Output;
}

/// Numbers on a cache line of their own: a vector that lies across two costs twice.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(64))]
pub(crate) struct Aligned<T>(pub T);

/// a b + c, fused or not.
#[inline(always)]
pub(crate) fn madd<const FMA: bool>(a: f64, b: f64, c: f64) -> f64 {
    #[cfg(feature = "std")]
    if FMA {
        return a.mul_add(b, c);
    }
    a * b + c
}

/// Runs a kernel on a set of instructions that [`Isa::detect`] or [`Isa::available`] gave; any other falls back.
#[inline]
pub(crate) fn run<K: Kernel>(isa: Isa, kernel: K) -> K::Output {
    #[cfg(all(feature = "std", target_arch = "x86_64"))]
    return x86::run(isa, kernel);
    #[cfg(not(all(feature = "std", target_arch = "x86_64")))]
    {
        let _ = isa;
        kernel.run::<false, 4>()
    }
}

#[cfg(all(feature = "std", target_arch = "x86_64"))]
#[expect(unsafe_code, reason = "a function compiled for more instructions is called after asking for them")]
mod x86 {
    use super::{Isa, Kernel};

    #[inline]
    pub(super) fn run<K: Kernel>(isa: Isa, kernel: K) -> K::Output {
        // SAFETY: the functions need the features that `Isa::available` has just found on this machine, and nothing else:
        // the kernels are safe code. The look-up is an atomic load.
        match isa.available() {
            Isa::Portable => kernel.run::<false, 4>(),
            Isa::Avx2 => unsafe { avx2(kernel) },
            Isa::Avx512 => unsafe { avx512(kernel) },
        }
    }

    #[target_feature(enable = "avx2,fma")]
    fn avx2<K: Kernel>(kernel: K) -> K::Output {
        kernel.run::<true, 4>()
    }

    #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx2,fma")]
    fn avx512<K: Kernel>(kernel: K) -> K::Output {
        kernel.run::<true, 8>()
    }
}
