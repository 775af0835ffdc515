//! Page widths on a screen and on paper, and text wrapping.
//!
//! On paper the unit of a drawing is chosen so that the smallest letters have 8 pt, as journals require: a column of 85
//! mm has 346 units, a page of 170 mm 693. A picture is laid out for this width and never shrunk.

use super::canvas::{Anchor, Canvas, SMALL_TEXT};

/// Millimetres of paper per unit that give the smallest text 8 pt.
pub const UNIT_MM: f64 = 8.0 * 25.4 / 72.0 / SMALL_TEXT;
/// On a page narrower than this, text begins at the edge and numbers along an axis get less room.
const NARROW_WIDTH: f64 = 500.0;
const NARROW_LEFT_EDGE: f64 = 78.0;
/// Margin at the edge of a page.
pub const EDGE_MARGIN: f64 = 10.0;
/// Letter size and line height of a title, and of the lines under the title.
const TITLE_SIZES: (f64, f64) = (15.0, 19.0);
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

    /// Returns the scale of a drawing that is `size` wide and high: on a screen `usual`, on paper at most what leaves
    /// `room` to the left and right, and above and below.
    pub fn scale(&self, usual: f64, size: (f64, f64), room: (f64, f64)) -> f64 {
        match self.paper.is_printed() {
            true => usual.min((self.wide - room.0) / size.0).min((self.most_high() - room.1) / size.1),
            false => usual,
        }
    }

    /// Returns the largest height on paper: 70 mm of a column of 85 mm.
    pub fn most_high(&self) -> f64 {
        self.wide * 70.0 / 85.0
    }

    /// Returns an empty canvas of the page's width.
    pub fn canvas(&self, height: f64) -> Canvas {
        let mut canvas = Canvas::new(self.wide, height);
        if let Some(mm) = self.paper.0 {
            canvas.set_printed_width(mm);
        }
        canvas
    }

    /// Wraps a title and the lines under it. On paper they belong to the caption.
    pub fn heading(&self, title: &str, under: &[String]) -> Heading {
        let room = self.wide - self.begin - EDGE_MARGIN;
        let under = under.iter().map(String::as_str);
        if self.paper.is_printed() {
            let caption = std::iter::once(title).chain(under).map(String::from).collect();
            return Heading { begin: self.begin, titles: Vec::new(), under: Vec::new(), caption };
        }
        Heading {
            begin: self.begin,
            titles: wrap(title, room, TITLE_SIZES.0),
            under: under.flat_map(|line| wrap(line, room, SUBTITLE_SIZES.0)).collect(),
            caption: Vec::new(),
        }
    }

    /// Wraps notes in small text below a frame. On paper they belong to the caption.
    pub fn notes<'a>(&self, notes: impl IntoIterator<Item = &'a str>) -> Notes {
        let room = self.wide - self.begin - EDGE_MARGIN;
        let all = notes.into_iter().map(String::from).collect();
        match self.paper.is_printed() {
            true => Notes { begin: self.begin, lines: Vec::new(), caption: all },
            false => {
                let lines = all.iter().flat_map(|note| wrap(note, room, SMALL_TEXT)).collect();
                Notes { begin: self.begin, lines, caption: Vec::new() }
            }
        }
    }
}

/// A title with the lines under it.
pub struct Heading {
    begin: f64,
    titles: Vec<String>,
    under: Vec<String>,
    caption: Vec<String>,
}

impl Heading {
    /// Returns the additional height compared with a title of one line and `usual` lines under it; negative without
    /// them.
    pub fn extra_height(&self, usual: usize) -> f64 {
        let lines = if self.titles.is_empty() {
            (0.0, 0.0)
        } else {
            (self.titles.len() as f64, self.under.len().max(usual) as f64)
        };
        TITLE_SIZES.1 * (lines.0 - 1.0) + SUBTITLE_SIZES.1 * (lines.1 - usual as f64)
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
        canvas.caption(self.caption.iter().map(String::as_str));
    }
}

/// Notes below a frame.
pub struct Notes {
    begin: f64,
    lines: Vec<String>,
    caption: Vec<String>,
}

impl Notes {
    /// Distance of two lines, pixels.
    const LINE: f64 = 17.0;

    /// Returns the height of the notes.
    pub fn height(&self) -> f64 {
        Self::LINE * self.lines.len() as f64
    }

    /// Draws the notes with the first line at `y`.
    pub fn draw(&self, canvas: &mut Canvas, y: f64) {
        for (line, text) in self.lines.iter().enumerate() {
            canvas.text((self.begin, y + Self::LINE * line as f64), SMALL_TEXT, Anchor::Start, false, text);
        }
        canvas.caption(self.caption.iter().map(String::as_str));
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
