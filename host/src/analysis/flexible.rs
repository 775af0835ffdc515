//! What is not rigid about a device: transmissions between motors and links, structural modes of the links, and a hand
//! on the tip (docs/model.md section 6), linearised at a pose in continuous time.

use nalgebra::{DMatrix, DVector};

use haptic_bridge::model::description::{Joint, StructuralMode, Transmission};

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
    /// Whether there is any.
    pub fn is_there(&self) -> bool {
        *self != Hand::default()
    }
}

/// What is not rigid about a device at a pose. The default is a rigid device that nobody holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Flexible {
    /// Of each joint; empty where all are rigid.
    pub transmissions: Vec<Option<Transmission>>,
    /// Structural modes, each with its joint.
    pub modes: Vec<(usize, StructuralMode)>,
    /// On the tip.
    pub hand: Hand,
    /// The tip's Jacobian, d x N, m/rad: what the hand moves with.
    pub tip: DMatrix<f64>,
    /// The wall's unit normal, d entries.
    pub normal: DVector<f64>,
}

impl Flexible {
    /// The same with the transmissions and the structural modes of these joints.
    pub fn of_joints(mut self, joints: &[Joint]) -> Self {
        self.transmissions = joints.iter().map(|joint| joint.transmission).collect();
        let modes = joints.iter().enumerate();
        self.modes = modes.flat_map(|(index, joint)| joint.structural_modes().map(move |mode| (index, mode))).collect();
        self
    }

    /// Whether it is all rigid, and in nobody's hand.
    pub fn is_rigid(&self) -> bool {
        !self.hand.is_there() && self.modes.is_empty() && self.transmissions.iter().all(Option::is_none)
    }
}
