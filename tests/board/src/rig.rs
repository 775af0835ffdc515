//! A board on a test bench: firmware booted, a simulated device at its connectors, and the tool's client on its port.

use haptic::device_file::DeviceFile;
use haptic::link::Board;
use haptic::scene_file::SceneFile;
use haptic::sim::{Bridge, Device, Options};
use haptic_bridge::device::Device as DeviceData;
use haptic_bridge::guard::State;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use crate::boards::BoardKind;
use crate::hardware::Hardware;
use crate::image::Firmware;
use crate::interrupt::Handler;
use crate::plant::{Dummy, Plant};
use crate::run::{Bench, MILLISECOND, SECOND, VirtualBoard};
use crate::wire::Shared;

/// The release image of `board`, built once for each process.
///
/// # Panics
///
/// When it cannot be built; the reason is printed.
pub fn firmware(board: BoardKind) -> &'static Firmware {
    static IMAGES: [OnceLock<Firmware>; 2] = [OnceLock::new(), OnceLock::new()];
    IMAGES[board as usize].get_or_init(|| Firmware::of(board).unwrap_or_else(|error| panic!("{error}")))
}

/// The device files that ship.
#[must_use]
pub fn devices() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../devices")
}

/// The device file called `name`, with motors declared verified and wide joint limits where the file has none, as a
/// person who has checked them would.
///
/// # Panics
///
/// When there is no such file.
#[must_use]
pub fn device_file(name: &str) -> DeviceFile {
    let path = devices().join(name).with_extension("toml");
    let mut file = DeviceFile::load(&path).unwrap_or_else(|error| panic!("{error}"));
    for joint in &mut file.description.joints {
        if let Some(motor) = &mut joint.motor {
            motor.verified = true;
        }
        joint.limits.get_or_insert((-PI, PI));
    }
    file
}

/// A board, and the tool connected to it.
pub struct Rig {
    /// The kind of board.
    pub kind: BoardKind,
    /// The board.
    pub shared: Shared,
    /// The tool's client.
    pub tool: Board,
    /// The device at the board's connectors.
    pub file: Option<DeviceFile>,
}

impl Rig {
    /// Boots `kind` with nothing but standing encoders at its connectors.
    ///
    /// # Panics
    ///
    /// When the firmware does not come up on USB within two virtual seconds.
    #[must_use]
    pub fn empty(kind: BoardKind) -> Self {
        Self::with_plant(kind, Box::new(Dummy::default()), None)
    }

    /// Boots `kind` with the device of the shipped file `name`, simulated with `change`d options.
    ///
    /// # Panics
    ///
    /// When there is no such device, or the firmware does not come up.
    #[must_use]
    pub fn with_device(kind: BoardKind, name: &str, change: impl FnOnce(&mut Options)) -> Self {
        let file = device_file(name);
        let wiring = kind.wiring();
        let bridge = Bridge { bus_voltage: wiring.bus_voltage, dead_time: wiring.dead_time, carrier_hz: 20_000.0 };
        let mut options = Options { bridge, ..Options::default() };
        change(&mut options);
        let device = Device::new(&file.description, &options).unwrap_or_else(|error| panic!("{error}"));
        Self::with_plant(kind, Box::new(device), Some(file))
    }

    fn with_plant(kind: BoardKind, plant: Box<dyn Plant>, file: Option<DeviceFile>) -> Self {
        let hardware = Hardware::new(kind, plant).expect("the board's description is sound");
        let mut board = VirtualBoard::start(firmware(kind), hardware).unwrap_or_else(|error| panic!("{error}"));
        assert!(board.run_until(2 * SECOND, MILLISECOND, |bench| bench.usb().ready()), "no USB after two seconds");
        let shared = Shared::new(board);
        let tool = Board::over(shared.wire(), "virtual").unwrap_or_else(|error| panic!("{error}"));
        Self { kind, shared, tool, file }
    }

    /// The board after a press of its reset button, the tool connected again.
    ///
    /// # Panics
    ///
    /// When the firmware does not come up again.
    #[must_use]
    pub fn restarted(self) -> Self {
        let Self { kind, shared, file, .. } = self;
        {
            let mut board = shared.board();
            board.with(|bench| bench.reset());
            board.run(MILLISECOND);
            assert!(board.run_until(2 * SECOND, MILLISECOND, |bench| bench.usb().ready()), "no USB after a reset");
            board.with(|bench| bench.usb().take());
        }
        let tool = Board::over(shared.wire(), "virtual").unwrap_or_else(|error| panic!("{error}"));
        Self { kind, shared, tool, file }
    }

