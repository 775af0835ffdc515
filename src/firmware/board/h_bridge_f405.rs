//! Any STM32F405 module with up to three H-bridges, each driven in locked anti-phase: CHx switches one half of a bridge, CHxN the other.
//!
//! Off is the enable line (PC6 low), not the inputs: both inputs low brakes on many bridges. A low level on PB12 cuts the outputs in
//! hardware, whatever the program does. Pins: docs/wiring-h-bridge-f405.md.

use embassy_stm32::gpio::{AfType, Flex, Level, Output, Pull, Speed};
use embassy_stm32::pac;
use embassy_stm32::pac::timer::TimGp16;
use embassy_stm32::{Peripherals, peripherals, rcc};

use super::{Analog, Common, GateError};
use crate::adc;
use crate::encoder::Encoder;
use crate::pwm::{self, Carrier};

/// Name of the board, as the host shows it.
pub const NAME: &str = "h-bridge-f405";

/// Motors that it can drive.
pub const AXES: usize = 3;

/// Time in which both inputs of a bridge are low at each edge: 17 ticks of 1/168 MHz, 101 ns. It is the same at both edges, so
/// it costs a little voltage and distorts nothing.
pub const DEAD_TIME_TICKS: u8 = 17;

/// Amperes per volt at a current input, and the voltage of no current: a 185 mV/A Hall sensor behind a 5 V to 3.3 V divider.
const AMPERES_PER_VOLT: f32 = 1.0 / (0.185 * 0.66);

/// Bus divider: 10 kohm over 1 kohm.
pub const BUS_DIVIDER: f32 = 11.0;

/// Weight of one reading in the sensors' offset, learned while the bridges are off.
const OFFSET_WEIGHT: f32 = 1.0 / 256.0;

/// Bit of the bridges' enable line in port C.
const ENABLE: usize = 6;

/// Bridges off: outputs low, enable line low. Plain register writes: works in any state of the program.
#[inline]
pub fn off() {
    pac::GPIOC.bsrr().write(|w| w.set_br(ENABLE, true));
    pwm::drive(pac::TIM1, false);
}

/// What the control interrupt owns.
pub struct Io {
    encoders: [Encoder; AXES],
    offsets: [f32; AXES],
    carrier: Carrier,
}

impl Io {
    /// Encoder counts since power-on, one per axis.
    #[inline]
    pub fn counts(&mut self) -> [i32; AXES] {
        [self.encoders[0].read(), self.encoders[1].read(), self.encoders[2].read()]
    }

    /// The readings that the crest started; `learn` says that no current flows.
    #[inline]
    pub fn analog(&mut self, learn: bool) -> Analog {
        let fresh = adc::wait(pac::ADC1) & adc::wait(pac::ADC2);
        let raw = [adc::result(pac::ADC1, 0), adc::result(pac::ADC2, 0), adc::result(pac::ADC1, 1)];
        let mut current_a = [0.0; AXES];
        for axis in 0..AXES {
            let counts = f32::from(raw[axis]);
            let offset = &mut self.offsets[axis];
            if learn && fresh {
                *offset += (counts - *offset) * OFFSET_WEIGHT;
            }
            current_a[axis] = (counts - *offset) * (adc::REFERENCE_V / adc::FULL_SCALE * AMPERES_PER_VOLT);
        }
        let bus_v = f32::from(adc::result(pac::ADC2, 1)) * (adc::REFERENCE_V / adc::FULL_SCALE * BUS_DIVIDER);
        Analog { bus_v, current_a, fresh }
    }

    /// Duties in -1..1, applied at the next valley. NaN is no voltage.
    #[inline]
    pub fn write(&mut self, duty: [f32; AXES]) {
        for (channel, duty) in duty.into_iter().enumerate() {
            pac::TIM1.ccr(channel).write(|w| w.set_ccr(pwm::compare(0.5 + 0.5 * duty, self.carrier.top)));
        }
    }

    /// Connects the bridges to the carrier, or lets them float. Off also drops the enable line.
    #[inline]
    pub fn drive(&mut self, on: bool) {
        if on {
            pwm::drive(pac::TIM1, true);
            pac::GPIOC.bsrr().write(|w| w.set_bs(ENABLE, true));
        } else {
            off();
        }
    }

    /// The break input has cut the outputs, or still would.
    #[inline]
    pub fn driver_fault(&self) -> bool {
        pac::GPIOB.idr().read().idr(12) == pac::gpio::vals::Idr::LOW
    }

    /// The carrier in use.
    pub fn carrier(&self) -> Carrier {
        self.carrier
    }

    /// Changes the carrier; all axes take it at the same extreme.
    pub fn set_carrier(&mut self, carrier: Carrier) {
        pwm::set_carrier(pac::TIM1, carrier);
        self.carrier = carrier;
    }

    /// Starts the carrier.
    pub fn start(&mut self) {
        pwm::start(None);
    }
}

/// What tasks own: nothing to set up on this board, its bridges have no registers.
pub struct Gate;

impl Gate {
    /// The bridges are ready as soon as the enable line rises, which the control interrupt does.
    pub async fn raise(&mut self) -> Result<(), GateError> {
        Ok(())
    }
}

/// Divides the chip. `carrier` is what the board starts with; nothing runs and nothing is driven yet.
pub fn split(p: Peripherals, carrier: Carrier) -> (Io, Gate, Common) {
    core::mem::forget(Output::new(p.PC6, Level::Low, Speed::Low));

    rcc::enable_and_reset::<peripherals::TIM1>();
    rcc::enable_and_reset::<peripherals::TIM2>();
    rcc::enable_and_reset::<peripherals::TIM3>();
    rcc::enable_and_reset::<peripherals::TIM4>();
    rcc::enable_and_reset::<peripherals::ADC1>();
    rcc::enable_and_reset::<peripherals::ADC2>();

    // Pulled up: a board without a break line is not held off by it.
    let mut break_input = Flex::new(p.PB12);
    break_input.set_as_af_unchecked(1, AfType::input(Pull::Up));
    core::mem::forget(break_input);
    let setup = pwm::Setup { channels: [true; 3], dead_time: DEAD_TIME_TICKS, break_input: true };
    pwm::configure(pac::TIM1, &setup, carrier);
    let [a, b, c] = [Flex::new(p.PA8), Flex::new(p.PA9), Flex::new(p.PA10)];
    pwm::outputs([a, b, c, Flex::new(p.PB13), Flex::new(p.PB14), Flex::new(p.PB15)], 1);

    adc::inputs([Flex::new(p.PC0), Flex::new(p.PC1), Flex::new(p.PC2), Flex::new(p.PC3)]);
    adc::configure(pac::ADC1, &[10, 12]);
    adc::configure(pac::ADC2, &[11, 13]);

    // SAFETY: TIM2 is 32 bits wide and has the registers of a 16-bit timer at the same places; `Encoder` lets it count to 65 535.
    let tim2 = unsafe { TimGp16::from_ptr(pac::TIM2.as_ptr()) };
    let io = Io {
        encoders: [
            Encoder::new(tim2, Flex::new(p.PA15), Flex::new(p.PB3), 1),
            Encoder::new(pac::TIM3, Flex::new(p.PB4), Flex::new(p.PB5), 2),
            Encoder::new(pac::TIM4, Flex::new(p.PB6), Flex::new(p.PB7), 2),
        ],
        offsets: [adc::FULL_SCALE / 2.0; AXES],
        carrier,
    };
    (io, Gate, Common { usb: (p.USB_OTG_FS, p.PA12, p.PA11), flash: p.FLASH, watchdog: p.IWDG })
}
