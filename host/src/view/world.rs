//! What is looked at: a board, its links to draw, and where it is simulated the hand on it.

use crate::analysis::control_loop::TorquePath;
use crate::analysis::prediction::{Prediction, Subject};
use crate::analysis::sampled::Mode;
use crate::demo::Demo;
use crate::device_file::DeviceFile;
use crate::error::Failure;
use crate::link::{Board, LinkError};
use crate::scene_file::{DEFAULT_CUTOFF_HZ, DEFAULT_WASHOUT_HZ};
use crate::sim::{BoardOptions, Hand, HandSettings, Intent, Options, SharedBoard, ready_board};
use haptic_bridge::render::scene::{DEFAULT_RATE_HZ, FeedForward, Plane, Scene, Surface, Wall};
use haptic_bridge::safety::refusal::Refusal;

/// How far in front of the tip the wall stands that is there when no scene was named, m.
const AHEAD: f64 = 0.006;
/// How far in front of the tip the wall of [`World::demo`] stands, m.
const NEAR: f64 = 0.002;
/// Share of the joints' dry friction that it has, and how much finer its encoders are.
const LITTLE_FRICTION: f64 = 0.1;
const FINER: f64 = 5.0;
/// Tremor of the simulated hand, m: what sets a wall swinging that is about to.
const TREMOR: f64 = 2e-4;

/// A board and what is known of its surroundings.
pub struct World {
    /// The board.
    pub board: Board,
    /// The same board from the inside, where it is simulated in this process.
    pub simulated: Option<SharedBoard>,
    /// The device, for its links.
    pub file: Option<DeviceFile>,
    /// The device's weight was left out.
    pub weightless: bool,
    /// The device has less dry friction and finer encoders than its file says.
    pub smooth: bool,
}

impl World {
    /// A board that is there.
    pub fn of(board: Board, file: Option<DeviceFile>) -> Self {
        Self { board, simulated: None, file, weightless: false, smooth: false }
    }

    /// What a board that is there still needs before it can be looked at: a device, a scene.
    pub fn lacks(&mut self) -> Result<Option<Refusal>, LinkError> {
        Ok(match (self.board.device()?, self.board.scene()?) {
            (None, _) => Some(Refusal::NoDevice),
            (_, None) => Some(Refusal::NoScene),
            _ => None,
        })
    }

    /// The device of `haptic demo` in a pose and before a wall of its own: wherever the hand presses it, up to the
    /// motors' limit, the wall buzzes without the feed-forward and is quiet with it, by prediction as well as when it
    /// is tried.
    ///
    /// Friction of the joints can hold a wall that is unstable, and lets one swing on that is stable but near its
    /// boundary; encoder steps make a stiff wall tremble. Both would decide in the feed-forward's place, so this device
    /// has little of them, and pages are told.
    pub fn demo() -> Result<Self, Failure> {
        let mut demo = Demo::shipped(1)?;
        let (sine, cosine) = 45.0_f64.to_radians().sin_cos();
        (demo.pose, demo.normal) = ([2.2, 1.2, 0.0], [cosine, sine]);
        (demo.stiffness, demo.damping) = (8_700.0, 80.0);
        for joint in &mut demo.file.description.joints {
            joint.coulomb *= LITTLE_FRICTION;
            if let Some(encoder) = &mut joint.encoder {
                encoder.counts_per_turn *= FINER;
            }
        }
        let mut world = Self::start(demo.file.clone(), Some(demo.pose))?;
        world.smooth = true;
        let tip = world.simulated.as_ref().map_or([0.0; 3], |board| board.lock().device().tip());
        let surface = core::array::from_fn(|i| tip[i] - NEAR * demo.normal[i]);
        world.board.set_scene(&demo.scene(surface, FeedForward::Washout))?;
        Ok(world)
    }

