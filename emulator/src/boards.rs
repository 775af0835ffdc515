//! The wiring of each board, for the virtual hardware around the chip. The pins are transcribed again from
//! docs/wiring-*.md, so that a swapped pin in the firmware is detected.

pub use haptic_predict::boards::BoardKind;

/// A port pin, made of the port's letter and the pin's number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pin(pub char, pub u8);

impl Pin {
    /// Returns the pin of a converter channel.
    #[must_use]
    pub fn of_channel(channel: u8) -> Self {
        match channel {
            low @ 0..=7 => Self('A', low),
            middle @ 8..=9 => Self('B', middle - 8),
            high => Self('C', high - 10),
        }
    }
}

/// The wires of an encoder.
#[derive(Clone, Copy, Debug)]
pub struct EncoderWires {
    /// Number of the timer, 2 to 5.
    pub timer: u8,
    /// Pins of channels A and B, at the timer's channels 1 and 2.
    pub pins: [Pin; 2],
    /// Alternate function that connects the pins to the timer.
    pub function: u8,
    /// Pin of the index mark, if the board has one.
    pub index: Option<Pin>,
}

/// A switched half bridge at one end of a motor.
#[derive(Clone, Copy, Debug)]
pub enum HalfBridge {
    /// The upper switch follows a timer channel (1 to 3), and the lower switch follows the complement.
    Channel(u8),
    /// The upper switch follows the complement of a timer channel (1 to 3).
    Complement(u8),
}

/// Wires of a motor.
#[derive(Clone, Copy, Debug)]
pub struct MotorWires {
    /// Number of the advanced timer that drives the motor: 1 or 8.
    pub timer: u8,
    /// Half bridges at the two ends. Current flows from the first to the second at positive duty.
    pub ends: [HalfBridge; 2],
    /// Pins of the gate signals.
    pub gates: [Pin; 4],
    /// Timer channel (1 to 3) of a third half bridge and the pins of its gate signals, for three-phase motors.
    pub third: Option<(u8, [Pin; 2])>,
    /// Alternate function that connects `gates` to the timer.
    pub function: u8,
    /// Current sensors: converter channel and scale (V/A, positive for a current from the first end to the second). If
    /// the amplifier's gain is programmable, the scale is the shunt's resistance.
    pub sensors: &'static [(u8, f64)],
}

/// Wiring of a board.
#[derive(Clone, Copy, Debug)]
pub struct Wiring {
    /// Name of the board and of its image.
    pub name: &'static str,
    /// The encoders, those of the axes first.
    pub encoders: &'static [EncoderWires],
    /// The motors, one per axis.
    pub motors: &'static [MotorWires],
    /// Pin that enables the power stages, active high.
    pub enable: Pin,
    /// All pins that lead to a gate, a bridge input or an enable line, also of unused phases and of the brake.
    pub power_pins: &'static [Pin],
    /// True if enabled axes brake while the timer outputs are idle, false if they float.
    pub brakes_when_idle: bool,
    /// Pin that a power stage pulls low to report a fault.
    pub fault: Pin,
    /// True if `fault` is TIM1's break input.
    pub fault_is_break_input: bool,
    /// Converter channel and divider of the bus voltage.
    pub bus: (u8, f64),
    /// Pins that the board holds high with any wiring, in addition to the pin of the bus divider.
    pub pins_held_high: &'static [Pin],
    /// Supply voltage of the chip, which is the reference of the converters, mV.
    pub supply_mv: u32,
    /// Chip-select pins of the gate drivers on SPI3.
    pub driver_selects: &'static [Pin],
    /// Chip-select pins of absolute encoders on SPI3, one for each axis.
    pub encoder_selects: &'static [Pin],
    /// Nominal bus voltage, V.
    pub bus_voltage: f64,
    /// Zero offset of each current sensor, V. Shunt amplifiers have a few millivolts. Hall sensors are trimmed to zero.
    pub sensor_offsets: [f64; 4],
    /// Dead time with both switches of a half bridge off, s. It reduces the motor voltage. 0 for half-bridge modules.
    pub dead_time: f64,
}

/// Resistance of the shunts under phases B and C, ohm.
const SHUNT_OHMS: f64 = 500e-6;
/// Scale of a 185 mV/A Hall sensor behind a divider from 5 V to 3.3 V, V/A.
const HALL_VOLTS_PER_AMPERE: f64 = 0.185 * 0.66;
/// Scale of a 185 mV/A Hall sensor behind a divider from 5 V to 3.0 V, V/A.
const HALL_3V_VOLTS_PER_AMPERE: f64 = 0.185 * 0.6;

