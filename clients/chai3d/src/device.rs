//! The only device that CHAI3D finds: a board, in CHAI3D's frame, with a tick of 1 ms.

use haptic_host::frame::{Axes, rotation};
use haptic_host::haptic_bridge::board::protocol::{DeviceData, ForceAnswer};
use haptic_host::haptic_bridge::control::host_force::MAX_HELD_FORCE;
use haptic_host::haptic_bridge::model::device::Device as BoardDevice;
use haptic_host::haptic_bridge::render::scene::Scene;
use haptic_host::haptic_bridge::safety::fault::{Fault, State};
use haptic_host::link::{BoardError, LinkError, PortSpec, Session};
use haptic_host::vectors::padded;
use haptic_host::words::{commands_to_calls, fault_and_remedy};
use haptic_stability::analysis::map::Reachable;
use haptic_stability::analysis::pose::TaskPose;
use std::time::{Duration, Instant};

/// Period of a tick, the same as of CHAI3D's other devices.
pub const TICK: Duration = Duration::from_millis(1);

/// Number of angles per joint that are sampled for the size of the workspace.
const ANGLES_PER_JOINT: usize = 24;
/// Smallest radius of the workspace, m, which is not 0 because CHAI3D divides by the radius.
const MIN_RADIUS_M: f64 = 0.01;

/// Number of ticks between two attempts to reopen a lost board (0.5 s).
const RETRY_TICKS: u32 = 500;
/// Commands of the tool, and the actions of a program that replace them.
const CALLS: [(&str, &str); 1] = [("faults --clear", "close and open the device")];

/// Opens or reopens the board.
type OpenBoard = Box<dyn FnMut() -> Result<Session, String> + Send>;

/// A board for a program made with CHAI3D.
pub struct HdDevice {
    open: OpenBoard,
    /// `None` while the board is lost.
    session: Option<Session>,
    /// The board's device. A reopened board with another device is refused.
    device_data: DeviceData,
    axes: Axes,
    /// Tip position at CHAI3D's origin, m.
    centre: [f64; 3],
    /// Approximate radius of the workspace in every direction of the device, m.
    pub radius: f64,
    /// Name of the device.
    pub name: String,
    last: ForceAnswer,
    tick: Instant,
    /// Number of ticks since the board was lost.
    lost_ticks: u32,
    /// True for a simulated board, whose time advances only while a caller waits.
    is_simulated: bool,
    /// True if the present state of the motors has been reported.
    is_reported: bool,
    /// True if an invalid force has been reported.
    is_invalid_force_reported: bool,
    /// True if the motors are on according to the latest reply.
    is_armed: bool,
    /// True if a fault occurred while the motors were on, which opening the device again clears.
    is_tripped: bool,
}

/// Reads the board's device and state, and loads free space if the board has no scene.
fn read_device(session: &mut Session) -> Result<(DeviceData, ForceAnswer), String> {
    let device = session.device().map_err(|error| error.to_string())?;
    let device = device.ok_or("the board has no device; load one with `haptic device`")?;
    if session.scene().map_err(|error| error.to_string())?.is_none() {
        let task = device.mechanism.kind().spec().task as u8;
        session.set_scene(&Scene { task, ..Scene::default() }).map_err(|error| error.to_string())?;
    }
    let state = session.read_state().map_err(|error| error.to_string())?;
    Ok((device, state))
}

impl HdDevice {
    /// Opens the board at HAPTIC_PORT, by default a simulated board. Returns an error message for the user.
    pub fn open() -> Result<Self, String> {
        let port = std::env::var("HAPTIC_PORT").unwrap_or_else(|_| "sim".into());
        let spec = port.parse::<PortSpec>()?;
        let is_simulated = matches!(spec, PortSpec::Sim(_));
        Self::with_opener(
            Box::new(move || haptic_sim::open(&spec).map(Session::of).map_err(|error| error.to_string())),
            is_simulated,
        )
    }

