//! The stage: the thread that owns the board. It receives the pages' messages, lets time pass, and sends pictures.
//!
//! One page commands, the others watch. The motors are on only while the page in command holds its key down: if the
//! page releases the key, closes, or sends no hold message for [`KEY_TIMEOUT`], the motors go off. Any page may turn
//! the motors off. With each message about its key a page sends the control step of the newest picture that it had
//! received when it detected the key. The stage passes this step to the board ([`Board::hold_key`]), which thus knows
//! the age of the key press on a link of any delay. Simulated motors are harmless, so they stay on until the key is
//! released or the page is gone, however slow the computer is.
//!
//! The stage reads no clock: the caller of [`Stage::turn`] passes the time. The tool calls `turn` in a loop
//! ([`Stage::run`]), and the page as a file whenever the browser allows (clients/page/).

mod messages;
mod recording;
mod walls;

use super::hub::{Event, Hub, PageId};
use super::message::FromPage;
use super::picture::{FIELDS, Newest, nearest_wall};
use super::scope::{MAX_WINDOW_SECONDS, Ring, Scope};
use super::stability::{Plane, Predictor};
use super::world::{World, lead_hand};
use crate::track::Track;
use haptic_bridge::board::telemetry::{Field, RowShape};
use haptic_bridge::control::Rules;
use haptic_bridge::model::device::Device;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::error::Failure;
use haptic_host::link::{Board, BoardError, Column, LinkError, columns, max_rows_per_second};
use haptic_host::vectors::padded;
use haptic_predict::boards::torque_path;
use haptic_stability::analysis::control_loop::TorquePath;
use haptic_stability::analysis::oscillation::Oscillation;
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::analysis::prediction::Subject;
use messages::{describe_fault, plane_message};
use recording::ActiveRecording;
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use walls::check_scene;

/// Maximum number of events that one turn handles.
const MAX_EVENTS: usize = 64;
/// Longest age of the key press, by board steps and by page messages, before the motors go off. The board's own limit,
/// [`haptic_bridge::control::KEY_SECONDS`], is longer by a heartbeat and a turn, and causes a fault.
pub const KEY_TIMEOUT: Duration = Duration::from_millis(400);
/// Distance from the wall to which the simulated hand moves a tip before the motors go on, m.
const EXIT_DISTANCE: f64 = 0.005;
/// Time limit for the movement out of a wall.
const EXIT_TIMEOUT: Duration = Duration::from_secs(2);
/// Longest silence of the page in command before another page may take command.
const COMMAND_TIMEOUT: Duration = Duration::from_secs(5);
const PICTURE_INTERVAL: Duration = Duration::from_micros(16_600);
const SWEEP_INTERVAL: Duration = Duration::from_millis(40);
/// Interval between polls of slowly changing state.
const POLL_INTERVAL: Duration = Duration::from_millis(500);
/// Maximum simulated time to catch up after the computer was busy, and maximum part of a turn that counts as listening.
const MAX_CATCH_UP: Duration = Duration::from_millis(50);
/// Simulated time between two polls of the pages' messages.
const TIME_SLICE: Duration = Duration::from_millis(8);
/// Rotation of a joint after which the boundary is predicted again, rad.
const MAX_JOINT_ROTATION: f64 = 0.02;
/// Clock of the boards' core, Hz.
const CORE_HZ: f64 = 168e6;

/// Outcome of a turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// Time has passed, and there may be more to catch up.
    Played,
    /// Simulated time is up to date.
    Ahead,
}

