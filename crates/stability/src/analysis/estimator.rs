//! Velocity estimators of the control step as linear filters for the stability analysis.
//!
//! Each filter takes the change of position over the last sample and returns a velocity per sample. The changes of its
//! states are computed directly, because differences of nearly equal numbers lose precision.

use super::error::AnalysisError;
use haptic_bridge::render::velocity::{Chosen, Estimator as Kind};
use nalgebra::{Complex, DMatrix, DVector};

/// Longest window of a difference, samples.
pub const LONGEST_DIFFERENCE: usize = 64;

/// A linear velocity estimator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LinearEstimator {
    /// Backward difference without filter.
    BackwardDifference,
    /// Backward difference and a one-pole bilinear low-pass, prewarped at the cutoff (Hz).
    FirstOrder(f64),
    /// Backward difference and a second-order bilinear Butterworth low-pass, prewarped at the cutoff (Hz).
    Butterworth(f64),
    /// Difference over several samples, `(x[n] - x[n-k])/(k T)`, followed by a low-pass.
    Difference {
        /// Number of samples k, from 1 to [`LONGEST_DIFFERENCE`].
        samples: usize,
        /// Low-pass that follows the difference.
        low_pass: LowPass,
    },
    /// α-β-γ filter with its poles at this frequency (Hz), which uses the acceleration that the last command causes.
    Predicted(f64),
}

/// Low-pass that follows a difference over several samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LowPass {
    /// No low-pass.
    None,
    /// Low-pass of [`LinearEstimator::FirstOrder`], Hz.
    FirstOrder(f64),
    /// Low-pass of [`LinearEstimator::Butterworth`], Hz.
    Butterworth(f64),
}

/// Output of a filter for one sample: velocity per sample, and change of each state.
struct FilterOutput {
    velocity: f64,
    change: Vec<f64>,
}

impl LinearEstimator {
    /// Returns this estimator with its difference over `samples` samples, or unchanged if it takes no difference.
    pub fn with_window(self, samples: usize) -> Self {
        let low_pass = match self {
            Self::BackwardDifference => LowPass::None,
            Self::FirstOrder(hz) => LowPass::FirstOrder(hz),
            Self::Butterworth(hz) => LowPass::Butterworth(hz),
            Self::Difference { low_pass, .. } => low_pass,
            Self::Predicted(_) => return self,
        };
        Self::Difference { samples, low_pass }
    }

    /// Returns the linear form of a scene's estimator near rest; `None` if the estimator has no linear form.
    pub fn of(kind: Kind, cutoff_hz: f64) -> Option<Self> {
        let behind = |chosen: Chosen| if chosen.filtered { LowPass::Butterworth(cutoff_hz) } else { LowPass::None };
        match kind {
            Kind::Butterworth => Some(Self::Butterworth(cutoff_hz)),
            Kind::FirstOrder => Some(Self::FirstOrder(cutoff_hz)),
            Kind::BackwardDifference => Some(Self::BackwardDifference),
            Kind::Difference(chosen) => {
                Some(Self::Difference { samples: chosen.value as usize, low_pass: behind(chosen) })
            }
            Kind::Predicted(_) => Some(Self::Predicted(cutoff_hz)),
        }
    }

    /// Returns the linear estimators without a window. [`LinearEstimator::with_window`] adds one.
    pub fn windowless() -> impl Iterator<Item = (&'static str, Kind)> {
        let has_no_window = |kind: Kind| kind.spec().is_none_or(|spec| spec.key.is_none());
        let all = Kind::ALL.iter().copied();
        all.filter(move |(_, kind)| has_no_window(*kind) && Self::of(*kind, 1.0).is_some())
    }

    /// Returns true if the estimator begins with a difference.
    pub fn takes_difference(self) -> bool {
        !matches!(self, Self::Predicted(_))
    }

    /// Returns the cutoff, Hz; `None` if the estimator has no low-pass.
    pub fn cutoff_hz(self) -> Option<f64> {
        match self {
            Self::BackwardDifference | Self::Difference { low_pass: LowPass::None, .. } => None,
            Self::FirstOrder(hz)
            | Self::Butterworth(hz)
            | Self::Predicted(hz)
            | Self::Difference { low_pass: LowPass::FirstOrder(hz) | LowPass::Butterworth(hz), .. } => Some(hz),
        }
    }

