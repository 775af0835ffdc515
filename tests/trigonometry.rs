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
    assert!(!<Minimax as Math<f32>>::sqrt(f32::INFINITY).is_finite());
}

#[test]
fn the_square_root_is_good_to_the_last_digit_but_one() {
    assert_eq!(<Minimax as Math<f32>>::sqrt(0.0), 0.0);
    let mut worst = 0.0f64;
    // Every 1009th normal number.
    for bits in (f32::MIN_POSITIVE.to_bits()..=f32::MAX.to_bits()).step_by(1009) {
        let value = f32::from_bits(bits);
        let exact = f64::from(value).sqrt();
        worst = worst.max((f64::from(<Minimax as Math<f32>>::sqrt(value)) / exact - 1.0).abs());
    }
    assert!(worst < 1.2e-7, "{worst}");
}

#[test]
fn the_square_root_of_a_subnormal_number_loses_digits_but_not_its_sign_or_size() {
    for bits in (1..f32::MIN_POSITIVE.to_bits()).step_by(101) {
        let root = <Minimax as Math<f32>>::sqrt(f32::from_bits(bits));
        let exact = f64::from(f32::from_bits(bits)).sqrt();
        // Never too large by more than the last digits of a normal number.
        assert!(root >= 0.0 && f64::from(root) <= exact * (1.0 + 1.2e-7), "{bits}: {root} for {exact}");
    }
    let lost = |value: f32| 1.0 - f64::from(<Minimax as Math<f32>>::sqrt(value)) / f64::from(value).sqrt();
    assert!((lost(1.0e-40) - 0.4).abs() < 0.05 && lost(1.0e-44) > 0.98, "{} {}", lost(1.0e-40), lost(1.0e-44));
}
