//! The loop around a wall: its rate and delay, its estimator and drives, and which torque the wall's force becomes.

use haptic_bridge::render::scene::FeedForward;

use super::error::AnalysisError;
use super::estimator::LinearEstimator;
use super::flexible::felt;
use super::plant::{Drive, Linearised};

/// Longest delay that can be analysed, in samples.
pub const LONGEST_DELAY: f64 = 64.0;
/// Bandwidth (Hz) of the first-order lag that stands for a board's current loop (docs/results.md) where nothing else is
/// known.
pub const CURRENT_LOOP_HZ: f64 = 6400.0;
/// Carrier of the boards, Hz: torque follows the encoders by half a period of it.
pub const CARRIER_HZ: f64 = 20_000.0;

/// Which torque the wall force becomes: a wall's feed-forward with the numbers that it needs.
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
    /// The mode of a wall with this feed-forward and this corner of its washout (Hz).
    #[must_use]
    pub fn of(feed_forward: FeedForward, washout_hz: f64) -> Self {
        match feed_forward {
            FeedForward::Off => Self::Off,
            FeedForward::Full => Self::Full,
            FeedForward::Washout => Self::Washout(washout_hz),
        }
    }
}

/// Everything about the loop that is not the device.
#[derive(Clone, Debug, PartialEq)]
pub struct Loop {
    /// Control steps per second, Hz.
    pub rate_hz: f64,
    /// Samples between reading the position and the torque that answers it; fractions allowed.
    pub delay_samples: f64,
    /// Velocity estimator of every wall.
    pub estimator: LinearEstimator,
    /// Motor drives.
    pub drive: Drive,
    /// True if the feed-forward also compensates the joints' own damping (B q̇ in b).
    pub damping_compensation: bool,
}

impl Loop {
    /// A loop at this rate (Hz) with this estimator, through a board's torque path.
    #[must_use]
    pub fn through(path: &TorquePath, rate_hz: f64, estimator: LinearEstimator) -> Self {
        let TorquePath { delay_samples, drive } = path.clone();
        Self { rate_hz, delay_samples, estimator, drive, damping_compensation: false }
    }

    /// Refuses what cannot be sampled.
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

/// The delay and lag of a board, from the reading of its encoders to the torque that answers.
#[derive(Clone, Debug, PartialEq)]
pub struct TorquePath {
    /// Control samples, fractions allowed.
    pub delay_samples: f64,
    /// Motor drives.
    pub drive: Drive,
}

impl TorquePath {
    /// That of a board at this control rate when nothing else is known.
    #[must_use]
    pub fn usual(rate_hz: f64) -> Self {
        Self { delay_samples: usual_delay(rate_hz), drive: Drive::Current { bandwidth_hz: CURRENT_LOOP_HZ } }
    }
}

/// The delay of a board at a control rate when nothing else is known, control samples: half a period of the carrier.
pub fn usual_delay(rate_hz: f64) -> f64 {
    0.5 / (CARRIER_HZ / rate_hz).round().max(1.0)
}

impl Linearised {
    /// How far the tip gives way along the normal at rest beyond what the wall sees, m/N: Σⱼ Jrⱼ τⱼ/kⱼ with the joint
    /// torques τ per newton of wall, those of (4) with the full feed-forward and Jrᵀ without it or behind a washout.
    /// `None` where no transmission gives.
    #[must_use]
    pub fn compliance(&self, mode: Mode) -> Option<f64> {
        match mode {
            Mode::Full => self.flexible.compliance_at_tip(&self.row, &self.shaped_torque()),
            Mode::Off | Mode::Washout(_) => self.flexible.compliance_at_tip(&self.row, &self.row),
        }
    }

    /// The stiffness (N/m) that a hand feels at rest of a wall of this stiffness; `None` where no transmission gives.
    #[must_use]
    pub fn felt(&self, mode: Mode, stiffness: f64) -> Option<f64> {
        felt(stiffness, self.compliance(mode)?)
    }
}
