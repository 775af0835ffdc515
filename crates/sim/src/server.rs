//! A simulated board behind a port that other programs open: a pseudo-terminal or a TCP address.
//!
//! One thread runs the board and owns it; others only carry bytes (`sim/door.rs`), through queues of a bounded length,
//! so that a tool that floods or does not read costs no memory.

use super::board::SimulatedBoard;
use super::door::{BLOCK, DISARM_ANSWER, Event, Outgoing, STOPS, Stop, ToolListener};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, TryRecvError, TrySendError};
use std::time::{Duration, Instant};

/// The relation of simulated time to the wall clock.
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
pub fn serve(board: &mut SimulatedBoard, door: &ToolListener, pace: Pace, stop: &AtomicBool) {
    let slice = Duration::from_secs_f64(SLICE);
    let began = Instant::now();
    let mut server = Server::new(board, pace);
    while !stop.load(Ordering::SeqCst) {
        let now = began.elapsed().as_secs_f64();
        if let Ok(stop) = door.stops.try_recv() {
            server.stop(now, stop);
        }
        let due = server.due(now);
        let event = match due {
            Due::Nothing => {
                std::thread::sleep(slice);
                continue;
            }
            Due::Events => door.events.recv_timeout(slice),
            Due::Time => door.events.try_recv().map_err(|error| match error {
                TryRecvError::Empty => RecvTimeoutError::Timeout,
                TryRecvError::Disconnected => RecvTimeoutError::Disconnected,
            }),
        };
        if matches!(event, Err(RecvTimeoutError::Disconnected)) {
            return;
        }
        server.turn(now, due, event.ok());
    }
}

/// The server's next action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Due {
    /// The board is ahead of the clock. The tools wait too, because a request takes some of the board's time.
    Nothing,
    /// The tools are heard.
    Events,
    /// They are, and a slice of the board's time passes.
    Time,
}

/// A board and who talks to it. It reads no clock: whoever calls it says what time it is, s since it began.
struct Server<'a> {
    board: &'a mut SimulatedBoard,
    pace: Pace,
    tools: Tools,
    /// The board's time when it began, and what it was too slow for since, s.
    start: f64,
    skipped: f64,
    /// Since when the host is silent on the wall clock, and for how long it was by the board's.
    heard: (f64, f64),
}

impl<'a> Server<'a> {
    fn new(board: &'a mut SimulatedBoard, pace: Pace) -> Self {
        let start = board.time();
        Self { board, pace, tools: Tools::default(), start, skipped: 0.0, heard: (0.0, 0.0) }
    }

    /// By how much the board is behind, by its own time: requests take some, and a slice ends with a control period.
    fn behind(&self, now: f64) -> f64 {
        now - self.skipped - (self.board.time() - self.start)
    }

    fn due(&mut self, now: f64) -> Due {
        let idle = match self.pace {
            Pace::RealTime if self.behind(now) < -SLICE => return Due::Nothing,
            Pace::RealTime => self.behind(now) < SLICE,
            Pace::AsFastAsItCan => self.runs_away(now) || self.tools.none_reads(),
        };
        if idle { Due::Events } else { Due::Time }
    }

    fn runs_away(&mut self, now: f64) -> bool {
        self.board.host_silence().is_some_and(|(silent, allowed)| {
            if silent < self.heard.1 {
                self.heard.0 = now;
            }
            self.heard.1 = silent;
            silent > (0.25 * allowed).max(now - self.heard.0)
        })
    }

    /// Does what was due at `now`.
    fn turn(&mut self, now: f64, due: Due, event: Option<Event>) {
        match event {
            Some(Event::Connected(outgoing)) => {
                self.tools.holder = Some(outgoing);
                self.heard = (now, 0.0);
            }
            Some(Event::Bytes(bytes)) => self.board.receive(&bytes),
            Some(Event::Gone) => {
                self.tools.holder = None;
                self.tools.waiting = None;
                self.board.hang_up();
            }
            None => {}
        }
        if due == Due::Time {
            if self.pace == Pace::RealTime {
                self.skipped += (self.behind(now) - CATCH_UP).max(0.0);
            }
            self.board.run(SLICE);
        }
        self.tools.guests.retain(|(_, since)| now - since < DISARM_ANSWER.as_secs_f64());
        self.tools.pass_on(self.board);
    }

    /// Has the board disarm for a tool that does not hold it.
    fn stop(&mut self, now: f64, (request, answers): Stop) {
        // Ends whatever the holder was in the middle of.
        self.board.receive(&[0]);
        self.board.receive(&request);
        if self.tools.guests.len() >= STOPS {
            self.tools.guests.remove(0);
        }
        self.tools.guests.push((answers, now));
        self.tools.pass_on(self.board);
    }
}

/// Who hears what the board says.
#[derive(Default)]
struct Tools {
    holder: Option<Outgoing>,
    /// A block that the holder has not taken yet.
    waiting: Option<Vec<u8>>,
    /// Tools that disarmed past the holder, and since when they listen, s.
    guests: Vec<(Outgoing, f64)>,
}

impl Tools {
    fn none_reads(&self) -> bool {
        self.guests.is_empty() && (self.holder.is_none() || self.waiting.is_some())
    }

