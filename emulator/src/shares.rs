//! Instructions of a run by purpose: those of the control interrupt exactly, those of the tasks by their source
//! functions.

use std::collections::HashMap;

use rigless::emulator::Hit;

use crate::image::Firmware;
use crate::stages::Stages;
use crate::trace::{Code, Move, Walker};

/// Name of the control interrupt's share.
pub const CONTROL: &str = "the control interrupt";
/// Name of the share of tasks that wait for the control interrupt's reply.
pub const WAITING: &str = "waiting for the valley at which it takes a request";
/// Name of the remaining share.
const REST: &str = "everything else";

/// Purposes of the tasks' functions, with parts of their paths: the innermost function with a match decides.
const SHARES: &[(&str, &[&str])] = &[
    (WAITING, &["Requests::exchange"]),
    ("frames: COBS", &["board::framing"]),
    ("messages: postcard, and packing rows", &["postcard", "board::dispatch", "board::telemetry"]),
    ("copying", &["compiler_builtins::mem", "__aeabi_mem"]),
    ("packets: the USB core's interrupt and driver", &["OTG_FS", "embassy_usb", "firmware::serial"]),
    ("tasks and timers", &["embassy_executor", "embassy_time", "embassy_sync", "time_driver", "firmware::link"]),
];

/// Counts instructions: those of the control interrupt together, all others by address.
#[derive(Debug)]
pub struct Tally {
    code: Code,
    entry: u32,
    control: Option<Walker>,
    seen: u64,
    inside: u64,
    outside: HashMap<u32, u64>,
}

impl Tally {
    /// Returns a tally for a control interrupt that starts at `entry`.
    #[must_use]
    pub fn new(code: Code, entry: u32) -> Self {
        Self { code, entry, control: None, seen: 0, inside: 0, outside: HashMap::new() }
    }

    /// Handles a hit. A stop of the emulator may report an instruction twice; it is counted once.
    pub fn feed(&mut self, hit: &Hit) {
        if std::mem::replace(&mut self.seen, hit.instruction_count) == hit.instruction_count {
            return;
        }
        let at = hit.address as u32;
        if self.control.as_mut().is_some_and(|walker| walker.step(at) == Move::Left) {
            self.control = None;
        }
        if self.control.is_none() && at == self.entry {
            self.control = Some(Walker::new(self.code.clone(), at));
        }
        match self.control {
            Some(_) => self.inside += 1,
            None => *self.outside.entry(at).or_default() += 1,
        }
    }

    /// Returns the instructions of each share, the control interrupt's first.
    ///
    /// # Panics
    ///
    /// If the image has no debug information.
    #[must_use]
    pub fn shares(self, image: &Firmware) -> Vec<(&'static str, u64)> {
        let stages = Stages::of(image).expect("debug information");
        let mut shares = vec![(CONTROL, self.inside)];
        shares.extend(SHARES.iter().map(|(name, _)| (*name, 0)).chain([(REST, 0)]));
        for (at, count) in self.outside {
            let functions = stages.functions(at);
            let of = |function: &String| {
                SHARES.iter().position(|(_, parts)| parts.iter().any(|part| function.contains(part)))
            };
            let share = functions.iter().find_map(of).unwrap_or(SHARES.len());
            shares[1 + share].1 += count;
        }
        shares
    }
}
