//! From a board, running or in its boot loader, to the same board with another image: find it, ask what it is, keep its
//! settings, enter the boot loader, erase, write, read back, leave, wait for the board, compare, put settings back.
//!
//! Wherever that ends, the board has its old image whole, its new image whole, or none that starts and arms
//! ([`crate::plan`]); the error says which, and what to do.

use std::fmt;
use std::time::Duration;

use crate::dfuse::{DfuError, Dfuse, Transport, UsbError};
use crate::image::{BadImage, FLASH_START, Image, SETTINGS};
use crate::layout::{BadLayout, Layout};
use crate::plan::{Block, Misfit, plan};

/// What a running board says of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Said {
    /// Its kind.
    pub board: String,
    /// Version of its firmware.
    pub firmware: String,
    /// Its version of the protocol.
    pub protocol: u16,
    /// Its serial number.
    pub serial: String,
}

/// A boot loader on USB.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BootLoader {
    /// Its serial number, the same as that of the firmware on the chip.
    pub serial: String,
}

/// The board to flash.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Found {
    /// Its firmware runs.
    Running(Said),
    /// It is in its boot loader, which does not know what it is soldered to.
    BootLoader(BootLoader),
}

/// A boot loader that has been opened.
pub struct Opened<L> {
    /// The way to it.
    pub loader: L,
    /// Its description of the flash.
    pub memory: String,
    /// Most bytes of one transfer.
    pub transfer: u16,
}

/// The USB bus, the boards on it, and a clock.
pub trait Surroundings {
    /// The way to a boot loader.
    type Loader: Transport;
    /// Settings that were read from a board.
    type Kept;

    /// The boot loaders that are there.
    fn boot_loaders(&mut self) -> Result<Vec<BootLoader>, UsbError>;
    /// Opens one.
    fn open(&mut self, which: &BootLoader) -> Result<Opened<Self::Loader>, UsbError>;
    /// Serial numbers of the boards that run.
    fn boards(&mut self) -> Vec<String>;
    /// Asks one of them what it is; else why it does not say.
    fn ask(&mut self, serial: &str) -> Result<Said, String>;
    /// Reads its settings, where this tool and the board speak the same protocol.
    fn keep(&mut self, serial: &str) -> Result<Option<Self::Kept>, String>;
    /// Has it restart into its boot loader.
    fn enter(&mut self, serial: &str) -> Result<(), String>;
    /// Puts those settings back that the board no longer has as they were; their names.
    fn give_back(&mut self, serial: &str, kept: &Self::Kept) -> Result<Vec<String>, String>;
    /// The time since some beginning.
    fn now(&mut self) -> Duration;
    /// Lets time pass.
    fn wait(&mut self, time: Duration);
}

/// What is being done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Step {
    Find,
    Identify,
    Keep,
    Enter,
    Open,
    Erase,
    Write,
    ReadBack,
    Leave,
    Return,
    Compare,
    GiveBack,
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Find => "looking for a board",
            Self::Identify => "asking the board what it is",
            Self::Keep => "reading the board's settings",
            Self::Enter => "restarting the board into its boot loader",
            Self::Open => "opening the boot loader",
            Self::Erase => "erasing",
            Self::Write => "writing",
            Self::ReadBack => "reading back",
            Self::Leave => "leaving the boot loader",
            Self::Return => "waiting for the board",
            Self::Compare => "comparing versions",
            Self::GiveBack => "putting settings back",
        })
    }
}

/// What went wrong in a step.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs)]
pub enum Cause {
    #[error("there is neither a running board nor a boot loader on USB")]
    NoBoard,
    #[error("there are several: {}", .0.join(", "))]
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
    #[error("the flash at {address:#010x} holds {holds:#04x} and {wanted:#04x} was written")]
    Differs { address: u32, holds: u8, wanted: u8 },
    #[error("the settings in flash are not what they were before")]
    SettingsChanged,
    #[error("the board did not come back")]
    NoReturn,
    #[error("the board now says {said}, and the image is {image}")]
    OtherVersion { said: String, image: String },
}

