//! Criteria for a wall: stability within margins, the motors' torque, ripple under two hands, and rebounds.

use super::margins::Corner;
use super::{Question, Settings, TunedWall, check, measured, three_digits};
use crate::bench::wall::{SlideResult, WallSimulation};
use crate::boards::force_along;
use haptic_bridge::render::scene::FeedForward;
use haptic_host::error::Failure;
use haptic_host::vectors::padded_to;
use haptic_stability::analysis::plant::Linearised;
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::analysis::range::{boundary_of, stiffnesses};
use haptic_stability::sweep::Sweep;
use serde::{Deserialize, Serialize};

/// Largest allowed number of rebounds of a tip that taps a wall at 0.2 m/s with a push of 3 N. A finger feels one
/// rebound as hardness, and more as rattling.
pub const MAX_REBOUNDS: usize = 1;

const DAMPING_COUNT: usize = 9;
/// Largest damping of a curve, as a share of the largest stable damping.
const HIGHEST_SHARE: f64 = 0.9;
/// Smallest damping of a curve, as a share of the largest.
const LOWEST_SHARE: f64 = 0.003;
/// Smallest damping ratio at a quarter of the encoders' rule of thumb. With less damping the tip rebounds.
const LEAST_DAMPING_RATIO: f64 = 0.04;

/// Simulates the largest ripple of a wall over all tested devices. `holds` is true if all walls hold the hand.
pub fn ripple(question: &Question<'_>, settings: &Settings) -> Result<SlideResult, Failure> {
    worst_ripple(question, settings, f64::INFINITY)
}

/// Like [`ripple`], but stops when the ripple exceeds `bound_n` (N).
fn worst_ripple(question: &Question<'_>, settings: &Settings, bound_n: f64) -> Result<SlideResult, Failure> {
    let Question { file, q, normal, margins, admissible, .. } = question;
    let mut worst = SlideResult { ripple_n: Some(0.0), holds: true };
    for (model, device) in margins.deviations(&file.description) {
        let simulation = WallSimulation::new(&model, &device, q, normal, settings.rate_hz)?;
        let result = simulation.slide(&settings.rendered_wall(*admissible), bound_n)?;
        worst.ripple_n = worst.ripple_n.zip(result.ripple_n).map(|(one, other)| one.max(other));
        worst.holds &= result.holds;
        if worst.ripple_n.is_none_or(|ripple| ripple > bound_n) {
            break;
        }
    }
    Ok(worst)
}

/// Returns the wall with these settings if it meets all criteria.
pub fn accepted_wall(question: &Question<'_>, settings: &Settings) -> Result<Option<TunedWall>, Failure> {
    let sweep = Sweep::quiet();
    let context = SearchContext::new(question, &sweep)?;
    let kept =
        if context.largest_stiffness(settings)? < settings.stiffness { None } else { context.check_all(settings)? };
    Ok(kept.map(|wall| TunedWall { felt: context.felt_stiffness(settings), ..wall }))
}

/// A request, with the values that all candidates share.
pub(super) struct SearchContext<'a> {
    pub question: &'a Question<'a>,
    pub sweep: &'a Sweep,
    nominal: Linearised,
    /// Corners of the margins without and with feed-forward.
    corners: [Vec<Corner>; 2],
    /// Largest stiffness (N/m) and damping (N s/m) that the motors allow.
    pub motor_limits: (f64, f64),
    /// Stiffness at which encoder steps alone cause the allowed ripple, N/m. Rule of thumb: the tip moves evenly, and
    /// each joint's error is independent with a standard deviation of 1/√12 of its step. A tip that follows the steps,
    /// or that friction holds between two steps, ripples less.
    pub rule_of_thumb_stiffness: f64,
}

/// Largest stiffness of a candidate within margins and motors over damping, as (damping, stiffness).
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Curve {
    pub points: Vec<(f64, f64)>,
}

impl Curve {
    pub fn largest_stiffness(&self) -> f64 {
        self.points.iter().map(|point| point.1).fold(0.0, f64::max)
    }
}

impl<'a> SearchContext<'a> {
    pub fn new(question: &'a Question<'a>, sweep: &'a Sweep) -> Result<Self, Failure> {
        check(question)?;
        let Question { file, q, normal, admissible, .. } = question;
        let nominal = Linearised::holding(&file.description, q, normal, *admissible)?;
        let device = file.device::<f64>().map_err(Failure::wrong)?;
        let pose = TaskPose::of(&device.mechanism, q)?.regular()?;
        let force = force_along(&device, &pose, normal).ok_or_else(|| {
            Failure::wrong(format!("{} has joints without [joint.motor]", file.path.display()))
                .remedy("add the motors: they limit the stiffness of a wall")
        })?;
        let steps = pose.jacobian.tr_mul(&padded_to(q.len(), normal));
        let counts = || steps.iter().zip(&device.joints).map(|(lever, joint)| (lever * joint.radians_per_count).abs());
        let count = counts().fold(0.0, f64::max);
        let spread = counts().map(|count| count * count / 12.0).sum::<f64>().sqrt();
        let corners =
            [false, true].map(|shaped| question.margins.corners(&file.description, q, normal, *admissible, shaped));
        let [off, shaped] = corners;
        Ok(Self {
            question,
            sweep,
            nominal,
            corners: [off?, shaped?],
            motor_limits: (force / (question.counts * count), force / question.speed),
            rule_of_thumb_stiffness: question.ripple_n / spread,
        })
    }

    /// Returns true if equation (4) differs from Jᵀ at this pose.
    pub fn is_coupled(&self) -> bool {
        self.nominal.w_eff().is_some_and(|w_eff| self.nominal.w_rr() / w_eff > 1.0 + 1e-3)
    }

