//! The board around the chip: crystal, supply, power stages, sensors and encoders, wired as in [`crate::boards`].
//!
//! At every crest and valley of the carrier, the motor voltages are computed from the on-times of the switches since
//! the last extreme. The plant advances by the elapsed time, and its sensor values are applied to the chip's pins: one
//! quadrature edge after another, microvolts at the converters, and levels at the fault and index pins. Between two
//! extremes the mean of a centre-aligned carrier is its duty, so ripple is not simulated. While the carrier stands
//! still, the plant advances every [`PHYSICS_STEP_NS`].

use std::num::{NonZeroU32, NonZeroU64};

use haptic_sim::{BoardFaults, MotorInput};
use rigless::device::Level;
use rigless::machine::{Board, Target, armv7m};
use rigless::mcu::{Mcu, Operate};
use rigless::snapshot::Store;
use rigless::soc::st::tim::{BreakInput, BreakSource};
use rigless::soc::stm32f427::peripherals::adc::Channel as AnalogChannel;
use rigless::soc::stm32f427::peripherals::gpio::{Gpio, Pin as PortPin};
use rigless::soc::stm32f427::peripherals::spi::Select;
use rigless::soc::stm32f427::peripherals::tim::Channel;
use rigless::time::VirtualNanos;

use crate::angle_encoder::AngleEncoder;
use crate::boards::{EncoderWires, HalfBridge, MotorWires, Pin, Wiring};
use crate::chip::Chip;
use crate::chip::trigger::{REFERENCE_UV, Span};
use crate::drv8301::Drv8301;
use crate::plant::{Dummy, Peaks, Plant};

/// Instructions per second of virtual time, from 168 MHz and two cycles per instruction. The cycle estimate of a
/// control step with hidden wait states gives 1.9 to 2.3 cycles per instruction.
pub const INSTRUCTIONS_PER_SECOND: NonZeroU64 = NonZeroU64::new(84_000_000).expect("not zero");

/// Time between two steps of the plant without a carrier, which is half a period of the slowest carrier, ns.
pub const PHYSICS_STEP_NS: u64 = 25_000;
/// Time between two edges of one encoder, ns. It is longer than the 95 ns of the timer's input filter.
const EDGE_SPACING_NS: u64 = 250;

/// Offset of `ARR` of a timer.
const AUTO_RELOAD_OFFSET: u32 = 0x2C;
/// Offset of `MODER` of a port.
const PORT_MODE: u32 = 0x00;
/// Offset of `PUPDR` of a port.
const PORT_PULLS: u32 = 0x0C;
/// Offset of `BDTR` of an advanced timer.
const BREAK_AND_DEAD_TIME: u32 = 0x44;
/// Main output enable bit in `BDTR`.
const MAIN_OUTPUT: u64 = 1 << 15;
const CRYSTAL_HZ: u64 = 8_000_000;
/// Supply of a bare chip, mV.
const SUPPLY_MV: u32 = 3300;
/// Index of SPI3 in rigless.
const SPI3: usize = 2;

/// Levels of an encoder's two channels in its four phases, in the order of rising counts.
const QUADRATURE: [[Level; 2]; 4] =
    [[Level::Low, Level::Low], [Level::High, Level::Low], [Level::High, Level::High], [Level::Low, Level::High]];

/// A board with its chip.
#[derive(Debug)]
pub struct Hardware {
    /// The microcontroller.
    pub chip: Chip,
    /// Wiring of the board, or `None` for a bare chip.
    pub wiring: Option<&'static Wiring>,
    /// The plant at the board's connectors.
    pub plant: Box<dyn Plant>,
    /// True if the fault line is held low from outside.
    pub fault_line_shorted: bool,
    /// True for each encoder that is unplugged, so that its lines do not change.
    pub encoders_unplugged: [bool; 3],
    /// Number of edges of each encoder that its timer will miss.
    pub edges_lost: [u32; 3],
    /// True if the wire from the bus divider to the chip's pin is cut. Takes effect at the next start.
    pub is_bus_cut: bool,
    /// Other injected errors.
    pub faults: BoardFaults,
    /// Largest values since the last reset of this field.
    pub peaks: Peaks,
    encoders: [EncoderDrive; 3],
    /// Number of times that the encoders were sampled.
    samples: u64,
    next_step: u64,
    motor_inputs: [MotorInput; 3],
    break_level: Option<Level>,
    restarts_seen: Option<u64>,
}

