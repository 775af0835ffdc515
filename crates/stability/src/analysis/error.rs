//! Errors of the analysis of a control loop.

use thiserror::Error;

/// Reason why a control loop cannot be analysed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum AnalysisError {
    /// The rate is not positive or not finite.
    #[error("the rate must be a positive number of hertz, not {0}")]
    Rate(f64),
    /// The low-pass or washout frequency is not positive or not below the Nyquist frequency.
    #[error("a cutoff of {cutoff} Hz is impossible at {rate} Hz: it must lie above 0 and below half the rate")]
    Cutoff {
        /// Frequency, Hz.
        cutoff: f64,
        /// Control rate, Hz.
        rate: f64,
    },
    /// The delay is negative, not finite, or longer than [`super::control_loop::LONGEST_DELAY`].
    #[error("the delay must lie between 0 and 64 samples, not {0}")]
    Delay(f64),
    /// The request rate of a program that renders the wall is outside the analysed range.
    #[error("a host sends {rate} requests a second, but the rate must be 1 to {board}, the board's own rate")]
    HostRate {
        /// Request rate, Hz.
        rate: f64,
        /// Control rate of the board, Hz.
        board: f64,
    },
    /// The age of a force from a program is outside the analysed range.
    #[error(
        "a force from the host may be 0 to {longest} s old when it begins to act (64 of its requests), not {delay} s"
    )]
    HostDelay {
        /// Age, s.
        delay: f64,
        /// Longest age, s.
        longest: f64,
    },
    /// The window of a velocity difference has an unsupported number of samples.
    #[error("a difference can be taken over 1 to 64 samples, not {0}")]
    Difference(usize),
    /// The bandwidth of the current loop is not positive or not finite.
    #[error("the current loop's bandwidth must be a positive number of hertz, not {0}")]
    Bandwidth(f64),
    /// Motor data are missing or have no resistance.
    #[error("a voltage drive needs the resistance of every joint's motor ([joint.motor] in the device file)")]
    Motor,
    /// The mass matrix or Jacobian is singular or not finite.
    #[error("the device has no inertia in this direction here: its mass matrix or Jacobian is singular or not finite")]
    Singular,
    /// A requested damping is negative or not finite.
    #[error("damping values must be finite and not negative, not {0}")]
    Damping(f64),
    /// A wall's gain is negative or not finite.
    #[error("a wall's stiffness and damping must be finite and not negative, not {0}")]
    Gain(f64),
    /// Damping compensation was requested for a compliant device or with a hand.
    #[error("damping compensation is analysed only for rigid joints without a hand")]
    CompensatedFlexible,
    /// The search found no upper limit of stiffness.
    #[error("no stiffness was found at which this loop becomes unstable")]
    Unbounded,
}

impl From<AnalysisError> for haptic_host::error::Failure {
    fn from(error: AnalysisError) -> Self {
        match error {
            AnalysisError::Singular | AnalysisError::Unbounded => Self::impossible(error),
            _ => Self::wrong(error),
        }
    }
}
