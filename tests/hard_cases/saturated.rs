//! Motors that cannot make what a wall asks for: what is left along the normal and across it, of the servo's f32 torques.

use super::singular::Random;
use super::{Table, digits, shipped};
use haptic_bridge::drive::brushed::Bridge;
use haptic_bridge::math::{Libm, Minimax};
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::description::{Description, Encoder};
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
use haptic_bridge::model::precomputed::MassModelData;
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, Wall};
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::limits::Limits;
use haptic_bridge::servo::frame::Samples;
use haptic_bridge::servo::program::{Hardware, Program};
use haptic_bridge::servo::{Command, HostAction, Rules, Servo};
use nalgebra::SVector;

const COUNTS: f64 = 1.0e8;
const POSES: usize = 12;
/// N/m
const STIFFNESS: f64 = 20_000.0;

/// One row of the table.
#[derive(Clone, Debug)]
pub struct Row {
    pub device: &'static str,
    /// Sines of the poses.
    pub sines: [f64; 2],
    /// Largest force asked for over the largest that the motors can make.
    pub beyond: f64,
    /// Largest error of the force along the normal as a share of what can be made, without and with the feed-forward.
    pub along: [f64; 2],
    /// Largest force across the normal, as the same share, without the feed-forward: none was asked for.
    pub across: f64,
}

/// The servo with a wall through `tip`, armed.
struct Press {
    servo: Servo<Box<Program<Minimax>>>,
}

impl Press {
    fn new(device: &Description, tip: [f32; 3], normal: [f32; 3], feed_forward: FeedForward, torque: f32) -> Self {
        let task = device.kind.spec().task;
        let wall = Wall {
            surface: Surface::Plane(Plane { point: tip, normal }),
            stiffness: STIFFNESS as f32,
            damping: 0.0,
            feed_forward,
            washout_hz: 2.0,
            damping_compensation: false,
            bilateral: true,
        };
        let scene = Scene {
            task: task as u8,
            rate_hz: 1_000.0,
            cutoff_hz: 100.0,
            walls: [wall].into_iter().collect(),
            ..Scene::default()
        };
        let limits = Limits {
            torque: [torque; MAX_JOINTS],
            current: [1.0e3; MAX_JOINTS],
            continuous_current: [1.0e3; MAX_JOINTS],
            speed: [1.0e3; MAX_JOINTS],
            power: 1.0e6,
            tip_force: 1.0e9,
            ..Limits::default()
        };
        let bridge = Bridge { carrier_hz: 20_000.0, dead_time: 0.0, bandwidth_hz: 1_000.0, current_sensed: false };
        let hardware = Hardware { axes: 3, real: false, bus_sensed: false, timer_hz: 168_000_000, bridge };
        let device = Device::new("hard", device).expect("a sound device");
        let mut servo: Servo<Box<Program<Minimax>>> =
            Servo::new(hardware, Rules { limits, host_action: HostAction::Ignore, ..Rules::default() });
        let program = Program::new(&hardware, &limits, &device, &scene, &MassModelData::Exact, false).expect("fits");
        servo.execute(Command::Program(Box::new(program))).0.expect("a program that fits");
        Self { servo }
    }

    /// Joint torques (N m) and the force asked for (N) after so many steps at a pose.
    fn at<const N: usize>(&mut self, q: &SVector<f64, N>, steps: u32) -> (SVector<f64, N>, f64) {
        let turns = |i: usize| if i < N { q[i] / std::f64::consts::TAU } else { 0.0 };
        let counts = core::array::from_fn(|i| (turns(i) * COUNTS).round() as i32);
        for _ in 0..steps {
            self.servo.control(&Samples { counts, bus_voltage: 24.0, ..Samples::default() });
            self.servo.duties(24.0, &[0.0; MAX_JOINTS]);
            if self.servo.status().state == State::Disarmed {
                self.servo.execute(Command::Arm).0.expect("nothing is in the way");
            }
        }
        let frame = self.servo.frame();
        assert_eq!(frame.state, State::Armed, "at {q}: {:?}", self.servo.status());
        (SVector::from_fn(|i, _| f64::from(frame.torque[i])), f64::from(frame.wall_force))
    }
}

