//! Compliant parts of a device: transmissions between motors and links, structural modes of the links, and a hand on
//! the tip (docs/model.md section 4), linearised at a pose in continuous time.

use nalgebra::{DMatrix, DVector};

use haptic_bridge::model::description::{EncoderAt, Joint, StructuralMode, Transmission};

/// A hand as a mass, a damper and a spring to its target position, at the tip and equal in every direction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Hand {
    /// Mass, kg.
    pub mass: f64,
    /// Damping, N s/m.
    pub damping: f64,
    /// Stiffness, N/m.
    pub stiffness: f64,
}

impl Hand {
    /// Returns true if there is a hand.
    pub fn is_there(&self) -> bool {
        *self != Hand::default()
    }
}

/// Spring and damper that hold the orientation of a redundant device's last link: a scene's `[posture]` at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posture {
    /// Stiffness, N m/rad.
    pub stiffness: f64,
    /// Damping, N m s/rad.
    pub damping: f64,
}

/// Compliant parts of a device at a pose, the hand on its tip and the posture that holds it. The default is a rigid
/// device without hand and posture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Flexible {
    /// Transmission of each joint; empty if all are rigid.
    pub transmissions: Vec<Option<Transmission>>,
    /// Structural modes, each with its joint.
    pub modes: Vec<(usize, StructuralMode)>,
    /// Hand on the tip.
    pub hand: Hand,
    /// The posture that the board renders, with the row of the orientation's Jacobian, N.
    pub posture: Option<(Posture, DVector<f64>)>,
    /// Jacobian of the tip, d x N, m/rad, for the hand's motion.
    pub tip: DMatrix<f64>,
    /// Unit normal of the wall, d entries.
    pub normal: DVector<f64>,
}

/// Returns the stiffness that a hand feels at rest, N/m: that of a wall of `stiffness` (N/m) in series with parts of
/// this `compliance` (m/N). `None` if the wall cannot hold a hand at rest, because the torques of its feed-forward move
/// the tip into it.
#[must_use]
pub fn felt(stiffness: f64, compliance: f64) -> Option<f64> {
    let share = 1.0 + stiffness * compliance;
    (share > 0.0).then(|| stiffness / share)
}

impl Flexible {
    /// Adds the transmissions and the structural modes of these joints.
    pub fn of_joints(mut self, joints: &[Joint]) -> Self {
        self.transmissions = joints.iter().map(|joint| joint.transmission).collect();
        let modes = joints.iter().enumerate();
        self.modes = modes.flat_map(|(index, joint)| joint.structural_modes().map(move |mode| (index, mode))).collect();
        self
    }

    /// Returns the displacement of the tip along a direction with Jacobian `row` (m/rad, N) by the transmissions, while
    /// the motors are held at their encoders and give `torque` (N m per newton of wall, N): Σⱼ rowⱼ torqueⱼ/kⱼ, m/N. A
    /// joint with its encoder on the link's side is left out, because its wall measures that displacement. `None` if
    /// no such transmission is compliant.
    #[must_use]
    pub fn compliance_at_tip(&self, row: &DVector<f64>, torque: &DVector<f64>) -> Option<f64> {
        let joints = self.transmissions.iter().zip(row.iter().zip(torque.iter()));
        let compliance: f64 = joints
            .filter_map(|(transmission, (lever, torque))| {
                let transmission = transmission.filter(|candidate| candidate.encoder_at == EncoderAt::Motor)?;
                Some(lever * torque / transmission.stiffness)
            })
            .sum();
        (compliance != 0.0).then_some(compliance)
    }

    /// Returns true if an encoder is on the link's side of a compliant transmission: its motor then acts through a
    /// spring on the measured angle.
    #[must_use]
    pub fn is_sensed_behind_a_spring(&self) -> bool {
        self.transmissions.iter().flatten().any(|transmission| transmission.encoder_at == EncoderAt::Joint)
    }

    /// Returns true if everything is rigid and no hand holds the device.
    pub fn is_rigid(&self) -> bool {
        !self.hand.is_there() && self.modes.is_empty() && self.transmissions.iter().all(Option::is_none)
    }
}
