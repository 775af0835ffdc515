//! The configuration of a board: a device, the scene rendered on it, its mass matrix and its limits.

use crate::control::Rules;
use crate::drive::carrier::RATE_HZ;
use crate::model::device::Device;
use crate::model::precomputed::MassModelData;
use crate::render::scene::{MAX_RATE_HZ, MIN_RATE_HZ, Scene};

// A scene may ask for any rate that the carrier can give.
const _: () = assert!(RATE_HZ.0 as f64 == MIN_RATE_HZ && RATE_HZ.1 as f64 == MAX_RATE_HZ);

/// A whole configuration. The service makes the next one beside the one in force and swaps them once it is accepted, so
/// a refusal leaves nothing to undo.
#[derive(Clone, Debug)]
pub struct Configuration {
    /// The loaded device.
    pub device: Option<Device<f32>>,
    /// The loaded scene.
    pub scene: Option<Scene<f32>>,
    /// Source of the mass matrix in the step.
    pub mass: MassModelData,
    /// Limits and rules.
    pub rules: Rules,
}

/// The scene of a device that has none yet: nothing to feel.
pub fn nothing_to_feel(device: &Device<f32>) -> Scene<f32> {
    Scene { task: task(device) as u8, ..Scene::default() }
}

/// Dimensions of a device's task space.
pub fn task(device: &Device<f32>) -> usize {
    device.mechanism.kind().spec().task
}
