//! A framed coordinate system on a canvas: round ticks, SI prefixes, curves, dots with error bars, a legend.

use super::canvas::{Anchor, Canvas, SMALL_TEXT, Stroke};
use super::colour::{FAINT_GREY, INK};
use super::paper::{EDGE_MARGIN, wrap};

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

/// The symbol of a legend entry.
#[derive(Clone, Copy, Debug)]
pub enum Mark<'a> {
    /// A line.
    Line(Stroke<'a>),
    /// A dot with an error bar.
    Dot(&'a str),
    /// A circle.
    Circle(&'a str),
    /// A filled area.
    Area(&'a str),
    /// No symbol: the text continues the text of the previous entry.
    Continued,
}

impl Axis {
    /// Returns the factor from values to the prefixed unit, and that unit: 12000 N/m is 12 kN/m.
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
        let share = |axis: &Axis, v: f64| (v - axis.low) / (axis.high - axis.low);
        (self.at.0 + share(&self.x, x) * self.size.0, self.at.1 + (1.0 - share(&self.y, y)) * self.size.1)
    }

    /// Draws frame, ticks, labels and title.
    pub fn draw(&self, canvas: &mut Canvas, title: &str) {
        self.draw_along(canvas, title, &self.x.ticks(self.size.0 / 75.0), &self.x.label());
    }

    /// Draws the frame with a logarithmic x axis, labelled with the power of ten at each even decade.
    pub fn draw_decades(&self, canvas: &mut Canvas) {
        let superscript = |digit: char| match digit {
            '-' => '⁻',
            '1' => '¹',
            '2' => '²',
            '3' => '³',
            digit => digit.to_digit(10).and_then(|d| char::from_u32(0x2070 + d)).unwrap_or(digit),
        };
        let even = (self.x.low.ceil() as i32..=self.x.high.floor() as i32).filter(|decade| decade % 2 == 0);
        let power = |decade: i32| match decade {
            0 => "1".to_string(),
            decade => format!("10{}", decade.to_string().chars().map(superscript).collect::<String>()),
        };
        let ticks: Vec<(f64, String)> = even.map(|decade| (f64::from(decade), power(decade))).collect();
        self.draw_along(canvas, "", &ticks, &format!("{} ({})", self.x.name, self.x.unit));
    }

    fn draw_along(&self, canvas: &mut Canvas, title: &str, ticks: &[(f64, String)], label: &str) {
        let (left, top) = self.at;
        let (width, height) = self.size;
        let bottom = top + height;
        for (value, text) in ticks {
            let (x, _) = self.pixel(*value, self.y.low);
            canvas.line((x, bottom), (x, bottom + 5.0), Stroke::solid(INK, 1.0));
            canvas.text((x, bottom + 19.0), TICK_TEXT_SIZE, Anchor::Middle, false, text);
        }
        let mut widest = 0;
        for (value, text) in self.y.ticks(height / 55.0) {
            let (_, y) = self.pixel(self.x.low, value);
            widest = widest.max(text.chars().count());
            canvas.line((left - 5.0, y), (left, y), Stroke::solid(INK, 1.0));
            canvas.text((left - 9.0, y + 4.2), TICK_TEXT_SIZE, Anchor::End, false, &text);
        }
        canvas.rectangle(self.at, self.size, "none", Stroke::solid(INK, 1.0));
        canvas.text((left + width / 2.0, bottom + 40.0), 13.0, Anchor::Middle, false, label);
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

    /// Draws a legend in a corner of the frame free of `drawn` (values), or else below the picture, which then grows.
    pub fn place_legend(&self, canvas: &mut Canvas, drawn: &[Vec<(f64, f64)>], entries: &[(Mark<'_>, String)]) {
        const LEGEND_GAP: f64 = 10.0;
        let (width, height) = Self::legend_size(entries);
        let (left, right) = (self.at.0 + LEGEND_GAP, self.at.0 + self.size.0 - LEGEND_GAP);
        let (top, bottom) = (self.at.1 + LEGEND_GAP, self.at.1 + self.size.1 - LEGEND_GAP);
        let fits = width + 2.0 * LEGEND_GAP < self.size.0 && height + 2.0 * LEGEND_GAP < self.size.1;
        let corners = [(right, top), (left + width, top), (right, bottom - height), (left + width, bottom - height)];
        let free = corners.into_iter().find(|&(right, top)| {
            // Half the width of a dot with its outline.
            const DOT_MARGIN: f64 = 5.0;
            let low = (right - width - DOT_MARGIN, top - DOT_MARGIN);
            let high = (right + DOT_MARGIN, top + height + DOT_MARGIN);
            let pixels = |line: &Vec<(f64, f64)>| line.iter().map(|&(x, y)| self.pixel(x, y)).collect::<Vec<_>>();
            fits && !drawn.iter().map(pixels).any(|line| crosses_box(&line, low, high))
        });
        if let Some((right, top)) = free {
            return Self::legend(canvas, right, top, entries);
        }
        let max_width = canvas.width() - 2.0 * EDGE_MARGIN - 48.0;
        let folded: Vec<(Mark<'_>, String)> = entries
            .iter()
            .flat_map(|(mark, text)| {
                let lines = wrap(text, max_width, SMALL_TEXT);
                lines.into_iter().enumerate().map(|(i, line)| (if i == 0 { *mark } else { Mark::Continued }, line))
            })
            .collect();
        let (width, height) = Self::legend_size(&folded);
        let right = (self.at.0 + width).min(canvas.width() - EDGE_MARGIN);
        let top = canvas.lengthen(height + 2.0 * LEGEND_GAP);
        Self::legend(canvas, right, top, &folded);
    }

    /// Returns width and height of a legend, pixels.
    pub fn legend_size(entries: &[(Mark<'_>, String)]) -> (f64, f64) {
        let longest = entries.iter().map(|(_, text)| text.chars().count()).max().unwrap_or(0) as f64;
        (48.0 + 6.5 * longest, 10.0 + 18.0 * entries.len() as f64)
    }

    /// Draws a legend with its right edge at `right` and its first line at `top` (pixels).
    pub fn legend(canvas: &mut Canvas, right: f64, top: f64, entries: &[(Mark<'_>, String)]) {
        let (width, height) = Self::legend_size(entries);
        let left = right - width;
        canvas.rectangle((left, top), (width, height), "#ffffffee", Stroke::solid(FAINT_GREY, 0.6));
        for (i, entry) in entries.iter().enumerate() {
            Self::draw_entry(canvas, (left + 8.0, top + 14.0 + 18.0 * i as f64), entry);
        }
    }

    /// Draws a legend in one line that begins at `at` (pixels).
    pub fn legend_line(canvas: &mut Canvas, at: (f64, f64), entries: &[(Mark<'_>, String)]) {
        let mut left = at.0;
        for entry in entries {
            Self::draw_entry(canvas, (left, at.1), entry);
            left += 33.0 + 6.5 * entry.1.chars().count() as f64 + 20.0;
        }
    }

    /// Draws a legend entry: the symbol with its left end at this pixel, then the text.
    fn draw_entry(canvas: &mut Canvas, (left, y): (f64, f64), (mark, text): &(Mark<'_>, String)) {
        match mark {
            Mark::Line(stroke) => canvas.line((left, y), (left + 26.0, y), *stroke),
            Mark::Dot(colour) => {
                canvas.line((left + 13.0, y - 7.0), (left + 13.0, y + 7.0), Stroke::solid(colour, 1.2));
                canvas.circle((left + 13.0, y), 3.2, "white", Stroke::solid(colour, 1.6));
            }
            Mark::Area(colour) => {
                canvas.rectangle((left, y - 5.0), (26.0, 10.0), colour, Stroke::solid(colour, 0.0));
            }
            Mark::Circle(colour) => {
                canvas.circle((left + 13.0, y), 3.2, "white", Stroke::solid(colour, 1.6));
            }
            Mark::Continued => {}
        }
        canvas.text((left + 33.0, y + 4.0), 11.5, Anchor::Start, false, text);
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
        Axis { name: "x".into(), unit: unit.into(), low, high }
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
    }
}
