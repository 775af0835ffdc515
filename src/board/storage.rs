//! The settings in flash: a map of one entry per setting, so that adding or removing a setting never loses the others.
//!
//! `sequential-storage` appends entries with checksums and moves to the next page when one is full, which keeps the old
//! or the new value through a power cut at any point; tests/power_cut.rs cuts it at every single flash operation. It
//! silently skips a damaged entry and returns the one before. So every entry carries its generation, and
//! after each write a catalogue of the newest generations follows: an entry older than the catalogue knows is not the
//! one that was saved. A power cut between the two leaves an entry that is newer than that, which is no damage.
//!
//! Several settings change together, or none does: they are written aside first ([`Storage::stage`]), then a single
//! entry decides that they count ([`Storage::commit`]), and only then do they take their settings' places. Power that
//! goes before the decision leaves the old settings; power that goes after it leaves the decision, which the next
//! start carries out before it reads anything.
//!
//! Nothing here knows a chip: the firmware brings its flash as a [`NorFlash`], tests bring one that fails when told to.

use core::future::Future;
use core::ops::Range;
use core::pin::pin;
use core::task::{Context, Poll, Waker};
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use sequential_storage::cache::key_pointers::ArrayKeyPointers;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage, SerializationError, Value};

/// Longest entry, bytes, its key included.
pub const LONGEST_STORED: usize = 2048;

/// Key of the catalogue.
const CATALOGUE: u8 = 0;
/// Key of the decision: which staged entries count, by their generations; all zeros when none does. Settings have the
/// keys between the two.
pub(super) const DECISION: u8 = 7;
/// The bit that a setting's key has while its entry is staged.
const STAGED: u8 = 8;
const _: () = assert!(DECISION < STAGED && (DECISION as usize) < SETTINGS && 2 * SETTINGS <= KEYS);
/// Keys up to the decision's: places in the catalogue and in the decision.
const SETTINGS: usize = 8;
/// All keys.
const KEYS: usize = 16;

/// A generation: the seven lower bits count, round and round. 0 for an entry that has none, or is not there.
type Generation = u8;
/// Set in every generation, and not in the first byte of an entry of before there were any, which is its key.
const COUNTED: Generation = 0x80;

/// A setting's place in the catalogue and in the decision.
fn place(key: u8) -> usize {
    usize::from(key) % SETTINGS
}

/// The bit of a key.
fn bit(key: u8) -> u16 {
    1 << (usize::from(key) % KEYS)
}

/// The generation after this one.
fn next(generation: Generation) -> Generation {
    generation.wrapping_add(1) | COUNTED
}

/// Returns true if `found` is of a generation before `known`.
fn older(found: Generation, known: Generation) -> bool {
    known != 0 && (found == 0 || found.wrapping_sub(known) & 0x7F >= 64)
}

/// An entry as it is stored: its generation, then its bytes.
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

/// The errors of storing a setting; the chip's log names them by their numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum StorageError {
    /// The flash refused to erase or to write.
    Flash = 1,
    /// The entry does not fit.
    Full = 2,
    /// The entry does not read back as it was written: worn flash, or an emulated one.
    NotKept = 3,
    /// The entry that was saved last is damaged or gone.
    Damaged = 4,
    /// The flash failed in the middle of a decision: the next start shows the old settings or the new ones.
    Unsettled = 5,
}

impl core::fmt::Display for StorageError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Flash => "the flash refused to erase or to write: try again",
            Self::Full => "the entry does not fit",
            Self::NotKept => "what was written does not read back: the flash is worn",
            Self::Damaged => "what was saved last is damaged: save again",
            Self::Unsettled => "the flash failed in the middle of a change: the next start shows what was kept",
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

/// Caches the places of the newest entries: searching a full sector takes the chip milliseconds for every entry.
type Known = Cache<Uncached, Uncached, ArrayKeyPointers<u8, KEYS>, u8>;

/// A flash that is written only where somebody means it: what reads would otherwise erase and write to mend what it
/// finds.
struct Locked<F> {
    flash: F,
    writable: bool,
}

/// Why a [`Locked`] flash does not do it.
#[derive(Debug)]
enum Failure<E> {
    /// The flash itself failed.
    Flash(E),
    /// Writing has not been unlocked.
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

impl<F: NorFlash> ErrorType for Locked<F> {
    type Error = Failure<F::Error>;
}

impl<F: NorFlash> ReadNorFlash for Locked<F> {
    const READ_SIZE: usize = F::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        self.flash.read(offset, bytes).await.map_err(Failure::Flash)
    }

    fn capacity(&self) -> usize {
        self.flash.capacity()
    }
}

