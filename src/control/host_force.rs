//! Force from the host: what a program on a computer asks the motors for, beside the board's own scene.
//!
//! A host reads where the tip is, works out a force and sends it, about once a millisecond. The board adds it to its own
//! walls before the one rule that cuts torques to what the motors can do and to the limit of the force at the tip
//! (saturation.rs), where joint torques count as the force that they are worth, and under every limit and fault. It
//! trusts it no longer than it lives: a request acts in full until it is `hold` seconds old, then fades linearly and is
//! gone after `fade` seconds more. Its age counts from the state that it was computed from, so what came late has less
//! left to live.
//!
//! A contact is the host's nearest plane, which the board renders at its own rate. When the host moves it, the board goes
//! there evenly, in as long as the host took since it moved it last: no force steps where a plane does.

use crate::control::ControlLoop;
use crate::control::joints::{Counts, Torques};
use crate::control::program::Program;
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::model::catalogue::MAX_JOINTS;
use crate::render::controller::{Push, PushedPlane};
use crate::render::step_result::StepResult;
use crate::safety::fault::State;
use core::ops::DerefMut;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Longest time for which a request may be held, and longest for it to fade, s.
pub const MOST_LEASE: f32 = 0.2;
/// Largest force that a request may hold, N; what the motors cannot make is cut to what they can.
pub const MOST_HELD_FORCE: f32 = 1.0e3;
/// Largest joint torque that a request may hold, N m.
pub const MOST_TORQUE: f32 = 1.0e2;
/// Furthest from the origin that a contact's point may be, m.
pub const MOST_DISTANCE: f32 = 10.0;
/// Stiffest contact, N/m.
pub const MOST_STIFFNESS: f32 = 1.0e5;
/// Most damped contact, N s/m.
pub const MOST_DAMPING: f32 = 1.0e3;
/// Largest deviation of a contact's normal from a unit vector, as the square of its length.
const UNIT: f32 = 1.0e-3;
/// Shortest and longest time in which a contact goes from one plane to the next, s. One that appears or goes takes the
/// shortest.
pub const BLEND_SECONDS: (f32, f32) = (1.0e-3, 20.0e-3);

/// A host's request; it replaces the host's earlier one. Vectors are in the task frame, or one entry a joint, with
/// zeros in entries that the device does not have. The default requests no force and only reads the device's state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct ForceRequest {
    /// Rises with every request, wrapping. What is not newer than the last one taken is not taken.
    pub sequence: u32,
    /// [`ForceAnswer::step`] of the state that this was computed from; `None` for no state in particular.
    pub seen: Option<u32>,
    /// For how long it acts in full, s; at most [`MOST_LEASE`].
    pub hold: f32,
    /// In how long it then fades to nothing, s; at most [`MOST_LEASE`].
    pub fade: f32,
    /// Force at the tip, N.
    pub force: [f32; 3],
    /// Joint torques, N m.
    pub torque: [f32; MAX_JOINTS],
    /// A plane to be rendered by the board.
    pub contact: Option<HostContact>,
}

/// A one-sided plane that a host wants rendered: f = -stiffness x - damping ẋ along the normal, where the distance x =
/// normal·(tip - point) is negative, and never less than 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct HostContact {
    /// A point of it, m.
    pub point: [f32; 3],
    /// Unit normal out of the solid.
    pub normal: [f32; 3],
    /// N/m
    pub stiffness: f32,
    /// N s/m
    pub damping: f32,
}

/// The outcome of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum ForceDone {
    /// It acts from the next control step on.
    Taken,
    /// Nothing: with `hold` and `fade` 0 it only asks how the device is.
    Looked,
    /// Nothing: the motors are off.
    NotArmed,
    /// Nothing: one as new or newer has been taken, and still acts.
    NotNewer,
    /// Nothing: it is older than it may become.
    TooOld,
    /// Nothing: a number of it cannot be used.
    Bad(BadForce),
}

/// A number of a request that cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum BadForce {
    /// `hold` or `fade` is not a number from 0 to [`MOST_LEASE`].
    Lease,
    /// `seen` is a step that has not been.
    Seen,
    /// The force is not finite, above [`MOST_HELD_FORCE`], or in a direction that the device does not have.
    Force,
    /// A torque is not finite, above [`MOST_TORQUE`], or of a joint that the device does not have.
    Torque,
    /// The contact's point is not finite, or further away than [`MOST_DISTANCE`].
    Point,
    /// The contact's normal is not a unit vector of the task frame.
    Normal,
    /// The contact's stiffness or damping is not a number from 0 to [`MOST_STIFFNESS`] and [`MOST_DAMPING`].
    Gains,
}

