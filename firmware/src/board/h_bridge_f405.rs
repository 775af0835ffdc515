//! Any STM32F405 module with up to three H-bridges, each driven in locked anti-phase: CHx switches one half of a
//! bridge, CHxN the other.
//!
//! Off is the enable line (PC6 low), not the inputs: both inputs low brakes on many bridges. A low level on PB12 cuts
//! the outputs in hardware, whatever the program does. Pins: docs/wiring-h-bridge-f405.md.

use embassy_stm32::gpio::{AfType, Flex, Level, Output, Pull, Speed};
use embassy_stm32::pac;
use embassy_stm32::pac::timer::TimGp16;
use embassy_stm32::{Peripherals, peripherals, rcc};
use haptic_bridge::drive::carrier::{CARRIER_MIN_HZ, Carrier};
use haptic_bridge::drive::stage::Bridge;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::safety::fault::Fault;
use haptic_bridge::safety::limits::{Limits, MOST_TIP_FORCE};
use haptic_bridge::servo::frame::Samples;
use haptic_bridge::servo::joints::{Counts, Currents};

use super::{Board, Common, Io, Pin, Signs};
use crate::adc;
use crate::encoder;
use crate::gate::{Gate, GateError};
use crate::index;
use crate::pwm;
use crate::zeros::{Zeroing, Zeros, settle};

/// Motors that it can drive.
const AXES: usize = 3;

/// Time in which both inputs of a bridge are low at each edge: 17 ticks of 1/168 MHz, 101 ns. It is the same at both
/// edges, so it costs a little voltage and distorts nothing.
const DEAD_TIME_TICKS: u8 = 17;

/// Amperes per volt at a current input, and the voltage of no current: a 185 mV/A Hall sensor behind a 5 V to 3.3 V
/// divider.
const AMPERES_PER_VOLT: f32 = 1.0 / (0.185 * 0.66);

/// Amperes per count of the converter.
const AMPERES_PER_COUNT: f32 = adc::REFERENCE_V / adc::FULL_SCALE * AMPERES_PER_VOLT;

/// Farthest that a zero may be from the middle of the converter's range, counts: 40 mV of the sensor's own and 5 % of a
/// supply that it halves, behind the divider. More is a current: 0.9 A through a bridge that is off.
const ZERO_MAX: u16 = 136;

/// Bus divider: 10 kohm over 1 kohm.
const BUS_DIVIDER: f32 = 11.0;

/// The first encoder's timer.
// SAFETY: it is 32 bits wide and has the registers of a 16-bit timer at the same places; `encoder` lets it count to 65 535.
const TIM2: TimGp16 = unsafe { TimGp16::from_ptr(pac::TIM2.as_ptr()) };

/// Bits of the index inputs in port C.
const INDEX_LINES: [u32; AXES] = [1 << 7, 1 << 8, 1 << 9];

/// Bit of the break input in port B.
const BREAK: usize = 12;

/// Bit of the bridges' enable line in port C.
const ENABLE: usize = 6;

/// This board.
pub struct HBridgeF405;

impl Board for HBridgeF405 {
    const NAME: &'static str = "h-bridge-f405";
    /// The bus divider holds PC3 with 0.9 kohm, with the supply on or off; PA6 is not wired here, and is the bus divider
    /// of an ODrive.
    const SIGNS: Signs = Signs { held: &[Pin::new('C', 3)], open: &[Pin::new('A', 6)] };
    const AXES: usize = AXES;
    /// Data of the bridges. The dead time here costs no voltage (see [`DEAD_TIME_TICKS`]), so the drive compensates
    /// none.
    const BRIDGE: Bridge =
        Bridge { carrier_hz: CARRIER_MIN_HZ as f32, dead_time: 0.0, bandwidth_hz: 1000.0, current_sensed: true };
    /// Limits that cannot be raised over USB: the range of the sensors, and of the bus divider.
    const LIMITS: Limits = Limits {
        torque: [10.0; 3],
        current: [12.0; 3],
        continuous_current: [6.0; 3],
        speed: [100.0; 3],
        power: 40.0,
        bus_min: 6.0,
        bus_max: 34.0,
        tip_force: MOST_TIP_FORCE,
    };
    const POWER_FAULT: Fault = Fault::BreakInput;
    const UNSENSED: &'static [Fault] = &[Fault::EncoderIllegal, Fault::GateDriver];
    type Io = Pins;
    type Gate = EnableLine;

    #[inline]
    fn off() {
        pac::GPIOC.bsrr().write(|w| w.set_br(ENABLE, true));
        pwm::drive(pac::TIM1, false);
    }

