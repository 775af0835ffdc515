//! The motion of a joint slowly both ways through its arc, by requests of a host's force.
//!
//! A host's contact is a plane that pushes only, which the board renders at its own rate. A constant torque presses the
//! joint against it, so the two together hold the joint like a spring, and the plane's motion moves the joint. The other
//! joints are held by springs at the rate of the requests. All limits of the board apply, and all torques end with the
//! lease of the last request.

use super::{CoggingError, Motion, Pass, Sample};
use haptic_bridge::board::protocol::{ForceDone, ForceRequest, HostContact};
use haptic_bridge::control::Rules;
use haptic_bridge::math::Libm;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::cogging::shaft_ratio;
use haptic_bridge::model::device::Device;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::State;
use haptic_host::link::{Board, FADE_S, HOLD_S, LinkError};
use nalgebra::{Matrix3, Vector3};
use std::time::Duration;

/// Longest time between two replies of one motion, s.
const MAX_GAP_SECONDS: f64 = 0.1;
/// Control rate of the motion, Hz.
const RATE_HZ: f32 = 10_000.0;
/// Interval between two requests, unless the link is slower.
const INTERVAL: Duration = Duration::from_millis(1);
/// Speed of a motor's shaft, rad/s (of a slide times its lever).
const SPEED: f64 = 0.25;
/// Angular frequencies of the moved joint on the plane that are tried, fastest first, and of the others, rad/s.
const RATES: [f64; 6] = [400.0, 250.0, 150.0, 100.0, 60.0, 40.0];
const HOLD_RATE: f64 = 40.0;
/// Ratio of the cutoff of the velocities to the joint's frequency.
const CUTOFF_RATIO: f64 = 8.0;
/// Largest torque that the velocity of one count may make, as a share of the pressing torque.
const MAX_COUNT_SHARE: f64 = 0.5;
/// Largest velocity after a single count, as a share of the count times the cutoff (rad/s).
const COUNT_VELOCITY: f64 = 0.46;
/// Pressing torque as a share of the joint's limit.
const PRESSING_SHARE: f64 = 0.5;
/// Distance of the arc's ends from the joint's limits: share of the range, and at least rad (of a slide times its lever).
const MARGIN: (f64, f64) = (0.03, 0.02);
/// Largest ratio of the tip forces of a joint's torque within the arc of a linkage.
const MAX_LEVERAGE_RATIO: f32 = 3.0;
/// Number of poses in a range whose leverage is checked.
const CHECKED_POSES: u32 = 200;
/// Passes through the arc.
const PASSES: usize = 4;
/// Smallest share of a request that acts while samples count: the torque has ramped up, and no limit cuts it.
const WHOLE_SHARE: f32 = 0.99;

/// The motion of one joint.
#[derive(Clone, Debug)]
pub struct Sweep {
    device: Device<f32>,
    joint: usize,
    motion: Motion,
    /// Angular frequency of the joint on the plane, rad/s.
    rate: f64,
    pressing: f64,
    /// Ends of the arc, rad.
    arc: (f64, f64),
    /// Angles at which the other joints are held, rad; `None` until the first reply.
    held: Option<[f64; MAX_JOINTS]>,
    /// Angle to which the joint is led, rad.
    target: f64,
    /// Number of the present way: to the first end, then the passes.
    way: usize,
    passes: Vec<Pass>,
    request: ForceRequest,
    step: Option<u32>,
    time: f64,
}

