//! Walls whose stiffness increases along a line while a rule determines their damping.

use super::control_loop::{Loop, Mode};
use super::error::AnalysisError;
use super::plant::Linearised;
use super::several::open_loop;

const STIFFNESSES_PER_DECADE: u32 = 64;
const DECADES: u32 = 8;

/// Rule for the damping at a stiffness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DampingRule {
    /// Damping ratio ζ with the effective inertia: kd = 2 ζ √(kp m).
    Ratio(f64),
    /// Constant damping, N s/m.
    Damping(f64),
}

impl DampingRule {
    /// Returns the damping (N s/m) of a wall with this stiffness (N/m) and effective inertia (kg).
    #[must_use]
    pub fn damping(self, kp: f64, mass: f64) -> f64 {
        match self {
            Self::Ratio(ratio) => 2.0 * ratio * (kp * mass).sqrt(),
            Self::Damping(kd) => kd,
        }
    }
}

/// Stable part of a line of walls.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StableLine {
    /// Effective inertia, kg.
    pub mass: f64,
    /// Largest stiffness up to which every wall on the line is stable, N/m.
    pub kp: f64,
}

impl StableLine {
    /// Computes the stable part of the line for `device` in the control loop `around`.
    pub fn of(device: &Linearised, around: &Loop, mode: Mode, rule: DampingRule) -> Result<Self, AnalysisError> {
        let open = open_loop(device, device, around, mode)?;
        let (mass, t) = (open.mass, open.sample_s);
        let stable = |kp: f64| open.is_stable(kp * t * t / mass, rule.damping(kp, mass) * t / mass);
        // At this rate the largest stable stiffness is of the order of m/T².
        let largest = 4.0 * mass / (t * t);
        let (mut low, mut high) = (0.0, largest);
        for i in 0..=DECADES * STIFFNESSES_PER_DECADE {
            let kp = largest * 10_f64.powf(f64::from(i) / f64::from(STIFFNESSES_PER_DECADE) - f64::from(DECADES));
            if !stable(kp) {
                high = kp;
                break;
            }
            low = kp;
        }
        while low > 0.0 && high / low > 1.0 + 1e-6 {
            let middle = (low * high).sqrt();
            if stable(middle) { low = middle } else { high = middle }
        }
        Ok(Self { mass, kp: low })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::estimator::LinearEstimator;
    use crate::analysis::plant::Drive;
    use crate::analysis::range::predict;
    use haptic_host::device_file::DeviceFile;

    #[test]
    fn a_line_of_one_damping_ends_at_the_boundary() {
        let file = DeviceFile::load(concat!(env!("CARGO_MANIFEST_DIR"), "/../../devices/coupled-five-bar.toml"))
            .expect("a shipped file");
        let linearised = Linearised::at(&file.description, &[2.6, 1.75], &[0.6, 0.8]).expect("a regular pose");
        let around = Loop {
            rate_hz: 20_000.0,
            delay_samples: 0.5,
            estimator: LinearEstimator::Butterworth(500.0),
            drive: Drive::Ideal,
            damping_compensation: false,
        };
        let range = predict(&linearised, &around, Some(&[20.0]), None).expect("a loop that can be analysed");
        for (mode, boundary) in [(Mode::Off, &range.off.boundary), (Mode::Full, &range.full.boundary)] {
            let line = StableLine::of(&linearised, &around, mode, DampingRule::Damping(20.0)).expect("the same loop");
            let deviation = line.kp / boundary[0].kp - 1.0;
            // The line is searched to a precision of 1e-6.
            assert!(deviation.abs() < 2e-6, "{mode:?}: {} N/m, by {deviation:e} off", line.kp);
        }
    }
}
