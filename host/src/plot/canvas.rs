//! An SVG document and the few shapes the pictures need. Coordinates in pixels, y down.

use std::fmt::Write;

use super::Picture;
use super::colour::INK;

/// Font family of every text; compiled in for PNG, with a fallback for SVG viewers.
pub const FONT: &str = "DejaVu Sans";

/// Where a text sits relative to its point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// Starts there.
    Start,
    /// Centred on it.
    Middle,
    /// Ends there.
    End,
}

/// How a line is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke<'a> {
    /// Any SVG colour.
    pub colour: &'a str,
    /// Pixels.
    pub width: f64,
    /// SVG dash pattern; empty for a solid line.
    pub dash: &'a str,
}

impl<'a> Stroke<'a> {
    /// A solid line.
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
    clips: usize,
}

impl Canvas {
    /// An empty white page.
    pub fn new(width: f64, height: f64) -> Self {
        Self { body: String::new(), width, height, clips: 0 }
    }

    /// The finished picture; `title` and `description` are for readers who cannot see it.
    pub fn finish(self, title: &str, description: &str) -> Picture {
        let (width, height) = (self.width, self.height);
        let (title, description) = (escaped(title), escaped(description));
        let svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" font-family=\"{FONT}, Verdana, sans-serif\" fill=\"{INK}\">\n\
             <title>{title}</title>\n<desc>{description}</desc>\n\
             <rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n{}</svg>\n",
            self.body
        );
        Picture { svg }
    }

    fn push(&mut self, element: std::fmt::Arguments<'_>) {
        // Writing to a String cannot fail.
        let _ = self.body.write_fmt(element);
        self.body.push('\n');
    }

    /// A straight line.
    pub fn line(&mut self, from: (f64, f64), to: (f64, f64), stroke: Stroke<'_>) {
        let style = stroke.attributes();
        self.push(format_args!(
            r#"<line x1="{:.2}" y1="{:.2}" x2="{:.2}" y2="{:.2}" {style}/>"#,
            from.0, from.1, to.0, to.1
        ));
    }

    /// An open line through points.
    pub fn polyline(&mut self, points: &[(f64, f64)], stroke: Stroke<'_>) {
        let style = stroke.attributes();
        let points = listed(points);
        self.push(format_args!(r#"<polyline points="{points}" fill="none" stroke-linejoin="round" {style}/>"#));
    }

    /// A filled area without outline.
    pub fn polygon(&mut self, points: &[(f64, f64)], fill: &str, opacity: f64) {
        let points = listed(points);
        self.push(format_args!(r#"<polygon points="{points}" fill="{fill}" fill-opacity="{opacity}"/>"#));
    }

    /// Filled areas of one colour, outlined in it so that no seam shows between neighbours.
    pub fn tiles(&mut self, outlines: &[Vec<(f64, f64)>], fill: &str) {
        let mut path = String::new();
        for outline in outlines {
            for (i, (x, y)) in outline.iter().enumerate() {
                // Writing to a String cannot fail.
                let _ = write!(path, "{}{x:.1} {y:.1}", if i == 0 { "M" } else { "L" });
            }
            path.push('Z');
        }
        self.push(format_args!(r#"<path d="{path}" fill="{fill}" stroke="{fill}" stroke-width=".6"/>"#));
    }

    /// A rectangle, filled and (with a width above zero) outlined.
    pub fn rectangle(&mut self, at: (f64, f64), size: (f64, f64), fill: &str, stroke: Stroke<'_>) {
        let style = if stroke.width > 0.0 { stroke.attributes() } else { String::new() };
        self.push(format_args!(
            r#"<rect x="{:.2}" y="{:.2}" width="{:.2}" height="{:.2}" fill="{fill}" {style}/>"#,
            at.0, at.1, size.0, size.1
        ));
    }

    /// A circle.
    pub fn circle(&mut self, at: (f64, f64), radius: f64, fill: &str, stroke: Stroke<'_>) {
        let style = stroke.attributes();
        self.push(format_args!(r#"<circle cx="{:.2}" cy="{:.2}" r="{radius}" fill="{fill}" {style}/>"#, at.0, at.1));
    }

    /// Text of 11 pixels centred on a point, turned by `degrees` clockwise.
    pub fn slanted_text(&mut self, at: (f64, f64), degrees: f64, text: &str) {
        let text = escaped(text);
        self.push(format_args!(
            r#"<text transform="translate({:.2} {:.2}) rotate({degrees:.2})" font-size="11" text-anchor="middle">{text}</text>"#,
            at.0, at.1
        ));
    }

    /// Text of `size` pixels in a colour.
    pub fn coloured_text(&mut self, at: (f64, f64), size: f64, anchor: Anchor, colour: &str, text: &str) {
        self.push(format_args!(r#"<g fill="{colour}">"#));
        self.text(at, size, anchor, false, text);
        self.push(format_args!("</g>"));
    }

    /// Text of `size` pixels; `turned` by -90° where it labels a vertical axis.
    pub fn text(&mut self, at: (f64, f64), size: f64, anchor: Anchor, turned: bool, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let turn = if turned { format!(r#" transform="rotate(-90 {:.2} {:.2})""#, at.0, at.1) } else { String::new() };
        let text = escaped(text);
        self.push(format_args!(
            r#"<text x="{:.2}" y="{:.2}" font-size="{size}" text-anchor="{anchor}"{turn}>{text}</text>"#,
            at.0, at.1
        ));
    }

    /// Clips everything until [`Canvas::end_clip`] to a rectangle.
    pub fn begin_clip(&mut self, at: (f64, f64), size: (f64, f64)) {
        self.clips += 1;
        let id = self.clips;
        self.push(format_args!(
            r#"<clipPath id="clip{id}"><rect x="{:.2}" y="{:.2}" width="{:.2}" height="{:.2}"/></clipPath><g clip-path="url(#clip{id})">"#,
            at.0, at.1, size.0, size.1
        ));
    }

    /// Ends the clipping that began last.
    pub fn end_clip(&mut self) {
        self.push(format_args!("</g>"));
    }
}

fn listed(points: &[(f64, f64)]) -> String {
    points.iter().map(|(x, y)| format!("{x:.2},{y:.2}")).collect::<Vec<_>>().join(" ")
}

/// Text as XML; control characters, which XML forbids, become spaces.
fn escaped(text: &str) -> String {
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
