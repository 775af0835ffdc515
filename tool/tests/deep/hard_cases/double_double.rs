//! Numbers of 106 bits: the reference where double precision may be too coarse.
//!
//! A double-double is the unevaluated sum of two doubles (Dekker 1971; the algorithms of Hida, Li and Bailey 2000). The
//! library is generic over its scalar, so the same equations run in these numbers. Sine and cosine are Taylor series
//! after a reduction by π/2. Square roots take one Newton step. The relative error is about 1e-31.

use haptic_bridge::math::{Math, Real};
use num_traits::{Num, One, Zero};
use std::cmp::Ordering;
use std::fmt;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Rem, RemAssign, Sub, SubAssign};

/// The sum of `high` and `low`, |low| at most half a unit in the last place of `high`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DoubleDouble {
    pub high: f64,
    pub low: f64,
}

/// Computes a + b exactly, for |a| ≥ |b|.
fn fast_two_sum(a: f64, b: f64) -> DoubleDouble {
    let high = a + b;
    DoubleDouble { high, low: b - (high - a) }
}

/// Computes a + b exactly.
fn two_sum(a: f64, b: f64) -> DoubleDouble {
    let high = a + b;
    let part = high - a;
    DoubleDouble { high, low: (a - (high - part)) + (b - part) }
}

/// Computes a b exactly.
fn two_product(a: f64, b: f64) -> DoubleDouble {
    let high = a * b;
    DoubleDouble { high, low: a.mul_add(b, -high) }
}

impl From<f64> for DoubleDouble {
    fn from(high: f64) -> Self {
        Self { high, low: 0.0 }
    }
}

impl Add for DoubleDouble {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let s = two_sum(self.high, other.high);
        let t = two_sum(self.low, other.low);
        let v = fast_two_sum(s.high, s.low + t.high);
        fast_two_sum(v.high, v.low + t.low)
    }
}

impl Neg for DoubleDouble {
    type Output = Self;
    fn neg(self) -> Self {
        Self { high: -self.high, low: -self.low }
    }
}

impl Sub for DoubleDouble {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for DoubleDouble {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let p = two_product(self.high, other.high);
        fast_two_sum(p.high, p.low + (self.high * other.low + self.low * other.high))
    }
}

impl Div for DoubleDouble {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let first = self.high / other.high;
        let rest = self - other * first.into();
        let second = rest.high / other.high;
        let rest = rest - other * second.into();
        fast_two_sum(first, second) + (rest.high / other.high).into()
    }
}

impl Rem for DoubleDouble {
    type Output = Self;
    fn rem(self, other: Self) -> Self {
        let turns = (self / other).high.trunc();
        self - other * turns.into()
    }
}

macro_rules! assign {
    ($($Trait:ident $function:ident $operator:tt;)*) => {
        $(impl $Trait for DoubleDouble {
            fn $function(&mut self, other: Self) {
                *self = *self $operator other;
            }
        })*
    };
}
assign! {
    AddAssign add_assign +;
    SubAssign sub_assign -;
    MulAssign mul_assign *;
    DivAssign div_assign /;
    RemAssign rem_assign %;
}

impl PartialOrd for DoubleDouble {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        match self.high.partial_cmp(&other.high) {
            Some(Ordering::Equal) => self.low.partial_cmp(&other.low),
            order => order,
        }
    }
}

impl Zero for DoubleDouble {
    fn zero() -> Self {
        0.0.into()
    }
    fn is_zero(&self) -> bool {
        self.high == 0.0
    }
}

impl One for DoubleDouble {
    fn one() -> Self {
        1.0.into()
    }
}

impl Num for DoubleDouble {
    type FromStrRadixErr = <f64 as Num>::FromStrRadixErr;
    fn from_str_radix(text: &str, radix: u32) -> Result<Self, Self::FromStrRadixErr> {
        f64::from_str_radix(text, radix).map(Self::from)
    }
}

impl fmt::Display for DoubleDouble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{:+e}", self.high, self.low)
    }
}