    pub(super) fn samples(self) -> usize {
        match self {
            Self::Difference { samples, .. } => samples,
            _ => 1,
        }
    }

    /// Rejects a cutoff at or above half the rate, and a window longer than boards support.
    pub(super) fn check(self, rate_hz: f64) -> Result<(), AnalysisError> {
        let cutoff = self.cutoff_hz();
        match (self, cutoff) {
            (Self::Difference { samples, .. }, _) if !(1..=LONGEST_DIFFERENCE).contains(&samples) => {
                Err(AnalysisError::Difference(samples))
            }
            (_, Some(cutoff)) if !(cutoff > 0.0 && cutoff < rate_hz / 2.0) => {
                Err(AnalysisError::Cutoff { cutoff, rate: rate_hz })
            }
            _ => Ok(()),
        }
    }

    pub(super) fn states(self) -> usize {
        match self {
            Self::BackwardDifference => 0,
            Self::FirstOrder(_) => 1,
            Self::Butterworth(_) => 2,
            Self::Predicted(_) => 3,
            Self::Difference { samples, low_pass } => samples - 1 + low_pass.after_backward_difference().states(),
        }
    }

    pub(super) fn uses_commands(self) -> bool {
        matches!(self, Self::Predicted(_))
    }

    /// Computes one sample after the joint moved by `moved`; commands added `pushed` to its velocity per sample.
    fn filter_sample(self, rate_hz: f64, states: &[f64], moved: f64, pushed: f64) -> FilterOutput {
        let warped = |hz: f64| (std::f64::consts::PI * hz / rate_hz).tan();
        match (self, states) {
            (Self::FirstOrder(hz), [low]) => {
                let step = (moved - low) * warped(hz) / (1.0 + warped(hz));
                FilterOutput { velocity: low + step, change: vec![2.0 * step] }
            }
            (Self::Butterworth(hz), [s1, s2]) => {
                // A trapezoidal state-variable filter equals the bilinear Butterworth exactly.
                let (g, damping) = (warped(hz), std::f64::consts::SQRT_2);
                let high = (moved - (damping + g) * s1 - s2) / (1.0 + g * (damping + g));
                let band = s1 + g * high;
                FilterOutput { velocity: s2 + g * band, change: vec![2.0 * g * high, 2.0 * g * band] }
            }
            (Self::Difference { samples, low_pass }, states) => {
                let (past, rest) = states.split_at(samples - 1);
                let mean = (moved + past.iter().sum::<f64>()) / samples as f64;
                let mut after = low_pass.after_backward_difference().filter_sample(rate_hz, rest, mean, 0.0);
                let mut change = Vec::with_capacity(states.len());
                let mut newer = moved;
                for states_part in past {
                    change.push(newer - states_part);
                    newer = *states_part;
                }
                change.append(&mut after.change);
                FilterOutput { velocity: after.velocity, change }
            }
            (Self::Predicted(hz), [ahead, velocity, unknown]) => {
                let left = 2.0 * warped(hz) / (1.0 + warped(hz));
                let pole = 1.0 - left;
                let alpha = 1.0 - pole * pole * pole;
                let expected = unknown + pushed;
                let unexpected = moved - velocity - expected / 2.0;
                let beyond = ahead + unexpected;
                let gained = expected + 1.5 * left * left * (1.0 + pole) * beyond;
                let change = vec![unexpected - alpha * beyond, gained, left * left * left * beyond];
                FilterOutput { velocity: velocity + gained, change }
            }
            _ => FilterOutput { velocity: moved, change: Vec::new() },
        }
    }