    fn with_opener(mut open: OpenBoard, is_simulated: bool) -> Result<Self, String> {
        let mut session = open()?;
        let (device_data, last) = read_device(&mut session)?;
        let device = device_data.cast::<f64>();
        let task = device.mechanism.kind().spec().task;
        let axes = match std::env::var("HAPTIC_AXES") {
            Ok(text) => text.parse().map_err(|error| format!("HAPTIC_AXES: {error}"))?,
            Err(_) => Axes::of(device.mechanism.kind(), device.weight),
        };
        if let Some((index, _)) = axes.0.iter().flatten().find(|(index, _)| *index >= task) {
            return Err(format!("HAPTIC_AXES names axis {index} (from 0), but the device has {task} axes"));
        }
        let (centre, radius) = workspace(&device, last.tip.map(f64::from));
        Ok(Self {
            open,
            session: Some(session),
            name: format!("haptic-bridge {}", device.name.as_str()),
            device_data,
            axes,
            centre,
            radius,
            last,
            tick: Instant::now(),
            lost_ticks: 0,
            is_simulated,
            is_reported: false,
            is_invalid_force_reported: false,
            is_armed: false,
            is_tripped: false,
        })
    }

    /// Turns the motors on. If they stay off, reports the reason once on standard error.
    pub fn arm(&mut self) -> bool {
        if self.session.is_none() {
            self.reopen();
        }
        let Some(session) = &mut self.session else { return false };
        let cleared = if self.is_tripped { session.clear() } else { Ok(()) };
        match cleared.and_then(|()| session.arm()) {
            Ok(()) => {
                (self.tick, self.is_reported, self.is_armed, self.is_tripped) = (Instant::now(), false, true, false);
                true
            }
            // The motors may be on or off.
            Err(BoardError::Link(error)) => self.handle_link_error(&error),
            Err(refused) => {
                self.report(format!("the motors stay off: {refused}"));
                false
            }
        }
    }

    /// Turns the motors off.
    pub fn disarm(&mut self) -> bool {
        let off = self.session.as_mut().is_some_and(|session| session.disarm().is_ok());
        self.is_armed &= !off;
        off
    }

    /// Returns the position of the tip at the last tick, m; `None` while the board is lost.
    pub fn position(&self) -> Option<[f64; 3]> {
        let tip = self.last.tip.map(f64::from);
        self.session.as_ref()?;
        Some(self.axes.to_chai3d(std::array::from_fn(|i| tip[i] - self.centre[i])))
    }

    /// Returns the velocity of the tip at the last tick, m/s; `None` while the board is lost.
    pub fn velocity(&self) -> Option<[f64; 3]> {
        self.session.as_ref()?;
        Some(self.axes.to_chai3d(self.last.velocity.map(f64::from)))
    }
    /// Returns the rotation matrix of the handle at the last tick, by rows; `None` while the board is lost.
    pub fn rotation(&self) -> Option<[[f64; 3]; 3]> {
        self.session.as_ref()?;
        let matrix = self.axes.matrix();
        Some((matrix * rotation(&self.last.sensed) * matrix.transpose()).transpose().into())
    }
    /// Sends a force (N), waits for the next tick and reads the state. Sends zero and returns false for an invalid
    /// force. While the board is lost, tries to reopen it every 0.5 s.
    pub fn force(&mut self, force: [f64; 3]) -> bool {
        let is_valid = force.iter().all(|newtons| newtons.abs() <= f64::from(MAX_HELD_FORCE));
        if !is_valid && !self.is_invalid_force_reported {
            haptic_host::tell!("haptic-bridge: a force of {force:?} N is invalid: the motors get 0 N");
            self.is_invalid_force_reported = true;
        }
        let force = self.axes.to_task(if is_valid { force } else { [0.0; 3] });
        let Some(session) = &mut self.session else {
            // Waits, because a program without a board would otherwise load the CPU.
            std::thread::sleep(TICK);
            self.lost_ticks += 1;
            if self.lost_ticks.is_multiple_of(RETRY_TICKS) {
                self.reopen();
            }
            return false;
        };
        let sent = match session.force(force.map(|newtons| newtons as f32)) {
            Ok(sent) => sent,
            Err(error) => return self.handle_link_error(&error),
        };
        if sent.state == State::Fault {
            self.is_tripped |= std::mem::take(&mut self.is_armed);
            let how = if self.is_tripped { "; closing and opening the device clears it" } else { "" };
            let why = session.fault().map_or_else(String::new, |record| {
                format!(": {}{how}", commands_to_calls(&fault_and_remedy(&record), &CALLS))
            });
            self.report(format!("the board has turned its motors off{why}"));
        }
        if let Some(session) = self.session.as_mut().filter(|_| self.is_simulated)
            && let Err(error) = session.rows(TICK)
        {
            return self.handle_link_error(&error);
        }
        self.tick += TICK;
        let now = Instant::now();
        match self.tick.checked_duration_since(now) {
            Some(left) => std::thread::sleep(left),
            // A late tick does not shorten the later ticks.
            None => self.tick = now,
        }
        match self.session.as_mut().map(Session::read_state) {
            Some(Ok(state)) => {
                self.last = state;
                is_valid
            }
            Some(Err(error)) => self.handle_link_error(&error),
            None => false,
        }
    }

