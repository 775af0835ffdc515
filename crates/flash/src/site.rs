//! The hardware of this computer: boards on serial ports, boot loaders on USB, the clock.

use std::path::Path;
use std::thread::sleep;
use std::time::{Duration, Instant};

use haptic_bridge::board::protocol::{EnterDfu, GetInfo};
use haptic_bridge::board::settings::Key;
use haptic_host::backup::{Backup, RestoreMethod, restore, unsaved_settings};
use haptic_host::link::{Board, BoardError, BoardPort, Client, LinkError, PortSpec, SerialWire, boards};
use haptic_host::output;

use crate::dfuse::UsbError;
use crate::flashing::{BootLoader, Identity, OpenBootLoader, Surroundings};
use crate::usb::{self, UsbBootLoader};

/// Retry interval and longest wait for a board's reply.
const REPLY: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(2));

/// The boards and boot loaders on this computer's USB.
pub struct Bus {
    began: Instant,
}

impl Bus {
    /// Creates the access to this computer's USB.
    pub fn of_this_computer() -> Self {
        Self { began: Instant::now() }
    }
}

/// Returns true if the motors of a running board are on, and the names of the settings that a restart would lose.
/// Returns `None` if the board has another version of the protocol.
pub fn motors_on_and_unsaved_settings(serial: &str) -> Result<Option<(bool, Vec<&'static str>)>, BoardError> {
    let Some(mut board) = open_same_protocol(serial)? else { return Ok(None) };
    let drives = board.status()?.state.drives();
    Ok(Some((drives, unsaved_settings(&mut board)?)))
}

fn open_same_protocol(serial: &str) -> Result<Option<Board>, LinkError> {
    match Board::open(&PortSpec::Serial(serial.into())) {
        Err(LinkError::Version { .. }) => Ok(None),
        board => board.map(Some),
    }
}

/// Opens a client of a board with any protocol version.
fn client(serial: &str) -> Result<Client, String> {
    let port = boards().0.into_iter().find(|board| board.serial == serial);
    let BoardPort { path, .. } = port.ok_or("the board is not on USB any more")?;
    let wire = SerialWire::open(&path);
    let wire =
        wire.map_err(|error| format!("{path} cannot be opened ({error}): close the program that has it open"))?;
    let mut client = Client::new(Box::new(wire));
    client.end_frame().map_err(to_text)?;
    Ok(client)
}

fn to_text(error: impl std::fmt::Display) -> String {
    error.to_string()
}

impl Surroundings for Bus {
    type Loader = UsbBootLoader;
    type Settings = Backup;

    fn boot_loaders(&mut self) -> Result<Vec<BootLoader>, UsbError> {
        usb::boot_loaders()
    }
    fn open(&mut self, which: &BootLoader) -> Result<OpenBootLoader<UsbBootLoader>, UsbError> {
        usb::open(which)
    }
    fn boards(&mut self) -> Vec<String> {
        boards().0.into_iter().map(|board| board.serial).collect()
    }
    fn identify(&mut self, serial: &str) -> Result<Identity, String> {
        let info = client(serial)?.call::<GetInfo>(&(), REPLY).map_err(to_text)?;
        Ok(Identity {
            board: info.board.to_string(),
            firmware: info.firmware.to_string(),
            protocol: info.protocol,
            serial: info.serial.to_string(),
        })
    }

    fn read_settings(&mut self, serial: &str) -> Result<Option<Backup>, String> {
        let board = open_same_protocol(serial).map_err(to_text)?;
        board.map(|mut board| Backup::read(&mut board)).transpose().map_err(to_text)
    }
    fn enter_boot_loader(&mut self, serial: &str) -> Result<(), String> {
        // A board with another protocol version may refuse this request as unknown.
        let outcome = client(serial)?.call::<EnterDfu>(&(), REPLY).map_err(to_text)?;
        outcome.map_err(|refusal| format!("the board refuses: {refusal}"))
    }

    fn restore_settings(&mut self, serial: &str, saved: &Backup) -> Result<Vec<String>, String> {
        restore_settings(serial, saved).map_err(|why| {
            let file = output::unused_path(Path::new(&format!("haptic-backup-{serial}.json")));
            match output::write(&file, saved.to_text().as_bytes(), output::Overwrite::Never) {
                Ok(()) => format!("{why}; the settings are in the backup {}: restore it", file.display()),
                Err(error) => format!("{why}; the settings could not be written to a file either: {error}"),
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

fn restore_settings(serial: &str, saved: &Backup) -> Result<Vec<String>, String> {
    let board = open_same_protocol(serial).map_err(to_text)?;
    board.map_or(Ok(Vec::new()), |mut board| restore_lost_settings(&mut board, saved))
}

/// Restores all settings if the board reports a damaged setting or any setting differs. Returns their names.
pub fn restore_lost_settings(board: &mut Board, saved: &Backup) -> Result<Vec<String>, String> {
    let damaged = board.details().map_err(to_text)?.damage;
    let has = Backup::read(board).map_err(to_text)?;
    let lost = |key: &Key| {
        let was = saved.settings.get(key.name());
        let damaged = damaged.iter().any(|(damaged, _)| damaged == key);
        *key != Key::Polarity && was.is_some() && (damaged || has.settings.get(key.name()) != was)
    };
    if !Key::ALL.iter().any(lost) {
        return Ok(Vec::new());
    }
    // Restores all settings, because a restored device resets the settings that depend on it.
    let ready = saved.prepared_settings().map_err(to_text)?;
    restore(board, &ready).map_err(to_text)?;
    let back = ready.iter().filter(|setting| setting.method != RestoreMethod::NotRestored);
    Ok(back.map(|setting| setting.key.name().to_string()).collect())
}
