//! Motors that cannot make all that a wall asks for: the force keeps its direction and never falls as depth grows,
//! gravity stays compensated, and nothing jumps where a limit is reached.

use haptic::device_file::DeviceFile;
use haptic_bridge::drive::brushed::Bridge;
use haptic_bridge::math::{Libm, Minimax};
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::description::Encoder;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::Mechanism;
use haptic_bridge::model::precomputed::MassModelData;
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, Wall};
use haptic_bridge::safety::fault::State;
use haptic_bridge::safety::limits::Limits;
use haptic_bridge::servo::frame::Samples;
use haptic_bridge::servo::program::{Hardware, Program};
use haptic_bridge::servo::{Command, HostAction, Rules, Servo};
use haptic_bridge::with_mechanism;
use nalgebra::SVector;

const COUNTS: f64 = 1.0e8;

/// What motors leave of a wall's force at one depth.
#[derive(Clone, Copy, Debug)]
struct Point {
    /// Depth, m, and the force asked for, N.
    depth: f64,
    asked: f64,
    /// Force at the tip along the normal and across it, N, gravity's torque taken off.
    along: f64,
    across: f64,
    /// What the frame says is left of the force asked for.
    share: f64,
    torque: [f32; MAX_JOINTS],
}

/// The servo at rest ever deeper in a wall through the pose `q`: joint limits in N m, currents in A, the tip's in N.
struct Press {
    device: &'static str,
    q: [f64; 3],
    normal: [f64; 3],
    stiffness: f64,
    feed_forward: FeedForward,
    torque: f32,
    current: f32,
    tip_force: f32,
    /// How many times as strong the motors are as the file says.
    strength: f64,
    /// Control steps at each depth: a washout lets go in seconds.
    steps: u32,
}

impl Press {
    fn points(&self, depths: impl Iterator<Item = f64>) -> Vec<Point> {
        let path = format!("{}/devices/{}.toml", env!("CARGO_MANIFEST_DIR"), self.device);
        let file = DeviceFile::load(path).expect("a shipped device");
        with_mechanism!(&file.mechanism, m => self.run(m, &file, depths))
    }

    fn run<M: Mechanism<f64, N>, const N: usize>(
        &self,
        m: &M,
        file: &DeviceFile,
        depths: impl Iterator<Item = f64>,
    ) -> Vec<Point> {
        let mut description = file.description;
        for joint in &mut description.joints {
            joint.encoder = Some(Encoder { counts_per_turn: COUNTS, offset: 0.0, inverted: false });
            joint.limits = None;
            if let Some(motor) = &mut joint.motor {
                motor.max_current *= self.strength;
            }
        }
        let start = SVector::<f64, N>::from_fn(|i, _| self.q[i]);
        let pose = m.pose::<Libm>(&start);
        let tip = m.tip(&pose);
        let task = M::SPEC.task;
        let n = SVector::<f64, N>::from_fn(|i, _| if i < task { self.normal[i] } else { 0.0 });
        let three = |v: &SVector<f64, N>| core::array::from_fn(|i| if i < task.min(N) { v[i] as f32 } else { 0.0 });
        let wall = Wall {
            surface: Surface::Plane(Plane { point: three(&tip), normal: three(&n) }),
            stiffness: self.stiffness as f32,
            damping: 0.0,
            feed_forward: self.feed_forward,
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
            torque: [self.torque; MAX_JOINTS],
            current: [self.current; MAX_JOINTS],
            continuous_current: [self.current; MAX_JOINTS],
            speed: [1.0e3; MAX_JOINTS],
            power: 1.0e6,
            tip_force: self.tip_force,
            ..Limits::default()
        };
        let hardware = Hardware {
            axes: 3,
            real: false,
            bus_sensed: false,
            timer_hz: 168_000_000,
            bridge: Bridge { carrier_hz: 20_000.0, dead_time: 0.0, bandwidth_hz: 1_000.0, current_sensed: false },
        };
        let device = Device::new(&file.name, &description).expect("a sound device");
        let mut servo: Servo<Box<Program<Minimax>>> =
            Servo::new(hardware, Rules { limits, host_action: HostAction::Ignore, ..Rules::default() });
        let program = Program::new(&hardware, &limits, &device, &scene, &MassModelData::Exact, false).expect("fits");
        servo.execute(Command::Program(Box::new(program))).0.expect("a program that fits");
        let mut go =
            |q: &SVector<f64, N>, steps: u32| {
                let counts = core::array::from_fn(|i| {
                    if i < N { (q[i] / std::f64::consts::TAU * COUNTS).round() as i32 } else { 0 }
                });
                for _ in 0..steps {
                    servo.control(&Samples { counts, bus_voltage: 24.0, ..Samples::default() });
                    servo.duties(24.0, &[0.0; MAX_JOINTS]);
                    if servo.status().state == State::Disarmed {
                        servo.execute(Command::Arm).0.expect("nothing is in the way");
                    }
                }
                *servo.frame()
            };
        go(&start, 1_000);
        let inward = m.inverse(&pose, &-n);
        depths
            .map(|depth| {
                let q = start + inward * depth;
                let frame = go(&q, self.steps);
                assert_eq!(frame.state, State::Armed, "at {depth} m");
                let pose = m.pose::<Libm>(&q);
                let torque = SVector::<f64, N>::from_fn(|i, _| f64::from(frame.torque[i])) - m.gravity(&pose);
                // On a redundant arm the orientation's torque is not a force at the tip.
                let force = m.jacobian_inverse(&pose).tr_mul(&torque);
                let along = n.dot(&force);
                let across = (0..task).map(|i| (force[i] - n[i] * along).powi(2)).sum::<f64>().sqrt();
                Point {
                    depth,
                    asked: f64::from(frame.wall_force),
                    along,
                    across,
                    share: if frame.wall_force > 0.0 {
                        f64::from(frame.rendered_force / frame.wall_force)
                    } else {
                        1.0
                    },
                    torque: frame.torque,
                }
            })
            .collect()
    }
}

