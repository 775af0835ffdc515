//! A board with a chip in it, its USB cable and its switches; and images that such a board can run.

use std::cell::RefCell;
use std::rc::Rc;
use std::time::Duration;

use haptic_bridge::checksum::Crc32;
use haptic_flash::{BootLoader as There, Image, Opened, SETTINGS, Said, Segment, Surroundings, Transport, UsbError};

use crate::boot_loader::{Answer, BootLoader, FLASH, MEMORY};

pub const SERIAL: &str = "3852395C3038";
/// Where the word is that sums the image up, behind the vectors.
const CHECK: usize = 0x188;
const CODE: u32 = 0x0800_C000;

/// An image whose code begins with its own length and what it says of itself. It reaches into sector 4 and does not end
/// at a word.
pub fn image(board: &str, version: &str, protocol: u16) -> Image {
    let mut code = vec![0; 4];
    code.extend(format!("{board}\0{version}\0{protocol}\0").bytes());
    let seed = version.bytes().fold(7_u32, |sum, byte| sum.wrapping_mul(31) + u32::from(byte));
    code.extend((0..18_000_u32).map(|index| (index.wrapping_mul(2_654_435_761) ^ seed).to_be_bytes()[0]));
    code.push(1);
    let length = code.len() as u32;
    code[..4].copy_from_slice(&length.to_le_bytes());
    let mut vectors: Vec<u8> = [0x2001_3000_u32, CODE + 0x101].iter().flat_map(|word| word.to_le_bytes()).collect();
    vectors.extend(seed.to_le_bytes());
    vectors.resize(CHECK, 0x5A);
    let mut sum = Crc32::new();
    sum.take(&vectors);
    sum.take(&code);
    vectors.extend(sum.sum().to_le_bytes());
    let segments = vec![Segment { address: FLASH.start, bytes: vectors }, Segment { address: CODE, bytes: code }];
    Image { board: board.into(), version: Some(version.into()), protocol: Some(protocol), segments }
}

/// What takes the board away in the middle of something.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cut {
    /// The cable is pulled; the chip goes on.
    Cable,
    /// The power goes, before this request.
    Power,
    /// The power goes when this share of what the request begins is done.
    PowerWithin(f32),
}

pub enum Chip {
    Firmware,
    BootLoader(BootLoader),
    /// No power, or a program that is none.
    Dead,
}

pub struct Board {
    pub flash: Vec<u8>,
    pub chip: Chip,
    pub now: Duration,
    /// From when on the system sees it.
    seen_from: Duration,
    /// Time that the boot loader takes to answer.
    pub answers_after: Duration,
    pub plugged: bool,
    pub boot_pins: bool,
    pub protected: bool,
    pub memory: &'static str,
    /// Requests so far, and at which of them what happens.
    pub requests: usize,
    pub cut: Option<(usize, Cut)>,
    /// The firmware does not follow the request to restart into the boot loader.
    pub deaf: bool,
    /// The boot loader's jump leads nowhere; the power off and on does.
    pub lost_jump: bool,
    /// What the firmware says instead of its version.
    pub lies: Option<&'static str>,
    /// An address that holds this byte, whatever is written.
    pub stuck: Option<(u32, u8)>,
    pub opening: Option<UsbError>,
    /// Handed to every boot loader that starts.
    pub late: u32,
    pub fail: Option<usize>,
    /// Settings that were given back.
    pub given_back: Option<Vec<u8>>,
    pub erased: Vec<usize>,
}

/// A hand on it.
#[derive(Clone)]
pub struct Site(pub Rc<RefCell<Board>>);

impl Site {
    /// A board that runs this image.
    pub fn running(image: &Image) -> Self {
        let mut flash = vec![0xFF; (FLASH.end - FLASH.start) as usize];
        for segment in &image.segments {
            flash[(segment.address - FLASH.start) as usize..][..segment.bytes.len()].copy_from_slice(&segment.bytes);
        }
        let settings = (SETTINGS.start - FLASH.start) as usize..(SETTINGS.end - FLASH.start) as usize;
        flash[settings].iter_mut().zip(0_u32..).for_each(|(byte, index)| *byte = (index % 251) as u8);
        // What is left of something longer.
        flash[0x2_0000..0x2_0100].fill(0x33);
        Self(Rc::new(RefCell::new(Board {
            flash,
            chip: Chip::Firmware,
            now: Duration::ZERO,
            seen_from: Duration::ZERO,
            plugged: true,
            boot_pins: false,
            protected: false,
            memory: MEMORY,
            requests: 0,
            cut: None,
            deaf: false,
            lost_jump: false,
            lies: None,
            stuck: None,
            opening: None,
            answers_after: Duration::ZERO,
            late: 0,
            fail: None,
            given_back: None,
            erased: Vec::new(),
        })))
    }

    /// One in its boot loader.
    pub fn in_boot_loader(image: &Image) -> Self {
        let it = Self::running(image);
        it.0.borrow_mut().boot_pins = true;
        it.0.borrow_mut().power_cycle();
        it
    }

    pub fn change(&self, change: impl FnOnce(&mut Board)) -> &Self {
        change(&mut self.0.borrow_mut());
        self
    }
}

impl Board {
    /// Power off and on, with the cable in.
    pub fn power_cycle(&mut self) {
        self.plugged = true;
        self.lost_jump = false;
        if self.boot_pins { self.boot() } else { self.start() }
    }

    fn boot(&mut self) {
        let mut boot_loader = BootLoader::new(self.protected);
        (boot_loader.late, boot_loader.fail) = (self.late, self.fail);
        self.chip = Chip::BootLoader(boot_loader);
        self.seen_from = self.now + Duration::from_millis(700);
    }