impl Real for DoubleDouble {
    const EPSILON: Self = Self { high: 4.93e-32, low: 0.0 };
    const INFINITY: Self = Self { high: f64::INFINITY, low: 0.0 };
    fn from_f64(value: f64) -> Self {
        value.into()
    }
    fn to_f64(self) -> f64 {
        self.high
    }
    fn from_i32(value: i32) -> Self {
        f64::from(value).into()
    }
    fn whole(self) -> i32 {
        self.high as i32
    }
    fn abs(self) -> Self {
        if self.high < 0.0 { -self } else { self }
    }
    fn is_finite(self) -> bool {
        self.high.is_finite() && self.low.is_finite()
    }
}

/// Taylor series and Newton's step in 106 bits.
#[derive(Clone, Copy, Debug, Default)]
pub struct Series;

impl Math<DoubleDouble> for Series {
    const NAME: &'static str = "106-bit series";

    fn sin_cos(angle: DoubleDouble) -> (DoubleDouble, DoubleDouble) {
        // π/2 in three doubles (digits of π), so that many turns leave the rest as exact as the angle.
        const HALF_PI: [f64; 3] =
            [std::f64::consts::FRAC_PI_2, 6.123_233_995_736_766e-17, -1.497_384_904_859_169_8e-33];
        let turns = (angle.high / HALF_PI[0]).round();
        let r = HALF_PI.iter().fold(angle, |rest, part| rest - two_product(turns, *part));
        let z = r * r;
        // Σ (-1)ᵏ r²ᵏ⁺¹/(2k+1)! and Σ (-1)ᵏ r²ᵏ/(2k)!, smallest terms first.
        let series = |first: f64| {
            (1..=15).rev().fold(DoubleDouble::one(), |sum, k| {
                let n = 2.0 * f64::from(k) + first;
                DoubleDouble::one() - z * sum / (n * (n - 1.0)).into()
            })
        };
        let (sine, cosine) = (r * series(1.0), series(0.0));
        match turns.rem_euclid(4.0) as u8 {
            0 => (sine, cosine),
            1 => (cosine, -sine),
            2 => (-sine, -cosine),
            _ => (-cosine, sine),
        }
    }

    fn sqrt(value: DoubleDouble) -> DoubleDouble {
        if value.high <= 0.0 {
            return if value.high == 0.0 { value } else { f64::NAN.into() };
        }
        let root: DoubleDouble = value.high.sqrt().into();
        root + (value - root * root) / (root + root)
    }
}

#[test]
fn sine_and_root_have_thirty_digits() {
    // High and low parts computed with mpmath at 60 digits.
    for (angle, sine, cosine) in SINES {
        let (s, c) = Series::sin_cos(angle.into());
        for (found, expected) in [(s, sine), (c, cosine)] {
            let expected = DoubleDouble { high: expected[0], low: expected[1] };
            assert!((found - expected).abs().high < 1e-30, "{angle}: {found} against {expected}");
        }
    }
    let two = Series::sqrt(2.0.into());
    assert!((two * two - 2.0.into()).abs().high < 1e-30);
    assert!((DoubleDouble::one() / 3.0.into() * 3.0.into() - 1.0.into()).abs().high < 1e-31);
}

/// Angle, then high and low parts of its sine and cosine.
#[cfg(test)]
const SINES: [(f64, [f64; 2], [f64; 2]); 4] = [
    (1.0, [0.8414709848078965, 1.776845092935536e-18], [0.5403023058681398, -4.760954612604417e-17]),
    (-2.75, [-0.38166099205233167, -2.7333934873880806e-17], [-0.9243023786324636, 1.7461892611378503e-17]),
    (12.5, [-0.06632189735120068, -4.628667126141473e-18], [0.9977982791785807, 3.3602447434110414e-18]),
    (-100.125, [0.3949054323786691, 2.141091823933292e-17], [0.9187217747924648, 3.8722300885299295e-17]),
];
