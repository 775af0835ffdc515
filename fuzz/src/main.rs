//! Fuzzing: what comes from outside, made as wild as possible. Each target takes bytes from nowhere, and may neither
//! panic nor break its promise. `cargo xtask fuzz` builds this with the instrumentation that libFuzzer needs and runs
//! it: `HAPTIC_FUZZ=target program [libFuzzer's options] corpus`.
#![no_main]

mod answers;
#[path = "../../tests/rig/board.rs"]
mod board;
#[allow(dead_code, reason = "of the tool's own files only the parser is used here")]
#[path = "../../tool/src/cli.rs"]
mod cli;
#[allow(dead_code, reason = "of the tool's own files only the parser is used here")]
#[path = "../../tool/src/commands/mod.rs"]
mod commands;
mod files;
mod requests;
mod settings;
mod shipped;

use libfuzzer_sys::fuzz_target;
use std::sync::OnceLock;

/// What is done with wild bytes.
type Target = fn(&[u8]);

/// Every target by its name, which is also that of its seeds' directory.
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
    static RUN: OnceLock<Target> = OnceLock::new();
    let run = RUN.get_or_init(|| {
        let name = std::env::var("HAPTIC_FUZZ").expect("HAPTIC_FUZZ names a target");
        TARGETS.iter().find(|(known, _)| *known == name).expect("a target of that name").1
    });
    run(data);
});
