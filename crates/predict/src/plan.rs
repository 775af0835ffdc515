//! Plans a scene: finds the cheapest control step within an error budget.
//!
//! The planner considers the poses at which the tip touches the scene's walls, with the motors' force there and a
//! hand's speed. It computes the error with and without velocity terms in the board's precision, and chooses the
//! cheapest variant whose error is at most [`USABLE_SHARE`] of the budget.
//!
//! Velocity terms that the board fades are lost in every variant. This error is reported but does not count against the
//! budget. The result is a scene with `velocity_terms` and `feed_forward`, which the board renders unchanged.

use crate::bench::counts;
use crate::bench::error::{Errors, Law, Terms, TorqueVariant, Trigonometry, VariantErrors, errors};
use crate::bench::probe::{Probe, on_surface};
use haptic_bridge::model::device::Device;
use haptic_bridge::render::scene::{FeedForward, Scene, VelocityTerms};
use haptic_host::error::Failure;
use haptic_host::link::{Board, BoardError};
use serde::Serialize;

/// Share of the budget that the error at the computed poses may use, because between them the error may be larger.
pub const USABLE_SHARE: f64 = 0.6;
/// Default error budget, percent of the motors' torque.
pub const DEFAULT_PERCENT: f64 = 1.0;
const FIRMWARE_TRIGONOMETRY: &str = "table";

/// Largest error that a plan may have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Budget {
    /// Torque error of the worst joint, as a percentage of its motor's torque. The error of the tip force is the same
    /// percentage of the motors' largest tip force.
    Percent(f64),
    /// One duty step, because the duty has no finer resolution.
    OneDutyStep,
}

impl Budget {
    /// Returns the ratio of a variant's error to this budget.
    pub fn share_of_budget(self, errors: &Errors) -> f64 {
        match self {
            Budget::Percent(percent) => 100.0 * errors.share.max / percent,
            Budget::OneDutyStep => errors.duty.max,
        }
    }
}

/// A variant that was considered.
#[derive(Clone, Debug, Serialize)]
pub struct Candidate {
    /// Name of the terms.
    pub terms: &'static str,
    /// Instructions of the slowest control step on the Cortex-M4F.
    pub instructions: u32,
    /// Error including the fading that all variants have.
    pub errors: Errors,
    /// Error without the fading that all variants have.
    #[serde(skip)]
    pub unfaded_errors: Errors,
    /// Ratio of the error without fading to the budget.
    pub used: f64,
}

/// The result of planning.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The scene with the chosen feed-forward and velocity terms.
    pub scene: Scene<f64>,
    /// Terms of the walls' feed-forward.
    pub terms: Terms,
    /// Instructions of the slowest control step on the Cortex-M4F.
    pub instructions: u32,
    /// Error at the computed poses.
    pub errors: Errors,
    /// All considered variants in ascending order of cost.
    pub candidates: Vec<Candidate>,
    /// Reasons for the choice, one sentence each.
    pub reasons: Vec<String>,
}

impl Plan {
    /// Loads the scene onto a disarmed board. Returns the scene that was sent.
    pub fn load(&self, board: &mut Board) -> Result<Scene<f32>, BoardError> {
        let scene = self.scene.cast();
        board.set_scene(&scene)?;
        Ok(scene)
    }
}

fn angles_per_joint(joints: usize) -> usize {
    match joints {
        1 => 41,
        2 => 161,
        _ => 25,
    }
}

/// Plans `scene` on `device` for hands of up to `speed` m/s. Returns an error if the device cannot be analysed or if no
/// variant is within the budget; the error then names the best variant's error.
pub fn plan(device: &Device<f64>, scene: &Scene<f64>, budget: Budget, speed: f64) -> Result<Plan, Failure> {
    plan_on(device, scene, budget, speed, angles_per_joint(device.mechanism.kind().spec().joints))
}

