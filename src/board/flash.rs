//! The configuration on its way to flash: settings are staged, and then committed together.

use crate::board::configuration::{Configuration, nothing_to_feel};
use crate::board::machine::Machine;
use crate::board::protocol::KeyList;
use crate::board::settings::{self, Entry, Key, Setting};
use crate::model::precomputed::MassModelData;
use crate::safety::refusal::Refusal;

/// Makes what was staged under these keys count, and with it the rest of the configuration: what flash holds of another
/// would be in force beside it after the next start.
#[inline(never)]
pub(super) fn complete(machine: &mut impl Machine, next: &Configuration, keys: &KeyList) -> Result<(), Refusal> {
    let mut all = KeyList::new();
    stage_all(machine, next, &mut all)?;
    // A scene that is no more in force must not come back.
    if let (Some(device), None) = (&next.device, &next.scene)
        && machine.load(Key::Scene).is_some()
    {
        stage(machine, &nothing_to_feel(device), &mut all)?;
    }
    for key in keys {
        if !all.contains(key) {
            // There are as many places as keys.
            let _ = all.push(*key);
        }
    }
    machine.commit(&all)
}

/// Stages a configuration.
pub(super) fn stage_all(
    machine: &mut impl Machine,
    configuration: &Configuration,
    keys: &mut KeyList,
) -> Result<(), Refusal> {
    let Configuration { device, scene, mass, rules } = configuration;
    if let Some(device) = device {
        stage(machine, device, keys)?;
    }
    if let Some(scene) = scene {
        stage(machine, scene, keys)?;
    }
    stage(machine, rules, keys)?;
    // A table is too long for a setting and not kept: after a restart the board uses the closed form.
    match mass {
        MassModelData::Table(..) => stage(machine, &MassModelData::Exact, keys),
        kept => stage(machine, kept, keys),
    }
}

/// Returns true if flash holds this value. It is a function of its own, so that the entry is on the stack only while it
/// is compared.
#[inline(never)]
fn is_kept(machine: &mut impl Machine, key: Key, entry: &Entry) -> bool {
    machine.load(key).is_some_and(|old| old == *entry)
}

/// Stages a setting, unless flash holds this value already, and notes its key.
#[inline(never)]
pub(super) fn stage<S: Setting>(machine: &mut impl Machine, value: &S, keys: &mut KeyList) -> Result<(), Refusal> {
    let entry = settings::encode(value).map_err(|_| Refusal::Flash)?;
    if is_kept(machine, S::KEY, &entry) {
        return Ok(());
    }
    machine.stage(S::KEY, &entry)?;
    // There are as many places as keys.
    let _ = keys.push(S::KEY);
    Ok(())
}

pub(super) fn decoded<S: Setting>(entry: &[u8]) -> Result<S, Refusal> {
    settings::decode(entry).map_err(|_| Refusal::BadEntry)
}