/// State of the thread that owns the board.
pub struct Stage {
    world: World,
    hub: Hub,
    /// Time since the stage was opened.
    now: Duration,
    /// Part of `now` in which the stage could receive messages, without its own long waits.
    listened: Duration,
    last_picture: Duration,
    last_sweep: Duration,
    last_poll: Duration,
    device: Device<f64>,
    /// Drawn places of task coordinates that have no plane.
    tracks: Vec<Track>,
    scene: Scene<f64>,
    /// Scene and pose when the world was first opened; the pose (rad) only if it is simulated.
    first: Scene<f32>,
    start: [f64; 3],
    /// The rules at the last poll.
    rules: Rules,
    columns: Vec<Column>,
    rows_hz: f64,
    /// Largest row rate, if it was given.
    limit_hz: Option<f64>,
    /// The device with its transmissions, and the board's delay and drives.
    subject: Subject,
    /// The board's delay and drives.
    path: TorquePath,
    ring: Ring,
    last_step: Option<u32>,
    divider: u32,
    trail: Vec<[f64; 2]>,
    sound: Vec<f32>,
    scopes: BTreeMap<PageId, Scope>,
    listeners: Vec<PageId>,
    command: Option<(PageId, Duration)>,
    /// Control step of the newest picture when the page detected its key; `None` without a held key.
    held: Option<u32>,
    /// Value of `listened` at the last message about the key.
    key_time: Duration,
    /// Time of the key press while a simulated hand moves the tip out of a wall, before the motors go on.
    exiting: Option<Duration>,
    goal: Option<[f64; 2]>,
    state: State,
    fault: Option<String>,
    load: Option<f64>,
    predictor: Predictor,
    plane: Option<Plane>,
    requested: Option<(usize, Vec<f64>)>,
    /// Predicted oscillation of the plane's wall if its gains are unstable.
    buzz: Option<Oscillation>,
    pace: Pace,
    /// Folder for recordings; `None` disables recording.
    folder: Option<PathBuf>,
    recording: Option<ActiveRecording>,
}

/// Simulated time relative to real time.
struct Pace {
    began: Duration,
    board_began: Duration,
    measured: (Duration, Duration),
    speed: f64,
}

impl Stage {
    /// Prepares the board for a view: heartbeats, and a stream of every step, or of `limit_hz` rows a second. Recordings
    /// go to `folder`; without a folder they are disabled.
    pub fn open(mut world: World, hub: Hub, limit_hz: Option<f64>, folder: Option<PathBuf>) -> Result<Self, Failure> {
        let board = &mut world.board;
        let details = board.details()?;
        let device = board.device()?.ok_or(BoardError::Refused(Refusal::NoDevice))?;
        let scene = board.scene()?.ok_or(BoardError::Refused(Refusal::NoScene))?;
        let (shape, device) = (RowShape::of(Some(&device)), device.cast::<f64>());
        let (first, scene) = (scene.clone(), check_scene(&scene, &device)?);
        let rules = board.rules()?;
        let rate_hz = f64::from(details.rate_hz);
        let name = if world.simulated.is_some() { "simulated" } else { "" };
        let link_hz = max_rows_per_second(name, FIELDS, shape, rate_hz);
        let divider = (rate_hz / limit_hz.unwrap_or(link_hz).min(rate_hz)).ceil().max(1.0) as u32;
        let rows_hz = rate_hz / f64::from(divider);
        let columns = columns(FIELDS, &device.mechanism.units(), shape.sensed);
        // No page holds a key yet.
        board.disarm()?;
        board.keep_alive();
        board.start_stream(FIELDS, divider)?;
        let (now, board_now) = (Duration::ZERO, board.now());
        let stage = Self {
            ring: Ring::new(columns.len(), (1.5 * MAX_WINDOW_SECONDS * rows_hz).ceil() as usize),
            hub,
            now,
            listened: now,
            last_picture: now,
            last_sweep: now,
            last_poll: now,
            subject: Subject::on_board(device.clone(), world.file.as_ref()),
            path: torque_path(world.board.info(), &details),
            tracks: Track::of(&device, world.file.as_ref().map(|file| &file.description)),
            device,
            scene,
            first,
            start: world.simulated.as_ref().map_or([0.0; 3], |board| board.lock().device().start()),
            rules,
            columns,
            rows_hz,
            limit_hz,
            last_step: None,
            divider,
            trail: Vec::new(),
            sound: Vec::new(),
            scopes: BTreeMap::new(),
            listeners: Vec::new(),
            command: None,
            held: None,
            key_time: now,
            exiting: None,
            goal: None,
            state: State::Disarmed,
            fault: None,
            load: None,
            predictor: Predictor::default(),
            plane: None,
            requested: None,
            buzz: None,
            pace: Pace { began: now, board_began: board_now, measured: (now, board_now), speed: 1.0 },
            folder,
            recording: None,
            world,
        };
        stage.send_to_all(&stage.hello_message());
        stage.send_to_all(&stage.walls_message());
        Ok(stage)
    }

