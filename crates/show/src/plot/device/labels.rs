//! Places for labels: clear of links, of other labels and, if possible, of thin lines.

use super::HALF_LINK_WIDTH;
use super::marks::Mark;
use crate::plot::axes::{PlotArea, crosses_box};
use crate::plot::canvas::{Canvas, SMALL_TEXT};
use crate::plot::colour::INK;
use haptic_stability::skeleton::{Bar, Point, Skeleton};

/// Width of a letter, in sizes of the text.
const LETTER_WIDTH: f64 = 0.53;
/// Gap between a label and what is beside it, pixels.
const GAP: f64 = 3.0;
/// Number of directions around a point in which a label is tried.
const DIRECTIONS: usize = 16;

/// A rectangle of the drawing: left, top, right and bottom, pixels.
pub type Area = [f64; 4];

/// A text with its place.
pub struct Label {
    text: String,
    /// Centre of the text, pixels.
    centre: Point,
    size: f64,
    /// Rotation, degrees clockwise.
    slope: f64,
    colour: &'static str,
    /// True if the text covers no link and no other label.
    is_clear: bool,
}

/// The labels of a drawing, and what they must not cover.
pub struct Labels<'a> {
    frame: &'a PlotArea,
    links: Vec<[Point; 2]>,
    lines: Vec<Vec<Point>>,
    taken: Vec<Area>,
}

impl Label {
    fn new(text: &str, size: f64, colour: &'static str) -> Self {
        Self { text: text.into(), centre: (0.0, 0.0), size, slope: 0.0, colour, is_clear: false }
    }

    /// Returns half of the width and of the height of the rectangle around the text.
    fn half(&self) -> (f64, f64) {
        let (wide, tall) = (0.5 * LETTER_WIDTH * self.size * self.text.chars().count() as f64, 0.5 * self.size);
        let (sin, cos) = self.slope.to_radians().sin_cos();
        (wide * cos.abs() + tall * sin.abs(), wide * sin.abs() + tall * cos.abs())
    }

    fn area(&self) -> Area {
        let (wide, tall) = self.half();
        let (x, y) = self.centre;
        [x - wide - GAP, y - tall - GAP, x + wide + GAP, y + tall + GAP]
    }

    pub fn draw(&self, canvas: &mut Canvas) {
        // The baseline is below the centre of the letters.
        let (sin, cos) = self.slope.to_radians().sin_cos();
        let below = 0.36 * self.size;
        let at = (self.centre.0 - below * sin, self.centre.1 + below * cos);
        canvas.haloed_text(at, self.slope, self.size, self.colour, &self.text);
    }
}

impl<'a> Labels<'a> {
    /// Starts with the links, joints and tips of a skeleton.
    pub fn new(frame: &'a PlotArea, skeleton: &Skeleton) -> Self {
        let pixel = |(x, y): Point| frame.pixel(x, y);
        let links = skeleton.bars.iter().map(|bar| [bar.from, bar.to].map(pixel)).collect();
        let dots = skeleton.base.iter().chain([&skeleton.tip]).chain(&skeleton.more_tips).copied().map(pixel);
        let taken = dots.map(|(x, y)| [x - 6.0, y - 6.0, x + 6.0, y + 6.0]).collect();
        Self { frame, links, lines: Vec::new(), taken }
    }

    /// Adds thin lines, which labels avoid where there is another place.
    pub fn avoid(&mut self, lines: impl Iterator<Item = Vec<Point>>) {
        self.lines.extend(lines);
    }

