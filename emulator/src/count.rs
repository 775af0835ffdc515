//! Counts the instructions between the markers of a counting image on the emulated chip. The counts are exact and equal
//! on every run.
//!
//! The image is any ELF file for the chip with these symbols (`#[unsafe(no_mangle)]`, `#[inline(never)]`, and bodies
//! that differ from each other, because the linker merges equal functions):
//!
//! | symbol | what it is |
//! |---|---|
//! | `bench_begin`, `bench_end` | functions called immediately before and after the counted code |
//! | `bench_done` | a function called once, at the end |
//! | `BENCH_NAME` | a `[u32; 2]`, address and length of the variant's name (a `&'static str`), written before `bench_begin` |
//! | `BENCH_RESULT` | optional, words written before `bench_end`, reported bit for bit (f32 as its bits) |
//!
//! Pass inputs and outputs between the markers through `core::hint::black_box`, because the compiler may move other
//! work outside: `bench_begin(); let y = black_box(f(black_box(x))); bench_end();`.
//!
//! A call of a variant counts the instructions from entering `bench_begin` to entering `bench_end`. The variant `empty`
//! (nothing between the markers) gives the cost of the markers, which is subtracted from the other variants. Variants
//! are reported in the order of their first call; several calls with different inputs give minimum, maximum and mean.

use std::collections::BTreeMap;
use std::fmt;

use rigless::emulator::{self, Driver, Hit, Host, Settled, Start, Stop, Watch};
use rigless::session::Session;
use rigless::soc::Width;
use rigless::time::VirtualNanos;

use crate::hardware::Hardware;
use crate::image::{self, Firmware, Symbol};

/// Counts of one variant.
#[derive(Clone, Debug, PartialEq)]
pub struct Variant {
    /// Name of the variant in the image.
    pub name: String,
    /// Instructions of each call without the markers, in call order.
    pub instructions: Vec<u64>,
    /// `BENCH_RESULT` at the end of each call, in call order; empty if the image has none.
    pub results: Vec<Vec<u32>>,
}

impl Variant {
    /// Returns the smallest number of instructions of all calls.
    #[must_use]
    pub fn min(&self) -> u64 {
        self.instructions.iter().copied().min().unwrap_or(0)
    }

    /// Returns the largest number of instructions of all calls.
    #[must_use]
    pub fn max(&self) -> u64 {
        self.instructions.iter().copied().max().unwrap_or(0)
    }

    /// Returns the mean over all calls.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.instructions.iter().sum::<u64>() as f64 / self.instructions.len().max(1) as f64
    }
}

/// Reason why an image could not be counted.
#[derive(Debug)]
pub enum Error {
    /// The image does not exist or lacks a marker.
    Image(image::Error),
    /// The emulator rejected the image or stopped.
    Emulator(String),
    /// The image did not reach `bench_done` within this number of virtual seconds.
    NeverDone(u64),
    /// The image broke the convention: an end without a begin, or a name that is not text.
    Markers(&'static str),
}

impl fmt::Display for Error {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Image(error) => write!(out, "{error}"),
            Self::Emulator(error) => write!(out, "the emulator stopped: {error}"),
            Self::NeverDone(seconds) => {
                write!(out, "bench_done was not reached in {seconds} virtual seconds: did the image panic?")
            }
            Self::Markers(what) => write!(out, "the image breaks the marker convention: {what}"),
        }
    }
}

impl std::error::Error for Error {}

impl From<image::Error> for Error {
    fn from(error: image::Error) -> Self {
        Self::Image(error)
    }
}

/// Runs `firmware` until it calls `bench_done`, at most `seconds` of virtual time, and counts every variant.
///
/// # Errors
///
/// If the image has no markers or does not finish.
pub fn count(firmware: &Firmware, seconds: u64) -> Result<Vec<Variant>, Error> {
    let driver = Counter {
        begin: firmware.symbol("bench_begin")?.address,
        end: firmware.symbol("bench_end")?.address,
        done: firmware.symbol("bench_done")?.address,
        name: firmware.symbol("BENCH_NAME")?,
        result: firmware.find("BENCH_RESULT"),
        until: VirtualNanos(seconds * 1_000_000_000),
        armed: false,
        open: None,
        finished: false,
        broken: None,
        order: Vec::new(),
        variants: BTreeMap::new(),
    };
    let emulator = |error: &dyn fmt::Display| Error::Emulator(error.to_string());
    let hardware = Hardware::bare().map_err(|error| emulator(&error))?;
    // Watches can be set only at a stop, so the first stop comes at once.
    let session = Session::new(Box::new(hardware), 0, VirtualNanos(1)).map_err(|error| emulator(&error))?;
    let images = [firmware.image().map_err(|error| emulator(&error))?];
    let finished = emulator::run(session, &Start::new(&images), driver).map_err(|error| emulator(&error))?;
    finished.driver.report(seconds)
}

struct Counter {
    begin: u64,
    end: u64,
    done: u64,
    name: Symbol,
    result: Option<Symbol>,
    until: VirtualNanos,
    armed: bool,
    open: Option<(String, u64)>,
    finished: bool,
    broken: Option<&'static str>,
    order: Vec<String>,
    variants: BTreeMap<String, Variant>,
}

impl Counter {
    fn report(mut self, seconds: u64) -> Result<Vec<Variant>, Error> {
        if let Some(what) = self.broken {
            return Err(Error::Markers(what));
        }
        if !self.finished {
            return Err(Error::NeverDone(seconds));
        }
        let overhead = self.variants.get("empty").map_or(0, Variant::min);
        Ok(self
            .order
            .iter()
            .filter_map(|name| self.variants.remove(name))
            .map(|mut variant| {
                if variant.name != "empty" {
                    for count in &mut variant.instructions {
                        *count = count.saturating_sub(overhead);
                    }
                }
                variant
            })
            .collect())
    }

    fn on_hit(&mut self, hit: Hit, host: &mut dyn Host) {
        if hit.address == self.begin {
            match variant_name(self.name, host) {
                Some(name) => self.open = Some((name, hit.instruction_count)),
                None => self.broken = Some("BENCH_NAME does not point at text"),
            }
        } else if hit.address == self.end {
            let Some((name, from)) = self.open.take() else {
                self.broken = Some("bench_end without bench_begin");
                return;
            };
            if !self.variants.contains_key(&name) {
                self.order.push(name.clone());
            }
            let variant = self.variants.entry(name.clone()).or_insert(Variant {
                name,
                instructions: Vec::new(),
                results: Vec::new(),
            });
            variant.instructions.push(hit.instruction_count - from);
            if let Some(result) = self.result {
                let words = result.size / 4;
                variant.results.push((0..words).map(|n| word(host, result.address + 4 * n)).collect());
            }
        } else if hit.address == self.done {
            self.finished = true;
        }
    }
}

impl Driver<Hardware> for Counter {
    fn on_settled(&mut self, session: &mut Session<Hardware>, host: &mut dyn Host, settled: Settled) {
        if let Settled::Hit(hit) = settled {
            self.on_hit(hit, host);
            if self.finished || self.broken.is_some() {
                session.run_until(hit.at);
            }
        }
    }

    fn on_stop(&mut self, session: &mut Session<Hardware>, stop: Stop, _host: &mut dyn Host) -> Option<VirtualNanos> {
        if !self.armed {
            self.armed = true;
            for address in [self.begin, self.end, self.done] {
                session.watch(Watch::Instruction(address));
            }
        }
        let over = self.finished || self.broken.is_some() || stop.at >= self.until;
        (!over).then_some(self.until)
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