    fn split(p: Peripherals, carrier: Carrier, board: bool) -> (Pins, Option<EnableLine>, Common) {
        rcc::enable_and_reset::<peripherals::TIM1>();
        rcc::enable_and_reset::<peripherals::TIM2>();
        rcc::enable_and_reset::<peripherals::TIM3>();
        rcc::enable_and_reset::<peripherals::TIM4>();
        rcc::enable_and_reset::<peripherals::ADC1>();
        rcc::enable_and_reset::<peripherals::ADC2>();

        let config = pwm::PwmConfig { channels: [true; 3], dead_time: DEAD_TIME_TICKS, break_input: true };
        pwm::configure(pac::TIM1, &config, carrier);
        adc::configure(pac::ADC1, &[10, 12]);
        adc::configure(pac::ADC2, &[11, 13]);
        if board {
            core::mem::forget(Output::new(p.PC6, Level::Low, Speed::Low));
            // Pulled up: a board without a break line is not held off by it.
            let mut break_input = Flex::new(p.PB12);
            break_input.set_as_af_unchecked(1, AfType::input(Pull::Up));
            core::mem::forget(break_input);
            let [a, b, c] = [Flex::new(p.PA8), Flex::new(p.PA9), Flex::new(p.PA10)];
            pwm::outputs([a, b, c, Flex::new(p.PB13), Flex::new(p.PB14), Flex::new(p.PB15)], 1);
            adc::inputs([Flex::new(p.PC0), Flex::new(p.PC1), Flex::new(p.PC2), Flex::new(p.PC3)]);
            index::latch(INDEX_LINES[0] | INDEX_LINES[1] | INDEX_LINES[2]);
            encoder::start(TIM2, Flex::new(p.PA15), Flex::new(p.PB3), 1);
            encoder::start(pac::TIM3, Flex::new(p.PB4), Flex::new(p.PB5), 2);
            encoder::start(pac::TIM4, Flex::new(p.PB6), Flex::new(p.PB7), 2);
        }
        pwm::lock(pac::GPIOA, 0b111 << 8);
        pwm::lock(pac::GPIOB, 0b1111 << BREAK);
        pwm::lock(pac::GPIOC, 1 << ENABLE);

        let io = Pins { zeros: Zeros::new(), offsets: [0.0; AXES], carrier };
        (
            io,
            board.then_some(EnableLine),
            Common { usb: (p.USB_OTG_FS, p.PA12, p.PA11), flash: p.FLASH, watchdog: p.IWDG },
        )
    }
}

/// The part that the control interrupt owns.
pub struct Pins {
    zeros: Zeros<AXES>,
    /// Zero error of each sensor's reading, A.
    offsets: [f32; AXES],
    carrier: Carrier,
}

impl Pins {
    /// The readings of all sensors.
    #[inline(always)]
    fn raw() -> [i32; AXES] {
        [adc::result(pac::ADC1, 0), adc::result(pac::ADC2, 0), adc::result(pac::ADC1, 1)]
    }
}

impl Io for Pins {
    #[inline(always)]
    fn follow(&mut self, counts: &mut Counts) {
        encoder::follow(TIM2, &mut counts[0]);
        encoder::follow(pac::TIM3, &mut counts[1]);
        encoder::follow(pac::TIM4, &mut counts[2]);
    }

    #[inline(always)]
    fn marked(&self) -> bool {
        index::seen() != 0
    }

    fn marks(&mut self, counts: &Counts) -> [Option<i32>; MAX_JOINTS] {
        index::take(&INDEX_LINES, counts)
    }

    #[inline(always)]
    fn forget(&mut self) {
        adc::forget(pac::ADC1);
        adc::forget(pac::ADC2);
    }

    #[inline(always)]
    fn sampled(&self) -> bool {
        adc::finished(pac::ADC1, pac::ADC2)
    }

    fn await_samples(&self) -> bool {
        adc::wait(pac::ADC1, pac::ADC2)
    }

    #[inline(always)]
    fn sample(&mut self, seen: &mut Samples) {
        let raw = Self::raw();
        let current = |axis: usize| self.offsets[axis] + AMPERES_PER_COUNT * raw[axis] as f32;
        seen.currents = Currents([current(0), current(1), current(2)]);
        let bus = adc::result(pac::ADC2, 1) as f32;
        seen.bus_voltage = adc::REFERENCE_V / adc::FULL_SCALE * BUS_DIVIDER * bus;
    }

    fn learn(&mut self) {
        self.zeros.take(Self::raw());
        self.offsets = self.zeros.get().map(|zero| -AMPERES_PER_COUNT * zero);
    }

    /// Compare values of each axis's two legs, applied at the next valley: the second leg is the first one's complement
    /// here.
    #[inline(always)]
    fn write(&mut self, legs: &[[u16; 2]; MAX_JOINTS]) {
        pac::TIM1.ccr(0).write(|w| w.set_ccr(legs[0][0]));
        pac::TIM1.ccr(1).write(|w| w.set_ccr(legs[1][0]));
        pac::TIM1.ccr(2).write(|w| w.set_ccr(legs[2][0]));
    }

    #[inline]
    fn drive(&mut self, on: bool) {
        if on {
            pwm::drive(pac::TIM1, true);
            pac::GPIOC.bsrr().write(|w| w.set_bs(ENABLE, true));
        } else {
            HBridgeF405::off();
        }
    }

    /// True if the break input has cut the outputs, or still would.
    #[inline(always)]
    fn fault(&self) -> bool {
        let low = pac::GPIOB.idr().read().idr(BREAK) == pac::gpio::vals::Idr::LOW;
        let cut = !pac::TIM1.bdtr().read().moe();
        low || cut
    }

    #[inline(always)]
    fn carrier(&self) -> &Carrier {
        &self.carrier
    }

    fn set_carrier(&mut self, carrier: Carrier) {
        pwm::set_carrier(pac::TIM1, carrier);
        self.carrier = carrier;
    }

    fn start(&mut self) {
        pwm::start(None);
    }
}

/// The part that the tasks own. It has nothing to set up: this board's bridges have no registers.
pub struct EnableLine;

impl Gate for EnableLine {
    /// Learns the current sensors' zeros, 12 ms. The enable line rises when the control interrupt connects the bridges.
    fn raise(&mut self) -> Result<(), GateError> {
        let zero = settle(Zeroing::Learn);
        if zero > ZERO_MAX { Err(GateError::Offset(f32::from(zero) * AMPERES_PER_COUNT)) } else { Ok(()) }
    }

    /// Nothing to look at: bridges without registers.
    fn check(&mut self) -> Result<(), GateError> {
        Ok(())
    }
}
