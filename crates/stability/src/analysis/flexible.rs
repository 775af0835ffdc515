//! The parts of a device that are not rigid: transmissions between motors and links, structural modes of the links, and
//! a hand on the tip (docs/model.md section 4), linearised at a pose in continuous time.

use nalgebra::{DMatrix, DVector};

use haptic_bridge::model::description::{EncoderAt, Joint, StructuralMode, Transmission};

/// A hand as a mass, a damper and a spring to where it wants to be, at the tip and the same in every direction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Hand {
    /// kg
    pub mass: f64,
    /// N s/m
    pub damping: f64,
    /// N/m
    pub stiffness: f64,
}

impl Hand {
    /// Returns true if there is a hand.
    pub fn is_there(&self) -> bool {
        *self != Hand::default()
    }
}

/// The spring and the damper that hold the orientation of a redundant device's last link: a scene's `[posture]` where
/// it is at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posture {
    /// N m/rad
    pub stiffness: f64,
    /// N m s/rad
    pub damping: f64,
}

/// The parts of a device that are not rigid at a pose, and the hand that holds it beside the wall. The default is a
/// rigid device that nothing holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Flexible {
    /// Of each joint; empty where all are rigid.
    pub transmissions: Vec<Option<Transmission>>,
    /// Structural modes, each with its joint.
    pub modes: Vec<(usize, StructuralMode)>,
    /// On the tip.
    pub hand: Hand,
    /// The posture that the board renders, with the row of the orientation's Jacobian, N.
    pub posture: Option<(Posture, DVector<f64>)>,
    /// The tip's Jacobian, d x N, m/rad: what the hand moves with.
    pub tip: DMatrix<f64>,
    /// The wall's unit normal, d entries.
    pub normal: DVector<f64>,
}

/// The stiffness that a hand feels at rest of a wall of `stiffness` (N/m) behind parts of this compliance (m/N): both in
/// series. `None` where the wall holds no hand at rest: the torques of its feed-forward move the tip into it.
#[must_use]
pub fn felt(stiffness: f64, compliance: f64) -> Option<f64> {
    let share = 1.0 + stiffness * compliance;
    (share > 0.0).then(|| stiffness / share)
}

impl Flexible {
    /// The same with the transmissions and the structural modes of these joints.
    pub fn of_joints(mut self, joints: &[Joint]) -> Self {
        self.transmissions = joints.iter().map(|joint| joint.transmission).collect();
        let modes = joints.iter().enumerate();
        self.modes = modes.flat_map(|(index, joint)| joint.structural_modes().map(move |mode| (index, mode))).collect();
        self
    }

    /// How far the transmissions let the tip move along a direction whose Jacobian is `row` (m/rad, N) when the motors,
    /// held where their encoders see them, give `torque` (N m per newton of wall, N): Σⱼ rowⱼ torqueⱼ/kⱼ, m/N. A joint
    /// whose encoder is on the link's side does not count, because its wall sees what the transmission gives. `None`
    /// where nothing gives.
    #[must_use]
    pub fn compliance_at_tip(&self, row: &DVector<f64>, torque: &DVector<f64>) -> Option<f64> {
        let joints = self.transmissions.iter().zip(row.iter().zip(torque.iter()));
        let compliance: f64 = joints
            .filter_map(|(transmission, (lever, torque))| {
                let transmission = transmission.filter(|found| found.encoder_at == EncoderAt::Motor)?;
                Some(lever * torque / transmission.stiffness)
            })
            .sum();
        (compliance != 0.0).then_some(compliance)
    }

    /// Returns true if an encoder sits on the link's side of a transmission that gives: its motor then pushes through a
    /// spring on what it sees.
    #[must_use]
    pub fn is_sensed_behind_a_spring(&self) -> bool {
        self.transmissions.iter().flatten().any(|transmission| transmission.encoder_at == EncoderAt::Joint)
    }

    /// Returns true if everything is rigid and no hand holds the device.
    pub fn is_rigid(&self) -> bool {
        !self.hand.is_there() && self.modes.is_empty() && self.transmissions.iter().all(Option::is_none)
    }
}
