//! A wire that corrupts frames, for tests of programs that talk to a board.

use super::random::Random;
use haptic_bridge::board::telemetry::{Field, Fields};
use haptic_bridge::control::{HostAction, Rules};
use haptic_bridge::safety::fault::State;
use haptic_host::link::{Board, Losses, Wire};
use std::io;
use std::time::Duration;

/// A wire that corrupts one frame in a hundred in both directions. It inserts foreign bytes, or drops, doubles or swaps
/// one byte.
pub struct NoisyWire {
    wire: Box<dyn Wire>,
    random: Random,
    /// Number of next frames that pass unchanged, because a corrupted value in a first request might not be detected.
    unchanged_frames: u32,
}

impl NoisyWire {
    /// Arms the board at the other end with a host timeout of 0.5 s, and receives its telemetry for `steps` control
    /// steps.
    ///
    /// # Panics
    ///
    /// If the motors go off, if a row is neither received nor counted as missing, or if no frame was corrupted.
    pub fn check_telemetry(wire: Box<dyn Wire>, steps: u32) -> Losses {
        let noisy = Self { wire, random: Random::new(7), unchanged_frames: 16 };
        let mut board = Board::over(Box::new(noisy), "noisy").expect("the board replies");
        let rules = board.rules().expect("the board sends its rules");
        let with_host_timeout = Rules { host_action: HostAction::Disarm, host_seconds: 0.5, ..rules };
        board.set_rules(&with_host_timeout).expect("the board accepts the rules");
        board.keep_alive();
        board.arm().expect("the board arms");
        board.start_stream(Fields(Field::Angle.bit() | Field::State.bit()), 1).expect("the stream starts");
        let (mut first, mut last) = (None, 0);
        while first.is_none_or(|first| last - first < steps) {
            for row in board.rows(Duration::from_millis(100)).expect("the board sends rows") {
                assert!(row.step > last, "{} after {last}", row.step);
                (first, last) = (first.or(Some(row.step)), row.step);
            }
            let status = board.status().expect("the board sends its status");
            assert_eq!((status.state, status.fault), (State::Armed, None), "step {last}");
        }
        let losses = board.losses();
        let all = u64::from(last - first.unwrap_or(last) + 1);
        assert_eq!((losses.received + losses.missing, losses.dropped_by_board), (all, 0), "{losses}");
        assert!(losses.garbled > 0 && losses.batches_lost > 0, "{losses}");
        losses
    }

    fn corrupt(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut corrupted = Vec::new();
        for frame in bytes.split_inclusive(|byte| *byte == 0) {
            let mut frame = frame.to_vec();
            self.unchanged_frames = self.unchanged_frames.saturating_sub(1);
            if self.unchanged_frames == 0 && self.random.uniform() < 0.01 {
                let at = self.random.bits() as usize % frame.len();
                let (byte, next) = (frame[at], (at + 1) % frame.len());
                match self.random.bits() % 4 {
                    0 => drop(frame.splice(at..at, *b"AT\r\n")),
                    1 => drop(frame.remove(at)),
                    2 => frame.insert(at, byte),
                    _ => frame.swap(at, next),
                }
            }
            corrupted.extend(frame);
        }
        corrupted
    }
}

impl Wire for NoisyWire {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let corrupted = self.corrupt(bytes);
        self.wire.send(&corrupted)
    }
    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        // Half of the buffer stays free for injected bytes.
        let half = buffer.len() / 2;
        let count = self.wire.receive(&mut buffer[..half], timeout)?;
        let corrupted = self.corrupt(&buffer[..count]);
        buffer[..corrupted.len()].copy_from_slice(&corrupted);
        Ok(corrupted.len())
    }
    fn now(&self) -> Duration {
        self.wire.now()
    }
    fn slack(&self) -> Duration {
        self.wire.slack()
    }
}
