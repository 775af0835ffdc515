//! Times an interrupt handler in instructions: from its first instruction to its last, every run of it.
//!
//! The last instruction is found, not assumed: every halfword of the handler that can be a return (`bx lr`, `pop {…, pc}`,
//! `ldmia.w sp!, {…, pc}`) is watched. A handler whose compiler made it end in a jump to another function cannot be timed
//! this way, and is refused. Time in interrupts that preempt the handler would count too; the control interrupt has
//! the highest priority, so there are none.

use rigless::emulator::Hit;

use crate::image::Firmware;
use crate::run::Bench;

/// A handler under the clock.
#[derive(Clone, Debug)]
pub struct Handler {
    entry: u64,
    returns: Vec<u64>,
}

/// One run of a handler.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Run {
    /// Virtual nanoseconds at its first instruction.
    pub at: u64,
    /// Instructions, first and last included.
    pub instructions: u64,
}

impl Handler {
    /// The handler that the vector table calls `name`, or `None` when the image has none.
    #[must_use]
    pub fn find(firmware: &Firmware, name: &str) -> Option<Self> {
        let symbol = firmware.find(name)?;
        let code = firmware.code(symbol)?;
        let halfwords: Vec<u16> = code.chunks_exact(2).map(|two| u16::from_le_bytes([two[0], two[1]])).collect();
        let returns = (0..halfwords.len())
            .filter(|&nth| match halfwords[nth] {
                0x4770 => true,
                pop if pop & 0xFF00 == 0xBD00 => true,
                0xE8BD => halfwords.get(nth + 1).is_some_and(|list| list & 0x8000 != 0),
                _ => false,
            })
            .map(|nth| symbol.address + 2 * nth as u64)
            .collect();
        Some(Self { entry: symbol.address, returns })
    }

    /// Starts the clock.
    pub fn watch(&self, bench: &mut Bench<'_>) {
        bench.watch(self.entry);
        for &address in &self.returns {
            bench.watch(address);
        }
    }

    /// Stops the clock.
    pub fn unwatch(&self, bench: &mut Bench<'_>) {
        bench.unwatch(self.entry);
        for &address in &self.returns {
            bench.unwatch(address);
        }
    }

    /// The whole runs among `hits`.
    ///
    /// # Panics
    ///
    /// When a run has no end: the handler leaves in a way this does not know.
    #[must_use]
    pub fn runs(&self, hits: &[Hit]) -> Vec<Run> {
        let mut runs = Vec::new();
        let mut open: Option<&Hit> = None;
        for hit in hits {
            if hit.address == self.entry {
                assert!(open.is_none(), "the handler at {:#x} has an end that is no return", self.entry);
                open = Some(hit);
            } else if self.returns.contains(&hit.address)
                && let Some(began) = open.take()
            {
                let instructions = hit.instruction_count - began.instruction_count + 1;
                runs.push(Run { at: began.at.0, instructions });
            }
        }
        runs
    }
}
