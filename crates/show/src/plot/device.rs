//! The drawing of a device: its linkage at home, the zero angle and direction of each joint, the reach of the tip. It
//! makes a mirrored assembly or swapped motors visible.

use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::Description;

use super::axes::{Axis, PlotArea, crosses_box};
use super::canvas::{Anchor, Canvas, Stroke};
use super::colour::{FAINT_GREY, FULL_COLOUR, INK, OFF_COLOUR, WASHOUT_COLOUR};
use super::linkage::bounding_box;
use super::paper::Paper;
use super::{Picture, linkage};
use haptic_stability::analysis::cut::{Cut, Fineness};
use haptic_stability::analysis::pose::PoseError;
use haptic_stability::skeleton::{Angle, Bar, Point, Skeleton, Turret, skeleton};

/// Longest side of the plane for a linkage alone or with joint limits, pixels.
const LINKAGE_SIDE: f64 = 460.0;
/// Longest side of the plane for a reach without joint limits, pixels.
const REACH_SIDE: f64 = 760.0;
const REACH_COLOUR: &str = "#e6edf5";
const LINK_COLOUR: &str = "#b9bec6";
/// Half of a link's width, pixels.
const HALF_LINK_WIDTH: f64 = 4.5;
/// Largest radius of an angle's arc, pixels.
const MAX_ARC_RADIUS: f64 = 46.0;

/// Draws a device at joint angles `q` (rad), with `lines` of text below. Returns `None` if its linkage does not close.
pub fn draw(
    description: &Description,
    name: &str,
    q: &[f64],
    lines: &[String],
    paper: Paper,
) -> Result<Option<Picture>, PoseError> {
    let Some(skeleton) = skeleton(description, q) else { return Ok(None) };
    let spec = description.kind.spec();
    let reach = reachable_outlines(description)?;
    let bars = skeleton.bars.iter().flat_map(|bar| [bar.from, bar.to]);
    let limited = description.joints[..spec.joints].iter().all(|joint| joint.limits.is_some());
    let (low, high) = bounding_box(bars.chain(reach.iter().flatten().copied()));
    // Adds room for arcs and labels; a linkage without its reach needs more.
    let (room, side) = match (reach.is_empty(), limited) {
        (true, _) => (0.22, LINKAGE_SIDE),
        (false, true) => (0.08, LINKAGE_SIDE),
        (false, false) => (0.02, REACH_SIDE),
    };
    let room = room * (high.0 - low.0).max(high.1 - low.1);
    let (low, high) = ((low.0 - room, low.1 - room), (high.0 + room, high.1 + room));
    let (across, up) = (high.0 - low.0, high.1 - low.1);
    let usual = side / across.max(up);
    let page = paper.page((86.0 + across * usual + 30.0).max(640.0), 86.0);
    let title = if name == spec.name { name.to_string() } else { format!("{name}: a {}", spec.name) };
    let what =
        if description.home.is_some_and(|home| home[..spec.joints] == *q) { "at home" } else { "at the pose given" };
    let ground = if reach.is_empty() { "" } else { "; pale area: reach of the tip, clear of singular poses" };
    let heading = page.heading(&title, &[format!("{what}{ground}")]);
    let top = 62.0 + heading.extra_height(1);
    let pixels = page.scale(usual, (across, up), (page.left + 30.0, top + 46.0));
    let frame = PlotArea {
        at: (page.left, top),
        size: (across * pixels, up * pixels),
        x: Axis::new("x", "m", low.0, high.0),
        y: Axis::new("y", "m", low.1, high.1),
    };
    let mut notes: Vec<String> = mechanism_notes(description).into_iter().chain(lines.iter().cloned()).collect();
    let in_full = |bar: &Bar| format!("{}, {} mm", bar.name, (bar.length * 1e5).round() / 100.0);
    // Links that are alike have one name.
    let is_first = |i: usize| skeleton.bars[..i].iter().all(|bar| bar.name != skeleton.bars[i].name);
    // A link that is drawn short has no room for its name; the notes name it.
    let has_room = |bar: &Bar| {
        let (across, up) = (bar.to.0 - bar.from.0, bar.to.1 - bar.from.1);
        !page.is_narrow() && across.hypot(up) * pixels > 40.0
    };
    let named = |i: usize, with_room: bool| is_first(i) && has_room(&skeleton.bars[i]) == with_room;
    let bars = skeleton.bars.iter().enumerate();
    let names: Vec<String> =
        bars.clone().map(|(i, bar)| if named(i, true) { in_full(bar) } else { String::new() }).collect();
    let short: Vec<String> = bars.filter(|&(i, _)| named(i, false)).map(|(_, bar)| in_full(bar)).collect();
    if !short.is_empty() {
        notes.insert(0, short.join("; "));
    }
    let bottom = frame.at.1 + frame.size.1 + if paper.is_printed() { 46.0 } else { 68.0 };
    let notes = page.notes(notes.iter().map(String::as_str));
    let mut canvas = page.canvas(bottom + notes.height());
    heading.draw(&mut canvas);
    frame.draw_clipped(&mut canvas, |canvas| {
        let tiles: Vec<Vec<Point>> =
            reach.iter().map(|tile| tile.iter().map(|&(x, y)| frame.pixel(x, y)).collect()).collect();
        canvas.tiles(&tiles, REACH_COLOUR);
        draw_turret_axis(canvas, &frame, description.kind);
        let mut occupied: Vec<Area> =
            skeleton.angles.iter().map(|angle| angle_label(&frame, angle, &skeleton).area()).collect();
        occupied.extend(turret_label_area(&frame, description.kind));
        let tip = frame.pixel(skeleton.tip.0, skeleton.tip.1);
        occupied.push([tip.0 - 18.0, tip.1 - 24.0, tip.0 + 18.0, tip.1 + 6.0]);
        draw_links(canvas, &frame, &skeleton, &names, occupied);
        for (angle, colour) in skeleton.angles.iter().zip([OFF_COLOUR, FULL_COLOUR, WASHOUT_COLOUR]) {
            draw_joint_angle(canvas, &frame, angle, pixels, description, colour, &skeleton);
        }
        for base in &skeleton.base {
            linkage::draw_base_pivot(canvas, frame.pixel(base.0, base.1));
        }
        linkage::draw_tip(canvas, tip);
        let name = if skeleton.letters.is_empty() { "tip" } else { "tip P" };
        canvas.text((tip.0, tip.1 - 12.0), 12.5, Anchor::Middle, false, name);
    });
    frame.draw(&mut canvas, "");
    notes.draw(&mut canvas, bottom);
    Ok(Some(canvas.finish(&title, "The linkage, its joints with their zero angles and directions, and its reach.")))
}

