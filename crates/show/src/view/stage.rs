//! The stage: the one thread that owns the board. It hears the pages, lets time pass, and shows what there is to see.
//!
//! One page commands, the others watch. The motors are on only while the page in command holds its key down: a page that
//! lets go, closes, or was not heard to see the key for [`SILENCE`] turns them off. Any page may turn them off. With its
//! key a page says the newest control step that it had been shown when it saw the key, and this goes on to the board
//! ([`Board::hold_key`]): whatever is slow or stands still on this way round, the board knows how old the press is.
//! Simulated motors hurt no hand: they stay on until the key is let go or the page is gone, however slow the computer.
//!
//! It reads no clock: whoever calls [`Stage::turn`] says what time it is. The tool does so in a loop ([`Stage::run`]),
//! the page as a file whenever the browser lets it (clients/page/).

mod recording;
mod told;
mod walls;

use super::hub::{Event, Hub, PageId};
use super::message::FromPage;
use super::picture::{FIELDS, Newest, nearest_wall};
use super::scope::{LONGEST, Ring, Scope};
use super::stability::{Oracle, Plane};
use super::world::{World, lead};
use haptic_bridge::board::telemetry::Field;
use haptic_bridge::control::Rules;
use haptic_bridge::model::device::Device;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::error::Failure;
use haptic_host::link::{Board, BoardError, Column, LinkError, columns, rows_that_fit};
use haptic_host::vectors::padded;
use haptic_predict::boards::torque_path;
use haptic_sim::SharedBoard;
use haptic_stability::analysis::control_loop::TorquePath;
use haptic_stability::analysis::oscillation::Oscillation;
use haptic_stability::analysis::pose::TaskPose;
use haptic_stability::analysis::prediction::Subject;
use recording::ActiveRecording;
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use told::{in_words, plane_message};
use walls::fit;

/// Number of events that are heard in a turn; those that turn motors off come first among them ([`Hub::next`]).
const EVENTS: usize = 64;
/// Longest time since the page in command saw its key down, by the board's steps, and since it was heard, before the
/// motors go off. It is less than a board allows ([`haptic_bridge::control::KEY_SECONDS`]), where it is a fault, by a
/// heartbeat and a turn of this stage.
pub const SILENCE: Duration = Duration::from_millis(400);
/// Distance from a wall to which a simulated hand takes the tip out of it, m, and longest time that this may take.
const OUTSIDE: f64 = 0.005;
const WAY_OUT: Duration = Duration::from_secs(2);
/// Longest time that it may be silent at all before others may take command.
const ABSENCE: Duration = Duration::from_secs(5);
/// Between two pictures: 60 a second.
const PICTURE: Duration = Duration::from_micros(16_600);
/// Between two sweeps of an oscilloscope.
const SWEEP: Duration = Duration::from_millis(40);
/// Between two looks at what changes slowly.
const LOOK: Duration = Duration::from_millis(500);
/// Most simulated time that is caught up after the computer was busy, and most that a turn counts as time of listening.
const CATCH_UP: Duration = Duration::from_millis(50);
/// Simulated time that passes between two looks at what pages say.
const SLICE: Duration = Duration::from_millis(8);
/// Turn of a joint after which the boundary is worked out again, rad.
const TURNED: f64 = 0.02;
/// Cycles a second of the boards' core.
const CORE_HZ: f64 = 168e6;

/// The outcome of a turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// Time has passed; there may be more to catch up.
    Played,
    /// Simulated time was where it should be.
    Ahead,
}

/// The stage.
pub struct Stage {
    world: World,
    hub: Hub,
    /// Time since it was opened, and how much of it the stage has listened to pages: all but its own long waits, for
    /// what was said meanwhile may not be here yet.
    now: Duration,
    listened: Duration,
    /// When pages last got a picture, a sweep, and what changes slowly.
    shown: Duration,
    swept: Duration,
    looked: Duration,
    device: Device<f64>,
    scene: Scene<f64>,
    /// The scene as it was when the stage was opened.
    first: Scene<f32>,
    /// As they were last seen.
    rules: Rules,
    columns: Vec<Column>,
    rows_hz: f64,
    /// The device with what gives in it, and the board's delay and drives.
    subject: Subject,
    path: TorquePath,
    ring: Ring,
    last_step: Option<u32>,
    divider: u32,
    trail: Vec<[f64; 2]>,
    sound: Vec<f32>,
    scopes: BTreeMap<PageId, Scope>,
    listeners: Vec<PageId>,
    command: Option<(PageId, Duration)>,
    /// Of the key that is down, the newest step that its page had been shown, and when the page was heard, by `listened`.
    held: Option<u32>,
    key_heard: Duration,
    /// When the key was pressed, while a simulated hand takes the tip out of a wall: then the motors go on.
    coming_out: Option<Duration>,
    goal: Option<[f64; 2]>,
    state: State,
    fault: Option<String>,
    load: Option<f64>,
    oracle: Oracle,
    plane: Option<Plane>,
    asked: Option<(usize, Vec<f64>)>,
    /// The swing of the plane's wall where its gains are predicted to be unstable.
    buzz: Option<Oscillation>,
    pace: Pace,
    /// The folder for recordings, if there is one, and the recording under way.
    folder: Option<PathBuf>,
    recording: Option<ActiveRecording>,
}

