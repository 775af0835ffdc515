//! Serves a simulated board to other programs on a pseudo-terminal or a TCP address.
//!
//! One thread owns and runs the board. Other threads (`door.rs`) only move bytes through queues of bounded length, so
//! that no tool can exhaust memory.

use super::board::SimulatedBoard;
use super::door::{
    BLOCK_BYTES, DISARM_REPLY_TIME, DisarmRequest, Event, MAX_DISARM_REQUESTS, OutgoingBlocks, ToolListener,
};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, TryRecvError, TrySendError};
use std::time::{Duration, Instant};

/// The relation of simulated time to the wall clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// Simulated time follows the wall clock. It is ahead by at most one request or control period, and late if the
    /// computer is too slow.
    RealTime,
    /// Simulated time runs as fast as possible while a tool is connected and reads, without dropping telemetry. After a
    /// quarter of the silence that a board with a host timeout allows, simulated time runs no faster than the wall
    /// clock, so that a tool has time to send its heartbeat.
    AsFastAsItCan,
}

/// Simulated time between two polls of the link, s.
const SLICE_S: f64 = 1e-3;
/// Largest delay that a board in real time catches up after the computer was busy, s.
const MAX_CATCH_UP_S: f64 = 0.1;

/// Serves `board` on `door` until `stop` is set.
pub fn serve(board: &mut SimulatedBoard, door: &ToolListener, pace: Pace, stop: &AtomicBool) {
    let slice = Duration::from_secs_f64(SLICE_S);
    let began = Instant::now();
    let mut server = Server::new(board, pace);
    while !stop.load(Ordering::SeqCst) {
        let now = began.elapsed().as_secs_f64();
        if let Ok(stop) = door.stops.try_recv() {
            server.disarm_for_guest(now, stop);
        }
        let next_action = server.next_action(now);
        let event = match next_action {
            NextAction::Nothing => {
                std::thread::sleep(slice);
                continue;
            }
            NextAction::Events => door.events.recv_timeout(slice),
            NextAction::Time => door.events.try_recv().map_err(|error| match error {
                TryRecvError::Empty => RecvTimeoutError::Timeout,
                TryRecvError::Disconnected => RecvTimeoutError::Disconnected,
            }),
        };
        if matches!(event, Err(RecvTimeoutError::Disconnected)) {
            return;
        }
        server.advance(now, next_action, event.ok());
    }
}

/// The server's next action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum NextAction {
    /// Waits because the board is ahead of the clock. Events wait too, because a request takes some of the board's
    /// time.
    Nothing,
    /// Handles events.
    Events,
    /// Handles events and advances the board by a slice.
    Time,
}

/// A board and the tools connected to it. Its methods get the time since the start, s, from the caller instead of a
/// clock.
struct Server<'a> {
    board: &'a mut SimulatedBoard,
    pace: Pace,
    tools: Tools,
    /// The board's time at the start, s.
    start: f64,
    /// Time that was skipped because the computer was too slow, s.
    skipped_s: f64,
    /// Wall-clock time at which the host's silence began, and duration of the silence on the board's clock at the last
    /// check, s.
    silent_since: (f64, f64),
}

impl<'a> Server<'a> {
    fn new(board: &'a mut SimulatedBoard, pace: Pace) -> Self {
        let start = board.time();
        Self { board, pace, tools: Tools::default(), start, skipped_s: 0.0, silent_since: (0.0, 0.0) }
    }
    /// Returns the delay of the board behind the clock, s. Negative if the board is ahead, because requests take time
    /// and a slice ends with a control period.
    fn delay(&self, now: f64) -> f64 {
        now - self.skipped_s - (self.board.time() - self.start)
    }
    fn next_action(&mut self, now: f64) -> NextAction {
        let idle = match self.pace {
            Pace::RealTime if self.delay(now) < -SLICE_S => return NextAction::Nothing,
            Pace::RealTime => self.delay(now) < SLICE_S,
            Pace::AsFastAsItCan => self.outruns_host(now) || self.tools.has_no_reader(),
        };
        if idle { NextAction::Events } else { NextAction::Time }
    }

    fn outruns_host(&mut self, now: f64) -> bool {
        self.board.host_silence().is_some_and(|(silent, allowed)| {
            if silent < self.silent_since.1 {
                self.silent_since.0 = now;
            }
            self.silent_since.1 = silent;
            silent > (0.25 * allowed).max(now - self.silent_since.0)
        })
    }

    /// Carries out the action that was due at `now`.
    fn advance(&mut self, now: f64, next_action: NextAction, event: Option<Event>) {
        match event {
            Some(Event::Connected(outgoing)) => {
                self.tools.holder = Some(outgoing);
                self.silent_since = (now, 0.0);
            }
            Some(Event::Bytes(bytes)) => self.board.receive(&bytes),
            Some(Event::Gone) => {
                self.tools.holder = None;
                self.tools.waiting_block = None;
                self.board.hang_up();
            }
            None => {}
        }
        if next_action == NextAction::Time {
            if self.pace == Pace::RealTime {
                self.skipped_s += (self.delay(now) - MAX_CATCH_UP_S).max(0.0);
            }
            self.board.run(SLICE_S);
        }
        self.tools.guests.retain(|(_, since)| now - since < DISARM_REPLY_TIME.as_secs_f64());
        self.tools.send_blocks(self.board);
    }

