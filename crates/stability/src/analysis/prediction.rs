//! The one prediction: how stiff a wall can be on a device, behind a board, in a hand. Whoever asks, asks here.
//!
//! A [`Subject`] is the device with what gives between its motors and links; a [`Prediction`] puts it into a loop: the
//! scene's rate, estimator, feed-forward and posture, the board's delay and drives, a hand.

use super::control_loop::{CURRENT_LOOP_HZ, Loop, Mode, TorquePath};
use super::domain::{oscillation, oscillation_of_several, stiffness_at};
use super::error::AnalysisError;
use super::estimator::LinearEstimator;
use super::flexible::{Hand, Posture};
use super::oscillation::Oscillation;
use super::plant::{Drive, Linearised};
use super::pose::{PoseError, TaskPose};
use super::range::{Range, predict, predict_several};
use super::several::{Member, WallSet};
pub use super::subject::Subject;
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::render::scene::{Scene, Wall};
use haptic_host::error::Failure;
use haptic_host::words::digits;
use std::fmt::Write;

/// A device in a loop.
#[derive(Clone, Debug)]
pub struct Prediction {
    /// The device.
    pub subject: Subject,
    /// Rate, delay, estimator, drives.
    pub around: Loop,
    /// The coordinate that a redundant device holds.
    pub admissible: Admissible,
    /// α of the feed-forward; a board gives no more than [`Linearised::most_gain`].
    pub gain: f64,
    /// The posture that the board holds a redundant device in.
    pub posture: Option<Posture>,
    /// On the tip.
    pub hand: Hand,
}

impl Prediction {
    /// The prediction for this device in this loop, without a hand or a posture, with equation (4) as it stands.
    #[must_use]
    pub fn new(subject: Subject, around: Loop) -> Self {
        let (admissible, hand) = (Admissible::default(), Hand::default());
        Self { subject, around, admissible, gain: 1.0, posture: None, hand }
    }

    /// Of this device in a scene on a board, before `wall` or any other of it; `None` with an estimator that has no
    /// linear analysis.
    #[must_use]
    pub fn in_scene(
        subject: &Subject,
        scene: &Scene<f64>,
        wall: Option<&Wall<f64>>,
        path: &TorquePath,
    ) -> Option<Self> {
        let estimator = LinearEstimator::of(scene.estimator, scene.cutoff_hz)?;
        let mut around = Loop::through(path, scene.rate_hz, estimator);
        around.damping_compensation = wall.is_some_and(|wall| wall.damping_compensation);
        let held = scene.posture.map(|held| Posture { stiffness: held.stiffness, damping: held.damping });
        Some(Self {
            admissible: scene.admissible,
            gain: scene.feed_forward_gain,
            posture: held,
            ..Self::new(subject.clone(), around)
        })
    }

    /// The device as one wall sees it at `q` (rad) along `normal` (d entries, any length but zero).
    pub fn seen(&self, q: &[f64], normal: &[f64]) -> Result<Linearised, PoseError> {
        let mut seen = self.subject.along(q, normal, self.admissible)?.held(self.hand);
        seen.gain = self.gain.min(seen.most_gain().unwrap_or(1.0));
        seen.flexible.posture = self.posture_row(q)?;
        Ok(seen)
    }

    /// The device as these walls see it at `q` (rad).
    pub fn walls(&self, q: &[f64], members: &[Member]) -> Result<Walls, PoseError> {
        if let [only] = members {
            return Ok(Walls::One(self.seen(q, &only.normal)?));
        }
        let set = WallSet::of(&self.subject, q, members, self.admissible)?.held(self.hand);
        Ok(Walls::Several(set.in_posture(self.posture_row(q)?)))
    }

    /// α as the board gives it here: several walls have (4) as it stands.
    fn gain_at(&self, q: &[f64], members: &[Member]) -> f64 {
        match self.walls(q, members) {
            Ok(Walls::One(seen)) => seen.gain,
            _ => 1.0,
        }
    }

    /// The posture with the row of the orientation's Jacobian.
    fn posture_row(&self, q: &[f64]) -> Result<Option<(Posture, nalgebra::DVector<f64>)>, PoseError> {
        // Neither spring nor damper holds nothing.
        let acts = |held: &Posture| held.stiffness > 0.0 || held.damping > 0.0;
        let Some(held) = self.posture.filter(acts) else { return Ok(None) };
        let pose = TaskPose::of(&self.subject.device.mechanism, q)?;
        let redundant = pose.jacobian.nrows() > pose.task;
        Ok(redundant.then(|| (held, pose.jacobian.row(pose.task).transpose())))
    }

    /// The stable domain of these walls at `q` (rad) in the totals of stiffness and damping: without, with, and (at
    /// `washout_hz`) with washed-out feed-forward; at these dampings (N s/m), or at even ones.
    pub fn range(
        &self,
        q: &[f64],
        members: &[Member],
        kd: Option<&[f64]>,
        washout_hz: Option<f64>,
    ) -> Result<Range, Failure> {
        Ok(self.walls(q, members)?.range(&self.around, kd, washout_hz)?)
    }

