//! Improvements and drawbacks of the feed-forward, as sentences for the report and the picture.

use super::crossing::Crossing;
use std::cmp::Ordering;

/// Smaller relative changes are ignored, because the printed digits do not show them.
const MIN_CHANGE: f64 = 0.005;

/// Changes that the hand feels with the feed-forward.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Comparison {
    /// Improvements, such as "83 % less vibration under the resting hand".
    pub better: Vec<String>,
    /// Drawbacks, such as "4 % deeper penetration".
    pub worse: Vec<String>,
}

impl Comparison {
    /// Compares a crossing with the feed-forward with a crossing without it.
    pub fn of(without: &Crossing, with: &Crossing) -> Self {
        let mut comparison = Self::default();
        let mut compare = |without: f64, with: f64, less: &str, more: &str| {
            let change = with / without - 1.0;
            let percent = 100.0 * change.abs();
            if change < -MIN_CHANGE {
                comparison.better.push(format!("{percent:.0} % {less}"));
            } else if change > MIN_CHANGE {
                comparison.worse.push(format!("{percent:.0} % {more}"));
            }
        };
        let vibration = "vibration under the resting hand";
        compare(without.ripple, with.ripple, &format!("less {vibration}"), &format!("more {vibration}"));
        compare(without.penetration, with.penetration, "shallower penetration", "deeper penetration");
        compare(without.peak_force, with.peak_force, "lower peak force", "higher peak force");
        // Small counts are compared as numbers, not as percentages.
        let losses = format!("the hand loses contact {} times instead of {}", with.bounces, without.bounces);
        match with.bounces.cmp(&without.bounces) {
            Ordering::Less => comparison.better.push(losses),
            Ordering::Greater => comparison.worse.push(losses),
            Ordering::Equal => {}
        }
        comparison
    }

    /// Returns one sentence for the improvements and one for the drawbacks; "nothing" if there are none.
    pub fn sentences(&self) -> [String; 2] {
        let list = |changes: &[String]| if changes.is_empty() { "nothing".into() } else { changes.join(", ") };
        [format!("Better with it: {}.", list(&self.better)), format!("Worse with it: {}.", list(&self.worse))]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn crossing(penetration: f64, peak_force: f64, ripple: f64) -> Crossing {
        Crossing { moments: vec![], penetration, peak_force, ripple, bounces: 0, lost: 0, fault: None }
    }

    #[test]
    fn drawbacks_are_listed_with_improvements() {
        let comparison = Comparison::of(&crossing(1e-3, 10.0, 2.0), &crossing(1.2e-3, 10.01, 0.5));
        let [better, worse] = comparison.sentences();
        assert_eq!(better, "Better with it: 75 % less vibration under the resting hand.");
        assert_eq!(worse, "Worse with it: 20 % deeper penetration.");
        let bouncing = Crossing { bounces: 3, ..crossing(1e-3, 10.0, 2.0) };
        let [better, _] = Comparison::of(&bouncing, &crossing(1e-3, 10.0, 2.0)).sentences();
        assert_eq!(better, "Better with it: the hand loses contact 0 times instead of 3.");
        let same = crossing(1.0, 1.0, 1.0);
        assert_eq!(Comparison::of(&same, &same).sentences()[1], "Worse with it: nothing.");
    }
}
