//! Gains at which modes leave the unit circle, and the stable intervals between these gains.
//!
//! On the unit circle, z = e^{iθ}, the loop 1 + kp Gx(z) + kd Gv(z) = 0 determines the gain as a function of θ. The
//! gain must be real, so the crossings are the zeros of a real function of θ. The responses Gx and Gv do not depend on
//! the gains, so they are tabulated once per loop. For each gain, sign changes and near misses are then refined.
//! Eigenvalues decide which intervals between crossings are stable.
//!
//! This is Neimark's D-decomposition; see Gryazina and Polyak, "Stability regions in the parameter space:
//! D-decomposition revisited", Automatica 42 (2006) 13-26.

use super::sampled::{AnalysisError, OpenLoop};
use super::spectrum::Resolvent;
use nalgebra::Complex;

/// Smallest stiffness that is analysed, in units of m/T².
pub(crate) const SMALLEST_STIFFNESS: f64 = 1e-9;

/// Lowest frequency that is searched, rad per sample. The smallest stiffness oscillates with the mass alone at 3e-5.
const LOWEST_ANGLE_RAD: f64 = 3e-6;

/// A stable interval of a gain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Interval {
    pub low: f64,
    pub high: f64,
}

/// Responses of the loop to the wall force around the unit circle.
pub(crate) struct CircleResponses<'a> {
    open: &'a OpenLoop,
    resolvent: Resolvent,
    samples: Vec<Response>,
    at_nyquist: Response,
}

/// Rendered position and estimated velocity per wall force at one angle of the unit circle.
#[derive(Clone, Copy)]
struct Response {
    angle: f64,
    position: Complex<f64>,
    velocity: Complex<f64>,
}

#[derive(Clone, Copy, PartialEq)]
enum SearchedGain {
    Stiffness,
    Damping,
}

/// Largest phase difference between the responses of neighbouring samples, rad.
const MAX_PHASE_STEP_RAD: f64 = 0.25;

impl Response {
    /// Returns true if a crossing between two neighbouring samples could be missed.
    fn is_far_from(&self, other: &Response) -> bool {
        let turned = |a: Complex<f64>, b: Complex<f64>| (b * a.conj()).arg().abs() > MAX_PHASE_STEP_RAD;
        turned(self.position, other.position) || turned(self.velocity, other.velocity)
    }

    /// Returns the complex gain that puts a mode at this angle. A real result is a crossing.
    fn gain(&self, searched: SearchedGain, held: f64) -> Complex<f64> {
        let (own, other) = match searched {
            SearchedGain::Stiffness => (self.position, self.velocity),
            SearchedGain::Damping => (self.velocity, self.position),
        };
        -(other * held + 1.0) / own
    }

    /// Returns the imaginary part of [`Response::gain`] times a positive factor. The result is always finite.
    fn mismatch(&self, searched: SearchedGain, held: f64) -> f64 {
        let (own, other) = match searched {
            SearchedGain::Stiffness => (self.position, self.velocity),
            SearchedGain::Damping => (self.velocity, self.position),
        };
        ((other * held + 1.0) * own.conj()).im / (own.norm() * (1.0 + own.norm()))
    }
}

impl<'a> CircleResponses<'a> {
    /// Tabulates the responses of a loop.
    pub fn new(open: &'a OpenLoop, delay_samples: f64) -> Self {
        let mut circle = Self {
            open,
            resolvent: Resolvent::new(open.f.clone()),
            samples: Vec::new(),
            at_nyquist: Response {
                angle: std::f64::consts::PI,
                position: Complex::new(0.0, 0.0),
                velocity: Complex::new(0.0, 0.0),
            },
        };
        let even = (48.0 * (3.0 + delay_samples)) as usize;
        let start = 0.05;
        let decades = (start / LOWEST_ANGLE_RAD).log10();
        let below = (decades * 48.0) as usize;
        let angles: Vec<f64> = (0..below)
            .map(|i| LOWEST_ANGLE_RAD * 10f64.powf(decades * i as f64 / below as f64))
            .chain(
                (0..even).map(|i| start + (std::f64::consts::PI * (1.0 - 1e-9) - start) * i as f64 / (even - 1) as f64),
            )
            .collect();
        circle.samples = angles.into_iter().map(|angle| circle.respond(angle)).collect();
        if !open.resonances().is_empty() {
            circle.refine_resonances();
        }
        circle.at_nyquist = circle.respond(std::f64::consts::PI);
        circle
    }