/// Like [`plan`], with `per_joint` grid angles per joint.
fn plan_on(
    device: &Device<f64>,
    scene: &Scene<f64>,
    budget: Budget,
    speed: f64,
    per_joint: usize,
) -> Result<Plan, Failure> {
    let spec = device.mechanism.kind().spec();
    let mut scene = scene.clone();
    let mut reasons = Vec::new();
    let shaped = scene.walls.iter().filter(|wall| wall.feed_forward != FeedForward::Off).count();
    if shaped == 0 {
        reasons.push("no wall has feed-forward, so no mass matrix and no velocity terms are computed".into());
    } else if spec.joints == 1 {
        reasons.push("with one joint the feed-forward has no effect, so it is left out".into());
    }
    let probes =
        if shaped == 0 || spec.joints == 1 { Vec::new() } else { probes_on_walls(device, &scene, per_joint, speed)? };
    if probes.is_empty() && shaped > 0 && spec.joints > 1 {
        reasons.push("no wall with feed-forward can be reached, so no feed-forward is computed".into());
    }
    if probes.is_empty() {
        scene.walls.iter_mut().for_each(|wall| wall.feed_forward = FeedForward::Off);
        scene.velocity_terms = VelocityTerms::Off;
        let (instructions, errors) = (cost(device, &scene), Errors::default());
        return Ok(Plan { scene, terms: Terms::None, instructions, errors, candidates: Vec::new(), reasons });
    }

    let (wanted, law) = (scene.velocity_terms, Law::of(&scene, device)?);
    let used_of = |terms| if terms == Terms::FeedForwardZ { wanted } else { VelocityTerms::Off };
    let mut candidates: Vec<Candidate> = Vec::new();
    let mut chosen = None;
    // In ascending order of cost.
    for terms in [Terms::FeedForward, Terms::FeedForwardZ] {
        if terms == Terms::FeedForwardZ && wanted == VelocityTerms::Off {
            continue;
        }
        let instructions = cost(device, &Scene { velocity_terms: used_of(terms), ..scene.clone() });
        let variant = TorqueVariant { terms, trigonometry: Trigonometry::Tabulated, law };
        let VariantErrors { whole: errors, unfaded_errors } = errors(device, &probes, &variant);
        let used = budget.share_of_budget(&unfaded_errors);
        candidates.push(Candidate { terms: terms.name(), instructions, errors, unfaded_errors, used });
        if chosen.is_none() && used <= USABLE_SHARE {
            chosen = Some((instructions, terms, errors));
        }
    }
    let Some((instructions, terms, errors)) = chosen else {
        let best = candidates.iter().min_by(|a, b| a.used.total_cmp(&b.used));
        let least = best.map_or(f64::NAN, |best| match budget {
            Budget::Percent(_) => 100.0 * best.unfaded_errors.share.max / USABLE_SHARE,
            Budget::OneDutyStep => best.unfaded_errors.duty.max / USABLE_SHARE,
        });
        let (wanted, unit) = match budget {
            Budget::Percent(percent) => (percent, "percent"),
            Budget::OneDutyStep => (1.0, "duty steps"),
        };
        return Err(Failure::impossible(format!(
            "no control step keeps the error on the reachable walls below {wanted} {unit}; the best one needs {least:.3} {unit}"
        ))
        .remedy(format!("allow an error of {:.2}", least * 1.1)));
    };
    scene.velocity_terms = used_of(terms);
    let [faded, _] = law.fading_shares(device, &probes);
    let fading = (wanted != VelocityTerms::Off && faded > 0.0).then_some((faded, law.lag));
    reasons.extend(explain(&candidates, terms, budget, speed, fading));
    Ok(Plan { scene, terms, instructions, errors, candidates, reasons })
}

/// Returns situations at all walls with feed-forward.
pub fn probes_on_walls(
    device: &Device<f64>,
    scene: &Scene<f64>,
    per_joint: usize,
    speed: f64,
) -> Result<Vec<Probe>, Failure> {
    let mut probes = Vec::new();
    for wall in scene.walls.iter().filter(|wall| wall.feed_forward != FeedForward::Off) {
        probes.extend(on_surface(device, &wall.surface, per_joint, speed)?);
    }
    Ok(probes)
}

