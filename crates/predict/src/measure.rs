//! Measuring the stable range on a board: raise the stiffness until the loop oscillates, back off, bisect, repeat.
//!
//! Everything goes through the protocol, so the board may be simulated, emulated or real, and the theory is not asked:
//! what counts is whether the telemetry of the wall's motion dies out, builds up or goes on ([`swing`]).
//!
//! One bilateral wall, or a set of them in given parts of one stiffness and damping, is tested at the place where the
//! tip is held. Holding is done by walls too, because gains change at once and a new scene fades in over half a second:
//! one wall along the direction of the pull and one across it for every other direction (`measure/walls.rs`). A trial
//! pulls the tip aside by a small distance, lets it swing back, and hands it over to the tested gains. The holding
//! walls are soft springs chosen from the inertia at the pose, the filter's cutoff and the friction, and made softer
//! until the tip rests: a cable that gives may leave less damping than a rigid device stands, whatever its file says.
//!
//! A tip has several poses: the joints are compared with those of the beginning before and after every trial, and a
//! trial in another pose is no measurement. A redundant device needs a [`Law::posture`] besides.
//!
//! One wall is pulled along its normal. A set is pulled, and watched, half way between the stiffest motion that it
//! allows without the feed-forward and the one with it: a direction that shows either.
//!
//! A pull must be longer than what encoder steps explain ([`excitation`]); where the motors cannot even make the force
//! of the smallest such pull, nothing can be told, and nothing is reported.

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

/// Why a measurement, or the part of it at one damping, ended early. A measurement that returns one of these has turned
/// the motors off, if the board still answers; else it does so itself.
#[derive(Debug, Error)]
pub enum MeasureError {
    /// The board could not be reached or refused.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// The link broke.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The user stopped it.
    #[error("interrupted")]
    Interrupted,
    /// The board tripped a fault.
    #[error("the board tripped a fault: {0}")]
    Fault(Fault),
    /// Somebody else has turned the motors off.
    #[error("the motors were turned off meanwhile, not by this measurement")]
    Disarmed,
    /// The device stands elsewhere than when the measurement began.
    #[error("the device does not stand where this measurement began")]
    Moved,
    /// The joints are not where they were, though the tip may be.
    #[error(
        "joint {joint} stands {by:.3} rad from where the measurement began: what would be measured there is another pose"
    )]
    Away {
        /// Index of the joint.
        joint: usize,
        /// How far, rad.
        by: f64,
    },
    /// The tip could not be held still.
    #[error("the tip does not come to rest when held softly")]
    Restless,
    /// The tip could not be pulled aside.
    #[error(
        "friction holds the tip: a pull of {} mm takes {force:.3} N, and friction {friction:.3} N",
        crate::measure::excitation::millimetres(*.pull)
    )]
    Stuck {
        /// Length of the pull, m.
        pull: f64,
        /// Force of the hold on a tip that is pulled so far, N.
        force: f64,
        /// Coulomb friction at the tip, N.
        friction: f64,
    },
    /// The pose is no good.
    #[error(transparent)]
    Pose(#[from] PoseError),
    /// The scene is impossible.
    #[error("{0}")]
    Scene(String),
    /// The progress cannot be kept.
    #[error(transparent)]
    Progress(#[from] progress::ProgressError),
    /// No bound was found.
    #[error("nothing oscillates: friction or a hand damps it")]
    Unbounded,
    /// The search for a boundary could not go on.
    #[error("stable up to {stable:.0}, then: {why}")]
    Open {
        /// The largest gain that was seen to be stable, N/m or N s/m.
        stable: f64,
        /// Why.
        why: Box<MeasureError>,
    },
    /// The motors are too weak, or the encoders too coarse, to tell.
    #[error(
        "the motors saturate before the encoders can tell: at {stiffness:.0} N/m, {of}, the smallest pull, {} mm, takes \
         {:.3} N of the {force:.3} N that there are",
        crate::measure::excitation::millimetres(*.pull), .stiffness * .pull
    )]
    Saturates {
        /// Stiffness of the wall, or damping times the swing's frequency where that is more, N/m.
        stiffness: f64,
        /// Names the wall or hold that has this stiffness.
        of: &'static str,
        /// Shortest pull that counts, m.
        pull: f64,
        /// The most that the motors can give at the tip, N.
        force: f64,
    },
}

impl MeasureError {
    /// Returns true if the error concerns one damping only: the measurement goes on with the next.
    #[must_use]
    pub fn is_local(&self) -> bool {
        matches!(
            self,
            Self::Unbounded | Self::Saturates { .. } | Self::Restless | Self::Stuck { .. } | Self::Away { .. }
        )
    }
}

/// The quantity to measure, and the limits within which it is measured.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasurementSetup {
    /// The walls that act together.
    pub walls: Vec<Member>,
    /// Control rate, Hz.
    pub rate_hz: f64,
    /// Cutoff of the velocity filter, Hz.
    pub cutoff_hz: f64,
    /// Corner of the washout where that is measured, Hz.
    pub washout_hz: f64,
    /// The rest of the law that is measured.
    pub law: Law,
    /// Largest joint torque the measurement may ask for, N m.
    pub torque_limit: f64,
    /// Farthest the tip is pulled aside, m.
    pub largest_pull: f64,
}

/// The parts of a scene that decide the range besides rate, cutoff and washout, as scene files say them, with their
/// defaults.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    /// Velocity estimator.
    pub estimator: Estimator,
    /// True if the joints' own damping is compensated.
    pub damping_compensation: bool,
    /// The coordinate that a redundant device holds.
    pub admissible: Admissible,
    /// The device is held no faster than this, Hz: coarse encoders and weak motors hold only softly.
    pub hold_hz: f64,
    /// Holds the last link of a redundant device where it stands.
    pub posture: Option<Posture>,
    /// The tip may be pulled farther than the largest pull, up to [`walls::LONGEST_PULL`], where friction asks for it.
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
    /// Frequency with which the device is held and its motion judged, Hz: the low-pass's cutoff. The cutoff of an
    /// estimator that watches joints is not how fast the loop is, and theirs may be fast.
    #[must_use]
    pub fn tempo_hz(&self) -> f64 {
        let own = if self.law.estimator.spec().is_some() { (0.1 * self.rate_hz).min(500.0) } else { self.cutoff_hz };
        own.min(self.law.hold_hz)
    }
}