    fn board(&mut self) -> &mut Board {
        &mut self.world.board
    }

    /// Runs until `stop` is set or the board is lost. Without an error the motors are off afterwards.
    pub fn run(&mut self, stop: &AtomicBool) -> Result<(), LinkError> {
        let result = self.play(stop);
        let ended = self.end(result.is_err());
        result.and(ended)
    }

    /// Ends the view, with the motors off. A board that was `lost` turns its motors off itself.
    pub fn end(&mut self, lost: bool) -> Result<(), LinkError> {
        self.stop_recording(lost);
        self.disarm()?;
        if !lost {
            let _ = self.board().stop_stream();
        }
        Ok(())
    }

    fn play(&mut self, stop: &AtomicBool) -> Result<(), LinkError> {
        let (began, opened) = (Instant::now(), self.now);
        while !stop.load(Ordering::SeqCst) {
            if self.turn(opened + began.elapsed())? == Turn::Ahead {
                thread::sleep(Duration::from_millis(1));
            }
        }
        Ok(())
    }

    /// Does the work that is due at `now` (since opening): receives messages, lets time pass, sends pictures.
    pub fn turn(&mut self, now: Duration) -> Result<Turn, LinkError> {
        self.listened += now.saturating_sub(self.now).min(MAX_CATCH_UP);
        self.now = now;
        for _ in 0..MAX_EVENTS {
            let Some(event) = self.hub.next() else { break };
            self.handle_event(event)?;
        }
        self.check_key()?;
        let turn = match self.time_to_pass() {
            Some(wait) => {
                self.pass_time(wait)?;
                Turn::Played
            }
            None => Turn::Ahead,
        };
        if now.saturating_sub(self.last_picture) >= PICTURE_INTERVAL {
            self.last_picture = now;
            self.send_pictures();
        }
        if now.saturating_sub(self.last_sweep) >= SWEEP_INTERVAL {
            self.last_sweep = now;
            self.send_sweeps();
        }
        if now.saturating_sub(self.last_poll) >= POLL_INTERVAL {
            self.last_poll = now;
            self.poll_board()?;
        }
        Ok(turn)
    }

    /// Returns the time for which to wait for rows; `None` if simulated time is up to date.
    fn time_to_pass(&mut self) -> Option<Duration> {
        if self.world.simulated.is_none() {
            return Some(Duration::from_millis(5));
        }
        let passed = self.world.board.now().saturating_sub(self.pace.board_began);
        let behind = self.now.saturating_sub(self.pace.began).saturating_sub(passed);
        // Does not catch up with more than `MAX_CATCH_UP`, because the picture would race.
        self.pace.began += behind.saturating_sub(MAX_CATCH_UP);
        Some(behind.min(TIME_SLICE)).filter(|behind| !behind.is_zero())
    }