    /// Disarms the board for a tool that does not hold it.
    fn disarm_for_guest(&mut self, now: f64, (request, answers): DisarmRequest) {
        // Ends a partial frame of the holder.
        self.board.receive(&[0]);
        self.board.receive(&request);
        if self.tools.guests.len() >= MAX_DISARM_REQUESTS {
            self.tools.guests.remove(0);
        }
        self.tools.guests.push((answers, now));
        self.tools.send_blocks(self.board);
    }
}

/// The tools that receive the board's bytes.
#[derive(Default)]
struct Tools {
    holder: Option<OutgoingBlocks>,
    /// The block that the holder has not accepted yet.
    waiting_block: Option<Vec<u8>>,
    /// Tools that disarmed the board without holding it, and the times of their requests, s.
    guests: Vec<(OutgoingBlocks, f64)>,
}

impl Tools {
    fn has_no_reader(&self) -> bool {
        self.guests.is_empty() && (self.holder.is_none() || self.waiting_block.is_some())
    }
    /// Sends the board's bytes to the tools until the holder accepts no more. For a guest, continues and drops the
    /// blocks that the holder does not accept.
    fn send_blocks(&mut self, board: &mut SimulatedBoard) {
        while self.holder.is_some() || !self.guests.is_empty() {
            let block = self.waiting_block.take().unwrap_or_else(|| {
                let mut block = vec![0; BLOCK_BYTES];
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
                    self.waiting_block = Some(block);
                    return;
                }
                // The reading thread will report the end of the connection.
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

    /// Connects a tool; returns the blocks for it.
    fn connect(server: &mut Server<'_>) -> Receiver<Vec<u8>> {
        let (outgoing, received) = sync_channel(8);
        server.advance(0.0, NextAction::Events, Some(Event::Connected(outgoing)));
        received
    }

    #[test]
    fn in_real_time_the_board_follows_the_clock_under_any_load() {
        for with_requests in [false, true] {
            let mut board = board(200.0);
            let mut server = Server::new(&mut board, Pace::RealTime);
            let received = connect(&mut server);
            for turn in 1..2_000 {
                let now = 0.25e-3 * f64::from(turn);
                let next_action = server.next_action(now);
                if next_action != NextAction::Nothing {
                    // Every request takes two control periods, 10 ms.
                    server.advance(now, next_action, with_requests.then(|| Event::Bytes(request::<GetStatus>(&()))));
                }
                let _ = received.try_recv();
                let passed = server.board.time() - server.start;
                // The board is ahead by at most one slice and one request, and behind by at most one turn.
                assert!(
                    (now - 0.003..now + 0.021).contains(&passed),
                    "{passed} s in {now} s, with requests: {with_requests}"
                );
            }
        }
    }

    #[test]
    fn time_lost_on_a_busy_computer_is_skipped() {
        let mut board = board(1_000.0);
        let mut server = Server::new(&mut board, Pace::RealTime);
        while server.next_action(5.0) == NextAction::Time {
            server.advance(5.0, NextAction::Time, None);
        }
        let passed = server.board.time() - server.start;
        assert!((passed - MAX_CATCH_UP_S).abs() < 3.0 * SLICE_S, "{passed} s");
    }

    #[test]
    fn fast_mode_waits_for_a_reader_and_never_outruns_the_host() {
        for (start, state) in
            [(request::<Arm>(&()), State::Armed), (request::<CheckPolarity>(&()), State::CheckingPolarity)]
        {
            let mut board = board(1_000.0);
            let rules = Rules { host_action: HostAction::Disarm, ..Rules::default() };
            board.receive(&request::<SetRules>(&rules));
            board.receive(&start);
            let mut server = Server::new(&mut board, Pace::AsFastAsItCan);
            assert_eq!(server.next_action(0.0), NextAction::Events, "no tool is connected");
            let _received = connect(&mut server);
            let play = |server: &mut Server<'_>, now: f64| {
                while server.next_action(now) == NextAction::Time && server.board.status().state == state {
                    server.advance(now, NextAction::Time, None);
                }
                server.board.time() - server.start
            };
            let quarter = 0.25 * f64::from(rules.host_seconds);
            for now in [0.0, 0.5 * quarter, 2.0 * quarter, 3.0 * quarter] {
                let passed = play(&mut server, now);
                assert!((passed - now.max(quarter)).abs() < 3.0 * SLICE_S, "{passed} s at {now} s, {state:?}");
            }
            assert_eq!(server.board.status().state, state);
        }
    }

    #[test]
    fn a_guest_gets_its_reply_despite_a_blocked_holder() {
        let mut board = board(1_000.0);
        board.receive(&request::<Arm>(&()));
        let mut server = Server::new(&mut board, Pace::RealTime);
        let _holder = connect(&mut server);
        let (guest, received) = sync_channel(8);
        // A partial frame of the holder, which the guest's request interrupts.
        server.advance(0.0, NextAction::Events, Some(Event::Bytes(vec![1, 2, 3])));
        server.disarm_for_guest(0.0, (request::<Disarm>(&()), guest));
        assert_eq!(server.board.status().state, State::Disarmed);
        assert!(!received.try_recv().unwrap().is_empty());
        server.advance(1.5, NextAction::Events, None);
        assert!(server.tools.guests.is_empty(), "the guest has received its reply");
    }
}
