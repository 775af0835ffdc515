//! The computer at the other end of the USB cable. It enumerates a device like a PC, opens its serial port, and
//! transfers bytes in both directions. Tests can unplug the cable, suspend, close or not read the port, and write
//! garbage.
//!
//! Sources: USB 2.0 chapters 5, 8 and 9, and CDC PSTN 1.2 section 6.3 (line coding, control line state).

use std::collections::VecDeque;

use rigless::time::VirtualNanos;

use crate::otg_core::{Core, Handshake};

const MILLISECOND: u64 = 1_000_000;
/// Time from the pull-up to the first reset, the minimum of USB 2.0 section 7.1.7.3, ns. A PC waits longer.
const DEBOUNCE_NS: u64 = 100 * MILLISECOND;
/// Length of a reset, the minimum of USB 2.0 section 7.1.7.5, ns.
const RESET_NS: u64 = 10 * MILLISECOND;
/// Recovery time after a reset, the minimum of USB 2.0 section 7.1.7.5, ns.
const RECOVERY_NS: u64 = 10 * MILLISECOND;
/// Idle time after which a device counts as suspended (USB 2.0 section 7.1.7.6), ns.
const IDLE_NS: u64 = 3 * MILLISECOND;
/// Length of a resume (USB 2.0 section 7.1.7.7), ns.
const RESUME_NS: u64 = 20 * MILLISECOND;

const DEVICE_ADDRESS: u8 = 5;
/// Maximum length of a full-speed bulk packet, bytes.
const PACKET_BYTES: usize = 64;

/// Returns the duration of a packet of `bytes` bytes on the bus at 12 Mbit/s, with about 13 bytes of overhead, ns.
fn bus_time(bytes: usize) -> u64 {
    (bytes as u64 + 13) * 8 * 1000 / 12
}

/// An event at the host, which is recorded for tests.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// The device enabled its pull-up.
    Connected,
    /// The device was unplugged, or its pull-up went off.
    Disconnected,
    /// The bus was reset.
    Reset,
    /// The device accepted its address.
    Addressed,
    /// The device is configured and has a serial port.
    Configured,
    /// The port was opened (terminal ready is set).
    Opened,
    /// The port was closed.
    Closed,
    /// The device was suspended.
    Suspended,
    /// The device was resumed.
    Resumed,
    /// The device stalled a request with this setup packet.
    Stalled([u8; 8]),
}

/// Descriptors read during enumeration.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Descriptors {
    /// The device descriptor, 18 bytes.
    pub device: Vec<u8>,
    /// The complete configuration descriptor.
    pub configuration: Vec<u8>,
    /// Manufacturer, product and serial number, if the device has them.
    pub strings: Vec<String>,
}

