//! Boards with up to three H-bridges, each driven in locked anti-phase: CHx of TIM1 switches one half of a bridge, CHxN
//! the other half. The wiring of each board is in its own file ([`Wires`]).
//!
//! A low enable line turns the bridges off. Two low inputs do not, because they brake on many bridges. A low level on
//! the break input cuts the outputs in hardware.

use core::marker::PhantomData;

use embassy_stm32::gpio::{AfType, AnyPin, Flex, Level, Output, Pull, Speed};
use embassy_stm32::pac;
use embassy_stm32::pac::gpio::Gpio;
use embassy_stm32::pac::timer::TimGp16;
use embassy_stm32::{Peri, Peripherals, peripherals, rcc};
use haptic_bridge::control::compiled::Legs;
use haptic_bridge::control::frame::Samples;
use haptic_bridge::control::joints::{Counts, Currents};
use haptic_bridge::drive::carrier::{CARRIER_MIN_HZ, Carrier};
use haptic_bridge::drive::stage::Bridge;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::safety::fault::Fault;
use haptic_bridge::safety::limits::{Limits, MAX_TIP_FORCE};

use super::{Board, Common, IdentityPins, Io};
use crate::adc;
use crate::angle_sensors::{self, AngleSensors, Select};
use crate::encoder;
use crate::gate::{Gate, GateError};
use crate::index;
use crate::pwm;
use crate::zeros::{Zeroing, Zeros, learn_or_check_zeros};

const AXES: usize = 3;
/// Time in which both inputs of a bridge are low at each edge: 17 ticks of 1/168 MHz, 101 ns. It is equal at both
/// edges, so it reduces the voltage a little without distortion.
const DEAD_TIME_TICKS: u8 = 17;
/// Amperes per volt at a current input: a 185 mV/A Hall sensor behind a divider from 5 V to 3.3 V. If a board's
/// converter has another reference, its divider ends at that reference, so that a count is the same current.
const AMPERES_PER_VOLT: f32 = 1.0 / (0.185 * 0.66);
const AMPERES_PER_COUNT: f32 = adc::REFERENCE_V / adc::FULL_SCALE * AMPERES_PER_VOLT;
/// Largest distance of a zero from the middle of the converter's range, counts: 40 mV of the sensor's own offset and 5
/// % of the halved supply, behind the divider. A larger distance means at least 0.9 A through a bridge that is off.
const MAX_ZERO_DISTANCE: u16 = 136;

/// Chip selects of absolute encoders.
const ENCODER_SELECTS: [Select; AXES] = [(pac::GPIOA, 2), (pac::GPIOA, 3), (pac::GPIOB, 0)];

/// The wiring of a board with H-bridges. All boards use the encoder pins PA15 and PB3, PB4 and PB5, PB6 and PB7.
pub trait Wires {
    const NAME: &'static str;
    const IDENTITY: IdentityPins;
    const SUPPLY_LEVEL: u8;
    const ENABLE_PIN: (Gpio, usize);
    const BREAK_PIN: (Gpio, usize);
    /// Masks of the index inputs in port C.
    const INDEX_LINES: [u32; AXES];
    /// Channels of the two converters: currents 0 and 2 on the first; current 1 and the bus voltage on the second.
    const CHANNELS: [[u8; 2]; 2];
    /// Bus voltage at the converters' full scale, V.
    const BUS_FULL_SCALE: f32;
    /// Outputs, enable line and break input of each port, to be locked after their configuration.
    const LOCKED_PINS: &'static [(Gpio, u16)];
    /// Sorts the chip's pins without configuring any.
    fn divide(p: Peripherals) -> (Pins, Common);
}

type AnyPeri = Peri<'static, AnyPin>;

pub struct Pins {
    pub enable: AnyPeri,
    pub break_input: AnyPeri,
    /// TIM1's channels and their complements.
    pub gates: [AnyPeri; 2 * AXES],
    /// Currents and bus voltage.
    pub sensors: [AnyPeri; AXES + 1],
    /// Channels A and B of each encoder.
    pub encoders: [[AnyPeri; 2]; AXES],
    /// Clock, input and output of the bus of absolute encoders, and their chip selects.
    pub bus: [AnyPeri; 3],
    pub selects: [AnyPeri; AXES],
}

