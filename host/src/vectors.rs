//! Short vectors: padding with zeros, and unit vectors.

use nalgebra::DVector;

/// Returns the values, padded with zeros or cut to length `N`.
#[must_use]
pub fn padded<const N: usize>(values: &[f64]) -> [f64; N] {
    core::array::from_fn(|index| values.get(index).copied().unwrap_or(0.0))
}

/// Like [`padded`], for a length that is known at run time.
#[must_use]
pub fn padded_to(length: usize, values: &[f64]) -> DVector<f64> {
    DVector::from_fn(length, |index, _| values.get(index).copied().unwrap_or(0.0))
}

/// Returns the unit vector along `values`; `None` if they are zero or not finite.
#[must_use]
pub fn unit(values: &[f64]) -> Option<Vec<f64>> {
    let largest = values.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    // Scales by a power of two, which is exact, so that squares of tiny or huge entries neither underflow nor overflow.
    let scale = 2.0_f64.powi(largest.log2().floor().clamp(-1000.0, 1000.0) as i32);
    let scaled: Vec<f64> = values.iter().map(|value| value / scale).collect();
    let length = scaled.iter().map(|value| value * value).sum::<f64>().sqrt();
    (largest > 0.0 && length.is_finite()).then(|| scaled.iter().map(|value| value / length).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_vectors_of_tiny_and_huge_entries_have_length_1() {
        for size in [f64::from_bits(1), 2.0_f64.powi(-600), 1.0, 2.0_f64.powi(600)] {
            assert_eq!(unit(&[3.0 * size, 0.0, -4.0 * size]), Some(vec![0.6, 0.0, -0.8]), "{size}");
        }
        assert_eq!(unit(&[0.6, -0.8]), Some(vec![0.6, -0.8]));
        let diagonal = unit(&[f64::MAX, f64::MAX]).unwrap();
        assert!(diagonal.iter().all(|entry| (entry * entry - 0.5).abs() < 1e-15), "{diagonal:?}");
        for without_direction in [&[][..], &[0.0, -0.0], &[1.0, f64::NAN], &[f64::INFINITY, 1.0]] {
            assert_eq!(unit(without_direction), None, "{without_direction:?}");
        }
    }

    #[test]
    fn short_vectors_get_zeros_and_long_ones_are_cut() {
        assert_eq!(padded::<3>(&[1.0, 2.0]), [1.0, 2.0, 0.0]);
        assert_eq!(padded::<1>(&[1.0, 2.0]), [1.0]);
        assert_eq!(padded_to(3, &[1.0, 2.0]).as_slice(), [1.0, 2.0, 0.0]);
    }
}
