//! Cuts the torques asked for where the motors cannot make all of them.
//!
//! Limited joint by joint, a wall that is pressed beyond the motors would push less the deeper it is pressed, and
//! sideways. So the torques are cut in the order of what they are for (docs/model.md section 2):
//!
//! 1. what holds the device against gravity, each joint within its limit;
//! 2. what renders the forces asked for, Jᵀ f, all joints by one factor: the force keeps its direction, and is no larger
//!    than its own limit allows;
//! 3. the feed-forward, of the force that is really rendered and as far as the limits leave room, by one factor again:
//!    what it pushes aside at the tip counts towards the force's limit as well.
//!
//! A motor whose limit the force uses up leaves no room for the least feed-forward that points the same way, and full
//! room for the other way: the common factor would jump from 0 to 1 where that motor's own part passes zero. So the
//! force leaves a motor's own part its room up to [`ROOM`] of the limit.

use super::ControlLoop;
use crate::control::joints::Torques;
use crate::control::program::Program;
use crate::drive::bits::margin_bits;
use crate::drive::stage::Stage;
use crate::math::{Math, limited, sqrt};
use crate::model::catalogue::MAX_JOINTS;
use crate::model::device::{Leverage, squared};
use crate::render::step_result::TorqueDemand;
use core::ops::DerefMut;

/// Share of a joint's limit that what is rendered leaves to the feed-forward where that points the same way.
const ROOM: f32 = 1.0 / 64.0;

/// The torques that the limits allow of a demand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Granted {
    /// All torques together.
    pub torque: Torques,
    /// The part of them that holds the device against gravity.
    pub gravity: Torques,
    /// The share of the forces asked for that is rendered.
    pub share: f32,
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Not negative if the demand of the step on the J joints is some roundings within their limits, step by step of
    /// the order above, and its forces within theirs. Negative if it may not be, and for NaN.
    #[inline(always)]
    pub(super) fn fits<const J: usize>(&self) -> i32 {
        let TorqueDemand { total, gravity, rendered, force_squared } = &self.now.found.asked;
        let mut least = margin_bits(*force_squared, self.most_force_squared);
        let mut pushing = *total;
        if self.weighs {
            pushing.iter_mut().zip(gravity).take(J).for_each(|(total, gravity)| *total -= gravity);
        }
        least |= margin_bits(squared(&self.leverage.force::<J>(&pushing)), self.most_force_squared);
        if self.weighs {
            for (i, fitting) in self.fitting.iter().enumerate().take(J) {
                // If weight and force together fit whatever their signs, each of them does, and their sum.
                let both = gravity[i].abs() + rendered[i].abs();
                least |= margin_bits(total[i], *fitting) | margin_bits(both, *fitting);
            }
        } else {
            for (i, fitting) in self.fitting.iter().enumerate().take(J) {
                least |= margin_bits(total[i], *fitting) | margin_bits(rendered[i], *fitting);
            }
        }
        least
    }
}

impl TorqueDemand<f32> {
    /// The torques within ±`limit` (not negative) of each of the J joints, and within `tip_force` (N, not negative) by
    /// `leverage`, which gives the force of each torque.
    #[inline(always)]
    pub(super) fn within<const J: usize>(&self, limit: &Torques, tip_force: f32, leverage: &Leverage) -> Granted {
        let pushing = core::array::from_fn(|i| self.total[i] - self.gravity[i]);
        let mut least = margin_bits(self.force_squared, tip_force * tip_force);
        least |= margin_bits(squared(&leverage.force::<J>(&pushing)), tip_force * tip_force);
        for (i, limit) in limit.iter().enumerate().take(J) {
            let both = self.gravity[i] + self.rendered[i];
            least |=
                margin_bits(self.gravity[i], *limit) | margin_bits(both, *limit) | margin_bits(self.total[i], *limit);
        }
        if least >= 0 {
            Granted { torque: Torques(self.total), gravity: Torques(self.gravity), share: 1.0 }
        } else {
            self.cut::<J>(limit, tip_force, leverage)
        }
    }

