//! The power is cut at every flash operation of a save. Afterwards every setting must have its old or its new value,
//! and the next save must work.
//!
//! The flash is a model of the board's two 16 KB sectors. An erase sets a sector to ones. A write works word by word
//! and can only clear bits. Each operation is cut at its start, or halfway (half a sector erased, half a word written).

use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use haptic_bridge::board::storage::{LONGEST_STORED, Storage, StorageError};
use std::collections::BTreeMap;

const SECTOR_BYTES: usize = 16 * 1024;
const FLASH_START: usize = 0x4000;
const FLASH_RANGE: core::ops::Range<u32> = 0x4000..0xC000;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Cut {
    AtStart,
    Halfway,
}

#[derive(Clone)]
struct Sectors {
    bytes: Vec<u8>,
    operations: usize,
    erases: usize,
    bytes_read: usize,
    cut: Option<(usize, Cut)>,
    /// True if only the operation fails at the cut, and the flash works again afterwards.
    keeps_power: bool,
    is_off: bool,
}

#[derive(Debug)]
struct PowerCut;

impl NorFlashError for PowerCut {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl Sectors {
    fn new() -> Self {
        Self {
            bytes: vec![0xFF; 2 * SECTOR_BYTES],
            operations: 0,
            erases: 0,
            bytes_read: 0,
            cut: None,
            keeps_power: false,
            is_off: false,
        }
    }

    /// Counts an operation. Returns the cut that acts on this operation, or `None` if the operation is completed.
    fn begin_operation(&mut self) -> Option<Cut> {
        let number = self.operations;
        self.operations += 1;
        if self.is_off {
            return Some(Cut::AtStart);
        }
        match self.cut {
            Some((at, cut)) if at == number => {
                self.is_off = !self.keeps_power;
                Some(cut)
            }
            _ => None,
        }
    }

