//! The settings flash of a board without a chip.

use haptic_bridge::board::settings::{Entry, Key};
use haptic_bridge::safety::refusal::Refusal;
use std::collections::BTreeMap;

/// The entries that count, by their keys, and those that were staged and do not count yet.
#[derive(Clone, Debug, Default)]
pub struct SettingsFlash {
    /// The entries that count: what the next start reads.
    pub kept: BTreeMap<u8, Entry>,
    /// Writing fails from now on.
    pub broken: bool,
    staged: BTreeMap<u8, Entry>,
}

impl SettingsFlash {
    /// A flash that holds these entries.
    pub fn holding(kept: BTreeMap<u8, Entry>) -> Self {
        Self { kept, ..Self::default() }
    }

    /// Puts an entry aside.
    pub fn stage(&mut self, key: Key, entry: &[u8]) -> Result<(), Refusal> {
        if self.broken {
            return Err(Refusal::Flash);
        }
        self.staged.insert(key as u8, Entry::from_slice(entry).map_err(|_| Refusal::Flash)?);
        Ok(())
    }

    /// The entry put aside for a setting.
    pub fn staged(&self, key: Key) -> Option<Entry> {
        self.staged.get(&(key as u8)).cloned()
    }

    /// Makes the staged entries of these settings count, all of them or none, and forgets the others.
    pub fn commit(&mut self, keys: &[Key]) -> Result<(), Refusal> {
        if self.broken || keys.iter().any(|key| !self.staged.contains_key(&(*key as u8))) {
            return Err(Refusal::Flash);
        }
        let staged = std::mem::take(&mut self.staged);
        self.kept.extend(staged.into_iter().filter(|(key, _)| keys.iter().any(|named| *named as u8 == *key)));
        Ok(())
    }

    /// The entry that counts for a setting.
    pub fn load(&self, key: Key) -> Option<Entry> {
        self.kept.get(&(key as u8)).cloned()
    }

    /// Forgets what was staged, as a restart does.
    pub fn restart(&mut self) {
        self.staged.clear();
    }
}
