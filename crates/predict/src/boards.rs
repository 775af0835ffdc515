//! Boards with firmware, and their properties for predictions.

use haptic_bridge::board::protocol::{Details, Info};
use haptic_bridge::model::device::Device;
use haptic_bridge::model::motor::Motor;
use haptic_host::vectors::padded_to;
use haptic_stability::analysis::control_loop::{CARRIER_HZ, CURRENT_LOOP_HZ, TorquePath};
use haptic_stability::analysis::plant::Drive;
use haptic_stability::analysis::pose::TaskPose;

/// Returns delay and lag from encoders to torque of a connected board at its present rate.
#[must_use]
pub fn torque_path(info: &Info, details: &Details) -> TorquePath {
    let bandwidth_hz = (CURRENT_LOOP_HZ * f64::from(details.carrier_hz) / CARRIER_HZ).round();
    let ideal = info.board.as_str() == haptic_sim::IDEAL_BOARD;
    TorquePath {
        delay_samples: (f64::from(details.delay_samples) * 1e6).round() / 1e6,
        drive: if ideal { Drive::Ideal } else { Drive::Current { bandwidth_hz } },
    }
}

/// A board with firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoardKind {
    /// ODrive v3.6 and its clones.
    OdriveV3,
    /// STM32F405 module with three H-bridges.
    HBridgeF405,
    /// ST's Discovery board STM32F407G-DISC1 with three H-bridges.
    HBridgeF407Disc1,
}

impl BoardKind {
    /// All boards in ascending order of axes.
    pub const ALL: [Self; 3] = [Self::OdriveV3, Self::HBridgeF405, Self::HBridgeF407Disc1];

    /// Returns the name that the board reports, which is also the name of its firmware image.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::OdriveV3 => "odrive-v3",
            Self::HBridgeF405 => "h-bridge-f405",
            Self::HBridgeF407Disc1 => "h-bridge-f407-disc1",
        }
    }

    /// Returns the number of motors that the board drives.
    #[must_use]
    pub fn axes(self) -> usize {
        match self {
            Self::OdriveV3 => 2,
            Self::HBridgeF405 | Self::HBridgeF407Disc1 => 3,
        }
    }

    /// Returns the board's default limit of motor current, A. No setting raises this limit.
    #[must_use]
    pub fn max_current(self) -> f64 {
        match self {
            Self::OdriveV3 => 20.0,
            Self::HBridgeF405 | Self::HBridgeF407Disc1 => 12.0,
        }
    }

    /// Returns the board with this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Returns the smallest board that drives a device with this number of joints.
    #[must_use]
    pub fn with_axes(joints: usize) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.axes() >= joints)
    }
}

/// Returns the torque of a motor at rest in a device with this number of joints, N m at the joint. The motor's
/// `max_current`, which `supply` in the file already bounds ([`haptic_host::device_file::DeviceFile`]), and the current
/// of the smallest suitable board limit it. All predicted forces and torques use this function.
#[must_use]
pub fn torque_at_rest(motor: &Motor<f64>, joints: usize) -> f64 {
    let board = BoardKind::with_axes(joints).map_or(f64::INFINITY, BoardKind::max_current);
    motor.torque_constant.abs() * motor.max_current.min(board)
}

/// Returns the largest force of the motors along a direction of d entries, N; `None` if a joint has no motor.
pub fn force_along(device: &Device<f64>, pose: &TaskPose, direction: &[f64]) -> Option<f64> {
    let task = padded_to(pose.jacobian.nrows(), direction);
    let per_newton = pose.jacobian.tr_mul(&task);
    let mut least = f64::INFINITY;
    for (joint, torque) in per_newton.iter().enumerate() {
        let motor = device.joints[joint].motor?;
        least = least.min(torque_at_rest(&motor, device.axes()) / torque.abs().max(1e-12));
    }
    Some(least)
}
