//! The step of a scene with a single wall, or no wall.

use super::super::Controller;
use super::Start;
use crate::math::{Math, Real};
use crate::model::mechanism::{Mechanism, ShapedTorque};
use crate::render::scene::FeedForward;
use crate::render::step_result::{AtWalls, StepResult, clear, put};
use nalgebra::SVector;

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// Implements [`Controller::render`] for one wall, by the closed form and with α = 1, or for no wall.
    /// Writes values as soon as they are known and computes equation (4) last, so that few values are live at a time.
    #[inline(never)]
    pub(in super::super) fn render_wall(&mut self, counts: &[i32; N], result: &mut StepResult<T>) {
        self.render_single::<false>(counts, result);
    }

    /// Implements [`Controller::render_wall`] or, with `ROUND`, [`Controller::render_round`].
    #[inline(always)]
    pub(super) fn render_single<const ROUND: bool>(&mut self, counts: &[i32; N], result: &mut StepResult<T>) {
        let Some(start) = self.start(counts, result) else {
            return self.render_generally(counts, result);
        };
        if self.guidance.adds_force {
            // Passes a copy, so that the usual case can keep the value in registers.
            self.write_guidance(&{ start }, &mut result.guidance);
        }
        let Start { pose, place, .. } = start;
        let debt = self.debt();
        let Some(running) = self.walls.single_wall() else {
            result.at.walls = AtWalls::none();
            return self.write_untouched(result);
        };
        let (contact, curvature) = if ROUND {
            running.surface().contact_and_curvature::<K, N>(&place)
        } else {
            (running.surface().contact::<K, N>(&place), T::zero())
        };
        let velocity = running.step_low_pass(&self.coefficients, contact.distance);
        let effect = running.effect_at(contact.distance, velocity, debt.as_ref(), T::one());
        result.at.walls = AtWalls {
            contacts: u8::from(effect.is_touched),
            distance: contact.distance,
            normal_velocity: effect.velocity,
            wall_force: effect.force,
            shaping: T::one(),
            energy: T::zero(),
            passivity_damping: effect.passivity_damping,
        };
        if !effect.is_touched {
            return self.write_untouched(result);
        }
        let (feed_forward, force) = (running.feed_forward(), effect.force);
        // All forces are along the normal, so one row of J converts every force through Jᵀ.
        let row = self.mechanism.transpose(&pose, &contact.normal);
        let rendered = row * force;
        put(&rendered, &mut result.asked.rendered);
        result.asked.force_squared = force * force;
        if !ROUND && feed_forward == FeedForward::Off {
            put(&self.mechanism.inverse(&pose, &contact.normal), &mut result.motion);
            self.record_wall_torques(&rendered, result);
            return self.write_total(&rendered, || contact.normal * force, result);
        }
        let ShapedTorque { e, mut torque } = if ROUND {
            self.shaped_torque_of_round_wall(&start, &contact.normal, effect.shaped, curvature)
        } else {
            self.shaped_torque(&start, &contact.normal, effect.shaped, Some(0))
        };
        // The rest of the force is zero if the complete force is shaped.
        torque += row * (force - effect.shaped);
        self.record_wall_torques(&torque, result);
        put(&e, &mut result.motion);
        self.write_total(&torque, || contact.normal * force, result);
    }

    #[inline(always)]
    fn write_untouched(&mut self, result: &mut StepResult<T>) {
        self.record_no_contact();
        clear::<T, N>(&mut result.motion);
        clear::<T, N>(&mut result.asked.rendered);
        result.asked.force_squared = T::zero();
        self.write_total(&SVector::zeros(), SVector::zeros, result);
    }
}
