//! The criteria for a wall: stability within the margins, the motors, ripple under two hands, and few rebounds after a
//! tap.

use super::margins::Corner;
use super::{Found, Question, Settings, check, measured, three_digits};
use crate::bench::wall::{Pressed, WallSimulation};
use crate::boards::force_along;
use haptic_bridge::render::scene::FeedForward;
use haptic_host::error::Failure;
use haptic_host::vectors::padded_to;
use haptic_stability::analysis::plant::Linearised;
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::analysis::range::{boundary_of, stiffnesses};
use haptic_stability::sweep::Sweep;
use serde::{Deserialize, Serialize};

/// Largest number of times that the tip may leave a wall again that it taps with 0.2 m/s, pushed with 3 N: a finger
/// feels one rebound as hardness and more as rattling.
pub const MOST_REBOUNDS: usize = 1;

/// Dampings of a curve; the largest as a share of where it ends, and the smallest as a share of that, but not so small
/// that a wall a quarter as stiff as the encoders' rule of thumb has less than this damping ratio: it rebounds.
const DAMPINGS: usize = 9;
const HIGHEST: f64 = 0.9;
const LOWEST: f64 = 0.003;
const LEAST_RATIO: f64 = 0.04;

/// Ripple of a wall with these settings: the largest of the device in the file and of those a little off it, which hold
/// the hand if all do.
pub fn ripple(question: &Question<'_>, settings: &Settings) -> Result<Pressed, Failure> {
    pressed(question, settings, f64::INFINITY)
}

/// The same as far as it matters whether it exceeds `bound_n`, N.
fn pressed(question: &Question<'_>, settings: &Settings, bound_n: f64) -> Result<Pressed, Failure> {
    let Question { file, q, normal, margins, admissible, .. } = question;
    let mut worst = Pressed { ripple_n: Some(0.0), holds: true };
    for (believed, moving) in margins.deviations(&file.description) {
        let simulation = WallSimulation::new(&believed, &moving, q, normal, settings.rate_hz)?;
        let found = simulation.slid_along(&settings.rendered(*admissible), bound_n)?;
        worst.ripple_n = worst.ripple_n.zip(found.ripple_n).map(|(one, other)| one.max(other));
        worst.holds &= found.holds;
        if worst.ripple_n.is_none_or(|ripple| ripple > bound_n) {
            break;
        }
    }
    Ok(worst)
}

/// A wall with these settings, if it keeps everything that is asked for.
pub fn keeps(question: &Question<'_>, settings: &Settings) -> Result<Option<Found>, Failure> {
    let sweep = Sweep::quiet();
    let context = SearchContext::new(question, &sweep)?;
    let kept = if context.most(settings)? < settings.stiffness { None } else { context.kept(settings)? };
    Ok(kept.map(|found| Found { felt: context.felt(settings), ..found }))
}

/// The question with what does not change between candidates.
pub(super) struct SearchContext<'a> {
    pub question: &'a Question<'a>,
    pub sweep: &'a Sweep,
    nominal: Linearised,
    /// Corners of the margins without and with a feed-forward.
    corners: [Vec<Corner>; 2],
    /// Largest stiffness (N/m) and damping (N s/m) for the motors.
    pub motors: (f64, f64),
    /// Stiffness (N/m) of which encoder steps alone make all of the ripple while the tip moves evenly through them: a
    /// step in each joint is an error evenly spread over itself, 1/√12 of it, and the joints' are independent. A rule
    /// of thumb: a tip that follows the steps, or that friction holds between two, ripples less.
    pub steps: f64,
}

/// The largest gains of a candidate: kp within the margins and the motors over damping.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Curve {
    pub points: Vec<(f64, f64)>,
}

