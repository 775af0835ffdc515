//! The step of a scene of several walls, or of walls beside springs and a host's plane, on a device with two joints that
//! moves in the plane.

use super::super::Controller;
use super::super::guidance::Beside;
use super::super::stiffness::Stiffness;
use super::super::walls::{Pulled, TOUCH_DEPTH, TOUCH_SHARE};
use super::{Started, task_part};
use crate::math::{Math, Real};
use crate::model::mechanism::Mechanism;
use crate::render::scene::MAX_WALLS;
use crate::render::step_result::{AtWalls, Guided, StepResult, clear, put};
use heapless::Vec;
use nalgebra::SVector;

/// A contact whose force is shaped.
#[derive(Clone, Copy, Debug)]
struct Stiff<T: Real, const N: usize> {
    normal: SVector<T, N>,
    pulled: Pulled<T>,
}

/// As many as can act together: walls, and the host's plane.
type Stiffs<T, const N: usize> = Vec<Stiff<T, N>, { MAX_WALLS + 1 }>;

/// The shaped part of the forces beside the walls.
#[derive(Clone, Copy, Debug)]
struct Plain<T: Real, const N: usize> {
    /// N
    force: SVector<T, N>,
    /// See [`TOUCH_SHARE`], m.
    reach: T,
    /// The springs, N/m.
    springs: Option<Stiffness<T>>,
    /// The host's plane, where it is touched.
    plane: Option<Stiff<T, N>>,
}

impl<T: Real, M: Mechanism<T, N>, K: Math<T>, const N: usize> Controller<T, M, K, N> {
    /// [`Controller::render`] for several walls, by the closed form and with α = 1, in the plane.
    ///
    /// There [`crate::model::principal`] has one level. With the stiffest direction e of the walls, the level's share s, and
    /// the force F, of which the part G is shaped, τ = s (4)(e, e·G) + Jᵀ(F - e s e·G).
    #[inline(never)]
    pub(in super::super) fn render_several(&mut self, counts: &[i32; N], found: &mut StepResult<T>) {
        let Some(started) = self.start(counts, found) else {
            return self.render_generally(counts, found);
        };
        let mut stiff = Stiffs::new();
        let (mut shaped, mut reach, mut springs) = (SVector::<T, N>::zeros(), T::zero(), None);
        if self.guidance.adds {
            let beside = self.guide_beside(&{ started }, &mut found.guided);
            if let Some(Plain { force, reach: depth, springs: of_springs, plane }) = beside {
                (shaped, reach, springs) = (force, depth, of_springs);
                if let Some(plane) = plane {
                    let _ = stiff.push(plane);
                }
            }
        }
        let Started { pose, place, .. } = started;
        let debt = self.debt();
        let (mut at, mut deepest) = (AtWalls { distance: T::INFINITY, ..AtWalls::none() }, SVector::zeros());
        let mut force = SVector::<T, N>::zeros();
        for running in self.walls.all() {
            let contact = running.surface().contact::<K, N>(&place);
            let velocity = running.pass(&self.coefficients, contact.distance);
            let pressed = running.press(contact.distance, velocity, debt.as_ref(), T::one());
            // Written so that what is not a number stays one, and is found out.
            let shallower = contact.distance >= at.distance;
            if !shallower {
                (at.distance, at.normal_velocity, deepest) = (contact.distance, pressed.velocity, contact.normal);
            }
            if !pressed.touched {
                continue;
            }
            at.contacts += 1;
            at.wall_force += pressed.force;
            at.passivity_damping += pressed.passivity_damping;
            force += contact.normal * pressed.force;
            if running.is_shaped() {
                shaped += contact.normal * pressed.shaped;
                let pulled = running.pull(contact.distance, pressed.shaped);
                reach = reach.greater(pulled.reach);
                let _ = stiff.push(Stiff { normal: contact.normal, pulled });
            }
        }
        if at.contacts > 0 {
            put(&self.mechanism.inverse(&pose, &deepest), &mut found.motion);
        } else {
            clear::<T, N>(&mut found.motion);
        }
        found.at.walls = at;
        let rendered = self.mechanism.transpose(&pose, &force);
        put(&rendered, &mut found.asked.rendered);
        found.asked.force_squared = force.dot(&force);
        let mut torque = rendered;
        if let Some((e, share)) = stiffest::<T, K, N>(&stiff, springs, reach) {
            let along = e.dot(&shaped);
            torque -= self.mechanism.transpose(&pose, &e) * (share * along);
            torque += self.shaped(&started, &e, along, None).torque * share;
        }
        if at.contacts > 0 {
            self.hold(&torque, found)
        } else {
            self.leave()
        }
        self.total(&torque, || force, found);
    }