/// A board with these wires.
pub struct HBridges<W>(PhantomData<W>);

impl<W: Wires> Board for HBridges<W> {
    const NAME: &'static str = W::NAME;
    const IDENTITY: IdentityPins = W::IDENTITY;
    const SUPPLY_LEVEL: u8 = W::SUPPLY_LEVEL;
    const AXES: usize = AXES;
    /// Data of the bridges. The dead time causes no distortion (see [`DEAD_TIME_TICKS`]), so it is not compensated.
    const BRIDGE: Bridge = Bridge {
        carrier_hz: CARRIER_MIN_HZ as f32,
        dead_time: 0.0,
        bandwidth_hz: 1000.0,
        current_sensed: true,
        legs: 2,
    };
    /// Limits that cannot be raised over USB: the ranges of the current sensors and of the bus divider.
    const LIMITS: Limits = Limits {
        torque: [10.0; 3],
        current: [12.0; 3],
        continuous_current: [6.0; 3],
        speed: [100.0; 3],
        power: 40.0,
        bus_min: 6.0,
        bus_max: 34.0,
        tip_force: MAX_TIP_FORCE,
    };
    const POWER_FAULT: Fault = Fault::BreakInput;
    const UNSENSED: &'static [Fault] = &[Fault::EncoderIllegal, Fault::GateDriver];
    type Io = BridgeIo<W>;
    type Gate = EnableLine;

    #[inline]
    fn turn_bridges_off() {
        let (port, bit) = W::ENABLE_PIN;
        port.bsrr().write(|w| w.set_br(bit, true));
        pwm::drive(pac::TIM1, false);
    }

    fn split(p: Peripherals, carrier: Carrier, board: bool) -> (BridgeIo<W>, Option<EnableLine>, Common) {
        rcc::enable_and_reset::<peripherals::TIM1>();
        rcc::enable_and_reset::<peripherals::TIM2>();
        rcc::enable_and_reset::<peripherals::TIM3>();
        rcc::enable_and_reset::<peripherals::TIM4>();
        rcc::enable_and_reset::<peripherals::ADC1>();
        rcc::enable_and_reset::<peripherals::ADC2>();

        let config = pwm::PwmConfig { channels: [true; 3], dead_time: DEAD_TIME_TICKS, break_input: true };
        pwm::configure(pac::TIM1, &config, carrier);
        adc::configure(pac::ADC1, &W::CHANNELS[0]);
        adc::configure(pac::ADC2, &W::CHANNELS[1]);
        let (pins, common) = W::divide(p);
        if board {
            core::mem::forget(Output::new(pins.enable, Level::Low, Speed::Low));
            // Pulled up, so that a board without a break line can drive.
            let mut break_input = Flex::new(pins.break_input);
            break_input.set_as_af_unchecked(1, AfType::input(Pull::Up));
            core::mem::forget(break_input);
            pwm::outputs(pins.gates.map(Flex::new), 1);
            adc::inputs(pins.sensors.map(Flex::new));
            index::latch(W::INDEX_LINES[0] | W::INDEX_LINES[1] | W::INDEX_LINES[2]);
            pins.selects.into_iter().for_each(angle_sensors::idle_select);
            let [clock, input, output] = pins.bus;
            angle_sensors::start_bus(clock, input, output);
            let [first, second, third] = pins.encoders.map(|channels| channels.map(Flex::new));
            start_encoder(encoder::TIM2, first, 1);
            start_encoder(pac::TIM3, second, 2);
            start_encoder(pac::TIM4, third, 2);
        }
        for &(port, pins) in W::LOCKED_PINS {
            pwm::lock(port, pins);
        }

        let angle_sensors = AngleSensors::new(&ENCODER_SELECTS, [encoder::TIM2, pac::TIM3, pac::TIM4]);
        let io = BridgeIo { zeros: Zeros::new(), offsets: [0.0; AXES], carrier, angle_sensors, wires: PhantomData };
        (io, board.then_some(EnableLine), common)
    }
}

