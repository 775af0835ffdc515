//! The share of the feed-forward and of the velocity terms near singularities.

use crate::math::Real;
use crate::model::mechanism::Regularity;
use nalgebra::SVector;

/// Sine of the nearest serial singularity at and above which the feed-forward acts in full.
///
/// At 0.05 an elbow is 3° from stretched and cond J is about 40 on the shipped devices. f32 keeps the torque within
/// 2e-5 there (docs/hard-cases.md), so the limit is needed not for precision but to protect the hand from a
/// feed-forward that grows as 1/sin.
pub const FULL_REGULARITY: f64 = 0.05;
/// Sine at and below which the feed-forward is off. Up to [`FULL_REGULARITY`] it fades, so the force is continuous.
pub const NO_REGULARITY: f64 = 0.02;
/// Divisor of the sine of a parallel singularity, which then counts as nearer: the feed-forward acts in full from a sine
/// of 0.15 (rods 9° from one line) and is off at 0.06. Precision sets this limit: Jᵀ itself loses digits as 1/sin², and
/// down to 0.15 f32 keeps the torque of a moving tip within 1e-4 (docs/hard-cases.md).
pub const PARALLEL_REGULARITY: f64 = 3.0;
/// Largest rotation of the fastest joint during the lag of its velocity estimate (rad), as a share of the sine of the
/// nearest singularity, with which the velocity terms act in full.
///
/// b grows as 1/sin³ at a constant speed of the tip, so within the lag it changes by three times this share: by 15 %
/// here, and by 30 % at [`UNKNOWN_TURN`]. Beyond that, b mostly reflects the past motion, and pushes a tip that slides
/// towards a stretched arm further into it (docs/model.md).
pub const KNOWN_TURN: f64 = 0.05;
/// Share like [`KNOWN_TURN`], at and above which velocity terms are off. Between the two they fade, so no force jumps.
pub const UNKNOWN_TURN: f64 = 0.1;

/// Returns the active share of the velocity terms at `qd` (rad/s) with a lag of `lag` (s), see [`KNOWN_TURN`].
#[inline(always)]
pub fn velocity_term_share<T: Real, const N: usize>(regularity: &Regularity<T>, qd: &SVector<T, N>, lag: T) -> T {
    let near = regularity.serial.lesser(regularity.parallel);
    let turned = qd.iter().fold(T::zero(), |largest, v| largest.greater(v.abs())) * lag;
    if turned <= near * T::from_f64(KNOWN_TURN) {
        return T::one();
    }
    let unknown = near * T::from_f64(UNKNOWN_TURN);
    if turned >= unknown {
        return T::zero();
    }
    let s = (unknown - turned) / (near * T::from_f64(UNKNOWN_TURN - KNOWN_TURN));
    s * s * (T::from_f64(3.0) - s - s)
}

/// Returns the distance from singularity for [`FULL_REGULARITY`] and [`PARALLEL_REGULARITY`].
#[inline(always)]
pub(super) fn clearance<T: Real>(regularity: &Regularity<T>) -> T {
    regularity.serial.lesser(regularity.parallel * T::from_f64(1.0 / PARALLEL_REGULARITY))
}

/// Returns the share of the feed-forward at [`clearance`]: a smooth step from [`NO_REGULARITY`] to [`FULL_REGULARITY`].
#[inline(always)]
pub(super) fn fade<T: Real>(regularity: T) -> T {
    let (low, high) = (T::from_f64(NO_REGULARITY), T::from_f64(FULL_REGULARITY));
    if regularity >= high {
        return T::one();
    }
    let s = ((regularity - low) * T::from_f64(1.0 / (FULL_REGULARITY - NO_REGULARITY))).greater(T::zero());
    s * s * (T::from_f64(3.0) - s - s)
}