    /// The share of the forces asked for that is rendered within `tip_force` (N) and ±`limit` of each of the J joints.
    #[inline(always)]
    fn share<const J: usize>(&self, limit: &Torques, tip_force: f32) -> f32 {
        let mut share = share_within(self.force_squared, tip_force);
        for (i, limit) in limit.iter().enumerate().take(J) {
            share = self.room_for_the_rendered(i, *limit, share);
        }
        share
    }

    /// The largest share, up to `most`, of what is rendered that joint `i` makes within ±`limit` on top of gravity and
    /// below the room of its feed-forward.
    #[inline(always)]
    fn room_for_the_rendered(&self, i: usize, limit: f32, most: f32) -> f32 {
        let (base, part) = (limited(self.gravity[i], limit), self.rendered[i]);
        let along = if part > 0.0 { self.rest(i) } else { -self.rest(i) };
        if along > 0.0 {
            // All of both, or the force up to the feed-forward's room.
            let both = room(base, part + self.rest(i), limit, most);
            let alone = room(base, part, limit - ROOM * limit, most);
            if both > alone { both } else { alone }
        } else {
            room(base, part, limit, most)
        }
    }

    /// The demand on joint `i` beyond gravity and rendered forces: the feed-forward.
    fn rest(&self, i: usize) -> f32 {
        self.total[i] - self.gravity[i] - self.rendered[i]
    }

    /// The same of all joints.
    #[inline(always)]
    fn rests(&self) -> [f32; MAX_JOINTS] {
        core::array::from_fn(|i| self.rest(i))
    }

    #[allow(clippy::needless_range_loop, reason = "one number for four arrays")]
    #[inline(always)]
    fn cut<const J: usize>(&self, limit: &Torques, tip_force: f32, leverage: &Leverage) -> Granted {
        let share = self.share::<J>(limit, tip_force);
        let (mut torque, mut gravity) = (Torques::default(), Torques::default());
        for i in 0..J {
            gravity[i] = limited(self.gravity[i], limit[i]);
            torque[i] = gravity[i] + share * self.rendered[i];
        }
        let (force, aside) = (leverage.force::<J>(&self.rendered), leverage.force::<J>(&self.rests()));
        let mut rest_share = room_aside(&force.map(|along| share * along), &aside, tip_force, share);
        for i in 0..J {
            rest_share = room(torque[i], self.rest(i), limit[i], rest_share);
        }
        for i in 0..J {
            // Once more each by itself: what is not finite asks for nothing, and rounding is no excuse.
            torque[i] = limited(torque[i] + rest_share * self.rest(i), limit[i]);
        }
        Granted { torque, gravity, share }
    }
}

/// By how much a force, given by its square (N²), is multiplied so that it is at most `most` (N): by 1 where it is
/// within that, by 0 where it is not finite.
pub(super) fn share_within(squared: f32, most: f32) -> f32 {
    if squared <= most * most {
        1.0
    } else if squared.is_finite() {
        most / sqrt(squared)
    } else {
        0.0
    }
}

/// The largest share, up to `most`, of `part` that fits on top of `base` within ±`limit`; 0 if `part` is NaN.
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

