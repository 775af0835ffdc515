//! A board while a program uses it: what the program asks for is counted and stamped, and the motors go off when it
//! lets go of it.

use super::board::Board;
use super::error::{BoardError, LinkError};
use super::ports::PortSpec;
use haptic_bridge::board::protocol::{ForceAnswer, ForceRequest, HostContact};
use haptic_bridge::safety::fault::{FaultRecord, State};
use std::ops::{Deref, DerefMut};
use std::time::Duration;

/// Time for which a request acts in full, s: it bridges two frames of a game in which the computer is busy.
pub const HOLD: f32 = 0.02;
/// Time over which it then fades to nothing, s.
pub const FADE: f32 = 0.05;

/// For how long a request is sent again, each time that its answer does not come within
/// [`FORCE_PATIENCE`](super::FORCE_PATIENCE), before it counts as unanswered: a computer or a board that was busy for a
/// moment ends no program's loop.
pub const PATIENCE: Duration = Duration::from_secs(1);

/// A board that this program holds. Everything that a [`Board`] does it does as well; dropping it disarms the board,
/// also when the program panics. A program that is killed leaves that to the board's watch of its host.
///
/// ```no_run
/// use haptic_host::link::Session;
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let mut session = Session::open(&"tcp:localhost:7710".parse()?)?;
/// let state = session.look()?;
/// println!("the tip is at {:?} m, step {}", state.tip, state.step);
/// # Ok(())
/// # }
/// ```
pub struct Session {
    board: Board,
    sequence: u32,
    /// Step of the state that was told last.
    seen: Option<u32>,
    /// The fault that had turned the motors off when that state was reported.
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

    /// Holds a board that is open already.
    pub fn of(board: Board) -> Self {
        Self { board, sequence: 0, seen: None, fault: None, patience: PATIENCE, lease: (HOLD, FADE) }
    }

    /// Motors on. Whenever this session waits for telemetry it tells the board that somebody is there; forces and looks
    /// tell it as well.
    pub fn arm(&mut self) -> Result<(), BoardError> {
        self.board.keep_alive();
        self.board.arm()
    }

    /// Clears a latched fault.
    pub fn clear(&mut self) -> Result<(), BoardError> {
        self.fault = None;
        self.board.clear()
    }

    /// The latched fault, where the last answer told of one.
    pub fn fault(&self) -> Option<FaultRecord> {
        self.fault
    }

    /// For how long an answer is waited for, and that its request is sent once; without this, see [`PATIENCE`].
    pub fn wait_for_forces(&mut self, patience: Duration) {
        self.patience = patience;
        self.board.wait_for_forces(patience);
    }

    /// Reads the device's state: tip (m), velocity (m/s), joint angles (rad).
    pub fn look(&mut self) -> Result<ForceAnswer, LinkError> {
        self.exchange(ForceRequest::default())
    }

    /// Pushes with a force (N) at the tip, in the task frame, in the place of what was asked for before. A force that
    /// was not taken is no error: [`ForceAnswer::done`] says why.
    pub fn force(&mut self, force: [f32; 3]) -> Result<ForceAnswer, LinkError> {
        self.push(force, None)
    }

    /// Pushes with a force (N) at the tip and has the board render a plane.
    pub fn push(&mut self, force: [f32; 3], contact: Option<HostContact>) -> Result<ForceAnswer, LinkError> {
        let (hold, fade) = self.lease;
        self.exchange(ForceRequest { hold, fade, force, contact, ..ForceRequest::default() })
    }

    /// Pushes with torques (N m) at the joints, in the place of what was asked for before.
    pub fn torque(&mut self, torque: [f32; 3]) -> Result<ForceAnswer, LinkError> {
        let (hold, fade) = self.lease;
        self.exchange(ForceRequest { hold, fade, torque, ..ForceRequest::default() })
    }

    /// Sends any request, counted and stamped with the state that was told last.
    pub fn exchange(&mut self, request: ForceRequest) -> Result<ForceAnswer, LinkError> {
        let began = self.board.now();
        let answer = loop {
            self.sequence = self.sequence.wrapping_add(1);
            match self.board.force(&ForceRequest { sequence: self.sequence, seen: self.seen, ..request }) {
                Err(LinkError::Unanswered { .. }) if self.board.now() - began < self.patience => {}
                Err(LinkError::Unanswered { .. }) => return Err(LinkError::Unanswered { waited: self.patience }),
                answered => break answered?,
            }
        };
        if self.seen.replace(answer.step).is_none() && request.hold + request.fade == 0.0 {
            // Only a look that follows another is a sign of the host.
            return self.exchange(request);
        }
        self.fault = match (answer.state, self.fault) {
            // If the board does not report the fault now, the next answer asks again.
            (State::Fault, None) => self.board.status().ok().and_then(|status| status.fault),
            (State::Fault, known) => known,
            _ => None,
        };
        Ok(answer)
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
        // A board that cannot be reached any more sees to it itself.
        let _ = self.board.disarm();
    }
}
