//! Velocity from positions, and the washout's high-pass.
//!
//! Two families. The low-passes of [`LowPass`] take the backward difference of every wall's own distance, as the paper
//! does. An estimator of the list below watches the encoder counts of each joint instead, and a wall's velocity is what
//! the estimated joint velocities make of it, n·J q̇: there the steps of the encoder are known, and the torques are.
//! Each of them is one file beside this one ([`JointEstimator`]) and one line in the list.

mod cutoff;
mod difference;
mod low_pass;
mod predicted;
mod washout;

use crate::math::{Math, Real};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::device::Device;
pub use cutoff::BadCutoff;
use cutoff::warped;
pub use difference::Difference;
pub use low_pass::{LowPass, Velocity};
pub use predicted::Predicted;
pub use washout::Washout;

/// Most samples that an estimator looks back.
pub const LONGEST_WINDOW: usize = 32;

/// Most periods after which an estimate of one count is looked for: the peak of the slowest low-pass that a scene may
/// ask for, 1 Hz at 20 kHz, lies at 3536.
const LONGEST_RISE: usize = 4096;

/// The meaning of `cutoff_hz` for an estimator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CutoffMeans {
    /// Its own bandwidth.
    Bandwidth,
    /// The cutoff of a 2nd-order Butterworth low-pass behind it, which is there if a cutoff is given.
    LowPassBehind,
}

/// The value that an estimator takes besides the cutoff: a whole number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EstimatorKey {
    /// Its key in scene files.
    pub name: &'static str,
    /// The unit that it counts.
    pub unit: &'static str,
    /// Least and most.
    pub range: (u32, u32),
    /// Its value if a file does not give one.
    pub usual: u32,
}

/// The entry of an estimator in scene files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EstimatorSpec {
    /// Its word for `estimator`.
    pub name: &'static str,
    /// The meaning of the cutoff for it.
    pub cutoff: CutoffMeans,
    /// Its own value, if it takes one.
    pub key: Option<EstimatorKey>,
    /// True if it wants to know the acceleration that the motors' torques give the joints.
    pub predicts: bool,
}

/// The choices that go with an estimator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
pub struct Chosen {
    /// The value of the key that its [`EstimatorSpec`] names; 0 where it names none.
    pub value: u32,
    /// True if a Butterworth low-pass at the cutoff stands behind it.
    pub filtered: bool,
}

/// The samples of one joint in one control period, in encoder counts and control periods.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen<T> {
    /// Distance that it moved, counts.
    pub moved: T,
    /// Acceleration that the motors' torques gave it, counts per period²; zero for an estimator that does not predict.
    pub pushed: T,
    /// Counts per period² in 1 rad/s²; negative where the encoder is inverted.
    pub unit: T,
}

/// A velocity estimator that watches one joint's encoder.
///
/// Velocities are in counts per control period. [`JointEstimator::step`] runs in the control interrupt: bounded time and
/// no panic.
pub trait JointEstimator<T: Real>: Copy {
    /// Its entry in scene files.
    const SPEC: EstimatorSpec;
    /// Its coefficients.
    type Design: Copy + core::fmt::Debug + PartialEq;
    /// Coefficients for these choices; `warped` is tan(π cutoff/rate).
    fn design(chosen: &Chosen, warped: T) -> Self::Design;
    /// The lag of the velocity while it grows steadily, control periods.
    fn lag(design: &Self::Design) -> T;
    /// Its memory of a joint that has been moving at this velocity.
    fn moving_at(velocity: T) -> Self;
    /// The velocity now.
    fn step<K: Math<T>>(&mut self, design: &Self::Design, seen: &Seen<T>) -> T;
}

