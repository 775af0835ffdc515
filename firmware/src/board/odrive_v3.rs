//! ODrive v3.6 and its clones: two axes, each a three-phase bridge behind a DRV8301, with shunts under phases B and C.
//!
//! A brushed motor is connected to phases B and C of its axis. One carrier drives both phases at 0.5 +- duty/2, and
//! phase A stays off. EN_GATE is common to both drivers; a low level resets their registers. Pins:
//! docs/wiring-odrive-v3.md.

use embassy_stm32::gpio::{Flex, Level, Output, Speed};
use embassy_stm32::pac;
use embassy_stm32::pac::timer::TimAdv;
use embassy_stm32::{Peripherals, peripherals, rcc};
use embassy_time::{Duration, block_for};
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
use crate::angle_sensors::{self, AngleSensors, Select};
use crate::clock::TIMER_HZ;
use crate::drv8301::{self, Drv8301, Inputs};
use crate::encoder;
use crate::gate::{Gate, GateError};
use crate::index;
use crate::pwm;
use crate::zeros::{Zeroing, Zeros, learn_or_check_zeros};

const AXES: usize = 2;
/// Dead time between the switches of a half bridge: 20 ticks of 1/168 MHz, 119 ns. The drivers add their own dead time.
const DEAD_TIME_TICKS: u8 = 20;
/// Resistance of the low-side shunts under phases B and C, ohm.
const SHUNT_OHM: f32 = 500e-6;
const AMPERES_PER_COUNT: f32 = adc::REFERENCE_V / adc::FULL_SCALE / drv8301::AMPLIFIER_GAIN / SHUNT_OHM;
/// Largest distance of a zero from the middle of the converter's range, counts: 1.5 times the amplifier's input offset
/// of 4 mV times the gain (SLOS719F section 6.5). No current adds to a zero, because the inputs are shorted.
const MAX_ZERO_DISTANCE: u16 = 600;
/// Largest apparent current with learned zeros and the bridges off, A: noise, and the effect of connecting the inputs.
const MAX_STRAY_CURRENT: f32 = 0.5;
/// Ratio of the 56 V boards' bus divider: 18 kohm over 1 kohm. The 24 V boards have 10 kohm over 1 kohm (11).
const BUS_DIVIDER: f32 = 19.0;

const TIMERS: [TimAdv; AXES] = [pac::TIM1, pac::TIM8];
/// Masks of the index inputs in port C.
const INDEX_LINES: [u32; AXES] = [1 << 9, 1 << 15];
/// Chip selects of absolute encoders, GPIO 3 and 4 of the header.
const ENCODER_SELECTS: [Select; AXES] = [(pac::GPIOA, 2), (pac::GPIOA, 3)];
/// Chip selects of the gate drivers.
const DRIVER_SELECTS: [Select; AXES] = [(pac::GPIOC, 13), (pac::GPIOC, 14)];
/// Bit of EN_GATE in port B.
const EN_GATE: usize = 12;
/// Bit of nFAULT in port D.
const N_FAULT: usize = 2;

pub struct OdriveV3;