impl Descriptors {
    /// Returns the vendor id and the product id.
    #[must_use]
    pub fn ids(&self) -> (u16, u16) {
        let word = |at: usize| {
            u16::from_le_bytes([
                self.device.get(at).copied().unwrap_or(0),
                self.device.get(at + 1).copied().unwrap_or(0),
            ])
        };
        (word(8), word(10))
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Port {
    communication: u8,
    data_in: usize,
    data_out: usize,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Bus {
    #[default]
    Detached,
    Debounce(u64),
    Reset(u64),
    Recovery(u64),
    Active,
    GoingIdle(u64),
    Suspended,
    Resuming(u64),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    DeviceHead,
    SetAddress,
    Device,
    ConfigurationHead,
    Configuration,
    String(u8),
    SetConfiguration,
    LineCoding,
    LineState(bool),
    UserRequest,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Setup,
    DataIn,
    DataOut,
    StatusIn,
    StatusOut,
}

#[derive(Clone, Debug)]
struct Control {
    step: Step,
    setup: [u8; 8],
    data: Vec<u8>,
    stage: Stage,
}

impl Control {
    fn read(step: Step, kind: u8, request: u8, value: u16, index: u16, length: u16) -> Self {
        let setup = setup(kind, request, value, index, length);
        Self { step, setup, data: Vec::new(), stage: Stage::Setup }
    }

    fn write(step: Step, kind: u8, request: u8, value: u16, index: u16, data: &[u8]) -> Self {
        let setup = setup(kind, request, value, index, data.len() as u16);
        Self { step, setup, data: data.to_vec(), stage: Stage::Setup }
    }

    fn is_read(&self) -> bool {
        self.setup[0] & 0x80 != 0
    }

    fn length(&self) -> usize {
        usize::from(u16::from_le_bytes([self.setup[6], self.setup[7]]))
    }
}

fn setup(kind: u8, request: u8, value: u16, index: u16, length: u16) -> [u8; 8] {
    let ([v0, v1], [i0, i1], [l0, l1]) = (value.to_le_bytes(), index.to_le_bytes(), length.to_le_bytes());
    [kind, request, v0, v1, i0, i1, l0, l1]
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Transaction {
    Control(Stage),
    BulkOut,
    BulkIn,
}

/// The host computer.
#[derive(Debug)]
pub struct Host {
    is_plugged: bool,
    open_requested: bool,
    reads_port: bool,
    suspend_requested: bool,
    bus: Bus,
    resets: u32,
    steps: VecDeque<Step>,
    user_requests: VecDeque<Control>,
    control: Option<Control>,
    port: Option<Port>,
    port_is_open: bool,
    in_progress: Option<(Transaction, u64)>,
    free_at: u64,
    last_was_out: bool,
    to_device: VecDeque<u8>,
    from_device: Vec<u8>,
    replies: Vec<Result<Vec<u8>, [u8; 8]>>,
    descriptors: Descriptors,
    log: Vec<(VirtualNanos, Event)>,
}

/// A PC with a running tool: the cable is plugged, the port is open, and the host reads.
impl Default for Host {
    fn default() -> Self {
        Self {
            is_plugged: true,
            open_requested: true,
            reads_port: true,
            suspend_requested: false,
            bus: Bus::Detached,
            resets: 0,
            steps: VecDeque::new(),
            user_requests: VecDeque::new(),
            control: None,
            port: None,
            port_is_open: false,
            in_progress: None,
            free_at: 0,
            last_was_out: false,
            to_device: VecDeque::new(),
            from_device: Vec::new(),
            replies: Vec::new(),
            descriptors: Descriptors::default(),
            log: Vec::new(),
        }
    }
}

impl Host {
    /// Plugs or unplugs the cable.
    pub fn plug(&mut self, plugged: bool) {
        self.is_plugged = plugged;
    }

    /// Opens or closes the serial port, like a program on a PC.
    pub fn open(&mut self, open: bool) {
        self.open_requested = open;
    }

    /// Reads the port if `reading` is true. Otherwise the device's data stay unread.
    pub fn read_port(&mut self, reading: bool) {
        self.reads_port = reading;
    }

    /// Suspends the bus if `idle` is true, like a sleeping PC. Otherwise resumes the bus.
    pub fn suspend(&mut self, idle: bool) {
        self.suspend_requested = idle;
    }

    /// Queues bytes for the port.
    pub fn write(&mut self, bytes: &[u8]) {
        self.to_device.extend(bytes);
    }

    /// Drops queued bytes that are not sent yet.
    pub fn discard(&mut self) {
        self.to_device.clear();
    }

    /// Returns the bytes that were received since the last call.
    pub fn take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.from_device)
    }

    /// Queues any control request, valid or not, as a setup packet and the `data` of a write.
    pub fn request(&mut self, setup: [u8; 8], data: &[u8]) {
        let (step, data) = (Step::UserRequest, data.to_vec());
        self.user_requests.push_back(Control { step, setup, data, stage: Stage::Setup });
    }

    /// Returns the replies to queued control requests, in order: the data of a read, or the setup packet if stalled.
    pub fn take_replies(&mut self) -> Vec<Result<Vec<u8>, [u8; 8]>> {
        std::mem::take(&mut self.replies)
    }

    /// Returns true if the port of a configured device is open, so that bytes can be transferred.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        self.bus == Bus::Active && self.port.is_some() && self.port_is_open
    }

    /// Returns the descriptors that were read during enumeration.
    #[must_use]
    pub fn descriptors(&self) -> &Descriptors {
        &self.descriptors
    }

    /// Returns all events with their times.
    #[must_use]
    pub fn log(&self) -> &[(VirtualNanos, Event)] {
        &self.log
    }

    /// Handles a disconnect without a movement of the cable, because the device's chip restarted.
    pub fn device_disconnected(&mut self) {
        if self.bus != Bus::Detached {
            let at = self.log.last().map_or(VirtualNanos(0), |&(at, _)| at);
            self.disconnect(at);
        }
    }

    fn disconnect(&mut self, at: VirtualNanos) {
        self.bus = Bus::Detached;
        self.control = None;
        self.steps.clear();
        self.in_progress = None;
        self.port = None;
        self.port_is_open = false;
        self.to_device.clear();
        self.log.push((at, Event::Disconnected));
    }

    /// Continues with all transactions that are possible at `now`. Returns the time of the next action, or `None` if
    /// the next action depends on the device.
    pub fn advance(&mut self, core: &mut Core, now: VirtualNanos) -> Option<VirtualNanos> {
        self.follow_cable(core, now);
        let due = |at: u64| now.0 >= at;
        match self.bus {
            Bus::Detached | Bus::Suspended => None,
            Bus::Debounce(at) if due(at) => {
                core.bus_reset();
                self.log.push((now, Event::Reset));
                self.wait(Bus::Reset, now, RESET_NS)
            }
            Bus::Reset(at) if due(at) => {
                core.enumeration_done();
                self.resets += 1;
                self.wait(Bus::Recovery, now, RECOVERY_NS)
            }
            Bus::Recovery(at) if due(at) => {
                self.bus = Bus::Active;
                self.start_enumeration();
                self.transact(core, now)
            }
            Bus::GoingIdle(at) if due(at) => {
                core.suspend();
                self.log.push((now, Event::Suspended));
                self.bus = Bus::Suspended;
                None
            }
            Bus::Resuming(at) if due(at) => {
                self.log.push((now, Event::Resumed));
                self.bus = Bus::Active;
                self.transact(core, now)
            }
            Bus::Active => self.transact(core, now),
            Bus::Debounce(at) | Bus::Reset(at) | Bus::Recovery(at) | Bus::GoingIdle(at) | Bus::Resuming(at) => {
                Some(VirtualNanos(at))
            }
        }
    }

    fn wait(&mut self, then: fn(u64) -> Bus, now: VirtualNanos, span: u64) -> Option<VirtualNanos> {
        self.bus = then(now.0 + span);
        Some(VirtualNanos(now.0 + span))
    }

    fn follow_cable(&mut self, core: &mut Core, now: VirtualNanos) {
        let is_present = self.is_plugged && core.is_connected();
        match self.bus {
            Bus::Detached if is_present => {
                self.log.push((now, Event::Connected));
                self.resets = 0;
                self.bus = Bus::Debounce(now.0 + DEBOUNCE_NS);
            }
            Bus::Detached => {}
            _ if !is_present => {
                // A device that does not sense the bus voltage only notices an idle bus.
                self.disconnect(now);
                core.suspend();
            }
            Bus::Active if self.suspend_requested => self.bus = Bus::GoingIdle(now.0 + IDLE_NS),
            Bus::Suspended | Bus::GoingIdle(_) if !self.suspend_requested => {
                core.resume();
                self.bus = Bus::Resuming(now.0 + RESUME_NS);
            }
            _ => {}
        }
    }

    fn start_enumeration(&mut self) {
        self.control = None;
        self.in_progress = None;
        // A PC reads the start of the device descriptor, resets the bus again, and then continues.
        self.steps = if self.resets == 1 {
            [Step::DeviceHead].into()
        } else {
            [Step::SetAddress, Step::Device, Step::ConfigurationHead].into()
        };
    }

    fn next_control(&mut self) -> Option<Control> {
        if let Some(step) = self.steps.pop_front() {
            return Some(self.control_of(step));
        }
        let port = self.port?;
        if self.open_requested != self.port_is_open {
            let coding = [0x00, 0xC2, 0x01, 0x00, 0, 0, 8];
            let index = u16::from(port.communication);
            return Some(if self.open_requested && self.steps.is_empty() && !self.port_is_open {
                self.steps.push_back(Step::LineState(true));
                Control::write(Step::LineCoding, 0x21, 0x20, 0, index, &coding)
            } else {
                self.control_of(Step::LineState(self.open_requested))
            });
        }
        self.user_requests.pop_front()
    }

    fn control_of(&self, step: Step) -> Control {
        let total =
            (self.descriptors.configuration.get(2..4)).map_or(9, |length| u16::from_le_bytes([length[0], length[1]]));
        let read = |value, index, length| Control::read(step, 0x80, 6, value, index, length);
        let write = |request, value| Control::write(step, 0x00, request, value, 0, &[]);
        match step {
            Step::DeviceHead => read(0x0100, 0, 64),
            Step::SetAddress => write(5, u16::from(DEVICE_ADDRESS)),
            Step::Device => read(0x0100, 0, 18),
            Step::ConfigurationHead => read(0x0200, 0, 9),
            Step::Configuration => read(0x0200, 0, total),
            Step::String(index) => read(0x0300 | u16::from(index), 0x0409, 255),
            Step::SetConfiguration => write(9, 1),
            Step::LineState(on) => {
                let index = self.port.map_or(0, |port| u16::from(port.communication));
                Control::write(step, 0x21, 0x22, if on { 3 } else { 0 }, index, &[])
            }
            Step::LineCoding | Step::UserRequest => unreachable!("created by next_control and request"),
        }
    }

    fn transact(&mut self, core: &mut Core, now: VirtualNanos) -> Option<VirtualNanos> {
        loop {
            if let Some((transaction, ends)) = self.in_progress {
                if now.0 < ends {
                    return Some(VirtualNanos(ends));
                }
                self.in_progress = None;
                self.free_at = ends;
                self.complete(transaction, core, now);
                if self.bus != Bus::Active {
                    return self.advance(core, now);
                }
            }
            if self.control.is_none() {
                self.control = self.next_control();
            }
            let (transaction, bytes) = self.next_transaction(core)?;
            let begins = now.0.max(self.free_at);
            self.in_progress = Some((transaction, begins + bus_time(bytes)));
        }
    }

    /// Returns the next transaction that the device would not reject, and its number of bytes.
    fn next_transaction(&mut self, core: &Core) -> Option<(Transaction, usize)> {
        let ready_bytes = |answer: Handshake<usize>| match answer {
            Handshake::Ack(bytes) => Some(bytes),
            Handshake::Stall => Some(0),
            Handshake::Nak => None,
        };
        let accepted_bytes = |answer: Handshake<()>, bytes: usize| match answer {
            Handshake::Ack(()) => ready_bytes(Handshake::Ack(bytes)),
            Handshake::Stall => Some(0),
            Handshake::Nak => None,
        };
        if let Some(control) = &self.control {
            let bytes = match control.stage {
                Stage::Setup => Some(8),
                Stage::DataIn | Stage::StatusIn => ready_bytes(core.offers(0)),
                Stage::DataOut => accepted_bytes(core.accepts(0), control.data.len().min(PACKET_BYTES)),
                Stage::StatusOut => accepted_bytes(core.accepts(0), 0),
            };
            if let Some(bytes) = bytes {
                return Some((Transaction::Control(control.stage), bytes));
            }
        }
        let port = self.port.filter(|_| self.port_is_open)?;
        let waiting = self.to_device.len().min(PACKET_BYTES);
        let out = (waiting > 0).then(|| accepted_bytes(core.accepts(port.data_out), waiting)).flatten();
        let input = self.reads_port.then(|| ready_bytes(core.offers(port.data_in))).flatten();
        match (out, input) {
            (Some(bytes), None) => Some((Transaction::BulkOut, bytes)),
            (Some(bytes), Some(_)) if !self.last_was_out => Some((Transaction::BulkOut, bytes)),
            (_, Some(bytes)) => Some((Transaction::BulkIn, bytes)),
            (None, None) => None,
        }
    }

    fn complete(&mut self, transaction: Transaction, core: &mut Core, now: VirtualNanos) {
        match (transaction, self.port) {
            (Transaction::Control(_), _) => self.complete_control(core, now),
            (Transaction::BulkOut, Some(port)) => {
                let packet: Vec<u8> = self.to_device.iter().take(PACKET_BYTES).copied().collect();
                if core.receive_out(port.data_out, &packet) == Handshake::Ack(()) {
                    self.to_device.drain(..packet.len());
                }
                self.last_was_out = true;
            }
            (Transaction::BulkIn, Some(port)) => {
                if let Handshake::Ack(data) = core.send_in(port.data_in) {
                    self.from_device.extend(data);
                }
                self.last_was_out = false;
            }
            (_, None) => {}
        }
    }

    fn complete_control(&mut self, core: &mut Core, now: VirtualNanos) {
        let Some(mut control) = self.control.take() else { return };
        let next = match control.stage {
            Stage::Setup => {
                core.receive_setup(control.setup);
                Some(match (control.is_read(), control.length()) {
                    (true, 1..) => Stage::DataIn,
                    (false, 1..) => Stage::DataOut,
                    (_, 0) => Stage::StatusIn,
                })
            }
            Stage::DataIn => match core.send_in(0) {
                Handshake::Ack(packet) => {
                    control.data.extend(&packet);
                    let over = packet.len() < PACKET_BYTES || control.data.len() >= control.length();
                    Some(if over { Stage::StatusOut } else { Stage::DataIn })
                }
                Handshake::Nak => Some(Stage::DataIn),
                Handshake::Stall => None,
            },
            Stage::DataOut => {
                let length = control.data.len().min(PACKET_BYTES);
                match core.receive_out(0, &control.data[..length]) {
                    Handshake::Ack(()) => {
                        control.data.drain(..length);
                        let over = control.data.is_empty();
                        Some(if over { Stage::StatusIn } else { Stage::DataOut })
                    }
                    Handshake::Nak => Some(Stage::DataOut),
                    Handshake::Stall => None,
                }
            }
            Stage::StatusIn => match core.send_in(0) {
                Handshake::Ack(_) => return self.finish(control, now),
                Handshake::Nak => Some(Stage::StatusIn),
                Handshake::Stall => None,
            },
            Stage::StatusOut => match core.receive_out(0, &[]) {
                Handshake::Ack(()) => return self.finish(control, now),
                Handshake::Nak => Some(Stage::StatusOut),
                Handshake::Stall => None,
            },
        };
        match next {
            Some(stage) => self.control = Some(Control { stage, ..control }),
            None => {
                self.log.push((now, Event::Stalled(control.setup)));
                if control.step == Step::UserRequest {
                    self.replies.push(Err(control.setup));
                }
            }
        }
    }

    fn finish(&mut self, control: Control, now: VirtualNanos) {
        match control.step {
            Step::DeviceHead => self.bus = Bus::Debounce(now.0),
            Step::SetAddress => self.log.push((now, Event::Addressed)),
            Step::Device => self.descriptors.device = control.data,
            Step::ConfigurationHead => {
                self.descriptors.configuration = control.data;
                self.steps.push_back(Step::Configuration);
                self.descriptors.strings.clear();
                let indices = self.descriptors.device.get(14..17).unwrap_or(&[]);
                self.steps.extend(indices.iter().filter(|&&index| index != 0).map(|&index| Step::String(index)));
                self.steps.push_back(Step::SetConfiguration);
            }
            Step::Configuration => self.descriptors.configuration = control.data,
            Step::String(_) => {
                let units: Vec<u16> = (control.data.get(2..).unwrap_or(&[]))
                    .chunks_exact(2)
                    .map(|unit| u16::from_le_bytes([unit[0], unit[1]]))
                    .collect();
                self.descriptors.strings.push(String::from_utf16_lossy(&units));
            }
            Step::SetConfiguration => {
                self.port = find_port(&self.descriptors.configuration);
                self.log.push((now, Event::Configured));
            }
            Step::LineCoding => {}
            Step::LineState(on) => {
                self.port_is_open = on;
                self.log.push((now, if on { Event::Opened } else { Event::Closed }));
            }
            Step::UserRequest => self.replies.push(Ok(control.data)),
        }
    }
}

/// Finds the first communication interface and the bulk endpoints of the first data interface.
fn find_port(configuration: &[u8]) -> Option<Port> {
    let (mut communication, mut data_in, mut data_out) = (None, None, None);
    let mut class = 0;
    let mut rest = configuration;
    while let [length, kind, ..] = *rest {
        let descriptor = rest.get(..usize::from(length.max(2)))?;
        match (kind, descriptor) {
            (4, [_, _, number, _, _, interface_class, ..]) => {
                class = *interface_class;
                if class == 0x02 {
                    communication = communication.or(Some(*number));
                }
            }
            (5, [_, _, address, attributes, ..]) if class == 0x0A && attributes & 3 == 2 => {
                let number = Some(usize::from(address & 0xF));
                if address & 0x80 != 0 {
                    data_in = data_in.or(number);
                } else {
                    data_out = data_out.or(number);
                }
            }
            _ => {}
        }
        rest = &rest[descriptor.len()..];
    }
    Some(Port { communication: communication?, data_in: data_in?, data_out: data_out? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_serial_port_is_found_by_its_classes() {
        let configuration = [
            9, 2, 0, 0, 2, 1, 0, 0x80, 50, // configuration
            9, 4, 0, 0, 1, 2, 2, 0, 0, // communication interface 0
            5, 0x24, 0, 0x10, 1, // functional descriptor
            7, 5, 0x81, 3, 8, 0, 255, // interrupt endpoint
            9, 4, 1, 0, 2, 0x0A, 0, 0, 0, // data interface 1
            7, 5, 0x02, 2, 64, 0, 0, 7, 5, 0x82, 2, 64, 0, 0,
        ];
        let port = find_port(&configuration);
        assert_eq!(port, Some(Port { communication: 0, data_in: 2, data_out: 2 }));
        assert_eq!(find_port(&configuration[..27]), None);
        assert_eq!(find_port(&[0, 0, 0]), None);
    }

    #[test]
    fn a_frame_has_room_for_nineteen_full_packets() {
        assert_eq!(1_000_000 / bus_time(PACKET_BYTES), 19);
    }
}
