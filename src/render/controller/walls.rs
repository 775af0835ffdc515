//! The walls of a scene at run time: contacts, forces, and what each wall remembers between two steps.
//!
//! Nothing here knows a mechanism, so devices with as many joints share the code.

use super::gains::Gains;
use super::passivity::Debt;
use crate::math::{Math, Real};
use crate::model::inertia::frame_rate;
use crate::render::scene::{Contact, FeedForward, MAX_WALLS, Scene, SceneError, Surface, Wall};
use crate::render::step_result::AtWalls;
use crate::render::velocity::{Coefficients, Velocity, Washout};
use heapless::Vec;
use nalgebra::SVector;
pub use together::{TOUCH_DEPTH, TOUCH_SHARE};
pub(super) use together::{Together, depth_of};

mod together;

/// One wall.
#[derive(Clone, Copy, Debug)]
pub(super) struct Running<T: Real> {
    wall: Wall<T>,
    /// Distance up to which it acts (m), and the least force that it makes (N): zero, but without end where it is bilateral.
    reach: T,
    least: T,
    /// The shaping of its force where it acts together with others: its own feed-forward, or theirs if it has none.
    together: FeedForward,
    /// True if it has the feed-forward itself.
    own: bool,
    /// Depth to which a newton presses it in, m: 0 without stiffness.
    softness: T,
    velocity: Velocity<T>,
    washout: Washout<T>,
}

/// The pull of one touched wall among others.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pulled<T> {
    /// N/m
    pub stiffness: T,
    /// True if it has the feed-forward itself.
    pub own: bool,
    /// Depth of the tip in it, m.
    pub depth: T,
    /// The depth at which its stiffness alone would make what is shaped of its force, m.
    pub reach: T,
}

/// The effect of one wall in one step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pressed<T> {
    /// Velocity along its normal, m/s.
    pub velocity: T,
    /// True if it acts.
    pub touched: bool,
    /// Its force along the normal, N, and the part that is shaped. Zero where it does not act.
    pub force: T,
    pub shaped: T,
    /// Damping that the passivity controller added, N s/m.
    pub passivity_damping: T,
}

impl<T: Real> Running<T> {
    /// The velocity along the normal (m/s) at this distance (m) by the wall's own low-pass.
    #[inline(always)]
    pub fn pass(&mut self, coefficients: &Coefficients<T>, distance: T) -> T {
        self.velocity.pass(coefficients, distance)
    }

    /// The same by any estimator. `known`: the velocity, by one that watches joints.
    #[inline(always)]
    fn approach(&mut self, coefficients: &Coefficients<T>, distance: T, known: Option<T>) -> T {
        match known {
            None => self.velocity.step(coefficients, distance),
            Some(velocity) => self.velocity.follow(distance, velocity),
        }
    }

    /// The wall at this distance (m) and at the velocity `v` (m/s). `gain`: the feed-forward's α.
    #[inline(always)]
    pub fn press(&mut self, distance: T, v: T, debt: Option<&Debt<T>>, gain: T) -> Pressed<T> {
        let wall = &self.wall;
        let zero = T::zero();
        let mut pressed = Pressed { velocity: v, touched: false, force: zero, shaped: zero, passivity_damping: zero };
        // Comparisons here are written so that what is not a number stays one, and is found out.
        let inside = distance < self.reach;
        if !inside {
            if self.together == FeedForward::Washout {
                self.washout.step(zero);
            }
            return pressed;
        }
        let mut force = -wall.stiffness * distance - wall.damping * v;
        if let Some(debt) = debt {
            let extra = debt.damping(v);
            force -= extra * v;
            pressed.passivity_damping = extra;
        }
        if force < self.least {
            force = self.least;
        }
        pressed.touched = true;
        pressed.force = force;
        pressed.shaped = match self.together {
            FeedForward::Off => zero,
            FeedForward::Full => force * gain,
            FeedForward::Washout => self.washout.step(force) * gain,
        };
        if let Some(debt) = debt {
            pressed.shaped *= debt.feed_forward_share();
        }
        pressed
    }

    /// Of wall `index` as it acts at a contact with the force `shaped` (N) through the feed-forward.
    #[inline(always)]
    pub fn acting<const N: usize>(&self, index: usize, contact: &Contact<T, N>, shaped: T) -> Active<T, N> {
        Active {
            wall: index,
            normal: contact.normal,
            shaped,
            distance: contact.distance,
            stiffness: self.wall.stiffness,
            bilateral: self.wall.bilateral,
            feed_forward: self.wall.feed_forward != FeedForward::Off,
        }
    }

