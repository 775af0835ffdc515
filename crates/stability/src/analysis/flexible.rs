//! Compliant parts of a device at a pose, linearised in continuous time: transmissions between motors and links,
//! structural modes of the links, and a hand on the tip (docs/model.md section 4).

use haptic_bridge::model::description::{EncoderAt, Joint, StructuralMode, Transmission};
use nalgebra::{DMatrix, DVector};

/// A hand at the tip: a mass, a damper and a spring to a target position, equal in every direction.
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

/// Spring and damper that hold the orientation of a redundant device's last link; `[posture]` in a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posture {
    /// Stiffness, N m/rad.
    pub stiffness: f64,
    /// Damping, N m s/rad.
    pub damping: f64,
}

/// Compliant parts of a device at a pose, with hand and posture control. The default is a free rigid device.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Flexible {
    /// Transmission of each joint; empty if all are rigid.
    pub transmissions: Vec<Option<Transmission>>,
    /// Structural modes, each with the index of its joint.
    pub modes: Vec<(usize, StructuralMode)>,
    /// Hand at the tip.
    pub hand: Hand,
    /// Posture control by the board, with the Jacobian row of the orientation (N entries).
    pub posture: Option<(Posture, DVector<f64>)>,
    /// Jacobian of the tip, d x N, m/rad, for the hand's motion.
    pub tip: DMatrix<f64>,
    /// Unit normal of the wall, d entries.
    pub normal: DVector<f64>,
}

/// Returns the stiffness that a hand feels at rest, N/m: a wall of `stiffness` (N/m) in series with this `compliance`
/// (m/N). Returns `None` if the wall cannot hold a hand at rest because its feed-forward moves the tip into the wall.
#[must_use]
pub fn felt_stiffness(stiffness: f64, compliance: f64) -> Option<f64> {
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

    /// Returns the displacement of the tip by compliant transmissions while the encoders do not move: Σⱼ rowⱼ
    /// torqueⱼ/kⱼ, m/N. `row` is the Jacobian along the direction (m/rad, N entries); `torque` is in N m per newton of
    /// wall (N entries). Joints with the encoder at the link are left out because their wall measures the displacement.
    /// Returns `None` if no other transmission is compliant.
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

    /// Returns true if a motor drives a measured angle through a spring.
    #[must_use]
    pub fn is_sensed_behind_a_spring(&self) -> bool {
        self.transmissions.iter().flatten().any(|transmission| transmission.encoder_at == EncoderAt::Joint)
    }

    /// Returns true if all parts are rigid and no hand holds the device.
    pub fn is_rigid(&self) -> bool {
        !self.hand.is_there() && self.modes.is_empty() && self.transmissions.iter().all(Option::is_none)
    }
}