/// Returns the area that the tip can reach, as outlines; empty for a paddle, whose reach is a line.
fn reachable_outlines(description: &Description) -> Result<Vec<Vec<Point>>, PoseError> {
    let spec = description.kind.spec();
    if spec.joints == 1 {
        return Ok(Vec::new());
    }
    let cut = Cut::new(description, &[1.0, 0.0, 0.0][..spec.task], Admissible::default())?;
    let coarse = Fineness { side: f64::INFINITY, least: f64::INFINITY, step: f64::INFINITY, top: 1.0 };
    Ok(cut.tiles(coarse).into_iter().map(|tile| tile.outline).collect())
}

/// Returns facts about a mechanism that its drawing cannot show.
fn mechanism_notes(description: &Description) -> Vec<String> {
    let side = if description.geometry[5] < 0.0 { "right" } else { "left" };
    let assembly =
        format!("assembly = {}: the tip P lies to the {side} of the line from C to D", description.geometry[5]);
    let beside_axis = "no pale area at joint 0's axis: on the axis joint 0 does not move the tip, a singular pose";
    let limited = description.joints[..description.kind.spec().joints].iter().any(|joint| joint.limits.is_some());
    let dotted = if limited { "; dotted arcs: limits" } else { "" };
    let angles = format!("angles count from the dashed line (zero) and grow counter-clockwise{dotted}");
    match description.kind {
        Kind::Paddle | Kind::Paddles2 | Kind::Paddles3 => {
            vec![angles, "the task coordinate is length × angle, along the arc".into()]
        }
        Kind::Chain1 | Kind::Chain2 | Kind::Chain3 => {
            vec!["joint frames and axes as in the device file; drawn along the task's coordinates".into()]
        }
        Kind::FiveBar => vec![angles, assembly],
        Kind::FiveBarTurret => vec![
            angles,
            assembly,
            "joint 0 turns this plane about the x axis: (X, Y, Z) = (x, y cos q0, y sin q0)".into(),
            beside_axis.into(),
        ],
        Kind::Parallelogram => vec![
            angles,
            "joints 1 and 2: angles count from the horizontal".into(),
            "joint 2 turns the crank; its angle is the forearm's".into(),
            "joint 0 turns this plane about the y axis: (X, Y, Z) = (x cos q0, y, -x sin q0)".into(),
            beside_axis.into(),
        ],
        Kind::Serial3r => vec![
            angles,
            "each angle is measured from the previous link".into(),
            "pale area: with the last link in its direction at home".into(),
        ],
        Kind::Delta => vec![
            "seen along z from the positive side; a line to the platform is a pair of rods".into(),
            "angles count from pointing outwards and grow towards +z; joint 0's arm is at azimuth[0]".into(),
            format!("assembly = {}: the side of the arms' ends that the tip is on", description.geometry[7]),
            "pale area: with joint 0 at home".into(),
        ],
    }
}

