//! The alignment of a three-phase motor before its polarity check: the rotor's electrical angle, the direction and the
//! number of pole pairs, from small motions.
//!
//! A quadrature current in a frame that stands still at the electrical angle φ makes a field at the angle φ + π/2 and the
//! torque Kₜ i cos(θ - φ), where θ is the electrical angle of the rotor. A swing in this frame measures the cosine. Two
//! frames a quarter turn apart therefore give θ roughly. The field then turns slowly from there, ahead and back, and the
//! rotor follows. Friction holds the rotor behind the field in either direction, so the mean of both directions is the
//! rotor's angle. The field's angle over the joint's angle is the electrical ratio, negative if two phases are exchanged.
//! Exchanged phases also change the sign of the torque, so the rough θ is then half a turn off, the field repels the
//! rotor, and turns by half a turn as soon as the rotor has fallen away too far.

use crate::control::ControlLoop;
use crate::control::joints::Torques;
use crate::control::program::Program;
use crate::drive::stage::{Frame, Stage};
use crate::math::{BinaryAngle, Math, Real};
use crate::safety::fault::Fault;
use core::f32::consts::{FRAC_PI_2, PI};
use core::ops::DerefMut;

/// Largest swing to either side in a standing frame, electrical rad.
pub(super) const MAX_SWING_ELECTRICAL: f32 = 0.25;
/// Torque that pulls the rotor towards the field, as a ratio to the torque that moved the joint in a swing.
const PULL_FRICTION_RATIO: f32 = 2.5;
/// The same ratio until the rotor moves, so that a rotor that is repelled does not fall fast.
const FIRST_PULL_FRICTION_RATIO: f32 = 1.5;
/// Smallest tip force of the pull, N.
const MIN_PULL_FORCE: f32 = 0.15;
/// Largest tip force of the pull, N.
const MAX_PULL_FORCE: f32 = 0.8;
/// Time in which the pull grows, s.
const GROWTH_SECONDS: f32 = 0.1;
/// Speed of the joint behind the field, rad/s.
const FOLLOWING_SPEED: f32 = 0.1;
/// Angle of the field until the pull is complete, rad.
const FIRST_FIELD: f32 = 1.2;
/// Motion of the joint to either side, rad, and the largest such motion, electrical rad.
const MOTION: f32 = 0.08;
const MAX_MOTION_ELECTRICAL: f32 = 2.0;
/// Angle that the field turns in addition, because the rotor stays behind, rad.
const LAG_ELECTRICAL: f32 = 0.5;
/// Angle by which only a rotor that is repelled moves within about [`FALL_SECONDS`], electrical rad.
const MIN_FALL: f32 = 1.2;
/// Time constant of the mean from which a fall is measured, s.
const FALL_SECONDS: f32 = 0.15;
/// Motion of the joint after which a direction ends early, rad, but at least this electrical angle.
const MAX_MOTION: (f32, f32) = (0.12, 2.6);
/// Largest distance of the joint from its initial angle, rad, but at least this electrical angle.
const MAX_ALIGNING_ANGLE: (f32, f32) = (0.2, 3.0);
/// Motion after which the joint follows in a new direction, rad, but at least two counts.
const MIN_FOLLOWED_ANGLE: f32 = 0.004;
/// Accepted difference of the measured ratio, electrical turns per shaft turn.
const MAX_POLE_PAIR_ERROR: f32 = 0.5;

/// The present part of an alignment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Part {
    /// Swings in the frame at angle zero.
    #[default]
    Zero,
    /// Swings in the frame a quarter turn ahead.
    Quarter,
    /// The field turns ahead with a small torque.
    Pull,
    /// The field turns ahead with the complete torque.
    Ahead,
    /// The field turns back, past its first angle.
    Back,
    /// The field turns ahead to its first angle.
    Return,
}

/// Sums for the straight line through points (joint angle, angle of the field), rad.
#[derive(Clone, Copy, Debug, Default)]
struct Line {
    points: f32,
    q: f32,
    field: f32,
    q_squared: f32,
    q_field: f32,
}

impl Line {
    fn add(&mut self, q: f32, field: f32) {
        self.points += 1.0;
        self.q += q;
        self.field += field;
        self.q_squared += q * q;
        self.q_field += q * field;
    }

