//! The picture of a device with one joint and thus no map: the reach of its handle, and its constant inertia.

use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::Description;

use super::axes::{Axis, PlotArea};
use super::canvas::Stroke;
use super::colour::{INK, scale};
use super::paper::Paper;
use super::{Picture, linkage};
use haptic_stability::analysis::map::effective_inertias;
use haptic_stability::analysis::pose::{PoseError, TaskPose, unit_normal};
use haptic_stability::skeleton::{Point, Skeleton, View, skeleton};

const ARC_POINTS: usize = 180;
/// Half of the mark at an end of the path, pixels.
const END_MARK: f64 = 14.0;

/// Draws the arc that the handle can reach.
pub fn draw(description: &Description, name: &str, paper: Paper) -> Result<Picture, PoseError> {
    let home = description.home.map_or(0.0, |home| home[0]);
    let joint = description.joints[0];
    let (view, half) = (View::of_task(description), std::f64::consts::PI);
    let (low, high) = joint.limits.unwrap_or(if joint.prismatic { (home, home) } else { (home - half, home + half) });
    let place = |q: f64| skeleton(description, &[q]).map_or((0.0, 0.0), |s| s.tip);
    let arc: Vec<Point> = (0..=ARC_POINTS).map(|i| place(low + (high - low) * i as f64 / ARC_POINTS as f64)).collect();
    let (_, w_rr) = effective_inertias(&TaskPose::at(description, &[home])?, &unit_normal(&[1.0], 1, 1)?)
        .ok_or(PoseError::Serial)?;

    let task = |q: f64| TaskPose::at(description, &[q]).map(|pose| 1e3 * pose.position[0]);
    let motion = if joint.prismatic { "rail" } else { "arc" };
    let zero = if description.kind == Kind::Paddle { "; zero angle along +x, growing counter-clockwise" } else { "" };
    let angle = |q: f64| if joint.prismatic { 1e3 * q } else { q.to_degrees() };
    let unit = if joint.prismatic { " mm" } else { "°" };
    let (limits, along) = match joint.limits {
        Some((low, high)) => (
            format!("limits {:.0} to {:.0}{unit}", angle(low), angle(high)),
            format!("{:.1} to {:.1} mm, home {:.1} mm", task(low)?, task(high)?, task(home)?),
        ),
        None => ("no joint limits".into(), format!("home {:.1} mm", task(home)?)),
    };
    let title = format!("{name}: one joint, no coupling");
    let under = [
        format!("inertia felt at the handle: Weff = Wrr = {:.1} g along its {motion}, everywhere", 1e3 * w_rr),
        format!("{limits}{zero}"),
        format!("task coordinate along the {motion}: {along}"),
    ];

    let drawn = skeleton(description, &[home]);
    let (min, max) = linkage::bounding_box(arc.iter().copied().chain(drawn.iter().flat_map(Skeleton::points)));
    let (across, up) = (max.0 - min.0, max.1 - min.1);
    let usual = 380.0 / across.max(up);
    let page = paper.page((86.0 + across * usual + 30.0).max(560.0), 86.0);
    let heading = page.heading(&title, &under);
    let top = 104.0 + heading.extra_height(3);
    let pixels = page.scale(usual, (across, up), (page.left + 30.0, top + 60.0));
    let frame = PlotArea {
        at: (page.left, top),
        size: (across * pixels, up * pixels),
        x: Axis::new(view.names[0], "m", min.0, max.0),
        y: Axis::new(view.names[1], "m", min.1, max.1),
    };
    // Ends of the path are marked across it.
    let across = |[from, to]: [Point; 2]| {
        let (at, before) = (frame.pixel(to.0, to.1), frame.pixel(from.0, from.1));
        let (dx, dy) = (at.0 - before.0, at.1 - before.1);
        let half = END_MARK / dx.hypot(dy).max(1e-9);
        [-half, half].map(|half| (at.0 - half * dy, at.1 + half * dx))
    };
    let mut canvas = page.canvas(frame.at.1 + frame.size.1 + 60.0);
    heading.draw(&mut canvas);
    frame.curve(&mut canvas, &arc, Stroke::solid(&scale(0.0), 6.0));
    if joint.limits.is_some() {
        for ends in [[arc[1], arc[0]], [arc[ARC_POINTS - 1], arc[ARC_POINTS]]].map(across) {
            canvas.line(ends[0], ends[1], Stroke::solid(INK, 2.0));
        }
    }
    if let Some(skeleton) = &drawn {
        linkage::draw_linkage(&mut canvas, &frame, skeleton);
    }
    frame.draw(&mut canvas, "");
    Ok(canvas.finish(&title, "The arc that the handle of a device with one joint can reach."))
}
