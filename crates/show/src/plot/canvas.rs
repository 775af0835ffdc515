//! An SVG document, and the shapes that the pictures need. Coordinates are pixels, y down.

use std::collections::BTreeMap;
use std::fmt::Write;

use super::Picture;
use super::colour::INK;

/// Font family of all text; compiled in for PNG, with a fallback for SVG viewers.
pub const FONT_FAMILY: &str = "DejaVu Sans";
/// Size of the smallest text, units.
pub const SMALL_TEXT: f64 = 11.5;

/// Alignment of a text relative to its point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// The text starts at the point.
    Start,
    /// The text is centred on the point.
    Middle,
    /// The text ends at the point.
    End,
}

/// Style of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke<'a> {
    /// Any SVG colour.
    pub colour: &'a str,
    /// Width, pixels.
    pub width: f64,
    /// SVG dash pattern; empty for a solid line.
    pub dash: &'a str,
}

impl<'a> Stroke<'a> {
    /// Returns the style of a solid line.
    pub fn solid(colour: &'a str, width: f64) -> Self {
        Self { colour, width, dash: "" }
    }

    fn attributes(&self) -> String {
        let dash = if self.dash.is_empty() { String::new() } else { format!(r#" stroke-dasharray="{}""#, self.dash) };
        format!(r#"stroke="{}" stroke-width="{}"{dash}"#, self.colour, self.width)
    }
}

/// An SVG document being drawn.
pub struct Canvas {
    body: String,
    width: f64,
    height: f64,
    /// Width on paper, mm.
    printed: Option<f64>,
    caption: Vec<String>,
    clips: usize,
}

impl Canvas {
    /// Creates an empty white page.
    pub fn new(width: f64, height: f64) -> Self {
        Self { body: String::new(), width, height, printed: None, caption: Vec::new(), clips: 0 }
    }

    /// Sets the width on paper, mm.
    pub fn set_printed_width(&mut self, mm: f64) {
        self.printed = Some(mm);
    }

    /// Adds lines to the caption.
    pub fn caption<'t>(&mut self, lines: impl IntoIterator<Item = &'t str>) {
        self.caption.extend(lines.into_iter().filter(|line| !line.is_empty()).map(String::from));
    }

    /// Returns the width, units.
    pub fn width(&self) -> f64 {
        self.width
    }

    /// Makes the page higher. Returns the previous height.
    pub fn lengthen(&mut self, by: f64) -> f64 {
        let end = self.height;
        self.height += by;
        end
    }

    /// Finishes the picture; `title` and `description` are for readers who cannot see it.
    pub fn finish(self, title: &str, description: &str) -> Picture {
        let (width, height) = (self.width, self.height);
        let (title, description) = (escape(title), escape(description));
        let size = match self.printed {
            None => [width, height].map(|side| side.to_string()),
            Some(mm) => [mm, mm * height / width].map(|side| format!("{side:.2}mm")),
        };
        let svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{}\" height=\"{}\" \
             viewBox=\"0 0 {width} {height}\" font-family=\"{FONT_FAMILY}, Verdana, sans-serif\" fill=\"{INK}\">\n\
             <title>{title}</title>\n<desc>{description}</desc>\n\
             <rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n{}</svg>\n",
            size[0], size[1], self.body
        );
        Picture { svg, caption: self.caption.join("\n"), printed: self.printed.is_some() }
    }

    /// Adds SVG as it is.
    pub fn write(&mut self, element: std::fmt::Arguments<'_>) {
        // Writing to a String cannot fail.
        let _ = self.body.write_fmt(element);
        self.body.push('\n');
    }

    /// Draws a straight line.
    pub fn line(&mut self, from: (f64, f64), to: (f64, f64), stroke: Stroke<'_>) {
        let style = stroke.attributes();
        self.write(format_args!(
            r#"<line x1="{:.2}" y1="{:.2}" x2="{:.2}" y2="{:.2}" {style}/>"#,
            from.0, from.1, to.0, to.1
        ));
    }

    /// Draws an open line through points.
    pub fn polyline(&mut self, points: &[(f64, f64)], stroke: Stroke<'_>) {
        let style = stroke.attributes();
        let points = point_list(points);
        self.write(format_args!(r#"<polyline points="{points}" fill="none" stroke-linejoin="round" {style}/>"#));
    }

    /// Draws a filled area without outline.
    pub fn polygon(&mut self, points: &[(f64, f64)], fill: &str, opacity: f64) {
        let points = point_list(points);
        self.write(format_args!(r#"<polygon points="{points}" fill="{fill}" fill-opacity="{opacity}"/>"#));
    }

    /// Draws filled areas of one colour. All outlines need the same sense of rotation, because areas that share an edge
    /// are merged. A stroke hides seams; positions are rounded to a tenth of a pixel.
    pub fn tiles(&mut self, outlines: &[Vec<(f64, f64)>], fill: &str) {
        let mut path = String::new();
        let mut pen = (0, 0);
        for outline in merge_outlines(outlines) {
            let mut command = "m";
            for &(x, y) in &outline {
                // Moves are relative to the last point, or to the last outline's start. Writing to a String cannot
                // fail.
                let _ = write!(path, "{command}{} {}", x - pen.0, y - pen.1);
                (pen, command) = ((x, y), " ");
            }
            path.push('z');
            pen = outline[0];
        }
        self.write(format_args!(
            r#"<path transform="scale(.1)" d="{path}" fill="{fill}" stroke="{fill}" stroke-width="6"/>"#
        ));
    }

    /// Draws a rectangle, filled and (with a width above zero) outlined.
    pub fn rectangle(&mut self, at: (f64, f64), size: (f64, f64), fill: &str, stroke: Stroke<'_>) {
        let style = if stroke.width > 0.0 { stroke.attributes() } else { String::new() };
        self.write(format_args!(
            r#"<rect x="{:.2}" y="{:.2}" width="{:.2}" height="{:.2}" fill="{fill}" {style}/>"#,
            at.0, at.1, size.0, size.1
        ));
    }

    /// Draws a circle.
    pub fn circle(&mut self, at: (f64, f64), radius: f64, fill: &str, stroke: Stroke<'_>) {
        let style = stroke.attributes();
        self.write(format_args!(r#"<circle cx="{:.2}" cy="{:.2}" r="{radius}" fill="{fill}" {style}/>"#, at.0, at.1));
    }

    /// Draws text centred on a point, turned clockwise by `degrees`, with a white outline over lines.
    pub fn haloed_text(&mut self, at: (f64, f64), degrees: f64, size: f64, colour: &str, text: &str) {
        let text = escape(text);
        self.write(format_args!(
            r#"<text transform="translate({:.2} {:.2}) rotate({degrees:.2})" font-size="{size}" text-anchor="middle" fill="{colour}" stroke="white" stroke-width="3" paint-order="stroke">{text}</text>"#,
            at.0, at.1
        ));
    }

    /// Draws text of `size` pixels in a colour.
    pub fn coloured_text(&mut self, at: (f64, f64), size: f64, anchor: Anchor, colour: &str, text: &str) {
        self.write(format_args!(r#"<g fill="{colour}">"#));
        self.text(at, size, anchor, false, text);
        self.write(format_args!("</g>"));
    }

    /// Draws text of `size` pixels; `turned` rotates it by -90° for a vertical axis.
    pub fn text(&mut self, at: (f64, f64), size: f64, anchor: Anchor, turned: bool, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let turn = if turned { format!(r#" transform="rotate(-90 {:.2} {:.2})""#, at.0, at.1) } else { String::new() };
        let text = escape(text);
        self.write(format_args!(
            r#"<text x="{:.2}" y="{:.2}" font-size="{size}" text-anchor="{anchor}"{turn}>{text}</text>"#,
            at.0, at.1
        ));
    }

    /// Clips everything until [`Canvas::end_clip`] to a rectangle.
    pub fn begin_clip(&mut self, at: (f64, f64), size: (f64, f64)) {
        self.clips += 1;
        let id = self.clips;
        self.write(format_args!(
            r#"<clipPath id="clip{id}"><rect x="{:.2}" y="{:.2}" width="{:.2}" height="{:.2}"/></clipPath><g clip-path="url(#clip{id})">"#,
            at.0, at.1, size.0, size.1
        ));
    }

    /// Ends the clipping that began last.
    pub fn end_clip(&mut self) {
        self.write(format_args!("</g>"));
    }
}

/// Returns the outlines of the union of tiles, in tenths of a pixel. An edge that two tiles share runs once in each
/// direction and cancels out; the remaining edges form closed outlines.
fn merge_outlines(outlines: &[Vec<(f64, f64)>]) -> Vec<Vec<(i64, i64)>> {
    let tenths = |&(x, y): &(f64, f64)| ((10.0 * x).round() as i64, (10.0 * y).round() as i64);
    // Maps each start point to its edges, sorted, so that the picture is deterministic.
    let mut edges = BTreeMap::<(i64, i64), Vec<(i64, i64)>>::new();
    for outline in outlines {
        for (from, to) in outline.iter().zip(outline.iter().cycle().skip(1)) {
            let (from, to) = (tenths(from), tenths(to));
            let back = edges.get_mut(&to).and_then(|ends| {
                let twin = ends.iter().position(|end| *end == from)?;
                Some(ends.swap_remove(twin))
            });
            if from != to && back.is_none() {
                edges.entry(from).or_default().push(to);
            }
        }
    }
    edges.retain(|_, ends| !ends.is_empty());
    let mut result = Vec::new();
    while let Some((&start, _)) = edges.first_key_value() {
        let mut outline = Vec::new();
        let mut at = start;
        while let Some(ends) = edges.get_mut(&at) {
            outline.push(at);
            let next = ends.pop();
            if ends.is_empty() {
                edges.remove(&at);
            }
            at = next.unwrap_or(start);
        }
        result.push(outline);
    }
    result
}

fn point_list(points: &[(f64, f64)]) -> String {
    points.iter().map(|(x, y)| format!("{x:.2},{y:.2}")).collect::<Vec<_>>().join(" ")
}

/// Escapes text for XML; control characters, which XML forbids, become spaces.
fn escape(text: &str) -> String {
    let clean = text.chars().map(|c| if c.is_control() { ' ' } else { c });
    clean.fold(String::new(), |mut out, c| {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            c => out.push(c),
        }
        out
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns twice the area of outlines, with the sign of their sense of rotation.
    fn twice_signed_area(outlines: &[Vec<(i64, i64)>]) -> i64 {
        let twice = |o: &Vec<(i64, i64)>| {
            o.iter().zip(o.iter().cycle().skip(1)).map(|(a, b)| a.0 * b.1 - b.0 * a.1).sum::<i64>()
        };
        outlines.iter().map(twice).sum()
    }

    fn square(x: f64, y: f64) -> Vec<(f64, f64)> {
        vec![(x, y), (x + 1.0, y), (x + 1.0, y + 1.0), (x, y + 1.0)]
    }

    #[test]
    fn tiles_with_shared_edges_become_one_shape_with_holes() {
        let row = merge_outlines(&[square(0.0, 0.0), square(1.0, 0.0), square(5.0, 5.0)]);
        assert_eq!(row.iter().map(Vec::len).collect::<Vec<_>>(), [6, 4]);
        let ring: Vec<_> = (0..9).filter(|i| *i != 4).map(|i| square(f64::from(i % 3), f64::from(i / 3))).collect();
        let merged_ring = merge_outlines(&ring);
        assert_eq!(merged_ring.iter().map(Vec::len).sum::<usize>(), 12 + 4);
        assert_eq!(twice_signed_area(&merged_ring), 2 * 8 * 100);
    }
}
