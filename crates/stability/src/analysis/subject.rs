//! The device of a prediction: a board's device and the compliant parts between its motors and links.

use super::control_loop::TorquePath;
use super::flexible::Flexible;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::description::{Description, DescriptionError, Joint};
use haptic_bridge::model::device::Device;
use haptic_host::device_file::DeviceFile;

/// A device for predictions.
#[derive(Clone, Debug)]
pub struct Subject {
    /// The device as it is loaded on a board.
    pub device: Device<f64>,
    /// Joints of the device file, with their compliant parts; `None` without a file, for a rigid device.
    pub joints: Option<[Joint; MAX_JOINTS]>,
}

impl Subject {
    /// Creates the subject from a device description.
    pub fn new(description: &Description) -> Result<Self, DescriptionError> {
        Ok(Self { device: Device::new("", description)?, joints: Some(description.joints) })
    }

    /// Creates the subject for a board's device. Adds the compliant parts if `file` describes the same device.
    #[must_use]
    pub fn on_board(device: Device<f64>, file: Option<&DeviceFile>) -> Self {
        let same = |file: &&DeviceFile| file.device::<f32>().is_ok_and(|described| described == device.cast());
        Self { joints: file.filter(same).map(|file| file.description.joints), device }
    }

    /// Returns the default torque path of a board with this device at this control rate (Hz).
    #[must_use]
    pub fn torque_path(&self, rate_hz: f64) -> TorquePath {
        let usual = TorquePath::usual(rate_hz);
        // The delay without absolute encoders is half a carrier period.
        let age = self.device.angle_age(0.5 / usual.delay_samples * rate_hz);
        TorquePath { delay_samples: usual.delay_samples + age * rate_hz, ..usual }
    }

    /// Removes joint damping.
    #[must_use]
    pub fn undamped(mut self) -> Self {
        self.device.joints.iter_mut().for_each(|joint| joint.viscous = 0.0);
        self
    }

    /// Returns the compliant parts.
    #[must_use]
    pub fn compliant_parts(&self) -> Flexible {
        let joints = self.joints.as_ref().map(|joints| &joints[..self.device.axes()]);
        joints.map_or_else(Flexible::default, |joints| Flexible::default().of_joints(joints))
    }

    /// Returns true if the device has compliant parts.
    #[must_use]
    pub fn is_flexible(&self) -> bool {
        !self.compliant_parts().is_rigid()
    }
}