#[derive(Clone, Copy, Debug, Default)]
struct EncoderDrive {
    shown_count: i32,
    wanted_count: i32,
}

/// Not stored in snapshots, because a run starts at power-on.
impl Store for Hardware {}

impl Hardware {
    /// Returns a bare chip with a crystal and a supply, for images that need no board.
    /// Returns an error if the description of the part is wrong, which is a bug in this crate.
    pub fn without_board() -> Result<Self, rigless::soc::Error> {
        let mut chip = Chip::new()?;
        chip.rcc.attach_crystals(CRYSTAL_HZ, 0);
        chip.set_supply(SUPPLY_MV);
        Ok(Self {
            chip,
            wiring: None,
            plant: Box::new(Dummy::default()),
            fault_line_shorted: false,
            encoders_unplugged: [false; 3],
            edges_lost: [0; 3],
            is_bus_cut: false,
            faults: BoardFaults::default(),
            peaks: Peaks::default(),
            encoders: [EncoderDrive::default(); 3],
            samples: 0,
            next_step: 0,
            motor_inputs: [MotorInput::Floating; 3],
            break_level: None,
            restarts_seen: None,
        })
    }

    /// Returns a board with `plant` at its connectors.
    /// Returns an error if the description of the part is wrong, which is a bug in this crate.
    pub fn new(wiring: impl Into<&'static Wiring>, plant: Box<dyn Plant>) -> Result<Self, rigless::soc::Error> {
        let wiring = wiring.into();
        let mut hardware = Self { wiring: Some(wiring), plant, ..Self::without_board()? };
        hardware.chip.set_supply(wiring.supply_mv);
        for select in wiring.driver_selects {
            let (port, pin) = port_and_pin(*select);
            let select = Select { port: PORT_NAMES[port], pin, active: Level::Low };
            hardware.chip.spi[SPI3].attach_selected(Drv8301::default(), select);
        }
        for select in wiring.encoder_selects {
            let (port, pin) = port_and_pin(*select);
            let select = Select { port: PORT_NAMES[port], pin, active: Level::Low };
            hardware.chip.spi[SPI3].attach_selected(AngleEncoder::default(), select);
        }
        Ok(hardware)
    }

    /// Returns the nth gate driver.
    pub fn driver(&mut self, nth: usize) -> &mut Drv8301 {
        self.chip.spi[SPI3].chip_mut(nth).expect("the board has this driver")
    }

    /// Returns the absolute encoder of an axis.
    pub fn angle_encoder(&mut self, axis: usize) -> &mut AngleEncoder {
        let drivers = self.wiring.map_or(0, |wiring| wiring.driver_selects.len());
        self.chip.spi[SPI3].chip_mut(drivers + axis).expect("the board has this axis")
    }

    /// Returns the motor inputs of the last step.
    #[must_use]
    pub fn motor_inputs(&self) -> [MotorInput; 3] {
        self.motor_inputs
    }

    /// Returns true if no bridge drives its motor: all main outputs are disabled and the enable line is low.
    pub fn bridges_float(&mut self) -> bool {
        let driven =
            ["TIM1", "TIM8"].iter().any(|timer| self.chip.register(timer, BREAK_AND_DEAD_TIME) & MAIN_OUTPUT != 0);
        let enable = self.wiring.map(|wiring| wiring.enable);
        !driven && enable.is_none_or(|enable| self.level(enable) == Level::Low)
    }

    /// Returns the level that the chip or the board applies to `pin`.
    pub fn level(&mut self, pin: Pin) -> Level {
        let (port, pin) = port_and_pin(pin);
        let (model, registers) = self.chip.port(port);
        model.level(pin, registers)
    }