impl core::fmt::Display for ForceDone {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Taken => f.write_str("taken"),
            Self::Looked => f.write_str("not taken: it has no time to live, and only asks how the device is"),
            Self::NotArmed => f.write_str("not taken: the motors are off; arm them first"),
            Self::NotNewer => f.write_str("not taken: a request with this sequence number or a later one acts"),
            Self::TooOld => f.write_str("not taken: it came later than its hold and fade allow"),
            Self::Bad(BadForce::Lease) => write!(f, "not taken: hold and fade must be from 0 to {MOST_LEASE} s"),
            Self::Bad(BadForce::Seen) => f.write_str("not taken: it was computed from a step that has not been"),
            Self::Bad(BadForce::Force) => write!(
                f,
                "not taken: each entry of the force must be at most {MOST_HELD_FORCE} N, and 0 where the device has no direction"
            ),
            Self::Bad(BadForce::Torque) => write!(
                f,
                "not taken: each torque must be at most {MOST_TORQUE} N m, and 0 where the device has no joint"
            ),
            Self::Bad(BadForce::Point) => {
                write!(f, "not taken: the contact's point must be within {MOST_DISTANCE} m of the origin")
            }
            Self::Bad(BadForce::Normal) => f.write_str(
                "not taken: the contact's normal must have length 1, and 0 where the device has no direction",
            ),
            Self::Bad(BadForce::Gains) => write!(
                f,
                "not taken: the contact's stiffness must be from 0 to {MOST_STIFFNESS} N/m, its damping to {MOST_DAMPING} N s/m"
            ),
        }
    }
}

/// The state of the device, and the effect of the host's requests, at the control step before the answer.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ForceAnswer {
    /// Of the request that this answers.
    pub sequence: u32,
    /// The outcome of the request.
    pub done: ForceDone,
    /// Disarmed, armed, fault.
    pub state: State,
    /// Control steps since boot, wrapping: the board's time, as in telemetry.
    pub step: u32,
    /// Seconds from one step to the next.
    pub period: f32,
    /// Time since the state that the acting request was computed from, s; `None` when none acts.
    pub age: Option<f32>,
    /// Tip, m.
    pub tip: [f32; 3],
    /// Tip velocity, filtered as the scene says, m/s.
    pub velocity: [f32; 3],
    /// Joint angles, rad.
    pub q: [f32; MAX_JOINTS],
    /// Joint velocities, filtered as the scene says, rad/s.
    pub qd: [f32; MAX_JOINTS],
    /// Joint torques commanded, after all limits, N m.
    pub torque: [f32; MAX_JOINTS],
    /// Force at the tip that the host's force and contact have really added, after lease, ramp and limits, N.
    pub force: [f32; 3],
    /// Share of what the host asks for that acts: lease times ramp times limits.
    pub share: f32,
}

impl ForceRequest {
    /// The first part of it that a device with this many task dimensions and joints cannot use.
    pub fn wrong(&self, task: usize, joints: usize) -> Option<BadForce> {
        let within = |value: &f32, most: f32| value.abs() <= most;
        let only = |values: &[f32; 3], count: usize| values.iter().skip(count).all(|value| *value == 0.0);
        let leased = |value: &f32| (0.0..=MOST_LEASE).contains(value);
        if !leased(&self.hold) || !leased(&self.fade) {
            return Some(BadForce::Lease);
        }
        if !self.force.iter().all(|value| within(value, MOST_HELD_FORCE)) || !only(&self.force, task) {
            return Some(BadForce::Force);
        }
        if !self.torque.iter().all(|value| within(value, MOST_TORQUE)) || !only(&self.torque, joints) {
            return Some(BadForce::Torque);
        }
        let contact = self.contact.as_ref()?;
        if !contact.point.iter().all(|value| within(value, MOST_DISTANCE)) {
            return Some(BadForce::Point);
        }
        let length = contact.normal.iter().fold(0.0, |sum, value| sum + value * value);
        if !within(&(length - 1.0), UNIT) || !only(&contact.normal, task) {
            return Some(BadForce::Normal);
        }
        let gains =
            (0.0..=MOST_STIFFNESS).contains(&contact.stiffness) && (0.0..=MOST_DAMPING).contains(&contact.damping);
        if gains { None } else { Some(BadForce::Gains) }
    }

    /// Share that acts at an age (s).
    fn lease(&self, age: f32) -> f32 {
        if age < self.hold {
            1.0
        } else {
            // A fade of 0 s ends at once.
            let remaining = self.hold + self.fade - age;
            if remaining > 0.0 { (remaining / self.fade).min(1.0) } else { 0.0 }
        }
    }
}

