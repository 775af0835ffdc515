//! Flashes a board, running or in its boot loader, in the order of [`Phase`].
//!
//! After any interruption the board has its complete old image, the complete new image, or no image that starts and
//! arms ([`crate::flash_sequence`]). The error reports the case and the remedy.

use std::fmt;
use std::time::Duration;

use crate::dfuse::{DfuError, Dfuse, Transport, UsbError};
use crate::flash_sequence::{Block, Misfit, flash_sequence};
use crate::image::{BadImage, FLASH_START, Image, SETTINGS};
use crate::layout::{BadLayout, Layout};

/// The identity that a running board reports.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Kind of board.
    pub board: String,
    /// Version of the firmware.
    pub firmware: String,
    /// Version of the protocol.
    pub protocol: u16,
    /// Serial number.
    pub serial: String,
}

/// A boot loader on USB.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BootLoader {
    /// Serial number, equal to the firmware's serial number on the same chip.
    pub serial: String,
}

/// The board to flash.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FlashTarget {
    /// A board whose firmware is running.
    Running(Identity),
    /// A board in its boot loader, which does not report the kind of board.
    BootLoader(BootLoader),
}

/// An open boot loader.
pub struct OpenBootLoader<L> {
    /// The connection to the boot loader.
    pub loader: L,
    /// The boot loader's description of the flash.
    pub memory: String,
    /// Maximum size of one transfer, bytes.
    pub transfer: u16,
}

/// The USB bus with its boards, and a clock.
pub trait Surroundings {
    /// A connection to a boot loader.
    type Loader: Transport;
    /// The settings of a board.
    type Settings;

    /// Lists the boot loaders.
    fn boot_loaders(&mut self) -> Result<Vec<BootLoader>, UsbError>;
    /// Opens a boot loader.
    fn open(&mut self, which: &BootLoader) -> Result<OpenBootLoader<Self::Loader>, UsbError>;
    /// Returns the serial numbers of the running boards.
    fn boards(&mut self) -> Vec<String>;
    /// Reads the identity of a running board, or returns the reason of a failure.
    fn identify(&mut self, serial: &str) -> Result<Identity, String>;
    /// Reads the settings of a board, if this tool and the board have the same protocol version.
    fn read_settings(&mut self, serial: &str) -> Result<Option<Self::Settings>, String>;
    /// Restarts a board into its boot loader.
    fn enter_boot_loader(&mut self, serial: &str) -> Result<(), String>;
    /// Restores the settings that the board has lost or changed. Returns their names.
    fn restore_settings(&mut self, serial: &str, saved: &Self::Settings) -> Result<Vec<String>, String>;
    /// Returns the time since a fixed instant.
    fn now(&mut self) -> Duration;
    /// Waits.
    fn wait(&mut self, time: Duration);
}

/// A phase of flashing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Phase {
    Find,
    Identify,
    ReadSettings,
    Enter,
    Open,
    Erase,
    Write,
    ReadBack,
    Leave,
    Return,
    Compare,
    RestoreSettings,
}

impl fmt::Display for Phase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Find => "finding a board",
            Self::Identify => "identifying the board",
            Self::ReadSettings => "reading the board's settings",
            Self::Enter => "restarting the board into its boot loader",
            Self::Open => "opening the boot loader",
            Self::Erase => "erasing",
            Self::Write => "writing",
            Self::ReadBack => "reading back",
            Self::Leave => "leaving the boot loader",
            Self::Return => "waiting for the board",
            Self::Compare => "comparing versions",
            Self::RestoreSettings => "restoring settings",
        })
    }
}

