//! The USB OTG full-speed core in device mode (RM0090 rev 22 chapter 34), as far as `embassy-usb-synopsys-otg` uses it.
//! The registers and FIFOs are accessed by the firmware and by a host's transactions.
//!
//! A packet is one event. A transaction takes its bus time at 12 Mbit/s and takes effect at its end. A NAK takes no
//! time, because the simulated host waits until an endpoint is ready, while a real host repeats the transaction.

use std::collections::VecDeque;

use rigless::device::Level;
use rigless::time::VirtualNanos;

/// Number of endpoints in each direction.
pub const ENDPOINTS: usize = 4;

/// Offset of each block from the base of the core.
pub const BLOCK_OFFSETS: [u32; 4] = [0x000, 0x400, 0x800, 0xE00];

const GAHBCFG: u32 = 0x008;
const GRSTCTL: u32 = 0x010;
const GINTSTS: u32 = 0x014;
const GINTMSK: u32 = 0x018;
const GRXSTSR: u32 = 0x01C;
/// Register whose read removes the received status from its FIFO.
pub const GRXSTSP: u32 = 0x020;
const GRXFSIZ: u32 = 0x024;
const DIEPTXF0: u32 = 0x028;
const CID: u32 = 0x03C;
const DIEPTXF1: u32 = 0x104;
const DCTL: u32 = 0x804;
const DSTS: u32 = 0x808;
const DIEPMSK: u32 = 0x810;
const DOEPMSK: u32 = 0x814;
const DAINT: u32 = 0x818;
const DAINTMSK: u32 = 0x81C;
const DIEPEMPMSK: u32 = 0x834;
const IN_ENDPOINTS: u32 = 0x900;
const OUT_ENDPOINTS: u32 = 0xB00;
/// Offset of the first FIFO. The other FIFOs follow.
pub const FIFOS: u32 = 0x1000;

const CTL: u32 = 0x00;
const INT: u32 = 0x08;
const TSIZ: u32 = 0x10;
const TXFSTS: u32 = 0x18;

const USBAEP: u32 = 1 << 15;
const NAKSTS: u32 = 1 << 17;
const STALL: u32 = 1 << 21;
const CNAK: u32 = 1 << 26;
const SNAK: u32 = 1 << 27;
const EPDIS: u32 = 1 << 30;
const EPENA: u32 = 1 << 31;

const XFRC: u32 = 1 << 0;
const EPDISD: u32 = 1 << 1;
const STUP: u32 = 1 << 3;
const TXFE: u32 = 1 << 7;

const RXFLVL: u32 = 1 << 4;
const USBSUSP: u32 = 1 << 11;
const USBRST: u32 = 1 << 12;
const ENUMDNE: u32 = 1 << 13;
const IEPINT: u32 = 1 << 18;
const OEPINT: u32 = 1 << 19;
const WKUPINT: u32 = 1 << 31;

const OUT_DATA: u32 = 2;
const OUT_DONE: u32 = 3;
const SETUP_DONE: u32 = 4;
const SETUP_DATA: u32 = 6;

/// The core's registers and FIFOs, accessed by the firmware and by a host's transactions.
#[derive(Debug)]
pub struct Core {
    words: Vec<u32>,
    received: VecDeque<u32>,
    receive_fifo: VecDeque<u32>,
    transmit_fifo: [VecDeque<u32>; ENDPOINTS],
    /// True if the firmware has reset the core, so that the pull-up was off for a moment.
    pub soft_reset: bool,
}

/// Reply of an endpoint.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Handshake<T> {
    /// The packet was transferred.
    Ack(T),
    /// The endpoint is not ready.
    Nak,
    /// The endpoint is halted until the host clears it.
    Stall,
}

impl Default for Core {
    fn default() -> Self {
        let mut core = Self {
            words: vec![0; 0x1000 / 4],
            received: VecDeque::new(),
            receive_fifo: VecDeque::new(),
            transmit_fifo: Default::default(),
            soft_reset: false,
        };
        core.reset_words();
        core
    }
}

fn endpoint(direction: u32, number: usize, register: u32) -> u32 {
    direction + 0x20 * number as u32 + register
}

