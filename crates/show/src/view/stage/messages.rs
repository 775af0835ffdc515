//! Messages to pages: pictures, sweeps, the device, the walls, and refusals.

use super::recording::{ActiveRecording, RecordingStatus};
use super::{MAX_JOINT_ROTATION, Stage};
use crate::demo::crossing::hand_settings;
use crate::outline::{outline, outline_on_track};
use crate::view::hub::PageId;
use crate::view::picture::{Geometry, Newest, Numbers, nearest_wall};
use crate::view::stability::{Plane, PredictionRequest, predict_buzz};
use crate::view::world::World;
use haptic_bridge::control::HostAction;
use haptic_bridge::render::scene::Surface;
use haptic_bridge::safety::fault::FaultRecord;
use haptic_stability::analysis::flexible::Hand;
use haptic_stability::analysis::oscillation::Oscillation;
use nalgebra::Vector3;
use serde::Serialize;
use serde_json::{Value, json};

#[derive(Serialize)]
struct Picture<'a> {
    is: &'static str,
    time: f64,
    step: u32,
    state: &'static str,
    /// Joint angles, rad.
    q: &'a [f64],
    geometry: &'a Geometry,
    numbers: &'a Numbers,
    trail: &'a [[f64; 2]],
    hand: Option<HandState>,
    command: Option<PageId>,
    held: bool,
    fault: Option<&'a str>,
    losses: String,
    lost: u64,
    load: Option<f64>,
    speed: Option<f64>,
    pages: usize,
    buzz: Option<Oscillation>,
    recording: Option<RecordingStatus>,
    if_lost: &'static str,
}

#[derive(Serialize)]
struct HandState {
    at: [f64; 2],
    goal: [f64; 2],
    force: [f64; 2],
}

impl Stage {
    pub(super) fn send_pictures(&mut self) {
        let newest = Newest::of(&self.ring, &self.columns);
        let links = self.world.file.as_ref().map(|file| &file.description);
        let (geometry, numbers) = newest.moment(&self.device, links, &self.tracks, &self.scene, self.rows_hz);
        let hand = self.world.simulated.as_ref().and_then(|board| {
            let board = board.lock();
            let [x, y, _] = board.device().hand().position()?;
            let [fx, fy, _] = board.device().hand_force();
            Some(HandState { at: [x, y], goal: self.goal.unwrap_or([x, y]), force: [fx, fy] })
        });
        let every = self.trail.len().div_ceil(32).max(1);
        let trail: Vec<[f64; 2]> = self.trail.drain(..).step_by(every).collect();
        let losses = self.world.board.losses();
        let q = newest.q(self.device.axes());
        let picture = Picture {
            is: "picture",
            time: self.world.board.now().as_secs_f64(),
            step: self.world.board.step(),
            state: crate::recorder::STATES[self.state as usize],
            q: &q,
            geometry: &geometry,
            numbers: &numbers,
            trail: &trail,
            hand,
            command: self.command.map(|(id, _)| id),
            held: self.held.is_some(),
            fault: self.fault.as_deref(),
            lost: losses.missing,
            losses: losses.to_string(),
            load: self.load,
            speed: self.world.simulated.is_some().then_some(self.pace.speed),
            pages: self.hub.count(),
            buzz: self.buzz.filter(|_| numbers.wall == self.plane.as_ref().map(|plane| plane.wall)),
            recording: self.recording.as_ref().map(ActiveRecording::status),
            if_lost: self.motors_if_lost(),
        };
        // NaN and infinities become null, which a page ignores.
        if let Ok(text) = serde_json::to_string(&picture) {
            self.hub.with_every_outbox(|outbox| outbox.picture = Some(text.clone()));
        }
        let sound = std::mem::take(&mut self.sound);
        for listener in &self.listeners {
            self.hub.with_outbox(*listener, |outbox| outbox.queue_sound(self.rows_hz as f32, &sound));
        }
        let Some((wall, normal)) = nearest_wall(&self.scene, &self.tip()) else { return };
        let has_moved = self.requested.as_ref().is_none_or(|(requested, at)| {
            *requested != wall || at.iter().zip(&q).any(|(before, now)| (before - now).abs() > MAX_JOINT_ROTATION)
        });
        // Computes the limiting effects once for a pose and a feed-forward, however often pages request them.
        let explain = self.predictor.should_explain(self.state.drives());
        let explained = self.plane.as_ref().and_then(|plane| plane.limits.as_ref()).map(|limits| limits.feed_forward);
        let is_unexplained = explain
            && self.plane.as_ref().is_some_and(|plane| plane.wall == wall)
            && self.scene.walls.get(wall).map(|wall| wall.feed_forward) != explained;
        if (has_moved || is_unexplained) && self.ring.end() > 0 && !self.predictor.is_busy() {
            self.predictor.request(PredictionRequest { explain, ..self.prediction_request(wall, q.clone(), &normal) });
            self.requested = Some((wall, q));
        }
        if let Some(result) = self.predictor.take_result() {
            self.plane = result;
            self.buzz = self.predicted_buzz();
            let message = self.plane.as_ref().map_or(json!({"is": "plane", "plane": null}), plane_message);
            self.send_to_all(&message);
        }
    }

    fn prediction_request(&self, wall: usize, q: Vec<f64>, normal: &Vector3<f64>) -> PredictionRequest {
        let hand = hand_settings();
        // The hand's grip holds the tip, because a hand hardly moves at the frequency of a buzz.
        let grip = Hand { mass: 0.0, damping: hand.grip_damping, stiffness: hand.grip_stiffness };
        PredictionRequest {
            subject: self.subject.clone(),
            scene: self.scene.clone(),
            wall,
            q,
            normal: normal.as_slice()[..usize::from(self.scene.task)].to_vec(),
            path: self.path.clone(),
            hand: self.world.simulated.is_some().then_some(grip),
            explain: false,
        }
    }

