//! The velocity estimators of the control step as linear filters, for the analysis of the loop around them.
//!
//! Each takes the change of position over the last sample and gives a velocity per sample. Its states are chosen so
//! that their change over a sample is computed directly, not as the difference of two nearly equal numbers.

use super::error::AnalysisError;
use haptic_bridge::render::velocity::{Chosen, Estimator as Kind};
use nalgebra::{Complex, DMatrix, DVector};

/// Most samples that a difference can be taken over.
pub const LONGEST_DIFFERENCE: usize = 64;

/// The linear velocity estimators, which take velocity from sampled positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LinearEstimator {
    /// The backward difference as it is.
    BackwardDifference,
    /// Backward difference, then one pole, bilinear, prewarped at the cutoff (Hz).
    FirstOrder(f64),
    /// Backward difference, then a second-order Butterworth, bilinear, prewarped at the cutoff (Hz).
    Butterworth(f64),
    /// The difference over several samples, `(x[n] - x[n-k])/(k T)`, then a low-pass.
    Over {
        /// k, from 1 to [`LONGEST_DIFFERENCE`].
        samples: usize,
        /// The low-pass after it.
        then: LowPass,
    },
    /// α-β-γ filter with its poles there (Hz), which knows the acceleration that the last sample's command gives.
    Predicted(f64),
}

/// The low-pass that follows a difference over several samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LowPass {
    /// Nothing.
    None,
    /// See [`LinearEstimator::FirstOrder`].
    FirstOrder(f64),
    /// See [`LinearEstimator::Butterworth`].
    Butterworth(f64),
}

/// A filter's answer to a sample: the velocity per sample, and the change of each of its states.
struct Answer {
    velocity: f64,
    change: Vec<f64>,
}

impl LinearEstimator {
    /// The same with the difference taken over `samples` samples; those that take none stay as they are.
    pub fn over(self, samples: usize) -> Self {
        let then = match self {
            Self::BackwardDifference => LowPass::None,
            Self::FirstOrder(hz) => LowPass::FirstOrder(hz),
            Self::Butterworth(hz) => LowPass::Butterworth(hz),
            Self::Over { then, .. } => then,
            Self::Predicted(_) => return self,
        };
        Self::Over { samples, then }
    }

    /// The linear form of a scene's estimator near rest; `None` where it has none.
    pub fn of(kind: Kind, cutoff_hz: f64) -> Option<Self> {
        let behind = |chosen: Chosen| if chosen.filtered { LowPass::Butterworth(cutoff_hz) } else { LowPass::None };
        match kind {
            Kind::Butterworth => Some(Self::Butterworth(cutoff_hz)),
            Kind::FirstOrder => Some(Self::FirstOrder(cutoff_hz)),
            Kind::BackwardDifference => Some(Self::BackwardDifference),
            Kind::Difference(chosen) => Some(Self::Over { samples: chosen.value as usize, then: behind(chosen) }),
            Kind::Predicted(_) => Some(Self::Predicted(cutoff_hz)),
        }
    }

    /// Those of scenes that one filter stands for whatever else is chosen, by their names there: they have no window of
    /// their own, which [`LinearEstimator::over`] gives to any that takes a difference.
    pub fn named() -> impl Iterator<Item = (&'static str, Kind)> {
        let windowless = |kind: Kind| kind.spec().is_none_or(|spec| spec.key.is_none());
        let all = Kind::ALL.iter().copied();
        all.filter(move |(_, kind)| windowless(*kind) && Self::of(*kind, 1.0).is_some())
    }

    /// Returns true if it begins with a difference, which can be taken over more samples.
    pub fn takes_difference(self) -> bool {
        !matches!(self, Self::Predicted(_))
    }

    /// Its cutoff, Hz.
    pub fn cutoff_hz(self) -> Option<f64> {
        match self {
            Self::BackwardDifference | Self::Over { then: LowPass::None, .. } => None,
            Self::FirstOrder(hz)
            | Self::Butterworth(hz)
            | Self::Predicted(hz)
            | Self::Over { then: LowPass::FirstOrder(hz) | LowPass::Butterworth(hz), .. } => Some(hz),
        }
    }

    /// Over how many samples the difference is taken.
    pub(super) fn samples(self) -> usize {
        match self {
            Self::Over { samples, .. } => samples,
            _ => 1,
        }
    }

    /// Refuses a cutoff at or above half the rate, and windows that no board has.
    pub(super) fn check(self, rate_hz: f64) -> Result<(), AnalysisError> {
        let cutoff = self.cutoff_hz();
        match (self, cutoff) {
            (Self::Over { samples, .. }, _) if !(1..=LONGEST_DIFFERENCE).contains(&samples) => {
                Err(AnalysisError::Difference(samples))
            }
            (_, Some(cutoff)) if !(cutoff > 0.0 && cutoff < rate_hz / 2.0) => {
                Err(AnalysisError::Cutoff { cutoff, rate: rate_hz })
            }
            _ => Ok(()),
        }
    }

    /// Number of states.
    pub(super) fn states(self) -> usize {
        match self {
            Self::BackwardDifference => 0,
            Self::FirstOrder(_) => 1,
            Self::Butterworth(_) => 2,
            Self::Predicted(_) => 3,
            Self::Over { samples, then } => samples - 1 + then.alone().states(),
        }
    }

    /// Returns true if it takes the command into account.
    pub(super) fn predicts(self) -> bool {
        matches!(self, Self::Predicted(_))
    }

