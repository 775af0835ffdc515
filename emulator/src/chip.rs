//! The microcontroller: rigless' STM32F427 turned into the STM32F405 that the boards carry.
//!
//! Taken over from rigless unchanged: the core, RCC, PWR, GPIO, timers, converters, SPI, DMA, watchdog. Replaced: the
//! memory sizes, the contents of the flash array ([`flash`]), the USB core in device mode ([`otg`]), and the wires from
//! timer triggers to converters and from TIM1 to TIM8 ([`trigger`]).
//!
//! rigless builds its part around a bus of its own description. Here the part runs on a bus of *our* description
//! ([`map`]) that holds the part's own slots, in the same order; a system reset hands the part its old bus back first.

pub mod flash;
pub mod hook;
pub mod map;
pub mod otg;
pub mod trigger;

use std::ops::{Deref, DerefMut};

use rigless::device::{ErasedDevice, ResetCause};
use rigless::mcu::{Mcu, Operate};
use rigless::soc::stm32f427::Stm32f427;
use rigless::soc::stm32f427::generated::dbg::Register as DebugRegister;
use rigless::soc::stm32f427::generated::exti::Register as ExtiRegister;
use rigless::soc::stm32f427::peripherals::{ADVANCED_TIMERS, CONVERTERS};
use rigless::soc::{Bus, Error, Width};
use rigless::time::VirtualNanos;

use flash::FlashUnit;
use otg::Otg;
use trigger::{Converter, MasterTimer};

/// The blocks that the vendor's file splits the USB core into, in address order.
pub const OTG_BLOCKS: [&str; 4] = ["OTG_FS_GLOBAL", "OTG_FS_HOST", "OTG_FS_DEVICE", "OTG_FS_PWRCLK"];

/// Which model of ours answers for a slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ours {
    None,
    Otg(usize),
    Flash,
    /// A table of ours without a model.
    Exti,
    Advanced(usize),
    Converter(usize),
}

/// An STM32F405.
#[derive(Debug)]
pub struct Chip {
    part: Stm32f427,
    /// The bus the part was built with, its slots moved out.
    parked: Bus,
    ours: Vec<Ours>,
    otg_slot: usize,
    /// Restarts so far.
    pub restarts: u64,
    /// The USB core and the cable's far end.
    pub otg: Otg,
    /// The flash interface with its array.
    pub flash: FlashUnit,
    /// TIM1 and TIM8.
    pub advanced: [MasterTimer; ADVANCED_TIMERS.len()],
    /// ADC1 to ADC3.
    pub converters: [Converter; CONVERTERS.len()],
}

impl Deref for Chip {
    type Target = Stm32f427;
    fn deref(&self) -> &Stm32f427 {
        &self.part
    }
}

impl DerefMut for Chip {
    fn deref_mut(&mut self) -> &mut Stm32f427 {
        &mut self.part
    }
}

impl Chip {
    /// The chip out of power-on with nothing on its pins.
    ///
    /// # Errors
    ///
    /// A wrong description of the part, which is a bug here.
    pub fn new() -> Result<Self, Error> {
        let part = Stm32f427::new()?;
        let bus = map::bus(part.bus())?;
        let bus_slot = bus.slot(OTG_BLOCKS[0])?;
        let ours = bus.slots().iter().map(|slot| owner(slot.peripheral().name)).collect();
        let mut chip = Self {
            part,
            parked: bus,
            otg_slot: bus_slot,
            ours,
            restarts: 0,
            otg: Otg::default(),
            flash: flash::unit(),
            advanced: std::array::from_fn(trigger::timer),
            converters: std::array::from_fn(trigger::converter),
        };
        chip.exchange();
        chip.check()?;
        chip.name_itself(VirtualNanos(0));
        Ok(chip)
    }

    /// Tells programs that this is an STM32F405, of revision Y (RM0090 section 38.6.1).
    fn name_itself(&mut self, at: VirtualNanos) {
        let slot = self.bus().slot_of("DBG").expect("the part has a debug component");
        let (registers, _) = self.part.bus_mut().drive(at, slot);
        registers.set(DebugRegister::DbgmcuIdcode, 0x100F_6413);
    }

    /// Swaps the bus in use with the parked one. The slots of the part's own models move along, so what they hold,
    /// what gates them and how they are corrected is the same on either.
    fn exchange(&mut self) {
        let Self { part, parked, ours, .. } = self;
        for (index, owner) in ours.iter().enumerate() {
            if !matches!(owner, Ours::Otg(_) | Ours::Exti) {
                std::mem::swap(parked.slot_mut(index), part.bus_mut().slot_mut(index));
            }
        }
        std::mem::swap(parked, part.bus_mut());
    }

    /// The bus and the advanced timers, apart, to drive a timer's input.
    pub fn bus_and_timers(&mut self) -> (&mut Bus, &mut [MasterTimer]) {
        (self.part.bus_mut(), &mut self.advanced)
    }

    /// A rising edge at pin `line` of port `port` (0 for A): latched where the firmware selected the port for the line
    /// (SYSCFG), its rising edges and its request (RM0090 section 12.3). No model of rigless does this.
    ///
    /// # Panics
    ///
    /// When the part has no such controller, which is a bug here.
    pub fn rising_edge(&mut self, at: VirtualNanos, port: usize, line: u32) {
        let selected = self.register("SYSCFG", 0x08 + 4 * (line / 4)) >> (4 * (line % 4)) & 0xF;
        let enabled = self.register("EXTI", map::exti::RISING) & self.register("EXTI", map::exti::MASK) & (1 << line);
        if selected == port as u64 && enabled != 0 {
            let slot = self.bus().slot_of("EXTI").expect("the part has EXTI");
            let (registers, _) = self.part.bus_mut().drive(at, slot);
            registers.set(ExtiRegister::Pr, registers.get(ExtiRegister::Pr) | enabled);
        }
    }

