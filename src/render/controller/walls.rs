//! The walls of a scene at run time: contacts, forces, and the state of each wall between two steps.
//!
//! This code does not depend on the mechanism, so devices with the same number of joints share it.

use super::gains::Gains;
use super::passivity::Debt;
use crate::math::{Math, Real};
use crate::model::inertia::frame_rate;
use crate::render::scene::{Contact, FeedForward, MAX_WALLS, Scene, SceneError, Surface, Wall};
use crate::render::step_result::AtWalls;
use crate::render::velocity::{Coefficients, Velocity, Washout};
pub(super) use contact_group::{ContactGroup, depth_of};
pub use contact_group::{TOUCH_DEPTH, TOUCH_SHARE};
use heapless::Vec;
use nalgebra::SVector;

mod contact_group;

#[derive(Clone, Copy, Debug)]
pub(super) struct RunningWall<T: Real> {
    wall: Wall<T>,
    /// Distance below which the wall acts, m: 0, or +∞ for a bilateral wall.
    acts_below: T,
    /// Smallest force that the wall may make, N: 0, or -∞ for a bilateral wall.
    least_force: T,
    /// Feed-forward among several walls: the wall's own, or the shared feed-forward if the wall has none.
    effective_feed_forward: FeedForward,
    /// True if the wall has a feed-forward of its own.
    has_feed_forward: bool,
    /// Depth per newton, m: 0 without stiffness.
    compliance: T,
    velocity: Velocity<T>,
    washout: Washout<T>,
}

/// Stiffness and depth of one touched wall among several.
#[derive(Clone, Copy, Debug)]
pub(super) struct ContactPull<T> {
    /// Stiffness, N/m.
    pub stiffness: T,
    /// True if the wall has a feed-forward of its own.
    pub has_feed_forward: bool,
    /// Depth of the tip in the wall, m.
    pub depth: T,
    /// Depth at which the stiffness alone would make the shaped part of the force, m.
    pub reach: T,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct WallEffect<T> {
    /// Velocity along the normal, m/s.
    pub velocity: T,
    /// True if the wall acts.
    pub is_touched: bool,
    /// Force along the normal, N; zero if the wall does not act.
    pub force: T,
    /// Part of the force for the feed-forward, N; zero if the wall does not act.
    pub shaped: T,
    /// Damping added by the passivity controller, N s/m.
    pub passivity_damping: T,
}

impl<T: Real> RunningWall<T> {
    /// Returns the velocity along the normal (m/s) at this distance (m), computed by the wall's own low-pass.
    #[inline(always)]
    pub fn step_low_pass(&mut self, coefficients: &Coefficients<T>, distance: T) -> T {
        self.velocity.step_low_pass(coefficients, distance)
    }

    /// Returns the velocity along the normal (m/s) for any estimator. `known` is the velocity from joint estimators.
    #[inline(always)]
    fn normal_velocity(&mut self, coefficients: &Coefficients<T>, distance: T, known: Option<T>) -> T {
        match known {
            None => self.velocity.step(coefficients, distance),
            Some(velocity) => self.velocity.follow(distance, velocity),
        }
    }

    /// Computes the wall's effect at this distance (m) and velocity `v` (m/s). `gain` is the feed-forward's α.
    #[inline(always)]
    pub fn effect_at(&mut self, distance: T, v: T, debt: Option<&Debt<T>>, gain: T) -> WallEffect<T> {
        let wall = &self.wall;
        let zero = T::zero();
        let mut effect =
            WallEffect { velocity: v, is_touched: false, force: zero, shaped: zero, passivity_damping: zero };
        // The comparisons below are written so that NaN propagates and is detected.
        let inside = distance < self.acts_below;
        if !inside {
            if self.effective_feed_forward == FeedForward::Washout {
                self.washout.step(zero);
            }
            return effect;
        }
        let mut force = -wall.stiffness * distance - wall.damping * v;
        if let Some(debt) = debt {
            let extra = debt.damping(v);
            force -= extra * v;
            effect.passivity_damping = extra;
        }
        if force < self.least_force {
            force = self.least_force;
        }
        effect.is_touched = true;
        effect.force = force;
        effect.shaped = match self.effective_feed_forward {
            FeedForward::Off => zero,
            FeedForward::Full => force * gain,
            FeedForward::Washout => self.washout.step(force) * gain,
        };
        if let Some(debt) = debt {
            effect.shaped *= debt.feed_forward_share();
        }
        effect
    }