    fn start(&mut self) {
        self.chip = if self.starts() && !self.lost_jump { Chip::Firmware } else { Chip::Dead };
        self.seen_from = self.now + Duration::from_millis(900);
    }

    fn word(&self, address: u32) -> u32 {
        let at = (address - FLASH.start) as usize;
        u32::from_le_bytes([self.flash[at], self.flash[at + 1], self.flash[at + 2], self.flash[at + 3]])
    }

    /// Whether the chip finds a stack and a first instruction.
    pub fn starts(&self) -> bool {
        let (stack, entry) = (self.word(FLASH.start), self.word(FLASH.start + 4));
        (0x2000_0000..=0x2002_0000).contains(&stack) && FLASH.contains(&entry) && entry % 2 == 1
    }

    /// Whether firmware that starts would ever arm: it compares its own checksum.
    pub fn arms(&self) -> bool {
        let (code, length) = ((CODE - FLASH.start) as usize, self.word(CODE) as usize);
        let Some(code) = self.flash.get(code..code.saturating_add(length)) else { return false };
        let mut sum = Crc32::new();
        sum.take(&self.flash[..CHECK]);
        sum.take(code);
        self.starts() && sum.sum() == self.word(FLASH.start + CHECK as u32)
    }

    /// Whether an image is in flash; of two segments, the second is its code.
    pub fn holds(&self, segments: &[Segment]) -> bool {
        segments.iter().all(|segment| {
            self.flash[(segment.address - FLASH.start) as usize..][..segment.bytes.len()] == segment.bytes
        })
    }

    pub fn settings(&self) -> Vec<u8> {
        self.flash[(SETTINGS.start - FLASH.start) as usize..(SETTINGS.end - FLASH.start) as usize].to_vec()
    }

    fn said(&self) -> Option<Said> {
        if !self.plugged || self.now < self.seen_from || !matches!(self.chip, Chip::Firmware) {
            return None;
        }
        let text = &self.flash[(CODE - FLASH.start) as usize + 4..][..64];
        let mut parts = text.split(|byte| *byte == 0).map(|part| String::from_utf8_lossy(part).into_owned());
        let (board, firmware) = (parts.next()?, parts.next()?);
        let protocol = parts.next()?.parse().ok()?;
        let firmware = self.lies.map(String::from).unwrap_or(firmware);
        Some(Said { board, firmware, protocol, serial: SERIAL.into() })
    }

    fn request(&mut self, request: (u8, u16), data: &[u8], length: u16) -> Result<Vec<u8>, UsbError> {
        if !self.plugged || self.now < self.seen_from {
            return Err(UsbError::Gone);
        }
        self.requests += 1;
        let mut share = 1.0;
        let mut power_goes = false;
        match self.cut.filter(|(at, _)| *at == self.requests) {
            Some((_, Cut::Cable)) => {
                self.plugged = false;
                return Err(UsbError::Gone);
            }
            Some((_, Cut::Power)) => {
                (self.chip, self.plugged) = (Chip::Dead, false);
                return Err(UsbError::Gone);
            }
            Some((_, Cut::PowerWithin(part))) => (share, power_goes) = (part, true),
            None => {}
        }
        let Chip::BootLoader(boot_loader) = &mut self.chip else { return Err(UsbError::Gone) };
        let answer = boot_loader.request(request, data, length, &mut self.flash, self.now, share);
        self.erased = boot_loader.erased.clone();
        if let Some((address, byte)) = self.stuck {
            self.flash[(address - FLASH.start) as usize] = byte;
        }
        if power_goes {
            (self.chip, self.plugged) = (Chip::Dead, false);
            return Err(UsbError::Gone);
        }
        match answer {
            Answer::Bytes(bytes) => Ok(bytes),
            Answer::Stall => Err(UsbError::Stalled),
            Answer::Leaves(bytes, FLASH_START) => {
                self.start();
                Ok(bytes)
            }
            Answer::Leaves(..) | Answer::Resets => {
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
        let answered_after = board.answers_after;
        board.now += answered_after;
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
    type Kept = Vec<u8>;

    fn boot_loaders(&mut self) -> Result<Vec<There>, UsbError> {
        let board = self.0.borrow();
        let there = board.plugged && board.now >= board.seen_from && matches!(board.chip, Chip::BootLoader(_));
        Ok(if there { vec![There { serial: SERIAL.into() }] } else { Vec::new() })
    }

    fn open(&mut self, which: &There) -> Result<Opened<Cable>, UsbError> {
        if let Some(error) = &self.0.borrow().opening {
            return Err(error.clone());
        }
        if !self.boot_loaders()?.contains(which) {
            return Err(UsbError::Gone);
        }
        Ok(Opened { loader: Cable(self.0.clone()), memory: self.0.borrow().memory.into(), transfer: 2048 })
    }

    fn boards(&mut self) -> Vec<String> {
        self.0.borrow().said().map(|said| said.serial).into_iter().collect()
    }

    fn ask(&mut self, _: &str) -> Result<Said, String> {
        self.0.borrow().said().ok_or("the board does not answer".into())
    }

    fn keep(&mut self, _: &str) -> Result<Option<Vec<u8>>, String> {
        Ok(Some(self.0.borrow().settings()))
    }

    fn enter(&mut self, _: &str) -> Result<(), String> {
        let mut board = self.0.borrow_mut();
        if !board.deaf {
            board.boot();
        }
        Ok(())
    }

    fn give_back(&mut self, _: &str, kept: &Vec<u8>) -> Result<Vec<String>, String> {
        self.0.borrow_mut().given_back = Some(kept.clone());
        Ok(vec!["rules".into()])
    }

    fn now(&mut self) -> Duration {
        self.0.borrow().now
    }

    fn wait(&mut self, time: Duration) {
        self.0.borrow_mut().now += time;
    }
}
