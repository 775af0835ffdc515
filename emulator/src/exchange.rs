//! A host that sends force requests as fast as the board replies, to count the exchanges per second of the chip's time.
//!
//! The bus is modelled as in usb.rs, at full speed, with 13 bytes of overhead per packet, without frame boundaries and
//! other devices. A packet begins as soon as the chip offers or accepts it. The simulated computer polls every
//! [`POLL_INTERVAL_NS`] and replies at once, whereas a real computer adds delays of its USB and scheduler.

use std::collections::VecDeque;
use std::time::Duration;

use haptic_bridge::board::protocol::{ForceDone, ForceRequest, HostContact};
use haptic_bridge::board::telemetry::Fields;
use haptic_bridge::safety::fault::State;
use haptic_host::link::{Board, Losses};

use crate::rig::Rig;
use crate::run::{MICROSECOND, MILLISECOND};

/// Longest time from the last byte of a reply to the next request, ns.
pub const POLL_INTERVAL_NS: u64 = 5 * MICROSECOND;

/// Result of a series of exchanges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exchanges {
    /// Number of requests with a reply, per second.
    pub per_second: f64,
    /// Median time from a request to its reply, s.
    pub median_seconds: f64,
    /// Longest time from a request to its reply, s.
    pub longest_seconds: f64,
    /// Number of rejected requests.
    pub rejected: usize,
    /// Number of control steps.
    pub steps: u32,
    /// Number of control periods.
    pub periods: u32,
    /// Number of steps that lasted past the next crest.
    pub overruns: u32,
    /// Losses of telemetry.
    pub losses: Losses,
    /// True if the motors were on at the end and no fault is latched.
    pub is_armed: bool,
}

/// Sends a small force, different in every exchange, together with `contact` for `milliseconds`. Meanwhile the board
/// streams `fields` of every `divider`th step (0: no stream). At most `ahead` requests wait for a reply at a time.
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
    let (mut times, rejected) = send_requests(rig, milliseconds, contact, ahead);
    let (after, ended) = (rig.steps(), rig.now());
    let losses = rig.tool.losses();
    rig.tool.stop_stream().expect("the stream stops");
    let (details, status) = (rig.tool.details().expect("it replies"), rig.tool.status().expect("it replies"));
    let seconds = |nanoseconds: u64| nanoseconds as f64 * 1e-9;
    let count = times.len();
    times.sort_unstable();
    Exchanges {
        per_second: count as f64 / seconds(ended - began),
        median_seconds: seconds(times[count / 2]),
        longest_seconds: seconds(times[count - 1]),
        rejected,
        steps: after.wrapping_sub(before),
        periods: ((ended - began) * u64::from(rate_hz) / 1_000_000_000) as u32,
        overruns: details.overruns,
        losses,
        is_armed: status.state == State::Armed && status.fault.is_none(),
    }
}

/// Connects a computer that polls every [`POLL_INTERVAL_NS`], and starts its stream.
fn start(rig: &mut Rig, (fields, divider): (Fields, u32)) {
    rig.tool = Board::over(rig.shared.wire_polled_every(POLL_INTERVAL_NS), "virtual").expect("the board replies");
    if divider > 0 {
        rig.tool.start_stream(fields, divider).expect("a stream starts");
    }
    rig.run(5 * MILLISECOND);
    rig.tool.rows(Duration::ZERO).expect("the link holds");
}

/// Sends requests. Returns the duration of each exchange (ns), and the number of rejected requests.
fn send_requests(rig: &mut Rig, milliseconds: u64, contact: Option<HostContact>, ahead: usize) -> (Vec<u64>, usize) {
    let began = rig.now();
    let end = began + milliseconds * MILLISECOND;
    let (mut times, mut seen, mut rejected) = (Vec::new(), None, 0);
    let (mut in_flight, mut sent_count) = (VecDeque::new(), 0);
    // The sequence numbers must be newer than those of an earlier run.
    let first = (began / MICROSECOND) as u32;
    while rig.now() < end {
        let sequence = first.wrapping_add(sent_count);
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
        in_flight.push_back((sequence, rig.now(), rig.tool.send_force(&request).expect("the link holds")));
        sent_count += 1;
        if in_flight.len() < ahead {
            continue;
        }
        let Some((sequence, began, sent)) = in_flight.pop_front() else { continue };
        let answer = rig.tool.force_answer(sent).expect("the board replies");
        rejected += usize::from(answer.done != ForceDone::Taken || answer.sequence != sequence);
        seen = Some(answer.step);
        times.push(rig.now() - began);
        rig.tool.rows(Duration::ZERO).expect("the link holds");
    }
    (times, rejected)
}
