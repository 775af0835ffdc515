//! The smallest board: one H-bridge on channel 1 of TIM1, one encoder on TIM4, and one current sensor. The firmware
//! compiles this file with its feature `toy-board`, and `toy.rs` runs the image. The file is an example of an
//! implementation, not a wiring for real motors, because it has no break input.

use embassy_stm32::gpio::{Flex, Level, Output, Speed};
use embassy_stm32::{Peripherals, pac, peripherals, rcc};
use haptic_bridge::control::compiled::Legs;
use haptic_bridge::control::frame::Samples;
use haptic_bridge::control::joints::Counts;
use haptic_bridge::drive::carrier::{CARRIER_MIN_HZ, Carrier};
use haptic_bridge::drive::stage::Bridge;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::safety::fault::Fault;
use haptic_bridge::safety::limits::{Limits, MAX_TIP_FORCE};

use super::{Board, Common, IdentityPins, Io, Pin};
use crate::adc;
use crate::encoder;
use crate::gate::{Gate, GateError};
use crate::index;
use crate::pwm;
use crate::zeros::{Zeroing, Zeros, learn_or_check_zeros};

/// Amperes per count of the converter, from 0.2 V/A.
const AMPERES_PER_COUNT: f32 = adc::REFERENCE_V / adc::FULL_SCALE / 0.2;

/// Volts per count of the converter, from a divider of 11:1.
const VOLTS_PER_COUNT: f32 = adc::REFERENCE_V / adc::FULL_SCALE * 11.0;

/// Largest deviation of the current sensor's zero from the middle of the range, counts.
const ZERO_MAX: u16 = 136;

/// Bit of the index input in port C.
const INDEX_LINES: [u32; 1] = [1 << 9];

/// Bit of the bridge's enable line in port C.
const ENABLE: usize = 6;

pub struct ToyBoard;

impl Board for ToyBoard {
    const NAME: &'static str = "toy-board";
    /// The pin of the bus divider identifies the board.
    const IDENTITY: IdentityPins = IdentityPins { held_pins: &[Pin::new('C', 3)], open_pins: &[] };
    const AXES: usize = 1;
    const BRIDGE: Bridge = Bridge {
        carrier_hz: CARRIER_MIN_HZ as f32,
        dead_time: 0.0,
        bandwidth_hz: 1000.0,
        current_sensed: true,
        legs: 2,
    };
    const LIMITS: Limits = Limits {
        torque: [1.0; 3],
        current: [8.0; 3],
        continuous_current: [4.0; 3],
        speed: [100.0; 3],
        power: 40.0,
        bus_min: 6.0,
        bus_max: 34.0,
        tip_force: MAX_TIP_FORCE,
    };
    const POWER_FAULT: Fault = Fault::GateDriver;
    const UNSENSED: &'static [Fault] = &[Fault::EncoderIllegal, Fault::GateDriver, Fault::BreakInput];
    type Io = Pins;
    type Gate = EnableLine;

    fn turn_bridges_off() {
        pac::GPIOC.bsrr().write(|w| w.set_br(ENABLE, true));
        pwm::drive(pac::TIM1, false);
    }

    fn split(p: Peripherals, carrier: Carrier, board: bool) -> (Pins, Option<EnableLine>, Common) {
        rcc::enable_and_reset::<peripherals::TIM1>();
        rcc::enable_and_reset::<peripherals::TIM4>();
        rcc::enable_and_reset::<peripherals::ADC1>();
        let config = pwm::PwmConfig { channels: [true, false, false], dead_time: 17, break_input: false };
        pwm::configure(pac::TIM1, &config, carrier);
        adc::configure(pac::ADC1, &[10, 13]);
        if board {
            core::mem::forget(Output::new(p.PC6, Level::Low, Speed::Low));
            pwm::outputs([Flex::new(p.PA8), Flex::new(p.PB13)], 1);
            adc::inputs([Flex::new(p.PC0), Flex::new(p.PC3)]);
            index::latch(INDEX_LINES[0]);
            encoder::start(pac::TIM4, Flex::new(p.PB6), Flex::new(p.PB7), 2);
        }
        pwm::lock(pac::GPIOA, 1 << 8);
        pwm::lock(pac::GPIOB, 1 << 13);
        pwm::lock(pac::GPIOC, 1 << ENABLE);
        let common = Common { usb: (p.USB_OTG_FS, p.PA12, p.PA11), flash: p.FLASH, watchdog: p.IWDG };
        (Pins { zeros: Zeros::new(), offset: 0.0, carrier }, board.then_some(EnableLine), common)
    }
}

/// The hardware that the control interrupt owns.
pub struct Pins {
    zeros: Zeros<1>,
    /// Offset of the current sensor's reading, A.
    offset: f32,
    carrier: Carrier,
}

impl Io for Pins {
    fn update_counts(&mut self, counts: &mut Counts) {
        encoder::update_count(pac::TIM4, &mut counts[0]);
    }

    fn has_marks(&self) -> bool {
        index::pending_lines() != 0
    }

    fn marks(&mut self, counts: &Counts) -> [Option<i32>; MAX_JOINTS] {
        index::take_pulses(&INDEX_LINES, counts)
    }

    fn clear_flags(&mut self) {
        adc::clear_flags(pac::ADC1);
    }

    fn has_sampled(&self) -> bool {
        adc::have_finished(pac::ADC1, pac::ADC1)
    }

    fn await_samples(&self) -> bool {
        adc::wait(pac::ADC1, pac::ADC1)
    }

    fn sample(&mut self, samples: &mut Samples) {
        samples.currents[0] = self.offset + AMPERES_PER_COUNT * adc::result(pac::ADC1, 0) as f32;
        samples.bus_voltage = VOLTS_PER_COUNT * adc::result(pac::ADC1, 1) as f32;
    }

    fn learn_zeros(&mut self) {
        self.zeros.update([adc::result(pac::ADC1, 0)]);
        self.offset = -AMPERES_PER_COUNT * self.zeros.get()[0];
    }

    fn write(&mut self, legs: &Legs) {
        pac::TIM1.ccr(0).write(|w| w.set_ccr(legs[0].pair[0]));
    }

    fn drive(&mut self, on: bool) {
        if on {
            pwm::drive(pac::TIM1, true);
            pac::GPIOC.bsrr().write(|w| w.set_bs(ENABLE, true));
        } else {
            ToyBoard::turn_bridges_off();
        }
    }

    fn has_fault(&self) -> bool {
        false
    }

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

/// The hardware that tasks own. Only the current sensor's zero must be measured before arming.
pub struct EnableLine;

impl Gate for EnableLine {
    fn raise(&mut self) -> Result<(), GateError> {
        let zero = learn_or_check_zeros(Zeroing::Learn);
        if zero > ZERO_MAX { Err(GateError::Offset(f32::from(zero) * AMPERES_PER_COUNT)) } else { Ok(()) }
    }

    fn check(&mut self) -> Result<(), GateError> {
        Ok(())
    }
}
