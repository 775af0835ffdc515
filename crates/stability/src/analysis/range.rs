//! The answer of `haptic range`: the stable domain of a wall on one device for each way of feeding forward, side by
//! side.

use serde::Serialize;

use super::control_loop::{Loop, Mode};
pub use super::domain::{
    BOUNDARY_POINTS, BoundaryPoint, Domain, Island, boundary_of, domain, domain_of_several, oscillation, stiffness_at,
    stiffnesses,
};
use super::error::AnalysisError;
use super::host::HostWall;
use super::plant::Linearised;
use super::several::WallSet;
use haptic_bridge::render::scene::FeedForward;

/// Area gained by the feed-forward below which it is not worth its cost.
pub const WORTHWHILE_RATIO: f64 = 1.05;

/// A feed-forward that leaves less than this share of the stable area or stiffness costs more than it brings; the last
/// percent is rounding.
pub const COSTLY_RATIO: f64 = 0.99;

/// Number of times that the search for a washout's corner halves it.
const HALVED: i32 = 10;

/// The first corner below `corner` (Hz), halved again and again, that is `free`.
pub fn lower_corner<E>(corner: f64, free: impl Fn(f64) -> Result<bool, E>) -> Result<Option<f64>, E> {
    for lower in (1..=HALVED).map(|halved| corner / 2.0_f64.powi(halved)) {
        if free(lower)? {
            return Ok(Some(lower));
        }
    }
    Ok(None)
}

/// The answer of `haptic range`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Range {
    /// Effective inertia, kg: what the wall meets without the feed-forward; of several walls, what their total
    /// stiffness meets in the stiffest motion, without and with it.
    pub w_eff: f64,
    /// Rendered inertia, kg: what it meets with it.
    pub w_rr: f64,
    /// α and what the wall meets with that much of the feed-forward (kg), where it is not 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feed_forward_gain: Option<f64>,
    /// See `feed_forward_gain`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inertia_met: Option<f64>,
    /// Stiffness of the transmissions at the tip along the wall, N/m, where any gives: a hand feels a wall without the
    /// feed-forward behind it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transmissions: Option<f64>,
    /// Without feed-forward.
    pub off: Domain,
    /// With equation (4).
    pub full: Domain,
    /// With equation (4) behind a washout, when asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub washout: Option<Domain>,
    /// Area with the feed-forward over area without; zero where nothing is stable.
    pub area_ratio: f64,
    /// The same wall rendered by a program on a computer, when asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub host: Option<HostWall>,
}

impl Range {
    /// The domain with this feed-forward; that of equation (4) for a washout that was not asked for.
    #[must_use]
    pub fn of(&self, feed_forward: FeedForward) -> &Domain {
        match feed_forward {
            FeedForward::Off => &self.off,
            FeedForward::Full => &self.full,
            FeedForward::Washout => self.washout.as_ref().unwrap_or(&self.full),
        }
    }
}

/// Predicts the stable domain of `device` in `around`: without, with, and (at `washout_hz`) with washed-out
/// feed-forward.
///
/// `kd` asks for the boundary at exactly these damping values (N s/m); else it has [`BOUNDARY_POINTS`] even ones.
pub fn predict(
    device: &Linearised,
    around: &Loop,
    kd: Option<&[f64]>,
    washout_hz: Option<f64>,
) -> Result<Range, AnalysisError> {
    let off = domain(device, around, Mode::Off, kd)?;
    let full = domain(device, around, Mode::Full, kd)?;
    let washout = washout_hz.map(|hz| domain(device, around, Mode::Washout(hz), kd)).transpose()?;
    let area_ratio = if off.area > 0.0 { full.area / off.area } else { 0.0 };
    let w_eff = device.w_eff().ok_or(AnalysisError::Singular)?;
    let feed_forward_gain = (device.gain != 1.0).then_some(device.gain);
    let inertia_met = feed_forward_gain.and_then(|_| device.inertia_met());
    let transmissions = device.compliance(Mode::Off).map(|compliance| 1.0 / compliance);
    let (w_rr, host) = (device.w_rr(), None);
    Ok(Range { w_eff, w_rr, feed_forward_gain, inertia_met, transmissions, off, full, washout, area_ratio, host })
}

/// Predicts the stable domain of walls that act together, in the totals of stiffness and damping.
pub fn predict_several(
    set: &WallSet,
    around: &Loop,
    kd: Option<&[f64]>,
    washout_hz: Option<f64>,
) -> Result<Range, AnalysisError> {
    let of = |mode| domain_of_several(set, around, mode, kd);
    let (off, full) = (of(Mode::Off)?, of(Mode::Full)?);
    let washout = washout_hz.map(|hz| of(Mode::Washout(hz))).transpose()?;
    let area_ratio = if off.area > 0.0 { full.area / off.area } else { 0.0 };
    let met = |feed_forward| set.met(feed_forward).ok_or(AnalysisError::Singular);
    let (w_eff, w_rr) = (met(false)?, met(true)?);
    let (feed_forward_gain, inertia_met, transmissions, host) = (None, None, None, None);
    Ok(Range { w_eff, w_rr, feed_forward_gain, inertia_met, transmissions, off, full, washout, area_ratio, host })
}