/// The largest share s, up to `share`, of the force `aside` with which it and `force` (N) are together within `most`
/// (N), |force + s aside| ≤ most; 0 for NaN.
#[inline(always)]
fn room_aside<const N: usize>(force: &[f32; N], aside: &[f32; N], most: f32, share: f32) -> f32 {
    let (a, room) = (squared(aside), most * most - squared(force));
    // A force that is at its limit may round to more.
    let room = if room < 0.0 { 0.0 } else { room };
    let b = (0..N).fold(0.0, |sum, i| sum + force[i] * aside[i]);
    if a * share * share + 2.0 * b * share <= room {
        return share;
    }
    // The positive root of a s² + 2 b s = room, without a difference of what is nearly the same.
    let root = sqrt(b * b + a * room);
    let found = if b > 0.0 { room / (b + root) } else { (root - b) / a };
    if found > 0.0 && found < share { found } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut(gravity: [f32; 3], rendered: [f32; 3], rest: [f32; 3], limit: [f32; 3]) -> [f32; 3] {
        let total = core::array::from_fn(|i| gravity[i] + rendered[i] + rest[i]);
        *TorqueDemand { total, gravity, rendered, force_squared: 0.0 }
            .within::<3>(&Torques(limit), 5.0, &Leverage::default())
            .torque
    }

    #[test]
    fn a_force_beyond_its_limit_is_cut_to_it_and_the_feed_forward_with_it() {
        // 3-4-5: 10 N where 5 N may be, in torques that all fit.
        let asked = TorqueDemand {
            total: [1.0, 6.0 + 2.0, 8.0 + 1.0],
            gravity: [1.0, 0.0, 0.0],
            rendered: [0.0, 6.0, 8.0],
            force_squared: 100.0,
        };
        assert_eq!(
            *asked.within::<3>(&Torques([50.0; 3]), 5.0, &Leverage::default()).torque,
            [1.0, 3.0 + 1.0, 4.0 + 0.5]
        );
        assert_eq!(
            *asked.within::<3>(&Torques([50.0; 3]), 10.0, &Leverage::default()).torque,
            asked.total,
            "10 N are within 10 N"
        );
        let less = asked.within::<3>(&Torques([50.0, 50.0, 2.0]), 5.0, &Leverage::default()).torque;
        // 2 N m less a 64th for that joint's own feed-forward, of 8.
        let share = (2.0 - 2.0 / 64.0) / 8.0;
        assert_eq!(less[..2], [1.0, 6.0 * share + 2.0 / 64.0 * 2.0], "a joint may leave less than the force");
        for no_number in [f32::NAN, f32::INFINITY] {
            let asked = TorqueDemand { force_squared: no_number, ..asked };
            assert_eq!(
                *asked.within::<3>(&Torques([50.0; 3]), 5.0, &Leverage::default()).torque,
                [1.0, 0.0, 0.0],
                "only what holds the device"
            );
        }
    }

    #[test]
    fn what_fits_is_left_alone() {
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
        // 0.5 N m are left at joint 0, a 64th of its 2 N m of them for the feed-forward's 0.5 N m.
        let room = 2.0 / 64.0;
        assert_eq!(torque, [2.0, 0.5 - room + room / 0.5, 0.0], "hardly any room is left for the feed-forward");
        let torque = cut([1.5, 0.0, 0.0], [1.0, 1.0, 0.0], [-0.5, 1.0, 0.0], [2.0; 3]);
        assert_eq!(torque, [1.75, 1.0, 0.0], "its own part of what is rendered, where it fits");
    }

    /// A number from -1 to 1 that the `nth` draw of a sequence gives.
    fn drawn(nth: &mut u32) -> f32 {
        *nth = nth.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (*nth >> 8) as f32 / 8_388_608.0 - 1.0
    }

    #[test]
    fn nothing_steps_on_the_way_from_any_torques_to_any_others() {
        let limit = [1.0; 3];
        let mut nth = 7;
        let mut steepest = 0.0_f32;
        for _ in 0..300 {
            // Gravity leaves a tenth of each motor; what is rendered is far beyond the limits, and what is on top of it
            // goes through 0 somewhere.
            let mut vector = |size: f32| -> [f32; 3] { core::array::from_fn(|_| size * drawn(&mut nth)) };
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
        // A step of a fiftieth of a limit would be 400.
        assert!(steepest < 400.0, "{steepest} N m from one end to the other");
    }

    #[test]
    fn what_is_no_number_asks_for_nothing() {
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