/// The cause of a failure.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)]
pub enum Cause {
    #[error("there is neither a running board nor a boot loader on USB")]
    NoBoard,
    #[error("there are several boards: {}", .0.join(", "))]
    Several(Vec<String>),
    #[error("nothing on USB has the serial number {0}")]
    NotThere(String),
    #[error("{0}")]
    Board(String),
    #[error("the image is for {image} and this board is {board}")]
    OtherBoard { image: String, board: String },
    #[error(transparent)]
    Image(#[from] BadImage),
    #[error("{0}")]
    Usb(#[from] UsbError),
    #[error("no boot loader with this board's serial number appeared on USB")]
    NoBootLoader,
    #[error(transparent)]
    Dfu(#[from] DfuError),
    #[error(transparent)]
    Layout(#[from] BadLayout),
    #[error(transparent)]
    Misfit(#[from] Misfit),
    #[error("the flash at {address:#010x} holds {holds:#04x}, but {wanted:#04x} was written")]
    Differs { address: u32, holds: u8, wanted: u8 },
    #[error("the settings in flash have changed")]
    SettingsChanged,
    #[error("the board did not appear on USB after its restart")]
    NoReturn,
    #[error("the board now reports {identity}, but the image is {image}")]
    OtherVersion { identity: String, image: String },
}

/// The contents of the flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Flash {
    /// The old contents, on a board that was not restarted.
    Untouched,
    /// The old contents, on a board that was restarted into its boot loader.
    Entered,
    /// No image that starts.
    Erased,
    /// The new image, read back.
    Written,
}

/// A failure to flash a board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FlashError {
    /// The phase of the failure.
    pub phase: Phase,
    /// The cause.
    pub cause: Cause,
    flash: Flash,
}

impl std::error::Error for FlashError {}

impl fmt::Display for FlashError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}; {}", self.phase, self.cause, self.remedy())
    }
}

/// Instructions to enter the boot loader without firmware.
const MANUAL_ENTRY: &str = "by hand: set the DIP switch to DFU (ODrive v3.6) or BOOT0 high, and switch the power off \
                            and on with USB plugged in";

impl FlashError {
    fn new(phase: Phase, cause: impl Into<Cause>, flash: Flash) -> Self {
        Self { phase, cause: cause.into(), flash }
    }
    /// Returns true if the flash holds no image that starts.
    pub fn is_erased(&self) -> bool {
        self.flash == Flash::Erased
    }
    /// Returns the remedy.
    pub fn remedy(&self) -> String {
        let first = match &self.cause {
            Cause::NoBoard => format!("plug in a board, or enter its boot loader {MANUAL_ENTRY}"),
            Cause::Several(_) => "choose a board by its serial number".into(),
            Cause::NotThere(_) => {
                "`haptic list` shows the running boards; a boot loader has the serial number of its board".into()
            }
            Cause::OtherBoard { board, .. } => format!("flash the image for this board: haptic flash {board}"),
            Cause::Image(_) | Cause::Misfit(_) | Cause::Layout(_) => {
                "check that the image is complete and made for this kind of board".into()
            }
            Cause::Board(_) if self.phase != Phase::RestoreSettings => format!("enter the boot loader {MANUAL_ENTRY}"),
            Cause::NoBootLoader => format!(
                "check the cable; on Linux, `haptic udev` writes the rule that lets a user open the boot loader; or \
                 enter the boot loader {MANUAL_ENTRY}"
            ),
            Cause::Usb(UsbError::Forbidden) => {
                "`haptic udev` writes the rule that lets you open the device; on Windows, install WinUSB with Zadig"
                    .into()
            }
            Cause::Usb(UsbError::Busy) => "close the other program (dfu-util, another `haptic`)".into(),
            Cause::Dfu(DfuError::Protected) => {
                "lifting the protection erases the whole chip, settings as well: `dfu-util -a 0 -s \
                 0x08000000:unprotect:force`, then run this again"
                    .into()
            }
            Cause::SettingsChanged => "restore the settings from a backup when the board runs".into(),
            Cause::OtherVersion { .. } => {
                "another board may have replied: plug in only this board and flash it again".into()
            }
            _ => String::new(),
        };
        let then = match self.flash {
            Flash::Untouched => "nothing was changed".to_string(),
            Flash::Entered => {
                "nothing was changed: switch the power off and on to start the present firmware".to_string()
            }
            Flash::Erased => format!(
                "the board has no firmware that starts, and its motors stay off: leave its power on, check the cable \
                 and run this again; if the power was off, enter the boot loader {MANUAL_ENTRY}"
            ),
            Flash::Written if self.phase == Phase::RestoreSettings => "the image is written and runs".into(),
            Flash::Written => "the image is written and read back: set the DIP switch back to RUN (or BOOT0 low) and \
                               switch the power off and on"
                .to_string(),
        };
        if first.is_empty() { then } else { format!("{first}; {then}") }
    }
}

/// Progress of flashing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// A phase begins.
    Begins(Phase),
    /// Finished and total number of sectors or bytes in a phase.
    Done(Phase, usize, usize),
    /// The board does not restart, so the user must switch its power off and on.
    PowerCycle,
}

/// Summary of a completed flash.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FlashSummary {
    /// Identity that the board reports after flashing.
    pub identity: Identity,
    /// Names of the restored settings.
    pub restored: Vec<String>,
    /// Number of erased sectors.
    pub sectors: usize,
    /// Number of bytes written and read back.
    pub bytes: usize,
}