/// A rectangle of the drawing: left, top, right and bottom, pixels.
type Area = [f64; 4];

fn areas_overlap(a: &Area, b: &Area) -> bool {
    a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3]
}

/// Draws the links, and their names outside the `occupied` areas.
fn draw_links(canvas: &mut Canvas, frame: &PlotArea, skeleton: &Skeleton, names: &[String], mut occupied: Vec<Area>) {
    for bar in &skeleton.bars {
        let ends = [bar.from, bar.to].map(|p| frame.pixel(p.0, p.1));
        canvas.polyline(&ends, Stroke::solid(INK, 2.0 * HALF_LINK_WIDTH));
        canvas.polyline(&ends, Stroke::solid(LINK_COLOUR, 2.0 * HALF_LINK_WIDTH - 2.0));
    }
    let middles = skeleton.bars.iter().map(|bar| ((bar.from.0 + bar.to.0) / 2.0, (bar.from.1 + bar.to.1) / 2.0));
    let sum = middles.fold((0.0, 0.0), |sum, p| (sum.0 + p.0, sum.1 + p.1));
    let count = skeleton.bars.len() as f64;
    let centre = frame.pixel(sum.0 / count, sum.1 / count);
    for (bar, text) in skeleton.bars.iter().zip(names) {
        let (from, to) = (frame.pixel(bar.from.0, bar.from.1), frame.pixel(bar.to.0, bar.to.1));
        for end in [from, to] {
            canvas.circle(end, 3.4, "white", Stroke::solid(INK, 1.4));
        }
        if text.is_empty() {
            continue;
        }
        // Writes the name along the link, on the side away from the other links.
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let (mut slope, length) = (dy.atan2(dx).to_degrees(), dx.hypot(dy).max(1e-9));
        if !(-90.0..=90.0).contains(&slope) {
            slope -= 180.0 * slope.signum();
        }
        let middle = ((from.0 + to.0) / 2.0, (from.1 + to.1) / 2.0);
        let (nx, ny) = (dy / length, -dx / length);
        let outward = if (middle.0 - centre.0) * nx + (middle.1 - centre.1) * ny < 0.0 { -1.0 } else { 1.0 };
        // Moves the label away from the arcs at the link's base; a label longer than its link starts with the link.
        let past = (3.1 * text.chars().count() as f64 + 6.0 - length / 2.0).max(0.06 * length);
        let half = (3.1 * text.chars().count() as f64, 6.0);
        let (sin, cos) = slope.to_radians().sin_cos();
        let (wide, tall) = ((half.0 * cos).abs() + (half.1 * sin).abs(), (half.0 * sin).abs() + (half.1 * cos).abs());
        let place = |past: f64, side: f64| {
            let (nx, ny) = (side * nx, side * ny);
            // The baseline is below the letters.
            let away = if ny > 0.0 { 18.0 } else { 9.0 };
            let at = (middle.0 + past * dx / length + away * nx, middle.1 + past * dy / length + away * ny);
            let [left, top] = [frame.at.0 + 2.0, frame.at.1 + 2.0];
            let [right, bottom] = [left + frame.size.0 - 4.0, top + frame.size.1 - 4.0];
            (
                at.0.clamp((left + wide).min(right - wide), right - wide),
                at.1.clamp((top + tall).min(bottom - tall), bottom - tall),
            )
        };
        let area = |at: (f64, f64)| [at.0 - wide, at.1 - tall, at.0 + wide, at.1 + tall];
        // Uses the first free place: outside, inside, towards the other end of the link. Prefers a place without other
        // labels and links, then one without other labels.
        let places = [(past, outward), (past, -outward), (-past, outward), (-past, -outward)].map(|(p, s)| place(p, s));
        let has_label = |at: (f64, f64)| occupied.iter().any(|other| areas_overlap(&area(at), other));
        let has_link = |at: (f64, f64)| {
            // Coordinates along the label and across it. The letters are above the baseline.
            let along = |p: Point| {
                let p = frame.pixel(p.0, p.1);
                let (x, y) = (p.0 - at.0, p.1 - at.1);
                (x * cos + y * sin, y * cos - x * sin)
            };
            let others = skeleton.bars.iter().filter(|other| *other != bar);
            let mut lines = others.map(|other| [other.from, other.to].map(along));
            lines.any(|line| crosses_box(&line, (-half.0, -9.0 - HALF_LINK_WIDTH), (half.0, 3.0 + HALF_LINK_WIDTH)))
        };
        let free = places.iter().find(|at| !has_label(**at) && !has_link(**at));
        let at = *free.or_else(|| places.iter().find(|at| !has_label(**at))).unwrap_or(&places[0]);
        occupied.push(area(at));
        canvas.slanted_text(at, slope, text);
    }
    for (letter, at) in &skeleton.letters {
        let (x, y) = frame.pixel(at.0, at.1);
        let (dx, dy) = (x - centre.0, y - centre.1);
        let away = 17.0 / dx.hypot(dy).max(1e-9);
        let outside = (x + away * dx, y + away * dy + 4.0);
        // A base pivot's letter is below the pivot, or next to it if a label is below.
        let places = if skeleton.base.contains(at) { [(x, y + 19.0), (x + 12.0, y - 7.0)] } else { [outside; 2] };
        let area = |(x, y): Point| [x - 5.0, y - 10.0, x + 5.0, y + 1.0];
        let free = places.iter().find(|at| !occupied.iter().any(|other| areas_overlap(&area(**at), other)));
        canvas.text(*free.unwrap_or(&places[0]), 12.5, Anchor::Middle, false, letter);
    }
}

