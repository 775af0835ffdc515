//! The default wall in front of a device for which the user has written no scene.

use crate::plausible::scene::{Contact, Ripple, SOFTEST_WALL, file_warnings, ripple};
use crate::tune::three_digits;
use haptic_bridge::render::scene::{DEFAULT_RATE_HZ, FeedForward, Plane, Scene, Surface, Wall};
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::scene_file::{DEFAULT_CUTOFF_HZ, DEFAULT_WASHOUT_HZ};
use haptic_host::vectors::padded;
use haptic_sim::HandLoop;
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::analysis::prediction::{Prediction, Subject};
use haptic_stability::analysis::sampled::Mode;

/// Distance of the wall from the tip, m.
const WALL_DISTANCE: f64 = 0.006;

/// Penetration at which a first wall may need all of the motors' torque, m. A smaller depth feels like a switch.
const FULL_FORCE_DEPTH: f64 = 1e-3;
/// Share of the allowed ripple that a first wall may have, because other hands also press it.
const RIPPLE_SHARE: f64 = 0.7;
const MAX_REDUCTIONS: usize = 12;

/// A scene of one wall, and the wall's ripple under a hand.
#[derive(Clone, Debug)]
pub struct FirstWall {
    /// The scene.
    pub scene: Scene<f32>,
    /// Ripple of the wall; `None` if it was not simulated.
    pub ripple: Option<Ripple>,
}

/// Returns the scene of [`first_wall`].
pub fn wall_ahead(file: &DeviceFile) -> Result<Scene<f32>, Failure> {
    first_wall(file).map(|first| first.scene)
}

/// Returns a wall in front of the tip at home for which `haptic check` prints no warning: stable, within the motors'
/// torque, and without rattle. The wall is on the side of the tip that a hand can reach.
pub fn first_wall(file: &DeviceFile) -> Result<FirstWall, Failure> {
    let first = first_wall_on(file, 1.0)?;
    if is_touched(file, &first.scene) {
        return Ok(first);
    }
    let other = first_wall_on(file, -1.0)?;
    Ok(if is_touched(file, &other.scene) { other } else { first })
}

/// Returns true if a hand that moves like the hand of `haptic sim` reaches a wall of the scene from home.
fn is_touched(file: &DeviceFile, scene: &Scene<f32>) -> bool {
    let home = file.description.home.unwrap_or_default();
    let pose = TaskPose::at(&file.description, &home[..file.spec().joints]);
    pose.is_ok_and(|pose| HandLoop::find(file, Some(&scene.cast()), padded(&pose.position)).on_a_wall)
}

/// Returns the wall on one side: below the tip if `side` is 1, above the tip if -1.
fn first_wall_on(file: &DeviceFile, side: f64) -> Result<FirstWall, Failure> {
    let stable = stable_wall(file, side)?;
    let subject = Subject::new(&file.description).map_err(Failure::wrong)?;
    // On a redundant arm hardly any stiffness may be stable with a washout.
    for feed_forward in [FeedForward::Washout, FeedForward::Off] {
        let mut scene = stable.clone();
        scene.walls.iter_mut().for_each(|wall| wall.feed_forward = feed_forward);
        for _ in 0..MAX_REDUCTIONS {
            let (warnings, contacts) = file_warnings(&subject, &scene.cast());
            match contacts.first() {
                Some(contact) if warnings.is_empty() => return Ok(soften_until_quiet(file, scene, contact)),
                None if warnings.is_empty() => return Ok(FirstWall { scene, ripple: None }),
                _ => weaken(&mut scene, 0.5, 0.5),
            }
        }
    }
    Ok(FirstWall { scene: stable, ripple: None })
}

/// Makes the wall softer until it is within the motors' torque and does not rattle, if possible.
fn soften_until_quiet(file: &DeviceFile, mut scene: Scene<f32>, contact: &Contact) -> FirstWall {
    let stiffness = |scene: &Scene<f32>| scene.walls.first().map_or(0.0, |wall| f64::from(wall.stiffness));
    let most = contact.force.map_or(f64::INFINITY, |force| force / FULL_FORCE_DEPTH).max(SOFTEST_WALL);
    let factor = (most / stiffness(&scene)).min(1.0);
    weaken(&mut scene, factor, factor);
    for _ in 0..MAX_REDUCTIONS {
        let Some(ripple) = ripple(&file.description, &scene.cast(), contact) else { break };
        let over = ripple.ripple_n.map_or(f64::INFINITY, |ripple_rms| ripple_rms / (RIPPLE_SHARE * ripple.allowed_n));
        if over <= 1.0 {
            break;
        }
        // Ripple grows roughly in proportion to the gains. From the smallest stiffness on, only the damping is reduced.
        let factor = (0.95 / over).clamp(0.25, 0.85);
        let softer = factor.max(SOFTEST_WALL / stiffness(&scene)).min(1.0);
        weaken(&mut scene, softer, factor);
    }
    FirstWall { ripple: ripple(&file.description, &scene.cast(), contact), scene }
}

/// Multiplies stiffness and damping of all walls, and rounds them to three digits.
fn weaken(scene: &mut Scene<f32>, stiffness: f64, damping: f64) {
    for wall in &mut scene.walls {
        wall.stiffness = three_digits(stiffness * f64::from(wall.stiffness), true) as f32;
        wall.damping = three_digits(damping * f64::from(wall.damping), true) as f32;
    }
}

/// Returns a wall in front of the tip at home with half the stiffness that is predicted stable.
fn stable_wall(file: &DeviceFile, side: f64) -> Result<Scene<f32>, Failure> {
    let task = file.spec().task;
    let none = || {
        Failure::wrong(format!("{} has no [home], so there is no pose to start in", file.path.display()))
            .remedy("add one to the device file")
    };
    let home = file.description.home.ok_or_else(none)?;
    let q = &home[..file.spec().joints];
    let pose = TaskPose::at(&file.description, q)?;
    let mut normal = vec![0.0; task];
    normal[usize::from(task > 1)] = side;
    let point = core::array::from_fn(|i| match (pose.position.get(i), normal.get(i)) {
        (Some(place), Some(n)) => (place - WALL_DISTANCE * n) as f32,
        _ => 0.0,
    });
    let normal_f32 = core::array::from_fn(|i| normal.get(i).map_or(0.0, |n| *n as f32));
    let mut wall = Wall {
        surface: Surface::Plane(Plane { point, normal: normal_f32 }),
        stiffness: 0.0,
        damping: 0.0,
        feed_forward: FeedForward::Washout,
        washout_hz: DEFAULT_WASHOUT_HZ as f32,
        damping_compensation: false,
        bilateral: false,
    };
    let mut scene = Scene {
        task: task as u8,
        rate_hz: DEFAULT_RATE_HZ as f32,
        cutoff_hz: DEFAULT_CUTOFF_HZ as f32,
        ..Scene::default()
    };
    let subject = Subject::new(&file.description).map_err(Failure::wrong)?;
    let path = subject.torque_path(DEFAULT_RATE_HZ);
    let Some(prediction) = Prediction::in_scene(&subject, &scene.cast(), None, &path) else { return Ok(scene) };
    let (_, largest_damping) = prediction.stiffness_at(q, &normal, Mode::Off, 0.0)?;
    let damping = 0.2 * largest_damping;
    let (largest_stiffness, _) = prediction.stiffness_at(q, &normal, Mode::Off, damping)?;
    (wall.stiffness, wall.damping) = ((0.5 * largest_stiffness) as f32, damping as f32);
    // The push cannot fail because a scene holds eight walls.
    let _ = scene.walls.push(wall);
    Ok(scene)
}