macro_rules! estimators {
    ($($(#[$doc:meta])* $Name:ident;)*) => {
        /// The estimators of wall velocities.
        #[derive(
            Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize, postcard_schema::Schema,
        )]
        #[serde(rename_all = "kebab-case")]
        pub enum Estimator {
            /// Backward difference and a 2nd-order Butterworth low-pass: the paper's.
            #[default]
            Butterworth,
            /// Backward difference and a 1st-order low-pass: less lag, less smoothing.
            FirstOrder,
            /// Backward difference alone; the cutoff is not used.
            BackwardDifference,
            $($(#[$doc])* $Name(Chosen),)*
        }

        impl Estimator {
            /// The entries in scene files of the estimators that watch joints.
            pub const SPECS: &'static [EstimatorSpec] = &[$(<$Name<f32> as JointEstimator<f32>>::SPEC),*];

            /// Every estimator, as it is where a file says no more than its name.
            pub const ALL: &'static [(&'static str, Self)] = &[
                ("butterworth", Self::Butterworth),
                ("first-order", Self::FirstOrder),
                ("backward-difference", Self::BackwardDifference),
                $((<$Name<f32> as JointEstimator<f32>>::SPEC.name, Self::$Name(usual(&<$Name<f32> as JointEstimator<f32>>::SPEC))),)*
            ];

            /// Its entry in scene files, if it watches joints.
            pub fn spec(&self) -> Option<EstimatorSpec> {
                match self {
                    $(Self::$Name(_) => Some(<$Name<f32> as JointEstimator<f32>>::SPEC),)*
                    _ => None,
                }
            }

            /// The choices that go with it, if it watches joints.
            pub fn chosen(&self) -> Option<Chosen> {
                match self {
                    $(Self::$Name(chosen) => Some(*chosen),)*
                    _ => None,
                }
            }

            /// The same with other choices.
            pub fn choosing(self, chosen: Chosen) -> Self {
                match self {
                    $(Self::$Name(_) => Self::$Name(chosen),)*
                    other => other,
                }
            }
        }

        /// Coefficients of an estimator that watches joints.
        #[derive(Clone, Copy, Debug, PartialEq)]
        enum Design<T: Real> { $($Name(<$Name<T> as JointEstimator<T>>::Design),)* }

        impl<T: Real> Design<T> {
            /// Of an estimator with its lag (control periods), if it watches joints.
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

        /// An estimator's memory of a joint.
        #[derive(Clone, Copy, Debug, Default)]
        enum Memory<T: Real> {
            /// Nothing: it does not watch joints.
            #[default]
            None,
            $($Name($Name<T>),)*
        }

        impl<T: Real> Memory<T> {
            fn moving_at(design: &Design<T>, velocity: T) -> Self {
                match design { $(Design::$Name(_) => Self::$Name(JointEstimator::moving_at(velocity)),)* }
            }

            /// The velocity, counts per period. Memory of another estimator is dropped.
            fn step<K: Math<T>>(&mut self, design: &Design<T>, seen: &Seen<T>, velocity: T) -> T {
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
    /// Predicts by the motors' torques and the device's inertia, corrects by counts.
    Predicted;
}

/// The choice if a file does not give one.
const fn usual(spec: &EstimatorSpec) -> Chosen {
    let value = match &spec.key {
        Some(key) => key.usual,
        None => 0,
    };
    Chosen { value, filtered: false }
}

impl Estimator {
    /// Its name in scene files and on the command line.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Butterworth => "butterworth",
            Self::FirstOrder => "first-order",
            Self::BackwardDifference => "backward-difference",
            other => other.spec().map_or("", |spec| spec.name),
        }
    }

    /// Returns true if its value lies in its range.
    pub fn valid(&self) -> bool {
        let (Some(spec), Some(chosen)) = (self.spec(), self.chosen()) else { return true };
        let (least, most) = spec.key.map_or((0, 0), |key| key.range);
        (least..=most).contains(&chosen.value)
    }
}

/// An estimator's coefficients, made when a scene or its gains are set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coefficients<T: Real> {
    /// Control rate, Hz.
    rate: T,
    kind: Estimator,
    /// Share that the low-pass's band-pass state loses in half a step, 1 - a₁: small if the cutoff is, so it keeps its
    /// digits there. None in a low-pass of first order.
    loss: T,
    a2: T,
    a3: T,
    /// There is no low-pass: the difference alone.
    none: bool,
    /// Gain of a first-order low-pass at the same cutoff (1 without one).
    first: T,
    /// s, see [`Coefficients::lag`].
    lag: T,
    /// rad/s, see [`Coefficients::one_count`].
    one_count: [T; MAX_JOINTS],
    /// Of one that watches joints.
    joints: Option<Design<T>>,
    /// True if a low-pass stands behind that.
    filtered: bool,
}

impl<T: Real> Coefficients<T> {
    /// For a control rate and a cutoff in Hz. The cutoff must lie between 0 and half the rate, except for
    /// [`Estimator::BackwardDifference`], which has none.
    #[inline(never)]
    pub fn new(kind: Estimator, rate_hz: T, cutoff_hz: T) -> Result<Self, BadCutoff> {
        let one = T::one();
        let g = match kind {
            Estimator::BackwardDifference => one,
            _ => warped(cutoff_hz, rate_hz)?,
        };
        let first = g / (one + g);
        let damped = g * (g + T::from_f64(core::f64::consts::SQRT_2));
        let a1 = one / (one + damped);
        // The slope of the low-pass's phase at rest, and half a sample for the difference.
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
            none: kind == Estimator::BackwardDifference,
            first,
            lag: slope / rate_hz,
            one_count: [T::zero(); MAX_JOINTS],
            joints: design.map(|(design, _)| design),
            filtered,
        })
    }

    /// As [`Coefficients::new`], with what single counts of the device's encoders make of joint velocities. Tries that
    /// count by count, so not for use inside the step.
    #[inline(never)]
    pub fn of_device<K: Math<T>>(
        (kind, rate_hz, cutoff_hz): (Estimator, T, T),
        device: &Device<T>,
    ) -> Result<Self, BadCutoff> {
        let mut coefficients = Self::new(kind, rate_hz, cutoff_hz)?;
        for (i, joint) in device.joints.iter().enumerate().take(device.axes().min(MAX_JOINTS)) {
            let speed = joint.radians_per_count.abs() * rate_hz;
            coefficients.one_count[i] = speed * coefficients.seen_of_one_count::<K>(speed * rate_hz);
        }
        Ok(coefficients)
    }

    /// The largest velocity (counts per period) after one count and then none, for a joint of which a count per period²
    /// is `acceleration` (rad/s²).
    fn seen_of_one_count<K: Math<T>>(&self, acceleration: T) -> T {
        let unit = if acceleration > T::zero() { T::one() / acceleration } else { T::zero() };
        let (mut behind, mut joint) = (LowPass::default(), JointVelocity::default());
        let (mut most, mut quiet) = (T::zero(), 0);
        for period in 0..LONGEST_RISE {
            let moved = if period == 1 { T::one() } else { T::zero() };
            let velocity = match &self.joints {
                Some(design) => {
                    // An estimator that forgets the count is not asked thousands of times while a low-pass behind it
                    // rises: the board does this when a request comes, and its watchdog waits meanwhile.
                    let found = if quiet > LONGEST_WINDOW {
                        T::zero()
                    } else {
                        joint.memory.step::<K>(design, &Seen { moved, pushed: T::zero(), unit }, T::zero())
                    };
                    quiet = if found == T::zero() { quiet + 1 } else { 0 };
                    if self.filtered { joint.behind.step(self, found) } else { found }
                }
                None => behind.step(self, moved),
            };
            if velocity.abs() * T::from_f64(2.0) < most {
                break;
            }
            most = most.greater(velocity.abs());
        }
        most
    }

    /// The largest velocity (rad/s) that the estimate of each joint shows of one single count, after rest: what cannot
    /// be told from standing still. Zero where no device is known.
    pub fn one_count(&self) -> &[T; MAX_JOINTS] {
        &self.one_count
    }

    /// The lag of an estimated velocity, s.
    pub fn lag(&self) -> T {
        self.lag
    }

    /// Of which estimator.
    pub fn kind(&self) -> Estimator {
        self.kind
    }

    /// Control rate, Hz.
    pub fn rate(&self) -> T {
        self.rate
    }

    /// The gain of [`LowPass::step_first_order`] at the same cutoff.
    pub fn first_order_gain(&self) -> T {
        self.first
    }

    /// Returns true if a low-pass behind the backward difference is the whole estimator.
    pub fn is_low_pass(&self) -> bool {
        !self.none && self.joints.is_none()
    }

    /// Returns true if the estimator watches joints.
    #[inline(always)]
    pub fn at_joints(&self) -> bool {
        self.joints.is_some()
    }

    /// Returns true if the estimator wants to know what the motors' torques do.
    pub fn predicts(&self) -> bool {
        self.kind.spec().is_some_and(|spec| spec.predicts)
    }
}

/// An estimator that watches one joint.
#[derive(Clone, Copy, Debug, Default)]
pub struct JointVelocity<T: Real> {
    memory: Memory<T>,
    behind: LowPass<T>,
}

impl<T: Real> JointVelocity<T> {
    /// The velocity (counts per period) after what a period showed. `velocity` is where it starts when another estimator
    /// was at work before. Zero where the estimator does not watch joints.
    pub fn step<K: Math<T>>(&mut self, coefficients: &Coefficients<T>, seen: &Seen<T>, velocity: T) -> T {
        let Some(design) = &coefficients.joints else { return T::zero() };
        let found = self.memory.step::<K>(design, seen, velocity);
        if coefficients.filtered { self.behind.step(coefficients, found) } else { found }
    }
}
