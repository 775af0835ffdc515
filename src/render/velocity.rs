//! Estimation of velocities from positions, and the washout's high-pass.
//!
//! There are two families. A [`LowPass`] filters the backward difference of each wall's own distance, like the paper. A
//! joint estimator ([`JointEstimator`]) instead uses the encoder counts of one joint, because encoder steps and motor
//! torques are known at the joints. A wall's velocity is then n·J q̇. Each joint estimator is one file in this module's
//! folder and one line in the list below.

mod cutoff;
mod difference;
mod low_pass;
mod predicted;
mod washout;

use crate::math::{Math, Real};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::device::Device;
pub use cutoff::BadCutoff;
use cutoff::prewarped_gain;
pub use difference::Difference;
pub use low_pass::{LowPass, Velocity};
pub use predicted::Predicted;
pub use washout::Washout;

/// Maximum number of past samples that an estimator uses.
pub const MAX_WINDOW: usize = 32;
/// Maximum number of periods for which the response to one count is computed. The slowest low-pass, 1 Hz at 20 kHz,
/// peaks at 3536.
const MAX_RESPONSE: usize = 4096;

/// The meaning of `cutoff_hz` for an estimator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CutoffMeaning {
    /// The bandwidth of the estimator.
    Bandwidth,
    /// The cutoff of a 2nd-order Butterworth low-pass after the estimator. The low-pass is used if a cutoff is given.
    LowPassAfter,
}

/// An integer value of an estimator in addition to the cutoff.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EstimatorKey {
    /// Name of the key in scene files.
    pub name: &'static str,
    /// Unit of the value.
    pub unit: &'static str,
    /// Smallest and largest value.
    pub range: (u32, u32),
    /// Value if a scene file does not contain the key.
    pub usual: u32,
}

/// Entry of an estimator in scene files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EstimatorSpec {
    /// Value of the key `estimator` in scene files.
    pub name: &'static str,
    /// Meaning of the cutoff.
    pub cutoff: CutoffMeaning,
    /// Additional value; `None` if the estimator has none.
    pub key: Option<EstimatorKey>,
    /// True if the estimator uses the accelerations that the motors' torques cause.
    pub predicts: bool,
}

/// Options of an estimator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
pub struct Chosen {
    /// Value of [`EstimatorSpec::key`]; 0 without a key.
    pub value: u32,
    /// True if a Butterworth low-pass at the cutoff follows the estimator.
    pub filtered: bool,
}

/// One joint's sample of one control period, in counts and control periods.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSample<T> {
    /// Distance moved, counts.
    pub moved: T,
    /// Acceleration by the motors' torques, counts per period²; zero for an estimator that does not predict.
    pub pushed: T,
    /// Counts per period² for 1 rad/s²; negative if the encoder is inverted.
    pub unit: T,
}

/// A velocity estimator for the encoder of one joint.
///
/// Velocities are in counts per control period. [`JointEstimator::step`] runs in the control interrupt, in bounded
/// time.
pub trait JointEstimator<T: Real>: Copy {
    /// Entry of the estimator in scene files.
    const SPEC: EstimatorSpec;
    /// Coefficients of the estimator.
    type Design: Copy + core::fmt::Debug + PartialEq;
    /// Computes the coefficients for these options; `warped` is tan(π cutoff/rate).
    fn design(chosen: &Chosen, warped: T) -> Self::Design;
    /// Returns the lag of the velocity at constant acceleration, in control periods.
    fn lag(design: &Self::Design) -> T;
    /// Returns the state for a joint that has been moving at `velocity`.
    fn moving_at(velocity: T) -> Self;
    /// Returns the present velocity.
    fn step<K: Math<T>>(&mut self, design: &Self::Design, seen: &JointSample<T>) -> T;
}

