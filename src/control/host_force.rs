//! Force from the host: forces, torques and a contact that a program on a computer adds to the board's own scene.
//!
//! A program on a computer reads the tip position, computes a force and sends it, about once a millisecond. The board
//! adds this force to its own walls before it limits all torques (saturation.rs). Joint torques count as their force at
//! the tip. All limits and faults apply. A request acts in full until it is `hold` seconds old, then fades linearly for
//! `fade` seconds. The age counts from the state that it was computed from, so a late request has less time.
//!
//! A contact is the host's nearest plane, which the board renders at its own rate. When the host moves the plane, the
//! board moves its copy evenly over the time since the host's previous move, so that the force does not jump.

use crate::control::ControlLoop;
use crate::control::joints::{Counts, Torques};
use crate::control::program::Program;
use crate::drive::stage::Stage;
use crate::math::Math;
use crate::model::catalogue::MAX_JOINTS;
use crate::model::description::MAX_SENSED;
use crate::render::controller::{Push, PushedPlane};
use crate::render::step_result::StepResult;
use crate::safety::fault::State;
use core::ops::DerefMut;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Longest hold and longest fade of a request, s.
pub const MAX_LEASE: f32 = 0.2;
/// Largest force that a request may contain, N. Forces beyond the motors' limits are cut.
pub const MAX_HELD_FORCE: f32 = 1.0e3;
/// Largest joint torque that a request may contain, N m, or force of a slide, N.
pub const MAX_HELD_TORQUE: f32 = 1.0e2;
/// Largest distance of a contact's point from the origin of the task frame, m.
pub const MAX_CONTACT_DISTANCE: f32 = 10.0;
/// Largest stiffness of a contact, N/m.
pub const MAX_CONTACT_STIFFNESS: f32 = 1.0e5;
/// Largest damping of a contact, N s/m.
pub const MAX_CONTACT_DAMPING: f32 = 1.0e3;
/// Largest deviation of the squared length of a contact's normal from 1.
const MAX_UNIT_LENGTH_ERROR: f32 = 1.0e-3;
/// Shortest and longest time in which a contact moves from one plane to the next, s. A contact that appears or
/// disappears takes the shortest.
pub const BLEND_SECONDS: (f32, f32) = (1.0e-3, 20.0e-3);

/// A host's request, which replaces its earlier request. Vectors are in the task frame or have one entry per joint;
/// entries that the device does not have are zero. The default requests no force and only reads the device's state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct ForceRequest {
    /// Increases with every request, wrapping. A request that is not newer than the last accepted request is rejected.
    pub sequence: u32,
    /// [`ForceAnswer::step`] of the state that the request was computed from; `None` if the request uses no state.
    pub seen: Option<u32>,
    /// Time for which the request acts in full, s; at most [`MAX_LEASE`].
    pub hold: f32,
    /// Time for which the request then fades to zero, s; at most [`MAX_LEASE`].
    pub fade: f32,
    /// Force at the tip, N.
    pub force: [f32; 3],
    /// Joint torques, N m; forces of slides, N.
    pub torque: [f32; MAX_JOINTS],
    /// A plane for the board to render.
    pub contact: Option<HostContact>,
}

/// A one-sided plane rendered for the host: f = -stiffness x - damping ẋ along the normal while the distance x =
/// normal·(tip - point) is negative. The force is never negative.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct HostContact {
    /// A point of the plane, m.
    pub point: [f32; 3],
    /// Unit normal, pointing out of the solid.
    pub normal: [f32; 3],
    /// Stiffness, N/m.
    pub stiffness: f32,
    /// Damping, N s/m.
    pub damping: f32,
}

/// Outcome of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum ForceDone {
    /// Accepted: the request acts from the next control step on.
    Taken,
    /// No force, because `hold` and `fade` are 0: the request only reads the device's state.
    Looked,
    /// Rejected: the motors are off.
    NotArmed,
    /// Rejected: a request with the same or a later number still acts.
    NotNewer,
    /// Rejected: the request is older than its hold and fade together.
    TooOld,
    /// Rejected: a value in the request cannot be used.
    Bad(BadForce),
}

/// The value of a request that cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum BadForce {
    /// `hold` or `fade` is not a number from 0 to [`MAX_LEASE`].
    Lease,
    /// `seen` is a step in the future.
    Seen,
    /// The force is not finite, above [`MAX_HELD_FORCE`], or in a direction that the device does not have.
    Force,
    /// A torque is not finite, above [`MAX_HELD_TORQUE`], or of a joint that the device does not have.
    Torque,
    /// The contact's point is not finite, or further away than [`MAX_CONTACT_DISTANCE`].
    Point,
    /// The contact's normal is not a unit vector of the task frame.
    Normal,
    /// The contact's stiffness or damping is not a number from 0 to its maximum.
    Gains,
}