    fn handle_link_error(&mut self, error: &LinkError) -> bool {
        // The next force may succeed after a lost frame.
        if matches!(error, LinkError::Unanswered { .. }) {
            return false;
        }
        (self.session, self.lost_ticks, self.is_reported) = (None, 0, false);
        self.report("the board is lost: plug it in, and it is opened again".into());
        false
    }

    /// Reopens a lost board if it is connected again. Does not turn the motors on, because the user who plugs the board
    /// in may be holding the device.
    fn reopen(&mut self) {
        let Ok(mut session) = (self.open)() else { return };
        match read_device(&mut session) {
            Ok((device_data, last)) if device_data == self.device_data => {
                // Lets the program clear HostLost, which the lost connection caused. The user must check any other
                // fault.
                if let Some(record) = session.status().ok().and_then(|status| status.fault) {
                    self.is_tripped = std::mem::take(&mut self.is_armed) && record.fault == Fault::HostLost;
                }
                (self.session, self.last, self.is_reported) = (Some(session), last, false);
                self.report("the board is back; closing and opening the device turns its motors on".into());
                self.is_reported = false;
            }
            Ok(_) => self.report("another device is on the board now: start the program again".into()),
            Err(_) => {}
        }
    }

    /// Reports a message to the user, unless a message was reported since the last change of state.
    fn report(&mut self, words: String) {
        if !self.is_reported {
            haptic_host::tell!("haptic-bridge: {words}");
            self.is_reported = true;
        }
    }
}

