//! The drawing of a device: its linkage at home, the zero angle and direction of each joint, the reach of the tip. It
//! makes a mirrored assembly or swapped motors visible.
//!
//! A device in space may have two views, one above the other, to one scale.

mod labels;
mod marks;

use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::model::catalogue::Kind;
use haptic_bridge::model::description::Description;

use super::axes::{Axis, PlotArea};
use super::canvas::{Canvas, Stroke};
use super::colour::{FULL_COLOUR, INK, OFF_COLOUR, WASHOUT_COLOUR};
use super::linkage::bounding_box;
use super::paper::Paper;
use super::{Picture, linkage};
use haptic_stability::analysis::cut::{Cut, Fineness};
use haptic_stability::analysis::pose::PoseError;
use haptic_stability::skeleton::{Bar, Point, Skeleton, View, skeleton_in};
use labels::Labels;
use marks::{axis_line, joint_marks};

/// Longest side of the plane for a linkage alone or with joint limits, pixels.
const LINKAGE_SIDE: f64 = 460.0;
/// Longest side of the plane for a reach without joint limits, pixels.
const REACH_SIDE: f64 = 760.0;
/// Longest side of each of two views, pixels.
const VIEW_SIDE: f64 = 380.0;
/// Height between two views, pixels.
const BETWEEN_VIEWS: f64 = 62.0;
const REACH_COLOUR: &str = "#e6edf5";
const PATH_COLOUR: &str = "#d3dfec";
const LINK_COLOUR: &str = "#b9bec6";
/// Half of a link's width, pixels.
const HALF_LINK_WIDTH: f64 = 4.5;
/// Colours of the joints.
const JOINT_COLOURS: [&str; 3] = [OFF_COLOUR, FULL_COLOUR, WASHOUT_COLOUR];
/// Number of points of a tip's path.
const PATH_POINTS: usize = 90;

/// One view of a device.
struct Panel {
    view: View,
    skeleton: Skeleton,
    /// Area that the tip can reach, as outlines.
    area: Vec<Vec<Point>>,
    /// Paths of the tips as a single joint moves.
    paths: Vec<Vec<Point>>,
    low: Point,
    high: Point,
}

