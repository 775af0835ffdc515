//! Cuts the requested torques to the motors' limits.
//!
//! If each joint were limited separately, a wall pressed beyond the motors' limits would push sideways, and push less
//! the deeper it is pressed. The torques are therefore cut in the order of their purpose (docs/model.md section 2):
//!
//! 1. torques that carry the device's weight, each joint within its limit;
//! 2. torques that render the requested forces, Jᵀ f: one factor keeps their direction, within the force limit;
//! 3. the feed-forward of the rendered force, by one factor. Its tip force counts towards the force limit.
//!
//! If the force used a motor's entire limit, the feed-forward would have no room in the same direction and full room in
//! the opposite one. The common factor would then jump from 0 to 1 where that motor's feed-forward crosses zero. The
//! force therefore leaves each motor's feed-forward room of up to [`FEED_FORWARD_ROOM`] of the limit.

use super::ControlLoop;
use crate::control::joints::Torques;
use crate::control::program::Program;
use crate::drive::bits::margin_bits;
use crate::drive::stage::Stage;
use crate::math::{Math, clamp, sqrt};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::device::{Leverage, squared};
use crate::render::step_result::TorqueDemand;
use core::ops::DerefMut;

/// Share of a joint's limit that rendered forces leave to a feed-forward in the same direction.
const FEED_FORWARD_ROOM: f32 = 1.0 / 64.0;

/// Torques of a demand after limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GrantedTorques {
    /// Sum of gravity, rendered and feed-forward torques.
    pub torque: Torques,
    /// Torques that carry the device's weight.
    pub gravity: Torques,
    /// Share of the requested forces that is rendered.
    pub share: f32,
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Returns a negative number unless joint torques and tip forces of the demand on J joints are within the limits by
    /// more than rounding errors. Returns a negative number for NaN.
    #[inline(always)]
    pub(super) fn fits<const J: usize>(&self) -> i32 {
        let TorqueDemand { total, gravity, rendered, force_squared } = &self.now.result.asked;
        let mut margin = margin_bits(*force_squared, self.max_tip_force_squared);
        let mut pushing = *total;
        if self.compensates_weight {
            pushing.iter_mut().zip(gravity).take(J).for_each(|(total, gravity)| *total -= gravity);
        }
        margin |= margin_bits(squared(&self.leverage.force::<J>(&pushing)), self.max_tip_force_squared);
        if self.compensates_weight {
            for (i, fitting) in self.unclamped_torque.iter().enumerate().take(J) {
                // If the sum of the magnitudes of weight and force fits, then weight, force and their sum fit.
                let both = gravity[i].abs() + rendered[i].abs();
                margin |= margin_bits(total[i], *fitting) | margin_bits(both, *fitting);
            }
        } else {
            for (i, fitting) in self.unclamped_torque.iter().enumerate().take(J) {
                margin |= margin_bits(total[i], *fitting) | margin_bits(rendered[i], *fitting);
            }
        }
        margin
    }
}

impl TorqueDemand<f32> {
    /// Returns the torques within ±`limit` (not negative) of each of the J joints, and within `tip_force` (N, not
    /// negative). `leverage` is the tip force per joint torque.
    #[inline(always)]
    pub(super) fn granted_torques<const J: usize>(
        &self,
        limit: &Torques,
        tip_force: f32,
        leverage: &Leverage,
    ) -> GrantedTorques {
        let pushing = core::array::from_fn(|i| self.total[i] - self.gravity[i]);
        let mut margin = margin_bits(self.force_squared, tip_force * tip_force);
        margin |= margin_bits(squared(&leverage.force::<J>(&pushing)), tip_force * tip_force);
        for (i, limit) in limit.iter().enumerate().take(J) {
            let both = self.gravity[i] + self.rendered[i];
            margin |=
                margin_bits(self.gravity[i], *limit) | margin_bits(both, *limit) | margin_bits(self.total[i], *limit);
        }
        if margin >= 0 {
            GrantedTorques { torque: Torques(self.total), gravity: Torques(self.gravity), share: 1.0 }
        } else {
            self.cut_to_limits::<J>(limit, tip_force, leverage)
        }
    }

    /// Returns the rendered share of the requested forces, within `tip_force` (N) and ±`limit` of each of the J joints.
    #[inline(always)]
    fn share<const J: usize>(&self, limit: &Torques, tip_force: f32) -> f32 {
        let mut share = share_within(self.force_squared, tip_force);
        for (i, limit) in limit.iter().enumerate().take(J) {
            share = self.room_for_rendered(i, *limit, share);
        }
        share
    }

