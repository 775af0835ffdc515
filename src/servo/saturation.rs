//! What is left of the torques asked for where the motors cannot make them all.
//!
//! Limited joint by joint, a wall that is pressed beyond the motors would push less the deeper it is pressed, and
//! sideways. So the torques are cut in the order of what they are for (docs/model.md section 2):
//!
//! 1. what holds the device against gravity, each joint within its limit;
//! 2. what renders the forces asked for, Jᵀ f, all joints by one factor: the force keeps its direction, and is no larger
//!    than its own limit allows;
//! 3. the feed-forward, of the force that is really rendered and as far as the limits leave room, by one factor again.

use crate::math::{limited, newton_sqrt};
use crate::model::catalogue::MAX_JOINTS;

/// Joint torques of one control step by what they are for, N m.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Asked {
    /// All of them together.
    pub total: [f32; MAX_JOINTS],
    /// What holds the device against gravity.
    pub gravity: [f32; MAX_JOINTS],
    /// What renders the forces that walls, springs and fields ask for; the rest is the feed-forward.
    pub rendered: [f32; MAX_JOINTS],
    /// |f|², the square of those forces' resultant, N².
    pub force_squared: f32,
}

impl Asked {
    /// The torques within ±`limit` (N m, not negative) of each of the first `joints` joints, and of forces within
    /// `tip_force` (N).
    #[inline(always)]
    pub fn within(&self, limit: &[f32; MAX_JOINTS], tip_force: f32, joints: usize) -> [f32; MAX_JOINTS] {
        // A loop, because an iterator's `all` is not inlined on the chip and checks its index there.
        let mut fits = self.force_squared <= tip_force * tip_force;
        for (i, limit) in limit.iter().enumerate().take(joints) {
            let both = self.gravity[i] + self.rendered[i];
            fits &= self.gravity[i].abs() <= *limit && both.abs() <= *limit && self.total[i].abs() <= *limit;
        }
        if fits { self.total } else { self.cut(limit, tip_force, joints) }
    }

    /// The share of the forces asked for that is rendered within `tip_force` (N) and ±`limit` (N m) of each of the first
    /// `joints` joints.
    pub fn share(&self, limit: &[f32; MAX_JOINTS], tip_force: f32, joints: usize) -> f32 {
        let mut share = share_within(self.force_squared, tip_force);
        for (i, limit) in limit.iter().enumerate().take(joints) {
            share = room(limited(self.gravity[i], *limit), self.rendered[i], *limit, share);
        }
        share
    }

    #[cold]
    #[inline(never)]
    #[allow(clippy::needless_range_loop, reason = "one number for four arrays")]
    fn cut(&self, limit: &[f32; MAX_JOINTS], tip_force: f32, joints: usize) -> [f32; MAX_JOINTS] {
        let joints = joints.min(MAX_JOINTS);
        let share = self.share(limit, tip_force, joints);
        let mut torque = [0.0; MAX_JOINTS];
        for i in 0..joints {
            torque[i] = limited(self.gravity[i], limit[i]) + share * self.rendered[i];
        }
        let rest = |i: usize| self.total[i] - self.gravity[i] - self.rendered[i];
        let mut rest_share = share;
        for i in 0..joints {
            rest_share = room(torque[i], rest(i), limit[i], rest_share);
        }
        for i in 0..joints {
            // Once more each by itself: what is not finite asks for nothing, and rounding is no excuse.
            torque[i] = limited(torque[i] + rest_share * rest(i), limit[i]);
        }
        torque
    }
}

/// The share of a force that is within `most` (N), 1 where all of it is; none of what is no number.
fn share_within(squared: f32, most: f32) -> f32 {
    if squared <= most * most {
        1.0
    } else if squared.is_finite() {
        most / newton_sqrt(squared)
    } else {
        0.0
    }
}

/// The largest share, up to `most`, of `part` that fits on top of `base` within ±`limit`; none of what is no number.
fn room(base: f32, part: f32, limit: f32, most: f32) -> f32 {
    let left = if part > 0.0 { limit - base } else { limit + base };
    let size = part.abs();
    if size * most <= left {
        most
    } else if size > 0.0 && left > 0.0 {
        // At most `most`, because left < size · most.
        left / size
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cut(gravity: [f32; 3], rendered: [f32; 3], rest: [f32; 3], limit: [f32; 3]) -> [f32; 3] {
        let total = core::array::from_fn(|i| gravity[i] + rendered[i] + rest[i]);
        Asked { total, gravity, rendered, force_squared: 0.0 }.within(&limit, 5.0, 3)
    }

    #[test]
    fn a_force_beyond_its_limit_is_cut_to_it_and_the_feed_forward_with_it() {
        // 3-4-5: 10 N where 5 N may be, in torques that all fit.
        let asked = Asked {
            total: [1.0, 6.0 + 2.0, 8.0 + 1.0],
            gravity: [1.0, 0.0, 0.0],
            rendered: [0.0, 6.0, 8.0],
            force_squared: 100.0,
        };
        assert_eq!(asked.within(&[50.0; 3], 5.0, 3), [1.0, 3.0 + 1.0, 4.0 + 0.5]);
        assert_eq!(asked.within(&[50.0; 3], 10.0, 3), asked.total, "10 N are within 10 N");
        assert_eq!(asked.within(&[50.0, 50.0, 2.0], 5.0, 3)[..2], [1.0, 1.5], "a joint may leave less than the force");
        for no_number in [f32::NAN, f32::INFINITY] {
            let asked = Asked { force_squared: no_number, ..asked };
            assert_eq!(asked.within(&[50.0; 3], 5.0, 3), [1.0, 0.0, 0.0], "only what holds the device");
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
        assert_eq!(torque, [2.0, 0.5, 0.0], "no room is left for the feed-forward at joint 0");
        let torque = cut([1.5, 0.0, 0.0], [1.0, 1.0, 0.0], [-0.5, 1.0, 0.0], [2.0; 3]);
        assert_eq!(torque, [1.75, 1.0, 0.0], "its own part of what is rendered, where it fits");
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