/// What the flash holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Flash {
    /// What it held before; the board runs or was found in its boot loader.
    Untouched,
    /// The same, and the board waits in its boot loader where it was put.
    Entered,
    /// Nothing that starts.
    Erased,
    /// The image, read back.
    Written,
}

/// Why a board was not flashed, or not to the end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FlashError {
    /// In which step.
    pub step: Step,
    /// What happened.
    pub cause: Cause,
    flash: Flash,
}

impl std::error::Error for FlashError {}

impl fmt::Display for FlashError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}; {}", self.step, self.cause, self.remedy())
    }
}

/// How a board enters its boot loader without firmware.
const BY_HAND: &str =
    "by hand: its DIP switch to DFU (ODrive v3.6), or BOOT0 high, then the power off and on with USB plugged in";

impl FlashError {
    fn new(step: Step, cause: impl Into<Cause>, flash: Flash) -> Self {
        Self { step, cause: cause.into(), flash }
    }

    /// Whether the flash holds nothing that starts.
    pub fn erased(&self) -> bool {
        self.flash == Flash::Erased
    }

    /// What to do.
    pub fn remedy(&self) -> String {
        let first = match &self.cause {
            Cause::NoBoard => format!("plug one in, or bring it into its boot loader {BY_HAND}"),
            Cause::Several(_) => "choose one by its serial number".into(),
            Cause::NotThere(_) => {
                "`haptic list` shows the boards that run; a boot loader has its board's number".into()
            }
            Cause::OtherBoard { board, .. } => format!("flash what is for it: haptic flash {board}"),
            Cause::Image(_) | Cause::Misfit(_) | Cause::Layout(_) => {
                "this image and this chip do not go together".into()
            }
            Cause::Board(_) if self.step != Step::GiveBack => format!("bring it into its boot loader {BY_HAND}"),
            Cause::NoBootLoader => format!(
                "look at the cable; on Linux, `haptic udev` writes the rule without which a user cannot open it; or \
                 bring it there {BY_HAND}"
            ),
            Cause::Usb(UsbError::Forbidden) => {
                "`haptic udev` writes the rule that lets you; on Windows, Zadig installs WinUSB for it".into()
            }
            Cause::Usb(UsbError::Busy) => "close the other program (dfu-util, another haptic)".into(),
            Cause::Dfu(DfuError::Protected) => {
                "lifting the protection erases the whole chip, settings as well: `dfu-util -a 0 -s \
                 0x08000000:unprotect:force`, then this again"
                    .into()
            }
            Cause::SettingsChanged => "put them back from a backup once the board runs".into(),
            Cause::OtherVersion { .. } => {
                "another board may have answered: plug in this one alone and flash it again".into()
            }
            _ => String::new(),
        };
        let then = match self.flash {
            Flash::Untouched => "nothing was changed".to_string(),
            Flash::Entered => "nothing was changed: the power off and on starts the firmware that it has".to_string(),
            Flash::Erased => format!(
                "the board has no firmware that starts, and its motors stay off: leave its power on, look at the cable \
                 and run this again; if the power was off, enter the boot loader {BY_HAND}"
            ),
            Flash::Written if self.step == Step::GiveBack => "the image is written and runs".into(),
            Flash::Written => "the image is written and read back: set the DIP switch back to RUN (or BOOT0 low) and \
                               switch the power off and on"
                .to_string(),
        };
        if first.is_empty() { then } else { format!("{first}; {then}") }
    }
}

/// How far it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// A step begins.
    Begins(Step),
    /// So much of a step is done, of so much.
    Done(Step, usize, usize),
    /// The board does not come back by itself: somebody has to switch its power off and on.
    PowerCycle,
}

/// What was done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Done {
    /// What the board says of itself now.
    pub said: Said,
    /// Settings that were put back.
    pub restored: Vec<String>,
    /// Sectors that were erased.
    pub sectors: usize,
    /// Bytes that were written and read back.
    pub bytes: usize,
}