    fn pass_time(&mut self, wait: Duration) -> Result<(), LinkError> {
        for row in self.world.board.rows(wait)? {
            if let Some(last) = self.last_step {
                let ahead = row.step.wrapping_sub(last) / self.divider;
                if ahead < u32::MAX / 2 / self.divider {
                    self.ring.push_lost(u64::from(ahead.saturating_sub(1)));
                }
            }
            self.last_step = Some(row.step);
            if let Some(recording) = &mut self.recording
                && let Err(error) = recording.add_row(&row)
            {
                self.recording_failed(error);
            }
            self.ring.push(row.values.iter().map(|value| *value as f32));
            if !self.listeners.is_empty() {
                self.sound.push(row.get(Field::Torque).iter().sum::<f64>() as f32);
            }
            let tip = row.get(Field::Tip);
            self.trail.push([tip[0], tip.get(1).copied().unwrap_or(0.0)]);
        }
        for record in self.world.board.take_reported_faults() {
            let words = describe_fault(&record, self.world.simulated.is_some());
            self.record_event(&words);
            self.fault = Some(words);
        }
        let code = Newest::of(&self.ring, &self.columns).get(Field::State, 0) as usize;
        let state = State::ALL.get(code).copied().unwrap_or_default();
        if state == State::Fault && (self.state != State::Fault || self.fault.is_none()) {
            let simulated = self.world.simulated.is_some();
            self.fault = self.board().status()?.fault.map(|record| describe_fault(&record, simulated));
            self.held = None;
        }
        if state != State::Fault && self.state == State::Fault {
            self.fault = None;
        }
        // Rows in transit may be older than the last key press, so ask the board for its state.
        let has_gone_off = self.state == State::Armed && state == State::Disarmed && self.held.is_some();
        self.state = state;
        if has_gone_off && self.board().status()?.state == State::Disarmed {
            self.held = None;
            self.refuse_all(Some("off"), "another tool turned the motors off");
        }
        Ok(())
    }

    /// Checks the dead man's key of real motors; silence of its page counts as a release. The age in board steps is not
    /// sufficient, because an emulated board may run slower than real time.
    fn check_key(&mut self) -> Result<(), LinkError> {
        let age = |seen: u32| f64::from(self.world.board.step().wrapping_sub(seen)) / self.scene.rate_hz;
        let is_silent = self.listened.saturating_sub(self.key_time) > KEY_TIMEOUT;
        let is_too_old = self.held.is_some_and(|seen| is_silent || age(seen) > KEY_TIMEOUT.as_secs_f64());
        if is_too_old && self.world.simulated.is_none() {
            self.disarm()?;
            self.refuse_all(Some("off"), "no message from the page in command, so the motors went off");
        }
        if self.command.is_some_and(|(_, last)| self.now.saturating_sub(last) > COMMAND_TIMEOUT) {
            self.give_up_command()?;
        }
        Ok(())
    }

    fn disarm(&mut self) -> Result<(), LinkError> {
        (self.held, self.exiting) = (None, None);
        match self.board().disarm() {
            Err(BoardError::Link(error)) => Err(error),
            Ok(()) | Err(BoardError::Refused(_)) => Ok(()),
        }
    }

    /// Turns the motors on after a key press. A simulated hand first moves the tip out of a wall.
    fn press(&mut self, seen: u32) -> Result<(), BoardError> {
        let began = self.exiting.take().unwrap_or(self.now);
        let armed = match &self.world.simulated {
            Some(_) => self.world.board.arm(),
            None => self.world.board.arm_held(seen),
        };
        if let (Err(BoardError::Refused(Refusal::InsideWall)), Some(simulated)) = (&armed, &self.world.simulated)
            && self.now.saturating_sub(began) < EXIT_TIMEOUT
            && let Some((_, normal)) = nearest_wall(&self.scene, &self.tip())
        {
            let tip: [f64; 2] = padded(&self.tip());
            let distance = EXIT_DISTANCE - Newest::of(&self.ring, &self.columns).get(Field::Distance, 0);
            let goal = [tip[0] + distance * normal[0], tip[1] + distance * normal[1]];
            lead_hand(simulated, Some(goal));
            (self.goal, self.exiting) = (Some(goal), Some(began));
            return Ok(());
        }
        armed?;
        (self.held, self.key_time) = (Some(seen), self.listened);
        Ok(())
    }

    fn give_up_command(&mut self) -> Result<(), LinkError> {
        self.command = None;
        self.goal = None;
        if let Some(simulated) = &self.world.simulated {
            lead_hand(simulated, None);
        }
        self.disarm()
    }