impl Core {
    fn reset_words(&mut self) {
        self.words.fill(0);
        self.set(GRSTCTL, 1 << 31);
        self.set(GRXFSIZ, 0x200);
        self.set(DIEPTXF0, 0x0200_0200);
        self.set(CID, 0x1200);
        self.set(DCTL, 1 << 1);
        self.set(DSTS, 3 << 1);
        self.set(endpoint(IN_ENDPOINTS, 0, CTL), USBAEP);
        self.set(endpoint(OUT_ENDPOINTS, 0, CTL), USBAEP);
        self.received.clear();
        self.receive_fifo.clear();
        self.transmit_fifo.iter_mut().for_each(VecDeque::clear);
    }

    fn get(&self, offset: u32) -> u32 {
        self.words[offset as usize / 4]
    }

    fn set(&mut self, offset: u32, value: u32) {
        self.words[offset as usize / 4] = value;
    }

    fn raise(&mut self, offset: u32, bits: u32) {
        self.set(offset, self.get(offset) | bits);
    }

    fn lower(&mut self, offset: u32, bits: u32) {
        self.set(offset, self.get(offset) & !bits);
    }

    /// Returns true if the firmware has enabled the pull-up, which signals a device.
    #[must_use]
    pub fn is_connected(&self) -> bool {
        self.get(DCTL) & (1 << 1) == 0
    }

    /// Resets the bus. Received packets stay in their FIFO until the firmware flushes it.
    pub fn bus_reset(&mut self) {
        for number in 0..ENDPOINTS {
            for direction in [IN_ENDPOINTS, OUT_ENDPOINTS] {
                let at = endpoint(direction, number, CTL);
                self.lower(at, EPENA | STALL | if number > 0 { USBAEP } else { 0 });
                self.raise(at, NAKSTS);
            }
            self.transmit_fifo[number].clear();
        }
        self.lower(DSTS, 1);
        self.raise(GINTSTS, USBRST);
    }

    /// Ends the reset of the bus, after which the speed is known.
    pub fn enumeration_done(&mut self) {
        self.raise(GINTSTS, ENUMDNE);
    }

    /// Suspends the device, which a host does by 3 ms without traffic.
    pub fn suspend(&mut self) {
        self.raise(DSTS, 1);
        self.raise(GINTSTS, USBSUSP);
    }

    /// Resumes the device.
    pub fn resume(&mut self) {
        self.lower(DSTS, 1);
        self.raise(GINTSTS, WKUPINT);
    }

    /// Receives a SETUP packet, which a device always accepts.
    pub fn receive_setup(&mut self, packet: [u8; 8]) {
        for direction in [IN_ENDPOINTS, OUT_ENDPOINTS] {
            let at = endpoint(direction, 0, CTL);
            self.lower(at, STALL);
            self.raise(at, NAKSTS);
        }
        self.received.push_back(SETUP_DATA << 17 | 8 << 4);
        self.receive_fifo.extend(packet.chunks_exact(4).map(little_endian));
        self.received.push_back(SETUP_DONE << 17);
    }

    /// Returns the handshake that an OUT packet to endpoint `number` would get now.
    #[must_use]
    pub fn accepts(&self, number: usize) -> Handshake<()> {
        let control = self.get(endpoint(OUT_ENDPOINTS, number, CTL));
        let packets = (self.get(endpoint(OUT_ENDPOINTS, number, TSIZ)) >> 19) & 0x3FF;
        // A queued packet needs its words and a status word (RM0090 section 34.13).
        let full = self.receive_fifo.len() + self.received.len() + 18 > (self.get(GRXFSIZ) & 0xFFFF) as usize;
        // The driver arms endpoint 0 again by clearing NAK, without a packet count.
        let armed = if number == 0 { control & NAKSTS == 0 } else { packets > 0 };
        if control & STALL != 0 {
            Handshake::Stall
        } else if control & USBAEP == 0 || !armed || full {
            Handshake::Nak
        } else {
            Handshake::Ack(())
        }
    }

