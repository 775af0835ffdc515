//! Page widths on a screen and on paper, and text wrapping.
//!
//! On paper the unit of a drawing is chosen so that the smallest letters have 8 pt, as journals require: a column of 85
//! mm has 346 units, a page of 170 mm 693. A picture is laid out for this width and never shrunk.

use super::canvas::{Anchor, Canvas, SMALL_TEXT};

/// Millimetres of paper per drawing unit that give the smallest text 8 pt.
const UNIT_MM: f64 = 8.0 * 25.4 / 72.0 / SMALL_TEXT;
/// Page width below which text begins at the edge and axis numbers get less room, units.
const NARROW_WIDTH: f64 = 500.0;
/// Left edge of frames on a narrow page, units.
const NARROW_LEFT_EDGE: f64 = 78.0;
/// Margin at the edge of a page, units.
pub const EDGE_MARGIN: f64 = 10.0;
/// Letter size and line height of a title, units.
const TITLE_SIZES: (f64, f64) = (15.0, 19.0);
/// Letter size and line height of a subtitle, units.
const SUBTITLE_SIZES: (f64, f64) = (12.0, 18.0);

/// Requested width of a picture, mm of paper; `None` for a screen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Paper(pub Option<f64>);

/// A page of a picture, measured in drawing units.
#[derive(Clone, Copy, Debug)]
pub struct Page {
    paper: Paper,
    /// Width, units.
    pub wide: f64,
    /// Left edge of frames, units.
    pub left: f64,
    /// Left edge of text, units.
    pub begin: f64,
}

impl Paper {
    /// Returns a page that is `usual` units wide on a screen, with frames and text at `left` if there is room.
    pub fn page(self, usual: f64, left: f64) -> Page {
        let wide = self.0.map_or(usual, |mm| mm / UNIT_MM);
        let (left, begin) = if wide < NARROW_WIDTH { (NARROW_LEFT_EDGE, EDGE_MARGIN) } else { (left, left) };
        Page { paper: self, wide, left, begin }
    }

    /// Returns true if the picture has a width on paper.
    pub fn is_printed(self) -> bool {
        self.0.is_some()
    }
}

impl Page {
    /// Returns true if the page is too narrow for the usual left margin.
    pub fn is_narrow(&self) -> bool {
        self.wide < NARROW_WIDTH
    }

    /// Returns an empty canvas of the page's width.
    pub fn canvas(&self, height: f64) -> Canvas {
        let mut canvas = Canvas::new(self.wide, height);
        if let Some(mm) = self.paper.0 {
            canvas.set_printed_width(mm);
        }
        canvas
    }

    /// Wraps a title and the lines under it.
    pub fn heading(&self, title: &str, under: &[String]) -> Heading {
        let room = self.wide - self.begin - EDGE_MARGIN;
        Heading {
            begin: self.begin,
            titles: wrap(title, room, TITLE_SIZES.0),
            under: under.iter().flat_map(|line| wrap(line, room, SUBTITLE_SIZES.0)).collect(),
        }
    }

    /// Wraps notes in small text below a frame.
    pub fn notes<'a>(&self, notes: impl IntoIterator<Item = &'a str>) -> Vec<String> {
        let room = self.wide - self.begin - EDGE_MARGIN;
        notes.into_iter().flat_map(|note| wrap(note, room, SMALL_TEXT)).collect()
    }
}

/// A title with the lines under it.
pub struct Heading {
    begin: f64,
    titles: Vec<String>,
    under: Vec<String>,
}

impl Heading {
    /// Returns the additional height compared with a title of one line and `usual` lines under it.
    pub fn extra_height(&self, usual: usize) -> f64 {
        let more = |lines: &[String], usual: usize| lines.len().saturating_sub(usual) as f64;
        TITLE_SIZES.1 * more(&self.titles, 1) + SUBTITLE_SIZES.1 * more(&self.under, usual)
    }

    /// Draws the heading at the top of a page.
    pub fn draw(&self, canvas: &mut Canvas) {
        let mut y = 28.0;
        for title in &self.titles {
            canvas.text((self.begin, y), TITLE_SIZES.0, Anchor::Start, false, title);
            y += TITLE_SIZES.1;
        }
        for line in &self.under {
            canvas.text((self.begin, y + 1.0), SUBTITLE_SIZES.0, Anchor::Start, false, line);
            y += SUBTITLE_SIZES.1;
        }
    }
}

/// Wraps words into lines of at most `room` units at this letter size; a single long word may be wider.
pub fn wrap(text: &str, room: f64, size: f64) -> Vec<String> {
    // A letter of the font is at most 0.6 of its size wide.
    let max_letters = (room / (0.6 * size)) as usize;
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let last = lines
            .last_mut()
            .filter(|line| line.is_empty() || line.chars().count() + word.chars().count() < max_letters);
        match last {
            Some(line) if line.is_empty() => line.push_str(word),
            Some(line) => line.extend([" ", word]),
            None => lines.push(word.into()),
        }
    }
    lines
}
