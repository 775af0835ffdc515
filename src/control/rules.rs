//! Rules that the control loop enforces.

use crate::model::catalogue::MAX_JOINTS;
use crate::safety::limits::Limits;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Reaction to a silent host, least strict first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Serialize, Deserialize, Schema)]
pub enum HostAction {
    /// Silence is no fault.
    Ignore,
    /// The scene continues. The fault is listed, and the board cannot be armed again until it is cleared.
    Hold,
    /// The motors go off.
    #[default]
    Disarm,
}

impl HostAction {
    /// Every action with its name on the command line.
    pub const ALL: [(&'static str, Self); 3] =
        [("ignore", Self::Ignore), ("hold", Self::Hold), ("disarm", Self::Disarm)];
}

/// Settings of the board that the control loop enforces.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Rules {
    /// Enforced limits.
    pub limits: Limits,
    /// Reaction to a silent host.
    pub host_action: HostAction,
    /// Time for which a host may be silent, s.
    pub host_seconds: f32,
    /// True if the passivity controller absorbs the energy that walls generate, with damping and less feed-forward.
    pub passivity: bool,
    /// Counts between two index pulses of each encoder; 0 for an encoder without index.
    pub index_period: [i32; MAX_JOINTS],
}

impl Default for Rules {
    fn default() -> Self {
        Self {
            limits: Limits::default(),
            host_action: HostAction::default(),
            host_seconds: 0.5,
            passivity: false,
            index_period: [0; MAX_JOINTS],
        }
    }
}

impl Rules {
    /// Shortest and longest permitted value of `host_seconds`, s. An f32 sum beyond a minute would lose steps.
    pub const HOST_SECONDS: (f32, f32) = (0.01, 60.0);

    /// Returns true if every protective setting is at least as strict as in `other`, which is safe at any time.
    pub fn is_no_looser_than(&self, other: &Self) -> bool {
        let watched = self.host_action >= other.host_action
            && (other.host_action == HostAction::Ignore || self.host_seconds <= other.host_seconds);
        let mut index = self.index_period.iter().zip(&other.index_period);
        self.limits.is_no_higher_than(&other.limits)
            && watched
            && (self.passivity || !other.passivity)
            && index.all(|(period, before)| *before == 0 || period == before)
    }
}
