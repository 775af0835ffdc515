//! Moves one joint a little while a person holds a key. The board applies a joint torque that lasts 70 ms; this module
//! does the rest. [`Plan`] rejects an unsafe jog, [`ControlLoop`] computes torques from angles without a board, and
//! [`run`] arms, evaluates the control loop a hundred times a second, and always ends with the motors off.
//!
//! The push on a joint at rest grows until the joint moves; then a PI controller holds its speed. Its gains follow from
//! the joint's inertia on the board's device. In every case the torque stays below a share of its limit, and a joint
//! that is faster than twice the requested speed, or moves backward, ends the jog.

use haptic_bridge::board::protocol::{DeviceData, ForceAnswer, ForceDone};
use haptic_bridge::control::ARM_SECONDS;
use haptic_bridge::math::Libm;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::render::scene::Scene;
use haptic_bridge::safety::fault::State;
use haptic_host::error::Failure;
use haptic_host::link::{Board, Session};
use haptic_host::words::{fault_and_remedy, short};
use std::collections::VecDeque;
use std::io;
use std::time::Duration;

/// Time between two torques: half of the time for which a torque acts in full.
const PERIOD: Duration = Duration::from_millis(10);
/// Averaging time of the speed, s: long enough for encoders of 2000 counts a turn.
const WINDOW: f64 = 0.05;
/// Bandwidth of the speed controller, rad/s: its delay of half the window and two periods costs 26 degrees of phase.
const BANDWIDTH: f64 = 10.0;
/// Shortest and longest time in which the push on a joint at rest grows from zero to the largest, s.
const RAMP: (f64, f64) = (2.0, 20.0);
/// Factor that limits the growth of the push to inertia times speed times this, 1/s²: until the motion is detected, the
/// joint gains less than the requested speed. A coarse encoder detects motion later ([`ControlLoop::onset`]).
const ONSET: f64 = 500.0;
/// Time at rest against the largest push after which the joint counts as blocked, s.
const BLOCKED_S: f64 = 0.5;
/// Speed that ends the jog, as a ratio to the requested speed.
const TOO_FAST: f64 = 2.0;
/// The same for the other joints: they are free, and a moved link turns the next joint by up to three times as much.
const OTHER_TOO_FAST: f64 = 5.0;
/// Backward motion that ends the jog, as a share of the requested motion.
const BACKWARD: f64 = 0.1;
/// Counts beyond which an encoder shows a motion: at rest it may vary by one count.
const SHAKE: f64 = 1.5;
/// Time after which torques that arrive too late end the jog, s.
const LATE: f64 = 0.5;
/// Largest share of the torque limit, motion (rad) and speed (rad/s).
const LARGEST: (f64, f64, f64) = (0.5, 1.0, 1.0);

/// A requested jog.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jog {
    /// Index of the joint.
    pub joint: usize,
    /// Distance with sign, rad.
    pub by: f64,
    /// Speed, rad/s; positive.
    pub speed: f64,
    /// Largest push as a share of the joint's torque limit.
    pub share: f64,
}

/// A jog that a board may begin.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    jog: Jog,
    device: DeviceData,
    /// Largest push, N m.
    pub most: f64,
    /// True if the scene holds the device's weight.
    carried: bool,
    /// Scene of free space for a board without a scene, because a board arms only with one.
    free: Option<Scene<f32>>,
}