    /// Adds samples at resonances, and between neighbouring samples whose responses differ too much.
    fn refine_resonances(&mut self) {
        let top = self.samples.last().map_or(0.0, |last| last.angle);
        for &(radius, centre) in self.open.resonances() {
            let width = (1.0 - radius).abs().max(1e-9);
            let mut aside = 0.25 * width;
            let mut near = vec![centre];
            while aside < 0.1 * centre {
                near.extend([centre - aside, centre + aside]);
                aside *= 1.6;
            }
            let within = near.into_iter().filter(|angle| (LOWEST_ANGLE_RAD..top).contains(angle));
            for angle in within.collect::<Vec<_>>() {
                let response = self.respond(angle);
                self.samples.push(response);
            }
        }
        self.samples.sort_by(|a, b| a.angle.total_cmp(&b.angle));
        let mut refined: Vec<Response> = Vec::with_capacity(self.samples.len());
        let mut ahead: Vec<Response> = std::mem::take(&mut self.samples);
        ahead.reverse();
        while let Some(next) = ahead.pop() {
            match refined.last() {
                Some(last) if next.angle - last.angle > 1e-9 * next.angle && last.is_far_from(&next) => {
                    let middle = self.respond(0.5 * (last.angle + next.angle));
                    ahead.extend([next, middle]);
                }
                _ => refined.push(next),
            }
        }
        self.samples = refined;
    }

    fn respond(&mut self, angle: f64) -> Response {
        // z - 1 without cancellation: e^{iθ} - 1 = 2i sin(θ/2) e^{iθ/2}.
        let half = angle / 2.0;
        let gamma = Complex::new(0.0, 2.0 * half.sin()) * Complex::new(half.cos(), half.sin());
        let state = self.resolvent.solve(gamma, &self.open.input);
        let along = |row: &nalgebra::DVector<f64>| -> Complex<f64> {
            row.iter().zip(state).filter(|(r, _)| **r != 0.0).map(|(r, s)| s * *r).sum()
        };
        Response { angle, position: along(&self.open.position), velocity: along(&self.open.velocity) }
    }

    /// Returns the positive real gains at which a mode lies on the unit circle, in ascending order.
    fn crossings(&mut self, searched: SearchedGain, held: f64) -> Vec<f64> {
        let mut gains = Vec::new();
        let values: Vec<f64> = self.samples.iter().map(|r| r.mismatch(searched, held)).collect();
        for i in 1..values.len() {
            if (values[i] > 0.0) != (values[i - 1] > 0.0) {
                gains.push(self.refine(searched, held, i - 1, i, values[i - 1]));
            }
            // Two crossings lie between samples if an extremum is near zero but no sample reaches zero.
            if i >= 2 {
                let (a, b, c) = (values[i - 2], values[i - 1], values[i]);
                let same_side = (a > 0.0) == (b > 0.0) && (b > 0.0) == (c > 0.0);
                if same_side && b.abs() < a.abs() && b.abs() < c.abs() && b.abs() < (a - b).abs().max((c - b).abs()) {
                    gains.extend(self.refine_pair(searched, held, i - 2, i, b));
                }
            }
        }
        if self.nyquist_response(searched).norm() > 1e-14 {
            gains.push(self.at_nyquist.gain(searched, held).re);
        }
        gains.retain(|gain| gain.is_finite() && *gain > 0.0);
        gains.sort_by(f64::total_cmp);
        gains
    }

    fn nyquist_response(&self, searched: SearchedGain) -> Complex<f64> {
        match searched {
            SearchedGain::Stiffness => self.at_nyquist.position,
            SearchedGain::Damping => self.at_nyquist.velocity,
        }
    }

    /// Refines a crossing between two samples by bisection with secant steps (Illinois). Returns the gain.
    fn refine(&mut self, searched: SearchedGain, held: f64, from: usize, to: usize, at_from: f64) -> f64 {
        let (a, b) = (self.samples[from].angle, self.samples[to].angle);
        let at_to = self.samples[to].mismatch(searched, held);
        self.root_between(searched, held, (a, at_from), (b, at_to))
    }

