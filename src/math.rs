//! Scalars and elementary functions: the only module in which the library computes a sine or a square root.
//!
//! [`Real`] is the float (`f32` on the board, `f64` in the analysis). [`Math`] is a zero-sized back end that supplies
//! sine, cosine and square root. docs/results.md compares the back ends by speed and error.

use core::fmt::{Debug, Display};
use core::ops::{Neg, Sub};

/// A floating-point type that the model can use.
pub trait Real:
    nalgebra::Scalar + Copy + Default + Debug + Display + PartialOrd + Neg<Output = Self> + num_traits::NumAssign
{
    /// Returns the representable number nearest to `value`.
    fn from_f64(value: f64) -> Self;
    /// Returns the number in double precision.
    fn to_f64(self) -> f64;
    /// Returns the representable number nearest to `value`.
    fn from_i32(value: i32) -> Self;
    /// Returns the integer part, clamped to the range of `i32`; 0 for NaN.
    fn integer_part(self) -> i32;
    /// Returns the absolute value.
    fn abs(self) -> Self;
    /// Returns true if the number is neither infinite nor NaN.
    fn is_finite(self) -> bool;
    /// The distance from 1 to the next larger number.
    const EPSILON: Self;
    /// Positive infinity.
    const INFINITY: Self;

    /// Returns the smaller of the two; `other` if `self` is NaN.
    fn lesser(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
    /// Returns the larger of the two; `other` if `self` is NaN.
    fn greater(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
}

/// Converts a number to another precision.
pub(crate) fn cast<T: Real, U: Real>(value: T) -> U {
    U::from_f64(value.to_f64())
}

/// Returns the largest integer that is not above `value`.
pub(crate) fn floor_to_i32(value: f32) -> i32 {
    let whole = value as i32;
    if (whole as f32) > value { whole - 1 } else { whole }
}

/// Clamps `value` to ±`bound`, which is not negative; returns 0 if `value` is not finite.
#[inline(always)]
pub(crate) fn clamp(value: f32, bound: f32) -> f32 {
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
            fn integer_part(self) -> i32 {
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

/// An angle as an integer: 2³² units are one turn, so wrapping arithmetic drops complete turns. One unit is 1.5e-9 rad.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BinaryAngle(pub u32);

impl BinaryAngle {
    /// Returns the binary angle nearest to an angle in radians.
    pub fn from_radians(radians: f64) -> Self {
        const PER_RADIAN: f64 = 4_294_967_296.0 / core::f64::consts::TAU;
        let turns = radians / core::f64::consts::TAU;
        // Removes complete turns first, so that the rest fits for any number of turns.
        let left = radians - (turns as i64) as f64 * core::f64::consts::TAU;
        let parts = left * PER_RADIAN;
        Self((parts + if parts < 0.0 { -0.5 } else { 0.5 }) as i64 as u32)
    }
}

/// An angle from which sine and cosine are computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Angle<T> {
    /// Angle, rad.
    pub radians: T,
    /// The same angle as a binary angle, if it comes from an encoder.
    pub binary: Option<BinaryAngle>,
}

impl<T> Angle<T> {
    /// Makes an angle without a binary angle.
    pub fn from_radians(radians: T) -> Self {
        Self { radians, binary: None }
    }
}

impl<T: Real> Sub for Angle<T> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        let binary = match (self.binary, other.binary) {
            (Some(BinaryAngle(a)), Some(BinaryAngle(b))) => Some(BinaryAngle(a.wrapping_sub(b))),
            _ => None,
        };
        Self { radians: self.radians - other.radians, binary }
    }
}

/// A back end of elementary functions for the float `T`. Every function accepts any input and never panics. Input that
/// is not finite yields output that is not finite.
pub trait Math<T>: Copy + Default + Debug + Send + Sync + 'static {
    /// Name in reports.
    const NAME: &'static str;
    /// Returns (sine, cosine) of an angle in radians.
    fn sin_cos(angle: T) -> (T, T);
    /// Returns (sine, cosine) of `angle`. A back end may use the binary angle instead of the radians.
    #[inline(always)]
    fn sin_cos_of(angle: Angle<T>) -> (T, T) {
        Self::sin_cos(angle.radians)
    }
    /// Returns the square root; NaN for a negative number.
    fn sqrt(value: T) -> T;
}