    /// Returns the predicted oscillation of the nearest wall if its gains are unstable. Computed with every boundary
    /// and every change of the scene, not for every picture.
    pub(super) fn predicted_buzz(&self) -> Option<Oscillation> {
        let (index, normal) = nearest_wall(&self.scene, &self.tip())?;
        let (requested, q) = self.requested.as_ref()?;
        let (plane, wall) = (self.plane.as_ref()?, self.scene.walls.get(index)?);
        let is_unstable = wall.stiffness > plane.max_stiffness(wall.feed_forward, wall.damping);
        let is_valid = [*requested, plane.wall].iter().all(|wall| *wall == index) && is_unstable;
        let oscillation = is_valid.then(|| predict_buzz(&self.prediction_request(index, q.clone(), &normal)))??;
        (oscillation.growth_per_s > 0.0).then_some(oscillation)
    }

    /// Describes the state of the motors if the connection to this stage is lost.
    fn motors_if_lost(&self) -> &'static str {
        match (self.world.simulated.is_some(), self.state.drives(), self.rules.host_action) {
            (true, ..) => "the simulated board is gone, or the lost key turned its motors off",
            _ if self.held.is_some() => {
                "the board turns its motors off half a second after the last message about the key"
            }
            (_, true, HostAction::Disarm) => {
                "another tool turned the motors on; the board turns them off if no tool reports to it"
            }
            (_, true, _) => "the motors MAY BE ON: another tool turned them on, and the board does not watch its host",
            (_, false, _) => "the motors were off in the last picture",
        }
    }

    pub(super) fn send_sweeps(&mut self) {
        for (id, scope) in &mut self.scopes {
            if let Some(sweep) = scope.sweep(&self.ring) {
                let bytes = scope.encode(&sweep);
                self.hub.with_outbox(*id, |outbox| outbox.scope = Some(bytes));
            }
        }
    }

    /// Returns the message with the facts that do not change during a view.
    pub(super) fn hello_message(&self) -> Value {
        let info = self.world.board.info();
        json!({
            "is": "hello",
            "device": self.device.name.as_str(),
            "scene": self.world.scene_name,
            "board": info.board.as_str(),
            "serial": info.serial.as_str(),
            "port": self.world.board.port(),
            "simulated": self.world.simulated.is_some(),
            "worlds": World::names().collect::<Vec<_>>(),
            "records": self.folder.is_some(),
            "weightless": self.world.weightless, "smooth": self.world.smooth,
            "flat": self.device.mechanism.kind().spec().task == 2,
            "task": self.device.mechanism.kind().spec().task,
            "tracks": &self.tracks,
            "rate_hz": self.scene.rate_hz,
            "rows_hz": self.rows_hz,
            "cutoff_hz": self.scene.cutoff_hz,
            "columns": self.columns.iter().map(|column| column.label.as_str()).collect::<Vec<_>>(),
        })
    }

    pub(super) fn walls_message(&self) -> Value {
        let wall_outline = |surface: &Surface<f64>| match self.tracks.as_slice() {
            [] => (None, outline(surface)),
            tracks => outline_on_track(surface, tracks).unzip(),
        };
        let walls = self.scene.walls.iter().map(|wall| {
            let (track, outline) = wall_outline(&wall.surface);
            json!({
                "shape": wall.surface.spec().name, "values": wall.surface.values(),
                "outline": outline, "track": track, "stiffness": wall.stiffness,
                "damping": wall.damping, "feed_forward": wall.feed_forward,
            })
        });
        let springs = self.scene.springs.iter().map(|spring| {
            json!({
                "point": spring.point, "direction": spring.direction, "stiffness": spring.stiffness,
                "damping": spring.damping,
            })
        });
        json!({
            "is": "walls", "walls": walls.collect::<Vec<_>>(), "springs": springs.collect::<Vec<_>>(),
            "field_damping": self.scene.field_damping,
        })
    }

    pub(super) fn send(&self, id: PageId, message: &Value) {
        self.hub.with_outbox(id, |outbox| outbox.queue_document(message.to_string()));
    }

    pub(super) fn send_to_all(&self, message: &Value) {
        let text = message.to_string();
        self.hub.with_every_outbox(|outbox| outbox.queue_document(text.clone()));
    }

    pub(super) fn refuse(&self, id: PageId, why: &str) {
        self.send(id, &json!({"is": "refused", "why": why}));
    }

    /// Sends a refusal that the page shows while `cause` persists, a name in page/link.js.
    pub(super) fn refuse_while(&self, cause: &str, id: PageId, why: &str) {
        self.send(id, &json!({"is": "refused", "of": cause, "why": why}));
    }

    pub(super) fn refuse_all(&self, cause: Option<&str>, why: &str) {
        self.send_to_all(&json!({"is": "refused", "of": cause, "why": why}));
    }
}

pub(super) fn plane_message(plane: &Plane) -> Value {
    json!({"is": "plane", "plane": plane})
}

/// Describes a fault and its remedy; for a device that is simulated in this process, without advice about hardware.
pub(super) fn describe_fault(record: &FaultRecord, simulated: bool) -> String {
    let joint = record.axis.map_or(String::new(), |axis| format!(" (joint {axis})"));
    let remedy = match simulated {
        true => "a simulated device cannot break: start over, or clear the fault and continue",
        false => record.fault.remedy(),
    };
    format!("{}{joint}: {remedy}", record.fault)
}
