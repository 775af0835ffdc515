//! What goes into a control period and what it leaves behind for telemetry.

use crate::drive::stage::MAX_DUTY;
use crate::model::catalogue::MAX_JOINTS;
use crate::model::mechanism::Regularity;
use crate::safety::fault::{Fault, State};
use crate::servo::joints::{Counts, Currents, Duties, Torques};
use crate::servo::saturation::Asked;

/// A duty as large as this is as large as it can be: the drive's own end, less what rounding may take off it.
const DUTY_END: f32 = MAX_DUTY * (1.0 - 8.0 * f32::EPSILON);

/// What the hardware saw at one sampling instant, a crest of the carrier.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Samples {
    /// Encoder counts.
    pub counts: Counts,
    /// V; ignored where the board does not sense it.
    pub bus_voltage: f32,
    /// Motor currents; ignored where they are not sensed.
    pub currents: Currents,
    /// What two sensors of a motor's current differ by; 0 where it has one.
    pub imbalance: Currents,
    /// Count at the index pulse seen since the last step, late by at most what the joint moved in it.
    pub index: [Option<i32>; MAX_JOINTS],
    /// A fault that hardware or another part of the firmware reports.
    pub fault: Option<(Fault, Option<u8>, f32)>,
}

/// What the scene asks for in a control period, see [`Servo::render`](super::Servo::render).
#[derive(Clone, Copy, Debug, Default)]
pub struct Rendered {
    pub(crate) regularity: Regularity<f32>,
    pub(crate) asked: Asked,
}

/// What one control step decided.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outputs {
    /// Whether the bridges may drive; false means floating.
    pub bridges: bool,
}

/// What the last step left: the servo's working memory.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Now {
    /// Control steps since boot.
    pub step: u32,
    pub counts: Counts,
    /// Joint angles, rad, and velocities, rad/s.
    pub q: [f32; MAX_JOINTS],
    pub qd: [f32; MAX_JOINTS],
    /// Tip, m.
    pub tip: [f32; MAX_JOINTS],
    /// What the motors are to make, after limits.
    pub torque: Torques,
    /// Measured, or commanded where none is sensed.
    pub current: Currents,
    /// Of the carrier period that comes.
    pub duty: Duties,
    /// V; 0 where it is not sensed.
    pub bus_voltage: f32,
    pub walls: AtWalls,
    /// What the limits leave of the walls' force, N.
    pub rendered_force: f32,
    /// See [`StepRecord::limited`].
    pub limited: u8,
}

/// What a step found at the walls, see [`StepRecord`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct AtWalls {
    pub contacts: u8,
    /// m
    pub distance: f32,
    /// m/s
    pub normal_velocity: f32,
    /// N
    pub force: f32,
    pub shaping: f32,
    /// J
    pub energy: f32,
    /// N s/m
    pub passivity_damping: f32,
}

/// One step as telemetry records it. Vectors are padded with zeros to three entries.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepRecord {
    /// Control steps since boot.
    pub step: u32,
    /// The state after this step.
    pub state: State,
    /// Walls touched.
    pub contacts: u8,
    /// Encoder counts.
    pub counts: Counts,
    /// Joint angles, rad.
    pub q: [f32; MAX_JOINTS],
    /// Joint velocities, rad/s.
    pub qd: [f32; MAX_JOINTS],
    /// Tip, m.
    pub tip: [f32; MAX_JOINTS],
    /// Joint torques after limits.
    pub torque: Torques,
    /// Measured currents, or commanded ones where none is sensed.
    pub current: Currents,
    /// Duties of the carrier period after the step.
    pub duty: Duties,
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

impl StepRecord {
    /// The record of a step that left the servo in `state`, field by field: a copy of the whole would be a call of memcpy.
    #[inline(always)]
    pub(crate) fn of(now: &Now, state: State) -> Self {
        let Now { step, counts, q, qd, tip, torque, current, duty, bus_voltage, walls, rendered_force, limited } = *now;
        Self {
            step,
            state,
            contacts: walls.contacts,
            counts,
            q,
            qd,
            tip,
            torque,
            current,
            duty,
            distance: walls.distance,
            normal_velocity: walls.normal_velocity,
            wall_force: walls.force,
            rendered_force,
            limited,
            shaping: walls.shaping,
            energy: walls.energy,
            passivity_damping: walls.passivity_damping,
            bus_voltage,
        }
    }

    /// Whether joint `i` could not do what was asked: 1 a limit changed its torque ([`StepRecord::limited`]), 2 its duty is at
    /// its end, 3 both.
    pub fn saturation(&self, i: usize) -> f32 {
        let end = self.duty.get(i).is_some_and(|duty| duty.abs() >= DUTY_END);
        f32::from(self.limited >> i & 1) + if end { 2.0 } else { 0.0 }
    }
}
