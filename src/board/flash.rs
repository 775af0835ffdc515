//! Writes the configuration to flash: settings are staged, then committed together.

use crate::board::configuration::{Configuration, empty_scene};
use crate::board::machine::Machine;
use crate::board::protocol::KeyList;
use crate::board::settings::{self, Entry, Key, Setting};
use crate::safety::refusal::Refusal;

/// Commits the settings staged under these keys together with the rest of the configuration, so that no setting of an
/// older configuration in flash applies after the next start.
#[inline(never)]
pub(super) fn commit_configuration(
    machine: &mut impl Machine,
    next: &Configuration,
    keys: &KeyList,
) -> Result<(), Refusal> {
    let mut all = KeyList::new();
    stage_all(machine, next, &mut all)?;
    // A scene that no longer applies must not return after a restart.
    if let (Some(device), None) = (&next.device, &next.scene)
        && machine.load(Key::Scene).is_some()
    {
        stage(machine, &empty_scene(device), &mut all)?;
    }
    for key in keys {
        if !all.contains(key) {
            // `all` has room for every key.
            let _ = all.push(*key);
        }
    }
    machine.commit(&all)
}

pub(super) fn stage_all(
    machine: &mut impl Machine,
    configuration: &Configuration,
    keys: &mut KeyList,
) -> Result<(), Refusal> {
    let Configuration { device, scene, rules, cogging } = configuration;
    if let Some(device) = device {
        stage(machine, device, keys)?;
    }
    if let Some(scene) = scene {
        stage(machine, scene, keys)?;
    }
    // Potentials of an earlier device must not return after a restart.
    if !cogging.is_empty() || machine.load(Key::Cogging).is_some() {
        stage(machine, cogging, keys)?;
    }
    stage(machine, rules, keys)
}

/// Returns true if flash holds this value. A separate function, so that the entry is on the stack only here.
#[inline(never)]
fn is_in_flash(machine: &mut impl Machine, key: Key, entry: &Entry) -> bool {
    machine.load(key).is_some_and(|old| old == *entry)
}

/// Stages a setting unless flash holds this value already, and adds its key to `keys`.
#[inline(never)]
pub(super) fn stage<S: Setting>(machine: &mut impl Machine, value: &S, keys: &mut KeyList) -> Result<(), Refusal> {
    let entry = settings::encode(value).map_err(|_| Refusal::Flash)?;
    if is_in_flash(machine, S::KEY, &entry) {
        return Ok(());
    }
    machine.stage(S::KEY, &entry)?;
    // `keys` has room for every key.
    let _ = keys.push(S::KEY);
    Ok(())
}

pub(super) fn decode_setting<S: Setting>(entry: &[u8]) -> Result<S, Refusal> {
    settings::decode(entry).map_err(|_| Refusal::BadEntry)
}
