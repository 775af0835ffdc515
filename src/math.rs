//! Scalars and elementary functions: the only place where the library touches a sine or a square root.
//!
//! [`Real`] is the float (`f32` on the board, `f64` in the analysis); [`Math`] is a zero-sized back end that
//! supplies sine-and-cosine and square root for it. Which back end ships on the board is decided by the
//! speed-against-error report (docs/results.md), so every one stays selectable.

use core::fmt::{Debug, Display};
use core::ops::Neg;

/// The floating-point numbers the model is written for.
pub trait Real:
    nalgebra::Scalar + Copy + Default + Debug + Display + PartialOrd + Neg<Output = Self> + num_traits::NumAssign
{
    /// The nearest representable number.
    fn from_f64(value: f64) -> Self;
    /// The same number in double precision.
    fn to_f64(self) -> f64;
    /// The nearest representable number.
    fn from_i32(value: i32) -> Self;
    /// The whole part; limited to what fits, 0 for NaN.
    fn whole(self) -> i32;
    /// Absolute value.
    fn abs(self) -> Self;
    /// Neither infinite nor NaN.
    fn is_finite(self) -> bool;
    /// The distance from 1 to the next larger number.
    const EPSILON: Self;
    /// Larger than any number.
    const INFINITY: Self;

    /// The smaller of two; `other` when `self` is NaN.
    fn lesser(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
    /// The larger of two; `other` when `self` is NaN.
    fn greater(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
}

/// The same number in another precision.
pub(crate) fn cast<T: Real, U: Real>(value: T) -> U {
    U::from_f64(value.to_f64())
}

/// `value` within ±`bound`, which is not negative; 0 for what is not finite.
#[inline(always)]
pub(crate) fn limited(value: f32, bound: f32) -> f32 {
    if value.abs() <= bound {
        value
    } else if value.is_finite() {
        bound.copysign(value)
    } else {
        0.0
    }
}

macro_rules! real {
    ($float:ident) => {
        impl Real for $float {
            const EPSILON: Self = $float::EPSILON;
            const INFINITY: Self = $float::INFINITY;
            #[inline(always)]
            fn from_f64(value: f64) -> Self {
                value as $float
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                f64::from(self)
            }
            #[inline(always)]
            fn from_i32(value: i32) -> Self {
                value as $float
            }
            #[inline(always)]
            fn whole(self) -> i32 {
                self as i32
            }
            #[inline(always)]
            fn abs(self) -> Self {
                $float::abs(self)
            }
            #[inline(always)]
            fn is_finite(self) -> bool {
                $float::is_finite(self)
            }
        }
    };
}
real!(f32);
real!(f64);

/// A back end of elementary functions for the float `T`. All of them accept any input and never panic;
/// what is not finite yields what is not finite.
pub trait Math<T>: Copy + Default + Debug + Send + Sync + 'static {
    /// The name used in reports.
    const NAME: &'static str;
    /// (sine, cosine) of an angle in radians.
    fn sin_cos(angle: T) -> (T, T);
    /// Square root; NaN for a negative number.
    fn sqrt(value: T) -> T;
}

/// `libm`: correctly rounded to within one unit in the last place; slow on the board because its argument reduction
/// is done in software double precision.
#[derive(Clone, Copy, Debug, Default)]
pub struct Libm;

impl Math<f32> for Libm {
    const NAME: &'static str = "libm";
    #[inline(always)]
    fn sin_cos(angle: f32) -> (f32, f32) {
        libm::sincosf(angle)
    }
    #[inline(always)]
    fn sqrt(value: f32) -> f32 {
        libm::sqrtf(value)
    }
}

impl Math<f64> for Libm {
    const NAME: &'static str = "libm";
    #[inline(always)]
    fn sin_cos(angle: f64) -> (f64, f64) {
        libm::sincos(angle)
    }
    #[inline(always)]
    fn sqrt(value: f64) -> f64 {
        libm::sqrt(value)
    }
}

/// One pair of minimax polynomials after a quadrant reduction; absolute error below 1.2e-7 for |angle| ≤ 2π. The square
/// root is the FPU's, correctly rounded. No table in flash, and a PC and the chip agree bit for bit.
#[derive(Clone, Copy, Debug, Default)]
pub struct Minimax;

/// Sine and cosine of `angle` (rad) by minimax polynomials on [-π/4, π/4] (Remez exchange on (sin r - r)/r³ and
/// (cos r - 1 + r²/2)/r⁴; residuals 3.6e-9 and 9.7e-11), after a two-term Cody-Waite reduction by π/2.
///
/// Angles beyond ±1e5 rad lose the reduction's accuracy; the controller hands in angles already wrapped to a turn.
#[inline(always)]
pub fn minimax_sin_cos(angle: f32) -> (f32, f32) {
    const TWO_OVER_PI: f32 = core::f32::consts::FRAC_2_PI;
    // π/2 split so that a quadrant count of up to 16 bits times the head is exact in f32.
    const HALF_PI_HEAD: f32 = 1.570_312_5;
    const HALF_PI_TAIL: f32 = 4.838_268e-4;
    // 1.5 · 2²³: adding it rounds to a whole number, which then stands in the low bits. Good for |angle| < 6e6.
    const ROUNDER: f32 = 12_582_912.0;
    let rounded = angle * TWO_OVER_PI + ROUNDER;
    let quadrant = rounded.to_bits();
    let turns = rounded - ROUNDER;
    let r = (angle - turns * HALF_PI_HEAD) - turns * HALF_PI_TAIL;
    let z = r * r;
    let sine = r + r * z * (-0.166_666_55 + z * (8.332_174e-3 + z * -1.951_665_6e-4));
    let cosine = 1.0 - 0.5 * z + z * z * (4.166_664_7e-2 + z * (-1.388_736_1e-3 + z * 2.443_773e-5));
    let (sine, cosine) = if quadrant & 1 == 0 { (sine, cosine) } else { (cosine, -sine) };
    if quadrant & 2 == 0 { (sine, cosine) } else { (-sine, -cosine) }
}

/// Square root, correctly rounded; NaN for a negative number. The FPU's on the chip, libm's elsewhere: the same bits.
#[inline(always)]
pub fn sqrt(value: f32) -> f32 {
    #[cfg(target_arch = "arm")]
    return haptic_fpu::sqrt(value);
    #[cfg(not(target_arch = "arm"))]
    libm::sqrtf(value)
}

impl Math<f32> for Minimax {
    const NAME: &'static str = "minimax";
    #[inline(always)]
    fn sin_cos(angle: f32) -> (f32, f32) {
        minimax_sin_cos(angle)
    }
    #[inline(always)]
    fn sqrt(value: f32) -> f32 {
        sqrt(value)
    }
}

/// The `micromath` crate: smallest, least accurate (sine 1.1e-3, square root up to 6 % relative).
#[cfg(feature = "micromath")]
#[derive(Clone, Copy, Debug, Default)]
pub struct Micromath;

#[cfg(feature = "micromath")]
impl Math<f32> for Micromath {
    const NAME: &'static str = "micromath";
    #[inline(always)]
    fn sin_cos(angle: f32) -> (f32, f32) {
        let angle = micromath::F32(angle);
        (angle.sin().0, angle.cos().0)
    }
    #[inline(always)]
    fn sqrt(value: f32) -> f32 {
        micromath::F32(value).sqrt().0
    }
}