impl HostContact {
    fn plane(&self) -> PushedPlane<f32> {
        let offset = self.normal.iter().zip(&self.point).fold(0.0, |sum, (n, p)| sum + n * p);
        PushedPlane { normal: self.normal, offset, stiffness: self.stiffness, damping: self.damping }
    }
}

/// A plane on its way from where it was to where the host has put it.
#[derive(Clone, Copy, Debug, Default)]
struct Blend {
    from: PushedPlane<f32>,
    to: PushedPlane<f32>,
    /// Time since the host has moved it, and in which it is there, s.
    elapsed: f32,
    duration: f32,
}

impl Blend {
    /// Its present plane.
    fn now(&self) -> PushedPlane<f32> {
        if self.elapsed >= self.duration {
            return self.to;
        }
        let (from, to) = (&self.from, &self.to);
        let part = self.elapsed / self.duration;
        let between = |from: f32, to: f32| from + (to - from) * part;
        let stiffness = between(from.stiffness, to.stiffness);
        // Each plane's share in the place is its share in the stiffness: then the force is the mean of the two planes' forces, and
        // not more than either pushes. Half the stiffness half way in could be far more.
        let weight = if stiffness > 0.0 { part * to.stiffness / stiffness } else { part };
        let placed = |from: f32, to: f32| from + (to - from) * weight;
        PushedPlane {
            normal: core::array::from_fn(|i| placed(from.normal[i], to.normal[i])),
            offset: placed(from.offset, to.offset),
            stiffness,
            damping: between(from.damping, to.damping),
        }
    }

    /// Sends it to the host's contact, or lets it vanish where it is.
    fn go(&mut self, contact: Option<&HostContact>) {
        let now = self.now();
        let gone = |plane: PushedPlane<f32>| PushedPlane { stiffness: 0.0, damping: 0.0, ..plane };
        let absent = |plane: &PushedPlane<f32>| plane.stiffness == 0.0 && plane.damping == 0.0;
        let to = contact.map_or(gone(self.to), HostContact::plane);
        if to == self.to {
            return;
        }
        let (least, most) = BLEND_SECONDS;
        let moves = !absent(&now) && !absent(&to);
        self.duration = if moves { self.elapsed.clamp(least, most) } else { least };
        self.from = if absent(&now) { gone(to) } else { now };
        self.to = to;
        self.elapsed = 0.0;
    }
}

/// The host's request while it acts.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HostForce {
    /// True if a request acts.
    pub acts: bool,
    request: ForceRequest,
    /// Time since the state that it was computed from, s.
    age: f32,
    /// Share of it that acts in this step, the joint torques (N m) that this makes, and how long it may yet act, s.
    lease: f32,
    torque: Torques,
    life: f32,
    /// Share of those that ramp and limits left where they left less than all.
    pub granted: f32,
    contact: Blend,
    /// Share of the contact that acted in the last step; how far that still is from the lease of this request, which
    /// took the place of another; and how fast the difference shrinks, 1/s.
    contact_lease: f32,
    beside: f32,
    closing: f32,
}

impl HostForce {
    /// Takes a request that is `age` seconds old.
    fn take(&mut self, request: &ForceRequest, age: f32) {
        // As large a share of the contact acts next as did in the last step. A new one fades in: its plane grows stiff.
        let was_there = self.acts && self.contact.now().stiffness + self.contact.now().damping > 0.0;
        self.beside = if was_there { self.contact_lease - request.lease(age) } else { 0.0 };
        self.closing = self.beside.abs() / BLEND_SECONDS.0;
        // The blend keeps the rest of the earlier contact.
        (self.request, self.age, self.acts) = (ForceRequest { contact: None, ..*request }, age, true);
        self.contact.go(request.contact.as_ref());
    }

    /// Lets a step of `period` (s) pass and returns what it pushes with in that step; `None` once it is gone.
    #[inline(never)]
    fn step(&mut self, period: f32) -> Option<Push<f32>> {
        self.age += period;
        self.contact.elapsed += period;
        self.lease = self.request.lease(self.age);
        if self.lease <= 0.0 {
            *self = Self::default();
            return None;
        }
        self.torque = Torques(self.request.torque.map(|torque| torque * self.lease));
        self.life = self.request.hold + self.request.fade - self.age;
        let closed = self.closing * period;
        self.beside -= if self.beside.abs() > closed { closed.copysign(self.beside) } else { self.beside };
        self.contact_lease = self.lease + self.beside;
        let plane = self.contact.now();
        Some(Push {
            force: self.request.force.map(|force| force * self.lease),
            plane: PushedPlane {
                stiffness: plane.stiffness * self.contact_lease,
                damping: plane.damping * self.contact_lease,
                ..plane
            },
        })
    }
}

