//! A test rig: a board with booted firmware, a simulated device at its connectors, and the tool's client on its port.

use haptic_bridge::control::{HostAction, Rules};
use haptic_bridge::model::device::Device as DeviceData;
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::limits::{Limits, MAX_TIP_FORCE};
use haptic_host::device_file::{BOARD_ENCODERS, DeviceFile};
use haptic_host::link::Board;
use haptic_host::scene_file::SceneFile;
use haptic_sim::{Options, PowerStage, SimulatedDevice};
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crate::boards::Wiring;
use crate::hands::hold;
use crate::hardware::Hardware;
use crate::image::Firmware;
use crate::plant::{Dummy, Plant};
use crate::run::{MILLISECOND, SECOND, StoppedBoard, VirtualBoard};
use crate::wire::Shared;

/// Returns the release image of `board`, which is built once per process.
pub fn firmware(board: impl Into<&'static Wiring>) -> &'static Firmware {
    static IMAGES: Mutex<BTreeMap<&str, &Firmware>> = Mutex::new(BTreeMap::new());
    let name = board.into().name;
    let mut images = IMAGES.lock().unwrap_or_else(PoisonError::into_inner);
    images
        .entry(name)
        .or_insert_with(|| Box::leak(Box::new(Firmware::build(name).unwrap_or_else(|error| panic!("{error}")))))
}

/// Returns the folder of the shipped device files.
#[must_use]
pub fn devices() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../devices")
}

/// Returns the device file `name` with verified motors, with wide joint limits where the file has none, and without the
/// encoders for which no board has inputs.
#[must_use]
pub fn device_file(name: &str) -> DeviceFile {
    let path = devices().join(format!("{name}.toml"));
    let mut file = DeviceFile::load(&path).unwrap_or_else(|error| panic!("{error}"));
    for joint in &mut file.description.joints {
        if let Some(motor) = &mut joint.motor {
            motor.verified = true;
        }
        joint.limits.get_or_insert((-PI, PI));
    }
    let left = BOARD_ENCODERS - file.spec().joints;
    file.description.sensed.iter_mut().skip(left).for_each(|sensed| *sensed = None);
    file
}

/// A board, and a tool that is connected to the board.
pub struct Rig {
    /// Board for which the image was built.
    pub kind: &'static Wiring,
    /// The board.
    pub shared: Shared,
    /// The tool's client.
    pub tool: Board,
    /// Device at the board's connectors, if any.
    pub file: Option<DeviceFile>,
}

impl Rig {
    /// Boots `kind` with only encoders at rest at its connectors.
    #[must_use]
    pub fn empty(kind: impl Into<&'static Wiring>) -> Self {
        Self::with_plant(kind.into(), Box::new(Dummy::default()), None)
    }

    /// Boots the image of `kind` on another board, with only encoders at rest at its connectors.
    #[must_use]
    pub fn on_other_board(kind: impl Into<&'static Wiring>, board: impl Into<&'static Wiring>, device: &str) -> Self {
        Self::boot(kind.into(), board.into(), Box::new(Dummy::default()), Some(device_file(device)))
    }

    /// Boots `kind` with the simulated device of the shipped file `name`. `change` sets the simulation's options.
    #[must_use]
    pub fn with_device(kind: impl Into<&'static Wiring>, name: &str, change: impl FnOnce(&mut Options)) -> Self {
        Self::with_file(kind, device_file(name), change)
    }

    /// Boots `kind` with the simulated device of `file`. `change` sets the simulation's options.
    #[must_use]
    pub fn with_file(kind: impl Into<&'static Wiring>, file: DeviceFile, change: impl FnOnce(&mut Options)) -> Self {
        let kind = kind.into();
        let bridge = PowerStage { bus_voltage: kind.bus_voltage, dead_time: kind.dead_time, carrier_hz: 20_000.0 };
        let mut options = Options { bridge, ..Options::default() };
        change(&mut options);
        let mut device = SimulatedDevice::new(&file.description, &options).unwrap_or_else(|error| panic!("{error}"));
        if file.description.gravity != [0.0; 3] {
            hold(&mut device);
        }
        Self::with_plant(kind, Box::new(device), Some(file))
    }

    fn with_plant(kind: &'static Wiring, plant: Box<dyn Plant>, file: Option<DeviceFile>) -> Self {
        Self::boot(kind, kind, plant, file)
    }

    fn boot(kind: &'static Wiring, board: &'static Wiring, plant: Box<dyn Plant>, file: Option<DeviceFile>) -> Self {
        let hardware = Hardware::new(board, plant).expect("the board's description is sound");
        let mut board = VirtualBoard::start(firmware(kind), hardware).unwrap_or_else(|error| panic!("{error}"));
        assert!(
            board.run_until(2 * SECOND, MILLISECOND, |stopped| stopped.usb().is_ready()),
            "no USB after two seconds"
        );
        assert!(
            !board.while_stopped(|stopped| stopped.hardware().peaks.bridge_was_on),
            "a bridge was on before USB was ready"
        );
        let shared = Shared::new(board);
        let tool = Board::over(shared.wire(), "virtual").unwrap_or_else(|error| panic!("{error}"));
        let mut rig = Self { kind, shared, tool, file };
        rig.relax_rules();
        rig
    }