    fn handle_event(&mut self, event: Event) -> Result<(), LinkError> {
        match event {
            Event::Connected(id) => {
                self.send(id, &self.hello_message());
                self.send(id, &self.walls_message());
                if let Some(plane) = &self.plane {
                    self.send(id, &plane_message(plane));
                }
            }
            Event::Disconnected(id) => {
                self.scopes.remove(&id);
                self.listeners.retain(|listener| *listener != id);
                if self.has_command(id) {
                    self.give_up_command()?;
                }
            }
            Event::Received(id, Err(why)) => self.refuse(id, &why),
            Event::Dropped(id, count) => self.refuse(id, &format!("too many messages at once: {count} were dropped")),
            Event::Received(id, Ok(message)) => {
                if let Some((holder, last)) = &mut self.command
                    && *holder == id
                {
                    *last = self.now;
                }
                match self.execute(id, message) {
                    Err(BoardError::Link(error)) => return Err(error),
                    Err(BoardError::Refused(Refusal::InsideWall)) => {
                        self.refuse_while("inside", id, &Refusal::InsideWall.to_string());
                    }
                    Err(BoardError::Refused(refusal)) => self.refuse(id, &refusal.to_string()),
                    Ok(()) => {}
                }
            }
        }
        Ok(())
    }

    fn record_event(&mut self, words: &str) {
        if let Some(recording) = &mut self.recording
            && let Err(error) = recording.add_event(words)
        {
            self.recording_failed(error);
        }
    }

    fn has_command(&self, id: PageId) -> bool {
        self.command.is_some_and(|(holder, _)| holder == id)
    }

    fn execute(&mut self, id: PageId, message: FromPage) -> Result<(), BoardError> {
        // Handles the messages that any page may send.
        match &message {
            FromPage::Here {} => return Ok(()),
            FromPage::Disarm {} => return Ok(self.disarm()?),
            FromPage::Explain {} => {
                self.predictor.explain();
                return Ok(());
            }
            FromPage::Take {} if self.command.is_none() => {
                self.command = Some((id, self.now));
                return Ok(());
            }
            FromPage::Scope(request) => {
                let labels: Vec<String> = self.columns.iter().map(|column| column.label.clone()).collect();
                match Scope::new(request.clone(), &labels, self.rows_hz, self.ring.end()) {
                    Ok(scope) => {
                        self.scopes.insert(id, scope);
                    }
                    Err(why) => self.refuse(id, &why),
                }
                return Ok(());
            }
            FromPage::Sound { on } => {
                self.listeners.retain(|listener| *listener != id);
                if *on {
                    self.listeners.push(id);
                }
                return Ok(());
            }
            _ => {}
        }
        if !self.has_command(id) {
            if !matches!(message, FromPage::Release {} | FromPage::Hold { .. }) {
                match self.command {
                    Some(_) => self.refuse_while("watching", id, "another page is in command; this one watches"),
                    None => self.refuse_while("nobody", id, "no page is in command: take command first"),
                }
            }
            return Ok(());
        }
        match message {
            FromPage::Give {} => self.give_up_command()?,
            FromPage::Release {} => self.disarm()?,
            FromPage::Arm { seen } if self.held.is_none() => self.press(seen)?,
            FromPage::Hold { seen } if self.exiting.is_some() => self.press(seen)?,
            // Only a press arms. A key that stayed down while something else turned the motors off does not arm.
            FromPage::Arm { seen } | FromPage::Hold { seen } => {
                self.key_time = self.listened;
                if self.held.is_some_and(|before| before != seen) {
                    self.held = Some(seen);
                    if self.world.simulated.is_none() {
                        self.board().hold_key(seen)?;
                    }
                }
            }
            FromPage::Clear {} => self.board().clear()?,
            FromPage::Record { on: true } => self.start_recording(id)?,
            FromPage::Record { on: false } => self.stop_recording(false),
            FromPage::Gains { wall, stiffness, damping, feed_forward, beyond } => {
                self.change_gains(id, wall, stiffness, damping, feed_forward, beyond)?;
            }
            FromPage::Wall { wall, point, normal } => self.move_wall(id, usize::from(wall), point, normal)?,
            FromPage::Hand { at } => match &self.world.simulated {
                Some(simulated) if at.is_none_or(|at| at.iter().all(|v| v.is_finite())) => {
                    lead_hand(simulated, at);
                    self.goal = at;
                }
                Some(_) => self.refuse(id, "a position is two finite numbers"),
                None => self.refuse(id, "this device is not simulated: hold it in your own hand"),
            },
            FromPage::StartOver { .. } | FromPage::World { .. } | FromPage::Rate { .. }
                if self.world.simulated.is_none() =>
            {
                self.refuse(id, "this device is not simulated");
            }
            FromPage::StartOver { pose } => self.start_over(id, pose),
            FromPage::World { world } => {
                self.reopen(id, World::shipped(world));
            }
            FromPage::Rate { hz } => {
                let scene = self.board().scene()?.unwrap_or_default();
                self.recreate(id, &Scene { rate_hz: hz, ..scene }, None);
            }
            FromPage::Here {}
            | FromPage::Disarm {}
            | FromPage::Take {}
            | FromPage::Explain {}
            | FromPage::Scope(_)
            | FromPage::Sound { .. } => {}
        }
        Ok(())
    }

