//! A host that pushes through a board as fast as the board answers: how many exchanges a second of the chip's time.
//!
//! The bus is the one of usb.rs: full speed, each packet 13 bytes longer than what it carries, no frame boundaries and
//! no other device, a packet begun as soon as the chip offers or takes it. A computer that answers at once is looked at
//! every [`LOOK`]; a real one adds what its own USB and scheduler take.

use std::collections::VecDeque;
use std::time::Duration;

use haptic_bridge::board::protocol::{ForceDone, ForceRequest, HostContact};
use haptic_bridge::board::telemetry::Fields;
use haptic_bridge::safety::fault::State;
use haptic_host::link::{Board, Losses};

use crate::image::CONTROL_INTERRUPT;
use crate::rig::{Rig, firmware};
use crate::run::{MICROSECOND, MILLISECOND};
use crate::trace::Code;

/// Longest time from an answer's last byte to the next request, ns.
pub const LOOK: u64 = 5 * MICROSECOND;

/// The result of a stretch of exchanges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exchanges {
    /// Requests answered in a second.
    pub per_second: f64,
    /// From a request to its answer: the median and the longest, s.
    pub median: f64,
    /// s
    pub longest: f64,
    /// Requests that the board did not take.
    pub not_taken: usize,
    /// Control steps that ran, and periods that passed.
    pub steps: u32,
    /// Periods.
    pub periods: u32,
    /// Steps that reached past the next crest.
    pub overruns: u32,
    /// Telemetry.
    pub losses: Losses,
    /// True if the motors were on at the end, without a fault.
    pub armed: bool,
}

/// Pushes for `milliseconds` with a small force that changes at every exchange, and `contact`, while every `divider`th
/// step's `fields` stream; no stream with 0. `ahead`: how many requests are on their way at most, 1 for lock step.
///
/// # Panics
///
/// When the link breaks.
pub fn run(
    rig: &mut Rig,
    (fields, divider): (Fields, u32),
    rate_hz: u32,
    milliseconds: u64,
    contact: Option<HostContact>,
    ahead: usize,
) -> Exchanges {
    start(rig, (fields, divider));
    let (before, began) = (rig.steps(), rig.now());
    let (mut times, not_taken) = push(rig, milliseconds, contact, ahead);
    let (after, ended) = (rig.steps(), rig.now());
    let losses = rig.tool.losses();
    rig.tool.stop_stream().expect("the stream stops");
    let (details, status) = (rig.tool.details().expect("it answers"), rig.tool.status().expect("it answers"));
    let seconds = |nanoseconds: u64| nanoseconds as f64 * 1e-9;
    let count = times.len();
    times.sort_unstable();
    Exchanges {
        per_second: count as f64 / seconds(ended - began),
        median: seconds(times[count / 2]),
        longest: seconds(times[count - 1]),
        not_taken,
        steps: after.wrapping_sub(before),
        periods: ((ended - began) * u64::from(rate_hz) / 1_000_000_000) as u32,
        overruns: details.overruns,
        losses,
        armed: status.state == State::Armed && status.fault.is_none(),
    }
}

/// Counts the instructions of an exchange by their purpose, with at most `ahead` exchanges on their way and no
/// telemetry.
///
/// # Panics
///
/// When the link breaks, or the image has no control interrupt or no debug information.
pub fn shares(rig: &mut Rig, milliseconds: u64, ahead: usize) -> Vec<(&'static str, f64)> {
    start(rig, (Fields::USUAL, 0));
    let image = firmware(rig.kind);
    let entry = image.symbol(CONTROL_INTERRUPT).unwrap_or_else(|error| panic!("{error}")).address;
    let code = Code::of(image).expect("an image with code");
    let watched = code.clone();
    rig.with(move |bench| bench.tally(&watched, entry));
    let (times, _) = push(rig, milliseconds, None, ahead);
    let tally = rig.with(move |bench| bench.take_tally(&code)).expect("a tally was begun");
    tally.shares(image).into_iter().map(|(name, count)| (name, count as f64 / times.len() as f64)).collect()
}

/// A computer that looks often, and the stream that it asks for.
fn start(rig: &mut Rig, (fields, divider): (Fields, u32)) {
    rig.tool = Board::over(rig.shared.wire_looking_every(LOOK), "virtual").expect("the board answers");
    if divider > 0 {
        rig.tool.start_stream(fields, divider).expect("a stream starts");
    }
    rig.run(5 * MILLISECOND);
    rig.tool.rows(Duration::ZERO).expect("the link holds");
}

/// Pushes: how long each exchange took, ns, and how many were not taken.
fn push(rig: &mut Rig, milliseconds: u64, contact: Option<HostContact>, ahead: usize) -> (Vec<u64>, usize) {
    let began = rig.now();
    let end = began + milliseconds * MILLISECOND;
    let (mut times, mut seen, mut not_taken) = (Vec::new(), None, 0);
    let (mut under_way, mut asked) = (VecDeque::new(), 0);
    // Newer than those of a run before this one.
    let first = (began / MICROSECOND) as u32;
    while rig.now() < end {
        let sequence = first.wrapping_add(asked);
        let push = if sequence.is_multiple_of(2) { 0.05 } else { -0.05 };
        let request = ForceRequest {
            sequence,
            seen,
            hold: 0.02,
            fade: 0.05,
            force: [push, 0.0, 0.0],
            contact,
            ..ForceRequest::default()
        };
        under_way.push_back((sequence, rig.now(), rig.tool.send_force(&request).expect("the link holds")));
        asked += 1;
        if under_way.len() < ahead {
            continue;
        }
        let Some((sequence, began, sent)) = under_way.pop_front() else { continue };
        let answer = rig.tool.force_answer(sent).expect("the board answers");
        not_taken += usize::from(answer.done != ForceDone::Taken || answer.sequence != sequence);
        seen = Some(answer.step);
        times.push(rig.now() - began);
        rig.tool.rows(Duration::ZERO).expect("the link holds");
    }
    (times, not_taken)
}