macro_rules! estimators {
    ($($(#[$doc:meta])* $Name:ident;)*) => {
        /// The estimators of wall velocities.
        #[derive(
            Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize, postcard_schema::Schema,
        )]
        #[serde(rename_all = "kebab-case")]
        pub enum Estimator {
            /// Backward difference and a 2nd-order Butterworth low-pass, as in the paper.
            #[default]
            Butterworth,
            /// Backward difference and a 1st-order low-pass: less lag and less smoothing than Butterworth.
            FirstOrder,
            /// Backward difference without a filter; the cutoff is not used.
            BackwardDifference,
            $($(#[$doc])* $Name(Chosen),)*
        }

        impl Estimator {
            /// Entries of the joint estimators in scene files.
            pub const SPECS: &'static [EstimatorSpec] = &[$(<$Name<f32> as JointEstimator<f32>>::SPEC),*];
            /// Every estimator with its default options, by name.
            pub const ALL: &'static [(&'static str, Self)] = &[
                ("butterworth", Self::Butterworth),
                ("first-order", Self::FirstOrder),
                ("backward-difference", Self::BackwardDifference),
                $((<$Name<f32> as JointEstimator<f32>>::SPEC.name, Self::$Name(default_options(&<$Name<f32> as JointEstimator<f32>>::SPEC))),)*
            ];

            /// Returns the entry in scene files; `None` unless the estimator uses joints.
            pub fn spec(&self) -> Option<EstimatorSpec> {
                match self {
                    $(Self::$Name(_) => Some(<$Name<f32> as JointEstimator<f32>>::SPEC),)*
                    _ => None,
                }
            }

            /// Returns the options; `None` unless the estimator uses joints.
            pub fn chosen(&self) -> Option<Chosen> {
                match self {
                    $(Self::$Name(chosen) => Some(*chosen),)*
                    _ => None,
                }
            }

            /// Returns the estimator with other options.
            pub fn with_options(self, chosen: Chosen) -> Self {
                match self {
                    $(Self::$Name(_) => Self::$Name(chosen),)*
                    other => other,
                }
            }
        }

        #[derive(Clone, Copy, Debug, PartialEq)]
        enum Design<T: Real> { $($Name(<$Name<T> as JointEstimator<T>>::Design),)* }

        impl<T: Real> Design<T> {
            /// Makes the coefficients and the lag (control periods); `None` unless the estimator uses joints.
            fn new(kind: Estimator, warped: T) -> Option<(Self, T)> {
                match kind {
                    $(Estimator::$Name(chosen) => {
                        let design = <$Name<T> as JointEstimator<T>>::design(&chosen, warped);
                        Some((Self::$Name(design), <$Name<T> as JointEstimator<T>>::lag(&design)))
                    })*
                    _ => None,
                }
            }
        }

        /// State of a joint estimator.
        #[derive(Clone, Copy, Debug, Default)]
        enum Memory<T: Real> {
            /// No state: the estimator does not use joints.
            #[default]
            None,
            $($Name($Name<T>),)*
        }

        impl<T: Real> Memory<T> {
            fn moving_at(design: &Design<T>, velocity: T) -> Self {
                match design { $(Design::$Name(_) => Self::$Name(JointEstimator::moving_at(velocity)),)* }
            }

            /// Returns the velocity, counts per period. Starts from `velocity` if the state is of another estimator.
            fn step<K: Math<T>>(&mut self, design: &Design<T>, seen: &JointSample<T>, velocity: T) -> T {
                match (&mut *self, design) {
                    $((Self::$Name(memory), Design::$Name(design)) => memory.step::<K>(design, seen),)*
                    _ => {
                        *self = Self::moving_at(design, velocity);
                        velocity
                    }
                }
            }
        }
    };
}

estimators! {
    /// Difference over several samples.
    Difference;
    /// Prediction from the motors' torques and the device's inertia, corrected by counts.
    Predicted;
}

/// Returns the default options, for a file that sets none.
const fn default_options(spec: &EstimatorSpec) -> Chosen {
    let value = match &spec.key {
        Some(key) => key.usual,
        None => 0,
    };
    Chosen { value, filtered: false }
}