impl Plan {
    /// Checks with the board that the jog may begin.
    pub fn new(board: &mut Board, jog: Jog) -> Result<Self, Failure> {
        let Jog { joint, by, speed, share } = jog;
        let (most_share, most_by, most_speed) = LARGEST;
        let inside = |value: f64, most: f64| value > 0.0 && value <= most;
        if !inside(by.abs(), most_by) {
            return Err(Failure::wrong(format!(
                "the way is {by} rad, and must be at most {most_by} either way, and not 0"
            )));
        }
        if !inside(speed, most_speed) {
            return Err(Failure::wrong(format!(
                "the speed is {speed} rad/s, and must be more than 0 and at most {most_speed}"
            )));
        }
        if !inside(share, most_share) {
            return Err(Failure::wrong(format!(
                "the share of the torque limit is {share}, and must be more than 0 and at most {most_share}"
            )));
        }
        let device = board.device()?.ok_or_else(|| {
            Failure::impossible("the board has no device").remedy("load one with `haptic device FILE`")
        })?;
        if joint >= device.axes() {
            let last = device.axes() - 1;
            return Err(Failure::wrong(format!(
                "joint {joint} does not exist: the joints of {} are 0 to {last}",
                device.name
            )));
        }
        let status = board.status()?;
        match (status.state, status.fault) {
            (State::Disarmed, _) => {}
            (State::Fault, Some(record)) => return Err(Failure::impossible(fault_and_remedy(&record))),
            _ => return Err(Failure::impossible("the motors are on already").remedy("`haptic disarm` first")),
        }
        if !status.homed && device.joints[joint].limits.is_some() {
            return Err(Failure::impossible("the board does not know where the joint is, and it has limits")
                .remedy("hold the device in its home pose and run `haptic home`"));
        }
        let scene = board.scene()?;
        let renders = scene.as_ref().is_some_and(|scene| {
            !(scene.walls.is_empty()
                && scene.springs.is_empty()
                && scene.posture.is_none()
                && scene.field_damping == 0.0)
        });
        if renders {
            return Err(Failure::impossible("the board's scene renders forces, and a jog needs free space").remedy(
                "load a scene without walls, springs, field and posture, or the device again (`haptic device FILE`)",
            ));
        }
        let limits = board.rules()?.limits;
        if TOO_FAST * speed > f64::from(limits.speed[joint]) {
            let allowed = short(limits.speed[joint]);
            return Err(Failure::wrong(format!(
                "the speed is {speed} rad/s, and the rules let joint {joint} go {allowed}"
            ))
            .remedy("ask for at most half of that"));
        }
        let motor = device.joints[joint].motor.ok_or_else(|| Failure::impossible("this joint has no motor"))?;
        let current = motor.max_current.min(limits.current[joint]);
        let most = share * f64::from((motor.torque_constant * current).min(limits.torque[joint]));
        if !(most > 0.0 && most.is_finite()) {
            return Err(Failure::impossible("the rules or the motor allow no torque").remedy("see `haptic rules`"));
        }
        let carried = scene.as_ref().is_none_or(|scene| scene.gravity_compensation);
        let task = device.mechanism.kind().spec().task as u8;
        let free = || Scene { task, rate_hz: 1000.0, cutoff_hz: 100.0, ..Scene::default() };
        let plan = Self { jog, device, most, carried, free: scene.is_none().then(free) };
        plan.check_goal(&status.q)?;
        Ok(plan)
    }

    /// Rejects a jog from these angles (rad) that ends beyond the joint's limits or where the linkage cannot close.
    fn check_goal(&self, q: &[f32; MAX_JOINTS]) -> Result<(), Failure> {
        let (joint, mut goal) = (self.jog.joint, *q);
        goal[joint] += self.jog.by as f32;
        if let Some((low, high)) = self.device.joints[joint].limits
            && !(low..=high).contains(&goal[joint])
        {
            return Err(Failure::impossible(format!(
                "joint {joint} would go from {} to {} rad, and its limits are {} and {}",
                short(q[joint]),
                short(goal[joint]),
                short(low),
                short(high)
            ))
            .remedy("choose a shorter way, or the other one"));
        }
        if !self.device.mechanism.is_finite_at::<Libm>(&goal) {
            return Err(Failure::impossible(format!("no pose has joint {joint} at {} rad", short(goal[joint])))
                .remedy("choose a shorter way, or the other one"));
        }
        Ok(())
    }