/// Draws a device at joint angles `q` (rad), with `lines` of text below. Returns `None` if its linkage does not close.
pub fn draw(
    description: &Description,
    name: &str,
    q: &[f64],
    lines: &[String],
    paper: Paper,
) -> Result<Option<Picture>, PoseError> {
    let spec = description.kind.spec();
    let limited = description.joints[..spec.joints].iter().all(|joint| joint.limits.is_some());
    let mut panels = Vec::new();
    for view in View::of_drawing(description) {
        let Some(skeleton) = skeleton_in(description, q, &view) else { return Ok(None) };
        let area = if panels.is_empty() { reachable_outlines(description, &view, &skeleton)? } else { Vec::new() };
        let paths = if area.is_empty() { tip_paths(description, q, &view, &skeleton) } else { Vec::new() };
        let reach = area.iter().chain(&paths).flatten().copied();
        let (low, high) = bounding_box(skeleton.points().chain(reach));
        // Adds room for arcs and labels; a linkage without its reach needs more.
        let room = match (area.is_empty(), limited) {
            (true, _) => 0.22,
            (false, true) => 0.08,
            (false, false) => 0.02,
        };
        let room = room * (high.0 - low.0).max(high.1 - low.1);
        let (low, high) = ((low.0 - room, low.1 - room), (high.0 + room, high.1 + room));
        panels.push(Panel { view, skeleton, area, paths, low, high });
    }
    let has_area = panels.iter().any(|panel| !panel.area.is_empty());
    let side = match (panels.len(), has_area && !limited) {
        (1, false) => LINKAGE_SIDE,
        (1, true) => REACH_SIDE,
        _ => VIEW_SIDE,
    };
    let sizes: Vec<(f64, f64)> = panels.iter().map(|p| (p.high.0 - p.low.0, p.high.1 - p.low.1)).collect();
    let (across, up) = sizes.iter().fold((0.0_f64, 0.0), |sum, size| (sum.0.max(size.0), sum.1 + size.1));
    let usual = side / sizes.iter().fold(0.0_f64, |most, size| most.max(size.0).max(size.1));
    let page = paper.page((86.0 + across * usual + 30.0).max(640.0), 86.0);
    // The name of several paddles is a plural.
    let article = if spec.name.ends_with('s') { "" } else { "a " };
    let title = if name == spec.name { name.to_string() } else { format!("{name}: {article}{}", spec.name) };
    let what =
        if description.home.is_some_and(|home| home[..spec.joints] == *q) { "at home" } else { "at the pose given" };
    let ground = if has_area { "; pale area: reach of the tip, clear of singular poses" } else { "" };
    let has_path = panels.iter().any(|panel| !panel.paths.is_empty());
    let path = if has_path { "; pale line: path of the tip as one joint moves" } else { "" };
    let heading = page.heading(&title, &[format!("{what}{ground}{path}")]);
    let top = 62.0 + heading.extra_height(1);
    let below = BETWEEN_VIEWS * (panels.len() - 1) as f64;
    let pixels = page.scale(usual, (across, up), (page.left + 30.0, top + below + 46.0));
    let mut bottom = top;
    let frames: Vec<PlotArea> = (panels.iter())
        .map(|Panel { view, low, high, .. }| {
            let frame = PlotArea {
                at: (page.left, if bottom > top { bottom + BETWEEN_VIEWS } else { top }),
                size: ((high.0 - low.0) * pixels, (high.1 - low.1) * pixels),
                x: Axis::new(view.names[0], "m", low.0, high.0),
                y: Axis::new(view.names[1], "m", low.1, high.1),
            };
            bottom = frame.at.1 + frame.size.1;
            frame
        })
        .collect();
    let mut notes: Vec<String> =
        mechanism_notes(description, &panels).into_iter().chain(lines.iter().cloned()).collect();
    let in_full = |bar: &Bar| format!("{}, {} mm", bar.name, (bar.length * 1e5).round() / 100.0);
    // A link that is drawn short has no room for its name; the notes name it. A link without length is not drawn.
    let drawn_length = |bar: &Bar| pixels * (bar.to.0 - bar.from.0).hypot(bar.to.1 - bar.from.1);
    // Links that are alike have one name, in the view that shows the link longest.
    let mut names: Vec<Vec<String>> = panels.iter().map(|p| vec![String::new(); p.skeleton.bars.len()]).collect();
    let mut short = Vec::new();
    let first = panels.first().map_or(&[][..], |panel| &panel.skeleton.bars);
    for (i, bar) in first.iter().enumerate() {
        if bar.length < 1e-6 || first[..i].iter().any(|before| before.name == bar.name) {
            continue;
        }
        let lengths = panels.iter().map(|panel| drawn_length(&panel.skeleton.bars[i])).enumerate();
        // The first of equal lengths.
        let longest = lengths.rev().max_by(|a, b| a.1.total_cmp(&b.1));
        match longest.filter(|(_, length)| !page.is_narrow() && *length > 40.0) {
            Some((panel, _)) => names[panel][i] = in_full(bar),
            None => short.push(in_full(bar)),
        }
    }
    if !short.is_empty() {
        notes.insert(0, short.join("; "));
    }
    bottom += if paper.is_printed() { 46.0 } else { 68.0 };
    let notes = page.notes(notes.iter().map(String::as_str));
    let mut canvas = page.canvas(bottom + notes.height());
    heading.draw(&mut canvas);
    for ((panel, frame), names) in panels.iter().zip(&frames).zip(&names) {
        frame.draw_clipped(&mut canvas, |canvas| draw_panel(canvas, frame, panel, names, pixels, description));
        frame.draw(&mut canvas, "");
    }
    notes.draw(&mut canvas, bottom);
    Ok(Some(canvas.finish(&title, "The linkage, its joints with their zero angles and directions, and its reach.")))
}

