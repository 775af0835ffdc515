//! The cogging of a motor: the torque of its magnets without current, as the derivative of a potential.
//!
//! The potential is a Fourier series of the angle θ of the motor's shaft, V(θ) = Σ energy cos(order θ + phase). Orders
//! are integers above zero, so the torque does no net work in a turn. θ is zero where the joint's angle q is zero. The
//! magnets' torque at the joint is -dV/dq, and the compensation adds dV/dq.

use crate::math::{BinaryAngle, table_sin_cos};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::device::{Device, Joint};
use core::f64::consts::TAU;
use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Maximum number of harmonics of a potential.
pub const MAX_HARMONICS: usize = 8;
/// Largest sum of the harmonics' torques, as a share of the torque of the motor's largest current.
pub const MAX_TORQUE_SHARE: f32 = 0.25;

/// A harmonic of a potential.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Harmonic {
    /// Periods in a turn of the motor's shaft, above zero.
    pub order: u16,
    /// Amplitude of the potential, J.
    pub energy: f32,
    /// Phase at joint angle zero, rad.
    pub phase: f32,
}

/// The potential of a motor's magnets; empty if it is not known.
pub type Potential = Vec<Harmonic, MAX_HARMONICS>;

/// The potentials of all motors of a device.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct Potentials(pub [Potential; MAX_JOINTS]);

impl Potentials {
    /// Returns true if no potential is known.
    pub fn is_empty(&self) -> bool {
        self.0.iter().all(Vec::is_empty)
    }

    /// Returns the first joint whose potential a board cannot use on this device.
    pub fn first_unusable_joint(&self, device: &Device<f32>) -> Option<u8> {
        let usable = |(joint, potential): (&Joint<f32>, &Potential)| {
            let most = joint.motor.map_or(0.0, |motor| motor.max_current * motor.torque_constant.abs());
            let torques = potential.iter().map(|harmonic| harmonic.torque(shaft_ratio(joint) as f32).abs());
            let finite = potential.iter().all(|harmonic| harmonic.order > 0 && harmonic.phase.is_finite());
            // Written so that NaN is not usable.
            potential.is_empty() || finite && torques.sum::<f32>() <= MAX_TORQUE_SHARE * most
        };
        let axes = device.axes();
        let joints = device.joints.iter().zip(&self.0).enumerate();
        let unusable = |(i, joint): &(usize, (&Joint<f32>, &Potential))| match *i < axes {
            true => !usable(*joint),
            false => !joint.1.is_empty(),
        };
        joints.into_iter().find(unusable).map(|(i, _)| i as u8)
    }
}

impl Harmonic {
    /// Returns the amplitude of the torque at a joint whose shaft makes `ratio` turns per turn of the joint, N m.
    fn torque(&self, ratio: f32) -> f32 {
        self.energy * f32::from(self.order) * ratio
    }
}

/// Returns the turns of the motor's shaft per turn of the joint.
pub fn shaft_ratio(joint: &Joint<f32>) -> f64 {
    joint.motor.map_or(1.0, |motor| motor.shaft_ratio().into())
}

/// A harmonic of the compensation's torque, amplitude · sin(order θ + phase).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sinusoid {
    order: u32,
    /// Phase at count zero.
    phase: u32,
    /// Amplitude, N m.
    amplitude: f32,
}

/// The compensation of one joint, compiled for the control step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Compensation {
    /// Angle of the shaft per encoder count, in units of a binary angle.
    angle_per_count: u32,
    count: usize,
    sinusoids: [Sinusoid; MAX_HARMONICS],
}

impl Compensation {
    /// Compiles the potential of a joint's motor.
    pub fn new(joint: &Joint<f32>, potential: &Potential) -> Self {
        let ratio = shaft_ratio(joint);
        let units = f64::from(joint.radians_per_count) * ratio * (4_294_967_296.0 / TAU);
        let mut sinusoids = [Sinusoid::default(); MAX_HARMONICS];
        for (sinusoid, harmonic) in sinusoids.iter_mut().zip(potential) {
            let phase = f64::from(harmonic.phase) + f64::from(harmonic.order) * ratio * f64::from(joint.offset);
            *sinusoid = Sinusoid {
                order: harmonic.order.into(),
                phase: BinaryAngle::from_radians(phase).0,
                amplitude: -harmonic.torque(ratio as f32),
            };
        }
        // Rounds to the nearest unit, and wraps negative angles.
        let angle_per_count = (units + if units < 0.0 { -0.5 } else { 0.5 }) as i64 as u32;
        Self { angle_per_count, count: potential.len(), sinusoids }
    }

    /// Returns true if the compensation makes no torque.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Returns the compensation's torque at an encoder count from home's zero, N m.
    #[inline(always)]
    pub fn torque(&self, count: i32) -> f32 {
        let angle = (count as u32).wrapping_mul(self.angle_per_count);
        let mut torque = 0.0;
        for Sinusoid { order, phase, amplitude } in self.sinusoids.iter().take(self.count) {
            let (sine, _) = table_sin_cos(BinaryAngle(order.wrapping_mul(angle).wrapping_add(*phase)));
            torque += amplitude * sine;
        }
        torque
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::motor::{Motor, Winding};

    #[test]
    fn the_compensation_is_the_potentials_slope_and_does_no_net_work_in_a_turn() {
        let winding = Winding::ThreePhase { pole_pairs: 7, ratio: 2.5 };
        let joint = Joint {
            radians_per_count: -(TAU / 40_000.0) as f32,
            offset: 0.3,
            motor: Some(Motor { torque_constant: 0.1, max_current: 2.0, winding, ..Motor::default() }),
            ..Joint::default()
        };
        let harmonics = [(12, 3.0e-4, 0.5), (84, 1.0e-4, -2.0), (168, 2.0e-5, 3.0)];
        let potential: Potential =
            harmonics.into_iter().map(|(order, energy, phase)| Harmonic { order, energy, phase }).collect();
        let compensation = Compensation::new(&joint, &potential);
        let at = |count: i32| f64::from(joint.radians_per_count) * f64::from(count) + f64::from(joint.offset);
        let energy = |q: f64| -> f64 {
            potential
                .iter()
                .map(|h| f64::from(h.energy) * libm::cos(f64::from(h.order) * 2.5 * q + f64::from(h.phase)))
                .sum()
        };
        // A turn of the shaft has 16 000 counts.
        let (mut work, mut absolute) = (0.0, 0.0);
        for count in 0..16_000 {
            let torque = f64::from(compensation.torque(count - 5_000));
            let q = at(count - 5_000);
            let slope = (energy(q + 1e-6) - energy(q - 1e-6)) / 2e-6;
            // The shaft's angle per count is a whole number of units, 2⁻³² turns, so half a unit a count is lost.
            assert!((torque - slope).abs() < 3e-5, "{count}: {torque} N m, not {slope} N m");
            work += torque * f64::from(joint.radians_per_count);
            absolute += (torque * f64::from(joint.radians_per_count)).abs();
        }
        assert!(absolute > 5e-3 && work.abs() < 1e-6 * absolute, "{work} J of {absolute} J");
    }
}