/// Draws a joint's angle: the line of zero angle, the arc with an arrow, the arc of the limits.
fn draw_joint_angle(
    canvas: &mut Canvas,
    frame: &PlotArea,
    angle: &Angle,
    pixels: f64,
    description: &Description,
    colour: &str,
    skeleton: &Skeleton,
) {
    let centre = frame.pixel(angle.at.0, angle.at.1);
    let separation = match skeleton.base.as_slice() {
        [a, b] if a != b => 0.46 * pixels * (a.0 - b.0).hypot(a.1 - b.1),
        _ => MAX_ARC_RADIUS,
    };
    let radius = (0.42 * pixels * angle.arm).min(MAX_ARC_RADIUS).min(separation.max(24.0));
    let on = |radius: f64, direction: f64| (centre.0 + radius * direction.cos(), centre.1 - radius * direction.sin());
    canvas.line(centre, on(radius + 16.0, angle.zero), Stroke { colour, width: 1.2, dash: "4 3" });
    let drawn =
        angle.angle.rem_euclid(std::f64::consts::TAU) - if angle.angle < 0.0 { std::f64::consts::TAU } else { 0.0 };
    let steps = 40;
    let along = |from: f64, to: f64, radius: f64| -> Vec<(f64, f64)> {
        (0..=steps).map(|i| on(radius, angle.zero + from + (to - from) * f64::from(i) / f64::from(steps))).collect()
    };
    canvas.polyline(&along(0.0, drawn, radius), Stroke::solid(colour, 1.8));
    if drawn.abs() > 0.05 {
        // The arrow's head is on the arc's tangent at its end.
        let end = on(radius, angle.zero + drawn);
        let head = (0.6 * radius * drawn.abs()).min(9.0);
        let back = drawn - drawn.signum() * head / radius;
        for side in [-0.45 * head, 0.45 * head] {
            canvas.line(end, on(radius + side, angle.zero + back), Stroke::solid(colour, 1.8));
        }
    }
    if let Some((low, high)) = description.joints[angle.joint].limits
        && high - low < std::f64::consts::TAU
    {
        canvas.polyline(&along(low, high, radius + 7.0), Stroke { colour, width: 1.2, dash: "1.5 2.5" });
    }
    let label = angle_label(frame, angle, skeleton);
    let [left, top, right, bottom] = label.area();
    canvas.rectangle((left, top), (right - left, bottom - top), "#ffffffdd", Stroke::solid(FAINT_GREY, 0.0));
    canvas.coloured_text(label.at, 12.0, label.anchor, colour, &label.text);
}

