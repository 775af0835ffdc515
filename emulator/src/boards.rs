//! The wiring of each board, for the virtual hardware around the chip. The pins are those of its page,
//! docs/wiring-*.md, read a second time here, so that a pin swapped in the firmware shows.

pub use haptic_predict::boards::BoardKind;

/// A port pin: the port's letter and the pin's number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pin(pub char, pub u8);

impl Pin {
    /// The pin of a converter's channel.
    #[must_use]
    pub fn of_channel(channel: u8) -> Self {
        match channel {
            low @ 0..=7 => Self('A', low),
            middle @ 8..=9 => Self('B', middle - 8),
            high => Self('C', high - 10),
        }
    }
}

/// An encoder's wires: the general timer that counts it (2 to 5), its two pins and their alternate function.
#[derive(Clone, Copy, Debug)]
pub struct EncoderWires {
    /// TIM2 to TIM5, by number.
    pub timer: u8,
    /// Channel A at the timer's channel 1, channel B at its channel 2.
    pub pins: [Pin; 2],
    /// The alternate function that joins the pins to the timer.
    pub function: u8,
    /// The index mark's pin.
    pub index: Pin,
}

/// One side of a motor: a switched half bridge.
#[derive(Clone, Copy, Debug)]
pub enum HalfBridge {
    /// The upper switch follows a timer channel (1 to 3), the lower one its complement.
    Channel(u8),
    /// The upper switch follows the complement of a channel.
    Complement(u8),
}

/// A motor's wires.
#[derive(Clone, Copy, Debug)]
pub struct MotorWires {
    /// The advanced timer that drives it: 1 or 8.
    pub timer: u8,
    /// The half bridges at its two ends; current flows from the first to the second at positive duty.
    pub ends: [HalfBridge; 2],
    /// The gate signals' pins, and the alternate function that joins them to the timer.
    pub gates: [Pin; 4],
    /// The alternate function of `gates`.
    pub function: u8,
    /// Its current sensors: converter channel, and volts per ampere (from first end to second) of each. A
    /// gain-programmed sensor gives the shunt's volts per ampere; the driver's gain multiplies it.
    pub sensors: &'static [(u8, f64)],
}

/// A board.
#[derive(Clone, Copy, Debug)]
pub struct Wiring {
    /// The name that the board gives itself and that its image is built under.
    pub name: &'static str,
    /// The encoders, one per axis.
    pub encoders: &'static [EncoderWires],
    /// The motors, one per axis.
    pub motors: &'static [MotorWires],
    /// The pin that lets the power stages work, high for on.
    pub enable: Pin,
    /// Every pin that leads to a gate, an input of a bridge or an enable line, of used and unused phases and of the brake.
    pub power: &'static [Pin],
    /// The state of all axes while it is on but the timer's outputs are idle: they float (false) or brake (true).
    pub idle_brakes: bool,
    /// The pin that a power stage pulls low for a fault, and whether that line is the timer's break input.
    pub fault: Pin,
    /// TIM1's break input listens to `fault`.
    pub fault_breaks: bool,
    /// The bus voltage's converter channel and divider.
    pub bus: (u8, f64),
    /// Pins that the board itself holds high, whatever hangs on it, besides the bus divider's.
    pub held: &'static [Pin],
    /// The chip's supply, which is also the converters' reference, mV.
    pub supply_mv: u32,
    /// The chip selects of the gate drivers, on SPI3.
    pub drivers: &'static [Pin],
    /// The nominal bus voltage, V.
    pub bus_voltage: f64,
    /// The zero offset of each current sensor, V: a few millivolts at shunt amplifiers; Hall sensors are taken as
    /// trimmed.
    pub sensor_offsets: [f64; 4],
    /// Dead time that costs voltage, s: both switches of a half bridge off. Zero where a half bridge is a module of its
    /// own.
    pub dead_time: f64,
}

/// Shunts under phases B and C.
const SHUNT: f64 = 500e-6;
/// A 185 mV/A Hall sensor behind a divider from 5 V to 3.3 V.
const HALL: f64 = 0.185 * 0.66;
/// The same, behind a divider to 3.0 V.
const HALL_OF_3V: f64 = 0.185 * 0.6;

static ODRIVE_V3: Wiring = Wiring {
    name: BoardKind::OdriveV3.name(),
    encoders: &[
        EncoderWires { timer: 3, pins: [Pin('B', 4), Pin('B', 5)], function: 2, index: Pin('C', 9) },
        EncoderWires { timer: 4, pins: [Pin('B', 6), Pin('B', 7)], function: 2, index: Pin('C', 15) },
    ],
    motors: &[
        MotorWires {
            timer: 1,
            ends: [HalfBridge::Channel(2), HalfBridge::Channel(3)],
            gates: [Pin('A', 9), Pin('A', 10), Pin('B', 14), Pin('B', 15)],
            function: 1,
            sensors: &[(10, SHUNT), (11, -SHUNT)],
        },
        MotorWires {
            timer: 8,
            ends: [HalfBridge::Channel(2), HalfBridge::Channel(3)],
            gates: [Pin('C', 7), Pin('C', 8), Pin('B', 0), Pin('B', 1)],
            function: 3,
            sensors: &[(13, SHUNT), (12, -SHUNT)],
        },
    ],
    enable: Pin('B', 12),
    power: &[
        Pin('A', 7),
        Pin('A', 8),
        Pin('A', 9),
        Pin('A', 10),
        Pin('B', 0),
        Pin('B', 1),
        Pin('B', 10),
        Pin('B', 11),
        Pin('B', 12),
        Pin('B', 13),
        Pin('B', 14),
        Pin('B', 15),
        Pin('C', 6),
        Pin('C', 7),
        Pin('C', 8),
    ],
    idle_brakes: false,
    fault: Pin('D', 2),
    fault_breaks: false,
    bus: (6, 19.0),
    held: &[Pin('C', 5)],
    supply_mv: 3300,
    drivers: &[Pin('C', 13), Pin('C', 14)],
    bus_voltage: 24.0,
    sensor_offsets: [0.008, -0.005, 0.003, -0.011],
    dead_time: 20.0 / 168e6,
};