    /// Restores the power and resets the counters.
    fn reboot(mut self) -> Self {
        self.is_off = false;
        self.cut = None;
        self.operations = 0;
        self.erases = 0;
        self.bytes_read = 0;
        self
    }
}

impl ErrorType for Sectors {
    type Error = PowerCut;
}

impl ReadNorFlash for Sectors {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), PowerCut> {
        if self.is_off {
            return Err(PowerCut);
        }
        self.bytes_read += bytes.len();
        let from = offset as usize - FLASH_START;
        bytes.copy_from_slice(&self.bytes[from..from + bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        FLASH_RANGE.end as usize
    }
}

impl NorFlash for Sectors {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR_BYTES;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), PowerCut> {
        for sector in (from as usize - FLASH_START..to as usize - FLASH_START).step_by(SECTOR_BYTES) {
            let cut = self.begin_operation();
            self.erases += 1;
            let erased = match cut {
                Some(Cut::AtStart) => 0,
                Some(Cut::Halfway) => SECTOR_BYTES / 2,
                None => SECTOR_BYTES,
            };
            self.bytes[sector..sector + erased].fill(0xFF);
            if cut.is_some() {
                return Err(PowerCut);
            }
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), PowerCut> {
        let from = offset as usize - FLASH_START;
        for (i, word) in bytes.chunks(4).enumerate() {
            let at = from + 4 * i;
            let cut = self.begin_operation();
            let written = match cut {
                Some(Cut::AtStart) => 0,
                Some(Cut::Halfway) => 2,
                None => 4,
            };
            for (cell, byte) in self.bytes[at..].iter_mut().zip(&word[..written]) {
                *cell &= byte;
            }
            if cut.is_some() {
                return Err(PowerCut);
            }
        }
        Ok(())
    }
}

type Values = BTreeMap<u8, Vec<u8>>;

/// Returns settings as large as the board's, with contents that depend on the generation.
fn values_of(generation: u8) -> Values {
    let sizes = [(1, 420), (2, 760), (3, 100), (4, 40), (5, 12), (6, 24)];
    sizes
        .into_iter()
        .map(|(key, size)| (key, (0..size).map(|i| generation.wrapping_mul(31) ^ i as u8).collect()))
        .collect()
}

fn save(mut flash: Sectors, values: &Values) -> Sectors {
    let mut buffer = [0; LONGEST_STORED];
    let mut storage = Storage::new(&mut flash, FLASH_RANGE, &mut buffer);
    for (key, value) in values {
        if storage.write(*key, value).is_err() {
            break;
        }
    }
    flash
}

fn read(mut flash: Sectors) -> (Values, Sectors) {
    let mut buffer = [0; LONGEST_STORED];
    let mut storage = Storage::new(&mut flash, FLASH_RANGE, &mut buffer);
    storage.start();
    let mut found = Values::new();
    for key in 1..=6 {
        if let Some(value) = storage.read(key).expect("the board boots") {
            found.insert(key, value.to_vec());
        }
    }
    (found, flash)
}

fn flash_after_saves(generations: u8) -> Sectors {
    (0..generations).fold(Sectors::new(), |flash, generation| save(flash, &values_of(generation))).reboot()
}

/// Cuts the power at every operation of the next save and checks the settings. Returns the counts of operations and
/// erases.
fn check_every_cut(flash: &Sectors, old: &Values, new: &Values) -> (usize, usize) {
    let complete = save(flash.clone(), new);
    let (operations, erases) = (complete.operations, complete.erases);
    assert_eq!(read(complete.reboot()).0, *new);
    for operation in 0..operations {
        for cut in [Cut::AtStart, Cut::Halfway] {
            let mut trial = flash.clone();
            trial.cut = Some((operation, cut));
            let (found, after) = read(save(trial, new).reboot());
            for key in 1..=6 {
                let value = found.get(&key);
                assert!(
                    value == old.get(&key) || value == new.get(&key),
                    "operation {operation}, {cut:?}: setting {key} has neither its old nor its new value"
                );
            }
            if cut == Cut::Halfway {
                let (saved, _) = read(save(after.reboot(), new).reboot());
                assert_eq!(saved, *new, "operation {operation}: the next save failed");
            }
        }
    }
    (operations, erases)
}

#[test]
fn a_cut_in_the_first_save_of_a_new_board_is_harmless() {
    let (operations, _) = check_every_cut(&Sectors::new(), &Values::new(), &values_of(1));
    assert!(operations > 300, "only {operations} operations");
}

#[test]
fn a_cut_in_a_save_within_a_sector_is_harmless() {
    check_every_cut(&flash_after_saves(3), &values_of(2), &values_of(9));
}

#[test]
fn a_cut_in_a_save_that_changes_the_sector_is_harmless() {
    // Saves one setting until a save erases a sector and copies all other settings.
    let (mut old, mut flash) = (values_of(1), flash_after_saves(2));
    for generation in 2..=255 {
        let mut new = old.clone();
        new.insert(2, values_of(generation)[&2].clone());
        let next = save(flash.clone(), &new);
        if next.erases > 0 {
            let (operations, erases) = check_every_cut(&flash, &old, &new);
            assert!(operations > 300 && erases > 0, "{operations} operations");
            return;
        }
        (old, flash) = (new, next.reboot());
    }
    panic!("no save erased a sector");
}

#[test]
fn two_hundred_saves_wear_both_sectors_equally_and_lose_nothing() {
    let mut flash = Sectors::new();
    for generation in 0..200_u32 {
        let now = values_of(generation as u8);
        flash = save(flash, &now);
        if generation % 97 == 0 {
            let (found, same) = read(flash);
            assert_eq!(found, now, "{generation}");
            flash = same;
        }
    }
    assert!((14..28).contains(&flash.erases), "{} erases in two hundred saves", flash.erases);
}

type ReadResult = Result<Option<Vec<u8>>, StorageError>;

/// Reads every setting after a start. Returns the results and the flash.
fn read_results(mut flash: Sectors) -> (Vec<ReadResult>, Sectors) {
    let mut buffer = [0; LONGEST_STORED];
    let mut storage = Storage::new(&mut flash, FLASH_RANGE, &mut buffer);
    storage.start();
    let found = (1..=6).map(|key| storage.read(key).map(|value| value.map(<[u8]>::to_vec))).collect();
    (found, flash)
}

#[test]
fn a_flipped_bit_is_reported_and_restores_no_older_value() {
    // With generation 3 the damaged setting has older values, with generation 0 it has none.
    for generation in [3, 0] {
        let (before, flash, now) =
            (flash_after_saves(generation), flash_after_saves(generation + 1), values_of(generation));
        let last = |at: &usize| *at >= 4 && before.bytes[*at] != flash.bytes[*at];
        let (mut damaged, mut intact) = (0, 0);
        for (nth, at) in (0..flash.bytes.len()).filter(last).enumerate() {
            let mut spoilt = flash.clone();
            spoilt.bytes[at] ^= 1 << (nth % 8);
            let (found, after) = read_results(spoilt);
            for (key, found) in (1..).zip(&found) {
                match found {
                    Err(StorageError::Damaged) => damaged += 1,
                    Ok(Some(value)) if *value == now[&key] => intact += 1,
                    other => panic!("byte {at}: setting {key} is silently {other:?}"),
                }
            }
            let reports = found.iter().filter(|found| found.is_err()).count();
            assert!(reports <= 1, "byte {at}: {reports} settings are damaged");
            // The next save must repair the setting.
            if nth % 50 == 0 {
                assert_eq!(read(save(after.reboot(), &now).reboot()).0, now, "byte {at}");
            }
        }
        // Most bytes belong to one setting. The others belong to the catalogue, which is not needed.
        assert!(damaged > 1_300 && intact > 5 * damaged, "{damaged} damaged, {intact} intact");
    }
}

#[test]
fn a_setting_without_a_generation_is_read_and_replaced() {
    use embassy_futures::block_on;
    use sequential_storage::cache::Cache;
    use sequential_storage::map::{MapConfig, MapStorage};
    let mut map = MapStorage::<u8, _, _>::new(Sectors::new(), MapConfig::new(FLASH_RANGE), Cache::new_uncached());
    let old: &[u8] = &[1, 2, 40, 41, 42, 43];
    block_on(map.store_item(&mut [0; LONGEST_STORED], &1, &old)).expect("the flash works");
    let (found, flash) = read_results(map.destroy().0);
    assert_eq!(found[0], Ok(Some(old.to_vec())));
    let (found, _) = read_results(save(flash, &values_of(5)));
    assert_eq!(found[0], Ok(Some(values_of(5)[&1].clone())));
}

fn save_together(mut flash: Sectors, values: &Values) -> Sectors {
    let mut buffer = [0; LONGEST_STORED];
    let mut storage = Storage::new(&mut flash, FLASH_RANGE, &mut buffer);
    let keys: Vec<u8> = values.keys().copied().collect();
    if values.iter().all(|(key, value)| storage.stage(*key, value).is_ok()) {
        let _ = storage.commit(&keys);
    }
    flash
}

/// Cuts the power at every operation of a joint save and checks that all values are old or all are new. Returns the
/// number of operations, and the number of cuts after which the values were new.
fn check_all_or_none(flash: &Sectors, old: &Values, new: &Values) -> (usize, usize) {
    let complete = save_together(flash.clone(), new);
    let operations = complete.operations;
    assert_eq!(read(complete.reboot()).0, *new);
    let mut decided = 0;
    for operation in 0..operations {
        for cut in [Cut::AtStart, Cut::Halfway] {
            let mut trial = flash.clone();
            trial.cut = Some((operation, cut));
            let (found, after) = read(save_together(trial, new).reboot());
            assert!(found == *old || found == *new, "operation {operation}, {cut:?}: some settings are old, some new");
            decided += usize::from(found == *new);
            // A second cut, while the board completes the first save, must not change the result.
            if operation % 7 == 0 && cut == Cut::Halfway {
                let mut again = save_together(Sectors { cut: Some((operation, cut)), ..flash.clone() }, new).reboot();
                again.cut = Some((operation % 50, Cut::Halfway));
                let mut buffer = [0; LONGEST_STORED];
                let mut storage = Storage::new(&mut again, FLASH_RANGE, &mut buffer);
                let _ = storage.read(1);
                assert_eq!(read(again.reboot()).0, found, "operation {operation}: a second cut changed the settings");
                assert_eq!(read(save_together(after.reboot(), new).reboot()).0, *new, "the next save failed");
            }
        }
    }
    (operations, decided)
}

#[test]
fn settings_committed_together_are_all_old_or_all_new() {
    for (flash, old) in [(Sectors::new(), Values::new()), (flash_after_saves(3), values_of(2))] {
        let (operations, decided) = check_all_or_none(&flash, &old, &values_of(9));
        assert!(operations > 700, "only {operations} operations");
        assert!(
            decided > operations / 4 && decided < 2 * operations,
            "the new values were read after {decided} cuts of {operations} operations"
        );
    }
}

#[test]
fn a_commit_that_erases_a_sector_is_all_or_none() {
    let (mut old, mut flash) = (values_of(1), save_together(Sectors::new(), &values_of(1)).reboot());
    for generation in 2..=255 {
        let new = values_of(generation);
        let next = save_together(flash.clone(), &new);
        if next.erases > 0 {
            check_all_or_none(&flash, &old, &new);
            return;
        }
        (old, flash) = (new, next.reboot());
    }
    panic!("no save erased a sector");
}

#[test]
fn staged_settings_without_a_commit_are_not_used() {
    let mut buffer = [0; LONGEST_STORED];
    let mut flash = flash_after_saves(1);
    let mut storage = Storage::new(&mut flash, FLASH_RANGE, &mut buffer);
    storage.stage(3, &[7; 40]).expect("the flash works");
    assert_eq!(storage.staged(3), Ok(Some(&[7; 40][..])));
    assert_eq!(storage.commit(&[3, 4]), Err(StorageError::NotKept), "4 was not staged");
    let mut flash = flash.reboot();
    assert_eq!(read(flash.clone()).0, values_of(0));
    let mut storage = Storage::new(&mut flash, FLASH_RANGE, &mut buffer);
    assert_eq!(storage.staged(3), Ok(None), "entries that were staged before a reboot are discarded");
    assert_eq!(storage.commit(&[3]), Err(StorageError::NotKept));
}

#[test]
fn a_commit_reports_the_settings_in_force_after_a_flash_failure() {
    let (old, new) = (values_of(0), values_of(9));
    let (mut kept, mut completed) = (0, 0);
    for (operation, cut) in (0..).flat_map(|operation| [(operation, Cut::AtStart), (operation, Cut::Halfway)]) {
        let mut flash = Sectors { cut: Some((operation, cut)), keeps_power: true, ..flash_after_saves(1).reboot() };
        let mut buffer = [0; LONGEST_STORED];
        let mut storage = Storage::new(&mut flash, FLASH_RANGE, &mut buffer);
        if new.iter().any(|(key, value)| storage.stage(*key, value).is_err()) {
            continue;
        }
        let result = storage.commit(&new.keys().copied().collect::<Vec<_>>());
        if flash.operations <= operation {
            break;
        }
        let operations = flash.operations;
        let (found, flash) = read_results(flash);
        assert_eq!(flash.operations, operations, "operation {operation}: a reader wrote");
        let equal =
            |wanted: &Values| wanted.values().zip(&found).all(|(value, found)| found == &Ok(Some(value.clone())));
        assert!(equal(if result.is_ok() { &new } else { &old }), "operation {operation}, {cut:?}: {result:?}");
        match result {
            Ok(()) => completed += 1,
            Err(error) => {
                assert_eq!(error, StorageError::Flash);
                kept += 1;
            }
        }
    }
    assert!(completed > 100 && kept > 1, "{completed} commits completed, {kept} kept the old settings");
}

/// Reads all settings once. Returns the number of writes and the number of bytes read.
fn count_reads(storage: &mut Storage<'_, &mut Sectors>) -> (usize, usize) {
    let so_far = |storage: &mut Storage<'_, &mut Sectors>| (storage.flash().operations, storage.flash().bytes_read);
    let before = so_far(storage);
    (1..=6).for_each(|key| _ = storage.read(key));
    let after = so_far(storage);
    (after.0 - before.0, after.1 - before.1)
}

/// While the motors are on, the watchdog leaves no time for a search, and flash must not be written. This must hold
/// after a flipped bit, after a cut save, and with settings that were never saved.
#[test]
fn after_the_start_a_read_needs_no_search_and_no_write() {
    let whole: usize = values_of(0).values().map(Vec::len).sum();
    // A read covers every entry, the catalogue before the entry, their headers, and the bytes read to find them.
    let max_bytes = 2 * whole;
    let mut flashes = vec![Sectors::new(), flash_after_saves(9)];
    let is_saved = |key: &u8| *key != 5;
    flashes.push(save(Sectors::new(), &values_of(3).into_iter().filter(|(key, _)| is_saved(key)).collect()));
    let (nine, six) = (flash_after_saves(9), flash_after_saves(6));
    for at in (0..2 * SECTOR_BYTES).step_by(29) {
        let mut spoilt = nine.clone();
        spoilt.bytes[at] ^= 0x10;
        flashes.push(spoilt);
    }
    let saved = save(six.clone(), &values_of(7)).operations;
    for operation in (0..saved).step_by(3) {
        flashes.push(save(Sectors { cut: Some((operation, Cut::Halfway)), ..six.clone() }, &values_of(7)).reboot());
    }
    let count = flashes.len();
    for (nth, mut flash) in flashes.into_iter().enumerate() {
        let mut buffer = [0; LONGEST_STORED];
        let mut storage = Storage::new(&mut flash, FLASH_RANGE, &mut buffer);
        storage.start();
        for round in 0..3 {
            let (written, read) = count_reads(&mut storage);
            assert_eq!(written, 0, "flash {nth} of {count}, round {round}: a reader wrote");
            assert!(
                read < max_bytes,
                "flash {nth} of {count}, round {round}: {read} bytes read, at most {max_bytes} are needed"
            );
        }
    }
}

/// After the start a read repairs no entry, and no sector with an end mark but no start mark (a start would erase it).
#[test]
fn a_read_does_not_repair_damage_after_the_start() {
    let mut buffer = [0; LONGEST_STORED];
    let mut flash = flash_after_saves(3);
    let mut storage = Storage::new(&mut flash, FLASH_RANGE, &mut buffer);
    storage.start();
    storage.write(1, &values_of(4)[&1]).expect("the flash works");
    for sector in storage.flash().bytes.chunks_mut(SECTOR_BYTES) {
        sector.fill(0x55);
        sector[..4].fill(0xFF);
        sector[SECTOR_BYTES - 4..].fill(0x00);
    }
    assert_eq!(count_reads(&mut storage).0, 0, "a reader wrote");
    assert_eq!(storage.read(1), Err(StorageError::Flash));
    let mut storage = Storage::new(&mut flash, FLASH_RANGE, &mut buffer);
    let before = storage.flash().operations;
    storage.start();
    assert!(storage.flash().operations > before, "a start repairs the damage");
}

#[test]
fn a_staged_entry_damaged_after_the_commit_is_reported() {
    let complete = save_together(flash_after_saves(1), &values_of(9));
    let mut reported = 0;
    for operation in (0..complete.operations).rev() {
        let cut = Sectors { cut: Some((operation, Cut::AtStart)), ..flash_after_saves(1) };
        let flash = save_together(cut, &values_of(9)).reboot();
        if read(flash.clone()).0 != values_of(9) {
            break;
        }
        // The first 500 bytes identify the staged scene, because the other settings are shorter.
        let scene = &values_of(9)[&2];
        let Some(at) = flash.bytes.windows(500).position(|window| window == &scene[..500]) else { continue };
        let mut spoilt = flash.clone();
        spoilt.bytes[at] ^= 1;
        let (found, _) = read_results(spoilt);
        assert!(found[1] != Ok(Some(values_of(0)[&2].clone())), "operation {operation}: the old scene came back");
        reported += usize::from(found[1] == Err(StorageError::Damaged));
    }
    assert!(reported > 0);
}
