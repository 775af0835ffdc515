//! A wire that spoils frames, for tests of what talks to a board.

use super::random::Random;
use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_bridge::control::{HostAction, Rules};
use haptic_bridge::safety::fault::State;
use haptic_host::link::{Board, Losses, Wire};
use std::io;
use std::time::Duration;

/// A wire on which one frame in a hundred, either way, has stray bytes injected, or one byte dropped, doubled or swapped
/// with the next.
pub struct SpoiltWire {
    wire: Box<dyn Wire>,
    random: Random,
    /// Frames that still pass unspoilt: a number that changes in a request to arm, say, is not seen.
    clean: u32,
}

impl SpoiltWire {
    /// Arms the board at the other end, has it watch its host, and follows it for so many control steps.
    ///
    /// # Panics
    ///
    /// When the motors go off, a row is neither received nor counted as missing, or no frame was spoilt.
    pub fn follow(wire: Box<dyn Wire>, steps: u32) -> Losses {
        let spoilt = Self { wire, random: Random::new(7), clean: 16 };
        let mut board = Board::over(Box::new(spoilt), "spoilt").expect("a board");
        let rules = board.rules().expect("it has rules");
        let watched = Rules { host_action: HostAction::Disarm, host_seconds: 0.5, ..rules };
        board.set_rules(&watched).expect("it watches its host");
        board.keep_alive();
        board.arm().expect("it arms");
        board.start_stream(Fields(Field::Angle.bit() | Field::State.bit()), 1).expect("a stream starts");
        let (mut first, mut last) = (None, 0);
        while first.is_none_or(|first| last - first < steps) {
            for row in board.rows(Duration::from_millis(100)).expect("rows come") {
                assert!(row.step > last, "{} after {last}", row.step);
                (first, last) = (first.or(Some(row.step)), row.step);
            }
            let status = board.status().expect("it answers");
            assert_eq!((status.state, status.fault), (State::Armed, None), "step {last}");
        }
        let losses = board.losses();
        let all = u64::from(last - first.unwrap_or(last) + 1);
        assert_eq!((losses.received + losses.missing, losses.dropped_by_board), (all, 0), "{losses}");
        assert!(losses.garbled > 0 && losses.batches_lost > 0, "{losses}");
        losses
    }

    fn pass(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut passed = Vec::new();
        for frame in bytes.split_inclusive(|byte| *byte == 0) {
            let mut frame = frame.to_vec();
            self.clean = self.clean.saturating_sub(1);
            if self.clean == 0 && self.random.uniform() < 0.01 {
                let at = self.random.bits() as usize % frame.len();
                let (byte, next) = (frame[at], (at + 1) % frame.len());
                match self.random.bits() % 4 {
                    0 => drop(frame.splice(at..at, *b"AT\r\n")),
                    1 => drop(frame.remove(at)),
                    2 => frame.insert(at, byte),
                    _ => frame.swap(at, next),
                }
            }
            passed.extend(frame);
        }
        passed
    }
}

impl Wire for SpoiltWire {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let passed = self.pass(bytes);
        self.wire.send(&passed)
    }
    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        // Injected bytes take room.
        let half = buffer.len() / 2;
        let count = self.wire.receive(&mut buffer[..half], timeout)?;
        let passed = self.pass(&buffer[..count]);
        buffer[..passed.len()].copy_from_slice(&passed);
        Ok(passed.len())
    }
    fn now(&self) -> Duration {
        self.wire.now()
    }
    fn slack(&self) -> Duration {
        self.wire.slack()
    }
}
