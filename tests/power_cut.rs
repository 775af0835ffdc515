//! The power goes at every single flash operation of a save: afterwards each setting is the old or the new one, and the
//! next save works.
//!
//! The flash is a model of the board's two 16 KB sectors: erasing sets a sector to ones, a write works word by word and
//! can only clear bits. Two kinds of cut are tried at each operation: nothing of it happens (all of the one before
//! did), or half of it happens (half a sector erased, half a word written).

use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};
use haptic_bridge::board::storage::{LONGEST_STORED, Storage, StorageError};
use std::collections::BTreeMap;

const SECTOR: usize = 16 * 1024;
const START: usize = 0x4000;
const RANGE: core::ops::Range<u32> = 0x4000..0xC000;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Cut {
    Before,
    Within,
}

#[derive(Clone)]
struct Sectors {
    bytes: Vec<u8>,
    operations: usize,
    erases: usize,
    /// Bytes that were read.
    bytes_read: usize,
    cut: Option<(usize, Cut)>,
    /// The flash goes on after the cut: it failed, the power did not.
    goes_on: bool,
    dead: bool,
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
            bytes: vec![0xFF; 2 * SECTOR],
            operations: 0,
            erases: 0,
            bytes_read: 0,
            cut: None,
            goes_on: false,
            dead: false,
        }
    }

    /// Counts an operation; how much of it happens.
    fn operate(&mut self) -> Option<Cut> {
        let number = self.operations;
        self.operations += 1;
        if self.dead {
            return Some(Cut::Before);
        }
        match self.cut {
            Some((at, cut)) if at == number => {
                self.dead = !self.goes_on;
                Some(cut)
            }
            _ => None,
        }
    }

    /// Power is back.
    fn reboot(mut self) -> Self {
        self.dead = false;
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
        if self.dead {
            return Err(PowerCut);
        }
        self.bytes_read += bytes.len();
        let from = offset as usize - START;
        bytes.copy_from_slice(&self.bytes[from..from + bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        RANGE.end as usize
    }
}

impl NorFlash for Sectors {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), PowerCut> {
        for sector in (from as usize - START..to as usize - START).step_by(SECTOR) {
            let cut = self.operate();
            self.erases += 1;
            let erased = match cut {
                Some(Cut::Before) => 0,
                Some(Cut::Within) => SECTOR / 2,
                None => SECTOR,
            };
            self.bytes[sector..sector + erased].fill(0xFF);
            if cut.is_some() {
                return Err(PowerCut);
            }
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), PowerCut> {
        let from = offset as usize - START;
        for (i, word) in bytes.chunks(4).enumerate() {
            let at = from + 4 * i;
            let cut = self.operate();
            let written = match cut {
                Some(Cut::Before) => 0,
                Some(Cut::Within) => 2,
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

/// Settings as large as the board's are, of this generation.
fn values(generation: u8) -> Values {
    let sizes = [(1, 420), (2, 760), (3, 100), (4, 40), (5, 12), (6, 24)];
    sizes
        .into_iter()
        .map(|(key, size)| (key, (0..size).map(|i| generation.wrapping_mul(31) ^ i as u8).collect()))
        .collect()
}

fn save(mut flash: Sectors, values: &Values) -> Sectors {
    let mut buffer = [0; LONGEST_STORED];
    let mut storage = Storage::new(&mut flash, RANGE, &mut buffer);
    for (key, value) in values {
        if storage.write(*key, value).is_err() {
            break;
        }
    }
    flash
}

fn read(mut flash: Sectors) -> (Values, Sectors) {
    let mut buffer = [0; LONGEST_STORED];
    let mut storage = Storage::new(&mut flash, RANGE, &mut buffer);
    storage.start();
    let mut found = Values::new();
    for key in 1..=6 {
        if let Some(value) = storage.read(key).expect("the board boots") {
            found.insert(key, value.to_vec());
        }
    }
    (found, flash)
}

/// A flash with `generations` saves behind it.
fn aged(generations: u8) -> Sectors {
    (0..generations).fold(Sectors::new(), |flash, generation| save(flash, &values(generation))).reboot()
}

/// Cuts the power at every operation of the next save; returns how many there are, and how many of them erase.
fn survives(flash: &Sectors, old: &Values, new: &Values) -> (usize, usize) {
    let whole = save(flash.clone(), new);
    let (operations, erases) = (whole.operations, whole.erases);
    assert_eq!(read(whole.reboot()).0, *new);
    for operation in 0..operations {
        for cut in [Cut::Before, Cut::Within] {
            let mut trial = flash.clone();
            trial.cut = Some((operation, cut));
            let (found, after) = read(save(trial, new).reboot());
            for key in 1..=6 {
                let value = found.get(&key);
                assert!(
                    value == old.get(&key) || value == new.get(&key),
                    "operation {operation}, {cut:?}: setting {key} is neither the old nor the new one"
                );
            }
            if cut == Cut::Within {
                let (mended, _) = read(save(after.reboot(), new).reboot());
                assert_eq!(mended, *new, "operation {operation}: the next save");
            }
        }
    }
    (operations, erases)
}

#[test]
fn the_first_save_of_a_new_board_may_be_cut_anywhere() {
    let (operations, _) = survives(&Sectors::new(), &Values::new(), &values(1));
    assert!(operations > 300, "{operations}");
}

#[test]
fn a_save_into_half_a_sector_may_be_cut_anywhere() {
    survives(&aged(3), &values(2), &values(9));
}

#[test]
fn a_save_that_moves_to_the_other_sector_may_be_cut_anywhere() {
    // One setting is saved until its next save erases a sector and carries all the others over.
    let (mut old, mut flash) = (values(1), aged(2));
    for generation in 2..=255 {
        let mut new = old.clone();
        new.insert(2, values(generation)[&2].clone());
        let next = save(flash.clone(), &new);
        if next.erases > 0 {
            let (operations, erases) = survives(&flash, &old, &new);
            assert!(operations > 300 && erases > 0, "{operations} operations");
            return;
        }
        (old, flash) = (new, next.reboot());
    }
    panic!("no save erased a sector");
}

#[test]
fn two_hundred_saves_wear_both_sectors_alike_and_lose_nothing() {
    let mut flash = Sectors::new();
    for generation in 0..200_u32 {
        let now = values(generation as u8);
        flash = save(flash, &now);
        if generation % 97 == 0 {
            let (found, same) = read(flash);
            assert_eq!(found, now, "{generation}");
            flash = same;
        }
    }
    assert!((14..28).contains(&flash.erases), "{} erases in two hundred saves", flash.erases);
}

/// A flash's answer for a setting.
type Asked = Result<Option<Vec<u8>>, StorageError>;

/// The answers of a flash with one bit flipped for each setting, and the flash afterwards.
fn asked(mut flash: Sectors) -> (Vec<Asked>, Sectors) {
    let mut buffer = [0; LONGEST_STORED];
    let mut storage = Storage::new(&mut flash, RANGE, &mut buffer);
    storage.start();
    let found = (1..=6).map(|key| storage.read(key).map(|value| value.map(<[u8]>::to_vec))).collect();
    (found, flash)
}

#[test]
fn a_flipped_bit_is_reported_and_never_brings_back_what_was_saved_before() {
    // With three saves behind the last one, and with none: then nothing is left of what is damaged.
    for generation in [3, 0] {
        let (before, flash, now) = (aged(generation), aged(generation + 1), values(generation));
        let last = |at: &usize| *at >= 4 && before.bytes[*at] != flash.bytes[*at];
        let (mut damaged, mut whole) = (0, 0);
        for (nth, at) in (0..flash.bytes.len()).filter(last).enumerate() {
            let mut spoilt = flash.clone();
            spoilt.bytes[at] ^= 1 << (nth % 8);
            let (found, after) = asked(spoilt);
            for (key, found) in (1..).zip(&found) {
                match found {
                    Err(StorageError::Damaged) => damaged += 1,
                    Ok(Some(value)) if *value == now[&key] => whole += 1,
                    other => panic!("byte {at}: setting {key} is silently {other:?}"),
                }
            }
            let reports = found.iter().filter(|found| found.is_err()).count();
            assert!(reports <= 1, "byte {at}: {reports} settings are lost");
            // The next save puts it right.
            if nth % 50 == 0 {
                assert_eq!(read(save(after.reboot(), &now).reboot()).0, now, "byte {at}");
            }
        }
        // Most bytes belong to one setting; the rest to the catalogue, which is not needed.
        assert!(damaged > 1_300 && whole > 5 * damaged, "{damaged} damaged, {whole} whole");
    }
}

#[test]
fn a_setting_from_before_there_were_generations_is_read_and_replaced() {
    use embassy_futures::block_on;
    use sequential_storage::cache::Cache;
    use sequential_storage::map::{MapConfig, MapStorage};
    let mut map = MapStorage::<u8, _, _>::new(Sectors::new(), MapConfig::new(RANGE), Cache::new_uncached());
    let old: &[u8] = &[1, 2, 40, 41, 42, 43];
    block_on(map.store_item(&mut [0; LONGEST_STORED], &1, &old)).expect("the flash works");
    let (found, flash) = asked(map.destroy().0);
    assert_eq!(found[0], Ok(Some(old.to_vec())));
    let (found, _) = asked(save(flash, &values(5)));
    assert_eq!(found[0], Ok(Some(values(5)[&1].clone())));
}

/// Stages all of these and decides that they count.
fn save_together(mut flash: Sectors, values: &Values) -> Sectors {
    let mut buffer = [0; LONGEST_STORED];
    let mut storage = Storage::new(&mut flash, RANGE, &mut buffer);
    let keys: Vec<u8> = values.keys().copied().collect();
    if values.iter().all(|(key, value)| storage.stage(*key, value).is_ok()) {
        let _ = storage.commit(&keys);
    }
    flash
}

/// Cuts the power at every operation of a joint save; how many there are, and after how many the new values were found.
fn all_or_none(flash: &Sectors, old: &Values, new: &Values) -> (usize, usize) {
    let whole = save_together(flash.clone(), new);
    let operations = whole.operations;
    assert_eq!(read(whole.reboot()).0, *new);
    let mut decided = 0;
    for operation in 0..operations {
        for cut in [Cut::Before, Cut::Within] {
            let mut trial = flash.clone();
            trial.cut = Some((operation, cut));
            let (found, after) = read(save_together(trial, new).reboot());
            assert!(found == *old || found == *new, "operation {operation}, {cut:?}: some settings are old, some new");
            decided += usize::from(found == *new);
            // A second cut while the first one's rest is carried out changes nothing about that.
            if operation % 7 == 0 && cut == Cut::Within {
                let mut again = save_together(Sectors { cut: Some((operation, cut)), ..flash.clone() }, new).reboot();
                again.cut = Some((operation % 50, Cut::Within));
                let mut buffer = [0; LONGEST_STORED];
                let mut storage = Storage::new(&mut again, RANGE, &mut buffer);
                let _ = storage.read(1);
                assert_eq!(read(again.reboot()).0, found, "operation {operation}: a second cut");
                assert_eq!(read(save_together(after.reboot(), new).reboot()).0, *new, "the next save");
            }
        }
    }
    (operations, decided)
}

#[test]
fn settings_that_change_together_are_all_old_or_all_new_wherever_the_power_goes() {
    for (flash, old) in [(Sectors::new(), Values::new()), (aged(3), values(2))] {
        let (operations, decided) = all_or_none(&flash, &old, &values(9));
        assert!(operations > 700, "{operations}");
        assert!(decided > operations / 4 && decided < 2 * operations, "{decided} of {operations} found the new ones");
    }
}

#[test]
fn what_changes_together_while_a_sector_is_erased_is_still_all_or_none() {
    let (mut old, mut flash) = (values(1), save_together(Sectors::new(), &values(1)).reboot());
    for generation in 2..=255 {
        let new = values(generation);
        let next = save_together(flash.clone(), &new);
        if next.erases > 0 {
            all_or_none(&flash, &old, &new);
            return;
        }
        (old, flash) = (new, next.reboot());
    }
    panic!("no save erased a sector");
}

#[test]
fn what_was_staged_and_never_decided_never_counts() {
    let mut buffer = [0; LONGEST_STORED];
    let mut flash = aged(1);
    let mut storage = Storage::new(&mut flash, RANGE, &mut buffer);
    storage.stage(3, &[7; 40]).expect("the flash works");
    assert_eq!(storage.staged(3), Ok(Some(&[7; 40][..])));
    assert_eq!(storage.commit(&[3, 4]), Err(StorageError::NotKept), "4 was not staged");
    let mut flash = flash.reboot();
    assert_eq!(read(flash.clone()).0, values(0));
    let mut storage = Storage::new(&mut flash, RANGE, &mut buffer);
    assert_eq!(storage.staged(3), Ok(None), "what an earlier run staged is forgotten");
    assert_eq!(storage.commit(&[3]), Err(StorageError::NotKept));
}

#[test]
fn a_flash_that_fails_once_says_which_settings_count_and_reading_writes_nothing() {
    let (old, new) = (values(0), values(9));
    let (mut kept, mut went_on) = (0, 0);
    for (operation, cut) in (0..).flat_map(|operation| [(operation, Cut::Before), (operation, Cut::Within)]) {
        let mut flash = Sectors { cut: Some((operation, cut)), goes_on: true, ..aged(1).reboot() };
        let mut buffer = [0; LONGEST_STORED];
        let mut storage = Storage::new(&mut flash, RANGE, &mut buffer);
        if new.iter().any(|(key, value)| storage.stage(*key, value).is_err()) {
            continue;
        }
        let answer = storage.commit(&new.keys().copied().collect::<Vec<_>>());
        if flash.operations <= operation {
            break;
        }
        let operations = flash.operations;
        let (found, flash) = asked(flash);
        assert_eq!(flash.operations, operations, "operation {operation}: a reader wrote");
        let same =
            |wanted: &Values| wanted.values().zip(&found).all(|(value, found)| found == &Ok(Some(value.clone())));
        assert!(same(if answer.is_ok() { &new } else { &old }), "operation {operation}, {cut:?}: {answer:?}");
        match answer {
            Ok(()) => went_on += 1,
            Err(error) => {
                assert_eq!(error, StorageError::Flash);
                kept += 1;
            }
        }
    }
    assert!(went_on > 100 && kept > 1, "{went_on} went on, {kept} kept what was there");
}

/// The reads of the flash that all settings take once.
fn reads(storage: &mut Storage<'_, &mut Sectors>) -> (usize, usize) {
    let so_far = |storage: &mut Storage<'_, &mut Sectors>| (storage.flash().operations, storage.flash().bytes_read);
    let before = so_far(storage);
    (1..=6).for_each(|key| _ = storage.read(key));
    let after = so_far(storage);
    (after.0 - before.0, after.1 - before.1)
}

/// With the motors on the watchdog waits for no search, and nothing may be written: also where a bit has flipped, where
/// a save was cut short, and where some settings were never saved.
#[test]
fn after_the_start_reading_takes_no_search_and_no_write_whatever_the_flash_holds() {
    let whole: usize = values(0).values().map(Vec::len).sum();
    // Every entry with the catalogue before it, their headers, and what looking for them takes.
    let most = 2 * whole;
    let mut flashes = vec![Sectors::new(), aged(9)];
    let aside = |key: &u8| *key != 5;
    flashes.push(save(Sectors::new(), &values(3).into_iter().filter(|(key, _)| aside(key)).collect()));
    let (nine, six) = (aged(9), aged(6));
    for at in (0..2 * SECTOR).step_by(29) {
        let mut spoilt = nine.clone();
        spoilt.bytes[at] ^= 0x10;
        flashes.push(spoilt);
    }
    let saved = save(six.clone(), &values(7)).operations;
    for operation in (0..saved).step_by(3) {
        flashes.push(save(Sectors { cut: Some((operation, Cut::Within)), ..six.clone() }, &values(7)).reboot());
    }
    let count = flashes.len();
    for (nth, mut flash) in flashes.into_iter().enumerate() {
        let mut buffer = [0; LONGEST_STORED];
        let mut storage = Storage::new(&mut flash, RANGE, &mut buffer);
        storage.start();
        for round in 0..3 {
            let (written, read) = reads(&mut storage);
            assert_eq!(written, 0, "flash {nth} of {count}, round {round}: a reader wrote");
            assert!(read < most, "flash {nth} of {count}, round {round}: {read} bytes read, where {most} hold it all");
        }
    }
}

/// A reader does not mend damage that came after the start: neither entries nor sectors that end before they begin,
/// which a start would erase.
#[test]
fn a_flash_that_goes_bad_while_the_board_runs_is_not_mended_by_reading_it() {
    let mut buffer = [0; LONGEST_STORED];
    let mut flash = aged(3);
    let mut storage = Storage::new(&mut flash, RANGE, &mut buffer);
    storage.start();
    storage.write(1, &values(4)[&1]).expect("the flash works");
    for sector in storage.flash().bytes.chunks_mut(SECTOR) {
        sector.fill(0x55);
        sector[..4].fill(0xFF);
        sector[SECTOR - 4..].fill(0x00);
    }
    assert_eq!(reads(&mut storage).0, 0, "a reader wrote");
    assert_eq!(storage.read(1), Err(StorageError::Flash));
    let mut storage = Storage::new(&mut flash, RANGE, &mut buffer);
    let mended = storage.flash().operations;
    storage.start();
    assert!(storage.flash().operations > mended, "a start mends it");
}

#[test]
fn a_staged_entry_that_is_damaged_after_the_decision_is_reported() {
    let whole = save_together(aged(1), &values(9));
    let mut reported = 0;
    for operation in (0..whole.operations).rev() {
        let cut = Sectors { cut: Some((operation, Cut::Before)), ..aged(1) };
        let flash = save_together(cut, &values(9)).reboot();
        if read(flash.clone()).0 != values(9) {
            break;
        }
        // More bytes in a row than any other setting has: where the scene was staged.
        let scene = &values(9)[&2];
        let Some(at) = flash.bytes.windows(500).position(|window| window == &scene[..500]) else { continue };
        let mut spoilt = flash.clone();
        spoilt.bytes[at] ^= 1;
        let (found, _) = asked(spoilt);
        assert!(found[1] != Ok(Some(values(0)[&2].clone())), "operation {operation}: the old scene came back");
        reported += usize::from(found[1] == Err(StorageError::Damaged));
    }
    assert!(reported > 0);
}
