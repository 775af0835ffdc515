//! Any STM32F405 module with up to three H-bridges. docs/wiring-h-bridge-f405.md lists the pins.

use embassy_stm32::Peripherals;
use embassy_stm32::pac::gpio::Gpio;
use embassy_stm32::pac::{GPIOA, GPIOB, GPIOC};

use super::h_bridges::{Pins, Wires};
use super::{Common, IdentityPins, Pin};
use crate::adc;
use crate::board::MONITOR_2V9;

pub struct HBridgeF405;

impl Wires for HBridgeF405 {
    const NAME: &'static str = "h-bridge-f405";
    /// The bus divider holds PC3 with 0.9 kohm, with the supply on or off. PA6 and PB9 are open, but an ODrive has its
    /// bus divider at PA6, and a Discovery board pulls PB9 up.
    const IDENTITY: IdentityPins =
        IdentityPins { held_pins: &[Pin::new('C', 3)], open_pins: &[Pin::new('A', 6), Pin::new('B', 9)] };
    const SUPPLY_LEVEL: u8 = MONITOR_2V9;
    const ENABLE_PIN: (Gpio, usize) = (GPIOC, 6);
    const BREAK_PIN: (Gpio, usize) = (GPIOB, 12);
    const INDEX_LINES: [u32; 3] = [1 << 7, 1 << 8, 1 << 9];
    const CHANNELS: [[u8; 2]; 2] = [[10, 12], [11, 13]];
    /// Bus divider: 10 kohm over 1 kohm.
    const BUS_FULL_SCALE: f32 = adc::REFERENCE_V * 11.0;
    const LOCKED_PINS: &'static [(Gpio, u16)] = &[(GPIOA, 0b111 << 8), (GPIOB, 0b1111 << 12), (GPIOC, 1 << 6)];

    fn divide(p: Peripherals) -> (Pins, Common) {
        let pins = Pins {
            enable: p.PC6.into(),
            break_input: p.PB12.into(),
            gates: [p.PA8.into(), p.PA9.into(), p.PA10.into(), p.PB13.into(), p.PB14.into(), p.PB15.into()],
            sensors: [p.PC0.into(), p.PC1.into(), p.PC2.into(), p.PC3.into()],
            encoders: [[p.PA15.into(), p.PB3.into()], [p.PB4.into(), p.PB5.into()], [p.PB6.into(), p.PB7.into()]],
            bus: [p.PC10.into(), p.PC11.into(), p.PC12.into()],
            selects: [p.PA2.into(), p.PA3.into(), p.PB0.into()],
        };
        (pins, Common { usb: (p.USB_OTG_FS, p.PA12, p.PA11), flash: p.FLASH, watchdog: p.IWDG })
    }
}