impl<F: NorFlash> NorFlash for Locked<F> {
    const WRITE_SIZE: usize = F::WRITE_SIZE;
    const ERASE_SIZE: usize = F::ERASE_SIZE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        if !self.writable {
            return Err(Failure::Locked);
        }
        self.flash.erase(from, to).await.map_err(Failure::Flash)
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        if !self.writable {
            return Err(Failure::Locked);
        }
        self.flash.write(offset, bytes).await.map_err(Failure::Flash)
    }
}

/// The settings' place in a flash.
pub struct Storage<'b, F: NorFlash> {
    map: MapStorage<u8, Locked<F>, Known>,
    /// Bits of the keys that were searched for in vain.
    absent: u16,
    /// Bits of the settings that could not be read when they were last looked for: not searched for again.
    lost: u16,
    /// Generations of what was staged since the start or the last decision.
    staged: [Generation; SETTINGS],
    /// A decision that the power cut short has been looked for, and carried out.
    recovered: bool,
    buffer: &'b mut [u8; LONGEST_STORED],
}

impl<'b, F: NorFlash> Storage<'b, F> {
    /// The settings in `range` of `flash`, at least two pages; reads nothing yet. Panics when the range is not made of
    /// whole pages.
    pub fn new(flash: F, range: Range<u32>, buffer: &'b mut [u8; LONGEST_STORED]) -> Self {
        let known = Cache::new(Uncached, Uncached, ArrayKeyPointers::new());
        Self {
            map: MapStorage::new(Locked { flash, writable: false }, MapConfig::new(range), known),
            absent: 0,
            lost: 0,
            staged: [0; SETTINGS],
            recovered: false,
            buffer,
        }
    }

    /// Mends what a power cut left behind and finds every setting, so that [`Storage::read`] neither writes nor
    /// searches from then on. May erase a sector and look through both many times, so it is called at the start, before
    /// anything else, where nothing waits for it.
    pub fn start(&mut self) {
        let _ = self.while_writable(|_| Ok(()));
    }

    /// The flash itself.
    pub fn flash(&mut self) -> &mut F {
        &mut self.map.flash().flash
    }

    /// Runs an operation that may write, and then locates every entry again: writing moves entries, and a flash that
    /// fails loses track of all of them.
    fn while_writable<T>(
        &mut self,
        work: impl FnOnce(&mut Self) -> Result<T, StorageError>,
    ) -> Result<T, StorageError> {
        self.lost = 0;
        self.map.flash().writable = true;
        let result = work(self);
        // An entry that cannot be read makes the map forget where the rest is: find the rest again, without it.
        loop {
            let before = self.lost;
            for key in 1..DECISION {
                if self.read(key).is_err() {
                    self.lost |= bit(key);
                }
            }
            if self.lost == before {
                break;
            }
        }
        self.map.flash().writable = false;
        result
    }

