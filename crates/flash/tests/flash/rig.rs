//! A simulated board with a chip, a USB cable and switches, and images for the board.

use std::cell::RefCell;
use std::rc::Rc;
use std::time::Duration;

use haptic_bridge::checksum::Crc32;
use haptic_flash::{
    BootLoader as BootLoaderOnUsb, Identity, Image, OpenBootLoader, SETTINGS, Segment, Surroundings, Transport,
    UsbError,
};

use crate::boot_loader::{BootLoader, FLASH, MEMORY, Reply};

pub const SERIAL: &str = "3852395C3038";
/// Offset of the image's checksum, behind the vectors, bytes.
const CHECKSUM_OFFSET: usize = 0x188;
const CODE_START: u32 = 0x0800_C000;

/// Creates an image whose code begins with the length of the code and the identity. The code ends in sector 4, not at a
/// word boundary.
pub fn image(board: &str, version: &str, protocol: u16) -> Image {
    let mut code = vec![0; 4];
    code.extend(format!("{board}\0{version}\0{protocol}\0").bytes());
    let seed = version.bytes().fold(7_u32, |sum, byte| sum.wrapping_mul(31) + u32::from(byte));
    code.extend((0..18_000_u32).map(|index| (index.wrapping_mul(2_654_435_761) ^ seed).to_be_bytes()[0]));
    code.push(1);
    let length = code.len() as u32;
    code[..4].copy_from_slice(&length.to_le_bytes());
    let mut vectors: Vec<u8> =
        [0x2001_3000_u32, CODE_START + 0x101].iter().flat_map(|word| word.to_le_bytes()).collect();
    vectors.extend(seed.to_le_bytes());
    vectors.resize(CHECKSUM_OFFSET, 0x5A);
    let mut sum = Crc32::new();
    sum.take(&vectors);
    sum.take(&code);
    vectors.extend(sum.sum().to_le_bytes());
    let segments = vec![Segment { address: FLASH.start, bytes: vectors }, Segment { address: CODE_START, bytes: code }];
    Image { board: board.into(), version: Some(version.into()), protocol: Some(protocol), segments }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cut {
    /// The cable is pulled before this request; the chip stays powered.
    Cable,
    /// The power fails before this request.
    Power,
    /// The power fails after this share of the request's operation.
    PowerWithin(f32),
}

pub enum Chip {
    Firmware,
    BootLoader(BootLoader),
    /// No power, or no valid program.
    Dead,
}

pub struct Board {
    pub flash: Vec<u8>,
    pub chip: Chip,
    pub now: Duration,
    /// Time from which the device is on USB.
    visible_from: Duration,
    /// Time that the boot loader takes to reply.
    pub reply_delay: Duration,
    pub plugged: bool,
    pub boot_pins: bool,
    pub protected: bool,
    pub memory: &'static str,
    pub requests: usize,
    /// Request number and kind of the interruption.
    pub cut: Option<(usize, Cut)>,
    /// True if the firmware ignores the request to restart into the boot loader.
    pub ignores_restart: bool,
    /// True if the boot loader does not start the program until a power cycle.
    pub fails_to_start: bool,
    /// The version that the firmware reports instead of its own.
    pub reported_version: Option<&'static str>,
    /// An address that always holds this byte.
    pub stuck_byte: Option<(u32, u8)>,
    pub open_error: Option<UsbError>,
    /// [`BootLoader::late`] of every boot loader that starts.
    pub late: u32,
    pub failing_operation: Option<usize>,
    pub restored_settings: Option<Vec<u8>>,
    pub erased: Vec<usize>,
}

#[derive(Clone)]
pub struct Site(pub Rc<RefCell<Board>>);

impl Site {
    /// Creates a board that runs this image.
    pub fn running(image: &Image) -> Self {
        let mut flash = vec![0xFF; (FLASH.end - FLASH.start) as usize];
        for segment in &image.segments {
            flash[(segment.address - FLASH.start) as usize..][..segment.bytes.len()].copy_from_slice(&segment.bytes);
        }
        let settings = (SETTINGS.start - FLASH.start) as usize..(SETTINGS.end - FLASH.start) as usize;
        flash[settings].iter_mut().zip(0_u32..).for_each(|(byte, index)| *byte = (index % 251) as u8);
        // The remains of an earlier, longer image.
        flash[0x2_0000..0x2_0100].fill(0x33);
        Self(Rc::new(RefCell::new(Board {
            flash,
            chip: Chip::Firmware,
            now: Duration::ZERO,
            visible_from: Duration::ZERO,
            plugged: true,
            boot_pins: false,
            protected: false,
            memory: MEMORY,
            requests: 0,
            cut: None,
            ignores_restart: false,
            fails_to_start: false,
            reported_version: None,
            stuck_byte: None,
            open_error: None,
            reply_delay: Duration::ZERO,
            late: 0,
            failing_operation: None,
            restored_settings: None,
            erased: Vec::new(),
        })))
    }

    /// Creates a board in its boot loader.
    pub fn in_boot_loader(image: &Image) -> Self {
        let site = Self::running(image);
        site.0.borrow_mut().boot_pins = true;
        site.0.borrow_mut().power_cycle();
        site
    }

    pub fn change(&self, change: impl FnOnce(&mut Board)) -> &Self {
        change(&mut self.0.borrow_mut());
        self
    }
}

impl Board {
    /// Switches power off and on, with the cable plugged in.
    pub fn power_cycle(&mut self) {
        self.plugged = true;
        self.fails_to_start = false;
        if self.boot_pins { self.boot() } else { self.start() }
    }

    fn boot(&mut self) {
        let mut boot_loader = BootLoader::new(self.protected);
        (boot_loader.late, boot_loader.failing_operation) = (self.late, self.failing_operation);
        self.chip = Chip::BootLoader(boot_loader);
        self.visible_from = self.now + Duration::from_millis(700);
    }

    fn start(&mut self) {
        self.chip = if self.starts() && !self.fails_to_start { Chip::Firmware } else { Chip::Dead };
        self.visible_from = self.now + Duration::from_millis(900);
    }
    fn word(&self, address: u32) -> u32 {
        let at = (address - FLASH.start) as usize;
        u32::from_le_bytes([self.flash[at], self.flash[at + 1], self.flash[at + 2], self.flash[at + 3]])
    }
    /// Returns true if the flash contains a valid stack pointer and reset vector.
    pub fn starts(&self) -> bool {
        let (stack, entry) = (self.word(FLASH.start), self.word(FLASH.start + 4));
        (0x2000_0000..=0x2002_0000).contains(&stack) && FLASH.contains(&entry) && entry % 2 == 1
    }
    /// Returns true if the firmware starts and would arm because its checksum is right.
    pub fn arms(&self) -> bool {
        let (code, length) = ((CODE_START - FLASH.start) as usize, self.word(CODE_START) as usize);
        let Some(code) = self.flash.get(code..code.saturating_add(length)) else { return false };
        let mut sum = Crc32::new();
        sum.take(&self.flash[..CHECKSUM_OFFSET]);
        sum.take(code);
        self.starts() && sum.sum() == self.word(FLASH.start + CHECKSUM_OFFSET as u32)
    }

    /// Returns true if the flash holds these segments.
    pub fn holds(&self, segments: &[Segment]) -> bool {
        segments.iter().all(|segment| {
            self.flash[(segment.address - FLASH.start) as usize..][..segment.bytes.len()] == segment.bytes
        })
    }

    pub fn settings(&self) -> Vec<u8> {
        self.flash[(SETTINGS.start - FLASH.start) as usize..(SETTINGS.end - FLASH.start) as usize].to_vec()
    }
    fn identity(&self) -> Option<Identity> {
        if !self.plugged || self.now < self.visible_from || !matches!(self.chip, Chip::Firmware) {
            return None;
        }
        let text = &self.flash[(CODE_START - FLASH.start) as usize + 4..][..64];
        let mut parts = text.split(|byte| *byte == 0).map(|part| String::from_utf8_lossy(part).into_owned());
        let (board, firmware) = (parts.next()?, parts.next()?);
        let protocol = parts.next()?.parse().ok()?;
        let firmware = self.reported_version.map(String::from).unwrap_or(firmware);
        Some(Identity { board, firmware, protocol, serial: SERIAL.into() })
    }

    fn request(&mut self, request: (u8, u16), data: &[u8], length: u16) -> Result<Vec<u8>, UsbError> {
        if !self.plugged || self.now < self.visible_from {
            return Err(UsbError::Gone);
        }
        self.requests += 1;
        let mut share = 1.0;
        let mut power_fails = false;
        match self.cut.filter(|(at, _)| *at == self.requests) {
            Some((_, Cut::Cable)) => {
                self.plugged = false;
                return Err(UsbError::Gone);
            }
            Some((_, Cut::Power)) => {
                (self.chip, self.plugged) = (Chip::Dead, false);
                return Err(UsbError::Gone);
            }
            Some((_, Cut::PowerWithin(part))) => (share, power_fails) = (part, true),
            None => {}
        }
        let Chip::BootLoader(boot_loader) = &mut self.chip else { return Err(UsbError::Gone) };
        let answer = boot_loader.request(request, data, length, &mut self.flash, self.now, share);
        self.erased = boot_loader.erased.clone();
        if let Some((address, byte)) = self.stuck_byte {
            self.flash[(address - FLASH.start) as usize] = byte;
        }
        if power_fails {
            (self.chip, self.plugged) = (Chip::Dead, false);
            return Err(UsbError::Gone);
        }
        match answer {
            Reply::Bytes(bytes) => Ok(bytes),
            Reply::Stall => Err(UsbError::Stalled),
            Reply::Leaves(bytes, FLASH_START) => {
                self.start();
                Ok(bytes)
            }
            Reply::Leaves(..) | Reply::Resets => {
                self.power_cycle();
                Err(UsbError::Gone)
            }
        }
    }
}

const FLASH_START: u32 = FLASH.start;

pub struct Cable(Rc<RefCell<Board>>);

impl Transport for Cable {
    fn send(&mut self, request: u8, value: u16, data: &[u8]) -> Result<(), UsbError> {
        self.0.borrow_mut().request((request, value), data, 0).map(|_| ())
    }
    fn receive(&mut self, request: u8, value: u16, length: u16) -> Result<Vec<u8>, UsbError> {
        let mut board = self.0.borrow_mut();
        let reply_delay = board.reply_delay;
        board.now += reply_delay;
        board.request((request, value), &[], length)
    }

    fn wait(&mut self, time: Duration) {
        self.0.borrow_mut().now += time;
    }
    fn now(&self) -> Duration {
        self.0.borrow().now
    }
}

impl Surroundings for Site {
    type Loader = Cable;
    type Settings = Vec<u8>;

    fn boot_loaders(&mut self) -> Result<Vec<BootLoaderOnUsb>, UsbError> {
        let board = self.0.borrow();
        let is_there = board.plugged && board.now >= board.visible_from && matches!(board.chip, Chip::BootLoader(_));
        Ok(if is_there { vec![BootLoaderOnUsb { serial: SERIAL.into() }] } else { Vec::new() })
    }

    fn open(&mut self, which: &BootLoaderOnUsb) -> Result<OpenBootLoader<Cable>, UsbError> {
        if let Some(error) = &self.0.borrow().open_error {
            return Err(error.clone());
        }
        if !self.boot_loaders()?.contains(which) {
            return Err(UsbError::Gone);
        }
        Ok(OpenBootLoader { loader: Cable(self.0.clone()), memory: self.0.borrow().memory.into(), transfer: 2048 })
    }

    fn boards(&mut self) -> Vec<String> {
        self.0.borrow().identity().map(|identity| identity.serial).into_iter().collect()
    }
    fn identify(&mut self, _: &str) -> Result<Identity, String> {
        self.0.borrow().identity().ok_or("the board does not reply".into())
    }
    fn read_settings(&mut self, _: &str) -> Result<Option<Vec<u8>>, String> {
        Ok(Some(self.0.borrow().settings()))
    }
    fn enter_boot_loader(&mut self, _: &str) -> Result<(), String> {
        let mut board = self.0.borrow_mut();
        if !board.ignores_restart {
            board.boot();
        }
        Ok(())
    }

    fn restore_settings(&mut self, _: &str, settings: &Vec<u8>) -> Result<Vec<String>, String> {
        self.0.borrow_mut().restored_settings = Some(settings.clone());
        Ok(vec!["rules".into()])
    }
    fn now(&mut self) -> Duration {
        self.0.borrow().now
    }
    fn wait(&mut self, time: Duration) {
        self.0.borrow_mut().now += time;
    }
}
