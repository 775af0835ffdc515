//! Comparisons that return a sign, negative if a value is beyond its bound. Several results are combined by OR and
//! tested once, without a branch for each and without moving the FPU's flags.
//!
//! The bit patterns of positive floats have the order of the floats. Infinity and NaN are above all numbers.

/// Returns a negative number if |`value`| exceeds `bound` (not negative) or `value` is NaN.
#[inline(always)]
pub(crate) fn margin_bits(value: f32, bound: f32) -> i32 {
    bound.to_bits().wrapping_sub(value.abs().to_bits()) as i32
}

/// Returns a negative number if `value` is below `low`, above `high` (both not negative) or NaN.
#[inline(always)]
pub(crate) fn margin_bits_between(value: f32, (low, high): (f32, f32)) -> i32 {
    let bits = value.to_bits();
    (bits | bits.wrapping_sub(low.to_bits()) | high.to_bits().wrapping_sub(bits)) as i32
}

/// Returns a negative number if |`moved`| exceeds `bound` (not negative) or the difference wraps.
#[inline(always)]
pub(crate) fn margin_counts(moved: i32, bound: i32) -> i32 {
    bound.wrapping_sub(moved) | bound.wrapping_add(moved)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_beyond_the_bound_and_nan_give_a_negative_margin() {
        for within in [0.0, -0.0, 1.0e-40, 0.5, -0.5, 2.0, -2.0] {
            assert!(margin_bits(within, 2.0) >= 0, "{within}");
        }
        for beyond in [2.000_000_5, -2.000_000_5, f32::MAX, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, -f32::NAN] {
            assert!(margin_bits(beyond, 2.0) < 0, "{beyond}");
        }
        assert!(
            margin_bits(f32::MAX, f32::INFINITY) >= 0 && margin_bits(f32::NAN, f32::INFINITY) < 0,
            "an infinite bound still rejects NaN"
        );
    }

    #[test]
    fn values_between_the_ends_give_no_negative_margin() {
        for within in [1.0, 1.5, 2.0] {
            assert!(margin_bits_between(within, (1.0, 2.0)) >= 0, "{within}");
        }
        for beyond in [0.0, 0.999_999_9, 2.000_000_5, -1.5, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, -f32::NAN] {
            assert!(margin_bits_between(beyond, (1.0, 2.0)) < 0, "{beyond}");
        }
    }

    #[test]
    fn any_motion_beyond_its_bound_gives_a_negative_margin() {
        assert!([-9, 0, 9].iter().all(|moved| margin_counts(*moved, 9) >= 0));
        assert!([-10, 10, i32::MIN, i32::MIN + 8, i32::MAX].iter().all(|moved| margin_counts(*moved, 9) < 0));
    }
}