impl Board for OdriveV3 {
    const NAME: &'static str = "odrive-v3";
    /// The bus divider holds PA6 with 0.9 kohm, with the supply on or off, and a thermistor with 3.3 kohm to the supply
    /// holds PC5. On a Discovery board PA6 is an output of its accelerometer, and PC5 is free. The two DRV8301 can be
    /// identified only while EN_GATE is high, so arming reads their registers back.
    const IDENTITY: IdentityPins = IdentityPins { held_pins: &[Pin::new('A', 6), Pin::new('C', 5)], open_pins: &[] };
    const AXES: usize = AXES;
    const ENCODERS: u8 = AXES as u8 + 1;
    /// Data of the bridges. The current loop has a phase margin of 60 degrees with half a carrier period of delay,
    /// because its bandwidth is the lowest carrier frequency / (10 * 2 pi), rounded down.
    const BRIDGE: Bridge = Bridge {
        carrier_hz: CARRIER_MIN_HZ as f32,
        dead_time: DEAD_TIME_TICKS as f32 / TIMER_HZ as f32,
        bandwidth_hz: 1000.0,
        current_sensed: true,
        legs: 3,
    };
    /// Limits that cannot be raised over USB. The current limit is half of the shunts' range. A 24 V board has a
    /// smaller divider and shows 1.7 times its voltage, so the 50 V limit trips at 29 V there.
    const LIMITS: Limits = Limits {
        torque: [10.0; 3],
        current: [20.0; 3],
        continuous_current: [10.0; 3],
        speed: [100.0; 3],
        power: 40.0,
        bus_min: 10.0,
        bus_max: 50.0,
        tip_force: MAX_TIP_FORCE,
    };
    const POWER_FAULT: Fault = Fault::GateDriver;
    const UNSENSED: &'static [Fault] = &[Fault::EncoderIllegal, Fault::BreakInput];
    type Io = Pins;
    type Gate = Drivers;

    #[inline]
    fn turn_bridges_off() {
        for timer in TIMERS {
            pwm::drive(timer, false);
        }
        pac::GPIOB.bsrr().write(|w| w.set_br(EN_GATE, true));
    }

    fn split(p: Peripherals, carrier: Carrier, board: bool) -> (Pins, Option<Drivers>, Common) {
        rcc::enable_and_reset::<peripherals::TIM1>();
        rcc::enable_and_reset::<peripherals::TIM8>();
        rcc::enable_and_reset::<peripherals::TIM2>();
        rcc::enable_and_reset::<peripherals::TIM3>();
        rcc::enable_and_reset::<peripherals::TIM4>();
        rcc::enable_and_reset::<peripherals::ADC1>();
        rcc::enable_and_reset::<peripherals::ADC2>();

        let config = pwm::PwmConfig { channels: [false, true, true], dead_time: DEAD_TIME_TICKS, break_input: false };
        for timer in TIMERS {
            pwm::configure(timer, &config, carrier);
        }
        // ADC1 samples phase B of both axes and the bus, ADC2 samples phase C of both axes.
        adc::configure(pac::ADC1, &[10, 13, 6]);
        adc::configure(pac::ADC2, &[11, 12]);

        let gate = board.then(|| {
            // EN_GATE is set low before any gate signal is driven.
            core::mem::forget(Output::new(p.PB12, Level::Low, Speed::Low));
            let mut fault = Flex::new(p.PD2);
            fault.set_as_input(embassy_stm32::gpio::Pull::Up);
            core::mem::forget(fault);
            // The brake resistor's half bridge stays off.
            let brake = [Output::new(p.PB10, Level::Low, Speed::Low), Output::new(p.PB11, Level::Low, Speed::Low)];
            core::mem::forget(brake);
            let [a, b, c] = [Flex::new(p.PA8), Flex::new(p.PA9), Flex::new(p.PA10)];
            pwm::outputs([a, b, c, Flex::new(p.PB13), Flex::new(p.PB14), Flex::new(p.PB15)], 1);
            let [a, b, c] = [Flex::new(p.PC6), Flex::new(p.PC7), Flex::new(p.PC8)];
            pwm::outputs([a, b, c, Flex::new(p.PA7), Flex::new(p.PB0), Flex::new(p.PB1)], 3);
            adc::inputs([Flex::new(p.PC0), Flex::new(p.PC1), Flex::new(p.PC2), Flex::new(p.PC3), Flex::new(p.PA6)]);
            encoder::start(pac::TIM3, Flex::new(p.PB4), Flex::new(p.PB5), 2);
            encoder::start(pac::TIM4, Flex::new(p.PB6), Flex::new(p.PB7), 2);
            encoder::start(encoder::TIM2, Flex::new(p.PA15), Flex::new(p.PB3), 1);
            index::latch(INDEX_LINES[0] | INDEX_LINES[1]);

            // A floating select would let an encoder answer in place of a gate driver.
            for pin in [p.PA2.into(), p.PA3.into(), p.PC13.into(), p.PC14.into()] {
                angle_sensors::idle_select(pin);
            }
            angle_sensors::start_bus(p.PC10.into(), p.PC11.into(), p.PC12.into());
            Drivers { drivers: DRIVER_SELECTS.map(Drv8301::new) }
        });
        pwm::lock(pac::GPIOA, 0b1111 << 7);
        pwm::lock(pac::GPIOB, 0b11 | 0b11_1111 << 10);
        pwm::lock(pac::GPIOC, 0b111 << 6);
        pwm::lock(pac::GPIOD, 1 << N_FAULT);

        let io = Pins {
            zeros: Zeros::new(),
            offsets: [ZeroOffsets { current: 0.0, imbalance: 0.0 }; AXES],
            carrier,
            has_third_legs: false,
            angle_sensors: AngleSensors::new(&ENCODER_SELECTS, [pac::TIM3, pac::TIM4, encoder::TIM2]),
        };
        (io, gate, Common { usb: (p.USB_OTG_FS, p.PA12, p.PA11), flash: p.FLASH, watchdog: p.IWDG })
    }
}

