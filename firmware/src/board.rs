//! The interface of a board ([`Board`]), and the one this image is for ([`This`]): one file per board, one Cargo
//! feature each.

// Two features name `This` twice, which no image compiles with.
#[cfg(not(any(
    feature = "odrive-v3",
    feature = "h-bridge-f405",
    feature = "h-bridge-f407-disc1",
    feature = "toy-board"
)))]
compile_error!("choose a board: `--features odrive-v3`, `h-bridge-f405` or `h-bridge-f407-disc1`");

#[cfg(any(feature = "h-bridge-f405", feature = "h-bridge-f407-disc1"))]
mod h_bridges;

#[cfg(feature = "h-bridge-f405")]
mod h_bridge_f405;
/// This image's board.
#[cfg(feature = "h-bridge-f405")]
pub type This = h_bridges::HBridges<h_bridge_f405::HBridgeF405>;

#[cfg(feature = "h-bridge-f407-disc1")]
mod h_bridge_f407_disc1;
/// This image's board.
#[cfg(feature = "h-bridge-f407-disc1")]
pub type This = h_bridges::HBridges<h_bridge_f407_disc1::HBridgeF407Disc1>;

#[cfg(feature = "odrive-v3")]
mod odrive_v3;
#[cfg(feature = "odrive-v3")]
pub use odrive_v3::OdriveV3 as This;

#[cfg(feature = "toy-board")]
#[path = "../../emulator/tests/emulated/toy_board.rs"]
mod toy_board;
#[cfg(feature = "toy-board")]
pub use toy_board::ToyBoard as This;

use embassy_stm32::pac;
use embassy_stm32::pac::gpio::Gpio;
use embassy_stm32::pac::gpio::vals::{Idr, Pupdr};
use embassy_stm32::peripherals::{FLASH, IWDG, PA11, PA12, USB_OTG_FS};
use embassy_stm32::{Peri, Peripherals};
use embassy_time::{Duration, block_for};
use haptic_bridge::drive::carrier::Carrier;
use haptic_bridge::drive::stage::Bridge;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::safety::fault::Fault;
use haptic_bridge::safety::limits::Limits;
use haptic_bridge::servo::frame::Samples;
use haptic_bridge::servo::joints::Counts;

use crate::gate::Gate;

/// Highest level of the supply monitor: 2.9 V (STM32F405 datasheet, table 19), for a supply of 3.3 V.
pub const MONITOR_2V9: u8 = 7;

/// A pin of ports A to D: sixteen times its port's number, 0 for A, and its number there.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Pin(pub(crate) u8);

/// Time after which a pin follows a pull, us: 40 kohm, and a thousand times what a wire of a metre has (100 pF).
const PULL_US: u64 = 500;

/// The ports.
const PORTS: [Gpio; 4] = [pac::GPIOA, pac::GPIOB, pac::GPIOC, pac::GPIOD];

impl Pin {
    /// Pin `number` of `port`.
    pub const fn new(port: char, number: u8) -> Self {
        Self((port as u8 - b'A') << 4 | number)
    }

    /// Returns true if nothing outside holds the pin, so that it follows the chip's own pulls down and up, twice. A
    /// pin held between the two levels may read as either, but does not change. Call it while the pin is an input; it
    /// leaves the pin an input without a pull.
    pub fn is_open(self) -> bool {
        let (port, number) = (PORTS[usize::from(self.0 >> 4 & 3)], usize::from(self.0 & 15));
        let pulls = [(Pupdr::PULL_DOWN, Idr::LOW), (Pupdr::PULL_UP, Idr::HIGH)];
        let follows = pulls.into_iter().chain(pulls).all(|(pull, level)| {
            port.pupdr().modify(|w| w.set_pupdr(number, pull));
            block_for(Duration::from_micros(PULL_US));
            port.idr().read().idr(number) == level
        });
        port.pupdr().modify(|w| w.set_pupdr(number, Pupdr::FLOATING));
        follows
    }
}