    /// Advances the board to the time `at` of a stop. Returns the time at which the board needs the next stop.
    pub fn step(&mut self, at: VirtualNanos) -> Option<VirtualNanos> {
        let wiring = self.wiring?;
        if self.restarts_seen != Some(self.chip.restarts) {
            self.restarts_seen = Some(self.chip.restarts);
            self.break_level = None;
            // A starting chip must find the levels of encoders that have not moved.
            for (axis, wires) in wiring.encoders.iter().enumerate() {
                self.set_encoder_phase(at, axis, wires);
            }
            let bus_level = Level::from(self.plant.bus_voltage() / wiring.bus.1 > wiring.zero_current_volts());
            self.drive_pin(wiring.bus_pin(), (!self.is_bus_cut).then_some(bus_level), at);
            wiring.pins_held_high.iter().for_each(|&pin| self.set_pin(pin, Level::High, at));
        }
        if at.0 >= self.next_step {
            self.advance_plant(wiring, at);
            self.next_step = self.next_extreme(at.0).unwrap_or(at.0 - at.0 % PHYSICS_STEP_NS + PHYSICS_STEP_NS);
        }
        let moving = self.drive_encoders(wiring, at);
        Some(VirtualNanos(if moving { at.0 + EDGE_SPACING_NS } else { self.next_step }))
    }

    /// Returns the time of the first crest or valley of TIM1 after `at`, ns, or `None` if the timer does not run.
    fn next_extreme(&self, at: u64) -> Option<u64> {
        let crest = self.chip.advanced[0].hook.crest()?;
        let top = self.chip.register("TIM1", AUTO_RELOAD_OFFSET);
        // The timer counts at 168 MHz, so a tick takes 125/21 ns.
        let passed = at.saturating_sub(crest) * 21 / (125 * top.max(1));
        // If the crest did not come again two slopes later, the timer has stopped.
        let next = crest + (((passed + 1) * top + 1) * 125).div_ceil(21);
        (top > 0 && passed < 3 && next > at).then_some(next)
    }

    fn advance_plant(&mut self, wiring: &Wiring, at: VirtualNanos) {
        let spans = [0, 1].map(|nth| self.chip.advanced[nth].hook.take_span(at));
        let enabled = self.level(wiring.enable) == Level::High;
        for nth in 0..wiring.driver_selects.len() {
            self.driver(nth).enable(enabled);
        }
        for (axis, motor) in wiring.motors.iter().enumerate() {
            let has_phases = self.plant.phase_currents(axis).is_some();
            let span = &spans[usize::from(motor.timer == 8)];
            self.motor_inputs[axis] = self.drive(wiring, motor, span, enabled, has_phases);
        }
        self.peaks.bridge_was_on |= !self.bridges_float();
        self.peaks.power_pin_was_driven =
            self.peaks.power_pin_was_driven || wiring.power_pins.iter().any(|&pin| !self.is_untouched(pin));
        if spans[0].length_ns > 0 {
            self.plant.step(&self.faults.drives(self.motor_inputs), spans[0].length_ns as f64 * 1e-9);
            self.peaks.update(&mut *self.plant);
            self.samples += 1;
        }
        let (counts, absolute) = (self.faults.counts(self.plant.counts(), self.samples), self.plant.absolute_axes());
        for axis in 0..wiring.encoders.len() {
            match absolute[axis] {
                true => self.angle_encoder(axis).turn_to(counts[axis]),
                false => self.encoders[axis].wanted_count = counts[axis],
            }
        }
        self.set_analog_inputs(wiring);
        self.set_levels(wiring, at);
    }