    /// Receives an OUT packet for endpoint `number`.
    pub fn receive_out(&mut self, number: usize, data: &[u8]) -> Handshake<()> {
        let answer = self.accepts(number);
        if answer != Handshake::Ack(()) {
            return answer;
        }
        let (count, length) = (number as u32, data.len() as u32);
        self.received.push_back(OUT_DATA << 17 | length << 4 | count);
        self.receive_fifo.extend(data.chunks(4).map(little_endian));
        self.received.push_back(OUT_DONE << 17 | count);
        let at = endpoint(OUT_ENDPOINTS, number, TSIZ);
        let size = self.get(at);
        let left = (size & 0x7_FFFF).saturating_sub(length);
        let packets = ((size >> 19) & 0x3FF).saturating_sub(1);
        self.set(at, (size & (3 << 29)) | packets << 19 | left);
        if number == 0 {
            self.raise(endpoint(OUT_ENDPOINTS, 0, CTL), NAKSTS);
        }
        Handshake::Ack(())
    }

    /// Returns the handshake that an IN token to endpoint `number` would get now, with the length of the packet.
    #[must_use]
    pub fn offers(&self, number: usize) -> Handshake<usize> {
        let control = self.get(endpoint(IN_ENDPOINTS, number, CTL));
        let size = self.get(endpoint(IN_ENDPOINTS, number, TSIZ));
        let length = (size & 0x7F) as usize;
        if control & STALL != 0 {
            return Handshake::Stall;
        }
        let queued = 4 * self.transmit_fifo[number].len() >= length;
        let armed = control & (EPENA | USBAEP | NAKSTS) == EPENA | USBAEP;
        if armed && (size >> 19) & 3 != 0 && queued { Handshake::Ack(length) } else { Handshake::Nak }
    }

    /// Handles an IN token for endpoint `number`.
    pub fn send_in(&mut self, number: usize) -> Handshake<Vec<u8>> {
        let length = match self.offers(number) {
            Handshake::Ack(length) => length,
            Handshake::Nak => return Handshake::Nak,
            Handshake::Stall => return Handshake::Stall,
        };
        let words = self.transmit_fifo[number].drain(..length.div_ceil(4));
        let mut data: Vec<u8> = words.flat_map(u32::to_le_bytes).collect();
        data.truncate(length);
        self.lower(endpoint(IN_ENDPOINTS, number, TSIZ), 0x1FFF_FFFF);
        self.lower(endpoint(IN_ENDPOINTS, number, CTL), EPENA);
        self.raise(endpoint(IN_ENDPOINTS, number, INT), XFRC);
        Handshake::Ack(data)
    }

    fn transmit_space(&self, number: usize) -> u32 {
        let at = if number == 0 { DIEPTXF0 } else { DIEPTXF1 + 4 * (number as u32 - 1) };
        (self.get(at) >> 16).saturating_sub(self.transmit_fifo[number].len() as u32)
    }

    fn endpoint_interrupts(&self) -> u32 {
        let mut all = 0;
        for number in 0..ENDPOINTS {
            let empty = self.transmit_fifo[number].is_empty() && self.get(DIEPEMPMSK) & (1 << number) != 0;
            let input = self.get(endpoint(IN_ENDPOINTS, number, INT)) & self.get(DIEPMSK);
            let output = self.get(endpoint(OUT_ENDPOINTS, number, INT)) & self.get(DOEPMSK);
            all |= u32::from(input != 0 || empty) << number;
            all |= u32::from(output != 0) << (16 + number);
        }
        all
    }

    fn interrupts(&self) -> u32 {
        let endpoints = self.endpoint_interrupts() & self.get(DAINTMSK);
        let mut status = self.get(GINTSTS);
        if !self.received.is_empty() {
            status |= RXFLVL;
        }
        if endpoints & 0xFFFF != 0 {
            status |= IEPINT;
        }
        if endpoints >> 16 != 0 {
            status |= OEPINT;
        }
        status
    }

    /// Returns the level of the core's interrupt request.
    pub fn line(&self) -> Level {
        Level::from(self.get(GAHBCFG) & 1 != 0 && self.interrupts() & self.get(GINTMSK) != 0)
    }