    /// Describes the jog in a sentence.
    pub fn in_words(&self) -> String {
        let Jog { joint, by, speed, share } = self.jog;
        let free = match (self.device.weight, self.carried) {
            (true, true) => "get only the torque that carries the device's weight",
            (true, false) => "get no torque, and nothing carries the device's weight",
            (false, _) => "get no torque",
        };
        let most = short(self.most as f32);
        let scene = if self.free.is_some() { "; the board has no scene, and gets one of free space" } else { "" };
        format!(
            "joint {joint} goes by {by:+} rad at {speed} rad/s, pushed with at most {most} N m ({share} of its limit); \
             other joints {free}{scene}"
        )
    }

    fn control_loop(&self, start: &ForceAnswer) -> ControlLoop {
        ControlLoop::new(
            JogParameters {
                jog: self.jog,
                joints: self.device.axes(),
                most: self.most,
                inertia: inertia_with_others_free(
                    &self.device.mechanism.inertia::<Libm>(&start.q),
                    self.device.axes(),
                    self.jog.joint,
                ),
                count: self.device.joints.map(|joint| f64::from(joint.radians_per_count).abs()),
            },
            start.q.map(f64::from),
        )
    }
}

/// Returns the inertia that a torque at `joint` accelerates while the other joints are free, kg m²: 1/(M⁻¹)ᵢᵢ.
fn inertia_with_others_free(mass: &[[f32; MAX_JOINTS]; MAX_JOINTS], joints: usize, joint: usize) -> f64 {
    let mut mass = mass.map(|row| row.map(f64::from));
    for other in (0..joints).filter(|other| *other != joint) {
        let pivot = mass[other];
        for row in (0..joints).filter(|row| *row != other) {
            let factor = mass[row][other] / pivot[other];
            (0..joints).for_each(|column| mass[row][column] -= factor * pivot[column]);
        }
    }
    mass[joint][joint]
}

/// Parameters of a [`ControlLoop`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JogParameters {
    /// The requested jog.
    pub jog: Jog,
    /// Number of joints of the device.
    pub joints: usize,
    /// The largest push, N m.
    pub most: f64,
    /// Inertia of the moving joint, kg m².
    pub inertia: f64,
    /// Angle per encoder count of each joint, rad.
    pub count: [f64; MAX_JOINTS],
}

/// The reason for a jog's end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JogEnd {
    /// The joint completed its motion.
    Arrived,
    /// The key was released.
    Released,
    /// A person requested the end.
    Stopped,
    /// The joint exceeded twice the requested speed.
    TooFast,
    /// The joint moved backward.
    Backward,
    /// Another joint moved by itself.
    Other(usize),
    /// The joint stood still against the largest push.
    Stuck,
}

impl JogEnd {
    /// Returns a sentence for an expected end, and an error otherwise.
    pub fn in_words(self) -> Result<&'static str, Failure> {
        let failed = |why: &str, remedy: &str| Err(Failure::impossible(why).remedy(remedy));
        match self {
            Self::Arrived => Ok("it has gone its way"),
            Self::Released => Ok("the key was let go"),
            Self::Stopped => Ok("ended as asked"),
            Self::TooFast => failed(
                "the joint moved faster than twice the speed asked for",
                "let nothing push it, see that its weight is carried, and try a smaller share of the torque limit",
            ),
            Self::Backward => failed(
                "the joint moved against the push",
                "let nothing push it and see that its weight is carried; else motor and encoder disagree: run \
                 `haptic polarity`",
            ),
            Self::Other(joint) => Err(Failure::impossible(format!("joint {joint} moved by itself")).remedy(
                "let nothing push it, see that its weight is carried, and that each motor has its own encoder",
            )),
            Self::Stuck => failed(
                "the joint stands still against the largest push: it stands against something, or friction is more",
                "see what holds it; if nothing does, use a larger share of the torque limit",
            ),
        }
    }
}

