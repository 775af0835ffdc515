//! Counts the instructions between the markers of a counting image on the emulated chip, exactly and equally in each
//! run.
//!
//! The image is any ELF file for the chip with these symbols. They need `#[unsafe(no_mangle)]`, `#[inline(never)]` and
//! different bodies, because the linker merges equal functions.
//!
//! | symbol | what it is |
//! |---|---|
//! | `bench_begin`, `bench_end` | functions called immediately before and after the counted code |
//! | `bench_done` | a function called once, at the end |
//! | `BENCH_NAME` | a `[u32; 2]`, address and length of the variant's name (a `&'static str`), written before `bench_begin` |
//!
//! Inputs and outputs between the markers must pass through `core::hint::black_box`, because the compiler may move
//! other work outside: `bench_begin(); let y = black_box(f(black_box(x))); bench_end();`.
//!
//! The count of a call goes from the entry of `bench_begin` to the entry of `bench_end`. The variant `empty` has
//! nothing between the markers. Its count, the cost of the markers, is subtracted from the other variants. Variants are
//! reported in the order of their first call, each with its longest call.

use std::fmt::Display;

use rigless::emulator::{self, Driver, Hit, Host, Settled, Start, Stop, Watch};
use rigless::session::Session;
use rigless::soc::Width;
use rigless::time::VirtualNanos;

use crate::hardware::Hardware;
use crate::image::{Firmware, Symbol};

/// Runs `firmware` until it calls `bench_done`, for at most `seconds` of virtual time. Returns the name of every
/// variant and the instructions of its longest call.
/// Returns an error if the image has no markers or does not finish.
pub fn count(firmware: &Firmware, seconds: u64) -> Result<Vec<(String, u64)>, String> {
    let driver = Counter {
        begin_address: firmware.symbol("bench_begin")?.address,
        end_address: firmware.symbol("bench_end")?.address,
        done_address: firmware.symbol("bench_done")?.address,
        name: firmware.symbol("BENCH_NAME")?,
        deadline: VirtualNanos(seconds * 1_000_000_000),
        watches_are_set: false,
        open_call: None,
        is_finished: false,
        violation: None,
        variants: Vec::new(),
    };
    let emulator = |error: &dyn Display| format!("the emulator stopped: {error}");
    let hardware = Hardware::without_board().map_err(|error| emulator(&error))?;
    // Watches can be set only while the emulator is stopped, so the first stop is after 1 ns.
    let session = Session::new(Box::new(hardware), 0, VirtualNanos(1)).map_err(|error| emulator(&error))?;
    let images = [firmware.image().map_err(|error| emulator(&error))?];
    let finished = emulator::run(session, &Start::new(&images), driver).map_err(|error| emulator(&error))?;
    let Counter { violation, is_finished, mut variants, .. } = finished.driver;
    if let Some(reason) = violation {
        return Err(format!("the image breaks the marker convention: {reason}"));
    }
    if !is_finished {
        return Err(format!("bench_done was not reached in {seconds} virtual seconds: did the image panic?"));
    }
    if let Some(empty) = variants.iter().position(|(name, _)| name == "empty") {
        let (_, markers) = variants.remove(empty);
        variants.iter_mut().for_each(|(_, instructions)| *instructions = instructions.saturating_sub(markers));
    }
    Ok(variants)
}

struct Counter {
    begin_address: u64,
    end_address: u64,
    done_address: u64,
    name: Symbol,
    deadline: VirtualNanos,
    watches_are_set: bool,
    open_call: Option<(String, u64)>,
    is_finished: bool,
    violation: Option<&'static str>,
    /// Name of each variant, and the instructions of its longest call including the markers.
    variants: Vec<(String, u64)>,
}

impl Counter {
    fn on_hit(&mut self, hit: Hit, host: &mut dyn Host) {
        if hit.address == self.begin_address {
            match variant_name(self.name, host) {
                Some(name) => self.open_call = Some((name, hit.instruction_count)),
                None => self.violation = Some("BENCH_NAME does not point at text"),
            }
        } else if hit.address == self.end_address {
            let Some((name, from)) = self.open_call.take() else {
                self.violation = Some("bench_end without bench_begin");
                return;
            };
            let instructions = hit.instruction_count - from;
            match self.variants.iter_mut().find(|(other, _)| *other == name) {
                Some((_, longest)) => *longest = instructions.max(*longest),
                None => self.variants.push((name, instructions)),
            }
        } else if hit.address == self.done_address {
            self.is_finished = true;
        }
    }
}

impl Driver<Hardware> for Counter {
    fn on_settled(&mut self, session: &mut Session<Hardware>, host: &mut dyn Host, settled: Settled) {
        if let Settled::Hit(hit) = settled {
            self.on_hit(hit, host);
            if self.is_finished || self.violation.is_some() {
                session.run_until(hit.at);
            }
        }
    }

    fn on_stop(&mut self, session: &mut Session<Hardware>, stop: Stop, _host: &mut dyn Host) -> Option<VirtualNanos> {
        if !self.watches_are_set {
            self.watches_are_set = true;
            for address in [self.begin_address, self.end_address, self.done_address] {
                session.watch(Watch::Instruction(address));
            }
        }
        let over = self.is_finished || self.violation.is_some() || stop.at >= self.deadline;
        (!over).then_some(self.deadline)
    }
}

fn word(host: &mut dyn Host, address: u64) -> u32 {
    host.read(address, Width::W32).map_or(0, |value| value as u32)
}

fn variant_name(at: Symbol, host: &mut dyn Host) -> Option<String> {
    let (start, length) = (word(host, at.address), word(host, at.address + 4));
    let bytes: Option<Vec<u8>> = (0..length.min(256))
        .map(|n| host.read(u64::from(start) + u64::from(n), Width::W8).ok().map(|byte| byte as u8))
        .collect();
    String::from_utf8(bytes?).ok()
}