    /// Returns the largest share, up to `most`, of the rendered torque of joint `i` that fits within ±`limit` together
    /// with gravity and the room of its feed-forward.
    #[inline(always)]
    fn room_for_rendered(&self, i: usize, limit: f32, most: f32) -> f32 {
        let (base, part) = (clamp(self.gravity[i], limit), self.rendered[i]);
        let along = if part > 0.0 { self.feed_forward(i) } else { -self.feed_forward(i) };
        if along > 0.0 {
            // The larger share of two: the force and its feed-forward fit together, or the force leaves the reserved room.
            let both = room(base, part + self.feed_forward(i), limit, most);
            let alone = room(base, part, limit - FEED_FORWARD_ROOM * limit, most);
            if both > alone { both } else { alone }
        } else {
            room(base, part, limit, most)
        }
    }

    /// Returns the feed-forward of joint `i`: its demand beyond gravity and rendered forces.
    fn feed_forward(&self, i: usize) -> f32 {
        self.total[i] - self.gravity[i] - self.rendered[i]
    }

    #[inline(always)]
    fn feed_forwards(&self) -> [f32; MAX_JOINTS] {
        core::array::from_fn(|i| self.feed_forward(i))
    }

    #[allow(clippy::needless_range_loop, reason = "one number for four arrays")]
    #[inline(always)]
    fn cut_to_limits<const J: usize>(&self, limit: &Torques, tip_force: f32, leverage: &Leverage) -> GrantedTorques {
        let share = self.share::<J>(limit, tip_force);
        let (mut torque, mut gravity) = (Torques::default(), Torques::default());
        for i in 0..J {
            gravity[i] = clamp(self.gravity[i], limit[i]);
            torque[i] = gravity[i] + share * self.rendered[i];
        }
        let (force, aside) = (leverage.force::<J>(&self.rendered), leverage.force::<J>(&self.feed_forwards()));
        let mut rest_share = room_aside(&force.map(|along| share * along), &aside, tip_force, share);
        for i in 0..J {
            rest_share = room(torque[i], self.feed_forward(i), limit[i], rest_share);
        }
        for i in 0..J {
            // Limits each torque again, because rounding may exceed the limit. A torque that is not finite becomes 0.
            torque[i] = clamp(torque[i] + rest_share * self.feed_forward(i), limit[i]);
        }
        GrantedTorques { torque, gravity, share }
    }
}

/// Returns the factor that reduces a force, given by its square (N²), to at most `most` (N): 1 for a force within the
/// limit, 0 for a force that is not finite.
pub(super) fn share_within(squared: f32, most: f32) -> f32 {
    if squared <= most * most {
        1.0
    } else if squared.is_finite() {
        most / sqrt(squared)
    } else {
        0.0
    }
}

/// Returns the largest share, up to `most`, of `part` that fits on top of `base` within ±`limit`; 0 if `part` is NaN.
#[inline(always)]
fn room(base: f32, part: f32, limit: f32, most: f32) -> f32 {
    let space = if part > 0.0 { limit - base } else { limit + base };
    let size = part.abs();
    if size * most <= space {
        most
    } else if size > 0.0 && space > 0.0 {
        // At most `most`, because space < size · most.
        space / size
    } else {
        0.0
    }
}

