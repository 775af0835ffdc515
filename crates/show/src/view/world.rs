//! A board with everything that a view of it needs: its links to draw, and the hand if the board is simulated.

use crate::demo::Demo;
use crate::demo::crossing::{DEPTH_TIME, Moment, PHASES, hand_settings, press};
use haptic_bridge::model::shipped::*;
use haptic_bridge::render::scene::{FeedForward, Scene, Surface, Wall};
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::link::{Board, LinkError};
use haptic_host::scene_file::SceneFile;
use haptic_predict::wall_ahead::wall_ahead;
use haptic_sim::{BoardOptions, Hand, Intent, Options, SharedBoard, Waypoint, ready_board};

/// Distance of the wall of [`World::demo`] from the tip, m.
const WALL_DISTANCE: f64 = 0.010;
/// Dry friction of the demo's joints, relative to the device file.
const FRICTION_FACTOR: f64 = 0.1;
/// Number of encoder counts in the demo, relative to the device file.
const ENCODER_FACTOR: f64 = 5.0;
/// Time at which [`press_while_switching`] begins: the hand rests and the wall buzzes, s after arming.
const SWITCHED_FROM: f64 = 2.5;
/// Depth of the hand below the wall's surface in [`press_while_switching`], m.
const RESTING_DEPTH: f64 = 0.045;

/// A shipped device in front of the walls of a scene.
#[derive(Clone, Copy, Debug)]
pub struct ShippedWorld {
    /// Name of the device, with the name of the scene after a slash, and a description after a colon.
    pub name: &'static str,
    /// Text of the device file.
    pub device: &'static str,
    /// Text of the scene file; `None` for one wall in front of the tip.
    pub scene: Option<&'static str>,
}

/// The devices that a page offers in addition to the demo's.
pub const WORLDS: [ShippedWorld; 7] = [
    ShippedWorld { name: "haply-2diy/disc: a disc", device: HAPLY_2DIY, scene: Some(DISC) },
    ShippedWorld { name: "haply-2diy/groove: a groove", device: HAPLY_2DIY, scene: Some(GROOVE) },
    ShippedWorld { name: "pantograph-mk2/corner: a corner", device: PANTOGRAPH_MK2, scene: Some(CORNER) },
    ShippedWorld { name: "hapkit-paddle/wall: a wall", device: HAPKIT_PADDLE, scene: Some(PADDLE_WALL) },
    ShippedWorld { name: "hapkit-paddle/slow: a wall at 1 kHz", device: HAPKIT_PADDLE, scene: Some(PADDLE_WALL_1_KHZ) },
    ShippedWorld { name: "woodenhaptics: a wall", device: WOODENHAPTICS, scene: None },
    ShippedWorld { name: "phantom-premium-1.5: a wall", device: PHANTOM_PREMIUM, scene: None },
];

/// A board, its device and its simulation.
pub struct World {
    /// The board.
    pub board: Board,
    /// Access to the same board if it is simulated in this process.
    pub simulated: Option<SharedBoard>,
    /// Device file, whose links are drawn.
    pub file: Option<DeviceFile>,
    /// Name of the scene's file, for links to the page.
    pub scene_name: Option<String>,
    /// True if the device's weight was left out.
    pub weightless: bool,
    /// True if the device has less dry friction and finer encoders than its file.
    pub smooth: bool,
}

impl World {
    /// Creates the world of a connected board.
    pub fn of(board: Board, file: Option<DeviceFile>) -> Self {
        Self { board, simulated: None, file, scene_name: None, weightless: false, smooth: false }
    }

    /// Returns the refusal of a view if the connected board lacks a device or a scene.
    pub fn missing_setting(&mut self) -> Result<Option<Refusal>, LinkError> {
        Ok(match (self.board.device()?, self.board.scene()?) {
            (None, _) => Some(Refusal::NoDevice),
            (_, None) => Some(Refusal::NoScene),
            _ => None,
        })
    }

    /// Creates the device of `haptic demo` in another pose, with another wall: at any force up to the motors' limit the
    /// wall buzzes without the feed-forward and is quiet with it, both in the prediction and in simulation.
    ///
    /// Joint friction can hold an unstable wall still, or keep a stable wall near its boundary oscillating; encoder
    /// steps make a stiff wall tremble. This device has little of both, and pages report this.
    pub fn demo() -> Result<Self, Failure> {
        let mut demo = Demo::shipped(1)?;
        let (sine, cosine) = 45.0_f64.to_radians().sin_cos();
        // The wall is 2 mm behind the tip's position at 2.2 and 1.2 rad, and was tested around that pose.
        (demo.pose, demo.normal) = ([2.109_673, 1.225_778, 0.0], [cosine, sine]);
        (demo.stiffness, demo.damping) = (8_700.0, 80.0);
        for joint in &mut demo.file.description.joints {
            joint.coulomb *= FRICTION_FACTOR;
            if let Some(encoder) = &mut joint.encoder {
                encoder.counts_per_turn *= ENCODER_FACTOR;
            }
        }
        let mut world = Self::start(demo.file.clone(), Some(demo.pose))?;
        world.smooth = true;
        let tip = world.simulated.as_ref().map_or([0.0; 3], |board| board.lock().device().tip());
        let surface = core::array::from_fn(|i| tip[i] - WALL_DISTANCE * demo.normal[i]);
        world.board.set_scene(&demo.scene(surface, FeedForward::Washout))?;
        Ok(world)
    }

