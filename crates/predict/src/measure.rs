//! Measures the stable range on a board: raises the stiffness until the loop oscillates, backs off, bisects, repeats.
//!
//! The measurement uses the board's protocol only, so the board may be simulated, emulated or real, and it does not use
//! the theory. The telemetry decides: the motion of the tip dies out, builds up or continues ([`swing`]).
//!
//! The tested walls are one bilateral wall, or several with given shares of one stiffness and damping, at the position
//! where the tip is held. Walls also hold the tip, because gains change at once and a new scene fades in over half a
//! second: one wall along the direction of the pull and one across it for every other direction (`measure/walls.rs`). A
//! trial pulls the tip aside by a small distance, lets it swing back, and hands it over to the tested gains. The holding
//! walls are soft springs, chosen from the inertia at the pose, the filter's cutoff and the friction. They are made
//! softer until the tip rests, because a device with compliant cables may tolerate less damping than a rigid one.
//!
//! A tip position has several poses. Before and after every trial the joints are compared with the first pose, and a
//! trial in another pose does not count. A redundant device also needs a [`Law::posture`].
//!
//! One wall is pulled along its normal. Several walls are pulled, and observed, half way between the stiffest motion
//! without the feed-forward and the stiffest motion with it, because this direction shows both.
//!
//! A pull must be longer than the motion that encoder steps explain ([`excitation`]). If the motors cannot make the
//! force of the shortest such pull, no result is reported.

pub mod before;
pub mod campaign;
pub mod excitation;
pub mod occasion;
pub mod prepared;
pub mod progress;
pub mod search;
pub mod simulated;
pub mod swing;
mod walls;

pub use prepared::{PreparedBoard, rules_for};
pub use search::Boundary;
pub use walls::{LONGEST_PULL, complement, most_tested};

use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::render::velocity::Estimator;
use haptic_bridge::safety::fault::Fault;
use thiserror::Error;

use haptic_host::link::{BoardError, LinkError};
use haptic_stability::analysis::flexible::Posture;
use haptic_stability::analysis::pose::PoseError;
use haptic_stability::analysis::several::Member;

/// Reason why a measurement, or its part at one damping, ended early. The motors are then off: the measurement has
/// turned them off, or the board does so if it no longer replies.
#[derive(Debug, Error)]
pub enum MeasureError {
    /// The board could not be reached, or it refused a request.
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
    /// The device is in another pose than at the beginning.
    #[error("the device has left the pose in which this measurement began")]
    Moved,
    /// A joint has moved since the beginning; the tip may be at its position nevertheless.
    #[error("joint {joint} is {by:.3} rad from its angle at the beginning of the measurement: this is another pose")]
    Away {
        /// Index of the joint.
        joint: usize,
        /// Distance from the first angle, rad.
        by: f64,
    },
    /// The tip could not be held still.
    #[error("the tip does not come to rest when held softly")]
    Restless,
    /// The tip could not be pulled aside.
    #[error(
        "friction holds the tip: a pull of {} mm makes {force:.3} N, but friction is {friction:.3} N",
        crate::measure::excitation::millimetres(*.pull)
    )]
    Stuck {
        /// Length of the pull, m.
        pull: f64,
        /// Force of the hold at this pull, N.
        force: f64,
        /// Coulomb friction at the tip, N.
        friction: f64,
    },
    /// The device cannot be analysed in this pose.
    #[error(transparent)]
    Pose(#[from] PoseError),
    /// The measurement's scene cannot be made.
    #[error("{0}")]
    Scene(String),
    /// The progress cannot be saved.
    #[error(transparent)]
    Progress(#[from] progress::ProgressError),
    /// No gain oscillates.
    #[error("no wall oscillates: friction or a hand damps the motion")]
    Unbounded,
    /// The search for a boundary ended early.
    #[error("stable up to {stable:.0}, then: {why}")]
    Open {
        /// The largest gain that was stable, N/m or N s/m.
        stable: f64,
        /// Reason.
        why: Box<MeasureError>,
    },
    /// The motors are too weak, or the encoders too coarse, to measure.
    #[error(
        "the motors are too weak for these encoders: at {stiffness:.0} N/m, {of}, the shortest measurable pull, {} mm, \
         needs {:.3} N, and the motors make at most {force:.3} N",
        crate::measure::excitation::millimetres(*.pull), .stiffness * .pull
    )]
    Saturates {
        /// Stiffness of the wall, or damping times the frequency of the swing if that is larger, N/m.
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
    /// Returns true if the error concerns one damping only, so that the measurement continues with the next.
    #[must_use]
    pub fn is_local(&self) -> bool {
        matches!(
            self,
            Self::Unbounded | Self::Saturates { .. } | Self::Restless | Self::Stuck { .. } | Self::Away { .. }
        )
    }
}

/// The walls and the control loop to measure, and the limits of the measurement.
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

/// The properties of a scene that determine the range in addition to rate, cutoff and washout, with the defaults of
/// scene files.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    /// Velocity estimator.
    pub estimator: Estimator,
    /// True if the damping of the joints is compensated.
    pub damping_compensation: bool,
    /// The coordinate that a redundant device holds.
    pub admissible: Admissible,
    /// Highest frequency of the hold, Hz: coarse encoders and weak motors hold only softly.
    pub hold_hz: f64,
    /// Posture that holds the last link of a redundant device.
    pub posture: Option<Posture>,
    /// True if friction may lengthen a pull beyond `largest_pull`, up to [`walls::LONGEST_PULL`].
    pub farther: bool,
}

impl Default for Law {
    fn default() -> Self {
        Self {
            estimator: Estimator::default(),
            damping_compensation: false,
            admissible: Admissible::default(),
            hold_hz: f64::INFINITY,
            posture: None,
            farther: false,
        }
    }
}

impl MeasurementSetup {
    /// Returns the frequency of the hold and of the judged motion, Hz: the low-pass cutoff. An estimator that works on
    /// joints is not limited by the cutoff, so a tenth of the rate, but at most 500 Hz, is returned.
    #[must_use]
    pub fn tempo_hz(&self) -> f64 {
        let own = if self.law.estimator.spec().is_some() { (0.1 * self.rate_hz).min(500.0) } else { self.cutoff_hz };
        own.min(self.law.hold_hz)
    }
}