fn draw_panel(
    canvas: &mut Canvas,
    frame: &PlotArea,
    panel: &Panel,
    names: &[String],
    pixels: f64,
    description: &Description,
) {
    let skeleton = &panel.skeleton;
    let to_pixels = |points: &Vec<Point>| -> Vec<Point> { points.iter().map(|&(x, y)| frame.pixel(x, y)).collect() };
    if !panel.area.is_empty() {
        canvas.tiles(&panel.area.iter().map(to_pixels).collect::<Vec<_>>(), REACH_COLOUR);
    }
    for path in panel.paths.iter().map(to_pixels) {
        canvas.polyline(&path, Stroke::solid(PATH_COLOUR, 5.0));
    }
    let axes: Vec<[Point; 2]> = skeleton.axes.iter().map(|axis| axis_line(frame, axis)).collect();
    for line in &axes {
        canvas.line(line[0], line[1], Stroke { colour: INK, width: 1.2, dash: "14 4 3 4" });
    }
    let rails: Vec<[Point; 2]> =
        skeleton.slides.iter().map(|slide| slide.rail().map(|(x, y)| frame.pixel(x, y))).collect();
    for rail in &rails {
        canvas.polyline(rail, Stroke::solid(INK, 3.0));
    }
    let marks = joint_marks(frame, skeleton, pixels, description);
    let mut labels = Labels::new(frame, skeleton);
    labels.avoid(rails.iter().chain(&axes).map(|line| line.to_vec()));
    labels.avoid(marks.iter().flat_map(|mark| mark.lines().cloned()));
    let tips = [skeleton.tip].into_iter().chain(skeleton.more_tips.iter().copied());
    let tips: Vec<Point> = tips.map(|(x, y)| frame.pixel(x, y)).collect();
    let is_named = !skeleton.letters.is_empty() || description.kind == Kind::Delta;
    let tip_name = if is_named { "tip P" } else { "tip" };
    let tip_labels: Vec<_> = tips.iter().map(|tip| labels.around(*tip, 8.0, 12.5, tip_name)).collect();
    let letters: Vec<_> = (skeleton.letters.iter())
        .map(|(letter, at)| labels.around(frame.pixel(at.0, at.1), 8.0, 12.5, letter))
        .collect();
    let angles: Vec<_> = marks.iter().map(|mark| labels.of_mark(mark)).collect();
    let axis_names: Vec<_> = (skeleton.axes.iter().zip(&axes))
        .filter_map(|(axis, line)| labels.along(*line, &format!("axis of joint {}", axis.joint)))
        .collect();
    let link_names: Vec<_> = (skeleton.bars.iter().zip(names).filter(|(_, name)| !name.is_empty()))
        .filter_map(|(bar, name)| labels.of_link(skeleton, bar, name))
        .collect();

    draw_links(canvas, frame, skeleton);
    for mark in &marks {
        mark.draw(canvas);
    }
    for base in &skeleton.base {
        linkage::draw_base_pivot(canvas, frame.pixel(base.0, base.1));
    }
    for slide in &skeleton.slides {
        marks::draw_carriage(canvas, frame, slide);
    }
    for tip in tips {
        linkage::draw_tip(canvas, tip);
    }
    for label in [tip_labels, letters, angles, axis_names, link_names].iter().flatten() {
        label.draw(canvas);
    }
}

/// Returns the area that the tip can reach, as outlines; empty for a device of one joint or of several paddles, and if
/// the view does not show the area.
fn reachable_outlines(
    description: &Description,
    view: &View,
    skeleton: &Skeleton,
) -> Result<Vec<Vec<Point>>, PoseError> {
    let spec = description.kind.spec();
    let is_seen = match description.kind {
        Kind::Paddles2 | Kind::Paddles3 => false,
        Kind::Chain3 => skeleton.shows(1) && skeleton.shows(2),
        _ => spec.joints > 1,
    };
    if !is_seen {
        return Ok(Vec::new());
    }
    let cut = Cut::new(description, &[1.0, 0.0, 0.0][..spec.task], Admissible::default())?;
    if cut.view != *view {
        return Ok(Vec::new());
    }
    let coarse = Fineness { side: f64::INFINITY, least: f64::INFINITY, step: f64::INFINITY, top: 1.0 };
    Ok(cut.tiles(coarse).into_iter().map(|tile| tile.outline).collect())
}

/// Returns the path of the tip as each joint that the view shows moves alone between its limits. A paddle moves its own
/// tip.
fn tip_paths(description: &Description, q: &[f64], view: &View, skeleton: &Skeleton) -> Vec<Vec<Point>> {
    let is_paddles = matches!(description.kind, Kind::Paddles2 | Kind::Paddles3);
    let path = |joint: usize| -> Option<Vec<Point>> {
        let (low, high) = match (description.joints[joint].limits, description.joints[joint].prismatic) {
            (Some(limits), _) => limits,
            (None, false) => (q[joint] - std::f64::consts::PI, q[joint] + std::f64::consts::PI),
            (None, true) => return None,
        };
        let place = |i: usize| {
            let mut q = q.to_vec();
            q[joint] = low + (high - low) * i as f64 / PATH_POINTS as f64;
            let moved = skeleton_in(description, &q, view)?;
            if is_paddles && joint > 0 { moved.more_tips.get(joint - 1).copied() } else { Some(moved.tip) }
        };
        Some((0..=PATH_POINTS).filter_map(place).collect())
    };
    (0..q.len()).filter(|joint| skeleton.shows(*joint)).filter_map(path).collect()
}

