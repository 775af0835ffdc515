//! The step for several walls, or for walls together with springs and a host's plane, in the plane.

use super::super::Controller;
use super::super::guidance::SharedGuidance;
use super::super::stiffness::Stiffness;
use super::super::walls::{ContactPull, TOUCH_DEPTH, TOUCH_SHARE};
use super::{Start, task_part};
use crate::math::{Math, Real};
use crate::model::mechanism::Mechanism;
use crate::render::scene::MAX_WALLS;
use crate::render::step_result::{AtWalls, GuidanceDemand, StepResult, clear, put};
use heapless::Vec;
use nalgebra::SVector;

/// A contact whose force is shaped.
#[derive(Clone, Copy, Debug)]
struct StiffContact<T: Real, const N: usize> {
    normal: SVector<T, N>,
    pull: ContactPull<T>,
}

/// Contacts that can act together: walls, and the host's plane.
type StiffContacts<T, const N: usize> = Vec<StiffContact<T, N>, { MAX_WALLS + 1 }>;

/// Shaped part of the forces of springs and the host's plane.
#[derive(Clone, Copy, Debug)]
struct SharedPull<T: Real, const N: usize> {
    /// Force, N.
    force: SVector<T, N>,
    /// Largest depth at which one stiffness alone makes its shaped force, m, see [`TOUCH_SHARE`].
    reach: T,
    /// Stiffness of the springs, N/m.
    springs: Option<Stiffness<T>>,
    /// The host's plane, if it is touched.
    plane: Option<StiffContact<T, N>>,
}

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// Implements [`Controller::render`] for several walls in the plane, by the closed form and with α = 1.
    /// [`crate::model::principal`] has one level in the plane. With the stiffest direction e of the walls, the level's
    /// share s, the force F and its shaped part G, the torques are τ = s τ₄(e, e·G) + Jᵀ(F - e s e·G), τ₄ being
    /// equation (4).
    #[inline(never)]
    pub(in super::super) fn render_several(&mut self, counts: &[i32; N], result: &mut StepResult<T>) {
        let Some(start) = self.start(counts, result) else {
            return self.render_generally(counts, result);
        };
        let mut contacts = StiffContacts::new();
        let (mut shaped, mut reach, mut springs) = (SVector::<T, N>::zeros(), T::zero(), None);
        if self.guidance.adds_force {
            let shared = self.write_shared_guidance(&{ start }, &mut result.guidance);
            if let Some(SharedPull { force, reach: depth, springs: of_springs, plane }) = shared {
                (shaped, reach, springs) = (force, depth, of_springs);
                if let Some(plane) = plane {
                    let _ = contacts.push(plane);
                }
            }
        }
        let Start { pose, place, .. } = start;
        let debt = self.debt();
        let (mut at, mut deepest) = (AtWalls { distance: T::INFINITY, ..AtWalls::none() }, SVector::zeros());
        let mut force = SVector::<T, N>::zeros();
        for running in self.walls.all_walls() {
            let contact = running.surface().contact::<K, N>(&place);
            let velocity = running.step_low_pass(&self.coefficients, contact.distance);
            let effect = running.effect_at(contact.distance, velocity, debt.as_ref(), T::one());
            // Written so that NaN propagates and is detected.
            let shallower = contact.distance >= at.distance;
            if !shallower {
                (at.distance, at.normal_velocity, deepest) = (contact.distance, effect.velocity, contact.normal);
            }
            if !effect.is_touched {
                continue;
            }
            at.contacts += 1;
            at.wall_force += effect.force;
            at.passivity_damping += effect.passivity_damping;
            force += contact.normal * effect.force;
            if running.is_shaped() {
                shaped += contact.normal * effect.shaped;
                let pull = running.pull(contact.distance, effect.shaped);
                reach = reach.greater(pull.reach);
                let _ = contacts.push(StiffContact { normal: contact.normal, pull });
            }
        }
        if at.contacts > 0 {
            put(&self.mechanism.inverse(&pose, &deepest), &mut result.motion);
        } else {
            clear::<T, N>(&mut result.motion);
        }
        result.at.walls = at;
        let rendered = self.mechanism.transpose(&pose, &force);
        put(&rendered, &mut result.asked.rendered);
        result.asked.force_squared = force.dot(&force);
        let mut torque = rendered;
        if let Some((e, share)) = stiffest_direction::<T, K, N>(&contacts, springs, reach) {
            let along = e.dot(&shaped);
            torque -= self.mechanism.transpose(&pose, &e) * (share * along);
            torque += self.shaped_torque(&start, &e, along, None).torque * share;
        }
        if at.contacts > 0 {
            self.record_wall_torques(&torque, result)
        } else {
            self.record_no_contact()
        }
        self.write_total(&torque, || force, result);
    }

    /// Runs [`Controller::write_guidance`], and returns the part that is shaped together with the walls, if any.
    #[inline(never)]
    fn write_shared_guidance(
        &mut self,
        start: &Start<T, M::Pose, N>,
        guidance: &mut GuidanceDemand<T>,
    ) -> Option<SharedPull<T, N>> {
        let Start { pose, place, qd } = start;
        let (mut force, mut plain) = (self.guidance.push_force(), None);
        if self.guidance.is_active {
            let velocity = task_part::<T, M, N>(&self.mechanism.velocity(pose, qd));
            let (all, shared) = self.guidance.force_and_shared_part(place, &velocity);
            force += all;
            plain = shared.acts.then(|| self.shared_pull(place, &shared));
        }
        put(&force, &mut guidance.force);
        put(&self.mechanism.transpose(pose, &force), &mut guidance.torque);
        plain
    }

    /// Returns the forces of `shared` with their stiffness and depth.
    #[inline(always)]
    fn shared_pull(&self, place: &SVector<T, N>, shared: &SharedGuidance<T, N>) -> SharedPull<T, N> {
        let mut plain = SharedPull {
            force: shared.springs,
            reach: self.guidance.shared_depth(shared),
            springs: self.guidance.stiffness_in_plane(),
            plane: None,
        };
        if let Some((normal, depth, stiffness)) = self.guidance.touched_plane::<N>(place) {
            plain.force += normal * shared.plane;
            // The plane adds no depth here, because `shared_depth` already includes the plane.
            let pull = ContactPull { stiffness, has_feed_forward: false, depth, reach: T::zero() };
            plain.plane = Some(StiffContact { normal, pull });
        }
        plain
    }
}