static ODRIVE_V3: Wiring = Wiring {
    name: BoardKind::OdriveV3.name(),
    encoders: &[
        EncoderWires { timer: 3, pins: [Pin('B', 4), Pin('B', 5)], function: 2, index: Some(Pin('C', 9)) },
        EncoderWires { timer: 4, pins: [Pin('B', 6), Pin('B', 7)], function: 2, index: Some(Pin('C', 15)) },
        EncoderWires { timer: 2, pins: [Pin('A', 15), Pin('B', 3)], function: 1, index: None },
    ],
    motors: &[
        MotorWires {
            timer: 1,
            ends: [HalfBridge::Channel(2), HalfBridge::Channel(3)],
            gates: [Pin('A', 9), Pin('A', 10), Pin('B', 14), Pin('B', 15)],
            third: Some((1, [Pin('A', 8), Pin('B', 13)])),
            function: 1,
            sensors: &[(10, SHUNT_OHMS), (11, -SHUNT_OHMS)],
        },
        MotorWires {
            timer: 8,
            ends: [HalfBridge::Channel(2), HalfBridge::Channel(3)],
            gates: [Pin('C', 7), Pin('C', 8), Pin('B', 0), Pin('B', 1)],
            third: Some((1, [Pin('C', 6), Pin('A', 7)])),
            function: 3,
            sensors: &[(13, SHUNT_OHMS), (12, -SHUNT_OHMS)],
        },
    ],
    enable: Pin('B', 12),
    power_pins: &[
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
    brakes_when_idle: false,
    fault: Pin('D', 2),
    fault_is_break_input: false,
    bus: (6, 19.0),
    pins_held_high: &[Pin('C', 5)],
    supply_mv: 3300,
    driver_selects: &[Pin('C', 13), Pin('C', 14)],
    encoder_selects: &[Pin('A', 2), Pin('A', 3)],
    bus_voltage: 24.0,
    sensor_offsets: [0.008, -0.005, 0.003, -0.011],
    dead_time: 20.0 / 168e6,
};

static H_BRIDGE_F405: Wiring = Wiring {
    name: BoardKind::HBridgeF405.name(),
    encoders: &[
        EncoderWires { timer: 2, pins: [Pin('A', 15), Pin('B', 3)], function: 1, index: Some(Pin('C', 7)) },
        EncoderWires { timer: 3, pins: [Pin('B', 4), Pin('B', 5)], function: 2, index: Some(Pin('C', 8)) },
        EncoderWires { timer: 4, pins: [Pin('B', 6), Pin('B', 7)], function: 2, index: Some(Pin('C', 9)) },
    ],
    motors: &[
        h_bridge(1, [Pin('A', 8), Pin('B', 13)], &[(10, HALL_VOLTS_PER_AMPERE)]),
        h_bridge(2, [Pin('A', 9), Pin('B', 14)], &[(11, HALL_VOLTS_PER_AMPERE)]),
        h_bridge(3, [Pin('A', 10), Pin('B', 15)], &[(12, HALL_VOLTS_PER_AMPERE)]),
    ],
    enable: Pin('C', 6),
    power_pins: &[Pin('A', 8), Pin('A', 9), Pin('A', 10), Pin('B', 13), Pin('B', 14), Pin('B', 15), Pin('C', 6)],
    brakes_when_idle: true,
    fault: Pin('B', 12),
    fault_is_break_input: true,
    bus: (13, 11.0),
    pins_held_high: &[],
    supply_mv: 3300,
    driver_selects: &[],
    encoder_selects: &[Pin('A', 2), Pin('A', 3), Pin('B', 0)],
    bus_voltage: 24.0,
    sensor_offsets: [0.0; 4],
    dead_time: 0.0,
};

static H_BRIDGE_F407_DISC1: Wiring = Wiring {
    name: BoardKind::HBridgeF407Disc1.name(),
    encoders: &[
        EncoderWires { timer: 2, pins: [Pin('A', 15), Pin('B', 3)], function: 1, index: Some(Pin('C', 6)) },
        EncoderWires { timer: 3, pins: [Pin('B', 4), Pin('B', 5)], function: 2, index: Some(Pin('C', 8)) },
        EncoderWires { timer: 4, pins: [Pin('B', 6), Pin('B', 7)], function: 2, index: Some(Pin('C', 9)) },
    ],
    motors: &[
        h_bridge(1, [Pin('E', 9), Pin('E', 8)], &[(11, HALL_3V_VOLTS_PER_AMPERE)]),
        h_bridge(2, [Pin('E', 11), Pin('E', 10)], &[(12, HALL_3V_VOLTS_PER_AMPERE)]),
        h_bridge(3, [Pin('E', 13), Pin('E', 12)], &[(1, HALL_3V_VOLTS_PER_AMPERE)]),
    ],
    enable: Pin('E', 14),
    // PA9 is not a gate. It carries the 5 V of the USB cable.
    power_pins: &[
        Pin('A', 9),
        Pin('E', 8),
        Pin('E', 9),
        Pin('E', 10),
        Pin('E', 11),
        Pin('E', 12),
        Pin('E', 13),
        Pin('E', 14),
    ],
    brakes_when_idle: true,
    fault: Pin('E', 15),
    fault_is_break_input: true,
    bus: (14, 12.0),
    pins_held_high: &[Pin('B', 9)],
    supply_mv: 3000,
    driver_selects: &[],
    encoder_selects: &[Pin('A', 2), Pin('A', 3), Pin('B', 0)],
    bus_voltage: 24.0,
    sensor_offsets: [0.0; 4],
    dead_time: 0.0,
};

const fn h_bridge(channel: u8, [p, n]: [Pin; 2], sensors: &'static [(u8, f64)]) -> MotorWires {
    let ends = [HalfBridge::Channel(channel), HalfBridge::Complement(channel)];
    MotorWires { timer: 1, ends, gates: [p, n, p, n], third: None, function: 1, sensors }
}

impl Wiring {
    /// Returns the output of a current sensor at zero current, which is half of the chip's supply, V.
    #[must_use]
    pub fn zero_current_volts(&self) -> f64 {
        0.5e-3 * f64::from(self.supply_mv)
    }

    /// Returns the pin of the bus divider.
    #[must_use]
    pub fn bus_pin(&self) -> Pin {
        Pin::of_channel(self.bus.0)
    }

    /// Returns the wiring of a board.
    #[must_use]
    pub fn of_board(kind: BoardKind) -> &'static Self {
        match kind {
            BoardKind::OdriveV3 => &ODRIVE_V3,
            BoardKind::HBridgeF405 => &H_BRIDGE_F405,
            BoardKind::HBridgeF407Disc1 => &H_BRIDGE_F407_DISC1,
        }
    }
}

impl From<BoardKind> for &'static Wiring {
    fn from(kind: BoardKind) -> Self {
        Wiring::of_board(kind)
    }
}