/// The demo's pose and normal with motors of 2 N m.
fn demo(feed_forward: FeedForward) -> Press {
    let angle = 75_f64.to_radians();
    Press {
        device: "coupled-five-bar",
        q: [2.6, 1.75, 0.0],
        normal: [angle.cos(), angle.sin(), 0.0],
        stiffness: 20_000.0,
        feed_forward,
        torque: 2.0,
        current: 100.0,
        tip_force: 1.0e9,
        strength: 1.0,
        steps: 200,
    }
}

/// Depths to 2 mm, 40 N in the demo's wall.
fn depths() -> impl Iterator<Item = f64> {
    (0..=200).map(|i| 1.0e-5 * f64::from(i))
}

#[test]
fn the_demo_holds_what_its_motors_can_along_the_normal_and_nothing_sideways() {
    // Motors' own limit (3 A at 0.667 N m/A) and a torque limit of 2 N m say the same.
    for press in [demo(FeedForward::Off), Press { torque: 100.0, ..demo(FeedForward::Off) }] {
        for point in press.points([1.0e-3, 1.5e-3, 2.0e-3].into_iter()) {
            // The way in is straight in joint angles: 0.3 % off at 2 mm.
            assert!((point.asked / (20_000.0 * point.depth) - 1.0).abs() < 0.005, "{point:?}");
            // The pose moves by up to 2 mm, and with it what 2 N m make: 19.4 N at the surface.
            assert!((point.along - 19.4).abs() < 0.4, "{point:?}");
            assert!(point.across < 1.0e-3, "{point:?}");
            assert!((point.share - point.along / point.asked).abs() < 1.0e-3, "{point:?}");
            assert!(point.torque.iter().any(|torque| (torque.abs() - 2.0).abs() < 1.0e-5), "{point:?}");
        }
    }
}