    /// Presses the board's reset button and connects the tool again.
    #[must_use]
    pub fn restart(self) -> Self {
        let Self { kind, shared, file, .. } = self;
        {
            let mut board = shared.board();
            board.while_stopped(|stopped| stopped.reset());
            board.run(MILLISECOND);
            assert!(
                board.run_until(2 * SECOND, MILLISECOND, |stopped| stopped.usb().is_ready()),
                "no USB after a reset"
            );
            board.while_stopped(|stopped| stopped.usb().take());
        }
        let tool = Board::over(shared.wire(), "virtual").unwrap_or_else(|error| panic!("{error}"));
        let mut rig = Self { kind, shared, tool, file };
        rig.relax_rules();
        rig
    }

    /// Loosens the rules for tests, in which nobody can be hurt. The board ignores a silent host, because virtual time
    /// passes without messages. The tip-force limit is the largest possible.
    pub fn relax_rules(&mut self) {
        let rules = self.tool.rules().expect("the board replies");
        let limits = Limits { tip_force: MAX_TIP_FORCE, ..rules.limits };
        self.tool.set_rules(&Rules { limits, host_action: HostAction::Ignore, ..rules }).expect("the motors are off");
    }

    /// Loads the device at the connectors and a scene.
    pub fn load(&mut self, scene: &str) {
        let file = self.file.as_ref().expect("a device at the connectors");
        let device = DeviceData::new(&file.name, &file.description).expect("a device of the board's size");
        self.tool.set_device(&device).expect("the board takes the device");
        self.set_scene(scene);
    }

    /// Loads a scene.
    pub fn set_scene(&mut self, scene: &str) {
        let task = self.file.as_ref().expect("a device at the connectors").spec().task;
        let scene = SceneFile::parse(scene, "scene", task).unwrap_or_else(|error| panic!("{error}"));
        self.tool.set_scene(&scene.scene().expect("the scene fits f32")).expect("the board takes the scene");
    }

    /// Homes the device in place, checks its polarity, arms, and waits until torque has ramped up.
    pub fn home_and_arm(&mut self) {
        self.tool.home().expect("the device can be homed");
        self.check_polarity();
        self.arm();
    }

    /// Arms and waits until torque has ramped up.
    pub fn arm(&mut self) {
        self.tool.arm().expect("the board arms");
        self.run(SECOND);
        let status = self.tool.status().expect("the board replies");
        assert_eq!((status.state, status.fault), (State::Armed, None), "{status:?}");
    }

    /// Checks the polarity of every joint. The alignment of two three-phase motors takes half a minute.
    pub fn check_polarity(&mut self) {
        self.tool.check_polarity().expect("the polarity check starts");
        for _ in 0..600 {
            self.run(100 * MILLISECOND);
            let status = self.tool.status().expect("the board replies");
            if status.state != State::CheckingPolarity {
                assert!(status.polarity, "{status:?}");
                return;
            }
        }
        panic!("the polarity check does not end");
    }

    /// Runs for `span` virtual nanoseconds.
    pub fn run(&self, span: u64) {
        self.shared.board().run(span);
    }

    /// Runs `job` while the board stands still.
    pub fn while_stopped<T: Send + 'static>(&self, job: impl FnOnce(&mut StoppedBoard<'_>) -> T + Send + 'static) -> T {
        self.shared.board().while_stopped(job)
    }

    /// Runs `job` with the simulated device.
    pub fn with_simulated<T: Send + 'static>(&self, job: impl FnOnce(&mut SimulatedDevice) -> T + Send + 'static) -> T {
        self.while_stopped(|stopped| job(stopped.hardware().plant.device().expect("a simulated device")))
    }

    /// Describes a board that no longer replies, with the history of its port and its restarts.
    #[must_use]
    pub fn post_mortem(&self) -> String {
        let (at, port, restarts) =
            self.while_stopped(|stopped| (stopped.at, stopped.usb().log().to_vec(), stopped.resets().to_vec()));
        format!("at {at} ns\nport: {port:?}\nrestarts: {restarts:?}")
    }

    /// Returns the virtual time since power-on, ns.
    #[must_use]
    pub fn now(&self) -> u64 {
        self.shared.board().now()
    }

    /// Returns the number of control steps since the start, read from the chip's memory while the board stands still.
    #[must_use]
    pub fn steps(&self) -> u32 {
        // The count of steps is the first field of the shared state.
        let address = firmware(self.kind).find_ending("9interrupt7CONTROL").expect("the count of steps").address;
        self.while_stopped(move |stopped| stopped.word(address)).expect("RAM")
    }
}
