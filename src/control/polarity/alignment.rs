//! The alignment of a three-phase motor before its polarity check: the rotor's electrical angle, the direction and the
//! number of pole pairs, from small swings.
//!
//! A quadrature current in a frame that stands still at the electrical angle φ makes the torque Kₜ i cos(θ - φ), where
//! θ is the electrical angle of the rotor. A swing in this frame measures the cosine. Two frames a quarter turn apart
//! therefore give θ. Two more frames, an eighth of a turn to either side of this θ, correct it: friction lowers both
//! cosines alike. The motor, commutated from there, then moves its joint by less than a quarter electrical turn, where
//! either direction still pushes the joint the same way. The change of θ over the motion of the joint is the electrical
//! ratio with its direction. A second and longer motion measures the ratio well enough to count the pole pairs. If two
//! phases are exchanged, θ falls while the joint turns forward, and every measured θ is half a turn off, because the
//! torque has the other sign.

use crate::control::ControlLoop;
use crate::control::joints::Torques;
use crate::control::polarity::swing::Swing;
use crate::control::program::Program;
use crate::drive::brushless::Frame;
use crate::drive::stage::Stage;
use crate::math::{BinaryAngle, Math, clamp, sqrt};
use crate::safety::fault::Fault;
use core::f32::consts::{FRAC_PI_2, FRAC_PI_4, TAU};
use core::ops::DerefMut;

/// Accepted ratio (lowest, highest) of the torque that acted to the file's torque.
const ACCEPTED_TORQUE_RATIO: (f32, f32) = (0.5, 1.6);
/// Largest swing to either side in a standing frame, electrical rad.
pub(super) const MAX_SWING_ELECTRICAL: f32 = 0.25;
/// Largest correction of the electrical angle after which no further correction follows, rad.
const MAX_LAST_CORRECTION: f32 = 0.06;
/// Share of a correction that is applied, because friction lowers the smaller of two cosines more.
const CORRECTION_SHARE: f32 = 0.7;
/// Largest number of corrections at one place.
const MAX_CORRECTIONS: u8 = 6;
/// Length of the first motion, electrical rad.
const FIRST_MOTION_ELECTRICAL: f32 = 0.4;
/// Largest length of the second motion, electrical rad.
const MAX_MOTION_ELECTRICAL: f32 = 2.0;
/// Largest length of a motion, joint rad.
const MAX_MOTION: f32 = 0.08;
/// Accepted relative difference of the electrical ratio after the first motion, whose length is short.
const FIRST_RATIO_ERROR: f32 = 0.6;
/// Accepted difference of the electrical ratio after the second motion, electrical turns per shaft turn.
const MAX_POLE_PAIR_ERROR: f32 = 0.5;
/// Speed at which the position that pulls the joint moves, rad/s.
const MOTION_SPEED: f32 = 0.1;
/// Distance at which the pull reaches the largest torque of a swing, rad.
const FULL_PULL_DISTANCE: f32 = 0.1;
/// Longest time of a motion, s.
const MAX_MOTION_SECONDS: f32 = 4.0;

/// The present part of an alignment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Part {
    /// Swings in the frame at angle zero.
    #[default]
    Zero,
    /// Swings in the frame a quarter turn ahead.
    Quarter,
    /// Swings in the frame an eighth of a turn behind the estimate.
    Behind,
    /// Swings in the frame an eighth of a turn ahead of the estimate.
    Ahead,
    /// Moves the joint.
    Motion,
}

/// A place at which the electrical angle was measured.
#[derive(Clone, Copy, Debug, Default)]
struct Place {
    /// Joint angle, rad.
    q: f32,
    /// Electrical angle, rad.
    electrical: f32,
}

/// The alignment of one motor.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Alignment {
    part: Part,
    /// Estimate of the electrical angle, rad.
    estimate: f32,
    /// Cosine that the previous swing measured.
    cosine: f32,
    /// Joint angle at which the previous swing took place, rad.
    place: f32,
    corrections: u8,
    /// Place before the motions.
    first: Option<Place>,
    /// Measured electrical ratio, with the sign of the direction.
    ratio: Option<f32>,
    /// Length of the present motion, rad.
    length: f32,
    /// Time in the present motion, s.
    seconds: f32,
    /// True if the motor's frame turns with its rotor from now on.
    done: bool,
}

