//! A simulated board for measurements, optionally without friction, with finer encoders or ideal drives.

use haptic_host::device_file::DeviceFile;
use haptic_sim::{
    BoardOptions, DeviceError, DriveModel, Hand, HandSettings, Intent, Options, SharedBoard, Support, Waypoint,
    ready_board,
};

/// Part of the device file's friction that is simulated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Friction {
    /// All friction.
    #[default]
    All,
    /// Only viscous friction.
    Viscous,
    /// Only Coulomb friction.
    Coulomb,
    /// No friction.
    None,
}

/// Settings of the simulation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct World {
    /// Pose of the device, rad; `None` for its home.
    pub q: Option<[f64; 3]>,
    /// Friction that is simulated.
    pub friction: Friction,
    /// True if torques act at once, without bridges, windings and current loops.
    pub ideal_drive: bool,
    /// Counts per turn of all encoders; `None` for the counts in the device file.
    pub counts: Option<f64>,
    /// True if a relaxed hand at rest holds the tip ([`HandSettings::default`]).
    pub grip: bool,
}

/// Number of simulation steps per control period, enough because the torque is constant in a period.
const STEPS: f64 = 100.0;
/// Shortest and longest simulation step, s. The longest step is half of a 20 kHz carrier period.
const STEP_RANGE_S: (f64, f64) = (2e-6, 2.5e-5);

impl World {
    /// Changes the description to this world, so that predictions apply to the same device.
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
                joint.absolute = None;
            }
        }
    }

    /// Returns a board for `rate_hz` with the device of `file`. [`World::apply`] must have changed `file`.
    pub fn board(&self, file: &DeviceFile, rate_hz: f64) -> Result<SharedBoard, DeviceError> {
        let device = Options {
            start: self.q,
            substep: (1.0 / (STEPS * rate_hz)).clamp(STEP_RANGE_S.0, STEP_RANGE_S.1),
            ..Options::default()
        };
        let drive = if self.ideal_drive { DriveModel::Ideal } else { DriveModel::Electric };
        // A user holds the device until the motors carry it, because otherwise its weight would move it.
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
