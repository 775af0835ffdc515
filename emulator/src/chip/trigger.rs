//! Connections between peripherals that rigless does not model: timer triggers that start conversions (RM0090 tables 68
//! and 69), and the start of TIM8 by TIM1 (table 93, `ITR0`).

use rigless::device::{Device, DeviceContext, Level, RegisterFile, RequestChange};
use rigless::soc::stm32f427::generated::adc1::Register;
use rigless::soc::stm32f427::generated::tim1::Register as TimRegister;
use rigless::soc::stm32f427::peripherals::adc::Adc;
use rigless::soc::stm32f427::peripherals::rcc::HSI_HZ;
use rigless::soc::stm32f427::peripherals::tim::{Advanced, Channel, Tim};
use rigless::soc::stm32f427::peripherals::{ADVANCED_TIMERS, CONVERTERS, rcc};
use rigless::time::VirtualNanos;

use super::hook::{Hook, Hooked};

/// VREF+, µV. The inputs of the converters are set in µV, because rigless' millivolts are coarser than one bit.
pub const REFERENCE_UV: u32 = 3_300_000;

/// Request number of the trigger output, which rigless' models do not use.
const TRGO: usize = 100;
/// Request number of the reference of channel 4, which rigless' models do not use.
const CC4: usize = 101;

/// TIM1 or TIM8 with connected trigger outputs.
pub type MasterTimer = Hooked<Tim<Advanced>, Outputs>;
/// A converter with connected external triggers.
pub type Converter = Hooked<Adc, ExternalTrigger>;

/// Returns the nth advanced timer after a reset.
#[must_use]
pub fn timer(nth: usize) -> MasterTimer {
    let inner = Tim::with_clock(HSI_HZ, ADVANCED_TIMERS[nth].counter).breaks_on("RCC", rcc::CLOCK_FAILURE);
    let hook = Outputs { slave_of_tim1: ADVANCED_TIMERS[nth].instance == "TIM8", ..Outputs::default() };
    Hooked { inner, hook }
}

/// Returns the nth converter after a reset, with VREF+ and inputs in µV (see [`crate::hardware`]).
#[must_use]
pub fn converter(nth: usize) -> Converter {
    let mut inner = Adc::with_clock(HSI_HZ / 2);
    inner.set_reference(REFERENCE_UV);
    Hooked { inner, hook: ExternalTrigger { instance: CONVERTERS[nth], ignores_triggers: false } }
}

/// Latest outputs of a timer, and their durations.
#[derive(Debug, Default)]
pub struct Outputs {
    slave_of_tim1: bool,
    level: Level,
    pulses: u64,
    channel4: Level,
    crest: Option<u64>,
    references: [bool; 3],
    main_output_enabled: bool,
    counted_until: u64,
    span: Span,
}

/// On-times of a timer's channels within a time span.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Span {
    /// Length of the span, ns.
    pub length_ns: u64,
    /// Time with enabled main output, ns.
    pub enabled_ns: u64,
    /// Times with active references of channels 1 to 3 and enabled main output, ns. The upper switch is on except for
    /// the dead time.
    pub active_ns: [u64; 3],
}

impl Outputs {
    /// Returns the on-times from the last call until `now`.
    pub fn take_span(&mut self, now: VirtualNanos) -> Span {
        self.count_time(now);
        std::mem::take(&mut self.span)
    }

    /// Returns the time of the last rising edge of channel 4's reference, one tick before a crest, ns.
    #[must_use]
    pub fn crest(&self) -> Option<u64> {
        self.crest
    }

    /// Starts to count time at the end of a reset.
    pub fn start_counting(&mut self, at: VirtualNanos) {
        self.counted_until = at.0;
    }

    fn count_time(&mut self, now: VirtualNanos) {
        let passed = now.0.saturating_sub(self.counted_until);
        self.counted_until = self.counted_until.max(now.0);
        self.span.length_ns += passed;
        if self.main_output_enabled {
            self.span.enabled_ns += passed;
            for (active, reference) in self.span.active_ns.iter_mut().zip(self.references) {
                *active += if reference { passed } else { 0 };
            }
        }
    }
}

/// Main output enable bit in `BDTR`.
const MOE: u64 = 1 << 15;

impl Hook<Tim<Advanced>> for Outputs {
    fn after_call(&mut self, timer: &mut Tim<Advanced>, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.count_time(context.now());
        self.main_output_enabled = registers.get(TimRegister::Bdtr) & MOE != 0;
        for (number, reference) in (1..).zip(&mut self.references) {
            let channel = Channel::new(number).expect("a timer has four channels");
            *reference = timer.reference(channel) == Level::High;
        }
        let (level, pulses) = timer.trigger_output();
        if pulses != self.pulses {
            self.pulses = pulses;
            context.request(TRGO, Level::High);
            context.request(TRGO, Level::Low);
        }
        if level != self.level {
            self.level = level;
            context.request(TRGO, level);
        }
        let channel4 = timer.reference(Channel::new(4).expect("a timer has four channels"));
        if channel4 != self.channel4 {
            self.channel4 = channel4;
            if channel4 == Level::High {
                self.crest = Some(context.now().0);
            }
            context.request(CC4, channel4);
        }
    }

    fn request(
        &mut self,
        change: RequestChange,
        timer: &mut Tim<Advanced>,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        if self.slave_of_tim1 && change.instance == "TIM1" && change.request == TRGO {
            timer.drive_internal_trigger(0, change.level, registers, context);
        }
    }
}

/// External triggers that start conversions of a converter.
#[derive(Debug)]
pub struct ExternalTrigger {
    instance: &'static str,
    /// True if triggers have no effect.
    pub ignores_triggers: bool,
}

/// Bit that starts the injected group like a trigger.
const JSWSTART: u64 = 1 << 22;
/// Bit that starts the regular group like a trigger.
const SWSTART: u64 = 1 << 30;

impl Hook<Adc> for ExternalTrigger {
    fn request(
        &mut self,
        change: RequestChange,
        adc: &mut Adc,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        if change.instance == self.instance || self.ignores_triggers {
            return;
        }
        let control = registers.get(Register::Cr2);
        let starts = |select: u64, enable: u64, source: fn(u64) -> Option<(&'static str, usize)>| {
            let edge = match change.level {
                Level::High => 0b01,
                Level::Low => 0b10,
            };
            (control >> enable) & edge != 0
                && source((control >> select) & 0xF) == Some((change.instance, change.request))
        };
        let mut start = 0;
        if starts(16, 20, injected_source) {
            start |= JSWSTART;
        }
        if starts(24, 28, regular_source) {
            start |= SWSTART;
        }
        if start != 0 {
            registers.set(Register::Cr2, control | start);
            Device::write(adc, Register::Cr2, control | start, registers, context);
        }
    }
}

/// Returns the trigger that `JEXTSEL` selects (table 69).
fn injected_source(select: u64) -> Option<(&'static str, usize)> {
    match select {
        0 => Some(("TIM1", CC4)),
        1 => Some(("TIM1", TRGO)),
        14 => Some(("TIM8", CC4)),
        _ => None,
    }
}

/// Returns the trigger that `EXTSEL` selects (table 68). TIM1's trigger output does not start a regular group.
fn regular_source(select: u64) -> Option<(&'static str, usize)> {
    match select {
        14 => Some(("TIM8", TRGO)),
        _ => None,
    }
}