/// Computes the torque of a jog from the joint angles.
#[derive(Clone, Debug)]
pub struct ControlLoop {
    aim: JogParameters,
    from: [f64; MAX_JOINTS],
    /// Recent angles, each with its time (s since the start) and the push at that time (N m).
    seen: VecDeque<(f64, [f64; MAX_JOINTS], f64)>,
    push: f64,
    moves: bool,
    /// Time since which the largest push has moved nothing.
    pushed: Option<f64>,
}

impl ControlLoop {
    /// Begins at these angles (rad) and time 0, when the motors are switched on.
    pub fn new(aim: JogParameters, from: [f64; MAX_JOINTS]) -> Self {
        Self { aim, from, seen: VecDeque::from([(0.0, from, 0.0)]), push: 0.0, moves: false, pushed: None }
    }

    /// Returns the torque at a time (s) and these angles (rad), or the reason for the end. Times must increase from
    /// call to call.
    pub fn step(&mut self, time: f64, q: [f64; MAX_JOINTS]) -> Result<f64, JogEnd> {
        let JogParameters { jog: Jog { joint, by, speed, .. }, most, inertia, count, .. } = self.aim;
        let sign = by.signum();
        let moved = sign * (q[joint] - self.from[joint]);
        self.guard(time, &q, moved)?;
        if moved >= by.abs() {
            return Err(JogEnd::Arrived);
        }
        let last = self.seen.back().map_or(0.0, |(before, ..)| time - before);
        while self.seen.get(1).is_some_and(|(before, ..)| time - before >= WINDOW) {
            self.seen.pop_front();
        }
        let (before, earlier, push) = self.seen.front().copied().unwrap_or((0.0, self.from, 0.0));
        let recent_motion = sign * (q[joint] - earlier[joint]);
        // While torque ramps up after arming, only the guards act.
        if time >= f64::from(ARM_SECONDS) {
            let velocity = recent_motion / (time - before).max(1e-3);
            // The joint slows down at the end, because nothing brakes it once the motors are off.
            let target_speed = speed * (4.0 * (1.0 - moved / by.abs())).clamp(0.2, 1.0);
            let moves = recent_motion.abs() > SHAKE * count[joint];
            if moves && !self.moves {
                // Remove the push that was added since the motion began.
                self.push = push;
            }
            self.moves = moves;
            let (slope, proportional) = match moves {
                true => {
                    let proportional = BANDWIDTH * inertia * (target_speed - velocity);
                    (0.25 * BANDWIDTH * proportional, proportional)
                }
                false => (self.onset().clamp(most / RAMP.1, most / RAMP.0), 0.0),
            };
            self.push = (self.push + slope * last.min(WINDOW)).clamp(-most, most);
            let torque = (self.push + proportional).clamp(-most, most);
            let holds = !moves && torque >= most;
            let since = *self.pushed.get_or_insert(time);
            if !holds {
                self.pushed = None;
            } else if time - since >= BLOCKED_S {
                return Err(JogEnd::Stuck);
            }
            self.seen.push_back((time, q, self.push));
            return Ok(sign * torque);
        }
        self.seen.push_back((time, q, 0.0));
        Ok(0.0)
    }

    /// Returns the largest growth of the push on a joint at rest, N m/s. A free joint reaches the speed jt²/2 and the
    /// angle jt³/6, where j is the growth over its inertia. Motion is detected after two to three counts, and the joint
    /// must not exceed the requested speed by then.
    fn onset(&self) -> f64 {
        let JogParameters { jog: Jog { joint, speed, .. }, inertia, count, .. } = self.aim;
        let angle = 3.0 * count[joint];
        inertia * (ONSET * speed).min(2.0 * speed.powi(3) / (9.0 * angle * angle))
    }

