//! Devices between the analysis' double precision and the board's single precision.

use crate::error::Failure;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::AnyMechanism;
use haptic_bridge::render::scene::Scene;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Every number of `value` in the precision of `B`: the fields are written down and read again, so none can be
/// forgotten.
fn converted<A: Serialize, B: DeserializeOwned>(value: &A) -> Result<B, Failure> {
    serde_json::to_value(value)
        .and_then(serde_json::from_value)
        .map_err(|_| Failure::wrong("one of the device's coefficients is not a finite number"))
}

/// The coefficients as the board computes with them.
pub fn rounded(mechanism: &AnyMechanism<f64>) -> Result<AnyMechanism<f32>, Failure> {
    converted(mechanism)
}

/// A scene as the board has it, for the analysis.
pub fn widened_scene(scene: &Scene<f32>) -> Result<Scene<f64>, Failure> {
    converted(scene)
}

/// A device as the board has it, for the analysis.
pub fn widened(device: &Device<f32>) -> Result<Device<f64>, Failure> {
    converted(device)
}
