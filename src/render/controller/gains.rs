//! The gains of one wall.

use crate::render::scene::FeedForward;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// A scene's gains of one wall, as they may change while the wall is touched.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Gains<T> {
    /// Which wall, from 0.
    pub wall: u8,
    /// N/m
    pub stiffness: T,
    /// N s/m
    pub damping: T,
    /// The shaping of its force.
    pub feed_forward: FeedForward,
    /// Corner of its washout, Hz.
    pub washout_hz: T,
}
