//! Springs, fields, and what the host adds.
//!
//! It goes straight through Jᵀ, except for stiff parts beside walls that have the feed-forward: springs and the host's
//! plane then go through the levels of [`crate::model::principal`] with those walls, as walls without the feed-forward
//! do (docs/model.md section 2).

use super::push::{Push, PushedPlane};
use super::stiffness::Stiffness;
use super::walls::depth_of;
use crate::math::Real;
use crate::model::principal::Pull;
use crate::render::scene::{FeedForward, MAX_SPRINGS, Scene, Spring, task_vector};
use crate::render::velocity::Washout;
use heapless::Vec;
use nalgebra::SVector;

/// Springs, fields, and what the host adds.
#[derive(Clone, Debug)]
pub(super) struct Guidance<T: Real> {
    springs: Vec<Spring<T>, MAX_SPRINGS>,
    field_damping: T,
    push: Option<Push<T>>,
    /// True if there is more than a force of the host's.
    pub any: bool,
    /// True if the host pushes.
    pub pushed: bool,
    /// One or the other.
    pub adds: bool,
    /// Its shaping beside walls with the feed-forward; [`FeedForward::Off`] if the scene has none.
    together: FeedForward,
    /// The springs' total stiffness: in the plane, and their sum, N/m.
    in_plane: Stiffness<T>,
    stiffness: T,
    /// Of the springs' force, and of the plane's.
    washouts: [Washout<T>; 4],
}

/// The force of what is stiff, beside walls with the feed-forward.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beside<T, const N: usize> {
    /// True if there is anything stiff.
    pub acts: bool,
    /// The part of the springs' force that is shaped, N.
    pub springs: SVector<T, N>,
    /// The part of the plane's, along its normal, N.
    pub plane: T,
}

impl<T: Real, const N: usize> Beside<T, N> {
    /// Nothing.
    pub fn none() -> Self {
        Self { acts: false, springs: SVector::zeros(), plane: T::zero() }
    }
}

impl<T: Real> Guidance<T> {
    /// Of a checked scene.
    pub fn new(scene: &Scene<T>) -> Self {
        let mut guidance = Self {
            springs: scene.springs.clone(),
            field_damping: scene.field_damping,
            push: None,
            any: false,
            pushed: false,
            adds: false,
            together: FeedForward::Off,
            in_plane: Stiffness::none(),
            stiffness: scene.springs.iter().fold(T::zero(), |sum, spring| sum + spring.stiffness),
            washouts: [Washout::default(); 4],
        };
        for Spring { direction: [x, y, _], stiffness, .. } in &scene.springs {
            guidance.in_plane.add_across(*x, *y, *stiffness);
        }
        guidance.any = guidance.acts();
        guidance.adds = guidance.any;
        guidance
    }

    /// See [`Guidance::any`].
    fn acts(&self) -> bool {
        let plane = self.push.as_ref().is_some_and(|push| !push.plane.is_absent());
        !self.springs.is_empty() || self.field_damping > T::zero() || plane
    }

    /// Sets the host's force and plane from the next step on.
    pub fn set_push(&mut self, push: Option<&Push<T>>) {
        self.push = push.copied();
        self.any = self.acts();
        self.pushed = push.is_some();
        self.adds = self.any || self.pushed;
        if push.is_none_or(|push| push.plane.is_absent()) {
            let [of_plane, ..] = &mut self.washouts;
            *of_plane = restarted(of_plane);
        }
    }

    /// The force (N) that the host adds at the tip.
    pub fn pushing<const N: usize>(&self) -> SVector<T, N> {
        self.push.as_ref().map_or(SVector::zeros(), |push| task_vector(&push.force))
    }

    /// The host's force and plane.
    pub fn push(&self) -> Option<&Push<T>> {
        self.push.as_ref()
    }

    /// Takes over how walls with the feed-forward want the others shaped beside them.
    pub fn agree(&mut self, (together, washout): (FeedForward, Option<Washout<T>>)) {
        if together != self.together {
            // They were not stepped, so what they remember is no longer true.
            self.washouts = [Washout::default(); 4];
        }
        self.together = together;
        if let Some(washout) = washout {
            self.washouts.iter_mut().for_each(|own| own.retune(&washout));
        }
    }

    /// Restarts the washouts.
    pub fn forget(&mut self) {
        self.washouts.iter_mut().for_each(|washout| *washout = restarted(washout));
    }

    /// The force (N) at the tip, without what the host pushes with.
    #[inline(always)]
    pub fn force<const N: usize>(&self, place: &SVector<T, N>, velocity: &SVector<T, N>) -> SVector<T, N> {
        let mut force = velocity * -self.field_damping;
        if let Some(push) = &self.push {
            force += push.plane.pushes(place, velocity);
        }
        for spring in &self.springs {
            force += spring_force(spring, place, velocity);
        }
        force
    }

    /// Returns true if walls of this scene have the feed-forward, so that [`Guidance::beside`] wants every step.
    pub fn is_beside(&self) -> bool {
        self.together != FeedForward::Off
    }

