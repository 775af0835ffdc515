//! The distance by which the tip is pulled aside before a trial: no less than encoder steps could explain, no more than
//! the motors can hold, and far enough that friction is small beside it.

use haptic_bridge::control::Rules;
use nalgebra::DVector;

use super::MeasureError;
use super::swing::ENCODER_STEPS;
use haptic_host::device_file::DeviceFile;
use haptic_stability::analysis::plant::Linearised;

/// Share of the motors' force that a pull asks of the tested wall. A swing may then grow by half a dozen before the
/// motors bound it.
const GENTLE: f64 = 0.15;
/// The same where friction asks for more.
const HARD: f64 = 0.6;
/// Smallest ratio of a pull's force to that of friction. Coulomb friction damps a swing of amplitude A and frequency w
/// like 4 F / (pi A w): at forty times F that is a thirtieth of what the spring takes.
const OVER_FRICTION: f64 = 40.0;

/// The bounds of a pull.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Excitation {
    /// Smallest step of the tip along the normal that the encoders show, m.
    pub quantum: f64,
    /// Largest stiffness times pull at which no motor saturates, N: for one wall its force.
    pub force: f64,
    /// Coulomb friction as it meets the tip along the normal, N.
    pub friction: f64,
    /// Longest pull, m.
    pub largest: f64,
}

impl Excitation {
    /// At the pose of `device`, seen along the pull, within `rules` and the motors' own currents. `torques`: of the
    /// joints per metre of pull and N/m of stiffness, without and with the feed-forward, m.
    #[must_use]
    pub fn new(
        file: &DeviceFile,
        device: &Linearised,
        torques: &[DVector<f64>; 2],
        rules: &Rules,
        largest: f64,
    ) -> Self {
        let joints = &file.description.joints[..device.row.len()];
        let (mut quantum, mut friction, mut force) = (0.0, 0.0, f64::INFINITY);
        for (i, joint) in joints.iter().enumerate() {
            if let Some(encoder) = joint.encoder {
                quantum += device.row[i].abs() * std::f64::consts::TAU / encoder.counts_per_turn.abs();
            }
            friction += joint.coulomb * device.unit_motion[i].abs();
            let mut torque = f64::from(rules.limits.torque[i]);
            if let Some(motor) = joint.motor {
                let current = motor.max_current.min(f64::from(rules.limits.current[i]));
                torque = torque.min(motor.torque_constant.abs() * current);
            }
            let lever = torques[0][i].abs().max(torques[1][i].abs());
            if lever > 0.0 {
                force = force.min(torque / lever);
            }
        }
        Self { quantum, force, friction, largest }
    }

    /// The shortest pull of which encoder steps are no explanation, m.
    #[must_use]
    pub fn smallest(&self) -> f64 {
        ENCODER_STEPS * self.quantum
    }

    /// Returns the length of a pull (m) against `stiffness` (N/m), which is that `of` something.
    pub fn pull(&self, stiffness: f64, of: &'static str) -> Result<f64, MeasureError> {
        let smallest = self.smallest();
        if smallest * stiffness > self.force {
            return Err(MeasureError::Saturates { stiffness, of, pull: smallest, force: self.force });
        }
        let force = (OVER_FRICTION * self.friction).clamp(GENTLE * self.force, HARD * self.force);
        Ok(self.largest.min(force / stiffness).max(smallest))
    }
}

/// A length in mm, with as many digits as it takes.
#[must_use]
pub fn millimetres(metres: f64) -> String {
    let mm = metres * 1e3;
    let digits = if mm > 0.0 { (1.0 - mm.log10().floor()).clamp(0.0, 9.0) as usize } else { 0 };
    format!("{mm:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    const COARSE: Excitation = Excitation { quantum: 30e-6, force: 1.6, friction: 0.0, largest: 5e-4 };

    #[test]
    fn a_pull_is_as_long_as_the_motors_hold_and_never_what_encoder_steps_explain() {
        assert_eq!(COARSE.pull(100.0, "a wall").unwrap(), 5e-4);
        assert!((COARSE.pull(1200.0, "a wall").unwrap() - 0.15 * 1.6 / 1200.0).abs() < 1e-15);
        assert_eq!(COARSE.pull(5_000.0, "a wall").unwrap(), 6.0 * 30e-6);
        // 6 x 30 um x 10 kN/m are 1.8 N.
        assert!(matches!(COARSE.pull(10_000.0, "a wall"), Err(MeasureError::Saturates { .. })));
    }

    #[test]
    fn friction_asks_for_more() {
        let dry = Excitation { friction: 0.01, ..COARSE };
        assert!((dry.pull(1200.0, "a wall").unwrap() - 0.4 / 1200.0).abs() < 1e-15);
        let dryer = Excitation { friction: 1.0, ..COARSE };
        assert!((dryer.pull(4_000.0, "a wall").unwrap() - 0.6 * 1.6 / 4_000.0).abs() < 1e-15);
    }

    #[test]
    fn lengths_have_two_digits_or_more() {
        assert_eq!([millimetres(2e-3), millimetres(3.14159e-5), millimetres(0.0)], ["2.0", "0.031", "0"]);
    }
}
