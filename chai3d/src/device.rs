//! The one device that CHAI3D gets to see: a board, in CHAI3D's frame, at a tick of a millisecond.

use haptic::analysis::map::Reachable;
use haptic::analysis::pose::TaskPose;
use haptic::frame::Axes;
use haptic::haptic_bridge::board::protocol::ForceAnswer;
use haptic::haptic_bridge::model::device::Device as BoardDevice;
use haptic::haptic_bridge::render::scene::Scene;
use haptic::haptic_bridge::safety::fault::State;
use haptic::haptic_bridge::servo::host_force::MOST_HELD_FORCE;
use haptic::link::{LinkError, PortSpec, Session};
use haptic::vectors::padded;
use std::time::{Duration, Instant};

/// From one tick of the servo loop to the next: what CHAI3D's devices have.
pub const TICK: Duration = Duration::from_millis(1);

/// Angles of each joint that are tried to find out how large the workspace is.
const ANGLES: usize = 24;
/// CHAI3D divides by the radius, m.
const LEAST_RADIUS: f64 = 0.01;

/// A board that a program made with CHAI3D uses.
pub struct HdDevice {
    session: Session,
    axes: Axes,
    /// The tip that is CHAI3D's origin, m.
    centre: [f64; 3],
    /// As far as the tip goes in every direction that it has, about, m.
    pub radius: f64,
    /// What the device is called.
    pub name: String,
    last: ForceAnswer,
    tick: Instant,
    /// Simulated time passes only while somebody waits for it.
    simulated: bool,
    /// Why the motors are off was said.
    told: bool,
    /// A force that is none was said.
    told_absurd: bool,
}

impl HdDevice {
    /// Opens the board at HAPTIC_PORT, or a simulated one. Errors are words for a person.
    pub fn open() -> Result<Self, String> {
        let port = std::env::var("HAPTIC_PORT").unwrap_or_else(|_| "sim".into());
        let spec = port.parse::<PortSpec>()?;
        let mut session = Session::open(&spec).map_err(|error| error.to_string())?;
        let device = session.device().map_err(|error| error.to_string())?;
        let device = device.ok_or("the board has no device; load one with `haptic device`")?.cast::<f64>();
        let task = device.mechanism.kind().spec().task;
        if session.scene().map_err(|error| error.to_string())?.is_none() {
            let free = Scene { task: task as u8, ..Scene::default() };
            session.set_scene(&free).map_err(|error| error.to_string())?;
        }
        let axes = match std::env::var("HAPTIC_AXES") {
            Ok(text) => text.parse().map_err(|error| format!("HAPTIC_AXES: {error}"))?,
            Err(_) => Axes::of(device.mechanism.kind(), device.weight),
        };
        if let Some((index, _)) = axes.0.iter().flatten().find(|(index, _)| *index >= task) {
            return Err(format!("HAPTIC_AXES names axis {index} (from 0), and the device has {task}"));
        }
        let last = session.look().map_err(|error| error.to_string())?;
        let (centre, radius) = workspace(&device, last.tip.map(f64::from));
        Ok(Self {
            session,
            axes,
            centre,
            radius,
            name: format!("haptic-bridge {}", device.name.as_str()),
            last,
            tick: Instant::now(),
            simulated: matches!(spec, PortSpec::Sim(_)),
            told: false,
            told_absurd: false,
        })
    }

    /// Motors on; why they stay off goes to standard error, once.
    pub fn arm(&mut self) -> bool {
        match self.session.arm() {
            Ok(()) => {
                (self.tick, self.told) = (Instant::now(), false);
                true
            }
            Err(error) => {
                if !self.told {
                    haptic::tell!("haptic-bridge: the motors stay off: {error}");
                    self.told = true;
                }
                false
            }
        }
    }

    /// Motors off.
    pub fn disarm(&mut self) -> bool {
        self.session.disarm().is_ok()
    }

    /// Where the tip was at the last tick, m.
    pub fn position(&self) -> [f64; 3] {
        let tip = self.last.tip.map(f64::from);
        self.axes.to_chai3d(std::array::from_fn(|i| tip[i] - self.centre[i]))
    }

    /// How fast it was, m/s.
    pub fn velocity(&self) -> [f64; 3] {
        self.axes.to_chai3d(self.last.velocity.map(f64::from))
    }

    /// Sends a force (N), waits for the next tick and reads how the device is then. A force that no board accepts is
    /// replaced by none, and the call reports failure.
    pub fn force(&mut self, force: [f64; 3]) -> bool {
        let usable = force.iter().all(|newtons| newtons.abs() <= f64::from(MOST_HELD_FORCE));
        if !usable && !self.told_absurd {
            haptic::tell!("haptic-bridge: a force of {force:?} N is none: the motors get 0 N");
            self.told_absurd = true;
        }
        let force = self.axes.to_task(if usable { force } else { [0.0; 3] });
        let sent = match self.session.force(force.map(|newtons| newtons as f32)) {
            Ok(sent) => sent,
            Err(error) => return self.lost(&error),
        };
        if sent.state == State::Fault && !self.told {
            let fault = self.session.status().ok().and_then(|status| status.fault);
            let why = fault.map_or_else(String::new, |record| format!(": {}", record.fault));
            haptic::tell!("haptic-bridge: the board has turned its motors off{why}");
            self.told = true;
        }
        if self.simulated
            && let Err(error) = self.session.rows(TICK)
        {
            return self.lost(&error);
        }
        self.tick += TICK;
        let now = Instant::now();
        match self.tick.checked_duration_since(now) {
            Some(left) => std::thread::sleep(left),
            // Who is late does not hurry afterwards.
            None => self.tick = now,
        }
        match self.session.look() {
            Ok(state) => {
                self.last = state;
                usable
            }
            Err(error) => self.lost(&error),
        }
    }

    fn lost(&mut self, error: &LinkError) -> bool {
        // After a lost frame the next force goes on.
        if !self.told && !matches!(error, LinkError::Unanswered { .. }) {
            haptic::tell!("haptic-bridge: the board is gone");
            self.told = true;
        }
        // A program whose device is gone must not spin.
        std::thread::sleep(TICK);
        false
    }
}

/// The tip at home (without a home, `here`), and how far the tip goes from there in the direction where that is least,
/// m.
fn workspace(device: &BoardDevice<f64>, here: [f64; 3]) -> ([f64; 3], f64) {
    let task = device.mechanism.kind().spec().task;
    let tip = |q: &[f64]| TaskPose::of(&device.mechanism, q).map(|pose| pose.position);
    let home = device.home.and_then(|home| tip(&home[..device.axes()]).ok());
    let centre = home.map_or(here, |tip| padded(&tip));
    let (mut low, mut high) = (centre, centre);
    if let Ok(reachable) = Reachable::of(device, ANGLES, None) {
        for tip in reachable.indices().filter_map(|index| tip(&reachable.angles(index)).ok()) {
            for (i, place) in tip.into_iter().enumerate().take(3) {
                (low[i], high[i]) = (low[i].min(place), high[i].max(place));
            }
        }
    }
    let spans = (0..task).map(|i| (high[i] - centre[i]).min(centre[i] - low[i]));
    (centre, spans.fold(f64::INFINITY, f64::min).max(LEAST_RADIUS))
}