/// Simulated time against the wall clock.
struct Pace {
    began: Duration,
    board_began: Duration,
    measured: (Duration, Duration),
    speed: f64,
}

impl Stage {
    /// Sets the board up to be looked at: heartbeats, and a stream of every step, or of `rows_hz` rows a second.
    /// Recordings go to `folder`; without one there are none.
    pub fn open(mut world: World, hub: Hub, rows_hz: Option<f64>, folder: Option<PathBuf>) -> Result<Self, Failure> {
        let board = &mut world.board;
        let details = board.details()?;
        let device = board.device()?.ok_or(BoardError::Refused(Refusal::NoDevice))?;
        let scene = board.scene()?.ok_or(BoardError::Refused(Refusal::NoScene))?;
        let device = device.cast::<f64>();
        let (first, scene) = (scene.clone(), fit(&scene, &device)?);
        let rules = board.rules()?;
        let rate_hz = f64::from(details.rate_hz);
        let name = if world.simulated.is_some() { "simulated" } else { "" };
        let most = rows_that_fit(name, FIELDS, device.axes(), rate_hz);
        let divider = (rate_hz / rows_hz.unwrap_or(most).min(rate_hz)).ceil().max(1.0) as u32;
        let rows_hz = rate_hz / f64::from(divider);
        let columns = columns(FIELDS, device.axes());
        // No page holds a key yet.
        board.disarm()?;
        board.keep_alive();
        board.start_stream(FIELDS, divider)?;
        let (now, board_now) = (Duration::ZERO, board.now());
        let stage = Self {
            ring: Ring::new(columns.len(), (1.5 * LONGEST * rows_hz).ceil() as usize),
            hub,
            now,
            listened: now,
            shown: now,
            swept: now,
            looked: now,
            subject: Subject::on_board(device.clone(), world.file.as_ref()),
            path: torque_path(world.board.info(), &details),
            device,
            scene,
            first,
            rules,
            columns,
            rows_hz,
            last_step: None,
            divider,
            trail: Vec::new(),
            sound: Vec::new(),
            scopes: BTreeMap::new(),
            listeners: Vec::new(),
            command: None,
            held: None,
            key_heard: now,
            coming_out: None,
            goal: None,
            state: State::Disarmed,
            fault: None,
            load: None,
            oracle: Oracle::default(),
            plane: None,
            asked: None,
            buzz: None,
            pace: Pace { began: now, board_began: board_now, measured: (now, board_now), speed: 1.0 },
            folder,
            recording: None,
            world,
        };
        stage.say_to_all(&stage.about());
        stage.say_to_all(&stage.walls());
        Ok(stage)
    }

    fn board(&mut self) -> &mut Board {
        &mut self.world.board
    }

    /// Plays until `stop` is set, or the board is lost or does not answer. Without an error the motors are off afterwards.
    pub fn run(&mut self, stop: &AtomicBool) -> Result<(), LinkError> {
        let played = self.play(stop);
        let ended = self.end(played.is_err());
        played.and(ended)
    }

    /// Ends what is shown, with the motors off. A board that was `lost` turns them off itself.
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

    /// Does what is due at `now`, the time since the stage was opened: hears the pages, lets a few milliseconds pass,
    /// shows what there is to see.
    pub fn turn(&mut self, now: Duration) -> Result<Turn, LinkError> {
        self.listened += now.saturating_sub(self.now).min(CATCH_UP);
        self.now = now;
        for _ in 0..EVENTS {
            let Some(event) = self.hub.next() else { break };
            self.hear(event)?;
        }
        self.watch_the_key()?;
        let turn = match self.due() {
            Some(wait) => {
                self.let_time_pass(wait)?;
                Turn::Played
            }
            None => Turn::Ahead,
        };
        if now.saturating_sub(self.shown) >= PICTURE {
            self.shown = now;
            self.show();
        }
        if now.saturating_sub(self.swept) >= SWEEP {
            self.swept = now;
            self.sweep();
        }
        if now.saturating_sub(self.looked) >= LOOK {
            self.looked = now;
            self.look()?;
        }
        Ok(turn)
    }