    /// Returns the input of a motor, which has three phases if `has_phases`.
    fn drive(
        &mut self,
        wiring: &Wiring,
        motor: &MotorWires,
        span: &Span,
        enabled: bool,
        has_phases: bool,
    ) -> MotorInput {
        let joined = motor.gates.iter().all(|&gate| self.alternate_function(gate) == Some(motor.function));
        if !enabled || !joined || span.length_ns == 0 {
            return MotorInput::Floating;
        }
        if span.enabled_ns * 2 < span.length_ns {
            return if wiring.brakes_when_idle { MotorInput::Duty(0.0) } else { MotorInput::Floating };
        }
        let share = |end| match end {
            HalfBridge::Channel(n) => span.active_ns[usize::from(n) - 1] as f64,
            HalfBridge::Complement(n) => (span.enabled_ns - span.active_ns[usize::from(n) - 1]) as f64,
        };
        let [first, second] = motor.ends.map(|end| share(end) / span.length_ns as f64);
        match motor.third.filter(|_| has_phases) {
            Some((channel, gates)) => {
                // A leg without its gates floats, and so does the star of windings.
                let joined = gates.iter().all(|&gate| self.alternate_function(gate) == Some(motor.function));
                let third = share(HalfBridge::Channel(channel)) / span.length_ns as f64;
                if joined { MotorInput::Legs([first, second, third]) } else { MotorInput::Floating }
            }
            None => MotorInput::Duty(first - second),
        }
    }

    /// Returns the alternate function that a pin has now.
    fn alternate_function(&mut self, pin: Pin) -> Option<u8> {
        let (port, pin) = port_and_pin(pin);
        let (_, registers) = self.chip.port(port);
        Gpio::function(pin, registers)
    }

    fn set_analog_inputs(&mut self, wiring: &Wiring) {
        let currents = self.plant.currents();
        let mut nth = 0;
        for (axis, motor) in wiring.motors.iter().enumerate() {
            let gain = if wiring.driver_selects.is_empty() { Some(1.0) } else { self.driver(axis).gain() };
            let phases = self.plant.phase_currents(self.faults.motors[axis]);
            for (leg, &(channel, volts_per_ampere)) in motor.sensors.iter().enumerate() {
                // The second sensor of a brushed motor measures the returning current.
                let (current, volts_per_ampere) = match phases {
                    Some(phases) => (self.faults.leg_current(phases, axis, leg), volts_per_ampere.abs()),
                    None => (self.faults.current(&currents, axis, nth), volts_per_ampere),
                };
                let volts = gain.map_or(0.0, |gain| {
                    wiring.zero_current_volts() + wiring.sensor_offsets[nth] + gain * volts_per_ampere * current
                });
                self.set_input_volts(wiring, channel, volts);
                nth += 1;
            }
        }
        let (channel, divider) = wiring.bus;
        self.set_input_volts(wiring, channel, self.faults.bus_reading.unwrap_or(self.plant.bus_voltage()) / divider);
    }

    fn set_input_volts(&mut self, wiring: &Wiring, channel: u8, volts: f64) {
        let channel = AnalogChannel::new(channel).expect("a pin channel");
        // A float-to-int `as` saturates, like an input that is clamped to its rails. The converters have only one
        // reference voltage, so the input is scaled by the board's reference.
        let share = volts / (1e-3 * f64::from(wiring.supply_mv));
        let microvolts = ((share * f64::from(REFERENCE_UV)) as u32).min(REFERENCE_UV);
        for converter in &mut self.chip.converters {
            converter.inner.set_input(channel, microvolts);
        }
    }

    fn set_levels(&mut self, wiring: &Wiring, at: VirtualNanos) {
        let pulled =
            self.fault_line_shorted || (0..wiring.driver_selects.len()).any(|nth| self.driver(nth).pulls_fault());
        self.set_pin(wiring.fault, Level::from(!pulled), at);
        if wiring.fault_is_break_input {
            let level = Level::from(!pulled);
            if self.break_level != Some(level) && self.alternate_function(wiring.fault) == Some(1) {
                self.break_level = Some(level);
                let slot = self.chip.bus().slot_of("TIM1").expect("the part has TIM1");
                let (bus, timers) = self.chip.bus_and_timers();
                let (registers, mut context) = bus.drive(at, slot);
                let (input, source) = (BreakInput::First, BreakSource::Pin);
                timers[0].inner.drive_break_source(input, source, level, registers, &mut context);
            }
        }
        let index = self.plant.index();
        for (encoder, mark) in wiring.encoders.iter().zip(index) {
            let Some(pin) = encoder.index else { continue };
            let rises = mark && self.level(pin) == Level::Low;
            self.set_pin(pin, Level::from(mark), at);
            if rises {
                let (port, line) = port_and_pin(pin);
                self.chip.apply_rising_edge(at, port, line.bit());
            }
        }
    }

