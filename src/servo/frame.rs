//! What goes into a control period and what it leaves behind for telemetry.

use crate::drive::stage::MAX_DUTY;
use crate::model::catalogue::MAX_JOINTS;
use crate::safety::fault::{Fault, State};

/// A duty as large as this is as large as it can be: the drive's own end, less what rounding may take off it.
const DUTY_END: f32 = MAX_DUTY * (1.0 - 8.0 * f32::EPSILON);

/// What the hardware saw at one sampling instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Samples {
    /// Encoder counts, extended to 32 bits, wrapping.
    pub counts: [i32; MAX_JOINTS],
    /// V; ignored where the board does not sense it.
    pub bus_voltage: f32,
    /// Motor currents, A; ignored where they are not sensed.
    pub currents: [f32; MAX_JOINTS],
    /// Count at the index pulse seen since the last step, late by at most what the joint moved in it.
    pub index: [Option<i32>; MAX_JOINTS],
    /// A fault that hardware or another part of the firmware reports.
    pub fault: Option<(Fault, Option<u8>, f32)>,
}

/// What is sampled at every crest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Crest {
    /// Encoder counts, extended to 32 bits, wrapping.
    pub counts: [i32; MAX_JOINTS],
    /// V; ignored where the board does not sense it.
    pub bus_voltage: f32,
    /// Motor currents, A; ignored where they are not sensed.
    pub currents: [f32; MAX_JOINTS],
    /// What two sensors of a motor's current differ by, A; 0 where it has one.
    pub imbalance: [f32; MAX_JOINTS],
}

impl From<&Samples> for Crest {
    fn from(samples: &Samples) -> Self {
        let Samples { counts, bus_voltage, currents, .. } = *samples;
        Self { counts, bus_voltage, currents, imbalance: [0.0; MAX_JOINTS] }
    }
}

/// What one control step decided.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outputs {
    /// Whether the bridges may drive; false means floating.
    pub bridges: bool,
}

/// One step as telemetry records it. Vectors are padded with zeros to three entries.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Frame {
    /// Control steps since boot.
    pub step: u32,
    /// The state after this step.
    pub state: State,
    /// Walls touched.
    pub contacts: u8,
    /// Encoder counts.
    pub counts: [i32; MAX_JOINTS],
    /// Joint angles, rad.
    pub q: [f32; MAX_JOINTS],
    /// Joint velocities, rad/s.
    pub qd: [f32; MAX_JOINTS],
    /// Tip, m.
    pub tip: [f32; MAX_JOINTS],
    /// Joint torques after limits, N m.
    pub torque: [f32; MAX_JOINTS],
    /// Measured currents, or commanded ones where none is sensed, A.
    pub current: [f32; MAX_JOINTS],
    /// Duties of the last carrier period.
    pub duty: [f32; MAX_JOINTS],
    /// Distance to the deepest wall, m.
    pub distance: f32,
    /// Velocity along its normal, m/s.
    pub normal_velocity: f32,
    /// Sum of the forces that the walls ask for, N.
    pub wall_force: f32,
    /// What the limits leave of it along the normal of the deepest wall, N (docs/telemetry.md). Zero unless armed.
    pub rendered_force: f32,
    /// A bit for every joint that a limit gave another torque than was asked: its own limit of torque or current,
    /// another joint's, or that of the force at the tip, because all are cut by one factor.
    pub limited: u8,
    /// Share of the feed-forward that acts.
    pub shaping: f32,
    /// Energy the touched walls have taken up since contact began, less what they had given out by then (negative:
    /// given out), J.
    pub energy: f32,
    /// Damping the passivity controller added, N s/m.
    pub passivity_damping: f32,
    /// V
    pub bus_voltage: f32,
}

impl Frame {
    /// Whether joint `i` could not do what was asked: 1 a limit changed its torque ([`Frame::limited`]), 2 its duty is at
    /// its end, 3 both.
    pub fn saturation(&self, i: usize) -> f32 {
        let end = self.duty.get(i).is_some_and(|duty| duty.abs() >= DUTY_END);
        f32::from(self.limited >> i & 1) + if end { 2.0 } else { 0.0 }
    }
}