    fn root_between(&mut self, searched: SearchedGain, held: f64, from: (f64, f64), to: (f64, f64)) -> f64 {
        let ((mut a, mut fa), (mut b, mut fb)) = (from, to);
        let mut last = self.respond((a + b) / 2.0);
        for _ in 0..60 {
            let guess = (a * fb - b * fa) / (fb - fa);
            let guess = if guess > a.min(b) && guess < a.max(b) { guess } else { (a + b) / 2.0 };
            last = self.respond(guess);
            let value = last.mismatch(searched, held);
            if value == 0.0 || (b - a).abs() < 1e-13 * b.abs() {
                break;
            }
            let step = (guess - b).abs();
            if (value > 0.0) == (fb > 0.0) {
                fa /= 2.0;
            } else {
                (a, fa) = (b, fb);
            }
            (b, fb) = (guess, value);
            if step < 1e-12 * guess {
                break;
            }
        }
        last.gain(searched, held).re
    }

    /// Searches the extremum between two samples. If the mismatch there crosses zero, returns the gains on both sides.
    fn refine_pair(&mut self, searched: SearchedGain, held: f64, from: usize, to: usize, middle: f64) -> Vec<f64> {
        let sign = middle.signum();
        let (mut low, mut high) = (self.samples[from].angle, self.samples[to].angle);
        let (edge_low, edge_high) = (low, high);
        const GOLDEN_SECTION: f64 = 0.618_033_988_749_894_8;
        for _ in 0..40 {
            let left = high - GOLDEN_SECTION * (high - low);
            let right = low + GOLDEN_SECTION * (high - low);
            let at_left = sign * self.respond(left).mismatch(searched, held);
            let at_right = sign * self.respond(right).mismatch(searched, held);
            let (angle, value) = if at_left < at_right { (left, at_left) } else { (right, at_right) };
            if value < 0.0 {
                let at_low = self.respond(edge_low).mismatch(searched, held);
                let at_high = self.respond(edge_high).mismatch(searched, held);
                let inner = (angle, sign * value);
                return vec![
                    self.root_between(searched, held, (edge_low, at_low), inner),
                    self.root_between(searched, held, inner, (edge_high, at_high)),
                ];
            }
            if at_left < at_right {
                high = right;
            } else {
                low = left;
            }
        }
        Vec::new()
    }

    /// Returns the stable intervals of stiffness above [`SMALLEST_STIFFNESS`] for one damping, in sample units.
    pub fn stiffness_intervals(&mut self, kd: f64) -> Result<Vec<Interval>, AnalysisError> {
        let crossings = self.crossings(SearchedGain::Stiffness, kd);
        let open = self.open;
        stable_between(SMALLEST_STIFFNESS, &crossings, |kp| open.is_stable(kp, kd))
    }

    /// Returns the stable intervals of damping from zero up at the smallest stiffness, in sample units.
    pub fn damping_intervals(&mut self) -> Result<Vec<Interval>, AnalysisError> {
        let crossings = self.crossings(SearchedGain::Damping, SMALLEST_STIFFNESS);
        let open = self.open;
        stable_between(0.0, &crossings, |kd| open.is_stable(SMALLEST_STIFFNESS, kd))
    }

    /// Returns the loop of these responses.
    pub fn open(&self) -> &OpenLoop {
        self.open
    }
}