    /// Loads the device at the connectors, and a scene.
    ///
    /// # Panics
    ///
    /// When the board refuses either.
    pub fn load(&mut self, scene: &str) {
        let file = self.file.as_ref().expect("a device at the connectors");
        let device = DeviceData::new(&file.name, &file.description).expect("a device of the board's size");
        let task = file.spec().task;
        let scene = SceneFile::parse(scene, "scene", task).unwrap_or_else(|error| panic!("{error}"));
        self.tool.set_device(&device).expect("the board takes the device");
        self.tool.set_scene(&scene.scene().expect("the scene fits f32")).expect("the board takes the scene");
    }

    /// Homes the device where it stands, has its polarity checked, arms, and waits until torque has ramped up.
    ///
    /// # Panics
    ///
    /// When the board refuses, or finds a fault.
    pub fn arm(&mut self) {
        self.tool.home().expect("the device can be homed");
        self.check_polarity();
        self.tool.arm().expect("the board arms");
        self.run(SECOND);
        let status = self.tool.status().expect("the board answers");
        assert_eq!((status.state, status.fault), (State::Armed, None), "{status:?}");
    }

    /// Has the polarity of every joint checked.
    ///
    /// # Panics
    ///
    /// When the board refuses, or the check fails.
    pub fn check_polarity(&mut self) {
        self.tool.check_polarity().expect("the polarity check starts");
        for _ in 0..100 {
            self.run(100 * MILLISECOND);
            let status = self.tool.status().expect("the board answers");
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

    /// Does `job` with the board standing still.
    pub fn with<T: Send + 'static>(&self, job: impl FnOnce(&mut Bench<'_>) -> T + Send + 'static) -> T {
        self.shared.board().with(job)
    }

    /// Does `job` with the simulated device.
    ///
    /// # Panics
    ///
    /// On a rig without one.
    pub fn with_simulated<T: Send + 'static>(&self, job: impl FnOnce(&mut Device) -> T + Send + 'static) -> T {
        self.with(|bench| job(bench.hardware().plant.device().expect("a simulated device")))
    }

    /// Times the control interrupt over `span` virtual nanoseconds.
    ///
    /// # Panics
    ///
    /// When the image has no such handler, or it never runs.
    #[must_use]
    pub fn time_control(&self, span: u64) -> ControlTime {
        let handler = Handler::find(firmware(self.kind), CONTROL_INTERRUPT).expect("the control interrupt");
        let watched = handler.clone();
        self.with(move |bench| watched.watch(bench));
        // The first hand-back arms the watches; what they see before is not whole.
        self.run(MILLISECOND);
        self.with(|bench| bench.take_hits());
        self.run(span);
        let watched = handler.clone();
        let hits = self.with(move |bench| {
            watched.unwatch(bench);
            bench.take_hits()
        });
        let (crests, valleys): (Vec<u64>, Vec<u64>) =
            handler.runs(&hits).iter().map(|run| run.instructions).partition(|&count| count > VALLEY_MOST);
        let worst = |counts: &[u64]| counts.iter().copied().max().unwrap_or(0);
        ControlTime {
            worst: worst(&crests),
            least: crests.iter().copied().min().unwrap_or(0),
            mean: crests.iter().sum::<u64>() as f64 / crests.len().max(1) as f64,
            crests: crests.len(),
            valleys: valleys.len(),
            valley_worst: worst(&valleys),
        }
    }
}

/// The control interrupt's handler.
const CONTROL_INTERRUPT: &str = "TIM1_UP_TIM10";
/// A run at a valley does next to nothing; one at a crest samples, steps and writes duties.
const VALLEY_MOST: u64 = 60;

/// What the control interrupt takes, entry to exit, in instructions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlTime {
    /// The longest run at a crest.
    pub worst: u64,
    /// The shortest run at a crest.
    pub least: u64,
    /// The mean over the crests.
    pub mean: f64,
    /// Runs at a crest.
    pub crests: usize,
    /// Runs at a valley.
    pub valleys: usize,
    /// The longest run at a valley.
    pub valley_worst: u64,
}
