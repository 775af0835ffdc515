//! Comparisons whose outcomes are signs: negative where something is beyond its bound, so that many are gathered by OR and
//! looked at once, without a branch for each and without moving the FPU's flags.
//!
//! Bit patterns of positive floats are ordered as the floats are; infinity and NaN come above them all.

/// Negative when |`value`| exceeds `bound`, which is not negative, and for NaN.
#[inline(always)]
pub(crate) fn margin_bits(value: f32, bound: f32) -> i32 {
    bound.to_bits().wrapping_sub(value.abs().to_bits()) as i32
}

/// Negative when `value` is below `least` or above `most`, which both are not negative, and for NaN.
#[inline(always)]
pub(crate) fn margin_bits_between(value: f32, (least, most): (f32, f32)) -> i32 {
    let bits = value.to_bits();
    (bits | bits.wrapping_sub(least.to_bits()) | most.to_bits().wrapping_sub(bits)) as i32
}

/// Negative when |`moved`| exceeds `bound`, which is not negative: what wraps is as negative.
#[inline(always)]
pub(crate) fn margin_counts(moved: i32, bound: i32) -> i32 {
    bound.wrapping_sub(moved) | bound.wrapping_add(moved)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_beyond_its_bound_is_negative_and_so_is_nan() {
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
    fn a_value_between_its_ends_is_not_negative() {
        for within in [1.0, 1.5, 2.0] {
            assert!(margin_bits_between(within, (1.0, 2.0)) >= 0, "{within}");
        }
        for beyond in [0.0, 0.999_999_9, 2.000_000_5, -1.5, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, -f32::NAN] {
            assert!(margin_bits_between(beyond, (1.0, 2.0)) < 0, "{beyond}");
        }
    }

    #[test]
    fn a_motion_beyond_its_bound_is_negative_however_far_it_is() {
        assert!([-9, 0, 9].iter().all(|moved| margin_counts(*moved, 9) >= 0));
        assert!([-10, 10, i32::MIN, i32::MIN + 8, i32::MAX].iter().all(|moved| margin_counts(*moved, 9) < 0));
    }
}