    /// Returns the variance of the joint angle and its covariance with the field, times the number of points.
    fn moments(&self) -> (f32, f32) {
        let mean = self.q / self.points.max(1.0);
        (self.q_squared - mean * self.q, self.q_field - mean * self.field)
    }

    /// Returns the angle of the field at joint angle zero on a line of this slope.
    fn offset(&self, slope: f32) -> f32 {
        (self.field - slope * self.q) / self.points.max(1.0)
    }
}

/// The alignment of one motor.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Alignment {
    part: Part,
    /// Cosine that the first swing measured.
    cosine: f32,
    /// Smallest torque that moved the joint in a swing, N m.
    breakaway_torque: Option<f32>,
    /// Torque that pulls the rotor towards the field, N m: at first, and complete.
    torques: [f32; 2],
    /// First electrical angle of the field, rad.
    first: f32,
    /// Angle of the field from its first angle, rad.
    field: f32,
    /// Joint angle from the initial angle at which the present direction began, rad.
    turned_at: f32,
    /// Mean joint angle from the initial angle over about [`FALL_SECONDS`], rad.
    mean: f32,
    /// Time since the torque began to grow, s.
    seconds: f32,
    ahead: Line,
    back: Line,
    /// True if the field has turned by half a turn.
    was_repelled: bool,
    /// True if the motor's frame turns with its rotor from now on.
    done: bool,
}

impl Alignment {
    /// Returns true if a motor's swings take place in a standing frame.
    pub(super) fn is_under_way(&self, stage: &impl Stage) -> bool {
        stage.is_three_phase() && !self.done
    }

    /// Returns true while the rotor follows the field.
    pub(super) fn follows(&self) -> bool {
        !self.done && !matches!(self.part, Part::Zero | Part::Quarter)
    }

    /// Returns the pole pairs of a rotor that followed the field to this distance from its initial angle, rad.
    pub(super) fn rough_pole_pairs(&self, moved: f32, stage: &impl Stage) -> f32 {
        (self.field / moved).abs() * stage.pole_pairs() / stage.electrical_ratio()
    }

