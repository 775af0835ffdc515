//! The board around the chip: the crystal, the rail and the core's configuration.

use std::num::{NonZeroU32, NonZeroU64};

use rigless::machine::{Board, Target, armv7m};
use rigless::mcu::{Mcu, Operate};
use rigless::snapshot::Store;
use rigless::time::VirtualNanos;

use crate::chip::Chip;

/// Instructions a second of virtual time: 168 MHz at two cycles an instruction, the middle of the 1.9 to 2.3 that a
/// cycle estimate of a control step gives on a Cortex-M4F with flash wait states hidden.
pub const INSTRUCTIONS_PER_SECOND: NonZeroU64 = NonZeroU64::new(84_000_000).expect("not zero");

/// The 8 MHz crystal of both boards.
const CRYSTAL_HZ: u64 = 8_000_000;
/// The rail of both boards, in millivolts.
const RAIL_MV: u32 = 3300;

/// VREF+ in microvolts: the converters' inputs are set in that unit, since rigless' millivolts are coarser than a bit.
pub const REFERENCE_UV: u32 = 3_300_000;

/// A board with one STM32F405 on it.
#[derive(Debug)]
pub struct Hardware {
    /// The microcontroller.
    pub chip: Chip,
}

impl Hardware {
    /// The chip out of power-on with its crystal and its rail.
    ///
    /// # Errors
    ///
    /// A wrong description of the part, which is a bug here.
    pub fn new() -> Result<Self, rigless::soc::Error> {
        let mut chip = Chip::new()?;
        chip.rcc.attach_crystals(CRYSTAL_HZ, 0);
        chip.set_supply(RAIL_MV);
        Ok(Self { chip })
    }

    /// What happens on the board at a stop at `at`, and when it needs the next one.
    pub fn step(&mut self, _at: VirtualNanos) -> Option<VirtualNanos> {
        None
    }
}

/// No snapshots: a run starts at power-on.
impl Store for Hardware {}

impl Board for Hardware {
    fn name(&self) -> &'static str {
        "virtual-board"
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