/// Pins that tell one board from another before any pin is driven: some are held at a level by the board, others lead
/// nowhere. The chip pulls at each of them with its own 40 kohm, and a pin that leads nowhere follows. None of them
/// leads to a gate, an enable line or an input of a bridge on any board: on the wrong board the pull would move such a
/// pin towards on. EN_GATE of an ODrive, for example, would rest at 1.8 V between the chip's 40 kohm and the 50 kohm
/// inside its two drivers.
pub struct Signs {
    /// Held at a level.
    pub held: &'static [Pin],
    /// Without anything.
    pub open: &'static [Pin],
}

/// A motor-driver board.
pub trait Board {
    /// Its name, as the host shows it.
    const NAME: &'static str;
    /// The pins that identify it.
    const SIGNS: Signs;
    /// The level of the chip's supply monitor, 0 to 7: the highest that its supply surely is above.
    const SUPPLY_LEVEL: u8 = MONITOR_2V9;
    /// Motors that it can drive, at most [`MAX_JOINTS`].
    const AXES: usize;
    /// Data of its bridges that the drive needs.
    const BRIDGE: Bridge;
    /// Limits that cannot be raised over USB.
    const LIMITS: Limits;
    /// The fault to record when the power stage reports one.
    const POWER_FAULT: Fault;
    /// Faults that it has no means to see.
    const UNSENSED: &'static [Fault];
    /// The part that the control interrupt owns.
    type Io: Io;
    /// The part that the tasks own.
    type Gate: Gate;

    /// Bridges off. Plain register writes: works in any state of the program, even in a fault handler.
    fn off();

    /// Divides the chip. `carrier` is what the board starts with; nothing runs and nothing is driven yet. Where the chip
    /// is not on this `board`, no pin but USB's is touched, there is no power stage, and the pins that this image would
    /// drive stay inputs until the next reset.
    fn split(p: Peripherals, carrier: Carrier, board: bool) -> (Self::Io, Option<Self::Gate>, Common);
}

/// The part of a board that the control interrupt owns: encoders, conversions, bridges. Every function is bounded in
/// time.
pub trait Io {
    /// Brings encoder counts up to date, one per axis; they were 0 at power-on.
    fn follow(&mut self, counts: &mut Counts);

    /// Returns true if index pulses were seen since [`Io::marks`].
    fn marked(&self) -> bool;

    /// The counts of encoders whose index pulse was seen since the last call.
    fn marks(&mut self, counts: &Counts) -> [Option<i32>; MAX_JOINTS];

    /// Clears stale flags of the converters. Call between two crests: a flag left over once would make every later reading
    /// a crest old, or torn between two.
    fn forget(&mut self);

    /// Returns true if the conversions that the crest started have finished.
    fn sampled(&self) -> bool;
    /// Waits for them; returns true if they finish.
    fn await_samples(&self) -> bool;

    /// Puts their readings into `seen`: bus voltage, currents, and what two sensors of one differ by.
    fn sample(&mut self, seen: &mut Samples);

    /// Takes these readings for the sensors' zeros, where a task waits for that. While the bridges are off.
    fn learn(&mut self);

    /// Compare values of each axis's two legs, applied at the next valley.
    fn write(&mut self, legs: &[[u16; 2]; MAX_JOINTS]);

    /// Connects the bridges to the carrier, or lets them float. Off also drops the gate drivers or the enable line.
    fn drive(&mut self, on: bool);

    /// Returns true if the power stage reports a fault; only meaningful while it is up.
    fn fault(&self) -> bool;

    /// The carrier in use.
    fn carrier(&self) -> &Carrier;

    /// Changes the carrier; all axes take it at the same extreme.
    fn set_carrier(&mut self, carrier: Carrier);

    /// Starts the carrier.
    fn start(&mut self);
}

/// Peripherals that every board hands to its tasks.
pub struct Common {
    /// The USB device and its two pins.
    pub usb: (Peri<'static, USB_OTG_FS>, Peri<'static, PA12>, Peri<'static, PA11>),
    /// Flash, for the settings.
    pub flash: Peri<'static, FLASH>,
    /// The watchdog.
    pub watchdog: Peri<'static, IWDG>,
}
