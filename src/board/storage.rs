//! The settings in flash, as a map with one entry per setting, so that adding or removing a setting never loses others.
//!
//! `sequential-storage` appends entries with checksums and moves to the next page when a page is full. After a power
//! cut at any point, either the old or the new value is left; tests/power_cut.rs cuts the power at every flash
//! operation. The map skips a damaged entry silently and returns the earlier entry. Every entry therefore carries a
//! generation, and a catalogue of the newest generations is written after each entry. An entry with an older generation
//! than in the catalogue is not the saved entry. An entry with a newer generation, after a power cut, is valid.
//!
//! Several settings change together or not at all. They are staged first ([`Storage::stage`]), then a single entry, the
//! decision, makes them valid ([`Storage::commit`]), and only then are they moved to their settings' keys. A power cut
//! before the decision leaves the old settings. After a power cut that follows the decision, the next start carries out
//! the decision before it reads anything.
//!
//! This module does not depend on a chip: firmware and tests pass their flash as a [`NorFlash`].

use core::future::Future;
use core::ops::Range;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use sequential_storage::cache::key_pointers::ArrayKeyPointers;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage, SerializationError, Value};

/// Maximum length of an entry with its key, bytes.
pub const LONGEST_STORED: usize = 2048;

pub(super) const CATALOGUE_KEY: u8 = 0;
/// Key of the decision, which holds the generations of the valid staged entries, or zeros. Keys of settings are lower.
pub(super) const DECISION_KEY: u8 = 7;
/// Bit that marks the key of a staged entry.
const STAGED_BIT: u8 = 8;
const _: () = assert!(DECISION_KEY < STAGED_BIT && (DECISION_KEY as usize) < SETTINGS && 2 * SETTINGS <= KEYS);
/// Number of places in the catalogue and in the decision: one for each key up to [`DECISION_KEY`].
const SETTINGS: usize = 8;
const KEYS: usize = 16;
/// A generation: the seven lower bits count and wrap. 0 for a missing entry and for an entry without generation.
type Generation = u8;
/// Bit that is set in every generation. Entries without generation start with their key, which lacks this bit.
const GENERATION_BIT: Generation = 0x80;

/// Returns a setting's place in the catalogue and in the decision.
fn catalogue_place(key: u8) -> usize {
    usize::from(key) % SETTINGS
}

fn key_bit(key: u8) -> u16 {
    1 << (usize::from(key) % KEYS)
}

fn next_generation(generation: Generation) -> Generation {
    generation.wrapping_add(1) | GENERATION_BIT
}

/// Returns true if generation `found` is before `known`.
fn is_older(found: Generation, known: Generation) -> bool {
    known != 0 && (found == 0 || found.wrapping_sub(known) & 0x7F >= 64)
}

/// An entry as stored: its generation, then its bytes.
struct StampedEntry<'a>(Generation, &'a [u8]);

impl<'a> Value<'a> for StampedEntry<'a> {
    fn serialize_into(&self, buffer: &mut [u8]) -> Result<usize, SerializationError> {
        let Self(generation, entry) = self;
        let (first, rest) = buffer.split_first_mut().ok_or(SerializationError::BufferTooSmall)?;
        *first = *generation;
        Ok(1 + entry.serialize_into(rest)?)
    }

    fn deserialize_from(buffer: &'a [u8]) -> Result<(Self, usize), SerializationError> {
        let stamped = match buffer {
            [generation, entry @ ..] if generation & GENERATION_BIT != 0 => Self(*generation, entry),
            entry => Self(0, entry),
        };
        Ok((stamped, buffer.len()))
    }
}

/// Errors of storing a setting. The chip's log contains their numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum StorageError {
    /// The flash failed to erase or to write.
    Flash = 1,
    /// The entry does not fit.
    Full = 2,
    /// The entry does not read back as written, because the flash is worn or emulated.
    NotKept = 3,
    /// The last saved entry is damaged or missing.
    Damaged = 4,
    /// The flash failed during a decision, so that the old or the new settings apply after the next start.
    Unsettled = 5,
}

