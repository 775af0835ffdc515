//! Springs, fields, and the host's force and plane.
//!
//! The forces go through Jᵀ. If a wall with the feed-forward is touched, springs and the host's plane go through the
//! levels of [`crate::model::principal`] together with the wall, like walls without the feed-forward (docs/model.md
//! section 2).

use super::push::{Push, PushedPlane};
use super::stiffness::Stiffness;
use super::walls::depth_of;
use crate::math::Real;
use crate::model::principal::Pull;
use crate::render::scene::{FeedForward, MAX_SPRINGS, Scene, Spring, task_vector};
use crate::render::velocity::Washout;
use heapless::Vec;
use nalgebra::SVector;

/// The run-time form of springs, fields, and the host's force and plane.
#[derive(Clone, Debug)]
pub(super) struct Guidance<T: Real> {
    springs: Vec<Spring<T>, MAX_SPRINGS>,
    field_damping: T,
    push: Option<Push<T>>,
    /// True if there is a spring, a field or a plane of the host.
    pub is_active: bool,
    /// True if the host pushes.
    pub is_pushed: bool,
    /// True if `is_active` or `is_pushed`.
    pub adds_force: bool,
    /// Feed-forward of springs and plane together with walls; [`FeedForward::Off`] if no wall has a feed-forward.
    shared_feed_forward: FeedForward,
    /// Total stiffness matrix of the springs in the plane, N/m.
    in_plane: Stiffness<T>,
    /// Sum of the springs' stiffnesses, N/m.
    stiffness: T,
    /// Washouts of the plane's force and of the springs' force.
    washouts: [Washout<T>; 4],
}

/// The force of springs and plane in so far as they act together with walls that have the feed-forward.
#[derive(Clone, Copy, Debug)]
pub(super) struct SharedGuidance<T, const N: usize> {
    /// True if a spring or the plane is stiff and acts.
    pub acts: bool,
    /// Shaped part of the springs' force, N.
    pub springs: SVector<T, N>,
    /// Shaped part of the plane's force along its normal, N.
    pub plane: T,
}

impl<T: Real, const N: usize> SharedGuidance<T, N> {
    /// Returns the state without any force.
    pub fn none() -> Self {
        Self { acts: false, springs: SVector::zeros(), plane: T::zero() }
    }
}

impl<T: Real> Guidance<T> {
    /// Makes the run-time form of a checked scene.
    pub fn new(scene: &Scene<T>) -> Self {
        let mut guidance = Self {
            springs: scene.springs.clone(),
            field_damping: scene.field_damping,
            push: None,
            is_active: false,
            is_pushed: false,
            adds_force: false,
            shared_feed_forward: FeedForward::Off,
            in_plane: Stiffness::none(),
            stiffness: scene.springs.iter().fold(T::zero(), |sum, spring| sum + spring.stiffness),
            washouts: [Washout::default(); 4],
        };
        for Spring { direction: [x, y, _], stiffness, .. } in &scene.springs {
            guidance.in_plane.add_across(*x, *y, *stiffness);
        }
        guidance.is_active = guidance.has_any_force();
        guidance.adds_force = guidance.is_active;
        guidance
    }

    /// Returns true if there is a spring, a field or a plane of the host.
    fn has_any_force(&self) -> bool {
        let plane = self.push.as_ref().is_some_and(|push| !push.plane.is_absent());
        !self.springs.is_empty() || self.field_damping > T::zero() || plane
    }

    /// Sets the host's force and plane from the next step on.
    pub fn set_push(&mut self, push: Option<&Push<T>>) {
        self.push = push.copied();
        self.is_active = self.has_any_force();
        self.is_pushed = push.is_some();
        self.adds_force = self.is_active || self.is_pushed;
        if push.is_none_or(|push| push.plane.is_absent()) {
            let [of_plane, ..] = &mut self.washouts;
            *of_plane = cleared_washout(of_plane);
        }
    }

