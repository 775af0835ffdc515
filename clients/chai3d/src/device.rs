//! The one device that CHAI3D gets to see: a board, in CHAI3D's frame, at a tick of a millisecond.

use haptic_host::frame::Axes;
use haptic_host::haptic_bridge::board::protocol::{DeviceData, ForceAnswer};
use haptic_host::haptic_bridge::control::host_force::MOST_HELD_FORCE;
use haptic_host::haptic_bridge::model::device::Device as BoardDevice;
use haptic_host::haptic_bridge::render::scene::Scene;
use haptic_host::haptic_bridge::safety::fault::{Fault, State};
use haptic_host::link::{BoardError, LinkError, PortSpec, Session};
use haptic_host::vectors::padded;
use haptic_host::words::{fault_and_remedy, for_a_program};
use haptic_stability::analysis::map::Reachable;
use haptic_stability::analysis::pose::TaskPose;
use std::time::{Duration, Instant};

/// From one tick of the control loop to the next: what CHAI3D's devices have.
pub const TICK: Duration = Duration::from_millis(1);

/// Angles of each joint that are tried to find out how large the workspace is.
const ANGLES: usize = 24;
/// CHAI3D divides by the radius, m.
const LEAST_RADIUS: f64 = 0.01;

/// Ticks between two attempts to open a board that went away: half a second.
const RETRY: u32 = 500;
/// Commands that a person would type, and what a program does instead.
const CALLS: [(&str, &str); 1] = [("faults --clear", "close and open the device")];

/// Opens the board, also once more.
type Opener = Box<dyn FnMut() -> Result<Session, String> + Send>;

/// A board that a program made with CHAI3D uses.
pub struct HdDevice {
    open: Opener,
    /// None while the board is gone.
    session: Option<Session>,
    /// The board's device: a board with another one in its place is not this device.
    held: DeviceData,
    axes: Axes,
    /// The tip that is CHAI3D's origin, m.
    centre: [f64; 3],
    /// As far as the tip goes in every direction that it has, about, m.
    pub radius: f64,
    /// The name of the device.
    pub name: String,
    last: ForceAnswer,
    tick: Instant,
    /// Ticks since the board went away.
    gone: u32,
    /// Simulated time passes only while somebody waits for it.
    simulated: bool,
    /// Why the motors are off was said.
    told: bool,
    /// A force that no board accepts was reported.
    told_absurd: bool,
    /// The program has the motors on, as far as it knows.
    armed: bool,
    /// A fault that came while it had is cleared when it opens the device again; no other fault is.
    tripped: bool,
}

/// The board's device, in a scene, and how it is.
fn look(session: &mut Session) -> Result<(DeviceData, ForceAnswer), String> {
    let device = session.device().map_err(|error| error.to_string())?;
    let device = device.ok_or("the board has no device; load one with `haptic device`")?;
    if session.scene().map_err(|error| error.to_string())?.is_none() {
        let task = device.mechanism.kind().spec().task as u8;
        session.set_scene(&Scene { task, ..Scene::default() }).map_err(|error| error.to_string())?;
    }
    let state = session.look().map_err(|error| error.to_string())?;
    Ok((device, state))
}

impl HdDevice {
    /// Opens the board at HAPTIC_PORT, or a simulated one. Errors are words for a person.
    pub fn open() -> Result<Self, String> {
        let port = std::env::var("HAPTIC_PORT").unwrap_or_else(|_| "sim".into());
        let spec = port.parse::<PortSpec>()?;
        let simulated = matches!(spec, PortSpec::Sim(_));
        Self::with(
            Box::new(move || haptic_sim::open(&spec).map(Session::of).map_err(|error| error.to_string())),
            simulated,
        )
    }

    fn with(mut open: Opener, simulated: bool) -> Result<Self, String> {
        let mut session = open()?;
        let (held, last) = look(&mut session)?;
        let device = held.cast::<f64>();
        let task = device.mechanism.kind().spec().task;
        let axes = match std::env::var("HAPTIC_AXES") {
            Ok(text) => text.parse().map_err(|error| format!("HAPTIC_AXES: {error}"))?,
            Err(_) => Axes::of(device.mechanism.kind(), device.weight),
        };
        if let Some((index, _)) = axes.0.iter().flatten().find(|(index, _)| *index >= task) {
            return Err(format!("HAPTIC_AXES names axis {index} (from 0), and the device has {task}"));
        }
        let (centre, radius) = workspace(&device, last.tip.map(f64::from));
        Ok(Self {
            open,
            session: Some(session),
            name: format!("haptic-bridge {}", device.name.as_str()),
            held,
            axes,
            centre,
            radius,
            last,
            tick: Instant::now(),
            gone: 0,
            simulated,
            told: false,
            told_absurd: false,
            armed: false,
            tripped: false,
        })
    }

