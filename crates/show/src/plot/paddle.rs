//! The picture of a device with one joint and thus no map: the reach of its handle, and its constant inertia.

use haptic_bridge::model::description::Description;

use super::axes::{Axis, PlotArea};
use super::canvas::Stroke;
use super::colour::{INK, scale};
use super::paper::Paper;
use super::{Picture, linkage};
use haptic_stability::analysis::map::effective_inertias;
use haptic_stability::analysis::pose::{PoseError, TaskPose, unit_normal};
use haptic_stability::skeleton::{Point, skeleton};

const ARC_POINTS: usize = 180;

/// Draws the arc that the handle can reach.
pub fn draw(description: &Description, name: &str, paper: Paper) -> Result<Picture, PoseError> {
    let home = description.home.map_or(0.0, |home| home[0]);
    let joint = description.joints[0];
    let half = std::f64::consts::PI;
    let (low, high) = joint.limits.unwrap_or((home - half, home + half));
    let place = |q: f64| skeleton(description, &[q]).map_or((0.0, 0.0), |s| s.tip);
    let arc: Vec<Point> = (0..=ARC_POINTS).map(|i| place(low + (high - low) * i as f64 / ARC_POINTS as f64)).collect();
    let (_, w_rr) = effective_inertias(&TaskPose::at(description, &[home])?, &unit_normal(&[1.0], 1, 1)?)
        .ok_or(PoseError::Serial)?;

    let length = 1e3 * description.geometry[0];
    let (limits, along) = match joint.limits {
        Some((low, high)) => (
            format!("limits {:.0} to {:.0}°", low.to_degrees(), high.to_degrees()),
            format!("{:.1} to {:.1} mm, home {:.1} mm", length * low, length * high, length * home),
        ),
        None => ("no joint limits".into(), format!("home {:.1} mm", length * home)),
    };
    let title = format!("{name}: one joint, no coupling");
    let under = [
        format!("inertia felt at the handle: Weff = Wrr = {:.1} g along its arc, everywhere", 1e3 * w_rr),
        format!("{limits}; zero angle along +x, growing counter-clockwise"),
        format!("task coordinate along the arc: {along}"),
    ];

    let (min, max) = linkage::bounding_box(arc.iter().copied().chain([(0.0, 0.0)]));
    let (across, up) = (max.0 - min.0, max.1 - min.1);
    let usual = 380.0 / across.max(up);
    let page = paper.page((86.0 + across * usual + 30.0).max(560.0), 86.0);
    let heading = page.heading(&title, &under);
    let top = 104.0 + heading.extra_height(3);
    let pixels = page.scale(usual, (across, up), (page.left + 30.0, top + 60.0));
    let frame = PlotArea {
        at: (page.left, top),
        size: (across * pixels, up * pixels),
        x: Axis::new("x", "m", min.0, max.0),
        y: Axis::new("y", "m", min.1, max.1),
    };
    let mut canvas = page.canvas(frame.at.1 + frame.size.1 + 60.0);
    heading.draw(&mut canvas);
    frame.curve(&mut canvas, &arc, Stroke::solid(&scale(0.0), 6.0));
    for end in [low, high].into_iter().filter(|_| joint.limits.is_some()) {
        let (x, y) = place(end);
        let ((fx, fy), (tx, ty)) = (frame.pixel(0.86 * x, 0.86 * y), frame.pixel(1.06 * x, 1.06 * y));
        canvas.line((fx, fy), (tx, ty), Stroke::solid(INK, 2.0));
    }
    if let Some(skeleton) = skeleton(description, &[home]) {
        linkage::draw_linkage(&mut canvas, &frame, &skeleton);
    }
    frame.draw(&mut canvas, "");
    Ok(canvas.finish(&title, "The arc that the handle of a device with one joint can reach."))
}