impl Alignment {
    /// Returns true if a motor's swings take place in a standing frame.
    pub(super) fn is_under_way(&self, stage: &impl Stage) -> bool {
        stage.is_three_phase() && !self.done
    }

    /// Returns true while a swing may find no motion, because its frame may lie across the rotor's field.
    pub(super) fn may_stand_still(&self) -> bool {
        matches!(self.part, Part::Zero | Part::Quarter)
    }

    /// Returns true while the joint moves to another place.
    pub(super) fn moves(&self) -> bool {
        self.part == Part::Motion
    }

    /// Returns the frame of the next swing.
    fn frame(&self) -> Frame {
        let angle = match self.part {
            Part::Zero => 0.0,
            Part::Quarter => FRAC_PI_2,
            Part::Behind => self.estimate - FRAC_PI_4,
            Part::Ahead | Part::Motion => self.estimate + FRAC_PI_4,
        };
        Frame::Fixed(BinaryAngle::from_radians(angle.into()))
    }
}

/// Returns an angle in -π..π that differs by whole turns, rad.
fn principal(angle: f32) -> f32 {
    let turns = angle / TAU;
    let whole = (turns + if turns < 0.0 { -0.5 } else { 0.5 }) as i32;
    angle - whole as f32 * TAU
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Begins the next swing of an alignment. Returns false if the motor needs no alignment.
    pub(super) fn begin_aligning_swing(&mut self) -> bool {
        let i = self.axis();
        if !self.polarity.alignment.is_under_way(&self.joints[i].stage) {
            return false;
        }
        self.joints[i].stage.set_frame(self.polarity.alignment.frame());
        self.begin_first_swing();
        true
    }

    /// Continues an alignment after a swing that measured this cosine.
    pub(super) fn continue_alignment(&mut self, cosine: f32, place: f32) {
        let (axis, alignment) = (Some(self.axis() as u8), &mut self.polarity.alignment);
        let before = core::mem::replace(&mut alignment.cosine, cosine);
        alignment.part = match alignment.part {
            Part::Zero => Part::Quarter,
            Part::Quarter if before == 0.0 && cosine == 0.0 => {
                return self.trip(Fault::PolarityNoMotion, axis, 0.0);
            }
            Part::Quarter => {
                alignment.estimate = libm::atan2f(cosine, before);
                Part::Behind
            }
            Part::Behind => Part::Ahead,
            Part::Ahead | Part::Motion => {
                let place = 0.5 * (alignment.place + place);
                return self.correct_angle(before, cosine, place);
            }
        };
        alignment.place = place;
        self.continue_swings();
    }

    fn continue_swings(&mut self) {
        (self.polarity.swing, self.polarity.part) = (None, 0);
        self.begin_aligning_swing();
    }

    /// Corrects the electrical angle by the cosines in the frames behind and ahead, and goes on if the angle is good.
    fn correct_angle(&mut self, behind: f32, ahead: f32, place: f32) {
        let axis = Some(self.axis() as u8);
        let size = sqrt(behind * behind + ahead * ahead);
        if !(ACCEPTED_TORQUE_RATIO.0..=ACCEPTED_TORQUE_RATIO.1).contains(&size) {
            return self.trip(Fault::TorqueMismatch, axis, size);
        }
        // cos(δ + π/4) behind and cos(δ - π/4) ahead: their difference over their sum is tan δ.
        let correction = CORRECTION_SHARE * libm::atan2f(ahead - behind, ahead + behind);
        let alignment = &mut self.polarity.alignment;
        alignment.estimate = principal(alignment.estimate + correction);
        alignment.corrections += 1;
        if correction.abs() > MAX_LAST_CORRECTION && alignment.corrections < MAX_CORRECTIONS {
            alignment.part = Part::Behind;
            return self.continue_swings();
        }
        alignment.corrections = 0;
        self.finish_place(Place { q: place, electrical: self.polarity.alignment.estimate });
    }

    /// Uses the electrical angle at a place: moves on from the first place, and compares the second with the file.
    fn finish_place(&mut self, place: Place) {
        let (i, alignment) = (self.axis(), &mut self.polarity.alignment);
        let file = self.joints[i].stage.electrical_ratio();
        let Some(first) = alignment.first.replace(place) else {
            return self.begin_motion(place, (FIRST_MOTION_ELECTRICAL / file).min(MAX_MOTION), false);
        };
        let moved = place.q - first.q;
        // After a long motion the angle is known only up to whole turns without the ratio of the first motion.
        let expected = alignment.ratio.map_or(0.0, |ratio| ratio * moved);
        let turned = expected + principal(place.electrical - first.electrical - expected);
        let ratio = turned / moved;
        let (found, relative) = (ratio.abs() * self.joints[i].stage.pole_pairs() / file, ratio.abs() / file - 1.0);
        let is_last = alignment.ratio.is_some();
        let error = if is_last { MAX_POLE_PAIR_ERROR / self.joints[i].stage.pole_pairs() } else { FIRST_RATIO_ERROR };
        // Written so that NaN is an error.
        if !(relative.abs() <= error) {
            return self.trip(Fault::PolePairs, Some(i as u8), found);
        }
        alignment.ratio = Some(ratio.signum() * file);
        if !is_last {
            // Moves back, so that the joint stays near its initial place.
            return self.begin_motion(place, -(MAX_MOTION_ELECTRICAL / file).min(MAX_MOTION), ratio < 0.0);
        }
        self.align(place, ratio < 0.0);
        let alignment = &mut self.polarity.alignment;
        alignment.done = true;
        (self.polarity.swing, self.polarity.part) = (None, 0);
        self.begin_first_swing();
    }

    /// Lets the motor's frame turn with its rotor, from the electrical angle at a place.
    fn align(&mut self, place: Place, reversed: bool) {
        let i = self.axis();
        let Some(program) = self.program.as_ref() else { return };
        let back = (self.polarity.q[i] - place.q) / program.radians_per_count[i];
        let count = self.now.counts[i].wrapping_sub(back as i32);
        self.joints[i].stage.align(BinaryAngle::from_radians(place.electrical.into()), count, reversed);
    }

    fn begin_motion(&mut self, place: Place, length: f32, reversed: bool) {
        self.align(place, reversed);
        let alignment = &mut self.polarity.alignment;
        (alignment.part, alignment.length) = (Part::Motion, length);
        alignment.seconds = 0.0;
        self.polarity.initial = Some(self.polarity.q);
        self.polarity.part = 0;
    }

    /// Runs a step of a motion and returns the torques. `moved` is the joint's motion since its beginning, rad.
    pub(super) fn move_joint(&mut self, moved: f32) -> Torques {
        let i = self.axis();
        let Some(Swing { max_torque, .. }) = self.polarity.swing else { return Torques::default() };
        let alignment = &mut self.polarity.alignment;
        alignment.seconds += self.polarity.step_period;
        let direction = alignment.length.signum();
        let has_arrived = direction * moved >= alignment.length.abs();
        let is_over = alignment.seconds > MAX_MOTION_SECONDS;
        if is_over && direction * moved < 0.5 * alignment.length.abs() {
            self.trip(Fault::PolarityNoMotion, Some(i as u8), moved);
            return Torques::default();
        }
        if has_arrived || is_over {
            alignment.part = Part::Behind;
            if let (Some(first), Some(ratio)) = (alignment.first, alignment.ratio) {
                // The estimate of the second place follows from the ratio of the first motion.
                alignment.estimate = principal(first.electrical + ratio * (self.polarity.q[i] - first.q));
            }
            (self.polarity.swing, self.polarity.inertia) = (None, None);
            self.polarity.wait_seconds = 0.0;
            return Torques::default();
        }
        let pull = direction * MOTION_SPEED * alignment.seconds - moved;
        let stiffness = max_torque / FULL_PULL_DISTANCE;
        let damping = 1.4 * sqrt(stiffness * self.polarity.effective_inertia);
        let wanted = stiffness * pull - damping * self.joints[i].speed();
        self.torques_within_tip_force(clamp(wanted, max_torque))
    }
}