/// The part that the control interrupt owns.
pub struct Pins {
    zeros: Zeros<4>,
    offsets: [ZeroOffsets; AXES],
    carrier: Carrier,
    /// True if a three-phase motor is loaded.
    has_third_legs: bool,
    angle_sensors: AngleSensors,
}

/// Zero errors of an axis's two sensors, A: `current` is half their difference, `imbalance` their sum.
#[derive(Clone, Copy)]
struct ZeroOffsets {
    current: f32,
    imbalance: f32,
}

impl ZeroOffsets {
    /// Returns current and imbalance of these readings, A. The current of phase B returns through phase C.
    #[inline(always)]
    fn current_and_imbalance(&self, b: i32, c: i32) -> (f32, f32) {
        let current = self.current + 0.5 * AMPERES_PER_COUNT * (b - c) as f32;
        (current, self.imbalance + AMPERES_PER_COUNT * (b + c) as f32)
    }
}

impl Pins {
    /// Writes the compare values of phase A of both axes.
    #[inline(never)]
    fn write_third_legs(legs: &Legs) {
        pac::TIM1.ccr(0).write(|w| w.set_ccr(legs[0].third));
        pac::TIM8.ccr(0).write(|w| w.set_ccr(legs[1].third));
    }

    /// Returns the readings of all current sensors: phases B and C of the first axis, then of the second axis.
    #[inline(always)]
    fn raw_readings() -> [i32; 4] {
        [adc::result(pac::ADC1, 0), adc::result(pac::ADC2, 0), adc::result(pac::ADC1, 1), adc::result(pac::ADC2, 1)]
    }
}

impl Io for Pins {
    #[inline(always)]
    fn update_counts(&mut self, counts: &mut Counts) {
        encoder::update_count(pac::TIM3, &mut counts[0]);
        encoder::update_count(pac::TIM4, &mut counts[1]);
    }

    #[inline(always)]
    fn update_other_counts(&mut self, counts: &mut Counts) {
        encoder::update_count(encoder::TIM2, &mut counts[2]);
    }

    #[inline(always)]
    fn has_marks(&self) -> bool {
        index::pending_lines() != 0
    }

    fn marks(&mut self, counts: &Counts) -> [Option<i32>; MAX_JOINTS] {
        index::take_pulses(&INDEX_LINES, counts)
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
        let [b0, c0, b1, c1] = Self::raw_readings();
        (samples.currents[0], samples.imbalance[0]) = self.offsets[0].current_and_imbalance(b0, c0);
        (samples.currents[1], samples.imbalance[1]) = self.offsets[1].current_and_imbalance(b1, c1);
        let bus = adc::result(pac::ADC1, 2) as f32;
        samples.bus_voltage = adc::REFERENCE_V / adc::FULL_SCALE * BUS_DIVIDER * bus;
    }