    /// Reads a register for the firmware, at an offset from the core's base.
    pub fn read(&mut self, offset: u32, now: VirtualNanos) -> u32 {
        match offset {
            GINTSTS => self.interrupts(),
            GRXSTSR => self.received.front().copied().unwrap_or(0),
            GRXSTSP => self.pop_status(),
            DAINT => self.endpoint_interrupts(),
            // The frame number counts milliseconds.
            DSTS => self.get(DSTS) | ((now.0 / 1_000_000) as u32 & 0x3FFF) << 8,
            FIFOS.. => self.receive_fifo.pop_front().unwrap_or(0),
            _ => match in_register(offset) {
                Some((number, TXFSTS)) => self.transmit_space(number),
                Some((number, INT)) => {
                    let empty = self.transmit_fifo[number].is_empty();
                    self.get(offset) | if empty { TXFE } else { 0 }
                }
                _ => self.get(offset),
            },
        }
    }

    fn pop_status(&mut self) -> u32 {
        let Some(status) = self.received.pop_front() else { return 0 };
        let number = (status & 0xF) as usize;
        match (status >> 17) & 0xF {
            SETUP_DONE => self.raise(endpoint(OUT_ENDPOINTS, number, INT), STUP),
            OUT_DONE => self.raise(endpoint(OUT_ENDPOINTS, number, INT), XFRC),
            _ => {}
        }
        status
    }

    /// Writes a register for the firmware, at an offset from the core's base.
    pub fn write(&mut self, offset: u32, value: u32) {
        match offset {
            GINTSTS => self.lower(GINTSTS, value & (USBSUSP | USBRST | ENUMDNE | WKUPINT | 0x4000_0408)),
            GRSTCTL => self.reset_control(value),
            CID | DSTS | DAINT | GRXSTSR | GRXSTSP => {}
            FIFOS.. => {
                let number = ((offset - FIFOS) / 0x1000) as usize;
                if number < ENDPOINTS {
                    self.transmit_fifo[number].push_back(value);
                }
            }
            _ => match (in_register(offset), out_register(offset)) {
                (Some((_, INT)), _) | (_, Some((_, INT))) => self.lower(offset, value),
                (Some((number, CTL)), _) | (_, Some((number, CTL))) => {
                    self.endpoint_control(offset, number, value);
                }
                (Some((_, TXFSTS)), _) => {}
                _ => self.set(offset, value),
            },
        }
    }

    fn reset_control(&mut self, value: u32) {
        if value & 1 != 0 {
            self.reset_words();
            self.soft_reset = true;
        }
        if value & (1 << 4) != 0 {
            self.received.clear();
            self.receive_fifo.clear();
        }
        if value & (1 << 5) != 0 {
            match ((value >> 6) & 0x1F) as usize {
                0x10 => self.transmit_fifo.iter_mut().for_each(VecDeque::clear),
                number if number < ENDPOINTS => self.transmit_fifo[number].clear(),
                _ => {}
            }
        }
        // The AHB master is always idle, and every reset or flush ends at once.
        self.set(GRSTCTL, 1 << 31 | value & (0x1F << 6));
    }

    fn endpoint_control(&mut self, offset: u32, number: usize, value: u32) {
        let old = self.get(offset);
        let mut new = value & !(NAKSTS | CNAK | SNAK | EPDIS | EPENA | 3 << 28);
        new |= old & (NAKSTS | EPENA);
        if number == 0 {
            // The firmware sets STALL of the control endpoint, and a SETUP packet clears it.
            new |= USBAEP | (old & STALL);
        }
        if value & SNAK != 0 {
            new |= NAKSTS;
        }
        if value & CNAK != 0 {
            new &= !NAKSTS;
        }
        if value & EPENA != 0 {
            new |= EPENA;
        }
        if value & EPDIS != 0 && new & EPENA != 0 {
            new &= !EPENA;
            self.raise(offset - CTL + INT, EPDISD);
        }
        self.set(offset, new);
    }
}

fn little_endian(bytes: &[u8]) -> u32 {
    let mut word = [0; 4];
    word[..bytes.len()].copy_from_slice(bytes);
    u32::from_le_bytes(word)
}

fn in_register(offset: u32) -> Option<(usize, u32)> {
    register_of(offset, IN_ENDPOINTS)
}

fn out_register(offset: u32) -> Option<(usize, u32)> {
    register_of(offset, OUT_ENDPOINTS)
}

fn register_of(offset: u32, direction: u32) -> Option<(usize, u32)> {
    let from = offset.checked_sub(direction)?;
    let number = (from / 0x20) as usize;
    (number < ENDPOINTS).then_some((number, from % 0x20))
}
