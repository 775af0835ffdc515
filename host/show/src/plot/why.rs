//! The picture of what each effect takes: the largest stiffness without it beside that with everything, on a
//! logarithmic scale, without and with the feed-forward.

use super::Picture;
use super::canvas::{Anchor, Canvas, Stroke};
use super::colour::{FAINT, FULL, OFF};
use haptic_host::words::with_unit;
use haptic_stability::analysis::why::{Both, Why};

/// Width of a letter at most, of the bars, and what one effect takes of the height, pixels.
const LETTER: f64 = 6.8;
const WIDTH: f64 = 420.0;
const ROW: f64 = 40.0;
const TOP: f64 = 92.0;

/// Draws it under a heading and two smaller lines.
pub fn draw(title: &str, subtitle: &[String; 2], why: &Why) -> Picture {
    let rows: Vec<(String, Both)> = std::iter::once(("with everything".to_string(), why.limits))
        .chain(why.effects.iter().map(|without| (format!("{}: {}", without.effect, without.instead), without.limits)))
        .collect();
    let longest = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    let left = 24.0 + LETTER * longest as f64;
    let values = || rows.iter().flat_map(|(_, both)| [both.off, both.full]).flatten().map(|limits| limits.kp_max);
    let highest = values().fold(0.0, f64::max).max(f64::MIN_POSITIVE);
    let lowest = values().filter(|kp| *kp > 0.0).fold(highest, f64::min);
    let (low, high) = (lowest.log10().floor(), highest.log10().ceil().max(lowest.log10().floor() + 1.0));
    let at = |kp: f64| left + WIDTH * ((kp.log10() - low) / (high - low)).clamp(0.0, 1.0);
    let bottom = TOP + ROW * rows.len() as f64;

    let mut canvas = Canvas::new(left + WIDTH + 120.0, bottom + 56.0);
    for decade in low as i32..=high as i32 {
        let kp = 10f64.powi(decade);
        canvas.line((at(kp), TOP - 6.0), (at(kp), bottom), Stroke { colour: FAINT, width: 0.8, dash: "2 3" });
        canvas.text((at(kp), bottom + 16.0), 11.0, Anchor::Middle, false, &with_unit(kp, "N/m"));
    }
    for (row, (name, both)) in rows.iter().enumerate() {
        let top = TOP + ROW * row as f64;
        canvas.text((left - 8.0, top + 21.0), 12.0, Anchor::End, false, name);
        for (slot, (limits, colour)) in [(both.off, OFF), (both.full, FULL)].into_iter().enumerate() {
            let y = top + 4.0 + 15.0 * slot as f64;
            let (end, text) = match limits {
                Some(limits) if limits.kp_max > 0.0 => (at(limits.kp_max), with_unit(limits.kp_max, "N/m")),
                Some(_) => (left, "nothing is stable".to_string()),
                None => (left + WIDTH, "no limit".to_string()),
            };
            canvas.rectangle((left, y), (end - left, 12.0), colour, Stroke::solid(colour, 0.0));
            canvas.text((end + 6.0, y + 10.0), 11.0, Anchor::Start, false, &text);
        }
    }
    for (limits, colour) in [(why.limits.off, OFF), (why.limits.full, FULL)] {
        if let Some(limits) = limits.filter(|limits| limits.kp_max > 0.0) {
            let x = at(limits.kp_max);
            canvas.line((x, TOP), (x, bottom), Stroke { colour, width: 1.2, dash: "5 3" });
        }
    }
    canvas.text((16.0, 28.0), 15.0, Anchor::Start, false, title);
    for (line, text) in subtitle.iter().enumerate() {
        canvas.text((16.0, 48.0 + 18.0 * line as f64), 12.0, Anchor::Start, false, text);
    }
    canvas.coloured_text((left, bottom + 40.0), 12.0, Anchor::Start, OFF, "no feed-forward");
    canvas.coloured_text((left + 130.0, bottom + 40.0), 12.0, Anchor::Start, FULL, "feed-forward (4)");
    canvas.text(
        (left + 260.0, bottom + 40.0),
        12.0,
        Anchor::Start,
        false,
        "largest stable stiffness without the effect",
    );
    canvas.finish(title, "Largest stable stiffness with everything, and without each effect in turn.")
}
