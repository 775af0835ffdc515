//! Colours: a palette that colour-blind readers can distinguish, and a perceptually uniform scale.
//!
//! Palette: Okabe and Ito, "Color Universal Design" (2008). Scale: viridis (Smith and van der Walt, 2015), sampled.

/// Colour of results without feed-forward.
pub const OFF_COLOUR: &str = "#0072B2";
/// Colour of results with feed-forward.
pub const FULL_COLOUR: &str = "#D55E00";
/// Colour of results with washed-out feed-forward.
pub const WASHOUT_COLOUR: &str = "#009E73";
/// Colour of walls rendered by a computer.
pub const HOST_COLOUR: &str = "#CC79A7";
/// Colour of passivity bounds, in contrast to the stability boundary.
pub const BOUND_COLOUR: &str = "#7A5195";
/// Colour of frames, ticks and text.
pub const INK: &str = "#222222";
/// Colour of background elements.
pub const FAINT_GREY: &str = "#9a9a9a";

/// Colour of values above the end of the scale.
pub const ABOVE_SCALE: &str = "#f4a58a";

/// The viridis scale sampled in equal steps, RGB.
const VIRIDIS: [(u8, u8, u8); 11] = [
    (68, 1, 84),
    (72, 36, 117),
    (65, 68, 135),
    (53, 95, 141),
    (42, 120, 142),
    (33, 145, 140),
    (34, 168, 132),
    (68, 191, 112),
    (122, 209, 81),
    (189, 223, 38),
    (253, 231, 37),
];

/// Returns the colour of a share between 0 and 1; values outside get the nearest end.
pub fn scale(share: f64) -> String {
    let last = VIRIDIS.len() - 1;
    let at = if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) * last as f64 };
    let low = (at.floor() as usize).min(last - 1);
    let mix = at - low as f64;
    let ((r0, g0, b0), (r1, g1, b1)) = (VIRIDIS[low], VIRIDIS[low + 1]);
    let channel = |a: u8, b: u8| (f64::from(a) + mix * (f64::from(b) - f64::from(a))).round() as u8;
    format!("#{:02x}{:02x}{:02x}", channel(r0, r1), channel(g0, g1), channel(b0, b1))
}