/// Longest time for a board to enter or leave its boot loader, including the operating system.
const RESTART_TIMEOUT: Duration = Duration::from_secs(10);
/// Longest time for the user to switch the power off and on.
const POWER_CYCLE_TIMEOUT: Duration = Duration::from_secs(60);
/// Interval between polls of the USB bus.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Finds the board with this serial number, or the only board.
pub fn find_board<S: Surroundings>(site: &mut S, serial: Option<&str>) -> Result<FlashTarget, FlashError> {
    let wrong = |cause: Cause| FlashError::new(Phase::Find, cause, Flash::Untouched);
    let mut boards = site.boards();
    // Ignores an error if boards were found, because a system may list serial ports but not USB.
    let loaders = site.boot_loaders();
    if let (Err(error), true) = (&loaders, boards.is_empty()) {
        return Err(wrong(error.clone().into()));
    }
    let mut loaders = loaders.unwrap_or_default();
    if let Some(serial) = serial {
        boards.retain(|board| board == serial);
        loaders.retain(|loader| loader.serial == serial);
    }
    match (&boards[..], &loaders[..]) {
        ([board], []) => {
            let identity = site.identify(board);
            let identity =
                identity.map_err(|why| FlashError::new(Phase::Identify, Cause::Board(why), Flash::Untouched))?;
            Ok(FlashTarget::Running(identity))
        }
        ([], [loader]) => Ok(FlashTarget::BootLoader(loader.clone())),
        ([], []) => Err(wrong(serial.map_or(Cause::NoBoard, |serial| Cause::NotThere(serial.into())))),
        _ => {
            let boards = boards.iter().map(|serial| format!("board {serial}"));
            let loaders = loaders.iter().map(|loader| format!("boot loader {}", loader.serial));
            Err(wrong(Cause::Several(boards.chain(loaders).collect())))
        }
    }
}

