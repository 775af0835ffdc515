//! A connection over which a program sends forces. Requests are numbered and stamped, and the motors go off when the
//! program drops the session.

use super::board::Board;
use super::error::{BoardError, LinkError};
use super::ports::PortSpec;
use haptic_bridge::board::protocol::{ForceAnswer, ForceRequest, HostContact};
use haptic_bridge::safety::fault::{FaultRecord, State};
use std::ops::{Deref, DerefMut};
use std::time::Duration;

/// Time for which a request acts in full, s: longer than a frame of a game at 60 Hz (0.017 s).
pub const HOLD_S: f32 = 0.02;
/// Time over which a request fades to zero after acting in full, s.
pub const FADE_S: f32 = 0.05;

/// Time after which a request without a reply counts as unanswered. Until then the request is sent again every
/// [`FORCE_PATIENCE`](super::FORCE_PATIENCE), so that a briefly busy computer or board does not end a program's loop.
pub const PATIENCE: Duration = Duration::from_secs(1);

/// A board that this program holds, with all methods of [`Board`]. Dropping it disarms the board, also when the program
/// panics. If the program is killed, the board disarms because it watches its host.
///
/// ```no_run
/// use haptic_host::link::Session;
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let mut session = Session::open(&"tcp:localhost:7710".parse()?)?;
/// let state = session.read_state()?;
/// println!("the tip is at {:?} m, step {}", state.tip, state.step);
/// # Ok(())
/// # }
/// ```
pub struct Session {
    board: Board,
    sequence: u32,
    /// Step of the latest state that was received.
    latest_step: Option<u32>,
    /// The fault that had turned the motors off at `latest_step`.
    fault: Option<FaultRecord>,
    patience: Duration,
    /// Times for which a request acts in full and then fades, s; at most 0.2 each.
    pub lease: (f32, f32),
}

impl Session {
    /// Opens the board at a port, see [`Board::open`].
    pub fn open(port: &PortSpec) -> Result<Self, LinkError> {
        Ok(Self::of(Board::open(port)?))
    }
    /// Creates a session with an open board.
    pub fn of(board: Board) -> Self {
        Self { board, sequence: 0, latest_step: None, fault: None, patience: PATIENCE, lease: (HOLD_S, FADE_S) }
    }
    /// Turns the motors on and enables heartbeats while this session waits for telemetry. Forces and state requests act
    /// as heartbeats too.
    pub fn arm(&mut self) -> Result<(), BoardError> {
        self.board.keep_alive();
        self.board.arm()
    }
    /// Clears a latched fault.
    pub fn clear(&mut self) -> Result<(), BoardError> {
        self.fault = None;
        self.board.clear()
    }
    /// Returns the latched fault according to the latest reply.
    pub fn fault(&self) -> Option<FaultRecord> {
        self.fault
    }
    /// Sets the longest wait for a reply, and sends each request only once. For the default, see [`PATIENCE`].
    pub fn wait_for_forces(&mut self, patience: Duration) {
        self.patience = patience;
        self.board.wait_for_forces(patience);
    }
    /// Reads the device's state: tip (m), velocity (m/s), joint angles (rad).
    pub fn read_state(&mut self) -> Result<ForceAnswer, LinkError> {
        self.exchange(ForceRequest::default())
    }
    /// Pushes with a force (N) at the tip, in the task frame, which replaces the previous request. A refused force is
    /// not an error: [`ForceAnswer::done`] gives the reason.
    pub fn force(&mut self, force: [f32; 3]) -> Result<ForceAnswer, LinkError> {
        self.push(force, None)
    }
    /// Pushes with a force (N) at the tip and has the board render a plane.
    pub fn push(&mut self, force: [f32; 3], contact: Option<HostContact>) -> Result<ForceAnswer, LinkError> {
        let (hold, fade) = self.lease;
        self.exchange(ForceRequest { hold, fade, force, contact, ..ForceRequest::default() })
    }
    /// Pushes with torques (N m) at the joints, which replaces the previous request.
    pub fn torque(&mut self, torque: [f32; 3]) -> Result<ForceAnswer, LinkError> {
        let (hold, fade) = self.lease;
        self.exchange(ForceRequest { hold, fade, torque, ..ForceRequest::default() })
    }
    /// Sends any request, numbered and stamped with the latest received state.
    pub fn exchange(&mut self, request: ForceRequest) -> Result<ForceAnswer, LinkError> {
        let began = self.board.now();
        let reply = loop {
            self.sequence = self.sequence.wrapping_add(1);
            match self.board.force(&ForceRequest { sequence: self.sequence, seen: self.latest_step, ..request }) {
                Err(LinkError::Unanswered { .. }) if self.board.now() - began < self.patience => {}
                Err(LinkError::Unanswered { .. }) => return Err(LinkError::Unanswered { waited: self.patience }),
                reply => break reply?,
            }
        };
        if self.latest_step.replace(reply.step).is_none() && request.hold + request.fade == 0.0 {
            // A state request counts as a heartbeat only after an earlier state request.
            return self.exchange(request);
        }
        self.fault = match (reply.state, self.fault) {
            // If the status request fails, the next exchange reads the fault.
            (State::Fault, None) => self.board.status().ok().and_then(|status| status.fault),
            (State::Fault, known) => known,
            _ => None,
        };
        Ok(reply)
    }
}

impl Deref for Session {
    type Target = Board;
    fn deref(&self) -> &Board {
        &self.board
    }
}

impl DerefMut for Session {
    fn deref_mut(&mut self) -> &mut Board {
        &mut self.board
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        // A board that cannot be reached disarms by itself.
        let _ = self.board.disarm();
    }
}
