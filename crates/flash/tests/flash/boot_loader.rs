//! A scripted copy of the boot loader in the chip's ROM, from the USB forum's DFU 1.1 and ST's AN2662. The copy is
//! stricter than the ROM: a request that the documents do not allow, such as a status request before the reported time,
//! is an error.

use std::time::Duration;

/// Addresses of the flash.
pub const FLASH: std::ops::Range<u32> = 0x0800_0000..0x0810_0000;
pub const MEMORY: &str = "@Internal Flash  /0x08000000/04*016Kg,01*064Kg,07*128Kg";

// Request numbers (DFU 1.1, table 3.2).
const DNLOAD: u8 = 1;
const UPLOAD: u8 = 2;
const GETSTATUS: u8 = 3;
const CLRSTATUS: u8 = 4;
const GETSTATE: u8 = 5;
const ABORT: u8 = 6;

/// States of the boot loader, DFU 1.1 section 6.1.2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    Idle = 2,
    DnloadSync = 3,
    Dnbusy = 4,
    DnloadIdle = 5,
    ManifestSync = 6,
    Manifest = 7,
    UploadIdle = 9,
    Error = 10,
}

/// Statuses, DFU 1.1 section 6.1.2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    Ok = 0,
    Target = 1,
    Prog = 6,
    Vendor = 11,
    StalledPacket = 15,
}

/// An operation that the next status request starts.
#[derive(Clone, Debug)]
enum PendingOperation {
    SetAddress(u32),
    Erase(u32),
    MassErase,
    Unprotect,
    Unsupported,
    Write { address: u32, bytes: Vec<u8> },
}

#[derive(Debug, PartialEq)]
pub enum Reply {
    Bytes(Vec<u8>),
    Stall,
    /// The boot loader leaves USB and starts the program at this address.
    Leaves(Vec<u8>, u32),
    /// The boot loader leaves USB and resets.
    Resets,
}

pub struct BootLoader {
    pub state: State,
    pub status: Status,
    pointer: u32,
    pending: Option<PendingOperation>,
    /// Time before which a status request is an error.
    busy_until: Duration,
    outcome: Status,
    /// Number of status replies of an operation that each announce 5 ms more.
    pub late: u32,
    late_left: u32,
    /// Numbers of the erased sectors, in order.
    pub erased: Vec<usize>,
    pub protected: bool,
    /// Number of the operation that fails, from 1.
    pub failing_operation: Option<usize>,
    operations: usize,
}

impl BootLoader {
    pub fn new(protected: bool) -> Self {
        Self {
            state: State::Idle,
            status: Status::Ok,
            pointer: FLASH.start,
            pending: None,
            busy_until: Duration::ZERO,
            outcome: Status::Ok,
            late: 0,
            late_left: 0,
            erased: Vec::new(),
            protected,
            failing_operation: None,
            operations: 0,
        }
    }

    /// Carries out one class request. An erase or write that the request starts changes only `share` of its bytes in
    /// `flash`.
    pub fn request(
        &mut self,
        (request, value): (u8, u16),
        data: &[u8],
        length: u16,
        flash: &mut [u8],
        now: Duration,
        share: f32,
    ) -> Reply {
        if self.state == State::Dnbusy && now < self.busy_until {
            return self.stall(Status::StalledPacket);
        }
        match (request, self.state) {
            (DNLOAD, State::Idle | State::DnloadIdle) => self.download(value, data),
            (UPLOAD, State::Idle | State::UploadIdle) => self.upload(value, length, flash),
            (GETSTATUS, _) => self.report_status(flash, now, share),
            (GETSTATE, _) => Reply::Bytes(vec![self.state as u8]),
            (CLRSTATUS, State::Error) => self.idle(),
            (ABORT, State::Idle | State::DnloadIdle | State::DnloadSync | State::UploadIdle | State::ManifestSync) => {
                self.idle()
            }
            _ => self.stall(Status::StalledPacket),
        }
    }

    fn idle(&mut self) -> Reply {
        (self.state, self.status, self.pending) = (State::Idle, Status::Ok, None);
        Reply::Bytes(Vec::new())
    }
    fn stall(&mut self, status: Status) -> Reply {
        (self.state, self.status, self.pending) = (State::Error, status, None);
        Reply::Stall
    }
    fn download(&mut self, value: u16, data: &[u8]) -> Reply {
        let address = |data: &[u8]| u32::from_le_bytes([data[1], data[2], data[3], data[4]]);
        if data.is_empty() {
            self.state = State::ManifestSync;
            return Reply::Bytes(Vec::new());
        }
        let pending = match (value, data) {
            (0, [0x21, _, _, _, _]) => PendingOperation::SetAddress(address(data)),
            (0, [0x41, _, _, _, _]) => PendingOperation::Erase(address(data)),
            (0, [0x41]) => PendingOperation::MassErase,
            (0, [0x92]) => PendingOperation::Unprotect,
            (0, _) => PendingOperation::Unsupported,
            (1, _) => return self.stall(Status::StalledPacket),
            // A block has 2 to 2048 bytes.
            (_, data) if !(2..=2048).contains(&data.len()) => return self.stall(Status::StalledPacket),
            // The offset of a block is its number minus 2, times its length.
            (block, data) => PendingOperation::Write {
                address: self.pointer.wrapping_add(u32::from(block - 2) * data.len() as u32),
                bytes: data.to_vec(),
            },
        };
        (self.state, self.pending) = (State::DnloadSync, Some(pending));
        Reply::Bytes(Vec::new())
    }

