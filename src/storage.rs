//! The settings in flash: a map of one entry per setting, so that adding or removing a setting never loses the others.
//!
//! `sequential-storage` appends entries with checksums and moves to the next page when one is full, which keeps the old or
//! the new value through a power cut at any point; tests/power_cut.rs cuts it at every single flash operation. Nothing here
//! knows a chip: the firmware brings its flash as a [`NorFlash`], tests bring one that fails when told to.

use core::ops::Range;
use embedded_storage_async::nor_flash::NorFlash;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage};

/// Longest entry, bytes, its key included.
pub const ENTRY_MAX: usize = 2048;

/// What can go wrong with a setting; the chip's log names it by its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum StorageError {
    /// The flash refused to erase or to write.
    Flash = 1,
    /// The entry does not fit.
    Full = 2,
    /// What was written does not read back: worn flash, or an emulated one.
    NotKept = 3,
    /// The region holds nothing that makes sense, and could not be repaired.
    Damaged = 4,
}

impl core::fmt::Display for StorageError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Flash => "the flash refused to erase or to write: try again",
            Self::Full => "the entry does not fit",
            Self::NotKept => "what was written does not read back: the flash is worn",
            Self::Damaged => "the settings' flash holds nothing that makes sense: save again",
        })
    }
}

impl core::error::Error for StorageError {}

impl<E> From<sequential_storage::Error<E>> for StorageError {
    fn from(error: sequential_storage::Error<E>) -> Self {
        match error {
            sequential_storage::Error::Storage { .. } => Self::Flash,
            sequential_storage::Error::Corrupted { .. } => Self::Damaged,
            _ => Self::Full,
        }
    }
}

/// The settings' place in a flash.
pub struct Storage<'b, F: NorFlash> {
    map: MapStorage<u8, F, Cache<Uncached, Uncached, Uncached, u8>>,
    buffer: &'b mut [u8; ENTRY_MAX],
}

impl<'b, F: NorFlash> Storage<'b, F> {
    /// The settings in `range` of `flash`, at least two pages; reads nothing yet. Panics when the range is not made of
    /// whole pages.
    pub fn new(flash: F, range: Range<u32>, buffer: &'b mut [u8; ENTRY_MAX]) -> Self {
        Self { map: MapStorage::new(flash, MapConfig::new(range), Cache::new_uncached()), buffer }
    }

    /// The entry of a setting, `None` when it was never stored. Damaged entries are skipped, which leaves the one before.
    pub async fn read(&mut self, key: u8) -> Result<Option<&[u8]>, StorageError> {
        Ok(self.map.fetch_item::<&[u8]>(self.buffer, &key).await?)
    }

    /// Stores an entry, unless the same is there already, and reads it back. Stalls the program while the flash works;
    /// bridges off.
    pub async fn write(&mut self, key: u8, value: &[u8]) -> Result<(), StorageError> {
        if self.read(key).await? == Some(value) {
            return Ok(());
        }
        self.map.store_item(self.buffer, &key, &value).await?;
        if self.read(key).await? == Some(value) { Ok(()) } else { Err(StorageError::NotKept) }
    }

    /// Gives the flash back.
    pub fn into_flash(self) -> F {
        self.map.destroy().0
    }
}