impl Estimator {
    /// Returns the estimator's name in scene files and on the command line.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Butterworth => "butterworth",
            Self::FirstOrder => "first-order",
            Self::BackwardDifference => "backward-difference",
            other => other.spec().map_or("", |spec| spec.name),
        }
    }

    /// Returns true if the additional value is in its range.
    pub fn is_valid(&self) -> bool {
        let (Some(spec), Some(chosen)) = (self.spec(), self.chosen()) else { return true };
        let (smallest, largest) = spec.key.map_or((0, 0), |key| key.range);
        (smallest..=largest).contains(&chosen.value)
    }
}

/// Coefficients of an estimator, computed when a scene or its gains are set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coefficients<T: Real> {
    /// Control rate, Hz.
    rate: T,
    kind: Estimator,
    /// 1 - a₁: the share of the low-pass's band-pass state that is lost in half a step. Stored instead of a₁, whose
    /// rounding would hide the small share of a low cutoff. Zero for a first-order low-pass.
    loss: T,
    a2: T,
    a3: T,
    /// True if the backward difference is not filtered.
    unfiltered: bool,
    /// Gain of a first-order low-pass at the same cutoff; 1 without a cutoff.
    first: T,
    /// Lag, s, see [`Coefficients::lag`].
    lag: T,
    /// Velocity of one count, rad/s, see [`Coefficients::one_count`].
    one_count: [T; MAX_JOINTS],
    /// Coefficients of an estimator that uses joints.
    joints: Option<Design<T>>,
    /// True if a low-pass follows the joint estimator.
    filtered: bool,
}

impl<T: Real> Coefficients<T> {
    /// Computes the coefficients for a control rate and a cutoff in Hz. The cutoff must be between 0 and half the rate,
    /// except for [`Estimator::BackwardDifference`], which has no cutoff.
    #[inline(never)]
    pub fn new(kind: Estimator, rate_hz: T, cutoff_hz: T) -> Result<Self, BadCutoff> {
        let one = T::one();
        let g = match kind {
            Estimator::BackwardDifference => one,
            _ => prewarped_gain(cutoff_hz, rate_hz)?,
        };
        let first = g / (one + g);
        let damped = g * (g + T::from_f64(core::f64::consts::SQRT_2));
        let a1 = one / (one + damped);
        // Slope of the low-pass's phase at zero frequency. The difference adds half a sample.
        let second_order = T::from_f64(core::f64::consts::FRAC_1_SQRT_2) / g;
        let half = T::from_f64(0.5);
        let design = Design::new(kind, g);
        let filtered = kind.chosen().is_some_and(|chosen| chosen.filtered);
        let slope = match (kind, &design) {
            (_, Some((_, lag))) if filtered => *lag + second_order,
            (_, Some((_, lag))) => *lag,
            (Estimator::FirstOrder, _) => half + half / g,
            (Estimator::BackwardDifference, _) => half,
            _ => half + second_order,
        };
        let zero = T::zero();
        let (loss, a2, a3) = match kind {
            Estimator::FirstOrder => (zero, zero, first),
            _ => (damped * a1, g * a1, g * g * a1),
        };
        Ok(Self {
            rate: rate_hz,
            kind,
            loss,
            a2,
            a3,
            unfiltered: kind == Estimator::BackwardDifference,
            first,
            lag: slope / rate_hz,
            one_count: [T::zero(); MAX_JOINTS],
            joints: design.map(|(design, _)| design),
            filtered,
        })
    }

