//! An incremental encoder, which converts an angle to counts since power-on. The edges nearest to count 0 are half a
//! count on either side.

use haptic_bridge::model::description::Encoder;
use std::f64::consts::TAU;

/// The encoder of a joint, which counts from the angle of count 0, usually the joint angle at power-on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncoderModel {
    /// Counts per radian; negative for an inverted encoder.
    counts_per_rad: f64,
    /// The joint's angle at count 0, rad.
    origin: f64,
    /// The joint's angle at the index mark, rad.
    index: f64,
}

impl EncoderModel {
    /// Creates an encoder whose count is 0 at `origin` (rad).
    pub fn new(encoder: &Encoder, origin: f64) -> Self {
        let sign = if encoder.inverted { -1.0 } else { 1.0 };
        Self { counts_per_rad: sign * encoder.counts_per_turn / TAU, origin, index: encoder.offset }
    }
    /// Returns the count at the angle `q` (rad).
    pub fn counts(&self, q: f64) -> i32 {
        // `as` saturates, and converts NaN to 0.
        ((q - self.origin) * self.counts_per_rad).round() as i32
    }
    /// Returns true if the index mark is under the sensor, within half a count of the description's `offset` in each
    /// turn.
    pub fn at_index(&self, q: f64) -> bool {
        let turns = (q - self.index) / TAU;
        ((turns - turns.round()) * TAU * self.counts_per_rad).abs() <= 0.5
    }
    /// Returns the encoder with its edges shifted by `share` of one count.
    pub fn with_shifted_edges(&self, share: f64) -> Self {
        Self { origin: self.origin + share * self.resolution(), ..*self }
    }
    /// Returns the angle of one count, rad.
    pub fn resolution(&self) -> f64 {
        1.0 / self.counts_per_rad.abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_start_at_zero_at_power_on_and_follow_the_direction() {
        let encoder = Encoder { counts_per_turn: 4000.0, offset: 0.0, inverted: false };
        let plain = EncoderModel::new(&encoder, 1.0);
        let inverted = EncoderModel::new(&Encoder { inverted: true, ..encoder }, 1.0);
        assert_eq!(plain.counts(1.0), 0);
        assert_eq!(plain.counts(1.0 + TAU / 4.0), 1000);
        assert_eq!(inverted.counts(1.0 + TAU / 4.0), -1000);
        let half = 0.5 * plain.resolution();
        assert_eq!(plain.counts(1.0 + 0.99 * half), 0);
        assert_eq!(plain.counts(1.0 + 1.01 * half), 1);
    }

    #[test]
    fn the_index_mark_is_passed_once_per_turn_at_the_offset() {
        let encoder = Encoder { counts_per_turn: 4000.0, offset: 0.3, inverted: true };
        let model = EncoderModel::new(&encoder, 1.0);
        let hits = (0..4000).filter(|i| model.at_index(0.3 + f64::from(*i) * TAU / 4000.0)).count();
        assert_eq!(hits, 1);
        assert!(model.at_index(0.3 - TAU));
    }
}