#[test]
fn the_force_along_the_normal_never_falls_and_nothing_jumps() {
    for feed_forward in [FeedForward::Off, FeedForward::Full, FeedForward::Washout] {
        let points = demo(feed_forward).points(depths());
        let mut cut = 0;
        for pair in points.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            // What 2 N m make at the tip changes with the pose by 0.2 N per mm: 2 mN in a hundredth.
            assert!(b.along >= a.along - 5.0e-3, "{feed_forward:?}: {a:?} {b:?}");
            assert!((b.along - a.along).abs() < 0.21, "0.2 N more are asked for: {a:?} {b:?}");
            assert!((b.across - a.across).abs() < 0.25, "{feed_forward:?}: {a:?} {b:?}");
            assert!(b.share <= a.share + 1.0e-4 && b.share > 0.0, "{feed_forward:?}: {a:?} {b:?}");
            cut += u32::from(b.share < 0.999);
        }
        assert!(cut > 50, "the motors are at their limit: {cut}");
        let last = points[points.len() - 1];
        match feed_forward {
            FeedForward::Off => assert!(last.across < 1.0e-3, "{last:?}"),
            // The feed-forward's own sideways force belongs to what is rendered: it grows with it and no further.
            _ => {
                let before = points.iter().rev().find(|p| p.share > 0.9999).expect("small forces are not cut");
                let per_newton = before.across / before.along;
                assert!(last.across <= per_newton * last.along * 1.02 + 1.0e-3, "{before:?} {last:?}");
            }
        }
    }
}

#[test]
fn a_hand_that_rests_on_a_wall_beyond_the_motors_feels_no_sideways_force_with_the_washout() {
    let points = Press { steps: 3_000, ..demo(FeedForward::Washout) }.points([2.0e-3].into_iter());
    assert!(points[0].across < 1.0e-3 && (points[0].along - 19.4).abs() < 0.4, "{points:?}");
}

#[test]
fn gravity_stays_compensated_however_deep_the_wall_is_pressed() {
    for device in ["phantom-premium-1.5", "woodenhaptics"] {
        let press = Press {
            device,
            q: [0.3, 0.9, -0.3],
            normal: [0.6, 0.0, 0.8],
            stiffness: 5_000.0,
            feed_forward: FeedForward::Off,
            torque: 0.6,
            current: 100.0,
            tip_force: 1.0e9,
            strength: 1.0,
            steps: 50,
        };
        let points = press.points((0..=40).map(|i| 1.0e-4 * f64::from(i)));
        let last = points[points.len() - 1];
        assert!(last.share < 0.9, "{device} is at its limit: {last:?}");
        for pair in points.windows(2) {
            assert!(pair[1].along >= pair[0].along - 2.0e-2, "{device}: {pair:?}");
            // Nothing sideways: along and across are what is left without gravity's torque.
            assert!(pair[1].across < 5.0e-3, "{device}: {pair:?}");
        }
    }
}

#[test]
fn walls_push_with_the_tips_limit_and_no_more_in_every_pose() {
    let pressed = |device, q, normal, feed_forward| {
        // A limit of 5 N is what acts.
        let strong = Press { torque: 1.0e3, current: 1.0e4, strength: 100.0, ..demo(feed_forward) };
        let press = Press { device, q, normal, tip_force: 5.0, steps: 300, ..strong };
        let points = press.points((0..=20).map(|i| 5.0e-5 * f64::from(i)));
        for point in &points {
            assert!(point.along <= 5.005, "{device} at {q:?}: {point:?}");
            assert!(
                (point.share - point.along / point.asked.max(1.0e-9)).abs() < 2.0e-3 || point.asked < 0.1,
                "{point:?}"
            );
        }
        let last = points[points.len() - 1];
        assert!(last.asked > 19.0 && (last.along - 5.0).abs() < 5.0e-3, "{device} at {q:?}: {last:?}");
        last.across
    };
    for angle in [0.3_f64, 1.3, 2.9] {
        let (sin, cos) = angle.sin_cos();
        for feed_forward in [FeedForward::Off, FeedForward::Full, FeedForward::Washout] {
            for q in [[2.6, 1.75, 0.0], [2.4, 1.6, 0.0], [2.8, 1.9, 0.0]] {
                let across = pressed("coupled-five-bar", q, [cos, sin, 0.0], feed_forward);
                // The feed-forward's sideways push is not what was asked for, and is cut with it.
                assert!(feed_forward != FeedForward::Off || across < 1.0e-3, "{across} N sideways");
            }
        }
        for device in ["phantom-premium-1.5", "woodenhaptics"] {
            for q in [[0.3, 0.9, -0.3], [-0.2, 0.7, -0.5]] {
                let across = pressed(device, q, [cos * 0.6, sin * 0.6, 0.8], FeedForward::Off);
                assert!(across < 5.0e-3, "{device}: {across} N sideways");
            }
        }
    }
}
