//! Short vectors: zeros behind them, and unit length.

use nalgebra::DVector;

/// The values, with zeros after them.
#[must_use]
pub fn padded<const N: usize>(values: &[f64]) -> [f64; N] {
    core::array::from_fn(|index| values.get(index).copied().unwrap_or(0.0))
}

/// As [`padded`], of a length that is not known before.
#[must_use]
pub fn padded_to(length: usize, values: &[f64]) -> DVector<f64> {
    DVector::from_fn(length, |index, _| values.get(index).copied().unwrap_or(0.0))
}

/// The direction of a vector, of length 1; none of one that is zero or not finite.
#[must_use]
pub fn unit(values: &[f64]) -> Option<Vec<f64>> {
    // Scaled first, so that neither tiny nor huge entries spoil the squares.
    let largest = values.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    // By a power of two, which leaves every digit as it is: 0.6 and 0.8 stay what they are.
    let scale = 2.0_f64.powi(largest.log2().floor().clamp(-1000.0, 1000.0) as i32);
    let scaled: Vec<f64> = values.iter().map(|value| value / scale).collect();
    let length = scaled.iter().map(|value| value * value).sum::<f64>().sqrt();
    (largest > 0.0 && length.is_finite()).then(|| scaled.iter().map(|value| value / length).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_direction_has_unit_length_however_small_or_large_its_entries() {
        for size in [f64::from_bits(1), 2.0_f64.powi(-600), 1.0, 2.0_f64.powi(600)] {
            assert_eq!(unit(&[3.0 * size, 0.0, -4.0 * size]), Some(vec![0.6, 0.0, -0.8]), "{size}");
        }
        assert_eq!(unit(&[0.6, -0.8]), Some(vec![0.6, -0.8]));
        let diagonal = unit(&[f64::MAX, f64::MAX]).unwrap();
        assert!(diagonal.iter().all(|entry| (entry * entry - 0.5).abs() < 1e-15), "{diagonal:?}");
        for nowhere in [&[][..], &[0.0, -0.0], &[1.0, f64::NAN], &[f64::INFINITY, 1.0]] {
            assert_eq!(unit(nowhere), None, "{nowhere:?}");
        }
    }

    #[test]
    fn what_is_short_gets_zeros_and_what_is_long_is_cut() {
        assert_eq!(padded::<3>(&[1.0, 2.0]), [1.0, 2.0, 0.0]);
        assert_eq!(padded::<1>(&[1.0, 2.0]), [1.0]);
        assert_eq!(padded_to(3, &[1.0, 2.0]).as_slice(), [1.0, 2.0, 0.0]);
    }
}
