//! Measures how a board's limits reduce the force of a wall, with the firmware's control loop and a device that is held
//! still in the wall.

use haptic_bridge::control::compiled::BoardMath;
use haptic_bridge::control::frame::Samples;
use haptic_bridge::control::joints::Counts;
use haptic_bridge::control::program::{Hardware, Program};
use haptic_bridge::control::{Command, ControlLoop, HostAction, Rules};
use haptic_bridge::drive::stage::Bridge;
use haptic_bridge::math::Libm;
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::description::{Description, Encoder, MAX_SENSED};
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, Wall};
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::limits::Limits;
use haptic_bridge::safety::refusal::Refusal;
use haptic_bridge::with_mechanism;
use nalgebra::SVector;

/// Encoder counts per turn, with which quantisation is negligible.
const FINE_COUNTS_PER_TURN: f64 = 1.0e8;
/// Number of control steps in which a newly armed control loop ramps up its torque.
const RAMP_STEPS: u32 = 1_000;

/// A bilateral wall at 1 kHz, and a device held in it.
#[derive(Clone, Copy, Debug)]
pub struct Press<'a> {
    /// The device, whose encoders and joint limits are ignored.
    pub device: &'a Description,
    /// Joint angles with the tip on the wall, rad.
    pub q: [f64; 3],
    /// The wall's unit normal.
    pub normal: [f64; 3],
    /// Wall stiffness, N/m.
    pub stiffness: f64,
    /// Feed-forward of the wall.
    pub feed_forward: FeedForward,
    /// The board's limits.
    pub limits: Limits,
}

/// Limits that never act.
pub const WIDE_LIMITS: Limits = Limits {
    torque: [1.0e3; MAX_JOINTS],
    current: [1.0e4; MAX_JOINTS],
    continuous_current: [1.0e4; MAX_JOINTS],
    speed: [1.0e3; MAX_JOINTS],
    power: 1.0e6,
    bus_min: 8.0,
    bus_max: 28.0,
    tip_force: 1.0e9,
};

/// The forces on a hand that holds the device at one depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PressForces {
    /// Depth, m.
    pub depth: f64,
    /// Joint angles, rad.
    pub q: [f64; 3],
    /// Joint torques, N m.
    pub torque: [f64; 3],
    /// Force that the wall requests before the limits, N.
    pub requested: f64,
    /// Force within the board's limits, as the board reports it, N.
    pub rendered: f64,
    /// Tip force of the joint torques minus the gravity torques, along the normal, N.
    pub along: f64,
    /// Tip force of the joint torques minus the gravity torques, across the normal, N.
    pub across: f64,
    /// State of the board: armed, unless a fault occurred.
    pub state: State,
}

impl PressForces {
    /// Returns the share of the requested force that the limits leave, as the board reports; 1 if the requested force
    /// is zero.
    pub fn share(&self) -> f64 {
        if self.requested > 0.0 { self.rendered / self.requested } else { 1.0 }
    }
}

/// A board with a held device.
#[derive(Debug)]
pub struct PressedBoard {
    control_loop: ControlLoop<Box<Program<BoardMath>>>,
    mechanism: AnyMechanism<f64>,
    q: [f64; 3],
    /// Joint angles per metre into the wall, rad/m.
    inward: [f64; 3],
    /// The normal in the board's precision.
    normal: [f64; 3],
}

