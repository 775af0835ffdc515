//! The subject of a view: a board, its links to draw, and the hand on it if it is simulated.

use crate::demo::Demo;
use haptic_bridge::render::scene::{FeedForward, Scene};
use haptic_bridge::safety::refusal::Refusal;
use haptic_host::device_file::DeviceFile;
use haptic_host::error::Failure;
use haptic_host::link::{Board, LinkError};
use haptic_predict::wall_ahead::wall_ahead;
use haptic_sim::{BoardOptions, Hand, HandSettings, Intent, Options, SharedBoard, ready_board};

/// Distance at which the wall of [`World::demo`] stands in front of the tip, m.
const NEAR: f64 = 0.010;
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
    /// The name of the scene's file, by which links know it.
    pub scene_name: Option<String>,
    /// The device's weight was left out.
    pub weightless: bool,
    /// The device has less dry friction and finer encoders than its file says.
    pub smooth: bool,
}

impl World {
    /// A board that is there.
    pub fn of(board: Board, file: Option<DeviceFile>) -> Self {
        Self { board, simulated: None, file, scene_name: None, weightless: false, smooth: false }
    }

    /// The device or the scene that a connected board still needs before it can be looked at.
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
        // The wall passes 2 mm behind the tip's place at 2.2 and 1.2 rad, in and around which it was tried.
        (demo.pose, demo.normal) = ([2.109_673, 1.225_778, 0.0], [cosine, sine]);
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

    /// A simulated device in a scene, or before a wall that is stable and does not rattle.
    pub fn simulate(file: DeviceFile, scene: Option<Scene<f32>>) -> Result<Self, Failure> {
        let scene = match scene {
            Some(scene) => scene,
            None => wall_ahead(&file)?,
        };
        let mut world = Self::start(file, None)?;
        world.board.set_scene(&scene)?;
        Ok(world)
    }

    /// The device without its weight: with the motors off no hand would carry it, and with them on the board does.
    fn start(mut file: DeviceFile, start: Option<[f64; 3]>) -> Result<Self, Failure> {
        let weightless = file.description.gravity.iter().any(|g| *g != 0.0);
        file.description.gravity = [0.0; 3];
        let device = Options { start, stops_short: true, ..Options::default() };
        let options = BoardOptions { device, ..BoardOptions::default() };
        let board = ready_board(&file, options)
            .map_err(|error| LinkError::CannotSimulate(format!("{}: {error}", file.path.display())))?;
        let simulated = SharedBoard::new(board);
        let board = Board::over(simulated.wire(), "sim")?;
        Ok(Self { simulated: Some(simulated), weightless, ..Self::of(board, Some(file)) })
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