    /// The part of [`Guidance::force`] that is shaped beside walls that have the feed-forward, α `gain`.
    #[inline(never)]
    pub fn beside<const N: usize>(&mut self, place: &SVector<T, N>, velocity: &SVector<T, N>, gain: T) -> Beside<T, N> {
        let mut beside = Beside::none();
        for spring in self.springs.iter().filter(|spring| spring.stiffness > T::zero()) {
            beside.springs += spring_force(spring, place, velocity);
            beside.acts = true;
        }
        let plane = self.stiff_plane();
        let touched = plane.is_some_and(|plane| plane.depth(place) > T::zero());
        beside.plane = plane.map_or(T::zero(), |plane| plane.force(place, velocity));
        self.shape(&mut beside, touched, gain);
        beside
    }

    /// The host's plane where it is stiff.
    #[inline(always)]
    fn stiff_plane(&self) -> Option<&PushedPlane<T>> {
        self.push.as_ref().map(|push| &push.plane).filter(|plane| plane.stiffness > T::zero())
    }

    /// Leaves of all that is stiff beside walls that have the feed-forward, α `gain`, the part that is shaped. `touched`:
    /// whether the plane is.
    #[inline(always)]
    fn shape<const N: usize>(&mut self, beside: &mut Beside<T, N>, touched: bool, gain: T) {
        beside.acts |= touched;
        if self.together == FeedForward::Washout {
            let [of_plane, of_springs @ ..] = &mut self.washouts;
            beside.plane = of_plane.step(beside.plane);
            for (force, washout) in beside.springs.iter_mut().zip(of_springs) {
                *force = washout.step(*force);
            }
        }
        beside.springs *= gain;
        beside.plane = if touched { beside.plane * gain } else { T::zero() };
    }

    /// [`Guidance::force`], and with α = 1 [`Guidance::beside`], each spring's force worked out once.
    #[inline(always)]
    pub fn force_and_beside<const N: usize>(
        &mut self,
        place: &SVector<T, N>,
        velocity: &SVector<T, N>,
    ) -> (SVector<T, N>, Beside<T, N>) {
        let mut beside = Beside::none();
        let mut force = velocity * -self.field_damping;
        for spring in &self.springs {
            let of_spring = spring_force(spring, place, velocity);
            force += of_spring;
            if spring.stiffness > T::zero() {
                beside.springs += of_spring;
                beside.acts = true;
            }
        }
        let mut touched = false;
        if let Some(Push { plane, .. }) = &self.push {
            let along = plane.force(place, velocity);
            force += task_vector::<T, N>(&plane.normal) * along;
            if plane.stiffness > T::zero() {
                touched = plane.depth(place) > T::zero();
                beside.plane = along;
            }
        }
        if self.is_beside() {
            self.shape(&mut beside, touched, T::one());
        }
        (force, beside)
    }

    /// The springs' total stiffness in the plane; zero without springs.
    #[inline(always)]
    pub fn in_plane(&self) -> Option<Stiffness<T>> {
        (self.stiffness > T::zero()).then_some(self.in_plane)
    }

    /// The normal of the host's plane, the depth in it (m) at the tip position `place` (m) and its stiffness (N/m), where it is
    /// stiff and touched.
    #[inline(always)]
    pub fn touched_plane<const N: usize>(&self, place: &SVector<T, N>) -> Option<(SVector<T, N>, T, T)> {
        let plane = self.stiff_plane()?;
        let depth = plane.depth(place);
        (depth > T::zero()).then(|| (task_vector(&plane.normal), depth, plane.stiffness))
    }

    /// The force of `beside`, N.
    #[inline(never)]
    pub fn sum<const N: usize>(&self, beside: &Beside<T, N>) -> SVector<T, N> {
        let normal = self.push.as_ref().map_or(SVector::zeros(), |push| task_vector(&push.plane.normal));
        beside.springs + normal * beside.plane
    }

    /// The extension of the springs and the depth in the plane, by the part of their force that is shaped, m.
    pub fn reach<const N: usize>(&self, beside: &Beside<T, N>) -> T {
        let plane = self.push.as_ref().map_or(T::zero(), |push| push.plane.stiffness);
        let most = beside.springs.iter().fold(T::zero(), |most, force| most.greater(force.abs()));
        depth_of(most, self.stiffness).greater(depth_of(beside.plane, plane))
    }

    /// The stiffness at the tip position `place` (m): for the plane with the depth in it (m).
    pub fn pulls<const N: usize>(&self, place: &SVector<T, N>, mut each: impl FnMut(Pull<T, N>, Option<T>)) {
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

/// The same design without a memory.
fn restarted<T: Real>(washout: &Washout<T>) -> Washout<T> {
    let mut fresh = Washout::default();
    fresh.retune(washout);
    fresh
}

/// The force (N) of one spring at the tip. Not inlined: few scenes have springs, and mechanisms share it.
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
