//! The colours of a map equal the numbers of `haptic model`, for every shipped device, with and without joint limits.

use crate::common::prelude::*;
use crate::common::{all_shipped_devices, shipped_device, svg_number};
use haptic_bridge::model::catalogue::Kind;
use haptic_show::plot::Picture;
use haptic_show::plot::colour::ABOVE_SCALE;
use haptic_show::plot::map::{Chart, chart, colour};
use haptic_show::plot::paper::Paper;
use haptic_stability::analysis::map::map;
use haptic_stability::model::{Precision, WallForce, evaluate_holding};
use resvg::tiny_skia::Pixmap;

/// Pixels of the PNG per unit of the drawing.
const PIXELS_PER_UNIT: f64 = 2.0;
/// Largest error of the coupling's share that a colour shows, relative to the scale: one colour step from rounding, two
/// within a tile, and three within the searched pixels.
const TOLERANCE: f64 = 0.06;
/// Largest distance of the expected colour from a pose's place, pixels: half the width of a drawn ellipse or link.
const SEARCH_PIXELS: i32 = 6;

fn colour_at(image: &Pixmap, x: i32, y: i32) -> Option<[u8; 3]> {
    let pixel = image.pixel(u32::try_from(x).ok()?, u32::try_from(y).ok()?)?.demultiply();
    Some([pixel.red(), pixel.green(), pixel.blue()])
}

fn rgb(hex: &str) -> [u8; 3] {
    std::array::from_fn(|i| u8::from_str_radix(&hex[1 + 2 * i..3 + 2 * i], 16).unwrap())
}

fn colour_distance(a: [u8; 3], b: [u8; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(b)).powi(2)).sum::<f64>().sqrt()
}

/// Returns true if the colour at this place of the picture agrees with `share` within the tolerance.
fn shows_share(chart: &Chart, image: &Pixmap, place: &[f64], share: f64) -> bool {
    let (x, y) = chart.frame.pixel(place[0], place[1]);
    let (x, y) = ((PIXELS_PER_UNIT * x) as i32, (PIXELS_PER_UNIT * y) as i32);
    let wanted: Vec<[u8; 3]> = (-6..=6)
        .map(|i| share + f64::from(i) / 6.0 * TOLERANCE * chart.top)
        .map(|share| rgb(&colour(share.max(0.0), chart.top)))
        .collect();
    (-SEARCH_PIXELS..=SEARCH_PIXELS).any(|dy| {
        (-SEARCH_PIXELS..=SEARCH_PIXELS).any(|dx| {
            colour_at(image, x + dx, y + dy)
                .is_some_and(|found| wanted.iter().any(|wanted| colour_distance(found, *wanted) < 6.0))
        })
    })
}

/// Largest allowed size of a picture, bytes. Drawing an outline for every tile took twice as much.
const MAX_BYTES: usize = 800_000;

/// Adds unequal joint limits around home that cut the workspace.
fn with_limits(mut description: Description) -> Description {
    let home = description.home.unwrap();
    for (i, joint) in description.joints.iter_mut().enumerate().take(description.kind.spec().joints) {
        let below = [0.9, 0.8, 0.7][i];
        joint.limits = Some((home[i] - below, home[i] + 0.6));
    }
    description
}

/// Returns a random pose of the drawn plane, within the limits.
fn random_pose(description: &Description, random: &mut Random) -> Vec<f64> {
    let home = description.home.unwrap();
    let joints = description.kind.spec().joints;
    let mut q: Vec<f64> = (0..joints)
        .map(|i| {
            let (low, high) = description.joints[i].limits.unwrap_or((home[i] - 1.2, home[i] + 1.2));
            low + (high - low) * random.uniform()
        })
        .collect();
    match description.kind {
        Kind::FiveBarTurret | Kind::Parallelogram => q[0] = 0.0,
        Kind::Serial3r => q[2] = home[..3].iter().sum::<f64>() - q[0] - q[1],
        _ => {}
    }
    q
}

fn is_within_limits(description: &Description, q: &[f64]) -> bool {
    q.iter().zip(&description.joints).all(|(q, j)| j.limits.is_none_or(|(low, high)| (low..=high).contains(q)))
}

