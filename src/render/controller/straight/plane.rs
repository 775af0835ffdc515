//! The step of a scene that is one plane.

use super::super::{Controller, FULL_REGULARITY, PARALLEL_REGULARITY, fade, task_part};
use crate::math::{Math, Real};
use crate::model::inertia::shaped_torque_beside;
use crate::model::mechanism::Mechanism;
use crate::render::controller::guidance::Beside;
use crate::render::controller::walls::Active;
use crate::render::found::{AtWalls, Found, put};
use crate::render::scene::shape::Shape;
use crate::render::scene::{FeedForward, Surface, VelocityTerms};
use nalgebra::SVector;

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// [`Controller::render`] for one plane, the closed form and α = 1, with the force that a host may add; false, and
    /// nothing done, where the scene is another.
    #[inline(always)]
    pub(in super::super) fn render_a_plane(&mut self, counts: &[i32; N], found: &mut Found<T>) -> bool {
        let Some((running, passivity)) = self.walls.lone() else { return false };
        let Surface::Plane(plane) = *running.surface() else { return false };
        let (q, turned) = self.encoders.angles(counts);
        put(&q, &mut found.at.q);
        let qd = self.encoders.velocities(&self.coefficients, counts);
        put(&qd, &mut found.at.qd);
        let pose = self.mechanism.pose::<K>(&turned);
        let tip = self.mechanism.tip(&pose);
        put(&tip, &mut found.at.tip);
        let place = task_part::<T, M, N>(&tip);
        let regularity = self.mechanism.regularity(&pose);
        found.regularity = regularity;

        let contact = plane.contact::<K, N>(&place);
        let pressed = running.press(&self.coefficients, &contact, None, passivity, T::one());
        found.at.walls = AtWalls {
            contacts: u8::from(pressed.touched),
            distance: contact.distance,
            normal_velocity: pressed.velocity,
            wall_force: pressed.force,
            shaping: T::one(),
            energy: if pressed.touched { running.energy() } else { T::zero() },
            passivity_damping: pressed.passivity_damping,
        };
        let (mut torque, mut rendered) = (SVector::zeros(), SVector::zeros());
        let (mut force, mut motion) = (SVector::zeros(), SVector::zeros());
        if pressed.touched {
            motion = self.mechanism.inverse(&pose, &contact.normal);
            let feed_forward = running.feed_forward();
            // In full nothing is left for Jᵀ alone.
            let mut straight = feed_forward != FeedForward::Full;
            let shaped = contact.normal * pressed.shaped;
            let mut plain = contact.normal * (pressed.force - pressed.shaped);
            force = if straight { plain + shaped } else { shaped };
            rendered = self.mechanism.transpose(&pose, &force);
            if feed_forward == FeedForward::Off {
                torque = rendered;
            } else {
                let parallel = regularity.parallel * T::from_f64(1.0 / PARALLEL_REGULARITY);
                let near = regularity.serial.lesser(parallel);
                if near >= T::from_f64(FULL_REGULARITY) {
                    let shaping = self.mechanism.shaping(&pose, &contact.normal);
                    torque = if self.biased {
                        let qd = self.encoders.certain(&qd);
                        let mut b = self.mechanism.velocity_torque(&pose, &qd);
                        b *= self.known(&pose, &qd);
                        let met = if self.velocity_terms == VelocityTerms::Paper { b } else { SVector::zeros() };
                        shaped_torque_beside(&shaping, pressed.shaped, &b, &met)
                    } else {
                        shaping.me * (pressed.shaped / shaping.w_rr)
                    };
                } else {
                    // Copies, so that the usual case need not keep these in memory.
                    let (pose, place, qd, turned) = (pose, place, qd, turned);
                    let first = Active { wall: 0, normal: contact.normal, shaped: pressed.shaped };
                    let share = fade(near);
                    let beside = Beside::none();
                    let left;
                    (torque, left) =
                        self.shaped_by_several(&turned, &pose, &place, &qd, &first, &[], &beside, &shaped, share);
                    found.at.walls.shaping = share;
                    plain += left;
                    straight = true;
                }
                if straight {
                    torque += self.mechanism.transpose(&pose, &plain);
                }
            }
        }
        put(&motion, &mut found.motion);
        put(&rendered, &mut found.asked.rendered);
        found.asked.force_squared = force.dot(&force);
        self.ask(&pose, torque, &mut found.asked);
        self.push_as_well(&pose, &force, &mut found.asked);
        true
    }
}