/// Returns the stiffest direction of the contacts and springs, and the share of the force along it that is shaped.
/// Returns `None` if no contact has the feed-forward or all directions are equally stiff. `reach` is the largest depth
/// (m) at which one stiffness alone makes its shaped force, see [`TOUCH_SHARE`].
#[inline(always)]
fn stiffest_direction<T: Real, K: Math<T>, const N: usize>(
    contacts: &[StiffContact<T, N>],
    springs: Option<Stiffness<T>>,
    reach: T,
) -> Option<(SVector<T, N>, T)> {
    let full = T::one() / (reach * T::from_f64(TOUCH_SHARE)).greater(T::from_f64(TOUCH_DEPTH));
    // Total stiffness, and the stiffness of the contacts and springs without a feed-forward of their own.
    let mut all = springs.unwrap_or(Stiffness::none());
    let (mut plain, mut mixed) = (all, springs.is_some());
    for StiffContact { normal, pull } in contacts {
        let k = pull.stiffness * (pull.depth * full).lesser(T::one());
        all.add(normal[0], normal[1], k);
        if !pull.has_feed_forward {
            plain.add(normal[0], normal[1], k);
            mixed = true;
        }
    }
    let half = T::from_f64(0.5);
    let (mean, half_difference) = (half * (all.xx + all.yy), half * (all.xx - all.yy));
    let radius = K::sqrt(half_difference * half_difference + all.xy * all.xy);
    let with_feed_forward = if mixed { all.xx - plain.xx + (all.yy - plain.yy) } else { mean };
    if !(with_feed_forward > T::zero() && radius > mean * T::EPSILON) {
        return None;
    }
    // Half of the angle with the cosine half_difference/radius, computed from its larger part.
    let larger = K::sqrt(half + half * half_difference.abs() / radius);
    let smaller = half * all.xy / (radius * larger);
    let (x, y) = if half_difference >= T::zero() { (larger, smaller) } else { (smaller, larger) };
    let (stiffest, softest) = (mean + radius, mean - radius);
    let ratio = softest / stiffest;
    let mut share = (T::one() - ratio) * (T::one() + ratio);
    if mixed {
        share *= T::one() - plain.along(x, y) / stiffest;
    }
    let mut e = SVector::zeros();
    (e[0], e[1]) = (x, y);
    Some((e, share))
}
