//! ST's Discovery board STM32F407G-DISC1 with up to three H-bridges. docs/wiring-h-bridge-f407-disc1.md lists the pins.
//!
//! The chip is the STM32F405's die in a larger package. A 3.3 V regulator behind a diode supplies it with 3.0 V, which
//! is also the converters' reference. PA9 carries the USB cable's 5 V on this board and must not be driven.

use embassy_stm32::Peripherals;
use embassy_stm32::pac::gpio::Gpio;
use embassy_stm32::pac::{GPIOA, GPIOE};

use super::h_bridges::{Pins, Wires};
use super::{Common, IdentityPins, Pin};

const REFERENCE_V: f32 = 3.0;
/// Level of the supply monitor: 2.66 V for a falling, at most 2.82 V for a rising supply (STM32F407 datasheet, table
/// 19). The next level may need 2.99 V, which the board may not reach. The flash is fast enough down to 2.7 V.
const MONITOR_2V7: u8 = 4;

pub struct HBridgeF407Disc1;

impl Wires for HBridgeF407Disc1 {
    const NAME: &'static str = "h-bridge-f407-disc1";
    /// The bus divider holds PC4, with the supply on or off, and the board pulls PB9 up for its audio chip. Both pins
    /// are open on an STM32F405 module, and PC4 is a free connector pin on an ODrive.
    const IDENTITY: IdentityPins = IdentityPins { held_pins: &[Pin::new('C', 4), Pin::new('B', 9)], open_pins: &[] };
    const SUPPLY_LEVEL: u8 = MONITOR_2V7;
    const ENABLE_PIN: (Gpio, usize) = (GPIOE, 14);
    const BREAK_PIN: (Gpio, usize) = (GPIOE, 15);
    const INDEX_LINES: [u32; 3] = [1 << 6, 1 << 8, 1 << 9];
    const CHANNELS: [[u8; 2]; 2] = [[11, 1], [12, 14]];
    /// Bus divider: 11 kohm over 1 kohm.
    const BUS_FULL_SCALE: f32 = REFERENCE_V * 12.0;
    /// Outputs and inputs to lock. PA9 carries the cable's 5 V and must stay an input.
    const LOCKED_PINS: &'static [(Gpio, u16)] = &[(GPIOA, 1 << 9), (GPIOE, 0xFF00)];

    fn divide(p: Peripherals) -> (Pins, Common) {
        let pins = Pins {
            enable: p.PE14.into(),
            break_input: p.PE15.into(),
            gates: [p.PE9.into(), p.PE11.into(), p.PE13.into(), p.PE8.into(), p.PE10.into(), p.PE12.into()],
            sensors: [p.PC1.into(), p.PC2.into(), p.PA1.into(), p.PC4.into()],
            encoders: [[p.PA15.into(), p.PB3.into()], [p.PB4.into(), p.PB5.into()], [p.PB6.into(), p.PB7.into()]],
            bus: [p.PC10.into(), p.PC11.into(), p.PC12.into()],
            selects: [p.PA2.into(), p.PA3.into(), p.PB0.into()],
        };
        (pins, Common { usb: (p.USB_OTG_FS, p.PA12, p.PA11), flash: p.FLASH, watchdog: p.IWDG })
    }
}