/// The `libm` crate: errors of at most one unit in the last place. Slow on the board (argument reduction in f64).
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
/// root is the FPU's, correctly rounded. Needs no table in flash, and gives the same bits on PC and chip.
#[derive(Clone, Copy, Debug, Default)]
pub struct Minimax;

/// Returns the sine and cosine of `angle` (rad). Uses minimax polynomials on [-π/4, π/4] (Remez exchange on (sin r -
/// r)/r³ and (cos r - 1 + r²/2)/r⁴; residuals 3.6e-9 and 9.7e-11) after a two-term Cody-Waite reduction.
///
/// The reduction loses accuracy beyond ±1e5 rad. The controller passes angles that are already wrapped to one turn.
#[inline(always)]
pub fn minimax_sin_cos(angle: f32) -> (f32, f32) {
    const TWO_OVER_PI: f32 = core::f32::consts::FRAC_2_PI;
    // π/2 in two parts, so that a quadrant count of up to 16 bits times the head is exact in f32.
    const HALF_PI_HEAD: f32 = 1.570_312_5;
    const HALF_PI_TAIL: f32 = 4.838_268e-4;
    // 1.5 · 2²³: adding it rounds to an integer, which is then in the low bits. Valid for |angle| < 6e6.
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

/// Returns the correctly rounded square root; NaN for a negative number. FPU and libm return the same bits.
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

/// The board's trigonometry. It looks up sine and cosine of the nearest 256th of a turn and adds the rest, less than
/// π/256, by the addition theorem with two terms of each series; absolute error below 1.0e-7. Angles without a binary
/// angle go through [`Minimax`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Tabulated;

/// (sine, cosine) of every 256th of a turn.
static SIN_COS_TABLE: [(f32, f32); 256] = {
    let mut all = [(0.0, 0.0); 256];
    let mut i = 0;
    while i < 256 {
        let (sine, cosine) = sin_cos_of_place(i);
        all[i] = (sine as f32, cosine as f32);
        i += 1;
    }
    all
};

/// [`SIN_COS_TABLE`] in double precision.
static FINE_SIN_COS_TABLE: [(f64, f64); 256] = {
    let mut all = [(0.0, 0.0); 256];
    let mut i = 0;
    while i < 256 {
        all[i] = sin_cos_of_place(i);
        i += 1;
    }
    all
};

/// A 256th of a turn in two parts. The first part has 36 bits, so its product with up to 2¹⁷ is exact.
const TABLE_STEP: [f64; 2] = [1.570_796_326_792_333_3 / 64.0, 2.563_344_151_594_519e-12 / 64.0];

/// Returns (sine, cosine) of `place` 256ths of a turn.
const fn sin_cos_of_place(place: usize) -> (f64, f64) {
    // Measures from the nearest quarter turn, which is at most π/4 away.
    let quarter = (place + 32) / 64;
    let parts = place as f64 - 64.0 * quarter as f64;
    let (sine, cosine) = sin_cos_series(parts * TABLE_STEP[0], parts * TABLE_STEP[1]);
    match quarter % 4 {
        0 => (sine, cosine),
        1 => (cosine, -sine),
        2 => (-sine, -cosine),
        _ => (-cosine, sine),
    }
}

/// Returns (sine, cosine) of `x` + `rest` by their Taylor series, exact to the last digit. |`x`| ≤ π/4 rad; `rest` is
/// its rounding error.
const fn sin_cos_series(x: f64, rest: f64) -> (f64, f64) {
    // (sin x)/x - 1 and cos x - 1 by Horner's rule: -x²/(2·3) (1 - x²/(4·5) (1 - ...)).
    let (mut sine, mut cosine, mut n) = (0.0, 0.0, 20.0);
    while n > 0.0 {
        sine = -x * x / (n * (n + 1.0)) * (1.0 + sine);
        cosine = -x * x / (n * (n - 1.0)) * (1.0 + cosine);
        n -= 2.0;
    }
    (x + (x * sine + rest * (1.0 + cosine)), 1.0 + (cosine - rest * x * (1.0 + sine)))
}

/// Returns the sine and cosine of a binary angle, see [`Tabulated`].
#[inline(always)]
pub fn table_sin_cos(BinaryAngle(angle): BinaryAngle) -> (f32, f32) {
    const RADIANS: f32 = (core::f64::consts::TAU / 4_294_967_296.0) as f32;
    const HALF_TABLE_STEP: u32 = 1 << 23;
    let (sine, cosine) = SIN_COS_TABLE[(angle.wrapping_add(HALF_TABLE_STEP) >> 24) as usize];
    let d = ((angle << 8) as i32 >> 8) as f32 * RADIANS;
    let half = 0.5 * d * d;
    // sin d = d - d³/6, cos d = 1 - d²/2.
    let s = d - d * half * (1.0 / 3.0);
    (sine + (cosine * s - sine * half), cosine - (sine * s + cosine * half))
}

impl Math<f32> for Tabulated {
    const NAME: &'static str = "table";
    #[inline(always)]
    fn sin_cos(angle: f32) -> (f32, f32) {
        minimax_sin_cos(angle)
    }
    #[inline(always)]
    fn sin_cos_of(angle: Angle<f32>) -> (f32, f32) {
        match angle.binary {
            Some(binary) => table_sin_cos(binary),
            None => minimax_sin_cos(angle.radians),
        }
    }
    #[inline(always)]
    fn sqrt(value: f32) -> f32 {
        sqrt(value)
    }
}

/// The analysis's trigonometry, in double precision and from radians. It uses the same table and the addition theorem,
/// with enough terms for absolute errors below 2e-16 and, up to 1e-9 rad from a zero, relative errors below 7e-16. It
/// is faster than [`Libm`], which it calls for angles beyond ±3000 rad.
#[derive(Clone, Copy, Debug, Default)]
pub struct FineTable;

/// Returns the sine and cosine of `angle` (rad), see [`FineTable`].
#[inline(always)]
pub fn fine_sin_cos(angle: f64) -> (f64, f64) {
    const LARGEST_ANGLE: f64 = 3_000.0;
    // 1.5 · 2⁵²: adding it rounds to an integer, which is then in the low bits.
    const ROUNDER: f64 = 6_755_399_441_055_744.0;
    // Written so that NaN is not `near`.
    let near = angle.abs() <= LARGEST_ANGLE;
    if !near {
        return sin_cos_of_large(angle);
    }
    let rounded = angle * (256.0 / core::f64::consts::TAU) + ROUNDER;
    let (sine, cosine) = FINE_SIN_COS_TABLE[(rounded.to_bits() & 255) as usize];
    let places = rounded - ROUNDER;
    let d = (angle - places * TABLE_STEP[0]) - places * TABLE_STEP[1];
    let z = d * d;
    // sin d by a minimax polynomial (Remez exchange on |d| ≤ π/256, relative residual 2.6e-17), cos d by its series.
    let s = d + d * z * (-0.166_666_666_664_728_15 + z * 8.333_291_730_412_959e-3);
    let c = z * (0.5 + z * (-1.0 / 24.0 + z * (1.0 / 720.0)));
    (sine + (cosine * s - sine * c), cosine - (sine * s + cosine * c))
}

#[cold]
#[inline(never)]
fn sin_cos_of_large(angle: f64) -> (f64, f64) {
    libm::sincos(angle)
}

impl Math<f64> for FineTable {
    const NAME: &'static str = "fine table";
    #[inline(always)]
    fn sin_cos(angle: f64) -> (f64, f64) {
        fine_sin_cos(angle)
    }
    #[inline(always)]
    fn sqrt(value: f64) -> f64 {
        libm::sqrt(value)
    }
}

/// The `micromath` crate: the smallest and least accurate back end (sine 1.1e-3, square root up to 6 % relative).
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