/// Returns the largest share s, up to `share`, of the force `aside` (N) with |force + s aside| ≤ `most` (N); 0 for NaN.
#[inline(always)]
fn room_aside<const N: usize>(force: &[f32; N], aside: &[f32; N], most: f32, share: f32) -> f32 {
    let (a, room) = (squared(aside), most * most - squared(force));
    // A force at its limit may round to more than the limit.
    let room = if room < 0.0 { 0.0 } else { room };
    let b = (0..N).fold(0.0, |sum, i| sum + force[i] * aside[i]);
    if a * share * share + 2.0 * b * share <= room {
        return share;
    }
    // The positive root of a s² + 2 b s = room, computed without a difference of nearly equal numbers.
    let root = sqrt(b * b + a * room);
    let root_share = if b > 0.0 { room / (b + root) } else { (root - b) / a };
    if root_share > 0.0 && root_share < share { root_share } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut(gravity: [f32; 3], rendered: [f32; 3], rest: [f32; 3], limit: [f32; 3]) -> [f32; 3] {
        let total = core::array::from_fn(|i| gravity[i] + rendered[i] + rest[i]);
        *TorqueDemand { total, gravity, rendered, force_squared: 0.0 }
            .granted_torques::<3>(&Torques(limit), 5.0, &Leverage::default())
            .torque
    }

    #[test]
    fn a_force_beyond_its_limit_is_cut_with_its_feed_forward() {
        // The force is 10 N (3-4-5 triangle), its limit 5 N. All torques are within their limits.
        let asked = TorqueDemand {
            total: [1.0, 6.0 + 2.0, 8.0 + 1.0],
            gravity: [1.0, 0.0, 0.0],
            rendered: [0.0, 6.0, 8.0],
            force_squared: 100.0,
        };
        assert_eq!(
            *asked.granted_torques::<3>(&Torques([50.0; 3]), 5.0, &Leverage::default()).torque,
            [1.0, 3.0 + 1.0, 4.0 + 0.5]
        );
        assert_eq!(
            *asked.granted_torques::<3>(&Torques([50.0; 3]), 10.0, &Leverage::default()).torque,
            asked.total,
            "a force of 10 N is within a limit of 10 N"
        );
        let less = asked.granted_torques::<3>(&Torques([50.0, 50.0, 2.0]), 5.0, &Leverage::default()).torque;
        // The limit of 2 N m, less a 64th for the joint's feed-forward, over the demand of 8 N m.
        let share = (2.0 - 2.0 / 64.0) / 8.0;
        assert_eq!(
            less[..2],
            [1.0, 6.0 * share + 2.0 / 64.0 * 2.0],
            "a joint's limit may be stricter than the force limit"
        );
        for no_number in [f32::NAN, f32::INFINITY] {
            let asked = TorqueDemand { force_squared: no_number, ..asked };
            assert_eq!(
                *asked.granted_torques::<3>(&Torques([50.0; 3]), 5.0, &Leverage::default()).torque,
                [1.0, 0.0, 0.0],
                "only the weight is carried"
            );
        }
    }

    #[test]
    fn torques_within_the_limits_are_not_changed() {
        let torque = cut([0.1, 0.0, 0.0], [0.5, -0.5, 0.0], [0.2, 0.2, 0.1], [1.0; 3]);
        assert_eq!(torque, [0.1 + 0.5 + 0.2, -0.5 + 0.2, 0.1]);
    }

    #[test]
    fn a_force_too_large_keeps_its_direction() {
        let torque = cut([0.0; 3], [4.0, 1.0, -2.0], [0.0; 3], [2.0, 2.0, 0.5]);
        assert_eq!(torque, [1.0, 0.25, -0.5]);
    }

    #[test]
    fn gravity_comes_first_and_the_feed_forward_last() {
        let torque = cut([1.5, 0.0, 0.0], [1.0, 1.0, 0.0], [0.5, 1.0, 0.0], [2.0; 3]);
        // Gravity leaves 0.5 N m at joint 0, of which a 64th of the limit (2 N m) is reserved for the feed-forward.
        let room = 2.0 / 64.0;
        assert_eq!(torque, [2.0, 0.5 - room + room / 0.5, 0.0], "hardly any room is left for the feed-forward");
        let torque = cut([1.5, 0.0, 0.0], [1.0, 1.0, 0.0], [-0.5, 1.0, 0.0], [2.0; 3]);
        assert_eq!(torque, [1.75, 1.0, 0.0], "a force that fits is rendered in full");
    }

    /// Returns the next pseudorandom number from -1 to 1.
    fn random_number(nth: &mut u32) -> f32 {
        *nth = nth.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (*nth >> 8) as f32 / 8_388_608.0 - 1.0
    }

    #[test]
    fn torques_change_continuously_between_two_demands() {
        let limit = [1.0; 3];
        let mut nth = 7;
        let mut steepest = 0.0_f32;
        for _ in 0..300 {
            // Gravity uses nine tenths of each motor's limit. Rendered torques exceed the limits by far, and the
            // feed-forward crosses 0.
            let mut vector = |size: f32| -> [f32; 3] { core::array::from_fn(|_| size * random_number(&mut nth)) };
            let (gravity, from, to) = (vector(0.9), [vector(4.0), vector(1.0)], [vector(4.0), vector(1.0)]);
            let at = |share: f32| {
                let between = |k: usize| core::array::from_fn(|i| from[k][i] + share * (to[k][i] - from[k][i]));
                cut(gravity, between(0), between(1), limit)
            };
            let mut before = at(0.0);
            for step in 1..=20_000 {
                let now = at(step as f32 / 20_000.0);
                let jump = (0..3).fold(0.0_f32, |most, i| most.max((now[i] - before[i]).abs()));
                steepest = steepest.max(jump * 20_000.0);
                before = now;
            }
        }
        // A jump by a fiftieth of a limit would be 400.
        assert!(steepest < 400.0, "steepest slope {steepest} N m over the entire range");
    }

    #[test]
    fn numbers_that_are_not_finite_stay_within_the_limits() {
        let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX];
        for gravity in bad {
            for rendered in bad {
                for rest in bad {
                    let torque = cut([gravity, 0.1, 0.0], [rendered, 0.1, 0.0], [rest, 0.1, 0.0], [1.0; 3]);
                    assert!(torque.iter().all(|value| value.abs() <= 1.0), "{torque:?}");
                }
            }
        }
    }
}
