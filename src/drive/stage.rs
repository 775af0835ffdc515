//! The motor stage: the interface between joint torques and the legs of a board's bridges.
//!
//! Boards use the stage [`MotorStage`](super::motor_stage::MotorStage). The control loop applies its limits, checks and
//! thermal budget to any stage, such as an amplifier with a current set-point (tests/stages.rs).

use super::bits::margin_bits_between;
use crate::math::{BinaryAngle, clamp};
use crate::model::motor::Motor;
use core::fmt::Debug;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Largest |duty|. Each leg stays within 0.04 to 0.96, so that bootstrap capacitors stay charged and the low-side
/// shunts conduct for long enough to be sampled.
pub const MAX_DUTY: f32 = 0.92;

/// Properties of a board's bridges.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Bridge {
    /// Carrier frequency, Hz; the current loop runs once per carrier period.
    pub carrier_hz: f32,
    /// Dead time between the switches of a leg, s.
    pub dead_time: f32,
    /// Bandwidth of the loop that corrects the error of the winding model, Hz; used if current is sensed.
    pub bandwidth_hz: f32,
    /// True if the motors' currents are measured.
    pub current_sensed: bool,
    /// Number of legs of each motor's bridge: 2 for brushed motors only, or 3.
    pub legs: u8,
}

/// The voltage across a motor, as a signed share of the bus voltage of at most [`MAX_DUTY`], never NaN.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Duty(pub(super) f32);

impl Duty {
    /// Returns the duty nearest to `share`; zero if `share` is not finite.
    pub fn nearest(share: f32) -> Self {
        Self(clamp(share, MAX_DUTY))
    }
}

impl From<Duty> for f32 {
    #[inline(always)]
    fn from(duty: Duty) -> Self {
        duty.0
    }
}

/// Range of plausible bus voltages, V.
pub const BUS_VOLTAGE: (f32, f32) = (1.0, 1.0e3);

/// The supply of all motors during a carrier period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Supply {
    /// Bus voltage, V.
    pub volts: f32,
    /// Duty per volt, 1/V.
    pub inverse: f32,
}

impl Supply {
    /// Makes the supply for a bus voltage, V.
    #[inline(always)]
    pub fn of(volts: f32) -> Self {
        Self { volts, inverse: 1.0 / volts }
    }

    #[inline(always)]
    pub(crate) fn is_usable(&self) -> bool {
        margin_bits_between(self.volts, BUS_VOLTAGE) >= 0
    }
}

/// The frame of the two current loops of a three-phase motor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Frame {
    /// The electrical angle of the rotor is not known, so the motor receives no current.
    #[default]
    Unknown,
    /// The frame stands still at this angle, for the alignment of the motor.
    Fixed(BinaryAngle),
    /// The frame turns with the rotor, and has this angle at count zero of the encoder.
    Rotor(BinaryAngle),
}

/// One motor and its power stage.
pub trait Stage: Copy + Debug + Default {
    /// The board's samples of one motor at a crest: a current (A), or one current for each phase and an angle.
    type Sample: Copy + Debug + Default;
    /// Command to the legs of one motor until the next crest: a duty, or one for each leg. The default is no voltage.
    type Drive: Copy + Debug + Default;
    /// Makes the stage of a motor. The current limit is the smaller of `max_current` (A) and the motor's own limit.
    fn new(motor: &Motor<f32>, bridge: &Bridge, max_current: f32) -> Self;
    /// Sets the joint's angle per encoder count, rad.
    fn set_encoder(&mut self, _radians_per_count: f32) {}

    /// Returns true if the motor has three phases. Such a stage is read by [`Stage::read`] and driven by
    /// [`Stage::drive`], not by [`Stage::drive_in_range`].
    #[inline(always)]
    fn is_three_phase(&self) -> bool {
        false
    }

    /// Returns the electrical turns per turn of the joint of a three-phase motor, positive.
    fn electrical_ratio(&self) -> f32 {
        1.0
    }

    /// Returns the number of pole pairs of a three-phase motor.
    fn pole_pairs(&self) -> f32 {
        1.0
    }

    /// Returns true for a brushed motor, and for a three-phase motor whose frame turns with its rotor.
    fn is_aligned(&self) -> bool {
        true
    }

    /// Sets the frame in which a three-phase motor receives its current.
    fn set_frame(&mut self, _frame: Frame) {}

    /// Lets the frame of a three-phase motor turn with its rotor, which has this electrical angle at a count. `reversed`
    /// if the electrical angle falls while the joint's angle grows.
    fn align(&mut self, _electrical: BinaryAngle, _count: i32, _reversed: bool) {}

    /// Assumes that the electrical angle of a three-phase motor is zero where its joint's angle is zero. `offset` is the
    /// joint's angle at count zero, rad. Only for simulated motors.
    fn assume_alignment(&mut self, _offset: f32) {}

