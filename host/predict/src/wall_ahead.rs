//! The wall that stands before a device when no scene is named.

use haptic_bridge::render::scene::{DEFAULT_RATE_HZ, FeedForward, Plane, Scene, Surface, Wall};
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::scene_file::{DEFAULT_CUTOFF_HZ, DEFAULT_WASHOUT_HZ};
use haptic_stability::analysis::control_loop::TorquePath;
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::analysis::prediction::{Prediction, Subject};
use haptic_stability::analysis::sampled::Mode;

/// Distance of the wall from the tip, m.
const AHEAD: f64 = 0.006;

/// A wall in front of the tip at home, below it where the device moves in a plane or in space, of half the stiffness
/// that is predicted stable.
pub fn wall_ahead(file: &DeviceFile) -> Result<Scene<f32>, Failure> {
    let task = file.spec().task;
    let none = || {
        Failure::wrong(format!("{} has no [home], so there is no pose to start in", file.path.display()))
            .remedy("add one to the device file")
    };
    let home = file.description.home.ok_or_else(none)?;
    let q = &home[..file.spec().joints];
    let pose = TaskPose::at(&file.description, q)?;
    let mut normal = vec![0.0; task];
    normal[usize::from(task > 1)] = 1.0;
    let point = core::array::from_fn(|i| match (pose.position.get(i), normal.get(i)) {
        (Some(place), Some(n)) => (place - AHEAD * n) as f32,
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
    let (subject, path) =
        (Subject::new(&file.description).map_err(Failure::wrong)?, TorquePath::usual(DEFAULT_RATE_HZ));
    let Some(prediction) = Prediction::in_scene(&subject, &scene.cast(), None, &path) else { return Ok(scene) };
    let (_, most_damping) = prediction.stiffness_at(q, &normal, Mode::Off, 0.0)?;
    let damping = 0.2 * most_damping;
    let (most_stiffness, _) = prediction.stiffness_at(q, &normal, Mode::Off, damping)?;
    (wall.stiffness, wall.damping) = ((0.5 * most_stiffness) as f32, damping as f32);
    // A scene holds eight walls.
    let _ = scene.walls.push(wall);
    Ok(scene)
}
