//! The counterpart of a map for a device with one joint: nothing couples and the inertia is the same everywhere, so the
//! picture shows the reach of the handle and what it weighs there.

use haptic_bridge::model::description::Description;

use super::axes::{Axis, PlotArea};
use super::canvas::{Anchor, Canvas, Stroke};
use super::colour::{INK, scale};
use super::{Picture, linkage};
use haptic_stability::analysis::map::along;
use haptic_stability::analysis::pose::{PoseError, TaskPose, unit_normal};
use haptic_stability::skeleton::{Point, skeleton};

/// Points on the arc.
const POINTS: usize = 180;

/// Draws the arc that the handle can reach.
pub fn draw(description: &Description, name: &str) -> Result<Picture, PoseError> {
    let home = description.home.map_or(0.0, |home| home[0]);
    let joint = description.joints[0];
    let half = std::f64::consts::PI;
    let (low, high) = joint.limits.unwrap_or((home - half, home + half));
    let place = |q: f64| skeleton(description, &[q]).map_or((0.0, 0.0), |s| s.tip);
    let arc: Vec<Point> = (0..=POINTS).map(|i| place(low + (high - low) * i as f64 / POINTS as f64)).collect();
    let (_, w_rr) =
        along(&TaskPose::at(description, &[home])?, &unit_normal(&[1.0], 1, 1)?).ok_or(PoseError::Serial)?;

    let (least, most) = linkage::bounds(arc.iter().copied().chain([(0.0, 0.0)]));
    let pixels = 380.0 / (most.0 - least.0).max(most.1 - least.1);
    let frame = PlotArea {
        at: (86.0, 100.0),
        size: ((most.0 - least.0) * pixels, (most.1 - least.1) * pixels),
        x: Axis { name: "x".into(), unit: "m".into(), low: least.0, high: most.0 },
        y: Axis { name: "y".into(), unit: "m".into(), low: least.1, high: most.1 },
    };
    let mut canvas = Canvas::new((frame.at.0 + frame.size.0 + 30.0).max(560.0), frame.at.1 + frame.size.1 + 60.0);
    frame.curve(&mut canvas, &arc, Stroke::solid(&scale(0.0), 6.0));
    for end in [low, high].into_iter().filter(|_| joint.limits.is_some()) {
        let (x, y) = place(end);
        let ((fx, fy), (tx, ty)) = (frame.pixel(0.86 * x, 0.86 * y), frame.pixel(1.06 * x, 1.06 * y));
        canvas.line((fx, fy), (tx, ty), Stroke::solid(INK, 2.0));
    }
    if let Some(skeleton) = skeleton(description, &[home]) {
        linkage::outline(&mut canvas, &frame, &skeleton);
    }
    frame.draw(&mut canvas, "");
    let title = format!("{name}: one joint, nothing to couple");
    canvas.text((frame.at.0, 28.0), 15.0, Anchor::Start, false, &title);
    let weight = format!("inertia felt at the handle: Weff = Wrr = {:.1} g along its arc, everywhere", 1e3 * w_rr);
    canvas.text((frame.at.0, 48.0), 12.0, Anchor::Start, false, &weight);
    let length = 1e3 * description.geometry[0];
    let (limits, along) = match joint.limits {
        Some((low, high)) => (
            format!("limits {:.0} to {:.0}°", low.to_degrees(), high.to_degrees()),
            format!("{:.1} to {:.1} mm, home {:.1} mm", length * low, length * high, length * home),
        ),
        None => ("no joint limits".into(), format!("home {:.1} mm", length * home)),
    };
    let zero = format!("{limits}; zero angle along +x, growing counter-clockwise");
    canvas.text((frame.at.0, 65.0), 12.0, Anchor::Start, false, &zero);
    let task = format!("task coordinate along the arc: {along}");
    canvas.text((frame.at.0, 82.0), 12.0, Anchor::Start, false, &task);
    Ok(canvas.finish(&title, "The arc that the handle of a device with one joint can reach."))
}