    /// Returns true if its force is shaped, by itself or with others.
    #[inline(always)]
    pub fn is_shaped(&self) -> bool {
        self.together != FeedForward::Off
    }

    /// The part of its stiffness that acts at this distance (m), by the depth of the tip in it: unlimited if it acts on
    /// both sides. `force`: the shaped part of its force, N.
    #[inline(always)]
    pub fn pull(&self, distance: T, force: T) -> Pulled<T> {
        Pulled {
            stiffness: self.wall.stiffness,
            own: self.own,
            depth: self.reach - distance,
            reach: force.abs() * self.softness,
        }
    }

    /// Its surface.
    pub fn surface(&self) -> &Surface<T> {
        &self.wall.surface
    }

    /// Its share of the feed-forward.
    pub fn feed_forward(&self) -> FeedForward {
        self.wall.feed_forward
    }

    /// Not inlined: the same for every mechanism, and rare.
    #[inline(never)]
    fn set_gains(&mut self, gains: &Gains<T>, washout: &Washout<T>) {
        self.wash(washout);
        self.wall.stiffness = gains.stiffness;
        self.wall.damping = gains.damping;
        self.wall.feed_forward = gains.feed_forward;
        self.wall.washout_hz = gains.washout_hz;
    }

    /// Takes this design for its washout.
    fn wash(&mut self, washout: &Washout<T>) {
        if self.together == FeedForward::Washout {
            self.washout.retune(washout);
        } else {
            // It was not stepped, so what it remembers is no longer true.
            self.washout = Washout::default();
            self.washout.retune(washout);
        }
    }
}

/// A contact whose force goes through the feed-forward in this step, its own or that of walls it acts together with.
#[derive(Clone, Copy, Debug)]
pub(super) struct Active<T: Real, const N: usize> {
    /// Which wall.
    pub wall: usize,
    /// Its unit normal here.
    pub normal: SVector<T, N>,
    /// The part of its force that is shaped, N.
    pub shaped: T,
    /// Distance of the tip to it, m; negative inside it.
    pub distance: T,
    /// Its stiffness, N/m.
    pub stiffness: T,
    /// True if it acts on both sides.
    pub bilateral: bool,
    /// True if it has the feed-forward itself.
    pub feed_forward: bool,
}

impl<T: Real, const N: usize> Active<T, N> {
    /// A force (N) along a normal, that of a wall (by its index) or of none.
    pub fn along(normal: &SVector<T, N>, shaped: T, wall: Option<usize>) -> Self {
        let zero = T::zero();
        let wall = wall.unwrap_or(MAX_WALLS);
        Self { wall, normal: *normal, shaped, distance: zero, stiffness: zero, bilateral: false, feed_forward: true }
    }
}

/// For what b of the feed-forward is asked.
pub(super) enum Acting<'a, T: Real, const N: usize> {
    /// One wall.
    One(&'a Active<T, N>),
    /// So many rendered directions of several walls.
    Level(&'a Together<'a, T, N>, usize),
}

/// All walls of a scene.
#[derive(Clone, Debug)]
pub(super) struct Walls<T: Real> {
    running: Vec<Running<T>, MAX_WALLS>,
    /// α: how much of (4)'s feed-forward there is.
    gain: T,
    /// Some wall is curved.
    pub curved: bool,
    /// Some wall compensates joint damping.
    pub damped: bool,
}

/// The effect of the walls at one tip position.
#[derive(Clone, Copy, Debug)]
pub(super) struct Touch<T: Real, const N: usize> {
    pub found: AtWalls<T>,
    /// The normal of the deepest.
    pub normal: SVector<T, N>,
    /// The force that goes straight through Jᵀ, N.
    pub plain: SVector<T, N>,
    /// The first wall with the feed-forward: by itself, because one is the usual case and need not go through memory.
    pub first: Option<Active<T, N>>,
}

