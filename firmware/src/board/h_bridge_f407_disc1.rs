//! ST's Discovery board STM32F407G-DISC1 with up to three H-bridges. Pins: docs/wiring-h-bridge-f407-disc1.md.
//!
//! The chip is the STM32F405's die in a larger package. It runs at 3.0 V, from a 3.3 V regulator behind a diode: the
//! converters' reference is that, and so is what the supply monitor sees. PA9 has the USB cable's 5 V here, and nothing
//! may drive it.

use embassy_stm32::Peripherals;
use embassy_stm32::pac::gpio::Gpio;
use embassy_stm32::pac::{GPIOA, GPIOE};

use super::h_bridges::{Pins, Wires};
use super::{Common, Pin, Signs};

/// The converters' reference, V.
const REFERENCE_V: f32 = 3.0;

/// Level of the supply monitor: 2.66 V as the supply falls, 2.82 V at most as it rises (STM32F407 datasheet, table 19).
/// The next one may wait for 2.99 V, which the board need not have. The flash is fast enough down to 2.7 V.
const MONITOR_2V7: u8 = 4;

/// Its wires.
pub struct HBridgeF407Disc1;

impl Wires for HBridgeF407Disc1 {
    const NAME: &'static str = "h-bridge-f407-disc1";
    /// The bus divider holds PC4, with the supply on or off, and the board pulls PB9 up for its audio chip. Neither leads
    /// anywhere on an STM32F405 module; on an ODrive PC4 is a free connector pin.
    const SIGNS: Signs = Signs { held: &[Pin::new('C', 4), Pin::new('B', 9)], open: &[] };
    const SUPPLY_LEVEL: u8 = MONITOR_2V7;
    const ENABLE: (Gpio, usize) = (GPIOE, 14);
    const BREAK: (Gpio, usize) = (GPIOE, 15);
    const INDEX_LINES: [u32; 3] = [1 << 6, 1 << 8, 1 << 9];
    const CHANNELS: [[u8; 2]; 2] = [[11, 1], [12, 14]];
    /// Divider: 11 kohm over 1 kohm.
    const BUS_FULL_SCALE: f32 = REFERENCE_V * 12.0;
    /// PA9 too, which has the cable's 5 V and must stay an input.
    const LOCKED: &'static [(Gpio, u16)] = &[(GPIOA, 1 << 9), (GPIOE, 0xFF00)];

    fn divide(p: Peripherals) -> (Pins, Common) {
        let pins = Pins {
            enable: p.PE14.into(),
            break_input: p.PE15.into(),
            gates: [p.PE9.into(), p.PE11.into(), p.PE13.into(), p.PE8.into(), p.PE10.into(), p.PE12.into()],
            sensors: [p.PC1.into(), p.PC2.into(), p.PA1.into(), p.PC4.into()],
            encoders: [[p.PA15.into(), p.PB3.into()], [p.PB4.into(), p.PB5.into()], [p.PB6.into(), p.PB7.into()]],
        };
        (pins, Common { usb: (p.USB_OTG_FS, p.PA12, p.PA11), flash: p.FLASH, watchdog: p.IWDG })
    }
}
