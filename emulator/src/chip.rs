//! The microcontroller: rigless' model of the STM32F427, changed to the STM32F405 of the boards.
//!
//! The core, RCC, PWR, GPIO, timers, converters, SPI, DMA and watchdog are those of rigless. Our models replace the
//! memory sizes, the contents of the flash array ([`flash`]), the USB core in device mode ([`otg`]), and the
//! connections from timer triggers to converters and from TIM1 to TIM8 ([`trigger`]).
//!
//! rigless builds its part with its own bus. The part then runs on a bus of *our* description ([`map`]), which holds
//! the part's own slots in the same order. Before a system reset, the part gets its original bus back.

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

/// Names of the blocks of the USB core in the vendor's file, in address order.
pub const OTG_BLOCKS: [&str; 4] = ["OTG_FS_GLOBAL", "OTG_FS_HOST", "OTG_FS_DEVICE", "OTG_FS_PWRCLK"];

/// Our model that replaces the part's model in a slot of the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum OwnModel {
    None,
    Otg(usize),
    Flash,
    /// Our register table, without a model.
    Exti,
    Advanced(usize),
    Converter(usize),
}

/// An STM32F405.
#[derive(Debug)]
pub struct Chip {
    part: Stm32f427,
    /// Bus that the part was built with, without its slots.
    inactive_bus: Bus,
    own_models: Vec<OwnModel>,
    otg_slot: usize,
    /// Number of restarts so far.
    pub restarts: u64,
    /// The USB core and the computer at the cable's other end.
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
    /// Returns the chip after power-on, with unconnected pins.
    /// Returns an error if the description of the part is wrong, which is a bug in this crate.
    pub fn new() -> Result<Self, Error> {
        let part = Stm32f427::new()?;
        let bus = map::bus(part.bus())?;
        let bus_slot = bus.slot(OTG_BLOCKS[0])?;
        let own_models = bus.slots().iter().map(|slot| find_own_model(slot.peripheral().name)).collect();
        let mut chip = Self {
            part,
            inactive_bus: bus,
            otg_slot: bus_slot,
            own_models,
            restarts: 0,
            otg: Otg::default(),
            flash: flash::unit(),
            advanced: std::array::from_fn(trigger::timer),
            converters: std::array::from_fn(trigger::converter),
        };
        chip.swap_buses();
        chip.check()?;
        chip.set_device_id(VirtualNanos(0));
        Ok(chip)
    }

    /// Sets the identity that programs read to STM32F405, revision Y (RM0090 section 38.6.1).
    fn set_device_id(&mut self, at: VirtualNanos) {
        let slot = self.bus().slot_of("DBG").expect("the part has a debug component");
        let (registers, _) = self.part.bus_mut().drive(at, slot);
        registers.set(DebugRegister::DbgmcuIdcode, 0x100F_6413);
    }

    /// Swaps the active bus with the inactive bus. The slots of the part's own models move to the new active bus.
    fn swap_buses(&mut self) {
        let Self { part, inactive_bus, own_models, .. } = self;
        for (index, owner) in own_models.iter().enumerate() {
            if !matches!(owner, OwnModel::Otg(_) | OwnModel::Exti) {
                std::mem::swap(inactive_bus.slot_mut(index), part.bus_mut().slot_mut(index));
            }
        }
        std::mem::swap(inactive_bus, part.bus_mut());
    }

    /// Returns the bus and the advanced timers separately, so that a timer's input can be driven.
    pub fn bus_and_timers(&mut self) -> (&mut Bus, &mut [MasterTimer]) {
        (self.part.bus_mut(), &mut self.advanced)
    }

    /// Applies a rising edge to pin `line` of port `port` (0 for A). rigless does not model the edge. It is latched if
    /// the firmware selected the port for the line (SYSCFG) and enabled rising edges and the request (RM0090 12.3).
    pub fn apply_rising_edge(&mut self, at: VirtualNanos, port: usize, line: u32) {
        let selected = self.register("SYSCFG", 0x08 + 4 * (line / 4)) >> (4 * (line % 4)) & 0xF;
        let enabled = self.register("EXTI", map::exti::RTSR) & self.register("EXTI", map::exti::IMR) & (1 << line);
        if selected == port as u64 && enabled != 0 {
            let slot = self.bus().slot_of("EXTI").expect("the part has EXTI");
            let (registers, _) = self.part.bus_mut().drive(at, slot);
            registers.set(ExtiRegister::Pr, registers.get(ExtiRegister::Pr) | enabled);
        }
    }

