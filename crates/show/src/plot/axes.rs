//! A framed coordinate system on a canvas: round ticks, SI prefixes, curves with names, dots with error bars.

use super::canvas::{Anchor, Canvas, SMALL_TEXT, Stroke};
use super::colour::INK;

const TICK_TEXT_SIZE: f64 = 12.0;

/// A quantity along an axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Name, such as "stiffness kp".
    pub name: String,
    /// SI unit, such as "N/m".
    pub unit: String,
    /// Lowest value shown.
    pub low: f64,
    /// Highest value shown.
    pub high: f64,
    /// True for a logarithmic axis.
    pub log: bool,
}

/// The frame of a plot: its position on the canvas, and its axes.
#[derive(Clone, Debug)]
pub struct PlotArea {
    /// Left and top edge, pixels.
    pub at: (f64, f64),
    /// Width and height, pixels.
    pub size: (f64, f64),
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
}

/// A name to write next to a curve.
pub struct CurveName<'a> {
    /// Points of the curve, values.
    pub curve: Vec<(f64, f64)>,
    /// Colour of the curve.
    pub colour: &'a str,
    /// The name.
    pub name: String,
}

impl Axis {
    /// Returns a linear axis.
    pub fn new(name: impl Into<String>, unit: &str, low: f64, high: f64) -> Self {
        Self { name: name.into(), unit: unit.into(), low, high, log: false }
    }

    /// Returns a logarithmic axis; values below its lowest are drawn there.
    pub fn logarithmic(name: impl Into<String>, unit: &str, low: f64, high: f64) -> Self {
        Self { log: true, ..Self::new(name, unit, low, high) }
    }