    /// One sample from these states, after the joint moved by `moved` and the commanded torque added `pushed` to its
    /// velocity per sample.
    fn answer(self, rate_hz: f64, states: &[f64], moved: f64, pushed: f64) -> Answer {
        let warped = |hz: f64| (std::f64::consts::PI * hz / rate_hz).tan();
        match (self, states) {
            (Self::FirstOrder(hz), [low]) => {
                let step = (moved - low) * warped(hz) / (1.0 + warped(hz));
                Answer { velocity: low + step, change: vec![2.0 * step] }
            }
            (Self::Butterworth(hz), [s1, s2]) => {
                // Trapezoidal state-variable filter: the bilinear Butterworth, exactly.
                let (g, damping) = (warped(hz), std::f64::consts::SQRT_2);
                let high = (moved - (damping + g) * s1 - s2) / (1.0 + g * (damping + g));
                let band = s1 + g * high;
                Answer { velocity: s2 + g * band, change: vec![2.0 * g * high, 2.0 * g * band] }
            }
            (Self::Over { samples, then }, states) => {
                let (past, rest) = states.split_at(samples - 1);
                let mean = (moved + past.iter().sum::<f64>()) / samples as f64;
                let mut after = then.alone().answer(rate_hz, rest, mean, 0.0);
                let mut change = Vec::with_capacity(states.len());
                let mut newer = moved;
                for own in past {
                    change.push(newer - own);
                    newer = *own;
                }
                change.append(&mut after.change);
                Answer { velocity: after.velocity, change }
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
                Answer { velocity: velocity + gained, change }
            }
            _ => Answer { velocity: moved, change: Vec::new() },
        }
    }

    /// Velocity per sample that a position of amplitude 1 gives at an angle per sample, rad; of one that predicts,
    /// without what it knows of the commands.
    pub(super) fn response(self, rate_hz: f64) -> impl Fn(f64) -> Complex<f64> {
        let (samples, filter) = match self {
            Self::Over { samples, then } => (samples, then.alone()),
            alone => (1, alone),
        };
        let (matrix, states) = (filter.matrix(rate_hz), filter.states());
        move |angle: f64| {
            let back = |steps: f64| Complex::from_polar(1.0, -angle * steps);
            let difference = (1.0 - back(samples as f64)) / samples as f64;
            // z - 1 times the states is their change.
            let mut own = matrix.view((0, 0), (states, states)).map(|value| Complex::from(-value));
            own.iter_mut().step_by(states + 1).for_each(|entry| *entry += back(-1.0) - 1.0);
            let driven = matrix.view((0, states), (states, 1)).map(Complex::from);
            let rest = if states == 0 { None } else { own.lu().solve(&driven) };
            let through: Complex<f64> =
                rest.iter().flat_map(|rest| rest.iter().enumerate()).map(|(i, s)| s * matrix[(states, i)]).sum();
            difference * (through + matrix[(states, states)])
        }
    }

    /// The filter as a matrix: over its states, the change of position and the velocity given by the command, each a
    /// column; the change of each state and the velocity, each a row.
    pub fn matrix(self, rate_hz: f64) -> DMatrix<f64> {
        let states = self.states();
        let mut matrix = DMatrix::zeros(states + 1, states + 2);
        let mut unit = vec![0.0; states + 2];
        for column in 0..states + 2 {
            unit[column] = 1.0;
            let answer = self.answer(rate_hz, &unit[..states], unit[states], unit[states + 1]);
            for (row, value) in answer.change.iter().chain([&answer.velocity]).enumerate() {
                matrix[(row, column)] = *value;
            }
            unit[column] = 0.0;
        }
        matrix
    }

    /// Its name on a command line, and the number of samples over which it takes the difference.
    pub fn name_and_window(self) -> (&'static str, usize) {
        match self {
            Self::BackwardDifference => ("backward-difference", 1),
            Self::FirstOrder(_) => ("first-order", 1),
            Self::Butterworth(_) => ("butterworth", 1),
            Self::Predicted(_) => ("predicted", 1),
            Self::Over { samples, then: LowPass::None } => ("backward-difference", samples),
            Self::Over { samples, then: LowPass::FirstOrder(_) } => ("first-order", samples),
            Self::Over { samples, then: LowPass::Butterworth(_) } => ("butterworth", samples),
        }
    }
}

impl LinearEstimator {
    /// The largest velocity that it says of a step of the position, for each metre of the step, 1/s.
    pub fn quickest(self, rate_hz: f64) -> f64 {
        let matrix: DMatrix<f64> = self.matrix(rate_hz);
        let states = matrix.nrows() - 1;
        let mut memory = DVector::zeros(states + 2);
        let mut most: f64 = 0.0;
        // The answer of a low-pass to a step ends before ten of its periods have passed.
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

    /// Its states where it has seen this velocity per sample, given by commands to this part per sample, for long.
    pub(super) fn rest(self, rate_hz: f64, moved: f64, pushed: f64) -> DVector<f64> {
        let (matrix, states) = (self.matrix(rate_hz), self.states());
        if states == 0 {
            return DVector::zeros(0);
        }
        let own = matrix.view((0, 0), (states, states)).into_owned();
        let driven =
            matrix.view((0, states), (states, 1)) * -moved - matrix.view((0, states + 1), (states, 1)) * pushed;
        own.lu().solve(&driven).map_or_else(|| DVector::zeros(states), |rest| rest.column(0).into_owned())
    }
}

impl LowPass {
    /// Behind a backward difference.
    fn alone(self) -> LinearEstimator {
        match self {
            Self::None => LinearEstimator::BackwardDifference,
            Self::FirstOrder(hz) => LinearEstimator::FirstOrder(hz),
            Self::Butterworth(hz) => LinearEstimator::Butterworth(hz),
        }
    }
}
