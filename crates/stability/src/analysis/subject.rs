//! The device that a prediction is about: what a board knows of it, and what gives between its motors and its links.

use super::flexible::Flexible;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::description::{Description, DescriptionError, Joint};
use haptic_bridge::model::device::Device;
use haptic_host::device_file::DeviceFile;

/// A device as predictions know it.
#[derive(Clone, Debug)]
pub struct Subject {
    /// As a board has it.
    pub device: Device<f64>,
    /// Its joints as the file describes them: their transmissions and structural modes are what a board's device lacks.
    /// `None` where only a board is known; then nothing gives.
    pub joints: Option<[Joint; MAX_JOINTS]>,
}

impl Subject {
    /// The device that a file describes.
    pub fn new(description: &Description) -> Result<Self, DescriptionError> {
        Ok(Self { device: Device::new("", description)?, joints: Some(description.joints) })
    }

    /// The device that a board holds, with what gives in it where `file` describes the same device.
    #[must_use]
    pub fn on_board(device: Device<f64>, file: Option<&DeviceFile>) -> Self {
        let same = |file: &&DeviceFile| file.device::<f32>().is_ok_and(|described| described == device.cast());
        Self { joints: file.filter(same).map(|file| file.description.joints), device }
    }

    /// The same without joint damping.
    #[must_use]
    pub fn undamped(mut self) -> Self {
        self.device.joints.iter_mut().for_each(|joint| joint.viscous = 0.0);
        self
    }

    /// Its compliant parts.
    #[must_use]
    pub fn gives(&self) -> Flexible {
        let joints = self.joints.as_ref().map(|joints| &joints[..self.device.axes()]);
        joints.map_or_else(Flexible::default, |joints| Flexible::default().of_joints(joints))
    }

    /// Returns true if it has compliant parts.
    #[must_use]
    pub fn is_flexible(&self) -> bool {
        !self.gives().is_rigid()
    }
}
