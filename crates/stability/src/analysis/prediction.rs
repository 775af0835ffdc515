//! Prediction of the stable walls of a device on a board, with a hand. All commands use this prediction.
//!
//! A [`Subject`] is the device with its compliant parts. A [`Prediction`] adds the control loop: the scene's rate,
//! estimator, feed-forward and posture, the board's delay and drives, and the hand.

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

/// A device in a control loop.
#[derive(Clone, Debug)]
pub struct Prediction {
    /// The device.
    pub subject: Subject,
    /// Rate, delay, estimator and drives of the control loop.
    pub around: Loop,
    /// The coordinate that the feed-forward of a redundant device holds.
    pub admissible: Admissible,
    /// Gain α of the feed-forward; a board limits it to [`Linearised::largest_gain`].
    pub gain: f64,
    /// Posture control of a redundant device.
    pub posture: Option<Posture>,
    /// Hand at the tip.
    pub hand: Hand,
}

impl Prediction {
    /// Creates a prediction without hand and posture, with the feed-forward of equation (4).
    #[must_use]
    pub fn new(subject: Subject, around: Loop) -> Self {
        let (admissible, hand) = (Admissible::default(), Hand::default());
        Self { subject, around, admissible, gain: 1.0, posture: None, hand }
    }

    /// Creates a prediction for a scene on a board; `None` if the estimator has no linear model.
    #[must_use]
    pub fn in_scene(
        subject: &Subject,
        scene: &Scene<f64>,
        wall: Option<&Wall<f64>>,
        path: &TorquePath,
    ) -> Option<Self> {
        let estimator = LinearEstimator::of(scene.estimator, scene.cutoff_hz)?;
        let mut around = Loop::with_torque_path(path, scene.rate_hz, estimator);
        around.damping_compensation = wall.is_some_and(|wall| wall.damping_compensation);
        let held = scene.posture.map(|held| Posture { stiffness: held.stiffness, damping: held.damping });
        Some(Self {
            admissible: scene.admissible,
            gain: scene.feed_forward_gain,
            posture: held,
            ..Self::new(subject.clone(), around)
        })
    }

    /// Linearises the device for one wall at `q` (rad) along `normal` (d entries, any length but zero).
    pub fn linearise(&self, q: &[f64], normal: &[f64]) -> Result<Linearised, PoseError> {
        let mut linearised = self.subject.linearise_along(q, normal, self.admissible)?.with_hand(self.hand);
        linearised.gain = self.gain.min(linearised.largest_gain().unwrap_or(1.0));
        linearised.flexible.posture = self.posture_with_jacobian(q)?;
        Ok(linearised)
    }

    /// Linearises the device for these walls at `q` (rad).
    pub fn walls(&self, q: &[f64], members: &[Member]) -> Result<Walls, PoseError> {
        if let [only] = members {
            return Ok(Walls::One(self.linearise(q, &only.normal)?));
        }
        let set = WallSet::of(&self.subject, q, members, self.admissible)?.with_hand(self.hand);
        Ok(Walls::Several(set.in_posture(self.posture_with_jacobian(q)?)))
    }

    /// Returns the gain α that the board applies; for several walls α is 1.
    fn gain_at(&self, q: &[f64], members: &[Member]) -> f64 {
        match self.walls(q, members) {
            Ok(Walls::One(linearised)) => linearised.gain,
            _ => 1.0,
        }
    }

    /// Returns the posture control with the Jacobian row of the orientation; `None` if the control has no effect.
    fn posture_with_jacobian(&self, q: &[f64]) -> Result<Option<(Posture, nalgebra::DVector<f64>)>, PoseError> {
        // A posture without stiffness and damping has no effect.
        let acts = |held: &Posture| held.stiffness > 0.0 || held.damping > 0.0;
        let Some(held) = self.posture.filter(acts) else { return Ok(None) };
        let pose = TaskPose::of(&self.subject.device.mechanism, q)?;
        let redundant = pose.jacobian.nrows() > pose.task;
        Ok(redundant.then(|| (held, pose.jacobian.row(pose.task).transpose())))
    }

    /// Predicts the stable domains of these walls at `q` (rad) without feed-forward, with it, and with it behind a
    /// washout at `washout_hz`, in the totals of stiffness and damping. The dampings are `kd` (N s/m) or evenly spaced.
    pub fn range(
        &self,
        q: &[f64],
        members: &[Member],
        kd: Option<&[f64]>,
        washout_hz: Option<f64>,
    ) -> Result<Range, Failure> {
        Ok(self.walls(q, members)?.range(&self.around, kd, washout_hz)?)
    }

    /// Returns the largest stable stiffness with damping `kd`, N/m (0 if none is stable), and the largest damping.
    pub fn stiffness_at(&self, q: &[f64], normal: &[f64], mode: Mode, kd: f64) -> Result<(f64, f64), Failure> {
        Ok(stiffness_at(&self.linearise(q, normal)?, &self.around, mode, kd)?)
    }

    /// Returns the least damped oscillation of these walls at `q` (rad) with the totals `kp` (N/m) and `kd` (N s/m), or
    /// `None` if no mode oscillates. Beyond the stability boundary this oscillation is the buzz.
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

    /// Returns the options with which `haptic range DEVICE` repeats this prediction, without dampings and washout. The
    /// options contain all digits, so round the numbers before predicting.
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

    /// Returns the options of the control loop for this gain α. Each option begins with a space.
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

/// Returns the options of `haptic range` for a drive.
fn drive_options(drive: &Drive) -> String {
    match drive {
        Drive::Ideal => String::new(),
        Drive::Voltage(_) => " --drive voltage".into(),
        Drive::Current { bandwidth_hz } if *bandwidth_hz == CURRENT_LOOP_HZ => " --drive current".into(),
        Drive::Current { bandwidth_hz } => format!(" --drive current --current-bandwidth {bandwidth_hz}"),
    }
}

/// Returns the options of `haptic range` for an estimator, except `--cutoff`.
fn estimator_options(estimator: LinearEstimator) -> String {
    let (name, samples) = estimator.name_and_window();
    let kind = if name == "butterworth" { String::new() } else { format!(" --estimator {name}") };
    if samples > 1 { format!("{kind} --difference-over {samples}") } else { kind }
}

/// Rounds a value to the six printed digits, so that the prediction equals a prediction with the printed options.
#[must_use]
pub fn round_as_printed(value: f64) -> f64 {
    digits(value).parse().unwrap_or(value)
}

/// Device linearised for one wall, whose boundary is exact, or for several walls that act together.
#[derive(Clone, Debug)]
pub enum Walls {
    /// One wall.
    One(Linearised),
    /// Several walls.
    Several(WallSet),
}

impl Walls {
    /// Computes the result of [`Prediction::range`] for these walls.
    pub fn range(&self, around: &Loop, kd: Option<&[f64]>, washout_hz: Option<f64>) -> Result<Range, AnalysisError> {
        match self {
            Self::One(device) => predict(device, around, kd, washout_hz),
            Self::Several(set) => predict_several(set, around, kd, washout_hz),
        }
    }
}
