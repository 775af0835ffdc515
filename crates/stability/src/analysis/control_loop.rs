//! The control loop of a wall: rate, delay, estimator, drives, and the torque that renders the wall's force.

use haptic_bridge::render::scene::FeedForward;

use super::error::AnalysisError;
use super::estimator::LinearEstimator;
use super::flexible::felt;
use super::plant::{Drive, Linearised};

/// Longest delay that can be analysed, samples.
pub const LONGEST_DELAY: f64 = 64.0;
/// Default bandwidth (Hz) of the first-order lag that represents a board's current loop (docs/results.md).
pub const CURRENT_LOOP_HZ: f64 = 6400.0;
/// Carrier frequency of the boards, Hz: torque follows the encoders half a carrier period later.
pub const CARRIER_HZ: f64 = 20_000.0;

/// Torque that renders the wall force: a wall's feed-forward with its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mode {
    /// τ = Jrᵀ fr.
    Off,
    /// Equation (4).
    Full,
    /// Equation (4) with the force behind fa high-passed at this frequency, Hz.
    Washout(f64),
}

impl Mode {
    /// Returns the mode of a wall with this feed-forward and this corner of its washout (Hz).
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
    /// Samples from reading the position to the torque; fractions allowed.
    pub delay_samples: f64,
    /// Velocity estimator of every wall.
    pub estimator: LinearEstimator,
    /// Motor drives.
    pub drive: Drive,
    /// True if the feed-forward also compensates the joints' own damping (B q̇ in b).
    pub damping_compensation: bool,
}

impl Loop {
    /// Returns a control loop at this rate (Hz) with this estimator, through a board's torque path.
    #[must_use]
    pub fn through(path: &TorquePath, rate_hz: f64, estimator: LinearEstimator) -> Self {
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

/// Returns the default delay of a board at a control rate, control samples: half a carrier period.
pub fn usual_delay(rate_hz: f64) -> f64 {
    0.5 / (CARRIER_HZ / rate_hz).round().max(1.0)
}

impl Linearised {
    /// Returns the additional displacement of the tip along the normal at rest that the wall does not measure, m/N: Σⱼ
    /// Jrⱼ τⱼ/kⱼ with the joint torques τ per newton of wall. These torques are those of equation (4) with the full
    /// feed-forward, and Jrᵀ without feed-forward or behind a washout. `None` if no transmission is compliant.
    #[must_use]
    pub fn compliance(&self, mode: Mode) -> Option<f64> {
        match mode {
            Mode::Full => self.flexible.compliance_at_tip(&self.row, &self.shaped_torque()),
            Mode::Off | Mode::Washout(_) => self.flexible.compliance_at_tip(&self.row, &self.row),
        }
    }

    /// Returns the stiffness (N/m) that a hand feels at rest; `None` if no transmission is compliant.
    #[must_use]
    pub fn felt(&self, mode: Mode, stiffness: f64) -> Option<f64> {
        felt(stiffness, self.compliance(mode)?)
    }
}
