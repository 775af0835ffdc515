//! The step of a scene that is one wall, or none.

use super::super::Controller;
use super::Started;
use crate::math::{Math, Real};
use crate::model::mechanism::{Mechanism, Shaped};
use crate::render::scene::FeedForward;
use crate::render::step_result::{AtWalls, StepResult, clear, put};
use nalgebra::SVector;

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// [`Controller::render`] for one wall, by the closed form and with α = 1, or for none.
    ///
    /// Known values are written at once, and equation (4) comes last: so few numbers have to be kept on the way.
    #[inline(never)]
    pub(in super::super) fn render_wall(&mut self, counts: &[i32; N], found: &mut StepResult<T>) {
        self.render_single::<false>(counts, found);
    }

    /// The same; `ROUND` as [`Controller::render_round`] has it.
    #[inline(always)]
    pub(super) fn render_single<const ROUND: bool>(&mut self, counts: &[i32; N], found: &mut StepResult<T>) {
        let Some(started) = self.start(counts, found) else {
            return self.render_generally(counts, found);
        };
        if self.guidance.adds {
            // A copy, so that the usual case need not keep it in memory.
            self.guide(&{ started }, &mut found.guided);
        }
        let Started { pose, place, .. } = started;
        let debt = self.debt();
        let Some(running) = self.walls.single() else {
            found.at.walls = AtWalls::none();
            return self.untouched(found);
        };
        let (contact, curvature) = if ROUND {
            running.surface().bent_contact::<K, N>(&place)
        } else {
            (running.surface().contact::<K, N>(&place), T::zero())
        };
        let velocity = running.pass(&self.coefficients, contact.distance);
        let pressed = running.press(contact.distance, velocity, debt.as_ref(), T::one());
        found.at.walls = AtWalls {
            contacts: u8::from(pressed.touched),
            distance: contact.distance,
            normal_velocity: pressed.velocity,
            wall_force: pressed.force,
            shaping: T::one(),
            energy: T::zero(),
            passivity_damping: pressed.passivity_damping,
        };
        if !pressed.touched {
            return self.untouched(found);
        }
        let (feed_forward, force) = (running.feed_forward(), pressed.force);
        // Everything is along the normal: one row of J makes torques of all that goes through Jᵀ.
        let row = self.mechanism.transpose(&pose, &contact.normal);
        let rendered = row * force;
        put(&rendered, &mut found.asked.rendered);
        found.asked.force_squared = force * force;
        if !ROUND && feed_forward == FeedForward::Off {
            put(&self.mechanism.inverse(&pose, &contact.normal), &mut found.motion);
            self.hold(&rendered, found);
            return self.total(&rendered, || contact.normal * force, found);
        }
        let Shaped { e, mut torque } = if ROUND {
            self.shaped_round(&started, &contact.normal, pressed.shaped, curvature)
        } else {
            self.shaped(&started, &contact.normal, pressed.shaped, Some(0))
        };
        // Adds zero if the whole force is shaped.
        torque += row * (force - pressed.shaped);
        self.hold(&torque, found);
        put(&e, &mut found.motion);
        self.total(&torque, || contact.normal * force, found);
    }

    /// Writes the result of a step that touches no wall.
    #[inline(always)]
    fn untouched(&mut self, found: &mut StepResult<T>) {
        self.leave();
        clear::<T, N>(&mut found.motion);
        clear::<T, N>(&mut found.asked.rendered);
        found.asked.force_squared = T::zero();
        self.total(&SVector::zeros(), SVector::zeros, found);
    }
}
