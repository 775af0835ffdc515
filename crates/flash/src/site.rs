//! What there is on this computer: boards by their serial ports, boot loaders on USB, the clock.

use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};

use haptic_bridge::board::protocol::{EnterDfu, GetInfo};
use haptic_bridge::board::settings::Key;
use haptic_host::backup::{Backup, Restored, restore, unsaved};
use haptic_host::link::{Board, BoardError, BoardPort, Client, LinkError, PortSpec, SerialWire, boards};
use haptic_host::output;

use crate::dfuse::UsbError;
use crate::sequence::{BootLoader, Opened, Said, Surroundings};
use crate::usb::{self, UsbBootLoader};

/// How long a board may take over an answer.
const ANSWER: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(2));

/// The boards and boot loaders on this computer's USB.
pub struct Bus {
    began: Instant,
}

impl Bus {
    /// This computer's.
    pub fn here() -> Self {
        Self { began: Instant::now() }
    }
}

/// Whether the motors of a running board are on, and what it would forget in a restart. None where it speaks another
/// version of the protocol, in which it cannot be asked.
pub fn motors_and_unsaved(serial: &str) -> Result<Option<(bool, Vec<&'static str>)>, BoardError> {
    let Some(mut board) = of_this_protocol(serial)? else { return Ok(None) };
    let drives = board.status()?.state.drives();
    Ok(Some((drives, unsaved(&mut board)?)))
}

fn of_this_protocol(serial: &str) -> Result<Option<Board>, LinkError> {
    match Board::open(&PortSpec::Serial(serial.into())) {
        Err(LinkError::Version { .. }) => Ok(None),
        board => board.map(Some),
    }
}

/// A client of a board of any protocol.
fn client(serial: &str) -> Result<Client, String> {
    let port = boards().0.into_iter().find(|board| board.serial == serial);
    let BoardPort { path, .. } = port.ok_or("it is not on USB any more")?;
    let wire = SerialWire::open(&path);
    let wire = wire.map_err(|error| format!("{path} cannot be opened ({error}): close what else has it open"))?;
    let mut client = Client::new(Box::new(wire));
    client.end_frame().map_err(text)?;
    Ok(client)
}

fn text(error: impl std::fmt::Display) -> String {
    error.to_string()
}

impl Surroundings for Bus {
    type Loader = UsbBootLoader;
    type Kept = Backup;

    fn boot_loaders(&mut self) -> Result<Vec<BootLoader>, UsbError> {
        usb::boot_loaders()
    }

    fn open(&mut self, which: &BootLoader) -> Result<Opened<UsbBootLoader>, UsbError> {
        usb::open(which)
    }

    fn boards(&mut self) -> Vec<String> {
        boards().0.into_iter().map(|board| board.serial).collect()
    }

    fn ask(&mut self, serial: &str) -> Result<Said, String> {
        let info = client(serial)?.call::<GetInfo>(&(), ANSWER).map_err(text)?;
        Ok(Said {
            board: info.board.to_string(),
            firmware: info.firmware.to_string(),
            protocol: info.protocol,
            serial: info.serial.to_string(),
        })
    }

    fn keep(&mut self, serial: &str) -> Result<Option<Backup>, String> {
        let board = of_this_protocol(serial).map_err(text)?;
        board.map(|mut board| Backup::read(&mut board)).transpose().map_err(text)
    }

    fn enter(&mut self, serial: &str) -> Result<(), String> {
        // The request may have another form in another version of the protocol; then the board does not know it.
        let outcome = client(serial)?.call::<EnterDfu>(&(), ANSWER).map_err(text)?;
        outcome.map_err(|refusal| format!("the board refuses: {refusal}"))
    }

    fn give_back(&mut self, serial: &str, kept: &Backup) -> Result<Vec<String>, String> {
        give_back(serial, kept).map_err(|why| {
            let file = output::unused(Path::new(&format!("haptic-backup-{serial}.json")));
            match output::write(&file, kept.to_text().as_bytes(), output::Overwrite::Never) {
                Ok(()) => format!("{why}; the settings are in {}, a backup to restore", file.display()),
                Err(error) => format!("{why}; nor could they be written to a file: {error}"),
            }
        })
    }

    fn now(&mut self) -> Duration {
        self.began.elapsed()
    }

    fn wait(&mut self, time: Duration) {
        sleep(time);
    }
}

fn give_back(serial: &str, kept: &Backup) -> Result<Vec<String>, String> {
    let board = of_this_protocol(serial).map_err(text)?;
    board.map_or(Ok(Vec::new()), |mut board| put_back(&mut board, kept))
}

/// Puts all settings back where the board reports one of them as damaged, or no longer has it as it was; their names.
pub fn put_back(board: &mut Board, kept: &Backup) -> Result<Vec<String>, String> {
    let damaged = board.details().map_err(text)?.damage;
    let has = Backup::read(board).map_err(text)?;
    let lost = |key: &Key| {
        let was = kept.settings.get(key.name());
        let damaged = damaged.iter().any(|(damaged, _)| damaged == key);
        *key != Key::Polarity && was.is_some() && (damaged || has.settings.get(key.name()) != was)
    };
    if !Key::ALL.iter().any(lost) {
        return Ok(Vec::new());
    }
    // All of them: a device takes with it what belongs to the one before.
    let ready = kept.ready().map_err(text)?;
    restore(board, &ready).map_err(text)?;
    let back = ready.iter().filter(|setting| setting.how != Restored::MadeAnew);
    Ok(back.map(|setting| setting.key.name().to_string()).collect())
}
