//! The result of `haptic range`: the stable domain of a wall on one device for each feed-forward.

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
use serde::Serialize;

/// Smallest ratio of areas with and without the feed-forward that justifies its cost.
pub const WORTHWHILE_RATIO: f64 = 1.05;

/// Ratio of stable areas or stiffnesses below which a feed-forward does harm; the last percent is rounding.
pub const COSTLY_RATIO: f64 = 0.99;

/// Maximum number of halvings in the search for a washout corner.
const MAX_HALVINGS: i32 = 10;

/// Halves `corner` (Hz) repeatedly and returns the first corner for which `is_harmless` returns true.
pub fn lower_corner<E>(corner: f64, is_harmless: impl Fn(f64) -> Result<bool, E>) -> Result<Option<f64>, E> {
    for lower in (1..=MAX_HALVINGS).map(|halvings| corner / 2.0_f64.powi(halvings)) {
        if is_harmless(lower)? {
            return Ok(Some(lower));
        }
    }
    Ok(None)
}

/// The result of `haptic range`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Range {
    /// Effective inertia without the feed-forward, kg. For several walls it is the effective inertia of their total
    /// stiffness in the stiffest motion; `w_rr` is the corresponding value with the feed-forward.
    pub w_eff: f64,
    /// Rendered inertia, which is the effective inertia with the feed-forward, kg.
    pub w_rr: f64,
    /// Gain α of the feed-forward; `None` if it is 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feed_forward_gain: Option<f64>,
    /// Effective inertia with this gain α, kg.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub inertia_met: Option<f64>,
    /// Stiffness of the transmissions at the tip, in series with a wall, N/m; `None` if all are rigid.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub transmissions: Option<f64>,
    /// Domain without the feed-forward.
    pub off: Domain,
    /// Domain with the feed-forward of equation (4).
    pub full: Domain,
    /// Domain with the feed-forward behind a washout, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub washout: Option<Domain>,
    /// Ratio of the areas with and without the feed-forward; zero if nothing is stable.
    pub area_ratio: f64,
    /// The wall rendered by a program on a computer, if requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub host: Option<HostWall>,
}

impl Range {
    /// Returns the domain with this feed-forward; the domain of equation (4) for a washout that was not requested.
    #[must_use]
    pub fn of(&self, feed_forward: FeedForward) -> &Domain {
        match feed_forward {
            FeedForward::Off => &self.off,
            FeedForward::Full => &self.full,
            FeedForward::Washout => self.washout.as_ref().unwrap_or(&self.full),
        }
    }
}

/// Predicts the stable domains of `device` in `around`: without feed-forward, with it, and with it behind a washout at
/// `washout_hz`. The dampings are `kd` (N s/m) or [`BOUNDARY_POINTS`] evenly spaced dampings.
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

/// Like [`predict`], for several walls that act together. Stiffness and damping in the result are totals of the walls.
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
    let effective_inertia = |feed_forward| set.effective_inertia(feed_forward).ok_or(AnalysisError::Singular);
    let (w_eff, w_rr) = (effective_inertia(false)?, effective_inertia(true)?);
    let (feed_forward_gain, inertia_met, transmissions, host) = (None, None, None, None);
    Ok(Range { w_eff, w_rr, feed_forward_gain, inertia_met, transmissions, off, full, washout, area_ratio, host })
}