    /// Returns the shaped contact of wall `index` with the force `shaped` (N) through the feed-forward.
    #[inline(always)]
    pub fn shaped_contact<const N: usize>(
        &self,
        index: usize,
        contact: &Contact<T, N>,
        shaped: T,
    ) -> ShapedContact<T, N> {
        ShapedContact {
            wall: index,
            normal: contact.normal,
            shaped,
            distance: contact.distance,
            stiffness: self.wall.stiffness,
            bilateral: self.wall.bilateral,
            feed_forward: self.wall.feed_forward != FeedForward::Off,
        }
    }

    /// Returns true if the wall's force is shaped, by its own feed-forward or together with other walls.
    #[inline(always)]
    pub fn is_shaped(&self) -> bool {
        self.effective_feed_forward != FeedForward::Off
    }

    /// Returns stiffness and depth of the wall at this distance (m); the depth is infinite for a bilateral wall.
    /// `force` is the shaped part of the wall's force, N.
    #[inline(always)]
    pub fn pull(&self, distance: T, force: T) -> ContactPull<T> {
        ContactPull {
            stiffness: self.wall.stiffness,
            has_feed_forward: self.has_feed_forward,
            depth: self.acts_below - distance,
            reach: force.abs() * self.compliance,
        }
    }

    /// Returns the wall's surface.
    pub fn surface(&self) -> &Surface<T> {
        &self.wall.surface
    }

    /// Returns the wall's own feed-forward.
    pub fn feed_forward(&self) -> FeedForward {
        self.wall.feed_forward
    }

    /// Sets the gains. Not inlined, because it is rare and the same for every mechanism.
    #[inline(never)]
    fn set_gains(&mut self, gains: &Gains<T>, washout: &Washout<T>) {
        self.set_washout(washout);
        self.wall.stiffness = gains.stiffness;
        self.wall.damping = gains.damping;
        self.wall.feed_forward = gains.feed_forward;
        self.wall.washout_hz = gains.washout_hz;
    }