static H_BRIDGE_F405: Wiring = Wiring {
    name: BoardKind::HBridgeF405.name(),
    encoders: &[
        EncoderWires { timer: 2, pins: [Pin('A', 15), Pin('B', 3)], function: 1, index: Pin('C', 7) },
        EncoderWires { timer: 3, pins: [Pin('B', 4), Pin('B', 5)], function: 2, index: Pin('C', 8) },
        EncoderWires { timer: 4, pins: [Pin('B', 6), Pin('B', 7)], function: 2, index: Pin('C', 9) },
    ],
    motors: &[
        h_bridge(1, [Pin('A', 8), Pin('B', 13)], &[(10, HALL)]),
        h_bridge(2, [Pin('A', 9), Pin('B', 14)], &[(11, HALL)]),
        h_bridge(3, [Pin('A', 10), Pin('B', 15)], &[(12, HALL)]),
    ],
    enable: Pin('C', 6),
    power: &[Pin('A', 8), Pin('A', 9), Pin('A', 10), Pin('B', 13), Pin('B', 14), Pin('B', 15), Pin('C', 6)],
    idle_brakes: true,
    fault: Pin('B', 12),
    fault_breaks: true,
    bus: (13, 11.0),
    held: &[],
    supply_mv: 3300,
    drivers: &[],
    bus_voltage: 24.0,
    sensor_offsets: [0.0; 4],
    dead_time: 0.0,
};

static H_BRIDGE_F407_DISC1: Wiring = Wiring {
    name: BoardKind::HBridgeF407Disc1.name(),
    encoders: &[
        EncoderWires { timer: 2, pins: [Pin('A', 15), Pin('B', 3)], function: 1, index: Pin('C', 6) },
        EncoderWires { timer: 3, pins: [Pin('B', 4), Pin('B', 5)], function: 2, index: Pin('C', 8) },
        EncoderWires { timer: 4, pins: [Pin('B', 6), Pin('B', 7)], function: 2, index: Pin('C', 9) },
    ],
    motors: &[
        h_bridge(1, [Pin('E', 9), Pin('E', 8)], &[(11, HALL_OF_3V)]),
        h_bridge(2, [Pin('E', 11), Pin('E', 10)], &[(12, HALL_OF_3V)]),
        h_bridge(3, [Pin('E', 13), Pin('E', 12)], &[(1, HALL_OF_3V)]),
    ],
    enable: Pin('E', 14),
    // PA9 is no gate: it has the cable's 5 V.
    power: &[
        Pin('A', 9),
        Pin('E', 8),
        Pin('E', 9),
        Pin('E', 10),
        Pin('E', 11),
        Pin('E', 12),
        Pin('E', 13),
        Pin('E', 14),
    ],
    idle_brakes: true,
    fault: Pin('E', 15),
    fault_breaks: true,
    bus: (14, 12.0),
    held: &[Pin('B', 9)],
    supply_mv: 3000,
    drivers: &[],
    bus_voltage: 24.0,
    sensor_offsets: [0.0; 4],
    dead_time: 0.0,
};

const fn h_bridge(channel: u8, [p, n]: [Pin; 2], sensors: &'static [(u8, f64)]) -> MotorWires {
    let ends = [HalfBridge::Channel(channel), HalfBridge::Complement(channel)];
    MotorWires { timer: 1, ends, gates: [p, n, p, n], function: 1, sensors }
}

impl Wiring {
    /// Half of the chip's supply, where a current sensor stands at no current, V.
    #[must_use]
    pub fn middle(&self) -> f64 {
        0.5e-3 * f64::from(self.supply_mv)
    }

    /// The pin that the bus divider holds.
    #[must_use]
    pub fn bus_pin(&self) -> Pin {
        Pin::of_channel(self.bus.0)
    }

    /// Returns the wiring of a board.
    #[must_use]
    pub fn of(kind: BoardKind) -> &'static Self {
        match kind {
            BoardKind::OdriveV3 => &ODRIVE_V3,
            BoardKind::HBridgeF405 => &H_BRIDGE_F405,
            BoardKind::HBridgeF407Disc1 => &H_BRIDGE_F407_DISC1,
        }
    }
}

impl From<BoardKind> for &'static Wiring {
    fn from(kind: BoardKind) -> Self {
        Wiring::of(kind)
    }
}
