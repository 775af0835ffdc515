//! Tip forces of a wall that needs more than the motors' torque: with the board's control loop, and for comparison with
//! torques limited joint by joint. Draws docs/results/saturation.svg: `cargo run --package figures --bin saturation`.

use haptic_bridge::model::catalogue::MAX_JOINTS;
use haptic_bridge::render::scene::FeedForward;
use haptic_bridge::safety::limits::Limits;
use haptic_host::device_file::DeviceFile;
use haptic_show::plot::axes::{Axis, Mark, PlotArea};
use haptic_show::plot::canvas::{Anchor, Canvas, Stroke};
use haptic_show::plot::colour::{FAINT, FULL, OFF};
use haptic_sim::{Press, PressForces, PressedBoard, WIDE_LIMITS};
use std::path::Path;

/// Pose of the demo, rad.
const POSE: [f64; 3] = [2.6, 1.75, 0.0];
/// Angle of the wall's normal, rad.
const NORMAL: f64 = 75.0 * std::f64::consts::PI / 180.0;
/// Stiffness of the wall, N/m.
const STIFFNESS: f64 = 20_000.0;
/// Torque limit of each motor, N m.
const LIMIT: f64 = 2.0;

/// Tip forces along the normal and sideways, N, over the depth, m.
type Forces = Vec<(f64, [f64; 2])>;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
    let file = DeviceFile::load(format!("{root}/devices/coupled-five-bar.toml"))?;
    let cut: Forces =
        pressed(&file, LIMIT as f32)?.1.iter().map(|felt| (felt.depth, [felt.along, felt.across])).collect();
    let (held, asked) = pressed(&file, WIDE_LIMITS.torque[0])?;
    let each = |felt: &PressForces| held.force(&felt.q, &felt.torque.map(|torque| torque.clamp(-LIMIT, LIMIT)));
    let jointly: Forces = asked.iter().map(|felt| (felt.depth, each(felt).into())).collect();
    println!("depth mm, one factor: along N, sideways N; joint by joint: along N, sideways N");
    for (one, each) in cut.iter().zip(&jointly).skip(50).step_by(50) {
        let ([a, b], [c, d]) = (one.1, each.1);
        println!("{:.2} {a:.1} {b:.1} {c:.1} {d:.1}", 1.0e3 * one.0);
    }

    let mut canvas = Canvas::new(720.0, 486.0);
    let frame = PlotArea {
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
    let drawn: Vec<_> = curves.iter().map(|(points, ..)| points.clone()).collect();
    frame.clear_legend(&mut canvas, &drawn, &entries);
    let picture = canvas.finish("saturation", "Force along the normal and sideways over the depth in a wall.");
    picture.save_svg(&Path::new(root).join("docs/results/saturation.svg"))?;
    Ok(())
}

/// Holds the demo's device at growing depths in its wall, with motors limited to `limit` (N m).
fn pressed(file: &DeviceFile, limit: f32) -> Result<(PressedBoard, Vec<PressForces>), Box<dyn std::error::Error>> {
    let mut device = file.description;
    for motor in device.joints.iter_mut().filter_map(|joint| joint.motor.as_mut()) {
        motor.max_current = 1.0e4;
    }
    let mut held = PressedBoard::new(&Press {
        device: &device,
        q: POSE,
        normal: [NORMAL.cos(), NORMAL.sin(), 0.0],
        stiffness: STIFFNESS,
        feed_forward: FeedForward::Off,
        limits: Limits { torque: [limit; MAX_JOINTS], ..WIDE_LIMITS },
    })?;
    let felt = (0..=200).map(|i| held.forces_at(1.0e-5 * f64::from(i), 100)).collect();
    Ok((held, felt))
}