fn row<M: Mechanism<f64, N>, const N: usize>(m: M, name: &'static str, device: &Description, sines: [f64; 2]) -> Row {
    let task = M::SPEC.task;
    let mut random = Random(23);
    let mut row = Row { device: name, sines, beyond: 0.0, along: [0.0; 2], across: 0.0 };
    let mut poses = 0;
    while poses < POSES {
        let q: SVector<f64, N> = random.vector(3.1);
        let mut n: SVector<f64, N> = random.vector(1.0);
        for i in task..N {
            n[i] = 0.0;
        }
        let pose = m.pose::<Libm>(&q);
        let r = m.regularity(&pose);
        if !(sines[0]..sines[1]).contains(&r.serial) || r.parallel < 0.3 || n.norm() < 0.1 {
            continue;
        }
        n /= n.norm();
        poses += 1;
        let narrow = |v: &SVector<f64, N>| core::array::from_fn(|i| if i < task.min(N) { v[i] as f32 } else { 0.0 });
        let normal: [f32; 3] = narrow(&n);
        let n = SVector::<f64, N>::from_fn(|i, _| f64::from(normal[i]));
        // Room for the device's own weight and for 5 N.
        let lever = m.transpose(&pose, &n).amax();
        let torque = (m.gravity(&pose).amax() + 5.0 * lever) as f32;
        for (index, feed_forward) in [FeedForward::Off, FeedForward::Full].into_iter().enumerate() {
            let mut press = Press::new(device, narrow(&m.tip(&pose)), normal, feed_forward, torque);
            press.at(&q, 1_000);
            for step in 1..=20 {
                let inside = q - m.inverse(&pose, &n) * (1.0e-4 * f64::from(step));
                let pose = m.pose::<Libm>(&inside);
                if m.regularity(&pose).serial < 0.8 * sines[0] {
                    break;
                }
                let (found, asked) = press.at(&inside, 100);
                let gravity = m.gravity(&pose);
                // By hand: the largest share of Jᵀ n f that every joint has room for beside the weight.
                let rendered = m.transpose(&pose, &n) * asked;
                let room = |i: usize| (f64::from(torque) - gravity[i] * rendered[i].signum()) / rendered[i].abs();
                let right = asked * (0..N).map(room).fold(1.0, f64::min);
                let force = m.jacobian_inverse(&pose).tr_mul(&(found - gravity));
                let along = n.dot(&force) / n.dot(&n);
                row.beyond = row.beyond.max(asked / right);
                row.along[index] = row.along[index].max((along - right).abs() / right);
                if feed_forward == FeedForward::Off {
                    let across = (0..task).map(|i| (force[i] - n[i] * along).powi(2)).sum::<f64>().sqrt();
                    row.across = row.across.max(across / right);
                }
            }
        }
    }
    row
}

/// Every mechanism that has more than one direction: in the open, and where an elbow's feed-forward begins to fade.
pub fn all() -> Vec<Row> {
    [
        ("five-bar", "coupled-five-bar"),
        ("five-bar-turret", "fictive-five-bar-turret"),
        ("parallelogram", "phantom-premium-1.5"),
        ("serial-3r", "serial-3r"),
    ]
    .into_iter()
    .flat_map(|(name, file)| {
        let mut device = shipped(file);
        for joint in &mut device.joints {
            joint.encoder = Some(Encoder { counts_per_turn: COUNTS, offset: 0.0, inverted: false });
            joint.limits = None;
            if let Some(motor) = &mut joint.motor {
                // The torque limit alone decides.
                motor.max_current = 1.0e3;
            }
        }
        let mechanism = AnyMechanism::<f64>::new(&device).expect("a shipped device is sound");
        haptic_bridge::with_mechanism!(mechanism, m => [[0.3, 1.1], [0.05, 0.1]].map(|sines| row(m, name, &device, sines)))
    })
    .collect()
}

/// The rows as the page shows them.
pub fn table(rows: &[Row]) -> Table {
    let mut table = Table::new(
        "Motors at their limit",
        "A wall of 20 kN/m pressed up to 2 mm, in the whole servo, with motors that have room for the device's weight and 5 N \
         along a random normal; twelve poses each in the open and near a singularity of an elbow. Errors against the largest \
         force that fits, worked out joint by joint in f64, as a share of it. Across the normal nothing is asked for.",
        &["device", "sine", "asked/possible", "**along, plain**", "**across, plain**", "**along, feed-forward**"],
    );
    for row in rows {
        let sines = format!("{:.2} to {:.2}", row.sines[0], row.sines[1].min(1.0));
        let errors = [row.along[0], row.across, row.along[1]].map(digits);
        table.push([row.device.to_string(), sines, format!("{:.0}", row.beyond)].into_iter().chain(errors).collect());
    }
    table
}
