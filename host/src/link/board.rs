//! A board as a program sees it: one method for every endpoint of the protocol.

use super::client::{Client, HEARTBEAT, Patience, Sent};
use super::error::{BoardError, LinkError};
use super::telemetry::{Losses, Row, Rows};
use super::wire::Wire;
use crate::error::Failure;
use crate::words::fault_and_remedy;
use haptic_bridge::board::protocol::{self as p, Details, GainsRequest, Info, Outcome, PROTOCOL};
use haptic_bridge::board::settings::{Entry, Key};
use haptic_bridge::board::telemetry::{Fields, StreamRequest};
use haptic_bridge::control::{Rules, Status};
use haptic_bridge::model::precomputed::{MassModelData, TableChunk};
use haptic_bridge::render::controller::Gains;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::render::velocity::Estimator;
use haptic_bridge::safety::fault::{FaultRecord, State};
use haptic_bridge::safety::refusal::Refusal;
use postcard_rpc::Endpoint;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::time::Duration;

/// Values of a table that travel in one message.
const TABLE_PIECE: usize = 64;
/// Time after which a request is sent again, some times within the half second after which a board may take its host for
/// lost, and time a board may take to answer; a board that is a process also waits for its turn ([`Wire::slack`]).
const ANSWER: Patience = (Duration::from_millis(100), Duration::from_secs(2));
/// The same when it writes flash: two sector erases of 16 KB and the writing (STM32F405 data sheet).
const FLASH_ANSWER: Patience = (Duration::from_secs(3), Duration::from_secs(6));
/// The same when it is to turn its motors off: who asks for that is told soon that they may be on.
const STOP_ANSWER: Patience = (Duration::from_millis(100), Duration::from_secs(4));
/// Batches in a row that cannot be read before a stream ends with an error: fewer may be spoilt frames.
const UNREADABLE: u32 = 50;
/// Time to wait for the answer to a force, unless a program says otherwise: until then its lease has run out by itself,
/// as [`super::Session`] sets it.
pub const FORCE_PATIENCE: Duration = Duration::from_millis(100);

/// The result of a polarity check.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PolarityOutcome {
    /// Every motor turns its joint the right way.
    Right,
    /// A fault ended it.
    Fault(FaultRecord),
    /// Somebody else turned the motors off.
    Stopped,
}

impl PolarityOutcome {
    /// Nothing more where it passed; else what ended it before.
    pub fn passed(self) -> Result<(), Failure> {
        match self {
            Self::Right => Ok(()),
            Self::Fault(record) => Err(Failure::impossible(fault_and_remedy(&record))),
            Self::Stopped => Err(Failure::impossible("the check was ended from outside").remedy("start it again")),
        }
    }
}

/// A board whose motors [`Board::stop`] has turned off.
pub enum Stopped {
    /// It is this tool's now.
    Open(Box<Board>),
    /// It speaks this version of the protocol, so nothing more can be asked of it.
    Unlike(u16),
    /// Another tool holds it.
    Past,
}

/// An open board of this tool's protocol version.
pub struct Board {
    client: Client,
    port: String,
    info: Info,
    rows: Rows,
    garbled_before: u64,
    last_heartbeat: Option<Duration>,
    /// The step that the board told in answer to the newest heartbeat.
    step: u32,
    force_patience: Duration,
    /// By which the board tells what this tool has put aside, and whose key it holds, from what another has and does.
    session: u32,
    faults: Vec<FaultRecord>,
}

impl Board {
    /// A board behind an open wire; `port` is what messages call it.
    pub fn over(wire: Box<dyn Wire>, port: impl Into<String>) -> Result<Self, LinkError> {
        Self::greet(Self::reach(wire)?, port.into())
    }

    fn reach(wire: Box<dyn Wire>) -> Result<Client, LinkError> {
        let mut client = Client::new(wire);
        // A tool that was killed may have left half a request in the board's buffer: end it first.
        client.end_frame()?;
        Ok(client)
    }

    /// Turns the motors of a board behind an open wire off, before anything else is asked of it: of any version of the
    /// protocol, and also where a server lets only this request past the tool that holds the board.
    pub fn stop_over(wire: Box<dyn Wire>, port: impl Into<String>) -> Result<Stopped, BoardError> {
        let (mut client, port) = (Self::reach(wire)?, port.into());
        match client.call::<p::Disarm>(&(), STOP_ANSWER) {
            Err(_) if client.was_told_occupied() => return Err(LinkError::HeldByAnother(port).into()),
            outcome => outcome??,
        }
        Ok(match Self::greet(client, port) {
            Ok(board) => Stopped::Open(Box::new(board)),
            Err(LinkError::Version { board, .. }) => Stopped::Unlike(board),
            Err(_) => Stopped::Past,
        })
    }