    /// A simulated device in a scene, or before a wall of half the stiffness that is predicted to be stable.
    pub fn simulate(file: DeviceFile, scene: Option<Scene<f32>>) -> Result<Self, Failure> {
        let scene = match scene {
            Some(scene) => scene,
            None => wall_ahead(&file)?,
        };
        let mut world = Self::start(file, None)?;
        world.board.set_scene(&scene)?;
        Ok(world)
    }

    /// The device without its weight: with the motors off nobody would hold it, and with them on the board does.
    fn start(mut file: DeviceFile, start: Option<[f64; 3]>) -> Result<Self, Failure> {
        let weightless = file.description.gravity.iter().any(|g| *g != 0.0);
        file.description.gravity = [0.0; 3];
        let options = BoardOptions { device: Options { start, ..Options::default() }, ..BoardOptions::default() };
        let board = ready_board(&file, options)
            .map_err(|error| LinkError::CannotSimulate(format!("{}: {error}", file.path.display())))?;
        let simulated = SharedBoard::new(board);
        let board = Board::over(simulated.wire(), "sim")?;
        Ok(Self { board, simulated: Some(simulated), file: Some(file), weightless, smooth: false })
    }
}

/// The hand that a page leads.
pub fn hand_settings() -> HandSettings {
    HandSettings { tremor: TREMOR, ..HandSettings::default() }
}

/// Leads the simulated hand to `goal` (m) in the plane that is drawn, or lets go of the tip.
pub fn lead(board: &SharedBoard, goal: Option<[f64; 2]>) {
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
            device.hand_mut().lead([x, y, 0.0]);
        }
    }
}

/// A wall in front of the tip at home, below it where the device moves in a plane or in space, of half the stiffness that
/// is predicted stable.
pub fn wall_ahead(file: &DeviceFile) -> Result<Scene<f32>, Failure> {
    let task = file.spec().task;
    let none = || {
        Failure::wrong(format!("{} has no [home], so there is no pose to start in", file.path.display()))
            .remedy("add one to the device file")
    };
    let home = file.description.home.ok_or_else(none)?;
    let q = &home[..file.spec().joints];
    let pose = crate::analysis::pose::TaskPose::at(&file.description, q)?;
    let mut normal = vec![0.0; task];
    normal[usize::from(task > 1)] = 1.0;
    let point = core::array::from_fn(|i| match (pose.position.get(i), normal.get(i)) {
        (Some(place), Some(n)) => (place - AHEAD * n) as f32,
        _ => 0.0,
    });
    let normal_f32 = core::array::from_fn(|i| normal.get(i).map_or(0.0, |n| *n as f32));
    let mut wall = Wall {
        surface: Surface::Plane(Plane { point, normal: normal_f32 }),
        stiffness: 0.0,
        damping: 0.0,
        feed_forward: FeedForward::Washout,
        washout_hz: DEFAULT_WASHOUT_HZ as f32,
        damping_compensation: false,
        bilateral: false,
    };
    let mut scene = Scene {
        task: task as u8,
        rate_hz: DEFAULT_RATE_HZ as f32,
        cutoff_hz: DEFAULT_CUTOFF_HZ as f32,
        ..Scene::default()
    };
    let (subject, path) =
        (Subject::new(&file.description).map_err(Failure::wrong)?, TorquePath::usual(DEFAULT_RATE_HZ));
    let Some(prediction) = Prediction::in_scene(&subject, &scene.cast(), None, &path) else { return Ok(scene) };
    let (_, most_damping) = prediction.stiffness_at(q, &normal, Mode::Off, 0.0)?;
    let damping = 0.2 * most_damping;
    let (most_stiffness, _) = prediction.stiffness_at(q, &normal, Mode::Off, damping)?;
    (wall.stiffness, wall.damping) = ((0.5 * most_stiffness) as f32, damping as f32);
    // A scene holds eight walls.
    let _ = scene.walls.push(wall);
    Ok(scene)
}