    fn upload(&mut self, value: u16, length: u16, flash: &[u8]) -> Reply {
        if value == 0 {
            self.state = State::UploadIdle;
            return Reply::Bytes(vec![0x00, 0x21, 0x41, 0x92]);
        }
        if value == 1 || !(2..=2048).contains(&length) {
            return self.stall(Status::StalledPacket);
        }
        if self.protected {
            return self.stall(Status::Vendor);
        }
        let start = self.pointer.wrapping_add(u32::from(value - 2) * u32::from(length));
        let inside = FLASH.contains(&start) && FLASH.end - start >= u32::from(length);
        if !inside {
            return self.stall(Status::Target);
        }
        self.state = State::UploadIdle;
        Reply::Bytes(flash[(start - FLASH.start) as usize..][..usize::from(length)].to_vec())
    }

    fn report_status(&mut self, flash: &mut [u8], now: Duration, share: f32) -> Reply {
        let mut pause = 0;
        match self.state {
            State::DnloadSync => {
                let Some(pending) = self.pending.take() else { return self.stall(Status::StalledPacket) };
                if matches!(pending, PendingOperation::Unprotect) {
                    // The chip erases its flash, then resets.
                    flash.fill(0xFF);
                    self.protected = false;
                    return Reply::Resets;
                }
                if matches!(pending, PendingOperation::Unsupported) {
                    (self.state, self.status) = (State::Error, Status::StalledPacket);
                } else {
                    self.operations += 1;
                    (self.outcome, pause) = self.carry_out(pending, flash, share);
                    if self.failing_operation == Some(self.operations) {
                        self.outcome = Status::Prog;
                    }
                    (self.state, self.busy_until) = (State::Dnbusy, now + Duration::from_millis(pause.into()));
                    self.late_left = self.late;
                }
            }
            State::Dnbusy if self.late_left > 0 => {
                self.late_left -= 1;
                pause = 5;
                self.busy_until = now + Duration::from_millis(5);
            }
            State::Dnbusy if self.outcome == Status::Ok => self.state = State::DnloadIdle,
            State::Dnbusy => (self.state, self.status) = (State::Error, self.outcome),
            State::ManifestSync => {
                self.state = State::Manifest;
                return Reply::Leaves(self.status_bytes(0), self.pointer);
            }
            _ => {}
        }
        Reply::Bytes(self.status_bytes(pause))
    }

    fn status_bytes(&self, pause: u32) -> Vec<u8> {
        let [low, middle, high, _] = pause.to_le_bytes();
        vec![self.status as u8, low, middle, high, self.state as u8, 0]
    }
    /// Carries out an operation. Returns its status and its duration, ms (typical times of the STM32F405 data sheet).
    fn carry_out(&mut self, pending: PendingOperation, flash: &mut [u8], share: f32) -> (Status, u32) {
        let part = |length: usize| (length as f32 * share) as usize;
        match pending {
            PendingOperation::SetAddress(address) if FLASH.contains(&address) => {
                self.pointer = address;
                (Status::Ok, 1)
            }
            PendingOperation::SetAddress(_) => (Status::Target, 1),
            _ if self.protected => (Status::Vendor, 1),
            PendingOperation::Erase(address) => {
                let Some((number, start, length)) = sector(address) else { return (Status::Target, 1) };
                let from = (start - FLASH.start) as usize;
                flash[from..][..part(length)].fill(0xFF);
                self.erased.push(number);
                (Status::Ok, 15 + length as u32 / 64)
            }
            PendingOperation::MassErase => {
                flash.fill(0xFF);
                self.erased.extend(0..12);
                (Status::Ok, 16_000)
            }
            PendingOperation::Write { address, bytes } => {
                if !FLASH.contains(&address) || FLASH.end - address < bytes.len() as u32 {
                    return (Status::Target, 1);
                }
                let from = (address - FLASH.start) as usize;
                // Programming only clears bits.
                let cells = flash[from..].iter_mut().zip(&bytes).take(part(bytes.len()));
                cells.for_each(|(cell, byte)| *cell &= byte);
                (Status::Ok, bytes.len() as u32 / 128)
            }
            PendingOperation::Unprotect | PendingOperation::Unsupported => (Status::StalledPacket, 0),
        }
    }
}

/// Returns number, start and length of the sector with this address (RM0090, table "Flash module organization").
pub fn sector(address: u32) -> Option<(usize, u32, usize)> {
    let lengths = [16, 16, 16, 16, 64, 128, 128, 128, 128, 128, 128, 128].map(|kilobytes| kilobytes * 1024);
    let mut start = FLASH.start;
    for (number, length) in lengths.into_iter().enumerate() {
        if (start..start + length as u32).contains(&address) {
            return Some((number, start, length));
        }
        start += length as u32;
    }
    None
}