/// How long a board may take into its boot loader and out of it, with what the operating system needs.
const CHANGE: Duration = Duration::from_secs(10);
/// How long somebody may take to switch the power off and on.
const SOMEBODY: Duration = Duration::from_secs(60);
const GLANCE: Duration = Duration::from_millis(100);

/// Finds the board with this serial number, or the only one there is.
pub fn look<S: Surroundings>(site: &mut S, serial: Option<&str>) -> Result<Found, FlashError> {
    let wrong = |cause: Cause| FlashError::new(Step::Find, cause, Flash::Untouched);
    let mut boards = site.boards();
    // A system without USB, or that does not let us look, may still have a serial port with a board.
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
            let said = site.ask(board);
            let said = said.map_err(|why| FlashError::new(Step::Identify, Cause::Board(why), Flash::Untouched))?;
            Ok(Found::Running(said))
        }
        ([], [loader]) => Ok(Found::BootLoader(loader.clone())),
        ([], []) => Err(wrong(serial.map_or(Cause::NoBoard, |serial| Cause::NotThere(serial.into())))),
        _ => {
            let boards = boards.iter().map(|serial| format!("board {serial}"));
            let loaders = loaders.iter().map(|loader| format!("boot loader {}", loader.serial));
            Err(wrong(Cause::Several(boards.chain(loaders).collect())))
        }
    }
}

