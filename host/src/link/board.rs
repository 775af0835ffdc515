//! A board on an open wire, with one method for every endpoint of the protocol.

use super::client::{Client, HEARTBEAT_INTERVAL, Patience, SentRequest};
use super::error::{BoardError, LinkError};
use super::telemetry::{Losses, Row, Rows};
use super::wire::Wire;
use crate::error::Failure;
use crate::words::fault_and_remedy;
use haptic_bridge::board::protocol::{self as p, Details, GainsRequest, Info, Outcome, PROTOCOL};
use haptic_bridge::board::settings::{Entry, Key};
use haptic_bridge::board::telemetry::{Fields, StreamRequest};
use haptic_bridge::control::{Rules, Status};
use haptic_bridge::model::cogging::Potentials;
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::render::velocity::Estimator;
use haptic_bridge::safety::fault::{FaultRecord, State};
use haptic_bridge::safety::refusal::Refusal;
use postcard_rpc::Endpoint;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::time::Duration;

/// Retry interval and longest wait for a reply. The interval allows several retries within the 0.5 s after which a
/// board may consider its host lost. [`Wire::slack`] is added to the wait.
const REPLY: Patience = (Duration::from_millis(100), Duration::from_secs(2));
/// Retry interval and longest wait for a flash write, which erases two sectors of 16 KB (STM32F405 data sheet).
const FLASH_REPLY: Patience = (Duration::from_secs(3), Duration::from_secs(6));
/// Retry interval and longest wait for a disarm request: short, because the user must know soon if the motors may still
/// be on.
const STOP_REPLY: Patience = (Duration::from_millis(100), Duration::from_secs(4));
/// Number of consecutive unreadable batches after which a stream ends with an error; fewer may be corrupted frames.
const MAX_UNREADABLE_BATCHES: u32 = 50;
/// Default wait for the reply to a force, longer than the lease that [`super::Session`] gives the force.
pub const FORCE_PATIENCE: Duration = Duration::from_millis(100);

/// The result of a polarity check.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PolarityOutcome {
    /// Every motor turns its joint the right way.
    Right,
    /// A fault ended the check.
    Fault(FaultRecord),
    /// Another program turned the motors off.
    Stopped,
}

impl PolarityOutcome {
    /// Returns an error with the cause if the check did not pass.
    pub fn require_pass(self) -> Result<(), Failure> {
        match self {
            Self::Right => Ok(()),
            Self::Fault(record) => Err(Failure::impossible(fault_and_remedy(&record))),
            Self::Stopped => Err(Failure::impossible("another program ended the check").remedy("start it again")),
        }
    }
}

/// A board whose motors [`Board::stop`] has turned off.
pub enum StopOutcome {
    /// The open board.
    Open(Box<Board>),
    /// A board with this other protocol version, which accepts no further requests.
    OtherProtocol(u16),
    /// A board that another tool holds.
    Held,
}

/// An open board of this tool's protocol version.
pub struct Board {
    client: Client,
    port: String,
    info: Info,
    rows: Rows,
    garbled_before: u64,
    last_heartbeat: Option<Duration>,
    /// The step in the reply to the latest heartbeat.
    step: u32,
    force_patience: Duration,
    /// Identifies this tool's staged settings and its key.
    session: u32,
    faults: Vec<FaultRecord>,
}

impl Board {
    /// Opens the board on an open wire. Messages name `port` as its port.
    pub fn over(wire: Box<dyn Wire>, port: impl Into<String>) -> Result<Self, LinkError> {
        Self::handshake(Self::connect(wire)?, port.into())
    }
    fn connect(wire: Box<dyn Wire>) -> Result<Client, LinkError> {
        let mut client = Client::new(wire);
        // A killed tool may have left a partial request in the board's buffer: end it first.
        client.end_frame()?;
        Ok(client)
    }

