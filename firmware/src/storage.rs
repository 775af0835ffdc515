//! The chip's flash for the stored settings: sectors 1 and 2.
//!
//! A write stalls the program for 16 us per word, and for up to 0.5 s if a sector is erased, so the caller writes only
//! while the bridges are off. Reading a setting never writes.

use embassy_stm32::flash::{Bank1Region1, Blocking, Error as FlashError, Flash};
use embassy_stm32::{Peri, peripherals::FLASH};
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, ReadNorFlash};
use haptic_bridge::board::storage::{self, LONGEST_STORED};
use static_cell::ConstStaticCell;

use crate::clock;

/// Sectors 1 and 2, as offsets into the region of 16 KB sectors (memory.x reserves them).
const SETTINGS_RANGE: core::ops::Range<u32> = 0x4000..0xC000;
pub type Storage = storage::Storage<'static, Sectors>;

/// The flash sectors behind the storage's asynchronous interface. Every operation blocks.
pub struct Sectors(Bank1Region1<'static, Blocking>);

impl ErrorType for Sectors {
    type Error = FlashError;
}

impl ReadNorFlash for Sectors {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        self.0.blocking_read(offset, bytes)
    }

    fn capacity(&self) -> usize {
        SETTINGS_RANGE.end as usize
    }
}

impl NorFlash for Sectors {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 16 * 1024;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        let erased = self.0.blocking_erase(from, to);
        clock::clear_data_cache();
        erased
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        self.0.blocking_write(offset, bytes)
    }
}

/// Creates the storage without reading the flash. Call once.
pub fn open(flash: Peri<'static, FLASH>) -> Storage {
    static BUFFER: ConstStaticCell<[u8; LONGEST_STORED]> = ConstStaticCell::new([0; LONGEST_STORED]);
    let sectors = Sectors(Flash::new_blocking(flash).into_blocking_regions().bank1_region1);
    Storage::new(sectors, SETTINGS_RANGE, BUFFER.take())
}
