//! Writes a scene file with one flat wall from settings.

use super::Settings;
use haptic_bridge::model::admissible::Admissible;
use haptic_bridge::render::scene::FeedForward;
use std::fmt::Write;

/// Formats a scene with one wall through `point` (m) with the unit `normal`. `about` are the lines of its comment.
#[must_use]
pub fn to_toml(settings: &Settings, admissible: Admissible, point: &[f64], normal: &[f64], about: &[String]) -> String {
    let mut text = String::new();
    for line in about {
        let _ = writeln!(text, "# {line}");
    }
    let list = |values: &[f64]| {
        let values: Vec<String> =
            values.iter().map(|value| format!("{:?}", (value * 1e6).round() / 1e6 + 0.0)).collect();
        format!("[{}]", values.join(", "))
    };
    let mut line = |content: String| {
        let _ = writeln!(text, "{content}");
    };
    line(format!("\nrate_hz = {:?}", settings.rate_hz));
    if settings.has_cutoff() {
        line(format!("cutoff_hz = {:?}", settings.cutoff_hz));
    }
    line(format!("estimator = \"{}\"", settings.estimator));
    if let Some(key) = settings.kind.spec().and_then(|spec| spec.key) {
        line(format!("{} = {}", key.name, settings.value));
    }
    if admissible != Admissible::default() {
        line(format!("admissible = \"{}\"", admissible.name()));
    }
    line(format!("\n[[wall]]\npoint = {}\nnormal = {}", list(point), list(normal)));
    line(format!("stiffness = {:?}\ndamping = {:?}", settings.stiffness, settings.damping));
    line(format!("feed_forward = \"{}\"", settings.feed_forward.name()));
    if settings.feed_forward == FeedForward::Washout {
        line(format!("washout_hz = {:?}", settings.washout_hz));
    }
    if settings.damping_compensation {
        line("damping_compensation = true".into());
    }
    text
}
