//! Assigns instructions to stages of the control interrupt, by the functions that they are part of.
//!
//! The compiler inlines most of the interrupt into a few functions. The debug information of the unmodified image lists
//! the source functions of every instruction. The innermost function with a stage decides. Code without such a function
//! (memory copies, outlined sequences, iterators) belongs to its caller's stage.

use std::borrow::Cow;
use std::collections::{BTreeSet, HashMap};

use addr2line::Context;
use addr2line::gimli::{Dwarf, EndianSlice, LittleEndian};
use object::{Object as _, ObjectSection as _};

use crate::image::Firmware;
use crate::trace::{Code, Move, Run, Walker};

/// Stage that runs only if a task sent a request.
pub const REQUEST: &str = "a request";

/// Stage that runs at every crest and at no valley.
pub const ENCODERS: &str = "encoders";

/// Stage in which the interrupt only waits.
pub const WAITING: &str = "waiting for the converters";

/// Stages of a run in order, and the functions of each: the ends of their paths without generic arguments.
pub const STAGES: &[(&str, &[&str])] = &[
    ("entry, exit, overrun check", &["TIM1_UP_TIM10", "InterruptState::keep_time", "InterruptState::record_time"]),
    (
        ENCODERS,
        &[
            "Pins::update_counts",
            "Sampled::update_counts",
            "encoder::update_count",
            "Pins::has_marks",
            "Sampled::has_marks",
            "Pins::marks",
            "Sampled::marks",
            "InterruptState::mark",
        ],
    ),
    (WAITING, &["adc::wait"]),
    (
        "currents and bus voltage",
        &[
            "InterruptState::sample",
            "InterruptState::await_samples",
            "Pins::has_sampled",
            "Sampled::has_sampled",
            "Pins::sample",
            "Sampled::sample",
        ],
    ),
    ("fault lines", &["Pins::has_fault", "Sampled::has_fault", "InterruptState::trip_driving"]),
    (
        "order of a crest",
        &[
            "InterruptState::crest",
            "InterruptState::crest_before_step",
            "InterruptState::crest_between",
            "InterruptState::is_late",
            "InterruptState::crest_late",
            "InterruptState::write_late",
            "InterruptState::write",
            "InterruptState::check_missed_crest",
            "InterruptState::trip_overrun",
        ],
    ),
    (REQUEST, &["InterruptState::carry_out"]),
    (
        "control",
        &[
            "ControlLoop::render",
            "ControlLoop::render_scene",
            "ControlLoop::render_pushed",
            "AnyController::render",
            "Controller::render",
            "Controller::render_uncommon",
            "compiled::render",
            "compiled::crest",
            "compiled::crest_of_one",
            "compiled::crest_of_two",
            "compiled::crest_of_three",
            "compiled::crest_generally",
            "ControlLoop::crest_of",
            "ControlLoop::crest_generally",
            "ControlLoop::go_on",
            "ControlLoop::begin_step",
            "ControlLoop::step",
            "ControlLoop::slow_step",
            "ControlLoop::update_fast_path",
        ],
    ),
    (
        "step: angles, speeds",
        &["Encoders::angles", "Encoders::velocities", "Controller::observe", "Controller::observe_energy"],
    ),
    (
        "step: pose, tip, weight",
        &[
            "Controller::start",
            "Controller::write_motion",
            "Controller::write_total",
            "straight::add_guidance",
            "Controller::restart",
            "Controller::write_gravity",
            "mechanism::shared_pose",
            "::pose_at",
            "::regular_pose",
            "::regularity",
            "::tip",
        ],
    ),
    (
        "step: walls",
        &[
            "Controller::render_wall",
            "Controller::render_round",
            "Controller::render_single",
            "Controller::render_several",
            "Controller::render_generally",
            "Controller::render_any_scene",
            "Controller::write_untouched",
            "Controller::write_guidance",
            "Controller::write_shared_guidance",
            "Controller::shared_pull",
            "Surface::contact_and_curvature",
            "Controller::add_force",
            "RunningWall::pass",
            "RunningWall::press",
            "Surface::contact",
            "Surface::curved_contact",
            "Walls::touch",
        ],
    ),
    (
        "step: feed-forward",
        &[
            "several::stiffest",
            "Controller::shaped",
            "Controller::shaped_rarely",
            "Controller::shaped_round",
            "Controller::shaped_in_general",
            "Controller::certain_velocities",
            "round::turning",
            "Controller::feed_forward",
            "Controller::bias",
            "Controller::velocity_term_share",
            "Encoders::beyond_one_count",
            "Encoders::are_known",
            "ContactGroup::new",
            "Principal::new",
            "::shaped",
            "::shaped_turning",
            "::shaping",
            "::velocity_torque",
        ],
    ),
    ("limits, at every crest", &["ControlLoop::look_of", "ControlLoop::look", "ControlLoop::find_at_crest"]),
    ("guard", &["ControlLoop::watch", "ControlLoop::find"]),
    (
        "drive: torque to current",
        &[
            "ControlLoop::fits",
            "ControlLoop::command_unlimited",
            "ControlLoop::command_limited",
            "ControlLoop::command",
            "ControlLoop::command_of",
            "ControlLoop::fade_in",
        ],
    ),
    ("bridges", &["InterruptState::connect"]),
    (
        "current loops",
        &[
            "::drive_in_range",
            "ControlLoop::drive_all",
            "ControlLoop::drive_unusually",
            "ControlLoop::drive_rest",
            "crest::drive_one",
            "Axis::drive_at_limits",
            "ControlLoop::drive",
            "Ticks::legs",
            "Supply::of",
        ],
    ),
    ("duties to the timers", &["Pins::write", "Sampled::write"]),
    (
        "valley: order, converters",
        &[
            "InterruptState::valley",
            "Pins::clear_flags",
            "Sampled::clear_flags",
            "Pins::learn_zeros",
            "Sampled::learn_zeros",
        ],
    ),
    (
        "valley: what the step saw, telemetry",
        &[
            "InterruptState::record",
            "Frames::push",
            "compiled::note",
            "ControlLoop::note",
            "ControlLoop::note_late",
            "AnyController::angles",
            "Controller::angles",
        ],
    ),
    (
        "valley: models of the motors, heat, stalls",
        &[
            "compiled::check_slow_faults",
            "ControlLoop::check_slow_faults_of",
            "ControlLoop::doubt",
            "ControlLoop::spent",
            "::settle",
            "ControlLoop::outputs",
        ],
    ),
];

