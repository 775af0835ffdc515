//! Settings in flash: saved from the configuration, read for a backup, and restored from a backup.

use super::{Service, check_cogging, check_device, scene_fits_device};
use crate::board::configuration::{Configuration, task};
use crate::board::flash::{decode_setting, stage, stage_all};
use crate::board::machine::{Machine, check_motors_off};
use crate::board::protocol::{Commit, KeyList, WriteEntry};
use crate::board::settings::{BoardName, Entry, Key, Polarity, Setting, is_former};
use crate::control::Rules;
use crate::model::cogging::Potentials;
use crate::model::device::Device;
use crate::render::scene::Scene;
use crate::safety::refusal::Refusal;

impl Service {
    /// Writes all settings to flash, or none. The motors must be off, because the processor stalls during an erase.
    pub fn save(&mut self, machine: &mut impl Machine) -> Result<(), Refusal> {
        check_motors_off(machine)?;
        let mut keys = KeyList::new();
        stage_all(machine, &self.configuration, &mut keys)?;
        stage(machine, &BoardName(self.name.clone()), &mut keys)?;
        if keys.is_empty() { Ok(()) } else { machine.commit(&keys) }
    }

    /// Returns the entry of a setting in flash.
    pub fn read_entry(&self, machine: &mut impl Machine, key: Key) -> Option<Entry> {
        machine.load(key).filter(|entry| !is_former(entry))
    }

    /// Stages a setting from a backup until [`Service::commit_entries`]. Refuses a damaged or unknown setting.
    pub fn stage_entry(&mut self, machine: &mut impl Machine, write: &WriteEntry) -> Result<(), Refusal> {
        check_motors_off(machine)?;
        let entry = write.entry.as_slice();
        match write.key {
            Key::Device => decode_setting::<Device<f32>>(entry).map(drop)?,
            Key::Scene => decode_setting::<Scene<f32>>(entry).map(drop)?,
            Key::Rules => decode_setting::<Rules>(entry).map(drop)?,
            Key::Cogging => decode_setting::<Potentials>(entry).map(drop)?,
            Key::Polarity => decode_setting::<Polarity>(entry).map(drop)?,
            Key::Name => decode_setting::<BoardName>(entry).map(drop)?,
        }
        // A tool must not commit the settings that another tool staged.
        if self.staged_entries.0 != write.session {
            self.staged_entries = (write.session, KeyList::new());
        }
        self.staged_entries.1.retain(|key| *key != write.key);
        machine.stage(write.key, entry)?;
        // The list has room for every key.
        let _ = self.staged_entries.1.push(write.key);
        Ok(())
    }

    /// Applies the settings staged under these keys and writes all of them to flash, or none. Other settings stay,
    /// except that another device drops a scene that does not fit. Flash then holds the same configuration, so that
    /// limits apply only to their own device.
    pub fn commit_entries<Mc: Machine>(&mut self, machine: &mut Mc, commit: &Commit) -> Result<(), Refusal> {
        check_motors_off(machine)?;
        let keys = &commit.keys;
        if keys.iter().any(|key| commit.session != self.staged_entries.0 || !self.staged_entries.1.contains(key)) {
            return Err(Refusal::BadEntry);
        }
        let name: Option<BoardName> = self.staged_value(machine, keys)?;
        let (mut next, same_device) = self.restored_configuration(machine, keys)?;
        self.install(machine, &mut next, same_device, Some(keys))?;
        if let Some(BoardName(name)) = name {
            self.name = name;
        }
        match same_device {
            true if keys.contains(&Key::Cogging) => self.send_cogging(machine, false),
            true => Ok(()),
            false => self.finish_device_change(machine),
        }
    }

    /// Returns the present configuration with the settings staged under these keys, and true if the device stays the
    /// same. A separate function, so that the decoded settings leave the stack before they are applied.
    #[inline(never)]
    fn restored_configuration<Mc: Machine>(
        &self,
        machine: &mut Mc,
        keys: &KeyList,
    ) -> Result<(Configuration, bool), Refusal> {
        let rules: Option<Rules> = self.staged_value(machine, keys)?;
        let device: Option<Device<f32>> = self.staged_value(machine, keys)?;
        let scene: Option<Scene<f32>> = self.staged_value(machine, keys)?;
        let cogging: Option<Potentials> = self.staged_value(machine, keys)?;

        let rules = rules.unwrap_or(self.configuration.rules);
        self.check_rules(&rules)?;
        if let Some(device) = &device {
            check_device::<Mc::Math>(device)?;
        }
        let same_device = device.is_none();
        let before = &self.configuration;
        let cogging = match &device {
            Some(device) if before.device.as_ref() != Some(device) => cogging.unwrap_or_default(),
            _ => cogging.unwrap_or_else(|| before.cogging.clone()),
        };
        let device = device.or_else(|| before.device.clone());
        let scene = match &device {
            Some(device) => {
                if let Some(scene) = &scene {
                    scene.check(task(device)).map_err(Refusal::Scene)?;
                }
                scene.or_else(|| before.scene.clone().filter(|scene| scene_fits_device(scene, device)))
            }
            None if scene.is_some() => return Err(Refusal::NoDevice),
            None => None,
        };
        match &device {
            Some(device) => check_cogging(device, &cogging)?,
            None if !cogging.is_empty() => return Err(Refusal::NoDevice),
            None => {}
        }
        Ok((Configuration { device, scene, rules, cogging }, same_device))
    }

    /// Returns the staged value of a setting if `keys` contains its key.
    fn staged_value<S: Setting>(&self, machine: &mut impl Machine, keys: &KeyList) -> Result<Option<S>, Refusal> {
        if !keys.contains(&S::KEY) {
            return Ok(None);
        }
        let entry = machine.staged(S::KEY).ok_or(Refusal::BadEntry)?;
        decode_setting(&entry).map(Some)
    }
}