/// Returns the instructions of the slowest control step of a scene, from counts for one wall, a pair of walls, a ball
/// and no wall. Each additional wall adds the difference that a wall of its kind makes.
pub fn cost(device: &Device<f64>, scene: &Scene<f64>) -> u32 {
    let name = device.mechanism.kind().spec().name;
    let counted = |terms: &str| counts::instructions(name, FIRMWARE_TRIGONOMETRY, terms).unwrap_or(0);
    let free = counted("free");
    let z = if scene.velocity_terms == VelocityTerms::Off { "" } else { "+z" };
    let per_wall = counted("none").saturating_sub(free);
    let walls = scene.walls.len() as u32;
    let shaped: Vec<_> = scene.walls.iter().filter(|wall| wall.feed_forward != FeedForward::Off).collect();
    let curved = scene.walls.iter().any(|wall| wall.surface.is_curved());
    let Some(first) = shaped.first() else { return free + walls * per_wall };
    let one = match first.feed_forward {
        _ if curved => counted(&format!("ball, washout{z}")),
        FeedForward::Full if shaped.len() == 1 => counted(&format!("feed-forward{z}")),
        _ => counted(&format!("washout{z}")),
    };
    let plain = walls - shaped.len() as u32;
    let more = match shaped.len() as u32 {
        1 => 0,
        count => {
            let pair = counted(&format!("edge, washout{z}"));
            pair.saturating_sub(counted(&format!("washout{z}"))) + (count - 2) * per_wall
        }
    };
    one + more + plain * per_wall
}

/// Returns the reasons for a choice. `fading` is the share of fading situations and the velocity lag, s.
fn explain(
    candidates: &[Candidate],
    terms: Terms,
    budget: Budget,
    speed: f64,
    fading: Option<(f64, f64)>,
) -> Vec<String> {
    let find = |terms: Terms| candidates.iter().find(|c| c.terms == terms.name());
    // Uses the force that 99 % of the situations do not exceed, because the others are close to singularities.
    let size = |errors: &Errors| {
        let Errors { force, share, duty, .. } = errors;
        let most = match budget {
            Budget::Percent(_) => format!("{} of the motors' torque", percent(share.max)),
            Budget::OneDutyStep => format!("{:.1} duty steps", duty.max),
        };
        format!("up to {} at the tip in 99 % of the situations, at worst {most}", newtons(force.most))
    };
    let mut reasons = Vec::new();
    if let Some(without) = find(Terms::FeedForward) {
        let verdict = match terms {
            Terms::FeedForward if budget.share_of_budget(&without.errors) <= USABLE_SHARE => {
                "too small to be compensated"
            }
            Terms::FeedForward => "too small to be compensated where they do not fade",
            _ if fading.is_some() => "they are compensated, except where they fade",
            _ => "they are compensated",
        };
        reasons.push(format!("at {speed} m/s the forces of motion are {}: {verdict}", size(&without.errors)));
    }
    if let (Some((share, lag)), Some(whole)) = (fading, find(Terms::FeedForwardZ)) {
        reasons.push(format!(
            "estimated velocities lag by {:.2} ms, so the velocity terms fade where the joints turn fast near a singular pose, in {} of the \
             situations: up to {} of the forces of motion then remain; a higher rate and cutoff reduce them",
            1.0e3 * lag,
            percent(share),
            newtons(whole.errors.force.max)
        ));
    }
    reasons
}

/// Formats a force with its significant digits.
pub fn newtons(force: f64) -> String {
    match force {
        f if f >= 10.0 => format!("{f:.0} N"),
        f if f >= 0.1 => format!("{f:.1} N"),
        f if f >= 1.0e-4 => format!("{:.1} mN", 1.0e3 * f),
        _ => "less than 0.1 mN".into(),
    }
}

/// Formats a share in percent. Above 100 % the number has no meaning.
pub fn percent(share: f64) -> String {
    match 100.0 * share {
        p if p > 100.0 => "more than all".into(),
        p if p >= 10.0 => format!("{p:.0} %"),
        p if p >= 0.01 => format!("{p:.2} %"),
        _ => "less than 0.01 %".into(),
    }
}