impl core::fmt::Display for ForceDone {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Taken => f.write_str("taken"),
            Self::Looked => f.write_str("not taken: hold and fade are 0, so the request only reads the device's state"),
            Self::NotArmed => f.write_str("not taken: the motors are off; arm them first"),
            Self::NotNewer => f.write_str("not taken: a request with this or a later sequence number acts; send a later one"),
            Self::TooOld => f.write_str("not taken: it arrived after its hold and fade had ended; send it earlier"),
            Self::Bad(BadForce::Lease) => write!(f, "not taken: hold and fade must be from 0 to {MAX_LEASE} s"),
            Self::Bad(BadForce::Seen) => f.write_str("not taken: `seen` is a future step; send the step of an earlier reply"),
            Self::Bad(BadForce::Force) => write!(
                f,
                "not taken: each entry of the force must be at most {MAX_HELD_FORCE} N in size, and 0 in a direction that the device does not have"
            ),
            Self::Bad(BadForce::Torque) => write!(
                f,
                "not taken: each torque must be at most {MAX_HELD_TORQUE} N m in size, and 0 for a joint that the device does not have"
            ),
            Self::Bad(BadForce::Point) => {
                write!(f, "not taken: the contact's point must be within {MAX_CONTACT_DISTANCE} m of the origin")
            }
            Self::Bad(BadForce::Normal) => f.write_str(
                "not taken: the contact's normal must have length 1, and an entry of 0 in a direction that the device does not have",
            ),
            Self::Bad(BadForce::Gains) => write!(
                f,
                "not taken: the contact's stiffness must be from 0 to {MAX_CONTACT_STIFFNESS} N/m, its damping from 0 to {MAX_CONTACT_DAMPING} N s/m"
            ),
        }
    }
}

/// State of the device and effect of the host's requests at the control step before the reply.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ForceAnswer {
    /// Sequence number of the request.
    pub sequence: u32,
    /// Outcome of the request.
    pub done: ForceDone,
    /// State of the control loop.
    pub state: State,
    /// Control steps since boot, wrapping: the board's time, as in telemetry.
    pub step: u32,
    /// Time from one step to the next, s.
    pub period: f32,
    /// Time since the state that the acting request was computed from, s; `None` if no request acts.
    pub age: Option<f32>,
    /// Tip position, m.
    pub tip: [f32; 3],
    /// Tip velocity, filtered by the scene's estimator, m/s.
    pub velocity: [f32; 3],
    /// Joint angles, rad; travels of slides, m. `qd` and `torque` have the units that belong to these.
    pub q: [f32; MAX_JOINTS],
    /// Joint velocities, filtered by the scene's estimator, rad/s.
    pub qd: [f32; MAX_JOINTS],
    /// Angles of the encoders without motors, rad.
    pub sensed: [f32; MAX_SENSED],
    /// Commanded joint torques after all limits, N m.
    pub torque: [f32; MAX_JOINTS],
    /// Force at the tip that the host's force and contact added, after lease, ramp and limits, N.
    pub force: [f32; 3],
    /// Share of the host's request that acts: lease times ramp times limits.
    pub share: f32,
}

impl ForceRequest {
    /// Returns the first value that a device with this many task dimensions and joints cannot use.
    pub fn first_unusable_value(&self, task: usize, joints: usize) -> Option<BadForce> {
        let within = |value: &f32, most: f32| value.abs() <= most;
        let only = |values: &[f32; 3], count: usize| values.iter().skip(count).all(|value| *value == 0.0);
        let leased = |value: &f32| (0.0..=MAX_LEASE).contains(value);
        if !leased(&self.hold) || !leased(&self.fade) {
            return Some(BadForce::Lease);
        }
        if !self.force.iter().all(|value| within(value, MAX_HELD_FORCE)) || !only(&self.force, task) {
            return Some(BadForce::Force);
        }
        if !self.torque.iter().all(|value| within(value, MAX_HELD_TORQUE)) || !only(&self.torque, joints) {
            return Some(BadForce::Torque);
        }
        let contact = self.contact.as_ref()?;
        if !contact.point.iter().all(|value| within(value, MAX_CONTACT_DISTANCE)) {
            return Some(BadForce::Point);
        }
        let length = contact.normal.iter().fold(0.0, |sum, value| sum + value * value);
        if !within(&(length - 1.0), MAX_UNIT_LENGTH_ERROR) || !only(&contact.normal, task) {
            return Some(BadForce::Normal);
        }
        let gains = (0.0..=MAX_CONTACT_STIFFNESS).contains(&contact.stiffness)
            && (0.0..=MAX_CONTACT_DAMPING).contains(&contact.damping);
        if gains { None } else { Some(BadForce::Gains) }
    }