/// Returns the shipped devices to draw, redundant ones once for each of several admissible sets.
fn devices_to_draw() -> Vec<(DeviceFile, Admissible)> {
    let devices = all_shipped_devices().into_iter().filter(|file| file.spec().joints > 1);
    devices
        .flat_map(|file| {
            let redundant = file.spec().joints > file.spec().task;
            let sets = [Admissible::Orientation, Admissible::Joint2, Admissible::Consistent];
            sets[..if redundant { 3 } else { 1 }].iter().map(|set| (file.clone(), *set)).collect::<Vec<_>>()
        })
        .collect()
}

#[test]
fn every_picture_shows_the_numbers_of_the_model() {
    for (file, admissible) in devices_to_draw() {
        for (which, description) in [("as shipped", file.description), ("with limits", with_limits(file.description))] {
            let file = DeviceFile { description, name: format!("{} {which}", file.name), ..file.clone() };
            let normal = &[0.6, 0.8, 0.0][..file.spec().task];
            let chart = chart(&file.description, &file.name, normal, admissible, Paper::default()).unwrap();
            let image = Pixmap::decode_png(&chart.picture.png().unwrap()).unwrap();
            check_colours(&file, normal, admissible, &chart, &image);
            if file.spec().joints == 2 {
                check_nothing_outside(&file, normal, &chart, &image);
            }
            check_scale(&file.name, &chart);
        }
    }
}

/// Compares colours with the model at random poses that can be reached from home.
fn check_colours(file: &DeviceFile, normal: &[f64], admissible: Admissible, chart: &Chart, image: &Pixmap) {
    let mut random = Random::new(7);
    let (mut compared, mut wrong) = (0, Vec::new());
    let home = evaluate_share(file, &file.description.home.unwrap()[..file.spec().joints], normal, admissible).unwrap();
    for _ in 0..800 {
        let q = random_pose(&file.description, &mut random);
        if compared == 50 || !is_within_limits(&file.description, &q) {
            continue;
        }
        let Some(found) = evaluate_share(file, &q, normal, admissible) else { continue };
        if found.regular < 0.2 || !is_straight_path_regular(file, &q, normal, home.side) {
            continue;
        }
        compared += 1;
        if !shows_share(chart, image, &found.place, found.share) {
            wrong.push((q, found.place, found.share));
        }
    }
    assert!(compared >= 20, "{}: only {compared} poses", file.name);
    assert!(wrong.is_empty(), "{}: {} of {compared} wrong: {:?}", file.name, wrong.len(), wrong.first());
}

/// Checks that nothing is drawn at places that are far from all poses of the JSON.
fn check_nothing_outside(file: &DeviceFile, normal: &[f64], chart: &Chart, image: &Pixmap) {
    let points = map(&file.description, normal, 20_000).unwrap();
    let places: Vec<(f64, f64)> = points.iter().map(|p| chart.frame.pixel(p.position[0], p.position[1])).collect();
    let mut random = Random::new(11);
    let (mut outside, mut coloured) = (0, Vec::new());
    for _ in 0..400 {
        let x = chart.frame.at.0 + chart.frame.size.0 * random.uniform();
        let y = chart.frame.at.1 + chart.frame.size.1 * random.uniform();
        // Grid poses are at most a dozen units apart, so places farther from all of them are outside.
        if places.iter().any(|p| (p.0 - x).hypot(p.1 - y) < 20.0) {
            continue;
        }
        outside += 1;
        let found = colour_at(image, (PIXELS_PER_UNIT * x) as i32, (PIXELS_PER_UNIT * y) as i32).unwrap();
        // The ground is white, and the lines of the linkage are grey.
        let grey = found.iter().max().unwrap() - found.iter().min().unwrap() < 12;
        if !grey {
            coloured.push((x, y));
        }
    }
    assert!(outside > 20, "{}: only {outside} places are outside", file.name);
    assert!(coloured.is_empty(), "{}: {} of {outside} at {coloured:?}", file.name, coloured.len());
}

