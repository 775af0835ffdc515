//! The interface of a board ([`Board`]), and this image's board ([`This`]). Every board has a file and a Cargo feature.

// Two board features define `This` twice, which does not compile.
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
use haptic_bridge::control::compiled::Legs;
use haptic_bridge::control::frame::Samples;
use haptic_bridge::control::joints::Counts;
use haptic_bridge::drive::carrier::Carrier;
use haptic_bridge::drive::stage::Bridge;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::safety::fault::Fault;
use haptic_bridge::safety::limits::Limits;

use crate::angle_sensors::AngleSensors;
use crate::gate::Gate;

/// Highest level of the supply monitor, 2.9 V (STM32F405 datasheet, table 19), for a supply of 3.3 V.
pub const MONITOR_2V9: u8 = 7;

/// A pin of ports A to D, as 16 times the port's number (0 for A) plus the pin's number.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Pin(pub(crate) u8);

/// Time in which a pin follows a pull of 40 kohm, us: enough for a thousand times a 1 m wire's capacitance (100 pF).
const PULL_US: u64 = 500;
/// Ports A to D, in the order of [`Pin`]'s numbers.
const PORTS: [Gpio; 4] = [pac::GPIOA, pac::GPIOB, pac::GPIOC, pac::GPIOD];

impl Pin {
    /// Returns pin `number` of `port`.
    pub const fn new(port: char, number: u8) -> Self {
        Self((port as u8 - b'A') << 4 | number)
    }

    /// Returns true if the pin, an input, follows the chip's pull-down and pull-up twice. A pin that the board holds
    /// does not change its level.
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

/// Pins that identify a board before any pin is driven. The chip pulls each pin with 40 kohm. An open pin follows the
/// pull, a held pin does not. No identifying pin may lead to a gate, an enable line or a bridge input of any board,
/// because the pull could switch a bridge on. For example, the pull would raise EN_GATE of an ODrive to 1.8 V.
pub struct IdentityPins {
    /// Pins that the board holds at a level.
    pub held_pins: &'static [Pin],
    /// Pins that the board leaves open.
    pub open_pins: &'static [Pin],
}

/// A motor-driver board.
pub trait Board {
    /// The board's name, as the host shows it.
    const NAME: &'static str;
    /// The pins that identify the board.
    const IDENTITY: IdentityPins;
    /// Level of the chip's supply monitor, 0 to 7: the highest level that the board's supply always exceeds.
    const SUPPLY_LEVEL: u8 = MONITOR_2V9;
    /// Number of motors that the board can drive, at most [`MAX_JOINTS`].
    const AXES: usize;
    /// Number of encoder inputs, those of the motors first, at most [`MAX_JOINTS`].
    const ENCODERS: u8 = Self::AXES as u8;
    /// Data of the bridges for the drive.
    const BRIDGE: Bridge;
    /// Limits that cannot be raised over USB.
    const LIMITS: Limits;
    /// Fault to record when the power stage reports a fault.
    const POWER_FAULT: Fault;
    /// Faults that the board cannot sense.
    const UNSENSED: &'static [Fault];
    /// The part that the control interrupt owns.
    type Io: Io;
    /// The part that the tasks own.
    type Gate: Gate;
    /// Turns the bridges off by plain register writes, which work in any state of the program, even in fault handlers.
    fn turn_bridges_off();
    /// Divides the chip's peripherals between interrupt and tasks, and sets the timers to `carrier` without starting
    /// them. If `board` is false, the chip is on another board: only USB's pins are used, there is no power stage, and
    /// all pins that this image would drive stay inputs until the next reset.
    fn split(p: Peripherals, carrier: Carrier, board: bool) -> (Self::Io, Option<Self::Gate>, Common);
}

/// The part of a board that the control interrupt owns: encoders, converters, bridges. All its functions are bounded in
/// time.
pub trait Io {
    /// Updates the encoder counts, one per axis. They are 0 at power-on.
    fn update_counts(&mut self, counts: &mut Counts);
    /// Updates the counts of the encoder inputs after those of the axes. Called once a step for a device with encoders
    /// without motors.
    fn update_other_counts(&mut self, _counts: &mut Counts) {}
    /// Returns true if an index pulse came since the last call of [`Io::marks`].
    fn has_marks(&self) -> bool;
    /// Returns the counts of the encoders with an index pulse since the last call.
    fn marks(&mut self, counts: &Counts) -> [Option<i32>; MAX_JOINTS];
    /// Clears stale flags of the converters. Call between two crests, because a stale flag would make every later
    /// reading one crest old or mix two crests.
    fn clear_flags(&mut self);
    /// Returns true if the conversions that the crest started have finished.
    fn has_sampled(&self) -> bool;
    /// Waits for the conversions. Returns true if they finish.
    fn await_samples(&self) -> bool;
    /// Writes the readings to `samples`: bus voltage, currents, and the difference of two sensors of one current.
    fn sample(&mut self, samples: &mut Samples);
    /// Takes the readings as the sensors' zeros if a task waits for zeros. Call while the bridges are off.
    fn learn_zeros(&mut self);
    /// Writes the compare values of each axis's legs, which apply at the next valley.
    fn write(&mut self, legs: &Legs);
    /// Connects the third legs of these axes to the carrier, and all other third legs to ground. Call while the bridges
    /// are off.
    fn connect_third_legs(&mut self, _axes: [bool; MAX_JOINTS]) {}
    /// Returns the absolute encoders; `None` if the board has no bus for them.
    fn angle_sensors(&mut self) -> Option<&mut AngleSensors> {
        None
    }
    /// Connects the bridges to the carrier, or lets them float and disables the gate drivers or the enable line.
    fn drive(&mut self, on: bool);
    /// Returns true if the power stage reports a fault. Valid only while the power stage is enabled.
    fn has_fault(&self) -> bool;

    fn carrier(&self) -> &Carrier;
    /// Changes the carrier of all axes at the same extreme.
    fn set_carrier(&mut self, carrier: Carrier);

    fn start(&mut self);
}

/// Peripherals that every board passes to its tasks.
pub struct Common {
    /// The USB device and its two pins.
    pub usb: (Peri<'static, USB_OTG_FS>, Peri<'static, PA12>, Peri<'static, PA11>),
    /// Flash, for the settings.
    pub flash: Peri<'static, FLASH>,
    pub watchdog: Peri<'static, IWDG>,
}
