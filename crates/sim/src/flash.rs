//! The settings flash of a board without a chip.

use haptic_bridge::board::settings::{Entry, Key};
use haptic_bridge::safety::refusal::Refusal;
use std::collections::BTreeMap;

/// The committed entries by key, and staged entries.
#[derive(Clone, Debug, Default)]
pub struct SettingsFlash {
    /// The committed entries, which the board reads at its next start.
    pub committed_entries: BTreeMap<u8, Entry>,
    /// True if writing fails.
    pub fails_writes: bool,
    staged: BTreeMap<u8, Entry>,
}

impl SettingsFlash {
    /// Stages an entry.
    pub fn stage(&mut self, key: Key, entry: &[u8]) -> Result<(), Refusal> {
        if self.fails_writes {
            return Err(Refusal::Flash);
        }
        self.staged.insert(key as u8, Entry::from_slice(entry).map_err(|_| Refusal::Flash)?);
        Ok(())
    }

    /// Returns the staged entry of a setting.
    pub fn staged(&self, key: Key) -> Option<Entry> {
        self.staged.get(&(key as u8)).cloned()
    }
    /// Commits the staged entries of these settings, all or none, and drops the other staged entries.
    pub fn commit(&mut self, keys: &[Key]) -> Result<(), Refusal> {
        if self.fails_writes || keys.iter().any(|key| !self.staged.contains_key(&(*key as u8))) {
            return Err(Refusal::Flash);
        }
        let staged = std::mem::take(&mut self.staged);
        self.committed_entries
            .extend(staged.into_iter().filter(|(key, _)| keys.iter().any(|named| *named as u8 == *key)));
        Ok(())
    }

    /// Returns the committed entry of a setting.
    pub fn load(&self, key: Key) -> Option<Entry> {
        self.committed_entries.get(&(key as u8)).cloned()
    }
    /// Drops staged entries, as a restart does.
    pub fn restart(&mut self) {
        self.staged.clear();
    }
}
