//! ODrive v3.6 and its clones: two axes, each a three-phase bridge behind a DRV8301, with shunts under phases B and C.
//!
//! A brushed motor sits between phases B and C of its axis: both carry the same carrier at 0.5 +- duty/2 and phase A
//! stays off. Pins: docs/wiring-odrive-v3.md. EN_GATE is common to both drivers, and low resets their registers.

use embassy_stm32::gpio::{Flex, Level, Output, Speed};
use embassy_stm32::pac;
use embassy_stm32::pac::timer::TimAdv;
use embassy_stm32::spi::{self, Spi};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Peripherals, peripherals, rcc};
use embassy_time::{Duration, block_for};
use haptic_bridge::drive::carrier::{CARRIER_MIN_HZ, Carrier};
use haptic_bridge::drive::stage::Bridge;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::safety::fault::Fault;
use haptic_bridge::safety::limits::{Limits, MOST_TIP_FORCE};
use haptic_bridge::servo::frame::Samples;
use haptic_bridge::servo::joints::Counts;

use super::{Board, Common, Io, Pin, Signs};
use crate::adc;
use crate::clock::TIMER_HZ;
use crate::drv8301::{self, Drv8301, Inputs};
use crate::encoder;
use crate::gate::{Gate, GateError};
use crate::index;
use crate::pwm;
use crate::zeros::{Zeroing, Zeros, settle};

/// Motors that it can drive.
const AXES: usize = 2;

/// Dead time between the switches of a half bridge: 20 ticks of 1/168 MHz, 119 ns, on top of what the driver inserts
/// itself.
const DEAD_TIME_TICKS: u8 = 20;

/// Low-side shunts under phases B and C, ohm.
const SHUNT_OHM: f32 = 500e-6;

/// Amperes per count of the converter.
const AMPERES_PER_COUNT: f32 = adc::REFERENCE_V / adc::FULL_SCALE / drv8301::AMPLIFIER_GAIN / SHUNT_OHM;

/// Farthest that a zero may be from the middle of the converter's range, counts: 4 mV of input offset (SLOS719F section
/// 6.5) times the gain, and half as much again. It is learned with shorted inputs, so no current hides in it.
const ZERO_MAX: u16 = 600;

/// Current that may seem to flow once the zeros are learned and the bridges are still off, A: noise, and an amplifier
/// whose inputs are no longer shorted.
const STRAY_A: f32 = 0.5;

/// Bus divider of the 56 V boards, 18 kohm over 1 kohm; the 24 V ones have 10 kohm over 1 kohm (11).
const BUS_DIVIDER: f32 = 19.0;

const TIMERS: [TimAdv; AXES] = [pac::TIM1, pac::TIM8];

/// Bits of the index inputs in port C.
const INDEX_LINES: [u32; AXES] = [1 << 9, 1 << 15];
/// Bit of EN_GATE in port B.
const EN_GATE: usize = 12;
/// Bit of nFAULT in port D.
const N_FAULT: usize = 2;

/// This board.
pub struct OdriveV3;

impl Board for OdriveV3 {
    const NAME: &'static str = "odrive-v3";
    /// The bus divider holds PA6 with 0.9 kohm, with the supply on or off, and a thermistor with 3.3 kohm to the supply
    /// holds PC5. On a Discovery board PA6 is an output of its accelerometer, and PC5 is free. That there are two DRV8301
    /// shows only once EN_GATE is high: arming reads their registers back.
    const SIGNS: Signs = Signs { held: &[Pin::new('A', 6), Pin::new('C', 5)], open: &[] };
    const AXES: usize = AXES;
    /// Data of the bridges. The current loop's bandwidth is a tenth of the slowest carrier over two pi, rounded down:
    /// with half a period of delay it keeps 60 degrees of phase margin at any carrier.
    const BRIDGE: Bridge = Bridge {
        carrier_hz: CARRIER_MIN_HZ as f32,
        dead_time: DEAD_TIME_TICKS as f32 / TIMER_HZ as f32,
        bandwidth_hz: 1000.0,
        current_sensed: true,
    };
    /// Limits that cannot be raised over USB: half of the range of the shunts, and a bus voltage that is also safe for
    /// a 24 V board, whose divider makes it read 1.7 times too high.
    const LIMITS: Limits = Limits {
        torque: [10.0; 3],
        current: [20.0; 3],
        continuous_current: [10.0; 3],
        speed: [100.0; 3],
        power: 40.0,
        bus_min: 10.0,
        bus_max: 50.0,
        tip_force: MOST_TIP_FORCE,
    };
    const POWER_FAULT: Fault = Fault::GateDriver;
    const UNSENSED: &'static [Fault] = &[Fault::EncoderIllegal, Fault::BreakInput];
    type Io = Pins;
    type Gate = Drivers;

