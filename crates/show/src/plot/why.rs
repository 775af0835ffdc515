//! The picture of the limiting effects: the largest stiffness without each effect, compared with the complete loop, on
//! a logarithmic scale, without and with the feed-forward.

use super::Picture;
use super::canvas::{Anchor, SMALL_TEXT, Stroke};
use super::colour::{FAINT_GREY, FULL_COLOUR, OFF_COLOUR};
use super::paper::{EDGE_MARGIN, Paper};
use haptic_host::words::with_unit;
use haptic_stability::analysis::why::{EffectShares, LimitPair};

/// Maximum width of a letter, width of the bars on a screen, width of the values behind them, height of one effect,
/// pixels.
const LETTER_WIDTH: f64 = 6.8;
const BARS_WIDTH: f64 = 420.0;
const VALUE_WIDTH: f64 = 120.0;
const ROW_HEIGHT: f64 = 40.0;
const TOP_MARGIN: f64 = 92.0;
/// Height of the names of decades and colours below the rows, pixels.
const FOOT_HEIGHT: f64 = 48.0;
/// Shorter bars are placed under their names instead of next to them, pixels.
const MIN_BAR_WIDTH: f64 = 200.0;
/// Minimum distance between labels of decades, pixels.
const DECADE_GAP: f64 = 78.0;

/// Draws the picture with a title and two subtitle lines.
pub fn draw(title: &str, subtitle: &[String; 2], why: &EffectShares, paper: Paper) -> Picture {
    let rows: Vec<(String, LimitPair)> = std::iter::once(("with everything".to_string(), why.limits))
        .chain(why.effects.iter().map(|without| (format!("{}: {}", without.effect, without.instead), without.limits)))
        .collect();
    let longest = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    let name_width = 24.0 + LETTER_WIDTH * longest as f64;
    let page = paper.page(name_width + BARS_WIDTH + VALUE_WIDTH, 16.0);
    let in_line = page.wide - name_width - VALUE_WIDTH > MIN_BAR_WIDTH;
    let left = if in_line { name_width } else { EDGE_MARGIN };
    let width = page.wide - left - VALUE_WIDTH;
    let mut under = subtitle.to_vec();
    under.push("bars: largest stable stiffness without the effect".into());
    let heading = page.heading(title, &under);
    let top_of_rows = if paper.is_printed() { EDGE_MARGIN } else { TOP_MARGIN + heading.extra_height(2) };
    // On paper the rows share the height of a column.
    let bar = if paper.is_printed() { 7.0 } else { 12.0 };
    let row_high = match paper.is_printed() {
        true => (page.most_high() - top_of_rows - FOOT_HEIGHT).min(34.0 * rows.len() as f64) / rows.len() as f64,
        false if in_line => ROW_HEIGHT,
        false => ROW_HEIGHT + 16.0,
    };
    let values = || rows.iter().flat_map(|(_, both)| [both.off, both.full]).flatten().map(|limits| limits.kp_max);
    let highest = values().fold(0.0, f64::max).max(f64::MIN_POSITIVE);
    let lowest = values().filter(|kp| *kp > 0.0).fold(highest, f64::min);
    let (low, high) = (lowest.log10().floor(), highest.log10().ceil().max(lowest.log10().floor() + 1.0));
    let at = |kp: f64| left + width * ((kp.log10() - low) / (high - low)).clamp(0.0, 1.0);
    let bottom = top_of_rows + row_high * rows.len() as f64;

    let mut canvas = page.canvas(bottom + FOOT_HEIGHT);
    heading.draw(&mut canvas);
    let every = (DECADE_GAP * (high - low) / width).ceil().max(1.0) as usize;
    for (index, decade) in (low as i32..=high as i32).enumerate() {
        let kp = 10f64.powi(decade);
        let line = Stroke { colour: FAINT_GREY, width: 0.8, dash: "2 3" };
        canvas.line((at(kp), top_of_rows - 6.0), (at(kp), bottom), line);
        if index % every == 0 {
            // Keeps the first label on the page.
            let anchor = if at(kp) < DECADE_GAP / 2.0 { Anchor::Start } else { Anchor::Middle };
            canvas.text((at(kp), bottom + 16.0), SMALL_TEXT, anchor, false, &with_unit(kp, "N/m"));
        }
    }
    for (row, (name, both)) in rows.iter().enumerate() {
        let mut top = top_of_rows + row_high * row as f64;
        if in_line {
            canvas.text((left - 8.0, top + 21.0), 12.0, Anchor::End, false, name);
        } else {
            canvas.text((left, top + 12.0), 12.0, Anchor::Start, false, name);
            top += 14.0;
        }
        for (slot, (limits, colour)) in [(both.off, OFF_COLOUR), (both.full, FULL_COLOUR)].into_iter().enumerate() {
            let y = top + 2.0 + (bar + 2.0) * slot as f64;
            let (end, text) = match limits {
                Some(limits) if limits.kp_max > 0.0 => (at(limits.kp_max), with_unit(limits.kp_max, "N/m")),
                Some(_) => (left, "nothing is stable".to_string()),
                None => (left + width, "no limit".to_string()),
            };
            canvas.rectangle((left, y), (end - left, bar), colour, Stroke::solid(colour, 0.0));
            canvas.text((end + 6.0, y + bar / 2.0 + 4.0), SMALL_TEXT, Anchor::Start, false, &text);
        }
    }
    for (limits, colour) in [(why.limits.off, OFF_COLOUR), (why.limits.full, FULL_COLOUR)] {
        if let Some(limits) = limits.filter(|limits| limits.kp_max > 0.0) {
            let x = at(limits.kp_max);
            canvas.line((x, top_of_rows), (x, bottom), Stroke { colour, width: 1.2, dash: "5 3" });
        }
    }
    canvas.coloured_text((left, bottom + 40.0), 12.0, Anchor::Start, OFF_COLOUR, "no feed-forward");
    canvas.coloured_text((left + 130.0, bottom + 40.0), 12.0, Anchor::Start, FULL_COLOUR, "with feed-forward");
    canvas.finish(title, "Largest stable stiffness with everything, and without each effect in turn.")
}
