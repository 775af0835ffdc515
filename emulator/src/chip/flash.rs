//! The flash array behind rigless' flash interface. Programming clears bits, and erasing sets bits (RM0090 chapter 3).
//!
//! On silicon, code that runs from flash stalls during a sector erase and while a word is programmed. Here the code
//! runs on, and only the busy flag stays set for that time.

use std::collections::VecDeque;

use rigless::device::{DeviceContext, RegisterFile};
use rigless::soc::Width;
use rigless::soc::stm32f427::generated::flash::Register;
use rigless::soc::stm32f427::peripherals::flash::Flash;
use rigless::soc::stm32f427::peripherals::rcc::HSI_HZ;

use super::hook::{Hook, Hooked};
use super::map;

const PG: u64 = 1 << 0;
const SER: u64 = 1 << 1;
const LOCK: u64 = 1 << 31;
const BUSY: u64 = 1 << 16;
/// Token of our own read accesses, different from all tokens of the model.
const READ_TOKEN: u64 = 1 << 62;
/// Token of our own write accesses, different from all tokens of the model.
pub(super) const WRITE_TOKEN: u64 = READ_TOKEN + 1;

/// The flash interface and its array.
pub type FlashUnit = Hooked<Flash, Array>;

/// Returns the flash as after power-on. The array's contents are in memory, which outlives a reset.
#[must_use]
pub fn unit() -> FlashUnit {
    Hooked { inner: Flash::with_clock(HSI_HZ), hook: Array::default() }
}

/// Operations on the array, and a cut of the power during one of them.
#[derive(Debug, Default)]
pub struct Array {
    busy: bool,
    stores: VecDeque<(u64, Width, u64)>,
    /// Sectors that were erased since power-on, in order.
    pub erased: Vec<u64>,
    /// Number of operations (sector erases or programmed words) until the power fails, or `None` for never. The last of
    /// these operations is half done, and no operation after it has an effect. 0 once the power has failed.
    pub operations_until_cut: Option<u64>,
}

impl Array {
    /// Begins an operation. Returns how many of its two halves are done.
    fn begin_operation(&mut self) -> u64 {
        match &mut self.operations_until_cut {
            None => 2,
            Some(0) => 0,
            Some(left) => {
                *left -= 1;
                if *left == 0 { 1 } else { 2 }
            }
        }
    }
}

impl Hook<Flash> for Array {
    fn after_call(&mut self, _: &mut Flash, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let busy = registers.get(Register::Sr) & BUSY != 0;
        let began = busy && !self.busy;
        self.busy = busy;
        let control = registers.get(Register::Cr);
        if began && control & SER != 0 {
            let number = (control >> 3) & 0xF;
            let (start, size) = map::sector(number);
            for offset in (0..size / 2 * self.begin_operation()).step_by(8) {
                context.program(start + offset, Width::W64, u64::MAX, WRITE_TOKEN);
            }
            self.erased.push(number);
        }
    }

    fn handle_reply(&mut self, token: u64, value: u64, context: &mut DeviceContext<'_>) -> bool {
        if token == READ_TOKEN
            && let Some((address, width, wanted)) = self.stores.pop_front()
        {
            context.program(address, width, value & wanted, WRITE_TOKEN);
        }
        token == READ_TOKEN || token == WRITE_TOKEN
    }

    fn handle_store(
        &mut self,
        store: (u64, Width, u64),
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> bool {
        let control = registers.get(Register::Cr);
        if control & PG != 0 && control & LOCK == 0 {
            let (address, width, value) = store;
            let kept_bits = match self.begin_operation() {
                2 => 0,
                1 => u64::MAX << (4 * width.bytes()),
                _ => u64::MAX,
            };
            self.stores.push_back((address, width, value | kept_bits));
            context.read_from(address, width, READ_TOKEN);
        }
        true
    }
}