    /// The crystal stops. Answers whether the clock security system was on, which flags it and goes on with the chip's
    /// own oscillator (RM0090 section 7.2.7); its wire to the core's non-maskable interrupt is not modelled.
    pub fn stop_crystal(&mut self, at: VirtualNanos) -> bool {
        self.part.drive_clocks(at, |clocks, registers, context| clocks.fail_hse(registers, context));
        self.register("RCC", map::rcc::INTERRUPTS) & map::rcc::CLOCK_FAILED != 0
    }

    /// Gives the chip so many millivolts. Answers whether its supply monitor asks for its interrupt: the monitor's
    /// output has risen on line 16, where rising edges and requests are let through (RM0090 sections 5.2.2 and 12.2.5).
    /// No model of rigless joins the two.
    ///
    /// # Panics
    ///
    /// When the part has no such controller, which is a bug here.
    pub fn supply(&mut self, at: VirtualNanos, millivolts: u32) -> bool {
        let low = |chip: &Self| chip.register("PWR", map::power::STATUS) & map::power::SUPPLY_LOW != 0;
        let before = low(self);
        self.part.set_supply(millivolts);
        let line = self.register("EXTI", map::exti::RISING) & self.register("EXTI", map::exti::MASK) & (1 << 16);
        if before || !low(self) || line == 0 {
            return false;
        }
        let slot = self.bus().slot_of("EXTI").expect("the part has EXTI");
        let (registers, _) = self.part.bus_mut().drive(at, slot);
        registers.set(ExtiRegister::Pr, registers.get(ExtiRegister::Pr) | line);
        true
    }

    /// Changes a word of the flash as age or radiation would, without the interface; in force when the run goes on.
    ///
    /// # Panics
    ///
    /// When the part has no flash interface, which is a bug here.
    pub fn spoil_flash(&mut self, at: VirtualNanos, address: u64, word: u32) {
        let slot = self.bus().slot_of("FLASH").expect("the part has a flash interface");
        let (_, mut context) = self.part.bus_mut().drive(at, slot);
        context.program(address, Width::W32, u64::from(word), flash::WRITTEN);
    }

    /// The registers of the instance called `name`.
    ///
    /// # Panics
    ///
    /// When the part has no such instance, which is a bug of the caller.
    #[must_use]
    pub fn register(&self, name: &str, offset: u32) -> u64 {
        let bus = self.part.bus();
        let slot = &bus.slots()[bus.slot_of(name).expect("an instance of the part")];
        let row = (slot.peripheral().registers.iter())
            .position(|register| register.offset == offset)
            .expect("a register of the instance");
        slot.registers().get(map::Row(row))
    }
}

fn owner(instance: &str) -> Ours {
    if let Some(block) = OTG_BLOCKS.iter().position(|&name| name == instance) {
        return Ours::Otg(block);
    }
    if let Some(nth) = ADVANCED_TIMERS.iter().position(|timer| timer.instance == instance) {
        return Ours::Advanced(nth);
    }
    if let Some(nth) = CONVERTERS.iter().position(|&name| name == instance) {
        return Ours::Converter(nth);
    }
    match instance {
        "FLASH" => Ours::Flash,
        "EXTI" => Ours::Exti,
        _ => Ours::None,
    }
}

impl Mcu for Chip {
    fn bus(&self) -> &Bus {
        self.part.bus()
    }

    fn bus_mut(&mut self) -> &mut Bus {
        self.part.bus_mut()
    }

    fn reset(&mut self, at: VirtualNanos, cause: ResetCause) {
        self.exchange();
        // Our bus of before, with the count of events that models may still wait for.
        let before = std::mem::replace(&mut self.parked, map::bus(self.part.bus()).expect("described once already"));
        self.part.reset(at, cause);
        self.parked.keep_added(&before).expect("the same description");
        self.exchange();
        self.name_itself(at);
        self.restarts += 1;
        self.otg.chip_reset();
        self.flash = flash::unit();
        for (nth, timer) in self.advanced.iter_mut().enumerate() {
            *timer = trigger::timer(nth);
            timer.hook.begin(at);
        }
        for (nth, converter) in self.converters.iter_mut().enumerate() {
            let mut fresh = trigger::converter(nth);
            fresh.inner.inherit(&converter.inner);
            *converter = fresh;
        }
    }

    fn poll(&mut self, now: VirtualNanos) {
        // The part's own poll asks its serial ports alone, and nothing hangs on those.
        let Self { part, otg, otg_slot, .. } = self;
        let (_, mut context) = part.bus_mut().drive(now, *otg_slot);
        otg.look_outside(&mut context);
    }

    fn split(&mut self, slot: usize) -> (&mut Bus, Option<&mut dyn ErasedDevice>) {
        let Self { part, ours, otg, flash, advanced, converters, .. } = self;
        let model: &mut dyn ErasedDevice = match ours.get(slot) {
            None | Some(Ours::None | Ours::Exti) => return part.split(slot),
            Some(&Ours::Otg(block)) => otg.answering_for(block),
            Some(Ours::Flash) => flash,
            Some(&Ours::Advanced(nth)) => &mut advanced[nth],
            Some(&Ours::Converter(nth)) => &mut converters[nth],
        };
        (part.bus_mut(), Some(model))
    }
}