    /// Replaces the simulated world, with the motors off. The pages stay, and so does the page in command. Returns true
    /// if the world has been replaced.
    fn reopen(&mut self, id: PageId, world: Result<World, Failure>) -> bool {
        let (hub, folder) = (self.hub.clone(), self.folder.clone());
        match world.and_then(|world| Self::open(world, hub, self.limit_hz, folder)) {
            Ok(stage) => {
                self.stop_recording(false);
                let (command, now) = (self.command, self.now);
                *self = Self { command, now, ..stage };
                true
            }
            Err(why) => {
                self.refuse(id, &why.to_string());
                false
            }
        }
    }

    /// Creates the simulated world again with another scene, in its first or another pose.
    fn recreate(&mut self, id: PageId, scene: &Scene<f32>, pose: Option<Vec<f64>>) {
        let (first, start) = (Scene { rate_hz: scene.rate_hz, ..self.first.clone() }, self.start);
        if self.reopen(id, self.world.recreate(scene, pose.map_or(start, |q| padded(&q)))) {
            (self.first, self.start) = (first, start);
        }
    }

    /// Resets a simulated device and its scene to the start, or puts the device into another pose.
    fn start_over(&mut self, id: PageId, pose: Option<Vec<f64>>) {
        let is_possible = pose.as_ref().is_none_or(|q| {
            q.len() == self.device.axes()
                && q.iter().all(|angle| angle.abs() <= TAU)
                && TaskPose::of(&self.device.mechanism, q).is_ok()
        });
        if is_possible {
            self.recreate(id, &self.first.clone(), pose);
        } else {
            self.refuse(
                id,
                &format!(
                    "a pose is {} angles (rad; of slides travels, m) that the device can have",
                    self.device.axes()
                ),
            );
        }
    }

    fn tip(&self) -> Vec<f64> {
        let newest = Newest::of(&self.ring, &self.columns);
        (0..usize::from(self.scene.task)).map(|axis| newest.get(Field::Tip, axis)).collect()
    }

    fn poll_board(&mut self) -> Result<(), LinkError> {
        let details = self.board().details()?;
        self.rules = self.board().rules()?;
        let cycles = f64::from(details.longest_cycles);
        if let Some(Err(error)) = self.recording.as_mut().map(|recording| recording.flush()) {
            self.recording_failed(error);
        }
        self.load = (cycles > 0.0).then(|| cycles * f64::from(details.carrier_hz) / CORE_HZ);
        let (now, board_now) = (self.now, self.world.board.now());
        let (then, board_then) = std::mem::replace(&mut self.pace.measured, (now, board_now));
        self.pace.speed = board_now.saturating_sub(board_then).as_secs_f64() / now.saturating_sub(then).as_secs_f64();
        Ok(())
    }
}