    /// Stops the crystal. Returns true if the clock security system was on. This system then sets its flag and switches
    /// to the internal oscillator (RM0090 section 7.2.7). Its non-maskable interrupt is not modelled.
    pub fn stop_crystal(&mut self, at: VirtualNanos) -> bool {
        self.part.drive_clocks(at, |clocks, registers, context| clocks.fail_hse(registers, context));
        self.register("RCC", map::rcc::INTERRUPTS) & map::rcc::CLOCK_FAILED != 0
    }

    /// Sets the chip's supply voltage. Returns true if the supply monitor requests its interrupt, which rigless does
    /// not model. The request needs a rising edge on line 16 that is enabled (RM0090 5.2.2 and 12.2.5).
    pub fn set_supply_voltage(&mut self, at: VirtualNanos, millivolts: u32) -> bool {
        let low = |chip: &Self| chip.register("PWR", map::power::STATUS) & map::power::SUPPLY_LOW != 0;
        let before = low(self);
        self.part.set_supply(millivolts);
        let line = self.register("EXTI", map::exti::RTSR) & self.register("EXTI", map::exti::IMR) & (1 << 16);
        if before || !low(self) || line == 0 {
            return false;
        }
        let slot = self.bus().slot_of("EXTI").expect("the part has EXTI");
        let (registers, _) = self.part.bus_mut().drive(at, slot);
        registers.set(ExtiRegister::Pr, registers.get(ExtiRegister::Pr) | line);
        true
    }

    /// Changes a word of the flash directly, like age or radiation. The change takes effect when the run continues.
    pub fn corrupt_flash(&mut self, at: VirtualNanos, address: u64, word: u32) {
        let slot = self.bus().slot_of("FLASH").expect("the part has a flash interface");
        let (_, mut context) = self.part.bus_mut().drive(at, slot);
        context.program(address, Width::W32, u64::from(word), flash::WRITE_TOKEN);
    }

    /// Returns the register at `offset` of the instance `name`.
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

/// Returns our model for an instance of the part, by its name.
fn find_own_model(instance: &str) -> OwnModel {
    if let Some(block) = OTG_BLOCKS.iter().position(|&name| name == instance) {
        return OwnModel::Otg(block);
    }
    if let Some(nth) = ADVANCED_TIMERS.iter().position(|timer| timer.instance == instance) {
        return OwnModel::Advanced(nth);
    }
    if let Some(nth) = CONVERTERS.iter().position(|&name| name == instance) {
        return OwnModel::Converter(nth);
    }
    match instance {
        "FLASH" => OwnModel::Flash,
        "EXTI" => OwnModel::Exti,
        _ => OwnModel::None,
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
        self.swap_buses();
        // Our previous bus, with the count of events for which models may still wait.
        let before = std::mem::replace(&mut self.inactive_bus, map::bus(self.part.bus()).expect("a valid description"));
        self.part.reset(at, cause);
        self.inactive_bus.keep_added(&before).expect("the same description");
        self.swap_buses();
        self.set_device_id(at);
        self.restarts += 1;
        self.otg.chip_reset();
        self.flash = flash::unit();
        for (nth, timer) in self.advanced.iter_mut().enumerate() {
            *timer = trigger::timer(nth);
            timer.hook.start_counting(at);
        }
        for (nth, converter) in self.converters.iter_mut().enumerate() {
            let mut fresh = trigger::converter(nth);
            fresh.inner.inherit(&converter.inner);
            *converter = fresh;
        }
    }

    fn poll(&mut self, now: VirtualNanos) {
        // The part's own poll is not needed because it serves only serial ports, which are not connected.
        let Self { part, otg, otg_slot, .. } = self;
        let (_, mut context) = part.bus_mut().drive(now, *otg_slot);
        otg.update_host(&mut context);
    }

    fn split(&mut self, slot: usize) -> (&mut Bus, Option<&mut dyn ErasedDevice>) {
        let Self { part, own_models, otg, flash, advanced, converters, .. } = self;
        let model: &mut dyn ErasedDevice = match own_models.get(slot) {
            None | Some(OwnModel::None | OwnModel::Exti) => return part.split(slot),
            Some(&OwnModel::Otg(block)) => otg.model_of_block(block),
            Some(OwnModel::Flash) => flash,
            Some(&OwnModel::Advanced(nth)) => &mut advanced[nth],
            Some(&OwnModel::Converter(nth)) => &mut converters[nth],
        };
        (part.bus_mut(), Some(model))
    }
}
