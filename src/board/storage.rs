//! The settings in flash: a map of one entry per setting, so that adding or removing a setting never loses the others.
//!
//! `sequential-storage` appends entries with checksums and moves to the next page when one is full, which keeps the old
//! or the new value through a power cut at any point; tests/power_cut.rs cuts it at every single flash operation. An
//! entry that is damaged it passes over in silence, for the one before. So every entry carries its generation, and
//! after each write a catalogue of the newest generations follows: an entry older than the catalogue knows is not the
//! one that was saved. A power cut between the two leaves an entry that is newer than that, which is no damage.
//!
//! Nothing here knows a chip: the firmware brings its flash as a [`NorFlash`], tests bring one that fails when told to.

use core::future::Future;
use core::ops::Range;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use embedded_storage_async::nor_flash::NorFlash;
use sequential_storage::cache::key_pointers::ArrayKeyPointers;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage, SerializationError, Value};

/// Longest entry, bytes, its key included.
pub const ENTRY_MAX: usize = 2048;

/// Key of the catalogue. Settings have the keys above it.
const CATALOGUE: u8 = 0;
/// Keys, the catalogue's among them.
const KEYS: usize = 8;

/// A generation: the seven lower bits count, round and round. 0 for an entry that has none, or is not there.
type Generation = u8;
/// Set in every generation, and not in the first byte of an entry of before there were any, which is its key.
const COUNTED: Generation = 0x80;

/// A key's place among all of them.
fn place(key: u8) -> usize {
    usize::from(key) % KEYS
}

/// Whether `found` is of a generation before `known`.
fn older(found: Generation, known: Generation) -> bool {
    known != 0 && (found == 0 || found.wrapping_sub(known) & 0x7F >= 64)
}

/// What is stored: a generation, then the entry.
struct Stamped<'a>(Generation, &'a [u8]);

impl<'a> Value<'a> for Stamped<'a> {
    fn serialize_into(&self, buffer: &mut [u8]) -> Result<usize, SerializationError> {
        let Self(generation, entry) = self;
        let (first, rest) = buffer.split_first_mut().ok_or(SerializationError::BufferTooSmall)?;
        *first = *generation;
        Ok(1 + entry.serialize_into(rest)?)
    }

    fn deserialize_from(buffer: &'a [u8]) -> Result<(Self, usize), SerializationError> {
        let stamped = match buffer {
            [generation, entry @ ..] if generation & COUNTED != 0 => Self(*generation, entry),
            entry => Self(0, entry),
        };
        Ok((stamped, buffer.len()))
    }
}

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
    /// What was saved last is damaged or gone.
    Damaged = 4,
}

impl core::fmt::Display for StorageError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Flash => "the flash refused to erase or to write: try again",
            Self::Full => "the entry does not fit",
            Self::NotKept => "what was written does not read back: the flash is worn",
            Self::Damaged => "what was saved last is damaged: save again",
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

/// Finishes what only waits for a flash that stalls the program: it is never pending.
fn finish<T>(work: impl Future<Output = T>) -> T {
    let mut work = pin!(work);
    loop {
        if let Poll::Ready(done) = work.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
            return done;
        }
    }
}

/// Where the newest entries are: looking through a full sector takes the chip milliseconds for every entry.
type Known = Cache<Uncached, Uncached, ArrayKeyPointers<u8, KEYS>, u8>;

/// The settings' place in a flash.
pub struct Storage<'b, F: NorFlash> {
    map: MapStorage<u8, F, Known>,
    /// Bits of the keys that were searched for in vain.
    absent: u8,
    buffer: &'b mut [u8; ENTRY_MAX],
}

impl<'b, F: NorFlash> Storage<'b, F> {
    /// The settings in `range` of `flash`, at least two pages; reads nothing yet. Panics when the range is not made of
    /// whole pages.
    pub fn new(flash: F, range: Range<u32>, buffer: &'b mut [u8; ENTRY_MAX]) -> Self {
        let known = Cache::new(Uncached, Uncached, ArrayKeyPointers::new());
        Self { map: MapStorage::new(flash, MapConfig::new(range), known), absent: 0, buffer }
    }

    fn fetch(&mut self, key: u8) -> Result<Option<Stamped<'_>>, StorageError> {
        let bit = 1 << place(key);
        if self.absent & bit != 0 {
            return Ok(None);
        }
        let found = finish(self.map.fetch_item(self.buffer, &key))?;
        if found.is_none() {
            self.absent |= bit;
        }
        Ok(found)
    }

    fn store(&mut self, key: u8, item: &Stamped<'_>) -> Result<(), StorageError> {
        self.absent &= !(1 << place(key));
        Ok(finish(self.map.store_item(self.buffer, &key, item))?)
    }

    /// The generation of every key's newest entry, as far as is known.
    fn catalogue(&mut self) -> Result<[Generation; KEYS], StorageError> {
        let found = self.fetch(CATALOGUE)?;
        Ok(found.and_then(|Stamped(_, known)| known.try_into().ok()).unwrap_or_default())
    }

    /// The entry of a setting, `None` when it was never stored. [`StorageError::Damaged`] when only an older one is
    /// left, or none.
    pub fn read(&mut self, key: u8) -> Result<Option<&[u8]>, StorageError> {
        let known = self.catalogue()?[place(key)];
        let found = self.fetch(key)?;
        if older(found.as_ref().map_or(0, |found| found.0), known) {
            return Err(StorageError::Damaged);
        }
        Ok(found.map(|found| found.1))
    }

    /// Stores an entry, unless the same is there already, and reads it back. Stalls the program while the flash works;
    /// bridges off.
    pub fn write(&mut self, key: u8, value: &[u8]) -> Result<(), StorageError> {
        let mut catalogue = self.catalogue()?;
        let known = &mut catalogue[place(key)];
        if let Some(Stamped(found, entry)) = self.fetch(key)? {
            if found == *known && entry == value {
                return Ok(());
            }
            if !older(found, *known) {
                *known = found;
            }
        }
        *known = known.wrapping_add(1) | COUNTED;
        let stamped = Stamped(*known, value);
        self.store(key, &stamped)?;
        self.store(CATALOGUE, &Stamped(COUNTED, &catalogue))?;
        if self.read(key)? == Some(value) { Ok(()) } else { Err(StorageError::NotKept) }
    }

    /// Gives the flash back.
    pub fn into_flash(self) -> F {
        self.map.destroy().0
    }
}