    /// For how long the board's rows are waited for; none: simulated time is where it should be.
    fn due(&mut self) -> Option<Duration> {
        if self.world.simulated.is_none() {
            return Some(Duration::from_millis(5));
        }
        let passed = self.world.board.now().saturating_sub(self.pace.board_began);
        let behind = self.now.saturating_sub(self.pace.began).saturating_sub(passed);
        // Time that the computer was too slow for is not made up for: the picture would race.
        self.pace.began += behind.saturating_sub(CATCH_UP);
        Some(behind.min(SLICE)).filter(|behind| !behind.is_zero())
    }

    fn let_time_pass(&mut self, wait: Duration) -> Result<(), LinkError> {
        for row in self.world.board.rows(wait)? {
            if let Some(last) = self.last_step {
                let ahead = row.step.wrapping_sub(last) / self.divider;
                if ahead < u32::MAX / 2 / self.divider {
                    self.ring.lose(u64::from(ahead.saturating_sub(1)));
                }
            }
            self.last_step = Some(row.step);
            if let Some(recording) = &mut self.recording
                && let Err(error) = recording.take(&row)
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
            let words = in_words(&record, self.world.simulated.is_some());
            self.note(&words);
            self.fault = Some(words);
        }
        let code = Newest::of(&self.ring, &self.columns).get(Field::State, 0) as usize;
        let state = State::ALL.get(code).copied().unwrap_or_default();
        if state == State::Fault && (self.state != State::Fault || self.fault.is_none()) {
            let simulated = self.world.simulated.is_some();
            self.fault = self.board().status()?.fault.map(|record| in_words(&record, simulated));
            self.held = None;
        }
        if state != State::Fault && self.state == State::Fault {
            self.fault = None;
        }
        // Rows on their way may be of the time before the last press of the key: the board says how it is.
        let went_off = self.state == State::Armed && state == State::Disarmed && self.held.is_some();
        self.state = state;
        if went_off && self.board().status()?.state == State::Disarmed {
            self.held = None;
            self.refuse_all(Some("off"), "another tool turned the motors off");
        }
        Ok(())
    }

    /// The dead man's key of real motors: silence counts as letting go. An emulated board's steps may pass at a part of
    /// real time, so they alone do not tell.
    fn watch_the_key(&mut self) -> Result<(), LinkError> {
        let age = |seen: u32| f64::from(self.world.board.step().wrapping_sub(seen)) / self.scene.rate_hz;
        let silent = self.listened.saturating_sub(self.key_heard) > SILENCE;
        let too_old = self.held.is_some_and(|seen| silent || age(seen) > SILENCE.as_secs_f64());
        if too_old && self.world.simulated.is_none() {
            self.disarm()?;
            self.refuse_all(Some("off"), "the page in command was not heard: motors off");
        }
        if self.command.is_some_and(|(_, heard)| self.now.saturating_sub(heard) > ABSENCE) {
            self.leave()?;
        }
        Ok(())
    }

    fn disarm(&mut self) -> Result<(), LinkError> {
        (self.held, self.coming_out) = (None, None);
        match self.board().disarm() {
            Err(BoardError::Link(error)) => Err(error),
            Ok(()) | Err(BoardError::Refused(_)) => Ok(()),
        }
    }

    /// The key is pressed: motors on. A simulated hand takes the tip out of a wall first.
    fn press(&mut self, seen: u32) -> Result<(), BoardError> {
        let began = self.coming_out.take().unwrap_or(self.now);
        let armed = match &self.world.simulated {
            Some(_) => self.world.board.arm(),
            None => self.world.board.arm_held(seen),
        };
        if let (Err(BoardError::Refused(Refusal::InsideWall)), Some(simulated)) = (&armed, &self.world.simulated)
            && self.now.saturating_sub(began) < WAY_OUT
            && let Some((_, normal)) = nearest_wall(&self.scene, &self.tip())
        {
            let tip: [f64; 2] = padded(&self.tip());
            let way = OUTSIDE - Newest::of(&self.ring, &self.columns).get(Field::Distance, 0);
            let goal = [tip[0] + way * normal[0], tip[1] + way * normal[1]];
            lead(simulated, Some(goal));
            (self.goal, self.coming_out) = (Some(goal), Some(began));
            return Ok(());
        }
        armed?;
        (self.held, self.key_heard) = (Some(seen), self.listened);
        Ok(())
    }

    /// Takes command from the page that has it.
    fn leave(&mut self) -> Result<(), LinkError> {
        self.command = None;
        self.goal = None;
        if let Some(simulated) = &self.world.simulated {
            lead(simulated, None);
        }
        self.disarm()
    }

