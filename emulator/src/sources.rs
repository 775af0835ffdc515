//! Finds the source functions and source files of an image's instructions in its debug information.
//!
//! The compiler inlines most of the control interrupt into a few functions. The debug information of the unmodified
//! image names the source functions of every instruction.

use std::collections::HashMap;

use addr2line::Context;
use addr2line::gimli::{Dwarf, EndianSlice, LittleEndian};
use object::{Object as _, ObjectSection as _};

use crate::image::Firmware;
use crate::trace::Run;

/// Function that runs at every crest and at no valley.
const CREST_FUNCTION: &str = "::update_counts";
/// Function that runs only if a task has sent a request.
const REQUEST_FUNCTION: &str = "InterruptState::carry_out";
/// Function in which the interrupt only waits for the converters.
const WAIT_FUNCTION: &str = "adc::wait";

type Reader<'a> = EndianSlice<'a, LittleEndian>;

#[derive(Debug, Default)]
struct Source {
    /// Paths of the instruction's functions, innermost first, without generic arguments.
    functions: Vec<String>,
    /// Innermost source file of this repository.
    file: Option<String>,
}

/// Finds the source of instructions.
pub struct Sources<'a> {
    context: Context<Reader<'a>>,
    cache: HashMap<u32, Source>,
}

impl<'a> Sources<'a> {
    /// Reads the debug information of `firmware`. Returns `None` if there is none or it cannot be read.
    #[must_use]
    pub fn new(firmware: &'a Firmware) -> Option<Self> {
        let elf = object::File::parse(firmware.bytes()).ok()?;
        let load = |id: addr2line::gimli::SectionId| -> Result<Reader<'a>, addr2line::gimli::Error> {
            let data = elf.section_by_name(id.name()).and_then(|section| section.data().ok());
            Ok(Reader::new(data.unwrap_or(&[]), LittleEndian))
        };
        let context = Context::from_dwarf(Dwarf::load(load).ok()?).ok()?;
        Some(Self { context, cache: HashMap::new() })
    }

    fn source(&mut self, address: u32) -> &Source {
        self.cache.entry(address).or_insert_with(|| {
            let mut source = Source::default();
            if let Ok(mut frames) = self.context.find_frames(u64::from(address)).skip_all_loads() {
                while let Ok(Some(frame)) = frames.next() {
                    let name = frame
                        .function
                        .and_then(|function| function.demangle().ok().map(|name| without_generics(&name)));
                    source.functions.extend(name);
                    // xtask/src/toolchain.rs replaces the path of the repository by `..`.
                    let file = frame.location.and_then(|location| location.file?.strip_prefix("../"));
                    source.file = source.file.take().or(file.map(|file| file.replace("firmware/../", "")));
                }
            }
            source
        })
    }

    fn belongs_to(&mut self, address: u32, function: &str) -> bool {
        self.source(address).functions.iter().any(|name| name.ends_with(function))
    }

    fn executes(&mut self, run: &Run, function: &str) -> bool {
        run.path.iter().any(|at| self.belongs_to(*at, function))
    }

    /// Returns true if a run of the control interrupt belongs to a crest, false if it belongs to a valley.
    pub fn is_crest(&mut self, run: &Run) -> bool {
        self.executes(run, CREST_FUNCTION)
    }

    /// Returns true if a run carries out a request of a task.
    pub fn has_request(&mut self, run: &Run) -> bool {
        self.executes(run, REQUEST_FUNCTION)
    }

    /// Returns the instructions of a run, without the instructions that wait for the converters.
    pub fn instructions_without_waiting(&mut self, run: &Run) -> Vec<u32> {
        run.path.iter().copied().filter(|at| !self.belongs_to(*at, WAIT_FUNCTION)).collect()
    }

    /// Returns the source file of an instruction. Code that the compiler shares between functions may have no file.
    pub fn file(&mut self, address: u32) -> &str {
        self.source(address).file.as_deref().unwrap_or("no file of this repository")
    }
}

/// Removes generic arguments from a path, so that `<a::B<C> as d::E<F>>::g` becomes `a::B::g`.
fn without_generics(name: &str) -> String {
    let mut out = String::new();
    let mut depth = 0_u32;
    let mut skipping = false;
    // The implementing type is in angle brackets at the front, and the trait is removed.
    let path = name.trim_start_matches('<');
    for (at, letter) in path.char_indices() {
        match letter {
            '<' => depth += 1,
            '>' if depth > 0 => depth -= 1,
            '>' => skipping = false,
            _ if depth > 0 || skipping => {}
            ' ' if path[at..].starts_with(" as ") => skipping = true,
            _ => out.push(letter),
        }
    }
    out.replace("::::", "::").trim_end_matches("::").to_owned()
}

#[cfg(test)]
mod tests {
    use super::without_generics;

    #[test]
    fn paths_lose_their_generic_arguments() {
        let controller = "<haptic_bridge::render::controller::Controller<f32, a::B, c::D, 2>>::step";
        assert_eq!(without_generics(controller), "haptic_bridge::render::controller::Controller::step");
        assert_eq!(without_generics("<a::B<C> as d::E<F>>::g"), "a::B::g");
        assert_eq!(without_generics("a::padded::<i32>"), "a::padded");
    }
}