    /// Returns the position of a value along the axis, 0 to 1 within it.
    fn share(&self, value: f64) -> f64 {
        if self.log {
            (value.max(self.low) / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        }
    }

    /// Returns the prefixed unit and the factor from values to it: 12000 N/m is 12 kN/m.
    fn with_prefix(&self) -> (f64, String) {
        let size = self.low.abs().max(self.high.abs());
        let prefixes = [(1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ")];
        // Kilograms (never "mkg"), decibels and numbers without a unit get no prefix.
        if self.unit.is_empty() || self.unit == "kg" || self.unit == "dB" {
            return (1.0, self.unit.clone());
        }
        // A larger unit begins at 2: 1500 N/m stays, but 1500 mN is 1.5 N.
        let fits = |f: f64| size >= if f > 1.0 { 2.0 * f } else { f };
        let (factor, prefix) = prefixes.into_iter().find(|(f, _)| fits(*f)).unwrap_or((1e-6, "µ"));
        (1.0 / factor, format!("{prefix}{}", self.unit))
    }

    fn label(&self) -> String {
        let unit = self.with_prefix().1;
        if unit.is_empty() { self.name.clone() } else { format!("{} ({unit})", self.name) }
    }

    /// Returns round values inside the axis, about `count` of them and at least four, with their texts.
    fn ticks(&self, count: f64) -> Vec<(f64, String)> {
        let factor = self.with_prefix().0;
        if self.log {
            let text = |power: i32| match power {
                -3..=3 => format!("{}", 10f64.powi(power)),
                _ => format!("1e{power}"),
            };
            let decades = (self.low * factor).log10().ceil() as i32..=(self.high * factor).log10().floor() as i32;
            return decades.map(|power| (10f64.powi(power) / factor, text(power))).collect();
        }
        let (low, high) = (self.low * factor, self.high * factor);
        let span = high - low;
        if !(span.is_finite() && span > 0.0) {
            return Vec::new();
        }
        let raw = span / count;
        let power = 10f64.powf(raw.log10().floor());
        let first = |step: f64| (low / step - 1e-9).ceil() as i64;
        let last = |step: f64| (high / step + 1e-9).floor() as i64;
        // Lists steps from coarse to fine. The first candidate is not finer than `count` requires.
        let steps = [10.0, 5.0, 2.0, 1.0, 0.5].map(|s| s * power);
        let coarse = steps.into_iter().rposition(|step| step >= raw).unwrap_or(0);
        let step = steps[coarse..].iter().copied().find(|step| last(*step) - first(*step) >= 3).unwrap_or(steps[4]);
        let decimals = (-(step.log10() + 1e-9).floor()).clamp(0.0, 9.0) as usize;
        (first(step)..=last(step))
            .map(|i| {
                let value = i as f64 * step;
                (value / factor, format!("{value:.decimals$}"))
            })
            .collect()
    }
}

impl PlotArea {
    /// Returns the pixel of a value pair.
    pub fn pixel(&self, x: f64, y: f64) -> (f64, f64) {
        (self.at.0 + self.x.share(x) * self.size.0, self.at.1 + (1.0 - self.y.share(y)) * self.size.1)
    }

    /// Draws frame, ticks, labels and title.
    pub fn draw(&self, canvas: &mut Canvas, title: &str) {
        let (left, top) = self.at;
        let (width, height) = self.size;
        let bottom = top + height;
        let ticks = self.x.ticks(width / 75.0);
        // A narrow frame labels only every second or third tick, counted so that zero keeps its label.
        let longest = ticks.iter().map(|(_, text)| text.len()).max().unwrap_or(0);
        let shares: Vec<f64> = ticks.iter().map(|(value, _)| self.x.share(*value)).collect();
        let gap = shares.windows(2).map(|pair| width * (pair[1] - pair[0])).fold(width, f64::min);
        let stride = ((0.6 * longest as f64 + 0.7) * TICK_TEXT_SIZE / gap).ceil().max(1.0) as usize;
        let zero = ticks.iter().position(|(value, _)| *value == 0.0).unwrap_or(0);
        for (i, (value, text)) in ticks.into_iter().enumerate() {
            let (x, _) = self.pixel(value, self.y.low);
            canvas.line((x, bottom), (x, bottom + 5.0), Stroke::solid(INK, 1.0));
            if i % stride == zero % stride {
                canvas.text((x, bottom + 19.0), TICK_TEXT_SIZE, Anchor::Middle, false, &text);
            }
        }
        let mut widest = 0;
        for (value, text) in self.y.ticks(height / 55.0) {
            let (_, y) = self.pixel(self.x.low, value);
            widest = widest.max(text.chars().count());
            canvas.line((left - 5.0, y), (left, y), Stroke::solid(INK, 1.0));
            canvas.text((left - 9.0, y + 4.2), TICK_TEXT_SIZE, Anchor::End, false, &text);
        }
        canvas.rectangle(self.at, self.size, "none", Stroke::solid(INK, 1.0));
        canvas.text((left + width / 2.0, bottom + 40.0), 13.0, Anchor::Middle, false, &self.x.label());
        let clear = left - 20.0 - 7.7 * widest as f64;
        canvas.text((clear, top + height / 2.0), 13.0, Anchor::Middle, true, &self.y.label());
        canvas.text((left, top - 10.0), 13.5, Anchor::Start, false, title);
    }

    /// Runs `draw` and clips its shapes to the frame.
    pub fn draw_clipped(&self, canvas: &mut Canvas, draw: impl FnOnce(&mut Canvas)) {
        canvas.begin_clip(self.at, self.size);
        draw(canvas);
        canvas.end_clip();
    }

    /// Draws a curve through value pairs.
    pub fn curve(&self, canvas: &mut Canvas, points: &[(f64, f64)], stroke: Stroke<'_>) {
        let pixels: Vec<(f64, f64)> = points.iter().map(|&(x, y)| self.pixel(x, y)).collect();
        canvas.polyline(&pixels, stroke);
    }

    /// Fills the area between a curve and the horizontal axis.
    pub fn area_under(&self, canvas: &mut Canvas, points: &[(f64, f64)], fill: &str, opacity: f64) {
        let (Some(first), Some(last)) = (points.first(), points.last()) else { return };
        let mut pixels = vec![self.pixel(first.0, 0.0)];
        pixels.extend(points.iter().map(|&(x, y)| self.pixel(x, y)));
        pixels.push(self.pixel(last.0, 0.0));
        canvas.polygon(&pixels, fill, opacity);
    }

    /// Draws a dot at `y` with a bar from `low` to `high`.
    pub fn dot(&self, canvas: &mut Canvas, x: f64, y: f64, low: f64, high: f64, colour: &str) {
        let (px, top) = self.pixel(x, high);
        let (_, bottom) = self.pixel(x, low);
        let bar = Stroke::solid(colour, 1.2);
        if bottom - top > 1.0 {
            canvas.line((px, top), (px, bottom), bar);
            canvas.line((px - 3.0, top), (px + 3.0, top), bar);
            canvas.line((px - 3.0, bottom), (px + 3.0, bottom), bar);
        }
        canvas.circle(self.pixel(x, y), 3.2, "white", Stroke::solid(colour, 1.6));
    }

    /// Writes names of curves (values) in their colours, each next to its curve and clear of all `drawn` lines and dots
    /// and of other names. A name without room is not written.
    pub fn name_curves(&self, canvas: &mut Canvas, drawn: &[Vec<(f64, f64)>], names: &[CurveName<'_>]) {
        /// Distance of places that are tried, height of the letters, and smallest distance from a line, pixels.
        const STEP: f64 = 6.0;
        const HIGH: f64 = 10.0;
        const DOT_MARGIN: f64 = 5.0;
        let pixels = |line: &Vec<(f64, f64)>| line.iter().map(|&(x, y)| self.pixel(x, y)).collect::<Vec<_>>();
        let mut taken: Vec<Vec<(f64, f64)>> = drawn.iter().map(pixels).collect();
        for CurveName { curve, colour, name } in names {
            let width = 6.6 * name.chars().count() as f64;
            let curve = pixels(curve);
            let distance = |line: &[(f64, f64)], (x, y): (f64, f64)| {
                let to = |at: f64| line.iter().map(move |p| (p.0 - at).hypot(p.1 - y)).fold(f64::INFINITY, f64::min);
                to(x).min(to(x + width / 2.0)).min(to(x + width))
            };
            let (columns, rows) = ((self.size.0 - width - 12.0) / STEP, (self.size.1 - HIGH - 12.0) / STEP);
            let places =
                (0..=columns.max(-1.0) as i32).flat_map(|column| (0..=rows as i32).map(move |row| (column, row)));
            let places = places.map(|(column, row)| {
                (self.at.0 + 6.0 + STEP * f64::from(column), self.at.1 + 6.0 + HIGH + STEP * f64::from(row))
            });
            let is_free = |&(x, y): &(f64, f64)| {
                let (low, high) = ((x - DOT_MARGIN, y - HIGH - DOT_MARGIN), (x + width + DOT_MARGIN, y + DOT_MARGIN));
                !taken.iter().any(|line| crosses_box(line, low, high))
            };
            // The distance counts, and more so if another line is nearer.
            let cost = |at: &(f64, f64)| {
                let middle = (at.0, at.1 - HIGH / 2.0);
                let own = distance(&curve, middle);
                let others = taken.iter().filter(|line| **line != curve);
                own + others.map(|line| (1.5 * own - distance(line, middle)).max(0.0)).fold(0.0, f64::max)
            };
            let best = places.filter(is_free).map(|at| (cost(&at), at)).min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((_, at)) = best else { continue };
            canvas.coloured_text(at, SMALL_TEXT, Anchor::Start, colour, name);
            taken.push(vec![(at.0, at.1 - HIGH / 2.0), (at.0 + width, at.1 - HIGH / 2.0)]);
        }
    }
}

/// Returns true if the line through these points (or the single point) crosses the box between two corners.
pub(super) fn crosses_box(line: &[(f64, f64)], low: (f64, f64), high: (f64, f64)) -> bool {
    let crosses = |from: (f64, f64), to: (f64, f64)| {
        // Parameters of the segment, 0 to 1, at which it enters and leaves the box.
        let (mut enters, mut leaves) = (0.0_f64, 1.0_f64);
        for (from, to, low, high) in [(from.0, to.0, low.0, high.0), (from.1, to.1, low.1, high.1)] {
            if from == to {
                if from < low || from > high {
                    return false;
                }
                continue;
            }
            let ends = [(low - from) / (to - from), (high - from) / (to - from)];
            enters = enters.max(ends[0].min(ends[1]));
            leaves = leaves.min(ends[0].max(ends[1]));
        }
        enters <= leaves
    };
    match line {
        [only] => crosses(*only, *only),
        line => line.windows(2).any(|ends| crosses(ends[0], ends[1])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis(low: f64, high: f64, unit: &str) -> Axis {
        Axis::new("x", unit, low, high)
    }

    #[test]
    fn ticks_are_round_and_inside() {
        let texts = |axis: Axis| axis.ticks(6.0).into_iter().map(|t| t.1).collect::<Vec<_>>();
        assert_eq!(texts(axis(0.0, 0.103, "m")), ["0", "20", "40", "60", "80", "100"]);
        assert_eq!(texts(axis(-0.5, 0.5, "")), ["-0.4", "-0.2", "0.0", "0.2", "0.4"]);
        // A low panel has at least four ticks, because two would not show the scale.
        let low = axis(0.0, 17.3, "N").ticks(3.2).into_iter().map(|t| t.1).collect::<Vec<_>>();
        assert_eq!(low, ["0", "5", "10", "15"]);
        assert_eq!(axis(0.0, 12_000.0, "N/m").label(), "x (kN/m)");
        assert!(axis(1.0, 1.0, "m").ticks(5.0).is_empty());
        let decades = Axis::logarithmic("x", "N/m", 50.0, 2e5).ticks(5.0).into_iter().map(|t| t.1).collect::<Vec<_>>();
        assert_eq!(decades, ["0.1", "1", "10", "100"]);
    }
}