impl Curve {
    pub fn top(&self) -> f64 {
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
                .remedy("a wall is as stiff as motors make it: add them")
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
            motors: (force / (question.counts * count), force / question.speed),
            steps: question.ripple_n / spread,
        })
    }

    /// Returns true if equation (4) differs from Jᵀ here.
    pub fn is_coupled(&self) -> bool {
        self.nominal.w_eff().is_some_and(|w_eff| self.nominal.w_rr() / w_eff > 1.0 + 1e-3)
    }

    /// The stiffness that a hand feels of a wall, N/m; `None` where no transmission gives.
    pub fn felt(&self, settings: &Settings) -> Option<f64> {
        self.nominal.felt(settings.mode(), settings.stiffness)
    }

    fn corners(&self, settings: &Settings) -> &[Corner] {
        &self.corners[usize::from(settings.feed_forward != FeedForward::Off)]
    }

    /// kp over damping within margins and motors. Nothing where some corner is unstable at every gain, or has no bound.
    pub fn curve(&self, settings: &Settings) -> Result<Option<Curve>, Failure> {
        let (Some(around), Some(hard)) = (settings.around(), self.corners(settings).first()) else { return Ok(None) };
        let stiffness = 0.25 * self.steps.min(self.motors.0);
        let quick = 2.0 * LEAST_RATIO * (stiffness * self.nominal.w_eff().unwrap_or_default()).sqrt();
        let points = boundary_of(&hard.device, &hard.believed, &hard.around(&around), settings.mode(), |end| {
            let high = (HIGHEST * end).min(self.motors.1);
            let low = quick.max(LOWEST * high).min(0.5 * high);
            let share = |i: usize| (high / low).powf(i as f64 / (DAMPINGS - 1) as f64);
            let mut dampings: Vec<f64> = (0..DAMPINGS).map(|i| three_digits(low * share(i), true)).collect();
            dampings.retain(|damping| *damping > 0.0);
            dampings
        });
        let Ok(points) = points else { return Ok(None) };
        let dampings: Vec<f64> = points.iter().map(|point| point.kd).collect();
        let Some(most) = self.allowed(settings, &dampings)? else { return Ok(None) };
        let curve = Curve { points: dampings.into_iter().zip(most).collect() };
        Ok((curve.top() > 0.0).then_some(curve))
    }

    /// Largest stiffness at each damping within margins and motors; none where some corner has no such bound.
    pub fn allowed(&self, settings: &Settings, dampings: &[f64]) -> Result<Option<Vec<f64>>, Failure> {
        let Some(around) = settings.around() else { return Ok(None) };
        let (most, damped) = self.motors;
        let mut least: Vec<f64> = dampings.iter().map(|damping| if *damping > damped { 0.0 } else { most }).collect();
        for corner in self.corners(settings) {
            self.sweep.go_on()?;
            let around = corner.around(&around);
            match stiffnesses(&corner.device, &corner.believed, &around, settings.mode(), dampings) {
                Ok(found) => least.iter_mut().zip(found).for_each(|(least, found)| *least = least.min(found)),
                Err(_) => return Ok(None),
            }
        }
        Ok(Some(least))
    }

    /// The same at the settings' own damping, N/m; 0 if no stiffness is allowed.
    pub fn most(&self, settings: &Settings) -> Result<f64, Failure> {
        Ok(self.allowed(settings, &[settings.damping])?.map_or(0.0, |most| most[0]))
    }

    /// Ripple under the hand that slides, N, if it is kept and the wall holds the hand.
    pub fn slid_along(&self, settings: &Settings) -> Result<Option<f64>, Failure> {
        self.sweep.go_on()?;
        let bound = self.question.ripple_n;
        let Pressed { ripple_n, holds } = pressed(self.question, settings, bound)?;
        Ok(ripple_n.filter(|ripple| holds && *ripple <= bound))
    }

    /// Returns true if a tip that taps the wall leaves it no more often than it may.
    pub fn tapped(&self, settings: &Settings) -> Result<bool, Failure> {
        let Question { file, q, normal, admissible, .. } = self.question;
        let simulation = WallSimulation::new(&file.description, &file.description, q, normal, settings.rate_hz)?;
        let rebounds = simulation.rebounds(&settings.rendered(*admissible))?;
        Ok(rebounds.is_some_and(|rebounds| rebounds <= MOST_REBOUNDS))
    }

    /// Ripple on the simulated board, N, if that is kept.
    pub fn on_board(&self, settings: &Settings, bound_n: f64) -> Result<Option<f64>, Failure> {
        Ok(measured::ripple(self.question, settings, self.sweep)?.filter(|ripple| *ripple <= bound_n))
    }

    /// A wall, if it keeps the ripple of the hand that slides and what a tap may do; what is cheaper comes first.
    pub fn quiet(&self, settings: &Settings) -> Result<Option<Found>, Failure> {
        let Some(ripple_n) = self.slid_along(settings)? else { return Ok(None) };
        Ok(self.tapped(settings)?.then_some(Found { settings: *settings, ripple_n, board_ripple_n: None, felt: None }))
    }

    /// The same, if the board keeps its ripple as well: all that is found by simulation.
    pub fn kept(&self, settings: &Settings) -> Result<Option<Found>, Failure> {
        let Some(found) = self.quiet(settings)? else { return Ok(None) };
        let Some(bound) = self.question.board_ripple_n else { return Ok(Some(found)) };
        Ok(self.on_board(settings, bound)?.map(|ripple| Found { board_ripple_n: Some(ripple), ..found }))
    }
}