    /// Sets the design of the wall's washout.
    fn set_washout(&mut self, washout: &Washout<T>) {
        if self.effective_feed_forward == FeedForward::Washout {
            self.washout.retune(washout);
        } else {
            // The washout was not stepped, so its state is no longer valid.
            self.washout = Washout::default();
            self.washout.retune(washout);
        }
    }
}

/// A contact whose force is shaped in this step, by its own feed-forward or together with other walls.
#[derive(Clone, Copy, Debug)]
pub(super) struct ShapedContact<T: Real, const N: usize> {
    /// Index of the wall.
    pub wall: usize,
    /// Unit normal at the contact.
    pub normal: SVector<T, N>,
    /// Shaped part of the wall's force, N.
    pub shaped: T,
    /// Distance of the tip, m; negative inside the wall.
    pub distance: T,
    /// Stiffness, N/m.
    pub stiffness: T,
    /// True if the wall acts on both sides.
    pub bilateral: bool,
    /// True if the wall has a feed-forward of its own.
    pub feed_forward: bool,
}

impl<T: Real, const N: usize> ShapedContact<T, N> {
    /// Makes the contact of the force `shaped` (N) along a normal. `wall` is the index of the force's wall, if any.
    pub fn along(normal: &SVector<T, N>, shaped: T, wall: Option<usize>) -> Self {
        let zero = T::zero();
        let wall = wall.unwrap_or(MAX_WALLS);
        Self { wall, normal: *normal, shaped, distance: zero, stiffness: zero, bilateral: false, feed_forward: true }
    }
}

/// Contacts for which b of the feed-forward is computed.
pub(super) enum BiasScope<'a, T: Real, const N: usize> {
    /// One wall.
    One(&'a ShapedContact<T, N>),
    /// The first directions of a group of walls, as many as the number.
    Level(&'a ContactGroup<'a, T, N>, usize),
}

#[derive(Clone, Debug)]
pub(super) struct Walls<T: Real> {
    running: Vec<RunningWall<T>, MAX_WALLS>,
    /// α: factor on the feed-forward of equation (4).
    gain: T,
    /// True if some wall is curved.
    pub has_curved_wall: bool,
    /// True if some wall compensates joint damping.
    pub compensates_damping: bool,
}

/// The effect of the walls at one tip position.
#[derive(Clone, Copy, Debug)]
pub(super) struct WallContacts<T: Real, const N: usize> {
    pub at_walls: AtWalls<T>,
    /// Normal of the deepest wall.
    pub normal: SVector<T, N>,
    /// Force through Jᵀ without feed-forward, N.
    pub plain: SVector<T, N>,
    /// The first wall with the feed-forward, separate because a usual scene has only one wall.
    pub first: Option<ShapedContact<T, N>>,
}

impl<T: Real> Walls<T> {
    /// Makes the run-time walls of a checked scene and designs their filters.
    #[inline(never)]
    pub fn new(scene: &Scene<T>) -> Result<Self, SceneError> {
        let mut running = Vec::new();
        for (index, wall) in scene.walls.iter().enumerate() {
            let washout = match wall.feed_forward {
                FeedForward::Washout => {
                    Washout::new(wall.washout_hz, scene.rate_hz).map_err(|_| SceneError::Washout(index as u8))?
                }
                _ => Washout::default(),
            };
            // The two vectors have the same capacity.
            let (acts_below, least_force) =
                if wall.bilateral { (T::INFINITY, -T::INFINITY) } else { (T::zero(), T::zero()) };
            let _ = running.push(RunningWall {
                wall: *wall,
                acts_below,
                least_force,
                effective_feed_forward: wall.feed_forward,
                has_feed_forward: false,
                compliance: T::zero(),
                velocity: Velocity::default(),
                washout,
            });
        }
        let mut walls = Self {
            running,
            gain: scene.feed_forward_gain,
            has_curved_wall: scene.walls.iter().any(|wall| wall.surface.is_curved()),
            compensates_damping: scene.walls.iter().any(|wall| wall.damping_compensation),
        };
        walls.update_shared_feed_forward();
        Ok(walls)
    }

    /// Returns the feed-forward that walls share with springs and with walls without a feed-forward. It has a washout
    /// if any wall has a washout, because such a wall must not push sideways at rest.
    pub fn shared_feed_forward(&self) -> (FeedForward, Option<Washout<T>>) {
        let with = |feed_forward| self.running.iter().find(move |other| other.wall.feed_forward == feed_forward);
        match with(FeedForward::Washout).map(|other| other.washout) {
            Some(washout) => (FeedForward::Washout, Some(washout)),
            None if with(FeedForward::Full).is_some() => (FeedForward::Full, None),
            None => (FeedForward::Off, None),
        }
    }

    /// Gives [`Walls::shared_feed_forward`] to the walls without a feed-forward.
    fn update_shared_feed_forward(&mut self) {
        let (others, washout) = self.shared_feed_forward();
        for running in &mut self.running {
            let own = running.wall.feed_forward;
            if let (FeedForward::Off, Some(washout)) = (own, &washout) {
                running.set_washout(washout);
            }
            let shares = own == FeedForward::Off && running.wall.stiffness > T::zero();
            running.effective_feed_forward = if shares { others } else { own };
            running.has_feed_forward = own != FeedForward::Off;
            running.compliance = depth_of(T::one(), running.wall.stiffness);
        }
    }

