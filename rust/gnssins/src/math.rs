//! One alias for every elementary function on `f64`.
//!
//! `f64::sin` and its relatives live in `std`, so a `no_std` crate must not name them. The rest of the crate
//! calls these functions only: with feature `std` they are the methods of the standard library, without it
//! the `libm` crate. The two may differ in the last bit; one build always gives the same bits. Sine and cosine
//! together ([`sin_cos`]) are those of `libm` in every build.

macro_rules! one_argument {
    ($($(#[$doc:meta])* $name:ident, $method:ident, $libm:ident;)*) => {$(
        $(#[$doc])*
        #[inline]
        #[must_use]
        pub fn $name(x: f64) -> f64 {
            #[cfg(feature = "std")]
            return x.$method();
            #[cfg(not(feature = "std"))]
            return libm::$libm(x);
        }
    )*};
}

one_argument! {
    /// Sine of an angle in radians.
    sin, sin, sin;
    /// Cosine of an angle in radians.
    cos, cos, cos;
    /// Tangent of an angle in radians.
    tan, tan, tan;
    /// Inverse sine, radians in [-pi/2, pi/2]; NaN outside [-1, 1].
    asin, asin, asin;
    /// Inverse cosine, radians in [0, pi]; NaN outside [-1, 1].
    acos, acos, acos;
    /// Inverse tangent, radians in [-pi/2, pi/2].
    atan, atan, atan;
    /// Hyperbolic tangent.
    tanh, tanh, tanh;
    /// Square root; NaN for a negative number.
    sqrt, sqrt, sqrt;
    /// Real cube root, defined for negative numbers too.
    cbrt, cbrt, cbrt;
    /// e to the power x.
    exp, exp, exp;
    /// e to the power x, minus one, accurate for small x.
    exp_m1, exp_m1, expm1;
    /// Natural logarithm.
    ln, ln, log;
    /// Natural logarithm of 1 + x, accurate for small x.
    ln_1p, ln_1p, log1p;
    /// Largest integer not above x.
    floor, floor, floor;
    /// Smallest integer not below x.
    ceil, ceil, ceil;
    /// Nearest integer, halves away from zero.
    round, round, round;
    /// Integer part, towards zero.
    trunc, trunc, trunc;
    /// Magnitude.
    abs, abs, fabs;
}

/// Sine and cosine of an angle in radians: of the same code on every machine, both at once.
#[inline]
#[must_use]
pub fn sin_cos(x: f64) -> (f64, f64) {
    libm::sincos(x)
}

/// Sine and cosine of `x + step` from those of x: by series for a step below a thousandth, exact to rounding.
#[inline(always)]
#[must_use]
pub fn sin_cos_near(sin_x: f64, cos_x: f64, x: f64, step: f64) -> (f64, f64) {
    if abs(step) > 1e-3 {
        return sin_cos(x + step);
    }
    let square = step * step;
    let sine = step * (1.0 - square / 6.0 * (1.0 - square / 20.0));
    // one minus the cosine
    let versed = 0.5 * square * (1.0 - square / 12.0 * (1.0 - square / 30.0));
    (sin_x + (cos_x * sine - sin_x * versed), cos_x - (sin_x * sine + cos_x * versed))
}

/// Four-quadrant inverse tangent of `y / x`, radians in [-pi, pi]; 0 for (0, 0).
#[inline]
#[must_use]
pub fn atan2(y: f64, x: f64) -> f64 {
    #[cfg(feature = "std")]
    return y.atan2(x);
    #[cfg(not(feature = "std"))]
    return libm::atan2(y, x);
}

/// `sqrt(x² + y²)` without overflow or underflow on the way.
#[inline]
#[must_use]
pub fn hypot(x: f64, y: f64) -> f64 {
    #[cfg(feature = "std")]
    return x.hypot(y);
    #[cfg(not(feature = "std"))]
    return libm::hypot(x, y);
}

/// x to a real power.
#[inline]
#[must_use]
pub fn powf(x: f64, y: f64) -> f64 {
    #[cfg(feature = "std")]
    return x.powf(y);
    #[cfg(not(feature = "std"))]
    return libm::pow(x, y);
}

/// x to an integer power.
#[inline]
#[must_use]
pub fn powi(x: f64, n: i32) -> f64 {
    #[cfg(feature = "std")]
    return x.powi(n);
    #[cfg(not(feature = "std"))]
    return libm::pow(x, f64::from(n));
}

/// Magnitude of `x` with the sign of `sign`.
#[inline]
#[must_use]
pub fn copysign(x: f64, sign: f64) -> f64 {
    #[cfg(feature = "std")]
    return x.copysign(sign);
    #[cfg(not(feature = "std"))]
    return libm::copysign(x, sign);
}