    /// Returns the host's force at the tip, N.
    pub fn push_force<const N: usize>(&self) -> SVector<T, N> {
        self.push.as_ref().map_or(SVector::zeros(), |push| task_vector(&push.force))
    }

    /// Returns the host's force and plane.
    pub fn push(&self) -> Option<&Push<T>> {
        self.push.as_ref()
    }

    /// Sets the feed-forward that stiff parts share with walls, and its washout.
    pub fn set_shared_feed_forward(&mut self, (shared_feed_forward, washout): (FeedForward, Option<Washout<T>>)) {
        if shared_feed_forward != self.shared_feed_forward {
            // The washouts were not stepped, so their states are no longer valid.
            self.washouts = [Washout::default(); 4];
        }
        self.shared_feed_forward = shared_feed_forward;
        if let Some(washout) = washout {
            self.washouts.iter_mut().for_each(|own| own.retune(&washout));
        }
    }

    /// Restarts the washouts.
    pub fn forget(&mut self) {
        self.washouts.iter_mut().for_each(|washout| *washout = cleared_washout(washout));
    }

    /// Returns the force of springs, fields and the plane at the tip without the host's force, N.
    #[inline(always)]
    pub fn force<const N: usize>(&self, place: &SVector<T, N>, velocity: &SVector<T, N>) -> SVector<T, N> {
        let mut force = velocity * -self.field_damping;
        if let Some(push) = &self.push {
            force += push.plane.force(place, velocity);
        }
        for spring in &self.springs {
            force += spring_force(spring, place, velocity);
        }
        force
    }

    /// Returns true if walls have the feed-forward, so that [`Guidance::shared_part`] must run in every step.
    pub fn shares_feed_forward(&self) -> bool {
        self.shared_feed_forward != FeedForward::Off
    }

    /// Returns the part of [`Guidance::force`] that walls with the feed-forward shape with the factor α = `gain`.
    #[inline(never)]
    pub fn shared_part<const N: usize>(
        &mut self,
        place: &SVector<T, N>,
        velocity: &SVector<T, N>,
        gain: T,
    ) -> SharedGuidance<T, N> {
        let mut shared = SharedGuidance::none();
        for spring in self.springs.iter().filter(|spring| spring.stiffness > T::zero()) {
            shared.springs += spring_force(spring, place, velocity);
            shared.acts = true;
        }
        let plane = self.stiff_plane();
        let touched = plane.is_some_and(|plane| plane.depth(place) > T::zero());
        shared.plane = plane.map_or(T::zero(), |plane| plane.normal_force(place, velocity));
        self.keep_shaped_part(&mut shared, touched, gain);
        shared
    }

    #[inline(always)]
    fn stiff_plane(&self) -> Option<&PushedPlane<T>> {
        self.push.as_ref().map(|push| &push.plane).filter(|plane| plane.stiffness > T::zero())
    }

    /// Reduces the forces to the part that is shaped together with walls, for α = `gain`. `touched` is true if the
    /// plane is touched.
    #[inline(always)]
    fn keep_shaped_part<const N: usize>(&mut self, shared: &mut SharedGuidance<T, N>, touched: bool, gain: T) {
        shared.acts |= touched;
        if self.shared_feed_forward == FeedForward::Washout {
            let [of_plane, of_springs @ ..] = &mut self.washouts;
            shared.plane = of_plane.step(shared.plane);
            for (force, washout) in shared.springs.iter_mut().zip(of_springs) {
                *force = washout.step(*force);
            }
        }
        shared.springs *= gain;
        shared.plane = if touched { shared.plane * gain } else { T::zero() };
    }

