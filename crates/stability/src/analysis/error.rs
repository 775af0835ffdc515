//! Why a loop cannot be analysed, in words.

use thiserror::Error;

/// Why a loop cannot be analysed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum AnalysisError {
    /// Rate outside what makes sense.
    #[error("the rate must be a positive number of hertz, not {0}")]
    Rate(f64),
    /// Low-pass or washout at or above the Nyquist frequency, or not positive.
    #[error("a cutoff of {cutoff} Hz cannot be had at {rate} Hz: it must lie above 0 and below half the rate")]
    Cutoff {
        /// Hz.
        cutoff: f64,
        /// Hz.
        rate: f64,
    },
    /// Negative, not finite, or longer than [`super::control_loop::LONGEST_DELAY`].
    #[error("the delay must lie between 0 and 64 samples, not {0}")]
    Delay(f64),
    /// Requests of a program that renders the wall.
    #[error("a host asks {rate} times a second, and it must be 1 to {board}, the board's own rate")]
    HostRate {
        /// Hz.
        rate: f64,
        /// Hz.
        board: f64,
    },
    /// Age of a force that a program sends.
    #[error(
        "a force from the host may be 0 to {longest} s old when it begins to act (64 of its requests), not {delay} s"
    )]
    HostDelay {
        /// s
        delay: f64,
        /// s
        longest: f64,
    },
    /// Samples of the difference.
    #[error("a difference can be taken over 1 to 64 samples, not {0}")]
    Difference(usize),
    /// Bandwidth of the current loop.
    #[error("the current loop's bandwidth must be a positive number of hertz, not {0}")]
    Bandwidth(f64),
    /// Motor data missing or without resistance.
    #[error("a voltage drive needs the resistance of every joint's motor ([joint.motor] in the device file)")]
    Motor,
    /// Jr, M or B not what a device has.
    #[error("the device has no inertia in this direction here: its mass matrix or Jacobian is singular or not finite")]
    Singular,
    /// A damping value of the boundary.
    #[error("damping values must be finite and not negative, not {0}")]
    Damping(f64),
    /// A gain of a wall.
    #[error("a wall's stiffness and damping must be finite and not negative, not {0}")]
    Gain(f64),
    /// Damping compensation is analysed only for a rigid device without a hand.
    #[error("damping compensation is analysed for rigid joints that nobody holds")]
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