    /// Returns velocity over position as a function of the angle per sample (rad), without commands.
    pub(super) fn response(self, rate_hz: f64) -> impl Fn(f64) -> Complex<f64> {
        let (samples, filter) = match self {
            Self::Difference { samples, low_pass } => (samples, low_pass.after_backward_difference()),
            alone => (1, alone),
        };
        let (matrix, states) = (filter.matrix(rate_hz), filter.states());
        move |angle: f64| {
            let back = |steps: f64| Complex::from_polar(1.0, -angle * steps);
            let difference = (1.0 - back(samples as f64)) / samples as f64;
            // A state times (z - 1) is its change over a sample.
            let mut states_part = matrix.view((0, 0), (states, states)).map(|value| Complex::from(-value));
            states_part.iter_mut().step_by(states + 1).for_each(|entry| *entry += back(-1.0) - 1.0);
            let driven = matrix.view((0, states), (states, 1)).map(Complex::from);
            let rest = if states == 0 { None } else { states_part.lu().solve(&driven) };
            let through: Complex<f64> =
                rest.iter().flat_map(|rest| rest.iter().enumerate()).map(|(i, s)| s * matrix[(states, i)]).sum();
            difference * (through + matrix[(states, states)])
        }
    }

    /// Returns the filter as a matrix. Its columns are the states, the change of position and the velocity from the
    /// command; its rows are the change of each state and the velocity.
    pub fn matrix(self, rate_hz: f64) -> DMatrix<f64> {
        let states = self.states();
        let mut matrix = DMatrix::zeros(states + 1, states + 2);
        let mut unit = vec![0.0; states + 2];
        for column in 0..states + 2 {
            unit[column] = 1.0;
            let output = self.filter_sample(rate_hz, &unit[..states], unit[states], unit[states + 1]);
            for (row, value) in output.change.iter().chain([&output.velocity]).enumerate() {
                matrix[(row, column)] = *value;
            }
            unit[column] = 0.0;
        }
        matrix
    }

    /// Returns the command-line name, and the window of the difference in samples.
    pub fn name_and_window(self) -> (&'static str, usize) {
        match self {
            Self::BackwardDifference => ("backward-difference", 1),
            Self::FirstOrder(_) => ("first-order", 1),
            Self::Butterworth(_) => ("butterworth", 1),
            Self::Predicted(_) => ("predicted", 1),
            Self::Difference { samples, low_pass: LowPass::None } => ("backward-difference", samples),
            Self::Difference { samples, low_pass: LowPass::FirstOrder(_) } => ("first-order", samples),
            Self::Difference { samples, low_pass: LowPass::Butterworth(_) } => ("butterworth", samples),
        }
    }
}

impl LinearEstimator {
    /// Returns the largest velocity after a position step, per metre of the step, 1/s.
    pub fn peak_step_response(self, rate_hz: f64) -> f64 {
        let matrix: DMatrix<f64> = self.matrix(rate_hz);
        let states = matrix.nrows() - 1;
        let mut memory = DVector::zeros(states + 2);
        let mut most: f64 = 0.0;
        // The step response of a low-pass ends within ten periods of its cutoff.
        let cutoff = self.cutoff_hz().unwrap_or(rate_hz);
        let samples = (10.0 * rate_hz / cutoff).ceil() as usize + self.samples();
        for n in 0..samples {
            memory[states] = if n == 0 { 1.0 } else { 0.0 };
            let change = &matrix * &memory;
            for state in 0..states {
                memory[state] += change[state];
            }
            most = most.max(change[states].abs());
        }
        most * rate_hz
    }

    /// Returns the states at a constant motion `moved` per sample, to which commands contribute `pushed`.
    pub(super) fn steady_states(self, rate_hz: f64, moved: f64, pushed: f64) -> DVector<f64> {
        let (matrix, states) = (self.matrix(rate_hz), self.states());
        if states == 0 {
            return DVector::zeros(0);
        }
        let states_part = matrix.view((0, 0), (states, states)).into_owned();
        let driven =
            matrix.view((0, states), (states, 1)) * -moved - matrix.view((0, states + 1), (states, 1)) * pushed;
        states_part.lu().solve(&driven).map_or_else(|| DVector::zeros(states), |rest| rest.column(0).into_owned())
    }
}

impl LowPass {
    /// Returns this low-pass after a backward difference.
    fn after_backward_difference(self) -> LinearEstimator {
        match self {
            Self::None => LinearEstimator::BackwardDifference,
            Self::FirstOrder(hz) => LinearEstimator::FirstOrder(hz),
            Self::Butterworth(hz) => LinearEstimator::Butterworth(hz),
        }
    }
}