    /// Computes contacts and forces at the tip position `place` (m). Writes walls with shaped force to `more`, except
    /// for the first wall with a feed-forward of its own. `along` is the tip velocity (m/s) from joint estimators, if
    /// used. Every estimator runs in every step, so that no contact starts an estimator from zero.
    #[inline(always)]
    pub fn compute_contacts<K: Math<T>, const N: usize>(
        &mut self,
        coefficients: &Coefficients<T>,
        place: &SVector<T, N>,
        along: Option<&SVector<T, N>>,
        debt: Option<&Debt<T>>,
        more: &mut Vec<ShapedContact<T, N>, MAX_WALLS>,
    ) -> WallContacts<T, N> {
        let mut at_walls = AtWalls::none();
        if !self.running.is_empty() {
            at_walls.distance = T::INFINITY;
        }
        let zeros = SVector::zeros();
        let mut touch = WallContacts { at_walls, normal: zeros, plain: zeros, first: None };
        for (index, running) in self.running.iter_mut().enumerate() {
            let contact = running.wall.surface.contact::<K, N>(place);
            let known = along.map(|velocity| contact.normal.dot(velocity));
            let velocity = running.normal_velocity(coefficients, contact.distance, known);
            let effect = running.effect_at(contact.distance, velocity, debt, self.gain);
            // Written so that NaN propagates and is detected.
            let shallower = contact.distance >= touch.at_walls.distance;
            if !shallower {
                touch.at_walls.distance = contact.distance;
                touch.at_walls.normal_velocity = effect.velocity;
                touch.normal = contact.normal;
            }
            if !effect.is_touched {
                continue;
            }
            touch.at_walls.contacts += 1;
            touch.at_walls.wall_force += effect.force;
            touch.at_walls.passivity_damping += effect.passivity_damping;
            touch.plain += contact.normal * (effect.force - effect.shaped);
            if running.effective_feed_forward != FeedForward::Off {
                let shaped = running.shaped_contact(index, &contact, effect.shaped);
                if touch.first.is_none() && shaped.feed_forward {
                    touch.first = Some(shaped);
                } else {
                    let _ = more.push(shaped);
                }
            }
        }
        if touch.first.is_none() && !more.is_empty() {
            // No wall has a feed-forward of its own.
            touch.plain += more.iter().fold(SVector::zeros(), |sum, a| sum + a.normal * a.shaped);
            more.clear();
        }
        touch
    }

    /// Returns the share of joint damping that is compensated. For several walls with the feed-forward, it is the
    /// stiffness of the walls that request compensation, over the stiffness of all.
    pub fn damping_share<const N: usize>(&self, scope: &BiasScope<'_, T, N>) -> T {
        let compensates =
            |a: &ShapedContact<T, N>| self.running.get(a.wall).is_some_and(|r| r.wall.damping_compensation);
        if !self.compensates_damping {
            return T::zero();
        }
        match scope {
            BiasScope::One(only) if compensates(only) => T::one(),
            BiasScope::One(_) => T::zero(),
            BiasScope::Level(group, _) => {
                let (mut compensated, mut all) = (T::zero(), T::zero());
                for (a, pull) in group.walls().filter(|(_, pull)| pull.feed_forward) {
                    all += pull.stiffness;
                    compensated += if compensates(a) { pull.stiffness } else { T::zero() };
                }
                if all > T::zero() { compensated / all } else { T::zero() }
            }
        }
    }