    /// Simulates a device in `scene`; without a scene, in front of a stable wall that does not rattle.
    pub fn simulate(file: DeviceFile, scene: Option<Scene<f32>>) -> Result<Self, Failure> {
        let scene = match scene {
            Some(scene) => scene,
            None => wall_ahead(&file)?,
        };
        let mut world = Self::start(file, None)?;
        world.board.set_scene(&scene)?;
        Ok(world)
    }

    /// Returns the names of the shipped worlds; links use the part before the colon.
    pub fn names() -> impl Iterator<Item = &'static str> {
        std::iter::once("coupled-five-bar: a wall that the feed-forward quiets").chain(WORLDS.map(|world| world.name))
    }

    /// Creates a shipped world by its number in [`Self::names`]; the first is [`Self::demo`].
    pub fn shipped(number: usize) -> Result<Self, Failure> {
        let Some(index) = number.checked_sub(1) else { return Self::demo() };
        let no_world = || Failure::wrong(format!("there is no world {number}"));
        let world = WORLDS.get(index).ok_or_else(no_world)?;
        let file = DeviceFile::parse(world.device, world.name)?;
        let read = |text| SceneFile::parse(text, world.name, file.spec().task)?.scene().map_err(Failure::wrong);
        let scene = world.scene.map(read).transpose()?;
        let scene_name = world.name.split([':', '/']).nth(1).filter(|_| scene.is_some()).map(Into::into);
        Ok(Self { scene_name, ..Self::simulate(file, scene)? })
    }

    /// Creates this simulated world again with another scene, in another pose (rad).
    pub fn recreate(&self, scene: &Scene<f32>, pose: [f64; 3]) -> Result<Self, Failure> {
        let file = self.file.clone().ok_or_else(|| Failure::wrong("this device is not simulated"))?;
        let mut world = Self::start(file, Some(pose))?;
        world.board.set_scene(scene)?;
        Ok(Self { scene_name: self.scene_name.clone(), weightless: self.weightless, smooth: self.smooth, ..world })
    }

    /// Starts the device without its weight, because with the motors off the simulated hand could not carry the weight.
    /// With the motors on the board compensates for it.
    fn start(mut file: DeviceFile, start: Option<[f64; 3]>) -> Result<Self, Failure> {
        let weightless = file.description.gravity.iter().any(|g| *g != 0.0);
        file.description.gravity = [0.0; 3];
        let device = Options { start, soft_stop: true, ..Options::default() };
        let options = BoardOptions { device, ..BoardOptions::default() };
        let board = ready_board(&file, options)
            .map_err(|error| LinkError::CannotSimulate(format!("{}: {error}", file.path.display())))?;
        let simulated = SharedBoard::new(board);
        let board = Board::over(simulated.wire(), "sim")?;
        Ok(Self { simulated: Some(simulated), weightless, ..Self::of(board, Some(file)) })
    }
}

/// Lets a hand rest on the wall of [`World::demo`] while the feed-forward is off, on and off again. Returns that demo
/// and the moments of these [`PHASES`].
pub fn press_while_switching() -> Result<(Demo, Vec<Moment>), Failure> {
    let World { mut board, simulated: Some(shared), file: Some(file), .. } = World::demo()? else {
        return Err(Failure::impossible("the demo is not simulated"));
    };
    let scene = board.scene()?.ok_or_else(|| Failure::impossible("the demo has no scene"))?;
    let Wall { surface: Surface::Plane(plane), stiffness, damping, .. } = scene.walls[0] else {
        return Err(Failure::impossible("the demo has no plane"));
    };
    let (tip, pose) = {
        let board = shared.lock();
        (board.device().tip(), board.device().q())
    };
    let normal = [plane.normal[0], plane.normal[1]].map(f64::from);
    let (stiffness, damping) = (f64::from(stiffness), f64::from(damping));
    let demo = Demo { file, pose, normal, stiffness, damping, ..Demo::shipped(1)? };
    let depth = (0..2).map(|i| (tip[i] - f64::from(plane.point[i])) * normal[i]).sum::<f64>() + RESTING_DEPTH;
    let rest = [(0.0, 0.0), (DEPTH_TIME, depth)]
        .map(|(time, depth)| Waypoint { time, value: [tip[0] - depth * normal[0], tip[1] - depth * normal[1], 0.0] });
    let [off, on, again] = PHASES;
    let modes = [
        (0.0, FeedForward::Off),
        (SWITCHED_FROM + off, FeedForward::Washout),
        (SWITCHED_FROM + off + on, FeedForward::Off),
    ];
    let end = SWITCHED_FROM + off + on + again;
    let (moments, ..) = press(&mut board, &shared, &scene, rest.to_vec(), &modes, end, &mut |_| {})?;
    let first = moments.len().saturating_sub(((off + on + again) * demo.rate_hz) as usize);
    Ok((demo, moments[first..].to_vec()))
}

/// Moves the simulated hand to `goal` (m) in the drawn plane, or removes it from the tip. Across the plane the hand stays
/// where it gripped the tip.
pub fn lead_hand(board: &SharedBoard, goal: Option<[f64; 2]>) {
    let mut board = board.lock();
    let now = board.time();
    let device = board.device_mut();
    let tip = device.tip();
    match goal {
        None => device.set_hand(Hand::none()),
        Some([x, y]) => {
            if device.hand().position().is_none() {
                device.set_hand(Hand::new(hand_settings(), Intent::Lead(tip), tip, now));
            }
            let across = device.hand().goal().map_or(tip[2], |goal| goal[2]);
            device.hand_mut().lead([x, y, across]);
        }
    }
}