impl core::fmt::Display for StorageError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Flash => "the flash failed to erase or to write: try again",
            Self::Full => "the entry does not fit",
            Self::NotKept => "the written entry does not read back: the flash is worn",
            Self::Damaged => "the last saved entry is damaged: save again",
            Self::Unsettled => "the flash failed during a change: the next start shows which settings were kept",
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

/// Runs a future to its end. Futures of flash operations are never pending, because the operations stall the program.
fn block_on<T>(work: impl Future<Output = T>) -> T {
    let mut work = pin!(work);
    loop {
        if let Poll::Ready(done) = work.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
            return done;
        }
    }
}

/// Cache of the newest entries' places, because a search of a full sector takes the chip milliseconds per entry.
type KeyCache = Cache<Uncached, Uncached, ArrayKeyPointers<u8, KEYS>, u8>;

/// A flash that can be written only while unlocked. Without the lock, reads would erase and write to repair damage.
struct LockableFlash<F> {
    flash: F,
    is_writable: bool,
}

#[derive(Debug)]
enum Failure<E> {
    Flash(E),
    Locked,
}

impl<E: NorFlashError> NorFlashError for Failure<E> {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::Flash(error) => error.kind(),
            Self::Locked => NorFlashErrorKind::Other,
        }
    }
}

impl<F: NorFlash> ErrorType for LockableFlash<F> {
    type Error = Failure<F::Error>;
}

impl<F: NorFlash> ReadNorFlash for LockableFlash<F> {
    const READ_SIZE: usize = F::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        self.flash.read(offset, bytes).await.map_err(Failure::Flash)
    }

    fn capacity(&self) -> usize {
        self.flash.capacity()
    }
}

impl<F: NorFlash> NorFlash for LockableFlash<F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        if !self.is_writable {
            return Err(Failure::Locked);
        }
        self.flash.erase(from, to).await.map_err(Failure::Flash)
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        if !self.is_writable {
            return Err(Failure::Locked);
        }
        self.flash.write(offset, bytes).await.map_err(Failure::Flash)
    }
}

/// The settings in a range of a flash.
pub struct Storage<'b, F: NorFlash> {
    map: MapStorage<u8, LockableFlash<F>, KeyCache>,
    /// Bits of the keys that a search did not find.
    absent_keys: u16,
    /// Bits of the settings that the last search could not read. These settings are not searched again.
    unreadable_settings: u16,
    /// Generations of the entries staged since the start or the last decision.
    staged_generations: [Generation; SETTINGS],
    /// True if no decision waits to be carried out.
    is_recovered: bool,
    buffer: &'b mut [u8; LONGEST_STORED],
}

impl<'b, F: NorFlash> Storage<'b, F> {
    /// Creates the storage in `range` of `flash`, at least two pages, without reading. Panics unless the range consists
    /// of entire pages.
    pub fn new(flash: F, range: Range<u32>, buffer: &'b mut [u8; LONGEST_STORED]) -> Self {
        let known = Cache::new(Uncached, Uncached, ArrayKeyPointers::new());
        Self {
            map: MapStorage::new(LockableFlash { flash, is_writable: false }, MapConfig::new(range), known),
            absent_keys: 0,
            unreadable_settings: 0,
            staged_generations: [0; SETTINGS],
            is_recovered: false,
            buffer,
        }
    }

    /// Repairs the effects of a power cut and locates every setting, so that [`Storage::read`] neither writes nor
    /// searches. May erase a sector and search both sectors many times, so call it at the start before other code.
    pub fn start(&mut self) {
        let _ = self.with_writing(|_| Ok(()));
    }

    /// Returns the flash.
    pub fn flash(&mut self) -> &mut F {
        &mut self.map.flash().flash
    }

