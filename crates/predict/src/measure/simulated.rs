//! A simulated board to measure on, whose world is as simple as the question asks: the device as its file describes it,
//! or without friction, with finer encoders, with torque that acts at once, at any pose.

use haptic_host::device_file::DeviceFile;
use haptic_sim::{
    BoardOptions, DeviceError, DriveModel, Hand, HandSettings, Intent, Options, SharedBoard, Support, Waypoint,
    ready_board,
};

/// Which friction of the device file acts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Friction {
    /// All of it.
    #[default]
    All,
    /// The viscous part.
    Viscous,
    /// The Coulomb part.
    Coulomb,
    /// None.
    None,
}

/// The simulated world.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct World {
    /// The device's pose, rad; its home when `None`.
    pub q: Option<[f64; 3]>,
    /// Which friction acts.
    pub friction: Friction,
    /// Commanded torques act at once, without bridges, windings and current loops.
    pub ideal_drive: bool,
    /// Counts per turn of every encoder; the device file's when `None`.
    pub counts: Option<f64>,
    /// A relaxed grip at rest holds the tip ([`HandSettings::default`]).
    pub grip: bool,
}

/// Simulation steps in a control period. The torque is held for a whole period, so slow loops need no finer ones.
const STEPS: f64 = 100.0;
/// Shortest and longest simulation step, s. The longest is half a carrier period at 20 kHz.
const STEP_RANGE_S: (f64, f64) = (2e-6, 2.5e-5);

impl World {
    /// Takes out of the description what this world leaves out, so that predictions made from it are of the same world.
    pub fn apply(&self, file: &mut DeviceFile) {
        for joint in &mut file.description.joints {
            if matches!(self.friction, Friction::Coulomb | Friction::None) {
                joint.viscous = 0.0;
            }
            if matches!(self.friction, Friction::Viscous | Friction::None) {
                joint.coulomb = 0.0;
                joint.friction = None;
            }
            if let (Some(encoder), Some(counts)) = (&mut joint.encoder, self.counts) {
                encoder.counts_per_turn = counts;
            }
        }
    }

    /// A board with the device of `file`, to which [`World::apply`] was done, that will run at `rate_hz`.
    pub fn board(&self, file: &DeviceFile, rate_hz: f64) -> Result<SharedBoard, DeviceError> {
        let device = Options {
            start: self.q,
            substep: (1.0 / (STEPS * rate_hz)).clamp(STEP_RANGE_S.0, STEP_RANGE_S.1),
            ..Options::default()
        };
        let drive = if self.ideal_drive { DriveModel::Ideal } else { DriveModel::Electric };
        // Its user holds it until the motors carry it: what has weight would fall into another pose.
        let options = BoardOptions { device, drive, support: Support::Held, ..BoardOptions::default() };
        let mut board = ready_board(file, options)?;
        if self.grip {
            let tip = board.device().tip();
            let rest = Intent::Follow(vec![Waypoint { time: 0.0, value: tip }]);
            board.device_mut().set_hand(Hand::new(HandSettings::default(), rest, tip, 0.0));
        }
        Ok(SharedBoard::new(board))
    }
}
