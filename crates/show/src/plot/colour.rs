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

/// The viridis scale sampled in equal steps, 0xRRGGBB.
const VIRIDIS: [u32; 11] =
    [0x440154, 0x482475, 0x414487, 0x355f8d, 0x2a788e, 0x21918c, 0x22a884, 0x44bf70, 0x7ad151, 0xbddf26, 0xfde725];

/// Returns the colour of a share between 0 and 1; values outside get the nearest end.
pub fn scale(share: f64) -> String {
    let last = VIRIDIS.len() - 1;
    let at = if share.is_nan() { 0.0 } else { share.clamp(0.0, 1.0) * last as f64 };
    let low = (at.floor() as usize).min(last - 1);
    let mix = at - low as f64;
    let channel = |shift: u32| {
        let [a, b] = [low, low + 1].map(|step| f64::from((VIRIDIS[step] >> shift) & 0xff));
        (a + mix * (b - a)).round() as u8
    };
    format!("#{:02x}{:02x}{:02x}", channel(16), channel(8), channel(0))
}
