//! The configuration of a board: a device, the scene rendered on it and its limits.

use crate::control::Rules;
use crate::drive::carrier::RATE_HZ;
use crate::model::cogging::Potentials;
use crate::model::device::Device;
use crate::render::scene::{MAX_RATE_HZ, MIN_RATE_HZ, Scene};

// A scene may have any rate that the carrier supports.
const _: () = assert!(RATE_HZ.0 as f64 == MIN_RATE_HZ && RATE_HZ.1 as f64 == MAX_RATE_HZ);

/// A complete configuration. The service builds the next configuration separately, so that a refusal changes nothing.
#[derive(Clone, Debug)]
pub struct Configuration {
    /// The loaded device.
    pub device: Option<Device<f32>>,
    /// The loaded scene.
    pub scene: Option<Scene<f32>>,
    /// Limits and rules.
    pub rules: Rules,
    /// Potentials of the device's motors.
    pub cogging: Potentials,
}

/// Returns an empty scene for a device without a loaded scene.
pub fn empty_scene(device: &Device<f32>) -> Scene<f32> {
    Scene { task: task(device) as u8, ..Scene::default() }
}

/// Returns the number of dimensions of a device's task space.
pub fn task(device: &Device<f32>) -> usize {
    device.mechanism.kind().spec().task
}
