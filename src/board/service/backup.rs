//! Settings in flash: saved from the configuration, read for a backup, and put back from one.

use super::{Service, check_device, fits};
use crate::board::configuration::{Configuration, task};
use crate::board::flash::{decoded, stage, stage_all};
use crate::board::machine::{Machine, must_be_off};
use crate::board::protocol::{Commit, KeyList, WriteEntry};
use crate::board::settings::{BoardName, Entry, Key, Polarity, Setting};
use crate::control::Rules;
use crate::model::device::Device;
use crate::model::precomputed::MassModelData;
use crate::render::scene::Scene;
use crate::safety::refusal::Refusal;

impl Service {
    /// Writes every setting to flash, or none; motors must be off, because the processor stalls while flash is erased.
    pub fn save(&mut self, machine: &mut impl Machine) -> Result<(), Refusal> {
        must_be_off(machine)?;
        let mut keys = KeyList::new();
        stage_all(machine, &self.configuration, &mut keys)?;
        stage(machine, &BoardName(self.name.clone()), &mut keys)?;
        if keys.is_empty() { Ok(()) } else { machine.commit(&keys) }
    }

    /// A setting as it is in flash.
    pub fn read_entry(&self, machine: &mut impl Machine, key: Key) -> Option<Entry> {
        machine.load(key)
    }

    /// Takes a setting from a backup and puts it aside until [`Service::commit_entries`]. A damaged or unknown one is
    /// refused.
    pub fn stage_entry(&mut self, machine: &mut impl Machine, write: &WriteEntry) -> Result<(), Refusal> {
        must_be_off(machine)?;
        let entry = write.entry.as_slice();
        match write.key {
            Key::Device => decoded::<Device<f32>>(entry).map(drop)?,
            Key::Scene => decoded::<Scene<f32>>(entry).map(drop)?,
            Key::Rules => decoded::<Rules>(entry).map(drop)?,
            Key::MassModel => decoded::<MassModelData>(entry).map(drop)?,
            Key::Polarity => decoded::<Polarity>(entry).map(drop)?,
            Key::Name => decoded::<BoardName>(entry).map(drop)?,
        }
        // Settings staged by a tool that died are not for another tool to commit.
        if self.staged.0 != write.session {
            self.staged = (write.session, KeyList::new());
        }
        self.staged.1.retain(|key| *key != write.key);
        machine.stage(write.key, entry)?;
        // There are as many places as keys.
        let _ = self.staged.1.push(write.key);
        Ok(())
    }

    /// Puts the settings that were staged under these keys in force and into flash: all of them, or none. Settings that
    /// are not named stay as they are, but another device drops the mass model and a scene that does not fit it, and
    /// another scene the mass model. Flash then holds the same, so no limit is in force with a device that it was not
    /// meant for, nor after the next start.
    pub fn commit_entries<Mc: Machine>(&mut self, machine: &mut Mc, commit: &Commit) -> Result<(), Refusal> {
        must_be_off(machine)?;
        let keys = &commit.keys;
        if keys.iter().any(|key| commit.session != self.staged.0 || !self.staged.1.contains(key)) {
            return Err(Refusal::BadEntry);
        }
        let name: Option<BoardName> = self.taken(machine, keys)?;
        let (mut next, same_device) = self.restored(machine, keys)?;
        self.install(machine, &mut next, same_device, Some(keys))?;
        if let Some(BoardName(name)) = name {
            self.name = name;
        }
        if same_device { Ok(()) } else { self.took_device(machine) }
    }

    /// The configuration in force with the settings that were staged under these keys, and whether its device is the
    /// same. A function of its own, so that the decoded settings have left the stack when they are put in force.
    #[inline(never)]
    fn restored<Mc: Machine>(&self, machine: &mut Mc, keys: &KeyList) -> Result<(Configuration, bool), Refusal> {
        let rules: Option<Rules> = self.taken(machine, keys)?;
        let device: Option<Device<f32>> = self.taken(machine, keys)?;
        let scene: Option<Scene<f32>> = self.taken(machine, keys)?;
        let mass: Option<MassModelData> = self.taken(machine, keys)?;

        let rules = rules.unwrap_or(self.configuration.rules);
        self.check_rules(&rules)?;
        if matches!(mass, Some(MassModelData::Table(..))) {
            return Err(Refusal::BadTable);
        }
        if let Some(device) = &device {
            check_device::<Mc::Math>(device)?;
        }
        let same_device = device.is_none();
        let before = &self.configuration;
        let device = device.or_else(|| before.device.clone());
        let (scene, mass) = match &device {
            Some(device) => {
                if let Some(scene) = &scene {
                    scene.check(task(device)).map_err(Refusal::Scene)?;
                }
                // A prepared matrix is for the device and the walls that it was made for.
                let kept = if same_device && scene.is_none() { before.mass.clone() } else { MassModelData::Exact };
                let scene = scene.or_else(|| before.scene.clone().filter(|scene| fits(scene, device)));
                (scene, mass.unwrap_or(kept))
            }
            None if scene.is_some() => return Err(Refusal::NoDevice),
            None => (None, before.mass.clone()),
        };
        Ok((Configuration { device, scene, mass, rules }, same_device))
    }

    /// The staged value of a setting, where its key is among these.
    fn taken<S: Setting>(&self, machine: &mut impl Machine, keys: &KeyList) -> Result<Option<S>, Refusal> {
        if !keys.contains(&S::KEY) {
            return Ok(None);
        }
        let entry = machine.staged(S::KEY).ok_or(Refusal::BadEntry)?;
        decoded(&entry).map(Some)
    }
}