/// Prefix of the names of stages that run at a valley.
pub const AT_VALLEYS: &str = "valley: ";

type Reader<'a> = EndianSlice<'a, LittleEndian>;

/// Assigns instructions to stages.
pub struct Stages<'a> {
    code: Code,
    context: Context<Reader<'a>>,
    known: HashMap<u32, Option<usize>>,
}

impl<'a> Stages<'a> {
    /// Reads the debug information of `firmware`; `None` if there is no readable one.
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

    /// Returns the source functions of the instruction at `address`, innermost first, without generic arguments.
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

    /// Returns the functions of the library and the firmware in `run` that have no stage, so that their instructions count
    /// for their callers.
    #[must_use]
    pub fn unnamed(&mut self, run: &Run) -> BTreeSet<String> {
        let places: BTreeSet<u32> = run.path.iter().copied().collect();
        let unnamed: Vec<u32> = places.into_iter().filter(|at| self.own(*at).is_none()).collect();
        let outermost = unnamed.into_iter().filter_map(|at| self.functions(at).pop());
        outermost.filter(|function| function.starts_with("haptic_bridge")).collect()
    }

    /// Returns the stage of each instruction of `run`, as an index into [`STAGES`].
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

/// Removes generic arguments from a path: `<a::B<C> as d::E<F>>::g` becomes `a::B::g`.
fn plain(name: &str) -> String {
    let mut out = String::new();
    let mut depth = 0_u32;
    let mut rest = name;
    // The implementing type is in angle brackets at the front; the trait does not matter.
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
    use super::{STAGES, plain};
    use std::path::Path;

    /// Returns all sources in a folder, concatenated.
    fn sources(folder: &Path) -> String {
        let entries =
            std::fs::read_dir(folder).expect("a readable folder").map(|entry| entry.expect("an entry").path());
        entries
            .map(|path| match path.extension() {
                _ if path.is_dir() => sources(&path),
                Some(end) if end == "rs" => std::fs::read_to_string(&path).expect("a readable source"),
                _ => String::new(),
            })
            .collect()
    }

    #[test]
    fn every_function_of_a_stage_exists() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let text = sources(&root.join("src")) + &sources(&root.join("firmware/src"));
        assert!(text.len() > 500_000, "only {} bytes of sources", text.len());
        for part in STAGES.iter().flat_map(|(_, parts)| *parts) {
            let name = part.rsplit("::").next().unwrap_or_default();
            let exists = ["(", "<"].iter().any(|next| text.contains(&format!("fn {name}{next}")));
            assert!(exists, "{part}: no function has this name");
        }
    }

    /// Functions of a board without a stage would count for their callers.
    #[test]
    fn every_board_has_its_functions_in_stages() {
        let text = sources(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../firmware/src/board"));
        let parts: Vec<&str> = text
            .lines()
            .filter(|line| line.starts_with("impl"))
            .filter_map(|line| line.split_once("Io for "))
            .map(|(_, rest)| rest.split(|c: char| !c.is_alphanumeric()).next().unwrap_or_default())
            .collect();
        assert!(parts.len() >= 2, "{parts:?}");
        for part in parts {
            for function in ["update_counts", "sample", "has_fault", "write"] {
                let name = format!("{part}::{function}");
                assert!(STAGES.iter().any(|(_, parts)| parts.contains(&name.as_str())), "no stage has {name}");
            }
        }
    }

    #[test]
    fn paths_lose_their_generic_arguments() {
        let controller = "<haptic_bridge::render::controller::Controller<f32, a::B, c::D, 2>>::step";
        assert_eq!(plain(controller), "haptic_bridge::render::controller::Controller::step");
        assert_eq!(plain("<a::B<C> as d::E<F>>::g"), "a::B::g");
        assert_eq!(plain("a::padded::<i32>"), "a::padded");
    }
}