/// Splits [start, ∞) at the crossings, keeps the stable intervals and joins neighbours.
fn stable_between(
    start: f64,
    crossings: &[f64],
    is_stable: impl Fn(f64) -> bool,
) -> Result<Vec<Interval>, AnalysisError> {
    let mut edges = vec![start];
    edges.extend(crossings.iter().copied().filter(|c| *c > start));
    let Some(&last) = edges.last() else { return Ok(Vec::new()) };
    edges.push(last * 4.0 + 1.0);
    let mut stable: Vec<Interval> = Vec::new();
    for (i, pair) in edges.windows(2).enumerate() {
        let (low, high) = (pair[0], pair[1]);
        if high - low <= 1e-12 * high || !is_stable((low + high) / 2.0) {
            continue;
        }
        // The first interval does not count if the smallest stiffness is unstable.
        if i == 0 && start > 0.0 && !is_stable(start) {
            continue;
        }
        if i + 2 == edges.len() {
            return Err(AnalysisError::Unbounded);
        }
        match stable.last_mut() {
            Some(before) if before.high >= low * (1.0 - 1e-12) => before.high = high,
            _ => stable.push(Interval { low, high }),
        }
    }
    Ok(stable)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::flexible::Flexible;
    use crate::analysis::plant::{Drive, Linearised, MotorElectrics};
    use crate::analysis::sampled::{LinearEstimator, Loop, Mode};
    use haptic_sim::Random;
    use nalgebra::{DMatrix, DVector};

    /// Returns a device with random inertia, direction and damping. Some or all joints may have no damping.
    fn random_device(random: &mut Random, joints: usize) -> Linearised {
        let factor = DMatrix::from_fn(joints, joints, |_, _| random.between(-1.0, 1.0));
        let mass = (&factor * factor.transpose() + DMatrix::identity(joints, joints) * 0.05) * 1e-3;
        let jacobian = DMatrix::from_fn(joints, joints, |i, j| {
            if i == j { random.between(0.05, 0.2) } else { random.between(-0.05, 0.05) }
        });
        let n = DVector::from_fn(joints, |_, _| random.between(-1.0, 1.0)).normalize();
        let scale = 10f64.powf(random.between(-5.0, -1.5));
        let viscous = DVector::from_fn(joints, |_, _| {
            if random.between(0.0, 1.0) < 0.25 { 0.0 } else { scale * random.between(0.1, 1.0) }
        });
        Linearised {
            gain: 1.0,
            flexible: Flexible::default(),
            row: jacobian.tr_mul(&n),
            unit_motion: jacobian.try_inverse().unwrap() * n,
            mass,
            viscous,
        }
    }

    fn random_loop(random: &mut Random, joints: usize) -> Loop {
        let rate_hz = 10f64.powf(random.between(200f64.log10(), 50_000f64.log10()));
        let cutoff = 10f64.powf(random.between(1.0, (0.4 * rate_hz).log10()));
        let estimator = match random.between(0.0, 4.0) as u32 {
            0 => LinearEstimator::FirstOrder(cutoff),
            1 => LinearEstimator::BackwardDifference,
            _ => LinearEstimator::Butterworth(cutoff),
        };
        let drive = match random.between(0.0, 4.0) as u32 {
            0 => Drive::Current { bandwidth_hz: random.between(200.0, 3000.0) },
            1 => {
                let inductance = if random.between(0.0, 1.0) < 0.5 { 0.0 } else { 1e-4 };
                let motor = MotorElectrics { torque_constant: 0.1, back_emf: 0.1, resistance: 2.0, inductance };
                Drive::Voltage(vec![motor; joints])
            }
            _ => Drive::Ideal,
        };
        let delay_samples = [0.0, 0.5, 1.0, 1.37, 3.0][random.between(0.0, 4.99) as usize];
        let damping_compensation = random.between(0.0, 1.0) < 0.2;
        Loop { rate_hz, delay_samples, estimator, drive, damping_compensation }
    }

    #[test]
    fn every_gain_below_the_boundary_is_stable_and_none_above() {
        let mut random = Random::new(7);
        let mut stable_somewhere = 0;
        for case in 0..300 {
            let joints = 1 + case % 3;
            let device = random_device(&mut random, joints);
            let around = random_loop(&mut random, joints);
            let mode = [Mode::Off, Mode::Full, Mode::Washout(2.0)][(case / 3) % 3];
            let open = OpenLoop::with_model(&device, &device, &around, mode).unwrap();
            let mut circle = CircleResponses::new(&open, around.delay_samples);
            let support = circle.damping_intervals().unwrap();
            for interval in &support {
                for share in [0.03, 0.3, 0.6, 0.9] {
                    let kd = interval.low + share * (interval.high - interval.low);
                    let stable = circle.stiffness_intervals(kd).unwrap();
                    let Some(first) = stable.first().filter(|s| s.low <= SMALLEST_STIFFNESS) else {
                        panic!("case {case}: {mode:?} {around:?}: kd {kd} lies in the support and is not stable");
                    };
                    stable_somewhere += 1;
                    for i in 0..40 {
                        let kp =
                            SMALLEST_STIFFNESS * (first.high * 0.999 / SMALLEST_STIFFNESS).powf(f64::from(i) / 39.0);
                        assert!(
                            open.is_stable(kp, kd),
                            "case {case}: {mode:?} {around:?}: unstable at {kp} of {first:?}, kd {kd}"
                        );
                    }
                    let above = first.high * 1.001;
                    let joined = stable.iter().skip(1).any(|s| s.low <= above);
                    assert!(
                        joined || !open.is_stable(above, kd),
                        "case {case}: {mode:?} {around:?}: stable above {first:?}, kd {kd}"
                    );
                }
            }
        }
        assert!(stable_somewhere > 600, "{stable_somewhere}");
    }
}
