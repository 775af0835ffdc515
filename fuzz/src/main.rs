//! Fuzzing of all input from outside. Each target receives random bytes and must neither panic nor violate its
//! invariants. `cargo xtask fuzz` builds this program with libFuzzer's instrumentation and runs it: `HAPTIC_FUZZ=target
//! program [libFuzzer's options] corpus`.
#![no_main]

mod answers;
#[path = "../../tests/rig/board.rs"]
mod board;
#[allow(dead_code, reason = "only the tool's parser is used here")]
#[path = "../../tool/src/cli.rs"]
mod cli;
#[allow(dead_code, reason = "only the tool's parser is used here")]
#[path = "../../tool/src/commands/mod.rs"]
mod commands;
mod files;
mod requests;
mod settings;
mod shipped;

use libfuzzer_sys::fuzz_target;
use std::sync::OnceLock;

/// Function that processes an input of random bytes.
type Target = fn(&[u8]);

/// All targets by their names, which are also the names of their folders of seeds.
const TARGETS: [(&str, Target); 8] = [
    ("bytes", requests::bytes),
    ("requests", |data| {
        requests::requests(data);
    }),
    ("answers", answers::answers),
    ("settings", settings::settings),
    ("device_file", files::device_file),
    ("scene_file", files::scene_file),
    ("kept_file", files::kept_file),
    ("command_line", files::command_line),
];

fuzz_target!(|data: &[u8]| {
    static TARGET: OnceLock<Target> = OnceLock::new();
    let run = TARGET.get_or_init(|| {
        let name = std::env::var("HAPTIC_FUZZ").expect("HAPTIC_FUZZ names a target");
        TARGETS.iter().find(|(known, _)| *known == name).expect("HAPTIC_FUZZ is the name of a target").1
    });
    run(data);
});