struct Label {
    text: String,
    at: (f64, f64),
    anchor: Anchor,
}

impl Label {
    fn area(&self) -> Area {
        let width = 6.1 * self.text.chars().count() as f64;
        let start = if self.anchor == Anchor::End { self.at.0 - width } else { self.at.0 };
        [start - 3.0, self.at.1 - 11.0, start + width + 3.0, self.at.1 + 4.0]
    }
}

fn angle_label(frame: &PlotArea, angle: &Angle, skeleton: &Skeleton) -> Label {
    let centre = frame.pixel(angle.at.0, angle.at.1);
    let text = format!("joint {}: {:.1}°", angle.joint, angle.angle.to_degrees());
    // Places the label below the pivot if no link is there, or above. Labels of two base pivots point apart.
    let left = skeleton.base.first().is_some_and(|first| skeleton.base.len() > 1 && *first == angle.at);
    let right = skeleton.base.len() > 1 && !left;
    let (shift, anchor) = match (left, right) {
        (true, _) => (-2.0, Anchor::End),
        (_, true) => (2.0, Anchor::Start),
        _ => (8.0, Anchor::Start),
    };
    let below = if skeleton.base.contains(&angle.at) { 38.0 } else { 22.0 };
    let ends = (frame.at.0, frame.at.0 + frame.size.0);
    let at = |shift: f64, below: f64, anchor: Anchor| {
        let mut label = Label { text: text.clone(), at: (centre.0 + shift, centre.1 + below), anchor };
        label.at.0 -= (label.area()[2] - ends.1).max(0.0) + (label.area()[0] - ends.0).min(0.0);
        label
    };
    let has_link = |label: &Label| {
        let [left, top, right, bottom] = label.area();
        let mut links = skeleton.bars.iter().map(|bar| [bar.from, bar.to].map(|end| frame.pixel(end.0, end.1)));
        links.any(|link| crosses_box(&link, (left, top - HALF_LINK_WIDTH), (right, bottom + HALF_LINK_WIDTH)))
    };
    let other = if anchor == Anchor::End { Anchor::Start } else { Anchor::End };
    let places =
        [at(shift, below, anchor), at(-shift, below, other), at(shift, -26.0, anchor), at(-shift, -26.0, other)];
    let free = places.iter().position(|label| !has_link(label)).unwrap_or(0);
    places.into_iter().nth(free).unwrap_or_else(|| at(shift, below, anchor))
}

