//! Length of the pull before a trial, between encoder steps, friction and the force of the motors.

use super::MeasureError;
use super::swing::ENCODER_STEPS;
use haptic_bridge::control::Rules;
use haptic_host::device_file::DeviceFile;
use haptic_stability::analysis::plant::Linearised;
use nalgebra::DVector;

/// Usual share of the motors' force for a pull. The swing can grow to six times its size before the motors saturate.
const USUAL_SHARE: f64 = 0.15;
/// Largest share of the motors' force for a pull, if friction requires more than [`USUAL_SHARE`].
const LARGEST_SHARE: f64 = 0.6;
/// Smallest ratio of a pull's force to friction. Coulomb friction F damps a swing of amplitude A and angular frequency
/// w like a damper of 4 F / (π A w); at a ratio of 40 the damping force is a thirtieth of the spring's.
const LEAST_FRICTION_RATIO: f64 = 40.0;

/// Bounds of a pull.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Excitation {
    /// Tip motion along the pull by one count of every encoder, m.
    pub quantum: f64,
    /// Largest product of stiffness and pull without saturation, N; for one wall this is the wall's force.
    pub force: f64,
    /// Coulomb friction at the tip along the pull, N.
    pub friction: f64,
    /// Longest pull, m.
    pub longest_pull: f64,
}

impl Excitation {
    /// Computes the bounds at the pose of `device` within `rules` and the motors' currents. `torques` are the joint
    /// torques per metre of pull and per N/m of stiffness, without and with the feed-forward, m.
    #[must_use]
    pub fn new(
        file: &DeviceFile,
        device: &Linearised,
        torques: &[DVector<f64>; 2],
        rules: &Rules,
        longest_pull: f64,
    ) -> Self {
        let joints = &file.description.joints[..device.row.len()];
        let limits = rules.limits.in_units(&file.description.units());
        let (mut quantum, mut friction, mut force) = (0.0, 0.0, f64::INFINITY);
        for (i, joint) in joints.iter().enumerate() {
            if let Some(encoder) = joint.encoder {
                quantum += device.row[i].abs() * std::f64::consts::TAU / encoder.counts_per_turn.abs();
            }
            friction += joint.coulomb * device.unit_motion[i].abs();
            let mut torque = f64::from(limits.torque[i]);
            if let Some(motor) = joint.motor {
                let current = motor.max_current.min(f64::from(limits.current[i]));
                torque = torque.min(motor.torque_constant.abs() * current);
            }
            let lever = torques[0][i].abs().max(torques[1][i].abs());
            if lever > 0.0 {
                force = force.min(torque / lever);
            }
        }
        Self { quantum, force, friction, longest_pull }
    }

    /// Returns the shortest pull that exceeds the motion by encoder steps, m.
    #[must_use]
    pub fn shortest_pull(&self) -> f64 {
        ENCODER_STEPS * self.quantum
    }

    /// Returns the length of a pull against `stiffness` (N/m), m. `of` names the wall or hold for the error message.
    pub fn pull(&self, stiffness: f64, of: &'static str) -> Result<f64, MeasureError> {
        let smallest = self.shortest_pull();
        if smallest * stiffness > self.force {
            return Err(MeasureError::Saturates { stiffness, of, pull: smallest, force: self.force });
        }
        let force = (LEAST_FRICTION_RATIO * self.friction).clamp(USUAL_SHARE * self.force, LARGEST_SHARE * self.force);
        Ok(self.longest_pull.min(force / stiffness).max(smallest))
    }
}

/// Formats a length in millimetres with at least two digits.
#[must_use]
pub fn millimetres(metres: f64) -> String {
    let mm = metres * 1e3;
    let digits = if mm > 0.0 { (1.0 - mm.log10().floor()).clamp(0.0, 9.0) as usize } else { 0 };
    format!("{mm:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    const COARSE_ENCODERS: Excitation = Excitation { quantum: 30e-6, force: 1.6, friction: 0.0, longest_pull: 5e-4 };

    #[test]
    fn pulls_fit_the_motors_and_exceed_encoder_steps() {
        assert_eq!(COARSE_ENCODERS.pull(100.0, "a wall").unwrap(), 5e-4);
        assert!((COARSE_ENCODERS.pull(1200.0, "a wall").unwrap() - 0.15 * 1.6 / 1200.0).abs() < 1e-15);
        assert_eq!(COARSE_ENCODERS.pull(5_000.0, "a wall").unwrap(), 6.0 * 30e-6);
        // 6 · 30 µm · 10 kN/m = 1.8 N, more than the motors' 1.6 N.
        assert!(matches!(COARSE_ENCODERS.pull(10_000.0, "a wall"), Err(MeasureError::Saturates { .. })));
    }

    #[test]
    fn friction_lengthens_pulls() {
        let dry = Excitation { friction: 0.01, ..COARSE_ENCODERS };
        assert!((dry.pull(1200.0, "a wall").unwrap() - 0.4 / 1200.0).abs() < 1e-15);
        let dryer = Excitation { friction: 1.0, ..COARSE_ENCODERS };
        assert!((dryer.pull(4_000.0, "a wall").unwrap() - 0.6 * 1.6 / 4_000.0).abs() < 1e-15);
    }

    #[test]
    fn lengths_have_two_digits_or_more() {
        assert_eq!([millimetres(2e-3), millimetres(3.14159e-5), millimetres(0.0)], ["2.0", "0.031", "0"]);
    }
}