    fn fetch(&mut self, key: u8) -> Result<Option<Stamped<'_>>, StorageError> {
        if self.absent & bit(key) != 0 {
            return Ok(None);
        }
        let found = finish(self.map.fetch_item(self.buffer, &key))?;
        if found.is_none() {
            self.absent |= bit(key);
        }
        Ok(found)
    }

    fn store(&mut self, key: u8, item: &Stamped<'_>) -> Result<(), StorageError> {
        self.absent &= !bit(key);
        Ok(finish(self.map.store_item(self.buffer, &key, item))?)
    }

    /// The generations in the entry of the catalogue or the decision.
    fn generations(&mut self, key: u8) -> Result<[Generation; SETTINGS], StorageError> {
        let found = self.fetch(key)?;
        Ok(found.and_then(|Stamped(_, known)| known.try_into().ok()).unwrap_or_default())
    }

    /// The entry of a setting, `None` when it was never stored: the staged one where that is decided on and not yet in
    /// its place. Writes nothing, so that it may be asked at any time. [`StorageError::Damaged`] when only an older one
    /// is left, or none, or when it could not be read at the start.
    pub fn read(&mut self, key: u8) -> Result<Option<&[u8]>, StorageError> {
        if self.lost & bit(key) != 0 {
            return Err(StorageError::Damaged);
        }
        let decided = if self.recovered { 0 } else { self.generations(DECISION)?[place(key)] };
        if decided == 0 {
            return self.current(key);
        }
        match self.fetch(STAGED | key)? {
            Some(Stamped(found, entry)) if found == decided => Ok(Some(entry)),
            _ => Err(StorageError::Damaged),
        }
    }

    fn current(&mut self, key: u8) -> Result<Option<&[u8]>, StorageError> {
        let known = self.generations(CATALOGUE)?[place(key)];
        let found = self.fetch(key)?;
        if older(found.as_ref().map_or(0, |found| found.0), known) {
            return Err(StorageError::Damaged);
        }
        Ok(found.map(|found| found.1))
    }

    /// Stores an entry, unless the same is there already, and reads it back. Stalls the program while the flash works;
    /// bridges off.
    pub fn write(&mut self, key: u8, value: &[u8]) -> Result<(), StorageError> {
        self.while_writable(|storage| {
            storage.recover()?;
            storage.put(key, value)
        })
    }

    fn put(&mut self, key: u8, value: &[u8]) -> Result<(), StorageError> {
        let mut catalogue = self.generations(CATALOGUE)?;
        let known = &mut catalogue[place(key)];
        if let Some(Stamped(found, entry)) = self.fetch(key)? {
            if found == *known && entry == value {
                return Ok(());
            }
            if !older(found, *known) {
                *known = found;
            }
        }
        *known = next(*known);
        let stamped = Stamped(*known, value);
        self.store(key, &stamped)?;
        self.store(CATALOGUE, &Stamped(COUNTED, &catalogue))?;
        if self.current(key)? == Some(value) { Ok(()) } else { Err(StorageError::NotKept) }
    }

    /// Writes the next entry of a setting aside; it counts from the [`Storage::commit`] that names it on. Replaces what
    /// was staged for this setting before.
    pub fn stage(&mut self, key: u8, value: &[u8]) -> Result<(), StorageError> {
        self.while_writable(|storage| storage.put_aside(key, value))
    }

    fn put_aside(&mut self, key: u8, value: &[u8]) -> Result<(), StorageError> {
        self.recover()?;
        let aside = STAGED | key;
        let generation = next(self.fetch(aside)?.map_or(0, |found| found.0));
        self.store(aside, &Stamped(generation, value))?;
        match self.fetch(aside)? {
            Some(Stamped(found, entry)) if found == generation && entry == value => {
                self.staged[place(key)] = generation;
                Ok(())
            }
            _ => Err(StorageError::NotKept),
        }
    }

    /// The entry that is staged for a setting.
    pub fn staged(&mut self, key: u8) -> Result<Option<&[u8]>, StorageError> {
        let known = self.staged[place(key)];
        if known == 0 {
            return Ok(None);
        }
        Ok(self.fetch(STAGED | key)?.filter(|found| found.0 == known).map(|found| found.1))
    }

    /// Puts what was staged for these settings in their places, all of them or, when the power goes, none. Errors:
    /// [`StorageError::NotKept`] when one was not staged since the start, [`StorageError::Unsettled`] when the flash
    /// goes on failing; after any other nothing has changed.
    pub fn commit(&mut self, keys: &[u8]) -> Result<(), StorageError> {
        self.while_writable(|storage| storage.decide(keys))
    }

    fn decide(&mut self, keys: &[u8]) -> Result<(), StorageError> {
        self.recover()?;
        let mut decision = [0; SETTINGS];
        for key in keys {
            decision[place(*key)] = self.staged[place(*key)];
            if decision[place(*key)] == 0 {
                return Err(StorageError::NotKept);
            }
        }
        self.staged = [0; SETTINGS];
        // A decision that was not carried out is carried out before anything else is read or written.
        self.recovered = false;
        if let Err(error) = self.store(DECISION, &Stamped(COUNTED, &decision)) {
            // It may be there all the same.
            let taken_back = self.store(DECISION, &Stamped(COUNTED, &[0; SETTINGS]));
            return Err(if taken_back.is_ok() { error } else { StorageError::Unsettled });
        }
        self.recover().or_else(|_| self.recover()).map_err(|_| StorageError::Unsettled)
    }

    /// Carries out a decision that has not been, if there is one.
    fn recover(&mut self) -> Result<(), StorageError> {
        if self.recovered {
            return Ok(());
        }
        let decision = self.generations(DECISION)?;
        for key in (1..DECISION).filter(|key| decision[place(*key)] != 0) {
            self.settle(key, decision[place(key)])?;
        }
        if decision != [0; SETTINGS] {
            self.store(DECISION, &Stamped(COUNTED, &[0; SETTINGS]))?;
        }
        self.recovered = true;
        Ok(())
    }

    /// Puts a staged entry of this generation in its setting's place. If the staged entry has been damaged since, the
    /// setting counts as damaged: the change was decided, so its earlier value no longer counts.
    #[inline(never)]
    fn settle(&mut self, key: u8, generation: Generation) -> Result<(), StorageError> {
        let mut copy = [0; LONGEST_STORED / 2];
        let length = match self.fetch(STAGED | key)? {
            Some(Stamped(found, entry)) if found == generation => {
                copy.get_mut(..entry.len()).ok_or(StorageError::Full)?.copy_from_slice(entry);
                entry.len()
            }
            _ => {
                let mut catalogue = self.generations(CATALOGUE)?;
                let known = &mut catalogue[place(key)];
                *known = next(*known);
                return self.store(CATALOGUE, &Stamped(COUNTED, &catalogue));
            }
        };
        self.put(key, copy.get(..length).unwrap_or_default())
    }
}
