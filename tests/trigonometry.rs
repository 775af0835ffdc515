//! Compares the board's elementary functions with double precision.

use haptic_bridge::math::{Angle, BinaryAngle, FineTable, Libm, Math, Minimax, Tabulated};
use std::f64::consts::FRAC_PI_2;

/// Returns the largest absolute error of sine and cosine for angles between -`turns` and `turns` turns.
fn worst_error<K: Math<f32>>(turns: f32) -> f64 {
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
fn the_polynomials_have_errors_below_1_2e_7() {
    assert!(worst_error::<Minimax>(1.0) < 1.2e-7, "{}", worst_error::<Minimax>(1.0));
    assert!(worst_error::<Libm>(1.0) < 1.2e-7, "{}", worst_error::<Libm>(1.0));
}

/// Computes the error of the board's sine and cosine for an encoder angle.
fn table_error(parts: u32) -> f64 {
    // The radians are wrong here, because the table must ignore them.
    let (sine, cosine) = Tabulated::sin_cos_of(Angle { radians: 7.0, binary: Some(BinaryAngle(parts)) });
    let exact = f64::from(parts) / 4_294_967_296.0 * core::f64::consts::TAU;
    (f64::from(sine) - exact.sin()).abs().max((f64::from(cosine) - exact.cos()).abs())
}

#[test]
fn the_table_with_its_series_has_errors_below_1e_7() {
    // Every 4099th angle is checked, and the angles at the limits between table entries.
    let limits = (0..256_u32).flat_map(|entry| {
        let end = (entry << 24) + (1 << 23);
        [end - 1, end, end + 1, entry << 24]
    });
    let worst = (0..=u32::MAX).step_by(4099).chain(limits).map(table_error).fold(0.0, f64::max);
    assert!(worst < 1.0e-7, "an error of {worst}");
    // Half a unit in the last place below 1 is 3e-8. A table without the series would have an error of 1.2e-2.
    assert!(worst > 1.0e-8, "{worst}: no angle was checked");
}

#[test]
fn an_angle_without_parts_of_a_turn_is_in_radians() {
    for angle in [-6.0_f32, -1.0, 0.0, 0.3, 2.0, 6.0] {
        assert_eq!(Tabulated::sin_cos_of(Angle::from_radians(angle)), Minimax::sin_cos(angle));
        let binary = BinaryAngle::from_radians(f64::from(angle));
        let (sine, cosine) = Tabulated::sin_cos_of(Angle { radians: 7.0, binary: Some(binary) });
        assert!((sine - angle.sin()).abs() < 2.0e-7 && (cosine - angle.cos()).abs() < 2.0e-7, "{angle}");
    }
    let known = |parts: u32| Angle { radians: 0.0_f32, binary: Some(BinaryAngle(parts)) };
    assert_eq!((known(5) - known(7)).binary, Some(BinaryAngle(u32::MAX - 1)), "the difference wraps");
    assert_eq!((known(5) - Angle::from_radians(1.0)).binary, None);
}

/// Computes the absolute and the relative error of the sine and cosine that the analysis uses.
fn fine_errors(angle: f64) -> [f64; 2] {
    let (sine, cosine) = FineTable::sin_cos(angle);
    let (exact_sine, exact_cosine) = angle.sin_cos();
    let errors = [(sine - exact_sine).abs(), (cosine - exact_cosine).abs()];
    [errors[0].max(errors[1]), (errors[0] / exact_sine.abs()).max(errors[1] / exact_cosine.abs())]
}

#[test]
fn sines_of_the_analysis_are_right_to_the_last_digits() {
    // The error against 50 digits is 1.6e-16. The oracle of this test has an error of half a unit itself (1.1e-16).
    let all_around = (-200_000..=200_000).map(|step| f64::from(step) * 1.5e-2);
    let worst = all_around.map(|angle| fine_errors(angle)[0]).fold(0.0, f64::max);
    assert!(worst < 2.7e-16, "an error of {worst:e}");
    assert!(worst > 1.0e-17, "{worst:e}: no angle was checked");
    // The relative error counts near a zero, because a mechanism divides by the sine.
    for quarter in -64..=64 {
        for step in 1..=10_000 {
            let offset = f64::from(step) * 1.0e-6;
            for angle in [offset, -offset, offset * 1.0e-3] {
                let angle = f64::from(quarter) * FRAC_PI_2 + angle;
                assert!(
                    fine_errors(angle)[1] < 6.7e-16,
                    "three units in the last place: {angle}, {:?}",
                    fine_errors(angle)
                );
            }
        }
    }
    assert_eq!(FineTable::sin_cos(0.0), (0.0, 1.0));
}

#[test]
fn libm_computes_angles_beyond_the_fine_table() {
    for angle in [3000.1, -3000.1, 1.0e6, -1.0e15, 1.0e300] {
        assert_eq!(FineTable::sin_cos(angle), <Libm as Math<f64>>::sin_cos(angle), "{angle}");
    }
    assert!(fine_errors(3000.0)[0] < 2.7e-16 && fine_errors(-3000.0)[0] < 2.7e-16);
    for angle in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let (sine, cosine) = FineTable::sin_cos(angle);
        assert!(sine.is_nan() && cosine.is_nan(), "{angle} rad: sine {sine}, cosine {cosine}");
    }
}

#[test]
fn invalid_angles_have_no_finite_sine() {
    for angle in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let (sine, cosine) = Minimax::sin_cos(angle);
        assert!(!sine.is_finite() && !cosine.is_finite(), "{angle} rad: sine {sine}, cosine {cosine}");
    }
    assert!(<Minimax as Math<f32>>::sqrt(-1.0).is_nan());
    assert!(<Minimax as Math<f32>>::sqrt(f32::NAN).is_nan());
}

#[test]
fn the_square_root_is_correctly_rounded() {
    // Every 1009th non-negative number is checked, including subnormal numbers and infinity. A double-precision root
    // has more than twice the digits, so rounding it again adds no error.
    for bits in (0..=f32::INFINITY.to_bits()).step_by(1009).chain([1, f32::INFINITY.to_bits()]) {
        let value = f32::from_bits(bits);
        assert_eq!(<Minimax as Math<f32>>::sqrt(value), f64::from(value).sqrt() as f32, "{value:e}");
    }
}