    /// Takes the first place in the frame that is clear of everything; otherwise one clear of links and labels, of
    /// labels, or the first.
    fn take(&mut self, mut label: Label, centres: impl IntoIterator<Item = (Point, f64)>) -> Label {
        let [left, top] = [self.frame.at.0, self.frame.at.1];
        let [right, bottom] = [left + self.frame.size.0, top + self.frame.size.1];
        let mut best: Option<(usize, Point, f64)> = None;
        for (centre, slope) in centres {
            label.slope = slope;
            let (wide, tall) = label.half();
            let within = |at: f64, low: f64, high: f64| at.clamp(low.min(high), high.max(low));
            label.centre = (
                within(centre.0, left + wide + GAP, right - wide - GAP),
                within(centre.1, top + tall + GAP, bottom - tall - GAP),
            );
            let area = label.area();
            let covers = |line: &[Point], margin: f64| {
                crosses_box(line, (area[0] - margin, area[1] - margin), (area[2] + margin, area[3] + margin))
            };
            let cost = if self.taken.iter().any(|other| overlap(&area, other)) {
                3
            } else if self.links.iter().any(|link| covers(link, HALF_LINK_WIDTH - GAP)) {
                2
            } else {
                usize::from(self.lines.iter().any(|line| covers(line, -GAP)))
            };
            if best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, label.centre, slope));
            }
        }
        if let Some((cost, centre, slope)) = best {
            (label.centre, label.slope, label.is_clear) = (centre, slope, cost < 2);
        }
        self.taken.push(label.area());
        label
    }

    /// Takes the first place that is clear of links and labels, if there is one.
    fn take_clear(&mut self, label: Label, centres: impl IntoIterator<Item = (Point, f64)>) -> Option<Label> {
        let label = self.take(label, centres);
        if !label.is_clear {
            self.taken.pop();
        }
        label.is_clear.then_some(label)
    }

    /// Places a text next to a point, at least `distance` pixels away.
    pub fn around(&mut self, point: Point, distance: f64, size: f64, text: &str) -> Label {
        let label = Label::new(text, size, INK);
        let places = self.ring(point, distance, label.half());
        self.take(label, places)
    }

    /// Returns places around a point, the nearest first; above, below and beside it before the oblique ones.
    fn ring(&self, point: Point, distance: f64, (wide, tall): (f64, f64)) -> Vec<(Point, f64)> {
        let order = [4, 12, 0, 8].into_iter().chain(0..DIRECTIONS);
        let directions: Vec<(f64, f64)> =
            order.map(|i| (i as f64 * std::f64::consts::TAU / DIRECTIONS as f64).sin_cos()).collect();
        let far = [0.0, 8.0, 18.0, 32.0, 50.0];
        let places = far.into_iter().flat_map(|far| directions.iter().map(move |(sin, cos)| (far, *sin, *cos)));
        places
            .map(|(far, sin, cos)| {
                let away = distance + GAP + far;
                ((point.0 + (away + wide) * cos, point.1 - (away + tall) * sin), 0.0)
            })
            .collect()
    }

    /// Places the label of a joint near its mark.
    pub fn of_mark(&mut self, mark: &Mark) -> Label {
        let label = Label::new(&mark.text, 12.0, mark.colour);
        let half = label.half();
        let close = self.ring(mark.at, 12.0, half);
        let outside = self.ring(mark.at, mark.radius, half);
        self.take(label, close.into_iter().chain(outside))
    }

    /// Places the name of an axis along its line, near one of its ends. Returns `None` if every place covers a link or
    /// another label.
    pub fn along(&mut self, line: [Point; 2], text: &str) -> Option<Label> {
        let label = Label::new(text, SMALL_TEXT, INK);
        let (wide, _) = label.half();
        let places = beside(line, 10.0, &[-1.0, 1.0], |length| {
            [wide + 8.0, length - wide - 8.0, 0.25 * length, 0.75 * length].to_vec()
        });
        self.take_clear(label, places)
    }

    /// Places the name of a link along it, on the side away from the other links if possible. Returns `None` if every
    /// place covers a link or another label.
    pub fn of_link(&mut self, skeleton: &Skeleton, bar: &Bar, text: &str) -> Option<Label> {
        let pixel = |(x, y): Point| self.frame.pixel(x, y);
        let middle = |bar: &Bar| ((bar.from.0 + bar.to.0) / 2.0, (bar.from.1 + bar.to.1) / 2.0);
        let sum = skeleton.bars.iter().map(middle).fold((0.0, 0.0), |sum, p| (sum.0 + p.0, sum.1 + p.1));
        let count = skeleton.bars.len() as f64;
        let (centre, own) = (pixel((sum.0 / count, sum.1 / count)), pixel(middle(bar)));
        let line = [pixel(bar.from), pixel(bar.to)];
        let (dx, dy) = (line[1].0 - line[0].0, line[1].1 - line[0].1);
        let outward = if (own.0 - centre.0) * dy - (own.1 - centre.1) * dx < 0.0 { -1.0 } else { 1.0 };
        let label = Label::new(text, SMALL_TEXT, INK);
        let (wide, _) = label.half();
        // Begins away from the arcs at the link's base; a name longer than its link starts with the link.
        let places = beside(line, HALF_LINK_WIDTH + 9.0, &[outward, -outward], |length| {
            let past = (wide + 6.0 - length / 2.0).max(0.06 * length);
            [past, -past, 0.0, 0.2 * length, -0.2 * length, 2.0 * past].map(|past| length / 2.0 + past).to_vec()
        });
        self.take_clear(label, places)
    }
}

/// Returns places beside a line: `away` pixels from it on each of the `sides`, at some distances from its start. Text
/// runs along the line and never upside down.
fn beside([from, to]: [Point; 2], away: f64, sides: &[f64], distances: impl Fn(f64) -> Vec<f64>) -> Vec<(Point, f64)> {
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let length = dx.hypot(dy).max(1e-9);
    let (ux, uy) = (dx / length, dy / length);
    let mut slope = dy.atan2(dx).to_degrees();
    if !(-90.0..=90.0).contains(&slope) {
        slope -= 180.0 * slope.signum();
    }
    let place =
        |far: f64, side: f64| ((from.0 + far * ux + side * away * uy, from.1 + far * uy - side * away * ux), slope);
    distances(length).into_iter().flat_map(|far| sides.iter().map(move |side| place(far, *side))).collect()
}

fn overlap(a: &Area, b: &Area) -> bool {
    a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3]
}
