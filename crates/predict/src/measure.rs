//! Measures stable gains on a board: raises the stiffness until the loop oscillates, then bisects.
//!
//! The measurement uses only the board's protocol, so the board may be simulated, emulated or real. The measurement
//! does not use the theory. Telemetry shows if the tip's motion decays, grows or continues ([`swing`]).
//!
//! The tested walls are one bilateral wall, or several with given shares of one stiffness and damping, at the position
//! where the tip is held. Walls also hold the tip, because gains change at once but a new scene fades in over half a
//! second: one wall along the pull and one for every direction across it (`measure/walls.rs`).
//!
//! A trial pulls the tip aside by a small distance, lets it swing back, and switches to the tested gains. The holding
//! walls are soft springs, chosen from the inertia at the pose, the filter's cutoff and friction. They become softer
//! until the tip rests, because a device with compliant cables may tolerate less damping than a rigid device.
//!
//! A tip position has several poses. The joints are compared with the first pose before and after every trial, and a
//! trial in another pose does not count. A redundant device also needs a [`Law::posture`].
//!
//! One wall is pulled along its normal. Several walls are pulled and observed half way between the stiffest motions
//! without and with the feed-forward, because this direction shows both motions.
//!
//! A pull must be longer than the motion that encoder steps cause ([`excitation`]). If the motors cannot make the force
//! of the shortest such pull, there is no result.

pub mod board_measurement;
pub mod campaign;
pub mod earlier_settings;
pub mod excitation;
pub mod prepared;
pub mod progress;
pub mod search;
pub mod simulated;
pub mod swing;
mod walls;

use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::render::velocity::Estimator;
use haptic_bridge::safety::fault::Fault;
use haptic_host::link::{BoardError, LinkError};
use haptic_stability::analysis::flexible::Posture;
use haptic_stability::analysis::pose::PoseError;
use haptic_stability::analysis::several::Member;
pub use prepared::{PreparedBoard, rules_for};
pub use search::Boundary;
use thiserror::Error;
pub use walls::{LONGEST_PULL, complement, max_tested_walls};

/// Reason why a measurement, or its part at one damping, ended early. The motors are then off: the measurement turned
/// them off, or the board does so because it no longer receives heartbeats.
#[derive(Debug, Error)]
pub enum MeasureError {
    /// The board refused a request or could not be reached.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// The connection was lost.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The user stopped the measurement.
    #[error("interrupted")]
    Interrupted,
    /// The board tripped a fault.
    #[error("the board tripped a fault: {0}")]
    Fault(Fault),
    /// Another program has turned the motors off.
    #[error("another program turned the motors off during the measurement")]
    Disarmed,
    /// The device is not in the pose in which the measurement began.
    #[error("the device has left the pose in which this measurement began")]
    Moved,
    /// A joint is not at its first angle. The tip may still be at its first position.
    #[error("joint {joint} is {by:.3} {unit} from its angle at the beginning of the measurement: this is another pose")]
    Away {
        /// Index of the joint.
        joint: usize,
        /// Distance from the first angle, or travel of a slide.
        by: f64,
        /// Unit of the distance.
        unit: &'static str,
    },
    /// The tip does not come to rest.
    #[error("the tip does not come to rest when held softly")]
    Restless,
    /// The tip cannot be pulled aside.
    #[error(
        "{} the tip: a pull of {} mm makes {force:.3} N, {} friction is {friction:.3} N",
        if force > friction { "a hand or a stop holds" } else { "friction holds" },
        crate::measure::excitation::millimetres(*.pull),
        if force > friction { "and" } else { "but" },
    )]
    Stuck {
        /// Length of the pull, m.
        pull: f64,
        /// Force of the hold at this pull, N.
        force: f64,
        /// Coulomb friction at the tip, N.
        friction: f64,
    },
    /// The device cannot be analysed at this pose.
    #[error(transparent)]
    Pose(#[from] PoseError),
    /// The scene of the measurement is invalid.
    #[error("{0}")]
    Scene(String),
    /// The progress file cannot be written.
    #[error(transparent)]
    Progress(#[from] progress::ProgressError),
    /// All gains are stable.
    #[error("no wall oscillates: friction or a hand damps the motion")]
    Unbounded,
    /// The search for a boundary ended early.
    #[error("stable up to {stable:.0}, then: {why}")]
    Open {
        /// The largest gain that was stable, N/m or N s/m.
        stable: f64,
        /// Reason why the search ended.
        why: Box<MeasureError>,
    },
    /// The motors are too weak, or the encoders too coarse, for a measurement.
    #[error(
        "the motors are too weak for these encoders: at {stiffness:.0} N/m, {of}, the shortest measurable pull, {} mm, \
         needs {:.3} N, and the motors make at most {force:.3} N",
        crate::measure::excitation::millimetres(*.pull), .stiffness * .pull
    )]
    Saturates {
        /// Stiffness of the wall, or the product of damping and frequency of the swing if that is larger, N/m.
        stiffness: f64,
        /// Names the wall or hold that has this stiffness.
        of: &'static str,
        /// Shortest pull that counts, m.
        pull: f64,
        /// Largest force of the motors at the tip, N.
        force: f64,
    },
}

impl MeasureError {
    /// Returns true if the error concerns only one damping, so that the measurement continues at the next.
    #[must_use]
    pub fn is_local(&self) -> bool {
        matches!(
            self,
            Self::Unbounded | Self::Saturates { .. } | Self::Restless | Self::Stuck { .. } | Self::Away { .. }
        )
    }
}

/// The walls and the control loop that are measured, and the limits of the measurement.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasurementSetup {
    /// The walls that act together.
    pub walls: Vec<Member>,
    /// Control rate, Hz.
    pub rate_hz: f64,
    /// Cutoff of the velocity filter, Hz.
    pub cutoff_hz: f64,
    /// Corner of the washout, Hz.
    pub washout_hz: f64,
    /// Other properties of the measured control loop.
    pub law: Law,
    /// Largest joint torque of the measurement, N m.
    pub torque_limit: f64,
    /// Longest pull, m.
    pub largest_pull: f64,
}

/// Properties of a scene that determine the range in addition to rate, cutoff and washout.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    /// Velocity estimator.
    pub estimator: Estimator,
    /// True if the damping of the joints is compensated.
    pub damping_compensation: bool,
    /// The coordinate that the feed-forward of a redundant device holds.
    pub admissible: Admissible,
    /// Highest frequency of the hold, Hz. Coarse encoders and weak motors allow only a soft hold.
    pub hold_hz: f64,
    /// Posture control of the last link of a redundant device.
    pub posture: Option<Posture>,
    /// True if friction may lengthen a pull beyond `largest_pull`, up to [`walls::LONGEST_PULL`].
    pub may_lengthen_pull: bool,
}

impl Default for Law {
    fn default() -> Self {
        Self {
            estimator: Estimator::default(),
            damping_compensation: false,
            admissible: Admissible::default(),
            hold_hz: f64::INFINITY,
            posture: None,
            may_lengthen_pull: false,
        }
    }
}

impl MeasurementSetup {
    /// Returns the frequency of the hold and of the judged motion, Hz. It is the low-pass cutoff, or a tenth of the
    /// rate, at most 500 Hz, for an estimator that works on joints, because the cutoff does not limit it.
    #[must_use]
    pub fn tempo_hz(&self) -> f64 {
        let own = if self.law.estimator.spec().is_some() { (0.1 * self.rate_hz).min(500.0) } else { self.cutoff_hz };
        own.min(self.law.hold_hz)
    }
}