impl Sweep {
    /// Prepares the motion of `joint` from the pose `q` (rad) of a board with these rules.
    pub fn new(device: &Device<f32>, rules: &Rules, q: &[f32; MAX_JOINTS], joint: usize) -> Result<Self, CoggingError> {
        let spec = device.mechanism.kind().spec();
        if spec.task != spec.joints {
            return Err(CoggingError::Redundant);
        }
        let of = device.joints.get(joint).filter(|_| joint < spec.joints).ok_or(CoggingError::Incomplete(joint))?;
        let (Some((low, high)), Some(motor), true) = (of.limits, of.motor, of.radians_per_count != 0.0) else {
            return Err(CoggingError::Incomplete(joint));
        };
        let lever = f64::from(device.mechanism.units()[joint].lever);
        let (low, high) = (f64::from(low), f64::from(high));
        let margin = (MARGIN.0 * (high - low)).max(MARGIN.1 * lever);
        let arc = regular_arc(device, q, joint, (low + margin, high - margin)).ok_or(CoggingError::NoArc(joint))?;
        let (_, along) = normal(device, q, joint).ok_or(CoggingError::NoArc(joint))?;
        let inertia = f64::from(device.mechanism.inertia::<Libm>(q)[joint][joint]);
        let motor_torque = f64::from(motor.max_current * motor.torque_constant.abs());
        let limits = &rules.limits;
        let allowed = f64::from(limits.current[joint] * motor.torque_constant.abs());
        let most = motor_torque.min(allowed).min(f64::from(limits.torque[joint]) / lever);
        let pressing = PRESSING_SHARE * most.min(f64::from(limits.tip_force) * along.abs());
        let count = f64::from(of.radians_per_count).abs();
        let quiet = |rate: &f64| {
            let velocity = COUNT_VELOCITY * count * CUTOFF_RATIO * rate;
            1.4 * inertia * rate * velocity + inertia * rate * rate * count <= MAX_COUNT_SHARE * pressing
        };
        let rate = RATES.into_iter().find(quiet).unwrap_or(RATES[RATES.len() - 1]);
        let ratio = shaft_ratio(of);
        let speed = SPEED * lever / ratio.abs().max(1.0);
        Ok(Self {
            device: device.clone(),
            joint,
            motion: Motion { inertia, viscous: of.viscous.into(), speed, count, ratio },
            rate,
            pressing,
            arc,
            held: None,
            target: 0.0,
            way: 0,
            passes: Vec::new(),
            request: ForceRequest::default(),
            step: None,
            time: 0.0,
        })
    }

    /// Returns the scene in which the joint moves.
    pub fn scene(&self) -> Scene<f32> {
        let task = self.device.mechanism.kind().spec().task as u8;
        let cutoff_hz = (CUTOFF_RATIO * self.rate / core::f64::consts::TAU) as f32;
        Scene { task, rate_hz: RATE_HZ, cutoff_hz, ..Scene::default() }
    }

    /// Returns the motion, for [`super::fit`].
    pub fn motion(&self) -> &Motion {
        &self.motion
    }
    /// Returns the passes so far.
    pub fn passes(&self) -> &[Pass] {
        &self.passes
    }
    /// Returns the ends of the arc, rad.
    pub fn arc(&self) -> (f64, f64) {
        self.arc
    }
    /// Returns the part of the passes that is over, 0 to 1.
    pub fn progress(&self) -> f64 {
        let end = if self.way % 2 == 1 { self.arc.1 } else { self.arc.0 };
        let left = ((end - self.target).abs() / (self.arc.1 - self.arc.0)).min(1.0);
        (self.way as f64 - left).max(0.0) / PASSES as f64
    }

    /// Moves the joint on, with the motors armed. Returns true after the last pass. Call again at once, or after the
    /// motors were off: the interrupted pass continues from the present pose.
    pub fn advance(&mut self, board: &mut Board) -> Result<bool, CoggingError> {
        board.rows(INTERVAL)?;
        let request = ForceRequest { sequence: self.request.sequence.wrapping_add(1), seen: self.step, ..self.request };
        self.request = request;
        let answer = match board.force(&request) {
            // The next request replaces a request whose reply was lost.
            Err(LinkError::Unanswered { .. }) => return Ok(false),
            answer => answer?,
        };
        if answer.state != State::Armed {
            let fault = board.status()?.fault;
            return Err(fault.map_or(CoggingError::Disarmed, CoggingError::Fault));
        }
        if self.way > PASSES {
            return Ok(true);
        }
        let q = answer.q.map(f64::from);
        let at = q[self.joint];
        let period = f64::from(answer.period);
        let passed =
            self.step.replace(answer.step).map_or(0.0, |step| f64::from(answer.step.wrapping_sub(step)) * period);
        self.time += passed;
        if passed > MAX_GAP_SECONDS {
            // The motors were off, and the device may have moved.
            self.held = None;
        }
        let held = *self.held.get_or_insert_with(|| {
            self.target = at;
            q
        });
        let whole = answer.done == ForceDone::Taken && answer.share >= WHOLE_SHARE;
        let stiffness = self.motion.inertia * self.rate * self.rate;
        if whole {
            if (self.target - at).abs() > 2.0 * self.pressing / stiffness + 0.1 * (self.arc.1 - self.arc.0) {
                return Err(CoggingError::Stuck { joint: self.joint, q: at });
            }
            let end = if self.way % 2 == 1 { self.arc.1 } else { self.arc.0 };
            let left = end - self.target;
            self.target += left.clamp(-passed * self.motion.speed, passed * self.motion.speed);
            if let Some(pass) = self.passes.last_mut() {
                let weight = self.device.mechanism.gravity::<Libm>(&answer.q)[self.joint];
                let torque = f64::from(answer.torque[self.joint] - weight);
                pass.samples.push(Sample { time: self.time, q: at, torque });
            }
            if left == 0.0 {
                self.way += 1;
                if self.way <= PASSES {
                    self.passes.push(Pass { forward: self.way % 2 == 1, samples: Vec::new() });
                }
            }
        }
        self.request =
            self.request_at(&answer.q, &answer.qd, &answer.tip, &held).ok_or(CoggingError::NoArc(self.joint))?;
        self.request.sequence = request.sequence;
        Ok(false)
    }

