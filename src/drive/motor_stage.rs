//! The motor stage of a board, for any motor that a device file describes.

use super::brushed::Axis;
use super::brushless::ThreePhase;
use super::stage::{Bridge, Duty, Frame, Stage, Supply};
use crate::math::BinaryAngle;
use crate::model::motor::Motor;

/// A brushed motor, or a three-phase motor whose quadrature axis makes the torque.
///
/// The brushed axis comes first, so that a crest reaches it as if it were alone.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub struct MotorStage {
    axis: Axis,
    three_phase: Option<ThreePhase>,
}

/// The command to the legs of one motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotorDrive {
    /// The voltage between the first two legs.
    Bridge(Duty),
    /// The voltages of three legs.
    ThreePhase {
        /// Duty of each leg, 0 to 1.
        legs: [f32; 3],
        /// Quadrature voltage as a share of the bus voltage.
        share: f32,
    },
}

impl Default for MotorDrive {
    fn default() -> Self {
        Self::Bridge(Duty::default())
    }
}

impl Stage for MotorStage {
    type Sample = f32;
    type Drive = MotorDrive;

    fn new(motor: &Motor<f32>, bridge: &Bridge, max_current: f32) -> Self {
        let (axis, three_phase) = (Axis::new(motor, bridge, max_current), ThreePhase::new(motor, bridge, max_current));
        Self { axis: if three_phase.is_some() { axis.without_dead_time() } else { axis }, three_phase }
    }

    fn set_encoder(&mut self, radians_per_count: f32) {
        if let Some(three_phase) = &mut self.three_phase {
            three_phase.set_encoder(radians_per_count);
        }
    }

    fn electrical_ratio(&self) -> f32 {
        self.three_phase.map_or(1.0, |three_phase| three_phase.electrical_ratio())
    }

    fn pole_pairs(&self) -> f32 {
        self.three_phase.map_or(1.0, |three_phase| three_phase.pole_pairs())
    }

    fn set_frame(&mut self, frame: Frame) {
        if let Some(three_phase) = &mut self.three_phase {
            three_phase.set_frame(frame);
        }
    }

    fn align(&mut self, electrical: BinaryAngle, count: i32, reversed: bool) {
        if let Some(three_phase) = &mut self.three_phase {
            three_phase.align(electrical, count, reversed);
        }
    }

    fn assume_alignment(&mut self, offset: f32) {
        if let Some(three_phase) = &mut self.three_phase {
            three_phase.assume_alignment(offset);
        }
    }

    fn is_three_phase(&self) -> bool {
        self.three_phase.is_some()
    }

    fn is_aligned(&self) -> bool {
        self.three_phase.is_none_or(|three_phase| three_phase.is_aligned())
    }

    fn read(&mut self, current: f32, imbalance: f32, count: i32) -> (f32, f32) {
        match &mut self.three_phase {
            None => (current, imbalance),
            Some(three_phase) => three_phase.read(current, imbalance, count),
        }
    }

    fn limit(&mut self, max_current: f32) {
        self.axis.limit(max_current);
        if let Some(three_phase) = &mut self.three_phase {
            three_phase.limit(max_current);
        }
    }

    fn max_current(&self) -> f32 {
        self.axis.max_current()
    }

    fn motor_current(&self) -> f32 {
        self.axis.motor_current()
    }

    fn max_torque(&self) -> f32 {
        self.axis.max_torque()
    }

    #[inline(always)]
    fn torque_of(&self, current: f32) -> f32 {
        self.axis.torque_of(current)
    }

    fn target_current(&self) -> f32 {
        self.axis.target_current()
    }

    #[inline(always)]
    fn command(&mut self, torque: f32) {
        self.axis.command(torque);
    }

    #[inline(always)]
    fn command_within(&mut self, torque: f32) {
        self.axis.command_within(torque);
    }

    fn drive(&mut self, supply: &Supply, sample: f32, speed: f32, late: bool) -> MotorDrive {
        match &mut self.three_phase {
            Some(three_phase) if supply.is_usable() => {
                if !three_phase.has_frame() {
                    self.axis.command(0.0);
                }
                let (legs, share) = three_phase.drive(&mut self.axis, supply, sample, speed, late);
                MotorDrive::ThreePhase { legs, share }
            }
            Some(three_phase) => {
                three_phase.rest();
                self.axis.rest();
                MotorDrive::ThreePhase { legs: [0.5; 3], share: 0.0 }
            }
            None => MotorDrive::Bridge(self.axis.drive(supply, sample, speed, late)),
        }
    }

    #[inline(always)]
    fn drive_in_range(&mut self, supply: &Supply, sample: f32, speed: f32, late: bool) -> Option<MotorDrive> {
        self.axis.drive_in_range(supply, sample, speed, late).map(MotorDrive::Bridge)
    }

    #[inline(always)]
    fn settle(&mut self, bus_voltage: f32, given: f32, speed: f32, raw: f32) {
        let Some(three_phase) = &mut self.three_phase else {
            return self.axis.settle(bus_voltage, given, speed, raw);
        };
        three_phase.settle(bus_voltage);
        // A frame that stands still is driven without the back-EMF.
        let given = if let Frame::Rotor(_) = three_phase.frame() { given } else { 0.0 };
        self.axis.settle(bus_voltage, given, speed, raw);
    }

    fn back_emf_current(&self, speed: f32) -> f32 {
        self.axis.back_emf_current(speed)
    }

    #[inline(always)]
    fn duty(drive: MotorDrive) -> f32 {
        match drive {
            MotorDrive::Bridge(duty) => duty.into(),
            MotorDrive::ThreePhase { share, .. } => share,
        }
    }

    fn resistance_of(&self, voltage: [f32; 2], current: [f32; 2], angle: [f32; 2], rate: f32) -> Option<(f32, f32)> {
        self.axis.resistance_of(voltage, current, angle, rate)
    }

    fn rest(&mut self) {
        self.axis.rest();
        if let Some(three_phase) = &mut self.three_phase {
            three_phase.rest();
        }
    }

    fn inherit(&mut self, other: &Self) {
        self.axis.inherit(&other.axis);
        if let (Some(three_phase), Some(other)) = (&mut self.three_phase, &other.three_phase) {
            three_phase.inherit(other);
        }
    }

    /// Returns the strain of the direct axis of a three-phase motor if it is above its bound.
    #[inline(always)]
    fn strain(&self) -> (f32, f32, f32) {
        if let Some(three_phase) = &self.three_phase {
            let (strain, most) = three_phase.direct_strain(self.axis.emf_tolerance());
            if strain.abs() > most {
                return (strain, most, most);
            }
        }
        self.axis.strain()
    }

    fn inspect_above(&mut self, torque: f32) {
        self.axis.inspect_above(torque);
    }

    fn current_from_voltage(&self) -> f32 {
        self.axis.current_from_voltage()
    }

    fn set_measured_resistance(&mut self, ohms: f32) {
        self.axis.set_measured_resistance(ohms);
        if let Some(three_phase) = &mut self.three_phase {
            three_phase.set_measured_resistance(ohms);
        }
    }

    fn has_expected_current(&self) -> bool {
        self.axis.has_expected_current()
    }

    fn speed_of_back_emf(&self, volts: f32) -> f32 {
        self.axis.speed_of_back_emf(volts)
    }

    #[inline(always)]
    fn least_speed(&self, duty: f32, bus_voltage: f32, current: f32) -> f32 {
        self.axis.least_speed(duty, bus_voltage, current)
    }
}