    fn set_pin(&mut self, pin: Pin, level: Level, at: VirtualNanos) {
        self.drive_pin(pin, Some(level), at);
    }

    /// Holds a pin of the chip at a level from outside, or releases the pin for `None`.
    fn drive_pin(&mut self, pin: Pin, level: Option<Level>, at: VirtualNanos) {
        let (port, pin) = port_and_pin(pin);
        self.chip.drive_port(at, port, |port, registers, context| {
            port.drive(pin, level, registers, context);
        });
    }

    /// Returns true if a pin is still configured as after a reset, as an input without pull-up.
    fn is_untouched(&self, Pin(port, number): Pin) -> bool {
        let port = PORT_NAMES[(port as usize) - ('A' as usize)];
        let field = |register| self.chip.register(port, register) >> (2 * number) & 0b11;
        field(PORT_MODE) == 0 && field(PORT_PULLS) != 0b01
    }

    /// Makes one edge of each encoder that has counts left. Returns true if counts are left afterwards.
    fn drive_encoders(&mut self, wiring: &Wiring, at: VirtualNanos) -> bool {
        let mut moving = false;
        for (axis, wires) in wiring.encoders.iter().enumerate() {
            let encoder = &mut self.encoders[axis];
            let step = (encoder.wanted_count - encoder.shown_count).signum();
            if step == 0 {
                continue;
            }
            encoder.shown_count += step;
            moving |= encoder.shown_count != encoder.wanted_count;
            if self.edges_lost[axis] > 0 {
                self.edges_lost[axis] -= 1;
                continue;
            }
            if !self.encoders_unplugged[axis]
                && wires.pins.iter().all(|&pin| self.alternate_function(pin) == Some(wires.function))
            {
                self.set_encoder_phase(at, axis, wires);
            }
        }
        moving
    }

    fn set_encoder_phase(&mut self, at: VirtualNanos, axis: usize, wires: &EncoderWires) {
        let levels = QUADRATURE[self.encoders[axis].shown_count.rem_euclid(4) as usize];
        for (channel, level) in (1..).zip(levels) {
            let channel = Channel::new(channel).expect("a timer has four channels");
            self.chip.drive_timer(at, usize::from(wires.timer) - 2, |timer, registers, context| {
                timer.drive_input(channel, level, registers, context);
            });
        }
    }
}

const PORT_NAMES: [&str; 5] = ["GPIOA", "GPIOB", "GPIOC", "GPIOD", "GPIOE"];

fn port_and_pin(Pin(port, number): Pin) -> (usize, PortPin) {
    let port = (port as usize) - ('A' as usize);
    (port, PortPin::new(number).expect("a port has sixteen pins"))
}

impl Board for Hardware {
    fn name(&self) -> &'static str {
        "haptic-emulator"
    }

    fn target_names(&self) -> Vec<&'static str> {
        vec!["stm32f405"]
    }

    fn mcu(&mut self, target: usize) -> Option<&mut dyn Mcu> {
        (target == 0).then_some(&mut self.chip)
    }

    fn targets(&mut self) -> Vec<Target<'_>> {
        let lines = u32::from(self.chip.cpu().interrupt_lines);
        let core = armv7m::Core {
            variant: armv7m::Variant::M4,
            clock_hz: NonZeroU64::new(168_000_000).expect("not zero"),
            interrupt_lines: NonZeroU32::new(lines).expect("the part has interrupts"),
            priority_bits: 4,
            refclk_divider: NonZeroU32::new(8).expect("not zero"),
            instructions_per_second: INSTRUCTIONS_PER_SECOND,
            boot: "flash",
        }
        .spec_with_parts(
            &rigless::cpu::armv7m::windows(self.chip.bus()),
            armv7m::Fpu::FpV4Sp,
            armv7m::MpuRegions::Eight,
        );
        vec![Target::new("stm32f405", &mut self.chip, core)]
    }
}