/// Returns facts about a mechanism that its drawing cannot show.
fn mechanism_notes(description: &Description, panels: &[Panel]) -> Vec<String> {
    let side = if description.geometry[5] < 0.0 { "right" } else { "left" };
    let assembly =
        format!("assembly = {}: the tip P lies to the {side} of the line from C to D", description.geometry[5]);
    let beside_axis = "no pale area at joint 0's axis: on the axis joint 0 does not move the tip, a singular pose";
    let limited = description.joints[..description.kind.spec().joints].iter().any(|joint| joint.limits.is_some());
    let dotted = if limited { "; dotted: limits" } else { "" };
    let angles = format!("angles count from the dashed line (zero) and grow counter-clockwise{dotted}");
    match description.kind {
        Kind::Paddle | Kind::Paddles2 | Kind::Paddles3 => {
            vec![angles, "the task coordinate is length × angle, along the arc".into()]
        }
        Kind::Chain1 | Kind::Chain2 | Kind::Chain3 => chain_notes(description, panels, dotted),
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
            format!("above: seen along z; below: seen along joint 0's axis{dotted}"),
            "a line to the platform is a pair of rods; angles count from pointing outwards and grow towards +z".into(),
            format!("assembly = {}: the side of the arms' ends that the tip is on", description.geometry[7]),
            "pale area: with joint 0 at home".into(),
        ],
    }
}

fn chain_notes(description: &Description, panels: &[Panel], dotted: &str) -> Vec<String> {
    let mut notes =
        vec![format!("angles and travel count from the dashed line (zero), in the direction of the arrow{dotted}")];
    let has_area = panels.iter().any(|panel| !panel.area.is_empty());
    if description.kind == Kind::Chain3 && has_area {
        notes.push("pale area: with joint 0 at home".into());
    }
    for joint in 0..description.kind.spec().joints {
        if panels.iter().any(|panel| panel.skeleton.shows(joint)) {
            continue;
        }
        let motion = if description.joints[joint].prismatic { "slides" } else { "turns" };
        notes.push(format!("joint {joint} {motion} out of the plane drawn"));
    }
    notes
}