    fn learn_zeros(&mut self) {
        self.zeros.update(Self::raw_readings());
        let zero = self.zeros.get().map(|zero| AMPERES_PER_COUNT * zero);
        for (axis, off) in self.offsets.iter_mut().enumerate() {
            let (b, c) = (zero[2 * axis], zero[2 * axis + 1]);
            *off = ZeroOffsets { current: -0.5 * (b - c), imbalance: -(b + c) };
        }
    }

    #[inline(always)]
    fn write(&mut self, legs: &Legs) {
        pac::TIM1.ccr(1).write(|w| w.set_ccr(legs[0].pair[0]));
        pac::TIM1.ccr(2).write(|w| w.set_ccr(legs[0].pair[1]));
        pac::TIM8.ccr(1).write(|w| w.set_ccr(legs[1].pair[0]));
        pac::TIM8.ccr(2).write(|w| w.set_ccr(legs[1].pair[1]));
        if self.has_third_legs {
            Self::write_third_legs(legs);
        }
    }

    fn connect_third_legs(&mut self, axes: [bool; MAX_JOINTS]) {
        for (timer, connected) in TIMERS.into_iter().zip(axes) {
            // An output that is off drives both switches of its leg low.
            timer.ccer().modify(|w| {
                w.set_cce(0, connected);
                w.set_ccne(0, connected);
            });
        }
        self.has_third_legs = axes.contains(&true);
    }

    fn angle_sensors(&mut self) -> Option<&mut AngleSensors> {
        Some(&mut self.angle_sensors)
    }

    #[inline]
    fn drive(&mut self, on: bool) {
        if on {
            for timer in TIMERS {
                pwm::drive(timer, true);
            }
        } else {
            OdriveV3::turn_bridges_off();
        }
    }

    /// Returns true if a gate driver pulls the common fault line low. Valid only while the drivers are enabled.
    #[inline(always)]
    fn has_fault(&self) -> bool {
        pac::GPIOD.idr().read().idr(N_FAULT) == pac::gpio::vals::Idr::LOW
    }

    #[inline(always)]
    fn carrier(&self) -> &Carrier {
        &self.carrier
    }

    fn set_carrier(&mut self, carrier: Carrier) {
        for timer in TIMERS {
            pwm::set_carrier(timer, carrier);
        }
        self.carrier = carrier;
    }

    fn start(&mut self) {
        pwm::start(Some(pac::TIM8));
    }
}

/// The part that the tasks own: the gate drivers.
pub struct Drivers {
    drivers: [Drv8301; AXES],
}

impl Drivers {
    fn configure(&mut self) -> Result<(), GateError> {
        for driver in &mut self.drivers {
            driver.configure(Inputs::Shorted)?;
        }
        let zero = learn_or_check_zeros(Zeroing::Learn);
        if zero > MAX_ZERO_DISTANCE {
            return Err(GateError::Offset(f32::from(zero) * AMPERES_PER_COUNT));
        }
        for driver in &mut self.drivers {
            driver.configure(Inputs::Shunts)?;
        }
        let stray = learn_or_check_zeros(Zeroing::Check);
        let current = f32::from(stray) * AMPERES_PER_COUNT;
        if current > MAX_STRAY_CURRENT { Err(GateError::Stray(current)) } else { Ok(()) }
    }
}

impl Gate for Drivers {
    /// Raises EN_GATE, configures both drivers, learns the amplifiers' zeros with shorted inputs and checks that no
    /// current flows. Takes about 35 ms. After an error the power stage is off.
    fn raise(&mut self) -> Result<(), GateError> {
        pac::GPIOB.bsrr().write(|w| w.set_bs(EN_GATE, true));
        // The drivers need up to 10 ms until they respond (SLOS719F 6.7).
        block_for(Duration::from_millis(10));
        let result = self.configure();
        if result.is_err() {
            OdriveV3::turn_bridges_off();
        }
        result
    }

    /// Checks that both drivers still hold their configuration. Takes 130 us.
    fn check(&mut self) -> Result<(), GateError> {
        self.drivers.iter_mut().try_for_each(|driver| driver.read_back(Inputs::Shunts))
    }
}
