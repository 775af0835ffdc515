//! The seam between joint torques and the legs of a board's bridges: what one motor of a kind makes of a torque.
//!
//! [`brushed::Axis`](super::brushed::Axis) is the one that ships. An amplifier that takes a current as its set-point, or a
//! field-oriented motor with a sample for each phase and a duty for each leg, is another one: the servo holds its limits,
//! its watch and its thermal budget to whatever stands here (tests/stages.rs has a toy of each).

use super::bits::margin_bits_between;
use crate::math::limited;
use crate::model::motor::Motor;
use core::fmt::Debug;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Largest |duty|: each leg stays within 0.04 to 0.96, which keeps bootstrap capacitors charged and leaves the
/// low-side shunts conducting long enough to be sampled.
pub const MAX_DUTY: f32 = 0.92;

/// The way one board drives its motors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Bridge {
    /// Carrier frequency, Hz; the current loop runs once a period.
    pub carrier_hz: f32,
    /// Dead time between the switches of a leg, s.
    pub dead_time: f32,
    /// Bandwidth of the loop that takes out what the model of the winding leaves, where current is sensed, Hz.
    pub bandwidth_hz: f32,
    /// True if the motors' currents are measured.
    pub current_sensed: bool,
}

/// The voltage across a motor, as a signed share of the bus voltage: never more than [`MAX_DUTY`], and never NaN.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Duty(pub(super) f32);

impl Duty {
    /// The nearest to a share; none for what is not finite.
    pub fn nearest(share: f32) -> Self {
        Self(limited(share, MAX_DUTY))
    }
}

impl From<Duty> for f32 {
    #[inline(always)]
    fn from(duty: Duty) -> Self {
        duty.0
    }
}

/// Bus voltages that are believed, V.
pub const BUS_VOLTAGE: (f32, f32) = (1.0, 1.0e3);

/// The supply of all motors in a carrier period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Supply {
    /// Bus voltage, V.
    pub volts: f32,
    /// Duty for each volt, 1/V.
    pub inverse: f32,
}

impl Supply {
    /// That of a bus voltage, V.
    #[inline(always)]
    pub fn of(volts: f32) -> Self {
        Self { volts, inverse: 1.0 / volts }
    }

    /// Returns true if its voltage can be believed.
    #[inline(always)]
    pub(crate) fn is_usable(&self) -> bool {
        margin_bits_between(self.volts, BUS_VOLTAGE) >= 0
    }
}

/// One motor behind its power stage.
pub trait Stage: Copy + Debug + Default {
    /// The board's samples of one motor at each crest: a current (A), or one for each phase, with an angle.
    type Sample: Copy + Debug + Default;
    /// The command to the legs of one motor until the next crest: a duty, or one for each leg. The default is no
    /// voltage.
    type Drive: Copy + Debug + Default;

    /// A motor on a bridge, allowed at most `max_current`, A (the smaller of this and the motor's own counts).
    fn new(motor: &Motor<f32>, bridge: &Bridge, max_current: f32) -> Self;

    /// Sets the current that is allowed, A; the motor's own limit still counts.
    fn limit(&mut self, max_current: f32);

    /// The limit, A.
    fn max_current(&self) -> f32;

    /// The motor's own limit, A.
    fn motor_current(&self) -> f32 {
        self.max_current()
    }

    /// Torque at the limit, N m.
    fn max_torque(&self) -> f32;

    /// The torque (N m) that a current (A) makes.
    fn torque_of(&self, current: f32) -> f32;

    /// The current that is asked for, A.
    fn asked(&self) -> f32;

    /// Takes the joint torque (N m) of this control step and asks for its current, after the limit. What is not finite
    /// asks for nothing.
    fn command(&mut self, torque: f32);

    /// [`Stage::command`] of a torque that is some roundings within [`Stage::max_torque`].
    #[inline(always)]
    fn command_within(&mut self, torque: f32) {
        self.command(torque);
    }

    /// The drive of the legs over the next carrier period, from the supply, the samples and the joint's speed (rad/s),
    /// filtered so that a count does not push. Call once a carrier period. The period begins at the valley half a
    /// period after the sample or, where that is too soon (`late`), at the crest after it, and lasts until the next
    /// drive applies.
    fn drive(&mut self, supply: &Supply, sample: Self::Sample, speed: f32, late: bool) -> Self::Drive;

    /// [`Stage::drive`] with a usable supply, where that is soon done; else `None`, and nothing is changed.
    #[inline(always)]
    fn drive_easily(&mut self, supply: &Supply, sample: Self::Sample, speed: f32, late: bool) -> Option<Self::Drive> {
        Some(self.drive(supply, sample, speed, late))
    }

    /// Sums up what the last drive from this bus voltage (V) showed: the speed that it was given and the joint's filtered
    /// one and the one as it is, rad/s. Call at the valley after it.
    fn settle(&mut self, _bus_voltage: f32, _given: f32, _speed: f32, _raw: f32) {}

    /// The current (A) that the back-EMF at a speed (rad/s) drives through the motor alone.
    fn driven_by(&self, _speed: f32) -> f32 {
        0.0
    }

    /// The share of the bus voltage that stands across the motor then, signed: for telemetry.
    fn duty(drive: Self::Drive) -> f32;

    /// The winding's resistance (Ω) shown by a voltage (V) and a current (A) that alternate at `rate` (rad/s), as the
    /// joint's angle (rad) does, each given as its parts in phase with a reference and a quarter of a turn later; and
    /// the expected resistance. `None` if they show none.
    fn resistance_of(
        &self,
        _voltage: [f32; 2],
        _current: [f32; 2],
        _angle: [f32; 2],
        _rate: f32,
    ) -> Option<(f32, f32)> {
        None
    }

    /// Forgets the loop's state when the bridge goes off.
    fn rest(&mut self);

    /// Goes on where the stage that this one replaces stands: loading a scene does not stop the current that flows.
    fn inherit(&mut self, other: &Self);

    /// Volts by which the motor at this current and speed differs from the one in the device file, from where on it is
    /// looked at ([`Stage::doubt_from`]), and the most that it may differ by. A stage without a model of its motor doubts
    /// nothing.
    fn strain(&self) -> (f32, f32, f32) {
        (0.0, f32::INFINITY, f32::INFINITY)
    }

    /// A motor whose volts tell a torque (N m) that its current does not is looked at from now on.
    fn doubt_from(&mut self, _torque: f32) {}

    /// The current (A) that the motor's volts tell, whatever its sensor shows.
    fn told_by_volts(&self) -> f32 {
        0.0
    }

    /// The winding was measured to have so many ohms.
    fn know_resistance(&mut self, _ohms: f32) {}

    /// Returns true if the measured current is about what a sound motor would have.
    fn flows_as_expected(&self) -> bool {
        false
    }

    /// The speed (rad/s) whose back-EMF would be so many volts.
    fn turning(&self, _volts: f32) -> f32 {
        0.0
    }

    /// The least speed (rad/s) that a duty at a bus voltage (V) and a current (A) tells.
    fn speed_of(&self, _duty: f32, _bus_voltage: f32, _current: f32) -> f32 {
        0.0
    }
}