/// Flashes a board, whose motors go off. For a bare boot loader, the caller must know the kind of board.
pub fn flash<S: Surroundings>(
    site: &mut S,
    target: &FlashTarget,
    image: Image,
    tell: &mut dyn FnMut(Progress),
) -> Result<FlashSummary, FlashError> {
    let at = |phase, flash| move |cause: Cause| FlashError::new(phase, cause, flash);
    let image = image.check().map_err(|error| at(Phase::Identify, Flash::Untouched)(error.into()))?;
    let (loader, saved, before) = match target {
        FlashTarget::BootLoader(loader) => (loader.clone(), None, Flash::Untouched),
        FlashTarget::Running(identity) if identity.board != image.board => {
            let cause = Cause::OtherBoard { image: image.board, board: identity.board.clone() };
            return Err(at(Phase::Identify, Flash::Untouched)(cause));
        }
        FlashTarget::Running(identity) => {
            tell(Progress::Begins(Phase::ReadSettings));
            let saved = site
                .read_settings(&identity.serial)
                .map_err(|why| at(Phase::ReadSettings, Flash::Untouched)(Cause::Board(why)))?;
            tell(Progress::Begins(Phase::Enter));
            site.enter_boot_loader(&identity.serial)
                .map_err(|why| at(Phase::Enter, Flash::Untouched)(Cause::Board(why)))?;
            let loader = BootLoader { serial: identity.serial.clone() };
            let is_there = |site: &mut S| site.boot_loaders().is_ok_and(|all| all.contains(&loader));
            if !wait_until(site, RESTART_TIMEOUT, is_there) {
                return Err(at(Phase::Enter, Flash::Entered)(Cause::NoBootLoader));
            }
            (loader, saved, Flash::Entered)
        }
    };

    tell(Progress::Begins(Phase::Open));
    let opening = at(Phase::Open, before);
    // udev may apply its rule a moment after the device appears.
    let opened = match site.open(&loader) {
        Err(UsbError::Forbidden) => {
            site.wait(POLL_INTERVAL * 5);
            site.open(&loader)
        }
        opened => opened,
    };
    let opened = opened.map_err(|error| opening(error.into()))?;
    let layout = Layout::parse(&opened.memory).map_err(|error| opening(error.into()))?;
    let mut dfuse = Dfuse::begin(opened.loader, opened.transfer).map_err(|error| opening(error.into()))?;
    let sequence = flash_sequence(&image, &layout, dfuse.transfer()).map_err(|error| opening(error.into()))?;
    let settings_size = (SETTINGS.end - SETTINGS.start) as usize;
    // Reads before erasing, because a protected chip refuses to be read.
    let settings = dfuse.read(SETTINGS.start, settings_size).map_err(|error| opening(error.into()))?;

    let (sectors, bytes) =
        (sequence.sectors.len(), sequence.code.iter().chain(&sequence.vectors).map(|it| it.bytes.len()).sum());
    tell(Progress::Begins(Phase::Erase));
    for (index, sector) in sequence.sectors.iter().enumerate() {
        dfuse.erase(sector.start).map_err(|error| at(Phase::Erase, Flash::Erased)(error.into()))?;
        tell(Progress::Done(Phase::Erase, index + 1, sectors));
    }
    let (mut written, mut read) = (0, 0);
    for blocks in [&sequence.code, &sequence.vectors] {
        tell(Progress::Begins(Phase::Write));
        for Block { address, bytes: block } in blocks {
            dfuse.write(*address, block).map_err(|error| at(Phase::Write, Flash::Erased)(error.into()))?;
            written += block.len();
            tell(Progress::Done(Phase::Write, written, bytes));
        }
        tell(Progress::Begins(Phase::ReadBack));
        for Block { address, bytes: block } in blocks {
            let reading = at(Phase::ReadBack, Flash::Erased);
            let holds = dfuse.read(*address, block.len()).map_err(|error| reading(error.into()))?;
            let mut places = (*address..).zip(holds.into_iter().zip(block));
            if let Some((address, (holds, wanted))) = places.find(|(_, (holds, wanted))| holds != *wanted) {
                return Err(reading(Cause::Differs { address, holds, wanted: *wanted }));
            }
            read += block.len();
            tell(Progress::Done(Phase::ReadBack, read, bytes));
        }
    }
    let leaving = at(Phase::Leave, Flash::Written);
    let after = dfuse.read(SETTINGS.start, settings_size).map_err(|error| leaving(error.into()))?;
    if after != settings {
        return Err(leaving(Cause::SettingsChanged));
    }

    tell(Progress::Begins(Phase::Leave));
    dfuse.leave(FLASH_START).map_err(|error| leaving(error.into()))?;
    tell(Progress::Begins(Phase::Return));
    let is_back = |site: &mut S| site.boards().contains(&loader.serial);
    if !wait_until(site, RESTART_TIMEOUT, is_back) {
        tell(Progress::PowerCycle);
        if !wait_until(site, POWER_CYCLE_TIMEOUT, is_back) {
            return Err(at(Phase::Return, Flash::Written)(Cause::NoReturn));
        }
    }

    tell(Progress::Begins(Phase::Compare));
    let comparing = at(Phase::Compare, Flash::Written);
    let mut identity = site.identify(&loader.serial);
    // Retries, because a board may appear on USB before it replies.
    for _ in 0..20 {
        if identity.is_err() {
            site.wait(POLL_INTERVAL);
            identity = site.identify(&loader.serial);
        }
    }
    let identity = identity.map_err(|why| comparing(Cause::Board(why)))?;
    let same = identity.board == image.board
        && image.version.as_ref().is_none_or(|version| *version == identity.firmware)
        && image.protocol.is_none_or(|protocol| protocol == identity.protocol);
    if !same {
        let name = |board: &str, version: &str, protocol: Option<u16>| {
            let protocol = protocol.map(|it| format!(", protocol {it}")).unwrap_or_default();
            format!("{board} {version}{protocol}")
        };
        let image = name(&image.board, image.version.as_deref().unwrap_or_default(), image.protocol);
        return Err(comparing(Cause::OtherVersion {
            identity: name(&identity.board, &identity.firmware, Some(identity.protocol)),
            image,
        }));
    }
    let mut restored = Vec::new();
    if let Some(saved) = saved {
        tell(Progress::Begins(Phase::RestoreSettings));
        let outcome = site.restore_settings(&loader.serial, &saved);
        restored = outcome.map_err(|why| at(Phase::RestoreSettings, Flash::Written)(Cause::Board(why)))?;
    }
    Ok(FlashSummary { identity, restored, sectors, bytes })
}

/// Waits until `condition` is true, at most for `longest`. Returns true if `condition` became true.
fn wait_until<S: Surroundings>(site: &mut S, longest: Duration, mut condition: impl FnMut(&mut S) -> bool) -> bool {
    let end = site.now() + longest;
    loop {
        if condition(site) {
            return true;
        }
        if site.now() >= end {
            return false;
        }
        site.wait(POLL_INTERVAL);
    }
}
