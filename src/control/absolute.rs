//! Absolute encoders: the angles in their SPI frames, disturbed frames, and the joint angles at power-on.
//!
//! AS5047 and AS5048 send an angle of 14 bits, an error flag (bit 14) and an even parity (bit 15). The board passes the
//! frames of every crest to [`ControlLoop::read_angles`], which extends the angles to counts like those of incremental
//! encoders. A count is the angle plus complete turns of the magnet; homing selects the turn. After a disturbed frame
//! the joint is assumed to keep its speed.

use super::ControlLoop;
use crate::control::joints::Counts;
use crate::control::program::Program;
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::math::floor_to_i32;
use crate::model::catalogue::MAX_JOINTS;
use crate::model::description::ANGLE_COUNTS;
use crate::safety::fault::Fault;
use crate::safety::refusal::Refusal;
use core::ops::DerefMut;

/// Flag of a frame: the encoder received an invalid command, or cannot measure.
pub const ERROR_FLAG: u16 = 1 << 14;
/// Bit that makes the parity of a frame even.
const PARITY: u16 = 1 << 15;
const ANGLE_MASK: u16 = ANGLE_COUNTS as u16 - 1;
/// Number of disturbed frames in a row that do not turn the motors off.
const TOLERATED_FRAMES: u8 = 2;
/// Number of consistent frames after which a real encoder is read, because a starting chip sends zeros.
const FIRST_FRAMES: u8 = 4;
/// Largest difference of two angles without motion, counts: five times the noise of an AS5047 (0.068 degrees rms) in
/// two angles.
pub(super) const ANGLE_NOISE: i32 = 24;

/// Returns the angle in a frame; `None` if the frame is invalid.
pub fn angle_in(frame: u16) -> Option<u16> {
    (frame & ERROR_FLAG == 0 && frame.count_ones().is_multiple_of(2)).then_some(frame & ANGLE_MASK)
}

/// Returns the frame of an angle, as an encoder sends it.
pub fn frame_of(angle: i32) -> u16 {
    let angle = angle as u16 & ANGLE_MASK;
    if angle.count_ones().is_multiple_of(2) { angle } else { angle | PARITY }
}

/// Returns the smallest motion from a count to an angle, counts.
fn motion_to(angle: u16, count: i32) -> i32 {
    const UNUSED_BITS: u32 = ANGLE_COUNTS.leading_zeros() + 1;
    (i32::from(angle).wrapping_sub(count) << UNUSED_BITS) >> UNUSED_BITS
}

/// The readings of one absolute encoder.
#[derive(Clone, Copy, Debug, Default)]
struct Reading {
    count: i32,
    /// Number of consistent frames, at most [`FIRST_FRAMES`].
    valid_frames: u8,
    /// Number of disturbed frames since the last valid frame.
    disturbed_frames: u8,
}

/// The absolute encoders of all joints.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct AbsoluteEncoders {
    readings: [Reading; MAX_JOINTS],
}

impl AbsoluteEncoders {
    /// Reads all encoders anew, because a joint may have moved unseen.
    pub(super) fn restart(&mut self) {
        self.readings.iter_mut().for_each(|reading| (reading.valid_frames, reading.disturbed_frames) = (0, 0));
    }
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Returns, for each axis, true if its encoder is absolute.
    pub fn absolute_axes(&self) -> [bool; MAX_JOINTS] {
        self.program.as_ref().map_or([false; MAX_JOINTS], |program| program.absolute)
    }

    /// Replaces the counts of the absolute encoders by those of their frames (`None` for a frame that did not come).
    /// Call once at every crest before any other use of the counts.
    pub fn read_angles(&mut self, frames: &[Option<u16>; MAX_JOINTS], counts: &mut Counts) {
        let axes = self.absolute_axes();
        let first_frames = if self.hardware.real { FIRST_FRAMES } else { 1 };
        let mut started = false;
        for i in (0..MAX_JOINTS).filter(|i| axes[*i]) {
            let (joint, reading) = (&mut self.joints[i], &mut self.absolute.readings[i]);
            let moved = frames[i].and_then(angle_in).map(|angle| motion_to(angle, reading.count));
            let explained = moved.filter(|moved| joint.can_move(*moved));
            if reading.valid_frames < first_frames {
                reading.count = reading.count.wrapping_add(moved.unwrap_or(0));
                // The first frame has no predecessor.
                reading.valid_frames =
                    if explained.is_some() { reading.valid_frames + 1 } else { moved.is_some().into() };
                if reading.valid_frames >= first_frames {
                    joint.start_at(reading.count);
                    started = true;
                }
                counts[i] = joint.count();
                continue;
            }
            reading.count = reading.count.wrapping_add(explained.unwrap_or_else(|| joint.expected_motion()));
            counts[i] = reading.count;
            reading.disturbed_frames = if explained.is_some() { 0 } else { reading.disturbed_frames + 1 };
            if reading.disturbed_frames > TOLERATED_FRAMES {
                self.trip(Fault::EncoderFrames, Some(i as u8), frames[i].map_or(-1.0, f32::from));
            }
        }
        if started && self.check_encoders_read().is_ok() {
            self.home_by_angles(counts);
        }
    }

    /// Returns an error if an absolute encoder has not yet sent its angle.
    pub(super) fn check_encoders_read(&self) -> Result<(), Refusal> {
        let is_silent = |i: &usize| self.hardware.real && self.absolute.readings[*i].valid_frames < FIRST_FRAMES;
        match (0..MAX_JOINTS).filter(|i| self.absolute_axes()[*i]).find(is_silent) {
            Some(i) => Err(Refusal::EncoderSilent(i as u8)),
            None => Ok(()),
        }
    }

    /// Homes a device whose absolute encoders tell all joint angles. A device that is not real is in its home pose.
    fn home_by_angles(&mut self, counts: &Counts) {
        let Some(program) = self.program.as_ref().filter(|program| program.homes_itself || !self.hardware.real) else {
            return;
        };
        let q =
            core::array::from_fn(
                |i| if program.absolute[i] { self.absolute_angle(i, program.nearest[i]) } else { 0.0 },
            );
        if let Some(program) = self.program.as_mut() {
            program.controller.home(counts, &q);
            (self.placed, self.homed) = (true, true);
            self.keep_polarity_near_its_home();
            self.set_ranges();
        }
    }

    /// Returns the angle (rad) of joint `i` by its absolute encoder, in the turn of the magnet nearest to `near` (rad).
    pub(super) fn absolute_angle(&self, i: usize, near: f32) -> f32 {
        let Some(program) = self.program.as_ref() else { return near };
        let (scale, angle) = (program.radians_per_count[i], self.absolute.readings[i].count & (ANGLE_COUNTS - 1));
        let at = angle as f32 * scale + program.offsets[i];
        let turn = ANGLE_COUNTS as f32 * scale;
        at + floor_to_i32((near - at) / turn + 0.5) as f32 * turn
    }
}

#[test]
fn frames_hold_angles_and_show_every_single_wrong_bit() {
    for angle in 0..ANGLE_COUNTS {
        let frame = frame_of(angle);
        assert_eq!(angle_in(frame), Some(angle as u16));
        assert!((0..16).all(|bit| angle_in(frame ^ 1 << bit).is_none()), "{frame:#x}");
    }
    assert_eq!((angle_in(0xFFFF), angle_in(0x7FFF)), (None, None));
    assert_eq!((motion_to(2, 16_383), motion_to(16_383, 2 - 16_384), motion_to(5, 5 + 3 * 16_384)), (3, -3, 0));
}