    /// Returns the tip acceleration (m/s²) by the rotation of curved walls' normals, -κ of [`frame_rate`].
    #[inline(never)]
    pub fn normal_turn_acceleration<K: Math<T>, const N: usize>(
        &self,
        place: &SVector<T, N>,
        velocity: &SVector<T, N>,
        scope: &BiasScope<'_, T, N>,
    ) -> SVector<T, N> {
        let rate = |a: &ShapedContact<T, N>| match self.running.get(a.wall) {
            Some(running) => running.wall.surface.normal_rate::<K, N>(place, velocity),
            None => SVector::zeros(),
        };
        let (line, line_rate) = match scope {
            BiasScope::One(only) => (only.normal, rate(only)),
            BiasScope::Level(group, rendered) => {
                // The rate of a principal direction is the mean of the normals' rates, weighted by their parts in it.
                let follow = |i: usize| {
                    let (mut sum, mut all) = (SVector::zeros(), T::zero());
                    for (a, pull) in group.walls() {
                        let along = group.principal.direction(i).dot(&a.normal);
                        sum += rate(a) * (pull.stiffness * along);
                        all += pull.stiffness * along * along;
                    }
                    if all > T::zero() { sum / all } else { SVector::zeros() }
                };
                if *rendered == 1 {
                    let (line, rate) = (group.principal.direction(0), follow(0));
                    (line, rate - line * line.dot(&rate))
                } else {
                    // The admissible line stays perpendicular to the rendered directions.
                    let line = group.principal.direction(N - 1);
                    let rate = (0..*rendered)
                        .fold(SVector::zeros(), |sum, i| sum - group.principal.direction(i) * line.dot(&follow(i)));
                    (line, rate)
                }
            }
        };
        -frame_rate(&line, &line_rate, velocity)
    }

    /// Returns the scene's wall; `None` unless the scene has exactly one.
    #[inline(always)]
    pub fn single_wall(&mut self) -> Option<&mut RunningWall<T>> {
        let [only] = self.running.as_mut_slice() else { return None };
        Some(only)
    }

    /// Returns all walls.
    #[inline(always)]
    pub fn all_walls(&mut self) -> &mut [RunningWall<T>] {
        &mut self.running
    }

    /// Returns true if every wall with the feed-forward is stiff, so that the walls' stiffness gives the directions.
    pub fn are_stiff(&self) -> bool {
        let stiff = |wall: &Wall<T>| wall.feed_forward == FeedForward::Off || wall.stiffness > T::zero();
        self.running.iter().all(|running| stiff(&running.wall))
    }

    /// Returns true if the scene's only wall is a ball with the feed-forward.
    pub fn is_single_ball(&self) -> bool {
        let [only] = self.running.as_slice() else { return false };
        only.wall.surface.is_sphere() && only.has_feed_forward
    }

    /// Returns true if the scene has a single wall, or no wall.
    pub fn has_at_most_one_wall(&self) -> bool {
        self.running.len() <= 1
    }

    /// Returns α of the feed-forward.
    pub fn gain(&self) -> T {
        self.gain
    }

    /// Starts every estimator with the tip at `place` (m), so that contact does not appear as a motion.
    #[inline(never)]
    pub fn begin<K: Math<T>, const N: usize>(&mut self, place: &SVector<T, N>) {
        for running in &mut self.running {
            running.velocity = Velocity::resting_at(running.wall.surface.contact::<K, N>(place).distance);
        }
    }

    /// Returns true if a one-sided wall is touched at the tip position `place`.
    #[inline(never)]
    pub fn is_any_touched<K: Math<T>, const N: usize>(&self, place: &SVector<T, N>) -> bool {
        self.running.iter().any(|running| {
            let wall = &running.wall;
            !wall.bilateral && wall.surface.contact::<K, N>(place).distance < T::zero()
        })
    }

    /// Sets the gains of one wall, see [`Controller::set_gains`](super::Controller::set_gains).
    pub fn set_gains(&mut self, gains: &Gains<T>, washout: &Washout<T>) {
        if let Some(running) = self.running.get_mut(usize::from(gains.wall)) {
            running.set_gains(gains, washout);
        }
        self.update_shared_feed_forward();
    }

    /// Clears the states of the washouts. [`Walls::begin`] starts the estimators.
    #[inline(never)]
    pub fn forget(&mut self) {
        for running in &mut self.running {
            let mut fresh = Washout::default();
            fresh.retune(&running.washout);
            running.washout = fresh;
        }
    }
}