    /// [`Controller::guide`], and what of that is shaped with the walls; nothing where none of it is.
    #[inline(never)]
    fn guide_beside(&mut self, started: &Started<T, M::Pose, N>, guided: &mut Guided<T>) -> Option<Plain<T, N>> {
        let Started { pose, place, qd } = started;
        let (mut force, mut plain) = (self.guidance.pushing(), None);
        if self.guidance.any {
            let velocity = task_part::<T, M, N>(&self.mechanism.velocity(pose, qd));
            let (all, beside) = self.guidance.force_and_beside(place, &velocity);
            force += all;
            plain = beside.acts.then(|| self.plain(place, &beside));
        }
        put(&force, &mut guided.force);
        put(&self.mechanism.transpose(pose, &force), &mut guided.torque);
        plain
    }

    /// The part of `beside` that acts.
    #[inline(always)]
    fn plain(&self, place: &SVector<T, N>, beside: &Beside<T, N>) -> Plain<T, N> {
        let mut plain = Plain {
            force: beside.springs,
            reach: self.guidance.reach(beside),
            springs: self.guidance.in_plane(),
            plane: None,
        };
        if let Some((normal, depth, stiffness)) = self.guidance.touched_plane::<N>(place) {
            plain.force += normal * beside.plane;
            // The depth by its force is already in the reach.
            let pulled = Pulled { stiffness, own: false, depth, reach: T::zero() };
            plain.plane = Some(Stiff { normal, pulled });
        }
        plain
    }
}

/// The stiffest direction of these contacts and its level's share; none where nothing has the feed-forward, or no direction
/// is stiffer than another. `reach`: see [`TOUCH_SHARE`], m.
#[inline(always)]
fn stiffest<T: Real, K: Math<T>, const N: usize>(
    stiff: &[Stiff<T, N>],
    springs: Option<Stiffness<T>>,
    reach: T,
) -> Option<(SVector<T, N>, T)> {
    let full = T::one() / (reach * T::from_f64(TOUCH_SHARE)).greater(T::from_f64(TOUCH_DEPTH));
    // The total stiffness, and that of the parts without a feed-forward of their own, of which most scenes have none.
    let mut all = springs.unwrap_or(Stiffness::none());
    let (mut plain, mut mixed) = (all, springs.is_some());
    for Stiff { normal, pulled } in stiff {
        let k = pulled.stiffness * (pulled.depth * full).lesser(T::one());
        all.add(normal[0], normal[1], k);
        if !pulled.own {
            plain.add(normal[0], normal[1], k);
            mixed = true;
        }
    }
    let half = T::from_f64(0.5);
    let (mean, apart) = (half * (all.xx + all.yy), half * (all.xx - all.yy));
    let radius = K::sqrt(apart * apart + all.xy * all.xy);
    let of_its_own = if mixed { all.xx - plain.xx + (all.yy - plain.yy) } else { mean };
    if !(of_its_own > T::zero() && radius > mean * T::EPSILON) {
        return None;
    }
    // Half of the angle whose cosine is apart/radius, from its larger part.
    let larger = K::sqrt(half + half * apart.abs() / radius);
    let smaller = half * all.xy / (radius * larger);
    let (x, y) = if apart >= T::zero() { (larger, smaller) } else { (smaller, larger) };
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