    /// Returns the request that leads the joint to its target from this state.
    fn request_at(&self, q: &[f32; 3], qd: &[f32; 3], tip: &[f32; 3], held: &[f64; 3]) -> Option<ForceRequest> {
        let (normal, along) = normal(&self.device, q, self.joint)?;
        let inertia = self.device.mechanism.inertia::<Libm>(q);
        let mut torque = [0.0; MAX_JOINTS];
        for j in 0..self.device.axes() {
            let hold = f64::from(inertia[j][j]) * HOLD_RATE;
            let away = held[j] - f64::from(q[j]);
            torque[j] = (hold * (HOLD_RATE * away - 1.4 * f64::from(qd[j]))) as f32;
        }
        torque[self.joint] = -self.pressing as f32;
        let stiffness = self.motion.inertia * self.rate * self.rate;
        // The plane moves by `along` per joint angle, and its force makes `along` of torque per newton.
        let away = self.target + self.pressing / stiffness - f64::from(q[self.joint]);
        let contact = HostContact {
            point: core::array::from_fn(|i| tip[i] + normal[i] * (along * away) as f32),
            normal,
            stiffness: (stiffness / (along * along)) as f32,
            damping: (1.4 * self.motion.inertia * self.rate / (along * along)) as f32,
        };
        let (hold, fade) = (HOLD_S, FADE_S);
        Some(ForceRequest { hold, fade, torque, contact: Some(contact), ..ForceRequest::default() })
    }
}

/// Returns the unit normal of the plane that only `joint` crosses, and the tip's motion along it per joint angle, m/rad,
/// positive. Returns `None` in a singular pose.
fn normal(device: &Device<f32>, q: &[f32; MAX_JOINTS], joint: usize) -> Option<([f32; 3], f64)> {
    let count = device.axes();
    let column = |j: usize| device.mechanism.torque::<Libm>(q, &core::array::from_fn(|i| f32::from(u8::from(i == j))));
    let transposed = Matrix3::from_fn(|i, j| match i < count && j < count {
        true => f64::from(column(j)[i]),
        false => f64::from(u8::from(i == j)),
    });
    let force = transposed.try_inverse()? * Vector3::from_fn(|i, _| f64::from(u8::from(i == joint)));
    let size = force.norm();
    (size.is_finite() && size > 0.0).then(|| (core::array::from_fn(|i| (force[i] / size) as f32), 1.0 / size))
}

/// Returns the part of a joint's range around `q` in which the leverage of all joints changes little.
fn regular_arc(
    device: &Device<f32>,
    q: &[f32; MAX_JOINTS],
    joint: usize,
    (low, high): (f64, f64),
) -> Option<(f64, f64)> {
    let leverage = |angle: f64| {
        let mut pose = *q;
        pose[joint] = angle as f32;
        let leverage = device.mechanism.leverage::<Libm>(&pose);
        [0, 1, 2].map(|j| if j < device.axes() { leverage.force_bound(j) } else { 1.0 })
    };
    let here = f64::from(q[joint]);
    let first = leverage(here);
    let regular = |angle: f64| {
        let ratios = leverage(angle).into_iter().zip(first).map(|(there, here)| there / here);
        // Written so that NaN is not regular.
        ratios.into_iter().all(|ratio| ratio <= MAX_LEVERAGE_RATIO && ratio * MAX_LEVERAGE_RATIO >= 1.0)
    };
    let end = |to: f64| {
        let place = |i: u32| here + (to - here) * f64::from(i) / f64::from(CHECKED_POSES);
        (0..=CHECKED_POSES).take_while(|i| regular(place(*i))).last().map(place)
    };
    let arc = (end(low)?, end(high)?);
    (arc.0 < here && here < arc.1).then_some(arc)
}