    /// Returns the largest distance of the joint from its initial angle while the rotor follows the field, rad;
    /// `electrical_ratio` is the file's.
    pub(super) fn farthest(electrical_ratio: f32) -> f32 {
        MAX_ALIGNING_ANGLE.0.greater(MAX_ALIGNING_ANGLE.1 / electrical_ratio)
    }
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
        let angle = if self.polarity.alignment.part == Part::Zero { 0.0 } else { FRAC_PI_2 };
        self.joints[i].stage.set_frame(Frame::Fixed(BinaryAngle::from_radians(angle.into())));
        self.begin_first_swing();
        true
    }

    /// Continues an alignment after a swing that measured this cosine. `breakaway` is the torque that moved the joint,
    /// N m.
    pub(super) fn continue_alignment(&mut self, cosine: f32, breakaway: Option<f32>) {
        let (axis, alignment) = (Some(self.axis() as u8), &mut self.polarity.alignment);
        let before = core::mem::replace(&mut alignment.cosine, cosine);
        let known = alignment.breakaway_torque.unwrap_or(f32::MAX);
        alignment.breakaway_torque = breakaway.map(|torque| torque.lesser(known)).or(alignment.breakaway_torque);
        (self.polarity.swing, self.polarity.part) = (None, 0);
        if alignment.part == Part::Zero {
            alignment.part = Part::Quarter;
            self.begin_aligning_swing();
            return;
        }
        let Some(breakaway) = alignment.breakaway_torque else {
            return self.trip(Fault::PolarityNoMotion, axis, 0.0);
        };
        (alignment.part, alignment.first) = (Part::Pull, libm::atan2f(cosine, before));
        self.polarity.initial = None;
        let force = self.polarity.force_per_torque;
        let torque = |ratio: f32| {
            let wanted = (ratio * breakaway).greater(MIN_PULL_FORCE / force);
            wanted.lesser((MAX_PULL_FORCE / force).greater(breakaway))
        };
        self.polarity.alignment.torques = [torque(FIRST_PULL_FRICTION_RATIO), torque(PULL_FRICTION_RATIO)];
    }

    /// Runs a step in which the rotor follows the field, and returns the torques. `moved` is the joint's motion from its
    /// initial angle, rad; `count` is its angle per encoder count, rad.
    pub(super) fn follow_field(&mut self, moved: f32, count: f32) -> Torques {
        let (i, period) = (self.axis(), self.polarity.step_period);
        let file = self.joints[i].stage.electrical_ratio();
        let end = (MOTION * file).lesser(MAX_MOTION_ELECTRICAL).greater(FIRST_FIELD) + LAG_ELECTRICAL;
        let alignment = &mut self.polarity.alignment;
        alignment.seconds += period;
        alignment.mean += (moved - alignment.mean) * (period / FALL_SECONDS).lesser(1.0);
        let falls = file * (moved - alignment.mean).abs() > MIN_FALL;
        if falls && !alignment.was_repelled && matches!(alignment.part, Part::Pull | Part::Ahead) {
            alignment.was_repelled = true;
            alignment.first += PI;
            (alignment.part, alignment.field, alignment.ahead) = (Part::Pull, 0.0, Line::default());
        }
        let step = FOLLOWING_SPEED * file * period;
        alignment.field += if alignment.part == Part::Back { -step } else { step };
        let follows = (moved - alignment.turned_at).abs() > MIN_FOLLOWED_ANGLE.greater(2.0 * count.abs());
        let is_far = follows && moved.abs() > MAX_MOTION.0.greater(MAX_MOTION.1 / file);
        let (field, growth) = (alignment.field, (alignment.seconds / GROWTH_SECONDS).lesser(1.0));
        match alignment.part {
            Part::Ahead if follows && growth >= 1.0 => alignment.ahead.add(moved, field),
            Part::Back if follows => alignment.back.add(moved, field),
            _ => {}
        }
        let next = match alignment.part {
            Part::Zero | Part::Quarter | Part::Pull => (field >= FIRST_FIELD).then_some(Part::Ahead),
            Part::Ahead => (field >= end || is_far).then_some(Part::Back),
            Part::Back => (field <= -end || is_far).then_some(Part::Return),
            Part::Return if field >= 0.0 => {
                self.finish_alignment(moved);
                return Torques::default();
            }
            Part::Return => None,
        };
        if let Some(part) = next {
            (alignment.part, alignment.turned_at) = (part, moved);
            alignment.seconds = if part == Part::Ahead { 0.0 } else { alignment.seconds };
        }
        let [first, complete] = alignment.torques;
        let torque = match alignment.part {
            Part::Zero | Part::Quarter | Part::Pull => growth * first,
            Part::Ahead => first + growth * (complete - first),
            Part::Back | Part::Return => complete,
        };
        let angle = alignment.first + alignment.field - FRAC_PI_2;
        self.joints[i].stage.set_frame(Frame::Fixed(BinaryAngle::from_radians(angle.into())));
        self.torques_within_tip_force(torque)
    }

    /// Compares the measured ratio with the file's, and lets the motor's frame turn with its rotor.
    fn finish_alignment(&mut self, moved: f32) {
        let i = self.axis();
        let Alignment { ahead, back, first, .. } = self.polarity.alignment;
        let [(ahead_variance, ahead_covariance), (back_variance, back_covariance)] = [ahead.moments(), back.moments()];
        let variance = ahead_variance + back_variance;
        if !(variance > 0.0 && ahead.points > 0.0 && back.points > 0.0) {
            return self.trip(Fault::PolarityNoMotion, Some(i as u8), moved);
        }
        let ratio = (ahead_covariance + back_covariance) / variance;
        let stage = &mut self.joints[i].stage;
        let (file, pole_pairs) = (stage.electrical_ratio(), stage.pole_pairs());
        let found = ratio.abs() * pole_pairs / file;
        // Written so that NaN is an error.
        if !((found - pole_pairs).abs() <= MAX_POLE_PAIR_ERROR) {
            return self.trip(Fault::PolePairs, Some(i as u8), found);
        }
        let ratio = if ratio < 0.0 { -file } else { file };
        let electrical = first + 0.5 * (ahead.offset(ratio) + back.offset(ratio)) + ratio * moved;
        stage.align(BinaryAngle::from_radians(electrical.into()), self.now.counts[i], ratio < 0.0);
        self.polarity.alignment.done = true;
        (self.polarity.swing, self.polarity.inertia, self.polarity.initial) = (None, None, None);
        (self.polarity.part, self.polarity.wait_seconds) = (0, 0.0);
    }
}