    /// Ends motions that are too fast or backward.
    fn guard(&self, time: f64, q: &[f64; MAX_JOINTS], moved: f64) -> Result<(), JogEnd> {
        let JogParameters { jog: Jog { joint, by, speed, .. }, joints, count, .. } = self.aim;
        if moved < -(BACKWARD * by.abs()).max(4.0 * count[joint]) {
            return Err(JogEnd::Backward);
        }
        for (before, earlier, _) in &self.seen {
            for i in 0..joints {
                let most = if i == joint { TOO_FAST } else { OTHER_TOO_FAST } * speed;
                // The comparison is false for NaN, so NaN counts as too fast.
                let slow = (q[i] - earlier[i]).abs() <= most * (time - before) + 2.0 * count[i];
                match slow {
                    true => {}
                    false if i == joint => return Err(JogEnd::TooFast),
                    false => return Err(JogEnd::Other(i)),
                }
            }
        }
        Ok(())
    }
}

/// State of the key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key {
    /// The key is down, and was not yet down at this control step of the board ([`Board::step`]).
    Down(u32),
    /// The key is up.
    Up,
    /// The person at the key wants to end.
    End,
}

/// Result of a jog.
#[derive(Debug)]
pub struct JogResult {
    /// Reason for the end; an error if the board or the connection ended it.
    pub ended: Result<JogEnd, Failure>,
    /// Motion of the joint, rad, once the motors are off; `None` if they were never on, or the board did not report it.
    pub moved: Option<f64>,
}

/// Waits for the key, moves the joint while it is held, and leaves the motors off. `key` is called a hundred times a
/// second with the newest control step that the board reported.
pub fn run(session: &mut Session, plan: &Plan, key: impl FnMut(u32) -> io::Result<Option<Key>>) -> JogResult {
    let mut from = None;
    let ended = jog_while_held(session, plan, key, &mut from);
    let off = session.disarm();
    let joint = plan.jog.joint;
    let moved = from.and_then(|from: f32| session.status().ok().map(|status| f64::from(status.q[joint] - from)));
    JogResult { ended: ended.and_then(|ended| Ok(off.map(|()| ended)?)), moved }
}

