//! Memory map of the STM32F405, and the bus of its peripherals (RM0090 rev 22, section 2.3, tables 5, 43 and 63).

use std::num::{NonZeroU32, NonZeroU64};

use rigless::soc::stm32f427::peripherals::{ADC_COMMON, ADVANCED_TIMERS, CONTROLLERS, CONVERTERS, SERIAL_INTERFACES};
use rigless::soc::stm32f427::{CPU, builder};
use rigless::soc::{
    Access, Bus, EraseBlocks, Error, Gate, Layout, Peripheral, ReadAction, Region, RegisterSpec, Width, WriteModify,
};

use super::OTG_BLOCKS;

/// Flash with twelve sectors (table 5), core-coupled RAM, system memory, SRAM1 and SRAM2, and backup SRAM.
pub static MEMORY: [Region; 5] = [
    Region::flash("flash", 0x0800_0000, 1 << 20).erased_in(&SECTORS).erased_to(0xFF).programmed_by("FLASH"),
    Region::ram("ccm", 0x1000_0000, 64 << 10),
    Region::system("system", 0x1FFF_0000, 32 << 10),
    Region::ram("sram", 0x2000_0000, 128 << 10),
    Region::ram("backup_sram", 0x4002_4000, 4 << 10),
];

static SECTORS: [EraseBlocks; 3] = [blocks(4, 16), blocks(1, 64), blocks(7, 128)];

const fn blocks(count: u32, kib: u64) -> EraseBlocks {
    EraseBlocks {
        count: NonZeroU32::new(count).expect("not zero"),
        size: NonZeroU64::new(kib << 10).expect("not zero"),
    }
}

/// Returns the first address and the size (bytes) of the flash sector `number`, 0 to 11.
#[must_use]
pub const fn sector(number: u64) -> (u64, u64) {
    const KIB: u64 = 1 << 10;
    let (offset, size) = match number {
        0..=3 => (number * 16 * KIB, 16 * KIB),
        4 => (64 * KIB, 64 * KIB),
        _ => ((number - 4) * 128 * KIB, 128 * KIB),
    };
    (0x0800_0000 + offset, size)
}

/// Reset bits that our drivers use (sections 6.3.5 to 6.3.9).
const RESET_LINES: [(&str, &str, &str); 15] = [
    ("ADC1", "APB2RSTR", "ADCRST"),
    ("ADC2", "APB2RSTR", "ADCRST"),
    ("ADC3", "APB2RSTR", "ADCRST"),
    ("C_ADC", "APB2RSTR", "ADCRST"),
    ("TIM1", "APB2RSTR", "TIM1RST"),
    ("TIM8", "APB2RSTR", "TIM8RST"),
    ("TIM2", "APB1RSTR", "TIM2RST"),
    ("TIM3", "APB1RSTR", "TIM3RST"),
    ("TIM4", "APB1RSTR", "TIM4RST"),
    ("TIM5", "APB1RSTR", "TIM5RST"),
    ("SPI3", "APB1RSTR", "SPI3RST"),
    ("DMA1", "AHB1RSTR", "DMA1RST"),
    ("DMA2", "AHB1RSTR", "DMA2RST"),
    ("OTG_FS_GLOBAL", "AHB2RSTR", "OTGFSRST"),
    ("PWR", "APB1RSTR", "PWRRST"),
];

/// Returns a bus of our description. Its slots have the order of `stock`, the bus that rigless builds.
/// Returns any error of [`rigless::soc::Builder::build`], which is a bug in the description.
pub fn bus(stock: &Bus) -> Result<Bus, Error> {
    // Clocks and request readers come from the stock description. Tables, gates and corrections come with the slots
    // that `Chip` moves to this bus.
    let described = builder().build()?;
    let peripherals: Vec<Peripheral> = stock.peripherals().map(with_our_tables).collect();
    let mut builder = Bus::builder(CPU, &MEMORY, peripherals);
    for peripheral in described.peripherals() {
        if let Some(clock) = described.clock_of(peripheral.name) {
            builder = builder.clocked_by(peripheral.name, clock);
        }
    }
    for (instance, register, field) in RESET_LINES {
        builder = builder.reset_by(instance, Gate::by("RCC", register, field));
    }
    let timers = ADVANCED_TIMERS.iter().map(|timer| timer.instance);
    let controllers = CONTROLLERS.iter().map(|controller| controller.instance);
    let readers = ["RTC", "RCC", ADC_COMMON].into_iter();
    for instance in readers.chain(SERIAL_INTERFACES).chain(CONVERTERS).chain(timers).chain(controllers) {
        builder = builder.reads_requests(instance);
    }
    builder.build()
}

