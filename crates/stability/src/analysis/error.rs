//! Errors of the analysis of a control loop.

use thiserror::Error;

/// Reason why a control loop cannot be analysed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum AnalysisError {
    /// Rate that is not positive or not finite.
    #[error("the rate must be a positive number of hertz, not {0}")]
    Rate(f64),
    /// Low-pass or washout at or above the Nyquist frequency, or not positive.
    #[error("a cutoff of {cutoff} Hz is impossible at {rate} Hz: it must lie above 0 and below half the rate")]
    Cutoff {
        /// Frequency, Hz.
        cutoff: f64,
        /// Control rate, Hz.
        rate: f64,
    },
    /// Negative, not finite, or longer than [`super::control_loop::LONGEST_DELAY`].
    #[error("the delay must lie between 0 and 64 samples, not {0}")]
    Delay(f64),
    /// Request rate of a program that renders the wall.
    #[error("a host sends {rate} requests a second, but the rate must be 1 to {board}, the board's own rate")]
    HostRate {
        /// Request rate, Hz.
        rate: f64,
        /// Control rate of the board, Hz.
        board: f64,
    },
    /// Age of a force from a program.
    #[error(
        "a force from the host may be 0 to {longest} s old when it begins to act (64 of its requests), not {delay} s"
    )]
    HostDelay {
        /// Age, s.
        delay: f64,
        /// Longest age, s.
        longest: f64,
    },
    /// Window of the difference, samples.
    #[error("a difference can be taken over 1 to 64 samples, not {0}")]
    Difference(usize),
    /// Bandwidth of the current loop.
    #[error("the current loop's bandwidth must be a positive number of hertz, not {0}")]
    Bandwidth(f64),
    /// Motor data missing or without resistance.
    #[error("a voltage drive needs the resistance of every joint's motor ([joint.motor] in the device file)")]
    Motor,
    /// Jr, M or B that no device has.
    #[error("the device has no inertia in this direction here: its mass matrix or Jacobian is singular or not finite")]
    Singular,
    /// Damping value of the boundary.
    #[error("damping values must be finite and not negative, not {0}")]
    Damping(f64),
    /// Gain of a wall.
    #[error("a wall's stiffness and damping must be finite and not negative, not {0}")]
    Gain(f64),
    /// Damping compensation is analysed only for a rigid device without a hand.
    #[error("damping compensation is analysed only for rigid joints without a hand")]
    CompensatedFlexible,
    /// No upper limit of stiffness was found.
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
