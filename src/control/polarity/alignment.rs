//! The alignment of a three-phase motor before its polarity check: the rotor's electrical angle, the direction and the
//! number of pole pairs, from small motions.
//!
//! A quadrature current in a frame that stands still at the electrical angle φ makes a field at the angle φ + π/2 and the
//! torque Kₜ i cos(θ - φ), where θ is the electrical angle of the rotor. A swing in this frame measures the cosine. Two
//! frames a quarter turn apart therefore give θ roughly, and two frames an eighth of a turn to either side correct it.
//! In these two the torque depends on the angle, so that the joint drifts while it swings: towards the middle between the
//! frames' fields, or away from it if two phases are exchanged. The direction of the drift therefore tells the direction
//! of the motor. Exchanged phases also change the sign of the torque, so θ is then half a turn off.
//!
//! The field then turns slowly from θ, ahead and back, and the rotor follows. Friction holds the rotor behind the field
//! in either direction, so the mean of both directions is the rotor's angle. The field's angle over the joint's angle is
//! the electrical ratio.

use crate::control::ControlLoop;
use crate::control::joints::Torques;
use crate::control::program::Program;
use crate::drive::stage::{Frame, Stage};
use crate::math::{BinaryAngle, Math, Real, sqrt};
use crate::safety::fault::Fault;
use core::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};
use core::ops::DerefMut;

