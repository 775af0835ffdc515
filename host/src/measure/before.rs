//! What a board held before a measurement, and whether it holds it again afterwards.

use haptic_bridge::board::protocol::{DeviceData, SceneData};
use haptic_bridge::render::scene::Scene;
use haptic_bridge::servo::Rules;

use super::walls::is_measurement;
use crate::backup::{self, BackupError};
use crate::link::{Board, BoardError, LinkError};
use serde::{Deserialize, Serialize};

/// Device, scene (with its control rate) and rules of a board.
#[derive(Clone, Debug, PartialEq)]
pub struct Before {
    device: Option<DeviceData>,
    scene: Option<SceneData>,
    rules: Rules,
}

/// What a file keeps of it for as long as a measurement runs: a tool that is killed puts nothing back itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    /// Serial number of the board.
    pub serial: String,
    scene: Option<backup::Kept>,
    rules: backup::Kept,
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

    /// Whether the scene is one that a measurement made and, cut short, did not take away again.
    #[must_use]
    pub fn is_left_over(&self) -> bool {
        self.scene.as_ref().is_some_and(is_measurement)
    }

    /// As a file keeps it: the scene and the rules of this board.
    #[must_use]
    pub fn keep(&self, serial: &str) -> Option<Kept> {
        let scene = match &self.scene {
            Some(scene) => Some(backup::Kept::of(scene)?),
            None => None,
        };
        Some(Kept { serial: serial.into(), scene, rules: backup::Kept::of(&self.rules)? })
    }

    /// The same with the scene that was kept before a measurement that was cut short. The rules stay those of now:
    /// somebody may have lowered them meanwhile. Also says whether they are as they were then.
    pub fn with_scene_of(&self, kept: &Kept) -> Result<(Self, bool), BackupError> {
        let scene = kept.scene.as_ref().map(backup::Kept::read::<Scene<f32>>).transpose()?;
        Ok((Self { scene, ..self.clone() }, kept.rules.read::<Rules>()? == self.rules))
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