    /// Motors on; why they stay off goes to standard error, once.
    pub fn arm(&mut self) -> bool {
        if self.session.is_none() {
            self.open_anew();
        }
        let Some(session) = &mut self.session else { return false };
        let cleared = if self.tripped { session.clear() } else { Ok(()) };
        match cleared.and_then(|()| session.arm()) {
            Ok(()) => {
                (self.tick, self.told, self.armed, self.tripped) = (Instant::now(), false, true, false);
                true
            }
            // Nobody knows whether they are on.
            Err(BoardError::Link(error)) => self.lost(&error),
            Err(refused) => {
                self.tell(format!("the motors stay off: {refused}"));
                false
            }
        }
    }

    /// Motors off.
    pub fn disarm(&mut self) -> bool {
        let off = self.session.as_mut().is_some_and(|session| session.disarm().is_ok());
        self.armed &= !off;
        off
    }

    /// The position of the tip at the last tick, m; `None` while the board is gone.
    pub fn position(&self) -> Option<[f64; 3]> {
        let tip = self.last.tip.map(f64::from);
        self.session.as_ref()?;
        Some(self.axes.to_chai3d(std::array::from_fn(|i| tip[i] - self.centre[i])))
    }

    /// The velocity of the tip, m/s; `None` while the board is gone.
    pub fn velocity(&self) -> Option<[f64; 3]> {
        self.session.as_ref()?;
        Some(self.axes.to_chai3d(self.last.velocity.map(f64::from)))
    }

    /// Sends a force (N), waits for the next tick and reads how the device is then. A force that no board accepts is
    /// replaced by none, and the call reports failure. Where the board is gone, it is looked for now and then.
    pub fn force(&mut self, force: [f64; 3]) -> bool {
        let usable = force.iter().all(|newtons| newtons.abs() <= f64::from(MOST_HELD_FORCE));
        if !usable && !self.told_absurd {
            haptic_host::tell!("haptic-bridge: a force of {force:?} N is none: the motors get 0 N");
            self.told_absurd = true;
        }
        let force = self.axes.to_task(if usable { force } else { [0.0; 3] });
        let Some(session) = &mut self.session else {
            // A program whose device is gone must not spin.
            std::thread::sleep(TICK);
            self.gone += 1;
            if self.gone.is_multiple_of(RETRY) {
                self.open_anew();
            }
            return false;
        };
        let sent = match session.force(force.map(|newtons| newtons as f32)) {
            Ok(sent) => sent,
            Err(error) => return self.lost(&error),
        };
        if sent.state == State::Fault {
            self.tripped |= std::mem::take(&mut self.armed);
            let how = if self.tripped { "; closing and opening the device clears it" } else { "" };
            let why = session.fault().map_or_else(String::new, |record| {
                format!(": {}{how}", for_a_program(&fault_and_remedy(&record), &CALLS))
            });
            self.tell(format!("the board has turned its motors off{why}"));
        }
        if let Some(session) = self.session.as_mut().filter(|_| self.simulated)
            && let Err(error) = session.rows(TICK)
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
        match self.session.as_mut().map(Session::look) {
            Some(Ok(state)) => {
                self.last = state;
                usable
            }
            Some(Err(error)) => self.lost(&error),
            None => false,
        }
    }

    fn lost(&mut self, error: &LinkError) -> bool {
        // After a lost frame the next force goes on.
        if matches!(error, LinkError::Unanswered { .. }) {
            return false;
        }
        (self.session, self.gone, self.told) = (None, 0, false);
        self.tell("the board is gone; once it is back it is found again".into());
        false
    }

    /// Opens a board that went away, if it is back. Its motors stay as they are: whoever plugs it in may hold it.
    fn open_anew(&mut self) {
        let Ok(mut session) = (self.open)() else { return };
        match look(&mut session) {
            Ok((held, last)) if held == self.held => {
                // That the board lost this program is its own to clear; what else came meanwhile, somebody has to look at.
                if let Some(record) = session.status().ok().and_then(|status| status.fault) {
                    self.tripped = std::mem::take(&mut self.armed) && record.fault == Fault::HostLost;
                }
                (self.session, self.last, self.told) = (Some(session), last, false);
                self.tell("the board is back; closing and opening the device turns its motors on".into());
                self.told = false;
            }
            Ok(_) => self.tell("another device is on the board now: start the program again".into()),
            Err(_) => {}
        }
    }