    fn hear(&mut self, event: Event) -> Result<(), LinkError> {
        match event {
            Event::Came(id) => {
                self.say(id, &self.about());
                self.say(id, &self.walls());
                if let Some(plane) = &self.plane {
                    self.say(id, &plane_message(plane));
                }
            }
            Event::Gone(id) => {
                self.scopes.remove(&id);
                self.listeners.retain(|listener| *listener != id);
                if self.commands(id) {
                    self.leave()?;
                }
            }
            Event::Said(id, Err(why)) => self.refuse(id, &why),
            Event::LeftOut(id, count) => self.refuse(id, &format!("too much at once: {count} messages were left out")),
            Event::Said(id, Ok(message)) => {
                if let Some((holder, heard)) = &mut self.command
                    && *holder == id
                {
                    *heard = self.now;
                }
                match self.act(id, message) {
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

    /// Keeps in the recording what happened.
    fn note(&mut self, words: &str) {
        if let Some(recording) = &mut self.recording
            && let Err(error) = recording.note(words)
        {
            self.recording_failed(error);
        }
    }

    fn commands(&self, id: PageId) -> bool {
        self.command.is_some_and(|(holder, _)| holder == id)
    }

    fn act(&mut self, id: PageId, message: FromPage) -> Result<(), BoardError> {
        // Every page may do these.
        match &message {
            FromPage::Here {} => return Ok(()),
            FromPage::Disarm {} => return Ok(self.disarm()?),
            FromPage::Explain {} => {
                self.oracle.explain();
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
        if !self.commands(id) {
            if !matches!(message, FromPage::Release {} | FromPage::Hold { .. }) {
                match self.command {
                    Some(_) => self.refuse_while("watching", id, "another page is in command; this one watches"),
                    None => self.refuse_while("nobody", id, "nobody is in command: take it first"),
                }
            }
            return Ok(());
        }
        match message {
            FromPage::Give {} => self.leave()?,
            FromPage::Release {} => self.disarm()?,
            FromPage::Arm { seen } if self.held.is_none() => self.press(seen)?,
            FromPage::Hold { seen } if self.coming_out.is_some() => self.press(seen)?,
            // Only a press arms: not a key that was down when something else turned the motors off.
            FromPage::Arm { seen } | FromPage::Hold { seen } => {
                self.key_heard = self.listened;
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
                    lead(simulated, at);
                    self.goal = at;
                }
                Some(_) => self.refuse(id, "a place is two finite numbers"),
                None => self.refuse(id, "this device is not simulated: take it into your own hand"),
            },
            FromPage::StartOver { pose } => match self.world.simulated.clone() {
                Some(simulated) => self.start_over(id, &simulated, pose)?,
                None => self.refuse(id, "this device is not simulated: move it back by hand"),
            },
            FromPage::Here {}
            | FromPage::Disarm {}
            | FromPage::Take {}
            | FromPage::Explain {}
            | FromPage::Scope(_)
            | FromPage::Sound { .. } => {}
        }
        Ok(())
    }

    /// Puts device, hand, walls and gains back to how they were in the beginning, or the device into another pose.
    fn start_over(&mut self, id: PageId, simulated: &SharedBoard, pose: Option<Vec<f64>>) -> Result<(), BoardError> {
        let start = match pose {
            None => simulated.lock().device().start(),
            Some(q)
                if q.len() == self.device.axes()
                    && q.iter().all(|angle| angle.abs() <= TAU)
                    && TaskPose::of(&self.device.mechanism, &q).is_ok() =>
            {
                padded(&q)
            }
            Some(_) => {
                self.refuse(id, &format!("a pose is {} angles (rad) that the device can have", self.device.axes()));
                return Ok(());
            }
        };
        self.disarm()?;
        lead(simulated, None);
        self.goal = None;
        simulated.lock().device_mut().place(start);
        // To the board's encoders this is a jump: a fault, of which nobody is to hear.
        self.world.board.rows(SLICE)?;
        match self.board().clear() {
            Err(BoardError::Link(error)) => return Err(error.into()),
            Ok(()) | Err(BoardError::Refused(_)) => {}
        }
        self.world.board.rows(SLICE)?;
        self.world.board.take_reported_faults();
        let first = self.first.clone();
        self.board().set_scene(&first)?;
        (self.last_step, self.asked, self.plane) = (None, None, None);
        self.let_time_pass(SLICE)?;
        self.trail.clear();
        self.note("started over");
        self.say_to_all(&self.about());
        self.reread()
    }

    fn tip(&self) -> Vec<f64> {
        let newest = Newest::of(&self.ring, &self.columns);
        (0..usize::from(self.scene.task)).map(|axis| newest.get(Field::Tip, axis)).collect()
    }

    fn look(&mut self) -> Result<(), LinkError> {
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