    /// The largest stiffness (N/m) of a wall with damping `kd` (N s/m) that is stable, zero where none is, and the
    /// damping at which all ends.
    pub fn stiffness_at(&self, q: &[f64], normal: &[f64], mode: Mode, kd: f64) -> Result<(f64, f64), Failure> {
        Ok(stiffness_at(&self.seen(q, normal)?, &self.around, mode, kd)?)
    }

    /// The swing of these walls at `q` (rad) that dies out most slowly, or grows, with `kp` (N/m) and `kd` (N s/m) in
    /// total: beyond the boundary it is the buzz. `None` where nothing swings.
    pub fn buzz(
        &self,
        q: &[f64],
        members: &[Member],
        mode: Mode,
        kp: f64,
        kd: f64,
    ) -> Result<Option<Oscillation>, Failure> {
        Ok(match self.walls(q, members)? {
            Walls::One(device) => oscillation(&device, &self.around, mode, kp, kd),
            Walls::Several(set) => oscillation_of_several(&set, &self.around, mode, kp, kd),
        }?)
    }

    /// The options with which `haptic range DEVICE` predicts the same for these walls, except dampings and washout. A
    /// number is there in all its digits: round before predicting.
    #[must_use]
    pub fn options(&self, q: &[f64], members: &[Member]) -> String {
        let list = |values: &[f64]| values.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
        let mut line = format!("--q={}", list(q));
        for wall in members {
            let _ = write!(line, " --normal={}", list(&wall.normal));
        }
        if let [_, _, ..] = members {
            let shares: Vec<f64> = members.iter().map(|wall| wall.share).collect();
            let _ = write!(line, " --share {}", list(&shares));
            let plain: Vec<String> = members
                .iter()
                .enumerate()
                .filter(|(_, wall)| !wall.feed_forward)
                .map(|(index, _)| index.to_string())
                .collect();
            if !plain.is_empty() {
                let _ = write!(line, " --no-feed-forward {}", plain.join(","));
            }
        }
        line + &self.loop_options(self.gain_at(q, members))
    }

    /// Those of the loop alone, with this α of the feed-forward, each after a space.
    #[must_use]
    pub fn loop_options(&self, gain: f64) -> String {
        let Loop { rate_hz, delay_samples, estimator, drive, damping_compensation } = &self.around;
        let mut line = format!(" --rate {rate_hz}");
        if let Some(cutoff) = estimator.cutoff_hz() {
            let _ = write!(line, " --cutoff {cutoff}");
        }
        let _ = write!(line, " --delay {delay_samples}{}{}", drive_options(drive), estimator_options(*estimator));
        if self.admissible != Admissible::default() {
            let _ = write!(line, " --admissible {}", self.admissible.name());
        }
        if gain != 1.0 {
            let _ = write!(line, " --feed-forward-gain {gain}");
        }
        if let Some(held) = self.posture {
            let _ = write!(line, " --posture {},{}", held.stiffness, held.damping);
        }
        if self.hand.is_there() {
            let _ = write!(line, " --hand {},{},{}", self.hand.mass, self.hand.damping, self.hand.stiffness);
        }
        if *damping_compensation {
            line.push_str(" --damping-compensation");
        }
        line
    }
}

/// The options of `haptic range` that ask for a drive.
fn drive_options(drive: &Drive) -> String {
    match drive {
        Drive::Ideal => String::new(),
        Drive::Voltage(_) => " --drive voltage".into(),
        Drive::Current { bandwidth_hz } if *bandwidth_hz == CURRENT_LOOP_HZ => " --drive current".into(),
        Drive::Current { bandwidth_hz } => format!(" --drive current --current-bandwidth {bandwidth_hz}"),
    }
}

/// The options of `haptic range` that ask for an estimator, beside `--cutoff`.
fn estimator_options(estimator: LinearEstimator) -> String {
    let (name, samples) = estimator.name_and_window();
    let kind = if name == "butterworth" { String::new() } else { format!(" --estimator {name}") };
    if samples > 1 { format!("{kind} --difference-over {samples}") } else { kind }
}

/// A value to the six digits in which it is printed: prediction and printed line then agree in every digit.
#[must_use]
pub fn printed(value: f64) -> f64 {
    digits(value).parse().unwrap_or(value)
}

/// One wall, whose boundary is known exactly, or several that act together.
#[derive(Clone, Debug)]
pub enum Walls {
    /// One.
    One(Linearised),
    /// Several.
    Several(WallSet),
}

impl Walls {
    /// See [`Prediction::range`].
    pub fn range(&self, around: &Loop, kd: Option<&[f64]>, washout_hz: Option<f64>) -> Result<Range, AnalysisError> {
        match self {
            Self::One(device) => predict(device, around, kd, washout_hz),
            Self::Several(set) => predict_several(set, around, kd, washout_hz),
        }
    }
}