    /// Makes [`Coefficients::new`] with the joint velocities that single counts of the device's encoders cause.
    /// Simulates these counts step by step, so do not call this function inside the control step.
    #[inline(never)]
    pub fn of_device<K: Math<T>>(
        (kind, rate_hz, cutoff_hz): (Estimator, T, T),
        device: &Device<T>,
    ) -> Result<Self, BadCutoff> {
        let mut coefficients = Self::new(kind, rate_hz, cutoff_hz)?;
        for (i, joint) in device.joints.iter().enumerate().take(device.axes().min(MAX_JOINTS)) {
            let speed = joint.radians_per_count.abs() * rate_hz;
            coefficients.one_count[i] = speed * coefficients.response_to_one_count::<K>(speed * rate_hz);
        }
        Ok(coefficients)
    }

    /// Returns the largest velocity after a single count (counts per period), for a joint on which one count per
    /// period² is `acceleration` (rad/s²).
    fn response_to_one_count<K: Math<T>>(&self, acceleration: T) -> T {
        let unit = if acceleration > T::zero() { T::one() / acceleration } else { T::zero() };
        let (mut low_pass, mut joint) = (LowPass::default(), JointVelocity::default());
        let (mut largest, mut quiet) = (T::zero(), 0);
        for period in 0..MAX_RESPONSE {
            let moved = if period == 1 { T::one() } else { T::zero() };
            let velocity = match &self.joints {
                Some(design) => {
                    // An estimator with zero output is not run thousands of times while the low-pass after it still
                    // responds, because the board runs this during a request while its watchdog waits.
                    let velocity = if quiet > MAX_WINDOW {
                        T::zero()
                    } else {
                        joint.memory.step::<K>(design, &JointSample { moved, pushed: T::zero(), unit }, T::zero())
                    };
                    quiet = if velocity == T::zero() { quiet + 1 } else { 0 };
                    if self.filtered { joint.low_pass.step(self, velocity) } else { velocity }
                }
                None => low_pass.step(self, moved),
            };
            if velocity.abs() * T::from_f64(2.0) < largest {
                break;
            }
            largest = largest.greater(velocity.abs());
        }
        largest
    }

    /// Returns the largest velocity of each joint's estimate after a single count from rest, rad/s: smaller velocities
    /// cannot be distinguished from rest. Zero without a known device.
    pub fn one_count(&self) -> &[T; MAX_JOINTS] {
        &self.one_count
    }

    /// Returns the lag of an estimated velocity, s.
    pub fn lag(&self) -> T {
        self.lag
    }

    /// Returns the kind of estimator.
    pub fn kind(&self) -> Estimator {
        self.kind
    }

    /// Returns the control rate, Hz.
    pub fn rate(&self) -> T {
        self.rate
    }

    /// Returns the gain of [`LowPass::step_first_order`] at the same cutoff.
    pub fn first_order_gain(&self) -> T {
        self.first
    }

    /// Returns true if the estimator consists of the backward difference and a low-pass.
    pub fn is_low_pass(&self) -> bool {
        !self.unfiltered && self.joints.is_none()
    }

    /// Returns true if the estimator uses joints.
    #[inline(always)]
    pub fn uses_joints(&self) -> bool {
        self.joints.is_some()
    }

    /// Returns true if the estimator uses the motors' torques.
    pub fn predicts(&self) -> bool {
        self.kind.spec().is_some_and(|spec| spec.predicts)
    }
}

/// A joint estimator with the low-pass that may follow it.
#[derive(Clone, Copy, Debug, Default)]
pub struct JointVelocity<T: Real> {
    memory: Memory<T>,
    low_pass: LowPass<T>,
}

impl<T: Real> JointVelocity<T> {
    /// Returns the velocity (counts per period) after this period's sample. `velocity` is the initial velocity if
    /// another estimator was used before. Returns zero if the estimator does not use joints.
    pub fn step<K: Math<T>>(&mut self, coefficients: &Coefficients<T>, seen: &JointSample<T>, velocity: T) -> T {
        let Some(design) = &coefficients.joints else { return T::zero() };
        let velocity = self.memory.step::<K>(design, seen, velocity);
        if coefficients.filtered { self.low_pass.step(coefficients, velocity) } else { velocity }
    }
}