    /// Returns [`Guidance::force`] and, for α = 1, [`Guidance::shared_part`]. Computes each spring's force once.
    #[inline(always)]
    pub fn force_and_shared_part<const N: usize>(
        &mut self,
        place: &SVector<T, N>,
        velocity: &SVector<T, N>,
    ) -> (SVector<T, N>, SharedGuidance<T, N>) {
        let mut shared = SharedGuidance::none();
        let mut force = velocity * -self.field_damping;
        for spring in &self.springs {
            let of_spring = spring_force(spring, place, velocity);
            force += of_spring;
            if spring.stiffness > T::zero() {
                shared.springs += of_spring;
                shared.acts = true;
            }
        }
        let mut touched = false;
        if let Some(Push { plane, .. }) = &self.push {
            let along = plane.normal_force(place, velocity);
            force += task_vector::<T, N>(&plane.normal) * along;
            if plane.stiffness > T::zero() {
                touched = plane.depth(place) > T::zero();
                shared.plane = along;
            }
        }
        if self.shares_feed_forward() {
            self.keep_shaped_part(&mut shared, touched, T::one());
        }
        (force, shared)
    }

    /// Returns the springs' total stiffness in the plane; `None` without springs.
    #[inline(always)]
    pub fn stiffness_in_plane(&self) -> Option<Stiffness<T>> {
        (self.stiffness > T::zero()).then_some(self.in_plane)
    }

    /// Returns the normal of the host's plane, the depth in it (m) at the tip position `place` (m) and its stiffness
    /// (N/m); `None` unless the plane is stiff and touched.
    #[inline(always)]
    pub fn touched_plane<const N: usize>(&self, place: &SVector<T, N>) -> Option<(SVector<T, N>, T, T)> {
        let plane = self.stiff_plane()?;
        let depth = plane.depth(place);
        (depth > T::zero()).then(|| (task_vector(&plane.normal), depth, plane.stiffness))
    }

    /// Returns the resultant of the shaped forces of springs and plane, N.
    #[inline(never)]
    pub fn shared_force<const N: usize>(&self, shared: &SharedGuidance<T, N>) -> SVector<T, N> {
        let normal = self.push.as_ref().map_or(SVector::zeros(), |push| task_vector(&push.plane.normal));
        shared.springs + normal * shared.plane
    }

    /// Returns the larger of the springs' extension and the depth in the plane, both computed from the shaped force, m.
    pub fn shared_depth<const N: usize>(&self, shared: &SharedGuidance<T, N>) -> T {
        let plane = self.push.as_ref().map_or(T::zero(), |push| push.plane.stiffness);
        let largest = shared.springs.iter().fold(T::zero(), |largest, force| largest.greater(force.abs()));
        depth_of(largest, self.stiffness).greater(depth_of(shared.plane, plane))
    }

    /// Calls `each` with the stiffness of each spring and of the touched plane, and with the plane's depth (m).
    pub fn for_each_pull<const N: usize>(&self, place: &SVector<T, N>, mut each: impl FnMut(Pull<T, N>, Option<T>)) {
        for spring in self.springs.iter().filter(|spring| spring.stiffness > T::zero()) {
            let normal = task_vector(&spring.direction);
            each(Pull { normal, across: true, stiffness: spring.stiffness, feed_forward: false }, None);
        }
        if let Some(push) = self.push.as_ref().filter(|push| push.plane.depth(place) > T::zero()) {
            let (normal, stiffness) = (task_vector(&push.plane.normal), push.plane.stiffness);
            each(Pull { normal, across: false, stiffness, feed_forward: false }, Some(push.plane.depth(place)));
        }
    }
}

/// Returns a washout of the same design with a cleared state.
fn cleared_washout<T: Real>(washout: &Washout<T>) -> Washout<T> {
    let mut fresh = Washout::default();
    fresh.retune(washout);
    fresh
}

/// Returns the force of one spring at the tip, N. Not inlined, because few scenes have springs.
#[inline(never)]
fn spring_force<T: Real, const N: usize>(
    spring: &Spring<T>,
    place: &SVector<T, N>,
    velocity: &SVector<T, N>,
) -> SVector<T, N> {
    let direction = task_vector::<T, N>(&spring.direction);
    let across = |v: SVector<T, N>| v - direction * direction.dot(&v);
    let stretch = across(place - task_vector::<T, N>(&spring.point));
    -(stretch * spring.stiffness + across(*velocity) * spring.damping)
}
