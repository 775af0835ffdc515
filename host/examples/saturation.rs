//! What the tip feels of a wall that is pressed beyond its motors: the board's servo, and for comparison the same torques
//! limited joint by joint. Draws docs/results/saturation.svg: `cargo run -p haptic --example saturation`.

use haptic::device_file::DeviceFile;
use haptic::plot::axes::{Axis, Frame, Mark};
use haptic::plot::canvas::{Anchor, Canvas, Stroke};
use haptic::plot::colour::{FAINT, FULL, OFF};
use haptic_bridge::drive::brushed::Bridge;
use haptic_bridge::math::{Libm, Minimax};
use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::model::description::Encoder;
use haptic_bridge::model::device::Device;
use haptic_bridge::model::mechanism::{AnyMechanism, Mechanism};
use haptic_bridge::model::precomputed::MassModelData;
use haptic_bridge::render::scene::{FeedForward, Plane, Scene, Surface, Wall};
use haptic_bridge::safety::limits::Limits;
use haptic_bridge::servo::frame::Samples;
use haptic_bridge::servo::program::{Hardware, Program};
use haptic_bridge::servo::{Command, HostAction, Rules, Servo};
use nalgebra::Vector2;
use std::path::Path;

/// The demo's pose, rad, and the angle of its wall's normal, rad.
const POSE: [f64; 2] = [2.6, 1.75];
const NORMAL: f64 = 75.0 * std::f64::consts::PI / 180.0;
const STIFFNESS: f64 = 20_000.0;
/// What each motor makes, N m.
const LIMIT: f64 = 2.0;
const COUNTS: f64 = 1.0e8;

/// Depth, m; joint angles there, rad; joint torques, N m.
type Pressed = (f64, Vector2<f64>, Vector2<f64>);
/// Forces at the tip, N, along the normal and sideways, over depth, m.
type Forces = Vec<(f64, [f64; 2])>;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
    let file = DeviceFile::load(format!("{root}/devices/coupled-five-bar.toml"))?;
    let (cut, asked) = (pressed(&file, LIMIT as f32)?, pressed(&file, 1.0e3)?);
    let jointly: Forces = forces(&file, &asked, |torque| torque.map(|t| t.clamp(-LIMIT, LIMIT)))?;
    let cut: Forces = forces(&file, &cut, |torque| torque)?;
    println!("depth mm, one factor: along N, sideways N; joint by joint: along N, sideways N");
    for (one, each) in cut.iter().zip(&jointly).skip(50).step_by(50) {
        let ([a, b], [c, d]) = (one.1, each.1);
        println!("{:.2} {a:.1} {b:.1} {c:.1} {d:.1}", 1.0e3 * one.0);
    }

    let mut canvas = Canvas::new(720.0, 486.0);
    let frame = Frame {
        at: (86.0, 82.0),
        size: (610.0, 340.0),
        x: Axis { name: "depth in the wall".into(), unit: "m".into(), low: 0.0, high: 2.0e-3 },
        y: Axis { name: "force at the tip".into(), unit: "N".into(), low: 0.0, high: 42.0 },
    };
    let curve = |forces: &Forces, i: usize| forces.iter().map(|(depth, f)| (*depth, f[i].abs())).collect::<Vec<_>>();
    let line = |colour, dash| Stroke { colour, width: 2.0, dash };
    let curves = [
        (curve(&cut, 0), line(OFF, ""), "along the normal, all joints by one factor"),
        (curve(&cut, 1), line(FULL, ""), "sideways, all joints by one factor"),
        (curve(&jointly, 0), line(OFF, "6 3"), "along the normal, joint by joint"),
        (curve(&jointly, 1), line(FULL, "6 3"), "sideways, joint by joint"),
        (vec![(0.0, 0.0), (2.0e-3, STIFFNESS * 2.0e-3)], line(FAINT, "2 3"), "asked for"),
    ];
    frame.clipped(&mut canvas, |canvas| {
        for (points, stroke, _) in &curves {
            frame.curve(canvas, points, *stroke);
        }
    });
    frame.draw(&mut canvas, "");
    canvas.text((frame.at.0, 28.0), 15.0, Anchor::Start, false, "A wall pressed beyond its motors keeps its direction");
    let about = "coupled five-bar at (2.6, 1.75) rad, 20 kN/m along 75°, motors of 2 N m, no feed-forward";
    canvas.text((frame.at.0, 48.0), 12.0, Anchor::Start, false, about);
    let entries: Vec<(Mark<'_>, String)> =
        curves.iter().map(|(_, stroke, text)| (Mark::Line(*stroke), (*text).to_string())).collect();
    Frame::legend(&mut canvas, frame.at.0 + 320.0, frame.at.1 + 10.0, &entries);
    let picture = canvas.finish("saturation", "Force along the normal and sideways over the depth in a wall.");
    picture.save_svg(&Path::new(root).join("docs/results/saturation.svg"))?;
    Ok(())
}