    /// Opens the board on an open wire and turns its motors off with the first request, in any version of the protocol.
    /// A server carries out this request even while another tool holds the board.
    pub fn stop_over(wire: Box<dyn Wire>, port: impl Into<String>) -> Result<StopOutcome, BoardError> {
        let (mut client, port) = (Self::connect(wire)?, port.into());
        match client.call::<p::Disarm>(&(), STOP_REPLY) {
            Err(_) if client.is_occupied() => return Err(LinkError::HeldByAnother(port).into()),
            outcome => outcome??,
        }
        Ok(match Self::handshake(client, port) {
            Ok(board) => StopOutcome::Open(Box::new(board)),
            Err(LinkError::Version { board, .. }) => StopOutcome::OtherProtocol(board),
            Err(_) => StopOutcome::Held,
        })
    }

    fn handshake(mut client: Client, port: String) -> Result<Self, LinkError> {
        let info = match client.call::<p::GetInfo>(&(), (REPLY.0, REPLY.1 + client.slack())) {
            Err(_) if client.is_occupied() => return Err(LinkError::HeldByAnother(port)),
            other => other?,
        };
        if info.protocol != PROTOCOL {
            return Err(LinkError::Version { board: info.protocol, tool: PROTOCOL });
        }
        let session = client.draw();
        Ok(Self {
            client,
            port,
            info,
            rows: Rows::of(0, Fields(0), 0),
            garbled_before: 0,
            last_heartbeat: None,
            step: 0,
            force_patience: FORCE_PATIENCE,
            session,
            faults: Vec::new(),
        })
    }

    /// Returns the port's name.
    pub fn port(&self) -> &str {
        &self.port
    }
    /// Returns the board's description of itself.
    pub fn info(&self) -> &Info {
        &self.info
    }
    /// Returns the time of the wire's clock: simulated time on a simulated board.
    pub fn now(&self) -> Duration {
        self.client.now()
    }
    fn call<E: Endpoint>(&mut self, request: &E::Request, patience: Patience) -> Result<E::Response, LinkError>
    where
        E::Request: Serialize,
        E::Response: DeserializeOwned,
    {
        self.client.call::<E>(request, (patience.0, patience.1 + self.client.slack()))
    }

    fn change<E: Endpoint<Response = Outcome>>(&mut self, request: &E::Request) -> Result<(), BoardError>
    where
        E::Request: Serialize,
    {
        Ok(self.call::<E>(request, REPLY)??)
    }

    /// Returns the outcome of a request to turn the motors on. If the first reply was lost, the board refuses the
    /// repeated request because the motors are already on; this refusal counts as success.
    fn allow_armed(&self, outcome: Result<(), BoardError>) -> Result<(), BoardError> {
        match outcome {
            Err(BoardError::Refused(Refusal::Armed)) if self.client.repeats > 0 => Ok(()),
            outcome => outcome,
        }
    }

