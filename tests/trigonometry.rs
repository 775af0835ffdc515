//! The board's elementary functions against double precision.

use haptic_bridge::math::{Libm, Math, Minimax};

/// Largest absolute error of sine and cosine over angles from -`turns` to `turns` turns.
fn worst_angle<K: Math<f32>>(turns: f32) -> f64 {
    let steps = 200_000;
    (-steps..=steps)
        .map(|step| {
            let angle = turns * core::f32::consts::TAU * step as f32 / steps as f32;
            let (sine, cosine) = K::sin_cos(angle);
            let exact = f64::from(angle);
            (f64::from(sine) - exact.sin()).abs().max((f64::from(cosine) - exact.cos()).abs())
        })
        .fold(0.0, f64::max)
}

#[test]
fn the_polynomials_are_within_one_and_a_fifth_of_ten_millionths() {
    assert!(worst_angle::<Minimax>(1.0) < 1.2e-7, "{}", worst_angle::<Minimax>(1.0));
    assert!(worst_angle::<Libm>(1.0) < 1.2e-7, "{}", worst_angle::<Libm>(1.0));
}

#[test]
fn what_is_not_a_number_stays_one() {
    for angle in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let (sine, cosine) = Minimax::sin_cos(angle);
        assert!(!sine.is_finite() && !cosine.is_finite(), "{angle}: {sine}, {cosine}");
    }
    assert!(<Minimax as Math<f32>>::sqrt(-1.0).is_nan());
    assert!(<Minimax as Math<f32>>::sqrt(f32::NAN).is_nan());
}

#[test]
fn the_square_root_is_correctly_rounded() {
    // Every 1009th number that is not negative, subnormal ones and infinity too. Rounding a root of double precision once
    // more does no harm: it has more than twice the digits.
    for bits in (0..=f32::INFINITY.to_bits()).step_by(1009).chain([1, f32::INFINITY.to_bits()]) {
        let value = f32::from_bits(bits);
        assert_eq!(<Minimax as Math<f32>>::sqrt(value), f64::from(value).sqrt() as f32, "{value:e}");
    }
}