/// Returns the area of the label that names the turret's axis.
fn turret_label_area(frame: &PlotArea, kind: Kind) -> Option<Area> {
    const LABEL_LENGTH: f64 = 100.0;
    let origin = frame.pixel(0.0, 0.0);
    let right = frame.at.0 + frame.size.0 - 8.0;
    Some(match Turret::of(kind)? {
        Turret::AboutX => [right - LABEL_LENGTH, origin.1 + 3.0, right, origin.1 + 18.0],
        Turret::AboutY => [origin.0 - 16.0, frame.at.1 + 8.0, origin.0 - 2.0, frame.at.1 + 8.0 + LABEL_LENGTH],
    })
}

fn draw_turret_axis(canvas: &mut Canvas, frame: &PlotArea, kind: Kind) {
    let axis = Stroke { colour: INK, width: 1.2, dash: "14 4 3 4" };
    let (left, top) = frame.at;
    let (right, bottom) = (left + frame.size.0, top + frame.size.1);
    let origin = frame.pixel(0.0, 0.0);
    match Turret::of(kind) {
        Some(Turret::AboutX) => {
            canvas.line((left, origin.1), (right, origin.1), axis);
            canvas.text((right - 8.0, origin.1 + 14.0), 11.5, Anchor::End, false, "axis of joint 0");
        }
        Some(Turret::AboutY) => {
            canvas.line((origin.0, top), (origin.0, bottom), axis);
            canvas.text((origin.0 - 6.0, top + 8.0), 11.5, Anchor::End, true, "axis of joint 0");
        }
        None => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use haptic_host::device_file::DeviceFile;

    /// Returns the number after `key` in a line of SVG.
    fn number_after(line: &str, key: &str) -> f64 {
        let value = line.split_once(key).unwrap_or_else(|| panic!("{key} in {line}")).1;
        value.split(['"', ' ', ')']).next().unwrap().parse().unwrap()
    }

    #[test]
    fn labels_do_not_cover_links() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../devices");
        let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        let mut checked = 0;
        for path in files.filter(|path| path.is_file()) {
            let DeviceFile { name, description, .. } = DeviceFile::load(&path).unwrap();
            let home = description.home.unwrap();
            let svg = draw(&description, &name, &home[..description.kind.spec().joints], &[], Paper::default());
            let svg = svg.unwrap().unwrap();
            let links: Vec<[Point; 2]> = (svg.svg().lines().filter(|line| line.contains("stroke-width=\"9\"")))
                .map(|line| {
                    let points = line.split('"').nth(1).unwrap();
                    let ends: Vec<f64> = points.split([' ', ',']).map(|number| number.parse().unwrap()).collect();
                    [(ends[0], ends[1]), (ends[2], ends[3])]
                })
                .collect();
            for line in svg.svg().lines() {
                let (low, high, turn) = if line.contains("#ffffffdd") {
                    let (x, y) = (number_after(line, " x=\""), number_after(line, " y=\""));
                    let high = (x + number_after(line, " width=\""), y + number_after(line, " height=\""));
                    ((x, y), high, ((0.0, 0.0), 0.0_f64))
                } else if line.starts_with("<text transform=\"translate(") {
                    let at = line.split_once("translate(").unwrap().1.split_once(')').unwrap().0;
                    let (x, y) = at.split_once(' ').unwrap();
                    let words = line.split_once('>').unwrap().1.split('<').next().unwrap();
                    let half = 3.0 * words.chars().count() as f64;
                    let at = (x.parse().unwrap(), y.parse().unwrap());
                    ((-half, -8.0), (half, 2.0), (at, number_after(line, "rotate(").to_radians()))
                } else {
                    continue;
                };
                checked += 1;
                let ((x, y), angle) = turn;
                let (sin, cos) = angle.sin_cos();
                for link in &links {
                    let along = link.map(|p| {
                        let (dx, dy) = (p.0 - x, p.1 - y);
                        (dx * cos + dy * sin, dy * cos - dx * sin)
                    });
                    let clearance = HALF_LINK_WIDTH - 0.1;
                    assert!(
                        !crosses_box(&along, (low.0, low.1 - clearance), (high.0, high.1 + clearance)),
                        "{name}: {line}"
                    );
                }
            }
        }
        assert!(checked > 40, "{checked}");
    }
}