fn with_our_tables(stock: &Peripheral) -> Peripheral {
    if stock.name == "EXTI" {
        return Peripheral { registers: &exti::TABLE, ..*stock };
    }
    match OTG_BLOCKS.iter().position(|&name| name == stock.name) {
        Some(block) => Peripheral { registers: otg_table(block), interrupts: &[OTG_LINE], ..*stock },
        None => *stock,
    }
}

/// Interrupt number of the USB core (table 63).
const OTG_LINE: u16 = 67;

/// Returns the register table of a block of the USB core from plain words, which [`super::otg`] implements.
#[must_use]
pub fn otg_table(block: usize) -> &'static [RegisterSpec] {
    static GLOBAL: [RegisterSpec; 256] = words();
    static HOST: [RegisterSpec; 256] = words();
    static DEVICE: [RegisterSpec; 384] = words();
    static POWER: [RegisterSpec; 17] = power();
    match block {
        0 => &GLOBAL,
        1 => &HOST,
        2 => &DEVICE,
        _ => &POWER,
    }
}

const fn word(offset: u32) -> RegisterSpec {
    RegisterSpec {
        name: "OTG_FS",
        offset,
        width: Width::W32,
        reset: 0,
        access: Access::ReadWrite,
        read: ReadAction::None,
        write: WriteModify::None,
        fields: &[],
    }
}

const fn words<const N: usize>() -> [RegisterSpec; N] {
    let mut table = [word(0); N];
    let mut row = 0;
    while row < N {
        table[row] = word(4 * row as u32);
        row += 1;
    }
    table
}

/// The external interrupt controller. A flag is cleared by writing 1, which the vendor's file does not describe.
pub mod exti {
    use super::{RegisterSpec, WriteModify};

    /// Offset of IMR, the lines whose interrupt request is enabled.
    pub const IMR: u32 = 0x00;
    /// Offset of RTSR, the lines that react to a rising edge.
    pub const RTSR: u32 = 0x08;

    pub(super) static TABLE: [RegisterSpec; 6] = [
        register("IMR", IMR, WriteModify::None),
        register("EMR", 0x04, WriteModify::None),
        register("RTSR", RTSR, WriteModify::None),
        register("FTSR", 0x0C, WriteModify::None),
        register("SWIER", 0x10, WriteModify::None),
        register("PR", 0x14, WriteModify::OneToClear),
    ];

    const fn register(name: &'static str, offset: u32, write: WriteModify) -> RegisterSpec {
        RegisterSpec { name, write, ..super::word(offset) }
    }
}

/// Registers of the clock controller (RM0090 section 7.3.4).
pub mod rcc {
    /// Offset of CIR.
    pub const INTERRUPTS: u32 = 0x0C;
    /// CSSF bit: the crystal failed.
    pub const CLOCK_FAILED: u64 = 1 << 7;
}

/// Registers of the power controller (section 5.4.2).
pub mod power {
    /// Offset of CSR.
    pub const STATUS: u32 = 0x04;
    /// PVDO bit: the supply is below the monitor's level.
    pub const SUPPLY_LOW: u64 = 1 << 2;
}

/// Returns the table with the power and clock gating register and the first word of each endpoint's FIFO window.
const fn power() -> [RegisterSpec; 17] {
    let mut table = [word(0); 17];
    let mut row = 1;
    while row < table.len() {
        table[row] = word(0x200 + 0x1000 * (row as u32 - 1));
        row += 1;
    }
    table
}

/// Row of a register in its instance's table, to read a register without its layout type.
#[derive(Clone, Copy, Debug)]
pub struct Row(pub usize);

impl Layout for Row {
    const REGISTERS: &'static [RegisterSpec] = &[];
    fn from_index(index: usize) -> Option<Self> {
        Some(Self(index))
    }
    fn index(self) -> usize {
        self.0
    }
}