    /// Reads the board's name and further details.
    pub fn details(&mut self) -> Result<Details, LinkError> {
        self.call::<p::GetDetails>(&(), REPLY)
    }
    /// Reads state, homing and latched fault.
    pub fn status(&mut self) -> Result<Status, LinkError> {
        self.call::<p::GetStatus>(&(), REPLY)
    }
    /// Loads a device, which makes homing and the polarity check invalid.
    pub fn set_device(&mut self, device: &p::DeviceData) -> Result<(), BoardError> {
        self.change::<p::SetDevice>(device)
    }
    /// Reads the loaded device.
    pub fn device(&mut self) -> Result<Option<p::DeviceData>, LinkError> {
        self.call::<p::GetDevice>(&(), REPLY)
    }
    /// Loads a scene.
    pub fn set_scene(&mut self, scene: &Scene<f32>) -> Result<(), BoardError> {
        self.change::<p::SetScene>(scene)
    }
    /// Reads the loaded scene.
    pub fn scene(&mut self) -> Result<Option<p::SceneData>, LinkError> {
        self.call::<p::GetScene>(&(), REPLY)
    }
    /// Changes the gains of one wall, also while it is in contact.
    pub fn set_wall_gains(&mut self, gains: Gains<f32>) -> Result<(), BoardError> {
        self.change::<p::SetGains>(&GainsRequest { wall: Some(gains), estimator: None })
    }
    /// Changes the velocity estimators of all walls, with the cutoff in Hz.
    pub fn set_estimator(&mut self, estimator: Estimator, cutoff_hz: f32) -> Result<(), BoardError> {
        self.change::<p::SetGains>(&GainsRequest { wall: None, estimator: Some((estimator, cutoff_hz)) })
    }
    /// Sets limits and rules. Limits may only be raised while disarmed.
    pub fn set_rules(&mut self, rules: &Rules) -> Result<(), BoardError> {
        self.change::<p::SetRules>(rules)
    }
    /// Reads limits and rules.
    pub fn rules(&mut self) -> Result<Rules, LinkError> {
        self.call::<p::GetRules>(&(), REPLY)
    }
    /// Reads the potentials of the motors, whose cogging the board compensates.
    pub fn cogging(&mut self) -> Result<Potentials, LinkError> {
        self.call::<p::GetCogging>(&(), REPLY)
    }
    /// Sets the potentials of the motors. The motors must be off.
    pub fn set_cogging(&mut self, cogging: &Potentials) -> Result<(), BoardError> {
        self.change::<p::SetCogging>(cogging)
    }
    /// Declares the present pose to be the device's home pose. Homes a device with index marks by the marks that its
    /// joints have passed.
    pub fn home(&mut self) -> Result<(), BoardError> {
        self.change::<p::Home>(&())
    }
    /// Declares home as soon as the device is at rest; gives up after 1 s of the board's time. The wait lets a user
    /// steady the device, or a simulated hand return the device after a polarity check.
    pub fn home_at_rest(&mut self) -> Result<(), BoardError> {
        let until = self.now() + Duration::from_secs(1) + self.client.slack();
        while let Err(error) = self.home() {
            if !matches!(error, BoardError::Refused(Refusal::Moving)) || self.now() >= until {
                return Err(error);
            }
            self.rows(Duration::from_millis(20))?;
        }
        Ok(())
    }
    /// Starts the polarity check, which moves each joint by a small torque.
    pub fn check_polarity(&mut self) -> Result<(), BoardError> {
        let outcome = self.change::<p::CheckPolarity>(&());
        self.allow_armed(outcome)
    }
    /// Starts to push each joint to its stop while a dead man's key is held, see [`Board::arm_held`] for `seen`. The
    /// device is homed when its state is no longer [`State::Homing`] and [`Status::homed`] is true.
    pub fn find_stops(&mut self, seen: u32) -> Result<(), BoardError> {
        let outcome = self.change::<p::FindStops>(&p::Press { holder: self.session, seen });
        self.allow_armed(outcome)
    }
    /// Turns the motors on.
    pub fn arm(&mut self) -> Result<(), BoardError> {
        let outcome = self.change::<p::Arm>(&());
        self.allow_armed(outcome)
    }
    /// Turns the motors off.
    pub fn disarm(&mut self) -> Result<(), BoardError> {
        self.change::<p::Disarm>(&())
    }
    /// Returns the latest control step that the board has reported in reply to a heartbeat, see [`Board::keep_alive`].
    /// Observations of a dead man's key use this step as their time stamp.
    pub fn step(&self) -> u32 {
        self.step
    }
    /// Turns the motors on for as long as a dead man's key is held. `seen` is the latest [`Board::step`] before the key
    /// was seen down. 0.5 s after this step the board turns its motors off with a fault, unless [`Board::hold_key`] has
    /// sent a newer step. If the 0.5 s have already passed, the board refuses to arm.
    pub fn arm_held(&mut self, seen: u32) -> Result<(), BoardError> {
        let outcome = self.change::<p::ArmHeld>(&p::Press { holder: self.session, seen });
        self.allow_armed(outcome)
    }
    /// Reports that the key is still down, see [`Board::arm_held`]. The board accepts the report only from the `Board`
    /// that armed it.
    pub fn hold_key(&mut self, seen: u32) -> Result<(), LinkError> {
        self.heartbeat(p::Beat::Held(p::Press { holder: self.session, seen }))
    }
    /// Requests a force at the tip, joint torques or a contact, for the duration of its lease, and reads the device's
    /// state. The reply names a request that was not carried out.
    pub fn force(&mut self, request: &p::ForceRequest) -> Result<p::ForceAnswer, LinkError> {
        let sent = self.send_force(request)?;
        self.force_answer(sent)
    }
    /// Sends the request of [`Board::force`] without waiting for the reply, so that a program can send its next request
    /// meanwhile. Two pending requests are enough, and at most eight are kept. Replies come in the order of the
    /// requests.
    pub fn send_force(&mut self, request: &p::ForceRequest) -> Result<SentRequest, LinkError> {
        self.client.send::<p::Force>(request)
    }
    /// Waits for the reply to [`Board::send_force`], at most as long as [`Board::wait_for_forces`] allows. Returns an
    /// error without waiting if the reply to a later request has come.
    pub fn force_answer(&mut self, sent: SentRequest) -> Result<p::ForceAnswer, LinkError> {
        let (began, patience) = (self.now(), self.force_patience);
        let reply = self.client.reply::<p::Force>(sent, patience);
        reply.map_err(|error| match error {
            LinkError::Silent { .. } | LinkError::Rejected { .. } | LinkError::Unreadable { .. } => {
                LinkError::Unanswered { waited: patience.min(self.now() - began) }
            }
            error => error,
        })
    }
    /// Sets the longest wait for the reply to a force; the default is [`FORCE_PATIENCE`].
    pub fn wait_for_forces(&mut self, patience: Duration) {
        self.force_patience = patience;
    }
    /// Clears a latched fault.
    pub fn clear(&mut self) -> Result<(), BoardError> {
        self.change::<p::Clear>(&())
    }
    /// Reads the faults since the board started, oldest first.
    pub fn faults(&mut self) -> Result<p::FaultList, LinkError> {
        self.call::<p::GetFaults>(&(), REPLY)
    }
    /// Returns the faults that the board has reported without a request since the last call.
    pub fn take_reported_faults(&mut self) -> Vec<FaultRecord> {
        std::mem::take(&mut self.faults)
    }
    /// Writes all settings to flash, only while disarmed. The board pauses for up to 1 s.
    pub fn save(&mut self) -> Result<(), BoardError> {
        Ok(self.call::<p::Save>(&(), FLASH_REPLY)??)
    }
    /// Reads the bytes of a stored setting.
    pub fn read_entry(&mut self, key: Key) -> Result<Option<Entry>, LinkError> {
        self.call::<p::ReadEntry>(&key, REPLY)
    }
    /// Stages a setting's bytes until [`Board::commit_entries`] names its key. Only this `Board` can commit them, and
    /// only until another `Board` stages an entry.
    pub fn stage_entry(&mut self, key: Key, entry: Entry) -> Result<(), BoardError> {
        Ok(self.call::<p::StageEntry>(&p::WriteEntry { session: self.session, key, entry }, FLASH_REPLY)??)
    }
    /// Applies the staged settings of these keys and writes them to flash, as one change.
    pub fn commit_entries(&mut self, keys: &p::KeyList) -> Result<(), BoardError> {
        let commit = p::Commit { session: self.session, keys: keys.clone() };
        Ok(self.call::<p::CommitEntries>(&commit, FLASH_REPLY)??)
    }
    /// Sets the board's name.
    pub fn set_name(&mut self, name: &p::Name) -> Result<(), BoardError> {
        Ok(self.call::<p::SetName>(name, FLASH_REPLY)??)
    }
    /// Restarts the board into the chip's own boot loader, for flashing over USB.
    pub fn enter_dfu(&mut self) -> Result<(), BoardError> {
        self.change::<p::EnterDfu>(&())
    }
    /// Restarts the board.
    pub fn restart(&mut self) -> Result<(), BoardError> {
        self.change::<p::Restart>(&())
    }
    /// Enables heartbeats, which this `Board` then sends every 50 ms while it waits for telemetry or a reply.
    pub fn keep_alive(&mut self) {
        self.client.sends_heartbeats = true;
    }
    /// Waits for the end of the polarity check that [`Board::check_polarity`] started, and returns its outcome. Sends
    /// heartbeats meanwhile.
    pub fn wait_for_polarity(&mut self) -> Result<PolarityOutcome, BoardError> {
        let before = std::mem::replace(&mut self.client.sends_heartbeats, true);
        let outcome = self.polarity_outcome();
        self.client.sends_heartbeats = before;
        outcome
    }

