//! A strict simulated board in this process, and a connection that loses messages.

use super::{board, shipped_device};
use haptic_bridge::model::description::{Description, Encoder};
use haptic_bridge::render::scene::Scene;
use haptic_host::link::{Board, Session, Wire};
use haptic_sim::{BoardOptions, SharedBoard, Support};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// Declares the motors of the first two joints verified and limits these joints to ±4 rad.
pub fn verify_motors(description: &mut Description) {
    for joint in &mut description.joints[..2] {
        joint.motor.as_mut().unwrap().verified = true;
        joint.limits = Some((-4.0, 4.0));
    }
}

/// Returns a board that can be armed: 1 kHz, a verified five-bar with an encoder without a motor in free space, homed, polarity checked.
pub fn strict_board() -> (SharedBoard, Session) {
    let mut file = shipped_device("coupled-five-bar");
    verify_motors(&mut file.description);
    file.description.sensed[0] = Some(Encoder { counts_per_turn: 4_000.0, offset: 0.0, inverted: false });
    let options = BoardOptions { strict: true, support: Support::Held, ..BoardOptions::default() };
    let (shared, board) = board(&file, options);
    let mut session = Session::of(board);
    session.set_scene(&Scene { task: 2, rate_hz: 1_000.0, cutoff_hz: 50.0, ..Scene::default() }).unwrap();
    session.home().unwrap();
    session.check_polarity().unwrap();
    session.wait_for_polarity().unwrap().require_pass().unwrap();
    session.home_at_rest().unwrap();
    (shared, session)
}

/// A wire that loses a given number of the next messages to the board.
pub struct LossyWire {
    wire: Box<dyn Wire>,
    loses: Arc<AtomicU32>,
}

impl LossyWire {
    /// Returns a session over a lossy wire, and the number of next messages to lose, initially 0.
    pub fn session(board: &SharedBoard) -> (Session, Arc<AtomicU32>) {
        let loses = Arc::new(AtomicU32::new(0));
        let wire = Self { wire: board.wire(), loses: loses.clone() };
        (Session::of(Board::over(Box::new(wire), "sim").unwrap()), loses)
    }
}

impl Wire for LossyWire {
    fn send(&mut self, bytes: &[u8]) -> std::io::Result<()> {
        let message_to_lose = self.loses.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1));
        if message_to_lose.is_ok() { Ok(()) } else { self.wire.send(bytes) }
    }
    fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> std::io::Result<usize> {
        self.wire.receive(buffer, timeout)
    }
    fn now(&self) -> Duration {
        self.wire.now()
    }
}
