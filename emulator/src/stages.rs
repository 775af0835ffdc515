//! To which stage of the control interrupt an instruction belongs, told by the functions it is part of.
//!
//! The compiler inlines most of the interrupt into a few functions; the debug information of the unchanged image says
//! for every instruction which functions of the source it came from. The innermost one that a stage names decides; code
//! that names none (memory copies, outlined sequences, iterators) belongs to the stage of whoever called it.

use std::borrow::Cow;
use std::collections::HashMap;

use addr2line::Context;
use addr2line::gimli::{Dwarf, EndianSlice, LittleEndian};
use object::{Object as _, ObjectSection as _};

use crate::image::Firmware;
use crate::trace::{Code, Move, Run, Walker};

/// The stage that runs only where a task asked for something.
pub const REQUEST: &str = "a request";

/// The stage that every step goes through and no valley.
pub const SAMPLING: &str = "waiting for the converters";

/// The stages of a run, in the order in which it goes through them, and the functions each consists of: parts of
/// their paths without generic arguments.
pub const STAGES: &[(&str, &[&str])] = &[
    ("entry, exit, overrun check", &["::TIM1_UP_TIM10", "Step::keep_time"]),
    (SAMPLING, &["adc::wait"]),
    ("currents and bus voltage", &["Pins::analog", "Zeros::less"]),
    ("order of a crest", &["Step::crest"]),
    (REQUEST, &["Step::take"]),
    ("encoders", &["Pins::counts", "Encoder::read", "Pins::index"]),
    ("samples, fault lines", &["Step::hardware_fault"]),
    ("servo", &["Servo::render", "compiled::render", "Servo::act_of", "compiled::judge"]),
    ("step: angles, speeds", &["Encoders::angles", "Encoders::velocities"]),
    ("step: pose, tip", &["mechanism::shared_pose", "::pose", "::tip", "::regularity"]),
    (
        "step: walls",
        &[
            "Controller::step",
            "Controller::step_generally",
            "Controller::step_at_a_plane",
            "Running::press",
            "AnyController::step",
            "Walls::touch",
        ],
    ),
    (
        "step: feed-forward",
        &[
            "Controller::shaped_by_one",
            "Controller::shaped_by_several",
            "Controller::bias",
            "Controller::known",
            "inertia::shaped_torque_beside",
            "::shaping",
            "::velocity_torque",
        ],
    ),
    ("limits, at every crest", &["compiled::guard", "Servo::guard", "Servo::guard_of", "::follow"]),
    ("guard", &["Servo::watch", "Servo::watch_budgets", "Servo::find", "Servo::index_agrees"]),
    ("drive: torque to current", &["Servo::drive"]),
    ("bridges", &["Step::connect"]),
    ("current loops", &["compiled::legs", "compiled::legs_of", "Servo::duties", "Servo::duties_of"]),
    ("duties to the timers", &["Pins::write"]),
    ("telemetry", &["Step::record", "compiled::record"]),
];

type Reader<'a> = EndianSlice<'a, LittleEndian>;

/// Attributes instructions to stages.
pub struct Stages<'a> {
    code: Code,
    context: Context<Reader<'a>>,
    known: HashMap<u32, Option<usize>>,
}

impl<'a> Stages<'a> {
    /// Reads the debug information of `firmware`; `None` where there is none that can be read.
    #[must_use]
    pub fn of(firmware: &'a Firmware) -> Option<Self> {
        let elf = object::File::parse(firmware.bytes()).ok()?;
        let load = |id: addr2line::gimli::SectionId| -> Result<Reader<'a>, addr2line::gimli::Error> {
            let data = elf.section_by_name(id.name()).and_then(|section| section.data().ok());
            Ok(Reader::new(data.unwrap_or(&[]), LittleEndian))
        };
        let context = Context::from_dwarf(Dwarf::load(load).ok()?).ok()?;
        Some(Self { code: Code::of(firmware)?, context, known: HashMap::new() })
    }

    /// The functions that the instruction at `address` came from, innermost first, without generic arguments.
    #[must_use]
    pub fn functions(&self, address: u32) -> Vec<String> {
        let mut names = Vec::new();
        if let Ok(mut frames) = self.context.find_frames(u64::from(address)).skip_all_loads() {
            while let Ok(Some(frame)) = frames.next() {
                let name = frame.function.and_then(|function| function.demangle().ok().map(Cow::into_owned));
                names.extend(name.map(|name| plain(&name)));
            }
        }
        names
    }

    fn own(&mut self, address: u32) -> Option<usize> {
        if let Some(stage) = self.known.get(&address) {
            return *stage;
        }
        let stage = self.functions(address).iter().find_map(|function| {
            STAGES.iter().position(|(_, parts)| parts.iter().any(|part| function.ends_with(part)))
        });
        self.known.insert(address, stage);
        stage
    }

    /// The stage of each instruction of `run`, by its place in [`STAGES`].
    #[must_use]
    pub fn of_each(&mut self, run: &Run) -> Vec<usize> {
        let Some(&entry) = run.path.first() else { return Vec::new() };
        let mut walker = Walker::new(self.code.clone(), entry);
        let mut callers = Vec::new();
        let (mut inherited, mut stage) = (0, 0);
        let mut stages = Vec::with_capacity(run.path.len());
        for (nth, &at) in run.path.iter().enumerate() {
            if nth > 0 {
                match walker.step(at) {
                    Move::Called => {
                        callers.push(inherited);
                        inherited = stage;
                    }
                    Move::Returned => inherited = callers.pop().unwrap_or(0),
                    Move::Within | Move::Left => {}
                }
            }
            stage = self.own(at).unwrap_or(inherited);
            stages.push(stage);
        }
        stages
    }
}

/// A path without generic arguments: `<a::B<C> as d::E<F>>::g` becomes `a::B::g`.
fn plain(name: &str) -> String {
    let mut out = String::new();
    let mut depth = 0_u32;
    let mut rest = name;
    // The implementing type stands in angle brackets at the front; what it implements does not matter.
    while let Some(inner) = rest.strip_prefix('<') {
        rest = inner;
    }
    let mut skipping = false;
    for (at, letter) in rest.char_indices() {
        match letter {
            '<' => depth += 1,
            '>' if depth > 0 => depth -= 1,
            '>' => skipping = false,
            _ if depth > 0 || skipping => {}
            ' ' if rest[at..].starts_with(" as ") => skipping = true,
            _ => out.push(letter),
        }
    }
    out.replace("::::", "::").trim_end_matches("::").to_owned()
}

#[cfg(test)]
mod tests {
    use super::plain;

    #[test]
    fn paths_lose_their_generic_arguments() {
        let controller = "<haptic_bridge::render::controller::Controller<f32, a::B, c::D, 2>>::step";
        assert_eq!(plain(controller), "haptic_bridge::render::controller::Controller::step");
        assert_eq!(plain("<a::B<C> as d::E<F>>::g"), "a::B::g");
        assert_eq!(plain("a::padded::<i32>"), "a::padded");
    }
}