    /// Hands the tools what the board has for them, as far as the holder takes it. While a guest listens nothing waits
    /// for a holder that does not read.
    fn pass_on(&mut self, board: &mut SimulatedBoard) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BoardOptions, SHIPPED_DEVICE, ready_board};
    use haptic_bridge::board::protocol::{Arm, CheckPolarity, Disarm, GetStatus, SetRules};
    use haptic_bridge::control::{HostAction, Rules};
    use haptic_bridge::render::scene::Scene;
    use haptic_bridge::safety::fault::State;
    use haptic_host::device_file::DeviceFile;
    use haptic_host::link::encode;
    use postcard_rpc::Endpoint;
    use postcard_rpc::header::{VarHeader, VarKey, VarSeq};
    use std::sync::mpsc::{Receiver, sync_channel};

    fn board(rate_hz: f32) -> SimulatedBoard {
        let file = DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml").unwrap();
        let mut board = ready_board(&file, BoardOptions::default()).unwrap();
        let scene = Scene { task: 2, rate_hz, cutoff_hz: 50.0, ..Scene::default() };
        board.load(&file.name, &file.description, Some(scene)).unwrap();
        board
    }

    fn request<E: Endpoint>(body: &E::Request) -> Vec<u8>
    where
        E::Request: serde::Serialize,
    {
        let header = VarHeader { key: VarKey::Key8(E::REQ_KEY), seq_no: VarSeq::Seq2(1) };
        encode(&header, &postcard::to_stdvec(body).unwrap())
    }

    /// A tool that has come, and what it is told.
    fn connect(server: &mut Server<'_>) -> Receiver<Vec<u8>> {
        let (outgoing, told) = sync_channel(8);
        server.turn(0.0, Due::Events, Some(Event::Connected(outgoing)));
        told
    }

    #[test]
    fn in_real_time_it_is_never_ahead_of_the_clock_however_long_its_periods_and_however_much_it_is_asked() {
        for asked in [false, true] {
            let mut board = board(200.0);
            let mut server = Server::new(&mut board, Pace::RealTime);
            let told = connect(&mut server);
            for turn in 1..2_000 {
                let now = 0.25e-3 * f64::from(turn);
                let due = server.due(now);
                if due != Due::Nothing {
                    // Every request takes two control periods of the board's time.
                    server.turn(now, due, asked.then(|| Event::Bytes(request::<GetStatus>(&()))));
                }
                let _ = told.try_recv();
                let passed = server.board.time() - server.start;
                // The board is ahead by at most one slice and one request, and behind by at most one turn.
                assert!((now - 0.003..now + 0.021).contains(&passed), "{passed} s in {now} s, asked: {asked}");
            }
        }
    }

    #[test]
    fn what_a_busy_computer_was_too_slow_for_is_skipped() {
        let mut board = board(1_000.0);
        let mut server = Server::new(&mut board, Pace::RealTime);
        while server.due(5.0) == Due::Time {
            server.turn(5.0, Due::Time, None);
        }
        let passed = server.board.time() - server.start;
        assert!((passed - CATCH_UP).abs() < 3.0 * SLICE, "{passed} s");
    }

    #[test]
    fn as_fast_as_it_can_it_waits_for_a_reader_and_does_not_take_its_own_haste_for_silence() {
        for (start, state) in
            [(request::<Arm>(&()), State::Armed), (request::<CheckPolarity>(&()), State::CheckingPolarity)]
        {
            let mut board = board(1_000.0);
            let rules = Rules { host_action: HostAction::Disarm, ..Rules::default() };
            board.receive(&request::<SetRules>(&rules));
            board.receive(&start);
            let mut server = Server::new(&mut board, Pace::AsFastAsItCan);
            assert_eq!(server.due(0.0), Due::Events, "nobody is there");
            let _told = connect(&mut server);
            let play = |server: &mut Server<'_>, now: f64| {
                while server.due(now) == Due::Time && server.board.status().state == state {
                    server.turn(now, Due::Time, None);
                }
                server.board.time() - server.start
            };
            let quarter = 0.25 * f64::from(rules.host_seconds);
            for now in [0.0, 0.5 * quarter, 2.0 * quarter, 3.0 * quarter] {
                let passed = play(&mut server, now);
                assert!((passed - now.max(quarter)).abs() < 3.0 * SLICE, "{passed} s at {now} s, {state:?}");
            }
            assert_eq!(server.board.status().state, state);
        }
    }

    #[test]
    fn a_tool_that_disarms_past_the_holder_hears_the_answer_although_the_holder_does_not_read() {
        let mut board = board(1_000.0);
        board.receive(&request::<Arm>(&()));
        let mut server = Server::new(&mut board, Pace::RealTime);
        let _holder = connect(&mut server);
        let (guest, told) = sync_channel(8);
        // In the middle of what the holder says.
        server.turn(0.0, Due::Events, Some(Event::Bytes(vec![1, 2, 3])));
        server.stop(0.0, (request::<Disarm>(&()), guest));
        assert_eq!(server.board.status().state, State::Disarmed);
        assert!(!told.try_recv().unwrap().is_empty());
        server.turn(1.5, Due::Events, None);
        assert!(server.tools.guests.is_empty(), "it has heard what it came for");
    }
}