    fn greet(mut client: Client, port: String) -> Result<Self, LinkError> {
        let info = match client.call::<p::GetInfo>(&(), (ANSWER.0, ANSWER.1 + client.slack())) {
            Err(_) if client.was_told_occupied() => return Err(LinkError::HeldByAnother(port)),
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

    /// The port's name.
    pub fn port(&self) -> &str {
        &self.port
    }
    /// The board's description of itself.
    pub fn info(&self) -> &Info {
        &self.info
    }
    /// The wire's clock: simulated time on a simulated board.
    pub fn now(&self) -> Duration {
        self.client.now()
    }

    fn ask<E: Endpoint>(&mut self, request: &E::Request, patience: Patience) -> Result<E::Response, LinkError>
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
        Ok(self.ask::<E>(request, ANSWER)??)
    }

    /// The outcome of a request to turn the motors on. One whose answer was lost is refused when it is repeated, because
    /// they are on.
    fn on(&self, outcome: Result<(), BoardError>) -> Result<(), BoardError> {
        match outcome {
            Err(BoardError::Refused(Refusal::Armed)) if self.client.repeats > 0 => Ok(()),
            outcome => outcome,
        }
    }

    /// The rest of what the board says of itself.
    pub fn details(&mut self) -> Result<Details, LinkError> {
        self.ask::<p::GetDetails>(&(), ANSWER)
    }
    /// State, homing, latched fault.
    pub fn status(&mut self) -> Result<Status, LinkError> {
        self.ask::<p::GetStatus>(&(), ANSWER)
    }
    /// Loads a device; homing and the polarity check are forgotten.
    pub fn set_device(&mut self, device: &p::DeviceData) -> Result<(), BoardError> {
        self.change::<p::SetDevice>(device)
    }
    /// The loaded device.
    pub fn device(&mut self) -> Result<Option<p::DeviceData>, LinkError> {
        self.ask::<p::GetDevice>(&(), ANSWER)
    }
    /// Loads a scene.
    pub fn set_scene(&mut self, scene: &Scene<f32>) -> Result<(), BoardError> {
        self.change::<p::SetScene>(scene)
    }
    /// The loaded scene.
    pub fn scene(&mut self) -> Result<Option<p::SceneData>, LinkError> {
        self.ask::<p::GetScene>(&(), ANSWER)
    }
    /// Says where the control step takes its mass matrix from.
    pub fn set_mass_model(
        &mut self,
        model: &haptic_bridge::model::precomputed::MassModelData,
    ) -> Result<(), BoardError> {
        self.change::<p::SetMassModel>(model)
    }
    /// Sends a piece of a precomputed table.
    pub fn send_table(&mut self, chunk: &p::TableChunk) -> Result<(), BoardError> {
        self.change::<p::SendTable>(chunk)
    }
    /// Changes the gains of one wall, also while it is touched.
    pub fn set_wall_gains(&mut self, gains: Gains<f32>) -> Result<(), BoardError> {
        self.change::<p::SetGains>(&GainsRequest { wall: Some(gains), estimator: None })
    }
    /// Changes the velocity estimators of all walls; cutoff in Hz.
    pub fn set_estimator(&mut self, estimator: Estimator, cutoff_hz: f32) -> Result<(), BoardError> {
        self.change::<p::SetGains>(&GainsRequest { wall: None, estimator: Some((estimator, cutoff_hz)) })
    }
    /// Sets limits and rules. Limits may only be raised while disarmed.
    pub fn set_rules(&mut self, rules: &Rules) -> Result<(), BoardError> {
        self.change::<p::SetRules>(rules)
    }
    /// Limits and rules.
    pub fn rules(&mut self) -> Result<Rules, LinkError> {
        self.ask::<p::GetRules>(&(), ANSWER)
    }
    /// Declares the present pose to be the device's home pose.
    pub fn home(&mut self) -> Result<(), BoardError> {
        self.change::<p::Home>(&())
    }
    /// Homes as soon as the device is at rest, for which it has a second of the board's time: somebody may be about to
    /// hold it still, and a simulated hand carries it back after a polarity check.
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
    /// Starts the polarity check: each joint is moved by a small torque.
    pub fn check_polarity(&mut self) -> Result<(), BoardError> {
        let outcome = self.change::<p::CheckPolarity>(&());
        self.on(outcome)
    }
    /// Motors on.
    pub fn arm(&mut self) -> Result<(), BoardError> {
        let outcome = self.change::<p::Arm>(&());
        self.on(outcome)
    }
    /// Motors off.
    pub fn disarm(&mut self) -> Result<(), BoardError> {
        self.change::<p::Disarm>(&())
    }
    /// The newest control step that the board has told in answer to a heartbeat, see [`Board::keep_alive`]: with it,
    /// whoever sees a dead man's key says when.
    pub fn step(&self) -> u32 {
        self.step
    }
    /// Motors on for as long as a dead man's key is held. `seen` is the newest [`Board::step`] that whoever sees the key
    /// knew of before the key was seen down. Half a second after that step the board turns its motors off, as a fault,
    /// unless [`Board::hold_key`] has told of a newer one; it refuses to arm where that is over already.
    pub fn arm_held(&mut self, seen: u32) -> Result<(), BoardError> {
        let outcome = self.change::<p::ArmHeld>(&p::Press { holder: self.session, seen });
        self.on(outcome)
    }
    /// The key is still down, see [`Board::arm_held`]. Only this `Board` can say so of the key that it armed with.
    pub fn hold_key(&mut self, seen: u32) -> Result<(), LinkError> {
        self.heartbeat(p::Beat::Held(p::Press { holder: self.session, seen }))
    }
    /// Asks for a force at the tip, joint torques or a contact, for as long as its lease runs; reads how the device is.
    /// The answer names what was not done.
    pub fn force(&mut self, request: &p::ForceRequest) -> Result<p::ForceAnswer, LinkError> {
        let sent = self.send_force(request)?;
        self.force_answer(sent)
    }
    /// Sends what [`Board::force`] sends, and does not wait: a program that sends its next request before it has this
    /// one's answer is not slowed down by the way to the board and back. Two on their way are enough, and more than
    /// eight are not kept; answers come in the order of the requests. Telemetry may be read in between.
    pub fn send_force(&mut self, request: &p::ForceRequest) -> Result<Sent, LinkError> {
        self.client.send::<p::Force>(request)
    }
    /// The answer to a [`Board::send_force`], waited for no longer than [`Board::wait_for_forces`] says, and not at all
    /// where a later one's has come.
    pub fn force_answer(&mut self, sent: Sent) -> Result<p::ForceAnswer, LinkError> {
        let (began, patience) = (self.now(), self.force_patience);
        let answer = self.client.answer::<p::Force>(sent, patience);
        answer.map_err(|error| match error {
            LinkError::Silent { .. } | LinkError::Rejected { .. } | LinkError::Unreadable { .. } => {
                LinkError::Unanswered { waited: patience.min(self.now() - began) }
            }
            error => error,
        })
    }
    /// For how long the answer to a force is waited for: [`FORCE_PATIENCE`] unless this says otherwise.
    pub fn wait_for_forces(&mut self, patience: Duration) {
        self.force_patience = patience;
    }
    /// Clears a latched fault.
    pub fn clear(&mut self) -> Result<(), BoardError> {
        self.change::<p::Clear>(&())
    }
    /// The faults seen since the board started, oldest first.
    pub fn faults(&mut self) -> Result<p::FaultList, LinkError> {
        self.ask::<p::GetFaults>(&(), ANSWER)
    }
    /// Faults the board has reported by itself since the last call.
    pub fn take_reported_faults(&mut self) -> Vec<haptic_bridge::safety::fault::FaultRecord> {
        std::mem::take(&mut self.faults)
    }
    /// Writes device, scene, rules and the rest to flash. Only while disarmed; the board pauses for up to a second.
    pub fn save(&mut self) -> Result<(), BoardError> {
        Ok(self.ask::<p::Save>(&(), FLASH_ANSWER)??)
    }
    /// The bytes of a setting as they are kept.
    pub fn read_entry(&mut self, key: Key) -> Result<Option<Entry>, LinkError> {
        self.ask::<p::ReadEntry>(&key, ANSWER)
    }
    /// Puts a setting's bytes aside until [`Board::commit_entries`] names its key. Only this `Board` can, and only
    /// until another one puts something aside.
    pub fn stage_entry(&mut self, key: Key, entry: Entry) -> Result<(), BoardError> {
        Ok(self.ask::<p::StageEntry>(&p::WriteEntry { session: self.session, key, entry }, FLASH_ANSWER)??)
    }
    /// Puts the staged settings of these keys in force and into flash, as one change.
    pub fn commit_entries(&mut self, keys: &p::KeyList) -> Result<(), BoardError> {
        let commit = p::Commit { session: self.session, keys: keys.clone() };
        Ok(self.ask::<p::CommitEntries>(&commit, FLASH_ANSWER)??)
    }
    /// Gives the board a name.
    pub fn set_name(&mut self, name: &p::Name) -> Result<(), BoardError> {
        Ok(self.ask::<p::SetName>(name, FLASH_ANSWER)??)
    }
    /// Restarts into the chip's own boot loader, to be flashed over USB.
    pub fn enter_dfu(&mut self) -> Result<(), BoardError> {
        self.change::<p::EnterDfu>(&())
    }
    /// Restarts the board.
    pub fn restart(&mut self) -> Result<(), BoardError> {
        self.change::<p::Restart>(&())
    }

    /// From now on says several times a second that the host is there, whenever it waits for telemetry
    /// or for an answer.
    pub fn keep_alive(&mut self) {
        self.client.alive = true;
    }

    /// Waits for the end of the polarity check that [`Board::check_polarity`] started, and says how it ended. Meanwhile
    /// the board is told that the host is there.
    pub fn wait_for_polarity(&mut self) -> Result<PolarityOutcome, BoardError> {
        let before = std::mem::replace(&mut self.client.alive, true);
        let outcome = self.polarity_outcome();
        self.client.alive = before;
        outcome
    }

    fn polarity_outcome(&mut self) -> Result<PolarityOutcome, BoardError> {
        loop {
            // No telemetry comes: this only waits, and lets a simulated board's time pass.
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

    /// Sends a prepared mass matrix and puts it in force; motors must be off. The closed form is what a scene comes
    /// with, so there is nothing to send of it.
    pub fn send_mass(&mut self, mass: &MassModelData, values: &[f32]) -> Result<(), BoardError> {
        if *mass == MassModelData::Exact {
            return Ok(());
        }
        for (offset, values) in (0_u16..).step_by(TABLE_PIECE).zip(values.chunks(TABLE_PIECE)) {
            self.send_table(&TableChunk { offset, values: values.iter().copied().collect() })?;
        }
        self.set_mass_model(mass)
    }

    /// Starts a stream of every `divider`-th step's `fields`; losses count from here.
    pub fn start_stream(&mut self, fields: Fields, divider: u32) -> Result<(), BoardError> {
        // Drawn, not counted: whatever a tool before this one left on the link has another.
        let stream = self.client.draw();
        self.rows = Rows::of(stream, fields, divider);
        self.garbled_before = self.client.garbled();
        self.change::<p::Stream>(&StreamRequest { fields, divider, stream })
    }

    /// Stops the stream. Rows that were still on their way are in the next [`Board::rows`].
    pub fn stop_stream(&mut self) -> Result<(), BoardError> {
        self.change::<p::Stream>(&StreamRequest { fields: Fields(0), divider: 0, stream: 0 })
    }

    /// The rows that have come, waiting at most `timeout` for the first. Faults that the board reports are kept for
    /// [`Board::take_reported_faults`].
    pub fn rows(&mut self, timeout: Duration) -> Result<Vec<Row>, LinkError> {
        let deadline = self.client.now() + timeout;
        let mut rows = Vec::new();
        loop {
            self.beat()?;
            let left = deadline.saturating_sub(self.client.now());
            let wait = if rows.is_empty() { left.min(HEARTBEAT) } else { Duration::ZERO };
            match self.client.topic(wait)? {
                Some(frame) => {
                    if let Some(batch) = frame.message::<p::Telemetry>() {
                        match batch {
                            Ok(batch) => self.rows.take(&batch, &mut rows),
                            Err(error) if self.rows.spoilt() > UNREADABLE => return Err(error),
                            Err(_) => {}
                        }
                    } else if let Some(record) = frame.message::<p::FaultSeen>() {
                        // One that was spoilt on its way is still in the board's list.
                        self.faults.extend(record);
                    }
                }
                None if !rows.is_empty() || left.is_zero() => return Ok(rows),
                None => {}
            }
        }
    }

    /// The losses of the stream so far.
    pub fn losses(&self) -> Losses {
        let losses = self.rows.losses();
        Losses { garbled: losses.garbled + self.client.garbled() - self.garbled_before, ..losses }
    }

    fn beat(&mut self) -> Result<(), LinkError> {
        let now = self.client.now();
        if self.client.alive && self.last_heartbeat.is_none_or(|last| now.saturating_sub(last) >= HEARTBEAT) {
            self.heartbeat(p::Beat::Here)?;
        }
        Ok(())
    }

    fn heartbeat(&mut self, beat: p::Beat) -> Result<(), LinkError> {
        self.last_heartbeat = Some(self.now());
        self.step = self.ask::<p::Heartbeat>(&beat, (HEARTBEAT, ANSWER.1))?;
        Ok(())
    }
}