    #[inline]
    fn off() {
        for timer in TIMERS {
            pwm::drive(timer, false);
        }
        pac::GPIOB.bsrr().write(|w| w.set_br(EN_GATE, true));
    }

    fn split(p: Peripherals, carrier: Carrier, board: bool) -> (Pins, Option<Drivers>, Common) {
        rcc::enable_and_reset::<peripherals::TIM1>();
        rcc::enable_and_reset::<peripherals::TIM8>();
        rcc::enable_and_reset::<peripherals::TIM3>();
        rcc::enable_and_reset::<peripherals::TIM4>();
        rcc::enable_and_reset::<peripherals::ADC1>();
        rcc::enable_and_reset::<peripherals::ADC2>();

        let config = pwm::PwmConfig { channels: [false, true, true], dead_time: DEAD_TIME_TICKS, break_input: false };
        for timer in TIMERS {
            pwm::configure(timer, &config, carrier);
        }
        // Phase B of both axes and the bus on one converter, phase C of both on the other.
        adc::configure(pac::ADC1, &[10, 13, 6]);
        adc::configure(pac::ADC2, &[11, 12]);

        let gate = board.then(|| {
            // EN_GATE first: low, for good measure, before any gate signal has a driver.
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
            index::latch(INDEX_LINES[0] | INDEX_LINES[1]);

            let mut config = spi::Config::default();
            config.mode = spi::MODE_1;
            config.frequency = Hertz(2_000_000);
            Drivers {
                bus: Spi::new_blocking(p.SPI3, p.PC10, p.PC12, p.PC11, config),
                drivers: [
                    Drv8301::new(Output::new(p.PC13, Level::High, Speed::Low)),
                    Drv8301::new(Output::new(p.PC14, Level::High, Speed::Low)),
                ],
            }
        });
        pwm::lock(pac::GPIOA, 0b1111 << 7);
        pwm::lock(pac::GPIOB, 0b11 | 0b11_1111 << 10);
        pwm::lock(pac::GPIOC, 0b111 << 6);
        pwm::lock(pac::GPIOD, 1 << N_FAULT);

        let io = Pins { zeros: Zeros::new(), offsets: [Offsets { current: 0.0, imbalance: 0.0 }; AXES], carrier };
        (io, gate, Common { usb: (p.USB_OTG_FS, p.PA12, p.PA11), flash: p.FLASH, watchdog: p.IWDG })
    }
}

/// The part that the control interrupt owns.
pub struct Pins {
    zeros: Zeros<4>,
    offsets: [Offsets; AXES],
    carrier: Carrier,
}

/// Zero errors of an axis's two sensors, A: half their difference, and their sum.
#[derive(Clone, Copy)]
struct Offsets {
    current: f32,
    imbalance: f32,
}

impl Offsets {
    /// Current and imbalance (A) of these readings. What leaves phase B comes back through C.
    #[inline(always)]
    fn sensed(&self, b: i32, c: i32) -> (f32, f32) {
        let current = self.current + 0.5 * AMPERES_PER_COUNT * (b - c) as f32;
        (current, self.imbalance + AMPERES_PER_COUNT * (b + c) as f32)
    }
}