    /// Says something to a person, once until it has changed.
    fn tell(&mut self, words: String) {
        if !self.told {
            haptic_host::tell!("haptic-bridge: {words}");
            self.told = true;
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use haptic_host::device_file::DeviceFile;
    use haptic_host::link::{Board, Wire};
    use haptic_sim::{BoardOptions, SHIPPED_DEVICE, SharedBoard, ready_board};
    use std::io;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};

    /// A wire that can be pulled.
    struct Cable(Box<dyn Wire>, Arc<AtomicBool>);

    impl Cable {
        fn there(&self) -> io::Result<()> {
            if self.1.load(Ordering::Relaxed) { Ok(()) } else { Err(io::ErrorKind::UnexpectedEof.into()) }
        }
    }

    impl Wire for Cable {
        fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
            self.there()?;
            self.0.send(bytes)
        }
        fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
            self.there()?;
            self.0.receive(buffer, timeout)
        }
        fn now(&self) -> Duration {
            self.0.now()
        }
    }

    /// A board that asks what a real one asks, ready to arm; the program's device; and its cable.
    fn device() -> (SharedBoard, HdDevice, Arc<AtomicBool>) {
        let mut file = DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml").unwrap();
        for joint in &mut file.description.joints[..2] {
            joint.motor.as_mut().unwrap().verified = true;
            joint.limits = Some((-4.0, 4.0));
        }
        let options = BoardOptions { strict: true, ..BoardOptions::default() };
        let board = SharedBoard::new(ready_board(&file, options).unwrap());
        let (shared, plugged) = (board.clone(), Arc::new(AtomicBool::new(true)));
        let cable = Arc::clone(&plugged);
        let open = move || {
            let wire = Cable(shared.wire(), Arc::clone(&cable));
            Board::over(Box::new(wire), "sim").map(Session::of).map_err(|error| error.to_string())
        };
        let mut device = HdDevice::with(Box::new(open), false).unwrap();
        let session = device.session.as_mut().unwrap();
        session.set_scene(&Scene { task: 2, rate_hz: 1_000.0, cutoff_hz: 50.0, ..Scene::default() }).unwrap();
        session.home().unwrap();
        session.check_polarity().unwrap();
        session.wait_for_polarity().unwrap().passed().unwrap();
        assert!(device.arm());
        (board, device, plugged)
    }

    #[test]
    fn a_fault_is_cleared_by_closing_and_opening_the_device() {
        let (board, mut device, _) = device();
        assert!(device.force([0.0; 3]));
        board.lock().run(0.6);
        assert!(device.force([0.0; 3]), "positions go on");
        assert_eq!(board.lock().status().state, State::Fault);
        assert!(device.disarm() && device.arm());
        assert_eq!(board.lock().status().state, State::Armed);
    }

    #[test]
    fn a_fault_that_came_while_the_motors_were_off_is_not_the_programs_to_clear() {
        let (board, mut device, _) = device();
        assert!(device.disarm());
        board.lock().inject(Fault::GateDriver, None, 0.0);
        board.lock().run(0.01);
        device.force([0.0; 3]);
        assert!(!device.arm());
        assert_eq!(board.lock().status().state, State::Fault);
    }

    #[test]
    fn a_board_that_is_lost_while_it_arms_is_gone_and_not_told_to_be_off() {
        let (_, mut device, plugged) = device();
        assert!(device.disarm());
        plugged.store(false, Ordering::Relaxed);
        assert!(!device.arm());
        assert_eq!(device.position(), None);
    }

    #[test]
    fn a_board_that_comes_back_is_found_again_and_armed_by_opening_the_device() {
        let (board, mut device, plugged) = device();
        plugged.store(false, Ordering::Relaxed);
        assert!(!device.force([0.0; 3]));
        assert_eq!((device.position(), device.velocity()), (None, None), "the last place is not where it is");
        assert!(!device.disarm() && !device.arm());
        plugged.store(true, Ordering::Relaxed);
        // Its watch has let go meanwhile.
        board.lock().run(0.6);
        while device.position().is_none() {
            assert!(!device.force([0.0; 3]));
        }
        assert!(device.force([0.0; 3]));
        assert_eq!(board.lock().status().state, State::Fault);
        assert!(device.disarm() && device.arm());
        assert_eq!(board.lock().status().state, State::Armed);
    }
}