fn jog_while_held(
    session: &mut Session,
    plan: &Plan,
    mut key: impl FnMut(u32) -> io::Result<Option<Key>>,
    from: &mut Option<f32>,
) -> Result<JogEnd, Failure> {
    if let Some(scene) = &plan.free {
        session.set_scene(scene)?;
    }
    session.keep_alive();
    let seen = loop {
        session.rows(PERIOD)?;
        match key(session.step()).map_err(Failure::impossible)? {
            Some(Key::Down(seen)) => break seen,
            Some(Key::End) => return Ok(JogEnd::Stopped),
            _ => {}
        }
    };
    let start = session.look()?;
    plan.check_goal(&start.q)?;
    session.arm_held(seen)?;
    let mut control_loop = plan.control_loop(&start);
    *from = Some(start.q[plan.jog.joint]);
    let seconds = |answer: &ForceAnswer| f64::from(answer.step.wrapping_sub(start.step)) * f64::from(answer.period);
    let mut taken = 0.0;
    loop {
        session.rows(PERIOD)?;
        match key(session.step()).map_err(Failure::impossible)? {
            Some(Key::Up) => return Ok(JogEnd::Released),
            Some(Key::End) => return Ok(JogEnd::Stopped),
            Some(Key::Down(seen)) => session.hold_key(seen)?,
            None => {}
        }
        let now = session.look()?;
        match (now.state, session.fault()) {
            (State::Armed, _) => {}
            (_, Some(record)) => return Err(Failure::impossible(fault_and_remedy(&record))),
            _ => return Err(Failure::impossible("the motors were turned off from elsewhere")),
        }
        let mut torque = [0.0; MAX_JOINTS];
        match control_loop.step(seconds(&now), now.q.map(f64::from)) {
            Ok(push) => torque[plan.jog.joint] = push as f32,
            Err(ended) => return Ok(ended),
        }
        let answer = session.torque(torque)?;
        match answer.done {
            ForceDone::Taken => taken = seconds(&answer),
            ForceDone::Bad(_) => return Err(Failure::impossible(answer.done)),
            // The next poll shows if the motors are still on.
            _ if seconds(&answer) - taken < LATE => {}
            _ => return Err(Failure::impossible(format!("the way to the board is too slow: {}", answer.done))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    #[test]
    fn joint_inertia_is_that_with_the_other_joints_free() {
        let mass = [[3.0, 1.0, 0.5], [1.0, 2.0, 0.3], [0.5, 0.3, 1.0]];
        let inverse = Matrix3::from_fn(|i, j| f64::from(mass[i][j])).try_inverse().unwrap();
        for joint in 0..3 {
            assert!((inertia_with_others_free(&mass, 3, joint) * inverse[(joint, joint)] - 1.0).abs() < 1e-6);
        }
        assert_eq!(inertia_with_others_free(&mass, 1, 0), 3.0);
    }

    /// Simulates a mass (kg m²) with dry friction (N m) behind an encoder, pushed every 12 ms; `drive` turns the
    /// commanded torque into the one that acts. Returns the end, the final angle (rad) and the highest speed (rad/s).
    fn simulate_push(aim: JogParameters, friction: f64, drive: impl Fn(f64) -> f64) -> (JogEnd, f64, f64) {
        let (mut angle, mut speed, mut fastest) = (0.0_f64, 0.0_f64, 0.0_f64);
        let (mut control_loop, step) = (ControlLoop::new(aim, [0.0; 3]), 1e-4);
        for period in 1..10_000 {
            let shown = (angle / aim.count[0]).floor() * aim.count[0];
            let torque = match control_loop.step(0.012 * f64::from(period), [shown, 0.0, 0.0]) {
                Ok(torque) => drive(torque),
                Err(ended) => return (ended, angle, fastest),
            };
            assert!(torque.abs() <= aim.most);
            for _ in 0..120 {
                let free = speed + step * torque / aim.inertia;
                let held = step * friction / aim.inertia;
                speed = free.signum() * (free.abs() - held).max(0.0);
                angle += step * speed;
                fastest = fastest.max(speed.abs());
            }
        }
        panic!("still moving at {angle} rad");
    }

    fn parameters(inertia: f64, by: f64, counts: f64) -> JogParameters {
        let jog = Jog { joint: 0, by, speed: 0.2, share: 0.2 };
        JogParameters { jog, joints: 2, most: 0.05, inertia, count: [std::f64::consts::TAU / counts; 3] }
    }

    #[test]
    fn every_joint_and_friction_arrives_within_the_speed_guard() {
        for inertia in [5e-5, 2e-4, 1e-3, 1e-2] {
            for friction in [0.0, 0.002, 0.03] {
                for counts in [2000.0, 20_000.0] {
                    for by in [0.1, -0.1, 0.4] {
                        let aim = parameters(inertia, by, counts);
                        let (ended, angle, fastest) = simulate_push(aim, friction, |torque| torque);
                        let case =
                            format!("{inertia} kg m², {friction} N m, {counts}, {by}: {angle} rad, {fastest} rad/s");
                        assert_eq!(ended, JogEnd::Arrived, "{case}");
                        // The encoder does not resolve one count in the window.
                        let most = TOO_FAST * 0.2 + aim.count[0] / WINDOW;
                        assert!((angle - by).abs() < 0.006 && fastest < most, "{case}");
                    }
                }
            }
        }
    }

    #[test]
    fn inverted_motors_and_high_friction_end_the_jog() {
        for inertia in [1e-4, 1e-3, 1e-2] {
            for by in [0.1, -0.1] {
                let aim = parameters(inertia, by, 20_000.0);
                let (ended, angle, _) = simulate_push(aim, 0.01, |torque| -torque);
                assert!(matches!(ended, JogEnd::Backward | JogEnd::TooFast), "{ended:?}");
                assert!(angle.abs() < 0.1, "{angle}");
                assert_eq!(simulate_push(aim, 0.06, |torque| torque).0, JogEnd::Stuck);
            }
        }
    }
}
