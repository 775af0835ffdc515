//! The share of the feed-forward and of the velocity terms near singularities.

use crate::math::Real;
use crate::model::mechanism::Regularity;
use nalgebra::SVector;

/// Sine of the nearest serial singularity at and above which the feed-forward acts in full.
///
/// At 0.05 an elbow is 3° from stretched and cond J is about 40 on the shipped devices. The torque's error in f32 is
/// still below 2e-5 there (docs/hard-cases.md). The limit protects the hand, because the feed-forward grows as 1/sin.
pub const FULL_REGULARITY: f64 = 0.05;
/// Sine at and below which the feed-forward is off. It fades up to [`FULL_REGULARITY`], so the force is continuous.
pub const NO_REGULARITY: f64 = 0.02;
/// Divisor of the sine of a parallel singularity before the comparison with the limits for serial singularities. The
/// feed-forward therefore acts in full from a sine of 0.15 (rods 9° from one line), and is off at 0.06. Jᵀ itself loses
/// digits as 1/sin², and from 0.15 on the f32 torque of a moving tip is within 1e-4 (docs/hard-cases.md).
pub const PARALLEL_REGULARITY: f64 = 3.0;
/// Rotation of the fastest joint during the lag of its velocity estimate (rad), divided by the sine of the nearest
/// singularity, up to which velocity terms act in full.
///
/// b grows as 1/sin³ at constant tip speed, so b changes by three times this quotient within the lag: by 15 % here, by
/// 30 % at [`NO_TERMS_TURN`]. Beyond, b mostly reflects past motion, and would push a tip that slides towards a
/// stretched arm further into the singularity (docs/model.md).
pub const FULL_TERMS_TURN: f64 = 0.05;
/// Value of the quotient in [`FULL_TERMS_TURN`] from which velocity terms are off. They fade between the two values.
pub const NO_TERMS_TURN: f64 = 0.1;

/// Returns the active share of the velocity terms at `qd` (rad/s) with a lag of `lag` (s), see [`FULL_TERMS_TURN`].
#[inline(always)]
pub fn velocity_term_share<T: Real, const N: usize>(regularity: &Regularity<T>, qd: &SVector<T, N>, lag: T) -> T {
    let near = regularity.serial.lesser(regularity.parallel);
    let turned = qd.iter().fold(T::zero(), |largest, v| largest.greater(v.abs())) * lag;
    if turned <= near * T::from_f64(FULL_TERMS_TURN) {
        return T::one();
    }
    let unknown = near * T::from_f64(NO_TERMS_TURN);
    if turned >= unknown {
        return T::zero();
    }
    let s = (unknown - turned) / (near * T::from_f64(NO_TERMS_TURN - FULL_TERMS_TURN));
    s * s * (T::from_f64(3.0) - s - s)
}

/// Returns the sine of the nearest singularity, with [`PARALLEL_REGULARITY`] applied.
#[inline(always)]
pub(super) fn clearance<T: Real>(regularity: &Regularity<T>) -> T {
    regularity.serial.lesser(regularity.parallel * T::from_f64(1.0 / PARALLEL_REGULARITY))
}

/// Returns the share of the feed-forward at this sine, a smooth step from [`NO_REGULARITY`] to [`FULL_REGULARITY`].
#[inline(always)]
pub(super) fn fade<T: Real>(regularity: T) -> T {
    let (low, high) = (T::from_f64(NO_REGULARITY), T::from_f64(FULL_REGULARITY));
    if regularity >= high {
        return T::one();
    }
    let s = ((regularity - low) * T::from_f64(1.0 / (FULL_REGULARITY - NO_REGULARITY))).greater(T::zero());
    s * s * (T::from_f64(3.0) - s - s)
}