    /// Returns the share of the request that acts at an age (s).
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

/// A plane that moves from its old to its new place.
#[derive(Clone, Copy, Debug, Default)]
struct MovingPlane {
    from: PushedPlane<f32>,
    to: PushedPlane<f32>,
    /// Time since the host moved the plane, s.
    elapsed: f32,
    /// Time that the board's move of the plane takes, s.
    duration: f32,
}

impl MovingPlane {
    fn present_plane(&self) -> PushedPlane<f32> {
        if self.elapsed >= self.duration {
            return self.to;
        }
        let (from, to) = (&self.from, &self.to);
        let part = self.elapsed / self.duration;
        let between = |from: f32, to: f32| from + (to - from) * part;
        let stiffness = between(from.stiffness, to.stiffness);
        // Each plane's position is weighted by its share of the stiffness. The force is then the mean of the two
        // planes' forces, so it exceeds neither force.
        let weight = if stiffness > 0.0 { part * to.stiffness / stiffness } else { part };
        let placed = |from: f32, to: f32| from + (to - from) * weight;
        PushedPlane {
            normal: core::array::from_fn(|i| placed(from.normal[i], to.normal[i])),
            offset: placed(from.offset, to.offset),
            stiffness,
            damping: between(from.damping, to.damping),
        }
    }

    /// Starts a move to the host's contact, or fades the plane out in place.
    fn move_to(&mut self, contact: Option<&HostContact>) {
        let now = self.present_plane();
        let faded_out = |plane: PushedPlane<f32>| PushedPlane { stiffness: 0.0, damping: 0.0, ..plane };
        let is_absent = |plane: &PushedPlane<f32>| plane.stiffness == 0.0 && plane.damping == 0.0;
        let to = contact.map_or(faded_out(self.to), HostContact::plane);
        if to == self.to {
            return;
        }
        let (shortest, longest) = BLEND_SECONDS;
        let moves = !is_absent(&now) && !is_absent(&to);
        self.duration = if moves { self.elapsed.clamp(shortest, longest) } else { shortest };
        self.from = if is_absent(&now) { faded_out(to) } else { now };
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
    /// Time since the state that the request was computed from, s.
    age: f32,
    /// Share of the request that acts in this step.
    lease: f32,
    /// Joint torques of the request in this step, N m.
    torque: Torques,
    /// Time until the request expires, s.
    remaining_seconds: f32,
    /// Share of the host's force that ramp and limits left in the last step that was cut.
    pub granted_share: f32,
    contact: MovingPlane,
    /// Share of the contact that acted in the last step.
    contact_lease: f32,
    /// Contact's share less the request's share; nonzero after the request replaced another request.
    share_offset: f32,
    /// Rate at which `share_offset` shrinks to zero, 1/s.
    offset_rate: f32,
}

impl HostForce {
    /// Accepts a request that is `age` seconds old.
    fn take(&mut self, request: &ForceRequest, age: f32) {
        // The contact's share continues from the last step. A new contact fades in with its rising stiffness.
        let was_there =
            self.acts && self.contact.present_plane().stiffness + self.contact.present_plane().damping > 0.0;
        self.share_offset = if was_there { self.contact_lease - request.lease(age) } else { 0.0 };
        self.offset_rate = self.share_offset.abs() / BLEND_SECONDS.0;
        // The blend keeps the rest of the earlier contact.
        (self.request, self.age, self.acts) = (ForceRequest { contact: None, ..*request }, age, true);
        self.contact.move_to(request.contact.as_ref());
    }