    /// Runs an operation that may write, then locates every entry again, because writes and flash errors move entries.
    fn with_writing<T>(&mut self, work: impl FnOnce(&mut Self) -> Result<T, StorageError>) -> Result<T, StorageError> {
        self.unreadable_settings = 0;
        self.map.flash().is_writable = true;
        let result = work(self);
        // The map loses all places at an unreadable entry, so the readable entries are located again.
        loop {
            let before = self.unreadable_settings;
            for key in 1..DECISION_KEY {
                if self.read(key).is_err() {
                    self.unreadable_settings |= key_bit(key);
                }
            }
            if self.unreadable_settings == before {
                break;
            }
        }
        self.map.flash().is_writable = false;
        result
    }

    fn fetch(&mut self, key: u8) -> Result<Option<StampedEntry<'_>>, StorageError> {
        if self.absent_keys & key_bit(key) != 0 {
            return Ok(None);
        }
        let entry = block_on(self.map.fetch_item(self.buffer, &key))?;
        if entry.is_none() {
            self.absent_keys |= key_bit(key);
        }
        Ok(entry)
    }

    fn store(&mut self, key: u8, item: &StampedEntry<'_>) -> Result<(), StorageError> {
        self.absent_keys &= !key_bit(key);
        Ok(block_on(self.map.store_item(self.buffer, &key, item))?)
    }

    fn generations(&mut self, key: u8) -> Result<[Generation; SETTINGS], StorageError> {
        let entry = self.fetch(key)?;
        Ok(entry.and_then(|StampedEntry(_, known)| known.try_into().ok()).unwrap_or_default())
    }

    /// Returns the entry of a setting, or its staged entry if the decision has not been carried out yet; `None` if the
    /// setting was never stored. Writes nothing, so call it at any time. Returns [`StorageError::Damaged`] if no entry
    /// or only an older entry is left, or if the start could not read the entry.
    pub fn read(&mut self, key: u8) -> Result<Option<&[u8]>, StorageError> {
        if self.unreadable_settings & key_bit(key) != 0 {
            return Err(StorageError::Damaged);
        }
        let decided = if self.is_recovered { 0 } else { self.generations(DECISION_KEY)?[catalogue_place(key)] };
        if decided == 0 {
            return self.current_entry(key);
        }
        match self.fetch(STAGED_BIT | key)? {
            Some(StampedEntry(found, entry)) if found == decided => Ok(Some(entry)),
            _ => Err(StorageError::Damaged),
        }
    }

    fn current_entry(&mut self, key: u8) -> Result<Option<&[u8]>, StorageError> {
        let known = self.generations(CATALOGUE_KEY)?[catalogue_place(key)];
        let entry = self.fetch(key)?;
        if is_older(entry.as_ref().map_or(0, |entry| entry.0), known) {
            return Err(StorageError::Damaged);
        }
        Ok(entry.map(|entry| entry.1))
    }

    /// Stores an entry that is not stored yet, and reads the entry back. Stalls the program, so bridges must be off.
    pub fn write(&mut self, key: u8, value: &[u8]) -> Result<(), StorageError> {
        self.with_writing(|storage| {
            storage.recover()?;
            storage.write_and_check(key, value)
        })
    }

    fn write_and_check(&mut self, key: u8, value: &[u8]) -> Result<(), StorageError> {
        let mut catalogue = self.generations(CATALOGUE_KEY)?;
        let known = &mut catalogue[catalogue_place(key)];
        if let Some(StampedEntry(found, entry)) = self.fetch(key)? {
            if found == *known && entry == value {
                return Ok(());
            }
            if !is_older(found, *known) {
                *known = found;
            }
        }
        *known = next_generation(*known);
        let stamped = StampedEntry(*known, value);
        self.store(key, &stamped)?;
        self.store(CATALOGUE_KEY, &StampedEntry(GENERATION_BIT, &catalogue))?;
        if self.current_entry(key)? == Some(value) { Ok(()) } else { Err(StorageError::NotKept) }
    }

    /// Stages the next entry of a setting, in place of an earlier staged entry. [`Storage::commit`] makes it valid.
    pub fn stage(&mut self, key: u8, value: &[u8]) -> Result<(), StorageError> {
        self.with_writing(|storage| storage.put_staged(key, value))
    }

    fn put_staged(&mut self, key: u8, value: &[u8]) -> Result<(), StorageError> {
        self.recover()?;
        let staged_key = STAGED_BIT | key;
        let generation = next_generation(self.fetch(staged_key)?.map_or(0, |found| found.0));
        self.store(staged_key, &StampedEntry(generation, value))?;
        match self.fetch(staged_key)? {
            Some(StampedEntry(found, entry)) if found == generation && entry == value => {
                self.staged_generations[catalogue_place(key)] = generation;
                Ok(())
            }
            _ => Err(StorageError::NotKept),
        }
    }

    /// Returns the staged entry of a setting.
    pub fn staged(&mut self, key: u8) -> Result<Option<&[u8]>, StorageError> {
        let known = self.staged_generations[catalogue_place(key)];
        if known == 0 {
            return Ok(None);
        }
        Ok(self.fetch(STAGED_BIT | key)?.filter(|found| found.0 == known).map(|found| found.1))
    }

    /// Makes the staged entries of these settings valid. After a power cut, either all are valid or none. Returns
    /// [`StorageError::NotKept`] if an entry was not staged since the start, [`StorageError::Unsettled`] if the flash
    /// keeps failing. After any other error, nothing has changed.
    pub fn commit(&mut self, keys: &[u8]) -> Result<(), StorageError> {
        self.with_writing(|storage| storage.decide(keys))
    }

    fn decide(&mut self, keys: &[u8]) -> Result<(), StorageError> {
        self.recover()?;
        let mut decision = [0; SETTINGS];
        for key in keys {
            decision[catalogue_place(*key)] = self.staged_generations[catalogue_place(*key)];
            if decision[catalogue_place(*key)] == 0 {
                return Err(StorageError::NotKept);
            }
        }
        self.staged_generations = [0; SETTINGS];
        // A pending decision must be carried out before any other read or write.
        self.is_recovered = false;
        if let Err(error) = self.store(DECISION_KEY, &StampedEntry(GENERATION_BIT, &decision)) {
            // The decision may be stored in spite of the error.
            let taken_back = self.store(DECISION_KEY, &StampedEntry(GENERATION_BIT, &[0; SETTINGS]));
            return Err(if taken_back.is_ok() { error } else { StorageError::Unsettled });
        }
        self.recover().or_else(|_| self.recover()).map_err(|_| StorageError::Unsettled)
    }

    /// Carries out a pending decision, if any.
    fn recover(&mut self) -> Result<(), StorageError> {
        if self.is_recovered {
            return Ok(());
        }
        let decision = self.generations(DECISION_KEY)?;
        for key in (1..DECISION_KEY).filter(|key| decision[catalogue_place(*key)] != 0) {
            self.move_to_setting(key, decision[catalogue_place(key)])?;
        }
        if decision != [0; SETTINGS] {
            self.store(DECISION_KEY, &StampedEntry(GENERATION_BIT, &[0; SETTINGS]))?;
        }
        self.is_recovered = true;
        Ok(())
    }

    /// Moves the staged entry of this generation to its setting's key. If the staged entry is damaged, the setting is
    /// damaged too, because the decision made the earlier value invalid.
    #[inline(never)]
    fn move_to_setting(&mut self, key: u8, generation: Generation) -> Result<(), StorageError> {
        let mut copy = [0; LONGEST_STORED / 2];
        let length = match self.fetch(STAGED_BIT | key)? {
            Some(StampedEntry(found, entry)) if found == generation => {
                copy.get_mut(..entry.len()).ok_or(StorageError::Full)?.copy_from_slice(entry);
                entry.len()
            }
            _ => {
                let mut catalogue = self.generations(CATALOGUE_KEY)?;
                let known = &mut catalogue[catalogue_place(key)];
                *known = next_generation(*known);
                return self.store(CATALOGUE_KEY, &StampedEntry(GENERATION_BIT, &catalogue));
            }
        };
        self.write_and_check(key, copy.get(..length).unwrap_or_default())
    }
}
