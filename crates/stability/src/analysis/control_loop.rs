//! The control loop of a wall: rate, delay, estimator, drives, and the torque that renders the wall's force.

use super::error::AnalysisError;
use super::estimator::LinearEstimator;
use super::flexible::felt_stiffness;
use super::plant::{Drive, Linearised};
use haptic_bridge::render::scene::FeedForward;

/// Longest delay that can be analysed, samples.
pub const LONGEST_DELAY: f64 = 64.0;
/// Default bandwidth (Hz) of the first-order lag that represents a board's current loop (docs/results.md).
pub const CURRENT_LOOP_HZ: f64 = 6400.0;
/// Carrier frequency of the boards, Hz. A torque acts half a carrier period after the encoders are read.
pub const CARRIER_HZ: f64 = 20_000.0;

/// Feed-forward of a wall with its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mode {
    /// Without feed-forward: τ = Jrᵀ fr.
    Off,
    /// Full feed-forward: equation (4).
    Full,
    /// Equation (4) with a high-pass on the force of the feed-forward; corner frequency, Hz.
    Washout(f64),
}

impl Mode {
    /// Returns the mode for a feed-forward; `washout_hz` is the corner of the washout, Hz.
    #[must_use]
    pub fn of(feed_forward: FeedForward, washout_hz: f64) -> Self {
        match feed_forward {
            FeedForward::Off => Self::Off,
            FeedForward::Full => Self::Full,
            FeedForward::Washout => Self::Washout(washout_hz),
        }
    }
}

/// Everything about the control loop except the device.
#[derive(Clone, Debug, PartialEq)]
pub struct Loop {
    /// Control steps per second, Hz.
    pub rate_hz: f64,
    /// Delay from reading the position to the torque, control samples; fractions allowed.
    pub delay_samples: f64,
    /// Velocity estimator of all walls.
    pub estimator: LinearEstimator,
    /// Motor drives.
    pub drive: Drive,
    /// True if the feed-forward also compensates the joints' own damping (B q̇ in b).
    pub damping_compensation: bool,
}

impl Loop {
    /// Returns a control loop with this rate (Hz), this estimator and a board's torque path.
    #[must_use]
    pub fn with_torque_path(path: &TorquePath, rate_hz: f64, estimator: LinearEstimator) -> Self {
        let TorquePath { delay_samples, drive } = path.clone();
        Self { rate_hz, delay_samples, estimator, drive, damping_compensation: false }
    }

    /// Rejects values that cannot be analysed.
    pub fn check(&self) -> Result<(), AnalysisError> {
        if !(self.rate_hz.is_finite() && self.rate_hz > 0.0) {
            return Err(AnalysisError::Rate(self.rate_hz));
        }
        if !(0.0..=LONGEST_DELAY).contains(&self.delay_samples) {
            return Err(AnalysisError::Delay(self.delay_samples));
        }
        self.estimator.check(self.rate_hz)?;
        match &self.drive {
            Drive::Current { bandwidth_hz } if !(bandwidth_hz.is_finite() && *bandwidth_hz > 0.0) => {
                Err(AnalysisError::Bandwidth(*bandwidth_hz))
            }
            Drive::Voltage(motors) if motors.iter().any(|m| !(m.resistance > 0.0 && m.inductance >= 0.0)) => {
                Err(AnalysisError::Motor)
            }
            _ => Ok(()),
        }
    }

    pub(super) fn check_cutoff(&self, cutoff: f64) -> Result<(), AnalysisError> {
        if cutoff > 0.0 && cutoff < self.rate_hz / 2.0 {
            Ok(())
        } else {
            Err(AnalysisError::Cutoff { cutoff, rate: self.rate_hz })
        }
    }
}

/// Delay and lag of a board, from reading its encoders to the torque.
#[derive(Clone, Debug, PartialEq)]
pub struct TorquePath {
    /// Delay in control samples, fractions allowed.
    pub delay_samples: f64,
    /// Motor drives.
    pub drive: Drive,
}

impl TorquePath {
    /// Returns the default torque path of a board at this control rate.
    #[must_use]
    pub fn usual(rate_hz: f64) -> Self {
        Self { delay_samples: usual_delay(rate_hz), drive: Drive::Current { bandwidth_hz: CURRENT_LOOP_HZ } }
    }
}

/// Returns the default delay of a board, control samples: half a carrier period.
pub fn usual_delay(rate_hz: f64) -> f64 {
    0.5 / (CARRIER_HZ / rate_hz).round().max(1.0)
}

impl Linearised {
    /// Returns the displacement of the tip along the normal at rest that the encoders do not measure, m/N: Σⱼ Jrⱼ
    /// τⱼ/kⱼ. The joint torques τ per newton of wall force come from equation (4) for the full feed-forward,
    /// otherwise Jrᵀ. Returns `None` if no transmission is compliant.
    #[must_use]
    pub fn compliance(&self, mode: Mode) -> Option<f64> {
        match mode {
            Mode::Full => self.flexible.compliance_at_tip(&self.row, &self.shaped_torque()),
            Mode::Off | Mode::Washout(_) => self.flexible.compliance_at_tip(&self.row, &self.row),
        }
    }

    /// Returns the stiffness that a hand feels at rest, N/m; `None` if no transmission is compliant.
    #[must_use]
    pub fn felt_stiffness(&self, mode: Mode, stiffness: f64) -> Option<f64> {
        felt_stiffness(stiffness, self.compliance(mode)?)
    }
}