/// Largest swing to either side in a standing frame, electrical rad.
pub(super) const MAX_SWING_ELECTRICAL: f32 = 0.25;
/// Torque that pulls the rotor towards the field, as a ratio to the torque that moved the joint in a swing.
const PULL_FRICTION_RATIO: f32 = 2.5;
/// Smallest tip force of the pull, N. A weaker current is too close to the resolution of an ODrive's sensors, 20 mA.
const MIN_PULL_FORCE: f32 = 0.4;
/// Largest tip force of the pull, N.
const MAX_PULL_FORCE: f32 = 0.8;
/// Time in which the pull grows, s.
const GROWTH_SECONDS: f32 = 0.3;
/// Speed of the joint behind the field, rad/s.
const FOLLOWING_SPEED: f32 = 0.1;
/// Accepted ratio (lowest, highest) of the torque that acted to the file's torque. Friction and the drift lower it.
const ACCEPTED_TORQUE_RATIO: (f32, f32) = (0.3, 1.6);
/// Largest correction after which no further correction follows, rad. Both swings then drift.
const MAX_LAST_CORRECTION: f32 = 0.3;
/// Largest number of corrections.
const MAX_CORRECTIONS: u8 = 5;
/// Share of a correction that is applied, because friction lowers the smaller of two cosines more.
const CORRECTION_SHARE: f32 = 0.7;
/// Motion of the joint to either side, rad, if it is at most [`MAX_MOTION_ELECTRICAL`].
const MOTION: f32 = 0.08;
/// Largest motion of the joint to either side, electrical rad.
const MAX_MOTION_ELECTRICAL: f32 = 2.0;
/// Angle that the field turns in addition, because the rotor stays behind, rad.
const LAG_ELECTRICAL: f32 = 0.8;
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
    /// Swings in the frame an eighth of a turn behind the rough angle.
    Behind,
    /// Swings in the frame an eighth of a turn in front of the rough angle.
    InFront,
    /// The torque towards the field grows.
    Pull,
    /// The field turns ahead.
    Ahead,
    /// The field turns back, past its first angle.
    Back,
    /// The field turns ahead to its first angle.
    Return,
    /// The torque towards the field fades, because the motor's frame changes at the end.
    Fade,
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
    /// Cosine that the last swing measured.
    cosine: f32,
    /// Joint angle at which the last swing took place, rad.
    place: f32,
    corrections: u8,
    /// Smallest torque that moved the joint in a swing, N m.
    breakaway_torque: Option<f32>,
    /// Torque that pulls the rotor towards the field, N m.
    torque: f32,
    /// First electrical angle of the field, rad.
    first: f32,
    /// Angle of the field from its first angle, rad.
    field: f32,
    /// Joint angle from the initial angle at which the present direction began, rad.
    turned_at: f32,
    /// Time in the present part, s.
    seconds: f32,
    ahead: Line,
    back: Line,
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
        !self.done && !matches!(self.part, Part::Zero | Part::Quarter | Part::Behind | Part::InFront)
    }

    /// Returns the pole pairs of a rotor that followed the field to this distance from its initial angle, rad.
    pub(super) fn rough_pole_pairs(&self, moved: f32, stage: &impl Stage) -> f32 {
        (self.field / moved).abs() * stage.pole_pairs() / stage.electrical_ratio()
    }

    /// Returns the largest distance of the joint from its initial angle while the rotor follows the field, rad;
    /// `electrical_ratio` is the file's.
    pub(super) fn max_distance(electrical_ratio: f32) -> f32 {
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
        let Alignment { part, first, .. } = self.polarity.alignment;
        let angle = match part {
            Part::Zero => 0.0,
            Part::Behind => first - FRAC_PI_4,
            Part::InFront => first + FRAC_PI_4,
            _ => FRAC_PI_2,
        };
        self.joints[i].stage.set_frame(Frame::Fixed(BinaryAngle::from_radians(angle.into())));
        self.begin_first_swing();
        true
    }

    /// Continues an alignment after a swing at this joint angle (rad), which measured this cosine. `breakaway` is the
    /// torque that moved the joint, N m.
    pub(super) fn continue_alignment(&mut self, cosine: f32, place: f32, breakaway: Option<f32>) {
        let axis = Some(self.axis() as u8);
        (self.polarity.swing, self.polarity.part) = (None, 0);
        let alignment = &mut self.polarity.alignment;
        let (last, from) = (alignment.cosine, alignment.place);
        (alignment.cosine, alignment.place) = (cosine, place);
        let known = alignment.breakaway_torque.unwrap_or(f32::MAX);
        alignment.breakaway_torque = breakaway.map(|torque| torque.lesser(known)).or(alignment.breakaway_torque);
        alignment.part = match alignment.part {
            Part::Zero => Part::Quarter,
            Part::Quarter => {
                alignment.first = libm::atan2f(cosine, last);
                Part::Behind
            }
            Part::Behind => Part::InFront,
            _ => {
                // cos(δ + π/4) behind and cos(δ - π/4) in front: their difference over their sum is tan δ, and the sum of
                // their squares is 1.
                let correction = CORRECTION_SHARE * libm::atan2f(cosine - last, cosine + last);
                alignment.first += correction;
                alignment.corrections += 1;
                let again = correction.abs() > MAX_LAST_CORRECTION && alignment.corrections < MAX_CORRECTIONS;
                if again { Part::Behind } else { Part::Pull }
            }
        };
        let breakaway = match (alignment.part, alignment.breakaway_torque) {
            (Part::Behind, None) => return self.trip(Fault::PolarityNoMotion, axis, 0.0),
            (Part::Pull, Some(breakaway)) => breakaway,
            _ => {
                self.begin_aligning_swing();
                return;
            }
        };
        let ratio = sqrt(cosine * cosine + last * last);
        if !(ACCEPTED_TORQUE_RATIO.0..=ACCEPTED_TORQUE_RATIO.1).contains(&ratio) {
            return self.trip(Fault::TorqueMismatch, axis, ratio);
        }
        let alignment = &mut self.polarity.alignment;
        if place > from {
            alignment.first += PI;
        }
        let force = self.polarity.force_per_torque;
        let most = (MAX_PULL_FORCE / force).greater(breakaway);
        alignment.torque = (PULL_FRICTION_RATIO * breakaway).greater(MIN_PULL_FORCE / force).lesser(most);
        self.polarity.initial = None;
    }

    /// Runs a step in which the rotor follows the field, and returns the torques. `moved` is the joint's motion from its
    /// initial angle, rad; `count` is its angle per encoder count, rad.
    pub(super) fn follow_field(&mut self, moved: f32, count: f32) -> Torques {
        let (i, period) = (self.axis(), self.polarity.step_period);
        let file = self.joints[i].stage.electrical_ratio();
        let end = (MOTION * file).lesser(MAX_MOTION_ELECTRICAL) + LAG_ELECTRICAL;
        let alignment = &mut self.polarity.alignment;
        alignment.seconds += period;
        let step = FOLLOWING_SPEED * file * period;
        alignment.field += match alignment.part {
            Part::Ahead | Part::Return => step,
            Part::Back => -step,
            _ => 0.0,
        };
        let follows = (moved - alignment.turned_at).abs() > MIN_FOLLOWED_ANGLE.greater(2.0 * count.abs());
        let is_far = follows && moved.abs() > MAX_MOTION.0.greater(MAX_MOTION.1 / file);
        let (field, growth) = (alignment.field, (alignment.seconds / GROWTH_SECONDS).lesser(1.0));
        match alignment.part {
            Part::Ahead if follows => alignment.ahead.add(moved, field),
            Part::Back if follows => alignment.back.add(moved, field),
            _ => {}
        }
        let next = match alignment.part {
            Part::Ahead => (field >= end || is_far).then_some(Part::Back),
            Part::Back => (field <= -end || is_far).then_some(Part::Return),
            Part::Return => (field >= 0.0).then_some(Part::Fade),
            Part::Fade if growth >= 1.0 => {
                self.finish_alignment(moved);
                return Torques::default();
            }
            Part::Fade => None,
            _ => (growth >= 1.0).then_some(Part::Ahead),
        };
        if let Some(part) = next {
            (alignment.part, alignment.turned_at, alignment.seconds) = (part, moved, 0.0);
        }
        let share = match alignment.part {
            Part::Ahead | Part::Back | Part::Return => 1.0,
            Part::Fade => 1.0 - growth,
            _ => growth,
        };
        let torque = share * alignment.torque;
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
        let error = (found - pole_pairs).abs();
        if error > MAX_POLE_PAIR_ERROR || error.is_nan() {
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