/// Checks that the scale ends on a round number and has a mark for larger values.
fn check_scale(name: &str, chart: &Chart) {
    let svg = chart.picture.svg();
    let percent = (100.0 * chart.top * 1e6).round() / 1e6;
    assert_eq!(svg.contains(ABOVE_SCALE), svg.contains(&format!("&gt; {percent}")), "{name}: {percent}");
    assert!(
        colour(1.001 * chart.top, chart.top) == ABOVE_SCALE && colour(0.999 * chart.top, chart.top) != ABOVE_SCALE,
        "{name}"
    );
    assert!(svg.contains(&format!(">{percent} %<")), "{name}: no tick at the top, {percent} %");
    assert!(svg.contains("g in every direction"), "{name}");
    assert!(svg.len() < MAX_BYTES, "{name}: {} bytes", svg.len());
}

struct ModelPoint {
    place: Vec<f64>,
    share: f64,
    side: bool,
    regular: f64,
}

fn evaluate_share(file: &DeviceFile, q: &[f64], normal: &[f64], admissible: Admissible) -> Option<ModelPoint> {
    let walls = [WallForce { normal: normal.to_vec(), force: 0.0, stiffness: 1.0, feed_forward: true }];
    let report = evaluate_holding(file, q, &vec![0.0; q.len()], &walls, Precision::F64, admissible).ok()?;
    let pose = haptic_stability::analysis::pose::TaskPose::at(&file.description, q).ok()?;
    Some(ModelPoint {
        share: report.coupling[0][0] / report.w_rr[0][0],
        place: report.position,
        side: pose.jacobian.determinant() > 0.0,
        regular: pose.regularity.serial.min(pose.regularity.parallel),
    })
}

/// Returns true if the straight path from home in joint angles stays regular, so that the pose is reachable.
fn is_straight_path_regular(file: &DeviceFile, q: &[f64], normal: &[f64], side: bool) -> bool {
    let mut home = file.description.home.unwrap()[..q.len()].to_vec();
    if matches!(file.description.kind, Kind::FiveBarTurret | Kind::Parallelogram) {
        home[0] = 0.0;
    }
    (0..=20).all(|i| {
        let way: Vec<f64> = home.iter().zip(q).map(|(h, q)| h + (q - h) * f64::from(i) / 20.0).collect();
        evaluate_share(file, &way, normal, Admissible::default())
            .is_some_and(|found| found.side == side && found.regular > 0.1)
    })
}

fn draw_map(file: &DeviceFile, normal: &[f64]) -> Picture {
    haptic_show::plot::map::draw(&file.description, &file.name, normal, Admissible::default(), Paper::default())
        .unwrap()
}

#[test]
fn a_paddle_shows_its_arc_and_its_inertia() {
    let picture = draw_map(&shipped_device("hapkit-paddle"), &[1.0]);
    // 0.0008 kg m² / (70 mm)² is 163.3 g.
    assert!(picture.svg().contains("163.3 g"), "{}", picture.svg());
}

/// Checks that at least `least` left-aligned lines of text end within the picture.
fn check_captions(svg: &str, least: usize) {
    let width = svg_number(svg, "width").unwrap();
    let mut line_count = 0;
    for line in svg.lines().filter(|line| line.starts_with("<text") && line.contains("\"start\"")) {
        let words = line.split_once('>').unwrap().1.trim_end_matches("</text>");
        // As measured in the PNG, letters of this font are on average half as wide as high.
        let [x, size] = ["x", "font-size"].map(|attribute| svg_number(line, attribute).unwrap());
        let end = x + 0.508 * size * words.chars().count() as f64;
        assert!(end < width, "{words}: ends at {end:.0} of {width}");
        line_count += 1;
    }
    assert!(line_count >= least, "{line_count}");
}

#[test]
fn no_caption_of_a_map_is_cut_off() {
    for file in all_shipped_devices().into_iter().filter(|file| file.name != "hapkit-paddle") {
        let normal: Vec<f64> = (0..file.spec().task).map(|axis| f64::from(u8::from(axis == 0))).collect();
        check_captions(draw_map(&file, &normal).svg(), 4);
    }
    let mut paddle = shipped_device("hapkit-paddle");
    for limits in [None, Some((-1.04, 1.04))] {
        paddle.description.joints[0].limits = limits;
        check_captions(draw_map(&paddle, &[1.0]).svg(), 4);
    }
}
