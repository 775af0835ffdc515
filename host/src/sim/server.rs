//! A simulated board behind a port that other programs open: a pseudo-terminal or a TCP address.
//!
//! One thread runs the board and owns it; others only carry bytes (`sim/door.rs`), through queues of a bounded length,
//! so that a tool that floods or does not read costs no memory.

use super::board::SimulatedBoard;
use super::door::{BLOCK, DISARM_ANSWER, Event, Outgoing, ToolListener};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, TryRecvError, TrySendError};
use std::time::{Duration, Instant};

/// A board as its server needs it; the emulated chip is another.
pub trait Hosted {
    /// Takes bytes from the tool.
    fn receive(&mut self, bytes: &[u8]);
    /// Bytes for the tool, as many as fit; returns how many.
    fn take_bytes(&mut self, buffer: &mut [u8]) -> usize;
    /// The tool is gone.
    fn hang_up(&mut self);
    /// Lets seconds pass, and what is left of a control period by then.
    fn run(&mut self, seconds: f64);
    /// Seconds since power-on.
    fn time(&self) -> f64;
    /// For how long the host has sent no heartbeat, and for how long it may, s; none where the board does not mind.
    fn host_silence(&self) -> Option<(f64, f64)> {
        None
    }
}

impl Hosted for SimulatedBoard {
    fn receive(&mut self, bytes: &[u8]) {
        Self::receive(self, bytes);
    }
    fn take_bytes(&mut self, buffer: &mut [u8]) -> usize {
        Self::take_bytes(self, buffer)
    }
    fn hang_up(&mut self) {
        Self::hang_up(self);
    }
    fn run(&mut self, seconds: f64) {
        Self::run(self, seconds);
    }
    fn time(&self) -> f64 {
        Self::time(self)
    }
    fn host_silence(&self) -> Option<(f64, f64)> {
        Self::host_silence(self)
    }
}

/// How simulated time passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// With the wall clock and never ahead of it, but for what one request or control period takes; when the computer
    /// is too slow, later.
    RealTime,
    /// As fast as the computer can while a tool is connected and reads; no telemetry is dropped. Where the board turns
    /// its motors off when the tool is silent, simulated time does not run away from the tool: from a quarter of that
    /// silence on it passes no faster than the wall clock, so that only a silence that is one is taken for one.
    AsFastAsItCan,
}

/// Simulated time between two looks at the link, s.
const SLICE: f64 = 1e-3;
/// The most that a board in real time catches up after the computer was busy, s.
const CATCH_UP: f64 = 0.1;

/// Runs `board` behind `door` until `stop` is set.
pub fn serve(board: &mut impl Hosted, door: &ToolListener, pace: Pace, stop: &AtomicBool) {
    let mut tools = Tools::default();
    let began = Instant::now();
    let start = board.time();
    let mut skipped = 0.0;
    // Since when the host is silent on the wall clock, and for how long it was by the board's.
    let mut heard = (Instant::now(), 0.0);
    while !stop.load(Ordering::SeqCst) {
        let now = began.elapsed().as_secs_f64() - skipped;
        // By the board's own time: requests take some, and a slice ends with a control period.
        let behind = now - (board.time() - start);
        if pace == Pace::RealTime && behind < -SLICE {
            std::thread::sleep(Duration::from_secs_f64(SLICE));
            continue;
        }
        let idle = match pace {
            Pace::RealTime => behind < SLICE,
            Pace::AsFastAsItCan => {
                let runs_away = board.host_silence().is_some_and(|(silent, allowed)| {
                    if silent < heard.1 {
                        heard.0 = Instant::now();
                    }
                    heard.1 = silent;
                    silent > (0.25 * allowed).max(heard.0.elapsed().as_secs_f64())
                });
                tools.none_reads() || runs_away
            }
        };
        let event = if idle {
            door.events.recv_timeout(Duration::from_secs_f64(SLICE))
        } else {
            door.events.try_recv().map_err(|error| match error {
                TryRecvError::Empty => RecvTimeoutError::Timeout,
                TryRecvError::Disconnected => RecvTimeoutError::Disconnected,
            })
        };
        match event {
            Ok(Event::Connected(outgoing)) => {
                tools.holder = Some(outgoing);
                heard = (Instant::now(), 0.0);
            }
            Ok(Event::Bytes(bytes)) => board.receive(&bytes),
            Ok(Event::Gone) => {
                tools.holder = None;
                tools.waiting = None;
                board.hang_up();
            }
            Ok(Event::Disarm(request, answers)) => {
                // Ends whatever the holder was in the middle of.
                board.receive(&[0]);
                board.receive(&request);
                tools.guests.push((answers, Instant::now()));
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        if !idle {
            if pace == Pace::RealTime && behind > CATCH_UP {
                skipped += behind - CATCH_UP;
            }
            board.run(SLICE);
        }
        tools.pass_on(board);
    }
}

/// Who hears what the board says.
#[derive(Default)]
struct Tools {
    holder: Option<Outgoing>,
    /// A block that the holder has not taken yet.
    waiting: Option<Vec<u8>>,
    /// Tools that disarmed past the holder, and since when they listen.
    guests: Vec<(Outgoing, Instant)>,
}

impl Tools {
    fn none_reads(&self) -> bool {
        self.guests.is_empty() && (self.holder.is_none() || self.waiting.is_some())
    }

    /// Hands the tools what the board has for them, as far as the holder takes it. While a guest listens nothing waits
    /// for a holder that does not read.
    fn pass_on(&mut self, board: &mut impl Hosted) {
        self.guests.retain(|(_, since)| since.elapsed() < DISARM_ANSWER);
        while self.holder.is_some() || !self.guests.is_empty() {
            let block = self.waiting.take().unwrap_or_else(|| {
                let mut block = vec![0; BLOCK];
                let count = board.take_bytes(&mut block);
                block.truncate(count);
                for (guest, _) in &self.guests {
                    let _ = guest.try_send(block.clone());
                }
                block
            });
            if block.is_empty() {
                return;
            }
            let Some(holder) = &self.holder else { continue };
            match holder.try_send(block) {
                Ok(()) => {}
                Err(TrySendError::Full(_)) if !self.guests.is_empty() => {}
                Err(TrySendError::Full(block)) => {
                    self.waiting = Some(block);
                    return;
                }
                // The reading side will say that the tool is gone.
                Err(TrySendError::Disconnected(_)) => self.holder = None,
            }
        }
    }
}