    /// Returns the stiffness that a hand feels, N/m; `None` if no transmission is compliant.
    pub fn felt_stiffness(&self, settings: &Settings) -> Option<f64> {
        self.nominal.felt_stiffness(settings.mode(), settings.stiffness)
    }

    fn corners(&self, settings: &Settings) -> &[Corner] {
        &self.corners[usize::from(settings.feed_forward != FeedForward::Off)]
    }

    /// Computes a candidate's curve; `None` if a corner is unstable at every gain or has no bound.
    pub fn curve(&self, settings: &Settings) -> Result<Option<Curve>, Failure> {
        let (Some(around), Some(corner)) = (settings.loop_settings(), self.corners(settings).first()) else {
            return Ok(None);
        };
        let stiffness = 0.25 * self.rule_of_thumb_stiffness.min(self.motor_limits.0);
        let least_damping = 2.0 * LEAST_DAMPING_RATIO * (stiffness * self.nominal.w_eff().unwrap_or_default()).sqrt();
        let points =
            boundary_of(&corner.device, &corner.model, &corner.adjusted_loop(&around), settings.mode(), |end| {
                let high = (HIGHEST_SHARE * end).min(self.motor_limits.1);
                let low = least_damping.max(LOWEST_SHARE * high).min(0.5 * high);
                let share = |i: usize| (high / low).powf(i as f64 / (DAMPING_COUNT - 1) as f64);
                let mut dampings: Vec<f64> = (0..DAMPING_COUNT).map(|i| three_digits(low * share(i), true)).collect();
                dampings.retain(|damping| *damping > 0.0);
                dampings
            });
        let Ok(points) = points else { return Ok(None) };
        let dampings: Vec<f64> = points.iter().map(|point| point.kd).collect();
        let Some(most) = self.allowed_stiffnesses(settings, &dampings)? else { return Ok(None) };
        let curve = Curve { points: dampings.into_iter().zip(most).collect() };
        Ok((curve.largest_stiffness() > 0.0).then_some(curve))
    }

    /// Computes the largest stiffness at each damping within margins and motors; `None` without a bound.
    pub fn allowed_stiffnesses(&self, settings: &Settings, dampings: &[f64]) -> Result<Option<Vec<f64>>, Failure> {
        let Some(around) = settings.loop_settings() else { return Ok(None) };
        let (most, damped) = self.motor_limits;
        let mut least: Vec<f64> = dampings.iter().map(|damping| if *damping > damped { 0.0 } else { most }).collect();
        for corner in self.corners(settings) {
            self.sweep.check_interrupted()?;
            let around = corner.adjusted_loop(&around);
            match stiffnesses(&corner.device, &corner.model, &around, settings.mode(), dampings) {
                Ok(result) => least.iter_mut().zip(result).for_each(|(least, result)| *least = least.min(result)),
                Err(_) => return Ok(None),
            }
        }
        Ok(Some(least))
    }

    /// Computes the largest stiffness at the settings' damping, N/m; 0 if no stiffness is allowed.
    pub fn largest_stiffness(&self, settings: &Settings) -> Result<f64, Failure> {
        Ok(self.allowed_stiffnesses(settings, &[settings.damping])?.map_or(0.0, |most| most[0]))
    }

    /// Simulates the ripple under a sliding hand, N; `None` if it exceeds the limit or the hand is not held.
    pub fn slide_ripple(&self, settings: &Settings) -> Result<Option<f64>, Failure> {
        self.sweep.check_interrupted()?;
        let bound = self.question.ripple_n;
        let SlideResult { ripple_n, holds } = worst_ripple(self.question, settings, bound)?;
        Ok(ripple_n.filter(|ripple| holds && *ripple <= bound))
    }

    /// Returns true if a tip that taps the wall rebounds no more often than allowed.
    pub fn passes_tap(&self, settings: &Settings) -> Result<bool, Failure> {
        let Question { file, q, normal, admissible, .. } = self.question;
        let simulation = WallSimulation::new(&file.description, &file.description, q, normal, settings.rate_hz)?;
        let rebounds = simulation.rebounds(&settings.rendered_wall(*admissible))?;
        Ok(rebounds.is_some_and(|rebounds| rebounds <= MAX_REBOUNDS))
    }

    /// Simulates the ripple on the simulated board, N. Returns `None` if it exceeds `bound_n`.
    pub fn board_ripple(&self, settings: &Settings, bound_n: f64) -> Result<Option<f64>, Failure> {
        Ok(measured::ripple(self.question, settings, self.sweep)?.filter(|ripple| *ripple <= bound_n))
    }

    /// Returns the wall if it meets the limits of ripple and rebounds. The cheaper simulation runs first.
    pub fn check_ripple(&self, settings: &Settings) -> Result<Option<TunedWall>, Failure> {
        let Some(ripple_n) = self.slide_ripple(settings)? else { return Ok(None) };
        Ok(self.passes_tap(settings)?.then_some(TunedWall {
            settings: *settings,
            ripple_n,
            board_ripple_n: None,
            felt: None,
        }))
    }

    /// Returns the wall if it meets all simulated criteria, also the ripple limit on the simulated board.
    pub fn check_all(&self, settings: &Settings) -> Result<Option<TunedWall>, Failure> {
        let Some(result) = self.check_ripple(settings)? else { return Ok(None) };
        let Some(bound) = self.question.board_ripple_n else { return Ok(Some(result)) };
        Ok(self.board_ripple(settings, bound)?.map(|ripple| TunedWall { board_ripple_n: Some(ripple), ..result }))
    }
}
