//! The step of a scene that is one plane.

use super::super::{Controller, FULL_REGULARITY, PARALLEL_REGULARITY, Step, fade, task_part};
use crate::math::{Math, Real};
use crate::model::inertia::shaped_torque_beside;
use crate::model::mechanism::Mechanism;
use crate::render::controller::guidance::Beside;
use crate::render::controller::walls::Active;
use crate::render::scene::shape::Shape;
use crate::render::scene::{FeedForward, Surface, VelocityTerms};
use nalgebra::SVector;

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// [`Controller::step`] for one plane, the closed form and α = 1; `None` where the scene is another.
    #[inline(always)]
    pub(in super::super) fn step_at_a_plane(&mut self, counts: &[i32; N]) -> Option<Step<T, N>> {
        let (running, passivity) = self.walls.lone()?;
        let Surface::Plane(plane) = *running.surface() else { return None };
        let (q, turned) = self.encoders.angles(counts);
        let qd = self.encoders.velocities(&self.coefficients, counts);
        let pose = self.mechanism.pose::<K>(&turned);
        let tip = self.mechanism.tip(&pose);
        let place = task_part::<T, M, N>(&tip);
        let regularity = self.mechanism.regularity(&pose);

        let contact = plane.contact::<K, N>(&place);
        let pressed = running.press(&self.coefficients, &contact, None, passivity, T::one());
        let (energy, feed_forward) = (running.energy(), running.feed_forward());
        let mut step = Step {
            q,
            qd,
            tip,
            torque: SVector::zeros(),
            gravity: SVector::zeros(),
            rendered: SVector::zeros(),
            force_squared: T::zero(),
            distance: contact.distance,
            normal_velocity: pressed.velocity,
            wall_force: pressed.force,
            motion: SVector::zeros(),
            contacts: u8::from(pressed.touched),
            energy: T::zero(),
            passivity_damping: pressed.passivity_damping,
            shaping: T::one(),
            regularity,
        };
        if pressed.touched {
            step.energy = energy;
            // In full nothing is left for Jᵀ alone.
            let mut straight = feed_forward != FeedForward::Full;
            let shaped = contact.normal * pressed.shaped;
            let mut plain = contact.normal * (pressed.force - pressed.shaped);
            let force = if straight { plain + shaped } else { shaped };
            step.force_squared = force.dot(&force);
            step.rendered = self.mechanism.transpose(&pose, &force);
            step.motion = self.mechanism.inverse(&pose, &contact.normal);
            if feed_forward == FeedForward::Off {
                step.torque = step.rendered;
            } else {
                let parallel = regularity.parallel * T::from_f64(1.0 / PARALLEL_REGULARITY);
                let near = regularity.serial.lesser(parallel);
                if near >= T::from_f64(FULL_REGULARITY) {
                    let shaping = self.mechanism.shaping(&pose, &contact.normal);
                    step.torque = if self.biased {
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
                    let left;
                    (step.torque, left) = self.shaped_by_several(
                        &turned,
                        &pose,
                        &place,
                        &qd,
                        &first,
                        &[],
                        &Beside::none(),
                        &shaped,
                        share,
                    );
                    step.shaping = share;
                    plain += left;
                    straight = true;
                }
                if straight {
                    step.torque += self.mechanism.transpose(&pose, &plain);
                }
            }
        }
        if self.gravity {
            step.gravity = self.mechanism.gravity(&pose);
            step.torque += step.gravity;
        }
        Some(step)
    }
}