/// Returns the tip at home (`here` without a home), and the smallest distance along an axis from this tip to the edge
/// of the workspace, m.
fn workspace(device: &BoardDevice<f64>, here: [f64; 3]) -> ([f64; 3], f64) {
    let task = device.mechanism.kind().spec().task;
    let tip = |q: &[f64]| TaskPose::of(&device.mechanism, q).map(|pose| pose.position);
    let home = device.home.and_then(|home| tip(&home[..device.axes()]).ok());
    let centre = home.map_or(here, |tip| padded(&tip));
    let (mut low, mut high) = (centre, centre);
    if let Ok(reachable) = Reachable::of(device, ANGLES_PER_JOINT, None) {
        for tip in reachable.indices().filter_map(|index| tip(&reachable.angles(index)).ok()) {
            for (i, place) in tip.into_iter().enumerate().take(3) {
                (low[i], high[i]) = (low[i].min(place), high[i].max(place));
            }
        }
    }
    let spans = (0..task).map(|i| (high[i] - centre[i]).min(centre[i] - low[i]));
    (centre, spans.fold(f64::INFINITY, f64::min).max(MIN_RADIUS_M))
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptic_host::device_file::DeviceFile;
    use haptic_host::haptic_bridge::model::description::Encoder;
    use haptic_host::link::{Board, Wire};
    use haptic_sim::{BoardOptions, SHIPPED_DEVICE, SharedBoard, ready_board};
    use std::io;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};

    /// A wire that can be unplugged.
    struct Cable(Box<dyn Wire>, Arc<AtomicBool>);

    impl Cable {
        fn check_plugged(&self) -> io::Result<()> {
            if self.1.load(Ordering::Relaxed) { Ok(()) } else { Err(io::ErrorKind::UnexpectedEof.into()) }
        }
    }

    impl Wire for Cable {
        fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
            self.check_plugged()?;
            self.0.send(bytes)
        }
        fn receive(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
            self.check_plugged()?;
            self.0.receive(buffer, timeout)
        }
        fn now(&self) -> Duration {
            self.0.now()
        }
    }

    /// Creates a strict board that is ready to arm, the program's device, and the cable's state.
    fn device() -> (SharedBoard, HdDevice, Arc<AtomicBool>) {
        let mut file = DeviceFile::parse(SHIPPED_DEVICE, "coupled-five-bar.toml").unwrap();
        for joint in &mut file.description.joints[..2] {
            joint.motor.as_mut().unwrap().verified = true;
            joint.limits = Some((-4.0, 4.0));
        }
        file.description.sensed = [Some(Encoder { counts_per_turn: 4_000.0, offset: 0.0, inverted: false }); 3];
        let options = BoardOptions { strict: true, ..BoardOptions::default() };
        let board = SharedBoard::new(ready_board(&file, options).unwrap());
        let (shared, plugged) = (board.clone(), Arc::new(AtomicBool::new(true)));
        let cable = Arc::clone(&plugged);
        let open = move || {
            let wire = Cable(shared.wire(), Arc::clone(&cable));
            Board::over(Box::new(wire), "sim").map(Session::of).map_err(|error| error.to_string())
        };
        let mut device = HdDevice::with_opener(Box::new(open), false).unwrap();
        let session = device.session.as_mut().unwrap();
        session.set_scene(&Scene { task: 2, rate_hz: 1_000.0, cutoff_hz: 50.0, ..Scene::default() }).unwrap();
        session.home().unwrap();
        session.check_polarity().unwrap();
        session.wait_for_polarity().unwrap().require_pass().unwrap();
        assert!(device.arm());
        (board, device, plugged)
    }

    /// The five-bar lies on the table: its x axis points to the operator's left.
    #[test]
    fn the_handle_turns_by_the_encoders_without_motors() {
        let (board, mut device, _) = device();
        for (counts, expected) in [
            ([0, 0, 0], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
            ([1_000, 0, 0], [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
            ([0, 0, 1_000], [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
        ] {
            board.lock().device_mut().set_sensed_counts(counts);
            device.force([0.0; 3]);
            device.force([0.0; 3]);
            let found = device.rotation().expect("a board");
            let near = found.as_flattened().iter().zip(expected.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-6);
            assert!(near, "{counts:?}: {found:?}");
        }
    }

    #[test]
    fn a_fault_is_cleared_by_closing_and_opening_the_device() {
        let (board, mut device, _) = device();
        assert!(device.force([0.0; 3]));
        board.lock().run(0.6);
        assert!(device.force([0.0; 3]), "positions stay available");
        assert_eq!(board.lock().status().state, State::Fault);
        assert!(device.disarm() && device.arm());
        assert_eq!(board.lock().status().state, State::Armed);
    }

    #[test]
    fn a_fault_while_disarmed_is_not_cleared_by_the_program() {
        let (board, mut device, _) = device();
        assert!(device.disarm());
        board.lock().inject(Fault::GateDriver, None, 0.0);
        board.lock().run(0.01);
        device.force([0.0; 3]);
        assert!(!device.arm());
        assert_eq!(board.lock().status().state, State::Fault);
    }

    #[test]
    fn a_board_lost_while_arming_has_no_position() {
        let (_, mut device, plugged) = device();
        assert!(device.disarm());
        plugged.store(false, Ordering::Relaxed);
        assert!(!device.arm());
        assert_eq!(device.position(), None);
    }

    #[test]
    fn a_board_that_is_back_is_armed_by_opening_the_device() {
        let (board, mut device, plugged) = device();
        plugged.store(false, Ordering::Relaxed);
        assert!(!device.force([0.0; 3]));
        assert_eq!((device.position(), device.velocity()), (None, None), "the last position is outdated");
        assert!(!device.disarm() && !device.arm());
        plugged.store(true, Ordering::Relaxed);
        // After 0.6 s the board has detected the lost host.
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