    /// Returns the current that makes torque and the error of all other current, A, from half the difference and the
    /// sum of the currents of the bridge's first two legs at an encoder count. For a brushed motor these are its current
    /// and the difference of two sensors.
    #[inline(always)]
    fn read(&mut self, half_difference: f32, sum: f32, _count: i32) -> (f32, f32) {
        (half_difference, sum)
    }

    /// Sets the current limit, A; the motor's own limit still applies.
    fn limit(&mut self, max_current: f32);
    /// Returns the current limit, A.
    fn max_current(&self) -> f32;

    /// Returns the motor's own current limit, A.
    fn motor_current(&self) -> f32 {
        self.max_current()
    }

    /// Returns the torque at the current limit, N m.
    fn max_torque(&self) -> f32;
    /// Returns the torque (N m) of a current (A).
    fn torque_of(&self, current: f32) -> f32;
    /// Returns the target current, A.
    fn target_current(&self) -> f32;
    /// Sets the target current for a joint torque (N m), within the limit; zero if the torque is not finite.
    fn command(&mut self, torque: f32);

    /// Sets the target current for a torque that is below [`Stage::max_torque`] by more than a few rounding errors.
    #[inline(always)]
    fn command_within(&mut self, torque: f32) {
        self.command(torque);
    }

    /// Returns the drive of the legs for the next carrier period from the supply, the samples and the joint's speed
    /// (rad/s), which must be filtered so that a single count does not push. Call once per carrier period. The drive
    /// begins at the next valley, or if `late` at the following crest, and lasts until the next drive.
    fn drive(&mut self, supply: &Supply, sample: Self::Sample, speed: f32, late: bool) -> Self::Drive;

    /// Returns [`Stage::drive`] with a usable supply. Returns `None` and changes nothing if a limit applies.
    #[inline(always)]
    fn drive_in_range(&mut self, supply: &Supply, sample: Self::Sample, speed: f32, late: bool) -> Option<Self::Drive> {
        Some(self.drive(supply, sample, speed, late))
    }

    /// Updates the motor model after a drive at this bus voltage (V), with the speed that the drive used, the joint's
    /// filtered speed and its unfiltered speed (rad/s). Call at the valley after the drive.
    fn settle(&mut self, _bus_voltage: f32, _given: f32, _speed: f32, _raw: f32) {}

    /// Returns the current (A) that the back-EMF at a speed (rad/s) drives through a short-circuited motor.
    fn back_emf_current(&self, _speed: f32) -> f32 {
        0.0
    }

    /// Returns the voltage across the motor during `drive` as a signed share of the bus voltage, for telemetry.
    fn duty(drive: Self::Drive) -> f32;

    /// Returns the measured and the expected resistance of the winding, Ω; `None` if it cannot be computed. Voltage
    /// (V), current (A) and joint angle (rad) alternate at `rate` (rad/s) and are given as the part in phase with a
    /// reference and the part a quarter period later.
    fn resistance_of(
        &self,
        _voltage: [f32; 2],
        _current: [f32; 2],
        _angle: [f32; 2],
        _rate: f32,
    ) -> Option<(f32, f32)> {
        None
    }

    /// Clears the loop's state when the bridge is switched off.
    fn rest(&mut self);
    /// Takes over the state of the previous stage, so that loading a scene does not interrupt the current.
    fn inherit(&mut self, other: &Self);

    /// Returns three voltages: the difference of the motor from the device file's model at this current and speed, the
    /// difference above which the motor is inspected ([`Stage::inspect_above`]), and the tolerance (infinite without a
    /// model), V.
    fn strain(&self) -> (f32, f32, f32) {
        (0.0, f32::INFINITY, f32::INFINITY)
    }

    /// Sets the difference between voltage and current, expressed as torque, above which the motor is inspected, N m.
    fn inspect_above(&mut self, _torque: f32) {}

    /// Returns the motor's current as computed from its voltage, A.
    fn current_from_voltage(&self) -> f32 {
        0.0
    }

    /// Takes over the measured resistance of the winding, Ω.
    fn set_measured_resistance(&mut self, _ohms: f32) {}

    /// Returns true if the measured current is about the current of a sound motor.
    fn has_expected_current(&self) -> bool {
        false
    }

    /// Returns the speed (rad/s) at which the back-EMF is `volts`.
    fn speed_of_back_emf(&self, _volts: f32) -> f32 {
        0.0
    }

    /// Returns the lowest speed (rad/s) that is consistent with a duty, a bus voltage (V) and a current (A).
    fn least_speed(&self, _duty: f32, _bus_voltage: f32, _current: f32) -> f32 {
        0.0
    }
}
