//! Plans a scene: finds the cheapest control step within an error budget.
//!
//! The planner considers the poses at which the tip touches the scene's walls, with the motors' force there and a
//! hand's speed. It computes the error of every mass model with and without velocity terms in the board's precision,
//! and chooses the cheapest variant whose error is at most [`USABLE_SHARE`] of the budget.
//!
//! Velocity terms that the board fades are lost in every variant. This error is reported but does not count against the
//! budget. The result is a mass model and a scene with `velocity_terms` and `feed_forward`, which the board renders
//! unchanged.

use crate::bench::counts;
use crate::bench::error::{Errors, Law, Terms, TorqueVariant, Trigonometry, VariantErrors, errors};
use crate::bench::precompute::{PrecomputedModel, frozen_model, mass_table, max_grid_points, shape_range};
use crate::bench::probe::{Probe, on_surface};
use haptic_bridge::model::device::Device;
use haptic_bridge::model::precomputed::Interpolation;
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
    /// Name of the mass model.
    pub model: &'static str,
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
    /// The chosen mass model.
    pub mass: PrecomputedModel,
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
    /// Loads the scene and the mass model onto a disarmed board. Returns the scene that was sent.
    pub fn load(&self, board: &mut Board) -> Result<Scene<f32>, BoardError> {
        let scene = self.scene.cast();
        board.set_scene(&scene)?;
        board.send_mass(&self.mass.data, &self.mass.values)?;
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
        let instructions = cost(device, &scene, "exact");
        let (mass, errors) = (PrecomputedModel::default(), Errors::default());
        return Ok(Plan { scene, mass, terms: Terms::None, instructions, errors, candidates: Vec::new(), reasons });
    }

    let (wanted, law) = (scene.velocity_terms, Law::of(&scene, device)?);
    let used_of = |terms| if terms == Terms::FeedForwardZ { wanted } else { VelocityTerms::Off };
    let mut variants = Vec::new();
    for mass in models(device, &probes) {
        for terms in [Terms::FeedForward, Terms::FeedForwardZ] {
            if terms == Terms::FeedForwardZ && wanted == VelocityTerms::Off {
                continue;
            }
            let with = Scene { velocity_terms: used_of(terms), ..scene.clone() };
            variants.push((cost(device, &with, mass.name()), terms, mass.clone()));
        }
    }
    variants.sort_by_key(|(instructions, _, mass)| (*instructions, mass.bytes()));

    let mut candidates: Vec<Candidate> = Vec::new();
    let mut chosen = None;
    for (instructions, terms, mass) in variants {
        let variant = TorqueVariant { model: &mass, terms, trigonometry: Trigonometry::Tabulated, law };
        let VariantErrors { whole: errors, unfaded_errors } = errors(device, &probes, &variant);
        let used = budget.share_of_budget(&unfaded_errors);
        let (model, terms_name) = (mass.name(), terms.name());
        candidates.push(Candidate { model, terms: terms_name, instructions, errors, unfaded_errors, used });
        if chosen.is_none() && used <= USABLE_SHARE {
            chosen = Some((instructions, terms, mass, errors));
        }
    }
    let Some((instructions, terms, mass, errors)) = chosen else {
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
            "no mass model keeps the error on the reachable walls below {wanted} {unit}; the best one needs {least:.3} {unit}"
        ))
        .remedy(format!("allow an error of {:.2}", least * 1.1)));
    };
    scene.velocity_terms = used_of(terms);
    let [faded, _] = law.fading_shares(device, &probes);
    let fading = (wanted != VelocityTerms::Off && faded > 0.0).then_some((faded, law.lag));
    reasons.extend(explain(&candidates, terms, &mass, budget, speed, fading));
    Ok(Plan { scene, mass, terms, instructions, errors, candidates, reasons })
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

fn models(device: &Device<f64>, probes: &[Probe]) -> Vec<PrecomputedModel> {
    let (points, range) = (max_grid_points(device), shape_range(device, probes));
    let mut models = vec![PrecomputedModel::default(), frozen_model(device, probes)];
    models.extend(mass_table(device, Interpolation::Bilinear, [points; 2], range));
    models.extend(mass_table(device, Interpolation::Bicubic, [points; 2], range));
    models
}

/// Returns the instructions of the slowest control step of a scene, from counts for one wall, a pair of walls, a ball
/// and no wall. Each additional wall adds the difference that a wall of its kind makes.
pub fn cost(device: &Device<f64>, scene: &Scene<f64>, model: &str) -> u32 {
    let name = device.mechanism.kind().spec().name;
    let counted =
        |model: &str, terms: &str| counts::instructions(name, FIRMWARE_TRIGONOMETRY, model, terms).unwrap_or(0);
    let free = counted("exact", "free");
    let z = if scene.velocity_terms == VelocityTerms::Off { "" } else { "+z" };
    let per_wall = counted("exact", "none").saturating_sub(free);
    let walls = scene.walls.len() as u32;
    let shaped: Vec<_> = scene.walls.iter().filter(|wall| wall.feed_forward != FeedForward::Off).collect();
    let curved = scene.walls.iter().any(|wall| wall.surface.is_curved());
    let Some(first) = shaped.first() else { return free + walls * per_wall };
    let one = match first.feed_forward {
        _ if curved => counted(model, &format!("ball, washout{z}")),
        FeedForward::Full if shaped.len() == 1 => counted(model, &format!("feed-forward{z}")),
        _ => counted(model, &format!("washout{z}")),
    };
    let plain = walls - shaped.len() as u32;
    let more = match shaped.len() as u32 {
        1 => 0,
        count => {
            let pair = counted("exact", &format!("edge, washout{z}"));
            pair.saturating_sub(counted("exact", &format!("washout{z}"))) + (count - 2) * per_wall
        }
    };
    one + more + plain * per_wall
}

/// Returns the reasons for a choice. `fading` is the share of fading situations and the velocity lag, s.
fn explain(
    candidates: &[Candidate],
    terms: Terms,
    mass: &PrecomputedModel,
    budget: Budget,
    speed: f64,
    fading: Option<(f64, f64)>,
) -> Vec<String> {
    let find = |model: &str, terms: Terms| candidates.iter().find(|c| c.model == model && c.terms == terms.name());
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
    if let Some(without) = find("exact", Terms::FeedForward) {
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
    if let (Some((share, lag)), Some(whole)) = (fading, find("exact", Terms::FeedForwardZ)) {
        reasons.push(format!(
            "estimated velocities lag by {:.2} ms, so the velocity terms fade where the joints turn fast near a singular pose, in {} of the \
             situations: up to {} of the forces of motion then remain with every mass matrix; a higher rate and cutoff reduce them",
            1.0e3 * lag,
            percent(share),
            newtons(whole.errors.force.max)
        ));
    }
    if let Some(one) = find("frozen", terms) {
        let verdict = match mass.name() {
            "frozen" => "so one matrix is enough",
            _ => "so the matrix must follow the pose",
        };
        let error = size(&one.unfaded_errors);
        reasons.push(format!("one mass matrix for all of the walls is wrong by {error}, {verdict}"));
    }
    if let (Some(exact), Some(table), false) = (find("exact", terms), find("bilinear", terms), mass.name() == "frozen")
    {
        let verdict = if mass.name() == "exact" { "so the closed form is used" } else { "so the table is used" };
        reasons.push(format!(
            "the closed form takes {} instructions, a table {}, {verdict}",
            exact.instructions, table.instructions
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
