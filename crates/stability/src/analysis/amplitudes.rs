//! Amplitude spectrum of a recorded signal.

use std::f64::consts::TAU;

const MAX_PIECE_SAMPLES: usize = 16_384;
const MIN_PIECE_SAMPLES: usize = 64;

/// A line of a spectrum.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct SpectralLine {
    /// Frequency, Hz.
    pub frequency: f64,
    /// Amplitude of a sine at that frequency, in the signal's unit.
    pub amplitude: f64,
}

/// The spectrum of a signal.
#[derive(Clone, Debug, PartialEq)]
pub struct Spectrum {
    /// Lines from 0 Hz to half of the signal's rate.
    pub lines: Vec<SpectralLine>,
    /// Number of samples in the signal.
    pub samples: usize,
}

/// Lowest frequency that counts as ripple, Hz. Slower force changes come from the hand.
pub const RIPPLE_HZ: f64 = 20.0;
/// Number of lines over which a Hann window spreads the power of a sine (its equivalent noise bandwidth).
const HANN_BANDWIDTH_LINES: f64 = 1.5;

impl Spectrum {
    /// Returns the root mean square of the signal's part at and above [`RIPPLE_HZ`], in the signal's unit.
    #[must_use]
    pub fn ripple(&self) -> f64 {
        let fast = self.lines.iter().filter(|line| line.frequency >= RIPPLE_HZ);
        (fast.map(|line| 0.5 * line.amplitude.powi(2)).sum::<f64>() / HANN_BANDWIDTH_LINES).sqrt()
    }
}

/// Computes a spectrum from evenly sampled `stretches` (Welch 1967).
///
/// Divides the stretches into pieces of equal length: the largest power of two of samples that fits the longest
/// stretch, at most 16384. Removes each piece's mean, applies a Hann window and averages the powers of all pieces. The
/// pieces of a stretch overlap by at least half and cover the stretch from its first to its last sample. Skips
/// stretches that are shorter than a piece. Returns `None` if the longest stretch has fewer than 64 samples.
pub fn spectrum(stretches: &[&[f64]], rate_hz: f64) -> Option<Spectrum> {
    let longest =
        stretches.iter().map(|stretch| stretch.len()).max().filter(|longest| *longest >= MIN_PIECE_SAMPLES)?;
    let size = (1 << longest.ilog2()).min(MAX_PIECE_SAMPLES);
    let window: Vec<f64> = (0..size).map(|i| 0.5 - 0.5 * (TAU * i as f64 / size as f64).cos()).collect();
    let gain: f64 = window.iter().sum();
    let mut power = vec![0.0; size / 2 + 1];
    let (mut pieces, mut samples) = (0.0, 0);
    for stretch in stretches.iter().filter(|stretch| stretch.len() >= size) {
        samples += stretch.len();
        let room = stretch.len() - size;
        let steps = room.div_ceil(size / 2);
        for step in 0..=steps {
            let piece = &stretch[room * step / steps.max(1)..][..size];
            let mean = piece.iter().sum::<f64>() / size as f64;
            let mut transformed: Vec<(f64, f64)> =
                piece.iter().zip(&window).map(|(v, w)| ((v - mean) * w, 0.0)).collect();
            transform(&mut transformed);
            for (sum, (re, im)) in power.iter_mut().zip(transformed) {
                *sum += re * re + im * im;
            }
            pieces += 1.0;
        }
    }
    let line = |(i, power): (usize, f64)| SpectralLine {
        frequency: i as f64 * rate_hz / size as f64,
        amplitude: 2.0 * (power / pieces).sqrt() / gain,
    };
    Some(Spectrum { lines: power.into_iter().enumerate().map(line).collect(), samples })
}

/// Transforms numbers in place by the FFT of Cooley and Tukey (1965). The number of values must be a power of two.
fn transform(values: &mut [(f64, f64)]) {
    let count = values.len();
    let bits = count.trailing_zeros();
    for i in 0..count {
        let j = i.reverse_bits() >> (usize::BITS - bits);
        if i < j {
            values.swap(i, j);
        }
    }
    let mut half = 1;
    while half < count {
        for i in 0..half {
            let (sin, cos) = (-TAU * i as f64 / (2 * half) as f64).sin_cos();
            for k in (i..count).step_by(2 * half) {
                let (a, b) = (values[k], values[k + half]);
                let transformed = (b.0 * cos - b.1 * sin, b.0 * sin + b.1 * cos);
                values[k] = (a.0 + transformed.0, a.1 + transformed.1);
                values[k + half] = (a.0 - transformed.0, a.1 - transformed.1);
            }
        }
        half *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transform_equals_its_defining_sum() {
        let signal: Vec<(f64, f64)> = (0..64_u64).map(|i| ((i * i % 17) as f64, (i * 7 % 5) as f64)).collect();
        let mut fast = signal.clone();
        transform(&mut fast);
        for (k, result) in fast.iter().enumerate() {
            let sum = signal.iter().enumerate().fold((0.0, 0.0), |sum: (f64, f64), (n, (re, im))| {
                let (sin, cos) = (-TAU * (k * n) as f64 / 64.0).sin_cos();
                (sum.0 + re * cos - im * sin, sum.1 + re * sin + im * cos)
            });
            assert!((result.0 - sum.0).hypot(result.1 - sum.1) < 1e-9, "{k}");
        }
    }

    #[test]
    fn spectrum_shows_the_amplitude_of_a_sine_without_its_mean() {
        let rate = 20_000.0;
        for (hz, amplitude) in [(61.035_156_25, 3.0), (1_000.0, 0.02)] {
            let signal: Vec<f64> =
                (0..50_000).map(|i| 7.0 + amplitude * (TAU * hz * f64::from(i) / rate).sin()).collect();
            let result = spectrum(&[&signal], rate).unwrap();
            let top = result.lines.iter().max_by(|a, b| a.amplitude.total_cmp(&b.amplitude)).unwrap();
            assert!((top.frequency - hz).abs() < rate / MAX_PIECE_SAMPLES as f64, "{top:?}");
            // Between two lines the Hann window shows at most 15 % less.
            assert!(top.amplitude <= 1.001 * amplitude && top.amplitude > 0.84 * amplitude, "{top:?}");
            let ripple = result.ripple() / (amplitude * 0.5_f64.sqrt());
            assert!((ripple - 1.0).abs() < 0.01, "{hz} Hz: {ripple} of the root mean square");
        }
        assert_eq!(spectrum(&[&[0.0; 63]], 1.0), None);
    }

    /// Pieces without overlap would leave out nearly half of 1000 samples, and a third of 767.
    #[test]
    fn every_sample_of_a_stretch_counts() {
        let rate = 1000.0;
        for count in [767, 1000, 20_000, 40_000] {
            for swings in [0..count / 5, count - count / 5..count] {
                let sine = |i: usize| if swings.contains(&i) { (TAU * 100.0 * i as f64 / rate).sin() } else { 0.0 };
                let signal: Vec<f64> = (0..count).map(sine).collect();
                let result = spectrum(&[&signal], rate).unwrap();
                let top = result.lines.iter().max_by(|a, b| a.amplitude.total_cmp(&b.amplitude)).unwrap();
                assert!((top.frequency - 100.0).abs() < 2.0 * rate / 64.0 && top.amplitude > 0.01, "{count}: {top:?}");
                assert_eq!(result.samples, count);
            }
        }
        // Every stretch that is long enough for a piece counts.
        let result = spectrum(&[&[1.0; 100], &[1.0; 63], &[1.0; 64]], rate).unwrap();
        assert_eq!((result.samples, result.lines.len()), (164, 33));
    }
}