impl<P, K, S> ControlLoop<P, S>
where
    P: DerefMut<Target = Program<K, S>>,
    K: Math<f32>,
    S: Stage,
{
    /// Carries out a request between two steps, as far as it can be, and tells how the device is.
    pub fn force(&mut self, request: &ForceRequest) -> ForceAnswer {
        let done = self.take_force(request);
        let mut answer = ForceAnswer {
            sequence: request.sequence,
            done,
            state: self.state,
            step: self.now.step,
            period: self.period,
            age: self.host.acts.then_some(self.host.age),
            tip: self.now.found.at.tip,
            velocity: [0.0; 3],
            q: self.now.found.at.q,
            qd: self.now.found.at.qd,
            torque: self.now.motors.torque.0,
            force: [0.0; 3],
            share: 0.0,
        };
        if let Some(program) = self.program.as_ref() {
            let (velocity, pushed) = program.controller.pushed(&self.now);
            answer.velocity = velocity;
            let granted = self.host_granted();
            answer.share = self.host.lease * granted;
            answer.force = pushed.map(|force| force * granted);
        }
        answer
    }

    /// The joint torques (N m) that acted in the last step because of the host, and how long they might (s).
    #[cold]
    pub(super) fn host_torque(&self) -> (Torques, f32) {
        let granted = self.host_granted();
        let Some(program) = self.program.as_ref().filter(|_| self.host.acts && granted > 0.0) else {
            return (Torques::default(), 0.0);
        };
        let (_, force) = program.controller.pushed(&self.now);
        let pushed = program.mechanism.torque::<K>(&self.now.found.at.q, &force);
        (Torques::from_fn(|i| granted * (pushed[i] + self.host.torque[i])), self.host.life)
    }

    /// Share of what acts of it that ramp and limits left.
    fn host_granted(&self) -> f32 {
        if self.was_cut() { self.host.granted } else { 1.0 }
    }

    fn take_force(&mut self, request: &ForceRequest) -> ForceDone {
        let device = self.program.as_ref().map(|program| (program.controller.kind().spec().task, program.joints));
        let (task, joints) = device.unwrap_or_default();
        if let Some(bad) = request.wrong(task, joints) {
            return ForceDone::Bad(bad);
        }
        let age = request.seen.map_or(0, |seen| self.now.step.wrapping_sub(seen) as i32);
        if age < 0 {
            return ForceDone::Bad(BadForce::Seen);
        }
        if request.hold == 0.0 && request.fade == 0.0 {
            // Whoever follows the device is there; a look that names no state before it may be anybody's.
            if request.seen.is_some() {
                self.hear_host();
            }
            return ForceDone::Looked;
        }
        if self.state != State::Armed {
            return ForceDone::NotArmed;
        }
        if self.host.acts && request.sequence.wrapping_sub(self.host.request.sequence) as i32 <= 0 {
            return ForceDone::NotNewer;
        }
        // Steps before a change of rate took another time, so their age is unknown.
        let before = age as u32 > self.now.step.wrapping_sub(self.rate_since);
        let age = age as f32 * self.period;
        if before || request.lease(age) <= 0.0 {
            return ForceDone::TooOld;
        }
        self.host.take(request, age);
        self.hear_host();
        ForceDone::Taken
    }

    /// Renders the scene and the host's push.
    #[inline(never)]
    pub(super) fn render_pushed(&mut self, counts: &Counts) {
        let push = self.host.step(self.period);
        if let Some(program) = self.program.as_mut() {
            program.controller.set_push(push.as_ref());
        }
        self.render_scene(counts);
        if self.host.acts {
            self.add(counts);
        }
    }

    /// Adds the host's joint torques to what the scene and the host's force ask for. They make a force at the tip, too,
    /// so the resultant of all that is rendered is computed again, from the sum of the torques.
    fn add(&mut self, counts: &Counts) {
        let torque = self.host.torque;
        if torque != Torques::default()
            && let Some(program) = self.program.as_ref()
        {
            program.controller.angles(counts, &mut self.now.found);
            let StepResult { at, asked, .. } = &mut self.now.found;
            for (i, torque) in torque.iter().enumerate() {
                asked.rendered[i] += torque;
                asked.total[i] += torque;
            }
            asked.force_squared = program.mechanism.leverage::<K>(&at.q).force_squared(&asked.rendered);
        }
    }

    /// Forgets what the host asked for.
    pub(super) fn let_go(&mut self) {
        self.host = HostForce::default();
        if let Some(program) = self.program.as_mut() {
            program.controller.set_push(None);
        }
    }
}