    /// Advances by a step of `period` seconds. Returns the push of this step; `None` if the request has expired.
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
        self.remaining_seconds = self.request.hold + self.request.fade - self.age;
        let closed = self.offset_rate * period;
        self.share_offset -=
            if self.share_offset.abs() > closed { closed.copysign(self.share_offset) } else { self.share_offset };
        self.contact_lease = self.lease + self.share_offset;
        let plane = self.contact.present_plane();
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
    /// Carries out a request between two steps, if possible, and returns the device's state.
    pub fn force(&mut self, request: &ForceRequest) -> ForceAnswer {
        let done = self.take_force(request);
        let mut answer = ForceAnswer {
            sequence: request.sequence,
            done,
            state: self.state,
            step: self.now.step,
            period: self.period,
            age: self.host.acts.then_some(self.host.age),
            tip: self.now.result.at.tip,
            velocity: [0.0; 3],
            q: self.now.result.at.q,
            qd: self.now.result.at.qd,
            sensed: self.sensed.angles,
            torque: self.now.motors.torque.0,
            force: [0.0; 3],
            share: 0.0,
        };
        if let Some(program) = self.program.as_ref() {
            let (velocity, pushed) = program.controller.velocity_and_push(&self.now);
            answer.velocity = velocity;
            let granted = self.host_granted();
            answer.share = self.host.lease * granted;
            answer.force = pushed.map(|force| force * granted);
        }
        answer
    }

    /// Returns the joint torques (N m) of the host in the last step, and their remaining time (s).
    #[cold]
    pub(super) fn host_torque(&self) -> (Torques, f32) {
        let granted = self.host_granted();
        let Some(program) = self.program.as_ref().filter(|_| self.host.acts && granted > 0.0) else {
            return (Torques::default(), 0.0);
        };
        let (_, force) = program.controller.velocity_and_push(&self.now);
        let pushed = program.mechanism.torque::<K>(&self.now.result.at.q, &force);
        (Torques::from_fn(|i| granted * (pushed[i] + self.host.torque[i])), self.host.remaining_seconds)
    }

    /// Returns the share of the host's force that ramp and limits left.
    fn host_granted(&self) -> f32 {
        if self.was_cut() { self.host.granted_share } else { 1.0 }
    }

    fn take_force(&mut self, request: &ForceRequest) -> ForceDone {
        let device = self.program.as_ref().map(|program| (program.controller.kind().spec().task, program.joints));
        let (task, joints) = device.unwrap_or_default();
        if let Some(bad) = request.first_unusable_value(task, joints) {
            return ForceDone::Bad(bad);
        }
        let age = request.seen.map_or(0, |seen| self.now.step.wrapping_sub(seen) as i32);
        if age < 0 {
            return ForceDone::Bad(BadForce::Seen);
        }
        if request.hold == 0.0 && request.fade == 0.0 {
            // A request that names a state comes from a live host. A request without a state may come from any tool.
            if request.seen.is_some() {
                self.record_host();
            }
            return ForceDone::Looked;
        }
        if self.state != State::Armed {
            return ForceDone::NotArmed;
        }
        if self.host.acts && request.sequence.wrapping_sub(self.host.request.sequence) as i32 <= 0 {
            return ForceDone::NotNewer;
        }
        // The period was different before a change of rate, so the age of earlier steps is unknown.
        let before = age as u32 > self.now.step.wrapping_sub(self.rate_since);
        let age = age as f32 * self.period;
        if before || request.lease(age) <= 0.0 {
            return ForceDone::TooOld;
        }
        self.host.take(request, age);
        self.update_added_torques();
        self.record_host();
        ForceDone::Taken
    }

    /// Renders the scene with the torques of the host and of the compensation of cogging.
    #[inline(never)]
    pub(super) fn render_with_added_torques(&mut self, counts: &Counts) {
        if self.host.acts {
            let push = self.host.step(self.period);
            if let Some(program) = self.program.as_mut() {
                program.controller.set_push(push.as_ref());
            }
        }
        self.render_scene(counts);
        if self.host.acts {
            self.add_host_torques(counts);
        }
        if self.cogging.acts {
            self.add_cogging(counts);
        }
        self.update_added_torques();
    }

    #[inline(always)]
    pub(super) fn update_added_torques(&mut self) {
        self.adds_torques = self.host.acts | self.cogging.acts;
    }

    /// Adds the host's joint torques to the demand, and the tip force of these torques to the resultant force.
    fn add_host_torques(&mut self, counts: &Counts) {
        let torque = self.host.torque;
        if torque != Torques::default()
            && let Some(program) = self.program.as_ref()
        {
            program.controller.angles(counts, &mut self.now.result);
            let StepResult { at, asked, .. } = &mut self.now.result;
            for (i, torque) in torque.iter().enumerate() {
                asked.rendered[i] += torque;
                asked.total[i] += torque;
            }
            asked.force_squared = program.mechanism.leverage::<K>(&at.q).force_squared(&asked.rendered);
        }
    }

    pub(super) fn clear_host_force(&mut self) {
        self.host = HostForce::default();
        self.update_added_torques();
        if let Some(program) = self.program.as_mut() {
            program.controller.set_push(None);
        }
    }
}