impl<T: Real> Walls<T> {
    /// The walls of a checked scene, with their filters designed.
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
            let (reach, least) = if wall.bilateral { (T::INFINITY, -T::INFINITY) } else { (T::zero(), T::zero()) };
            let _ = running.push(Running {
                wall: *wall,
                reach,
                least,
                together: wall.feed_forward,
                own: false,
                softness: T::zero(),
                velocity: Velocity::default(),
                washout,
            });
        }
        let mut walls = Self {
            running,
            gain: scene.feed_forward_gain,
            curved: scene.walls.iter().any(|wall| wall.surface.curved()),
            damped: scene.walls.iter().any(|wall| wall.damping_compensation),
        };
        walls.agree();
        Ok(walls)
    }

    /// The shaping of the force of walls without the feed-forward, and of springs, where they act together with walls
    /// that have it: through a washout if any of those has one, as they do not push sideways at rest either.
    pub fn others(&self) -> (FeedForward, Option<Washout<T>>) {
        let with = |feed_forward| self.running.iter().find(move |other| other.wall.feed_forward == feed_forward);
        match with(FeedForward::Washout).map(|other| other.washout) {
            Some(washout) => (FeedForward::Washout, Some(washout)),
            None if with(FeedForward::Full).is_some() => (FeedForward::Full, None),
            None => (FeedForward::Off, None),
        }
    }

    /// Tells walls without the feed-forward what [`Walls::others`] says.
    fn agree(&mut self) {
        let (others, washout) = self.others();
        for running in &mut self.running {
            let own = running.wall.feed_forward;
            let together = if own == FeedForward::Off && running.wall.stiffness > T::zero() { others } else { own };
            if let (FeedForward::Off, Some(washout)) = (own, &washout) {
                running.wash(washout);
            }
            running.together = together;
            running.own = own != FeedForward::Off;
            running.softness = depth_of(T::one(), running.wall.stiffness);
        }
    }

    /// Contacts and forces at the tip position `place` (m); walls whose force is shaped go to `more`, but for the first
    /// that has the feed-forward itself.
    /// `along` is the tip's velocity (m/s) where an estimator that watches joints knows it. Every estimator runs at every
    /// step, so contact never starts it from zero.
    #[inline(always)]
    pub fn touch<K: Math<T>, const N: usize>(
        &mut self,
        coefficients: &Coefficients<T>,
        place: &SVector<T, N>,
        along: Option<&SVector<T, N>>,
        debt: Option<&Debt<T>>,
        more: &mut Vec<Active<T, N>, MAX_WALLS>,
    ) -> Touch<T, N> {
        let mut found = AtWalls::none();
        if !self.running.is_empty() {
            found.distance = T::INFINITY;
        }
        let zeros = SVector::zeros();
        let mut touch = Touch { found, normal: zeros, plain: zeros, first: None };
        for (index, running) in self.running.iter_mut().enumerate() {
            let contact = running.wall.surface.contact::<K, N>(place);
            let known = along.map(|velocity| contact.normal.dot(velocity));
            let velocity = running.approach(coefficients, contact.distance, known);
            let pressed = running.press(contact.distance, velocity, debt, self.gain);
            // Written so that what is not a number stays one, and is found out.
            let shallower = contact.distance >= touch.found.distance;
            if !shallower {
                touch.found.distance = contact.distance;
                touch.found.normal_velocity = pressed.velocity;
                touch.normal = contact.normal;
            }
            if !pressed.touched {
                continue;
            }
            touch.found.contacts += 1;
            touch.found.wall_force += pressed.force;
            touch.found.passivity_damping += pressed.passivity_damping;
            touch.plain += contact.normal * (pressed.force - pressed.shaped);
            if running.together != FeedForward::Off {
                let active = running.acting(index, &contact, pressed.shaped);
                if touch.first.is_none() && active.feed_forward {
                    touch.first = Some(active);
                } else {
                    let _ = more.push(active);
                }
            }
        }
        if touch.first.is_none() && !more.is_empty() {
            // Walls without the feed-forward alone.
            touch.plain += more.iter().fold(SVector::zeros(), |sum, a| sum + a.normal * a.shaped);
            more.clear();
        }
        touch
    }

    /// The share of joint damping that is compensated: of several walls with the feed-forward, the share in their
    /// stiffness of those that ask for it.
    pub fn damping_share<const N: usize>(&self, acting: &Acting<'_, T, N>) -> T {
        let asks = |a: &Active<T, N>| self.running.get(a.wall).is_some_and(|r| r.wall.damping_compensation);
        if !self.damped {
            return T::zero();
        }
        match acting {
            Acting::One(only) if asks(only) => T::one(),
            Acting::One(_) => T::zero(),
            Acting::Level(together, _) => {
                let (mut asking, mut all) = (T::zero(), T::zero());
                for (a, pull) in together.walls().filter(|(_, pull)| pull.feed_forward) {
                    all += pull.stiffness;
                    asking += if asks(a) { pull.stiffness } else { T::zero() };
                }
                if all > T::zero() { asking / all } else { T::zero() }
            }
        }
    }

    /// The tip acceleration (m/s²) by which the turning of curved walls' normals differs from none, -κ of
    /// [`frame_rate`].
    #[inline(never)]
    pub fn turning<K: Math<T>, const N: usize>(
        &self,
        place: &SVector<T, N>,
        velocity: &SVector<T, N>,
        acting: &Acting<'_, T, N>,
    ) -> SVector<T, N> {
        let rate = |a: &Active<T, N>| match self.running.get(a.wall) {
            Some(running) => running.wall.surface.normal_rate::<K, N>(place, velocity),
            None => SVector::zeros(),
        };
        let (line, line_rate) = match acting {
            Acting::One(only) => (only.normal, rate(only)),
            Acting::Level(together, rendered) => {
                // The rate of a principal direction: the rates of the normals that make it, each by its part in it.
                let follow = |i: usize| {
                    let (mut sum, mut all) = (SVector::zeros(), T::zero());
                    for (a, pull) in together.walls() {
                        let along = together.principal.direction(i).dot(&a.normal);
                        sum += rate(a) * (pull.stiffness * along);
                        all += pull.stiffness * along * along;
                    }
                    if all > T::zero() { sum / all } else { SVector::zeros() }
                };
                if *rendered == 1 {
                    let (line, rate) = (together.principal.direction(0), follow(0));
                    (line, rate - line * line.dot(&rate))
                } else {
                    // The admissible line stays across what is rendered.
                    let line = together.principal.direction(N - 1);
                    let held = (0..*rendered)
                        .fold(SVector::zeros(), |sum, i| sum - together.principal.direction(i) * line.dot(&follow(i)));
                    (line, held)
                }
            }
        };
        -frame_rate(&line, &line_rate, velocity)
    }

    /// The only wall of a scene that has one alone.
    #[inline(always)]
    pub fn single(&mut self) -> Option<&mut Running<T>> {
        let [only] = self.running.as_mut_slice() else { return None };
        Some(only)
    }

    /// All of them.
    #[inline(always)]
    pub fn all(&mut self) -> &mut [Running<T>] {
        &mut self.running
    }

    /// Returns true if every wall that has the feed-forward is stiff: what is rendered then follows their stiffness.
    pub fn are_stiff(&self) -> bool {
        let stiff = |wall: &Wall<T>| wall.feed_forward == FeedForward::Off || wall.stiffness > T::zero();
        self.running.iter().all(|running| stiff(&running.wall))
    }

    /// Returns true if the scene has one ball alone, and that has the feed-forward.
    pub fn is_single_ball(&self) -> bool {
        let [only] = self.running.as_slice() else { return false };
        only.wall.surface.is_sphere() && only.own
    }

    /// Returns true if the scene has one wall alone, or none.
    pub fn at_most_one(&self) -> bool {
        self.running.len() <= 1
    }

    /// α of the feed-forward.
    pub fn gain(&self) -> T {
        self.gain
    }

    /// Starts every estimator with the tip at `place` (m): contact then is no motion.
    #[inline(never)]
    pub fn begin<K: Math<T>, const N: usize>(&mut self, place: &SVector<T, N>) {
        for running in &mut self.running {
            running.velocity = Velocity::resting_at(running.wall.surface.contact::<K, N>(place).distance);
        }
    }

    /// Returns true if a one-sided wall is touched at the tip position `place`.
    #[inline(never)]
    pub fn any_touched<K: Math<T>, const N: usize>(&self, place: &SVector<T, N>) -> bool {
        self.running.iter().any(|running| {
            let wall = &running.wall;
            !wall.bilateral && wall.surface.contact::<K, N>(place).distance < T::zero()
        })
    }

    /// See [`Controller::set_gains`](super::Controller::set_gains).
    pub fn set_gains(&mut self, gains: &Gains<T>, washout: &Washout<T>) {
        if let Some(running) = self.running.get_mut(usize::from(gains.wall)) {
            running.set_gains(gains, washout);
        }
        self.agree();
    }

    /// Forgets what the washouts have seen; the estimators begin with [`Walls::begin`].
    #[inline(never)]
    pub fn forget(&mut self) {
        for running in &mut self.running {
            let mut fresh = Washout::default();
            fresh.retune(&running.washout);
            running.washout = fresh;
        }
    }
}