/// Joint angles and torques of the servo at each depth, its motors limited to `limit` (N m).
fn pressed(file: &DeviceFile, limit: f32) -> Result<Vec<Pressed>, Box<dyn std::error::Error>> {
    let AnyMechanism::FiveBar(m) = &file.mechanism else { return Err("not a five-bar".into()) };
    let mut description = file.description;
    for joint in &mut description.joints {
        joint.encoder = Some(Encoder { counts_per_turn: COUNTS, offset: 0.0, inverted: false });
        joint.limits = None;
        if let Some(motor) = &mut joint.motor {
            motor.max_current = 1.0e4;
        }
    }
    let start = Vector2::from(POSE);
    let pose = m.pose::<Libm>(&start);
    let (tip, n) = (m.tip(&pose), Vector2::new(NORMAL.cos(), NORMAL.sin()));
    let wall = Wall {
        surface: Surface::Plane(Plane {
            point: [tip[0] as f32, tip[1] as f32, 0.0],
            normal: [n[0] as f32, n[1] as f32, 0.0],
        }),
        stiffness: STIFFNESS as f32,
        damping: 0.0,
        feed_forward: FeedForward::Off,
        washout_hz: 2.0,
        damping_compensation: false,
        bilateral: true,
    };
    let scene =
        Scene { task: 2, rate_hz: 1_000.0, cutoff_hz: 100.0, walls: [wall].into_iter().collect(), ..Scene::default() };
    let limits = Limits {
        torque: [limit; MAX_JOINTS],
        current: [1.0e4; MAX_JOINTS],
        continuous_current: [1.0e4; MAX_JOINTS],
        speed: [1.0e3; MAX_JOINTS],
        power: 1.0e6,
        tip_force: 1.0e9,
        ..Limits::default()
    };
    let hardware = Hardware {
        axes: 3,
        real: false,
        bus_sensed: false,
        timer_hz: 168_000_000,
        bridge: Bridge { carrier_hz: 20_000.0, dead_time: 0.0, bandwidth_hz: 1_000.0, current_sensed: false },
    };
    let device = Device::new(&file.name, &description)?;
    let mut servo: Servo<Box<Program<Minimax>>> =
        Servo::new(hardware, Rules { limits, host_action: HostAction::Ignore, ..Rules::default() });
    let refused = |refusal| format!("{refusal:?}");
    let program = Program::new(&hardware, &limits, &device, &scene, &MassModelData::Exact, false).map_err(refused)?;
    servo.execute(Command::Program(Box::new(program))).0.map_err(refused)?;
    let press = |servo: &mut Servo<Box<Program<Minimax>>>, q: &Vector2<f64>, steps: u32| {
        let count = |i: usize| (q[i] / std::f64::consts::TAU * COUNTS).round() as i32;
        for _ in 0..steps {
            servo.control(&Samples { counts: [count(0), count(1), 0], bus_voltage: 24.0, ..Samples::default() });
        }
        let torque = servo.frame().torque;
        Vector2::new(f64::from(torque[0]), f64::from(torque[1]))
    };
    press(&mut servo, &start, 10);
    servo.execute(Command::Arm).0.map_err(refused)?;
    press(&mut servo, &start, 1_000);
    let inward = m.inverse(&pose, &-n);
    Ok((0..=200)
        .map(|i| {
            let depth = 1.0e-5 * f64::from(i);
            let q = start + inward * depth;
            (depth, q, press(&mut servo, &q, 100))
        })
        .collect())
}

/// Forces at the tip of these torques after `limit`.
fn forces(
    file: &DeviceFile,
    points: &[Pressed],
    limit: impl Fn(Vector2<f64>) -> Vector2<f64>,
) -> Result<Forces, Box<dyn std::error::Error>> {
    let AnyMechanism::FiveBar(m) = &file.mechanism else { return Err("not a five-bar".into()) };
    let (n, t) = (Vector2::new(NORMAL.cos(), NORMAL.sin()), Vector2::new(-NORMAL.sin(), NORMAL.cos()));
    Ok(points
        .iter()
        .map(|(depth, q, torque)| {
            let force = m.jacobian_inverse(&m.pose::<Libm>(q)).tr_mul(&limit(*torque));
            (*depth, [n.dot(&force), t.dot(&force)])
        })
        .collect())
}