fn start_encoder(timer: TimGp16, [a, b]: [Flex<'static>; 2], alternate_function: u8) {
    encoder::start(timer, a, b, alternate_function);
}

/// The part that the control interrupt owns.
pub struct BridgeIo<W> {
    zeros: Zeros<AXES>,
    /// Zero error of each sensor's reading, A.
    offsets: [f32; AXES],
    carrier: Carrier,
    angle_sensors: AngleSensors,
    wires: PhantomData<W>,
}

impl<W> BridgeIo<W> {
    /// Returns the readings of all current sensors.
    #[inline(always)]
    fn raw_readings() -> [i32; AXES] {
        [adc::result(pac::ADC1, 0), adc::result(pac::ADC2, 0), adc::result(pac::ADC1, 1)]
    }
}

impl<W: Wires> Io for BridgeIo<W> {
    #[inline(always)]
    fn update_counts(&mut self, counts: &mut Counts) {
        encoder::update_count(encoder::TIM2, &mut counts[0]);
        encoder::update_count(pac::TIM3, &mut counts[1]);
        encoder::update_count(pac::TIM4, &mut counts[2]);
    }

    #[inline(always)]
    fn has_marks(&self) -> bool {
        index::pending_lines() != 0
    }

    fn marks(&mut self, counts: &Counts) -> [Option<i32>; MAX_JOINTS] {
        index::take_pulses(&W::INDEX_LINES, counts)
    }

    #[inline(always)]
    fn clear_flags(&mut self) {
        adc::clear_flags(pac::ADC1);
        adc::clear_flags(pac::ADC2);
    }

    #[inline(always)]
    fn has_sampled(&self) -> bool {
        adc::have_finished(pac::ADC1, pac::ADC2)
    }

    fn await_samples(&self) -> bool {
        adc::wait(pac::ADC1, pac::ADC2)
    }

    #[inline(always)]
    fn sample(&mut self, samples: &mut Samples) {
        let raw = Self::raw_readings();
        let current = |axis: usize| self.offsets[axis] + AMPERES_PER_COUNT * raw[axis] as f32;
        samples.currents = Currents([current(0), current(1), current(2)]);
        let bus = adc::result(pac::ADC2, 1) as f32;
        samples.bus_voltage = W::BUS_FULL_SCALE / adc::FULL_SCALE * bus;
    }

    fn learn_zeros(&mut self) {
        self.zeros.update(Self::raw_readings());
        self.offsets = self.zeros.get().map(|zero| -AMPERES_PER_COUNT * zero);
    }

    /// Writes the compare value of each axis's first leg. The second leg is its complement.
    #[inline(always)]
    fn write(&mut self, legs: &Legs) {
        pac::TIM1.ccr(0).write(|w| w.set_ccr(legs[0].pair[0]));
        pac::TIM1.ccr(1).write(|w| w.set_ccr(legs[1].pair[0]));
        pac::TIM1.ccr(2).write(|w| w.set_ccr(legs[2].pair[0]));
    }

    fn angle_sensors(&mut self) -> Option<&mut AngleSensors> {
        Some(&mut self.angle_sensors)
    }

    #[inline]
    fn drive(&mut self, on: bool) {
        if on {
            pwm::drive(pac::TIM1, true);
            let (port, bit) = W::ENABLE_PIN;
            port.bsrr().write(|w| w.set_bs(bit, true));
        } else {
            HBridges::<W>::turn_bridges_off();
        }
    }

    /// Returns true if the break input is low or has cut the outputs.
    #[inline(always)]
    fn has_fault(&self) -> bool {
        let (port, bit) = W::BREAK_PIN;
        let low = port.idr().read().idr(bit) == pac::gpio::vals::Idr::LOW;
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

/// The part that the tasks own. The bridges have no registers to configure.
pub struct EnableLine;

impl Gate for EnableLine {
    /// Learns the current sensors' zeros in 12 ms. The control interrupt raises the enable line.
    fn raise(&mut self) -> Result<(), GateError> {
        let zero = learn_or_check_zeros(Zeroing::Learn);
        if zero > MAX_ZERO_DISTANCE { Err(GateError::Offset(f32::from(zero) * AMPERES_PER_COUNT)) } else { Ok(()) }
    }

    /// Always succeeds, because the bridges have no registers.
    fn check(&mut self) -> Result<(), GateError> {
        Ok(())
    }
}