fn draw_links(canvas: &mut Canvas, frame: &PlotArea, skeleton: &Skeleton) {
    let ends = |bar: &Bar| [bar.from, bar.to].map(|p| frame.pixel(p.0, p.1));
    // A link that is seen from its end has only its joints.
    let is_seen = |[from, to]: &[Point; 2]| (from.0 - to.0).hypot(from.1 - to.1) > 0.1;
    for ends in skeleton.bars.iter().map(ends).filter(is_seen) {
        canvas.polyline(&ends, Stroke::solid(INK, 2.0 * HALF_LINK_WIDTH));
        canvas.polyline(&ends, Stroke::solid(LINK_COLOUR, 2.0 * HALF_LINK_WIDTH - 2.0));
    }
    for end in skeleton.bars.iter().flat_map(ends) {
        canvas.circle(end, 3.4, "white", Stroke::solid(INK, 1.4));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::axes::crosses_box;
    use haptic_host::device_file::DeviceFile;
    use haptic_predict::template::device_file;

    /// A rectangle of the drawing about its centre, turned clockwise.
    struct Text {
        centre: Point,
        half: Point,
        turn: f64,
        words: String,
    }

    impl Text {
        /// Reads a label of a link, a joint, an axis or a tip from a line of SVG.
        fn read(line: &str) -> Option<Self> {
            let at = line.strip_prefix("<text transform=\"translate(")?.split_once(')')?.0;
            let (x, y) = at.split_once(' ')?;
            let number = |key: &str| -> f64 {
                let value = line.split_once(key).unwrap_or_else(|| panic!("{key} in {line}")).1;
                value.split(['"', ')']).next().unwrap().parse().unwrap()
            };
            let (size, turn) = (number("font-size=\""), number("rotate(").to_radians());
            let words = line.split_once('>')?.1.split('<').next()?.to_string();
            // The letters are above the baseline.
            let (sin, cos) = turn.sin_cos();
            let (x, y): (f64, f64) = (x.parse().unwrap(), y.parse().unwrap());
            let centre = (x + 0.36 * size * sin, y - 0.36 * size * cos);
            Some(Self { centre, half: (0.25 * size * words.chars().count() as f64, 0.4 * size), turn, words })
        }

        fn corners(&self) -> Vec<Point> {
            let (sin, cos) = self.turn.sin_cos();
            let corner = |(a, b): Point| {
                let (dx, dy) = (a * self.half.0, b * self.half.1);
                (self.centre.0 + dx * cos - dy * sin, self.centre.1 + dx * sin + dy * cos)
            };
            [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)].map(corner).to_vec()
        }

        /// Returns true if a line of some width crosses the text.
        fn is_crossed(&self, line: &[Point], half_width: f64) -> bool {
            let (sin, cos) = self.turn.sin_cos();
            let own = |p: &Point| {
                let (dx, dy) = (p.0 - self.centre.0, p.1 - self.centre.1);
                (dx * cos + dy * sin, dy * cos - dx * sin)
            };
            let half = (self.half.0 + half_width, self.half.1 + half_width);
            crosses_box(&line.iter().map(own).collect::<Vec<_>>(), (-half.0, -half.1), half)
        }
    }

    /// Draws devices at home and in other poses: no label covers a link, another label, or the edge of its view; every
    /// joint is drawn or named in the notes.
    #[test]
    fn labels_do_not_cover_links() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../devices");
        let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        let shipped = files.filter(|path| path.is_file()).map(|path| DeviceFile::load(&path).unwrap());
        let upright = DeviceFile::parse(&device_file(Kind::Chain3, "upright"), "upright").unwrap();
        let mut checked = 0;
        for DeviceFile { name, description, .. } in shipped.chain([upright]) {
            let home = description.home.unwrap();
            let joints = description.kind.spec().joints;
            for step in 0..5 {
                let moved = |joint: usize| match description.joints[joint].limits {
                    Some((low, high)) => {
                        home[joint] + 0.2 * f64::from(step) * ([low, high][(step as usize + joint) % 2] - home[joint])
                    }
                    None => home[joint] + 0.1 * f64::from(step),
                };
                let q: Vec<f64> = (0..joints).map(moved).collect();
                let drawn = draw(&description, &name, &q, &[], Paper::default()).unwrap();
                let Some(svg) = drawn else { continue };
                let mut texts: Vec<Text> = Vec::new();
                let (mut links, mut frame) = (Vec::new(), [(0.0, 0.0); 2]);
                let mut shown = vec![false; joints];
                for line in svg.svg().lines() {
                    if let Some(clip) = line.strip_prefix("<clipPath ") {
                        let value = |key: &str| -> f64 {
                            clip.split_once(&format!(" {key}=\""))
                                .unwrap()
                                .1
                                .split('"')
                                .next()
                                .unwrap()
                                .parse()
                                .unwrap()
                        };
                        frame = [(value("x"), value("y")), (value("width"), value("height"))];
                        (texts, links) = (Vec::new(), Vec::new());
                    } else if line.contains("stroke-width=\"9\"") {
                        let ends: Vec<f64> =
                            line.split('"').nth(1).unwrap().split([' ', ',']).map(|n| n.parse().unwrap()).collect();
                        links.push([(ends[0], ends[1]), (ends[2], ends[3])]);
                    }
                    for (joint, shown) in shown.iter_mut().enumerate() {
                        *shown |= line.contains(&format!("joint {joint}"));
                    }
                    let Some(text) = Text::read(line) else { continue };
                    checked += 1;
                    let place = format!("{name} at {q:?}: {}", text.words);
                    assert!(
                        !links.iter().any(|link| text.is_crossed(link, HALF_LINK_WIDTH - 0.1)),
                        "{place} on a link"
                    );
                    for other in &texts {
                        assert!(!other.is_crossed(&text.corners(), 0.0), "{place} on {}", other.words);
                    }
                    let [low, size] = frame;
                    let is_inside =
                        |p: &Point| (low.0..=low.0 + size.0).contains(&p.0) && (low.1..=low.1 + size.1).contains(&p.1);
                    assert!(text.corners().iter().all(is_inside), "{place} outside");
                    texts.push(text);
                }
                assert!(shown.iter().all(|shown| *shown), "{name}: {shown:?}");
            }
        }
        assert!(checked > 400, "{checked}");
    }
}
