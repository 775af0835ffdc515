//! The gains of one wall.

use crate::render::scene::FeedForward;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// A wall's gains, which may change while the wall is touched.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Gains<T> {
    /// Index of the wall, from 0.
    pub wall: u8,
    /// Stiffness, N/m.
    pub stiffness: T,
    /// Damping, N s/m.
    pub damping: T,
    /// Feed-forward of the wall's force.
    pub feed_forward: FeedForward,
    /// Corner frequency of the feed-forward's washout, Hz.
    pub washout_hz: T,
}