/// Flashes a board. Motors go off when it restarts. What kind of board a bare boot loader is on, the caller has asked.
pub fn flash<S: Surroundings>(
    site: &mut S,
    found: &Found,
    image: Image,
    tell: &mut dyn FnMut(Progress),
) -> Result<Done, FlashError> {
    let at = |step, flash| move |cause: Cause| FlashError::new(step, cause, flash);
    let image = image.checked().map_err(|error| at(Step::Identify, Flash::Untouched)(error.into()))?;
    let (loader, kept, before) = match found {
        Found::BootLoader(loader) => (loader.clone(), None, Flash::Untouched),
        Found::Running(said) if said.board != image.board => {
            let cause = Cause::OtherBoard { image: image.board, board: said.board.clone() };
            return Err(at(Step::Identify, Flash::Untouched)(cause));
        }
        Found::Running(said) => {
            tell(Progress::Begins(Step::Keep));
            let kept = site.keep(&said.serial).map_err(|why| at(Step::Keep, Flash::Untouched)(Cause::Board(why)))?;
            tell(Progress::Begins(Step::Enter));
            site.enter(&said.serial).map_err(|why| at(Step::Enter, Flash::Untouched)(Cause::Board(why)))?;
            let loader = BootLoader { serial: said.serial.clone() };
            let there = |site: &mut S| site.boot_loaders().is_ok_and(|all| all.contains(&loader));
            if !until(site, CHANGE, there) {
                return Err(at(Step::Enter, Flash::Entered)(Cause::NoBootLoader));
            }
            (loader, kept, Flash::Entered)
        }
    };

    tell(Progress::Begins(Step::Open));
    let opening = at(Step::Open, before);
    // A rule of udev may be a moment behind the device.
    let opened = match site.open(&loader) {
        Err(UsbError::Forbidden) => {
            site.wait(GLANCE * 5);
            site.open(&loader)
        }
        opened => opened,
    };
    let opened = opened.map_err(|error| opening(error.into()))?;
    let layout = Layout::parse(&opened.memory).map_err(|error| opening(error.into()))?;
    let mut dfuse = Dfuse::begin(opened.loader, opened.transfer).map_err(|error| opening(error.into()))?;
    let plan = plan(&image, &layout, dfuse.transfer()).map_err(|error| opening(error.into()))?;
    let settings_size = (SETTINGS.end - SETTINGS.start) as usize;
    // A protected chip says so here, before anything is erased.
    let settings = dfuse.read(SETTINGS.start, settings_size).map_err(|error| opening(error.into()))?;

    let (sectors, bytes) = (plan.erase.len(), plan.code.iter().chain(&plan.vectors).map(|it| it.bytes.len()).sum());
    tell(Progress::Begins(Step::Erase));
    for (index, sector) in plan.erase.iter().enumerate() {
        dfuse.erase(sector.start).map_err(|error| at(Step::Erase, Flash::Erased)(error.into()))?;
        tell(Progress::Done(Step::Erase, index + 1, sectors));
    }
    let (mut written, mut read) = (0, 0);
    for blocks in [&plan.code, &plan.vectors] {
        tell(Progress::Begins(Step::Write));
        for Block { address, bytes: block } in blocks {
            dfuse.write(*address, block).map_err(|error| at(Step::Write, Flash::Erased)(error.into()))?;
            written += block.len();
            tell(Progress::Done(Step::Write, written, bytes));
        }
        tell(Progress::Begins(Step::ReadBack));
        for Block { address, bytes: block } in blocks {
            let reading = at(Step::ReadBack, Flash::Erased);
            let holds = dfuse.read(*address, block.len()).map_err(|error| reading(error.into()))?;
            let mut places = (*address..).zip(holds.into_iter().zip(block));
            if let Some((address, (holds, wanted))) = places.find(|(_, (holds, wanted))| holds != *wanted) {
                return Err(reading(Cause::Differs { address, holds, wanted: *wanted }));
            }
            read += block.len();
            tell(Progress::Done(Step::ReadBack, read, bytes));
        }
    }
    let leaving = at(Step::Leave, Flash::Written);
    let after = dfuse.read(SETTINGS.start, settings_size).map_err(|error| leaving(error.into()))?;
    if after != settings {
        return Err(leaving(Cause::SettingsChanged));
    }

    tell(Progress::Begins(Step::Leave));
    dfuse.leave(FLASH_START).map_err(|error| leaving(error.into()))?;
    tell(Progress::Begins(Step::Return));
    let back = |site: &mut S| site.boards().contains(&loader.serial);
    if !until(site, CHANGE, back) {
        tell(Progress::PowerCycle);
        if !until(site, SOMEBODY, back) {
            return Err(at(Step::Return, Flash::Written)(Cause::NoReturn));
        }
    }

    tell(Progress::Begins(Step::Compare));
    let comparing = at(Step::Compare, Flash::Written);
    let mut said = site.ask(&loader.serial);
    // It may be there and not answer yet.
    for _ in 0..20 {
        if said.is_err() {
            site.wait(GLANCE);
            said = site.ask(&loader.serial);
        }
    }
    let said = said.map_err(|why| comparing(Cause::Board(why)))?;
    let same = said.board == image.board
        && image.version.as_ref().is_none_or(|version| *version == said.firmware)
        && image.protocol.is_none_or(|protocol| protocol == said.protocol);
    if !same {
        let name = |board: &str, version: &str, protocol: Option<u16>| {
            let protocol = protocol.map(|it| format!(", protocol {it}")).unwrap_or_default();
            format!("{board} {version}{protocol}")
        };
        let image = name(&image.board, image.version.as_deref().unwrap_or_default(), image.protocol);
        return Err(comparing(Cause::OtherVersion {
            said: name(&said.board, &said.firmware, Some(said.protocol)),
            image,
        }));
    }
    let mut restored = Vec::new();
    if let Some(kept) = kept {
        tell(Progress::Begins(Step::GiveBack));
        let given = site.give_back(&loader.serial, &kept);
        restored = given.map_err(|why| at(Step::GiveBack, Flash::Written)(Cause::Board(why)))?;
    }
    Ok(Done { said, restored, sectors, bytes })
}

/// Waits until it is so, for no longer than that; whether it is.
fn until<S: Surroundings>(site: &mut S, longest: Duration, mut so: impl FnMut(&mut S) -> bool) -> bool {
    let end = site.now() + longest;
    loop {
        if so(site) {
            return true;
        }
        if site.now() >= end {
            return false;
        }
        site.wait(GLANCE);
    }
}
