//! Velocity estimators in f32, with cutoffs from 1e-4 to 0.45 of the control rate.
//!
//! The library's state-variable form is compared with the usual direct form of the same transfer function. Both are in
//! f32 and receive the same rounded positions. The oracle is the direct form in the reference's numbers.

use super::{Exact, ExactMath};
use haptic_bridge::math::{Math, Real};
use haptic_bridge::render::velocity::{Coefficients, Estimator, Velocity};

#[derive(Clone, Debug)]
pub struct Row {
    /// Cutoff as a share of the control rate.
    pub ratio: f64,
    /// Error of the board's estimate during a swing across the workspace, as a share of the largest velocity.
    pub swing: f64,
    /// Error of the board's estimate at constant speed after settling, as a share of the speed.
    pub gain: f64,
    /// `swing` of the direct form in f32.
    pub direct_swing: f64,
    /// `gain` of the direct form in f32.
    pub direct_gain: f64,
    /// Difference between the two forms in the reference's numbers.
    pub reference: f64,
}

const RATE_HZ: f64 = 20_000.0;

/// Second-order Butterworth low-pass by the prewarped bilinear transform, in direct form II transposed.
struct DirectForm<T> {
    b: [T; 3],
    a: [T; 2],
    s: [T; 2],
    last: Option<T>,
}

impl<T: Real> DirectForm<T> {
    /// Computes the coefficients in the reference's numbers and rounds the results.
    fn new(ratio: f64, rounded: impl Fn(Exact) -> T) -> Self {
        let exact = Exact::from_f64;
        let one = exact(1.0);
        let (s, c) = ExactMath::sin_cos(exact(std::f64::consts::PI) * exact(ratio));
        let k = s / c;
        let root = exact(std::f64::consts::SQRT_2);
        let norm = one / (one + k * (k + root));
        let b0 = k * k * norm;
        let b = [b0, exact(2.0) * b0, b0].map(&rounded);
        let a = [exact(2.0) * (k * k - one) * norm, (one + k * (k - root)) * norm].map(rounded);
        Self { b, a, s: [T::zero(); 2], last: None }
    }

    fn step(&mut self, position: T) -> T {
        let input = (position - self.last.replace(position).unwrap_or(position)) * T::from_f64(RATE_HZ);
        let output = self.b[0] * input + self.s[0];
        self.s[0] = self.b[1] * input - self.a[0] * output + self.s[1];
        self.s[1] = self.b[2] * input - self.a[1] * output;
        output
    }
}

/// Computes the largest errors over the second half of a motion, as shares of the largest velocity. They belong to the
/// state-variable form in f32, the direct form in f32, and the state-variable form in the reference's numbers.
fn errors(ratio: f64, motion: impl Fn(f64) -> f64) -> [f64; 3] {
    let steps = (20.0 / ratio).clamp(4_000.0, 100_000.0) as u32;
    let kind = Estimator::Butterworth;
    let valid = "a cutoff below half the rate";
    let board = Coefficients::<f32>::new(kind, RATE_HZ as f32, (ratio * RATE_HZ) as f32).expect(valid);
    let exact =
        Coefficients::<Exact>::new(kind, Exact::from_f64(RATE_HZ), Exact::from_f64(ratio * RATE_HZ)).expect(valid);
    let begin = motion(0.0) as f32;
    let (mut v, mut check) = (Velocity::resting_at(begin), Velocity::resting_at(Exact::from_f64(f64::from(begin))));
    let (mut direct, mut reference) =
        (DirectForm::<f32>::new(ratio, |x| x.to_f64() as f32), DirectForm::<Exact>::new(ratio, |x| x));
    let (mut worst, mut largest) = ([0.0_f64; 3], 0.0_f64);
    for k in 0..steps {
        let x = motion(f64::from(k) / f64::from(steps)) as f32;
        let precise = Exact::from_f64(f64::from(x));
        let truth = reference.step(precise).to_f64();
        let found = [f64::from(v.step(&board, x)), f64::from(direct.step(x)), check.step(&exact, precise).to_f64()];
        if k >= steps / 2 {
            largest = largest.max(truth.abs());
            for (worst, found) in worst.iter_mut().zip(found) {
                *worst = worst.max((found - truth).abs());
            }
        }
    }
    worst.map(|error| error / largest)
}

pub fn all_rows() -> Vec<Row> {
    [1e-4, 3e-4, 1e-3, 1e-2, 0.025, 0.1, 0.3, 0.45]
        .into_iter()
        .map(|ratio| {
            let [swing, direct_swing, a] = errors(ratio, |t| 0.05 + 0.1 * libm::sin(40.0 * t));
            let [gain, direct_gain, b] = errors(ratio, |t| -0.1 + 0.2 * t);
            Row { ratio, swing, gain, direct_swing, direct_gain, reference: a.max(b) }
        })
        .collect()
}
