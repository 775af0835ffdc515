//! The settings in flash: a map of one entry per setting in sectors 1 and 2, so that adding or removing a setting never loses
//! the others.
//!
//! `sequential-storage` appends entries with checksums and moves to the other sector when one is full, which keeps the old or
//! the new value through a power cut at any point. Writing stalls the program: 16 us per word, and up to 0.5 s when a sector is
//! erased, so it is done only while the bridges are off; the caller sees to that.

use embassy_stm32::flash::{Bank1Region1, Blocking, Error as FlashError, Flash};
use embassy_stm32::{Peri, peripherals::FLASH};
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage};
use static_cell::ConstStaticCell;

use crate::watchdog;

/// Sectors 1 and 2, as offsets into the region of 16 KB sectors (memory.x reserves them).
const RANGE: core::ops::Range<u32> = 0x4000..0xC000;

/// Longest entry, bytes, its key included.
pub const ENTRY_MAX: usize = 2048;

/// What can go wrong with a setting.
#[derive(Clone, Copy, PartialEq, Eq, Debug, defmt::Format)]
pub enum StorageError {
    /// The flash refused to erase or to write.
    Flash,
    /// The entry does not fit.
    Full,
    /// What was written does not read back: worn flash, or an emulated one.
    NotKept,
    /// The region holds nothing that makes sense, and could not be repaired.
    Damaged,
}

impl From<sequential_storage::Error<FlashError>> for StorageError {
    fn from(error: sequential_storage::Error<FlashError>) -> Self {
        match error {
            sequential_storage::Error::Storage { .. } => Self::Flash,
            sequential_storage::Error::Corrupted { .. } => Self::Damaged,
            _ => Self::Full,
        }
    }
}

/// The flash as the map wants it: asynchronous by name, blocking by nature, and with a watchdog that waits for an erase.
struct Sectors(Bank1Region1<'static, Blocking>);

impl ErrorType for Sectors {
    type Error = FlashError;
}

impl ReadNorFlash for Sectors {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        self.0.blocking_read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        RANGE.end as usize
    }
}

impl NorFlash for Sectors {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 16 * 1024;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        watchdog::patient(|| self.0.blocking_erase(from, to))
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        self.0.blocking_write(offset, bytes)
    }
}

/// The settings' place in flash.
pub struct Storage {
    map: MapStorage<u8, Sectors, Cache<Uncached, Uncached, Uncached, u8>>,
    buffer: &'static mut [u8; ENTRY_MAX],
}

impl Storage {
    /// Takes the flash; reads nothing yet. Call once.
    pub fn new(flash: Peri<'static, FLASH>) -> Self {
        static BUFFER: ConstStaticCell<[u8; ENTRY_MAX]> = ConstStaticCell::new([0; ENTRY_MAX]);
        let sectors = Sectors(Flash::new_blocking(flash).into_blocking_regions().bank1_region1);
        let map = MapStorage::new(sectors, const { MapConfig::new(RANGE) }, Cache::new_uncached());
        Self { map, buffer: BUFFER.take() }
    }

    /// The entry of a setting, `None` when it was never stored. Damaged entries are skipped, which leaves the one before.
    pub async fn read(&mut self, key: u8) -> Result<Option<&[u8]>, StorageError> {
        Ok(self.map.fetch_item::<&[u8]>(self.buffer, &key).await?)
    }

    /// Stores an entry, unless the same is there already, and reads it back. Stalls the program; bridges off.
    pub async fn write(&mut self, key: u8, value: &[u8]) -> Result<(), StorageError> {
        if self.read(key).await? == Some(value) {
            return Ok(());
        }
        self.map.store_item(self.buffer, &key, &value).await?;
        if self.read(key).await? == Some(value) { Ok(()) } else { Err(StorageError::NotKept) }
    }
}