impl Pins {
    /// The readings of all sensors: phases B and C of one axis, then of the other.
    #[inline(always)]
    fn raw() -> [i32; 4] {
        [adc::result(pac::ADC1, 0), adc::result(pac::ADC2, 0), adc::result(pac::ADC1, 1), adc::result(pac::ADC2, 1)]
    }
}

impl Io for Pins {
    #[inline(always)]
    fn follow(&mut self, counts: &mut Counts) {
        encoder::follow(pac::TIM3, &mut counts[0]);
        encoder::follow(pac::TIM4, &mut counts[1]);
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
        let [b0, c0, b1, c1] = Self::raw();
        (seen.currents[0], seen.imbalance[0]) = self.offsets[0].sensed(b0, c0);
        (seen.currents[1], seen.imbalance[1]) = self.offsets[1].sensed(b1, c1);
        let bus = adc::result(pac::ADC1, 2) as f32;
        seen.bus_voltage = adc::REFERENCE_V / adc::FULL_SCALE * BUS_DIVIDER * bus;
    }

    fn learn(&mut self) {
        self.zeros.take(Self::raw());
        let zero = self.zeros.get().map(|zero| AMPERES_PER_COUNT * zero);
        for (axis, off) in self.offsets.iter_mut().enumerate() {
            let (b, c) = (zero[2 * axis], zero[2 * axis + 1]);
            *off = Offsets { current: -0.5 * (b - c), imbalance: -(b + c) };
        }
    }

    #[inline(always)]
    fn write(&mut self, legs: &[[u16; 2]; MAX_JOINTS]) {
        pac::TIM1.ccr(1).write(|w| w.set_ccr(legs[0][0]));
        pac::TIM1.ccr(2).write(|w| w.set_ccr(legs[0][1]));
        pac::TIM8.ccr(1).write(|w| w.set_ccr(legs[1][0]));
        pac::TIM8.ccr(2).write(|w| w.set_ccr(legs[1][1]));
    }

    #[inline]
    fn drive(&mut self, on: bool) {
        if on {
            for timer in TIMERS {
                pwm::drive(timer, true);
            }
        } else {
            OdriveV3::off();
        }
    }

    /// True if a gate driver pulls the common fault line. Only meaningful while the drivers are up.
    #[inline(always)]
    fn fault(&self) -> bool {
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
    bus: drv8301::Bus,
    drivers: [Drv8301; AXES],
}

impl Drivers {
    fn set_up(&mut self) -> Result<(), GateError> {
        for driver in &mut self.drivers {
            driver.configure(&mut self.bus, Inputs::Shorted)?;
        }
        let zero = settle(Zeroing::Learn);
        if zero > ZERO_MAX {
            return Err(GateError::Offset(f32::from(zero) * AMPERES_PER_COUNT));
        }
        for driver in &mut self.drivers {
            driver.configure(&mut self.bus, Inputs::Shunts)?;
        }
        let stray = settle(Zeroing::Check);
        let current = f32::from(stray) * AMPERES_PER_COUNT;
        if current > STRAY_A { Err(GateError::Stray(current)) } else { Ok(()) }
    }
}

impl Gate for Drivers {
    /// Raises EN_GATE, sets both drivers up, learns the amplifiers' zeros with their inputs shorted and sees that no
    /// current flows: about 35 ms. On an error everything is off again.
    fn raise(&mut self) -> Result<(), GateError> {
        pac::GPIOB.bsrr().write(|w| w.set_bs(EN_GATE, true));
        // SLOS719F 6.7: up to 10 ms until the driver answers.
        block_for(Duration::from_millis(10));
        let result = self.set_up();
        if result.is_err() {
            OdriveV3::off();
        }
        result
    }

    /// Returns true if both drivers still are as [`Gate::raise`] left them: 130 us.
    fn check(&mut self) -> Result<(), GateError> {
        self.drivers.iter_mut().try_for_each(|driver| driver.read_back(&mut self.bus, Inputs::Shunts))
    }
}
