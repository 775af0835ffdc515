//! Settings of a board before a measurement, and their restoration.

use super::walls::is_measurement;
use haptic_bridge::board::protocol::{DeviceData, SceneData};
use haptic_bridge::control::Rules;
use haptic_bridge::render::scene::Scene;
use haptic_host::backup::{self, BackupError};
use haptic_host::link::{Board, BoardError, LinkError};
use serde::{Deserialize, Serialize};

/// Device, scene (with its control rate) and rules of a board.
#[derive(Clone, Debug, PartialEq)]
pub struct EarlierSettings {
    device: Option<DeviceData>,
    scene: Option<SceneData>,
    rules: Rules,
}

/// The part of [`EarlierSettings`] that a file stores, for the case that the tool is killed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RestorePoint {
    /// Serial number of the board.
    pub serial: String,
    scene: Option<backup::SavedSetting>,
    rules: backup::SavedSetting,
    /// Rules that the measurement sets. If the board still has them, no user has changed the rules since.
    #[serde(default)]
    measuring: Option<backup::SavedSetting>,
}

impl EarlierSettings {
    /// Reads the present settings of the board.
    pub fn of(board: &mut Board) -> Result<Self, LinkError> {
        Ok(Self { device: board.device()?, scene: board.scene()?, rules: board.rules()? })
    }

    /// Returns the loaded device.
    #[must_use]
    pub fn device(&self) -> Option<&DeviceData> {
        self.device.as_ref()
    }

    /// Returns true if the scene is left over from an interrupted measurement.
    #[must_use]
    pub fn is_of_interrupted_measurement(&self) -> bool {
        self.scene.as_ref().is_some_and(is_measurement)
    }

    /// Returns the part that a file stores: scene and rules of this board, and the rules that the measurement will set.
    #[must_use]
    pub fn restore_point(&self, serial: &str, measuring: &Rules) -> Option<RestorePoint> {
        let scene = match &self.scene {
            Some(scene) => Some(backup::SavedSetting::of(scene)?),
            None => None,
        };
        let (rules, measuring) = (backup::SavedSetting::of(&self.rules)?, backup::SavedSetting::of(measuring));
        Some(RestorePoint { serial: serial.into(), scene, rules, measuring })
    }

    /// Returns the settings from before an interrupted measurement, and true if their rules are those of the file.
    /// Rules that the measurement did not set stay, because a user has set them since.
    pub fn restored_from(&self, restore_point: &RestorePoint) -> Result<(Self, bool), BackupError> {
        let scene = restore_point.scene.as_ref().map(backup::SavedSetting::read::<Scene<f32>>).transpose()?;
        let then = restore_point.rules.read::<Rules>()?;
        let rules = self.with_earlier_rules(restore_point)?.map_or(self.rules, |before| before.rules);
        Ok((Self { scene, rules, ..self.clone() }, rules == then))
    }

    /// Returns these settings with the earlier rules; `None` if the measurement's rules are no longer set.
    pub fn with_earlier_rules(&self, restore_point: &RestorePoint) -> Result<Option<Self>, BackupError> {
        let then = restore_point.rules.read::<Rules>()?;
        let measuring = restore_point.measuring.as_ref().map(backup::SavedSetting::read::<Rules>).transpose()?;
        let left = measuring == Some(self.rules) && then != self.rules;
        Ok(left.then(|| Self { rules: then, ..self.clone() }))
    }

    /// Returns the rules.
    #[must_use]
    pub fn rules(&self) -> &Rules {
        &self.rules
    }

    /// Turns the motors off and restores rules, device and scene that differ, even after an error. A board without a
    /// scene gets an empty one because no request removes a scene. Returns the first error.
    pub fn restore(&self, board: &mut Board) -> Result<(), BoardError> {
        let off = board.disarm();
        let rules = board.set_rules(&self.rules);
        let device = match &self.device {
            // Loads only a different device, because a real board forgets its home when a device is loaded.
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

    /// Returns the names of the board's settings that differ from these settings.
    pub fn differing_settings(&self, board: &mut Board) -> Result<Vec<&'static str>, LinkError> {
        let now = Self::of(board)?;
        let empty = now.scene.as_ref().is_none_or(|scene| scene.walls.is_empty());
        let scene = now.scene == self.scene || (self.scene.is_none() && empty);
        let parts = [("device", now.device == self.device), ("scene", scene), ("rules", now.rules == self.rules)];
        Ok(parts.into_iter().filter(|(_, same)| !same).map(|(name, _)| name).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_torque(torque: f32) -> EarlierSettings {
        let mut rules = Rules::default();
        rules.limits.torque = [torque; 3];
        EarlierSettings { device: None, scene: None, rules }
    }

    #[test]
    fn only_the_rules_of_an_interrupted_measurement_are_replaced() {
        let (before, measuring) = (with_torque(5.0), with_torque(1.0));
        let restore_point = before.restore_point("1", &measuring.rules).unwrap();
        assert_eq!(measuring.restored_from(&restore_point).unwrap(), (before.clone(), true));
        assert_eq!(before.restored_from(&restore_point).unwrap(), (before.clone(), true));
        assert_eq!(measuring.with_earlier_rules(&restore_point).unwrap(), Some(before.clone()));
        assert_eq!(before.with_earlier_rules(&restore_point).unwrap(), None);
        let lowered = with_torque(0.5);
        assert_eq!(lowered.with_earlier_rules(&restore_point).unwrap(), None);
        assert_eq!(lowered.restored_from(&restore_point).unwrap(), (lowered, false));
        // A file of an earlier version does not contain the rules that the measurement set.
        let restore_point = RestorePoint { measuring: None, ..restore_point };
        assert_eq!(measuring.restored_from(&restore_point).unwrap(), (measuring, false));
    }
}
