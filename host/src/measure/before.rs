//! What a board held before a measurement, and whether it holds it again afterwards.

use haptic_bridge::board::protocol::{DeviceData, SceneData};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::servo::Rules;

use crate::link::{Board, BoardError, LinkError};

/// Device, scene (with its control rate) and rules of a board.
#[derive(Clone, Debug, PartialEq)]
pub struct Before {
    device: Option<DeviceData>,
    scene: Option<SceneData>,
    rules: Rules,
}

impl Before {
    /// What the board holds now.
    pub fn of(board: &mut Board) -> Result<Self, LinkError> {
        Ok(Self { device: board.device()?, scene: board.scene()?, rules: board.rules()? })
    }

    /// The device that was loaded.
    #[must_use]
    pub fn device(&self) -> Option<&DeviceData> {
        self.device.as_ref()
    }

    /// The rules that were in force.
    #[must_use]
    pub fn rules(&self) -> &Rules {
        &self.rules
    }

    /// Turns the motors off and puts back what is not as it was: rules, device, scene. Where no scene was loaded there is an
    /// empty one afterwards, as no board forgets a scene. Every part is tried whatever became of the others; the first
    /// error is returned.
    pub fn put_back(&self, board: &mut Board) -> Result<(), BoardError> {
        let off = board.disarm();
        let rules = board.set_rules(&self.rules);
        let device = match &self.device {
            // Loading a device makes a real board forget its homing.
            Some(device) if board.device()?.as_ref() != Some(device) => board.set_device(device),
            _ => Ok(()),
        };
        let scene = match (&self.scene, board.scene()?) {
            (Some(scene), now) if now.as_ref() != Some(scene) => board.set_scene(scene),
            (None, Some(now)) if !now.walls.is_empty() => {
                board.set_scene(&Scene { task: now.task, ..Scene::default() })
            }
            _ => Ok(()),
        };
        off.and(rules).and(device).and(scene)
    }

    /// What is not as it was, in words; nothing where all of it is.
    pub fn missing(&self, board: &mut Board) -> Result<Vec<&'static str>, LinkError> {
        let now = Self::of(board)?;
        let empty = now.scene.as_ref().is_none_or(|scene| scene.walls.is_empty());
        let scene = now.scene == self.scene || (self.scene.is_none() && empty);
        let parts = [("device", now.device == self.device), ("scene", scene), ("rules", now.rules == self.rules)];
        Ok(parts.into_iter().filter(|(_, same)| !same).map(|(name, _)| name).collect())
    }
}