    fn polarity_outcome(&mut self) -> Result<PolarityOutcome, BoardError> {
        loop {
            // No telemetry comes: this call only waits and advances a simulated board's time.
            self.rows(Duration::from_millis(100))?;
            let status = self.status()?;
            match (status.state, status.fault) {
                (State::CheckingPolarity, _) => {}
                (_, Some(record)) => return Ok(PolarityOutcome::Fault(record)),
                _ if status.polarity => return Ok(PolarityOutcome::Right),
                _ => return Ok(PolarityOutcome::Stopped),
            }
        }
    }

    /// Starts a stream of `fields` at every `divider`-th step, and resets the count of losses.
    pub fn start_stream(&mut self, fields: Fields, divider: u32) -> Result<(), BoardError> {
        // A random number distinguishes this stream from a stream of an earlier tool.
        let stream = self.client.draw();
        self.rows = Rows::of(stream, fields, divider);
        self.garbled_before = self.client.garbled_sequences();
        self.change::<p::Stream>(&StreamRequest { fields, divider, stream })
    }

    /// Stops the stream. The next [`Board::rows`] returns the rows that the board sent before it stopped.
    pub fn stop_stream(&mut self) -> Result<(), BoardError> {
        self.change::<p::Stream>(&StreamRequest { fields: Fields(0), divider: 0, stream: 0 })
    }
    /// Returns the received rows, and waits at most `timeout` for the first row. Stores reported faults for
    /// [`Board::take_reported_faults`].
    pub fn rows(&mut self, timeout: Duration) -> Result<Vec<Row>, LinkError> {
        let deadline = self.client.now() + timeout;
        let mut rows = Vec::new();
        loop {
            self.heartbeat_if_due()?;
            let left = deadline.saturating_sub(self.client.now());
            let wait = if rows.is_empty() { left.min(HEARTBEAT_INTERVAL) } else { Duration::ZERO };
            match self.client.topic(wait)? {
                Some(frame) => {
                    if let Some(batch) = frame.message::<p::Telemetry>() {
                        match batch {
                            Ok(batch) => self.rows.take(&batch, &mut rows),
                            Err(error) if self.rows.count_corrupted() > MAX_UNREADABLE_BATCHES => return Err(error),
                            Err(_) => {}
                        }
                    } else if let Some(record) = frame.message::<p::FaultSeen>() {
                        // Ignores a corrupted record, because the board's list of faults still contains the fault.
                        self.faults.extend(record);
                    }
                }
                None if !rows.is_empty() || left.is_zero() => return Ok(rows),
                None => {}
            }
        }
    }

    /// Returns the losses of the stream so far.
    pub fn losses(&self) -> Losses {
        let losses = self.rows.losses();
        Losses { garbled: losses.garbled + self.client.garbled_sequences() - self.garbled_before, ..losses }
    }
    fn heartbeat_if_due(&mut self) -> Result<(), LinkError> {
        let now = self.client.now();
        if self.client.sends_heartbeats
            && self.last_heartbeat.is_none_or(|last| now.saturating_sub(last) >= HEARTBEAT_INTERVAL)
        {
            self.heartbeat(p::Beat::Here)?;
        }
        Ok(())
    }

    fn heartbeat(&mut self, beat: p::Beat) -> Result<(), LinkError> {
        self.last_heartbeat = Some(self.now());
        self.step = self.call::<p::Heartbeat>(&beat, (HEARTBEAT_INTERVAL, REPLY.1))?;
        Ok(())
    }
}