impl PressedBoard {
    /// Creates an armed board with its device on the wall's surface.
    ///
    /// Returns an error if a board refuses the description, the wall or the limits.
    pub fn new(press: &Press<'_>) -> Result<Self, Refusal> {
        let mut description = *press.device;
        for joint in &mut description.joints {
            joint.encoder = Some(Encoder { counts_per_turn: FINE_COUNTS_PER_TURN, offset: 0.0, inverted: false });
            joint.absolute = None;
            joint.limits = None;
        }
        let mechanism = AnyMechanism::<f64>::new(&description).map_err(|_| Refusal::BadDevice)?;
        let normal = press.normal.map(|x| x as f32);
        let (tip, inward) = with_mechanism!(&mechanism, m => surface(m, &press.q, &normal));
        let wall = Wall {
            surface: Surface::Plane(Plane { point: tip.map(|x| x as f32), normal }),
            stiffness: press.stiffness as f32,
            damping: 0.0,
            feed_forward: press.feed_forward,
            washout_hz: 2.0,
            damping_compensation: false,
            bilateral: true,
        };
        let scene = Scene {
            task: description.kind.spec().task as u8,
            rate_hz: 1_000.0,
            cutoff_hz: 100.0,
            walls: [wall].into_iter().collect(),
            ..Scene::default()
        };
        let hardware = Hardware {
            axes: MAX_JOINTS,
            encoders: (MAX_JOINTS + MAX_SENSED) as u8,
            real: false,
            bus_sensed: false,
            timer_hz: super::TIMER_HZ,
            bridge: Bridge {
                carrier_hz: 20_000.0,
                dead_time: 0.0,
                bandwidth_hz: 1_000.0,
                current_sensed: false,
                legs: 2,
            },
        };
        let device = Device::new("held", &description).map_err(|_| Refusal::BadDevice)?;
        let program = Program::new(&hardware, &press.limits, &device, &scene, false)?;
        let rules = Rules { limits: press.limits, host_action: HostAction::Ignore, ..Rules::default() };
        let mut control_loop = ControlLoop::new(hardware, rules);
        control_loop.execute(Command::Program(Box::new(program))).0?;
        let mut held = Self { control_loop, mechanism, q: press.q, inward, normal: normal.map(f64::from) };
        held.hold(&press.q, 1);
        held.control_loop.execute(Command::Arm).0?;
        held.hold(&press.q, RAMP_STEPS);
        Ok(held)
    }

    /// Returns the joint angles at a depth (m), rad, extrapolated linearly from the surface.
    pub fn pose(&self, depth: f64) -> [f64; 3] {
        core::array::from_fn(|i| self.q[i] + self.inward[i] * depth)
    }
    /// Measures the forces after `steps` control steps at a depth (m).
    pub fn forces_at(&mut self, depth: f64, steps: u32) -> PressForces {
        let q = self.pose(depth);
        self.hold(&q, steps);
        let frame = self.control_loop.frame();
        let torque = frame.motors.torque.map(f64::from);
        let (along, across) = self.force(&q, &torque);
        PressForces {
            depth,
            q,
            torque,
            requested: frame.at.walls.wall_force.into(),
            rendered: frame.motors.rendered_force.into(),
            along,
            across,
            state: frame.state,
        }
    }

    /// Returns the tip force of joint torques (N m) minus the gravity torques, along the normal and across it, N. On a
    /// redundant arm the torque about the handle is not included.
    pub fn force(&self, q: &[f64; 3], torque: &[f64; 3]) -> (f64, f64) {
        with_mechanism!(&self.mechanism, m => tip_force(m, q, torque, &self.normal))
    }
    fn hold(&mut self, q: &[f64; 3], steps: u32) {
        let counts = Counts(q.map(|q| (q / std::f64::consts::TAU * FINE_COUNTS_PER_TURN).round() as i32));
        for _ in 0..steps {
            self.control_loop.control(&Samples { counts, bus_voltage: 24.0, ..Samples::default() });
            self.control_loop.duties(24.0, &[0.0; MAX_JOINTS], false);
        }
    }
}

/// Returns the tip (m), and the change of the joint angles per metre against the normal (rad/m).
fn surface<M: Mechanism<f64, N>, const N: usize>(m: &M, q: &[f64; 3], normal: &[f32; 3]) -> ([f64; 3], [f64; 3]) {
    let task = M::SPEC.task;
    let pose = m.pose::<Libm>(&SVector::from_fn(|i, _| q[i]));
    let tip = m.tip(&pose);
    let inward = m.inverse(&pose, &SVector::from_fn(|i, _| if i < task { -f64::from(normal[i]) } else { 0.0 }));
    let three = |v: &SVector<f64, N>, n: usize| core::array::from_fn(|i| if i < n.min(N) { v[i] } else { 0.0 });
    (three(&tip, task), three(&inward, N))
}

fn tip_force<M: Mechanism<f64, N>, const N: usize>(
    m: &M,
    q: &[f64; 3],
    torque: &[f64; 3],
    normal: &[f64; 3],
) -> (f64, f64) {
    let pose = m.pose::<Libm>(&SVector::from_fn(|i, _| q[i]));
    let contact_torque = SVector::<f64, N>::from_fn(|i, _| torque[i]) - m.gravity(&pose);
    let force = m.jacobian_inverse(&pose).tr_mul(&contact_torque);
    let square: f64 = normal.iter().map(|n| n * n).sum();
    let along = (0..M::SPEC.task).map(|i| normal[i] * force[i]).sum::<f64>() / square;
    let across = (0..M::SPEC.task).map(|i| (force[i] - normal[i] * along).powi(2)).sum::<f64>().sqrt();
    (along, across)
}
